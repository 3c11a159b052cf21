//! Scene light → what a screen can show, for looking only: nothing that is measured goes through here.

use crate::conventions::{Rgb, luminance};

use super::Image;
use super::colour::srgb_decode;
use super::ward::adjusted;

/// How scene light is shown.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum ToneCurve {
    /// Cut off at white: what is not clipped is exact.
    #[default]
    Clip,
    /// Rolled off so that luminance `white`, or that of the brightest pixel where that is brighter than 1, is
    /// just white (Reinhard et al. 2002, eq. 4).
    Reinhard { white: Option<f32> },
    /// Never quite white: `1 − e^(−L)` of the luminance.
    Exponential,
    /// The linear values themselves as codes, for reading them off: too dark to look at.
    Linear,
    /// `L^(1/γ)` as codes.
    Gamma { gamma: f32 },
    /// Histogram adjustment after Ward Larson, Rushmeier & Piatko (1997), where 1 stands for this many cd/m².
    Ward { white_cd_m2: f32 },
}

impl ToneCurve {
    /// Reinhard's curve with the brightest pixel white.
    pub const REINHARD: Self = Self::Reinhard { white: None };
}

/// Display-linear light 0…1 of scene light: scaled by 2^`stops`, then through the curve.
///
/// The curves work on luminance, so hues keep; what is still out of 0…1 per channel is cut. Linear and
/// gamma codes come as the light that an sRGB screen makes of them.
pub fn display(linear: &Image<Rgb>, stops: f32, curve: ToneCurve) -> Image<Rgb> {
    let scaled = linear.map(|&l| l * stops.exp2());
    let by_luminance = |shown_per_luminance: &dyn Fn(f32) -> f32| {
        scaled.map(|&l| l * shown_per_luminance(luminance(l).max(0.0)))
    };
    let toned = match curve {
        ToneCurve::Clip => scaled,
        ToneCurve::Reinhard { white } => {
            let brightest = || scaled.pixels().iter().map(|&l| luminance(l)).fold(1.0, f32::max);
            let white = white.unwrap_or_else(brightest);
            by_luminance(&|y| (1.0 + y / (white * white)) / (1.0 + y))
        }
        // (1 − e^−y)/y, which is 1 at 0.
        ToneCurve::Exponential => by_luminance(&|y| if y > 0.0 { -(-y).exp_m1() / y } else { 1.0 }),
        ToneCurve::Linear => scaled.map(|&l| as_code(l)),
        ToneCurve::Gamma { gamma } => {
            scaled.map(|&l| as_code(l.clamp(Rgb::ZERO, Rgb::ONE).powf(gamma.recip())))
        }
        ToneCurve::Ward { white_cd_m2 } => adjusted(&scaled, white_cd_m2),
    };
    toned.map(|l| l.clamp(Rgb::ZERO, Rgb::ONE))
}

/// The light that an sRGB screen makes of codes 0…1.
fn as_code(code: Rgb) -> Rgb {
    Rgb::from_array(code.to_array().map(|c| srgb_decode(c.clamp(0.0, 1.0))))
}

/// Stops that bring the picture's middle (log-average luminance) to 18 % grey.
///
/// Black pixels do not count; a black picture stays as it is.
pub fn automatic_stops(linear: &Image<Rgb>) -> f32 {
    stops_for_key(linear, 0.18)
}

/// Stops that bring the log-average luminance to `key` (Reinhard et al. 2002, eq. 2).
///
/// Black pixels do not count; a black picture stays as it is.
pub fn stops_for_key(linear: &Image<Rgb>, key: f64) -> f32 {
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
    (key.log2() - logs.iter().sum::<f64>() / logs.len() as f64) as f32
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
        let shown = display(&picture, 0.0, ToneCurve::REINHARD);
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

    /// Luminances over twelve decades through every curve.
    #[test]
    fn every_curve_keeps_order_and_range() {
        let picture = Image::from_fn(240, 1, |x, _| Rgb::splat(1.123f32.powi(x as i32 - 120)));
        for curve in [
            ToneCurve::Clip,
            ToneCurve::REINHARD,
            ToneCurve::Reinhard { white: Some(3.0) },
            ToneCurve::Exponential,
            ToneCurve::Linear,
            ToneCurve::Gamma { gamma: 2.2 },
            ToneCurve::Ward { white_cd_m2: 100.0 },
        ] {
            for stops in [-3.0, 0.0, 5.0] {
                let shown = display(&picture, stops, curve);
                assert!(shown.pixels().windows(2).all(|p| p[0].x <= p[1].x + 1e-6), "{curve:?}");
                assert!(shown.pixels().iter().all(|l| (0.0..=1.0).contains(&l.x)), "{curve:?}");
                assert!(shown[(239, 0)].x > 0.9 || stops < 0.0, "{curve:?}: {}", shown[(239, 0)]);
            }
            let black = display(&Image::filled(3, 3, Rgb::ZERO), 0.0, curve);
            assert!(black.pixels().iter().all(|l| *l == Rgb::ZERO), "{curve:?}");
        }
    }

    #[test]
    fn each_curve_is_its_formula() {
        let at = |l: f32, curve: ToneCurve| {
            display(&Image::filled(1, 1, Rgb::splat(l)), 0.0, curve)[(0, 0)].x
        };
        assert!((at(2.0, ToneCurve::Exponential) - (1.0 - (-2.0f32).exp())).abs() < 1e-6);
        assert!((at(1e-20, ToneCurve::Exponential) / 1e-20 - 1.0).abs() < 1e-6);
        let white_3 = ToneCurve::Reinhard { white: Some(3.0) };
        assert!((at(3.0, white_3) - 1.0).abs() < 1e-6);
        assert!((at(1.0, white_3) - (1.0 + 1.0 / 9.0) / 2.0).abs() < 1e-6);
        // As codes, which is what a file holds.
        let code = |l: f32, curve| crate::photo::colour::srgb_encode(at(l, curve));
        assert!((code(0.25, ToneCurve::Linear) - 0.25).abs() < 1e-6);
        assert!(
            (code(0.25, ToneCurve::Gamma { gamma: 2.2 }) - 0.25f32.powf(1.0 / 2.2)).abs() < 1e-6
        );
        // The key is the log-average's new place.
        let picture = Image::from_pixels(2, 1, vec![Rgb::splat(1.0), Rgb::splat(100.0)]).unwrap();
        assert!((stops_for_key(&picture, 0.4).exp2() * 10.0 - 0.4).abs() < 1e-5);
    }
}
