//! All frames of a bracket on one grid → the radiance of each pixel.
//!
//! x = ΣY/Σt over the unclipped frames: every photon counts once (Hanji, Zhong & Mantiuk, ECCV 2020).
//! Frames in which the pixel would be darker than about one code are left out, for their rounding
//! to black is a bias; hat weights keep them, and are +9 % … ×170 wrong in the dark. No clipped value
//! ever enters a mean. Codes read through a recovered curve count less towards its ends.

use glam::{BVec4A, Vec4};
use rayon::prelude::*;

use super::layer::{CLIPS, Layer, NO_DATA, Shown};
use super::noise::{Noise, Pair};
use super::{Radiance, Validity};
use crate::conventions::{LUMINANCE_WEIGHTS, Rgb};
use crate::photo::{Image, Measured, RUN_PX, Run};

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

/// One channel of neighbouring pixels, all frames together.
#[derive(Clone)]
struct Sums {
    /// Of light, each frame's times its weight; and of exposures.
    light: [f32; RUN_PX],
    time: [f32; RUN_PX],
    /// Number of frames that count.
    frames: [f32; RUN_PX],
    /// Radiance.
    mean: [f32; RUN_PX],
    variance: [f32; RUN_PX],
}

/// Four neighbouring values of a run: sums are made four at a time, and stay in registers over all frames.
#[inline]
fn four(of: &[f32; RUN_PX], at: usize) -> Vec4 {
    Vec4::from_slice(&of[at..at + 4])
}

impl Sums {
    const NONE: Self = Self {
        light: [0.0; RUN_PX],
        time: [0.0; RUN_PX],
        frames: [0.0; RUN_PX],
        mean: [0.0; RUN_PX],
        variance: [0.0; RUN_PX],
    };

    /// Sums `frames`, by rising exposure, each with it.
    fn fill<'a>(
        &mut self,
        frames: impl Iterator<Item = (&'a Run, f32)> + Clone,
        noise: Deviations,
    ) {
        for at in (0..RUN_PX).step_by(4) {
            let (mut light, mut time, mut longest) = (Vec4::ZERO, Vec4::ZERO, Vec4::ZERO);
            for (run, t) in frames.clone() {
                let measured = four(&run.trust, at).cmpgt(Vec4::ZERO);
                let t = Vec4::select(measured, Vec4::splat(t), Vec4::ZERO);
                light += Vec4::select(measured, four(&run.light, at), Vec4::ZERO);
                time += t;
                longest = longest.max(t);
            }
            let guess = light / time;

            // Weights: whether the frame counts, times how far its code is to be believed.
            let (mut light, mut time, mut counted) = (Vec4::ZERO, Vec4::ZERO, Vec4::ZERO);
            // Of the weights squared: alone, times exposures, and times the variance of rounding.
            let (mut squared, mut squared_time) = (Vec4::ZERO, Vec4::ZERO);
            let mut rounding = Vec4::ZERO;
            for (run, t) in frames.clone() {
                let bright = (guess * t).cmpge(Vec4::splat(DARKEST_USED));
                let counts = bright | longest.cmpeq(Vec4::splat(t));
                let weight = Vec4::select(counts, four(&run.trust, at), Vec4::ZERO);
                light += weight * four(&run.light, at);
                time += weight * t;
                counted += Vec4::select(weight.cmpgt(Vec4::ZERO), Vec4::ONE, Vec4::ZERO);
                let weight_squared = weight * weight;
                squared += weight_squared;
                squared_time += weight_squared * t;
                rounding += weight_squared * four(&run.rounding, at);
            }
            let mean = light / time;
            let photons = mean.max(Vec4::ZERO) * noise.per_light * squared_time;
            let variance = (photons + squared * noise.floor + rounding) / (time * time);
            for (to, from) in [
                (&mut self.light, light),
                (&mut self.time, time),
                (&mut self.frames, counted),
                (&mut self.mean, mean),
                (&mut self.variance, variance),
            ] {
                to[at..at + 4].copy_from_slice(&from.to_array());
            }
        }
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
            .for_each_init(
                || (vec![[Run::EMPTY; 3]; self.order.len()], [Sums::NONE; 3]),
                |(runs, sums), (y, (((mean, variance), validity), contradicted))| {
                    let mean = mean.chunks_mut(RUN_PX).enumerate();
                    let mean = mean.map(|(k, mean)| ((k * RUN_PX, y), mean));
                    let variance = variance.chunks_mut(RUN_PX);
                    let validity = validity.chunks_mut(RUN_PX);
                    let contradicted = contradicted.chunks_mut(RUN_PX);
                    for ((((at, mean), variance), validity), contradicted) in
                        mean.zip(variance).zip(validity).zip(contradicted)
                    {
                        self.sum(at, mean.len(), noise, runs, sums);
                        let contradictions = self.contradictions(runs, &sums[1], noise);
                        for i in 0..mean.len() {
                            let merge = self.pixel((at.0 + i, y), i, sums, noise);
                            (mean[i], variance[i], validity[i]) =
                                (merge.mean, merge.variance, merge.validity);
                            contradicted[i] =
                                merge.validity == Validity::Measured && contradictions[i];
                        }
                    }
                },
            );
        (radiance, contradicted)
    }

    /// What each frame shows at a pixel, by rising exposure, with its exposure.
    fn show(&self, x: usize, y: usize) -> impl Iterator<Item = (Shown, f32)> + '_ {
        self.order.iter().map(move |&k| (self.layers[k].shown(x, y), self.exposures[k] as f32))
    }

    /// Sums over the frames of so many pixels of a row from `at` on, in each channel; leaves in `runs` what each
    /// frame shows there.
    fn sum(
        &self,
        at: (usize, usize),
        pixels: usize,
        noise: Deviations,
        runs: &mut [[Run; 3]],
        sums: &mut [Sums; 3],
    ) {
        for (runs, &k) in runs.iter_mut().zip(self.order) {
            self.layers[k].read(at, pixels, self.channels_apart, runs);
        }
        for (c, sums) in sums.iter_mut().enumerate() {
            sums.fill(self.frames(runs, c), noise);
        }
    }

    /// What the frames show in a channel, each with its exposure.
    fn frames<'a>(
        &'a self,
        runs: &'a [[Run; 3]],
        channel: usize,
    ) -> impl Iterator<Item = (&'a Run, f32)> + Clone {
        let exposures = self.order.iter().map(|&k| self.exposures[k] as f32);
        runs.iter().map(move |runs| &runs[channel]).zip(exposures)
    }

    /// Pixel `at`, whose sums are those of place `i`.
    fn pixel(&self, at: (usize, usize), i: usize, sums: &[Sums; 3], noise: Deviations) -> Merge {
        let of =
            |which: fn(&Sums) -> &[f32; RUN_PX]| Rgb::from([0, 1, 2].map(|c| which(&sums[c])[i]));
        let time = of(|sums| &sums.time);
        if time.min_element() <= 0.0 {
            return self.clipped_everywhere(at, of(|sums| &sums.light), time, noise);
        }
        let (mean, variance) = (of(|sums| &sums.mean), of(|sums| &sums.variance));
        // A pixel is too dark when its luminance is, not when a pure colour lacks one channel.
        let sigma = (LUMINANCE_WEIGHTS * LUMINANCE_WEIGHTS).dot(variance).sqrt();
        let validity = if LUMINANCE_WEIGHTS.dot(mean) < 3.0 * sigma {
            Validity::UpperBound
        } else if of(|sums| &sums.frames).max_element() >= 2.0 {
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
        (x, y): (usize, usize),
        sum_y: Rgb,
        sum_t: Rgb,
        noise: Deviations,
    ) -> Merge {
        let Some((shown, t)) = self.show(x, y).find(|(shown, _)| shown.state & NO_DATA == 0) else {
            // Outside every frame: at least nothing.
            let (mean, variance) = (Rgb::ZERO, Rgb::ZERO);
            return Merge { mean, variance, validity: Validity::LowerBound };
        };
        let clips = shown.state & CLIPS != 0;
        let measured = sum_t.cmpgt(Rgb::ZERO);
        let mean = Rgb::select(measured, sum_y / sum_t, shown.measured.light / t);
        let variance = noise.variance(shown.measured.light) / (t * t);
        let validity = if clips { Validity::LowerBound } else { Validity::Single };
        Merge { mean, variance, validity }
    }

    /// Where one of the frames contradicts the mean in its green.
    fn contradictions(&self, runs: &[[Run; 3]], green: &Sums, noise: Deviations) -> [bool; RUN_PX] {
        let mut contradictions = [false; RUN_PX];
        for (k, contradictions) in contradictions.as_chunks_mut::<4>().0.iter_mut().enumerate() {
            let at = 4 * k;
            let mean = four(&green.mean, at);
            let mut found = BVec4A::FALSE;
            for (run, t) in self.frames(runs, 1) {
                let shown = (four(&run.light, at), four(&run.rounding, at));
                let measured = four(&run.trust, at).cmpgt(Vec4::ZERO);
                found |= measured & self.contradicts(shown, t, mean, noise, 0.0);
            }
            *contradictions = found.into();
        }
        contradictions
    }

    /// Whether what a frame of exposure `t` shows contradicts the mean of four pixels: by more than
    /// [`CONTRADICTING`] σ of the noise, of what curve and exposures are off, and of `sigma` in radiance.
    #[inline]
    fn contradicts(
        &self,
        (light, rounding): (Vec4, Vec4),
        t: f32,
        mean: Vec4,
        noise: Deviations,
        sigma: f32,
    ) -> BVec4A {
        let expected = mean * t;
        let systematic = expected * self.systematic as f32;
        let of_noise = expected.max(Vec4::ZERO) * noise.per_light + noise.floor + rounding;
        let variance = of_noise + systematic * systematic + (sigma * t).powi(2);
        // Where it is nearly black and should be, a frame's rounding says what it likes.
        let bright = light.max(expected).cmpge(Vec4::splat(4.0 * DARKEST_USED));
        let off = light - expected;
        bright & (off * off).cmpgt(variance * (CONTRADICTING * CONTRADICTING))
    }

    /// Whether a frame contradicts a pixel's mean in its green though it may be off by `sigma` for a reason
    /// of the place.
    pub fn contradicted(
        &self,
        (x, y): (usize, usize),
        mean: f32,
        noise: &Noise,
        sigma: f32,
    ) -> bool {
        let noise = Deviations::of(noise);
        self.show(x, y).any(|(shown, t)| {
            let Measured { light, rounding, .. } = shown.measured;
            let shown_four = (Vec4::splat(light.y), Vec4::splat(rounding.y));
            shown.usable(1, self.channels_apart)
                && self.contradicts(shown_four, t, Vec4::splat(mean), noise, sigma).any()
        })
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
