//! What a command says when it cannot do what was asked.

use std::error::Error;

/// One or more sentences for the person at the terminal: file or key, what was found, what to do.
///
/// Made from any room's error by `?`. Several problems found together are told together.
#[derive(Debug)]
pub struct CliError {
    problems: Vec<String>,
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
