//! Photographs of a mirror ball → one picture of light in which it is found.
//!
//! A bracket is aligned by its content. Where that cannot be (cut-outs of several sizes) or puts the ball of a
//! photograph elsewhere than it is (the camera moved, and the background with it), the photographs are laid
//! on one another by the ball.

use glam::DVec2;

use super::args::Wishes;
use super::photographed::{Merged, camera, merge as merge_photographs};
use crate::bracket::{Radiance, Validity, Warp, disagreement_px, exposure};
use crate::camera::Camera;
use crate::cli::CliError;
use crate::conventions::Rgb;
use crate::photo::{self, Encoded, Image, Photo};
use crate::probe::ball_frames::{LaidByBall, lay_by_ball};
use crate::probe::find::{BallImage, Hints, find};

/// Beyond this many σ of two rims a ball is not where the alignment by content puts it.
const ELSEWHERE_SIGMA: f64 = 4.0;
/// From here on a clean plate is told to be of another pose, px.
const PLATE_OFF_PX: f64 = 2.0;

/// What the photographs show of the ball.
pub(super) struct BallLight {
    pub(super) radiance: Radiance,
    /// What a value of 1 means.
    pub(super) unit: String,
    /// Of the picture that `radiance` is.
    pub(super) camera: Camera,
    pub(super) found: BallImage,
}

/// Merges the photographs so that the ball lies alike in all of them, and finds it.
pub(super) fn merge(
    wishes: &Wishes,
    photos: Vec<Encoded>,
    warnings: &mut Vec<String>,
) -> Result<BallLight, CliError> {
    let size = |photo: &Encoded| (photo.width, photo.height);
    let one_size = photos.iter().all(|photo| size(photo) == size(&photos[0]));
    if !one_size && wishes.args.camera.is_none() {
        return cut_outs(wishes, &photos, warnings);
    }
    let mut said = Vec::new();
    let by_content = merge_photographs(wishes, &photos, &mut said)?;
    let camera = camera(wishes, &photos[0], photos[0].width, photos[0].height)?;
    let plate = clean_plate(wishes, &photos, &by_content.exposures, warnings)?;
    let hints = Hints { circle_px: wishes.hint, clean_plate: plate.as_ref() };
    let found = find_in(&photos[0], &by_content.radiance.mean, &camera, &hints)?;
    let elsewhere = elsewhere(&photos, &by_content.warps, &camera, &found);
    let Merged { radiance, unit, .. } = by_content;
    let by_content = BallLight { radiance, unit, camera, found };
    let Some(elsewhere) = elsewhere else {
        warnings.extend(said);
        return Ok(by_content);
    };
    let mut said_by_ball = Vec::new();
    let laid = laid(&photos, &elsewhere.balls)?;
    let by_ball = merge_laid(wishes, &photos, &laid, &mut said_by_ball).ok();
    // Frames that lie rightly contradict one another less.
    let better = by_ball.filter(|by_ball| by_ball.contradictory() < by_content.contradictory());
    let told = format!(
        "{}: the ball lies {:.1} px off where the rest of the picture puts it (the camera moved)",
        photos[elsewhere.photo].path.display(),
        elsewhere.off_px
    );
    match better {
        Some(by_ball) => {
            warnings.extend(said_by_ball);
            warnings.push(format!("{told}; the photographs are laid on one another by the ball"));
            Ok(by_ball)
        }
        None => {
            warnings.extend(said);
            warnings.push(format!(
                "{told}; laying the photographs on one another by the ball fits no better: directions from this one \
                 are off by {:.1}°",
                (2.0 * elsewhere.off_px / by_content.found.radius_px).to_degrees()
            ));
            Ok(by_content)
        }
    }
}

impl BallLight {
    /// Share of the ball where one photograph contradicts the others.
    fn contradictory(&self) -> f64 {
        let (middle, radius) = (self.found.centre_px, self.found.radius_px);
        let validity = &self.radiance.validity;
        let (mut all, mut moved) = (0, 0);
        for y in 0..validity.height() {
            for x in 0..validity.width() {
                if DVec2::new(x as f64, y as f64).distance(middle) < radius {
                    all += 1;
                    moved += usize::from(validity[(x, y)] == Validity::Moved);
                }
            }
        }
        f64::from(moved as u32) / f64::from(all.max(1))
    }
}

/// A ball that is not where the alignment by content puts it.
struct Elsewhere {
    photo: usize,
    off_px: f64,
    /// The ball in every photograph.
    balls: Vec<BallImage>,
}

/// Looks for the ball in each photograph where `warps` put it, and tells which is farthest off, if any is.
fn elsewhere(
    photos: &[Encoded],
    warps: &[Warp],
    camera: &Camera,
    merged: &BallImage,
) -> Option<Elsewhere> {
    if photos.len() < 2 {
        return None;
    }
    let mut farthest = (0, 0.0);
    let mut balls = Vec::new();
    for (k, (photo, warp)) in photos.iter().zip(warps).enumerate() {
        let put = warp.apply(merged.centre_px);
        let hints = Hints { circle_px: Some([put.x, put.y, merged.radius_px]), clean_plate: None };
        let linear = Photo::from(photo.clone()).linear;
        let own = find(&linear, &camera.lens, &hints);
        match own.ok().filter(|ball| ball.score.is_some() && !ball.is_weak()) {
            Some(own) => {
                let off = own.centre_px.distance(put);
                if off > ELSEWHERE_SIGMA * own.sigma_px.hypot(merged.sigma_px) && off > farthest.1 {
                    farthest = (k, off);
                }
                balls.push(own);
            }
            // Too dark or too bright to be seen by itself.
            None => balls.push(BallImage { centre_px: put, ..merged.clone() }),
        }
    }
    let (photo, off_px) = farthest;
    (off_px > 0.0).then_some(Elsewhere { photo, off_px, balls })
}

/// Photographs that share no frame.
fn cut_outs(
    wishes: &Wishes,
    photos: &[Encoded],
    warnings: &mut Vec<String>,
) -> Result<BallLight, CliError> {
    if let Some(path) = &wishes.args.clean_plate {
        return Err(CliError::wrong(format!(
            "--clean-plate: {} cannot have the size of photographs of several sizes; leave it out",
            path.display()
        )));
    }
    let mut balls = Vec::new();
    for photo in photos {
        let camera = camera(wishes, photo, photo.width, photo.height)?;
        let hints = Hints { circle_px: wishes.hint, clean_plate: None };
        let linear = Photo::from(photo.clone()).linear;
        balls.push(find_in(photo, &linear, &camera, &hints).map_err(|cause| {
            CliError::wrong(format!(
                "the photographs differ in size, and must be laid on one another by their balls: {}",
                cause.sentence()
            ))
        })?);
    }
    let laid = laid(photos, &balls)?;
    warnings.push(format!(
        "the photographs differ in size; they are laid on one another by the ball, whose radius is {} px",
        listed(&balls)
    ));
    merge_laid(wishes, photos, &laid, warnings)
}

/// Radii, from the least to the greatest.
fn listed(balls: &[BallImage]) -> String {
    let radii = balls.iter().map(|ball| ball.radius_px);
    let (least, most) = radii.fold((f64::MAX, 0.0), |(a, b), r| (r.min(a), r.max(b)));
    format!("{least:.1} to {most:.1}")
}

fn laid(photos: &[Encoded], balls: &[BallImage]) -> Result<LaidByBall, CliError> {
    lay_by_ball(photos, balls)
        .ok_or_else(|| CliError::wrong("no photographs to lay by their balls"))
}

/// Merges cut-outs, and finds the ball in what comes out.
fn merge_laid(
    wishes: &Wishes,
    photos: &[Encoded],
    laid: &LaidByBall,
    warnings: &mut Vec<String>,
) -> Result<BallLight, CliError> {
    let Merged { radiance, unit, .. } = merge_photographs(wishes, &laid.photos, warnings)?;
    let reference = &photos[laid.reference];
    let first = DVec2::new(laid.first.0 as f64, laid.first.1 as f64);
    let (w, h) = (radiance.mean.width(), radiance.mean.height());
    let camera = camera(wishes, reference, reference.width, reference.height)?;
    let camera = camera.cropped(first.x, first.y, 1.0, w, h);
    let circle_px = wishes.hint.map(|[u, v, r]| [u - first.x, v - first.y, r]);
    let hints = Hints { circle_px, clean_plate: None };
    let found = find_in(reference, &radiance.mean, &camera, &hints)?;
    Ok(BallLight { radiance, unit, camera, found })
}

fn find_in(
    photo: &Encoded,
    picture: &Image<Rgb>,
    camera: &Camera,
    hints: &Hints,
) -> Result<BallImage, CliError> {
    find(picture, &camera.lens, hints)
        .map_err(|cause| CliError::wrong(format!("{}: {cause}", photo.path.display())))
}

/// The clean plate, and a word about how far off the photographs it lies.
fn clean_plate(
    wishes: &Wishes,
    photos: &[Encoded],
    exposures: &[f64],
    warnings: &mut Vec<String>,
) -> Result<Option<Image<Rgb>>, CliError> {
    let Some(path) = &wishes.args.clean_plate else { return Ok(None) };
    let plate = photo::read_encoded(path, &wishes.read)?;
    let plate_exposure = exposure::exposure(&plate.facts);
    // Of the photographs the one exposed most alike shows most in common.
    let like = |exposure: f64| plate_exposure.map_or(0.0, |plate| (exposure / plate).ln().abs());
    let nearest = photos.iter().zip(exposures).min_by(|a, b| like(*a.1).total_cmp(&like(*b.1)));
    if let Some((photo, &exposure)) = nearest
        && let Some((shift, reach)) =
            disagreement_px((photo, exposure), (&plate, plate_exposure.unwrap_or(exposure)))
        && reach > PLATE_OFF_PX
    {
        warnings.push(format!(
            "{}: lies ({:.1}, {:.1}) px off {}, up to {reach:.1} px: it is from another pose, and says little of where \
             the ball is; light and geometry of the plate are off by as much",
            path.display(),
            shift.x,
            shift.y,
            photo.path.display()
        ));
    }
    Ok(Some(Photo::from(plate).linear))
}
