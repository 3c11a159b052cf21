//! The files that a command is told to write, and whether it may.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use super::CliError;
use crate::conventions::Rgb;
use crate::photo::{Encoding, EncodingSource, Image, Primaries, Transfer, atomic, png};

/// Refuses, before any work, to write over a file that is read, twice to one file, or where nothing
/// can be written.
pub(super) fn check_outputs(inputs: &[&Path], outputs: &[&Path]) -> Result<(), CliError> {
    for (i, output) in outputs.iter().enumerate() {
        let taken = place(output);
        if inputs.iter().any(|input| place(input) == taken) {
            let path = output.display();
            return Err(CliError::wrong(format!(
                "{path}: is read and would be overwritten; name another file to write"
            )));
        }
        if outputs[..i].iter().any(|other| place(other) == taken) {
            let path = output.display();
            return Err(CliError::wrong(format!("{path}: is named twice to be written")));
        }
        if let Err(cause) = atomic::check(output) {
            let path = output.display();
            return Err(CliError::wrong(format!(
                "{path}: cannot be written: {cause}; name a file in a folder that takes files"
            )));
        }
    }
    Ok(())
}

/// A photograph named twice would count as two views.
pub(super) fn refuse_repeated(inputs: &[PathBuf]) -> Result<(), CliError> {
    let mut seen = HashSet::new();
    match inputs.iter().find(|input| !seen.insert(place(input))) {
        None => Ok(()),
        Some(twice) => {
            let path = twice.display();
            Err(CliError::wrong(format!("{path}: is named twice; name each photograph once")))
        }
    }
}

/// A name's ending must be that of what is written: a picture named otherwise is opened as what it
/// is not.
pub(super) fn check_ending(out: &Path, ending: &str) -> Result<(), CliError> {
    if out.extension().is_some_and(|found| found.eq_ignore_ascii_case(ending)) {
        return Ok(());
    }
    let (path, better) = (out.display(), out.with_extension(ending));
    Err(CliError::wrong(format!(
        "{path}: the name must end in .{ending}, which is what is written; name it {}",
        better.display()
    )))
}

/// Writes what is to be seen, display-linear light 0…1, as an 8-bit sRGB PNG.
pub(super) fn write_png(path: &Path, shown: &Image<Rgb>) -> Result<(), CliError> {
    let encoding = Encoding {
        transfer: Transfer::Srgb,
        primaries: Primaries::Rec709,
        source: EncodingSource::Named,
    };
    png::write(path, &png::srgb_codes(shown), shown.width(), shown.height(), &encoding)?;
    Ok(())
}

/// The one path of a file, however it is spelled; of one that is not there yet, in its folder's.
fn place(path: &Path) -> PathBuf {
    if let Ok(there) = std::fs::canonicalize(path) {
        return there;
    }
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    match (std::fs::canonicalize(folder.unwrap_or(Path::new("."))), path.file_name()) {
        (Ok(folder), Some(name)) => folder.join(name),
        _ => path.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_new_file_named_in_two_ways_is_named_twice() {
        let root = tempfile::tempdir().unwrap();
        std::fs::create_dir(root.path().join("b")).unwrap();
        let (plain, roundabout) = (root.path().join("a.png"), root.path().join("b/../a.png"));
        assert!(check_outputs(&[], &[&plain]).is_ok());
        let said = format!("{:?}", check_outputs(&[], &[&plain, &roundabout]).unwrap_err());
        assert!(said.contains("named twice"), "{said}");
        // One that will not be there before it is written is no input either.
        assert!(check_outputs(&[&root.path().join("b/a.png")], &[&plain]).is_ok());
        assert!(check_outputs(&[&roundabout], &[&plain]).is_err());
    }
}
