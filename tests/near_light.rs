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
    let beside =
        found(Plate::ExrHalf, "[surroundings]\nbox = { min = [1, -1, -2], max = [4, 2, 2] }\n");
    let told = said(&beside, "warnings", "surroundings.box");
    assert!(told[0].contains("the probe stands outside the box"), "{told:?}");
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
