//! What is to be rendered, checked before any work, and the integrators that can do it.

use super::albedo::AlbedoMap;
use super::coupled::Coupled;
use super::primary::Primary;
use super::sampler::Numbers;
use super::technique::Technique;
use super::two_pass::TwoPass;
use super::waves::Waves;
use super::world::{Groundwork, World};
use super::{Context, Integrator, Stop};
use crate::camera::Camera;
use crate::conventions::Rgb;
use crate::light::Lights;
use crate::photo::Image;
use crate::scene::{AlbedoSource, Scene};

/// How the difference is estimated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Method {
    /// One path in two worlds: the default.
    #[default]
    Coupled,
    /// Two pictures, subtracted; `same_numbers` draws both from the same random numbers.
    TwoPass { same_numbers: bool },
}

/// Everything an integrator needs.
#[derive(Clone, Copy, Debug)]
pub struct Job<'a> {
    pub scene: &'a Scene,
    pub lights: &'a Lights,
    pub camera: &'a Camera,
    /// Scene-linear, the camera's size.
    pub plate: &'a Image<Rgb>,
    pub stop: Stop,
    pub numbers: Numbers,
    /// Smallest relative change that the plate's file can show: half a code at white for integer
    /// files, 0 for floats. Tiles that provably change less get no samples.
    pub least_step: f32,
    /// Filter the finished picture where that provably lowers its error.
    pub denoise: bool,
    /// [`Technique::default`] unless methods are compared.
    pub technique: Technique,
}

/// Why a job cannot be rendered.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum RenderError {
    #[error(
        "the plate is {plate_width} x {plate_height} px but the camera {camera_width} x \
         {camera_height}; give the camera of this plate"
    )]
    Size { plate_width: usize, plate_height: usize, camera_width: usize, camera_height: usize },
    #[error("the plate has no pixels")]
    NoPixels,
    #[error("plate pixel ({x}, {y}) is {value}, not finite; repair it first")]
    PlateNotFinite { x: usize, y: usize, value: Rgb },
    #[error("render.{key} is {value}; it must be a number above 0")]
    Stop { key: &'static str, value: f64 },
    #[error(
        "albedo {albedo} of local mesh \"{mesh}\" is outside 0…1; a surface cannot reflect more \
         than it gets"
    )]
    Albedo { mesh: String, albedo: Rgb },
    #[error("{kind} mesh \"{mesh}\" names material {material} of {materials}")]
    Material { kind: &'static str, mesh: String, material: usize, materials: usize },
}

impl<'a> Job<'a> {
    /// Checks everything that can be wrong before a ray is traced.
    pub fn validate(&self) -> Result<(), RenderError> {
        let (width, height) = (self.plate.width(), self.plate.height());
        if width == 0 || height == 0 {
            return Err(RenderError::NoPixels);
        }
        if (width, height) != (self.camera.width, self.camera.height) {
            return Err(RenderError::Size {
                plate_width: width,
                plate_height: height,
                camera_width: self.camera.width,
                camera_height: self.camera.height,
            });
        }
        if let Some(k) = self.plate.pixels().iter().position(|p| !p.is_finite()) {
            let value = self.plate.pixels()[k];
            return Err(RenderError::PlateNotFinite { x: k % width, y: k / width, value });
        }
        let (key, value) = match self.stop {
            Stop::Error(e) => ("error", e),
            Stop::TimeSeconds(s) => ("time", s),
            Stop::Samples(n) => ("samples", f64::from(n)),
        };
        if !(value > 0.0 && value.is_finite()) {
            return Err(RenderError::Stop { key, value });
        }
        self.validate_scene()
    }

    fn validate_scene(&self) -> Result<(), RenderError> {
        let materials = self.scene.materials.len();
        let objects = self.scene.objects.iter().map(|mesh| ("object", mesh));
        let local = self.scene.local.iter().map(|l| ("local", &l.mesh));
        for (kind, mesh) in objects.chain(local) {
            if mesh.material >= materials {
                let (mesh, material) = (mesh.name.clone(), mesh.material);
                return Err(RenderError::Material { kind, mesh, material, materials });
            }
        }
        for local in &self.scene.local {
            if let AlbedoSource::Constant(albedo) = local.albedo
                && !(albedo.cmpge(Rgb::ZERO) & albedo.cmple(Rgb::ONE)).all()
            {
                return Err(RenderError::Albedo { mesh: local.mesh.name.clone(), albedo });
            }
        }
        Ok(())
    }
}

/// What a job has to know before its first sample, to be shared by jobs of the same scene, lights,
/// camera and plate.
pub fn groundwork(job: &Job, context: &Context) -> Result<Groundwork, RenderError> {
    job.validate()?;
    let mut world = World::new(job.scene, job.lights, job.camera, job.plate);
    let primary = Primary::new(job.camera, world.eye);
    AlbedoMap::solve(&mut world, &primary, context);
    let World { albedo, skylight, cells, .. } = world;
    Ok(Groundwork { albedo, skylight, cells })
}

/// The integrator of a method for a job, ready for its first wave.
///
/// Builds the acceleration structures and integrates the lights over the local surfaces' skies; the
/// albedo is solved in the first wave.
pub fn integrator<'a>(
    method: Method,
    job: Job<'a>,
) -> Result<Box<dyn Integrator + Send + 'a>, RenderError> {
    integrator_on(None, method, job)
}

/// As [`integrator`], with what is known of the job already.
pub fn integrator_on<'a>(
    groundwork: Option<&Groundwork>,
    method: Method,
    job: Job<'a>,
) -> Result<Box<dyn Integrator + Send + 'a>, RenderError> {
    job.validate()?;
    let Job { scene, lights, camera, plate, .. } = job;
    let world = match groundwork {
        Some(known) => World::on(known.clone(), scene, lights, camera, plate),
        None => World::new(scene, lights, camera, plate),
    };
    let world = world.with_technique(job.technique);
    let primary = Primary::new(job.camera, world.eye);
    Ok(match method {
        Method::Coupled => Box::new(Waves::new(Coupled { world, primary }, &job)),
        Method::TwoPass { same_numbers } => {
            let estimator = TwoPass { world, primary, same_numbers };
            Box::new(Waves::new(estimator, &job))
        }
    })
}
