//! Plate + difference, in scene-linear light.
//!
//! A pixel with plate value P becomes `object + (1 − coverage) · P + change`, where `change` is the
//! measured difference (additive) or `ratio · P` (ratio mode, which keeps the plate's texture and
//! needs no albedo; diffuse local surfaces only). All terms come from the same camera samples, so
//! object edges have no halo (methods-render R9.1–R9.3).

use rayon::prelude::*;

use crate::conventions::Rgb;
use crate::photo::{Format, Image, Photo, Window};
use crate::render::Difference;

/// How light that objects take from or give to the background reaches the plate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// P + difference.
    Additive,
    /// P · (1 + ΔE/E₀) where a diffuse local surface gave a ratio, additive elsewhere.
    Ratio,
}

/// The finished picture and its parts, in linear Rec.709 and the plate's scale.
#[derive(Clone, Debug)]
pub struct Composite {
    /// All of the picture. Finite; the plate's own values where `changed` is false.
    pub linear: Image<Rgb>,
    /// The difference's window; the pictures below hold it alone, and nothing is changed elsewhere.
    pub window: Window,
    /// True where anything of the objects reached the pixel.
    pub changed: Image<bool>,
    /// Signed change of the background: `linear = object + (1 − coverage) · plate + change`.
    pub change: Image<Rgb>,
    /// Background seen past the object = plate × this. 1 where nothing changed.
    pub shadow: Image<Rgb>,
    pub tally: Tally,
}

/// How the pixels of a composite came about, for the report.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct Tally {
    /// Pixels that differ from the plate.
    pub changed: u64,
    /// Of these, pixels with background that took their change from the ratio …
    pub by_ratio: u64,
    /// … and from the additive difference.
    pub by_difference: u64,
    /// Changed pixels where the plate itself is clipped: their result is a lower bound.
    pub plate_clipped: u64,
    /// Samples that would have been negative and were set to 0.
    pub negative: u64,
    /// Pixels whose difference was not finite; they keep the plate.
    pub not_finite: u64,
}

#[derive(Debug, thiserror::Error)]
pub enum CompositeError {
    #[error(
        "the difference is {difference:?} px and the plate {plate:?} px; render at the plate's size"
    )]
    Size { plate: (usize, usize), difference: (usize, usize) },
}

/// Adds the difference to the plate.
///
/// # Errors
/// Pictures of different sizes.
pub fn compose(
    plate: &Photo,
    difference: &Difference,
    mode: Mode,
) -> Result<Composite, CompositeError> {
    let size = (plate.linear.width(), plate.linear.height());
    if difference.size != size {
        return Err(CompositeError::Size { plate: size, difference: difference.size });
    }
    let window = difference.window;
    let pixels: Vec<Pixel> = (0..window.n_pixels())
        .into_par_iter()
        .map(|k| Pixel::compose(plate, difference, mode, k))
        .collect();

    let mut linear = plate.linear.clone();
    let mut tally = Tally::default();
    for (k, pixel) in pixels.iter().enumerate() {
        linear[window.pixel(k)] = pixel.linear;
        pixel.count(&mut tally);
    }
    let (width, height) = window.size;
    let image = |value: fn(&Pixel) -> Rgb| {
        Image::from_fn(width, height, |x, y| value(&pixels[y * width + x]))
    };
    Ok(Composite {
        linear,
        window,
        changed: Image::from_fn(width, height, |x, y| pixels[y * width + x].changed),
        change: image(|p| p.change),
        shadow: image(|p| p.shadow),
        tally,
    })
}

/// One finished pixel and how it came about.
#[derive(Clone, Copy)]
struct Pixel {
    linear: Rgb,
    change: Rgb,
    shadow: Rgb,
    changed: bool,
    by_ratio: bool,
    by_difference: bool,
    plate_clipped: bool,
    negative: u8,
    finite: bool,
}

impl Pixel {
    /// The difference's `k`-th pixel.
    fn compose(plate: &Photo, d: &Difference, mode: Mode, k: usize) -> Self {
        let at = d.window.pixel(k);
        let own = plate.linear[at];
        let (coverage, object) = (d.coverage.pixels()[k], d.object.pixels()[k]);
        // What is not there takes no light: alpha scales the difference as it scales the plate.
        let alpha = straight_alpha(plate, at);
        let (additive, ratio) = (d.difference.pixels()[k] * alpha, d.ratio.pixels()[k]);
        let untouched = Self {
            linear: own,
            change: Rgb::ZERO,
            shadow: Rgb::ONE,
            changed: false,
            by_ratio: false,
            by_difference: false,
            plate_clipped: false,
            negative: 0,
            finite: true,
        };
        if coverage == 0.0 && object == Rgb::ZERO && additive == Rgb::ZERO && ratio == Rgb::ZERO {
            return untouched;
        }
        let premultiplied = own * alpha;
        let use_ratio = mode == Mode::Ratio && ratio != Rgb::ZERO;
        // Per channel: black plates and dark channels have a difference but no ratio.
        let by_ratio = ratio.cmpne(Rgb::ZERO);
        let change = if use_ratio {
            Rgb::select(by_ratio, ratio * premultiplied, additive)
        } else {
            additive
        };
        let background = (1.0 - coverage) * premultiplied;
        let sum = object + background + change;
        if !(sum.is_finite() && coverage.is_finite()) {
            return Self { finite: false, ..untouched };
        }
        // A plate may hold negative values of its own (colours outside the gamut): those stay.
        let floor = premultiplied.min(Rgb::ZERO);
        let linear = sum.max(floor);
        let alpha_out = coverage + (1.0 - coverage) * alpha;
        Self {
            linear: if alpha_out > 0.0 { linear / alpha_out } else { linear },
            change,
            shadow: shadow(background, change),
            changed: true,
            by_ratio: use_ratio && coverage < 1.0,
            by_difference: !use_ratio && additive != Rgb::ZERO && coverage < 1.0,
            plate_clipped: coverage < 1.0 && plate.clipped[at],
            negative: (sum.cmplt(floor).bitmask().count_ones()) as u8,
            finite: true,
        }
    }

    fn count(&self, tally: &mut Tally) {
        tally.changed += u64::from(self.changed);
        tally.by_ratio += u64::from(self.by_ratio);
        tally.by_difference += u64::from(self.by_difference);
        tally.plate_clipped += u64::from(self.plate_clipped);
        tally.negative += u64::from(self.negative);
        tally.not_finite += u64::from(!self.finite);
    }
}

/// Alpha that the plate's colour still has to be multiplied with: 1 for EXR, which is premultiplied,
/// and for plates without alpha. Every other format is straight, whatever its sample type.
fn straight_alpha(plate: &Photo, at: (usize, usize)) -> f32 {
    match &plate.alpha {
        Some(alpha) if plate.format != Format::Exr => alpha[at],
        _ => 1.0,
    }
}

/// What to multiply the background with; 1 in channels where there is no background to multiply.
fn shadow(background: Rgb, change: Rgb) -> Rgb {
    let factor = (background + change).max(Rgb::ZERO) / background;
    let usable = background.cmpgt(Rgb::ZERO) & factor.cmplt(Rgb::splat(f32::INFINITY));
    Rgb::select(usable, factor, Rgb::ONE)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    fn plate() -> Photo {
        Photo::from_linear(Image::from_fn(4, 2, |x, y| Vec3::new(0.1, 0.2, 0.3) * (x + y) as f32))
    }

    #[test]
    fn plate_is_untouched_where_the_objects_have_no_influence() {
        let plate = plate();
        for mode in [Mode::Additive, Mode::Ratio] {
            let composite = compose(&plate, &Difference::nothing(4, 2), mode).unwrap();
            assert_eq!(composite.linear, plate.linear);
            assert!(composite.changed.pixels().iter().all(|&changed| !changed));
            assert_eq!(composite.tally, Tally::default());
        }
    }

    #[test]
    fn one_pixel_follows_the_formula_in_both_modes() {
        let plate = plate();
        let mut d = Difference::nothing(4, 2);
        d.coverage[(2, 1)] = 0.25;
        d.object[(2, 1)] = Vec3::new(0.2, 0.1, 0.05);
        d.difference[(2, 1)] = Vec3::new(-0.03, 0.01, 0.0);
        d.ratio[(2, 1)] = Vec3::new(-0.5, 0.25, 0.0);
        let own = plate.linear[(2, 1)];
        let additive = compose(&plate, &d, Mode::Additive).unwrap().linear[(2, 1)];
        let expected = d.object[(2, 1)] + 0.75 * own + d.difference[(2, 1)];
        assert!((additive - expected).abs().max_element() < 1e-7, "{additive} {expected}");
        let ratio = compose(&plate, &d, Mode::Ratio).unwrap();
        let expected = d.object[(2, 1)] + own * (0.75 + d.ratio[(2, 1)]);
        let found = ratio.linear[(2, 1)];
        assert!((found - expected).abs().max_element() < 1e-7, "{found} {expected}");
        assert_eq!(ratio.tally.changed, 1);
        assert_eq!(ratio.tally.by_ratio, 1);
    }

    #[test]
    fn shadow_layer_times_plate_is_the_background() {
        let plate = plate();
        let mut d = Difference::nothing(4, 2);
        d.coverage[(3, 1)] = 0.5;
        d.ratio[(3, 1)] = Vec3::new(-0.25, -0.5, 0.1);
        let composite = compose(&plate, &d, Mode::Ratio).unwrap();
        let rebuilt = 0.5 * plate.linear[(3, 1)] * composite.shadow[(3, 1)];
        assert!((rebuilt - composite.linear[(3, 1)]).abs().max_element() < 1e-6);
        assert_eq!(composite.shadow[(0, 0)], Rgb::ONE);
    }

    #[test]
    fn black_plate_takes_added_light_without_dividing_by_it() {
        let plate = Photo::from_linear(Image::filled(1, 1, Rgb::ZERO));
        let mut d = Difference::nothing(1, 1);
        d.difference[(0, 0)] = Vec3::splat(0.1);
        let composite = compose(&plate, &d, Mode::Ratio).unwrap();
        assert_eq!(composite.linear[(0, 0)], Vec3::splat(0.1));
        assert_eq!(composite.shadow[(0, 0)], Rgb::ONE);
        assert_eq!(composite.tally.by_difference, 1);
    }

    #[test]
    fn results_are_finite_and_not_negative() {
        let plate = plate();
        let mut d = Difference::nothing(4, 2);
        d.difference[(0, 1)] = Vec3::splat(-9.0);
        d.object[(1, 1)] = Vec3::new(f32::NAN, 0.0, 0.0);
        d.ratio[(2, 1)] = Vec3::splat(f32::INFINITY);
        let composite = compose(&plate, &d, Mode::Ratio).unwrap();
        assert_eq!(composite.linear[(0, 1)], Rgb::ZERO);
        assert_eq!(composite.linear[(1, 1)], plate.linear[(1, 1)]);
        assert_eq!(composite.linear[(2, 1)], plate.linear[(2, 1)]);
        assert_eq!((composite.tally.negative, composite.tally.not_finite), (3, 2));
    }

    #[test]
    fn negative_colours_of_the_plate_stay_its_own() {
        let plate = Photo::from_linear(Image::filled(1, 1, Vec3::new(-0.1, 0.5, 0.5)));
        let mut d = Difference::nothing(1, 1);
        d.ratio[(0, 0)] = Vec3::splat(-0.5);
        let composite = compose(&plate, &d, Mode::Ratio).unwrap();
        assert!((composite.linear[(0, 0)] - Vec3::new(-0.05, 0.25, 0.25)).length() < 1e-7);
        assert_eq!(composite.tally.negative, 0);
    }

    #[test]
    fn alpha_is_premultiplied_in_exr_and_straight_in_every_other_format() {
        let mut d = Difference::nothing(1, 1);
        d.coverage[(0, 0)] = 0.25;
        d.object[(0, 0)] = Vec3::splat(0.2);
        d.difference[(0, 0)] = Vec3::splat(0.08);
        d.ratio[(0, 0)] = Vec3::splat(-0.5);
        for mode in [Mode::Additive, Mode::Ratio] {
            let finished = |format, value: f32| {
                let plate = Photo {
                    format,
                    alpha: Some(Image::filled(1, 1, 0.5)),
                    ..Photo::from_linear(Image::filled(1, 1, Vec3::splat(value)))
                };
                compose(&plate, &d, mode).unwrap().linear[(0, 0)].x
            };
            let exr = finished(Format::Exr, 0.4);
            let change = if mode == Mode::Additive { 0.08 } else { -0.5 * 0.4 };
            assert!((exr - (0.2 + 0.75 * 0.4 + change)).abs() < 1e-6, "{mode:?}: {exr}");
            // Float TIFF is straight as 16-bit TIFF is: half of the plate, half of its change.
            let change = if mode == Mode::Additive { 0.5 * 0.08 } else { -0.5 * 0.5 * 0.4 };
            let over_alpha = 0.25 + 0.75 * 0.5;
            let expected = (0.2 + 0.75 * 0.5 * 0.4 + change) / over_alpha;
            for format in [Format::Tiff, Format::Png] {
                let straight = finished(format, 0.4);
                assert!((straight - expected).abs() < 1e-6, "{mode:?} {format:?}: {straight}");
            }
        }
    }

    #[test]
    fn other_sizes_are_refused() {
        assert!(compose(&plate(), &Difference::nothing(3, 2), Mode::Ratio).is_err());
    }
}
