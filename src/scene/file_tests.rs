//! Mesh files made by others: the shared test data, and files broken on purpose.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use glam::Vec2;

use super::{Model, SceneError, read};

/// The folder of shared test data; `None`, said on stderr, where it is not installed.
fn shared() -> Option<PathBuf> {
    let beside = || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared"));
    let folder = std::env::var_os("PLATELIGHT_SHARED").map_or_else(beside, PathBuf::from);
    if !folder.is_dir() {
        eprintln!("{} is not there: files of others are not tested", folder.display());
        return None;
    }
    Some(folder)
}

/// All mesh files below a folder, sorted.
fn mesh_files(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    let mut folders = vec![folder.to_path_buf()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let extension = path.extension().and_then(|e| e.to_str()).unwrap_or("");
            if path.is_dir() {
                folders.push(path);
            } else if ["glb", "gltf", "obj"].contains(&extension) {
                files.push(path);
            }
        }
    }
    files.sort();
    files
}

/// Reads in a thread of its own; a panic or more than 20 s (a file here takes milliseconds) fails.
fn read_watched(path: &Path) -> Result<Model, SceneError> {
    let begin = Instant::now();
    let owned = path.to_path_buf();
    let reading = std::thread::spawn(move || read(&owned));
    while !reading.is_finished() {
        assert!(begin.elapsed() < Duration::from_secs(20), "{} hangs", path.display());
        std::thread::sleep(Duration::from_millis(1));
    }
    let result = reading.join();
    result.unwrap_or_else(|_| panic!("{} panics", path.display()))
}

fn assert_kept_promises(model: &Model) {
    for mesh in &model.meshes {
        let n = mesh.positions.len();
        assert!(mesh.positions.iter().all(|p| p.is_finite()));
        assert!(mesh.triangles.iter().flatten().all(|&i| (i as usize) < n));
        for length in [
            mesh.normals.len(),
            mesh.uvs.len(),
            mesh.second_uvs.len(),
            mesh.tangents.len(),
            mesh.colours.len(),
        ] {
            assert!(length == 0 || length == n);
        }
        assert!(mesh.material < model.materials.len());
    }
}

/// Name, triangles, and a word of each warning that should be there and no other.
type Expected = (&'static str, usize, &'static [&'static str]);

#[test]
fn good_gltf_files_load_with_their_triangles_and_no_needless_warning() {
    let Some(shared) = shared() else { return };
    // Counted from the files' accessors.
    let expected: [Expected; 15] = [
        ("AnimatedMorphCube/AnimatedMorphCube.gltf", 12, &["morph"]),
        ("BoxInterleaved.glb", 12, &[]),
        ("BoxTextured.glb", 12, &[]),
        ("Cameras/Cameras.gltf", 2, &[]),
        ("ClearCoatTest/ClearCoatTest.gltf", 37116, &[]),
        ("Duck.glb", 4212, &[]),
        ("MeshPrimitiveModes/Mesh_PrimitiveMode_00.gltf", 0, &["Points", "no triangles"]),
        ("MeshPrimitiveModes/Mesh_PrimitiveMode_04.gltf", 2, &[]),
        ("MeshPrimitiveModes/Mesh_PrimitiveMode_05.gltf", 2, &[]),
        ("MeshPrimitiveModes/Mesh_PrimitiveMode_06.gltf", 2, &[]),
        ("MeshPrimitiveModes/Mesh_PrimitiveMode_07.gltf", 0, &["Points", "no triangles"]),
        ("TextureTransformTest/TextureTransformTest.gltf", 24, &[]),
        ("empty_nodes.glb", 0, &["no triangles"]),
        ("nested.glb", 36, &[]),
        ("quad_skin.glb", 2, &["FB_ngon_encoding", "skin"]),
    ];
    let folder = shared.join("data/gltf-good");
    assert_eq!(mesh_files(&folder).len(), expected.len());
    for (name, n_triangles, words) in expected {
        let model = read_watched(&folder.join(name)).unwrap_or_else(|e| panic!("{e}"));
        assert_kept_promises(&model);
        assert_eq!(model.n_triangles(), n_triangles, "{name}");
        assert_eq!(model.warnings.len(), words.len(), "{name}: {:?}", model.warnings);
        for (warning, word) in model.warnings.iter().zip(words) {
            assert!(warning.contains(word), "{name}: {warning}");
        }
    }
}

#[test]
fn texture_transforms_turn_the_arrows_of_khronos_test_to_their_marks() {
    let Some(shared) = shared() else { return };
    let file = shared.join("data/gltf-good/TextureTransformTest/TextureTransformTest.gltf");
    let model = read(&file).unwrap();
    let at = |name: &str, uv: Vec2| {
        let material = model.materials.iter().find(|m| m.name == name).unwrap();
        material.evaluate(&model.textures, [uv; 2], glam::Vec4::ONE).base_colour.y
    };
    // The stored arrow runs down the diagonal; its mark "correct" is at 67.5° from the upper edge
    // about the upper left corner, "error" at 22.5°, "not supported" at 45°.
    let turned = |degrees: f32| 0.5 * Vec2::from_angle(degrees.to_radians());
    assert!(at("Rotation", turned(67.5)) < 0.05);
    assert!(at("Rotation", turned(30.0)) > 0.9 && at("Rotation", turned(45.0)) > 0.9);
    // uv 0.6, 0.6 of the arrow's shaft, taken back through offset −0.2, −0.1, 0.3 rad and 1.5.
    assert!(at("All", Vec2::new(0.3716, 0.6034)) < 0.05);
    assert!(at("Scale", Vec2::splat(0.4)) < 0.05 && at("Scale", Vec2::splat(0.6)) > 0.9);
}

#[test]
fn bad_gltf_files_end_in_an_error_or_a_warning() {
    let Some(shared) = shared() else { return };
    // A valid file with an empty BIN chunk: what was broken was a reader.
    let fine = "zero-sized-bin-chunk-issue-440.glb";
    let files = mesh_files(&shared.join("data/gltf-bad"));
    assert!(files.len() > 40);
    for file in files {
        let Ok(model) = read_watched(&file) else { continue };
        assert_kept_promises(&model);
        assert!(
            file.ends_with(fine) || !model.warnings.is_empty(),
            "{} passes in silence",
            file.display()
        );
    }
}

#[test]
fn truth_objects_load_with_their_triangles_and_without_a_warning() {
    let Some(shared) = shared() else { return };
    for (scene, n_triangles) in
        [("outdoor-sun", 192_372), ("overcast-soft", 173_480), ("indoor-window", 198_608)]
    {
        let folder = shared.join("truth").join(scene);
        let objects = read(&folder.join("objects.glb")).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(objects.n_triangles(), n_triangles, "{scene}");
        for name in ["objects.glb", "props.glb", "support.glb"] {
            let model = read(&folder.join(name)).unwrap_or_else(|e| panic!("{e}"));
            assert_kept_promises(&model);
            assert!(model.warnings.is_empty(), "{scene}/{name}: {:?}", model.warnings);
        }
    }
}

#[test]
fn obj_files_load_with_their_triangles() {
    let Some(shared) = shared() else { return };
    // Suzanne: 32 triangles and 468 quads.
    for (name, n_triangles, width) in [
        ("stanford-bunny.obj", 69_451, 0.156),
        ("teapot.obj", 6_320, 6.4),
        ("suzanne.obj", 32 + 2 * 468, 2.7),
        ("spot.obj", 5_856, 0.9),
    ] {
        let model = read(&shared.join("data/mesh-obj").join(name)).unwrap();
        assert_kept_promises(&model);
        assert_eq!(model.n_triangles(), n_triangles, "{name}");
        let [min, max] = model.bounds(&glam::DAffine3::IDENTITY).unwrap();
        assert!(((max - min).x / width - 1.0).abs() < 0.05, "{name}: {} m wide", (max - min).x);
    }
}

/// A small generator, so that the mutations never change.
fn random(state: &mut u64, below: usize) -> usize {
    *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    (*state >> 33) as usize % below.max(1)
}

/// Reads cut and mutated copies of a file's bytes: none may panic, hang or break a promise.
fn assert_survives(file: &Path, n_mutations: usize) {
    let extension = file.extension().unwrap().to_str().unwrap();
    let original = std::fs::read(file).unwrap();
    let folder = tempfile::tempdir().unwrap();
    // What a .gltf names stands beside it
    for entry in std::fs::read_dir(file.parent().unwrap()).unwrap() {
        let beside = entry.unwrap().path();
        if extension == "gltf" && beside.is_file() {
            std::fs::copy(&beside, folder.path().join(beside.file_name().unwrap())).unwrap();
        }
    }
    let path = folder.path().join("mutant").with_extension(extension);
    let mut state = 0x5eed;
    let mut n_read = 0;
    // More, for an hour of trying: PLATELIGHT_MUTATIONS=100.
    let more = std::env::var("PLATELIGHT_MUTATIONS").ok().and_then(|n| n.parse().ok());
    for round in 0..n_mutations * more.unwrap_or(1) {
        let mut bytes = original.clone();
        if round % 4 == 0 {
            bytes.truncate(random(&mut state, bytes.len()));
        }
        for _ in 0..1 + random(&mut state, 4) {
            // Half of the changes hit the first kilobyte: headers, counts and JSON.
            let reach = if round % 2 == 0 { bytes.len().min(1024) } else { bytes.len() };
            let at = random(&mut state, reach);
            let value = [0, 255, b'-', b'9', random(&mut state, 256) as u8];
            if let Some(byte) = bytes.get_mut(at) {
                *byte = value[random(&mut state, value.len())];
            }
        }
        std::fs::write(&path, &bytes).unwrap();
        if let Ok(model) = read_watched(&path) {
            assert_kept_promises(&model);
            n_read += 1;
        }
    }
    assert!(n_read > 0, "no mutant of the {extension} file was read: nothing was tested");
}

#[test]
fn mutated_files_never_panic_hang_or_break_a_promise() {
    let Some(shared) = shared() else { return };
    let data = shared.join("data");
    for (name, n_mutations) in [
        ("gltf-good/BoxTextured.glb", 600),
        ("gltf-good/nested.glb", 600),
        ("gltf-good/quad_skin.glb", 300),
        ("gltf-good/TextureTransformTest/TextureTransformTest.gltf", 300),
        ("mesh-obj/suzanne.obj", 300),
    ] {
        assert_survives(&data.join(name), n_mutations);
    }
}
