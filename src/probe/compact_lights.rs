//! Compact bright lights of a panorama: lamps, the sun, also where they are clipped.

use glam::DVec3;

use super::fill::regions;
use super::panorama::Panorama;
use crate::bracket::Validity;
use crate::conventions::luminance;
use crate::photo::Image;

/// Brighter than this many medians is a light, as for [`resample`](super::resample).
const LIGHT_MEDIANS: f32 = 50.0;
/// Wider lights (9° across) are windows and skies, whose middle depends on where one stands.
const WIDEST_SR: f64 = 0.02;
/// Lights with less than this share of all light are left aside.
const LEAST_SHARE: f64 = 0.005;

/// A small light.
#[derive(Clone, Debug, PartialEq)]
pub struct CompactLight {
    /// Unit, world axes: centroid by flux.
    pub direction: DVec3,
    /// Standard error of the direction each way, radians: a share of its width and of a texel.
    pub sigma_rad: f64,
    /// Luminance times solid angle, the panorama's unit times sr.
    pub flux: f64,
    /// The flux is only known from below.
    pub clipped: bool,
    /// Row-major indices of its texels.
    pub texels: Vec<usize>,
}

/// The compact lights of a panorama where it was seen, the brightest first.
pub fn compact_lights(panorama: &Panorama) -> Vec<CompactLight> {
    let seen = |i: usize| {
        panorama.validity.pixels()[i] != Validity::Filled && panorama.coverage.pixels()[i] >= 0.5
    };
    let level = LIGHT_MEDIANS * median(panorama, &seen);
    if level <= 0.0 {
        return Vec::new();
    }
    let width = panorama.width();
    let bright = Image::from_fn(width, panorama.height(), |x, y| {
        seen(y * width + x) && luminance(panorama.radiance[(x, y)]) > level
    });
    let whole = f64::from(luminance(panorama.mean())) * 4.0 * std::f64::consts::PI;
    let mut found: Vec<CompactLight> =
        regions(&bright).into_iter().filter_map(|texels| light(panorama, texels, whole)).collect();
    found.sort_by(|a, b| b.flux.total_cmp(&a.flux));
    found
}

fn light(panorama: &Panorama, texels: Vec<usize>, whole: f64) -> Option<CompactLight> {
    let width = panorama.width();
    let (mut flux, mut moment, mut solid_angle) = (0.0, DVec3::ZERO, 0.0);
    for &i in &texels {
        let (x, y) = (i % width, i / width);
        let omega = panorama.solid_angle(y);
        let shone = f64::from(luminance(panorama.radiance[(x, y)])) * omega;
        flux += shone;
        moment += panorama.direction(x, y) * shone;
        solid_angle += omega;
    }
    if solid_angle > WIDEST_SR || flux < LEAST_SHARE * whole {
        return None;
    }
    let clipped = texels.iter().any(|&i| panorama.validity.pixels()[i] == Validity::LowerBound);
    let across = 2.0 * (solid_angle / std::f64::consts::PI).sqrt();
    let texel = std::f64::consts::TAU / width as f64;
    // Glare round a clipped light is seldom even.
    let sigma_rad = across * if clipped { 0.15 } else { 0.05 } + 0.25 * texel;
    Some(CompactLight { direction: moment.try_normalize()?, sigma_rad, flux, clipped, texels })
}

/// Median luminance over the texels that were seen, by their number.
fn median(panorama: &Panorama, seen: &dyn Fn(usize) -> bool) -> f32 {
    let mut values: Vec<f32> = panorama
        .radiance
        .pixels()
        .iter()
        .enumerate()
        .filter(|(i, _)| seen(*i))
        .map(|(_, l)| luminance(*l))
        .collect();
    let middle = values.len() / 2;
    match values.is_empty() {
        true => 0.0,
        false => *values.select_nth_unstable_by(middle, f32::total_cmp).1,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::conventions::Rgb;

    #[test]
    fn small_bright_lights_are_found_and_windows_are_not() {
        let mut panorama = Panorama::from_radiance(Image::filled(720, 360, Rgb::ONE));
        let mut light = |towards: DVec3, angle: f64, l: f32, class: Validity| {
            for y in 0..360 {
                for x in 0..720 {
                    if panorama.direction(x, y).angle_between(towards) < angle {
                        panorama.radiance[(x, y)] = Rgb::splat(l);
                        panorama.validity[(x, y)] = class;
                    }
                }
            }
        };
        let (sun, window) = (DVec3::new(0.3, 0.5, -1.0).normalize(), DVec3::X);
        light(sun, 0.02, 3000.0, Validity::LowerBound);
        light(window, 0.3, 100.0, Validity::Measured);
        light(DVec3::NEG_Y, 0.02, 3000.0, Validity::Filled);
        let found = compact_lights(&panorama);
        assert_eq!(found.len(), 1, "{found:?}");
        assert!(found[0].clipped && found[0].direction.angle_between(sun) < 1e-3);
        let cap = 2.0 * std::f64::consts::PI * (1.0 - 0.02f64.cos());
        // The disc is a staircase five texels across.
        assert!((found[0].flux / (3000.0 * cap) - 1.0).abs() < 0.1);
        let dark = Panorama::from_radiance(Image::filled(16, 8, Rgb::ZERO));
        assert!(compact_lights(&dark).is_empty());
    }
}
