//! What lights the scene: the sampled environment, suns split off it, near walls and lamps.
//!
//! [`Panorama`] → [`Lights`], which answer the queries of any light: sample, pdf, radiance, irradiance.
//! Start with [`Lights::new`]. [`Environment`] is everything far away as piecewise constant radiance,
//! [`Disc`] a sun or lamp too small for its texels. [`Proxy`] says on which walls near by the
//! environment really lies, [`Lamp`] is a lamp at its true place. [`Sky`] calculates what no probe saw: a
//! clear sky, its sun where [`sun_position`] puts it. This room never traces a path.

pub mod cells;
mod clear_sky;
pub mod clipped;
pub mod discrete;
pub mod environment;
pub mod lamp;
pub mod lamp_strength;
mod median;
pub mod moment;
pub mod near_field;
pub mod parts;
mod patch;
mod preetham;
pub mod proxy;
pub mod shadow_edge;
pub mod sibl;
pub mod sky;
pub mod sky_fit;
#[cfg(test)]
mod stability_tests;
pub mod sun;
pub mod sun_position;
mod support_grid;
pub mod table;
mod take_out;
#[cfg(test)]
mod test_yard;
mod walls;

pub use cells::Cells;
pub use discrete::LightSet;
pub use environment::Environment;
pub use lamp::{Lamp, LampHit};
pub use median::median_per_channel;
pub use moment::Moment;
pub use proxy::Proxy;
pub use sky::Sky;
pub use sun::{Disc, SunSplit};
pub use take_out::{NoLamp, take_out, take_out_lamp};

use glam::{DVec2, Vec3};

use crate::conventions::Rgb;
use crate::probe::Panorama;
use sun::Split;
use walls::Walls;

/// A direction drawn toward a light.
#[derive(Clone, Copy, Debug)]
pub struct LightSample {
    /// Unit, world axes.
    pub direction: Vec3,
    /// To the light, metres: what lies farther away does not block it. +∞ but for lamps.
    pub distance: f32,
    /// Radiance arriving from there: of the lamp drawn, or of everything else that shines from this
    /// direction, times the weight of draws (1 unless [`Draws::Alone`]).
    pub radiance: Rgb,
    /// Density per steradian of this direction: see [`Lights::lamps_on`] for a lamp, for all else
    /// [`Lights::evaluate`], summed over all strata, times the same weight.
    pub pdf: f32,
}

/// How a panorama becomes lights.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightOptions {
    /// Whether compact hot clusters become analytic discs.
    pub suns: SunSplit,
    /// Samples what exceeds the mean only and leaves the rest to BSDF sampling (Karlík et al. 2019).
    /// Off only for methods that sample lights alone.
    pub compensated: bool,
}

impl Default for LightOptions {
    fn default() -> Self {
        Self { suns: SunSplit::Auto, compensated: true }
    }
}

/// Which directions are drawn toward lights, and what such draws weigh beside those of a BSDF.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Draws {
    /// As the lights were made: what exceeds the mean, by the balance heuristic.
    #[default]
    AsMade,
    /// All light in proportion to its strength, by the balance heuristic.
    Whole,
    /// As [`Whole`](Self::Whole), and what a BSDF finds counts for nothing but in mirror directions.
    Alone,
    /// None: environment and suns are left to BSDFs.
    Never,
}

/// What a light's draw weighs against a BSDF's where it shall stand alone. Not infinite: in directions
/// without any draws the BSDF's keep their weight, and nothing is 0/0.
const ALONE: f32 = 1e12;

/// Why lights cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum LightError {
    #[error("panorama: {width} x {height} texels; at least one is needed, write a panorama first")]
    Empty { width: usize, height: usize },
}

/// Everything that shines, behind the queries that a renderer asks.
///
/// Draws come in strata, one from the environment's table, one from the suns and one from the lamps,
/// so that a shadow's umbra costs no luck. A renderer draws once from each stratum and weights by the
/// balance heuristic with the density of [`evaluate`](Lights::evaluate) plus the densities of its own
/// techniques. Lamps stand before all else and are weighed on their own: a ray gets what its end shows
/// and what the [`lamps_on`](Lights::lamps_on) it, before that end, add.
///
/// Places are relative to the scene's origin, metres. Without near walls and lamps they do not matter.
#[derive(Clone, Debug)]
pub struct Lights {
    pub environment: Environment,
    pub suns: Vec<Disc>,
    pub lamps: Vec<Lamp>,
    /// Where the environment really lies; `None`: infinitely far away.
    walls: Option<Walls>,
    /// Where the environment was measured.
    place: Vec3,
    /// Texels of the panorama with a channel that was NaN, infinite or negative; it counts as 0.
    pub repaired: usize,
    /// Running sums of the suns' shares of the sun stratum; the last is 1. All 0 where suns are never
    /// drawn.
    sun_sums: Vec<f32>,
    /// What a draw weighs beside those of a renderer's other techniques: 1 is the balance heuristic.
    weight: f32,
}

impl Lights {
    /// Splits suns off `panorama` as `options` say and prepares the rest for sampling.
    pub fn new(panorama: &Panorama, options: &LightOptions) -> Result<Self, LightError> {
        let Split { radiance, discs, repaired } = sun::split(panorama, options.suns);
        let environment =
            Environment::new(&radiance, panorama.world_from_panorama, options.compensated)?;
        Ok(Self { repaired, ..Self::from_parts(environment, discs) })
    }

    /// Lights from an environment and suns that are not part of it.
    pub fn from_parts(environment: Environment, suns: Vec<Disc>) -> Self {
        let suns: Vec<Disc> = suns.into_iter().filter(|s| s.flux() > 0.0).collect();
        let total: f32 = suns.iter().map(Disc::flux).sum();
        let mut sum = 0.0;
        let mut sun_sums: Vec<f32> = suns
            .iter()
            .map(|s| {
                sum += s.flux() / total;
                sum
            })
            .collect();
        if let Some(last) = sun_sums.last_mut() {
            *last = 1.0;
        }
        let (lamps, walls, place) = (Vec::new(), None, Vec3::ZERO);
        Self { environment, suns, lamps, walls, place, repaired: 0, sun_sums, weight: 1.0 }
    }

    /// The same lights, drawn otherwise. Every choice has the same mean; they differ in noise. Lamps
    /// are drawn as ever.
    pub fn with_draws(&self, draws: Draws) -> Self {
        let mut lights = self.clone();
        match draws {
            Draws::AsMade => {}
            Draws::Whole => lights.environment = lights.environment.with_whole_table(),
            Draws::Alone => {
                lights.environment = lights.environment.with_whole_table();
                lights.weight = ALONE;
            }
            Draws::Never => {
                lights.environment = lights.environment.without_table();
                lights.sun_sums.fill(0.0);
            }
        }
        lights
    }

    /// The same lights and more discs, say a sun recovered from the plate.
    pub fn with_discs(mut self, discs: impl IntoIterator<Item = Disc>) -> Self {
        self.suns.extend(discs);
        let Self { suns, sun_sums, environment, .. } =
            Self::from_parts(self.environment, self.suns);
        Self { suns, sun_sums, environment, ..self }
    }

    /// The same lights, measured at `place`, with the environment on near walls and lamps before it.
    ///
    /// Suns stay infinitely far away.
    pub fn near(mut self, place: Vec3, proxy: Option<Proxy>, lamps: Vec<Lamp>) -> Self {
        self.walls = proxy.map(|proxy| Walls::new(proxy, &self.environment));
        self.lamps = lamps;
        self.lamps.retain(|lamp| lamp.radiance.max_element() > 0.0);
        Self { place, ..self }
    }

    /// Where the environment really lies; `None`: infinitely far away.
    pub fn proxy(&self) -> Option<&Proxy> {
        self.walls.as_ref().map(|walls| &walls.proxy)
    }

    /// True if the light is not the same everywhere.
    pub fn is_near(&self) -> bool {
        self.walls.is_some() || !self.lamps.is_empty()
    }

    /// How many draws a renderer takes for one look at the lights: 0 to 3.
    ///
    /// 0 is legal: a constant environment is left entirely to BSDF sampling.
    pub fn n_strata(&self) -> usize {
        self.n_far_strata() + usize::from(!self.lamps.is_empty())
    }

    fn n_far_strata(&self) -> usize {
        usize::from(self.environment.can_be_sampled()) + usize::from(!self.suns.is_empty())
    }

    /// Draws a direction from one stratum, as seen from a place; `u` in [0, 1)².
    ///
    /// Returns nothing for a stratum that does not exist, or shows the place nothing.
    pub fn sample(&self, stratum: usize, from: Vec3, u: DVec2) -> Option<LightSample> {
        let (direction, environment, environment_pdf) =
            if stratum == 0 && self.environment.can_be_sampled() {
                let draw = self.environment.sample(u)?;
                match &self.walls {
                    None => (draw.direction, draw.radiance, draw.pdf),
                    Some(walls) => {
                        let turned = walls.proxy.toward(from, draw.direction)?;
                        (turned.direction, draw.radiance, draw.pdf * turned.density)
                    }
                }
            } else if stratum + 1 == self.n_far_strata() {
                let direction = self.sample_suns(u)?;
                let (radiance, pdf) = self.evaluate_environment(from, direction);
                (direction, radiance, pdf)
            } else {
                return if stratum == self.n_far_strata() {
                    lamp::sample(&self.lamps, from, u)
                } else {
                    None
                };
            };
        let (suns, sun_pdf) = self.evaluate_suns(direction);
        Some(LightSample {
            direction,
            distance: f32::INFINITY,
            radiance: (environment + suns) * self.weight,
            pdf: (environment_pdf + sun_pdf) * self.weight,
        })
    }

    /// Radiance arriving at a place from `direction` (unit, pointing away from the place) from behind
    /// everything and all lamps, and the expected number of draws per steradian there when every
    /// stratum but the lamps' draws once, times the weight of draws.
    pub fn evaluate(&self, from: Vec3, direction: Vec3) -> (Rgb, f32) {
        let (radiance, pdf) = self.evaluate_environment(from, direction);
        let (sun_radiance, sun_pdf) = self.evaluate_suns(direction);
        (radiance + sun_radiance, (pdf + sun_pdf) * self.weight)
    }

    fn evaluate_environment(&self, from: Vec3, direction: Vec3) -> (Rgb, f32) {
        match &self.walls {
            None => self.environment.evaluate(direction),
            Some(walls) => {
                let turned = walls.proxy.seen(from, direction);
                let (radiance, pdf) = self.environment.evaluate(turned.direction);
                (radiance, pdf * turned.density)
            }
        }
    }

    /// The lamps that a ray meets, in no order, whatever stands before them.
    pub fn lamps_on(&self, from: Vec3, direction: Vec3) -> impl Iterator<Item = LampHit> + '_ {
        lamp::on_ray(&self.lamps, from, direction)
    }

    /// Irradiance ∫ L max(0, n·ω) dω of an unoccluded plane with unit `normal` where the environment
    /// was measured.
    ///
    /// Exact for the piecewise constant environment but for the horizon, which is resolved to
    /// 1e-6 of the total. Takes a pass over all texels: for preparation, not for inner loops.
    pub fn irradiance(&self, normal: Vec3) -> Rgb {
        self.far_irradiance(normal) + self.by_lamps(self.place, normal)
    }

    /// The same without lamps.
    pub fn far_irradiance(&self, normal: Vec3) -> Rgb {
        self.environment.irradiance(normal.as_dvec3()).as_vec3() + self.by_suns(normal)
    }

    /// As [`irradiance`](Self::irradiance), at another place.
    ///
    /// With near walls a quadrature: good to 0.3 % farther from a convex room's walls than a tenth of
    /// its size, to 1 % in others.
    pub fn irradiance_at(&self, place: Vec3, normal: Vec3) -> Rgb {
        let lamps = self.by_lamps(place, normal);
        match self.walls.as_ref().filter(|walls| walls.proxy.holds(place)) {
            None => self.far_irradiance(normal) + lamps,
            Some(walls) => {
                let walls = walls.irradiance(&self.environment, place, normal);
                walls + self.by_suns(normal) + lamps
            }
        }
    }

    fn by_suns(&self, normal: Vec3) -> Rgb {
        self.suns.iter().map(|s| s.irradiance(normal)).sum()
    }

    fn by_lamps(&self, place: Vec3, normal: Vec3) -> Rgb {
        self.lamps.iter().map(|lamp| lamp.irradiance(place, normal)).sum()
    }

    /// True if nothing shines.
    pub fn is_dark(&self) -> bool {
        self.suns.is_empty() && self.lamps.is_empty() && self.environment.is_dark()
    }

    fn sample_suns(&self, u: DVec2) -> Option<Vec3> {
        let pick = u.x as f32;
        let k = self.sun_sums.iter().position(|&sum| pick < sum)?;
        let below = if k == 0 { 0.0 } else { self.sun_sums[k - 1] };
        let share = self.sun_sums[k] - below;
        // The rest of the number that chose the sun places the direction on it.
        let rest = ((u.x as f32 - below) / share).clamp(0.0, 1.0);
        Some(self.suns[k].sample(rest, u.y as f32))
    }

    fn evaluate_suns(&self, direction: Vec3) -> (Rgb, f32) {
        let mut radiance = Rgb::ZERO;
        let mut pdf = 0.0;
        let mut below = 0.0;
        for (sun, &sum) in self.suns.iter().zip(&self.sun_sums) {
            if sun.contains(direction) {
                radiance += sun.radiance;
                pdf += (sum - below) / sun.solid_angle();
            }
            below = sum;
        }
        (radiance, pdf)
    }
}
