//! CPU seconds of merging a bracket, to be set beside other programs.
//!
//! `cargo run --release --example merge_rate -- --step 2 PHOTO…` reads the photographs, the longest exposure
//! first, each `--step` stops below the one before it, and prints one line of JSON: seconds by CPU time of
//! all threads for reading and for merging, and the largest memory held.

mod cpu;

use std::error::Error;
use std::fs;
use std::path::PathBuf;

use clap::Parser;
use platelight::bracket::{Frame, MergeOptions, merge};
use platelight::photo::{self, Encoded, ReadOptions};

#[derive(Parser)]
struct Args {
    photos: Vec<PathBuf>,
    /// Stops between neighbours.
    #[arg(long, default_value_t = 2.0)]
    step: f64,
    /// Threads [default: all cores]
    #[arg(long, default_value_t = 0)]
    threads: usize,
}

fn main() -> Result<(), Box<dyn Error>> {
    let args = Args::parse();
    rayon::ThreadPoolBuilder::new().num_threads(args.threads).build_global()?;
    let start = cpu::seconds();
    let read = |path: &PathBuf| photo::read_encoded(path, &ReadOptions::default());
    let photos: Vec<Encoded> = args.photos.iter().map(read).collect::<Result<_, _>>()?;
    let read = cpu::seconds();
    let frames = photos.iter().enumerate().map(|(k, photo)| {
        let exposure = (-args.step * k as f64).exp2();
        Frame { photo, exposure }
    });
    let merged = merge(&frames.collect::<Vec<_>>(), &MergeOptions::default())?;
    let done = cpu::seconds();
    println!(
        "{}",
        serde_json::json!({
            "photos": photos.len(),
            "megapixels": 1e-6 * merged.radiance.mean.pixels().len() as f64,
            "read_cpu_s": read - start,
            "merge_cpu_s": done - read,
            "peak_gb": peak_gb(),
        })
    );
    Ok(())
}

/// Largest resident memory so far, GB.
fn peak_gb() -> f64 {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kib = line.and_then(|line| line.trim().split(' ').next()?.parse::<f64>().ok());
    kib.map_or(f64::NAN, |kib| kib * 1024e-9)
}
