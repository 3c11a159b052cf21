//! The bound holds wherever the difference was measured, and lets a large part of the frame go.

use glam::Vec3;

use super::albedo::AlbedoMap;
use super::guides::{Block, View};
use super::influence::{Influence, shapes};
use super::near_tests::{room, table_lamp};
use super::primary::Primary;
use super::test_scenes::*;
use super::world::World;
use super::{Context, Job, Method, Stop};
use crate::camera::{Camera, Distortion};
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
    let judged = |block: Block| (block, influence.judge(&world, &primary, &block, 0.01).bound);
    blocks.into_iter().map(judged).collect()
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

/// A wide ground with a post 4 mm thick and a low wall, through a bent lens.
fn thin_things() -> (Scene, Camera) {
    let grey = AlbedoSource::Constant(Rgb::splat(0.5));
    let post = rectangle(Vec3::new(0.7, 0.0, 0.2), Vec3::X * 0.004, Vec3::Y * 0.8);
    let stone = sphere(Vec3::new(-1.0, 0.02, 0.4), 0.02, 2);
    let things = [ground(2.5), post, stone].map(|mesh| local(mesh, grey));
    let ball = sphere(Vec3::Y * 0.1, 0.1, 3);
    let mut camera = corner_camera(WIDTH, HEIGHT, 4.0);
    camera.lens.distortion =
        Distortion::BrownConrady { k1: -0.12, k2: 0.05, p1: 1e-3, p2: -5e-4, k3: 0.0 };
    (scene(vec![ball], matt(0.7), things.to_vec()), camera)
}

#[test]
fn a_glance_at_a_block_misses_nothing_that_its_pixels_show() {
    let lights = uniform_sky(1.0);
    for (name, (scene, camera)) in
        [("post", thin_things()), ("prop", small_ball(true)), ("plain", small_ball(false))]
    {
        let plate = Image::filled(WIDTH, HEIGHT, Rgb::ONE);
        let world = World::new(&scene, &lights, &camera, &plate);
        let primary = Primary::new(&camera, world.eye);
        let shapes = shapes(&world);
        let (mut told, mut empty) = (0, 0);
        for block in Block::all(WIDTH, HEIGHT) {
            let Some(glance) = View::glance(&world, &primary, &shapes, &block) else { continue };
            if primary.meets(&block, &world.parts, world.eye) {
                continue;
            }
            let (view, _) = View::new(&world, &primary, &block);
            let meshes = |view: &View| view.footprint(block).map(|found| found.meshes);
            assert_eq!(meshes(&glance), meshes(&view), "{name}: {block:?}");
            assert_eq!(glance.is_plain(), view.is_plain(), "{name}: {block:?}");
            if let Some((at_once, all)) = glance.footprint(block).zip(view.footprint(block)) {
                let apart = at_once.ball.centre.distance(all.ball.centre);
                let needed = apart + all.ball.radius;
                // Both balls reach to the pixels' far edges by a margin of a twentieth.
                assert!(needed <= 1.02 * at_once.ball.radius, "{name}: {block:?}");
            }
            told += 1;
            empty += usize::from(meshes(&view).is_none());
        }
        let blocks = Block::all(WIDTH, HEIGHT).len();
        println!("{name}: {told} of {blocks} blocks at a glance, {empty} without anything");
        assert!(told > blocks / 3, "{name}: {told} of {blocks}");
    }
}

#[test]
fn work_grows_with_what_the_objects_reach_and_not_with_the_plate() {
    let (scene, small) = small_ball(false);
    let lights = sunny_sky(50.0, 5.0);
    let looked_at = |times: usize| {
        let (width, height) = (times * WIDTH, times * HEIGHT);
        // The same view of the ball in a corner of an ever larger plate.
        let camera = small.cropped(0.0, 0.0, 1.0, width, height);
        let plate = Image::filled(width, height, Rgb::splat(0.2));
        let mut world = World::new(&scene, &lights, &camera, &plate);
        let primary = Primary::new(&camera, world.eye);
        AlbedoMap::solve(&mut world, &primary, &Context::new(1));
        let influence = Influence::new(&world);
        let blocks = Block::all(width, height);
        let judged = blocks.iter().map(|block| influence.judge(&world, &primary, block, 0.005));
        judged.filter(|judged| judged.bound > 0.005 || judged.seen.is_some()).count()
    };
    let (one, nine) = (looked_at(1), looked_at(3));
    println!("{one} blocks looked at, {nine} in a plate of nine times the size");
    assert!(one > 20 && nine < 2 * one, "{one} {nine}");
}

#[test]
fn a_difference_holds_the_window_that_the_objects_reach() {
    let (scene, camera) = small_ball(false);
    let lights = sunny_sky(50.0, 5.0);
    let plate = Image::filled(WIDTH, HEIGHT, lights.irradiance(Vec3::Y) * 0.16);
    let job =
        Job { denoise: true, ..plain_job(&scene, &lights, &camera, &plate, Stop::Error(0.1)) };
    let (part, _) = finish(Method::Coupled, job, 3);
    let whole = part.whole();
    assert!(part.window.n_pixels() < WIDTH * HEIGHT / 2, "{:?}", part.window);
    assert!(part.coverage.pixels().contains(&1.0));
    assert_eq!(part.coverage.pixels().len(), part.window.n_pixels());
    for (x, y) in (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (x, y))) {
        let at = (x, y);
        let held = part.window.inside(at).map(|at| (part.difference[at], part.depth[at]));
        let expected = held.unwrap_or((Rgb::ZERO, f32::INFINITY));
        assert_eq!((whole.difference[at], whole.depth[at]), expected);
        assert!(held.is_none_or(|(_, depth)| depth.is_finite()), "the ground is seen everywhere");
    }
}

#[test]
fn samples_go_only_where_something_can_be_seen() {
    let (scene, camera) = small_ball(false);
    let lights = sunny_sky(50.0, 5.0);
    let plate = Image::filled(WIDTH, HEIGHT, lights.irradiance(Vec3::Y) * 0.16);
    let job = plain_job(&scene, &lights, &camera, &plate, Stop::Error(0.1));
    let d = finish(Method::Coupled, job, 3).0.whole();
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
    let job = plain_job(&scene, &lights, &camera, &plate, Stop::Error(0.05));
    let sparse = finish(Method::Coupled, job, 4).0.whole();
    let (wanted, found) = (total(&whole), total(&sparse));
    println!("{wanted} {found}");
    // Both sums are of thousands of samples in the shadow: σ below 1 % together.
    assert!((found / wanted - 1.0).abs() < 0.03, "{found} for {wanted}");
}
