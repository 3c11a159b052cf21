//! `platelight batch`: folders of shots, one after the other.

use std::path::PathBuf;

use super::run::Stop;
use super::terminal::Terminal;
use super::{CliError, Global, Outcome};
use crate::shot::batch::{Status, find_shots, run_batch, table, write_summary};
use crate::shot::run::{RunOptions, check_folder};

/// Run every shot in some folders; a bad one stops nothing
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  platelight batch shots
  platelight batch shots/robot shots/teapot --out renders --skip-existing

Every shot's results go into out/ beside its shot file, or with --out into DIR/<name of its folder>. \
A summary goes to stdout and to batch.json. Exit code 0 if all shots are done, 1 if some shots or \
frames failed, 2 if all failed or nothing could begin.")]
pub struct Args {
    /// Folders that hold shot.toml, or folders of such folders
    #[arg(required = true)]
    folders: Vec<PathBuf>,
    /// Folder for the results and batch.json [default: out/ beside each shot, batch.json in the
    /// first folder named]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    #[command(flatten)]
    stop: Stop,
    /// Leave shots alone whose results are complete and from the same inputs
    #[arg(long)]
    skip_existing: bool,
}

pub fn run(args: &Args, global: &Global) -> Result<Outcome, CliError> {
    let options = RunOptions { skip_existing: args.skip_existing, stop: args.stop.keys()? };
    let shots = find_shots(&args.folders, args.out.as_deref())?;
    let summary_folder = args.out.as_ref().or(args.folders.first());
    if let Some(folder) = summary_folder {
        check_folder(folder)?;
    }
    let terminal = Terminal::new(global);
    let tell = |result: &crate::shot::batch::ShotResult| {
        terminal.say(&format!("{:?}: {}", result.status, result.shot.display()));
    };
    let results =
        run_batch(&shots, args.out.as_deref(), &options, &global.context(), &terminal, tell);
    terminal.finish();

    let count = |status| results.iter().filter(|r| r.status == status).count();
    let (failed, part) = (count(Status::Failed), count(Status::Part));
    let interrupted =
        results.len() < shots.len() || results.iter().any(|r| r.status == Status::Interrupted);
    // Nothing was written by shots that all failed, so no summary is either: exit code 2.
    if failed == shots.len() {
        let problems = results.into_iter().flat_map(|r| r.problems).collect();
        return Err(CliError::several(problems));
    }
    if let Some(folder) = summary_folder.filter(|folder| folder.is_dir()) {
        write_summary(&folder.join("batch.json"), &results)?;
    }
    global.print(&results, || table(&results));
    Ok(match (interrupted, failed + part) {
        (true, _) => Outcome::Interrupted,
        (_, 0) => Outcome::Done,
        _ => Outcome::PartFailed,
    })
}
