//! `platelight chart`: what a second of work buys on this very shot, method by method.
//!
//! shot → prepared as for [`run`](super::run) → a picture small enough to render often → the best
//! rendering that the time allows as reference → every method in turn, each time for about four times
//! the work, so that whatever else the machine does meets all of them alike → chart.csv, .svg, .png,
//! .html and crops.png. The reference is the default method's own: an error that all methods share is
//! not seen.

mod bench;
mod contest;
mod methods;
mod pictures;
mod size;
mod verdict;

pub use methods::{Row, all, named};

use std::path::Path;
use std::time::{Duration, Instant};

use bench::{Aim, Bench, Rendering};
use contest::Contest;
use methods::{AUTO, MOVED, coupled};
use pictures::{Crop, Window};
use size::{bench_and_rows, check_scale};

use super::existing::PROGRAM;
use super::file::{DenoiseKeys, ShotFile};
use super::plan::Plan;
use super::prepare::{Prepared, method_name, prepare};
use super::run::{RunError, check_folder, refuse_to_overwrite};
use super::stop::StopKeys;
use super::watch::{Stopwatch, Watch};
use crate::render::compare::Region;
use crate::render::{Blocked, Context, Method, Stop, Technique};
use crate::report::chart::{Chart, Curve, Group, Reference};
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
/// The reference draws other random numbers than what is held against it.
const REFERENCE_SEED: u64 = 0x7265_6665_7265_6e63;

/// Charts a shot and writes the files into `out`; false beside the chart if the context was cancelled
/// before the time was over.
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
        shot = shot.at_frame(frame);
        notes.push(format!("frame {frame} stands for the sequence"));
    }
    let mut stopwatch = Stopwatch::new();
    stopwatch.begin("read the shot", watch);
    let mut plan = checked_plan(shot, out, options)?;
    let prepared = prepare(&mut plan, &mut stopwatch, context, watch)?;

    stopwatch.begin("choose the size", watch);
    // However long the preparation took, a chart is what was asked for
    let left =
        || (options.seconds - begin.elapsed().as_secs_f64() - WRITING).max(0.2 * options.seconds);
    let auto = auto(&plan, &prepared);
    let (bench, rows, left_out) =
        bench_and_rows(&plan, &prepared, &auto, options, left(), context)?;
    notes.extend(left_out);
    let round = rows.len() as f64 * least_seconds(&bench, &auto, context)?;
    let shares = Shares::of(left(), round);
    let end = Instant::now() + Duration::from_secs_f64(left().min(1e6));

    stopwatch.begin("reference", watch);
    let (region, reference) = reference(&bench, shares.reference, context, watch)?;
    let window = Window::around(&region, bench.plate());

    stopwatch.begin("methods", watch);
    let keys = plan.shot.render.stop;
    let limited = context.until(after(shares.chosen));
    let chosen = bench.render(&auto, Aim::Stop(stop_at(&plan, bench.reduced())), &limited, None)?;
    if chosen.is_none() {
        notes.push(format!(
            "{keys} is not reached in the time that a chart has for it; give more --time or a smaller \
             --scale"
        ));
    }
    let chosen = chosen.map(|rendering| rendering.point(&region));
    let contest = Contest { bench: &bench, region: &region, window, end, context };
    let (curves, crops): (Vec<Curve>, Vec<Vec<Crop>>) =
        contest.hold(rows, watch)?.into_iter().unzip();

    stopwatch.begin("draw", watch);
    let reference_crop = window.crop(&reference, bench.plate());
    let reference = Reference {
        error: region.own_error,
        cpu_seconds: reference.cpu_seconds,
        samples: reference.samples,
        pixels: region.n_pixels(),
    };
    notes.extend(verdict::reference_note(&curves, chosen.as_ref(), &reference));
    let mut chart = Chart {
        name: shot_name(&plan.shot.path),
        program: PROGRAM,
        seed: context.seed,
        size: [bench.plate().width(), bench.plate().height()],
        reduced: bench.reduced(),
        auto: described(&auto, &bench),
        stop: keys.to_string(),
        target: match keys {
            StopKeys::Error(error) => Some(error),
            StopKeys::Time(_) | StopKeys::Samples(_) => None,
        },
        reference,
        verdict: verdict::verdict(&curves, chosen.as_ref()),
        curves,
        chosen,
        notes,
        files: Vec::new(),
    };
    pictures::write(out, &mut chart, &plan.plate, reference_crop, &crops, watch)?;
    Ok((chart, !context.is_cancelled()))
}

/// Everything that can be wrong before any work.
fn checked_plan(shot: ShotFile, out: &Path, options: &ChartOptions) -> Result<Plan, RunError> {
    check_folder(out)?;
    let plan = Plan::make(shot).map_err(RunError::Problems)?;
    check_scale(&plan, options.reduced).map_err(|problem| RunError::Problems(vec![problem]))?;
    refuse_to_overwrite(out, plan.inputs.iter(), pictures::is_result)?;
    if plan.objects.is_empty() {
        let path = plan.shot.path.display();
        let problem =
            format!("{path}: object: there is none, so there is nothing to chart; add [[object]]");
        return Err(RunError::Problems(vec![problem]));
    }
    Ok(plan)
}

/// Seconds of the clock for what is rendered before all methods are in turn.
struct Shares {
    reference: f64,
    /// At most.
    chosen: f64,
}

impl Shares {
    /// Of `seconds`, of which the least rendering of every method takes about `round`.
    fn of(seconds: f64, round: f64) -> Self {
        /// Some methods cost more than the default, whose cost is known.
        const MARGIN: f64 = 1.3;
        let both = REFERENCE_SHARE + CHOSEN_SHARE;
        let free = (both * seconds).min(seconds - MARGIN * round);
        let reference = free * REFERENCE_SHARE / both;
        Self {
            reference: reference.max(LEAST_REFERENCE),
            chosen: (free * CHOSEN_SHARE / both).max(0.5 * LEAST_REFERENCE),
        }
    }
}

/// Seconds of the clock that the least rendering of a method takes, with what is built for it.
fn least_seconds(bench: &Bench, row: &Row, context: &Context) -> Result<f64, RunError> {
    let rendering = bench.render(row, Aim::Least, context, None)?;
    let rendering = rendering.ok_or(RunError::Interrupted)?;
    Ok(rendering.setup_seconds + rendering.seconds)
}

/// The shot's own settings as a row.
fn auto(plan: &Plan, prepared: &Prepared) -> Row {
    let denoise = plan.shot.render.denoise == DenoiseKeys::Auto;
    Row {
        name: AUTO,
        group: Group::Methods,
        does: "what the shot's settings choose",
        method: prepared.method,
        technique: Technique::default(),
        denoise,
        bias: denoise.then_some(MOVED),
    }
}

/// What a row comes to, in words.
fn described(row: &Row, bench: &Bench) -> String {
    let denoised = if row.denoise { ", denoised" } else { "" };
    let blocked = match bench.resolved(row.technique.blocked) {
        _ if row.method != Method::Coupled => "",
        Blocked::Cells => ", blocked light from cells",
        _ => ", blocked light by the same draws as all else",
    };
    format!("{}{blocked}{denoised}", method_name(row.method))
}

/// The shot's stopping rule at the reduced size: a time is shared by fewer pixels.
fn stop_at(plan: &Plan, reduced: usize) -> Stop {
    match plan.shot.render.stop {
        StopKeys::Error(error) => Stop::Error(error),
        StopKeys::Samples(samples) => Stop::Samples(samples),
        StopKeys::Time(seconds) => Stop::TimeSeconds(seconds / (reduced * reduced) as f64),
    }
}

/// A moment `seconds` from now; `None` beyond the clock's range.
fn after(seconds: f64) -> Option<Instant> {
    Instant::now().checked_add(Duration::try_from_secs_f64(seconds.max(0.0)).ok()?)
}

/// The best rendering that the time allows, and where it shows that the objects change the plate.
fn reference(
    bench: &Bench,
    seconds: f64,
    context: &Context,
    watch: &dyn Watch,
) -> Result<(Region, Rendering), RunError> {
    let other = context.with_seed(context.seed ^ REFERENCE_SEED);
    let aim = Aim::Stop(Stop::TimeSeconds(seconds));
    let rendering =
        bench.render(&coupled(), aim, &other, Some(watch))?.filter(|_| !context.is_cancelled());
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
