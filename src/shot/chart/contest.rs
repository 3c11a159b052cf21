//! All methods in turn, each time for about four times the work, until the time is over.

use std::time::Instant;

use super::after;
use super::bench::Bench;
use super::methods::Row;
use super::pictures::{Crop, Window};
use crate::render::compare::Region;
use crate::render::{Context, Stop};
use crate::report::chart::{Curve, Point};
use crate::shot::run::RunError;
use crate::shot::watch::Watch;

/// Below this many times the reference's own error a method is not followed.
const ABOVE_REFERENCE: f64 = 2.0;

/// A row on its way.
struct Run {
    row: Row,
    points: Vec<Point>,
    crops: Vec<Crop>,
    /// Error to ask for next.
    target: f64,
    /// What that may take, seconds on the clock; `None` before the first.
    expected: Option<f64>,
    ended: bool,
}

/// All rows, in turn, until the time is over.
pub struct Contest<'a> {
    pub bench: &'a Bench<'a>,
    pub region: &'a Region,
    pub window: Window,
    pub end: Instant,
    pub context: &'a Context,
}

impl Contest<'_> {
    /// Every row's renderings in the order of their cost, with the crops of them.
    ///
    /// # Errors
    /// [`RunError::Interrupted`] where the context was cancelled before every row had its first.
    pub fn hold(
        &self,
        rows: Vec<Row>,
        watch: &dyn Watch,
    ) -> Result<Vec<(Curve, Vec<Crop>)>, RunError> {
        let mut runs: Vec<Run> = rows.into_iter().map(Run::new).collect();
        self.go_round(&mut runs, watch)?;
        Ok(runs.into_iter().filter(|run| !run.points.is_empty()).map(Run::finish).collect())
    }

    fn go_round(&self, runs: &mut [Run], watch: &dyn Watch) -> Result<(), RunError> {
        let whole = self.left().max(1e-3);
        let mut first = true;
        while runs.iter().any(|run| !run.ended) {
            for k in 0..runs.len() {
                let going = runs.iter().filter(|run| !run.ended).count();
                let run = &mut runs[k];
                // What is left is shared by those that go on; the first rendering is everybody's.
                let share = self.left() / going.max(1) as f64;
                if !run.ended && !first && run.expected.is_some_and(|seconds| seconds > share) {
                    run.ended = true;
                }
                if !run.ended {
                    let allowed = if first { f64::INFINITY } else { 2.0 * share };
                    self.step(run, allowed)?;
                }
                if self.context.is_cancelled() {
                    return if first { Err(RunError::Interrupted) } else { Ok(()) };
                }
                let error = runs[k].points.last().map_or(0.0, |point| point.stated);
                watch.progress((1.0 - self.left() / whole).clamp(0.0, 1.0), error);
            }
            first = false;
        }
        Ok(())
    }

    fn left(&self) -> f64 {
        self.end.saturating_duration_since(Instant::now()).as_secs_f64()
    }

    /// One rendering more, and the next one's aim.
    fn step(&self, run: &mut Run, allowed: f64) -> Result<(), RunError> {
        let context = self.context.until(after(allowed));
        let rendering = self.bench.render(&run.row, Stop::Error(run.target), &context, None)?;
        let Some(rendering) = rendering else {
            run.ended = true;
            return Ok(());
        };
        let point = rendering.point(self.region);
        let enough = point.error.is_none()
            || rendering.stated < ABOVE_REFERENCE * self.region.own_error
            || rendering.stated <= 0.0;
        run.target = 0.5 * run.target.min(rendering.stated);
        run.expected = Some(rendering.setup_seconds + 4.0 * rendering.seconds);
        run.ended = enough;
        run.crops.push(self.window.crop(&rendering, self.bench.plate()));
        run.points.push(point);
        Ok(())
    }
}

impl Run {
    fn new(row: Row) -> Self {
        let (points, crops) = (Vec::new(), Vec::new());
        Self { row, points, crops, target: 1.0, expected: None, ended: false }
    }

    fn finish(self) -> (Curve, Vec<Crop>) {
        let Row { name, group, does, bias, .. } = self.row;
        (Curve { name, group, does, bias, points: self.points }, self.crops)
    }
}
