//! Pictures and arrays to and from `platelight-calib`.

use glam::{DMat3, DVec2};
use platelight_calib::board::{Checkerboard, find_checkerboard};
use platelight_calib::calibrate::{View, Warning as LensWarning};
use platelight_calib::charuco::{Charuco, find_charuco};
use platelight_calib::tag::{Family, Placed, find_tags};
use platelight_calib::{Model, Picture};

use super::{BoardSighting, Calibrated, DetectError, Rung, TagSighting, TurnedCamera, luma};
use crate::camera::{Distortion, Lens};
use crate::conventions::OPENCV_FROM_CAMERA;
use crate::photo::{Image, Photo};
use crate::report::Warning;
use crate::shot::camera_keys::Board;

/// Sheets are printed without OpenCV too: its door must know the limits that stand behind it.
const _: () = {
    use platelight_calib::{board, charuco};
    assert!(*board::CORNERS.start() == *super::CHECKERBOARD_CORNERS.start());
    assert!(*board::CORNERS.end() == *super::CHECKERBOARD_CORNERS.end());
    assert!(*charuco::CORNERS.start() == *super::CHARUCO_CORNERS.start());
    assert!(*charuco::CORNERS.end() == *super::CHARUCO_CORNERS.end());
    assert!(charuco::FEWEST == super::FEWEST_CHARUCO_CORNERS);
};

fn not_found(error: impl std::fmt::Display) -> DetectError {
    DetectError::NotFound(error.to_string())
}

/// Shortest side in which a board or tag could be told from noise, px.
const LEAST_SIDE: usize = 16;

fn picture(luma: &Image<f32>) -> Result<Picture<'_>, DetectError> {
    if luma.width().min(luma.height()) < LEAST_SIDE {
        let (w, h) = (luma.width(), luma.height());
        return Err(DetectError::NotFound(format!(
            "a picture of {w} × {h} px is too small to show anything; give the photograph itself"
        )));
    }
    Picture::new(luma.width(), luma.height(), luma.pixels()).ok_or_else(|| {
        let (w, h) = (luma.width(), luma.height());
        DetectError::NotFound(format!(
            "{w} × {h} px with its values cannot be searched: sides up to 32767 px and finite values can"
        ))
    })
}

/// Lenses and turns of the cameras of overlapping photographs; `None` where one overlaps with no other.
pub fn turned_cameras(lumas: &[Image<f32>]) -> Result<Vec<Option<TurnedCamera>>, DetectError> {
    let pictures: Vec<Picture> = lumas.iter().map(picture).collect::<Result<_, _>>()?;
    let found = platelight_calib::stitch::stitch(&pictures).map_err(not_found)?;
    let turned = |camera: platelight_calib::stitch::TurnedCamera| {
        let rows = camera.panorama_from_camera;
        let panorama_from_camera = DMat3::from_cols_array_2d(&rows).transpose();
        let [cx, cy] = camera.principal_px;
        let (fx, fy) = (camera.focal_px, camera.focal_px);
        let lens = Lens { fx, fy, cx, cy, distortion: Distortion::None, covariance: None };
        // Both axes are OpenCV's, and ours are the same change of each.
        let world_from_camera = OPENCV_FROM_CAMERA * panorama_from_camera * OPENCV_FROM_CAMERA;
        TurnedCamera { lens, world_from_camera }
    };
    Ok(found.into_iter().map(|camera| camera.map(turned)).collect())
}

/// Finds a board in a photograph.
pub fn board(photo: &Photo, board: &Board) -> Result<BoardSighting, DetectError> {
    let luma = luma(photo);
    let picture = picture(&luma)?;
    match board {
        Board::Checkerboard { corners: [columns, rows], square_mm } => {
            let grid = Checkerboard { columns: *columns as usize, rows: *rows as usize };
            let found = find_checkerboard(&picture, grid).map_err(not_found)?;
            let centre = DVec2::new(grid.columns as f64 - 1.0, grid.rows as f64 - 1.0) * 0.5;
            let place = |i: usize| {
                let at = DVec2::new((i % grid.columns) as f64, (i / grid.columns) as f64);
                (at - centre) * (square_mm * 1e-3)
            };
            Ok(BoardSighting {
                points: found
                    .pixels
                    .iter()
                    .enumerate()
                    .map(|(i, &p)| (place(i), DVec2::from(p)))
                    .collect(),
                turned_unknown: found.turned_unknown,
                clipped_white: found.clipped_white,
            })
        }
        Board::Charuco { corners, square_mm, marker_mm, dictionary } => {
            charuco(&picture, *corners, *square_mm, *marker_mm, dictionary)
        }
        Board::AprilGrid { tags, tag_mm, spacing } => {
            april_grid(&picture, *tags, *tag_mm, *spacing)
        }
    }
}

fn charuco(
    picture: &Picture,
    [columns, rows]: [u32; 2],
    square_mm: f64,
    marker_mm: f64,
    dictionary: &str,
) -> Result<BoardSighting, DetectError> {
    if !["4x4_50", "4x4_100", "4x4_250"].contains(&dictionary) {
        return Err(not_found(format!(
            "markers of the dictionary {dictionary} cannot be read; 4x4_50, 4x4_100 and 4x4_250 can"
        )));
    }
    let (columns, rows) = (columns as usize, rows as usize);
    let board = Charuco { columns, rows, marker: marker_mm / square_mm };
    let centre = DVec2::new(columns as f64 - 1.0, rows as f64 - 1.0) * 0.5;
    let seen = find_charuco(picture, board).map_err(not_found)?;
    let points = seen
        .iter()
        .map(|([column, row], pixel)| {
            let at = DVec2::new(*column as f64, *row as f64) - centre;
            (at * (square_mm * 1e-3), DVec2::from(*pixel))
        })
        .collect();
    Ok(BoardSighting { points, turned_unknown: false, clipped_white: 0.0 })
}

/// Kalibr's grid: tag 0 at the lower left, ids along rows, rows upward, black border two cells wide.
fn april_grid(
    picture: &Picture,
    [columns, rows]: [u32; 2],
    tag_mm: f64,
    spacing: f64,
) -> Result<BoardSighting, DetectError> {
    const FEWEST_TAGS: usize = 4;
    let found = find_tags(picture, Family::Tag36h11, 2, None).map_err(not_found)?;
    let side = tag_mm * 1e-3;
    let pitch = side * (1.0 + spacing);
    let extent = |n: u32| f64::from(n - 1) * pitch + side;
    let centre = DVec2::new(extent(columns), extent(rows)) * 0.5;
    let mut points = vec![];
    let mut clipped = 0.0;
    let mine: Vec<_> = found.iter().filter(|t| t.id < columns * rows).collect();
    for tag in &mine {
        let (column, row) = (tag.id % columns, rows - 1 - tag.id / columns);
        let corner = DVec2::new(f64::from(column), f64::from(row)) * pitch - centre;
        let offsets = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
        for (offset, pixel) in offsets.iter().zip(&tag.corners) {
            points.push((corner + DVec2::from(*offset) * side, DVec2::from(*pixel)));
        }
        clipped += tag.clipped_white / mine.len() as f64;
    }
    if mine.len() < FEWEST_TAGS {
        let n = mine.len();
        return Err(not_found(format!(
            "{n} tags of the grid are seen, {FEWEST_TAGS} are needed (36h11 with a border two cells wide)"
        )));
    }
    Ok(BoardSighting { points, turned_unknown: false, clipped_white: clipped })
}

/// Finds a tag in a photograph; with the lens its bent edges are followed.
pub fn tag(
    photo: &Photo,
    family: &str,
    id: u32,
    lens: Option<&Lens>,
) -> Result<TagSighting, DetectError> {
    let luma = luma(photo);
    let picture = picture(&luma)?;
    let named = Family::by_name(family)
        .ok_or_else(|| not_found(format!("\"{family}\" is no family of AprilTags")))?;
    let lens = lens.map(to_calib);
    let tags = find_tags(&picture, named, 1, lens.as_ref()).map_err(not_found)?;
    let mut mine = tags.iter().filter(|t| t.id == id);
    let Some(tag) = mine.next() else {
        let ids: Vec<String> = tags.iter().map(|t| t.id.to_string()).collect();
        if !ids.is_empty() {
            return Err(DetectError::OtherTags { id, seen: ids.join(", ") });
        }
        return Err(not_found(format!(
            "no tag of {family} is seen; check family and id, and that the white margin is whole"
        )));
    };
    if mine.next().is_some() {
        return Err(not_found(format!("tag {id} is seen more than once; cover all but one")));
    }
    Ok(TagSighting {
        corners: tag.corners.map(DVec2::from),
        sigma_px: tag.sigma_px,
        by_edges: matches!(tag.placed, Placed::EdgeLines { .. }),
        clipped_white: tag.clipped_white,
    })
}

/// Calibrates a lens from views of a board: for each the places on the print and pixels.
pub fn calibrate(
    width: usize,
    height: usize,
    views: &[Vec<(DVec2, DVec2)>],
) -> Result<Calibrated, DetectError> {
    let views: Vec<View> = views
        .iter()
        .map(|v| View {
            board: v.iter().map(|p| p.0.to_array()).collect(),
            pixels: v.iter().map(|p| p.1.to_array()).collect(),
        })
        .collect();
    let found = platelight_calib::calibrate::calibrate(width, height, &views).map_err(not_found)?;
    let sigma = found.projection.mean_px;
    Ok(Calibrated {
        lens: from_calib(&found.lens, &found.covariance),
        model: found.rung,
        sigma_px: found.sigma_px,
        rms_px: found.rms_px,
        views: found.views.iter().map(|v| (v.rms_px, v.rejected.clone())).collect(),
        sigma_projection_px: sigma,
        worst_projection_px: found.projection.max_px,
        extrapolated: found.projection.extrapolated,
        rungs: found
            .rungs
            .into_iter()
            .map(|r| Rung {
                model: r.name,
                n_free: r.n_free,
                rms_px: r.rms_px,
                bic: r.bic,
                held_out_rms_px: r.held_out_rms_px,
                sigma_projection_px: r.sigma_projection_px,
            })
            .collect(),
        warnings: found.warnings.iter().map(|w| warning(w, sigma)).collect(),
    })
}

fn warning(warning: &LensWarning, sigma_px: f64) -> Warning {
    /// What is put into the frame is not seen to stand beside its place by less than this.
    const SEEN_PX: f64 = 0.5;
    let size = match warning {
        LensWarning::RungsDisagree { apart_px, .. } => format!("{apart_px:.2} px over the frame"),
        LensWarning::Extrapolated { max_px, .. } => {
            let (about, size) = ("camera", "nobody sees so little");
            return if *max_px < SEEN_PX {
                Warning::note(about, warning.to_string(), size)
            } else {
                Warning::new(about, warning.to_string(), "objects there stand beside their place")
            };
        }
        _ => format!("the lens is known to {sigma_px:.2} px over the frame"),
    };
    Warning::new("camera", warning.to_string(), size)
}

/// Cells of a tag's print, border included, and how many to a side; true is white.
pub fn tag_pattern(family: &str, id: u32) -> Result<(usize, Vec<bool>), DetectError> {
    let named = Family::by_name(family)
        .ok_or_else(|| not_found(format!("\"{family}\" is no family of AprilTags")))?;
    let count = named.count().map_err(not_found)?;
    if id as usize >= count {
        return Err(not_found(format!("{family} has tags 0 to {}, not {id}", count - 1)));
    }
    let cells = platelight_calib::tag::pattern(named, id).map_err(not_found)?;
    Ok((named.cells(), cells))
}

/// Cells of a ChArUco board of `columns × rows` squares, and how many to a square's side; true is white.
pub fn charuco_pattern(columns: usize, rows: usize) -> Result<(usize, Vec<bool>), DetectError> {
    let cells = platelight_calib::targets::charuco_pattern(columns, rows).map_err(not_found)?;
    Ok((platelight_calib::targets::CHARUCO_CELLS, cells))
}

/// The same lens as `calib/` writes it: all twelve, or the eight of Kannala–Brandt.
pub fn to_calib(lens: &Lens) -> platelight_calib::Lens {
    let mut parameters = [0.0; platelight_calib::lens::MAX_PARAMETERS];
    let own = lens.parameters();
    parameters[..own.len()].copy_from_slice(&own);
    let model = match lens.distortion {
        Distortion::KannalaBrandt { .. } => Model::KannalaBrandt,
        _ => Model::Brown,
    };
    platelight_calib::Lens { model, parameters }
}

/// A lens of `calib/` with its covariance, in the smallest model that holds it.
pub fn from_calib(lens: &platelight_calib::Lens, covariance: &[f64]) -> Lens {
    let p = &lens.parameters;
    let distortion = match lens.model {
        Model::KannalaBrandt => {
            Distortion::KannalaBrandt { k1: p[4], k2: p[5], k3: p[6], k4: p[7] }
        }
        Model::Brown if p[4..].iter().all(|&k| k == 0.0) => Distortion::None,
        Model::Brown if p[9..].iter().all(|&k| k == 0.0) => {
            Distortion::BrownConrady { k1: p[4], k2: p[5], p1: p[6], p2: p[7], k3: p[8] }
        }
        Model::Brown => Distortion::Rational {
            k1: p[4],
            k2: p[5],
            p1: p[6],
            p2: p[7],
            k3: p[8],
            k4: p[9],
            k5: p[10],
            k6: p[11],
        },
    };
    let mut out = Lens { fx: p[0], fy: p[1], cx: p[2], cy: p[3], distortion, covariance: None };
    let (n, full) = (out.n_parameters(), lens.model.n_parameters());
    out.covariance = Some((0..n * n).map(|k| covariance[(k / n) * full + k % n]).collect());
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shot::camera_keys::FAMILIES;

    #[test]
    fn families_have_as_many_tags_as_the_shot_file_is_told() {
        for (name, tags) in FAMILIES {
            let family = Family::by_name(name).expect("a family");
            assert_eq!(family.count().expect("OpenCV's dictionary"), tags as usize, "{name}");
        }
    }
}
