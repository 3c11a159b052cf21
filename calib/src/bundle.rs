//! Bundle adjustment: one lens, one board, a pose for each view.
//!
//! Levenberg–Marquardt on pixels; the poses are eliminated view by view (Schur complement), so each
//! step solves one small dense system. Which parameters move, and which move together, is a
//! [`Shape`]; the board may bow (`Z = b_x(1 − (X/a)²) + b_y(1 − (Y/b)²)`).

use nalgebra::{DMatrix, DVector, Matrix3, Matrix6, Rotation3, Vector3, Vector6};
use opencv::calib3d;
use opencv::core::{Mat, Point2d, Point3d, Vector};

use crate::lens::{Lens, Model};
use crate::{OpenCvError, mat};

/// One picture's corners: board place (m) and pixel, in the same order.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    pub board: Vec<[f64; 2]>,
    pub pixels: Vec<[f64; 2]>,
}

/// Which numbers a fit may move.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Shape {
    pub model: Model,
    /// Each entry moves these parameters of the lens together.
    pub moves: Vec<Vec<usize>>,
    pub bow: bool,
}

impl Shape {
    pub fn n_free(&self) -> usize {
        self.moves.len() + if self.bow { 2 } else { 0 }
    }
}

/// Board to camera, OpenCV's axes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ViewPose {
    pub rotation: Rotation3<f64>,
    pub translation: Vector3<f64>,
}

#[derive(Clone, Debug)]
pub(crate) struct State {
    pub lens: Lens,
    pub bow: [f64; 2],
    pub poses: Vec<ViewPose>,
}

/// A finished fit.
#[derive(Clone, Debug)]
pub(crate) struct Fit {
    pub state: State,
    /// Sum of squared residuals of each view, px².
    pub view_squares: Vec<f64>,
    /// Information of the free global parameters, poses eliminated, at σ = 1 px.
    pub information: DMatrix<f64>,
}

impl Fit {
    pub fn sum_squares(&self) -> f64 {
        self.view_squares.iter().sum()
    }
}

/// Half-widths and centre of the board, for the bow.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BoardExtent {
    centre: [f64; 2],
    half: [f64; 2],
}

impl BoardExtent {
    pub fn of(views: &[View]) -> Self {
        let mut low = [f64::INFINITY; 2];
        let mut high = [f64::NEG_INFINITY; 2];
        for p in views.iter().flat_map(|v| &v.board) {
            for k in 0..2 {
                low[k] = low[k].min(p[k]);
                high[k] = high[k].max(p[k]);
            }
        }
        Self {
            centre: [0, 1].map(|k| 0.5 * (low[k] + high[k])),
            half: [0, 1].map(|k| 0.5 * (high[k] - low[k])),
        }
    }

    /// How far the board rises at a point for b = (1, 0) and (0, 1).
    fn rise(&self, p: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|k| 1.0 - ((p[k] - self.centre[k]) / self.half[k]).powi(2))
    }
}

/// Normal equations of one view: global × global, global × pose, pose × pose, and gradients.
struct Block {
    global: DMatrix<f64>,
    cross: DMatrix<f64>,
    pose: Matrix6<f64>,
    global_gradient: DVector<f64>,
    pose_gradient: Vector6<f64>,
    squares: f64,
}

fn block(
    shape: &Shape,
    extent: &BoardExtent,
    state: &State,
    view: &View,
    index: usize,
) -> Option<Block> {
    let g = shape.n_free();
    let mut out = Block {
        global: DMatrix::zeros(g, g),
        cross: DMatrix::zeros(g, 6),
        pose: Matrix6::zeros(),
        global_gradient: DVector::zeros(g),
        pose_gradient: Vector6::zeros(),
        squares: 0.0,
    };
    let pose = &state.poses[index];
    let rotation: &Matrix3<f64> = pose.rotation.matrix();
    let mut row_global = DVector::zeros(g);
    for (board, seen) in view.board.iter().zip(&view.pixels) {
        let rise = extent.rise(*board);
        let on_board =
            Vector3::new(board[0], board[1], state.bow[0] * rise[0] + state.bow[1] * rise[1]);
        let turned = rotation * on_board;
        let at = turned + pose.translation;
        let projection = state.lens.project_with_derivatives(at.into())?;
        for k in 0..2 {
            let residual = seen[k] - projection.pixel[k];
            let by_point = Vector3::from(projection.by_point[k]);
            // Turning by ω after the rotation moves the point by ω × turned.
            let turn = turned.cross(&by_point);
            let row_pose = Vector6::new(turn.x, turn.y, turn.z, by_point.x, by_point.y, by_point.z);
            for (i, together) in shape.moves.iter().enumerate() {
                row_global[i] = together.iter().map(|&p| projection.by_parameter[k][p]).sum();
            }
            if shape.bow {
                let lift = by_point.dot(&rotation.column(2));
                row_global[g - 2] = lift * rise[0];
                row_global[g - 1] = lift * rise[1];
            }
            out.global.ger(1.0, &row_global, &row_global, 1.0);
            out.cross.ger(1.0, &row_global, &row_pose, 1.0);
            out.pose.ger(1.0, &row_pose, &row_pose, 1.0);
            out.global_gradient.axpy(residual, &row_global, 1.0);
            out.pose_gradient.axpy(residual, &row_pose, 1.0);
            out.squares += residual * residual;
        }
    }
    Some(out)
}

fn blocks(
    shape: &Shape,
    extent: &BoardExtent,
    state: &State,
    views: &[View],
) -> Option<Vec<Block>> {
    views.iter().enumerate().map(|(i, v)| block(shape, extent, state, v, i)).collect()
}

fn damped6(pose: &Matrix6<f64>, damping: f64) -> Matrix6<f64> {
    let mut out = *pose;
    for i in 0..6 {
        out[(i, i)] *= 1.0 + damping;
    }
    out
}

/// Global system with the poses eliminated.
fn reduced(blocks: &[Block], g: usize, damping: f64) -> Option<(DMatrix<f64>, DVector<f64>)> {
    let mut system = DMatrix::zeros(g, g);
    let mut right = DVector::zeros(g);
    for b in blocks {
        system += &b.global;
        right += &b.global_gradient;
    }
    for i in 0..g {
        system[(i, i)] *= 1.0 + damping;
    }
    for b in blocks {
        let inverse = damped6(&b.pose, damping).try_inverse()?;
        let weighted = &b.cross * inverse;
        system -= &weighted * b.cross.transpose();
        right -= &weighted * b.pose_gradient;
    }
    Some((system, right))
}

/// Solves with the system scaled to a unit diagonal: focal lengths and k3 differ by 10⁶.
fn solve_scaled(system: &DMatrix<f64>, right: &DVector<f64>) -> Option<DVector<f64>> {
    let g = right.len();
    let scale = DVector::from_fn(g, |i, _| system[(i, i)].max(1e-300).sqrt().recip());
    let scaled = DMatrix::from_fn(g, g, |i, j| system[(i, j)] * scale[i] * scale[j]);
    let solved = scaled.cholesky()?.solve(&right.component_mul(&scale));
    Some(solved.component_mul(&scale))
}

fn stepped(shape: &Shape, state: &State, blocks: &[Block], damping: f64) -> Option<(State, f64)> {
    let g = shape.n_free();
    let step = if g > 0 {
        let (system, right) = reduced(blocks, g, damping)?;
        solve_scaled(&system, &right)?
    } else {
        DVector::zeros(0)
    };
    let mut next = state.clone();
    let mut largest = 0.0f64;
    for (i, together) in shape.moves.iter().enumerate() {
        for &p in together {
            next.lens.parameters[p] += step[i];
            largest = largest.max((step[i] / (1e-3 + next.lens.parameters[p].abs())).abs());
        }
    }
    if shape.bow {
        next.bow[0] += step[g - 2];
        next.bow[1] += step[g - 1];
    }
    for (pose, b) in next.poses.iter_mut().zip(blocks) {
        let right = b.pose_gradient - b.cross.transpose() * &step;
        let right = Vector6::from_column_slice(right.as_slice());
        let move6 = damped6(&b.pose, damping).try_inverse()? * right;
        let turn = Rotation3::new(Vector3::new(move6[0], move6[1], move6[2]));
        pose.rotation = turn * pose.rotation;
        pose.translation += Vector3::new(move6[3], move6[4], move6[5]);
        largest = largest.max(move6.amax());
    }
    // Many small products drift off the rotations.
    for pose in &mut next.poses {
        pose.rotation.renormalize();
    }
    Some((next, largest))
}

/// Levenberg–Marquardt from `start`; `None` if the start itself cannot be projected.
pub(crate) fn adjust(
    shape: &Shape,
    extent: &BoardExtent,
    views: &[View],
    start: State,
) -> Option<Fit> {
    const MOST_STEPS: usize = 120;
    let mut state = start;
    let mut current = blocks(shape, extent, &state, views)?;
    let squares = |all: &[Block]| all.iter().map(|b| b.squares).sum::<f64>();
    let mut damping = 1e-3;
    for _ in 0..MOST_STEPS {
        let tried = stepped(shape, &state, &current, damping).and_then(|(next, largest)| {
            let all = blocks(shape, extent, &next, views)?;
            (squares(&all) <= squares(&current)).then_some((next, all, largest))
        });
        match tried {
            Some((next, all, largest)) => {
                let gain = squares(&current) - squares(&all);
                let done = gain <= 1e-11 * squares(&current) && largest < 1e-5;
                (state, current) = (next, all);
                damping = (damping * 0.2).max(1e-12);
                if done {
                    break;
                }
            }
            None => {
                damping *= 8.0;
                if damping > 1e10 {
                    break;
                }
            }
        }
    }
    let g = shape.n_free();
    let information = if g > 0 { reduced(&current, g, 0.0)?.0 } else { DMatrix::zeros(0, 0) };
    let view_squares = current.iter().map(|b| b.squares).collect();
    Some(Fit { state, view_squares, information })
}

/// Pose of a view for a roughly known lens: OpenCV's planar solver on undistorted directions.
pub(crate) fn start_pose(lens: &Lens, view: &View) -> Result<Option<ViewPose>, OpenCvError> {
    let mut object = Vector::<Point3d>::new();
    let mut image = Vector::<Point2d>::new();
    for (board, &pixel) in view.board.iter().zip(&view.pixels) {
        // Directions beyond 80° have no useful place on the plane z = 1.
        if let Some(d) = lens.unproject(pixel).filter(|d| d[2] > 0.17) {
            object.push(Point3d::new(board[0], board[1], 0.0));
            image.push(Point2d::new(d[0] / d[2], d[1] / d[2]));
        }
    }
    if object.len() < 6 {
        return Ok(None);
    }
    let unit = Mat::from_slice_2d(&[[1.0f64, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])?;
    let none = opencv::core::no_array();
    let (mut rotation, mut translation) = (Mat::default(), Mat::default());
    let solved = calib3d::solve_pnp(
        &object,
        &image,
        &unit,
        &none,
        &mut rotation,
        &mut translation,
        false,
        calib3d::SOLVEPNP_IPPE,
    );
    // Degenerate point sets throw: that view has no pose, the others may.
    if !matches!(solved, Ok(true)) {
        return Ok(None);
    }
    let (r, t) = (mat::values(&rotation)?, mat::values(&translation)?);
    if r.len() != 3 || t.len() != 3 || r.iter().chain(&t).any(|v| !v.is_finite()) || t[2] <= 0.0 {
        return Ok(None);
    }
    Ok(Some(ViewPose {
        rotation: Rotation3::new(Vector3::from_column_slice(&r)),
        translation: Vector3::from_column_slice(&t),
    }))
}
