//! What must hold to the last bit, and what must not depend on anything but the seed.

use glam::Vec3;

use super::test_scenes::*;
use super::{Context, Difference, Job, Method, Numbers, Stop, Technique, integrator};
use crate::conventions::Rgb;
use crate::photo::Image;
use crate::scene::{AlbedoSource, Mesh};

const PLATE: AlbedoSource = AlbedoSource::Plate;

fn picture(objects: Vec<Mesh>, lights: &crate::light::Lights, method: Method) -> Difference {
    let scene = scene(objects, matt(0.5), vec![local(ground(2.0), PLATE)]);
    let camera = corner_camera(40, 30, 3.0);
    let plate = Image::from_fn(40, 30, |x, y| Rgb::splat(0.1 + 0.002 * (x + y) as f32));
    render(&scene, lights, &camera, &plate, method, 8, 3)
}

fn is_zero(d: &Difference) -> bool {
    d.coverage.pixels().iter().all(|&c| c == 0.0)
        && d.object.pixels().iter().all(|&p| p == Rgb::ZERO)
        && d.difference.pixels().iter().all(|&p| p == Rgb::ZERO)
        && d.ratio.pixels().iter().all(|&p| p == Rgb::ZERO)
        && d.stderr.pixels().iter().all(|&p| p == Rgb::ZERO)
}

#[test]
fn no_object_is_no_difference() {
    let d = picture(Vec::new(), &sunny_sky(40.0, 2.0), Method::Coupled);
    assert!(is_zero(&d));
    assert!(d.samples.pixels().iter().all(|&n| n == 0), "and no work");
}

#[test]
fn an_object_under_the_ground_is_no_difference() {
    let buried = sphere(Vec3::new(0.0, -0.5, 0.0), 0.3, 3);
    assert!(is_zero(&picture(vec![buried], &sunny_sky(40.0, 2.0), Method::Coupled)));
}

#[test]
fn a_buried_object_makes_no_difference_in_a_corner_either() {
    // With a wall local rays meet local surfaces: the recursion must stay empty, too.
    let buried = sphere(Vec3::new(0.0, -0.5, 0.0), 0.3, 3);
    let wall = rectangle(Vec3::new(-2.0, 0.0, -1.0), Vec3::X * 4.0, Vec3::Y * 2.0);
    let scene = scene(vec![buried], matt(0.5), vec![local(ground(2.0), PLATE), local(wall, PLATE)]);
    let camera = corner_camera(40, 30, 3.0);
    let plate = Image::filled(40, 30, Rgb::splat(0.2));
    let lights = sunny_sky(40.0, 2.0);
    assert!(is_zero(&render(&scene, &lights, &camera, &plate, Method::Coupled, 8, 3)));
}

#[test]
fn no_light_is_no_difference() {
    let ball = sphere(Vec3::new(0.0, 0.3, 0.0), 0.3, 3);
    let scene = scene(vec![ball], matt(0.5), vec![local(ground(2.0), PLATE)]);
    let camera = corner_camera(40, 30, 3.0);
    let plate = Image::filled(40, 30, Rgb::ZERO);
    let d = render(&scene, &uniform_sky(0.0), &camera, &plate, Method::Coupled, 8, 3);
    assert!(d.difference.pixels().iter().chain(d.object.pixels()).all(|&p| p == Rgb::ZERO));
    assert!(d.ratio.pixels().iter().all(|&p| p == Rgb::ZERO));
}

#[test]
fn the_number_of_threads_changes_no_bit() {
    let ball = || vec![sphere(Vec3::new(0.0, 0.3, 0.0), 0.3, 3)];
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| picture(ball(), &sunny_sky(40.0, 2.0), Method::Coupled))
    };
    let (one, four) = (with(1), with(4));
    assert_eq!(one.difference, four.difference);
    assert_eq!(one.object, four.object);
    assert_eq!(one.stderr, four.stderr);
    assert_eq!(one.albedo, four.albedo);
    assert!(one.difference.pixels().iter().any(|&p| p != Rgb::ZERO));
}

#[test]
fn everything_is_finite_under_hostile_input() {
    // An over-exposed plate, an albedo of 1.5 to be solved (G15), a sun on the horizon (G10).
    let ball = sphere(Vec3::new(0.0, 0.3, 0.0), 0.3, 3);
    let mut glossy = matt(0.9);
    glossy.specular = 1.0;
    glossy.roughness = 0.02;
    glossy.metallic = 0.5;
    let scene = scene(vec![ball], glossy, vec![local(ground(2.0), PLATE)]);
    let camera = corner_camera(40, 30, 3.0);
    let plate = Image::filled(40, 30, Rgb::new(1.0, 0.0, 100.0));
    for elevation in [0.1, 1.0, 90.0] {
        let lights = sunny_sky(elevation, 2.0);
        let d = render(&scene, &lights, &camera, &plate, Method::Coupled, 8, 3);
        let all = d.difference.pixels().iter().chain(d.object.pixels()).chain(d.stderr.pixels());
        assert!(all.chain(d.ratio.pixels()).all(|p| p.is_finite()));
    }
}

#[test]
fn a_cancelled_context_stops_at_once() {
    let ball = sphere(Vec3::new(0.0, 0.3, 0.0), 0.3, 3);
    let scene = scene(vec![ball], matt(0.5), vec![local(ground(2.0), PLATE)]);
    let camera = corner_camera(40, 30, 3.0);
    let plate = Image::filled(40, 30, Rgb::ONE);
    let lights = uniform_sky(1.0);
    let job = plain_job(&scene, &lights, &camera, &plate, Stop::Samples(1 << 20));
    let context = Context::new(1);
    context.cancel();
    let wave = integrator(Method::Coupled, job).unwrap().next_wave(&context);
    assert!(wave.finished() && wave.samples == 0);
}

#[test]
fn wrong_jobs_are_refused_with_their_cause() {
    let scene = scene(Vec::new(), matt(0.5), Vec::new());
    let camera = corner_camera(40, 30, 3.0);
    let lights = uniform_sky(1.0);
    let try_with = |plate: &Image<Rgb>, stop| {
        let numbers = Numbers::SobolOwen;
        let job = Job {
            scene: &scene,
            lights: &lights,
            camera: &camera,
            plate,
            stop,
            numbers,
            least_step: 0.0,
            denoise: false,
            technique: Technique::default(),
        };
        job.validate().unwrap_err().to_string()
    };
    let plate = Image::filled(40, 30, Rgb::ONE);
    assert!(try_with(&Image::filled(30, 40, Rgb::ONE), Stop::Samples(1)).contains("30 x 40"));
    assert!(try_with(&plate, Stop::Error(0.0)).contains("render.error"));
    assert!(try_with(&plate, Stop::TimeSeconds(f64::NAN)).contains("render.time"));
    let mut bad = plate.clone();
    bad[(3, 4)] = Rgb::new(1.0, f32::NAN, 0.0);
    assert!(try_with(&bad, Stop::Samples(1)).contains("(3, 4)"));
}
