//! Exposure brackets → radiance.
//!
//! `[Photo]` with exposures → [`Radiance`]: mean, variance and validity of every pixel, on one scale.
//! Start with [`merge()`]. This room never unwraps or moves a picture except to align a bracket.

mod align;
#[cfg(test)]
mod defect_tests;
pub mod exposure;
pub mod file;
mod ghosts;
pub mod group;
mod layer;
mod lint;
mod merge;
mod noise;
mod response;
#[cfg(test)]
mod simulation;
mod stack;
mod warp;

pub use self::align::disagreement_px;
pub use self::lint::Warning;
pub use self::merge::{Frame, MergeOptions, Merged, ResponseSource, merge};
pub use self::noise::Noise;
pub use self::response::{Response, ResponseMethod};
pub use self::warp::{Warp, WarpKind};

use std::path::PathBuf;

use crate::conventions::Rgb;
use crate::photo::{Image, PhotoError};

/// Why a bracket cannot be merged.
#[derive(Debug, thiserror::Error)]
pub enum BracketError {
    #[error("no photographs to merge; name at least one")]
    NoFrames,
    #[error(
        "{} is {} × {} px but {} is {} × {} px; the frames of a bracket have one size",
        a.display(), a_size.0, a_size.1, b.display(), b_size.0, b_size.1
    )]
    SizesDiffer { a: PathBuf, b: PathBuf, a_size: (usize, usize), b_size: (usize, usize) },
    #[error("{}: EXIF has no {missing}, so its exposure is not known; give the times of all frames (--times or --times-file)", path.display())]
    NoExposure { path: PathBuf, missing: String },
    #[error("{}: exposure {exposure} is not a positive number; give time, f-number and ISO as positive numbers (--times, or the shot file's exposures)", path.display())]
    BadExposure { path: PathBuf, exposure: f64 },
    #[error("{times} times for {photos} photographs; give one for each")]
    TimesCount { times: usize, photos: usize },
    #[error("\"{text}\" is not a shutter time in seconds; write 0.5 or 1/60")]
    BadTime { text: String },
    #[error("{}: is not in the list of times; add a line with its name and time", path.display())]
    NotListed { path: PathBuf },
    #[error("{}: is in the list of times more than once; keep one line", path.display())]
    ListedTwice { path: PathBuf },
    #[error(
        "the list of times names files, but has the time {time} without a name; give every line a name, or none"
    )]
    TimeWithoutName { time: f64 },
    #[error("{} has ISO and f-number in its EXIF, {} has not, so that their exposures cannot be compared; copy the EXIF over, or remove it from all and give --times", with.display(), without.display())]
    MixedExif { with: PathBuf, without: PathBuf },
    #[error(
        "{} and {}: the exposures are stated as 1:{label:.3}, but the pixels say 1:{measured:.3}; correct the times (--times)",
        short.display(), long.display()
    )]
    WrongLabel { short: PathBuf, long: PathBuf, label: f64, measured: f64 },
    #[error("{}: {pixels} pixels are not finite, the first at ({}, {}); repair the picture (NaN and infinity poison every sum of light)", path.display(), first.0, first.1)]
    NotFinite { path: PathBuf, pixels: u64, first: (usize, usize) },
    #[error(
        "{photos} photographs do not make brackets of {count}; give another count (--group), or name the files of each bracket"
    )]
    GroupCount { count: usize, photos: usize },
    #[error(transparent)]
    Photo(#[from] PhotoError),
}

/// What is known of the light at each pixel of a merged bracket.
///
/// Unit: linear photograph value (white = 1) divided by exposure `t · (ISO/100) / N²`, so two
/// pictures of one camera share it whatever their exposures.
#[derive(Clone, Debug)]
pub struct Radiance {
    pub mean: Image<Rgb>,
    /// Variance of `mean`, per channel, same unit squared.
    pub variance: Image<Rgb>,
    pub validity: Image<Validity>,
}

/// How well a pixel's radiance is known (methods-capture C3). Later steps keep the worst of what they mix.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Validity {
    /// Seen unclipped in two or more exposures.
    Measured = 0,
    /// Seen unclipped in one exposure.
    Single = 1,
    /// Clipped in the shortest exposure: the radiance is at least this.
    LowerBound = 2,
    /// Below 3σ in the longest exposure: the radiance is at most this.
    UpperBound = 3,
    /// Something moved between exposures.
    Moved = 4,
    /// Not seen; filled from elsewhere.
    Filled = 5,
    /// Replaced by an analytic light or model.
    Analytic = 6,
}
