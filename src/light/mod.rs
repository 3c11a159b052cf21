//! What lights the scene: the sampled environment and the suns split off it.
//!
//! [`Panorama`] → [`Lights`], which answer the queries of any light: sample, pdf, radiance, irradiance.
//! Start with [`Lights::new`]. [`Environment`] is everything far away as piecewise constant radiance,
//! [`Disc`] a sun or lamp too small for its texels. This room never traces a path.

pub mod cells;
pub mod clipped;
pub mod environment;
pub mod near_field;
mod patch;
pub mod sun;
mod support_grid;
pub mod table;
mod take_out;

pub use cells::Cells;
pub use environment::Environment;
pub use sun::{Disc, SunSplit};
pub use take_out::take_out;

use glam::{DVec2, Vec3};

use crate::conventions::Rgb;
use crate::probe::Panorama;
use sun::Split;

/// A direction drawn toward a light.
#[derive(Clone, Copy, Debug)]
pub struct LightSample {
    /// Unit, world axes.
    pub direction: Vec3,
    /// Radiance arriving from there, of everything that shines from this direction.
    pub radiance: Rgb,
    /// Density per steradian of this direction, summed over all strata: see [`Lights::evaluate`].
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

/// Why lights cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum LightError {
    #[error("panorama: {width} x {height} texels; at least one is needed, write a panorama first")]
    Empty { width: usize, height: usize },
}

/// Everything that shines, behind the queries that a renderer asks.
///
/// Draws come in strata, one from the environment's table and one from the suns, so that a shadow's
/// umbra costs no luck. A renderer draws once from each stratum and weights by the balance heuristic
/// with the density of [`evaluate`](Lights::evaluate) plus the densities of its own techniques.
#[derive(Clone, Debug)]
pub struct Lights {
    pub environment: Environment,
    pub suns: Vec<Disc>,
    /// Texels of the panorama with a channel that was NaN, infinite or negative; it counts as 0.
    pub repaired: usize,
    /// Running sums of the suns' shares of the sun stratum; the last is 1.
    sun_sums: Vec<f32>,
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
        Self { environment, suns, repaired: 0, sun_sums }
    }

    /// The same lights and more discs, say a sun recovered from the plate.
    pub fn with_discs(mut self, discs: impl IntoIterator<Item = Disc>) -> Self {
        self.suns.extend(discs);
        Self { repaired: self.repaired, ..Self::from_parts(self.environment, self.suns) }
    }

    /// How many draws a renderer takes for one look at the lights: 0, 1 or 2.
    ///
    /// 0 is legal: a constant environment is left entirely to BSDF sampling.
    pub fn n_strata(&self) -> usize {
        usize::from(self.environment.can_be_sampled()) + usize::from(!self.suns.is_empty())
    }

    /// Draws a direction from one stratum; `u` in [0, 1)².
    ///
    /// Returns nothing for a stratum that does not exist.
    pub fn sample(&self, stratum: usize, u: DVec2) -> Option<LightSample> {
        let (direction, environment, environment_pdf) =
            if stratum == 0 && self.environment.can_be_sampled() {
                let draw = self.environment.sample(u)?;
                (draw.direction, draw.radiance, draw.pdf)
            } else if stratum + 1 == self.n_strata() {
                let direction = self.sample_suns(u)?;
                let (radiance, pdf) = self.environment.evaluate(direction);
                (direction, radiance, pdf)
            } else {
                return None;
            };
        let (suns, sun_pdf) = self.evaluate_suns(direction);
        Some(LightSample {
            direction,
            radiance: environment + suns,
            pdf: environment_pdf + sun_pdf,
        })
    }

    /// Radiance arriving from `direction` (unit, pointing away from the place), and the expected number
    /// of draws per steradian there when every stratum draws once.
    pub fn evaluate(&self, direction: Vec3) -> (Rgb, f32) {
        let (radiance, pdf) = self.environment.evaluate(direction);
        let (sun_radiance, sun_pdf) = self.evaluate_suns(direction);
        (radiance + sun_radiance, pdf + sun_pdf)
    }

    /// Irradiance ∫ L max(0, n·ω) dω of an unoccluded plane with unit `normal`.
    ///
    /// Exact for the piecewise constant environment but for the horizon, which is resolved to
    /// 1e-6 of the total. Takes a pass over all texels: for preparation, not for inner loops.
    pub fn irradiance(&self, normal: Vec3) -> Rgb {
        let suns: Rgb = self.suns.iter().map(|s| s.irradiance(normal)).sum();
        self.environment.irradiance(normal.as_dvec3()).as_vec3() + suns
    }

    /// True if nothing shines.
    pub fn is_dark(&self) -> bool {
        self.suns.is_empty() && self.environment.is_dark()
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
