//! Photographs of a ball or through a lens, and maps of directions → panorama.

use std::path::PathBuf;

use glam::{DMat3, DQuat};

use super::args::{FisheyeKind, Source, Wishes};
use super::by_ball::{self, BallLight};
use crate::bracket::{self, Frame, MergeOptions, Radiance, Warp, exposure};
use crate::camera::lens::focal_px_from_35mm;
use crate::camera::{Camera, Lens, Pose};
use crate::cli::{CliError, Global};
use crate::conventions::Rgb;
use crate::photo::{self, Encoded, Format, Image, Photo};
use crate::probe::axes::Axes;
use crate::probe::find::BallImage;
use crate::probe::fisheye::{Fisheye, Projection};
use crate::probe::layout::Layout;
use crate::probe::lens_picture::LensPicture;
use crate::probe::mapping::Mapping;
use crate::probe::overlay::overlay;
use crate::probe::unwrap::{BallView, natural_width};
use crate::probe::view::Seeing;
use crate::probe::{Ball, Doubt, Panorama, file, photographed};

/// A panorama, and how its pictures showed it.
pub(super) struct Photographed {
    pub(super) panorama: Panorama,
    pub(super) ball: Option<BallImage>,
    /// The photograph with the rim, if it is wanted.
    pub(super) overlay: Option<Image<Rgb>>,
    pub(super) seen: Seen,
    /// Through what, in the panorama's world axes, as far as its file can say.
    pub(super) seeing: Option<Seeing>,
    /// What a value of 1 means.
    pub(super) unit: String,
}

/// Which direction each pixel of a picture showed.
pub(super) enum Seen {
    /// Several pictures of which none is told apart.
    Together,
    /// Of one picture.
    Picture { mapping: Box<dyn Mapping>, size: (usize, usize), mapping_from_world: DMat3 },
    /// Of several: pixels per degree, as a panorama in all channels.
    Several(Panorama),
}

/// Ball, fisheye or lens: merge, find, unwrap.
pub(super) fn photographed(
    wishes: &Wishes,
    warnings: &mut Vec<String>,
    global: &Global,
) -> Result<Photographed, CliError> {
    let args = wishes.args;
    let read = args.photos.iter().map(|path| photo::read_encoded(path, &wishes.read));
    let photos: Vec<Encoded> = read.collect::<Result<_, _>>()?;
    warnings.extend(photos.iter().flat_map(Encoded::named_remarks));
    global.go_on()?;
    if args.kind.ball {
        let merged = by_ball::merge(wishes, photos, warnings)?;
        global.go_on()?;
        return ball(wishes, merged, warnings);
    }
    let Merged { radiance, unit, .. } = merge(wishes, &photos, warnings)?;
    global.go_on()?;
    through_a_lens(wishes, &photos[0], radiance, unit)
}

fn through_a_lens(
    wishes: &Wishes,
    photo: &Encoded,
    mut radiance: Radiance,
    unit: String,
) -> Result<Photographed, CliError> {
    let args = wishes.args;
    let size = (radiance.mean.width(), radiance.mean.height());
    let mut seeing = None;
    let (mapping, world_from_lens, width): (Box<dyn Mapping>, _, _) = match args.kind.fisheye {
        Some(kind) => {
            let lens = fisheye(wishes, kind, size.0, size.1)?;
            if let Some(vignetting) = &wishes.vignetting {
                vignetting.divide_out(&mut radiance, |pixel| lens.off_axis(pixel))?;
            }
            let width = natural_width(lens.radius_px());
            seeing = Some(Seeing::fisheye(&lens, wishes.rotation));
            (Box::new(lens), wishes.rotation, width)
        }
        None => {
            let camera = camera(wishes, photo, size.0, size.1)?;
            let lens = LensPicture::new(camera.lens, size.0, size.1)?;
            if let Some(vignetting) = &wishes.vignetting {
                vignetting.divide_out(&mut radiance, |pixel| lens.off_axis(pixel))?;
            }
            // A quarter turn of a ball or circle is its radius; here it is that many pixels.
            let width = natural_width(2.0 / lens.pixel_rad());
            let world_from_camera = DQuat::from_mat3(&camera.pose.rotation());
            (Box::new(lens), wishes.rotation * world_from_camera, width)
        }
    };
    let width = args.width.unwrap_or(width);
    let panorama = photographed::through(&radiance, &*mapping, world_from_lens, width)?;
    let mapping_from_world = DMat3::from_quat(world_from_lens.conjugate());
    let seen = Seen::Picture { mapping, size, mapping_from_world };
    Ok(Photographed { panorama, ball: None, overlay: None, seen, seeing, unit })
}

fn ball(
    wishes: &Wishes,
    merged: BallLight,
    warnings: &mut Vec<String>,
) -> Result<Photographed, CliError> {
    let args = wishes.args;
    let BallLight { radiance, camera, found, .. } = &merged;
    let size = (radiance.mean.width(), radiance.mean.height());
    let reflectance = wishes.reflectance.unwrap_or(Rgb::ONE);
    let ball = Ball::new(found.centre_of(args.radius, camera), args.radius, reflectance)?;
    let panorama = photographed::ball(radiance, camera, found, &ball, None, args.width)?;
    warnings.extend(Doubt::about(found).into_iter().map(|doubt| doubt.sentence("--hint")));
    let wants_overlay = args.overlay.is_some();
    let drawn = wants_overlay.then(|| overlay(&radiance.mean, &camera.lens, found, 800));
    if wishes.reflectance.is_none() {
        warnings.push(
            "--reflectance is not given: the ball is taken as perfect, and the light comes out \
             too dark by its reflectance (chrome 0.55, good steel 0.6)"
                .into(),
        );
    }
    let seen = Seen::Picture {
        mapping: Box::new(BallView::new(camera, &found.rim, &ball, None)?),
        size,
        mapping_from_world: camera.pose.rotation().transpose()
            * DMat3::from_quat(wishes.rotation.conjugate()),
    };
    let seeing = Seeing::ball(&camera.lens, &found.rim, camera.pose.rotation())?;
    let seeing = Some(seeing.rotated(wishes.rotation));
    let panorama = panorama.rotated(wishes.rotation);
    let BallLight { found, unit, .. } = merged;
    Ok(Photographed { panorama, ball: Some(found), overlay: drawn, seen, seeing, unit })
}

/// One picture of directions, or the six faces of a cube.
pub(super) fn mapped(
    wishes: &Wishes,
    layout: Layout,
    warnings: &mut Vec<String>,
) -> Result<Photographed, CliError> {
    let args = wishes.args;
    let (read, size, warned) = match (wishes.source, args.photos.as_slice()) {
        (Source::Faces(faces), [px, nx, py, ny, pz, nz]) => {
            let face = |path: &PathBuf| photo::read(path, &wishes.read);
            let photos = [face(px)?, face(nx)?, face(py)?, face(ny)?, face(pz)?, face(nz)?];
            let size = (6 * photos[0].linear.width(), photos[0].linear.height());
            let read = file::from_faces(&photos, faces, wishes.rotation, args.width)?;
            (read, size, "the faces")
        }
        (Source::Faces(_), _) => {
            return Err(CliError::wrong(
                "--cube-faces: give six pictures in the order +X -X +Y -Y +Z -Z",
            ));
        }
        (_, [path]) => {
            let photo = photo::read(path, &wishes.read)?;
            let size = (photo.linear.width(), photo.linear.height());
            let read = file::from_photo(&photo, layout, wishes.rotation, args.width)?;
            (read, size, "the map")
        }
        _ => return Err(CliError::wrong("a map of directions is one picture, not a bracket")),
    };
    warnings.extend(read.remarks);
    warnings.extend(read.negative.map(|negative| match args.photos.as_slice() {
        [path] => format!("{}: {negative}", path.display()),
        _ => format!("{warned}: {negative}"),
    }));
    let mapping = layout.mapping(size).ok_or_else(|| CliError::wrong("no shape of a map"))?;
    let picture_from_world = layout.axes().map_or(DMat3::IDENTITY, Axes::picture_from_world);
    let mapping_from_world = picture_from_world * DMat3::from_quat(wishes.rotation.conjugate());
    Ok(Photographed {
        panorama: read.panorama,
        ball: None,
        overlay: None,
        seen: Seen::Picture { mapping, size, mapping_from_world },
        seeing: None,
        unit: "the value of the file that was read".into(),
    })
}

/// Photographs made one picture of light.
pub(super) struct Merged {
    pub(super) radiance: Radiance,
    /// What a value of 1 means.
    pub(super) unit: String,
    /// Where each photograph has the pixels of `radiance`.
    pub(super) warps: Vec<Warp>,
    /// Exposure of each photograph, as labelled.
    pub(super) exposures: Vec<f64>,
}

/// The photographs as radiance, and its unit: an EXR or HDR as it is, a bracket or a single photograph merged.
pub(super) fn merge(
    wishes: &Wishes,
    photos: &[Encoded],
    warnings: &mut Vec<String>,
) -> Result<Merged, CliError> {
    if let [only] = photos
        && matches!(only.format, Format::Exr | Format::RadianceHdr)
    {
        if wishes.times_s.is_some() {
            return Err(CliError::wrong(format!(
                "--times: {} is one picture of radiance, taken as it is; leave --times out",
                only.path.display()
            )));
        }
        let unit = "the value of the file that was read";
        return Ok(Merged {
            radiance: bracket::file::from_picture(&Photo::from(only.clone()))?,
            unit: unit.into(),
            warps: vec![Warp::IDENTITY],
            exposures: vec![1.0],
        });
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
    let unit = match (&wishes.times_s, photos) {
        (None, [only]) if exposure::exposure(&only.facts).is_none() => {
            "the linear value of the photograph"
        }
        _ => {
            "linear value of the photographs / exposure, t (ISO / 100) / N^2 with t in s; where EXIF has no \
              ISO and N, as if 100 and 1"
        }
    };
    let bracket::Merged { radiance, warps, .. } = merged;
    Ok(Merged { radiance, unit: unit.into(), warps, exposures })
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

/// The camera of the photographs: a file, a focal length, or EXIF.
pub(super) fn camera(
    wishes: &Wishes,
    photo: &Encoded,
    w: usize,
    h: usize,
) -> Result<Camera, CliError> {
    let args = wishes.args;
    if let Some(path) = &args.camera {
        let camera = crate::camera::file::read(path)?.camera;
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
