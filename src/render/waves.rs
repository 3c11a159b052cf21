//! Waves: which pixels get how many samples, and when it is enough.
//!
//! Tiles in which the objects provably cannot be seen ([`Influence`]) get none. Elsewhere a pilot of
//! two samples in one pixel of four comes first and gives the first picture; it gives way to the
//! samples it plans (a pixel that stops on its own luck is biased, methods-render R7.1). Tiles of one
//! plain surface where nothing stands out of the pilot's noise are sampled in one pixel of sixteen, and
//! the others lie between; if something stands out later, they begin anew. Then whole replicates are
//! given to tiles of 16 × 16 pixels by the tile's pooled error over its influenced pixels, until the
//! error over the influence region is what was asked. Which thread does what cannot change a bit:
//! every sample is a function of its pixel, replicate and index, every tile has one owner, sums over
//! tiles go in order.

use std::time::{Duration, Instant};

use rayon::prelude::*;

use super::film::Sample;
use super::guides::{Block, Guides};
use super::influence::{Influence, Judgement};
use super::job::Job;
use super::primary::Primary;
use super::refine::{Refinement, refine};
use super::sampler::{Numbers, Sampler};
use super::tile::{Floors, Grid, Tile};
use super::world::World;
use super::{Context, Difference, Integrator, Progress, Stop, Wave};
use crate::conventions::{Rgb, luminance};
use crate::photo::Image;

/// Independent replicates that a finished picture aims at.
const REPLICATES: u32 = 8;
const LARGEST_REPLICATE: u32 = 64;
/// Samples in a pixel beyond which no error asked for is pursued.
pub const MOST_SAMPLES: u32 = 65_536;
/// Replicates and samples per replicate that any sampled pixel gets: with fewer than four the
/// standard error of a pixel is anything (methods-render R7.3).
const LEAST_REPLICATES: u32 = 4;
const LEAST_SAMPLES: u32 = 1;
const PILOT_REPLICATES: u32 = 2;
/// The pilot samples one pixel of four.
const PILOT_GRID: Grid = Grid { stride: 2, scattered: true };
/// Where nothing stands out of the pilot's noise and one plain surface is seen, one pixel of sixteen
/// is sampled, more often, and the others lie between: less noise for less work.
const QUIET_GRID: Grid = Grid { stride: 4, scattered: false };
const QUIET_SAMPLES: u32 = 4;
/// Brightness below which errors are not magnified, relative to the plate's mean.
const FLOOR: f32 = 0.02;
/// Changes below this share of the error asked for are not worth a sample (methods-render R3.2).
const UNSEEN_SHARE: f64 = 0.1;
/// The same where no error is asked for.
const UNSEEN: f64 = 1e-4;
/// Gain in error that denoising of few samples has (methods-render R8.2: worth six times as many).
pub const EXPECTED_GAIN: f64 = 2.0;
/// How far past the time asked for the pilot may go, so that every part of the picture has something.
const PILOT_GRACE_SECONDS: f64 = 1.0;

/// Something that takes one camera sample.
pub trait Estimator: Sync {
    fn world(&self) -> &World<'_>;
    fn primary(&self) -> &Primary;
    /// Solves what has to be known before the first sample.
    fn solve_albedo(&mut self, context: &Context);
    fn sample(&self, x: usize, y: usize, sampler: Sampler) -> Sample;
}

fn mean_brightness(plate: &Image<Rgb>) -> f32 {
    let sum: f64 = plate.pixels().iter().map(|&p| f64::from(luminance(p).max(0.0))).sum();
    (sum / plate.pixels().len().max(1) as f64) as f32
}

/// Brightness below which errors are not magnified.
pub(super) fn error_floor(plate: &Image<Rgb>) -> f32 {
    (FLOOR * mean_brightness(plate)).max(1e-6)
}

/// Drives an [`Estimator`] wave by wave.
pub struct Waves<E> {
    estimator: E,
    stop: Stop,
    numbers: Numbers,
    /// Smallest relative change that the plate's file can show.
    least_step: f32,
    denoise: bool,
    /// What the denoiser made of the last wave, if that is better than the samples.
    refinement: Option<Refinement>,
    tiles: Vec<Tile>,
    guides: Option<Guides>,
    waves: u32,
    started: Option<Instant>,
    /// Seconds and samples of the waves so far, to predict the next.
    seconds: f64,
    samples: u64,
    error: f64,
    floors: Floors,
    /// Pixels that should have samples and got none from the pilot; all before it.
    missing: u64,
}

impl<E: Estimator> Waves<E> {
    pub fn new(estimator: E, job: &Job) -> Self {
        let Job { stop, numbers, least_step, denoise, .. } = *job;
        let plate = estimator.world().plate;
        let blocks = Block::all(plate.width(), plate.height());
        let mean = mean_brightness(plate);
        let floors = Floors { error: error_floor(plate), dark: 1e-4 * mean.max(1e-6) };
        Self {
            missing: plate.pixels().len() as u64,
            tiles: blocks.into_iter().map(Tile::new).collect(),
            estimator,
            stop,
            numbers,
            least_step,
            denoise,
            refinement: None,
            guides: None,
            waves: 0,
            started: None,
            seconds: 0.0,
            samples: 0,
            error: f64::INFINITY,
            floors,
        }
    }

    /// Change below which nobody can tell, relative to the light without objects.
    fn unseen(&self) -> f32 {
        let by_error = match self.stop {
            Stop::Error(error) => UNSEEN_SHARE * error,
            Stop::TimeSeconds(_) | Stop::Samples(_) => UNSEEN,
        };
        (by_error as f32).max(self.least_step)
    }

    /// Solves what the samples need, finds the tiles that matter and plans the pilot for them.
    fn begin(&mut self, context: &Context) {
        self.estimator.solve_albedo(context);
        let (world, primary) = (self.estimator.world(), self.estimator.primary());
        let (influence, unseen) = (Influence::new(world), self.unseen());
        let judge = |tile: &Tile| {
            (!context.is_over()).then(|| influence.judge(world, primary, &tile.block, unseen))
        };
        let judged: Vec<Option<Judgement>> = self.tiles.par_iter().map(judge).collect();
        let mut seen = Vec::new();
        for (tile, judgement) in self.tiles.iter_mut().zip(judged) {
            // What was not looked at may be changed by any amount.
            let (bound, plain) =
                judgement.as_ref().map_or((f32::INFINITY, false), |j| (j.bound, j.plain));
            tile.plain = plain;
            tile.doubtful = bound <= unseen && influence.may_focus && bound > 0.0;
            // A focused reflection may be as thin as a line.
            tile.grid = if tile.doubtful { Grid::FULL } else { PILOT_GRID };
            let matters = bound > unseen || tile.doubtful;
            tile.planned = if matters { PILOT_REPLICATES } else { 0 };
            seen.extend(judgement.and_then(|j| j.seen).map(|seen| (tile.block, seen)));
        }
        let window =
            Block::window(self.tiles.iter().filter(|tile| tile.planned > 0).map(|t| t.block));
        if !context.is_over() {
            self.guides = Some(Guides::new(world, primary, window, &seen));
        }
    }

    /// Ends the pilot: it is marked to give way, and tiles that only a focused reflection could have
    /// reached are given up where it found none.
    fn end_pilot(&mut self) {
        let missed = self.tiles.iter().filter(|tile| tile.planned > 0 && tile.replicates == 0);
        self.missing = missed.map(|tile| tile.block.n_pixels() as u64).sum();
        let unseen = f64::from(self.unseen());
        for tile in &mut self.tiles {
            tile.pilot = true;
            if tile.doubtful && tile.noise.largest_change <= unseen {
                tile.clear();
            }
        }
    }

    /// Shares out the next replicates by what is known of the tiles' errors.
    fn plan(&mut self) {
        let wanted = self.wanted_samples();
        for (tile, wanted) in self.tiles.iter_mut().zip(wanted) {
            if tile.grid != Grid::FULL && !tile.pilot && !tile.noise.quiet {
                // Something stands out after all: begin anew in every pixel.
                tile.pilot = true;
            }
            let thin = tile.plain && tile.noise.quiet && !matches!(self.stop, Stop::Samples(_));
            if tile.replicates == 0 {
                tile.planned = 0;
            } else if tile.pilot && thin {
                tile.grid_next = QUIET_GRID;
                (tile.n_next, tile.planned) = (QUIET_SAMPLES, LEAST_REPLICATES);
            } else if tile.pilot {
                tile.grid_next = Grid::FULL;
                let per_replicate = (wanted / f64::from(REPLICATES)).max(1.0) as u32;
                let n = (1 << per_replicate.ilog2()).min(LARGEST_REPLICATE);
                (tile.n_next, tile.planned) = match self.stop {
                    Stop::Samples(samples) => (n, samples.max(2).div_ceil(n).min(LEAST_REPLICATES)),
                    // The pilot's scatter is that of independent numbers: half of what it asks for.
                    _ => {
                        let n = n.max(LEAST_SAMPLES);
                        let half = (0.5 * wanted / f64::from(n)).ceil() as u32;
                        (n, half.clamp(LEAST_REPLICATES, REPLICATES))
                    }
                };
            } else {
                let replicates = (wanted / f64::from(tile.n)).ceil() as u32;
                // At most four times what there is: early estimates of the error are rough.
                let more = replicates.saturating_sub(tile.replicates);
                tile.planned = more.min(3 * tile.replicates);
            }
        }
    }

    /// Samples per pixel that each tile should have in the end.
    ///
    /// They minimise the work for the mean variance over the influence region:
    /// N ∝ σ √(influenced share of the tile).
    fn wanted_samples(&self) -> Vec<f64> {
        let target = match self.stop {
            Stop::Samples(n) => return vec![f64::from(n.max(2)); self.tiles.len()],
            Stop::Error(error) => error.max(1e-6) * self.gain(),
            // As much better each time as the doubling of samples gives.
            Stop::TimeSeconds(_) if self.error.is_finite() => self.error * 0.65,
            Stop::TimeSeconds(_) => 0.03,
        };
        let sigma = |t: &Tile| t.noise.sample_variance.sqrt();
        let share = |t: &Tile| (t.noise.influenced / t.block.n_pixels() as f64).sqrt();
        let region = self.tiles.iter().filter(|t| t.noise.influenced > 0.0);
        let (influenced, sum) = region.fold((0.0, 0.0), |(n, sum), t| {
            (n + t.noise.influenced, sum + t.noise.influenced * sigma(t) / share(t))
        });
        if influenced <= 0.0 {
            return vec![f64::from(LEAST_REPLICATES * LEAST_SAMPLES); self.tiles.len()];
        }
        let scale = sum / (target * target * influenced);
        self.tiles
            .iter()
            .map(|t| (sigma(t) * share(t) * scale).min(f64::from(MOST_SAMPLES)))
            .collect()
    }

    /// Cuts the plan to what the time left allows; every tile keeps its least.
    fn fit_into(&mut self, limit: f64) {
        let elapsed = self.elapsed();
        let planned: f64 = self.tiles.iter().map(|t| t.work() as f64).sum();
        let per_sample = self.seconds / (self.samples.max(1)) as f64;
        let affordable = (limit - elapsed).max(0.0) / per_sample.max(1e-12);
        if planned <= affordable {
            return;
        }
        let share = affordable / planned;
        for tile in &mut self.tiles {
            let least = if tile.pilot { LEAST_REPLICATES } else { 0 };
            let cut = (f64::from(tile.planned) * share) as u32;
            tile.planned = cut.max(least.min(tile.planned));
        }
    }

    /// How many times smaller denoising makes the error: as of the last wave; expected before.
    fn gain(&self) -> f64 {
        match &self.refinement {
            Some(refinement) => (self.measured_error() / refinement.error.max(1e-12)).max(1.0),
            None if self.denoise && self.waves == 1 => EXPECTED_GAIN,
            None => 1.0,
        }
    }

    /// Denoises what there is, if that makes the error smaller; the error reached either way.
    fn refine(&mut self) -> f64 {
        let raw = self.measured_error();
        let refined = match &self.guides {
            Some(guides) if self.denoise && self.waves > 1 => {
                refine(&self.tiles, guides, self.estimator.world().plate, self.floors)
            }
            _ => None,
        };
        self.refinement = refined.filter(|refined| refined.error < raw);
        self.refinement.as_ref().map_or(raw, |refined| refined.error)
    }

    fn elapsed(&self) -> f64 {
        self.started.map_or(0.0, |started| started.elapsed().as_secs_f64())
    }

    /// Renders what is planned; returns the samples taken. Tiles for which there is no time keep
    /// what they have.
    fn render(&mut self, context: &Context) -> u64 {
        // The pilot and the picture use different numbers.
        let offset = if self.waves == 0 { 1 << 30 } else { 0 };
        let (estimator, numbers, floors) = (&self.estimator, self.numbers, self.floors);
        let sample = |x, y, sampler| estimator.sample(x, y, sampler);
        self.tiles
            .par_iter_mut()
            .with_max_len(4)
            .map(|tile| {
                if tile.planned == 0 || context.is_over() {
                    return 0;
                }
                let taken = tile.render(sample, context, offset, numbers);
                if taken > 0 {
                    tile.measure(estimator.world().plate, floors);
                }
                taken
            })
            .sum()
    }

    /// Error over the influence region, root mean square.
    fn measured_error(&self) -> f64 {
        let (variance, pixels) = self.tiles.iter().fold((0.0, 0.0), |(v, n), t| {
            (v + t.noise.variance * t.noise.influenced, n + t.noise.influenced)
        });
        if pixels > 0.0 { (variance / pixels).sqrt() } else { 0.0 }
    }

    /// Share of the work done, and whether it is all.
    fn share_done(&self) -> (f64, bool) {
        match self.stop {
            Stop::Samples(n) => {
                let sampled = self.tiles.iter().filter(|t| t.replicates > 0);
                let least = sampled.map(|t| if t.pilot { 0 } else { t.samples() }).min();
                let done = least.map_or(1.0, |least| f64::from(least) / f64::from(n.max(2)));
                (done.min(1.0), done >= 1.0)
            }
            Stop::Error(target) => {
                // Good to 3 %: the error of the error is no better.
                let done = (target / self.error.max(1e-12)).powi(2).min(1.0);
                let whole = self.tiles.iter().all(|t| t.replicates == 0 || !t.pilot);
                (done, whole && self.error <= 1.03 * target)
            }
            Stop::TimeSeconds(limit) => {
                let elapsed = self.elapsed();
                ((elapsed / limit.max(1e-9)).min(1.0), elapsed >= 0.97 * limit)
            }
        }
    }

    /// When the time asked for is over; later for the pilot.
    fn deadline(&self) -> Option<Instant> {
        let Stop::TimeSeconds(limit) = self.stop else { return None };
        let grace = if self.waves == 0 { PILOT_GRACE_SECONDS } else { 0.0 };
        // A time beyond the clock's range never comes.
        let limit = Duration::try_from_secs_f64(limit + grace).ok()?;
        self.started?.checked_add(limit)
    }

    fn outliers(&self) -> u64 {
        self.tiles.iter().map(|tile| tile.noise.outliers).sum()
    }
}

impl<E: Estimator> Integrator for Waves<E> {
    fn next_wave(&mut self, context: &Context) -> Wave {
        let nothing = |progress| Wave {
            samples: 0,
            done: 1.0,
            progress,
            error: 0.0,
            outliers: 0,
            denoised: None,
            missing: 0,
        };
        if self.estimator.world().objects.is_empty() {
            return nothing(Progress::Met);
        }
        if context.is_cancelled() {
            let (error, outliers, missing) = (self.error, self.outliers(), self.missing);
            return Wave { error, outliers, missing, ..nothing(Progress::Cancelled) };
        }
        let begin = Instant::now();
        if self.waves == 0 {
            self.started = Some(begin);
            self.begin(&context.until(self.deadline()));
        } else {
            self.plan();
            if let Stop::TimeSeconds(limit) = self.stop {
                self.fit_into(limit);
            }
        }
        let samples = self.render(&context.until(self.deadline()));
        if self.waves == 0 {
            self.end_pilot();
        }
        self.waves += 1;
        self.samples += samples;
        self.seconds += begin.elapsed().as_secs_f64();
        self.error = self.refine();
        let (done, met) = self.share_done();
        let progress = match (context.is_cancelled(), met, samples) {
            (true, ..) => Progress::Cancelled,
            (_, true, _) => Progress::Met,
            (.., 0) => Progress::Exhausted,
            _ => Progress::Going,
        };
        let done = if progress == Progress::Going { done.min(0.999) } else { 1.0 };
        let (outliers, missing) = (self.outliers(), self.missing);
        let denoised = self.refinement.is_some().then(|| self.gain());
        Wave { samples, done, progress, error: self.error, outliers, denoised, missing }
    }

    fn snapshot(&self) -> Difference {
        let world = self.estimator.world();
        let window = Block::window(self.tiles.iter().filter(|t| t.replicates > 0).map(|t| t.block));
        let size = (world.plate.width(), world.plate.height());
        let mut out = Difference::nothing_within(size, window);
        let refined = self.refinement.as_ref().map(|refinement| &refinement.estimates);
        for (t, tile) in self.tiles.iter().enumerate() {
            for k in 0..tile.block.n_pixels() {
                let estimate = match refined {
                    Some(estimates) => estimates[t].get(k).copied(),
                    None => tile.estimate(k, world.plate, self.floors.dark),
                };
                let Some(estimate) = estimate else { continue };
                let Some(at) = window.inside(tile.block.pixel(k)) else { continue };
                out.coverage[at] = estimate.coverage;
                out.object[at] = estimate.object;
                out.difference[at] = estimate.difference;
                out.ratio[at] = estimate.ratio;
                out.stderr[at] = estimate.variance.map(f32::sqrt);
                out.samples[at] = tile.samples();
            }
        }
        if let Some(guides) = &self.guides {
            let of_guides = |k| guides.window.inside(window.pixel(k));
            for k in 0..window.n_pixels() {
                let Some(at) = of_guides(k) else { continue };
                out.depth.pixels_mut()[k] = guides.depth[at];
                out.normal.pixels_mut()[k] = guides.normal[at];
                let mesh = guides.local[at].checked_sub(1);
                out.albedo.pixels_mut()[k] = mesh.map_or(Rgb::ZERO, |mesh| {
                    world.albedo.shown(world, mesh as usize, window.pixel(k))
                });
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicU64, Ordering};

    use super::*;
    use crate::light::Lights;
    use crate::render::coupled::Coupled;
    use crate::render::test_scenes::*;
    use crate::scene::{AlbedoSource, Scene};

    /// The coupled estimator in a scene so slow that a sample takes milliseconds; it counts them, and
    /// cancels what it is rendered for at one of them.
    struct Slow<'a> {
        inner: Coupled<'a>,
        drawn: &'a AtomicU64,
        cancel_at: u64,
        context: Context,
    }

    const SAMPLE: Duration = Duration::from_millis(4);
    const THREADS: usize = 2;

    impl Estimator for Slow<'_> {
        fn world(&self) -> &World<'_> {
            &self.inner.world
        }

        fn primary(&self) -> &Primary {
            &self.inner.primary
        }

        fn solve_albedo(&mut self, context: &Context) {
            self.inner.solve_albedo(context);
        }

        fn sample(&self, x: usize, y: usize, sampler: Sampler) -> Sample {
            std::thread::sleep(SAMPLE);
            if self.drawn.fetch_add(1, Ordering::Relaxed) + 1 == self.cancel_at {
                self.context.cancel();
            }
            self.inner.sample(x, y, sampler)
        }
    }

    fn scene_and_lights() -> (Scene, Lights) {
        let ball = sphere(glam::Vec3::new(0.0, 0.3, 0.0), 0.3, 2);
        let ground = local(ground(2.0), AlbedoSource::Plate);
        (scene(vec![ball], matt(0.5), vec![ground]), uniform_sky(1.0))
    }

    /// Runs a slow scene, whose pilot takes 2400 samples, to its end; also how many were drawn.
    fn run_slow(stop: Stop, cancel_at: u64) -> (Wave, Difference, u64) {
        let (scene, lights) = scene_and_lights();
        let camera = corner_camera(80, 60, 3.0);
        let plate = Image::filled(80, 60, crate::conventions::Rgb::splat(0.2));
        let job = plain_job(&scene, &lights, &camera, &plate, stop);
        let world = World::new(&scene, &lights, &camera, &plate);
        let primary = Primary::new(&camera, world.eye);
        let (context, drawn) = (Context::new(1), AtomicU64::new(0));
        let inner = Coupled { world, primary };
        let slow = Slow { inner, drawn: &drawn, cancel_at, context: context.clone() };
        let mut waves = Waves::new(slow, &job);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(THREADS).build().unwrap();
        let wave = pool.install(|| {
            loop {
                let wave = waves.next_wave(&context);
                if wave.finished() {
                    break wave;
                }
            }
        });
        (wave, waves.snapshot().whole(), drawn.load(Ordering::Relaxed))
    }

    #[test]
    fn the_time_asked_for_holds_in_the_pilot_too_and_what_is_missing_is_told() {
        const SECONDS: f64 = 0.3;
        let (wave, difference, drawn) = run_slow(Stop::TimeSeconds(SECONDS), u64::MAX);
        // No thread draws more than the time and the pilot's grace hold, and the one it is at.
        let each = (SECONDS + PILOT_GRACE_SECONDS) / SAMPLE.as_secs_f64() + 1.0;
        assert!(drawn as f64 <= THREADS as f64 * each, "{drawn} samples");
        assert_eq!(wave.progress, Progress::Met);
        let unsampled = difference.samples.pixels().iter().filter(|&&n| n == 0).count() as u64;
        assert!(wave.missing > 0 && wave.missing <= unsampled, "{} {unsampled}", wave.missing);
    }

    #[test]
    fn a_cancelled_pilot_ends_soon() {
        const DRAWN: u64 = 100;
        let (wave, _, drawn) = run_slow(Stop::Samples(8), DRAWN);
        // Every thread may be at a sample.
        assert!((DRAWN..DRAWN + THREADS as u64).contains(&drawn), "{drawn} samples");
        assert!(wave.progress == Progress::Cancelled && wave.missing > 0);
    }

    #[test]
    fn a_time_beyond_any_clock_never_comes() {
        let (wave, ..) = run_slow(Stop::TimeSeconds(1e300), 20);
        assert_eq!(wave.progress, Progress::Cancelled);
    }
}
