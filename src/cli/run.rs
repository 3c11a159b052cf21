//! `platelight run`: one shot, from photographs to the finished picture.

use std::path::PathBuf;

use super::terminal::Terminal;
use super::{CliError, Global, Outcome};
use crate::report::summary;
use crate::shot::ShotFile;
use crate::shot::batch::out_folder;
use crate::shot::file::{ERRORS, NO_ERROR, StopKeys};
use crate::shot::run::{RunError, RunOptions, run_frames};

/// Put the objects of a shot into its plate
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  platelight run shots/robot
  platelight run shots/robot/shot.toml --out renders/robot --error 0.005
  platelight run shots/robot --time 60

Writes composite.exr (all layers), composite.png, camera.json, panorama.exr, report.json, report.html
and overlays. A first composite is there seconds after the start and is replaced when it is finished.")]
pub struct Args {
    /// The shot file, or the folder that holds shot.toml
    shot: PathBuf,
    /// Folder for the results [default: out/ beside the shot file]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    #[command(flatten)]
    stop: Stop,
    /// Leave a shot alone whose results are complete and from the same inputs
    #[arg(long)]
    skip_existing: bool,
}

/// When to stop; goes before [render] of the shot file.
#[derive(Debug, Default, clap::Args)]
#[group(multiple = false)]
pub struct Stop {
    /// Stop at this error relative to the plate, for example 0.01
    #[arg(long, value_name = "SHARE")]
    error: Option<f64>,
    /// Be done after this many seconds in all: reading, preparing and writing are part of them
    #[arg(long, value_name = "SECONDS")]
    time: Option<f64>,
    /// Stop after this many samples in every influenced pixel
    #[arg(long, value_name = "N")]
    samples: Option<u32>,
}

impl Stop {
    /// What was asked for, if anything.
    pub fn keys(&self) -> Result<Option<StopKeys>, CliError> {
        let positive = |name: &str, value: f64| {
            if value.is_finite() && value > 0.0 {
                Ok(value)
            } else {
                Err(CliError::wrong(format!("--{name}: {value} is not above 0")))
            }
        };
        Ok(match (self.error, self.time, self.samples) {
            (Some(error), ..) if !ERRORS.contains(&error) => {
                return Err(CliError::wrong(format!("--error: {error} {NO_ERROR}")));
            }
            (Some(error), ..) => Some(StopKeys::Error(error)),
            (_, Some(time), _) => Some(StopKeys::Time(positive("time", time)?)),
            (.., Some(0)) => return Err(CliError::wrong("--samples: 0 samples show nothing")),
            (.., Some(samples)) => Some(StopKeys::Samples(samples)),
            _ => None,
        })
    }
}

pub fn run(args: &Args, global: &Global) -> Result<Outcome, CliError> {
    let shot = ShotFile::read(&args.shot)?;
    let out = args.out.clone().unwrap_or_else(|| out_folder(&shot.path, None));
    let options = RunOptions { skip_existing: args.skip_existing, stop: args.stop.keys()? };
    let terminal = Terminal::new(global);
    let frames = run_frames(&shot, &out, &options, &global.context(), &terminal);
    terminal.finish();

    let mut outcome = Outcome::Done;
    let mut problems = Vec::new();
    let mut reports = Vec::new();
    let n_frames = frames.len();
    for result in frames {
        match result {
            Ok(finished) => {
                if !finished.complete {
                    outcome = Outcome::Interrupted;
                }
                reports.extend(finished.report);
            }
            Err(RunError::Interrupted) => outcome = Outcome::Interrupted,
            Err(error) => problems.extend(error.problems()),
        }
    }
    if !problems.is_empty() && (reports.is_empty() || n_frames == 1) {
        return Err(CliError::several(problems));
    }
    for problem in &problems {
        global.warn(problem);
    }
    if !problems.is_empty() && outcome == Outcome::Done {
        outcome = Outcome::PartFailed;
    }
    match reports.as_slice() {
        [] if outcome == Outcome::Interrupted => return Err(CliError::interrupted()),
        [] => {}
        [report] => global.print(report, || summary(report)),
        _ => global.print(&reports, || format!("{} frames in {}", reports.len(), out.display())),
    }
    Ok(outcome)
}
