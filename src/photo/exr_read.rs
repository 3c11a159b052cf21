//! OpenEXR files → samples: one flat layer, placed in the display window.
//!
//! The header is judged before a pixel is allocated, because a few flipped bytes can ask for tens of
//! gigabytes. DWAA/DWAB are refused before anything is decompressed: their decoder trusts a length
//! in the file and a hostile one ends the process (exr 1.74, zune-inflate; no panic to catch).
//! Chunks are decompressed one by one with their own header checked against the chosen part.

use std::collections::HashSet;
use std::io::Cursor;
use std::path::Path;

use exr::block::UncompressedBlock;
use exr::block::chunk::Chunk;
use exr::block::reader::Reader;
use exr::compression::Compression;
use exr::math::Vec2;
use exr::meta::BlockDescription;
use exr::meta::attribute::{AttributeValue, SampleType};
use exr::meta::header::Header;
use half::f16;
use rayon::prelude::*;

use super::error::{MAX_SIDE, check_size, guarded};
use super::{
    Decoded, Encoding, EncodingSource, Facts, PhotoError, Primaries, ReadOptions, Samples,
    Transfer, Window,
};
use crate::conventions::FULL_FRAME_DIAGONAL_MM;

const FORMAT: &str = "EXR";

/// Memory for decompressed chunks in flight.
const CHUNKS_IN_FLIGHT_BYTES: usize = 256 << 20;

pub(super) fn decode(
    path: &Path,
    bytes: &[u8],
    options: &ReadOptions,
) -> Result<Decoded, PhotoError> {
    guarded(path, FORMAT, || {
        let damaged = |e: exr::error::Error| match e {
            exr::error::Error::NotSupported(what) => {
                let remedy = "write it as flat RGB with ZIP or PIZ compression";
                PhotoError::unsupported(path, what.trim_end_matches(" not supported yet"), remedy)
            }
            other => PhotoError::damaged(path, FORMAT, other),
        };
        let reader = exr::block::read(Cursor::new(bytes), false).map_err(damaged)?;
        let headers = reader.headers();
        for header in headers {
            check_window(path, header)?;
        }
        let picture = choose(path, headers, options.layer.as_deref())?;
        let header = &headers[picture.part];
        check_part(path, header, &picture, options)?;
        let encoding = match &options.colour {
            Some(named) => named.encoding(),
            None => encoding(path, header)?,
        };
        let facts = facts(header);
        let (data_window, said) = data_window(header);
        let remarks =
            [said, other_parts(headers, &picture, options)].into_iter().flatten().collect();

        let display = header.shared_attributes.display_window;
        let (width, height) = (display.size.width(), display.size.height());
        let all_half = picture
            .channels
            .iter()
            .all(|&c| header.channels.list[c].sample_type == SampleType::F16);
        let channels = picture.channels.len();
        let samples = if all_half {
            let data = read_samples(path, reader, &picture, |_, raw| {
                f16::from_ne_bytes([raw[0], raw[1]])
            })?;
            Samples::F16 { channels, data }
        } else {
            let data = read_samples(path, reader, &picture, |kind, raw| match kind {
                SampleType::F16 => f16::from_ne_bytes([raw[0], raw[1]]).to_f32(),
                SampleType::F32 => f32::from_ne_bytes([raw[0], raw[1], raw[2], raw[3]]),
                SampleType::U32 => u32::from_ne_bytes([raw[0], raw[1], raw[2], raw[3]]) as f32,
            })?;
            Samples::F32 { channels, data }
        };
        Ok(Decoded { width, height, samples, facts, encoding, data_window, remarks })
    })
}

/// The text of the file's `comments` attribute, if it has one.
pub(super) fn comments(path: &Path, bytes: &[u8]) -> Result<Option<String>, PhotoError> {
    guarded(path, FORMAT, || {
        let reader = exr::block::read(Cursor::new(bytes), false)
            .map_err(|e| PhotoError::damaged(path, FORMAT, e))?;
        let text = |h: &Header| h.own_attributes.comments.as_ref().map(ToString::to_string);
        Ok(reader.headers().iter().find_map(text))
    })
}

/// The channels of a file that make up the wanted picture.
struct Picture {
    part: usize,
    /// Indices into the part's channel list: grey, or R G B, and alpha if there is one.
    channels: Vec<usize>,
}

/// Finds the main picture, or the layer that was asked for.
fn choose(path: &Path, headers: &[Header], layer: Option<&str>) -> Result<Picture, PhotoError> {
    if headers.iter().all(|h| h.deep) {
        let remedy = "flatten it first (deep to flat) and read the flat file";
        return Err(PhotoError::unsupported(path, "deep EXR", remedy));
    }
    let flat = || headers.iter().enumerate().filter(|(_, h)| !h.deep);
    let part_name = |h: &Header| h.own_attributes.layer_name.as_ref().map(ToString::to_string);
    let found = match layer {
        Some(layer) => flat().find_map(|(part, h)| {
            let of_part = part_name(h).filter(|_| headers.len() > 1).and_then(|name| {
                match layer.strip_prefix(&name) {
                    Some("") => picture_in(h, part, ""),
                    Some(rest) => picture_in(h, part, rest.strip_prefix('.')?),
                    None => None,
                }
            });
            of_part.or_else(|| picture_in(h, part, layer))
        }),
        None => flat().find_map(|(part, h)| picture_in(h, part, "")).or_else(|| {
            // No unnamed picture: take a named layer or a lone channel only if there is just one.
            let layers: Vec<_> = flat()
                .flat_map(|(part, h)| layer_names(h).into_iter().map(move |name| (part, h, name)))
                .collect();
            match layers.as_slice() {
                [(part, h, name)] => picture_in(h, *part, name).or_else(|| lone_channel(h, *part)),
                _ => None,
            }
        }),
    };
    found.ok_or_else(|| {
        let names: Vec<String> = flat()
            .flat_map(|(_, h)| h.channels.list.iter().map(|c| c.name.to_string()))
            .take(40)
            .collect();
        let wanted =
            layer.map_or("no R G B or Y main picture".into(), |l| format!("no layer {l:?}"));
        PhotoError::NoLayer { path: path.into(), wanted, channels: names.join(", ") }
    })
}

/// The part of the display window that the data window covers, if that is not all, and a word on it.
fn data_window(header: &Header) -> (Option<Window>, Option<String>) {
    let display = header.shared_attributes.display_window;
    let place = header.own_attributes.layer_position;
    // First and end of the data within the display window, along one side.
    let along = |place: i32, data: usize, display_place: i32, display: usize| {
        let first = i64::from(place) - i64::from(display_place);
        let clamp = |v: i64| v.clamp(0, display as i64) as usize;
        (clamp(first), clamp(first + data as i64))
    };
    let (data, size) = (header.layer_size, display.size);
    let (left, right) = along(place.0, data.0, display.position.0, size.0);
    let (top, bottom) = along(place.1, data.1, display.position.1, size.1);
    let window = Window { first: (left, top), size: (right - left, bottom - top) };
    if window.size == (size.0, size.1) {
        return (None, None);
    }
    let outside = size.area() - window.size.0 * window.size.1;
    let share = 100.0 * outside as f64 / size.area() as f64;
    let said = format!(
        "its data window holds {} × {} of {} × {} px; {share:.1} % of the picture are not in the file \
         and count as black and not seen",
        window.size.0, window.size.1, size.0, size.1
    );
    (Some(window), Some(said))
}

/// A word on parts that hold a main picture too, where nobody said which one is meant.
fn other_parts(headers: &[Header], picture: &Picture, options: &ReadOptions) -> Option<String> {
    let is_picture = |(part, h): &(usize, &Header)| !h.deep && picture_in(h, *part, "").is_some();
    let others = headers.iter().enumerate().filter(is_picture).count();
    if options.layer.is_some() || others < 2 {
        return None;
    }
    let name = headers[picture.part].own_attributes.layer_name.as_ref();
    let name = name.map_or(String::new(), |name| format!(" ({:?})", name.to_string()));
    Some(format!(
        "holds {others} pictures in {} parts; part {}{name} is taken, the others are left out",
        headers.len(),
        picture.part + 1
    ))
}

/// The text before the last dot of every channel name, each once.
fn layer_names(header: &Header) -> Vec<String> {
    let mut names: Vec<String> = Vec::new();
    for channel in &header.channels.list {
        let name = channel.name.to_string();
        let layer = name.rsplit_once('.').map_or("", |(layer, _)| layer).to_string();
        if !names.contains(&layer) {
            names.push(layer);
        }
    }
    names
}

/// R G B (A), Y (A) or X Y Z channels directly in `layer`.
fn picture_in(header: &Header, part: usize, layer: &str) -> Option<Picture> {
    let find = |suffix: &str| {
        let name = if layer.is_empty() { suffix.into() } else { format!("{layer}.{suffix}") };
        header.channels.list.iter().position(|c| c.name.eq_case_insensitive(&name))
    };
    let mut channels = match (find("R"), find("G"), find("B")) {
        (Some(r), Some(g), Some(b)) => vec![r, g, b],
        // A vector layer (N.X, N.Y, N.Z) can be looked at when it is asked for.
        _ => match (find("X"), find("Y"), find("Z")) {
            (Some(x), Some(y), Some(z)) if !layer.is_empty() => vec![x, y, z],
            _ => vec![find("Y")?],
        },
    };
    channels.extend(find("A"));
    Some(Picture { part, channels })
}

fn lone_channel(header: &Header, part: usize) -> Option<Picture> {
    (header.channels.list.len() == 1).then(|| Picture { part, channels: vec![0] })
}

/// Refuses windows no later sum could overflow on.
fn check_window(path: &Path, header: &Header) -> Result<(), PhotoError> {
    let size = header.layer_size;
    let far = |v: i32| v.unsigned_abs() > 1 << 24;
    let tiles_too_large = match header.blocks {
        BlockDescription::Tiles(tiles) => {
            tiles.tile_size.width() as u64 > MAX_SIDE || tiles.tile_size.height() as u64 > MAX_SIDE
        }
        BlockDescription::ScanLines => false,
    };
    let place = header.own_attributes.layer_position;
    let display = header.shared_attributes.display_window.position;
    if tiles_too_large || [place.0, place.1, display.0, display.1].into_iter().any(far) {
        return Err(PhotoError::damaged(path, FORMAT, "absurd data window or tile size"));
    }
    check_size(path, (size.width() as u64, size.height() as u64), 1, u64::MAX)
}

/// Refuses what would be decompressed wrongly, dangerously or at too great a size.
fn check_part(
    path: &Path,
    header: &Header,
    picture: &Picture,
    options: &ReadOptions,
) -> Result<(), PhotoError> {
    if matches!(header.compression, Compression::DWAA(_) | Compression::DWAB(_)) {
        let remedy = "its decoder can be crashed by a damaged file; write the file with ZIP or PIZ";
        return Err(PhotoError::unsupported(path, "DWAA/DWAB compression", remedy));
    }
    if header.channels.list.iter().any(|c| c.sampling != Vec2(1, 1)) {
        let remedy = "write the file as RGB without chroma subsampling";
        return Err(PhotoError::unsupported(path, "luminance-chroma with subsampling", remedy));
    }
    let aspect = header.shared_attributes.pixel_aspect;
    if aspect.is_nan() || (aspect - 1.0).abs() > 1e-3 {
        let found = format!("pixel aspect ratio {aspect}");
        return Err(PhotoError::unsupported(path, found, "resample it to square pixels"));
    }
    let has = |name: &str| header.channels.list.iter().any(|c| c.name == *name);
    if picture.channels.len() < 3 && has("RY") && has("BY") {
        let remedy = "write the file as RGB";
        return Err(PhotoError::unsupported(path, "luminance-chroma", remedy));
    }
    let display = header.shared_attributes.display_window.size;
    let bytes = 4 * picture.channels.len() as u64;
    check_size(path, (display.width() as u64, display.height() as u64), bytes, options.max_bytes)?;
    let size = header.layer_size;
    let bytes = header.channels.list.len() as u64 * 4;
    check_size(path, (size.width() as u64, size.height() as u64), bytes, options.max_bytes)
}

/// Decompresses the part's largest level into interleaved samples of the display window.
fn read_samples<T: Copy + Default>(
    path: &Path,
    reader: Reader<Cursor<&[u8]>>,
    picture: &Picture,
    sample: impl Fn(SampleType, &[u8]) -> T,
) -> Result<Vec<T>, PhotoError> {
    let damaged = |e: exr::error::Error| PhotoError::damaged(path, FORMAT, e);
    let meta = reader.meta_data().clone();
    let header = &meta.headers[picture.part];
    let part = picture.part;
    let mut chunks = reader
        .filter_chunks(false, |_, _, block| block.layer == part && block.level == Vec2(0, 0))
        .map_err(damaged)?;

    let mut canvas = Canvas::new(header, picture);
    let in_flight = (CHUNKS_IN_FLIGHT_BYTES / header.max_block_byte_size().max(1)).clamp(1, 64);
    loop {
        let batch: Vec<Chunk> =
            chunks.by_ref().take(in_flight).collect::<Result<_, _>>().map_err(damaged)?;
        if batch.is_empty() {
            break;
        }
        // A chunk says itself to which part it belongs: another part may be DWA or deep.
        if batch.iter().any(|chunk| chunk.layer_index != part) {
            return Err(PhotoError::damaged(path, FORMAT, "a chunk belongs to another part"));
        }
        let blocks: Vec<UncompressedBlock> = batch
            .into_par_iter()
            .map(|chunk| UncompressedBlock::decompress_chunk(chunk, &meta, false))
            .collect::<Result<_, _>>()
            .map_err(damaged)?;
        for block in &blocks {
            canvas.paste(block, header, &sample);
        }
    }
    if canvas.pasted_pixels != header.layer_size.area() {
        return Err(PhotoError::damaged(path, FORMAT, "blocks of pixels are missing"));
    }
    Ok(canvas.data)
}

/// The display window being filled.
struct Canvas<T> {
    data: Vec<T>,
    width: usize,
    height: usize,
    /// Column and row of the data window's corner in the display window; may be negative.
    offset: (i64, i64),
    /// Place of each file channel in a pixel of `data`.
    slots: Vec<Option<usize>>,
    channels: usize,
    seen: HashSet<(usize, usize)>,
    pasted_pixels: usize,
}

impl<T: Copy + Default> Canvas<T> {
    fn new(header: &Header, picture: &Picture) -> Self {
        let display = header.shared_attributes.display_window;
        let place = header.own_attributes.layer_position;
        let (width, height) = (display.size.width(), display.size.height());
        let channels = picture.channels.len();
        let slots = (0..header.channels.list.len())
            .map(|c| picture.channels.iter().position(|&p| p == c))
            .collect();
        Self {
            data: vec![T::default(); width * height * channels],
            width,
            height,
            offset: (
                i64::from(place.0) - i64::from(display.position.0),
                i64::from(place.1) - i64::from(display.position.1),
            ),
            slots,
            channels,
            seen: HashSet::new(),
            pasted_pixels: 0,
        }
    }

    fn paste(
        &mut self,
        block: &UncompressedBlock,
        header: &Header,
        sample: &impl Fn(SampleType, &[u8]) -> T,
    ) {
        let corner = block.index.pixel_position;
        if block.index.level != Vec2(0, 0) || !self.seen.insert((corner.0, corner.1)) {
            return;
        }
        self.pasted_pixels += block.index.pixel_size.area();
        for line in block.lines(&header.channels) {
            let Some(slot) = self.slots[line.location.channel] else { continue };
            let kind = header.channels.list[line.location.channel].sample_type;
            let y = line.location.position.1 as i64 + self.offset.1;
            if y < 0 || y >= self.height as i64 {
                continue;
            }
            let start = line.location.position.0 as i64 + self.offset.0;
            let row = y as usize * self.width;
            for (i, raw) in line.value.chunks_exact(kind.bytes_per_sample()).enumerate() {
                let x = start + i as i64;
                if (0..self.width as i64).contains(&x) {
                    self.data[(row + x as usize) * self.channels + slot] = sample(kind, raw);
                }
            }
        }
    }
}

/// What the header says of colour: ACES container, interop ID, chromaticities, else linear Rec.709.
fn encoding(path: &Path, header: &Header) -> Result<Encoding, PhotoError> {
    let attribute = |name: &str| {
        let of = |map: &std::collections::HashMap<_, AttributeValue>| {
            map.get(&exr::meta::attribute::Text::from(name)).cloned()
        };
        of(&header.own_attributes.other).or_else(|| of(&header.shared_attributes.other))
    };
    let linear = |primaries, source| Encoding { transfer: Transfer::Linear, primaries, source };
    if let Some(AttributeValue::I32(1)) = attribute("acesImageContainerFlag") {
        return Ok(linear(Primaries::Aces2065, EncodingSource::Header));
    }
    if let Some(AttributeValue::Text(id)) = attribute("colorInteropID") {
        let known = match id.to_string().as_str() {
            "lin_rec709_scene" | "lin_rec709_display" => {
                Some((Transfer::Linear, Primaries::Rec709))
            }
            "lin_p3d65_scene" => Some((Transfer::Linear, Primaries::DisplayP3)),
            "lin_adobergb_scene" => Some((Transfer::Linear, Primaries::AdobeRgb)),
            "lin_ap1_scene" => Some((Transfer::Linear, Primaries::AcesCg)),
            "lin_ap0_scene" => Some((Transfer::Linear, Primaries::Aces2065)),
            "srgb_rec709_scene" => Some((Transfer::Srgb, Primaries::Rec709)),
            "data" | "unknown" => None,
            other => {
                let found = format!("colorInteropID {other:?} is not known");
                return Err(PhotoError::UnknownColour { path: path.into(), found });
            }
        };
        if let Some((transfer, primaries)) = known {
            return Ok(Encoding { transfer, primaries, source: EncodingSource::Header });
        }
    }
    Ok(match header.shared_attributes.chromaticities {
        Some(c) => linear(
            Primaries::recognise([
                c.red.0, c.red.1, c.green.0, c.green.1, c.blue.0, c.blue.1, c.white.0, c.white.1,
            ]),
            EncodingSource::Header,
        ),
        None => linear(Primaries::Rec709, EncodingSource::FormatRule),
    })
}

fn facts(header: &Header) -> Facts {
    let own = &header.own_attributes;
    let other = |name: &str| {
        let name = exr::meta::attribute::Text::from(name);
        own.other.get(&name).or_else(|| header.shared_attributes.other.get(&name))
    };
    let text = |name| match other(name) {
        Some(AttributeValue::Text(text)) => Some(text.to_string()),
        _ => None,
    };
    let number = |name| match other(name) {
        Some(AttributeValue::F32(value)) => positive(*value),
        _ => None,
    };
    let positive_attribute = |value: Option<f32>| value.and_then(positive);
    Facts {
        exposure_s: positive_attribute(own.exposure),
        f_number: positive_attribute(own.aperture),
        iso: positive_attribute(own.iso_speed),
        focal_mm: number("pinholeFocalLength").or_else(|| number("nominalFocalLength")),
        focal_35mm: positive_attribute(own.horizontal_field_of_view)
            .and_then(|fov| focal_35mm(fov, header.shared_attributes.display_window.size)),
        orientation: 1,
        make: text("cameraMake"),
        model: text("cameraModel"),
        lens_model: text("lensModel"),
    }
}

/// The 35-mm equivalent, by the diagonal, of a picture that is `fov_deg` wide.
fn focal_35mm(fov_deg: f64, size: Vec2<usize>) -> Option<f64> {
    let (w, h) = (size.width() as f64, size.height() as f64);
    let focal_per_width = 0.5 / (0.5 * fov_deg.to_radians()).tan();
    let focal = focal_per_width * FULL_FRAME_DIAGONAL_MM * w / w.hypot(h);
    (fov_deg < 180.0 && focal.is_finite()).then_some(focal)
}

fn positive(value: f32) -> Option<f64> {
    (value.is_finite() && value > 0.0).then_some(f64::from(value))
}
