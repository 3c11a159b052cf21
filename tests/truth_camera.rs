//! Camera and pose of the truth scenes, from their photographs alone, against the known answer.
//!
//! Focal lengths within 0.1 %, plate and ball camera within 3 σ as stated. Each scene has 2 + 6 + 6
//! numbers; on three scenes 42 comparisons at 3 σ would fail by chance in one run of nine if every σ were
//! exact, but photographs are fixed: they pass or they do not. Needs `../shared/truth` and OpenCV.
#![cfg(feature = "opencv")]

use std::path::PathBuf;

use glam::{DAffine3, DMat3, DVec3};
use platelight::camera::Pose;
use platelight::photo::{self, ReadOptions};
use platelight::shot::camera_keys::PoseSource;
use platelight::shot::probe_keys::ProbeSource;
use platelight::shot::{ShotFile, calibrate, locate};

fn shared() -> Option<PathBuf> {
    let folder = std::env::var_os("PLATELIGHT_SHARED").map_or_else(
        || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared")),
        PathBuf::from,
    );
    let there = folder.join("truth").is_dir();
    if !there {
        eprintln!("skipped: {} has no truth scenes", folder.display());
    }
    there.then_some(folder)
}

fn pose(value: &serde_json::Value) -> Pose {
    let at = |row: usize, column: usize| value[row][column].as_f64().expect("a number");
    let column = |c: usize| DVec3::new(at(0, c), at(1, c), at(2, c));
    let matrix3 = DMat3::from_cols(column(0), column(1), column(2));
    let world_from_camera = DAffine3 { matrix3, translation: column(3) };
    Pose { world_from_camera, covariance: None }
}

/// Errors of a pose in its own σ: rotation x y z, position x y z.
fn in_sigmas(found: &Pose, truth: &Pose) -> ([f64; 6], DVec3, DVec3) {
    let (turn, shift) = found.difference(truth);
    let (sigma_turn, sigma_shift) = found.sigmas().expect("a stated σ");
    let (a, b) = (turn / sigma_turn, shift / sigma_shift);
    ([a.x, a.y, a.z, b.x, b.y, b.z], turn, shift)
}

#[test]
fn focal_length_and_poses_of_the_truth_scenes() {
    let Some(shared) = shared() else { return };
    let mut failures = vec![];
    for scene in ["outdoor-sun", "overcast-soft", "indoor-window"] {
        let folder = shared.join("truth").join(scene);
        let shot = ShotFile::read(&folder.join("shot.toml")).expect("the given shot file");
        let truth = std::fs::read_to_string(folder.join("truth.json")).expect("for scoring");
        let truth: serde_json::Value = serde_json::from_str(&truth).expect("JSON");
        let plate = photo::read(&folder.join("plate.png"), &ReadOptions::default()).expect("plate");

        let size = [plate.linear.width(), plate.linear.height()];
        let found = calibrate::find_lens(&shot.camera.source, size, &plate.facts, &plate.path)
            .expect("a lens");
        let sigma = found.lens.sigmas().expect("measured");
        eprintln!(
            "{scene}: {} · σ_proj {:.3} px · rms {:.3} px",
            found.report.distortion,
            found.report.sigma_projection_px.unwrap_or(f64::NAN),
            found.report.rms_px.unwrap_or(f64::NAN)
        );
        for warning in &found.warnings {
            eprintln!("  warning: {warning}");
        }
        for (i, (name, value)) in [
            ("fx", found.lens.fx),
            ("fy", found.lens.fy),
            ("cx", found.lens.cx),
            ("cy", found.lens.cy),
        ]
        .iter()
        .enumerate()
        {
            let known = truth["intrinsics"][name].as_f64().expect("a number");
            let off = value - known;
            eprintln!("  {name} {value:.3} off {off:+.3} px = {:+.2} σ", off / sigma[i]);
            if i < 2 && (off / known).abs() > 1e-3 {
                failures.push(format!("{scene}: {name} off by {:.3} %", 100.0 * off / known));
            }
        }

        let size = [found.width, found.height];
        let ProbeSource::Ball(ball) = &shot.probe.source else { panic!("a ball") };
        let Some(ball_pose) = &ball.pose else { panic!("a pose of its own") };
        let both: [(&str, &PoseSource, &str); 2] = [
            ("plate camera", &shot.pose, "plate_camera_to_world"),
            ("ball camera", ball_pose, "ball_camera_to_world"),
        ];
        for (name, source, key) in both {
            let board = match &shot.camera.source {
                platelight::shot::camera_keys::CameraSource::Boards { board, .. } => Some(board),
                _ => None,
            };
            let place = locate::find_pose(source, &found.lens, size, board).expect("a pose");
            let known = pose(&truth[key]);
            let (ratio, turn, shift) = in_sigmas(&place.pose, &known);
            eprintln!(
                "  {name}: rms {:.3} px, off {:.4}° {:.2} mm; in σ: {}",
                place.report.rms_px.unwrap_or(f64::NAN),
                turn.length().to_degrees(),
                1e3 * shift.length(),
                ratio.map(|r| format!("{r:+.2}")).join(" ")
            );
            for warning in &place.warnings {
                eprintln!("    warning: {warning}");
            }
            for r in ratio.iter().filter(|r| !(r.abs() <= 3.0)) {
                failures.push(format!("{scene}: {name} {r:.1} σ off"));
            }
        }
    }
    assert!(failures.is_empty(), "{failures:#?}");
}
