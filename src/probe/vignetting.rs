//! A lens's fall-off of light towards the rim, divided out of a photograph.
//!
//! Either `g(r) = 1 + a r² + b r⁴ + c r⁶` of the distance r from the middle (1 at the rim of a fisheye's
//! image circle, for other lenses at half the picture's diagonal), or a table of angle off the axis and
//! share of light. Radiance is divided by the fall-off, its variance by the square.

use std::path::Path;

use glam::DVec2;
use rayon::prelude::*;

use super::ProbeError;
use crate::bracket::Radiance;

/// A fall-off, 1 where nothing is lost.
///
/// # Guarantees
/// All numbers finite; a table has two rows or more, its angles ascend and its shares are above 0.
#[derive(Clone, Debug, PartialEq)]
pub struct Vignetting(FallOff);

#[derive(Clone, Debug, PartialEq)]
enum FallOff {
    Polynomial([f64; 3]),
    /// Radians off the axis and share of light.
    Table(Vec<[f64; 2]>),
}

/// A pixel that gets less than this share of the light is noise and no measurement.
const LEAST_SHARE: f64 = 0.01;

impl Vignetting {
    /// `1 + a r² + b r⁴ + c r⁶`.
    ///
    /// # Errors
    /// Coefficients that are not finite.
    pub fn polynomial(coefficients: [f64; 3]) -> Result<Self, ProbeError> {
        if coefficients.iter().all(|c| c.is_finite()) {
            return Ok(Self(FallOff::Polynomial(coefficients)));
        }
        Err(wrong(format!("{coefficients:?}"), "three finite numbers"))
    }

    /// A table of `[angle off the axis in degrees, share of light]`, linear between its rows.
    ///
    /// # Errors
    /// Fewer than two rows, angles that do not ascend from 0° or above, shares of 0 or below.
    pub fn table(rows: &[[f64; 2]]) -> Result<Self, ProbeError> {
        let ascending = rows.windows(2).all(|pair| pair[0][0] < pair[1][0]);
        let possible = |&[angle, share]: &[f64; 2]| {
            (0.0..=180.0).contains(&angle) && share.is_finite() && share > 0.0
        };
        if rows.len() < 2 || !ascending || !rows.iter().all(possible) {
            let found = format!("a table of {} rows", rows.len());
            return Err(wrong(
                found,
                "two rows or more of an angle (0 to 180 degrees, ascending) and a share above 0",
            ));
        }
        let rows = rows.iter().map(|&[angle, share]| [angle.to_radians(), share]).collect();
        Ok(Self(FallOff::Table(rows)))
    }

    /// Reads a table: an angle in degrees and a share of light a line; `#` begins a comment.
    ///
    /// # Errors
    /// A file that cannot be read, a line that is not two numbers, or what [`table`](Self::table) refuses.
    pub fn read(path: &Path) -> Result<Self, ProbeError> {
        let text = std::fs::read_to_string(path).map_err(|cause| {
            wrong(
                format!("{}: {cause}", path.display()),
                "a text file of angles and shares of light",
            )
        })?;
        let mut rows = Vec::new();
        for (n, line) in text.lines().enumerate() {
            let line = line.split('#').next().unwrap_or("").trim();
            if line.is_empty() {
                continue;
            }
            let words = line.split([' ', '\t', ',', ';']).filter(|word| !word.is_empty());
            let numbers: Result<Vec<f64>, _> = words.map(str::parse).collect();
            match numbers.as_deref() {
                Ok(&[angle, share]) => rows.push([angle, share]),
                _ => {
                    return Err(wrong(
                        format!("{}: line {}: {line:?}", path.display(), n + 1),
                        "an angle in degrees and a share of light",
                    ));
                }
            }
        }
        Self::table(&rows)
    }

    /// Share of the light that arrives at `radius` (of the rim's) and `angle_rad` off the axis.
    pub fn share(&self, radius: f64, angle_rad: f64) -> f64 {
        match &self.0 {
            FallOff::Polynomial([a, b, c]) => {
                let s = radius * radius;
                1.0 + s * (a + s * (b + s * c))
            }
            FallOff::Table(rows) => {
                let after = rows.partition_point(|row| row[0] < angle_rad);
                let (Some(before), Some(next)) = (rows.get(after.wrapping_sub(1)), rows.get(after))
                else {
                    // Before the first row or after the last: the nearest.
                    return rows[after.min(rows.len() - 1)][1];
                };
                let t = (angle_rad - before[0]) / (next[0] - before[0]);
                before[1] + t * (next[1] - before[1])
            }
        }
    }

    /// Divides the fall-off out of a photograph.
    ///
    /// `off_axis` gives the radius and the angle (radians) of a pixel; pixels where it gives nothing are
    /// not shown and stay as they are.
    ///
    /// # Errors
    /// A pixel that is shown and would get less than a hundredth of the light.
    pub fn divide_out(
        &self,
        radiance: &mut Radiance,
        off_axis: impl Fn(DVec2) -> Option<(f64, f64)> + Sync,
    ) -> Result<(), ProbeError> {
        let (width, height) = (radiance.mean.width(), radiance.mean.height());
        let gains: Vec<f32> = (0..width * height)
            .into_par_iter()
            .map(|k| {
                let pixel = DVec2::new((k % width) as f64, (k / width) as f64);
                let Some((radius, angle)) = off_axis(pixel) else { return Ok(1.0) };
                let share = self.share(radius, angle);
                if share >= LEAST_SHARE {
                    return Ok((1.0 / share) as f32);
                }
                let found = format!("{share:.4} at {:.1} degrees off the axis", angle.to_degrees());
                Err(wrong(found, "a share of at least 0.01 wherever the picture shows something"))
            })
            .collect::<Result<_, _>>()?;
        let pixels = radiance.mean.pixels_mut().iter_mut().zip(radiance.variance.pixels_mut());
        for ((mean, variance), gain) in pixels.zip(gains) {
            *mean *= gain;
            *variance *= gain * gain;
        }
        Ok(())
    }
}

fn wrong(found: String, expected: &'static str) -> ProbeError {
    ProbeError::Value { what: "the vignetting", found, expected }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bracket::Validity;
    use crate::conventions::Rgb;
    use crate::photo::Image;
    use crate::probe::fisheye::{Fisheye, Projection};

    fn fisheye() -> Fisheye {
        Fisheye::new(Projection::Equidistant, 180.0, None, [200, 200]).unwrap()
    }

    /// Light of 2 behind a lens that falls off as `share` says.
    fn darkened(share: impl Fn(f64, f64) -> f64) -> Radiance {
        let at = |x: usize, y: usize| {
            let off_axis = fisheye().off_axis(DVec2::new(x as f64, y as f64));
            off_axis.map_or(1.0, |(radius, angle)| share(radius, angle)) as f32
        };
        Radiance {
            mean: Image::from_fn(200, 200, |x, y| Rgb::splat(2.0 * at(x, y))),
            variance: Image::from_fn(200, 200, |x, y| Rgb::splat(at(x, y).powi(2))),
            validity: Image::filled(200, 200, Validity::Measured),
        }
    }

    #[test]
    fn what_the_lens_took_is_given_back() {
        let polynomial = Vignetting::polynomial([-0.3, 0.1, -0.2]).unwrap();
        let rows: Vec<[f64; 2]> =
            (0..=90).map(|k| [f64::from(k), f64::from(k).to_radians().cos() + 0.1]).collect();
        let table = Vignetting::table(&rows).unwrap();
        let mut by_polynomial =
            darkened(|r, _| 1.0 - 0.3 * r.powi(2) + 0.1 * r.powi(4) - 0.2 * r.powi(6));
        polynomial.divide_out(&mut by_polynomial, |p| fisheye().off_axis(p)).unwrap();
        let mut by_table = darkened(|_, angle| angle.cos() + 0.1);
        table.divide_out(&mut by_table, |p| fisheye().off_axis(p)).unwrap();
        for y in 0..200 {
            for x in 0..200 {
                if fisheye().off_axis(DVec2::new(x as f64, y as f64)).is_none() {
                    continue;
                }
                let (l, v) = (by_polynomial.mean[(x, y)].x, by_polynomial.variance[(x, y)].x);
                assert!((l / 2.0 - 1.0).abs() < 1e-6 && (v - 1.0).abs() < 1e-5, "({x}, {y}): {l}");
                // A straight line between whole degrees: h²/8 of the cosine.
                assert!((by_table.mean[(x, y)].x / 2.0 - 1.0).abs() < 5e-4, "({x}, {y})");
            }
        }
    }

    #[test]
    fn impossible_fall_offs_are_refused() {
        assert!(Vignetting::polynomial([0.0, f64::NAN, 0.0]).is_err());
        for rows in [
            &[][..],
            &[[0.0, 1.0]],
            &[[10.0, 1.0], [5.0, 0.9]],
            &[[0.0, 1.0], [90.0, 0.0]],
            &[[0.0, 1.0], [90.0, f64::NAN]],
        ] {
            assert!(Vignetting::table(rows).is_err(), "{rows:?}");
        }
        let black = Vignetting::polynomial([-1.0, 0.0, 0.0]).unwrap();
        let said = black.divide_out(&mut darkened(|_, _| 1.0), |p| fisheye().off_axis(p));
        assert!(said.unwrap_err().to_string().contains("degrees off the axis"));
    }

    #[test]
    fn tables_are_read_with_their_comments() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lens.txt");
        std::fs::write(&path, "# degrees share\n0 1\n45, 0.8 # measured\n\n90\t0.5\n").unwrap();
        let table = Vignetting::read(&path).unwrap();
        assert!((table.share(0.0, 22.5f64.to_radians()) - 0.9).abs() < 1e-12);
        assert!((table.share(0.0, 2.0) - 0.5).abs() < 1e-12, "beyond the table: its last");
        std::fs::write(&path, "0 1\nninety 0.5\n").unwrap();
        assert!(Vignetting::read(&path).unwrap_err().to_string().contains("line 2"));
        assert!(Vignetting::read(Path::new("nowhere.txt")).is_err());
    }
}
