//! How one frame of a bracket lies on its neighbour, and whether undoing that helps.
//!
//! Phase correlation on the cube root of light (0.09 px rms on a two-stop pair, against 0.34 px on
//! raw codes; methods-capture C3): coarse on a reduced picture, then fine in windows spread over the
//! frame. Of the ladder none, shift, affine, homography the lowest rung is taken that the windows left
//! out of the fit do not ask to leave; and none of them if what the frames do not share is not lowered.

use std::sync::Arc;

use glam::DVec2;
use rayon::prelude::*;
use rustfft::num_complex::Complex;
use rustfft::{Fft, FftPlanner};

use super::layer::{Layer, catmull_rom};
use super::warp::{Match, Warp, WarpKind};
use crate::photo::Encoded;

/// Sides of the squares that are correlated, px: the whole picture reduced, and windows at full size.
const COARSE: usize = 256;
const FINE: usize = 128;
/// Windows along each side of the frame.
const WINDOWS: usize = 4;
/// Shifts below this are left alone: undoing them costs more sharpness than they do, px.
const SMALLEST_SHIFT_PX: f64 = 0.25;
/// A warp must lower the residual at least to this share to be believed.
const WORTH_WARPING: f64 = 0.9;
/// A richer warp must lower the left-out windows' error to this share.
const WORTH_PARAMETERS: f64 = 0.7;
/// How far windows that see the same warp may be off each other, px.
const AGREEING_PX: f64 = 1.0;
/// Height of a correlation peak, as a share of a perfect one, from which on it is believed.
const WEAKEST_PEAK: f64 = 0.04;

/// What was found between two frames.
#[derive(Clone, Copy, Debug)]
pub(super) struct Alignment {
    pub kind: WarpKind,
    /// Takes a pixel of the reference to the frame; the identity unless it helps.
    pub warp: Warp,
    /// Mean shift of the frame's windows, whether or not undoing it helps, px.
    pub shift: DVec2,
}

/// Measures how `frame` lies on `reference`, both as their files have them; exposures make their light
/// comparable. `None` where the frames show too little in common.
pub(super) fn measure(reference: (&Layer, f64), frame: (&Layer, f64)) -> Option<Alignment> {
    let pair = Pair::new(reference, frame);
    let (w, h) = pair.size();
    if w < 16 || h < 16 {
        return None;
    }
    let coarse = pair.coarse()?;
    let size = w.max(h) as f64;
    let matches = agreeing(&pair.windows(coarse), size)?;
    let (kind, warp) = ladder(&matches, size)?;
    let centre = DVec2::new(w as f64 - 1.0, h as f64 - 1.0) / 2.0;
    let shift = warp.apply(centre) - centre;
    let still = Alignment { kind: WarpKind::None, warp: Warp::IDENTITY, shift };
    if kind == WarpKind::None || warp.reach_px(w, h) < SMALLEST_SHIFT_PX {
        return Some(still);
    }
    let before = pair.residual(&Warp::IDENTITY)?;
    let tried = [(kind, Some(warp)), (WarpKind::Shift, Warp::fit(WarpKind::Shift, &matches, size))];
    for (kind, warp) in tried {
        let Some(warp) = warp else { continue };
        let after = pair.residual(&warp)?;
        if after < WORTH_WARPING * before {
            return Some(Alignment { kind, warp, shift });
        }
    }
    Some(still)
}

/// How far a photograph lies off another of the same size, px: the shift of its middle, and the farthest that a
/// corner moves by what fits best. Both have their exposures.
///
/// `None` where they differ in size or show too little in common.
pub fn disagreement_px(reference: (&Encoded, f64), other: (&Encoded, f64)) -> Option<(DVec2, f64)> {
    let size = |photo: &Encoded| (photo.width, photo.height);
    if size(reference.0) != size(other.0) {
        return None;
    }
    let layers = [Layer::new(reference.0), Layer::new(other.0)];
    let found = measure((&layers[0], reference.1), (&layers[1], other.1))?;
    let (w, h) = size(reference.0);
    Some((found.shift, found.warp.reach_px(w, h).max(found.shift.length())))
}

/// The lowest rung that windows left out of its fit do not ask to leave, with its warp by all of them.
fn ladder(matches: &[Match], size: f64) -> Option<(WarpKind, Warp)> {
    let mut best = (WarpKind::Shift, left_out_error(WarpKind::Shift, matches, size)?);
    for kind in [WarpKind::Affine, WarpKind::Homography] {
        let Some(error) = left_out_error(kind, matches, size) else { continue };
        if error < WORTH_PARAMETERS * best.1 && best.1 > SMALLEST_SHIFT_PX {
            best = (kind, error);
        }
    }
    Some((best.0, Warp::fit(best.0, matches, size)?))
}

/// Rms distance of each match from the fit to the others, px.
fn left_out_error(kind: WarpKind, matches: &[Match], size: f64) -> Option<f64> {
    if matches.len() == 1 && kind == WarpKind::Shift {
        return Some(0.0);
    }
    let mut squares = 0.0;
    for k in 0..matches.len() {
        let mut others = matches.to_vec();
        let (from, to) = others.swap_remove(k);
        squares += Warp::fit(kind, &others, size)?.apply(from).distance_squared(to);
    }
    (!matches.is_empty()).then(|| (squares / matches.len() as f64).sqrt())
}

/// The largest set of matches that one turn, scale and shift explains to within [`AGREEING_PX`]: windows on
/// moving things or on a repeating pattern are not in it. `None` if it has less than half of them.
fn agreeing(matches: &[Match], size: f64) -> Option<Vec<Match>> {
    // What a homography may add to a similarity over the frame.
    let tolerance = AGREEING_PX.max(0.003 * size);
    let turned = |v: DVec2, by: DVec2| DVec2::new(v.x * by.x - v.y * by.y, v.x * by.y + v.y * by.x);
    let mut best = Vec::new();
    for (i, &(from, to)) in matches.iter().enumerate() {
        for &(other_from, other_to) in &matches[i + 1..] {
            let (before, after) = (other_from - from, other_to - to);
            // after / before, as complex numbers.
            let turn = turned(after, DVec2::new(before.x, -before.y)) / before.length_squared();
            let agrees = |m: &&Match| (to + turned(m.0 - from, turn)).distance(m.1) < tolerance;
            let agreeing: Vec<Match> = matches.iter().filter(agrees).copied().collect();
            if agreeing.len() > best.len() {
                best = agreeing;
            }
        }
    }
    if matches.len() == 1 {
        return Some(matches.to_vec());
    }
    (!best.is_empty() && 2 * best.len() >= matches.len()).then_some(best)
}

/// Two frames whose light is made comparable.
struct Pair<'a> {
    layers: [&'a Layer<'a>; 2],
    /// What makes their cube roots comparable: 1 where the longer frame is near clipping, and both are
    /// cut.
    scales: [f32; 2],
}

impl<'a> Pair<'a> {
    fn new(reference: (&'a Layer<'a>, f64), frame: (&'a Layer<'a>, f64)) -> Self {
        // 0.85 of white of the longer frame, in radiance.
        let top = 0.85 / reference.1.max(frame.1);
        let scales = [reference.1, frame.1].map(|exposure| (exposure * top).cbrt().recip() as f32);
        Self { layers: [reference.0, frame.0], scales }
    }

    fn size(&self) -> (usize, usize) {
        (self.layers[0].photo.width, self.layers[0].photo.height)
    }

    /// Cube root of a pixel's radiance, 1 where it is cut; the edge is repeated outside.
    fn value(&self, which: usize, x: i64, y: i64) -> f32 {
        let (w, h) = self.size();
        let (x, y) = (x.clamp(0, w as i64 - 1) as usize, y.clamp(0, h as i64 - 1) as usize);
        (self.layers[which].own_root(x, y) * self.scales[which]).min(1.0)
    }

    /// A square of `side` values from `corner`, each the mean of 4 × 4 pixels at most of the `factor`² that
    /// it stands for.
    fn square(&self, which: usize, corner: (i64, i64), side: usize, factor: usize) -> Vec<f32> {
        let taps = factor.min(4);
        let place = |k: usize| ((2 * k + 1) * factor / (2 * taps)) as i64;
        let row = |j: usize| {
            (0..side).map(move |i| {
                let at = (corner.0 + (i * factor) as i64, corner.1 + (j * factor) as i64);
                let mut sum = 0.0;
                for dy in 0..taps {
                    for dx in 0..taps {
                        sum += self.value(which, at.0 + place(dx), at.1 + place(dy));
                    }
                }
                sum / (taps * taps) as f32
            })
        };
        (0..side).flat_map(row).collect()
    }

    /// Shift of the whole frame, to about a pixel of the reduced picture.
    fn coarse(&self) -> Option<DVec2> {
        let (w, h) = self.size();
        let factor = w.max(h).div_ceil(COARSE);
        let square = |which: usize| self.square(which, (0, 0), COARSE, factor);
        let (shift, _) = Correlator::new(COARSE).shift(&square(0), &square(1))?;
        Some(shift * factor as f64)
    }

    /// Where the frame has the middles of windows of the reference.
    fn windows(&self, coarse: DVec2) -> Vec<Match> {
        let (w, h) = self.size();
        let side = FINE.min(w).min(h);
        let correlator = Correlator::new(side);
        let (dx, dy) = (coarse.x.round() as i64, coarse.y.round() as i64);
        let along = |length: usize| {
            let n = WINDOWS.min(length / side).max(1);
            (0..n).map(move |k| ((length - side) * (2 * k + 1) / (2 * n)) as i64)
        };
        let corners: Vec<(i64, i64)> =
            along(h).flat_map(|y| along(w).map(move |x| (x, y))).collect();
        let find = |&(x, y): &(i64, i64)| {
            let a = self.square(0, (x, y), side, 1);
            let b = self.square(1, (x + dx, y + dy), side, 1);
            let (fine, peak) = correlator.shift(&a, &b)?;
            let middle = DVec2::new(x as f64, y as f64) + (side as f64 - 1.0) / 2.0;
            let moved = DVec2::new(dx as f64, dy as f64) + fine;
            let believed = peak > WEAKEST_PEAK && fine.abs().max_element() < side as f64 / 4.0;
            believed.then_some((middle, middle + moved))
        };
        corners.par_iter().filter_map(find).collect()
    }

    /// How badly the frame, warped back, is a function of the reference: the share of its variance that
    /// the reference does not explain (correlation ratio; Roche et al. 1998), over the middle of the frame.
    ///
    /// A plain difference would be ruled by an unknown tone curve; this one does not see it.
    fn residual(&self, warp: &Warp) -> Option<f64> {
        /// Bands of brightness in the reference; each with count, sum and sum of squares of the frame.
        const BANDS: usize = 64;
        /// More pixels than this along a side are thinned out.
        const ALONG: usize = 256;
        type Sums = [[f64; 3]; BANDS];
        let (w, h) = self.size();
        let margin = (warp.reach_px(w, h).ceil() as usize).max(2) + 2;
        if w <= 2 * margin || h <= 2 * margin {
            return None;
        }
        let steps = [w, h].map(|side| side.div_ceil(ALONG) | 1);
        // 0.1 … 0.97: neither black nor cut; judged on the reference so that both warps see one set.
        let row_sums = |y: usize| {
            let mut sums: Sums = [[0.0; 3]; BANDS];
            for x in (margin..w - margin).step_by(steps[0]) {
                let reference = self.value(0, x as i64, y as i64);
                if !(0.1..0.97).contains(&reference) {
                    continue;
                }
                let value = f64::from(self.between(warp.apply(DVec2::new(x as f64, y as f64))));
                let band = &mut sums[(reference * BANDS as f32) as usize];
                *band = [band[0] + 1.0, band[1] + value, band[2] + value * value];
            }
            sums
        };
        let rows: Vec<usize> = (margin..h - margin).step_by(steps[1]).collect();
        let rows: Vec<Sums> = rows.into_par_iter().map(row_sums).collect();
        let mut all = [0.0; 3];
        let mut within = 0.0;
        for band in 0..BANDS {
            let add = |s: [f64; 3], t: [f64; 3]| [s[0] + t[0], s[1] + t[1], s[2] + t[2]];
            let sums = rows.iter().fold([0.0; 3], |sums, row| add(sums, row[band]));
            within += scatter(sums);
            all = add(all, sums);
        }
        (all[0] >= 100.0 && scatter(all) > 0.0).then(|| within / scatter(all))
    }

    /// The frame between its pixels, by Catmull and Rom's cubic.
    fn between(&self, at: DVec2) -> f32 {
        let (x0, y0) = (at.x.floor(), at.y.floor());
        let (wx, wy) = (catmull_rom(at.x - x0), catmull_rom(at.y - y0));
        let mut sum = 0.0;
        for (j, wy) in wy.into_iter().enumerate() {
            for (i, wx) in wx.into_iter().enumerate() {
                sum += wx * wy * self.value(1, x0 as i64 + i as i64 - 1, y0 as i64 + j as i64 - 1);
            }
        }
        sum
    }
}

/// Sum of squared deviations from the mean, of a count, a sum and a sum of squares.
fn scatter([n, sum, squares]: [f64; 3]) -> f64 {
    if n > 0.0 { (squares - sum * sum / n).max(0.0) } else { 0.0 }
}

/// Finds shifts between squares of one side by phase correlation.
struct Correlator {
    side: usize,
    forward: Arc<dyn Fft<f32>>,
    inverse: Arc<dyn Fft<f32>>,
}

impl Correlator {
    fn new(side: usize) -> Self {
        let mut planner = FftPlanner::new();
        let (forward, inverse) = (planner.plan_fft_forward(side), planner.plan_fft_inverse(side));
        Self { side, forward, inverse }
    }

    /// Shift of `b` against `a`, px, and the height of its peak (1: the squares differ by it alone);
    /// `None` where one of them is flat.
    fn shift(&self, a: &[f32], b: &[f32]) -> Option<(DVec2, f64)> {
        let side = self.side;
        let (a, b) = (self.spectrum(a)?, self.spectrum(b)?);
        // The highest frequencies hold noise only and are faded out.
        let fade = |k: usize| {
            let frequency = k.min(side - k) as f32 / side as f32;
            (-frequency * frequency / (2.0 * 0.15 * 0.15)).exp()
        };
        let faded: Vec<f32> = (0..side).map(fade).collect();
        let mut cross: Vec<Complex<f32>> = a
            .iter()
            .zip(&b)
            .enumerate()
            .map(|(i, (a, b))| {
                let product = a.conj() * b;
                let weight = faded[i % side] * faded[i / side];
                product * (weight / product.norm().max(f32::MIN_POSITIVE))
            })
            .collect();
        self.transform(&mut cross, &self.inverse);
        let total: f32 = faded.iter().sum();
        let peak = (0..cross.len()).max_by(|&i, &j| cross[i].re.total_cmp(&cross[j].re))?;
        let (px, py) = (peak % side, peak / side);
        let at = |x: usize, y: usize| cross[(y % side) * side + x % side].re;
        // The faded peak is a Gaussian: a parabola through the logarithms is exact for it.
        let sub_pixel = |before: f32, centre: f32, after: f32| {
            if before <= 0.0 || after <= 0.0 {
                return 0.0;
            }
            let (l, c, r) = (before.ln(), centre.ln(), after.ln());
            let curvature = l - 2.0 * c + r;
            if curvature < 0.0 {
                f64::from((0.5 * (l - r) / curvature).clamp(-0.5, 0.5))
            } else {
                0.0
            }
        };
        let dx = sub_pixel(at(px + side - 1, py), at(px, py), at(px + 1, py));
        let dy = sub_pixel(at(px, py + side - 1), at(px, py), at(px, py + 1));
        let signed = |p: usize| if p > side / 2 { p as f64 - side as f64 } else { p as f64 };
        let height = f64::from(at(px, py) / (total * total));
        Some((DVec2::new(signed(px) + dx, signed(py) + dy), height))
    }

    /// The transform of a square, tapered at its border; `None` of a flat one.
    fn spectrum(&self, values: &[f32]) -> Option<Vec<Complex<f32>>> {
        let side = self.side;
        let mean = values.iter().sum::<f32>() / values.len() as f32;
        let variance: f32 = values.iter().map(|v| (v - mean).powi(2)).sum();
        if variance < 1e-7 * values.len() as f32 {
            return None;
        }
        let hann = |i: usize| {
            let turn = std::f32::consts::TAU * (i as f32 + 0.5) / side as f32;
            0.5 - 0.5 * turn.cos()
        };
        let taper: Vec<f32> = (0..side).map(hann).collect();
        let tapered = values.iter().enumerate();
        let mut square: Vec<Complex<f32>> = tapered
            .map(|(i, v)| Complex::new((v - mean) * taper[i % side] * taper[i / side], 0.0))
            .collect();
        self.transform(&mut square, &self.forward);
        Some(square)
    }

    /// Transform of rows and columns; the inverse is not scaled.
    fn transform(&self, square: &mut [Complex<f32>], fft: &Arc<dyn Fft<f32>>) {
        let side = self.side;
        let transposed = |square: &[Complex<f32>]| -> Vec<Complex<f32>> {
            (0..side * side).map(|i| square[(i % side) * side + i / side]).collect()
        };
        fft.process(square);
        let mut turned = transposed(square);
        fft.process(&mut turned);
        square.copy_from_slice(&transposed(&turned));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::conventions::Rgb;
    use crate::photo::{Image, Photo};

    /// A smooth scene of blobs, each pixel showing the place that `seen` gives.
    fn scene(w: usize, h: usize, seen: impl Fn(DVec2) -> DVec2) -> Encoded {
        let blobs: Vec<(DVec2, f64)> = (0..600u32)
            .map(|k| {
                // A low-discrepancy scatter (Roberts 2018).
                let at =
                    |a: f64, size: usize| (a * f64::from(k)).fract() * (size as f64 + 80.0) - 40.0;
                let c = DVec2::new(at(0.754_877_666, w), at(0.569_840_291, h));
                (c, 3.0 + f64::from(k % 7))
            })
            .collect();
        let light = Image::from_fn(w, h, |x, y| {
            let p = seen(DVec2::new(x as f64, y as f64));
            let near = blobs.iter().filter(|(c, size)| p.distance_squared(*c) < 25.0 * size * size);
            let l: f64 =
                near.map(|(c, s)| 0.2 * (-p.distance_squared(*c) / (2.0 * s * s)).exp()).sum();
            Rgb::splat(0.05 + l as f32)
        });
        Photo::from_linear(light).encoded()
    }

    fn found(seen: impl Fn(DVec2) -> DVec2) -> Alignment {
        let (reference, frame) = (scene(420, 400, |p| p), scene(420, 400, seen));
        measure((&Layer::new(&reference), 1.0), (&Layer::new(&frame), 1.0)).unwrap()
    }

    #[test]
    fn shifts_are_measured_to_a_tenth_of_a_pixel() {
        for shift in [DVec2::new(0.4, -0.3), DVec2::new(3.7, 1.2), DVec2::new(-24.6, 18.25)] {
            let found = found(|p| p - shift);
            assert!(found.shift.distance(shift) < 0.1, "{shift} was found as {}", found.shift);
            assert_eq!(found.kind, WarpKind::Shift);
            assert!(found.warp.apply(DVec2::ZERO).distance(shift) < 0.1);
        }
    }

    /// F19: a hand turns by 0.3° between two frames, which a shift leaves 1.5 px off in the corners.
    #[test]
    fn turns_are_undone_to_a_fifth_of_a_pixel() {
        let (middle, turn) = (DVec2::new(210.0, 200.0), DVec2::from_angle(0.3f64.to_radians()));
        let to_frame = |p: DVec2| middle + turn.rotate(p - middle) + DVec2::new(2.0, -1.0);
        let to_reference = |q: DVec2| {
            let back = q - DVec2::new(2.0, -1.0) - middle;
            middle + DVec2::new(turn.x, -turn.y).rotate(back)
        };
        let found = found(to_reference);
        assert!(found.kind >= WarpKind::Affine, "{found:?}");
        for corner in [(0.0, 0.0), (419.0, 0.0), (0.0, 399.0), (419.0, 399.0)] {
            let corner = DVec2::from(corner);
            let off = found.warp.apply(corner).distance(to_frame(corner));
            assert!(off < 0.2, "corner {corner}: {off} px");
        }
    }

    #[test]
    fn a_still_camera_is_left_alone() {
        let found = found(|p| p);
        assert_eq!((found.kind, found.warp), (WarpKind::None, Warp::IDENTITY));
    }

    #[test]
    fn a_photograph_from_elsewhere_is_told_by_how_much() {
        let shift = DVec2::new(6.0, 61.0);
        let [a, b] = [DVec2::ZERO, shift].map(|by| scene(420, 400, |p| p - by));
        let (found, reach) = disagreement_px((&a, 1.0), (&b, 1.0)).unwrap();
        assert!(found.distance(shift) < 0.2 && (reach - shift.length()).abs() < 0.5, "{found}");
        assert!(disagreement_px((&a, 1.0), (&a, 1.0)).unwrap().1 < 0.1);
        assert!(disagreement_px((&a, 1.0), (&scene(400, 400, |p| p), 1.0)).is_none());
    }

    #[test]
    fn a_flat_frame_has_no_shift() {
        let flat = Photo::from_linear(Image::filled(64, 64, Rgb::splat(0.3))).encoded();
        assert!(measure((&Layer::new(&flat), 1.0), (&Layer::new(&flat), 1.0)).is_none());
    }

    #[test]
    fn windows_on_something_else_that_moves_are_left_out() {
        let matches: Vec<Match> = (0..16)
            .map(|k| {
                let p = DVec2::new(f64::from(k % 4), f64::from(k / 4)) * 100.0;
                let by = if k < 4 { DVec2::new(9.0, 0.0) } else { DVec2::new(1.0, 0.5) };
                (p, p + by + 0.01 * DVec2::new(f64::from(k % 3), f64::from(k % 2)))
            })
            .collect();
        let (kind, warp) = ladder(&agreeing(&matches, 400.0).unwrap(), 400.0).unwrap();
        assert_eq!(kind, WarpKind::Shift);
        assert!(warp.apply(DVec2::ZERO).distance(DVec2::new(1.0, 0.5)) < 0.05, "{warp:?}");
    }
}
