//! The program as users start it.

use std::path::Path;
use std::process::Output;

use assert_cmd::Command;

/// Runs `platelight` with these arguments to its end.
pub fn platelight(arguments: &[&str]) -> Output {
    Command::cargo_bin("platelight")
        .expect("the program is built")
        .args(arguments)
        .output()
        .expect("the program starts")
}

/// A temporary path as an argument.
pub fn text(path: &Path) -> &str {
    path.to_str().expect("temporary paths are text")
}
