//! Ten ways to merge a bracket: error against radiance, and what a pixel costs.
//!
//! Nine frames two stops apart of a camera with 40 000 electrons at white and a read noise of 6, rounded to
//! 8 bits of sRGB; a million pixels over 7.7 decades. Errors are relative, rms by decade.

use std::error::Error;
use std::fmt::Write;
use std::time::Instant;

use platelight::bracket::{Frame, MergeOptions, Noise, ResponseSource, merge};
use platelight::conventions::Rgb;
use platelight::photo::{Image, Photo, Samples, Transfer};

use super::plot::{self, Line};
use super::random::Random;

const WIDTH: usize = 1200;
const HEIGHT: usize = 800;
const FULL_WELL_E: f64 = 40_000.0;
const READ_NOISE_E: f64 = 6.0;
const FRAMES: usize = 9;
/// Brightest pixel, in units of what saturates the longest frame, and decades below it.
const TOP: f64 = 5e4;
const DECADES: f64 = 7.7;

/// A way to merge and how it did.
pub struct Row {
    name: &'static str,
    /// Radiance in the middle of a decade, mean and rms of the relative error there.
    decades: Vec<(f64, f64, f64)>,
    nanoseconds: f64,
    ours: bool,
}

/// A pixel's codes, as decoded values and exposures, merged by one rule.
type Rule = fn(&Pixel) -> f64;

struct Pixel<'a> {
    codes: &'a [u8],
    values: &'a [f64],
    exposures: &'a [f64],
}

impl Pixel<'_> {
    fn weighted(&self, weight: impl Fn(usize) -> f64, radiance: impl Fn(usize) -> f64) -> f64 {
        let (mut sum, mut total) = (0.0, 0.0);
        for k in 0..self.codes.len() {
            sum += weight(k) * radiance(k);
            total += weight(k);
        }
        sum / total
    }

    fn hat(&self, k: usize) -> f64 {
        f64::from(self.codes[k].min(255 - self.codes[k]))
    }

    fn usable(&self, k: usize) -> f64 {
        f64::from(u8::from(self.codes[k] < 250))
    }

    fn radiance(&self, k: usize) -> f64 {
        self.values[k] / self.exposures[k]
    }
}

const RULES: [(&str, Rule); 8] = [
    ("hat, of the values", |p| p.weighted(|k| p.hat(k), |k| p.radiance(k))),
    ("hat, of their logarithms (Debevec)", |p| {
        p.weighted(|k| p.hat(k), |k| p.radiance(k).max(1e-12).ln()).exp()
    }),
    ("broad hat (Ward)", |p| {
        let broad = |k: usize| 1.0 - (2.0 * f64::from(p.codes[k]) / 255.0 - 1.0).powi(12);
        p.weighted(|k| broad(k) * p.usable(k), |k| p.radiance(k))
    }),
    ("Gaussian × t² (Robertson)", |p| {
        let gauss =
            |k: usize| (-4.0 * (f64::from(p.codes[k]) - 127.5).powi(2) / 127.5f64.powi(2)).exp();
        p.weighted(
            |k| (gauss(k) - (-4.0f64).exp()).max(0.0) * p.exposures[k].powi(2),
            |k| p.radiance(k),
        )
    }),
    ("hat × t", |p| p.weighted(|k| p.hat(k) * p.exposures[k], |k| p.radiance(k))),
    ("longest unclipped", |p| {
        let longest = (0..p.codes.len()).find(|&k| p.codes[k] < 250).unwrap_or(p.codes.len() - 1);
        p.radiance(longest)
    }),
    ("ΣY/Σt", |p| p.weighted(|k| p.usable(k) * p.exposures[k], |k| p.radiance(k))),
    ("likelihood, noise known", |p| {
        let mut x = p.weighted(|k| p.usable(k) * p.exposures[k], |k| p.radiance(k));
        for _ in 0..4 {
            let weight = |k: usize| {
                let y = (x * p.exposures[k]).max(0.0);
                let code = Transfer::Srgb.encode(y as f32) * 255.0;
                let step = Transfer::Srgb.decode((code + 0.5) / 255.0)
                    - Transfer::Srgb.decode((code - 0.5).max(0.0) / 255.0);
                let variance = y / FULL_WELL_E + (READ_NOISE_E / FULL_WELL_E).powi(2);
                let variance = variance + f64::from(step).powi(2) / 12.0;
                p.usable(k) * p.exposures[k].powi(2) / variance
            };
            x = p.weighted(weight, |k| p.radiance(k));
        }
        x
    }),
];

pub fn measure() -> Result<Vec<Row>, Box<dyn Error>> {
    let scene: Vec<f64> = (0..WIDTH * HEIGHT)
        .map(|i| {
            let u = (i as f64 * 0.754_877_666_246_693 + 0.3).fract();
            TOP * 10f64.powf(DECADES * (u - 1.0))
        })
        .collect();
    // By falling exposure; the longest has 1.
    let exposures: Vec<f64> = (0..FRAMES).map(|k| 0.25f64.powi(k as i32)).collect();
    let mut random = Random(1);
    let codes: Vec<Vec<u8>> = exposures
        .iter()
        .map(|t| scene.iter().map(|l| shoot(l * t, &mut random)).collect())
        .collect();
    let linear: Vec<f64> =
        (0..=255u8).map(|code| f64::from(Transfer::Srgb.decode(f32::from(code) / 255.0))).collect();

    let mut rows = Vec::new();
    for (name, rule) in RULES {
        let clock = Instant::now();
        let merged: Vec<f64> = (0..scene.len())
            .map(|i| {
                let codes: [u8; FRAMES] = std::array::from_fn(|k| codes[k][i]);
                let values = codes.map(|code| linear[usize::from(code)]);
                rule(&Pixel { codes: &codes, values: &values, exposures: &exposures })
            })
            .collect();
        let nanoseconds = 1e9 * clock.elapsed().as_secs_f64() / scene.len() as f64;
        rows.push(Row { name, decades: judge(&scene, &merged), nanoseconds, ours: false });
    }
    rows.push(ours(&scene, &codes, &exposures)?);
    Ok(rows)
}

/// An 8-bit code of what falls on a pixel.
fn shoot(light: f64, random: &mut Random) -> u8 {
    let electrons = random.poisson(light * FULL_WELL_E) + READ_NOISE_E * random.normal();
    let y = (electrons / FULL_WELL_E).clamp(0.0, 1.0) as f32;
    (Transfer::Srgb.encode(y) * 255.0).round() as u8
}

/// The program's own merge with its default rule; three channels, so a third of its time is a pixel's.
fn ours(scene: &[f64], codes: &[Vec<u8>], exposures: &[f64]) -> Result<Row, Box<dyn Error>> {
    let photos: Vec<_> = codes
        .iter()
        .map(|codes| {
            let blank = Image::filled(WIDTH, HEIGHT, Rgb::ZERO);
            let mut photo = Photo::from_linear(blank).encoded();
            let data = codes.iter().flat_map(|&code| [code; 3]).collect();
            photo.samples = Samples::U8 { channels: 3, data };
            photo.encoding.transfer = Transfer::Srgb;
            photo
        })
        .collect();
    let frames: Vec<Frame> =
        photos.iter().zip(exposures).map(|(photo, &exposure)| Frame { photo, exposure }).collect();
    let options = MergeOptions {
        refine_exposures: false,
        response: ResponseSource::Stated,
        align: false,
        drop_ghosts: false,
        noise: Some(Noise { full_well_e: FULL_WELL_E, read_noise_e: READ_NOISE_E, measured: true }),
    };
    let clock = Instant::now();
    let merged = merge(&frames, &options)?;
    let nanoseconds = 1e9 * clock.elapsed().as_secs_f64() / scene.len() as f64 / 3.0;
    let values: Vec<f64> = merged.radiance.mean.pixels().iter().map(|l| f64::from(l.y)).collect();
    let decades = judge(scene, &values);
    Ok(Row {
        name: "ΣY/Σt without black frames (ours, σ included)",
        decades,
        nanoseconds,
        ours: true,
    })
}

/// Error in each decade that no frame clips.
fn judge(scene: &[f64], merged: &[f64]) -> Vec<(f64, f64, f64)> {
    (-3..4)
        .map(|decade| {
            let (low, high) = (10f64.powi(decade), 10f64.powi(decade + 1));
            let errors: Vec<f64> = scene
                .iter()
                .zip(merged)
                .filter(|(l, _)| (low..high).contains(*l))
                .map(|(l, x)| x / l - 1.0)
                .collect();
            let n = errors.len() as f64;
            let rms = (errors.iter().map(|e| e * e).sum::<f64>() / n).sqrt();
            ((low * high).sqrt(), errors.iter().sum::<f64>() / n, rms)
        })
        .collect()
}

pub fn csv(rows: &[Row]) -> String {
    let mut text = String::from("estimator,ns_per_pixel,radiance,bias,rms\n");
    for row in rows {
        for (radiance, bias, rms) in &row.decades {
            // Writing to a string cannot fail.
            let _ = writeln!(
                text,
                "\"{}\",{:.0},{radiance:.3e},{bias:+.5},{rms:.5}",
                row.name, row.nanoseconds
            );
        }
    }
    text
}

/// Error against radiance.
pub fn chart(rows: &[Row]) -> Result<String, Box<dyn Error>> {
    let lines: Vec<Line> = rows
        .iter()
        .map(|row| Line {
            name: format!("{}, {:.0} ns", row.name, row.nanoseconds),
            points: row.decades.iter().map(|d| (d.0, d.2)).collect(),
            ours: row.ours,
        })
        .collect();
    let title = "Merging nine exposures, 8 bits: error against radiance";
    let x_title = "radiance, 1 = white of the longest exposure";
    plot::chart(title, x_title, "relative error, rms", &lines)
}

/// Error against time: in the darkest decades and in the bright ones.
pub fn time_chart(rows: &[Row]) -> Result<String, Box<dyn Error>> {
    let lines: Vec<Line> = rows
        .iter()
        .map(|row| Line {
            name: row.name.into(),
            points: row.decades.iter().map(|d| (row.nanoseconds, d.2)).collect(),
            ours: row.ours,
        })
        .collect();
    let title = "Merging nine exposures, 8 bits: error in each of seven decades against time";
    plot::chart(title, "ns per pixel and channel, one thread", "relative error, rms", &lines)
}
