//! The bound holds wherever the difference was measured, and lets a large part of the frame go.

use glam::Vec3;

use super::albedo::AlbedoMap;
use super::guides::{Block, Guides};
use super::influence::Influence;
use super::near_tests::{room, table_lamp};
use super::primary::Primary;
use super::test_scenes::*;
use super::world::World;
use super::{Context, Job, Method, Numbers, Stop, Technique, integrator};
use crate::camera::Camera;
use crate::conventions::Rgb;
use crate::light::Lights;
use crate::photo::Image;
use crate::scene::{AlbedoSource, Scene};

const WIDTH: usize = 288;
const HEIGHT: usize = 192;

fn bounds(
    scene: &Scene,
    lights: &Lights,
    camera: &Camera,
    plate: &Image<Rgb>,
) -> Vec<(Block, f32)> {
    let mut world = World::new(scene, lights, camera, plate);
    let primary = Primary::new(camera, world.eye);
    AlbedoMap::solve(&mut world, &primary, &Context::new(1));
    let blocks = Block::all(WIDTH, HEIGHT);
    let influence = Influence::new(&world);
    let context = Context::default();
    let judge = |view: &super::guides::View| influence.bound(view, 0.01);
    let (_, bounds) = Guides::new(&world, &primary, &blocks, &context, judge);
    let bounds: Vec<f32> = bounds.into_iter().flatten().collect();
    blocks.into_iter().zip(bounds).collect()
}

/// Every block's change stays below its bound; returns the share of blocks below 1 %.
fn assert_holds(name: &str, scene: &Scene, lights: &Lights, camera: &Camera) -> f64 {
    let plate = Image::filled(WIDTH, HEIGHT, lights.irradiance(Vec3::Y) * 0.16);
    let bounds = bounds(scene, lights, camera, &plate);
    let difference = render(scene, lights, camera, &plate, Method::Coupled, 16, 3);
    let mut tested = 0;
    for (block, bound) in &bounds {
        let pixels = (0..block.n_pixels()).map(|k| block.pixel(k));
        let bare: Vec<_> = pixels.filter(|&p| difference.coverage[p] == 0.0).collect();
        if bare.is_empty() || !bound.is_finite() {
            continue;
        }
        tested += 1;
        let n = bare.len() as f32;
        let mean = bare.iter().map(|&p| difference.ratio[p]).sum::<Rgb>() / n;
        let variance = bare.iter().map(|&p| difference.stderr[p].powf(2.0)).sum::<Rgb>() / (n * n);
        let sigma = variance.map(f32::sqrt) / plate[bare[0]];
        // 4σ in two hundred blocks: a false alarm in 80 runs of unlucky seeds.
        let measured = (mean.abs() - 4.0 * sigma).max_element();
        assert!(measured <= *bound, "{name}: {block:?} changes by {measured}, bound {bound}");
    }
    assert!(tested > 10, "{name}: only {tested} blocks have a bound");
    bounds.iter().filter(|(_, bound)| *bound < 0.01).count() as f64 / bounds.len() as f64
}

/// A small ball on a wide ground, seen from above.
fn small_ball(props: bool) -> (Scene, Camera) {
    let grey = AlbedoSource::Constant(Rgb::splat(0.5));
    let mut things = vec![local(ground(40.0), grey)];
    if props {
        let post = sphere(Vec3::new(1.5, 0.3, 0.5), 0.3, 3);
        things.push(local(post, grey));
    }
    let scene = scene(vec![sphere(Vec3::Y * 0.1, 0.1, 3)], matt(0.7), things);
    (scene, corner_camera(WIDTH, HEIGHT, 6.0))
}

#[test]
fn the_bound_holds_under_sky_and_sun_with_and_without_props() {
    for (name, lights) in [("sky", uniform_sky(1.0)), ("sun", sunny_sky(50.0, 5.0))] {
        for props in [false, true] {
            let (scene, camera) = small_ball(props);
            let share = assert_holds(name, &scene, &lights, &camera);
            println!("{name}, props {props}: {:.0} % of the blocks below 1 %", 100.0 * share);
            assert!(share > 0.4, "{name}, props {props}: {share}");
        }
    }
}

#[test]
fn the_bound_holds_in_a_room_with_a_window_and_a_lamp() {
    let grey = AlbedoSource::Constant(Rgb::splat(0.5));
    let lamp = table_lamp();
    let sky = uniform_sky(0.5).near(Vec3::ZERO, None, vec![lamp]);
    let cases =
        [("window", room(None), false), ("room", room(Some(lamp)), true), ("lamp", sky, false)];
    for (name, lights, prop) in cases {
        let mut things = vec![local(ground(1.4), grey)];
        if prop {
            things.push(local(sphere(Vec3::new(-0.6, 0.1, 0.3), 0.1, 3), grey));
        }
        let ball = sphere(Vec3::new(0.0, 0.03, 0.1), 0.03, 3);
        let scene = scene(vec![ball], matt(0.7), things);
        let camera = corner_camera(WIDTH, HEIGHT, 2.5);
        let share = assert_holds(name, &scene, &lights, &camera);
        println!("{name}: {:.0} % of the blocks below 1 %", 100.0 * share);
        assert!(share > 0.2, "{name}: {share}");
    }
}

#[test]
fn a_block_that_the_objects_are_far_below_is_exactly_zero() {
    let grey = AlbedoSource::Constant(Rgb::splat(0.5));
    let under = scene(vec![sphere(-Vec3::Y, 0.5, 3)], matt(0.7), vec![local(ground(40.0), grey)]);
    let camera = corner_camera(WIDTH, HEIGHT, 6.0);
    let plate = Image::filled(WIDTH, HEIGHT, Rgb::ONE);
    let bounds = bounds(&under, &uniform_sky(1.0), &camera, &plate);
    let far = bounds.iter().filter(|(_, bound)| *bound == 0.0).count();
    assert!(far > bounds.len() / 4, "{far} of {}", bounds.len());
}

#[test]
fn samples_go_only_where_something_can_be_seen() {
    let (scene, camera) = small_ball(false);
    let lights = sunny_sky(50.0, 5.0);
    let plate = Image::filled(WIDTH, HEIGHT, lights.irradiance(Vec3::Y) * 0.16);
    let job = Job {
        scene: &scene,
        lights: &lights,
        camera: &camera,
        plate: &plate,
        stop: Stop::Error(0.1),
        numbers: Numbers::SobolOwen,
        least_step: 0.0,
        denoise: false,
        technique: Technique::default(),
    };
    let mut integrator = integrator(Method::Coupled, job).unwrap();
    while !integrator.next_wave(&Context::new(3)).finished() {}
    let d = integrator.snapshot();
    let unsampled = d.samples.pixels().iter().filter(|&&n| n == 0).count();
    assert!(unsampled > WIDTH * HEIGHT / 3, "only {unsampled} pixels were left out");
    for (k, &n) in d.samples.pixels().iter().enumerate() {
        let zero = d.ratio.pixels()[k] == Rgb::ZERO && d.coverage.pixels()[k] == 0.0;
        assert!(n > 0 || zero);
    }
}

/// Sum of the ratio over the picture, green.
fn total(difference: &super::Difference) -> f64 {
    difference.ratio.pixels().iter().map(|r| f64::from(r.y)).sum()
}

#[test]
fn sparse_quiet_tiles_lose_no_thin_shadow() {
    // G20, G29: the shadow of a wire 4 mm thick, one or two pixels wide, over many tiles.
    let wire = rectangle(Vec3::new(-0.002, 0.0, 0.0), Vec3::X * 0.004, Vec3::Y * 1.0);
    let grey = AlbedoSource::Constant(Rgb::splat(0.5));
    let scene = scene(vec![wire], matt(0.1), vec![local(ground(40.0), grey)]);
    let camera = corner_camera(WIDTH, HEIGHT, 1.5);
    let lights = sunny_sky(40.0, 5.0);
    let plate = Image::filled(WIDTH, HEIGHT, lights.irradiance(Vec3::Y) * 0.16);
    let whole = render(&scene, &lights, &camera, &plate, Method::Coupled, 64, 3);
    let job = Job {
        scene: &scene,
        lights: &lights,
        camera: &camera,
        plate: &plate,
        stop: Stop::Error(0.05),
        numbers: Numbers::SobolOwen,
        least_step: 0.0,
        denoise: false,
        technique: Technique::default(),
    };
    let mut integrator = integrator(Method::Coupled, job).unwrap();
    while !integrator.next_wave(&Context::new(4)).finished() {}
    let sparse = integrator.snapshot();
    let (wanted, found) = (total(&whole), total(&sparse));
    println!("{wanted} {found}");
    // Both sums are of thousands of samples in the shadow: σ below 1 % together.
    assert!((found / wanted - 1.0).abs() < 0.03, "{found} for {wanted}");
}
