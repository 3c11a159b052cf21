//! Nothing that is read is ever written over, and nothing odd is taken for a whole picture.

mod program;
mod tiny;

use std::fs;
use std::path::Path;

use program::{platelight, text};
use tiny::{Plate, write_cube, write_shot};

/// Runs, and holds that it is refused with `sentence` and that `file` stays as it was.
fn assert_refused(arguments: &[&str], file: &Path, sentence: &str) {
    let before = fs::read(file).expect("the file is there");
    let output = platelight(arguments);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{arguments:?}: {said}");
    assert!(said.contains(sentence), "{said}");
    assert!(fs::read(file).expect("the file is there") == before, "{arguments:?} changed a file");
}

#[test]
fn a_run_into_its_own_folder_keeps_camera_and_panorama() {
    for plate in [Plate::ExrFloat, Plate::ExrHalf, Plate::Png16, Plate::Png8] {
        let folder = tempfile::tempdir().unwrap();
        let object = write_cube(folder.path(), 0.2);
        let shot = write_shot(folder.path(), plate, &object);
        let arguments = ["run", text(&shot), "--out", text(folder.path())];
        for file in ["camera.json", "panorama.exr"] {
            assert_refused(&arguments, &folder.path().join(file), "would be overwritten");
        }
    }
}

#[cfg(unix)]
#[test]
fn a_link_to_an_input_in_the_folder_of_results_keeps_the_input() {
    let folder = tempfile::tempdir().unwrap();
    let object = write_cube(folder.path(), 0.2);
    let shot = write_shot(folder.path(), Plate::Png8, &object);
    let (plate, out) = (folder.path().join("plate.png"), folder.path().join("out"));
    fs::create_dir(&out).unwrap();
    for (command, result) in [("run", "composite.png"), ("chart", "chart.png")] {
        let link = out.join(result);
        std::os::unix::fs::symlink(&plate, &link).unwrap();
        let arguments = [command, text(&shot), "--out", text(&out)];
        assert_refused(&arguments, &plate, "would be overwritten");
        fs::remove_file(&link).unwrap();
    }
}

#[test]
fn no_command_writes_over_what_it_reads() {
    let folder = tempfile::tempdir().unwrap();
    write_shot(folder.path(), Plate::Png8, "");
    let (plate, panorama) = (folder.path().join("plate.png"), folder.path().join("panorama.exr"));
    let (p, e) = (text(&plate), text(&panorama));
    let other = folder.path().join("other.exr");
    let o = text(&other);
    assert_refused(&["preview", p, "--out", p], &plate, "would be overwritten");
    assert_refused(&["merge", p, "--times", "1", "--out", p], &plate, "would be overwritten");
    assert_refused(&["panorama", e, "--lat-long", "--out", e], &panorama, "would be overwritten");
    let twice = ["panorama", e, "--lat-long", "--out", o, "--preview", o];
    assert_refused(&twice, &panorama, "named twice");
    assert!(!other.exists());

    // What is read beside the pictures: a lens, the empty place, a list of times.
    let camera = folder.path().join("camera.json");
    let times = folder.path().join("times.exr");
    fs::write(&times, "1\n").unwrap();
    // The same file, spelled in another way.
    let roundabout = folder.path().join("../").join(folder.path().file_name().unwrap());
    let (c, t, r) = (text(&camera), text(&times), roundabout.join("camera.json"));
    let tag = ["locate", p, "--camera", c, "--tag", "1", "--size-mm", "50", "--out", text(&r)];
    assert_refused(&tag, &camera, "would be overwritten");
    let ball = ["panorama", p, "--ball", "--focal-px", "60", "--clean-plate", e, "--out", e];
    assert_refused(&ball, &panorama, "would be overwritten");
    let merge = ["merge", p, p, "--times-file", t, "--out", t];
    assert_refused(&merge, &times, "would be overwritten");
    let new = roundabout.join("other.exr");
    let twice = ["panorama", e, "--lat-long", "--out", o, "--preview", text(&new)];
    assert_refused(&twice, &panorama, "named twice");
}

#[test]
fn half_a_jpeg_is_damaged() {
    let folder = tempfile::tempdir().unwrap();
    let whole = Path::new(env!("CARGO_MANIFEST_DIR")).join("plates/demo/tag.jpg");
    let bytes = fs::read(whole).unwrap();
    let half = folder.path().join("half.jpg");
    fs::write(&half, &bytes[..bytes.len() / 2]).unwrap();
    let out = folder.path().join("out.png");
    let arguments = ["preview", text(&half), "--out", text(&out)];
    assert_refused(&arguments, &half, "ends before the picture does");
    assert!(!out.exists());
}
