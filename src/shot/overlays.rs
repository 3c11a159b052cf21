//! The overlays of a shot: what was found, over the photographs it was found in.

use glam::{DVec2, DVec3};

use super::place;
use super::plan::Plan;
use super::prepare::Prepared;
use crate::camera::Camera;
use crate::conventions::Rgb;
use crate::light::Lights;
use crate::photo::{self, Image, Photo, ReadOptions};
use crate::report::{Canvas, overlay};

/// One overlay, ready to be written as `name.png`.
pub struct Overlay {
    pub name: &'static str,
    pub title: &'static str,
    pub caption: &'static str,
    pub canvas: Canvas,
}

/// All overlays that the shot has photographs for.
pub fn draw(plan: &Plan, prepared: &Prepared) -> Vec<Overlay> {
    let mut overlays = vec![support(plan, prepared)];
    overlays.extend(ball(plan, prepared));
    overlays.extend(pose(plan, prepared));
    overlays.push(panorama(prepared));
    overlays
}

/// Longest side of pictures that are only looked at, pixels: a screen has no more.
const LONGEST: usize = 4096;

/// How many pixels of a picture become one, across and down, where it is only looked at.
pub fn reduction(picture: &Image<Rgb>) -> usize {
    picture.width().max(picture.height()).div_ceil(LONGEST).max(1)
}

/// The camera of a picture reduced so.
fn reduced_camera(camera: &Camera, n: usize) -> Camera {
    camera.cropped(0.0, 0.0, 1.0 / n as f64, camera.width / n, camera.height / n)
}

fn support(plan: &Plan, prepared: &Prepared) -> Overlay {
    let n = reduction(&plan.plate.linear);
    let mut canvas = Canvas::of(&plan.plate, n);
    let camera = &reduced_camera(&prepared.camera, n);
    let foot = place::foot(plan);
    // One step of the axes is about a tenth of the distance: well seen at any scale.
    let step = round_length(0.1 * camera.pose.position().distance(foot));
    if let Some(ground) = place::ground(plan) {
        overlay::support(&mut canvas, camera, &ground, foot, step);
    }
    for (name, corners) in place::object_boxes(plan) {
        overlay::object_box(&mut canvas, camera, &corners, name);
    }
    overlay::horizon(&mut canvas, camera);
    let (lights, origin) = (&prepared.light.lights, prepared.scene.origin);
    if let Some(toward) = strongest(lights, origin, foot + DVec3::Y * step) {
        overlay::shadow_direction(&mut canvas, camera, foot, step, toward);
    }
    Overlay {
        name: "overlay_support",
        title: "Support, axes, objects and shadow over the plate",
        caption: "White: the modelled support. Cyan: the objects' boxes. Red, green, blue: the world's X, \
                  Y, Z, as long as is written beside X. Yellow: the horizon, and the shadow of an upright stick in the strongest sun or lamp; compare \
                  it with real shadows.",
        canvas,
    }
}

/// Unit direction from the world point `tip` to the sun or lamp that lights it most.
///
/// `origin` is the place in the world that the lamps' centres are relative to.
fn strongest(lights: &Lights, origin: DVec3, tip: DVec3) -> Option<DVec3> {
    let suns = lights.suns.iter().map(|sun| (sun.direction.as_dvec3(), sun.flux()));
    let lamps = lights.lamps.iter().map(|lamp| {
        let way = origin + lamp.centre.as_dvec3() - tip;
        // Solid angle of a small sphere; only compared.
        let share = lamp.radius * lamp.radius / way.length_squared() as f32;
        (way.normalize_or(DVec3::Y), std::f32::consts::PI * share * lamp.radiance.max_element())
    });
    suns.chain(lamps).max_by(|a, b| a.1.total_cmp(&b.1)).map(|(toward, _)| toward)
}

fn ball(plan: &Plan, prepared: &Prepared) -> Option<Overlay> {
    let (camera, rim) = prepared.light.ball.as_ref()?;
    // The middle exposure shows the rim best.
    let photo = plan.probe_photos.get(plan.probe_photos.len() / 2)?;
    let photo = Photo::from(photo.clone());
    let n = reduction(&photo.linear);
    let mut canvas = Canvas::new(&bright(&photo).reduced(n));
    overlay::rim(&mut canvas, &reduced_camera(camera, n), rim.axis, rim.half_angle_rad);
    Some(Overlay {
        name: "overlay_ball",
        title: "Rim of the mirror ball",
        caption: "Yellow: the rim as fitted. It should follow the ball's outline all round.",
        canvas,
    })
}

fn pose(plan: &Plan, prepared: &Prepared) -> Option<Overlay> {
    let first = prepared.seen.first()?;
    let (mut canvas, n) = match &first.photo {
        Some(path) => {
            // It was read a moment ago; if it is gone since, there is no overlay.
            let photo = photo::read(path, &ReadOptions::default()).ok()?;
            let n = reduction(&photo.linear);
            (Canvas::new(&bright(&photo).reduced(n)), n)
        }
        None => {
            let n = reduction(&plan.plate.linear);
            (Canvas::of(&plan.plate, n), n)
        }
    };
    let reduced = |pixel: DVec2| (pixel + 0.5) / n as f64 - 0.5;
    for seen in prepared.seen.iter().filter(|seen| seen.photo == first.photo) {
        let measured: Vec<_> = seen.sightings.iter().map(|s| reduced(s.pixel)).collect();
        let expected = seen.sightings.iter().map(|s| prepared.seen_by.project_world(s.world));
        let expected: Vec<_> = expected.map(|pixel| pixel.map(reduced)).collect();
        overlay::corners(&mut canvas, &measured, &expected);
    }
    Some(Overlay {
        name: "overlay_pose",
        title: "What gave the camera's place",
        caption: "Green: corners as measured. Red: where lens and pose expect them.",
        canvas,
    })
}

/// 1, 2 or 5 times a power of ten, just below `length`.
fn round_length(length: f64) -> f64 {
    let decade = 10f64.powf(length.log10().floor());
    let leading = length / decade;
    decade
        * if leading >= 5.0 {
            5.0
        } else if leading >= 2.0 {
            2.0
        } else {
            1.0
        }
}

fn panorama(prepared: &Prepared) -> Overlay {
    Overlay {
        name: "overlay_panorama",
        title: "The panorama, in the plate's exposure",
        caption: "Lat-long, seen from inside: +Z in the middle, +X a quarter from the left, up is up. \
                  Lights taken out and sampled on their own are filled from their surroundings.",
        canvas: Canvas::new(&thinned(&prepared.light.panorama.radiance)),
    }
}

/// Every n-th pixel of every n-th row, so that it is at most [`MAX_WIDTH`] wide: the whole picture.
fn thinned(picture: &Image<Rgb>) -> Image<Rgb> {
    let step = picture.width().div_ceil(MAX_WIDTH).max(1);
    let (width, height) = (picture.width().div_ceil(step), picture.height().div_ceil(step));
    Image::from_fn(width, height, |x, y| picture[(x * step, y * step)])
}

/// The report shows the panorama no wider than this.
const MAX_WIDTH: usize = 1024;

/// The photograph, lifted so that its bright part is near white.
fn bright(photo: &Photo) -> Image<Rgb> {
    let mut values: Vec<f32> =
        photo.linear.pixels().iter().map(|l| l.max_element()).filter(|v| v.is_finite()).collect();
    if values.is_empty() {
        return photo.linear.clone();
    }
    let at = values.len() * 95 / 100;
    let (_, &mut high, _) = values.select_nth_unstable_by(at, f32::total_cmp);
    let gain = if high > 0.0 { 0.8 / high } else { 1.0 };
    photo.linear.map(|l| *l * gain)
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;

    #[test]
    fn a_thinned_picture_shows_all_of_it() {
        for (width, expected) in [(2000, 1000), (1024, 1024), (1025, 513), (4096, 1024), (1, 1)] {
            let picture = Image::from_fn(width, 4, |x, _| Rgb::splat(x as f32));
            let thin = thinned(&picture);
            assert_eq!(thin.width(), expected);
            let last = thin[(expected - 1, 0)].x as usize;
            assert!(width - last <= width.div_ceil(MAX_WIDTH), "column {last} of {width}");
        }
    }

    #[test]
    fn a_near_lamp_throws_the_shadow_where_it_outshines_the_sun() {
        use crate::light::{Disc, Lamp, LightOptions};
        use crate::probe::Panorama;
        let dim = Panorama::from_radiance(Image::filled(16, 8, Rgb::splat(0.1)));
        let mut lights = Lights::new(&dim, &LightOptions::default()).expect("light all round");
        let (origin, tip) = (DVec3::new(10.0, 0.0, 0.0), DVec3::new(10.0, 0.1, 0.0));
        assert_eq!(strongest(&lights, origin, tip), None);
        let radiance = Rgb::splat(1000.0);
        let sun = Disc { direction: Vec3::X, half_angle: 0.005, radiance };
        lights = Lights::from_parts(lights.environment, vec![sun]);
        assert_eq!(strongest(&lights, origin, tip), Some(DVec3::X));
        // 0.03 m at 0.5 m: 144 times the sun's solid angle.
        lights.lamps.push(Lamp { centre: Vec3::new(0.0, 0.5, 0.3), radius: 0.03, radiance });
        let toward = strongest(&lights, origin, tip).expect("a lamp");
        assert!((toward - DVec3::new(0.0, 0.8, 0.6)).length() < 1e-6, "{toward}");
    }

    #[test]
    fn lengths_round_to_1_2_5() {
        for (length, round) in [(0.14, 0.1), (0.26, 0.2), (7.0, 5.0), (0.099, 0.05)] {
            assert!((round_length(length) - round).abs() < 1e-12, "{length}");
        }
    }
}
