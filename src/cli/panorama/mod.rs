//! `platelight panorama`: photographs of a light probe → lat-long panorama.
//!
//! [`args`] (what can be asked) → [`photographed`] or a map's file → panorama → [`summary`].

mod args;
mod fill_sky;
mod photographed;
mod summary;

use std::path::Path;
use std::path::PathBuf;

pub use self::args::Args;
use self::args::{Wishes, layout};
use self::fill_sky::fill_sky;
use self::photographed::{Photographed, photographed};
use self::summary::{summary, text};
use super::outputs::{check_ending, check_outputs, write_png};
use super::{CliError, Global, Outcome};
use crate::photo::tone::{self, ToneCurve};
use crate::probe::file;

pub fn run(args: &Args, global: &Global) -> Result<Outcome, CliError> {
    let beside = args.camera.iter().chain(&args.clean_plate);
    let inputs: Vec<&Path> = args.photos.iter().chain(beside).map(PathBuf::as_path).collect();
    let further = [&args.preview, &args.overlay].into_iter().flatten();
    let outputs: Vec<&Path> =
        [&args.out].into_iter().chain(further).map(PathBuf::as_path).collect();
    check_outputs(&inputs, &outputs)?;
    check_ending(&args.out, "exr")?;
    for png in [&args.preview, &args.overlay].into_iter().flatten() {
        check_ending(png, "png")?;
    }
    if args.overlay.is_some() && !args.kind.ball {
        return Err(CliError::wrong("--overlay draws a ball's rim; only --ball has one"));
    }
    let wishes = Wishes::judge(args)?;
    let mut warnings = Vec::new();
    let Photographed { panorama, ball: found, overlay } = match layout(&args.kind) {
        Some(layout) => {
            let [path] = args.photos.as_slice() else {
                return Err(CliError::wrong("a map of directions is one picture, not a bracket"));
            };
            let read = file::read(path, layout, wishes.rotation, args.width, &wishes.read)?;
            warnings.extend(read.remarks);
            warnings.extend(read.negative.map(|n| format!("{}: {n}", path.display())));
            Photographed { panorama: read.panorama, ball: None, overlay: None }
        }
        None => photographed(&wishes, &mut warnings, global)?,
    };
    let mut panorama = file::in_world_axes(&panorama).into_owned();
    let sky = match &args.fill_sky {
        Some(sun) => Some(fill_sky(&mut panorama, sun, &mut warnings)?),
        None => None,
    };
    global.go_on()?;
    file::write(&args.out, &panorama)?;
    if let (Some(path), Some(drawn)) = (&args.overlay, &overlay) {
        write_png(path, drawn)?;
    }
    if let Some(path) = &args.preview {
        let shown = tone::automatic_stops(&panorama.radiance);
        write_png(path, &tone::display(&panorama.radiance, shown, ToneCurve::REINHARD))?;
    }
    let summary = summary(args, &panorama, found.as_ref(), sky, warnings);
    for warning in &summary.warnings {
        global.warn(warning);
    }
    global.print(&summary, || text(&summary));
    Ok(Outcome::Done)
}
