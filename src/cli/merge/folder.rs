//! `platelight merge FOLDER`: the brackets of a folder, one after the other; a bad one stops nothing.

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::{Args, Summary, one, text};
use crate::bracket::group::{Grouping, Listed, group};
use crate::cli::progress::progress_bar;
use crate::cli::{CliError, Global, Outcome};
use crate::photo;
use crate::shot::pictures;

/// Endings of photographs.
const PHOTOGRAPHS: [&str; 5] = ["jpg", "jpeg", "png", "tif", "tiff"];

/// How one bracket of the folder ended.
#[derive(Serialize)]
struct Ended {
    photographs: Vec<PathBuf>,
    #[serde(flatten)]
    merged: Option<Summary>,
    /// Why there is no result.
    problem: Option<String>,
}

pub(super) fn run(folder: &Path, args: &Args, global: &Global) -> Result<Outcome, CliError> {
    if args.out.is_file() {
        return Err(CliError::wrong(format!(
            "{}: is a file; {} is a folder, so name a folder to write to",
            args.out.display(),
            folder.display()
        )));
    }
    let listed = photographs(folder)?;
    let grouping = args.group.map_or(Grouping::Repeats, Grouping::Count);
    let groups = group(&listed, grouping)?;
    let (brackets, alone): (Vec<_>, Vec<_>) = groups.into_iter().partition(|g| g.len() > 1);
    if brackets.is_empty() {
        return Err(CliError::wrong(format!(
            "{}: no two photographs belong together; say how many make a bracket (--group)",
            folder.display()
        )));
    }
    let name = |k: usize| listed[k].path.file_name().unwrap_or_default().to_string_lossy();
    for bracket in &brackets {
        let names: Vec<_> = bracket.iter().map(|&k| name(k)).collect();
        global.say(&format!("bracket of {}: {}", names.len(), names.join(" ")));
    }
    for single in &alone {
        global.say(&format!("note: {} is alone and left out", name(single[0])));
    }
    std::fs::create_dir_all(&args.out).map_err(|cause| {
        CliError::wrong(format!("{}: cannot be made: {cause}; name another", args.out.display()))
    })?;

    let bar = progress_bar(global, "merge", brackets.len() as u64);
    let mut ended = Vec::new();
    for bracket in &brackets {
        global.go_on()?;
        let paths: Vec<PathBuf> = bracket.iter().map(|&k| listed[k].path.clone()).collect();
        let stem = paths[0].file_stem().unwrap_or_default();
        let out = args.out.join(stem).with_extension("exr");
        let (merged, problem) = match one(&paths, &out, args, global) {
            Ok(summary) => (Some(summary), None),
            Err(error) => (None, Some(error.sentence())),
        };
        if let Some(problem) = &problem {
            global.say(&format!("failed: {problem}"));
        }
        ended.push(Ended { photographs: paths, merged, problem });
        bar.inc(1);
    }
    bar.finish_and_clear();
    let problems: Vec<String> = ended.iter().filter_map(|e| e.problem.clone()).collect();
    if problems.len() == ended.len() {
        return Err(CliError::several(problems));
    }
    global.print(&ended, || {
        ended.iter().filter_map(|e| e.merged.as_ref()).map(text).collect::<Vec<_>>().join("\n")
    });
    Ok(if problems.is_empty() { Outcome::Done } else { Outcome::PartFailed })
}

/// The photographs of a folder in natural order, with what their cameras wrote.
fn photographs(folder: &Path) -> Result<Vec<Listed>, CliError> {
    let all = pictures::expand(&folder.join("*"))
        .map_err(|cause| CliError::wrong(format!("{}: {cause}", folder.display())))?;
    let is_photograph = |path: &PathBuf| {
        let ending = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
        PHOTOGRAPHS.contains(&ending.as_str())
    };
    let listed = all.into_iter().filter(is_photograph).map(|path| {
        let (facts, size) = photo::peek(&path)?;
        Ok(Listed { path, facts, size })
    });
    listed.collect()
}
