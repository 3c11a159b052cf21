//! shot.toml → plan → run, for one shot or a folder of shots.
//!
//! folder → folder. Everything that can be wrong is found in the plan, before any work.

pub mod calibrate;
pub mod camera_keys;
pub mod detect;
pub mod existing;
pub mod exposures;
pub mod file;
pub mod frames;
pub mod keys;
pub mod locate;
pub mod near_field;
pub mod pictures;
pub mod place;
pub mod plan;
pub mod probe_keys;
pub mod watch;
pub mod write;

pub use file::{ShotFile, ShotFileError};
