//! Light from near by: walls and lamps at their place, in both worlds.

use glam::{DVec2, DVec3, Vec3};

use super::Method;
use super::test_scenes::*;
use crate::camera::{Camera, Lens, Pose};
use crate::conventions::Rgb;
use crate::light::{Environment, Lamp, Lights, Proxy};
use crate::photo::Image;
use crate::scene::AlbedoSource;

/// A dark room with a window in the wall toward −x, seen from `place`, and a lamp.
pub fn room(lamp: Option<Lamp>) -> Lights {
    let place = Vec3::new(0.0, 0.1, 0.0);
    let (min, max) = (Vec3::new(-1.5, -0.7, -2.0), Vec3::new(2.0, 1.8, 1.9));
    let picture = Image::from_fn(256, 128, |i, j| {
        let at = DVec2::new(i as f64, j as f64);
        let d = crate::conventions::lat_long_direction(at, 256, 128);
        let p = d * (1.5 / -d.x);
        let window = d.x < 0.0 && (0.3..1.3).contains(&p.y) && p.z.abs() < 0.6;
        if window { Rgb::new(4.0, 5.0, 6.0) } else { Rgb::new(0.3, 0.25, 0.2) }
    });
    let environment = Environment::new(&picture, glam::DQuat::IDENTITY, true).unwrap();
    let proxy = Proxy::of_box(place, min, max).unwrap();
    Lights::from_parts(environment, Vec::new()).near(place, Some(proxy), lamp.into_iter().collect())
}

pub fn table_lamp() -> Lamp {
    Lamp { centre: Vec3::new(0.7, 0.6, 0.3), radius: 0.08, radiance: Rgb::new(60.0, 40.0, 20.0) }
}

/// A plate that shows a matt ground of albedo `rho` in the light of its own places.
pub fn plate_of_lit_ground(lights: &Lights, camera: &Camera, rho: f32) -> Image<Rgb> {
    Image::from_fn(camera.width, camera.height, |x, y| {
        let Some((eye, direction)) = camera.ray(DVec2::new(x as f64, y as f64)) else {
            return Rgb::ZERO;
        };
        let ground: DVec3 = eye + direction * (-eye.y / direction.y);
        let radiance = lights.irradiance_at(ground.as_vec3(), Vec3::Y) * rho;
        radiance * std::f32::consts::FRAC_1_PI
    })
}

fn dark_with(lamp: Lamp) -> Lights {
    let dark = Lights::from_parts(Environment::constant(Rgb::ZERO), Vec::new());
    dark.near(Vec3::ZERO, None, vec![lamp])
}

/// A camera that looks at one point of the ground from low on the side, through tiny pixels.
fn camera_at(x: f64, side: f64) -> Camera {
    let (eye, target) = (DVec3::new(x + side, 2.0, 0.0), DVec3::new(x, 0.0, 0.0));
    let pose = Pose::look_at(eye, target, DVec3::Y).unwrap();
    Camera { width: 4, height: 4, lens: Lens::pinhole(1e5, 4, 4), pose }
}

#[test]
fn an_object_before_a_lamp_shadows_it_and_one_behind_it_does_not() {
    let grey = AlbedoSource::Constant(Rgb::splat(0.5));
    let lamp = Lamp { centre: Vec3::Y * 0.5, radius: 0.05, radiance: Rgb::ONE };
    let (lights, camera) = (dark_with(lamp), camera_at(0.1, 20.0));
    let plate = plate_of_lit_ground(&lights, &camera, 0.5);
    // Black balls that hide the lamp from this point, or would if they stood before it.
    let before = sphere(Vec3::new(0.05, 0.25, 0.0), 0.07, 4);
    let behind = sphere(Vec3::Y * 0.8, 0.2, 4);
    for method in [Method::Coupled, Method::TwoPass { same_numbers: true }] {
        for (name, ball, wanted) in [("before", &before, -1.0), ("behind", &behind, 0.0)] {
            let scene = scene(vec![ball.clone()], matt(0.0), vec![local(ground(3.0), grey)]);
            let d = render(&scene, &lights, &camera, &plate, method, 256, 1);
            let (mean, sigma) = mean_ratio(&d);
            // 5 σ of 15 degrees of freedom: a false alarm in 1500 runs of four tests. Behind: exactly 0.
            assert!((mean - wanted).abs() <= 5.0 * sigma, "{method:?}, {name}: {mean} ± {sigma}");
        }
    }
}

#[test]
fn a_penumbra_is_the_hidden_part_of_the_lamp() {
    // A black half-plane at half the lamp's height hides the half of it that lies beyond the edge.
    let grey = AlbedoSource::Constant(Rgb::splat(0.5));
    let lamp = Lamp { centre: Vec3::Y, radius: 0.1, radiance: Rgb::ONE };
    let card = rectangle(Vec3::new(0.0, 0.5, 2.0), Vec3::X * 2.0, Vec3::NEG_Z * 4.0);
    let scene = scene(vec![card], matt(0.0), vec![local(ground(3.0), grey)]);
    let (lights, camera) = (dark_with(lamp), camera_at(0.0, -20.0));
    let plate = plate_of_lit_ground(&lights, &camera, 0.5);
    let d = render(&scene, &lights, &camera, &plate, Method::Coupled, 256, 3);
    let (mean, sigma) = mean_ratio(&d);
    // One test at 4 σ, and the pixel's own width: 2 mm of a penumbra of 20 cm.
    assert!((mean + 0.5).abs() < 4.0 * sigma + 0.01, "{mean} ± {sigma}");
}

#[test]
fn a_furnace_with_walls_and_a_support_stays_one() {
    // A ray that meets the support never reads the wall behind it: else the ball would glow.
    let white = AlbedoSource::Constant(Rgb::splat(0.95));
    let ball = sphere(Vec3::new(0.0, 0.3, 0.0), 0.3, 4);
    let scene = scene(vec![ball], matt(1.0), vec![local(ground(1.0), white)]);
    let place = Vec3::new(0.0, 0.1, 0.0);
    let (min, max) = (Vec3::new(-2.0, -0.5, -2.0), Vec3::new(2.0, 2.0, 2.0));
    let lights = Lights::from_parts(Environment::constant(Rgb::ONE), Vec::new()).near(
        place,
        Proxy::of_box(place, min, max),
        Vec::new(),
    );
    let camera = corner_camera(24, 18, 2.5);
    let plate = Image::filled(24, 18, Rgb::ONE);
    let d = render(&scene, &lights, &camera, &plate, Method::Coupled, 256, 5);
    let covered: Vec<f64> = (0..24 * 18)
        .filter(|&k| d.coverage.pixels()[k] == 1.0)
        .map(|k| f64::from(d.object.pixels()[k].x))
        .collect();
    let mean = covered.iter().sum::<f64>() / covered.len() as f64;
    // The ground about the ball is of albedo 0.95 where the plate does not show it, and paths end at
    // depth eight: at most 1 % is missing.
    assert!(covered.len() > 20 && (mean - 1.0).abs() < 0.01, "{mean} over {}", covered.len());
}

#[test]
fn near_light_gives_the_same_bytes_for_the_same_seed() {
    let grey = AlbedoSource::Constant(Rgb::splat(0.5));
    let ball = sphere(Vec3::new(0.0, 0.2, 0.0), 0.2, 3);
    let scene = scene(vec![ball], matt(0.6), vec![local(ground(1.0), grey)]);
    let lights = room(Some(table_lamp()));
    let camera = corner_camera(24, 18, 2.0);
    let plate = plate_of_lit_ground(&lights, &camera, 0.5);
    let once = || render(&scene, &lights, &camera, &plate, Method::Coupled, 16, 9);
    assert_eq!(once().difference.pixels(), once().difference.pixels());
}
