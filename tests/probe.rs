//! Mirror balls of the truth scenes: finder, unwrapping and light against the known answer.
//!
//! `truth.json` and `env_latlong.exr` score here and are never read by the program. The folder
//! `shared` lies beside the repository (or at PLATELIGHT_SHARED); without it the tests say so
//! and pass.

use std::path::PathBuf;

use glam::{DAffine3, DMat3, DQuat, DVec2, DVec3};
use platelight::bracket::{Frame, MergeOptions, Radiance, Validity, merge};
use platelight::camera::{Camera, Distortion, Lens, Pose};
use platelight::conventions::{Rgb, luminance};
use platelight::photo::{self, Image, ReadOptions};
use platelight::probe::ball::Mirror;
use platelight::probe::combine::{Options, combine};
use platelight::probe::compact_lights::compact_lights;
use platelight::probe::find::{BallImage, Hints, find};
use platelight::probe::fisheye::{Fisheye, Projection};
use platelight::probe::register::{RegisterError, by_content};
use platelight::probe::unwrap::{Support, unwrap_ball};
use platelight::probe::view::Seeing;
use platelight::probe::{Ball, Panorama, View, photographed};
use serde_json::Value;

/// The shared folder, or `None` with a word about it.
fn shared() -> Option<PathBuf> {
    let beside = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared"));
    let path = std::env::var_os("PLATELIGHT_SHARED").map_or(beside, PathBuf::from);
    if path.is_dir() {
        return Some(path);
    }
    eprintln!("{} is missing: nothing is tested", path.display());
    None
}

struct Scene {
    folder: PathBuf,
    camera: Camera,
    ball: Ball,
    facts: Value,
    truth: Value,
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect()
}

fn scene(name: &str) -> Option<Scene> {
    let folder = shared()?.join("truth").join(name);
    let json = |file: &str| -> Value {
        serde_json::from_str(&std::fs::read_to_string(folder.join(file)).unwrap()).unwrap()
    };
    let (facts, truth) = (json("shot_facts.json"), json("truth.json"));
    let k = |key: &str| truth["ball_intrinsics"][key].as_f64().unwrap();
    let distortion = Distortion::BrownConrady {
        k1: k("k1"),
        k2: k("k2"),
        p1: k("p1"),
        p2: k("p2"),
        k3: k("k3"),
    };
    let (fx, fy, cx, cy) = (k("fx"), k("fy"), k("cx"), k("cy"));
    let lens = Lens { fx, fy, cx, cy, distortion, covariance: None };
    let rows: Vec<Vec<f64>> =
        truth["ball_camera_to_world"].as_array().unwrap().iter().map(numbers).collect();
    let column = |c: usize| DVec3::new(rows[0][c], rows[1][c], rows[2][c]);
    let rotation = DMat3::from_cols(column(0), column(1), column(2));
    let world_from_camera = DAffine3::from_mat3_translation(rotation, column(3));
    let pose = Pose { world_from_camera, covariance: None };
    let camera = Camera { width: 720, height: 720, lens, pose };
    let centre = DVec3::from_slice(&numbers(&facts["ball"]["centre_world"]));
    let reflectance = numbers(&facts["ball"]["reflectance_rgb"]);
    let reflectance = DVec3::from_slice(&reflectance).as_vec3();
    let ball = Ball::new(centre, facts["ball"]["radius_m"].as_f64().unwrap(), reflectance).unwrap();
    Some(Scene { folder, camera, ball, facts, truth })
}

impl Scene {
    /// The bracket, in the unit of the truth's EXR files.
    fn bracket(&self) -> Radiance {
        let shots = self.facts["ball"]["photos"].as_array().unwrap();
        let photos: Vec<_> = shots
            .iter()
            .map(|s| {
                let file = self.folder.join(s["file"].as_str().unwrap());
                photo::read_encoded(&file, &ReadOptions::default()).unwrap()
            })
            .collect();
        let frames: Vec<Frame> = photos
            .iter()
            .zip(shots)
            .map(|(photo, s)| Frame { photo, exposure: s["exposure_scale"].as_f64().unwrap() })
            .collect();
        merge(&frames, &MergeOptions::default()).unwrap().radiance
    }

    fn picture(&self, file: &str) -> Image<Rgb> {
        photo::read(&self.folder.join(file), &ReadOptions::default()).unwrap().linear
    }

    fn noise_free(&self) -> Radiance {
        let mean = self.picture("ball.exr");
        let (w, h) = (mean.width(), mean.height());
        Radiance {
            mean,
            variance: Image::filled(w, h, Rgb::ZERO),
            validity: Image::filled(w, h, Validity::Measured),
        }
    }

    fn unwrap(&self, radiance: &Radiance, found: &BallImage) -> Panorama {
        let support = Support { point: DVec3::ZERO, normal: DVec3::Y };
        unwrap_ball(radiance, &self.camera, &found.rim, &self.ball, Some(&support), 1024).unwrap()
    }
}

/// Medians of the ratio to `env` over directions more than 10° above the horizon: (signed, |·|).
fn sky_ratio(panorama: &Panorama, env: &Panorama) -> (f64, f64) {
    let mut ratios: Vec<f64> = Vec::new();
    for y in 0..panorama.height() {
        for x in 0..panorama.width() {
            let d = panorama.direction(x, y);
            if d.y > 10f64.to_radians().sin() && panorama.validity[(x, y)] != Validity::Filled {
                let (a, b) = (panorama.radiance[(x, y)], env.radiance(d));
                ratios.push(f64::from(luminance(a) / luminance(b)) - 1.0);
            }
        }
    }
    let median = |mut v: Vec<f64>| {
        v.sort_by(f64::total_cmp);
        v[v.len() / 2]
    };
    (median(ratios.clone()), median(ratios.into_iter().map(f64::abs).collect()))
}

/// Rms angle between the directions that the found rim and the true ball mirror, over the pixels that mirror
/// what is up to 150° off the line back to the camera (beyond it one pixel covers many degrees), degrees.
fn direction_rms_deg(scene: &Scene, found: &BallImage) -> f64 {
    let centre = scene.camera.pose.inverse().transform_point3(scene.ball.centre);
    let truth = Mirror::new(centre / scene.ball.radius, 1.0).unwrap();
    let seen = Mirror::new(found.rim.axis / found.rim.half_angle_rad.sin(), 1.0).unwrap();
    let (mut squares, mut pixels) = (0.0, 0.0);
    for y in (0..720).step_by(3) {
        for x in (0..720).step_by(3) {
            let ray = scene.camera.lens.unproject(DVec2::new(f64::from(x), f64::from(y))).unwrap();
            let (Some(a), Some(b)) = (truth.reflect(ray), seen.reflect(ray)) else { continue };
            if a.direction.dot(-centre.normalize()) > 150f64.to_radians().cos() {
                squares += a.direction.angle_between(b.direction).powi(2);
                pixels += 1.0;
            }
        }
    }
    f64::sqrt(squares / pixels).to_degrees()
}

/// Irradiance of what faces up by all light farther than this from the sun, if there is one.
fn irradiance_without_sun(panorama: &Panorama, sun: Option<DVec3>) -> f64 {
    let mut sum = 0.0;
    for y in 0..panorama.height() {
        for x in 0..panorama.width() {
            let d = panorama.direction(x, y);
            if d.y > 0.0 && sun.is_none_or(|sun| d.dot(sun) < 5f64.to_radians().cos()) {
                let texel = panorama.solid_angle(y);
                sum += f64::from(luminance(panorama.radiance[(x, y)])) * d.y * texel;
            }
        }
    }
    sum
}

/// The places' scores, noise-free and from the JPEG brackets, by the ball camera's own lens.
///
/// Indoors the ball's panorama is not the map's: near walls and lamps stand elsewhere, and the map's own noise is
/// 5 % (README of the truth); the bracket's lamps are clipped there, and its light is a lower bound.
///
/// Directions are as good as the rim is, which is told to 0.11°: a bracket's fit moves by a quarter of a pixel
/// (0.1°) with a thousandth in its exposures.
#[test]
fn directions_and_light_by_ball() {
    for (name, rms_deg, of_map, of_bracket) in [
        ("outdoor-sun", [0.13, 0.13], 0.01, Some(0.01)),
        ("overcast-soft", [0.1, 0.13], 0.01, Some(0.01)),
        ("indoor-window", [0.1, 0.1], 0.05, None),
    ] {
        let Some(scene) = scene(name) else { return };
        let sun = &scene.truth["sun"]["direction"];
        let sun = sun.is_array().then(|| DVec3::from_slice(&numbers(sun)));
        let env = Panorama::from_radiance(scene.picture("env_latlong.exr"));
        let map = irradiance_without_sun(&env, sun);
        let mut light = Vec::new();
        let pictures = [("noise-free", scene.noise_free()), ("bracket", scene.bracket())];
        for ((what, radiance), rms_deg) in pictures.into_iter().zip(rms_deg) {
            let found = find(&radiance.mean, &scene.camera.lens, &Hints::default()).unwrap();
            let rms = direction_rms_deg(&scene, &found);
            let up = irradiance_without_sun(&scene.unwrap(&radiance, &found), sun);
            eprintln!(
                "{name}, {what}: directions {rms:.3}° rms (told ± {:.3}°), irradiance without suns {:+.2} %",
                found.rim.sigma_direction_rad().to_degrees(),
                100.0 * (up / map - 1.0),
            );
            assert!(rms < rms_deg, "{name}, {what}: directions {rms}° off");
            light.push(up);
        }
        let off = light[0] / map - 1.0;
        assert!(off.abs() < of_map, "{name}: irradiance {off} off");
        let off = light[1] / light[0] - 1.0;
        assert!(
            of_bracket.is_none_or(|most| off.abs() < most),
            "{name}: the bracket's is {off} off"
        );
    }
}

/// The truth's fisheye, as a lens shows it: the sun to half a texel, all light to 1 %.
#[test]
fn a_fisheye_keeps_directions_and_flux() {
    let Some(scene) = scene("outdoor-sun") else { return };
    let map = scene.picture("fisheye.exr");
    let (w, h) = (map.width(), map.height());
    let lens = Fisheye::new(Projection::Equidistant, 180.0, None, [w, h]).unwrap();
    let radiance = Radiance {
        mean: Image::from_fn(w, h, |x, y| map[(w - 1 - x, y)]),
        variance: Image::filled(w, h, Rgb::ZERO),
        validity: Image::filled(w, h, Validity::Measured),
    };
    // Right, up and back of the lens in the world: it looks up, the map's +X is to its left.
    let turn = DMat3::from_cols(DVec3::NEG_X, DVec3::NEG_Z, DVec3::NEG_Y);
    let width = 2048;
    let panorama =
        photographed::fisheye(&radiance, &lens, DQuat::from_mat3(&turn), Some(width)).unwrap();
    let sun = DVec3::from_slice(&numbers(&scene.truth["sun"]["direction"]));
    let found = compact_lights(&panorama)[0].direction.angle_between(sun).to_degrees();
    let env = Panorama::from_radiance(scene.picture("env_latlong.exr"));
    let all = irradiance_without_sun(&panorama, None) / irradiance_without_sun(&env, None) - 1.0;
    let sky =
        irradiance_without_sun(&panorama, Some(sun)) / irradiance_without_sun(&env, Some(sun));
    eprintln!(
        "fisheye: sun {found:.4}° off, irradiance {:+.2} %, without sun {:+.2} %",
        100.0 * all,
        100.0 * (sky - 1.0)
    );
    assert!(found < 0.5 * 360.0 / width as f64, "the sun is {found}° off");
    assert!(all.abs() < 0.01 && (sky - 1.0).abs() < 0.01, "light {all}, sky {sky}");
}

/// What the finder may be off by, px, and the sky's median error: signed and absolute.
/// The absolute one is mostly the truth's own noise and parallax (its README: 0.013, 0.022, 0.116).
struct Limits {
    centre_px: f64,
    radius_px: f64,
    signed: f64,
    absolute: f64,
    /// Irradiance from above, relative.
    irradiance: f64,
    with_bracket: bool,
}

fn check(name: &str, limits: &Limits) {
    let Some(scene) = scene(name) else { return };
    let env = Panorama::from_radiance(scene.picture("env_latlong.exr"));
    // One merged bracket is enough: merging is slow, and tested elsewhere.
    let mut pictures = vec![("noise-free", scene.noise_free())];
    if limits.with_bracket {
        pictures.push(("bracket", scene.bracket()));
    }
    for (what, radiance) in pictures {
        let found = find(&radiance.mean, &scene.camera.lens, &Hints::default()).unwrap();
        let (centre, radius) = found.disagreement_px(&scene.camera, &scene.ball).unwrap();
        let panorama = scene.unwrap(&radiance, &found);
        let (signed, absolute) = sky_ratio(&panorama, &env);
        let up = panorama.irradiance(DVec3::Y);
        let expected = numbers(&scene.truth["irradiance_up_from_env"]);
        eprintln!(
            "{name}, {what}: centre {centre:.2} px, radius {radius:+.2} px (σ {:.2} px, inliers \
             {:.2}); sky {signed:+.4}, |·| {absolute:.4}; E up {up:.3} of {expected:?}; filled {:.3}",
            found.sigma_px,
            found.rim.inlier_fraction,
            panorama.share(Validity::Filled),
        );
        assert!(centre < limits.centre_px, "{name}, {what}: centre {centre} px off");
        assert!(radius.abs() < limits.radius_px, "{name}, {what}: radius {radius} px off");
        // The bracket's lamps are clipped: only what never clips has the truth's irradiance.
        let error = f64::from(up.y) / expected[1] - 1.0;
        let whole = what == "noise-free";
        assert!(!whole || error.abs() < limits.irradiance, "{name}: irradiance {error} off");
        assert!(signed.abs() < limits.signed, "{name}, {what}: sky {signed} off");
        assert!(absolute < limits.absolute, "{name}, {what}: sky |{absolute}| off");
    }
}

#[test]
fn outdoor_sun() {
    let limits = Limits {
        centre_px: 0.6,
        radius_px: 0.5,
        signed: 0.005,
        absolute: 0.01,
        irradiance: 0.01,
        with_bracket: false,
    };
    check("outdoor-sun", &limits);
}

/// The rim lies on wood that mirrors wood, under a sky full of small clouds.
#[test]
fn overcast_soft() {
    let limits = Limits {
        centre_px: 0.6,
        radius_px: 0.5,
        signed: 0.01,
        absolute: 0.17,
        irradiance: 0.01,
        with_bracket: false,
    };
    check("overcast-soft", &limits);
}

/// Near walls and lamps: seen from the ball's surface they stand elsewhere than from its centre.
#[test]
fn indoor_window() {
    let limits = Limits {
        centre_px: 0.6,
        radius_px: 0.6,
        signed: 0.03,
        absolute: 0.15,
        irradiance: 0.07,
        with_bracket: true,
    };
    check("indoor-window", &limits);
}

/// Of the ball and of a fisheye that looks up, in axes of which nothing is told.
///
/// The truth's fisheye is drawn as a map, with +X right and +Z down: the mirror image of what a lens shows.
#[test]
fn a_ball_and_a_fisheye_find_their_way_together() {
    let Some(scene) = scene("outdoor-sun") else { return };
    let radiance = scene.noise_free();
    let found = find(&radiance.mean, &scene.camera.lens, &Hints::default()).unwrap();
    let world_from_camera = scene.camera.pose.rotation();
    let seeing = Seeing::ball(&scene.camera.lens, &found.rim, world_from_camera).unwrap();
    let ball = View { panorama: scene.unwrap(&radiance, &found), seeing };

    let map = scene.picture("fisheye.exr");
    let (w, h) = (map.width(), map.height());
    let lens = Fisheye::new(Projection::Equidistant, 180.0, None, [w, h]).unwrap();
    let view = |mean: Image<Rgb>| {
        let radiance = Radiance {
            mean,
            variance: Image::filled(w, h, Rgb::ZERO),
            validity: Image::filled(w, h, Validity::Measured),
        };
        let panorama =
            photographed::fisheye(&radiance, &lens, DQuat::IDENTITY, Some(1024)).unwrap();
        View { panorama, seeing: Seeing::fisheye(&lens, DQuat::IDENTITY) }
    };
    let fisheye = view(Image::from_fn(w, h, |x, y| map[(w - 1 - x, y)]));
    assert_eq!(by_content(&ball, &view(map)), Err(RegisterError::Mirrored));

    let content = by_content(&ball, &fisheye).unwrap();
    let rotation = content.registration.rotation;
    let truth = DMat3::from_cols(DVec3::NEG_X, DVec3::NEG_Z, DVec3::NEG_Y);
    let error = DQuat::from_mat3(&truth).angle_between(rotation).to_degrees();
    let merged = combine(&[ball, fisheye.rotated(rotation)], &Options::default()).unwrap();
    let sun = DVec3::from_slice(&numbers(&scene.truth["sun"]["direction"]));
    let found = compact_lights(&merged.panorama);
    let off = found[0].direction.angle_between(sun).to_degrees();
    let env = Panorama::from_radiance(scene.picture("env_latlong.exr"));
    let (signed, absolute) = sky_ratio(&merged.panorama, &env);
    eprintln!(
        "turn {error:.3}° off (told ± {:.3}°), sun {off:.3}° off, exposure × {:.4}, sky {signed:+.4}, |·| \
         {absolute:.4}",
        content.registration.sigma_rad().to_degrees(),
        merged.given[1].gain.factor.y,
    );
    // The ball's rim gives its directions to 0.12°.
    assert!(error < 0.3, "the turn is {error}° off");
    assert!(off < 0.3, "the sun is {off}° off");
    assert!((merged.given[1].gain.factor.y - 1.0).abs() < 0.01);
    assert!(absolute < 0.01, "sky |{absolute}| off");
}
