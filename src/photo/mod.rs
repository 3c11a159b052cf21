//! Pictures on disk ↔ pictures in scene-linear light.
//!
//! file → [`Photo`]: scene-linear Rec.709 f32, facts from EXIF, and the file's own samples, so that
//! what is not changed can be written back bit for bit. Start with [`Photo`] and [`Image`].
//! This room never guesses a colour space silently and never trusts a size it reads.

pub mod atomic;
pub mod bytes;
pub mod colour;
mod cut_out;
mod encoded;
mod error;
mod exif;
pub mod exr_file;
mod exr_read;
#[cfg(test)]
mod exr_tests;
mod icc;
pub mod image;
mod linear;
pub mod png;
pub mod radiance_hdr;
mod raster;
#[cfg(test)]
mod tests;
pub mod text;
pub mod tiff;
pub mod tone;
mod tone_curve;
mod ward;

pub use self::colour::NamedColour;
pub use self::encoded::{Decoder, Encoded, Measured, RUN_PX, Run};
pub use self::error::PhotoError;
pub use self::image::Image;
pub use self::radiance_hdr::Mantissa;
pub use self::tone_curve::ToneCurve;

use std::path::{Path, PathBuf};

use self::bytes::BytesError;
use crate::conventions::Rgb;

/// A photograph or rendered picture, upright, in scene-linear light.
#[derive(Clone, Debug)]
pub struct Photo {
    /// Where it was read.
    pub path: PathBuf,
    pub format: Format,
    /// Scene-linear Rec.709 of the display window, EXIF orientation applied.
    pub linear: Image<Rgb>,
    /// Coverage 0…1, if the file has one. `linear` stays as the file has it: premultiplied in EXR,
    /// straight in PNG and TIFF.
    pub alpha: Option<Image<f32>>,
    /// True where a channel is at or above the level at which this file clips: 250 of 255, 0.98 of
    /// 65535, the largest half; a float file never clips.
    pub clipped: Image<bool>,
    /// Samples that were NaN or infinite; `linear` has 0 there.
    pub nonfinite: Option<NonFinite>,
    /// The data window of an EXR within its display window, where it does not cover all of it;
    /// `linear` is 0 outside.
    pub data_window: Option<Window>,
    /// What a person should know of how the file was read, each a sentence without its name.
    pub remarks: Vec<String>,
    /// What the camera wrote beside the picture.
    pub facts: Facts,
    /// How the file's samples stand for light.
    pub encoding: Encoding,
    /// The file's own samples, upright, same size as `linear`.
    pub samples: Samples,
}

/// The kind of file a picture was read from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    Exr,
    RadianceHdr,
    Png,
    Tiff,
    Jpeg,
    /// Made in memory.
    None,
}

/// NaN or infinite samples found in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NonFinite {
    /// Pixels with at least one such sample.
    pub pixels: u64,
    /// Column and row of the first, row by row.
    pub first: (usize, usize),
}

/// A rectangle of a picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Window {
    /// Column and row of its first pixel.
    pub first: (usize, usize),
    /// Columns and rows; may be 0.
    pub size: (usize, usize),
}

impl Window {
    /// All of a picture.
    pub fn whole(width: usize, height: usize) -> Self {
        Self { first: (0, 0), size: (width, height) }
    }

    pub fn n_pixels(&self) -> usize {
        self.size.0 * self.size.1
    }

    /// Column and row in the picture of the window's `k`-th pixel, row by row.
    pub fn pixel(&self, k: usize) -> (usize, usize) {
        (self.first.0 + k % self.size.0, self.first.1 + k / self.size.0)
    }

    /// Place in the window, column and row, of a pixel of the picture; `None` outside.
    pub fn inside(&self, at: (usize, usize)) -> Option<(usize, usize)> {
        self.contains(at).then(|| (at.0 - self.first.0, at.1 - self.first.1))
    }

    pub fn contains(&self, (x, y): (usize, usize)) -> bool {
        let inside = |at: usize, first: usize, n: usize| (first..first + n).contains(&at);
        inside(x, self.first.0, self.size.0) && inside(y, self.first.1, self.size.1)
    }
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
#[derive(Clone, Debug, PartialEq)]
pub enum Transfer {
    /// Numbers are proportional to light.
    Linear,
    /// The exact sRGB curve (IEC 61966-2-1).
    Srgb,
    /// A pure power, exponent in hundredths: 220 = 2.2 (Adobe RGB).
    Gamma(u16),
    /// The camera's own, recovered from its photographs.
    Measured(ToneCurve),
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
#[derive(Clone, Debug, PartialEq)]
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
    /// An embedded ICC profile, or a PNG's own chunk.
    Profile,
    /// EXIF's colour space: 1 is sRGB, "R03" Adobe RGB.
    Exif,
    /// The user named it.
    Named,
    /// The documented rule for the format (8-bit files are sRGB, EXR and HDR are linear Rec.709).
    FormatRule,
}

/// "sRGB curve, Rec.709 primaries (EXIF)".
impl std::fmt::Display for Encoding {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        match &self.transfer {
            Transfer::Linear => f.write_str("linear")?,
            Transfer::Srgb => f.write_str("sRGB curve")?,
            Transfer::Gamma(hundredths) => write!(f, "gamma {}", f64::from(*hundredths) / 100.0)?,
            Transfer::Measured(_) => f.write_str("the camera's own curve, from the bracket")?,
        }
        let primaries = match self.primaries {
            Primaries::Rec709 => "Rec.709",
            Primaries::DisplayP3 => "Display P3",
            Primaries::AdobeRgb => "Adobe RGB",
            Primaries::AcesCg => "ACEScg",
            Primaries::Aces2065 => "ACES2065-1",
            Primaries::Custom(_) => "the file's own",
        };
        let source = match self.source {
            EncodingSource::Header => "the file's header",
            EncodingSource::Profile => "the file's colour profile",
            EncodingSource::Exif => "EXIF",
            EncodingSource::Named => "as asked for",
            EncodingSource::FormatRule => "not stated, the rule for this kind of file",
        };
        write!(f, ", {primaries} primaries ({source})")
    }
}

/// A file's own samples: interleaved channels, row-major, upright.
#[derive(Clone, Debug, PartialEq)]
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

impl Samples {
    /// Interleaved channels of a pixel: 1 grey, 2 grey and alpha, 3 RGB, 4 RGBA.
    pub fn channels(&self) -> usize {
        match self {
            Self::U8 { channels, .. }
            | Self::U16 { channels, .. }
            | Self::F16 { channels, .. }
            | Self::F32 { channels, .. } => *channels,
        }
    }

    /// Number of samples: channels times pixels.
    fn len(&self) -> usize {
        match self {
            Self::U8 { data, .. } => data.len(),
            Self::U16 { data, .. } => data.len(),
            Self::F16 { data, .. } => data.len(),
            Self::F32 { data, .. } => data.len(),
        }
    }
}

impl Photo {
    /// A picture that comes from no file: float, linear Rec.709, nothing clipped.
    pub fn from_linear(linear: Image<Rgb>) -> Self {
        let data = linear.pixels().iter().flat_map(|l| l.to_array()).collect();
        Self {
            path: PathBuf::new(),
            format: Format::None,
            alpha: None,
            clipped: linear.map(|_| false),
            nonfinite: None,
            data_window: None,
            remarks: Vec::new(),
            facts: Facts::default(),
            encoding: Encoding {
                transfer: Transfer::Linear,
                primaries: Primaries::Rec709,
                source: EncodingSource::Named,
            },
            samples: Samples::F32 { channels: 3, data },
            linear,
        }
    }

    /// The remarks, each with the file's name before it.
    pub fn named_remarks(&self) -> impl Iterator<Item = String> + '_ {
        self.remarks.iter().map(|remark| format!("{}: {remark}", self.path.display()))
    }

    /// Smallest relative change of light that the file can show: half a code at white, where codes
    /// are finest. 0 for floats.
    pub fn least_step(&self) -> f32 {
        let codes = match self.samples {
            Samples::U8 { .. } => 255.0,
            Samples::U16 { .. } => 65_535.0,
            Samples::F16 { .. } | Samples::F32 { .. } => return 0.0,
        };
        let transfer = &self.encoding.transfer;
        1.0 - transfer.decode(1.0 - 0.5 / codes) / transfer.decode(1.0)
    }

    /// The picture as its file holds it, without its light.
    pub fn encoded(&self) -> Encoded {
        Encoded {
            path: self.path.clone(),
            format: self.format,
            width: self.linear.width(),
            height: self.linear.height(),
            nonfinite: self.nonfinite,
            data_window: self.data_window,
            remarks: self.remarks.clone(),
            facts: self.facts.clone(),
            encoding: self.encoding.clone(),
            samples: self.samples.clone(),
        }
    }

    /// The same file read through another curve, its primaries kept.
    pub fn redecoded(&self, transfer: Transfer) -> Self {
        let mut file = self.encoded();
        file.encoding.transfer = transfer;
        file.encoding.source = EncodingSource::Named;
        file.into()
    }
}

/// What a reader may be told beside the file.
#[derive(Clone, Debug)]
pub struct ReadOptions {
    /// The file's colour space as named by the user; `None` lets the file or its format's rule say.
    pub colour: Option<NamedColour>,
    /// The EXR layer (or part) to read; `None` takes the unnamed main picture.
    pub layer: Option<String>,
    /// How the writer of a Radiance `.hdr` made its mantissas.
    pub mantissa: Mantissa,
    /// Refuse pictures that need more than this many bytes: their own samples, and 13 a pixel for
    /// linear light and clipping. The file's bytes are held beside them while it is read, and 4 a
    /// pixel where there is an alpha.
    pub max_bytes: u64,
}

impl Default for ReadOptions {
    /// Colour as the file says, main picture, truncated mantissas, 4 GiB.
    fn default() -> Self {
        Self { colour: None, layer: None, mantissa: Mantissa::Truncated, max_bytes: 4 << 30 }
    }
}

/// What a format's decoder hands over: upright samples and what the file says of them.
struct Decoded {
    width: usize,
    height: usize,
    samples: Samples,
    facts: Facts,
    encoding: Encoding,
    data_window: Option<Window>,
    remarks: Vec<String>,
}

/// Reads a picture: EXR, Radiance HDR, PNG, TIFF or JPEG, told by its first bytes.
///
/// # Errors
/// Anything unreadable, damaged, too large or of unknown colour, with file, cause and remedy.
/// No content of a file panics or allocates much more than [`ReadOptions::max_bytes`].
pub fn read(path: &Path, options: &ReadOptions) -> Result<Photo, PhotoError> {
    read_encoded(path, options).map(Photo::from)
}

/// Reads a picture as [`read`] does and leaves it in its file's own samples.
///
/// # Errors
/// As [`read`].
pub fn read_encoded(path: &Path, options: &ReadOptions) -> Result<Encoded, PhotoError> {
    encoded(path, &file_bytes(path, options)?, options)
}

fn file_bytes(path: &Path, options: &ReadOptions) -> Result<Vec<u8>, PhotoError> {
    bytes::read(path, options.max_bytes).map_err(|error| match error {
        BytesError::Read(source) => PhotoError::Read { path: path.into(), source },
        BytesError::TooLarge { bytes, limit } => {
            PhotoError::TooLarge { path: path.into(), what: "the file".into(), bytes, limit }
        }
    })
}

/// The text of an EXR file's `comments` attribute; `None` for other formats and files without it.
///
/// # Errors
/// As [`read`].
pub fn read_comments(path: &Path) -> Result<Option<String>, PhotoError> {
    let bytes = file_bytes(path, &ReadOptions::default())?;
    match bytes.as_slice() {
        [0x76, 0x2f, 0x31, 0x01, ..] => exr_read::comments(path, &bytes),
        _ => Ok(None),
    }
}

/// The camera's facts of a picture and its stored width and height, without reading its pixels.
///
/// # Errors
/// A file that cannot be opened, or is no picture.
pub fn peek(path: &Path) -> Result<(Facts, (u32, u32)), PhotoError> {
    let unreadable = |source| PhotoError::Read { path: path.into(), source };
    let file = std::fs::File::open(path).map_err(unreadable)?;
    let facts = exif::of_container(std::io::BufReader::new(file));
    let reader = ::image::ImageReader::open(path).and_then(|reader| reader.with_guessed_format());
    match reader.map_err(unreadable)?.into_dimensions() {
        Ok(size) => Ok((facts, size)),
        Err(error) => Err(PhotoError::Picture { path: path.into(), cause: error.to_string() }),
    }
}

/// Reads a layer of an EXR file; `None` if the file has none of that name.
///
/// # Errors
/// As [`read`]: a layer that is there but damaged is no missing layer.
pub fn read_layer(path: &Path, layer: &str) -> Result<Option<Photo>, PhotoError> {
    match read(path, &ReadOptions { layer: Some(layer.into()), ..ReadOptions::default() }) {
        Ok(photo) => Ok(Some(photo)),
        Err(PhotoError::NoLayer { .. }) => Ok(None),
        Err(error) => Err(error),
    }
}

/// Reads a picture from a file's bytes; `path` only names it in messages.
pub fn read_bytes(path: &Path, bytes: &[u8], options: &ReadOptions) -> Result<Photo, PhotoError> {
    encoded(path, bytes, options).map(Photo::from)
}

fn encoded(path: &Path, bytes: &[u8], options: &ReadOptions) -> Result<Encoded, PhotoError> {
    let (format, decoded) = match bytes {
        [0x76, 0x2f, 0x31, 0x01, ..] => (Format::Exr, exr_read::decode(path, bytes, options)),
        [b'#', b'?', ..] => (Format::RadianceHdr, radiance_hdr::decode(path, bytes, options)),
        [0x89, b'P', b'N', b'G', ..] => (Format::Png, raster::decode_png(path, bytes, options)),
        [b'I', b'I', 42 | 43, 0, ..] | [b'M', b'M', 0, 42 | 43, ..] => {
            (Format::Tiff, raster::decode_tiff(path, bytes, options))
        }
        [0xff, 0xd8, ..] => (Format::Jpeg, raster::decode_jpeg(path, bytes, options)),
        _ => return Err(not_a_picture(path, bytes)),
    };
    if let (Some(layer), true) = (&options.layer, format != Format::Exr) {
        let cause = format!("has no layer {layer:?}; only EXR files have layers");
        return Err(PhotoError::Picture { path: path.into(), cause });
    }
    Encoded::new(path, format, decoded?)
}

fn not_a_picture(path: &Path, bytes: &[u8]) -> PhotoError {
    let (found, hint) = match bytes {
        [] => ("is empty", ""),
        [b'v', b'e', b'r', b's', b'i', b'o', b'n', ..] => {
            ("is a Git LFS pointer, not a picture", "; fetch it with `git lfs pull`")
        }
        [b'B', b'M', ..] | [b'G', b'I', b'F', b'8', ..] => ("is BMP or GIF", "; convert to PNG"),
        [b'R', b'I', b'F', b'F', ..] => ("is WebP or another RIFF file", "; convert to PNG"),
        [_, _, _, _, b'f', b't', b'y', b'p', ..] => {
            ("is HEIC, AVIF, CR3 or another ISO media file", "; export to TIFF, EXR or JPEG")
        }
        _ => (
            "is not a picture in a known format",
            "; develop camera raw to 16-bit TIFF or EXR first",
        ),
    };
    PhotoError::NotAPicture { path: path.into(), found: found.into(), hint }
}
