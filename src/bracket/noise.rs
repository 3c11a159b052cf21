//! The camera's noise, read from the bracket itself.
//!
//! Model (methods-capture C3): a linear value y (white = 1) has variance y/FW + (RN/FW)² + step²/12,
//! with full well FW and read noise RN in electrons at white of one exposure, and the file's
//! quantisation step at y. Two frames of one place differ by noise only, whatever the texture, so
//! FW comes from the squared differences in bright pixels and RN from those in dark ones. In JPEGs
//! both take in what the compression adds, so FW is lower than the sensor's; what all frames share
//! (chroma subsampling, a lens's glare) no difference shows, and σ does not contain it.

/// Noise of a camera at one setting.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    /// Electrons at linear value 1.
    pub full_well_e: f64,
    /// Standard deviation of the read-out, electrons.
    pub read_noise_e: f64,
    /// False if the bracket did not show it and a typical camera is assumed.
    pub measured: bool,
}

impl Noise {
    /// A middling camera: what is assumed when nothing can be measured.
    pub const TYPICAL: Self = Self { full_well_e: 20_000.0, read_noise_e: 5.0, measured: false };

    /// Variance of a linear value `y` from photons and read-out, without quantisation.
    pub fn variance(&self, y: f64) -> f64 {
        y.max(0.0) / self.full_well_e + (self.read_noise_e / self.full_well_e).powi(2)
    }
}

/// The same place in two frames.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pair {
    /// Squared difference of the two radiances.
    pub squared: f64,
    /// Best guess of the radiance there, mostly from the longer frame.
    pub radiance: f64,
    /// Exposures of both frames.
    pub exposures: [f64; 2],
    /// Variance of quantisation of both together, in radiance.
    pub quantisation: f64,
}

impl Pair {
    /// Variance of the difference under `noise`.
    fn variance(&self, noise: &Noise) -> f64 {
        let of = |t: f64| noise.variance(self.radiance * t) / (t * t);
        of(self.exposures[0]) + of(self.exposures[1]) + self.quantisation
    }

    /// Linear value in the shorter frame, which has most of the noise.
    fn value(&self) -> f64 {
        self.radiance * self.exposures[0].min(self.exposures[1])
    }
}

/// Share of the pairs that one σ shall cover. Not the median: what JPEG does near edges has long
/// tails, and a σ that fits the middle covers 43 % of the merged truth-scene ball instead of 68 %.
const ONE_SIGMA: f64 = 0.682_689;
/// Pairs needed for that quantile to be good to about 2 %.
const MIN_PAIRS: usize = 4000;

/// Full well and read noise that make the scatter of `pairs` as likely as not.
pub(super) fn measure(pairs: &[Pair]) -> Option<Noise> {
    let bright: Vec<&Pair> = pairs.iter().filter(|p| (0.08..0.9).contains(&p.value())).collect();
    let dark: Vec<&Pair> = pairs.iter().filter(|p| (0.002..0.02).contains(&p.value())).collect();
    if bright.len() < MIN_PAIRS {
        return None;
    }
    let mut noise = Noise { measured: true, ..Noise::TYPICAL };
    // Each depends a little on the other; three rounds settle to well below the quantile's own error.
    for _ in 0..3 {
        noise.full_well_e = solve(100.0, 1e6, |full_well_e| {
            // The read noise stays what it is as a share of white.
            let read_noise_e = noise.read_noise_e / noise.full_well_e * full_well_e;
            scatter(&bright, &Noise { full_well_e, read_noise_e, ..noise })
        });
        if dark.len() >= MIN_PAIRS {
            noise.read_noise_e = solve(1e-2, 0.05 * noise.full_well_e, |read_noise_e| {
                -scatter(&dark, &Noise { read_noise_e, ..noise })
            });
        }
    }
    Some(noise)
}

/// Quantile [`ONE_SIGMA`] of squared difference over predicted variance, less 1: rises with FW.
fn scatter(pairs: &[&Pair], noise: &Noise) -> f64 {
    let mut ratios: Vec<f64> = pairs.iter().map(|p| p.squared / p.variance(noise)).collect();
    let at = (ONE_SIGMA * ratios.len() as f64) as usize;
    *ratios.select_nth_unstable_by(at, f64::total_cmp).1 - 1.0
}

/// Where a rising function crosses zero between `low` and `high`, in logarithmic steps.
fn solve(mut low: f64, mut high: f64, rising: impl Fn(f64) -> f64) -> f64 {
    for _ in 0..24 {
        let middle = (low * high).sqrt();
        if rising(middle) < 0.0 { low = middle } else { high = middle }
    }
    (low * high).sqrt()
}
