//! From the tiles' samples to the denoiser and back.
//!
//! Two pictures are filtered, each within itself: ΔE/E₀ of every local mesh, and the objects' radiance.

use rayon::prelude::*;

use super::denoise::{Filtered, Noisy, denoise};
use super::film::{Estimate, Halves};
use super::guides::{Block, Guides};
use super::tile::{Floors, Tile};
use crate::conventions::Rgb;
use crate::photo::{Image, Window};

/// What the denoiser made of the samples.
pub struct Refinement {
    /// By tile and pixel; empty for tiles without samples.
    pub estimates: Vec<Vec<Estimate>>,
    /// Error over the influence region, root mean square.
    pub error: f64,
}

/// Filters what the tiles hold; `None` if that is nothing, or the pilot's.
pub fn refine(
    tiles: &[Tile],
    guides: &Guides,
    plate: &Image<Rgb>,
    floors: Floors,
) -> Option<Refinement> {
    let sampled = tiles.iter().filter(|tile| tile.replicates > 0 && !tile.pilot);
    let frame = Block::window(sampled.map(|tile| tile.block));
    if frame.n_pixels() == 0 {
        return None;
    }
    // What has samples lies in the guides' window.
    let (left, top) = guides.window.first;
    let guide = |x: usize, y: usize| (frame.first.0 + x - left, frame.first.1 + y - top);
    let halves = gather(tiles, plate, floors.dark, frame);
    let ratio = filter(
        &halves,
        |h| (h.ratio, h.ratio_mass),
        |x, y| guides.local[guide(x, y)],
        // What is lost goes with the place; at an outline the normal would be the object's.
        |_, _| Rgb::ZERO,
    );
    let object =
        filter(&halves, |h| (h.object, h.object_mass), |_, _| 1, |x, y| guides.normal[guide(x, y)]);
    let estimates: Vec<Vec<Estimate>> = tiles
        .par_iter()
        .map(|tile| {
            let refined = |k: usize| {
                let at = frame.inside(tile.block.pixel(k));
                let of = |(filtered, groups): &(Filtered, Image<u32>)| {
                    let at = at.filter(|&at| groups[at] != 0);
                    at.map(|at| (filtered.moved[at], filtered.variance[at]))
                };
                tile.refined(k, plate, floors.dark, of(&ratio), of(&object))
            };
            (0..tile.block.n_pixels()).map_while(refined).collect()
        })
        .collect();
    let (variance, pixels) = tiles
        .par_iter()
        .zip(&estimates)
        .filter_map(|(tile, estimates)| tile.pool_estimates(estimates, plate, floors))
        .map(|noise| (noise.variance * noise.influenced, noise.influenced))
        .collect::<Vec<_>>()
        .into_iter()
        .fold((0.0, 0.0), |(v, n), (variance, pixels)| (v + variance, n + pixels));
    let error = if pixels > 0.0 { (variance / pixels).sqrt() } else { 0.0 };
    Some(Refinement { estimates, error })
}

/// Halves of the part `frame` of the picture; nothing where no tile has samples.
fn gather(tiles: &[Tile], plate: &Image<Rgb>, dark: f32, frame: Window) -> Image<Halves> {
    let mut halves = Image::filled(frame.size.0, frame.size.1, Halves::default());
    for tile in tiles.iter().filter(|tile| tile.replicates > 0 && !tile.pilot) {
        for k in 0..tile.block.n_pixels() {
            let Some(at) = frame.inside(tile.block.pixel(k)) else { continue };
            halves[at] = tile.halves(k, plate, dark);
        }
    }
    halves
}

/// Filters one of the two pictures; pixels that lack it get group 0.
fn filter(
    halves: &Image<Halves>,
    of: impl Fn(&Halves) -> (Option<[Rgb; 2]>, f32),
    group: impl Fn(usize, usize) -> u32,
    normal: impl Fn(usize, usize) -> Rgb,
) -> (Filtered, Image<u32>) {
    let (width, height) = (halves.width(), halves.height());
    let groups = Image::from_fn(width, height, |x, y| {
        if of(&halves[(x, y)]).0.is_some() { group(x, y) } else { 0 }
    });
    let half = |k: usize| halves.map(|h| of(h).0.map_or(Rgb::ZERO, |both| both[k]));
    let masses = halves.map(|h| of(h).1.max(1e-6));
    let filtered = denoise(&Noisy {
        halves: [half(0), half(1)],
        groups: groups.clone(),
        masses,
        between: halves.map(|h| h.between),
        normals: Image::from_fn(width, height, normal),
    });
    (filtered, groups)
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use crate::conventions::Rgb;
    use crate::photo::Image;
    use crate::render::test_scenes::*;
    use crate::render::{Difference, Job, Method, Stop, Wave};
    use crate::scene::AlbedoSource;

    const WIDTH: usize = 96;
    const HEIGHT: usize = 72;

    /// A matt ball on a grey ground in the sun.
    fn render(samples: u32, denoise: bool, seed: u64) -> (Difference, Wave) {
        let grey = AlbedoSource::Constant(Rgb::splat(0.5));
        let ball = sphere(Vec3::new(0.0, 0.3, 0.0), 0.3, 4);
        let scene = scene(vec![ball], matt(0.6), vec![local(ground(3.0), grey)]);
        let lights = sunny_sky(40.0, 2.0);
        let shown = lights.irradiance(Vec3::Y) * 0.5 * std::f32::consts::FRAC_1_PI;
        let plate = Image::filled(WIDTH, HEIGHT, shown);
        let camera = corner_camera(WIDTH, HEIGHT, 2.5);
        let job =
            Job { denoise, ..plain_job(&scene, &lights, &camera, &plate, Stop::Samples(samples)) };
        let (difference, wave) = finish(Method::Coupled, job, seed);
        (difference.whole(), wave)
    }

    fn values(d: &Difference) -> Vec<f64> {
        let both = d.object.pixels().iter().zip(d.difference.pixels());
        both.map(|(object, difference)| f64::from((*object + *difference).y)).collect()
    }

    fn mean_square(a: &[f64], b: &[f64]) -> f64 {
        a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>() / a.len() as f64
    }

    #[test]
    fn few_samples_come_nearer_to_the_truth_and_say_how_near() {
        let truth = values(&render(1024, false, 77).0);
        let (raw, filtered) = (render(8, false, 5), render(8, true, 5));
        assert!(raw.1.denoised.is_none());
        let gain = filtered.1.denoised.expect("eight samples gain by it");
        assert!(gain > 1.3, "{gain}");
        let before = mean_square(&values(&raw.0), &truth);
        let after = mean_square(&values(&filtered.0), &truth);
        println!("{:.5} → {:.5}, said {gain:.2}", before.sqrt(), after.sqrt());
        assert!(after < before / 2.0, "{before} {after}");
        let stated = filtered.0.stderr.pixels();
        let stated =
            stated.iter().map(|s| f64::from(s.y).powi(2)).sum::<f64>() / stated.len() as f64;
        assert!((0.5..2.0).contains(&(stated / after)), "{stated} for {after}");
        // What is moved between pixels is not lost.
        let sum = |d: &Difference| values(d).iter().sum::<f64>();
        let weight: f64 = values(&raw.0).iter().map(|v| v.abs()).sum();
        let shift = (sum(&filtered.0) - sum(&raw.0)) / weight;
        println!("shift {shift:.6}");
        assert!(shift.abs() < 1e-3, "{shift}");
    }

    #[test]
    fn many_samples_are_not_made_worse() {
        let truth = values(&render(4096, false, 77).0);
        let before = mean_square(&values(&render(256, false, 5).0), &truth);
        let after = mean_square(&values(&render(256, true, 5).0), &truth);
        println!("{:.6} → {:.6}", before.sqrt(), after.sqrt());
        assert!(after < 1.05 * before, "{before} {after}");
    }
}
