//! All far light as a few directions, as real-time renderers take it: without noise, and banded.
//!
//! Two ways to the same list: equal patches of the lat-long map, each a light at its middle, and median
//! cut (Debevec 2005), each part of equal power a light at the middle of its light. Both are biased:
//! what lies between two directions is never looked at. For comparison ([`render`](crate::render)'s
//! techniques), not for pictures.

use std::f64::consts::PI;

use glam::{DVec3, Vec3};

use super::cells::Cells;
use super::{Disc, Lights};
use crate::conventions::{Rgb, lat_long_solid_angle};

/// Light from one direction.
#[derive(Clone, Copy, Debug)]
pub struct Directional {
    /// Unit, world axes.
    pub direction: Vec3,
    /// Irradiance of a surface that faces it.
    pub irradiance: Rgb,
}

/// Lights that stand for all that is far away.
#[derive(Clone, Debug)]
pub struct LightSet {
    pub lights: Vec<Directional>,
}

impl LightSet {
    /// About `n` patches of equal width and height in angle, twice as many around as up; each sun is
    /// one more.
    pub fn patches(lights: &Lights, n: usize) -> Self {
        let (width, height) = lights.environment.size();
        // An even number: a row across a level horizon would be half lost.
        let rows = (2 * ((n as f64 / 8.0).sqrt().round() as usize)).clamp(1, height);
        let columns = (n / rows).clamp(1, width);
        let mut fluxes = vec![DVec3::ZERO; rows * columns];
        for (k, radiance) in lights.environment.radiance().into_iter().enumerate() {
            let (x, y) = (k % width, k / width);
            let patch = y * rows / height * columns + x * columns / width;
            fluxes[patch] += radiance.as_dvec3() * lat_long_solid_angle(y, width, height);
        }
        let world_from_map = lights.environment.world_from_map();
        let patches = fluxes.into_iter().enumerate().map(|(k, flux)| {
            let (sin, cos) = (middle(k / columns, rows, height) * PI).sin_cos();
            let longitude = (0.5 - middle(k % columns, columns, width)) * 2.0 * PI;
            let direction = DVec3::new(sin * longitude.sin(), cos, sin * longitude.cos());
            Directional {
                direction: (world_from_map * direction.as_vec3()).normalize(),
                irradiance: flux.as_vec3(),
            }
        });
        Self::lit(patches.chain(lights.suns.iter().map(sun)))
    }

    /// `n` parts of about equal power; each sun is one more.
    pub fn median_cut(lights: &Lights, n: usize) -> Self {
        let cells = Cells::new(lights, n);
        let part = |cell| Directional { direction: cells.centroid(cell), irradiance: cell.flux };
        Self::lit(cells.iter().map(part))
    }

    fn lit(lights: impl Iterator<Item = Directional>) -> Self {
        Self { lights: lights.filter(|light| light.irradiance != Rgb::ZERO).collect() }
    }
}

/// Middle of the texels that part `k` of `parts` has of `size`, as a share of all.
fn middle(k: usize, parts: usize, size: usize) -> f64 {
    let edge = |k: usize| (k * size).div_ceil(parts) as f64;
    0.5 * (edge(k) + edge(k + 1)) / size as f64
}

fn sun(disc: &Disc) -> Directional {
    Directional { direction: disc.direction, irradiance: disc.radiance * disc.solid_angle() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::Environment;
    use crate::photo::Image;

    /// A sky that brightens toward a spot.
    fn lights() -> Lights {
        let picture = Image::from_fn(96, 48, |i, j| {
            let spot = ((i as f32 - 30.0) / 8.0).powi(2) + ((j as f32 - 12.0) / 5.0).powi(2);
            Rgb::new(0.4, 0.6, 1.0) + Rgb::splat(20.0 * (-spot).exp())
        });
        let turn = glam::DQuat::from_rotation_y(0.4);
        Lights::from_parts(Environment::new(&picture, turn, true).unwrap(), Vec::new())
    }

    #[test]
    fn sets_hold_all_the_light_and_give_nearly_its_irradiance() {
        let lights = lights();
        let exact = lights.irradiance(Vec3::Y);
        for (name, set, tolerance) in [
            ("64 patches", LightSet::patches(&lights, 64), 0.05),
            ("1024 patches", LightSet::patches(&lights, 1024), 0.005),
            ("64 by median cut", LightSet::median_cut(&lights, 64), 0.02),
            ("1024 by median cut", LightSet::median_cut(&lights, 1024), 0.002),
        ] {
            let flux: Rgb = set.lights.iter().map(|l| l.irradiance).sum();
            let whole = lights.environment.flux().as_vec3();
            assert!((flux - whole).length() < 1e-4 * whole.length(), "{name}: {flux} {whole}");
            let irradiance: Rgb =
                set.lights.iter().map(|l| l.irradiance * l.direction.y.max(0.0)).sum();
            let off = (irradiance - exact).length() / exact.length();
            println!("{name}: {} lights, irradiance off by {off:.5}", set.lights.len());
            assert!(off < tolerance, "{name}: {off}");
        }
    }
}
