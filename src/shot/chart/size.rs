//! How large a picture is charted: small enough that every method gets to several renderings.

use super::bench::{Aim, Bench};
use super::methods::{Row, sort};
use super::{CHOSEN_SHARE, ChartOptions, REFERENCE_SHARE};
use crate::render::Context;
use crate::shot::plan::Plan;
use crate::shot::prepare::Prepared;
use crate::shot::run::RunError;

/// A method should fit at least this many least renderings, and scenes built for them, into its time:
/// steps of about four times the work each.
const RENDERINGS: f64 = 22.0;
const SETUPS: f64 = 4.0;
/// Pictures narrower than this show no shadow any more.
const LEAST_WIDTH: usize = 96;
/// A picture with a shorter side than this, pixels, is refused: a tile of the renderer.
const LEAST_SIDE: usize = 16;
/// Width of the picture that is rendered to see what rendering costs.
const SCOUT_WIDTH: usize = 160;

/// The shot at the size asked for, or that fits into `seconds`; the rows to chart, `auto` first; and
/// what is to be said of those left out.
pub fn bench_and_rows<'a>(
    plan: &'a Plan,
    prepared: &'a Prepared,
    auto: &Row,
    options: &ChartOptions,
    seconds: f64,
    context: &Context,
) -> Result<(Bench<'a>, Vec<Row>, Vec<String>), RunError> {
    let (width, height) = (plan.plate.linear.width(), plan.plate.linear.height());
    let first = options.reduced.unwrap_or(width.div_ceil(SCOUT_WIDTH)).min(width).min(height);
    let bench = Bench::new(plan, prepared, first, context)?;
    let sorted = sort(auto, options.rows.clone(), |blocked| bench.resolved(blocked));
    let notes = sorted.notes();
    let rows: Vec<Row> = std::iter::once(*auto).chain(sorted.kept).collect();
    if options.reduced.is_some() {
        return Ok((bench, rows, notes));
    }
    let fitting =
        fitting_size(&bench, [width, height], auto, seconds / rows.len() as f64, context)?;
    Ok((Bench::new(plan, prepared, fitting, context)?, rows, notes))
}

/// Refuses a plate of so many pixels in one that nothing is left to see.
///
/// # Errors
/// A sentence that names the smallest scale that works.
pub fn check_scale(plan: &Plan, reduced: Option<usize>) -> Result<(), String> {
    let plate = &plan.plate.linear;
    let (width, height) = (plate.width(), plate.height());
    let most = (width.min(height) / LEAST_SIDE).max(1);
    let Some(reduced) = reduced.filter(|&reduced| reduced > most) else { return Ok(()) };
    // Rounded up: one over it must not come out as one pixel more.
    let smallest = (1e3 / most as f64).ceil() * 1e-3;
    Err(format!(
        "--scale: {} x {} px would be left of the plate's {width} x {height}, which shows nothing; the \
         smallest that works is {smallest:.3}",
        width / reduced,
        height / reduced,
    ))
}

/// How many pixels of a plate of `[width, height]` become one so that a method fits into its part of
/// the time, by what `auto` costs at the scout's size.
fn fitting_size(
    scout: &Bench,
    [width, height]: [usize; 2],
    auto: &Row,
    seconds_each: f64,
    context: &Context,
) -> Result<usize, RunError> {
    let Some(rendering) = scout.render(auto, Aim::Least, context, None)? else {
        return Err(RunError::Interrupted);
    };
    let per_pixel = rendering.seconds / scout.plate().pixels().len() as f64;
    let share = (1.0 - REFERENCE_SHARE - CHOSEN_SHARE) * seconds_each;
    let affordable = (share - SETUPS * rendering.setup_seconds) / (RENDERINGS * per_pixel);
    let largest = (width / LEAST_WIDTH).clamp(1, height);
    let fits = |n: &usize| ((width / n) * (height / n)) as f64 <= affordable;
    Ok((1..largest).find(fits).unwrap_or(largest))
}
