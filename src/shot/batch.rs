//! Many shots, one after the other: a bad one stops nothing and is not hidden.
//!
//! Folders → every `shot.toml` in or directly under them → [`run_frames`] → a summary.

use std::collections::{HashMap, HashSet};
use std::io::Write;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::time::Instant;

use serde::Serialize;

use super::file::ShotFile;
use super::run::{RunError, RunOptions, run_frames};
use super::watch::Watch;
use crate::photo::atomic;
use crate::render::Context;

/// How one shot of a batch ended.
#[derive(Clone, Debug, Serialize)]
pub struct ShotResult {
    pub shot: PathBuf,
    pub out: PathBuf,
    pub status: Status,
    pub frames: FrameCounts,
    /// What was wrong, each with file, key and remedy.
    pub problems: Vec<String>,
    /// How many warnings the shot's report holds.
    pub warnings: usize,
    pub seconds: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Status {
    Done,
    /// Finished before, from the same inputs.
    Skipped,
    /// Some frames failed, the others were written.
    Part,
    Failed,
    Interrupted,
}

/// How the frames of a shot ended; a shot without a sequence is one frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct FrameCounts {
    pub done: usize,
    pub skipped: usize,
    pub failed: usize,
    /// Stopped by the user, before or while they were rendered.
    pub missing: usize,
}

impl FrameCounts {
    fn status(self) -> Status {
        match self {
            Self { missing: 1.., .. } => Status::Interrupted,
            Self { failed: 1.., done: 0, skipped: 0, .. } => Status::Failed,
            Self { failed: 1.., .. } => Status::Part,
            Self { done: 0, skipped: 1.., .. } => Status::Skipped,
            _ => Status::Done,
        }
    }
}

/// Why a batch could not begin, or its summary not be written.
#[derive(Debug, thiserror::Error)]
pub enum BatchError {
    #[error("{}: holds no shot.toml, neither itself nor in a folder below it", .0.display())]
    NoShots(PathBuf),
    #[error("{}: {cause}; name folders that hold shots", path.display())]
    Unreadable { path: PathBuf, cause: std::io::Error },
    #[error("{}: cannot be written: {cause}", path.display())]
    Summary { path: PathBuf, cause: std::io::Error },
    #[error("{}: is found twice; name each shot once", .0.display())]
    Twice(PathBuf),
    #[error(
        "{} and {} would both write into {}; give their folders different names, or run them one by \
         one with a --out each",
        shots[0].display(), shots[1].display(), out.display()
    )]
    SameOut { shots: [PathBuf; 2], out: PathBuf },
}

/// The shot files in or directly under these folders, in the order of their names.
///
/// # Errors
/// A folder without shots; a shot found twice; two shots whose results would lie in one folder, where
/// the second would replace the first. `out` is the folder of all results, see [`out_folder`].
pub fn find_shots(folders: &[PathBuf], out: Option<&Path>) -> Result<Vec<PathBuf>, BatchError> {
    let mut shots = Vec::new();
    for folder in folders {
        let own = folder.join("shot.toml");
        if folder.is_file() {
            shots.push(folder.clone());
            continue;
        }
        if own.is_file() {
            shots.push(own);
            continue;
        }
        let unreadable = |cause| BatchError::Unreadable { path: folder.clone(), cause };
        let mut below = Vec::new();
        for entry in std::fs::read_dir(folder).map_err(unreadable)? {
            let shot = entry.map_err(unreadable)?.path().join("shot.toml");
            if shot.is_file() {
                below.push(shot);
            }
        }
        if below.is_empty() {
            return Err(BatchError::NoShots(folder.clone()));
        }
        below.sort();
        shots.append(&mut below);
    }
    refuse_collisions(&shots, out)?;
    Ok(shots)
}

/// No shot twice, however its path is written, and no two shots with one folder for their results.
fn refuse_collisions(shots: &[PathBuf], out: Option<&Path>) -> Result<(), BatchError> {
    let mut seen = HashSet::new();
    let mut written = HashMap::new();
    for shot in shots {
        let real = real_path(shot);
        let folder = out_folder(&real, out);
        if !seen.insert(real) {
            return Err(BatchError::Twice(shot.clone()));
        }
        if let Some(other) = written.insert(folder, shot) {
            let out = out_folder(shot, out);
            return Err(BatchError::SameOut { shots: [other.clone(), shot.clone()], out });
        }
    }
    Ok(())
}

/// The shot file in its folder's one true path. The file itself may be a link: the paths in it start
/// from where the link lies.
fn real_path(shot: &Path) -> PathBuf {
    let folder = shot.parent().filter(|folder| !folder.as_os_str().is_empty());
    let real = std::fs::canonicalize(folder.unwrap_or(Path::new(".")));
    match (real, shot.file_name()) {
        (Ok(folder), Some(name)) => folder.join(name),
        _ => shot.to_owned(),
    }
}

/// Where a shot's results go: `out/` beside the shot file, or its folder's name under `out`.
pub fn out_folder(shot: &Path, out: Option<&Path>) -> PathBuf {
    let folder = shot.parent().unwrap_or(Path::new(""));
    match out {
        None => folder.join("out"),
        Some(out) => {
            let name = folder.file_name().unwrap_or(std::ffi::OsStr::new("shot"));
            out.join(name)
        }
    }
}

/// Runs every shot; `tell` hears of each as it ends.
pub fn run_batch(
    shots: &[PathBuf],
    out: Option<&Path>,
    options: &RunOptions,
    context: &Context,
    watch: &dyn Watch,
    mut tell: impl FnMut(&ShotResult),
) -> Vec<ShotResult> {
    let mut results = Vec::with_capacity(shots.len());
    for shot in shots {
        if context.is_cancelled() {
            break;
        }
        let result = run_one(shot, out_folder(shot, out), options, context, watch);
        tell(&result);
        results.push(result);
    }
    results
}

fn run_one(
    shot: &Path,
    out: PathBuf,
    options: &RunOptions,
    context: &Context,
    watch: &dyn Watch,
) -> ShotResult {
    let start = Instant::now();
    // A defect in one shot must not take the night's other shots with it. Nothing of a shot is
    // shared with the next.
    let outcome = catch_unwind(AssertUnwindSafe(|| match ShotFile::read(shot) {
        Ok(file) => run_frames(&file, &out, options, context, watch),
        Err(error) => vec![Err(RunError::Problems(error.problems()))],
    }));
    let ended = outcome.unwrap_or_else(|_| {
        vec![Err(RunError::Problems(vec![format!(
            "{}: a defect in platelight stopped this shot; please report it with the lines above",
            shot.display()
        )]))]
    });
    let mut frames = FrameCounts::default();
    let (mut problems, mut warnings) = (Vec::new(), 0);
    for frame in ended {
        match frame {
            Ok(finished) if finished.skipped => frames.skipped += 1,
            Ok(finished) => {
                let count = if finished.complete { &mut frames.done } else { &mut frames.missing };
                *count += 1;
                warnings += finished.warnings;
            }
            Err(RunError::Interrupted) => frames.missing += 1,
            Err(error) => {
                frames.failed += 1;
                for problem in error.problems() {
                    // What is wrong with the shot itself, every frame finds.
                    if !problems.contains(&problem) {
                        problems.push(problem);
                    }
                }
            }
        }
    }
    let seconds = start.elapsed().as_secs_f64();
    let (shot, status) = (shot.to_owned(), frames.status());
    ShotResult { shot, out, status, frames, problems, warnings, seconds }
}

/// Writes batch.json.
pub fn write_summary(path: &Path, results: &[ShotResult]) -> Result<(), BatchError> {
    let error = |cause| BatchError::Summary { path: path.to_owned(), cause };
    let json = serde_json::to_vec_pretty(&serde_json::json!({ "shots": results }))
        .map_err(|e| error(e.into()))?;
    atomic::write(path, |file| file.write_all(&json)).map_err(error)
}

/// The summary as a table.
pub fn table(results: &[ShotResult]) -> String {
    let name = |result: &ShotResult| result.shot.display().to_string();
    let width = results.iter().map(|r| name(r).chars().count()).max().unwrap_or(0).max(4);
    let mut lines =
        vec![format!("{:width$}  {:11}  {:>8}  {:>8}", "shot", "status", "seconds", "warnings")];
    for result in results {
        let status = status_of(result);
        lines.push(format!(
            "{:width$}  {status:11}  {:>8.1}  {:>8}",
            name(result),
            result.seconds,
            result.warnings
        ));
        lines.extend(result.problems.iter().map(|problem| format!("    {problem}")));
    }
    lines.join("\n")
}

/// "done"; "part 46/48" where some frames are written and some not.
fn status_of(result: &ShotResult) -> String {
    let word = format!("{:?}", result.status).to_lowercase();
    let FrameCounts { done, skipped, failed, missing } = result.frames;
    let all = done + skipped + failed + missing;
    match result.status {
        Status::Part | Status::Interrupted if all > 1 => format!("{word} {}/{all}", done + skipped),
        _ => word,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shots_are_found_in_and_under_folders() {
        let root = tempfile::tempdir().unwrap();
        for name in ["b", "a", "empty"] {
            std::fs::create_dir(root.path().join(name)).unwrap();
        }
        for name in ["b", "a"] {
            std::fs::write(root.path().join(name).join("shot.toml"), "").unwrap();
        }
        let all = find_shots(&[root.path().to_owned()], None).unwrap();
        assert_eq!(all, [root.path().join("a/shot.toml"), root.path().join("b/shot.toml")]);
        let one = find_shots(&[root.path().join("b")], None).unwrap();
        assert_eq!(one, [root.path().join("b/shot.toml")]);
        assert!(matches!(
            find_shots(&[root.path().join("empty")], None),
            Err(BatchError::NoShots(_))
        ));
        let twice = [root.path().to_owned(), root.path().join("a")];
        assert!(matches!(find_shots(&twice, None), Err(BatchError::Twice(_))));
        assert!(find_shots(&[root.path().join("missing")], None).is_err());
    }

    #[test]
    fn two_shots_that_would_write_into_one_folder_are_refused_with_both_names() {
        let root = tempfile::tempdir().unwrap();
        let folder = |name: &str| root.path().join(name).join("robot");
        for name in ["x", "y"] {
            std::fs::create_dir_all(folder(name)).unwrap();
            std::fs::write(folder(name).join("shot.toml"), "").unwrap();
        }
        std::fs::write(folder("x").join("night.toml"), "").unwrap();
        let both = [folder("x"), folder("y")];
        assert_eq!(find_shots(&both, None).unwrap().len(), 2);
        let said = find_shots(&both, Some(Path::new("bo"))).unwrap_err().to_string();
        for part in ["x/robot/shot.toml", "y/robot/shot.toml", "bo/robot"] {
            assert!(said.contains(part), "{said}");
        }
        // Two shot files of one folder share its out/.
        let files = ["shot.toml", "night.toml"].map(|name| folder("x").join(name));
        assert!(matches!(find_shots(&files, None), Err(BatchError::SameOut { .. })));
    }

    #[test]
    fn a_shot_named_along_two_paths_is_found_twice() {
        let root = tempfile::tempdir().unwrap();
        for name in ["a", "b"] {
            std::fs::create_dir(root.path().join(name)).unwrap();
        }
        std::fs::write(root.path().join("a/shot.toml"), "").unwrap();
        let twice = [root.path().join("a"), root.path().join("b/../a")];
        assert!(matches!(find_shots(&twice, None), Err(BatchError::Twice(_))));
    }

    #[test]
    fn a_shot_is_as_far_as_its_frames_are() {
        let counts = |done, skipped, failed, missing| {
            FrameCounts { done, skipped, failed, missing }.status()
        };
        assert_eq!(counts(3, 1, 0, 0), Status::Done);
        assert_eq!(counts(0, 4, 0, 0), Status::Skipped);
        assert_eq!(counts(2, 0, 1, 0), Status::Part);
        assert_eq!(counts(0, 2, 1, 0), Status::Part);
        assert_eq!(counts(0, 0, 3, 0), Status::Failed);
        assert_eq!(counts(2, 0, 1, 1), Status::Interrupted);
    }

    #[test]
    fn results_go_beside_the_shot_or_under_the_given_folder() {
        let shot = Path::new("shots/robot/shot.toml");
        assert_eq!(out_folder(shot, None), Path::new("shots/robot/out"));
        assert_eq!(out_folder(shot, Some(Path::new("/renders"))), Path::new("/renders/robot"));
    }
}
