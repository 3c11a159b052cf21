//! Exposure brackets → radiance.
//!
//! `[Photo]` with exposures → [`Radiance`]: mean, variance and validity of every pixel, on one scale.
//! This room never unwraps or moves a picture except to align a bracket.

use crate::conventions::Rgb;
use crate::photo::Image;

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
