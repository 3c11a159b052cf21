//! The shot's light: probe photographs → panorama in the plate's scale → lights.

use std::f64::consts::PI;

use glam::DVec3;

use super::clipped_light;
use super::exposures::Scale;
use super::lamp_light;
use super::near_field::NearField;
use super::place;
use super::plan::Plan;
use super::probe_keys::{
    Ball as BallKeys, Fisheye, FisheyeMapping, PanoramaKeys, ProbeSource, Suns,
};
use super::register;
use super::shown::Shown;
use super::sky::SkyKeys;
use crate::bracket::Radiance;
use crate::camera::Camera;
use crate::conventions::{Rgb, luminance};
use crate::light::sky;
use crate::light::{Disc, LightOptions, Lights, SunSplit};
use crate::photo::{Image, ReadOptions};
use crate::probe::file::{self, rotation_xyz_deg};
use crate::probe::find::{self, BallImage};
use crate::probe::fisheye::{self, Projection};
use crate::probe::photographed;
use crate::probe::unwrap::Support;
use crate::probe::{Ball, Doubt, Panorama, Rim};
use crate::report::{
    LightsReport, ProbeReport, SunReport, Warning, azimuth_elevation, photographs,
};
use crate::scene::Scene;

/// The light of a shot and how well it is known.
pub struct Light {
    /// In the plate's linear values; lights that stand on their own are taken out.
    pub panorama: Panorama,
    pub lights: Lights,
    /// The ball's camera and rim, for the overlay.
    pub ball: Option<(Camera, Rim)>,
    /// Relative standard error of the irradiance on level ground, from the panorama's variance.
    pub sigma_irradiance: Option<f64>,
    /// Relative standard error of a recovered sun.
    pub sigma_sun: Option<f64>,
    /// Relative standard error of the irradiance toward a clipped lamp from what its strength in the plate is
    /// known to; the largest.
    pub sigma_lamps: Option<f64>,
    /// Relative standard error of a sun against its sky that nobody measured.
    pub sigma_sky: Option<f64>,
    /// True if a ball's reflectance was divided out.
    pub has_reflectance: bool,
    /// Bound of the relative error from treating near light as distant, if the shot tells of any that
    /// still is.
    pub distant_error: Option<f64>,
    pub warnings: Vec<Warning>,
}

/// The panorama, before clipped lights are judged.
pub struct Unwrapped {
    pub panorama: Panorama,
    ball: Option<(Camera, Rim)>,
    /// Lights that were never in the panorama.
    discs: Vec<Disc>,
    report: ProbeReport,
    warnings: Vec<Warning>,
}

/// Filled directions with less than this share of the light on level ground are no matter for a warning.
const GUESSED_SHARE: f32 = 0.05;

/// Unwraps the merged `bracket` of a ball (which needs `ball_camera`) or fisheye, reads a panorama, or
/// calculates a sky.
///
/// # Errors
/// Sentences with file or key and remedy.
pub fn unwrap(
    plan: &Plan,
    bracket: Option<(Radiance, Vec<Warning>)>,
    ball_camera: Option<Camera>,
) -> Result<Unwrapped, String> {
    let shot = plan.shot.path.display();
    let photos = || bracket.ok_or_else(|| format!("{shot}: probe: no photographs"));
    match &plan.shot.probe.source {
        ProbeSource::Ball(keys) => {
            let camera = ball_camera.ok_or_else(|| format!("{shot}: probe.ball: no camera"))?;
            unwrap_the_ball(plan, keys, photos()?, camera)
                .map_err(|e| format!("{shot}: probe.ball: {e}"))
        }
        ProbeSource::Fisheye(keys) => {
            unwrap_fisheye(plan, keys, photos()?).map_err(|e| format!("{shot}: probe.fisheye: {e}"))
        }
        ProbeSource::Panorama(keys) => {
            take_panorama(keys).map_err(|e| format!("{shot}: probe.panorama: {e}"))
        }
        ProbeSource::Sky(keys) => {
            calculate_sky(keys).map_err(|e| format!("{shot}: probe.sky: {e}"))
        }
    }
}

fn unwrap_the_ball(
    plan: &Plan,
    keys: &BallKeys,
    (radiance, mut warnings): (Radiance, Vec<Warning>),
    camera: Camera,
) -> Result<Unwrapped, String> {
    let hints = find::Hints { circle_px: keys.hint_px, clean_plate: clean_plate(plan, keys) };
    let reflectance = DVec3::from(keys.reflectance).as_vec3();
    // Judged before the ball is looked for, which takes longer.
    let ball = Ball::new(keys.at.into(), keys.radius, reflectance).map_err(|e| e.to_string())?;
    let support =
        place::support_plane(plan, ball.centre).map(|(point, normal)| Support { point, normal });
    let found = find::find(&radiance.mean, &camera.lens, &hints).map_err(|cause| {
        let photo = plan.probe_photos.first();
        photo.map_or(cause.to_string(), |photo| format!("{}: {cause}", photo.path.display()))
    })?;
    let panorama = photographed::ball(&radiance, &camera, &found, &ball, support.as_ref(), None)
        .map_err(|e| e.to_string())?;
    warnings.extend(Doubt::about(&found).into_iter().map(|doubt| {
        Warning::new("probe.ball", doubt.sentence("probe.ball.hint_px"), doubt.effect())
    }));
    warnings.extend(found.disagreement_px(&camera, &ball).and_then(|off| misplaced(off, &found)));
    let report = ProbeReport {
        source: format!("mirror ball, {}", photographs(plan.probe_photos.len())),
        ball_px: Some([found.centre_px.x, found.centre_px.y, found.radius_px]),
        sigma_ball_px: Some(found.sigma_px),
        sigma_direction_deg: Some(found.rim.sigma_direction_rad().to_degrees()),
        ..ProbeReport::default()
    };
    let ball = Some((camera, found.rim));
    Ok(Unwrapped { panorama, ball, discs: Vec::new(), report, warnings })
}

/// A ball this far from where the shot file and the pose put it, as a share of its radius, is not
/// measured badly but placed wrongly: a tape is good to millimetres.
const MISPLACED: f64 = 0.25;
/// The same for its radius.
const MISSIZED: f64 = 0.1;

/// A warning where the rim is not where the ball's place and size and the camera's pose put it.
fn misplaced((centre, radius): (f64, f64), found: &BallImage) -> Option<Warning> {
    let (most, most_radius) = (MISPLACED * found.radius_px, MISSIZED * found.radius_px);
    if centre < most.max(5.0 * found.sigma_px) && radius.abs() < most_radius {
        return None;
    }
    let [u, v] = found.centre_px.to_array();
    let sentence = format!(
        "the ball's rim (centre {u:.0}, {v:.0}, radius {:.0} px) lies {centre:.0} px from where \
         probe.ball.at and the pose put it and is {radius:+.0} px off in radius; check at, radius, \
         the pose, and the overlay",
        found.radius_px
    );
    let size = "where the light was measured; its directions come from the rim itself";
    Some(Warning::new("probe.ball", sentence, size))
}

/// The plate, if it is the ball's photograph without the ball.
fn clean_plate<'a>(plan: &'a Plan, keys: &BallKeys) -> Option<&'a Image<Rgb>> {
    let same_view = keys.camera.is_none() && keys.pose.is_none() && keys.crop.is_none();
    same_view.then_some(&plan.plate.linear)
}

fn unwrap_fisheye(
    plan: &Plan,
    keys: &Fisheye,
    (radiance, mut warnings): (Radiance, Vec<Warning>),
) -> Result<Unwrapped, String> {
    let projection = match keys.mapping {
        FisheyeMapping::Equidistant => Projection::Equidistant,
        FisheyeMapping::Equisolid => Projection::Equisolid,
    };
    let size = [radiance.mean.width(), radiance.mean.height()];
    let fisheye = fisheye::Fisheye::new(projection, keys.fov_deg, keys.circle_px, size)
        .map_err(|error| error.to_string())?;
    let mut panorama =
        photographed::fisheye(&radiance, &fisheye, rotation_xyz_deg(keys.rotation), None)
            .map_err(|error| error.to_string())?;
    panorama.place = keys.at.into();
    warnings.extend(unseen_warning(&panorama));
    let report = ProbeReport {
        source: format!("fisheye, {}", photographs(plan.probe_photos.len())),
        ..ProbeReport::default()
    };
    Ok(Unwrapped { panorama, ball: None, discs: Vec::new(), report, warnings })
}

/// Light from above the horizon that a fisheye did not see is guessed from its edge.
fn unseen_warning(panorama: &Panorama) -> Option<Warning> {
    let all = luminance(panorama.irradiance(DVec3::Y));
    let mut seen = panorama.clone();
    for (l, coverage) in seen.radiance.pixels_mut().iter_mut().zip(panorama.coverage.pixels()) {
        if *coverage < 0.5 {
            *l = Rgb::ZERO;
        }
    }
    let guessed = 1.0 - luminance(seen.irradiance(DVec3::Y)) / all.max(f32::MIN_POSITIVE);
    (guessed > GUESSED_SHARE).then(|| {
        Warning::new(
            "probe.fisheye",
            "part of the upper hemisphere was not seen and is filled from the edge of the image circle; \
             point the lens up (rotation = [90, 0, 0]), or merge two views with platelight panorama --merge \
             and give that panorama",
            format!("{:.0} % of the light on level ground", 100.0 * guessed),
        )
    })
}

fn take_panorama(keys: &PanoramaKeys) -> Result<Unwrapped, String> {
    let rotation = rotation_xyz_deg(keys.rotation);
    let read = file::read(&keys.file, keys.mapping, rotation, None, &ReadOptions::default())
        .map_err(|error| error.to_string())?;
    let mut panorama = read.panorama;
    panorama.place = keys.at.into();
    let negative = read.negative.map(|negative| {
        let size = format!("{} texels, down to {}", negative.texels, negative.least);
        Warning::new("probe.panorama", negative.to_string(), size)
    });
    // Each says itself what it does to the picture.
    let remarks = read.remarks.into_iter().map(|said| Warning::new("probe.panorama", said, ""));
    let warnings = negative.into_iter().chain(remarks).collect();
    let source = format!("panorama {}", keys.file.display());
    let colour = read.encoding.to_string();
    let report = ProbeReport { source, colour, ..ProbeReport::default() };
    Ok(Unwrapped { panorama, ball: None, discs: Vec::new(), report, warnings })
}

/// Texels across a calculated sky: without its sun there is nothing sharp in it but the horizon.
const SKY_WIDTH: usize = 1024;

fn calculate_sky(keys: &SkyKeys) -> Result<Unwrapped, String> {
    let sky = keys.sky().map_err(|error| error.to_string())?;
    let colour = "linear Rec.709 (calculated)".to_owned();
    let report = ProbeReport { source: keys.sentence(), colour, ..ProbeReport::default() };
    Ok(Unwrapped {
        panorama: sky.panorama(SKY_WIDTH),
        ball: None,
        discs: vec![sky.sun()],
        report,
        warnings: keys.notes().into(),
    })
}

/// What light is judged by: the shot with its camera and scene in their places.
pub struct Setting<'a> {
    pub plan: &'a Plan,
    pub camera: &'a Camera,
    pub scene: &'a Scene,
    /// What the plate shows of the scene's local things.
    pub shown: &'a Shown,
}

/// Brings the panorama to the plate's scale, judges clipped lights, and splits off suns.
///
/// # Errors
/// A sentence with key and remedy: clipped lights that nobody accepted, or that cannot be recovered.
pub fn light(
    unwrapped: Unwrapped,
    setting: &Setting,
) -> Result<(Light, ProbeReport, LightsReport), String> {
    let Unwrapped { panorama, ball, discs, mut report, mut warnings } = unwrapped;
    let plan = setting.plan;
    let Scale { factor, source } = &plan.scale;
    let mut panorama = panorama.scaled(*factor as f32);
    let probe = &plan.shot.probe;
    report.registered = axes_from(&probe.source).to_owned();
    if let Some(keys) = &probe.register {
        let registered = register::register(keys, &probe.source, &mut panorama, setting.camera)
            .map_err(|error| format!("{}: {error}", plan.shot.path.display()))?;
        let rim = report.sigma_direction_deg.unwrap_or(0.0);
        report.sigma_direction_deg = Some(rim.hypot(registered.sigma_deg));
        report.registered = registered.sentence;
        warnings.extend(registered.warnings);
    }
    let sigma_irradiance = sigma_irradiance(&panorama);
    if let Some(photo) = plan.probe_photos.first() {
        report.colour = photo.encoding.to_string();
    }
    report.exposures = plan.exposures.values.clone();
    report.exposure_source = plan.exposures.source.to_owned();
    report.plate_exposure = *factor;
    report.plate_exposure_source = source.clone();
    report.seen_share = seen_share(&panorama);

    let mut suns = clipped_light::judge(&mut panorama, setting, &mut report, &mut warnings)?;
    // Also of what turns out to be a lamp's
    let sigma_sun = suns.iter().map(|(_, sigma)| *sigma).reduce(f64::max);
    let sigma_sky = matches!(plan.shot.probe.source, ProbeSource::Sky(_)).then_some(sky::SIGMA);
    suns.extend(discs.into_iter().map(|disc| {
        let radiance = disc.radiance * *factor as f32;
        (Disc { radiance, ..disc }, sky::SIGMA)
    }));
    let near = NearField::find(setting, &mut panorama, &mut suns)
        .map_err(|error| format!("{}: {error}", plan.shot.path.display()))?;
    warnings.extend(near.warnings);
    let options = LightOptions {
        suns: match plan.shot.probe.suns {
            // What hangs on a near wall is no sun.
            Suns::Auto if near.proxy.is_some() => SunSplit::Never,
            Suns::Auto => SunSplit::Auto,
            Suns::Never => SunSplit::Never,
            Suns::Always => SunSplit::Always,
        },
        ..LightOptions::default()
    };
    let found = Lights::new(&panorama, &options)
        .map_err(|error| format!("{}: probe: {error}", plan.shot.path.display()))?;
    let lights = found.with_discs(suns.into_iter().map(|(disc, _)| disc));
    let place = setting.scene.from_world(panorama.place);
    let mut lights = lights.near(place, near.proxy, near.lamps);
    let mut lamp_reports = near.lamp_reports;
    let in_place = lamp_reports.iter_mut().filter(|report| report.in_place).collect();
    warnings.extend(lamp_light::strengthen(&mut lights, &near.clipped_lamps, setting, in_place));
    clipped_light::mark_lamps(&mut report.clipped, &near.clipped_lamps, &lamp_reports);
    warnings.extend(clipped_light::accepted(&report.clipped));
    let sigma_lamps = lamp_light::sigma(&lights, place, &lamp_reports);
    warnings.extend(repaired_warning(&lights, &panorama));

    if lights.is_dark() {
        warnings.push(Warning::new(
            "probe",
            "the panorama is black: nothing lights the objects; look at panorama.exr",
            "objects are black",
        ));
    }
    let lights_report = LightsReport {
        irradiance_up: lights.irradiance(glam::Vec3::Y).as_dvec3().to_array(),
        suns: lights.suns.iter().map(sun_report).collect(),
        surroundings: near.surroundings,
        lamps: lamp_reports,
    };
    let has_reflectance = ball.is_some();
    let distant_error = near.distant_error;
    let light = Light {
        panorama,
        lights,
        ball,
        sigma_irradiance,
        sigma_sun,
        sigma_lamps,
        sigma_sky,
        has_reflectance,
        distant_error,
        warnings,
    };
    Ok((light, report, lights_report))
}

/// What says how a probe's axes lie in the world where nothing registers it.
fn axes_from(source: &ProbeSource) -> &'static str {
    match source {
        ProbeSource::Ball(keys) if keys.pose.is_some() => "by probe.ball.pose",
        ProbeSource::Ball(_) => "by the plate's pose",
        ProbeSource::Fisheye(_) => "by probe.fisheye.rotation, as given",
        ProbeSource::Panorama(_) => "by probe.panorama.rotation, as given",
        ProbeSource::Sky(_) => "by where the sun stands and probe.sky.north_deg",
    }
}

/// Texels that are no light would otherwise become shadows without a word.
fn repaired_warning(lights: &Lights, panorama: &Panorama) -> Option<Warning> {
    (lights.repaired > 0).then(|| {
        let all = panorama.radiance.pixels().len();
        Warning::new(
            "probe",
            "parts of the panorama are NaN, infinite or negative, which is no light; they count as black",
            format!("{} of {all} texels", lights.repaired),
        )
    })
}

fn sun_report(disc: &Disc) -> SunReport {
    let direction = disc.direction.as_dvec3();
    let (azimuth_deg, elevation_deg) = azimuth_elevation(direction);
    SunReport {
        direction: direction.to_array(),
        azimuth_deg,
        elevation_deg,
        half_angle_deg: f64::from(disc.half_angle).to_degrees(),
        irradiance: disc.irradiance(disc.direction).as_dvec3().to_array(),
    }
}

/// Share of the sphere that the probe really saw.
fn seen_share(panorama: &Panorama) -> f64 {
    let rows = (0..panorama.height()).map(|y| {
        let row: f64 = panorama.coverage.row(y).iter().map(|&c| f64::from(c)).sum();
        row * panorama.solid_angle(y)
    });
    rows.sum::<f64>() / (4.0 * PI)
}

/// Relative standard error of the irradiance on level ground; `None` if no variance is known.
fn sigma_irradiance(panorama: &Panorama) -> Option<f64> {
    let (mut sum, mut variance) = (0.0, 0.0);
    for y in 0..panorama.height() {
        let d_omega = panorama.solid_angle(y);
        for x in 0..panorama.width() {
            let weight = panorama.direction(x, y).y.max(0.0) * d_omega;
            sum += weight * f64::from(luminance(panorama.radiance[(x, y)]));
            variance += weight * weight * f64::from(luminance(panorama.variance[(x, y)]));
        }
    }
    (variance > 0.0 && sum > 0.0).then(|| variance.sqrt() / sum)
}

#[cfg(test)]
mod tests {
    use glam::DVec2;

    use super::*;

    #[test]
    fn a_ball_that_is_not_where_it_should_be_is_told_and_a_tape_s_error_is_not() {
        let found = BallImage {
            rim: Rim::known(DVec3::NEG_Z, 0.1, 1e-4),
            centre_px: DVec2::new(300.0, 200.0),
            radius_px: 100.0,
            sigma_px: 0.3,
            score: None,
            agreement: None,
            before_black: false,
            rival_px: None,
        };
        assert!(misplaced((10.0, -4.0), &found).is_none());
        for off in [(40.0, 0.0), (0.0, 15.0), (0.0, -15.0)] {
            let warning = misplaced(off, &found).expect("far off").to_string();
            assert!(warning.contains("300, 200") && warning.contains("probe.ball.at"), "{warning}");
        }
    }

    #[test]
    fn texels_that_are_no_light_are_counted_and_told() {
        let mut panorama = Panorama::from_radiance(Image::filled(64, 32, Rgb::ONE));
        let said = |panorama: &Panorama| {
            let lights = Lights::new(panorama, &LightOptions::default()).unwrap();
            repaired_warning(&lights, panorama)
        };
        assert_eq!(said(&panorama), None);
        panorama.radiance[(3, 4)] = Rgb::new(f32::NAN, 1.0, 1.0);
        panorama.radiance[(9, 30)] = Rgb::new(1.0, -0.1, f32::INFINITY);
        assert_eq!(said(&panorama).unwrap().size, "2 of 2048 texels");
    }

    #[test]
    fn irradiance_sigma_of_constant_noise_is_small_and_known() {
        let mut panorama = Panorama::from_radiance(Image::filled(64, 32, Rgb::ONE));
        assert_eq!(sigma_irradiance(&panorama), None);
        panorama.variance = Image::filled(64, 32, Rgb::splat(0.01));
        // E = π; variance = 0.01 Σ (cosθ dω)², closed form over the hemisphere with equal texels.
        let sigma = sigma_irradiance(&panorama).unwrap();
        let mut expected = 0.0;
        for y in 0..16 {
            for x in 0..64 {
                let w = panorama.direction(x, y).y * panorama.solid_angle(y);
                expected += 0.01 * w * w;
            }
        }
        assert!((sigma - expected.sqrt() / PI).abs() < 0.01 * sigma, "{sigma}");
    }
}
