//! A camera's own tone curve: the linear value of each 8-bit code.

use std::sync::Arc;

use super::colour::srgb_decode;

/// Linear value of every 8-bit code, as recovered from a camera's photographs; rises strictly.
///
/// Between codes it is interpolated linearly, so that decoding and encoding undo each other.
/// Cheap to clone.
#[derive(Clone, Debug, PartialEq)]
pub struct ToneCurve(Arc<[f32; 256]>);

impl ToneCurve {
    /// The curve through these values; `None` unless they are finite and rise strictly from 0.
    pub fn new(linear: [f32; 256]) -> Option<Self> {
        let rises = linear.windows(2).all(|pair| pair[0] < pair[1]);
        (linear[0] == 0.0 && linear[255].is_finite() && rises).then(|| Self(Arc::new(linear)))
    }

    /// Linear value of a code.
    pub fn linear(&self, code: u8) -> f32 {
        self.0[usize::from(code)]
    }

    /// Linear light of a file's number (code 255 = 1); odd around zero, continued above 1.
    pub fn decode(&self, value: f32) -> f32 {
        let position = value.abs() * 255.0;
        // The last step goes on for ever; a NaN becomes the black step and stays NaN.
        let below = (position as usize).min(254);
        let (a, b) = (self.0[below], self.0[below + 1]);
        (a + (b - a) * (position - below as f32)).copysign(value)
    }

    /// The file's number for linear light; inverse of [`Self::decode`].
    pub fn encode(&self, linear: f32) -> f32 {
        let light = linear.abs();
        let below = self.0.partition_point(|&v| v <= light).clamp(1, 255) - 1;
        let (a, b) = (self.0[below], self.0[below + 1]);
        ((below as f32 + (light - a) / (b - a)) / 255.0).copysign(linear)
    }

    /// Half the distance between the codes on both sides of the one nearest to linear value `y`.
    pub fn step(&self, y: f32) -> f32 {
        let code = self.0.partition_point(|&v| v < y).clamp(1, 254);
        0.5 * (self.0[code + 1] - self.0[code - 1])
    }

    /// Largest factor between this curve and sRGB over codes 20…240.
    pub fn distance_from_srgb(&self) -> f64 {
        (20..=240u8)
            .map(|code| {
                let srgb = srgb_decode(f32::from(code) / 255.0);
                f64::from(self.linear(code) / srgb).ln().abs().exp()
            })
            .fold(1.0, f64::max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An S-shaped curve.
    fn curve() -> ToneCurve {
        let value = |code: usize| {
            let x = code as f32 / 255.0;
            2.0 * x * x * (1.0 + 3.0 * x)
        };
        ToneCurve::new(std::array::from_fn(value)).unwrap()
    }

    #[test]
    fn encoding_undoes_decoding_for_every_code_and_beyond() {
        let curve = curve();
        for code in 0..=255u8 {
            let value = f32::from(code) / 255.0;
            assert_eq!(curve.decode(value), curve.linear(code));
            assert_eq!((curve.encode(curve.decode(value)) * 255.0).round() as u8, code);
        }
        for value in [-0.3f32, 0.1234, 0.987, 1.0, 1.7] {
            let back = curve.encode(curve.decode(value));
            assert!((back - value).abs() < 1e-5 * value.abs(), "{value} became {back}");
        }
    }

    #[test]
    fn a_curve_that_does_not_rise_is_none() {
        let mut values: [f32; 256] = std::array::from_fn(|code| code as f32);
        assert!(ToneCurve::new(values).is_some());
        values[200] = values[199];
        assert!(ToneCurve::new(values).is_none());
        values[200] = f32::NAN;
        assert!(ToneCurve::new(values).is_none());
        assert!(ToneCurve::new([0.0; 256]).is_none());
    }

    #[test]
    fn hostile_numbers_do_not_panic() {
        let curve = curve();
        for value in [f32::NAN, f32::INFINITY, -f32::INFINITY, f32::MAX] {
            let _ = (curve.decode(value), curve.encode(value), curve.step(value));
        }
    }
}
