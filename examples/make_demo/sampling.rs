//! Low-discrepancy numbers for one path: padded 2-D (0, 2)-sequences with Owen scrambling.
//!
//! Each pair of dimensions is the van der Corput / Sobol' pair, its order and its digits scrambled
//! by a hash (Laine and Karras 2011; Burley, JCGT 9(4), 2020). The numbers depend on (pixel, sample,
//! dimension) alone, so the plate and the truth share every number up to where their paths part.

use glam::{DVec2, DVec3};

/// The stream of numbers of one path.
pub struct Sampler {
    sample: u32,
    seed: u32,
    dimension: u32,
}

impl Sampler {
    /// Sample number `sample` of the pixel whose hash is `seed`.
    pub fn new(seed: u32, sample: u32) -> Self {
        Self { sample, seed, dimension: 0 }
    }

    /// The next two numbers, each in [0, 1).
    pub fn next_2d(&mut self) -> DVec2 {
        let key = hash(self.seed ^ hash(self.dimension.wrapping_add(0x9e37_79b9)));
        self.dimension += 1;
        let index = scramble(self.sample.reverse_bits(), key).reverse_bits();
        let x = scramble(index, hash(key ^ 1)).reverse_bits();
        let y = scramble(sobol_second(index).reverse_bits(), hash(key ^ 2)).reverse_bits();
        DVec2::new(f64::from(x), f64::from(y)) / 4_294_967_296.0
    }
}

/// A well mixed function of `x` (Wellons' lowbias32).
pub fn hash(mut x: u32) -> u32 {
    x ^= x >> 16;
    x = x.wrapping_mul(0x7feb_352d);
    x ^= x >> 15;
    x = x.wrapping_mul(0x846c_a68b);
    x ^ (x >> 16)
}

/// The hash of a pixel in a picture.
pub fn pixel_seed(picture: u32, x: usize, y: usize) -> u32 {
    hash(hash(hash(picture) ^ x as u32) ^ y as u32)
}

/// Owen scrambling of bit-reversed numbers: every bit flips by a hash of the bits below it.
fn scramble(mut x: u32, seed: u32) -> u32 {
    x = x.wrapping_add(seed);
    x ^= x.wrapping_mul(0x6c50_b47c);
    x ^= x.wrapping_mul(0xb82f_1e52);
    x ^= x.wrapping_mul(0xc7af_e638);
    x ^ x.wrapping_mul(0x8d22_f6e6)
}

/// Second dimension of Sobol's sequence, most significant bit first.
fn sobol_second(mut index: u32) -> u32 {
    let mut direction = 1_u32 << 31;
    let mut value = 0;
    while index != 0 {
        if index & 1 == 1 {
            value ^= direction;
        }
        direction ^= direction >> 1;
        index >>= 1;
    }
    value
}

/// Two unit vectors that make a right-handed frame with `n` (Duff et al., JCGT 6(1), 2017).
pub fn frame(n: DVec3) -> (DVec3, DVec3) {
    let sign = 1.0_f64.copysign(n.z);
    let a = -1.0 / (sign + n.z);
    let b = n.x * n.y * a;
    (
        DVec3::new(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x),
        DVec3::new(b, sign + n.y * n.y * a, -n.y),
    )
}

/// A direction about `axis` at polar angle acos(`cos_theta`) and azimuth 2π `turn`.
pub fn around(axis: DVec3, cos_theta: f64, turn: f64) -> DVec3 {
    let (s, t) = frame(axis);
    let sin_theta = (1.0 - cos_theta * cos_theta).max(0.0).sqrt();
    let (sin_phi, cos_phi) = (std::f64::consts::TAU * turn).sin_cos();
    s * (sin_theta * cos_phi) + t * (sin_theta * sin_phi) + axis * cos_theta
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 256 points of a (0, 2)-sequence put one point into each of the 16 × 16 cells.
    #[test]
    fn a_power_of_four_samples_fills_every_cell_once() {
        let mut cells = [0; 256];
        for sample in 0..256 {
            let mut sampler = Sampler::new(77, sample);
            sampler.next_2d();
            let p = sampler.next_2d() * 16.0;
            cells[p.y as usize * 16 + p.x as usize] += 1;
        }
        assert_eq!(cells, [1; 256]);
    }
}
