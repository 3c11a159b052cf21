//! A run's progress on the terminal: a bar with the time left while rendering, lines otherwise.

use std::path::Path;
use std::sync::Mutex;

use indicatif::ProgressBar;

use super::{Global, progress_bar};
use crate::report::Warning;
use crate::shot::watch::Watch;

/// Steps of the bar: fine enough to move every second of a long render.
const STEPS: f64 = 1000.0;

/// Tells stderr, unless quiet.
pub struct Terminal<'a> {
    global: &'a Global,
    bar: Mutex<Option<ProgressBar>>,
}

impl<'a> Terminal<'a> {
    pub fn new(global: &'a Global) -> Self {
        Self { global, bar: Mutex::new(None) }
    }

    /// Takes the bar away.
    pub fn finish(&self) {
        self.swap_bar(None);
    }

    /// Says a line beside the bar.
    pub fn say(&self, line: &str) {
        let bar = self.bar.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        match bar.as_ref().filter(|bar| !bar.is_hidden()) {
            Some(bar) => bar.suspend(|| self.global.say(line)),
            None => self.global.say(line),
        }
    }

    fn swap_bar(&self, new: Option<ProgressBar>) {
        let mut bar = self.bar.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        if let Some(old) = std::mem::replace(&mut *bar, new) {
            old.finish_and_clear();
        }
    }
}

impl Watch for Terminal<'_> {
    fn stage(&self, name: &str) {
        self.swap_bar(Some(progress_bar(self.global, name, STEPS as u64)));
    }

    fn progress(&self, done: f64, error: f64) {
        let bar = self.bar.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        if let Some(bar) = &*bar {
            bar.set_position((done.clamp(0.0, 1.0) * STEPS) as u64);
            bar.set_message(format!("render, error {:.2} %", 100.0 * error));
        }
    }

    fn warning(&self, warning: &Warning) {
        self.say(&format!("warning: {warning}"));
    }

    fn written(&self, path: &Path) {
        self.say(&format!("wrote {}", path.display()));
    }
}
