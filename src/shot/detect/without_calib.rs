//! Answers of a build without OpenCV.

use super::{BoardSighting, Calibrated, DetectError, TagSighting};
use crate::camera::Lens;
use crate::photo::Photo;
use crate::shot::camera_keys::Board;
use glam::DVec2;

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
