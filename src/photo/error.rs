//! What can go wrong between a file and a picture.

use std::io;
use std::path::{Path, PathBuf};

/// Why a picture could not be read or written. Every message names the file and a remedy.
#[derive(Debug, thiserror::Error)]
pub enum PhotoError {
    #[error("{}: cannot be read: {source}; check its name, and that it may be read", path.display())]
    Read { path: PathBuf, source: io::Error },
    #[error("{}: cannot be written: {source}; name another place, or make room there", path.display())]
    Write { path: PathBuf, source: io::Error },
    #[error("{}: {found}; Platelight reads EXR, Radiance HDR, PNG, TIFF and JPEG{hint}", path.display())]
    NotAPicture { path: PathBuf, found: String, hint: &'static str },
    #[error(
        "{}: {what} needs {} MiB, more than the limit of {} MiB; crop it or scale it down",
        path.display(), bytes >> 20, limit >> 20
    )]
    TooLarge { path: PathBuf, what: String, bytes: u64, limit: u64 },
    #[error("{}: damaged {format} file: {cause}; export or copy it again", path.display())]
    Damaged { path: PathBuf, format: &'static str, cause: String },
    #[error("{}: {found} is not supported; {remedy}", path.display())]
    Unsupported { path: PathBuf, found: String, remedy: String },
    #[error("{}: {found}; name its colour space (colour = \"…\", one of {})", path.display(), super::colour::known_names())]
    UnknownColour { path: PathBuf, found: String },
    #[error(
        "colour space {name:?} is not known; use \"auto\" or one of {}",
        super::colour::known_names()
    )]
    ColourName { name: String },
    /// An EXR file without the layer (or main picture) that was asked for; `wanted` says which.
    #[error("{}: has {wanted}; name one of its layers (channels: {channels})", path.display())]
    NoLayer { path: PathBuf, wanted: String, channels: String },
    #[error("{}: {cause}", path.display())]
    Picture { path: PathBuf, cause: String },
}

impl PhotoError {
    pub(super) fn damaged(path: &Path, format: &'static str, cause: impl ToString) -> Self {
        Self::Damaged { path: path.into(), format, cause: cause.to_string() }
    }

    pub(super) fn unsupported(path: &Path, found: impl Into<String>, remedy: &str) -> Self {
        Self::Unsupported { path: path.into(), found: found.into(), remedy: remedy.into() }
    }
}

/// Runs a decoder; a panic inside it becomes a [`PhotoError::Damaged`].
///
/// The decoders are other people's code fed with other people's bytes. They hold no state of ours,
/// so nothing half-done survives a caught panic.
pub(super) fn guarded<T>(
    path: &Path,
    format: &'static str,
    decode: impl FnOnce() -> Result<T, PhotoError>,
) -> Result<T, PhotoError> {
    std::panic::catch_unwind(std::panic::AssertUnwindSafe(decode))
        .unwrap_or_else(|_| Err(PhotoError::damaged(path, format, "the decoder gave up on it")))
}

/// What a pixel takes beside its own samples: linear light and whether it is clipped.
const DECODED_BYTES: u64 = (size_of::<crate::conventions::Rgb>() + size_of::<bool>()) as u64;

/// Refuses a picture that would need more memory than the limit, its linear light included, or whose
/// sides are too long.
pub(super) fn check_size(
    path: &Path,
    (width, height): (u64, u64),
    bytes_per_pixel: u64,
    limit: u64,
) -> Result<(), PhotoError> {
    let bytes = width.saturating_mul(height).saturating_mul(bytes_per_pixel + DECODED_BYTES);
    let what = || format!("a picture of {width} × {height} px");
    if width == 0 || height == 0 {
        return Err(PhotoError::Picture { path: path.into(), cause: "has no pixels".into() });
    }
    if width > MAX_SIDE || height > MAX_SIDE {
        return Err(PhotoError::unsupported(path, what(), "sides may have up to 65536 px"));
    }
    if bytes > limit {
        return Err(PhotoError::TooLarge { path: path.into(), what: what(), bytes, limit });
    }
    Ok(())
}

/// Longest side of a picture, px.
pub(super) const MAX_SIDE: u64 = 65_536;
