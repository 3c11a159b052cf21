//! What a tile of pixels has gathered: means over replicates and how they scatter.
//!
//! A replicate is n = 2^k stratified samples with randomisation of its own; only the scatter of whole
//! replicates says how wrong the mean is (the sample variance under Sobol numbers is too high by up to
//! ×2, methods-render R7.3). The ratio ΔE/E₀ is a quotient of two means over the same samples: its
//! first-order bias is taken off and its error propagated with their covariance.

use glam::{BVec3, Vec3};

use super::surface::Colouring;
use crate::conventions::{Rgb, luminance};

/// One camera sample, or the mean of some.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sample {
    /// Share of object samples.
    pub coverage: f32,
    /// Radiance of object samples, premultiplied.
    pub object: Rgb,
    /// Share of samples on local surfaces, and of those whose albedo is solved from the plate.
    pub local: f32,
    pub plate: f32,
    /// (with − without) and without on local surfaces, in units that cancel in their quotient.
    pub delta: Rgb,
    pub without: Rgb,
    /// (with − without) of local surfaces that bring their own albedo or material, absolute.
    pub own: Rgb,
}

/// (with − without) and without, of one look at a local point.
#[derive(Clone, Copy, Debug, Default)]
pub struct Pair {
    pub delta: Rgb,
    pub without: Rgb,
}

impl Sample {
    /// A sample that met a local surface first; `mean` is the surface's mean albedo.
    pub fn background(colour: Colouring, mean: Rgb, pair: Pair) -> Self {
        // One scale for all surfaces of a pixel, so that its quotient weighs them by their light.
        let (scale, own, plate) = match colour {
            Colouring::Plate => (mean, Rgb::ZERO, 1.0),
            Colouring::Matt(albedo) => (albedo, albedo * pair.delta, 0.0),
            Colouring::Own => (Rgb::ONE, pair.delta, 0.0),
        };
        let scale = scale.max(Rgb::splat(1e-3));
        Self {
            local: 1.0,
            plate,
            delta: pair.delta * scale,
            without: pair.without * scale,
            own,
            ..Self::default()
        }
    }
}

impl std::ops::Add for Sample {
    type Output = Self;

    fn add(mut self, other: Self) -> Self {
        self += other;
        self
    }
}

impl std::ops::AddAssign for Sample {
    fn add_assign(&mut self, s: Self) {
        self.coverage += s.coverage;
        self.object += s.object;
        self.local += s.local;
        self.plate += s.plate;
        self.delta += s.delta;
        self.without += s.without;
        self.own += s.own;
    }
}

impl std::ops::Mul<f32> for Sample {
    type Output = Self;

    fn mul(self, k: f32) -> Self {
        Self {
            coverage: self.coverage * k,
            object: self.object * k,
            local: self.local * k,
            plate: self.plate * k,
            delta: self.delta * k,
            without: self.without * k,
            own: self.own * k,
        }
    }
}

/// L_without, brought to the mean albedo, is taken for at least this share of the plate: a few
/// unlucky samples in a penumbra can leave it near zero, and the quotient would be anything.
const LEAST_WITHOUT: f32 = 0.05;
/// Largest correction of the quotient's bias, relative to the quotient.
const LARGEST_CORRECTION: f32 = 0.25;

/// Sums over the replicates of one pixel.
#[derive(Clone, Copy, Debug, Default)]
pub struct Pixel {
    sum: Sample,
    /// Of every second replicate, beginning with the first.
    even: Sample,
    replicates: u32,
    /// Second moments of u = object + own, a = delta, b = without.
    uu: Vec3,
    aa: Vec3,
    bb: Vec3,
    ua: Vec3,
    ub: Vec3,
    ab: Vec3,
}

/// What a pixel has come to.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Estimate {
    pub coverage: f32,
    pub object: Rgb,
    pub difference: Rgb,
    pub ratio: Rgb,
    /// Variance of `object + difference`.
    pub variance: Rgb,
}

impl Pixel {
    /// Weighted sum of neighbours with the same number of replicates.
    pub fn blend<'a>(parts: impl Iterator<Item = (f32, &'a Pixel)>) -> Self {
        let mut out = Self::default();
        for (weight, part) in parts {
            out.sum += part.sum * weight;
            out.even += part.even * weight;
            out.replicates = part.replicates;
            out.uu += part.uu * weight;
            out.aa += part.aa * weight;
            out.bb += part.bb * weight;
            out.ua += part.ua * weight;
            out.ub += part.ub * weight;
            out.ab += part.ab * weight;
        }
        out
    }

    /// Adds the mean of one replicate.
    pub fn add(&mut self, replicate: Sample) {
        let (u, a, b) = (replicate.object + replicate.own, replicate.delta, replicate.without);
        if self.replicates.is_multiple_of(2) {
            self.even += replicate;
        }
        self.replicates += 1;
        self.sum += replicate;
        self.uu += u * u;
        self.aa += a * a;
        self.bb += b * b;
        self.ua += u * a;
        self.ub += u * b;
        self.ab += a * b;
    }

    /// The estimate from `replicates` of them over a pixel whose plate value is `plate`.
    ///
    /// Where a channel has next to no light without objects (below `dark`), the quotient is
    /// meaningless: the ratio is 0 there, and the difference is that of the surface's mean albedo.
    pub fn estimate(&self, replicates: u32, plate: Rgb, dark: f32) -> Estimate {
        if replicates == 0 {
            return Estimate::default();
        }
        let n = replicates as f32;
        let mean = self.sum * (1.0 / n);
        let (lit, base) = base(&mean, plate, dark);
        let moment = |sum: Vec3, x: Vec3, y: Vec3| {
            if replicates > 1 { (sum / n - x * y) * (n / (n - 1.0)) } else { Vec3::ZERO }
        };
        let u = mean.object + mean.own;
        let (a, b) = (mean.delta, mean.without);
        let var_b = moment(self.bb, b, b);
        let cov_ab = moment(self.ab, a, b);
        let quotient = a / base;
        // Two replicates know their scatter badly: the correction may not rule the value.
        let most = LARGEST_CORRECTION * quotient.abs();
        let bias = ((quotient * var_b - cov_ab) / (base * base * n)).clamp(-most, most);
        let unbiased = quotient - bias;
        let ratio = Vec3::select(lit, unbiased * mean.local, Vec3::ZERO);
        let of_plate = if mean.local > 0.0 { mean.plate / mean.local } else { 0.0 };
        let by_plate = Vec3::select(lit, plate * ratio, mean.delta) * of_plate;
        let difference = mean.own + by_plate;

        // Linearised: u + k (a − q b), k = what the plate makes of one unit of delta
        let k = Vec3::select(lit, plate * mean.local / base, Vec3::ONE) * of_plate;
        let q = Vec3::select(lit, quotient, Vec3::ZERO);
        let variance = moment(self.uu, u, u)
            + 2.0 * k * (moment(self.ua, u, a) - q * moment(self.ub, u, b))
            + k * k * (moment(self.aa, a, a) - 2.0 * q * cov_ab + q * q * var_b);
        Estimate {
            coverage: mean.coverage,
            object: mean.object,
            difference,
            ratio,
            variance: (variance / n).max(Vec3::ZERO),
        }
    }
}

/// Which channels have light without objects, and what the difference is divided by.
fn base(mean: &Sample, plate: Rgb, dark: f32) -> (BVec3, Rgb) {
    let lit = mean.without.cmpgt(Vec3::splat(dark));
    let floor = plate * LEAST_WITHOUT;
    (lit, Vec3::select(lit, mean.without.max(floor), Vec3::ONE))
}

/// What a denoiser reads of a pixel: two independent halves, not premultiplied.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Halves {
    /// ΔE/E₀ of local surfaces.
    pub ratio: Option<[Rgb; 2]>,
    /// Radiance of objects.
    pub object: Option<[Rgb; 2]>,
    /// What one unit of either is worth in the finished pixel, by its brightness.
    pub ratio_mass: f32,
    pub object_mass: f32,
    /// They lie between those of sampled pixels.
    pub between: bool,
}

/// What a denoiser made of one of the [`Halves`]: how far it moved their mean, and the variance of what
/// it came to.
pub type Refined = Option<(Rgb, Rgb)>;

impl Pixel {
    /// The halves of `replicates`; nothing where a half would be a single replicate, or where the
    /// pixel shows surfaces of both known and unknown albedo.
    pub fn halves(&self, plate: Rgb, dark: f32) -> Halves {
        if self.replicates < 4 {
            return Halves::default();
        }
        let halves = self.half_means();
        let mean = self.sum * (1.0 / self.replicates as f32);
        let (lit, base) = base(&mean, plate, dark);
        let one_kind = mean.plate == 0.0 || mean.plate == mean.local;
        let quotient = |half: Sample| Vec3::select(lit, half.delta / base, Vec3::ZERO);
        let covered = halves.iter().all(|half| half.coverage > 0.0);
        Halves {
            ratio: (mean.local > 0.0 && one_kind).then(|| halves.map(quotient)),
            object: covered.then(|| halves.map(|half| half.object / half.coverage)),
            ratio_mass: luminance(if mean.plate > 0.0 { plate * mean.local } else { base }),
            object_mass: mean.coverage,
            between: false,
        }
    }

    /// Means of the even and the odd replicates; there must be two at least.
    fn half_means(&self) -> [Sample; 2] {
        let n_even = self.replicates.div_ceil(2) as f32;
        let odd = self.sum + self.even * -1.0;
        [self.even * (1.0 / n_even), odd * (1.0 / (self.replicates as f32 - n_even))]
    }

    /// `estimate` with what a denoiser made of the halves in place of the samples' own means.
    pub fn refined(
        &self,
        estimate: &Estimate,
        plate: Rgb,
        dark: f32,
        ratio: Refined,
        object: Refined,
    ) -> Estimate {
        let mut out = *estimate;
        let mean = self.sum * (1.0 / self.replicates.max(1) as f32);
        let (lit, base) = base(&mean, plate, dark);
        let whole =
            (ratio.is_some() || mean.local == 0.0) && (object.is_some() || mean.coverage == 0.0);
        if whole {
            out.variance = Rgb::ZERO;
        }
        let mut reflected = Rgb::ZERO;
        if let Some((moved, variance)) = ratio {
            // What one unit of the quotient makes of the pixel
            let unit = if mean.plate > 0.0 { plate * mean.local } else { base };
            // The denoiser moved the mean of the halves. The samples' own is another where one half
            // has a replicate more, and its bias was corrected: a find that the denoiser took out
            // would leave its share of both.
            let [even, odd] = self.half_means();
            let (of_samples, of_halves) =
                (mean.delta / base, 0.5 * (even.delta + odd.delta) / base);
            let refined = of_halves + moved;
            let bias = of_samples - estimate.ratio / mean.local;
            let most = LARGEST_CORRECTION * refined.abs();
            let moved = refined - bias.clamp(-most, most) - (of_samples - bias);
            let moved = Vec3::select(lit, moved, Vec3::ZERO);
            out.ratio += moved * mean.local;
            out.difference += unit * moved;
            reflected = out.difference / mean.local.max(f32::MIN_POSITIVE);
            if whole {
                out.variance += Vec3::select(lit, unit * unit * variance, estimate.variance);
            }
        }
        if let Some((moved, variance)) = object {
            let [even, odd] = self.half_means().map(|half| half.object / half.coverage);
            out.object = (0.5 * (even + odd) + moved) * mean.coverage;
            let value = out.object / mean.coverage;
            if whole {
                // The denoiser knows nothing of how well the outline is known.
                let [even, odd] = self.half_means();
                let outline = 0.25 * (even.coverage - odd.coverage).powi(2);
                out.variance += mean.coverage * mean.coverage * variance
                    + (value - reflected).powf(2.0) * outline;
            }
        }
        out
    }
}

/// Relative error measure of one pixel.
#[derive(Clone, Copy, Debug, Default)]
pub struct Noise {
    /// Variance of the finished pixel relative to its brightness, squared.
    pub relative_variance: f64,
    /// How much the objects change the pixel, relative to its brightness.
    pub change: f64,
    pub coverage: f64,
}

impl Estimate {
    /// Error and change relative to the brighter of plate and finished pixel, at least `floor`.
    pub fn noise(&self, plate: Rgb, floor: f32) -> Noise {
        let before = luminance(plate);
        let after = luminance(self.object + plate * (1.0 - self.coverage) + self.difference);
        let reference = f64::from(before.max(after).max(floor));
        // Channels of one path are strongly correlated: their standard deviations add.
        let sigma = f64::from(luminance(self.variance.map(f32::sqrt)));
        Noise {
            relative_variance: (sigma / reference).powi(2),
            change: f64::from((after - before).abs()) / reference,
            coverage: f64::from(self.coverage),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::sampler::{Numbers, Purpose, Sampler};

    #[test]
    fn nothing_gathered_is_nothing() {
        assert_eq!(Pixel::default().estimate(0, Rgb::ONE, 1e-6), Estimate::default());
        let mut pixel = Pixel::default();
        for _ in 0..4 {
            pixel.add(Sample { local: 1.0, plate: 1.0, without: Rgb::ONE, ..Sample::default() });
        }
        assert_eq!(pixel.estimate(4, Rgb::ONE, 1e-6), Estimate::default(), "bit-exact zero");
    }

    #[test]
    fn darkness_gives_no_quotient() {
        let mut pixel = Pixel::default();
        pixel.add(Sample {
            local: 1.0,
            plate: 1.0,
            delta: Rgb::ONE,
            without: Rgb::new(0.0, 1.0, 1e-12),
            ..Sample::default()
        });
        let e = pixel.estimate(1, Rgb::ONE, 1e-6);
        assert_eq!(e.ratio, Rgb::new(0.0, 1.0, 0.0));
        assert!(e.variance.is_finite());
    }

    #[test]
    fn an_unlucky_base_cannot_make_a_firefly() {
        let mut pixel = Pixel::default();
        for without in [1.0, -0.999] {
            let (delta, without) = (Rgb::splat(-0.1), Rgb::splat(without));
            pixel.add(Sample { local: 1.0, plate: 1.0, delta, without, ..Sample::default() });
        }
        let e = pixel.estimate(2, Rgb::ONE, 1e-6);
        // Ten times less light than there is would be −200 without the floor under the base; that
        // it is still below −1 is for the composite to mend, once noise has averaged out.
        assert!(e.ratio.cmpgt(Rgb::splat(-2.6)).all(), "{}", e.ratio);
    }

    #[test]
    fn nothing_stays_of_a_find_that_a_denoiser_takes_out() {
        // Odd numbers of replicates, the find in either half, and light that scatters with it.
        for (replicates, hot) in [(4, 1), (5, 0), (5, 1), (7, 2), (7, 5)] {
            let mut pixel = Pixel::default();
            for r in 0..replicates {
                let find = if r == hot { 40.0 } else { 0.0 };
                pixel.add(Sample {
                    coverage: 0.25,
                    object: Rgb::splat(0.25 * (0.5 + find)),
                    local: 0.75,
                    plate: 0.75,
                    delta: Rgb::splat(0.75 * (find - 0.5)),
                    without: Rgb::splat(0.75 + 0.01 * find),
                    ..Sample::default()
                });
            }
            let plate = Rgb::splat(2.0);
            let halves = pixel.halves(plate, 1e-6);
            // What takes the mean of the halves to −0.5 and to 0.5
            let to = |value: f32, halves: Option<[Rgb; 2]>| {
                halves.map(|[a, b]| (Rgb::splat(value) - 0.5 * (a + b), Rgb::ZERO))
            };
            let raw = pixel.estimate(replicates, plate, 1e-6);
            let refined =
                pixel.refined(&raw, plate, 1e-6, to(-0.5, halves.ratio), to(0.5, halves.object));
            let ratio = refined.ratio.x / 0.75;
            let within = 0.5 * LARGEST_CORRECTION;
            assert!((ratio + 0.5).abs() <= within + 1e-4, "{replicates}, {hot}: {ratio}");
            let difference = refined.difference.x - 2.0 * refined.ratio.x;
            assert!(difference.abs() < 1e-4, "{replicates}, {hot}: {difference}");
            assert!((refined.object.x - 0.125).abs() < 1e-4, "{replicates}, {hot}: {refined:?}");
        }
    }

    #[test]
    fn ratio_is_unbiased_and_its_error_is_known() {
        // a and b correlated and noisy: without the correction the ratio of R = 4 means is biased.
        let (runs, replicates) = (20_000, 4);
        let (mut sum, mut squares, mut predicted) = (0.0, 0.0, 0.0);
        for run in 0..runs {
            let mut pixel = Pixel::default();
            for r in 0..replicates {
                let s = Sampler::new(7, (run as usize, 0), r, 0, Numbers::Independent);
                let p = s.pair(Purpose::Pixel);
                let b = 1.0 + 0.8 * (p.x as f32 - 0.5);
                let a = -0.5 * b + 0.2 * (p.y as f32 - 0.5);
                pixel.add(Sample {
                    local: 1.0,
                    plate: 1.0,
                    delta: Rgb::splat(a),
                    without: Rgb::splat(b + 0.4 * (p.y as f32 - 0.5)),
                    ..Sample::default()
                });
            }
            let e = pixel.estimate(replicates, Rgb::splat(2.0), 1e-6);
            sum += f64::from(e.difference.x);
            squares += f64::from(e.difference.x).powi(2);
            predicted += f64::from(e.variance.x);
        }
        let n = f64::from(runs);
        let (mean, variance) = (sum / n, squares / n - (sum / n).powi(2));
        // True ratio −0.5; 4σ of the mean, and what is left of the bias is of second order.
        assert!((mean + 1.0).abs() < 4.0 * (variance / n).sqrt() + 1e-3, "{mean}");
        assert!((predicted / n / variance - 1.0).abs() < 0.1, "{} {variance}", predicted / n);
    }
}
