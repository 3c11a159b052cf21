//! What no lens can be: caught where a lens is read, before hours go into a picture of it.
//!
//! The bounds are far outside of what is built: a telescope's frame spans more than 0.05°, a
//! rectilinear wide-angle stays within 70° of its axis, and distortion moves nothing five times farther
//! out.

use std::ops::RangeInclusive;

use glam::{DVec2, DVec3};

use super::{Distortion, Lens};

/// Narrowest span of a frame's longer side.
const NARROWEST_DEG: f64 = 0.05;
/// Farthest from the axis that a rectilinear lens looks: at 85° the plane at unit distance is 11 wide.
const FARTHEST_DEG: f64 = 85.0;
/// Distorted radius over undistorted.
const STRETCH: RangeInclusive<f64> = 0.02..=5.0;
/// Focal lengths over each other: 0.5 and 2 are anamorphic.
const OBLONG: RangeInclusive<f64> = 0.1..=10.0;
/// Places looked at along each side of the frame.
const PLACES: usize = 16;

impl Lens {
    /// Refuses what no lens of a `width` × `height` picture can be. `Err` is a sentence without the
    /// file's name.
    ///
    /// The lens need not reach the frame's corners: a fisheye's circle may end before, and a model
    /// fitted to few corners may fold there. Nearer than halfway to the border it must not.
    ///
    /// # Errors
    /// A focal length, principal point or distortion outside of what is built.
    pub fn check_plausible(&self, width: usize, height: usize) -> Result<(), String> {
        let Self { fx, fy, cx, cy, .. } = *self;
        let focals = format!("focal lengths of {fx} and {fy} px");
        let span_deg = (width.max(height) as f64 / fx.max(fy)).atan().to_degrees();
        if !(span_deg >= NARROWEST_DEG) {
            return Err(format!(
                "{focals} for {width} × {height} px: the picture would span {span_deg:.1e}°; give \
                 pixels, not millimetres or metres, of this picture's size"
            ));
        }
        if !OBLONG.contains(&(fx / fy)) {
            return Err(format!("{focals}: pixels are not that oblong; both should be alike"));
        }
        let farthest_deg = match self.distortion {
            Distortion::KannalaBrandt { .. } => 180.0,
            _ => FARTHEST_DEG,
        };
        let middle = DVec2::new(width as f64 - 1.0, height as f64 - 1.0) / 2.0;
        for place in border(width, height) {
            for (pixel, must_see) in [(middle.midpoint(place), true), (place, false)] {
                let at = format!("pixel ({:.1}, {:.1})", pixel.x, pixel.y);
                let Some(direction) = self.unproject(pixel) else {
                    if must_see {
                        return Err(format!(
                            "the distortion folds within the picture: no direction, or several, \
                             belong to {at}; {REMEDY}"
                        ));
                    }
                    continue;
                };
                let angle = direction.angle_between(DVec3::NEG_Z);
                if !(angle.to_degrees() <= farthest_deg) {
                    return Err(format!(
                        "{focals} with the principal point at ({cx}, {cy}) px: {at} would look \
                         {:.1}° off the lens's axis; {REMEDY}",
                        angle.to_degrees()
                    ));
                }
                let distorted = ((pixel.x - cx) / fx).hypot((pixel.y - cy) / fy);
                let undistorted = match self.distortion {
                    Distortion::KannalaBrandt { .. } => angle,
                    _ => angle.tan(),
                };
                let stretch = distorted / undistorted;
                if undistorted > 0.0 && !STRETCH.contains(&stretch) {
                    return Err(format!(
                        "the distortion draws {at} {stretch:.2} times as far out as a lens without; \
                         {REMEDY}"
                    ));
                }
            }
        }
        Ok(())
    }
}

const REMEDY: &str = "check focal lengths, principal point and coefficients, and that they belong to \
                      pictures of this size";

/// Pixel positions along the frame's edge.
fn border(width: usize, height: usize) -> impl Iterator<Item = DVec2> {
    let (right, bottom) = (width as f64 - 0.5, height as f64 - 0.5);
    (0..=PLACES).flat_map(move |i| {
        let t = i as f64 / PLACES as f64;
        let (x, y) = (-0.5 + t * (right + 0.5), -0.5 + t * (bottom + 0.5));
        [(x, -0.5), (x, bottom), (-0.5, y), (right, y)].map(|(x, y)| DVec2::new(x, y))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn brown(k1: f64) -> Distortion {
        Distortion::BrownConrady { k1, k2: 0.0, p1: 0.0, p2: 0.0, k3: 0.0 }
    }

    #[test]
    fn lenses_that_are_built_pass() {
        let good = |lens: Lens, w, h| assert_eq!(lens.check_plausible(w, h), Ok(()), "{lens:?}");
        // 800 mm with two doublers, 50 mm and 10 mm on a sensor of 36 mm.
        for focal_mm in [3200.0, 50.0, 10.0] {
            good(Lens::pinhole(focal_mm / 36.0 * 6000.0, 6000, 4000), 6000, 4000);
        }
        let wide = Lens { distortion: brown(-0.1), ..Lens::pinhole(900.0, 1920, 1080) };
        good(wide.clone(), 1920, 1080);
        // A cut-out far from the axis, eight times as large.
        good(wide.cropped(7000.0, 300.0, 8.0), 200, 200);
        let k = Distortion::KannalaBrandt { k1: 0.02, k2: -0.004, k3: 0.0, k4: 0.0 };
        // 185° across a circle inside the frame.
        good(Lens { distortion: k, ..Lens::pinhole(330.0, 1920, 1080) }, 1920, 1080);
        good(Lens::pinhole(1.0, 1, 1), 1, 1);
        // Fitted without corners: folds in the outermost corners, which `calibrate` warns of.
        let folds = Lens { distortion: brown(-0.2), ..wide };
        assert!(!folds.covers(1920, 1080));
        good(folds, 1920, 1080);
    }

    #[test]
    fn lenses_that_nobody_builds_are_refused_with_the_reason() {
        let (w, h) = (1920, 1080);
        let lens = Lens::pinhole(1000.0, w, h);
        for (lens, told) in [
            (Lens::pinhole(1e9, w, h), "span"),
            (Lens::pinhole(1e-3, w, h), "off the lens's axis"),
            (Lens { fx: 1e-9, ..lens.clone() }, "oblong"),
            (Lens { cx: 1e7, ..lens.clone() }, "off the lens's axis"),
            (Lens { cy: -1e12, ..lens.clone() }, "off the lens's axis"),
            (Lens { distortion: brown(1e5), ..lens.clone() }, "times as far"),
            (Lens { distortion: brown(-3.0), ..lens.clone() }, "folds"),
            (Lens { distortion: brown(-1e5), ..lens.clone() }, "folds"),
        ] {
            let said = lens.check_plausible(w, h).unwrap_err();
            assert!(said.contains(told), "{lens:?}: {said}");
        }
        for k1 in [1e9, -1e5, f64::NAN] {
            let distortion = Distortion::KannalaBrandt { k1, k2: 0.0, k3: 0.0, k4: 0.0 };
            let fisheye = Lens { distortion, ..lens.clone() };
            assert!(fisheye.check_plausible(w, h).is_err(), "{k1}");
        }
    }
}
