//! Random numbers without state: a function of (pixel, replicate, sample, place in the path).
//!
//! Two-dimensional Sobol pairs with Owen scrambling by hashing, index shuffled anew for each pair
//! (Burley 2020, "Practical Hash-based Owen Scrambling"; the hash is Vegdahl's 2021 revision of Laine
//! and Karras's, whose published constants leave structure). As nothing is remembered, the number of
//! threads, the order of tiles and a restart cannot change a bit.
//! 2^k consecutive indices are stratified; a replicate is therefore 2^k samples.

use glam::DVec2;

/// What a pair of numbers decides; pairs of different purposes are independent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Purpose {
    Pixel = 1,
    Environment = 2,
    Sun = 3,
    Direction = 4,
    Choice = 5,
    Roulette = 6,
    Alpha = 7,
    Cells = 8,
    Lamp = 9,
    Glow = 10,
}

/// Which numbers: stratified ones for pictures, independent ones where statistics are tested.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Numbers {
    #[default]
    SobolOwen,
    Independent,
}

/// The numbers of one sample, at one vertex of its path.
#[derive(Clone, Copy, Debug)]
pub struct Sampler {
    seed: u32,
    index: u32,
    key: u32,
    numbers: Numbers,
}

impl Sampler {
    /// Sample `index` of `replicate` in pixel (x, y).
    pub fn new(
        seed: u64,
        pixel: (usize, usize),
        replicate: u32,
        index: u32,
        numbers: Numbers,
    ) -> Self {
        let mut hash = mix((seed as u32) ^ 0x5851_f42d);
        for word in [(seed >> 32) as u32, pixel.0 as u32, pixel.1 as u32, replicate] {
            hash = mix(hash ^ word).wrapping_add(word.rotate_left(16));
        }
        Self { seed: hash, index, key: 0, numbers }
    }

    /// The numbers of the next vertex; different branches of a path are independent.
    pub fn descend(self, branch: u32) -> Self {
        Self { key: mix(self.key.wrapping_mul(31).wrapping_add(branch + 1)), ..self }
    }

    /// Two numbers in [0, 1), 32 bits each.
    pub fn pair(&self, purpose: Purpose) -> DVec2 {
        let seed = mix(self.seed ^ mix(self.key.wrapping_add((purpose as u32) << 24)));
        let (x, y) = match self.numbers {
            Numbers::SobolOwen => {
                let index = scramble_reversed(self.index.reverse_bits(), seed).reverse_bits();
                let x = scramble_reversed(index, mix(seed ^ 0x68bc_21eb));
                let y = scramble_reversed(pascal(index), mix(seed ^ 0x02e5_be93));
                (x.reverse_bits(), y.reverse_bits())
            }
            Numbers::Independent => {
                let x = mix(seed ^ mix(self.index));
                (x, mix(x ^ 0x68bc_21eb ^ seed.rotate_left(7)))
            }
        };
        const STEP: f64 = 1.0 / 4_294_967_296.0;
        DVec2::new(f64::from(x) * STEP, f64::from(y) * STEP)
    }

    /// One number in [0, 1).
    pub fn one(&self, purpose: Purpose) -> f32 {
        to_f32(self.pair(purpose).x)
    }
}

/// The largest f32 not above `u`, so that it stays below 1.
pub fn to_f32(u: f64) -> f32 {
    below_one(u as f32)
}

/// `u`, or the largest f32 below 1.
pub fn below_one(u: f32) -> f32 {
    u.min(1.0 - f32::EPSILON / 2.0)
}

/// A good bijective hash of 32 bits ("lowbias32", Wellons 2018).
pub(super) fn mix(mut x: u32) -> u32 {
    x ^= x >> 16;
    x = x.wrapping_mul(0x7feb_352d);
    x ^= x >> 15;
    x = x.wrapping_mul(0x846c_a68b);
    x ^ (x >> 16)
}

/// Owen scrambling of a number whose bits are reversed: each bit is flipped by a hash of those above.
fn scramble_reversed(mut x: u32, seed: u32) -> u32 {
    x ^= x.wrapping_mul(0x3d20_adea);
    x = x.wrapping_add(seed);
    x = x.wrapping_mul((seed >> 16) | 1);
    x ^= x.wrapping_mul(0x0552_6c56);
    x ^ x.wrapping_mul(0x53a2_2864)
}

/// Product with Pascal's triangle modulo 2: Sobol's second dimension, bits reversed.
///
/// The triangle is the fifth Kronecker power of (1 1; 0 1): five steps instead of 32.
fn pascal(mut x: u32) -> u32 {
    x ^= (x >> 1) & 0x5555_5555;
    x ^= (x >> 2) & 0x3333_3333;
    x ^= (x >> 4) & 0x0f0f_0f0f;
    x ^= (x >> 8) & 0x00ff_00ff;
    x ^ ((x >> 16) & 0x0000_ffff)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pairs(n: u32, pixel: (usize, usize), numbers: Numbers) -> Vec<DVec2> {
        (0..n)
            .map(|i| Sampler::new(9, pixel, 0, i, numbers).descend(2).pair(Purpose::Direction))
            .collect()
    }

    #[test]
    fn sobol_pairs_put_one_point_in_every_elementary_interval() {
        for (log_x, log_y) in [(0, 6), (1, 5), (3, 3), (5, 1), (6, 0)] {
            for pixel in [(0, 0), (7, 3), (1000, 2)] {
                let mut counts = vec![0; 64];
                for p in pairs(64, pixel, Numbers::SobolOwen) {
                    let x = (p.x * f64::from(1 << log_x)) as usize;
                    let y = (p.y * f64::from(1 << log_y)) as usize;
                    counts[(y << log_x) + x] += 1;
                }
                assert!(counts.iter().all(|&c| c == 1), "{log_x} {log_y} {pixel:?}");
            }
        }
    }

    #[test]
    fn different_pixels_replicates_purposes_and_vertices_are_uncorrelated() {
        let base = Sampler::new(9, (5, 5), 0, 0, Numbers::SobolOwen);
        let others: [fn(u32) -> DVec2; 4] = [
            |i| Sampler::new(9, (6, 5), 0, i, Numbers::SobolOwen).pair(Purpose::Sun),
            |i| Sampler::new(9, (5, 5), 1, i, Numbers::SobolOwen).pair(Purpose::Sun),
            |i| Sampler::new(9, (5, 5), 0, i, Numbers::SobolOwen).pair(Purpose::Environment),
            |i| Sampler::new(9, (5, 5), 0, i, Numbers::SobolOwen).descend(0).pair(Purpose::Sun),
        ];
        const N: u32 = 16_384;
        for (k, other) in others.iter().enumerate() {
            let mut correlation = 0.0;
            for i in 0..N {
                let a = Sampler { index: i, ..base }.pair(Purpose::Sun);
                correlation += (a.x - 0.5) * (other(i).x - 0.5) * 12.0 / f64::from(N);
            }
            // Independent numbers would scatter by 1/√N = 0.0078; four comparisons at 4σ: 2.5e-4.
            assert!(correlation.abs() < 4.0 / f64::from(N).sqrt(), "{k}: {correlation}");
        }
    }

    #[test]
    fn independent_numbers_fill_the_square_evenly() {
        // χ² over 16 × 16 bins, 65 536 draws; 99.9 % of 255 degrees of freedom: 330.5.
        for pixel in [(0, 0), (3, 8)] {
            let mut counts = vec![0.0; 256];
            for p in pairs(65_536, pixel, Numbers::Independent) {
                counts[(p.y * 16.0) as usize * 16 + (p.x * 16.0) as usize] += 1.0;
            }
            let chi: f64 = counts.iter().map(|c| (c - 256.0) * (c - 256.0) / 256.0).sum();
            assert!(chi < 330.5, "{chi}");
        }
    }

    #[test]
    fn numbers_stay_below_one_in_single_precision() {
        assert!(to_f32(1.0 - 1e-12) < 1.0);
        assert_eq!(to_f32(0.25), 0.25);
    }
}
