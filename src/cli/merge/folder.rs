//! `platelight merge FOLDER`: the brackets of a folder.

use std::path::{Path, PathBuf};

use super::{Args, one, text};
use crate::bracket::group::{Grouping, group};
use crate::cli::folder::{self, Task};
use crate::cli::{CliError, Global, Outcome};

pub(super) fn run(from: &Path, args: &Args, global: &Global) -> Result<Outcome, CliError> {
    let listed = folder::listed(folder::files(from, &folder::PHOTOGRAPHS)?)?;
    let grouping = args.group.map_or(Grouping::Repeats, Grouping::Count);
    let groups = group(&listed, grouping)?;
    let (brackets, alone): (Vec<_>, Vec<_>) = groups.into_iter().partition(|g| g.len() > 1);
    if brackets.is_empty() {
        return Err(CliError::wrong(format!(
            "{}: no two photographs belong together; say how many make a bracket (--group)",
            from.display()
        )));
    }
    let path = |k: usize| listed[k].path.clone();
    let brackets: Vec<Vec<PathBuf>> =
        brackets.into_iter().map(|bracket| bracket.into_iter().map(path).collect()).collect();
    let tasks = folder::tasks(brackets, &args.out)?;
    tasks.iter().for_each(|task| global.say(&format!("bracket of {task}")));
    for single in alone {
        let alone = path(single[0]);
        let name = alone.file_name().unwrap_or_default().to_string_lossy();
        global.say(&format!("note: {name} is alone and left out"));
    }
    let one = |task: &Task| one(&task.photographs, &task.out, args, global);
    folder::each(tasks, &args.out, args.skip_existing, global, one, text)
}
