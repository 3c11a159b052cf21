//! Photographers and tripods: what one view shows near its own camera and another does not.
//!
//! On blocks of 1.4° two views disagree where they differ by more than 30 % and 4 σ. Regions of such
//! blocks (thin lines are edges a little aside) that lie clearly nearer to the one's camera than to the
//! other's are left to the other.

use glam::DVec3;

use super::Layer;
use crate::bracket::Validity;
use crate::conventions::luminance;
use crate::photo::Image;
use crate::probe::compact_lights::compact_lights;
use crate::probe::fill::regions;
use crate::probe::panorama::Panorama;

/// Blocks along a row.
const BLOCKS: usize = 256;
const RELATIVE: f64 = 0.3;
const SIGMAS: f64 = 4.0;
/// Smaller regions (2.5° across) change nothing, sr.
const LEAST_SR: f64 = 1.5e-3;
/// A person's middle is within this of the camera's direction, and no part beyond the second.
const NEAR_RAD: f64 = 45.0 * std::f64::consts::PI / 180.0;
const REACH_RAD: f64 = 60.0 * std::f64::consts::PI / 180.0;
/// How much nearer to the one camera than to the other.
const NEARER_RAD: f64 = 10.0 * std::f64::consts::PI / 180.0;

/// Marks what belongs to photographers as not usable; the solid angle for each layer, sr.
pub(super) fn leave_out(layers: &mut [Layer]) -> Vec<f64> {
    let grid = Panorama::from_radiance(Image::filled(BLOCKS, BLOCKS / 2, Default::default()));
    let blocks: Vec<Vec<Option<Block>>> = layers.iter().map(blocks).collect();
    let mut drop: Vec<Image<bool>> =
        layers.iter().map(|_| Image::filled(BLOCKS, BLOCKS / 2, false)).collect();
    for i in 0..layers.len() {
        for j in i + 1..layers.len() {
            for region in regions(&disagreement(&blocks[i], &blocks[j])) {
                if let Some(of_first) = whose(&grid, &region, &layers[i], &layers[j]) {
                    let k = if of_first { i } else { j };
                    let camera = layers[k].toward_camera.unwrap_or(DVec3::Y);
                    for &block in &region {
                        let d = grid.direction(block % BLOCKS, block / BLOCKS);
                        drop[k].pixels_mut()[block] |= d.angle_between(camera) < REACH_RAD;
                    }
                }
            }
        }
    }
    layers.iter_mut().zip(&drop).map(|(layer, drop)| layer.leave(drop)).collect()
}

/// Whether a region belongs to the first's photographer; `None` if to nobody's.
fn whose(grid: &Panorama, region: &[usize], first: &Layer, second: &Layer) -> Option<bool> {
    let (mut middle, mut size) = (DVec3::ZERO, 0.0);
    for &block in region {
        let omega = grid.solid_angle(block / BLOCKS);
        middle += omega * grid.direction(block % BLOCKS, block / BLOCKS);
        size += omega;
    }
    let middle = middle.try_normalize().filter(|_| size >= LEAST_SR)?;
    let off = |layer: &Layer| {
        layer.toward_camera.map_or(std::f64::consts::PI, |d| d.angle_between(middle))
    };
    let (a, b) = (off(first), off(second));
    (a.min(b) < NEAR_RAD && (a - b).abs() > NEARER_RAD).then_some(a < b)
}

#[derive(Clone, Copy)]
struct Block {
    light: f64,
    variance: f64,
}

/// Mean luminance of blocks that are usable for the most part and hold no light.
fn blocks(layer: &Layer) -> Vec<Option<Block>> {
    let panorama = &layer.panorama;
    let (w, h) = (panorama.width(), panorama.height());
    // A lamp that one view clips or does not see at all is no person.
    let mut light = panorama.validity.map(|class| *class == Validity::LowerBound);
    for i in compact_lights(panorama).iter().flat_map(|found| &found.texels) {
        light.pixels_mut()[*i] = true;
    }
    let mut sums = vec![(0.0, 0.0, 0usize, 0usize); BLOCKS * BLOCKS / 2];
    for y in 0..h {
        for x in 0..w {
            let sum = &mut sums[y * (BLOCKS / 2) / h * BLOCKS + x * BLOCKS / w];
            sum.3 += 1;
            if layer.usable[(x, y)] && !light[(x, y)] {
                sum.0 += f64::from(luminance(panorama.radiance[(x, y)]));
                sum.1 += f64::from(luminance(panorama.variance[(x, y)]));
                sum.2 += 1;
            }
        }
    }
    let block = |&(light, variance, used, all): &(f64, f64, usize, usize)| {
        let n = used as f64;
        (10 * used >= 9 * all && used > 0)
            .then(|| Block { light: light / n, variance: variance / (n * n) })
    };
    sums.iter().map(block).collect()
}

/// Blocks that differ, thin lines left out.
fn disagreement(a: &[Option<Block>], b: &[Option<Block>]) -> Image<bool> {
    let differ = Image::from_fn(BLOCKS, BLOCKS / 2, |x, y| {
        let at = y * BLOCKS + x;
        a[at].zip(b[at]).is_some_and(|(a, b)| {
            let apart = (a.light - b.light).abs();
            let sigma = (a.variance + b.variance).sqrt();
            apart > RELATIVE * a.light.max(b.light) && apart > SIGMAS * sigma
        })
    });
    let around = |marked: &Image<bool>, x: usize, y: usize| {
        let rows = y.saturating_sub(1)..(y + 2).min(BLOCKS / 2);
        rows.flat_map(|v| [BLOCKS - 1, 0, 1].map(|k| ((x + k) % BLOCKS, v)))
            .filter(|&at| marked[at])
            .count()
    };
    let solid = Image::from_fn(BLOCKS, BLOCKS / 2, |x, y| around(&differ, x, y) >= 7);
    Image::from_fn(BLOCKS, BLOCKS / 2, |x, y| around(&solid, x, y) > 0)
}

impl Layer {
    /// Leaves the marked blocks and those round them to the other layers; the solid angle, sr.
    fn leave(&mut self, drop: &Image<bool>) -> f64 {
        let panorama = &self.panorama;
        let (w, h) = (panorama.width(), panorama.height());
        let mut left = 0.0;
        for y in 0..h {
            for x in 0..w {
                if drop[(x * BLOCKS / w, y * (BLOCKS / 2) / h)] && self.usable[(x, y)] {
                    self.usable[(x, y)] = false;
                    left += panorama.solid_angle(y);
                }
            }
        }
        left
    }
}
