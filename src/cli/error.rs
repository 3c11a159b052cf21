//! What a command says when it cannot do what was asked.

use std::error::Error;

use super::Outcome;

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

    /// The problems in one line, for a result among others.
    pub fn sentence(&self) -> String {
        self.problems.join("; ")
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
