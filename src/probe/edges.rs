//! Edge points of a picture: place, direction and strength, for finding circles.
//!
//! Works on log luminance at reduced size: a rim between dark metal and dark wall counts like one
//! before a window. Weak edges are kept; what makes a circle of them is for
//! [`circles`](super::circles) to say.

use glam::DVec2;

use crate::conventions::{Rgb, luminance};
use crate::photo::Image;

/// More edge points than this are thinned to the strongest.
const MAX_EDGES: usize = 60_000;
/// Changes of log luminance per pixel: what is an edge begins at three times the quiet parts' gradient,
/// between these.
const LEAST_STRENGTH: f32 = 0.015;
const MOST_NOISE: f32 = 0.08;

/// A point where brightness changes, at the middle of the change.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Edge {
    /// Pixels of the picture the edges were taken from.
    pub at: DVec2,
    /// Unit direction in which it gets brighter.
    pub towards: DVec2,
    /// Change of log luminance per pixel.
    pub strength: f32,
}

/// Log luminance, softened below a twentieth of the bright parts, averaged `factor` × `factor`.
///
/// Incomplete blocks at the right and lower border are left out.
pub fn log_luminance(picture: &Image<Rgb>, factor: usize) -> Image<f32> {
    let factor = factor.max(1);
    let (w, h) = (picture.width() / factor, picture.height() / factor);
    let small = Image::from_fn(w, h, |x, y| {
        let mut sum = 0.0;
        for j in 0..factor {
            for l in &picture.row(y * factor + j)[x * factor..(x + 1) * factor] {
                sum += luminance(*l).max(0.0);
            }
        }
        sum / (factor * factor) as f32
    });
    let mut sorted = small.pixels().to_vec();
    if sorted.is_empty() {
        return small;
    }
    let bright = sorted.len() * 7 / 10;
    let bright = *sorted.select_nth_unstable_by(bright, f32::total_cmp).1;
    let floor = (0.05 * bright).max(1e-12);
    small.map(|l| (l + floor).ln())
}

/// Gaussian blur of standard deviation `sigma` px, the border repeated.
pub fn blur(picture: &Image<f32>, sigma: f64) -> Image<f32> {
    let reach = (3.0 * sigma).ceil() as i64;
    let kernel: Vec<f32> =
        (-reach..=reach).map(|k| (-0.5 * (k as f64 / sigma).powi(2)).exp() as f32).collect();
    let total: f32 = kernel.iter().sum();
    let (w, h) = (picture.width(), picture.height());
    let pass = |source: &Image<f32>, across: bool| {
        Image::from_fn(w, h, |x, y| {
            let sum: f32 = kernel
                .iter()
                .zip(-reach..=reach)
                .map(|(k, offset)| {
                    let (dx, dy) = if across { (offset, 0) } else { (0, offset) };
                    let sx = (x as i64 + dx).clamp(0, w as i64 - 1) as usize;
                    let sy = (y as i64 + dy).clamp(0, h as i64 - 1) as usize;
                    k * source[(sx, sy)]
                })
                .sum();
            sum / total
        })
    };
    pass(&pass(picture, true), false)
}

/// Edge points: ridges of the gradient's length, to a fraction of a pixel.
pub fn edges(log_luminance: &Image<f32>, sigma: f64) -> Vec<Edge> {
    let (w, h) = (log_luminance.width(), log_luminance.height());
    if w < 8 || h < 8 {
        return Vec::new();
    }
    let gradient = gradient(log_luminance, sigma);
    let length = gradient.map(|g| g.length() as f32);
    let threshold = (3.0 * quiet(&length)).clamp(LEAST_STRENGTH, MOST_NOISE);
    let mut found = Vec::new();
    for y in 2..h - 2 {
        for x in 2..w - 2 {
            let here = length[(x, y)];
            if here <= threshold {
                continue;
            }
            let towards = gradient[(x, y)].normalize();
            let at = DVec2::new(x as f64, y as f64);
            let (ahead, behind) =
                (bilinear(&length, at + towards), bilinear(&length, at - towards));
            if here < ahead || here <= behind {
                continue;
            }
            // Top of the parabola through the three lengths.
            let bend = f64::from(ahead + behind - 2.0 * here).min(-1e-12);
            let offset = (0.5 * f64::from(behind - ahead) / bend).clamp(-0.5, 0.5);
            found.push(Edge { at: at + towards * offset, towards, strength: here });
        }
    }
    if found.len() > MAX_EDGES {
        found.sort_by(|a, b| b.strength.total_cmp(&a.strength));
        found.truncate(MAX_EDGES);
    }
    found
}

/// The least blur, from `sigma` px on in doublings up to `most`, at which a noisy picture's quiet parts make
/// no edges.
///
/// Noise of a given strength makes gradients that fall with the square of the blur.
pub fn quiet_sigma(log_luminance: &Image<f32>, mut sigma: f64, most: f64) -> f64 {
    let noisy = |sigma: f64| {
        let length = gradient(log_luminance, sigma).map(|g| g.length() as f32);
        3.0 * quiet(&length) > MOST_NOISE
    };
    while 2.0 * sigma <= most && noisy(sigma) {
        sigma *= 2.0;
    }
    sigma
}

/// Gradient of a picture blurred by `sigma` px, per pixel.
fn gradient(log_luminance: &Image<f32>, sigma: f64) -> Image<DVec2> {
    let (w, h) = (log_luminance.width(), log_luminance.height());
    let smooth = blur(log_luminance, sigma);
    Image::from_fn(w, h, |x, y| {
        let (l, r) = (x.saturating_sub(1), (x + 1).min(w - 1));
        let (t, b) = (y.saturating_sub(1), (y + 1).min(h - 1));
        DVec2::new(
            f64::from(smooth[(r, y)] - smooth[(l, y)]) / (r - l).max(1) as f64,
            f64::from(smooth[(x, b)] - smooth[(x, t)]) / (b - t).max(1) as f64,
        )
    })
}

/// The gradient that 30 % of the picture stay below: its noise, where anything in it is smooth.
fn quiet(length: &Image<f32>) -> f32 {
    let mut sorted = length.pixels().to_vec();
    let at = sorted.len() * 3 / 10;
    if sorted.is_empty() {
        return 0.0;
    }
    *sorted.select_nth_unstable_by(at, f32::total_cmp).1
}

/// Bilinear value, the border repeated.
pub fn bilinear(picture: &Image<f32>, at: DVec2) -> f32 {
    let (w, h) = (picture.width(), picture.height());
    let x = at.x.clamp(0.0, (w - 1) as f64);
    let y = at.y.clamp(0.0, (h - 1) as f64);
    let (i, j) = ((x as usize).min(w.saturating_sub(2)), (y as usize).min(h.saturating_sub(2)));
    let (fx, fy) = ((x - i as f64) as f32, (y - j as f64) as f32);
    let (r, b) = ((i + 1).min(w - 1), (j + 1).min(h - 1));
    let top = picture[(i, j)] * (1.0 - fx) + picture[(r, j)] * fx;
    let bottom = picture[(i, b)] * (1.0 - fx) + picture[(r, b)] * fx;
    top * (1.0 - fy) + bottom * fy
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_disc_has_edges_on_its_circle_pointing_in() {
        let centre = DVec2::new(50.3, 47.8);
        let picture = Image::from_fn(100, 100, |x, y| {
            let r = (DVec2::new(x as f64, y as f64) - centre).length();
            (30.0 - r + 0.5).clamp(0.0, 1.0) as f32
        });
        let found = edges(&picture, 1.0);
        assert!(found.len() > 150, "{} edges", found.len());
        for edge in found {
            let out = edge.at - centre;
            assert!((out.length() - 30.0).abs() < 0.35, "{} px from the centre", out.length());
            assert!(out.normalize().dot(edge.towards) < -0.98);
        }
    }

    /// A disc of half the light in noise: at the blur that quiets it, far more of the edges are its rim's.
    #[test]
    fn noise_is_blurred_until_it_makes_no_edges() {
        let centre = DVec2::new(150.0, 150.0);
        let mut random = crate::probe::rim::XorShift(0x1234_5678_9abc_def1);
        let picture = Image::from_fn(300, 300, |x, y| {
            let r = (DVec2::new(x as f64, y as f64) - centre).length();
            let step = if r < 120.0 { -0.7 } else { 0.0 };
            let noise: f64 = (0..4).map(|_| random.uniform() - 0.5).sum();
            (step + 0.35 * noise) as f32
        });
        let sigma = quiet_sigma(&picture, 0.7, 3.0);
        let on_rim = |sigma: f64| {
            let found = edges(&picture, sigma);
            let near = found.iter().filter(|e| ((e.at - centre).length() - 120.0).abs() < 2.0);
            near.count() as f64 / found.len() as f64
        };
        assert_eq!(sigma, 1.4);
        assert!(on_rim(sigma) > 5.0 * on_rim(0.7), "{} {}", on_rim(0.7), on_rim(sigma));
        assert_eq!(quiet_sigma(&picture, 0.7, 1.0), 0.7);
        assert_eq!(quiet_sigma(&picture.map(|_| 0.0), 0.7, 3.0), 0.7);
    }

    #[test]
    fn flat_and_tiny_pictures_have_no_edges() {
        assert!(edges(&Image::filled(50, 50, 1.0), 1.0).is_empty());
        assert!(edges(&Image::filled(3, 2, 1.0), 1.0).is_empty());
        assert_eq!(log_luminance(&Image::filled(0, 0, Rgb::ZERO), 2).width(), 0);
        assert_eq!(log_luminance(&Image::filled(7, 5, Rgb::ONE), 2).width(), 3);
    }
}
