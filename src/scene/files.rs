//! Reading files that a stranger made: sizes, names and encodings that are not to be trusted.

use std::path::{Path, PathBuf};

use super::SceneError;
use crate::photo::bytes::{self, BytesError};

/// Largest file read, bytes.
const MAX_FILE: u64 = 2 << 30;

/// All bytes of an ordinary file of at most [`MAX_FILE`].
pub(super) fn read_file(path: &Path) -> Result<Vec<u8>, SceneError> {
    bytes::read(path, MAX_FILE).map_err(|error| match error {
        BytesError::Read(source) => SceneError::Read { path: path.into(), source },
        BytesError::TooLarge { bytes, limit } => SceneError::TooLarge {
            path: path.into(),
            place: "the file".into(),
            found: format!("{} MiB", bytes >> 20),
            limit: format!("{} GiB", limit >> 30),
            remedy: "split it into several files",
        },
    })
}

/// The file that `name`, written inside the file `from`, means: beside it or in a folder below.
///
/// Absolute paths, `..` and other schemes are refused: a mesh file from elsewhere has no business
/// outside its own folder.
pub(super) fn beside(from: &Path, name: &str) -> Result<PathBuf, String> {
    let is_relative = !name.starts_with('/') && !name.contains(':') && !name.contains('\0');
    let mut path = from.parent().unwrap_or(Path::new("")).to_path_buf();
    let mut parts = 0;
    for part in name.split(['/', '\\']).filter(|part| !part.is_empty() && *part != ".") {
        if part == ".." {
            return Err(outside());
        }
        path.push(part);
        parts += 1;
    }
    if is_relative && parts > 0 { Ok(path) } else { Err(outside()) }
}

fn outside() -> String {
    "only files beside it or in folders below are read; put the file there".into()
}

/// Text with `%41` for `A` made plain.
pub(super) fn percent_decoded(text: &str) -> Result<String, String> {
    let mut bytes = Vec::with_capacity(text.len());
    let mut rest = text.as_bytes();
    while let Some((&first, after)) = rest.split_first() {
        rest = after;
        if first != b'%' {
            bytes.push(first);
            continue;
        }
        let code = rest.get(..2).and_then(|code| std::str::from_utf8(code).ok());
        let byte = code.and_then(|code| u8::from_str_radix(code, 16).ok());
        bytes.push(byte.ok_or("a % is not followed by two hexadecimal digits")?);
        rest = &rest[2..];
    }
    String::from_utf8(bytes).map_err(|_| "it is not UTF-8".into())
}

/// What a `data:` URI holds; `None` if it is another kind of URI.
pub(super) fn data_uri(uri: &str) -> Option<Result<Vec<u8>, String>> {
    let (head, body) = uri.strip_prefix("data:")?.split_once(',').unwrap_or(("", ""));
    Some(match head.strip_suffix(";base64") {
        Some(_) => base64(body),
        None => percent_decoded(body).map(String::into_bytes),
    })
}

/// RFC 4648, both alphabets, padding optional.
fn base64(text: &str) -> Result<Vec<u8>, String> {
    let mut bytes = Vec::with_capacity(text.len() / 4 * 3);
    let (mut bits, mut n_bits) = (0_u32, 0);
    for character in text.trim_end_matches('=').bytes() {
        let six = match character {
            b'A'..=b'Z' => character - b'A',
            b'a'..=b'z' => character - b'a' + 26,
            b'0'..=b'9' => character - b'0' + 52,
            b'+' | b'-' => 62,
            b'/' | b'_' => 63,
            _ => return Err(format!("byte {character:#04x} is not base64")),
        };
        bits = bits << 6 | u32::from(six);
        n_bits += 6;
        if n_bits >= 8 {
            n_bits -= 8;
            bytes.push((bits >> n_bits) as u8);
            bits &= (1 << n_bits) - 1;
        }
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_gives_the_examples_of_rfc_4648() {
        for (text, bytes) in
            [("", ""), ("Zg==", "f"), ("Zm8", "fo"), ("Zm9vYg==", "foob"), ("Zm9vYmFy", "foobar")]
        {
            assert_eq!(base64(text).unwrap(), bytes.as_bytes());
        }
        assert!(base64("Zg\n==").is_err());
    }

    #[test]
    fn data_uris_hold_base64_or_percent_text() {
        let data = |uri| data_uri(uri).unwrap().unwrap();
        assert_eq!(data("data:application/octet-stream;base64,AQI="), [1, 2]);
        assert_eq!(data("data:,a%20b"), b"a b");
        assert!(data_uri("buffer.bin").is_none());
        assert!(data_uri("data:,%4").unwrap().is_err());
    }

    #[test]
    fn no_name_leads_out_of_the_folder() {
        let from = Path::new("/shots/7/robot.gltf");
        let good = beside(from, "textures/./skin 1.png").unwrap();
        assert_eq!(good, Path::new("/shots/7/textures/skin 1.png"));
        for name in ["../x.bin", "a/../../x", "/etc/passwd", "C:\\x", "http://x/y", "a\\..\\b", ""]
        {
            assert!(beside(from, name).is_err(), "{name}");
        }
    }

    #[test]
    fn folders_and_devices_are_not_read() {
        assert!(read_file(Path::new("/")).is_err());
        #[cfg(unix)]
        assert!(read_file(Path::new("/dev/zero")).is_err());
    }
}
