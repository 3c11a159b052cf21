//! One edge of a square, fitted to the pixels on both sides of it.
//!
//! `I = lo(s) + (hi(s) − lo(s))·(1 + E(d))/2` with E the blurred edge of `edge.rs`, levels straight lines
//! along the side, and the edge's own place straight too: seven numbers from some hundred pixels,
//! weighted by their noise. Pixels at the clip level only say "at least this bright".

use nalgebra::{SMatrix, SVector};

use crate::Picture;
use crate::edge::{edge, weights};
use crate::edge_lines::{Flattening, Line, Side, apply, on_side};

/// Place at the start and end of the side · black there · white there · blur.
const N: usize = 7;
type Parameters = SVector<f64, N>;

/// Light from which a sample counts as clipped.
const CLIP: f64 = 0.998;
/// Neighbouring pixels of a compressed photograph share their errors: variances grow by this
/// (measured on noisy JPEGs: 1.4 to 3).
const SHARED: f64 = 3.0;

struct Sample {
    /// 0…1 along the side.
    along: f64,
    /// Outward from the old line, px.
    off: f64,
    light: f64,
}

/// Fits side `k` of the square given by `homography` (unit square to flat picture).
pub(crate) fn measure(
    picture: &Picture,
    map: &Flattening,
    homography: &[f64; 9],
    k: usize,
    cells: f64,
    blur: f64,
) -> Option<Side> {
    const FURTHEST_PX: f64 = 1.0;
    const ROUNDS: usize = 4;
    let place = |along: f64, depth: f64| {
        let (s, t) = on_side(k, along, depth);
        apply(homography, s, t)
    };
    let (a, b) = (place(0.0, 0.0), place(1.0, 0.0));
    let length = (b[0] - a[0]).hypot(b[1] - a[1]);
    let along = [(b[0] - a[0]) / length, (b[1] - a[1]) / length];
    // Corners run clockwise: outward is to the left of the way.
    let normal = [along[1], -along[0]];
    let samples = gather(picture, map, &place, a, along, normal, length, cells, blur)?;

    let mean = |keep: &dyn Fn(f64) -> bool| {
        let all: Vec<f64> = samples.iter().filter(|s| keep(s.off)).map(|s| s.light).collect();
        all.iter().sum::<f64>() / all.len().max(1) as f64
    };
    let (black, white) = (mean(&|d| d < -1.0), mean(&|d| d > 1.0));
    let mut p = Parameters::from([0.0, 0.0, black, black, white, white, blur.max(0.3)]);
    let mut believed = vec![1.0; samples.len()];
    for _ in 0..ROUNDS {
        p = fit(&samples, &believed, p)?;
        let residuals: Vec<(f64, f64)> = samples.iter().map(|s| s.residual(&p)).collect();
        believed = weights(&residuals);
    }
    let (_, normal_matrix, _) = linearise(&samples, &believed, &p);
    let covariance = normal_matrix.try_inverse()?;
    let end_variance = SHARED * 0.5 * (covariance[(0, 0)] + covariance[(1, 1)]);
    if !(p[0].abs() < FURTHEST_PX && p[1].abs() < FURTHEST_PX && end_variance.is_finite()) {
        return None;
    }
    let shifted = |at: [f64; 2], by: f64| [at[0] + by * normal[0], at[1] + by * normal[1]];
    let (a, b) = (shifted(a, p[0]), shifted(b, p[1]));
    let length = (b[0] - a[0]).hypot(b[1] - a[1]);
    let whites: Vec<bool> =
        samples.iter().filter(|s| s.off > 1.0).map(|s| s.light >= CLIP).collect();
    let clipped = whites.iter().filter(|c| **c).count() as f64 / whites.len().max(1) as f64;
    Some(Side {
        line: Line { at: a, along: [(b[0] - a[0]) / length, (b[1] - a[1]) / length] },
        blur: (p[6] * p[6] + 1.0 / 12.0).sqrt(),
        end_variance,
        clipped_white: clipped,
    })
}

/// Pixels within the strip: not nearer to other cells than their blur reaches.
#[expect(clippy::too_many_arguments, reason = "one call; the side is its own small frame")]
fn gather(
    picture: &Picture,
    map: &Flattening,
    place: &dyn Fn(f64, f64) -> [f64; 2],
    a: [f64; 2],
    along: [f64; 2],
    normal: [f64; 2],
    length: f64,
    cells: f64,
    blur: f64,
) -> Option<Vec<Sample>> {
    const MARGIN: f64 = 0.08;
    const LONGEST_HALF_PX: f64 = 6.0;
    let depth = |at: f64| {
        let inner = place(at, 1.0 / cells);
        ((inner[0] - a[0]) * normal[0] + (inner[1] - a[1]) * normal[1]).abs()
    };
    let (first, last) = (depth(0.0), depth(1.0));
    // The picture's box round the side, from its ends and middle.
    let mut low = [f64::INFINITY; 2];
    let mut high = [f64::NEG_INFINITY; 2];
    for s in [0.0, 0.25, 0.5, 0.75, 1.0] {
        let pixel = map.pixel([a[0] + s * length * along[0], a[1] + s * length * along[1]])?;
        for i in 0..2 {
            low[i] = low[i].min(pixel[i] - LONGEST_HALF_PX - 2.0);
            high[i] = high[i].max(pixel[i] + LONGEST_HALF_PX + 2.0);
        }
    }
    let range = |i: usize, end: usize| {
        let from = low[i].max(0.0) as usize;
        from..(high[i].max(0.0) as usize).min(end.saturating_sub(1)) + 1
    };
    let mut samples = vec![];
    for y in range(1, picture.height()) {
        for x in range(0, picture.width()) {
            let Some(flat) = map.flat([x as f64, y as f64]) else { continue };
            let (dx, dy) = (flat[0] - a[0], flat[1] - a[1]);
            let s = (dx * along[0] + dy * along[1]) / length;
            let off = dx * normal[0] + dy * normal[1];
            let half = LONGEST_HALF_PX.min(first + (last - first) * s - 2.2 * blur);
            if (MARGIN..=1.0 - MARGIN).contains(&s) && off.abs() <= half {
                let light = f64::from(picture.luma()[y * picture.width() + x]);
                samples.push(Sample { along: s, off, light });
            }
        }
    }
    (samples.len() >= 8 * N).then_some(samples)
}

impl Sample {
    /// Black, white, and the edge with its derivatives by distance and blur.
    fn model(&self, p: &Parameters) -> (f64, f64, (f64, f64, f64)) {
        let mix = |from: f64, to: f64| from + (to - from) * self.along;
        let at = self.off - mix(p[0], p[1]);
        (mix(p[2], p[3]), mix(p[4], p[5]), edge(at, p[6]))
    }

    /// Seen − modelled, and the modelled share of white. Clipped pixels agree with all that is brighter.
    fn residual(&self, p: &Parameters) -> (f64, f64) {
        let (black, white, (e, _, _)) = self.model(p);
        let share = 0.5 * (1.0 + e);
        let modelled = black + (white - black) * share;
        if self.light >= CLIP && modelled >= CLIP {
            return (0.0, share);
        }
        (self.light - modelled, share)
    }
}

fn linearise(
    samples: &[Sample],
    believed: &[f64],
    p: &Parameters,
) -> (f64, SMatrix<f64, N, N>, Parameters) {
    let (mut squares, mut gradient) = (0.0, Parameters::zeros());
    let mut normal = SMatrix::<f64, N, N>::zeros();
    for (sample, &weight) in samples.iter().zip(believed) {
        let (residual, share) = sample.residual(p);
        if residual == 0.0 {
            continue;
        }
        let (black, white, (_, by_d, by_blur)) = sample.model(p);
        let swing = 0.5 * (white - black);
        let s = sample.along;
        let row = Parameters::from([
            -swing * by_d * (1.0 - s),
            -swing * by_d * s,
            (1.0 - share) * (1.0 - s),
            (1.0 - share) * s,
            share * (1.0 - s),
            share * s,
            swing * by_blur,
        ]);
        squares += weight * residual * residual;
        normal += row * (row * weight).transpose();
        gradient += row * (weight * residual);
    }
    (squares, normal, gradient)
}

/// Levenberg–Marquardt with fixed weights.
fn fit(samples: &[Sample], believed: &[f64], start: Parameters) -> Option<Parameters> {
    let mut p = start;
    let (mut squares, mut normal, mut gradient) = linearise(samples, believed, &p);
    let mut damping = 1e-3;
    for _ in 0..30 {
        let mut damped = normal;
        for i in 0..N {
            damped[(i, i)] = damped[(i, i)] * (1.0 + damping) + 1e-9;
        }
        let step = damped.cholesky()?.solve(&gradient);
        let mut next = p + step;
        next[6] = next[6].clamp(0.1, 6.0);
        let (next_squares, next_normal, next_gradient) = linearise(samples, believed, &next);
        if next_squares <= squares {
            let small = step[0].abs().max(step[1].abs()) < 1e-4;
            (p, squares, normal, gradient) = (next, next_squares, next_normal, next_gradient);
            damping *= 0.2;
            if small {
                break;
            }
        } else {
            damping *= 10.0;
            if damping > 1e8 {
                break;
            }
        }
    }
    Some(p)
}
