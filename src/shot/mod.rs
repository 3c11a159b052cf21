//! shot.toml → plan → run, for one shot or a folder of shots.
//!
//! folder → folder. Everything that can be wrong is found in the plan, before any work.
