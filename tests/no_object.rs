//! Pixels that no object changes are the plate's own, bit for bit.

mod tiny;

use std::path::Path;

use platelight::photo::{self, Image, Photo, ReadOptions, Samples};
use platelight::render::Context;
use platelight::shot::ShotFile;
use platelight::shot::run::{RunOptions, run_frames};
use platelight::shot::watch::Silent;
use tiny::{HEIGHT, Plate, WIDTH, write_cube, write_shot};

const PLATES: [Plate; 4] = [Plate::ExrFloat, Plate::ExrHalf, Plate::Png16, Plate::Png8];

fn run_shot(shot: &Path, out: &Path, seed: u64) {
    let file = ShotFile::read(shot).expect("the shot file is right");
    let context = Context::new(seed);
    for finished in run_frames(&file, out, &RunOptions::default(), &context, &Silent) {
        assert!(finished.expect("the shot runs").complete);
    }
}

fn read(path: &Path, layer: Option<&str>) -> Photo {
    let options = ReadOptions { layer: layer.map(str::to_owned), ..ReadOptions::default() };
    photo::read(path, &options).expect("a picture that was just written")
}

/// The finished picture in the plate's own format.
fn result_of(out: &Path, plate: Plate) -> Photo {
    let name = match plate {
        Plate::ExrFloat | Plate::ExrHalf => "composite.exr",
        Plate::Png16 | Plate::Png8 => "composite.png",
    };
    read(&out.join(name), None)
}

/// Bits of the colour channels of a pixel.
fn colour(samples: &Samples, pixel: usize) -> [u32; 3] {
    let at = |c: usize, channels: usize| channels * pixel + c;
    [0, 1, 2].map(|c| match samples {
        Samples::U8 { channels, data } => u32::from(data[at(c, *channels)]),
        Samples::U16 { channels, data } => u32::from(data[at(c, *channels)]),
        Samples::F16 { channels, data } => u32::from(data[at(c, *channels)].to_bits()),
        Samples::F32 { channels, data } => data[at(c, *channels)].to_bits(),
    })
}

fn differing(a: &Samples, b: &Samples) -> Image<bool> {
    assert_eq!(std::mem::discriminant(a), std::mem::discriminant(b), "the sample type changed");
    Image::from_fn(WIDTH, HEIGHT, |x, y| {
        let pixel = y * WIDTH + x;
        colour(a, pixel) != colour(b, pixel)
    })
}

#[test]
fn without_objects_the_result_is_the_plate_in_every_sample_type() {
    let folder = tempfile::tempdir().expect("a folder");
    for plate in PLATES {
        let place = folder.path().join(format!("{plate:?}"));
        let shot = write_shot(&place, plate, "");
        run_shot(&shot, &place.join("out"), 0);
        let before = ShotFile::read(&shot).expect("a shot").plate.file;
        let result = result_of(&place.join("out"), plate);
        let differing = differing(&read(&before, None).samples, &result.samples);
        assert!(differing.pixels().iter().all(|&d| !d), "{plate:?} was changed");
    }
}

#[test]
fn every_changed_pixel_lies_in_the_influence_layer() {
    let folder = tempfile::tempdir().expect("a folder");
    for plate in PLATES {
        let place = folder.path().join(format!("{plate:?}"));
        let cube = write_cube(&place, 0.15);
        let shot = write_shot(&place, plate, &cube);
        run_shot(&shot, &place.join("out"), 1);
        let before = ShotFile::read(&shot).expect("a shot").plate.file;
        let result = result_of(&place.join("out"), plate);
        let influence = read(&place.join("out/composite.exr"), Some("influence")).linear;
        let differing = differing(&read(&before, None).samples, &result.samples);
        let mut changed = 0;
        for (d, i) in differing.pixels().iter().zip(influence.pixels()) {
            assert!(!d || i.x > 0.5, "{plate:?}: a pixel changed outside the influence layer");
            changed += usize::from(*d);
        }
        // The cube covers about 15 × 15 px: something must have changed, and not everything.
        assert!(changed > 50 && changed < WIDTH * HEIGHT, "{plate:?}: {changed} px changed");
    }
}

#[test]
fn same_input_and_seed_give_the_same_bytes_on_any_number_of_threads_and_without_avx2() {
    let folder = tempfile::tempdir().expect("a folder");
    let cube = write_cube(folder.path(), 0.15);
    let shot = write_shot(folder.path(), Plate::ExrHalf, &cube);
    let bytes = [(1, false), (3, false), (2, true)].map(|(threads, portable)| {
        if portable {
            platelight::trace::portable_only();
        }
        let out = folder.path().join(format!("out{threads}"));
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| run_shot(&shot, &out, 7));
        ["composite.exr", "composite.png", "panorama.exr", "camera.json"]
            .map(|name| std::fs::read(out.join(name)).expect("a result"))
    });
    assert!(bytes[0] == bytes[1], "one and three threads differ");
    assert!(bytes[0] == bytes[2], "with and without AVX2 differ");
}
