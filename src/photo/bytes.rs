//! Files that strangers made: only ordinary ones are opened, and only so much of them is read.

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

/// Why a file's bytes are not read; the sentence does not name the file.
#[derive(Debug, thiserror::Error)]
pub enum BytesError {
    #[error(transparent)]
    Read(#[from] io::Error),
    /// It has so many bytes, or at least so many where it grows while it is read.
    #[error("it is larger than {} KiB, too large for what it should be", limit >> 10)]
    TooLarge { bytes: u64, limit: u64 },
}

impl From<BytesError> for io::Error {
    fn from(error: BytesError) -> Self {
        match error {
            BytesError::Read(error) => error,
            large @ BytesError::TooLarge { .. } => Self::other(large),
        }
    }
}

/// All bytes of an ordinary file of at most `limit` bytes.
///
/// Devices and pipes are refused before they are opened: a pipe without a writer would never open, a
/// device never end.
pub fn read(path: &Path, limit: u64) -> Result<Vec<u8>, BytesError> {
    let metadata = std::fs::metadata(path)?;
    if !metadata.is_file() {
        return Err(io::Error::other("it is no regular file").into());
    }
    let stated = metadata.len();
    if stated > limit {
        return Err(BytesError::TooLarge { bytes: stated, limit });
    }
    let mut bytes = Vec::with_capacity(stated as usize);
    // One more than may be: what a growing file delivers beyond its stated length is not trusted.
    File::open(path)?.take(limit + 1).read_to_end(&mut bytes)?;
    let bytes_read = bytes.len() as u64;
    if bytes_read > limit {
        return Err(BytesError::TooLarge { bytes: bytes_read, limit });
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_read_up_to_the_limit_and_nothing_else_is_opened() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        std::fs::write(&path, [7; 16]).unwrap();
        assert_eq!(read(&path, 16).unwrap(), [7; 16]);
        assert!(matches!(read(&path, 15), Err(BytesError::TooLarge { bytes: 16, limit: 15 })));
        for other in [folder.path().to_owned(), folder.path().join("no")] {
            assert!(matches!(read(&other, 16), Err(BytesError::Read(_))));
        }
        #[cfg(unix)]
        assert!(read(Path::new("/dev/zero"), 16).unwrap_err().to_string().contains("regular"));
    }
}
