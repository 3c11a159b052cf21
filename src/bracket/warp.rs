//! How one frame of a bracket lies on another: not at all, shifted, affine, or by a homography.

use glam::{DMat3, DVec2, DVec3};
use nalgebra::{DMatrix, DVector};

/// Takes a pixel of the bracket's grid to a pixel of a frame, homogeneously.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Warp(DMat3);

/// The kinds of [`Warp`], by rising number of parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum WarpKind {
    None,
    Shift,
    Affine,
    Homography,
}

impl std::fmt::Display for WarpKind {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.write_str(match self {
            Self::None => "nothing",
            Self::Shift => "a shift",
            Self::Affine => "an affine map",
            Self::Homography => "a homography",
        })
    }
}

/// A place of the grid and where the frame has it, px.
pub(super) type Match = (DVec2, DVec2);

impl Warp {
    pub const IDENTITY: Self = Self(DMat3::IDENTITY);

    pub fn shift(by: DVec2) -> Self {
        Self(DMat3::from_translation(by))
    }

    pub fn is_identity(&self) -> bool {
        *self == Self::IDENTITY
    }

    /// Where the frame has pixel `p` of the grid; far outside every frame if nowhere.
    #[inline]
    pub fn apply(&self, p: DVec2) -> DVec2 {
        let h = self.0 * DVec3::new(p.x, p.y, 1.0);
        if h.z > 1e-6 { DVec2::new(h.x / h.z, h.y / h.z) } else { DVec2::splat(-1e9) }
    }

    /// First `first`, then this.
    pub fn after(&self, first: &Self) -> Self {
        Self(self.0 * first.0)
    }

    /// Largest way that a corner of a `width` × `height` frame is moved, px.
    pub fn reach_px(&self, width: usize, height: usize) -> f64 {
        let (w, h) = (width as f64 - 1.0, height as f64 - 1.0);
        [(0.0, 0.0), (w, 0.0), (0.0, h), (w, h)]
            .map(|(x, y)| {
                let corner = DVec2::new(x, y);
                self.apply(corner).distance(corner)
            })
            .into_iter()
            .fold(0.0, f64::max)
    }

    /// The warp of a kind that fits `matches` best in least squares; `None` if they do not determine it.
    ///
    /// The homography minimises the algebraic error in coordinates scaled by `size` (the frame's larger
    /// side), where it is nearly the geometric one for the slight warps of a bracket.
    pub(super) fn fit(kind: WarpKind, matches: &[Match], size: f64) -> Option<Self> {
        let scaled = |p: DVec2| p / size - 0.5;
        let n = matches.len();
        let unknowns = match kind {
            WarpKind::None => return Some(Self::IDENTITY),
            WarpKind::Shift => {
                let sum: DVec2 = matches.iter().map(|(from, to)| to - from).sum();
                return (n > 0).then(|| Self::shift(sum / n as f64));
            }
            WarpKind::Affine => 6,
            WarpKind::Homography => 8,
        };
        if 2 * n < unknowns {
            return None;
        }
        let mut a = DMatrix::<f64>::zeros(2 * n, unknowns);
        let mut b = DVector::<f64>::zeros(2 * n);
        for (k, &(from, to)) in matches.iter().enumerate() {
            let (p, q) = (scaled(from), scaled(to));
            for (row, along) in [q.x, q.y].into_iter().enumerate() {
                let at = 2 * k + row;
                for (column, value) in [p.x, p.y, 1.0].into_iter().enumerate() {
                    a[(at, 3 * row + column)] = value;
                }
                if kind == WarpKind::Homography {
                    a[(at, 6)] = -along * p.x;
                    a[(at, 7)] = -along * p.y;
                }
                b[at] = along;
            }
        }
        let found = a.svd(true, true).solve(&b, 1e-9).ok()?;
        let at = |i: usize| if i < unknowns { found[i] } else { 0.0 };
        let rows = DMat3::from_cols(
            DVec3::new(at(0), at(3), at(6)),
            DVec3::new(at(1), at(4), at(7)),
            DVec3::new(at(2), at(5), 1.0),
        );
        // Into the scaled coordinates and out again.
        let into = DMat3::from_translation(DVec2::splat(-0.5))
            * DMat3::from_scale(DVec2::splat(1.0 / size));
        let warp = Self(into.inverse() * rows * into);
        warp.0.is_finite().then_some(warp)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid() -> impl Iterator<Item = DVec2> {
        (0..16)
            .map(|k| DVec2::new(100.0 + 150.0 * f64::from(k % 4), 80.0 + 120.0 * f64::from(k / 4)))
    }

    #[test]
    fn every_kind_is_found_from_its_own_matches() {
        let turn = DMat3::from_angle(0.005);
        let tilt = DMat3::from_cols(
            DVec3::new(1.01, 0.003, 2e-6),
            DVec3::new(-0.004, 0.995, -3e-6),
            DVec3::new(4.0, -2.0, 1.0),
        );
        for (kind, matrix) in [
            (WarpKind::Shift, DMat3::from_translation(DVec2::new(3.5, -1.25))),
            (WarpKind::Affine, turn),
            (WarpKind::Homography, tilt),
        ] {
            let truth = Warp(matrix);
            let matches: Vec<Match> = grid().map(|p| (p, truth.apply(p))).collect();
            let found = Warp::fit(kind, &matches, 800.0).unwrap();
            for p in grid() {
                assert!(found.apply(p).distance(truth.apply(p)) < 1e-6, "{kind:?}");
            }
        }
    }

    #[test]
    fn too_few_matches_determine_nothing() {
        let matches: Vec<Match> = grid().take(3).map(|p| (p, p)).collect();
        assert!(Warp::fit(WarpKind::Homography, &matches, 800.0).is_none());
        assert!(Warp::fit(WarpKind::Affine, &matches[..2], 800.0).is_none());
        assert!(Warp::fit(WarpKind::Shift, &[], 800.0).is_none());
    }

    #[test]
    fn warps_follow_one_another() {
        let (a, b) = (Warp::shift(DVec2::new(1.0, 2.0)), Warp(DMat3::from_angle(0.1)));
        let p = DVec2::new(30.0, 40.0);
        assert!(b.after(&a).apply(p).distance(b.apply(a.apply(p))) < 1e-9);
        assert!((a.reach_px(100, 50) - 5f64.sqrt()).abs() < 1e-9);
    }
}
