//! Several panoramas of one place → one: each direction from the view that shows it best.
//!
//! [`View`]s turned into one set of axes ([`register`](super::register)) → [`Combined`]. Each weighs by the square of its
//! radial resolution (a ball is finest towards its camera), fading out over 2° towards what it does not
//! show: its blind cone, its photographer ([`people`]). Exposures are brought to the first view's
//! ([`exposure`]). Small lights come whole from one view ([`lights`]): a mean of two would throw two shadows,
//! and a clipped lamp averaged with a measured one would darken it. What no view shows
//! is filled from around or left black, as asked; places are not moved.

mod exposure;
mod lights;
mod people;
mod taper;

use glam::DVec3;
use rayon::prelude::*;

pub use self::exposure::{Equalise, Gain};
use super::fill;
use super::panorama::Panorama;
use super::view::View;
use crate::bracket::Validity;
use crate::conventions::{Rgb, luminance};
use crate::photo::Image;

/// What becomes of directions that no view shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Unseen {
    /// A smooth blend of their surroundings.
    #[default]
    FillAround,
    /// Black, and said to be unseen.
    Black,
}

/// How views are combined.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    pub equalise: Equalise,
    pub unseen: Unseen,
    /// Half-angle of the cone toward its own camera that each view leaves to the others, radians.
    pub photographer_rad: f64,
    /// Angle over which a view fades out, radians.
    pub feather_rad: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            equalise: Equalise::default(),
            unseen: Unseen::default(),
            photographer_rad: 12f64.to_radians(),
            feather_rad: 2f64.to_radians(),
        }
    }
}

/// Why views cannot be combined.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum CombineError {
    #[error("one panorama is nothing to merge; give two or more of the same place")]
    Few,
    #[error(
        "panorama {view} differs from those before it by {stops:+.1} stops, more than {most}: they are not of one \
         scale or not of one light; write both with exposures known (EXIF or --times), or allow more stops"
    )]
    Exposure {
        /// Counted from 1.
        view: usize,
        stops: f64,
        most: f64,
    },
}

/// What one view gave.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Given {
    pub gain: Gain,
    /// Share of the merged light's directions that are its, 0…1.
    pub weight_share: f64,
    /// Solid angle left to others because its photographer or tripod stood there, sr: the cone, and what
    /// was found to disagree.
    pub cone_sr: f64,
    pub people_sr: f64,
}

/// One panorama of all views.
#[derive(Clone, Debug)]
pub struct Combined {
    /// In the axes and the exposure of the first.
    pub panorama: Panorama,
    /// Pixels per degree of the photographs it was made from, as they were weighed; 0 where none shows it.
    pub resolution: Image<f32>,
    pub given: Vec<Given>,
    /// Shares of all directions seen by no view, by one, by two or more.
    pub seen_by: [f64; 3],
    /// Lights that were taken whole from one view.
    pub lights: usize,
}

/// A view being combined: texels in common axes, in the common exposure.
struct Layer {
    panorama: Panorama,
    toward_camera: Option<DVec3>,
    /// Pixels per degree.
    resolution: Image<f32>,
    /// Seen at all.
    seen: Image<bool>,
    /// Seen, and not to be left to others.
    usable: Image<bool>,
}

/// Merges views whose world axes agree; the first gives the exposure, the widest the texels.
///
/// # Errors
/// Fewer than two views, or exposures further apart than [`Equalise`] allows.
pub fn combine(views: &[View], options: &Options) -> Result<Combined, CombineError> {
    if views.len() < 2 {
        return Err(CombineError::Few);
    }
    let width = views.iter().map(|view| view.panorama.width()).max().unwrap_or(0);
    let mut layers: Vec<Layer> =
        views.iter().map(|view| Layer::new(view.in_world_axes(width), options)).collect();
    let gains = exposure::equalise(&mut layers, &options.equalise)?;
    let people_sr = people::leave_out(&mut layers);
    let mut weights: Vec<Image<f32>> =
        layers.iter().map(|layer| layer.weights(options.feather_rad)).collect();
    let lights = lights::take_whole(&layers, &mut weights, options.feather_rad);
    let (mut panorama, resolution) = blend(&layers, &weights);

    let whole = 4.0 * std::f64::consts::PI;
    let shares = weight_shares(&weights, &panorama);
    let given = gains
        .into_iter()
        .zip(people_sr)
        .zip(layers.iter().zip(shares))
        .map(|((gain, people_sr), (layer, weight_share))| Given {
            gain,
            weight_share,
            cone_sr: layer.cone_sr(options),
            people_sr,
        })
        .collect();
    let mut seen_by = [0.0; 3];
    for y in 0..width / 2 {
        let share = panorama.solid_angle(y) / whole;
        for x in 0..width {
            let n = layers.iter().filter(|layer| layer.usable[(x, y)]).count();
            seen_by[n.min(2)] += share;
        }
    }
    if options.unseen == Unseen::FillAround {
        let gap = panorama.validity.map(|class| *class == Validity::Filled);
        if gap.pixels().iter().any(|unseen| !unseen) {
            fill::from_around(&mut panorama, &gap);
        }
    }
    Ok(Combined { panorama, resolution, given, seen_by, lights })
}

impl Layer {
    fn new(view: View, options: &Options) -> Self {
        let (seen, toward_camera) = (view.seen(), view.seeing.toward_camera());
        let (panorama, resolution) = (view.panorama, view.seeing.resolution());
        let (w, h) = (panorama.width(), panorama.height());
        let usable = Image::from_fn(w, h, |x, y| {
            let person = toward_camera.is_some_and(|camera| {
                panorama.direction(x, y).angle_between(camera) < options.photographer_rad
            });
            seen[(x, y)] && !person
        });
        let rows: Vec<Vec<f32>> = (0..h)
            .into_par_iter()
            .map(|y| (0..w).map(|x| resolution(panorama.direction(x, y)) as f32).collect())
            .collect();
        let resolution = Image::from_fn(w, h, |x, y| if seen[(x, y)] { rows[y][x] } else { 0.0 });
        Self { panorama, toward_camera, resolution, seen, usable }
    }

    /// Squared resolution, fading out towards what is not usable.
    fn weights(&self, feather_rad: f64) -> Image<f32> {
        let taper = taper::taper(&self.usable, feather_rad);
        Image::from_fn(taper.width(), taper.height(), |x, y| {
            trust(self.panorama.validity[(x, y)]) * squared(self.resolution[(x, y)]) * taper[(x, y)]
        })
    }

    fn cone_sr(&self, options: &Options) -> f64 {
        match self.toward_camera {
            Some(_) => 2.0 * std::f64::consts::PI * (1.0 - options.photographer_rad.cos()),
            None => 0.0,
        }
    }
}

/// A square that is never quite zero: what is seen at all is seen.
fn squared(resolution: f32) -> f32 {
    (resolution * resolution).max(1e-6)
}

/// Relative weight of a validity class, resolution aside.
fn trust(class: Validity) -> f32 {
    match class {
        Validity::Measured | Validity::Single | Validity::LowerBound | Validity::Analytic => 1.0,
        Validity::UpperBound => 0.25,
        Validity::Moved => 0.05,
        Validity::Filled => 0.0,
    }
}

/// A view's part of a texel.
struct Part<'a> {
    layer: &'a Layer,
    weight: f32,
}

/// One texel of the result.
struct Texel {
    radiance: Rgb,
    variance: Rgb,
    validity: Validity,
    coverage: f32,
    resolution: f32,
}

/// The weighted mean of all layers; what none shows is black and [`Validity::Filled`].
fn blend(layers: &[Layer], weights: &[Image<f32>]) -> (Panorama, Image<f32>) {
    let (w, h) = (weights[0].width(), weights[0].height());
    let rows: Vec<Vec<Texel>> = (0..h)
        .into_par_iter()
        .map(|y| (0..w).map(|x| texel(layers, weights, (x, y))).collect())
        .collect();
    let mut panorama = Panorama::from_radiance(Image::filled(w, h, Rgb::ZERO));
    panorama.place = layers[0].panorama.place;
    let mut resolution = Image::filled(w, h, 0.0);
    for (y, row) in rows.into_iter().enumerate() {
        for (x, texel) in row.into_iter().enumerate() {
            panorama.radiance[(x, y)] = texel.radiance;
            panorama.variance[(x, y)] = texel.variance;
            panorama.validity[(x, y)] = texel.validity;
            panorama.coverage[(x, y)] = texel.coverage;
            resolution[(x, y)] = texel.resolution;
        }
    }
    (panorama, resolution)
}

fn texel(layers: &[Layer], weights: &[Image<f32>], at: (usize, usize)) -> Texel {
    let mut parts: Vec<Part> = layers
        .iter()
        .zip(weights)
        .map(|(layer, weights)| Part { layer, weight: weights[at] })
        .filter(|part| part.weight > 0.0)
        .collect();
    if parts.is_empty() {
        // Better a photographer than nothing, where nobody else looked.
        let seen = layers.iter().filter(|layer| layer.seen[at]);
        parts = seen.map(|layer| Part { layer, weight: squared(layer.resolution[at]) }).collect();
    }
    keep_the_brightest_bound(&mut parts, at);
    mean(&parts, at)
}

/// Where a view is clipped: a measurement above its bound tells more; else the highest bound stands.
fn keep_the_brightest_bound(parts: &mut Vec<Part>, at: (usize, usize)) {
    let light = |part: &Part| luminance(part.layer.panorama.radiance[at]);
    let clipped = |part: &Part| part.layer.panorama.validity[at] == Validity::LowerBound;
    let bounds = parts.iter().filter(|part| clipped(part)).map(light);
    let Some(bound) = bounds.reduce(f32::max) else { return };
    let (sum, weight) = parts
        .iter()
        .filter(|part| !clipped(part))
        .fold((0.0, 0.0), |(sum, all), part| (sum + part.weight * light(part), all + part.weight));
    if weight > 0.0 && sum >= lights::REACHED as f32 * bound * weight {
        parts.retain(|part| !clipped(part));
    } else {
        parts.retain(|part| clipped(part) && light(part) >= bound);
    }
}

fn mean(parts: &[Part], at: (usize, usize)) -> Texel {
    let total: f32 = parts.iter().map(|part| part.weight).sum();
    let mut texel = Texel {
        radiance: Rgb::ZERO,
        variance: Rgb::ZERO,
        validity: Validity::Filled,
        coverage: 0.0,
        resolution: 0.0,
    };
    if total <= 0.0 {
        return texel;
    }
    let share = |part: &Part| part.weight / total;
    for part in parts {
        let Layer { panorama, resolution, .. } = part.layer;
        texel.radiance += panorama.radiance[at] * share(part);
        texel.resolution += resolution[at] * share(part);
        texel.coverage = texel.coverage.max(panorama.coverage[at]);
    }
    let mut scatter = Rgb::ZERO;
    let mut validity = Validity::Measured;
    for part in parts {
        let panorama = &part.layer.panorama;
        let squared = share(part) * share(part);
        texel.variance += panorama.variance[at] * squared;
        let off = panorama.radiance[at] - texel.radiance;
        scatter += off * off * squared;
        // What gives a hundredth does not make the whole of its class.
        if share(part) > 0.01 {
            validity = validity.max(panorama.validity[at]);
        }
    }
    // Views that disagree by more than their noise say how wrong they are.
    texel.variance = texel.variance.max(scatter);
    texel.validity = validity;
    texel
}

/// Each layer's share of all that was merged, by solid angle.
fn weight_shares(weights: &[Image<f32>], panorama: &Panorama) -> Vec<f64> {
    let mut shares = vec![0.0; weights.len()];
    let mut whole = 0.0;
    for y in 0..panorama.height() {
        let omega = panorama.solid_angle(y);
        for x in 0..panorama.width() {
            let total: f32 = weights.iter().map(|w| w[(x, y)]).sum();
            if total > 0.0 {
                whole += omega;
                for (share, w) in shares.iter_mut().zip(weights) {
                    *share += omega * f64::from(w[(x, y)] / total);
                }
            }
        }
    }
    shares.iter().map(|share| share / f64::max(whole, 1e-30)).collect()
}

#[cfg(test)]
#[path = "combine/tests.rs"]
mod tests;
