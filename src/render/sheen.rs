//! Sheen: upright fibres that scatter light back at grazing angles (KHR_materials_sheen).
//!
//! f = colour · D · V, with the "Charlie" distribution D = (2 + 1/α) sin^{1/α}θ_h / 2π and the
//! visibility V = 1 / (4 n·l n·v (1 + Λ(n·v) + Λ(n·l))) of Conty Estevez and Kulla 2017. What lies
//! beneath is scaled by 1 − max(colour) · E, with E the directional albedo at the lower of the two
//! directions: reciprocal, and no light is made.
//! The published fit of Λ returns more than it gets below some 5° above a surface of α < 0.06 (E up
//! to 3.7). There the lobe is divided by E.

use std::f32::consts::PI;
use std::sync::LazyLock;

use glam::Vec3;

use super::energy::AlbedoTable;
use crate::conventions::Rgb;

/// Narrowest lobe, sheen roughness 0.05: what is narrower lies within 2° of the surface.
const LEAST_ALPHA: f32 = 0.0025;

/// A sheen that is not black.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sheen {
    colour: Rgb,
    alpha: f32,
}

impl Sheen {
    /// `None` if it is black.
    pub fn new(colour: Rgb, roughness: f32) -> Option<Self> {
        let alpha = (roughness * roughness).max(LEAST_ALPHA);
        (colour.max_element() > 0.0).then_some(Self { colour, alpha })
    }

    /// f · cos wi. Unit vectors of the local frame, both above the surface.
    pub fn evaluate(&self, wo: Vec3, wi: Vec3) -> Rgb {
        let h = (wo + wi).normalize();
        let sine2 = (h.x * h.x + h.y * h.y).min(1.0);
        let shadowing = 1.0 + lambda(wo.z, self.alpha) + lambda(wi.z, self.alpha);
        let lobe = distribution(sine2, self.alpha) / (4.0 * wo.z * shadowing);
        self.colour * (lobe / self.raw_albedo(wo).max(self.raw_albedo(wi)).max(1.0))
    }

    /// Share of the light that what lies beneath may still scatter from `wi` to `wo`.
    pub fn kept(&self, wo: Vec3, wi: Vec3) -> f32 {
        1.0 - self.colour.max_element() * self.raw_albedo(wo).max(self.raw_albedo(wi)).min(1.0)
    }

    /// How much of a white sky seen along `wo` the sheen sends back, at most.
    pub fn albedo(&self, wo: Vec3) -> f32 {
        self.colour.max_element() * self.raw_albedo(wo).min(1.0)
    }

    /// Of a white sheen by the published formula: above 1 where that makes light.
    fn raw_albedo(&self, w: Vec3) -> f32 {
        ALBEDO.look_up(w.z.abs(), self.alpha)
    }
}

fn distribution(sine2: f32, alpha: f32) -> f32 {
    (2.0 + 1.0 / alpha) * sine2.powf(0.5 / alpha) / (2.0 * PI)
}

/// The fit of the fibres' shadowing.
fn lambda(cosine: f32, alpha: f32) -> f32 {
    let t = (1.0 - alpha) * (1.0 - alpha);
    let mix = |rough: f32, smooth: f32| rough + t * (smooth - rough);
    let (a, b) = (mix(21.5473, 25.3245), mix(3.82987, 3.32435));
    let (c, d, e) = (mix(0.19823, 0.16801), mix(-1.97760, -1.27393), mix(-4.32054, -4.85967));
    let l = |x: f32| a / (1.0 + b * x.powf(c)) + d * x + e;
    let cosine = cosine.abs().min(1.0);
    if cosine < 0.5 { l(cosine).exp() } else { (2.0 * l(0.5) - l(1.0 - cosine)).exp() }
}

/// E(μ, α) of a white sheen.
static ALBEDO: LazyLock<AlbedoTable> = LazyLock::new(|| {
    // Midpoints, even in √z since the lobe is narrow along the surface.
    const N_Z: usize = 64;
    const N_PHI: usize = 32;
    AlbedoTable::new(|cosines, alpha| {
        let alpha = alpha.max(LEAST_ALPHA);
        let heights: [f32; N_Z] = std::array::from_fn(|i| {
            let t = (i as f32 + 0.5) / N_Z as f32;
            t * t
        });
        let lambdas = heights.map(|z| lambda(z, alpha));
        cosines.map(|mu| {
            let (sine, own) = ((1.0 - mu * mu).max(0.0).sqrt(), lambda(mu, alpha));
            let mut sum = 0.0;
            for (z, other) in heights.iter().zip(lambdas) {
                let radius = (1.0 - z * z).sqrt();
                let mut ring = 0.0;
                for j in 0..N_PHI {
                    let cos_phi = (PI * (j as f32 + 0.5) / N_PHI as f32).cos();
                    let across = sine * sine + radius * radius + 2.0 * sine * radius * cos_phi;
                    let along = (mu + z) * (mu + z);
                    ring += distribution(across / (across + along), alpha);
                }
                // dz = 2 √z dt
                let weight = 2.0 * z.sqrt() / (4.0 * mu * (1.0 + own + other));
                sum += f64::from(ring * weight);
            }
            (sum * 2.0 * f64::from(PI) / (N_Z * N_PHI) as f64) as f32
        })
    })
});

#[cfg(test)]
mod tests {
    use glam::vec3;

    use super::*;

    #[test]
    fn the_table_agrees_with_a_fine_quadrature() {
        // Midpoint sums of 800 × 800 in f64, made apart from this program (see the formula above).
        for (alpha, at) in [
            (0.04, [(0.05, 0.8126), (0.3, 0.1466), (0.5, 0.0333)]),
            (0.25, [(0.05, 0.6798), (0.3, 0.3214), (0.75, 0.0890)]),
            (1.0, [(0.05, 0.8272), (0.5, 0.3563), (1.0, 0.1638)]),
        ] {
            for (mu, wanted) in at {
                let got = ALBEDO.look_up(mu, alpha);
                assert!((got - wanted).abs() < 5e-3, "mu {mu} alpha {alpha}: {got} for {wanted}");
            }
        }
    }

    #[test]
    fn black_is_no_sheen() {
        assert!(Sheen::new(Rgb::ZERO, 0.5).is_none());
        let velvet = Sheen::new(vec3(0.0, 0.5, 0.0), 0.0).unwrap();
        assert!(velvet.evaluate(Vec3::Z, vec3(0.6, 0.0, 0.8)).is_finite());
    }
}
