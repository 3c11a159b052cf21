//! The known answer: what the shot holds, and where the objects change the picture.

use std::error::Error;
use std::fs;
use std::path::Path;

use glam::DVec3;
use serde_json::json;

use crate::files::{Window, write_exr};
use crate::place::{BALL_RADIUS_M, BALL_REFLECTANCE};
use crate::shoot::{ball_corner, ball_view, lens, plate_view, tag_corners};
use crate::sky;
use crate::tracer::Rendered;

/// Smallest relative change of luminance that counts as influence, after a 9 × 9 mean.
const INFLUENCE: f64 = 0.01;

/// Writes `truth.exr`: truth (R, G, B), plate without noise, coverage and influence, where it matters.
pub fn write_pictures(
    path: &Path,
    plate: &Rendered,
    truth: &Rendered,
) -> Result<(), Box<dyn Error>> {
    let influence = influence(plate, truth);
    let window = bounds(&influence, plate.width, plate.height, 8);
    let channel = |picture: &Rendered, c: usize| picture.light.iter().map(|l| l[c]).collect();
    let channels = [
        ("R", channel(truth, 0)),
        ("G", channel(truth, 1)),
        ("B", channel(truth, 2)),
        ("plate.R", channel(plate, 0)),
        ("plate.G", channel(plate, 1)),
        ("plate.B", channel(plate, 2)),
        ("coverage.Y", truth.coverage.clone()),
        ("influence.Y", influence.iter().map(|i| f64::from(u8::from(*i))).collect()),
    ];
    write_exr(path, &channels, (plate.width, plate.height), window)
}

/// Writes `truth.json`: the camera, its places and the sun. For scoring only.
pub fn write_facts(path: &Path) -> Result<(), Box<dyn Error>> {
    let (view, lens) = (plate_view(), lens());
    let (x, y) = ball_corner();
    let facts = json!({
        "about": "the answers of plates/demo; only for scoring, the pipeline never reads this file",
        "camera": {
            "width": view.width, "height": view.height,
            "fx": lens.focal.x, "fy": lens.focal.y, "cx": lens.centre.x, "cy": lens.centre.y,
            "k1_k2_p1_p2_k3": [lens.k[0], lens.k[1], lens.p[0], lens.p[1], lens.k[2]],
            "world_from_camera": view.world_from_camera(),
        },
        "ball": {
            "centre": [0.0, BALL_RADIUS_M, 0.0], "radius_m": BALL_RADIUS_M,
            "reflectance": BALL_REFLECTANCE.to_array(), "crop": [x, y],
            "world_from_camera": ball_view().world_from_camera(),
        },
        "tag_corners_world": tag_corners().map(|c| c.to_array()),
        "tag_corners_px": tag_corners().map(|c| view.project(c).to_array()),
        "sun": {
            "direction": sky::sun_direction().to_array(),
            "angular_radius_rad": sky::SUN_RADIUS_RAD,
            "irradiance_facing_it": sky::SUN_IRRADIANCE.to_array(),
        },
    });
    Ok(fs::write(path, serde_json::to_string_pretty(&facts)? + "\n")?)
}

fn influence(plate: &Rendered, truth: &Rendered) -> Vec<bool> {
    let luminance = |l: DVec3| l.dot(DVec3::new(0.2126, 0.7152, 0.0722));
    let (width, height) = (plate.width as i64, plate.height as i64);
    let mean = |at: i64, value: &dyn Fn(usize) -> f64| {
        let (x, y) = (at % width, at / width);
        let mut sum = 0.0;
        for (dx, dy) in (-4..=4).flat_map(|dy| (-4..=4).map(move |dx| (dx, dy))) {
            let (u, v) = ((x + dx).clamp(0, width - 1), (y + dy).clamp(0, height - 1));
            sum += value((v * width + u) as usize);
        }
        sum / 81.0
    };
    (0..width * height)
        .map(|at| {
            let change = mean(at, &|i| luminance(truth.light[i] - plate.light[i]));
            let level = mean(at, &|i| luminance(plate.light[i]));
            truth.coverage[at as usize] > 0.0 || change.abs() > INFLUENCE * level
        })
        .collect()
}

/// The rectangle round all true pixels, `margin` wider where the picture allows it.
fn bounds(mask: &[bool], width: usize, height: usize, margin: usize) -> Window {
    let hits = || mask.iter().enumerate().filter(|(_, m)| **m).map(|(i, _)| (i % width, i / width));
    let (left, top) = hits().fold((width - 1, height - 1), |a, p| (a.0.min(p.0), a.1.min(p.1)));
    let (right, bottom) = hits().fold((left, top), |a, p| (a.0.max(p.0), a.1.max(p.1)));
    let (x, y) = (left.saturating_sub(margin), top.saturating_sub(margin));
    let (last_x, last_y) = ((right + margin).min(width - 1), (bottom + margin).min(height - 1));
    Window { x, y, width: last_x + 1 - x, height: last_y + 1 - y }
}
