//! Animations of glTF in files made here: what moves, and what cannot be right.

use std::path::Path;

use glam::{DAffine3, DQuat, DVec3};

use super::gltf::{read, read_played};
use super::gltf_tests::{base64, floats};
use super::{Model, SceneError};

/// Seconds, then values of two tracks: a way along X (three keys) and half a turn about Y (two keys).
const NUMBERS: [f32; 25] = [
    0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, // a triangle
    1.0, 2.0, 4.0, // times
    0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 5.0, 0.0, 0.0, // places
    0.0, 0.0, 0.0, 1.0, // no turn
];

/// About Y by 90°.
const QUARTER: [f32; 4] =
    [0.0, std::f32::consts::FRAC_1_SQRT_2, 0.0, std::f32::consts::FRAC_1_SQRT_2];

/// Accessors: 0 positions, 1 three times, 2 three places, 3 two times (those from 1 to 2 s), 4 two turns.
const ACCESSORS: &str = r#"
    {"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"},
    {"bufferView":0,"byteOffset":36,"componentType":5126,"count":3,"type":"SCALAR"},
    {"bufferView":0,"byteOffset":48,"componentType":5126,"count":3,"type":"VEC3"},
    {"bufferView":0,"byteOffset":36,"componentType":5126,"count":2,"type":"SCALAR"},
    {"bufferView":0,"byteOffset":84,"componentType":5126,"count":2,"type":"VEC4"}"#;

/// An arm (node 0, a mesh of its own) that holds a hand (node 1) 2 m along its Z.
const NODES: &str = r#"{"mesh":0,"children":[1]},{"mesh":0,"translation":[0,0,2]}"#;

/// The arm goes along X and turns about Y.
const SWING: &str = r#"{"name":"swing","channels":[
    {"sampler":0,"target":{"node":0,"path":"translation"}},
    {"sampler":1,"target":{"node":0,"path":"rotation"}}],
    "samplers":[{"input":1,"output":2},{"input":3,"output":4}]}"#;

fn file(folder: &Path, nodes: &str, accessors: &str, animations: &str) -> std::path::PathBuf {
    let buffer = floats(&[&NUMBERS[..], &QUARTER].concat());
    let json = format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{nodes}],
        "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}}}}]}}],"accessors":[{accessors}],
        "bufferViews":[{{"buffer":0,"byteLength":{n}}}],"animations":[{animations}],
        "buffers":[{{"byteLength":{n},"uri":"data:;base64,{bytes}"}}]}}"#,
        n = buffer.len(),
        bytes = base64(&buffer)
    );
    serde_json::from_str::<serde_json::Value>(&json).expect("the test's own JSON");
    let path = folder.join("arm.gltf");
    std::fs::write(&path, json).expect("a file to read");
    path
}

fn read_arm(accessors: &str, animations: &str) -> Result<Model, SceneError> {
    let folder = tempfile::tempdir().expect("a folder");
    read_played(&file(folder.path(), NODES, accessors, animations), None)
}

/// First corners of the two meshes: where the arm and the hand are.
fn places(model: &Model) -> [DVec3; 2] {
    [0, 1].map(|mesh: usize| model.meshes[mesh].positions[0])
}

#[test]
fn a_hand_follows_the_arm_that_moves_and_turns() {
    let model = read_arm(ACCESSORS, SWING).unwrap();
    assert!(model.warnings.is_empty(), "{:?}", model.warnings);
    let rest = [DVec3::ZERO, 2.0 * DVec3::Z];
    assert_eq!(places(&model), rest, "at rest until it is played");
    for (time, x, turned_deg) in
        [(0.0, 0.0, 0.0), (1.5, 0.5, 45.0), (2.0, 1.0, 90.0), (3.0, 3.0, 90.0), (9.0, 5.0, 90.0)]
    {
        let turn = DQuat::from_rotation_y(f64::to_radians(turned_deg));
        let [arm, hand] = places(&model.at_time(time).unwrap());
        assert!((arm - DVec3::X * x).length() < 1e-6, "{time}: {arm}");
        assert!(
            (hand - (DVec3::X * x + turn * (2.0 * DVec3::Z))).length() < 1e-6,
            "{time}: {hand}"
        );
    }
    // In any order: no time hangs on another.
    let late = model.at_time(3.0).unwrap();
    assert_eq!(places(&late.at_time(1.5).unwrap()), places(&model.at_time(1.5).unwrap()));
}

#[test]
fn the_box_of_a_motion_holds_every_moment_of_it() {
    let model = read_arm(ACCESSORS, SWING).unwrap();
    let to_world = DAffine3::from_translation(DVec3::new(0.0, 7.0, 0.0));
    let [min, max] = model.swept_bounds(&to_world).unwrap();
    for k in 0..=40 {
        let [low, high] = model.at_time(0.1 * f64::from(k)).unwrap().bounds(&to_world).unwrap();
        assert!((low - min).min_element() > -1e-3 && (max - high).min_element() > -1e-3, "{k}");
    }
    // The hand ends 2 m in X beside the arm's last place, and its triangle turned with it.
    assert!((max.x - 7.0).abs() < 1e-6 && (max.y - 8.0).abs() < 1e-6, "{max}");
    let still = read_arm(ACCESSORS, "").unwrap();
    assert_eq!(still.swept_bounds(&to_world), still.bounds(&to_world));
}

#[test]
fn animations_are_found_by_name_and_a_wrong_one_names_those_there_are() {
    let folder = tempfile::tempdir().unwrap();
    let animations = format!(
        r#"{{"channels":[{{"sampler":0,"target":{{"node":1,"path":"scale"}}}}],
            "samplers":[{{"input":1,"output":2,"interpolation":"STEP"}}]}},{SWING}"#
    );
    let path = file(folder.path(), NODES, ACCESSORS, &animations);
    let first = read_played(&path, None).unwrap();
    assert_eq!(first.animations, ["animations[0]", "swing"]);
    // The first one scales the hand, flat in two axes: it is hidden, which is no news.
    let flat = first.at_time(2.5).unwrap();
    assert_eq!((first.n_triangles(), flat.n_triangles()), (2, 1));
    assert!(flat.warnings.is_empty(), "{:?}", flat.warnings);
    let swing = read_played(&path, Some("swing")).unwrap();
    assert!((places(&swing.at_time(4.0).unwrap())[0].x - 5.0).abs() < 1e-6);
    let error = read_played(&path, Some("swign")).unwrap_err().to_string();
    assert!(error.contains("swign") && error.contains("\"animations[0]\", \"swing\""), "{error}");
    let error = super::read_played(Path::new("a.obj"), Some("walk")).unwrap_err().to_string();
    assert!(error.contains("a.obj") && error.contains("has none"), "{error}");
}

#[test]
fn a_broken_animation_is_named_when_it_is_played_and_no_matter_at_rest() {
    let channel = |node: &str, sampler: &str, path: &str| {
        format!(
            r#"{{"channels":[{{"sampler":{sampler},"target":{{"node":{node},"path":"{path}"}}}}],
            "samplers":[{{"input":1,"output":2}}]}}"#
        )
    };
    let sampler = |input: usize, output: usize, way: &str| {
        format!(
            r#"{{"channels":[{{"sampler":0,"target":{{"node":0,"path":"translation"}}}}],
            "samplers":[{{"input":{input},"output":{output},"interpolation":"{way}"}}]}}"#
        )
    };
    let accessor = |offset: usize, count: u64, kind: &str| {
        format!(
            r#"{ACCESSORS},{{"bufferView":0,"byteOffset":{offset},"componentType":5126,"count":{count},"type":"{kind}"}}"#
        )
    };
    let own = || ACCESSORS.to_owned();
    let sparse = format!(
        r#"{ACCESSORS},{{"componentType":5126,"count":4000000000,"type":"SCALAR","sparse":{{"count":1,
        "indices":{{"bufferView":0,"componentType":5121}},"values":{{"bufferView":0}}}}}}"#
    );
    for (accessors, animation, told) in [
        (own(), channel("7", "0", "translation"), "channels[0].target.node: node 7 of 2"),
        (own(), sampler(3, 2, "LINEAR"), "(translation of nodes[0]): 3 values for 2 keys"),
        (own(), sampler(1, 2, "CUBICSPLINE"), "3 values for 3 keys, which need 3 each"),
        (own(), sampler(1, 4, "LINEAR"), "accessors[4] (keyframe values): Vec4"),
        (own(), sampler(2, 2, "LINEAR"), "accessors[2] (keyframe times): Vec3"),
        (accessor(40, 3, "SCALAR"), sampler(5, 2, "LINEAR"), "key 2 at 0 s comes after one at 4 s"),
        (
            accessor(36, 4000, "SCALAR"),
            sampler(5, 2, "LINEAR"),
            "accessors[5] (keyframe times): 4000",
        ),
        (
            sparse,
            sampler(5, 2, "LINEAR"),
            "accessors[5] (keyframe times) needs 4000000000 elements",
        ),
    ] {
        let error = read_arm(&accessors, &animation).unwrap_err().to_string();
        assert!(error.contains(told), "{error}\nis not: {told}");
        let folder = tempfile::tempdir().unwrap();
        let path = file(folder.path(), NODES, &accessors, &animation);
        assert_eq!(read(&path).map(|model| model.n_triangles()).ok(), Some(2), "{told}");
    }
    // Judged by the crate, at rest too.
    for (animation, told) in [
        (channel("0", "1", "translation"), "animations[0].channels[0].sampler"),
        (sampler(9, 2, "LINEAR"), "animations[0].samplers[0].input"),
        (sampler(1, 2, "BEZIER"), "animations[0].samplers[0].interpolation"),
    ] {
        let error = read_arm(ACCESSORS, &animation).unwrap_err().to_string();
        assert!(error.contains(told), "{error}");
    }
    let folder = tempfile::tempdir().unwrap();
    let matrix = r#"{"mesh":0,"matrix":[1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1]}"#;
    let path = file(folder.path(), matrix, ACCESSORS, SWING);
    let error = read_played(&path, None).unwrap_err().to_string();
    assert!(error.contains("nodes[0]") && error.contains("matrix"), "{error}");
}

#[test]
fn channels_that_are_not_of_nodes_are_left_out() {
    let animation = r#"{"channels":[
        {"sampler":0,"target":{"path":"pointer","extensions":{"KHR_animation_pointer":{"pointer":"/x"}}}},
        {"sampler":0,"target":{"node":0,"path":"weights"}},
        {"sampler":0,"target":{"node":0,"path":"colour"}},
        {"sampler":0,"target":{"node":1,"path":"translation"}},
        {"sampler":1,"target":{"node":1,"path":"translation"}}],
        "samplers":[{"input":1,"output":2},{"input":9,"output":9}]}"#
        .replace("{\"input\":9,\"output\":9}", "{\"input\":1,\"output\":2,\"interpolation\":\"STEP\"}");
    let model = read_arm(ACCESSORS, &animation).unwrap();
    let [unknown, second] = model.warnings.as_slice() else { panic!("{:?}", model.warnings) };
    assert!(unknown.contains("2 of 5 channels") && second.contains("1 of 5"), "{unknown} {second}");
    let [arm, hand] = places(&model.at_time(1.5).unwrap());
    assert_eq!((arm, hand), (DVec3::ZERO, 0.5 * DVec3::X));
}
