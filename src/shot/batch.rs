//! Many shots, one after the other: a bad one stops nothing and is not hidden.
//!
//! Folders → every `shot.toml` in or directly under them → [`run`](super::run::run) → a summary.

use std::io::Write;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::time::Instant;

use serde::Serialize;

use super::file::ShotFile;
use super::run::{RunError, RunOptions, run};
use super::watch::Watch;
use crate::photo::atomic;
use crate::render::Context;

/// How one shot of a batch ended.
#[derive(Clone, Debug, Serialize)]
pub struct ShotResult {
    pub shot: PathBuf,
    pub out: PathBuf,
    pub status: Status,
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
    Failed,
    Interrupted,
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
}

/// The shot files in or directly under these folders, in the order of their names.
pub fn find_shots(folders: &[PathBuf]) -> Result<Vec<PathBuf>, BatchError> {
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
    let mut sorted = shots.clone();
    sorted.sort();
    match sorted.windows(2).find(|pair| pair[0] == pair[1]) {
        Some(pair) => Err(BatchError::Twice(pair[0].clone())),
        None => Ok(shots),
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
    let outcome = catch_unwind(AssertUnwindSafe(|| {
        let file = ShotFile::read(shot).map_err(|e| RunError::Problems(vec![e.to_string()]))?;
        run(&file, &out, options, context, watch)
    }));
    let (status, problems, warnings) = match outcome {
        Ok(Ok(finished)) => {
            let status = match (finished.skipped, finished.complete) {
                (true, _) => Status::Skipped,
                (false, true) => Status::Done,
                (false, false) => Status::Interrupted,
            };
            (status, Vec::new(), finished.warnings)
        }
        Ok(Err(RunError::Interrupted)) => (Status::Interrupted, Vec::new(), 0),
        Ok(Err(error)) => (Status::Failed, error.problems(), 0),
        Err(_) => {
            let sentence = format!(
                "{}: a defect in platelight stopped this shot; please report it with the lines above",
                shot.display()
            );
            (Status::Failed, vec![sentence], 0)
        }
    };
    let seconds = start.elapsed().as_secs_f64();
    ShotResult { shot: shot.to_owned(), out, status, problems, warnings, seconds }
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
        let status = format!("{:?}", result.status).to_lowercase();
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
        let all = find_shots(&[root.path().to_owned()]).unwrap();
        assert_eq!(all, [root.path().join("a/shot.toml"), root.path().join("b/shot.toml")]);
        let one = find_shots(&[root.path().join("b")]).unwrap();
        assert_eq!(one, [root.path().join("b/shot.toml")]);
        assert!(matches!(find_shots(&[root.path().join("empty")]), Err(BatchError::NoShots(_))));
        let twice = [root.path().to_owned(), root.path().join("a")];
        assert!(matches!(find_shots(&twice), Err(BatchError::Twice(_))));
        assert!(find_shots(&[root.path().join("missing")]).is_err());
    }

    #[test]
    fn results_go_beside_the_shot_or_under_the_given_folder() {
        let shot = Path::new("shots/robot/shot.toml");
        assert_eq!(out_folder(shot, None), Path::new("shots/robot/out"));
        assert_eq!(out_folder(shot, Some(Path::new("/renders"))), Path::new("/renders/robot"));
    }
}
