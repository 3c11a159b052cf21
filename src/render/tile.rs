//! A tile of pixels: what it has gathered, how wrong that is, and how many samples it should get.

use super::Context;
use super::film::{Estimate, Halves, Noise, Pixel, Refined, Sample};
use super::guides::Block;
use super::sampler::{Numbers, Sampler, mix};
use crate::conventions::Rgb;
use crate::photo::Image;

/// A pixel belongs to the influence region if the objects change it by more than this.
pub(super) const INFLUENCE: f64 = 0.01;
/// Share of the influenced pixels that the pooled error leaves out: a caustic found by chance has no
/// variance that more samples of its own kind would bring down, and must not take all the work.
/// They are counted, and the standard error delivered for them stays what it is.
pub(super) const HEAVY_TAIL: f64 = 0.02;
/// A pixel left out is told of if its variance is this many times the others' mean.
const OUTLIER: f64 = 25.0;
/// Samples of a pixel between two looks at the clock. A sample costs microseconds in most scenes and
/// milliseconds where thousands of triangles coincide; a look costs 30 ns.
const BETWEEN_LOOKS: u32 = 4;

/// A tile is quiet if no pixel's change is larger than its noise by this factor: of 64 pixels one
/// exceeds 5 σ by chance in 30 000 tiles, and in a few more where σ is from two replicates.
const QUIET_SIGMAS: f64 = 5.0;

/// Which pixels of a tile are sampled: one of each square of stride × stride, the others lie between.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Grid {
    pub stride: usize,
    /// The sampled pixel lies now here, now there in its square, so that no line across the tile
    /// slips between them; the others are then what their square's one is.
    pub scattered: bool,
}

impl Grid {
    /// Every pixel.
    pub const FULL: Self = Self { stride: 1, scattered: false };

    /// How many squares have a sampled pixel along a side of `size` pixels.
    fn squares(&self, size: usize) -> usize {
        if self.scattered {
            size.div_ceil(self.stride)
        } else {
            (size - self.first(size)).div_ceil(self.stride)
        }
    }

    /// The first sampled pixel along a side of `size` pixels, if they are not scattered.
    fn first(&self, size: usize) -> usize {
        (self.stride / 2).min(size.saturating_sub(1))
    }

    /// How many pixels of a block are sampled.
    fn n_sampled(&self, block: &Block) -> usize {
        self.squares(block.width) * self.squares(block.height)
    }

    /// The block's pixels that are sampled, square by square.
    fn sampled(self, block: &Block) -> impl Iterator<Item = usize> + use<> {
        let Block { width, height, .. } = *block;
        let stride = self.stride;
        let place = move |i: usize, j: usize| {
            let (x, y) = if self.scattered {
                // Along a column of squares x takes every place in turn, along a row y does.
                let across = (j + mix(i as u32) as usize) % stride;
                let down = (i + mix(!(j as u32)) as usize) % stride;
                (stride * i + across, stride * j + down)
            } else {
                (self.first(width) + stride * i, self.first(height) + stride * j)
            };
            y.min(height - 1) * width + x.min(width - 1)
        };
        let columns = self.squares(width);
        (0..self.squares(height)).flat_map(move |j| (0..columns).map(move |i| place(i, j)))
    }

    /// The two squares between which a place along a side lies, and how far it is on the way.
    fn between(&self, at: usize, size: usize) -> (usize, usize, f32) {
        if self.scattered {
            return (at / self.stride, at / self.stride, 0.0);
        }
        let last = self.squares(size) - 1;
        let place = at.saturating_sub(self.first(size)) as f32 / self.stride as f32;
        let low = (place as usize).min(last);
        (low, (low + 1).min(last), (place - low as f32).min(1.0))
    }
}

/// Samples and pooled error of a block of pixels.
pub struct Tile {
    pub block: Block,
    /// Samples per replicate.
    pub n: u32,
    pub replicates: u32,
    /// Replicates to add in the next wave.
    pub planned: u32,
    /// What is held came from the pilot and gives way to the first replicates of the picture.
    pub pilot: bool,
    /// Samples per replicate once the pilot has given way.
    pub n_next: u32,
    /// Only a focused reflection could be seen here.
    pub doubtful: bool,
    /// All of it shows one local mesh and no object: its light is smooth where the objects' own is.
    pub plain: bool,
    pub grid: Grid,
    /// The grid once the pilot has given way.
    pub grid_next: Grid,
    pub noise: TileNoise,
    pixels: Vec<Pixel>,
}

/// Pooled error of a tile's influenced pixels, the worst [`HEAVY_TAIL`] left out; of all its pixels
/// if none is influenced.
#[derive(Clone, Copy, Debug, Default)]
pub struct TileNoise {
    /// Mean relative variance of a single sample.
    pub sample_variance: f64,
    /// Mean relative variance reached.
    pub variance: f64,
    /// Pixels in the influence region.
    pub influenced: f64,
    /// Influenced pixels whose light is found by chance: far noisier than the others.
    pub outliers: u64,
    /// Largest change that a pixel shows, relative to its brightness.
    pub largest_change: f64,
    /// No change stands out of the noise anywhere.
    pub quiet: bool,
}

/// Brightnesses below which errors are not magnified and light counts as none.
#[derive(Clone, Copy, Debug)]
pub struct Floors {
    pub error: f32,
    pub dark: f32,
}

impl Tile {
    pub fn new(block: Block) -> Self {
        Self {
            block,
            n: 1,
            replicates: 0,
            planned: 0,
            pilot: false,
            n_next: 1,
            doubtful: false,
            plain: false,
            grid: Grid::FULL,
            grid_next: Grid::FULL,
            noise: TileNoise::default(),
            pixels: Vec::new(),
        }
    }

    /// Samples a pixel that are held.
    pub fn samples(&self) -> u32 {
        self.n * self.replicates
    }

    /// Samples of all pixels that are planned.
    pub fn work(&self) -> u64 {
        let (n, grid) =
            if self.pilot { (self.n_next, self.grid_next) } else { (self.n, self.grid) };
        u64::from(n * self.planned) * grid.n_sampled(&self.block) as u64
    }

    /// What is held for the block's `k`-th pixel, or lies between what its neighbours hold.
    fn held(&self, k: usize) -> Option<Pixel> {
        if self.grid == Grid::FULL || self.pixels.is_empty() {
            return self.pixels.get(k).copied();
        }
        let Block { width, height, .. } = self.block;
        let columns = self.grid.squares(width);
        let (x0, x1, fx) = self.grid.between(k % width, width);
        let (y0, y1, fy) = self.grid.between(k / width, height);
        let corners = [
            ((1.0 - fx) * (1.0 - fy), y0 * columns + x0),
            (fx * (1.0 - fy), y0 * columns + x1),
            ((1.0 - fx) * fy, y1 * columns + x0),
            (fx * fy, y1 * columns + x1),
        ];
        Some(Pixel::blend(corners.into_iter().map(|(weight, at)| (weight, &self.pixels[at]))))
    }

    /// Forgets what was gathered.
    pub fn clear(&mut self) {
        *self = Self::new(self.block);
    }

    /// Takes the planned replicates of `sample(x, y, sampler)`; returns the samples taken.
    ///
    /// Replicate r draws from the numbers of replicate `offset` + r. If the context is over before
    /// all are taken, none is: the tile is what it was.
    pub fn render(
        &mut self,
        sample: impl Fn(usize, usize, Sampler) -> Sample,
        context: &Context,
        offset: u32,
        numbers: Numbers,
    ) -> u64 {
        let n = if self.pilot { self.n_next } else { self.n };
        let grid = if self.pilot { self.grid_next } else { self.grid };
        let (mut pixels, held) = if self.pilot || self.pixels.is_empty() {
            (vec![Pixel::default(); grid.n_sampled(&self.block)], 0)
        } else {
            (self.pixels.clone(), self.replicates)
        };
        let more = offset + held..offset + held + self.planned;
        for (k, pixel) in grid.sampled(&self.block).zip(&mut pixels) {
            let (x, y) = self.block.pixel(k);
            for replicate in more.clone() {
                let mut sum = Sample::default();
                for index in 0..n {
                    if index % BETWEEN_LOOKS == 0 && context.is_over() {
                        return 0;
                    }
                    let sampler = Sampler::new(context.seed, (x, y), replicate, index, numbers);
                    sum += sample(x, y, sampler);
                }
                pixel.add(sum * (1.0 / n as f32));
            }
        }
        (self.pixels, self.n, self.replicates) = (pixels, n, held + self.planned);
        self.grid = grid;
        self.pilot = false;
        self.work()
    }

    /// What the tile's `k`-th pixel has come to; `None` if nothing was sampled.
    pub fn estimate(&self, k: usize, plate: &Image<Rgb>, dark: f32) -> Option<Estimate> {
        let plate = plate[self.block.pixel(k)];
        self.held(k).map(|pixel| pixel.estimate(self.replicates, plate, dark))
    }

    /// What a denoiser reads of the tile's `k`-th pixel; nothing of a pilot.
    pub fn halves(&self, k: usize, plate: &Image<Rgb>, dark: f32) -> Halves {
        match self.held(k) {
            Some(pixel) if !self.pilot => Halves {
                between: self.grid != Grid::FULL,
                ..pixel.halves(plate[self.block.pixel(k)], dark)
            },
            _ => Halves::default(),
        }
    }

    /// As [`estimate`](Self::estimate), with what a denoiser made of the halves.
    pub fn refined(
        &self,
        k: usize,
        plate: &Image<Rgb>,
        dark: f32,
        ratio: Refined,
        object: Refined,
    ) -> Option<Estimate> {
        let raw = self.estimate(k, plate, dark)?;
        if ratio.is_none() && object.is_none() {
            return Some(raw);
        }
        Some(self.held(k)?.refined(&raw, plate[self.block.pixel(k)], dark, ratio, object))
    }

    /// Pools the errors of the pixels.
    pub fn measure(&mut self, plate: &Image<Rgb>, floors: Floors) {
        let noises: Vec<Noise> = self
            .grid
            .sampled(&self.block)
            .zip(&self.pixels)
            .map(|(k, pixel)| {
                let plate = plate[self.block.pixel(k)];
                pixel.estimate(self.replicates, plate, floors.dark).noise(plate, floors.error)
            })
            .collect();
        let noise = self.pool(&noises);
        self.noise = noise.unwrap_or(self.noise);
    }

    /// Pooled error of `estimates` of all the tile's pixels; `None` if there are none.
    pub fn pool_estimates(
        &self,
        estimates: &[Estimate],
        plate: &Image<Rgb>,
        floors: Floors,
    ) -> Option<TileNoise> {
        let noises: Vec<Noise> = estimates
            .iter()
            .enumerate()
            .map(|(k, estimate)| estimate.noise(plate[self.block.pixel(k)], floors.error))
            .collect();
        self.pool(&noises)
    }

    fn pool(&self, noises: &[Noise]) -> Option<TileNoise> {
        if noises.is_empty() {
            return None;
        }
        // A change counts if it stands out of the tile's noise; a pixel's own estimate of its noise,
        // from few replicates, is often small by luck.
        let background: Vec<f64> =
            noises.iter().filter(|n| n.coverage == 0.0).map(|n| n.relative_variance).collect();
        let sigma = pooled(&background).0.sqrt();
        let seen = |n: &&Noise| n.coverage > 0.0 || n.change > INFLUENCE + 2.0 * sigma;
        let mut influenced: Vec<&Noise> = noises.iter().filter(seen).collect();
        // Few samples hide a change in noise: then the background's mean decides for all of it.
        let excess: f64 = noises
            .iter()
            .filter(|n| n.coverage == 0.0)
            .map(|n| (n.change - sigma).clamp(0.0, 1.0))
            .sum();
        let in_all = !background.is_empty() && excess > INFLUENCE * background.len() as f64;
        if in_all {
            influenced = noises.iter().collect();
        }
        let of: Vec<f64> = if influenced.is_empty() {
            noises.iter().map(|n| n.relative_variance).collect()
        } else {
            influenced.iter().map(|n| n.relative_variance).collect()
        };
        let (variance, outliers) = pooled(&of);
        let largest_change = noises.iter().map(|n| n.change).fold(0.0, f64::max);
        let covered = noises.iter().any(|n| n.coverage > 0.0);
        let quiet = !covered && !in_all && largest_change < INFLUENCE + QUIET_SIGMAS * sigma;
        let each = self.block.n_pixels() as f64 / noises.len() as f64;
        let thin = self.grid != Grid::FULL && !self.pilot;
        Some(TileNoise {
            sample_variance: variance * f64::from(self.samples()),
            variance,
            influenced: if thin && quiet { 0.0 } else { influenced.len() as f64 * each },
            outliers: if influenced.is_empty() { 0 } else { outliers },
            largest_change,
            quiet,
        })
    }
}

/// Mean of variances without the heavy tail, and how many of the tail are outliers; 0 of nothing.
fn pooled(variances: &[f64]) -> (f64, u64) {
    let mut sorted = variances.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    let kept = sorted.len() - (HEAVY_TAIL * sorted.len() as f64) as usize;
    let mean = sorted[..kept].iter().sum::<f64>() / kept.max(1) as f64;
    (mean, sorted[kept..].iter().filter(|&&v| v > OUTLIER * mean).count() as u64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::sampler::Purpose;

    const FLOORS: Floors = Floors { error: 1e-3, dark: 1e-6 };

    /// A tile of which the first `n` pixels are covered by a noisy object.
    fn tile(n: usize) -> (Tile, Image<Rgb>) {
        let mut tile = Tile::new(Block { x: 0, y: 0, width: 16, height: 16 });
        (tile.n, tile.planned) = (1, 8);
        let sample = |x: usize, y: usize, sampler: Sampler| {
            if 16 * y + x >= n {
                return Sample::default();
            }
            let light = 1.0 + (sampler.one(Purpose::Choice) - 0.5);
            Sample { coverage: 1.0, object: Rgb::splat(light), ..Sample::default() }
        };
        let taken = tile.render(sample, &Context::new(5), 0, Numbers::Independent);
        assert_eq!(taken, 8 * 256);
        let plate = Image::filled(16, 16, Rgb::ONE);
        tile.measure(&plate, FLOORS);
        (tile, plate)
    }

    #[test]
    fn a_thin_object_is_not_diluted_by_its_background() {
        let (few, many) = (tile(8).0.noise, tile(256).0.noise);
        assert_eq!((few.influenced, many.influenced), (8.0, 256.0));
        // Uniform noise of ±½: variance 1/12 a sample, relative to about 1. Eight pixels of seven
        // degrees of freedom each: 3 σ of the ratio is 0.57.
        assert!((few.sample_variance * 12.0 - 1.0).abs() < 0.57, "{few:?}");
        assert!((many.sample_variance * 12.0 - 1.0).abs() < 0.1, "{many:?}");
    }

    #[test]
    fn the_pilot_gives_way_to_the_picture() {
        let (mut tile, plate) = tile(256);
        tile.pilot = true;
        let pilot = tile.estimate(3, &plate, 1e-6);
        (tile.n_next, tile.planned) = (1, 4);
        tile.render(|_, _, _| Sample::default(), &Context::new(5), 100, Numbers::Independent);
        assert!(!tile.pilot && tile.replicates == 4);
        assert_ne!(tile.estimate(3, &plate, 1e-6), pilot);
        assert_eq!(tile.estimate(3, &plate, 1e-6), Some(Estimate::default()));
    }

    #[test]
    fn a_tile_that_is_broken_off_is_what_it_was() {
        let (mut tile, plate) = tile(256);
        let (before, held) = (tile.estimate(3, &plate, 1e-6), tile.replicates);
        let context = Context::new(5);
        let mut taken = std::cell::Cell::new(0);
        let sample = |_: usize, _: usize, _: Sampler| {
            taken.set(taken.get() + 1);
            if taken.get() == 100 {
                context.cancel();
            }
            Sample::default()
        };
        (tile.pilot, tile.n_next, tile.planned) = (true, 2, 4);
        assert_eq!(tile.render(sample, &context, 0, Numbers::Independent), 0);
        assert!(tile.pilot && tile.replicates == held && *taken.get_mut() < 110);
        assert_eq!(tile.estimate(3, &plate, 1e-6), before);
    }

    /// A tile sampled on `grid` whose pixels all change by `change(x, y)`, without noise.
    fn sparse(grid: Grid, width: usize, change: impl Fn(usize, usize) -> f32) -> Tile {
        let mut tile = Tile::new(Block { x: 0, y: 0, width, height: 16 });
        (tile.grid, tile.planned) = (grid, 4);
        let sample = |x: usize, y: usize, _: Sampler| Sample {
            local: 1.0,
            plate: 1.0,
            delta: Rgb::splat(change(x, y)),
            without: Rgb::ONE,
            ..Sample::default()
        };
        tile.render(sample, &Context::new(5), 0, Numbers::Independent);
        tile.measure(&Image::filled(width, 16, Rgb::ONE), FLOORS);
        tile
    }

    #[test]
    fn pixels_between_the_sampled_ones_lie_between_them() {
        for (stride, width) in [(2, 16), (4, 16), (4, 7), (4, 1)] {
            let slope = |x: usize, y: usize| 0.01 * x as f32 - 0.02 * y as f32;
            let grid = Grid { stride, scattered: false };
            let tile = sparse(grid, width, slope);
            let plate = Image::filled(width, 16, Rgb::ONE);
            for k in 0..tile.block.n_pixels() {
                let (x, y) = tile.block.pixel(k);
                // Beyond the outermost samples it stays as there.
                let held = |at: usize, size: usize| {
                    let last = grid.first(size) + (grid.squares(size) - 1) * stride;
                    at.clamp(grid.first(size), last)
                };
                let wanted = slope(held(x, width), held(y, 16));
                let found = tile.estimate(k, &plate, 1e-6).unwrap().ratio.x;
                assert!((found - wanted).abs() < 1e-5, "{stride} ({x}, {y}): {found} for {wanted}");
            }
        }
    }

    #[test]
    fn a_shadow_one_pixel_wide_keeps_its_tile_from_being_quiet() {
        let scattered = Grid { stride: 2, scattered: true };
        for (width, at) in (0..16).map(|at| (16, at)).chain((0..7).map(|at| (7, at))) {
            let quiet = |line: &dyn Fn(usize, usize) -> bool| {
                let change = |x, y| if line(x, y) { -0.5 } else { 0.0 };
                sparse(scattered, width, change).noise.quiet
            };
            assert!(!quiet(&|x, _| x == at), "column {at}");
            assert!(!quiet(&|_, y| y == at), "row {at}");
            // A slanting line as thin covers about two pixels of a row.
            let near = |x: usize, y: usize| (x + 2 * width - y % width - at) % width < 2;
            assert!(!quiet(&near), "diagonal {at}");
            assert!(!quiet(&|x, y| near(width - 1 - x, y)), "other diagonal {at}");
        }
        assert!(sparse(scattered, 16, |_, _| -0.002).noise.quiet);
    }

    #[test]
    fn pixels_of_chance_light_are_counted_not_pooled() {
        let mut variances = vec![1.0; 98];
        variances.extend([1e6, 2.0]);
        let (mean, outliers) = pooled(&variances);
        assert!((mean - 1.0).abs() < 0.02 && outliers == 1, "{mean} {outliers}");
        assert_eq!(pooled(&[]), (0.0, 0));
    }
}
