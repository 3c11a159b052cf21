//! What a run tells while it works, and the clock it works against.

use std::time::Instant;

use crate::report::{Stage, Warning};

/// Somebody who is told how a run goes on: a terminal, a log, nobody.
pub trait Watch: Sync {
    /// A stage of the work begins.
    fn stage(&self, name: &str);
    /// `done` of 1 of the rendering is finished; `error` relative to the plate is reached.
    fn progress(&self, done: f64, error: f64);
    /// Something may be wrong with the picture.
    fn warning(&self, warning: &Warning);
    /// A file is on disk.
    fn written(&self, path: &std::path::Path);
}

/// Nobody listens.
pub struct Silent;

impl Watch for Silent {
    fn stage(&self, _name: &str) {}
    fn progress(&self, _done: f64, _error: f64) {}
    fn warning(&self, _warning: &Warning) {}
    fn written(&self, _path: &std::path::Path) {}
}

/// Times the stages of a run.
pub struct Stopwatch {
    begun: (Instant, Option<f64>),
    stages: Vec<Stage>,
    current: Option<(String, Instant, Option<f64>)>,
}

impl Stopwatch {
    pub fn new() -> Self {
        Self { begun: (Instant::now(), cpu_seconds()), stages: Vec::new(), current: None }
    }

    /// Seconds on the clock since it was made, and of all cores together.
    pub fn elapsed(&self) -> (f64, Option<f64>) {
        let (begun, cpu_begun) = self.begun;
        let worked = cpu_seconds().zip(cpu_begun).map(|(now, begun)| now - begun);
        (begun.elapsed().as_secs_f64(), worked)
    }

    /// Ends the stage before and begins one.
    pub fn begin(&mut self, name: &str, watch: &dyn Watch) {
        self.end();
        watch.stage(name);
        self.current = Some((name.to_owned(), Instant::now(), cpu_seconds()));
    }

    fn end(&mut self) {
        if let Some((name, start, cpu_start)) = self.current.take() {
            let cpu = cpu_seconds().zip(cpu_start).map(|(now, start)| now - start);
            let seconds = start.elapsed().as_secs_f64();
            self.stages.push(Stage { name, seconds, cpu_seconds: cpu });
        }
    }

    /// All stages; the current one ends now.
    pub fn finish(&mut self) -> Vec<Stage> {
        self.end();
        self.stages.clone()
    }
}

impl Default for Stopwatch {
    fn default() -> Self {
        Self::new()
    }
}

/// Seconds all cores together have worked for this program; `None` where the system does not say.
///
/// Linux: user and system time of /proc/self/stat, in ticks of 10 ms (USER_HZ is 100 on every
/// architecture Rust's standard library supports).
pub fn cpu_seconds() -> Option<f64> {
    const TICKS_PER_SECOND: f64 = 100.0;
    let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
    // The program's name stands in brackets and may hold anything; fields are counted behind it.
    let mut fields = stat.rsplit_once(')')?.1.split_ascii_whitespace().skip(11);
    let user: f64 = fields.next()?.parse().ok()?;
    let system: f64 = fields.next()?.parse().ok()?;
    Some((user + system) / TICKS_PER_SECOND)
}

/// Seconds that the threads which are still there have worked; finer than [`cpu_seconds`], for the
/// difference of two moments between which no thread ends. `None` where the system does not say.
///
/// Linux: time on a processor of every /proc/self/task/*/schedstat, nanoseconds; of a thread at work
/// as of the last tick of the clock (1 to 10 ms).
pub fn thread_seconds() -> Option<f64> {
    let mut sum = 0.0;
    for task in std::fs::read_dir("/proc/self/task").ok()? {
        // A thread may end meanwhile.
        let Ok(stat) = std::fs::read_to_string(task.ok()?.path().join("schedstat")) else {
            continue;
        };
        sum += stat.split_ascii_whitespace().next()?.parse::<f64>().ok()?;
    }
    (sum > 0.0).then_some(1e-9 * sum)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stages_are_timed_in_order() {
        let mut stopwatch = Stopwatch::new();
        stopwatch.begin("calibrate", &Silent);
        stopwatch.begin("render", &Silent);
        let stages = stopwatch.finish();
        let names: Vec<&str> = stages.iter().map(|stage| stage.name.as_str()).collect();
        assert_eq!(names, ["calibrate", "render"]);
    }

    /// Works until `clock` has gone on by 30 ms: on a busy machine that takes longer than on an idle
    /// one, but no machine keeps a program waiting for a minute.
    #[cfg(target_os = "linux")]
    fn work_until_it_shows(clock: impl Fn() -> Option<f64>) {
        let Some(start) = clock() else { return };
        let wall = Instant::now();
        let mut x = 0_u64;
        while clock().expect("it said before") - start < 0.03 {
            assert!(wall.elapsed().as_secs() < 60, "a minute of work took less than 30 CPU ms");
            for _ in 0..1_000_000 {
                x = std::hint::black_box(x.wrapping_mul(31).wrapping_add(7));
            }
        }
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn cpu_time_grows_with_work() {
        assert!(cpu_seconds().is_some(), "Linux says");
        work_until_it_shows(cpu_seconds);
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn the_finer_clock_grows_with_work() {
        work_until_it_shows(thread_seconds);
    }
}
