//! What moved between the frames of a bracket: found pixel by pixel, and taken from one frame alone.
//!
//! A frame contradicts a pixel's mean where it is more than 4 σ off; a pixel has moved where it is so
//! itself and at least 8 of the 25 around it (methods-capture C3). Edges that alignment left a fraction
//! of a pixel off are no motion.

use rayon::prelude::*;

use super::noise::Noise;
use super::stack::Stack;
use super::{Radiance, Validity};
use crate::photo::Image;

/// Half a side of the square in which neighbours must agree, px, and how many of them.
const REACH_PX: usize = 2;
const AGREEING: usize = 8;
/// Smaller regions are chance, px.
const SMALLEST_REGION_PX: usize = 25;
/// A moved thing's soft border reaches this far beyond what contradicts, px.
const BORDER_PX: usize = 2;
/// What alignment may leave, px.
const MISALIGNED_PX: f32 = 0.5;

/// Puts every moved region from the frame that shows it best, as [`Validity::Moved`]; their number of
/// pixels, and the first. `contradicted` is that of [`Stack::merge`].
pub(super) fn drop(
    stack: &Stack,
    radiance: &mut Radiance,
    contradicted: Image<bool>,
    noise: &Noise,
) -> Option<(usize, (usize, usize))> {
    let (w, h) = stack.size();
    if stack.order.len() < 2 || w <= 2 * REACH_PX || h <= 2 * REACH_PX {
        return None;
    }
    let moved = agreed(&off_the_edges(stack, radiance, contradicted, noise));
    let mut found: Vec<usize> = Vec::new();
    for region in regions(&moved) {
        if region.len() < SMALLEST_REGION_PX {
            continue;
        }
        let region = widened(&region, w, h);
        // The most light without clipping: a frame that does not show the region at all gives none.
        let light = |slot: usize| -> f64 {
            let shown = region.iter().filter_map(|&i| stack.alone(slot, i % w, i / w, noise));
            let exposure = stack.exposures[stack.order[slot]];
            shown.map(|merge| f64::from(merge.mean.y) * exposure).sum()
        };
        let lights: Vec<f64> = (0..stack.order.len()).into_par_iter().map(light).collect();
        let Some(best) = (0..lights.len()).max_by(|&a, &b| lights[a].total_cmp(&lights[b])) else {
            continue;
        };
        for &i in &region {
            // Where that frame clips, the next shorter one.
            let alone = (0..=best).rev().find_map(|slot| stack.alone(slot, i % w, i / w, noise));
            if let Some(alone) = alone {
                radiance.mean.pixels_mut()[i] = alone.mean;
                radiance.variance.pixels_mut()[i] = alone.variance;
                radiance.validity.pixels_mut()[i] = Validity::Moved;
                found.push(i);
            }
        }
    }
    found.sort_unstable();
    found.dedup();
    found.first().map(|&i| (found.len(), (i % w, i / w)))
}

/// Contradicted pixels, without those that a slight misalignment explains.
fn off_the_edges(
    stack: &Stack,
    radiance: &Radiance,
    mut contradicted: Image<bool>,
    noise: &Noise,
) -> Image<bool> {
    let (w, h) = stack.size();
    let light = |x: usize, y: usize| radiance.mean.pixels()[y * w + x].y;
    contradicted.pixels_mut().par_chunks_exact_mut(w).enumerate().for_each(|(y, row)| {
        for (x, marked) in row.iter_mut().enumerate().filter(|(_, marked)| **marked) {
            let (left, right) = (x.saturating_sub(1), (x + 1).min(w - 1));
            let (above, below) = (y.saturating_sub(1), (y + 1).min(h - 1));
            let slope = (light(right, y) - light(left, y)).hypot(light(x, below) - light(x, above));
            // Over two pixels.
            let sigma = 0.5 * slope * MISALIGNED_PX;
            *marked = stack.contradicted((x, y), light(x, y), noise, sigma);
        }
    });
    contradicted
}

/// Marked pixels most of whose neighbours are marked too.
fn agreed(marked: &Image<bool>) -> Image<bool> {
    let (w, h) = (marked.width(), marked.height());
    let mut agreed = Image::filled(w, h, false);
    agreed.pixels_mut().par_chunks_exact_mut(w).enumerate().for_each(|(y, row)| {
        let rows = y.saturating_sub(REACH_PX)..(y + REACH_PX + 1).min(h);
        for (x, agreed) in row.iter_mut().enumerate().filter(|(x, _)| marked[(*x, y)]) {
            let columns = x.saturating_sub(REACH_PX)..(x + REACH_PX + 1).min(w);
            let around = rows.clone().map(|y| marked.row(y)[columns.clone()].iter());
            *agreed = around.flatten().filter(|&&m| m).count() >= AGREEING;
        }
    });
    agreed
}

/// Connected marked pixels, as indices.
fn regions(marked: &Image<bool>) -> Vec<Vec<usize>> {
    let (w, h) = (marked.width(), marked.height());
    let mut open = marked.clone();
    let mut regions = Vec::new();
    for start in 0..w * h {
        if !open.pixels()[start] {
            continue;
        }
        open.pixels_mut()[start] = false;
        let mut region = vec![start];
        let mut next = 0;
        while next < region.len() {
            let (x, y) = (region[next] % w, region[next] / w);
            for j in y.saturating_sub(1)..(y + 2).min(h) {
                for i in x.saturating_sub(1)..(x + 2).min(w) {
                    if std::mem::take(&mut open[(i, j)]) {
                        region.push(j * w + i);
                    }
                }
            }
            next += 1;
        }
        regions.push(region);
    }
    regions
}

/// A region with its border.
fn widened(region: &[usize], w: usize, h: usize) -> Vec<usize> {
    let around = |&i: &usize| {
        let (x, y) = (i % w, i / w);
        (y.saturating_sub(BORDER_PX)..(y + BORDER_PX + 1).min(h)).flat_map(move |y| {
            (x.saturating_sub(BORDER_PX)..(x + BORDER_PX + 1).min(w)).map(move |x| y * w + x)
        })
    };
    let mut wide: Vec<usize> = region.iter().flat_map(around).collect();
    wide.sort_unstable();
    wide.dedup();
    wide
}
