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
                        platelight preview composite.exr --layer difference --exposure 3\n  \
                        platelight preview garden.exr --curve reinhard --key 0.36 --white 8\n  \
                        platelight preview garden.exr --curve ward --candela 5000"
)]
pub struct Args {
    /// EXR, Radiance HDR, PNG, TIFF or JPEG
    #[arg(value_name = "PICTURE")]
    picture: PathBuf,
    /// The PNG to write [default: the picture's name with .preview.png]
    #[arg(long, short, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Stops of exposure to add, or "auto": the middle of the picture (its log-average) becomes 18 % grey
    #[arg(long, default_value = "0", allow_hyphen_values = true, value_name = "STOPS")]
    exposure: String,
    /// How light is shown
    #[arg(long, value_enum, default_value_t = Curve::Srgb)]
    curve: Curve,
    /// Instead of --exposure: the grey that the log-average becomes, 0.18 as with "auto"
    #[arg(long, value_name = "GREY", conflicts_with = "exposure")]
    key: Option<f64>,
    /// The light, after exposure, that --curve reinhard shows just white [default: the brightest pixel's]
    #[arg(long, value_name = "L")]
    white: Option<f32>,
    /// The exponent of --curve gamma
    #[arg(long, value_name = "G", default_value_t = 2.2)]
    gamma: f32,
    /// What the value 1 is in cd/m2, after exposure, for --curve ward: the eye's thresholds depend on it
    #[arg(long, value_name = "N", default_value_t = 100.0)]
    candela: f32,
    /// EXR layer to show
    #[arg(long, value_name = "NAME")]
    layer: Option<String>,
    /// Colour space of the picture, where it does not say it itself
    #[arg(long, alias = "color", default_value = "auto", value_name = "NAME")]
    colour: String,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Curve {
    /// Cut off at white; the exact sRGB curve below
    Srgb,
    /// Rolled off: Reinhard's photographic operator (2002), global
    Reinhard,
    /// Never quite white: 1 - exp(-L)
    Exponential,
    /// Histogram adjustment with the contrast that an eye would see (Ward Larson 1997), for a screen of
    /// 1 to 100 cd/m2; --exposure auto is no help to it, --candela is
    Ward,
    /// The linear values as codes, for reading them off
    Linear,
    /// L^(1/gamma) as codes
    Gamma,
}

impl Args {
    /// The curve with its numbers.
    fn tone_curve(&self) -> Result<ToneCurve, CliError> {
        let positive = |option: &str, value: f32| {
            let usable = value.is_finite() && (1e-6..=1e9).contains(&value);
            usable.then_some(value).ok_or_else(|| {
                CliError::wrong(format!("{option} {value}: give a number between 1e-6 and 1e9"))
            })
        };
        let is_reinhard = matches!(self.curve, Curve::Reinhard);
        if self.white.is_some() && !is_reinhard {
            return Err(CliError::wrong("--white: is for --curve reinhard; leave it out"));
        }
        Ok(match self.curve {
            Curve::Srgb => ToneCurve::Clip,
            Curve::Reinhard => {
                let white = self.white.map(|white| positive("--white", white)).transpose()?;
                ToneCurve::Reinhard { white }
            }
            Curve::Exponential => ToneCurve::Exponential,
            Curve::Ward => ToneCurve::Ward { white_cd_m2: positive("--candela", self.candela)? },
            Curve::Linear => ToneCurve::Linear,
            Curve::Gamma => ToneCurve::Gamma { gamma: positive("--gamma", self.gamma)? },
        })
    }
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
    let curve = args.tone_curve()?;
    if let Some(key) = args.key.filter(|key| !(1e-6..=1e6).contains(key)) {
        return Err(CliError::wrong(format!("--key {key}: give a grey between 1e-6 and 1e6")));
    }
    let photo = photo::read(&args.picture, &options)?;
    photo.named_remarks().for_each(|remark| global.warn(&remark));
    let stops = match args.key {
        Some(key) => tone::stops_for_key(&photo.linear, key),
        None => stops.unwrap_or_else(|| tone::automatic_stops(&photo.linear)),
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
    if white > 0.9 && args.key.is_none() && args.exposure != "auto" {
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
