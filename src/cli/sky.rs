//! `platelight sky`: a clear sky of a place and time → lat-long panorama, or a day of them.

use std::f64::consts::PI;
use std::path::{Path, PathBuf};

use glam::DVec3;
use serde::Serialize;

use super::outputs::{check_ending, check_outputs, write_png};
use super::{CliError, Global, Outcome};
use crate::conventions::{Rgb, luminance};
use crate::light::Moment;
use crate::light::sky::{self, Sky, SkyError, Strength};
use crate::light::sun_position::{Place, SunPosition, sun_position};
use crate::photo::tone::{self, ToneCurve};
use crate::probe::file;
use crate::probe::unwrap::check_width;
use crate::shot::frames::{frame_path, has_pattern};

/// Calculate the clear sky of a place and time, with its sun, as a lat-long panorama
///
/// For what no probe saw: there are no clouds in it, and sun against sky is good to 25 %, whatever the
/// weather looked like. In the world, -Z is north and +X east unless --north turns it; compare the
/// printed direction of the shadows with one in the plate. A level white card has radiance 1, in a
/// sequence at its brightest moment.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  platelight sky --place 48.14,11.58 --time 2026-06-21T12:00:00+02:00 \\
      -o sky.exr --preview sky.png
  platelight sky --sun 215,40 --turbidity 5 --no-sun -o sky.exr
  platelight sky --place 48.14,11.58 --time 2026-06-21T05:00:00+02:00 \\
      --until 2026-06-21T21:30:00+02:00 --every 15min -o day.####.exr")]
pub struct Args {
    /// Latitude and longitude in degrees, north and east positive
    #[arg(
        long,
        value_name = "LAT,LON",
        value_delimiter = ',',
        allow_hyphen_values = true,
        requires = "time",
        required_unless_present = "sun"
    )]
    place: Option<Vec<f64>>,
    /// The moment with its zone, 2026-06-21T12:00:00+02:00 or …Z; +02:00 is what the clock was ahead of UTC, summer
    /// time included
    #[arg(long, value_name = "TIME", requires = "place")]
    time: Option<Moment>,
    /// Instead of place and time: where the sun is seen, degrees clockwise from true north and above the horizon
    #[arg(
        long,
        value_name = "AZIMUTH,ELEVATION",
        value_delimiter = ',',
        allow_hyphen_values = true,
        conflicts_with_all = ["place", "time", "until"]
    )]
    sun: Option<Vec<f64>>,
    /// A sequence: its last moment
    #[arg(long, value_name = "TIME", requires = "every")]
    until: Option<Moment>,
    /// A sequence: from one moment to the next, 30s, 15min or 1h
    #[arg(long, value_name = "STEP", requires = "until")]
    every: Option<String>,
    /// A sequence: number of the first file
    #[arg(long, value_name = "N", default_value_t = 1, requires = "until")]
    first_frame: u32,
    /// Haze: 2 is mountain air, 3 a clear day, 6 hazy, 10 the most
    #[arg(long, value_name = "T", default_value_t = sky::DEFAULT_TURBIDITY)]
    turbidity: f64,
    /// Albedo of the ground below the horizon: one number or R,G,B
    #[arg(long, value_name = "R,G,B", value_delimiter = ',', default_value = "0.2")]
    ground: Vec<f32>,
    /// Where the world's -Z points: degrees from true north, clockwise
    #[arg(long, value_name = "DEG", default_value_t = 0.0, allow_hyphen_values = true)]
    north: f64,
    /// Irradiance of level ground by the sky alone, luminance: sets the unit, lux if it is in lux; the
    /// sun follows by the model
    #[arg(long, value_name = "E")]
    sky_irradiance: Option<f64>,
    /// Irradiance by the sun alone of a surface that faces it; the sky follows by the model unless it
    /// is given too
    #[arg(long, value_name = "R,G,B", value_delimiter = ',', conflicts_with = "until")]
    sun_irradiance: Option<Vec<f64>>,
    /// Leave the sun's disc out, for a renderer that has a sun of its own: its numbers are printed
    #[arg(long)]
    no_sun: bool,
    /// Texels across; the height is half
    #[arg(long, value_name = "N", default_value_t = 2048)]
    width: usize,
    /// The EXR to write; with --until a name with #### for the number
    #[arg(long, short, value_name = "FILE")]
    out: PathBuf,
    /// Also write it as a PNG to look at
    #[arg(long, value_name = "PNG")]
    preview: Option<PathBuf>,
}

/// What was written, for people and machines.
#[derive(Serialize)]
struct Summary {
    width: usize,
    height: usize,
    turbidity: f64,
    sun_in_map: bool,
    /// Relative standard error of the sun's irradiance over the sky's.
    sigma_sun_over_sky: f64,
    frames: Vec<FrameSummary>,
    /// Moments without a sun above the horizon.
    left_out: Vec<Instant>,
}

/// When, and where the sun is seen then: degrees clockwise from true north and above the horizon.
#[derive(Clone, Copy, Serialize)]
struct Instant {
    #[serde(skip_serializing_if = "Option::is_none")]
    frame: Option<i64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    time: Option<Moment>,
    #[serde(flatten)]
    sun: SunPosition,
}

/// A sky and when it is seen.
struct Lit {
    instant: Instant,
    sky: Sky,
}

#[derive(Serialize)]
struct FrameSummary {
    out: PathBuf,
    #[serde(flatten)]
    instant: Instant,
    /// Toward the sun, world axes.
    direction: [f64; 3],
    half_angle_deg: f64,
    /// Of a surface that faces the sun, by the sun alone.
    sun_irradiance: [f32; 3],
    /// Of level ground: by the sky alone, and in all.
    sky_irradiance: [f32; 3],
    level_irradiance: [f32; 3],
}

pub fn run(args: &Args, global: &Global) -> Result<Outcome, CliError> {
    check_names(args)?;
    check_width(args.width)?;
    if args.width > MOST_TEXELS {
        return Err(CliError::wrong(format!(
            "--width: {} texels across take tens of gigabytes; at most {MOST_TEXELS} show the sun's disc 24 texels \
             across",
            args.width
        )));
    }
    if !args.north.is_finite() {
        return Err(CliError::wrong(format!("--north: {} is no angle in degrees", args.north)));
    }
    let instants = instants(args)?;
    let (skies, left_out) = skies(args, &instants)?;
    let skies = in_one_unit(args, skies)?;
    if !left_out.is_empty() {
        global.say(&format!(
            "note: {} of {} moments are left out: the sun is below the horizon",
            left_out.len(),
            instants.len()
        ));
    }
    let mut frames = Vec::with_capacity(skies.len());
    let brightest =
        skies.iter().map(|lit| luminance(lit.sky.level_irradiance())).fold(0.0, f32::max);
    for lit in &skies {
        global.go_on()?;
        frames.push(write(args, lit, brightest)?);
    }
    let summary = Summary {
        width: args.width,
        height: args.width / 2,
        turbidity: args.turbidity,
        sun_in_map: !args.no_sun,
        sigma_sun_over_sky: sky::SIGMA,
        frames,
        left_out,
    };
    global.print(&summary, || text(&summary));
    Ok(Outcome::Done)
}

/// Of this width a map takes 13 GB while it is written (96 bytes a texel: 0.8 GB at 4096).
const MOST_TEXELS: usize = 1 << 14;

/// A sequence needs a number in its names, and only a sequence has one.
fn check_names(args: &Args) -> Result<(), CliError> {
    let files = [Some((&args.out, "exr")), args.preview.as_ref().map(|path| (path, "png"))];
    for (path, ending) in files.into_iter().flatten() {
        check_ending(path, ending)?;
        let name = path.display();
        match (has_pattern(path), args.until.is_some()) {
            (false, true) => {
                return Err(CliError::wrong(format!(
                    "{name}: a sequence is many files; write #### where the number goes, sky.####.{ending}"
                )));
            }
            (true, false) => {
                return Err(CliError::wrong(format!(
                    "{name}: has #### for a number, but this is one moment; add --until and --every, or \
                     name one file"
                )));
            }
            _ => {}
        }
    }
    // The others differ by their numbers alone.
    let first = |path: &PathBuf| frame_path(path, i64::from(args.first_frame));
    let outputs: Vec<PathBuf> =
        [Some(&args.out), args.preview.as_ref()].into_iter().flatten().map(first).collect();
    let outputs: Vec<&Path> = outputs.iter().map(PathBuf::as_path).collect();
    check_outputs(&[], &outputs)
}

/// More skies than minutes of a week are a slip of the finger.
const MOST_FRAMES: f64 = 10_080.0;

/// Every moment asked for, with its sun.
fn instants(args: &Args) -> Result<Vec<Instant>, CliError> {
    if let Some(values) = &args.sun {
        let wrong = || {
            CliError::wrong(format!(
                "--sun: {values:?} is no azimuth and elevation; write two numbers of degrees, 215,40"
            ))
        };
        let &[azimuth_deg, elevation_deg] = values.as_slice() else { return Err(wrong()) };
        if !(azimuth_deg.is_finite() && elevation_deg.abs() <= 90.0) {
            return Err(wrong());
        }
        let sun = SunPosition { azimuth_deg: azimuth_deg.rem_euclid(360.0), elevation_deg };
        return Ok(vec![Instant { frame: None, time: None, sun }]);
    }
    let (Some(place), Some(start)) = (&args.place, args.time) else {
        return Err(CliError::wrong("--place and --time, or --sun, are needed"));
    };
    let &[latitude, longitude] = place.as_slice() else {
        return Err(CliError::wrong(format!(
            "--place: {} numbers were given; two are needed, latitude and longitude: 48.14,11.58",
            place.len()
        )));
    };
    let place = Place::new(latitude, longitude)
        .map_err(|error| CliError::wrong(format!("--place: {error}")))?;
    let at = |frame: Option<i64>, time: Moment| Instant {
        frame,
        time: Some(time),
        sun: sun_position(time, place),
    };
    let (Some(end), Some(step)) = (args.until, &args.every) else {
        return Ok(vec![at(None, start)]);
    };
    let step = seconds(step).ok_or_else(|| {
        CliError::wrong(format!("--every: \"{step}\" is no step; write 30s, 15min or 1h"))
    })?;
    let span = end.seconds_since(start);
    if !(span >= 0.0) {
        return Err(CliError::wrong(format!("--until: {end} is before --time {start}")));
    }
    // A step that is a fraction of a second must not lose the last moment to rounding.
    let last = (span / step + 1e-6).floor();
    if last >= MOST_FRAMES {
        return Err(CliError::wrong(format!(
            "--every: {} skies from {start} to {end}; at most {MOST_FRAMES} are made at once: take a \
             longer step",
            last + 1.0
        )));
    }
    let number = |k: u32| i64::from(args.first_frame) + i64::from(k);
    let moments = (0..=last as u32).map(|k| at(Some(number(k)), start.later(f64::from(k) * step)));
    Ok(moments.collect())
}

/// `30s`, `15min`, `15m`, `1h`, or seconds; above 0.
fn seconds(text: &str) -> Option<f64> {
    let unit = text.trim_start_matches(|c: char| c.is_ascii_digit() || c == '.');
    let number: f64 = text[..text.len() - unit.len()].parse().ok()?;
    let each = match unit {
        "" | "s" => 1.0,
        "m" | "min" => 60.0,
        "h" => 3600.0,
        _ => return None,
    };
    Some(number * each).filter(|s| s.is_finite() && *s > 0.0)
}

/// The skies that there are, in the model's unit, and the moments without a sun.
fn skies(args: &Args, instants: &[Instant]) -> Result<(Vec<Lit>, Vec<Instant>), CliError> {
    let ground: Rgb = rgb("--ground", &args.ground)?;
    let (mut skies, mut left_out) = (Vec::new(), Vec::new());
    let mut night = None;
    for instant in instants {
        let SunPosition { azimuth_deg, elevation_deg } = instant.sun;
        match Sky::of_model(instant.sun.direction(args.north), args.turbidity, ground) {
            Ok(sky) => skies.push(Lit { instant: *instant, sky }),
            Err(error @ SkyError::BelowHorizon(_)) => {
                left_out.push(*instant);
                night.get_or_insert_with(|| {
                    let asked =
                        instant.time.map_or("--sun".to_owned(), |time| format!("--time {time}"));
                    format!(
                        "{asked}: azimuth {azimuth_deg:.1}°, elevation {elevation_deg:.1}°: {error}"
                    )
                });
            }
            Err(error) => return Err(CliError::wrong(format!("--{}: {error}", error.key()))),
        }
    }
    match night {
        Some(problem) if skies.is_empty() => Err(CliError::wrong(problem)),
        _ => Ok((skies, left_out)),
    }
}

/// The skies in the unit asked for, which is set at the brightest moment of all.
fn in_one_unit(args: &Args, skies: Vec<Lit>) -> Result<Vec<Lit>, CliError> {
    let level = |sky: &Sky| f64::from(luminance(sky.level_irradiance()));
    let brightest = skies.iter().map(|lit| &lit.sky).max_by(|a, b| level(a).total_cmp(&level(b)));
    // There is one: no sky at all is an error before.
    let Some(brightest) = brightest.cloned() else { return Ok(skies) };
    let sun = args.sun_irradiance.as_deref();
    let sun: Option<DVec3> = sun.map(|values| rgb("--sun-irradiance", values)).transpose()?;
    let strength = Strength { sky: args.sky_irradiance, sun };
    let before = f64::from(luminance(brightest.sky_irradiance()));
    let white = PI / level(&brightest);
    let chosen = brightest.scaled(white).with_strength(&strength).map_err(|error| {
        let option =
            if args.sun_irradiance.is_some() { "--sun-irradiance" } else { "--sky-irradiance" };
        CliError::wrong(format!("{option}: {error}"))
    })?;
    if sun.is_some() {
        return Ok(skies.into_iter().map(|lit| Lit { sky: chosen.clone(), ..lit }).collect());
    }
    let factor = f64::from(luminance(chosen.sky_irradiance())) / before;
    Ok(skies.into_iter().map(|lit| Lit { sky: lit.sky.scaled(factor), ..lit }).collect())
}

/// One number for all channels, or three.
fn rgb<T: Copy, V: From<[T; 3]>>(option: &str, values: &[T]) -> Result<V, CliError> {
    match *values {
        [all] => Ok([all; 3].into()),
        [r, g, b] => Ok([r, g, b].into()),
        _ => Err(CliError::wrong(format!(
            "{option}: {} numbers were given; write one, or three for red, green and blue",
            values.len()
        ))),
    }
}

/// Writes one sky; all previews of a sequence have the exposure of its brightest moment.
fn write(
    args: &Args,
    Lit { instant, sky }: &Lit,
    brightest: f32,
) -> Result<FrameSummary, CliError> {
    let name = |path: &PathBuf| instant.frame.map_or(path.clone(), |frame| frame_path(path, frame));
    let out = name(&args.out);
    let panorama =
        if args.no_sun { sky.panorama(args.width) } else { sky.panorama_with_sun(args.width) };
    file::write(&out, &panorama)?;
    if let Some(path) = &args.preview {
        let stops = (SHOWN * PI as f32 / brightest).log2();
        write_png(&name(path), &tone::display(&panorama.radiance, stops, ToneCurve::REINHARD))?;
    }
    let sun = sky.sun();
    Ok(FrameSummary {
        out,
        instant: *instant,
        direction: sun.direction.as_dvec3().to_array(),
        half_angle_deg: f64::from(sun.half_angle).to_degrees(),
        sun_irradiance: sky.sun_irradiance().to_array(),
        sky_irradiance: sky.sky_irradiance().to_array(),
        level_irradiance: sky.level_irradiance().to_array(),
    })
}

/// Radiance at which a preview's level white card lies, before light rolls off.
const SHOWN: f32 = 2.0;

fn text(summary: &Summary) -> String {
    let numbers = |rgb: [f32; 3]| rgb.map(|v| format!("{v:.4}")).join(" ");
    let mut lines = Vec::new();
    for frame in &summary.frames {
        let FrameSummary { out, instant, direction: [x, y, z], .. } = frame;
        let SunPosition { azimuth_deg, elevation_deg } = instant.sun;
        let when = instant.time.map_or(String::new(), |time| format!("{time}, "));
        let shadows = (azimuth_deg + 180.0).rem_euclid(360.0);
        if summary.frames.len() > 1 {
            lines.push(format!(
                "{}: {when}sun at azimuth {azimuth_deg:.2}°, elevation {elevation_deg:.2}°",
                out.display()
            ));
            continue;
        }
        lines.push(format!("{}: {} × {} texels", out.display(), summary.width, summary.height));
        lines.push(format!(
            "  {when}sun at azimuth {azimuth_deg:.2}°, elevation {elevation_deg:.2}°; shadows point to azimuth \
             {shadows:.1}°: compare one in the plate"
        ));
        lines.push(format!(
            "  toward the sun: {x:.4} {y:.4} {z:.4}; it gives {} to what faces it",
            numbers(frame.sun_irradiance)
        ));
        lines.push(format!(
            "  level ground has {} from the sky, {} in all",
            numbers(frame.sky_irradiance),
            numbers(frame.level_irradiance)
        ));
    }
    let sun = if summary.sun_in_map { "is drawn into the map" } else { "is left out of the map" };
    lines.push(format!(
        "  the sun {sun}; sun against sky is good to {:.0} % on a clear day",
        100.0 * summary.sigma_sun_over_sky
    ));
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_read_as_they_are_written() {
        for (text, wanted) in
            [("30s", 30.0), ("15min", 900.0), ("1.5h", 5400.0), ("2m", 120.0), ("7", 7.0)]
        {
            assert_eq!(seconds(text), Some(wanted), "{text}");
        }
        for text in ["", "min", "0s", "-1h", "1 day", "15minutes", "1..5h", "é"] {
            assert_eq!(seconds(text), None, "{text}");
        }
    }
}
