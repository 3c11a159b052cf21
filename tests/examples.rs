//! Each example program runs on the demo shot and does what its first line says.
//!
//! A plain `cargo test` builds the examples and puts them beside this test's own folder; with
//! `cargo test --test examples` alone, run `cargo build --examples` first.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

#[cfg(feature = "opencv")]
use platelight::conventions::luminance;
use platelight::photo::{self, ReadOptions};

fn example(name: &str) -> Command {
    let test = std::env::current_exe().expect("a running test has a path");
    let profile = test.ancestors().nth(2).expect("target/<profile>/deps/<test>");
    let mut command = Command::new(profile.join("examples").join(name));
    command.current_dir(env!("CARGO_MANIFEST_DIR"));
    command
}

fn run(command: &mut Command) -> String {
    let Output { status, stdout, stderr } = command.output().expect("the example was built");
    let (out, err) = (String::from_utf8_lossy(&stdout), String::from_utf8_lossy(&stderr));
    assert!(status.success(), "{command:?} failed\n{out}\n{err}");
    out.into_owned()
}

fn demo(file: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("plates/demo").join(file)
}

/// calibrate → unwrap → insert: one chain, as a user would run it.
#[cfg(feature = "opencv")]
#[test]
fn camera_panorama_and_composite_come_from_the_demo_photographs() {
    let folder = tempfile::tempdir().expect("a scratch folder");
    let [camera, panorama, inserted] =
        ["camera.json", "panorama.exr", "inserted.png"].map(|name| folder.path().join(name));
    let truth: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(demo("truth.json")).expect("truth.json"))
            .expect("truth.json is JSON");

    run(example("calibrate").arg(demo("shot.toml")).arg(&camera));
    let found = platelight::camera::file::read(&camera).expect("the camera just written").camera;
    let fx = truth["camera"]["fx"].as_f64().expect("a number");
    assert!((found.lens.fx / fx - 1.0).abs() < 1e-3, "{} is not {fx}", found.lens.fx);

    let said = run(example("unwrap").arg(demo("shot.toml")).arg(&camera).arg(&panorama));
    assert!(said.contains("clipped lights: 0"), "{said}");

    run(example("insert")
        .args([demo("plate.png"), camera, panorama, demo("vase.glb"), inserted.clone()])
        .args(["--error", "0.2"]));
    let read = |path: &Path| photo::read(path, &ReadOptions::default()).expect("a picture").linear;
    let (plate, inserted) = (read(&demo("plate.png")), read(&inserted));
    // The vase stands at the origin and throws its shadow to the right; the sky keeps its pixels.
    let changed = |x: usize, y: usize| luminance(inserted[(x, y)] - plate[(x, y)]);
    let n_changed = (0..plate.height())
        .flat_map(|y| (0..plate.width()).map(move |x| (x, y)))
        .filter(|(x, y)| changed(*x, *y) != 0.0)
        .count();
    assert!(n_changed > 20_000, "only {n_changed} pixels changed");
    assert!((0..plate.width()).all(|x| changed(x, 0) == 0.0));
    // Copper in daylight, on the plate's scale: neither black nor burnt out.
    let vase = luminance(inserted[(525, 380)]);
    assert!((0.05..0.9).contains(&vase), "luminance of the vase {vase}");
}

/// Two runs of the generator at 1/12 of the size give the same bytes, whatever the threads.
#[test]
fn demo_generator_is_deterministic() {
    let folder = tempfile::tempdir().expect("a scratch folder");
    let [one, two] = ["one", "two"].map(|name| folder.path().join(name));
    let small = ["--coarser", "12", "--samples", "1"];
    run(example("make_demo").arg("--out").arg(&one).args(small).env("RAYON_NUM_THREADS", "1"));
    run(example("make_demo").arg("--out").arg(&two).args(small).env("RAYON_NUM_THREADS", "3"));
    let mut n_files = 0;
    for entry in std::fs::read_dir(&one).expect("the folder just written") {
        let path = entry.expect("an entry").path();
        let name = path.file_name().expect("a file");
        let bytes = |path: &Path| std::fs::read(path).expect("a file just written");
        assert!(bytes(&path) == bytes(&two.join(name)), "{} differs", name.display());
        n_files += 1;
    }
    assert_eq!(n_files, 30, "files of the demo shot");
}

/// The shot file in plates/demo is the one the generator writes.
#[test]
fn demo_shot_file_is_up_to_date() {
    let folder = tempfile::tempdir().expect("a scratch folder");
    run(example("make_demo").arg("--out").arg(folder.path()).args(["--only", "shot.toml"]));
    let text = |path: &Path| std::fs::read_to_string(path).expect("shot.toml");
    assert_eq!(text(&folder.path().join("shot.toml")), text(&demo("shot.toml")));
}

/// The answer scored as a result is perfect but for the grain; a plate without objects is far off.
#[test]
fn score_tells_the_plate_from_the_answer() {
    let folder = tempfile::tempdir().expect("a scratch folder");
    let plate = photo::read(&demo("plate.png"), &ReadOptions::default()).expect("the plate");
    let picture = photo::png::srgb_codes(&plate.linear);
    let path = folder.path().join("composite.exr");
    let (width, height) = (plate.linear.width(), plate.linear.height());
    photo::png::write(&path, &picture, width, height, &plate.encoding).expect("a PNG");
    let said = run(example("score_demo").arg(folder.path()).arg(demo("")));
    let shadow = said.lines().find(|l| l.contains("shadow")).expect("a line for the shadow");
    assert!(shadow.contains("-100.00 %"), "{said}");
}
