//! How a surface scatters light: glTF 2.0 metallic-roughness, its appendix B, with transmission.
//!
//! f = metallic · conductor + (1 − metallic) · [(1 − t) · plastic + t · glass]. Plastic is Lambert under
//! a GGX coat (Schlick's Fresnel with the half vector, KHR_materials_specular weight), glass a
//! dielectric boundary by exact Fresnel (Walter, Marschner, Li, Torrance 2007) or, if the material is
//! thin, a sheet that lets light straight through. Lobes with α < 10⁻³ are perfect mirrors.
//! Everything happens in a local frame, normal +z on the side of `wo`. Radiance is counted per η²
//! ("basic radiance"), so nothing is scaled at a boundary; camera and lights are all outside.
//! Multiple scattering between microfacets is not added back: rough metals lose what R4.9 lists.

use std::f32::consts::FRAC_1_PI;

use glam::{Vec2, Vec3, vec3};

use super::fresnel;
use super::ggx::{self, SMOOTH_ALPHA};
use crate::conventions::Rgb;

/// A glTF material's scattering at one point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bsdf {
    pub base: Rgb,
    pub metallic: f32,
    /// GGX α = roughness².
    pub alpha: f32,
    /// KHR_materials_specular: 0 is exactly Lambert.
    pub specular: f32,
    /// Reflectance of the plastic coat at normal incidence.
    pub f0: Rgb,
    pub transmission: f32,
    /// Index beyond the surface over the index on `wo`'s side.
    pub eta: f32,
    /// No volume behind the surface: light goes straight through.
    pub thin: bool,
}

/// A direction drawn from a [`Bsdf`].
#[derive(Clone, Copy, Debug)]
pub struct Scattered {
    /// Unit, local frame.
    pub direction: Vec3,
    /// f · |cos| / pdf.
    pub weight: Rgb,
    /// Density per steradian; infinite for a mirror or straight-through direction.
    pub pdf: f32,
}

/// Probabilities of the lobes for one `wo`.
struct Shares {
    diffuse: f32,
    coat: f32,
    glass: f32,
}

impl Bsdf {
    /// A matt surface of albedo `base`.
    pub fn lambert(base: Rgb) -> Self {
        Self {
            base,
            metallic: 0.0,
            alpha: 1.0,
            specular: 0.0,
            f0: Rgb::ZERO,
            transmission: 0.0,
            eta: 1.5,
            thin: true,
        }
    }

    /// True if the surface scatters by Lambert's law alone.
    pub fn is_lambert(&self) -> bool {
        self.metallic == 0.0 && self.specular == 0.0 && self.transmission == 0.0
    }

    /// f · |cos wi| and the density with which [`sample`](Self::sample) draws `wi`.
    ///
    /// Unit vectors, local frame, `wo.z` > 0. Mirror lobes are no part of either.
    pub fn evaluate(&self, wo: Vec3, wi: Vec3) -> (Rgb, f32) {
        if wo.z <= 0.0 || wi.z == 0.0 {
            return (Rgb::ZERO, 0.0);
        }
        let shares = self.shares(wo);
        if wi.z < 0.0 {
            return self.evaluate_transmitted(wo, wi, &shares);
        }
        let mut value = Rgb::ZERO;
        let mut pdf = shares.diffuse * wi.z * FRAC_1_PI;
        let h = (wo + wi).normalize();
        let cosine = wo.dot(h);
        let plastic = (1.0 - self.metallic) * (1.0 - self.transmission);
        if plastic > 0.0 {
            let kept = 1.0 - self.specular * fresnel::schlick(self.f0, cosine).max_element();
            value += self.base * (plastic * kept * wi.z * FRAC_1_PI);
        }
        if self.alpha >= SMOOTH_ALPHA {
            let d = ggx::distribution(h, self.alpha);
            let g = ggx::masking(wo, self.alpha);
            let facets = d * g * ggx::masking(wi, self.alpha) / (4.0 * wo.z);
            let facet_pdf = d * g / (4.0 * wo.z);
            value += self.coat_fresnel(cosine) * facets;
            pdf += shares.coat * facet_pdf;
            if shares.glass > 0.0 {
                let reflected = self.boundary(cosine).0;
                value += Rgb::splat(self.glass_amount() * reflected * facets);
                pdf += shares.glass * reflected * facet_pdf;
            }
        }
        (value, pdf)
    }

    /// Draws a direction; `choice` in [0, 1) picks the lobe. `None` where the light is lost.
    pub fn sample(&self, wo: Vec3, u: Vec2, choice: f32) -> Option<Scattered> {
        if wo.z <= 0.0 {
            return None;
        }
        let shares = self.shares(wo);
        if choice < shares.diffuse {
            let wi = sample_cosine(u);
            return self.finish(wo, wi);
        }
        let rest = choice - shares.diffuse;
        let smooth = self.alpha < SMOOTH_ALPHA;
        let h = if smooth { fresnel::UP } else { ggx::sample_visible_normal(wo, self.alpha, u) };
        let cosine = wo.dot(h);
        if rest < shares.coat {
            let wi = fresnel::reflect(wo, h);
            return match (smooth, wi.z > 0.0) {
                (true, _) => mirror(wi, self.coat_fresnel(cosine) / shares.coat),
                (false, true) => self.finish(wo, wi),
                (false, false) => None,
            };
        }
        if shares.glass <= 0.0 {
            return None;
        }
        let reflected = self.boundary(cosine).0;
        let choice = ((rest - shares.coat) / shares.glass).clamp(0.0, 1.0 - f32::EPSILON);
        let per_share = self.glass_amount() / shares.glass;
        let wi = if choice < reflected {
            fresnel::reflect(wo, h)
        } else if self.thin {
            // Straight through; rough sheets blur by the mirrored reflection.
            fresnel::reflect(wo, h) * vec3(1.0, 1.0, -1.0)
        } else {
            fresnel::refract(wo, h, self.eta)?
        };
        if smooth {
            let tint = if choice < reflected { Rgb::ONE } else { self.base };
            return mirror(wi, tint * per_share);
        }
        // A steep facet can send light to the wrong side; its share is lost, not drawn elsewhere.
        if (wi.z > 0.0) != (choice < reflected) {
            return None;
        }
        self.finish(wo, wi)
    }

    fn finish(&self, wo: Vec3, wi: Vec3) -> Option<Scattered> {
        let (value, pdf) = self.evaluate(wo, wi);
        let weight = value / pdf;
        (pdf > 0.0 && weight.is_finite()).then_some(Scattered { direction: wi, weight, pdf })
    }

    fn evaluate_transmitted(&self, wo: Vec3, wi: Vec3, shares: &Shares) -> (Rgb, f32) {
        if shares.glass <= 0.0 || self.alpha < SMOOTH_ALPHA {
            return (Rgb::ZERO, 0.0);
        }
        let (h, jacobian) = if self.thin {
            let h = (wo + wi * vec3(1.0, 1.0, -1.0)).normalize();
            (h, 0.25 / wo.dot(h).max(1e-9))
        } else {
            let mut h = (wo + wi * self.eta).normalize_or_zero();
            if h.z < 0.0 {
                h = -h;
            }
            let (o, i) = (wo.dot(h), wi.dot(h));
            let denominator = o + self.eta * i;
            (h, self.eta * self.eta * i.abs() / (denominator * denominator).max(1e-12))
        };
        let cosine = wo.dot(h);
        if cosine <= 0.0 || (!self.thin && wi.dot(h) >= 0.0) {
            return (Rgb::ZERO, 0.0);
        }
        let facet_pdf = ggx::pdf_visible_normal(wo, h, self.alpha) * jacobian;
        let let_through = self.boundary(cosine).1 * facet_pdf;
        let value = self.base * (self.glass_amount() * let_through * ggx::masking(wi, self.alpha));
        (value, shares.glass * let_through)
    }

    fn glass_amount(&self) -> f32 {
        (1.0 - self.metallic) * self.transmission
    }

    /// Shares reflected and let through by the glass boundary or sheet.
    fn boundary(&self, cosine: f32) -> (f32, f32) {
        let r = fresnel::dielectric(cosine, self.eta);
        if self.thin { fresnel::sheet(r) } else { (r, 1.0 - r) }
    }

    /// Reflectance of the microfacets of metal and plastic together.
    fn coat_fresnel(&self, cosine: f32) -> Rgb {
        let plastic = (1.0 - self.metallic) * (1.0 - self.transmission) * self.specular;
        fresnel::schlick(self.base, cosine) * self.metallic
            + fresnel::schlick(self.f0, cosine) * plastic
    }

    /// Lobes by what they reflect of a white sky seen along `wo`, roughly.
    fn shares(&self, wo: Vec3) -> Shares {
        let coat = self.coat_fresnel(wo.z).max_element();
        // Along a grazing view the coat takes nearly all by the mirror, not by steep facets: the
        // matt part must not be starved of draws.
        let kept = 1.0 - self.specular * fresnel::schlick(self.f0, wo.z.max(0.5)).max_element();
        let plastic = (1.0 - self.metallic) * (1.0 - self.transmission);
        let diffuse = plastic * kept * self.base.max_element();
        let glass = self.glass_amount();
        let sum = diffuse + coat + glass;
        if sum <= 0.0 {
            // Black: any lobe will do, the weight is 0.
            return Shares { diffuse: 1.0, coat: 0.0, glass: 0.0 };
        }
        Shares { diffuse: diffuse / sum, coat: coat / sum, glass: glass / sum }
    }
}

fn mirror(direction: Vec3, weight: Rgb) -> Option<Scattered> {
    (direction.z != 0.0).then_some(Scattered { direction, weight, pdf: f32::INFINITY })
}

/// A cosine-weighted direction about +z (Shirley & Chiu's concentric map keeps strata compact).
pub fn sample_cosine(u: Vec2) -> Vec3 {
    let p = 2.0 * u - Vec2::ONE;
    let (radius, angle) = if p == Vec2::ZERO {
        (0.0, 0.0)
    } else if p.x.abs() > p.y.abs() {
        (p.x, std::f32::consts::FRAC_PI_4 * p.y / p.x)
    } else {
        (p.y, std::f32::consts::FRAC_PI_2 - std::f32::consts::FRAC_PI_4 * p.x / p.y)
    };
    let (sin, cos) = angle.sin_cos();
    let z = (1.0 - radius * radius).max(1e-8).sqrt();
    vec3(radius * cos, radius * sin, z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::sampler::{Numbers, Purpose, Sampler, to_f32};

    fn plastic(alpha: f32) -> Bsdf {
        Bsdf {
            base: vec3(0.8, 0.5, 0.2),
            alpha,
            specular: 1.0,
            f0: Rgb::splat(0.04),
            ..Bsdf::lambert(Rgb::ONE)
        }
    }

    fn metal(alpha: f32) -> Bsdf {
        Bsdf { metallic: 1.0, base: Rgb::ONE, ..plastic(alpha) }
    }

    fn glass(alpha: f32, eta: f32, thin: bool) -> Bsdf {
        Bsdf { transmission: 1.0, base: Rgb::ONE, eta, thin, ..plastic(alpha) }
    }

    fn at(mu: f32) -> Vec3 {
        vec3((1.0 - mu * mu).sqrt(), 0.0, mu)
    }

    fn draws(bsdf: Bsdf, wo: Vec3, n: u32) -> impl Iterator<Item = Option<Scattered>> {
        (0..n).map(move |i| {
            let s = Sampler::new(4, (1, 2), 0, i, Numbers::Independent);
            let choice = to_f32(s.pair(Purpose::Choice).x);
            bsdf.sample(
                wo,
                s.pair(Purpose::Direction).as_vec2().min(Vec2::splat(0.999_999_9)),
                choice,
            )
        })
    }

    #[test]
    fn specular_weight_zero_is_exactly_lambert() {
        let bsdf = Bsdf { specular: 0.0, ..plastic(0.3) };
        for (wo, wi) in [(at(0.3), at(0.9)), (at(1.0), at(0.1))] {
            let (value, pdf) = bsdf.evaluate(wo, wi);
            assert!((value - bsdf.base * wi.z * FRAC_1_PI).abs().max_element() < 1e-7);
            assert!((pdf - wi.z * FRAC_1_PI).abs() < 1e-6);
        }
        assert!(bsdf.is_lambert() && !plastic(0.3).is_lambert());
    }

    #[test]
    fn reflection_is_reciprocal() {
        let mut worst = 0.0_f32;
        for i in 0..10_000 {
            let s = Sampler::new(8, (0, 0), 0, i, Numbers::Independent);
            let a = sample_cosine(s.pair(Purpose::Direction).as_vec2());
            let b = sample_cosine(s.pair(Purpose::Environment).as_vec2());
            for bsdf in [plastic(0.09), plastic(0.7), metal(0.3), glass(0.3, 1.5, false)] {
                let f = bsdf.evaluate(a, b).0 / b.z;
                let back = bsdf.evaluate(b, a).0 / a.z;
                worst = worst.max(((f - back) / (f + back + 1e-6)).abs().max_element());
            }
        }
        assert!(worst < 1e-4, "{worst}");
    }

    /// Draws against the density over 64 × 32 bins of (cos, φ) on both sides; false alarm 0.001.
    #[test]
    fn draws_follow_the_density() {
        for bsdf in [
            plastic(0.05),
            plastic(0.5),
            metal(0.2),
            metal(1.0),
            glass(0.3, 1.5, false),
            glass(0.4, 1.0 / 1.5, false),
            glass(0.3, 1.5, true),
            Bsdf { metallic: 0.5, transmission: 0.4, ..plastic(0.3) },
        ] {
            for mu in [0.02, 0.4, 0.95] {
                // A narrow lobe at grazing is thinner than the cells of the sum it is compared with.
                if bsdf.alpha > 0.1 || mu > 0.1 {
                    chi_square(bsdf, at(mu));
                }
            }
        }
    }

    fn chi_square(bsdf: Bsdf, wo: Vec3) {
        const N: u32 = 200_000;
        let (rows, columns) = (32, 32);
        let bin = |d: Vec3| {
            let row = ((d.z + 1.0) * 0.5 * rows as f32) as usize;
            let phi = d.y.atan2(d.x) / std::f32::consts::TAU + 0.5;
            row.min(rows - 1) * columns + ((phi * columns as f32) as usize).min(columns - 1)
        };
        let mut counts = vec![0.0; rows * columns];
        for s in draws(bsdf, wo, N).flatten() {
            counts[bin(s.direction)] += 1.0;
        }
        let fine = 64;
        let (mut chi, mut cells) = (0.0, 0.0);
        for row in 0..rows {
            for column in 0..columns {
                let mut expected = 0.0;
                for a in 0..fine {
                    for b in 0..fine {
                        let z = ((row as f64 + (a as f64 + 0.5) / fine as f64) / rows as f64) * 2.0
                            - 1.0;
                        let phi = ((column as f64 + (b as f64 + 0.5) / fine as f64)
                            / columns as f64
                            - 0.5)
                            * std::f64::consts::TAU;
                        let r = (1.0 - z * z).sqrt();
                        let wi = vec3((r * phi.cos()) as f32, (r * phi.sin()) as f32, z as f32);
                        expected += f64::from(bsdf.evaluate(wo, wi).1);
                    }
                }
                expected *= f64::from(N) * 4.0 * std::f64::consts::PI
                    / (rows * columns * fine * fine) as f64;
                let count = counts[row * columns + column];
                // Bins where the lobe turns within one fine cell are not resolved by this sum.
                if expected > 20.0 {
                    let relative_quadrature_error = 0.01 * expected;
                    chi += (count - expected) * (count - expected)
                        / (expected + relative_quadrature_error * relative_quadrature_error);
                    cells += 1.0;
                }
            }
        }
        let n: f64 = cells;
        let limit = n * (1.0 - 2.0 / (9.0 * n) + 3.8 * (2.0 / (9.0 * n)).sqrt()).powi(3);
        assert!(chi < limit, "{bsdf:?} at {wo}: chi-square {chi} with {cells} bins");
    }

    #[test]
    fn glass_and_white_plastic_lose_nothing_where_they_may_not() {
        // Smooth glass reflects or refracts everything; a sheet too.
        for bsdf in [glass(0.0, 1.5, false), glass(0.0, 1.0 / 1.5, false), glass(0.0, 1.5, true)] {
            for mu in [0.1, 0.6, 1.0] {
                for s in draws(bsdf, at(mu), 100) {
                    let s = s.unwrap();
                    assert!((s.weight - Rgb::ONE).abs().max_element() < 1e-5);
                    assert_eq!(s.pdf, f32::INFINITY);
                }
            }
        }
        // A perfect mirror.
        for s in draws(metal(0.0), at(0.3), 50) {
            assert!((s.unwrap().weight - Rgb::ONE).length() < 1e-5);
        }
    }

    #[test]
    fn mean_weight_is_the_integral_of_the_value() {
        // Albedo by draws against a midpoint sum over the sphere: 0.5 % for 1e5 draws.
        for (bsdf, mu) in [
            (plastic(0.3), 0.5),
            (metal(0.6), 0.7),
            (glass(0.5, 1.5, false), 0.8),
            (glass(0.5, 1.5, true), 0.6),
        ] {
            let n = 100_000;
            let mean: f64 =
                draws(bsdf, at(mu), n).flatten().map(|s| f64::from(s.weight.x)).sum::<f64>()
                    / f64::from(n);
            let (mut sum, m) = (0.0, 1200);
            for a in 0..m {
                for b in 0..m {
                    let z = (f64::from(a) + 0.5) / f64::from(m) * 2.0 - 1.0;
                    let phi = (f64::from(b) + 0.5) / f64::from(m) * std::f64::consts::TAU;
                    let r = (1.0 - z * z).sqrt();
                    let wi = vec3((r * phi.cos()) as f32, (r * phi.sin()) as f32, z as f32);
                    sum += f64::from(bsdf.evaluate(at(mu), wi).0.x);
                }
            }
            let integral = sum * 4.0 * std::f64::consts::PI / f64::from(m * m);
            assert!((mean - integral).abs() < 5e-3 * integral, "{bsdf:?}: {mean} for {integral}");
        }
    }

    #[test]
    fn grazing_views_stay_finite() {
        for bsdf in [plastic(0.001), plastic(1.0), metal(0.01), glass(0.2, 1.5, false)] {
            for s in draws(bsdf, at(1e-4), 2000).flatten() {
                assert!(s.weight.is_finite() && s.weight.max_element() < 50.0, "{bsdf:?} {s:?}");
            }
        }
    }
}
