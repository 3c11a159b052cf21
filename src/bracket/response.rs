//! The camera's own tone curve, recovered from a bracket whose exposures are known.
//!
//! Three methods on the same sample pixels, each with one curve for all channels and one for each;
//! [`recover`] takes the one that explains best what it was not fitted to.
//! - Debevec & Malik 1997, eq. 3: ln f⁻¹(z) = g(z) for 256 codes and the log radiance of sample pixels
//!   minimise Σ w(z)²·(g(z) − ln E − ln t)² + λ² Σ (w(z)·g″(z))². The pixel unknowns each touch only
//!   their own equations and are eliminated, which leaves 256 × 256.
//! - Robertson, Borman & Stevenson 2003: f⁻¹(z) is the mean of t·E over the samples of code z, E their
//!   weighted mean, in turns.
//! - Mitsunaga & Nayar 1999, eq. 10, with the ratios known: f⁻¹ a polynomial whose values in two frames
//!   have the ratio of their exposures.
//!
//! A bracket alone fixes the curve up to a factor; it is set so that the code that sRGB gives to 18 %
//! grey keeps that meaning, because the plate beside the bracket is read as sRGB.
//! Needs trusted exposure ratios: a wrong exponent in them is one in the curve (Grossberg & Nayar 2003).

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::layer::{Layer, NO_DATA};
use crate::photo::{Samples, ToneCurve, colour::srgb_decode};

/// How a response was recovered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ResponseMethod {
    DebevecMalik,
    Robertson,
    MitsunagaNayar,
}

impl std::fmt::Display for ResponseMethod {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.write_str(match self {
            Self::DebevecMalik => "Debevec and Malik's",
            Self::Robertson => "Robertson's",
            Self::MitsunagaNayar => "Mitsunaga and Nayar's",
        })
    }
}

/// A camera's tone curve, recovered from a bracket.
#[derive(Clone, Debug)]
pub struct Response {
    /// Of red, green and blue.
    pub curves: [ToneCurve; 3],
    /// Whether each channel has its own: then each is a measurement of its own too, and one that is not
    /// clipped holds whatever the others do (film scans).
    pub per_channel: bool,
    pub method: ResponseMethod,
    /// Deviation of the log radiance by this curve of samples that were left out of the fit, by bands of codes.
    pub held_out: f64,
}

impl Response {
    /// Largest factor between these curves and sRGB over codes 20…240.
    pub fn distance_from_srgb(&self) -> f64 {
        self.curves.iter().map(ToneCurve::distance_from_srgb).fold(1.0, f64::max)
    }
}

/// Smoothness λ of Debevec and Malik's curve for a thousand samples (methods-capture C3: 0.2 % on an S-curve);
/// λ² grows with their number, or the curve would follow their noise.
const SMOOTHNESS: f64 = 50.0;
/// Sample pixels of each channel, at most. methods-capture C3 asks for a thousand, evenly from the codes of
/// the middle frame: ten thousand so chosen put Debevec's church .036 / .059 / .050 stops off his own map, as
/// many from anywhere flat .027 / .041 / .042.
const SAMPLES: usize = 10_000;
/// Fewer say too little about 256 codes.
const FEWEST_SAMPLES: usize = 250;
/// From this weight on a code counts where curves are compared, by bands of so many codes that hold so many.
const LEAST_JUDGED: f64 = 16.0;
const BAND: usize = 16;
const FEWEST_IN_BAND: usize = 20;
/// Parts into which the samples fall; each is left out of a fit once.
const FOLDS: usize = 4;
/// Highest power of Mitsunaga and Nayar's polynomial.
const DEGREE: usize = 7;
/// sRGB code of 18 % grey, where the curve is anchored.
const GREY_CODE: usize = 118;

/// Codes of one pixel's channel in every frame.
type Sample = Vec<u8>;

/// Recovers the response; `None` if the files are not 8-bit RGB or show too little. `one_curve`: all
/// channels must share it.
pub(super) fn recover(
    layers: &[Layer],
    exposures: &[f64],
    order: &[usize],
    one_curve: bool,
) -> Option<Response> {
    let codes = Codes::new(layers, order)?;
    let samples = [0, 1, 2].map(|channel| codes.samples(channel));
    if samples.iter().any(|channel| channel.len() < FEWEST_SAMPLES) {
        return None;
    }
    let logs: Vec<f64> = order.iter().map(|&k| exposures[k].ln()).collect();
    let methods =
        [ResponseMethod::DebevecMalik, ResponseMethod::Robertson, ResponseMethod::MitsunagaNayar];
    let best = |shared: bool| {
        let judged = methods.map(|method| (method, held_out(&samples, &logs, method, shared)));
        first_good(judged.into_iter())
    };
    let (method, shared) = best(true)?;
    let best_apart = best(false)?;
    // One curve for all, unless one for each explains more than the scatter of the parts allows.
    if best_apart.1.clearly_below(&shared) && !one_curve {
        let curve = |channel: usize| anchored(solve(&samples[channel], &logs, best_apart.0)?);
        if let (Some(r), Some(g), Some(b)) = (curve(0), curve(1), curve(2)) {
            let (method, held_out) = (best_apart.0, best_apart.1.mean);
            return Some(Response { curves: [r, g, b], per_channel: true, method, held_out });
        }
    }
    let curve = anchored(solve(&samples.concat(), &logs, method)?)?;
    let curves = [curve.clone(), curve.clone(), curve];
    Some(Response { curves, per_channel: false, method, held_out: shared.mean })
}

/// The first method that no later one beats clearly; `None` if none could be fitted.
fn first_good(
    judged: impl Iterator<Item = (ResponseMethod, HeldOut)>,
) -> Option<(ResponseMethod, HeldOut)> {
    judged
        .filter(|(_, held_out)| held_out.mean.is_finite())
        .reduce(|best, next| if next.1.clearly_below(&best.1) { next } else { best })
}

/// The frames' 8-bit codes on one grid.
struct Codes<'a> {
    layers: Vec<&'a Layer<'a>>,
    data: Vec<(&'a [u8], usize)>,
    width: usize,
    height: usize,
}

impl<'a> Codes<'a> {
    fn new(layers: &'a [Layer], order: &[usize]) -> Option<Self> {
        let layers: Vec<&Layer> = order.iter().map(|&k| &layers[k]).collect();
        let codes = |layer: &&'a Layer| match &layer.photo.samples {
            Samples::U8 { channels, data } if *channels >= 3 => Some((data.as_slice(), *channels)),
            _ => None,
        };
        let data = layers.iter().map(codes).collect::<Option<Vec<_>>>()?;
        let (width, height) = (layers[0].photo.width, layers[0].photo.height);
        Some(Self { layers, data, width, height })
    }

    /// The code of a frame at a pixel of the grid, if it has one there.
    fn code(&self, k: usize, x: usize, y: usize, channel: usize) -> Option<u8> {
        let at = self.layers[k].warp.apply(glam::DVec2::new(x as f64, y as f64)).round();
        let inside = at.x >= 0.0 && at.y >= 0.0;
        if !(inside && at.x < self.width as f64 && at.y < self.height as f64) {
            return None;
        }
        let (x, y) = (at.x as usize, at.y as usize);
        let (data, channels) = self.data[k];
        let shows = self.layers[k].state(x, y) & NO_DATA == 0;
        shows.then(|| data[(y * self.width + x) * channels + channel])
    }

    /// Pixels from all over the picture, of the half that lies in flatter places: each a code for every frame.
    ///
    /// Not chosen by their codes: what is chosen for a rare code of one frame is mostly an edge or noise
    /// there, and bends the curve towards that frame's errors.
    fn samples(&self, channel: usize) -> Vec<Sample> {
        // A scattered order (golden-ratio steps).
        let n = (self.width * self.height) as u64;
        let step = ((n as f64 * 0.618_033_988_75) as u64) | 1;
        let scattered = (1..=n.min(200_000)).map(|k| {
            let at = (k as u128 * u128::from(step) % u128::from(n)) as usize;
            (at % self.width, at / self.width)
        });
        let seen = |(x, y): (usize, usize)| {
            let codes = (0..self.data.len()).map(|k| self.code(k, x, y, channel));
            let codes = codes.collect::<Option<Sample>>()?;
            let seen_twice = codes.iter().filter(|&&c| weight(c) > 4.0).count() >= 2;
            seen_twice.then(|| (self.steepness((x, y), channel), codes))
        };
        let seen: Vec<(u8, Sample)> = scattered.filter_map(seen).take(2 * SAMPLES).collect();
        let mut steepness: Vec<u8> = seen.iter().map(|(steepness, _)| *steepness).collect();
        if steepness.is_empty() {
            return Vec::new();
        }
        let middle = steepness.len() / 2;
        let limit = *steepness.select_nth_unstable(middle).1;
        let flat = seen.into_iter().filter(|(steepness, _)| *steepness <= limit);
        flat.map(|(_, codes)| codes).take(SAMPLES).collect()
    }

    /// Largest difference of a code to one of the four beside it, over the frames.
    fn steepness(&self, (x, y): (usize, usize), channel: usize) -> u8 {
        let beside = [
            (x.saturating_sub(1), y),
            ((x + 1).min(self.width - 1), y),
            (x, y.saturating_sub(1)),
            (x, (y + 1).min(self.height - 1)),
        ];
        let of_frame = |k: usize| {
            let own = self.code(k, x, y, channel)?;
            let others = beside.iter().filter_map(|&(x, y)| self.code(k, x, y, channel));
            others.map(|code| code.abs_diff(own)).max()
        };
        (0..self.data.len()).filter_map(of_frame).max().unwrap_or(0)
    }
}

/// Debevec & Malik's hat: no trust in codes at either end; none at all in clipped ones.
fn weight(code: u8) -> f64 {
    if code >= 250 { 0.0 } else { f64::from(code.min(255 - code)) }
}

/// What a fit leaves unexplained of samples left out of it, and its σ over the parts left out.
///
/// Root mean square over the bands of codes of their median deviation from the samples' own means: noise
/// has no median, a curve that is wrong has one wherever it is.
#[derive(Clone, Copy, Debug)]
struct HeldOut {
    mean: f64,
    sigma: f64,
}

impl HeldOut {
    /// By more than the standard error of the difference.
    fn clearly_below(&self, other: &Self) -> bool {
        self.mean + self.sigma.hypot(other.sigma) < other.mean
    }
}

/// Fits a method to all samples but a fold, and judges it by that fold; each channel by itself even where
/// they share a curve, for what is too bright in one and too dark in another would cancel.
fn held_out(
    samples: &[Vec<Sample>; 3],
    log_exposures: &[f64],
    method: ResponseMethod,
    shared: bool,
) -> HeldOut {
    let curve_of = |fitted: &[Sample]| anchored(solve(fitted, log_exposures, method)?);
    let of_fold = |fold: usize| -> Option<f64> {
        let part = |channel: &Vec<Sample>, within: bool| -> Vec<Sample> {
            let chosen = channel.iter().enumerate().filter(|(i, _)| (i % FOLDS == fold) == within);
            chosen.map(|(_, sample)| sample.clone()).collect()
        };
        let fitted = samples.each_ref().map(|channel| part(channel, false));
        let curves = if shared {
            let curve = curve_of(&fitted.concat())?;
            [curve.clone(), curve.clone(), curve]
        } else {
            [curve_of(&fitted[0])?, curve_of(&fitted[1])?, curve_of(&fitted[2])?]
        };
        let mut sum = 0.0;
        for (channel, curve) in samples.iter().zip(&curves) {
            sum += unexplained(&part(channel, true), curve, log_exposures)?;
        }
        Some(sum / 3.0)
    };
    let folds: Option<Vec<f64>> = (0..FOLDS).into_par_iter().map(of_fold).collect();
    let Some(folds) = folds else { return HeldOut { mean: f64::INFINITY, sigma: 0.0 } };
    let n = folds.len() as f64;
    let mean = folds.iter().sum::<f64>() / n;
    let variance = folds.iter().map(|f| (f - mean).powi(2)).sum::<f64>() / (n - 1.0);
    HeldOut { mean, sigma: (variance / n).sqrt() }
}

/// Root mean square over the bands of codes of the samples' median deviation; `None` of too few samples.
fn unexplained(samples: &[Sample], curve: &ToneCurve, log_exposures: &[f64]) -> Option<f64> {
    let mut bands = vec![Vec::new(); 256 / BAND];
    for sample in samples {
        for (code, off) in deviations(sample, curve, log_exposures) {
            bands[usize::from(code) / BAND].push(off);
        }
    }
    let medians: Vec<f64> =
        bands.into_iter().filter(|band| band.len() >= FEWEST_IN_BAND).map(median).collect();
    let squares: f64 = medians.iter().map(|m| m * m).sum();
    (!medians.is_empty()).then(|| (squares / medians.len() as f64).sqrt())
}

/// How far the log radiance by each code of a sample is from their mean by Debevec and Malik's weight; codes
/// at either end are left out.
fn deviations(sample: &Sample, curve: &ToneCurve, log_exposures: &[f64]) -> Vec<(u8, f64)> {
    let within =
        sample.iter().zip(log_exposures).filter(|(code, _)| weight(**code) >= LEAST_JUDGED);
    let logs: Vec<(u8, f64)> =
        within.map(|(&code, t)| (code, f64::from(curve.linear(code)).ln() - t)).collect();
    if logs.len() < 2 {
        return Vec::new();
    }
    let (sum, total) = logs.iter().fold((0.0, 0.0), |(sum, total), &(code, log)| {
        let w = weight(code).powi(2);
        (sum + w * log, total + w)
    });
    logs.into_iter().map(|(code, log)| (code, log - sum / total)).collect()
}

/// The middle value; the list is not empty.
fn median(mut values: Vec<f64>) -> f64 {
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// Log of the linear value of each code, up to a constant; `None` if it cannot be solved.
fn solve(
    samples: &[Sample],
    log_exposures: &[f64],
    method: ResponseMethod,
) -> Option<DVector<f64>> {
    match method {
        ResponseMethod::DebevecMalik => debevec_malik(samples, log_exposures),
        ResponseMethod::Robertson => robertson(samples, log_exposures),
        ResponseMethod::MitsunagaNayar => mitsunaga_nayar(samples, log_exposures),
    }
}

fn debevec_malik(samples: &[Sample], log_exposures: &[f64]) -> Option<DVector<f64>> {
    let mut normal = DMatrix::<f64>::zeros(256, 256);
    let mut right = DVector::<f64>::zeros(256);
    for codes in samples {
        // ln E of this pixel is the weighted mean of g − ln t; what remains is each one's
        // difference from that mean.
        let squared: Vec<f64> = codes.iter().map(|&c| weight(c).powi(2)).collect();
        let total: f64 = squared.iter().sum();
        let mean_log = squared.iter().zip(log_exposures).map(|(w, t)| w * t).sum::<f64>() / total;
        for (i, &a) in codes.iter().enumerate() {
            normal[(a.into(), a.into())] += squared[i];
            right[usize::from(a)] += squared[i] * (log_exposures[i] - mean_log);
            for (j, &b) in codes.iter().enumerate() {
                normal[(a.into(), b.into())] -= squared[i] * squared[j] / total;
            }
        }
    }
    let smoothness = SMOOTHNESS * (samples.len() as f64 / 1000.0).sqrt();
    for z in 1..255usize {
        let w = (smoothness * f64::from(z.min(255 - z) as u32)).powi(2);
        let second = [(z - 1, 1.0), (z, -2.0), (z + 1, 1.0)];
        for (i, a) in second {
            for (j, b) in second {
                normal[(i, j)] += w * a * b;
            }
        }
    }
    // g(GREY_CODE) = 0 for now: takes away the free factor.
    normal[(GREY_CODE, GREY_CODE)] += 1e9;
    normal.cholesky().map(|c| c.solve(&right))
}

/// Rounds until Robertson's curve moves by less than the codes' own steps.
const ROUNDS: usize = 40;

fn robertson(samples: &[Sample], log_exposures: &[f64]) -> Option<DVector<f64>> {
    let exposures: Vec<f64> = log_exposures.iter().map(|log| log.exp()).collect();
    let mut curve: Vec<f64> = (0..256).map(|code| f64::from(code) / GREY_CODE as f64).collect();
    // The paper's weight: a Gaussian that is 0 at both ends.
    let gauss = |code: u8| (-4.0 * (f64::from(code) - 127.5).powi(2) / 127.5f64.powi(2)).exp();
    let weight = |code: u8| if weight(code) > 0.0 { gauss(code) - gauss(0) } else { 0.0 };
    for _ in 0..ROUNDS {
        let (mut sums, mut counts) = ([0.0; 256], [0.0; 256]);
        for sample in samples {
            let (mut light, mut total) = (0.0, 0.0);
            for (&code, t) in sample.iter().zip(&exposures) {
                light += weight(code) * t * curve[usize::from(code)];
                total += weight(code) * t * t;
            }
            if total <= 0.0 {
                continue;
            }
            for (&code, t) in sample.iter().zip(&exposures) {
                // A clipped code says nothing of what it stands for.
                if code < 250 {
                    sums[usize::from(code)] += t * light / total;
                    counts[usize::from(code)] += 1.0;
                }
            }
        }
        let known: Vec<(usize, f64)> = (0..256)
            .filter(|&code| counts[code] > 0.0 && sums[code] > 0.0)
            .map(|code| (code, (sums[code] / counts[code]).ln()))
            .collect();
        let logs = between(&known)?;
        curve = logs.iter().map(|log| (log - logs[GREY_CODE]).exp()).collect();
    }
    Some(DVector::from_iterator(256, curve.iter().map(|v| v.max(1e-12).ln())))
}

/// Logarithms of 256 codes from some of them: linear between, and beyond the first and the last with the
/// slope that they have there.
fn between(known: &[(usize, f64)]) -> Option<Vec<f64>> {
    if known.len() < 16 {
        return None;
    }
    Some(
        (0..256)
            .map(|code| {
                let above = known.partition_point(|k| k.0 < code).clamp(1, known.len() - 1);
                let ((a, low), (b, high)) = (known[above - 1], known[above]);
                low + (high - low) * (code as f64 - a as f64) / (b as f64 - a as f64)
            })
            .collect(),
    )
}

fn mitsunaga_nayar(samples: &[Sample], log_exposures: &[f64]) -> Option<DVector<f64>> {
    // f⁻¹(m) = Σ cₙ mⁿ, n from 1: code 0 is black; and f⁻¹(1) = 1.
    let powers = |code: u8| -> [f64; DEGREE] {
        let m = f64::from(code) / 255.0;
        std::array::from_fn(|n| m.powi(n as i32 + 1))
    };
    let mut normal = DMatrix::<f64>::zeros(DEGREE, DEGREE);
    for sample in samples {
        for (k, pair) in sample.windows(2).enumerate() {
            let w = weight(pair[0]).min(weight(pair[1]));
            if w <= 0.0 {
                continue;
            }
            let ratio = (log_exposures[k] - log_exposures[k + 1]).exp();
            let (a, b) = (powers(pair[0]), powers(pair[1]));
            let row = DVector::from_fn(DEGREE, |n, _| w * (a[n] - ratio * b[n]));
            normal += &row * row.transpose();
        }
    }
    let ones = DVector::from_element(DEGREE, 1.0);
    let solved = normal.cholesky()?.solve(&ones);
    let sum = solved.sum();
    let value = |code: u8| powers(code).iter().zip(solved.iter()).map(|(p, c)| p * c / sum).sum();
    // A polynomial may dip below black; the curve is made to rise later.
    let logs = (0..=255u8).map(|code| f64::max(value(code), 1e-9).ln());
    Some(DVector::from_iterator(256, logs))
}

/// The curve of g, made to rise strictly and to give 18 % grey its sRGB meaning; `None` if it runs
/// beyond all numbers.
fn anchored(g: DVector<f64>) -> Option<ToneCurve> {
    if g.iter().any(|v| !v.is_finite()) {
        return None;
    }
    let grey = f64::from(srgb_decode(GREY_CODE as f32 / 255.0));
    let mut curve: Vec<f64> = g.iter().map(|v| (v - g[GREY_CODE]).exp() * grey).collect();
    // Away from grey outward: noise must not turn the curve around.
    for code in GREY_CODE + 1..256 {
        curve[code] = curve[code].max(curve[code - 1] * (1.0 + 1e-5));
    }
    for code in (0..GREY_CODE).rev() {
        curve[code] = curve[code].min(curve[code + 1] * (1.0 - 1e-5));
    }
    let mut response = [0.0; 256];
    for (to, from) in response.iter_mut().zip(curve) {
        *to = from as f32;
    }
    // Code 0 is black, whatever a logarithm says.
    response[0] = 0.0;
    ToneCurve::new(response)
}
