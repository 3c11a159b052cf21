//! What a person looks at: report.json, report.html, overlays.
//!
//! Everything above → files for eyes. Start with [`Report`]; [`Canvas`] draws over photographs.
//! This room never computes a picture or a number it reports on, it only shows them.

mod axes_card;
mod canvas;
pub mod chart;
mod html;
mod lettering;
pub mod overlay;
mod text;

pub use axes_card::axes_card;
pub use canvas::Canvas;
pub use html::{shot_name, write_html};
pub use text::{length, per_cent, summary};

use std::io::Write;
use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::photo::atomic;

/// Everything known about one finished picture.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Report {
    pub program: String,
    /// The effective settings: the shot file with its defaults.
    pub shot: serde_json::Value,
    pub seed: u64,
    /// Name, size and time of every file the shot was made from, and of every file made.
    pub inputs: serde_json::Value,
    pub outputs: serde_json::Value,
    pub plate: PlateReport,
    pub camera: CameraReport,
    pub pose: PoseReport,
    pub probe: ProbeReport,
    pub lights: LightsReport,
    pub render: RenderReport,
    pub composite: CompositeReport,
    /// Seconds of every stage, in order.
    pub stages: Vec<Stage>,
    pub budget: Budget,
    /// What somebody should look at or mend.
    pub warnings: Vec<Warning>,
    /// What is good to know and asks for nothing.
    pub notes: Vec<Warning>,
    /// Files beside the report, by what they show.
    pub pictures: Vec<Picture>,
}

/// Something that may make the picture wrong, with how wrong.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Warning {
    /// Part of the work or key of the shot file it belongs to.
    pub about: String,
    /// What was found, and what to do.
    pub message: String,
    /// How large the effect on the picture can be; empty where the message says it.
    pub size: String,
    /// False of a note, which asks for nothing. Not written: lists of the two are kept apart
    /// ([`Warning::apart`]).
    #[serde(skip)]
    pub asks: bool,
}

impl Warning {
    pub fn new(
        about: impl Into<String>,
        message: impl Into<String>,
        size: impl Into<String>,
    ) -> Self {
        Self { about: about.into(), message: message.into(), size: size.into(), asks: true }
    }

    /// Something good to know that asks for nothing. Reports list notes apart from warnings; a run does
    /// not say them on the terminal, the other commands say them as notes.
    pub fn note(
        about: impl Into<String>,
        message: impl Into<String>,
        size: impl Into<String>,
    ) -> Self {
        Self { asks: false, ..Self::new(about, message, size) }
    }

    /// Those that ask for something, and the notes.
    pub fn apart(all: Vec<Self>) -> (Vec<Self>, Vec<Self>) {
        all.into_iter().partition(|warning| warning.asks)
    }
}

impl std::fmt::Display for Warning {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        write!(f, "{}: {}", self.about, self.message)?;
        if self.size.is_empty() { Ok(()) } else { write!(f, "\n    effect: {}", self.size) }
    }
}

/// The photograph that the objects were put into.
#[derive(Clone, Debug, Default, Serialize)]
pub struct PlateReport {
    pub file: PathBuf,
    /// How its numbers stand for light, and who said so.
    pub colour: String,
}

/// The plate camera's lens.
#[derive(Clone, Debug, Default, Serialize)]
pub struct CameraReport {
    /// "14 photographs of a checkerboard", a file, a focal length.
    pub source: String,
    pub size_px: [usize; 2],
    pub focal_px: [f64; 2],
    /// Standard deviation of the focal length, if it was measured.
    pub sigma_focal_px: Option<f64>,
    pub principal_point_px: [f64; 2],
    /// Name of the lens model and its coefficients.
    pub distortion: String,
    pub distortion_coefficients: Vec<f64>,
    /// What they are called.
    pub distortion_names: Vec<&'static str>,
    /// How far the distortion moves the corner of the picture that it moves most.
    pub distortion_px: Option<f64>,
    /// Standard deviation of a projected point over the picture, if it was measured.
    pub sigma_projection_px: Option<f64>,
    pub rms_px: Option<f64>,
    /// Every photograph used: its residual, or why it was not used.
    pub views: Vec<ViewReport>,
}

#[derive(Clone, Debug, Default, Serialize)]
pub struct ViewReport {
    pub photo: PathBuf,
    pub rms_px: Option<f64>,
    pub rejected: Option<String>,
}

/// Where the plate camera stood.
#[derive(Clone, Debug, Default, Serialize)]
pub struct PoseReport {
    pub source: String,
    /// World, metres.
    pub position_m: [f64; 3],
    pub sigma_position_m: Option<[f64; 3]>,
    pub sigma_rotation_deg: Option<[f64; 3]>,
    pub rms_px: Option<f64>,
    /// Standard deviation of where the foot of the objects is seen.
    pub slip_px: Option<f64>,
    /// What else fitted, and how much worse.
    pub ambiguity: Option<String>,
}

/// The light probe and the bracket it was merged from.
#[derive(Clone, Debug, Default, Serialize)]
pub struct ProbeReport {
    pub source: String,
    /// How its files' numbers stand for light, and who said so.
    pub colour: String,
    /// Relative exposures t · (ISO/100) / N² of the frames, and who said so.
    pub exposures: Vec<f64>,
    pub exposure_source: String,
    /// The probe's radiance × this = plate value.
    pub plate_exposure: f64,
    pub plate_exposure_source: String,
    /// Centre and radius of the ball's picture.
    pub ball_px: Option<[f64; 3]>,
    pub sigma_ball_px: Option<f64>,
    /// Error of all directions together, from the rim's σ and from how the probe was registered.
    pub sigma_direction_deg: Option<f64>,
    /// How the probe's axes came into the world's.
    pub registered: String,
    /// Share of the sphere that was seen.
    pub seen_share: f64,
    pub clipped: Vec<ClippedReport>,
}

/// A light that no exposure shows unclipped.
#[derive(Clone, Debug, Default, Serialize)]
pub struct ClippedReport {
    /// World.
    pub direction: [f64; 3],
    pub azimuth_deg: f64,
    pub elevation_deg: f64,
    pub solid_angle_sr: f64,
    /// Flux ∫ L dω that it has at least, per channel, in the plate's linear scale times sr.
    pub flux_at_least: [f64; 3],
    /// The same as a share of all light that the probe saw.
    pub share_at_least: f64,
    pub treatment: Treatment,
}

/// What was done about a clipped light; report.json has it as a sentence.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Treatment {
    /// Taken as it is, too weak.
    #[default]
    Accepted,
    /// Its irradiance (on a plane that faces it, the plate's scale) was found in the plate, with a
    /// relative standard error, from so many pieces of evidence. `moved_deg` is how far shadow edges in the
    /// plate moved it; without such, its direction is the probe's.
    Recovered {
        irradiance: [f64; 3],
        sigma: f64,
        evidence: usize,
        sigma_direction_deg: f64,
        moved_deg: Option<f64>,
    },
    /// It is a `[[lamp]]` that got its strength from the plate, to this relative standard error.
    Lamp { sigma: f64 },
}

impl std::fmt::Display for Treatment {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        match self {
            Self::Accepted => f.write_str("accepted as a lower bound"),
            Self::Recovered {
                irradiance: [r, g, b],
                sigma,
                evidence,
                sigma_direction_deg,
                moved_deg,
            } => {
                write!(
                    f,
                    "recovered as a sun from the plate, irradiance {r:.3}, {g:.3}, {b:.3} ± {:.0} % \
                     ({evidence} pieces of evidence), direction ± {sigma_direction_deg:.2}° ",
                    100.0 * sigma
                )?;
                match moved_deg {
                    Some(moved) => {
                        write!(f, "by shadow edges in the plate, {moved:.2}° from the probe's")
                    }
                    None => f.write_str("by the probe"),
                }
            }
            Self::Lamp { sigma } => {
                write!(f, "a lamp whose strength is taken from the plate, ± {:.0} %", 100.0 * sigma)
            }
        }
    }
}

impl Serialize for Treatment {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

#[derive(Clone, Debug, Default, Serialize)]
pub struct LightsReport {
    /// On a horizontal surface at the probe, in the plate's linear scale.
    pub irradiance_up: [f64; 3],
    pub suns: Vec<SunReport>,
    /// How `[surroundings]` are treated, and why; empty without.
    pub surroundings: String,
    pub lamps: Vec<LampReport>,
}

/// A lamp of the shot file.
#[derive(Clone, Debug, Default, Serialize)]
pub struct LampReport {
    /// Its centre, world.
    pub at_m: [f64; 3],
    pub radius_m: f64,
    /// Mean over its disc above its surroundings, in the plate's linear scale; 0 if it stays in the
    /// panorama.
    pub radiance: [f64; 3],
    /// Angle between where it should be seen and where the panorama shows it.
    pub beside_deg: f64,
    /// Whether it shines from its place; otherwise it is part of the panorama.
    pub in_place: bool,
    /// It clipped in every exposure: how many times stronger the plate shows it than the probe, per channel,
    /// and the relative σ of that.
    pub strengthened: Option<[f64; 3]>,
    pub sigma: Option<f64>,
    /// What was done with it, and why.
    pub treated: String,
}

/// A small bright light that is sampled on its own.
#[derive(Clone, Debug, Default, Serialize)]
pub struct SunReport {
    /// World, toward the light.
    pub direction: [f64; 3],
    /// From +Z toward +X.
    pub azimuth_deg: f64,
    pub elevation_deg: f64,
    pub half_angle_deg: f64,
    /// On a surface that faces it, in the plate's linear scale.
    pub irradiance: [f64; 3],
}

#[derive(Clone, Debug, Default, Serialize)]
pub struct RenderReport {
    pub method: String,
    pub stop: String,
    /// Standard error relative to the plate over the influence region.
    pub error: f64,
    pub samples: u64,
    pub waves: u32,
    /// Seconds on the clock and of all cores together.
    pub seconds: f64,
    pub cpu_seconds: Option<f64>,
    /// Pixels that the error leaves out: light found by chance, far noisier than around them.
    pub outliers: u64,
    /// How many times smaller denoising made the error, where it did.
    pub denoised: Option<f64>,
    /// Pixels that the objects may change and for which there was no time.
    pub missing: u64,
    /// False if it ended before the stopping rule was met.
    pub complete: bool,
}

#[derive(Clone, Debug, Default, Serialize)]
pub struct CompositeReport {
    pub mode: String,
    pub reason: String,
    pub tally: crate::composite::Tally,
    /// Samples beyond the range of the plate's type.
    pub clamped: u64,
    /// Median albedo of the local surface seen in the plate, per channel, if it was solved.
    pub albedo_median: Option<[f64; 3]>,
}

/// One stage of the work.
#[derive(Clone, Debug, Serialize)]
pub struct Stage {
    pub name: String,
    pub seconds: f64,
    pub cpu_seconds: Option<f64>,
}

/// How wrong the picture may be, cause by cause, as far as it is known.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Budget {
    pub terms: Vec<Term>,
    /// The cause with the largest effect on brightness.
    pub dominated_by: Option<String>,
}

/// One cause of error.
#[derive(Clone, Debug, Serialize)]
pub struct Term {
    pub cause: String,
    /// One standard deviation, in `unit`; `None` where nobody measured it.
    pub sigma: Option<f64>,
    pub unit: &'static str,
    /// Relative effect on the brightness of what was inserted, where it can be said.
    pub brightness: Option<f64>,
    /// Measured, assumed or unknown, and what would make it smaller.
    pub note: String,
}

impl Budget {
    pub fn new(terms: Vec<Term>) -> Self {
        let largest = terms
            .iter()
            .filter(|term| term.brightness.is_some())
            .max_by(|a, b| a.brightness.unwrap_or(0.0).total_cmp(&b.brightness.unwrap_or(0.0)));
        let dominated_by = largest.map(|term| term.cause.clone());
        Self { terms, dominated_by }
    }
}

/// A picture beside the report.
#[derive(Clone, Debug, Serialize)]
pub struct Picture {
    /// Name in the report's folder.
    pub file: String,
    pub title: String,
    /// How to read it.
    pub caption: String,
}

/// Why a report could not be written.
#[derive(Debug, thiserror::Error)]
#[error("{}: cannot be written: {cause}", path.display())]
pub struct ReportError {
    path: PathBuf,
    cause: std::io::Error,
}

/// Writes report.json.
pub fn write_json(path: &Path, report: &Report) -> Result<(), ReportError> {
    let json = serde_json::to_string_pretty(report)
        .map_err(|cause| ReportError { path: path.to_owned(), cause: cause.into() })?;
    write_text(path, &(json + "\n"))
}

/// Writes a text whole or not at all.
fn write_text(path: &Path, text: &str) -> Result<(), ReportError> {
    atomic::write(path, |file| file.write_all(text.as_bytes()))
        .map_err(|cause| ReportError { path: path.to_owned(), cause })
}

/// "1 photograph", "14 photographs".
pub fn photographs(n: usize) -> String {
    counted(n, "photograph")
}

/// "1 note", "3 notes".
pub fn counted(n: usize, noun: &str) -> String {
    let plural = if n == 1 { "" } else { "s" };
    format!("{n} {noun}{plural}")
}

/// Azimuth (from +Z toward +X) and elevation (above the horizon) of a direction, degrees.
pub fn azimuth_elevation(direction: glam::DVec3) -> (f64, f64) {
    let azimuth = direction.x.atan2(direction.z).to_degrees();
    let elevation = direction.y.atan2(direction.x.hypot(direction.z)).to_degrees();
    (azimuth, elevation)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_largest_known_effect_dominates() {
        let term = |cause: &str, brightness| Term {
            cause: cause.to_owned(),
            sigma: None,
            unit: "%",
            brightness,
            note: String::new(),
        };
        let budget =
            Budget::new(vec![term("a", Some(0.01)), term("b", Some(0.03)), term("c", None)]);
        assert_eq!(budget.dominated_by.as_deref(), Some("b"));
        assert_eq!(Budget::new(vec![term("c", None)]).dominated_by, None);
    }

    #[test]
    fn json_has_the_parts_the_design_names() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("report.json");
        write_json(&path, &Report::default()).unwrap();
        let json: serde_json::Value =
            serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
        for key in ["camera", "pose", "probe", "lights", "render", "warnings", "budget"] {
            assert!(json.get(key).is_some(), "no {key}");
        }
    }

    #[test]
    fn azimuth_runs_from_z_to_x() {
        assert_eq!(azimuth_elevation(glam::DVec3::X), (90.0, 0.0));
        assert_eq!(azimuth_elevation(glam::DVec3::Y).1, 90.0);
    }
}
