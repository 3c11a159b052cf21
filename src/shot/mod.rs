//! shot.toml → plan → run, for one shot or a folder of shots.
//!
//! folder → folder. Everything that can be wrong is found in the plan, before any work.

pub mod batch;
mod bracket;
pub mod budget;
pub mod calibrate;
pub mod camera_keys;
pub mod chart;
pub mod check;
pub mod clipped_light;
pub mod detect;
pub mod existing;
pub mod exposures;
pub mod file;
pub mod finish;
pub mod frames;
pub mod keys;
mod lamp_light;
pub mod light;
pub mod locate;
pub mod motion;
pub mod near_field;
pub mod overlays;
pub mod pictures;
pub mod place;
mod placing;
pub mod plan;
pub mod prepare;
pub mod probe_keys;
pub mod register;
pub mod run;
pub mod sheet;
mod shown;
pub mod sky;
pub mod stop;
mod support_light;
mod unseen;
pub mod watch;
pub mod write;

pub use file::{ShotFile, ShotFileError};
