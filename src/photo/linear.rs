//! A file's own samples → scene-linear Rec.709.

use std::path::Path;

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use super::{Decoded, Encoding, Format, Image, NonFinite, Photo, PhotoError, Samples, Transfer};
use crate::conventions::Rgb;

/// Codes at or above this are clipped in 8 bit: JPEG and sensor noise spread the clip level.
const CLIP_8BIT: u8 = 250;
/// The same for 16 bit: 0.98 of white.
const CLIP_16BIT: u16 = 64_225;

/// The finished [`Photo`] of a decoded file.
pub(super) fn photo(path: &Path, format: Format, decoded: Decoded) -> Result<Photo, PhotoError> {
    let Decoded { width, height, samples, facts, encoding } = decoded;
    let rec709_from_file = match encoding.primaries.rec709_from_rgb() {
        Some(matrix) => (matrix != DMat3::IDENTITY).then_some(matrix),
        None => {
            let found = "the file's chromaticities do not span a colour space".into();
            return Err(PhotoError::UnknownColour { path: path.into(), found });
        }
    };
    let lines = lines(&samples, &encoding, width, rec709_from_file);

    let nonfinite = lines
        .iter()
        .filter_map(|l| l.first_nonfinite)
        .next()
        .map(|first| NonFinite { pixels: lines.iter().map(|l| l.nonfinite).sum(), first });
    let has_alpha = samples.channels().is_multiple_of(2);
    let mut linear = Vec::with_capacity(width * height);
    let mut alpha = Vec::with_capacity(if has_alpha { width * height } else { 0 });
    let mut clipped = Vec::with_capacity(width * height);
    for line in lines {
        linear.extend(line.linear);
        alpha.extend(line.alpha);
        clipped.extend(line.clipped);
    }
    let wrong_count = || PhotoError::damaged(path, "picture", "wrong number of samples");
    Ok(Photo {
        path: path.into(),
        format,
        linear: Image::from_pixels(width, height, linear).ok_or_else(wrong_count)?,
        alpha: if has_alpha {
            Some(Image::from_pixels(width, height, alpha).ok_or_else(wrong_count)?)
        } else {
            None
        },
        clipped: Image::from_pixels(width, height, clipped).ok_or_else(wrong_count)?,
        nonfinite,
        facts,
        encoding,
        samples,
    })
}

/// One row of the picture.
struct Line {
    linear: Vec<Rgb>,
    alpha: Vec<f32>,
    clipped: Vec<bool>,
    /// Pixels with a NaN or infinite sample, and the first of them.
    nonfinite: u64,
    first_nonfinite: Option<(usize, usize)>,
}

fn lines(
    samples: &Samples,
    encoding: &Encoding,
    width: usize,
    rec709_from_file: Option<DMat3>,
) -> Vec<Line> {
    let transfer = &encoding.transfer;
    match samples {
        Samples::U8 { channels, data } => {
            let curve: Vec<f32> =
                (0..=u8::MAX).map(|c| transfer.decode(f32::from(c) / 255.0)).collect();
            of_rows(
                data,
                *channels,
                width,
                rec709_from_file,
                Codes {
                    light: |c: u8| curve[usize::from(c)],
                    coverage: |c| f32::from(c) / 255.0,
                    clips: |c| c >= CLIP_8BIT,
                },
            )
        }
        Samples::U16 { channels, data } => {
            let curve: Vec<f32> = (0..=u16::MAX)
                .into_par_iter()
                .map(|c| transfer.decode(f32::from(c) / 65535.0))
                .collect();
            of_rows(
                data,
                *channels,
                width,
                rec709_from_file,
                Codes {
                    light: |c: u16| curve[usize::from(c)],
                    coverage: |c| f32::from(c) / 65535.0,
                    clips: |c| c >= CLIP_16BIT,
                },
            )
        }
        Samples::F16 { channels, data } => of_rows(
            data,
            *channels,
            width,
            rec709_from_file,
            Codes {
                light: |v: half::f16| decode_float(transfer, v.to_f32()),
                coverage: half::f16::to_f32,
                clips: |v| v >= half::f16::MAX,
            },
        ),
        Samples::F32 { channels, data } => of_rows(
            data,
            *channels,
            width,
            rec709_from_file,
            Codes {
                light: |v: f32| decode_float(transfer, v),
                coverage: |v| v,
                clips: |v| v == f32::INFINITY,
            },
        ),
    }
}

fn decode_float(transfer: &Transfer, value: f32) -> f32 {
    if *transfer == Transfer::Linear { value } else { transfer.decode(value) }
}

/// How one kind of sample stands for light, for coverage, and when it is clipped.
struct Codes<Light, Coverage, Clips> {
    light: Light,
    coverage: Coverage,
    clips: Clips,
}

fn of_rows<T: Copy + Sync>(
    data: &[T],
    channels: usize,
    width: usize,
    rec709_from_file: Option<DMat3>,
    codes: Codes<impl Fn(T) -> f32 + Sync, impl Fn(T) -> f32 + Sync, impl Fn(T) -> bool + Sync>,
) -> Vec<Line> {
    let colours = if channels >= 3 { 3 } else { 1 };
    let has_alpha = channels.is_multiple_of(2);
    let line = |(y, row): (usize, &[T])| {
        let mut line = Line {
            linear: Vec::with_capacity(width),
            alpha: Vec::with_capacity(if has_alpha { width } else { 0 }),
            clipped: Vec::with_capacity(width),
            nonfinite: 0,
            first_nonfinite: None,
        };
        for (x, pixel) in row.chunks_exact(channels).enumerate() {
            let light = |c: usize| (codes.light)(pixel[c.min(colours - 1)]);
            let mut l = Rgb::new(light(0), light(1), light(2));
            if let Some(matrix) = rec709_from_file {
                l = (matrix * DVec3::from(l)).as_vec3();
            }
            if !l.is_finite() {
                line.nonfinite += 1;
                line.first_nonfinite.get_or_insert((x, y));
                l = Rgb::select(l.is_finite_mask(), l, Rgb::ZERO);
            }
            line.linear.push(l);
            line.clipped.push(pixel[..colours].iter().any(|&c| (codes.clips)(c)));
            if has_alpha {
                let a = (codes.coverage)(pixel[channels - 1]);
                line.alpha.push(if a.is_finite() { a } else { 0.0 });
            }
        }
        line
    };
    data.par_chunks_exact(width * channels).enumerate().map(line).collect()
}
