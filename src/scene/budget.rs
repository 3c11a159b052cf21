//! [`Budget`]: how much memory what a file holds may take, so that a small file cannot fill it.

use std::cell::{Cell, RefCell};
use std::collections::HashSet;
use std::path::{Path, PathBuf};

use super::SceneError;

/// What any file may take, bytes.
const FREE: u64 = 2 << 30;

/// What each byte read may take beyond that, bytes: a JPEG's texels are some 20 of RGBA for each of
/// its own, a vertex with its place in tree and scene about 10.
const PER_BYTE: u64 = 32;

/// Bytes that a model may still take in memory, counted while it is read.
///
/// Sparse accessors make elements of nothing, pictures and buffers may be named a thousand times.
pub(super) struct Budget {
    path: PathBuf,
    left: Cell<u64>,
    /// Files whose bytes were already granted: naming one again grants nothing.
    granted: RefCell<HashSet<String>>,
}

impl Budget {
    /// For a file of `n_bytes`.
    pub fn new(path: &Path, n_bytes: usize) -> Self {
        let left = FREE.saturating_add(PER_BYTE.saturating_mul(n_bytes as u64));
        Self { path: path.into(), left: Cell::new(left), granted: RefCell::default() }
    }

    /// More, for the `n_bytes` read of another file, the first time it is named.
    pub fn grant(&self, uri: &str, n_bytes: usize) {
        // What stands in a data URI was granted with the file that holds it.
        if !uri.starts_with("data:") && self.granted.borrow_mut().insert(uri.into()) {
            let more = PER_BYTE.saturating_mul(n_bytes as u64);
            self.left.set(self.left.get().saturating_add(more));
        }
    }

    /// Takes `n` times `size` bytes for what is at `place`.
    ///
    /// # Errors
    /// [`SceneError::TooLarge`] where so much is not left.
    pub fn take(&self, n: usize, size: usize, place: &str) -> Result<(), SceneError> {
        let wanted = (n as u64).saturating_mul(size as u64);
        match self.left.get().checked_sub(wanted) {
            Some(left) => {
                self.left.set(left);
                Ok(())
            }
            None => Err(SceneError::TooLarge {
                path: self.path.clone(),
                place: place.into(),
                found: format!("{} MiB more", wanted.div_ceil(1 << 20)),
                limit: format!("{} MiB left for a file of its size", self.left.get() >> 20),
                remedy: "use fewer or smaller meshes and textures",
            }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_taken_is_bounded_by_what_was_read() {
        let budget = Budget::new(Path::new("a.gltf"), 1000);
        budget.take(1 << 30, 2, "meshes[0]").unwrap();
        budget.take(1000, 32, "meshes[1]").unwrap();
        let error = budget.take(1, 1, "meshes[2]").unwrap_err().to_string();
        assert!(error.contains("a.gltf") && error.contains("meshes[2]"), "{error}");
        for _ in 0..2 {
            budget.grant("a.bin", 10);
            budget.grant("data:,abc", 3);
        }
        assert!(budget.take(321, 1, "meshes[3]").is_err());
        budget.take(320, 1, "meshes[3]").unwrap();
        assert!(budget.take(usize::MAX, usize::MAX, "meshes[4]").is_err());
    }
}
