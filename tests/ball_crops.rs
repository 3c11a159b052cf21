//! Photographs of a ball that do not lie on one another, as `platelight panorama` takes them.

mod program;

use std::path::Path;

use glam::{DVec2, DVec3};
use platelight::conventions::Rgb;
use platelight::photo::{Encoding, EncodingSource, Image, Primaries, Transfer, png};
use platelight::probe::ball::Mirror;
use program::{platelight, text};
use serde_json::Value;

/// Pixels a radian of the photographs; the ball is 12.5 radii away, 1600 / 12.5 px in radius.
const FOCAL_PX: f64 = 1600.0;

/// A yard: chequered ground, walls of other widths, a sky that is brighter on one side.
fn world(d: DVec3) -> f64 {
    let turn = d.x.atan2(d.z);
    if d.y < -0.02 {
        let (x, z) = (d.x / d.y, d.z / d.y);
        return if (x.floor() + z.floor()).rem_euclid(2.0) < 1.0 { 0.03 } else { 0.09 };
    }
    if d.y < 0.3 + 0.15 * (3.0 * turn).sin() {
        return 0.02 + 0.05 * (7.0 * turn).sin().abs();
    }
    0.4 + 0.3 * d.y + 0.2 * turn.cos()
}

/// The ball's middle in the whole frame, px.
const MIDDLE: [f64; 2] = [200.0, 190.0];

/// What of the frame one photograph is, at one exposure: `first` is its first pixel.
fn photograph(path: &Path, exposure: f64, first: [f64; 2], size: [usize; 2]) {
    let mirror = Mirror::new(DVec3::new(0.0, 0.0, -12.5), 1.0).unwrap();
    let light = |x: f64, y: f64| {
        let p = DVec2::new(x, y) + DVec2::from(first) - DVec2::from(MIDDLE);
        let ray = DVec3::new(p.x, -p.y, -FOCAL_PX).normalize();
        mirror.reflect(ray).map_or(world(ray), |r| 0.6 * world(r.direction))
    };
    let pixel = |x: usize, y: usize| {
        let sum: f64 = (0..9)
            .map(|k| {
                light(x as f64 + f64::from(k % 3 - 1) / 3.0, y as f64 + f64::from(k / 3 - 1) / 3.0)
            })
            .sum();
        Rgb::splat((sum / 9.0 * exposure) as f32)
    };
    let samples = png::srgb_codes(&Image::from_fn(size[0], size[1], pixel));
    let encoding = Encoding {
        transfer: Transfer::Srgb,
        primaries: Primaries::Rec709,
        source: EncodingSource::Named,
    };
    png::write(path, &samples, size[0], size[1], &encoding).unwrap();
}

fn panorama(folder: &Path, photos: &[&str]) -> Result<Value, String> {
    let paths: Vec<_> = photos.iter().map(|name| folder.join(name)).collect();
    let out = folder.join(format!("{}.exr", photos[0]));
    let focal = FOCAL_PX.to_string();
    let mut arguments = vec!["panorama", "--ball"];
    arguments.extend(paths.iter().map(|path| text(path)));
    arguments.extend(["--times", "1/4,1,4", "--focal-px", &focal, "--reflectance", "0.6,0.6,0.6"]);
    arguments.extend(["--width", "256", "--json", "--out", text(&out)]);
    let output = platelight(&arguments);
    if !output.status.success() {
        return Err(String::from_utf8_lossy(&output.stderr).into_owned());
    }
    Ok(serde_json::from_slice(&output.stdout).unwrap())
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap()
}

/// Cut out by hand: every photograph has its own size, the ball its own place, and some cut the rim.
#[test]
fn cut_outs_of_several_sizes_are_laid_on_one_another_by_the_ball() {
    let folder = tempfile::tempdir().unwrap();
    let shots = [
        (0.25, "a", [66.0, 55.0], [270, 268]),
        (1.0, "b", [75.0, 60.0], [262, 265]),
        (4.0, "c", [61.0, 52.0], [268, 262]),
    ];
    for (exposure, name, first, size) in shots {
        photograph(
            &folder.path().join(format!("whole_{name}.png")),
            exposure,
            [0.0; 2],
            [400, 380],
        );
        photograph(&folder.path().join(format!("cut_{name}.png")), exposure, first, size);
    }
    let whole = panorama(folder.path(), &["whole_a.png", "whole_b.png", "whole_c.png"]).unwrap();
    let cut = panorama(folder.path(), &["cut_a.png", "cut_b.png", "cut_c.png"]).unwrap();
    // What touches a ball 12.5 radii away.
    let radius = FOCAL_PX * f64::asin(1.0 / 12.5).tan();
    let off = number(&cut["ball"]["radius_px"]) - radius;
    assert!(off.abs() < 1.0, "radius {off} px off");
    let light = |found: &Value| number(&found["irradiance_up"][1]);
    let off = light(&cut) / light(&whole) - 1.0;
    assert!(off.abs() < 0.02, "irradiance {off} off");
    let told = cut["warnings"].to_string();
    assert!(told.contains("differ in size") && told.contains("by the ball"), "{told}");
    assert!(!whole["warnings"].to_string().contains("by the ball"));
}

#[test]
fn what_has_no_ball_is_named() {
    let folder = tempfile::tempdir().unwrap();
    for (name, size) in [("a.png", [60, 50]), ("b.png", [64, 50]), ("c.png", [60, 52])] {
        photograph(&folder.path().join(name), 1.0, [-900.0, -900.0], size);
    }
    let said = panorama(folder.path(), &["a.png", "b.png", "c.png"]).unwrap_err();
    assert!(
        said.contains("a.png") && said.contains("no mirror ball") && said.contains("--hint"),
        "{said}"
    );
    assert!(said.contains("differ in size") && said.contains("--fisheye"), "{said}");
}
