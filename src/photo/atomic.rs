//! Files appear whole or not at all.

use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use tempfile::NamedTempFile;

/// Writes a file through a temporary one in the same folder, renamed when complete.
///
/// A reader never sees half a file, and a failed write leaves what was there, also when the power
/// fails between the two. Its mode is any new file's (0666 less the umask): the temporary file's own
/// 0600 would hide results from the rest of a studio.
pub fn write<E: From<io::Error>>(
    path: &Path,
    fill: impl FnOnce(&mut File) -> Result<(), E>,
) -> Result<(), E> {
    let target = target(path)?;
    let mut temporary = temporary_in(folder_of(&target))?;
    fill(temporary.as_file_mut())?;
    temporary.as_file_mut().flush()?;
    // Before the rename: some file systems write names before contents.
    temporary.as_file().sync_all()?;
    temporary.persist(&target).map_err(|e| e.error)?;
    Ok(())
}

/// Whether [`write`] would find room for a file at `path`: to be asked before minutes of work.
///
/// # Errors
/// The folder is not there or takes no files, or something else than a file has the name.
pub fn check(path: &Path) -> io::Result<()> {
    temporary_in(folder_of(&target(path)?)).map(drop)
}

/// Whether files can be written into a folder, which need not exist yet: it is not made now.
///
/// # Errors
/// It, or the nearest folder above it that exists, takes no files; or a file is in its place.
pub fn check_folder(folder: &Path) -> io::Result<()> {
    let is_there = |folder: &&Path| std::fs::symlink_metadata(folder).is_ok();
    let there = folder.ancestors().filter(|path| !path.as_os_str().is_empty()).find(is_there);
    temporary_in(there.unwrap_or(Path::new("."))).map(drop)
}

/// Where the file is put: what a link points to is replaced, not the link; devices and pipes cannot
/// be.
fn target(path: &Path) -> io::Result<PathBuf> {
    match std::fs::metadata(path) {
        Ok(there) if there.is_file() => std::fs::canonicalize(path),
        Ok(_) => Err(io::Error::other("it exists and is no regular file")),
        Err(_) if path.file_name().is_none() => Err(io::Error::other("it names no file")),
        Err(_) => Ok(path.to_owned()),
    }
}

fn folder_of(path: &Path) -> &Path {
    let parent = path.parent().filter(|parent| !parent.as_os_str().is_empty());
    parent.unwrap_or(Path::new("."))
}

/// A temporary file. Its errors do not tell its name, which nobody knows, but the folder's trouble.
fn temporary_in(folder: &Path) -> io::Result<NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(".platelight-");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    builder.tempfile_in(folder).map_err(|error| {
        let (kind, place) = (error.kind(), folder.display());
        let said = match std::fs::metadata(folder) {
            // A folder of the system itself, such as /proc, knows no new names.
            Ok(there) if there.is_dir() && kind == io::ErrorKind::NotFound => {
                format!("the system lets nobody make files in {place}")
            }
            Ok(there) if there.is_dir() => format!("folder {place} takes no files: {kind}"),
            Ok(_) => format!("{place} is a file, not a folder"),
            Err(_) => format!("the folder {place} is not there"),
        };
        io::Error::new(kind, said)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failed_write_leaves_the_old_file_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.txt");
        write(&path, |f| f.write_all(b"old")).unwrap();
        let failed = write(&path, |f| {
            f.write_all(b"half")?;
            Err(io::Error::other("disk full"))
        });
        assert!(failed.is_err());
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[cfg(unix)]
    #[test]
    fn a_file_has_the_mode_of_any_new_file() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let mode = |name: &str| {
            let path = folder.path().join(name);
            std::fs::metadata(path).unwrap().permissions().mode() & 0o777
        };
        File::create(folder.path().join("plain")).unwrap();
        write(&folder.path().join("ours"), |f| f.write_all(b"x")).unwrap();
        assert_eq!(mode("ours"), mode("plain"));
    }

    #[cfg(unix)]
    #[test]
    fn a_link_stays_a_link_and_a_folder_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let (file, link) = (folder.path().join("file"), folder.path().join("link"));
        write(&file, |f| f.write_all(b"old")).unwrap();
        std::os::unix::fs::symlink(&file, &link).unwrap();
        write(&link, |f| f.write_all(b"new")).unwrap();
        assert_eq!(std::fs::read(&file).unwrap(), b"new");
        assert!(std::fs::symlink_metadata(&link).unwrap().is_symlink());
        assert!(write(folder.path(), |f| f.write_all(b"x")).is_err());
    }

    #[test]
    fn a_missing_folder_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("missing/a.txt");
        assert!(write(&path, |f| f.write_all(b"x")).is_err());
    }

    #[test]
    fn room_is_found_or_missed_before_the_work_and_nothing_is_left() {
        let folder = tempfile::tempdir().unwrap();
        let inside = |name: &str| folder.path().join(name);
        assert!(check(&inside("a.txt")).is_ok() && check_folder(&inside("new/deeper")).is_ok());
        let said = check(&inside("missing/a.txt")).unwrap_err().to_string();
        assert!(said.contains("missing") && !said.contains(".platelight-"), "{said}");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
        File::create(inside("file")).unwrap();
        for blocked in ["file", "file/out"] {
            assert!(check_folder(&inside(blocked)).is_err(), "{blocked}");
        }
        assert!(check(folder.path()).is_err() && check(Path::new("/")).is_err());
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_folder_that_takes_no_files_is_told_by_its_own_name() {
        let said = check(Path::new("/proc/a.png")).unwrap_err().to_string();
        assert!(said.contains("/proc") && !said.contains(".platelight-"), "{said}");
        assert!(check_folder(Path::new("/proc/out")).is_err());
    }
}
