//! `platelight check`: everything that can be wrong with a shot, before any rendering.

use std::path::PathBuf;

use super::terminal::Terminal;
use super::{CliError, Global, Outcome, read_shot};
use crate::shot::check;

/// Find everything that is wrong with a shot, without rendering
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  platelight check shots/robot
  platelight check shots/robot --json

Reads every file, calibrates, finds tags, boards and the ball, and predicts memory and time. \
Writes nothing. Exit code 0 if the shot can run, 2 if not. Problems come in up to three rounds, all \
of a round together: the text and missing files, what is in the files, what the photographs show.")]
pub struct Args {
    /// The shot file, or the folder that holds shot.toml
    shot: PathBuf,
}

pub fn run(args: &Args, global: &Global) -> Result<Outcome, CliError> {
    let shot = read_shot(&args.shot)?;
    let terminal = Terminal::new(global);
    let findings = check::check(&shot, &global.context(), &terminal);
    terminal.finish();
    global.go_on()?;
    let findings = findings.map_err(|error| CliError::several(error.problems()))?;
    global.print(&findings, || findings.to_string());
    Ok(Outcome::Done)
}
