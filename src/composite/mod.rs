//! Difference onto plate: modes, layers, the plate's own bytes where nothing changed.
//!
//! [`Photo`](crate::photo::Photo) + [`Difference`](crate::render::Difference) → `Composite`. This room never renders.

/// Layers that can be written beside the main picture, as `[output] layers` names them.
pub const LAYERS: [&str; 10] = [
    "difference",
    "object",
    "shadow",
    "albedo",
    "stderr",
    "samples",
    "influence",
    "clip",
    "Z",
    "N",
];
