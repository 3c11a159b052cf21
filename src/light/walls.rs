//! Near walls with the panorama's light on them, for irradiance at any place in the room.

use std::f32::consts::{PI, TAU};

use glam::{DVec3, Vec3};

use super::environment::Environment;
use super::parts::{Part, parts};
use super::proxy::Proxy;
use crate::conventions::Rgb;

/// Walls are cut into parts as large as a cell of this grid over the probe's sphere.
const COLUMNS: usize = 512;
const ROWS: usize = 256;
/// Rays for irradiance where parts of the walls may hide each other are this many squared.
const RAYS_PER_SIDE: u32 = 48;

/// A proxy and what shines from it.
#[derive(Clone, Debug)]
pub(super) struct Walls {
    pub proxy: Proxy,
    /// What the probe sees on them; of a convex proxy only.
    parts: Vec<Part>,
}

impl Walls {
    pub fn new(proxy: Proxy, environment: &Environment) -> Self {
        let parts = if proxy.is_convex() { parts(environment, COLUMNS, ROWS) } else { Vec::new() };
        Self { proxy, parts }
    }

    /// Irradiance of an unoccluded plane with unit `normal` by the walls.
    pub fn irradiance(&self, environment: &Environment, place: Vec3, normal: Vec3) -> Rgb {
        if self.proxy.is_convex() {
            self.by_parts(place, normal)
        } else {
            self.by_rays(environment, place, normal)
        }
    }

    /// Each part as a point: dω at the place = dω at the probe / density.
    fn by_parts(&self, place: Vec3, normal: Vec3) -> Rgb {
        let mut sum = DVec3::ZERO;
        for part in &self.parts {
            if let Some(turned) = self.proxy.toward(place, part.direction) {
                let cosine = normal.dot(turned.direction).max(0.0);
                sum += (part.flux * (cosine / turned.density)).as_dvec3();
            }
        }
        sum.as_vec3()
    }

    /// Stratified directions, in proportion to the cosine.
    fn by_rays(&self, environment: &Environment, place: Vec3, normal: Vec3) -> Rgb {
        let (tangent, bitangent) = normal.any_orthonormal_pair();
        let n = RAYS_PER_SIDE as f32;
        let mut sum = Rgb::ZERO;
        for k in 0..RAYS_PER_SIDE * RAYS_PER_SIDE {
            let (u, v) = ((k % RAYS_PER_SIDE) as f32 + 0.5, (k / RAYS_PER_SIDE) as f32 + 0.5);
            let (s, c) = (TAU * u / n).sin_cos();
            let (radius, height) = ((v / n).sqrt(), (1.0 - v / n).sqrt());
            let direction = (tangent * c + bitangent * s) * radius + normal * height;
            sum += environment.evaluate(self.proxy.seen(place, direction.normalize()).direction).0;
        }
        sum * (PI / (n * n))
    }
}
