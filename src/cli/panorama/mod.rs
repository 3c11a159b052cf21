//! `platelight panorama`: photographs of a light probe, or a map of directions → panorama.
//!
//! [`args`] (what can be asked) → [`photographed`] → panorama → [`written`] (in which layout, and what
//! beside it) → [`summary`]. Several panoramas of one place go through [`merge`].

mod args;
mod by_ball;
mod fill_sky;
mod folder;
mod merge;
mod photographed;
mod stitch;
mod summary;
mod written;

use std::path::{Path, PathBuf};

pub use self::args::Args;
use self::args::{Source, Wishes};
use self::fill_sky::fill_sky;
use self::photographed::{mapped, photographed};
use self::stitch::stitch;
use self::summary::{Summary, summary, text};
use self::written::{ending, write};
use super::outputs::{check_ending, check_outputs, write_png};
use super::{CliError, Global, Outcome};
use crate::photo::atomic;
use crate::photo::tone::{self, ToneCurve};
use crate::probe::cube::CubeLayout;
use crate::probe::file;
use crate::probe::layout::Layout;

pub fn run(args: &Args, global: &Global) -> Result<Outcome, CliError> {
    if let [from] = args.photos.as_slice()
        && from.is_dir()
    {
        return folder::run(from, args, global);
    }
    if let Some(option) = args.of_folder() {
        return Err(CliError::wrong(format!(
            "{option} is for a folder; name one, or leave it out"
        )));
    }
    let summary = convert(args, global)?;
    global.print(&summary, || text(&summary));
    Ok(Outcome::Done)
}

/// Makes one panorama and writes it, with all that is asked for beside it.
fn convert(args: &Args, global: &Global) -> Result<Summary, CliError> {
    let wishes = Wishes::judge(args)?;
    check_files(&wishes)?;
    let mut warnings = Vec::new();
    let mut merged = None;
    let mut found = match wishes.source {
        Source::Panoramas => {
            let (found, report) = merge::merge(&wishes, &mut warnings, global)?;
            merged = Some(report);
            found
        }
        Source::Photographs => photographed(&wishes, &mut warnings, global)?,
        Source::Overlapping => stitch(&wishes, &mut warnings, global)?,
        Source::Map(layout) => mapped(&wishes, layout, &mut warnings)?,
        Source::Faces(faces) => {
            mapped(&wishes, Layout::Cube(CubeLayout::Strip, faces), &mut warnings)?
        }
    };
    let sky = match &args.fill_sky {
        Some(sun) => {
            found.panorama = file::in_world_axes(&found.panorama).into_owned();
            Some(fill_sky(&mut found.panorama, sun, &mut warnings)?)
        }
        None => None,
    };
    global.go_on()?;
    let size = write(&wishes, &found)?;
    let panorama = file::in_world_axes(&found.panorama);
    global.go_on()?;
    if let (Some(path), Some(drawn)) = (&args.overlay, &found.overlay) {
        write_png(path, drawn)?;
    }
    if let Some(path) = &args.preview {
        let shown = tone::automatic_stops(&panorama.radiance);
        write_png(path, &tone::display(&panorama.radiance, shown, ToneCurve::REINHARD))?;
    }
    written::beside(&wishes, &panorama)?;
    let mut summary = summary(&wishes, &panorama, size, &found, sky, warnings);
    summary.merged = merged;
    for warning in &summary.warnings {
        global.warn(warning);
    }
    Ok(summary)
}

/// Whether everything that is asked for can be written.
fn check_files(wishes: &Wishes) -> Result<(), CliError> {
    let (args, further) = (wishes.args, &wishes.args.further);
    let beside = args.camera.iter().chain(&args.clean_plate);
    let inputs: Vec<&Path> = args.photos.iter().chain(beside).map(PathBuf::as_path).collect();
    let pictures = [&args.preview, &args.overlay, &further.axes].into_iter().flatten();
    let sibl = further.sibl.as_deref().map(written::sibl_files).transpose()?;
    let mut outputs = wishes.target.files(&args.out);
    outputs.extend(pictures.clone().chain(&further.irradiance).cloned());
    if let Some(folder) = &further.sibl {
        atomic::check_folder(folder).map_err(|cause| {
            CliError::wrong(format!(
                "{}: nothing can be written there: {cause}; name another folder",
                folder.display()
            ))
        })?;
    }
    if let Some(files) =
        sibl.filter(|_| further.sibl.as_ref().is_some_and(|folder| folder.is_dir()))
    {
        outputs.extend(files.all().map(Path::to_path_buf));
    }
    check_outputs(&inputs, &outputs.iter().map(PathBuf::as_path).collect::<Vec<_>>())?;
    ending(&args.out)?;
    for png in pictures {
        check_ending(png, "png")?;
    }
    if let Some(exr) = &further.irradiance {
        check_ending(exr, "exr")?;
    }
    Ok(())
}
