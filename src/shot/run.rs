//! One shot from photographs to the finished picture.
//!
//! plan → prepare (lens, pose, light, scene) → render in waves → composite → report. Nothing is
//! written before rendering begins; the first composite appears after the first wave and is replaced
//! by the finished one.

use std::path::{Path, PathBuf};
use std::time::Instant;

use super::existing;
use super::file::{Albedo, DenoiseKeys, ModeKeys, ShotFile};
use super::finish::{Finish, finish};
use super::plan::Plan;
use super::prepare::{Prepared, method_name, prepare};
use super::stop::StopKeys;
use super::watch::{Stopwatch, Watch, cpu_seconds};
use super::write::{self, FileMark, OutFiles};
use crate::composite::{Mode, compose};
use crate::conventions::Rgb;
use crate::photo::{Image, PhotoError, Window, atomic};
use crate::render::{
    self, Context, Difference, Job, Numbers, Progress, RenderError, Stop, Technique,
};
use crate::report::{RenderReport, Report, ReportError};

/// How to run, beside what the shot file says.
#[derive(Clone, Debug, Default)]
pub struct RunOptions {
    /// Leave a shot alone whose results are complete and from the same inputs.
    pub skip_existing: bool,
    /// Goes before `[render]`.
    pub stop: Option<StopKeys>,
}

/// A shot or frame that was run.
#[derive(Debug)]
pub struct Finished {
    /// `None` if it was skipped.
    pub report: Option<Box<Report>>,
    /// False if it was stopped before the stopping rule was met.
    pub complete: bool,
    pub skipped: bool,
    pub warnings: usize,
}

/// Why a shot was not finished.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// What was found wrong before rendering, together.
    #[error("{}", .0.join("\n"))]
    Problems(Vec<String>),
    #[error(transparent)]
    Picture(#[from] PhotoError),
    #[error(transparent)]
    Report(#[from] ReportError),
    #[error("{}: {cause}; choose another folder with --out", folder.display())]
    Folder { folder: PathBuf, cause: std::io::Error },
    #[error(transparent)]
    Render(#[from] RenderError),
    #[error("stopped before anything was rendered")]
    Interrupted,
}

impl RunError {
    /// One sentence for each problem.
    pub fn problems(self) -> Vec<String> {
        match self {
            Self::Problems(problems) => problems,
            other => vec![other.to_string()],
        }
    }
}

/// Runs a shot, or every frame of a sequence; one result for each, also for frames that were not
/// begun because the run was cancelled.
pub fn run_frames(
    shot: &ShotFile,
    out: &Path,
    options: &RunOptions,
    context: &Context,
    watch: &dyn Watch,
) -> Vec<Result<Finished, RunError>> {
    let Some(frames) = &shot.plate.frames else {
        let files = OutFiles::new(out, None);
        let mut alone = Shared::default();
        return vec![run_one(shot.clone(), &files, options, context, &mut alone, watch)];
    };
    let mut results = Vec::new();
    let mut shared = Shared::default();
    for frame in frames.iter() {
        if context.is_cancelled() {
            results.push(Err(RunError::Interrupted));
            continue;
        }
        // Another seed each frame: a fixed pattern would stand still while the picture moves.
        let seeded = context.with_seed(context.seed ^ (frame as u64).wrapping_mul(0x9e37_79b9));
        let files = OutFiles::new(out, Some(frame));
        results.push(run_one(shot.at_frame(frame), &files, options, &seeded, &mut shared, watch));
    }
    results
}

/// What the frames of a sequence share: everything but the plate and the places of what moves. Lens,
/// place and light are found once, with the first frame, so that they stand still.
#[derive(Default)]
struct Shared(Option<(Plan, Option<Prepared>)>);

impl Shared {
    /// The plan of a frame, and what is prepared already that serves it.
    fn plan(&mut self, shot: ShotFile) -> Result<&mut (Plan, Option<Prepared>), Vec<String>> {
        let serves = match &mut self.0 {
            Some((plan, _)) => plan.take_frame(&shot)?,
            None => false,
        };
        if !serves {
            self.0 = None;
        }
        match &mut self.0 {
            Some(kept) => Ok(kept),
            none => Ok(none.insert((Plan::make(shot)?, None))),
        }
    }
}

fn run_one(
    mut shot: ShotFile,
    files: &OutFiles,
    options: &RunOptions,
    context: &Context,
    shared: &mut Shared,
    watch: &dyn Watch,
) -> Result<Finished, RunError> {
    if let Some(stop) = options.stop {
        shot.render.stop = stop;
    }
    let settings = serde_json::to_value(&shot).unwrap_or_default();
    check_folder(&files.folder)?;
    let mut stopwatch = Stopwatch::new();
    stopwatch.begin("read the shot", watch);
    let (plan, prepared) = shared.plan(shot).map_err(RunError::Problems)?;
    let inputs: Vec<FileMark> = plan.inputs.iter().filter_map(|path| FileMark::of(path)).collect();
    refuse_to_overwrite(&files.folder, &plan.inputs, |name| files.is_result(name))?;
    let report_path = files.path("report", "json");
    if options.skip_existing
        && existing::is_complete(&report_path, &settings, context.seed, &inputs)
    {
        return Ok(Finished { report: None, complete: true, skipped: true, warnings: 0 });
    }

    let prepared = match prepared {
        Some(prepared) => {
            if plan.moves() {
                stopwatch.begin("move the objects", watch);
                prepared.take_frame(plan)?;
            }
            prepared
        }
        none => none.insert(prepare(plan, &mut stopwatch, context, watch)?),
    };
    for warning in plan.warnings.iter().chain(&prepared.warnings).filter(|w| w.asks) {
        watch.warning(warning);
    }
    stopwatch.begin("render", watch);
    let (difference, render) = render_shot(plan, prepared, files, context, &stopwatch, watch)?;

    stopwatch.begin("composite and report", watch);
    let done = Finish { plan, prepared, difference, render, settings, inputs, seed: context.seed };
    let report = finish(done, files, stopwatch, watch)?;
    Ok(Finished {
        complete: report.render.complete,
        skipped: false,
        warnings: report.warnings.len(),
        report: Some(Box::new(report)),
    })
}

/// A folder that cannot hold the results is found before any work; it need not exist yet.
///
/// # Errors
/// [`RunError::Folder`].
pub fn check_folder(folder: &Path) -> Result<(), RunError> {
    atomic::check_folder(folder)
        .map_err(|cause| RunError::Folder { folder: folder.to_owned(), cause })
}

/// Results, which `is_result` knows by their names in `folder`, must not take the place of what the
/// shot is made from: not through a link either.
///
/// # Errors
/// [`RunError::Problems`] with the input that would be lost.
pub fn refuse_to_overwrite<'a>(
    folder: &Path,
    inputs: impl IntoIterator<Item = &'a PathBuf>,
    is_result: impl Fn(&str) -> bool,
) -> Result<(), RunError> {
    let there = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let results: Vec<PathBuf> = there
        .filter(|entry| entry.file_name().to_str().is_some_and(&is_result))
        .filter_map(|entry| std::fs::canonicalize(entry.path()).ok())
        .collect();
    let is_taken =
        |input: &&PathBuf| std::fs::canonicalize(input).is_ok_and(|place| results.contains(&place));
    match inputs.into_iter().find(is_taken) {
        None => Ok(()),
        Some(input) => Err(RunError::Problems(vec![format!(
            "--out {}: {} is an input of the shot and would be overwritten; name another folder",
            folder.display(),
            input.display()
        )])),
    }
}

fn make_folder(folder: &Path) -> Result<(), RunError> {
    std::fs::create_dir_all(folder)
        .map_err(|cause| RunError::Folder { folder: folder.to_owned(), cause })
}

/// What of a time limit is left for the waves: preparation is over, and the results want to be written.
fn time_to_render(limit: f64, so_far: &Stopwatch, plan: &Plan, prepared: &Prepared) -> f64 {
    /// Seconds for composite, layers and overlays of a megapixel, for one of the panorama, and for the
    /// rest: measured on plates of 0.8 and 8 megapixels.
    const WRITING: [f64; 3] = [3.0, 0.6, 1.3];
    /// Where preparation left less than this share of the limit the waves get it all the same: a plate
    /// without its objects is not what anybody asked for.
    const LEAST: f64 = 0.1;
    let megapixels = |picture: &Image<Rgb>| picture.pixels().len() as f64 * 1e-6;
    let plate = WRITING[0] * megapixels(&plan.plate.linear);
    let panorama = WRITING[1] * megapixels(&prepared.light.panorama.radiance);
    let (elapsed, worked) = so_far.elapsed();
    // On a busy machine preparation took longer than its own work, and writing will.
    let busy = worked.map_or(1.0, |worked| (elapsed / worked.max(1e-3)).clamp(1.0, 4.0));
    (limit - elapsed - busy * (plate + panorama + WRITING[2])).max(LEAST * limit)
}

/// Renders until the stopping rule is met; the first wave's picture is written at once.
fn render_shot(
    plan: &Plan,
    prepared: &Prepared,
    files: &OutFiles,
    context: &Context,
    stopwatch: &Stopwatch,
    watch: &dyn Watch,
) -> Result<(Difference, RenderReport), RunError> {
    let (wall, cpu) = (Instant::now(), cpu_seconds());
    let stop = match plan.shot.render.stop {
        StopKeys::Error(error) => Stop::Error(error),
        StopKeys::Time(seconds) => {
            Stop::TimeSeconds(time_to_render(seconds, stopwatch, plan, prepared))
        }
        StopKeys::Samples(samples) => Stop::Samples(samples),
    };
    let mut report = RenderReport {
        method: method_name(prepared.method).to_owned(),
        stop: plan.shot.render.stop.to_string(),
        complete: true,
        ..RenderReport::default()
    };
    if plan.objects.is_empty() {
        let (width, height) = (plan.plate.linear.width(), plan.plate.linear.height());
        make_folder(&files.folder)?;
        return Ok((Difference::nothing_within((width, height), Window::default()), report));
    }
    let job = Job {
        scene: &prepared.scene,
        lights: &prepared.light.lights,
        camera: &prepared.camera,
        plate: &plan.plate.linear,
        stop,
        numbers: Numbers::default(),
        least_step: plan.plate.least_step(),
        denoise: plan.shot.render.denoise == DenoiseKeys::Auto,
        technique: Technique { caustics: plan.shot.render.caustics, ..Technique::default() },
    };
    let mut integrator = render::integrator(prepared.method, job)?;
    let mode = mode(plan).0;
    loop {
        let wave = integrator.next_wave(context);
        report.samples += wave.samples;
        report.waves += 1;
        report.error = wave.error;
        watch.progress(wave.done, wave.error);
        if wave.progress == Progress::Cancelled && wave.missing > 0 {
            // Half a picture is none.
            return Err(RunError::Interrupted);
        }
        if wave.finished() {
            report.complete = wave.progress != Progress::Cancelled;
            report.outliers = wave.outliers;
            report.denoised = wave.denoised;
            report.missing = wave.missing;
            break;
        }
        if report.waves == 1 {
            write_first_picture(plan, &integrator.snapshot(), mode, files, watch)?;
        }
    }
    make_folder(&files.folder)?;
    report.seconds = wall.elapsed().as_secs_f64();
    report.cpu_seconds = cpu_seconds().zip(cpu).map(|(now, start)| now - start);
    Ok((integrator.snapshot(), report))
}

/// A picture to look at while the rest is rendered.
fn write_first_picture(
    plan: &Plan,
    difference: &Difference,
    mode: Mode,
    files: &OutFiles,
    watch: &dyn Watch,
) -> Result<(), RunError> {
    make_folder(&files.folder)?;
    let composite = compose(&plan.plate, difference, mode).map_err(wrong_size)?;
    let encoded = write::encoded(&plan.plate, &composite, difference);
    let path = files.path("composite", "png");
    write::composite_png(&path, &plan.plate, &composite, &encoded)?;
    watch.written(&path);
    Ok(())
}

/// The mode of the composite and why it was taken.
pub fn mode(plan: &Plan) -> (Mode, &'static str) {
    match (plan.shot.composite.mode, plan.shot.support.albedo) {
        (ModeKeys::Additive, _) => (Mode::Additive, "asked for"),
        (ModeKeys::Ratio, _) => (Mode::Ratio, "asked for"),
        (ModeKeys::Auto, Albedo::Plate) => (
            Mode::Ratio,
            "the support's colour comes from the plate, so its own texture is dimmed or lit; \
             additive where there is no diffuse surface to divide by",
        ),
        (ModeKeys::Auto, Albedo::Mesh | Albedo::Constant(_)) => {
            (Mode::Additive, "the support's albedo was given, and its light is added as such")
        }
    }
}

/// The renderer works at the plate's size; another one is a defect of the program.
pub fn wrong_size(error: crate::composite::CompositeError) -> RunError {
    RunError::Problems(vec![error.to_string()])
}
