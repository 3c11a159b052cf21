//! From light to a photograph: exposure, shot and read noise, clipping, the exact sRGB curve, 8 bits.

use glam::DVec3;

use crate::sampling::hash;

/// Electrons a pixel holds at white, and the noise of reading it.
const FULL_WELL_E: f64 = 20_000.0;
const READ_NOISE_E: f64 = 4.0;

/// Shutter time as the fraction EXIF stores, f-number and ISO of one photograph.
#[derive(Clone, Copy)]
pub struct Exposure {
    pub time: (u32, u32),
    pub f_number: f64,
    pub iso: u32,
}

/// The plate's exposure: with it, radiance 1 is white.
pub const PLATE: Exposure = Exposure { time: (1, 30), f_number: 5.6, iso: 100 };

impl Exposure {
    pub fn seconds(self) -> f64 {
        f64::from(self.time.0) / f64::from(self.time.1)
    }

    /// t · (ISO / 100) / N².
    pub fn amount(self) -> f64 {
        self.seconds() * f64::from(self.iso) / 100.0 / (self.f_number * self.f_number)
    }

    /// Linear value of radiance 1: the plate's is 1.
    pub fn scale(self) -> f64 {
        self.amount() / PLATE.amount()
    }
}

/// The photograph of `light` (in the plate's values), 8-bit sRGB, row-major.
pub fn photograph(light: &[DVec3], exposure: Exposure, seed: u32) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(3 * light.len());
    for (i, value) in light.iter().enumerate() {
        for c in 0..3 {
            let electrons = value[c] * exposure.scale() * FULL_WELL_E;
            // Photon counts here are large or drowned by read noise: a normal law is enough.
            let sigma = (electrons.max(0.0) + READ_NOISE_E * READ_NOISE_E).sqrt();
            let noise = sigma * normal(hash(hash(seed) ^ (3 * i + c) as u32));
            bytes.push(to_srgb8((electrons + noise) / FULL_WELL_E));
        }
    }
    bytes
}

/// The exact sRGB curve (IEC 61966-2-1), clipped and rounded to 8 bits.
fn to_srgb8(linear: f64) -> u8 {
    let x = linear.clamp(0.0, 1.0);
    let encoded = if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 };
    (encoded * 255.0).round() as u8
}

/// A standard normal number from a hash (Box and Muller 1958).
fn normal(key: u32) -> f64 {
    let unit = |k: u32| (f64::from(k) + 0.5) / 4_294_967_296.0;
    let radius = (-2.0 * unit(hash(key ^ 0x68bc_21eb)).ln()).sqrt();
    radius * (std::f64::consts::TAU * unit(hash(key ^ 0x02e5_be93))).cos()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 40 000 pixels at half of white: mean within 4 σ/√n, spread within 3 % (its own σ is 0.35 %).
    #[test]
    fn noise_has_the_size_of_the_electrons() {
        let bytes = photograph(&vec![DVec3::splat(0.5); 40_000], PLATE, 1);
        let linear = |b: u8| ((f64::from(b) / 255.0 + 0.055) / 1.055).powf(2.4);
        let n = bytes.len() as f64;
        let mean = bytes.iter().map(|b| linear(*b)).sum::<f64>() / n;
        let variance = bytes.iter().map(|b| (linear(*b) - mean).powi(2)).sum::<f64>() / n;
        let step = linear(188) - linear(187);
        let expected = (10_000.0_f64 + 16.0) / FULL_WELL_E.powi(2) + step * step / 12.0;
        assert!((mean - 0.5).abs() < 4.0 * (expected / n).sqrt() + 2e-4, "{mean}");
        assert!((variance / expected - 1.0).abs() < 0.03, "{variance} {expected}");
    }
}
