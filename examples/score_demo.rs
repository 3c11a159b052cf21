//! How far a result of the demo shot is from the known answer.
//!
//! `cargo run --release --example score_demo -- out/demo plates/demo`
//!
//! All figures are taken in linear light, Y = luminance, over pixels where the objects change the
//! picture (`influence`); *object* means coverage > 0.99, *shadow* influence without coverage.
//! The plate's own grain, which the result rightly keeps and the answer does not have, is taken out
//! first: result + (1 − coverage) · (clean plate − plate).

use std::error::Error;
use std::path::{Path, PathBuf};

use clap::Parser;
use platelight::conventions::{Rgb, luminance};
use platelight::photo::{Image, ReadOptions, read};

#[derive(Parser)]
struct Args {
    /// Folder with the result's composite.exr.
    #[arg(default_value = "out/demo")]
    result: PathBuf,
    /// Folder with the shot's plate.png and truth.exr.
    #[arg(default_value = "plates/demo")]
    shot: PathBuf,
}

fn main() -> Result<(), Box<dyn Error>> {
    let args = Args::parse();
    let picture = |path: &Path, layer: Option<&str>| -> Result<Image<Rgb>, Box<dyn Error>> {
        let options = ReadOptions { layer: layer.map(String::from), ..ReadOptions::default() };
        Ok(read(path, &options)?.linear)
    };
    let answer = args.shot.join("truth.exr");
    let composite = args.result.join("composite.exr");
    let pictures = Pictures {
        result: picture(&composite, None)?,
        plate: picture(&args.shot.join("plate.png"), None)?,
        truth: picture(&answer, None)?,
        clean: picture(&answer, Some("plate"))?,
        coverage: picture(&answer, Some("coverage"))?,
        influence: picture(&answer, Some("influence"))?,
    };
    let size = |image: &Image<Rgb>| (image.width(), image.height());
    if size(&pictures.result) != size(&pictures.truth) {
        let (found, expected) = (size(&pictures.result), size(&pictures.truth));
        let path = composite.display();
        return Err(format!("{path}: is {found:?} pixels, the answer is {expected:?}").into());
    }
    let score = pictures.score();
    println!("distance from the known answer of {}:", args.shot.display());
    println!("  brightness of the objects   {:+.2} %", 100.0 * score.object_mean);
    println!("  strength of the shadow      {:+.2} %", 100.0 * score.shadow_ratio);
    println!("  rms over the influence      {:.2} %", 100.0 * score.rel_rmse);
    println!("pictures: {}", args.result.canonicalize()?.display());
    Ok(())
}

/// The result, and what it is measured against.
struct Pictures {
    result: Image<Rgb>,
    /// The photograph, with its grain, and the same without.
    plate: Image<Rgb>,
    clean: Image<Rgb>,
    truth: Image<Rgb>,
    coverage: Image<Rgb>,
    influence: Image<Rgb>,
}

/// Relative distances; 0 is perfect.
struct Score {
    /// mean Y(result) / mean Y(truth) − 1 over the objects.
    object_mean: f64,
    /// Σ Y(plate − result) / Σ Y(plate − truth) − 1 over the shadow, signed.
    shadow_ratio: f64,
    /// √ mean [Y(result − truth)² / (Y(truth)² + (0.05 median Y(plate))²)] over the influence.
    rel_rmse: f64,
}

impl Pictures {
    fn score(&self) -> Score {
        let mut levels: Vec<f32> = self.plate.pixels().iter().map(|l| luminance(*l)).collect();
        levels.sort_by(f32::total_cmp);
        let floor = 0.05 * levels.get(levels.len() / 2).copied().unwrap_or(0.0);

        let (mut object, mut object_truth) = (0.0, 0.0);
        let (mut shadow, mut shadow_truth) = (0.0, 0.0);
        let (mut squares, mut n) = (0.0, 0.0);
        for i in (0..self.plate.pixels().len()).filter(|i| self.influence.pixels()[*i].x > 0.5) {
            let coverage = self.coverage.pixels()[i].x;
            let (clean, truth) = (self.clean.pixels()[i], self.truth.pixels()[i]);
            let grain = (1.0 - coverage) * (clean - self.plate.pixels()[i]);
            let result = self.result.pixels()[i] + grain;
            let (y_result, y_truth) = (luminance(result), luminance(truth));
            if coverage > 0.99 {
                object += f64::from(y_result);
                object_truth += f64::from(y_truth);
            } else if coverage < 0.01 {
                shadow += f64::from(luminance(clean - result));
                shadow_truth += f64::from(luminance(clean - truth));
            }
            squares += f64::from((y_result - y_truth).powi(2) / (y_truth.powi(2) + floor.powi(2)));
            n += 1.0;
        }
        Score {
            object_mean: object / object_truth - 1.0,
            shadow_ratio: shadow / shadow_truth - 1.0,
            rel_rmse: (squares / n).sqrt(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A row of: untouched, half-dark shadow, object.
    fn pictures(result: [f32; 3]) -> Pictures {
        let row = |v: [f32; 3]| Image::from_fn(3, 1, |x, _| Rgb::splat(v[x]));
        Pictures {
            result: row(result),
            plate: row([0.52, 0.48, 0.5]),
            clean: row([0.5, 0.5, 0.5]),
            truth: row([0.5, 0.25, 0.8]),
            coverage: row([0.0, 0.0, 1.0]),
            influence: row([0.0, 1.0, 1.0]),
        }
    }

    #[test]
    fn the_answer_with_the_grain_of_the_plate_is_perfect() {
        let score = pictures([0.52, 0.23, 0.8]).score();
        assert!(score.object_mean.abs() < 1e-6);
        assert!(score.shadow_ratio.abs() < 1e-6);
        assert!(score.rel_rmse < 1e-6);
    }

    #[test]
    fn a_missing_shadow_and_a_dark_object_are_measured() {
        let score = pictures([0.52, 0.48, 0.4]).score();
        assert!((score.object_mean + 0.5).abs() < 1e-6);
        assert!((score.shadow_ratio + 1.0).abs() < 1e-6);
    }
}
