//! OpenEXR files written: one part, scanlines, ZIP, any mix of half, float and integer channels.
//!
//! [`ExrPicture`] → file. Channels are sorted as the format demands; a layer is the text before a
//! channel name's last dot. The same picture gives the same bytes on any number of threads: chunks
//! are compressed in order and there is at most one attribute outside the crate's own list in each of
//! the header's two parts (those live in randomly seeded maps). Lossy compressions are never written.

use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use exr::block::writer::ChunksWriter;
use exr::block::{BlockIndex, UncompressedBlock};
use exr::compression::Compression;
use exr::math::Vec2;
use exr::meta::BlockDescription;
use exr::meta::attribute::{
    AttributeValue, ChannelDescription, Chromaticities, LineOrder, SampleType, Text,
};
use exr::meta::header::{Header, ImageAttributes, LayerAttributes};
use half::f16;
use rayon::prelude::*;

use super::error::MAX_SIDE;
use super::{Facts, PhotoError, Primaries, Window, atomic};
use crate::conventions::FULL_FRAME_DIAGONAL_MM;

/// A picture to be written as EXR.
#[derive(Clone, Debug, Default)]
pub struct ExrPicture {
    pub width: usize,
    pub height: usize,
    pub channels: Vec<ExrChannel>,
    pub attributes: ExrAttributes,
}

/// One channel: its full name (`R`, `difference.R`, `Z`) and a sample for every pixel, row by row.
#[derive(Clone, Debug)]
pub struct ExrChannel {
    pub name: String,
    pub samples: ExrSamples,
    /// The part of the picture that `samples` are of, and the value elsewhere; `None`: they are of all of
    /// it.
    pub part: Option<(Window, f32)>,
}

/// The samples of a channel in the type they are stored in.
#[derive(Clone, Debug, PartialEq)]
pub enum ExrSamples {
    F16(Vec<f16>),
    F32(Vec<f32>),
    U32(Vec<u32>),
}

/// What is said of the picture beside its pixels.
#[derive(Clone, Debug, Default)]
pub struct ExrAttributes {
    /// `comments`: JSON text with everything that has no attribute of its own.
    pub comments: Option<String>,
    /// `colorInteropID`, e.g. [`LINEAR_REC709`].
    pub colour_id: Option<&'static str>,
    /// `chromaticities`, for older tools. Not together with `colour_id` (ASWF recommendation).
    pub chromaticities: Option<Primaries>,
    /// `envmap`: the picture is of all directions.
    pub environment: Option<EnvironmentMap>,
    /// `worldToCamera`: OpenEXR's left-handed camera (+Z into the scene), row vectors.
    pub world_to_camera: Option<[f32; 16]>,
    /// `expTime`, `aperture`, `isoSpeed`, `nominalFocalLength` (mm) and `fieldOfViewHorizontal` (°, from
    /// the 35-mm equivalent) from these facts.
    pub facts: Option<Facts>,
}

/// A picture of all directions in OpenEXR's axes (ImfEnvmap.h).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EnvironmentMap {
    LatLong,
    /// Six faces below each other: +X −X +Y −Y +Z −Z.
    Cube,
}

/// `colorInteropID` of scene-linear Rec.709.
pub const LINEAR_REC709: &str = "lin_rec709_scene";

impl ExrSamples {
    /// Rounds to half floats. Light beyond ±65504, the largest half, is clamped to it instead of
    /// becoming infinite; the number of clamped samples is returned.
    pub fn half(values: impl IntoIterator<Item = f32>) -> (Self, usize) {
        let mut clamped = 0;
        let samples = values
            .into_iter()
            .map(|v| {
                let h = f16::from_f32(v);
                if h.is_infinite() {
                    clamped += 1;
                    f16::MAX.copysign(h)
                } else {
                    h
                }
            })
            .collect();
        (Self::F16(samples), clamped)
    }

    fn len(&self) -> usize {
        match self {
            Self::F16(samples) => samples.len(),
            Self::F32(samples) => samples.len(),
            Self::U32(samples) => samples.len(),
        }
    }

    fn kind(&self) -> SampleType {
        match self {
            Self::F16(_) => SampleType::F16,
            Self::F32(_) => SampleType::F32,
            Self::U32(_) => SampleType::U32,
        }
    }

    /// Copies `target`'s worth of samples from index `start` on, in native byte order.
    fn copy_bytes(&self, start: usize, target: &mut [u8]) {
        match self {
            Self::F16(samples) => copy(&samples[start..], target, |v| v.to_ne_bytes()),
            Self::F32(samples) => copy(&samples[start..], target, |v| v.to_ne_bytes()),
            Self::U32(samples) => copy(&samples[start..], target, |v| v.to_ne_bytes()),
        }
    }

    /// Fills `target` with one value in the samples' type.
    fn fill_bytes(&self, value: f32, target: &mut [u8]) {
        let fill = |target: &mut [u8], raw: &[u8]| {
            target.chunks_exact_mut(raw.len()).for_each(|sample| sample.copy_from_slice(raw));
        };
        match self {
            Self::F16(_) => fill(target, &f16::from_f32(value).to_ne_bytes()),
            Self::F32(_) => fill(target, &value.to_ne_bytes()),
            Self::U32(_) => fill(target, &(value as u32).to_ne_bytes()),
        }
    }

    fn bytes_per_sample(&self) -> usize {
        self.kind().bytes_per_sample()
    }
}

impl ExrChannel {
    /// Copies a line of the picture, of `width` px, from its left end on, in native byte order.
    fn copy_line(&self, y: usize, width: usize, target: &mut [u8]) {
        let Some((window, elsewhere)) = self.part else {
            return self.samples.copy_bytes(y * width, target);
        };
        self.samples.fill_bytes(elsewhere, target);
        if let Some((_, row)) = window.inside((window.first.0, y)) {
            let bytes = self.samples.bytes_per_sample();
            let inside = bytes * window.first.0..bytes * (window.first.0 + window.size.0);
            self.samples.copy_bytes(row * window.size.0, &mut target[inside]);
        }
    }
}

fn copy<T: Copy, const N: usize>(samples: &[T], target: &mut [u8], bytes: impl Fn(T) -> [u8; N]) {
    for (raw, &value) in target.chunks_exact_mut(N).zip(samples) {
        raw.copy_from_slice(&bytes(value));
    }
}

impl ExrPicture {
    /// Adds a channel.
    pub fn push(&mut self, name: impl Into<String>, samples: ExrSamples) {
        self.channels.push(ExrChannel { name: name.into(), samples, part: None });
    }

    /// Adds a channel that is `elsewhere` outside of a window.
    pub fn push_part(
        &mut self,
        name: impl Into<String>,
        samples: ExrSamples,
        window: Window,
        elsewhere: f32,
    ) {
        let part = Some((window, elsewhere));
        self.channels.push(ExrChannel { name: name.into(), samples, part });
    }
}

/// Writes the picture; the file appears whole or not at all.
///
/// Compression ZIP (16 lines), lossless; data window = display window = the picture.
///
/// # Errors
/// A channel of the wrong length, an empty or doubled channel name, no pixels, or the disk.
pub fn write(path: &Path, picture: &ExrPicture) -> Result<(), PhotoError> {
    let header = header(path, picture)?;
    atomic::write(path, |file| {
        let mut buffered = BufWriter::new(file);
        write_chunks(&mut buffered, header, picture)?;
        buffered.flush()
    })
    .map_err(|source| PhotoError::Write { path: path.into(), source })
}

/// The file's bytes, as [`write`] would write them. `path` only names the picture in messages.
pub fn to_bytes(path: &Path, picture: &ExrPicture) -> Result<Vec<u8>, PhotoError> {
    let mut bytes = io::Cursor::new(Vec::new());
    write_chunks(&mut bytes, header(path, picture)?, picture)
        .map_err(|source| PhotoError::Write { path: path.into(), source })?;
    Ok(bytes.into_inner())
}

fn header(path: &Path, picture: &ExrPicture) -> Result<Header, PhotoError> {
    let wrong = |cause: String| PhotoError::Picture { path: PathBuf::from(path), cause };
    let (width, height) = (picture.width, picture.height);
    if width == 0 || height == 0 || width as u64 > MAX_SIDE || height as u64 > MAX_SIDE {
        return Err(wrong(format!("cannot hold {width} × {height} px")));
    }
    let mut names: Vec<&str> = picture.channels.iter().map(|c| c.name.as_str()).collect();
    names.sort_unstable();
    if let Some(pair) = names.windows(2).find(|pair| pair[0] == pair[1]) {
        return Err(wrong(format!("would hold channel {:?} twice", pair[0])));
    }
    for channel in &picture.channels {
        let window = channel.part.map_or(Window::whole(width, height), |(window, _)| window);
        let fits = |first: usize, size: usize, of: usize| first <= of && size <= of - first;
        if !fits(window.first.0, window.size.0, width)
            || !fits(window.first.1, window.size.1, height)
        {
            return Err(wrong(format!("channel {:?} reaches beyond it", channel.name)));
        }
        if channel.samples.len() != window.n_pixels() {
            let (name, n) = (&channel.name, channel.samples.len());
            let (width, height) = window.size;
            return Err(wrong(format!(
                "channel {name:?} has {n} samples for {width} × {height} px"
            )));
        }
        if channel.name.is_empty() || !channel.name.is_ascii() {
            return Err(wrong(format!("channel name {:?} is not plain ASCII", channel.name)));
        }
    }

    let channels = sorted(picture)
        .into_iter()
        .map(|c| ChannelDescription::new(c.name.as_str(), c.samples.kind(), false))
        .collect();
    let mut header = Header::new(Text::default(), (width, height), channels).with_encoding(
        Compression::ZIP16,
        BlockDescription::ScanLines,
        LineOrder::Increasing,
    );
    header.shared_attributes = shared_attributes(picture);
    header.own_attributes = own_attributes(picture);
    Ok(header)
}

fn sorted(picture: &ExrPicture) -> Vec<&ExrChannel> {
    let mut channels: Vec<&ExrChannel> = picture.channels.iter().collect();
    channels.sort_by(|a, b| a.name.cmp(&b.name));
    channels
}

fn shared_attributes(picture: &ExrPicture) -> ImageAttributes {
    let mut shared = ImageAttributes::with_size((picture.width, picture.height));
    shared.chromaticities = picture.attributes.chromaticities.map(|primaries| {
        let [rx, ry, gx, gy, bx, by, wx, wy] = primaries.chromaticities();
        Chromaticities {
            red: Vec2(rx, ry),
            green: Vec2(gx, gy),
            blue: Vec2(bx, by),
            white: Vec2(wx, wy),
        }
    });
    let focal_mm = picture.attributes.facts.as_ref().and_then(|facts| facts.focal_mm);
    if let Some(focal_mm) = focal_mm {
        // Among the shared ones because `colorInteropID` is among the others: one in each map.
        let value = AttributeValue::F32(focal_mm as f32);
        shared.other.insert("nominalFocalLength".into(), value);
    }
    shared
}

fn own_attributes(picture: &ExrPicture) -> LayerAttributes {
    let attributes = &picture.attributes;
    let mut own = LayerAttributes {
        software_name: Some(concat!("platelight ", env!("CARGO_PKG_VERSION")).into()),
        comments: attributes.comments.as_deref().map(ascii),
        environment_map: attributes.environment.map(|environment| match environment {
            EnvironmentMap::LatLong => exr::meta::attribute::EnvironmentMap::LatitudeLongitude,
            EnvironmentMap::Cube => exr::meta::attribute::EnvironmentMap::Cube,
        }),
        world_to_camera: attributes.world_to_camera,
        ..LayerAttributes::default()
    };
    if let Some(facts) = &attributes.facts {
        own.exposure = facts.exposure_s.map(|v| v as f32);
        own.aperture = facts.f_number.map(|v| v as f32);
        own.iso_speed = facts.iso.map(|v| v as f32);
        own.horizontal_field_of_view = facts.focal_35mm.map(|focal| {
            let focal_per_width = focal / FULL_FRAME_DIAGONAL_MM * diagonal_per_width(picture);
            (2.0 * (0.5 / focal_per_width).atan().to_degrees()) as f32
        });
    }
    if let Some(id) = attributes.colour_id {
        own.other.insert("colorInteropID".into(), AttributeValue::Text(id.into()));
    }
    own
}

/// The picture's diagonal ÷ its width.
fn diagonal_per_width(picture: &ExrPicture) -> f64 {
    1f64.hypot(picture.height as f64 / picture.width as f64)
}

/// EXR strings have no encoding: what is not ASCII is written as JSON writes it, `\uXXXX`.
fn ascii(text: &str) -> Text {
    let mut plain = String::with_capacity(text.len());
    for c in text.chars() {
        if c.is_ascii() {
            plain.push(c);
        } else {
            let mut units = [0u16; 2];
            for unit in c.encode_utf16(&mut units) {
                plain.push_str(&format!("\\u{unit:04x}"));
            }
        }
    }
    plain.as_str().into()
}

/// Compresses on all threads of the current pool, writes in order.
fn write_chunks<W: io::Write + io::Seek>(
    target: &mut W,
    header: Header,
    picture: &ExrPicture,
) -> io::Result<()> {
    const CHUNKS_IN_FLIGHT: usize = 64;
    let channels = sorted(picture);
    let plain = |e: exr::error::Error| match e {
        exr::error::Error::Io(e) => e,
        other => io::Error::other(other.to_string()),
    };
    exr::block::write(target, [header].into_iter().collect(), true, |meta, writer| {
        let header = &meta.headers[0];
        let blocks: Vec<_> = header.enumerate_ordered_blocks().collect();
        for batch in blocks.chunks(CHUNKS_IN_FLIGHT) {
            let chunks: Vec<_> = batch
                .par_iter()
                .map(|(_, tile)| {
                    let bounds = header.get_absolute_block_pixel_coordinates(tile.location)?;
                    let index = BlockIndex {
                        layer: 0,
                        pixel_position: bounds.position.to_usize("block position")?,
                        pixel_size: bounds.size,
                        level: Vec2(0, 0),
                    };
                    UncompressedBlock::from_lines(&header.channels, index, |line| {
                        // Blocks of scan lines are as wide as the picture.
                        let at = line.location;
                        channels[at.channel].copy_line(at.position.y(), picture.width, line.value);
                    })
                    .compress_to_chunk(&meta.headers)
                })
                .collect::<Result<_, _>>()?;
            for ((index, _), chunk) in batch.iter().zip(chunks) {
                writer.write_chunk(*index, chunk)?;
            }
        }
        Ok(())
    })
    .map_err(plain)
}
