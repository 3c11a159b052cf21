//! Camera rays through the calibrated lens, one box per pixel.
//!
//! Directions at the corners of all pixels are unprojected once (Newton in `camera`), and a sample
//! inside a pixel is interpolated between its four corners, in the plane at unit distance: exact for
//! a pinhole, and off by less than 10⁻⁴ px for the distortion of a lens of 1000 px focal length.
//! The plate itself is never warped.

use glam::{DVec2, DVec3, Vec3};
use rayon::prelude::*;

use super::guides::Block;
use super::world::PartBall;
use crate::camera::Camera;
use crate::trace::Ray;

/// Rays of a camera's pixels.
pub struct Primary {
    width: usize,
    /// World directions at pixel corners, `(width + 1) × (height + 1)`, zero where the lens has none.
    /// Of length 1 along the axis if all the frame looks forward, else of unit length.
    corners: Vec<Vec3>,
    eye: Vec3,
}

impl Primary {
    /// `eye` is the camera's position relative to the scene's origin.
    pub fn new(camera: &Camera, eye: Vec3) -> Self {
        let width = camera.width;
        let axis = camera.pose.world_from_camera.matrix3 * -DVec3::Z;
        let mut corners: Vec<DVec3> = (0..camera.height + 1)
            .into_par_iter()
            .flat_map_iter(|y| {
                (0..width + 1).map(move |x| {
                    let pixel = DVec2::new(x as f64 - 0.5, y as f64 - 0.5);
                    camera.ray(pixel).map_or(DVec3::ZERO, |(_, d)| d)
                })
            })
            .collect();
        let forward = |d: &DVec3| *d == DVec3::ZERO || d.dot(axis) > 0.05;
        if corners.iter().all(forward) {
            for d in corners.iter_mut().filter(|d| **d != DVec3::ZERO) {
                *d /= d.dot(axis);
            }
        }
        let corners = corners.into_iter().map(|d| d.as_vec3()).collect();
        Self { width, corners, eye }
    }

    /// The ray through the point (u, v) in [0, 1]² of a pixel's box; `None` outside the lens.
    pub fn ray(&self, x: usize, y: usize, u: f32, v: f32) -> Option<Ray> {
        let at = |x: usize, y: usize| self.corners[y * (self.width + 1) + x];
        let corners = [at(x, y), at(x + 1, y), at(x, y + 1), at(x + 1, y + 1)];
        if corners.contains(&Vec3::ZERO) {
            return None;
        }
        let direction = corners[0].lerp(corners[1], u).lerp(corners[2].lerp(corners[3], u), v);
        Some(Ray {
            origin: self.eye,
            direction: direction.normalize(),
            t_min: 0.0,
            t_max: f32::INFINITY,
        })
    }

    /// Whether a ray of a block of pixels may meet one of the balls, as seen from `eye`.
    pub fn meets(&self, block: &Block, balls: &[PartBall], eye: Vec3) -> bool {
        let cone = self.cone(block.x, block.y, block.width, block.height);
        cone.is_none_or(|(axis, angle)| {
            balls.iter().any(|ball| {
                let to = ball.centre - eye;
                let distance = to.length();
                distance <= ball.radius
                    || axis.angle_between(to) <= angle + (ball.radius / distance).asin() + 1e-3
            })
        })
    }

    /// A cone around all rays of a block of pixels: axis and half angle, radians. `None` where the
    /// lens has no ray for a corner or the block spans too wide.
    fn cone(&self, x: usize, y: usize, width: usize, height: usize) -> Option<(Vec3, f32)> {
        let stride = self.width + 1;
        let corner = |i: usize, j: usize| self.corners[j * stride + i];
        let last = corner(x + width, y + height);
        let axis = (corner(x, y).normalize_or_zero() + last.normalize_or_zero()).try_normalize()?;
        let mut angle = 0.0_f32;
        for j in y..=y + height {
            for i in x..=x + width {
                if corner(i, j) == Vec3::ZERO {
                    return None;
                }
                angle = angle.max(axis.angle_between(corner(i, j)));
            }
        }
        (angle < 1.0).then_some((axis, angle))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{Distortion, Lens, Pose};

    #[test]
    fn interpolated_rays_are_those_of_the_lens() {
        let mut lens = Lens::pinhole(1000.0, 1200, 800);
        lens.distortion =
            Distortion::BrownConrady { k1: -0.12, k2: 0.05, p1: 1e-3, p2: -5e-4, k3: 0.0 };
        let pose = Pose::look_at(DVec3::new(1.0, 2.0, 3.0), DVec3::ZERO, DVec3::Y).unwrap();
        let camera = Camera { width: 1200, height: 800, lens, pose };
        let primary = Primary::new(&camera, camera.pose.position().as_vec3());
        for (x, y) in [(0, 0), (1199, 799), (600, 400), (50, 700)] {
            for (u, v) in [(0.5, 0.5), (0.25, 0.9)] {
                let ray = primary.ray(x, y, u, v).unwrap();
                let pixel =
                    DVec2::new(x as f64 - 0.5 + f64::from(u), y as f64 - 0.5 + f64::from(v));
                let (_, exact) = camera.ray(pixel).unwrap();
                let off = ray.direction.as_dvec3().angle_between(exact) * 1000.0;
                // f32 directions of ±6e-8 at 1000 px focal length alone are 1e-4 px.
                assert!(off < 3e-4, "({x}, {y}): {off} px");
            }
        }
    }
}
