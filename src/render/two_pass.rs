//! The plain way: path-trace the picture with the objects, then without, and subtract.
//!
//! A textbook path tracer (light sampling and BSDF sampling by MIS, roulette) in which local surfaces
//! are painted with their solved albedo. It shares geometry, BSDF and lights with the coupled
//! estimator but none of its integrals, so their agreement is evidence. With the same numbers in both
//! worlds the paths agree until they meet an object; with independent ones the difference is that of
//! two noisy pictures.

use super::Context;
use super::albedo::AlbedoMap;
use super::coupled::{MAX_DEPTH, purpose_of};
use super::film::{Pair, Sample};
use super::primary::Primary;
use super::sampler::{Purpose, Sampler, to_f32};
use super::surface::{Colouring, LocalPoint, Surface};
use super::technique::WIDE_PDF;
use super::waves::Estimator;
use super::world::{Step, World};
use crate::conventions::Rgb;
use crate::trace::{Hit, Ray};

/// The two-pass estimator for camera samples.
pub struct TwoPass<'a> {
    pub world: World<'a>,
    pub primary: Primary,
    /// Use the same random numbers in both worlds.
    pub same_numbers: bool,
}

impl Estimator for TwoPass<'_> {
    fn world(&self) -> &World<'_> {
        &self.world
    }

    fn primary(&self) -> &Primary {
        &self.primary
    }

    fn solve_albedo(&mut self, context: &Context) {
        AlbedoMap::solve(&mut self.world, &self.primary, context);
    }

    fn sample(&self, x: usize, y: usize, sampler: Sampler) -> Sample {
        let jitter = sampler.pair(Purpose::Pixel);
        let Some(ray) = self.primary.ray(x, y, to_f32(jitter.x), to_f32(jitter.y)) else {
            return Sample::default();
        };
        let step = self.world.camera_step(&ray, &sampler);
        if let Some(hit) = step.object {
            let point = self.world.object_point(&ray, &hit, false);
            let sent = point.emitted + self.radiance(point.surface, true, sampler.descend(0));
            return Sample { coverage: 1.0, object: sent, ..Sample::default() };
        }
        let Some(hit) = step.local else { return Sample::default() };
        let point = self.world.local_point(&ray, &hit);
        let other = if self.same_numbers { 0 } else { 1 };
        let with = self.radiance(point.surface, true, sampler.descend(0));
        let without = self.radiance(point.surface, false, sampler.descend(other));
        let mean = self.world.albedo.mean(point.mesh);
        Sample::background(point.colour, mean, Pair { delta: with - without, without })
    }
}

impl TwoPass<'_> {
    /// Radiance that a surface reflects toward where the ray came from, in one of the worlds.
    fn radiance(&self, surface: Surface, with: bool, sampler: Sampler) -> Rgb {
        let world = &self.world;
        let (mut surface, mut sampler) = (surface, sampler);
        let mut radiance = Rgb::ZERO;
        let mut throughput = Rgb::ONE;
        let (mut after_wide, mut on_object) = (false, true);
        for depth in 0..MAX_DEPTH + 4 {
            for stratum in 0..world.lights.n_strata() {
                radiance += throughput * self.lit(&surface, stratum, with, &sampler);
            }
            let u = sampler.pair(Purpose::Direction).as_vec2();
            let choice = sampler.one(Purpose::Choice);
            let Some(drawn) = surface.bsdf.sample(surface.wo, u, choice) else { break };
            let direction = surface.to_world(drawn.direction);
            if (drawn.direction.z > 0.0) != (surface.geometric.dot(direction) > 0.0) {
                break;
            }
            throughput *= drawn.weight;
            after_wide = drawn.pdf < WIDE_PDF || after_wide && on_object;
            if depth > 3 {
                let survival = throughput.max_element().clamp(0.05, 0.95);
                if sampler.one(Purpose::Roulette) >= survival {
                    break;
                }
                throughput /= survival;
            }
            sampler = sampler.descend(1);
            let ray = surface.leave(direction);
            let (object, local) = self.first(&ray, with, &sampler);
            let from = surface.position;
            let end = Step { object, local }.first_distance();
            for lamp in world.lights.lamps_on(from, direction).filter(|l| l.distance < end) {
                radiance += throughput * lamp.radiance * drawn.weight_against(lamp.pdf);
            }
            if let Some(hit) = object {
                let point = world.object_point(&ray, &hit, after_wide);
                if let Some(per_metre) = point.inside {
                    throughput *= per_metre.powf(hit.t);
                }
                radiance += throughput * point.emitted;
                (surface, on_object) = (point.surface, true);
            } else if let Some(hit) = local {
                let point = world.local_point(&ray, &hit);
                throughput *= self.paint(&point, &sampler);
                (surface, on_object) = (point.surface, false);
            } else {
                let (l, pdf) = world.lights.evaluate(from, direction);
                radiance += throughput * l * drawn.weight_against(pdf);
                break;
            }
        }
        radiance
    }

    fn first(&self, ray: &Ray, with: bool, sampler: &Sampler) -> (Option<Hit>, Option<Hit>) {
        if with {
            let step = self.world.step(ray, sampler);
            (step.object, step.local)
        } else {
            (None, self.world.closest_local(ray, sampler))
        }
    }

    fn lit(&self, surface: &Surface, stratum: usize, with: bool, sampler: &Sampler) -> Rgb {
        let world = &self.world;
        let u = sampler.pair(purpose_of(stratum));
        let Some(light) = world.lights.sample(stratum, surface.position, u) else {
            return Rgb::ZERO;
        };
        let (value, pdf) = surface.evaluate(light.direction);
        if value == Rgb::ZERO {
            return Rgb::ZERO;
        }
        let ray = surface.leave_for(&light);
        let blocked =
            world.local_occluded(&ray, sampler) || (with && world.object_occluded(&ray, sampler));
        if blocked { Rgb::ZERO } else { value * light.radiance / (light.pdf + pdf) }
    }

    /// What makes the white BSDF of a local point its own.
    fn paint(&self, point: &LocalPoint, sampler: &Sampler) -> Rgb {
        match point.colour {
            Colouring::Own => Rgb::ONE,
            Colouring::Matt(albedo) => albedo,
            Colouring::Plate => match self.world.pixel_of(&point.surface, sampler) {
                Some(pixel) => {
                    let plate = self.world.plate_at(pixel);
                    self.world.albedo.albedo(plate, pixel, point.mesh)
                }
                None => self.world.albedo.mean(point.mesh),
            },
        }
    }
}
