//! Intrinsics from views of a flat board, with the error of every number.
//!
//! corners of many views → [`Calibration`]: the lens, its covariance, the residuals of each view, what
//! was rejected and why, and the projection uncertainty over the frame, which alone decides whether a
//! calibration is good: the residual is the same for a useless set of frontal views (measured).

use nalgebra::Vector3;

pub use crate::bundle::View;
use crate::choice::{self, Choice, Rung};
use crate::lens::Lens;
pub use crate::projection::{GRID, ProjectionSigma};
use crate::{OpenCvError, mat};

/// Mean projection uncertainty above which a lens is refused, px.
pub const MOST_SIGMA_PX: f64 = 2.0;
/// Mean projection uncertainty above which a lens draws a warning, px.
pub const WEAK_SIGMA_PX: f64 = 0.5;

/// A calibrated lens and how well it is known.
#[derive(Clone, Debug)]
pub struct Calibration {
    pub lens: Lens,
    /// Covariance of the model's parameters, row-major.
    pub covariance: Vec<f64>,
    /// The chosen rung in words, e.g. `f c k1 k2 p1 p2, aspect`.
    pub rung: String,
    /// All rungs that could be fitted, for the report.
    pub rungs: Vec<RungReport>,
    /// Standard deviation of a corner coordinate, from the residuals, px.
    pub sigma_px: f64,
    /// Root mean square residual over both coordinates of a corner, px.
    pub rms_px: f64,
    /// One entry for each view given, in order.
    pub views: Vec<ViewReport>,
    pub projection: ProjectionSigma,
    /// Rise of the board's middle along x and y with its σ, m, where the bow was needed.
    pub bow_m: Option<[(f64, f64); 2]>,
    pub warnings: Vec<Warning>,
}

/// One rung of the ladder.
#[derive(Clone, Debug, PartialEq)]
pub struct RungReport {
    pub name: String,
    pub n_free: usize,
    pub rms_px: f64,
    pub bic: f64,
    /// Root of the mean squared held-out residual, px.
    pub held_out_rms_px: Option<f64>,
    pub sigma_projection_px: f64,
}

/// What became of a view.
#[derive(Clone, Debug, PartialEq)]
pub struct ViewReport {
    pub rms_px: f64,
    /// Why the view was left out, if it was.
    pub rejected: Option<String>,
    /// Board to camera (OpenCV's axes): rows of R, and t in metres; `None` if rejected.
    pub pose: Option<([[f64; 3]; 3], [f64; 3])>,
    /// Angle between the board's normal and the line of sight, degrees.
    pub tilt_deg: Option<f64>,
}

/// Something a person should know about a calibration that still stands.
#[derive(Clone, Debug, PartialEq)]
pub enum Warning {
    /// Mean projection uncertainty between half a pixel and two.
    Weak { mean_px: f64 },
    /// This share of the frame lies outside all corners.
    Extrapolated { share: f64, max_px: f64 },
    /// BIC and cross-validation name lenses that differ by this much.
    RungsDisagree { taken: String, other: String, apart_px: f64 },
    /// Richer rungs fit better but are not determined by these views.
    RungsDropped { taken: String, better: String },
    /// The principal point was not fitted.
    CentreAssumed,
    /// The board is not flat.
    Bowed { rise_mm: f64 },
    /// Focal lengths differ by this ratio: rarely the lens, usually the print.
    Aspect { ratio: f64 },
    /// Residuals are larger than corner noise.
    Noisy { sigma_px: f64 },
    /// The lens model does not reach the corners of the picture.
    Folds,
    /// Fewer views than a good calibration has.
    FewViews { used: usize },
}

impl std::fmt::Display for Warning {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        match self {
            Self::Weak { mean_px } => write!(
                f,
                "the lens is known to {mean_px:.2} px over the frame (0.5 is good): add tilted views and fill the corners"
            ),
            Self::Extrapolated { share, max_px } => write!(
                f,
                "{:.0} % of the frame lies outside every board corner; σ reaches {max_px:.2} px there",
                100.0 * share
            ),
            Self::RungsDisagree { taken, other, apart_px } => write!(
                f,
                "the two model criteria disagree by {apart_px:.2} px over the frame ('{taken}' taken, '{other}' set aside): more views would settle it"
            ),
            Self::RungsDropped { taken, better } => write!(
                f,
                "'{better}' fits better but these views do not determine it; '{taken}' was taken: tilt the board more and fill the corners"
            ),
            Self::CentreAssumed => {
                write!(
                    f,
                    "the principal point was not fitted and is assumed at the picture's centre"
                )
            }
            Self::Bowed { rise_mm } => {
                write!(
                    f,
                    "the board is bent by {rise_mm:.2} mm; the bow was fitted, a flat board is better"
                )
            }
            Self::Aspect { ratio } => write!(
                f,
                "fy/fx is {ratio:.3}: pixels are nearly always square, so the print is probably stretched; measure it both ways"
            ),
            Self::Noisy { sigma_px } => write!(
                f,
                "residuals of {sigma_px:.2} px are more than corner noise: the board moved, is blurred or is not flat"
            ),
            Self::Folds => write!(
                f,
                "the lens model does not reach the corners of the picture; nothing is rendered there"
            ),
            Self::FewViews { used } => {
                write!(f, "only {used} views: 10 to 15 at different tilts are good")
            }
        }
    }
}

/// Why there is no calibration.
#[derive(Debug, thiserror::Error)]
pub enum CalibrateError {
    #[error("no view shows the board whole")]
    NoViews,
    #[error("view {index} has {n} corners (at least 9 are needed) or values that are not finite")]
    BadView { index: usize, n: usize },
    #[error(
        "these {n_views} views leave the lens unknown by {sigma_px:.1} px over the frame (limit {MOST_SIGMA_PX}): {advice}"
    )]
    TooUncertain { n_views: usize, sigma_px: f64, advice: String },
    #[error("these {n_views} views determine no lens: {advice}")]
    NoModel { n_views: usize, advice: String },
    #[error(transparent)]
    OpenCv(#[from] OpenCvError),
}

/// Calibrates a lens from views taken at one size, focal length and focus.
pub fn calibrate(
    width: usize,
    height: usize,
    views: &[View],
) -> Result<Calibration, CalibrateError> {
    if views.is_empty() || width == 0 || height == 0 {
        return Err(CalibrateError::NoViews);
    }
    for (index, view) in views.iter().enumerate() {
        let n = view.pixels.len();
        let finite = view.pixels.iter().chain(&view.board).flatten().all(|v| v.is_finite());
        if n < 9 || view.board.len() != n || !finite {
            return Err(CalibrateError::BadView { index, n });
        }
    }
    mat::prepare();

    // Fit; leave out views that spoil it; fit again.
    let mut used: Vec<usize> = (0..views.len()).collect();
    let mut reports: Vec<Option<ViewReport>> = vec![None; views.len()];
    let (kept, rungs) = loop {
        let kept: Vec<View> = used.iter().map(|&v| views[v].clone()).collect();
        let rungs = choice::fit_all(width, height, &kept)?;
        let Some(best) = rungs.iter().min_by(|a, b| a.bic.total_cmp(&b.bic)) else {
            return Err(CalibrateError::NoModel {
                n_views: used.len(),
                advice: advice(None, &kept, width, height),
            });
        };
        let bad = spoilers(best, &kept);
        if bad.is_empty() || used.len() - bad.len() < 3 {
            break (kept, rungs);
        }
        for &(at, rms_px, median_px) in bad.iter().rev() {
            let view = used.remove(at);
            let reason = format!(
                "its corners miss the common lens by {rms_px:.2} px where the others miss by {median_px:.2} px"
            );
            reports[view] =
                Some(ViewReport { rms_px, rejected: Some(reason), pose: None, tilt_deg: None });
        }
    };

    let mut rungs = rungs;
    choice::cross_validate(&mut rungs, &kept);
    let Some(decision) = choice::choose(&rungs, width, height, MOST_SIGMA_PX) else {
        let least = rungs.iter().map(|r| r.projection.mean_px).fold(f64::INFINITY, f64::min);
        let advice = advice(rungs.first(), &kept, width, height);
        return Err(CalibrateError::TooUncertain { n_views: used.len(), sigma_px: least, advice });
    };
    let taken = &rungs[decision.index];
    for (slot, &view) in used.iter().enumerate() {
        reports[view] = Some(view_report(taken, slot, &kept[slot]));
    }
    Ok(Calibration {
        lens: taken.fit.state.lens,
        covariance: taken.covariance.transpose().as_slice().to_vec(),
        rung: taken.name.clone(),
        rungs: rungs.iter().map(|r| rung_report(r, &kept)).collect(),
        sigma_px: taken.sigma_px,
        rms_px: rms(taken, &kept),
        views: reports.into_iter().flatten().collect(),
        projection: taken.projection.clone(),
        bow_m: taken.bow_sigma_m.map(|sigma| [0, 1].map(|k| (taken.fit.state.bow[k], sigma[k]))),
        warnings: warnings(&rungs, &decision, used.len()),
    })
}

fn n_corners(views: &[View]) -> f64 {
    views.iter().map(|v| v.pixels.len()).sum::<usize>() as f64
}

fn rms(rung: &Rung, views: &[View]) -> f64 {
    (rung.fit.sum_squares() / n_corners(views)).sqrt()
}

fn view_rms(rung: &Rung, slot: usize, view: &View) -> f64 {
    (rung.fit.view_squares[slot] / view.pixels.len() as f64).sqrt()
}

/// Views whose residual stands far out: (index, its rms, median rms), px.
fn spoilers(rung: &Rung, views: &[View]) -> Vec<(usize, f64, f64)> {
    const FAR: f64 = 3.0;
    const HARMLESS_PX: f64 = 0.3;
    let each: Vec<f64> = views.iter().enumerate().map(|(i, v)| view_rms(rung, i, v)).collect();
    let mut sorted = each.clone();
    sorted.sort_by(f64::total_cmp);
    let median = sorted[sorted.len() / 2];
    each.iter()
        .enumerate()
        .filter(|(_, rms)| **rms > FAR * median && **rms > HARMLESS_PX)
        .map(|(i, &rms)| (i, rms, median))
        .collect()
}

fn view_report(rung: &Rung, slot: usize, view: &View) -> ViewReport {
    let pose = &rung.fit.state.poses[slot];
    let r = pose.rotation.matrix();
    let rows = std::array::from_fn(|i| std::array::from_fn(|j| r[(i, j)]));
    ViewReport {
        rms_px: view_rms(rung, slot, view),
        rejected: None,
        pose: Some((rows, pose.translation.into())),
        tilt_deg: Some(tilt_deg(rung, slot, view)),
    }
}

fn tilt_deg(rung: &Rung, slot: usize, view: &View) -> f64 {
    let pose = &rung.fit.state.poses[slot];
    let n = view.board.len() as f64;
    let middle = view.board.iter().fold([0.0; 2], |a, p| [a[0] + p[0] / n, a[1] + p[1] / n]);
    let at = pose.rotation * Vector3::new(middle[0], middle[1], 0.0) + pose.translation;
    let normal = pose.rotation * Vector3::z();
    (normal.dot(&at.normalize())).abs().min(1.0).acos().to_degrees()
}

fn rung_report(rung: &Rung, views: &[View]) -> RungReport {
    let held_out = rung.held_out.as_ref().map(|e| (e.iter().sum::<f64>() / e.len() as f64).sqrt());
    RungReport {
        name: rung.name.clone(),
        n_free: rung.shape.n_free(),
        rms_px: rms(rung, views),
        bic: rung.bic,
        held_out_rms_px: held_out,
        sigma_projection_px: rung.projection.mean_px,
    }
}

fn warnings(rungs: &[Rung], decision: &Choice, n_views: usize) -> Vec<Warning> {
    const FEW: usize = 6;
    const NOISY_PX: f64 = 0.35;
    const ASPECT: f64 = 0.01;
    const UNCOVERED: f64 = 0.35;
    let taken = &rungs[decision.index];
    let mut all = vec![];
    if taken.projection.mean_px > WEAK_SIGMA_PX {
        all.push(Warning::Weak { mean_px: taken.projection.mean_px });
    }
    if taken.projection.extrapolated > UNCOVERED {
        let share = taken.projection.extrapolated;
        all.push(Warning::Extrapolated { share, max_px: taken.projection.max_px });
    }
    if let Some((other, apart_px)) = decision.disagrees {
        let other = rungs[other].name.clone();
        all.push(Warning::RungsDisagree { taken: taken.name.clone(), other, apart_px });
    }
    if decision.dropped
        && let Some(better) = rungs.iter().min_by(|a, b| a.bic.total_cmp(&b.bic))
    {
        let (taken, better) = (taken.name.clone(), better.name.clone());
        all.push(Warning::RungsDropped { taken, better });
    }
    if !taken.shape.moves.iter().any(|m| m.contains(&2)) {
        all.push(Warning::CentreAssumed);
    }
    if taken.shape.bow {
        let bow = taken.fit.state.bow;
        all.push(Warning::Bowed { rise_mm: 1e3 * bow[0].abs().max(bow[1].abs()) });
    }
    let ratio = taken.fit.state.lens.parameters[1] / taken.fit.state.lens.parameters[0];
    if (ratio - 1.0).abs() > ASPECT {
        all.push(Warning::Aspect { ratio });
    }
    if taken.sigma_px > NOISY_PX {
        all.push(Warning::Noisy { sigma_px: taken.sigma_px });
    }
    if !taken.covers {
        all.push(Warning::Folds);
    }
    if n_views < FEW {
        all.push(Warning::FewViews { used: n_views });
    }
    all
}

/// What to photograph next, from what these views lack.
fn advice(rung: Option<&Rung>, views: &[View], width: usize, height: usize) -> String {
    const ENOUGH_VIEWS: usize = 6;
    const ENOUGH_SPREAD_DEG: f64 = 20.0;
    const ENOUGH_FRAME: f64 = 0.4;
    let mut all = vec![];
    if let Some(rung) = rung {
        let normals: Vec<_> =
            rung.fit.state.poses.iter().map(|p| p.rotation * Vector3::z()).collect();
        let spread = normals
            .iter()
            .flat_map(|a| {
                normals.iter().map(move |b| a.dot(b).clamp(-1.0, 1.0).acos().to_degrees())
            })
            .fold(0.0, f64::max);
        if spread < ENOUGH_SPREAD_DEG {
            all.push(format!(
                "tilt the board more, by 20 to 45° in different directions (the views differ by {spread:.0}° at most)"
            ));
        }
    }
    if rung.is_none() {
        all.push("tilt the board more, by 20 to 45° in different directions".to_string());
    }
    let hull =
        crate::projection::convex_hull(views.iter().flat_map(|v| v.pixels.clone()).collect());
    let area: f64 = (0..hull.len())
        .map(|i| {
            let (a, b) = (hull[i], hull[(i + 1) % hull.len()]);
            0.5 * (a[0] * b[1] - a[1] * b[0])
        })
        .sum();
    if area < ENOUGH_FRAME * (width * height) as f64 {
        all.push("move the board into the corners of the frame".to_string());
    }
    if views.len() < ENOUGH_VIEWS {
        all.push("take 10 to 15 views".to_string());
    }
    if all.is_empty() {
        all.push("check the corner counts, and that focus and zoom stayed fixed".to_string());
    }
    all.join("; ")
}
