//! Pixel ↔ ray: lens models, pose, and how well both are known.
//!
//! corners or files → [`Camera`] = size + [`Lens`] + [`Pose`], with covariances.
//! This room never detects anything in a picture (that is `calib/`) and never warps one.

pub mod lens;

pub use lens::{Distortion, Lens};

use glam::DAffine3;

/// A camera: picture size, lens, place, and the covariances of both.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    pub width: usize,
    pub height: usize,
    pub lens: Lens,
    pub pose: Pose,
}

/// Where a camera stands: rigid, camera axes (−Z forward, +Y up) to world.
#[derive(Clone, Debug, PartialEq)]
pub struct Pose {
    pub world_from_camera: DAffine3,
    /// Covariance of (rotation vector in camera axes, rad; camera position in world, m), row-major.
    /// `None` when nobody measured it.
    pub covariance: Option<[[f64; 6]; 6]>,
}
