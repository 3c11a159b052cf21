//! Exposures → radiance: what is done to a bracket, in its order.
//!
//! Lint, alignment, tone curve, exposures, noise, the mean of every pixel ([`super::stack`]), and what moved.

use std::path::PathBuf;

use super::align;
use super::exposure;
use super::ghosts;
use super::layer::Layer;
use super::lint::{self, Warning};
use super::noise::{self, Noise};
use super::response::{self, Response};
use super::stack::{SYSTEMATIC, Stack};
use super::warp::{Warp, WarpKind};
use super::{BracketError, Radiance};
use crate::photo::{Encoded, Facts};

/// A photograph of a bracket and how much light it gathered.
#[derive(Clone, Copy, Debug)]
pub struct Frame<'a> {
    pub photo: &'a Encoded,
    /// t·(ISO/100)/N² ([`exposure::exposure`]), as labelled.
    pub exposure: f64,
}

/// How to merge.
#[derive(Clone, Copy, Debug)]
pub struct MergeOptions {
    /// Correct labelled exposures from the pixels; otherwise they are taken as true.
    pub refine_exposures: bool,
    pub response: ResponseSource,
    /// Measure how the frames lie on each other and undo what helps.
    pub align: bool,
    /// Take what moved between the frames from one of them.
    pub drop_ghosts: bool,
    /// The camera's noise; `None` measures it in the bracket.
    pub noise: Option<Noise>,
}

impl Default for MergeOptions {
    fn default() -> Self {
        Self {
            refine_exposures: true,
            response: ResponseSource::WhereShown,
            align: true,
            drop_ghosts: true,
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
    /// The bracket's own, one for all channels, by which another photograph can be read too.
    Bracket,
}

/// A merged bracket and what was found on the way.
#[derive(Clone, Debug)]
pub struct Merged {
    pub radiance: Radiance,
    /// Exposure of each frame as used, in the order given.
    pub exposures: Vec<f64>,
    /// σ of each frame's measured ratio to the next shorter one, relative; `None` where none was measured.
    pub sigma_exposures: Vec<Option<f64>>,
    /// What was undone for each frame.
    pub warps: Vec<Warp>,
    pub noise: Noise,
    /// The camera's tone curve, where the pixels showed that it is not the files' stated one.
    pub response: Option<Response>,
    pub warnings: Vec<Warning>,
    /// The frames' paths, in the order given.
    pub paths: Vec<PathBuf>,
    /// Focal lengths in mm, the lens's and the 35-mm equivalent, where all frames agree on them.
    pub focal_mm: [Option<f64>; 2],
}

/// What all frames say, if they say the same.
fn agreed(frames: &[Frame], fact: impl Fn(&Facts) -> Option<f64>) -> Option<f64> {
    let first = fact(&frames.first()?.photo.facts)?;
    frames.iter().all(|frame| fact(&frame.photo.facts) == Some(first)).then_some(first)
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
    let mut layers: Vec<Layer> = frames.iter().map(|frame| Layer::new(frame.photo)).collect();
    lint::facts(frames, &order, &mut warnings);
    lint::range(&layers[order[0]], &layers[order[order.len() - 1]], &mut warnings);

    let labels: Vec<f64> = frames.iter().map(|f| f.exposure).collect();
    // Shifted frames give wrong ratios, and wrong ratios hardly disturb the shift: align first.
    if options.align {
        align_all(&mut layers, &labels, &order, &mut warnings);
    }
    let mut ratios = exposure::ratios(&layers, &order);
    let response = match options.response {
        ResponseSource::Stated => None,
        ResponseSource::WhereShown => exposure::show_tone_curve(&ratios, &layers, &labels, &order)
            .then(|| response::recover(&layers, &labels, &order, false))
            .flatten(),
        ResponseSource::Bracket => response::recover(&layers, &labels, &order, true),
    };
    if let Some(response) = &response {
        layers.iter_mut().for_each(|layer| layer.read_through(&response.curves));
        ratios = exposure::ratios(&layers, &order);
        warnings.push(Warning::ResponseRecovered {
            factor: response.distance_from_srgb(),
            method: response.method,
            per_channel: response.per_channel,
            held_out: response.held_out,
        });
    }
    let mut exposures = labels;
    let mut sigma_exposures = vec![None; exposures.len()];
    if options.refine_exposures && order.len() > 1 {
        let mut found = Vec::new();
        let refined = exposure::refine(&ratios, &layers, &exposures, &order, &mut found)?;
        if response.is_none() {
            (exposures, sigma_exposures) = (refined.exposures, refined.sigma);
        } else {
            // A recovered curve was fitted to the labels: they can be checked, no longer corrected, and no
            // warning may say that they were. What the curve leaves is said with it.
            found.retain(|warning| {
                !matches!(warning, Warning::LabelOff { .. } | Warning::ToneCurve { .. })
            });
        }
        warnings.extend(found);
    }
    for &(copy, original) in &copies {
        exposures[copy] = exposures[original];
    }

    let curve_off = response.as_ref().map_or(0.0, |response| 2.0 * response.held_out);
    let stack = Stack {
        layers: &layers,
        exposures: &exposures,
        order: &order,
        channels_apart: response.as_ref().is_some_and(|response| response.per_channel),
        systematic: SYSTEMATIC.hypot(curve_off),
    };
    let noise = options.noise.or_else(|| noise::measure(&stack.pairs())).unwrap_or_else(|| {
        let Noise { full_well_e, read_noise_e, .. } = Noise::TYPICAL;
        warnings.push(Warning::NoiseAssumed { full_well_e, read_noise_e });
        Noise::TYPICAL
    });
    let (mut radiance, contradicted) = stack.merge(&noise);
    if options.drop_ghosts
        && let Some((pixels, first)) = ghosts::drop(&stack, &mut radiance, contradicted, &noise)
    {
        let share = pixels as f64 / radiance.mean.pixels().len() as f64;
        warnings.push(Warning::Ghosts { pixels, share, first });
    }
    Ok(Merged {
        radiance,
        warps: layers.iter().map(|layer| layer.warp).collect(),
        exposures,
        sigma_exposures,
        noise,
        response,
        warnings,
        paths: frames.iter().map(|f| f.photo.path.clone()).collect(),
        focal_mm: [
            agreed(frames, |facts| facts.focal_mm),
            agreed(frames, |facts| facts.focal_35mm),
        ],
    })
}

/// Lays every frame on the middle one of `order`; where the two share too little, on the neighbour between
/// them, whose own error it then takes over.
fn align_all(layers: &mut [Layer], labels: &[f64], order: &[usize], warnings: &mut Vec<Warning>) {
    let middle = order.len() / 2;
    let outwards = (0..middle).rev().map(|i| (i, i + 1));
    for (i, neighbour) in outwards.chain((middle + 1..order.len()).map(|i| (i, i - 1))) {
        let k = order[i];
        let measure = |by: usize| {
            let found = align::measure((&layers[by], labels[by]), (&layers[k], labels[k]))?;
            Some((by, found))
        };
        let found = measure(order[middle]).or_else(|| measure(order[neighbour]));
        let path = layers[k].photo.path.clone();
        let size = (layers[k].photo.width, layers[k].photo.height);
        let Some((by, found)) = found else {
            // Nothing to be seen in both: it most likely lies as its neighbour does.
            layers[k].warp = layers[order[neighbour]].warp;
            continue;
        };
        layers[k].warp = found.warp.after(&layers[by].warp);
        let shift = (found.shift.x, found.shift.y);
        if found.kind != WarpKind::None {
            let reach_px = layers[k].warp.reach_px(size.0, size.1);
            warnings.push(Warning::Moved { path, by: found.kind, reach_px });
        } else if found.shift.length() > 1.0 {
            warnings.push(Warning::NotAligned { path, shift });
        }
    }
}
