//! What was found, drawn over the photographs it was found in.

use std::f64::consts::TAU;

use glam::{DVec2, DVec3};

use super::canvas::{Canvas, Colour};
use super::text::length;
use crate::camera::Camera;

const RED: Colour = [255, 64, 64];
const GREEN: Colour = [64, 220, 64];
const BLUE: Colour = [80, 140, 255];
const WHITE: Colour = [255, 255, 255];
const YELLOW: Colour = [255, 220, 0];
const CYAN: Colour = [0, 235, 255];

/// A plane rectangle in the world that stands for the support.
#[derive(Clone, Copy, Debug)]
pub struct Ground {
    pub centre: DVec3,
    /// Unit vectors along its sides.
    pub sides: [DVec3; 2],
    /// Half its lengths along the sides, metres.
    pub half_size: [f64; 2],
}

/// Draws the support as a grid of `step` metres and the world's axes (X red, Y green, Z blue, one
/// step long, which is written beside them) from `origin`.
pub fn support(canvas: &mut Canvas, camera: &Camera, ground: &Ground, origin: DVec3, step: f64) {
    for (along, across) in [(0, 1), (1, 0)] {
        // At most 40 lines a side: more would hide the photograph.
        let n = ((ground.half_size[across] / step).floor() as i64).clamp(1, 20);
        for i in -n..=n {
            let offset = ground.sides[across] * (i as f64 * ground.half_size[across] / n as f64);
            let reach = ground.sides[along] * ground.half_size[along];
            let start = ground.centre + offset;
            let points = seen(camera, start - reach, start + reach);
            if i.abs() == n {
                canvas.path(&points, WHITE);
            } else {
                canvas.faint_path(&points, WHITE);
            }
        }
    }
    let axes = [(DVec3::X, RED, "X"), (DVec3::Y, GREEN, "Y"), (DVec3::Z, BLUE, "Z")];
    for (axis, colour, name) in axes {
        let tip = origin + axis * step;
        let name = if name == "X" { format!("X {}", length(step)) } else { name.to_owned() };
        label_beyond(canvas, camera, [origin, tip], &name, colour);
    }
    // After the letters, which in a small picture lie on them.
    for (axis, colour, _) in axes {
        canvas.path(&seen(camera, origin, origin + axis * step), colour);
    }
}

/// Draws the edges of an object's box, its corners counted in binary (x, y, z), and its name.
pub fn object_box(canvas: &mut Canvas, camera: &Camera, corners: &[DVec3; 8], name: &str) {
    for i in 0..8 {
        for axis in [1, 2, 4].into_iter().filter(|axis| i & axis == 0) {
            canvas.path(&seen(camera, corners[i], corners[i | axis]), CYAN);
        }
    }
    let middle = corners.iter().sum::<DVec3>() / 8.0;
    let top = corners.iter().map(|c| c.y).fold(f64::NEG_INFINITY, f64::max);
    label(canvas, camera, DVec3::new(middle.x, top, middle.z), name, CYAN);
}

/// Writes beside a world point, if the picture shows it.
fn label(canvas: &mut Canvas, camera: &Camera, at: DVec3, text: &str, colour: Colour) {
    let Some(at) = camera.project_world(at).filter(|p| camera.shows(*p)) else { return };
    let gap = 0.5 * canvas.letter_height();
    canvas.text(at + DVec2::new(gap, -gap), text, colour);
}

/// Writes where a line from the first to the second point would go on.
fn label_beyond(
    canvas: &mut Canvas,
    camera: &Camera,
    line: [DVec3; 2],
    text: &str,
    colour: Colour,
) {
    let [from, to] = line.map(|point| camera.project_world(point));
    let (Some(from), Some(to)) = (from, to.filter(|p| camera.shows(*p))) else { return };
    let high = canvas.letter_height();
    let middle = to + (to - from).normalize_or(DVec2::X) * high;
    // The first letter's middle; the others follow to the right.
    canvas.text(middle + DVec2::new(-0.35, 0.5) * high, text, colour);
}

/// Draws where the shadow of an upright stick at `foot` falls in the light from `toward_sun`.
///
/// Compare it with real shadows in the plate. A sun at or below the horizon draws nothing.
pub fn shadow_direction(
    canvas: &mut Canvas,
    camera: &Camera,
    foot: DVec3,
    height: f64,
    toward_sun: DVec3,
) {
    if toward_sun.y <= 0.02 {
        return;
    }
    let tip = foot + DVec3::Y * height;
    let shadow_tip = tip - toward_sun * (height / toward_sun.y);
    canvas.path(&seen(camera, foot, tip), GREEN);
    canvas.path(&seen(camera, foot, shadow_tip), YELLOW);
    label(canvas, camera, shadow_tip, "shadow", YELLOW);
}

/// Draws the horizon: where level directions are seen.
pub fn horizon(canvas: &mut Canvas, camera: &Camera) {
    let rotation = camera.pose.rotation();
    let points: Vec<_> = (0..=720)
        .map(|i| {
            let (sin, cos) = (f64::from(i) / 720.0 * TAU).sin_cos();
            camera.lens.project(rotation.inverse() * DVec3::new(sin, 0.0, cos))
        })
        .map(|point| point.filter(|p| near_frame(camera, *p)))
        .collect();
    canvas.path(&points, YELLOW);
    let leftmost = points.iter().flatten().filter(|p| camera.shows(**p));
    if let Some(at) = leftmost.min_by(|a, b| a.x.total_cmp(&b.x)) {
        // Below the line: it is often at the upper edge.
        canvas.text(*at + DVec2::Y * 2.0 * canvas.letter_height(), "horizon", YELLOW);
    }
}

/// Draws the rim of a ball: the tangent cone of half-angle `half_angle` round `axis` (unit, camera
/// axes), as the lens shows it.
pub fn rim(canvas: &mut Canvas, camera: &Camera, axis: DVec3, half_angle: f64) {
    let (side, up) = axis.any_orthonormal_pair();
    let points: Vec<_> = (0..=360)
        .map(|i| {
            let (sin, cos) = (f64::from(i) / 360.0 * TAU).sin_cos();
            let across = (side * cos + up * sin) * half_angle.sin();
            camera.lens.project(axis * half_angle.cos() + across)
        })
        .collect();
    canvas.path(&points, YELLOW);
    if let Some(centre) = camera.lens.project(axis) {
        canvas.cross(centre, canvas.letter_height(), YELLOW);
    }
}

/// Draws measured points as green circles and where the model expects them as red crosses.
pub fn corners(canvas: &mut Canvas, measured: &[DVec2], expected: &[Option<DVec2>]) {
    let radius = 0.7 * canvas.letter_height();
    for &point in measured {
        canvas.circle(point, radius, GREEN);
    }
    for point in expected.iter().flatten() {
        canvas.cross(*point, 0.6 * radius, RED);
    }
}

/// A world line as the lens shows it: bent by distortion, cut where it is not seen.
fn seen(camera: &Camera, from: DVec3, to: DVec3) -> Vec<Option<DVec2>> {
    const PIECES: usize = 64;
    (0..=PIECES)
        .map(|i| camera.project_world(from.lerp(to, i as f64 / PIECES as f64)))
        .map(|point| point.filter(|p| near_frame(camera, *p)))
        .collect()
}

/// Far outside the frame a lens model says nothing, and lines would cross the picture at random.
fn near_frame(camera: &Camera, p: DVec2) -> bool {
    let (w, h) = (camera.width as f64, camera.height as f64);
    p.x > -w && p.x < 2.0 * w && p.y > -h && p.y < 2.0 * h
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{Lens, Pose};
    use crate::conventions::Rgb;
    use crate::photo::{Image, Samples};

    fn camera() -> Camera {
        let pose = Pose::look_at(DVec3::new(0.0, 1.0, 1.0), DVec3::ZERO, DVec3::Y);
        Camera {
            width: 64,
            height: 64,
            lens: Lens::pinhole(64.0, 64, 64),
            pose: pose.expect("looks at the origin"),
        }
    }

    fn drawn(draw: impl FnOnce(&mut Canvas)) -> Vec<u8> {
        let mut canvas = Canvas::new(&Image::filled(64, 64, Rgb::ZERO));
        draw(&mut canvas);
        let (.., Samples::U8 { data, .. }) = canvas.into_samples() else { panic!() };
        data
    }

    #[test]
    fn axes_point_right_up_and_toward_the_camera() {
        let ground = Ground {
            centre: DVec3::new(50.0, 0.0, 50.0),
            sides: [DVec3::X, DVec3::Z],
            half_size: [0.1, 0.1],
        };
        let data = drawn(|c| support(c, &camera(), &ground, DVec3::ZERO, 0.3));
        let colour = |x: usize, y: usize| &data[3 * (64 * y + x)..][..3];
        let right = colour(38, 31);
        assert!(right[0] > 200 && right[2] < 100, "X axis is red: {right:?}");
        let up = colour(31, 26);
        assert!(up[1] > 150 && up[0] < 100, "Y axis is green: {up:?}");
        let near = colour(31, 37);
        assert!(near[2] > 150 && near[0] < 120, "Z axis is blue: {near:?}");
    }

    #[test]
    fn shadow_falls_away_from_the_sun() {
        let sun = DVec3::new(-1.0, 1.0, 0.0).normalize();
        let data = drawn(|c| shadow_direction(c, &camera(), DVec3::ZERO, 0.2, sun));
        let right = &data[3 * (64 * 31 + 36)..][..3];
        assert!(right[0] > 150 && right[1] > 150, "the sun is left, the shadow right: {right:?}");
        let below = drawn(|c| shadow_direction(c, &camera(), DVec3::ZERO, 0.2, -sun));
        assert!(below.iter().all(|&v| v == 0));
    }
}
