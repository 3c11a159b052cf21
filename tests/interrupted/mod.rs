//! Ctrl-C: a picture that is there is written whole, and nothing half-written is left.

use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use crate::program::text;
use crate::tiny::{Plate, write_cube, write_shot};

/// Longer than any machine needs for what is waited for here.
const PATIENCE: Duration = Duration::from_secs(60);

/// A run that ends with the test, however that ends.
struct Run(Child);

impl Drop for Run {
    fn drop(&mut self) {
        // It has ended, or somebody gave up on it.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A shot that would render for days.
fn start(folder: &Path) -> Run {
    let cube = write_cube(folder, 0.4);
    let shot = write_shot(folder, Plate::Png8, &cube);
    let endless = std::fs::read_to_string(&shot).expect("shot").replace("= 8\n", "= 60000000\n");
    std::fs::write(&shot, endless).expect("shot");
    let child = Command::new(assert_cmd::cargo::cargo_bin("platelight"))
        .args(["run", text(folder)])
        .stderr(Stdio::null())
        .stdout(Stdio::null())
        .spawn();
    Run(child.expect("the program starts"))
}

fn send(signal: &str, run: &Run) {
    // The shell's own: a machine may have no other.
    let kill = format!("kill {signal} {}", run.0.id());
    let sent = Command::new("sh").args(["-c", &kill]).status();
    assert!(sent.expect("a shell is there").success());
}

fn end_of(run: &mut Run) -> ExitStatus {
    let begin = Instant::now();
    loop {
        if let Some(status) = run.0.try_wait().expect("a child") {
            return status;
        }
        assert!(begin.elapsed() <= PATIENCE, "it went on after Ctrl-C");
        std::thread::sleep(Duration::from_millis(20));
    }
}

fn wait_for(path: &Path) {
    let begin = Instant::now();
    while !path.exists() {
        assert!(begin.elapsed() < PATIENCE, "{} does not appear", path.display());
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// Names of the files in a folder; none if it is not there.
fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).into_iter().flatten();
    entries.map(|e| e.expect("an entry").file_name().to_string_lossy().into_owned()).collect()
}

#[test]
fn an_interrupted_run_writes_the_picture_it_has_and_leaves_no_temporary_file() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut run = start(folder.path());
    let out = folder.path().join("out");
    wait_for(&out.join("composite.png"));
    send("-INT", &run);
    assert_eq!(end_of(&mut run).code(), Some(130));
    let report = std::fs::read(out.join("report.json")).expect("the picture was finished");
    let report: serde_json::Value = serde_json::from_slice(&report).expect("JSON");
    assert_eq!(report.pointer("/render/complete"), Some(&false.into()));
    let left: Vec<String> = names(&out).into_iter().filter(|name| name.starts_with('.')).collect();
    assert!(left.is_empty(), "{left:?}");
}

#[test]
fn a_run_interrupted_early_leaves_whole_files_or_none() {
    for milliseconds in [0, 30, 100, 300] {
        let folder = tempfile::tempdir().expect("a folder");
        let mut run = start(folder.path());
        std::thread::sleep(Duration::from_millis(milliseconds));
        // Not Ctrl-C's: what is started in the background of a shell is deaf to that at first.
        send("-TERM", &run);
        let status = end_of(&mut run);
        // No code: it was killed before its first line.
        assert!(matches!(status.code(), None | Some(130)), "{status}");
        let left = names(&folder.path().join("out"));
        assert!(left.is_empty() || left.iter().any(|name| name == "report.json"), "{left:?}");
        assert!(!left.iter().any(|name| name.starts_with('.')), "{left:?}");
    }
}
