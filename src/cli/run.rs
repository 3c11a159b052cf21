//! `platelight run`: one shot, from photographs to the finished picture.

use std::path::PathBuf;

use super::terminal::Terminal;
use super::{CliError, Global, Outcome, read_shot};
use crate::report::summary;
use crate::shot::batch::out_folder;
use crate::shot::run::{RunError, RunOptions, run_frames};
use crate::shot::stop::StopKeys;

/// Put the objects of a shot into its plate
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  platelight run shots/robot
  platelight run shots/robot/shot.toml --out renders/robot --error 0.005
  platelight run shots/robot --time 5m

Writes composite.exr (all layers), composite.png, camera.json, panorama.exr, report.json, report.html \
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
    #[arg(long, value_name = "SHARE", allow_negative_numbers = true)]
    error: Option<String>,
    /// Be done after this long in all (60, 60s, 5m, 2h): reading, preparing and writing are part of it
    #[arg(long, value_name = "TIME", allow_negative_numbers = true)]
    time: Option<String>,
    /// Stop after this many samples in every influenced pixel
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    samples: Option<String>,
}

impl Stop {
    /// What was asked for, if anything.
    pub fn keys(&self) -> Result<Option<StopKeys>, CliError> {
        let number = |text: &str| {
            text.trim().parse::<f64>().map_err(|_| format!("\"{text}\" is no number; write one"))
        };
        let (option, keys) = match (&self.error, &self.time, &self.samples) {
            (Some(text), ..) => ("--error", number(text).and_then(StopKeys::error)),
            (_, Some(text), _) => ("--time", StopKeys::time(text)),
            (.., Some(text)) => ("--samples", number(text).and_then(StopKeys::samples)),
            _ => return Ok(None),
        };
        keys.map(Some).map_err(|cause| CliError::wrong(format!("{option}: {cause}")))
    }
}

pub fn run(args: &Args, global: &Global) -> Result<Outcome, CliError> {
    let options = RunOptions { skip_existing: args.skip_existing, stop: args.stop.keys()? };
    let shot = read_shot(&args.shot)?;
    let out = args.out.clone().unwrap_or_else(|| out_folder(&shot.path, None));
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
