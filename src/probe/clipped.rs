//! Lights that clipped in every exposure: where they are and what they shine at least.

use glam::DVec3;

use super::fill::regions;
use super::panorama::Panorama;
use crate::bracket::Validity;
use crate::conventions::{Rgb, luminance};

/// A connected patch of the sky whose radiance is only known from below.
#[derive(Clone, Debug, PartialEq)]
pub struct ClippedRegion {
    /// Unit, world axes: centroid by flux.
    pub direction: DVec3,
    /// Solid angle, sr.
    pub solid_angle: f64,
    /// Flux that it has at least, per channel: `∫ L dω`, the panorama's unit times sr.
    pub lower_bound: Rgb,
    /// Row-major indices of its texels.
    pub texels: Vec<usize>,
}

impl ClippedRegion {
    /// Angle of the disc of the same solid angle, degrees across.
    pub fn width_deg(&self) -> f64 {
        let share = (self.solid_angle / (2.0 * std::f64::consts::PI)).min(2.0);
        2.0 * (1.0 - share).acos().to_degrees()
    }
}

/// "0.9° wide, azimuth 25° (from +Z towards +X), elevation 40°".
impl std::fmt::Display for ClippedRegion {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        let azimuth = self.direction.x.atan2(self.direction.z).to_degrees();
        let elevation = self.direction.y.clamp(-1.0, 1.0).asin().to_degrees();
        let width = self.width_deg();
        write!(
            f,
            "{width:.1}° wide, azimuth {azimuth:.0}° (+Z is 0°, +X is 90°), elevation {elevation:.0}°"
        )
    }
}

/// The clipped regions of a panorama, the one with the most light first.
pub fn clipped_regions(panorama: &Panorama) -> Vec<ClippedRegion> {
    let clipped = panorama.validity.map(|v| *v == Validity::LowerBound);
    let mut found: Vec<ClippedRegion> = regions(&clipped)
        .into_iter()
        .map(|texels| {
            let (mut flux, mut moment, mut solid_angle) = (DVec3::ZERO, DVec3::ZERO, 0.0);
            for &index in &texels {
                let (x, y) = (index % panorama.width(), index / panorama.width());
                let l = panorama.radiance[(x, y)];
                let d_omega = panorama.solid_angle(y);
                flux += l.as_dvec3() * d_omega;
                // The tiny floor places black regions too.
                let weight = f64::from(luminance(l)).max(1e-30) * d_omega;
                moment += panorama.direction(x, y) * weight;
                solid_angle += d_omega;
            }
            let direction = moment.try_normalize().unwrap_or(DVec3::Y);
            ClippedRegion { direction, solid_angle, lower_bound: flux.as_vec3(), texels }
        })
        .collect();
    found.sort_by(|a, b| luminance(b.lower_bound).total_cmp(&luminance(a.lower_bound)));
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::photo::Image;

    #[test]
    fn regions_are_found_across_seam_and_pole_with_their_flux() {
        let mut panorama = Panorama::from_radiance(Image::filled(360, 180, Rgb::ONE));
        let mut mark = |towards: DVec3, angle: f64, l: f32| {
            for y in 0..180 {
                for x in 0..360 {
                    if panorama.direction(x, y).angle_between(towards) < angle {
                        panorama.radiance[(x, y)] = Rgb::splat(l);
                        panorama.validity[(x, y)] = Validity::LowerBound;
                    }
                }
            }
        };
        let seam = DVec3::new(0.0, 0.3, -1.0).normalize();
        mark(seam, 0.1, 50.0);
        mark(DVec3::Y, 0.1, 100.0);
        let found = clipped_regions(&panorama);
        assert_eq!(found.len(), 2);
        assert!(found[0].direction.angle_between(DVec3::Y) < 1e-3);
        assert!(found[1].direction.angle_between(seam) < 5e-3);
        let cap = 2.0 * std::f64::consts::PI * (1.0 - 0.1f64.cos());
        assert!((found[1].solid_angle / cap - 1.0).abs() < 0.05);
        assert!((f64::from(found[1].lower_bound.x) / (50.0 * cap) - 1.0).abs() < 0.05);
        assert!((found[1].width_deg() - 11.46).abs() < 0.4);
        assert!(found[0].to_string().contains("elevation 90°"), "{}", found[0]);
    }

    #[test]
    fn nothing_clipped_is_nothing_found() {
        let panorama = Panorama::from_radiance(Image::filled(8, 4, Rgb::ONE));
        assert!(clipped_regions(&panorama).is_empty());
    }
}
