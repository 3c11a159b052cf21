//! Small text files that somebody wrote by hand: shot files, cameras, lists of times.

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

/// The text of an ordinary file of at most `limit` bytes, without a byte-order mark.
///
/// Devices and pipes are refused before they are opened: reading them may never end.
///
/// # Errors
/// What cannot be read, is larger, or is no UTF-8; the sentence does not name the file.
pub fn read(path: &Path, limit: u64) -> io::Result<String> {
    if !std::fs::metadata(path)?.is_file() {
        return Err(io::Error::other("it is no regular file"));
    }
    let mut bytes = Vec::new();
    File::open(path)?.take(limit + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > limit {
        let found =
            format!("it is larger than {} KiB, too large for what it should be", limit >> 10);
        return Err(io::Error::other(found));
    }
    let text = String::from_utf8(bytes).map_err(|error| {
        io::Error::other(match error.as_bytes() {
            [0xff, 0xfe, ..] | [0xfe, 0xff, ..] => "it is UTF-16 text; save it as UTF-8",
            _ => "it is not UTF-8 text; save it as UTF-8, or name another file",
        })
    })?;
    Ok(match text.strip_prefix("\u{feff}") {
        Some(rest) => rest.to_owned(),
        None => text,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_read_and_anything_else_refused_with_its_kind() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("shot.toml");
        let given = |bytes: &[u8]| {
            std::fs::write(&path, bytes).unwrap();
            read(&path, 16).map_err(|error| error.to_string())
        };
        assert_eq!(given("\u{feff}a = \"é\"".as_bytes()).unwrap(), "a = \"é\"");
        assert!(given(b"\xff\xfea\0").unwrap_err().contains("UTF-16"));
        assert!(given(b"caf\xe9").unwrap_err().contains("not UTF-8"));
        assert!(given(&[b'a'; 17]).unwrap_err().contains("larger"));
        assert!(read(folder.path(), 16).is_err() && read(&folder.path().join("no"), 16).is_err());
        #[cfg(unix)]
        assert!(read(Path::new("/dev/zero"), 16).unwrap_err().to_string().contains("regular"));
    }
}
