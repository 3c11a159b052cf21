//! Panoramas on disk: lat-long EXR with layers, and any picture of all directions.
//!
//! Written ([`picture_file`](super::picture_file)): EXR with `envmap`, R G B, `variance.R/G/B`,
//! `validity.Y`, `coverage.Y`; axes, rotation, place, unit and origin in `comments` as JSON. Read: that, or
//! any layout ([`Layout`]) that [`photo::read`](crate::photo::read()) reads; a lat-long must be 2:1, so that
//! a mapping taken for another is an error and not half a sphere of wrong directions (F27).

use std::borrow::Cow;
use std::path::Path;

use glam::{DMat3, DQuat, DVec3};

use super::ProbeError;
use super::axes::{Axes, moved_columns, with_columns};
use super::cube::{Cube, CubeFaces, CubeLayout};
pub use super::layout::Layout;
use super::mapping::{LatLong, Mapping};
use super::panorama::Panorama;
use super::picture_file::{self, Origin};
use super::resample::{Resampled, resample, to_lat_long};
use super::unwrap::check_width;
use super::view::Seeing;
use crate::bracket::{self, Radiance, Validity};
use crate::conventions::Rgb;
use crate::photo::{self, Format, Image, Photo, PhotoError, ReadOptions};

/// Writes a panorama, its texels in the world's axes: a turned one is resampled once.
pub fn write(path: &Path, panorama: &Panorama) -> Result<(), PhotoError> {
    write_seen(path, panorama, None)
}

/// [`write()`], and with it through what the panorama was seen, for merging.
pub fn write_seen(
    path: &Path,
    panorama: &Panorama,
    seeing: Option<&Seeing>,
) -> Result<(), PhotoError> {
    let panorama = &*in_world_axes(panorama);
    let seen_through = seeing.copied();
    let origin = Origin { place_m: panorama.place, seen_through, ..Origin::default() };
    let pictured = Resampled { light: light(panorama), coverage: panorama.coverage.clone() };
    picture_file::write_exr(path, &pictured, Layout::LatLong(Axes::OpenExr), &origin)
}

/// The same light with its texels in the world's axes; resampled if it was turned.
pub fn in_world_axes(panorama: &Panorama) -> Cow<'_, Panorama> {
    let turn = panorama.world_from_panorama;
    if turn.angle_between(DQuat::IDENTITY) < 1e-12 {
        return Cow::Borrowed(panorama);
    }
    let size = (panorama.width(), panorama.height());
    let lat_long = LatLong { width: size.0, height: size.1 };
    let back = DMat3::from_quat(turn.conjugate());
    let pictured = laid_out_by(panorama, &lat_long, size, back);
    let mut turned = Panorama::from_radiance(pictured.light.mean);
    turned.variance = pictured.light.variance;
    turned.validity = pictured.light.validity;
    turned.coverage = pictured.coverage;
    turned.place = panorama.place;
    Cow::Owned(turned)
}

/// The panorama's light in another layout, `size` as the layout's [`mapping`](Layout::mapping) has it.
///
/// Columns that only move are moved, everything else is resampled once.
///
/// # Errors
/// A size that the layout does not have.
pub fn laid_out(
    panorama: &Panorama,
    layout: Layout,
    size: (usize, usize),
) -> Result<Resampled, ProbeError> {
    let mapping = layout.mapping(size).ok_or_else(|| ProbeError::Value {
        what: "the size of the picture",
        found: format!("{} × {}", size.0, size.1),
        expected: layout.shape(),
    })?;
    let world_from_target =
        layout.axes().map_or(DMat3::IDENTITY, |axes| axes.picture_from_world().transpose());
    let panorama_from_world = DMat3::from_quat(panorama.world_from_panorama.conjugate());
    Ok(laid_out_by(panorama, &*mapping, size, panorama_from_world * world_from_target))
}

fn laid_out_by(
    panorama: &Panorama,
    target: &dyn Mapping,
    size: (usize, usize),
    panorama_from_target: DMat3,
) -> Resampled {
    let same_size = target.wraps() && size == (panorama.width(), panorama.height());
    let columns = if same_size { moved_columns(panorama_from_target, size.0) } else { None };
    if let Some(columns) = columns {
        return Resampled {
            light: Radiance {
                mean: with_columns(&panorama.radiance, &columns),
                variance: with_columns(&panorama.variance, &columns),
                validity: with_columns(&panorama.validity, &columns),
            },
            coverage: with_columns(&panorama.coverage, &columns),
        };
    }
    let source = light(panorama);
    let mapping = LatLong { width: panorama.width(), height: panorama.height() };
    let mut pictured = resample(&source, &mapping, target, size, panorama_from_target);
    if panorama.coverage.pixels().iter().all(|&seen| seen == 1.0) {
        return pictured;
    }
    let coverage = Radiance {
        mean: panorama.coverage.map(|c| Rgb::splat(*c)),
        variance: panorama.coverage.map(|_| Rgb::ZERO),
        validity: panorama.coverage.map(|_| Validity::Measured),
    };
    let seen = resample(&coverage, &mapping, target, size, panorama_from_target);
    pictured.coverage = seen.light.mean.map(|c| c.x);
    pictured
}

fn light(panorama: &Panorama) -> Radiance {
    Radiance {
        mean: panorama.radiance.clone(),
        variance: panorama.variance.clone(),
        validity: panorama.validity.clone(),
    }
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
/// `rotation` turns the picture, its axes taken as the layout says, in the world. Lat-longs keep their
/// texels; other layouts are resampled to `width` texels ([`Layout::natural_width`] if `None`). The layers that [`write`] writes are
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
    from_photo(&photo::read(path, options)?, layout, rotation, width)
}

/// As [`read`], of a picture that is there already.
///
/// # Errors
/// As [`read`]'s.
pub fn from_photo(
    photo: &Photo,
    layout: Layout,
    rotation: DQuat,
    width: Option<usize>,
) -> Result<ReadPanorama, ProbeError> {
    let (path, negative) = (&photo.path, negative(&photo.linear));
    let source = bracket::file::from_picture(photo)?;
    let (w, h) = (source.mean.width(), source.mean.height());
    let not_its_shape = || match layout {
        Layout::LatLong(_) => ProbeError::NotLatLong { path: path.clone(), width: w, height: h },
        _ => ProbeError::Layout { path: path.clone(), width: w, height: h, wanted: layout.shape() },
    };
    let mapping = layout.mapping((w, h)).ok_or_else(not_its_shape)?;
    let mut panorama = match layout {
        Layout::LatLong(axes) => with_axes(lat_long(path, photo.format, source)?, axes),
        _ => {
            let width = width.unwrap_or_else(|| layout.natural_width(w));
            check_width(width)?;
            to_lat_long(&source, &*mapping, DMat3::IDENTITY, width)
        }
    };
    if photo.data_window.is_some() {
        uncover_unseen(&mut panorama);
    }
    Ok(ReadPanorama {
        panorama: panorama.rotated(rotation),
        negative,
        remarks: photo.named_remarks().collect(),
        encoding: photo.encoding.clone(),
    })
}

/// The panorama of six pictures, the faces +X −X +Y −Y +Z −Z of a cube.
///
/// # Errors
/// As [`read`]'s, and faces that are not square or not of one size.
pub fn from_faces(
    photos: &[Photo; 6],
    faces: CubeFaces,
    rotation: DQuat,
    width: Option<usize>,
) -> Result<ReadPanorama, ProbeError> {
    let side = photos[0].linear.width();
    for photo in photos {
        let (width, height) = (photo.linear.width(), photo.linear.height());
        if (width, height) != (side, side) {
            let path = photo.path.clone();
            let wanted = "a face of a cube: square, and as large as the first";
            return Err(ProbeError::Layout { path, width, height, wanted });
        }
    }
    let [a, b, c, d, e, f] = photos;
    let light = |photo: &Photo| bracket::file::from_picture(photo);
    let cells = [light(a)?, light(b)?, light(c)?, light(d)?, light(e)?, light(f)?];
    let of = |x: usize, y: usize| (&cells[x / side], (x % side, y));
    let strip = Radiance {
        mean: Image::from_fn(6 * side, side, |x, y| of(x, y).0.mean[of(x, y).1]),
        variance: Image::from_fn(6 * side, side, |x, y| of(x, y).0.variance[of(x, y).1]),
        validity: Image::from_fn(6 * side, side, |x, y| of(x, y).0.validity[of(x, y).1]),
    };
    let layout = Layout::Cube(CubeLayout::Strip, faces);
    let width = width.unwrap_or_else(|| layout.natural_width(6 * side));
    check_width(width)?;
    let mapping = Cube::new(CubeLayout::Strip, faces, side);
    let panorama = to_lat_long(&strip, &mapping, DMat3::IDENTITY, width);
    let negatives = photos.iter().filter_map(|photo| negative(&photo.linear));
    Ok(ReadPanorama {
        panorama: panorama.rotated(rotation),
        negative: negatives.reduce(|a, b| Negative {
            texels: a.texels + b.texels,
            least: a.least.min(b.least),
            brightest: a.brightest.max(b.brightest),
        }),
        remarks: photos.iter().flat_map(Photo::named_remarks).collect(),
        encoding: photos[0].encoding.clone(),
    })
}

/// A lat-long whose texels are in other axes than ours: a mirrored one is mirrored back, then turned.
fn with_axes(mut panorama: Panorama, axes: Axes) -> Panorama {
    let mut world_from_picture = axes.picture_from_world().transpose();
    if world_from_picture.determinant() < 0.0 {
        let mirrored: Vec<usize> = (0..panorama.width()).rev().collect();
        panorama.radiance = with_columns(&panorama.radiance, &mirrored);
        panorama.variance = with_columns(&panorama.variance, &mirrored);
        panorama.validity = with_columns(&panorama.validity, &mirrored);
        panorama.coverage = with_columns(&panorama.coverage, &mirrored);
        world_from_picture *= DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0));
    }
    panorama.rotated(DQuat::from_mat3(&world_from_picture))
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
    use glam::DVec2;

    const LAT_LONG: Layout = Layout::LatLong(Axes::OpenExr);

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
        let back = read(&path, LAT_LONG, DQuat::IDENTITY, None).unwrap().panorama;
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
        let read = read(&path, LAT_LONG, DQuat::IDENTITY, None).unwrap().panorama;
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
        let found = read(&path, LAT_LONG, DQuat::IDENTITY, None).unwrap();
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
        let found = read(&path, LAT_LONG, DQuat::IDENTITY, None).unwrap();
        assert_eq!(found.panorama.radiance[(2, 2)], Rgb::new(1.0, 0.0, 1.0));
        let negative = found.negative.expect("one texel is negative");
        assert_eq!((negative.texels, negative.least), (1, -0.25));

        panorama.variance[(1, 1)] = Rgb::splat(f32::NAN);
        write(&path, &panorama).unwrap();
        let error = read(&path, LAT_LONG, DQuat::IDENTITY, None).unwrap_err();
        assert!(error.to_string().contains("variance"), "{error}");
    }

    #[test]
    fn wrong_shapes_are_refused_with_the_remedy() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("square.hdr");
        let square = Image::filled(64, 64, Rgb::ONE);
        photo::radiance_hdr::write(&path, &square, Default::default()).unwrap();
        let refused = |layout| read(&path, layout, DQuat::IDENTITY, None).unwrap_err().to_string();
        assert!(refused(LAT_LONG).contains("angular"), "{}", refused(LAT_LONG));
        assert!(refused(Layout::Cube(CubeLayout::Cross, CubeFaces::Inside)).contains("cube"));
        let angular = read(&path, Layout::Angular, DQuat::IDENTITY, Some(64)).unwrap().panorama;
        assert_eq!((angular.width(), angular.height()), (64, 32));
        assert!(read(&path, Layout::Angular, DQuat::IDENTITY, Some(3)).is_err());
        assert!(read(Path::new("nowhere.exr"), LAT_LONG, DQuat::IDENTITY, None).is_err());
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
