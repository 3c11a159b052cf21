//! Denoising of the difference: non-local means between two halves of the samples.
//!
//! What is filtered is ΔE/E₀ and the objects' radiance, never the plate (methods-render R8.1). How
//! alike two pixels are is judged by one half and applied to the other (Rousselle, Knaus, Zwicker
//! 2012, eq. 4), so that no noise chooses its own neighbours. What passes between two pixels is
//! symmetric: what one gets the other gives, and the sum over the picture stays what it was. Where
//! the other half does not confirm that a pixel came nearer to the truth, it keeps its samples (R8.3).

use rayon::prelude::*;

use crate::conventions::Rgb;
use crate::photo::Image;

/// Pixels that look at each other lie at most this far apart in x and in y.
const REACH: usize = 5;
/// Half the side of the patches that are compared.
const PATCH: usize = 1;
/// Strictness: how many times the noise two pixels may differ (k of Rousselle et al.).
const STRICTNESS: f32 = 0.5;
/// Pixels of a block in each direction.
const BLOCK: usize = 48;
/// Around a block: neighbours, their neighbours, and the patches of those.
const MARGIN: usize = 2 * REACH + PATCH;

/// A noisy picture in two independent halves.
pub struct Noisy {
    pub halves: [Image<Rgb>; 2],
    /// Pixels of different groups never mix; 0 is not filtered at all.
    pub groups: Image<u32>,
    /// How much of the picture a pixel's value stands for: Σ mass · value is kept. Above 0.
    pub masses: Image<f32>,
}

/// The filtered picture.
pub struct Filtered {
    pub value: Image<Rgb>,
    /// `value` less the mean of the halves.
    pub moved: Image<Rgb>,
    /// Expected squared error of `value`, by channel: noise and what the filter smears.
    pub variance: Image<Rgb>,
}

/// Filters `noisy`. Pixels of group 0 come back as the mean of their halves, with variance 0.
pub fn denoise(noisy: &Noisy) -> Filtered {
    let Noisy { halves: [a, b], groups, .. } = noisy;
    let (width, height) = (groups.width(), groups.height());
    let squared: Image<Rgb> =
        Image::from_fn(width, height, |x, y| 0.5 * (a[(x, y)] - b[(x, y)]).powf(2.0));
    // Variance of one half
    let variance = smooth(&squared, groups, 2);
    let [fa, fb] = filter_halves(noisy, &variance);

    // Judged by the half that is not in it, a filtered half errs by this beyond that half's noise
    let error_of_half: Image<Rgb> = Image::from_fn(width, height, |x, y| {
        let p = (x, y);
        0.5 * ((fa[p] - b[p]).powf(2.0) + (fb[p] - a[p]).powf(2.0)) - squared[p]
    });
    let scatter: Image<Rgb> =
        Image::from_fn(width, height, |x, y| 0.25 * (fa[(x, y)] - fb[(x, y)]).powf(2.0));
    let (error_of_half, scatter) = (smooth(&error_of_half, groups, 3), smooth(&scatter, groups, 3));
    let mut out = Filtered {
        value: Image::filled(width, height, Rgb::ZERO),
        moved: Image::filled(width, height, Rgb::ZERO),
        variance: Image::filled(width, height, Rgb::ZERO),
    };
    for y in 0..height {
        for x in 0..width {
            let p = (x, y);
            let raw = 0.5 * (a[p] + b[p]);
            out.value[p] = raw;
            if groups[p] == 0 {
                continue;
            }
            let of_raw = 0.5 * variance[p];
            // Both halves smear alike but scatter apart: their mean scatters half as much.
            let of_filtered = (error_of_half[p] - scatter[p]).max(scatter[p]);
            let share = of_raw / (of_raw + of_filtered).max(Rgb::splat(1e-30));
            out.moved[p] = share * (0.5 * (fa[p] + fb[p]) - raw);
            out.value[p] = raw + out.moved[p];
            out.variance[p] = share * share * of_filtered + (Rgb::ONE - share).powf(2.0) * of_raw;
        }
    }
    out
}

/// Mean over (2 `radius` + 1)² pixels of the same group.
fn smooth(image: &Image<Rgb>, groups: &Image<u32>, radius: usize) -> Image<Rgb> {
    let (width, height) = (image.width(), image.height());
    let rows: Vec<Vec<Rgb>> = (0..height)
        .into_par_iter()
        .map(|y| {
            let near = y.saturating_sub(radius)..(y + radius + 1).min(height);
            (0..width)
                .map(|x| {
                    let group = groups[(x, y)];
                    if group == 0 {
                        return Rgb::ZERO;
                    }
                    let (mut sum, mut n) = (Rgb::ZERO, 0.0);
                    for j in near.clone() {
                        for i in x.saturating_sub(radius)..(x + radius + 1).min(width) {
                            if groups[(i, j)] == group {
                                sum += image[(i, j)];
                                n += 1.0;
                            }
                        }
                    }
                    sum / n
                })
                .collect()
        })
        .collect();
    Image::from_pixels(width, height, rows.into_iter().flatten().collect())
        .unwrap_or_else(|| Image::filled(width, height, Rgb::ZERO))
}

/// A block with its margin: what the filter reads, channel by channel.
struct Area {
    width: usize,
    height: usize,
    groups: Vec<u32>,
    masses: Vec<f32>,
    variance: [Vec<f32>; 3],
    halves: [[Vec<f32>; 3]; 2],
}

/// Each half filtered by what the other says is alike.
fn filter_halves(noisy: &Noisy, variance: &Image<Rgb>) -> [Image<Rgb>; 2] {
    let groups = &noisy.groups;
    let (width, height) = (groups.width(), groups.height());
    let mut blocks = Vec::new();
    for y in (0..height).step_by(BLOCK) {
        for x in (0..width).step_by(BLOCK) {
            let (w, h) = (BLOCK.min(width - x), BLOCK.min(height - y));
            let any = (y..y + h).any(|j| groups.row(j)[x..x + w].iter().any(|&g| g != 0));
            if any {
                blocks.push((x, y, w, h));
            }
        }
    }
    let filtered: Vec<[Vec<Rgb>; 2]> = blocks
        .par_iter()
        .map(|&(x, y, w, h)| {
            let area = Area::new(noisy, variance, x, y, w, h);
            [0, 1].map(|half| area.filter(half, w, h))
        })
        .collect();
    let mut out = noisy.halves.clone();
    for (&(x, y, w, _), filtered) in blocks.iter().zip(&filtered) {
        for (out, filtered) in out.iter_mut().zip(filtered) {
            for (k, &value) in filtered.iter().enumerate() {
                out[(x + k % w, y + k / w)] = value;
            }
        }
    }
    out
}

impl Area {
    fn new(noisy: &Noisy, variance: &Image<Rgb>, x: usize, y: usize, w: usize, h: usize) -> Self {
        let (width, height) = (w + 2 * MARGIN, h + 2 * MARGIN);
        let n = width * height;
        let zeros = || [0; 3].map(|_| vec![0.0; n]);
        let mut area = Self {
            width,
            height,
            groups: vec![0; n],
            masses: vec![1.0; n],
            variance: zeros(),
            halves: [zeros(), zeros()],
        };
        for j in 0..height {
            for i in 0..width {
                let at = (x + i).checked_sub(MARGIN).zip((y + j).checked_sub(MARGIN));
                let Some(p) = at else { continue };
                let Some(&group) = noisy.groups.get(p.0, p.1) else { continue };
                let k = j * width + i;
                area.groups[k] = group;
                area.masses[k] = noisy.masses[p];
                for c in 0..3 {
                    area.variance[c][k] = variance[p][c];
                    for half in 0..2 {
                        area.halves[half][c][k] = noisy.halves[half][p][c];
                    }
                }
            }
        }
        area
    }

    /// The inner `w` × `h` pixels of one half, filtered by the likeness seen in the other.
    fn filter(&self, half: usize, w: usize, h: usize) -> Vec<Rgb> {
        let n = self.groups.len();
        let offsets = offsets();
        let mut weights: Vec<Vec<f32>> = Vec::with_capacity(offsets.len());
        let mut sums = vec![1.0_f32; n];
        for &(dx, dy) in &offsets {
            let of = self.likeness(1 - half, dx, dy);
            let step = self.step(dx, dy);
            for k in 0..n - step {
                sums[k] += of[k];
                sums[k + step] += of[k];
            }
            weights.push(of);
        }
        let mut out = self.halves[half].clone();
        for (&(dx, dy), of) in offsets.iter().zip(&weights) {
            let step = self.step(dx, dy);
            for (values, out) in self.halves[half].iter().zip(&mut out) {
                for k in 0..n - step {
                    let (here, there) = (self.masses[k], self.masses[k + step]);
                    // What the lighter of the two takes changes the heavier one less.
                    let passed = of[k] / (sums[k].max(sums[k + step]) * here.max(there))
                        * (values[k + step] - values[k]);
                    out[k] += passed * there;
                    out[k + step] -= passed * here;
                }
            }
        }
        let inner = |k: usize| (MARGIN + k / w) * self.width + MARGIN + k % w;
        (0..w * h).map(|k| Rgb::new(out[0][inner(k)], out[1][inner(k)], out[2][inner(k)])).collect()
    }

    fn step(&self, dx: isize, dy: usize) -> usize {
        (dy * self.width).wrapping_add_signed(dx)
    }

    /// How much pixel k and the one at (dx, dy) from it may share, 0…1, by one half.
    fn likeness(&self, half: usize, dx: isize, dy: usize) -> Vec<f32> {
        let (n, width) = (self.groups.len(), self.width);
        let step = self.step(dx, dy);
        let mut distance = vec![0.0_f32; n];
        for c in 0..3 {
            let (value, variance) = (&self.halves[half][c], &self.variance[c]);
            for k in 0..n - step {
                let both = variance[k] + variance[k + step];
                let apart = value[k] - value[k + step];
                distance[k] +=
                    (apart * apart - both) / (1e-12 + STRICTNESS * STRICTNESS * both) / 3.0;
            }
        }
        // A pair counts if both are of one group; rows of the area do not run on into each other.
        let mut counts = vec![0.0_f32; n];
        for y in 0..self.height - dy {
            let columns = (-dx).max(0) as usize..width - dx.max(0) as usize;
            for k in columns.map(|x| y * width + x) {
                let group = self.groups[k];
                if group != 0 && group == self.groups[k + step] {
                    counts[k] = 1.0;
                } else {
                    distance[k] = 0.0;
                }
            }
        }
        for k in 0..n {
            distance[k] *= counts[k];
        }
        let (sum, number) = (box_sum(&distance, width), box_sum(&counts, width));
        let mut out = vec![0.0; n];
        for k in 0..n {
            let mean = (sum[k] / number[k].max(1.0)).max(0.0);
            // Near to e^−x, and 0 from x = 5 on
            let left = (1.0 - 0.2 * mean).max(0.0);
            out[k] = counts[k] * (left * left) * (left * left);
        }
        out
    }
}

/// Half the neighbours: the others are these seen from the other side.
fn offsets() -> Vec<(isize, usize)> {
    let reach = REACH as isize;
    (0..=REACH)
        .flat_map(|dy| (-reach..=reach).map(move |dx| (dx, dy)))
        .filter(|&(dx, dy)| dy > 0 || dx > 0)
        .collect()
}

/// Sums over 3 × 3 pixels; the border stays 0.
fn box_sum(values: &[f32], width: usize) -> Vec<f32> {
    let n = values.len();
    let mut rows = vec![0.0; n];
    for k in PATCH..n - PATCH {
        rows[k] = values[k - 1] + values[k] + values[k + 1];
    }
    let mut out = vec![0.0; n];
    for k in width..n - width {
        out[k] = rows[k - width] + rows[k] + rows[k + width];
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A standard normal number (sum of twelve), fixed by its place.
    fn normal(x: usize, y: usize, salt: u32) -> f32 {
        let mut sum = -6.0;
        for k in 0..12 {
            let mut h = (x as u32).wrapping_mul(0x9e37_79b9)
                ^ (y as u32).wrapping_mul(0x85eb_ca6b)
                ^ (salt * 12 + k).wrapping_mul(0xc2b2_ae35);
            for m in [0x7feb_352d_u32, 0x846c_a68b] {
                h = (h ^ (h >> 16)).wrapping_mul(m);
            }
            sum += (h ^ (h >> 15)) as f32 / 4_294_967_296.0;
        }
        sum
    }

    const SIZE: usize = 120;

    /// A penumbra beside a hard edge.
    fn truth(x: usize, y: usize) -> f32 {
        if x + y / 4 > 90 { -0.7 } else { -0.3 / (1.0 + (x as f32 - 30.0).powi(2) / 400.0) }
    }

    fn noisy(sigma: f32, groups: Image<u32>) -> Noisy {
        let half = |salt| {
            Image::from_fn(SIZE, SIZE, |x, y| {
                Rgb::splat(truth(x, y) + sigma * normal(x, y, salt)) * Rgb::new(1.0, 0.9, 1.1)
            })
        };
        Noisy { halves: [half(1), half(2)], groups, masses: Image::filled(SIZE, SIZE, 1.0) }
    }

    fn squared_error(image: &Image<Rgb>) -> f64 {
        let mut sum = 0.0;
        for y in 0..SIZE {
            for x in 0..SIZE {
                sum += f64::from(image[(x, y)].x - truth(x, y)).powi(2);
            }
        }
        sum / (SIZE * SIZE) as f64
    }

    #[test]
    fn noise_falls_and_the_error_it_states_is_true() {
        let noisy = noisy(0.1, Image::filled(SIZE, SIZE, 1));
        let filtered = denoise(&noisy);
        let raw = 0.1_f64 * 0.1 / 2.0;
        let error = squared_error(&filtered.value);
        assert!(error < raw / 6.0, "{error} of {raw}");
        let stated: f64 = filtered.variance.pixels().iter().map(|v| f64::from(v.x)).sum::<f64>()
            / (SIZE * SIZE) as f64;
        assert!((0.6..1.7).contains(&(stated / error)), "{stated} for {error}");
    }

    #[test]
    fn an_edge_stays_an_edge() {
        let filtered = denoise(&noisy(0.05, Image::filled(SIZE, SIZE, 1)));
        for y in (20..100).step_by(8) {
            let edge = 90 - y / 4;
            let (left, right) = (filtered.value[(edge - 1, y)].x, filtered.value[(edge + 2, y)].x);
            assert!((left - truth(edge - 1, y)).abs() < 0.1 && (right + 0.7).abs() < 0.1);
        }
    }

    #[test]
    fn the_sum_over_the_picture_stays() {
        let noisy = noisy(0.2, Image::filled(SIZE, SIZE, 1));
        let area =
            Area::new(&noisy, &Image::filled(SIZE, SIZE, Rgb::splat(0.04)), 0, 0, SIZE, SIZE);
        // One block that holds the whole picture: nothing can leave it.
        let filtered = area.filter(0, SIZE, SIZE);
        let sum = |pixels: &[Rgb]| pixels.iter().map(|p| f64::from(p.x)).sum::<f64>();
        let (before, after) = (sum(noisy.halves[0].pixels()), sum(&filtered));
        assert!((after / before - 1.0).abs() < 1e-5, "{before} {after}");
        let mean = |image: &Image<Rgb>| sum(image.pixels());
        let whole = mean(&denoise(&noisy).value);
        let raw = 0.5 * (mean(&noisy.halves[0]) + mean(&noisy.halves[1]));
        assert!((whole / raw - 1.0).abs() < 1e-3, "{whole} {raw}");
    }

    #[test]
    fn groups_do_not_mix_and_what_has_none_stays() {
        let groups = Image::from_fn(SIZE, SIZE, |x, _| match x {
            0..40 => 1,
            40..80 => 2,
            _ => 0,
        });
        let half = Image::from_fn(SIZE, SIZE, |x, y| {
            let level = if x < 40 { 0.0 } else { 1e-3 };
            Rgb::splat(level + normal(x, y, 3) * if x < 80 { 0.0 } else { 1.0 })
        });
        let noisy = Noisy {
            halves: [half.clone(), half.clone()],
            groups,
            masses: Image::filled(SIZE, SIZE, 1.0),
        };
        let filtered = denoise(&noisy);
        for (a, b) in filtered.value.pixels().iter().zip(half.pixels()) {
            assert!((*a - *b).abs().max_element() < 1e-7);
        }
    }

    #[test]
    fn blocks_leave_no_seam() {
        // The same picture shifted by a few pixels is cut elsewhere and must come out the same.
        let whole = noisy(0.1, Image::filled(SIZE, SIZE, 1));
        let shift = 7;
        let cut = |image: &Image<Rgb>| {
            Image::from_fn(SIZE - shift, SIZE - shift, |x, y| image[(x + shift, y + shift)])
        };
        let part = Noisy {
            halves: [cut(&whole.halves[0]), cut(&whole.halves[1])],
            groups: Image::filled(SIZE - shift, SIZE - shift, 1),
            masses: Image::filled(SIZE - shift, SIZE - shift, 1.0),
        };
        let (a, b) = (denoise(&whole).value, denoise(&part).value);
        for y in 30..SIZE - shift {
            for x in 30..SIZE - shift {
                assert!((a[(x + shift, y + shift)] - b[(x, y)]).abs().max_element() < 1e-6);
            }
        }
    }
}
