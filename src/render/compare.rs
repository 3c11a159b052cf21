//! One rendering of a job held against a better one: how wrong it is where the objects change the plate.
//!
//! Error and influence region are those of the stopping rule (`film`, `tile`): the finished pixel's
//! error relative to the brighter of plate and finished pixel, over the pixels that objects cover or
//! change by more than 1 %, without the 2 % of them that the better rendering itself knows worst.

use std::collections::BTreeMap;

use super::Difference;
use super::guides::TILE;
use super::tile::{HEAVY_TAIL, INFLUENCE};
use super::waves::error_floor;
use crate::conventions::{Rgb, luminance};
use crate::photo::Image;

/// The pixels that count, with what a good rendering makes of them.
#[derive(Clone, Debug)]
pub struct Region {
    pixels: Vec<Pixel>,
    /// The reference's own standard error, root mean square over the region.
    pub own_error: f64,
}

#[derive(Clone, Copy, Debug)]
struct Pixel {
    at: (usize, usize),
    plate: Rgb,
    finished: Rgb,
    brightness: f32,
    covered: bool,
    own_variance: f64,
}

/// How far a rendering is from the reference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Comparison {
    /// Root mean square over the region, the reference's own error taken out. 0 where it is smaller
    /// than the reference can tell.
    pub error: f64,
    /// The same over the pixels that objects cover by half, and over the others; 0 of none.
    pub on_objects: f64,
    pub beside: f64,
    /// Mean signed difference over the region: above 0 if the rendering is too bright.
    pub bias: f64,
    /// Standard error of `bias`, the larger of two: if pixels err independently of each other, and if
    /// tiles do, in which they share a filter and what lies between samples. Light that no sample found
    /// is in neither.
    pub bias_sigma: f64,
}

impl Region {
    /// The influence region as `reference` shows it; `None` if the objects change nothing.
    pub fn new(reference: &Difference, plate: &Image<Rgb>) -> Option<Self> {
        let floor = error_floor(plate);
        let mut pixels = Vec::new();
        for y in 0..plate.height() {
            for x in 0..plate.width() {
                let at = (x, y);
                let finished = reference.over(plate[at], at);
                let (before, after) = (luminance(plate[at]), luminance(finished));
                let brightness = before.max(after).max(floor);
                let changed = f64::from((after - before).abs() / brightness) > INFLUENCE;
                if reference.samples[at] > 0 && (changed || reference.coverage[at] > 0.0) {
                    let own = f64::from(luminance(reference.stderr[at]) / brightness);
                    pixels.push(Pixel {
                        at,
                        plate: plate[at],
                        finished,
                        brightness,
                        covered: reference.coverage[at] > 0.5,
                        own_variance: own * own,
                    });
                }
            }
        }
        pixels.sort_by(|a, b| a.own_variance.total_cmp(&b.own_variance));
        pixels.truncate(pixels.len() - (HEAVY_TAIL * pixels.len() as f64) as usize);
        let variance: f64 = pixels.iter().map(|p| p.own_variance).sum();
        let n = pixels.len() as f64;
        (!pixels.is_empty()).then(|| Self { own_error: (variance / n).sqrt(), pixels })
    }

    /// Pixels that count.
    pub fn n_pixels(&self) -> usize {
        self.pixels.len()
    }

    /// Column, row and relative change of every pixel that counts.
    pub fn changes(&self) -> impl Iterator<Item = ((usize, usize), f32)> {
        let change = |p: &Pixel| luminance((p.finished - p.plate).abs()) / p.brightness;
        self.pixels.iter().map(move |p| (p.at, change(p)))
    }

    /// How far `rendering`, of the same job, is from the reference.
    pub fn compare(&self, rendering: &Difference) -> Comparison {
        // Squares less the reference's own, and pixels: beside the objects and on them
        let mut parts = [(0.0, 0.0); 2];
        let (mut sum, mut signed_squares) = (0.0, 0.0);
        // Signed differences, and pixels, of every tile
        let mut tiles: BTreeMap<(usize, usize), (f64, f64)> = BTreeMap::new();
        for pixel in &self.pixels {
            let off = rendering.over(pixel.plate, pixel.at) - pixel.finished;
            // Channels of one path are strongly correlated: their errors add.
            let size = f64::from(luminance(off.abs()) / pixel.brightness);
            let signed = f64::from(luminance(off) / pixel.brightness);
            let (squares, n) = &mut parts[usize::from(pixel.covered)];
            *squares += size * size - pixel.own_variance;
            *n += 1.0;
            sum += signed;
            signed_squares += signed * signed;
            let (of_tile, n) = tiles.entry((pixel.at.0 / TILE, pixel.at.1 / TILE)).or_default();
            *of_tile += signed;
            *n += 1.0;
        }
        let root = |(squares, n): (f64, f64)| (squares.max(0.0) / n.max(1.0)).sqrt();
        let [beside, covered] = parts;
        let n = self.pixels.len() as f64;
        let bias = sum / n;
        Comparison {
            error: root((beside.0 + covered.0, n)),
            on_objects: root(covered),
            beside: root(beside),
            bias,
            // Of few tiles, the scatter among them is itself known badly
            bias_sigma: sigma_of_mean(tiles.into_values(), bias, n).max(signed_squares.sqrt() / n),
        }
    }
}

/// Standard error of the mean of `n` values whose parts, of known sums and sizes, scatter independently
/// (Liang and Zeger 1986, of clusters); 0 of fewer than two parts.
fn sigma_of_mean(parts: impl ExactSizeIterator<Item = (f64, f64)>, mean: f64, n: f64) -> f64 {
    let count = parts.len() as f64;
    if count < 2.0 {
        return 0.0;
    }
    let squares: f64 = parts.map(|(sum, size)| (sum - size * mean).powi(2)).sum();
    (squares * count / (count - 1.0)).sqrt() / n
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::Lights;
    use crate::render::test_scenes::{
        corner_camera, finish, ground, local, matt, plain_job, scene, sphere, sunny_sky,
        uniform_sky,
    };
    use crate::render::{Job, Method, Stop};
    use crate::scene::AlbedoSource;

    /// A shadow of half the light over the left half of a grey picture.
    fn reference() -> (Difference, Image<Rgb>) {
        let plate = Image::filled(40, 20, Rgb::splat(0.5));
        let mut difference = Difference::nothing(40, 20);
        for y in 0..20 {
            for x in 0..20 {
                difference.difference[(x, y)] = Rgb::splat(-0.25);
                difference.stderr[(x, y)] = Rgb::splat(0.005);
                difference.samples[(x, y)] = 64;
            }
        }
        (difference, plate)
    }

    #[test]
    fn the_region_is_what_changes_without_the_worst_known() {
        let (difference, plate) = reference();
        let region = Region::new(&difference, &plate).unwrap();
        assert_eq!(region.n_pixels(), 400 - 8);
        assert!((region.own_error - 0.01).abs() < 1e-7);
        assert!(region.changes().all(|((x, _), change)| x < 20 && (change - 0.5).abs() < 1e-6));
        assert!(Region::new(&Difference::nothing(40, 20), &plate).is_none());
    }

    #[test]
    fn error_and_bias_are_told_apart() {
        let (difference, plate) = reference();
        let region = Region::new(&difference, &plate).unwrap();
        let mut off = difference.clone();
        for (k, d) in off.difference.pixels_mut().iter_mut().enumerate() {
            *d += Rgb::splat(0.01 + if k % 2 == 0 { 0.02 } else { -0.02 });
        }
        let found = region.compare(&off);
        // √(0.02² + 0.04² − 0.01²): bias, scatter, and what the reference itself may be off.
        assert!((found.error - 0.0019_f64.sqrt()).abs() < 1e-6, "{found:?}");
        assert!((found.bias - 0.02).abs() < 1e-4, "{found:?}");
        assert!(found.on_objects == 0.0 && found.beside == found.error, "{found:?}");
        assert_eq!(region.compare(&difference).error, 0.0);
    }

    #[test]
    fn what_pixels_of_a_tile_have_in_common_counts_in_full() {
        // 100 pixels of each of four tiles err alike: only the four scatter.
        let parts = [0.1, -0.1, 0.3, 0.1].map(|off| (100.0 * off, 100.0));
        let mean = 0.1;
        let wanted = (0.08 / 3.0 / 4.0_f64).sqrt();
        let sigma = sigma_of_mean(parts.into_iter(), mean, 400.0);
        assert!((sigma - wanted).abs() < 1e-12, "{sigma} for {wanted}");
        assert_eq!(sigma_of_mean([(40.0, 400.0)].into_iter(), mean, 400.0), 0.0);
    }

    /// A ball on a grey ground, rendered with an error that is told.
    fn render(lights: &Lights, stop: Stop, denoise: bool, seed: u64) -> (Difference, f64) {
        let ball = sphere(glam::Vec3::new(0.0, 0.3, 0.0), 0.3, 3);
        let scene = scene(vec![ball], matt(0.5), vec![local(ground(8.0), AlbedoSource::Plate)]);
        let (camera, plate) = (corner_camera(96, 72, 3.5), plate());
        let job = Job { denoise, ..plain_job(&scene, lights, &camera, &plate, stop) };
        let (difference, wave) = finish(Method::Coupled, job, seed);
        (difference.whole(), wave.error)
    }

    fn plate() -> Image<Rgb> {
        Image::filled(96, 72, Rgb::splat(0.15))
    }

    /// σ of the pixels is what their errors scatter by, and so is the error told of all of them; the filter's
    /// is said to be up to a quarter larger than it is, never smaller.
    #[test]
    fn the_error_told_is_the_error_made() {
        for (name, lights) in [("sky", uniform_sky(1.0)), ("sun", sunny_sky(40.0, 2.0))] {
            let reference = render(&lights, Stop::Samples(1024), false, 1000).0;
            let region = Region::new(&reference, &plate()).unwrap();
            for (target, denoise) in [(0.1, false), (0.03, false), (0.1, true), (0.03, true)] {
                let (mut made, mut told, mut by_pixel) = (0.0, 0.0, 0.0);
                for seed in 0..8 {
                    let (difference, error) = render(&lights, Stop::Error(target), denoise, seed);
                    made += region.compare(&difference).error.powi(2);
                    told += error * error;
                    let own = |p: &Pixel| luminance(difference.stderr[p.at]) / p.brightness;
                    let squares = region.pixels.iter().map(|p| f64::from(own(p)).powi(2));
                    by_pixel += squares.sum::<f64>() / region.n_pixels() as f64;
                }
                let [made, told, by_pixel] =
                    [made, told, by_pixel].map(|squares: f64| (squares / 8.0).sqrt());
                let (told, by_pixel) = (told / made, by_pixel / made);
                println!("{name}, {target}, denoised {denoise}: {told:.3}, by pixel {by_pixel:.3}");
                // Eight errors over two thousand pixels each: good to 2 %.
                let most = if denoise { 1.25 } else { 1.15 };
                assert!((0.9..most).contains(&by_pixel), "{name} {target} {denoise}: {by_pixel}");
                // Told of the pixels that stand out of the noise, which are those that err most.
                assert!((0.9..1.3).contains(&told), "{name} {target} {denoise}: {told}");
            }
        }
    }

    /// The bias of renderings without any scatters over 16 seeds as its standard error says, denoised or
    /// not: the scatter of 16 is good to 18 %, the standard error of some twenty tiles to as much.
    #[test]
    fn the_standard_error_of_the_bias_is_its_scatter() {
        let (lights, plate) = (uniform_sky(1.0), plate());
        let render = |stop, denoise, seed| render(&lights, stop, denoise, seed).0;
        let region = Region::new(&render(Stop::Samples(256), false, 1000), &plate).unwrap();
        for denoise in [false, true] {
            const N: f64 = 16.0;
            let of_seed = |seed| region.compare(&render(Stop::Error(0.3), denoise, seed));
            let found: Vec<Comparison> = (0..N as u64).map(of_seed).collect();
            let mean = |of: &dyn Fn(&Comparison) -> f64| found.iter().map(of).sum::<f64>() / N;
            let bias = mean(&|f| f.bias);
            let scatter = (mean(&|f| (f.bias - bias).powi(2)) * N / (N - 1.0)).sqrt();
            let stated = mean(&|f| f.bias_sigma);
            println!(
                "denoised {denoise}: {bias:.5}, scatter {scatter:.5}, stated {stated:.5}; as pixels {:.5}",
                mean(&|f| f.error) / (region.n_pixels() as f64).sqrt()
            );
            assert!((0.6..1.6).contains(&(scatter / stated)), "{denoise}: {scatter} for {stated}");
        }
    }
}
