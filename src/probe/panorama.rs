//! Light arriving at a place from every direction, as a lat-long picture.

use glam::{DQuat, DVec3};

use crate::bracket::Validity;
use crate::conventions::{Rgb, lat_long_direction, lat_long_pixel, lat_long_solid_angle};
use crate::photo::Image;

/// Light arriving at a place from every direction, as a lat-long picture (`conventions`).
#[derive(Clone, Debug)]
pub struct Panorama {
    /// Radiance in the plate's own scale, 2N × N texels.
    pub radiance: Image<Rgb>,
    /// Variance of `radiance` per channel.
    pub variance: Image<Rgb>,
    pub validity: Image<Validity>,
    /// Share of each texel that the probe really saw, 0…1.
    pub coverage: Image<f32>,
    /// Takes a direction of the picture's axes to the world.
    pub world_from_panorama: DQuat,
    /// Where in the world the light was measured, metres.
    pub place: DVec3,
}

impl Panorama {
    /// A panorama of exactly known radiance, its axes the world's, at the world's origin.
    pub fn from_radiance(radiance: Image<Rgb>) -> Self {
        let (width, height) = (radiance.width(), radiance.height());
        Self {
            radiance,
            variance: Image::filled(width, height, Rgb::ZERO),
            validity: Image::filled(width, height, Validity::Measured),
            coverage: Image::filled(width, height, 1.0),
            world_from_panorama: DQuat::IDENTITY,
            place: DVec3::ZERO,
        }
    }

    pub fn width(&self) -> usize {
        self.radiance.width()
    }

    pub fn height(&self) -> usize {
        self.radiance.height()
    }

    /// World direction (unit) of the centre of texel (`x`, `y`).
    pub fn direction(&self, x: usize, y: usize) -> DVec3 {
        let pixel = glam::DVec2::new(x as f64, y as f64);
        self.world_from_panorama * lat_long_direction(pixel, self.width(), self.height())
    }

    /// Solid angle (sr) of each texel in row `y`.
    pub fn solid_angle(&self, y: usize) -> f64 {
        lat_long_solid_angle(y, self.width(), self.height())
    }

    /// Radiance from the world direction `direction` (any length but zero), bilinear.
    ///
    /// Columns wrap; across a pole the neighbour is the same row half a turn away. Mixes texels of
    /// all validity classes, as light does.
    pub fn radiance(&self, direction: DVec3) -> Rgb {
        let (w, h) = (self.width() as i64, self.height() as i64);
        let p = lat_long_pixel(
            self.world_from_panorama.conjugate() * direction,
            self.width(),
            self.height(),
        );
        let (x, y) = (p.x.floor(), p.y.floor());
        let (fx, fy) = ((p.x - x) as f32, (p.y - y) as f32);
        let texel = |x: i64, y: i64| {
            let (x, y) = match y {
                y if y < 0 => (x + w / 2, 0),
                y if y >= h => (x + w / 2, h - 1),
                y => (x, y),
            };
            self.radiance[(x.rem_euclid(w) as usize, y as usize)]
        };
        let (x, y) = (x as i64, y as i64);
        let top = texel(x, y).lerp(texel(x + 1, y), fx);
        top.lerp(texel(x, y + 1).lerp(texel(x + 1, y + 1), fx), fy)
    }

    /// Irradiance on a surface with the unit normal `normal` (world): `∫ L max(0, n·ω) dω`.
    ///
    /// Exact for radiance constant in each texel (the texel's first moment in closed form), but
    /// for the texels that the horizon cuts.
    pub fn irradiance(&self, normal: DVec3) -> Rgb {
        let normal = self.world_from_panorama.conjugate() * normal;
        let columns: Vec<[f64; 2]> = (0..self.width()).map(|x| self.column_moment(x)).collect();
        let mut sum = DVec3::ZERO;
        for y in 0..self.height() {
            let (level, up) = self.row_moment(y);
            let mut row = DVec3::ZERO;
            for (l, [x, z]) in self.radiance.row(y).iter().zip(&columns) {
                let cosine =
                    level * (x * normal.x + z * normal.z) + up * self.column_angle() * normal.y;
                row += l.as_dvec3() * cosine.max(0.0);
            }
            sum += row;
        }
        sum.as_vec3()
    }

    /// `∫ ω dω` over texel (`x`, `y`), exactly, in the picture's axes.
    pub fn first_moment(&self, x: usize, y: usize) -> DVec3 {
        let (level, up) = self.row_moment(y);
        let [east, south] = self.column_moment(x);
        DVec3::new(level * east, up * self.column_angle(), level * south)
    }

    /// Width of a column, radians.
    fn column_angle(&self) -> f64 {
        2.0 * std::f64::consts::PI / self.width() as f64
    }

    /// `∫ sin λ dλ` and `∫ cos λ dλ` over the longitudes of column `x`.
    fn column_moment(&self, x: usize) -> [f64; 2] {
        let east = (0.5 - (x + 1) as f64 / self.width() as f64) * 2.0 * std::f64::consts::PI;
        let west = east + self.column_angle();
        [east.cos() - west.cos(), west.sin() - east.sin()]
    }

    /// `∫ cos² φ dφ` and `∫ sin φ cos φ dφ` over the latitudes of row `y`.
    fn row_moment(&self, y: usize) -> (f64, f64) {
        let latitude =
            |row: usize| (0.5 - row as f64 / self.height() as f64) * std::f64::consts::PI;
        let (top, bottom) = (latitude(y), latitude(y + 1));
        let level = 0.5 * (top - bottom) + 0.25 * ((2.0 * top).sin() - (2.0 * bottom).sin());
        (level, 0.5 * (top.sin().powi(2) - bottom.sin().powi(2)))
    }

    /// Mean radiance over all directions, each by its solid angle.
    pub fn mean(&self) -> Rgb {
        let sum: DVec3 = (0..self.height())
            .map(|y| {
                let row: DVec3 = self.radiance.row(y).iter().map(|l| l.as_dvec3()).sum();
                row * self.solid_angle(y)
            })
            .sum();
        (sum / (4.0 * std::f64::consts::PI)).as_vec3()
    }

    /// Share of the sphere whose texels are of class `class`.
    pub fn share(&self, class: Validity) -> f64 {
        let sum: f64 = (0..self.height())
            .map(|y| {
                let n = self.validity.row(y).iter().filter(|&&v| v == class).count();
                n as f64 * self.solid_angle(y)
            })
            .sum();
        sum / (4.0 * std::f64::consts::PI)
    }

    /// The same light in another unit: radiance times `factor`.
    pub fn scaled(mut self, factor: f32) -> Self {
        self.radiance.pixels_mut().iter_mut().for_each(|l| *l *= factor);
        self.variance.pixels_mut().iter_mut().for_each(|v| *v *= factor * factor);
        self
    }

    /// The same light turned by `rotation` in the world; no texel is touched.
    pub fn rotated(mut self, rotation: DQuat) -> Self {
        self.world_from_panorama = (rotation * self.world_from_panorama).normalize();
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    fn constant(width: usize) -> Panorama {
        Panorama::from_radiance(Image::filled(width, width / 2, Rgb::new(1.0, 2.0, 0.5)))
    }

    /// 14 rows of a 1024 wide panorama: a disc whose edge lies between texels.
    const DISC_RAD: f64 = 14.0 * PI / 512.0;

    /// Radiance 1 within a small disc round `direction`, else 0.
    fn spot(width: usize, direction: DVec3) -> Panorama {
        let mut panorama = constant(width);
        for y in 0..width / 2 {
            for x in 0..width {
                let near = panorama.direction(x, y).angle_between(direction) < DISC_RAD;
                panorama.radiance[(x, y)] = Rgb::splat(if near { 1.0 } else { 0.0 });
            }
        }
        panorama
    }

    #[test]
    fn constant_light_gives_irradiance_pi() {
        for normal in [DVec3::Y, DVec3::X, DVec3::new(0.3, -0.8, 0.5).normalize()] {
            let e = constant(512).irradiance(normal);
            // The horizon cuts texels for slanted normals: second order in their size.
            assert!((f64::from(e.x) - PI).abs() < 1e-4, "{normal}: {e}");
            assert!((e.y / e.x - 2.0).abs() < 1e-5);
        }
        assert!((constant(64).mean() - Rgb::new(1.0, 2.0, 0.5)).length() < 1e-6);
    }

    #[test]
    fn a_disc_of_light_gives_sine_squared() {
        let panorama = spot(1024, DVec3::Y);
        let e = f64::from(panorama.irradiance(DVec3::Y).x);
        let expected = PI * DISC_RAD.sin().powi(2);
        assert!((e / expected - 1.0).abs() < 1e-6, "{e} {expected}");
        assert_eq!(panorama.irradiance(-DVec3::Y).x, 0.0);
    }

    #[test]
    fn rotation_turns_light_with_it() {
        let turn = DQuat::from_rotation_z(0.4) * DQuat::from_rotation_y(2.0);
        let panorama = spot(256, DVec3::Z);
        let turned = panorama.clone().rotated(turn);
        for d in [DVec3::Z, DVec3::X, DVec3::new(0.1, 0.1, 1.0).normalize()] {
            assert!((panorama.radiance(d) - turned.radiance(turn * d)).length() < 1e-6);
        }
        let (a, b) = (panorama.irradiance(DVec3::Z), turned.irradiance(turn * DVec3::Z));
        assert!((a - b).length() < 1e-6 * a.length());
    }

    /// methods-capture A7, A8: no half-pixel shift, no leak from nadir to zenith.
    #[test]
    fn lookup_returns_texels_at_their_centres_and_blends_across_seam_and_pole() {
        let pixels: Vec<Rgb> = (0..32).map(|k| Rgb::splat(k as f32)).collect();
        let panorama = Panorama::from_radiance(Image::from_pixels(8, 4, pixels).unwrap());
        for y in 0..4 {
            for x in 0..8 {
                let l = panorama.radiance(panorama.direction(x, y));
                assert!((l.x - (8 * y + x) as f32).abs() < 1e-5);
            }
        }
        // The zenith is the mean of two opposite texels of the top row.
        assert!(panorama.radiance(DVec3::Y).x < 8.0);
        assert!(panorama.radiance(-DVec3::Y).x >= 24.0);
        // The seam between the last and the first column of row 1, half a row above its centre line.
        let seam = lat_long_direction(glam::DVec2::new(7.5, 1.0), 8, 4);
        assert!((panorama.radiance(seam).x - (8.0 + 15.0) / 2.0).abs() < 1e-4);
    }

    #[test]
    fn scaling_scales_variance_by_the_square() {
        let mut panorama = constant(4);
        panorama.variance.pixels_mut().fill(Rgb::ONE);
        let scaled = panorama.scaled(3.0);
        assert_eq!(scaled.radiance[(0, 0)], Rgb::new(3.0, 6.0, 1.5));
        assert_eq!(scaled.variance[(0, 0)], Rgb::splat(9.0));
    }

    #[test]
    fn shares_of_the_classes_add_up() {
        let mut panorama = constant(16);
        panorama.validity.pixels_mut()[..64].fill(Validity::Filled);
        assert!((panorama.share(Validity::Filled) - 0.5).abs() < 1e-12);
        assert!((panorama.share(Validity::Measured) - 0.5).abs() < 1e-12);
    }
}
