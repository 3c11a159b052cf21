//! `platelight sky` as a user runs it, and a shot that is lit by it.

mod program;
mod tiny;

use std::path::Path;

use glam::{DQuat, DVec3};
use platelight::bracket::Validity;
use platelight::conventions::Rgb;
use platelight::photo::exr_file::{self, ExrPicture, ExrSamples};
use platelight::photo::{Image, ReadOptions};
use platelight::probe::Panorama;
use platelight::probe::axes::Axes;
use platelight::probe::file::{self, Layout};
use program::{platelight, text};

const MUNICH: [&str; 4] = ["--place", "48.14,11.58", "--time", "2026-06-21T12:00:00+02:00"];

fn read(path: &Path) -> Panorama {
    let options = ReadOptions::default();
    file::read(path, Layout::LatLong(Axes::OpenExr), DQuat::IDENTITY, None, &options)
        .expect("a panorama")
        .panorama
}

fn numbers(value: &serde_json::Value) -> [f64; 3] {
    let numbers: Vec<f64> =
        value.as_array().expect("a list").iter().map(|v| v.as_f64().expect("a number")).collect();
    numbers.try_into().expect("three numbers")
}

fn luminance([r, g, b]: [f64; 3]) -> f64 {
    0.2126 * r + 0.7152 * g + 0.0722 * b
}

#[test]
fn a_sky_is_written_with_its_sun_and_without() {
    let folder = tempfile::tempdir().unwrap();
    let (with, without) = (folder.path().join("with.exr"), folder.path().join("without.exr"));
    let png = folder.path().join("with.png");
    let run = |more: &[&str]| {
        let arguments: Vec<&str> = ["sky", "--json", "--width", "256"]
            .iter()
            .chain(&MUNICH)
            .chain(more)
            .copied()
            .collect();
        let output = platelight(&arguments);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let summary: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        summary["frames"][0].clone()
    };
    let frame = run(&["--out", text(&with), "--preview", text(&png)]);
    run(&["--no-sun", "--out", text(&without)]);
    assert!(png.is_file());

    // Munich's summer noon is at 13:15 on the clock: the sun is still in the south-east.
    let azimuth = frame["azimuth_deg"].as_f64().unwrap();
    assert!((130.0..150.0).contains(&azimuth), "{azimuth}");
    let direction = DVec3::from(numbers(&frame["direction"]));
    assert!(direction.x > 0.0 && direction.z > 0.0 && direction.y > 0.8, "{direction}");
    assert!(
        (luminance(numbers(&frame["level_irradiance"])) / std::f64::consts::PI - 1.0).abs() < 1e-4
    );

    let (with, without) = (read(&with), read(&without));
    assert!(with.validity.pixels().iter().all(|&v| v == Validity::Analytic));
    let up = |panorama: &Panorama| f64::from(panorama.irradiance(DVec3::Y).y);
    let [sky, level] = ["sky_irradiance", "level_irradiance"].map(|key| numbers(&frame[key])[1]);
    // The texel's mean cosine is not the sun's own: half a texel of 1.4° at 63° of height.
    assert!((up(&without) / sky - 1.0).abs() < 2e-3, "{} {sky}", up(&without));
    assert!((up(&with) / level - 1.0).abs() < 1e-2, "{} {level}", up(&with));
}

#[test]
fn a_day_of_skies_is_numbered_and_has_one_unit() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("day.####.exr");
    let output = platelight(&[
        "sky",
        "--json",
        "--width",
        "64",
        "--place",
        "48.14,11.58",
        "--time",
        "2026-06-21T03:00:00+02:00",
        "--until",
        "2026-06-21T13:00:00+02:00",
        "--every",
        "2h",
        "--first-frame",
        "1001",
        "--out",
        text(&out),
    ]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(String::from_utf8_lossy(&output.stderr).contains("note: 2 of 6 moments are left out"));
    let summary: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(summary["left_out"][0]["time"], "2026-06-21T03:00:00+02:00");
    let frames = summary["frames"].as_array().unwrap();
    assert_eq!(frames.len(), 4);
    // A file's number says which moment it is, also where others are left out.
    for (frame, number) in frames.iter().zip(1003..) {
        assert!(folder.path().join(format!("day.{number}.exr")).is_file());
        assert_eq!(frame["frame"], number);
    }
    let level: Vec<f64> =
        frames.iter().map(|f| luminance(numbers(&f["level_irradiance"]))).collect();
    assert!(level.windows(2).all(|pair| pair[0] < pair[1]), "{level:?}");
    assert!((level[3] / std::f64::consts::PI - 1.0).abs() < 1e-4, "{level:?}");
}

/// methods-capture F30: below the horizon, turbidity below 2, no zone.
#[test]
fn what_cannot_be_is_refused_with_its_remedy_and_nothing_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("sky.exr");
    let said = |more: &[&str]| {
        let arguments: Vec<&str> =
            ["sky", "--out", text(&out)].iter().chain(more).copied().collect();
        let output = platelight(&arguments);
        assert_eq!(output.status.code(), Some(2), "{more:?}");
        assert!(!out.exists(), "{more:?}");
        String::from_utf8_lossy(&output.stderr).into_owned()
    };
    let night = said(&["--place", "48.14,11.58", "--time", "2026-06-21T00:00:00+02:00"]);
    assert!(night.contains("azimuth") && night.contains("below the horizon"), "{night}");
    let no_zone = said(&["--place", "48.14,11.58", "--time", "2026-06-21T12:00:00"]);
    assert!(no_zone.contains("has no zone"), "{no_zone}");
    let sun = |more: &[&str]| {
        let arguments: Vec<&str> = ["--sun", "180,40"].iter().chain(more).copied().collect();
        said(&arguments)
    };
    assert!(sun(&["--turbidity", "1.5"]).contains("--turbidity: 1.5 is below 2"));
    assert!(sun(&["--turbidity", "11"]).contains("--turbidity: 11 is above 10"));
    assert!(sun(&["--ground", "2"]).contains("--ground"));
    assert!(sun(&["--ground", "0.1,0.2"]).contains("--ground: 2 numbers"));
    assert!(sun(&["--sun-irradiance", "0"]).contains("--sun-irradiance"));
    assert!(sun(&["--sky-irradiance", "nan"]).contains("--sky-irradiance"));
    assert!(sun(&["--north", "inf"]).contains("--north"));
    assert!(sun(&["--width", "32768"]).contains("--width: 32768"));
    assert!(said(&["--sun", "180"]).contains("--sun: [180.0] is no azimuth and elevation"));
    assert!(said(&["--sun", "180,-3"]).contains("3.0° below"));
    assert!(said(&["--place", "91,0", "--time", "2026-06-21T12:00Z"]).contains("--place: 91, 0"));
    assert!(said(&["--place", "48"]).contains("--time"));
    let sequence = ["--until", "2026-06-22T12:00:00+02:00", "--every"];
    let day = |step: &str| {
        let all: Vec<&str> = MUNICH.iter().chain(&sequence).chain([&step]).copied().collect();
        said(&all)
    };
    assert!(day("1h").contains("write #### where the number goes"));
}

/// The tiny shot under a sky, and what a run says of its light.
fn lit_by_sky(folder: &Path, sky: &str, objects: &str) -> (serde_json::Value, std::path::PathBuf) {
    let shot = tiny::write_shot(folder, tiny::Plate::ExrFloat, objects);
    let written = std::fs::read_to_string(&shot).unwrap();
    let changed = written.replace("panorama = { file = \"panorama.exr\" }", sky);
    assert_ne!(written, changed);
    std::fs::write(&shot, changed.replace("relative_exposure = 1.0", "relative_exposure = 0.5"))
        .unwrap();
    let out = folder.join("out");
    let output = platelight(&["run", text(&shot), "--out", text(&out)]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let report = std::fs::read_to_string(out.join("report.json")).unwrap();
    (serde_json::from_str(&report).unwrap(), out)
}

#[test]
fn a_shot_is_lit_by_a_calculated_sky() {
    let folder = tempfile::tempdir().unwrap();
    let cube = tiny::write_cube(folder.path(), 0.15);
    // The camera looks down along −Z from the south; the sun is in the west, 45° high.
    let sky = "sky = { sun = [270, 45], turbidity = 3 }";
    let (report, out) = lit_by_sky(folder.path(), sky, &cube);
    let suns = report["lights"]["suns"].as_array().unwrap();
    assert_eq!(suns.len(), 1);
    let direction = DVec3::from(numbers(&suns[0]["direction"]));
    let half = std::f64::consts::FRAC_1_SQRT_2;
    assert!((direction - DVec3::new(-half, half, 0.0)).length() < 1e-6, "{direction}");
    // A level white card has the value 0.5 in the plate: relative_exposure.
    let level = luminance(numbers(&report["lights"]["irradiance_up"]));
    assert!((level / (0.5 * std::f64::consts::PI) - 1.0).abs() < 2e-3, "{level}");
    assert!(report["probe"]["source"].as_str().unwrap().starts_with("clear sky of turbidity 3"));
    let notes = report["notes"].to_string();
    assert!(
        notes.contains("it must point to 90.0°, in the world along x +0.71, z")
            && notes.contains("25 %"),
        "{notes}"
    );
    assert!(report["budget"].to_string().contains("calculated sun"));
    assert!(out.join("panorama.exr").is_file());

    // The shadow falls east of the cube, which is +X and to the right.
    let shadow = ReadOptions { layer: Some("difference".to_owned()), ..ReadOptions::default() };
    let difference = platelight::photo::read(&out.join("composite.exr"), &shadow).unwrap().linear;
    let darkened = |columns: std::ops::Range<usize>| -> f32 {
        let all = (0..tiny::HEIGHT).flat_map(|y| columns.clone().map(move |x| (x, y)));
        -all.map(|at| difference[at].y).sum::<f32>()
    };
    let (left, right) = (darkened(0..24), darkened(40..64));
    // On the other side it hides but part of the sky, whose light is a quarter of all.
    assert!(right > 5.0 * left && right > 1.0, "left {left}, right {right}");
}

/// A clear sky through an upright fisheye that looks level: half of the sky is behind it.
#[test]
fn a_half_seen_sky_is_filled_with_its_other_half() {
    let folder = tempfile::tempdir().unwrap();
    let [whole, fisheye, out] =
        ["whole.exr", "fisheye.exr", "out.exr"].map(|f| folder.path().join(f));
    let made = platelight(&[
        "sky",
        "--sun",
        "60,35",
        "--turbidity",
        "4",
        "--no-sun",
        "--width",
        "256",
        "--out",
        text(&whole),
    ]);
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    let whole = read(&whole);
    // Equidistant, 180° across, looking along −Z.
    let size = 201;
    let picture = Image::from_fn(size, size, |x, y| {
        let (dx, dy) = (x as f64 - 100.0, 100.0 - y as f64);
        let (r, angle) = (dx.hypot(dy), dy.atan2(dx));
        let theta = r / 100.5 * std::f64::consts::FRAC_PI_2;
        if r > 100.5 {
            return Rgb::ZERO;
        }
        let (sin, cos) = theta.sin_cos();
        whole.radiance(DVec3::new(sin * angle.cos(), sin * angle.sin(), -cos))
    });
    let mut exr = ExrPicture { width: size, height: size, ..ExrPicture::default() };
    for (c, name) in ["R", "G", "B"].into_iter().enumerate() {
        let values = picture.pixels().iter().map(|l| l[c]).collect();
        exr.push(name, ExrSamples::F32(values));
    }
    exr_file::write(&fisheye, &exr).unwrap();
    let fill = |sun: &str| {
        platelight(&[
            "panorama",
            text(&fisheye),
            "--fisheye",
            "equidistant",
            "--width",
            "256",
            "--json",
            "--fill-sky",
            sun,
            "--out",
            text(&out),
        ])
    };
    let nothing = fill("found");
    assert_eq!(nothing.status.code(), Some(2));
    assert!(
        String::from_utf8_lossy(&nothing.stderr).contains("--fill-sky: nothing above the horizon")
    );
    assert!(!out.exists());

    let output = fill("60,35");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let summary: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let turbidity = summary["sky"]["turbidity"].as_f64().unwrap();
    assert!((turbidity - 4.0).abs() < 0.1, "{turbidity}");
    assert!((summary["sky"]["filled"].as_f64().unwrap() - 0.5).abs() < 0.03, "{}", summary["sky"]);
    let filled = read(&out);
    for direction in
        [DVec3::new(0.2, 0.5, 0.8), DVec3::new(-0.9, 0.3, 0.4), DVec3::new(0.1, 1.0, 0.3)]
    {
        let (found, wanted) = (filled.radiance(direction), whole.radiance(direction));
        assert!((found / wanted - 1.0).abs().max_element() < 0.02, "{direction}: {found} {wanted}");
    }
}
