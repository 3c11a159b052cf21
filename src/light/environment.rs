//! Light from far away: a lat-long picture as piecewise constant radiance that can be sampled.
//!
//! Density of a texel ∝ max(0, L − L̄) with L = max(R, G, B) and L̄ its solid-angle mean: MIS
//! compensation (Karlík, Šik, Vévoda, Skřivan, Křivánek 2019); it must be paired with BSDF sampling.
//! Inside a texel a direction is uniform in longitude and in the cosine of the polar angle, with the
//! texel's exact solid angle, so poles and seam need no care. Look-up is by the nearest texel: pdf and
//! radiance live on the same cells.

use std::f64::consts::PI;

use glam::{DMat3, DQuat, DVec2, DVec3, Mat3, Vec3, Vec4};
use rayon::prelude::*;

use super::LightError;
use super::patch::{Patch, ring_areas};
use super::table::GridTable;
use crate::conventions::{Rgb, lat_long_solid_angle};
use crate::photo::Image;

/// A direction drawn from the environment's table.
#[derive(Clone, Copy, Debug)]
pub struct Draw {
    /// Unit, world axes.
    pub direction: Vec3,
    pub radiance: Rgb,
    /// Per steradian.
    pub pdf: f32,
}

/// A lat-long environment, world axes outside, ready to be sampled.
///
/// # Guarantees
/// Every radiance is finite and not negative; every pdf is finite.
#[derive(Clone, Debug)]
pub struct Environment {
    width: usize,
    height: usize,
    /// Radiance and, in `w`, density per steradian.
    texels: Vec<Vec4>,
    table: Option<GridTable>,
    /// Cosine of the polar angle at the upper edge of each row, and −1 at the end.
    row_cosines: Vec<f64>,
    world_from_map: Mat3,
    map_from_world: Mat3,
}

impl Environment {
    /// Prepares `radiance` (lat-long, `conventions`); `world_from_map` turns its axes into the world.
    ///
    /// NaN, infinite and negative channels become 0. Any size with a texel is legal.
    pub fn new(
        radiance: &Image<Rgb>,
        world_from_map: DQuat,
        compensated: bool,
    ) -> Result<Self, LightError> {
        let (width, height) = (radiance.width(), radiance.height());
        if width == 0 || height == 0 {
            return Err(LightError::Empty { width, height });
        }
        let mut texels: Vec<Vec4> =
            radiance.pixels().iter().map(|&l| repair(l).extend(0.0)).collect();
        let table = fill_densities(&mut texels, width, height, compensated);
        let rotation = DMat3::from_quat(world_from_map.normalize());
        Ok(Self {
            width,
            height,
            texels,
            table,
            row_cosines: row_cosines(height),
            world_from_map: rotation.as_mat3(),
            map_from_world: rotation.transpose().as_mat3(),
        })
    }

    /// The same radiance from everywhere.
    pub fn constant(radiance: Rgb) -> Self {
        Self {
            width: 1,
            height: 1,
            texels: vec![repair(radiance).extend(0.0)],
            table: None,
            row_cosines: row_cosines(1),
            world_from_map: Mat3::IDENTITY,
            map_from_world: Mat3::IDENTITY,
        }
    }

    /// The same radiance, drawn in proportion to all of it.
    pub(super) fn with_whole_table(mut self) -> Self {
        self.table = fill_densities(&mut self.texels, self.width, self.height, false);
        self
    }

    /// The same radiance, never drawn.
    pub(super) fn without_table(mut self) -> Self {
        for texel in &mut self.texels {
            texel.w = 0.0;
        }
        Self { table: None, ..self }
    }

    /// Width and height of the map, texels.
    pub(super) fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// The map's radiance, row by row.
    pub(super) fn radiance(&self) -> Vec<Rgb> {
        self.texels.iter().map(|t| t.truncate()).collect()
    }

    pub(super) fn world_from_map(&self) -> Mat3 {
        self.world_from_map
    }

    /// False if the table is empty: then only BSDF sampling finds this light.
    pub fn can_be_sampled(&self) -> bool {
        self.table.is_some()
    }

    pub fn is_dark(&self) -> bool {
        self.texels.iter().all(|t| t.truncate() == Vec3::ZERO)
    }

    /// Draws a direction; `u` in [0, 1)². `None` if the table is empty.
    pub fn sample(&self, u: DVec2) -> Option<Draw> {
        let cell = self.table.as_ref()?.draw(u);
        let longitude = (0.5 - (cell.column as f64 + cell.inside.x) / self.width as f64) * 2.0 * PI;
        let (top, bottom) = (self.row_cosines[cell.row], self.row_cosines[cell.row + 1]);
        let y = top + (bottom - top) * cell.inside.y;
        let radius = ((1.0 - y) * (1.0 + y)).max(0.0).sqrt();
        let (sin, cos) = (longitude as f32).sin_cos();
        let direction = Vec3::new(radius as f32 * sin, y as f32, radius as f32 * cos);
        let texel = self.texels[cell.row * self.width + cell.column];
        Some(Draw {
            direction: (self.world_from_map * direction).normalize(),
            radiance: texel.truncate(),
            pdf: texel.w,
        })
    }

    /// Radiance from `direction` (unit, world axes) and the density with which it would be drawn.
    pub fn evaluate(&self, direction: Vec3) -> (Rgb, f32) {
        let texel = self.texels[self.texel_at(direction)];
        (texel.truncate(), texel.w)
    }

    /// Irradiance of an unoccluded plane with unit `normal` (world axes).
    ///
    /// Closed form for every texel above the plane, [`Patch::cosine_integral`] along its horizon. Rows go in parallel
    /// and are summed in order.
    pub fn irradiance(&self, normal: DVec3) -> DVec3 {
        let n = self.map_from_world.as_dmat3() * normal;
        let edges: Vec<(f64, f64)> = (0..=self.width)
            .map(|i| ((0.5 - i as f64 / self.width as f64) * 2.0 * PI).sin_cos())
            .collect();
        let rows: Vec<DVec3> = (0..self.height)
            .into_par_iter()
            .map(|row| self.row_irradiance(row, n, &edges))
            .collect();
        rows.into_iter().sum()
    }

    fn row_irradiance(&self, row: usize, n: DVec3, edges: &[(f64, f64)]) -> DVec3 {
        let cosines = [self.row_cosines[row], self.row_cosines[row + 1]];
        let (ring, lift) = ring_areas(cosines);
        let (_, radius) = self.patch(0, row).bounding_cap();
        let middle = (0.5 * (cosines[0].acos() + cosines[1].acos())).sin_cos();
        let slice = 2.0 * PI / self.width as f64;
        let mut sum = DVec3::ZERO;
        for column in 0..self.width {
            let l = self.texels[row * self.width + column].truncate().as_dvec3();
            if l == DVec3::ZERO {
                continue;
            }
            let ((s0, c0), (s1, c1)) = (edges[column], edges[column + 1]);
            // The chord's middle points at the texel's middle longitude, if the texel is narrow.
            let toward =
                DVec3::new(0.5 * (s0 + s1) * middle.0, middle.1, 0.5 * (c0 + c1) * middle.0);
            let elevation_sine = n.dot(toward);
            let narrow = self.width >= 64;
            sum += l * if narrow && elevation_sine > 1.1 * radius + 1e-3 {
                n.dot(DVec3::new((c1 - c0) * ring, lift * slice, (s0 - s1) * ring))
            } else if narrow && elevation_sine < -1.1 * radius - 1e-3 {
                0.0
            } else {
                self.patch(column, row).cosine_integral(n)
            };
        }
        sum
    }

    /// Flux ∫ L dω of the whole sphere.
    pub fn flux(&self) -> DVec3 {
        self.texels
            .iter()
            .enumerate()
            .map(|(i, t)| {
                let row = i / self.width;
                t.truncate().as_dvec3() * lat_long_solid_angle(row, self.width, self.height)
            })
            .sum()
    }

    fn patch(&self, column: usize, row: usize) -> Patch {
        Patch::new(self.width, self.height, &self.row_cosines, column, row)
    }

    fn texel_at(&self, direction: Vec3) -> usize {
        let d = self.map_from_world * direction;
        let longitude = d.x.atan2(d.z);
        let polar = d.x.hypot(d.z).atan2(d.y);
        let column = (0.5 - longitude / std::f32::consts::TAU) * self.width as f32;
        let row = polar / std::f32::consts::PI * self.height as f32;
        // Longitude −π is the end of the last column, which is the beginning of the first.
        let column = if column >= self.width as f32 { 0 } else { column as usize };
        (row as usize).min(self.height - 1) * self.width + column
    }
}

/// NaN, infinite and negative channels become 0.
pub(super) fn repair(l: Rgb) -> Rgb {
    l.map(|c| if c.is_finite() && c > 0.0 { c } else { 0.0 })
}

fn row_cosines(height: usize) -> Vec<f64> {
    (0..=height).map(|j| (PI * j as f64 / height as f64).cos()).collect()
}

/// Writes each texel's density into its `w` and builds the table that draws by it.
fn fill_densities(
    texels: &mut [Vec4],
    width: usize,
    height: usize,
    compensated: bool,
) -> Option<GridTable> {
    let strength = |t: &Vec4| f64::from(t.truncate().max_element());
    let solid_angles: Vec<f64> =
        (0..height).map(|row| lat_long_solid_angle(row, width, height)).collect();
    let flux: f64 =
        texels.iter().enumerate().map(|(i, t)| strength(t) * solid_angles[i / width]).sum();
    // Rounding must not leave a constant picture with a table of noise.
    let floor = if compensated { flux / (4.0 * PI) * (1.0 + 1e-6) } else { 0.0 };
    let weights: Vec<f64> = texels
        .iter()
        .enumerate()
        .map(|(i, t)| (strength(t) - floor).max(0.0) * solid_angles[i / width])
        .collect();
    let total: f64 = weights.iter().sum();
    let table = GridTable::new(width, &weights)?;
    for (i, texel) in texels.iter_mut().enumerate() {
        texel.w = (weights[i] / (total * solid_angles[i / width])) as f32;
    }
    Some(table)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Counter-based uniform numbers, enough for tests (Jarzynski & Olano 2020, pcg2d).
    fn uniform(i: u32) -> DVec2 {
        let mut v = [i.wrapping_mul(1_664_525).wrapping_add(1_013_904_223), i ^ 0x9e37_79b9];
        for _ in 0..2 {
            v[0] = v[0].wrapping_mul(1_664_525).wrapping_add(v[1].wrapping_mul(0x85eb_ca6b) | 1);
            v[0] ^= v[0] >> 16;
            v[1] = v[1].wrapping_mul(1_664_525).wrapping_add(v[0].wrapping_mul(0xc2b2_ae35) | 1);
            v[1] ^= v[1] >> 15;
        }
        DVec2::new(f64::from(v[0]) / 4_294_967_296.0, f64::from(v[1]) / 4_294_967_296.0)
    }

    fn sunny(width: usize, height: usize) -> Image<Rgb> {
        Image::from_fn(width, height, |i, j| {
            let sky = if j < height / 2 { 1.0 + 0.5 * (i as f32 * 0.3).sin() } else { 0.2 };
            let sun = if (i, j) == (width / 3, height / 5) { 500.0 } else { 0.0 };
            Rgb::new(sky + sun, 0.8 * sky + sun, 1.2 * sky + 0.9 * sun)
        })
    }

    fn environment(radiance: &Image<Rgb>, compensated: bool) -> Environment {
        Environment::new(radiance, DQuat::IDENTITY, compensated).unwrap()
    }

    /// Largest χ² accepted at p = 0.001 with `n` degrees of freedom (Wilson & Hilferty 1931).
    fn chi_square_limit(n: f64) -> f64 {
        n * (1.0 - 2.0 / (9.0 * n) + 3.0902 * (2.0 / (9.0 * n)).sqrt()).powi(3)
    }

    /// χ² of 1e6 draws against the exact mass of 64 × 32 bins; false alarm 0.001 each.
    fn assert_draws_follow_pdf(env: &Environment) {
        const N: u32 = 1_000_000;
        let (bins_x, bins_y) = (64, 32);
        let bin_of = |d: Vec3| {
            let p = crate::conventions::lat_long_pixel(d.as_dvec3(), bins_x, bins_y);
            let x = ((p.x + 0.5) as usize).min(bins_x - 1);
            ((p.y + 0.5) as usize).min(bins_y - 1) * bins_x + x
        };
        let mut expected = vec![0.0; bins_x * bins_y];
        for row in 0..env.height {
            for column in 0..env.width {
                let solid_angle = lat_long_solid_angle(row, env.width, env.height);
                // The test's pictures are made of whole texels per bin.
                let bin = (row * bins_y / env.height) * bins_x + column * bins_x / env.width;
                expected[bin] +=
                    f64::from(env.texels[row * env.width + column].w) * solid_angle * f64::from(N);
            }
        }
        let mut counts = vec![0.0; bins_x * bins_y];
        for i in 0..N {
            let draw = env.sample(uniform(i)).unwrap();
            assert!(draw.pdf > 0.0 && (draw.direction.length() - 1.0).abs() < 1e-5);
            counts[bin_of(draw.direction)] += 1.0;
        }
        let (mut chi, mut cells) = (0.0, 0.0);
        let (mut pooled_e, mut pooled_c) = (0.0, 0.0);
        for (e, c) in expected.iter().zip(&counts) {
            if *e >= 5.0 {
                chi += (c - e) * (c - e) / e;
                cells += 1.0;
            } else {
                pooled_e += e;
                pooled_c += c;
            }
        }
        // A direction within rounding of a texel's edge may be counted next door.
        assert!(
            (pooled_c - pooled_e).abs() < 5.0 * pooled_e.sqrt() + 60.0,
            "{pooled_c} {pooled_e}"
        );
        if cells > 1.0 {
            assert!(chi < chi_square_limit(cells - 1.0), "chi-square {chi} with {cells} bins");
        }
    }

    #[test]
    fn draws_follow_the_density_with_and_without_compensation() {
        assert_draws_follow_pdf(&environment(&sunny(128, 64), true));
        assert_draws_follow_pdf(&environment(&sunny(128, 64), false));
    }

    #[test]
    fn hot_texels_at_poles_seam_and_corner_are_drawn_and_looked_up() {
        for (i, j) in [(5, 0), (77, 63), (0, 20), (127, 20), (0, 0), (127, 63)] {
            let picture = Image::from_fn(128, 64, |x, y| {
                if (x, y) == (i, j) { Rgb::splat(1000.0) } else { Rgb::splat(0.5) }
            });
            let env = environment(&picture, true);
            let hits = (0..2000)
                .filter(|&k| {
                    let draw = env.sample(uniform(k)).unwrap();
                    assert!(draw.radiance == Rgb::splat(1000.0) && draw.pdf.is_finite());
                    env.evaluate(draw.direction).0 == draw.radiance
                })
                .count();
            // f32 directions within rounding of the edge may look up a neighbour.
            assert!(hits > 1990, "({i}, {j}): {hits} of 2000 look up the texel they came from");
        }
    }

    #[test]
    fn density_integrates_to_one() {
        for (w, h) in [(128, 64), (7, 5), (1, 9), (9, 1), (1024, 512)] {
            for compensated in [true, false] {
                let env = environment(&sunny(w, h), compensated);
                let sum: f64 = env
                    .texels
                    .iter()
                    .enumerate()
                    .map(|(i, t)| f64::from(t.w) * lat_long_solid_angle(i / w, w, h))
                    .sum();
                assert!((sum - 1.0).abs() < 1e-6 || !env.can_be_sampled(), "{w} x {h}: {sum}");
            }
        }
    }

    #[test]
    fn constant_light_has_no_table_and_irradiance_pi() {
        for (w, h) in [(1, 1), (1, 7), (9, 1), (5, 3), (64, 32)] {
            let env = environment(&Image::filled(w, h, Rgb::new(1.0, 2.0, 0.5)), true);
            assert!(!env.can_be_sampled(), "{w} x {h}");
            assert!(env.sample(DVec2::new(0.5, 0.5)).is_none());
            for n in [DVec3::Y, DVec3::X, DVec3::new(0.6, -0.48, 0.64)] {
                let e = env.irradiance(n);
                assert!((e.x / PI - 1.0).abs() < 2e-6, "{w} x {h}, {n}: {}", e.x / PI);
                assert!((e.y / PI - 2.0).abs() < 4e-6);
            }
        }
    }

    #[test]
    fn uniform_map_gives_pi_by_light_samples_alone() {
        // B4, B31: a mass taken for a density would give 1.27 π.
        let env = environment(&Image::filled(64, 32, Rgb::ONE), false);
        let n = Vec3::new(0.36, 0.48, 0.8);
        let count = 200_000;
        let sum: f64 = (0..count)
            .map(|k| {
                let draw = env.sample(uniform(k)).unwrap();
                f64::from(draw.radiance.x * n.dot(draw.direction).max(0.0) / draw.pdf)
            })
            .sum();
        let e = sum / f64::from(count);
        // Standard deviation of one estimate is 1.55 π/√12-like ≈ 3.6: 4σ is 0.033.
        assert!((e - PI).abs() < 0.033, "{e}");
    }

    #[test]
    fn sampled_irradiance_is_the_exact_one() {
        let picture = sunny(256, 128);
        let env = environment(&picture, false);
        let exact = env.irradiance(DVec3::Y).x;
        let count = 400_000;
        let values = (0..count).map(|k| {
            let draw = env.sample(uniform(k)).unwrap();
            f64::from(draw.radiance.x * draw.direction.y.max(0.0) / draw.pdf)
        });
        let (sum, squares) = values.fold((0.0, 0.0), |(s, q), v| (s + v, q + v * v));
        let mean = sum / f64::from(count);
        let sigma = (squares / f64::from(count) - mean * mean).sqrt() / f64::from(count).sqrt();
        assert!((mean - exact).abs() < 4.0 * sigma, "{mean} against {exact}, sigma {sigma}");
    }

    #[test]
    fn bad_texels_are_dark() {
        let mut picture = Image::filled(8, 4, Rgb::ONE);
        picture[(0, 0)] = Rgb::new(f32::NAN, 1.0, 1.0);
        picture[(3, 2)] = Rgb::new(1.0, f32::INFINITY, 1.0);
        picture[(7, 3)] = Rgb::new(-1.0, 1.0, 1.0);
        let env = environment(&picture, true);
        assert!(env.irradiance(DVec3::Y).is_finite());
    }

    #[test]
    fn darkness_is_legal() {
        let env = environment(&Image::filled(8, 4, Rgb::ZERO), true);
        assert!(env.is_dark() && !env.can_be_sampled());
        assert_eq!(env.irradiance(DVec3::Y), DVec3::ZERO);
        assert!(Environment::new(&Image::filled(0, 4, Rgb::ZERO), DQuat::IDENTITY, true).is_err());
    }

    #[test]
    fn every_lit_texel_of_an_uncompensated_map_can_be_drawn_under_a_sun() {
        // B47, G30: in f32 running sums the texels below a 3e6 sun would get density 0.
        let picture = Image::from_fn(1024, 512, |i, j| {
            if (i, j) == (300, 100) { Rgb::splat(3e6) } else { Rgb::splat(1e-2) }
        });
        let env = environment(&picture, false);
        assert!(env.texels.iter().all(|t| t.w > 0.0));
    }

    #[test]
    fn eight_compass_marks_are_found_where_they_were_drawn() {
        // G31: a rotated or mirrored probe would put the shadow on the wrong side.
        let turn = DQuat::from_rotation_y(0.7);
        let picture = Image::from_fn(64, 32, |i, j| Rgb::new((i / 8) as f32, j as f32, 0.0));
        let env = Environment::new(&picture, turn, true).unwrap();
        for k in 0..8 {
            let pixel = DVec2::new(f64::from(8 * k + 3), 11.0);
            let direction = turn * crate::conventions::lat_long_direction(pixel, 64, 32);
            let l = env.evaluate(direction.as_vec3()).0;
            assert_eq!(l, Rgb::new(k as f32, 11.0, 0.0));
        }
    }
}
