//! Near walls with the panorama's light on them, for irradiance at any place in the room.

use std::f32::consts::{PI, TAU};

use glam::{DVec2, DVec3, Vec3};
use rayon::prelude::*;

use super::environment::Environment;
use super::proxy::Proxy;
use crate::conventions::{Rgb, lat_long_direction, lat_long_solid_angle};

/// Walls are cut into parts as large as a cell of this grid over the probe's sphere.
const COLUMNS: usize = 512;
const ROWS: usize = 256;
/// Rays for irradiance where parts of the walls may hide each other are this many squared.
const RAYS_PER_SIDE: u32 = 48;

/// A proxy and what shines from it.
#[derive(Clone, Debug)]
pub(super) struct Walls {
    pub proxy: Proxy,
    /// Of a convex proxy only.
    parts: Vec<Part>,
}

/// A part of the walls that the probe sees in one direction.
#[derive(Clone, Copy, Debug)]
struct Part {
    /// Of its light's middle, unit, world axes.
    direction: Vec3,
    /// ∫ L dω at the probe.
    flux: Rgb,
}

impl Walls {
    pub fn new(proxy: Proxy, environment: &Environment) -> Self {
        let parts = if proxy.is_convex() { parts(environment) } else { Vec::new() };
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

/// The environment in blocks of texels, or in parts of them where it is coarse; dark ones left out.
fn parts(environment: &Environment) -> Vec<Part> {
    let (width, height) = environment.size();
    let split = [COLUMNS.div_ceil(width), ROWS.div_ceil(height)];
    let (columns, rows) = (width * split[0], height * split[1]);
    let (texels, turn) = (environment.radiance(), environment.world_from_map());
    let edges = |k: usize, n: usize, of: usize| k * of / n..(k + 1) * of / n;
    let part = |i: usize, j: usize| {
        let (mut flux, mut middle) = (DVec3::ZERO, DVec3::ZERO);
        for row in edges(j, ROWS, rows) {
            let solid_angle = lat_long_solid_angle(row, columns, rows);
            for column in edges(i, COLUMNS, columns) {
                let l = texels[row / split[1] * width + column / split[0]].as_dvec3() * solid_angle;
                let at = DVec2::new(column as f64, row as f64);
                flux += l;
                middle += lat_long_direction(at, columns, rows) * l.max_element();
            }
        }
        let direction = turn * middle.try_normalize()?.as_vec3();
        Some(Part { direction: direction.normalize(), flux: flux.as_vec3() })
    };
    let rows = (0..ROWS).into_par_iter();
    rows.flat_map_iter(|j| {
        let part = &part;
        (0..COLUMNS).filter_map(move |i| part(i, j))
    })
    .collect()
}
