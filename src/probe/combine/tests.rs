//! Two mirror balls photographed from 105° apart: what one hides the other shows.

use glam::{DQuat, DVec2, DVec3};

use super::*;
use crate::bracket::Radiance;
use crate::camera::{Camera, Lens, Pose};
use crate::probe::ball::{Ball, Mirror};
use crate::probe::compact_lights::compact_lights;
use crate::probe::register::by_content;
use crate::probe::rim::Rim;
use crate::probe::test_worlds::{Random, overcast};
use crate::probe::unwrap::unwrap_ball;
use crate::probe::view::Seeing;

const LAMP_RAD: f64 = 1.5 * std::f64::consts::PI / 180.0;
const LAMP: f32 = 300.0;

fn lamp_direction() -> DVec3 {
    DVec3::new(0.5, 0.6, 0.7).normalize()
}

/// The yard, and a lamp in it.
fn world(d: DVec3) -> Rgb {
    match d.angle_between(lamp_direction()) < LAMP_RAD {
        true => Rgb::splat(LAMP),
        false => overcast(d, 4) * Rgb::new(1.0, 0.9, 0.7),
    }
}

/// Where the photographer behind the camera at `camera` stands: 16° wide, from 8° above to 30° below.
fn is_photographer(camera: DVec3, d: DVec3) -> bool {
    let side = camera.cross(DVec3::Y).normalize();
    let aside = d.dot(side).asin().to_degrees();
    let above = (d.y.asin() - camera.y.asin()).to_degrees();
    d.dot(camera) > 0.0 && aside.abs() < 8.0 && (-30.0..8.0).contains(&above)
}

/// A ball photographed from `azimuth_deg`, in its camera's axes; values above `clip` are cut off.
fn ball_view(azimuth_deg: f64, clip: f32, exposure: f32) -> (View, DQuat) {
    let toward =
        DQuat::from_rotation_y(azimuth_deg.to_radians()) * DVec3::new(0.0, 0.2, 1.0).normalize();
    let pose = Pose::look_at(toward, DVec3::ZERO, DVec3::Y).unwrap();
    let world_from_camera = DQuat::from_mat3(&pose.rotation());
    let (size, radius) = (520, 0.1);
    let lens = Lens::pinhole(2400.0, size, size);
    let mirror = Mirror::new(DVec3::NEG_Z, radius).unwrap();
    let mut random = Random(azimuth_deg as u64);
    let seen = |d: DVec3| {
        let d = world_from_camera * d;
        if is_photographer(toward, d) { Rgb::splat(0.02) } else { world(d) }
    };
    let mean = Image::from_fn(size, size, |x, y| {
        let samples = [(-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25)];
        let sum: Rgb = samples
            .iter()
            .map(|(u, v)| {
                let ray = lens.unproject(DVec2::new(x as f64 + u, y as f64 + v)).unwrap();
                seen(mirror.reflect(ray).map_or(ray, |r| r.direction))
            })
            .sum();
        exposure * sum / 4.0 * (1.0 + 0.01 * random.normal() as f32)
    });
    let clipped = |l: &Rgb| l.max_element() > clip;
    let radiance = Radiance {
        variance: mean.map(|l| (*l * 0.01).powf(2.0)),
        validity: mean.map(|l| if clipped(l) { Validity::LowerBound } else { Validity::Measured }),
        mean: mean.map(|l| l.min(Rgb::splat(clip))),
    };
    let camera = Camera { width: size, height: size, lens, pose: Pose::identity() };
    let rim = Rim::known(DVec3::NEG_Z, mirror.half_angle(), 1e-5);
    let ball = Ball::new(DVec3::NEG_Z, radius, Rgb::ONE).unwrap();
    let panorama = unwrap_ball(&radiance, &camera, &rim, &ball, None, 512).unwrap();
    let seeing = Seeing::ball(&camera.lens, &rim, glam::DMat3::IDENTITY).unwrap();
    (View { panorama, seeing }, world_from_camera)
}

/// Both views in the first's axes, registered by content, and the true axes.
fn pair(clips: [f32; 2], exposures: [f32; 2]) -> (Vec<View>, DQuat) {
    let (first, truth) = ball_view(0.0, clips[0], exposures[0]);
    let (second, other) = ball_view(105.0, clips[1], exposures[1]);
    let found = by_content(&first, &second).unwrap();
    let error = found.registration.rotation.angle_between(truth.conjugate() * other).to_degrees();
    println!("registered to {error:.3}°, told {:.3}°", found.registration.sigma_rad().to_degrees());
    assert!(error < 0.25, "{error}°");
    (vec![first, second.rotated(found.registration.rotation)], truth)
}

/// Root mean square of the log luminance's error over directions that `counted` picks (world axes).
fn error(panorama: &Panorama, truth: DQuat, counted: impl Fn(DVec3) -> bool) -> f64 {
    let (mut squares, mut n) = (0.0, 0.0);
    for y in 0..panorama.height() {
        for x in 0..panorama.width() {
            let d = truth * panorama.direction(x, y);
            if counted(d) {
                let expected = luminance(world(d));
                let off = f64::from((luminance(panorama.radiance[(x, y)]) / expected).ln());
                squares += off * off * panorama.solid_angle(y);
                n += panorama.solid_angle(y);
            }
        }
    }
    f64::sqrt(squares / f64::max(n, 1e-9))
}

#[test]
fn two_balls_show_what_each_alone_hides() {
    let (views, truth) = pair([f32::INFINITY; 2], [1.0, 0.7]);
    let combined = combine(&views, &Options::default()).unwrap();
    let merged = &combined.panorama;
    let camera = truth * views[0].seeing.toward_camera().unwrap();

    let gain = combined.given[1].gain;
    assert!((luminance(gain.factor) * 0.7 - 1.0).abs() < 0.02, "gain {gain:?}");
    assert!(combined.seen_by[0] < 0.002 && combined.seen_by[2] > 0.8, "{:?}", combined.seen_by);

    // Off the lamp; edges of walls are a texel's matter and the same for all.
    let sky = |d: DVec3| d.y > 0.5 && d.angle_between(lamp_direction()) > 0.1;
    let person = |d: DVec3| is_photographer(camera, d);
    let blind = |d: DVec3| d.angle_between(-camera) < 0.1;
    let [alone, both] = [&views[0].panorama, merged].map(|map| error(map, truth, person));
    println!("photographer {alone:.2} → {both:.3}");
    assert!(alone > 1.0 && both < 0.35, "photographer: {alone} alone, {both} merged");
    let [alone, both] = [&views[0].panorama, merged].map(|map| error(map, truth, blind));
    println!("blind cone {alone:.3} → {both:.3}");
    assert!(both < 0.35, "blind cone: {alone} alone, {both} merged");
    assert!(error(merged, truth, sky) < 0.02, "sky: {}", error(merged, truth, sky));
    let all = |_: DVec3| true;
    let [a, b, both] =
        [&views[0].panorama, &views[1].panorama, merged].map(|map| error(map, truth, all));
    println!("all directions {a:.3}, {b:.3} → {both:.3}; {:?}", combined.given);

    let light = compact_lights(merged);
    assert_eq!((light.len(), combined.lights), (1, 1), "{light:?}");
    let off = (truth * light[0].direction).angle_between(lamp_direction()).to_degrees();
    let flux = f64::from(LAMP) * std::f64::consts::TAU * (1.0 - LAMP_RAD.cos());
    println!("lamp {off:.3}° off, flux {:+.2} %", 100.0 * (light[0].flux / flux - 1.0));
    assert!(off < 0.15, "the lamp is {off}° off");
    assert!((light[0].flux / flux - 1.0).abs() < 0.03, "flux {} of {flux}", light[0].flux);
}

#[test]
fn a_clipped_lamp_is_taken_from_the_view_that_measured_it() {
    let flux = f64::from(LAMP) * std::f64::consts::TAU * (1.0 - LAMP_RAD.cos());
    let of = |clips: [f32; 2]| {
        let (views, _) = pair(clips, [1.0; 2]);
        let merged = combine(&views, &Options::default()).unwrap().panorama;
        (compact_lights(&merged), merged.share(Validity::LowerBound))
    };
    for clips in [[80.0, f32::INFINITY], [f32::INFINITY, 80.0]] {
        let (light, bound) = of(clips);
        assert_eq!(light.len(), 1);
        assert!((light[0].flux / flux - 1.0).abs() < 0.03, "{clips:?}: {}", light[0].flux / flux);
        assert_eq!(bound, 0.0, "{clips:?}: nothing is clipped any more");
    }
    // Neither knows: the higher bound stands, whole, and says so.
    let (views, _) = pair([80.0, 120.0], [1.0; 2]);
    let higher = compact_lights(&views[1].panorama)[0].flux;
    let merged = combine(&views, &Options::default()).unwrap().panorama;
    let light = &compact_lights(&merged)[0];
    assert!(merged.share(Validity::LowerBound) > 0.0 && light.clipped);
    assert!((light.flux / higher - 1.0).abs() < 0.03, "{} of {higher}", light.flux);
}

#[test]
fn what_nobody_sees_is_filled_or_black_as_asked() {
    let mut view = View::even(Panorama::from_radiance(Image::filled(128, 64, Rgb::ONE)));
    for y in 40..64 {
        for x in 0..128 {
            view.panorama.radiance[(x, y)] = Rgb::splat(9.0);
            view.panorama.validity[(x, y)] = Validity::Filled;
            view.panorama.coverage[(x, y)] = 0.0;
        }
    }
    for (unseen, expected) in [(Unseen::FillAround, 1.0), (Unseen::Black, 0.0)] {
        let options = Options { unseen, ..Options::default() };
        let combined = combine(&[view.clone(), view.clone()], &options).unwrap();
        let panorama = &combined.panorama;
        assert!((panorama.radiance[(5, 60)].x - expected).abs() < 1e-5);
        assert_eq!(
            (panorama.validity[(5, 60)], panorama.coverage[(5, 60)]),
            (Validity::Filled, 0.0)
        );
        assert_eq!(panorama.radiance[(5, 20)], Rgb::ONE);
        let below = panorama.share(Validity::Filled);
        assert!((combined.seen_by[0] - below).abs() < 1e-9 && combined.seen_by[1] == 0.0);
    }
}

#[test]
fn one_view_and_two_lights_are_refused() {
    let view = View::even(Panorama::from_radiance(Image::filled(64, 32, Rgb::ONE)));
    assert_eq!(
        combine(std::slice::from_ref(&view), &Options::default()).unwrap_err(),
        CombineError::Few
    );
    let mut other = view.clone();
    other.panorama = other.panorama.scaled(8.0);
    let views = [view, other];
    let said = combine(&views, &Options::default()).unwrap_err();
    assert!(said.to_string().contains("-3.0 stops"), "{said}");
    let equalise = Equalise { most_stops: 4.0, per_channel: true };
    let combined = combine(&views, &Options { equalise, ..Options::default() }).unwrap();
    assert!((combined.given[1].gain.factor - 0.125).abs().max_element() < 1e-4);
    assert!((combined.panorama.radiance[(3, 3)].x - 1.0).abs() < 1e-4);
}
