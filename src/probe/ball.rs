//! A mirror ball in front of a camera: exact perspective reflection.
//!
//! In the plane of the ball's centre, the camera and the mirrored direction, with D the distance
//! of the centre and ρ the radius: the pixel ray meets the ball where the normal stands at φ from
//! the way back to the camera, the ray itself lies β off the axis, and the mirrored direction at
//! `θ = 2φ + β, β = atan2(ρ sin φ, D − ρ cos φ)` from the way back. θ ends at π − α, sin α = ρ/D:
//! the cone of half-angle α behind the ball is never seen. The common orthographic formula
//! `θ = 2 asin s` is the limit D → ∞; at D = 10 ρ it is 4° wrong, so it exists only in the tests.
//! Only ρ/D matters for directions; metres matter only for where the mirrored ray starts.

use std::f64::consts::{FRAC_PI_2, PI};

use glam::DVec3;

use super::ProbeError;
use crate::conventions::Rgb;

/// A mirror ball as it stands in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ball {
    /// Centre in the world, metres.
    pub centre: DVec3,
    /// Radius, metres.
    pub radius: f64,
    /// Share of light that the ball gives back, per channel.
    pub reflectance: Rgb,
}

/// Radii of mirror balls, from a bead to a dome, m.
const RADII_M: std::ops::RangeInclusive<f64> = 1e-4..=100.0;

impl Ball {
    /// A ball of finite place, a radius that balls have and reflectance in (0, 1].
    pub fn new(centre: DVec3, radius: f64, reflectance: Rgb) -> Result<Self, ProbeError> {
        if !centre.is_finite() {
            let found = format!("{centre}");
            return Err(ProbeError::Value {
                what: "ball.at",
                found,
                expected: "a place in metres",
            });
        }
        if !RADII_M.contains(&radius) {
            let found = format!("{radius:?}");
            return Err(ProbeError::Value {
                what: "ball.radius",
                found,
                expected: "a length between 0.1 mm and 100 m, in metres",
            });
        }
        let share = |r: f32| r > 0.0 && r <= 1.0;
        if !reflectance.to_array().into_iter().all(share) {
            let found = format!("{reflectance}");
            return Err(ProbeError::Value {
                what: "ball.reflectance",
                found,
                expected: "three numbers above 0 and up to 1",
            });
        }
        Ok(Self { centre, radius, reflectance })
    }
}

/// A mirroring sphere seen by a camera at the origin; axes are whatever `centre` is given in.
///
/// # Guarantees
/// The camera is outside the sphere: `0 < radius < centre.length()`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mirror {
    centre: DVec3,
    radius: f64,
}

/// What the ball shows along one camera ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reflection {
    /// Where the ray meets the ball; the mirrored ray starts here.
    pub point: DVec3,
    /// Unit normal there, outwards.
    pub normal: DVec3,
    /// Unit direction in which the ball shows the world.
    pub direction: DVec3,
}

impl Mirror {
    /// `None` unless the origin is outside the sphere and all is finite.
    pub fn new(centre: DVec3, radius: f64) -> Option<Self> {
        let outside = radius > 0.0 && centre.is_finite() && centre.length() > radius;
        outside.then_some(Self { centre, radius })
    }

    /// The ball of `radius` whose rim is the cone of `half_angle_rad` round `axis`.
    pub fn from_rim(axis: DVec3, half_angle_rad: f64, radius: f64) -> Option<Self> {
        let distance = radius / half_angle_rad.sin();
        Self::new(axis.try_normalize()? * distance, radius)
    }

    pub fn centre(&self) -> DVec3 {
        self.centre
    }

    pub fn radius(&self) -> f64 {
        self.radius
    }

    /// Unit direction from the camera to the centre.
    pub fn axis(&self) -> DVec3 {
        self.centre.normalize()
    }

    pub fn distance(&self) -> f64 {
        self.centre.length()
    }

    /// Half-angle α of the rim's cone, and of the blind cone behind the ball, radians.
    pub fn half_angle(&self) -> f64 {
        (self.radius / self.distance()).asin()
    }

    /// What the ball shows along the camera ray `ray` (unit); `None` where the ray misses it.
    pub fn reflect(&self, ray: DVec3) -> Option<Reflection> {
        let b = ray.dot(self.centre);
        // The cross product keeps its digits for a far ball, where b² − D² loses them all.
        let half_chord = self.radius * self.radius - ray.cross(self.centre).length_squared();
        if b <= 0.0 || half_chord < 0.0 {
            return None;
        }
        let point = (b - half_chord.sqrt()) * ray;
        let normal = (point - self.centre) / self.radius;
        let direction = (ray - 2.0 * ray.dot(normal) * normal).normalize();
        Some(Reflection { point, normal, direction })
    }

    /// The unit camera ray along which the ball shows `direction` (unit).
    ///
    /// `None` in the blind cone behind the ball. Inverse of [`Mirror::reflect`] to 1e-12.
    pub fn ray_showing(&self, direction: DVec3) -> Option<DVec3> {
        let axis = self.axis();
        let back = -axis;
        let sideways = direction - direction.dot(back) * back;
        let theta = sideways.length().atan2(direction.dot(back));
        let phi = self.normal_angle(theta)?;
        // Straight back the plane of reflection is undefined, and not needed.
        let across = sideways.try_normalize().unwrap_or(back.any_orthonormal_vector());
        let beta = self.ray_angle(phi);
        Some(axis * beta.cos() + across * beta.sin())
    }

    /// Unit camera ray to the point of the ball that mirrors the world point `target` (camera axes).
    ///
    /// Where a thing is near, its direction from the ball's surface is not its direction from the
    /// centre; this solves Alhazen's problem for its true place. `None` if it is inside or hidden.
    pub fn ray_to_point(&self, target: DVec3) -> Option<DVec3> {
        let from_centre = target - self.centre;
        let distance = from_centre.length();
        if distance <= self.radius {
            return None;
        }
        let back = -self.axis();
        let along = from_centre.dot(back);
        let sideways = from_centre - along * back;
        let across = sideways.try_normalize().unwrap_or(back.any_orthonormal_vector());
        let target_angle = sideways.length().atan2(along);
        // In the plane: the normal at φ halves the angle between the ways to camera and target.
        // The miss grows strictly with φ, so bisection cannot fail; it is left when exact.
        let (mut low, mut high) = (0.0, FRAC_PI_2 - self.half_angle());
        let miss = |phi: f64| {
            let beta = self.ray_angle(phi);
            let mirrored = 2.0 * phi + beta;
            let (px, py) = (self.radius * phi.cos(), self.radius * phi.sin());
            let (tx, ty) = (distance * target_angle.cos(), distance * target_angle.sin());
            let wanted = (ty - py).atan2(tx - px);
            // Below −π/2 the target lies past the half turn.
            mirrored - if wanted < -FRAC_PI_2 { wanted + 2.0 * PI } else { wanted }
        };
        if miss(high) < 0.0 {
            return None;
        }
        while high - low > 1e-13 {
            let middle = 0.5 * (low + high);
            if middle <= low || middle >= high {
                break;
            }
            if miss(middle) < 0.0 { low = middle } else { high = middle }
        }
        let beta = self.ray_angle(0.5 * (low + high));
        Some(-back * beta.cos() + across * beta.sin())
    }

    /// Solid angle that the ball shows per solid angle of camera rays, at the unit ray `ray`.
    ///
    /// `dω/dΩ = sin θ · (dθ/dφ) / (sin β · (dβ/dφ))`; infinite at the rim, `None` off the ball.
    pub fn spread(&self, ray: DVec3) -> Option<f64> {
        let reflection = self.reflect(ray)?;
        let axis = self.axis();
        let phi = {
            let along = -reflection.normal.dot(axis);
            (reflection.normal + along * axis).length().atan2(along)
        };
        let beta = self.ray_angle(phi);
        let beta_rate = self.ray_angle_rate(phi);
        let theta_rate = 2.0 + beta_rate;
        // On the axis both sines vanish and their ratio is that of the rates.
        if phi < 1e-6 {
            return Some((theta_rate / beta_rate).powi(2));
        }
        let theta = 2.0 * phi + beta;
        Some(theta.sin() / beta.sin() * theta_rate / beta_rate)
    }

    /// Angle of camera rays per angle of directions shown, away from the axis: `dβ/dθ` at `direction` (unit).
    ///
    /// `½ α cos(θ/2)` for a far ball: half as many pixels to a degree at 120° as at the camera, none at the
    /// rim. Zero in the blind cone.
    pub fn ray_rate(&self, direction: DVec3) -> f64 {
        let back = -self.axis();
        let theta = direction.cross(back).length().atan2(direction.dot(back));
        self.normal_angle(theta).map_or(0.0, |phi| {
            let rate = self.ray_angle_rate(phi);
            (rate / (2.0 + rate)).max(0.0)
        })
    }

    /// Angle of the pixel ray off the axis where the normal stands at `phi`.
    fn ray_angle(&self, phi: f64) -> f64 {
        (self.radius * phi.sin()).atan2(self.distance() - self.radius * phi.cos())
    }

    /// Derivative of [`Mirror::ray_angle`].
    fn ray_angle_rate(&self, phi: f64) -> f64 {
        let (d, r) = (self.distance(), self.radius);
        r * (d * phi.cos() - r) / (d * d + r * r - 2.0 * d * r * phi.cos())
    }

    /// φ at which the mirrored direction stands at `theta` from the way back: Newton's method.
    fn normal_angle(&self, theta: f64) -> Option<f64> {
        let last = FRAC_PI_2 - self.half_angle();
        if theta > PI - self.half_angle() {
            return None;
        }
        let mut phi = theta / (2.0 + self.radius / (self.distance() - self.radius));
        for _ in 0..20 {
            let step = (2.0 * phi + self.ray_angle(phi) - theta) / (2.0 + self.ray_angle_rate(phi));
            phi = (phi - step).clamp(0.0, last);
            if step.abs() < 1e-15 {
                break;
            }
        }
        Some(phi)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ball at D/ρ = `ratio` off to the side.
    fn mirror(ratio: f64) -> Mirror {
        Mirror::new(DVec3::new(0.3, -0.2, -0.93).normalize() * ratio * 0.06, 0.06).unwrap()
    }

    /// Unit ray `beta` off the axis of `mirror`, turned by `turn` round it.
    fn ray(mirror: &Mirror, beta: f64, turn: f64) -> DVec3 {
        let (e1, e2) = mirror.axis().any_orthonormal_pair();
        mirror.axis() * beta.cos() + (e1 * turn.cos() + e2 * turn.sin()) * beta.sin()
    }

    #[test]
    fn direction_and_ray_invert_each_other() {
        for ratio in [1.5, 3.0, 10.0, 30.0, 1000.0] {
            let mirror = mirror(ratio);
            for k in 0..200 {
                let beta = mirror.half_angle() * (k as f64 / 200.0) * 0.999;
                let there = ray(&mirror, beta, k as f64);
                let back = mirror.ray_showing(mirror.reflect(there).unwrap().direction).unwrap();
                assert!((back - there).length() < 1e-12, "D/ρ {ratio}, k {k}: {back} {there}");
            }
        }
    }

    #[test]
    fn facing_point_shows_the_camera_and_the_rim_shows_past_the_ball() {
        let mirror = mirror(10.0);
        let facing = mirror.reflect(mirror.axis()).unwrap();
        assert!((facing.direction + mirror.axis()).length() < 1e-14);
        assert!((facing.point - mirror.axis() * (0.6 - 0.06)).length() < 1e-14);
        let rim = ray(&mirror, mirror.half_angle() - 1e-12, 2.0);
        assert!(mirror.reflect(rim).unwrap().direction.angle_between(rim) < 1e-4);
        assert!(mirror.reflect(ray(&mirror, mirror.half_angle() + 1e-9, 2.0)).is_none());
        assert!(mirror.reflect(-mirror.axis()).is_none());
        assert!(mirror.ray_showing(mirror.axis()).is_none());
    }

    #[test]
    fn law_of_reflection_holds() {
        let mirror = mirror(4.0);
        for k in 0..50 {
            let there = ray(&mirror, mirror.half_angle() * k as f64 / 51.0, 0.7 * k as f64);
            let r = mirror.reflect(there).unwrap();
            assert!((r.direction.dot(r.normal) + there.dot(r.normal)).abs() < 1e-14);
            assert!(r.direction.cross(there).dot(r.normal).abs() < 1e-14);
            assert!(((r.point - mirror.centre()).length() - 0.06).abs() < 1e-15);
        }
    }

    #[test]
    fn far_ball_is_the_orthographic_formula() {
        let mirror = Mirror::new(DVec3::NEG_Z * 1e6, 1.0).unwrap();
        for k in 1..20 {
            let s = k as f64 / 20.0;
            let beta = (s / 1e6).asin();
            let r = mirror.reflect(DVec3::new(beta.sin(), 0.0, -beta.cos())).unwrap();
            let theta = r.direction.angle_between(DVec3::Z);
            assert!((theta - 2.0 * s.asin()).abs() < 3e-6);
        }
    }

    /// methods-capture F23: at D/ρ = 10 the orthographic formula is 3.9° rms wrong.
    #[test]
    fn orthographic_formula_is_four_degrees_off_near_the_ball() {
        let mirror = Mirror::new(DVec3::NEG_Z * 10.0, 1.0).unwrap();
        let (mut sum, mut weight) = (0.0_f64, 0.0_f64);
        for k in 0..2000 {
            let theta = (PI - mirror.half_angle()) * (k as f64 + 0.5) / 2000.0;
            let direction = DVec3::new(theta.sin(), 0.0, theta.cos());
            let ray = mirror.ray_showing(direction).unwrap();
            // s: distance from the ball's centre in the picture, over the rim's radius.
            let s = (ray.x / -ray.z) / mirror.half_angle().tan();
            sum += (2.0 * s.asin() - theta).to_degrees().powi(2) * theta.sin();
            weight += theta.sin();
        }
        let rms = (sum / weight).sqrt();
        assert!((rms - 3.95).abs() < 0.05, "rms {rms}°");
    }

    #[test]
    fn spread_adds_up_to_all_directions_but_the_blind_cone() {
        for ratio in [3.0, 10.0, 30.0] {
            let mirror = mirror(ratio);
            let (alpha, n) = (mirror.half_angle(), 4000);
            // ∫ spread dΩ over the ball; β = α sin u takes the singularity at the rim away.
            let sum: f64 = (0..n)
                .map(|k| {
                    let u = FRAC_PI_2 * (k as f64 + 0.5) / n as f64;
                    let beta = alpha * u.sin();
                    let rate = alpha * u.cos() * FRAC_PI_2 / n as f64;
                    2.0 * PI * mirror.spread(ray(&mirror, beta, 1.0)).unwrap() * beta.sin() * rate
                })
                .sum();
            let expected = 2.0 * PI * (1.0 + alpha.cos());
            assert!((sum / expected - 1.0).abs() < 1e-4, "D/ρ {ratio}: {sum} {expected}");
        }
    }

    /// methods-capture A4: dω/dA = 4/R² everywhere on an orthographic ball.
    #[test]
    fn far_ball_spreads_evenly() {
        let mirror = Mirror::new(DVec3::NEG_Z * 1e6, 1.0).unwrap();
        for s in [0.0, 0.3, 0.6, 0.9] {
            let beta = f64::asin(s / 1e6);
            let spread = mirror.spread(DVec3::new(beta.sin(), 0.0, -beta.cos())).unwrap();
            assert!((spread * 1e-12 - 4.0).abs() < 2e-5, "{s}: {}", spread * 1e-12);
        }
    }

    /// methods-capture C4: R = 500 px shows 4.4 px/° facing, 2.2 at 120°, 1.1 at 150°, 0.38 at 170°.
    #[test]
    fn radial_resolution_falls_towards_the_rim() {
        let mirror = Mirror::new(DVec3::NEG_Z * 1e6, 1.0).unwrap();
        for (theta_deg, expected) in [(0.0, 4.36), (120.0, 2.18), (150.0, 1.13), (170.0, 0.38)] {
            let theta = f64::to_radians(theta_deg);
            let shown = DVec3::new(theta.sin(), 0.0, theta.cos());
            let px_per_deg = 500.0 * 1e6 * mirror.ray_rate(shown) * PI / 180.0;
            assert!((px_per_deg - expected).abs() < 0.005, "{theta_deg}°: {px_per_deg}");
        }
        // It is the derivative of the mapping, at a near ball too.
        let near = self::mirror(4.0);
        let (e1, _) = near.axis().any_orthonormal_pair();
        let shown = |theta: f64| -near.axis() * theta.cos() + e1 * theta.sin();
        let beta = |theta: f64| near.ray_showing(shown(theta)).unwrap().angle_between(near.axis());
        for theta in [0.3, 1.5, 2.5] {
            let slope = (beta(theta + 1e-4) - beta(theta - 1e-4)) / 2e-4;
            assert!((near.ray_rate(shown(theta)) / slope - 1.0).abs() < 1e-6, "{theta}");
        }
        assert_eq!(near.ray_rate(near.axis()), 0.0);
    }

    #[test]
    fn near_point_is_seen_along_its_own_reflection() {
        let mirror = mirror(10.0);
        for k in 0..300 {
            let there = ray(&mirror, mirror.half_angle() * (k as f64 / 300.0) * 0.99, k as f64);
            let r = mirror.reflect(there).unwrap();
            for distance in [0.01, 0.1, 10.0] {
                let back = mirror.ray_to_point(r.point + r.direction * distance).unwrap();
                assert!((back - there).length() < 1e-9, "k {k}, {distance} m: {back} {there}");
            }
        }
        assert!(mirror.ray_to_point(mirror.centre()).is_none());
        assert!(mirror.ray_to_point(mirror.centre() * 3.0).is_none());
    }

    #[test]
    fn camera_inside_the_ball_is_no_mirror() {
        assert!(Mirror::new(DVec3::new(0.0, 0.0, -0.05), 0.06).is_none());
        assert!(Mirror::new(DVec3::NAN, 0.06).is_none());
        assert!(Mirror::new(DVec3::NEG_Z, f64::NAN).is_none());
        assert!(Ball::new(DVec3::ZERO, -1.0, Rgb::ONE).is_err());
        assert!(Ball::new(DVec3::ZERO, 1.0, Rgb::new(0.5, f32::NAN, 0.5)).is_err());
    }
}
