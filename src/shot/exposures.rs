//! How much light each photograph took in, and how the probe's scale is tied to the plate's.

use std::path::Path;

use serde::Serialize;

use super::camera_keys::ExposureKeys;
use crate::bracket;
use crate::photo::{Encoded, Facts, Photo};

/// The probe's radiance × `factor` = plate value.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Scale {
    pub factor: f64,
    pub source: String,
}

/// Exposures t · (ISO/100) / N² of a bracket, in the order of its photographs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Exposures {
    pub values: Vec<f64>,
    pub source: &'static str,
}

/// The plate's factor, from `relative_exposure`, the shot file or EXIF.
pub fn plate_scale(
    photo: &Photo,
    keys: &ExposureKeys,
    relative: Option<f64>,
) -> Result<Scale, String> {
    if let Some(factor) = relative {
        let source = "plate.relative_exposure".to_owned();
        return possible(Scale { factor, source });
    }
    let facts = with_keys(&photo.facts, keys);
    match bracket::exposure::exposure(&facts) {
        Some(factor) => possible(Scale { factor, source: who_said(keys).to_owned() }),
        None => Err(format!(
            "plate.exposure: {}: {} not known; write exposure = {{ time_s = …, f_number = …, iso = … }} \
             or relative_exposure = … into [plate]",
            photo.path.display(),
            missing(&facts)
        )),
    }
}

/// A scale that f32 pictures survive, their variances squared.
///
/// Between an hour at f/1 and ISO 100 000 and a flash of a microsecond at f/64 lie 17 powers of ten.
fn possible(scale: Scale) -> Result<Scale, String> {
    const SCALES: std::ops::RangeInclusive<f64> = 1e-12..=1e12;
    if SCALES.contains(&scale.factor) {
        return Ok(scale);
    }
    Err(format!(
        "{}: the plate would hold {:e} times the probe's radiance; no two exposures are so far apart: \
         correct it",
        scale.source, scale.factor
    ))
}

/// The exposures of a probe's photographs. `tied` is false if the plate's scale does not need them.
///
/// `key` names the photographs in messages.
pub fn of_bracket(
    photos: &[Encoded],
    keys: &[ExposureKeys],
    tied: bool,
    key: &str,
) -> Result<Exposures, Vec<String>> {
    if !keys.is_empty() && keys.len() != photos.len() {
        return Err(vec![format!(
            "{key}.exposures: {} are given for {} photographs; give one for each, in the order of \
             their names",
            keys.len(),
            photos.len()
        )]);
    }
    // One picture of radiance, or one photograph whose scale the plate's key gives.
    if let [single] = photos
        && (!tied || is_radiance(&single.path))
        && keys.is_empty()
    {
        return Ok(Exposures { values: vec![1.0], source: "one picture, taken as radiance" });
    }
    let mut values = Vec::with_capacity(photos.len());
    let mut problems = Vec::new();
    for (i, photo) in photos.iter().enumerate() {
        let facts = with_keys(&photo.facts, &keys.get(i).copied().unwrap_or_default());
        match bracket::exposure::exposure(&facts) {
            Some(value) => values.push(value),
            None => problems.push(format!(
                "{key}.photos: {}: {} not known; write exposures = [{{ time_s = …, f_number = …, \
                 iso = … }}, …], one for each photograph, into {key}",
                photo.path.display(),
                missing(&facts)
            )),
        }
    }
    let source = if keys.is_empty() { "EXIF" } else { "the shot file" };
    if problems.is_empty() { Ok(Exposures { values, source }) } else { Err(problems) }
}

/// What the shot file gives goes before what the camera wrote.
fn with_keys(facts: &Facts, keys: &ExposureKeys) -> Facts {
    Facts {
        exposure_s: keys.time_s.or(facts.exposure_s),
        f_number: keys.f_number.or(facts.f_number),
        iso: keys.iso.or(facts.iso),
        ..facts.clone()
    }
}

fn who_said(keys: &ExposureKeys) -> &'static str {
    match (keys.time_s, keys.f_number, keys.iso) {
        (None, None, None) => "EXIF",
        (Some(_), Some(_), Some(_)) => "plate.exposure",
        _ => "plate.exposure and EXIF",
    }
}

/// "exposure time and ISO are", "f-number is".
fn missing(facts: &Facts) -> String {
    let names: Vec<&str> = [
        (facts.exposure_s.is_none(), "exposure time"),
        (facts.f_number.is_none(), "f-number"),
        (facts.iso.is_none(), "ISO"),
    ]
    .into_iter()
    .filter_map(|(missing, name)| missing.then_some(name))
    .collect();
    match names.as_slice() {
        [] => "its exposure is".to_owned(),
        [one] => format!("{one} is"),
        [first, .., last] if names.len() == 3 => format!("{first}, {} and {last} are", names[1]),
        [first, last, ..] => format!("{first} and {last} are"),
    }
}

/// Formats that hold radiance, not photographs.
fn is_radiance(path: &Path) -> bool {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default();
    ["exr", "hdr", "pic"].contains(&extension.to_ascii_lowercase().as_str())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::conventions::Rgb;
    use crate::photo::Image;

    fn photo(time: Option<f64>, name: &str) -> Photo {
        let facts =
            Facts { exposure_s: time, f_number: Some(2.0), iso: Some(200.0), ..Facts::default() };
        Photo { facts, path: name.into(), ..Photo::from_linear(Image::filled(1, 1, Rgb::ONE)) }
    }

    #[test]
    fn a_scale_that_no_two_exposures_have_is_refused() {
        let photo = Photo::from_linear(Image::filled(1, 1, Rgb::ONE));
        let scale = |relative| plate_scale(&photo, &ExposureKeys::default(), Some(relative));
        assert!(scale(1e-9).is_ok() && scale(40.0).is_ok());
        for far in [1e300, 1e38, 1e-45, 1e-300] {
            let said = scale(far).unwrap_err();
            assert!(said.contains("plate.relative_exposure"), "{said}");
        }
    }

    #[test]
    fn shot_file_goes_before_exif_field_by_field() {
        let keys = ExposureKeys { time_s: Some(0.5), ..Default::default() };
        let scale = plate_scale(&photo(Some(9.0), "p.png"), &keys, None).unwrap();
        // 0.5 s · 200/100 / 2²
        assert!((scale.factor - 0.25).abs() < 1e-12);
        assert_eq!(scale.source, "plate.exposure and EXIF");
        let relative = plate_scale(&photo(None, "p.png"), &keys, Some(3.0)).unwrap();
        assert_eq!(relative.factor, 3.0);
    }

    #[test]
    fn missing_facts_are_named_with_their_remedy() {
        let error = plate_scale(&photo(None, "p.png"), &ExposureKeys::default(), None).unwrap_err();
        assert!(error.contains("exposure time is not known; write exposure ="), "{error}");
        let photos = [photo(Some(1.0), "a.jpg"), photo(None, "b.jpg")].map(|photo| photo.encoded());
        let errors = of_bracket(&photos, &[], true, "probe.ball").unwrap_err();
        assert!(errors.len() == 1 && errors[0].contains("b.jpg"), "{errors:?}");
        let errors = of_bracket(&photos, &[ExposureKeys::default()], true, "k").unwrap_err();
        assert!(errors[0].contains("1 are given for 2"), "{errors:?}");
    }

    #[test]
    fn one_radiance_picture_needs_no_exposure() {
        let exposures = of_bracket(&[photo(None, "ball.EXR").encoded()], &[], true, "k").unwrap();
        assert_eq!(exposures.values, [1.0]);
        assert!(of_bracket(&[photo(None, "ball.jpg").encoded()], &[], true, "k").is_err());
        assert!(of_bracket(&[photo(None, "ball.jpg").encoded()], &[], false, "k").is_ok());
    }
}
