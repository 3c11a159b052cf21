//! Pictures on disk ↔ pictures in scene-linear light.
//!
//! file → [`Photo`]: scene-linear Rec.709 f32, facts from EXIF, and the file's own samples, so that
//! what is not changed can be written back bit for bit. Start with [`Photo`] and [`Image`].
//! This room never guesses a colour space silently and never trusts a size it reads.

pub mod image;

pub use self::image::Image;

use std::path::PathBuf;

use crate::conventions::Rgb;

/// A photograph or rendered picture, upright, in scene-linear light.
#[derive(Clone, Debug)]
pub struct Photo {
    /// Where it was read.
    pub path: PathBuf,
    /// Scene-linear Rec.709 of the display window, EXIF orientation applied.
    pub linear: Image<Rgb>,
    /// Straight coverage 0…1, if the file has one.
    pub alpha: Option<Image<f32>>,
    /// True where a channel is at or above the level at which this file clips.
    pub clipped: Image<bool>,
    /// What the camera wrote beside the picture.
    pub facts: Facts,
    /// How the file's samples stand for light.
    pub encoding: Encoding,
    /// The file's own samples, upright, same size as `linear`.
    pub samples: Samples,
}

/// Facts the camera wrote into the file (EXIF or EXR attributes); `None` where it did not.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Facts {
    pub exposure_s: Option<f64>,
    pub f_number: Option<f64>,
    pub iso: Option<f64>,
    pub focal_mm: Option<f64>,
    /// 35-mm equivalent focal length.
    pub focal_35mm: Option<f64>,
    /// EXIF orientation 1…8 as stored; the pixels of [`Photo`] are already upright.
    pub orientation: u8,
    pub make: Option<String>,
    pub model: Option<String>,
    pub lens_model: Option<String>,
}

/// How a file's numbers stand for light.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Transfer {
    /// Numbers are proportional to light.
    Linear,
    /// The exact sRGB curve (IEC 61966-2-1).
    Srgb,
    /// A pure power, exponent in hundredths: 220 = 2.2 (Adobe RGB).
    Gamma(u16),
}

/// RGB primaries and white of a file's numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Primaries {
    Rec709,
    DisplayP3,
    AdobeRgb,
    AcesCg,
    Aces2065,
    /// CIE xy of red, green, blue and white, from EXR `chromaticities`.
    Custom([f32; 8]),
}

/// A file's colour encoding and who said so.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Encoding {
    pub transfer: Transfer,
    pub primaries: Primaries,
    pub source: EncodingSource,
}

/// Where the knowledge of the encoding came from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EncodingSource {
    /// EXR attributes.
    Header,
    /// An embedded ICC profile, sRGB chunk or EXIF colour space.
    Profile,
    /// The user named it.
    Named,
    /// The documented rule for the format (8-bit files are sRGB, EXR and HDR are linear Rec.709).
    FormatRule,
}

/// A file's own samples: interleaved channels, row-major, upright.
#[derive(Clone, Debug)]
pub enum Samples {
    U8 {
        channels: usize,
        data: Vec<u8>,
    },
    U16 {
        channels: usize,
        data: Vec<u16>,
    },
    /// Half floats as in EXR, `channels` interleaved in the order R G B (A).
    F16 {
        channels: usize,
        data: Vec<half::f16>,
    },
    F32 {
        channels: usize,
        data: Vec<f32>,
    },
}
