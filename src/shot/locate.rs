//! `[pose]`: a tag, a board, a marked rectangle or a file → where the camera stood, with its errors.

use std::path::PathBuf;

use glam::DVec3;

use super::camera_keys::{Board, Placing, PoseSource, TagPose};
use super::detect::{self, DetectError};
use crate::camera::planar_pose::{
    self, Noise, PlanarPose, PoseError, PoseScatter, Sighting, Verdict,
};
use crate::camera::{Camera, Lens, Pose, file, print, slip};
use crate::photo::{self, Photo, PhotoError, ReadOptions};
use crate::report::{PoseReport, Warning};

/// Where a camera stood, and everything the report says about it.
#[derive(Clone, Debug)]
pub struct FoundPose {
    pub pose: Pose,
    /// How the pose scatters, lens and own part apart; `None` for a pose read from a file.
    pub scatter: Option<PoseScatter>,
    /// `slip_px` is left empty: see [`FoundPose::slip_px`].
    pub report: PoseReport,
    pub warnings: Vec<Warning>,
    /// What was seen of every target; none for a pose read from a file.
    pub seen: Vec<Seen>,
}

/// The points of one target.
#[derive(Clone, Debug)]
pub struct Seen {
    /// `None`: clicked in the plate.
    pub photo: Option<PathBuf>,
    pub sightings: Vec<Sighting>,
}

/// Why there is no pose.
#[derive(Debug, thiserror::Error)]
pub enum LocateError {
    #[error(transparent)]
    Photo(#[from] PhotoError),
    /// `key` is the print's place below `[pose]`.
    #[error("{}: {cause}", photo.display())]
    Detect { key: String, photo: PathBuf, cause: DetectError },
    #[error("{target}: {cause}")]
    Pose { target: String, cause: PoseError },
    #[error(
        "{}: {}×{} px, but the camera it is to locate has {}×{}; use a photograph of the same setting",
        photo.display(), found[0], found[1], expected[0], expected[1]
    )]
    OtherSize { photo: PathBuf, found: [usize; 2], expected: [usize; 2] },
    #[error("{target}: facing and up are parallel or zero; up lies in the print's plane")]
    Placing { target: String },
    #[error(
        "{target}: the four corners in the picture lie on one line, cross or turn inward; mark upper left, \
         upper right, lower right and lower left as seen from the front"
    )]
    Corners { target: String },
    #[error("pose.board: describe the board (kind, corners, square_mm): [camera] has none")]
    NoBoard,
    #[error(
        "{target}: two poses fit equally ({detail}); photograph it tilted by 20° or more, \
         or use a larger target or several tags"
    )]
    Ambiguous { target: String, detail: String },
    #[error(transparent)]
    File(#[from] file::CameraFileError),
    #[error("{}: the file has a lens but no pose", path.display())]
    NoPose { path: PathBuf },
}

impl LocateError {
    /// The key below `[pose]` whose value is to be looked at; empty where it is any of them.
    pub fn key(&self) -> &str {
        match self {
            Self::Detect { key, .. } => key,
            _ => "",
        }
    }
}

/// Whether four corners go round once, as those of any rectangle in front of a camera do.
fn is_convex(corners_px: &[[f64; 2]; 4]) -> bool {
    /// Smallest triangle of three corners, twice its area, px².
    const LEAST: f64 = 1.0;
    let corner = |i: usize| glam::DVec2::from(corners_px[i % 4]);
    let turn = |i: usize| (corner(i + 1) - corner(i)).perp_dot(corner(i + 2) - corner(i + 1));
    let turns = [0, 1, 2, 3].map(turn);
    let goes = |sign: f64| turns.iter().all(|turn| sign * turn >= LEAST && turn.is_finite());
    goes(1.0) || goes(-1.0)
}

/// Smallest σ of a board corner that is believed, px, and what it is worth in residuals.
const BOARD_SIGMA_PX: f64 = 0.03;
const BOARD_DEGREES: f64 = 4.0;
/// What the edge lines' σ of a tag corner is worth in residuals.
const TAG_DEGREES: f64 = 8.0;
/// How exactly people click the corners of a rectangle, px.
const CLICK_SIGMA_PX: f64 = 0.5;
/// How exactly the stated size of a target is that of the print, relative: half a millimetre on a rule
/// over the 0.2 m of a sheet. A camera's distance is wrong by as much. (Prints nobody measured are off by
/// up to 1 %, for the scale to fit the page.)
pub const PRINT_SIGMA: f64 = 0.0025;

/// The pose that a shot names, for a camera with this lens and picture size.
///
/// `board` is the board of `[camera]`, for a `[pose] board` that does not describe its own.
pub fn find_pose(
    source: &PoseSource,
    lens: &Lens,
    size: [usize; 2],
    board: Option<&Board>,
) -> Result<FoundPose, LocateError> {
    match source {
        PoseSource::Tags(tags) => from_tags(tags, lens, size),
        PoseSource::Board(own) => {
            let board = own.board.as_ref().or(board).ok_or(LocateError::NoBoard)?;
            let photo = read(&own.photo, size)?;
            from_board(&photo, board, &own.placing, lens)
        }
        PoseSource::Rectangle(own) => {
            let target = "pose.rectangle".to_owned();
            if !is_convex(&own.corners_px) {
                return Err(LocateError::Corners { target });
            }
            let place = &own.placing;
            let corners = print::rectangle_corners(
                place.at.into(),
                place.facing.into(),
                place.up.into(),
                own.size[0],
                own.size[1],
            )
            .ok_or(LocateError::Placing { target: target.clone() })?;
            let sightings = corners
                .iter()
                .zip(&own.corners_px)
                .map(|(&world, &pixel)| Sighting { world, pixel: pixel.into() })
                .collect();
            let noise =
                Noise { sigma_px: CLICK_SIGMA_PX, degrees: TAG_DEGREES, size_sigma: PRINT_SIGMA };
            solve(&[sightings], lens, &noise, target, "four corners of a rectangle".into())
        }
        PoseSource::File(path) => {
            let read = file::read(path)?;
            if !read.has_pose {
                return Err(LocateError::NoPose { path: path.clone() });
            }
            let report = PoseReport { source: path.display().to_string(), ..PoseReport::default() };
            let mut found = FoundPose {
                pose: read.camera.pose,
                scatter: None,
                report,
                warnings: vec![],
                seen: vec![],
            };
            found.fill_report();
            Ok(found)
        }
    }
}

fn read(path: &std::path::Path, [width, height]: [usize; 2]) -> Result<Photo, LocateError> {
    let photo = photo::read(path, &ReadOptions::default())?;
    let found = [photo.linear.width(), photo.linear.height()];
    if found != [width, height] {
        let expected = [width, height];
        return Err(LocateError::OtherSize { photo: path.to_owned(), found, expected });
    }
    Ok(photo)
}

/// Pose from one or more tags, each in a photograph from the same place.
pub fn from_tags(
    tags: &[TagPose],
    lens: &Lens,
    size: [usize; 2],
) -> Result<FoundPose, LocateError> {
    let mut targets = vec![];
    let mut warnings = vec![];
    let mut sigma_px = 0.0f64;
    for (i, tag) in tags.iter().enumerate() {
        let photo = read(&tag.photo, size)?;
        let key = if tags.len() == 1 { "tag".to_owned() } else { format!("tags[{i}]") };
        let (sightings, sigma, said) = sight_tag(&photo, tag, &key, lens)?;
        targets.push(sightings);
        sigma_px = sigma_px.max(sigma);
        warnings.extend(said);
    }
    let source = match tags {
        [one] => format!("tag {} ({})", one.id, one.family),
        _ => format!("{} tags", tags.len()),
    };
    let noise = Noise { sigma_px, degrees: TAG_DEGREES, size_sigma: PRINT_SIGMA };
    let target = tags.first().map_or("pose.tags".into(), |t| t.photo.display().to_string());
    let mut found = solve(&targets, lens, &noise, target, source)?;
    found.warnings.extend(warnings);
    for (seen, tag) in found.seen.iter_mut().zip(tags) {
        seen.photo = Some(tag.photo.clone());
    }
    Ok(found)
}

/// Corners of a tag where the world has them, their σ, and what to say about them.
fn sight_tag(
    photo: &Photo,
    tag: &TagPose,
    key: &str,
    lens: &Lens,
) -> Result<(Vec<Sighting>, f64, Option<Warning>), LocateError> {
    const CLIPPED: f64 = 0.3;
    const ALL_CLIPPED: f64 = 0.9;
    let name = photo.path.display();
    let seen = detect::tag(photo, &tag.family, tag.id, Some(lens)).map_err(|cause| {
        let key = match cause {
            DetectError::OtherTags { .. } => format!("{key}.id"),
            DetectError::NoOpenCv | DetectError::NotFound(_) => key.to_owned(),
        };
        LocateError::Detect { key, photo: photo.path.clone(), cause }
    })?;
    let side = tag.size_mm * 1e-3;
    let place = &tag.placing;
    let (at, facing, up) = (place.at.into(), place.facing.into(), place.up.into());
    let corners = print::rectangle_corners(at, facing, up, side, side)
        .ok_or_else(|| LocateError::Placing { target: name.to_string() })?;
    let sightings =
        corners.iter().zip(seen.corners).map(|(&world, pixel)| Sighting { world, pixel }).collect();
    if seen.clipped_white > CLIPPED {
        // F40: black grows by the light that spills over a clipped edge. Where part of the white is not
        // clipped the edge fit knows how bright it is; where nothing is left it guesses.
        let sigma_px = if seen.clipped_white > ALL_CLIPPED { 0.5 } else { 0.1 };
        let said = Warning::new(
            format!("pose.{key}"),
            format!("{name}: the white round the tag is clipped; use a shorter exposure"),
            format!("corners known to {sigma_px} px"),
        );
        return Ok((sightings, seen.sigma_px.max(sigma_px), Some(said)));
    }
    let said = (!seen.by_edges).then(|| {
        Warning::new(
            format!("pose.{key}"),
            format!(
                "{name}: tag {} is too small or too blurred to fit its edges; go nearer",
                tag.id
            ),
            format!("corners known to {:.2} px only", seen.sigma_px),
        )
    });
    Ok((sightings, seen.sigma_px, said))
}

/// Pose from a board in a photograph.
pub fn from_board(
    photo: &Photo,
    board: &Board,
    place: &Placing,
    lens: &Lens,
) -> Result<FoundPose, LocateError> {
    let name = photo.path.display().to_string();
    let seen = detect::board(photo, board).map_err(|cause| {
        let key = "board".to_owned();
        LocateError::Detect { key, photo: photo.path.clone(), cause }
    })?;
    let (right, up) = print::target_axes(place.facing.into(), place.up.into())
        .ok_or_else(|| LocateError::Placing { target: name.clone() })?;
    let at = DVec3::from(place.at);
    let sightings = seen
        .points
        .iter()
        .map(|&(on_print, pixel)| Sighting {
            world: at + right * on_print.x - up * on_print.y,
            pixel,
        })
        .collect();
    let noise = Noise { sigma_px: BOARD_SIGMA_PX, degrees: BOARD_DEGREES, size_sigma: PRINT_SIGMA };
    let mut found = solve(&[sightings], lens, &noise, name.clone(), "a board".into())?;
    found.seen.iter_mut().for_each(|seen| seen.photo = Some(photo.path.clone()));
    if seen.turned_unknown {
        found.warnings.push(Warning::new(
            "pose.board",
            format!(
                "{name}: this board looks the same upside down; its upper left corner was taken to be the \
                 one nearest the picture's; a board with one odd and one even count cannot be mistaken"
            ),
            "the camera may stand on the opposite side",
        ));
    }
    Ok(found)
}

fn solve(
    targets: &[Vec<Sighting>],
    lens: &Lens,
    noise: &Noise,
    target: String,
    source: String,
) -> Result<FoundPose, LocateError> {
    let solved = planar_pose::solve_joint(lens, targets, noise)
        .map_err(|cause| LocateError::Pose { target: target.clone(), cause })?;
    let ambiguity = ambiguity(&solved);
    if solved.verdict == Verdict::Ambiguous {
        let detail = ambiguity.unwrap_or_else(|| "the target is seen face-on".into());
        return Err(LocateError::Ambiguous { target, detail });
    }
    let mut warnings = vec![];
    if solved.verdict == Verdict::Probable {
        warnings.push(Warning::new(
            "pose",
            format!("{target}: a second pose fits nearly as well; tilt the target more"),
            "wrong about once in a thousand",
        ));
    }
    // Far more than the detector's σ: a wrong size, a bent print, a changed lens.
    if solved.sigma_px > 5.0 * noise.sigma_px.max(0.1) {
        warnings.push(Warning::new(
            "pose",
            format!(
                "{target}: corners miss by {:.2} px rms; check the target's size and flatness, and that \
                 focus and zoom are those of the calibration",
                solved.rms_px
            ),
            "contained in the stated σ",
        ));
    }
    let report =
        PoseReport { source, rms_px: Some(solved.rms_px), ambiguity, ..PoseReport::default() };
    let scatter = Some(solved.scatter);
    let seen = targets.iter().map(|sightings| Seen { photo: None, sightings: sightings.clone() });
    let mut found =
        FoundPose { pose: solved.pose, scatter, report, warnings, seen: seen.collect() };
    found.fill_report();
    Ok(found)
}

fn ambiguity(solved: &PlanarPose) -> Option<String> {
    let other = solved.alternative.as_ref()?;
    let [x, y, z] = other.pose.position().to_array();
    Some(format!(
        "a second pose at {x:.3}, {y:.3}, {z:.3} m fits to {:.2} px instead of {:.2} (Δχ² {:.1})",
        other.rms_px, solved.rms_px, other.delta_chi2
    ))
}

impl FoundPose {
    fn fill_report(&mut self) {
        self.report.position_m = self.pose.position().to_array();
        let sigmas = self.pose.sigmas();
        self.report.sigma_position_m = sigmas.map(|(_, position)| position.to_array());
        self.report.sigma_rotation_deg =
            sigmas.map(|(turn, _)| turn.to_array().map(f64::to_degrees));
    }

    /// Predicted slip (px) of an object with its foot at `foot` on a support with this normal.
    ///
    /// `camera` is the one whose pose this is, cropped or not.
    pub fn slip_px(
        &self,
        camera: &Camera,
        foot: DVec3,
        normal: DVec3,
        radius_m: f64,
    ) -> Option<f64> {
        slip::predicted_px(camera, self.scatter.as_ref()?, foot, normal, radius_m)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shot::camera_keys::{BoardPose, RectanglePose};

    const PLACING: Placing =
        Placing { at: [0.1, 0.0, -0.2], facing: [0.0, 1.0, 0.0], up: [0.0, 0.0, -1.0] };

    fn camera(eye: DVec3) -> Camera {
        Camera {
            width: 960,
            height: 640,
            lens: Lens::pinhole(940.0, 960, 640),
            pose: Pose::look_at(eye, PLACING.at.into(), -DVec3::Z).unwrap(),
        }
    }

    #[test]
    fn corners_that_no_rectangle_shows_are_refused() {
        for (corners, good) in [
            ([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]], true),
            ([[0.0, 0.0], [10.0, 0.0], [20.0, 0.0], [30.0, 0.0]], false),
            ([[0.0, 0.0], [10.0, 10.0], [10.0, 0.0], [0.0, 10.0]], false),
            ([[0.0, 0.0], [10.0, 0.0], [2.0, 2.0], [0.0, 10.0]], false),
            ([[1e300, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]], false),
            ([[5.0, 5.0]; 4], false),
        ] {
            assert_eq!(is_convex(&corners), good, "{corners:?}");
        }
    }

    fn rectangle(camera: &Camera, size: [f64; 2]) -> PoseSource {
        let p = PLACING;
        let corners =
            print::rectangle_corners(p.at.into(), p.facing.into(), p.up.into(), size[0], size[1])
                .unwrap();
        let corners_px = corners.map(|c| camera.project_world(c).unwrap().to_array());
        PoseSource::Rectangle(RectanglePose { corners_px, size, placing: p })
    }

    #[test]
    fn four_corners_of_a_rectangle_place_the_camera() {
        let truth = camera(DVec3::new(0.4, 1.2, 1.5));
        let source = rectangle(&truth, [0.45, 0.3]);
        let found = find_pose(&source, &truth.lens, [960, 640], None).unwrap();
        let (turn, shift) = truth.pose.difference(&found.pose);
        assert!(turn.length() < 1e-8 && shift.length() < 1e-8, "{turn} {shift}");
        assert!(found.report.ambiguity.is_some() && found.warnings.is_empty());
        let slip = found.slip_px(&truth, DVec3::ZERO, DVec3::Y, 0.1).unwrap();
        // Corners clicked to half a pixel cannot pin the ground to better than a quarter.
        assert!((0.2..3.0).contains(&slip), "{slip}");
    }

    #[test]
    fn the_print_s_size_is_part_of_the_stated_error() {
        let truth = camera(DVec3::new(0.4, 1.2, 1.5));
        let source = rectangle(&truth, [0.45, 0.3]);
        let found = find_pose(&source, &truth.lens, [960, 640], None).unwrap();
        let sigma = DVec3::from(found.report.sigma_position_m.unwrap()).length();
        let distance = truth.pose.position().distance(PLACING.at.into());
        assert!(sigma > PRINT_SIGMA * distance, "{sigma} m at {distance} m");
        // The same rectangle said to be 1 % larger puts the camera 1 % farther off: 4 of these σ.
        let PoseSource::Rectangle(mut larger) = source else { panic!("a rectangle") };
        larger.size = larger.size.map(|side| 1.01 * side);
        let moved =
            find_pose(&PoseSource::Rectangle(larger), &truth.lens, [960, 640], None).unwrap();
        let off = moved.pose.position().distance(truth.pose.position());
        assert!((off / distance - 0.01).abs() < 1e-4, "{off} m at {distance} m");
        assert!(off < 4.1 * sigma, "{off} m with σ {sigma} m");
    }

    #[test]
    fn a_small_rectangle_seen_face_on_is_ambiguous() {
        let above = camera(DVec3::new(0.1, 3.0, -0.19));
        let source = rectangle(&above, [0.2, 0.2]);
        let error = find_pose(&source, &above.lens, [960, 640], None).unwrap_err();
        assert!(error.to_string().contains("two poses fit equally"), "{error}");
    }

    #[cfg(feature = "opencv")]
    #[test]
    fn another_tag_than_the_one_seen_is_told_with_the_key_of_its_number() {
        let demo = concat!(env!("CARGO_MANIFEST_DIR"), "/plates/demo/tag.jpg");
        let tag = |id| TagPose {
            photo: PathBuf::from(demo),
            family: "36h11".to_owned(),
            id,
            size_mm: 160.0,
            placing: PLACING,
        };
        let lens = Lens::pinhole(1180.0, 1080, 720);
        let locate = |tags| find_pose(&PoseSource::Tags(tags), &lens, [1080, 720], None);
        assert!(locate(vec![tag(5)]).is_ok());
        let error = locate(vec![tag(6)]).unwrap_err();
        assert!(error.to_string().contains("tag 6 is not seen, but 5"), "{error}");
        assert_eq!(error.key(), "tag.id");
        assert_eq!(locate(vec![tag(5), tag(6)]).unwrap_err().key(), "tags[1].id");
    }

    #[test]
    fn what_is_missing_is_named() {
        let lens = Lens::pinhole(940.0, 960, 640);
        let photo = PathBuf::from("/nowhere/tag.jpg");
        let board = PoseSource::Board(BoardPose { photo, board: None, placing: PLACING });
        let error = find_pose(&board, &lens, [960, 640], None).unwrap_err();
        assert!(error.to_string().contains("describe the board"), "{error}");
        let file = PoseSource::File(PathBuf::from("/nowhere/camera.json"));
        let error = find_pose(&file, &lens, [960, 640], None).unwrap_err();
        assert!(error.to_string().contains("/nowhere/camera.json"), "{error}");
        let parallel = Placing { up: PLACING.facing, ..PLACING };
        let corners_px = [[0.0, 0.0], [9.0, 0.0], [9.0, 9.0], [0.0, 9.0]];
        let bad = RectanglePose { corners_px, size: [1.0, 1.0], placing: parallel };
        let error = find_pose(&PoseSource::Rectangle(bad), &lens, [960, 640], None).unwrap_err();
        assert!(error.to_string().contains("parallel"), "{error}");
    }
}
