//! PNG, TIFF and JPEG: the file's own samples, its profile, and its EXIF.
//!
//! Decoded by `image`. The colour space comes from the ICC profile or the PNG chunks, else from
//! EXIF, else from the user. Only an 8-bit file that says nothing is sRGB by rule (and a float file
//! linear); 16-bit files that say nothing are refused. EXIF orientation is applied to the samples.

use std::io::Cursor;
use std::path::Path;

use image::codecs::jpeg::JpegDecoder;
use image::codecs::png::PngDecoder;
use image::codecs::tiff::TiffDecoder;
use image::{DynamicImage, ExtendedColorType, ImageDecoder, ImageError, Limits};

use super::error::{check_size, guarded};
use super::exif::{self, ExifColour};
use super::{
    Decoded, Encoding, EncodingSource, Facts, PhotoError, Primaries, ReadOptions, Samples,
    Transfer, icc, png,
};

pub(super) fn decode_png(
    path: &Path,
    bytes: &[u8],
    options: &ReadOptions,
) -> Result<Decoded, PhotoError> {
    guarded(path, "PNG", || {
        let failed = |e| image_error(path, "PNG", e);
        if let Some(size) = png::size(bytes) {
            check_size(path, size, 1, options.max_bytes)?;
        }
        let mut decoder =
            PngDecoder::with_limits(Cursor::new(bytes), limits(options)).map_err(failed)?;
        let exif = decoder.exif_metadata().map_err(failed)?;
        // cICP stands above ICC, ICC above sRGB, gAMA and cHRM (PNG third edition, 4.3).
        // What they say is not looked at, and need not be understood, where the user names a space.
        let profile = match options.colour {
            Some(_) => None,
            None => match png::cicp_encoding(path, bytes)? {
                Some(encoding) => Some(encoding),
                None => match decoder.icc_profile().map_err(failed)? {
                    Some(icc) => Some(icc::encoding(path, &icc)?),
                    None => png::chunk_encoding(
                        bytes,
                        decoder.color_type().bits_per_pixel()
                            / u16::from(decoder.color_type().channel_count()),
                    ),
                },
            },
        };
        finish(path, options, decoder, exif.as_deref(), profile, "PNG")
    })
}

pub(super) fn decode_tiff(
    path: &Path,
    bytes: &[u8],
    options: &ReadOptions,
) -> Result<Decoded, PhotoError> {
    guarded(path, "TIFF", || {
        let failed = |e| image_error(path, "TIFF", e);
        let mut decoder = TiffDecoder::new(Cursor::new(bytes)).map_err(failed)?;
        if let ExtendedColorType::Cmyk8 | ExtendedColorType::Cmyk16 = decoder.original_color_type()
        {
            return Err(PhotoError::unsupported(path, "CMYK", "convert it to RGB"));
        }
        // Before the limits are set: image 0.25 then hides every tag larger than the pixels.
        let profile = match decoder.icc_profile().map_err(failed)? {
            Some(icc) if options.colour.is_none() => Some(icc::encoding(path, &icc)?),
            _ => None,
        };
        decoder.set_limits(limits(options)).map_err(failed)?;
        // A TIFF file is an EXIF block itself.
        finish(path, options, decoder, Some(bytes), profile, "TIFF")
    })
}

pub(super) fn decode_jpeg(
    path: &Path,
    bytes: &[u8],
    options: &ReadOptions,
) -> Result<Decoded, PhotoError> {
    guarded(path, "JPEG", || {
        let failed = |e| image_error(path, "JPEG", e);
        let frame = jpeg_frame(bytes)
            .ok_or_else(|| PhotoError::damaged(path, "JPEG", "no frame header found"))?;
        if !frame.whole {
            // The decoder would fill the rest with grey.
            return Err(PhotoError::damaged(path, "JPEG", "it ends before the picture does"));
        }
        if frame.components != 1 && frame.components != 3 {
            let found = format!("a JPEG of {} components (CMYK)", frame.components);
            return Err(PhotoError::unsupported(path, found, "convert it to RGB"));
        }
        check_size(path, frame.size, frame.components.into(), options.max_bytes)?;
        let mut decoder = JpegDecoder::new(Cursor::new(bytes)).map_err(failed)?;
        decoder.set_limits(limits(options)).map_err(failed)?;
        let exif = decoder.exif_metadata().map_err(failed)?;
        let profile = match decoder.icc_profile().map_err(failed)? {
            Some(icc) if options.colour.is_none() => Some(icc::encoding(path, &icc)?),
            _ => None,
        };
        finish(path, options, decoder, exif.as_deref(), profile, "JPEG")
    })
}

/// Decodes the samples, turns them upright and settles the colour space.
fn finish(
    path: &Path,
    options: &ReadOptions,
    decoder: impl ImageDecoder,
    raw_exif: Option<&[u8]>,
    profile: Option<Encoding>,
    format: &'static str,
) -> Result<Decoded, PhotoError> {
    let (width, height) = decoder.dimensions();
    let colour = decoder.color_type();
    check_size(
        path,
        (width.into(), height.into()),
        colour.bytes_per_pixel().into(),
        options.max_bytes,
    )?;
    let (facts, exif_colour) = match raw_exif {
        Some(raw) => exif::parse(raw),
        None => (Facts { orientation: 1, ..Facts::default() }, None),
    };
    let picture = DynamicImage::from_decoder(decoder).map_err(|e| image_error(path, format, e))?;
    let samples = match picture {
        DynamicImage::ImageLuma8(p) => Samples::U8 { channels: 1, data: p.into_raw() },
        DynamicImage::ImageLumaA8(p) => Samples::U8 { channels: 2, data: p.into_raw() },
        DynamicImage::ImageRgb8(p) => Samples::U8 { channels: 3, data: p.into_raw() },
        DynamicImage::ImageRgba8(p) => Samples::U8 { channels: 4, data: p.into_raw() },
        DynamicImage::ImageLuma16(p) => Samples::U16 { channels: 1, data: p.into_raw() },
        DynamicImage::ImageLumaA16(p) => Samples::U16 { channels: 2, data: p.into_raw() },
        DynamicImage::ImageRgb16(p) => Samples::U16 { channels: 3, data: p.into_raw() },
        DynamicImage::ImageRgba16(p) => Samples::U16 { channels: 4, data: p.into_raw() },
        DynamicImage::ImageRgb32F(p) => Samples::F32 { channels: 3, data: p.into_raw() },
        DynamicImage::ImageRgba32F(p) => Samples::F32 { channels: 4, data: p.into_raw() },
        _ => return Err(PhotoError::unsupported(path, "this kind of sample", "convert it to RGB")),
    };
    let encoding = match &options.colour {
        Some(named) => named.encoding(),
        None => settle(path, profile, exif_colour, &samples)?,
    };
    let (width, height, samples) =
        upright(width as usize, height as usize, samples, facts.orientation);
    Ok(Decoded { width, height, samples, facts, encoding, data_window: None, remarks: Vec::new() })
}

/// The encoding of a file: its profile's, EXIF's, or the rule for its kind of sample.
fn settle(
    path: &Path,
    profile: Option<Encoding>,
    exif: Option<ExifColour>,
    samples: &Samples,
) -> Result<Encoding, PhotoError> {
    let as_is = |transfer, primaries, source| Ok(Encoding { transfer, primaries, source });
    if let Some(encoding) = profile {
        return Ok(encoding);
    }
    match (exif, samples) {
        (Some(ExifColour::AdobeRgb), Samples::U8 { .. } | Samples::U16 { .. }) => {
            as_is(Transfer::Gamma(220), Primaries::AdobeRgb, EncodingSource::Exif)
        }
        (Some(ExifColour::Srgb), Samples::U8 { .. } | Samples::U16 { .. }) => {
            as_is(Transfer::Srgb, Primaries::Rec709, EncodingSource::Exif)
        }
        (_, Samples::U8 { .. }) => {
            as_is(Transfer::Srgb, Primaries::Rec709, EncodingSource::FormatRule)
        }
        (_, Samples::F16 { .. } | Samples::F32 { .. }) => {
            as_is(Transfer::Linear, Primaries::Rec709, EncodingSource::FormatRule)
        }
        (_, Samples::U16 { .. }) => Err(PhotoError::UnknownColour {
            path: path.into(),
            found: "has 16 bits and no profile that says what they mean".into(),
        }),
    }
}

fn limits(options: &ReadOptions) -> Limits {
    // Decoders keep a copy of their own beside the finished samples.
    let mut limits = Limits::no_limits();
    limits.max_alloc = Some(options.max_bytes.saturating_mul(2));
    limits
}

fn image_error(path: &Path, format: &'static str, error: ImageError) -> PhotoError {
    match error {
        ImageError::Unsupported(what) => {
            PhotoError::unsupported(path, what.to_string(), "convert it to 8- or 16-bit RGB")
        }
        other => PhotoError::damaged(path, format, other),
    }
}

/// What a JPEG's frame header says.
struct JpegFrame {
    size: (u64, u64),
    components: u8,
    /// The end of the picture is there.
    whole: bool,
}

/// Reads the first SOF marker, without decoding anything.
fn jpeg_frame(bytes: &[u8]) -> Option<JpegFrame> {
    let mut at = 2;
    loop {
        // Any number of fill bytes may precede a marker.
        while *bytes.get(at)? != 0xff {
            at += 1;
        }
        while *bytes.get(at)? == 0xff {
            at += 1;
        }
        let marker = bytes[at];
        at += 1;
        match marker {
            // Frame headers, but for the Huffman, arithmetic and JPG extension markers among them.
            0xc0..=0xcf if !matches!(marker, 0xc4 | 0xc8 | 0xcc) => {
                let frame = bytes.get(at..at + 8)?;
                let be = |i: usize| u64::from(u16::from_be_bytes([frame[i], frame[i + 1]]));
                // In coded data 0xff is followed by 0 or a restart: only the end reads so.
                let whole = bytes[at..].windows(2).any(|pair| pair == [0xff, 0xd9]);
                return Some(JpegFrame { size: (be(5), be(3)), components: frame[7], whole });
            }
            0x01 | 0xd0..=0xd8 => {}
            0xd9 | 0xda => return None,
            _ => {
                let length = bytes.get(at..at + 2)?;
                at += usize::from(u16::from_be_bytes([length[0], length[1]])).max(2);
            }
        }
    }
}

/// Turns stored samples upright: applies EXIF orientation 1…8.
fn upright(
    width: usize,
    height: usize,
    samples: Samples,
    orientation: u8,
) -> (usize, usize, Samples) {
    if !(2..=8).contains(&orientation) {
        return (width, height, samples);
    }
    let turned = match samples {
        Samples::U8 { channels, data } => {
            Samples::U8 { channels, data: turn(&data, channels, width, height, orientation) }
        }
        Samples::U16 { channels, data } => {
            Samples::U16 { channels, data: turn(&data, channels, width, height, orientation) }
        }
        Samples::F16 { channels, data } => {
            Samples::F16 { channels, data: turn(&data, channels, width, height, orientation) }
        }
        Samples::F32 { channels, data } => {
            Samples::F32 { channels, data: turn(&data, channels, width, height, orientation) }
        }
    };
    if orientation >= 5 { (height, width, turned) } else { (width, height, turned) }
}

fn turn<T: Copy>(
    stored: &[T],
    channels: usize,
    width: usize,
    height: usize,
    orientation: u8,
) -> Vec<T> {
    let (w, h) = if orientation >= 5 { (height, width) } else { (width, height) };
    let mut upright = Vec::with_capacity(stored.len());
    for y in 0..h {
        for x in 0..w {
            // Where in the stored picture the upright pixel (x, y) lies (EXIF 2.3, Orientation).
            let (sx, sy) = match orientation {
                2 => (width - 1 - x, y),
                3 => (width - 1 - x, height - 1 - y),
                4 => (x, height - 1 - y),
                5 => (y, x),
                6 => (y, height - 1 - x),
                7 => (width - 1 - y, height - 1 - x),
                8 => (width - 1 - y, x),
                _ => (x, y),
            };
            let start = (sy * width + sx) * channels;
            upright.extend_from_slice(&stored[start..start + channels]);
        }
    }
    upright
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_orientation_agrees_with_the_image_crate() {
        let (width, height) = (5u32, 3u32);
        let stored: Vec<u8> = (0..45).collect();
        for orientation in 1..=8u8 {
            let buffer = image::RgbImage::from_raw(width, height, stored.clone()).unwrap();
            let mut theirs = DynamicImage::ImageRgb8(buffer);
            theirs.apply_orientation(image::metadata::Orientation::from_exif(orientation).unwrap());
            let samples = Samples::U8 { channels: 3, data: stored.clone() };
            let (w, h, ours) = upright(5, 3, samples, orientation);
            assert_eq!((w as u32, h as u32), (theirs.width(), theirs.height()));
            assert_eq!(
                ours,
                Samples::U8 { channels: 3, data: theirs.into_bytes() },
                "{orientation}"
            );
        }
    }
}
