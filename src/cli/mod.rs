//! The command line: one file a command.
//!
//! arguments → a call into [`shot`](crate::shot) or one stage → an [`Outcome`] → the exit code.
//! A command is a file here with `Args`, `run(&Args, &Global)`, and one line in each of the two
//! lists below. Results go to stdout, everything said to a person on the way to stderr.
//! This room computes nothing.

mod batch;
mod calibrate;
mod chart;
mod check;
mod error;
mod folder;
mod interrupt;
mod locate;
mod merge;
mod outputs;
mod panorama;
mod preview;
mod progress;
mod run;
mod sky;
mod targets;
mod terminal;

pub use error::CliError;
pub use progress::progress_bar;

use std::io::Write;
use std::path::Path;
use std::process::ExitCode;

use clap::{Parser, Subcommand};
use serde::Serialize;

use crate::render::Context;
use crate::report::Warning;
use crate::shot::ShotFile;
use crate::trace;

/// Put CG objects into photographs, and be told how right the result is.
#[derive(Debug, Parser)]
#[command(
    name = "platelight",
    version,
    propagate_version = true,
    arg_required_else_help = true,
    after_help = "Example:\n  platelight check shots/robot\n  platelight run shots/robot --out renders/robot\n\n\
                  Exit codes: 0 done, 1 part of a batch failed, 2 the request was wrong (nothing written) \
                  or a result could not be written, 130 interrupted (Ctrl-C: a picture that is there is \
                  written, else nothing; a second Ctrl-C ends at once)."
)]
struct Cli {
    #[command(flatten)]
    global: Global,
    #[command(subcommand)]
    command: Command,
}

/// What every command understands.
#[derive(Clone, Debug, clap::Args)]
pub struct Global {
    /// Threads to use; the result does not depend on it [default: all cores]
    #[arg(long, global = true, value_name = "N", help_heading = "Everywhere")]
    pub threads: Option<usize>,
    /// Seed of all random numbers: same input and seed, same bytes
    #[arg(long, global = true, value_name = "N", default_value_t = 0, help_heading = "Everywhere")]
    pub seed: u64,
    /// Trace rays without AVX2: the same picture, more slowly
    #[arg(long, global = true, help_heading = "Everywhere")]
    pub portable: bool,
    /// Print the result as JSON on stdout
    #[arg(long, global = true, help_heading = "Everywhere")]
    pub json: bool,
    /// Say nothing but errors
    #[arg(long, short, global = true, help_heading = "Everywhere")]
    pub quiet: bool,
    /// Cancelled by Ctrl-C; see [`interrupt`].
    #[arg(skip)]
    interrupted: Context,
}

impl Global {
    /// What long computations are given.
    pub fn context(&self) -> Context {
        self.interrupted.with_seed(self.seed)
    }

    /// To be asked between the steps of a command, and before anything is written.
    ///
    /// # Errors
    /// The user wants no more of it.
    fn go_on(&self) -> Result<(), CliError> {
        if self.interrupted.is_cancelled() { Err(CliError::interrupted()) } else { Ok(()) }
    }

    /// Prints a command's result on stdout: as JSON if that was asked for, else as `text`.
    pub fn print(&self, value: &impl Serialize, text: impl FnOnce() -> String) {
        if self.json {
            // Serialising plain structs to memory fails only for maps with keys that are no strings.
            let json = serde_json::to_string_pretty(value)
                .unwrap_or_else(|e| serde_json::json!({ "errors": [e.to_string()] }).to_string());
            print_line(&json);
        } else if !self.quiet {
            print_line(&text());
        }
    }

    /// Says something on the way, on stderr, unless quiet.
    pub fn say(&self, message: &str) {
        if !self.quiet {
            say_line(message);
        }
    }

    /// Says a warning on stderr, unless quiet.
    pub fn warn(&self, message: &str) {
        self.say(&format!("warning: {message}"));
    }

    /// Says a room's warnings, and its notes as such, on stderr, unless quiet.
    pub fn tell(&self, warnings: &[Warning]) {
        for warning in warnings {
            let word = if warning.asks { "warning" } else { "note" };
            self.say(&format!("{word}: {warning}"));
        }
    }
}

/// Prints a line on stdout.
///
/// Not `println!`, which panics where nobody reads on (`platelight … --json | head -1`): what is not
/// read is not missed, and the files that were to be written are.
pub(crate) fn print_line(line: &str) {
    let mut stdout = std::io::stdout().lock();
    if let Err(error) = writeln!(stdout, "{line}").and_then(|()| stdout.flush())
        && error.kind() != std::io::ErrorKind::BrokenPipe
    {
        say_line(&format!("error: standard output: {error}; the result was not printed"));
    }
}

/// Prints a line on stderr, if anybody still reads there; who does not cannot be told.
pub(crate) fn say_line(line: &str) {
    let _ = writeln!(std::io::stderr().lock(), "{line}");
}

/// The commands; each has its file.
#[derive(Debug, Subcommand)]
enum Command {
    Run(run::Args),
    Check(check::Args),
    Chart(chart::Args),
    Batch(batch::Args),
    Calibrate(calibrate::Args),
    Locate(locate::Args),
    Merge(merge::Args),
    // In a box: it has twice as many options as the next.
    Panorama(Box<panorama::Args>),
    Preview(preview::Args),
    Sky(sky::Args),
    Targets(targets::Args),
}

/// Runs the command with its arguments.
fn dispatch(command: &Command, global: &Global) -> Result<Outcome, CliError> {
    match command {
        Command::Run(args) => run::run(args, global),
        Command::Check(args) => check::run(args, global),
        Command::Chart(args) => chart::run(args, global),
        Command::Batch(args) => batch::run(args, global),
        Command::Calibrate(args) => calibrate::run(args, global),
        Command::Locate(args) => locate::run(args, global),
        Command::Merge(args) => merge::run(args, global),
        Command::Panorama(args) => panorama::run(args, global),
        Command::Preview(args) => preview::run(args, global),
        Command::Sky(args) => sky::run(args, global),
        Command::Targets(args) => targets::run(args, global),
    }
}

/// The shot file, or the one in this folder, with its defaults.
fn read_shot(path: &Path) -> Result<ShotFile, CliError> {
    ShotFile::read(path).map_err(|error| CliError::several(error.problems()))
}

/// How a command ended, when it was not an error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    Done,
    /// Some shots or frames of several failed; the others were written.
    PartFailed,
    /// Stopped by the user; what was finished before is there.
    Interrupted,
}

impl Outcome {
    fn code(self) -> u8 {
        match self {
            Self::Done => 0,
            Self::PartFailed => 1,
            Self::Interrupted => 130,
        }
    }
}

/// Parses the arguments, runs the command in a pool of `--threads`, and prints what went wrong.
pub fn main() -> ExitCode {
    let Cli { global, command } = Cli::parse();
    if let Err(error) = interrupt::cancel_on_signals(&global.interrupted) {
        global.warn(&format!("Ctrl-C may leave half-written files: {error}"));
    }
    if global.portable {
        trace::portable_only();
    }
    let outcome = in_pool(&global, || dispatch(&command, &global));
    match outcome {
        Ok(outcome) => ExitCode::from(outcome.code()),
        Err(error) => {
            error.print(global.json);
            ExitCode::from(error.code())
        }
    }
}

/// More than any machine has cores; each thread takes memory for its stack.
const MOST_THREADS: usize = 1024;

/// Runs `work` where rayon uses the threads that were asked for.
fn in_pool<T: Send>(
    global: &Global,
    work: impl FnOnce() -> Result<T, CliError> + Send,
) -> Result<T, CliError> {
    let threads = match global.threads {
        Some(n) if !(1..=MOST_THREADS).contains(&n) => {
            return Err(CliError::wrong(format!(
                "--threads: {n} is not between 1 and {MOST_THREADS}; leave it out to use all cores"
            )));
        }
        Some(n) => n,
        // RAYON_NUM_THREADS or all cores, as rayon alone would; the variable has the same limit.
        None => {
            let wished = std::env::var("RAYON_NUM_THREADS").ok().and_then(|n| n.parse().ok());
            wished.map_or(0, |n: usize| n.min(MOST_THREADS))
        }
    };
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        // Readers and builders of trees recurse; 8 MB is what a program's first thread has.
        .stack_size(8 << 20)
        .build()
        .map_err(|e| CliError::wrong(format!("--threads: {e}; ask for fewer threads")))?;
    pool.install(work)
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    /// Terminals wrap what is longer, and a wrapped example is not what is to be typed; a paragraph that
    /// is broken by hand is broken again by a terminal of another width.
    #[test]
    fn examples_fit_a_terminal_and_paragraphs_are_left_to_it() {
        const NARROW: usize = 80;
        let program = Cli::command();
        for command in std::iter::once(&program).chain(program.get_subcommands()) {
            let Some(help) = command.get_after_help() else { continue };
            let (help, name) = (help.to_string(), command.get_name());
            let lines: Vec<&str> = help.lines().collect();
            for (k, line) in lines.iter().enumerate() {
                let next = lines.get(k + 1).copied().unwrap_or_default();
                if line.starts_with(' ') {
                    assert!(line.chars().count() <= NARROW, "{name}: {line}");
                } else if !line.is_empty() {
                    assert!(next.is_empty() || next.starts_with(' '), "{name}: {line}\n{next}");
                }
            }
        }
    }
}
