//! How much light each frame of a bracket gathered: from EXIF or the user, checked in the pixels.
//!
//! Labels are rounded (1/30 s is really 1/32) and sometimes false, while the ratio of two exposures
//! can be read from pixels that both show: the median of the log ratios is good to 0.04 %
//! (methods-capture C3). A tone curve that is not the assumed one makes the ratio depend on
//! brightness; then the pixels say nothing about the exposures, and the labels are kept.

use std::path::PathBuf;

use rayon::prelude::*;

use super::layer::Layer;
use super::{BracketError, Warning};
use crate::photo::{Encoded, Facts, Format};

/// Exposure t·(ISO/100)/N² of a photograph: linear value = exposure × radiance (up to the camera's
/// own constant). `None` if EXIF lacks the time, the f-number or the ISO.
pub fn exposure(facts: &Facts) -> Option<f64> {
    let (t, n, iso) = (facts.exposure_s?, facts.f_number?, facts.iso?);
    let exposure = t * (iso / 100.0) / (n * n);
    (exposure.is_finite() && exposure > 0.0).then_some(exposure)
}

/// Exposures of all frames from their EXIF.
///
/// # Errors
/// Names the first frame without, what is missing, and the remedy.
pub fn from_exif(photos: &[Encoded]) -> Result<Vec<f64>, BracketError> {
    photos
        .iter()
        .map(|photo| {
            exposure(&photo.facts).ok_or_else(|| BracketError::NoExposure {
                path: photo.path.clone(),
                missing: missing(&photo.facts),
            })
        })
        .collect()
}

/// Exposures from shutter times given by the user.
///
/// ISO and f-number still come from EXIF where every frame has them; where none has, the result is
/// relative (as if f/1 at ISO 100) and cannot be tied to another camera.
///
/// # Errors
/// A wrong number of times, or EXIF in some frames only.
pub fn from_times(photos: &[Encoded], times_s: &[f64]) -> Result<Vec<f64>, BracketError> {
    if times_s.len() != photos.len() {
        return Err(BracketError::TimesCount { times: times_s.len(), photos: photos.len() });
    }
    if let Some(&time) = times_s.iter().find(|t| !(t.is_finite() && **t > 0.0)) {
        return Err(BracketError::BadTime { text: time.to_string() });
    }
    let gains: Vec<Option<f64>> = photos
        .iter()
        .map(|p| exposure(&Facts { exposure_s: Some(1.0), ..p.facts.clone() }))
        .collect();
    if let (Some(some), Some(none)) =
        (gains.iter().position(Option::is_some), gains.iter().position(Option::is_none))
    {
        return Err(BracketError::MixedExif {
            with: photos[some].path.clone(),
            without: photos[none].path.clone(),
        });
    }
    Ok(times_s.iter().zip(gains).map(|(t, gain)| t * gain.unwrap_or(1.0)).collect())
}

/// Reads a list of shutter times: one a line, `name time` or `time` alone, in seconds.
///
/// Times may be fractions (`1/60`). Empty lines and lines that begin with `#` are skipped. With
/// names the order of the lines does not matter; each of `photos` must have one, other files may.
///
/// # Errors
/// A time that is none, a photograph that is not listed or listed twice, lines with and without
/// names, or a wrong number of times.
pub fn parse_times(text: &str, photos: &[PathBuf]) -> Result<Vec<f64>, BracketError> {
    let mut named = Vec::new();
    let mut plain = Vec::new();
    for line in text.lines().map(str::trim).filter(|l| !l.is_empty() && !l.starts_with('#')) {
        match line.rsplit_once(char::is_whitespace) {
            Some((name, time)) => named.push((name.trim(), parse_time(time)?)),
            None => plain.push(parse_time(line)?),
        }
    }
    if named.is_empty() {
        return if plain.len() == photos.len() {
            Ok(plain)
        } else {
            Err(BracketError::TimesCount { times: plain.len(), photos: photos.len() })
        };
    }
    if let Some(&time) = plain.first() {
        return Err(BracketError::TimeWithoutName { time });
    }
    photos
        .iter()
        .map(|photo| {
            let name = photo.file_name().map(|n| n.to_string_lossy().into_owned());
            let mut times = named.iter().filter(|(listed, _)| name.as_deref() == Some(*listed));
            match (times.next(), times.next()) {
                (Some(&(_, time)), None) => Ok(time),
                (None, _) => Err(BracketError::NotListed { path: photo.clone() }),
                (Some(_), Some(_)) => Err(BracketError::ListedTwice { path: photo.clone() }),
            }
        })
        .collect()
}

/// Shutter times that cameras have, s: flashes of a tenth of a microsecond to nights of eleven days.
const TIMES_S: std::ops::RangeInclusive<f64> = 1e-7..=1e6;

/// A time in seconds: `0.5`, `1/60`.
pub fn parse_time(text: &str) -> Result<f64, BracketError> {
    let number = |t: &str| t.trim().parse::<f64>().ok();
    let time = match text.split_once('/') {
        Some((a, b)) => number(a).zip(number(b)).map(|(a, b)| a / b),
        None => number(text),
    };
    time.filter(|t| TIMES_S.contains(t)).ok_or_else(|| BracketError::BadTime { text: text.into() })
}

/// Names what an exposure needs and `facts` lack.
pub(super) fn missing(facts: &Facts) -> String {
    let mut missing = Vec::new();
    for (known, name) in [
        (facts.exposure_s.is_some(), "exposure time"),
        (facts.f_number.is_some(), "f-number"),
        (facts.iso.is_some(), "ISO"),
    ] {
        if !known {
            missing.push(name);
        }
    }
    missing.join(", ")
}

/// Labels this close to the pixels (in log) are kept as they are.
const SAME_AS_LABEL: f64 = 0.005;
/// From here on the user is told.
const WARN_ABOVE: f64 = 0.05;
/// From here on a label is wrong, not rounded.
const WRONG_ABOVE: f64 = 0.25;
/// Pixels two frames must share for a ratio.
const MIN_SHARED_PIXELS: usize = 1000;
/// About this many pixels of larger frames are looked at.
const MOST_SHARED_PIXELS: usize = 1 << 18;
/// Brightness range below which both frames are mostly noise.
const DARKEST_SHARED: f32 = 0.01;
/// A ratio that varies by more than this over brightness is a tone curve, not an exposure.
const CURVE_SPREAD: f64 = 0.10;

/// What neighbouring frames of `order` say of their exposures; `None` where they share too little.
pub(super) fn ratios(layers: &[Layer], order: &[usize]) -> Vec<Option<Ratio>> {
    order.windows(2).map(|pair| ratio(&layers[pair[0]], &layers[pair[1]])).collect()
}

/// Whether neighbouring frames show a tone curve that is not the files' stated one.
pub(super) fn show_tone_curve(
    ratios: &[Option<Ratio>],
    layers: &[Layer],
    labels: &[f64],
    order: &[usize],
) -> bool {
    order.windows(2).zip(ratios).any(|(pair, ratio)| {
        let label = (labels[pair[1]] / labels[pair[0]]).ln();
        ratio.as_ref().is_some_and(|ratio| ratio.is_curve(label, layers[pair[0]].photo))
    })
}

/// Slopes in log-log that a camera's tone curve may have; beyond, the label is wrong.
const CURVE_SLOPES: std::ops::RangeInclusive<f64> = 0.4..=2.5;

/// What two frames say of the ratio of their exposures.
pub(super) struct Ratio {
    /// ln(longer/shorter).
    log: f64,
    /// Its standard error.
    sigma: f64,
    /// Largest difference of the log ratio between brightness bands.
    spread: f64,
}

impl Ratio {
    /// Whether a tone curve explains the ratio better than a wrong label does.
    ///
    /// It does where the ratio depends on brightness; and in a JPEG that a camera developed, whose
    /// times the camera itself wrote, more likely than a label that is 25 % wrong.
    fn is_curve(&self, label: f64, short: &Encoded) -> bool {
        let by_camera = short.format == Format::Jpeg && short.facts.make.is_some();
        self.spread > CURVE_SPREAD
            || by_camera && (self.log - label).abs() > (1.0 + WRONG_ABOVE).ln()
    }
}

/// Exposures as the pixels have them.
pub(super) struct Refined {
    pub exposures: Vec<f64>,
    /// σ of each frame's measured ratio to the next shorter one, relative; `None` where none was measured.
    pub sigma: Vec<Option<f64>>,
}

/// Corrects labels from the pixels; `order` lists the frames by rising label. What it gives for
/// frames that `order` leaves out (copies) means nothing.
///
/// # Errors
/// A label that is more than 25 % away from the pixels.
pub(super) fn refine(
    ratios: &[Option<Ratio>],
    layers: &[Layer],
    labels: &[f64],
    order: &[usize],
    warnings: &mut Vec<Warning>,
) -> Result<Refined, BracketError> {
    let mut log_exposure = vec![0.0; labels.len()];
    let mut sigma = vec![None; labels.len()];
    let mut corrected = false;
    for (pair, ratio) in order.windows(2).zip(ratios) {
        let (short, long) = (pair[0], pair[1]);
        let label = (labels[long] / labels[short]).ln();
        let name = |k: usize| layers[k].photo.path.clone();
        let mut log = label;
        match ratio {
            None => {
                warnings.push(Warning::RatioUnchecked { short: name(short), long: name(long) });
            }
            Some(ratio) if ratio.is_curve(label, layers[short].photo) => {
                if !may_be_curve(label, ratio.log) {
                    return Err(wrong_label(name(short), name(long), label, ratio.log));
                }
                warnings.push(Warning::ToneCurve {
                    short: name(short),
                    long: name(long),
                    label: label.exp(),
                    measured: ratio.log.exp(),
                    spread: ratio.spread,
                });
            }
            Some(ratio) => {
                let off = (ratio.log - label).abs();
                if off > (1.0 + WRONG_ABOVE).ln() {
                    return Err(wrong_label(name(short), name(long), label, ratio.log));
                }
                if off > (1.0 + WARN_ABOVE).ln() {
                    warnings.push(Warning::LabelOff {
                        short: name(short),
                        long: name(long),
                        label: label.exp(),
                        measured: ratio.log.exp(),
                    });
                }
                sigma[long] = Some(ratio.sigma);
                if off > SAME_AS_LABEL {
                    let thirds = whole_thirds(label);
                    let is_thirds = (ratio.log - thirds).abs() <= SAME_AS_LABEL;
                    log = if is_thirds { thirds } else { ratio.log };
                    corrected = true;
                }
            }
        }
        log_exposure[long] = log_exposure[short] + log;
    }
    if !corrected {
        return Ok(Refined { exposures: labels.to_vec(), sigma });
    }
    // Ratios leave one common factor free: the labels are right on average. Of the frames compared:
    // a copy's place in `log_exposure` was never filled.
    let mean_off =
        order.iter().map(|&k| labels[k].ln() - log_exposure[k]).sum::<f64>() / order.len() as f64;
    let exposures = log_exposure.iter().map(|e| (e + mean_off).exp()).collect();
    Ok(Refined { exposures, sigma })
}

/// Whether a tone curve may have made `measured` of a label, both log ratios of exposures: a curve of slope γ in
/// log-log turns a ratio r into r^γ. Exposures that hardly differ have no slope: they must be alike.
fn may_be_curve(label: f64, measured: f64) -> bool {
    let wrong = (1.0 + WRONG_ABOVE).ln();
    if label.abs() < wrong {
        return (measured - label).abs() <= wrong;
    }
    CURVE_SLOPES.contains(&(measured / label))
}

/// A logarithm of a ratio of exposures, in whole thirds of a stop: shutters run in them, whatever round
/// number is engraved (1/15 s is 1/16, 1/60 is 1/64, 1/125 is 1/128).
fn whole_thirds(log: f64) -> f64 {
    let third = std::f64::consts::LN_2 / 3.0;
    (log / third).round() * third
}

fn wrong_label(short: PathBuf, long: PathBuf, label: f64, measured: f64) -> BracketError {
    BracketError::WrongLabel { short, long, label: label.exp(), measured: measured.exp() }
}

/// Median log ratio of two frames over pixels that both show well, and how it varies.
fn ratio(short: &Layer, long: &Layer) -> Option<Ratio> {
    let (w, h) = (long.photo.width, long.photo.height);
    // A regular part is enough; an odd step does not fall into step with a power-of-two row.
    let step = (w * h / MOST_SHARED_PIXELS).max(1) | 1;
    // Chosen by the longer frame only: choosing by the noisy one would favour its upward noise.
    let shared = |i: usize| {
        let (x, y) = (i % w, i / w);
        // Green: the channel with most light and least interpolation.
        let a = long.usable(x, y)?.y;
        if a <= DARKEST_SHARED {
            return None;
        }
        let b = short.usable(x, y)?.y;
        (b > 0.0).then(|| (a, f64::from(a / b).ln()))
    };
    let mut logs: Vec<(f32, f64)> =
        (0..w * h).into_par_iter().step_by(step).filter_map(shared).collect();
    if logs.len() < MIN_SHARED_PIXELS {
        return None;
    }
    let guess = median(logs.iter().map(|l| l.1).collect())?;
    // Both frames above the floor, judged through the longer one.
    let floor = DARKEST_SHARED * guess.exp() as f32;
    logs.retain(|l| l.0 > floor);
    if logs.len() < MIN_SHARED_PIXELS {
        return None;
    }
    let log = median(logs.iter().map(|l| l.1).collect())?;
    let scatter = 1.4826 * median(logs.iter().map(|l| (l.1 - log).abs()).collect())?;
    // A median of normal values scatters 1.2533 times as much as their mean.
    let sigma = 1.2533 * scatter / (logs.len() as f64).sqrt();
    logs.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    const BANDS: usize = 5;
    let bands: Vec<f64> = logs
        .chunks(logs.len().div_ceil(BANDS))
        .filter_map(|band| median(band.iter().map(|l| l.1).collect()))
        .collect();
    let (low, high) = bands
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &b| (low.min(b), high.max(b)));
    Some(Ratio { log, sigma, spread: high - low })
}

/// The middle value; `None` of nothing.
fn median(mut values: Vec<f64>) -> Option<f64> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// ISO that cancels the shutter: 1:1.000 on the label and 1:0.981 in the pixels was called a wrong label.
    #[test]
    fn like_exposures_that_measure_alike_are_no_wrong_label() {
        assert!(may_be_curve(0.0, 0.981f64.ln()) && may_be_curve(0.18, 0.2));
        assert!(!may_be_curve(0.0, 1.3f64.ln()));
        let stops = |n: f64| n * std::f64::consts::LN_2;
        assert!(may_be_curve(stops(2.0), stops(3.0)) && !may_be_curve(stops(2.0), stops(-0.1)));
    }

    #[test]
    fn exposure_needs_time_aperture_and_iso() {
        let mut facts = Facts {
            exposure_s: Some(1.0 / 160.0),
            f_number: Some(8.0),
            iso: Some(200.0),
            ..Facts::default()
        };
        assert!((exposure(&facts).unwrap() - 2.0 / 160.0 / 64.0).abs() < 1e-15);
        facts.f_number = None;
        assert_eq!(exposure(&facts), None);
    }

    #[test]
    fn times_may_be_fractions_named_or_plain() {
        let photos = [PathBuf::from("x/a.jpg"), PathBuf::from("x/b.jpg")];
        assert_eq!(parse_times("b.jpg 1/4\n# dark\na.jpg  2\n", &photos).unwrap(), [2.0, 0.25]);
        assert_eq!(parse_times("1/8\n0.5\n", &photos).unwrap(), [0.125, 0.5]);
        // A file that lists more than this bracket is read for what it names.
        let more = parse_times("b.jpg 1/4\nc.jpg 7\na.jpg  2\n", &photos).unwrap();
        assert_eq!(more, [2.0, 0.25]);
        for (bad, told) in [
            ("b.jpg 1/4\na.jpg 2\n0.5", "0.5"),
            ("a.jpg 2\nb.jpg 1/4\na.jpg 3", "a.jpg"),
            ("a.jpg 2\nc.jpg 1", "b.jpg"),
        ] {
            let error = parse_times(bad, &photos).unwrap_err().to_string();
            assert!(error.contains(told) && error.contains(';'), "{bad:?}: {error}");
        }
        for bad in ["1/0\n1", "a.jpg 1", "1\n2\n3", "x y\nz w", "-1\n1", "nan\n1", "1e300\n1"] {
            assert!(parse_times(bad, &photos).is_err(), "{bad:?}");
        }
    }
}
