//! How far an object may slide over the plate because lens and pose are not exactly known.
//!
//! What the eye sees of a pose error is the foot of the object moving against the ground. A circle on
//! the support is projected; `slip = √(tr(J Σ J^T)/n)`, with pose and lens kept tied together: a focal
//! length that is wrong moves the pose as well, and most of it cancels near the target.

use glam::{DVec2, DVec3};

use super::planar_pose::PoseScatter;
use super::{Camera, lens::Projection};

/// Points of the circle.
const POINTS: usize = 12;

/// Predicted slip at `foot` (world, m), px rms over both coordinates of a circle of `radius_m` round it.
///
/// `normal` is the support's. `None` where the circle is not seen or nothing is known of the errors.
pub fn predicted_px(
    camera: &Camera,
    scatter: &PoseScatter,
    foot: DVec3,
    normal: DVec3,
    radius_m: f64,
) -> Option<f64> {
    let (a, b) = normal.try_normalize()?.any_orthonormal_pair();
    let mut variance = 0.0;
    for k in 0..POINTS {
        let (sin, cos) = (std::f64::consts::TAU * k as f64 / POINTS as f64).sin_cos();
        variance += point_variance(camera, scatter, foot + (a * cos + b * sin) * radius_m)?;
    }
    Some((variance / POINTS as f64).sqrt())
}

/// Variance of where a world point is seen, both coordinates together, px².
fn point_variance(camera: &Camera, scatter: &PoseScatter, point: DVec3) -> Option<f64> {
    let seen = camera.pose.inverse().transform_point3(point);
    let projection = camera.lens.project_with_derivatives(seen)?;
    let by_pose = by_pose(camera, &projection, seen);
    let mut variance = 0.0;
    for (i, a) in by_pose.iter().enumerate() {
        for (j, b) in by_pose.iter().enumerate() {
            variance += scatter.own[i][j] * a.dot(*b);
        }
    }
    let n = camera.lens.n_parameters();
    if let Some(lens) = camera.lens.covariance.as_ref().filter(|c| c.len() == n * n) {
        // A lens error acts directly and through the pose it was solved with.
        let by_lens: Vec<DVec2> = (0..n)
            .map(|k| {
                let through = scatter.by_lens.get(k).map_or(DVec2::ZERO, |moved| {
                    by_pose.iter().zip(moved).map(|(j, m)| *j * *m).sum()
                });
                projection.by_parameter[k] + through
            })
            .collect();
        for i in 0..n {
            for j in 0..n {
                variance += lens[i * n + j] * by_lens[i].dot(by_lens[j]);
            }
        }
    }
    Some(variance)
}

/// ∂pixel by rotation (camera axes) and position (world), as in [`planar_pose`](super::planar_pose).
fn by_pose(camera: &Camera, projection: &Projection, seen: DVec3) -> [DVec2; 6] {
    let [u, v] = projection.by_point;
    let (turn_u, turn_v) = (u.cross(seen), v.cross(seen));
    let rotation = camera.pose.rotation();
    let (shift_u, shift_v) = (-(rotation * u), -(rotation * v));
    std::array::from_fn(|i| {
        if i < 3 {
            DVec2::new(turn_u[i], turn_v[i])
        } else {
            DVec2::new(shift_u[i - 3], shift_v[i - 3])
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::planar_pose::{Noise, Sighting, solve};
    use crate::camera::print::rectangle_corners;
    use crate::camera::{Lens, Pose};

    #[test]
    fn predicted_slip_is_the_scatter_of_the_foot() {
        // 300 draws: a mean square of 12 × 2 tied coordinates scatters by less than 10 %; 4σ = 35 %.
        let truth = Camera {
            width: 1500,
            height: 1000,
            lens: Lens::pinhole(1500.0, 1500, 1000),
            pose: Pose::look_at(DVec3::new(0.0, 1.15, 1.64), DVec3::ZERO, DVec3::Y).unwrap(),
        };
        let corners = rectangle_corners(DVec3::ZERO, DVec3::Y, -DVec3::Z, 0.3, 0.3).unwrap();
        let foot = DVec3::new(0.4, 0.0, 0.0);
        let noise = Noise { sigma_px: 0.2, degrees: 1e6, size_sigma: 0.0 };
        let mut state = 88_172_645_463_325_252u64;
        let mut normal = || {
            (0..12)
                .map(|_| {
                    state ^= state << 13;
                    state ^= state >> 7;
                    state ^= state << 17;
                    (state >> 11) as f64 / (1u64 << 53) as f64
                })
                .sum::<f64>()
                - 6.0
        };
        let (mut seen_square, mut predicted) = (0.0, 0.0);
        for _ in 0..300 {
            let sightings: Vec<Sighting> = corners
                .iter()
                .map(|&world| {
                    let pixel = truth.project_world(world).unwrap();
                    Sighting { world, pixel: pixel + DVec2::new(normal(), normal()) * 0.2 }
                })
                .collect();
            let found = solve(&truth.lens, &sightings, &noise).unwrap();
            let camera = Camera { pose: found.pose.clone(), ..truth.clone() };
            let off = camera.project_world(foot).unwrap() - truth.project_world(foot).unwrap();
            seen_square += off.length_squared() / 300.0;
            predicted = predicted_px(&camera, &found.scatter, foot, DVec3::Y, 1e-6).unwrap();
        }
        let ratio = predicted / seen_square.sqrt();
        assert!(
            (0.75..1.35).contains(&ratio),
            "predicted {predicted}, seen {}",
            seen_square.sqrt()
        );
    }
}
