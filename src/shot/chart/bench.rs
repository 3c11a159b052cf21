//! Renderings of one shot by many methods, each timed and held against the same reference.

use std::time::Instant;

use super::methods::Row;
use crate::camera::Camera;
use crate::conventions::Rgb;
use crate::photo::Image;
use crate::render::compare::Region;
use crate::render::world::Groundwork;
use crate::render::{
    Blocked, Context, Difference, Job, Numbers, Progress, RenderError, Stop, Technique, groundwork,
    integrator_on,
};
use crate::report::chart::Point;
use crate::shot::plan::Plan;
use crate::shot::prepare::Prepared;
use crate::shot::watch::{Watch, thread_seconds};

/// The shot at a size that can be rendered often.
pub struct Bench<'a> {
    small: Small<'a>,
    /// The same for every method.
    groundwork: Groundwork,
}

/// The shot with a plate of fewer pixels.
struct Small<'a> {
    plan: &'a Plan,
    prepared: &'a Prepared,
    /// Pixels of the plate that became one, across and down.
    reduced: usize,
    plate: Image<Rgb>,
    camera: Camera,
}

/// Where a rendering ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Aim {
    /// With the first samples that stay, right after the pilot: whatever the error, this is the least
    /// that a method can do.
    Least,
    Stop(Stop),
}

/// A rendering, and what it cost.
pub struct Rendering {
    pub difference: Difference,
    /// The error that the method states.
    pub stated: f64,
    pub samples: u64,
    /// On the clock, for the waves alone.
    pub seconds: f64,
    pub cpu_seconds: f64,
    /// On the clock, of the first wave: what does not grow with the samples.
    pub first_wave_seconds: f64,
    /// On the clock, to build what the waves need.
    pub setup_seconds: f64,
}

impl<'a> Bench<'a> {
    /// Every `reduced` × `reduced` pixels of the plate become one.
    pub fn new(
        plan: &'a Plan,
        prepared: &'a Prepared,
        reduced: usize,
        context: &Context,
    ) -> Result<Self, RenderError> {
        let plate = plan.plate.linear.reduced(reduced);
        let (width, height) = (plate.width(), plate.height());
        let camera = prepared.camera.cropped(0.0, 0.0, 1.0 / reduced as f64, width, height);
        let small = Small { plan, prepared, reduced, plate, camera };
        let groundwork =
            groundwork(&small.job(Stop::Samples(1), false, Technique::default()), context)?;
        Ok(Self { small, groundwork })
    }

    pub fn plate(&self) -> &Image<Rgb> {
        &self.small.plate
    }

    /// Pixels of the shot's plate that became one here, across and down.
    pub fn reduced(&self) -> usize {
        self.small.reduced
    }

    /// How blocked light is found where a technique says `blocked`.
    pub fn resolved(&self, blocked: Blocked) -> Blocked {
        blocked.resolved(&self.small.prepared.light.lights, &self.groundwork.cells)
    }

    /// Renders toward `aim`; `None` if the context was over first. `watch` hears how it goes on.
    pub fn render(
        &self,
        row: &Row,
        aim: Aim,
        context: &Context,
        watch: Option<&dyn Watch>,
    ) -> Result<Option<Rendering>, RenderError> {
        let stop = match aim {
            // The least is planned for, and only what changes the plate by less than 10 % left out
            Aim::Least => Stop::Error(1.0),
            Aim::Stop(stop) => stop,
        };
        let begin = Instant::now();
        let job = self.small.job(stop, row.denoise, row.technique);
        let mut integrator = integrator_on(Some(&self.groundwork), row.method, job)?;
        let setup_seconds = begin.elapsed().as_secs_f64();
        let (begin, worked) = (Instant::now(), thread_seconds());
        let mut samples = 0;
        let mut first_wave_seconds = None;
        let wave = loop {
            let wave = integrator.next_wave(context);
            let is_pilot = first_wave_seconds.is_none();
            first_wave_seconds.get_or_insert(begin.elapsed().as_secs_f64());
            samples += wave.samples;
            if let Some(watch) = watch {
                watch.progress(wave.done, wave.error);
            }
            let is_least = aim == Aim::Least && !is_pilot;
            if wave.finished() || context.is_over() || is_least {
                break wave;
            }
        };
        if wave.progress != Progress::Met && context.is_over() || wave.missing > 0 {
            return Ok(None);
        }
        let seconds = begin.elapsed().as_secs_f64();
        let cpu = thread_seconds().zip(worked).map(|(now, before)| now - before);
        // Where nobody counts the processor's time, all threads are taken to have worked.
        let cpu_seconds = cpu.unwrap_or(seconds * rayon::current_num_threads() as f64);
        Ok(Some(Rendering {
            difference: integrator.snapshot().whole(),
            stated: wave.error,
            samples,
            seconds,
            cpu_seconds: cpu_seconds.max(1e-4),
            first_wave_seconds: first_wave_seconds.unwrap_or(seconds),
            setup_seconds,
        }))
    }
}

impl Small<'_> {
    /// Caustics are everybody's as the shot asks for them.
    fn job(&self, stop: Stop, denoise: bool, technique: Technique) -> Job<'_> {
        Job {
            scene: &self.prepared.scene,
            lights: &self.prepared.light.lights,
            camera: &self.camera,
            plate: &self.plate,
            stop,
            numbers: Numbers::default(),
            least_step: self.plan.plate.least_step(),
            denoise,
            technique: Technique { caustics: self.plan.shot.render.caustics, ..technique },
        }
    }
}

impl Rendering {
    /// What the rendering is on a chart.
    pub fn point(&self, region: &Region) -> Point {
        let found = region.compare(&self.difference);
        let above_zero = |error: f64| (error > 0.0).then_some(error);
        Point {
            cpu_seconds: self.cpu_seconds,
            seconds: self.seconds,
            samples: self.samples,
            stated: self.stated,
            error: above_zero(found.error),
            on_objects: above_zero(found.on_objects),
            beside: above_zero(found.beside),
            bias: found.bias,
            bias_sigma: found.bias_sigma,
        }
    }
}
