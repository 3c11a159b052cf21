//! Sampling toward the objects: caps that hold them, as seen from a point.
//!
//! Mixture Σ q_k / Ω_k over balls around parts of the objects (methods-render R2.4), with q_k in
//! proportion to what a ball can block of a surface's sky. A ball that holds the point itself has no
//! cap: its share stays with the BSDF.

use std::f32::consts::{PI, TAU};

use glam::{Vec2, Vec3};

use super::world::PartBall;
use crate::conventions::cap_height;

const MOST: usize = 16;

#[derive(Clone, Copy)]
struct Cap {
    axis: Vec3,
    /// 1 − cos of the half angle, without cancellation.
    height: f32,
    sin: f32,
    cos: f32,
    /// q_k / Ω_k
    density: f32,
    /// Sum of q up to and including this cap.
    end: f32,
}

impl Cap {
    fn holds(&self, direction: Vec3) -> bool {
        (direction - self.axis).length_squared() <= 2.0 * self.height
    }
}

/// The caps of one point.
pub struct Cones {
    caps: [Cap; MOST],
    n: usize,
    /// Probability that a draw comes from a cap, the rest is the BSDF's.
    share: f32,
    /// False if every ball lies wholly below the surface's horizon.
    above: bool,
    /// The point lies in a ball: objects may stand in any direction.
    inside: bool,
}

impl Cones {
    /// Caps of `parts` over a surface at `x` with unit `normal`; they get at most `share` of the draws.
    pub fn new(parts: &[PartBall], x: Vec3, normal: Vec3, share: f32) -> Self {
        let empty = Cap { axis: Vec3::Y, height: 0.0, sin: 0.0, cos: 1.0, density: 0.0, end: 0.0 };
        let mut cones = Self { caps: [empty; MOST], n: 0, share: 0.0, above: false, inside: false };
        let (mut sum, mut inside) = (0.0, 0.0);
        for part in parts.iter().take(MOST) {
            let to = part.centre - x;
            let (distance2, radius2) = (to.length_squared(), part.radius * part.radius);
            if distance2 <= radius2 * 1.0001 {
                inside += 1.0;
                (cones.above, cones.inside) = (true, true);
                continue;
            }
            let distance = distance2.sqrt();
            let sin2 = radius2 / distance2;
            let (sin, axis) = (sin2.sqrt(), to / distance);
            let elevation = normal.dot(axis);
            if elevation <= -sin {
                continue;
            }
            cones.above = true;
            let weight = sin2 * (elevation + 0.5 * sin).max(0.05 * sin);
            let height = cap_height(sin2);
            sum += weight;
            cones.caps[cones.n] = Cap {
                axis,
                height,
                sin,
                cos: 1.0 - height,
                density: weight / (TAU * height),
                end: sum,
            };
            cones.n += 1;
        }
        if sum > 0.0 {
            cones.share = share * sum / (sum + inside * sum.max(PI / 4.0));
            let scale = cones.share / sum;
            for cap in &mut cones.caps[..cones.n] {
                cap.density *= scale;
                cap.end *= scale;
            }
        }
        cones
    }

    /// Caps that are never drawn from.
    pub fn none() -> Self {
        Self::new(&[], Vec3::ZERO, Vec3::Y, 0.0)
    }

    pub fn share(&self) -> f32 {
        self.share
    }

    /// False if no object can be above the horizon of the point.
    pub fn any_above(&self) -> bool {
        self.above
    }

    /// False if no object stands in `direction`.
    pub fn may_meet(&self, direction: Vec3) -> bool {
        self.inside || self.caps[..self.n].iter().any(|cap| cap.holds(direction))
    }

    /// False if no object stands in any direction of a cap; a cap wider than a half sphere has
    /// cosine −∞.
    pub fn may_meet_cap(&self, direction: Vec3, sin: f32, cos: f32) -> bool {
        self.inside
            || self.caps[..self.n]
                .iter()
                .any(|cap| direction.dot(cap.axis) >= cap.cos * cos - cap.sin * sin - 1e-6)
    }

    /// Density per steradian of drawing `direction` from a cap, times the caps' share.
    pub fn pdf(&self, direction: Vec3) -> f32 {
        self.caps[..self.n].iter().filter(|cap| cap.holds(direction)).map(|cap| cap.density).sum()
    }

    /// A direction from the caps; `choice` in [0, share).
    pub fn sample(&self, u: Vec2, choice: f32) -> Option<Vec3> {
        let cap = self.caps[..self.n].iter().find(|cap| choice < cap.end)?;
        let below = u.y * cap.height;
        let sin = (below * (2.0 - below)).max(0.0).sqrt();
        let (s, c) = (TAU * u.x).sin_cos();
        let (tangent, bitangent) = cap.axis.any_orthonormal_pair();
        Some((cap.axis * (1.0 - below) + (tangent * c + bitangent * s) * sin).normalize())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::sampler::{Numbers, Purpose, Sampler};

    #[test]
    fn draws_follow_the_density_of_overlapping_caps() {
        let parts = [
            PartBall { centre: Vec3::new(0.0, 2.0, 0.0), radius: 1.0 },
            PartBall { centre: Vec3::new(1.0, 2.0, 0.0), radius: 0.8 },
            PartBall { centre: Vec3::new(0.0, 0.1, 0.0), radius: 0.5 },
        ];
        let cones = Cones::new(&parts, Vec3::ZERO, Vec3::Y, 0.8);
        assert!(cones.any_above() && cones.share() < 0.8, "the third ball holds the point");
        // E[1/pdf over draws] = solid angle of the union; compare with a count of uniform directions.
        let n = 100_000;
        let (mut by_draws, mut by_count) = (0.0, 0.0);
        for i in 0..n {
            let s = Sampler::new(3, (0, 0), 0, i, Numbers::SobolOwen);
            let choice = s.one(Purpose::Choice) * cones.share();
            let u = s.pair(Purpose::Direction).as_vec2();
            let d = cones.sample(u, choice * 0.999_999).unwrap();
            by_draws += f64::from(cones.share() / cones.pdf(d)) / f64::from(n);
            let z = 2.0 * u.y - 1.0;
            let r = (1.0 - z * z).sqrt();
            let d = Vec3::new(r * (TAU * u.x).cos(), r * (TAU * u.x).sin(), z);
            by_count +=
                f64::from(u8::from(cones.pdf(d) > 0.0)) / f64::from(n) * 4.0 * f64::from(PI);
        }
        assert!((by_draws / by_count - 1.0).abs() < 5e-3, "{by_draws} {by_count}");
    }

    #[test]
    fn objects_below_the_horizon_need_no_draw() {
        let parts = [PartBall { centre: Vec3::new(0.0, -2.0, 3.0), radius: 1.0 }];
        let cones = Cones::new(&parts, Vec3::ZERO, Vec3::Y, 0.8);
        assert!(!cones.any_above() && cones.share() == 0.0);
        assert!(cones.sample(Vec2::ZERO, 0.0).is_none());
    }
}
