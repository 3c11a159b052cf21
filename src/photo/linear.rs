//! A file's own samples → scene-linear Rec.709.

use std::path::Path;

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use super::{Decoded, Format, Image, NonFinite, Photo, PhotoError, Samples, Transfer};
use crate::conventions::Rgb;

/// Codes at or above this are clipped in 8 bit: JPEG and sensor noise spread the clip level.
const CLIP_8BIT: u8 = 250;
/// The same for 16 bit: 0.98 of white.
const CLIP_16BIT: u16 = 64_225;

/// The finished [`Photo`] of a decoded file.
pub(super) fn photo(path: &Path, format: Format, decoded: Decoded) -> Result<Photo, PhotoError> {
    let Decoded { width, height, samples, facts, encoding, data_window, remarks } = decoded;
    let rec709_from_file = match encoding.primaries.rec709_from_rgb() {
        Some(matrix) => (matrix != DMat3::IDENTITY).then_some(matrix),
        None => {
            let found = "the file's chromaticities do not span a colour space".into();
            return Err(PhotoError::UnknownColour { path: path.into(), found });
        }
    };
    let wrong_count = || PhotoError::damaged(path, "picture", "wrong number of samples");
    let pixels = width.checked_mul(height).filter(|&n| n > 0).ok_or_else(wrong_count)?;
    if pixels.checked_mul(samples.channels()) != Some(samples.len()) {
        return Err(wrong_count());
    }
    // Filled in place: rows collected first would hold every pixel twice.
    let mut linear = vec![Rgb::ZERO; pixels];
    let mut clipped = vec![false; pixels];
    let rows = Rows { width, rec709_from_file, linear: &mut linear, clipped: &mut clipped };
    let (nonfinite, alpha) = decode(&samples, &encoding.transfer, rows);
    let nonfinite = nonfinite.first.map(|first| NonFinite { pixels: nonfinite.pixels, first });
    Ok(Photo {
        path: path.into(),
        format,
        linear: Image::from_pixels(width, height, linear).ok_or_else(wrong_count)?,
        alpha: match alpha {
            Some(alpha) => Some(Image::from_pixels(width, height, alpha).ok_or_else(wrong_count)?),
            None => None,
        },
        clipped: Image::from_pixels(width, height, clipped).ok_or_else(wrong_count)?,
        nonfinite,
        data_window,
        remarks,
        facts,
        encoding,
        samples,
    })
}

/// Where the decoded picture goes, row by row.
struct Rows<'a> {
    width: usize,
    rec709_from_file: Option<DMat3>,
    linear: &'a mut [Rgb],
    clipped: &'a mut [bool],
}

/// Pixels with a NaN or infinite sample, and the first of them.
#[derive(Default)]
struct Bad {
    pixels: u64,
    first: Option<(usize, usize)>,
}

impl Bad {
    /// Of two parts of a picture, this one the upper.
    fn and(self, below: Self) -> Self {
        Self { pixels: self.pixels + below.pixels, first: self.first.or(below.first) }
    }
}

/// Fills `rows`; returns what was not finite, and the coverage where the samples have one.
fn decode(samples: &Samples, transfer: &Transfer, rows: Rows) -> (Bad, Option<Vec<f32>>) {
    match samples {
        Samples::U8 { channels, data } => {
            let curve: Vec<f32> =
                (0..=u8::MAX).map(|c| transfer.decode(f32::from(c) / 255.0)).collect();
            rows.fill(
                data,
                *channels,
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
            rows.fill(
                data,
                *channels,
                Codes {
                    light: |c: u16| curve[usize::from(c)],
                    coverage: |c| f32::from(c) / 65535.0,
                    clips: |c| c >= CLIP_16BIT,
                },
            )
        }
        Samples::F16 { channels, data } => rows.fill(
            data,
            *channels,
            Codes {
                light: |v: half::f16| decode_float(transfer, v.to_f32()),
                coverage: half::f16::to_f32,
                clips: |v| v >= half::f16::MAX,
            },
        ),
        Samples::F32 { channels, data } => rows.fill(
            data,
            *channels,
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

impl Rows<'_> {
    fn fill<T: Copy + Sync>(
        self,
        data: &[T],
        channels: usize,
        codes: Codes<impl Fn(T) -> f32 + Sync, impl Fn(T) -> f32 + Sync, impl Fn(T) -> bool + Sync>,
    ) -> (Bad, Option<Vec<f32>>) {
        let Self { width, rec709_from_file, linear, clipped } = self;
        let colours = if channels >= 3 { 3 } else { 1 };
        let pixel = |pixel: &[T]| {
            let light = |c: usize| (codes.light)(pixel[c.min(colours - 1)]);
            let l = Rgb::new(light(0), light(1), light(2));
            match rec709_from_file {
                Some(matrix) => (matrix * DVec3::from(l)).as_vec3(),
                None => l,
            }
        };
        let fill_row = |y: usize, row: &[T], linear: &mut [Rgb], clipped: &mut [bool]| {
            let mut bad = Bad::default();
            for (x, samples) in row.chunks_exact(channels).enumerate() {
                let l = pixel(samples);
                if !l.is_finite() {
                    bad.pixels += 1;
                    bad.first.get_or_insert((x, y));
                }
                linear[x] = Rgb::select(l.is_finite_mask(), l, Rgb::ZERO);
                clipped[x] = samples[..colours].iter().any(|&c| (codes.clips)(c));
            }
            bad
        };
        let bad = data
            .par_chunks_exact(width * channels)
            .zip(linear.par_chunks_exact_mut(width))
            .zip(clipped.par_chunks_exact_mut(width))
            .enumerate()
            .map(|(y, ((row, linear), clipped))| fill_row(y, row, linear, clipped))
            .reduce(Bad::default, Bad::and);
        let coverage = |pixel: &[T]| {
            let a = (codes.coverage)(pixel[channels - 1]);
            if a.is_finite() { a } else { 0.0 }
        };
        let has_alpha = channels.is_multiple_of(2);
        (bad, has_alpha.then(|| data.par_chunks_exact(channels).map(coverage).collect()))
    }
}
