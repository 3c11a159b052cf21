//! Linear light → samples in the plate's own encoding; unchanged pixels keep the plate's samples.

use glam::DMat3;
use rayon::prelude::*;

use super::Composite;
use crate::conventions::{Rgb, luminance};
use crate::photo::{Image, Photo, Samples, Transfer, Window};

/// Finished samples, and how many values did not fit their type.
#[derive(Clone, Debug)]
pub struct Encoded {
    pub samples: Samples,
    /// Changed samples beyond the type's range, set to its end: white, 0 or ±65504.
    pub clamped: u64,
}

/// The composite in the plate's sample type, transfer curve and primaries.
///
/// Samples of pixels that no object changed are the plate's own, bit for bit. A grey plate gets the
/// luminance; its alpha grows by the objects' coverage, which is that of the composite's window.
pub fn encode(plate: &Photo, composite: &Composite, coverage: &Image<f32>) -> Encoded {
    // The reader refuses primaries that span no colour space, so both matrices exist.
    let file_from_rec709 = plate
        .encoding
        .primaries
        .rec709_from_rgb()
        .filter(|matrix| *matrix != DMat3::IDENTITY)
        .map(|matrix| matrix.inverse());
    let window = composite.window;
    let pixel = |k: usize| {
        if !composite.changed.pixels()[k] {
            return None;
        }
        let linear = composite.linear[window.pixel(k)];
        let linear = match file_from_rec709 {
            Some(matrix) => (matrix * linear.as_dvec3()).as_vec3(),
            None => linear,
        };
        let transfer = &plate.encoding.transfer;
        let colour = Rgb::from_array(linear.to_array().map(|l| transfer.encode(l)));
        let alpha = plate.alpha.as_ref().map_or(1.0, |a| a[window.pixel(k)]);
        let covered = coverage.pixels()[k];
        Some((colour, transfer, covered + (1.0 - covered) * alpha))
    };
    let place = (plate.linear.width(), window);
    let (samples, clamped) = match &plate.samples {
        Samples::U8 { channels, data } => {
            let (data, clamped) = replace(data, *channels, place, pixel, |v| whole(v, 255.0));
            (Samples::U8 { channels: *channels, data }, clamped)
        }
        Samples::U16 { channels, data } => {
            let (data, clamped) = replace(data, *channels, place, pixel, |v| whole(v, 65535.0));
            (Samples::U16 { channels: *channels, data }, clamped)
        }
        Samples::F16 { channels, data } => {
            let (data, clamped) = replace(data, *channels, place, pixel, |v| {
                let end = half::f16::MAX.to_f32();
                (half::f16::from_f32(v.clamp(-end, end)), v.abs() > end)
            });
            (Samples::F16 { channels: *channels, data }, clamped)
        }
        Samples::F32 { channels, data } => {
            let (data, clamped) = replace(data, *channels, place, pixel, |v| (v, false));
            (Samples::F32 { channels: *channels, data }, clamped)
        }
    };
    Encoded { samples, clamped }
}

/// Nearest whole code for a value where 1 is `white`, and whether it lay outside.
fn whole<T: Code>(value: f32, white: f32) -> (T, bool) {
    (T::from_code((value.clamp(0.0, 1.0) * white).round()), !(0.0..=1.0).contains(&value))
}

/// An integer sample type.
trait Code {
    fn from_code(code: f32) -> Self;
}
impl Code for u8 {
    fn from_code(code: f32) -> Self {
        code as u8
    }
}
impl Code for u16 {
    fn from_code(code: f32) -> Self {
        code as u16
    }
}

/// Copies `data`, replacing the samples of changed pixels by `pixel` stored with `store`; `place` is the
/// picture's width and the window that pixels are counted in.
fn replace<'a, T: Copy + Send + Sync>(
    data: &[T],
    channels: usize,
    (width, window): (usize, Window),
    pixel: impl Fn(usize) -> Option<(Rgb, &'a Transfer, f32)> + Sync,
    store: impl Fn(f32) -> (T, bool) + Sync,
) -> (Vec<T>, u64) {
    let mut out = data.to_vec();
    let (left, wide) = (window.first.0, window.size.0);
    let clamped = out
        .par_chunks_mut((channels * width).max(1))
        .skip(window.first.1)
        .take(window.size.1)
        .enumerate()
        .map(|(row, samples)| {
            let mut clamped = 0;
            let samples = &mut samples[channels * left..channels * (left + wide)];
            for (column, samples) in samples.chunks_mut(channels).enumerate() {
                let Some((colour, transfer, alpha)) = pixel(row * wide + column) else { continue };
                for (channel, sample) in samples.iter_mut().enumerate() {
                    let value = match (channels, channel) {
                        (2 | 4, c) if c + 1 == channels => alpha,
                        (1 | 2, _) => grey(colour, transfer),
                        (_, c) => colour.to_array()[c],
                    };
                    let (stored, outside) = store(value);
                    *sample = stored;
                    clamped += u64::from(outside);
                }
            }
            clamped
        })
        .sum();
    (out, clamped)
}

/// Luminance of an encoded colour, encoded again.
fn grey(colour: Rgb, transfer: &Transfer) -> f32 {
    let linear = Rgb::from_array(colour.to_array().map(|v| transfer.decode(v)));
    transfer.encode(luminance(linear))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::composite::{Mode, compose};
    use crate::photo::{Encoding, EncodingSource, Primaries, ToneCurve};
    use crate::render::Difference;

    /// A plate whose samples run through all 8-bit codes, in a wide encoding.
    fn plate(primaries: Primaries) -> Photo {
        let data: Vec<u8> = (0..768).map(|i| (i % 256) as u8).collect();
        let to_rec709 = primaries.rec709_from_rgb().expect("named primaries");
        let linear = Image::from_fn(16, 16, |x, y| {
            let code = |c| Transfer::Srgb.decode(f32::from(data[3 * (16 * y + x) + c]) / 255.0);
            (to_rec709 * Rgb::new(code(0), code(1), code(2)).as_dvec3()).as_vec3()
        });
        let encoding =
            Encoding { transfer: Transfer::Srgb, primaries, source: EncodingSource::Profile };
        let samples = Samples::U8 { channels: 3, data };
        Photo { encoding, samples, ..Photo::from_linear(linear) }
    }

    #[test]
    fn encoding_inverts_reading_for_every_code_and_primaries() {
        let bent = ToneCurve::new(std::array::from_fn(|code| (code as f32).powi(3) * 1e-6));
        for (primaries, transfer) in [
            (Primaries::Rec709, Transfer::Srgb),
            (Primaries::DisplayP3, Transfer::Srgb),
            (Primaries::AdobeRgb, Transfer::Gamma(220)),
            (Primaries::Rec709, Transfer::Measured(bent.expect("a curve that rises"))),
        ] {
            let plate = plate(primaries).redecoded(transfer);
            let mut composite = compose(&plate, &Difference::nothing(16, 16), Mode::Ratio).unwrap();
            // Every pixel is said to be changed, by nothing: all are encoded anew.
            composite.changed = Image::filled(16, 16, true);
            let encoded = encode(&plate, &composite, &Image::filled(16, 16, 0.0));
            assert_eq!(encoded.samples, plate.samples, "{primaries:?}");
        }
    }

    #[test]
    fn light_above_white_is_clamped_and_counted() {
        let plate = plate(Primaries::Rec709);
        let mut d = Difference::nothing(16, 16);
        d.coverage[(3, 0)] = 1.0;
        d.object[(3, 0)] = Rgb::new(2.0, 0.5, 3.0);
        let composite = compose(&plate, &d, Mode::Ratio).unwrap();
        let encoded = encode(&plate, &composite, &d.coverage);
        assert_eq!(encoded.clamped, 2);
        let Samples::U8 { data, .. } = encoded.samples else { panic!("type was changed") };
        assert_eq!(data[9..12], [255, 188, 255]);
    }

    #[test]
    fn half_plates_stay_half_and_never_become_infinite() {
        let data = vec![half::f16::from_f32(0.5); 3];
        let plate = Photo {
            samples: Samples::F16 { channels: 3, data },
            ..Photo::from_linear(Image::filled(1, 1, Rgb::splat(0.5)))
        };
        let mut d = Difference::nothing(1, 1);
        d.coverage[(0, 0)] = 1.0;
        d.object[(0, 0)] = Rgb::new(1e6, 0.25, 0.0);
        let composite = compose(&plate, &d, Mode::Additive).unwrap();
        let encoded = encode(&plate, &composite, &d.coverage);
        assert_eq!(encoded.clamped, 1);
        let Samples::F16 { data, .. } = encoded.samples else { panic!("type was changed") };
        assert_eq!(data.iter().map(|v| v.to_f32()).collect::<Vec<_>>(), [65504.0, 0.25, 0.0]);
    }
}
