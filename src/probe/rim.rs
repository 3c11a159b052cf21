//! The rim of a ball: the cone of camera rays that touch it.
//!
//! edge points as unit rays → [`Rim`] = axis + half-angle α with covariance. Every rim ray d obeys
//! `n·d = cos α, sin α = ρ/D`; in the picture that is an ellipse, and fitting a circle there is
//! 17 px wrong at 25° off axis (methods-capture C4, F22). RANSAC over three rays, plane fit to the
//! inliers, then Gauss–Newton on `acos(n·d) − α` with Tukey's weights.
//!
//! The scatter of the points says little about what was taken for the rim: an error of
//! [`SYSTEMATIC_PX`] is added to the statistical one (measured on rendered balls, C4).

use std::f64::consts::PI;

use glam::{DMat3, DVec3};
use nalgebra::Matrix3;

use super::ProbeError;

/// Error of axis and half-angle that no number of edge points removes, px.
pub const SYSTEMATIC_PX: f64 = 0.3;

/// Share of the edge points that must lie on the rim. With half of them on another curve
/// (a reflected horizon) RANSAC follows the wrong one in every tenth picture.
pub const MIN_INLIERS: f64 = 0.6;

/// Arc of the rim that must be seen, radians (F25: below it the axis error exceeds a pixel).
pub const MIN_ARC_RAD: f64 = PI / 4.0;

/// The cone of rays that touch a ball, in the axes of the rays it was fitted to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rim {
    /// Unit direction to the ball's centre.
    pub axis: DVec3,
    /// Half-angle α of the cone, radians.
    pub half_angle_rad: f64,
    /// Covariance of (axis along [`Rim::tangents`].0, along .1, half-angle), rad².
    pub covariance: [[f64; 3]; 3],
    /// Share of the edge points that lie on this cone.
    pub inlier_fraction: f64,
    /// How much of the rim the inliers cover, radians (full: 2π).
    pub arc_rad: f64,
    /// Scatter of the inliers about the cone, radians.
    pub residual_rad: f64,
}

impl Rim {
    /// A cone known from elsewhere, its axis to `sigma_rad` each way and its half-angle alike.
    pub fn known(axis: DVec3, half_angle_rad: f64, sigma_rad: f64) -> Self {
        let v = sigma_rad * sigma_rad;
        Self {
            axis: axis.normalize(),
            half_angle_rad,
            covariance: [[v, 0.0, 0.0], [0.0, v, 0.0], [0.0, 0.0, v]],
            inlier_fraction: 1.0,
            arc_rad: 2.0 * PI,
            residual_rad: 0.0,
        }
    }

    /// Two unit directions square to the axis and to each other.
    pub fn tangents(&self) -> (DVec3, DVec3) {
        self.axis.any_orthonormal_pair()
    }

    /// Standard error of the axis (root mean square of its two components), radians.
    pub fn sigma_axis_rad(&self) -> f64 {
        ((self.covariance[0][0] + self.covariance[1][1]) / 2.0).sqrt()
    }

    /// Standard error of the directions that the ball shows, radians: `2 σ/α` (C4: a centre error
    /// of one pixel turns the mirrored direction by 2/R rad).
    pub fn sigma_direction_rad(&self) -> f64 {
        2.0 * self.sigma_axis_rad() / self.half_angle_rad.sin()
    }

    /// Unit ray of the rim at `turn` radians round the axis.
    pub fn ray(&self, turn: f64) -> DVec3 {
        let (e1, e2) = self.tangents();
        let sideways = e1 * turn.cos() + e2 * turn.sin();
        self.axis * self.half_angle_rad.cos() + sideways * self.half_angle_rad.sin()
    }
}

/// Fits the rim to unit rays, of which up to 40 % may belong to something else.
///
/// `pixel_rad` is the angle of one pixel there; a ray counts as an inlier within `tolerance_px`.
/// Deterministic: the random triples come from a fixed seed.
pub fn fit(rays: &[DVec3], pixel_rad: f64, tolerance_px: f64) -> Result<Rim, ProbeError> {
    if rays.len() < 8 {
        let reason = format!("only {} edge points were found, 8 are needed", rays.len());
        return Err(ProbeError::NoBall { reason });
    }
    let tolerance = tolerance_px * pixel_rad;
    let start = consensus(rays, tolerance)
        .ok_or_else(|| ProbeError::NoBall { reason: "the edge points lie on no cone".into() })?;
    let near: Vec<DVec3> = rays.iter().copied().filter(|d| start.miss(*d) < tolerance).collect();
    let cone = plane_fit(&near).filter(|c| c.half_angle.is_finite()).unwrap_or(start);
    let refined = refine(cone, rays, pixel_rad)
        .ok_or_else(|| ProbeError::NoBall { reason: "the cone fit is degenerate".into() })?;
    judge(refined, rays, tolerance, pixel_rad)
}

#[derive(Clone, Copy)]
struct Cone {
    axis: DVec3,
    half_angle: f64,
}

impl Cone {
    /// The cone through the circle in which the plane with unit normal `n` at height `cos` cuts the
    /// unit sphere.
    fn new(n: DVec3, cos: f64) -> Option<Self> {
        let (n, cos) = if cos < 0.0 { (-n, -cos) } else { (n, cos) };
        let half_angle = cos.clamp(-1.0, 1.0).acos();
        (n.is_finite() && half_angle > 1e-9 && half_angle < 1.55)
            .then_some(Self { axis: n, half_angle })
    }

    /// Angle of `ray` off the axis minus the half-angle. Precise for narrow cones, unlike `acos`.
    fn residual(&self, ray: DVec3) -> f64 {
        self.axis.cross(ray).length().atan2(self.axis.dot(ray)) - self.half_angle
    }

    fn miss(&self, ray: DVec3) -> f64 {
        self.residual(ray).abs()
    }
}

/// RANSAC: the cone through three rays that most others agree with (truncated squares).
fn consensus(rays: &[DVec3], tolerance: f64) -> Option<Cone> {
    let mut random = XorShift(0x9E37_79B9_7F4A_7C15);
    let mut best: Option<(f64, Cone)> = None;
    // 40 % outliers: a triple is clean with 0.216; 400 triples all fail with 1e-42.
    for _ in 0..400 {
        let (a, b, c) = (random.pick(rays), random.pick(rays), random.pick(rays));
        let Some(n) = (b - a).cross(c - a).try_normalize() else { continue };
        let Some(cone) = Cone::new(n, n.dot(a)) else { continue };
        let cost: f64 = rays.iter().map(|&d| (cone.residual(d) / tolerance).powi(2).min(1.0)).sum();
        if best.is_none_or(|(least, _)| cost < least) {
            best = Some((cost, cone));
        }
    }
    best.map(|(_, cone)| cone)
}

/// Plane of least squares through the tips of the rays: smallest singular vector, centred.
fn plane_fit(rays: &[DVec3]) -> Option<Cone> {
    if rays.len() < 3 {
        return None;
    }
    let mean = rays.iter().sum::<DVec3>() / rays.len() as f64;
    let mut scatter = DMat3::ZERO;
    for &ray in rays {
        let d = ray - mean;
        scatter += DMat3::from_cols(d * d.x, d * d.y, d * d.z);
    }
    let eigen = Matrix3::from_column_slice(&scatter.to_cols_array()).symmetric_eigen();
    let n = eigen.eigenvectors.column(eigen.eigenvalues.imin());
    let n = DVec3::new(n[0], n[1], n[2]).try_normalize()?;
    Cone::new(n, n.dot(mean))
}

struct Refined {
    cone: Cone,
    /// `(JᵀWJ)⁻¹`, multiplied by the residual variance: rad².
    covariance: Matrix3<f64>,
}

/// Gauss–Newton on `acos(n·d) − α` with Tukey's weights.
fn refine(mut cone: Cone, rays: &[DVec3], pixel_rad: f64) -> Option<Refined> {
    let mut scale = f64::INFINITY;
    for _ in 0..30 {
        let residuals: Vec<f64> = rays.iter().map(|&d| cone.residual(d)).collect();
        // The scale may only shrink, or a bad start would let the outliers in again.
        scale = scale.min(robust_sigma(&residuals)).max(0.02 * pixel_rad);
        let step = newton_step(&cone, rays, &residuals, scale)?;
        let (e1, e2) = cone.axis.any_orthonormal_pair();
        cone.axis = (cone.axis + e1 * step.0.x + e2 * step.0.y).normalize();
        cone.half_angle += step.0.z;
        if step.0.length() < 1e-13 {
            break;
        }
    }
    if !(cone.half_angle > 0.0 && cone.axis.is_finite()) {
        return None;
    }
    let residuals: Vec<f64> = rays.iter().map(|&d| cone.residual(d)).collect();
    let (_, covariance) = newton_step(&cone, rays, &residuals, scale)?;
    Some(Refined { cone, covariance })
}

/// One step (axis along e1, e2, half-angle) and the covariance at its start.
fn newton_step(
    cone: &Cone,
    rays: &[DVec3],
    residuals: &[f64],
    scale: f64,
) -> Option<(DVec3, Matrix3<f64>)> {
    let (e1, e2) = cone.axis.any_orthonormal_pair();
    let mut normal = Matrix3::<f64>::zeros();
    let mut gradient = nalgebra::Vector3::<f64>::zeros();
    let (mut squares, mut weights, mut squared_weights) = (0.0, 0.0, 0.0);
    for (&ray, &residual) in rays.iter().zip(residuals) {
        let w = tukey(residual / scale);
        if w == 0.0 {
            continue;
        }
        let sideways = (ray - cone.axis * cone.axis.dot(ray)).try_normalize()?;
        let row = nalgebra::Vector3::new(-e1.dot(sideways), -e2.dot(sideways), -1.0);
        normal += w * row * row.transpose();
        gradient += w * residual * row;
        squares += w * residual * residual;
        weights += w;
        squared_weights += w * w;
    }
    // Columns of J are of order one each (a plain circle fit), so no scaling is needed.
    let inverse = normal.try_inverse()?;
    let step = -(inverse * gradient);
    let effective = weights * weights / squared_weights.max(1e-300);
    let variance = squares / weights.max(1e-300) * effective / (effective - 3.0).max(1.0);
    Some((DVec3::new(step[0], step[1], step[2]), inverse * variance * TUKEY_VARIANCE))
}

/// Tukey's biweight with the usual 95 % tuning constant.
fn tukey(scaled: f64) -> f64 {
    let x = scaled / 4.685;
    if x.abs() >= 1.0 { 0.0 } else { (1.0 - x * x).powi(2) }
}

/// From the weighted residual square to the variance of the estimate for Gaussian errors:
/// `E[w²r²]/E[w]²` against `E[wr²]/E[w]`, with the factor 1/0.95 of Tukey's efficiency.
const TUKEY_VARIANCE: f64 = 1.16;

/// Standard deviation from the median of the absolute values.
fn robust_sigma(residuals: &[f64]) -> f64 {
    let mut sorted: Vec<f64> = residuals.iter().map(|r| r.abs()).collect();
    sorted.sort_by(f64::total_cmp);
    sorted[sorted.len() / 2] / 0.6745
}

/// Refuses what is not a rim, and tells the rest's quality.
fn judge(
    fitted: Refined,
    rays: &[DVec3],
    tolerance: f64,
    pixel_rad: f64,
) -> Result<Rim, ProbeError> {
    let cone = fitted.cone;
    let inliers: Vec<DVec3> = rays.iter().copied().filter(|&d| cone.miss(d) < tolerance).collect();
    let inlier_fraction = inliers.len() as f64 / rays.len() as f64;
    if inlier_fraction < MIN_INLIERS {
        return Err(ProbeError::FewInliers {
            found: 100.0 * inlier_fraction,
            needed: 100.0 * MIN_INLIERS,
        });
    }
    let arc_rad = arc(&cone, &inliers);
    if arc_rad < MIN_ARC_RAD {
        return Err(ProbeError::ShortArc { arc_deg: arc_rad.to_degrees() });
    }
    let squares: f64 = inliers.iter().map(|&d| cone.miss(d).powi(2)).sum();
    let floor = (SYSTEMATIC_PX * pixel_rad).powi(2);
    let covariance = fitted.covariance + Matrix3::identity() * floor;
    Ok(Rim {
        axis: cone.axis,
        half_angle_rad: cone.half_angle,
        covariance: covariance.transpose().into(),
        inlier_fraction,
        arc_rad,
        residual_rad: (squares / inliers.len() as f64).sqrt(),
    })
}

/// How much of the cone has inliers: occupied sectors of 5°, radians.
fn arc(cone: &Cone, inliers: &[DVec3]) -> f64 {
    let (e1, e2) = cone.axis.any_orthonormal_pair();
    let mut seen = [false; 72];
    for ray in inliers {
        let turn = ray.dot(e2).atan2(ray.dot(e1)).rem_euclid(2.0 * PI);
        seen[((turn / (2.0 * PI) * 72.0) as usize).min(71)] = true;
    }
    seen.iter().filter(|&&s| s).count() as f64 * 2.0 * PI / 72.0
}

/// Marsaglia's xorshift64: the same triples on every machine.
pub(super) struct XorShift(pub u64);

impl XorShift {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }

    /// In [0, 1).
    #[cfg(test)]
    pub(super) fn uniform(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }

    fn pick(&mut self, rays: &[DVec3]) -> DVec3 {
        rays[(self.next() >> 16) as usize % rays.len()]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One pixel of these tests: R = 300 px.
    const PIXEL: f64 = 0.1 / 300.0;

    fn truth() -> Rim {
        Rim::known(DVec3::new(0.35, -0.2, -1.0), 0.1, 0.0)
    }

    /// A Gaussian deviate, from two uniform ones.
    fn gauss(random: &mut XorShift) -> f64 {
        let mut uniform = || ((random.next() >> 11) as f64 + 0.5) / (1u64 << 53) as f64;
        (-2.0 * uniform().ln()).sqrt() * (2.0 * PI * uniform()).cos()
    }

    /// Rim rays over `arc`, each off the rim by `sigma` px.
    fn rim_rays(n: usize, arc: f64, sigma: f64, random: &mut XorShift) -> Vec<DVec3> {
        let rim = truth();
        (0..n)
            .map(|k| {
                let off = Rim { half_angle_rad: 0.1 + sigma * PIXEL * gauss(random), ..rim };
                off.ray(arc * k as f64 / n as f64)
            })
            .collect()
    }

    #[test]
    fn exact_rays_give_the_exact_cone() {
        for n in [72, 360] {
            let rays = rim_rays(n, 2.0 * PI, 0.0, &mut XorShift(1));
            let rim = fit(&rays, PIXEL, 2.0).unwrap();
            assert!((rim.axis - truth().axis).length() < 1e-12);
            assert!((rim.half_angle_rad - 0.1).abs() < 1e-12);
            assert_eq!(rim.inlier_fraction, 1.0);
        }
    }

    /// 200 fits of 360 points with σ = 0.3 px (seeds 1…200). The mean of `(error/σ)²` over three
    /// parameters is χ²(600)/600: outside [0.8, 1.25] with probability below 1e-3.
    #[test]
    fn predicted_sigma_covers_the_scatter() {
        let mut sum = 0.0;
        for seed in 1..=200 {
            let mut random = XorShift(0x1234_5678_9ABC_DEF1 ^ (seed << 20));
            let rays = rim_rays(360, 2.0 * PI, 0.3, &mut random);
            let rim = fit(&rays, PIXEL, 2.0).unwrap();
            let (e1, e2) = rim.tangents();
            let error = DVec3::new(
                e1.dot(truth().axis - rim.axis),
                e2.dot(truth().axis - rim.axis),
                0.1 - rim.half_angle_rad,
            );
            // Only the statistical part: these points have no systematic error.
            for k in 0..3 {
                let floor = (SYSTEMATIC_PX * PIXEL).powi(2);
                sum += error[k] * error[k] / (rim.covariance[k][k] - floor) / 600.0;
            }
        }
        assert!(sum > 0.8 && sum < 1.25, "mean of (error/σ)² is {sum}");
    }

    /// methods-capture C4: axis error 0.03 px for a full circle at σ = 0.3 px, 0.19 px for 90°.
    #[test]
    fn axis_error_is_as_measured_before() {
        for (arc, expected) in [(2.0 * PI, 0.03), (PI, 0.053), (PI / 2.0, 0.19)] {
            let mut squares = 0.0;
            for seed in 1..=40 {
                let rays = rim_rays(360, arc, 0.3, &mut XorShift(seed * 0x9E37_79B9));
                let error = fit(&rays, PIXEL, 2.0).unwrap().axis - truth().axis;
                squares += (error.length() / PIXEL).powi(2) / 40.0;
            }
            let rms = squares.sqrt();
            assert!(rms < 1.6 * expected && rms > 0.4 * expected, "arc {arc}: {rms} px");
        }
    }

    #[test]
    fn a_third_of_one_sided_outliers_does_no_harm() {
        let mut random = XorShift(77);
        let mut rays = rim_rays(360, 2.0 * PI, 0.3, &mut random);
        // A reflected horizon: 108 neighbours lie 20 px further in.
        let inner = Rim { half_angle_rad: 0.1 - 20.0 * PIXEL, ..truth() };
        for (k, ray) in rays.iter_mut().enumerate().take(108) {
            *ray = inner.ray(2.0 * PI * k as f64 / 360.0);
        }
        let rim = fit(&rays, PIXEL, 2.0).unwrap();
        assert!((rim.axis - truth().axis).length() < 0.15 * PIXEL);
        assert!((rim.inlier_fraction - 0.7).abs() < 0.02);
    }

    #[test]
    fn half_the_points_elsewhere_is_refused() {
        let mut rays = rim_rays(360, 2.0 * PI, 0.3, &mut XorShift(5));
        for (k, ray) in rays.iter_mut().enumerate().take(180) {
            let other = Rim::known(DVec3::new(0.36, -0.19, -1.0), 0.08, 0.0);
            *ray = other.ray(k as f64);
        }
        assert!(matches!(fit(&rays, PIXEL, 2.0), Err(ProbeError::FewInliers { .. })));
    }

    #[test]
    fn short_arcs_and_few_points_are_refused() {
        let rays = rim_rays(200, 40f64.to_radians(), 0.1, &mut XorShift(9));
        assert!(matches!(fit(&rays, PIXEL, 2.0), Err(ProbeError::ShortArc { .. })));
        assert!(matches!(fit(&rays[..5], PIXEL, 2.0), Err(ProbeError::NoBall { .. })));
        assert!(fit(&[DVec3::NEG_Z; 50], PIXEL, 2.0).is_err());
        assert!(fit(&[DVec3::NAN; 50], PIXEL, 2.0).is_err());
    }

    /// methods-capture F22: fitting the cone is exact where the circle's centre is 17 px off.
    #[test]
    fn picture_circle_misses_the_axis_at_25_degrees() {
        let axis = DVec3::new(25f64.to_radians().sin(), 0.0, -25f64.to_radians().cos());
        let rim = Rim::known(axis, 0.1, 0.0);
        // Focal length at which the ball's radius is about 300 px there.
        let focal = 300.0 / (0.1 / axis.z.powi(2));
        let rays: Vec<DVec3> = (0..360).map(|k| rim.ray(f64::to_radians(k as f64))).collect();
        let across: Vec<f64> = rays.iter().map(|d| focal * d.x / -d.z).collect();
        let ends = |f: fn(f64, f64) -> f64| across.iter().copied().reduce(f).unwrap();
        let centre = (ends(f64::min) + ends(f64::max)) / 2.0;
        let naive = (centre - focal * axis.x / -axis.z).abs();
        assert!(naive > 10.0, "the circle's centre is {naive} px off");
        let fitted = fit(&rays, PIXEL, 2.0).unwrap();
        assert!((fitted.axis - axis).length() < 1e-12);
    }
}
