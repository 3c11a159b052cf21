//! Platelight puts CG objects into photographs and says how right the result is.
//!
//! The rooms below are listed in the order of the data; a room uses only rooms above it.
//!
//! - [`conventions`]: axes, pixel centre, lat-long formula, units
//! - [`photo`]: files ↔ scene-linear pictures
//! - [`bracket`]: exposure brackets → radiance with variance and validity
//! - [`camera`]: pixel ↔ ray, pose, uncertainty
//! - [`probe`]: mirror ball, fisheye, panorama → lat-long panorama
//! - [`scene`]: meshes, materials, objects, local surface
//! - [`trace`]: ray → hit
//! - [`light`]: panorama → lights that can be sampled
//! - [`render`]: scene + lights + camera → the difference the objects make
//! - [`composite`]: difference onto plate
//! - [`report`]: what a person looks at
//! - [`shot`]: shot.toml → plan → run
//! - [`cli`]: one file a command

pub mod bracket;
pub mod camera;
pub mod cli;
pub mod composite;
pub mod conventions;
pub mod light;
pub mod photo;
pub mod probe;
pub mod render;
pub mod report;
pub mod scene;
pub mod shot;
pub mod trace;
