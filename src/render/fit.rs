//! Light fitted window by window to place and normal, for the denoiser.
//!
//! Around centres three pixels apart every channel of a half is fitted by 1, x, y and the normal, and
//! every pixel takes the weighted mean of the windows that hold it (first-order regression after
//! Bitterli et al. 2016, "Nonlinearly weighted first-order regression for denoising Monte Carlo
//! renderings", there with one window a pixel). How alike two pixels are is judged by one half and
//! applied to the other (Rousselle, Knaus, Zwicker 2012, eq. 4), so that no noise chooses its own
//! neighbours.

use rayon::prelude::*;

use crate::conventions::Rgb;
use crate::photo::Image;

/// A window's pixels lie at most this far from its centre in x and in y.
const REACH: usize = 6;
/// Pixels between the centres of windows.
const SPACING: usize = 3;
/// Half the side of the patches that are compared.
const PATCH: usize = 1;
/// Strictness: how many times the noise two pixels may differ (k of Rousselle et al.).
const STRICTNESS: f32 = 0.6;
/// Pixels less alike than this are not fitted together.
const LEAST_LIKENESS: f32 = 0.01;
/// A pixel that all windows together hold less than this is fitted by a window of its own.
const LEAST_WEIGHT: f32 = 0.2;
/// Ridge of the slopes, relative to the window's weight: what a window hardly varies in stays flat.
const RIDGE: f32 = 2e-3;
/// What is fitted: 1, x, y and the normal's three.
const N_FIT: usize = 6;
/// Pixels of a block in each direction; a multiple of [`SPACING`], so that blocks leave no seam.
const BLOCK: usize = 48;
/// Around a block: windows that reach into it, their pixels, and the patches of those.
const MARGIN: usize = 2 * REACH + PATCH;

/// Each half fitted by what the other says is alike.
///
/// `variance` is that of the sum of a half's channels. Pixels of group 0 stay as they are.
pub fn fit_halves(
    halves: &[Image<Rgb>; 2],
    groups: &Image<u32>,
    normals: &Image<Rgb>,
    variance: &Image<f32>,
) -> [Image<Rgb>; 2] {
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
    let fitted: Vec<[Vec<Rgb>; 2]> = blocks
        .par_iter()
        .map(|&(x, y, w, h)| {
            let area = Area::new(halves, groups, normals, variance, (x, y, w, h));
            [0, 1].map(|half| area.fit(half, w, h))
        })
        .collect();
    let mut out = halves.clone();
    for (&(x, y, w, _), fitted) in blocks.iter().zip(&fitted) {
        for (out, fitted) in out.iter_mut().zip(fitted) {
            for (k, &value) in fitted.iter().enumerate() {
                out[(x + k % w, y + k / w)] = value;
            }
        }
    }
    out
}

/// A block with its margin: what the windows read.
struct Area {
    width: usize,
    height: usize,
    groups: Vec<u32>,
    normals: Vec<Rgb>,
    halves: [Vec<Rgb>; 2],
    /// Sum of the channels, which likeness goes by, and its variance.
    brightness: [Vec<f32>; 2],
    variance: Vec<f32>,
}

/// A pixel of a window: where, how alike the centre, and what its light is fitted by.
type Member = (usize, f32, [f32; N_FIT]);

/// Weighted sums of what windows say of each pixel.
struct Sums {
    values: Vec<Rgb>,
    weights: Vec<f32>,
}

impl Area {
    fn new(
        halves: &[Image<Rgb>; 2],
        groups: &Image<u32>,
        normals: &Image<Rgb>,
        variance: &Image<f32>,
        (x, y, w, h): (usize, usize, usize, usize),
    ) -> Self {
        let (width, height) = (w + 2 * MARGIN, h + 2 * MARGIN);
        let n = width * height;
        let mut area = Self {
            width,
            height,
            groups: vec![0; n],
            normals: vec![Rgb::ZERO; n],
            halves: [0; 2].map(|_| vec![Rgb::ZERO; n]),
            brightness: [0; 2].map(|_| vec![0.0; n]),
            variance: vec![0.0; n],
        };
        for k in 0..n {
            let at = (x + k % width).checked_sub(MARGIN).zip((y + k / width).checked_sub(MARGIN));
            let Some(p) = at else { continue };
            let Some(&group) = groups.get(p.0, p.1) else { continue };
            area.groups[k] = group;
            area.normals[k] = normals[p];
            area.variance[k] = variance[p];
            for half in 0..2 {
                area.halves[half][k] = halves[half][p];
                area.brightness[half][k] = halves[half][p].element_sum();
            }
        }
        area
    }

    /// The inner `w` × `h` pixels of one half, fitted by the likeness seen in the other.
    fn fit(&self, half: usize, w: usize, h: usize) -> Vec<Rgb> {
        let n = self.groups.len();
        let likeness: Vec<Likeness> =
            offsets().into_iter().map(|(dx, dy)| self.likeness(1 - half, dx, dy)).collect();
        let mut sums = Sums { values: vec![Rgb::ZERO; n], weights: vec![0.0; n] };
        let mut members = Vec::new();
        let first = MARGIN - REACH;
        // Centres lie on one grid over the picture: blocks begin at multiples of the spacing
        let on_grid = |at: usize| (at + SPACING * MARGIN - MARGIN).is_multiple_of(SPACING);
        for y in (first..MARGIN + h + REACH).filter(|&y| on_grid(y)) {
            for x in (first..MARGIN + w + REACH).filter(|&x| on_grid(x)) {
                let centre = y * self.width + x;
                if self.groups[centre] != 0 {
                    self.window(centre, half, &likeness, &mut members, |k, weight, value| {
                        sums.values[k] += weight * value;
                        sums.weights[k] += weight;
                    });
                }
            }
        }
        (0..w * h)
            .map(|k| {
                let k = (MARGIN + k / w) * self.width + MARGIN + k % w;
                if self.groups[k] == 0 {
                    return self.halves[half][k];
                }
                if sums.weights[k] >= LEAST_WEIGHT {
                    return sums.values[k] / sums.weights[k];
                }
                let mut own = Rgb::ZERO;
                self.window(k, half, &likeness, &mut members, |at, _, value| {
                    if at == k {
                        own = value;
                    }
                });
                own
            })
            .collect()
    }

    /// Fits the window around `centre` and tells `give` each member's weight and fitted value.
    fn window(
        &self,
        centre: usize,
        half: usize,
        likeness: &[Likeness],
        members: &mut Vec<Member>,
        mut give: impl FnMut(usize, f32, Rgb),
    ) {
        members.clear();
        let numbers = |k: usize, dx: isize, dy: isize| {
            let normal = self.normals[k] - self.normals[centre];
            let (x, y) = (dx as f32 / REACH as f32, dy as f32 / REACH as f32);
            [1.0, x, y, normal.x, normal.y, normal.z]
        };
        members.push((centre, 1.0, numbers(centre, 0, 0)));
        for &Likeness { dx, dy, step, ref of } in likeness {
            let dy = dy as isize;
            if of[centre] > LEAST_LIKENESS {
                members.push((centre + step, of[centre], numbers(centre + step, dx, dy)));
            }
            let back = centre - step;
            if of[back] > LEAST_LIKENESS {
                members.push((back, of[back], numbers(back, -dx, -dy)));
            }
        }
        let slopes = solve(members, &self.halves[half]);
        for &(k, weight, ref numbers) in members.iter() {
            let value = numbers.iter().zip(&slopes).map(|(&number, &slope)| number * slope).sum();
            give(k, weight, value);
        }
    }

    fn step(&self, dx: isize, dy: usize) -> usize {
        (dy * self.width).wrapping_add_signed(dx)
    }

    /// How alike the patches around pixel k and around the one at (dx, dy) from it are in one half.
    fn likeness(&self, half: usize, dx: isize, dy: usize) -> Likeness {
        let (n, width) = (self.groups.len(), self.width);
        let step = self.step(dx, dy);
        let (value, variance) = (&self.brightness[half], &self.variance);
        let mut distance = vec![0.0_f32; n];
        for k in 0..n - step {
            let both = variance[k] + variance[k + step];
            let apart = value[k] - value[k + step];
            distance[k] = (apart * apart - both) / (1e-12 + STRICTNESS * STRICTNESS * both);
        }
        // A pair counts if both are of one group; rows of the area do not run on into each other.
        let mut counts = vec![0.0_f32; n];
        for y in 0..self.height - dy {
            let columns = (-dx).max(0) as usize..width - dx.max(0) as usize;
            for k in columns.map(|x| y * width + x) {
                let group = self.groups[k];
                counts[k] = if group != 0 && group == self.groups[k + step] { 1.0 } else { 0.0 };
            }
        }
        for (distance, &counts) in distance.iter_mut().zip(&counts) {
            // Where nothing counts the distance may be anything, also infinite
            *distance = if counts > 0.0 { *distance } else { 0.0 };
        }
        let (sum, number) = (box_sum(&distance, width), box_sum(&counts, width));
        let mut of = vec![0.0; n];
        for k in 0..n {
            let mean = (sum[k] / number[k].max(1.0)).max(0.0);
            // Near to e^−x, and 0 from x = 5 on
            let left = (1.0 - 0.2 * mean).max(0.0);
            of[k] = counts[k] * (left * left) * (left * left);
        }
        Likeness { dx, dy, step, of }
    }
}

/// Likeness, 0…1, of every pixel k of an area with pixel k + `step`, which is (`dx`, `dy`) away.
struct Likeness {
    dx: isize,
    dy: usize,
    step: usize,
    of: Vec<f32>,
}

/// Weighted least squares of `values` over the members, by channel; ridge on all but the constant.
fn solve(members: &[Member], values: &[Rgb]) -> [Rgb; N_FIT] {
    let mut moments = [[0.0_f32; N_FIT]; N_FIT];
    let mut right = [Rgb::ZERO; N_FIT];
    for &(k, weight, ref numbers) in members {
        for i in 0..N_FIT {
            let weighted = weight * numbers[i];
            for j in 0..=i {
                moments[i][j] += weighted * numbers[j];
            }
            right[i] += weighted * values[k];
        }
    }
    let ridge = RIDGE * moments[0][0];
    for i in 1..N_FIT {
        moments[i][i] += ridge;
    }
    // Cholesky factor in place, then forward and back substitution
    for i in 0..N_FIT {
        for j in 0..=i {
            let known: f32 = (0..j).map(|p| moments[i][p] * moments[j][p]).sum();
            let rest = moments[i][j] - known;
            moments[i][j] =
                if i == j { rest.max(f32::MIN_POSITIVE).sqrt() } else { rest / moments[j][j] };
        }
    }
    for i in 0..N_FIT {
        let known: Rgb = (0..i).map(|p| moments[i][p] * right[p]).sum();
        right[i] = (right[i] - known) / moments[i][i];
    }
    for i in (0..N_FIT).rev() {
        let known: Rgb = (i + 1..N_FIT).map(|p| moments[p][i] * right[p]).sum();
        right[i] = (right[i] - known) / moments[i][i];
    }
    right
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
