//! Stitching as an experiment: a known world photographed by a camera that only turns.

use nalgebra::{Matrix3, Rotation3, Vector3};
use platelight_calib::Picture;
use platelight_calib::stitch::{StitchError, stitch};

const WIDTH: usize = 480;
const HEIGHT: usize = 360;
const FOCAL: f64 = 430.0;

/// A number of 0…1 for each cell of a grid.
fn hash(x: i64, y: i64, z: i64, seed: i64) -> f64 {
    let mut h = (x.wrapping_mul(73_856_093) ^ y.wrapping_mul(19_349_663)) as u64;
    h ^= (z.wrapping_mul(83_492_791) ^ seed.wrapping_mul(2_654_435_761)) as u64;
    h = (h ^ (h >> 31)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    h = (h ^ (h >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    (h >> 40) as f64 / (1u64 << 24) as f64
}

/// Light of a direction: blocks of several sizes, soft-edged, that have corners to match.
fn light(d: &Vector3<f64>) -> f32 {
    let mut sum = 0.0;
    for (seed, cells) in [(1, 9.0), (2, 23.0), (3, 51.0)] {
        let cell = d.map(|v| (v * cells).floor() as i64);
        sum += hash(cell.x, cell.y, cell.z, seed) / 3.0;
    }
    sum as f32
}

fn photograph(panorama_from_camera: &Rotation3<f64>) -> Vec<f32> {
    let centre = [(WIDTH as f64 - 1.0) / 2.0, (HEIGHT as f64 - 1.0) / 2.0];
    (0..WIDTH * HEIGHT)
        .map(|k| {
            let (x, y) = ((k % WIDTH) as f64, (k / WIDTH) as f64);
            let samples = (0..9).map(|s| {
                let (dx, dy) = (f64::from(s % 3 - 1) / 3.0, f64::from(s / 3 - 1) / 3.0);
                let ray = Vector3::new(x + dx - centre[0], y + dy - centre[1], FOCAL);
                light(&(panorama_from_camera * ray.normalize()))
            });
            samples.sum::<f32>() / 9.0
        })
        .collect()
}

/// Yaw and pitch of each photograph, degrees.
const TURNS: [(f64, f64); 6] =
    [(-50.0, 4.0), (-30.0, -3.0), (-10.0, 2.0), (10.0, -4.0), (30.0, 3.0), (50.0, 0.0)];

fn turned((yaw, pitch): (f64, f64)) -> Rotation3<f64> {
    Rotation3::from_axis_angle(&Vector3::y_axis(), yaw.to_radians())
        * Rotation3::from_axis_angle(&Vector3::x_axis(), pitch.to_radians())
}

#[test]
fn a_turning_camera_is_found_again() {
    let photographs: Vec<Vec<f32>> = TURNS.iter().map(|&t| photograph(&turned(t))).collect();
    let pictures: Vec<Picture> =
        photographs.iter().map(|luma| Picture::new(WIDTH, HEIGHT, luma).unwrap()).collect();
    let found: Vec<_> =
        stitch(&pictures).unwrap().into_iter().map(|c| c.expect("it overlaps")).collect();
    for camera in &found {
        assert!((camera.focal_px / FOCAL - 1.0).abs() < 0.01, "{}", camera.focal_px);
        let off = (camera.principal_px[0] - (WIDTH as f64 - 1.0) / 2.0).abs();
        assert!(off < 1.0, "{:?}", camera.principal_px);
    }
    let rotation = |k: usize| {
        let rows = found[k].panorama_from_camera;
        Rotation3::from_matrix(&Matrix3::from_fn(|y, x| rows[y][x]))
    };
    for k in 1..TURNS.len() {
        let step = rotation(k - 1).inverse() * rotation(k);
        let wanted = turned(TURNS[k - 1]).inverse() * turned(TURNS[k]);
        let off = (step.inverse() * wanted).angle().to_degrees();
        // Half a pixel is 0.07°.
        assert!(off < 0.15, "step {k}: {off}°");
    }
}

#[test]
fn photographs_of_other_things_are_left_out_and_alone_refused() {
    let mut photographs: Vec<Vec<f32>> =
        TURNS[..3].iter().map(|&t| photograph(&turned(t))).collect();
    photographs.insert(1, photograph(&turned((170.0, 0.0))));
    let pictures: Vec<Picture> =
        photographs.iter().map(|luma| Picture::new(WIDTH, HEIGHT, luma).unwrap()).collect();
    let found = stitch(&pictures).unwrap();
    let there: Vec<bool> = found.iter().map(Option::is_some).collect();
    assert_eq!(there, [true, false, true, true]);
    let refused = stitch(&pictures[..2]);
    assert!(matches!(refused, Err(StitchError::TooFew | StitchError::NoAgreement)), "{refused:?}");
    let flat = vec![0.5; WIDTH * HEIGHT];
    let grey = Picture::new(WIDTH, HEIGHT, &flat).unwrap();
    assert!(stitch(&[grey, grey]).is_err());
}
