//! Fading out towards the edge of what may be used.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use rayon::prelude::*;

use crate::photo::Image;

/// 0 at unusable texels, 1 from `feather_rad` away on, `sin²` between: `cos²` counted from the inside.
pub(super) fn taper(usable: &Image<bool>, feather_rad: f64) -> Image<f32> {
    let (w, h) = (usable.width(), usable.height());
    let sphere = Sphere::new(w, h);
    let edge = edge(usable);
    // Edge texels by row, so that each row meets only those near it.
    let mut by_row: Vec<Vec<usize>> = vec![Vec::new(); h];
    for &(x, y) in &edge {
        by_row[y].push(x);
    }
    let reach = (feather_rad / PI * h as f64).ceil() as usize;
    let rows: Vec<Vec<f32>> = (0..h)
        .into_par_iter()
        .map(|y| {
            let mut cosine = vec![-1.0f64; w];
            for v in y.saturating_sub(reach)..(y + reach + 1).min(h) {
                for &x in &by_row[v] {
                    sphere.nearer(&mut cosine, (x, v), y, feather_rad);
                }
            }
            (0..w)
                .map(|x| match usable[(x, y)] {
                    true => fade(cosine[x].clamp(-1.0, 1.0).acos(), feather_rad),
                    false => 0.0,
                })
                .collect()
        })
        .collect();
    Image::from_fn(w, h, |x, y| rows[y][x])
}

fn fade(angle: f64, feather_rad: f64) -> f32 {
    (FRAC_PI_2 * (angle / feather_rad).min(1.0)).sin().powi(2) as f32
}

/// Unusable texels with a usable neighbour.
fn edge(usable: &Image<bool>) -> Vec<(usize, usize)> {
    let (w, h) = (usable.width(), usable.height());
    let mut found = Vec::new();
    for y in 0..h {
        for x in 0..w {
            let beside = [
                ((x + 1) % w, y),
                ((x + w - 1) % w, y),
                (x, (y + 1).min(h - 1)),
                (x, y.saturating_sub(1)),
            ];
            if !usable[(x, y)] && beside.iter().any(|&at| usable[at]) {
                found.push((x, y));
            }
        }
    }
    found
}

/// Sines and cosines of a lat-long's rows and of steps along them.
struct Sphere {
    width: usize,
    /// (sin, cos) of each row's latitude.
    rows: Vec<(f64, f64)>,
    /// Cosine of `k` columns of longitude.
    steps: Vec<f64>,
}

impl Sphere {
    fn new(width: usize, height: usize) -> Self {
        let latitude = |y: usize| (0.5 - (y as f64 + 0.5) / height as f64) * PI;
        Self {
            width,
            rows: (0..height).map(|y| latitude(y).sin_cos()).collect(),
            steps: (0..width).map(|k| (k as f64 * TAU / width as f64).cos()).collect(),
        }
    }

    /// Raises the cosines of row `y` to those of the angles to `from`, within `reach_rad`.
    fn nearer(&self, cosine: &mut [f64], from: (usize, usize), y: usize, reach_rad: f64) {
        let ((s1, c1), (s2, c2)) = (self.rows[from.1], self.rows[y]);
        let least = reach_rad.cos();
        for (k, step) in self.steps.iter().enumerate().take(self.width / 2 + 1) {
            let found = s1 * s2 + c1 * c2 * step;
            if found < least {
                break;
            }
            for x in [(from.0 + k) % self.width, (from.0 + self.width - k) % self.width] {
                cosine[x] = cosine[x].max(found);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::conventions::Rgb;
    use crate::probe::Panorama;

    #[test]
    fn the_fade_is_as_wide_at_the_pole_as_at_the_equator() {
        let panorama = Panorama::from_radiance(Image::filled(720, 360, Rgb::ONE));
        for towards in [DVec3::Z, DVec3::NEG_Z, DVec3::new(0.05, 1.0, 0.0).normalize()] {
            let off = |x: usize, y: usize| panorama.direction(x, y).angle_between(towards);
            let usable = Image::from_fn(720, 360, |x, y| off(x, y) > 0.2);
            let taper = taper(&usable, 0.1);
            for y in 0..360 {
                for x in 0..720 {
                    let expected = fade((off(x, y) - 0.2).max(0.0), 0.1);
                    // The edge is half a degree of texel uncertain: π/2 · 0.012/0.1 of the steepest slope.
                    let error = (taper[(x, y)] - expected).abs();
                    assert!(error < 0.15, "{towards} ({x}, {y}): {} {expected}", taper[(x, y)]);
                }
            }
        }
    }

    #[test]
    fn all_or_nothing_usable_has_no_fade() {
        let all = taper(&Image::filled(16, 8, true), 0.1);
        assert!(all.pixels().iter().all(|t| *t == 1.0));
        let none = taper(&Image::filled(16, 8, false), 0.1);
        assert!(none.pixels().iter().all(|t| *t == 0.0));
    }
}
