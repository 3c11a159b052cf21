//! What pixels near a straight edge show, and how far each is to be believed.

/// An edge at distance `d`, blurred by `s` and by the pixel's area: value −1…1, derivatives by d and s.
///
/// The pixel is a box 1 px wide along the edge's normal: exact for edges along rows and columns, and of
/// the right variance for all. Without it a sharp edge lands up to 0.15 px off.
pub(crate) fn edge(d: f64, s: f64) -> (f64, f64, f64) {
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

/// Weights 1/σ² with Tukey's biweight for samples (residual, share of white 0…1).
///
/// Noise grows with light, and on the edge itself the blur's true shape tells: black, white and the edge
/// have a σ each, taken from their own residuals; a firefly or a speck of dirt beyond 4.685 σ has no say.
pub(crate) fn weights(samples: &[(f64, f64)]) -> Vec<f64> {
    /// No picture is cleaner than its last bit.
    const LEAST_SIGMA: f64 = 1e-3;
    /// Shares of white that count as black, and as white.
    const BLACK: f64 = 0.08;
    const WHITE: f64 = 0.92;
    let sigma = |keep: &dyn Fn(f64) -> bool| {
        let mut sizes: Vec<f64> =
            samples.iter().filter(|(_, white)| keep(*white)).map(|(r, _)| r.abs()).collect();
        sizes.sort_by(f64::total_cmp);
        sizes.get(sizes.len() / 2).map_or(LEAST_SIGMA, |m| (1.4826 * m).max(LEAST_SIGMA))
    };
    let dark = sigma(&|w| w < BLACK);
    let bright = sigma(&|w| w > WHITE);
    let between = sigma(&|w| (BLACK..=WHITE).contains(&w)).max(0.5 * (dark + bright));
    samples
        .iter()
        .map(|(residual, white)| {
            let sigma = match *white {
                w if w < BLACK => dark,
                w if w > WHITE => bright,
                _ => between,
            };
            let x = (residual / (4.685 * sigma)).powi(2);
            if x < 1.0 { ((1.0 - x) / sigma).powi(2) } else { 0.0 }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sharp_edge_is_the_pixels_share() {
        // Edge at 0.25 from the pixel's centre: three quarters white, value 2·0.75 − 1.
        assert!((edge(0.25, 1e-3).0 - 0.5).abs() < 1e-3);
        assert!((edge(3.0, 0.5).0 - 1.0).abs() < 1e-4);
        let h = 1e-6;
        let (_, by_d, by_s) = edge(0.4, 0.7);
        assert!((by_d - (edge(0.4 + h, 0.7).0 - edge(0.4 - h, 0.7).0) / (2.0 * h)).abs() < 1e-5);
        // The series for erf is exact to 1.5e-7 only, which 2h does not forgive.
        let wide = 1e-3;
        let slope = (edge(0.4, 0.7 + wide).0 - edge(0.4, 0.7 - wide).0) / (2.0 * wide);
        assert!((by_s - slope).abs() < 1e-3);
    }

    #[test]
    fn a_firefly_has_no_say() {
        let mut samples: Vec<(f64, f64)> =
            (0..40).map(|i| (0.01 * ((i * 7 % 11) as f64 - 5.0), (i % 2) as f64)).collect();
        samples.push((3.0, 1.0));
        let all = weights(&samples);
        assert_eq!(all[40], 0.0);
        assert!(all[..40].iter().all(|w| *w > 0.0));
    }
}
