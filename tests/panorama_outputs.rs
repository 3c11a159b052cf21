//! `platelight panorama --from … --to …` as a user runs it, and what it writes beside the panorama.

mod program;

use std::path::Path;

use glam::{DQuat, DVec2, DVec3};
use platelight::camera::{Camera, Distortion, Lens, Pose, file as camera_file};
use platelight::conventions::{Rgb, lat_long_direction};
use platelight::photo::{self, Image, ReadOptions};
use platelight::probe::Panorama;
use platelight::probe::file::{self, Layout};
use platelight::probe::lens_picture::LensPicture;
use platelight::probe::mapping::Mapping;
use program::{platelight, text};

/// Smooth light that is another one in every direction.
fn light(d: DVec3) -> Rgb {
    Rgb::new(2.0 + d.x as f32, 2.0 + d.y as f32, 2.0 + d.z as f32)
}

fn written(folder: &Path) -> std::path::PathBuf {
    let at = |x: usize, y: usize| lat_long_direction(DVec2::new(x as f64, y as f64), 256, 128);
    let panorama = Panorama::from_radiance(Image::from_fn(256, 128, |x, y| light(at(x, y))));
    let path = folder.join("world.exr");
    file::write(&path, &panorama).unwrap();
    path
}

fn succeeds(arguments: &[&str]) -> serde_json::Value {
    let output = platelight(&[arguments, &["--json"]].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

fn check(path: &Path, tolerance: f32) {
    let options = ReadOptions::default();
    let layout = Layout::named("latlong").unwrap();
    let read = file::read(path, layout, DQuat::IDENTITY, None, &options).unwrap().panorama;
    for d in [DVec3::X, DVec3::NEG_Z, DVec3::new(0.3, 0.8, 0.5), DVec3::new(-0.6, -0.4, 0.2)] {
        let d = d.normalize();
        let off = (read.radiance(d) - light(d)).abs().max_element();
        assert!(off < tolerance, "{}: {d}: {} for {}", path.display(), read.radiance(d), light(d));
    }
}

#[test]
fn a_panorama_comes_back_from_every_mapping() {
    let folder = tempfile::tempdir().unwrap();
    let world = written(folder.path());
    let there = folder.path().join("there.exr");
    let back = folder.path().join("back.exr");
    for mapping in [
        "latlong:pbrt-v3",
        "angular",
        "sphere",
        "cube-vertical",
        "cube-strip:opengl",
        "cube-column",
    ] {
        let said = succeeds(&[
            "panorama",
            text(&world),
            "--lat-long",
            "--to",
            mapping,
            "-o",
            text(&there),
        ]);
        assert_eq!(said["mapping"], mapping);
        succeeds(&["panorama", text(&there), "--from", mapping, "-o", text(&back)]);
        check(&back, 0.03);
    }
}

#[test]
fn six_faces_and_radiance_hdr_come_back() {
    let folder = tempfile::tempdir().unwrap();
    let world = written(folder.path());
    let out = folder.path().join("sky.hdr");
    let arguments = ["--lat-long", "--to", "cube-faces:opengl", "--size", "96", "-o", text(&out)];
    let said = succeeds(&[&["panorama", text(&world)], &arguments[..]].concat());
    assert!(said["out"].as_str().unwrap().ends_with("sky_px.hdr"));
    let faces: Vec<_> = ["px", "nx", "py", "ny", "pz", "nz"]
        .map(|face| folder.path().join(format!("sky_{face}.hdr")))
        .into();
    let back = folder.path().join("back.exr");
    let mut arguments = vec!["panorama", "--cube-faces=opengl", "-o", text(&back)];
    arguments.extend(faces.iter().map(|path| text(path)));
    succeeds(&arguments);
    check(&back, 0.03);
    let output = platelight(&arguments[..arguments.len() - 1]);
    assert_eq!(output.status.code(), Some(2), "five faces are no cube");
}

#[test]
fn what_comes_beside_the_panorama_is_written_and_right() {
    let folder = tempfile::tempdir().unwrap();
    let world = written(folder.path());
    let path = |name: &str| folder.path().join(name);
    let (out, irradiance, axes, set) =
        (path("out.exr"), path("irradiance.exr"), path("axes.png"), path("garden"));
    succeeds(&[
        "panorama",
        text(&world),
        "--lat-long",
        "--quality",
        "--rotation",
        "0,90,0",
        "-o",
        text(&out),
        "--irradiance",
        text(&irradiance),
        "--axes",
        text(&axes),
        "--sibl",
        text(&set),
    ]);
    // A linear ramp of light: E(n) = π a + ⅔π b·n. The turn takes the map's +X to the world's −Z.
    let e = photo::read(&irradiance, &ReadOptions::default()).unwrap().linear;
    let (x, y) = (64, 40);
    let n = lat_long_direction(DVec2::new(x as f64, y as f64), 256, 128);
    let turned = Rgb::new(-n.z as f32, n.y as f32, n.x as f32);
    let wanted = std::f32::consts::PI * (Rgb::splat(2.0) + turned * (2.0 / 3.0));
    assert!((e[(x, y)] - wanted).abs().max_element() < 2e-3, "{} {wanted}", e[(x, y)]);
    let quality = photo::read_layer(&out, "quality").unwrap().expect("a layer").linear;
    assert!((quality[(30, 64)].x - 256.0 / 360.0).abs() < 1e-3, "{}", quality[(30, 64)]);
    assert!(axes.is_file() && set.join("garden.ibl").is_file());
    let header = String::from_utf8_lossy(&std::fs::read(&out).unwrap()).into_owned();
    for said in
        ["\"sources\":[", "world.exr", "\"unit\":", "\"rotation_deg\":[0.0,90.0,0.0]", "envmap"]
    {
        assert!(header.contains(said), "{said} in {header:.1500}");
    }
}

#[test]
fn a_fisheye_of_kannala_and_brandt_is_unwrapped_without_its_vignetting() {
    let folder = tempfile::tempdir().unwrap();
    let distortion = Distortion::KannalaBrandt { k1: -0.02, k2: 0.003, k3: 0.0, k4: 0.0 };
    let lens = Lens { distortion, ..Lens::pinhole(120.0, 400, 400) };
    let picture = LensPicture::new(lens.clone(), 400, 400).unwrap();
    let light_at = |x: usize, y: usize| {
        let pixel = DVec2::new(x as f64, y as f64);
        let (Some(d), Some((_, angle))) = (picture.direction(pixel), picture.off_axis(pixel))
        else {
            return Rgb::ZERO;
        };
        light(d) * (1.0 - 0.3 * angle / std::f64::consts::FRAC_PI_2) as f32
    };
    let photograph = folder.path().join("sky.hdr");
    let image = Image::from_fn(400, 400, light_at);
    photo::radiance_hdr::write(&photograph, &image, Default::default()).unwrap();
    let camera = folder.path().join("camera.json");
    let pose = Pose::identity();
    camera_file::write(&camera, &Camera { width: 400, height: 400, lens, pose }, false).unwrap();
    let table = folder.path().join("vignetting.txt");
    std::fs::write(&table, "# degrees, share\n0 1\n90 0.7\n").unwrap();
    let out = folder.path().join("out.exr");
    succeeds(&[
        "panorama",
        text(&photograph),
        "--lens",
        "--camera",
        text(&camera),
        "--vignetting",
        text(&table),
        "-o",
        text(&out),
    ]);
    let options = ReadOptions::default();
    let layout = Layout::named("latlong").unwrap();
    let read = file::read(&out, layout, DQuat::IDENTITY, None, &options).unwrap().panorama;
    for d in [DVec3::NEG_Z, DVec3::new(0.5, 0.2, -1.0), DVec3::new(-1.0, 0.3, -0.3)] {
        let d = d.normalize();
        let off = (read.radiance(d) - light(d)).abs().max_element();
        assert!(off < 0.02, "{d}: {} for {}", read.radiance(d), light(d));
    }
}

#[test]
fn wrong_wishes_are_refused_before_anything_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let world = written(folder.path());
    let out = folder.path().join("out.exr");
    for (wrong, said) in [
        (&["--to", "maya"][..], "cube-cross"),
        (&["--to", "latlong:maya"], "blender"),
        (&["--to", "cube-cross", "--size", "100000"], "--size"),
        (&["--to", "latlong", "--size", "33"], "--size"),
        (&["--vignetting", "0,0,0"], "--vignetting"),
        (&["--camera", "camera.json"], "--camera"),
        (&["--irradiance", "e.png"], ".exr"),
    ] {
        let arguments =
            [&["panorama", text(&world), "--lat-long", "-o", text(&out)], wrong].concat();
        let output = platelight(&arguments);
        let told = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{wrong:?}: {told}");
        assert!(told.contains(said) && !out.exists(), "{wrong:?}: {told}");
    }
    let named = folder.path().join("out.png");
    let output = platelight(&["panorama", text(&world), "--lat-long", "-o", text(&named)]);
    assert!(String::from_utf8_lossy(&output.stderr).contains(".hdr"));
}

/// By the batch's rules: a bad one stops nothing, and what is done already may be left alone.
#[test]
fn a_folder_of_maps_becomes_a_folder_of_panoramas() {
    let folder = tempfile::tempdir().unwrap();
    let maps = folder.path().join("maps");
    std::fs::create_dir(&maps).unwrap();
    let world = written(&maps);
    std::fs::copy(&world, maps.join("again.exr")).unwrap();
    std::fs::write(maps.join("notes.txt"), "no picture").unwrap();
    let whole = std::fs::read(&world).unwrap();
    std::fs::write(maps.join("cut.exr"), &whole[..whole.len() / 2]).unwrap();
    let (out, seen) = (folder.path().join("out"), folder.path().join("seen"));
    let mut arguments = vec!["panorama", text(&maps), "--lat-long", "-o", text(&out), "--json"];
    arguments.extend(["--preview", text(&seen), "--skip-existing"]);

    let run = || {
        let output = platelight(&arguments);
        let said: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(output.status.code(), Some(1), "{said}");
        assert_eq!(
            said,
            serde_json::from_slice::<serde_json::Value>(
                &std::fs::read(out.join("batch.json")).unwrap()
            )
            .unwrap()
        );
        said
    };
    let said = run();
    assert_eq!(said.as_array().unwrap().len(), 3);
    assert!(said[1]["problem"].as_str().unwrap().contains("cut.exr"), "{said}");
    for name in ["world", "again"] {
        check(&out.join(name).with_extension("exr"), 2e-3);
        assert!(seen.join(name).with_extension("png").exists());
    }
    assert!(!out.join("cut.exr").exists() && !out.join("notes.exr").exists());
    let said = run();
    assert_eq!((&said[0]["skipped"], &said[2]["skipped"]), (&true.into(), &true.into()), "{said}");

    // What is no folder's matter, and a file where a folder must be.
    for (arguments, told) in [
        (vec!["panorama", text(&world), "--lat-long", "-o", "p.exr", "--group", "3"], "--group"),
        (vec!["panorama", text(&maps), "--merge", "-o", text(&out)], "name the pictures"),
        (vec!["panorama", text(&maps), "--lat-long", "-o", text(&world)], "is a file"),
    ] {
        let output = platelight(&arguments);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{said}");
        assert!(said.contains(told), "{said}");
    }
}
