//! Light probes → lat-long panorama.
//!
//! [`Radiance`](crate::bracket::Radiance) + [`Camera`](crate::camera::Camera) → [`Panorama`]: mirror
//! ball, fisheye, angular map and lat-long. Start with [`Panorama`]. This room never lights anything.

use glam::{DQuat, DVec3};

use crate::bracket::Validity;
use crate::conventions::Rgb;
use crate::photo::Image;

/// Light arriving at a place from every direction, as a lat-long picture (`conventions`).
#[derive(Clone, Debug)]
pub struct Panorama {
    /// Radiance in the plate's own scale, 2N × N texels.
    pub radiance: Image<Rgb>,
    /// Variance of `radiance` per channel.
    pub variance: Image<Rgb>,
    pub validity: Image<Validity>,
    /// Share of each texel that the probe really saw, 0…1.
    pub coverage: Image<f32>,
    /// Takes a direction of the picture's axes to the world.
    pub world_from_panorama: DQuat,
    /// Where in the world the light was measured, metres.
    pub place: DVec3,
}
