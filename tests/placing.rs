//! Objects that stand where nobody would put them are told before any rendering, with the key.

mod program;
mod tiny;

use program::{platelight, text};
use tiny::{Plate, write_cube, write_shot};

/// What `check` says of an object with these keys (a cube of 20 cm that stands on the origin).
fn said(keys: &str) -> Vec<String> {
    said_of(keys, |shot| shot)
}

fn said_of(keys: &str, change: impl FnOnce(String) -> String) -> Vec<String> {
    let folder = tempfile::tempdir().expect("a folder");
    let cube = write_cube(folder.path(), 0.2);
    let shot = write_shot(folder.path(), Plate::Png8, &format!("{cube}{keys}"));
    let text_of = std::fs::read_to_string(&shot).expect("shot");
    std::fs::write(&shot, change(text_of)).expect("shot");
    let output = platelight(&["check", "--json", text(folder.path())]);
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let warnings = json["warnings"].as_array().expect("a list");
    warnings
        .iter()
        .filter(|w| w["about"].as_str().is_some_and(|about| about.starts_with("object[")))
        .map(|w| {
            format!(
                "{}: {}",
                w["about"].as_str().unwrap_or(""),
                w["message"].as_str().unwrap_or("")
            )
        })
        .collect()
}

#[test]
fn what_stands_well_is_not_told() {
    for keys in ["", "at = [0.1, 0.001, -0.2]\nrotate = [0, 33, 0]\n", "scale = 0.5\n"] {
        assert_eq!(said(keys), Vec::<String>::new(), "{keys}");
    }
}

#[test]
fn what_does_not_is_told_once_with_the_key_that_mends_it() {
    for (keys, expected) in [
        (
            "at = [0, 0.03, 0]\n",
            "object[0].at: cube hovers 3 cm above the support; to stand it there, set at = [0, 0, 0]",
        ),
        (
            "at = [0.1, -0.05, 0]\n",
            "object[0].at: cube sinks 5 cm into the support; to stand it there, set at = [0.1, 0, 0]",
        ),
        (
            "scale = 100\n",
            "object[0].scale: cube measures 20 m × 20 m × 20 m (X, Y, Z), far larger",
        ),
        (
            "scale = 0.01\n",
            "object[0].scale: cube measures 2 mm × 2 mm × 2 mm (X, Y, Z), far smaller",
        ),
        (
            "at = [0, 0, 4]\n",
            "object[0].at: cube is behind the camera, which stands at [0.00, 1.00, 1.00]",
        ),
        ("at = [1.7, 0, 0]\n", "object[0].at: cube is outside the frame"),
    ] {
        let said = said(keys);
        assert_eq!(said.len(), 1, "{keys}: {said:?}");
        assert!(said[0].starts_with(expected), "{keys}: {said:?}");
    }
    // Below the support and thus hidden by it.
    let buried = said("at = [0, -0.5, 0]\n");
    assert!(
        buried[0].contains("sinks 50 cm") && buried[1].contains("hidden by the support"),
        "{buried:?}"
    );
}

#[test]
fn a_thing_on_another_does_not_hover_and_a_mesh_is_a_support_too() {
    let second = "[[object]]\nfile = \"cube.obj\"\nscale = 0.5\nat = [0, 0.2, 0]\n";
    assert_eq!(said(second), Vec::<String>::new(), "a cube on a cube");
    let slope = |shot: String| shot.replace("plane = { size = [4.0, 4.0] }", "mesh = \"cube.obj\"");
    // The support is the cube itself, whose top is at 0.2 m.
    assert_eq!(said_of("scale = 0.5\nat = [0, 0.2, 0]\n", slope), Vec::<String>::new());
    let sunk = said_of("scale = 0.5\nat = [0, 0.15, 0]\n", slope);
    assert!(
        sunk[0].contains("sinks 5 cm into the support; to stand it there, set at = [0, 0.2, 0]"),
        "{sunk:?}"
    );
}

#[test]
fn check_and_run_say_the_same_of_every_kind_of_plate() {
    for plate in [Plate::ExrFloat, Plate::ExrHalf, Plate::Png16, Plate::Png8] {
        let folder = tempfile::tempdir().expect("a folder");
        let cube = write_cube(folder.path(), 0.2);
        write_shot(folder.path(), plate, &format!("{cube}at = [0, 0, 4]\n"));
        let of_objects = |command: &str| {
            let output = platelight(&[command, "--json", text(folder.path())]);
            let json: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
            let mut all = json["warnings"].as_array().expect("a list").clone();
            all.retain(|w| w["about"].as_str().is_some_and(|about| about.starts_with("object")));
            all
        };
        assert_eq!(of_objects("check").len(), 1);
        assert_eq!(of_objects("check"), of_objects("run"), "{plate:?}");
    }
}
