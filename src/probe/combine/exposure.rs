//! One exposure for all views: the median ratio of what two of them measured alike.

use super::{CombineError, Layer};
use crate::bracket::Validity;
use crate::conventions::{Rgb, luminance};

/// How exposures are brought together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Equalise {
    /// Each channel by its own ratio: for views whose white balance differs.
    pub per_channel: bool,
    /// Ratios beyond this many stops are refused.
    pub most_stops: f64,
}

impl Default for Equalise {
    fn default() -> Self {
        Self { per_channel: false, most_stops: 2.0 }
    }
}

/// What a view was multiplied with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gain {
    /// Per channel; 1 for the first view, and where nothing was seen in common.
    pub factor: Rgb,
    /// Median deviation of the single ratios from it, relative: noise, parallax, other light.
    pub scatter: f64,
    /// Solid angle that the ratio comes from, sr.
    pub overlap_sr: f64,
}

/// Less in common than this gives no ratio, sr.
const LEAST_OVERLAP_SR: f64 = 0.05;
/// Texels whose light is not known to this share are left out.
const KNOWN_TO: f32 = 0.2;

/// Brings every layer to those before it; the first stays.
pub(super) fn equalise(
    layers: &mut [Layer],
    options: &Equalise,
) -> Result<Vec<Gain>, CombineError> {
    let mut gains = vec![Gain { factor: Rgb::ONE, scatter: 0.0, overlap_sr: 0.0 }];
    for k in 1..layers.len() {
        let gain = gain(&layers[..k], &layers[k], options.per_channel);
        let stops = f64::from(luminance(gain.factor)).log2();
        if stops.abs() > options.most_stops {
            return Err(CombineError::Exposure { view: k + 1, stops, most: options.most_stops });
        }
        let panorama = &mut layers[k].panorama;
        panorama.radiance.pixels_mut().iter_mut().for_each(|l| *l *= gain.factor);
        let square = gain.factor * gain.factor;
        panorama.variance.pixels_mut().iter_mut().for_each(|v| *v *= square);
        gains.push(gain);
    }
    Ok(gains)
}

fn gain(before: &[Layer], layer: &Layer, per_channel: bool) -> Gain {
    let channels = |of: &dyn Fn(Rgb) -> f32| {
        let mut ratios: Vec<(f64, f64)> =
            before.iter().flat_map(|other| ratios(other, layer, of)).collect();
        let (middle, overlap) = median(&mut ratios);
        let mut off: Vec<(f64, f64)> =
            ratios.iter().map(|(ratio, omega)| ((ratio - middle).abs(), *omega)).collect();
        (middle, median(&mut off).0, overlap)
    };
    let (middle, scatter, overlap_sr) = channels(&luminance);
    if overlap_sr < LEAST_OVERLAP_SR {
        return Gain { factor: Rgb::ONE, scatter: 0.0, overlap_sr };
    }
    let factor = match per_channel {
        true => Rgb::from_array([0, 1, 2].map(|k| channels(&move |l| l[k]).0.exp() as f32)),
        false => Rgb::splat(middle.exp() as f32),
    };
    Gain { factor, scatter: scatter.exp_m1(), overlap_sr }
}

/// Logarithms of `one`/`other` with their solid angles, where both are well known.
fn ratios(one: &Layer, other: &Layer, of: &dyn Fn(Rgb) -> f32) -> Vec<(f64, f64)> {
    let panorama = &one.panorama;
    let known = |layer: &Layer, i: usize| {
        let panorama = &layer.panorama;
        let class = panorama.validity.pixels()[i];
        let light = of(panorama.radiance.pixels()[i]);
        let sigma = of(panorama.variance.pixels()[i]).max(0.0).sqrt();
        let measured = matches!(class, Validity::Measured | Validity::Single);
        (measured && layer.usable.pixels()[i] && light > 0.0 && sigma < KNOWN_TO * light)
            .then_some(light)
    };
    (0..panorama.radiance.pixels().len())
        .filter_map(|i| {
            let (a, b) = (known(one, i)?, known(other, i)?);
            Some((f64::from(a / b).ln(), panorama.solid_angle(i / panorama.width())))
        })
        .collect()
}

/// Weighted median and the whole weight; 0 of nothing.
fn median(values: &mut [(f64, f64)]) -> (f64, f64) {
    values.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let whole: f64 = values.iter().map(|(_, weight)| weight).sum();
    let mut sum = 0.0;
    for &(value, weight) in values.iter() {
        sum += weight;
        if 2.0 * sum >= whole {
            return (value, whole);
        }
    }
    (0.0, whole)
}
