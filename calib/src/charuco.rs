//! ChArUco boards: a checkerboard whose white squares carry numbered markers, so that part of it is enough.
//!
//! OpenCV names the corners; it places them half a pixel off in 4.6 and not in later versions, so here they
//! are only starts for `cornerSubPix` on linear light with a window that ends before the markers begin.

use opencv::aruco;
use opencv::core::{Point2f, Size, TermCriteria, Vector};
use opencv::imgproc;

use crate::board::BoardError;
use crate::{Picture, mat, targets};

/// A ChArUco board with markers of the dictionary 4x4_250 (which begins with 4x4_50 and 4x4_100).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Charuco {
    /// Inner corners along x and y: one fewer than squares.
    pub columns: usize,
    pub rows: usize,
    /// Marker side ÷ square side.
    pub marker: f64,
}

/// Corners seen: column and row of the inner corner, and its pixel.
pub type Seen = Vec<([usize; 2], [f64; 2])>;

/// Inner corners that a ChArUco board may have along each side.
pub const CORNERS: std::ops::RangeInclusive<usize> = 2..=30;
/// Fewest corners with which a view is worth anything.
pub const FEWEST: usize = 9;

/// Finds the corners of the board that are seen.
pub fn find_charuco(picture: &Picture, board: Charuco) -> Result<Seen, BoardError> {
    let Charuco { columns, rows, marker } = board;
    let fits = CORNERS.contains(&columns) && CORNERS.contains(&rows);
    if !(fits && marker > 0.2 && marker < 0.95) {
        return Err(BoardError::Size { columns, rows });
    }
    mat::prepare();
    let bytes = mat::eight_bit(picture)?;
    let made = targets::charuco(columns + 1, rows + 1, 1.0, marker)?;
    let dictionary =
        aruco::get_predefined_dictionary(aruco::PREDEFINED_DICTIONARY_NAME::DICT_4X4_250)?;
    let parameters = aruco::DetectorParameters::create()?;
    let mut corners = Vector::<Vector<Point2f>>::new();
    let mut ids = Vector::<i32>::new();
    let mut rejected = Vector::<Vector<Point2f>>::new();
    aruco::detect_markers(&bytes, &dictionary, &mut corners, &mut ids, &parameters, &mut rejected)?;
    let missing = BoardError::NotFound { columns, rows };
    if ids.len() < 4 {
        return Err(missing);
    }
    let mut points = Vector::<Point2f>::new();
    let mut numbers = Vector::<i32>::new();
    aruco::interpolate_corners_charuco_def(
        &corners,
        &ids,
        &bytes,
        &made,
        &mut points,
        &mut numbers,
    )?;
    if points.len() < FEWEST || points.len() != numbers.len() {
        return Err(missing);
    }
    let numbers: Vec<i32> = numbers.iter().collect();
    let placed = place(picture, &points, columns, &numbers, marker)?;
    Ok(numbers
        .iter()
        .zip(placed)
        .filter_map(|(&id, pixel)| {
            let id = usize::try_from(id).ok().filter(|id| *id < columns * rows)?;
            // OpenCV numbers row by row from the upper left of its own print.
            Some(([id % columns, id / columns], pixel))
        })
        .collect())
}

/// Sub-pixel places, with windows of a tenth of a square: markers begin at (1 − marker)/2.
fn place(
    picture: &Picture,
    points: &Vector<Point2f>,
    columns: usize,
    ids: &[i32],
    marker: f64,
) -> Result<Vec<[f64; 2]>, BoardError> {
    let starts: Vec<[f64; 2]> = points.iter().map(|p| mat::doubles(&p)).collect();
    let mut square = f64::INFINITY;
    for (i, a) in ids.iter().enumerate() {
        for (j, b) in ids.iter().enumerate() {
            if b - a == 1 && (*a as usize % columns) + 1 < columns {
                square =
                    square.min((starts[i][0] - starts[j][0]).hypot(starts[i][1] - starts[j][1]));
            }
        }
    }
    let free = 0.8 * 0.5 * (1.0 - marker) * if square.is_finite() { square } else { 20.0 };
    let half = free.floor().clamp(2.0, 11.0) as i32;
    let mut moved = points.clone();
    let criteria = TermCriteria::new(3, 100, 1e-4)?;
    let floats = mat::linear(picture)?;
    let window = Size::new(half, half);
    imgproc::corner_sub_pix(&floats, &mut moved, window, Size::new(-1, -1), criteria)?;
    Ok(moved
        .iter()
        .zip(starts)
        .map(|(p, start)| {
            let p = mat::doubles(&p);
            if (p[0] - start[0]).hypot(p[1] - start[1]) < 2.0 { p } else { start }
        })
        .collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::targets::{CHARUCO_CELLS, CHARUCO_MARKER, charuco_pattern};

    #[test]
    fn corners_of_our_own_print_are_found_where_they_are() {
        // 7 × 5 squares of 40 px turned by 0.2 rad; part of the board lies outside the picture.
        let (columns, rows) = (7, 5);
        let cells = charuco_pattern(columns, rows).unwrap();
        let (s, c) = 0.2f64.sin_cos();
        let to_pixel = |a: f64, b: f64| {
            let (x, y) = (40.0 * (a - 3.0), 40.0 * (b - 2.5));
            [190.2 + c * x - s * y, 160.6 + s * x + c * y]
        };
        let (width, height) = (330, 330);
        let mut luma = vec![];
        for j in 0..height {
            for i in 0..width {
                let mut sum = 0.0;
                for k in 0..25 {
                    let x = i as f64 + 1.5 * ((k % 5) as f64 / 5.0 - 0.4) - 190.2;
                    let y = j as f64 + 1.5 * ((k / 5) as f64 / 5.0 - 0.4) - 160.6;
                    let a = ((c * x + s * y) / 40.0 + 3.0) * CHARUCO_CELLS as f64;
                    let b = ((-s * x + c * y) / 40.0 + 2.5) * CHARUCO_CELLS as f64;
                    let w = columns * CHARUCO_CELLS;
                    let on = a >= 0.0
                        && b >= 0.0
                        && (a as usize) < w
                        && (b as usize) < rows * CHARUCO_CELLS;
                    let white = !on || cells[b as usize * w + a as usize];
                    sum += if white { 0.8 } else { 0.05 };
                }
                luma.push((sum / 25.0) as f32);
            }
        }
        let picture = Picture::new(width, height, &luma).unwrap();
        let board = Charuco { columns: 6, rows: 4, marker: CHARUCO_MARKER };
        let seen = find_charuco(&picture, board).unwrap();
        assert!(seen.len() >= 16, "only {} corners", seen.len());
        for ([column, row], p) in &seen {
            let truth = to_pixel(*column as f64 + 1.0, *row as f64 + 1.0);
            let off = (p[0] - truth[0]).hypot(p[1] - truth[1]);
            assert!(off < 0.15, "corner {column},{row}: {p:?} is not {truth:?}");
        }
        let grey = vec![0.5; width * height];
        let picture = Picture::new(width, height, &grey).unwrap();
        assert!(matches!(find_charuco(&picture, board), Err(BoardError::NotFound { .. })));
    }
}
