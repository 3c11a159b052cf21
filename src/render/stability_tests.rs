//! Situations in which renderers fail (methods-render R13), those that no other test has by meaning.
//!
//! Numbers as in `docs/stability.md`, where all are listed with their tests. Fixed seeds; comparisons at
//! 3.5 to 4 standard errors.

use glam::{DQuat, DVec3, Vec3};

use super::test_scenes::*;
use super::{Difference, Method};
use crate::camera::{Camera, Lens, Pose};
use crate::conventions::Rgb;
use crate::light::{Disc, Environment, Lights};
use crate::photo::Image;
use crate::scene::{AlbedoSource, Material, Mesh, Scene};

const COUPLED: Method = Method::Coupled;
const BLACK: AlbedoSource = AlbedoSource::Constant(Rgb::ZERO);
const GREY: AlbedoSource = AlbedoSource::Constant(Rgb::splat(0.5));

/// D / L₀ at a point of the ground on the x axis, with its standard error.
fn ratio_at(scene: &Scene, lights: &Lights, x: f32, samples: u32) -> (f64, f64) {
    let plate = Image::filled(4, 4, Rgb::ZERO);
    let (cameras, _) = point_camera(&[x]);
    mean_ratio(&render(scene, lights, &cameras[0], &plate, COUPLED, samples, 11))
}

/// A black object over a black ground.
fn over_ground(object: Mesh) -> Scene {
    scene(vec![object], matt(0.0), vec![local(ground(300.0), BLACK)])
}

fn sun_alone(elevation: f32) -> Lights {
    let half = crate::conventions::SUN_HALF_ANGLE_RAD as f32;
    let (sin, cos) = elevation.to_radians().sin_cos();
    let sun = Disc::from_irradiance(Vec3::new(cos, sin, 0.0), half, Rgb::ONE);
    Lights::from_parts(Environment::constant(Rgb::ZERO), vec![sun])
}

fn sum(difference: &Difference) -> Rgb {
    let both = difference.object.pixels().iter().chain(difference.difference.pixels());
    both.copied().sum()
}

#[test]
fn g02_light_on_the_seam_is_as_light_anywhere() {
    // The same light, its brightest texels once on the map's seam and once in its middle.
    let lights = |turn: usize, angle: f64| {
        let picture = Image::from_fn(64, 32, |i, j| {
            let i = (i + turn) % 64;
            let hot = (i == 0 || i == 63) && (8..10).contains(&j);
            Rgb::splat(if hot { 200.0 } else { 0.5 + 0.01 * j as f32 })
        });
        let env = Environment::new(&picture, DQuat::from_rotation_y(angle), true).unwrap();
        Lights::from_parts(env, Vec::new())
    };
    let scene = over_ground(sphere(Vec3::new(0.0, 1.2, -0.8), 0.5, 3));
    let at = |lights: &Lights| ratio_at(&scene, lights, 0.3, 256);
    let (seam, middle) = (at(&lights(0, 0.0)), at(&lights(32, std::f64::consts::PI)));
    let sigma = (seam.1 * seam.1 + middle.1 * middle.1).sqrt();
    assert!(
        seam.0 < -0.01 && (seam.0 - middle.0).abs() < 4.0 * sigma + 1e-4,
        "{seam:?} {middle:?}"
    );
}

#[test]
fn g06_the_shadow_reaches_the_contact() {
    // A wall 1 high and 40 wide, from 1 cm: ½ (1 − c / √(1 + c²)) but for its far ends.
    let wall = rectangle(Vec3::new(0.0, 0.0, -20.0), Vec3::Z * 40.0, Vec3::Y);
    let scene = over_ground(wall);
    for c in [0.003_f32, 0.01, 0.03] {
        let d = f64::from(c);
        let far = (1.0 + d * d).sqrt();
        let wanted = ((20.0 / d).atan() - d / far * (20.0 / far).atan()) / std::f64::consts::PI;
        let got = ratio_at(&scene, &uniform_sky(1.0), c, 256);
        assert!((got.0 + wanted).abs() < 4.0 * got.1 + 0.002, "{c}: {got:?} for −{wanted}");
    }
}

#[test]
fn g09_a_camera_below_the_ground_sees_no_difference() {
    let scene =
        scene(vec![sphere(Vec3::Y * 0.5, 0.3, 3)], matt(0.5), vec![local(ground(20.0), GREY)]);
    let eye = DVec3::new(0.0, -2.0, 0.5);
    let pose = Pose::look_at(eye, DVec3::new(0.0, -0.1, 0.0), DVec3::Y).unwrap();
    let camera = Camera { width: 16, height: 12, lens: Lens::pinhole(20.0, 16, 12), pose };
    let plate = Image::filled(16, 12, Rgb::splat(0.2));
    let d = render(&scene, &sunny_sky(40.0, 2.0), &camera, &plate, COUPLED, 16, 3);
    assert!(d.coverage.pixels().iter().all(|&c| c == 0.0));
    let nothing = |p: &Rgb| *p == Rgb::ZERO;
    assert!(d.difference.pixels().iter().all(nothing) && d.ratio.pixels().iter().all(nothing));
}

#[test]
fn g10_shadows_of_a_sun_on_the_horizon_are_as_long_as_they_are() {
    // A sheet 1 high on x = 0: umbra to cot(α + δ), half a sun at cot α, none beyond cot(α − δ).
    let sheet = rectangle(Vec3::new(0.0, 0.0, -100.0), Vec3::Z * 200.0, Vec3::Y);
    let scene = over_ground(sheet);
    for elevation in [1.0_f32, 5.0] {
        let cot = |degrees: f32| 1.0 / degrees.to_radians().tan();
        let half = crate::conventions::SUN_HALF_ANGLE_RAD.to_degrees() as f32;
        let (near, far) = (cot(elevation + half), cot(elevation - half));
        for (x, wanted) in [(0.95 * near, -1.0), (1.05 * far, 0.0)] {
            let got = ratio_at(&scene, &sun_alone(elevation), -x, 64);
            assert!((got.0 - wanted).abs() < 4.0 * got.1 + 1e-3, "{elevation}°, {x} m: {got:?}");
        }
        // Where the sheet's edge stands before the sun's centre half the irradiance is left, but for
        // the cosine's rise over the disc: 2 / 3π · 2δ / α of it at most.
        let got = ratio_at(&scene, &sun_alone(elevation), -cot(elevation), 256);
        let rise = 0.43 * half / elevation;
        assert!((got.0 + 0.5).abs() < 4.0 * got.1 + f64::from(rise), "{elevation}°: {got:?}");
    }
}

#[test]
fn g11_a_place_far_from_the_origin_looks_the_same() {
    let at = |shift: DVec3| {
        let mut scene =
            scene(vec![sphere(Vec3::Y * 0.3, 0.3, 3)], matt(0.5), vec![local(ground(3.0), GREY)]);
        scene.origin = shift;
        let eye = DVec3::new(0.7, 1.0, 2.0);
        let pose = Pose::look_at(eye + shift, DVec3::Y * 0.2 + shift, DVec3::Y).unwrap();
        let camera = Camera { width: 24, height: 18, lens: Lens::pinhole(28.0, 24, 18), pose };
        let plate = Image::filled(24, 18, Rgb::splat(0.2));
        render(&scene, &sunny_sky(40.0, 2.0), &camera, &plate, COUPLED, 32, 3)
    };
    let (near, far) = (at(DVec3::ZERO), at(DVec3::new(1e5, -300.0, 4e5)));
    for (k, (a, b)) in near.difference.pixels().iter().zip(far.difference.pixels()).enumerate() {
        let moved = (*a + near.object.pixels()[k] - *b - far.object.pixels()[k]).abs();
        // The camera's place is known to 1e-10 m there: a draw may fall on the other side of an edge.
        let allowed = near.stderr.pixels()[k] + Rgb::splat(1e-4);
        assert!(moved.cmple(allowed).all(), "pixel {k}: {moved}");
    }
    assert!((sum(&near) / sum(&far) - 1.0).abs().max_element() < 1e-3);
}

#[test]
fn g23_an_object_around_the_camera_fills_the_frame() {
    let inside_out = {
        let mut mesh = sphere(Vec3::Y, 5.0, 3);
        mesh.triangles.iter_mut().for_each(|t| t.swap(1, 2));
        mesh
    };
    let scene = scene(vec![inside_out], matt(0.5), vec![local(ground(3.0), GREY)]);
    let camera = corner_camera(24, 18, 2.0);
    let plate = Image::filled(24, 18, Rgb::splat(0.2));
    let d = render(&scene, &uniform_sky(1.0), &camera, &plate, COUPLED, 16, 3);
    // In a closed ball without a lamp it is dark: nothing of the plate's light is left on the ground.
    assert!(d.coverage.pixels().iter().all(|&c| (0.0..=1.0).contains(&c)));
    assert!(d.coverage.pixels().contains(&1.0), "beyond the ground there is the ball");
    assert!(d.object.pixels().iter().chain(d.ratio.pixels()).all(|p| p.is_finite()));
    let ground = d.coverage.pixels().iter().position(|&c| c == 0.0).expect("the ground is seen");
    let left = 1.0 + d.ratio.pixels()[ground];
    assert!(left.abs().max_element() < 0.1, "{left} of the light is left");
}

#[test]
fn g24_sky_behind_the_ground_is_copied_to_the_last_bit() {
    let scene = scene(
        vec![sphere(Vec3::new(0.0, 0.3, 0.0), 0.3, 3)],
        matt(0.5),
        vec![local(ground(1.0), GREY)],
    );
    let eye = DVec3::new(0.0, 0.5, 4.0);
    let pose = Pose::look_at(eye, DVec3::new(0.0, 1.2, 0.0), DVec3::Y).unwrap();
    let camera = Camera { width: 24, height: 24, lens: Lens::pinhole(24.0, 24, 24), pose };
    let plate = Image::filled(24, 24, Rgb::splat(0.2));
    let d = render(&scene, &sunny_sky(40.0, 2.0), &camera, &plate, COUPLED, 16, 3);
    for y in 0..8 {
        for x in 0..24 {
            let changed = d.object[(x, y)] + d.difference[(x, y)] + d.ratio[(x, y)];
            assert!(changed == Rgb::ZERO && d.coverage[(x, y)] == 0.0, "({x}, {y}): {changed}");
        }
    }
    assert!(d.coverage.pixels().iter().any(|&c| c > 0.0), "the ball is in the frame");
}

#[test]
fn g26_a_card_wound_the_other_way_is_the_same_card() {
    let card = rectangle(Vec3::new(-0.5, 0.6, 0.5), Vec3::X, Vec3::NEG_Z);
    let mut flipped = card.clone();
    flipped.triangles.iter_mut().for_each(|t| t.swap(1, 2));
    let at = |card: Mesh| {
        let scene = scene(vec![card], matt(0.5), vec![local(ground(3.0), GREY)]);
        let camera = corner_camera(24, 18, 3.0);
        let lights = sunny_sky(50.0, 2.0);
        let plate = Image::filled(24, 18, Rgb::splat(0.2));
        render(&scene, &lights, &camera, &plate, COUPLED, 64, 3)
    };
    let (front, back) = (at(card), at(flipped));
    assert_eq!(front.coverage, back.coverage);
    let moved = (sum(&front) - sum(&back)).abs().max_element();
    assert!(moved < 1e-3 * sum(&front).abs().max_element(), "{} {}", sum(&front), sum(&back));
}

/// A lamp in the form of a disc of `n` triangles, which looks down.
fn disc(height: f32, radius: f32, n: u32) -> Mesh {
    // A polygon of the disc's area
    let angle = std::f32::consts::TAU / n as f32;
    let corner = radius * (angle / angle.sin()).sqrt();
    let rim = (0..n).map(|k| {
        let (sin, cos) = (k as f32 * angle).sin_cos();
        Vec3::new(corner * cos, height, corner * sin)
    });
    Mesh {
        name: "disc".into(),
        positions: std::iter::once(Vec3::Y * height).chain(rim).collect(),
        triangles: (0..n).map(|k| [0, 1 + k, 1 + (k + 1) % n]).collect(),
        ..Mesh::default()
    }
}

#[test]
fn g27_a_glowing_disc_lights_the_ground_by_its_form_factor() {
    // R4.3: E = π L a² / (a² + h²) below its middle; the black disc itself sends nothing back, and
    // the dark sky behind it is missed by nobody. A sky of 1 gives the unit: L₀ = ρ.
    let lamp = Material { emissive: Rgb::splat(5.0), double_sided: true, ..matt(0.0) };
    let (a, h) = (0.4_f32, 1.0_f32);
    let lit = scene(vec![disc(h, a, 64)], lamp, vec![local(ground(20.0), BLACK)]);
    let share = f64::from(a * a / (a * a + h * h));
    let plate = Image::filled(4, 4, Rgb::ZERO);
    // From the side, since the disc hides the ground below it from above.
    let eye = DVec3::new(50.0, 20.0, 0.0);
    let pose = Pose::look_at(eye, DVec3::ZERO, DVec3::Y).unwrap();
    let camera = Camera { width: 4, height: 4, lens: Lens::pinhole(1e5, 4, 4), pose };
    let d = render(&lit, &uniform_sky(1.0), &camera, &plate, COUPLED, 256, 11);
    let (mean, sigma) = mean_ratio(&d);
    let wanted = 4.0 * share;
    assert!((mean - wanted).abs() < 4.0 * sigma + 0.003 * wanted, "{mean} ± {sigma} for {wanted}");
}
