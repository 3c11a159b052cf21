//! A shot of a few pixels that runs in a moment: camera, pose and panorama from files.

#![allow(dead_code, reason = "every test program uses some of it")]

use std::path::{Path, PathBuf};

use glam::DVec3;
use platelight::camera::{Camera, Lens, Pose, file};
use platelight::conventions::Rgb;
use platelight::photo::exr_file::{self, ExrPicture, ExrSamples};
use platelight::photo::{Encoding, EncodingSource, Image, Primaries, Samples, Transfer, png};

pub const WIDTH: usize = 64;
pub const HEIGHT: usize = 48;

/// What the plate is stored as.
#[derive(Clone, Copy, Debug)]
pub enum Plate {
    ExrFloat,
    ExrHalf,
    Png16,
    Png8,
}

/// A value between 0.1 and 0.7 that differs from pixel to pixel and channel to channel.
fn value(index: usize) -> f32 {
    let mixed = (index as u32).wrapping_mul(2_654_435_761) >> 8;
    0.1 + 0.6 * mixed as f32 / (1u32 << 24) as f32
}

/// The camera of [`write_shot`].
pub fn camera() -> Camera {
    let pose = Pose::look_at(DVec3::new(0.0, 1.0, 1.0), DVec3::ZERO, DVec3::Y);
    Camera {
        width: WIDTH,
        height: HEIGHT,
        lens: Lens::pinhole(60.0, WIDTH, HEIGHT),
        pose: pose.expect("the camera looks at the origin"),
    }
}

/// Writes plate, camera.json, panorama.exr and shot.toml; returns the shot file.
///
/// `objects` is TOML for `[[object]]`. The world: a level plane under a lat-long with a bright
/// quarter, seen from 1 m above.
pub fn write_shot(folder: &Path, plate: Plate, objects: &str) -> PathBuf {
    std::fs::create_dir_all(folder).expect("a folder to write into");
    let plate_file = write_plate(folder, plate);
    file::write(&folder.join("camera.json"), &camera(), true).expect("camera.json");
    write_panorama(&folder.join("panorama.exr"));
    let shot = folder.join("shot.toml");
    let text = format!(
        "[plate]\nfile = \"{plate_file}\"\nrelative_exposure = 1.0\n\
         [camera]\nfile = \"camera.json\"\n\
         [pose]\nfile = \"camera.json\"\n\
         [probe]\npanorama = {{ file = \"panorama.exr\" }}\n\
         [support]\nplane = {{ size = [4.0, 4.0] }}\n\
         [render]\nsamples = 8\n{objects}"
    );
    std::fs::write(&shot, text).expect("shot.toml");
    shot
}

fn write_plate(folder: &Path, plate: Plate) -> &'static str {
    let n = 3 * WIDTH * HEIGHT;
    let encoding = Encoding {
        transfer: Transfer::Srgb,
        primaries: Primaries::Rec709,
        source: EncodingSource::FormatRule,
    };
    let write_png = |samples: Samples| {
        png::write(&folder.join("plate.png"), &samples, WIDTH, HEIGHT, &encoding).expect("plate");
        "plate.png"
    };
    match plate {
        Plate::Png8 => {
            let data = (0..n).map(|i| (255.0 * value(i)) as u8).collect();
            write_png(Samples::U8 { channels: 3, data })
        }
        Plate::Png16 => {
            let data = (0..n).map(|i| (65535.0 * value(i)) as u16).collect();
            write_png(Samples::U16 { channels: 3, data })
        }
        Plate::ExrFloat | Plate::ExrHalf => {
            let mut picture = ExrPicture { width: WIDTH, height: HEIGHT, ..ExrPicture::default() };
            for (c, name) in ["R", "G", "B"].into_iter().enumerate() {
                let values = (0..WIDTH * HEIGHT).map(|i| value(3 * i + c));
                picture.push(
                    name,
                    match plate {
                        Plate::ExrHalf => ExrSamples::half(values).0,
                        _ => ExrSamples::F32(values.collect()),
                    },
                );
            }
            exr_file::write(&folder.join("plate.exr"), &picture).expect("plate");
            "plate.exr"
        }
    }
}

fn write_panorama(path: &Path) {
    let (width, height) = (64, 32);
    let light = Image::from_fn(width, height, |x, y| {
        let bright = (8..16).contains(&x) && (4..8).contains(&y);
        if bright { Rgb::new(6.0, 5.0, 4.0) } else { Rgb::splat(0.5) }
    });
    let mut picture = ExrPicture { width, height, ..ExrPicture::default() };
    for (c, name) in ["R", "G", "B"].into_iter().enumerate() {
        let values = light.pixels().iter().map(|l| l.to_array()[c]).collect();
        picture.push(name, ExrSamples::F32(values));
    }
    exr_file::write(path, &picture).expect("panorama");
}

/// An OBJ cube with sides of `side` metres that stands on the origin; returns its `[[object]]`.
pub fn write_cube(folder: &Path, side: f64) -> String {
    std::fs::create_dir_all(folder).expect("a folder to write into");
    let h = 0.5 * side;
    let mut text = String::new();
    for y in [0.0, side] {
        for (x, z) in [(-h, -h), (h, -h), (h, h), (-h, h)] {
            text += &format!("v {x} {y} {z}\n");
        }
    }
    text += "f 1 2 3 4\nf 5 8 7 6\nf 1 5 6 2\nf 2 6 7 3\nf 3 7 8 4\nf 4 8 5 1\n";
    std::fs::write(folder.join("cube.obj"), text).expect("cube.obj");
    "[[object]]\nfile = \"cube.obj\"\n".to_owned()
}
