//! How the demo's surfaces scatter: Lambert, mirror, and glTF 2.0 metallic-roughness (appendix B).
//!
//! Written from the specification, apart from the library, so that the two check each other:
//! GGX with α = roughness², separable Smith masking, Schlick's Fresnel with F0 = 0.04, and
//! `fresnel_mix` of the diffuse and the specular lobe.

use std::f64::consts::PI;

use glam::{DVec2, DVec3};

use crate::paint::Paint;
use crate::sampling::{around, frame};

/// What a thing is made of.
#[derive(Clone, Copy)]
pub struct Finish {
    pub paint: Paint,
    pub gloss: Gloss,
}

#[derive(Clone, Copy)]
pub enum Gloss {
    Matt,
    Mirror,
    Dielectric { roughness: f64 },
    Metal { roughness: f64 },
}

/// The scattering of one point: an albedo and what lies over it.
pub struct Scatter {
    pub colour: DVec3,
    pub gloss: Gloss,
    /// Unit, on the viewer's side.
    pub normal: DVec3,
}

impl Scatter {
    /// BSDF times the cosine at the light, and the density with which [`Scatter::sample`] finds `wi`.
    pub fn value_and_pdf(&self, wo: DVec3, wi: DVec3) -> (DVec3, f64) {
        let (no, ni) = (self.normal.dot(wo), self.normal.dot(wi));
        if ni <= 0.0 || no <= 0.0 {
            return (DVec3::ZERO, 0.0);
        }
        let diffuse = self.colour / PI;
        let Some((roughness, share)) = self.specular_lobe() else {
            return (diffuse * ni, ni / PI);
        };
        let half = (wo + wi).normalize();
        let (nh, oh) = (self.normal.dot(half), wo.dot(half));
        let alpha2 = roughness.powi(4);
        let ggx = alpha2 / (PI * (nh * nh * (alpha2 - 1.0) + 1.0).powi(2));
        let smith = |c: f64| 1.0 / (c + (alpha2 + (1.0 - alpha2) * c * c).sqrt());
        let specular = ggx * smith(no) * smith(ni);
        let schlick = (1.0 - oh).powi(5);
        let value = match self.gloss {
            Gloss::Metal { .. } => (self.colour + (DVec3::ONE - self.colour) * schlick) * specular,
            _ => diffuse.lerp(DVec3::splat(specular), 0.04 + 0.96 * schlick),
        };
        // Density of the half vectors that are seen (Heitz 2018), turned into one of directions.
        let pdf_specular = ggx * smith(no) / 2.0;
        (value * ni, share * pdf_specular + (1.0 - share) * ni / PI)
    }

    /// A direction to follow, for `choice` and `u` in [0, 1).
    pub fn sample(&self, wo: DVec3, choice: f64, u: DVec2) -> DVec3 {
        match self.specular_lobe() {
            Some((roughness, share)) if choice < share => {
                let half = visible_half(self.normal, wo, roughness * roughness, u);
                2.0 * wo.dot(half) * half - wo
            }
            _ => around(self.normal, (1.0 - u.x).sqrt(), u.y),
        }
    }

    /// Roughness and the share of samples of the specular lobe, if there is one.
    fn specular_lobe(&self) -> Option<(f64, f64)> {
        match self.gloss {
            Gloss::Matt | Gloss::Mirror => None,
            Gloss::Dielectric { roughness } => Some((roughness, 0.3)),
            Gloss::Metal { roughness } => Some((roughness, 1.0)),
        }
    }
}

/// A half vector with the density of the GGX normals seen from `wo` (Heitz, JCGT 7(4), 2018).
fn visible_half(n: DVec3, wo: DVec3, alpha: f64, u: DVec2) -> DVec3 {
    let (s, t) = frame(n);
    let local = DVec3::new(wo.dot(s) * alpha, wo.dot(t) * alpha, wo.dot(n)).normalize();
    let (t1, t2) = frame(local);
    let r = u.x.sqrt();
    let (sin, cos) = (2.0 * PI * u.y).sin_cos();
    // t1, t2 span the disc seen along `local`; the half facing down is squeezed to the horizon.
    let horizontal = DVec3::Z.cross(local);
    let (t1, t2) = if horizontal.length_squared() > 1e-12 {
        let t1 = horizontal.normalize();
        (t1, local.cross(t1))
    } else {
        (t1, t2)
    };
    let x = r * cos;
    let lift = 0.5 * (1.0 + local.z);
    let y = (1.0 - lift) * (1.0 - x * x).max(0.0).sqrt() + lift * r * sin;
    let h = t1 * x + t2 * y + local * (1.0 - x * x - y * y).max(0.0).sqrt();
    let h = DVec3::new(alpha * h.x, alpha * h.y, h.z.max(1e-9)).normalize();
    s * h.x + t * h.y + n * h.z
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::Sampler;

    /// The density integrates to what falls above the surface, and value / density under a uniform
    /// sky is the same by this sampling as by uniform directions. 2^16 low-discrepancy samples;
    /// 1 % is far above their error for α ≥ 0.09.
    #[test]
    fn sampling_and_uniform_directions_agree() {
        let wo = DVec3::new(0.6, 0.0, 0.8);
        for gloss in
            [Gloss::Matt, Gloss::Dielectric { roughness: 0.4 }, Gloss::Metal { roughness: 0.3 }]
        {
            let scatter = Scatter { colour: DVec3::new(0.7, 0.4, 0.2), gloss, normal: DVec3::Z };
            let (mut by_lobe, mut by_uniform, mut inside, mut pdf_sum) = (0.0, 0.0, 0.0, 0.0);
            const N: u32 = 1 << 16;
            for i in 0..N {
                let mut sampler = Sampler::new(5, i);
                let wi = scatter.sample(wo, sampler.next_2d().x, sampler.next_2d());
                let (value, pdf) = scatter.value_and_pdf(wo, wi);
                if pdf > 0.0 {
                    by_lobe += value.x / pdf;
                    inside += 1.0;
                }
                let u = sampler.next_2d();
                let (value, pdf) = scatter.value_and_pdf(wo, around(DVec3::Z, u.x, u.y));
                by_uniform += value.x * 2.0 * PI;
                pdf_sum += pdf * 2.0 * PI;
            }
            assert!((by_lobe / by_uniform - 1.0).abs() < 0.01, "{by_lobe} {by_uniform}");
            assert!((pdf_sum / inside - 1.0_f64).abs() < 0.01, "{pdf_sum} {inside}");
        }
    }
}
