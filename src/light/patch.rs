//! A piece of the sphere between two meridians and two parallels: what a lat-long texel is.
//!
//! Closed forms of the integrals that irradiance needs; only the horizon is halved numerically.

use std::f64::consts::PI;

use glam::DVec3;

/// ∫ √(1 − y²) dy and ∫ y dy between two polar cosines.
pub fn ring_areas([c0, c1]: [f64; 2]) -> (f64, f64) {
    let g = |y: f64| 0.5 * (y * (1.0 - y * y).max(0.0).sqrt() + y.clamp(-1.0, 1.0).asin());
    (g(c0) - g(c1), 0.5 * (c0 * c0 - c1 * c1))
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

    /// ∫ max(0, n·ω) dω over the patch: closed form above the horizon, halved along it.
    pub fn cosine_integral(&self, n: DVec3, depth: u32) -> f64 {
        let (middle, radius) = self.bounding_cap();
        let elevation = n.dot(middle).clamp(-1.0, 1.0).asin();
        if elevation <= -radius {
            return 0.0;
        }
        if elevation >= radius || radius < 2e-4 || depth > 24 {
            return n.dot(self.vector_area()).max(0.0);
        }
        self.halves().iter().map(|half| half.cosine_integral(n, depth + 1)).sum()
    }

    /// Two halves, cut across the longer side.
    pub fn halves(&self) -> [Self; 2] {
        let [l0, l1] = self.longitude;
        let [c0, c1] = self.cosine;
        let (polar0, polar1) = (c0.clamp(-1.0, 1.0).acos(), c1.clamp(-1.0, 1.0).acos());
        let middle = 0.5 * (polar0 + polar1);
        if (l0 - l1) * middle.sin() > polar1 - polar0 {
            let l = 0.5 * (l0 + l1);
            [Self { longitude: [l0, l], ..*self }, Self { longitude: [l, l1], ..*self }]
        } else {
            let c = middle.cos();
            [Self { cosine: [c0, c], ..*self }, Self { cosine: [c, c1], ..*self }]
        }
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
