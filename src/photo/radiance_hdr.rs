//! Radiance `.hdr` (RGBE): an own reader and writer, because mantissas need a convention.
//!
//! Radiance truncates mantissas and reads them back as (m + ½)·2^(e−136) (Ward, `colr_color`). Most
//! other writers do the same; reading without the ½ darkens by 0.3 % in the strongest channel and by
//! 3 % in one ten times weaker. A file written with rounded mantissas needs [`Mantissa::Rounded`].
//! EXPOSURE and COLORCORR are divided out, PRIMARIES become [`Primaries`]; XYZE is refused.

use std::io::Write;
use std::path::Path;

use super::error::check_size;
use super::{
    Decoded, Encoding, EncodingSource, Facts, Image, PhotoError, Primaries, ReadOptions, Samples,
    Transfer, atomic,
};
use crate::conventions::Rgb;

const FORMAT: &str = "Radiance HDR";

/// How the writer of a file made 8-bit mantissas.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mantissa {
    /// Rounded down, so the middle of the step is ½ above (Radiance itself).
    #[default]
    Truncated,
    /// Rounded to nearest: the mantissa is the value.
    Rounded,
}

impl Mantissa {
    fn offset(self) -> f32 {
        match self {
            Self::Truncated => 0.5,
            Self::Rounded => 0.0,
        }
    }

    /// Linear value of a mantissa under exponent `e`; an exponent of 0 is black.
    fn decode(self, m: u8, e: u8) -> f32 {
        if e == 0 { 0.0 } else { (f32::from(m) + self.offset()) * scale(i32::from(e) - 136) }
    }
}

/// 2^power for −136 … 119, exact also where 2^power is no normal f32.
fn scale(power: i32) -> f32 {
    f64::from(power).exp2() as f32
}

/// What the text before the pixels says.
struct HdrHeader {
    width: usize,
    height: usize,
    /// Product of all EXPOSURE lines times COLORCORR, per channel: stored = scale · radiance.
    stored_per_radiance: [f64; 3],
    primaries: Option<[f32; 8]>,
}

pub(super) fn decode(
    path: &Path,
    bytes: &[u8],
    options: &ReadOptions,
) -> Result<Decoded, PhotoError> {
    let (header, pixels) = header(path, bytes)?;
    let (width, height) = (header.width, header.height);
    check_size(path, (width as u64, height as u64), 12, options.max_bytes)?;
    // Even a row of one run takes four bytes: a height that the file cannot hold asks for nothing.
    if pixels.len() / 4 < height {
        return Err(PhotoError::damaged(path, FORMAT, "the pixels are cut off"));
    }
    let gain = header.stored_per_radiance.map(|s| (1.0 / s) as f32);
    let mut data = Vec::with_capacity(width * height * 3);
    let mut scanline = vec![[0u8; 4]; width];
    let mut rest = pixels;
    for y in 0..height {
        rest = read_scanline(rest, &mut scanline).ok_or_else(|| {
            PhotoError::damaged(path, FORMAT, format!("row {y} is cut or broken"))
        })?;
        for [r, g, b, e] in &scanline {
            for (m, gain) in [r, g, b].into_iter().zip(gain) {
                data.push(options.mantissa.decode(*m, *e) * gain);
            }
        }
    }
    let encoding = match (&options.colour, header.primaries) {
        (Some(named), _) => named.encoding(),
        (None, Some(xy)) => Encoding {
            transfer: Transfer::Linear,
            primaries: Primaries::recognise(xy),
            source: EncodingSource::Header,
        },
        (None, None) => Encoding {
            transfer: Transfer::Linear,
            primaries: Primaries::Rec709,
            source: EncodingSource::FormatRule,
        },
    };
    let samples = Samples::F32 { channels: 3, data };
    let facts = Facts { orientation: 1, ..Facts::default() };
    Ok(Decoded { width, height, samples, facts, encoding, data_window: None, remarks: Vec::new() })
}

fn header<'a>(path: &Path, bytes: &'a [u8]) -> Result<(HdrHeader, &'a [u8]), PhotoError> {
    let damaged = |cause: &str| PhotoError::damaged(path, FORMAT, cause);
    let mut rest = bytes;
    let mut stored_per_radiance = [1.0f64; 3];
    let mut primaries = None;
    loop {
        let line = take_line(&mut rest).ok_or_else(|| damaged("the header has no end"))?;
        if line.is_empty() {
            break;
        }
        let numbers = |text: &str| -> Vec<f64> {
            text.split_whitespace().map_while(|v| v.parse().ok()).collect()
        };
        let usable = |v: &f64| v.is_finite() && *v > 1e-20 && *v < 1e20;
        match line.split_once('=') {
            Some(("FORMAT", format)) => match format.trim() {
                "32-bit_rle_rgbe" => {}
                "32-bit_rle_xyze" => {
                    let remedy = "convert it to RGBE (ra_xyze -r) or EXR";
                    return Err(PhotoError::unsupported(path, "XYZE Radiance HDR", remedy));
                }
                _ => return Err(damaged("FORMAT is neither RGBE nor XYZE")),
            },
            Some(("EXPOSURE", value)) => match numbers(value).as_slice() {
                [exposure] if usable(exposure) => {
                    stored_per_radiance.iter_mut().for_each(|s| *s *= exposure);
                }
                _ => return Err(damaged("EXPOSURE is not a positive number")),
            },
            Some(("COLORCORR", value)) => match numbers(value).as_slice() {
                correction @ [_, _, _] if correction.iter().all(usable) => {
                    for (s, c) in stored_per_radiance.iter_mut().zip(correction) {
                        *s *= c;
                    }
                }
                _ => return Err(damaged("COLORCORR is not three positive numbers")),
            },
            Some(("PRIMARIES", value)) => match numbers(value).as_slice() {
                &[rx, ry, gx, gy, bx, by, wx, wy] => {
                    primaries = Some([rx, ry, gx, gy, bx, by, wx, wy].map(|v| v as f32));
                }
                _ => return Err(damaged("PRIMARIES is not eight numbers")),
            },
            _ => {}
        }
    }
    let size = take_line(&mut rest).ok_or_else(|| damaged("the size line is missing"))?;
    let words: Vec<&str> = size.split_whitespace().collect();
    let (height, width) = match words.as_slice() {
        ["-Y", height, "+X", width] => match (height.parse(), width.parse()) {
            (Ok(height), Ok(width)) => (height, width),
            _ => return Err(damaged("the size is not a number")),
        },
        [y, _, x, _] if [y, x].iter().all(|a| a.ends_with(['X', 'Y'])) => {
            let remedy = "write it with rows from the top (-Y h +X w), e.g. by pflip or protate";
            return Err(PhotoError::unsupported(path, format!("pixel order {y} {x}"), remedy));
        }
        _ => return Err(damaged("the size line is not \"-Y height +X width\"")),
    };
    Ok((HdrHeader { width, height, stored_per_radiance, primaries }, rest))
}

/// The next line without its end; headers are short, so a long line is no header.
fn take_line<'a>(rest: &mut &'a [u8]) -> Option<&'a str> {
    const LONGEST_LINE: usize = 4096;
    let end = rest.iter().take(LONGEST_LINE).position(|&b| b == b'\n')?;
    let line = &rest[..end];
    *rest = &rest[end + 1..];
    // Comments may be in any encoding; they are skipped, so what is not text reads as one.
    Some(std::str::from_utf8(line).unwrap_or("#").trim_end_matches('\r'))
}

/// Reads one row (new, old or no run-length coding); gives the bytes after it.
fn read_scanline<'a>(bytes: &'a [u8], row: &mut [[u8; 4]]) -> Option<&'a [u8]> {
    match bytes {
        [2, 2, high, low, rest @ ..]
            if *high < 128
                && usize::from(u16::from_be_bytes([*high, *low])) == row.len()
                && (8..=0x7fff).contains(&row.len()) =>
        {
            read_channels(rest, row)
        }
        _ => read_old_runs(bytes, row),
    }
}

/// Four channels one after another, each run-length coded (1991 and later).
fn read_channels<'a>(mut rest: &'a [u8], row: &mut [[u8; 4]]) -> Option<&'a [u8]> {
    for channel in 0..4 {
        let mut x = 0;
        while x < row.len() {
            let (&count, tail) = rest.split_first()?;
            let count = usize::from(count);
            if count > 128 {
                let (&value, tail) = tail.split_first()?;
                row.get_mut(x..x + count - 128)?.iter_mut().for_each(|p| p[channel] = value);
                x += count - 128;
                rest = tail;
            } else {
                if count == 0 {
                    return None;
                }
                let (values, tail) = tail.split_at_checked(count)?;
                let pixels = row.get_mut(x..x + count)?;
                pixels.iter_mut().zip(values).for_each(|(p, &v)| p[channel] = v);
                x += count;
                rest = tail;
            }
        }
    }
    Some(rest)
}

/// Plain pixels, or the old coding in which (1, 1, 1, n) repeats the last pixel n times.
fn read_old_runs<'a>(mut rest: &'a [u8], row: &mut [[u8; 4]]) -> Option<&'a [u8]> {
    let mut x = 0;
    let mut shift = 0u32;
    let mut last = [0u8; 4];
    while x < row.len() {
        let (pixel, tail) = rest.split_first_chunk::<4>()?;
        rest = tail;
        if pixel[..3] == [1, 1, 1] {
            // Repeat counts of neighbouring markers are one number, low byte first.
            let repeat = usize::from(pixel[3]).checked_shl(shift)?;
            row.get_mut(x..x.checked_add(repeat)?)?.fill(last);
            x += repeat;
            shift = (shift + 8).min(24);
        } else {
            last = *pixel;
            row[x] = last;
            x += 1;
            shift = 0;
        }
    }
    Some(rest)
}

/// Shortest run that takes less room than the bytes themselves between two others.
const SHORTEST_RUN: usize = 4;
/// Longest run and longest row of single bytes that one count can say.
const LONGEST_RUN: usize = 127;
const LONGEST_PLAIN: usize = 128;

/// Adds a row: four channels one after another, each run-length coded; flat where the format has no coding
/// for its width.
fn push_scanline(row: &[[u8; 4]], bytes: &mut Vec<u8>) {
    let width = row.len();
    if !(8..=0x7fff).contains(&width) {
        bytes.extend(row.as_flattened());
        return;
    }
    bytes.extend([2, 2, (width >> 8) as u8, width as u8]);
    for channel in 0..4 {
        let value = |x: usize| row[x][channel];
        let run_at = |x: usize| {
            let most = (width - x).min(LONGEST_RUN);
            (1..most).find(|&n| value(x + n) != value(x)).unwrap_or(most)
        };
        let mut x = 0;
        while x < width {
            let run = run_at(x);
            if run >= SHORTEST_RUN {
                bytes.extend([(128 + run) as u8, value(x)]);
                x += run;
                continue;
            }
            let mut end = x + run;
            while end < width && end - x < LONGEST_PLAIN && run_at(end) < SHORTEST_RUN {
                end += 1;
            }
            bytes.push((end - x) as u8);
            bytes.extend((x..end).map(value));
            x = end;
        }
    }
}

/// Writes run-length coded RGBE, `-Y h +X w`, mantissas made as `mantissa` says.
///
/// Prefer EXR: a colour keeps 8 bits of its strongest channel only, and nothing below zero.
///
/// # Errors
/// A pixel that is not finite or beyond 2^127, or the disk.
pub fn write(path: &Path, linear: &Image<Rgb>, mantissa: Mantissa) -> Result<(), PhotoError> {
    let mut bytes = format!(
        "#?RADIANCE\nSOFTWARE=platelight {}\nFORMAT=32-bit_rle_rgbe\n\n-Y {} +X {}\n",
        env!("CARGO_PKG_VERSION"),
        linear.height(),
        linear.width()
    )
    .into_bytes();
    let mut row = Vec::with_capacity(linear.width());
    for y in 0..linear.height() {
        row.clear();
        for (x, &l) in linear.row(y).iter().enumerate() {
            row.push(encode(l, mantissa).ok_or_else(|| {
                let cause = format!("pixel ({x}, {y}) is {l}, which RGBE cannot hold; write EXR");
                PhotoError::Picture { path: path.into(), cause }
            })?);
        }
        push_scanline(&row, &mut bytes);
    }
    atomic::write(path, |file| file.write_all(&bytes))
        .map_err(|source| PhotoError::Write { path: path.into(), source })
}

/// RGBE of a colour, negative channels as 0; `None` for what the format cannot hold.
fn encode(l: Rgb, mantissa: Mantissa) -> Option<[u8; 4]> {
    // First: max would turn NaN into 0 and −∞ with it.
    if !l.is_finite() {
        return None;
    }
    let l = l.as_dvec3().max(glam::DVec3::ZERO);
    let largest = l.max_element();
    if largest < 1e-37 {
        return Some([0; 4]);
    }
    let code = |exponent: i32| {
        l.to_array().map(|v| {
            let m = v * f64::from(8 - exponent).exp2();
            if mantissa == Mantissa::Rounded { m.round() } else { m.floor() }
        })
    };
    // largest = f · 2^exponent with f in [½, 1); rounding may carry into the next exponent.
    let mut exponent = largest.log2().floor() as i32 + 1;
    let mut mantissas = code(exponent);
    if mantissas.iter().any(|&m| m > 255.0) {
        exponent += 1;
        mantissas = code(exponent);
    }
    let e = u8::try_from(exponent + 128).ok().filter(|&e| e > 0)?;
    let [r, g, b] = mantissas.map(|m| m as u8);
    Some([r, g, b, e])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_rgbe_cannot_hold_is_refused_and_never_written_as_black() {
        for l in [
            Rgb::NAN,
            Rgb::new(1.0, f32::NAN, 1.0),
            Rgb::new(f32::INFINITY, 0.0, 0.0),
            Rgb::new(f32::NEG_INFINITY, 0.0, 0.0),
        ] {
            assert_eq!(encode(l, Mantissa::Truncated), None, "{l}");
        }
        assert_eq!(encode(Rgb::new(-1.0, 0.0, 0.0), Mantissa::Truncated), Some([0; 4]));
    }
    /// Rows of one colour, of noise, of runs of every length, and of widths that have no coding.
    #[test]
    fn rows_come_back_from_their_coding_bit_for_bit() {
        let mut random = 1u32;
        let mut next = move || {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (random >> 24) as u8
        };
        for width in [1, 7, 8, 9, 127, 128, 129, 255, 300, 1000, 0x7fff, 0x8000] {
            for kind in 0..3 {
                let mut last = [0u8; 4];
                let row: Vec<[u8; 4]> = (0..width)
                    .map(|_| {
                        let anew = [next(), next(), next(), next()];
                        for (v, new) in last.iter_mut().zip(anew) {
                            let changes = match kind {
                                0 => false,
                                1 => next() < 60,
                                _ => true,
                            };
                            *v = if changes { new | 128 } else { *v | 128 };
                        }
                        last
                    })
                    .collect();
                let mut bytes = Vec::new();
                push_scanline(&row, &mut bytes);
                let mut back = vec![[0u8; 4]; width];
                let rest = read_scanline(&bytes, &mut back).expect("a row that was written");
                assert!(rest.is_empty(), "{width}, {kind}: {} bytes left", rest.len());
                assert!(back == row, "{width}, {kind}");
                if kind == 0 && (8..=0x7fff).contains(&width) {
                    // Two bytes a run, and four for what is left of it.
                    assert!(bytes.len() <= 4 + 4 * (2 * (width / 127) + 4), "{}", bytes.len());
                }
                // Noise costs a count for each 128 bytes.
                assert!(bytes.len() <= 4 + 4 * (width + width.div_ceil(128)), "{width}, {kind}");
            }
        }
    }
}
