//! Exposures → radiance: the Poisson estimator of methods-capture C3.
//!
//! x = ΣY/Σt over the unclipped frames: every photon counts once (Hanji, Zhong & Mantiuk, ECCV 2020).
//! Frames in which the pixel would be darker than about one code are left out, for their rounding
//! to black is a bias; hat weights keep them, and are +9 % … ×170 wrong in the dark. No clipped value
//! ever enters a mean.

use std::path::PathBuf;

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use super::align;
use super::exposure;
use super::lint::{self, Warning};
use super::noise::{self, Noise, Pair, Quantisation};
use super::response;
use super::{BracketError, Radiance, Validity};
use crate::conventions::{LUMINANCE_WEIGHTS, Rgb};
use crate::photo::{Format, Image, Photo, ToneCurve, Transfer};

/// A photograph of a bracket and how much light it gathered.
#[derive(Clone, Copy, Debug)]
pub struct Frame<'a> {
    pub photo: &'a Photo,
    /// t·(ISO/100)/N² ([`exposure::exposure`]), as labelled.
    pub exposure: f64,
}

/// How to merge.
#[derive(Clone, Copy, Debug)]
pub struct MergeOptions {
    /// Correct labelled exposures from the pixels; otherwise they are taken as true.
    pub refine_exposures: bool,
    pub response: ResponseSource,
    /// Measure shifts between frames and undo those that help.
    pub align: bool,
    /// The camera's noise; `None` measures it in the bracket.
    pub noise: Option<Noise>,
}

impl Default for MergeOptions {
    fn default() -> Self {
        Self {
            refine_exposures: true,
            response: ResponseSource::WhereShown,
            align: true,
            noise: None,
        }
    }
}

/// Which tone curve 8-bit files are read through.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ResponseSource {
    /// What the files say; other curves are only warned of.
    Stated,
    /// The bracket's own where the pixels contradict the files, else what the files say.
    WhereShown,
    /// The bracket's own.
    Bracket,
}

/// A merged bracket and what was found on the way.
#[derive(Clone, Debug)]
pub struct Merged {
    pub radiance: Radiance,
    /// Exposure of each frame as used, in the order given.
    pub exposures: Vec<f64>,
    /// Shift that was undone for each frame, px.
    pub shifts: Vec<DVec2>,
    pub noise: Noise,
    /// The camera's tone curve, where the pixels showed that it is not the files' stated one.
    pub response: Option<ToneCurve>,
    pub warnings: Vec<Warning>,
    /// The frames' paths, in the order given.
    pub paths: Vec<PathBuf>,
    /// Focal lengths in mm, the lens's and the 35-mm equivalent, where all frames agree on them.
    pub focal_mm: [Option<f64>; 2],
}

/// Linear value, about one code of 8 bits, below which a frame is left out (methods-capture C3).
const DARKEST_USED: f64 = 0.004;
/// Chroma subsampling and ringing carry a clipped pixel's colour this far in a JPEG, px.
const JPEG_BLEED_PX: usize = 2;
/// Shifts below this are left alone: undoing them costs more sharpness than they do, px.
const SMALLEST_SHIFT_PX: f64 = 0.25;
/// A shift must lower the residual at least to this share to be believed.
const WORTH_SHIFTING: f64 = 0.9;

/// What all frames say, if they say the same.
fn agreed(frames: &[Frame], fact: impl Fn(&Photo) -> Option<f64>) -> Option<f64> {
    let first = fact(frames.first()?.photo)?;
    frames.iter().all(|frame| fact(frame.photo) == Some(first)).then_some(first)
}

/// Merges the frames of a bracket.
///
/// Mean, variance (photons, read-out and quantisation) and validity of every pixel, in linear value
/// per exposure. One frame is a bracket too: its clipped pixels are lower bounds.
///
/// # Errors
/// No frames, frames of different sizes, an exposure that is no positive number, or a labelled
/// exposure that the pixels contradict by more than 25 %.
pub fn merge(frames: &[Frame], options: &MergeOptions) -> Result<Merged, BracketError> {
    lint::same_size(frames)?;
    for frame in frames {
        if !(frame.exposure.is_finite() && frame.exposure > 0.0) {
            let path = frame.photo.path.clone();
            return Err(BracketError::BadExposure { path, exposure: frame.exposure });
        }
    }
    let mut warnings = Vec::new();
    let copies = lint::duplicates(frames, &mut warnings);
    let is_copy = |k: &usize| copies.iter().any(|(copy, _)| copy == k);
    let mut order: Vec<usize> = (0..frames.len()).filter(|k| !is_copy(k)).collect();
    order.sort_by(|&a, &b| frames[a].exposure.total_cmp(&frames[b].exposure));
    let (shortest, longest) = (order[0], order[order.len() - 1]);
    lint::facts(frames, &order, &mut warnings);
    lint::range(frames[shortest].photo, frames[longest].photo, &mut warnings);

    let labels: Vec<f64> = frames.iter().map(|f| f.exposure).collect();
    let photos: Vec<&Photo> = frames.iter().map(|f| f.photo).collect();
    // Shifted frames give wrong ratios, and wrong ratios hardly disturb the shift: align first.
    let mut layers: Vec<Layer> = photos.iter().map(|photo| Layer::new(photo)).collect();
    if options.align && order.len() > 1 {
        // The middle of the bracket shares most of its range with every other frame.
        let reference = order[order.len() / 2];
        for &k in order.iter().filter(|&&k| k != reference) {
            let found =
                align::measure((photos[reference], labels[reference]), (photos[k], labels[k]));
            let Some(found) = found else { continue };
            layers[k].settle(photos[k], found, &mut warnings);
        }
    }
    let mut response = None;
    let recover = match options.response {
        ResponseSource::Stated => false,
        ResponseSource::WhereShown => exposure::show_tone_curve(&layers, &photos, &labels, &order),
        ResponseSource::Bracket => true,
    };
    if recover {
        response = response::recover(&photos, &layers, &labels, &order);
        if let Some(response) = &response {
            layers
                .iter_mut()
                .zip(&photos)
                .for_each(|(layer, photo)| layer.redecode(photo, response));
            warnings.push(Warning::ResponseRecovered { factor: response.distance_from_srgb() });
        }
    }
    let mut exposures = labels;
    if options.refine_exposures && order.len() > 1 {
        let mut found = Vec::new();
        let refined = exposure::refine(&layers, &photos, &exposures, &order, &mut found)?;
        if response.is_none() {
            exposures = refined;
        } else {
            // A recovered curve was fitted to the labels: they can be checked, no longer corrected,
            // and no warning may say that they were.
            found.retain(|warning| !matches!(warning, Warning::LabelOff { .. }));
        }
        warnings.extend(found);
    }
    for &(copy, original) in &copies {
        exposures[copy] = exposures[original];
    }

    let stack = Stack { layers: &layers, exposures: &exposures, order: &order };
    let noise = options.noise.or_else(|| noise::measure(&stack.pairs())).unwrap_or_else(|| {
        let Noise { full_well_e, read_noise_e, .. } = Noise::TYPICAL;
        warnings.push(Warning::NoiseAssumed { full_well_e, read_noise_e });
        Noise::TYPICAL
    });
    Ok(Merged {
        radiance: stack.merge(&noise),
        shifts: layers.iter().map(|l| l.shift).collect(),
        exposures,
        noise,
        response,
        warnings,
        paths: frames.iter().map(|f| f.photo.path.clone()).collect(),
        focal_mm: [
            agreed(frames, |photo| photo.facts.focal_mm),
            agreed(frames, |photo| photo.facts.focal_35mm),
        ],
    })
}

/// A frame as it enters the merge.
pub(super) struct Layer {
    pub linear: Image<Rgb>,
    /// True where nothing is clipped, near a clipped pixel, or outside after a shift.
    pub usable: Image<bool>,
    /// True where the pixel itself is clipped, as stored.
    clipped: Image<bool>,
    quantisation: Quantisation,
    shift: DVec2,
}

impl Layer {
    fn new(photo: &Photo) -> Self {
        let clipped = match photo.format {
            Format::Jpeg => dilated(&photo.clipped, JPEG_BLEED_PX),
            _ => photo.clipped.clone(),
        };
        Self {
            linear: photo.linear.clone(),
            usable: clipped.map(|&c| !c),
            clipped: photo.clipped.clone(),
            quantisation: Quantisation::new(&photo.samples, photo.encoding.clone()),
            shift: DVec2::ZERO,
        }
    }

    /// Whether the pixel itself, not only a neighbour, is clipped; `None` outside the frame.
    fn clips(&self, x: usize, y: usize) -> Option<bool> {
        let (dx, dy) = self.whole_shift();
        let at = |v: usize, d: i64| usize::try_from(v as i64 + d).ok();
        self.clipped.get(at(x, dx)?, at(y, dy)?).copied()
    }

    /// The shift that was undone, in whole pixels.
    pub fn whole_shift(&self) -> (i64, i64) {
        (self.shift.x.round() as i64, self.shift.y.round() as i64)
    }

    /// Reads the photograph's codes again through a recovered curve.
    fn redecode(&mut self, photo: &Photo, curve: &ToneCurve) {
        let Ok(photo) = photo.redecoded(Transfer::Measured(curve.clone())) else { return };
        self.quantisation = Quantisation::new(&photo.samples, photo.encoding);
        self.linear = photo.linear;
        if self.shift != DVec2::ZERO {
            // The mask is shifted already, and shrinks no further.
            let (linear, _) = align::undo(&self.linear, &self.usable, self.shift);
            self.linear = linear;
        }
    }

    /// Undoes a measured shift if that makes the frame fit better.
    fn settle(&mut self, photo: &Photo, found: align::Alignment, warnings: &mut Vec<Warning>) {
        let path = photo.path.clone();
        let shift = (found.shift.x, found.shift.y);
        if found.shift.length() < SMALLEST_SHIFT_PX {
            return;
        }
        if found.residual_ratio < WORTH_SHIFTING {
            (self.linear, self.usable) = align::undo(&self.linear, &self.usable, found.shift);
            self.shift = found.shift;
            warnings.push(Warning::Moved { path, shift });
        } else if found.shift.length() > 1.0 {
            warnings.push(Warning::NotAligned { path, shift });
        }
    }
}

/// True wherever a true pixel is within `radius` px along both axes.
fn dilated(mask: &Image<bool>, radius: usize) -> Image<bool> {
    let spread = |length: usize, at: &dyn Fn(usize) -> bool| -> Vec<bool> {
        (0..length)
            .map(|i| (i.saturating_sub(radius)..(i + radius + 1).min(length)).any(at))
            .collect()
    };
    let (w, h) = (mask.width(), mask.height());
    let mut wide = mask.clone();
    for y in 0..h {
        let row = spread(w, &|x| mask[(x, y)]);
        wide.pixels_mut()[y * w..(y + 1) * w].copy_from_slice(&row);
    }
    let mut both = wide.clone();
    for x in 0..w {
        for (y, value) in spread(h, &|y| wide[(x, y)]).into_iter().enumerate() {
            both[(x, y)] = value;
        }
    }
    both
}

/// All frames on one grid with their exposures.
struct Stack<'a> {
    layers: &'a [Layer],
    exposures: &'a [f64],
    /// Frames by rising exposure, copies left out.
    order: &'a [usize],
}

/// One pixel's result.
struct Merge {
    mean: Rgb,
    variance: Rgb,
    validity: Validity,
}

impl Stack<'_> {
    fn merge(&self, noise: &Noise) -> Radiance {
        let (w, h) = (self.layers[0].linear.width(), self.layers[0].linear.height());
        let rows: Vec<Vec<Merge>> = (0..h)
            .into_par_iter()
            .map(|y| (0..w).map(|x| self.pixel(x, y, noise)).collect())
            .collect();
        let mut radiance = Radiance {
            mean: Image::filled(w, h, Rgb::ZERO),
            variance: Image::filled(w, h, Rgb::ZERO),
            validity: Image::filled(w, h, Validity::LowerBound),
        };
        for (i, merge) in rows.into_iter().flatten().enumerate() {
            radiance.mean.pixels_mut()[i] = merge.mean;
            radiance.variance.pixels_mut()[i] = merge.variance;
            radiance.validity.pixels_mut()[i] = merge.validity;
        }
        radiance
    }

    fn pixel(&self, x: usize, y: usize, noise: &Noise) -> Merge {
        let usable = |k: &&usize| self.layers[**k].usable[(x, y)];
        let Some(&longest) = self.order.iter().rev().find(usable) else {
            return self.clipped_everywhere(x, y, noise);
        };
        let value = |k: usize| self.layers[k].linear[(x, y)].as_dvec3();
        let (mut sum_y, mut sum_t) = (DVec3::ZERO, 0.0);
        for &k in self.order.iter().filter(usable) {
            sum_y += value(k);
            sum_t += self.exposures[k];
        }
        let first_guess = sum_y / sum_t;
        let (mut mean, mut variance) = (DVec3::ZERO, DVec3::ZERO);
        let mut frames_used = 0;
        for channel in 0..3 {
            let guess = first_guess[channel];
            let bright = |k: &&usize| **k == longest || guess * self.exposures[**k] >= DARKEST_USED;
            let (mut sum_y, mut sum_t, mut n) = (0.0, 0.0, 0);
            for &k in self.order.iter().filter(usable).filter(bright) {
                sum_y += value(k)[channel];
                sum_t += self.exposures[k];
                n += 1;
            }
            mean[channel] = sum_y / sum_t;
            let noise_of = |&k: &usize| {
                let y = mean[channel] * self.exposures[k];
                noise.variance(y) + self.layers[k].quantisation.variance(y)
            };
            let sum_variance: f64 =
                self.order.iter().filter(usable).filter(bright).map(noise_of).sum();
            variance[channel] = sum_variance / (sum_t * sum_t);
            frames_used = frames_used.max(n);
        }
        // A pixel is too dark when its luminance is, not when a pure colour lacks one channel.
        let weights = LUMINANCE_WEIGHTS.as_dvec3();
        let sigma = (weights * weights).dot(variance).sqrt();
        let validity = if weights.dot(mean) < 3.0 * sigma {
            Validity::UpperBound
        } else if frames_used >= 2 {
            Validity::Measured
        } else {
            Validity::Single
        };
        Merge { mean: mean.as_vec3(), variance: variance.as_vec3(), validity }
    }

    /// The shortest frame that shows the pixel: the radiance at which it clips, or what it shows
    /// beside a clipped pixel.
    fn clipped_everywhere(&self, x: usize, y: usize, noise: &Noise) -> Merge {
        let shown = |&k: &usize| Some((k, self.layers[k].clips(x, y)?));
        let Some((k, clips)) = self.order.iter().find_map(shown) else {
            // Outside every frame: at least nothing.
            let (mean, variance) = (Rgb::ZERO, Rgb::ZERO);
            return Merge { mean, variance, validity: Validity::LowerBound };
        };
        let t = self.exposures[k];
        let value = self.layers[k].linear[(x, y)].as_dvec3();
        let variance = value.to_array().map(|y| noise.variance(y) / (t * t));
        let variance = DVec3::from(variance).as_vec3();
        let validity = if clips { Validity::LowerBound } else { Validity::Single };
        Merge { mean: (value / t).as_vec3(), variance, validity }
    }

    /// Pixels seen in two neighbouring frames, for the noise: a regular subset of some 200 000 pixels at
    /// most, each with a pair for each channel.
    fn pairs(&self) -> Vec<Pair> {
        const MOST_PIXELS: usize = 200_000;
        let Some(first) = self.layers.first() else { return Vec::new() };
        let all = first.linear.pixels().len() * 3 * self.order.len().saturating_sub(1);
        // An odd step does not fall into step with a power-of-two row.
        let step = (all / MOST_PIXELS).max(1) | 1;
        let mut pairs = Vec::new();
        for two in self.order.windows(2) {
            let (short, long) = (&self.layers[two[0]], &self.layers[two[1]]);
            let exposures = [self.exposures[two[0]], self.exposures[two[1]]];
            if short.shift != long.shift {
                // A shifted frame is interpolated, and its noise with it.
                continue;
            }
            for i in (0..first.linear.pixels().len()).step_by(step.div_ceil(3)) {
                if !(short.usable.pixels()[i] && long.usable.pixels()[i]) {
                    continue;
                }
                for channel in 0..3 {
                    let y = [short, long].map(|l| f64::from(l.linear.pixels()[i][channel]));
                    let radiance = (y[0] + y[1]) / (exposures[0] + exposures[1]);
                    let rounding =
                        |layer: &Layer, t: f64| layer.quantisation.variance(radiance * t) / (t * t);
                    pairs.push(Pair {
                        squared: (y[0] / exposures[0] - y[1] / exposures[1]).powi(2),
                        radiance,
                        exposures,
                        quantisation: rounding(short, exposures[0]) + rounding(long, exposures[1]),
                    });
                }
            }
        }
        pairs
    }
}
