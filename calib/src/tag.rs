//! AprilTags: found by OpenCV, placed by lines along their edges.
//!
//! The detector sees the picture through a square root, which it likes; corners are placed on linear
//! light (`edge_lines.rs`). Where edges are too short or too blurred the detector's own corners stay, with
//! an honest σ. OpenCV 4.6 returns them half a pixel off (its AprilTag code counts pixel centres from
//! 0.5); a tag drawn in memory tells at start whether this OpenCV does.

use std::sync::OnceLock;

use opencv::aruco;
use opencv::core::{Mat, MatTraitConst, MatTraitConstManual, Point2f, Ptr, Vector};
use opencv::prelude::{DetectorParametersTrait, DictionaryTraitConst};

use crate::lens::Lens;
use crate::{OpenCvError, Picture, edge_lines, mat};

/// A family of AprilTags.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Family {
    Tag36h11,
    Tag36h10,
    Tag25h9,
    Tag16h5,
}

impl Family {
    /// `36h11`, `36h10`, `25h9` or `16h5`.
    pub fn by_name(name: &str) -> Option<Self> {
        Some(match name {
            "36h11" => Self::Tag36h11,
            "36h10" => Self::Tag36h10,
            "25h9" => Self::Tag25h9,
            "16h5" => Self::Tag16h5,
            _ => return None,
        })
    }

    /// Cells along a side, border included.
    pub fn cells(self) -> usize {
        match self {
            Self::Tag36h11 | Self::Tag36h10 => 8,
            Self::Tag25h9 => 7,
            Self::Tag16h5 => 6,
        }
    }

    pub(crate) fn dictionary(self) -> Result<Ptr<aruco::Dictionary>, OpenCvError> {
        use aruco::PREDEFINED_DICTIONARY_NAME as Name;
        let name = match self {
            Self::Tag36h11 => Name::DICT_APRILTAG_36h11,
            Self::Tag36h10 => Name::DICT_APRILTAG_36h10,
            Self::Tag25h9 => Name::DICT_APRILTAG_25h9,
            Self::Tag16h5 => Name::DICT_APRILTAG_16h5,
        };
        Ok(aruco::get_predefined_dictionary(name)?)
    }

    /// Number of tags in the family.
    pub fn count(self) -> Result<usize, OpenCvError> {
        Ok(self.dictionary()?.bytes_list().rows() as usize)
    }
}

/// A tag seen in a picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Tag {
    pub id: u32,
    /// Outer corners of the black border: upper left, upper right, lower right, lower left of the print.
    pub corners: [[f64; 2]; 4],
    /// Standard deviation of a corner coordinate, px.
    pub sigma_px: f64,
    pub placed: Placed,
    /// Share of the white around it that is clipped; corners are then up to a pixel off.
    pub clipped_white: f64,
}

/// What placed a tag's corners.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Placed {
    /// Lines along the edges, whose blur was this many px.
    EdgeLines { blur_px: f64 },
    /// The detector: the tag is too small or too blurred for more.
    Detector,
}

/// Smallest σ claimed for a corner placed by edge lines, px.
pub const EDGE_SIGMA_FLOOR_PX: f64 = 0.03;
/// σ of a corner the detector placed, px (measured 0.14 on linear light, more when small).
const DETECTOR_SIGMA_PX: f64 = 0.25;

/// All tags of a family in a picture, sorted by id. `border` is the black border's width in cells (1, or 2
/// on Kalibr's grids). With the lens, bent edges are followed.
pub fn find_tags(
    picture: &Picture,
    family: Family,
    border: usize,
    lens: Option<&Lens>,
) -> Result<Vec<Tag>, OpenCvError> {
    mat::prepare();
    let shift = detector_shift()?;
    let bytes = mat::eight_bit(picture)?;
    let mut found = detect(&bytes, family, border, aruco::CORNER_REFINE_APRILTAG, shift)?;
    // The contour detector finds some tags the other misses.
    for other in detect(&bytes, family, border, aruco::CORNER_REFINE_SUBPIX, 0.0)? {
        if found.iter().all(|(id, _)| *id != other.0) {
            found.push(other);
        }
    }
    found.sort_by_key(|(id, _)| *id);
    let cells = (family.cells() - 2 + 2 * border) as f64;
    Ok(found
        .into_iter()
        .map(|(id, corners)| match edge_lines::refine(picture, lens, corners, cells) {
            Some(square) => Tag {
                id,
                corners: square.corners,
                sigma_px: square.sigma_px.max(EDGE_SIGMA_FLOOR_PX),
                placed: Placed::EdgeLines { blur_px: square.blur_px },
                clipped_white: square.clipped_white,
            },
            None => Tag {
                id,
                corners,
                sigma_px: DETECTOR_SIGMA_PX,
                placed: Placed::Detector,
                clipped_white: 0.0,
            },
        })
        .collect())
}

type Detected = (u32, [[f64; 2]; 4]);

fn detect(
    bytes: &Mat,
    family: Family,
    border: usize,
    refinement: i32,
    shift: f64,
) -> Result<Vec<Detected>, OpenCvError> {
    let dictionary = family.dictionary()?;
    let mut parameters = aruco::DetectorParameters::create()?;
    parameters.set_corner_refinement_method(refinement);
    parameters.set_marker_border_bits(border as i32);
    let mut corners = Vector::<Vector<Point2f>>::new();
    let mut ids = Vector::<i32>::new();
    let mut rejected = Vector::<Vector<Point2f>>::new();
    aruco::detect_markers(bytes, &dictionary, &mut corners, &mut ids, &parameters, &mut rejected)?;
    let tags = corners.iter().zip(ids.iter()).filter_map(|(quad, id)| {
        let points: Vec<[f64; 2]> =
            quad.iter().map(|p| mat::doubles(&p).map(|v| v - shift)).collect();
        Some((u32::try_from(id).ok()?, points.try_into().ok()?))
    });
    Ok(tags.collect())
}

/// How far this OpenCV's AprilTag refinement puts corners to the lower right: 0 or ½ px.
fn detector_shift() -> Result<f64, OpenCvError> {
    static SHIFT: OnceLock<f64> = OnceLock::new();
    if let Some(&shift) = SHIFT.get() {
        return Ok(shift);
    }
    const CELL: usize = 12;
    const FROM: usize = 40;
    let bits = pattern(Family::Tag36h11, 0)?;
    let n = Family::Tag36h11.cells();
    let size = 2 * FROM + n * CELL;
    let mut drawn = vec![230u8; size * size];
    for (row, line) in bits.chunks(n).enumerate() {
        for (column, &white) in line.iter().enumerate() {
            for j in 0..CELL {
                for i in 0..CELL {
                    let at = (FROM + row * CELL + j) * size + FROM + column * CELL + i;
                    drawn[at] = if white { 230 } else { 25 };
                }
            }
        }
    }
    let picture = Mat::new_rows_cols_with_data(size as i32, size as i32, &drawn)?;
    let mut soft = Mat::default();
    let kernel = opencv::core::Size::new(5, 5);
    opencv::imgproc::gaussian_blur_def(&picture, &mut soft, kernel, 0.8)?;
    let found = detect(&soft, Family::Tag36h11, 1, aruco::CORNER_REFINE_APRILTAG, 0.0)?;
    // The square's edges lie between pixels: FROM − ½ and FROM + 8·CELL − ½.
    let (low, high) = (FROM as f64 - 0.5, (FROM + n * CELL) as f64 - 0.5);
    let truth = [[low, low], [high, low], [high, high], [low, high]];
    let mean = found.first().map_or(0.5, |(_, corners)| {
        corners.iter().zip(&truth).map(|(a, b)| a[0] - b[0] + a[1] - b[1]).sum::<f64>() / 8.0
    });
    let shift = if mean > 0.25 { 0.5 } else { 0.0 };
    Ok(*SHIFT.get_or_init(|| shift))
}

/// The print of a tag, border included: row-major, true is white.
pub fn pattern(family: Family, id: u32) -> Result<Vec<bool>, OpenCvError> {
    let cells = family.cells();
    let mut drawn = Mat::default();
    let id = i32::try_from(id).unwrap_or(i32::MAX);
    aruco::draw_marker(&family.dictionary()?, id, cells as i32, &mut drawn, 1)?;
    let mut bits = Vec::with_capacity(cells * cells);
    for row in 0..drawn.rows() {
        bits.extend(drawn.at_row::<u8>(row)?.iter().map(|&v| v > 127));
    }
    Ok(bits)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Quantiles of a triangle 2 px wide: the pixel's area and a little lens blur.
    fn soft(k: usize) -> f64 {
        let q = (k as f64 + 0.5) / 8.0;
        if q < 0.5 { (2.0 * q).sqrt() - 1.0 } else { 1.0 - (2.0 - 2.0 * q).sqrt() }
    }

    /// A tag turned by `angle`, cell 14 px, centre (200.3, 180.6), drawn with 64 samples a pixel.
    fn draw(id: u32, angle: f64, cell: f64) -> (Vec<f32>, [[f64; 2]; 4]) {
        let bits = pattern(Family::Tag36h11, id).unwrap();
        let (s, c) = angle.sin_cos();
        let (cx, cy) = (200.3, 180.6);
        let mut luma = vec![];
        for j in 0..360 {
            for i in 0..400 {
                let mut sum = 0.0;
                for k in 0..64 {
                    let x = i as f64 + soft(k % 8) - cx;
                    let y = j as f64 + soft(k / 8) - cy;
                    let (a, b) = ((c * x + s * y) / cell + 4.0, (-s * x + c * y) / cell + 4.0);
                    let on = (0.0..8.0).contains(&a) && (0.0..8.0).contains(&b);
                    let white = !on || bits[b as usize * 8 + a as usize];
                    sum += if white { 0.8 } else { 0.04 };
                }
                luma.push((sum / 64.0) as f32);
            }
        }
        let corner = |a: f64, b: f64| {
            let (x, y) = (a * 4.0 * cell, b * 4.0 * cell);
            [cx + c * x - s * y, cy + s * x + c * y]
        };
        let corners = [corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
        (luma, corners)
    }

    fn worst(tag: &Tag, truth: &[[f64; 2]; 4]) -> f64 {
        let off = |(a, b): (&[f64; 2], &[f64; 2])| (a[0] - b[0]).hypot(a[1] - b[1]);
        tag.corners.iter().zip(truth).map(off).fold(0.0, f64::max)
    }

    #[test]
    fn tags_are_found_upright_and_placed_to_a_fortieth_of_a_pixel() {
        for (id, angle) in [(0, 0.15), (7, 1.9), (23, 4.0), (586, 5.5)] {
            let (luma, truth) = draw(id, angle, 14.0);
            let picture = Picture::new(400, 360, &luma).unwrap();
            let tags = find_tags(&picture, Family::Tag36h11, 1, None).unwrap();
            assert_eq!(tags.len(), 1, "tag {id}");
            assert_eq!(tags[0].id, id);
            let off = worst(&tags[0], &truth);
            assert!(off < 0.025, "tag {id} off by {off} px, {:?}", tags[0].placed);
        }
    }

    #[test]
    fn the_detector_alone_has_no_half_pixel_offset() {
        // F10, F12: a tag of 26 px keeps the detector's corners and a wider σ.
        // Single corners may miss by 0.4 px; turned four ways, an offset of the convention would stay.
        let mut mean = [0.0; 2];
        for turn in 0..4 {
            let (luma, truth) = draw(11, 0.4 + 1.571 * f64::from(turn), 3.2);
            let picture = Picture::new(400, 360, &luma).unwrap();
            let tags = find_tags(&picture, Family::Tag36h11, 1, None).unwrap();
            assert_eq!(tags[0].placed, Placed::Detector);
            for (found, known) in tags[0].corners.iter().zip(&truth) {
                mean = [0, 1].map(|k| mean[k] + (found[k] - known[k]) / 16.0);
            }
        }
        assert!(mean[0].abs() < 0.15 && mean[1].abs() < 0.15, "{mean:?}");
    }

    /// AprilTag's own first code, 0xd5d628584, row by row from the upper left, 1 is white.
    const FIRST: [&str; 6] = ["110101", "011101", "011000", "101000", "010110", "000100"];

    #[test]
    fn prints_are_those_of_apriltag_turned_upside_down() {
        let bits = pattern(Family::Tag36h11, 0).unwrap();
        let inner = |row: usize, column: usize| bits[(row + 1) * 8 + column + 1];
        let theirs = |row: usize, column: usize| FIRST[row].as_bytes()[column] == b'1';
        let same = (0..36).all(|k| inner(k / 6, k % 6) == theirs(k / 6, k % 6));
        let turned = (0..36).all(|k| inner(k / 6, k % 6) == theirs(5 - k / 6, 5 - k % 6));
        assert!(!same && turned, "same {same}, turned {turned}: {bits:?}");
    }

    #[test]
    fn unknown_ids_are_errors_and_empty_pictures_have_no_tags() {
        assert!(pattern(Family::Tag36h11, 587).is_err());
        assert!(pattern(Family::Tag36h11, u32::MAX).is_err());
        assert_eq!(Family::Tag36h11.count().unwrap(), 587);
        let grey = vec![0.5; 200 * 100];
        let picture = Picture::new(200, 100, &grey).unwrap();
        assert!(find_tags(&picture, Family::Tag16h5, 1, None).unwrap().is_empty());
    }
}
