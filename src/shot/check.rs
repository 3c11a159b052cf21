//! All that can be found wrong with a shot before any rendering, and what a run will need.

use std::path::PathBuf;

use serde::Serialize;

use super::file::{DenoiseKeys, ShotFile};
use super::frames::frame_path;
use super::plan::Plan;
use super::prepare::prepare;
use super::run::RunError;
use super::stop::StopKeys;
use super::watch::{Stopwatch, Watch};
use crate::render::Context;
use crate::render::waves::EXPECTED_GAIN;
use crate::report::{CameraReport, LightsReport, PoseReport, ProbeReport, Warning};

/// What a check found on a shot that can run.
#[derive(Clone, Debug, Serialize)]
pub struct Findings {
    pub shot: PathBuf,
    /// Files read.
    pub inputs: usize,
    /// Frames that will be run.
    pub frames: usize,
    pub camera: CameraReport,
    pub pose: PoseReport,
    pub probe: ProbeReport,
    pub lights: LightsReport,
    /// Triangles of objects, and of support and local things.
    pub triangles: [usize; 2],
    /// Memory a run will need at its peak, roughly.
    pub predicted_bytes: u64,
    /// What a run will take on this machine, in words.
    pub predicted_time: String,
    pub warnings: Vec<Warning>,
    pub notes: Vec<Warning>,
}

/// Reads, calibrates, locates and unwraps, as a run would, and renders nothing.
pub fn check(shot: &ShotFile, context: &Context, watch: &dyn Watch) -> Result<Findings, RunError> {
    let mut first = shot.clone();
    let mut missing = Vec::new();
    let mut frames = 1;
    if let Some(list) = &shot.plate.frames {
        let files: Vec<PathBuf> = list.iter().map(|n| frame_path(&shot.plate.file, n)).collect();
        frames = files.len();
        missing = files
            .iter()
            .filter_map(|file| {
                let cause = super::pictures::readable(file).err()?;
                let shot = shot.path.display();
                Some(format!("{shot}: plate.file: {}: {cause}", file.display()))
            })
            .collect();
        first = list.iter().next().map_or(first, |frame| shot.at_frame(frame));
    }
    if !missing.is_empty() {
        return Err(RunError::Problems(missing));
    }
    let mut stopwatch = Stopwatch::new();
    stopwatch.begin("read the shot", watch);
    let mut plan = Plan::make(first).map_err(RunError::Problems)?;
    let prepared = prepare(&mut plan, &mut stopwatch, context, watch)?;
    let local = plan.support.iter().chain(&plan.local);
    let warnings = [&plan.warnings[..], &prepared.warnings[..]].concat();
    let (warnings, notes) = Warning::apart(warnings);
    Ok(Findings {
        shot: shot.path.clone(),
        inputs: plan.inputs.len(),
        frames,
        camera: prepared.camera_report,
        pose: prepared.pose_report,
        probe: prepared.probe_report,
        lights: prepared.lights_report,
        triangles: [
            plan.objects.iter().map(|model| model.n_triangles()).sum(),
            local.map(|model| model.n_triangles()).sum(),
        ],
        predicted_bytes: plan.predicted_bytes(),
        predicted_time: predicted_time(&plan),
        warnings,
        notes,
    })
}

/// A word on time, from rates measured on the truth scenes; a run's own first wave knows better.
fn predicted_time(plan: &Plan) -> String {
    if plan.objects.is_empty() {
        return "no rendering: the shot has no object".to_owned();
    }
    match plan.shot.render.stop {
        StopKeys::Time(seconds) => format!("{seconds:.0} s in all, as asked for"),
        StopKeys::Samples(samples) => {
            format!("{} of rendering", span(seconds(plan, f64::from(samples))))
        }
        StopKeys::Error(error) => {
            let samples = samples_for(error, plan.shot.render.denoise);
            format!("about {} of rendering", span(seconds(plan, samples)))
        }
    }
}

/// Samples a pixel with which the truth scenes reach an error of 1 %.
const SAMPLES_FOR_ONE_PERCENT: f64 = 250.0;

/// Samples a pixel for an error: noise falls with their root, and denoising takes its part.
fn samples_for(error: f64, denoise: DenoiseKeys) -> f64 {
    let sampled = match denoise {
        DenoiseKeys::Auto => EXPECTED_GAIN * error,
        DenoiseKeys::Off => error,
    };
    SAMPLES_FOR_ONE_PERCENT * (0.01 / sampled).powi(2)
}

/// Seconds on this machine's cores for `samples` in every pixel.
fn seconds(plan: &Plan, samples: f64) -> f64 {
    /// Camera samples of one core in a second.
    const RATE: f64 = 300_000.0;
    let pixels = plan.plate.linear.pixels().len() as f64;
    pixels * samples / RATE / rayon::current_num_threads() as f64
}

fn span(seconds: f64) -> String {
    match seconds {
        s if s < 10.0 => "a few seconds".to_owned(),
        s if s < 120.0 => format!("{:.0} s", (s / 10.0).round() * 10.0),
        s => format!("{:.0} minutes", s / 60.0),
    }
}

/// What was found, for a terminal.
impl std::fmt::Display for Findings {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        let sigma = self.camera.sigma_focal_px.map_or(String::new(), |s| format!(" ± {s:.2}"));
        writeln!(f, "{}: can run", self.shot.display())?;
        writeln!(f, "files    {} read, {} to render", self.inputs, frames(self.frames))?;
        writeln!(
            f,
            "camera   focal {:.1}{sigma} px ({})",
            self.camera.focal_px[0], self.camera.source
        )?;
        let slip = self.pose.slip_px.map_or("not known".to_owned(), |s| format!("± {s:.2} px"));
        writeln!(f, "pose     slip {slip} at the objects ({})", self.pose.source)?;
        writeln!(
            f,
            "probe    {:.0} % of the sphere seen ({})",
            100.0 * self.probe.seen_share,
            self.probe.source
        )?;
        for sun in &self.lights.suns {
            writeln!(
                f,
                "light    azimuth {:.1}°, elevation {:.1}°, irradiance {:.2}",
                sun.azimuth_deg, sun.elevation_deg, sun.irradiance[1]
            )?;
        }
        let [objects, local] = self.triangles;
        writeln!(f, "scene    {objects} triangles of objects, {local} of local things")?;
        write!(
            f,
            "needs    about {} MB, {}",
            self.predicted_bytes / 1_000_000,
            self.predicted_time
        )?;
        for warning in &self.warnings {
            write!(f, "\nwarning: {warning}")?;
        }
        for note in &self.notes {
            write!(f, "\nnote: {note}")?;
        }
        Ok(())
    }
}

fn frames(n: usize) -> String {
    if n == 1 { "1 frame".to_owned() } else { format!("{n} frames") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_denoised_needs_fewer_samples() {
        assert_eq!(samples_for(0.01, DenoiseKeys::Off), SAMPLES_FOR_ONE_PERCENT);
        let gain = samples_for(0.02, DenoiseKeys::Off) / samples_for(0.02, DenoiseKeys::Auto);
        assert!((gain - EXPECTED_GAIN.powi(2)).abs() < 1e-9, "{gain}");
    }
}
