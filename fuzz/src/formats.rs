//! What the program promises of every file format it reads, as functions of bytes.
//!
//! Each function reads `bytes` as its format and checks the result; an error is as good as a picture.
//! Shared by the fuzz targets and by `tests/hostile_files.rs`, which replays `corpus/`.

use std::fs;
use std::path::Path;

use platelight::bracket::exposure;
use platelight::camera;
use platelight::photo::{self, ReadOptions};
use platelight::scene::{self, Model, SceneError};
use platelight::shot::file::ShotFile;

/// A format: the name of its fuzz target and corpus folder, and its function.
pub type Format = (&'static str, fn(&[u8]));

/// Every format the program reads.
pub const FORMATS: [Format; 14] = [
    ("exr", exr),
    ("hdr", hdr),
    ("png", png),
    ("tiff", tiff),
    ("jpeg", jpeg),
    ("exif", exif),
    ("icc", icc),
    ("gltf", gltf),
    ("glb", glb),
    ("obj", obj),
    ("mtl", mtl),
    ("shot", shot),
    ("camera", camera),
    ("times", times),
];

/// Memory a picture may take: small, so that a size believed too early is seen at once.
pub const MAX_BYTES: u64 = 16 << 20;

fn picture(name: &str, bytes: &[u8]) {
    for layer in [None, Some("difference".to_string())] {
        let options = ReadOptions { layer, max_bytes: MAX_BYTES, ..ReadOptions::default() };
        match photo::read_bytes(Path::new(name), bytes, &options) {
            Ok(photo) => {
                let pixels = photo.linear.width() * photo.linear.height();
                assert!(pixels > 0);
                assert!(photo.linear.pixels().iter().all(|l| l.is_finite()));
                assert_eq!(photo.clipped.pixels().len(), pixels);
            }
            Err(error) => assert!(error.to_string().contains(name), "{error}"),
        }
    }
}

pub fn exr(bytes: &[u8]) {
    picture("a.exr", bytes);
}

pub fn hdr(bytes: &[u8]) {
    picture("a.hdr", bytes);
}

pub fn png(bytes: &[u8]) {
    picture("a.png", bytes);
}

pub fn tiff(bytes: &[u8]) {
    picture("a.tif", bytes);
}

pub fn jpeg(bytes: &[u8]) {
    picture("a.jpg", bytes);
}

/// An EXIF block inside a good JPEG: whatever it holds, the picture is read.
pub fn exif(bytes: &[u8]) {
    picture("a.jpg", &jpeg_with(0xe1, &[b"Exif\0\0", bytes].concat()));
}

/// An ICC profile inside a good JPEG.
pub fn icc(bytes: &[u8]) {
    picture("a.jpg", &jpeg_with(0xe2, &[b"ICC_PROFILE\0\x01\x01", bytes].concat()));
}

/// The smallest grey JPEG, 8 × 8, with a marker segment put in.
fn jpeg_with(marker: u8, content: &[u8]) -> Vec<u8> {
    let plain = include_bytes!("../corpus/jpeg/grey");
    let content = &content[..content.len().min(65_533)];
    let mut bytes = plain[..2].to_vec();
    bytes.extend([0xff, marker]);
    bytes.extend((content.len() as u16 + 2).to_be_bytes());
    bytes.extend(content);
    bytes.extend(&plain[2..]);
    bytes
}

/// Reads `bytes` as a file of that name in a folder of its own.
fn mesh(name: &str, bytes: &[u8], beside: Option<(&str, &str)>) {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let write = |name: &str, bytes: &[u8]| {
        fs::write(folder.path().join(name), bytes).expect("a temporary file can be written");
    };
    write(name, bytes);
    let path = folder.path().join(beside.map_or(name, |(name, _)| name));
    if let Some((name, text)) = beside {
        write(name, text.as_bytes());
    }
    let read = scene::read(&path);
    // As it moves, too: what can be broken at rest and played need not be the same.
    let played = scene::read_played(&path, None)
        .and_then(|model| [0.0, 0.75, 1e30].into_iter().try_fold(model, |m, time| m.at_time(time)));
    for result in [read, played] {
        judge(&path, result);
    }
}

/// Panics where a model breaks its promises, or an error does not name the file.
fn judge(path: &Path, result: Result<Model, SceneError>) {
    match result {
        Ok(model) => {
            for repeat in &model.repeats {
                assert!(repeat.mesh < model.meshes.len() && repeat.moved.is_finite());
            }
            for mesh in &model.meshes {
                assert!(mesh.positions.iter().all(|p| p.is_finite()));
                let n = mesh.positions.len();
                assert!(mesh.triangles.iter().flatten().all(|&i| (i as usize) < n));
                assert!(mesh.material < model.materials.len());
                for length in [mesh.normals.len(), mesh.uvs.len(), mesh.tangents.len()] {
                    assert!(length == 0 || length == n);
                }
            }
        }
        Err(error) => {
            let file = path.file_name().expect("the path was joined").to_string_lossy();
            assert!(error.to_string().contains(&*file), "{error}");
        }
    }
}

pub fn gltf(bytes: &[u8]) {
    mesh("a.gltf", bytes, None);
}

pub fn glb(bytes: &[u8]) {
    mesh("a.glb", bytes, None);
}

pub fn obj(bytes: &[u8]) {
    mesh("a.obj", bytes, None);
}

/// A material library used by a triangle.
pub fn mtl(bytes: &[u8]) {
    let object = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl m\nf 1 2 3\n";
    mesh("a.mtl", bytes, Some(("a.obj", object)));
}

pub fn shot(bytes: &[u8]) {
    let text = String::from_utf8_lossy(bytes);
    if let Err(error) = ShotFile::parse(Path::new("shots/a/shot.toml"), &text) {
        assert!(error.to_string().contains("shot.toml"), "{error}");
    }
}

/// `camera.json` and the lens files of other programs.
pub fn camera(bytes: &[u8]) {
    let text = String::from_utf8_lossy(bytes);
    if let Ok(read) = camera::file::parse(&text) {
        let lens = &read.camera.lens;
        assert!(lens.parameters().iter().all(|v| v.is_finite()) && lens.fx > 0.0 && lens.fy > 0.0);
        let (width, height) = (read.camera.width, read.camera.height);
        assert!(width > 0 && height > 0);
        // Whatever the coefficients, the search for each border pixel's direction ends.
        lens.covers(width, height);
    }
}

/// Lists of shutter times.
pub fn times(bytes: &[u8]) {
    let text = String::from_utf8_lossy(bytes);
    let photos = ["a.jpg".into(), "b.jpg".into()];
    if let Ok(times) = exposure::parse_times(&text, &photos) {
        assert!(times.len() == 2 && times.iter().all(|t| t.is_finite() && *t > 0.0));
    }
}
