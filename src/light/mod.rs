//! What lights the scene: the sampled environment and lights split off it.
//!
//! [`Panorama`](crate::probe::Panorama) → `Lights`, which answer the three queries of any light:
//! sample, pdf, radiance. This room never traces a path.

pub mod clipped;

use glam::Vec3;

use crate::conventions::Rgb;

/// A direction drawn toward a light.
#[derive(Clone, Copy, Debug)]
pub struct LightSample {
    /// Unit, world axes.
    pub direction: Vec3,
    /// Distance to the light, metres; infinite for the environment.
    pub distance: f32,
    /// Radiance arriving from there.
    pub radiance: Rgb,
    /// Density per steradian with which all lights together would have drawn this direction.
    pub pdf: f32,
}
