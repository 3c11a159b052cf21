//! Two independent estimators must agree: the coupled one against the plain two-pass path tracer.
//!
//! Per pixel z = (coupled − two-pass) / √(σ₁² + σ₂²) from replicates. With R replicates each, z
//! follows about t with 2R − 2 degrees of freedom; the largest |z| over all pixels and channels is
//! compared with a bound at a family-wise level of 1 % (Šidák), the mean z with its own.

use glam::{DAffine3, DQuat, DVec3, Vec3};

use super::near_tests::{plate_of_lit_ground, room, table_lamp};
use super::test_scenes::*;
use super::{Difference, Method};
use crate::camera::Camera;
use crate::conventions::Rgb;
use crate::light::Lights;
use crate::photo::Image;
use crate::scene::{AlbedoSource, Clearcoat, Material, Model, ModelMesh, Repeat, Scene, Sheen};

const TWO_PASS: Method = Method::TwoPass { same_numbers: true };
const WIDTH: usize = 24;
const HEIGHT: usize = 18;

/// z per pixel block of 3 × 3: blocks make the errors of heavy-tailed pixels more normal.
fn scores(a: &Difference, b: &Difference) -> Vec<f64> {
    let value = |d: &Difference, x: usize, y: usize| d.object[(x, y)] + d.difference[(x, y)];
    let mut scores = Vec::new();
    for y in (0..HEIGHT).step_by(3) {
        for x in (0..WIDTH).step_by(3) {
            let (mut difference, mut variance) = (0.0, 0.0);
            for (i, j) in (0..9).map(|k| (x + k % 3, y + k / 3)) {
                difference += f64::from((value(a, i, j) - value(b, i, j)).y);
                variance += f64::from(a.stderr[(i, j)].y).powi(2);
                variance += f64::from(b.stderr[(i, j)].y).powi(2);
            }
            // Far from the objects the two-pass method meets them in a few samples of a thousand, or
            // none: what it then calls its error means nothing. Below 0.02 % of the plate's
            // brightness (0.5) nothing is compared.
            if difference.abs() < 9.0 * 1e-4 {
                continue;
            }
            if variance > 0.0 {
                scores.push(difference / variance.sqrt());
            } else {
                assert_eq!(difference, 0.0, "({x}, {y}) differs without any error");
            }
        }
    }
    scores
}

fn assert_agreement(
    name: &str,
    scene: &Scene,
    lights: &Lights,
    camera: &Camera,
    plate: &Image<Rgb>,
) {
    let coupled = render(scene, lights, camera, plate, Method::Coupled, 256, 21);
    let two_pass = render(scene, lights, camera, plate, TWO_PASS, 1024, 22);
    let z = scores(&coupled, &two_pass);
    let worst = z.iter().fold(0.0_f64, |m, z| m.max(z.abs()));
    let mean = z.iter().sum::<f64>() / z.len() as f64;
    // 48 blocks at 1 % together: 0.02 % each, |z| < 3.7 for normal errors; pooled t of 9 · 14
    // degrees of freedom 3.8, and room for skewness.
    assert!(worst < 4.3, "{name}: worst z {worst}, mean {mean}");
    // Mean of n scores: 1/√n, at 0.1 %.
    assert!(mean.abs() < 3.3 / (z.len() as f64).sqrt(), "{name}: mean z {mean} of {}", z.len());
    assert!(coupled.coverage.pixels().iter().any(|&c| c > 0.0), "{name}: the object is in view");
}

/// A plate that shows a ground of albedo `rho` as these lights light it.
fn plate_of_ground(lights: &Lights, rho: f32) -> Image<Rgb> {
    let radiance = lights.irradiance(Vec3::Y) * rho * std::f32::consts::FRAC_1_PI;
    Image::filled(WIDTH, HEIGHT, radiance)
}

fn on_ground(name: &str, lights: &Lights, material: Material) {
    let rho = 0.5;
    let objects = vec![sphere(Vec3::new(0.0, 0.3, 0.0), 0.3, 4)];
    let grey = AlbedoSource::Constant(Rgb::splat(rho));
    let scene = scene(objects, material, vec![local(ground(3.0), grey)]);
    let camera = corner_camera(WIDTH, HEIGHT, 2.5);
    assert_agreement(name, &scene, lights, &camera, &plate_of_ground(lights, rho));
}

#[test]
fn estimators_agree_on_a_matt_ball_under_a_uniform_sky() {
    on_ground("uniform sky", &uniform_sky(1.0), matt(0.7));
}

#[test]
fn estimators_agree_on_a_matt_ball_in_the_sun() {
    on_ground("sun", &sunny_sky(40.0, 3.0), matt(0.7));
}

#[test]
fn estimators_agree_on_rough_metal_and_glossy_plastic() {
    let metal = Material { metallic: 1.0, roughness: 0.6, ..matt(0.8) };
    on_ground("metal", &sunny_sky(50.0, 1.0), metal);
    let plastic = Material { specular: 1.0, roughness: 0.4, ..matt(0.6) };
    on_ground("plastic", &sunny_sky(50.0, 1.0), plastic);
}

#[test]
fn estimators_agree_on_a_glass_ball() {
    let glass = Material {
        transmission: 1.0,
        solid: true,
        roughness: 0.0,
        specular: 1.0,
        attenuation_colour: Rgb::new(0.9, 0.5, 0.7),
        attenuation_distance: 0.5,
        ..matt(1.0)
    };
    on_ground("glass", &uniform_sky(1.0), glass);
}

#[test]
fn estimators_agree_on_lacquer_and_velvet() {
    let clearcoat = Some(Clearcoat { factor: 1.0, roughness: 0.3, ..Clearcoat::default() });
    let sheen = Some(Sheen { colour: Rgb::splat(0.8), roughness: 0.5, ..Sheen::default() });
    on_ground(
        "lacquered velvet",
        &sunny_sky(50.0, 1.0),
        Material { clearcoat, sheen, ..matt(0.3) },
    );
}

#[test]
fn estimators_agree_between_a_glowing_ball_and_a_glossy_one() {
    // G27: the two-pass method finds the lamp by chance alone, the coupled one by draws on it as well.
    let lights = uniform_sky(1.0);
    let lamp = Material { emissive: Rgb::new(4.0, 3.0, 1.0), ..matt(0.2) };
    let glossy = Material { specular: 1.0, roughness: 0.4, ..matt(0.6) };
    let mut shining = sphere(Vec3::new(0.3, 0.2, 0.2), 0.2, 3);
    shining.material = 1;
    let scene = Scene {
        objects: vec![sphere(Vec3::new(-0.2, 0.3, 0.0), 0.3, 4), shining],
        local: vec![local(ground(3.0), AlbedoSource::Constant(Rgb::splat(0.5)))],
        materials: vec![glossy, lamp],
        ..Scene::default()
    };
    let camera = corner_camera(WIDTH, HEIGHT, 2.5);
    assert_agreement("glow", &scene, &lights, &camera, &plate_of_ground(&lights, 0.5));
}

#[test]
fn estimators_agree_in_a_concave_place_with_a_prop() {
    let lights = sunny_sky(35.0, 2.0);
    let grey = AlbedoSource::Constant(Rgb::splat(0.5));
    let wall = rectangle(Vec3::new(-1.5, 0.0, -0.5), Vec3::X * 3.0, Vec3::Y * 1.2);
    let post = rectangle(Vec3::new(0.9, 0.0, -0.2), Vec3::Z * 0.4, Vec3::Y * 0.8);
    let camera = corner_camera(WIDTH, HEIGHT, 2.5);
    let local_meshes =
        || vec![local(ground(1.5), grey), local(wall.clone(), grey), local(post.clone(), grey)];

    // The plate is what the two-pass method itself sees without objects: a matt "object" that is
    // the place itself would be circular, so the place is rendered as an object over nothing.
    let place = scene(local_meshes().into_iter().map(|l| l.mesh).collect(), matt(0.5), Vec::new());
    let dark = Image::filled(WIDTH, HEIGHT, Rgb::ZERO);
    let plate = render(&place, &lights, &camera, &dark, TWO_PASS, 4096, 1).object;

    let ball = sphere(Vec3::new(0.0, 0.3, 0.0), 0.3, 4);
    let scene = scene(vec![ball], matt(0.5), local_meshes());
    assert_agreement("corner", &scene, &lights, &camera, &plate);
}

#[test]
fn estimators_agree_in_a_room_with_a_window_and_a_lamp() {
    let lights = room(Some(table_lamp()));
    let grey = AlbedoSource::Constant(Rgb::splat(0.5));
    let camera = corner_camera(WIDTH, HEIGHT, 1.6);
    let ball = || vec![sphere(Vec3::new(0.0, 0.2, 0.0), 0.2, 4)];
    let plate = plate_of_lit_ground(&lights, &camera, 0.5);
    let matt_ball = scene(ball(), matt(0.6), vec![local(ground(1.2), grey)]);
    assert_agreement("room", &matt_ball, &lights, &camera, &plate);
    let steel = Material { metallic: 1.0, roughness: 0.4, ..matt(0.7) };
    let steel_ball = scene(ball(), steel, vec![local(ground(1.2), grey)]);
    assert_agreement("room, steel", &steel_ball, &lights, &camera, &plate);
}

#[test]
fn estimators_agree_under_a_sky_and_a_lamp() {
    let lights = uniform_sky(0.5).near(Vec3::ZERO, None, vec![table_lamp()]);
    let grey = AlbedoSource::Constant(Rgb::splat(0.5));
    let camera = corner_camera(WIDTH, HEIGHT, 1.6);
    let plate = plate_of_lit_ground(&lights, &camera, 0.5);
    let ball = sphere(Vec3::new(0.0, 0.2, 0.0), 0.2, 4);
    let scene = scene(vec![ball], matt(0.6), vec![local(ground(1.2), grey)]);
    assert_agreement("sky and lamp", &scene, &lights, &camera, &plate);
}

/// Spheres under the sun, the first one's mesh at more places: mirrored, stretched, one before another.
fn many_spheres(is_instanced: bool) -> Scene {
    let mesh = sphere(Vec3::new(0.0, 0.2, 0.0), 0.2, 4);
    let places = [
        (DVec3::new(1.0, 1.4, 0.6), 0.5, DVec3::new(-0.45, 0.0, 0.1)),
        (DVec3::new(-0.7, 0.7, 1.0), -0.8, DVec3::new(0.4, 0.05, -0.2)),
        (DVec3::splat(0.5), 1.5, DVec3::new(0.2, 0.0, 0.35)),
    ];
    let moved = places.map(|(scale, angle, translation)| {
        let turn = DQuat::from_rotation_z(angle);
        DAffine3::from_scale_rotation_translation(scale, turn, translation)
    });
    let mut model = Model {
        meshes: vec![ModelMesh {
            positions: mesh.positions.iter().map(|p| p.as_dvec3()).collect(),
            normals: mesh.normals,
            triangles: mesh.triangles,
            ..ModelMesh::default()
        }],
        repeats: moved.map(|moved| Repeat { mesh: 0, moved }).to_vec(),
        materials: vec![Material { roughness: 0.4, metallic: 0.5, ..Material::default() }],
        ..Model::default()
    };
    if !is_instanced {
        model = model.flattened().expect("three copies");
    }
    let mut scene = Scene::new(DVec3::ZERO);
    scene.add_object(&model, &DAffine3::IDENTITY).expect("all is near");
    scene.local.push(local(ground(3.0), AlbedoSource::Constant(Rgb::splat(0.5))));
    scene.materials.push(matt(0.5));
    scene
}

#[test]
fn instances_look_as_copies_do() {
    let (ours, copies) = (many_spheres(true), many_spheres(false));
    assert_eq!((ours.instances.len(), copies.instances.len()), (3, 0));
    let lights = sunny_sky(40.0, 2.0);
    let (camera, plate) = (corner_camera(WIDTH, HEIGHT, 2.0), plate_of_ground(&lights, 0.5));
    let a = render(&ours, &lights, &camera, &plate, Method::Coupled, 256, 31);
    let b = render(&copies, &lights, &camera, &plate, Method::Coupled, 256, 32);
    let z = scores(&a, &b);
    let worst = z.iter().fold(0.0_f64, |m, z| m.max(z.abs()));
    let mean = z.iter().sum::<f64>() / z.len() as f64;
    // Bounds as in `assert_agreement`.
    assert!(worst < 4.3, "worst z {worst}, mean {mean}");
    assert!(mean.abs() < 3.3 / (z.len() as f64).sqrt(), "mean z {mean} of {}", z.len());
    assert!(z.len() > 30, "{} blocks show something", z.len());
    // The same numbers find the same outlines.
    let c = render(&copies, &lights, &camera, &plate, Method::Coupled, 256, 31);
    let off = a.coverage.pixels().iter().zip(c.coverage.pixels()).map(|(a, c)| (a - c).abs());
    assert!(off.fold(0.0, f32::max) <= 2.0 / 256.0);
}
