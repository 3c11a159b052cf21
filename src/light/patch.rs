//! A piece of the sphere between two meridians and two parallels: what a lat-long texel is.
//!
//! Closed forms of the integrals that irradiance needs; only along the horizon one of the two is by
//! Gauss' rule.

use std::f64::consts::PI;

use glam::DVec3;

/// ∫ √(1 − y²) dy and ∫ y dy between two polar cosines.
pub fn ring_areas([c0, c1]: [f64; 2]) -> (f64, f64) {
    let g = |y: f64| 0.5 * (y * (1.0 - y * y).max(0.0).sqrt() + y.clamp(-1.0, 1.0).asin());
    (g(c0) - g(c1), 0.5 * (c0 * c0 - c1 * c1))
}

/// Widest slice of a patch that [`Patch::cosine_integral`] takes at once, radians. Within a slice the
/// integrand's second derivative jumps where the horizon leaves through an upper or lower edge: the
/// error of one jump is far below the cube of this.
const WIDEST_SLICE: f64 = 0.01;
/// Places and weights of Gauss' rule with three points on (−1, 1).
const GAUSS_3: [(f64, f64); 3] =
    [(-0.774_596_669_241_483_4, 5.0 / 9.0), (0.0, 8.0 / 9.0), (0.774_596_669_241_483_4, 5.0 / 9.0)];

/// ∫ max(0, n·ω) sin θ dθ along a meridian between two polar angles in (0, π), θ from the pole.
fn meridian_integral(n: DVec3, longitude: f64, polar: [f64; 2]) -> f64 {
    // n·ω = a sin θ + b cos θ, which changes its sign once, at `horizon`
    let (sin, cos) = longitude.sin_cos();
    let (a, b) = (n.x * sin + n.z * cos, n.y);
    let horizon = b.abs().atan2(if b < 0.0 { a } else { -a });
    let [from, to] = polar.map(|p| if b < 0.0 { p.max(horizon) } else { p.min(horizon) });
    let up_to = |p: f64| {
        let (sin, cos) = p.sin_cos();
        0.5 * (a * (p - sin * cos) + b * sin * sin)
    };
    (up_to(to) - up_to(from)).max(0.0)
}

/// A piece of the sphere between two longitudes and two polar cosines, map axes.
#[derive(Clone, Copy, Debug)]
pub struct Patch {
    pub longitude: [f64; 2],
    pub cosine: [f64; 2],
}

impl Patch {
    /// Texel (column, row) of a lat-long picture whose row edges have these cosines.
    pub fn new(width: usize, height: usize, cosines: &[f64], column: usize, row: usize) -> Self {
        debug_assert!(row < height);
        let at = |i: usize| (0.5 - i as f64 / width as f64) * 2.0 * PI;
        Self { longitude: [at(column), at(column + 1)], cosine: [cosines[row], cosines[row + 1]] }
    }

    /// ∫ ω dω over the patch, in closed form.
    fn vector_area(&self) -> DVec3 {
        let [l0, l1] = self.longitude;
        let (ring, lift) = ring_areas(self.cosine);
        DVec3::new((l1.cos() - l0.cos()) * ring, lift * (l0 - l1), (l0.sin() - l1.sin()) * ring)
    }

    /// ∫ max(0, n·ω) dω over the patch: in closed form along every meridian, and all over where the
    /// patch does not meet the horizon; across the meridians Gauss' rule with three points a slice.
    pub fn cosine_integral(&self, n: DVec3) -> f64 {
        let (middle, radius) = self.bounding_cap();
        let elevation = n.dot(middle).clamp(-1.0, 1.0).asin();
        if elevation <= -radius {
            return 0.0;
        }
        if elevation >= radius {
            return n.dot(self.vector_area()).max(0.0);
        }
        let polar = self.cosine.map(|c| c.clamp(-1.0, 1.0).acos());
        let [l0, l1] = self.longitude;
        let slices = ((l0 - l1).abs() / WIDEST_SLICE).ceil().max(1.0);
        let half = 0.5 * (l0 - l1) / slices;
        let slice = |k: usize| {
            let centre = l1 + (2 * k + 1) as f64 * half;
            GAUSS_3.map(|(at, weight)| weight * meridian_integral(n, centre + at * half, polar))
        };
        half.abs() * (0..slices as usize).flat_map(slice).sum::<f64>()
    }

    /// A cap that holds the patch: unit direction and angular radius.
    pub fn bounding_cap(&self) -> (DVec3, f64) {
        let at = |longitude: f64, polar: f64| {
            DVec3::new(longitude.sin() * polar.sin(), polar.cos(), longitude.cos() * polar.sin())
        };
        let polar = self.cosine.map(|c| c.clamp(-1.0, 1.0).acos());
        let middle = 0.5 * (polar[0] + polar[1]);
        let half_width = 0.5 * (self.longitude[0] - self.longitude[1]).abs();
        let half_height = 0.5 * (polar[1] - polar[0]);
        let widest = if polar[0] < 0.5 * PI && polar[1] > 0.5 * PI {
            1.0
        } else {
            polar[0].sin().max(polar[1].sin())
        };
        let longitude = 0.5 * (self.longitude[0] + self.longitude[1]);
        (at(longitude, middle), (half_width * widest + half_height).min(PI))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Patches of a 16 × 8 map: large, so that every way the horizon can run through one is met.
    fn patches() -> Vec<Patch> {
        let cosines: Vec<f64> = (0..=8).map(|i| (PI * f64::from(i) / 8.0).cos()).collect();
        (0..128).map(|k| Patch::new(16, 8, &cosines, k % 16, k / 16)).collect()
    }

    #[test]
    fn the_whole_sphere_gives_pi_whatever_the_normal() {
        let turned = DVec3::new(0.36, 0.48, 0.8);
        for n in [DVec3::Y, -DVec3::Y, DVec3::X, -DVec3::X, DVec3::Z, turned, -turned] {
            let sum: f64 = patches().iter().map(|patch| patch.cosine_integral(n)).sum();
            assert!((sum / PI - 1.0).abs() < 1e-6, "{n}: {}", sum / PI);
        }
    }

    #[test]
    fn each_patch_is_the_sum_of_many_small_directions() {
        const N: usize = 400;
        let step = |k: usize| (k as f64 + 0.5) / N as f64;
        for n in [DVec3::new(0.36, 0.48, 0.8), DVec3::new(0.6, -0.1, -0.79), DVec3::X] {
            let n = n.normalize();
            for patch in patches() {
                let ([l0, l1], [c0, c1]) = (patch.longitude, patch.cosine);
                let cosine_at = |k: usize| {
                    let (cosine, longitude) =
                        (c0 + (c1 - c0) * step(k % N), l0 + (l1 - l0) * step(k / N));
                    let sine = (1.0 - cosine * cosine).sqrt();
                    n.dot(DVec3::new(longitude.sin() * sine, cosine, longitude.cos() * sine))
                        .max(0.0)
                };
                let mean = (0..N * N).map(cosine_at).sum::<f64>() / (N * N) as f64;
                let expected = mean * (l0 - l1) * (c0 - c1);
                // The midpoint rule with 400² points is good to 1e-5 of a patch's 0.15 sr.
                let found = patch.cosine_integral(n);
                assert!((found - expected).abs() < 2e-6, "{n} {patch:?}: {found}, {expected}");
            }
        }
    }
}
