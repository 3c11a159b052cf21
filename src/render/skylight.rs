//! What an unoccluded matt surface sends back, exactly, for the few directions local surfaces face.
//!
//! A control variate for L_without: on an open plane the light without objects then has no noise.

use std::f32::consts::FRAC_1_PI;

use glam::Vec3;

use crate::conventions::Rgb;
use crate::light::Lights;
use crate::scene::Scene;

/// More distinct normals than this are a curved surface, which gains nothing from a list.
const MOST: usize = 12;
/// Normals nearer than this (radians) are the same: irradiance changes by less than 10⁻⁵.
const SAME: f32 = 1e-5;

/// Radiance of white Lambert planes under all lights, by normal.
#[derive(Clone, Debug, Default)]
pub struct Skylight {
    planes: Vec<(Vec3, Rgb)>,
}

impl Skylight {
    /// Finds the largest flat faces of the local scene and integrates the lights over their sky.
    pub fn new(scene: &Scene, lights: &Lights) -> Self {
        let mut faces: Vec<(Vec3, f32)> = Vec::new();
        for local in &scene.local {
            for triangle in 0..local.mesh.triangles.len() {
                let [a, b, c] = local.mesh.corners(triangle);
                let cross = (b - a).cross(c - a);
                let Some(n) = cross.try_normalize() else { continue };
                match faces.iter().position(|(m, _)| (*m - n).length() < SAME) {
                    Some(k) => faces[k].1 += cross.length(),
                    None if faces.len() < 8 * MOST => faces.push((n, cross.length())),
                    None => {}
                }
            }
        }
        faces.sort_by(|a, b| b.1.total_cmp(&a.1));
        faces.truncate(MOST);
        let planes =
            faces.into_iter().map(|(n, _)| (n, lights.irradiance(n) * FRAC_1_PI)).collect();
        Self { planes }
    }

    /// E/π of an open plane with this unit normal, if it is one of those known.
    pub fn radiance(&self, normal: Vec3) -> Option<Rgb> {
        self.planes.iter().find(|(n, _)| (*n - normal).length_squared() < SAME * SAME).map(|p| p.1)
    }
}
