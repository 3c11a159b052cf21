//! Where two edges of a checkerboard cross, to a hundredth of a pixel.
//!
//! Fits `I = (1 + g·q)(m + a·erf(d₁/√2s)·erf(d₂/√2s))` to the linear light round a corner, with d₁, d₂
//! the distances to two lines through it: corner, both angles, levels, blur and a light gradient.
//! The model is point-symmetric, so any symmetric blur (lens, pixel area, defocus) leaves the corner
//! where it is; in gamma-encoded numbers it would not.

use nalgebra::{SMatrix, SVector};

use crate::Picture;

/// corner x, y · angles of the lines · mean · amplitude · blur · gradient x, y.
const N: usize = 9;
type Parameters = SVector<f64, N>;

/// How far the window reaches along the board, in squares: neighbours' edges begin at 1.
const REACH: f64 = 0.7;
/// Longest reach, px: beyond, the lens bends lines and nothing is gained.
const LONGEST_PX: f64 = 22.0;

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
    let (mut squares, mut normal, mut gradient) = linearise(&samples, &p);
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
        let (next_squares, next_normal, next_gradient) = linearise(&samples, &next);
        if next_squares <= squares {
            let small = step[0].hypot(step[1]) < 1e-5;
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
    let moved = p[0].hypot(p[1]);
    let contrast = (2.0 * p[5]).abs();
    let noise = (squares / samples.len() as f64).sqrt();
    let clear = moved < FURTHEST_PX && contrast > 4.0 * noise;
    clear.then(|| [start[0] + p[0], start[1] + p[1]])
}

/// A pixel of the window, relative to the start.
struct Sample {
    at: [f64; 2],
    light: f64,
    /// +1 in two opposite squares, −1 in the others.
    quadrant: f64,
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

fn linearise(samples: &[Sample], p: &Parameters) -> (f64, SMatrix<f64, N, N>, Parameters) {
    let (mut squares, mut gradient) = (0.0, Parameters::zeros());
    let mut normal = SMatrix::<f64, N, N>::zeros();
    let (s1, c1) = p[2].sin_cos();
    let (s2, c2) = p[3].sin_cos();
    let [mean, amplitude, blur] = [p[4], p[5], p[6]];
    for sample in samples {
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
        squares += residual * residual;
        normal.ger(1.0, &row, &row, 1.0);
        gradient += row * residual;
    }
    (squares, normal, gradient)
}

/// An edge at distance d, blurred by s and by the pixel's area: value −1…1, derivatives by d and s.
///
/// The pixel is a box 1 px wide along the edge's normal: exact for edges along rows and columns, and of
/// the right variance for all. Without it a sharp edge lands up to 0.15 px off.
fn edge(d: f64, s: f64) -> (f64, f64, f64) {
    let (before, after) = (Smooth::at(d - 0.5, s), Smooth::at(d + 0.5, s));
    (after.integral - before.integral, after.erf - before.erf, after.bell - before.bell)
}

/// erf(d/√2s), its integral over d, and that integral's derivative by s.
struct Smooth {
    erf: f64,
    integral: f64,
    bell: f64,
}

impl Smooth {
    fn at(d: f64, s: f64) -> Self {
        let x = d / s;
        let gauss = (-0.5 * x * x).exp();
        // Abramowitz & Stegun 7.1.26, error below 1.5e-7.
        let t = 1.0 / (1.0 + 0.327_591_1 * x.abs() * std::f64::consts::FRAC_1_SQRT_2);
        let poly = t
            * (0.254_829_592
                + t * (-0.284_496_736
                    + t * (1.421_413_741 + t * (-1.453_152_027 + t * 1.061_405_429))));
        let erf = (1.0 - poly * gauss) * x.signum();
        let bell = (2.0 / std::f64::consts::PI).sqrt() * gauss;
        Self { erf, integral: d * erf + s * bell, bell }
    }
}
