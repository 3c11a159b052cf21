//! The demo shot from its photographs to the written composite, and the parts before the rendering.
//!
//! `cargo bench --bench end_to_end`. One sample in each pixel that the objects change: what is
//! measured is everything around the path tracer (`benches/tracer.rs` measures that).

use std::path::Path;

use divan::Bencher;
use platelight::render::Context;
use platelight::shot::ShotFile;
use platelight::shot::run::{RunOptions, run_frames};
use platelight::shot::stop::StopKeys;
use platelight::shot::watch::Silent;

fn demo() -> ShotFile {
    let shot = Path::new(env!("CARGO_MANIFEST_DIR")).join("plates/demo/shot.toml");
    ShotFile::read(&shot).expect("the demo shot")
}

#[divan::bench(sample_count = 3, sample_size = 1)]
fn demo_with_one_sample(bencher: Bencher) {
    let file = demo();
    let stop = Some(StopKeys::Samples(1));
    let options = RunOptions { stop, ..RunOptions::default() };
    bencher.bench_local(|| {
        let out = tempfile::tempdir().expect("a folder");
        for frame in run_frames(&file, out.path(), &options, &Context::new(0), &Silent) {
            assert!(frame.expect("the demo runs").complete);
        }
    });
}

fn main() {
    divan::main();
}
