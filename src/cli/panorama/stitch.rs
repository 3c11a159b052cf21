//! Overlapping photographs from one place → panorama: cameras by OpenCV, light by our own resampling.

use std::path::Path;

use glam::{DMat3, DQuat};

use super::args::Wishes;
use super::photographed::{Photographed, Seen};
use crate::bracket::{self, Frame, MergeOptions, Radiance, exposure};
use crate::cli::{CliError, Global};
use crate::conventions::luminance;
use crate::photo::{self, Encoded, Format, Photo};
use crate::probe::lens_picture::LensPicture;
use crate::probe::stitched::{View, stitched};
use crate::probe::unwrap::natural_width;
use crate::shot::detect::{TurnedCamera, turned_cameras};

/// Views that are brighter or darker than the others by more than this are told of, stops.
const TOLD_STOPS: f32 = 0.1;

pub(super) fn stitch(
    wishes: &Wishes,
    warnings: &mut Vec<String>,
    global: &Global,
) -> Result<Photographed, CliError> {
    let args = wishes.args;
    let photos: Vec<Photo> =
        args.photos.iter().map(|path| photo::read(path, &wishes.read)).collect::<Result<_, _>>()?;
    warnings.extend(photos.iter().flat_map(Photo::named_remarks));
    global.go_on()?;
    let (radiances, unit) = radiances(wishes, &photos)?;
    let lumas: Vec<_> =
        radiances.iter().map(|radiance| radiance.mean.map(|&l| luminance(l).max(0.0))).collect();
    let cameras =
        turned_cameras(&lumas).map_err(|error| CliError::wrong(format!("--stitch: {error}")))?;
    drop(lumas);
    global.go_on()?;
    let (shown, views) = views(&photos, &radiances, cameras, warnings)?;
    // As fine as the finest view.
    let pixel_rad = views.iter().map(|view| view.picture.pixel_rad()).fold(f64::INFINITY, f64::min);
    let width = args.width.unwrap_or_else(|| natural_width(2.0 / pixel_rad));
    let found = stitched(&views, width)?;
    for (path, stops) in shown.iter().zip(&found.off_stops) {
        if stops.abs() > TOLD_STOPS {
            warnings.push(format!(
                "{}: {stops:+.2} stops beside the photographs that it overlaps; give true exposures \
                 (--times), or light changed between them",
                path.display()
            ));
        }
    }
    let panorama = found.panorama.rotated(wishes.rotation);
    Ok(Photographed {
        panorama,
        ball: None,
        overlay: None,
        seen: Seen::Together,
        seeing: None,
        unit,
    })
}

/// Each photograph as radiance on one scale.
fn radiances(wishes: &Wishes, photos: &[Photo]) -> Result<(Vec<Radiance>, String), CliError> {
    let linear = |photo: &Photo| matches!(photo.format, Format::Exr | Format::RadianceHdr);
    if photos.iter().all(linear) {
        if wishes.times_s.is_some() {
            return Err(CliError::wrong(
                "--times: these are pictures of radiance, taken as they are; leave --times out",
            ));
        }
        let all = photos.iter().map(bracket::file::from_picture).collect::<Result<_, _>>()?;
        return Ok((all, "the value of the files that were read".into()));
    }
    let encoded: Vec<Encoded> = photos.iter().map(Photo::encoded).collect();
    let exposures = match &wishes.times_s {
        Some(times) => exposure::from_times(&encoded, times)?,
        None => exposure::from_exif(&encoded)?,
    };
    let single = |(photo, &exposure): (&Encoded, &f64)| {
        bracket::merge(&[Frame { photo, exposure }], &MergeOptions::default())
            .map(|merged| merged.radiance)
    };
    let all = encoded.iter().zip(&exposures).map(single).collect::<Result<_, _>>()?;
    Ok((all, "linear value of the photographs / exposure, t (ISO / 100) / N^2 with t in s".into()))
}

/// The views that overlap, and the photographs they are; the others are told of.
fn views<'a>(
    photos: &'a [Photo],
    radiances: &'a [Radiance],
    cameras: Vec<Option<TurnedCamera>>,
    warnings: &mut Vec<String>,
) -> Result<(Vec<&'a Path>, Vec<View<'a>>), CliError> {
    let (mut shown, mut views) = (Vec::new(), Vec::new());
    for ((photo, radiance), camera) in photos.iter().zip(radiances).zip(cameras) {
        let Some(TurnedCamera { lens, world_from_camera }) = camera else {
            warnings.push(format!(
                "{}: overlaps with no other photograph and is left out",
                photo.path.display()
            ));
            continue;
        };
        let (width, height) = (radiance.mean.width(), radiance.mean.height());
        let picture = LensPicture::new(lens, width, height)?;
        // Single precision left it a little off a rotation.
        let turn = DQuat::from_mat3(&world_from_camera).normalize();
        let world_from_camera = DMat3::from_quat(turn);
        shown.push(photo.path.as_path());
        views.push(View { radiance, picture, world_from_camera });
    }
    Ok((shown, views))
}
