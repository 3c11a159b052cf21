//! Panoramas on disk: lat-long EXR with layers, and any picture of all directions.
//!
//! Written: EXR with `envmap`, R G B, `variance.R/G/B`, `validity.Y`, `coverage.Y`; rotation, place
//! and unit in `comments` as JSON. Read: that, or any lat-long, angular map or cube cross that
//! [`photo::read`](crate::photo::read()) reads; a lat-long must be 2:1, so that a mapping taken for
//! another is an error and not half a sphere of wrong directions (F27).

use std::path::Path;

use glam::{DMat3, DQuat, DVec3};

use super::ProbeError;
use super::mapping::{Angular, BallMap, CubeCross};
use super::panorama::Panorama;
use super::resample::to_lat_long;
use super::unwrap::check_width;
use crate::bracket::{self, Radiance, Validity};
use crate::conventions::Rgb;
use crate::photo::exr_file::{self, ExrAttributes, ExrPicture, ExrSamples, LINEAR_REC709};
use crate::photo::{self, Image, PhotoError, ReadOptions};

/// How a picture of all directions is laid out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layout {
    LatLong,
    /// Debevec's angular map; −Z in the middle.
    Angular,
    /// Orthographic mirror-ball map; +Z in the middle.
    BallMap,
    /// Horizontal cube cross, 4 × 3 faces; −Z in the middle row's second face.
    Cube,
}

/// Writes a panorama.
pub fn write(path: &Path, panorama: &Panorama) -> Result<(), PhotoError> {
    let comments = serde_json::json!({
        "what": "lat-long panorama: +Z in the middle, +X left of it, +Y up; texel areas tile the sphere",
        "world_from_panorama_xyzw": panorama.world_from_panorama.to_array(),
        "place_m": panorama.place.to_array(),
        "validity": "0 measured, 1 single, 2 lower bound, 3 upper bound, 4 moved, 5 filled, 6 analytic",
    });
    let mut picture = ExrPicture {
        width: panorama.width(),
        height: panorama.height(),
        channels: Vec::new(),
        attributes: ExrAttributes {
            comments: Some(comments.to_string()),
            colour_id: Some(LINEAR_REC709),
            lat_long: true,
            ..ExrAttributes::default()
        },
    };
    for (layer, image) in [("", &panorama.radiance), ("variance.", &panorama.variance)] {
        for (channel, name) in ["R", "G", "B"].into_iter().enumerate() {
            // Float: the sun does not fit a half.
            let samples = image.pixels().iter().map(|l| l[channel]).collect();
            picture.push(format!("{layer}{name}"), ExrSamples::F32(samples));
        }
    }
    let classes = panorama.validity.pixels().iter().map(|&v| u32::from(v as u8)).collect();
    picture.push("validity.Y", ExrSamples::U32(classes));
    picture.push("coverage.Y", ExrSamples::F32(panorama.coverage.pixels().to_vec()));
    exr_file::write(path, &picture)
}

/// Reads a picture of all directions as a panorama.
///
/// `rotation` takes the picture's axes to the world. Lat-longs keep their texels; other layouts are
/// resampled to `width` texels ([`natural_width`] if `None`). The layers that [`write`] writes are
/// read where they are; a picture without them is taken as measured and exact.
pub fn read(
    path: &Path,
    layout: Layout,
    rotation: DQuat,
    width: Option<usize>,
) -> Result<Panorama, ProbeError> {
    let options = ReadOptions::default();
    let photo = photo::read(path, &options)?;
    if let Some(bad) = photo.nonfinite {
        let (x, y) = bad.first;
        return Err(ProbeError::NotFinite { path: path.into(), n: bad.pixels, x, y });
    }
    let linear = without_negatives(photo.linear);
    let (w, h) = (linear.width(), linear.height());
    if layout == Layout::LatLong {
        if w != 2 * h {
            return Err(ProbeError::NotLatLong { path: path.into(), width: w, height: h });
        }
        return Ok(with_layers(path, linear).rotated(rotation));
    }
    let width = width.unwrap_or_else(|| natural_width(layout, w));
    check_width(width)?;
    let shape = |wanted: &'static str| ProbeError::Layout {
        path: path.into(),
        width: w,
        height: h,
        wanted,
    };
    let source = exact(linear);
    let panorama = match layout {
        Layout::Cube if w % 4 == 0 && w / 4 * 3 == h => {
            to_lat_long(&source, &CubeCross { face: w / 4 }, DMat3::IDENTITY, width)
        }
        Layout::Cube => return Err(shape("a horizontal cube cross (4 faces wide, 3 high)")),
        _ if w != h => return Err(shape("square")),
        Layout::Angular => to_lat_long(&source, &Angular { size: w }, DMat3::IDENTITY, width),
        Layout::BallMap => to_lat_long(&source, &BallMap { size: w }, DMat3::IDENTITY, width),
        // Returned above.
        Layout::LatLong => return Err(shape("twice as wide as high")),
    };
    Ok(panorama.rotated(rotation))
}

/// Width at which the layout's middle keeps its resolution.
fn natural_width(layout: Layout, width: usize) -> usize {
    let texels = match layout {
        Layout::LatLong | Layout::Cube => width,
        Layout::Angular => width,
        Layout::BallMap => width * 3 / 2,
    };
    (texels.clamp(64, 8192) / 2) * 2
}

fn exact(mean: Image<Rgb>) -> Radiance {
    let (w, h) = (mean.width(), mean.height());
    Radiance {
        mean,
        variance: Image::filled(w, h, Rgb::ZERO),
        validity: Image::filled(w, h, Validity::Measured),
    }
}

/// Light is not negative; compression and colour conversion make it slightly so.
fn without_negatives(mut linear: Image<Rgb>) -> Image<Rgb> {
    linear.pixels_mut().iter_mut().for_each(|l| *l = l.max(Rgb::ZERO));
    linear
}

/// The panorama with the layers that the file has of those [`write`] writes.
fn with_layers(path: &Path, radiance: Image<Rgb>) -> Panorama {
    let (w, h) = (radiance.width(), radiance.height());
    let mut panorama = Panorama::from_radiance(radiance);
    if let Ok(stored) = bracket::file::read(path)
        && (stored.mean.width(), stored.mean.height()) == (w, h)
    {
        panorama.variance = stored.variance;
        panorama.validity = stored.validity;
    }
    let options = ReadOptions { layer: Some("coverage".into()), ..ReadOptions::default() };
    if let Ok(coverage) = photo::read(path, &options)
        && (coverage.linear.width(), coverage.linear.height()) == (w, h)
    {
        panorama.coverage = coverage.linear.map(|c| c.x);
    }
    panorama
}

/// Radians about the world's X, then Y, then Z: how shot files write a rotation in degrees.
pub fn rotation_xyz_deg(degrees: [f64; 3]) -> DQuat {
    let [x, y, z] = degrees.map(f64::to_radians);
    DQuat::from_axis_angle(DVec3::Z, z)
        * DQuat::from_axis_angle(DVec3::Y, y)
        * DQuat::from_axis_angle(DVec3::X, x)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec2;

    #[test]
    fn a_panorama_survives_its_file() {
        let mut panorama = Panorama::from_radiance(Image::from_fn(16, 8, |x, y| {
            Rgb::new(x as f32, y as f32, 70000.0)
        }));
        panorama.validity[(3, 2)] = Validity::LowerBound;
        panorama.variance[(3, 2)] = Rgb::splat(4.0);
        panorama.coverage[(5, 5)] = 0.25;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pano.exr");
        write(&path, &panorama).unwrap();
        let back = read(&path, Layout::LatLong, DQuat::IDENTITY, None).unwrap();
        assert_eq!(back.radiance, panorama.radiance);
        assert_eq!(back.variance, panorama.variance);
        assert_eq!(back.validity, panorama.validity);
        assert_eq!(back.coverage, panorama.coverage);
    }

    #[test]
    fn wrong_shapes_are_refused_with_the_remedy() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("square.hdr");
        let square = Image::filled(64, 64, Rgb::ONE);
        photo::radiance_hdr::write(&path, &square, Default::default()).unwrap();
        let refused = |layout| read(&path, layout, DQuat::IDENTITY, None).unwrap_err().to_string();
        assert!(refused(Layout::LatLong).contains("angular"), "{}", refused(Layout::LatLong));
        assert!(refused(Layout::Cube).contains("cube"));
        let angular = read(&path, Layout::Angular, DQuat::IDENTITY, Some(64)).unwrap();
        assert_eq!((angular.width(), angular.height()), (64, 32));
        assert!(read(&path, Layout::Angular, DQuat::IDENTITY, Some(3)).is_err());
        assert!(read(Path::new("nowhere.exr"), Layout::LatLong, DQuat::IDENTITY, None).is_err());
    }

    #[test]
    fn rotation_turns_about_x_then_y_then_z() {
        let turned = rotation_xyz_deg([90.0, 90.0, 0.0]) * DVec3::Y;
        // About X: +Y becomes +Z; about Y: +Z becomes +X.
        assert!((turned - DVec3::X).length() < 1e-12, "{turned}");
        let panorama = Panorama::from_radiance(Image::filled(4, 2, Rgb::ONE));
        let front = panorama.rotated(rotation_xyz_deg([0.0, 90.0, 0.0]));
        let there = crate::conventions::lat_long_direction(DVec2::new(1.5, 0.5), 4, 2);
        assert!((there - DVec3::Z).length() < 1e-12);
        assert!((front.world_from_panorama * there - DVec3::X).length() < 1e-12);
    }
}
