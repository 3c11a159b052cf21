//! Rotation from what two panoramas show, without clicks.
//!
//! Log luminance of both, blurred to 5°, is compared in all rotations ([`turns`](super::turns)); the twelve
//! likeliest are refined by Gauss–Newton on ever finer pictures, and the likeliest of those wins if it
//! wins clearly. That needs no lamps and no corners: an overcast garden has a horizon and a house. A shift
//! of the place is fitted along, as if all stood at one distance, and counts where it explains much. Where both see compact lights, these are
//! brought together in the end: two suns side by side would throw two shadows. The error is taken from the
//! scatter over patches of the sphere, which holds what parallax does too.

use std::f64::consts::PI;

use glam::{DMat3, DQuat, DVec3};
use rayon::prelude::*;

use super::matches::outer;
use super::pyramid::{ANY_SHIFT, Aligned, Level, NO_SHIFT, Placed, align};
use super::turns::{LEAST_OVERLAP_SR, search};
use super::{RegisterError, Registration};
use crate::bracket::Validity;
use crate::photo::Image;
use crate::probe::compact_lights::{CompactLight, compact_lights};
use crate::probe::view::View;

/// Blur of the coarse search.
const BLUR_RAD: f64 = 5.0 * PI / 180.0;
/// Widths of the pyramid; those beyond the panoramas' are left out.
const WIDTHS: [usize; 4] = [64, 128, 256, 512];
/// Rotations of the coarse search that are refined.
const CANDIDATES: usize = 12;
/// Those of them that are refined further.
const FINALISTS: usize = 5;
/// Evidence (log likelihood over 14° patches) by which the best must beat all others.
const LEAST_LEAD: f64 = 8.0;
/// Correlation of log luminance below which two pictures are not of one place.
const LEAST_CORRELATION: f64 = 0.5;
/// Rotations nearer than this are the same answer.
const SAME_RAD: f64 = 8.0 * PI / 180.0;
/// Error that finer pictures do not remove, texels of the finest level.
const FLOOR_TEXELS: f64 = 0.05;
/// The shift of the place counts where it leaves less than this share of what is unexplained without it. In a
/// room, 0.3 m apart, it leaves 0.3 (and the rotation is 0.8° off instead of 3.2°); in a yard with a sky, where
/// the ball's own radius is the shift, 0.93 (and 0.55° instead of 0.14°).
const SHIFT_EXPLAINS: f64 = 0.6;
/// Error of the rotation over the angle between those with and without a shift, in these two places.
const MODEL_ERROR: f64 = 0.25;
/// Photographers are not part of the place.
const PHOTOGRAPHER_RAD: f64 = 15.0 * PI / 180.0;

/// The rotation that content gave, and how sure it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Content {
    /// Takes the second view's world axes to the first's.
    pub registration: Registration,
    /// Correlation of log luminance where both see, −1…1.
    pub correlation: f64,
    /// Seen by both, sr.
    pub overlap_sr: f64,
    /// Log likelihood by which it beats every other rotation.
    pub lead: f64,
    /// How far things are typically seen aside because the probes stood apart, radians: the distance between them
    /// over that of what they see. Beyond a degree the merged light belongs to neither place (F32).
    pub parallax_rad: f64,
    /// Compact lights seen by both, which hold the rotation.
    pub lights: usize,
}

/// The rotation that takes `second`'s axes to `first`'s, from what they show.
///
/// Any rotation is found. Both should stand at about one place: from another place near things are seen in
/// other directions, which widens the error that is told.
///
/// # Errors
/// Too little in common, no likeness, two rotations about equally likely, or a mirrored panorama.
pub fn by_content(first: &View, second: &View) -> Result<Content, RegisterError> {
    let (a, b) = (Pyramid::new(first)?, Pyramid::new(second)?);
    let mut found = a.candidates(&b);
    let Some(&(mut best)) = found.first() else {
        return Err(RegisterError::Overlap {
            share_deg2: 0.0,
            needed_deg2: LEAST_OVERLAP_SR * (180.0 / PI).powi(2),
        });
    };
    let evidence = |candidate: &Aligned| candidate.agreement.evidence();
    let mirrored = a.candidates(&b.mirrored());
    if mirrored.first().is_some_and(|m| evidence(m) > evidence(&best) + LEAST_LEAD) {
        return Err(RegisterError::Mirrored);
    }
    found.retain(|other| other.placed.rotation.angle_between(best.placed.rotation) > SAME_RAD);
    let rival = found.iter().map(evidence).fold(0.0, f64::max);
    let lead = evidence(&best) - rival;
    let undecided = |reason: String| Err(RegisterError::Undecided { reason });
    let correlation = best.agreement.correlation;
    if correlation < LEAST_CORRELATION {
        return undecided(format!(
            "their light correlates to {correlation:.2} at best, {LEAST_CORRELATION} is needed"
        ));
    }
    if lead < LEAST_LEAD {
        return undecided(format!(
            "another rotation fits about as well: log likelihood {lead:.1} apart, {LEAST_LEAD} is needed"
        ));
    }
    let (shifted, texel) = a.refined(&b, best, ANY_SHIFT);
    best.placed.shift = DVec3::ZERO;
    let (unshifted, _) = a.refined(&b, best, NO_SHIFT);
    // Sky and sun do not move with the place: a shift that explains little is the worse model.
    let explains = SHIFT_EXPLAINS * unshifted.agreement.unexplained();
    let shift_holds = shifted.agreement.unexplained() < explains;
    let fine = if shift_holds { shifted } else { unshifted };
    let apart = shifted.placed.rotation.angle_between(unshifted.placed.rotation);
    let further = (FLOOR_TEXELS * texel).powi(2) + (MODEL_ERROR * apart).powi(2) / 3.0;
    let covariance = fine.covariance + DMat3::IDENTITY * further;
    let in_world =
        in_world(Registration { rotation: fine.placed.rotation, covariance }, first, second);
    let parallax_rad = shifted.placed.shift.length();
    let (lights_a, lights_b) = (compact_lights(&first.panorama), compact_lights(&second.panorama));
    let (registration, lights) = hold_lights(in_world, parallax_rad, &lights_a, &lights_b);
    let agreement = fine.agreement;
    Ok(Content {
        registration,
        correlation: agreement.correlation,
        overlap_sr: agreement.overlap_sr,
        lead,
        parallax_rad,
        lights,
    })
}

/// A rotation between pictures as one between the worlds in which they are turned.
fn in_world(found: Registration, first: &View, second: &View) -> Registration {
    let (a, b) = (first.panorama.world_from_panorama, second.panorama.world_from_panorama);
    let turn = DMat3::from_quat(a);
    Registration {
        rotation: (a * found.rotation * b.conjugate()).normalize(),
        covariance: turn * found.covariance * turn.transpose(),
    }
}

fn likeliest_first(found: &mut [Aligned]) {
    found.sort_by(|a, b| b.agreement.evidence().total_cmp(&a.agreement.evidence()));
}

/// One view's log luminance at all sizes.
struct Pyramid {
    blurred: Level,
    levels: Vec<Level>,
}

impl Pyramid {
    fn new(view: &View) -> Result<Self, RegisterError> {
        let panorama = &view.panorama;
        let (seen, width) = (view.seen(), panorama.width());
        let camera = view.seeing.toward_camera();
        let usable = Image::from_fn(width, panorama.height(), |x, y| {
            let class = panorama.validity[(x, y)];
            let of_the_place = !matches!(class, Validity::Analytic | Validity::Moved);
            let person = camera.is_some_and(|camera| {
                panorama.direction(x, y).angle_between(camera) < PHOTOGRAPHER_RAD
            });
            seen[(x, y)] && of_the_place && !person
        });
        let levels: Vec<Level> = WIDTHS
            .into_iter()
            .filter(|w| *w <= width)
            .map(|w| Level::new(view, &usable, w))
            .collect();
        let Some(coarse) = levels.first() else {
            let reason = format!("{width} texels across are too few, {} are needed", WIDTHS[0]);
            return Err(RegisterError::Undecided { reason });
        };
        Ok(Self { blurred: coarse.blurred(BLUR_RAD), levels })
    }

    fn mirrored(&self) -> Self {
        Self {
            blurred: self.blurred.mirrored(),
            levels: self.levels.iter().take(2).map(Level::mirrored).collect(),
        }
    }

    /// Candidates of the coarse search: all refined blurred, the likelier ones on the two coarsest levels too,
    /// the likeliest first.
    fn candidates(&self, other: &Self) -> Vec<Aligned> {
        let mut begun: Vec<Aligned> = search(&self.blurred, &other.blurred, CANDIDATES)
            .par_iter()
            .filter_map(|(start, _)| {
                let start = Placed { rotation: *start, shift: DVec3::ZERO };
                align(&self.blurred, &other.blurred, start, ANY_SHIFT)
            })
            .collect();
        likeliest_first(&mut begun);
        begun.truncate(FINALISTS);
        let mut found: Vec<Aligned> = begun
            .par_iter()
            .filter_map(|candidate| {
                let mut levels = self.levels.iter().zip(&other.levels).take(2);
                levels.try_fold(*candidate, |at, (a, b)| align(a, b, at.placed, ANY_SHIFT))
            })
            .filter(|candidate| candidate.agreement.overlap_sr >= LEAST_OVERLAP_SR)
            .collect();
        likeliest_first(&mut found);
        found
    }

    /// The rotation on the finest level both have, and that level's texel in radians.
    fn refined(&self, other: &Self, start: Aligned, shift_sigma: f64) -> (Aligned, f64) {
        let mut at = start;
        let mut texel = 2.0 * PI / WIDTHS[0] as f64;
        for (a, b) in self.levels.iter().zip(&other.levels) {
            if let Some(finer) = align(a, b, at.placed, shift_sigma) {
                at = finer;
                texel = 2.0 * PI / a.width as f64;
            }
        }
        (at, texel)
    }
}

/// Lights whose directions differ by more than this many standard errors are two.
const LIGHT_SIGMAS: f64 = 4.0;
/// And those whose light differs by more than this factor.
const LIGHT_FLUX_RATIO: f64 = 4.0;

/// Brings the lights that both show together, as far as content leaves room; how many there are.
///
/// Lights in a room stand aside by parallax as all else does, nobody knows how far.
fn hold_lights(
    content: Registration,
    parallax_rad: f64,
    first: &[CompactLight],
    second: &[CompactLight],
) -> (Registration, usize) {
    let mut information = content.covariance.inverse();
    let mut pull = DVec3::ZERO;
    let mut held = 0;
    for b in second {
        let seen = content.rotation * b.direction;
        let nearest = first.iter().filter(|a| alike(a, b)).min_by(|p, q| {
            p.direction.angle_between(seen).total_cmp(&q.direction.angle_between(seen))
        });
        let Some(a) = nearest else { continue };
        let variance = a.sigma_rad.powi(2) + b.sigma_rad.powi(2) + parallax_rad.powi(2);
        let reach = LIGHT_SIGMAS * (variance + content.sigma_rad().powi(2)).sqrt();
        if a.direction.angle_between(seen) > reach {
            continue;
        }
        // The small turn that takes the one to the other, square to both.
        pull += seen.cross(a.direction) / variance;
        information += (DMat3::IDENTITY - outer(seen, seen)) * (1.0 / variance);
        held += 1;
    }
    let covariance = information.inverse();
    let rotation = (DQuat::from_scaled_axis(covariance * pull) * content.rotation).normalize();
    (Registration { rotation, covariance }, held)
}

/// Whether two lights may be one: a clipped one may be any times as bright.
fn alike(a: &CompactLight, b: &CompactLight) -> bool {
    let ratio = a.flux / b.flux;
    let most = LIGHT_FLUX_RATIO;
    (ratio < most || b.clipped) && (ratio > 1.0 / most || a.clipped)
}

#[cfg(test)]
#[path = "content_tests.rs"]
mod tests;
