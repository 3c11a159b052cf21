//! Any picture of directions → lat-long or any other, conserving light.
//!
//! A map of light is a measure: ∫L dω and ∫L ω dω must survive. Texels gather `S × S` bilinear
//! samples, S = ⌈2 · source pixels per texel⌉ up to 8, each weighed by its solid angle; one sample
//! alone loses up to 31 % of a lamp (methods-capture C5). What is brighter than 50 medians (lamps,
//! the sun) is cut off there first and its excess is scattered forward ([`scatter`](super::scatter)).
//!
//! Samples never mix validity classes: of the four neighbours only those in the nearest one's group
//! count. A texel's class is the worst it mixed, but [`Validity::LowerBound`] outlives all others:
//! a clipped lamp must never look measured.

use glam::{DMat3, DVec2};
use rayon::prelude::*;

use super::block::{BLOCK, SMOOTH_PX, Surface};
use super::mapping::{LatLong, Mapping};
use super::panorama::Panorama;
use super::scatter::{lamp_level, scatter_lamps};
use crate::bracket::{Radiance, Validity};
use crate::conventions::{Rgb, luminance};
use crate::photo::Image;

/// Largest number of samples along a texel's side.
const MAX_SIDE: usize = 8;

/// Corners of a texel are taken this far inside it, px: right on an edge they may be another face's.
const INSET: f64 = 1e-6;

/// `source`, seen through `mapping`, as a lat-long of `width` × `width / 2` texels.
///
/// `mapping_from_panorama` takes a direction of the panorama's axes to the mapping's. Texels that
/// the picture does not show are black, [`Validity::Filled`] and of coverage 0.
pub fn to_lat_long<M: Mapping + ?Sized>(
    source: &Radiance,
    mapping: &M,
    mapping_from_panorama: DMat3,
    width: usize,
) -> Panorama {
    let target = LatLong { width, height: width / 2 };
    let Resampled { light, coverage } =
        resample(source, mapping, target, (width, width / 2), mapping_from_panorama);
    let mut panorama = Panorama::from_radiance(light.mean);
    panorama.variance = light.variance;
    panorama.validity = light.validity;
    panorama.coverage = coverage;
    panorama
}

/// A picture of directions, and the share of each texel that its source showed, 0…1.
#[derive(Clone, Debug)]
pub struct Resampled {
    pub light: Radiance,
    pub coverage: Image<f32>,
}

impl Resampled {
    /// The part of `width` × `height` texels whose first one is (`left`, `top`).
    pub fn part(&self, (left, top): (usize, usize), (width, height): (usize, usize)) -> Self {
        fn cut<T: Clone>(
            image: &Image<T>,
            left: usize,
            top: usize,
            size: (usize, usize),
        ) -> Image<T> {
            Image::from_fn(size.0, size.1, |x, y| image[(left + x, top + y)].clone())
        }
        let size = (width, height);
        Self {
            light: Radiance {
                mean: cut(&self.light.mean, left, top, size),
                variance: cut(&self.light.variance, left, top, size),
                validity: cut(&self.light.validity, left, top, size),
            },
            coverage: cut(&self.coverage, left, top, size),
        }
    }
}

/// `source`, seen through `mapping`, as the picture of `size` texels that `target` maps.
///
/// `mapping_from_target` takes a direction of the target's axes to the mapping's; it may mirror. Texels
/// that the source does not show, or the target has no direction for, are black,
/// [`Validity::Filled`] and of coverage 0. Those on the target's rim hold the mean of their part inside.
pub fn resample<M: Mapping + ?Sized, D: Mapping>(
    source: &Radiance,
    mapping: &M,
    target: D,
    size: (usize, usize),
    mapping_from_target: DMat3,
) -> Resampled {
    let gatherer = Gatherer::new(source, mapping, target, size, mapping_from_target);
    let mut resampled = gatherer.gather();
    scatter_lamps(&gatherer, &mut resampled.light.mean);
    resampled
}

/// A source picture ready to be sampled for texels of a target.
pub(super) struct Gatherer<'a, M: Mapping + ?Sized, D: Mapping> {
    pub(super) source: &'a Radiance,
    pub(super) mapping: &'a M,
    pub(super) target: D,
    pub(super) turn: DMat3,
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) usable: Image<bool>,
    /// [`lamp_level`].
    pub(super) lamp_level: f32,
}

/// What one texel mixed.
pub(super) struct Texel {
    pub radiance: Rgb,
    pub variance: Rgb,
    pub validity: Validity,
    pub coverage: f32,
}

impl<'a, M: Mapping + ?Sized, D: Mapping> Gatherer<'a, M, D> {
    pub(super) fn new(
        source: &'a Radiance,
        mapping: &'a M,
        target: D,
        (width, height): (usize, usize),
        turn: DMat3,
    ) -> Self {
        let (w, h) = (source.mean.width(), source.mean.height());
        let rows: Vec<Vec<bool>> = (0..h)
            .into_par_iter()
            .map(|y| (0..w).map(|x| mapping.covers(x, y)).collect())
            .collect();
        let usable = Image::from_fn(w, h, |x, y| rows[y][x]);
        let lamp_level = lamp_level(source, &usable);
        Self { source, mapping, target, turn, width, height, usable, lamp_level }
    }

    /// All texels, lamps cut off at the lamp level.
    fn gather(&self) -> Resampled {
        let (w, h) = (self.width, self.height);
        let bands = (0..h.div_ceil(BLOCK)).into_par_iter();
        let rows: Vec<Vec<Texel>> = bands.flat_map_iter(|k| self.band(k)).collect();
        let of = |x: usize, y: usize| &rows[y][x];
        Resampled {
            light: Radiance {
                mean: Image::from_fn(w, h, |x, y| of(x, y).radiance),
                variance: Image::from_fn(w, h, |x, y| of(x, y).variance),
                validity: Image::from_fn(w, h, |x, y| of(x, y).validity),
            },
            coverage: Image::from_fn(w, h, |x, y| of(x, y).coverage),
        }
    }

    /// The rows of band `k`, [`BLOCK`] of them or what is left.
    fn band(&self, k: usize) -> Vec<Vec<Texel>> {
        let mut taps = Taps::default();
        let rows = k * BLOCK..((k + 1) * BLOCK).min(self.height);
        if !self.target.wraps() {
            let texel = |x, y, taps: &mut Taps| self.texel(x, y, self.cell(x, y), taps);
            return rows
                .map(|y| (0..self.width).map(|x| texel(x, y, &mut taps)).collect())
                .collect();
        }
        // Without edges in the picture neighbours share their corners.
        let corners = self.corners(k * BLOCK);
        rows.map(|y| {
            let at = |x: usize, y: usize| corners[(y - k * BLOCK) * (self.width + 1) + x];
            let cell = |x: usize| [at(x, y), at(x + 1, y), at(x, y + 1), at(x + 1, y + 1)];
            (0..self.width).map(|x| self.texel(x, y, cell(x), &mut taps)).collect()
        })
        .collect()
    }

    /// Source pixels of the texel corners of [`BLOCK`] rows from `top` on, row by row, one corner more than
    /// there are texels both ways.
    fn corners(&self, top: usize) -> Vec<Option<DVec2>> {
        let mut corners = vec![None; (self.width + 1) * (BLOCK + 1)];
        // The nodes of a block's right side are those of the next one's left.
        let mut left = self.nodes(0, top);
        for block in 0..self.width.div_ceil(BLOCK) {
            let x0 = block * BLOCK;
            let (middle, right) = (self.nodes(x0 + BLOCK / 2, top), self.nodes(x0 + BLOCK, top));
            let surface = self.surface([left, middle, right], x0, top);
            for j in 0..=BLOCK {
                for i in 0..=BLOCK.min(self.width - x0) {
                    corners[j * (self.width + 1) + x0 + i] = match &surface {
                        Some(surface) => Some(surface.at(i, j)),
                        None => self.corner(x0 + i, top + j),
                    };
                }
            }
            left = right;
        }
        corners
    }

    /// Source pixel of the upper left corner of texel (`x`, `y`).
    fn corner(&self, x: usize, y: usize) -> Option<DVec2> {
        self.locate(x as f64 - 0.5, y as f64 - 0.5)
    }

    /// Three corners of column `x`: where a block begins, its middle and its end.
    fn nodes(&self, x: usize, top: usize) -> [Option<DVec2>; 3] {
        [0, BLOCK / 2, BLOCK].map(|j| self.corner(x, top + j))
    }

    /// The map over a block, if it is as smooth there as is needed.
    fn surface(&self, nodes: [[Option<DVec2>; 3]; 3], x0: usize, y0: usize) -> Option<Surface> {
        let first = nodes[0][0]?;
        let wrapped = |p: DVec2| {
            let w = self.source.mean.width() as f64;
            let turns = if self.mapping.wraps() { ((p.x - first.x) / w).round() } else { 0.0 };
            DVec2::new(p.x - turns * w, p.y)
        };
        let mut exact = [[DVec2::ZERO; 3]; 3];
        for (to, from) in exact.iter_mut().flatten().zip(nodes.into_iter().flatten()) {
            *to = wrapped(from?);
            if self.mapping.piece(*to) != self.mapping.piece(first) {
                return None;
            }
        }
        let surface = Surface { nodes: exact };
        let (near, far) = (BLOCK / 4, BLOCK - BLOCK / 4);
        let fits = |(i, j): (usize, usize)| {
            let exact = self.corner(x0 + i, y0 + j).map(wrapped);
            exact.is_some_and(|exact| exact.distance(surface.at(i, j)) < SMOOTH_PX)
        };
        [(near, near), (far, near), (near, far), (far, far)]
            .into_iter()
            .all(fits)
            .then_some(surface)
    }

    /// The single texel (`x`, `y`).
    pub(super) fn one(&self, x: usize, y: usize) -> Texel {
        self.texel(x, y, self.cell(x, y), &mut Taps::default())
    }

    /// Source pixels of the corners of texel (`x`, `y`).
    fn cell(&self, x: usize, y: usize) -> [Option<DVec2>; 4] {
        let inset = if self.target.wraps() { 0.0 } else { INSET };
        let (near, far) = (inset - 0.5, 0.5 - inset);
        [(near, near), (far, near), (near, far), (far, far)]
            .map(|(dx, dy)| self.locate(x as f64 + dx, y as f64 + dy))
    }

    /// Source pixel of a point of the target.
    fn locate(&self, x: f64, y: f64) -> Option<DVec2> {
        self.mapping.pixel(self.turn * self.target.direction(DVec2::new(x, y))?)
    }

    fn texel(&self, x: usize, y: usize, cell: [Option<DVec2>; 4], taps: &mut Taps) -> Texel {
        taps.clear();
        // Neither corners nor middle: what a narrow lens leaves of the sphere is not searched 64 times.
        if cell.iter().all(Option::is_none) && self.locate(x as f64, y as f64).is_none() {
            return self.mix(taps, 0.0);
        }
        let smooth = self.smooth_cell(cell);
        let side = smooth.map_or(MAX_SIDE, samples_along);
        let mut asked = 0.0;
        for j in 0..side {
            let v = (j as f64 + 0.5) / side as f64;
            let strip = self.target.part_of_row(y, j, side);
            for i in 0..side {
                let u = (i as f64 + 0.5) / side as f64;
                let at = DVec2::new(x as f64 - 0.5 + u, y as f64 - 0.5 + v);
                // Beyond the target's rim there is nothing to ask for.
                let Some(weight) = strip.or_else(|| self.target.solid_angle(at)) else { continue };
                asked += weight;
                // The map is smooth within a cell of a pixel or few: interpolate it.
                let place = match smooth {
                    Some([a, b, c, d]) => Some(a.lerp(b, u).lerp(c.lerp(d, u), v)),
                    None => self.locate(at.x, at.y),
                };
                if let Some(place) = place {
                    self.tap(place, weight, taps);
                }
            }
        }
        self.mix(taps, asked)
    }

    /// The cell's corners if the map may be interpolated between them.
    fn smooth_cell(&self, cell: [Option<DVec2>; 4]) -> Option<[DVec2; 4]> {
        let [a, mut b, mut c, mut d] = [cell[0]?, cell[1]?, cell[2]?, cell[3]?];
        if self.mapping.wraps() {
            let w = self.source.mean.width() as f64;
            for corner in [&mut b, &mut c, &mut d] {
                corner.x -= ((corner.x - a.x) / w).round() * w;
            }
        }
        // Wider cells lie near a pole or rim of the source, where the map bends.
        let piece = self.mapping.piece(a);
        let near = |p: DVec2| (p - a).length() < 16.0 && self.mapping.piece(p) == piece;
        (near(b) && near(c) && near(d)).then_some([a, b, c, d])
    }

    /// Adds the bilinear weights of one sample at `place`.
    fn tap(&self, place: DVec2, weight: f64, taps: &mut Taps) {
        let corner = place.floor();
        let f = place - corner;
        let weights = [(1.0 - f.x) * (1.0 - f.y), f.x * (1.0 - f.y), (1.0 - f.x) * f.y, f.x * f.y];
        let mut found = [None; 4];
        for (k, slot) in found.iter_mut().enumerate() {
            // Saturating: a place beyond all integers is outside, not an overflow.
            let (right, down) = ((k & 1) as i64, (k >> 1) as i64);
            let (x, y) = (corner.x as i64, corner.y as i64);
            *slot = self.index(place, x.saturating_add(right), y.saturating_add(down));
        }
        // The nearest usable neighbour decides the class.
        let mut nearest: Option<usize> = None;
        for k in 0..4 {
            if found[k].is_some() && nearest.is_none_or(|n| weights[k] > weights[n]) {
                nearest = Some(k);
            }
        }
        let Some(nearest) = nearest.and_then(|n| found[n]) else { return };
        let group = group(self.source.validity.pixels()[nearest]);
        let same = |i: usize| group == self::group(self.source.validity.pixels()[i]);
        let sum = |of: &dyn Fn(usize) -> bool| -> f64 {
            (0..4).filter(|&k| found[k].is_some_and(of)).map(|k| weights[k]).sum()
        };
        // Past the last usable pixels would be guessing.
        if sum(&|_| true) < 0.5 {
            return;
        }
        let total = sum(&same);
        for k in 0..4 {
            if let Some(index) = found[k].filter(|&i| same(i)) {
                taps.add(index, weight * weights[k] / total);
            }
        }
        taps.seen += weight;
    }

    /// Index of the usable pixel that is at (x, y) as seen from `inside`.
    fn index(&self, inside: DVec2, x: i64, y: i64) -> Option<usize> {
        let (w, h) = (self.usable.width() as i64, self.usable.height() as i64);
        let (x, y) = self.mapping.continued(inside, x, y);
        let within = x >= 0 && x < w && y >= 0 && y < h;
        (within && self.usable[(x as usize, y as usize)]).then_some((y * w + x) as usize)
    }

    /// The texel that the taps add up to.
    fn mix(&self, taps: &Taps, asked: f64) -> Texel {
        let mut texel = Texel {
            radiance: Rgb::ZERO,
            variance: Rgb::ZERO,
            validity: Validity::Filled,
            coverage: 0.0,
        };
        if taps.seen <= 0.0 {
            return texel;
        }
        texel.coverage = (taps.seen / asked) as f32;
        let mut validity = Validity::Measured;
        for &(index, weight) in &taps.weights {
            let share = (weight / taps.seen) as f32;
            texel.radiance += self.below_lamp(self.source.mean.pixels()[index]) * share;
            texel.variance += self.source.variance.pixels()[index] * (share * share);
            validity = worst(validity, self.source.validity.pixels()[index]);
        }
        texel.validity = validity;
        texel
    }

    /// A pixel's radiance, cut off at the lamp level with its colour kept.
    pub(super) fn below_lamp(&self, l: Rgb) -> Rgb {
        let y = luminance(l);
        if y > self.lamp_level { l * (self.lamp_level / y) } else { l }
    }
}

/// Weights of source pixels in one texel.
#[derive(Default)]
struct Taps {
    weights: Vec<(usize, f64)>,
    seen: f64,
}

impl Taps {
    fn clear(&mut self) {
        self.weights.clear();
        self.seen = 0.0;
    }

    fn add(&mut self, index: usize, weight: f64) {
        // A texel's samples share a handful of pixels, met last first.
        match self.weights.iter_mut().rev().find(|(i, _)| *i == index) {
            Some((_, w)) => *w += weight,
            None => self.weights.push((index, weight)),
        }
    }
}

/// Samples along a texel's side: two for each source pixel it spans.
fn samples_along([a, b, c, d]: [DVec2; 4]) -> usize {
    let span = [(a, b), (c, d), (a, c), (b, d)]
        .iter()
        .map(|(p, q)| (*p - *q).length())
        .fold(0.0, f64::max);
    ((2.0 * span).ceil() as usize).clamp(1, MAX_SIDE)
}

/// Classes that may be interpolated with each other.
fn group(class: Validity) -> u8 {
    match class {
        Validity::Measured | Validity::Single => 0,
        other => other as u8,
    }
}

/// The class of a mixture: the worst, but a lower bound outlives all.
pub fn worst(a: Validity, b: Validity) -> Validity {
    if a == Validity::LowerBound || b == Validity::LowerBound {
        Validity::LowerBound
    } else {
        a.max(b)
    }
}

#[cfg(test)]
mod tests {
    use super::super::projection_tests::sun;
    use super::*;
    use crate::conventions::{lat_long_direction, lat_long_solid_angle};
    use crate::probe::mapping::{Angular, BallMap};
    use glam::{DQuat, DVec3};

    fn exact(mean: Image<Rgb>) -> Radiance {
        let (w, h) = (mean.width(), mean.height());
        Radiance {
            mean,
            variance: Image::filled(w, h, Rgb::ONE),
            validity: Image::filled(w, h, Validity::Measured),
        }
    }

    /// Corners that a parabola gives are those of the map itself, over poles, seams and rims too.
    #[test]
    fn blocks_of_corners_are_where_the_map_has_them() {
        let source = exact(Image::filled(300, 300, Rgb::ONE));
        let lat_long = LatLong { width: 300, height: 150 };
        let mappings: [&dyn Mapping; 3] =
            [&lat_long, &Angular { size: 300 }, &BallMap { size: 300 }];
        for mapping in mappings {
            for (k, width) in [(0, 60), (1, 256), (2, 1000), (3, 1000)] {
                let target = LatLong { width, height: width / 2 };
                let turn = DMat3::from_quat(rotation(k));
                let gatherer = Gatherer::new(&source, mapping, target, (width, width / 2), turn);
                for top in (0..width / 2).step_by(BLOCK) {
                    let corners = gatherer.corners(top);
                    for j in 0..=BLOCK.min(width / 2 - top) {
                        for x in 0..=width {
                            let found = corners[j * (width + 1) + x];
                            let there = gatherer.corner(x, top + j);
                            let off = match (found, there) {
                                (Some(found), Some(there)) => {
                                    let off = found - there;
                                    let round = if mapping.wraps() { 300.0 } else { f64::INFINITY };
                                    off.x.abs().min((off.x.abs() - round).abs()).hypot(off.y)
                                }
                                (None, None) => 0.0,
                                _ => f64::INFINITY,
                            };
                            assert!(off < 2.0 * SMOOTH_PX, "({x}, {}): {off} px", top + j);
                        }
                    }
                }
            }
        }
    }

    /// Flux and flux-weighted direction of what is brighter than 1.5.
    fn moments(image: &Image<Rgb>) -> (f64, DVec3) {
        let (w, h) = (image.width(), image.height());
        let (mut flux, mut moment) = (0.0, DVec3::ZERO);
        for y in 0..h {
            for x in 0..w {
                let l = f64::from(image[(x, y)].x) - 1.0;
                let d = lat_long_direction(DVec2::new(x as f64, y as f64), w, h);
                flux += l * lat_long_solid_angle(y, w, h);
                moment += l * lat_long_solid_angle(y, w, h) * d;
            }
        }
        (flux, moment.normalize())
    }

    /// Deterministic rotations all over the group.
    fn rotation(k: usize) -> DQuat {
        let k = k as f64;
        DQuat::from_rotation_y(2.4 * k)
            * DQuat::from_rotation_x(1.7 * k)
            * DQuat::from_rotation_z(k)
    }

    #[test]
    fn sixteen_rotations_keep_the_suns_flux_and_place() {
        let towards = DVec3::new(0.3, 0.5, -0.4).normalize();
        let source = exact(sun(1024, towards));
        let (flux, _) = moments(&source.mean);
        for k in 0..16 {
            let turn = DMat3::from_quat(rotation(k));
            let mapping = LatLong { width: 1024, height: 512 };
            let width = if k < 8 { 512 } else { 1024 };
            let out = to_lat_long(&source, &mapping, turn, width);
            let (f, d) = moments(&out.radiance);
            assert!((f / flux - 1.0).abs() < 3e-3, "rotation {k}: flux {f} of {flux}");
            let off = (turn * d).angle_between(towards).to_degrees();
            // 0.02° at 1024: flux lands in texel centres, a 17th of a texel off on the whole.
            assert!(off < 20.0 / width as f64, "rotation {k}: {off}°");
        }
    }

    #[test]
    fn constant_light_stays_constant() {
        let source = exact(Image::filled(256, 256, Rgb::new(0.2, 0.5, 3.0)));
        let turn = DMat3::from_quat(rotation(3));
        let out = to_lat_long(&source, &Angular { size: 256 }, turn, 128);
        let seen = out.radiance.pixels().iter().zip(out.coverage.pixels());
        for (l, coverage) in seen.filter(|(_, c)| **c > 0.0) {
            assert!((*l / Rgb::new(0.2, 0.5, 3.0) - 1.0).abs().max_element() < 1e-5, "{l}");
            assert!(*coverage <= 1.0 + 1e-6);
        }
        // The rim of the angular map is one direction; nearly all is seen.
        let seen = out.coverage.pixels().iter().filter(|c| **c > 0.5).count();
        assert!(seen > 128 * 64 * 99 / 100, "{seen}");
    }

    #[test]
    fn six_coloured_axes_arrive_where_they_belong() {
        let axes = [DVec3::X, DVec3::NEG_X, DVec3::Y, DVec3::NEG_Y, DVec3::Z, DVec3::NEG_Z];
        let colour = |d: DVec3| {
            let k = (0..6).max_by(|&a, &b| axes[a].dot(d).total_cmp(&axes[b].dot(d))).unwrap();
            Rgb::new((k & 1) as f32, (k >> 1 & 1) as f32, (k >> 2) as f32) + 0.1
        };
        let angular = Angular { size: 300 };
        let source = exact(Image::from_fn(300, 300, |x, y| {
            angular.direction(DVec2::new(x as f64, y as f64)).map_or(Rgb::ZERO, colour)
        }));
        let out = to_lat_long(&source, &angular, DMat3::IDENTITY, 200);
        for axis in axes {
            // +Z itself is the angular map's rim.
            let near = (axis + DVec3::new(0.05, 0.07, -0.03)).normalize();
            assert!((out.radiance(near) - colour(near)).length() < 1e-3, "{axis}");
        }
    }

    #[test]
    fn classes_are_not_mixed_and_a_lower_bound_survives() {
        let mut source = exact(Image::filled(64, 32, Rgb::ONE));
        source.mean[(20, 10)] = Rgb::splat(9.0);
        source.validity[(20, 10)] = Validity::LowerBound;
        source.validity[(21, 10)] = Validity::Moved;
        let mapping = LatLong { width: 64, height: 32 };
        let turn = DMat3::from_rotation_y(0.02);
        let out = to_lat_long(&source, &mapping, turn, 128);
        let bounds = out.validity.pixels().iter().filter(|v| **v == Validity::LowerBound).count();
        assert!((4..=9).contains(&bounds), "{bounds} texels");
        // No sample blends 9 with 1; texels on the border of the two hold area shares of both.
        let top = out.radiance.pixels().iter().map(|l| l.x).fold(0.0, f32::max);
        assert_eq!(top, 9.0);
    }

    #[test]
    fn variance_falls_with_the_number_of_pixels_mixed() {
        let source = exact(Image::filled(256, 128, Rgb::ONE));
        let mapping = LatLong { width: 256, height: 128 };
        let out = to_lat_long(&source, &mapping, DMat3::IDENTITY, 64);
        // 4 × 4 pixels and the tails of the tent: about 1/16.
        let v = out.variance[(30, 16)].x;
        assert!(v > 1.0 / 24.0 && v < 1.0 / 14.0, "{v}");
    }

    #[test]
    fn black_and_tiny_pictures_survive() {
        for (w, h) in [(1, 1), (2, 1), (8, 8)] {
            let source = exact(Image::filled(w, h, Rgb::ZERO));
            let mapping = LatLong { width: w, height: h };
            let out = to_lat_long(&source, &mapping, DMat3::IDENTITY, 16);
            assert!(out.radiance.pixels().iter().all(|l| *l == Rgb::ZERO));
        }
    }
}
