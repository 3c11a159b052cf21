//! A light that is modelled apart leaves the panorama, so that it does not shine twice.

use std::f64::consts::PI;

use glam::{DVec2, DVec3};

use super::median::median_per_channel;
use crate::bracket::Validity;
use crate::conventions::{Rgb, cap_height, lat_long_direction, luminance};
use crate::probe::Panorama;

/// What stands in a cone of the panorama, and round it.
#[derive(Clone, Debug)]
pub struct Spot {
    texels: Vec<(usize, usize)>,
    /// Median of the ring round the cone, by channel.
    pub surroundings: Rgb,
    /// ∫ (L − surroundings) dω over the cone, by channel.
    pub flux: DVec3,
    /// Where the flux comes from; the cone's axis if there is none.
    pub direction: DVec3,
    /// Share of the cone that the probe really saw, 0…1.
    pub seen: f64,
    /// Whether a part of it clipped in every exposure.
    pub clipped: bool,
}

impl Spot {
    /// Looks at the cone around `direction` (world, unit); the surroundings are the ring out to twice
    /// its half angle, clipped texels left out. `None` if either is empty.
    pub fn look(panorama: &Panorama, direction: DVec3, half_angle_rad: f64) -> Option<Self> {
        let (width, height) = (panorama.radiance.width(), panorama.radiance.height());
        let axis = panorama.world_from_panorama.inverse() * direction;
        let mut texels = Vec::new();
        let mut ring: Vec<Rgb> = Vec::new();
        for y in 0..height {
            for x in 0..width {
                let texel = lat_long_direction(DVec2::new(x as f64, y as f64), width, height);
                let angle = axis.angle_between(texel);
                if angle <= half_angle_rad {
                    texels.push((x, y));
                } else if angle <= 2.0 * half_angle_rad
                    && panorama.validity[(x, y)] != Validity::LowerBound
                {
                    ring.push(panorama.radiance[(x, y)]);
                }
            }
        }
        if texels.is_empty() {
            return None;
        }
        let surroundings = median_per_channel(&ring)?;
        let (mut flux, mut centroid, mut seen, mut all) = (DVec3::ZERO, DVec3::ZERO, 0.0, 0.0);
        for &(x, y) in &texels {
            let solid_angle = panorama.solid_angle(y);
            let excess = (panorama.radiance[(x, y)] - surroundings).as_dvec3() * solid_angle;
            flux += excess;
            centroid += panorama.direction(x, y) * excess.element_sum().max(0.0);
            seen += f64::from(panorama.coverage[(x, y)]) * solid_angle;
            all += solid_angle;
        }
        let direction = centroid.try_normalize().unwrap_or(direction);
        let clipped = texels.iter().any(|&at| panorama.validity[at] == Validity::LowerBound);
        Some(Self { texels, surroundings, flux, direction, seen: seen / all, clipped })
    }

    /// Puts the surroundings in the place of what was seen; its texels become
    /// [`Validity::Analytic`].
    pub fn fill(&self, panorama: &mut Panorama) {
        for &at in &self.texels {
            panorama.radiance[at] = self.surroundings;
            panorama.validity[at] = Validity::Analytic;
        }
    }
}

/// Takes a light that is modelled apart out of the panorama: its texels get the median of their
/// surroundings and become [`Validity::Analytic`].
///
/// `half_angle_rad` is that of the cone around `direction` (world) to clear; the surroundings are
/// the ring out to twice that, clipped texels left out. Nothing changes if the ring is empty.
pub fn take_out(panorama: &mut Panorama, direction: DVec3, half_angle_rad: f64) {
    if let Some(spot) = Spot::look(panorama, direction, half_angle_rad) {
        spot.fill(panorama);
    }
}

/// A lamp that the probe saw, taken out of its panorama.
#[derive(Clone, Copy, Debug)]
pub struct TakenLamp {
    /// Mean over its disc, above the surroundings, by channel: its flux at the probe is what the
    /// panorama lost.
    pub radiance: Rgb,
    /// Angle between where it should be seen and where its light came from, radians.
    pub off_rad: f64,
    /// Whether it clipped in every exposure: then it is at least as strong.
    pub clipped: bool,
    /// The middle (unit, world) and the half angle, radians, of the cone that was cleared.
    pub cleared: (DVec3, f64),
}

/// Why a lamp stays in the panorama.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum NoLamp {
    /// The probe stands in it.
    Inside,
    /// The probe saw less than half of its directions.
    Unseen,
    /// It is no brighter than what is round it.
    NotHot { excess: f32, surroundings: f32 },
}

/// A lamp's mean radiance exceeds its surroundings by this share of them at least.
const HOT_SHARE: f32 = 0.1;

/// Tape, pose and rim together put a lamp no farther beside its place than this, radians: 3°.
const ASTRAY_RAD: f64 = 0.052;

/// Takes the lamp of `radius` (m) at `at` (world) out of the panorama.
///
/// It is looked for within 3° of its place and the parallax of a probe of `probe_radius` (m), which
/// sees it from its surface. Its cone is cleared half as wide again and two texels more: blooming and
/// the resampler spread a lamp over its neighbours.
pub fn take_out_lamp(
    panorama: &mut Panorama,
    at: DVec3,
    radius: f64,
    probe_radius: f64,
) -> Result<TakenLamp, NoLamp> {
    let to = at - panorama.place;
    let sin = radius / to.length();
    if !(sin < 1.0) {
        return Err(NoLamp::Inside);
    }
    let texel = 2.0 * PI / panorama.width() as f64;
    let own = sin.asin() + texel;
    let half_angle = 1.5 * sin.asin() + 2.0 * texel;
    let direction = to.normalize();
    let parallax = (probe_radius / to.length()).min(1.0).asin();
    let shown = brightest_disc(panorama, direction, own, ASTRAY_RAD + parallax);
    let spot = Spot::look(panorama, shown, half_angle).ok_or(NoLamp::Unseen)?;
    if spot.seen < 0.5 {
        return Err(NoLamp::Unseen);
    }
    let solid_angle = 2.0 * PI * f64::from(cap_height((sin * sin) as f32));
    let radiance = (spot.flux / solid_angle).as_vec3().max(Rgb::ZERO);
    let (excess, surroundings) = (luminance(radiance), luminance(spot.surroundings));
    if excess <= HOT_SHARE * surroundings {
        return Err(NoLamp::NotHot { excess, surroundings });
    }
    spot.fill(panorama);
    let off_rad = spot.direction.angle_between(direction);
    Ok(TakenLamp { radiance, off_rad, clipped: spot.clipped, cleared: (shown, half_angle) })
}

/// Middle of the brightest disc of half angle `own` that begins within `search` of `direction`, radians.
fn brightest_disc(panorama: &Panorama, direction: DVec3, own: f64, search: f64) -> DVec3 {
    /// Discs that are tried, about; then the best one moves to the middle of its light.
    const TRIED: usize = 1000;
    const MOVES: usize = 5;
    let mut texels: Vec<(DVec3, f64)> = Vec::new();
    for y in 0..panorama.height() {
        for x in 0..panorama.width() {
            let texel = panorama.direction(x, y);
            if texel.angle_between(direction) < search + 2.5 * own {
                let l = f64::from(luminance(panorama.radiance[(x, y)]));
                texels.push((texel, l * panorama.solid_angle(y)));
            }
        }
    }
    let within = |middle: DVec3, angle: f64| {
        let cos = angle.cos();
        texels.iter().filter(move |(texel, _)| texel.dot(middle) > cos)
    };
    let flux = |middle: DVec3| within(middle, own).map(|(_, flux)| flux).sum::<f64>();
    let places: Vec<DVec3> = within(direction, search).map(|(texel, _)| *texel).collect();
    let tried = places.iter().step_by(places.len().div_ceil(TRIED).max(1));
    // Its own place wins where nothing is brighter.
    let mut best = (direction, 1.01 * flux(direction));
    for &place in tried {
        let found = flux(place);
        if found > best.1 {
            best = (place, found);
        }
    }
    let mut middle = best.0;
    for _ in 0..MOVES {
        // What lies under the disc's mean is no part of the lamp.
        let all: Vec<_> = within(middle, 1.5 * own).collect();
        let mean = all.iter().map(|(_, flux)| flux).sum::<f64>() / all.len().max(1) as f64;
        let centroid: DVec3 = all.iter().map(|(texel, flux)| *texel * (flux - mean).max(0.0)).sum();
        middle = centroid.try_normalize().unwrap_or(middle);
    }
    middle
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::conventions::lat_long_pixel;
    use crate::light::{Lamp, LightOptions, Lights};
    use crate::photo::Image;
    use glam::{DQuat, Vec3};

    #[test]
    fn taking_a_light_out_leaves_its_surroundings() {
        let sky = Rgb::new(0.02, 0.03, 0.05);
        let mut panorama = Panorama::from_radiance(Image::filled(64, 32, sky));
        let direction = DVec3::new(-0.25, 1.0, 0.1).normalize();
        let at = lat_long_pixel(direction, 64, 32).round();
        let at = (at.x as usize, at.y as usize);
        panorama.radiance[at] = Rgb::splat(50.0);
        panorama.validity[at] = Validity::LowerBound;
        take_out(&mut panorama, direction, 0.1);
        assert_eq!(panorama.radiance[at], sky);
        assert_eq!(panorama.validity[at], Validity::Analytic);
        assert!(panorama.radiance.pixels().iter().all(|&l| l == sky));
    }

    /// A dim room with a lamp of `radiance` in it, each texel the mean of 8 × 8 directions.
    fn with_lamp(at: DVec3, radius: f64, radiance: Rgb) -> Panorama {
        let (place, turn) = (DVec3::new(0.0, 0.06, 0.0), DQuat::from_rotation_y(0.4));
        let cos = (1.0 - (radius / (at - place).length()).powi(2)).sqrt();
        let axis = turn.inverse() * (at - place).normalize();
        let picture = Image::from_fn(1024, 512, |i, j| {
            let part = |k: usize| (k as f64 + 0.5) / 8.0 - 0.5;
            let lit = (0..64).filter(|k| {
                let texel = DVec2::new(i as f64 + part(k % 8), j as f64 + part(k / 8));
                lat_long_direction(texel, 1024, 512).dot(axis) > cos
            });
            Rgb::new(0.5, 0.4, 0.3) + radiance * (lit.count() as f32 / 64.0)
        });
        Panorama { place, world_from_panorama: turn, ..Panorama::from_radiance(picture) }
    }

    #[test]
    fn a_lamp_taken_out_and_put_back_gives_the_same_light_at_the_probe() {
        let (at, radius) = (DVec3::new(0.74, 0.3, -0.2), 0.05);
        let mut panorama = with_lamp(at, radius, Rgb::new(95.0, 58.0, 27.0));
        let before = Lights::new(&panorama, &LightOptions::default()).unwrap();
        let taken = take_out_lamp(&mut panorama, at, radius, 0.0).unwrap();
        assert!((taken.radiance / Rgb::new(95.0, 58.0, 27.0) - 1.0).abs().max_element() < 5e-3);
        assert!(taken.off_rad < 1e-3, "{taken:?}");
        let lamp = Lamp { centre: at.as_vec3(), radius: radius as f32, radiance: taken.radiance };
        let after = Lights::new(&panorama, &LightOptions::default()).unwrap();
        let after = after.near(panorama.place.as_vec3(), None, vec![lamp]);
        for normal in [Vec3::Y, Vec3::X, Vec3::new(0.6, 0.0, -0.8), Vec3::new(-0.6, 0.8, 0.0)] {
            let change = after.irradiance(normal) / before.irradiance(normal) - 1.0;
            assert!(change.abs().max_element() < 1e-3, "{normal}: {change}");
        }
    }

    #[test]
    fn a_lamp_that_shows_beside_its_place_is_found_whole() {
        let (at, radius) = (DVec3::new(0.74, 0.3, -0.2), 0.05);
        let mut panorama = with_lamp(at, radius, Rgb::new(95.0, 58.0, 27.0));
        // 6 cm of ball see it up to 4.5° away, and the tape erred by 2 cm.
        let said = at + DVec3::new(0.02, -0.05, 0.03);
        let taken = take_out_lamp(&mut panorama, said, radius, 0.06).unwrap();
        let off = (at - panorama.place).angle_between(said - panorama.place);
        assert!(off > 0.06 && (taken.off_rad - off).abs() < 2e-3, "{} for {off}", taken.off_rad);
        let rest = Rgb::new(0.5, 0.4, 0.3);
        let left = panorama.radiance.pixels().iter().map(|l| (*l - rest).abs().max_element());
        assert!(left.fold(0.0, f32::max) < 1e-5, "some of the lamp is left");
    }

    #[test]
    fn lamps_that_show_nothing_stay_where_they_are() {
        let at = DVec3::new(0.74, 0.3, -0.2);
        let mut panorama = with_lamp(at, 0.05, Rgb::splat(0.01));
        let untouched = panorama.radiance.clone();
        let off = take_out_lamp(&mut panorama, at, 0.05, 0.0);
        assert!(matches!(off, Err(NoLamp::NotHot { .. })), "{off:?}");
        let around = take_out_lamp(&mut panorama, DVec3::ZERO, 0.1, 0.0);
        assert_eq!(around.unwrap_err(), NoLamp::Inside);
        panorama.coverage = Image::filled(1024, 512, 0.2);
        assert_eq!(take_out_lamp(&mut panorama, at, 0.05, 0.0).unwrap_err(), NoLamp::Unseen);
        assert_eq!(panorama.radiance.pixels(), untouched.pixels());
    }
}
