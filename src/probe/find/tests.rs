//! The ball is found where it is, or not at all.

use super::*;
use crate::camera::Distortion;

/// A street: checkered ground, a bright sky with a darker band, walls on two sides.
fn world(d: DVec3) -> Rgb {
    let turn = d.x.atan2(d.z);
    let l = if d.y < -0.02 {
        let (x, z) = (d.x / d.y, d.z / d.y);
        if (x.floor() + z.floor()).rem_euclid(2.0) < 1.0 { 0.15 } else { 0.3 }
    } else if d.y < 0.3 + 0.2 * (3.0 * turn).sin() {
        0.08 + 0.1 * (7.0 * turn).sin().abs()
    } else {
        1.5 + 0.5 * d.y
    };
    Rgb::splat(l as f32)
}

/// The picture of a ball of D/ρ = 8 in direction `axis`, every pixel 3 × 3 times.
fn photograph(lens: &Lens, width: usize, height: usize, axis: DVec3) -> Image<Rgb> {
    let mirror = Mirror::new(axis.normalize() * 8.0, 1.0).unwrap();
    Image::from_fn(width, height, |x, y| {
        let mut sum = Rgb::ZERO;
        for k in 0..9 {
            let offset = DVec2::new((k % 3) as f64 - 1.0, (k / 3) as f64 - 1.0) / 3.0;
            let ray = lens.unproject(DVec2::new(x as f64, y as f64) + offset).unwrap();
            sum += match mirror.reflect(ray) {
                Some(r) => 0.6 * world(r.direction),
                None => world(ray),
            };
        }
        sum / 9.0
    })
}

fn lens() -> Lens {
    let distortion = Distortion::BrownConrady { k1: -0.1, k2: 0.03, p1: 0.0, p2: 0.0, k3: 0.0 };
    Lens { distortion, ..Lens::pinhole(420.0, 480, 360) }
}

/// Distance of the found axis from the true one, and of the half-angles, px.
fn error_px(found: &BallImage, lens: &Lens, axis: DVec3) -> (f64, f64) {
    let pixel = pixel_angle(lens, axis).unwrap();
    let half_angle = f64::asin(1.0 / 8.0);
    (
        found.rim.axis.angle_between(axis.normalize()) / pixel,
        (found.rim.half_angle_rad - half_angle) / pixel,
    )
}

#[test]
fn a_ball_at_the_side_of_a_wide_lens_is_found_without_a_hint() {
    let lens = lens();
    for axis in [DVec3::new(0.36, -0.14, -1.0), DVec3::new(-0.05, 0.1, -1.0)] {
        let picture = photograph(&lens, 480, 360, axis);
        let found = find(&picture, &lens, &Hints::default()).unwrap();
        let (centre, radius) = error_px(&found, &lens, axis);
        assert!(centre < 1.3 && radius.abs() < 1.0, "{centre} px, {radius} px: {found:?}");
        assert!(found.sigma_px >= 0.3 && found.sigma_px < 0.5);
        assert!(found.rival_px.is_none());
    }
}

#[test]
fn a_ball_cut_by_the_frame_is_found() {
    let lens = lens();
    // A third of the disc lies outside.
    let axis = DVec3::new(0.53, 0.05, -1.0);
    let picture = photograph(&lens, 480, 360, axis);
    let found = find(&picture, &lens, &Hints::default()).unwrap();
    let (centre, radius) = error_px(&found, &lens, axis);
    assert!(centre < 1.6 && radius.abs() < 1.0, "{centre} px, {radius} px: {found:?}");
    assert!(found.rim.arc_rad < 5.5);
}

#[test]
fn a_clean_plate_and_a_hint_find_the_same_ball() {
    let lens = lens();
    let axis = DVec3::new(-0.2, 0.1, -1.0);
    let picture = photograph(&lens, 480, 360, axis);
    let plate = photograph(&lens, 480, 360, DVec3::Z).map(|l| *l * 0.7);
    let with_plate = Hints { clean_plate: Some(&plate), ..Hints::default() };
    let hinted = Hints { circle_px: Some([157.0, 142.0, 54.0]), ..Hints::default() };
    for hints in [with_plate, hinted] {
        let found = find(&picture, &lens, &hints).unwrap();
        let (centre, radius) = error_px(&found, &lens, axis);
        assert!(centre < 1.3 && radius.abs() < 1.0, "{centre} px, {radius} px: {found:?}");
    }
}

#[test]
fn a_hint_that_no_circle_of_the_picture_is_is_refused_at_once() {
    let picture = Image::filled(60, 40, Rgb::splat(0.5));
    let lens = Lens::pinhole(60.0, 60, 40);
    for hint in [[1e9; 3], [30.0, 20.0, 1e9], [f64::NAN, 1.0, 6.0], [300.0, 20.0, 9.0]] {
        let hints = Hints { circle_px: Some(hint), ..Hints::default() };
        let said = find(&picture, &lens, &hints).unwrap_err().to_string();
        assert!(said.contains("hint"), "{hint:?}: {said}");
    }
}

#[test]
fn a_picture_without_a_ball_says_so_but_a_hint_is_believed() {
    let lens = lens();
    let picture = photograph(&lens, 480, 360, DVec3::Z);
    let error = find(&picture, &lens, &Hints::default()).unwrap_err();
    assert!(matches!(error, ProbeError::NoBall { .. }), "{error}");
    let flat = Image::filled(480, 360, Rgb::ONE);
    let hints = Hints { circle_px: Some([200.0, 150.0, 40.0]), ..Hints::default() };
    let found = find(&flat, &lens, &hints).unwrap();
    assert!((found.radius_px - 40.0).abs() < 0.3 && found.score.is_none());
    assert!(found.sigma_px >= 0.99, "{}", found.sigma_px);
}

/// A wall of printed tags, 6 × 6 cells each, turned and seen slightly blurred.
fn tags(turn: f64, cell: f64, seed: u64) -> Image<Rgb> {
    let at = |x: f64, y: f64| -> f32 {
        let p = DVec2::from_angle(turn).rotate(DVec2::new(x, y)) / cell + 400.0;
        // A cell of paper between the tags, a black border, and bits.
        let (tag, bit) = ((p / 9.0).floor(), p.rem_euclid(DVec2::splat(9.0)).floor());
        if bit.min_element() < 1.0 {
            return 0.8;
        }
        let border = bit.min_element() < 2.0 || bit.max_element() > 7.0;
        let key = [tag.x, tag.y, bit.x, bit.y].iter().fold(seed, |key, v| {
            (key ^ *v as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15).rotate_left(29)
        });
        if border || key & 1 == 0 { 0.04 } else { 0.8 }
    };
    Image::from_fn(480, 360, |x, y| {
        let sum: f32 = (0..16)
            .map(|k| at(x as f64 + f64::from(k % 4) / 4.0, y as f64 + f64::from(k / 4) / 4.0))
            .sum();
        Rgb::splat(sum / 16.0)
    })
}

/// They were taken for balls: among so many edges some lie roughly on a circle.
#[test]
fn tags_hold_no_ball() {
    let lens = Lens::pinhole(420.0, 480, 360);
    for (turn, cell, seed) in [(0.1, 7.3, 1), (0.4, 11.9, 2), (0.7, 5.1, 3), (1.2, 16.4, 4)] {
        let said = find(&tags(turn, cell, seed), &lens, &Hints::default());
        let error = said.map(|b| (b.centre_px, b.radius_px, b.score, b.agreement)).unwrap_err();
        assert!(matches!(error, ProbeError::NoBall { .. }), "{error}");
    }
}

/// Nothing but black lies round a masked ball, as round a fisheye's picture, of which the frame cuts a side.
#[test]
fn black_round_a_ball_is_told_and_a_cut_circle_in_black_is_a_fisheye_s() {
    let lens = lens();
    let masked = |axis: DVec3| {
        let mirror = Mirror::new(axis.normalize() * 8.0, 1.0).unwrap();
        let mut picture = photograph(&lens, 480, 360, axis);
        for y in 0..360 {
            for x in 0..480 {
                let ray = lens.unproject(DVec2::new(x as f64, y as f64)).unwrap();
                if mirror.reflect(ray).is_none() {
                    picture[(x, y)] = Rgb::ZERO;
                }
            }
        }
        find(&picture, &lens, &Hints::default())
    };
    let whole = masked(DVec3::new(-0.05, 0.1, -1.0)).unwrap();
    assert!(whole.before_black && whole.agreement > Some(TRUSTED_AGREEMENT));
    let cut = masked(DVec3::new(0.58, 0.05, -1.0)).unwrap_err();
    assert!(matches!(cut, ProbeError::FisheyeBorder { .. }), "{cut}");
    let unmasked = photograph(&lens, 480, 360, DVec3::new(-0.05, 0.1, -1.0));
    assert!(!find(&unmasked, &lens, &Hints::default()).unwrap().before_black);
}

#[test]
fn edges_seen_straight_behind_do_not_stretch_the_plane_of_the_search() {
    let distortion = Distortion::KannalaBrandt { k1: 0.0, k2: 0.0, k3: 0.0, k4: 0.0 };
    let lens = Lens { distortion, ..Lens::pinhole(40.0, 256, 256) };
    let plane = Plane { lens: &lens, width: 256, height: 256 };
    let centre = DVec2::splat(127.5);
    let edge = |radius: f64| Edge {
        at: centre + DVec2::from_angle(0.3) * radius,
        towards: DVec2::from_angle(0.3),
        strength: 1.0,
    };
    // 40 px a radian: 143° and 179.9°.
    let moved = plane.edges(&[edge(100.0), edge(125.6)], DVec2::ZERO, 1.0);
    assert_eq!(moved.len(), 1, "{moved:?}");
    assert!(moved[0].at.length() < 2.0 * plane.focal() * 75f64.to_radians().tan());
}

#[test]
fn hostile_pictures_and_hints_are_refused() {
    let lens = lens();
    for (w, h) in [(0, 0), (1, 1), (15, 400)] {
        assert!(find(&Image::filled(w, h, Rgb::ONE), &lens, &Hints::default()).is_err());
    }
    let flat = Image::filled(64, 64, Rgb::ONE);
    for circle in [[f64::NAN, 1.0, 9.0], [10.0, 10.0, 0.0], [1e9, 1e9, 1e9]] {
        let hints = Hints { circle_px: Some(circle), ..Hints::default() };
        assert!(find(&flat, &lens, &hints).is_err(), "{circle:?}");
    }
    let plate = Image::filled(32, 64, Rgb::ONE);
    let hints = Hints { clean_plate: Some(&plate), ..Hints::default() };
    assert!(matches!(find(&flat, &lens, &hints), Err(ProbeError::Value { .. })));
}
