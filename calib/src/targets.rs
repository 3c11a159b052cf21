//! Patterns of printable targets as OpenCV will look for them.

use opencv::aruco;
use opencv::core::{Mat, MatTraitConst, MatTraitConstManual, Ptr, Size};
use opencv::prelude::CharucoBoardTrait;

use crate::{OpenCvError, mat};

/// Cells of a ChArUco square along its side: a marker of six cells and a margin of one.
pub const CHARUCO_CELLS: usize = 8;
/// Marker side ÷ square side of the boards drawn here.
pub const CHARUCO_MARKER: f64 = 0.75;

/// A ChArUco board: `columns × rows` squares with 4 × 4-bit markers from the dictionary 4x4_250.
pub(crate) fn charuco(
    columns: usize,
    rows: usize,
    square_m: f64,
    marker_m: f64,
) -> Result<Ptr<aruco::CharucoBoard>, OpenCvError> {
    let dictionary =
        aruco::get_predefined_dictionary(aruco::PREDEFINED_DICTIONARY_NAME::DICT_4X4_250)?;
    let (columns, rows) = (columns as i32, rows as i32);
    Ok(aruco::CharucoBoard::create(columns, rows, square_m as f32, marker_m as f32, &dictionary)?)
}

/// The print of a ChArUco board of `columns × rows` squares: row-major cells, true is white,
/// [`CHARUCO_CELLS`] cells a square.
pub fn charuco_pattern(columns: usize, rows: usize) -> Result<Vec<bool>, OpenCvError> {
    // OpenCV draws into pixels; four to a cell, and the second is looked at.
    const PIXELS: usize = 4;
    mat::prepare();
    let mut board = charuco(columns, rows, 1.0, CHARUCO_MARKER)?;
    let side = |n: usize| (n * CHARUCO_CELLS * PIXELS) as i32;
    let mut drawn = Mat::default();
    board.draw(Size::new(side(columns), side(rows)), &mut drawn, 0, 1)?;
    let mut cells = Vec::with_capacity(columns * rows * CHARUCO_CELLS * CHARUCO_CELLS);
    for row in (PIXELS / 2..drawn.rows() as usize).step_by(PIXELS) {
        let pixels = drawn.at_row::<u8>(row as i32)?;
        cells.extend(pixels.iter().skip(PIXELS / 2).step_by(PIXELS).map(|&v| v > 127));
    }
    Ok(cells)
}
