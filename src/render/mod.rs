//! The difference the objects make, path-traced in two worlds at once.
//!
//! [`Scene`](crate::scene::Scene) + `Lights` + [`Camera`](crate::camera::Camera) + plate →
//! [`Difference`], through an [`Integrator`] in waves. This room never writes a picture.

pub mod albedo;
pub mod blocked;
pub mod bsdf;
pub mod coat;
pub mod compare;
pub mod cones;
pub mod coupled;
pub mod denoise;
pub mod energy;
pub mod film;
mod fit;
pub mod fresnel;
pub mod ggx;
pub mod glow;
pub mod guides;
pub mod influence;
pub mod job;
pub mod primary;
pub mod refine;
pub mod sampler;
pub mod sheen;
pub mod skylight;
pub mod sources;
pub mod surface;
pub mod technique;
pub mod tile;
pub mod two_pass;
pub mod waves;
pub mod world;

#[cfg(test)]
mod agreement_tests;
#[cfg(test)]
mod bsdf_tests;
#[cfg(test)]
mod closed_form_tests;
#[cfg(test)]
mod exactness_tests;
#[cfg(test)]
mod influence_tests;
#[cfg(test)]
mod near_tests;
#[cfg(test)]
mod stability_tests;
#[cfg(test)]
mod technique_tests;
#[cfg(test)]
mod test_scenes;

pub use job::{Job, Method, RenderError, groundwork, integrator, integrator_on};
pub use sampler::Numbers;
pub use technique::{Blocked, Caustics, Technique};

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use crate::conventions::Rgb;
use crate::photo::{Image, Window};

/// What every long computation is given: seed and cancellation. Threads are rayon's current pool.
#[derive(Clone, Debug, Default)]
pub struct Context {
    /// Same input and seed: same bytes, whatever the number of threads.
    pub seed: u64,
    cancelled: Arc<AtomicBool>,
    deadline: Option<Instant>,
}

impl Context {
    pub fn new(seed: u64) -> Self {
        Self { seed, ..Self::default() }
    }

    /// The same cancellation with another seed.
    pub fn with_seed(&self, seed: u64) -> Self {
        Self { seed, ..self.clone() }
    }

    /// The same, over at `deadline` at the latest; `None` sets no other end.
    pub fn until(&self, deadline: Option<Instant>) -> Self {
        let deadline = deadline.into_iter().chain(self.deadline).min();
        Self { deadline, ..self.clone() }
    }

    /// What cancels this context when it is set, for those who cannot call: signal handlers.
    pub fn flag(&self) -> Arc<AtomicBool> {
        Arc::clone(&self.cancelled)
    }

    /// Asks every computation that shares this context to stop soon.
    pub fn cancel(&self) {
        self.cancelled.store(true, Ordering::Relaxed);
    }

    pub fn is_cancelled(&self) -> bool {
        self.cancelled.load(Ordering::Relaxed)
    }

    /// Cancelled, or past its deadline. Cheap enough to be asked every few samples.
    pub fn is_over(&self) -> bool {
        self.is_cancelled() || self.deadline.is_some_and(|deadline| Instant::now() > deadline)
    }
}

/// What the objects change, per pixel of the plate, in the plate's own linear scale.
///
/// Every camera sample either meets an object first (*object sample*) or not (*background sample*).
/// With N samples in a pixel and plate value P the finished pixel is
/// `object + (1 − coverage) · P + difference` (additive) or
/// `object + (1 − coverage) · P + ratio · P` (ratio mode, diffuse local surfaces).
/// All four are exactly zero where no sample met anything of the objects.
///
/// The pictures hold a window of the plate, around all pixels with samples; [`whole`](Self::whole) spreads
/// them over the plate.
#[derive(Clone, Debug)]
pub struct Difference {
    /// Width and height of the plate.
    pub size: (usize, usize),
    /// The part of the plate that the pictures below hold; nothing is changed elsewhere.
    pub window: Window,
    /// Share of the samples that met an object first: alpha, 0…1.
    pub coverage: Image<f32>,
    /// Radiance of the object samples, summed over them and divided by N (premultiplied).
    pub object: Image<Rgb>,
    /// (with − without) of the background samples, summed and divided by N. Signed.
    pub difference: Image<Rgb>,
    /// ΔE/E₀ of the background samples on diffuse local surfaces, summed and divided by N. Signed.
    pub ratio: Image<Rgb>,
    /// Standard error of `object + difference`, per channel, from independent replicates.
    pub stderr: Image<Rgb>,
    /// Diffuse albedo of the local surface as solved from the plate, 0 where none is seen.
    pub albedo: Image<Rgb>,
    /// Plane distance along the view axis of the first thing seen *with* the objects, metres; +∞ for none. Not filtered.
    pub depth: Image<f32>,
    /// World normal of the first thing seen *with* the objects, zero for none. Not filtered.
    pub normal: Image<glam::Vec3>,
    /// Camera samples taken; 0 where the influence bound proved that nothing can be seen. In quiet
    /// tiles, those of each of the sampled pixels that the others lie between.
    pub samples: Image<u32>,
}

impl Difference {
    /// The finished pixel `at` of the window, by addition, where the plate has `plate`.
    pub fn over(&self, plate: Rgb, at: (usize, usize)) -> Rgb {
        self.object[at] + plate * (1.0 - self.coverage[at]) + self.difference[at]
    }

    /// What no object at all makes of a picture of `width` × `height` pixels.
    pub fn nothing(width: usize, height: usize) -> Self {
        Self::nothing_within((width, height), Window::whole(width, height))
    }

    /// The same, held for a window.
    pub fn nothing_within(size: (usize, usize), window: Window) -> Self {
        let (width, height) = window.size;
        let black = Image::filled(width, height, Rgb::ZERO);
        Self {
            size,
            window,
            coverage: Image::filled(width, height, 0.0),
            object: black.clone(),
            difference: black.clone(),
            ratio: black.clone(),
            stderr: black.clone(),
            albedo: black.clone(),
            depth: Image::filled(width, height, f32::INFINITY),
            normal: black,
            samples: Image::filled(width, height, 0),
        }
    }

    /// The same, held for all of the plate.
    pub fn whole(&self) -> Self {
        let (width, height) = self.size;
        let mut out = Self::nothing(width, height);
        for k in 0..self.window.n_pixels() {
            let at = self.window.pixel(k);
            out.coverage[at] = self.coverage.pixels()[k];
            out.object[at] = self.object.pixels()[k];
            out.difference[at] = self.difference.pixels()[k];
            out.ratio[at] = self.ratio.pixels()[k];
            out.stderr[at] = self.stderr.pixels()[k];
            out.albedo[at] = self.albedo.pixels()[k];
            out.depth[at] = self.depth.pixels()[k];
            out.normal[at] = self.normal.pixels()[k];
            out.samples[at] = self.samples.pixels()[k];
        }
        out
    }
}

/// What one wave did.
#[derive(Clone, Debug, PartialEq)]
pub struct Wave {
    /// Camera samples taken in this wave.
    pub samples: u64,
    /// Share of the work toward the stopping rule that is done, 0…1.
    pub done: f64,
    pub progress: Progress,
    /// Error over the influence region reached so far, relative to the plate.
    pub error: f64,
    /// Pixels that this error leaves out: their light is found by chance (caustics) and is far
    /// noisier than around them. Their own standard error says so.
    pub outliers: u64,
    /// How many times smaller denoising made the error; `None` where it did not, or was not asked.
    pub denoised: Option<f64>,
    /// Pixels that the objects may change and that have no samples yet: the time was over, or the
    /// context cancelled, before their first ones were taken. The difference is 0 there.
    pub missing: u64,
}

impl Wave {
    /// True if there is nothing more to wait for.
    pub fn finished(&self) -> bool {
        self.progress != Progress::Going
    }
}

/// Where a render stands after a wave.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progress {
    Going,
    /// The stopping rule is met.
    Met,
    /// No more samples are given although the stopping rule is not met.
    Exhausted,
    Cancelled,
}

/// When to stop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Stop {
    /// Standard error relative to the plate, root mean square over the influence region.
    Error(f64),
    /// CPU-independent wall seconds.
    TimeSeconds(f64),
    /// Camera samples in every influenced pixel.
    Samples(u32),
}

/// A method that estimates the difference wave by wave.
///
/// The CLI, the progress bar and the stopping rule use nothing else.
pub trait Integrator {
    /// Takes more samples. Returns early, with what it has, when the context is cancelled.
    fn next_wave(&mut self, context: &Context) -> Wave;
    /// The difference as known after the waves so far.
    fn snapshot(&self) -> Difference;
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn the_earlier_of_two_deadlines_holds() {
        let now = Instant::now();
        let (soon, late) = (now + Duration::from_secs(60), now + Duration::from_secs(3600));
        let context = Context::new(1).until(Some(soon));
        assert_eq!(context.until(Some(late)).deadline, Some(soon));
        assert_eq!(Context::new(1).until(Some(late)).until(Some(soon)).deadline, Some(soon));
        assert_eq!(context.until(None).deadline, Some(soon));
    }
}
