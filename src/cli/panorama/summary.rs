//! What `panorama` says when it is done.

use std::f64::consts::PI;
use std::path::PathBuf;

use glam::DVec3;
use serde::Serialize;

use super::args::Wishes;
use super::fill_sky::SkySummary;
use super::merge::{self, Merged};
use super::photographed::Photographed;
use crate::bracket::Validity;
use crate::conventions::luminance;
use crate::probe::{Panorama, clipped_regions};

/// What came out, for people and machines.
#[derive(Serialize)]
pub(super) struct Summary {
    /// The first of six where each face is a file.
    pub(super) out: PathBuf,
    pub(super) mapping: String,
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) ball: Option<BallSummary>,
    /// Share of all directions that was not seen and is filled.
    pub(super) filled: f64,
    /// The clear sky that fills what was not seen above the horizon.
    pub(super) sky: Option<SkySummary>,
    /// What a value of 1 means.
    pub(super) unit: String,
    /// Irradiance on a level surface, the panorama's unit times sr.
    pub(super) irradiance_up: [f32; 3],
    pub(super) clipped: Vec<ClippedSummary>,
    /// How several panoramas became one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) merged: Option<Merged>,
    pub(super) warnings: Vec<String>,
}

#[derive(Serialize)]
pub(super) struct BallSummary {
    pub(super) centre_px: [f64; 2],
    pub(super) radius_px: f64,
    pub(super) sigma_px: f64,
    pub(super) sigma_direction_deg: f64,
    pub(super) inliers: f64,
    /// `None`: the hint was taken as it is.
    pub(super) score: Option<f64>,
    /// Share of the rim whose edges agree on one circle; `None` likewise.
    pub(super) agreement: Option<f64>,
}

#[derive(Serialize)]
pub(super) struct ClippedSummary {
    pub(super) direction: [f64; 3],
    pub(super) solid_angle_sr: f64,
    pub(super) flux_at_least: [f32; 3],
    pub(super) place: String,
}

pub(super) fn summary(
    wishes: &Wishes,
    panorama: &Panorama,
    (width, height): (usize, usize),
    found: &Photographed,
    sky: Option<SkySummary>,
    mut warnings: Vec<String>,
) -> Summary {
    let regions = clipped_regions(panorama);
    let whole = f64::from(luminance(panorama.mean())) * 4.0 * PI;
    for region in &regions {
        let share = f64::from(luminance(region.lower_bound)) / whole;
        if share > 0.01 {
            warnings.push(format!(
                "clipped in every photograph: {region}; at least {:.0} % of all light comes from there; \
                 add a shorter exposure",
                100.0 * share
            ));
        }
    }
    Summary {
        out: wishes.target.files(&wishes.args.out).swap_remove(0),
        mapping: wishes.args.further.to.clone(),
        width,
        height,
        ball: found.ball.as_ref().map(|b| BallSummary {
            centre_px: b.centre_px.to_array(),
            radius_px: b.radius_px,
            sigma_px: b.sigma_px,
            sigma_direction_deg: b.rim.sigma_direction_rad().to_degrees(),
            inliers: b.rim.inlier_fraction,
            score: b.score,
            agreement: b.agreement,
        }),
        filled: panorama.share(Validity::Filled),
        sky,
        unit: found.unit.clone(),
        irradiance_up: panorama.irradiance(DVec3::Y).to_array(),
        clipped: regions
            .iter()
            .map(|r| ClippedSummary {
                direction: r.direction.to_array(),
                solid_angle_sr: r.solid_angle,
                flux_at_least: r.lower_bound.to_array(),
                place: r.to_string(),
            })
            .collect(),
        merged: None,
        warnings,
    }
}

pub(super) fn text(summary: &Summary) -> String {
    let (w, h) = (summary.width, summary.height);
    let mapping = match summary.mapping.as_str() {
        "latlong" => String::new(),
        other => format!(", {other}"),
    };
    let mut lines = vec![format!("{}: {w} × {h} texels{mapping}", summary.out.display())];
    if let Some(b) = &summary.ball {
        lines.push(format!(
            "  ball at ({:.1}, {:.1}) px, radius {:.1} px, ± {:.2} px: directions ± {:.2}°",
            b.centre_px[0], b.centre_px[1], b.radius_px, b.sigma_px, b.sigma_direction_deg
        ));
    }
    let [r, g, b] = summary.irradiance_up;
    lines.push(format!("  irradiance from above {r:.4} {g:.4} {b:.4}; 1 is {}", summary.unit));
    if summary.filled > 0.0 {
        lines.push(format!(
            "  not seen and filled: {:.1} % of all directions",
            100.0 * summary.filled
        ));
    }
    if let Some(sky) = &summary.sky {
        lines.push(format!(
            "  clear sky of turbidity {:.1} fits to {:.1} % what was seen of it ({:.0} %), and fills {:.0} %",
            sky.turbidity,
            100.0 * sky.residual,
            100.0 * sky.seen,
            100.0 * sky.filled
        ));
    }
    for region in summary.clipped.iter().take(5) {
        lines.push(format!("  clipped: {}", region.place));
    }
    lines.extend(summary.merged.iter().flat_map(merge::lines));
    lines.join("\n")
}
