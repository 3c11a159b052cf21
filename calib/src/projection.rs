//! How far a lens may be wrong over the frame, in pixels of the picture.
//!
//! A turn of the camera and a change of the lens can look alike; what matters is what no turn takes
//! back (rotation-compensated projection uncertainty, after D. Kogan's mrcal). Not contained: errors
//! of a model that is too small, of a bent board, of a lens that moved since.

use nalgebra::{DMatrix, Matrix3, Vector3};

use crate::lens::Lens;

/// Columns and rows of the grid on which uncertainty is stated.
pub const GRID: [usize; 2] = [17, 11];

/// Projection uncertainty over the frame.
#[derive(Clone, Debug, PartialEq)]
pub struct ProjectionSigma {
    /// Row-major over [`GRID`], from the first to the last pixel centre; `None` where the model sees nothing.
    pub grid_px: Vec<Option<f64>>,
    /// Mean over the whole frame, as far as the model sees it.
    pub mean_px: f64,
    pub max_px: f64,
    /// Mean inside the hull of all corners.
    pub covered_px: f64,
    /// Share of the frame that lies outside the hull of all corners.
    pub extrapolated: f64,
}

impl ProjectionSigma {
    /// Inside the corners within `most_px`, and over the frame within four times that.
    ///
    /// What lies beyond every corner is extrapolated and only warned of: a fisheye's dead corners would
    /// otherwise condemn every lens that is honest about them.
    pub(crate) fn is_within(&self, most_px: f64) -> bool {
        self.covered_px <= most_px && self.mean_px <= 4.0 * most_px
    }
}

/// Pixels of the grid.
pub(crate) fn grid(width: usize, height: usize) -> Vec<[f64; 2]> {
    let [columns, rows] = GRID;
    (0..columns * rows)
        .map(|k| {
            let (i, j) = (k % columns, k / columns);
            [
                (width as f64 - 1.0) * i as f64 / (columns - 1) as f64,
                (height as f64 - 1.0) * j as f64 / (rows - 1) as f64,
            ]
        })
        .collect()
}

/// Rows ∂q/∂ω of turning the direction `d` by a small ω.
fn turn_rows(by_point: [[f64; 3]; 2], d: [f64; 3]) -> [Vector3<f64>; 2] {
    by_point.map(|g| Vector3::from(d).cross(&Vector3::from(g)))
}

/// Uncertainty on the grid from the covariance of all parameters (row-major, model's size).
pub(crate) fn sigma(
    lens: &Lens,
    covariance: &DMatrix<f64>,
    width: usize,
    height: usize,
    hull: &[[f64; 2]],
) -> Option<ProjectionSigma> {
    let n = lens.model.n_parameters();
    let places = grid(width, height);
    let mut lines = vec![];
    let mut turns = vec![];
    let mut seen = vec![None; places.len()];
    for (k, &pixel) in places.iter().enumerate() {
        let Some(d) = lens.unproject(pixel) else { continue };
        let Some(p) = lens.project_with_derivatives(d) else { continue };
        seen[k] = Some(lines.len());
        lines.push(p.by_parameter);
        turns.push(turn_rows(p.by_point, d));
    }
    if lines.len() < 3 {
        return None;
    }
    let by_lens = DMatrix::from_fn(2 * lines.len(), n, |r, c| lines[r / 2][r % 2][c]);
    let by_turn = DMatrix::from_fn(2 * lines.len(), 3, |r, c| turns[r / 2][r % 2][c]);
    let normal: Matrix3<f64> = (by_turn.transpose() * &by_turn).fixed_view::<3, 3>(0, 0).into();
    let taken = &by_turn * (normal.try_inverse()? * (by_turn.transpose() * &by_lens));
    let left = by_lens - taken;
    let spread = &left * covariance;
    let variance = |row: usize| spread.row(row).dot(&left.row(row)).max(0.0);
    let grid_px: Vec<Option<f64>> = seen
        .iter()
        .map(|line| line.map(|l| (variance(2 * l) + variance(2 * l + 1)).sqrt()))
        .collect();
    let known: Vec<f64> = grid_px.iter().flatten().copied().collect();
    let covered: Vec<f64> = places
        .iter()
        .zip(&grid_px)
        .filter(|&(&p, _)| inside(hull, p))
        .filter_map(|(_, s)| *s)
        .collect();
    let outside = places.iter().filter(|&&p| !inside(hull, p)).count();
    let mean = |all: &[f64]| all.iter().sum::<f64>() / all.len() as f64;
    Some(ProjectionSigma {
        // A hull between the grid's points has no mean of its own.
        covered_px: if covered.is_empty() { mean(&known) } else { mean(&covered) },
        mean_px: mean(&known),
        max_px: known.iter().copied().fold(0.0, f64::max),
        extrapolated: outside as f64 / places.len() as f64,
        grid_px,
    })
}

/// Root mean square difference of two lenses over the frame after the best turn, px.
pub(crate) fn difference(a: &Lens, b: &Lens, width: usize, height: usize) -> Option<f64> {
    let mut off = vec![];
    let mut turns = vec![];
    for pixel in grid(width, height) {
        let Some(d) = a.unproject(pixel) else { continue };
        let Some(p) = b.project_with_derivatives(d) else { continue };
        let rows = turn_rows(p.by_point, d);
        for k in 0..2 {
            off.push(p.pixel[k] - pixel[k]);
            turns.push(rows[k]);
        }
    }
    let mut normal = Matrix3::zeros();
    let mut right = Vector3::zeros();
    for (o, t) in off.iter().zip(&turns) {
        normal += t * t.transpose();
        right += t * *o;
    }
    let turn = normal.try_inverse()? * right;
    let squares: f64 = off.iter().zip(&turns).map(|(o, t)| (o - t.dot(&turn)).powi(2)).sum();
    Some((2.0 * squares / off.len() as f64).sqrt())
}

/// Convex hull, counter-clockwise (Andrew's monotone chain).
pub(crate) fn convex_hull(mut points: Vec<[f64; 2]>) -> Vec<[f64; 2]> {
    points.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    let half = |points: &mut dyn Iterator<Item = &[f64; 2]>| {
        let mut chain: Vec<[f64; 2]> = vec![];
        for &p in points {
            while chain.len() >= 2 && turn(chain[chain.len() - 2], chain[chain.len() - 1], p) <= 0.0
            {
                chain.pop();
            }
            chain.push(p);
        }
        chain.pop();
        chain
    };
    let mut hull = half(&mut points.iter());
    hull.extend(half(&mut points.iter().rev()));
    hull
}

/// Twice the signed area of the triangle a, b, c.
fn turn(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

fn inside(hull: &[[f64; 2]], p: [f64; 2]) -> bool {
    hull.len() >= 3 && (0..hull.len()).all(|i| turn(hull[i], hull[(i + 1) % hull.len()], p) >= 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::Model;

    #[test]
    fn shifting_the_principal_point_is_mostly_a_turn() {
        let lens = Lens::simple(Model::Brown, 900.0, 960, 640);
        let mut covariance = DMatrix::zeros(12, 12);
        covariance[(2, 2)] = 1.0;
        let shift = sigma(&lens, &covariance, 960, 640, &[]).unwrap();
        assert!(shift.mean_px < 0.25, "1 px of cx leaves {} px", shift.mean_px);
        covariance[(2, 2)] = 0.0;
        (covariance[(0, 0)], covariance[(0, 1)]) = (1.0, 1.0);
        (covariance[(1, 0)], covariance[(1, 1)]) = (1.0, 1.0);
        // 1 px of f moves a pixel by r/f, whatever the turn.
        let focal = sigma(&lens, &covariance, 960, 640, &[]).unwrap();
        let corner = focal.grid_px[0].unwrap();
        assert!((corner - 479.5f64.hypot(319.5) / 900.0).abs() < 1e-3, "{corner}");
        assert_eq!(focal.extrapolated, 1.0);
    }

    #[test]
    fn hull_of_a_grid_is_its_corners() {
        let points = (0..20).map(|i| [(i % 5) as f64, (i / 5) as f64]).collect();
        assert_eq!(convex_hull(points).len(), 4);
        assert!(inside(&[[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]], [1.0, 1.9]));
        assert!(!inside(&[[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]], [1.0, 2.1]));
    }
}
