//! A thin clear varnish over everything else (KHR_materials_clearcoat).
//!
//! f = (1 − c F) f_base + c F · D G / (4 n·v n·l), with F = 0.04 + 0.96 (1 − |n·v|)⁵ and the coat's own
//! normal n, as the extension prints it: by the view and not by the half vector, so that what the coat
//! takes and what it sends back are the same number. That is not reciprocal: swapping the directions
//! scales either part by its other Fresnel factor. GGX of α = roughness²; no refraction.

use glam::{Vec2, Vec3};

use super::fresnel;
use super::ggx::{self, SMOOTH_ALPHA};
use crate::conventions::Rgb;

/// Reflectance of index 1.5 head on.
const F0: f32 = 0.04;

/// A coat of some weight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Coat {
    /// Share of the surface that is coated.
    pub weight: f32,
    /// GGX α.
    pub alpha: f32,
    /// Unit, in the frame of the surface beneath, on the side of the view.
    pub normal: Vec3,
}

impl Coat {
    /// Share of the light sent to `wo` that the coat itself reflects: c F.
    pub fn share(&self, wo: Vec3) -> f32 {
        self.weight * fresnel::schlick(Rgb::splat(F0), wo.dot(self.normal).abs()).x
    }

    pub fn is_smooth(&self) -> bool {
        self.alpha < SMOOTH_ALPHA
    }

    /// f · |cos| by the coat's own normal of a lobe of reflectance 1, and the density of
    /// [`sample`](Self::sample). Zero of a smooth coat.
    pub fn evaluate(&self, wo: Vec3, wi: Vec3) -> (f32, f32) {
        let (wo, wi) = (self.to_own(wo), self.to_own(wi));
        if self.is_smooth() || wo.z <= 0.0 || wi.z <= 0.0 {
            return (0.0, 0.0);
        }
        let h = (wo + wi).normalize();
        let pdf = ggx::distribution(h, self.alpha) * ggx::masking(wo, self.alpha) / (4.0 * wo.z);
        (pdf * ggx::masking(wi, self.alpha), pdf)
    }

    /// A direction in the frame of the surface beneath; `None` where the light is lost.
    pub fn sample(&self, wo: Vec3, u: Vec2) -> Option<Vec3> {
        let wo = self.to_own(wo);
        if wo.z <= 0.0 {
            return None;
        }
        let smooth = self.is_smooth();
        let h = if smooth { fresnel::UP } else { ggx::sample_visible_normal(wo, self.alpha, u) };
        let wi = fresnel::reflect(wo, h);
        let (x, y) = self.normal.any_orthonormal_pair();
        (wi.z > 0.0).then(|| (x * wi.x + y * wi.y + self.normal * wi.z).normalize())
    }

    fn to_own(self, w: Vec3) -> Vec3 {
        let (x, y) = self.normal.any_orthonormal_pair();
        Vec3::new(x.dot(w), y.dot(w), self.normal.dot(w))
    }
}
