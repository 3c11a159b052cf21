//! `platelight chart`: what a second of work buys on this very shot, method by method.
//!
//! shot → prepared as for [`run`](super::run) → a picture small enough to render often → the best
//! rendering that the time allows as reference → every method in turn, each time for about four times
//! the work, so that whatever else the machine does meets all of them alike → chart.csv, .svg, .png,
//! .html and crops.png. The reference is the default method's own: an error that all methods share is
//! not seen.

mod bench;
mod methods;
mod pictures;

pub use methods::{Row, all, named};

use std::path::Path;
use std::time::{Duration, Instant};

use bench::{Bench, Limit, Rendering};
use methods::{AUTO, Decision, without_repeats};
use pictures::{Crop, Window};

use super::existing::PROGRAM;
use super::file::{DenoiseKeys, ShotFile};
use super::frames::frame_path;
use super::plan::Plan;
use super::prepare::{Prepared, method_name, prepare};
use super::run::{RunError, check_folder};
use super::stop::StopKeys;
use super::watch::{Stopwatch, Watch};
use crate::render::compare::Region;
use crate::render::{Blocked, Context, Method, Stop, Technique};
use crate::report::chart::{Chart, Curve, Group, Point, Reference, Verdict};
use crate::report::shot_name;

/// What to chart.
#[derive(Clone, Debug)]
pub struct ChartOptions {
    /// For all of it, preparation and writing included.
    pub seconds: f64,
    /// Beside the shot's own settings.
    pub rows: Vec<Row>,
    /// Pixels of the plate that become one, across and down; `None`: what fits the time.
    pub reduced: Option<usize>,
}

/// Seconds kept for drawing and writing.
const WRITING: f64 = 1.5;
/// Share of the time for rendering that the reference gets. With the rest shared by twenty methods the
/// reference has thirty times the work of each.
const REFERENCE_SHARE: f64 = 0.55;
/// Less shows nothing, on however small a picture.
const LEAST_REFERENCE: f64 = 2.0;
/// The most that the shot's own stopping rule gets.
const CHOSEN_SHARE: f64 = 0.15;
/// A method should fit at least this many least renderings, and scenes built for them, into its time:
/// steps of about four times the work each.
const RENDERINGS: f64 = 22.0;
const SETUPS: f64 = 4.0;
/// Pictures narrower than this show no shadow any more.
const LEAST_WIDTH: usize = 96;
/// Width of the picture that is rendered to see what rendering costs.
const SCOUT_WIDTH: usize = 160;
/// Below this many times the reference's own error a method is not followed.
const ABOVE_REFERENCE: f64 = 2.0;
/// The reference draws other random numbers than what is held against it.
const REFERENCE_SEED: u64 = 0x7265_6665_7265_6e63;

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

/// Charts a shot and writes the files into `out`.
///
/// # Errors
/// Everything wrong with the shot, before any work; [`RunError::Interrupted`] where the context was
/// cancelled before every method had its first rendering.
pub fn chart(
    mut shot: ShotFile,
    out: &Path,
    options: &ChartOptions,
    context: &Context,
    watch: &dyn Watch,
) -> Result<(Chart, bool), RunError> {
    let begin = Instant::now();
    let mut notes = Vec::new();
    if let Some(frame) = shot.plate.frames.as_ref().and_then(|frames| frames.iter().next()) {
        shot.plate.file = frame_path(&shot.plate.file, frame);
        notes.push(format!("frame {frame} stands for the sequence"));
    }
    check_folder(out)?;
    let mut stopwatch = Stopwatch::new();
    stopwatch.begin("read the shot", watch);
    let mut plan = Plan::make(shot).map_err(RunError::Problems)?;
    pictures::refuse_to_overwrite(out, &plan.inputs)?;
    if plan.objects.is_empty() {
        let path = plan.shot.path.display();
        let problem =
            format!("{path}: object: there is none, so there is nothing to chart; add [[object]]");
        return Err(RunError::Problems(vec![problem]));
    }
    let prepared = prepare(&mut plan, &mut stopwatch, context, watch)?;

    let auto = auto(&plan, &prepared);
    let decision = Decision::of(&prepared.light.lights);
    let (rows, repeats) = without_repeats(&auto, options.rows.clone(), &decision);
    notes.extend(repeats.iter().map(|(name, other)| format!("{name} is what {other} does here")));
    let rows: Vec<Row> = std::iter::once(auto).chain(rows).collect();

    stopwatch.begin("choose the size", watch);
    let left = options.seconds - begin.elapsed().as_secs_f64() - WRITING;
    let seconds = left.max(0.2 * options.seconds);
    let reduced = match options.reduced {
        Some(reduced) => reduced.min(plan.plate.linear.width()).min(plan.plate.linear.height()),
        None => fitting_size(&plan, &prepared, &rows, seconds, context)?,
    };
    let started = Instant::now();
    let bench = Bench::new(&plan, &prepared, reduced, context)?;

    stopwatch.begin("reference", watch);
    let (region, reference) = reference(&bench, REFERENCE_SHARE * seconds, context, watch)?;
    let window = Window::around(&region, bench.plate());
    let reference_crop = window.crop(&reference, bench.plate());

    stopwatch.begin("methods", watch);
    let stop = stop(plan.shot.render.stop, reduced);
    let limit = |seconds: f64| Limit { context, deadline: after(seconds) };
    let chosen = bench.render(&auto, stop, limit(CHOSEN_SHARE * seconds), None)?;
    if chosen.is_none() {
        notes.push(format!(
            "{} is not reached in the time that a chart has for it; give more --time or a smaller --scale",
            plan.shot.render.stop
        ));
    }
    let chosen = chosen.map(|rendering| rendering.point(&region));
    let end = started + Duration::from_secs_f64(seconds.min(1e6));
    let mut contest = Contest { bench: &bench, region: &region, window, end, context };
    let mut runs: Vec<Run> = rows.into_iter().map(Run::new).collect();
    contest.hold(&mut runs, watch)?;

    stopwatch.begin("draw", watch);
    let [width, height] = [bench.plate().width(), bench.plate().height()];
    let reference = Reference {
        error: region.own_error,
        cpu_seconds: reference.cpu_seconds,
        samples: reference.samples,
        pixels: region.n_pixels(),
    };
    let (curves, crops): (Vec<Curve>, Vec<Vec<Crop>>) =
        runs.into_iter().filter(|run| !run.points.is_empty()).map(Run::finish).unzip();
    notes.extend(reference_note(&curves, &reference));
    let mut chart = Chart {
        name: shot_name(&plan.shot.path),
        program: PROGRAM,
        seed: context.seed,
        size: [width, height],
        reduced,
        auto: described(&auto, &decision),
        stop: plan.shot.render.stop.to_string(),
        target: match plan.shot.render.stop {
            StopKeys::Error(error) => Some(error),
            StopKeys::Time(_) | StopKeys::Samples(_) => None,
        },
        reference,
        verdict: verdict(&curves, chosen.as_ref()),
        curves,
        chosen,
        notes,
        files: Vec::new(),
    };
    pictures::write(out, &mut chart, &plan.plate, reference_crop, &crops, watch)?;
    Ok((chart, !context.is_cancelled()))
}

/// The shot's own settings as a row.
fn auto(plan: &Plan, prepared: &Prepared) -> Row {
    Row {
        name: AUTO,
        group: Group::Methods,
        does: "what the shot's settings choose",
        method: prepared.method,
        technique: Technique::default(),
        denoise: plan.shot.render.denoise == DenoiseKeys::Auto,
        bias: None,
    }
}

/// What a row comes to, in words.
fn described(row: &Row, decision: &Decision) -> String {
    let denoised = if row.denoise { ", denoised" } else { "" };
    let blocked = match decision.on(row.technique).blocked {
        _ if row.method != Method::Coupled => "",
        Blocked::Cells => ", blocked light from cells",
        _ => ", blocked light by the same draws as all else",
    };
    format!("{}{blocked}{denoised}", method_name(row.method))
}

/// The stopping rule at the reduced size: a time is shared by fewer pixels.
fn stop(keys: StopKeys, reduced: usize) -> Stop {
    match keys {
        StopKeys::Error(error) => Stop::Error(error),
        StopKeys::Samples(samples) => Stop::Samples(samples),
        StopKeys::Time(seconds) => Stop::TimeSeconds(seconds / (reduced * reduced) as f64),
    }
}

/// A moment `seconds` from now; `None` beyond the clock's range.
fn after(seconds: f64) -> Option<Instant> {
    Instant::now().checked_add(Duration::try_from_secs_f64(seconds.max(0.0)).ok()?)
}

/// How many pixels become one so that every method gets to several renderings.
fn fitting_size(
    plan: &Plan,
    prepared: &Prepared,
    rows: &[Row],
    seconds: f64,
    context: &Context,
) -> Result<usize, RunError> {
    let (width, height) = (plan.plate.linear.width(), plan.plate.linear.height());
    let reduced = width.div_ceil(SCOUT_WIDTH).min(height);
    let scout = Bench::new(plan, prepared, reduced, context)?;
    let limit = Limit { context, deadline: None };
    let Some(rendering) = scout.render(&rows[0], Stop::Error(1.0), limit, None)? else {
        return Err(RunError::Interrupted);
    };
    let per_pixel = rendering.seconds / scout.plate().pixels().len() as f64;
    let share = (1.0 - REFERENCE_SHARE - CHOSEN_SHARE) * seconds / rows.len() as f64;
    let affordable = (share - SETUPS * rendering.setup_seconds) / (RENDERINGS * per_pixel);
    let largest = (width / LEAST_WIDTH).clamp(1, height);
    let fits = |n: &usize| ((width / n) * (height / n)) as f64 <= affordable;
    Ok((1..largest).find(fits).unwrap_or(largest))
}

fn reference(
    bench: &Bench,
    seconds: f64,
    context: &Context,
    watch: &dyn Watch,
) -> Result<(Region, Rendering), RunError> {
    let row =
        named(&["coupled".to_owned()]).ok().and_then(|rows| rows.first().copied()).ok_or_else(
            || RunError::Problems(vec!["the default method is not on the chart".to_owned()]),
        )?;
    let other = context.with_seed(context.seed ^ REFERENCE_SEED);
    let limit = Limit { context: &other, deadline: None };
    let rendering = bench
        .render(&row, Stop::TimeSeconds(seconds.max(LEAST_REFERENCE)), limit, Some(watch))?
        .filter(|_| !context.is_cancelled());
    let Some(rendering) = rendering else {
        return Err(if context.is_cancelled() { RunError::Interrupted } else { too_short() });
    };
    let Some(region) = Region::new(&rendering.difference, bench.plate()) else {
        return Err(RunError::Problems(vec![
            "the objects change no pixel by more than 1 %, so there is no error to chart; run \
             `platelight check` on the shot"
                .to_owned(),
        ]));
    };
    Ok((region, rendering))
}

fn too_short() -> RunError {
    RunError::Problems(vec![
        "--time: was over before every part of the picture had its first samples; give more, or a \
         smaller --scale"
            .to_owned(),
    ])
}

/// All rows, in turn, until the time is over.
struct Contest<'a> {
    bench: &'a Bench<'a>,
    region: &'a Region,
    window: Window,
    end: Instant,
    context: &'a Context,
}

impl Contest<'_> {
    fn hold(&mut self, runs: &mut [Run], watch: &dyn Watch) -> Result<(), RunError> {
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
        let limit = Limit { context: self.context, deadline: after(allowed) };
        let rendering = self.bench.render(&run.row, Stop::Error(run.target), limit, None)?;
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

/// Error of a curve at a cost: between its points as a power law, beyond the last as Monte Carlo goes.
/// `None` before the first.
fn error_at(curve: &Curve, cpu_seconds: f64) -> Option<f64> {
    let mut known: Vec<(f64, f64)> =
        curve.points.iter().filter_map(|p| Some((p.cpu_seconds, p.error?))).collect();
    known.sort_by(|a, b| a.0.total_cmp(&b.0));
    // Costs are good to some per cent.
    let (first, last) = (known.first()?, known.last()?);
    if cpu_seconds < 0.9 * first.0 {
        return None;
    }
    if cpu_seconds >= last.0 {
        return Some(last.1 * (last.0 / cpu_seconds).sqrt());
    }
    let after = known.iter().position(|(cost, _)| *cost > cpu_seconds)?;
    let (low, high) = (known[after.saturating_sub(1)], known[after]);
    let share = ((cpu_seconds / low.0).ln() / (high.0 / low.0).ln().max(1e-12)).clamp(0.0, 1.0);
    Some(low.1 * (high.1 / low.1).powf(share))
}

/// The shot's own settings against the best unbiased method at the same cost; the first curve is the
/// shot's.
fn verdict(curves: &[Curve], chosen: Option<&Point>) -> Option<Verdict> {
    let (auto, others) = curves.split_first()?;
    let point = chosen.filter(|point| point.error.is_some());
    let point = point.or_else(|| auto.points.iter().rev().find(|point| point.error.is_some()))?;
    let (best, best_error, extrapolated) = others
        .iter()
        .filter(|curve| curve.bias.is_none())
        .filter_map(|curve| {
            let last = curve.points.iter().map(|point| point.cpu_seconds).fold(0.0, f64::max);
            let beyond = point.cpu_seconds > 1.1 * last;
            Some((curve.name, error_at(curve, point.cpu_seconds)?, beyond))
        })
        .min_by(|a, b| a.1.total_cmp(&b.1))?;
    let (cpu_seconds, error) = (point.cpu_seconds, point.error?);
    Some(Verdict { cpu_seconds, error, best, best_error, extrapolated })
}

/// What the reference's own error means for the best of the others.
fn reference_note(curves: &[Curve], reference: &Reference) -> Option<String> {
    let best = curves.iter().flat_map(|curve| &curve.points).filter_map(|point| point.error);
    let best = best.reduce(f64::min)?;
    let times = best / reference.error.max(1e-12);
    (times < 10.0).then(|| {
        format!(
            "the best error plotted is {times:.1} times the reference's own, which is taken out of it; \
             more --time makes the reference better"
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve(name: &'static str, factor: f64, bias: Option<&'static str>) -> Curve {
        let point = |cpu_seconds: f64| Point {
            cpu_seconds,
            seconds: cpu_seconds,
            samples: 1,
            stated: 0.0,
            error: Some(factor / cpu_seconds.sqrt()),
            bias: 0.0,
            bias_sigma: 0.0,
            on_objects: None,
            beside: None,
        };
        let points = [0.1, 0.5, 2.0].map(point).to_vec();
        Curve { name, group: Group::Methods, does: "", bias, points }
    }

    #[test]
    fn errors_between_and_beyond_points_follow_the_power_law() {
        let curve = curve("x", 0.01, None);
        for cost in [0.1, 0.2, 1.0, 2.0, 50.0] {
            let found = error_at(&curve, cost).unwrap();
            assert!((found * cost.sqrt() - 0.01).abs() < 1e-9, "{cost}: {found}");
        }
        assert_eq!(error_at(&curve, 0.05), None);
    }

    #[test]
    fn the_verdict_names_the_best_unbiased_method_at_equal_cost() {
        let curves = [
            curve("auto", 0.02, None),
            curve("slow", 0.05, None),
            curve("fast", 0.01, None),
            curve("biased", 0.001, Some("all")),
        ];
        let found = verdict(&curves, None).unwrap();
        assert_eq!((found.best, found.cpu_seconds), ("fast", 2.0));
        assert!((found.ratio() - 2.0).abs() < 1e-9 && !found.extrapolated);
        let dear = Point { cpu_seconds: 8.0, ..curves[0].points[2] };
        assert!(verdict(&curves, Some(&dear)).unwrap().extrapolated);
        assert!(verdict(&curves[..1], None).is_none());
    }
}
