//! Boards, tags and overlaps in photographs: the only door from this crate to `calib/`.
//!
//! [`Photo`] → corners in pixels and places on the print. Without the feature `opencv` every function
//! here answers [`DetectError::NoOpenCv`]; lenses from files or focal lengths and poses from marked
//! corners need nothing of this.

#[cfg(feature = "opencv")]
mod with_calib;
#[cfg(not(feature = "opencv"))]
mod without_calib;

#[cfg(feature = "opencv")]
pub use self::with_calib::{
    board, calibrate, charuco_pattern, from_calib, tag, tag_pattern, to_calib, turned_cameras,
};
#[cfg(not(feature = "opencv"))]
pub use self::without_calib::{
    board, calibrate, charuco_pattern, tag, tag_pattern, turned_cameras,
};

use std::ops::RangeInclusive;

use glam::{DMat3, DVec2};

use crate::camera::Lens;
use crate::photo::{Image, Photo};
use crate::report::Warning;

/// Inner corners that a checkerboard may have along each side to be found.
pub const CHECKERBOARD_CORNERS: RangeInclusive<usize> = 3..=100;
/// Inner corners that a ChArUco board may have along each side.
pub const CHARUCO_CORNERS: RangeInclusive<usize> = 2..=30;
/// Corners of a ChArUco board that must be seen.
pub const FEWEST_CHARUCO_CORNERS: usize = 9;

/// Why a print was not found, as a sentence without the photograph's name.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum DetectError {
    #[error(
        "finding boards and tags needs OpenCV, and this platelight was built without it; build with the \
         feature `opencv`, or give the lens as a file or focal length and the pose as a rectangle"
    )]
    NoOpenCv,
    #[error("{0}")]
    NotFound(String),
    /// `seen`: the numbers of this family's tags in the photograph.
    #[error(
        "tag {id} is not seen, but {seen}; check family and id, and that the white margin is whole"
    )]
    OtherTags { id: u32, seen: String },
}

/// How one of several overlapping photographs was taken.
#[derive(Clone, Debug, PartialEq)]
pub struct TurnedCamera {
    /// A pinhole.
    pub lens: Lens,
    /// Level where the cameras were; which of them is ahead is the stitcher's choice.
    pub world_from_camera: DMat3,
}

/// A board seen in a photograph.
#[derive(Clone, Debug, PartialEq)]
pub struct BoardSighting {
    /// Place on the print and pixel: metres from the centre of the corner grid, x right, y down.
    pub points: Vec<(DVec2, DVec2)>,
    /// The pattern looks the same upside down: the first corner is the picture's upper left one.
    pub turned_unknown: bool,
    /// Share of the white squares that is clipped.
    pub clipped_white: f64,
}

/// A tag seen in a photograph.
#[derive(Clone, Debug, PartialEq)]
pub struct TagSighting {
    /// Outer corners of the black border: upper left, upper right, lower right, lower left of the print.
    pub corners: [DVec2; 4],
    /// Standard deviation of a corner coordinate, px.
    pub sigma_px: f64,
    /// True if lines along its edges placed the corners, false if only the detector did.
    pub by_edges: bool,
    /// Share of the white around it that is clipped.
    pub clipped_white: f64,
}

/// A lens from views of a board.
#[derive(Clone, Debug)]
pub struct Calibrated {
    pub lens: Lens,
    /// The rung of the model ladder, in words.
    pub model: String,
    /// Standard deviation of a corner coordinate and rms residual of a corner, px.
    pub sigma_px: f64,
    pub rms_px: f64,
    /// For each view: rms residual, and why it was left out.
    pub views: Vec<(f64, Option<String>)>,
    /// Mean and largest projection uncertainty over the frame, px, and share outside all corners.
    pub sigma_projection_px: f64,
    pub worst_projection_px: f64,
    pub extrapolated: f64,
    /// All rungs: name, number of free parameters, rms, BIC, held-out rms, projection uncertainty.
    pub rungs: Vec<Rung>,
    pub warnings: Vec<Warning>,
}

/// One rung of the model ladder.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Rung {
    pub model: String,
    pub n_free: usize,
    pub rms_px: f64,
    pub bic: f64,
    pub held_out_rms_px: Option<f64>,
    pub sigma_projection_px: f64,
}

/// Scene-linear luminance of a photograph.
pub fn luma(photo: &Photo) -> Image<f32> {
    photo.linear.map(|&rgb| crate::conventions::luminance(rgb))
}
