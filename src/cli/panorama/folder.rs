//! `platelight panorama FOLDER`: a panorama for each bracket, or each map, of a folder.

use std::path::{Path, PathBuf};

use super::args::{Args, Source, Wishes};
use super::convert;
use super::summary::text;
use crate::bracket::group::{Grouping, group};
use crate::cli::folder::{self, PHOTOGRAPHS, Task};
use crate::cli::{CliError, Global, Outcome};

/// Endings of pictures that are no photographs.
const MAPS: [&str; 2] = ["exr", "hdr"];

pub(super) fn run(from: &Path, args: &Args, global: &Global) -> Result<Outcome, CliError> {
    let source = Wishes::judge(args)?.source;
    let endings = [PHOTOGRAPHS.as_slice(), &MAPS].concat();
    let groups = match source {
        Source::Photographs => groups(from, args)?,
        Source::Map(_) => {
            folder::files(from, &endings)?.into_iter().map(|path| vec![path]).collect()
        }
        Source::Panoramas | Source::Overlapping | Source::Faces(_) => {
            return Err(CliError::wrong(format!(
                "{}: is a folder, of which each bracket or map becomes a panorama; name the pictures \
                 that become one",
                from.display()
            )));
        }
    };
    if groups.is_empty() {
        return Err(CliError::wrong(format!(
            "{}: holds no pictures ({})",
            from.display(),
            endings.join(", ")
        )));
    }
    let tasks = folder::tasks(groups, &args.out)?;
    beside(args).try_for_each(|folder| folder::check(folder))?;
    tasks.iter().for_each(|task| global.say(&format!("panorama of {task}")));
    beside(args).try_for_each(|folder| folder::make(folder))?;
    let one = |task: &Task| convert(&of_task(task, args), global);
    folder::each(tasks, &args.out, args.skip_existing, global, one, text)
}

/// Photographs in brackets, as `merge` has them; floating-point pictures each alone.
fn groups(from: &Path, args: &Args) -> Result<Vec<Vec<PathBuf>>, CliError> {
    let photographs = folder::files(from, &PHOTOGRAPHS)?;
    let merged = folder::files(from, &MAPS)?.into_iter().map(|path| vec![path]);
    let listed = folder::listed(photographs)?;
    let grouping = args.group.map_or(Grouping::Repeats, Grouping::Count);
    let groups = if listed.is_empty() { Vec::new() } else { group(&listed, grouping)? };
    let groups = groups.into_iter();
    let groups = groups.map(|group| group.into_iter().map(|k| listed[k].path.clone()).collect());
    Ok(groups.chain(merged).collect())
}

/// Folders of what is written beside the panoramas.
fn beside(args: &Args) -> impl Iterator<Item = &PathBuf> {
    let further = &args.further;
    [&args.preview, &args.overlay, &further.irradiance, &further.axes].into_iter().flatten()
}

/// What is asked of one task: every file in the folder that is named for its kind, under the task's name.
fn of_task(task: &Task, args: &Args) -> Args {
    let mut of_task = args.clone();
    of_task.photos = task.photographs.clone();
    of_task.out = task.out.clone();
    let stem = task.out.file_stem().unwrap_or_default();
    let within = |folder: &mut Option<PathBuf>, ending: &str| {
        if let Some(folder) = folder {
            *folder = folder.join(stem).with_extension(ending);
        }
    };
    within(&mut of_task.preview, "png");
    within(&mut of_task.overlay, "png");
    within(&mut of_task.further.axes, "png");
    within(&mut of_task.further.irradiance, "exr");
    if let Some(folder) = &mut of_task.further.sibl {
        folder.push(stem);
    }
    of_task
}
