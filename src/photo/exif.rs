//! Facts the camera wrote: EXIF.
//!
//! raw EXIF → [`Facts`]. A damaged block gives what could be read of it, never an error: a photograph
//! is still a photograph without it, and whoever needs a fact says that it is missing.

use exif::{Exif, In, Reader, Tag, Value};

use super::Facts;

/// EXIF's word on the colour space of an RGB file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ExifColour {
    Srgb,
    /// "Uncalibrated" with interoperability index R03: Adobe RGB (DCF optional colour space).
    AdobeRgb,
}

/// Facts and colour space from a raw EXIF block (TIFF structure, without the `Exif\0\0` head).
pub(super) fn parse(raw: &[u8]) -> (Facts, Option<ExifColour>) {
    let nothing = || (Facts { orientation: 1, ..Facts::default() }, None);
    let raw = raw.strip_prefix(b"Exif\0\0").unwrap_or(raw);
    // The parser is guarded too: it has no state that a panic could spoil.
    let parsed = std::panic::catch_unwind(|| {
        let mut reader = Reader::new();
        reader.continue_on_error(true);
        reader.read_raw(raw.to_vec()).or_else(|e| e.distill_partial_result(|_| ()))
    });
    match parsed {
        Ok(Ok(exif)) => (facts(&exif), colour(&exif)),
        _ => nothing(),
    }
}

/// Facts from a file that holds an EXIF block; none from any other.
pub(super) fn of_container(mut file: impl std::io::BufRead + std::io::Seek) -> Facts {
    let parsed = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
        let mut reader = Reader::new();
        reader.continue_on_error(true);
        reader.read_from_container(&mut file).or_else(|e| e.distill_partial_result(|_| ()))
    }));
    match parsed {
        Ok(Ok(exif)) => facts(&exif),
        _ => Facts { orientation: 1, ..Facts::default() },
    }
}

fn facts(exif: &Exif) -> Facts {
    Facts {
        exposure_s: number(exif, Tag::ExposureTime).or_else(|| apex_time(exif)),
        f_number: number(exif, Tag::FNumber).or_else(|| apex_aperture(exif)),
        // 65535 fills the tag and says that the number is in one of the others (EXIF 2.3).
        iso: number(exif, Tag::PhotographicSensitivity)
            .filter(|&iso| iso < 65535.0)
            .or_else(|| number(exif, Tag::ISOSpeed))
            .or_else(|| number(exif, Tag::RecommendedExposureIndex))
            .or_else(|| number(exif, Tag::StandardOutputSensitivity)),
        focal_mm: number(exif, Tag::FocalLength),
        focal_35mm: number(exif, Tag::FocalLengthIn35mmFilm),
        orientation: uint(exif, Tag::Orientation)
            .filter(|o| (1..=8).contains(o))
            .map_or(1, |o| o as u8),
        make: text(exif, Tag::Make),
        model: text(exif, Tag::Model),
        lens_model: text(exif, Tag::LensModel),
    }
}

/// A positive finite number, or `None` (0 means "unknown" in every one of these tags).
fn number(exif: &Exif, tag: Tag) -> Option<f64> {
    let value = match &exif.get_field(tag, In::PRIMARY)?.value {
        Value::Rational(v) => v.first()?.to_f64(),
        Value::SRational(v) => v.first()?.to_f64(),
        Value::Short(v) => f64::from(*v.first()?),
        Value::Long(v) => f64::from(*v.first()?),
        Value::Float(v) => f64::from(*v.first()?),
        Value::Double(v) => *v.first()?,
        _ => return None,
    };
    (value.is_finite() && value > 0.0).then_some(value)
}

fn signed(exif: &Exif, tag: Tag) -> Option<f64> {
    let value = match &exif.get_field(tag, In::PRIMARY)?.value {
        Value::Rational(v) => v.first()?.to_f64(),
        Value::SRational(v) => v.first()?.to_f64(),
        _ => return None,
    };
    (value.is_finite() && value.abs() < 30.0).then_some(value)
}

/// Exposure time, s, from APEX ShutterSpeedValue: 2^−Tv.
fn apex_time(exif: &Exif) -> Option<f64> {
    signed(exif, Tag::ShutterSpeedValue).map(|tv| (-tv).exp2())
}

/// f-number from APEX ApertureValue: 2^(Av/2).
fn apex_aperture(exif: &Exif) -> Option<f64> {
    signed(exif, Tag::ApertureValue).map(|av| (av / 2.0).exp2())
}

fn uint(exif: &Exif, tag: Tag) -> Option<u32> {
    exif.get_field(tag, In::PRIMARY)?.value.get_uint(0)
}

fn text(exif: &Exif, tag: Tag) -> Option<String> {
    let Value::Ascii(lines) = &exif.get_field(tag, In::PRIMARY)?.value else { return None };
    // Names end up in reports: no control characters, no endless ones.
    let line: String = String::from_utf8_lossy(lines.first()?)
        .chars()
        .filter(|c| !c.is_control())
        .take(100)
        .collect();
    let line = line.trim();
    (!line.is_empty()).then(|| line.to_string())
}

fn colour(exif: &Exif) -> Option<ExifColour> {
    match uint(exif, Tag::ColorSpace)? {
        1 => Some(ExifColour::Srgb),
        // 2 is not in the standard, but some cameras write it.
        2 => Some(ExifColour::AdobeRgb),
        _ => {
            let index = exif.get_field(Tag::InteroperabilityIndex, In::PRIMARY)?;
            matches!(&index.value, Value::Ascii(v) if v.first().is_some_and(|s| s.starts_with(b"R03")))
                .then_some(ExifColour::AdobeRgb)
        }
    }
}
