//! Our conventions against the outside standards: OpenCV's projection, glTF's and USD's cameras.

use glam::{DMat4, DVec2, DVec3, DVec4};
use platelight::camera::{Camera, Distortion, Lens, Pose};

mod lenses;
use lenses::lenses;

fn points() -> impl Iterator<Item = DVec3> {
    (-4..=4).flat_map(|i| {
        (-4..=4).map(move |j| DVec3::new(0.12 * f64::from(i), 0.1 * f64::from(j), -1.3))
    })
}

#[cfg(feature = "opencv")]
#[test]
fn projection_is_that_of_opencv() {
    use platelight::shot::detect::to_calib;
    for lens in lenses() {
        let theirs = to_calib(&lens);
        for point in points() {
            let ours = lens.project(point).expect("in front");
            // OpenCV's axes: y down, z forward.
            let there = [point.x, -point.y, -point.z];
            let opencv = platelight_calib::lens::project_by_opencv(&theirs, there).expect("OpenCV");
            let off = (ours - DVec2::from(opencv)).length();
            assert!(off < 1e-9, "{point}: {ours} is not {opencv:?} ({lens:?})");
            // The copy of the formulas inside calib.
            let copy = theirs.project(there).expect("in front");
            assert!((ours - DVec2::from(copy)).length() < 1e-9);
            let back = theirs.unproject(copy).expect("inside");
            let back = DVec3::new(back[0], -back[1], -back[2]);
            assert!((back - point.normalize()).length() < 1e-9);
        }
    }
}

/// glTF 2.0, 3.10.3: perspective projection by yfov and aspectRatio, camera along −Z, +Y up.
#[test]
fn a_centred_pinhole_is_gltfs_perspective_camera() {
    let (width, height, focal) = (960usize, 640usize, 700.0);
    let lens = Lens::pinhole(focal, width, height);
    let yfov = 2.0 * (0.5 * height as f64 / focal).atan();
    let (aspect, near) = (width as f64 / height as f64, 0.01);
    let a = (0.5 * yfov).tan();
    // The infinite perspective matrix of the specification, row by row.
    let matrix = DMat4::from_cols(
        DVec4::new(1.0 / (aspect * a), 0.0, 0.0, 0.0),
        DVec4::new(0.0, 1.0 / a, 0.0, 0.0),
        DVec4::new(0.0, 0.0, -1.0, -1.0),
        DVec4::new(0.0, 0.0, -2.0 * near, 0.0),
    );
    for point in points() {
        let clip = matrix * point.extend(1.0);
        let device = DVec2::new(clip.x, clip.y) / clip.w;
        // Device −1…1 spans the picture's edges, y up; pixel edges lie half a pixel outside centres.
        let expected = DVec2::new(
            (device.x + 1.0) * 0.5 * width as f64 - 0.5,
            (1.0 - device.y) * 0.5 * height as f64 - 0.5,
        );
        let ours = lens.project(point).expect("in front");
        assert!((ours - expected).length() < 1e-9, "{ours} is not {expected}");
    }
}

/// USD: focalLength and apertures in one unit, row vectors, camera along −Z with +Y up.
#[test]
fn a_pinhole_is_usds_camera() {
    let (width, height) = (960usize, 540usize);
    let (focal_mm, horizontal_mm) = (35.0, 36.0);
    let focal =
        platelight::camera::lens::focal_px(focal_mm, horizontal_mm, width).expect("positive");
    let pose = Pose::look_at(DVec3::new(1.0, 2.0, 3.0), DVec3::new(0.2, 0.1, 0.0), DVec3::Y);
    let pose = pose.expect("looks somewhere");
    let camera = Camera { width, height, lens: Lens::pinhole(focal, width, height), pose };
    // A USD matrix is the transpose of ours: translation in the last row.
    let usd = DMat4::from(camera.pose.world_from_camera).transpose();
    assert_eq!(usd.row(3), DVec4::new(1.0, 2.0, 3.0, 1.0));
    let forward = DVec3::new(0.2, 0.1, 0.0) - DVec3::new(1.0, 2.0, 3.0);
    assert!((usd.row(2).truncate() + forward.normalize()).length() < 1e-12, "third row: +Z, back");
    for offset in points() {
        let world = camera.pose.world_from_camera.transform_point3(offset);
        let row = DVec4::new(world.x, world.y, world.z, 1.0);
        let inverse = usd.inverse();
        // row vector × matrix.
        let local =
            DVec3::new(row.dot(inverse.x_axis), row.dot(inverse.y_axis), row.dot(inverse.z_axis));
        let film_mm = DVec2::new(local.x, local.y) * (focal_mm / -local.z);
        let expected = DVec2::new(
            (film_mm.x / horizontal_mm + 0.5) * width as f64 - 0.5,
            0.5 * height as f64 - film_mm.y / horizontal_mm * width as f64 - 0.5,
        );
        let ours = camera.project_world(world).expect("in front");
        assert!((ours - expected).length() < 1e-9, "{ours} is not {expected}");
    }
}

#[test]
fn every_lens_returns_what_it_projected() {
    for lens in lenses() {
        for point in points() {
            let back = lens.unproject(lens.project(point).expect("in front")).expect("inside");
            assert!((back - point.normalize()).length() < 1e-11);
        }
    }
}
