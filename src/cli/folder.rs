//! A folder of photographs, by the batch's rules: all that can be judged is judged before the first is
//! read, a bad one stops nothing, and a summary goes to stdout and to `batch.json`.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::progress::progress_bar;
use super::{CliError, Global, Outcome};
use crate::bracket::group::Listed;
use crate::photo::{self, atomic};
use crate::shot::pictures;

/// How one of a folder's tasks ended.
#[derive(Serialize)]
struct Ended<T> {
    photographs: Vec<PathBuf>,
    #[serde(flatten)]
    done: Option<T>,
    /// Why there is no result.
    problem: Option<String>,
    /// Left alone: its result is there and newer than its photographs.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    skipped: bool,
}

/// Endings of photographs.
pub(super) const PHOTOGRAPHS: [&str; 5] = ["jpg", "jpeg", "png", "tif", "tiff"];

/// What becomes of photographs.
pub(super) struct Task {
    pub photographs: Vec<PathBuf>,
    pub out: PathBuf,
}

/// How many, and their names.
impl std::fmt::Display for Task {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        write!(f, "{}:", self.photographs.len())?;
        self.photographs.iter().try_for_each(|path| {
            write!(f, " {}", path.file_name().unwrap_or_default().to_string_lossy())
        })
    }
}

/// The files of a folder with one of these endings, in natural order.
pub(super) fn files(folder: &Path, endings: &[&str]) -> Result<Vec<PathBuf>, CliError> {
    let mut all = pictures::expand(&folder.join("*"))
        .map_err(|cause| CliError::wrong(format!("{}: {cause}", folder.display())))?;
    all.retain(|path| {
        let ending = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
        endings.contains(&ending.as_str())
    });
    Ok(all)
}

/// What cameras wrote beside photographs, their pixels not read.
pub(super) fn listed(photographs: Vec<PathBuf>) -> Result<Vec<Listed>, CliError> {
    let listed = photographs.into_iter().map(|path| {
        let (facts, size) = photo::peek(&path)?;
        Ok(Listed { path, facts, size })
    });
    listed.collect()
}

/// Whether a folder for results can be made, or is there and takes files.
pub(super) fn check(folder: &Path) -> Result<(), CliError> {
    let name = folder.display();
    if folder.is_file() {
        return Err(CliError::wrong(format!(
            "{name}: is a file; of a folder many are made, so name a folder to write to"
        )));
    }
    atomic::check_folder(folder).map_err(|cause| {
        CliError::wrong(format!("{name}: nothing can be written there: {cause}; name another"))
    })
}

/// Makes a folder for results.
pub(super) fn make(folder: &Path) -> Result<(), CliError> {
    std::fs::create_dir_all(folder).map_err(|cause| {
        CliError::wrong(format!("{}: cannot be made: {cause}; name another", folder.display()))
    })
}

/// A file in the folder `out` for each group of photographs, named after its first one.
///
/// # Errors
/// `out` cannot hold them, or two groups would be one file.
pub(super) fn tasks(groups: Vec<Vec<PathBuf>>, out: &Path) -> Result<Vec<Task>, CliError> {
    check(out)?;
    let mut taken: HashMap<PathBuf, PathBuf> = HashMap::new();
    let mut tasks = Vec::new();
    for photographs in groups {
        let Some(first) = photographs.first().cloned() else { continue };
        let out = out.join(first.file_stem().unwrap_or_default()).with_extension("exr");
        if let Some(other) = taken.insert(out.clone(), first.clone()) {
            return Err(CliError::wrong(format!(
                "{} and {} would both become {}; rename one of them",
                other.display(),
                first.display(),
                out.display()
            )));
        }
        tasks.push(Task { photographs, out });
    }
    Ok(tasks)
}

/// Whether a task's result is there and newer than all it is made of.
fn is_done(task: &Task) -> bool {
    let changed = |path: &PathBuf| path.metadata().and_then(|of| of.modified()).ok();
    let Some(made) = changed(&task.out) else { return false };
    task.photographs.iter().all(|path| changed(path).is_some_and(|changed| changed < made))
}

/// Does every task, one after the other; with `skip_done` those alone whose results are not there.
///
/// # Errors
/// All failed.
pub(super) fn each<T: Serialize>(
    tasks: Vec<Task>,
    out: &Path,
    skip_done: bool,
    global: &Global,
    one: impl Fn(&Task) -> Result<T, CliError>,
    text: impl Fn(&T) -> String,
) -> Result<Outcome, CliError> {
    make(out)?;
    let bar = progress_bar(global, "photographs", tasks.len() as u64);
    let mut ended = Vec::new();
    let mut interrupted = false;
    for task in tasks {
        let skipped = skip_done && is_done(&task);
        let (done, problem) = if skipped {
            (None, None)
        } else {
            match one(&task) {
                Ok(done) => (Some(done), None),
                Err(error) => (None, Some(error.sentence())),
            }
        };
        interrupted = global.go_on().is_err();
        if interrupted {
            break;
        }
        if let Some(problem) = &problem {
            global.say(&format!("failed: {problem}"));
        }
        ended.push(Ended { photographs: task.photographs, done, problem, skipped });
        bar.inc(1);
    }
    bar.finish_and_clear();
    let problems: Vec<String> = ended.iter().filter_map(|e| e.problem.clone()).collect();
    if !ended.is_empty() && problems.len() == ended.len() {
        return Err(CliError::several(problems));
    }
    write_summary(&out.join("batch.json"), &ended)?;
    global.print(&ended, || {
        let told = |ended: &Ended<T>| match (&ended.done, &ended.problem) {
            (Some(done), _) => text(done),
            (None, Some(problem)) => format!("failed: {problem}"),
            (None, None) => format!("{}: is there already", ended.photographs[0].display()),
        };
        ended.iter().map(told).collect::<Vec<_>>().join("\n")
    });
    Ok(match (interrupted, problems.is_empty()) {
        (true, _) => Outcome::Interrupted,
        (false, true) => Outcome::Done,
        (false, false) => Outcome::PartFailed,
    })
}

fn write_summary(path: &Path, ended: &impl Serialize) -> Result<(), CliError> {
    let wrong = |cause: std::io::Error| {
        CliError::wrong(format!("{}: cannot be written: {cause}", path.display()))
    };
    let json = serde_json::to_vec_pretty(ended).map_err(|cause| wrong(cause.into()))?;
    atomic::write(path, |file| std::io::Write::write_all(file, &json)).map_err(wrong)
}
