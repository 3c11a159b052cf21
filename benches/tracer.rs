//! The path tracer on the demo's three objects (matt, varnished, metal) on a table in the sun.
//!
//! `cargo bench --bench tracer`. For every method the time of four samples in each pixel that the
//! objects change, getting ready (structures, tables of the light, what can be seen) included.

use std::path::Path;
use std::sync::LazyLock;

use divan::{Bencher, black_box};
use glam::{DAffine3, DVec2, DVec3, Vec3};
use platelight::camera::{Camera, Lens, Pose};
use platelight::conventions::Rgb;
use platelight::light::{LightOptions, Lights};
use platelight::photo::Image;
use platelight::probe::Panorama;
use platelight::render::{Context, Job, Method, Numbers, Stop, Technique, integrator};
use platelight::scene::{self, AlbedoSource, Scene};

const WIDTH: usize = 240;
const HEIGHT: usize = 160;

struct Place {
    scene: Scene,
    lights: Lights,
    camera: Camera,
    plate: Image<Rgb>,
}

static PLACE: LazyLock<Place> = LazyLock::new(|| {
    let mut scene = Scene::new(DVec3::ZERO);
    for (file, x, z) in [("spot", -0.15, 0.05), ("vase", 0.1, -0.1), ("bowl", 0.2, 0.12)] {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("plates/demo/{file}.glb"));
        let model = scene::read(&path).expect("an object of the demo");
        let place = DAffine3::from_translation(DVec3::new(x, 0.0, z));
        scene.add_object(&model, &place).expect("an object of the demo");
    }
    let grey = AlbedoSource::Constant(Rgb::splat(0.4));
    scene.add_plane(DVec2::splat(4.0), DVec3::ZERO, DVec3::Y, grey).expect("a table");

    // A sky that brightens toward the horizon, a grey ground, and a sun of four texels
    let sun = [Vec3::new(0.5, 0.7, 0.5), Vec3::new(0.49, 0.7, 0.51)].map(Vec3::normalize);
    let radiance = Image::from_fn(512, 256, |i, j| {
        if sun.iter().any(|&sun| lat_long(i, j).dot(sun) > 0.9999) {
            Rgb::splat(5000.0)
        } else if j < 128 {
            Rgb::new(0.5, 0.7, 1.0) * (0.6 + 0.005 * j as f32)
        } else {
            Rgb::splat(0.15)
        }
    });
    let panorama = Panorama::from_radiance(radiance);
    let lights = Lights::new(&panorama, &LightOptions::default()).expect("a sky");
    let eye = DVec3::new(0.3, 0.6, 1.2);
    let pose = Pose::look_at(eye, DVec3::new(0.0, 0.1, 0.0), DVec3::Y).expect("a pose");
    let lens = Lens::pinhole(1.5 * WIDTH as f64, WIDTH, HEIGHT);
    let camera = Camera { width: WIDTH, height: HEIGHT, lens, pose };
    Place { scene, lights, camera, plate: Image::filled(WIDTH, HEIGHT, Rgb::splat(0.3)) }
});

/// Direction of a texel's centre.
fn lat_long(column: usize, row: usize) -> Vec3 {
    let longitude = (0.5 - (column as f32 + 0.5) / 512.0) * std::f32::consts::TAU;
    let polar = (row as f32 + 0.5) / 256.0 * std::f32::consts::PI;
    Vec3::new(longitude.sin() * polar.sin(), polar.cos(), longitude.cos() * polar.sin())
}

#[divan::bench(args = ["coupled", "two-pass", "two-pass-independent"], sample_count = 10, sample_size = 1)]
fn four_samples(bencher: Bencher, method: &str) {
    let place = &*PLACE;
    let method = match method {
        "coupled" => Method::Coupled,
        "two-pass" => Method::TwoPass { same_numbers: true },
        _ => Method::TwoPass { same_numbers: false },
    };
    bencher.bench(|| {
        let job = Job {
            scene: &place.scene,
            lights: &place.lights,
            camera: &place.camera,
            plate: &place.plate,
            stop: Stop::Samples(4),
            numbers: Numbers::default(),
            least_step: 0.0,
            denoise: false,
            technique: Technique::default(),
        };
        let mut integrator = integrator(method, job).expect("a job");
        let context = Context::new(1);
        while !integrator.next_wave(&context).finished() {}
        black_box(integrator.snapshot())
    });
}

fn main() {
    divan::main();
}
