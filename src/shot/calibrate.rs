//! `[camera]`: photographs of a board, a file, or a focal length → the plate's lens with its errors.

use std::path::{Path, PathBuf};

use glam::DVec2;
use rayon::prelude::*;

use super::camera_keys::{Board, CameraSource};
use super::detect::{self, DetectError, Rung};
use super::pictures;
use crate::camera::lens::focal_px;
use crate::camera::{Camera, Distortion, Lens, file};
use crate::photo::{self, Facts, PhotoError, ReadOptions};
use crate::report::{CameraReport, ViewReport, Warning};

/// A lens for pictures of one size, and everything the report says about it.
#[derive(Clone, Debug)]
pub struct FoundLens {
    pub lens: Lens,
    pub width: usize,
    pub height: usize,
    pub report: CameraReport,
    /// All rungs of the model ladder, if the lens was calibrated here.
    pub rungs: Vec<Rung>,
    pub warnings: Vec<Warning>,
}

/// Why there is no lens.
#[derive(Debug, thiserror::Error)]
pub enum LensError {
    #[error("{}: {cause}", pattern.display())]
    Photos { pattern: PathBuf, cause: String },
    #[error(transparent)]
    Photo(#[from] PhotoError),
    #[error("{key}: {cause}")]
    Absurd { key: &'static str, cause: String },
    #[error("{photo}: {cause}", photo = photo.display())]
    Detect { photo: PathBuf, cause: DetectError },
    #[error("none of {n} photographs shows the board; {}: {cause}", first.display())]
    NoBoard { n: usize, first: PathBuf, cause: DetectError },
    #[error("calibration from {n} photographs: {cause}")]
    Calibrate { n: usize, cause: DetectError },
    #[error(transparent)]
    File(#[from] file::CameraFileError),
    #[error(
        "{}: its EXIF has no focal length; give camera.focal_mm, or photograph a board", plate.display()
    )]
    NoFocal { plate: PathBuf },
    #[error(
        "the lens is known for {}×{} px but the plate has {}×{}: another aspect, so it was cropped; \
         calibrate at the plate's own setting", from[0], from[1], to[0], to[1]
    )]
    OtherShape { from: [usize; 2], to: [usize; 2] },
}

/// The lens that `[camera]` names, for a photograph of that size and those facts.
pub fn find_lens(
    source: &CameraSource,
    [width, height]: [usize; 2],
    facts: &Facts,
    photo: &Path,
) -> Result<FoundLens, LensError> {
    let found = match source {
        CameraSource::Boards { photos, board } => {
            let files = pictures::expand(photos)
                .map_err(|cause| LensError::Photos { pattern: photos.clone(), cause })?;
            let (mut found, of_boards) = from_boards(&files, board)?;
            found.warnings.extend(other_setting(&of_boards, facts));
            found
        }
        CameraSource::File(path) => {
            let read = file::read(path)?;
            let Camera { lens, width, height, .. } = read.camera;
            let covers = lens.covers(width, height);
            let mut found = plain(lens, width, height, &path.display().to_string());
            found.warnings.extend((!covers).then(|| outside_the_lens(path)));
            found
        }
        CameraSource::Focal { focal_mm, sensor_mm } => {
            let sensor = sensor_mm.unwrap_or(36.0);
            let found = nominal(*focal_mm, sensor, width, height, "focal_mm")
                .ok_or_else(|| LensError::NoFocal { plate: photo.into() })?;
            plausible(found, "focal_mm")?
        }
        CameraSource::Exif { sensor_mm } => facts
            .focal_mm
            .and_then(|focal| nominal(focal, *sensor_mm, width, height, "EXIF"))
            .ok_or_else(|| LensError::NoFocal { plate: photo.into() })
            .and_then(|found| plausible(found, "exif_sensor_mm"))?,
    };
    fit_to(found, width, height)
}

/// The lens, if one like it can be built. A file's is checked where the file is read.
fn plausible(found: FoundLens, key: &'static str) -> Result<FoundLens, LensError> {
    match found.lens.check_plausible(found.width, found.height) {
        Ok(()) => Ok(found),
        Err(cause) => Err(LensError::Absurd { key, cause }),
    }
}

/// Calibrates from photographs of a board; also the facts of the first one used.
pub fn from_boards(files: &[PathBuf], board: &Board) -> Result<(FoundLens, Facts), LensError> {
    let options = ReadOptions::default();
    let seen: Vec<Seen> = files
        .par_iter()
        .map(|path| {
            let photo = photo::read(path, &options)?;
            let size = [photo.linear.width(), photo.linear.height()];
            let sighting = detect::board(&photo, board);
            Ok(Seen { path: path.clone(), size, sighting, facts: photo.facts })
        })
        .collect::<Result<_, PhotoError>>()?;
    if let Some(Seen { sighting: Err(DetectError::NoOpenCv), path, .. }) = seen.first() {
        return Err(LensError::Detect { photo: path.clone(), cause: DetectError::NoOpenCv });
    }

    // One lens has one size of picture: the one most photographs have.
    let size = commonest(seen.iter().map(|s| s.size));
    let mut views = vec![];
    let mut reports = vec![];
    for photo in &seen {
        let rejected = match &photo.sighting {
            Err(cause) => Some(cause.to_string()),
            Ok(_) if photo.size != size => Some(format!(
                "it is {}×{} px where the others are {}×{}",
                photo.size[0], photo.size[1], size[0], size[1]
            )),
            Ok(sighting) => {
                views.push((reports.len(), sighting.points.clone()));
                None
            }
        };
        reports.push(ViewReport { photo: photo.path.clone(), rms_px: None, rejected });
    }
    if views.is_empty() {
        let n = seen.len();
        return Err(match seen.into_iter().find_map(|s| Some((s.path, s.sighting.err()?))) {
            Some((first, cause)) => LensError::NoBoard { n, first, cause },
            None => LensError::Photos { pattern: PathBuf::new(), cause: "no photographs".into() },
        });
    }

    let points: Vec<_> = views.iter().map(|(_, points)| points.clone()).collect();
    let n = points.len();
    let found = detect::calibrate(size[0], size[1], &points)
        .map_err(|cause| LensError::Calibrate { n, cause })?;
    for ((at, _), (rms_px, rejected)) in views.iter().zip(&found.views) {
        reports[*at].rms_px = Some(*rms_px);
        reports[*at].rejected = rejected.clone();
    }
    let used = reports.iter().filter(|r| r.rejected.is_none()).count();
    let mut warnings = found.warnings.clone();
    warnings.extend(clipped_boards(&seen));
    let facts = seen[views[0].0].facts.clone();
    let mut out = plain(found.lens, size[0], size[1], &format!("{used} photographs of a board"));
    out.report.distortion += &format!(" (free: {})", found.model);
    out.report.sigma_projection_px = Some(found.sigma_projection_px);
    out.report.rms_px = Some(found.rms_px);
    out.report.views = reports;
    out.rungs = found.rungs;
    out.warnings = warnings;
    Ok((out, facts))
}

/// A photograph that was searched for the board.
struct Seen {
    path: PathBuf,
    size: [usize; 2],
    sighting: Result<detect::BoardSighting, DetectError>,
    facts: Facts,
}

fn commonest(sizes: impl Iterator<Item = [usize; 2]>) -> [usize; 2] {
    let mut counts: Vec<([usize; 2], usize)> = vec![];
    for size in sizes {
        match counts.iter_mut().find(|(s, _)| *s == size) {
            Some((_, n)) => *n += 1,
            None => counts.push((size, 1)),
        }
    }
    // The first of equally common sizes, so that the order of files decides and not chance.
    let most = counts.iter().map(|(_, n)| *n).max().unwrap_or(0);
    counts.iter().find(|(_, n)| *n == most).map_or([0, 0], |(size, _)| *size)
}

fn clipped_boards(seen: &[Seen]) -> Option<Warning> {
    const MUCH: f64 = 0.2;
    let clipped: Vec<&Path> = seen
        .iter()
        .filter(|s| s.sighting.as_ref().is_ok_and(|b| b.clipped_white > MUCH))
        .map(|s| s.path.as_path())
        .collect();
    let first = clipped.first()?;
    Some(Warning::new(
        "camera.boards",
        format!(
            "{}: the board's white is clipped, in {} photographs; expose them shorter",
            first.display(),
            clipped.len()
        ),
        "corners may be off by 0.1 px",
    ))
}

/// Parts of the frame that a file's lens has no directions for.
fn outside_the_lens(path: &Path) -> Warning {
    let sentence = format!(
        "{}: the lens has no direction for some pixels at the border of the picture: its distortion \
         folds there, or a fisheye's circle ends",
        path.display()
    );
    Warning::new("camera.file", sentence, "objects and shadows are not seen there")
}

/// Boards and plate taken at different focal lengths.
fn other_setting(boards: &Facts, plate: &Facts) -> Option<Warning> {
    const SAME: f64 = 0.005;
    let (a, b) = (boards.focal_mm?, plate.focal_mm?);
    let ratio = b / a;
    ((ratio - 1.0).abs() > SAME).then(|| {
        Warning::new(
            "camera.boards",
            format!(
                "the boards were taken at {a} mm and the plate at {b} mm; calibrate at the plate's"
            ),
            format!("{:.1} % of the focal length", 100.0 * (ratio - 1.0).abs()),
        )
    })
}

/// A lens with the report filled from the lens itself.
fn plain(lens: Lens, width: usize, height: usize, source: &str) -> FoundLens {
    let name = match lens.distortion {
        Distortion::None => "pinhole",
        Distortion::BrownConrady { .. } => "Brown-Conrady",
        Distortion::Rational { .. } => "rational",
        Distortion::KannalaBrandt { .. } => "Kannala-Brandt",
    };
    let mut found = FoundLens {
        lens,
        width,
        height,
        report: CameraReport {
            source: source.to_owned(),
            distortion: name.to_owned(),
            ..CameraReport::default()
        },
        rungs: vec![],
        warnings: vec![],
    };
    found.fill_report();
    found
}

impl FoundLens {
    fn fill_report(&mut self) {
        let lens = &self.lens;
        self.report.size_px = [self.width, self.height];
        self.report.focal_px = [lens.fx, lens.fy];
        self.report.sigma_focal_px = lens.sigmas().map(|s| s[0]);
        self.report.principal_point_px = [lens.cx, lens.cy];
        self.report.distortion_coefficients = lens.distortion.coefficients();
        self.report.distortion_names = lens.distortion.names().to_vec();
        let straight = Lens { distortion: Distortion::None, covariance: None, ..lens.clone() };
        let (right, below) = (self.width as f64 - 1.0, self.height as f64 - 1.0);
        let corners = [(0.0, 0.0), (right, 0.0), (0.0, below), (right, below)];
        let moved = corners.into_iter().filter_map(|corner| {
            let corner = DVec2::from(corner);
            Some(straight.project(lens.unproject(corner)?)?.distance(corner))
        });
        self.report.distortion_px = moved.reduce(f64::max);
    }
}

/// A pinhole from a focal length in millimetres, with the error such numbers have.
///
/// `sensor_mm` is the sensor's longer side, which lies along the picture's longer side.
fn nominal(
    focal_mm: f64,
    sensor_mm: f64,
    width: usize,
    height: usize,
    who: &str,
) -> Option<FoundLens> {
    /// Engraved and EXIF focal lengths are rounded and change with focus.
    const FOCAL_SIGMA: f64 = 0.02;
    /// Sensors are not centred behind lenses to better than this share of the width.
    const CENTRE_SIGMA: f64 = 0.005;
    let focal = focal_px(focal_mm, sensor_mm, width.max(height))?;
    let mut lens = Lens::pinhole(focal, width, height);
    let (f, c) = ((FOCAL_SIGMA * focal).powi(2), (CENTRE_SIGMA * width as f64).powi(2));
    #[rustfmt::skip]
    let covariance = vec![
        f, f, 0.0, 0.0,
        f, f, 0.0, 0.0,
        0.0, 0.0, c, 0.0,
        0.0, 0.0, 0.0, c,
    ];
    lens.covariance = Some(covariance);
    let source = format!("{focal_mm} mm ({who}) on a sensor {sensor_mm} mm wide");
    let mut found = plain(lens, width, height, &source);
    found.warnings.push(Warning::new(
        "camera",
        "the focal length is nominal and the lens has no distortion; calibrate with a board for more",
        format!("about {:.0} % of the focal length", 100.0 * FOCAL_SIGMA),
    ));
    Some(found)
}

/// The same lens for a picture of another size, if it is the same frame scaled.
fn fit_to(found: FoundLens, width: usize, height: usize) -> Result<FoundLens, LensError> {
    const SAME_SHAPE: f64 = 0.002;
    if (found.width, found.height) == (width, height) {
        return Ok(found);
    }
    let scale = width as f64 / found.width as f64;
    let other = height as f64 / found.height as f64;
    if !((scale / other - 1.0).abs() < SAME_SHAPE) {
        let (from, to) = ([found.width, found.height], [width, height]);
        return Err(LensError::OtherShape { from, to });
    }
    let (old_width, old_height) = (found.width, found.height);
    let lens = found.lens.cropped(0.0, 0.0, scale);
    let mut scaled = FoundLens { lens, width, height, ..found };
    scaled.fill_report();
    scaled.warnings.push(Warning::new(
        "camera",
        format!(
            "the lens was measured at {old_width}×{old_height} px and scaled to {width}×{height}"
        ),
        "right if the whole frame was scaled; a crop of the same shape would be wrong altogether",
    ));
    Ok(scaled)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(width: usize, height: usize) -> FoundLens {
        plain(Lens::pinhole(900.0, width, height), width, height, "test")
    }

    #[test]
    fn a_lens_follows_a_scaled_plate_and_refuses_a_cropped_one() {
        // F7.
        let half = fit_to(found(960, 640), 480, 320).unwrap();
        assert_eq!(half.report.focal_px, [450.0, 450.0]);
        assert!((half.lens.cx - 239.5).abs() < 1e-12);
        assert_eq!(half.warnings.len(), 1);
        assert!(matches!(fit_to(found(960, 640), 960, 540), Err(LensError::OtherShape { .. })));
        assert!(fit_to(found(960, 640), 960, 640).unwrap().warnings.is_empty());
    }

    #[test]
    fn portrait_pictures_have_the_sensor_upright() {
        // F8: the sensor's longer side lies along the picture's.
        let wide = nominal(35.0, 36.0, 960, 640, "EXIF").unwrap();
        let tall = nominal(35.0, 36.0, 640, 960, "EXIF").unwrap();
        assert_eq!(wide.lens.fx, tall.lens.fx);
        assert!((wide.report.sigma_focal_px.unwrap() / wide.lens.fx - 0.02).abs() < 1e-12);
        assert!(nominal(0.0, 36.0, 640, 960, "EXIF").is_none());
    }

    #[test]
    fn the_commonest_size_wins() {
        let sizes = [[1281, 721], [1280, 720], [1280, 720]];
        assert_eq!(commonest(sizes.into_iter()), [1280, 720]);
        assert_eq!(commonest(std::iter::empty()), [0, 0]);
    }

    #[test]
    fn another_focal_length_than_the_boards_is_told() {
        let at = |focal_mm| Facts { focal_mm, ..Facts::default() };
        assert!(other_setting(&at(Some(35.0)), &at(Some(36.0))).is_some());
        assert!(other_setting(&at(Some(35.0)), &at(Some(35.0))).is_none());
        assert!(other_setting(&at(None), &at(Some(35.0))).is_none());
    }
}
