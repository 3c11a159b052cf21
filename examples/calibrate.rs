//! Photographs of a board and of a tag → the camera: its lens and its place, with errors.
//!
//! `cargo run --release --example calibrate -- plates/demo/shot.toml out/camera.json`

use std::error::Error;
use std::path::PathBuf;

use clap::Parser;
use platelight::camera::{Camera, file};
use platelight::photo::{self, ReadOptions};
use platelight::shot::camera_keys::CameraSource;
use platelight::shot::{ShotFile, calibrate, locate};

#[derive(Parser)]
struct Args {
    /// Shot file that names the photographs.
    shot: PathBuf,
    /// Where the camera is written.
    out: PathBuf,
}

fn main() -> Result<(), Box<dyn Error>> {
    let args = Args::parse();
    let shot = ShotFile::read(&args.shot)?;
    let plate = photo::read(&shot.plate.file, &ReadOptions::default())?;

    // The lens: as many of its terms as the boards can hold.
    let size = [plate.linear.width(), plate.linear.height()];
    let found = calibrate::find_lens(&shot.camera.source, size, &plate.facts, &plate.path)?;
    let sigmas = found.lens.sigmas().unwrap_or_else(|| vec![f64::NAN; 4]);
    println!("focal length   {:.2} ± {:.2} px", found.lens.fx, sigmas[0]);
    println!("principal point {:.2}, {:.2} px", found.lens.cx, found.lens.cy);
    println!("distortion     {:?}", found.lens.distortion);

    // The place: from the tag that lay in the picture.
    let board = match &shot.camera.source {
        CameraSource::Boards { board, .. } => Some(board),
        _ => None,
    };
    let size = [found.width, found.height];
    let place = locate::find_pose(&shot.pose, &found.lens, size, board)?;
    println!("camera stands at {:.4} m", place.pose.position());
    if let Some((turn, shift)) = place.pose.sigmas() {
        println!("  ± {:.1} mm, ± {:.3}°", 1e3 * shift.length(), turn.length().to_degrees());
    }
    for warning in found.warnings.iter().chain(&place.warnings) {
        println!("note: {warning}");
    }

    let [width, height] = size;
    let camera = Camera { width, height, lens: found.lens, pose: place.pose };
    file::write(&args.out, &camera, true)?;
    println!("wrote {}", args.out.display());
    Ok(())
}
