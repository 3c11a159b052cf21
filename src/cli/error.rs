//! What a command says when it cannot do what was asked.

use std::collections::HashSet;
use std::error::Error;
use std::path::{Path, PathBuf};

use super::Outcome;
use crate::photo::atomic;

/// One or more sentences for the person at the terminal: file or key, what was found, what to do.
///
/// Made from any room's error by `?`. Several problems found together are told together.
#[derive(Debug)]
pub struct CliError {
    problems: Vec<String>,
    outcome: Ended,
}

/// How a command ended that wrote nothing.
#[derive(Clone, Copy, Debug)]
enum Ended {
    Wrong,
    Interrupted,
}

/// Refuses, before any work, to write over a file that is read, twice to one file, or where nothing
/// can be written.
pub(super) fn check_outputs(inputs: &[&Path], outputs: &[&Path]) -> Result<(), CliError> {
    let place = |path: &Path| std::fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    for (i, output) in outputs.iter().enumerate() {
        let taken = place(output);
        if inputs.iter().any(|input| place(input) == taken) {
            let path = output.display();
            return Err(CliError::wrong(format!(
                "{path}: is read and would be overwritten; name another file to write"
            )));
        }
        if outputs[..i].iter().any(|other| place(other) == taken) {
            let path = output.display();
            return Err(CliError::wrong(format!("{path}: is named twice to be written")));
        }
        if let Err(cause) = atomic::check(output) {
            let path = output.display();
            return Err(CliError::wrong(format!(
                "{path}: cannot be written: {cause}; name a file in a folder that takes files"
            )));
        }
    }
    Ok(())
}

/// A photograph named twice would count as two views.
pub(super) fn refuse_repeated(inputs: &[PathBuf]) -> Result<(), CliError> {
    let mut seen = HashSet::new();
    let place = |path: &Path| std::fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    match inputs.iter().find(|input| !seen.insert(place(input))) {
        None => Ok(()),
        Some(twice) => {
            let path = twice.display();
            Err(CliError::wrong(format!("{path}: is named twice; name each photograph once")))
        }
    }
}

/// A name's ending must be that of what is written: a picture named otherwise is opened as what it
/// is not.
pub(super) fn check_ending(out: &Path, ending: &str) -> Result<(), CliError> {
    if out.extension().is_some_and(|found| found.eq_ignore_ascii_case(ending)) {
        return Ok(());
    }
    let (path, better) = (out.display(), out.with_extension(ending));
    Err(CliError::wrong(format!(
        "{path}: the name must end in .{ending}, which is what is written; name it {}",
        better.display()
    )))
}

impl CliError {
    /// 2: the request was wrong, or could not be carried out. 130: the user stopped it.
    pub fn code(&self) -> u8 {
        match self.outcome {
            Ended::Wrong => 2,
            Ended::Interrupted => Outcome::Interrupted.code(),
        }
    }

    /// Stopped by the user before there was anything to write.
    pub fn interrupted() -> Self {
        let said = "stopped before there was a result; nothing was written";
        Self { problems: vec![said.to_owned()], outcome: Ended::Interrupted }
    }

    /// A problem found by the command line itself.
    pub fn wrong(problem: impl Into<String>) -> Self {
        Self::several(vec![problem.into()])
    }

    /// Problems that were found together.
    pub fn several(problems: Vec<String>) -> Self {
        Self { problems, outcome: Ended::Wrong }
    }

    /// Prints the problems to stderr, and with `json` also as `{"errors": […]}` to stdout.
    pub fn print(&self, json: bool) {
        for problem in &self.problems {
            super::say_line(&format!("error: {problem}"));
        }
        if json {
            super::print_line(&serde_json::json!({ "errors": self.problems }).to_string());
        }
    }
}

impl<E: Error> From<E> for CliError {
    fn from(error: E) -> Self {
        Self::wrong(error.to_string())
    }
}
