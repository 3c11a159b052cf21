//! Difference onto plate: modes, layers, the plate's own bytes where nothing changed.
//!
//! [`Photo`](crate::photo::Photo) + [`Difference`](crate::render::Difference) → `Composite`. This room never renders.
