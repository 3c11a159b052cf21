//! Histogram adjustment: a picture's whole range on a screen, with no contrast that an eye on the scene
//! would not have seen (Ward Larson, Rushmeier & Piatko, IEEE TVCG 3(4), 1997).
//!
//! The histogram of log luminance, cumulated, is the tone curve; each bin is first trimmed to the
//! ceiling at which the curve would raise contrast above the threshold of human vision there
//! (their eq. 7 with Ferwerda's thresholds, table 1). Where trimming leaves nothing the range fits the
//! screen as it is, and light is only scaled.

use super::Image;
use crate::conventions::{Rgb, luminance};

/// The screen that is assumed: its black and white, cd/m² (their figures for a cathode-ray tube).
const SCREEN: [f64; 2] = [1.0, 100.0];

const BINS: usize = 100;

/// Trimming ends when a pass takes less than this share of the histogram.
const TOLERANCE: f64 = 0.025;

/// The darkest luminance that counts, as a share of the brightest: more than any eye or camera spans.
const DARKEST: f64 = 1e-10;

/// The tone curve of a picture: ln of scene luminance → ln of screen luminance, both cd/m².
#[derive(Clone, Debug, PartialEq)]
struct Adjustment {
    /// ln of the darkest luminance, and the width of a bin.
    darkest: f64,
    bin: f64,
    /// Share of the trimmed histogram below each bin's lower edge; `BINS` + 1 of them, 0 … 1.
    cumulated: Vec<f64>,
}

/// Display-linear light of a picture in which 1 stands for `white_cd_m2`.
///
/// Hues keep; what is still out of 0…1 per channel is left so.
pub(super) fn adjusted(linear: &Image<Rgb>, white_cd_m2: f32) -> Image<Rgb> {
    let Some(curve) = Adjustment::of(linear, f64::from(white_cd_m2)) else {
        let brightest = linear.pixels().iter().map(|&l| luminance(l)).fold(1.0, f32::max);
        return linear.map(|&l| l / brightest);
    };
    let [black, white] = SCREEN;
    linear.map(|&l| {
        let y = f64::from(luminance(l));
        if y <= 0.0 {
            return Rgb::ZERO;
        }
        let shown = curve.screen(y * f64::from(white_cd_m2));
        l * ((shown - black) / (white - black) / y) as f32
    })
}

impl Adjustment {
    /// `None` where there is nothing to compress: the scene's range fits the screen, or is none.
    fn of(linear: &Image<Rgb>, white_cd_m2: f64) -> Option<Self> {
        let luminances = || {
            let all = linear.pixels().iter().map(|&l| f64::from(luminance(l)) * white_cd_m2);
            all.filter(|y| *y > 0.0 && y.is_finite())
        };
        let brightest = luminances().fold(0.0, f64::max);
        let floor = brightest * DARKEST;
        let darkest = luminances().filter(|&y| y >= floor).fold(f64::INFINITY, f64::min).ln();
        let bin = (brightest.ln() - darkest) / BINS as f64;
        // NaN too.
        if !(bin > 1e-9) {
            return None;
        }
        let mut counts = vec![0.0; BINS];
        for y in luminances() {
            let place = (y.ln() - darkest) / bin;
            counts[(place.max(0.0) as usize).min(BINS - 1)] += 1.0;
        }
        let mut curve = Self { darkest, bin, cumulated: Vec::new() };
        curve.trim(&mut counts).then_some(curve)
    }

    /// Trims the histogram to what is visible and cumulates it; false if nothing is left.
    fn trim(&mut self, counts: &mut [f64]) -> bool {
        let tolerance = TOLERANCE * counts.iter().sum::<f64>();
        loop {
            let total: f64 = counts.iter().sum();
            if total < tolerance {
                return false;
            }
            self.cumulated = cumulate(counts, total);
            let mut trimmed = 0.0;
            for (i, count) in counts.iter_mut().enumerate() {
                let scene = (self.darkest + (i as f64 + 0.5) * self.bin).exp();
                // Counts are slopes: of ln(screen) by ln(scene), times total · bin / ln(range).
                let ceiling = steepest(scene, self.screen(scene)) * total * self.bin / range();
                if *count > ceiling {
                    trimmed += *count - ceiling;
                    *count = ceiling;
                }
            }
            if trimmed <= tolerance {
                let total = counts.iter().sum();
                self.cumulated = cumulate(counts, total);
                return true;
            }
        }
    }

    /// Screen luminance of a scene luminance, cd/m²: the cumulated share of the screen's logarithmic range.
    fn screen(&self, scene: f64) -> f64 {
        let place = ((scene.ln() - self.darkest) / self.bin).clamp(0.0, BINS as f64);
        let i = (place as usize).min(BINS - 1);
        let (low, high) = (self.cumulated[i], self.cumulated[i + 1]);
        let share = low + (place - i as f64) * (high - low);
        (SCREEN[0].ln() + range() * share).exp()
    }
}

/// ln of the screen's contrast.
fn range() -> f64 {
    (SCREEN[1] / SCREEN[0]).ln()
}

fn cumulate(counts: &[f64], total: f64) -> Vec<f64> {
    let mut sum = 0.0;
    let mut cumulated = vec![0.0];
    cumulated.extend(counts.iter().map(|count| {
        sum += count;
        sum / total
    }));
    cumulated
}

/// Largest slope of ln(screen) by ln(scene) that shows no more contrast than the scene itself did.
fn steepest(scene: f64, screen: f64) -> f64 {
    threshold(screen) / threshold(scene) * scene / screen
}

/// Smallest luminance difference seen by an eye adapted to `adapted`, both cd/m² (Ferwerda et al. 1996).
fn threshold(adapted: f64) -> f64 {
    let a = adapted.log10();
    let exponent = if a < -3.94 {
        -2.86
    } else if a < -1.44 {
        (0.405 * a + 1.6).powf(2.18) - 2.86
    } else if a < -0.0184 {
        a - 0.395
    } else if a < 1.9 {
        (0.249 * a + 0.65).powf(2.7) - 0.72
    } else {
        a - 1.255
    };
    10f64.powf(exponent)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two thousand pixels from 0.001 to 10 000 cd/m², most of them in two heaps.
    fn scene() -> Image<Rgb> {
        Image::from_fn(200, 10, |x, y| {
            let even = -3.0 + 7.0 * (y as f64 * 200.0 + x as f64) / 2000.0;
            let exponent = match y {
                0..=4 => -1.0 + 0.5 * (x as f64 / 200.0),
                5..=7 => 3.0 + 0.3 * (x as f64 / 200.0),
                _ => even,
            };
            Rgb::splat(10f64.powf(exponent) as f32)
        })
    }

    #[test]
    fn thresholds_join_where_their_pieces_meet() {
        for (at, jump) in [(-3.94, 0.01), (-1.44, 0.02), (-0.0184, 0.01), (1.9, 0.02)] {
            let of = |a: f64| threshold(10f64.powf(a)).log10();
            assert!((of(at - 1e-9) - of(at + 1e-9)).abs() < jump, "{at}");
        }
        // In daylight Weber's law: 5.6 %.
        assert!((threshold(1e4) / 1e4 - 10f64.powf(-1.255)).abs() < 1e-12);
    }

    #[test]
    fn brighter_is_never_shown_darker_and_the_range_fits() {
        let picture = scene();
        let shown = adjusted(&picture, 1.0);
        let mut pairs: Vec<(f32, f32)> =
            picture.pixels().iter().zip(shown.pixels()).map(|(l, d)| (l.x, d.x)).collect();
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
        assert!(pairs.windows(2).all(|p| p[0].1 <= p[1].1 * (1.0 + 1e-5)));
        let (first, last) = (pairs[0].1, pairs[pairs.len() - 1].1);
        assert!(first.abs() < 1e-3 && (last - 1.0).abs() < 1e-3, "{first} … {last}");
    }

    #[test]
    fn no_bin_is_steeper_than_the_eye() {
        let curve = Adjustment::of(&scene(), 1.0).expect("seven decades do not fit the screen");
        for i in 0..BINS {
            let slope = (curve.cumulated[i + 1] - curve.cumulated[i]) * range() / curve.bin;
            let scene = (curve.darkest + (i as f64 + 0.5) * curve.bin).exp();
            let ceiling = steepest(scene, curve.screen(scene));
            // What the last pass took changes the total by its tolerance, and the screen values with it.
            assert!(slope <= ceiling * 1.1, "bin {i}: {slope} of {ceiling}");
        }
        // Something was trimmed: the heaps alone would be steeper.
        let heap = 0.5 * range() / (0.5 * std::f64::consts::LN_10);
        assert!(heap > 1.5, "{heap}");
    }

    #[test]
    fn what_fits_the_screen_is_only_scaled() {
        for value in [0.0, 0.18, 7.0] {
            let shown = adjusted(&Image::filled(4, 4, Rgb::splat(value)), 100.0);
            assert!(shown.pixels().iter().all(|l| (l.x - value.min(1.0)).abs() < 1e-6), "{value}");
        }
        let few = Image::from_fn(10, 1, |x, _| Rgb::splat(0.5 + 0.01 * x as f32));
        assert_eq!(adjusted(&few, 100.0), few, "a tenth of a stop asks for no compression");
    }
}
