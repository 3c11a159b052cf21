//! Runs from beginning to end: one shot, a batch of them, the frames of a sequence.

#[cfg(unix)]
mod interrupted;
mod program;
mod tiny;

use std::path::{Path, PathBuf};
use std::process::Output;

use platelight::render::Context;
use platelight::shot::ShotFile;
use platelight::shot::run::{RunError, RunOptions, run_frames};
use platelight::shot::watch::{Silent, Watch};
use platelight::shot::write::OutFiles;
use program::{platelight, text};
use tiny::{Plate, write_cube, write_shot};

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn a_run_leaves_all_its_files_and_tells_json() {
    let folder = tempfile::tempdir().expect("a folder");
    let cube = write_cube(folder.path(), 0.15);
    write_shot(folder.path(), Plate::Png16, &cube);
    let out = folder.path().join("results");
    let arguments = ["run", text(folder.path()), "--out", text(&out), "--json", "--quiet"];
    let output = platelight(&arguments);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert!(output.stderr.is_empty(), "quiet is quiet: {}", stderr(&output));
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    for key in ["camera", "pose", "probe", "lights", "render", "composite", "budget", "warnings"] {
        assert!(report.get(key).is_some(), "report has no {key}");
    }
    for name in [
        "composite.exr",
        "composite.png",
        "camera.json",
        "panorama.exr",
        "report.json",
        "report.html",
        "overlay_support.png",
    ] {
        assert!(out.join(name).is_file(), "no {name}");
    }
    let files = OutFiles::new(&out, None);
    for entry in std::fs::read_dir(&out).expect("out").flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        assert!(files.is_result(&name), "a run writes {name} and would overwrite an input of it");
    }
    let hidden = std::fs::read_dir(&out).expect("out").flatten();
    let left: Vec<PathBuf> = hidden
        .map(|entry| entry.path())
        .filter(|path| path.file_name().is_some_and(|n| n.to_string_lossy().starts_with('.')))
        .collect();
    assert!(left.is_empty(), "temporary files are left: {left:?}");

    // Complete and from the same inputs: nothing to do. A cut file is made anew.
    let again = [&arguments[..], &["--skip-existing"]].concat();
    let exr = out.join("composite.exr");
    let written = || std::fs::metadata(&exr).and_then(|m| m.modified()).expect("composite.exr");
    let before = written();
    assert_eq!(platelight(&again).status.code(), Some(0));
    assert_eq!(written(), before, "it was rendered again");
    std::fs::write(&exr, "cut").expect("composite.exr");
    assert_eq!(platelight(&again).status.code(), Some(0));
    assert!(std::fs::metadata(&exr).expect("composite.exr").len() > 1000, "it was left cut");
}

#[test]
fn an_edited_material_library_or_texture_is_not_skipped() {
    let folder = tempfile::tempdir().expect("a folder");
    let cube = write_cube(folder.path(), 0.15);
    let obj = folder.path().join("cube.obj");
    let mesh = std::fs::read_to_string(&obj).expect("cube.obj");
    std::fs::write(&obj, format!("mtllib a.mtl\nusemtl red\n{mesh}")).expect("cube.obj");
    let library = folder.path().join("a.mtl");
    std::fs::write(&library, "newmtl red\nKd 0.8 0 0\n").expect("a.mtl");
    write_shot(folder.path(), Plate::Png8, &cube);
    let run = || {
        let output = platelight(&["run", text(folder.path()), "--skip-existing"]);
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        std::fs::read(folder.path().join("out/composite.png")).expect("a picture")
    };
    let red = run();
    assert_eq!(run(), red);
    std::fs::write(&library, "newmtl red\nKd 0 0 0.81\n").expect("a.mtl");
    assert_ne!(run(), red, "the picture of before was kept");
}

#[test]
fn one_bad_shot_stops_nothing_and_is_told() {
    let folder = tempfile::tempdir().expect("a folder");
    write_shot(&folder.path().join("a-good"), Plate::ExrFloat, "");
    let bad = write_shot(&folder.path().join("b-bad"), Plate::Png8, "");
    std::fs::remove_file(bad.with_file_name("plate.png")).expect("it was written");
    write_shot(&folder.path().join("c-good"), Plate::Png8, "");
    let output = platelight(&["batch", text(folder.path())]);
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    let table = String::from_utf8_lossy(&output.stdout);
    assert!(table.contains("done") && table.contains("failed") && table.contains("plate.png"));
    for (name, there) in [("a-good", true), ("b-bad", false), ("c-good", true)] {
        assert_eq!(folder.path().join(name).join("out/composite.png").is_file(), there, "{name}");
    }
    let summary = std::fs::read(folder.path().join("batch.json")).expect("batch.json");
    let summary: serde_json::Value = serde_json::from_slice(&summary).expect("JSON");
    let status: Vec<_> =
        (0..3).map(|i| summary["shots"][i]["status"].as_str().expect("a status")).collect();
    assert_eq!(status, ["done", "failed", "done"]);
}

#[test]
fn a_batch_of_bad_shots_is_exit_code_2_and_writes_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    for name in ["a", "b"] {
        let shot = write_shot(&folder.path().join(name), Plate::Png8, "");
        std::fs::remove_file(shot.with_file_name("camera.json")).expect("it was written");
    }
    let output = platelight(&["batch", text(folder.path())]);
    assert_eq!(output.status.code(), Some(2));
    assert!(!folder.path().join("batch.json").exists());
}

/// A shot of frames 1001 to 1003 of which only `there` exist.
fn write_sequence(folder: &Path, there: &[i64]) -> PathBuf {
    let shot = write_shot(folder, Plate::ExrHalf, "");
    for frame in there {
        let name = folder.join(format!("plate.{frame}.exr"));
        std::fs::copy(folder.join("plate.exr"), name).expect("a frame");
    }
    let single = std::fs::read_to_string(&shot).expect("shot");
    let sequence = single.replace("\"plate.exr\"", "\"plate.####.exr\"\nframes = \"1001-1003\"");
    std::fs::write(&shot, sequence).expect("shot");
    shot
}

#[test]
fn frames_of_a_sequence_are_run_one_by_one_and_a_missing_one_is_told() {
    let folder = tempfile::tempdir().expect("a folder");
    write_sequence(folder.path(), &[1001, 1003]);
    let output = platelight(&["run", text(folder.path())]);
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains("plate.1002.exr"), "{said}");
    assert!(folder.path().join("out/composite.1001.exr").is_file());
    assert!(!folder.path().join("out/composite.1002.exr").exists());
    assert!(folder.path().join("out/report.1003.json").is_file());
}

#[test]
fn a_batch_counts_the_frames_that_failed_beside_those_that_are_done() {
    let folder = tempfile::tempdir().expect("a folder");
    write_sequence(&folder.path().join("shot"), &[1002, 1003]);
    let output = platelight(&["batch", text(folder.path())]);
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    let summary = std::fs::read(folder.path().join("batch.json")).expect("batch.json");
    let summary: serde_json::Value = serde_json::from_slice(&summary).expect("JSON");
    let shot = &summary["shots"][0];
    assert_eq!(shot["status"], "part");
    let counts = ["done", "skipped", "failed", "missing"].map(|key| shot["frames"][key].as_u64());
    assert_eq!(counts, [2, 0, 1, 0].map(Some));
    let problem = shot["problems"][0].as_str().expect("a problem");
    assert!(problem.contains("plate.1001.exr"), "{problem}");
}

#[test]
fn frames_that_a_cancelled_run_did_not_begin_are_told_as_interrupted() {
    let folder = tempfile::tempdir().expect("a folder");
    let shot = ShotFile::read(&write_sequence(folder.path(), &[1001, 1002, 1003])).expect("a shot");
    let context = Context::new(0);
    context.cancel();
    let out = folder.path().join("out");
    let ended = run_frames(&shot, &out, &RunOptions::default(), &context, &Silent);
    assert_eq!(ended.len(), 3);
    assert!(ended.iter().all(|frame| matches!(frame, Err(RunError::Interrupted))));
}

/// Counts how often the lens is looked for.
#[derive(Default)]
struct Lenses(std::sync::atomic::AtomicU32);

impl Watch for Lenses {
    fn stage(&self, name: &str) {
        let counts = name == "calibrate the lens";
        self.0.fetch_add(u32::from(counts), std::sync::atomic::Ordering::Relaxed);
    }
    fn progress(&self, _done: f64, _error: f64) {}
    fn warning(&self, _warning: &platelight::report::Warning) {}
    fn written(&self, _path: &Path) {}
}

#[test]
fn a_sequence_is_prepared_once_and_its_frames_are_as_if_run_alone() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = write_sequence(folder.path(), &[1001, 1002, 1003]);
    let text_of = std::fs::read_to_string(&path).expect("shot");
    let cube = write_cube(folder.path(), 0.15);
    std::fs::write(&path, format!("{text_of}{cube}")).expect("shot");
    let run = |out: &str| {
        let shot = ShotFile::read(&path).expect("a shot");
        let (out, lenses) = (folder.path().join(out), Lenses::default());
        let ended = run_frames(&shot, &out, &RunOptions::default(), &Context::new(3), &lenses);
        let n_done = ended.iter().filter(|frame| frame.is_ok()).count();
        (out, n_done, lenses.0.into_inner())
    };
    let (all, n_done, n_lenses) = run("all");
    assert_eq!((n_done, n_lenses), (3, 1));
    let alone = std::fs::read_to_string(&path).expect("shot").replace("1001-1003", "1003");
    std::fs::write(&path, alone).expect("shot");
    let (one, n_done, n_lenses) = run("one");
    assert_eq!((n_done, n_lenses), (1, 1));
    for name in ["composite.1003.png", "panorama.1003.exr", "camera.1003.json"] {
        let bytes = |folder: &Path| std::fs::read(folder.join(name)).expect("a result");
        assert!(bytes(&all) == bytes(&one), "{name} differs");
    }
    let report = std::fs::read_to_string(all.join("report.1003.json")).expect("a report");
    assert!(report.contains("plate.1003.exr") && !report.contains("plate.1001.exr"));
}
