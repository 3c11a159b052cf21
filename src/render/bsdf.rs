//! How a surface scatters light: glTF 2.0 metallic-roughness, its appendix B, with transmission.
//!
//! f = metallic · conductor + (1 − metallic) · [(1 − t) · plastic + t · glass]. Plastic is Lambert under
//! a GGX coat (Schlick's Fresnel with the half vector, KHR_materials_specular weight), glass a
//! dielectric boundary by exact Fresnel (Walter, Marschner, Li, Torrance 2007) or, if the material is
//! thin, a sheet that lets light straight through. Lobes with α < 10⁻³ are perfect mirrors.
//! Upon that may lie a [`Sheen`], and upon all a [`Coat`].
//! Everything happens in a local frame, normal +z on the side of `wo`. Radiance is counted per η²
//! ("basic radiance"), so nothing is scaled at a boundary; camera and lights are all outside.
//! Microfacets lose the light that they pass among each other (69 % of it at α = 1, head on), as
//! appendix B has it. With `multiple_scattering` it is given back after Turquin 2019: the reflection of
//! metal and plastic is scaled by 1 + F₀ (1 − E) / E, with E the albedo of its lobe at reflectance 1. That
//! goes by the view alone and is not quite reciprocal.

use std::f32::consts::{FRAC_1_PI, TAU};

use glam::{Vec2, Vec3, vec3};

use super::coat::Coat;
use super::fresnel;
use super::ggx::{self, SMOOTH_ALPHA};
use super::sampler::below_one;
use super::sheen::Sheen;
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
    /// Reflectance of plastic and glass at normal incidence.
    pub f0: Rgb,
    pub transmission: f32,
    /// Index beyond the surface over the index on `wo`'s side.
    pub eta: f32,
    /// No volume behind the surface: light goes straight through.
    pub thin: bool,
    /// Whether light scattered between microfacets more than once is given back.
    pub multiple_scattering: bool,
    /// What the microfacets of metal and plastic reflect, relative to their own: see
    /// [`softened`](Self::softened).
    pub facet_gain: f32,
    pub sheen: Option<Sheen>,
    pub coat: Option<Coat>,
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

impl Scattered {
    /// Balance heuristic against lights that draw this direction with density `light_pdf`.
    pub fn weight_against(&self, light_pdf: f32) -> f32 {
        if self.pdf.is_finite() { self.pdf / (self.pdf + light_pdf) } else { 1.0 }
    }
}

/// A direction drawn from what lies under sheen and coat.
struct Drawn {
    direction: Vec3,
    /// Of a mirror or straight-through direction: f · |cos| / pdf.
    mirror_weight: Option<Rgb>,
}

/// Probabilities of coat, sheen and what lies beneath for one `wo`.
struct LayerShares {
    coat: f32,
    sheen: f32,
    base: f32,
}

/// Probabilities of the lobes beneath for one `wo`.
struct Shares {
    diffuse: f32,
    facets: f32,
    glass: f32,
    /// What they reflect of a white sky together, roughly.
    reflected: f32,
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
            multiple_scattering: false,
            facet_gain: 1.0,
            sheen: None,
            coat: None,
        }
    }

    /// The same seen along `wo` with no lobe sharper than `least`, reflecting as much of a white sky:
    /// within 4 %, but for plastic and varnish seen along their surface, which reflect up to a fifth
    /// less.
    ///
    /// Glass stays what it is: a blurred boundary would lose light inside.
    pub fn softened(mut self, wo: Vec3, least: f32) -> Self {
        if let Some(coat) = &mut self.coat {
            coat.alpha = coat.alpha.max(least);
        }
        if self.alpha >= least || self.transmission > 0.0 {
            return self;
        }
        if !self.multiple_scattering {
            let own = if self.alpha < SMOOTH_ALPHA { 1.0 } else { ggx::albedo(wo.z, self.alpha) };
            self.facet_gain = own / ggx::albedo(wo.z, least);
        }
        Self { alpha: least, ..self }
    }

    /// True if the surface scatters by Lambert's law alone.
    pub fn is_lambert(&self) -> bool {
        let plain = self.metallic == 0.0 && self.specular == 0.0 && self.transmission == 0.0;
        plain && !self.has_layers()
    }

    fn has_layers(&self) -> bool {
        self.sheen.is_some() || self.coat.is_some()
    }

    /// Share of the light the surface itself sends to `wo` that its coat lets through.
    pub fn let_out(&self, wo: Vec3) -> f32 {
        1.0 - self.coat.map_or(0.0, |coat| coat.share(wo))
    }

    /// f · |cos wi| and the density with which [`sample`](Self::sample) draws `wi`.
    ///
    /// Unit vectors, local frame, `wo.z` > 0. Mirror lobes are no part of either.
    pub fn evaluate(&self, wo: Vec3, wi: Vec3) -> (Rgb, f32) {
        if wo.z <= 0.0 || wi.z == 0.0 {
            return (Rgb::ZERO, 0.0);
        }
        let (mut value, mut pdf) = self.evaluate_base(wo, wi);
        if !self.has_layers() {
            return (value, pdf);
        }
        let shares = self.layer_shares(wo);
        pdf *= shares.base;
        if let Some(sheen) = &self.sheen {
            value *= sheen.kept(wo, wi);
            if wi.z > 0.0 {
                value += sheen.evaluate(wo, wi);
                pdf += shares.sheen * EVEN_PDF;
            }
        }
        if let Some(coat) = &self.coat {
            let reflected = coat.share(wo);
            value *= 1.0 - reflected;
            if wi.z > 0.0 {
                let (facets, facet_pdf) = coat.evaluate(wo, wi);
                value += reflected * facets;
                pdf += shares.coat * facet_pdf;
            }
        }
        (value, pdf)
    }

    /// Draws a direction by `u` in [0, 1]²; `choice` in [0, 1) picks the lobe. `None` where the light is
    /// lost.
    pub fn sample(&self, wo: Vec3, u: Vec2, choice: f32) -> Option<Scattered> {
        if wo.z <= 0.0 {
            return None;
        }
        // Numbers in f64 below 1 may be 1 in f32, where lobes have their edges
        let u = u.map(below_one);
        let shares = self.layer_shares(wo);
        if let Some(coat) = self.coat.filter(|_| choice < shares.coat) {
            let wi = coat.sample(wo, u).filter(|wi| wi.z > 0.0)?;
            if coat.is_smooth() {
                return mirror(wi, Rgb::splat(coat.share(wo) / shares.coat));
            }
            return self.finish(wo, wi);
        }
        let rest = choice - shares.coat;
        if rest < shares.sheen {
            // Sheen has no peak that is worth more than the rest of it
            return self.finish(wo, sample_even(u));
        }
        let choice = ((rest - shares.sheen) / shares.base).clamp(0.0, 1.0 - f32::EPSILON);
        let drawn = self.sample_base(wo, u, choice)?;
        let Some(weight) = drawn.mirror_weight else { return self.finish(wo, drawn.direction) };
        let kept = self.sheen.map_or(1.0, |sheen| sheen.kept(wo, drawn.direction));
        mirror(drawn.direction, weight * (kept * self.let_out(wo) / shares.base))
    }

    fn finish(&self, wo: Vec3, wi: Vec3) -> Option<Scattered> {
        let (value, pdf) = self.evaluate(wo, wi);
        let weight = value / pdf;
        (pdf > 0.0 && weight.is_finite()).then_some(Scattered { direction: wi, weight, pdf })
    }

    fn evaluate_base(&self, wo: Vec3, wi: Vec3) -> (Rgb, f32) {
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
            value += self.facet_reflectance(wo, cosine) * facets;
            pdf += shares.facets * facet_pdf;
            if shares.glass > 0.0 {
                let reflected = self.boundary(cosine);
                value += reflected * (self.glass_amount() * facets);
                pdf += shares.glass * reflected.max_element() * facet_pdf;
            }
        }
        (value, pdf)
    }

    fn sample_base(&self, wo: Vec3, u: Vec2, choice: f32) -> Option<Drawn> {
        let rough = |direction| Some(Drawn { direction, mirror_weight: None });
        let mirror = |direction, weight| Some(Drawn { direction, mirror_weight: Some(weight) });
        let shares = self.shares(wo);
        if choice < shares.diffuse {
            return rough(sample_cosine(u));
        }
        let rest = choice - shares.diffuse;
        let smooth = self.alpha < SMOOTH_ALPHA;
        let h = if smooth { fresnel::UP } else { ggx::sample_visible_normal(wo, self.alpha, u) };
        let cosine = wo.dot(h);
        if rest < shares.facets {
            let wi = fresnel::reflect(wo, h);
            return match (smooth, wi.z > 0.0) {
                (true, _) => mirror(wi, self.facet_reflectance(wo, cosine) / shares.facets),
                (false, true) => rough(wi),
                (false, false) => None,
            };
        }
        if shares.glass <= 0.0 {
            return None;
        }
        let reflected = self.boundary(cosine);
        let share = reflected.max_element();
        let choice = ((rest - shares.facets) / shares.glass).clamp(0.0, 1.0 - f32::EPSILON);
        let per_share = self.glass_amount() / shares.glass;
        if choice < share {
            let wi = fresnel::reflect(wo, h);
            return match (smooth, wi.z > 0.0) {
                (true, _) => mirror(wi, reflected * (per_share / share)),
                (false, true) => rough(wi),
                // A steep facet sends light to the wrong side; its share is lost.
                (false, false) => None,
            };
        }
        let wi = if self.thin {
            // Straight through; rough sheets blur by the mirrored reflection.
            fresnel::reflect(wo, h) * vec3(1.0, 1.0, -1.0)
        } else if self.bends() {
            fresnel::refract(wo, h, self.eta)?
        } else {
            -wo
        };
        match (smooth || !(self.thin || self.bends()), wi.z < 0.0) {
            (true, _) => mirror(wi, self.base * per_share),
            (false, true) => rough(wi),
            (false, false) => None,
        }
    }

    fn evaluate_transmitted(&self, wo: Vec3, wi: Vec3, shares: &Shares) -> (Rgb, f32) {
        let spreads = self.alpha >= SMOOTH_ALPHA && (self.thin || self.bends());
        if shares.glass <= 0.0 || !spreads {
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
        let let_through = (1.0 - self.boundary(cosine).max_element()) * facet_pdf;
        let value = self.base * (self.glass_amount() * let_through * ggx::masking(wi, self.alpha));
        (value, shares.glass * let_through)
    }

    fn glass_amount(&self) -> f32 {
        (1.0 - self.metallic) * self.transmission
    }

    /// Whether the index changes at the surface: if not, facets of any slope pass light straight on.
    fn bends(&self) -> bool {
        (self.eta - 1.0).abs() > 1e-3
    }

    /// What the glass boundary or sheet reflects; as much as the largest channel is not let through.
    fn boundary(&self, cosine: f32) -> Rgb {
        let exact = fresnel::dielectric(cosine, self.eta);
        if exact >= 1.0 {
            return Rgb::ONE;
        }
        // KHR_materials_specular: from `f0` head on to `specular` at grazing, by the exact curve.
        let head_on = fresnel::normal_reflectance(self.eta);
        let rise = (exact - head_on) / (1.0 - head_on);
        let r = (self.specular * (self.f0 + (Rgb::ONE - self.f0) * rise)).max(Rgb::ZERO);
        if self.thin { r.map(|r| fresnel::sheet(r).0) } else { r }
    }

    /// Reflectance of the microfacets of metal and plastic together, seen along `wo`, where a facet
    /// meets light at `cosine`.
    fn facet_reflectance(&self, wo: Vec3, cosine: f32) -> Rgb {
        let plastic = (1.0 - self.metallic) * (1.0 - self.transmission) * self.specular;
        let metal = fresnel::schlick(self.base, cosine) * self.metallic;
        let plastic = fresnel::schlick(self.f0, cosine) * plastic;
        if !self.multiple_scattering || self.alpha < SMOOTH_ALPHA {
            return self.facet_gain * (metal + plastic);
        }
        let albedo = ggx::albedo(wo.z, self.alpha);
        let lost = (1.0 - albedo) / albedo;
        metal * (1.0 + self.base * lost) + plastic * (1.0 + self.f0 * lost)
    }

    /// Layers by what they reflect of a white sky seen along `wo`, roughly.
    fn layer_shares(&self, wo: Vec3) -> LayerShares {
        let coat = self.coat.map_or(0.0, |coat| coat.share(wo));
        let sheen = self.sheen.map_or(0.0, |sheen| sheen.albedo(wo));
        if coat + sheen == 0.0 {
            return LayerShares { coat: 0.0, sheen: 0.0, base: 1.0 };
        }
        // A dark base still gets every tenth draw: its lobes may be bright in one direction.
        let base = self.shares(wo).reflected.clamp(0.1, 1.0) * (1.0 - sheen).max(0.1);
        let beneath = (1.0 - coat).max(0.1);
        let sum = coat + beneath * (sheen + base);
        LayerShares { coat: coat / sum, sheen: beneath * sheen / sum, base: beneath * base / sum }
    }

    /// Lobes by what they reflect of a white sky seen along `wo`, roughly.
    fn shares(&self, wo: Vec3) -> Shares {
        let facets = self.facet_reflectance(wo, wo.z).max_element();
        // Along a grazing view the facets take nearly all by the mirror, not by steep facets: the
        // matt part must not be starved of draws.
        let kept = 1.0 - self.specular * fresnel::schlick(self.f0, wo.z.max(0.5)).max_element();
        let plastic = (1.0 - self.metallic) * (1.0 - self.transmission);
        let diffuse = plastic * kept * self.base.max_element();
        let glass = self.glass_amount();
        let sum = diffuse + facets + glass;
        if sum <= 0.0 {
            // Black: any lobe will do, the weight is 0.
            return Shares { diffuse: 1.0, facets: 0.0, glass: 0.0, reflected: 0.0 };
        }
        Shares { diffuse: diffuse / sum, facets: facets / sum, glass: glass / sum, reflected: sum }
    }
}

fn mirror(direction: Vec3, weight: Rgb) -> Option<Scattered> {
    (direction.z != 0.0).then_some(Scattered { direction, weight, pdf: f32::INFINITY })
}

/// Density per steradian of [`sample_even`].
pub const EVEN_PDF: f32 = 0.5 * FRAC_1_PI;

/// A direction of the hemisphere about +z, all alike.
pub fn sample_even(u: Vec2) -> Vec3 {
    let z = 1.0 - u.x;
    let radius = (1.0 - z * z).max(0.0).sqrt();
    let (sin, cos) = (TAU * u.y).sin_cos();
    vec3(radius * cos, radius * sin, z.max(1e-7))
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
