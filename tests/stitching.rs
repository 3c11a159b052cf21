//! `platelight panorama --stitch` as a user runs it: a camera that turns in a world with two lamps.
#![cfg(feature = "opencv")]

mod program;

use glam::{DMat3, DQuat, DVec2, DVec3};
use platelight::conventions::{Rgb, luminance};
use platelight::photo::exr_file::{self, ExrPicture, ExrSamples};
use platelight::photo::{Image, ReadOptions};
use platelight::probe::axes::Axes;
use platelight::probe::file::{self, Layout};
use platelight::probe::{Panorama, unwrap};
use program::{platelight, text};

const SIZE: (usize, usize) = (480, 360);
const FOCAL: f64 = 430.0;

/// Yaw to the left and pitch upwards of each photograph, degrees.
const TURNS: [(f64, f64); 6] =
    [(50.0, -4.0), (30.0, 3.0), (10.0, -2.0), (-10.0, 4.0), (-30.0, -3.0), (-50.0, 0.0)];

/// Two lamps 2° across: yaw to the left and elevation, degrees.
const LAMPS: [(f64, f64); 2] = [(33.0, 5.0), (-27.0, -6.0)];
const LAMP: f32 = 3000.0;

fn towards((yaw, pitch): (f64, f64)) -> DVec3 {
    turned((yaw, pitch)) * DVec3::NEG_Z
}

fn turned((yaw, pitch): (f64, f64)) -> DMat3 {
    DMat3::from_rotation_y(yaw.to_radians()) * DMat3::from_rotation_x(pitch.to_radians())
}

/// A number of 0…1 for each cell of a grid.
fn hash(cell: DVec3, seed: i64) -> f32 {
    let [x, y, z] = cell.to_array().map(|v| v as i64);
    let mut h = (x.wrapping_mul(73_856_093) ^ y.wrapping_mul(19_349_663)) as u64;
    h ^= (z.wrapping_mul(83_492_791) ^ seed.wrapping_mul(2_654_435_761)) as u64;
    h = (h ^ (h >> 31)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    h = (h ^ (h >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    (h >> 40) as f32 / (1u64 << 24) as f32
}

/// Blocks of several sizes, which have corners to match, and the lamps.
fn light(d: DVec3, lamps: &[DVec3; 2], cosine: f64) -> f32 {
    if lamps.iter().any(|lamp| lamp.dot(d) > cosine) {
        return LAMP;
    }
    [(1, 9.0), (2, 23.0), (3, 51.0)]
        .iter()
        .map(|&(seed, n)| hash((d * n).floor(), seed) / 3.0)
        .sum()
}

fn photograph(turn: DMat3) -> Vec<f32> {
    let (width, height) = SIZE;
    let centre = DVec2::new(width as f64 - 1.0, height as f64 - 1.0) / 2.0;
    let (lamps, cosine) = (LAMPS.map(towards), 1f64.to_radians().cos());
    (0..width * height)
        .map(|k| {
            let pixel = DVec2::new((k % width) as f64, (k / width) as f64) - centre;
            let samples = (0..9).map(|s| {
                let p = pixel + DVec2::new(f64::from(s % 3 - 1), f64::from(s / 3 - 1)) / 3.0;
                light(turn * DVec3::new(p.x, -p.y, -FOCAL).normalize(), &lamps, cosine)
            });
            samples.sum::<f32>() / 9.0
        })
        .collect()
}

/// Direction and flux of what is brighter than 100 on the side of the middle where `left` says.
fn lamp(panorama: &Panorama, middle: DVec3, left: bool) -> (DVec3, f64) {
    let (mut moment, mut flux) = (DVec3::ZERO, 0.0);
    for y in 0..panorama.height() {
        for x in 0..panorama.width() {
            let d = panorama.direction(x, y);
            let l = f64::from(luminance(panorama.radiance[(x, y)]));
            if l > 5.0 && (middle.cross(d).y > 0.0) == left {
                moment += d * l * panorama.solid_angle(y);
                flux += l * panorama.solid_angle(y);
            }
        }
    }
    (moment.normalize(), flux)
}

#[test]
fn two_lamps_keep_their_flux_their_heights_and_the_angle_between_them() {
    let folder = tempfile::tempdir().unwrap();
    let mut arguments = vec!["panorama".to_owned(), "--stitch".into(), "--json".into()];
    for (k, &turn) in TURNS.iter().enumerate() {
        let mut picture = ExrPicture { width: SIZE.0, height: SIZE.1, ..ExrPicture::default() };
        let light = photograph(turned(turn));
        for channel in ["R", "G", "B"] {
            picture.push(channel, ExrSamples::F32(light.clone()));
        }
        let path = folder.path().join(format!("turn_{k}.exr"));
        exr_file::write(&path, &picture).unwrap();
        arguments.push(text(&path).into());
    }
    let out = folder.path().join("pano.exr");
    arguments.extend(["--width".into(), "2048".into(), "-o".into(), text(&out).into()]);
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let output = platelight(&arguments);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let layout = Layout::LatLong(Axes::OpenExr);
    let options = ReadOptions::default();
    let panorama = file::read(&out, layout, DQuat::IDENTITY, None, &options).unwrap().panorama;
    assert!(unwrap::check_width(panorama.width()).is_ok());

    // Which way is ahead is the stitcher's choice: take the middle of what was measured.
    let seen = |x: usize, y: usize| panorama.coverage[(x, y)] > 0.5;
    let mut middle = DVec3::ZERO;
    for y in 0..panorama.height() {
        for x in (0..panorama.width()).filter(|&x| seen(x, y)) {
            middle += panorama.direction(x, y) * panorama.solid_angle(y);
        }
    }
    let found = [lamp(&panorama, middle, true), lamp(&panorama, middle, false)];
    let solid_angle = 2.0 * std::f64::consts::PI * (1.0 - 1f64.to_radians().cos());
    for ((direction, flux), place) in found.into_iter().zip(LAMPS) {
        let share = flux / (f64::from(LAMP) * solid_angle);
        assert!((share - 1.0).abs() < 0.02, "flux {share} of what it is");
        // Level to what six cameras that pitch by a few degrees can tell.
        let elevation = direction.y.asin().to_degrees();
        assert!((elevation - place.1).abs() < 1.5, "elevation {elevation}, not {}", place.1);
    }
    let between = found[0].0.angle_between(found[1].0).to_degrees();
    let wanted = towards(LAMPS[0]).angle_between(towards(LAMPS[1])).to_degrees();
    assert!((between - wanted).abs() < 0.3, "{between}° between the lamps, not {wanted}°");
}

#[test]
fn photographs_that_do_not_overlap_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let mut paths = Vec::new();
    for (k, turn) in [(0.0, 0.0), (120.0, 0.0)].into_iter().enumerate() {
        let path = folder.path().join(format!("{k}.hdr"));
        let light = photograph(turned(turn));
        let image = Image::from_fn(SIZE.0, SIZE.1, |x, y| Rgb::splat(light[y * SIZE.0 + x]));
        platelight::photo::radiance_hdr::write(&path, &image, Default::default()).unwrap();
        paths.push(path);
    }
    let out = folder.path().join("pano.exr");
    let output =
        platelight(&["panorama", "--stitch", text(&paths[0]), text(&paths[1]), "-o", text(&out)]);
    let told = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{told}");
    assert!(told.contains("--stitch") && !out.exists(), "{told}");
}
