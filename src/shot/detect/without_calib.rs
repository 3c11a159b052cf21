//! Answers of a build without OpenCV.

use super::{BoardSighting, Calibrated, DetectError, TagSighting, TurnedCamera};
use crate::camera::Lens;
use crate::photo::{Image, Photo};
use crate::shot::camera_keys::Board;
use glam::DVec2;

/// Lenses and turns of the cameras of overlapping photographs.
pub fn turned_cameras(_: &[Image<f32>]) -> Result<Vec<Option<TurnedCamera>>, DetectError> {
    Err(DetectError::NotFound(
        "stitching needs OpenCV, and this platelight was built without it; build with the feature \
         `opencv`, or stitch in another program and give the panorama"
            .into(),
    ))
}

/// Finds a board in a photograph.
pub fn board(_: &Photo, _: &Board) -> Result<BoardSighting, DetectError> {
    Err(DetectError::NoOpenCv)
}

/// Finds a tag in a photograph.
pub fn tag(_: &Photo, _: &str, _: u32, _: Option<&Lens>) -> Result<TagSighting, DetectError> {
    Err(DetectError::NoOpenCv)
}

/// Calibrates a lens from views of a board.
pub fn calibrate(_: usize, _: usize, _: &[Vec<(DVec2, DVec2)>]) -> Result<Calibrated, DetectError> {
    Err(DetectError::NoOpenCv)
}

/// Cells of a tag's print.
pub fn tag_pattern(_: &str, _: u32) -> Result<(usize, Vec<bool>), DetectError> {
    Err(DetectError::NoOpenCv)
}

/// Cells of a ChArUco board.
pub fn charuco_pattern(_: usize, _: usize) -> Result<(usize, Vec<bool>), DetectError> {
    Err(DetectError::NoOpenCv)
}
