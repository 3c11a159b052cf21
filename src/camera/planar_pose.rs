//! Camera pose from points of known place on one plane: tag, board or rectangle.
//!
//! Homography → both planar solutions (Collins & Bartoli, IJCV 109(3), 2014) → Levenberg–Marquardt
//! of each on pixels through the lens → covariance → a decision. The two solutions are judged by
//! Δχ² = (Σr₂² − Σr₁²)/σ², not by the ratio of residuals: a ratio above 2 is wrong one time in ten,
//! Δχ² > 9 one time in a thousand. Works without OpenCV; never looks at a picture.

use glam::{DVec2, DVec3};
use nalgebra::{DMatrix, Matrix6, Vector6};
use thiserror::Error;

use super::planar_start::{Plane, homography, planar_starts, start};
use super::{Lens, Pose};

/// Δχ² above which the better solution is taken without a word.
pub const CLEAR_DELTA_CHI2: f64 = 13.0;
/// Δχ² below which both solutions fit equally well.
pub const AMBIGUOUS_DELTA_CHI2: f64 = 9.0;

/// A point of the world and the pixel that shows it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sighting {
    /// Where the point is, m.
    pub world: DVec3,
    /// Where it is seen, px.
    pub pixel: DVec2,
}

/// How well pixels and sizes are known before the residuals are seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    /// Standard deviation of a pixel coordinate according to the detector, px.
    pub sigma_px: f64,
    /// How many residuals that statement is worth against the ones of this fit.
    pub degrees: f64,
    /// Relative standard deviation of the target's printed size.
    pub size_sigma: f64,
}

/// Why there is no pose.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum PoseError {
    #[error("{0} points: a pose needs at least four on one plane")]
    TooFew(usize),
    #[error(
        "the points of the target are not finite or lie on one line: give four that span an area"
    )]
    Degenerate,
    #[error("the points lie {off_m:.4} m off a common plane: a planar pose needs flat targets")]
    NotPlanar { off_m: f64 },
    #[error("point {index} at pixel ({x:.1}, {y:.1}) lies outside what the lens model can see")]
    OutsideLens { index: usize, x: f64, y: f64 },
    #[error("no camera pose explains the points: check their order and the target's size")]
    NoSolution,
}

/// How sure the choice between the two planar solutions is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Δχ² > 13, or there is only one solution.
    Clear,
    /// Δχ² between 9 and 13: wrong about once in a thousand.
    Probable,
    /// Two poses fit equally, or the target is so nearly face-on that its leaning is lost.
    Ambiguous,
}

/// The planar solution that was not taken.
#[derive(Clone, Debug, PartialEq)]
pub struct Alternative {
    pub pose: Pose,
    pub rms_px: f64,
    /// (Σr² of this one − Σr² of the one taken)/σ².
    pub delta_chi2: f64,
}

/// How the pose scatters, split so that errors of the lens stay tied to it.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseScatter {
    /// Covariance from the pixels (and the target's size) alone, ordered as [`Pose::covariance`].
    pub own: [[f64; 6]; 6],
    /// What one unit of each lens parameter does to the pose.
    pub by_lens: Vec<[f64; 6]>,
}

/// A pose with everything a report says about it.
#[derive(Clone, Debug, PartialEq)]
pub struct PlanarPose {
    /// The pose taken; its covariance contains pixels, lens and size.
    pub pose: Pose,
    /// Root mean square residual, px over both coordinates of a point.
    pub rms_px: f64,
    /// Standard deviation of a pixel coordinate, from residuals and the detector's statement.
    pub sigma_px: f64,
    /// Seen − predicted, px, one a point.
    pub residuals: Vec<DVec2>,
    pub alternative: Option<Alternative>,
    pub verdict: Verdict,
    pub scatter: PoseScatter,
}

/// Pose of the camera that sees `sightings` (coplanar, at least four) through `lens`.
pub fn solve(lens: &Lens, sightings: &[Sighting], noise: &Noise) -> Result<PlanarPose, PoseError> {
    solve_joint(lens, &[sightings.to_vec()], noise)
}

/// Pose of the camera that sees several flat targets, each in its own plane, through `lens`.
///
/// Every target's two planar solutions start a fit to the points of all targets.
pub fn solve_joint(
    lens: &Lens,
    targets: &[Vec<Sighting>],
    noise: &Noise,
) -> Result<PlanarPose, PoseError> {
    let planes = targets.iter().map(|t| Plane::through(t)).collect::<Result<Vec<_>, _>>()?;
    let sightings = &targets.concat();
    let mut starts = vec![];
    for (target, plane) in targets.iter().zip(&planes) {
        let homography = homography(lens, target, plane)?;
        for rotation in planar_starts(&homography) {
            starts.extend(start(lens, target, plane, rotation));
        }
    }

    // Refine all; a start that leaves the field is no solution.
    let mut found: Vec<Fit> =
        starts.into_iter().filter_map(|pose| refine(lens, sightings, pose)).collect();
    found.sort_by(|a, b| a.sum_squares.total_cmp(&b.sum_squares));
    let best = found.first().ok_or(PoseError::NoSolution)?;

    // The detector's statement counts as `degrees` residuals of its size.
    let spare = (2 * sightings.len()) as f64 - 6.0;
    let sigma_px = ((noise.degrees * noise.sigma_px.powi(2) + best.sum_squares)
        / (noise.degrees + spare))
        .sqrt();
    let rms = |fit: &Fit| (fit.sum_squares / sightings.len() as f64).sqrt();
    let alternative = found.iter().find(|other| differs(&best.pose, &other.pose)).map(|other| {
        let delta_chi2 = (other.sum_squares - best.sum_squares) / sigma_px.powi(2);
        Alternative { pose: other.pose.clone(), rms_px: rms(other), delta_chi2 }
    });
    let centre = sightings.iter().map(|s| s.world).sum::<DVec3>() / sightings.len() as f64;
    let scatter = scatter(lens, sightings, best, sigma_px, centre, noise.size_sigma)
        .ok_or(PoseError::Degenerate)?;
    let covariance = Some(total_covariance(lens, &scatter));
    let pose = Pose { covariance, ..best.pose.clone() };
    let verdict = match &alternative {
        Some(a) if a.delta_chi2 < AMBIGUOUS_DELTA_CHI2 => Verdict::Ambiguous,
        Some(a) if a.delta_chi2 < CLEAR_DELTA_CHI2 => Verdict::Probable,
        None if planes.len() == 1 && leaning_is_lost(&pose, &planes[0]) => Verdict::Ambiguous,
        _ => Verdict::Clear,
    };
    Ok(PlanarPose {
        rms_px: rms(best),
        sigma_px,
        residuals: best.residuals.clone(),
        alternative,
        verdict,
        scatter,
        pose,
    })
}

/// A refined pose and what it leaves over.
struct Fit {
    pose: Pose,
    sum_squares: f64,
    residuals: Vec<DVec2>,
    /// JᵀJ of pixels by (ω, position).
    normal: Matrix6<f64>,
}

/// ∂(u, v)/∂(ω in camera axes, position): two rows.
///
/// The camera sees `x = Rᵀ(X − p)`; turning R by ω moves x by `x × ω`, moving p by `−Rᵀ dp`.
fn pose_rows(by_point: [DVec3; 2], seen: DVec3, pose: &Pose) -> [Vector6<f64>; 2] {
    by_point.map(|g| {
        let turn = g.cross(seen);
        let shift = -(pose.rotation() * g);
        Vector6::new(turn.x, turn.y, turn.z, shift.x, shift.y, shift.z)
    })
}

fn linearise(lens: &Lens, sightings: &[Sighting], pose: &Pose) -> Option<(Fit, Vector6<f64>)> {
    let camera_from_world = pose.inverse();
    let mut normal = Matrix6::zeros();
    let mut gradient = Vector6::zeros();
    let mut residuals = Vec::with_capacity(sightings.len());
    for s in sightings {
        let seen = camera_from_world.transform_point3(s.world);
        let projection = lens.project_with_derivatives(seen)?;
        let residual = s.pixel - projection.pixel;
        let rows = pose_rows(projection.by_point, seen, pose);
        for (row, r) in rows.iter().zip(residual.to_array()) {
            normal += row * row.transpose();
            gradient += row * r;
        }
        residuals.push(residual);
    }
    let sum_squares = residuals.iter().map(|r| r.length_squared()).sum();
    Some((Fit { pose: pose.clone(), sum_squares, residuals, normal }, gradient))
}

/// Levenberg–Marquardt on pixels.
fn refine(lens: &Lens, sightings: &[Sighting], start: Pose) -> Option<Fit> {
    let (mut fit, mut gradient) = linearise(lens, sightings, &start)?;
    let mut damping = 1e-4;
    for _ in 0..100 {
        let mut damped = fit.normal;
        for i in 0..6 {
            damped[(i, i)] *= 1.0 + damping;
        }
        let step = damped.cholesky().map(|c| c.solve(&gradient))?;
        let moved = fit
            .pose
            .nudged(DVec3::new(step[0], step[1], step[2]), DVec3::new(step[3], step[4], step[5]));
        match linearise(lens, sightings, &moved) {
            Some((next, next_gradient)) if next.sum_squares <= fit.sum_squares => {
                let gain = fit.sum_squares - next.sum_squares;
                let done = gain <= 1e-14 * fit.sum_squares || step.norm() < 1e-13;
                (fit, gradient) = (next, next_gradient);
                damping = (damping * 0.1).max(1e-12);
                if done {
                    return Some(fit);
                }
            }
            _ => {
                damping *= 10.0;
                if damping > 1e12 {
                    return Some(fit);
                }
            }
        }
    }
    Some(fit)
}

/// Whether two solutions are different minima and not one reached twice.
fn differs(a: &Pose, b: &Pose) -> bool {
    let (turn, _) = a.difference(b);
    turn.length() > 1e-5
}

/// Whether a nearly face-on target could as well lean the other way, by angles that matter.
///
/// There both minima melt into one flat minimum: no second solution is found, yet none is excluded.
fn leaning_is_lost(pose: &Pose, plane: &Plane) -> bool {
    // Near the flat minimum σ is only the curvature's: five of it.
    const MATTERS_RAD: f64 = 0.01;
    let sight = (plane.origin - pose.position()).normalize_or_zero();
    let tilt = sight.cross(plane.axes.z_axis).length().asin();
    let sigma = pose.sigmas().map_or(0.0, |(turn, _)| turn.x.max(turn.y));
    sigma > MATTERS_RAD && tilt < 5.0 * sigma
}

fn scatter(
    lens: &Lens,
    sightings: &[Sighting],
    fit: &Fit,
    sigma_px: f64,
    centre: DVec3,
    size_sigma: f64,
) -> Option<PoseScatter> {
    // Scaled to a unit diagonal first: radians and metres may differ by orders of magnitude.
    let scale = Vector6::from_fn(|i, _| fit.normal[(i, i)].sqrt().recip());
    let scaled = Matrix6::from_fn(|i, j| fit.normal[(i, j)] * scale[i] * scale[j]);
    let inverse = scaled.try_inverse()?;
    let inverse = Matrix6::from_fn(|i, j| inverse[(i, j)] * scale[i] * scale[j]);

    let n = lens.n_parameters();
    let mut cross = DMatrix::<f64>::zeros(6, n);
    let camera_from_world = fit.pose.inverse();
    for s in sightings {
        let seen = camera_from_world.transform_point3(s.world);
        let projection = lens.project_with_derivatives(seen)?;
        let rows = pose_rows(projection.by_point, seen, &fit.pose);
        for (k, by) in projection.by_parameter.iter().enumerate() {
            for i in 0..6 {
                cross[(i, k)] += rows[0][i] * by.x + rows[1][i] * by.y;
            }
        }
    }
    let by_lens = -(DMatrix::from_fn(6, 6, |i, j| inverse[(i, j)]) * cross);

    // A target printed larger puts the camera further from its centre.
    let away = (fit.pose.position() - centre) * size_sigma;
    let stretch = [0.0, 0.0, 0.0, away.x, away.y, away.z];
    let own = std::array::from_fn(|i| {
        std::array::from_fn(|j| sigma_px * sigma_px * inverse[(i, j)] + stretch[i] * stretch[j])
    });
    let by_lens = (0..n).map(|k| std::array::from_fn(|i| by_lens[(i, k)])).collect();
    Some(PoseScatter { own, by_lens })
}

/// Pixels, size and lens together.
fn total_covariance(lens: &Lens, scatter: &PoseScatter) -> [[f64; 6]; 6] {
    let n = lens.n_parameters();
    let mut total = scatter.own;
    let Some(lens_covariance) = lens.covariance.as_ref().filter(|c| c.len() == n * n) else {
        return total;
    };
    for (i, row) in total.iter_mut().enumerate() {
        for (j, cell) in row.iter_mut().enumerate() {
            for a in 0..n {
                for b in 0..n {
                    *cell +=
                        scatter.by_lens[a][i] * lens_covariance[a * n + b] * scatter.by_lens[b][j];
                }
            }
        }
    }
    total
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Distortion;
    use crate::camera::print::rectangle_corners;

    const EXACT: Noise = Noise { sigma_px: 0.03, degrees: 4.0, size_sigma: 0.0 };

    /// xorshift and the sum of twelve: plenty for scatter tests.
    struct Dice(u64);
    impl Dice {
        fn uniform(&mut self) -> f64 {
            self.0 ^= self.0 << 13;
            self.0 ^= self.0 >> 7;
            self.0 ^= self.0 << 17;
            (self.0 >> 11) as f64 / (1u64 << 53) as f64
        }
        fn normal(&mut self) -> f64 {
            (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
        }
    }

    fn lens() -> Lens {
        Lens {
            distortion: Distortion::BrownConrady {
                k1: -0.1,
                k2: 0.03,
                p1: 6e-4,
                p2: -4e-4,
                k3: 0.0,
            },
            ..Lens::pinhole(940.0, 960, 640)
        }
    }

    fn tag(side: f64) -> [DVec3; 4] {
        rectangle_corners(
            DVec3::new(0.1, 0.0, -0.1),
            DVec3::Y,
            DVec3::new(0.2, 0.0, -1.0),
            side,
            side,
        )
        .unwrap()
    }

    fn sightings(
        lens: &Lens,
        pose: &Pose,
        corners: &[DVec3],
        sigma: f64,
        dice: &mut Dice,
    ) -> Vec<Sighting> {
        corners
            .iter()
            .map(|&world| {
                let pixel = lens.project(pose.inverse().transform_point3(world)).unwrap();
                let noise = DVec2::new(dice.normal(), dice.normal()) * sigma;
                Sighting { world, pixel: pixel + noise }
            })
            .collect()
    }

    #[test]
    fn exact_corners_give_the_exact_pose() {
        let (lens, mut dice) = (lens(), Dice(7));
        for eye in
            [DVec3::new(0.3, 1.5, 2.0), DVec3::new(-1.0, 0.4, 0.2), DVec3::new(0.1, 2.0, 0.1)]
        {
            let truth = Pose::look_at(eye, DVec3::ZERO, DVec3::Y).unwrap();
            let seen = sightings(&lens, &truth, &tag(0.2), 0.0, &mut dice);
            let found = solve(&lens, &seen, &EXACT).unwrap();
            let (turn, shift) = truth.difference(&found.pose);
            // Nearly face-on the tilt hardly shows: 1e-7 rad moves no pixel by 1e-7 px.
            assert!(turn.length() < 1e-6 && shift.length() < 1e-6, "off by {turn} {shift}");
        }
    }

    #[test]
    fn predicted_sigma_covers_the_scatter() {
        // 200 draws: the mean of χ²₆ is 6 ± √(12/200) = 6 ± 0.24; 4σ either side.
        let (lens, mut dice) = (lens(), Dice(11));
        let truth = Pose::look_at(DVec3::new(0.3, 1.5, 2.0), DVec3::ZERO, DVec3::Y).unwrap();
        let known = Noise { sigma_px: 0.1, degrees: 1e6, size_sigma: 0.0 };
        let mut total = 0.0;
        for _ in 0..200 {
            let seen = sightings(&lens, &truth, &tag(0.4), 0.1, &mut dice);
            let found = solve(&lens, &seen, &known).unwrap();
            let (turn, shift) = truth.difference(&found.pose);
            let off = Vector6::new(turn.x, turn.y, turn.z, shift.x, shift.y, shift.z);
            let sigma = found.pose.covariance.unwrap();
            let sigma = Matrix6::from_fn(|i, j| sigma[i][j]);
            total += (off.transpose() * sigma.try_inverse().unwrap() * off)[0];
        }
        let mean = total / 200.0;
        assert!((mean - 6.0).abs() < 4.0 * 0.245, "mean chi² {mean}");
    }

    #[test]
    fn error_of_the_lens_reaches_the_pose() {
        let (mut lens, mut dice) = (lens(), Dice(3));
        let truth = Pose::look_at(DVec3::new(0.0, 1.0, 1.0), DVec3::ZERO, DVec3::Y).unwrap();
        let seen = sightings(&lens, &truth, &tag(0.2), 0.0, &mut dice);
        let tight = solve(&lens, &seen, &EXACT).unwrap();
        let n = lens.n_parameters();
        let mut covariance = vec![0.0; n * n];
        (covariance[0], covariance[n + 1]) = (81.0, 81.0);
        (covariance[1], covariance[n]) = (81.0, 81.0);
        lens.covariance = Some(covariance);
        let loose = solve(&lens, &seen, &EXACT).unwrap();
        // 9 px of 940 is 1 % of focal length: about 1 % of the distance.
        let away = loose.pose.sigmas().unwrap().1.length();
        let distance = (truth.position() - DVec3::new(0.1, 0.0, -0.1)).length();
        assert!(away > 0.8 * 0.0096 * distance && away < 1.3 * 0.0096 * distance, "{away}");
        assert!(tight.pose.sigmas().unwrap().1.length() < 0.3 * away);
    }

    #[test]
    fn face_on_tag_is_called_ambiguous() {
        // F11: tilted 3°, small: at most one of 100 seeds may be called clear and be wrong.
        let (lens, mut dice) = (lens(), Dice(5));
        let (mut ambiguous, mut wrong) = (0, 0);
        for _ in 0..100 {
            let eye = DVec3::new(
                0.1,
                2.0 * 3f64.to_radians().cos(),
                -0.1 + 2.0 * 3f64.to_radians().sin(),
            );
            let truth = Pose::look_at(eye, DVec3::new(0.1, 0.0, -0.1), -DVec3::Z).unwrap();
            let seen = sightings(&lens, &truth, &tag(0.15), 0.2, &mut dice);
            let noise = Noise { sigma_px: 0.2, degrees: 20.0, size_sigma: 0.0 };
            let found = solve(&lens, &seen, &noise).unwrap();
            let (off, _) = truth.difference(&found.pose);
            let sigma = found.pose.sigmas().unwrap().0;
            match found.verdict {
                Verdict::Ambiguous => ambiguous += 1,
                _ if off.length() > 5.0 * sigma.length() => wrong += 1,
                _ => {}
            }
        }
        assert!(ambiguous >= 90, "only {ambiguous} called ambiguous");
        assert!(wrong <= 1, "{wrong} wrong");
    }

    #[test]
    fn tilted_tag_is_clear_and_keeps_both_solutions() {
        let (lens, mut dice) = (lens(), Dice(13));
        let truth = Pose::look_at(DVec3::new(0.3, 1.5, 2.0), DVec3::ZERO, DVec3::Y).unwrap();
        let seen = sightings(&lens, &truth, &tag(0.4), 0.03, &mut dice);
        let found = solve(&lens, &seen, &EXACT).unwrap();
        assert_eq!(found.verdict, Verdict::Clear);
        let other = found.alternative.expect("the mirrored pose");
        assert!(other.delta_chi2 > CLEAR_DELTA_CHI2 && other.rms_px > found.rms_px);
    }

    #[test]
    fn hostile_points_are_errors() {
        let lens = lens();
        let at = |world: DVec3, x: f64, y: f64| Sighting { world, pixel: DVec2::new(x, y) };
        let square = tag(0.2);
        let few: Vec<_> = square[..3].iter().map(|&w| at(w, 0.0, 0.0)).collect();
        assert_eq!(solve(&lens, &few, &EXACT), Err(PoseError::TooFew(3)));
        let line: Vec<_> = (0..5).map(|i| at(DVec3::X * i as f64, i as f64, 0.0)).collect();
        assert_eq!(solve(&lens, &line, &EXACT), Err(PoseError::Degenerate));
        let same: Vec<_> = square.iter().map(|&w| at(w, 10.0, 10.0)).collect();
        assert!(solve(&lens, &same, &EXACT).is_err());
        let nan: Vec<_> = square.iter().map(|&w| at(w, f64::NAN, 10.0)).collect();
        assert_eq!(solve(&lens, &nan, &EXACT), Err(PoseError::Degenerate));
        let mut bent: Vec<_> = square.iter().map(|&w| at(w, w.x, w.z)).collect();
        bent[0].world.y += 0.05;
        assert!(matches!(solve(&lens, &bent, &EXACT), Err(PoseError::NotPlanar { .. })));
    }
}
