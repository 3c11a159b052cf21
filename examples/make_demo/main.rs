//! Makes the demo shot: `cargo run --release --example make_demo -- --out plates/demo`.
//!
//! A synthetic place (`place`), photographed through a distorting lens (`lens`) by a small path
//! tracer (`tracer`, `surface`) that shares no code with the library, with the noise of a sensor
//! (`sensor`): boards and a tag (`targets`), a bracketed mirror ball, the plate, and the true answer
//! (`truth`). Everything is a function of the code: no clock, no random seed.

mod files;
mod lens;
mod mesh;
mod objects;
mod paint;
mod place;
mod sampling;
mod sensor;
mod shoot;
mod shot_file;
mod sky;
mod surface;
mod targets;
mod tracer;
mod truth;

use std::error::Error;
use std::fs;
use std::path::{Path, PathBuf};

use clap::Parser;

use crate::sensor::{Exposure, PLATE, photograph};
use crate::shoot::{BRACKET, Effort, N_BOARDS};
use crate::tracer::Rendered;

#[derive(Parser)]
#[command(about = "Makes the synthetic demo shot and its known answer")]
struct Args {
    /// Folder to write into.
    #[arg(long, default_value = "plates/demo")]
    out: PathBuf,
    /// Paths in a pixel of the plate and the truth.
    #[arg(long, default_value_t = 64)]
    samples: u32,
    /// Pixels this many times as large: a look at the place in seconds, not fit for the pipeline.
    #[arg(long, default_value_t = 1)]
    coarser: usize,
    /// Only the pictures whose file name begins with this.
    #[arg(long, default_value = "")]
    only: String,
}

fn main() -> Result<(), Box<dyn Error>> {
    let args = Args::parse();
    fs::create_dir_all(&args.out)?;
    let effort = Effort { coarser: args.coarser, samples: args.samples };
    let wanted = |name: &str| name.starts_with(&args.only);
    let path = |name: &str| args.out.join(name);

    if wanted("shot.toml") {
        fs::write(path("shot.toml"), shot_file::text())?;
        truth::write_facts(&path("truth.json"))?;
    }
    if wanted("objects") {
        write_models(&args.out)?;
    }
    for index in (0..N_BOARDS).filter(|i| wanted(&format!("board_{i:02}"))) {
        let (picture, exposure) = effort.board(index);
        save(&path(&format!("board_{index:02}.jpg")), &picture, exposure, 100 + index as u32)?;
    }
    if wanted("tag") {
        save(&path("tag.jpg"), &effort.tag(), PLATE, 200)?;
    }
    if wanted("ball_pose") {
        save(&path("ball_pose_board.jpg"), &effort.ball_pose(), PLATE, 201)?;
    }
    if wanted("ball_b") {
        let ball = effort.ball();
        for (i, exposure) in BRACKET.into_iter().enumerate() {
            save(&path(&format!("ball_b{i}.jpg")), &ball, exposure, 300 + i as u32)?;
        }
    }
    if wanted("plate") {
        let plate = effort.plate();
        let bytes = photograph(&plate.light, PLATE, 400);
        files::write_png(&path("plate.png"), &bytes, plate.width, plate.height)?;
        truth::write_pictures(&path("truth.exr"), &plate, &effort.truth())?;
    }
    Ok(())
}

fn save(
    path: &Path,
    picture: &Rendered,
    exposure: Exposure,
    noise_seed: u32,
) -> Result<(), Box<dyn Error>> {
    let bytes = photograph(&picture.light, exposure, noise_seed);
    files::write_jpeg(path, &bytes, picture.width, picture.height, exposure)
}

/// The objects, each standing at its own origin, and the real things near them, where they stand.
fn write_models(folder: &Path) -> Result<(), Box<dyn Error>> {
    for object in objects::objects() {
        let mesh = [(object.name, &object.triangles, object.finish)];
        files::write_glb(&folder.join(object.name).with_extension("glb"), &mesh)?;
    }
    let props = place::props();
    let plain: Vec<_> = props
        .iter()
        .map(|p| {
            let paint = paint::Paint::Plain(p.albedo);
            (p.name, &p.triangles, surface::Finish { paint, ..p.finish })
        })
        .collect();
    files::write_glb(&folder.join("props.glb"), &plain)
}
