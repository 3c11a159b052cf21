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

use bench::{Bench, Rendering};
use contest::Contest;
use methods::{AUTO, coupled};
use pictures::{Crop, Window};
use size::bench_and_rows;

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
    let mut plan = checked_plan(shot, out)?;
    let prepared = prepare(&mut plan, &mut stopwatch, context, watch)?;

    stopwatch.begin("choose the size", watch);
    let left = options.seconds - begin.elapsed().as_secs_f64() - WRITING;
    let seconds = left.max(0.2 * options.seconds);
    let auto = auto(&plan, &prepared);
    let (bench, rows, repeats) =
        bench_and_rows(&plan, &prepared, &auto, options, seconds, context)?;
    notes.extend(repeats.iter().map(|(name, other)| format!("{name} is what {other} does here")));
    let end = Instant::now() + Duration::from_secs_f64(seconds.min(1e6));

    stopwatch.begin("reference", watch);
    let (region, reference) = reference(&bench, REFERENCE_SHARE * seconds, context, watch)?;
    let window = Window::around(&region, bench.plate());

    stopwatch.begin("methods", watch);
    let keys = plan.shot.render.stop;
    let limited = context.until(after(CHOSEN_SHARE * seconds));
    let chosen = bench.render(&auto, stop(keys, bench.reduced()), &limited, None)?;
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
fn checked_plan(shot: ShotFile, out: &Path) -> Result<Plan, RunError> {
    check_folder(out)?;
    let plan = Plan::make(shot).map_err(RunError::Problems)?;
    refuse_to_overwrite(out, plan.inputs.iter(), pictures::is_result)?;
    if plan.objects.is_empty() {
        let path = plan.shot.path.display();
        let problem =
            format!("{path}: object: there is none, so there is nothing to chart; add [[object]]");
        return Err(RunError::Problems(vec![problem]));
    }
    Ok(plan)
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
fn described(row: &Row, bench: &Bench) -> String {
    let denoised = if row.denoise { ", denoised" } else { "" };
    let blocked = match bench.resolved(row.technique.blocked) {
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

/// The best rendering that the time allows, and where it shows that the objects change the plate.
fn reference(
    bench: &Bench,
    seconds: f64,
    context: &Context,
    watch: &dyn Watch,
) -> Result<(Region, Rendering), RunError> {
    let other = context.with_seed(context.seed ^ REFERENCE_SEED);
    let stop = Stop::TimeSeconds(seconds.max(LEAST_REFERENCE));
    let rendering =
        bench.render(&coupled(), stop, &other, Some(watch))?.filter(|_| !context.is_cancelled());
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
