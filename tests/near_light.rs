//! Walls and lamps of a shot file: which are put in their place, which stay far away, and what is said.

mod program;
mod tiny;

use program::{platelight, text};
use serde_json::Value;
use tiny::{Plate, write_cube, write_shot};

/// What `check` finds of a shot with a cube and these keys; the probe stands in the origin.
fn found(plate: Plate, keys: &str) -> Value {
    let folder = tempfile::tempdir().expect("a folder");
    let cube = write_cube(folder.path(), 0.2);
    write_shot(folder.path(), plate, &format!("{cube}{keys}"));
    let output = platelight(&["check", "--json", text(folder.path())]);
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("JSON")
}

/// What `check` says of such a shot that it refuses.
fn refused(keys: &str) -> String {
    let folder = tempfile::tempdir().expect("a folder");
    let cube = write_cube(folder.path(), 0.2);
    write_shot(folder.path(), Plate::Png8, &format!("{cube}{keys}"));
    let output = platelight(&["check", text(folder.path())]);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{said}");
    said
}

/// The sentences about a key.
fn said(found: &Value, list: &str, about: &str) -> Vec<String> {
    let list = found[list].as_array().expect("a list");
    let own = list.iter().filter(|w| w["about"] == about);
    own.map(|w| w["message"].as_str().unwrap_or("").to_owned()).collect()
}

#[test]
fn near_walls_are_used_without_a_warning_and_far_ones_stay_far() {
    let near =
        found(Plate::Png8, "[surroundings]\nbox = { min = [-2, -0.7, -2], max = [2, 2, 2] }\n");
    assert!(
        near["lights"]["surroundings"].as_str().unwrap().starts_with("light lies on the walls")
    );
    assert!(said(&near, "warnings", "surroundings.box").is_empty());
    let far =
        found(Plate::Png16, "[surroundings]\nbox = { min = [-90, -1, -90], max = [90, 90, 90] }\n");
    assert!(far["lights"]["surroundings"].as_str().unwrap().starts_with("far enough"));
    assert!(said(&far, "warnings", "surroundings.box").is_empty());
    assert_eq!(said(&far, "notes", "surroundings.box").len(), 1);
}

#[test]
fn light_that_the_probe_cannot_have_seen_from_its_place_is_an_error() {
    let told = refused("[surroundings]\nbox = { min = [1, -1, -2], max = [4, 2, 2] }\n");
    let wanted = "surroundings.box: the probe stands at (0.00, 0.00, 0.00) m, outside the box";
    assert!(told.contains(wanted) && told.contains("correct the box"), "{told}");
    let told = refused("[[lamp]]\nat = [0.1, 0.1, 0]\nradius = 0.2\n");
    assert!(told.contains("lamp[0]: the probe stands inside this lamp; correct"), "{told}");
}

#[test]
fn tables_in_the_wrong_form_are_told_with_the_right_one() {
    for (keys, wanted) in [
        (
            "[lamp]\nat = [0.5, 0.8, 0]\nradius = 0.1\n",
            "lamp: expected a list of tables, found a table; write [[lamp]]",
        ),
        (
            "[[surroundings]]\nbox = { min = [-1, -1, -1], max = [1, 1, 1] }\n",
            "write [surroundings], in single brackets",
        ),
        ("[surroundings]\nbox = [[-1, -1, -1], [1, 1, 1]]\n", "write box = { min = …, max = … }"),
        (
            "[surroundings]\nbox = { min = [-1, 2, -1], max = [1, 1, 1] }\n",
            "along y (2 and 1); min is the corner",
        ),
        (
            "[[lamp]]\nat = [0.5, 0.8, 0]\nradius = 0.1\n[[lamp]]\nat = [0.5, 0.85, 0]\nradius = 0.02\n",
            "lamp[1].at: is inside lamp[0]",
        ),
    ] {
        let told = refused(keys);
        assert!(told.contains(wanted), "{keys}: {told}");
    }
}

#[test]
fn a_lamp_behind_the_walls_is_told() {
    let lamp = "[surroundings]\nbox = { min = [-2, -1, -2], max = [2, 2, 2] }\n[[lamp]]\nat = [3, 1, 0]\nradius = 0.1\n";
    let told = said(&found(Plate::Png8, lamp), "warnings", "lamp[0]");
    assert!(told[0].contains("outside the box of [surroundings]"), "{told:?}");
}

#[test]
fn lamps_are_put_in_their_place_or_told_why_not() {
    // The panorama's bright quarter lies round longitude 112°, latitude 56°.
    let lamp = |at: &str, radius: f64| {
        found(Plate::ExrFloat, &format!("[[lamp]]\nat = {at}\nradius = {radius}\n"))
    };
    let there = lamp("[0.52, 0.83, -0.21]", 0.35);
    assert!(
        there["lights"]["lamps"][0]["treated"].as_str().unwrap().starts_with("put in its place")
    );
    assert!(there["lights"]["lamps"][0]["radiance"][0].as_f64().unwrap() > 2.0, "{there}");
    let off = lamp("[-0.5, 0.8, 0.2]", 0.1);
    let told = said(&off, "warnings", "lamp[0]");
    assert!(told[0].contains("nothing brighter than its surroundings"), "{told:?}");
    let far = lamp("[30, 40, 0]", 0.5);
    assert_eq!(said(&far, "notes", "lamp[0]").len(), 1);
    assert!(said(&far, "warnings", "lamp[0]").is_empty());
}
