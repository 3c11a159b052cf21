//! Success and error of registering by content, on places with known rotations.

use std::path::{Path, PathBuf};

use glam::{DQuat, DVec3};

use super::*;
use crate::conventions::Rgb;
use crate::photo::ReadOptions;
use crate::probe::Panorama;
use crate::probe::axes::Axes;
use crate::probe::file::{self, Layout};
use crate::probe::test_worlds::{Random, overcast, picture, room};
use crate::probe::view::Seeing;

/// What a probe sees of the world: in axes of its own, in another exposure, with noise, a photographer in
/// front of it, and nothing in its blind cone (a cap of `blind_rad` opposite).
fn seen(
    random: &mut Random,
    world: impl Fn(DVec3) -> Rgb,
    world_from_view: DQuat,
    blind_rad: f64,
) -> View {
    let mut panorama = picture(256, |d| world(world_from_view * d));
    let camera = random.direction();
    let exposure = (0.5 * random.normal()).exp();
    for y in 0..128 {
        for x in 0..256 {
            let d = panorama.direction(x, y);
            if d.angle_between(-camera) < blind_rad {
                panorama.coverage[(x, y)] = 0.0;
                panorama.validity[(x, y)] = Validity::Filled;
                panorama.radiance[(x, y)] = Rgb::ONE;
                continue;
            }
            if d.angle_between(camera) < 0.25 {
                panorama.radiance[(x, y)] = Rgb::splat(0.02);
            }
            let noise = 1.0 + 0.02 * random.normal();
            panorama.radiance[(x, y)] *= (exposure * noise) as f32;
        }
    }
    let seeing = Seeing::Ball { toward_camera: camera, half_angle_rad: 0.1, px_per_rad: 1e3 };
    View { panorama, seeing }
}

/// Errors in degrees of `n` pairs of views in random rotations; `None` where it was refused.
fn errors(
    n: u64,
    blind_rad: [f64; 2],
    world: impl Fn(u64, usize, DVec3) -> Rgb,
) -> Vec<Option<(f64, Content)>> {
    (0..n)
        .map(|k| {
            let mut random = Random(1000 + k);
            let (a, b) = (random.rotation(), random.rotation());
            let first = seen(&mut random, |d| world(k, 0, d), a, blind_rad[0]);
            let second = seen(&mut random, |d| world(k, 1, d), b, blind_rad[1]);
            let truth = a.conjugate() * b;
            by_content(&first, &second)
                .ok()
                .map(|found| (truth.angle_between(found.registration.rotation).to_degrees(), found))
        })
        .collect()
}

/// Prints and returns (found within `within_deg`, refused, rms of the found in degrees).
fn told(name: &str, errors: &[Option<(f64, Content)>], within_deg: f64) -> (usize, usize, f64) {
    let good: Vec<&(f64, Content)> = errors.iter().flatten().filter(|e| e.0 < within_deg).collect();
    let refused = errors.iter().filter(|e| e.is_none()).count();
    let mean = |of: &dyn Fn(&(f64, Content)) -> f64| {
        good.iter().map(|e| of(e)).sum::<f64>() / good.len().max(1) as f64
    };
    let rms = mean(&|e| e.0 * e.0).sqrt();
    let said = mean(&|e| e.1.registration.sigma_rad().to_degrees().powi(2)).sqrt();
    let least = good.iter().map(|e| e.1.lead).fold(f64::INFINITY, f64::min);
    println!(
        "{name}: {} of {} found, {refused} refused, rms {rms:.3}° (told {said:.3}°), parallax {:.2}°, correlation \
         {:.2}, least lead {least:.0}",
        good.len(),
        errors.len(),
        mean(&|e| e.1.parallax_rad.to_degrees()),
        mean(&|e| e.1.correlation),
    );
    (good.len(), refused, rms)
}

const BALL: f64 = 0.15;
const HEMISPHERE: f64 = 1.57;

#[test]
fn any_rotation_is_found_in_rooms_and_under_overcast_skies() {
    let here = DVec3::new(0.3, -0.2, 0.4);
    let rooms = errors(5, [BALL, BALL], |k, _, d| room(here, d, k));
    let skies = errors(5, [BALL, BALL], |k, _, d| overcast(d, k));
    let halves = errors(5, [BALL, HEMISPHERE], |k, _, d| room(here, d, k));
    for (name, errors) in [("rooms", &rooms), ("overcast", &skies), ("half of a room", &halves)] {
        let (good, refused, rms) = told(name, errors, 1.0);
        assert!(good + refused == 5 && refused <= 1, "{name}: {good} found, {refused} refused");
        // Texels are 1.4°.
        assert!(rms < 0.1, "{name}: {rms}°");
    }
}

/// F32: a third of a metre between the probes in a room five metres long.
#[test]
fn another_place_widens_the_error_that_is_told() {
    let eyes = [DVec3::new(0.3, -0.2, 0.4), DVec3::new(0.0, -0.2, 0.3)];
    let apart = errors(5, [BALL, BALL], |k, view, d| room(eyes[view], d, k));
    let (good, refused, rms) = told("0.3 m apart", &apart, 10.0);
    assert!(good + refused == 5 && good >= 4, "{good} found, {refused} refused");
    assert!(rms < 4.0, "{rms}°");
    let z2 = apart
        .iter()
        .flatten()
        .map(|(error, found)| (error / found.registration.sigma_rad().to_degrees()).powi(2));
    let z = (z2.sum::<f64>() / good as f64).sqrt();
    assert!((0.3..3.0).contains(&z), "errors are {z} times as large as told");
}

#[test]
fn other_places_and_mirrored_panoramas_are_refused() {
    let here = DVec3::new(0.3, -0.2, 0.4);
    let other = errors(2, [BALL, BALL], |k, view, d| match view {
        0 => room(here, d, k),
        _ => overcast(d, k),
    });
    let (_, refused, _) = told("a room and a yard", &other, 360.0);
    assert_eq!(refused, 2);
    let mirrored = |view: usize, d: DVec3| if view == 0 { d } else { DVec3::new(-d.x, d.y, d.z) };
    let mut random = Random(5);
    let (a, b) = (random.rotation(), random.rotation());
    let first = seen(&mut random, |d| room(here, mirrored(0, d), 1), a, BALL);
    let second = seen(&mut random, |d| room(here, mirrored(1, d), 1), b, BALL);
    assert_eq!(by_content(&first, &second), Err(RegisterError::Mirrored));
}

#[test]
fn nothing_in_common_and_nothing_to_see_are_refused() {
    let mut random = Random(3);
    let mut grey = || seen(&mut random, |_| Rgb::ONE, DQuat::IDENTITY, 0.1);
    assert!(by_content(&grey(), &grey()).is_err());
    let tiny = View::even(Panorama::from_radiance(crate::photo::Image::filled(16, 8, Rgb::ONE)));
    assert!(by_content(&tiny, &tiny).unwrap_err().to_string().contains("16 texels"));
}

/// Light of three places with known answers, photographed with no rotation told.
#[test]
fn places_traced_with_full_light_are_registered() {
    let shared = std::env::var("PLATELIGHT_SHARED")
        .map_or_else(|_| Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared"), PathBuf::from);
    for scene in ["outdoor-sun", "overcast-soft", "indoor-window"] {
        let path = shared.join("truth").join(scene).join("env_latlong.exr");
        if !path.is_file() {
            println!("skipped: {} is missing", path.display());
            continue;
        }
        let options = ReadOptions::default();
        let map =
            file::read(&path, Layout::LatLong(Axes::OpenExr), DQuat::IDENTITY, None, &options)
                .unwrap();
        for (name, blind) in [("balls", [BALL, BALL]), ("ball and fisheye", [BALL, HEMISPHERE])] {
            let found = errors(3, blind, |_, _, d| map.panorama.radiance(d));
            let (good, refused, rms) = told(&format!("{scene}, {name}"), &found, 1.0);
            assert!(
                good + refused == 3 && refused <= 1,
                "{scene}: {good} found, {refused} refused"
            );
            assert!(rms < 0.2, "{scene}: {rms}°");
        }
    }
}
