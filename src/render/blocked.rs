//! Far light that objects keep from a matt point, by draws over the lights' cells.
//!
//! Cells that lie in no cone toward the objects, or below the horizon, are passed over (methods-render
//! R12.3). Over the rest goes one systematic sample: equal steps through their power × cosine, so that
//! a sun gets as many draws as it is worth and neighbouring draws are strata of one picture. Where the
//! step falls inside a cell is one of the two numbers that choose the direction in it.

use std::f32::consts::PI;

use glam::DVec2;

use super::cones::Cones;
use super::sampler::{Purpose, Sampler};
use super::surface::Surface;
use super::technique::Blocked;
use super::world::World;
use crate::conventions::Rgb;
use crate::light::{Cells, LightSet, Lights};

/// Cells of the environment.
pub const CELLS: usize = 256;
/// Where suns and lamps smaller than this, radians, hold more than this share of the light, whole
/// draws of the lights find them as well, and cells cost more than they gain (R14; measured on the
/// truth scenes: the same noise for 1.6 times the work under a sun, 2.4 times less variance at equal
/// work under clouds).
const SMALL_CELL: f32 = 0.03;
const MOST_IN_SMALL: f32 = 0.25;
/// Beside them, each sun is one.
const MOST_CELLS: usize = CELLS + 64;
/// Draws where all of a point's light may be blocked.
const MOST_DRAWS: f32 = 8.0;
/// Golden ratio: steps of a Kronecker sequence.
const GOLDEN: f64 = 0.618_033_988_749_894_9;

impl Blocked {
    /// What this comes to under `lights`, which `cells` are cut from: never [`Auto`](Self::Auto).
    ///
    /// Cells and lists of lights are directions that hold everywhere: with near walls blocked light is
    /// found by draws, whatever was asked for.
    pub fn resolved(self, lights: &Lights, cells: &Cells) -> Self {
        let fit = cells.len() <= MOST_CELLS;
        let pay = fit && cells.share_of_small(SMALL_CELL) < MOST_IN_SMALL;
        match self {
            _ if lights.proxy().is_some() => Self::Draws,
            Self::Auto if pay => Self::Cells,
            Self::Cells if fit => Self::Cells,
            Self::Auto | Self::Cells => Self::Draws,
            Self::Draws | Self::Patches(_) | Self::MedianCut(_) => self,
        }
    }
}

impl World<'_> {
    /// ∫ f cosθ L dω over the directions in which an object is met and nothing local.
    ///
    /// Made for BSDFs whose value goes with the cosine; right for any without mirror directions.
    pub fn blocked_light(&self, surface: &Surface, cones: &Cones, sampler: &Sampler) -> Rgb {
        if let Some(set) = &self.light_set {
            return self.blocked_by_set(set, surface, cones, sampler);
        }
        let normal = surface.geometric;
        // Which cells may be blocked, and the running sum of what they can give
        let mut cells = [(0_u32, 0.0_f32); MOST_CELLS];
        let (mut n, mut total) = (0, 0.0);
        self.cells.visit(
            |direction, sin, cos| {
                normal.dot(direction) > -sin && cones.may_meet_cap(direction, sin, cos)
            },
            |k, cell| {
                let cosine = normal.dot(cell.direction).max(0.25 * cell.radius.min(1.0));
                if cell.power > 0.0 {
                    total += cell.power * cosine;
                    cells[n] = (k as u32, total);
                    n += 1;
                }
            },
        );
        if n == 0 {
            return Rgb::ZERO;
        }
        let whole =
            self.skylight.radiance(surface.position, normal).map_or(0.0, |l| PI * l.max_element());
        let share = if whole > 0.0 { total / whole } else { 1.0 };
        let draws = (MOST_DRAWS * share).ceil().clamp(1.0, MOST_DRAWS);

        let u = sampler.pair(Purpose::Cells);
        let (mut i, mut below) = (0, 0.0);
        let mut blocked = Rgb::ZERO;
        for k in 0..draws as u32 {
            let at = (k as f32 + u.x as f32) / draws * total;
            while i + 1 < n && cells[i].1 <= at {
                below = cells[i].1;
                i += 1;
            }
            let (cell, end) = cells[i];
            let width = end - below;
            let inside = f64::from((at - below) / width).clamp(0.0, 1.0 - f64::EPSILON);
            let across = (u.y + f64::from(k) * GOLDEN).fract();
            let (direction, arriving) = self.cells.draw(cell as usize, DVec2::new(across, inside));
            if !cones.may_meet(direction) {
                continue;
            }
            let (value, _) = surface.evaluate(direction);
            let ray = surface.leave(direction);
            if value == Rgb::ZERO || !self.object_occluded(&ray, sampler) {
                continue;
            }
            if self.flat || !self.local_occluded(&ray, sampler) {
                blocked += value * arriving * (total / (draws * width));
            }
        }
        blocked
    }

    /// The same as if all light came from a few directions. Biased; without noise of its own.
    fn blocked_by_set(
        &self,
        set: &LightSet,
        surface: &Surface,
        cones: &Cones,
        sampler: &Sampler,
    ) -> Rgb {
        let mut blocked = Rgb::ZERO;
        for light in &set.lights {
            if surface.geometric.dot(light.direction) <= 0.0 || !cones.may_meet(light.direction) {
                continue;
            }
            let (value, _) = surface.evaluate(light.direction);
            let ray = surface.leave(light.direction);
            if value != Rgb::ZERO
                && self.object_occluded(&ray, sampler)
                && (self.flat || !self.local_occluded(&ray, sampler))
            {
                blocked += value * light.irradiance;
            }
        }
        blocked
    }
}
