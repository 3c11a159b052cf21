//! TIFF written: the samples as they are, with the profile that says what they mean.

use std::io::Cursor;
use std::path::Path;

use image::codecs::tiff::TiffEncoder;
use image::{ExtendedColorType, ImageEncoder};

use super::{Encoding, PhotoError, Primaries, Samples, Transfer, atomic, icc, png};

/// Writes 8-, 16-bit or float samples as they are; the file appears whole or not at all.
///
/// An ICC profile says what they mean; only linear Rec.709 floats need none.
///
/// # Errors
/// Grey with alpha and half floats (this writer has none), a wrong number of samples, or the disk.
pub fn write(
    path: &Path,
    samples: &Samples,
    width: usize,
    height: usize,
    encoding: &Encoding,
) -> Result<(), PhotoError> {
    let wrong = |cause: &str| PhotoError::Picture { path: path.into(), cause: cause.into() };
    let (kind, raw): (_, Vec<u8>) = match samples {
        Samples::U8 { channels: 1, data } => (ExtendedColorType::L8, data.clone()),
        Samples::U8 { channels: 3, data } => (ExtendedColorType::Rgb8, data.clone()),
        Samples::U8 { channels: 4, data } => (ExtendedColorType::Rgba8, data.clone()),
        Samples::U16 { channels: 1, data } => {
            (ExtendedColorType::L16, bytes(data, |v| v.to_ne_bytes()))
        }
        Samples::U16 { channels: 3, data } => {
            (ExtendedColorType::Rgb16, bytes(data, |v| v.to_ne_bytes()))
        }
        Samples::U16 { channels: 4, data } => {
            (ExtendedColorType::Rgba16, bytes(data, |v| v.to_ne_bytes()))
        }
        Samples::F32 { channels: 3, data } => {
            (ExtendedColorType::Rgb32F, bytes(data, |v| v.to_ne_bytes()))
        }
        Samples::F32 { channels: 4, data } => {
            (ExtendedColorType::Rgba32F, bytes(data, |v| v.to_ne_bytes()))
        }
        _ => return Err(wrong("this kind of sample is not written as TIFF; write PNG or EXR")),
    };
    let (w, h) = match (u32::try_from(width), u32::try_from(height)) {
        (Ok(w), Ok(h))
            if u64::from(kind.bits_per_pixel()) * u64::from(w) * u64::from(h)
                == 8 * raw.len() as u64
                && w > 0
                && h > 0 =>
        {
            (w, h)
        }
        _ => return Err(wrong("has a number of samples that does not fit its size")),
    };
    // Floats without a profile are linear Rec.709 to every reader.
    let plain = encoding.transfer == Transfer::Linear
        && encoding.primaries == Primaries::Rec709
        && matches!(samples, Samples::F32 { .. });
    let profile = if plain { None } else { icc::profile(encoding) };
    let mut file = Cursor::new(Vec::new());
    let mut encoder = TiffEncoder::new(&mut file);
    if let Some(icc) = profile.as_ref().and_then(png::profile_bytes) {
        encoder.set_icc_profile(icc).map_err(|e| wrong(&e.to_string()))?;
    }
    encoder.write_image(&raw, w, h, kind).map_err(|e| wrong(&e.to_string()))?;
    atomic::write(path, |target| std::io::Write::write_all(target, file.get_ref()))
        .map_err(|source| PhotoError::Write { path: path.into(), source })
}

fn bytes<T: Copy, const N: usize>(samples: &[T], to_bytes: impl Fn(T) -> [u8; N]) -> Vec<u8> {
    samples.iter().flat_map(|&v| to_bytes(v)).collect()
}
