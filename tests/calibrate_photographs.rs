//! Calibration of real photographs whose lenses others have measured. Needs `../shared/data` and OpenCV.
#![cfg(feature = "opencv")]

use std::path::{Path, PathBuf};

use platelight::camera::Distortion;
use platelight::shot::calibrate::{FoundLens, from_boards};
use platelight::shot::camera_keys::Board;
use platelight::shot::{detect, pictures};

fn data() -> Option<PathBuf> {
    let folder = std::env::var_os("PLATELIGHT_SHARED").map_or_else(
        || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared")),
        PathBuf::from,
    );
    let folder = folder.join("data");
    let there = folder.join("calib-carnd").is_dir();
    if !there {
        eprintln!("skipped: {} has no photographs", folder.display());
    }
    there.then_some(folder)
}

fn calibrate(pattern: &Path, corners: [u32; 2], square_mm: f64) -> FoundLens {
    let files = pictures::expand(pattern).expect("photographs");
    let board = Board::Checkerboard { corners, square_mm };
    let (found, _) = from_boards(&files, &board).expect("a lens");
    eprintln!(
        "{}: {} fx {:.2} fy {:.2} cx {:.2} cy {:.2} rms {:.3} σ_f {:.2} σ_proj {:.2}",
        pattern.display(),
        found.report.distortion,
        found.lens.fx,
        found.lens.fy,
        found.lens.cx,
        found.lens.cy,
        found.report.rms_px.unwrap_or(f64::NAN),
        found.report.sigma_focal_px.unwrap_or(f64::NAN),
        found.report.sigma_projection_px.unwrap_or(f64::NAN),
    );
    for view in found.report.views.iter().filter(|v| v.rejected.is_some()) {
        eprintln!("  {}: {}", view.photo.display(), view.rejected.as_deref().unwrap_or(""));
    }
    for warning in &found.warnings {
        eprintln!("  warning: {warning}");
    }
    found
}

/// OpenCV's own sample pictures: fx 532.8, fy 532.9 by OpenCV's five-parameter model.
#[test]
fn opencv_samples_agree_with_opencv() {
    let Some(data) = data() else { return };
    let found = calibrate(&data.join("calib-opencv-stereo/left*.jpg"), [9, 6], 25.0);
    let used = found.report.views.iter().filter(|v| v.rejected.is_none()).count();
    assert!(used >= 10, "{used} of 13");
    // The reference has errors of its own: 1 px on fx at rms 0.2 px.
    assert!((found.lens.fx - 532.8).abs() < 2.0 && (found.lens.fy - 532.9).abs() < 2.0);
    // OpenCV reaches 0.195 px; here outer squares that the print cuts short disturb the rim's corners.
    assert!(found.report.rms_px.is_some_and(|rms| rms < 0.3));
}

/// Two of these have another size, and up to three boards are cut off: each is named with its reason.
#[test]
fn odd_sized_and_cut_boards_are_named() {
    let Some(data) = data() else { return };
    let found = calibrate(&data.join("calib-carnd/calibration*.jpg"), [9, 6], 25.0);
    let rejected: Vec<(String, String)> = found
        .report
        .views
        .iter()
        .filter_map(|v| {
            Some((v.photo.file_stem()?.to_string_lossy().into_owned(), v.rejected.clone()?))
        })
        .collect();
    for odd in ["calibration7", "calibration15"] {
        let reason = rejected.iter().find(|(name, _)| name == odd);
        assert!(reason.is_some_and(|(_, why)| why.contains("1281×721")), "{odd}: {reason:?}");
    }
    for cut in ["calibration1", "calibration5"] {
        assert!(rejected.iter().any(|(name, _)| name == cut), "{cut} is cut off");
    }
    assert!((1140.0..1180.0).contains(&found.lens.fx), "fx {}", found.lens.fx);
}

/// A real fisheye: Brown–Conrady reaches rms 0.48 px, Kannala–Brandt 0.177 px.
#[test]
fn a_fisheye_gets_a_fisheye_model() {
    let Some(data) = data() else { return };
    let found = calibrate(&data.join("calib-fisheye-left/left*.jpg"), [9, 6], 24.23);
    assert!(matches!(found.lens.distortion, Distortion::KannalaBrandt { .. }));
    assert!((found.lens.fx - 227.4).abs() < 2.0, "fx {}", found.lens.fx);
}

/// The print is stretched by 6 %: only a warning tells.
#[test]
fn a_stretched_print_is_called_out() {
    let Some(data) = data() else { return };
    let found = calibrate(&data.join("calib-iphone6/*.png"), [9, 7], 21.0);
    assert!(found.warnings.iter().any(|w| w.message.contains("stretched")), "{:?}", found.warnings);
}

/// All tags of the duckie pictures are found and turned as their names say.
#[test]
fn tags_turn_as_their_pictures_do() {
    let Some(data) = data() else { return };
    let turned = |name: &str| {
        let path =
            data.join("tags-duckie-rotation").join(format!("test_image_rotation_{name}.png"));
        let photo = platelight::photo::read(&path, &Default::default()).expect("a picture");
        let seen = detect::tag(&photo, "36h11", 76, None).expect("tag 76");
        let edge = seen.corners[1] - seen.corners[0];
        let side = seen.corners[3] - seen.corners[0];
        eprintln!("{name}: by edges {} σ {:.3} {:?}", seen.by_edges, seen.sigma_px, seen.corners);
        edge.length() / side.length()
    };
    // Turned about the vertical: the upper edge shortens as cos of the angle.
    assert!(turned("0") > 0.9 && turned("40") < turned("20") && turned("70") < turned("40"));
}
