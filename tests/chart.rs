//! `platelight chart`: its files, its order of what is known, and whether `auto` holds what it promises.

mod program;
mod tiny;

use std::path::{Path, PathBuf};

use platelight::render::Context;
use platelight::report::chart::{Chart, Curve};
use platelight::shot::ShotFile;
use platelight::shot::chart::{ChartOptions, chart, named};
use platelight::shot::watch::Silent;
use program::{platelight, text};
use tiny::{Plate, write_cube, write_shot};

fn charted(
    shot: &Path,
    out: &Path,
    seconds: f64,
    methods: &[&str],
    reduced: Option<usize>,
) -> Chart {
    let names: Vec<String> = methods.iter().map(|&name| name.to_owned()).collect();
    let rows = named(&names).expect("methods that are there");
    let shot = ShotFile::read(shot).expect("the shot file is right");
    let options = ChartOptions { seconds, rows, reduced };
    let (chart, complete) =
        chart(shot, out, &options, &Context::new(7), &Silent).expect("the shot can be charted");
    assert!(complete);
    chart
}

/// Errors × √samples of a curve's first rendering, which no clock decides: on the objects and beside.
fn errors_of_a_sample(curve: &Curve) -> [f64; 2] {
    let first = curve.points.first().expect("a rendering");
    let errors = [first.on_objects, first.beside].map(|e| e.expect("an error that can be told"));
    errors.map(|error| error * (first.samples as f64).sqrt())
}

#[test]
fn all_files_are_written_and_what_is_known_of_the_methods_is_found() {
    let folder = tempfile::tempdir().expect("a folder");
    let object = write_cube(folder.path(), 0.3);
    let shot = write_shot(folder.path(), Plate::ExrFloat, &object);
    let out = folder.path().join("chart");
    let methods = ["two-pass-independent", "two-pass", "coupled", "depth-1", "patches-64"];
    let chart = charted(&shot, &out, 20.0, &methods, Some(1));

    for name in ["chart.csv", "chart.svg", "chart.png", "chart.html", "crops.png"] {
        assert!(out.join(name).metadata().is_ok_and(|file| file.len() > 100), "{name}");
    }
    let table = std::fs::read_to_string(out.join("chart.csv")).expect("chart.csv");
    let curve = |name: &str| {
        let found = chart.curves.iter().find(|curve| curve.name == name);
        found.unwrap_or_else(|| panic!("{name} is charted:\n{table}"))
    };
    assert_eq!(chart.size, [tiny::WIDTH, tiny::HEIGHT]);
    assert!(chart.curves.iter().all(|curve| table.contains(curve.name)));
    // What auto chooses is not measured twice, and said.
    assert!(chart.curves.iter().all(|curve| curve.name != "coupled"));
    assert!(chart.notes.iter().any(|note| note.contains("coupled is what auto does")));

    // methods-render R2.8: the same numbers in both pictures are worth a factor of five in variance
    // beside the objects. On them there is no second picture to take anything from.
    let [same, independent] =
        ["two-pass", "two-pass-independent"].map(|name| errors_of_a_sample(curve(name)));
    println!("error x root of samples: {same:.5?} {independent:.5?}\n{table}");
    assert!(1.3 * same[1] < independent[1], "{same:?} {independent:?}");
    assert!((same[0] / independent[0] - 1.0).abs() < 0.1, "{same:?} {independent:?}");
    // Without what the lit cube sends to the ground, that is too dark.
    let last = curve("depth-1").points.last().expect("a rendering");
    assert!(last.bias < -3.0 * last.bias_sigma, "{last:?}");
    let firsts = chart.curves.iter().filter_map(|curve| curve.points.first());
    let most = firsts.map(|point| point.samples).max();
    assert!(most.is_some_and(|most| most < chart.reference.samples), "{:?}", chart.reference);
    assert!(chart.reference.error < 0.02, "{:?}", chart.reference);
}

#[test]
fn what_is_wrong_is_told_before_any_work() {
    let folder = tempfile::tempdir().expect("a folder");
    let empties = [Plate::Png8, Plate::Png16, Plate::ExrHalf]
        .map(|plate| write_shot(&folder.path().join(format!("{plate:?}")), plate, ""));
    let empty = text(&empties[0]);
    for (arguments, told) in [
        (vec![empty, "--methods", "coupeld"], "did you mean coupled?"),
        (vec![empty, "--scale", "1.5"], "--scale: 1.5"),
        (vec![empty, "--scale", "0.001"], "the smallest that works is 0.334"),
        (vec![empty, "--time", "0"], "--time: \"0\" is no time; write seconds above 0"),
        (vec![empty, "--time", "1s"], "--time: 1s is not 2 s or more"),
        (vec![empty, "--time", "-3"], "--time: \"-3\" is no time"),
        (vec!["no/such/shot"], "no/such/shot"),
        (vec![empty], "object: there is none"),
        (vec![text(&empties[1])], "object: there is none"),
        (vec![text(&empties[2])], "object: there is none"),
    ] {
        let output = platelight(&[&["chart"], arguments.as_slice()].concat());
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {said}");
        assert!(said.contains(told), "{arguments:?}: {said}");
        assert!(empties.iter().all(|shot| !shot.with_file_name("out").exists()), "{arguments:?}");
    }
}

/// The shots on which `auto` is judged.
fn shots() -> Vec<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let shared = std::env::var_os("PLATELIGHT_SHARED")
        .map_or_else(|| root.join("../shared"), PathBuf::from)
        .join("truth");
    let mut shots = vec![root.join("plates/demo")];
    if shared.is_dir() {
        shots.extend(
            ["overcast-soft", "outdoor-sun", "indoor-window"].map(|name| shared.join(name)),
        );
    } else {
        eprintln!("skipped: {} has no truth scenes", shared.display());
    }
    shots
}

/// Six minutes: `make test-long`.
#[test]
#[ignore = "minutes"]
fn auto_is_within_half_again_of_the_best_unbiased_method_at_equal_cost() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut failures = Vec::new();
    for shot in shots() {
        let chart = charted(&shot, folder.path(), 90.0, &[], None);
        let verdict = chart.verdict.as_ref().expect("unbiased methods to compare with");
        println!("{}: {:.2} times {}, {verdict:?}", chart.name, verdict.ratio(), verdict.best);
        if verdict.ratio() > 1.5 {
            failures.push(format!("{}: {verdict:?}", chart.name));
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}
