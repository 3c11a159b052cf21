//! Where two edges of a checkerboard cross, to a hundredth of a pixel.
//!
//! Fits `I = (1 + g·q)(m + a·erf(d₁/√2s)·erf(d₂/√2s))` to the linear light round a corner, with d₁, d₂
//! the distances to two lines through it: corner, both angles, levels, blur and a light gradient.
//! The model is point-symmetric, so any symmetric blur (lens, pixel area, defocus) leaves the corner
//! where it is; in gamma-encoded numbers it would not. Pixels are weighted by their noise, fireflies out.

use nalgebra::{SMatrix, SVector};

use crate::Picture;
use crate::edge::{edge, weights};

/// corner x, y · angles of the lines · mean · amplitude · blur · gradient x, y.
const N: usize = 9;
type Parameters = SVector<f64, N>;

/// How far the window reaches along the board, in squares: neighbours' edges begin at 1.
const REACH: f64 = 0.7;
/// Longest reach, px: beyond, the lens bends lines and nothing is gained.
const LONGEST_PX: f64 = 15.0;

/// The corner near `start`; `along_x`, `along_y` are one square's steps (px).
///
/// `None` where the fit does not settle on a clear corner within 1.5 px of `start`.
pub(crate) fn refine(
    picture: &Picture,
    start: [f64; 2],
    along_x: [f64; 2],
    along_y: [f64; 2],
) -> Option<[f64; 2]> {
    const FURTHEST_PX: f64 = 1.5;
    const ROUNDS: usize = 3;
    let samples = window(picture, start, along_x, along_y)?;
    let high = samples.iter().map(|s| s.light).fold(f64::NEG_INFINITY, f64::max);
    let low = samples.iter().map(|s| s.light).fold(f64::INFINITY, f64::min);
    let sign = samples.iter().map(|s| s.quadrant * (s.light - 0.5 * (high + low))).sum::<f64>();
    let angle = |d: [f64; 2]| d[1].atan2(d[0]);
    let mut p = Parameters::from([
        0.0,
        0.0,
        angle(along_x),
        angle(along_y),
        0.5 * (high + low),
        0.5 * (high - low) * sign.signum(),
        0.6,
        0.0,
        0.0,
    ]);
    // Weights from the last fit's residuals; the first fit believes all pixels alike.
    let mut believed = vec![1.0; samples.len()];
    for _ in 0..ROUNDS {
        p = fit(&samples, &believed, p)?;
        let residuals: Vec<(f64, f64)> = samples.iter().map(|s| s.residual(&p)).collect();
        believed = weights(&residuals);
    }
    let total: f64 = believed.iter().sum();
    let squares: f64 =
        samples.iter().zip(&believed).map(|(s, w)| w * s.residual(&p).0.powi(2)).sum();
    let moved = p[0].hypot(p[1]);
    let contrast = (2.0 * p[5]).abs();
    let noise = (squares / total).sqrt();
    let clear = moved < FURTHEST_PX && contrast > 4.0 * noise;
    clear.then(|| [start[0] + p[0], start[1] + p[1]])
}

/// Levenberg–Marquardt with fixed weights.
fn fit(samples: &[Sample], believed: &[f64], start: Parameters) -> Option<Parameters> {
    let mut p = start;
    let (mut squares, mut normal, mut gradient) = linearise(samples, believed, &p);
    let mut damping = 1e-3;
    for _ in 0..30 {
        let mut damped = normal;
        for i in 0..N {
            damped[(i, i)] *= 1.0 + damping;
            damped[(i, i)] += 1e-12;
        }
        let step = damped.cholesky()?.solve(&gradient);
        let mut next = p + step;
        next[6] = next[6].clamp(0.1, 8.0);
        let (next_squares, next_normal, next_gradient) = linearise(samples, believed, &next);
        if next_squares <= squares {
            // A thousandth of a pixel is a tenth of what the best corners are known to.
            let small = step[0].hypot(step[1]) < 1e-3;
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

/// A pixel of the window, relative to the start.
struct Sample {
    at: [f64; 2],
    light: f64,
    /// +1 in two opposite squares, −1 in the others.
    quadrant: f64,
}

impl Sample {
    /// Seen − modelled, and the modelled share of white.
    fn residual(&self, p: &Parameters) -> (f64, f64) {
        let (x, y) = (self.at[0] - p[0], self.at[1] - p[1]);
        let ((s1, c1), (s2, c2)) = (p[2].sin_cos(), p[3].sin_cos());
        let crossed = edge(c1 * y - s1 * x, p[6]).0 * edge(c2 * y - s2 * x, p[6]).0;
        let light = 1.0 + p[7] * self.at[0] + p[8] * self.at[1];
        let white = 0.5 * (1.0 + p[5].signum() * crossed);
        (self.light - light * (p[4] + p[5] * crossed), white)
    }
}

/// Pixels inside the parallelogram of `REACH` squares; `None` if too few are in the picture.
fn window(
    picture: &Picture,
    start: [f64; 2],
    along_x: [f64; 2],
    along_y: [f64; 2],
) -> Option<Vec<Sample>> {
    let length = |d: [f64; 2]| d[0].hypot(d[1]);
    let limit = |d: [f64; 2]| REACH.min(LONGEST_PX / length(d));
    let (reach_x, reach_y) = (limit(along_x), limit(along_y));
    let determinant = along_x[0] * along_y[1] - along_x[1] * along_y[0];
    let half = [0, 1].map(|k| (reach_x * along_x[k]).abs() + (reach_y * along_y[k]).abs());
    if !(determinant.abs() > 1.0) || !half[0].is_finite() || !half[1].is_finite() {
        return None;
    }
    let range = |k: usize, end: usize| {
        let low = (start[k] - half[k]).ceil().max(0.0) as usize;
        let high = (start[k] + half[k]).floor().min(end as f64 - 1.0);
        low..(high.max(-1.0) + 1.0) as usize
    };
    let mut samples = vec![];
    for j in range(1, picture.height()) {
        for i in range(0, picture.width()) {
            let at = [i as f64 - start[0], j as f64 - start[1]];
            let a = (at[0] * along_y[1] - at[1] * along_y[0]) / determinant;
            let b = (along_x[0] * at[1] - along_x[1] * at[0]) / determinant;
            if a.abs() <= reach_x && b.abs() <= reach_y {
                let light = f64::from(picture.luma()[j * picture.width() + i]);
                samples.push(Sample { at, light, quadrant: (a * b).signum() });
            }
        }
    }
    (samples.len() >= 4 * N).then_some(samples)
}

fn linearise(
    samples: &[Sample],
    believed: &[f64],
    p: &Parameters,
) -> (f64, SMatrix<f64, N, N>, Parameters) {
    let (mut squares, mut gradient) = (0.0, Parameters::zeros());
    let mut normal = SMatrix::<f64, N, N>::zeros();
    let (s1, c1) = p[2].sin_cos();
    let (s2, c2) = p[3].sin_cos();
    let [mean, amplitude, blur] = [p[4], p[5], p[6]];
    for (sample, &weight) in samples.iter().zip(believed) {
        let (x, y) = (sample.at[0] - p[0], sample.at[1] - p[1]);
        let (d1, d2) = (c1 * y - s1 * x, c2 * y - s2 * x);
        let (e1, slope1, swell1) = edge(d1, blur);
        let (e2, slope2, swell2) = edge(d2, blur);
        let light = 1.0 + p[7] * sample.at[0] + p[8] * sample.at[1];
        let pattern = mean + amplitude * e1 * e2;
        let (by_d1, by_d2) = (light * amplitude * slope1 * e2, light * amplitude * e1 * slope2);
        let row = Parameters::from([
            by_d1 * s1 + by_d2 * s2,
            -by_d1 * c1 - by_d2 * c2,
            by_d1 * (-s1 * y - c1 * x),
            by_d2 * (-s2 * y - c2 * x),
            light,
            light * e1 * e2,
            light * amplitude * (swell1 * e2 + e1 * swell2),
            pattern * sample.at[0],
            pattern * sample.at[1],
        ]);
        let residual = sample.light - light * pattern;
        squares += weight * residual * residual;
        normal += row * (row * weight).transpose();
        gradient += row * (weight * residual);
    }
    (squares, normal, gradient)
}
