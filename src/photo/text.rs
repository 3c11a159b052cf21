//! Small text files that somebody wrote by hand: shot files, cameras, lists of times.

use std::io;
use std::path::Path;

use super::bytes;

/// The text of an ordinary file of at most `limit` bytes, without a byte-order mark.
///
/// # Errors
/// What cannot be read, is larger, or is no UTF-8; the sentence does not name the file.
pub fn read(path: &Path, limit: u64) -> io::Result<String> {
    let text = String::from_utf8(bytes::read(path, limit)?).map_err(|error| {
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
    }
}
