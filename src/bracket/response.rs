//! The camera's own tone curve, recovered from a bracket whose exposures are known.
//!
//! Debevec & Malik 1997, eq. 3: ln f⁻¹(z) = g(z) for 256 codes and the log radiance of sample pixels
//! minimise Σ w(z)²·(g(z) − ln E − ln t)² + λ² Σ (w(z)·g″(z))², one curve for all channels. The pixel
//! unknowns each touch only their own equations and are eliminated, which leaves 256 × 256.
//! A bracket alone fixes g up to a factor; it is set so that the code that sRGB gives to 18 % grey
//! keeps that meaning, because the plate beside the bracket is read as sRGB.
//! Needs trusted exposure ratios: a wrong exponent in them is one in the curve (Grossberg & Nayar 2003).

use nalgebra::{DMatrix, DVector};

use super::merge::Layer;
use crate::photo::{Photo, Samples, ToneCurve, colour::srgb_decode};

/// Smoothness λ and number of sample pixels (methods-capture C3: 0.2 % on an S-curve).
const SMOOTHNESS: f64 = 50.0;
const SAMPLES: usize = 1000;
/// Codes of a neighbour may differ this much: samples lie away from edges. The first that gives
/// enough samples is taken; a small or noisy picture has no flatter places.
const FLAT_CODES: [u8; 3] = [2, 4, 8];
/// Fewer say too little about 256 codes.
const FEWEST_SAMPLES: usize = SAMPLES / 4;
/// sRGB code of 18 % grey, where the curve is anchored.
const GREY_CODE: usize = 118;

/// Recovers the response; `None` if the files are not 8-bit RGB or show too little.
pub(super) fn recover(
    photos: &[&Photo],
    layers: &[Layer],
    exposures: &[f64],
    order: &[usize],
) -> Option<ToneCurve> {
    let codes = Codes::new(photos, layers, order)?;
    let samples = FLAT_CODES
        .iter()
        .map(|&flat| codes.samples(flat))
        .find(|samples| samples.len() >= FEWEST_SAMPLES)?;
    let logs: Vec<f64> = order.iter().map(|&k| exposures[k].ln()).collect();
    solve(&samples, &logs).and_then(anchored)
}

/// The frames' 8-bit codes on one grid.
struct Codes<'a> {
    frames: Vec<(&'a [u8], usize)>,
    /// Whole-pixel shift of each frame.
    shifts: Vec<(i64, i64)>,
    width: i64,
    height: i64,
}

impl<'a> Codes<'a> {
    fn new(photos: &[&'a Photo], layers: &[Layer], order: &[usize]) -> Option<Self> {
        let frames = order
            .iter()
            .map(|&k| match &photos[k].samples {
                Samples::U8 { channels, data } if *channels >= 3 => {
                    Some((data.as_slice(), *channels))
                }
                _ => None,
            })
            .collect::<Option<Vec<_>>>()?;
        let shifts = order.iter().map(|&k| layers[k].whole_shift()).collect();
        let size = &photos[order[0]].linear;
        Some(Self { frames, shifts, width: size.width() as i64, height: size.height() as i64 })
    }

    /// The code of a frame at a pixel of the reference, if it lies on a flat place there.
    fn flat_code(&self, k: usize, x: i64, y: i64, channel: usize, flat: u8) -> Option<u8> {
        let (x, y) = (x + self.shifts[k].0, y + self.shifts[k].1);
        if x < 2 || y < 2 || x >= self.width - 2 || y >= self.height - 2 {
            return None;
        }
        let (data, channels) = self.frames[k];
        let at = |x: i64, y: i64| data[(y * self.width + x) as usize * channels + channel];
        let code = at(x, y);
        let is_flat = [(2, 0), (-2, 0), (0, 2), (0, -2)]
            .iter()
            .all(|&(dx, dy)| at(x + dx, y + dy).abs_diff(code) <= flat);
        is_flat.then_some(code)
    }

    /// Pixels spread over the codes of the middle frame: each a code for every frame.
    fn samples(&self, flat: u8) -> Vec<Vec<u8>> {
        const BANDS: usize = 16;
        let middle = self.frames.len() / 2;
        let mut bands = vec![Vec::new(); BANDS];
        // A scattered order (golden-ratio steps) fills the bands from all over the picture.
        let n = (self.width * self.height) as u64;
        let step = ((n as f64 * 0.618_033_988_75) as u64) | 1;
        let mut at = 0;
        for i in 0..n.min(400_000) {
            at = (at + step) % n;
            let (x, y) = ((at % self.width as u64) as i64, (at / self.width as u64) as i64);
            let channel = (i % 3) as usize;
            let codes: Option<Vec<u8>> =
                (0..self.frames.len()).map(|k| self.flat_code(k, x, y, channel, flat)).collect();
            let Some(codes) = codes else { continue };
            let band: &mut Vec<Vec<u8>> = &mut bands[usize::from(codes[middle]) * BANDS / 256];
            let seen_twice = codes.iter().filter(|&&c| weight(c) > 4.0).count() >= 2;
            if seen_twice && band.len() < SAMPLES {
                band.push(codes);
            }
        }
        // Evenly from all bands; what empty ones leave, the fuller ones give.
        let mut samples = Vec::new();
        bands.sort_by_key(Vec::len);
        for (i, band) in bands.iter().enumerate() {
            let share = (SAMPLES - samples.len()) / (BANDS - i);
            samples.extend_from_slice(&band[..band.len().min(share)]);
        }
        samples
    }
}

/// Debevec & Malik's hat: no trust in codes at either end; none at all in clipped ones.
fn weight(code: u8) -> f64 {
    if code >= 250 { 0.0 } else { f64::from(code.min(255 - code)) }
}

/// Least squares for g; `None` if it cannot be solved.
fn solve(samples: &[Vec<u8>], log_exposures: &[f64]) -> Option<DVector<f64>> {
    let mut normal = DMatrix::<f64>::zeros(256, 256);
    let mut right = DVector::<f64>::zeros(256);
    for codes in samples {
        // ln E of this pixel is the weighted mean of g − ln t; what remains is each one's
        // difference from that mean.
        let squared: Vec<f64> = codes.iter().map(|&c| weight(c).powi(2)).collect();
        let total: f64 = squared.iter().sum();
        let mean_log = squared.iter().zip(log_exposures).map(|(w, t)| w * t).sum::<f64>() / total;
        for (i, &a) in codes.iter().enumerate() {
            normal[(a.into(), a.into())] += squared[i];
            right[usize::from(a)] += squared[i] * (log_exposures[i] - mean_log);
            for (j, &b) in codes.iter().enumerate() {
                normal[(a.into(), b.into())] -= squared[i] * squared[j] / total;
            }
        }
    }
    for z in 1..255usize {
        let w = (SMOOTHNESS * f64::from(z.min(255 - z) as u32)).powi(2);
        let second = [(z - 1, 1.0), (z, -2.0), (z + 1, 1.0)];
        for (i, a) in second {
            for (j, b) in second {
                normal[(i, j)] += w * a * b;
            }
        }
    }
    // g(GREY_CODE) = 0 for now: takes away the free factor.
    normal[(GREY_CODE, GREY_CODE)] += 1e9;
    normal.cholesky().map(|c| c.solve(&right)).filter(|g| g.iter().all(|v| v.is_finite()))
}

/// The curve of g, made to rise strictly and to give 18 % grey its sRGB meaning; `None` if it runs
/// beyond all numbers.
fn anchored(g: DVector<f64>) -> Option<ToneCurve> {
    let grey = f64::from(srgb_decode(GREY_CODE as f32 / 255.0));
    let mut curve: Vec<f64> = g.iter().map(|v| (v - g[GREY_CODE]).exp() * grey).collect();
    // Away from grey outward: noise must not turn the curve around.
    for code in GREY_CODE + 1..256 {
        curve[code] = curve[code].max(curve[code - 1] * (1.0 + 1e-5));
    }
    for code in (0..GREY_CODE).rev() {
        curve[code] = curve[code].min(curve[code + 1] * (1.0 - 1e-5));
    }
    let mut response = [0.0; 256];
    for (to, from) in response.iter_mut().zip(curve) {
        *to = from as f32;
    }
    // Code 0 is black, whatever a logarithm says.
    response[0] = 0.0;
    ToneCurve::new(response)
}
