//! Procedural places and small random numbers for the tests of registering and merging.

use std::f64::consts::TAU;

use glam::{DQuat, DVec3};

use super::panorama::Panorama;
use crate::conventions::Rgb;
use crate::photo::Image;

/// A small generator (SplitMix64, Steele et al. 2014): tests need no more.
pub struct Random(pub u64);

impl Random {
    pub fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (TAU * self.uniform()).cos()
    }

    pub fn direction(&mut self) -> DVec3 {
        DVec3::new(self.normal(), self.normal(), self.normal()).normalize()
    }

    pub fn rotation(&mut self) -> DQuat {
        DQuat::from_xyzw(self.normal(), self.normal(), self.normal(), self.normal()).normalize()
    }

    /// A direction `sigma_rad` each way off `d`.
    pub fn near(&mut self, d: DVec3, sigma_rad: f64) -> DVec3 {
        let (u, v) = d.any_orthonormal_pair();
        (d + sigma_rad * (self.normal() * u + self.normal() * v)).normalize()
    }
}

/// A value in 0…1 for a cell of a grid, the same for the same cell.
fn hash(cell: [i64; 3], salt: u64) -> f64 {
    let mixed = cell
        .iter()
        .fold(salt, |h, &c| (h ^ c as u64).wrapping_mul(0xbf58_476d_1ce4_e5b9).rotate_left(29));
    Random(mixed).uniform()
}

/// A room of 5 × 2.7 × 4 m with a chequered floor, pictures on its walls and a lamp; by `salt` another one.
///
/// Radiance seen from `eye` in `direction`; what is seen depends on where one stands.
pub fn room(eye: DVec3, direction: DVec3, salt: u64) -> Rgb {
    let (low, high) = (DVec3::new(-2.5, -1.0, -2.0), DVec3::new(2.5, 1.7, 2.0));
    let lamp = DVec3::new(1.2, 1.2, -0.8);
    let to_lamp = lamp - eye;
    if (to_lamp - to_lamp.dot(direction) * direction).length() < 0.06
        && to_lamp.dot(direction) > 0.0
    {
        return Rgb::new(300.0, 260.0, 200.0);
    }
    // The nearest wall ahead.
    let far = |axis: usize| {
        let wall = if direction[axis] > 0.0 { high[axis] } else { low[axis] };
        if direction[axis] == 0.0 { f64::INFINITY } else { (wall - eye[axis]) / direction[axis] }
    };
    let axis = (0..3).min_by(|&a, &b| far(a).total_cmp(&far(b))).unwrap_or(0);
    let at = eye + direction * far(axis);
    let size = if axis == 1 { 0.5 } else { 0.7 };
    let cell = |k: usize| {
        if k == axis { i64::from(direction[k] > 0.0) } else { (at[k] / size).floor() as i64 }
    };
    let shade = hash([cell(0), cell(1), cell(2)], salt + axis as u64);
    let fall = 1.0 / (0.5 + (at - lamp).length_squared());
    (DVec3::new(1.0, 0.9, 0.8) * (0.1 + shade * shade) * fall).as_vec3()
}

/// A yard under an even overcast sky: no lamp anywhere, walls and hedges of random heights all round.
///
/// All of it is far away.
pub fn overcast(direction: DVec3, salt: u64) -> Rgb {
    let azimuth = direction.x.atan2(direction.z) / TAU + 0.5;
    let block = (azimuth * 14.0).floor() as i64;
    let height = 0.45 * hash([block, 0, 0], salt).powi(2);
    let elevation = direction.y.asin();
    if elevation > height {
        // Moon and Spencer's overcast sky: a third at the horizon.
        return Rgb::splat(((1.0 + 2.0 * direction.y) / 3.0) as f32);
    }
    if elevation > 0.0 {
        return Rgb::splat((0.05 + 0.25 * hash([block, 1, 0], salt)) as f32);
    }
    let paving = [
        (direction.x / (0.1 - direction.y) * 2.0).floor() as i64,
        (direction.z / (0.1 - direction.y) * 2.0).floor() as i64,
        2,
    ];
    Rgb::splat((0.12 + 0.1 * hash(paving, salt)) as f32)
}

/// What is seen of a world in all directions; 2 × 2 samples a texel.
pub fn picture(width: usize, world: impl Fn(DVec3) -> Rgb) -> Panorama {
    let mut panorama = Panorama::from_radiance(Image::filled(width, width / 2, Rgb::ZERO));
    for y in 0..width / 2 {
        for x in 0..width {
            let samples = [(-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25)];
            let sum: Rgb = samples
                .iter()
                .map(|(u, v)| {
                    let at = glam::DVec2::new(x as f64 + u, y as f64 + v);
                    world(crate::conventions::lat_long_direction(at, width, width / 2))
                })
                .sum();
            panorama.radiance[(x, y)] = sum / 4.0;
        }
    }
    panorama
}
