//! `platelight chart`: speed against accuracy of every method, on one's own shot.

use std::path::PathBuf;

use super::terminal::Terminal;
use super::{CliError, Global, Outcome, read_shot};
use crate::report::chart::summary;
use crate::shot::batch::out_folder;
use crate::shot::chart::{ChartOptions, all, chart, named};
use crate::shot::run::RunError;
use crate::shot::stop::StopKeys;

/// Chart speed against accuracy of every method on a shot
#[derive(Debug, clap::Args)]
#[command(after_help = format!("\
Examples:
  platelight chart shots/robot
  platelight chart shots/robot --time 600 --out charts/robot
  platelight chart shots/robot --methods two-pass,mis-compensated --scale 0.5

Renders a reference, then the shot's own settings (auto) and each method at growing cost, in turn, and \
writes chart.csv, chart.svg, chart.png, chart.html and crops.png, the same part of the picture by every \
method, each at its cost nearest to the others'. Error and bias are those over the influence region, \
relative to the picture's brightness; costs are CPU seconds of rendering, without preparation.

Methods: {}.", method_names()))]
pub struct Args {
    /// The shot file, or the folder that holds shot.toml
    shot: PathBuf,
    /// Folder for the results [default: out/chart/ beside the shot file]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Be done after about this long (60, 60s, 5m, 2h), preparation included; every method is rendered
    /// once, even if that takes longer
    #[arg(long, value_name = "TIME", default_value = "180s", allow_negative_numbers = true)]
    time: String,
    /// Methods to hold against the shot's own settings, separated by commas [default: all]
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    methods: Vec<String>,
    /// Size of the picture rendered, as a share of the plate's: 1, 0.5, 0.333 … [default: what fits
    /// the time]
    #[arg(long, value_name = "SHARE", allow_negative_numbers = true)]
    scale: Option<f64>,
}

fn method_names() -> String {
    all().iter().map(|row| row.name).collect::<Vec<_>>().join(", ")
}

/// Less is over before anything was rendered twice.
const LEAST_SECONDS: f64 = 2.0;

pub fn run(args: &Args, global: &Global) -> Result<Outcome, CliError> {
    let told = |problem: String| CliError::wrong(format!("--time: {problem}"));
    let seconds = match StopKeys::time(&args.time).map_err(told)? {
        StopKeys::Time(seconds) if seconds >= LEAST_SECONDS => seconds,
        _ => {
            return Err(told(format!(
                "{} is not {LEAST_SECONDS} s or more; a chart needs many renderings",
                args.time
            )));
        }
    };
    let reduced = match args.scale {
        Some(scale) if !(scale > 0.0 && scale <= 1.0) => {
            return Err(CliError::wrong(format!(
                "--scale: {scale} is no share of the plate's size; write one above 0 and up to 1, the \
                 plate's own"
            )));
        }
        scale => scale.map(|scale| (1.0 / scale).round() as usize),
    };
    let rows = named(&args.methods).map_err(CliError::wrong)?;
    let shot = read_shot(&args.shot)?;
    let out = args.out.clone().unwrap_or_else(|| out_folder(&shot.path, None).join("chart"));
    let options = ChartOptions { seconds, rows, reduced };
    let terminal = Terminal::new(global);
    let charted = chart(shot, &out, &options, &global.context(), &terminal);
    terminal.finish();
    let (chart, complete) = match charted {
        Ok(charted) => charted,
        Err(RunError::Interrupted) => return Err(CliError::interrupted()),
        Err(error) => return Err(CliError::several(error.problems())),
    };
    global.print(&chart, || summary(&chart));
    Ok(if complete { Outcome::Done } else { Outcome::Interrupted })
}
