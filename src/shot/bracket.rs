//! The probe's photographs → one picture of radiance, plate and probe read through one tone curve.

use super::file::PlateColour;
use super::plan::Plan;
use super::probe_keys::ProbeSource;
use crate::bracket::{self, Radiance, ResponseSource};
use crate::photo::{Photo, Transfer};
use crate::report::Warning;

/// Merges the photographs of a ball or fisheye; `None` for a panorama or a sky.
///
/// With `plate.colour = "bracket"` the plate is read again through the curve that the bracket shows:
/// a curve for one of them alone would change the scale between them by more than it mends.
///
/// # Errors
/// A sentence with file, cause and remedy.
pub fn merge(plan: &mut Plan) -> Result<Option<(Radiance, Vec<Warning>)>, String> {
    let key = match &plan.shot.probe.source {
        ProbeSource::Fisheye(_) => "probe.fisheye",
        ProbeSource::Ball(_) | ProbeSource::Panorama(_) | ProbeSource::Sky(_) => "probe.ball",
    };
    match plan.probe_photos.as_slice() {
        [] => return Ok(None),
        [photo] if plan.exposures.values == [1.0] => {
            let radiance = bracket::file::from_picture(&Photo::from(photo.clone()))
                .map_err(|error| format!("{}: {key}: {error}", plan.shot.path.display()))?;
            return Ok(Some((radiance, Vec::new())));
        }
        _ => {}
    }
    let frames: Vec<bracket::Frame> = plan
        .probe_photos
        .iter()
        .zip(&plan.exposures.values)
        .map(|(photo, &exposure)| bracket::Frame { photo, exposure })
        .collect();
    let response = match plan.shot.plate.colour {
        PlateColour::Bracket => ResponseSource::Bracket,
        PlateColour::Auto | PlateColour::Named(_) => ResponseSource::Stated,
    };
    let recovering = response == ResponseSource::Bracket;
    let options = bracket::MergeOptions { response, ..Default::default() };
    let merged = bracket::merge(&frames, &options)
        .map_err(|error| format!("{}: {key}: {error}", plan.shot.path.display()))?;

    let mut warnings = Vec::new();
    let mut bent = false;
    for warning in &merged.warnings {
        match warning {
            bracket::Warning::ResponseRecovered { .. } => continue,
            bracket::Warning::ToneCurve { .. } if merged.response.is_some() => continue,
            bracket::Warning::ToneCurve { .. } => bent = true,
            _ => {}
        }
        let said = Warning::new("probe bracket", warning.to_string(), "");
        warnings.push(Warning { asks: warning.asks(), ..said });
    }
    if recovering && merged.response.is_none() {
        return Err(format!(
            "{}: plate.colour: the bracket shows too little to recover a tone curve from; name a \
             colour space or take \"auto\" instead of \"bracket\"",
            plan.shot.path.display()
        ));
    }
    if let Some(response) = merged.response {
        warnings.push(Warning::note(
            "plate.colour",
            "plate and probe are read through the camera's own tone curve, recovered from the bracket",
            format!("up to a factor {:.2} from sRGB", response.distance_from_srgb()),
        ));
        // One curve for all channels was asked for.
        let [curve, ..] = response.curves;
        plan.plate = plan.plate.redecoded(Transfer::Measured(curve));
    } else if bent {
        warnings.push(Warning::new(
            "plate.colour",
            "the camera bends its tones; if plate and probe are 8-bit files of one camera at one \
             setting, plate.colour = \"bracket\" reads both through the curve that the bracket shows",
            "objects too bright or too dark, by up to the difference of the curves",
        ));
    }
    Ok(Some((merged.radiance, warnings)))
}
