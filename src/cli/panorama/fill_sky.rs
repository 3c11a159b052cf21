//! `panorama --fill-sky`: what a probe did not see of a clear sky.

use serde::Serialize;

use crate::cli::CliError;
use crate::light::sky::DEFAULT_GROUND;
use crate::light::sky_fit::{self, LARGEST_RESIDUAL, SkyFit};
use crate::light::sun_position::SunPosition;
use crate::probe::Panorama;

/// The sky that was fitted and filled in.
#[derive(Serialize)]
pub(super) struct SkySummary {
    pub(super) turbidity: f64,
    /// Relative standard deviation of what was seen of the sky from the model.
    pub(super) residual: f64,
    /// Shares of the upper half sphere that the fit saw, and that are the model's now.
    pub(super) seen: f64,
    pub(super) filled: f64,
}

/// Fits the sky round the sun that `option` names, and fills with it.
pub(super) fn fill_sky(
    panorama: &mut Panorama,
    option: &str,
    warnings: &mut Vec<String>,
) -> Result<SkySummary, CliError> {
    let wrong = |cause: String| CliError::wrong(format!("--fill-sky: {cause}"));
    let sun = if option == "found" {
        sky_fit::find_sun(panorama).ok_or_else(|| {
            wrong(
                "nothing above the horizon is small and bright as the sun; give its azimuth (clockwise from \
                 -Z) and elevation, 215,40"
                    .into(),
            )
        })?
    } else {
        sun(option)
            .ok_or_else(|| {
                wrong(format!(
                    "\"{option}\" is no sun; write found, or azimuth (clockwise from -Z) and elevation in \
                     degrees, 215,40"
                ))
            })?
            .direction(0.0)
    };
    let fit = sky_fit::fit(panorama, sun, DEFAULT_GROUND);
    let SkyFit { sky, residual, seen } = fit.map_err(|error| wrong(error.to_string()))?;
    let filled = sky_fit::fill(panorama, &sky);
    if residual > LARGEST_RESIDUAL {
        warnings.push(format!(
            "--fill-sky: what was seen of the sky is {:.0} % off the clear sky that fits it best (a clear day's \
             is below {:.0} %): there are clouds or houses in it, or the sun is elsewhere; what is filled in \
             is as wrong",
            100.0 * residual,
            100.0 * LARGEST_RESIDUAL
        ));
    }
    Ok(SkySummary { turbidity: sky.turbidity(), residual, seen, filled })
}

/// `215,40`
fn sun(text: &str) -> Option<SunPosition> {
    let (azimuth, elevation) = text.split_once(',')?;
    let azimuth_deg: f64 = azimuth.trim().parse().ok()?;
    let elevation_deg: f64 = elevation.trim().parse().ok()?;
    let possible = azimuth_deg.is_finite() && elevation_deg.abs() <= 90.0;
    possible.then_some(SunPosition { azimuth_deg, elevation_deg })
}
