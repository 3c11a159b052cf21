//! Charts of what the capture steps are good for: merge estimators and unwrap filtering.
//!
//! `cargo run --release --example capture_charts -- OUT` writes `merge.svg`, `merge_time.svg`,
//! `unwrap_light.svg` and `unwrap_direction.svg`, each with its table, into the folder OUT. Everything is simulated with fixed seeds; times are of one thread of
//! the machine it runs on. `docs/charts.md` says what is to be seen.

mod merge;
mod plot;
mod random;
mod unwrap;

use std::error::Error;
use std::fs;
use std::path::PathBuf;

use clap::Parser;

#[derive(Parser)]
struct Args {
    /// Folder for the charts.
    out: PathBuf,
}

fn main() -> Result<(), Box<dyn Error>> {
    let args = Args::parse();
    fs::create_dir_all(&args.out)?;
    rayon::ThreadPoolBuilder::new().num_threads(1).build_global()?;
    let write = |name: &str, text: String| fs::write(args.out.join(name), text);

    let rows = merge::measure()?;
    write("merge.csv", merge::csv(&rows))?;
    write("merge.svg", merge::chart(&rows)?)?;
    write("merge_time.svg", merge::time_chart(&rows)?)?;
    println!("{}", merge::csv(&rows));

    let rows = unwrap::measure();
    write("unwrap.csv", unwrap::csv(&rows))?;
    write("unwrap_light.svg", unwrap::chart(&rows, false)?)?;
    write("unwrap_direction.svg", unwrap::chart(&rows, true)?)?;
    println!("{}", unwrap::csv(&rows));
    Ok(())
}
