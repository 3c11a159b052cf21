//! What is done about lights that clipped in every photograph of the probe.
//!
//! Clipped regions of the panorama → errors, lower bounds, or a sun with the strength and the direction that
//! the plate shows. Clipped lamps of `[[lamp]]` get theirs in [`lamp_light`](super::lamp_light).

use std::f64::consts::PI;

use glam::DVec3;

use super::file::Albedo;
use super::light::Setting;
use super::plan::Plan;
use super::probe_keys::Clipped;
use crate::conventions::{Rgb, luminance};
use crate::light::clipped::{self, RecoverError, Stage};
use crate::light::shadow_edge::{self, ShadowEdges};
use crate::light::{Disc, take_out};
use crate::probe::{ClippedRegion, Panorama, clipped_regions};
use crate::report::{
    ClippedReport, LampReport, ProbeReport, Treatment, Warning, azimuth_elevation,
};

/// A clipped region with less than this share of the light changes nothing that can be seen.
const NEGLIGIBLE_SHARE: f64 = 1e-3;
/// All of them together with less than this are a note.
const SMALL_SUM: f64 = 1e-2;

/// Where the panorama showed a clipped lamp before it was taken out: the direction, and the half angle of the
/// cone that was cleared, radians.
pub type Cleared = (DVec3, f64);

/// Errs on, accepts or recovers clipped lights; returns recovered suns with their relative σ.
///
/// # Errors
/// A sentence with file, key and remedy.
pub fn judge(
    panorama: &mut Panorama,
    setting: &Setting,
    report: &mut ProbeReport,
    warnings: &mut Vec<Warning>,
) -> Result<Vec<(Disc, f64)>, String> {
    let total = f64::from(luminance(panorama.mean())) * 4.0 * PI;
    let share =
        |region: &ClippedRegion| f64::from(luminance(region.lower_bound)) / total.max(1e-30);
    let regions = clipped_regions(panorama);
    let (matter, small): (Vec<_>, Vec<_>) =
        regions.into_iter().partition(|region| share(region) >= NEGLIGIBLE_SHARE);
    if !small.is_empty() {
        let sum: f64 = small.iter().map(share).sum();
        let said = Warning::new(
            "probe",
            format!(
                "{} small lights are clipped in every exposure and taken as they are",
                small.len()
            ),
            format!("at least {:.2} % of the light", 100.0 * sum),
        );
        warnings.push(Warning { asks: sum > SMALL_SUM, ..said });
    }
    let reports: Vec<ClippedReport> =
        matter.iter().map(|region| clipped_report(region, share(region))).collect();
    let Some(brightest) = matter.first() else { return Ok(Vec::new()) };
    let shot = setting.plan.shot.path.display();
    report.clipped = reports;
    match setting.plan.shot.probe.clipped {
        Clipped::Error => {
            let list: Vec<String> = matter.iter().map(ToString::to_string).collect();
            Err(format!(
                "{shot}: probe.clipped: {} lights are clipped in every exposure: {}; add a shorter \
                 exposure, or set probe.clipped = \"recover\" (from the plate's own shadows and lit \
                 surfaces) or \"accept\"",
                matter.len(),
                list.join("; ")
            ))
        }
        Clipped::Accept => Ok(Vec::new()),
        Clipped::Recover => {
            let sun = recover(panorama, brightest, setting, report, warnings)
                .map_err(|error| format!("{shot}: probe.clipped: {error}"))?;
            Ok(vec![sun])
        }
    }
}

/// Clipped lights that nobody found stronger than the probe saw them, said once the others are known.
pub fn accepted(clipped: &[ClippedReport]) -> Option<Warning> {
    let accepted = clipped.iter().filter(|light| light.treatment == Treatment::Accepted);
    let (n, sum) = accepted.fold((0, 0.0), |(n, sum), light| (n + 1, sum + light.share_at_least));
    (n > 0).then(|| {
        Warning::new(
            "probe.clipped",
            format!(
                "{n} clipped lights are accepted as they are: shadows and highlights are too weak"
            ),
            format!("at least {:.1} % of the light, upper bound unknown", 100.0 * sum),
        )
    })
}

/// Notes which of the clipped lights were lamps that got their strength from the plate. `cleared` and the lamps
/// in their places among `lamps` are in one order.
pub fn mark_lamps(
    clipped: &mut [ClippedReport],
    cleared: &[Option<Cleared>],
    lamps: &[LampReport],
) {
    let in_place = lamps.iter().filter(|lamp| lamp.in_place);
    for (lamp, cleared) in in_place.zip(cleared) {
        let (Some((direction, half_angle)), Some(sigma)) = (cleared, lamp.sigma) else { continue };
        for light in clipped.iter_mut() {
            let is_it = DVec3::from(light.direction).angle_between(*direction) < *half_angle;
            if is_it && light.treatment == Treatment::Accepted {
                light.treatment = Treatment::Lamp { sigma };
            }
        }
    }
}

/// Recovers the brightest clipped light as a sun, with its relative σ; the others stay accepted.
fn recover(
    panorama: &mut Panorama,
    sun: &ClippedRegion,
    setting: &Setting,
    report: &mut ProbeReport,
    warnings: &mut Vec<Warning>,
) -> Result<(Disc, f64), String> {
    let half_angle = clipped::half_angle_of(sun.solid_angle, panorama.width()).ok_or_else(|| {
        format!(
            "the brightest clipped light ({sun}, {:.1e} sr) is too large to be recovered as a sun: its \
             shadows are soft; add a shorter exposure to the probe's bracket, or set probe.clipped = \
             \"accept\" if it may be too weak",
            sun.solid_angle
        )
    })?;
    let half_width = 0.5 * sun.width_deg().to_radians();
    // Half as much again: blooming and the resampler spread a clipped disc over its neighbours.
    take_out(panorama, sun.direction, 1.5 * half_width);
    let stage = Stage {
        plate: &setting.plan.plate.linear,
        clipped: &setting.plan.plate.clipped,
        camera: setting.camera,
        panorama,
        scene: setting.scene,
        local: &setting.shown.local,
        support_albedo: support_albedo(setting.plan),
    };
    let axes = report.sigma_direction_deg.map_or(0.0, f64::to_radians);
    let sigma = shadow_edge::sigma_of_clipped(sun.solid_angle, panorama.width()).hypot(axes);
    let found = shadow_edge::by_shadow_edges(&stage, sun.direction, sigma, half_angle);
    let (direction, sigma_direction, moved) = match found {
        ShadowEdges::Found(place) => (place.direction, place.sigma_rad, Some(place.moved_rad)),
        ShadowEdges::Unseen => (sun.direction, sigma * 2f64.sqrt(), None),
        ShadowEdges::Elsewhere(least) => {
            warnings.push(elsewhere(least));
            (sun.direction, least, None)
        }
    };
    let recovered = clipped::recover(&stage, direction, half_angle)
        .map_err(|error| format!("{error}; {}", remedy(&error)))?;
    let irradiance = recovered.irradiance_normal;
    let treatment = Treatment::Recovered {
        irradiance: irradiance.to_array(),
        sigma: recovered.sigma,
        evidence: recovered.evidence.len(),
        sigma_direction_deg: sigma_direction.to_degrees(),
        moved_deg: moved.map(f64::to_degrees),
    };
    if let Some(light) = report.clipped.first_mut() {
        light.treatment = treatment;
    }
    let disc = Disc::from_irradiance(
        direction.as_vec3(),
        recovered.half_angle_rad as f32,
        irradiance.as_vec3(),
    );
    Ok((disc, recovered.sigma))
}

/// The modelled shadows lie beside those in the plate.
fn elsewhere(least: f64) -> Warning {
    Warning::new(
        "probe",
        "the shadows in the plate do not fall where the probe's sun throws them from what is modelled; check \
         how the probe is turned, its time, the pose, and the places of support and [[local]]; \
         overlay_support.png shows the shadow of an upright stick",
        format!("shadows turned by {:.1}° or more", least.to_degrees()),
    )
}

/// What to do in the shot file when a sun cannot be recovered.
fn remedy(error: &RecoverError) -> &'static str {
    match error {
        RecoverError::NoEvidence => {
            "give support.albedo as [r, g, b], model the thing that casts a visible shadow as \
             [[local]], add a shorter exposure to the probe's bracket, or set probe.clipped = \"accept\""
        }
        RecoverError::NotASun(..) => "set probe.clipped = \"accept\"",
    }
}

/// An albedo somebody gave, taken as good to 10 %.
fn support_albedo(plan: &Plan) -> Option<(Rgb, f64)> {
    match plan.shot.support.albedo {
        Albedo::Constant(rgb) => Some((DVec3::from(rgb).as_vec3(), 0.1)),
        Albedo::Plate | Albedo::Mesh => None,
    }
}

fn clipped_report(region: &ClippedRegion, share_at_least: f64) -> ClippedReport {
    let (azimuth_deg, elevation_deg) = azimuth_elevation(region.direction);
    ClippedReport {
        direction: region.direction.to_array(),
        azimuth_deg,
        elevation_deg,
        solid_angle_sr: region.solid_angle,
        flux_at_least: region.lower_bound.as_dvec3().to_array(),
        share_at_least,
        treatment: Treatment::Accepted,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lamps_with_a_strength_of_their_own_are_no_accepted_lights() {
        let light = |direction: DVec3, share| ClippedReport {
            direction: direction.to_array(),
            share_at_least: share,
            ..ClippedReport::default()
        };
        let mut clipped = [light(DVec3::X, 0.1), light(DVec3::Y, 0.02)];
        let lamp = |sigma| LampReport { in_place: true, sigma, ..LampReport::default() };
        let cleared = [Some((DVec3::new(1.0, 0.02, 0.0), 0.05)), Some((DVec3::Y, 0.05)), None];
        // A lamp that stayed in the panorama stands between them in the list.
        let lamps = [lamp(Some(0.1)), LampReport::default(), lamp(None), lamp(None)];
        mark_lamps(&mut clipped, &cleared, &lamps);
        assert_eq!(clipped[0].treatment, Treatment::Lamp { sigma: 0.1 });
        let said = accepted(&clipped).expect("one is left");
        assert!(said.message.starts_with("1 clipped") && said.size.contains("2.0 %"), "{said}");
        assert_eq!(accepted(&clipped[..1]), None);
    }
}
