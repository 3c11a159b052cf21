//! The strength of a sun that clipped in every photograph of the probe.
//!
//! Its direction is known (the centroid of the clipped region), its flux only from below. What it
//! does to surfaces is in the plate, though: methods-capture C7 gives the irradiance `E_n` on a
//! plane facing the sun from what the plate shows, with `E_k` the irradiance by everything else.
//!
//! 1. the lit support, if its albedo ρ is given: `E_n = (πL/ρ − E_k)/cos θ`;
//! 2. a real shadow on the support, albedo unknown: `E_n = (r·E_k,shadow − E_k,lit)/cos θ`, with
//!    `r = L_lit/L_shadow` of neighbouring pixels.
//!
//! `E_k` is integrated over the panorama without the sun, from the very point: rays that meet the
//! modelled local scene are answered by the panorama too, in the direction in which the probe saw
//! the point that was met. Estimates are combined by inverse variance.

use std::f64::consts::PI;

use glam::DVec3;
use thiserror::Error;

use super::sun::COMPACT_SR;
use super::support_grid::{SupportGrid, SupportSample, TILES_OF_A_SAMPLE, median_radiance};
use crate::camera::Camera;
use crate::conventions::{Rgb, SUN_HALF_ANGLE_RAD, lat_long_pixel, luminance};
use crate::photo::Image;
use crate::probe::Panorama;
use crate::scene::Scene;
use crate::trace::{Accel, Hit, Ray};

/// Relative doubt of the irradiance by everything but the sun (methods-capture C7's budget).
const SIGMA_KNOWN_IRRADIANCE: f64 = 0.05;
/// Rays per estimate of the known irradiance, a square number: stratified, cosine-weighted.
const IRRADIANCE_RAYS_PER_SIDE: usize = 24;
/// Why a clipped sun could not be recovered.
#[derive(Debug, Error)]
pub enum RecoverError {
    #[error(
        "the plate shows neither a lit surface of known albedo nor a modelled shadow, so the \
         clipped sun's strength stays unknown"
    )]
    NoEvidence,
    #[error(
        "the support is as dark in the sun as out of it (irradiance by the sun {0:.4} of the \
         plate's scale, by all else {1:.4}): the clipped region is no sun"
    )]
    NotASun(f64, f64),
}

/// One estimate of the sun's irradiance on a plane facing it.
#[derive(Clone, Debug, PartialEq)]
pub struct Evidence {
    pub method: Method,
    /// Per channel, the plate's scale times sr.
    pub irradiance_normal: DVec3,
    /// Relative standard error.
    pub sigma: f64,
    /// How many independent places it rests on.
    pub places: usize,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// The lit support, of given albedo.
    KnownAlbedo,
    /// A modelled shadow on the support.
    Shadow,
}

/// What the plate says of a clipped sun.
#[derive(Clone, Debug, PartialEq)]
pub struct RecoveredSun {
    /// Unit, world: toward the sun.
    pub direction: DVec3,
    pub half_angle_rad: f64,
    /// Irradiance on a plane facing the sun, per channel, in the plate's scale times sr.
    pub irradiance_normal: DVec3,
    /// Relative standard error of `irradiance_normal`.
    pub sigma: f64,
    /// All estimates, the ones combined above.
    pub evidence: Vec<Evidence>,
}

impl RecoveredSun {
    /// Radiance of a uniform disc with this irradiance.
    pub fn radiance(&self) -> Rgb {
        let projected_solid_angle = PI * self.half_angle_rad.sin().powi(2);
        (self.irradiance_normal / projected_solid_angle).as_vec3()
    }
}

/// The shot as the recovery sees it: the plate, its camera and the modelled local scene.
pub struct Stage<'a> {
    /// Linear plate; `clipped` pixels are ignored.
    pub plate: &'a Image<Rgb>,
    pub clipped: &'a Image<bool>,
    pub camera: &'a Camera,
    /// Light by everything but the sun: the clipped texels already filled by their surroundings.
    pub panorama: &'a Panorama,
    pub scene: &'a Scene,
    /// Built over the meshes of `scene.local`, in their order.
    pub local: &'a Accel,
    /// The support's albedo and its relative standard error, if the shot gives it.
    pub support_albedo: Option<(Rgb, f64)>,
}

/// Largest clipped region that can be one small light whatever its texels: 5° across.
const LARGEST_SR: f64 = 6e-3;

/// Half angle of the disc that stands for a light whose clipped texels cover `solid_angle` of a
/// lat-long map `map_width` texels wide; `None` if that is too much for a light that throws one hard
/// shadow: a window, a bright sky.
///
/// Blooming and the resampler add up to a texel and a half all round; what is left is the light's
/// own, never smaller than the sun.
pub fn half_angle_of(solid_angle: f64, map_width: usize) -> Option<f64> {
    let texel = 2.0 * PI / map_width as f64;
    if solid_angle > (COMPACT_SR + 9.0 * texel * texel).min(LARGEST_SR) {
        return None;
    }
    let seen = (solid_angle / PI).sqrt();
    Some((seen - 1.5 * texel).max(SUN_HALF_ANGLE_RAD))
}

/// Finds the irradiance of a sun in `direction` (unit, world) from what it does in the plate.
pub fn recover(
    stage: &Stage,
    direction: DVec3,
    half_angle_rad: f64,
) -> Result<RecoveredSun, RecoverError> {
    let samples = SupportGrid::sample(stage, direction);
    let mut evidence = Vec::new();
    evidence.extend(by_shadow(stage, &samples, direction));
    evidence.extend(by_support_albedo(stage, &samples, direction));

    if evidence.is_empty() {
        return Err(RecoverError::NoEvidence);
    }
    let weight_sum: f64 = evidence.iter().map(|e| e.sigma.powi(-2)).sum();
    let irradiance_normal =
        evidence.iter().map(|e| e.irradiance_normal * e.sigma.powi(-2)).sum::<DVec3>() / weight_sum;
    if irradiance_normal.min_element() <= 0.0 {
        let known = stage.known_irradiance(stage.panorama.place, DVec3::Y);
        return Err(RecoverError::NotASun(
            luminance(irradiance_normal.as_vec3()).into(),
            luminance(known.as_vec3()).into(),
        ));
    }
    Ok(RecoveredSun {
        direction,
        half_angle_rad,
        irradiance_normal,
        sigma: weight_sum.powf(-0.5),
        evidence,
    })
}

impl Stage<'_> {
    /// Irradiance (plate's scale times sr) at a world point by everything but the sun.
    fn known_irradiance(&self, point: DVec3, normal: DVec3) -> DVec3 {
        let n = IRRADIANCE_RAYS_PER_SIDE;
        let (tangent, bitangent) = normal.any_orthonormal_pair();
        let mut sum = DVec3::ZERO;
        for i in 0..n {
            for j in 0..n {
                // Centres of equal-area cells of the unit disc, lifted to the hemisphere: pdf = cos θ/π
                let r = ((i as f64 + 0.5) / n as f64).sqrt();
                let phi = 2.0 * PI * (j as f64 + 0.5) / n as f64;
                let height = (1.0 - r * r).sqrt();
                let direction =
                    tangent * (r * phi.cos()) + bitangent * (r * phi.sin()) + normal * height;
                sum += self.known_radiance(point, normal, direction);
            }
        }
        sum * PI / (n * n) as f64
    }

    /// Radiance that arrives at `point` from `direction`, the sun left out.
    fn known_radiance(&self, point: DVec3, normal: DVec3, direction: DVec3) -> DVec3 {
        let ray = self.ray_from(point, normal, direction);
        let seen_from_probe = match self.local.closest(&ray) {
            Some(hit) => {
                self.scene.origin + (ray.origin + ray.direction * hit.t).as_dvec3()
                    - self.panorama.place
            }
            None => direction,
        };
        texel(self.panorama, seen_from_probe.try_normalize().unwrap_or(direction)).as_dvec3()
    }

    pub(super) fn sees_sun(&self, point: DVec3, normal: DVec3, direction: DVec3) -> bool {
        normal.dot(direction) > 0.0
            && !self.local.occluded(&self.ray_from(point, normal, direction))
    }

    /// How far from `point` the thing stands that hides `direction` from it, metres.
    pub(super) fn distance_to_shade(
        &self,
        point: DVec3,
        normal: DVec3,
        direction: DVec3,
    ) -> Option<f64> {
        Some(f64::from(self.local.closest(&self.ray_from(point, normal, direction))?.t))
    }

    /// Geometric normal of the triangle that was hit; `None` if it has no area.
    pub(super) fn normal(&self, hit: &Hit) -> Option<DVec3> {
        let mesh = &self.scene.local[hit.mesh as usize].mesh;
        let [a, b, c] = mesh.triangles[hit.triangle as usize]
            .map(|corner| mesh.positions[corner as usize].as_dvec3());
        (b - a).cross(c - a).try_normalize()
    }

    fn ray_from(&self, point: DVec3, normal: DVec3, direction: DVec3) -> Ray {
        let local = point - self.scene.origin;
        // Clear of the surface itself: f32 positions carry 6e-8 of their size
        let lift = 1e-4 + 1e-6 * local.length();
        let facing = if normal.dot(direction) < 0.0 { -normal } else { normal };
        Ray {
            origin: (local + facing * lift).as_vec3(),
            direction: direction.as_vec3(),
            t_min: 0.0,
            t_max: f32::INFINITY,
        }
    }
}

/// Radiance of the nearest texel in a world direction.
fn texel(panorama: &Panorama, direction: DVec3) -> Rgb {
    let (width, height) = (panorama.radiance.width(), panorama.radiance.height());
    let local = panorama.world_from_panorama.inverse() * direction;
    let pixel = lat_long_pixel(local, width, height);
    let x = (pixel.x.round().max(0.0) as usize).min(width - 1);
    let y = (pixel.y.round().max(0.0) as usize).min(height - 1);
    panorama.radiance[(x, y)]
}

/// Method 2: shadows that the local scene throws on the support.
fn by_shadow(stage: &Stage, grid: &SupportGrid, sun: DVec3) -> Option<Evidence> {
    let estimates: Vec<DVec3> = grid
        .split_tiles()
        .iter()
        .filter_map(|[lit, shadowed]| {
            let ratio = median_radiance(lit)? / median_radiance(shadowed)?;
            let cos = lit[0].normal.dot(sun);
            let [lit, shadowed] = [lit, shadowed].map(|side| mean_known_irradiance(stage, side));
            Some((ratio * shadowed - lit) / cos)
        })
        .filter(|e| e.is_finite())
        .collect();
    let combined = robust_mean(&estimates, estimates.len() as f64 / TILES_OF_A_SAMPLE)?;
    // The known irradiance enters in proportion, the scatter of the tiles tells the rest
    let sigma = combined.sigma.hypot(2.0 * SIGMA_KNOWN_IRRADIANCE);
    Some(Evidence {
        method: Method::Shadow,
        irradiance_normal: combined.mean,
        sigma,
        places: estimates.len(),
    })
}

/// Method 1 on the support itself, where the shot gives its albedo.
fn by_support_albedo(stage: &Stage, grid: &SupportGrid, sun: DVec3) -> Option<Evidence> {
    let (albedo, sigma_albedo) = stage.support_albedo?;
    let lit = grid.lit();
    let centre = lit.get(lit.len() / 2)?;
    let cos = centre.normal.dot(sun);
    let known = stage.known_irradiance(centre.point, centre.normal);
    let total = median_radiance(&lit)? * PI / albedo.as_dvec3();
    let irradiance_normal = (total - known) / cos;
    if !irradiance_normal.is_finite() || irradiance_normal.min_element() <= 0.0 {
        return None;
    }
    let share = |e: DVec3| luminance((e / (irradiance_normal * cos)).as_vec3()) as f64;
    let sigma = (sigma_albedo * share(total)).hypot(SIGMA_KNOWN_IRRADIANCE * share(known));
    Some(Evidence { method: Method::KnownAlbedo, irradiance_normal, sigma, places: 1 })
}

/// Known irradiance averaged over a few samples spread evenly through the list.
fn mean_known_irradiance(stage: &Stage, samples: &[SupportSample]) -> DVec3 {
    let step = samples.len().div_ceil(4);
    let chosen: Vec<&SupportSample> = samples.iter().step_by(step).collect();
    let sum: DVec3 = chosen.iter().map(|s| stage.known_irradiance(s.point, s.normal)).sum();
    sum / chosen.len() as f64
}

struct RobustMean {
    mean: DVec3,
    /// Relative standard error of its luminance.
    sigma: f64,
}

/// Per-channel median with the standard error that the median absolute deviation tells, as many of them being
/// `independent`; `None` for fewer than two estimates or a median that is not positive.
fn robust_mean(estimates: &[DVec3], independent: f64) -> Option<RobustMean> {
    if estimates.len() < 2 {
        return None;
    }
    let median = |mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        0.5 * (values[(values.len() - 1) / 2] + values[values.len() / 2])
    };
    let mean =
        DVec3::from_array([0, 1, 2].map(|c| median(estimates.iter().map(|e| e[c]).collect())));
    if mean.min_element() <= 0.0 {
        return None;
    }
    let brightness: Vec<f64> =
        estimates.iter().map(|e| f64::from(luminance((e / mean).as_vec3()))).collect();
    let deviation = median(brightness.iter().map(|b| (b - 1.0).abs()).collect());
    // 1.4826 turns the median deviation into σ of a normal law, 1.2533 is the median's own price
    let sigma = 1.4826 * 1.2533 * deviation / independent.max(1.0).sqrt();
    Some(RobustMean { mean, sigma })
}

#[cfg(test)]
mod tests {
    use super::super::test_yard::{CARD, SUN, camera, photograph, sky, yard};
    use super::*;
    use crate::scene::Mesh;

    fn recover_in_yard(
        support_albedo: Option<(Rgb, f64)>,
        plate: &Image<Rgb>,
        scene: &Scene,
        sun: DVec3,
    ) -> Result<RecoveredSun, RecoverError> {
        let meshes: Vec<&Mesh> = scene.local.iter().map(|l| &l.mesh).collect();
        let local = Accel::build(&meshes);
        let stage = Stage {
            plate,
            clipped: &Image::filled(plate.width(), plate.height(), false),
            camera: &camera(),
            panorama: &sky(),
            scene,
            local: &local,
            support_albedo,
        };
        recover(&stage, sun, SUN_HALF_ANGLE_RAD)
    }

    fn sun_direction() -> DVec3 {
        DVec3::new(-0.25, 1.0, 0.1).normalize()
    }

    fn assert_recovered(found: &RecoveredSun, tolerance: f64) {
        let off = (found.irradiance_normal / SUN - 1.0).abs().max_element();
        assert!(off < tolerance, "{} is off by {off}", found.irradiance_normal);
    }

    #[test]
    fn a_real_shadow_tells_the_sun_without_an_albedo() {
        let sun = sun_direction();
        let plate = photograph(&camera(), sun, 0.3, CARD);
        let found = recover_in_yard(None, &plate, &yard(CARD), sun).unwrap();
        assert_eq!(found.evidence[0].method, Method::Shadow);
        // The photograph leaves out the 1.5 % of sky behind the card; tiles leave texture in the ratio.
        assert_recovered(&found, 0.05);
        assert!(found.sigma > 0.05 && found.sigma < 0.2, "stated {}", found.sigma);
    }

    #[test]
    fn a_known_albedo_tells_the_sun_without_a_shadow() {
        let sun = sun_direction();
        let plate = photograph(&camera(), sun, 0.3, CARD);
        let mut scene = yard(CARD);
        scene.local.truncate(1);
        let albedo = Some((Rgb::splat(0.3), 0.05));
        let found = recover_in_yard(albedo, &plate, &scene, sun).unwrap();
        assert_eq!(found.evidence.len(), 1);
        assert_recovered(&found, 0.02);
    }

    #[test]
    fn without_shadow_or_albedo_the_strength_stays_unknown() {
        let sun = sun_direction();
        let mut scene = yard(CARD);
        scene.local.truncate(1);
        let plate = photograph(&camera(), sun, 0.3, CARD);
        let found = recover_in_yard(None, &plate, &scene, sun);
        assert!(matches!(found, Err(RecoverError::NoEvidence)));
    }

    #[test]
    fn a_clipped_window_is_no_sun_and_a_lamp_keeps_its_size() {
        let disc = |degrees: f64| PI * (0.5 * degrees).to_radians().powi(2);
        assert_eq!(half_angle_of(disc(0.53), 2048), Some(SUN_HALF_ANGLE_RAD));
        // A sun bloomed over 3 × 3 texels of 0.7°.
        let texel = 2.0 * PI / 512.0;
        assert_eq!(half_angle_of(9.0 * texel * texel, 512), Some(SUN_HALF_ANGLE_RAD));
        let lamp = half_angle_of(disc(2.0), 2048).unwrap().to_degrees();
        assert!((0.7..1.0).contains(&lamp), "{lamp}");
        for width in [128, 512, 2048] {
            assert_eq!(half_angle_of(disc(8.0), width), None, "a window in {width} texels");
        }
        assert_eq!(half_angle_of(disc(3.0), 2048), None);
    }
}
