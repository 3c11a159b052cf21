//! Small lights are taken whole from one view.

use super::Layer;
use super::taper::taper;
use crate::bracket::Validity;
use crate::conventions::luminance;
use crate::photo::Image;
use crate::probe::compact_lights::compact_lights;
use crate::probe::fill::regions;

/// A measurement that reaches this share of another view's lower bound stands in its place.
pub(super) const REACHED: f64 = 0.8;
/// Margin round a light that comes with it, radians: glare, and what registering leaves over.
const MARGIN_RAD: f64 = 1.0 * std::f64::consts::PI / 180.0;
/// Wider regions (20° across) are skies and windows, and judged texel by texel.
const WIDEST_SR: f64 = 0.1;

/// Leaves each small light to one view: a measured one that reaches all bounds, else the brightest.
///
/// Returns how many lights were seen by more than one view.
pub(super) fn take_whole(layers: &[Layer], weights: &mut [Image<f32>], feather_rad: f64) -> usize {
    let first = &layers[0].panorama;
    let (w, h) = (first.width(), first.height());
    let mut plain = Image::filled(w, h, true);
    for layer in layers {
        let panorama = &layer.panorama;
        let found = compact_lights(panorama);
        found.iter().flat_map(|lamp| &lamp.texels).for_each(|&i| plain.pixels_mut()[i] = false);
        for (plain, class) in plain.pixels_mut().iter_mut().zip(panorama.validity.pixels()) {
            *plain &= *class != Validity::LowerBound;
        }
    }
    // What is less than the margin away fades.
    let near = taper(&plain, MARGIN_RAD).map(|t| *t < 1.0);
    let mut left: Vec<Image<bool>> = layers.iter().map(|_| Image::filled(w, h, true)).collect();
    let mut taken = 0;
    for region in regions(&near) {
        let solid_angle: f64 = region.iter().map(|&i| first.solid_angle(i / w)).sum();
        if solid_angle > WIDEST_SR {
            continue;
        }
        let seen: Vec<(usize, Seen)> = (0..layers.len())
            .filter_map(|k| Some((k, Seen::of(&layers[k], &weights[k], &region)?)))
            .collect();
        let Some(best) = best(&seen) else { continue };
        taken += usize::from(seen.len() > 1);
        for (k, left) in left.iter_mut().enumerate().filter(|(k, _)| *k != best) {
            if seen.iter().any(|(other, _)| *other == k) {
                region.iter().for_each(|&i| left.pixels_mut()[i] = false);
            }
        }
    }
    for (weights, left) in weights.iter_mut().zip(&left) {
        if left.pixels().iter().all(|keeps| *keeps) {
            continue;
        }
        let fade = taper(left, feather_rad);
        weights.pixels_mut().iter_mut().zip(fade.pixels()).for_each(|(w, f)| *w *= f);
    }
    taken
}

/// What one view shows of a light.
struct Seen {
    flux: f64,
    weight: f64,
    clipped: bool,
}

impl Seen {
    /// `None` if the view does not show all of it.
    fn of(layer: &Layer, weights: &Image<f32>, region: &[usize]) -> Option<Self> {
        let panorama = &layer.panorama;
        let mut seen = Self { flux: 0.0, weight: 0.0, clipped: false };
        let mut shown = 0;
        for &i in region {
            let omega = panorama.solid_angle(i / panorama.width());
            seen.flux += f64::from(luminance(panorama.radiance.pixels()[i])) * omega;
            seen.weight += f64::from(weights.pixels()[i]) * omega;
            seen.clipped |= panorama.validity.pixels()[i] == Validity::LowerBound;
            shown += usize::from(weights.pixels()[i] > 0.0);
        }
        (10 * shown >= 9 * region.len()).then_some(seen)
    }
}

/// A view with less than this share of the light that another shows does not show the light at all.
const HIDDEN: f64 = 0.5;

/// The view a light is taken from.
fn best(seen: &[(usize, Seen)]) -> Option<usize> {
    let most = |clipped_only: bool| {
        let counted = seen.iter().filter(|(_, s)| s.clipped || !clipped_only);
        counted.map(|(_, s)| s.flux).fold(0.0, f64::max)
    };
    let least = f64::max(REACHED * most(true), HIDDEN * most(false));
    let measured = seen.iter().filter(|(_, s)| !s.clipped && s.flux >= least);
    let finest = measured.max_by(|a, b| a.1.weight.total_cmp(&b.1.weight));
    let brightest = || seen.iter().max_by(|a, b| a.1.flux.total_cmp(&b.1.flux));
    finest.or_else(brightest).map(|(k, _)| *k)
}
