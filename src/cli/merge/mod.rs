//! `platelight merge`: the photographs of a bracket → one EXR of radiance; a folder → one for each bracket.

mod folder;

use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::bracket::{
    self, Frame, MergeOptions, Merged, Noise, ResponseSource, Validity, Warning, exposure,
};
use crate::cli::outputs::{check_ending, check_outputs};
use crate::cli::{CliError, Global, Outcome};
use crate::photo::{self, Encoded, ReadOptions, colour};

/// Merge an exposure bracket into radiance with variance and validity
///
/// The exposures come from EXIF (time, f-number, ISO) or from --times; they are checked against the
/// pixels. The EXR holds R G B in linear value per exposure, so brackets and plates of one camera
/// share its scale, and the layers variance and validity. Of a folder every bracket is merged: a new one
/// begins where an exposure comes again or the camera's setting changes, or every --group photographs.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  platelight merge ball_b*.jpg --out ball.exr\n  \
                        platelight merge b0.png b1.png b2.png --times 1/10,1/40,1/160 --out ball.exr\n  \
                        platelight merge day_1/probes --out merged")]
pub struct Args {
    /// The photographs of a bracket in any order, or one folder of brackets
    #[arg(required = true, value_name = "PHOTO")]
    photos: Vec<PathBuf>,
    /// The EXR to write; of a folder, the folder to write them to, each named after its first photograph
    #[arg(long, short, value_name = "FILE")]
    out: PathBuf,
    /// Photographs of each bracket in a folder [default: told by their exposures]
    #[arg(long, value_name = "N")]
    group: Option<usize>,
    /// Of a folder, leave brackets alone whose EXR is there and newer than they are
    #[arg(long)]
    skip_existing: bool,
    /// Shutter times in seconds, one for each photograph in its order (0.1 or 1/10)
    #[arg(long, value_delimiter = ',', value_name = "TIMES", conflicts_with = "times_file")]
    times: Option<Vec<String>>,
    /// File of shutter times: `name time` or `time` on each line
    #[arg(long, value_name = "FILE")]
    times_file: Option<PathBuf>,
    /// Colour space of the photographs, where they do not say it themselves
    #[arg(long, alias = "color", default_value = "auto", value_name = "NAME")]
    colour: String,
    /// Take the stated exposures as true, whatever the pixels say
    #[arg(long)]
    trust_times: bool,
    /// Read the photographs by their stated tone curve even where the pixels contradict it
    #[arg(long)]
    no_response: bool,
    /// Do not look for shifts, turns and tilts between the photographs
    #[arg(long)]
    no_align: bool,
    /// Merge what moved between the photographs like everything else
    #[arg(long)]
    no_ghosts: bool,
    /// Electrons at white and read noise in electrons, if known [default: measured in the bracket]
    #[arg(long, value_name = "FULL,READ", value_delimiter = ',')]
    noise: Option<Vec<f64>>,
}

/// What was merged, for people and machines.
#[derive(Serialize)]
struct Summary {
    out: PathBuf,
    width: usize,
    height: usize,
    frames: Vec<FrameSummary>,
    full_well_e: f64,
    read_noise_e: f64,
    noise_measured: bool,
    /// Pixels seen in two or more frames, in one, clipped in all, below the noise.
    measured_px: usize,
    single_px: usize,
    lower_bound_px: usize,
    upper_bound_px: usize,
    /// Pixels of what moved, taken from one photograph.
    moved_px: usize,
    warnings: Vec<String>,
    /// What is good to know and asks for nothing.
    notes: Vec<String>,
}

#[derive(Serialize)]
struct FrameSummary {
    file: PathBuf,
    stated_exposure: f64,
    exposure: f64,
    /// σ of the ratio to the next shorter exposure as the pixels have it; null where they do not say.
    sigma_relative: Option<f64>,
    /// How far this photograph was moved at most, px.
    moved_px: f64,
    /// The same picture as another one, and left out.
    copy: bool,
}

pub fn run(args: &Args, global: &Global) -> Result<Outcome, CliError> {
    if let [folder] = args.photos.as_slice()
        && folder.is_dir()
    {
        return folder::run(folder, args, global);
    }
    if args.group.is_some() {
        return Err(CliError::wrong(
            "--group divides the photographs of a folder; name one folder, or leave --group out",
        ));
    }
    if args.skip_existing {
        return Err(CliError::wrong("--skip-existing is for a folder; name one, or leave it out"));
    }
    let summary = one(&args.photos, &args.out, args, global)?;
    global.print(&summary, || text(&summary));
    Ok(Outcome::Done)
}

/// Merges one bracket into a file.
fn one(paths: &[PathBuf], out: &Path, args: &Args, global: &Global) -> Result<Summary, CliError> {
    let inputs: Vec<&Path> = paths.iter().chain(&args.times_file).map(PathBuf::as_path).collect();
    check_outputs(&inputs, &[out])?;
    check_ending(out, "exr")?;
    let options = ReadOptions { colour: colour::named(&args.colour)?, ..ReadOptions::default() };
    let photos = read_all(paths, &options, global)?;
    for photo in &photos {
        photo.named_remarks().for_each(|remark| global.warn(&remark));
        if let Some(bad) = photo.nonfinite {
            let (path, (x, y)) = (photo.path.display(), bad.first);
            let n = bad.pixels;
            global.warn(&format!(
                "{path}: {n} px are NaN or infinite, first at ({x}, {y}); taken as 0"
            ));
        }
    }
    let stated = exposures(args, paths, &photos)?;
    let noise = match args.noise.as_deref() {
        Some(&[full_well_e, read_noise_e]) if full_well_e > 0.0 && read_noise_e >= 0.0 => {
            Some(Noise { full_well_e, read_noise_e, measured: true })
        }
        Some(_) => return Err(CliError::wrong("--noise: give full well > 0 and read noise ≥ 0")),
        None => None,
    };
    let frames: Vec<Frame> =
        photos.iter().zip(&stated).map(|(photo, &exposure)| Frame { photo, exposure }).collect();
    let merge_options = MergeOptions {
        refine_exposures: !args.trust_times,
        response: if args.no_response {
            ResponseSource::Stated
        } else {
            ResponseSource::WhereShown
        },
        align: !args.no_align,
        drop_ghosts: !args.no_ghosts,
        noise,
    };
    let merged = bracket::merge(&frames, &merge_options)?;
    for warning in &merged.warnings {
        let word = if warning.asks() { "warning" } else { "note" };
        global.say(&format!("{word}: {warning}"));
    }
    global.go_on()?;
    bracket::file::write(out, &merged)?;
    Ok(summary(out, &stated, &merged))
}

/// Largest file of shutter times, bytes.
const LARGEST_LIST: u64 = 1 << 20;

/// Reads every photograph; tells all that cannot be read together.
fn read_all(
    paths: &[PathBuf],
    options: &ReadOptions,
    global: &Global,
) -> Result<Vec<Encoded>, CliError> {
    let mut photos = Vec::new();
    let mut problems = Vec::new();
    for path in paths {
        global.go_on()?;
        match photo::read_encoded(path, options) {
            Ok(photo) => photos.push(photo),
            Err(error) => problems.push(error.to_string()),
        }
    }
    if problems.is_empty() { Ok(photos) } else { Err(CliError::several(problems)) }
}

fn exposures(args: &Args, paths: &[PathBuf], photos: &[Encoded]) -> Result<Vec<f64>, CliError> {
    let times = match (&args.times, &args.times_file) {
        (Some(times), _) => {
            times.iter().map(|t| exposure::parse_time(t)).collect::<Result<Vec<_>, _>>()?
        }
        (None, Some(file)) => {
            let text = photo::text::read(file, LARGEST_LIST)
                .map_err(|e| CliError::wrong(format!("{}: cannot be read: {e}", file.display())))?;
            exposure::parse_times(&text, paths)?
        }
        (None, None) => return Ok(exposure::from_exif(photos)?),
    };
    Ok(exposure::from_times(photos, &times)?)
}

fn summary(out: &Path, stated: &[f64], merged: &Merged) -> Summary {
    let validity = merged.radiance.validity.pixels();
    let is_copy = |file: &PathBuf| {
        merged.warnings.iter().any(|w| matches!(w, Warning::Duplicate { b, .. } if b == file))
    };
    let (warnings, notes): (Vec<&Warning>, Vec<_>) =
        merged.warnings.iter().partition(|warning| warning.asks());
    let sentences = |said: Vec<&Warning>| said.into_iter().map(ToString::to_string).collect();
    let count = |class: Validity| validity.iter().filter(|&&v| v == class).count();
    let (width, height) = (merged.radiance.mean.width(), merged.radiance.mean.height());
    Summary {
        out: out.to_owned(),
        width,
        height,
        frames: merged
            .paths
            .iter()
            .enumerate()
            .map(|(k, file)| FrameSummary {
                file: file.clone(),
                stated_exposure: stated[k],
                exposure: merged.exposures[k],
                sigma_relative: merged.sigma_exposures[k],
                moved_px: merged.warps[k].reach_px(width, height),
                copy: is_copy(file),
            })
            .collect(),
        full_well_e: merged.noise.full_well_e,
        read_noise_e: merged.noise.read_noise_e,
        noise_measured: merged.noise.measured,
        measured_px: count(Validity::Measured),
        single_px: count(Validity::Single),
        lower_bound_px: count(Validity::LowerBound),
        upper_bound_px: count(Validity::UpperBound),
        moved_px: count(Validity::Moved),
        warnings: sentences(warnings),
        notes: sentences(notes),
    }
}

fn text(summary: &Summary) -> String {
    let n_used = summary.frames.iter().filter(|frame| !frame.copy).count();
    let mut lines = vec![format!(
        "{}: {} × {} px from {} photographs",
        summary.out.display(),
        summary.width,
        summary.height,
        n_used
    )];
    for frame in &summary.frames {
        if frame.copy {
            lines
                .push(format!("  {}  left out: the same picture as another", frame.file.display()));
            continue;
        }
        lines.push(format!(
            "  {}  exposure {:.4e} (stated {:.4e}{})  moved {:.2} px",
            frame.file.display(),
            frame.exposure,
            frame.stated_exposure,
            frame.sigma_relative.map_or(String::new(), |s| format!(", ± {:.2} %", 100.0 * s)),
            frame.moved_px
        ));
    }
    let origin = if summary.noise_measured { "measured" } else { "assumed" };
    lines.push(format!(
        "  full well {:.0} e⁻, read noise {:.1} e⁻ ({origin})",
        summary.full_well_e, summary.read_noise_e
    ));
    lines.push(format!(
        "  pixels seen twice or more {}, once {}, clipped in all {}, below the noise {}, moved {}",
        summary.measured_px,
        summary.single_px,
        summary.lower_bound_px,
        summary.upper_bound_px,
        summary.moved_px
    ));
    lines.join("\n")
}
