//! What a command says when it cannot do what was asked.

use std::error::Error;
use std::path::Path;

/// One or more sentences for the person at the terminal: file or key, what was found, what to do.
///
/// Made from any room's error by `?`. Several problems found together are told together.
#[derive(Debug)]
pub struct CliError {
    problems: Vec<String>,
}

/// Refuses to write over a file that is read, or twice to one file.
pub(super) fn refuse_to_overwrite(inputs: &[&Path], outputs: &[&Path]) -> Result<(), CliError> {
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
    }
    Ok(())
}

impl CliError {
    /// The exit code of every error: the request was wrong, or could not be carried out.
    pub const CODE: u8 = 2;

    /// A problem found by the command line itself.
    pub fn wrong(problem: impl Into<String>) -> Self {
        Self { problems: vec![problem.into()] }
    }

    /// Problems that were found together.
    pub fn several(problems: Vec<String>) -> Self {
        Self { problems }
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
