//! How large a picture is charted: small enough that every method gets to several renderings.

use super::bench::Bench;
use super::methods::{Row, without_repeats};
use super::{CHOSEN_SHARE, ChartOptions, REFERENCE_SHARE};
use crate::render::{Context, Stop};
use crate::shot::plan::Plan;
use crate::shot::prepare::Prepared;
use crate::shot::run::RunError;

/// A method should fit at least this many least renderings, and scenes built for them, into its time:
/// steps of about four times the work each.
const RENDERINGS: f64 = 22.0;
const SETUPS: f64 = 4.0;
/// Pictures narrower than this show no shadow any more.
const LEAST_WIDTH: usize = 96;
/// Width of the picture that is rendered to see what rendering costs.
const SCOUT_WIDTH: usize = 160;

/// The names of rows that equal another one here, with that one's.
pub type Repeats = Vec<(&'static str, &'static str)>;

/// The shot at the size asked for, or that fits into `seconds`; the rows to chart, `auto` first; and
/// which were left out because another one does the same here.
pub fn bench_and_rows<'a>(
    plan: &'a Plan,
    prepared: &'a Prepared,
    auto: &Row,
    options: &ChartOptions,
    seconds: f64,
    context: &Context,
) -> Result<(Bench<'a>, Vec<Row>, Repeats), RunError> {
    let (width, height) = (plan.plate.linear.width(), plan.plate.linear.height());
    let first = options.reduced.unwrap_or(width.div_ceil(SCOUT_WIDTH)).min(width).min(height);
    let bench = Bench::new(plan, prepared, first, context)?;
    let (others, repeats) =
        without_repeats(auto, options.rows.clone(), |blocked| bench.resolved(blocked));
    let rows: Vec<Row> = std::iter::once(*auto).chain(others).collect();
    if options.reduced.is_some() {
        return Ok((bench, rows, repeats));
    }
    let fitting =
        fitting_size(&bench, [width, height], auto, seconds / rows.len() as f64, context)?;
    Ok((Bench::new(plan, prepared, fitting, context)?, rows, repeats))
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
    let Some(rendering) = scout.render(auto, Stop::Error(1.0), context, None)? else {
        return Err(RunError::Interrupted);
    };
    let per_pixel = rendering.seconds / scout.plate().pixels().len() as f64;
    let share = (1.0 - REFERENCE_SHARE - CHOSEN_SHARE) * seconds_each;
    let affordable = (share - SETUPS * rendering.setup_seconds) / (RENDERINGS * per_pixel);
    let largest = (width / LEAST_WIDTH).clamp(1, height);
    let fits = |n: &usize| ((width / n) * (height / n)) as f64 <= affordable;
    Ok((1..largest).find(fits).unwrap_or(largest))
}
