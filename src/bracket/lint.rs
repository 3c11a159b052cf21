//! What can be said against a bracket before it is merged.

use std::path::PathBuf;

use super::layer::{CLIPS, Layer, NO_DATA};
use super::response::ResponseMethod;
use super::warp::WarpKind;
use super::{BracketError, Frame};
use crate::photo::Encoded;

/// Something about a bracket a person should know; with its size where it has one.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Warning {
    #[error("{} and {} have the same exposure (within 2 %): they lower noise but widen no range", a.display(), b.display())]
    SameExposure { a: PathBuf, b: PathBuf },
    #[error("{} and {} are the same picture; one of them is left out", a.display(), b.display())]
    Duplicate { a: PathBuf, b: PathBuf },
    #[error("{} and {} are {stops:.1} stops apart (usable are up to 3): what lies between is noisy", short.display(), long.display())]
    Gap { short: PathBuf, long: PathBuf, stops: f64 },
    #[error("{} and {} differ in {what}: {a_value} and {b_value}", a.display(), b.display())]
    Differs { a: PathBuf, b: PathBuf, what: &'static str, a_value: String, b_value: String },
    #[error(
        "the shutter times span {shutter:.1} stops, but ISO changes against them: the photographs differ by {exposure:.1} stops only, and the longest are noisier, not brighter (bracket at one ISO)"
    )]
    IsoCancels { shutter: f64, exposure: f64 },
    #[error("{}: {pixels} px ({:.2} %) are clipped in this shortest exposure, first at ({}, {}): their radiance is only a lower bound", path.display(), 100.0 * share, first.0, first.1)]
    ClippedInShortest { path: PathBuf, pixels: usize, share: f64, first: (usize, usize) },
    #[error("{}: {:.0} % of this longest exposure is black: the dark parts are only noise", path.display(), 100.0 * share)]
    BlackInLongest { path: PathBuf, share: f64 },
    #[error("{} and {}: too few pixels are well exposed in both to check their stated exposures against each other", short.display(), long.display())]
    RatioUnchecked { short: PathBuf, long: PathBuf },
    #[error("{} and {}: the exposures are stated as 1:{label:.3}, the pixels say 1:{measured:.3}; the pixels are believed", short.display(), long.display())]
    LabelOff { short: PathBuf, long: PathBuf, label: f64, measured: f64 },
    #[error(
        "{} and {}: 1:{measured:.2} in the pixels where 1:{label:.2} is stated, varying by {:.0} % from dark to bright: the camera's tone curve is not the assumed one, and radiance is wrong by about as much",
        short.display(), long.display(), 100.0 * spread
    )]
    ToneCurve { short: PathBuf, long: PathBuf, label: f64, measured: f64, spread: f64 },
    #[error(
        "the camera's tone curve is not sRGB (up to a factor {factor:.2}); it was recovered from the bracket by {method} method, {} (off by {:.1} % on what was left out of the fit), but a single photograph such as the plate is still read as sRGB",
        if *per_channel { "a curve for each channel" } else { "one curve for all channels" }, 100.0 * held_out
    )]
    ResponseRecovered { factor: f64, method: ResponseMethod, per_channel: bool, held_out: f64 },
    #[error("{}: was moved by {by} of up to {reach_px:.1} px to lie on the others", path.display())]
    Moved { path: PathBuf, by: WarpKind, reach_px: f64 },
    #[error("{pixels} px ({:.2} %) moved between the photographs, first at ({}, {}); each such place is taken from one photograph alone", 100.0 * share, first.0, first.1)]
    Ghosts { pixels: usize, share: f64, first: (usize, usize) },
    #[error("{}: lies ({:.1}, {:.1}) px off the others, but moving it makes it fit no better; check for rotation or motion", path.display(), shift.0, shift.1)]
    NotAligned { path: PathBuf, shift: (f64, f64) },
    #[error(
        "camera noise was not measurable in this bracket; full well {full_well_e:.0} e⁻ and read noise {read_noise_e:.0} e⁻ are assumed"
    )]
    NoiseAssumed { full_well_e: f64, read_noise_e: f64 },
}

impl Warning {
    /// Whether somebody should look at it or mend it; false of what the merge took care of, of clipped
    /// pixels, which their own validity class follows to the end, and of what only lowers the noise.
    pub fn asks(&self) -> bool {
        match self {
            Self::Gap { .. }
            | Self::IsoCancels { .. }
            | Self::Differs { .. }
            | Self::BlackInLongest { .. }
            | Self::LabelOff { .. }
            | Self::ToneCurve { .. } => true,
            // Noise and compression make some by chance.
            Self::Ghosts { share, .. } => *share > 0.005,
            // In a frame that shares little with the others so small a shift is often chance.
            Self::NotAligned { shift: (x, y), .. } => x.hypot(*y) > 2.0,
            Self::SameExposure { .. }
            | Self::Duplicate { .. }
            | Self::ClippedInShortest { .. }
            | Self::RatioUnchecked { .. }
            | Self::ResponseRecovered { .. }
            | Self::Moved { .. }
            | Self::NoiseAssumed { .. } => false,
        }
    }
}

/// Largest useful step of a bracket, stops (methods-capture C3, bracket plan).
const MAX_STEP_STOPS: f64 = 3.0;
/// Stops that ISO may take from a bracket before it is told.
const CANCELLED_STOPS: f64 = 1.0;
/// Share of black pixels in the longest frame from which on it is too short.
const MAX_BLACK: f64 = 0.05;
/// About this many pixels of larger frames are looked at for it.
const MOST_LOOKED_AT: usize = 1 << 19;
/// Linear value below which a pixel is black: about half a code of 8 bits at the foot of sRGB.
const BLACK: f32 = 1.5e-4;

/// Checks sizes; later steps may index all frames alike.
pub(super) fn same_size(frames: &[Frame]) -> Result<(), BracketError> {
    let size = |photo: &Encoded| (photo.width, photo.height);
    let Some(first) = frames.first() else { return Err(BracketError::NoFrames) };
    match frames.iter().find(|f| size(f.photo) != size(first.photo)) {
        Some(other) => Err(BracketError::SizesDiffer {
            a: first.photo.path.clone(),
            b: other.photo.path.clone(),
            a_size: size(first.photo),
            b_size: size(other.photo),
        }),
        None => Ok(()),
    }
}

/// What the labels and facts of the frames say; `order` lists them by rising exposure.
pub(super) fn facts(frames: &[Frame], order: &[usize], warnings: &mut Vec<Warning>) {
    let path = |k: usize| frames[k].photo.path.clone();
    for pair in order.windows(2) {
        let (short, long) = (pair[0], pair[1]);
        let stops = (frames[long].exposure / frames[short].exposure).log2();
        // 2 %: the third-stop labels next to each other are 26 % apart.
        if stops < 1.02f64.log2() {
            warnings.push(Warning::SameExposure { a: path(short), b: path(long) });
        } else if stops > MAX_STEP_STOPS + 0.1 {
            warnings.push(Warning::Gap { short: path(short), long: path(long), stops });
        }
    }
    let first = &frames[order[0]].photo.facts;
    let differs = |what, get: fn(&crate::photo::Facts) -> Option<f64>| {
        order.iter().find_map(|&k| {
            let (a, b) = (get(first)?, get(&frames[k].photo.facts)?);
            ((a / b).ln().abs() > 0.01).then(|| Warning::Differs {
                a: path(order[0]),
                b: path(k),
                what,
                a_value: a.to_string(),
                b_value: b.to_string(),
            })
        })
    };
    let span = |of: &dyn Fn(&Frame) -> Option<f64>| -> Option<f64> {
        let values = order.iter().map(|&k| of(&frames[k]).map(f64::log2));
        let stops: Vec<f64> = values.collect::<Option<_>>()?;
        let (low, high) =
            stops.iter().fold((f64::MAX, f64::MIN), |(low, high), &s| (low.min(s), high.max(s)));
        Some(high - low)
    };
    let shutter = span(&|frame| frame.photo.facts.exposure_s);
    if let (Some(shutter), Some(exposure)) = (shutter, span(&|frame| Some(frame.exposure)))
        && shutter - exposure > CANCELLED_STOPS
        && differs("ISO", |f| f.iso).is_some()
    {
        warnings.push(Warning::IsoCancels { shutter, exposure });
    }
    // Time is meant to change. ISO changes noise, aperture changes blur and vignetting, focal
    // length changes the picture itself.
    warnings.extend(differs("ISO", |f| f.iso));
    warnings.extend(differs("f-number", |f| f.f_number));
    warnings.extend(differs("focal length (mm)", |f| f.focal_mm));
}

/// What the pixels of the shortest and the longest frame say.
pub(super) fn range(shortest: &Layer, longest: &Layer, warnings: &mut Vec<Warning>) {
    let (width, height) = (shortest.photo.width, shortest.photo.height);
    let pixels = width * height;
    let clips = |state: &u8| state & CLIPS != 0 && state & NO_DATA == 0;
    if let Some(first) = shortest.states().iter().position(clips) {
        let clipped = shortest.states().iter().filter(|state| clips(state)).count();
        warnings.push(Warning::ClippedInShortest {
            path: shortest.photo.path.clone(),
            pixels: clipped,
            share: clipped as f64 / pixels as f64,
            first: (first % width, first / width),
        });
    }
    let dark = |i: &usize| {
        let (x, y) = (i % width, i / width);
        longest.state(x, y) & NO_DATA == 0 && longest.own_light(x, y).max_element() < BLACK
    };
    // A regular part is enough; an odd step does not fall into step with a power-of-two row.
    let step = (pixels / MOST_LOOKED_AT).max(1) | 1;
    let share =
        (0..pixels).step_by(step).filter(dark).count() as f64 / pixels.div_ceil(step) as f64;
    if share > MAX_BLACK {
        warnings.push(Warning::BlackInLongest { path: longest.photo.path.clone(), share });
    }
}

/// Frames that are the same picture as an earlier one (copies, not re-shots: noise never repeats), each
/// with the first such picture.
pub(super) fn duplicates(frames: &[Frame], warnings: &mut Vec<Warning>) -> Vec<(usize, usize)> {
    let mut copies = Vec::new();
    for k in 1..frames.len() {
        let is_copy = |j: &usize| frames[*j].photo.samples == frames[k].photo.samples;
        if let Some(j) = (0..k).find(is_copy) {
            let path = |k: usize| frames[k].photo.path.clone();
            warnings.push(Warning::Duplicate { a: path(j), b: path(k) });
            copies.push((k, j));
        }
    }
    copies
}
