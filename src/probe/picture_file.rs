//! Pictures of directions written: EXR with everything known of them, or Radiance `.hdr`.

use std::path::Path;

use glam::DVec3;

use super::axes::Axes;
use super::cube::{CubeFaces, CubeLayout};
use super::layout::Layout;
use super::resample::Resampled;
use super::view::Seeing;
use crate::conventions::Rgb;
use crate::photo::exr_file::{
    self, EnvironmentMap, ExrAttributes, ExrPicture, ExrSamples, LINEAR_REC709,
};
use crate::photo::radiance_hdr::{self, Mantissa};
use crate::photo::{Image, PhotoError};

/// Where a panorama comes from, for its file.
#[derive(Clone, Debug, Default)]
pub struct Origin {
    /// The files it was made from, as they were named.
    pub sources: Vec<String>,
    /// What a value of 1 means.
    pub unit: Option<String>,
    /// Degrees about X, then Y, then Z by which it was turned.
    pub rotation_deg: Option<[f64; 3]>,
    /// Where the light was measured, world, metres.
    pub place_m: DVec3,
    /// Through what it was seen, for merging it with others.
    pub seen_through: Option<Seeing>,
}

/// A further layer of one channel.
#[derive(Clone, Debug)]
pub struct Layer {
    /// Full channel name: `quality.Y`.
    pub name: &'static str,
    pub samples: Image<f32>,
}

impl Layer {
    /// The part of `size` texels whose first one is `first`.
    pub fn part(&self, first: (usize, usize), size: (usize, usize)) -> Self {
        let samples =
            Image::from_fn(size.0, size.1, |x, y| self.samples[(first.0 + x, first.1 + y)]);
        Self { name: self.name, samples }
    }
}

/// Writes a picture of directions as EXR with its variance, validity and coverage.
///
/// `comments` says as JSON what the picture shows where, its unit and [`Origin`].
///
/// # Errors
/// The disk.
pub fn write_exr(
    path: &Path,
    pictured: &Resampled,
    layout: Layout,
    origin: &Origin,
) -> Result<(), PhotoError> {
    write_exr_with(path, pictured, layout, origin, &[])
}

/// As [`write_exr`], with further layers.
///
/// # Errors
/// A layer of another size, or the disk.
pub fn write_exr_with(
    path: &Path,
    pictured: &Resampled,
    layout: Layout,
    origin: &Origin,
    layers: &[Layer],
) -> Result<(), PhotoError> {
    let light = &pictured.light;
    let mut picture = ExrPicture {
        width: light.mean.width(),
        height: light.mean.height(),
        channels: Vec::new(),
        attributes: ExrAttributes {
            comments: Some(comments(layout, origin)),
            colour_id: Some(LINEAR_REC709),
            environment: environment(layout),
            ..ExrAttributes::default()
        },
    };
    for (layer, image) in [("", &light.mean), ("variance.", &light.variance)] {
        for (channel, name) in ["R", "G", "B"].into_iter().enumerate() {
            // Float: the sun does not fit a half.
            let samples = image.pixels().iter().map(|l| l[channel]).collect();
            picture.push(format!("{layer}{name}"), ExrSamples::F32(samples));
        }
    }
    let classes = light.validity.pixels().iter().map(|&v| u32::from(v as u8)).collect();
    picture.push("validity.Y", ExrSamples::U32(classes));
    picture.push("coverage.Y", ExrSamples::F32(pictured.coverage.pixels().to_vec()));
    for layer in layers {
        picture.push(layer.name, ExrSamples::F32(layer.samples.pixels().to_vec()));
    }
    exr_file::write(path, &picture)
}

/// Writes a lat-long of light alone in OpenEXR's axes; `what` says of `comments` what its values are.
///
/// # Errors
/// The disk.
pub fn write_light(path: &Path, light: &Image<Rgb>, what: &str) -> Result<(), PhotoError> {
    let layout = Layout::LatLong(Axes::OpenExr);
    let comments = serde_json::json!({ "what": what, "axes": layout.description() });
    let mut picture = ExrPicture {
        width: light.width(),
        height: light.height(),
        channels: Vec::new(),
        attributes: ExrAttributes {
            comments: Some(comments.to_string()),
            colour_id: Some(LINEAR_REC709),
            environment: environment(layout),
            ..ExrAttributes::default()
        },
    };
    for (channel, name) in ["R", "G", "B"].into_iter().enumerate() {
        let samples = light.pixels().iter().map(|l| l[channel]).collect();
        picture.push(name, ExrSamples::F32(samples));
    }
    exr_file::write(path, &picture)
}

/// Writes a picture of directions as Radiance HDR: its light alone.
///
/// # Errors
/// Light that RGBE cannot hold, or the disk.
pub fn write_hdr(path: &Path, pictured: &Resampled) -> Result<(), PhotoError> {
    radiance_hdr::write(path, &pictured.light.mean, Mantissa::Truncated)
}

fn comments(layout: Layout, origin: &Origin) -> String {
    let mut said = serde_json::json!({
        "what": layout.description(),
        "mapping": layout.name(),
        "place_m": origin.place_m.to_array(),
        "validity": "0 measured, 1 single, 2 lower bound, 3 upper bound, 4 moved, 5 filled, 6 analytic",
    });
    if !origin.sources.is_empty() {
        said["sources"] = origin.sources.clone().into();
    }
    if let Some(unit) = &origin.unit {
        said["unit"] = unit.clone().into();
    }
    if let Some(rotation) = origin.rotation_deg {
        said["rotation_deg"] = rotation.to_vec().into();
    }
    if let Some(seeing) = &origin.seen_through {
        said["seen_through"] = serde_json::json!(seeing);
    }
    said.to_string()
}

/// `envmap` promises OpenEXR's axes and faces; other pictures do without.
fn environment(layout: Layout) -> Option<EnvironmentMap> {
    match layout {
        Layout::LatLong(Axes::OpenExr) => Some(EnvironmentMap::LatLong),
        Layout::Cube(CubeLayout::Column, CubeFaces::Inside) => Some(EnvironmentMap::Cube),
        _ => None,
    }
}
