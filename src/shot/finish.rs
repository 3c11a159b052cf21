//! After rendering: composite, layers, overlays, report.

use std::path::PathBuf;

use super::budget;
use super::existing;
use super::plan::Plan;
use super::prepare::Prepared;
use super::run::{RunError, mode, wrong_size};
use super::stop::StopKeys;
use super::watch::{Stopwatch, Watch};
use super::write::{self, CompositeSettings, FileMark, OutFiles};
use super::{overlays, place};
use crate::camera;
use crate::composite::{Composite, Encoded, Mode, compose};
use crate::conventions::Rgb;
use crate::light::median_per_channel;
use crate::photo::Image;
use crate::probe;
use crate::render::waves::MOST_SAMPLES;
use crate::render::{Caustics, Difference};
use crate::report::{self, CompositeReport, Picture, PlateReport, RenderReport, Report, Warning};
use crate::scene::{AlbedoSource, Scene};

/// What a finished rendering leaves.
pub struct Finish<'a> {
    pub plan: &'a Plan,
    pub prepared: &'a Prepared,
    pub difference: Difference,
    pub render: RenderReport,
    pub settings: serde_json::Value,
    pub inputs: Vec<FileMark>,
    pub seed: u64,
}

/// The picture that the rendering makes of the plate.
struct Composed {
    mode: Mode,
    /// Why this mode.
    reason: &'static str,
    composite: Composite,
    encoded: Encoded,
}

/// Writes everything; the report is last, so that a report means a complete shot.
pub fn finish(
    done: Finish,
    files: &OutFiles,
    mut stopwatch: Stopwatch,
    watch: &dyn Watch,
) -> Result<Report, RunError> {
    let (mode, reason) = mode(done.plan);
    let plate = &done.plan.plate;
    let composite = compose(plate, &done.difference, mode).map_err(wrong_size)?;
    let encoded = write::encoded(plate, &composite, &done.difference);
    let composed = Composed { mode, reason, composite, encoded };

    let mut outputs = Outputs { paths: Vec::new(), watch };
    write_results(&done, &composed, files, &mut outputs)?;
    let pictures = write_pictures(done.plan, done.prepared, files, &mut outputs)?;

    let found = warnings(&done, &composed);
    for warning in found.iter().filter(|warning| warning.asks) {
        watch.warning(warning);
    }
    let known = [&done.plan.warnings[..], &done.prepared.warnings[..]].concat();
    let (warnings, notes) = Warning::apart([known, found].concat());

    let report = Report {
        outputs: outputs.marks(),
        stages: stopwatch.finish(),
        warnings,
        notes,
        pictures,
        ..report_of(done, &composed)
    };
    let html_path = files.path("report", "html");
    let before = files.name("before", "png");
    report::write_html(&html_path, &report, &before, &files.name("composite", "png"))?;
    watch.written(&html_path);
    let json_path = files.path("report", "json");
    report::write_json(&json_path, &report)?;
    watch.written(&json_path);
    Ok(report)
}

/// Composite, panorama and camera.
fn write_results(
    done: &Finish,
    composed: &Composed,
    files: &OutFiles,
    outputs: &mut Outputs,
) -> Result<(), RunError> {
    let Finish { plan, prepared, difference, .. } = done;
    let Composed { mode, composite, encoded, .. } = composed;
    let path = files.path("composite", "png");
    write::composite_png(&path, &plan.plate, composite, encoded)?;
    outputs.wrote(path);

    let settings = CompositeSettings {
        layers: plan.shot.output.layers.clone(),
        mode: mode.name(),
        shot: done.settings.clone(),
        seed: done.seed,
    };
    let path = files.path("composite", "exr");
    let camera = &prepared.camera;
    write::composite_exr(&path, &plan.plate, difference, composite, encoded, camera, &settings)?;
    outputs.wrote(path);

    let path = files.path("panorama", "exr");
    probe::file::write(&path, &prepared.light.panorama)?;
    outputs.wrote(path);

    let path = files.path("camera", "json");
    camera::file::write(&path, camera, true)
        .map_err(|error| RunError::Problems(vec![error.to_string()]))?;
    outputs.wrote(path);
    Ok(())
}

/// What only the finished picture shows to be wrong.
fn warnings(done: &Finish, composed: &Composed) -> Vec<Warning> {
    let Finish { plan, prepared, difference, render, .. } = done;
    let tally = composed.composite.tally;
    let mut warnings = composite_warnings(&composed.composite, composed.encoded.clamped);
    let rendered = !plan.objects.is_empty() && render.missing == 0;
    if tally.changed == 0 && rendered && !prepared.objects_maybe_unseen {
        warnings.push(Warning::new(
            "object",
            "no object changes a pixel, though all stand in the picture: look at their materials and \
             at the panorama",
            "the result is the plate itself",
        ));
    }
    warnings.extend(stop_warning(plan.shot.render.stop, render));
    if render.missing > 0 {
        let pixels = plan.plate.linear.pixels().len() as u64;
        warnings.push(Warning::new(
            "render.time",
            "the time was over before every part of the picture had its first samples; what has none \
             shows the plate without the objects; give more time",
            format!("{:.1} % of the picture", percent(render.missing, pixels)),
        ));
    }
    let (stop, caustics) = (plan.shot.render.stop, plan.shot.render.caustics);
    warnings.extend(outliers_warning(render.outliers, tally.changed, stop, caustics));
    if let Some(ground) = place::ground(plan) {
        warnings.extend(border_warning(prepared, difference, &ground));
    }
    warnings
}

/// An error that was asked for and is out of reach; what the last wave misses by is no matter.
fn stop_warning(stop: StopKeys, render: &RenderReport) -> Option<Warning> {
    let StopKeys::Error(target) = stop else { return None };
    (render.complete && render.error > 1.1 * target).then(|| {
        Warning::new(
            "render.error",
            format!("the error asked for was not reached with {MOST_SAMPLES} samples a pixel"),
            format!("{:.3} % instead of {:.3} %", 100.0 * render.error, 100.0 * target),
        )
    })
}

/// Everything the report says but what was written, when, and what may be wrong.
fn report_of(done: Finish, composed: &Composed) -> Report {
    let Finish { plan, prepared, difference, render, settings, inputs, seed } = done;
    let solved = solved_albedos(&prepared.scene, &difference.albedo);
    Report {
        program: existing::PROGRAM.to_owned(),
        shot: settings,
        seed,
        inputs: serde_json::to_value(&inputs).unwrap_or_default(),
        plate: PlateReport {
            file: plan.plate.path.clone(),
            colour: plan.plate.encoding.to_string(),
        },
        camera: prepared.camera_report.clone(),
        pose: prepared.pose_report.clone(),
        probe: prepared.probe_report.clone(),
        lights: prepared.lights_report.clone(),
        budget: budget::budget(prepared, &render),
        render,
        composite: CompositeReport {
            mode: composed.mode.name().to_owned(),
            reason: composed.reason.to_owned(),
            tally: composed.composite.tally,
            clamped: composed.encoded.clamped,
            albedo_median: median_per_channel(&solved).map(|albedo| albedo.as_dvec3().to_array()),
        },
        ..Report::default()
    }
}

/// Files written so far.
struct Outputs<'a> {
    paths: Vec<PathBuf>,
    watch: &'a dyn Watch,
}

impl Outputs<'_> {
    fn wrote(&mut self, path: PathBuf) {
        self.watch.written(&path);
        self.paths.push(path);
    }

    fn marks(&self) -> serde_json::Value {
        let marks: Vec<FileMark> =
            self.paths.iter().filter_map(|path| FileMark::of(path)).collect();
        serde_json::to_value(marks).unwrap_or_default()
    }
}

/// The plate and the overlays as PNGs; returns those the report shows below its tables.
fn write_pictures(
    plan: &Plan,
    prepared: &Prepared,
    files: &OutFiles,
    outputs: &mut Outputs,
) -> Result<Vec<Picture>, RunError> {
    let before = files.path("before", "png");
    write::canvas(
        &before,
        report::Canvas::of(&plan.plate, overlays::reduction(&plan.plate.linear)),
    )?;
    outputs.wrote(before);
    let mut pictures = Vec::new();
    for overlay in overlays::draw(plan, prepared) {
        let path = files.path(overlay.name, "png");
        write::canvas(&path, overlay.canvas)?;
        outputs.wrote(path);
        pictures.push(Picture {
            file: files.name(overlay.name, "png"),
            title: overlay.title.to_owned(),
            caption: overlay.caption.to_owned(),
        });
    }
    Ok(pictures)
}

fn composite_warnings(composite: &Composite, clamped: u64) -> Vec<Warning> {
    let tally = composite.tally;
    let share = |n: u64| format!("{:.2} % of the changed pixels", percent(n, tally.changed));
    let mut warnings = Vec::new();
    if tally.not_finite > 0 {
        warnings.push(Warning::new(
            "render",
            "some pixels came out as no number; they keep the plate, please report this",
            format!("{} pixels", tally.not_finite),
        ));
    }
    if percent(tally.plate_clipped, tally.changed) > 1.0 {
        warnings.push(Warning::new(
            "composite",
            "the plate is clipped where the objects change it: the true result is brighter",
            share(tally.plate_clipped),
        ));
    }
    if percent(tally.negative, 3 * tally.changed) > 1.0 {
        warnings.push(Warning::new(
            "composite",
            "more light is taken away than the plate has; the exposures of plate and probe disagree, \
             or the albedo given is too high",
            format!("{:.2} % of the changed samples were set to 0", percent(tally.negative, 3 * tally.changed)),
        ));
    }
    if percent(clamped, 3 * tally.changed) > 1.0 {
        warnings.push(Warning::new(
            "composite",
            "results lie beyond the plate's sample type and are clamped in the main picture; the \
             object and difference layers hold them whole",
            format!("{:.2} % of the changed samples", percent(clamped, 3 * tally.changed)),
        ));
    }
    warnings
}

/// Few such pixels are a note; where they are many they show as specks.
fn outliers_warning(
    outliers: u64,
    changed: u64,
    stop: StopKeys,
    caustics: Caustics,
) -> Option<Warning> {
    let share = percent(outliers, changed);
    let found = "some pixels caught light that is found by chance (a sun mirrored by an object); the \
                 error reached leaves them out, the layer stderr does not";
    let size = format!("{outliers} px, {share:.2} % of the changed ones");
    match share {
        _ if outliers == 0 => None,
        share if share < SPECKS_PERCENT => Some(Warning::note("render", found, size)),
        _ => {
            let more = match stop {
                StopKeys::Error(_) => "take a smaller render.error",
                StopKeys::Time(_) => "give more render.time",
                StopKeys::Samples(_) => "take more render.samples",
            };
            let or = match caustics {
                Caustics::Soft => "",
                Caustics::Exact => ", or render.caustics = \"soft\"",
            };
            let remedy = format!("{found}; they may show as specks: {more}{or}");
            Some(Warning::new("render", remedy, size))
        }
    }
}

/// A speck in a hundred pixels across and down is seen, one in a thousand pixels is lost in grain.
const SPECKS_PERCENT: f64 = 0.1;

fn percent(part: u64, whole: u64) -> f64 {
    if whole == 0 { 0.0 } else { 100.0 * part as f64 / whole as f64 }
}

/// A shadow cut off along less of the border than this is hardly found by who looks for it.
const BORDER_SEEN_PERCENT: f64 = 5.0;

/// A shadow that reaches the border of the modelled support is cut off there (R9.8).
fn border_warning(
    prepared: &Prepared,
    difference: &Difference,
    ground: &report::overlay::Ground,
) -> Option<Warning> {
    const STEPS: i32 = 200;
    let (mut cut, mut seen) = (0u64, 0u64);
    for (side, other) in [(0, 1), (1, 0)] {
        for edge in [-0.99, 0.99] {
            for i in -STEPS..=STEPS {
                let along = f64::from(i) / f64::from(STEPS) * ground.half_size[side];
                let across = edge * ground.half_size[other];
                let point =
                    ground.centre + ground.sides[side] * along + ground.sides[other] * across;
                let Some(pixel) = prepared.camera.project_world(point) else { continue };
                if !prepared.camera.shows(pixel) {
                    continue;
                }
                seen += 1;
                let at = (pixel.x.round() as usize, pixel.y.round() as usize);
                let Some(at) = difference.window.inside(at) else { continue };
                let d = difference.difference[at];
                let plate_noise = 2.0 * difference.stderr[at];
                let visible = d.abs().cmpgt(plate_noise).any()
                    && difference.ratio[at].abs().max_element() > 0.01;
                cut += u64::from(visible && difference.coverage[at] < 1.0);
            }
        }
    }
    let share = percent(cut, seen);
    let said = Warning::new(
        "support",
        "the objects' shadow or light reaches the border of the modelled support and ends there; where \
         the real surface goes on, make the support larger",
        format!("{share:.0} % of its border, more than 1 % of the plate there"),
    );
    (share > 1.0).then_some(Warning { asks: share > BORDER_SEEN_PERCENT, ..said })
}

/// The albedos that were solved from the plate; those that somebody gave say nothing of its light.
fn solved_albedos(scene: &Scene, layer: &Image<Rgb>) -> Vec<Rgb> {
    let given: Vec<Rgb> = scene
        .local
        .iter()
        .filter_map(|local| match local.albedo {
            AlbedoSource::Constant(albedo) => Some(albedo),
            AlbedoSource::Plate | AlbedoSource::Material => None,
        })
        .collect();
    // The layer holds a given albedo to the bit.
    let is_solved = |a: &Rgb| a.max_element() > 0.0 && a.is_finite() && !given.contains(a);
    layer.pixels().iter().copied().filter(is_solved).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{LocalMesh, LocalRole, Mesh};

    #[test]
    fn a_white_that_somebody_gave_is_not_among_those_solved() {
        let local = |albedo| LocalMesh { mesh: Mesh::default(), role: LocalRole::Support, albedo };
        let white = Rgb::splat(0.98);
        let layer = Image::from_fn(10, 10, |x, _| if x < 8 { white } else { Rgb::splat(0.3) });
        let given = [AlbedoSource::Constant(white), AlbedoSource::Plate].map(local);
        let scene = Scene { local: given.to_vec(), ..Scene::default() };
        let solved = solved_albedos(&scene, &layer);
        assert_eq!(median_per_channel(&solved), Some(Rgb::splat(0.3)));
    }

    #[test]
    fn specks_are_met_by_more_of_what_was_asked_for() {
        let said = |stop, caustics| {
            let warning = outliers_warning(100, 1000, stop, caustics).unwrap();
            assert!(warning.asks);
            warning.message
        };
        assert!(said(StopKeys::Error(0.01), Caustics::Soft).ends_with("a smaller render.error"));
        assert!(said(StopKeys::Time(60.0), Caustics::Soft).ends_with("more render.time"));
        let exact = said(StopKeys::Samples(64), Caustics::Exact);
        assert!(exact.ends_with("more render.samples, or render.caustics = \"soft\""), "{exact}");
    }
}
