//! The diffuse light of a panorama: irradiance for every normal, `E(n) = ∫ L(ω) max(0, n·ω) dω`.
//!
//! Exact sums, no spherical harmonics: texels are gathered into at most 256 × 128 blocks, each as its
//! first moment `M = ∫ L ω dω`. A block wholly above a surface's horizon gives `n·M` exactly, whatever is in
//! it, suns too. Blocks that the horizon itself cuts give `max(0, n·M)`, which for constant light is wrong
//! by less than 1e-4 of π L.

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use super::panorama::Panorama;
use crate::conventions::{Rgb, lat_long_direction};
use crate::photo::Image;

/// Columns of blocks, at most.
const BLOCKS: usize = 256;
/// Sums that run beside each other: what a processor's vectors hold.
const LANES: usize = 8;

/// First moments of one channel, as a processor likes them: x, y and z of all blocks in rows.
#[derive(Default)]
struct Moments {
    x: Vec<f32>,
    y: Vec<f32>,
    z: Vec<f32>,
}

/// Irradiance for the normals of a lat-long of `width` × `width / 2` texels, in world axes: the panorama's
/// unit times sr.
pub fn irradiance_map(panorama: &Panorama, width: usize) -> Image<Rgb> {
    let height = width / 2;
    let channels = moments(panorama);
    let pixels: Vec<Rgb> = (0..width * height)
        .into_par_iter()
        .map(|k| {
            let texel = DVec2::new((k % width) as f64, (k / width) as f64);
            let normal = lat_long_direction(texel, width, height);
            let [r, g, b] = [0, 1, 2].map(|c| channels[c].irradiance(normal) as f32);
            Rgb::new(r, g, b)
        })
        .collect();
    Image::from_fn(width, height, |x, y| pixels[y * width + x])
}

/// First moments of the panorama's blocks, world axes, one list a channel.
fn moments(panorama: &Panorama) -> [Moments; 3] {
    let columns = BLOCKS.min(panorama.width());
    let rows = (BLOCKS / 2).min(panorama.height());
    let mut sums = vec![[DVec3::ZERO; 3]; columns * rows];
    for y in 0..panorama.height() {
        let row = y * rows / panorama.height();
        for x in 0..panorama.width() {
            let column = x * columns / panorama.width();
            let moment = panorama.world_from_panorama * panorama.first_moment(x, y);
            let l = panorama.radiance[(x, y)].as_dvec3();
            for (sum, l) in sums[row * columns + column].iter_mut().zip(l.to_array()) {
                *sum += moment * l;
            }
        }
    }
    [0, 1, 2].map(|c| {
        let mut channel = Moments::default();
        for block in sums.iter().map(|channels| channels[c]) {
            channel.x.push(block.x as f32);
            channel.y.push(block.y as f32);
            channel.z.push(block.z as f32);
        }
        channel
    })
}

impl Moments {
    fn irradiance(&self, normal: DVec3) -> f64 {
        let n = normal.as_vec3();
        let mut whole = 0.0;
        // f32 within a few hundred blocks, f64 over them.
        let rows = self.x.chunks(BLOCKS).zip(self.y.chunks(BLOCKS)).zip(self.z.chunks(BLOCKS));
        for ((x, y), z) in rows {
            let mut lanes = [0.0f32; LANES];
            let blocks = x.chunks(LANES).zip(y.chunks(LANES)).zip(z.chunks(LANES));
            for ((x, y), z) in blocks {
                for (((lane, x), y), z) in lanes.iter_mut().zip(x).zip(y).zip(z) {
                    *lane += (n.x * x + n.y * y + n.z * z).max(0.0);
                }
            }
            whole += lanes.iter().map(|&lane| f64::from(lane)).sum::<f64>();
        }
        whole
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;
    use std::f64::consts::PI;

    #[test]
    fn constant_light_gives_pi_everywhere() {
        for width in [64, 256, 600] {
            let light = Rgb::new(0.5, 1.0, 4.0);
            let panorama = Panorama::from_radiance(Image::filled(width, width / 2, light));
            let map = irradiance_map(&panorama, 64);
            // The horizon cuts blocks: second order in their size.
            let tolerance = 1e-4 * (256.0 / width.min(256) as f64).powi(2);
            for e in map.pixels() {
                let off = (e.as_dvec3() / (PI * light.as_dvec3()) - 1.0).abs().max_element();
                assert!(off < tolerance, "{width}: {off}");
            }
        }
    }

    #[test]
    fn one_texel_gives_a_cosine() {
        let mut radiance = Image::filled(1000, 500, Rgb::ZERO);
        radiance[(333, 111)] = Rgb::new(1e5, 2e5, 3e5);
        let turn = DQuat::from_rotation_y(0.4) * DQuat::from_rotation_x(1.0);
        let panorama = Panorama::from_radiance(radiance).rotated(turn);
        let towards = panorama.direction(333, 111);
        let flux = 1e5 * panorama.solid_angle(111);
        let map = irradiance_map(&panorama, 64);
        for y in 0..32 {
            for x in 0..64 {
                let normal = lat_long_direction(DVec2::new(x as f64, y as f64), 64, 32);
                let wanted = flux * normal.dot(towards).max(0.0);
                let e = map[(x, y)].as_dvec3();
                assert!((e.x - wanted).abs() < 1e-5 * flux, "({x}, {y}): {e} {wanted}");
                assert!((e.z - 3.0 * e.x).abs() < 1e-5 * flux);
            }
        }
    }

    #[test]
    fn it_is_the_panoramas_own_irradiance() {
        let panorama = Panorama::from_radiance(Image::from_fn(128, 64, |x, y| {
            Rgb::new((x % 7) as f32, (y % 5) as f32, (x * y % 3) as f32)
        }));
        let map = irradiance_map(&panorama, 32);
        for (x, y) in [(0, 0), (13, 9), (31, 15)] {
            let normal = lat_long_direction(DVec2::new(x as f64, y as f64), 32, 16);
            let off = (map[(x, y)] - panorama.irradiance(normal)).abs().max_element();
            assert!(off < 1e-4 * map[(x, y)].max_element(), "({x}, {y}): {off}");
        }
    }
}
