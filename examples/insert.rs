//! The library's main job: plate + camera + panorama + object → composite.
//!
//! `cargo run --release --example insert -- plates/demo/plate.png out/camera.json out/panorama.exr
//! plates/demo/vase.glb out/inserted.png`
//!
//! The object stands on the ground plane y = 0 at the origin; the ground's colour comes from the
//! plate. See `examples/calibrate.rs` and `examples/unwrap.rs` for camera and panorama.

use std::error::Error;
use std::path::PathBuf;

use clap::Parser;
use glam::{DAffine3, DVec2, DVec3};
use platelight::camera::file;
use platelight::composite::{Mode, compose};
use platelight::light::{LightOptions, Lights};
use platelight::photo::{self, ReadOptions, png};
use platelight::probe::Panorama;
use platelight::render::{Context, Job, Method, Numbers, Stop, Technique, integrator};
use platelight::scene::{self, AlbedoSource, Scene};

#[derive(Parser)]
struct Args {
    plate: PathBuf,
    camera: PathBuf,
    panorama: PathBuf,
    object: PathBuf,
    out: PathBuf,
    /// Standard error to reach, relative to the plate.
    #[arg(long, default_value_t = 0.02)]
    error: f64,
}

fn main() -> Result<(), Box<dyn Error>> {
    let args = Args::parse();
    let plate = photo::read(&args.plate, &ReadOptions::default())?;
    let camera = file::read(&args.camera)?.camera;
    let panorama = photo::read(&args.panorama, &ReadOptions::default())?.linear;
    let lights = Lights::new(&Panorama::from_radiance(panorama), &LightOptions::default())?;

    // The object, and the ground it stands on.
    let mut scene = Scene::new(DVec3::ZERO);
    scene.add_object(&scene::read(&args.object)?, &DAffine3::IDENTITY)?;
    scene.add_plane(DVec2::splat(3.0), DVec3::ZERO, DVec3::Y, AlbedoSource::Plate)?;

    // What the object changes, until its error is small enough.
    let job = Job {
        scene: &scene,
        lights: &lights,
        camera: &camera,
        plate: &plate.linear,
        stop: Stop::Error(args.error),
        numbers: Numbers::default(),
        least_step: plate.least_step(),
        denoise: false,
        technique: Technique::default(),
    };
    let mut integrator = integrator(Method::default(), job)?;
    let context = Context::new(0);
    let wave = loop {
        let wave = integrator.next_wave(&context);
        if wave.finished() {
            break wave;
        }
    };
    println!("standard error {:.2} %", 100.0 * wave.error);

    let composite = compose(&plate, &integrator.snapshot(), Mode::Ratio)?;
    let changed = composite.tally.changed;
    println!("{changed} of {} pixels changed", plate.linear.pixels().len());
    let samples = png::srgb_codes(&composite.linear);
    let (width, height) = (composite.linear.width(), composite.linear.height());
    png::write(&args.out, &samples, width, height, &plate.encoding)?;
    println!("wrote {}", args.out.display());
    Ok(())
}
