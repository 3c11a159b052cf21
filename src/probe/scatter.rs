//! Lamps of a resampled picture, flux by flux.
//!
//! What is brighter than the lamp level was cut off when texels were gathered. Its excess, radiance ×
//! solid angle of the source pixel, is scattered forward over the tent that bilinear interpolation
//! would give it: the flux is exact whatever the texels' size.

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use super::mapping::Mapping;
use super::resample::Gatherer;
use crate::bracket::Radiance;
use crate::conventions::{Rgb, luminance};
use crate::photo::Image;

/// Brighter than this many medians is a lamp.
const LAMP_MEDIANS: f32 = 50.0;

/// Samples along a side of a texel on the target's rim, whose solid angle is that of its part inside.
const RIM_SIDE: usize = 8;

/// Luminance above which a pixel is a lamp, whose flux is scattered forward; infinite in a black picture.
pub(super) fn lamp_level(source: &Radiance, usable: &Image<bool>) -> f32 {
    let usable = source.mean.pixels().iter().zip(usable.pixels()).filter(|(_, usable)| **usable);
    let mut values: Vec<f32> = usable.map(|(l, _)| luminance(*l)).collect();
    if values.is_empty() {
        return f32::INFINITY;
    }
    let middle = values.len() / 2;
    let level = LAMP_MEDIANS * *values.select_nth_unstable_by(middle, f32::total_cmp).1;
    if level > 0.0 { level } else { f32::INFINITY }
}

/// Adds what lamps shine above the lamp level to `radiance`, each pixel's flux exactly.
pub(super) fn scatter_lamps<M: Mapping + ?Sized, D: Mapping>(
    gatherer: &Gatherer<M, D>,
    radiance: &mut Image<Rgb>,
) {
    let source = &gatherer.source.mean;
    // Rows in parallel, summed in their order: the same bytes for any number of threads.
    let deposits: Vec<Vec<(usize, DVec3)>> = (0..source.height())
        .into_par_iter()
        .map(|y| {
            let mut row = Vec::new();
            for x in 0..source.width() {
                let l = source[(x, y)];
                if gatherer.usable[(x, y)] && luminance(l) > gatherer.lamp_level {
                    gatherer.scatter(x, y, l - gatherer.below_lamp(l), &mut row);
                }
            }
            row
        })
        .collect();
    for (index, flux) in deposits.into_iter().flatten() {
        let (x, y) = (index % gatherer.width, index / gatherer.width);
        if let Some(solid_angle) = texel_solid_angle(&gatherer.target, x, y) {
            radiance[(x, y)] += (flux / solid_angle).as_vec3();
        }
    }
}

/// Solid angle of texel (`x`, `y`), of its part inside where it lies on the rim; `None` outside.
pub fn texel_solid_angle<D: Mapping + ?Sized>(target: &D, x: usize, y: usize) -> Option<f64> {
    if let Some(exact) = target.part_of_row(y, 0, 1) {
        return Some(exact);
    }
    let centre = DVec2::new(x as f64, y as f64);
    // Inside its own pixel: on a corner's far side there is another face.
    let corners = [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)];
    let whole = corners
        .iter()
        .all(|&(dx, dy)| target.solid_angle(centre + DVec2::new(dx, dy) * 0.499_999).is_some());
    if whole {
        return target.solid_angle(centre);
    }
    let step = 1.0 / RIM_SIDE as f64;
    let sum: f64 = (0..RIM_SIDE * RIM_SIDE)
        .filter_map(|k| {
            let at = DVec2::new((k % RIM_SIDE) as f64 + 0.5, (k / RIM_SIDE) as f64 + 0.5) * step;
            target.solid_angle(centre - 0.5 + at)
        })
        .sum();
    (sum > 0.0).then_some(sum * step * step)
}

impl<M: Mapping + ?Sized, D: Mapping> Gatherer<'_, M, D> {
    /// Spreads one pixel's `excess` radiance over the texels under its tent.
    fn scatter(&self, x: usize, y: usize, excess: Rgb, deposits: &mut Vec<(usize, DVec3)>) {
        let centre = DVec2::new(x as f64, y as f64);
        let Some(solid_angle) = self.mapping.solid_angle(centre) else { return };
        let back = self.turn.transpose();
        let Some(texel) = self.texel_width(x, y) else { return };
        // Enough points that neighbours land less than half a texel apart; even, so that none is in the
        // middle, which at twice the resolution lies between two texels and always went to the same side.
        let points = (4.0 * solid_angle.sqrt() / texel).ceil() as usize;
        let side = points.clamp(4, 64).next_multiple_of(2);
        let mut landed: Vec<(usize, f64)> = Vec::new();
        let mut total = 0.0;
        for j in 0..side {
            for i in 0..side {
                let offset = DVec2::new(i as f64 + 0.5, j as f64 + 0.5) * (2.0 / side as f64) - 1.0;
                let weight = (1.0 - offset.x.abs()) * (1.0 - offset.y.abs());
                let seen = self.mapping.direction_beyond(centre, centre + offset);
                let Some(index) = seen.and_then(|d| self.landing(back * d)) else { continue };
                total += weight;
                match landed.iter_mut().rev().find(|(k, _)| *k == index) {
                    Some((_, w)) => *w += weight,
                    None => landed.push((index, weight)),
                }
            }
        }
        let flux = excess.as_dvec3() * solid_angle;
        deposits.extend(landed.into_iter().map(|(index, w)| (index, flux * (w / total))));
    }

    /// Angle across the texel that shows the source pixel (`x`, `y`), radians; `None` outside the target.
    fn texel_width(&self, x: usize, y: usize) -> Option<f64> {
        if self.target.wraps() {
            return Some(2.0 * std::f64::consts::PI / self.width as f64);
        }
        let direction = self.mapping.direction(DVec2::new(x as f64, y as f64))?;
        let there = self.target.pixel(self.turn.transpose() * direction)?;
        self.target.solid_angle(there).map(|solid_angle| solid_angle.sqrt().max(1e-6))
    }

    /// Index of the texel that shows `direction`, if the target does.
    fn landing(&self, direction: DVec3) -> Option<usize> {
        let p = self.target.pixel(direction)?;
        let (x, y) = match self.target.wraps() {
            true => self.target.continued(p, p.x.round() as i64, p.y.round() as i64),
            false => (p.x.round() as i64, p.y.round() as i64),
        };
        let (w, h) = (self.width as i64, self.height as i64);
        (x >= 0 && x < w && y >= 0 && y < h).then_some((y * w + x) as usize)
    }
}
