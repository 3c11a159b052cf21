//! `platelight preview`: any picture → a PNG to look at.

use std::path::PathBuf;

use serde::Serialize;

use super::outputs::{check_ending, check_outputs};
use super::{CliError, Global, Outcome};
use crate::photo::tone::{self, ToneCurve};
use crate::photo::{self, Encoding, EncodingSource, Primaries, ReadOptions, Transfer, colour, png};

/// Show any picture as an 8-bit sRGB PNG
///
/// For looking only: exposure and tone curve are applied, EXIF orientation is honoured, NaN and
/// infinite pixels are black.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  platelight preview ball.exr --exposure auto --curve reinhard --out ball.png\n  \
                        platelight preview composite.exr --layer difference --exposure 3"
)]
pub struct Args {
    /// EXR, Radiance HDR, PNG, TIFF or JPEG
    #[arg(value_name = "PICTURE")]
    picture: PathBuf,
    /// The PNG to write [default: the picture's name with .preview.png]
    #[arg(long, short, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Stops of exposure to add, or "auto": the middle of the picture becomes 18 % grey
    #[arg(long, default_value = "0", allow_hyphen_values = true, value_name = "STOPS")]
    exposure: String,
    /// How light above white is shown: cut off, or rolled off
    #[arg(long, value_enum, default_value_t = Curve::Srgb)]
    curve: Curve,
    /// EXR layer to show
    #[arg(long, value_name = "NAME")]
    layer: Option<String>,
    /// Colour space of the picture, where it does not say it itself
    #[arg(long, alias = "color", default_value = "auto", value_name = "NAME")]
    colour: String,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Curve {
    Srgb,
    Reinhard,
}

/// What was shown, for people and machines.
#[derive(Serialize)]
struct Summary {
    out: PathBuf,
    width: usize,
    height: usize,
    stops: f32,
    /// Share of pixels that are white or brighter in the preview.
    white: f64,
    nonfinite_px: u64,
}

pub fn run(args: &Args, global: &Global) -> Result<Outcome, CliError> {
    let options = ReadOptions {
        colour: colour::named(&args.colour)?,
        layer: args.layer.clone(),
        ..ReadOptions::default()
    };
    let out = args.out.clone().unwrap_or_else(|| args.picture.with_extension("preview.png"));
    check_outputs(&[&args.picture], &[&out])?;
    check_ending(&out, "png")?;
    let stops = match args.exposure.as_str() {
        "auto" => None,
        text => Some(text.parse().ok().filter(|s: &f32| s.abs() <= 60.0).ok_or_else(|| {
            CliError::wrong(format!("--exposure {text}: give stops between -60 and 60, or auto"))
        })?),
    };
    let photo = photo::read(&args.picture, &options)?;
    photo.named_remarks().for_each(|remark| global.warn(&remark));
    let stops = stops.unwrap_or_else(|| tone::automatic_stops(&photo.linear));
    let curve = match args.curve {
        Curve::Srgb => ToneCurve::Clip,
        Curve::Reinhard => ToneCurve::Reinhard,
    };
    let shown = tone::display(&photo.linear, stops, curve);
    let white = shown.pixels().iter().filter(|l| l.min_element() >= 1.0).count() as f64
        / shown.pixels().len() as f64;
    let encoding = Encoding {
        transfer: Transfer::Srgb,
        primaries: Primaries::Rec709,
        source: EncodingSource::Named,
    };
    global.go_on()?;
    png::write(&out, &png::srgb_codes(&shown), shown.width(), shown.height(), &encoding)?;
    if white > 0.9 && args.exposure != "auto" {
        let share = 100.0 * white;
        global.warn(&format!("{share:.0} % of the preview is white; try --exposure auto"));
    }
    let nonfinite_px = photo.nonfinite.map_or(0, |bad| bad.pixels);
    let summary =
        Summary { out, width: shown.width(), height: shown.height(), stops, white, nonfinite_px };
    global.print(&summary, || {
        let bad = match summary.nonfinite_px {
            0 => String::new(),
            n => format!(", {n} px NaN or infinite shown black"),
        };
        let (path, w, h) = (summary.out.display(), summary.width, summary.height);
        format!("{path}: {w} × {h} px at {stops:+.2} stops{bad}")
    });
    Ok(Outcome::Done)
}
