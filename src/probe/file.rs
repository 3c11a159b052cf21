//! Panoramas on disk: lat-long EXR with layers, and any picture of all directions.
//!
//! Written: EXR with `envmap`, R G B, `variance.R/G/B`, `validity.Y`, `coverage.Y`; rotation, place
//! and unit in `comments` as JSON. Read: that, or any lat-long, angular map or cube cross that
//! [`photo::read`](crate::photo::read()) reads; a lat-long must be 2:1, so that a mapping taken for
//! another is an error and not half a sphere of wrong directions (F27).

use std::borrow::Cow;
use std::path::Path;

use glam::{DMat3, DQuat, DVec3};

use super::ProbeError;
use super::mapping::{Angular, BallMap, CubeCross, LatLong};
use super::panorama::Panorama;
use super::resample::to_lat_long;
use super::unwrap::check_width;
use crate::bracket::{self, Radiance, Validity};
use crate::conventions::Rgb;
use crate::photo::exr_file::{self, ExrAttributes, ExrPicture, ExrSamples, LINEAR_REC709};
use crate::photo::{self, Format, Image, PhotoError, ReadOptions};

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

/// Writes a panorama, its texels in the world's axes: a turned one is resampled once.
pub fn write(path: &Path, panorama: &Panorama) -> Result<(), PhotoError> {
    let panorama = &*in_world_axes(panorama);
    let comments = serde_json::json!({
        "what": "lat-long panorama: +Z in the middle, +X left of it, +Y up; texel areas tile the sphere",
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

/// The same light with its texels in the world's axes; resampled if it was turned.
pub fn in_world_axes(panorama: &Panorama) -> Cow<'_, Panorama> {
    let turn = panorama.world_from_panorama;
    if turn.angle_between(DQuat::IDENTITY) < 1e-12 {
        return Cow::Borrowed(panorama);
    }
    let mapping = LatLong { width: panorama.width(), height: panorama.height() };
    let back = DMat3::from_quat(turn.conjugate());
    let source = Radiance {
        mean: panorama.radiance.clone(),
        variance: panorama.variance.clone(),
        validity: panorama.validity.clone(),
    };
    let mut turned = to_lat_long(&source, &mapping, back, mapping.width);
    turned.place = panorama.place;
    let coverage = Radiance {
        mean: panorama.coverage.map(|c| Rgb::splat(*c)),
        variance: panorama.coverage.map(|_| Rgb::ZERO),
        validity: panorama.coverage.map(|_| Validity::Measured),
    };
    let seen = to_lat_long(&coverage, &mapping, back, mapping.width);
    turned.coverage = seen.radiance.map(|c| c.x);
    Cow::Owned(turned)
}

/// A panorama read, and what was not right with its file.
#[derive(Clone, Debug)]
pub struct ReadPanorama {
    pub panorama: Panorama,
    /// Texels with negative light, which is taken as none.
    pub negative: Option<Negative>,
    /// What a person should know of how the file was read, each a sentence without its name.
    pub remarks: Vec<String>,
    /// How the file's numbers stand for light.
    pub encoding: photo::Encoding,
}

/// Negative light in a picture; compression and colour conversion make a little of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Negative {
    pub texels: usize,
    /// The lowest value, the picture's unit.
    pub least: f32,
    /// The brightest value, to compare it with.
    pub brightest: f32,
}

/// "3 texels hold negative light, which is taken as none: down to -0.25, the brightest is 7".
impl std::fmt::Display for Negative {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        let Self { texels, least, brightest } = self;
        write!(
            f,
            "{texels} texels hold negative light, which is taken as none: down to {least}, the \
             brightest is {brightest}"
        )
    }
}

/// Reads a picture of all directions as a panorama.
///
/// `rotation` takes the picture's axes to the world. Lat-longs keep their texels; other layouts are
/// resampled to `width` texels ([`natural_width`] if `None`). The layers that [`write`] writes are
/// read where they are; a picture without them is taken as exact, its clipped pixels as lower bounds.
///
/// # Errors
/// An unreadable picture or layer, values that are not finite, or a shape that is not the layout's.
pub fn read(
    path: &Path,
    layout: Layout,
    rotation: DQuat,
    width: Option<usize>,
    options: &ReadOptions,
) -> Result<ReadPanorama, ProbeError> {
    let photo = photo::read(path, options)?;
    let (negative, encoding) = (negative(&photo.linear), photo.encoding.clone());
    let remarks = photo.named_remarks().collect();
    let source = bracket::file::from_picture(&photo)?;
    let (w, h) = (source.mean.width(), source.mean.height());
    if layout == Layout::LatLong {
        if w != 2 * h {
            return Err(ProbeError::NotLatLong { path: path.into(), width: w, height: h });
        }
        let mut panorama = lat_long(path, photo.format, source)?;
        if photo.data_window.is_some() {
            uncover_unseen(&mut panorama);
        }
        let panorama = panorama.rotated(rotation);
        return Ok(ReadPanorama { panorama, negative, remarks, encoding });
    }
    let width = width.unwrap_or_else(|| natural_width(layout, w));
    check_width(width)?;
    let shape = |wanted: &'static str| ProbeError::Layout {
        path: path.into(),
        width: w,
        height: h,
        wanted,
    };
    let mut panorama = match layout {
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
    if photo.data_window.is_some() {
        uncover_unseen(&mut panorama);
    }
    let panorama = panorama.rotated(rotation);
    Ok(ReadPanorama { panorama, negative, remarks, encoding })
}

/// What no pixel of the file shows is not covered.
fn uncover_unseen(panorama: &mut Panorama) {
    let Panorama { validity, coverage, .. } = panorama;
    for (class, coverage) in validity.pixels().iter().zip(coverage.pixels_mut()) {
        if *class == Validity::Filled {
            *coverage = 0.0;
        }
    }
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

fn negative(linear: &Image<Rgb>) -> Option<Negative> {
    let pixels = linear.pixels();
    let texels = pixels.iter().filter(|l| l.min_element() < 0.0).count();
    let least = pixels.iter().map(|l| l.min_element()).fold(0.0, f32::min);
    let brightest = pixels.iter().map(|l| l.max_element()).fold(0.0, f32::max);
    (texels > 0).then_some(Negative { texels, least, brightest })
}

/// The panorama that a lat-long picture is, with its file's coverage where that has one.
fn lat_long(path: &Path, format: Format, source: Radiance) -> Result<Panorama, PhotoError> {
    let (w, h) = (source.mean.width(), source.mean.height());
    let mut panorama = Panorama::from_radiance(source.mean);
    panorama.variance = source.variance;
    panorama.validity = source.validity;
    let stored = match format {
        Format::Exr => photo::read_layer(path, "coverage")?,
        _ => None,
    };
    if let Some(coverage) = stored {
        if (coverage.linear.width(), coverage.linear.height()) != (w, h) {
            let cause = "its layer coverage has another size than the picture; write it again";
            return Err(PhotoError::Picture { path: path.into(), cause: cause.into() });
        }
        panorama.coverage = coverage.linear.map(|c| c.x.clamp(0.0, 1.0));
    }
    Ok(panorama)
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
    use crate::bracket::Validity;
    use glam::DVec2;

    fn read(
        path: &Path,
        layout: Layout,
        rotation: DQuat,
        width: Option<usize>,
    ) -> Result<ReadPanorama, ProbeError> {
        super::read(path, layout, rotation, width, &ReadOptions::default())
    }

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
        let back = read(&path, Layout::LatLong, DQuat::IDENTITY, None).unwrap().panorama;
        assert_eq!(back.radiance, panorama.radiance);
        assert_eq!(back.variance, panorama.variance);
        assert_eq!(back.validity, panorama.validity);
        assert_eq!(back.coverage, panorama.coverage);
    }

    #[test]
    fn a_turned_panorama_is_written_in_the_worlds_axes() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("turned.exr");
        let smooth = Image::from_fn(64, 32, |x, y| {
            let d = crate::conventions::lat_long_direction(DVec2::new(x as f64, y as f64), 64, 32);
            Rgb::splat(2.0 + d.x as f32)
        });
        // A quarter about +Y takes the map's +X to the world's −Z.
        let turn = DQuat::from_rotation_y(std::f64::consts::FRAC_PI_2);
        let mut turned = Panorama::from_radiance(smooth).rotated(turn);
        turned.place = DVec3::new(0.1, 0.2, 0.3);
        write(&path, &turned).unwrap();
        let read = read(&path, Layout::LatLong, DQuat::IDENTITY, None).unwrap().panorama;
        for (x, y) in [(3, 16), (20, 10), (40, 20), (60, 15)] {
            let d = read.direction(x, y);
            let l = f64::from(read.radiance[(x, y)].x);
            assert!((l - (2.0 - d.z)).abs() < 0.02, "{d}: {l}");
        }
        // Its place is the world's already and is not turned.
        let header = String::from_utf8_lossy(&std::fs::read(&path).unwrap()).into_owned();
        assert!(header.contains("\"place_m\":[0.1,0.2,0.3]"), "{header:.2000}");
    }

    #[test]
    fn clipped_texels_of_a_picture_are_lower_bounds() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pano.png");
        let mut codes = vec![100u8; 16 * 8 * 3];
        codes[(3 * 16 + 5) * 3] = 255;
        let encoding = photo::Encoding {
            transfer: photo::Transfer::Srgb,
            primaries: photo::Primaries::Rec709,
            source: photo::EncodingSource::Named,
        };
        let samples = photo::Samples::U8 { channels: 3, data: codes };
        photo::png::write(&path, &samples, 16, 8, &encoding).unwrap();
        let found = read(&path, Layout::LatLong, DQuat::IDENTITY, None).unwrap();
        assert_eq!(found.panorama.validity[(5, 3)], Validity::LowerBound);
        assert_eq!(found.panorama.share(Validity::Measured), {
            let clipped = found.panorama.solid_angle(3) / (4.0 * std::f64::consts::PI);
            1.0 - clipped
        });
        // The same picture as an angular map: its middle is clipped, and stays so when resampled.
        let codes: Vec<u8> = (0..64 * 64)
            .flat_map(|i| {
                let inside = (28..36).contains(&(i % 64)) && (28..36).contains(&(i / 64));
                [if inside { 255 } else { 100 }; 3]
            })
            .collect();
        let samples = photo::Samples::U8 { channels: 3, data: codes };
        photo::png::write(&path, &samples, 64, 64, &encoding).unwrap();
        let angular = read(&path, Layout::Angular, DQuat::IDENTITY, Some(64)).unwrap();
        assert!(angular.panorama.share(Validity::LowerBound) > 0.0);
    }

    #[test]
    fn negative_light_is_counted_and_a_broken_layer_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pano.exr");
        let mut panorama = Panorama::from_radiance(Image::filled(16, 8, Rgb::ONE));
        panorama.radiance[(2, 2)] = Rgb::new(1.0, -0.25, 1.0);
        write(&path, &panorama).unwrap();
        let found = read(&path, Layout::LatLong, DQuat::IDENTITY, None).unwrap();
        assert_eq!(found.panorama.radiance[(2, 2)], Rgb::new(1.0, 0.0, 1.0));
        let negative = found.negative.expect("one texel is negative");
        assert_eq!((negative.texels, negative.least), (1, -0.25));

        panorama.variance[(1, 1)] = Rgb::splat(f32::NAN);
        write(&path, &panorama).unwrap();
        let error = read(&path, Layout::LatLong, DQuat::IDENTITY, None).unwrap_err();
        assert!(error.to_string().contains("variance"), "{error}");
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
        let angular = read(&path, Layout::Angular, DQuat::IDENTITY, Some(64)).unwrap().panorama;
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
