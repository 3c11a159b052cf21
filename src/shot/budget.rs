//! The error budget: how wrong the picture may be, cause by cause, as far as it is known.

use super::prepare::Prepared;
use crate::report::{Budget, ClippedReport, RenderReport, Term, Treatment};

/// A mirror ball's reflectance, photographed against a grey card, is good to about 3 %
/// (methods-capture C4); nobody measured this one.
const ASSUMED_SIGMA_REFLECTANCE: f64 = 0.03;
/// A slip of more than half a pixel is seen at a contact edge.
const VISIBLE_SLIP_PX: f64 = 0.5;

/// All causes that the stages know of.
pub fn budget(prepared: &Prepared, render: &RenderReport) -> Budget {
    let mut terms = vec![slip(prepared), directions(prepared)];
    terms.push(Term {
        cause: "noise of the merged bracket".to_owned(),
        sigma: prepared.light.sigma_irradiance.map(|s| 100.0 * s),
        unit: "% of the irradiance",
        brightness: prepared.light.sigma_irradiance,
        note: "measured: variance of the panorama, summed over the upper hemisphere".to_owned(),
    });
    if prepared.light.has_reflectance {
        terms.push(Term {
            cause: "the ball's reflectance".to_owned(),
            sigma: Some(100.0 * ASSUMED_SIGMA_REFLECTANCE),
            unit: "%",
            brightness: Some(ASSUMED_SIGMA_REFLECTANCE),
            note: "assumed; photograph a grey card directly and in the ball".to_owned(),
        });
    }
    if let Some(sigma) = prepared.light.sigma_sun {
        terms.push(Term {
            cause: "strength of the recovered sun".to_owned(),
            sigma: Some(100.0 * sigma),
            unit: "%",
            brightness: Some(sigma),
            note: "from the scatter of the evidence in the plate".to_owned(),
        });
    }
    if let Some(sigma) = prepared.light.sigma_lamps {
        terms.push(Term {
            cause: "strength of the clipped lamps".to_owned(),
            sigma: Some(100.0 * sigma),
            unit: "% of the irradiance toward them",
            brightness: Some(sigma),
            note: "from parts of the plate left out in turns".to_owned(),
        });
    }
    if let Some(sigma) = prepared.light.sigma_sky {
        terms.push(Term {
            cause: "the calculated sun against its sky".to_owned(),
            sigma: Some(100.0 * sigma),
            unit: "%",
            brightness: Some(sigma),
            note: "assumed for a clear day; photograph the light, or give sun_irradiance"
                .to_owned(),
        });
    }
    if let Some(term) = accepted_clipping(&prepared.probe_report.clipped) {
        terms.push(term);
    }
    terms.extend(near_light(prepared));
    terms.push(Term {
        cause: "Monte-Carlo noise".to_owned(),
        sigma: Some(100.0 * render.error),
        unit: "% of the plate",
        brightness: Some(render.error),
        note: "measured over the influence region; lower render.error".to_owned(),
    });
    Budget::new(terms)
}

fn near_light(prepared: &Prepared) -> Vec<Term> {
    let distant = prepared.light.distant_error.map(|error| Term {
        cause: "near light treated as distant".to_owned(),
        sigma: Some(100.0 * error),
        unit: "% of the irradiance",
        brightness: Some(error),
        note: "bound from the distances in [surroundings] and [[lamp]]".to_owned(),
    });
    let walls = prepared.light.lights.proxy().map(|_| Term {
        cause: "things that stand before the walls".to_owned(),
        sigma: None,
        unit: "%",
        brightness: None,
        note: "light of things that are not modelled is put on the wall behind them".to_owned(),
    });
    distant.into_iter().chain(walls).collect()
}

fn slip(prepared: &Prepared) -> Term {
    let sigma = prepared.pose_report.slip_px;
    let note = match sigma {
        Some(s) if s > VISIBLE_SLIP_PX => {
            "objects may stand visibly beside their place; use a larger or nearer tag or board"
        }
        Some(_) => {
            "measured: pose and lens; assumed: a target's size to 0.25 %; below half a pixel it is not seen"
        }
        None => "the pose came without a covariance",
    };
    Term {
        cause: "place in the picture (lens and pose)".to_owned(),
        sigma,
        unit: "px",
        brightness: None,
        note: note.to_owned(),
    }
}

fn directions(prepared: &Prepared) -> Term {
    let by_sun = prepared.probe_report.clipped.iter().find_map(|light| match light.treatment {
        Treatment::Recovered { sigma_direction_deg, .. } => Some(sigma_direction_deg),
        Treatment::Accepted | Treatment::Lamp { .. } => None,
    });
    let (sigma, from) = match by_sun {
        Some(sigma) => (Some(sigma), "of the recovered sun"),
        None => (prepared.probe_report.sigma_direction_deg, "from how the probe's axes are known"),
    };
    Term {
        cause: "directions of the light".to_owned(),
        sigma,
        unit: "°",
        // A plane turned by δ under light from 45° changes by δ: first order.
        brightness: sigma.map(f64::to_radians),
        note: format!("{from}; shadows turn by this much"),
    }
}

fn accepted_clipping(clipped: &[ClippedReport]) -> Option<Term> {
    let accepted: Vec<_> = clipped.iter().filter(|c| c.treatment == Treatment::Accepted).collect();
    (!accepted.is_empty()).then(|| Term {
        cause: "clipped lights taken as they are".to_owned(),
        sigma: None,
        unit: "%",
        brightness: None,
        note: format!(
            "{} lights are brighter than any exposure shows; add a shorter exposure or recover them",
            accepted.len()
        ),
    })
}
