//! Waves: which pixels get how many samples, and when it is enough.
//!
//! A pilot of two samples a pixel comes first and gives the first picture; its samples are thrown away
//! (a pixel that stops on its own luck is biased, methods-render R7.1). Then whole replicates are
//! given to tiles of 16 × 16 pixels by the tile's pooled error, N ∝ σ, until the error over the
//! influence region is what was asked. Which thread does what cannot change a bit: every sample is a
//! function of its pixel, replicate and index, every tile has one owner, sums over tiles go in order.

use std::time::Instant;

use glam::Vec3;
use rayon::prelude::*;

use super::albedo::AlbedoMap;
use super::coupled::Pair;
pub use super::film::Sample;
use super::film::{Estimate, Noise, Pixel};
use super::primary::Primary;
use super::sampler::{Numbers, Sampler};
use super::surface::Colouring;
use super::world::World;
use super::{Context, Difference, Integrator, Stop, Wave};
use crate::conventions::{Rgb, luminance};
use crate::photo::Image;

/// Side of a tile, pixels.
pub const TILE: usize = 16;
/// Independent replicates that a finished picture aims at.
const REPLICATES: u32 = 8;
const LARGEST_REPLICATE: u32 = 64;
const MOST_SAMPLES: f64 = 65_536.0;
/// A pixel belongs to the influence region if the objects change it by more than this.
const INFLUENCE: f64 = 0.01;
/// Share of a tile's pixels that its pooled error leaves out: a caustic found by chance has no
/// variance that more samples of its own kind would bring down, and must not take all the work.
/// The standard error delivered for those pixels stays what it is.
const HEAVY_TAIL: f64 = 0.02;
/// Replicates and samples per replicate that any pixel gets: two are needed for a standard error.
const LEAST_REPLICATES: u32 = 2;
const LEAST_SAMPLES: u32 = 2;
/// Brightness below which errors are not magnified, relative to the plate's mean.
const FLOOR: f32 = 0.02;

/// Something that takes one camera sample.
pub trait Estimator: Sync {
    fn world(&self) -> &World<'_>;
    fn primary(&self) -> &Primary;
    /// Solves what has to be known before the first sample.
    fn prepare(&mut self, context: &Context);
    fn sample(&self, x: usize, y: usize, sampler: Sampler) -> Sample;
}

impl Sample {
    /// A sample that met a local surface first; `mean` is the surface's mean albedo.
    pub fn background(colour: Colouring, mean: Rgb, pair: Pair) -> Self {
        // One scale for all surfaces of a pixel, so that its quotient weighs them by their light.
        let (scale, own, plate) = match colour {
            Colouring::Plate => (mean, Rgb::ZERO, 1.0),
            Colouring::Matt(albedo) => (albedo, albedo * pair.delta, 0.0),
            Colouring::Own => (Rgb::ONE, pair.delta, 0.0),
        };
        let scale = scale.max(Rgb::splat(1e-3));
        Self {
            local: 1.0,
            plate,
            delta: pair.delta * scale,
            without: pair.without * scale,
            own,
            ..Self::default()
        }
    }
}

struct Tile {
    x: usize,
    y: usize,
    width: usize,
    height: usize,
    /// Samples per replicate.
    n: u32,
    replicates: u32,
    /// Replicates to add in the next wave.
    planned: u32,
    pixels: Vec<Pixel>,
    noise: TileNoise,
}

/// Pooled error of a tile, the worst [`HEAVY_TAIL`] of its pixels left out.
#[derive(Clone, Copy, Default)]
struct TileNoise {
    /// Mean over the pixels of the relative variance of a single sample.
    sample_variance: f64,
    /// Mean over the pixels of the relative variance reached.
    variance: f64,
    /// Pixels in the influence region.
    influenced: f64,
}

/// What the camera meets first at pixel centres; never filtered.
struct Guides {
    depth: Image<f32>,
    normal: Image<Vec3>,
    local: Image<Option<usize>>,
}

/// Drives an [`Estimator`] wave by wave.
pub struct Waves<E> {
    estimator: E,
    stop: Stop,
    numbers: Numbers,
    tiles: Vec<Tile>,
    guides: Option<Guides>,
    waves: u32,
    started: Option<Instant>,
    /// Seconds and samples of the waves so far, to predict the next.
    seconds: f64,
    samples: u64,
    error: f64,
    floor: f32,
    dark: f32,
}

impl<E: Estimator> Waves<E> {
    pub fn new(estimator: E, stop: Stop, numbers: Numbers) -> Self {
        let plate = estimator.world().plate;
        let (width, height) = (plate.width(), plate.height());
        let mut tiles = Vec::new();
        for y in (0..height).step_by(TILE) {
            for x in (0..width).step_by(TILE) {
                tiles.push(Tile {
                    x,
                    y,
                    width: TILE.min(width - x),
                    height: TILE.min(height - y),
                    n: 1,
                    replicates: 0,
                    planned: 0,
                    pixels: Vec::new(),
                    noise: TileNoise::default(),
                });
            }
        }
        let sum: f64 = plate.pixels().iter().map(|&p| f64::from(luminance(p).max(0.0))).sum();
        let mean = (sum / plate.pixels().len().max(1) as f64) as f32;
        Self {
            estimator,
            stop,
            numbers,
            tiles,
            guides: None,
            waves: 0,
            started: None,
            seconds: 0.0,
            samples: 0,
            error: f64::INFINITY,
            floor: (FLOOR * mean).max(1e-6),
            dark: 1e-4 * mean.max(1e-6),
        }
    }

    /// True if no pixel can differ: nothing inserted, or no light at all.
    fn provably_zero(&self) -> bool {
        let world = self.estimator.world();
        world.objects.is_empty()
    }

    /// Whether anything of the objects or the local scene can be met through a tile.
    fn can_matter(world: &World, primary: &Primary, tile: &Tile) -> bool {
        if !world.local.is_empty() {
            return true;
        }
        primary.cone(tile.x, tile.y, tile.width, tile.height).is_none_or(|(axis, angle)| {
            world.parts.iter().any(|part| {
                let to = part.centre - world.eye;
                let distance = to.length();
                distance <= part.radius
                    || axis.angle_between(to) <= angle + (part.radius / distance).asin() + 1e-3
            })
        })
    }

    fn pilot(&mut self) {
        let (world, primary) = (self.estimator.world(), self.estimator.primary());
        for tile in &mut self.tiles {
            tile.n = 1;
            tile.planned =
                if Self::can_matter(world, primary, tile) { LEAST_REPLICATES } else { 0 };
        }
    }

    /// Throws the pilot away and shares out the first replicates by what it saw.
    fn first_plan(&mut self) {
        let wanted = self.wanted_samples();
        for (tile, wanted) in self.tiles.iter_mut().zip(wanted) {
            let seen = tile.replicates > 0;
            let per_replicate = (wanted / f64::from(REPLICATES)).max(1.0) as u32;
            let n = 1 << per_replicate.ilog2();
            tile.n = match self.stop {
                Stop::Samples(_) => n.min(LARGEST_REPLICATE),
                _ => n.clamp(LEAST_SAMPLES, LARGEST_REPLICATE),
            };
            tile.replicates = 0;
            tile.pixels = Vec::new();
            tile.planned = match self.stop {
                _ if !seen => 0,
                Stop::Samples(_) => LEAST_REPLICATES,
                // The pilot's scatter is that of independent numbers: half of what it asks for.
                _ => ((0.5 * wanted / f64::from(tile.n)).ceil() as u32)
                    .clamp(LEAST_REPLICATES, REPLICATES),
            };
        }
    }

    fn next_plan(&mut self) {
        let wanted = self.wanted_samples();
        for (tile, wanted) in self.tiles.iter_mut().zip(wanted) {
            let replicates = (wanted / f64::from(tile.n)).ceil() as u32;
            // At most four times what there is: early estimates of the error are rough.
            tile.planned = if tile.replicates == 0 {
                0
            } else {
                replicates.saturating_sub(tile.replicates).min(3 * tile.replicates)
            };
        }
    }

    /// Samples per pixel that each tile should have in the end.
    fn wanted_samples(&self) -> Vec<f64> {
        let target = match self.stop {
            Stop::Samples(n) => return vec![f64::from(n.max(1)); self.tiles.len()],
            Stop::Error(error) => error.max(1e-6),
            // As much better each time as the doubling of samples gives.
            Stop::TimeSeconds(_) if self.error.is_finite() => self.error * 0.65,
            Stop::TimeSeconds(_) => 0.03,
        };
        let sigma = |t: &Tile| t.noise.sample_variance.sqrt();
        let influenced: f64 = self.tiles.iter().map(|t| t.noise.influenced).sum();
        let sum: f64 = self.tiles.iter().map(|t| t.noise.influenced * sigma(t)).sum();
        if influenced <= 0.0 {
            return vec![f64::from(REPLICATES * LEAST_SAMPLES); self.tiles.len()];
        }
        let scale = sum / (target * target * influenced);
        self.tiles.iter().map(|t| (sigma(t) * scale).min(MOST_SAMPLES)).collect()
    }

    /// Renders what is planned; returns the samples taken.
    fn render(&mut self, context: &Context) -> u64 {
        let deadline = match self.stop {
            Stop::TimeSeconds(limit) if self.waves > 0 => Some(limit),
            _ => None,
        };
        let (estimator, numbers, started) = (&self.estimator, self.numbers, self.started);
        let (floor, dark) = (self.floor, self.dark);
        let late = || {
            let elapsed = started.map_or(0.0, |s| s.elapsed().as_secs_f64());
            deadline.is_some_and(|limit| elapsed > limit)
        };
        // The pilot and the picture use different numbers.
        let offset = if self.waves == 0 { 1 << 30 } else { 0 };
        self.tiles
            .par_iter_mut()
            .with_max_len(4)
            .map(|tile| {
                if tile.planned == 0 || context.is_cancelled() || late() {
                    return 0;
                }
                tile.render(estimator, context.seed, offset, numbers);
                tile.measure(estimator.world().plate, floor, dark);
                u64::from(tile.n * tile.planned) * (tile.width * tile.height) as u64
            })
            .sum()
    }

    /// Error over the influence region, root mean square.
    fn measured_error(&self) -> f64 {
        let region = self.tiles.iter().filter(|t| t.noise.influenced > 0.0);
        let (variance, pixels) = region.fold((0.0, 0.0), |(v, n), t| {
            (v + t.noise.variance * t.noise.influenced, n + t.noise.influenced)
        });
        if pixels > 0.0 { (variance / pixels).sqrt() } else { 0.0 }
    }

    /// Share of the work done, and whether it is all.
    fn progress(&self) -> (f64, bool) {
        match self.stop {
            Stop::Samples(n) => {
                let least = self
                    .tiles
                    .iter()
                    .filter(|t| t.replicates > 0)
                    .map(|t| t.n * t.replicates)
                    .min()
                    .unwrap_or(u32::MAX);
                let done = f64::from(least) / f64::from(n.max(1));
                (done.min(1.0), done >= 1.0)
            }
            Stop::Error(target) => {
                // Good to 3 %: the error of the error is no better.
                let done = (target / self.error.max(1e-12)).powi(2).min(1.0);
                (done, self.error <= 1.03 * target)
            }
            Stop::TimeSeconds(limit) => {
                let elapsed = self.started.map_or(0.0, |s| s.elapsed().as_secs_f64());
                ((elapsed / limit.max(1e-9)).min(1.0), elapsed >= 0.97 * limit)
            }
        }
    }

    fn finished(&self, samples: u64) -> Wave {
        Wave { samples, done: 1.0, finished: true, error: 0.0 }
    }
}

impl Tile {
    fn render<E: Estimator>(&mut self, estimator: &E, seed: u64, offset: u32, numbers: Numbers) {
        if self.pixels.is_empty() {
            self.pixels = vec![Pixel::default(); self.width * self.height];
        }
        for (k, pixel) in self.pixels.iter_mut().enumerate() {
            let (x, y) = (self.x + k % self.width, self.y + k / self.width);
            for replicate in self.replicates..self.replicates + self.planned {
                let mut sum = Sample::default();
                for index in 0..self.n {
                    let sampler = Sampler::new(seed, (x, y), offset + replicate, index, numbers);
                    sum += estimator.sample(x, y, sampler);
                }
                pixel.add(sum * (1.0 / self.n as f32));
            }
        }
        self.replicates += self.planned;
    }

    fn estimate(&self, k: usize, plate: &Image<Rgb>, dark: f32) -> (Rgb, Estimate) {
        let (x, y) = (self.x + k % self.width, self.y + k / self.width);
        let plate = plate[(x, y)];
        (plate, self.pixels[k].estimate(self.replicates, plate, dark))
    }

    fn measure(&mut self, plate: &Image<Rgb>, floor: f32, dark: f32) {
        let pixels = self.pixels.len() as f64;
        let noises: Vec<Noise> = (0..self.pixels.len())
            .map(|k| {
                let (plate, estimate) = self.estimate(k, plate, dark);
                estimate.noise(plate, floor)
            })
            .collect();
        let mut variances: Vec<f64> = noises.iter().map(|n| n.relative_variance).collect();
        variances.sort_unstable_by(f64::total_cmp);
        variances.truncate(variances.len() - (HEAVY_TAIL * pixels) as usize);
        let variance = variances.iter().sum::<f64>() / variances.len() as f64;

        // A change counts if it stands out of the tile's noise; a pixel's own estimate of its noise,
        // from two replicates, is often small by luck.
        let sigma = variance.sqrt();
        let seen = |n: &Noise| n.coverage > 0.0 || n.change > INFLUENCE + 2.0 * sigma;
        let mut influenced = noises.iter().filter(|n| seen(n)).count() as f64;
        // Few samples hide a change in noise: then the tile's mean decides for all its pixels.
        let excess: f64 = noises.iter().map(|n| (n.change - sigma).clamp(0.0, 1.0)).sum();
        if noises.iter().any(|n| n.coverage == 0.0) && excess > INFLUENCE * pixels {
            influenced = pixels;
        }
        let samples = f64::from(self.n * self.replicates);
        self.noise = TileNoise { sample_variance: variance * samples, variance, influenced };
    }
}

impl<E: Estimator> Integrator for Waves<E> {
    fn next_wave(&mut self, context: &Context) -> Wave {
        let begin = Instant::now();
        if self.provably_zero() || context.is_cancelled() {
            return self.finished(0);
        }
        match self.waves {
            0 => {
                self.started = Some(begin);
                self.estimator.prepare(context);
                self.guides = Some(Guides::new(self.estimator.world(), self.estimator.primary()));
                self.pilot();
            }
            1 => self.first_plan(),
            _ => self.next_plan(),
        }
        if self.waves > 0
            && let Stop::TimeSeconds(limit) = self.stop
        {
            self.fit_into(limit);
        }
        let samples = self.render(context);
        self.waves += 1;
        self.samples += samples;
        self.seconds += begin.elapsed().as_secs_f64();
        self.error = self.measured_error();
        let (done, finished) = self.progress();
        let idle = samples == 0 || context.is_cancelled();
        let finished = idle || (finished && self.waves > 1);
        let done = if finished { 1.0 } else { done.min(0.999) };
        Wave { samples, done, finished, error: self.error }
    }

    fn snapshot(&self) -> Difference {
        let world = self.estimator.world();
        let (width, height) = (world.plate.width(), world.plate.height());
        let mut out = Difference {
            coverage: Image::filled(width, height, 0.0),
            object: Image::filled(width, height, Rgb::ZERO),
            difference: Image::filled(width, height, Rgb::ZERO),
            ratio: Image::filled(width, height, Rgb::ZERO),
            stderr: Image::filled(width, height, Rgb::ZERO),
            albedo: Image::filled(width, height, Rgb::ZERO),
            depth: Image::filled(width, height, f32::INFINITY),
            normal: Image::filled(width, height, Vec3::ZERO),
            samples: Image::filled(width, height, 0),
        };
        for tile in &self.tiles {
            for k in 0..tile.pixels.len() {
                let at = (tile.x + k % tile.width, tile.y + k / tile.width);
                let (_, estimate) = tile.estimate(k, world.plate, self.dark);
                out.coverage[at] = estimate.coverage;
                out.object[at] = estimate.object;
                out.difference[at] = estimate.difference;
                out.ratio[at] = estimate.ratio;
                out.stderr[at] = estimate.variance.map(f32::sqrt);
                out.samples[at] = tile.n * tile.replicates;
            }
        }
        if let Some(guides) = &self.guides {
            out.depth = guides.depth.clone();
            out.normal = guides.normal.clone();
            out.albedo = world.albedo.layer(world, &guides.local);
        }
        out
    }
}

impl<E: Estimator> Waves<E> {
    /// Cuts the plan to what the time left allows.
    fn fit_into(&mut self, limit: f64) {
        let elapsed = self.started.map_or(0.0, |s| s.elapsed().as_secs_f64());
        let planned: f64 = self
            .tiles
            .iter()
            .map(|t| f64::from(t.n * t.planned) * (t.width * t.height) as f64)
            .sum();
        let per_sample = self.seconds / (self.samples.max(1)) as f64;
        let affordable = (limit - elapsed).max(0.0) / per_sample.max(1e-12);
        if planned <= affordable {
            return;
        }
        let share = affordable / planned;
        for tile in &mut self.tiles {
            let least = if tile.replicates == 0 { LEAST_REPLICATES } else { 0 };
            let cut = (f64::from(tile.planned) * share) as u32;
            tile.planned = cut.max(least.min(tile.planned));
        }
    }
}

impl Guides {
    fn new(world: &World, primary: &Primary) -> Self {
        let (width, height) = (world.plate.width(), world.plate.height());
        let axis = (world.camera.pose.world_from_camera.matrix3 * -glam::DVec3::Z).as_vec3();
        let found: Vec<(f32, Vec3, Option<usize>)> = (0..width * height)
            .into_par_iter()
            .map(|k| {
                let (x, y) = (k % width, k / width);
                let nothing = (f32::INFINITY, Vec3::ZERO, None);
                let Some(ray) = primary.ray(x, y, 0.5, 0.5) else { return nothing };
                let sampler = Sampler::new(0, (x, y), 0, 0, Numbers::SobolOwen);
                let step = world.camera_step(&ray, &sampler);
                let mesh = step.local.map(|hit| hit.mesh as usize);
                let along = ray.direction.dot(axis);
                match (step.object, step.local) {
                    (Some(hit), _) => {
                        let point = world.object_point(&ray, &hit);
                        (hit.t * along, point.surface.normal(), mesh)
                    }
                    (None, Some(hit)) => {
                        let point = world.local_point(&ray, &hit);
                        (hit.t * along, point.surface.normal(), mesh)
                    }
                    (None, None) => nothing,
                }
            })
            .collect();
        Self {
            depth: Image::from_fn(width, height, |x, y| found[y * width + x].0),
            normal: Image::from_fn(width, height, |x, y| found[y * width + x].1),
            local: Image::from_fn(width, height, |x, y| found[y * width + x].2),
        }
    }
}

/// Solves the albedo map of a world.
pub fn solve_albedo(world: &mut World, primary: &Primary, context: &Context) {
    AlbedoMap::solve(world, primary, context);
}
