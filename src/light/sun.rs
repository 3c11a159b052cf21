//! Suns and lamps too small for their texels: analytic discs, and splitting them off a panorama.
//!
//! A sun resampled to a 1k panorama has a penumbra 1.4 times too wide; as a disc of the same flux at
//! the flux centroid it has the right one. A cluster is split off only by a rule that can be reported
//! (methods: > 50 × the robust mean, < 1e-3 sr, ≥ 2 % of the flux, at most eight).

use std::f32::consts::PI;

use glam::{DQuat, DVec2, DVec3, Vec3};

use super::environment::repair;
use super::median::median_per_channel;
use crate::bracket::Validity;
use crate::conventions::{Rgb, SUN_HALF_ANGLE_RAD, lat_long_direction, lat_long_solid_angle};
use crate::photo::Image;
use crate::probe::Panorama;

/// When compact hot clusters of the panorama become analytic discs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SunSplit {
    /// If their shape needs it: clipped, texels wider than half a sun, or several clusters.
    #[default]
    Auto,
    Never,
    /// Whenever there is a cluster.
    Always,
}

/// A round light at infinity, of one radiance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Disc {
    /// Unit, world axes, toward the light.
    pub direction: Vec3,
    /// Half the angle under which it is seen, radians, 0 < half angle < π/2.
    pub half_angle: f32,
    pub radiance: Rgb,
}

impl Disc {
    /// A disc that gives `irradiance` to a plane facing it.
    pub fn from_irradiance(direction: Vec3, half_angle: f32, irradiance: Rgb) -> Self {
        let direction = direction.normalize();
        // ∫ cosθ dω over the disc is π sin².
        let projected = PI * half_angle.sin().powi(2);
        Self { direction, half_angle, radiance: irradiance / projected }
    }

    /// Solid angle, sr: 2π(1 − cos) without its cancellation.
    pub fn solid_angle(&self) -> f32 {
        4.0 * PI * (0.5 * self.half_angle).sin().powi(2)
    }

    /// Flux ∫ L dω of the strongest channel.
    pub fn flux(&self) -> f32 {
        self.radiance.max_element() * self.solid_angle()
    }

    /// Irradiance of an unoccluded plane with unit `normal`; the part below its horizon is cut off.
    pub fn irradiance(&self, normal: Vec3) -> Rgb {
        let sin = self.half_angle.sin();
        let elevation_sine = normal.dot(self.direction);
        self.radiance * PI * sin * sin * visible_cosine(elevation_sine, self.half_angle)
    }

    /// True if `direction` (unit) points at the disc.
    ///
    /// By the chord between the two unit vectors: their dot product in f32 knows the rim of a sun
    /// only to 1 %.
    pub fn contains(&self, direction: Vec3) -> bool {
        let chord = 2.0 * (0.5 * self.half_angle).sin();
        (direction - self.direction).length_squared() <= chord * chord
    }

    /// A direction uniform over the disc's solid angle; `u`, `v` in [0, 1].
    pub fn sample(&self, u: f32, v: f32) -> Vec3 {
        // 1 − cosθ is uniform.
        let below = v * 2.0 * (0.5 * self.half_angle).sin().powi(2);
        let sin = (below * (2.0 - below)).max(0.0).sqrt();
        let (s, c) = (2.0 * PI * u).sin_cos();
        let (tangent, bitangent) = self.direction.any_orthonormal_pair();
        (self.direction * (1.0 - below) + (tangent * c + bitangent * s) * sin).normalize()
    }
}

/// Cosine-weighted share of a disc above the horizon, as a factor on π sin²: the cosine of its
/// middle where it is whole, the cut circle's first moment where it straddles the horizon.
fn visible_cosine(elevation_sine: f32, half_angle: f32) -> f32 {
    let sin = half_angle.sin();
    if elevation_sine >= sin {
        return elevation_sine;
    }
    if elevation_sine <= -sin {
        return 0.0;
    }
    // Small disc as a flat circle of radius `sin`: ∫ over the part above of (s + y), over π sin².
    let s = (elevation_sine / sin).clamp(-1.0, 1.0);
    let root = (1.0 - s * s).sqrt();
    let area = s.acos();
    let area_above = PI - area + s * root;
    sin * (s * area_above + 2.0 / 3.0 * root.powi(3)) / PI
}

/// Threshold of a cluster against the robust mean.
const HOT: f32 = 50.0;
/// Largest solid angle of a cluster, sr.
pub(super) const COMPACT_SR: f64 = 1e-3;
/// Smallest share of the flux that is worth a light of its own.
const FLUX_SHARE: f64 = 0.02;
/// Importance sampling handles more small lights than this better than a list does.
const MOST_DISCS: usize = 8;

/// A connected set of hot texels.
struct Cluster {
    texels: Vec<usize>,
    flux: f64,
    /// Flux over peak radiance, sr: what the core covers, however far its skirt is blurred.
    core_sr: f64,
    clipped: bool,
}

/// A panorama without the clusters that became discs.
pub struct Split {
    /// Finite, not negative.
    pub radiance: Image<Rgb>,
    /// World axes.
    pub discs: Vec<Disc>,
    /// Texels with a channel that was NaN, infinite or negative and is 0 now.
    pub repaired: usize,
}

/// Takes the clusters that are better lights of their own out of a panorama.
///
/// Flux is conserved per channel: the disc holds what the filled-in texels lost.
pub fn split(panorama: &Panorama, policy: SunSplit) -> Split {
    let mut radiance = panorama.radiance.map(|&l| repair(l));
    let pairs = radiance.pixels().iter().zip(panorama.radiance.pixels());
    let repaired = pairs.filter(|(clean, own)| clean != own).count();
    let discs = lift_clusters(&mut radiance, panorama, policy);
    Split { radiance, discs, repaired }
}

fn lift_clusters(radiance: &mut Image<Rgb>, panorama: &Panorama, policy: SunSplit) -> Vec<Disc> {
    if policy == SunSplit::Never {
        return Vec::new();
    }
    let mut clusters = find_clusters(radiance, &panorama.validity);
    clusters.sort_by(|a, b| b.flux.total_cmp(&a.flux));
    clusters.truncate(MOST_DISCS);
    let texel_rad = std::f64::consts::TAU / radiance.width() as f64;
    let wanted = policy == SunSplit::Always
        || clusters.len() >= 2
        || texel_rad > SUN_HALF_ANGLE_RAD
        || clusters.iter().any(|c| c.clipped);
    if !wanted {
        return Vec::new();
    }
    let lifted = clusters.iter().map(|c| lift(radiance, c, panorama.world_from_panorama));
    lifted.flatten().collect()
}

fn solid_angle_of(radiance: &Image<Rgb>, texel: usize) -> f64 {
    let (w, h) = (radiance.width(), radiance.height());
    lat_long_solid_angle(texel / w, w, h)
}

/// The eight neighbours of a texel, wrapping in longitude only.
fn neighbours(texel: usize, w: usize, h: usize) -> impl Iterator<Item = usize> {
    let (x, y) = (texel % w, texel / w);
    (0..9).filter(|&k| k != 4).filter_map(move |k| {
        let row = (y + k / 3).checked_sub(1).filter(|&r| r < h)?;
        Some(row * w + (x + w + k % 3 - 1) % w)
    })
}

fn find_clusters(radiance: &Image<Rgb>, validity: &Image<Validity>) -> Vec<Cluster> {
    let (w, h) = (radiance.width(), radiance.height());
    let values: Vec<f32> = radiance.pixels().iter().map(|l| l.max_element()).collect();
    let total: f64 =
        values.iter().enumerate().map(|(i, &v)| f64::from(v) * solid_angle_of(radiance, i)).sum();
    let threshold = HOT * robust_mean(radiance, &values);
    if !(total > 0.0) {
        return Vec::new();
    }
    let limit_sr = COMPACT_SR + 9.0 * lat_long_solid_angle(h / 2, w, h);
    let mut seen = vec![false; values.len()];
    let mut clusters = Vec::new();
    for start in 0..values.len() {
        if seen[start] || values[start] <= threshold {
            continue;
        }
        let mut texels = vec![start];
        seen[start] = true;
        let mut next = 0;
        while next < texels.len() {
            for n in neighbours(texels[next], w, h) {
                if !seen[n] && values[n] > threshold {
                    seen[n] = true;
                    texels.push(n);
                }
            }
            next += 1;
        }
        let flux: f64 =
            texels.iter().map(|&t| f64::from(values[t]) * solid_angle_of(radiance, t)).sum();
        let peak = texels.iter().map(|&t| values[t]).fold(0.0, f32::max);
        let core_sr = flux / f64::from(peak);
        let clipped = texels.iter().any(|&t| {
            matches!(
                validity.pixels().get(t),
                Some(Validity::LowerBound) | Some(Validity::Analytic)
            )
        });
        if core_sr <= limit_sr && flux >= FLUX_SHARE * total {
            clusters.push(Cluster { texels, flux, core_sr, clipped });
        }
    }
    clusters
}

/// Mean of the dimmer 98 % of the sphere.
fn robust_mean(radiance: &Image<Rgb>, values: &[f32]) -> f32 {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_unstable_by(|&a, &b| values[a].total_cmp(&values[b]));
    let limit = 0.98 * 4.0 * std::f64::consts::PI;
    let (mut area, mut sum) = (0.0, 0.0);
    for i in order {
        let solid_angle = solid_angle_of(radiance, i);
        if area + solid_angle > limit && area > 0.0 {
            break;
        }
        area += solid_angle;
        sum += solid_angle * f64::from(values[i]);
    }
    if area > 0.0 { (sum / area) as f32 } else { 0.0 }
}

/// Takes a cluster and its blurred skirt out of the picture and returns it as a disc (world axes).
fn lift(radiance: &mut Image<Rgb>, cluster: &Cluster, world_from_map: DQuat) -> Option<Disc> {
    let (w, h) = (radiance.width(), radiance.height());
    // Resampling spreads a light over its neighbours: two rings belong to it, the third is sky.
    let mut inside = cluster.texels.clone();
    inside.sort_unstable();
    let grow = |set: &[usize]| -> Vec<usize> {
        let mut grown: Vec<usize> =
            set.iter().flat_map(|&t| neighbours(t, w, h).chain([t])).collect();
        grown.sort_unstable();
        grown.dedup();
        grown
    };
    inside = grow(&grow(&inside));
    let ring: Vec<Rgb> = grow(&inside)
        .into_iter()
        .filter(|t| inside.binary_search(t).is_err())
        .map(|t| radiance.pixels()[t])
        .collect();
    let fill = median_per_channel(&ring).unwrap_or(Rgb::ZERO);

    let (mut flux, mut centroid) = (DVec3::ZERO, DVec3::ZERO);
    for &t in &inside {
        let excess = (radiance.pixels()[t] - fill).max(Rgb::ZERO).as_dvec3();
        let power = excess * solid_angle_of(radiance, t);
        flux += power;
        centroid += lat_long_direction(DVec2::new((t % w) as f64, (t / w) as f64), w, h)
            * power.element_sum();
    }
    let direction = world_from_map * centroid.try_normalize()?;
    for &t in &inside {
        let l = radiance.pixels()[t];
        radiance.pixels_mut()[t] = l.min(fill);
    }

    // As small as a sun can look at this resolution: take it for one, else keep its own size.
    let texel_rad = std::f64::consts::TAU / w as f64;
    let own = (cluster.core_sr / std::f64::consts::PI).sqrt();
    let is_sun = direction.y > 0.0 && own <= SUN_HALF_ANGLE_RAD + 1.5 * texel_rad;
    let half_angle = if is_sun { SUN_HALF_ANGLE_RAD } else { own.min(0.5) };
    let mut disc = Disc {
        direction: direction.as_vec3().normalize(),
        half_angle: half_angle as f32,
        radiance: Rgb::ZERO,
    };
    disc.radiance = flux.as_vec3() / disc.solid_angle();
    Some(disc)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::{Environment, LightOptions, Lights};
    use glam::DQuat;

    fn panorama(radiance: Image<Rgb>) -> Panorama {
        let (w, h) = (radiance.width(), radiance.height());
        Panorama {
            variance: Image::filled(w, h, Rgb::ZERO),
            validity: Image::filled(w, h, Validity::Measured),
            coverage: Image::filled(w, h, 1.0),
            world_from_panorama: DQuat::from_rotation_y(0.3),
            place: DVec3::ZERO,
            radiance,
        }
    }

    /// A sky with a blurred sun at (x, y) texels.
    fn with_sun(w: usize, h: usize, x: f64, y: f64) -> Image<Rgb> {
        Image::from_fn(w, h, |i, j| {
            let r2 = (i as f64 - x).powi(2) + (j as f64 - y).powi(2);
            let sun = 40_000.0 * (-r2 / 0.8).exp();
            Rgb::new(0.6 + sun as f32, 0.7 + 0.9 * sun as f32, 1.0 + 0.7 * sun as f32)
        })
    }

    #[test]
    fn splitting_keeps_the_flux_and_the_direction() {
        let picture = with_sun(512, 256, 130.3, 60.8);
        let place = panorama(picture.clone());
        let Split { radiance: rest, discs, repaired } = split(&place, SunSplit::Auto);
        assert_eq!((discs.len(), repaired), (1, 0));
        let whole = Environment::new(&picture, place.world_from_panorama, true).unwrap().flux();
        let remains = Environment::new(&rest, place.world_from_panorama, true).unwrap().flux();
        let disc = discs[0].radiance.as_dvec3() * f64::from(discs[0].solid_angle());
        assert!((remains + disc - whole).abs().max_element() < 1e-5 * whole.max_element());
        let wanted =
            place.world_from_panorama * lat_long_direction(DVec2::new(130.3, 60.8), 512, 256);
        let off = wanted.angle_between(discs[0].direction.as_dvec3()).to_degrees();
        assert!(off < 0.05, "{off} degrees off");
        assert!((f64::from(discs[0].half_angle) - SUN_HALF_ANGLE_RAD).abs() < 1e-8);
        assert!(rest.pixels().iter().all(|l| l.x < 1.5), "no skirt is left in the sky");
    }

    #[test]
    fn what_is_up_is_asked_in_the_world_not_in_a_tilted_map() {
        // Half a turn about X: the map's lower half is the sky.
        let mut place = panorama(with_sun(512, 256, 130.3, 255.0 - 60.8));
        place.world_from_panorama = DQuat::from_rotation_x(std::f64::consts::PI);
        let discs = split(&place, SunSplit::Auto).discs;
        assert!(discs[0].direction.y > 0.5);
        assert!((f64::from(discs[0].half_angle) - SUN_HALF_ANGLE_RAD).abs() < 1e-8);
        place.world_from_panorama = DQuat::IDENTITY;
        let discs = split(&place, SunSplit::Auto).discs;
        assert!(f64::from(discs[0].half_angle) > 1.1 * SUN_HALF_ANGLE_RAD, "a lamp, not a sun");
    }

    #[test]
    fn smooth_skies_and_darkness_are_not_split() {
        let smooth = Image::from_fn(64, 32, |_, j| Rgb::splat(1.0 + j as f32));
        assert!(split(&panorama(smooth), SunSplit::Always).discs.is_empty());
        assert!(
            split(&panorama(Image::filled(8, 4, Rgb::ZERO)), SunSplit::Always).discs.is_empty()
        );
        let one = Image::filled(1, 1, Rgb::ONE);
        assert!(split(&panorama(one), SunSplit::Always).discs.is_empty());
        let sun = with_sun(512, 256, 130.0, 60.0);
        assert!(split(&panorama(sun), SunSplit::Never).discs.is_empty());
    }

    #[test]
    fn a_fine_unclipped_sun_stays_in_the_map_unless_asked() {
        let sun = panorama(with_sun(2048, 1024, 700.0, 300.0));
        assert!(split(&sun, SunSplit::Auto).discs.is_empty());
        assert_eq!(split(&sun, SunSplit::Always).discs.len(), 1);
    }

    #[test]
    fn a_sun_on_the_seam_is_one_cluster() {
        let picture = Image::from_fn(512, 256, |i, j| {
            let sun = if (i == 0 || i == 511) && j == 80 { 50_000.0 } else { 0.0 };
            Rgb::splat(1.0 + sun)
        });
        assert_eq!(split(&panorama(picture), SunSplit::Auto).discs.len(), 1);
    }

    #[test]
    fn disc_samples_stay_on_the_disc_and_fill_it() {
        let disc = Disc::from_irradiance(Vec3::new(0.3, 0.8, -0.2), 0.004_65, Rgb::ONE);
        let mut mean = DVec3::ZERO;
        for k in 0..1000 {
            let (u, v) = ((k % 40) as f32 / 40.0, (k / 40) as f32 / 24.0);
            let d = disc.sample(u, v * 0.999);
            assert!(disc.contains(d));
            mean += d.as_dvec3() / 1000.0;
        }
        assert!(mean.angle_between(disc.direction.as_dvec3()) < 1e-4);
        let facing = disc.irradiance(disc.direction);
        assert!((facing - Rgb::ONE).length() < 1e-5, "{facing}");
        assert!(!disc.contains(disc.sample(0.1, 1.02)));
    }

    #[test]
    fn a_disc_on_the_horizon_gives_what_is_above_it() {
        let disc = Disc { direction: Vec3::X, half_angle: 0.02, radiance: Rgb::ONE };
        // Half a disc: ∫ y over a half circle of radius r is 2r³/3.
        let wanted = 2.0 / 3.0 * 0.02_f32.powi(3);
        let got = disc.irradiance(Vec3::Y).x;
        assert!((got / wanted - 1.0).abs() < 1e-3, "{got} for {wanted}");
        assert_eq!(disc.irradiance(Vec3::NEG_X).x, 0.0);
    }

    #[test]
    fn lights_of_two_strata_estimate_the_irradiance_together() {
        let place = panorama(with_sun(256, 128, 60.0, 30.0));
        let lights =
            Lights::new(&place, &LightOptions { compensated: false, ..Default::default() })
                .unwrap();
        assert_eq!((lights.suns.len(), lights.n_strata()), (1, 2));
        let exact = lights.irradiance(Vec3::Y);
        let n = 20_000;
        let mut sum = DVec3::ZERO;
        for k in 0..n {
            for stratum in 0..lights.n_strata() {
                let u = DVec2::new(
                    (f64::from(k) * 0.754_877_666).fract(),
                    (f64::from(k) * 0.569_840_29).fract(),
                );
                let draw = lights.sample(stratum, Vec3::ZERO, u).unwrap();
                assert!(
                    (lights.evaluate(Vec3::ZERO, draw.direction).1 / draw.pdf - 1.0).abs() < 1e-3
                );
                sum += (draw.radiance * draw.direction.y.max(0.0) / draw.pdf).as_dvec3();
            }
        }
        let mean = sum / f64::from(n);
        // A rank-1 lattice of 20 000 points: its error on these smooth pieces is far below 0.3 %.
        assert!((mean / exact.as_dvec3() - 1.0).abs().max_element() < 3e-3, "{mean} {exact}");
        assert!(lights.sample(2, Vec3::ZERO, DVec2::ZERO).is_none());
    }
}
