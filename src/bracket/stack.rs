//! All frames of a bracket on one grid → the radiance of each pixel.
//!
//! x = ΣY/Σt over the unclipped frames: every photon counts once (Hanji, Zhong & Mantiuk, ECCV 2020).
//! Frames in which the pixel would be darker than about one code are left out, for their rounding
//! to black is a bias; hat weights keep them, and are +9 % … ×170 wrong in the dark. No clipped value
//! ever enters a mean. Codes read through a recovered curve count less towards its ends.

use rayon::prelude::*;

use super::layer::{CLIPS, Layer, NO_DATA, Shown};
use super::noise::{Noise, Pair};
use super::{Radiance, Validity};
use crate::conventions::{LUMINANCE_WEIGHTS, Rgb};
use crate::photo::{Image, Measured};

/// Linear value, about one code of 8 bits, below which a frame is left out (methods-capture C3).
const DARKEST_USED: f32 = 0.004;

/// How many σ a frame may be off a pixel's mean (methods-capture C3).
const CONTRADICTING: f32 = 4.0;
/// σ of what a known tone curve and the exposures are off, as a share of the light.
pub(super) const SYSTEMATIC: f64 = 0.03;

/// All frames on one grid with their exposures.
pub(super) struct Stack<'a> {
    pub layers: &'a [Layer<'a>],
    pub exposures: &'a [f64],
    /// Frames by rising exposure, copies left out.
    pub order: &'a [usize],
    /// Whether a channel that is not clipped counts whatever the others do.
    pub channels_apart: bool,
    /// σ of what tone curve and exposures are off, as a share of the light.
    pub systematic: f64,
}

/// One pixel's result.
#[derive(Clone, Copy)]
pub(super) struct Merge {
    pub mean: Rgb,
    pub variance: Rgb,
    pub validity: Validity,
}

/// Noise of a camera as sums want it.
#[derive(Clone, Copy)]
struct Deviations {
    per_light: f32,
    floor: f32,
}

impl Deviations {
    fn of(noise: &Noise) -> Self {
        let full_well_e = noise.full_well_e;
        let floor = (noise.read_noise_e / full_well_e).powi(2);
        Self { per_light: (1.0 / full_well_e) as f32, floor: floor as f32 }
    }

    /// Variance of linear values.
    fn variance(&self, light: Rgb) -> Rgb {
        light.max(Rgb::ZERO) * self.per_light + self.floor
    }
}

impl Stack<'_> {
    /// Width and height of the grid.
    pub fn size(&self) -> (usize, usize) {
        (self.layers[0].photo.width, self.layers[0].photo.height)
    }

    /// Every pixel's radiance, and where a frame contradicts it.
    pub fn merge(&self, noise: &Noise) -> (Radiance, Image<bool>) {
        let (w, h) = self.size();
        let mut radiance = Radiance {
            mean: Image::filled(w, h, Rgb::ZERO),
            variance: Image::filled(w, h, Rgb::ZERO),
            validity: Image::filled(w, h, Validity::LowerBound),
        };
        let mut contradicted = Image::filled(w, h, false);
        let noise = Deviations::of(noise);
        radiance
            .mean
            .pixels_mut()
            .par_chunks_exact_mut(w)
            .zip(radiance.variance.pixels_mut().par_chunks_exact_mut(w))
            .zip(radiance.validity.pixels_mut().par_chunks_exact_mut(w))
            .zip(contradicted.pixels_mut().par_chunks_exact_mut(w))
            .enumerate()
            .for_each(|(y, (((mean, variance), validity), contradicted))| {
                let mut shown = Vec::with_capacity(self.order.len());
                for x in 0..w {
                    self.show(x, y, &mut shown);
                    let merge = self.pixel(&shown, noise);
                    (mean[x], variance[x], validity[x]) =
                        (merge.mean, merge.variance, merge.validity);
                    contradicted[x] = merge.validity == Validity::Measured
                        && self.contradict(&shown, merge.mean.y, noise, 0.0);
                }
            });
        (radiance, contradicted)
    }

    /// What each frame shows at a pixel, by rising exposure, with its exposure.
    pub fn show(&self, x: usize, y: usize, shown: &mut Vec<(Shown, f32)>) {
        shown.clear();
        let of = |&k: &usize| (self.layers[k].shown(x, y), self.exposures[k] as f32);
        shown.extend(self.order.iter().map(of));
    }

    fn pixel(&self, shown: &[(Shown, f32)], noise: Deviations) -> Merge {
        // What is beside a clipped pixel of a JPEG is left out: its colour runs, and a sun's rim rings to well
        // below the codes that count as clipped.
        let usable = |shown: &Shown| {
            let channel = |c: usize| f32::from(u8::from(shown.usable(c, self.channels_apart)));
            Rgb::new(channel(0), channel(1), channel(2))
        };
        let (mut sum_y, mut sum_t, mut longest) = (Rgb::ZERO, Rgb::ZERO, Rgb::ZERO);
        for (shown, t) in shown {
            let usable = usable(shown);
            sum_y += usable * shown.measured.light;
            sum_t += usable * *t;
            longest = Rgb::select(usable.cmpgt(Rgb::ZERO), Rgb::splat(*t), longest);
        }
        if sum_t.min_element() <= 0.0 {
            return self.clipped_everywhere(shown, sum_y, sum_t, noise);
        }
        let guess = sum_y / sum_t;
        // Weights: whether the frame counts, times how far its code is to be believed.
        let weight = |shown: &Shown, t: f32| {
            let bright = (guess * t).cmpge(Rgb::splat(DARKEST_USED)) | longest.cmpeq(Rgb::splat(t));
            usable(shown) * Rgb::select(bright, shown.measured.trust, Rgb::ZERO)
        };
        let (mut sum_y, mut sum_t, mut used) = (Rgb::ZERO, Rgb::ZERO, Rgb::ZERO);
        for (shown, t) in shown {
            let w = weight(shown, *t);
            sum_y += w * shown.measured.light;
            sum_t += w * *t;
            used += Rgb::select(w.cmpgt(Rgb::ZERO), Rgb::ONE, Rgb::ZERO);
        }
        let mean = sum_y / sum_t;
        let mut sum_variance = Rgb::ZERO;
        for (shown, t) in shown {
            let w = weight(shown, *t);
            sum_variance += w * w * (noise.variance(mean * *t) + shown.measured.rounding);
        }
        let variance = sum_variance / (sum_t * sum_t);
        // A pixel is too dark when its luminance is, not when a pure colour lacks one channel.
        let sigma = (LUMINANCE_WEIGHTS * LUMINANCE_WEIGHTS).dot(variance).sqrt();
        let validity = if LUMINANCE_WEIGHTS.dot(mean) < 3.0 * sigma {
            Validity::UpperBound
        } else if used.max_element() >= 2.0 {
            Validity::Measured
        } else {
            Validity::Single
        };
        Merge { mean, variance, validity }
    }

    /// The shortest frame that shows the pixel: the radiance at which it clips, or what it shows beside a
    /// clipped pixel. Channels that a frame measured (`sum_t` above 0) keep their mean.
    fn clipped_everywhere(
        &self,
        shown: &[(Shown, f32)],
        sum_y: Rgb,
        sum_t: Rgb,
        noise: Deviations,
    ) -> Merge {
        let Some((shown, t)) = shown.iter().find(|(shown, _)| shown.state & NO_DATA == 0) else {
            // Outside every frame: at least nothing.
            let (mean, variance) = (Rgb::ZERO, Rgb::ZERO);
            return Merge { mean, variance, validity: Validity::LowerBound };
        };
        let clips = shown.state & CLIPS != 0;
        let measured = sum_t.cmpgt(Rgb::ZERO);
        let mean = Rgb::select(measured, sum_y / sum_t, shown.measured.light / *t);
        let variance = noise.variance(shown.measured.light) / (t * t);
        let validity = if clips { Validity::LowerBound } else { Validity::Single };
        Merge { mean, variance, validity }
    }

    /// Whether one of `shown` contradicts a pixel's mean, in its green: by more than [`CONTRADICTING`] σ of
    /// the noise, of what curve and exposures are off, and of `sigma` in radiance.
    fn contradict(&self, shown: &[(Shown, f32)], mean: f32, noise: Deviations, sigma: f32) -> bool {
        let systematic = (self.systematic as f32 * mean).powi(2) + sigma * sigma;
        let limit = CONTRADICTING * CONTRADICTING;
        shown.iter().any(|(shown, t)| {
            let Measured { light, rounding, .. } = shown.measured;
            // Where it is nearly black and should be, a frame's rounding says what it likes.
            let dark = light.y.max(mean * t) < 4.0 * DARKEST_USED;
            if dark || !shown.usable(1, self.channels_apart) {
                return false;
            }
            let of_noise = noise.variance(Rgb::splat(mean * t)).y + rounding.y;
            let off = light.y / t - mean;
            off * off > limit * (of_noise / (t * t) + systematic)
        })
    }

    /// Whether a frame contradicts a pixel's mean though it may be off by `sigma` for a reason of the place.
    pub fn contradicted(
        &self,
        (x, y): (usize, usize),
        mean: f32,
        noise: &Noise,
        sigma: f32,
    ) -> bool {
        let mut shown = Vec::new();
        self.show(x, y, &mut shown);
        self.contradict(&shown, mean, Deviations::of(noise), sigma)
    }

    /// What a pixel is by one frame alone, if that shows it.
    pub fn alone(&self, slot: usize, x: usize, y: usize, noise: &Noise) -> Option<Merge> {
        let k = self.order[slot];
        let (shown, t) = (self.layers[k].shown(x, y), self.exposures[k] as f32);
        let usable = |channel| shown.usable(channel, self.channels_apart);
        (0..3).all(usable).then(|| Merge {
            mean: shown.measured.light / t,
            variance: (Deviations::of(noise).variance(shown.measured.light)
                + shown.measured.rounding)
                / (t * t),
            validity: Validity::Moved,
        })
    }

    /// Pixels seen in two neighbouring frames, for the noise: a regular subset of some 200 000 pixels at
    /// most, each with a pair for each channel.
    pub fn pairs(&self) -> Vec<Pair> {
        const MOST_PIXELS: usize = 200_000;
        let (w, h) = self.size();
        let all = w * h * 3 * self.order.len().saturating_sub(1);
        // An odd step does not fall into step with a power-of-two row.
        let step = (all / MOST_PIXELS).max(1) | 1;
        let mut pairs = Vec::new();
        for two in self.order.windows(2) {
            let (short, long) = (&self.layers[two[0]], &self.layers[two[1]]);
            let exposures = [self.exposures[two[0]], self.exposures[two[1]]];
            if short.warp != long.warp {
                // A warped frame is interpolated, and its noise with it.
                continue;
            }
            for i in (0..w * h).step_by(step.div_ceil(3)) {
                let shown = [short, long].map(|layer| layer.shown(i % w, i / w));
                if !shown.iter().all(|shown| shown.usable(0, false)) {
                    continue;
                }
                for channel in 0..3 {
                    let y = shown.map(|shown| f64::from(shown.measured.light[channel]));
                    let rounding = |k: usize| {
                        f64::from(shown[k].measured.rounding[channel])
                            / (exposures[k] * exposures[k])
                    };
                    pairs.push(Pair {
                        squared: (y[0] / exposures[0] - y[1] / exposures[1]).powi(2),
                        radiance: (y[0] + y[1]) / (exposures[0] + exposures[1]),
                        exposures,
                        quantisation: rounding(0) + rounding(1),
                    });
                }
            }
        }
        pairs
    }
}
