//! Where the fit of a planar pose begins: homography → both rotations that explain it → poses.
//!
//! The two solutions of Collins & Bartoli, IJCV 109(3), 2014. Linear algebra only, through the undistorted
//! picture; [`planar_pose`](super::planar_pose) refines and judges them.

use glam::{DMat2, DMat3, DVec2, DVec3};
use nalgebra::{SMatrix, SymmetricEigen};

use super::planar_pose::{PoseError, Sighting};
use super::{Lens, Pose};
use crate::conventions::OPENCV_FROM_CAMERA;

/// The plane of the points: origin at their mean, two axes in it.
pub(super) struct Plane {
    pub origin: DVec3,
    /// Two in the plane, and its normal.
    pub axes: DMat3,
    /// Root mean square distance of the points from the origin, m.
    size: f64,
}

impl Plane {
    pub fn through(sightings: &[Sighting]) -> Result<Self, PoseError> {
        let n = sightings.len();
        if n < 4 {
            return Err(PoseError::TooFew(n));
        }
        if sightings.iter().any(|s| !s.world.is_finite() || !s.pixel.is_finite()) {
            return Err(PoseError::Degenerate);
        }
        let origin = sightings.iter().map(|s| s.world).sum::<DVec3>() / n as f64;
        let mut spread = SMatrix::<f64, 3, 3>::zeros();
        for s in sightings {
            let d = nalgebra::Vector3::from((s.world - origin).to_array());
            spread += d * d.transpose();
        }
        let eigen = SymmetricEigen::new(spread);
        let mut order = [0, 1, 2];
        order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
        let axis = |k: usize| {
            let v = eigen.eigenvectors.column(order[k]);
            DVec3::new(v[0], v[1], v[2])
        };
        let length = |k: usize| (eigen.eigenvalues[order[k]].max(0.0) / n as f64).sqrt();
        if length(1) <= 1e-6 * length(0) || length(0) == 0.0 {
            return Err(PoseError::Degenerate);
        }
        let normal = axis(0).cross(axis(1)).normalize();
        let off = |s: &Sighting| (s.world - origin).dot(normal).abs();
        let off_m = sightings.iter().map(off).fold(0.0, f64::max);
        if off_m > 1e-3 * length(0) {
            return Err(PoseError::NotPlanar { off_m });
        }
        Ok(Self { origin, axes: DMat3::from_cols(axis(0), axis(1), normal), size: length(0) })
    }

    /// In-plane coordinates in units of [`size`](Self::size).
    fn flat(&self, world: DVec3) -> DVec2 {
        let p = self.axes.transpose() * (world - self.origin) / self.size;
        DVec2::new(p.x, p.y)
    }
}

/// Undistorted pixel on OpenCV's plane z = 1.
fn undistorted(lens: &Lens, index: usize, pixel: DVec2) -> Result<DVec2, PoseError> {
    let outside = PoseError::OutsideLens { index, x: pixel.x, y: pixel.y };
    let d = OPENCV_FROM_CAMERA * lens.unproject(pixel).ok_or(outside.clone())?;
    if d.z < 1e-3 { Err(outside) } else { Ok(DVec2::new(d.x, d.y) / d.z) }
}

/// Takes in-plane coordinates to the undistorted picture: direct linear transform.
pub(super) fn homography(
    lens: &Lens,
    sightings: &[Sighting],
    plane: &Plane,
) -> Result<DMat3, PoseError> {
    let seen = sightings
        .iter()
        .enumerate()
        .map(|(i, s)| undistorted(lens, i, s.pixel))
        .collect::<Result<Vec<_>, _>>()?;
    let n = seen.len() as f64;
    let mean = seen.iter().sum::<DVec2>() / n;
    let spread = (seen.iter().map(|p| (*p - mean).length_squared()).sum::<f64>() / n).sqrt();
    if !(spread > 0.0) {
        return Err(PoseError::Degenerate);
    }
    let mut normal = SMatrix::<f64, 9, 9>::zeros();
    for (sighting, &at) in sightings.iter().zip(&seen) {
        let p = plane.flat(sighting.world);
        let q = (at - mean) / spread;
        let rows = [
            [p.x, p.y, 1.0, 0.0, 0.0, 0.0, -q.x * p.x, -q.x * p.y, -q.x],
            [0.0, 0.0, 0.0, p.x, p.y, 1.0, -q.y * p.x, -q.y * p.y, -q.y],
        ];
        for row in rows {
            let row = SMatrix::<f64, 9, 1>::from(row);
            normal += row * row.transpose();
        }
    }
    let eigen = SymmetricEigen::new(normal);
    let h = eigen.eigenvectors.column(eigen.eigenvalues.imin());
    let rows = DMat3::from_cols_array(&std::array::from_fn(|i| h[(i % 3) * 3 + i / 3]));
    let back = DMat3::from_cols(
        DVec3::new(spread, 0.0, 0.0),
        DVec3::new(0.0, spread, 0.0),
        DVec3::new(mean.x, mean.y, 1.0),
    );
    let h = back * rows;
    let scale = h.z_axis.z;
    if scale == 0.0 || !h.is_finite() { Err(PoseError::Degenerate) } else { Ok(h * scale.recip()) }
}

/// Both rotations (plane axes to OpenCV's camera) that explain the homography near its origin.
///
/// Collins & Bartoli 2014, section 3: the homography's first derivative fixes the plane's tilt up to
/// a reflection about the line of sight.
pub(super) fn planar_starts(h: &DMat3) -> Vec<DMat3> {
    let at = DVec2::new(h.z_axis.x, h.z_axis.y);
    let jacobian = DMat2::from_cols(
        DVec2::new(h.x_axis.x, h.x_axis.y) - at * h.x_axis.z,
        DVec2::new(h.y_axis.x, h.y_axis.y) - at * h.y_axis.z,
    );
    let to_sight = rotation_to(at.extend(1.0).normalize());
    // [I | −at]·R restricted to the plane across the line of sight.
    let across = |column: DVec3| DVec2::new(column.x, column.y) - at * column.z;
    let b = DMat2::from_cols(across(to_sight.x_axis), across(to_sight.y_axis));
    let a = b.inverse() * jacobian;
    let squares = a.x_axis.length_squared() + a.y_axis.length_squared();
    let inner = (squares * squares - 4.0 * a.determinant().powi(2)).max(0.0).sqrt();
    let scale = (0.5 * (squares + inner)).sqrt();
    if !(scale > 0.0) || !scale.is_finite() {
        return vec![];
    }
    let (x, y) = (a.x_axis / scale, a.y_axis / scale);
    let depth_x = (1.0 - x.length_squared()).max(0.0).sqrt();
    let depth_y = (1.0 - y.length_squared()).max(0.0).sqrt();
    let depth_y = if x.dot(y) > 0.0 { -depth_y } else { depth_y };
    [1.0, -1.0]
        .iter()
        .map(|sign| {
            let first = x.extend(sign * depth_x);
            let second = y.extend(sign * depth_y);
            to_sight * DMat3::from_cols(first, second, first.cross(second))
        })
        .collect()
}

/// The shortest rotation that takes +Z to `direction` (unit, z > 0).
fn rotation_to(direction: DVec3) -> DMat3 {
    DMat3::from_quat(glam::DQuat::from_rotation_arc(DVec3::Z, direction))
}

/// The pose with this rotation whose translation fits best (linear least squares).
pub(super) fn start(
    lens: &Lens,
    sightings: &[Sighting],
    plane: &Plane,
    rotation: DMat3,
) -> Option<Pose> {
    let mut normal = SMatrix::<f64, 3, 3>::zeros();
    let mut right = SMatrix::<f64, 3, 1>::zeros();
    for (i, s) in sightings.iter().enumerate() {
        let q = undistorted(lens, i, s.pixel).ok()?;
        let p = rotation * plane.flat(s.world).extend(0.0);
        for (row, wanted) in
            [([1.0, 0.0, -q.x], q.x * p.z - p.x), ([0.0, 1.0, -q.y], q.y * p.z - p.y)]
        {
            let row = SMatrix::<f64, 3, 1>::from(row);
            normal += row * row.transpose();
            right += row * wanted;
        }
    }
    let t = normal.cholesky()?.solve(&right) * plane.size;
    let world_rotation = rotation * plane.axes.transpose();
    let translation = DVec3::new(t[0], t[1], t[2]) - world_rotation * plane.origin;
    let rows = world_rotation.transpose().to_cols_array_2d();
    Some(Pose::from_opencv(rows, translation.to_array()))
}
