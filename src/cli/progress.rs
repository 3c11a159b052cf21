//! Progress bars: on a terminal only, on stderr, silent in pipes and when quiet.

use std::io::IsTerminal;
use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};

use super::Global;

/// A bar of `length` steps with the time left; it draws nothing in a pipe or when quiet.
///
/// The message names the stage. Use `bar.set_position`, `bar.inc` and `bar.finish_and_clear`.
pub fn progress_bar(global: &Global, stage: &str, length: u64) -> ProgressBar {
    if global.quiet || !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let style = ProgressStyle::with_template("{msg:28} {wide_bar} {percent:>3} %  {eta} left")
        .unwrap_or_else(|_| ProgressStyle::default_bar());
    let bar = ProgressBar::new(length).with_style(style).with_message(stage.to_owned());
    bar.enable_steady_tick(Duration::from_millis(200));
    bar
}
