//! Bracketed photographs of a mirror ball → the light of the place as a lat-long panorama.
//!
//! `cargo run --release --example unwrap -- plates/demo/shot.toml out/camera.json out/panorama.exr`
//!
//! The camera file gives the lens (see `examples/calibrate.rs`); where the camera stood for the ball
//! comes from the board photographed from there.

use std::error::Error;
use std::path::PathBuf;

use clap::Parser;
use glam::DVec3;
use platelight::bracket::{Frame, MergeOptions, exposure, merge};
use platelight::camera::{Camera, file};
use platelight::photo::{self, ReadOptions};
use platelight::probe::photographed;
use platelight::probe::{self, Ball, clipped_regions, find, unwrap};
use platelight::shot::camera_keys::CameraSource;
use platelight::shot::probe_keys::ProbeSource;
use platelight::shot::{ShotFile, exposures, locate, pictures};

#[derive(Parser)]
struct Args {
    /// Shot file that names the photographs.
    shot: PathBuf,
    /// The camera's lens.
    camera: PathBuf,
    /// Where the panorama is written, in the plate's linear values.
    out: PathBuf,
}

fn main() -> Result<(), Box<dyn Error>> {
    let args = Args::parse();
    let shot = ShotFile::read(&args.shot)?;
    let ProbeSource::Ball(ball) = &shot.probe.source else {
        return Err("the shot has no mirror ball".into());
    };
    let read = |path: &PathBuf| photo::read_encoded(path, &ReadOptions::default());

    // Merge the bracket into radiance, with its variance.
    let photos = pictures::expand(&ball.photos)?.iter().map(read).collect::<Result<Vec<_>, _>>()?;
    let exposures = exposure::from_exif(&photos)?;
    let frames: Vec<Frame> =
        photos.iter().zip(exposures).map(|(photo, exposure)| Frame { photo, exposure }).collect();
    let merged = merge(&frames, &MergeOptions::default())?;

    // The camera at the place of the ball's photographs, through their cut-out.
    let Camera { width, height, lens, pose } = file::read(&args.camera)?.camera;
    let board = match &shot.camera.source {
        CameraSource::Boards { board, .. } => Some(board),
        _ => None,
    };
    let pose = match &ball.pose {
        Some(source) => locate::find_pose(source, &lens, [width, height], board)?.pose,
        None => pose,
    };
    let mut camera = Camera { width, height, lens, pose };
    if let Some(crop) = ball.crop {
        let picture = &merged.radiance.mean;
        camera = camera.cropped(crop.x, crop.y, crop.scale, picture.width(), picture.height());
    }

    // Find the rim, then follow every ray into the ball.
    let found = find::find(&merged.radiance.mean, &camera.lens, &find::Hints::default())?;
    let reflectance = DVec3::from(ball.reflectance).as_vec3();
    let ball = Ball::new(ball.at.into(), ball.radius, reflectance)?;
    let table = unwrap::Support { point: DVec3::ZERO, normal: DVec3::Y };
    let panorama =
        photographed::ball(&merged.radiance, &camera, &found, &ball, Some(&table), None)?;
    println!("ball: radius {:.1} ± {:.1} px", found.radius_px, found.sigma_px);
    println!("clipped lights: {}", clipped_regions(&panorama).len());

    let plate = photo::read(&shot.plate.file, &ReadOptions::default())?;
    let keys = &shot.plate;
    let scale = exposures::plate_scale(&plate, &keys.exposure, keys.relative_exposure)?.factor;
    let up = panorama.irradiance(DVec3::Y) * scale as f32;
    println!("irradiance of the ground: {up:.3} (plate's linear values)");
    let (width, height) = (panorama.width(), panorama.height());
    probe::file::write(&args.out, &panorama.scaled(scale as f32))?;
    println!("wrote {} ({width} × {height})", args.out.display());
    Ok(())
}
