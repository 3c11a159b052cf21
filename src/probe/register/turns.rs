//! All rotations, coarsely: which bring one blurred picture onto another?
//!
//! 6° apart, 1146 places for the second picture's zenith times 60 turns about it. A turn about the
//! zenith shifts the columns of a lat-long, so directions are looked up once for each zenith:
//! 55 million table look-ups, a fraction of a second, and no lamp or corner needs to be found first.

use std::f64::consts::{PI, TAU};

use glam::{DMat3, DQuat, DVec2, DVec3};
use rayon::prelude::*;

use super::pyramid::{Agreement, Level, Sums};
use crate::conventions::{lat_long_direction, lat_long_pixel};
use crate::probe::mapping::spread_directions;

const STEP_RAD: f64 = 6.0 * PI / 180.0;
/// Directions of the first picture that are compared.
const POINTS: usize = 800;
/// Columns of the second picture's table: two for each turn.
const COLUMNS: usize = 120;
const TURNS: usize = COLUMNS / 2;
/// Candidates nearer to each other than this are one.
const APART_RAD: f64 = 15.0 * PI / 180.0;
/// Less than this in common proves nothing, sr.
pub(super) const LEAST_OVERLAP_SR: f64 = 0.6;

/// The best rotations of `b`'s axes to `a`'s, the most likely first, with their evidence.
pub(super) fn search(a: &Level, b: &Level, n: usize) -> Vec<(DQuat, f64)> {
    let points: Vec<(DVec3, f64)> =
        spread_directions(POINTS).filter_map(|d| a.value_at(d).map(|v| (d, v))).collect();
    let table: Vec<Option<f64>> = (0..COLUMNS * COLUMNS / 2)
        .map(|k| {
            let pixel = DVec2::new((k % COLUMNS) as f64, (k / COLUMNS) as f64);
            b.value_at(lat_long_direction(pixel, COLUMNS, COLUMNS / 2))
        })
        .collect();
    let zeniths = (4.0 * PI / (STEP_RAD * STEP_RAD)) as usize;
    let mut scored: Vec<(DQuat, f64)> = spread_directions(zeniths)
        .collect::<Vec<_>>()
        .par_iter()
        .flat_map_iter(|&zenith| {
            let tilt = DQuat::from_rotation_arc(DVec3::Y, zenith);
            scores(&points, &table, tilt).into_iter().enumerate().map(move |(turn, score)| {
                (tilt * DQuat::from_rotation_y(turn as f64 * TAU / TURNS as f64), score)
            })
        })
        .collect();
    // Stable, and in the order of the grid: the same for any number of threads.
    scored.sort_by(|a, b| b.1.total_cmp(&a.1));
    let mut best: Vec<(DQuat, f64)> = Vec::new();
    for candidate in scored {
        if best.len() == n || candidate.1 <= 0.0 {
            break;
        }
        if best.iter().all(|other| other.0.angle_between(candidate.0) > APART_RAD) {
            best.push(candidate);
        }
    }
    best
}

/// Evidence for each turn about the second picture's zenith after `tilt`.
fn scores(points: &[(DVec3, f64)], table: &[Option<f64>], tilt: DQuat) -> Vec<f64> {
    let back = DMat3::from_quat(tilt.conjugate());
    // Row and column at no turn; a turn about +Y moves the column on.
    let cells: Vec<(usize, usize, f64)> = points
        .iter()
        .map(|&(d, value)| {
            let p = lat_long_pixel(back * d, COLUMNS, COLUMNS / 2).round();
            let row = (p.y.max(0.0) as usize).min(COLUMNS / 2 - 1);
            (row * COLUMNS, (p.x as i64).rem_euclid(COLUMNS as i64) as usize, value)
        })
        .collect();
    let share = 4.0 * PI / POINTS as f64;
    (0..TURNS)
        .map(|turn| {
            let mut sums = Sums::default();
            for &(row, column, value) in &cells {
                if let Some(other) = table[row + (column + 2 * turn) % COLUMNS] {
                    sums.add(share, value, other);
                }
            }
            if sums.weight < LEAST_OVERLAP_SR { 0.0 } else { Agreement::of(&sums).evidence() }
        })
        .collect()
}
