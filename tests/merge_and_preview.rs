//! `platelight merge` and `platelight preview` as a user runs them.

mod program;

use std::fs;
use std::path::{Path, PathBuf};

use platelight::bracket;
use platelight::photo::{
    self, Encoding, EncodingSource, Primaries, ReadOptions, Samples, Transfer, colour, png,
};
use program::{platelight, text};

/// A ramp of light photographed at three times; PNG, exact sRGB, without noise.
fn bracket_in(folder: &Path) -> Vec<PathBuf> {
    let encoding = Encoding {
        transfer: Transfer::Srgb,
        primaries: Primaries::Rec709,
        source: EncodingSource::Named,
    };
    [0.25f32, 1.0, 4.0]
        .iter()
        .enumerate()
        .map(|(k, time)| {
            let code = |i: usize| {
                let l = (i % 64) as f32 / 64.0 * time;
                (colour::srgb_encode(l.min(1.0)) * 255.0).round() as u8
            };
            let data = (0..64 * 48).flat_map(|i| [code(i); 3]).collect();
            let path = folder.join(format!("b{k}.png"));
            png::write(&path, &Samples::U8 { channels: 3, data }, 64, 48, &encoding).unwrap();
            path
        })
        .collect()
}

#[test]
fn a_bracket_becomes_radiance_and_a_picture_of_it() {
    let folder = tempfile::tempdir().unwrap();
    let photos = bracket_in(folder.path());
    let out = folder.path().join("merged.exr");
    let mut arguments = vec!["merge", "--json", "--times", "1/4,1,4", "--out", text(&out)];
    arguments.extend(photos.iter().map(|p| text(p)));
    let output = platelight(&arguments);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let summary: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(summary["frames"].as_array().unwrap().len(), 3);
    let radiance = bracket::file::read(&out).unwrap();
    // Column 40: light 40/64, clipped in the longest frame only; half a code of 8 bits is 0.4 %.
    assert!((radiance.mean[(40, 20)].x / (40.0 / 64.0) - 1.0).abs() < 0.01);

    // Any number of threads writes the same bytes.
    let again = folder.path().join("again.exr");
    arguments[5] = text(&again);
    arguments.extend(["--threads", "1"]);
    assert!(platelight(&arguments).status.success());
    assert!(fs::read(&out).unwrap() == fs::read(&again).unwrap());

    let png = folder.path().join("merged.png");
    let output = platelight(&["preview", text(&out), "--exposure", "-1", "--out", text(&png)]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let shown = photo::read(&png, &ReadOptions::default()).unwrap();
    assert!((shown.linear[(40, 20)].x / (20.0 / 64.0) - 1.0).abs() < 0.02);
}

#[test]
fn a_folder_becomes_one_picture_for_each_bracket_and_a_bad_one_stops_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let photos = folder.path().join("photos");
    fs::create_dir(&photos).unwrap();
    bracket_in(&photos);
    for k in 0..3 {
        fs::copy(photos.join(format!("b{k}.png")), photos.join(format!("c{k}.png"))).unwrap();
    }
    fs::write(photos.join("notes.txt"), "not a photograph").unwrap();
    let out = folder.path().join("merged");
    let arguments =
        ["merge", text(&photos), "--group", "3", "--times", "1/4,1,4", "--out", text(&out)];
    let output = platelight(&arguments);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.contains("bracket of 3: c0.png c1.png c2.png"), "{said}");
    assert_eq!(fs::read(out.join("b0.exr")).unwrap(), fs::read(out.join("c0.exr")).unwrap());

    // One bracket cut short: the other is merged, and the exit code tells.
    let whole = fs::read(photos.join("c1.png")).unwrap();
    fs::write(photos.join("c1.png"), &whole[..whole.len() / 2]).unwrap();
    fs::remove_dir_all(&out).unwrap();
    let output = platelight(&arguments);
    assert_eq!(output.status.code(), Some(1), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(String::from_utf8_lossy(&output.stderr).contains("c1.png"));
    assert!(out.join("b0.exr").exists() && !out.join("c0.exr").exists());

    // Without exposures nobody can tell the brackets apart; four do not divide six.
    for (extra, word) in [(vec![], "exposure time"), (vec!["--group", "4"], "6 photographs")] {
        let out = folder.path().join("nothing");
        let mut arguments = vec!["merge", text(&photos), "--out", text(&out)];
        arguments.extend(extra);
        let output = platelight(&arguments);
        assert_eq!(output.status.code(), Some(2));
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(said.contains(word) && !out.exists(), "{said}");
    }
}

#[test]
fn wrong_requests_exit_with_2_name_the_file_and_write_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let photos = bracket_in(folder.path());
    let (out, png) = (folder.path().join("out.exr"), folder.path().join("out.png"));
    let missing = folder.path().join("missing.png");
    for (arguments, word) in [
        // No EXIF and no times.
        (vec!["merge", text(&photos[0]), text(&photos[1]), "--out", text(&out)], "--times"),
        (vec!["merge", text(&photos[0]), text(&missing), "--out", text(&out)], "missing.png"),
        (vec!["merge", text(&photos[0]), "--times", "1,2", "--out", text(&out)], "2 times"),
        (vec!["merge", text(&photos[0]), "--times", "0", "--out", text(&out)], "1/60"),
        (vec!["preview", text(&missing), "--out", text(&png)], "missing.png"),
        (vec!["preview", text(&photos[0]), "--exposure", "lots", "--out", text(&png)], "auto"),
        (vec!["preview", text(&photos[0]), "--layer", "depth", "--out", text(&png)], "depth"),
        (vec!["preview", text(&photos[0]), "--colour", "sRBG", "--out", text(&png)], "acescg"),
    ] {
        let output = platelight(&arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(said.contains(word), "{arguments:?}: {said}");
        assert!(!out.exists() && !png.exists(), "{arguments:?} wrote something");
    }
}
