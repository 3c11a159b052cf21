//! All methods in turn, each time for about four times the work, until the time is over.

use std::time::Instant;

use super::after;
use super::bench::{Aim, Bench, Rendering};
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
    /// What to aim at next, and the error that is hoped for.
    aim: Aim,
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
            for run in runs.iter_mut().filter(|run| !run.ended) {
                self.step(run)?;
                if self.context.is_cancelled() {
                    return if first { Err(RunError::Interrupted) } else { Ok(()) };
                }
                let error = run.points.last().map_or(0.0, |point| point.stated);
                watch.progress((1.0 - self.left() / whole).clamp(0.0, 1.0), error);
            }
            end_what_does_not_fit(runs, self.left());
            first = false;
        }
        Ok(())
    }

    fn left(&self) -> f64 {
        self.end.saturating_duration_since(Instant::now()).as_secs_f64()
    }

    /// One rendering more, and the next one's aim.
    fn step(&self, run: &mut Run) -> Result<(), RunError> {
        // The first is everybody's; later ones may be dearer than was thought, within what is left
        let allowed = run.expected.map(|expected| (2.0 * expected).min(self.left().max(expected)));
        let context = self.context.until(allowed.and_then(after));
        let rendering = self.bench.render(&run.row, run.aim, &context, None)?;
        let Some(rendering) = rendering else {
            run.ended = true;
            return Ok(());
        };
        let point = rendering.point(self.region);
        let enough = point.error.is_none()
            || rendering.stated < ABOVE_REFERENCE * self.region.own_error
            || rendering.stated <= 0.0;
        run.target = 0.5 * run.target.min(rendering.stated);
        run.aim = Aim::Stop(Stop::Error(run.target));
        let Rendering { setup_seconds, first_wave_seconds, seconds, .. } = rendering;
        // Half the error takes four times the samples, after the same beginnings
        let times = (rendering.stated / run.target).powi(2);
        let sampling = times * (seconds - first_wave_seconds);
        run.expected = Some(setup_seconds + first_wave_seconds + sampling);
        run.ended = enough;
        run.crops.push(self.window.crop(&rendering, self.bench.plate()));
        run.points.push(point);
        Ok(())
    }
}

/// Ends the runs whose next renderings have no room in `left` seconds beside all cheaper ones.
fn end_what_does_not_fit(runs: &mut [Run], left: f64) {
    let mut going: Vec<&mut Run> = runs.iter_mut().filter(|run| !run.ended).collect();
    let cost = |run: &Run| run.expected.unwrap_or(0.0);
    going.sort_by(|a, b| cost(a).total_cmp(&cost(b)));
    let mut taken = 0.0;
    for run in going {
        taken += cost(run);
        run.ended = taken > left;
    }
}

impl Run {
    fn new(row: Row) -> Self {
        let (points, crops) = (Vec::new(), Vec::new());
        Self { row, points, crops, aim: Aim::Least, target: 1.0, expected: None, ended: false }
    }

    fn finish(self) -> (Curve, Vec<Crop>) {
        let Row { name, group, does, bias, .. } = self.row;
        (Curve { name, group, does, bias, points: self.points }, self.crops)
    }
}

#[cfg(test)]
mod tests {
    use super::super::methods::all;
    use super::*;

    #[test]
    fn the_cheapest_go_on_while_there_is_time_for_all_of_them() {
        let mut runs: Vec<Run> = all().into_iter().take(4).map(Run::new).collect();
        for (run, seconds) in runs.iter_mut().zip([5.0, 1.0, 2.0, 3.0]) {
            run.expected = Some(seconds);
        }
        end_what_does_not_fit(&mut runs, 6.5);
        let ended = |runs: &[Run]| runs.iter().map(|run| run.ended).collect::<Vec<_>>();
        assert_eq!(ended(&runs), [true, false, false, false]);
        end_what_does_not_fit(&mut runs, 2.0);
        assert_eq!(ended(&runs), [true, false, true, true]);
        end_what_does_not_fit(&mut runs, 0.0);
        assert!(runs.iter().all(|run| run.ended));
    }
}
