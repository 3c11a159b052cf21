//! The files of a finished shot, each whole or not there.

use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::camera::Camera;
use crate::composite::{Composite, Encoded, NO_DEPTH, encode, exr_picture, exr_primaries};
use crate::photo::exr_file::{self, ExrAttributes, LINEAR_REC709};
use crate::photo::{
    Encoding, EncodingSource, Photo, PhotoError, Primaries, Samples, Transfer, png,
};
use crate::render::Difference;
use crate::report::Canvas;

/// Names of a shot's or frame's files: `composite.exr`, or `composite.1001.exr` in a sequence.
#[derive(Clone, Debug)]
pub struct OutFiles {
    pub folder: PathBuf,
    frame: Option<String>,
}

impl OutFiles {
    pub fn new(folder: &Path, frame: Option<i64>) -> Self {
        Self { folder: folder.to_owned(), frame: frame.map(|n| format!("{n:04}")) }
    }

    /// Whether a run may write a file of this name.
    pub fn is_result(&self, name: &str) -> bool {
        const NAMES: [(&str, &str); 7] = [
            ("composite", "exr"),
            ("composite", "png"),
            ("panorama", "exr"),
            ("camera", "json"),
            ("before", "png"),
            ("report", "json"),
            ("report", "html"),
        ];
        name.starts_with("overlay_")
            || NAMES.iter().any(|(stem, extension)| self.name(stem, extension) == name)
    }

    /// The path of `stem.extension` with the frame's number between them.
    pub fn path(&self, stem: &str, extension: &str) -> PathBuf {
        self.folder.join(self.name(stem, extension))
    }

    /// The same, without the folder.
    pub fn name(&self, stem: &str, extension: &str) -> String {
        match &self.frame {
            Some(frame) => format!("{stem}.{frame}.{extension}"),
            None => format!("{stem}.{extension}"),
        }
    }
}

/// A file as it was: enough to see whether it is still the same.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FileMark {
    pub file: PathBuf,
    pub bytes: u64,
    /// Nanoseconds since 1970; 0 where the system does not say.
    pub modified_ns: u64,
}

impl FileMark {
    /// `None` where the file is not there.
    pub fn of(path: &Path) -> Option<Self> {
        let metadata = std::fs::metadata(path).ok()?;
        let modified = metadata.modified().ok();
        let since = modified.and_then(|time| time.duration_since(std::time::UNIX_EPOCH).ok());
        Some(Self {
            file: path.to_owned(),
            bytes: metadata.len(),
            modified_ns: since.map_or(0, |since| since.as_nanos() as u64),
        })
    }
}

/// Writes the composite as a PNG in the plate's own encoding and bit depth.
///
/// Plates that no PNG can hold (EXR, HDR) become 8-bit sRGB, for the eye only.
pub fn composite_png(
    path: &Path,
    plate: &Photo,
    composite: &Composite,
    encoded: &Encoded,
) -> Result<(), PhotoError> {
    let (width, height) = (plate.linear.width(), plate.linear.height());
    match &encoded.samples {
        Samples::U8 { .. } | Samples::U16 { .. } => {
            png::write(path, &encoded.samples, width, height, &plate.encoding)
        }
        Samples::F16 { .. } | Samples::F32 { .. } => {
            let samples = png::srgb_codes(&composite.linear);
            png::write(path, &samples, width, height, &SRGB)
        }
    }
}

/// 8-bit pictures for the eye.
const SRGB: Encoding = Encoding {
    transfer: Transfer::Srgb,
    primaries: Primaries::Rec709,
    source: EncodingSource::FormatRule,
};

/// Writes a picture that was drawn on.
pub fn canvas(path: &Path, canvas: Canvas) -> Result<(), PhotoError> {
    let (width, height, samples) = canvas.into_samples();
    png::write(path, &samples, width, height, &SRGB)
}

/// Writes composite.exr: the main picture and its layers.
pub fn composite_exr(
    path: &Path,
    plate: &Photo,
    difference: &Difference,
    composite: &Composite,
    encoded: &Encoded,
    camera: &Camera,
    settings: &CompositeSettings,
) -> Result<(), PhotoError> {
    let layers = settings.layers.as_deref();
    let mut picture = exr_picture(plate, difference, composite, encoded, layers);
    let comments = serde_json::json!({
        "mode": settings.mode,
        "formula": "RGB = object.RGB + (1 - object.A) * plate + difference.RGB",
        "difference": "signed",
        "shadow": "background behind the objects = plate * shadow",
        "Z": format!("plane distance along the view axis, metres, not antialiased; {NO_DEPTH:e} where nothing is seen"),
        "stderr": "standard error of object + difference, luminance",
        "settings": settings.shot,
        "seed": settings.seed,
    });
    let primaries = exr_primaries(plate);
    picture.attributes = ExrAttributes {
        comments: Some(comments.to_string()),
        colour_id: (primaries == Primaries::Rec709).then_some(LINEAR_REC709),
        chromaticities: (primaries != Primaries::Rec709).then_some(primaries),
        environment: None,
        world_to_camera: Some(world_to_camera(camera)),
        facts: Some(plate.facts.clone()),
    };
    exr_file::write(path, &picture)
}

/// What composite.exr says of its making.
pub struct CompositeSettings {
    pub layers: Option<Vec<String>>,
    pub mode: &'static str,
    pub shot: serde_json::Value,
    pub seed: u64,
}

/// OpenEXR's `worldToCamera`: left-handed, +Z into the scene; row vectors, so columns are rows.
fn world_to_camera(camera: &Camera) -> [f32; 16] {
    let mirrored = glam::DMat3::from_diagonal(glam::DVec3::new(1.0, 1.0, -1.0));
    let inverse = camera.pose.inverse();
    let rotation = mirrored * inverse.matrix3;
    let translation = mirrored * inverse.translation;
    // p · M with p a row: M's rows are where the world's axes go, the last one the origin.
    let rows = [rotation.x_axis, rotation.y_axis, rotation.z_axis, translation];
    let mut matrix = [0.0; 16];
    for (i, row) in rows.iter().enumerate() {
        for (j, value) in row.to_array().into_iter().enumerate() {
            matrix[4 * i + j] = value as f32;
        }
        matrix[4 * i + 3] = if i == 3 { 1.0 } else { 0.0 };
    }
    matrix
}

/// The composite's samples for the plate.
pub fn encoded(plate: &Photo, composite: &Composite, difference: &Difference) -> Encoded {
    encode(plate, composite, &difference.coverage)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{Lens, Pose};
    use glam::DVec3;

    #[test]
    fn frames_stand_before_the_extension() {
        let files = OutFiles::new(Path::new("out"), Some(7));
        assert_eq!(files.path("composite", "exr"), Path::new("out/composite.0007.exr"));
        assert_eq!(OutFiles::new(Path::new("out"), None).name("a", "png"), "a.png");
    }

    #[test]
    fn exr_camera_looks_along_plus_z_in_row_vectors() {
        let pose = Pose::look_at(DVec3::new(0.0, 0.0, 5.0), DVec3::ZERO, DVec3::Y).unwrap();
        let camera = Camera { width: 4, height: 4, lens: Lens::pinhole(4.0, 4, 4), pose };
        let m = world_to_camera(&camera);
        // The world's origin is 5 m in front: row (0,0,0,1) · M = last row.
        assert_eq!(m[12..16], [0.0, 0.0, 5.0, 1.0]);
        // +X stays right, +Y up, world +Z comes toward the camera.
        assert_eq!((m[0], m[5], m[10]), (1.0, 1.0, -1.0));
    }
}
