//! A camera that bends its tones: plate and bracket read through the curve that the bracket shows.

use std::f32::consts::TAU;
use std::fs;
use std::path::{Path, PathBuf};

use platelight::conventions::{Rgb, luminance};
use platelight::photo::{self, Photo, ReadOptions, Samples, png};
use platelight::render::Context;
use platelight::shot::ShotFile;
use platelight::shot::run::{RunOptions, run_frames};
use platelight::shot::stop::StopKeys;
use platelight::shot::watch::Silent;

fn demo() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("plates/demo")
}

/// The demo's plate and bracket as a camera with more contrast would have stored them.
fn write_bent(folder: &Path, colour: &str) -> PathBuf {
    let bend = |code: u8| {
        let x = f32::from(code) / 255.0;
        ((x - 0.1 * (TAU * x).sin()) * 255.0).round() as u8
    };
    let mut times = Vec::new();
    for name in ["plate", "ball_b0", "ball_b1", "ball_b2", "ball_b3", "ball_b4", "ball_b5"] {
        let extension = if name == "plate" { "png" } else { "jpg" };
        let path = demo().join(name).with_extension(extension);
        let photo = photo::read(&path, &ReadOptions::default()).unwrap();
        let Samples::U8 { channels, data } = &photo.samples else { panic!("8-bit files") };
        let bent =
            Samples::U8 { channels: *channels, data: data.iter().map(|&c| bend(c)).collect() };
        let (width, height) = (photo.linear.width(), photo.linear.height());
        let to = folder.join(name).with_extension("png");
        png::write(&to, &bent, width, height, &photo.encoding).unwrap();
        if name != "plate" {
            let f = photo.facts;
            times.push(format!(
                "{{ time_s = {:?}, f_number = {:?}, iso = {:?} }}",
                f.exposure_s.unwrap(),
                f.f_number.unwrap(),
                f.iso.unwrap()
            ));
        }
    }
    let demo = demo().to_string_lossy().replace('\\', "/");
    let mut text = fs::read_to_string(format!("{demo}/shot.toml")).unwrap();
    for name in ["board_*", "tag", "ball_pose_board", "props", "spot", "vase", "bowl"] {
        for extension in ["jpg", "glb"] {
            let file = format!("\"{name}.{extension}\"");
            text = text.replace(&file, &format!("\"{demo}/{name}.{extension}\""));
        }
    }
    text = text
        .replace("file = \"plate.png\"", &format!("file = \"plate.png\"\ncolour = \"{colour}\""))
        .replace(
            "photos = \"ball_b*.jpg\"",
            &format!("photos = \"ball_b*.png\"\nexposures = [{}]", times.join(", ")),
        );
    let path = folder.join(format!("{colour}.toml"));
    fs::write(&path, text).unwrap();
    path
}

fn render(shot: &Path, out: &Path) -> (Photo, Photo) {
    let file = ShotFile::read(shot).expect("the shot file is right");
    let options = RunOptions { stop: Some(StopKeys::Samples(2)), ..RunOptions::default() };
    let context = Context::new(1);
    for finished in run_frames(&file, out, &options, &context, &Silent) {
        assert!(finished.expect("the shot runs").complete);
    }
    let read = |layer: Option<&str>| {
        let options = ReadOptions { layer: layer.map(str::to_owned), ..ReadOptions::default() };
        photo::read(&out.join("composite.exr"), &options).unwrap()
    };
    (read(None), read(Some("object")))
}

/// Mean light of the objects over the light of the table beside them.
fn objects_over_table((composite, object): &(Photo, Photo)) -> f64 {
    let sum = |pixels: &mut dyn Iterator<Item = &Rgb>| -> f64 {
        pixels.map(|&p| f64::from(luminance(p))).sum()
    };
    let width = composite.linear.width();
    let table = &composite.linear.pixels()[width * (composite.linear.height() - 40)..];
    sum(&mut object.linear.pixels().iter()) / sum(&mut table.iter())
}

#[test]
fn objects_fit_the_plate_of_a_camera_that_bends_its_tones() {
    let folder = tempfile::tempdir().unwrap();
    let straight = objects_over_table(&render(&demo().join("shot.toml"), &folder.path().join("s")));
    let ratio = |colour: &str| {
        let shot = write_bent(folder.path(), colour);
        objects_over_table(&render(&shot, &folder.path().join(colour))) / straight
    };
    let (recovered, as_srgb) = (ratio("bracket"), ratio("srgb"));
    println!("objects over table: curve recovered ×{recovered:.3}, read as sRGB ×{as_srgb:.3}");
    assert!((recovered - 1.0).abs() < 0.06, "{recovered}");
    assert!((as_srgb - 1.0).abs() > 0.1, "the curve was not worth recovering: {as_srgb}");
}
