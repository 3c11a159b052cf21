//! The program as a person meets it: help, exit codes, messages, and nothing written on an error.

#[cfg(unix)]
mod interrupted;
mod program;
mod tiny;

use std::path::{Path, PathBuf};
use std::process::Output;

use platelight::camera::{Camera, Lens, Pose, file};
use platelight::conventions::Rgb;
use platelight::photo::Image;
use platelight::photo::exr_file::{self, ExrPicture, ExrSamples};
use platelight::probe::file::rotation_xyz_deg;
use platelight::shot::ShotFile;
use program::{platelight, text};
use tiny::{Plate, write_shot};

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn stdout(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// Names of all commands, from the program's own help.
fn commands() -> Vec<String> {
    let help = stdout(&platelight(&["--help"]));
    let list = help.split("Commands:").nth(1).expect("help lists commands");
    list.lines()
        .skip(1)
        .take_while(|line| line.starts_with("  "))
        .filter(|line| !line.starts_with("   "))
        .filter_map(|line| line.split_whitespace().next().map(str::to_owned))
        .filter(|name| name != "help")
        .collect()
}

#[test]
fn a_reader_that_went_away_is_no_crash() {
    let program = assert_cmd::cargo::cargo_bin("platelight");
    let mut child = std::process::Command::new(program)
        .args(["--json", "check", "no/such/shot"])
        .stdout(std::process::Stdio::piped())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .expect("the program starts");
    drop(child.stdout.take());
    let output = child.wait_with_output().expect("the program ends");
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(said.contains("no/such/shot") && !said.contains("panicked"), "{said}");
}

#[test]
fn a_panorama_s_arguments_are_judged_before_anything_is_read() {
    let out = ["-o", "never.exr"];
    for (arguments, told) in [
        (vec!["a.hdr", "--lat-long", "--width", "64"], "--width"),
        (vec!["a.hdr", "--angular", "--times", "1"], "--times"),
        (vec!["a.jpg", "--ball", "--reflectance", "0.5,0.5"], "--reflectance"),
        (vec!["a.jpg", "--ball", "--reflectance", "7"], "reflectance"),
        (vec!["a.jpg", "--ball", "--hint", "1,2"], "--hint"),
        (vec!["a.jpg", "--ball", "--camera", "c.json", "--crop", "1,2,0"], "--crop"),
        (vec!["a.hdr", "--cube", "--colour", "sRBG"], "sRBG"),
        (vec!["a.jpg", "--fisheye", "equidistant", "--times", "x"], "\"x\""),
        (vec!["a.exr", "--merge"], "two or more"),
        (vec!["a.exr", "a.exr", "--merge"], "named twice"),
        (vec!["a.exr", "b.exr", "--merge", "--width", "64"], "--width"),
        (vec!["a.exr", "b.exr", "--merge", "--photographer", "120"], "--photographer"),
        (vec!["a.exr", "b.exr", "--merge", "--match", "1,2,3"], "each match takes four"),
        (vec!["a.exr", "--lat-long", "--match", "1,2,3,4"], "--merge"),
        (vec!["a.exr", "--lat-long", "--radius", "0.1"], "--radius is for --ball"),
        (vec!["a.jpg", "--fisheye", "equidistant", "--hint", "1,2,3"], "--hint is for --ball"),
        (vec!["a.jpg", "--ball", "--circle", "1,2,3"], "--circle is for --fisheye"),
    ] {
        let all = [&["panorama"], arguments.as_slice(), &out].concat();
        let output = platelight(&all);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        let said = stderr(&output);
        assert!(said.contains(told) && !said.contains("cannot be read"), "{arguments:?}: {said}");
    }
}

#[test]
fn a_ball_in_a_cut_out_is_unwrapped_once_its_place_in_the_frame_is_said() {
    let folder = tempfile::tempdir().expect("a folder");
    let camera = folder.path().join("camera.json");
    let lens = Lens::pinhole(1180.0, 1080, 720);
    let whole = Camera { width: 1080, height: 720, lens, pose: Pose::identity() };
    file::write(&camera, &whole, false).expect("camera.json");
    let ball = Path::new(env!("CARGO_MANIFEST_DIR")).join("plates/demo/ball_b3.jpg");
    let out = folder.path().join("panorama.exr");
    let arguments =
        ["panorama", text(&ball), "--ball", "--camera", text(&camera), "-o", text(&out)];
    let said = stderr(&platelight(&arguments));
    assert!(said.contains("600 × 600 px") && said.contains("--crop"), "{said}");
    let crop = ["--crop", "1260,661,3", "--width", "128", "--json"];
    let output = platelight(&[&arguments[..], &crop].concat());
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let inliers = json["ball"]["inliers"].as_f64().expect("a share");
    assert!(inliers > 0.8, "the rim fits a cone through this part of the lens: {json}");
    // A place that is none in this frame
    for outside in ["-10,661,3", "2700,661,3", "1260,661,1"] {
        let output = platelight(&[&arguments[..], &["--crop", outside]].concat());
        let said = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{outside}: {said}");
        assert!(said.contains("--crop") && said.contains("1080 × 720 px"), "{outside}: {said}");
    }
}

#[test]
fn two_panoramas_in_different_axes_are_merged_in_the_first_one_s() {
    let folder = tempfile::tempdir().expect("a folder");
    let name = |name: &str| folder.path().join(name).display().to_string();
    let camera = folder.path().join("camera.json");
    let lens = Lens::pinhole(1180.0, 1080, 720);
    let whole = Camera { width: 1080, height: 720, lens, pose: Pose::identity() };
    file::write(&camera, &whole, false).expect("camera.json");
    let ball = Path::new(env!("CARGO_MANIFEST_DIR")).join("plates/demo/ball_b3.jpg");
    let (one, other, both) = (name("one.exr"), name("other.exr"), name("both.exr"));
    for (out, rotation) in [(&one, "0,0,0"), (&other, "20,70,-10")] {
        let crop = ["--camera", text(&camera), "--crop", "1260,661,3", "--width", "256"];
        let ball = ["panorama", text(&ball), "--ball", "--rotation", rotation, "-o", out];
        let output = platelight(&[&ball[..], &crop].concat());
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    }
    let output = platelight(&["--json", "panorama", &one, &other, "--merge", "-o", &both]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let angles = json["merged"]["views"][1]["rotation_deg"].as_array().expect("three angles");
    let angles: Vec<f64> = angles.iter().filter_map(serde_json::Value::as_f64).collect();
    let turn = |degrees: &[f64]| rotation_xyz_deg([degrees[0], degrees[1], degrees[2]]);
    let left = (turn(&angles) * turn(&[20.0, 70.0, -10.0])).to_axis_angle().1.to_degrees();
    assert!(left.min(360.0 - left) < 0.2, "{left}° from the first one's axes: {json}");
    // One photograph twice: what it does not show nobody shows, and the light is its own.
    let seen: Vec<f64> = (0..3).filter_map(|n| json["merged"]["seen_by"][n].as_f64()).collect();
    assert!(seen[0] > 0.0 && seen[0] < 0.05 && seen[2] > 0.9, "{seen:?}");
    let gain = json["merged"]["views"][1]["gain"][1].as_f64().expect("a number");
    assert!((gain - 1.0).abs() < 0.01, "gain {gain}");
}

#[test]
fn every_command_explains_itself_with_an_example() {
    let commands = commands();
    for expected in ["run", "check", "batch"] {
        assert!(commands.iter().any(|name| name == expected), "no {expected} in {commands:?}");
    }
    for command in commands {
        let output = platelight(&[&command, "--help"]);
        assert_eq!(output.status.code(), Some(0));
        let help = stdout(&output);
        assert!(help.contains("Example"), "{command} --help has no example");
        assert!(
            help.contains(&format!("platelight {command}")),
            "{command}'s example is another's"
        );
    }
}

#[test]
fn wrong_usage_is_exit_code_2() {
    for arguments in [
        &["rnu"][..],
        &["run"],
        &["check", "nowhere/shot.toml"],
        &["batch", "nowhere"],
        &["--threads", "0", "check", "nowhere"],
        &["--threads", "10000", "check", "nowhere"],
        &["run", "nowhere", "--error", "-1"],
    ] {
        let output = platelight(arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        assert!(output.stdout.is_empty() && !output.stderr.is_empty(), "{arguments:?}");
    }
}

#[test]
fn meshes_that_show_nothing_and_plates_without_a_picture_are_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = |name: &str| folder.path().join(name);
    let objects = "[[object]]\nfile = \"points.obj\"\n[[object]]\nfile = \"renamed.obj\"\n";
    let shot = write_shot(folder.path(), Plate::Png8, objects);
    std::fs::write(file("points.obj"), "v 0 0 0\nv 1 0 0\np 1 2\n").expect("points");
    std::fs::write(file("renamed.obj"), b"glTF\x02\0\0\0\0\0\0\0").expect("a binary");
    // Three channels of NaN.
    let nan = Image::filled(tiny::WIDTH, tiny::HEIGHT, Rgb::splat(f32::NAN));
    let channel = || ExrSamples::F32(nan.pixels().iter().map(|l| l.x).collect());
    let mut picture =
        ExrPicture { width: nan.width(), height: nan.height(), ..ExrPicture::default() };
    for name in ["R", "G", "B"] {
        picture.push(name, channel());
    }
    exr_file::write(&file("nan.exr"), &picture).expect("a plate");
    let text_of = std::fs::read_to_string(&shot).expect("shot").replace("plate.png", "nan.exr");
    std::fs::write(&shot, text_of).expect("shot");
    let output = platelight(&["check", text(folder.path())]);
    assert_eq!(output.status.code(), Some(2));
    let said = stderr(&output);
    for told in [
        "object[0].file: ",
        "holds no triangles",
        "renamed.obj: its first bytes: it is a binary glTF file; name it .glb",
        "nan.exr: every pixel is NaN or infinite",
    ] {
        assert!(said.contains(told), "{told} is not in:\n{said}");
    }
}

#[test]
fn a_lens_that_nobody_builds_and_text_of_another_encoding_are_refused_by_file() {
    let folder = tempfile::tempdir().expect("a folder");
    let shot = write_shot(folder.path(), Plate::Png8, "");
    let camera = folder.path().join("camera.json");
    let good = std::fs::read_to_string(&camera).expect("camera.json");
    let far = good.replace("\"fx\": 60.0", "\"fx\": 1e9").replace("\"fy\": 60.0", "\"fy\": 1e9");
    assert_ne!(far, good);
    std::fs::write(&camera, far).expect("camera.json");
    let output = platelight(&["check", text(folder.path())]);
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(said.contains("camera.json") && said.contains("would span"), "{said}");

    let units = std::fs::read_to_string(&shot).expect("shot");
    let utf16: Vec<u8> =
        [0xfeff].into_iter().chain(units.encode_utf16()).flat_map(u16::to_le_bytes).collect();
    std::fs::write(&shot, utf16).expect("shot");
    let said = stderr(&platelight(&["check", text(folder.path())]));
    assert!(said.contains("shot.toml: it is UTF-16 text; save it as UTF-8"), "{said}");
}

#[test]
fn a_name_that_ends_in_another_format_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    write_shot(folder.path(), Plate::Png8, "");
    let (plate, jpg) = (folder.path().join("plate.png"), folder.path().join("p.jpg"));
    let (picture, preview) = (text(&plate), text(&jpg));
    for arguments in [
        &["merge", "a.png", "b.png", "-o", "m.png"][..],
        &["panorama", "a.hdr", "--angular", "-o", "p"],
        &["preview", picture, "-o", preview],
        &["preview", "no.png", "-o", preview],
    ] {
        let said = stderr(&platelight(arguments));
        assert!(said.contains("must end in .") && said.contains("name it"), "{said}");
    }
}

#[cfg(target_os = "linux")]
#[test]
fn a_place_that_takes_no_files_is_told_before_anything_is_read() {
    let folder = tempfile::tempdir().expect("a folder");
    write_shot(folder.path(), Plate::Png8, "");
    let shot = text(folder.path());
    let there = folder.path().join("plate.png");
    let (picture, file) = (text(&there), folder.path().join("plate.png/out"));
    // No process makes files in /proc, whoever it is.
    for arguments in [
        &["run", shot, "--out", "/proc/out"][..],
        &["run", shot, "--out", text(&file)],
        &["batch", shot, "--out", "/proc/out"],
        &["merge", "no.png", "no2.png", "-o", "/proc/a.exr"],
        &["panorama", "no.hdr", "--angular", "-o", "/proc/a.exr"],
        &["panorama", picture, "--lat-long", "-o", "a.exr", "--preview", "/proc/a.png"],
        &["calibrate", picture, "--corners", "9x6", "--square-mm", "25", "-o", "/proc/a.json"],
        &["preview", "no.png", "-o", "no/such/folder/a.png"],
        &["targets", "checkerboard", "-o", "/proc/a.pdf"],
    ] {
        let output = platelight(arguments);
        let said = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {said}");
        let told = ["/proc", "plate.png/out", "no/such/folder"];
        assert!(told.iter().any(|place| said.contains(place)), "{arguments:?}: {said}");
        assert!(!said.contains(".platelight-") && !said.contains("no.png: cannot"), "{said}");
    }
}

#[test]
fn a_folder_that_is_a_file_or_the_system_s_is_called_so() {
    let folder = tempfile::tempdir().expect("a folder");
    write_shot(folder.path(), Plate::Png8, "");
    let plate = folder.path().join("plate.png");
    let said = stderr(&platelight(&["run", text(folder.path()), "--out", text(&plate)]));
    assert!(said.contains("plate.png is a file, not a folder; choose another"), "{said}");
    #[cfg(target_os = "linux")]
    {
        let said = stderr(&platelight(&["run", text(folder.path()), "--out", "/proc/out"]));
        assert!(said.contains("the system lets nobody make files in /proc; choose"), "{said}");
    }
}

#[test]
fn when_to_stop_is_judged_alike_on_the_command_line_and_in_the_shot_file() {
    let folder = tempfile::tempdir().expect("a folder");
    let shot = write_shot(folder.path(), Plate::Png8, "");
    let text_of = std::fs::read_to_string(&shot).expect("shot");
    for (key, value, told) in [
        ("error", "-1", "-1 is no share of the plate; write one from"),
        ("error", "3", "3 is no share of the plate; write one from"),
        ("time", "0", "0 is no time; write seconds above 0"),
        ("time", "\"-5m\"", "\"-5m\" is no time; write seconds above 0"),
        ("samples", "0", "0 is no number of samples; write a whole number"),
        ("samples", "2.5", "2.5 is no number of samples; write a whole number"),
    ] {
        // A shell takes the quotes away, and a time of the command line is quoted as text.
        let plain = |text: &str| text.replace('"', "");
        for command in ["run", "batch"] {
            let option = plain(&format!("--{key}={value}"));
            let output = platelight(&[command, text(folder.path()), &option]);
            let said = plain(&stderr(&output));
            assert_eq!(output.status.code(), Some(2), "{said}");
            assert!(said.contains(&plain(&format!("--{key}: {told}"))), "{said}");
        }
        let wrong = text_of.replace("samples = 8", &format!("{key} = {value}"));
        std::fs::write(&shot, wrong).expect("shot");
        let said = stderr(&platelight(&["check", text(folder.path())]));
        assert!(said.contains(&format!("render.{key}: {told}")), "{said}");
        std::fs::write(&shot, &text_of).expect("shot");
    }
    // As people type them: a negative number is no option, and a unit is understood.
    let said = stderr(&platelight(&["run", "nowhere", "--error", "-1"]));
    assert!(said.contains("--error: -1 is no share"), "{said}");
    let said = stderr(&platelight(&["run", "nowhere", "--time", "60s"]));
    assert!(said.contains("nowhere") && !said.contains("--time"), "{said}");
}

#[test]
fn unknown_keys_name_file_line_and_the_nearest_key() {
    let folder = tempfile::tempdir().expect("a folder");
    let shot = write_shot(folder.path(), Plate::Png8, "");
    let misspelt = std::fs::read_to_string(&shot).expect("shot").replace("relative_", "relativ_");
    std::fs::write(&shot, misspelt).expect("shot");
    let output = platelight(&["run", text(folder.path())]);
    assert_eq!(output.status.code(), Some(2));
    let said = stderr(&output);
    let expected =
        "shot.toml:3: plate.relativ_exposure: unknown key; did you mean `plate.relative_exposure`?";
    assert!(said.contains(expected), "{said}");
    assert!(!folder.path().join("out").exists(), "something was written");
}

#[test]
fn missing_files_are_told_together_and_nothing_is_written() {
    let folder = tempfile::tempdir().expect("a folder");
    let objects = "[[object]]\nfile = \"robot.glb\"\n[[local]]\nfile = \"props.glb\"\n";
    write_shot(folder.path(), Plate::Png8, objects);
    for file in ["plate.png", "panorama.exr"] {
        std::fs::remove_file(folder.path().join(file)).expect("it was written");
    }
    for command in ["check", "run"] {
        let output = platelight(&[command, text(folder.path())]);
        assert_eq!(output.status.code(), Some(2));
        let said = stderr(&output);
        for (key, file) in [
            ("plate.file", "plate.png"),
            ("probe.panorama.file", "panorama.exr"),
            ("object[0].file", "robot.glb"),
            ("local[0].file", "props.glb"),
        ] {
            let named = said.lines().any(|line| {
                line.contains(key) && line.contains(file) && line.contains("does not exist")
            });
            assert!(named, "{key} {file} is not in:\n{said}");
        }
        assert!(!folder.path().join("out").exists(), "something was written");
    }
}

#[test]
fn wrong_keys_and_missing_files_are_told_together() {
    let folder = tempfile::tempdir().expect("a folder");
    let objects = "[[object]]\nfile = \"robot.glb\"\nscael = 2\n";
    let shot = write_shot(folder.path(), Plate::Png8, objects);
    std::fs::remove_file(folder.path().join("panorama.exr")).expect("it was written");
    let line = |key: &str| {
        let text = std::fs::read_to_string(&shot).expect("shot");
        1 + text.lines().position(|line| line.contains(key)).expect("a line")
    };
    for command in ["check", "run"] {
        let said = stderr(&platelight(&[command, text(folder.path())]));
        for expected in [
            "object[0].scael: unknown key; did you mean `object[0].scale`?".to_owned(),
            format!("shot.toml:{}: object[0].file: ", line("robot.glb")),
            format!("shot.toml:{}: probe.panorama.file: ", line("panorama.exr")),
        ] {
            assert!(said.contains(&expected), "{expected} is not in: {said}");
        }
        assert!(!said.contains("plate.png"), "{said}");
        assert_eq!(said.matches("does not exist").count(), 2, "{said}");
    }
}

#[test]
fn a_plate_that_stands_for_several_files_is_refused_with_their_names() {
    let folder = tempfile::tempdir().expect("a folder");
    let shot = write_shot(folder.path(), Plate::Png8, "");
    std::fs::copy(folder.path().join("plate.png"), folder.path().join("plate2.png")).expect("copy");
    let named = std::fs::read_to_string(&shot).expect("shot");
    std::fs::write(&shot, named.replace("plate.png", "pl*.png")).expect("shot");
    let output = platelight(&["run", text(folder.path())]);
    assert_eq!(output.status.code(), Some(2));
    let said = stderr(&output);
    for part in ["plate.file", "plate.png", "plate2.png", "2 files"] {
        assert!(said.contains(part), "{said}");
    }
    assert!(!folder.path().join("out").exists(), "something was written");
}

#[test]
fn a_plate_without_a_place_is_one_problem_not_a_second_one_of_the_ball() {
    let folder = tempfile::tempdir().expect("a folder");
    let shot = write_shot(folder.path(), Plate::Png8, "");
    // The board stands nowhere in the plate.
    let board = "board = { photo = \"plate.png\", kind = \"checkerboard\", corners = [9, 6], square_mm = 25.0, \
                 at = [0, 0, 0], facing = [0, 1, 0], up = [0, 0, -1] }";
    let ball = "ball = { photos = \"plate.png\", radius = 0.06, at = [0, 0.06, 0], \
                reflectance = [0.6, 0.6, 0.6] }";
    let named = std::fs::read_to_string(&shot).expect("shot");
    let named = named
        .replace("[pose]\nfile = \"camera.json\"", &format!("[pose]\n{board}"))
        .replace("panorama = { file = \"panorama.exr\" }", ball);
    std::fs::write(&shot, named).expect("shot");
    let output = platelight(&["check", text(folder.path())]);
    assert_eq!(output.status.code(), Some(2));
    let said = stderr(&output);
    assert!(said.contains("pose.board:") && !said.contains("no camera"), "{said}");
}

#[test]
fn errors_are_json_too_when_asked() {
    let output = platelight(&["check", "nowhere", "--json"]);
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON on stdout");
    assert!(json["errors"][0].as_str().expect("a sentence").contains("nowhere"));

    // Several problems of a text are several sentences.
    let folder = tempfile::tempdir().expect("a folder");
    let shot = write_shot(folder.path(), Plate::Png8, "[composite]\nmode = \"on\"\n");
    let text_of = std::fs::read_to_string(&shot).expect("shot").replace("size =", "siez =");
    std::fs::write(&shot, text_of).expect("shot");
    for command in ["check", "run", "batch"] {
        let output = platelight(&[command, text(folder.path()), "--json"]);
        let json: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
        let errors = json["errors"].as_array().expect("a list");
        let errors: Vec<&str> = errors.iter().filter_map(|error| error.as_str()).collect();
        assert_eq!(errors.len(), 2, "{command}: {errors:?}");
        assert!(errors[0].contains("did you mean `support.plane.size`?"), "{errors:?}");
        let known = "\"on\" is not known; write \"auto\" or \"additive\" or \"ratio\"";
        assert!(errors[1].contains(known), "{errors:?}");
    }
}

#[test]
fn the_truth_shots_are_understood_as_they_are() {
    let shared = std::env::var("PLATELIGHT_SHARED")
        .map_or_else(|_| Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared"), PathBuf::from);
    for scene in ["overcast-soft", "outdoor-sun", "indoor-window"] {
        let shot = shared.join("truth").join(scene).join("shot.toml");
        if !shot.is_file() {
            eprintln!("{} is not here; skipped", shot.display());
            return;
        }
        let file = ShotFile::read(&shot).expect("the shot file is given and fixed");
        assert_eq!(file.objects.len(), 1);
    }
}
