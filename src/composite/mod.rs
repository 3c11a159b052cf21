//! Difference onto plate: modes, layers, the plate's own samples where nothing changed.
//!
//! [`Photo`](crate::photo::Photo) + [`Difference`](crate::render::Difference) → [`Composite`].
//! Start with [`compose()`]. Arithmetic is in scene-linear light (methods-render R9); the plate is
//! never resampled, and a sample that no object changes is copied, not computed.
//! This room never renders.

mod compose;
mod encode;
mod layers;

pub use compose::{Composite, CompositeError, Mode, Tally, compose};
pub use encode::{Encoded, encode};
pub use layers::{LAYERS, NO_DEPTH, exr_picture, exr_primaries};
