//! The environment in small parts, each as if its light came from one direction.
//!
//! For sums over the whole sphere where a direction may err by the width of a part: of 256 × 128 parts,
//! 1.4°. Exact integrals are [`Environment::irradiance`]'s.

use glam::{DVec2, DVec3, Vec3};
use rayon::prelude::*;

use super::environment::Environment;
use crate::conventions::{Rgb, lat_long_direction, lat_long_solid_angle};

/// A part of the sphere.
#[derive(Clone, Copy, Debug)]
pub struct Part {
    /// Of its light's middle, unit, world axes.
    pub direction: Vec3,
    /// ∫ L dω.
    pub flux: Rgb,
}

/// The environment in `columns` × `n_rows` blocks of texels, or of parts of them where it is coarser;
/// dark ones are left out.
pub fn parts(environment: &Environment, columns: usize, n_rows: usize) -> Vec<Part> {
    let (width, height) = environment.size();
    let split = [columns.div_ceil(width), n_rows.div_ceil(height)];
    let (fine_columns, fine_rows) = (width * split[0], height * split[1]);
    let (texels, turn) = (environment.radiance(), environment.world_from_map());
    let edges = |k: usize, n: usize, of: usize| k * of / n..(k + 1) * of / n;
    let part = |i: usize, j: usize| {
        let (mut flux, mut middle) = (DVec3::ZERO, DVec3::ZERO);
        for row in edges(j, n_rows, fine_rows) {
            let solid_angle = lat_long_solid_angle(row, fine_columns, fine_rows);
            for column in edges(i, columns, fine_columns) {
                let l = texels[row / split[1] * width + column / split[0]].as_dvec3() * solid_angle;
                let at = DVec2::new(column as f64, row as f64);
                flux += l;
                middle += lat_long_direction(at, fine_columns, fine_rows) * l.max_element();
            }
        }
        let direction = turn * middle.try_normalize()?.as_vec3();
        Some(Part { direction: direction.normalize(), flux: flux.as_vec3() })
    };
    let rows = (0..n_rows).into_par_iter();
    rows.flat_map_iter(|j| {
        let part = &part;
        (0..columns).filter_map(move |i| part(i, j))
    })
    .collect()
}

#[cfg(test)]
mod tests {
    use glam::DQuat;

    use super::*;
    use crate::photo::Image;

    #[test]
    fn parts_hold_all_the_light_and_nearly_its_irradiance() {
        let bright = |i: usize, j: usize| if (i, j) == (40, 9) { 500.0 } else { 1.0 + j as f32 };
        let fine = Image::from_fn(300, 150, |i, j| Rgb::splat(bright(i / 4, j / 4)));
        let coarse = Image::from_fn(3, 2, |i, j| Rgb::splat((i + 4 * j) as f32));
        for picture in [fine, coarse] {
            let map = Environment::new(&picture, DQuat::from_rotation_x(0.7), false).unwrap();
            let parts = parts(&map, 256, 128);
            let flux: DVec3 = parts.iter().map(|part| part.flux.as_dvec3()).sum();
            assert!((flux / map.flux() - 1.0).abs().max_element() < 1e-5);
            for normal in [Vec3::Y, Vec3::X, Vec3::new(-0.6, 0.0, 0.8)] {
                let light = |part: &Part| part.flux * normal.dot(part.direction).max(0.0);
                let sum: Rgb = parts.iter().map(light).sum();
                let exact = map.irradiance(normal.as_dvec3()).as_vec3();
                // A cosine that errs by a part's 1.4° at most, and by chance to either side.
                assert!((sum / exact - 1.0).abs().max_element() < 3e-3, "{sum} for {exact}");
            }
        }
    }
}
