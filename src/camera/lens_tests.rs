//! Lens models against OpenCV's figures and their own inverses.

use glam::{DVec2, DVec3};

use super::lens::*;

#[path = "../../tests/lenses/mod.rs"]
mod list;

use list::lenses;

#[test]
fn unproject_inverts_project_over_the_frame() {
    for lens in lenses() {
        for j in 0..=16 {
            for i in 0..=24 {
                let pixel = DVec2::new(i as f64 * 40.0 - 0.5, j as f64 * 40.0 - 0.5);
                let ray = lens
                    .unproject(pixel)
                    .unwrap_or_else(|| panic!("{pixel} outside the field of {lens:?}"));
                assert!((ray.length() - 1.0).abs() < 1e-12);
                let back = lens.project(ray * 7.0).expect("in front");
                assert!((back - pixel).length() < 1e-9, "{pixel} came back as {back}: {lens:?}");
            }
        }
    }
}

#[test]
fn derivatives_are_those_of_differences() {
    for lens in lenses() {
        let point = DVec3::new(0.31, -0.22, -1.3);
        let at = lens.project_with_derivatives(point).expect("in front");
        let h = 1e-6;
        for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
            let far = lens.project(point + axis * h).unwrap();
            let near = lens.project(point - axis * h).unwrap();
            let slope = (far - near) / (2.0 * h);
            let mine = DVec2::new(at.by_point[0].dot(axis), at.by_point[1].dot(axis));
            // Differences of numbers near 1000 px over 1e-6 carry about 1e-7 of rounding.
            assert!((slope - mine).length() < 1e-5, "{slope} against {mine}: {lens:?}");
        }
        let parameters = lens.parameters();
        for i in 0..parameters.len() {
            let moved = |by: f64| {
                let mut p = parameters.clone();
                p[i] += by;
                let distortion = lens.distortion.with_coefficients(&p[4..]).unwrap();
                let lens =
                    Lens { fx: p[0], fy: p[1], cx: p[2], cy: p[3], distortion, covariance: None };
                lens.project(point).unwrap()
            };
            let slope = (moved(h) - moved(-h)) / (2.0 * h);
            assert!((slope - at.by_parameter[i]).length() < 1e-5, "parameter {i}: {lens:?}");
        }
    }
}

#[test]
fn a_folding_model_sees_nothing_beyond_its_fold() {
    let lens = Lens {
        distortion: Distortion::BrownConrady { k1: -0.3, k2: 0.0, p1: 0.0, p2: 0.0, k3: 0.0 },
        ..Lens::pinhole(500.0, 2001, 2001)
    };
    // 1 − 0.9 r² = 0 at r = 1.054, where r_d = 0.7027.
    assert!(lens.project(DVec3::new(1.05, 0.0, -1.0)).is_some());
    assert!(lens.project(DVec3::new(1.06, 0.0, -1.0)).is_none());
    assert!(lens.unproject(DVec2::new(1000.0 + 0.702 * 500.0, 1000.0)).is_some());
    assert!(lens.unproject(DVec2::new(1000.0 + 0.704 * 500.0, 1000.0)).is_none());
    assert!(!lens.covers(2001, 2001));
}

#[test]
fn behind_the_camera_is_nowhere_but_a_fisheye_may_look_back() {
    let lenses = lenses();
    assert!(lenses[0].project(DVec3::Z).is_none());
    assert!(lenses[1].project(DVec3::ZERO).is_none());
    assert!(lenses[1].project(DVec3::splat(f64::NAN)).is_none());
    let wide = Lens {
        distortion: Distortion::KannalaBrandt { k1: 0.0, k2: 0.0, k3: 0.0, k4: 0.0 },
        ..Lens::pinhole(200.0, 1000, 1000)
    };
    let back = DVec3::new(1.0, 0.0, 0.2);
    let pixel = wide.project(back).expect("95 degrees off the axis");
    assert!((wide.unproject(pixel).unwrap() - back.normalize()).length() < 1e-10);
}

#[test]
fn a_nearly_singular_lens_ends_the_search() {
    // A determinant too small to be inverted: the slope's inverse is infinite.
    let distortion = Distortion::Rational {
        k1: 0.0,
        k2: 0.0,
        p1: 0.0,
        p2: 0.0,
        k3: 0.0,
        k4: 1e158,
        k5: 0.0,
        k6: 0.0,
    };
    let lens = Lens { distortion, ..Lens::pinhole(900.0, 960, 640) };
    let (answer, answered) = std::sync::mpsc::channel();
    std::thread::spawn(move || answer.send(lens.covers(960, 640)));
    // Milliseconds where it ends at all.
    let covers = answered.recv_timeout(std::time::Duration::from_secs(20));
    assert_eq!(covers, Ok(false));
}

#[test]
fn crop_shows_the_same_direction() {
    let lens = &lenses()[1];
    let crop = lens.cropped(1575.0, 908.0, 4.0);
    let point = DVec3::new(0.02, -0.01, -1.0);
    let (full, cut) = (lens.project(point).unwrap(), crop.project(point).unwrap());
    let expected = (full + 0.5) * 4.0 - 0.5 - DVec2::new(1575.0, 908.0);
    assert!((cut - expected).length() < 1e-9);
}

#[test]
fn focal_length_from_millimetres() {
    assert!((focal_px(35.0, 36.0, 960).unwrap() - 933.333_333_333_333_4).abs() < 1e-9);
    let equivalent = focal_px_from_35mm(35.0, 960, 640).unwrap();
    assert!((equivalent - 933.333).abs() < 0.001, "3:2 pictures agree with the width rule");
    assert_eq!(focal_px(35.0, 0.0, 960), None);
    assert_eq!(focal_px(f64::NAN, 36.0, 960), None);
}
