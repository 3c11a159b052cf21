//! What is far away in the demo's place: late sky with thin cloud, sea and hills, and a hazy sun.
//!
//! Radiance is in the plate's linear values (white = 1). The sun is a uniform disc, wider than the
//! real one (haze), so that the shortest photograph of the bracket does not clip.

use glam::{DVec2, DVec3};

use crate::paint::{fbm, smooth};
use crate::sampling::around;

/// The sun's angular radius, radians.
pub const SUN_RADIUS_RAD: f64 = 0.018;

/// Unit vector towards the sun's centre.
pub fn sun_direction() -> DVec3 {
    DVec3::new(-0.74, 0.50, -0.36).normalize()
}

/// Irradiance of the sun on a surface that faces it.
pub const SUN_IRRADIANCE: DVec3 = DVec3::new(4.9, 3.75, 2.55);

/// Solid angle of the sun's disc, sr.
pub fn sun_solid_angle() -> f64 {
    std::f64::consts::TAU * (1.0 - SUN_RADIUS_RAD.cos())
}

/// Radiance of the sun's disc.
pub fn sun_radiance() -> DVec3 {
    SUN_IRRADIANCE / sun_solid_angle()
}

/// A direction uniformly on the sun's disc; its density is 1 / [`sun_solid_angle`].
pub fn sample_sun(u: DVec2) -> DVec3 {
    around(sun_direction(), 1.0 - u.x * (1.0 - SUN_RADIUS_RAD.cos()), u.y)
}

/// True if `direction` points into the sun's disc.
pub fn in_sun(direction: DVec3) -> bool {
    direction.dot(sun_direction()) > SUN_RADIUS_RAD.cos()
}

/// Radiance of everything far away in `direction`, without the sun's disc.
pub fn radiance(d: DVec3) -> DVec3 {
    let azimuth = d.z.atan2(d.x);
    if d.y < 0.0 {
        return sea(d, azimuth);
    }
    let ridge = 0.035 + 0.05 * fbm(DVec3::new(azimuth * 3.0, 0.0, 5.0), 5);
    let open_sea = smooth(0.45, 1.0, (azimuth + 1.75).abs());
    let haze = DVec3::new(0.72, 0.64, 0.54);
    if d.y < ridge * open_sea {
        return DVec3::new(0.20, 0.24, 0.30).lerp(haze, 0.45);
    }
    clear_sky(d).lerp(cloud_light(d), cloud_cover(d))
}

fn sea(d: DVec3, azimuth: f64) -> DVec3 {
    let depth = smooth(0.0, 0.22, -d.y);
    let water = DVec3::new(0.34, 0.42, 0.46).lerp(DVec3::new(0.055, 0.125, 0.17), depth.sqrt());
    let ripple = fbm(DVec3::new(azimuth * 40.0, 0.0, 6.0 / (0.02 - d.y)), 4);
    water * (1.0 + 0.25 * ripple)
}

fn clear_sky(d: DVec3) -> DVec3 {
    let height = d.y.max(0.0);
    let zenith = DVec3::new(0.070, 0.135, 0.29);
    let horizon = DVec3::new(0.62, 0.55, 0.47);
    let blue = zenith.lerp(horizon, (-height / 0.20).exp() * 0.85);
    let angle = d.dot(sun_direction()).clamp(-1.0, 1.0).acos();
    let glow = 0.55 * (-angle / 0.30).exp() + 1.6 * (-angle / 0.06).exp();
    blue + DVec3::new(1.0, 0.78, 0.50) * glow
}

/// Share of a direction that thin cloud covers: a flat layer seen in perspective.
fn cloud_cover(d: DVec3) -> f64 {
    let layer = DVec3::new(d.x, 0.0, d.z) / (d.y + 0.12);
    let streaks = fbm(DVec3::new(layer.x * 0.9, 1.7, layer.z * 2.1), 6);
    0.75 * smooth(0.02, 0.42, streaks) * smooth(0.02, 0.16, d.y)
}

fn cloud_light(d: DVec3) -> DVec3 {
    let toward_sun = 0.5 + 0.5 * d.dot(sun_direction());
    DVec3::new(0.50, 0.47, 0.45) + DVec3::new(0.50, 0.38, 0.24) * toward_sun.powi(3)
}
