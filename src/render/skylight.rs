//! What an unoccluded matt surface sends back, exactly, for the few directions local surfaces face.
//!
//! A control variate for L_without: on an open plane the light without objects then has no noise.
//! Lamps are added at the very point; where the environment lies on near walls, nothing is known.

use std::f32::consts::FRAC_1_PI;

use glam::Vec3;

use crate::conventions::Rgb;
use crate::light::{Lamp, Lights};
use crate::scene::Scene;

/// More distinct normals than this are a curved surface, which gains nothing from a list.
const MOST: usize = 12;
/// Normals nearer than this (radians) are the same: irradiance changes by less than 10⁻⁵.
const SAME: f32 = 1e-5;

/// Radiance of white Lambert planes under all lights.
#[derive(Clone, Debug, Default)]
pub struct Skylight {
    /// By normal, without lamps.
    planes: Vec<(Vec3, Rgb)>,
    lamps: Vec<Lamp>,
}

impl Skylight {
    /// Finds the largest flat faces of the local scene and integrates the lights over their sky.
    pub fn new(scene: &Scene, lights: &Lights) -> Self {
        if lights.proxy().is_some() {
            return Self::default();
        }
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
            faces.into_iter().map(|(n, _)| (n, lights.far_irradiance(n) * FRAC_1_PI)).collect();
        Self { planes, lamps: lights.lamps.clone() }
    }

    /// E/π of an open plane with this unit normal at a place, if it is one of those known.
    pub fn radiance(&self, place: Vec3, normal: Vec3) -> Option<Rgb> {
        let same = |(n, _): &&(Vec3, Rgb)| (*n - normal).length_squared() < SAME * SAME;
        let (_, far) = self.planes.iter().find(same)?;
        let by_lamps = |sum: Rgb, lamp: &Lamp| sum + lamp.irradiance(place, normal) * FRAC_1_PI;
        Some(self.lamps.iter().fold(*far, by_lamps))
    }
}
