//! Lamps near the objects: spheres of one radiance, at their true place.
//!
//! A lamp is light added along a ray, not a body: it hides nothing, because what was seen beside it
//! fills its place in the panorama and its own radiance is what it shows above that. A thing before it
//! blocks it, a thing behind it does not.
//! Seen from x, a sphere of radius R at distance d fills a cap of sin α = R/d, in which directions are
//! drawn uniformly. Its irradiance, cut by the horizon or not, is a closed form (methods-render R4.2).

use std::f32::consts::{PI, TAU};

use glam::{DVec2, Vec3};

use super::LightSample;
use crate::conventions::{Rgb, cap_height};

/// A round lamp of one radiance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lamp {
    /// Relative to the scene's origin, metres.
    pub centre: Vec3,
    /// Metres, above 0.
    pub radius: f32,
    /// Above that of its surroundings, which fill its place in the panorama.
    pub radiance: Rgb,
}

/// A lamp on a ray.
#[derive(Clone, Copy, Debug)]
pub struct LampHit {
    /// To the near side of the sphere, metres.
    pub distance: f32,
    pub radiance: Rgb,
    /// Density per steradian with which the lamps' stratum draws this lamp in this direction.
    pub pdf: f32,
}

/// What a lamp looks like from a place outside it.
struct View {
    axis: Vec3,
    distance: f32,
    /// 1 − cos α, without cancellation.
    height: f32,
}

impl View {
    fn solid_angle(&self) -> f32 {
        TAU * self.height
    }
}

impl Lamp {
    /// `None` from inside.
    fn view(&self, from: Vec3) -> Option<View> {
        let to = self.centre - from;
        let (distance2, radius2) = (to.length_squared(), self.radius * self.radius);
        if distance2 <= radius2 {
            return None;
        }
        let (distance, sin2) = (distance2.sqrt(), radius2 / distance2);
        Some(View { axis: to / distance, distance, height: cap_height(sin2) })
    }

    /// Solid angle seen from a place, sr; 0 from inside.
    pub fn solid_angle(&self, from: Vec3) -> f32 {
        self.view(from).map_or(0.0, |view| view.solid_angle())
    }

    /// Distance at which a ray from outside meets the sphere.
    fn meets(&self, from: Vec3, direction: Vec3) -> Option<f32> {
        let to = self.centre - from;
        let along = to.dot(direction);
        let beside2 = (to - along * direction).length_squared();
        let radius2 = self.radius * self.radius;
        if along <= 0.0 || beside2 > radius2 || to.length_squared() <= radius2 {
            return None;
        }
        Some(along - (radius2 - beside2).sqrt())
    }

    /// Irradiance of an unoccluded plane at `from` with unit `normal`; what lies below its horizon is
    /// cut off. 0 from inside.
    pub fn irradiance(&self, from: Vec3, normal: Vec3) -> Rgb {
        let to = (self.centre - from).as_dvec3();
        let distance = to.length();
        let radius = f64::from(self.radius);
        if distance <= radius {
            return Rgb::ZERO;
        }
        let sin = radius / distance;
        let cos_beta = normal.as_dvec3().dot(to) / distance;
        let factor = if cos_beta >= sin {
            sin * sin * cos_beta
        } else if cos_beta <= -sin {
            0.0
        } else {
            let sin_beta = (1.0 - cos_beta * cos_beta).sqrt();
            let h2 = 1.0 / (sin * sin);
            let x = (h2 - 1.0).sqrt();
            let y = (-x * cos_beta / sin_beta).clamp(-1.0, 1.0);
            let root = (1.0 - y * y).sqrt();
            let sum =
                (cos_beta * y.acos() - x * sin_beta * root) / h2 + (sin_beta * root / x).atan();
            (sum / std::f64::consts::PI).max(0.0)
        };
        self.radiance * (PI * factor as f32)
    }

    /// What a draw is worth from a place: solid angle × strongest channel.
    fn strength(&self, from: Vec3) -> f32 {
        self.solid_angle(from) * self.radiance.max_element()
    }
}

/// Draws a lamp by what it is worth at `from`, and a direction in its cap; `u` in [0, 1)².
pub(super) fn sample(lamps: &[Lamp], from: Vec3, u: DVec2) -> Option<LightSample> {
    let total: f32 = lamps.iter().map(|lamp| lamp.strength(from)).sum();
    if total <= 0.0 {
        return None;
    }
    // Which lamp, and where in its share the number lies
    let mut rest = u.x as f32 * total;
    let mut chosen = None;
    for lamp in lamps {
        let share = lamp.strength(from);
        if share <= 0.0 {
            continue;
        }
        chosen = Some((lamp, share, (rest / share).clamp(0.0, 1.0)));
        if rest < share {
            break;
        }
        rest -= share;
    }
    let (lamp, share, inside) = chosen?;
    let view = lamp.view(from)?;
    let below = u.y as f32 * view.height;
    let sin = (below * (2.0 - below)).max(0.0).sqrt();
    let (s, c) = (TAU * inside).sin_cos();
    let (tangent, bitangent) = view.axis.any_orthonormal_pair();
    let direction = (view.axis * (1.0 - below) + (tangent * c + bitangent * s) * sin).normalize();
    // At the rim rounding may say that the ray passes: the tangent's length is the limit.
    let tangent = (view.distance * view.distance - lamp.radius * lamp.radius).max(0.0).sqrt();
    Some(LightSample {
        direction,
        distance: lamp.meets(from, direction).unwrap_or(tangent),
        radiance: lamp.radiance,
        pdf: share / total / view.solid_angle(),
    })
}

/// The lamps that a ray meets, in no order.
pub(super) fn on_ray(
    lamps: &[Lamp],
    from: Vec3,
    direction: Vec3,
) -> impl Iterator<Item = LampHit> + '_ {
    lamps.iter().filter_map(move |lamp| {
        let distance = lamp.meets(from, direction)?;
        let total: f32 = lamps.iter().map(|lamp| lamp.strength(from)).sum();
        // share / Ω, where the share is Ω × strongest channel.
        let pdf = if total > 0.0 { lamp.radiance.max_element() / total } else { 0.0 };
        Some(LampHit { distance, radiance: lamp.radiance, pdf })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lamp(centre: Vec3, radius: f32) -> Lamp {
        Lamp { centre, radius, radiance: Rgb::new(3.0, 2.0, 1.0) }
    }

    #[test]
    fn irradiance_is_the_sphere_s_form_factor() {
        // π L (r/d)² cosθ above the horizon.
        let high = lamp(Vec3::new(0.3, 0.4, 0.0), 0.05).irradiance(Vec3::ZERO, Vec3::Y);
        assert!((high.x / (PI * 3.0 * 0.01 * 0.8) - 1.0).abs() < 1e-5, "{high}");
        // R4.2's table: radius, height of the centre, distance along the plane.
        for (r, h, d, factor) in [
            (1.0, 0.5, 1.5, 0.141_044),
            (1.0, 0.0, 2.0, 0.028_834),
            (1.0, 0.9, 1.0, 0.370_448),
            (1.0, -0.3, 1.5, 0.033_510),
        ] {
            let cut = lamp(Vec3::new(d, h, 0.0), r).irradiance(Vec3::ZERO, Vec3::Y).z / PI;
            assert!((cut - factor).abs() < 2e-6, "{cut} for {factor}");
        }
        let inside = lamp(Vec3::Y * 0.01, 0.05);
        assert_eq!(inside.irradiance(Vec3::ZERO, Vec3::Y), Rgb::ZERO);
        assert_eq!(lamp(-Vec3::Y, 0.05).irradiance(Vec3::ZERO, Vec3::Y), Rgb::ZERO);
    }

    #[test]
    fn draws_estimate_the_irradiance_of_all_lamps_and_know_their_density() {
        let lamps = [
            lamp(Vec3::new(0.3, 0.4, 0.0), 0.1),
            lamp(Vec3::new(-0.5, 0.02, 0.2), 0.05),
            lamp(Vec3::new(0.0, -0.5, 0.2), 0.2),
            // The first one's light lies on the way to this one's.
            lamp(Vec3::new(0.6, 0.8, 0.0), 0.15),
        ];
        let exact: Rgb = lamps.iter().map(|l| l.irradiance(Vec3::ZERO, Vec3::Y)).sum();
        let n = 40_000;
        let mut sum = Vec3::ZERO;
        for k in 0..n {
            let u = DVec2::new(
                (f64::from(k) * 0.754_877_666).fract(),
                (f64::from(k) * 0.569_840_29).fract(),
            );
            let draw = sample(&lamps, Vec3::ZERO, u).unwrap();
            let same = |hit: &LampHit| (hit.distance / draw.distance - 1.0).abs() < 1e-2;
            if let Some(hit) = on_ray(&lamps, Vec3::ZERO, draw.direction).find(same) {
                assert!((hit.pdf / draw.pdf - 1.0).abs() < 1e-4, "{hit:?} {draw:?}");
            }
            sum += draw.radiance * draw.direction.y.max(0.0) / draw.pdf / n as f32;
        }
        // A rank-1 lattice over four smooth pieces, one cut by the horizon: far below 0.3 %.
        assert!((sum / exact - 1.0).abs().max_element() < 3e-3, "{sum} for {exact}");
    }

    #[test]
    fn a_ray_away_from_a_lamp_or_from_inside_it_meets_nothing() {
        let one = [lamp(Vec3::Y, 0.2)];
        assert_eq!(on_ray(&one, Vec3::ZERO, Vec3::NEG_Y).count(), 0);
        assert_eq!(on_ray(&one, Vec3::Y, Vec3::X).count(), 0);
        assert!(sample(&one, Vec3::Y, DVec2::splat(0.5)).is_none());
        let hit = on_ray(&one, Vec3::ZERO, Vec3::Y).next().unwrap();
        assert!((hit.distance - 0.8).abs() < 1e-6);
    }
}
