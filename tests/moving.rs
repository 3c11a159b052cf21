//! Objects that move: a box that slides along X over three frames, as a user runs it.

mod program;
mod tiny;

use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

use glam::DVec3;
use platelight::photo::{self, Image, ReadOptions};
use platelight::render::Context;
use platelight::report::Warning;
use platelight::shot::ShotFile;
use platelight::shot::run::{RunOptions, run_frames};
use platelight::shot::watch::{Silent, Watch};
use program::{platelight, text};
use tiny::{HEIGHT, Plate, WIDTH, camera, write_shot};

/// Half a side of the box, metres.
const HALF: f32 = 0.1;
/// Where its middle is in X after 0, 1/24 and 2/24 s.
const X: [f64; 3] = [-0.4, 0.0, 0.4];

/// `box.gltf`: a box that stands on the ground in a node that goes from `X[0]` to `X[2]`; its other
/// animation scales it with the same numbers, flat in two axes.
fn write_box(folder: &Path) {
    let corner = |i: usize| {
        let side = |bit: usize| if i >> bit & 1 == 0 { -HALF } else { HALF };
        [side(0), side(1) + HALF, side(2)]
    };
    let floats = (0..8).flat_map(corner).chain([0.0, 2.0 / 24.0]);
    let places = [X[0] as f32, 0.0, 0.0, X[2] as f32, 0.0, 0.0];
    let mut buffer: Vec<u8> = floats.chain(places).flat_map(f32::to_le_bytes).collect();
    // Two triangles a face, corners counted in binary (x, y, z).
    let faces =
        [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    buffer.extend(faces.iter().flat_map(|&[a, b, c, d]: &[u8; 4]| [a, b, c, a, c, d]));
    let json = format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],
        "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}},"indices":1}}]}}],
        "animations":[{{"name":"slide","channels":[
            {{"sampler":0,"target":{{"node":0,"path":"translation"}}}}],
            "samplers":[{{"input":2,"output":3}}]}},
        {{"name":"hide","channels":[{{"sampler":0,"target":{{"node":0,"path":"scale"}}}}],
            "samplers":[{{"input":2,"output":3}}]}}],
        "accessors":[{{"bufferView":0,"componentType":5126,"count":8,"type":"VEC3"}},
        {{"bufferView":0,"byteOffset":128,"componentType":5121,"count":36,"type":"SCALAR"}},
        {{"bufferView":0,"byteOffset":96,"componentType":5126,"count":2,"type":"SCALAR"}},
        {{"bufferView":0,"byteOffset":104,"componentType":5126,"count":2,"type":"VEC3"}}],
        "bufferViews":[{{"buffer":0,"byteLength":{n}}}],
        "buffers":[{{"byteLength":{n},"uri":"box.bin"}}]}}"#,
        n = buffer.len()
    );
    std::fs::write(folder.join("box.bin"), buffer).expect("box.bin");
    std::fs::write(folder.join("box.gltf"), json).expect("box.gltf");
}

/// A shot of the box under the frames 1001 to 1003, or under one plate; `keys` are the box's.
fn write_moving(folder: &Path, frames: Option<&str>, keys: &str) -> PathBuf {
    write_box(folder);
    let object = format!("[[object]]\nfile = \"box.gltf\"\n{keys}\n");
    let shot = write_shot(folder, Plate::ExrHalf, &object);
    let Some(frames) = frames else { return shot };
    for frame in 1001..=1003 {
        let name = folder.join(format!("plate.{frame}.exr"));
        std::fs::copy(folder.join("plate.exr"), name).expect("a frame");
    }
    let pattern = format!("\"plate.####.exr\"\nframes = \"{frames}\"");
    let single = std::fs::read_to_string(&shot).expect("shot");
    std::fs::write(&shot, single.replace("\"plate.exr\"", &pattern)).expect("shot");
    shot
}

/// Counts how often the lens is looked for.
#[derive(Default)]
struct Lenses(AtomicU32);

impl Watch for Lenses {
    fn stage(&self, name: &str) {
        self.0.fetch_add(u32::from(name == "calibrate the lens"), Ordering::Relaxed);
    }
    fn progress(&self, _done: f64, _error: f64) {}
    fn warning(&self, _warning: &Warning) {}
    fn written(&self, _path: &Path) {}
}

fn run(shot: &Path, out: &Path, context: &Context, watch: &dyn Watch) {
    let shot = ShotFile::read(shot).expect("the shot file is right");
    for finished in run_frames(&shot, out, &RunOptions::default(), context, watch) {
        assert!(finished.expect("the frame runs").complete);
    }
}

/// Columns of the picture that show the box.
fn columns_shown(composite: &Path) -> RangeInclusive<usize> {
    let options = ReadOptions { layer: Some("object".to_owned()), ..ReadOptions::default() };
    let object: Image<_> = photo::read(composite, &options).expect("a layer").linear;
    let shows = |x: usize| (0..HEIGHT).any(|y| object[(x, y)].max_element() > 0.0);
    let first = (0..WIDTH).find(|&x| shows(x)).expect("the box is seen");
    let last = (0..WIDTH).rev().find(|&x| shows(x)).expect("the box is seen");
    first..=last
}

/// The same from the box's corners and the camera of [`write_shot`].
fn columns_expected(x: f64) -> RangeInclusive<usize> {
    let camera = camera();
    let half = f64::from(HALF);
    let columns = (0..8).map(|i| {
        let side = |bit: i32| if i >> bit & 1 == 0 { -half } else { half };
        let corner = DVec3::new(x + side(0), half + side(1), side(2));
        camera.project_world(corner).expect("in front of the camera").x
    });
    let (first, last) =
        columns.fold((f64::MAX, f64::MIN), |(first, last), u| (first.min(u), last.max(u)));
    // Pixel i reaches from i − ½ to i + ½.
    first.round() as usize..=last.round() as usize
}

fn assert_near(shown: RangeInclusive<usize>, expected: RangeInclusive<usize>) {
    // A pixel of which less than one sample in eight falls on the box may miss it; the sampling kernel
    // reaches half a pixel over its border.
    let near = |a: &usize, b: &usize| a.abs_diff(*b) <= 1;
    let is_near = near(shown.start(), expected.start()) && near(shown.end(), expected.end());
    assert!(is_near, "columns {shown:?} show the box, expected were {expected:?}");
}

#[test]
fn a_box_that_slides_stands_in_each_frame_where_its_keys_put_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let shot = write_moving(folder.path(), Some("1001-1003"), "");
    let lenses = Lenses::default();
    let all = folder.path().join("all");
    run(&shot, &all, &Context::new(3), &lenses);
    assert_eq!(lenses.0.into_inner(), 1, "what stands still is found once");
    for (frame, x) in [1001, 1002, 1003].into_iter().zip(X) {
        let shown = columns_shown(&all.join(format!("composite.{frame}.exr")));
        assert_near(shown, columns_expected(x));
    }
    // The last frame alone, on one thread: the same bytes. Its number says no longer when it begins.
    let shot = write_moving(folder.path(), Some("1003"), "start_frame = 1001");
    let one = folder.path().join("one");
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread");
    pool.install(|| run(&shot, &one, &Context::new(3), &Silent));
    for name in ["composite.1003.png", "panorama.1003.exr", "camera.1003.json"] {
        let bytes = |folder: &Path| std::fs::read(folder.join(name)).expect("a result");
        assert!(bytes(&all) == bytes(&one), "{name} differs");
    }
    let report = std::fs::read_to_string(all.join("report.1003.json")).expect("a report");
    let report: serde_json::Value = serde_json::from_str(&report).expect("JSON");
    assert_eq!(report["shot"]["plate"]["frame"], 1003);
}

#[test]
fn a_single_plate_shows_the_second_that_time_names_and_else_the_rest() {
    let folder = tempfile::tempdir().expect("a folder");
    for (keys, x) in [("", 0.0), ("time = 0", X[0]), ("animation = \"slide\"\ntime = 9", X[2])] {
        let shot = write_moving(folder.path(), None, keys);
        let out = folder.path().join("out");
        run(&shot, &out, &Context::new(3), &Silent);
        assert_near(columns_shown(&out.join("composite.exr")), columns_expected(x));
        let report = std::fs::read_to_string(out.join("report.json")).expect("a report");
        let says = report.contains("has the animation \\\"slide\\\"");
        assert_eq!(says, keys.is_empty(), "only the rest is told of: {report}");
    }
}

#[test]
fn what_an_animation_hides_changes_nothing_and_is_no_news() {
    let folder = tempfile::tempdir().expect("a folder");
    let shot = write_moving(folder.path(), Some("1001-1002"), "animation = \"hide\"");
    let out = folder.path().join("out");
    run(&shot, &out, &Context::new(3), &Silent);
    for frame in [1001, 1002] {
        let report = std::fs::read_to_string(out.join(format!("report.{frame}.json")));
        let report: serde_json::Value =
            serde_json::from_str(&report.expect("a report")).expect("JSON");
        assert_eq!(report["composite"]["tally"]["changed"], 0);
        let warnings = report["warnings"].to_string();
        assert!(!warnings.contains("object") && !warnings.contains("box"), "{warnings}");
    }
}

#[test]
fn an_animation_that_is_not_there_is_told_before_any_work() {
    let folder = tempfile::tempdir().expect("a folder");
    let said = |keys: &str| {
        write_moving(folder.path(), Some("1001-1003"), keys);
        let output = platelight(&["check", text(folder.path())]);
        assert_eq!(output.status.code(), Some(2), "{keys}");
        String::from_utf8_lossy(&output.stderr).into_owned()
    };
    let error = said("animation = \"slied\"");
    assert!(error.contains("object[0].animation: ") && error.contains("\"slied\""), "{error}");
    assert!(error.contains("box.gltf") && error.contains("it has \"slide\""), "{error}");
    let cube = tiny::write_cube(folder.path(), 0.1).replace("[[object]]\n", "");
    let error = said(&format!("[[object]]\n{cube}start_frame = 1001"));
    assert!(error.contains("object[1].file: ") && error.contains("moves no node"), "{error}");
}
