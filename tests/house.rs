//! The order of the rooms: a room uses only rooms above it in `lib.rs`, and only `shot` and `cli`
//! know the crate that knows OpenCV.

use std::path::{Path, PathBuf};

fn source_root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("src")
}

/// The rooms in the order in which the head of `lib.rs` lists them: `//! - [`photo`]: …`. (The
/// `pub mod` lines are in the alphabet's order, by rustfmt.)
fn rooms() -> Vec<String> {
    let lib = std::fs::read_to_string(source_root().join("lib.rs")).expect("lib.rs is there");
    let listed = |line: &str| Some(line.strip_prefix("//! - [`")?.split_once('`')?.0.to_owned());
    lib.lines().filter_map(listed).collect()
}

/// All Rust files of a room.
fn files(room: &str) -> Vec<PathBuf> {
    let single = source_root().join(format!("{room}.rs"));
    if single.is_file() {
        return vec![single];
    }
    let mut found = Vec::new();
    let mut folders = vec![source_root().join(room)];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).expect("the room's folder is there") {
            let path = entry.expect("a readable folder").path();
            match path.extension() {
                _ if path.is_dir() => folders.push(path),
                Some(extension) if extension == "rs" => found.push(path),
                _ => {}
            }
        }
    }
    found
}

/// The file's code, without comments.
fn code(path: &Path) -> String {
    let text = std::fs::read_to_string(path).expect("a readable file");
    text.lines().map(|line| line.split("//").next().unwrap_or("")).collect::<Vec<_>>().join("\n")
}

/// How many modules deep a file is: 1 for `src/photo/mod.rs`, 2 for `src/photo/png.rs`.
fn depth(file: &Path) -> usize {
    let inside = file.strip_prefix(source_root()).expect("a file of src");
    inside.components().count() - usize::from(inside.ends_with("mod.rs"))
}

/// The first names behind every path that begins at the crate's root, also in groups:
/// `crate::{photo::Image, render}`, and `super::super::camera` in a file two modules deep.
fn rooms_named(code: &str, depth: usize) -> Vec<String> {
    let mut names = Vec::new();
    for (at, _) in code.match_indices("super::") {
        // Each chain once, at its beginning.
        if code[..at].ends_with("super::") || code[..at].ends_with(|c: char| c.is_alphanumeric()) {
            continue;
        }
        let rest = code[at..].trim_start_matches("super::");
        let steps = (code.len() - at - rest.len()) / "super::".len();
        // Tests stand at the foot of a file, one module deeper.
        if steps != depth + usize::from(code[..at].contains("mod tests {")) {
            continue;
        }
        match rest.strip_prefix('{') {
            Some(group) => names.extend(group_heads(group)),
            None => names.push(first_name(rest)),
        }
    }
    for (at, _) in code.match_indices("crate::") {
        // `platelight_crate::` and the like are other names.
        if code[..at].ends_with(|c: char| c.is_alphanumeric() || c == '_') {
            continue;
        }
        let rest = &code[at + "crate::".len()..];
        match rest.strip_prefix('{') {
            Some(group) => names.extend(group_heads(group)),
            None => names.push(first_name(rest)),
        }
    }
    names
}

fn first_name(text: &str) -> String {
    text.trim_start().chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect()
}

/// First names of the members of a group whose opening brace is just before `text`.
fn group_heads(text: &str) -> Vec<String> {
    let mut heads = vec![first_name(text)];
    let mut depth = 1;
    for (at, c) in text.char_indices() {
        match c {
            '{' => depth += 1,
            '}' => depth -= 1,
            ',' if depth == 1 => heads.push(first_name(&text[at + 1..])),
            _ => {}
        }
        if depth == 0 {
            break;
        }
    }
    // What follows a last comma is no name.
    heads.retain(|head| !head.is_empty());
    heads
}

#[test]
fn paths_are_found_alone_and_in_groups() {
    let code = "use crate::photo::Image;\nuse crate::{\n  bracket::{A, B},\n  camera,\n};\ncrate::render::x()";
    assert_eq!(rooms_named(code, 2), ["photo", "bracket", "camera", "render"]);
    assert!(rooms_named("other_crate::photo::x", 2).is_empty());
}

#[test]
fn chains_of_super_that_leave_the_room_are_followed() {
    let code = "use super::super::{render, cli::x};\nuse super::lens::Lens;\nmod tests {\n use \
                super::super::lens;\n use super::super::super::shot::plan;\n}";
    assert_eq!(rooms_named(code, 2), ["render", "cli", "shot"]);
    assert_eq!(depth(&source_root().join("photo/mod.rs")), 1);
    assert_eq!(depth(&source_root().join("shot/detect/with_calib.rs")), 3);
}

#[test]
fn a_room_uses_only_rooms_above_it() {
    let rooms = rooms();
    assert_eq!(rooms.first().map(String::as_str), Some("conventions"));
    assert_eq!(rooms.last().map(String::as_str), Some("cli"));
    let mut wrong = Vec::new();
    for (place, room) in rooms.iter().enumerate() {
        for file in files(room) {
            for name in rooms_named(&code(&file), depth(&file)) {
                if rooms.iter().position(|room| *room == name).is_some_and(|other| other > place) {
                    wrong.push(format!("{} uses {name}, which is below {room}", file.display()));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn only_shot_and_cli_know_the_calibration_crate_and_nobody_knows_opencv() {
    for room in rooms() {
        for file in files(&room) {
            let code = code(&file);
            let may = room == "shot" || room == "cli";
            assert!(may || !code.contains("platelight_calib"), "{} names it", file.display());
            assert!(!code.contains("opencv::"), "{} names OpenCV", file.display());
        }
    }
}

#[test]
fn every_room_is_a_room_of_the_list() {
    let rooms = rooms();
    for entry in std::fs::read_dir(source_root()).expect("src is there") {
        let path = entry.expect("a readable folder").path();
        let name =
            path.file_stem().and_then(|name| name.to_str()).expect("a plain name").to_owned();
        let known = rooms.contains(&name) || name == "lib" || name == "main";
        assert!(known, "src/{name} is not in lib.rs");
    }
}
