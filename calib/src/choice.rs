//! The model ladder and the rule that picks a rung.
//!
//! Every rung is fitted. The Bayesian information criterion and leave-views-out cross-validation with
//! the one-standard-error rule (Hastie et al., ESL §7.10) each name one; where the two lenses differ by
//! less than a fifth of a pixel over the frame BIC's is taken, else the one with the smaller
//! projection uncertainty, with a warning. Too small a model is far worse than one too big; a bent
//! board makes BIC greedy, which is why the bow is a rung of its own.

use nalgebra::{DMatrix, SymmetricEigen};
use rayon::prelude::*;

use crate::OpenCvError;
use crate::bundle::{self, BoardExtent, Fit, Shape, State, View};
use crate::lens::{Lens, Model};
use crate::projection::{self, ProjectionSigma};

/// A fitted rung with everything the rule looks at.
#[derive(Clone, Debug)]
pub(crate) struct Rung {
    pub name: String,
    pub shape: Shape,
    pub fit: Fit,
    pub sigma_px: f64,
    pub bic: f64,
    /// Covariance of all parameters of the model.
    pub covariance: DMatrix<f64>,
    /// Covariance of the bow, if free.
    pub bow_sigma_m: Option<[f64; 2]>,
    pub projection: ProjectionSigma,
    pub covers: bool,
    /// Mean squared residual of each held-out view, px².
    pub held_out: Option<Vec<f64>>,
}

/// Smallest standard deviation of a corner coordinate that is believed, px.
const SIGMA_FLOOR_PX: f64 = 0.01;

fn shapes() -> Vec<(&'static str, Shape)> {
    let brown = |moves: &[&[usize]]| Shape {
        model: Model::Brown,
        moves: moves.iter().map(|m| m.to_vec()).collect(),
        bow: false,
    };
    let fisheye = |coefficients: usize| Shape {
        model: Model::KannalaBrandt,
        moves: [vec![0, 1], vec![2], vec![3]]
            .into_iter()
            .chain((4..4 + coefficients).map(|k| vec![k]))
            .collect(),
        bow: false,
    };
    let f: &[usize] = &[0, 1];
    let (cx, cy): (&[usize], &[usize]) = (&[2], &[3]);
    let [k1, k2, p1, p2, k3]: [&[usize]; 5] = [&[4], &[5], &[6], &[7], &[8]];
    let [k4, k5, k6]: [&[usize]; 3] = [&[9], &[10], &[11]];
    vec![
        ("f", brown(&[f])),
        ("f k1", brown(&[f, k1])),
        ("f c k1", brown(&[f, cx, cy, k1])),
        ("f c k1 k2", brown(&[f, cx, cy, k1, k2])),
        ("f c k1 k2 p1 p2", brown(&[f, cx, cy, k1, k2, p1, p2])),
        ("f c k1 k2 p1 p2 k3", brown(&[f, cx, cy, k1, k2, p1, p2, k3])),
        ("rational", brown(&[f, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6])),
        ("Kannala-Brandt k1", fisheye(1)),
        ("Kannala-Brandt k1 k2", fisheye(2)),
        ("Kannala-Brandt k1 k2 k3", fisheye(3)),
        ("Kannala-Brandt k1 k2 k3 k4", fisheye(4)),
    ]
}

/// The same rung with fx and fy apart.
fn with_aspect(shape: &Shape) -> Shape {
    let mut moves = vec![vec![0], vec![1]];
    moves.extend(shape.moves[1..].iter().cloned());
    Shape { moves, ..shape.clone() }
}

/// Whether the diagonal field exceeds 90°: below, fisheye models only imitate the others.
fn is_wide(lens: &Lens, width: usize, height: usize) -> bool {
    let off_axis = |x: f64, y: f64| lens.unproject([x, y]).map(|d| d[2].clamp(-1.0, 1.0).acos());
    match (off_axis(0.0, 0.0), off_axis(width as f64 - 1.0, height as f64 - 1.0)) {
        (Some(a), Some(b)) => a + b > std::f64::consts::FRAC_PI_2,
        // Corners no direction reaches belong to an image circle.
        _ => true,
    }
}

/// Best one-parameter fit from several focal lengths: one start decides nothing.
fn first_fit(
    model: Model,
    width: usize,
    height: usize,
    views: &[View],
    extent: &BoardExtent,
) -> Result<Option<State>, OpenCvError> {
    let factors: &[f64] = match model {
        Model::Brown => &[0.45, 0.8, 1.2, 2.0, 4.0],
        Model::KannalaBrandt => &[0.22, 0.35, 0.6, 1.0, 2.0],
    };
    let shape = Shape { model, moves: vec![vec![0, 1]], bow: false };
    let mut best: Option<Fit> = None;
    for factor in factors {
        let lens = Lens::simple(model, factor * width.max(height) as f64, width, height);
        let poses = views
            .iter()
            .map(|v| bundle::start_pose(&lens, v))
            .collect::<Result<Option<Vec<_>>, _>>()?;
        let Some(poses) = poses else { continue };
        let start = State { lens, bow: [0.0; 2], poses };
        if let Some(fit) = bundle::adjust(&shape, extent, views, start)
            .filter(|f| f.state.lens.parameters[0] > 0.0)
            && best.as_ref().is_none_or(|b| fit.sum_squares() < b.sum_squares())
        {
            best = Some(fit);
        }
    }
    Ok(best.map(|fit| fit.state))
}

/// Fits all rungs that `views` can carry; ordered as the ladder, fewest parameters first.
pub(crate) fn fit_all(
    width: usize,
    height: usize,
    views: &[View],
) -> Result<Vec<Rung>, OpenCvError> {
    let extent = BoardExtent::of(views);
    let hull = projection::convex_hull(views.iter().flat_map(|v| v.pixels.clone()).collect());
    let mut fits: Vec<(String, Shape, Fit)> = vec![];
    for model in [Model::Brown, Model::KannalaBrandt] {
        let Some(first) = first_fit(model, width, height, views, &extent)? else { continue };
        let mut start = first;
        if model == Model::KannalaBrandt && !is_wide(&start.lens, width, height) {
            continue;
        }
        // One and two views cannot tell a principal point from a tilt.
        let ladder = shapes().into_iter().filter(|(_, s)| s.model == model);
        for (name, shape) in ladder.filter(|(_, s)| views.len() > 2 || s.moves.len() <= 2) {
            let Some(fit) = bundle::adjust(&shape, &extent, views, start.clone()) else { continue };
            start = fit.state.clone();
            fits.push((name.to_string(), shape, fit));
        }
    }

    // Every rung again with fx and fy apart; then the best few on a bowed board.
    let aspects = fits
        .iter()
        .filter(|(_, shape, _)| shape.moves.len() >= 4)
        .map(|(name, shape, fit)| {
            (format!("{name}, aspect"), with_aspect(shape), fit.state.clone())
        })
        .collect();
    fits.extend(adjust_all(aspects, &extent, views));
    let n = 2.0 * views.iter().map(|v| v.pixels.len()).sum::<usize>() as f64;
    let mut best: Vec<&(String, Shape, Fit)> =
        fits.iter().filter(|(_, shape, _)| shape.moves.len() >= 4).collect();
    best.sort_by(|a, b| bic(&a.1, &a.2, n).total_cmp(&bic(&b.1, &b.2, n)));
    let bows = best
        .iter()
        .take(BOWED_RUNGS)
        .map(|(name, shape, fit)| {
            let bowed = Shape { bow: true, ..shape.clone() };
            (format!("{name}, bow"), bowed, fit.state.clone())
        })
        .collect();
    fits.extend(adjust_all(bows, &extent, views));

    let mut rungs: Vec<Rung> = fits
        .into_iter()
        .filter_map(|(name, shape, fit)| judge(name, shape, fit, width, height, views, &hull))
        .collect();
    rungs.sort_by_key(|r| r.shape.n_free());
    Ok(rungs)
}

/// How many of the best rungs are tried on a bowed board.
const BOWED_RUNGS: usize = 4;

fn adjust_all(
    variants: Vec<(String, Shape, State)>,
    extent: &BoardExtent,
    views: &[View],
) -> Vec<(String, Shape, Fit)> {
    variants
        .into_par_iter()
        .filter_map(|(name, shape, start)| {
            let fit = bundle::adjust(&shape, extent, views, start)?;
            Some((name, shape, fit))
        })
        .collect()
}

/// Bayesian information criterion of a fit to `n` coordinates.
fn bic(shape: &Shape, fit: &Fit, n: f64) -> f64 {
    n * (fit.sum_squares() / n).max(SIGMA_FLOOR_PX.powi(2)).ln() + shape.n_free() as f64 * n.ln()
}

/// Covariances and criteria of a fit; `None` if the views do not determine it.
fn judge(
    name: String,
    shape: Shape,
    fit: Fit,
    width: usize,
    height: usize,
    views: &[View],
    hull: &[[f64; 2]],
) -> Option<Rung> {
    let n = 2.0 * views.iter().map(|v| v.pixels.len()).sum::<usize>() as f64;
    let spare = n - (shape.n_free() + 6 * views.len()) as f64;
    let lens = &fit.state.lens;
    // A model that folds before the corners it was fitted to explains nothing.
    let sees_its_corners = hull.iter().all(|&p| lens.unproject(p).is_some());
    if spare <= 0.0 || !sees_its_corners || lens.parameters.iter().any(|p| !p.is_finite()) {
        return None;
    }
    let sigma_px = (fit.sum_squares() / spare).sqrt().max(SIGMA_FLOOR_PX);
    let free = invert(&fit.information)? * (sigma_px * sigma_px);
    let m = lens.model.n_parameters();
    let spread = DMatrix::from_fn(m, shape.n_free(), |p, i| {
        if shape.moves.get(i).is_some_and(|together| together.contains(&p)) { 1.0 } else { 0.0 }
    });
    let covariance = &spread * &free * spread.transpose();
    let bow_sigma_m = shape.bow.then(|| {
        let g = shape.n_free();
        [free[(g - 2, g - 2)].sqrt(), free[(g - 1, g - 1)].sqrt()]
    });
    let projection = projection::sigma(lens, &covariance, width, height, hull)?;
    let bic = bic(&shape, &fit, n);
    let covers = lens.covers(width, height);
    Some(Rung {
        name,
        shape,
        fit,
        sigma_px,
        bic,
        covariance,
        bow_sigma_m,
        projection,
        covers,
        held_out: None,
    })
}

/// Inverse of an information matrix, scaled to a unit diagonal; `None` if a direction is undetermined.
fn invert(information: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    const CUT: f64 = 1e-13;
    let g = information.nrows();
    if (0..g).any(|i| !(information[(i, i)] > 0.0)) {
        return None;
    }
    let scale: Vec<f64> = (0..g).map(|i| information[(i, i)].sqrt().recip()).collect();
    let eigen = SymmetricEigen::new(DMatrix::from_fn(g, g, |i, j| {
        information[(i, j)] * scale[i] * scale[j]
    }));
    if eigen.eigenvalues.iter().any(|&v| !(v > CUT)) {
        return None;
    }
    let inner = DMatrix::from_diagonal(&eigen.eigenvalues.map(f64::recip));
    let inverse = &eigen.eigenvectors * inner * eigen.eigenvectors.transpose();
    Some(DMatrix::from_fn(g, g, |i, j| inverse[(i, j)] * scale[i] * scale[j]))
}

/// Fewest views with which folds still leave enough to fit.
const FEWEST_FOR_FOLDS: usize = 6;

/// Held-out error of each rung: fit on five sixths of the views, move only the pose of the rest.
pub(crate) fn cross_validate(rungs: &mut [Rung], views: &[View]) {
    const FOLDS: usize = 6;
    if views.len() < FEWEST_FOR_FOLDS {
        return;
    }
    let extent = BoardExtent::of(views);
    rungs.par_iter_mut().for_each(|rung| {
        let mut errors = vec![f64::NAN; views.len()];
        for fold in 0..FOLDS {
            let kept = |v: &usize| v % FOLDS != fold;
            let train: Vec<usize> = (0..views.len()).filter(kept).collect();
            let chosen: Vec<View> = train.iter().map(|&v| views[v].clone()).collect();
            let state = &rung.fit.state;
            let poses = train.iter().map(|&v| state.poses[v]).collect();
            let start = State { poses, ..state.clone() };
            let Some(fit) = bundle::adjust(&rung.shape, &extent, &chosen, start) else { return };
            let held = Shape { model: rung.shape.model, moves: vec![], bow: false };
            for v in (0..views.len()).filter(|v| !kept(v)) {
                let start = State { poses: vec![state.poses[v]], ..fit.state.clone() };
                let one = std::slice::from_ref(&views[v]);
                let Some(alone) = bundle::adjust(&held, &extent, one, start) else { return };
                errors[v] = alone.sum_squares() / views[v].pixels.len() as f64;
            }
        }
        rung.held_out = Some(errors);
    });
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Index of the smallest rung whose held-out error is within one standard error of the best.
fn one_standard_error(rungs: &[Rung]) -> Option<usize> {
    let errors = |i: usize| rungs[i].held_out.as_deref();
    let best = (0..rungs.len()).filter(|&i| errors(i).is_some()).min_by(|&a, &b| {
        mean(errors(a).unwrap_or(&[])).total_cmp(&mean(errors(b).unwrap_or(&[])))
    })?;
    let reference = errors(best)?;
    (0..rungs.len()).find(|&i| {
        errors(i).is_some_and(|e| {
            let gap: Vec<f64> = e.iter().zip(reference).map(|(a, b)| a - b).collect();
            let n = gap.len() as f64;
            let centre = mean(&gap);
            let variance = gap.iter().map(|g| (g - centre).powi(2)).sum::<f64>() / (n - 1.0);
            centre <= (variance / n).sqrt()
        })
    })
}

/// What the rule decided.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Choice {
    pub index: usize,
    /// The rung cross-validation named, if it is another and differs by more than a fifth of a pixel.
    pub disagrees: Option<(usize, f64)>,
    /// Rungs that fit better but are less certain than `most_sigma_px`.
    pub dropped: bool,
}

/// Picks a rung; `None` if none is certain to `most_sigma_px`.
pub(crate) fn choose(
    rungs: &[Rung],
    width: usize,
    height: usize,
    most_sigma_px: f64,
) -> Option<Choice> {
    const AGREE_PX: f64 = 0.2;
    const NEARLY: f64 = 1.2;
    // A model that folds inside the frame stands only if none that covers it fits nearly as well.
    let certain_enough = |r: &Rung| r.projection.is_within(most_sigma_px);
    let usable = |r: &Rung| {
        let instead = |o: &Rung| o.covers && certain_enough(o) && o.sigma_px < NEARLY * r.sigma_px;
        r.covers || !rungs.iter().any(instead)
    };
    let lowest = |keep: &dyn Fn(&Rung) -> bool| {
        (0..rungs.len())
            .filter(|&i| usable(&rungs[i]) && keep(&rungs[i]))
            .min_by(|&a, &b| rungs[a].bic.total_cmp(&rungs[b].bic))
    };
    let free = lowest(&|_| true)?;
    let certain = lowest(&certain_enough)?;
    let dropped = certain != free;
    if dropped {
        return Some(Choice { index: certain, disagrees: None, dropped });
    }
    let by_bic = prefer_fisheye(rungs, certain);
    let Some(by_folds) = one_standard_error(rungs).filter(|&i| i != by_bic) else {
        return Some(Choice { index: by_bic, disagrees: None, dropped });
    };
    let (a, b) = (&rungs[by_bic], &rungs[by_folds]);
    let apart = projection::difference(&a.fit.state.lens, &b.fit.state.lens, width, height)
        .unwrap_or(f64::INFINITY);
    if apart < AGREE_PX {
        return Some(Choice { index: by_bic, disagrees: None, dropped });
    }
    let smaller = if b.projection.mean_px < a.projection.mean_px { by_folds } else { by_bic };
    let other = if smaller == by_bic { by_folds } else { by_bic };
    Some(Choice { index: smaller, disagrees: Some((other, apart)), dropped })
}

/// Above 100° a polynomial in tan θ extrapolates wildly: at equal residuals take Kannala–Brandt.
fn prefer_fisheye(rungs: &[Rung], best: usize) -> usize {
    const WIDE_COS: f64 = 0.642_787_6;
    const EQUAL: f64 = 1.05;
    let lens = &rungs[best].fit.state.lens;
    let edge = rungs[best].fit.state.lens.parameters[3];
    // Half the field along the row of the principal point, from either edge.
    let wide = [[0.0, edge], [2.0 * lens.parameters[2], edge]]
        .iter()
        .all(|&p| lens.unproject(p).is_none_or(|d| d[2] < WIDE_COS));
    if !wide || lens.model == Model::KannalaBrandt {
        return best;
    }
    (0..rungs.len())
        .filter(|&i| {
            rungs[i].shape.model == Model::KannalaBrandt
                && rungs[i].sigma_px < EQUAL * rungs[best].sigma_px
        })
        .min_by(|&a, &b| rungs[a].bic.total_cmp(&rungs[b].bic))
        .unwrap_or(best)
}
