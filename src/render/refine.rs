//! From the tiles' samples to the denoiser and back.
//!
//! Two pictures are filtered, each within itself: ΔE/E₀ of every local mesh, and the objects' radiance.

use rayon::prelude::*;

use super::denoise::{Filtered, Noisy, denoise};
use super::film::{Estimate, Halves};
use super::guides::Guides;
use super::tile::{Floors, Tile};
use crate::conventions::Rgb;
use crate::photo::Image;

/// What the denoiser made of the samples.
pub struct Refinement {
    /// By tile and pixel; empty for tiles without samples.
    pub estimates: Vec<Vec<Estimate>>,
    /// Error over the influence region, root mean square.
    pub error: f64,
}

/// The rectangle that holds all tiles with samples.
struct Frame {
    x: usize,
    y: usize,
    width: usize,
    height: usize,
}

/// Filters what the tiles hold; `None` if that is nothing, or the pilot's.
pub fn refine(
    tiles: &[Tile],
    guides: &Guides,
    plate: &Image<Rgb>,
    floors: Floors,
) -> Option<Refinement> {
    let frame = frame(tiles)?;
    let halves = gather(tiles, plate, floors.dark, &frame);
    let ratio = filter(
        &halves,
        |h| h.ratio,
        |x, y| guides.local[(frame.x + x, frame.y + y)].map_or(0, |mesh| mesh as u32 + 1),
    );
    let object = filter(&halves, |h| h.object, |_, _| 1);
    let estimates: Vec<Vec<Estimate>> = tiles
        .par_iter()
        .map(|tile| {
            let refined = |k: usize| {
                let (x, y) = tile.block.pixel(k);
                let at = (x.wrapping_sub(frame.x), y.wrapping_sub(frame.y));
                let of = |(filtered, groups): &(Filtered, Image<u32>)| {
                    let group = groups.get(at.0, at.1).copied().unwrap_or(0);
                    (group != 0).then(|| (filtered.value[at], filtered.variance[at]))
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

fn frame(tiles: &[Tile]) -> Option<Frame> {
    let sampled = || tiles.iter().filter(|t| t.replicates > 0 && !t.pilot).map(|t| t.block);
    let (x, y) = (sampled().map(|b| b.x).min()?, sampled().map(|b| b.y).min()?);
    let (right, bottom) =
        (sampled().map(|b| b.x + b.width).max()?, sampled().map(|b| b.y + b.height).max()?);
    Some(Frame { x, y, width: right - x, height: bottom - y })
}

fn gather(tiles: &[Tile], plate: &Image<Rgb>, dark: f32, frame: &Frame) -> Image<Halves> {
    let mut halves = Image::filled(frame.width, frame.height, Halves::default());
    for tile in tiles.iter().filter(|tile| tile.replicates > 0 && !tile.pilot) {
        for k in 0..tile.block.n_pixels() {
            let (x, y) = tile.block.pixel(k);
            halves[(x - frame.x, y - frame.y)] = tile.halves(k, plate, dark);
        }
    }
    halves
}

/// Filters one of the two pictures; pixels that lack it get group 0.
fn filter(
    halves: &Image<Halves>,
    of: impl Fn(&Halves) -> Option<[Rgb; 2]>,
    group: impl Fn(usize, usize) -> u32,
) -> (Filtered, Image<u32>) {
    let (width, height) = (halves.width(), halves.height());
    let groups =
        Image::from_fn(
            width,
            height,
            |x, y| {
                if of(&halves[(x, y)]).is_some() { group(x, y) } else { 0 }
            },
        );
    let half = |k: usize| halves.map(|h| of(h).map_or(Rgb::ZERO, |both| both[k]));
    let filtered = denoise(&Noisy { halves: [half(0), half(1)], groups: groups.clone() });
    (filtered, groups)
}
