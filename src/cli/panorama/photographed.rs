//! Photographs of a ball or through a fisheye → panorama: merge, find, unwrap.

use super::args::{FisheyeKind, Wishes};
use crate::bracket::{self, Frame, MergeOptions, Radiance, exposure};
use crate::camera::lens::focal_px_from_35mm;
use crate::camera::{self, Camera, Lens, Pose};
use crate::cli::{CliError, Global};
use crate::conventions::Rgb;
use crate::photo::{self, Format, Image, Photo};
use crate::probe::find::{BallImage, Hints, find};
use crate::probe::fisheye::{Fisheye, Projection};
use crate::probe::overlay::overlay;
use crate::probe::{Ball, Doubt, Panorama, photographed};

/// A ball or fisheye unwrapped.
pub(super) struct Photographed {
    pub(super) panorama: Panorama,
    pub(super) ball: Option<BallImage>,
    /// The photograph with the rim, if it is wanted.
    pub(super) overlay: Option<Image<Rgb>>,
}

/// Ball or fisheye: merge, find, unwrap.
pub(super) fn photographed(
    wishes: &Wishes,
    warnings: &mut Vec<String>,
    global: &Global,
) -> Result<Photographed, CliError> {
    let args = wishes.args;
    let photos: Vec<Photo> =
        args.photos.iter().map(|path| photo::read(path, &wishes.read)).collect::<Result<_, _>>()?;
    warnings.extend(photos.iter().flat_map(Photo::named_remarks));
    global.go_on()?;
    let radiance = radiance(wishes, &photos, warnings)?;
    global.go_on()?;
    let (w, h) = (radiance.mean.width(), radiance.mean.height());
    if let Some(kind) = args.kind.fisheye {
        let lens = fisheye(wishes, kind, w, h)?;
        let panorama = photographed::fisheye(&radiance, &lens, wishes.rotation, args.width)?;
        return Ok(Photographed { panorama, ball: None, overlay: None });
    }
    let camera = ball_camera(wishes, &photos[0], w, h)?;
    let plate = match &args.clean_plate {
        Some(path) => Some(photo::read(path, &wishes.read)?.linear),
        None => None,
    };
    let hints = Hints { circle_px: wishes.hint, clean_plate: plate.as_ref() };
    let found = find(&radiance.mean, &camera.lens, &hints)?;
    let reflectance = wishes.reflectance.unwrap_or(Rgb::ONE);
    let ball = Ball::new(found.centre_of(args.radius, &camera), args.radius, reflectance)?;
    let panorama = photographed::ball(&radiance, &camera, &found, &ball, None, args.width)?;
    warnings.extend(Doubt::about(&found).into_iter().map(|doubt| doubt.sentence("--hint")));
    let wants_overlay = args.overlay.is_some();
    let drawn = wants_overlay.then(|| overlay(&radiance.mean, &camera.lens, &found, 800));
    if wishes.reflectance.is_none() {
        warnings.push(
            "--reflectance is not given: the ball is taken as perfect, and the light comes out \
             too dark by its reflectance (chrome 0.55, good steel 0.6)"
                .into(),
        );
    }
    let panorama = panorama.rotated(wishes.rotation);
    Ok(Photographed { panorama, ball: Some(found), overlay: drawn })
}

/// The photographs as radiance: an EXR or HDR as it is, a bracket or a single photograph merged.
fn radiance(
    wishes: &Wishes,
    photos: &[Photo],
    warnings: &mut Vec<String>,
) -> Result<Radiance, CliError> {
    if let [only] = photos
        && matches!(only.format, Format::Exr | Format::RadianceHdr)
    {
        if wishes.times_s.is_some() {
            return Err(CliError::wrong(format!(
                "--times: {} is one picture of radiance, taken as it is; leave --times out",
                only.path.display()
            )));
        }
        return Ok(bracket::file::from_picture(only)?);
    }
    let exposures = match &wishes.times_s {
        Some(times) => exposure::from_times(photos, times)?,
        // One photograph needs no exposure to have a scale.
        None if photos.len() == 1 => vec![exposure::exposure(&photos[0].facts).unwrap_or(1.0)],
        None => exposure::from_exif(photos)?,
    };
    let frames: Vec<Frame> =
        photos.iter().zip(&exposures).map(|(photo, &exposure)| Frame { photo, exposure }).collect();
    let merged = bracket::merge(&frames, &MergeOptions::default())?;
    let asking = merged.warnings.iter().filter(|warning| warning.asks());
    warnings.extend(asking.map(ToString::to_string));
    Ok(merged.radiance)
}

fn fisheye(wishes: &Wishes, kind: FisheyeKind, w: usize, h: usize) -> Result<Fisheye, CliError> {
    let fov = wishes.args.fov;
    let projection = match kind {
        FisheyeKind::Equidistant => Projection::Equidistant,
        FisheyeKind::Equisolid => Projection::Equisolid,
        FisheyeKind::Stereographic => Projection::Stereographic,
        FisheyeKind::Orthographic => Projection::Orthographic,
    };
    Ok(Fisheye::new(projection, fov, wishes.circle, [w, h])?)
}

/// The camera of the ball's photographs: a file, a focal length, or EXIF.
fn ball_camera(wishes: &Wishes, photo: &Photo, w: usize, h: usize) -> Result<Camera, CliError> {
    let args = wishes.args;
    if let Some(path) = &args.camera {
        let camera = camera::file::read(path)?.camera;
        if let Some([x, y, scale]) = wishes.crop {
            if !camera.holds_cut_out(x, y, scale, w, h) {
                let [wide, high] = [camera.width, camera.height].map(|size| size as f64 * scale);
                let frame = path.display();
                return Err(CliError::wrong(format!(
                    "--crop {x},{y},{scale}: {w} × {h} px from {x}, {y} on do not lie in the frame of {frame}, \
                     {} × {} px, which is {wide:.0} × {high:.0} px at scale {scale}; X,Y is the cut-out's first \
                     pixel in the frame at that scale",
                    camera.width, camera.height
                )));
            }
            return Ok(camera.cropped(x, y, scale, w, h));
        }
        if (camera.width, camera.height) != (w, h) {
            let (cw, ch, path) = (camera.width, camera.height, path.display());
            return Err(CliError::wrong(format!(
                "{path}: the camera is of {cw} × {ch} px, the photographs of {w} × {h} px; calibrate \
                 with photographs of the same size, or say which part of the frame these are (--crop)"
            )));
        }
        return Ok(camera);
    }
    let exif = || focal_px_from_35mm(photo.facts.focal_35mm?, w, h);
    if let Some(given) = args.focal_px.filter(|f| !(f.is_finite() && *f > 0.0)) {
        return Err(CliError::wrong(format!(
            "--focal-px: {given} is not above 0; give focal length in mm / sensor width in mm × \
             picture width in px"
        )));
    }
    let focal = args.focal_px.or_else(exif).filter(|f| f.is_finite() && *f > 0.0);
    let focal = focal.ok_or_else(|| {
        let path = photo.path.display();
        CliError::wrong(format!(
            "{path}: no focal length in its EXIF or header; give --camera camera.json or --focal-px (focal length \
             in mm / sensor width in mm × picture width in px)"
        ))
    })?;
    let lens = Lens::pinhole(focal, w, h);
    let source = if args.focal_px.is_some() { "--focal-px" } else { "EXIF" };
    lens.check_plausible(w, h).map_err(|cause| CliError::wrong(format!("{source}: {cause}")))?;
    Ok(Camera { width: w, height: h, lens, pose: Pose::identity() })
}
