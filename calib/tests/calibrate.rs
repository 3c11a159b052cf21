//! Calibration as an experiment: known lenses, drawn corners, stated errors against real ones.

use platelight_calib::calibrate::{CalibrateError, Calibration, View, Warning, calibrate};
use platelight_calib::{Lens, Model};

const WIDTH: usize = 960;
const HEIGHT: usize = 640;

/// xorshift, and the sum of twelve for normal deviates.
struct Dice(u64);

impl Dice {
    fn uniform(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

/// How the board is held.
#[derive(Clone, Copy)]
struct Session {
    n_views: usize,
    tilt_deg: f64,
    /// Share of the frame in which board centres lie.
    spread: f64,
    square_px: f64,
    sigma_px: f64,
    bow_m: f64,
}

const GOOD: Session = Session {
    n_views: 12,
    tilt_deg: 45.0,
    spread: 0.75,
    square_px: 40.0,
    sigma_px: 0.1,
    bow_m: 0.0,
};

/// Corners of a 9 × 6 board of 25 mm seen through `lens`; boards that leave the frame are redrawn.
fn views(lens: &Lens, session: &Session, dice: &mut Dice) -> Vec<View> {
    let mut all = vec![];
    let fx = lens.parameters[0];
    while all.len() < session.n_views {
        let z = 0.025 * fx / session.square_px * dice.between(0.85, 1.2);
        let tilt = |dice: &mut Dice| dice.between(-session.tilt_deg, session.tilt_deg).to_radians();
        let (a, b, c) = (tilt(dice), tilt(dice), dice.between(-0.3, 0.3));
        let at = |half: f64, dice: &mut Dice| half * session.spread * dice.between(-1.0, 1.0);
        let x = at(WIDTH as f64 / 2.0, dice) / fx * z;
        let y = at(HEIGHT as f64 / 2.0, dice) / fx * z;
        let rotation = nalgebra::Rotation3::from_euler_angles(a, b, c);
        let mut view = View { board: vec![], pixels: vec![] };
        for k in 0..54 {
            let board = [0.025 * (k % 9) as f64, 0.025 * (k / 9) as f64];
            let (u, v) = (board[0] - 0.1, board[1] - 0.0625);
            let rise = session.bow_m * (1.0 - (u / 0.1).powi(2));
            let p = rotation * nalgebra::Vector3::new(u, v, rise) + nalgebra::Vector3::new(x, y, z);
            let Some(pixel) = lens.project(p.into()) else { break };
            let inside = (3.0..WIDTH as f64 - 4.0).contains(&pixel[0])
                && (3.0..HEIGHT as f64 - 4.0).contains(&pixel[1]);
            if !inside {
                break;
            }
            view.board.push(board);
            let noise = [dice.normal(), dice.normal()].map(|n| n * session.sigma_px);
            view.pixels.push([pixel[0] + noise[0], pixel[1] + noise[1]]);
        }
        if view.pixels.len() == 54 {
            all.push(view);
        }
    }
    all
}

/// Slight barrel, decentred, pixels not quite square.
fn ordinary() -> Lens {
    let mut lens = Lens::simple(Model::Brown, 940.0, WIDTH, HEIGHT);
    lens.parameters[..8].copy_from_slice(&[940.0, 941.4, 484.0, 316.0, -0.11, 0.03, 5e-4, -4e-4]);
    lens
}

fn sigma(calibration: &Calibration, i: usize) -> f64 {
    let n = calibration.lens.model.n_parameters();
    calibration.covariance[i * n + i].sqrt()
}

#[test]
fn predicted_sigma_covers_the_scatter_of_the_focal_length() {
    // 40 draws: the mean of z² has σ = √(2/40) = 0.22; four of them, and the choice of the rung on top.
    let (lens, mut dice) = (ordinary(), Dice(42));
    let mut sum = 0.0;
    let n = 40;
    for _ in 0..n {
        let found = calibrate(WIDTH, HEIGHT, &views(&lens, &GOOD, &mut dice)).unwrap();
        let off = found.lens.parameters[0] - lens.parameters[0];
        sum += (off / sigma(&found, 0)).powi(2);
        assert!(found.projection.mean_px < 0.6, "σ_proj {}", found.projection.mean_px);
        assert!((found.sigma_px - 0.1).abs() < 0.012, "σ of the corners {}", found.sigma_px);
    }
    let mean = sum / f64::from(n);
    eprintln!("mean z² of fx: {mean:.2}");
    assert!((0.3..2.2).contains(&mean), "mean z² {mean}");
}

#[test]
fn a_pinhole_is_called_a_pinhole() {
    let lens = Lens::simple(Model::Brown, 1000.0, WIDTH, HEIGHT);
    let mut dice = Dice(3);
    for _ in 0..4 {
        let found = calibrate(WIDTH, HEIGHT, &views(&lens, &GOOD, &mut dice)).unwrap();
        assert_eq!(found.rung, "f");
    }
}

#[test]
fn frontal_views_are_refused_with_the_remedy() {
    // F1, F2: the residual is as small as ever; only σ_proj tells.
    let (lens, mut dice) = (ordinary(), Dice(4));
    let frontal = Session { tilt_deg: 1.0, ..GOOD };
    let error = calibrate(WIDTH, HEIGHT, &views(&lens, &frontal, &mut dice)).unwrap_err();
    let refused = matches!(
        error,
        CalibrateError::TooUncertain { sigma_px: 2.0.., .. } | CalibrateError::NoModel { .. }
    );
    assert!(refused && error.to_string().contains("tilt the board"), "{error}");
}

#[test]
fn corners_in_the_middle_only_warn_or_are_refused() {
    // F3: a third of the frame covered.
    let (lens, mut dice) = (ordinary(), Dice(5));
    let middle = Session { spread: 0.05, square_px: 26.0, ..GOOD };
    match calibrate(WIDTH, HEIGHT, &views(&lens, &middle, &mut dice)) {
        Ok(found) => {
            let told = |w: &Warning| matches!(w, Warning::Extrapolated { .. });
            assert!(found.warnings.iter().any(told), "{:?}", found.warnings);
            assert!(found.projection.extrapolated > 0.35);
        }
        Err(error) => assert!(error.to_string().contains("corners of the frame"), "{error}"),
    }
}

#[test]
fn few_views_get_few_parameters_or_a_refusal() {
    // F4.
    let (lens, mut dice) = (ordinary(), Dice(6));
    for n_views in [1, 2] {
        let few = Session { n_views, ..GOOD };
        match calibrate(WIDTH, HEIGHT, &views(&lens, &few, &mut dice)) {
            Ok(found) => {
                assert!(found.rung == "f" || found.rung == "f k1", "{}", found.rung);
                assert!(found.warnings.contains(&Warning::FewViews { used: n_views }));
                assert!(found.warnings.contains(&Warning::CentreAssumed));
            }
            Err(error) => assert!(error.to_string().contains("10 to 15"), "{error}"),
        }
    }
    assert!(matches!(calibrate(WIDTH, HEIGHT, &[]), Err(CalibrateError::NoViews)));
}

#[test]
fn a_fisheye_is_fitted_by_kannala_brandt() {
    // F6: a lens of 150° by the equidistant family.
    let mut lens = Lens::simple(Model::KannalaBrandt, 330.0, WIDTH, HEIGHT);
    lens.parameters[4..8].copy_from_slice(&[0.02, -0.004, 0.002, -0.0006]);
    let mut dice = Dice(7);
    let session = Session { n_views: 14, spread: 0.7, square_px: 26.0, tilt_deg: 40.0, ..GOOD };
    let found = calibrate(WIDTH, HEIGHT, &views(&lens, &session, &mut dice)).unwrap();
    assert_eq!(found.lens.model, Model::KannalaBrandt, "{}", found.rung);
    assert!((found.lens.parameters[0] - 330.0).abs() < 4.0 * sigma(&found, 0).max(0.05));
}

#[test]
fn a_bent_board_is_noticed_and_does_not_bend_the_lens() {
    // F13: 0.5 mm over ±10 cm.
    let (lens, mut dice) = (ordinary(), Dice(8));
    let bent = Session { bow_m: 5e-4, ..GOOD };
    let found = calibrate(WIDTH, HEIGHT, &views(&lens, &bent, &mut dice)).unwrap();
    let [(along, sigma_along), _] = found.bow_m.expect("the bow is a rung");
    assert!((along.abs() - 5e-4).abs() < 5.0 * sigma_along + 3e-5, "{along} ± {sigma_along}");
    assert!(found.warnings.iter().any(|w| matches!(w, Warning::Bowed { .. })));
    assert!((found.lens.parameters[0] / 940.0 - 1.0).abs() < 2e-3, "{:?}", found.lens);
}

#[test]
fn one_bad_view_is_named_and_left_out() {
    // U10: corners of view 5 from a board that moved while exposed.
    let (lens, mut dice) = (ordinary(), Dice(9));
    let mut all = views(&lens, &GOOD, &mut dice);
    for (k, p) in all[5].pixels.iter_mut().enumerate() {
        p[0] += 2.0 * ((k % 9) as f64 / 4.0 - 1.0).powi(3);
    }
    let found = calibrate(WIDTH, HEIGHT, &all).unwrap();
    for (i, view) in found.views.iter().enumerate() {
        assert_eq!(view.rejected.is_some(), i == 5, "view {i}: {:?}", view.rejected);
    }
    assert!((found.lens.parameters[0] - 940.0).abs() < 5.0 * sigma(&found, 0));
}

#[test]
fn hostile_views_are_errors() {
    let bad = View { board: vec![[0.0, 0.0]; 3], pixels: vec![[1.0, 1.0]; 3] };
    assert!(matches!(calibrate(WIDTH, HEIGHT, &[bad]), Err(CalibrateError::BadView { .. })));
    let nan = View { board: vec![[0.0, 0.0]; 12], pixels: vec![[f64::NAN, 1.0]; 12] };
    assert!(matches!(calibrate(WIDTH, HEIGHT, &[nan]), Err(CalibrateError::BadView { .. })));
    let same = View { board: vec![[0.0, 0.0]; 12], pixels: vec![[5.0, 1.0]; 12] };
    assert!(calibrate(WIDTH, HEIGHT, &[same.clone(), same.clone(), same]).is_err());
}
