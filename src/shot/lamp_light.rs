//! Lamps near the objects that clipped in the probe's photographs get the strength that the plate shows.

use std::collections::HashMap;

use glam::{DVec3, Vec3};

use super::clipped_light::Cleared;
use super::light::Setting;
use super::shown::Seen;
use crate::conventions::{Rgb, luminance};
use crate::light::lamp_strength::{LampStrength, LitPlace, lamp_strengths};
use crate::light::{Lamp, Lights, median_per_channel};
use crate::photo::Image;
use crate::report::{LampReport, Warning};
use crate::scene::AlbedoSource;
use crate::trace::Ray;

/// Places this near each other share the irradiance by what is no lamp, m.
const SAME_PLACE_M: f32 = 0.05;
/// Normals this near each other do (8°).
const SAME_NORMAL: f32 = 0.99;
/// With a smaller share of clipped pixels than this, the middle of a block is none of them.
const CLIPPED_SHARE: f64 = 0.4;

/// Strengthens those of the lamps of `lights` that are `clipped`, and says so or why not. `reports` are those
/// of the lamps in their places, in the order of `lights.lamps`.
pub fn strengthen(
    lights: &mut Lights,
    clipped: &[Option<Cleared>],
    setting: &Setting,
    reports: Vec<&mut LampReport>,
) -> Option<Warning> {
    let which: Vec<usize> = (0..clipped.len()).filter(|&k| clipped[k].is_some()).collect();
    if which.is_empty() {
        return None;
    }
    let strengths = lamp_strengths(&places(lights, &which, setting));
    let strength_of = |k: usize| {
        let at = which.iter().position(|&lamp| lamp == k)?;
        strengths.get(at).copied().flatten()
    };
    for (k, report) in reports.into_iter().enumerate().filter(|(k, _)| which.contains(k)) {
        let Some(LampStrength { factor, sigma }) = strength_of(k) else {
            report.treated += "; clipped in every exposure, and as weak as the probe saw it: the plate shows \
                               too little of its light on modelled surfaces to tell how strong it is";
            continue;
        };
        let lamp = &mut lights.lamps[k];
        lamp.radiance *= factor.as_vec3();
        report.radiance = lamp.radiance.as_dvec3().to_array();
        report.strengthened = Some(factor.to_array());
        report.sigma = Some(sigma);
        report.treated += &format!(
            "; clipped in every exposure, and by what the plate shows of its light {} times as strong as \
             the probe saw it, ± {:.0} %",
            factor.to_array().map(|f| format!("{f:.2}")).join(" / "),
            100.0 * sigma
        );
    }
    let known: Vec<f64> = strengths.iter().flatten().map(|lamp| lamp.sigma).collect();
    let worst = known.iter().copied().fold(0.0, f64::max);
    let unknown = which.len() - known.len();
    let message = match (known.len(), unknown) {
        (known, 0) => format!(
            "{known} lamps are clipped in every exposure; how strong they are is taken from how their light \
             falls off over the surfaces in the plate"
        ),
        (known, unknown) => format!(
            "{} lamps are clipped in every exposure, and of {unknown} the plate does not tell how strong they \
             are: they stay as weak as the probe saw them; add a shorter exposure to its bracket",
            known + unknown
        ),
    };
    let size = match known.len() {
        0 => "a lower bound".to_owned(),
        _ => format!("± {:.0} % of those that are known", 100.0 * worst),
    };
    Some(Warning { asks: unknown > 0 || worst > 0.1, ..Warning::new("lamp", message, size) })
}

/// Relative standard error of the irradiance at the probe's `place` on what faces a strengthened lamp, of the
/// lamp for which it is largest; `None` without such. `reports` are those of all lamps.
pub fn sigma(lights: &Lights, place: Vec3, reports: &[LampReport]) -> Option<f64> {
    let in_place = reports.iter().filter(|report| report.in_place);
    let known = lights.lamps.iter().zip(in_place).filter_map(|(lamp, report)| {
        let facing = (lamp.centre - place).normalize_or(Vec3::Y);
        let share = luminance(lamp.irradiance(place, facing))
            / luminance(lights.irradiance_at(place, facing)).max(f32::MIN_POSITIVE);
        Some(report.sigma? * f64::from(share))
    });
    known.reduce(f64::max)
}

/// What the plate shows of the local things, and how the lamps in question light them.
fn places(lights: &Lights, which: &[usize], setting: &Setting) -> Vec<LitPlace> {
    let (plate, step) = (&setting.plan.plate, setting.shown.step);
    let cell = |seen: &Seen| (seen.pixel.0 / step, seen.pixel.1 / step);
    let shown: HashMap<(usize, usize), (u32, Vec3)> = setting
        .shown
        .grid
        .iter()
        .map(|seen| (cell(seen), (seen.hit.mesh, seen.place(setting.scene).1)))
        .collect();
    // A block that reaches over its surface's edge shows two colours.
    let inside = |seen: &Seen, normal: Vec3| {
        let (x, y) = cell(seen);
        let beside = [(1, 0), (-1, 0), (0, 1), (0, -1)]
            .map(|(i, j)| Some((x.checked_add_signed(i)?, y.checked_add_signed(j)?)));
        beside.into_iter().all(|at| {
            at.and_then(|at| shown.get(&at)).is_some_and(|(mesh, other)| {
                *mesh == seen.hit.mesh && other.dot(normal) > SAME_NORMAL
            })
        })
    };
    let mut known: Vec<(Vec3, Vec3, Rgb)> = Vec::new();
    let found = setting.shown.grid.iter().filter_map(|seen| {
        let from_plate = setting.scene.local[seen.hit.mesh as usize].albedo == AlbedoSource::Plate;
        let (point, normal) = seen.place(setting.scene);
        if !from_plate || !inside(seen, normal) {
            return None;
        }
        let radiance = middle(&plate.linear, &plate.clipped, seen.pixel, step)?;
        let like = |known: &&(Vec3, Vec3, Rgb)| {
            known.0.distance(point) < SAME_PLACE_M && known.1.dot(normal) > SAME_NORMAL
        };
        let elsewhere = known.iter().find(like).map(|known| known.2);
        let irradiance = elsewhere.unwrap_or_else(|| {
            let lamps: Rgb = lights.lamps.iter().map(|lamp| lamp.irradiance(point, normal)).sum();
            let irradiance = (lights.irradiance_at(point, normal) - lamps).max(Rgb::ZERO);
            known.push((point, normal, irradiance));
            irradiance
        });
        let by = |lamp: &Lamp| {
            lamp.irradiance(point, normal).as_dvec3() * shown_share(setting, lamp, point)
        };
        let others = (0..lights.lamps.len()).filter(|k| !which.contains(k));
        let by_others: DVec3 = others.map(|k| by(&lights.lamps[k])).sum();
        let (x, y) = cell(seen);
        Some(LitPlace {
            at: (x as u32, y as u32),
            surface: seen.hit.mesh,
            radiance: radiance.as_dvec3(),
            irradiance: irradiance.as_dvec3() + by_others,
            by_lamps: which.iter().map(|&k| by(&lights.lamps[k])).collect(),
        })
    });
    found.collect()
}

/// Median colour of the block of `step` pixels round one, clipped ones among them: they are brighter than it.
///
/// Left out, they would take the bright half of the grain with them just where a lamp shines brightest, and
/// the surface would seem the darker the nearer the lamp. `None` if too many are clipped.
fn middle(
    plate: &Image<Rgb>,
    clipped: &Image<bool>,
    (x, y): (usize, usize),
    step: usize,
) -> Option<Rgb> {
    let around = |at: usize, end: usize| at.saturating_sub(step / 2)..(at + step / 2 + 1).min(end);
    let columns = around(x, plate.width());
    let pixels = around(y, plate.height()).flat_map(|y| columns.clone().map(move |x| (x, y)));
    let pixels: Vec<(usize, usize)> = pixels.collect();
    let n_clipped = pixels.iter().filter(|&&at| clipped[at]).count();
    let colours: Vec<Rgb> = pixels.iter().map(|&at| plate[at]).collect();
    let few = (n_clipped as f64) < CLIPPED_SHARE * pixels.len() as f64;
    few.then(|| median_per_channel(&colours)).flatten()
}

/// Share of a lamp's disc that local things leave to be seen from `point`, by five rays.
fn shown_share(setting: &Setting, lamp: &Lamp, point: Vec3) -> f64 {
    let to = lamp.centre - point;
    let (across, up) = to.normalize_or_zero().any_orthonormal_pair();
    let aside = 0.7 * lamp.radius;
    let aims = [Vec3::ZERO, across * aside, -across * aside, up * aside, -up * aside];
    let free = aims.iter().filter(|&&aim| {
        let way = to + aim;
        let ray =
            Ray { t_max: way.length() - lamp.radius, ..Ray::new(point, way.normalize_or_zero()) };
        !setting.shown.local.occluded(&ray)
    });
    free.count() as f64 / aims.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clipped_grain_does_not_darken_the_middle_of_its_block() {
        // Grain of ± 0.1 about 0.9, cut at 1: a third of it clips.
        let grain = |x: usize, y: usize| 0.9 + 0.15 * ((7 * x + 3 * y) % 11) as f32 / 5.0 - 0.15;
        let plate = Image::from_fn(11, 11, |x, y| Rgb::splat(grain(x, y).min(1.0)));
        let clipped = Image::from_fn(11, 11, |x, y| grain(x, y) >= 1.0);
        let n_clipped = clipped.pixels().iter().filter(|&&c| c).count();
        assert!((15..45).contains(&n_clipped), "{n_clipped}");
        let found = middle(&plate, &clipped, (5, 5), 10).expect("most of it is whole");
        assert!((found.x - 0.9).abs() < 0.02, "{found}");
        let all = Image::filled(11, 11, true);
        assert_eq!(middle(&plate, &all, (5, 5), 10), None);
    }
}
