//! The found rim drawn over the photograph, for a person to judge.

use glam::DVec2;

use super::find::BallImage;
use crate::camera::Lens;
use crate::conventions::Rgb;
use crate::photo::{Image, tone};

/// The cut-out round the ball, brightened for display (linear, 1 is white), the rim in red and a
/// cross at the direction of the centre; at most `side` px on a side.
pub fn overlay(picture: &Image<Rgb>, lens: &Lens, found: &BallImage, side: usize) -> Image<Rgb> {
    let (w, h) = (picture.width(), picture.height());
    let reach = 1.3 * found.radius_px;
    let least = (found.centre_px - reach).floor().max(DVec2::ZERO);
    let most = (found.centre_px + reach).ceil().min(DVec2::new(w as f64, h as f64) - 1.0);
    let size = (most - least).max(DVec2::splat(1.0));
    // Small balls are enlarged, large ones reduced.
    let scale = (side.max(16) as f64 / size.max_element()).min(8.0);
    let (width, height) = ((size.x * scale) as usize + 1, (size.y * scale) as usize + 1);
    let mut out = Image::from_fn(width, height, |x, y| {
        let p = least + DVec2::new(x as f64, y as f64) / scale;
        let (x, y) = ((p.x.round() as usize).min(w - 1), (p.y.round() as usize).min(h - 1));
        picture[(x, y)]
    });
    let gain = tone::automatic_stops(&out).exp2();
    out.pixels_mut().iter_mut().for_each(|l| *l *= gain);
    let mut mark = |pixel: DVec2| {
        let p = ((pixel - least) * scale).round();
        if p.x >= 0.0 && p.y >= 0.0 && p.x < width as f64 && p.y < height as f64 {
            out[(p.x as usize, p.y as usize)] = Rgb::new(1.0, 0.02, 0.02);
        }
    };
    let steps = (8.0 * found.radius_px * scale) as usize;
    for k in 0..steps {
        let turn = k as f64 / steps as f64 * 2.0 * std::f64::consts::PI;
        if let Some(pixel) = lens.project(found.rim.ray(turn)) {
            mark(pixel);
        }
    }
    for k in -12..=12 {
        let offset = f64::from(k) / scale;
        mark(found.centre_px + DVec2::new(offset, 0.0));
        mark(found.centre_px + DVec2::new(0.0, offset));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::probe::Rim;
    use glam::DVec3;

    #[test]
    fn the_rim_is_drawn_and_balls_over_the_frame_do_no_harm() {
        let lens = Lens::pinhole(500.0, 200, 100);
        let picture = Image::filled(200, 100, Rgb::splat(0.3));
        for half_angle in [0.05, 0.3] {
            let found = BallImage {
                rim: Rim::known(DVec3::NEG_Z, half_angle, 1e-4),
                centre_px: DVec2::new(99.5, 49.5),
                radius_px: 500.0 * half_angle,
                sigma_px: 0.3,
                score: None,
                agreement: None,
                before_black: false,
                rival_px: None,
            };
            let drawn = overlay(&picture, &lens, &found, 300);
            let red = drawn.pixels().iter().filter(|l| l.x > 2.0 * l.y).count();
            assert!(red > 40 && drawn.width() <= 301, "{red} red of {}", drawn.width());
        }
    }
}
