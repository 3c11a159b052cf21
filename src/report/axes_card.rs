//! A picture of directions with its axes named on it: orientation to check by eye, in any program.

use glam::{DVec2, DVec3};

use super::canvas::{Canvas, Colour};
use crate::conventions::Rgb;
use crate::photo::Image;

/// The six axes, each in a colour of its own: red, green and blue, and what is left of white.
const AXES: [(DVec3, &str, Colour); 6] = [
    (DVec3::X, "+X", [255, 70, 70]),
    (DVec3::NEG_X, "-X", [70, 255, 255]),
    (DVec3::Y, "+Y", [70, 255, 70]),
    (DVec3::NEG_Y, "-Y", [255, 70, 255]),
    (DVec3::Z, "+Z", [80, 110, 255]),
    (DVec3::NEG_Z, "-Z", [255, 255, 70]),
];

/// How much of the picture's light is left under the letters.
const DIMMED: f32 = 0.3;

/// Points of each great circle.
const POINTS: usize = 1440;

/// `picture` (display-linear) dimmed, with the three great circles through the axes, a dot for each axis,
/// its name, and `title` in a corner. `pixel` says where a world direction is.
pub fn axes_card(
    picture: &Image<Rgb>,
    pixel: impl Fn(DVec3) -> Option<DVec2>,
    title: &str,
) -> Canvas {
    let size = DVec2::new(picture.width() as f64, picture.height() as f64);
    let longer = size.max_element();
    let mut canvas = Canvas::new(&picture.map(|&l| l * DIMMED));
    for (a, b) in [(DVec3::X, DVec3::Z), (DVec3::X, DVec3::Y), (DVec3::Y, DVec3::Z)] {
        let mut path: Vec<Option<DVec2>> = Vec::new();
        let mut last: Option<DVec2> = None;
        for k in 0..=POINTS {
            let turn = std::f64::consts::TAU * k as f64 / POINTS as f64;
            let here = pixel(a * turn.cos() + b * turn.sin());
            // Over a seam or a cut the line goes on elsewhere.
            if let (Some(here), Some(last)) = (here, last)
                && here.distance(last) > longer / 40.0
            {
                path.push(None);
            }
            path.push(here);
            last = here;
        }
        canvas.faint_path(&path, [255, 255, 255]);
    }
    let radius = (longer / 150.0).max(2.0);
    for (axis, name, colour) in AXES {
        if let Some(at) = pixel(axis) {
            canvas.disc(at, radius, colour);
            canvas.text(at + DVec2::new(1.5 * radius, -1.5 * radius), name, colour);
        }
    }
    canvas.text(DVec2::new(0.0, size.y), title, [255, 255, 255]);
    canvas
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::conventions::lat_long_pixel;
    use crate::photo::Samples;

    #[test]
    fn dots_have_their_axes_colours() {
        let picture = Image::filled(600, 300, Rgb::splat(0.5));
        let at = |d: DVec3| Some(lat_long_pixel(d, 600, 300));
        let card = axes_card(&picture, at, "latlong");
        let (width, _, Samples::U8 { data, .. }) = card.into_samples() else { panic!() };
        for (axis, name, colour) in AXES {
            let p = lat_long_pixel(axis, 600, 300).round();
            let (x, y) = (p.x.clamp(0.0, 599.0) as usize, p.y.clamp(0.0, 299.0) as usize);
            let there = &data[3 * (y * width + x)..][..3];
            assert_eq!(there, colour, "{name}");
        }
        // Dimmed, not gone.
        let plain = &data[3 * (40 * width + 20)..][..3];
        assert!(plain.iter().all(|&v| v > 50 && v < 188), "{plain:?}");
    }
}
