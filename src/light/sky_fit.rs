//! The clear sky that a probe saw in part, and what it did not see filled with the rest of it.
//!
//! Turbidity and one scale, fitted to what is well known of the sky (methods-capture C8): never the
//! model's own strength. Sums of absolute differences of logarithms, not of squares: houses, trees and
//! small clouds may hide up to half of the sky. The colour is the model's: a probe of another white
//! balance shows a seam.

use glam::{DVec2, DVec3};

use super::preetham::Preetham;
use super::sky::{Sky, SkyError, TURBIDITIES, draw_disc};
use super::sun::{SunSplit, split};
use crate::bracket::Validity;
use crate::conventions::{Rgb, lat_long_pixel, luminance};
use crate::probe::{Panorama, clipped_regions};

/// A sky fitted to a panorama.
#[derive(Clone, Debug)]
pub struct SkyFit {
    /// In the panorama's unit.
    pub sky: Sky,
    /// Relative standard deviation of the well known sky from the model, from its median: a clear
    /// sky's is a few per cent.
    pub residual: f64,
    /// Share of the upper half sphere that the fit saw.
    pub seen: f64,
}

/// A residual above this is not a clear sky, or not only.
pub const LARGEST_RESIDUAL: f64 = 0.15;
/// Less of the upper half sphere says nothing of the rest.
const LEAST_SEEN: f64 = 0.05;
/// So far from the sun and from clipped light its glare is in the lens, degrees.
const GLARE_DEG: f64 = 3.0;
/// Texels that the fit looks at: more do not change it.
const MOST_SAMPLES: usize = 4096;

/// Why no sky can be fitted.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FitError {
    #[error(
        "{:.1} % of the sky is seen, unclipped and away from the sun; {:.0} % are needed to tell its haze: \
         photograph more of it, or calculate it alone (platelight sky)",
        100.0 * .0, 100.0 * LEAST_SEEN
    )]
    TooLittle(f64),
    #[error(transparent)]
    Sky(#[from] SkyError),
}

/// A look at the sky.
struct Sample {
    cos_theta: f64,
    cos_gamma: f64,
    log_luminance: f64,
    solid_angle: f64,
}

/// Fits the clear sky round a sun in `sun`'s direction (world, +Y up) to what `panorama` saw of it.
///
/// `ground` is the albedo below the horizon of the sky that comes back.
///
/// # Errors
/// [`FitError`]: too little of the sky is well known, or the sun is below the horizon.
pub fn fit(panorama: &Panorama, sun: DVec3, ground: Rgb) -> Result<SkyFit, FitError> {
    // Asked first: without a sun in the sky there is nothing to fit.
    let any = Sky::of_model(sun, *TURBIDITIES.start(), ground)?;
    let sun = any.sun().direction.as_dvec3();
    let (samples, seen) = samples(panorama, sun);
    if !(seen >= LEAST_SEEN) {
        return Err(FitError::TooLittle(seen));
    }
    let sun_zenith = sun.x.hypot(sun.z).atan2(sun.y);
    let differences = |turbidity: f64| {
        let preetham = Preetham::new(turbidity, sun_zenith);
        let pairs = samples.iter().map(|s| {
            let model = preetham.radiance(s.cos_theta, s.cos_gamma).as_vec3();
            (s.log_luminance - f64::from(luminance(model)).ln(), s.solid_angle)
        });
        spread(pairs.collect())
    };
    let turbidity = least(|turbidity| differences(turbidity).mean);
    let Spread { median, robust_sigma, .. } = differences(turbidity);
    let sky = Sky::of_model(sun, turbidity, ground)?.with_luminance_scale(median.exp());
    Ok(SkyFit { sky, residual: robust_sigma.exp_m1(), seen })
}

/// The well known sky, thinned evenly, and what share of the upper half sphere all of it is.
fn samples(panorama: &Panorama, sun: DVec3) -> (Vec<Sample>, f64) {
    let clipped = clipped_regions(panorama);
    let near = |direction: DVec3| {
        let within = |light: DVec3, deg: f64| light.angle_between(direction).to_degrees() < deg;
        within(sun, GLARE_DEG)
            || clipped.iter().any(|r| within(r.direction, GLARE_DEG + 0.5 * r.width_deg()))
    };
    let mut all = Vec::new();
    for y in 0..panorama.height() {
        let solid_angle = panorama.solid_angle(y);
        for x in 0..panorama.width() {
            let known = matches!(panorama.validity[(x, y)], Validity::Measured | Validity::Single);
            let l = luminance(panorama.radiance[(x, y)]);
            if !known || panorama.coverage[(x, y)] < 0.5 || !(l > 0.0 && l.is_finite()) {
                continue;
            }
            let direction = panorama.direction(x, y);
            if direction.y > 0.0 && !near(direction) {
                let log_luminance = f64::from(l).ln();
                let (cos_theta, cos_gamma) = (direction.y, direction.dot(sun));
                all.push(Sample { cos_theta, cos_gamma, log_luminance, solid_angle });
            }
        }
    }
    let seen = all.iter().map(|s| s.solid_angle).sum::<f64>() / std::f64::consts::TAU;
    // Every so-many-th texel, at an odd step that falls on other columns in every row.
    let step = all.len().div_ceil(MOST_SAMPLES) | 1;
    (all.into_iter().step_by(step).collect(), seen)
}

struct Spread {
    median: f64,
    /// Mean absolute difference from the median.
    mean: f64,
    /// 1.4826 × the median absolute difference: σ, if they are normal.
    robust_sigma: f64,
}

/// Of values with weights; there is at least one.
fn spread(mut pairs: Vec<(f64, f64)>) -> Spread {
    let median = weighted_median(&mut pairs);
    for (value, _) in &mut pairs {
        *value = (*value - median).abs();
    }
    let whole: f64 = pairs.iter().map(|(_, weight)| weight).sum();
    let mean = pairs.iter().map(|(value, weight)| value * weight).sum::<f64>() / whole;
    Spread { median, mean, robust_sigma: 1.4826 * weighted_median(&mut pairs) }
}

fn weighted_median(pairs: &mut [(f64, f64)]) -> f64 {
    pairs.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let half = 0.5 * pairs.iter().map(|(_, weight)| weight).sum::<f64>();
    let mut sum = 0.0;
    let middle = pairs.iter().find(|(_, weight)| {
        sum += weight;
        sum >= half
    });
    middle.map_or(0.0, |(value, _)| *value)
}

/// The turbidity of the least cost, to 0.01: a grid, for the cost may have two valleys, then a golden
/// section about its best.
fn least(cost: impl Fn(f64) -> f64) -> f64 {
    const GRID: usize = 17;
    let (first, last) = (*TURBIDITIES.start(), *TURBIDITIES.end());
    let step = (last - first) / (GRID - 1) as f64;
    let at = |k: usize| first + step * k as f64;
    let best = (0..GRID).min_by(|&a, &b| cost(at(a)).total_cmp(&cost(at(b)))).unwrap_or(0);
    let (mut low, mut high) = ((at(best) - step).max(first), (at(best) + step).min(last));
    let golden = 0.5 * (5f64.sqrt() - 1.0);
    while high - low > 0.01 {
        let (a, b) = (high - golden * (high - low), low + golden * (high - low));
        if cost(a) < cost(b) { high = b } else { low = a }
    }
    0.5 * (low + high)
}

/// Puts `sky` into the texels above the horizon that were not seen ([`Validity::Filled`]), and its sun if
/// that was not seen either; they become [`Validity::Analytic`]. Returns their share of the upper half
/// sphere.
pub fn fill(panorama: &mut Panorama, sky: &Sky) -> f64 {
    let sun = sky.sun();
    let (width, height) = (panorama.width(), panorama.height());
    let back = panorama.world_from_panorama.conjugate();
    let in_map = back * sun.direction.as_dvec3();
    let pixel = lat_long_pixel(in_map, width, height);
    let texel = |value: f64, n: usize| ((value + 0.5).max(0.0) as usize).min(n - 1);
    let at_sun = (texel(pixel.x, width), texel(pixel.y, height));
    let sun_unseen = panorama.validity[at_sun] == Validity::Filled;
    let mut filled = 0.0;
    for y in 0..height {
        for x in 0..width {
            let up = panorama.direction(x, y).y > 0.0;
            if up && panorama.validity[(x, y)] == Validity::Filled {
                let pixel = DVec2::new(x as f64, y as f64);
                panorama.radiance[(x, y)] =
                    sky.mean_over_texel(pixel, width, height, panorama.world_from_panorama);
                panorama.variance[(x, y)] = Rgb::ZERO;
                panorama.validity[(x, y)] = Validity::Analytic;
                filled += panorama.solid_angle(y);
            }
        }
    }
    if sun_unseen {
        let direction = in_map.as_vec3();
        draw_disc(&mut panorama.radiance, &super::Disc { direction, ..sun });
    }
    filled / std::f64::consts::TAU
}

/// Toward the strongest small light above the horizon, clipped or not; `None` if there is none.
pub fn find_sun(panorama: &Panorama) -> Option<DVec3> {
    let clipped = clipped_regions(panorama).into_iter().find(|r| r.direction.y > 0.0);
    let discs = split(panorama, SunSplit::Always).discs;
    let disc = discs.into_iter().find(|disc| disc.direction.y > 0.0);
    clipped.map(|r| r.direction).or(disc.map(|disc| disc.direction.as_dvec3()))
}

#[cfg(test)]
mod tests {
    use glam::DQuat;

    use super::*;
    use crate::light::sky::DEFAULT_GROUND;
    use crate::light::sun_position::SunPosition;
    use crate::photo::Image;

    const UNIT: f64 = 7.0;

    fn sun(elevation_deg: f64) -> DVec3 {
        SunPosition { azimuth_deg: 250.0, elevation_deg }.direction(0.0)
    }

    /// A sky in another unit than the model's, photographed.
    fn photographed(elevation_deg: f64, turbidity: f64) -> Panorama {
        let sky = Sky::new(sun(elevation_deg), turbidity, DEFAULT_GROUND).expect("a sky");
        let panorama = sky.scaled(UNIT).panorama(256);
        Panorama::from_radiance(panorama.radiance)
    }

    /// Marks what is not to be seen.
    fn hide(panorama: &mut Panorama, hidden: impl Fn(DVec3) -> bool) {
        for y in 0..panorama.height() {
            for x in 0..panorama.width() {
                if hidden(panorama.direction(x, y)) {
                    panorama.radiance[(x, y)] = Rgb::splat(0.123);
                    panorama.validity[(x, y)] = Validity::Filled;
                    panorama.coverage[(x, y)] = 0.0;
                }
            }
        }
    }

    #[test]
    fn haze_and_unit_of_a_half_seen_sky_are_found_and_the_rest_is_filled() {
        for (elevation, turbidity) in [(55.0, 3.0), (20.0, 2.0), (35.0, 6.3), (8.0, 9.9)] {
            let whole = photographed(elevation, turbidity);
            let mut half = whole.clone();
            hide(&mut half, |d| d.x > 0.2);
            let SkyFit { sky, residual, seen } =
                fit(&half, sun(elevation), DEFAULT_GROUND).expect("a fit");
            let at = format!("{elevation} {turbidity}");
            assert!((sky.turbidity() - turbidity).abs() < 0.02, "{at}: {}", sky.turbidity());
            assert!(residual < 0.01 && (0.3..0.7).contains(&seen), "{at}: {residual} {seen}");
            let filled = fill(&mut half, &sky);
            assert!(filled > 0.3, "{filled}");
            for y in 0..half.height() {
                for x in 0..half.width() {
                    // The texels at the horizon, where the model bends most, are the worst.
                    let (found, true_l) = (half.radiance[(x, y)], whole.radiance[(x, y)]);
                    let up = half.direction(x, y).y > 0.0;
                    let off = luminance(found) / luminance(true_l) - 1.0;
                    // The sun was seen on one side only; its disc is in no picture of these.
                    let beside = half.direction(x, y).angle_between(sun(elevation)) > 0.1;
                    assert!(!up || !beside || off.abs() < 0.02, "{at}: ({x}, {y}) {off}");
                }
            }
            assert!(half.share(Validity::Analytic) > 0.15);
            assert!(half.share(Validity::Filled) > 0.15, "the ground stays as it was");
        }
    }

    #[test]
    fn houses_noise_and_a_clipped_sun_do_not_lead_it_astray() {
        let mut panorama = photographed(40.0, 4.0);
        let sun = sun(40.0);
        for y in 0..panorama.height() {
            for x in 0..panorama.width() {
                let d = panorama.direction(x, y);
                let mixed = ((y * 256 + x) as u32).wrapping_mul(2_654_435_761) >> 8;
                let noise = 1.0 + 0.1 * (mixed as f32 / (1 << 24) as f32 - 0.5);
                panorama.radiance[(x, y)] *= noise;
                // Dark fronts over a third of the lower sky
                if d.y < 0.4 && d.z > 0.3 {
                    panorama.radiance[(x, y)] *= 0.1;
                }
                if d.angle_between(sun).to_degrees() < 2.0 {
                    panorama.radiance[(x, y)] = Rgb::splat(1e3);
                    panorama.validity[(x, y)] = Validity::LowerBound;
                }
            }
        }
        assert!(find_sun(&panorama).expect("it is clipped").angle_between(sun).to_degrees() < 0.5);
        let found = fit(&panorama, sun, DEFAULT_GROUND).expect("a fit");
        assert!((found.sky.turbidity() - 4.0).abs() < 0.3, "{}", found.sky.turbidity());
        // ±5 % evenly: the median absolute difference is 2.5 %.
        assert!((0.02..0.1).contains(&found.residual), "{}", found.residual);
    }

    #[test]
    fn an_overcast_sky_is_told_by_its_residual() {
        // Moon and Spencer 1942: three times as bright above as at the horizon, whatever the sun does.
        let overcast = Panorama::from_radiance(Image::from_fn(128, 64, |_, y| {
            let elevation = (0.5 - (y as f64 + 0.5) / 64.0) * std::f64::consts::PI;
            Rgb::splat((1.0 + 2.0 * elevation.sin().max(0.0)) as f32 / 3.0)
        }));
        let found = fit(&overcast, sun(30.0), DEFAULT_GROUND).expect("a fit, if a bad one");
        assert!(found.residual > LARGEST_RESIDUAL, "{}", found.residual);
    }

    #[test]
    fn an_unseen_sun_is_drawn_into_a_turned_map_and_a_seen_one_is_not() {
        let sky = Sky::new(sun(40.0), 3.0, DEFAULT_GROUND).expect("a sky");
        let turn = DQuat::from_rotation_z(0.7) * DQuat::from_rotation_y(2.0);
        let panorama = sky.panorama(256);
        let mut turned = Panorama::from_radiance(panorama.radiance.clone()).rotated(turn);
        for y in 0..128 {
            for x in 0..256 {
                turned.radiance[(x, y)] = sky.radiance(turned.direction(x, y));
            }
        }
        let mut seen = turned.clone();
        hide(&mut seen, |d| d.dot(sun(40.0)) < 0.0);
        hide(&mut turned, |d| d.dot(sun(40.0)) > 0.5);
        for (map, factor) in [(&mut turned, 1.0), (&mut seen, 0.0)] {
            fill(map, &sky);
            let toward = sun(40.0);
            let wanted = panorama.irradiance(toward).y + factor * sky.sun_irradiance().y;
            let found = map.irradiance(toward).y;
            // The ground stays hidden in one of them, at a value of its own.
            assert!((found / wanted - 1.0).abs() < 0.02, "{factor}: {found} {wanted}");
        }
    }

    #[test]
    fn what_shows_too_little_is_refused() {
        let mut panorama = photographed(40.0, 3.0);
        hide(&mut panorama, |d| d.x > -0.9);
        let error = fit(&panorama, sun(40.0), DEFAULT_GROUND).unwrap_err();
        assert!(error.to_string().contains("% of the sky is seen"), "{error}");
        let night = fit(&panorama, -DVec3::Y, DEFAULT_GROUND).unwrap_err();
        assert!(matches!(night, FitError::Sky(SkyError::BelowHorizon(_))), "{night}");
        assert_eq!(find_sun(&photographed(40.0, 3.0)), None);
    }
}
