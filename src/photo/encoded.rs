//! A picture as its file holds it, from which light is made where and when it is needed.

use std::path::{Path, PathBuf};

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use super::{
    Decoded, Encoding, Facts, Format, NonFinite, PhotoError, Samples, ToneCurve, Transfer, Window,
};
use crate::conventions::Rgb;

/// Codes at or above this are clipped in 8 bit: JPEG and sensor noise spread the clip level.
const CLIP_8BIT: u8 = 250;
/// The same for 16 bit: 0.98 of white.
const CLIP_16BIT: u16 = 64_225;

/// A picture as its file holds it, upright: its own samples and what they mean.
///
/// A 24-megapixel JPEG takes 72 MB like this and 390 as a [`Photo`]: brackets are held this way.
#[derive(Clone, Debug)]
pub struct Encoded {
    /// Where it was read.
    pub path: PathBuf,
    pub format: Format,
    pub width: usize,
    pub height: usize,
    /// Samples that are NaN or infinite; their light is 0.
    pub nonfinite: Option<NonFinite>,
    /// As [`Photo::data_window`].
    pub data_window: Option<Window>,
    /// What a person should know of how the file was read, each a sentence without its name.
    pub remarks: Vec<String>,
    /// What the camera wrote beside the picture.
    pub facts: Facts,
    /// How the samples stand for light.
    pub encoding: Encoding,
    pub samples: Samples,
}

impl Encoded {
    /// Judges a decoder's result: as many samples as pixels, colours that span a space.
    pub(super) fn new(path: &Path, format: Format, decoded: Decoded) -> Result<Self, PhotoError> {
        let Decoded { width, height, samples, facts, encoding, data_window, remarks } = decoded;
        if encoding.primaries.rec709_from_rgb().is_none() {
            let found = "the file's chromaticities do not span a colour space".into();
            return Err(PhotoError::UnknownColour { path: path.into(), found });
        }
        let pixels = width.checked_mul(height).filter(|&n| n > 0);
        if pixels.and_then(|n| n.checked_mul(samples.channels())) != Some(samples.len()) {
            return Err(PhotoError::damaged(path, "picture", "wrong number of samples"));
        }
        let mut encoded = Self {
            path: path.into(),
            format,
            width,
            height,
            nonfinite: None,
            data_window,
            remarks,
            facts,
            encoding,
            samples,
        };
        encoded.nonfinite = encoded.find_nonfinite();
        Ok(encoded)
    }

    /// What makes light of the samples.
    pub fn decoder(&self) -> Decoder<'_> {
        Decoder::new(self, &self.encoding.transfer)
    }

    /// The remarks, each with the file's name before it.
    pub fn named_remarks(&self) -> impl Iterator<Item = String> + '_ {
        self.remarks.iter().map(|remark| format!("{}: {remark}", self.path.display()))
    }

    pub(super) fn find_nonfinite(&self) -> Option<NonFinite> {
        if matches!(self.samples, Samples::U8 { .. } | Samples::U16 { .. }) {
            return None;
        }
        let decoder = self.decoder();
        let bad = |i: &usize| !decoder.raw_light(*i).is_finite();
        let pixels = self.width * self.height;
        let first = (0..pixels).into_par_iter().find_first(bad)?;
        let pixels = (0..pixels).into_par_iter().filter(bad).count() as u64;
        Some(NonFinite { pixels, first: (first % self.width, first / self.width) })
    }
}

/// Makes scene-linear Rec.709 of an [`Encoded`] picture's samples; pixels are counted row by row.
pub struct Decoder<'a> {
    samples: &'a Samples,
    curve: Curve<'a>,
    /// How far each 8-bit code is to be believed, above 0 and up to 1, where they are not all alike.
    trust: Option<Box<[f32; 256]>>,
    rec709_from_file: Option<DMat3>,
}

/// What a pixel says of the light.
#[derive(Clone, Copy, Debug)]
pub struct Measured {
    /// Scene-linear Rec.709; channels that are not finite are 0.
    pub light: Rgb,
    /// Variance of `light` by the rounding to codes: 0 of floats. Primaries other than Rec.709 are not
    /// followed.
    pub rounding: Rgb,
    /// How far `light` is to be believed beside that of another exposure: 1, and less towards the ends of
    /// a recovered curve.
    pub trust: Rgb,
}

/// Pixels of a [`Run`], at most.
pub const RUN_PX: usize = 256;

/// What neighbouring pixels say of the light of one channel: [`Measured`] in columns, for sums over many.
/// Of a fixed size, for only then are such sums made four at a time.
#[derive(Clone, Debug)]
pub struct Run {
    pub light: [f32; RUN_PX],
    pub rounding: [f32; RUN_PX],
    pub trust: [f32; RUN_PX],
}

impl Run {
    pub const EMPTY: Self =
        Self { light: [0.0; RUN_PX], rounding: [0.0; RUN_PX], trust: [0.0; RUN_PX] };
}

/// What a sample stands for.
enum Curve<'a> {
    /// Each 8-bit code, in each channel.
    Table8(Box<[[Value; 256]; 3]>),
    /// Each 16-bit code.
    Table16(Vec<Value>),
    Float(&'a Transfer),
}

/// What a code stands for.
#[derive(Clone, Copy)]
struct Value {
    linear: f32,
    /// Variance of rounding to this code: a uniform error as wide as half the way between its neighbours.
    rounding: f32,
}

/// The values of codes whose light is given.
fn values(linear: &[f32]) -> impl Iterator<Item = Value> + '_ {
    (0..linear.len()).map(|code| {
        let (below, above) = (code.saturating_sub(1), (code + 1).min(linear.len() - 1));
        let step = (linear[above] - linear[below]) / (above - below) as f32;
        Value { linear: linear[code], rounding: step * step / 12.0 }
    })
}

fn table8(linear: [f32; 256]) -> [Value; 256] {
    let mut table = [Value { linear: 0.0, rounding: 0.0 }; 256];
    table.iter_mut().zip(values(&linear)).for_each(|(to, value)| *to = value);
    table
}

impl<'a> Decoder<'a> {
    fn new(picture: &'a Encoded, transfer: &'a Transfer) -> Self {
        let curve = match &picture.samples {
            Samples::U8 { .. } => {
                let light = |code| transfer.decode(code as f32 / f32::from(u8::MAX));
                Curve::Table8(Box::new([table8(std::array::from_fn(light)); 3]))
            }
            Samples::U16 { .. } => {
                let light = |code: u16| transfer.decode(f32::from(code) / f32::from(u16::MAX));
                let linear: Vec<f32> = (0..=u16::MAX).into_par_iter().map(light).collect();
                Curve::Table16(values(&linear).collect())
            }
            Samples::F16 { .. } | Samples::F32 { .. } => Curve::Float(transfer),
        };
        let matrix = picture.encoding.primaries.rec709_from_rgb();
        Self {
            samples: &picture.samples,
            curve,
            trust: None,
            rec709_from_file: matrix.filter(|matrix| *matrix != DMat3::IDENTITY),
        }
    }

    /// A decoder by the camera's own curves of red, green and blue; `None` unless the samples are 8-bit
    /// codes.
    pub fn through(picture: &'a Encoded, curves: &[ToneCurve; 3]) -> Option<Self> {
        let Samples::U8 { .. } = picture.samples else { return None };
        let table =
            |curve: &ToneCurve| table8(std::array::from_fn(|code| curve.linear(code as u8)));
        let tables = Box::new([table(&curves[0]), table(&curves[1]), table(&curves[2])]);
        // Few samples say what the codes at both ends stand for: Debevec and Malik's hat.
        let trust = std::array::from_fn(|code: usize| code.min(255 - code).max(1) as f32 / 127.0);
        let (curve, trust) = (Curve::Table8(tables), Some(Box::new(trust)));
        Some(Self { curve, trust, ..picture.decoder() })
    }

    /// Light of pixel `i`; channels that are not finite are 0.
    #[inline]
    pub fn light(&self, i: usize) -> Rgb {
        let l = self.raw_light(i);
        Rgb::select(l.is_finite_mask(), l, Rgb::ZERO)
    }

    #[inline]
    fn raw_light(&self, i: usize) -> Rgb {
        let l = match (self.samples, &self.curve) {
            (Samples::U8 { channels, data }, Curve::Table8(table)) => {
                let [r, g, b] = colours(data, *channels, i).map(usize::from);
                Rgb::new(table[0][r].linear, table[1][g].linear, table[2][b].linear)
            }
            (Samples::U16 { channels, data }, Curve::Table16(table)) => {
                let code = colours(data, *channels, i);
                Rgb::from(code.map(|code| table[usize::from(code)].linear))
            }
            (Samples::F16 { channels, data }, curve) => {
                Rgb::from(colours(data, *channels, i).map(|value| curve.decode(value.to_f32())))
            }
            (Samples::F32 { channels, data }, curve) => {
                Rgb::from(colours(data, *channels, i).map(|value| curve.decode(value)))
            }
            // `new` makes the table that fits the samples.
            (Samples::U8 { .. } | Samples::U16 { .. }, _) => Rgb::ZERO,
        };
        match self.rec709_from_file {
            Some(matrix) => (matrix * DVec3::from(l)).as_vec3(),
            None => l,
        }
    }

    /// Light of pixel `i` and how good it is.
    #[inline]
    pub fn measured(&self, i: usize) -> Measured {
        let rounding = match (self.samples, &self.curve) {
            (Samples::U8 { channels, data }, Curve::Table8(table)) => {
                let [r, g, b] = colours(data, *channels, i).map(usize::from);
                Rgb::new(table[0][r].rounding, table[1][g].rounding, table[2][b].rounding)
            }
            (Samples::U16 { channels, data }, Curve::Table16(table)) => {
                let codes = colours(data, *channels, i);
                Rgb::from(codes.map(|code| table[usize::from(code)].rounding))
            }
            _ => Rgb::ZERO,
        };
        let trust = match (self.samples, &self.trust) {
            (Samples::U8 { channels, data }, Some(trust)) => {
                Rgb::from(colours(data, *channels, i).map(|code| trust[usize::from(code)]))
            }
            _ => Rgb::ONE,
        };
        Measured { light: self.light(i), rounding, trust }
    }

    /// Light of so many pixels from `first` on, and how good it is, in red, green and blue. At most
    /// [`RUN_PX`]; what follows them in the runs stays.
    pub fn measure(&self, first: usize, pixels: usize, runs: &mut [Run; 3]) {
        if self.rec709_from_file.is_none()
            && let (Samples::U8 { channels, data }, Curve::Table8(table)) =
                (self.samples, &self.curve)
        {
            let codes = &data[first * channels..(first + pixels) * channels];
            for (c, (run, table)) in runs.iter_mut().zip(&**table).enumerate() {
                let own = if *channels >= 3 { c } else { 0 };
                let codes = codes[own..].iter().step_by(*channels).map(|&code| usize::from(code));
                for ((light, rounding), code) in
                    run.light.iter_mut().zip(&mut run.rounding).zip(codes.clone())
                {
                    (*light, *rounding) = (table[code].linear, table[code].rounding);
                }
                match &self.trust {
                    Some(table) => {
                        run.trust
                            .iter_mut()
                            .zip(codes)
                            .for_each(|(trust, code)| *trust = table[code]);
                    }
                    None => run.trust = [1.0; RUN_PX],
                }
            }
            return;
        }
        for i in 0..pixels {
            let Measured { light, rounding, trust } = self.measured(first + i);
            for (c, run) in runs.iter_mut().enumerate() {
                (run.light[i], run.rounding[i], run.trust[i]) = (light[c], rounding[c], trust[c]);
            }
        }
    }

    /// Green of pixel `i` as a position in [`Self::greens`], of samples that are codes.
    #[inline]
    pub fn green_code(&self, i: usize) -> Option<usize> {
        match self.samples {
            Samples::U8 { channels, data } => Some(usize::from(colours(data, *channels, i)[1])),
            Samples::U16 { channels, data } => Some(usize::from(colours(data, *channels, i)[1])),
            Samples::F16 { .. } | Samples::F32 { .. } => None,
        }
    }

    /// Linear value of every green code, in the file's own primaries; empty of floats.
    pub fn greens(&self) -> Vec<f32> {
        match &self.curve {
            Curve::Table8(table) => table[1].iter().map(|value| value.linear).collect(),
            Curve::Table16(table) => table.iter().map(|value| value.linear).collect(),
            Curve::Float(_) => Vec::new(),
        }
    }

    /// Which of red, green and blue of pixel `i` are at or above the level at which this kind of file clips.
    #[inline]
    pub fn clips(&self, i: usize) -> [bool; 3] {
        match self.samples {
            Samples::U8 { channels, data } => {
                colours(data, *channels, i).map(|code| code >= CLIP_8BIT)
            }
            Samples::U16 { channels, data } => {
                colours(data, *channels, i).map(|code| code >= CLIP_16BIT)
            }
            Samples::F16 { channels, data } => {
                colours(data, *channels, i).map(|value| value >= half::f16::MAX)
            }
            Samples::F32 { channels, data } => {
                colours(data, *channels, i).map(|value| value == f32::INFINITY)
            }
        }
    }

    /// [`Self::clips`] of the pixels from `first` on, as the bits 1, 2 and 4.
    pub fn clip_bits(&self, first: usize, bits: &mut [u8]) {
        let bits_of = |[r, g, b]: [bool; 3]| u8::from(r) | u8::from(g) << 1 | u8::from(b) << 2;
        match self.samples {
            Samples::U8 { channels: 3, data } => {
                // Most stretches of most pictures clip nowhere.
                const STRETCH_PX: usize = 64;
                let codes = &data[3 * first..3 * (first + bits.len())];
                let stretches = bits.chunks_mut(STRETCH_PX).zip(codes.chunks(3 * STRETCH_PX));
                for (bits, codes) in stretches {
                    if codes.iter().fold(0, |most: u8, &code| most.max(code)) < CLIP_8BIT {
                        bits.fill(0);
                        continue;
                    }
                    for (bits, code) in bits.iter_mut().zip(codes.as_chunks::<3>().0) {
                        *bits = bits_of(code.map(|code| code >= CLIP_8BIT));
                    }
                }
            }
            _ => {
                for (i, bits) in bits.iter_mut().enumerate() {
                    *bits = bits_of(self.clips(first + i));
                }
            }
        }
    }

    /// Coverage of pixel `i`, 0…1, of samples that have it.
    pub fn coverage(&self, i: usize) -> Option<f32> {
        let channels = self.samples.channels();
        if !channels.is_multiple_of(2) {
            return None;
        }
        let at = i * channels + channels - 1;
        let coverage = match self.samples {
            Samples::U8 { data, .. } => f32::from(data[at]) / f32::from(u8::MAX),
            Samples::U16 { data, .. } => f32::from(data[at]) / f32::from(u16::MAX),
            Samples::F16 { data, .. } => data[at].to_f32(),
            Samples::F32 { data, .. } => data[at],
        };
        Some(if coverage.is_finite() { coverage } else { 0.0 })
    }
}

impl Curve<'_> {
    fn decode(&self, value: f32) -> f32 {
        match self {
            Self::Float(Transfer::Linear) | Self::Table8(_) | Self::Table16(_) => value,
            Self::Float(transfer) => transfer.decode(value),
        }
    }
}

/// The three colours of pixel `i`; a grey stands for all of them.
#[inline]
fn colours<T: Copy>(data: &[T], channels: usize, i: usize) -> [T; 3] {
    let at = i * channels;
    if channels >= 3 { [data[at], data[at + 1], data[at + 2]] } else { [data[at]; 3] }
}
