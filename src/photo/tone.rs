//! Scene light → what a screen can show, for looking only: nothing that is measured goes through here.

use crate::conventions::{Rgb, luminance};

use super::Image;

/// How light above white is shown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ToneCurve {
    /// Cut off at white: what is not clipped is exact.
    #[default]
    Clip,
    /// Rolled off so that the brightest pixel is just white (Reinhard et al. 2002, eq. 4).
    Reinhard,
}

/// Display-linear light 0…1 of scene light: scaled by 2^`stops`, then through the curve.
///
/// The curve works on luminance, so hues keep; what is still out of 0…1 per channel is cut.
pub fn display(linear: &Image<Rgb>, stops: f32, curve: ToneCurve) -> Image<Rgb> {
    let gain = stops.exp2();
    let white = match curve {
        ToneCurve::Clip => 1.0,
        ToneCurve::Reinhard => {
            linear.pixels().iter().map(|&l| luminance(l) * gain).fold(1.0, f32::max)
        }
    };
    linear.map(|&l| {
        let l = l * gain;
        let toned = match curve {
            ToneCurve::Clip => l,
            ToneCurve::Reinhard => {
                let y = luminance(l).max(0.0);
                l * ((1.0 + y / (white * white)) / (1.0 + y))
            }
        };
        toned.clamp(Rgb::ZERO, Rgb::ONE)
    })
}

/// Stops that bring the picture's middle (log-average luminance) to 18 % grey.
///
/// Black pixels do not count; a black picture stays as it is.
pub fn automatic_stops(linear: &Image<Rgb>) -> f32 {
    let logs: Vec<f64> = linear
        .pixels()
        .iter()
        .map(|&l| f64::from(luminance(l)))
        .filter(|y| *y > 0.0)
        .map(f64::log2)
        .collect();
    if logs.is_empty() {
        return 0.0;
    }
    (0.18f64.log2() - logs.iter().sum::<f64>() / logs.len() as f64) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clip_shows_exactly_what_fits() {
        let picture =
            Image::from_pixels(2, 1, vec![Rgb::new(0.1, 0.2, 2.0), Rgb::new(-1.0, 0.0, 0.5)]);
        let shown = display(&picture.unwrap(), 1.0, ToneCurve::Clip);
        assert_eq!(shown.pixels(), [Rgb::new(0.2, 0.4, 1.0), Rgb::new(0.0, 0.0, 1.0)]);
    }

    #[test]
    fn reinhard_puts_the_brightest_at_white_and_keeps_order() {
        let picture = Image::from_fn(100, 1, |x, _| Rgb::splat(1.1f32.powi(x as i32)));
        let shown = display(&picture, 0.0, ToneCurve::Reinhard);
        assert!((shown[(99, 0)].x - 1.0).abs() < 1e-4);
        assert!(shown.pixels().windows(2).all(|p| p[0].x < p[1].x));
    }

    #[test]
    fn automatic_exposure_puts_grey_in_the_middle() {
        let picture = Image::filled(3, 3, Rgb::splat(5000.0));
        let shown = display(&picture, automatic_stops(&picture), ToneCurve::Clip);
        assert!((shown[(1, 1)].x - 0.18).abs() < 1e-4);
        assert_eq!(automatic_stops(&Image::filled(3, 3, Rgb::ZERO)), 0.0);
    }
}
