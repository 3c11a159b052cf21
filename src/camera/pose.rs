//! Where a camera stands, and how well that is known.

use glam::{DAffine3, DMat3, DQuat, DVec3};

use crate::conventions::OPENCV_FROM_CAMERA;

/// Where a camera stands: rigid, camera axes (−Z forward, +Y up) to world.
#[derive(Clone, Debug, PartialEq)]
pub struct Pose {
    pub world_from_camera: DAffine3,
    /// Covariance of (rotation vector in camera axes, rad; camera position in world, m), row-major.
    ///
    /// The true rotation is `R · exp([ω]×)` with ω drawn from the first three.
    /// `None` when nobody measured it.
    pub covariance: Option<[[f64; 6]; 6]>,
}

impl Pose {
    /// At the origin, looking along −Z with +Y up.
    pub fn identity() -> Self {
        Self { world_from_camera: DAffine3::IDENTITY, covariance: None }
    }

    /// At `eye`, looking at `target`, with `up` upward in the picture.
    ///
    /// `None` where `eye` is at `target` or `up` lies along the view.
    pub fn look_at(eye: DVec3, target: DVec3, up: DVec3) -> Option<Self> {
        let back = (eye - target).try_normalize()?;
        let right = up.cross(back).try_normalize()?;
        let rotation = DMat3::from_cols(right, back.cross(right), back);
        Some(Self::from_rotation(rotation, eye))
    }

    /// From a rotation (camera axes to world) and the camera's position in the world.
    pub fn from_rotation(world_from_camera: DMat3, position: DVec3) -> Self {
        let world_from_camera = DAffine3 { matrix3: world_from_camera, translation: position };
        Self { world_from_camera, covariance: None }
    }

    /// From OpenCV's world → camera: `X_cv = R·X_world + t`, rows of `rotation` first.
    pub fn from_opencv(rotation: [[f64; 3]; 3], translation: [f64; 3]) -> Self {
        let camera_from_world =
            OPENCV_FROM_CAMERA * DMat3::from_cols_array_2d(&rotation).transpose();
        let world_from_camera = camera_from_world.transpose();
        let position = -(world_from_camera * (OPENCV_FROM_CAMERA * DVec3::from(translation)));
        Self::from_rotation(world_from_camera, position)
    }

    /// OpenCV's world → camera: rows of R, and t.
    pub fn to_opencv(&self) -> ([[f64; 3]; 3], [f64; 3]) {
        let inverse = self.inverse();
        let rotation = (OPENCV_FROM_CAMERA * inverse.matrix3).transpose();
        (rotation.to_cols_array_2d(), (OPENCV_FROM_CAMERA * inverse.translation).to_array())
    }

    /// World → camera axes.
    pub fn inverse(&self) -> DAffine3 {
        let rotation = self.world_from_camera.matrix3.transpose();
        DAffine3 { matrix3: rotation, translation: -(rotation * self.position()) }
    }

    /// The camera's position in the world, m.
    pub fn position(&self) -> DVec3 {
        self.world_from_camera.translation
    }

    /// Camera axes to world.
    pub fn rotation(&self) -> DMat3 {
        self.world_from_camera.matrix3
    }

    /// Standard deviation of the rotation about camera x, y, z (rad) and of the position (m).
    pub fn sigmas(&self) -> Option<(DVec3, DVec3)> {
        let c = self.covariance.as_ref()?;
        let sigma = |i: usize| c[i][i].max(0.0).sqrt();
        Some((DVec3::new(sigma(0), sigma(1), sigma(2)), DVec3::new(sigma(3), sigma(4), sigma(5))))
    }

    /// The same pose with the rotation turned by ω (camera axes, rad) and the position moved.
    pub fn nudged(&self, omega: DVec3, shift: DVec3) -> Self {
        let turned = self.rotation() * DMat3::from_quat(DQuat::from_scaled_axis(omega));
        let pose = Self::from_rotation(turned, self.position() + shift);
        Self { covariance: self.covariance, ..pose }
    }

    /// What takes this pose to `other`: rotation vector (this camera's axes, rad) and shift (m).
    pub fn difference(&self, other: &Self) -> (DVec3, DVec3) {
        let turn = DQuat::from_mat3(&(self.rotation().transpose() * other.rotation()));
        let shift = other.position() - self.position();
        (if turn.w < 0.0 { -turn } else { turn }.to_scaled_axis(), shift)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn look_at_puts_the_target_ahead_and_up_upward() {
        let pose = Pose::look_at(DVec3::new(1.0, 2.0, 3.0), DVec3::ZERO, DVec3::Y).unwrap();
        let target = pose.inverse().transform_point3(DVec3::ZERO);
        assert!(target.x.abs() < 1e-12 && target.y.abs() < 1e-12 && target.z < 0.0);
        assert!(pose.inverse().transform_vector3(DVec3::Y).y > 0.0);
        assert!(Pose::look_at(DVec3::ZERO, DVec3::ZERO, DVec3::Y).is_none());
        assert!(Pose::look_at(DVec3::ZERO, DVec3::Y, DVec3::Y).is_none());
    }

    #[test]
    fn opencv_round_trip() {
        let pose = Pose::look_at(DVec3::new(1.0, 2.0, 3.0), DVec3::X, DVec3::Y).unwrap();
        let (r, t) = pose.to_opencv();
        // OpenCV sees the target ahead along +Z.
        let row = |i: usize| DVec3::from(r[i]).dot(DVec3::X) + t[i];
        assert!(row(0).abs() < 1e-12 && row(1).abs() < 1e-12 && row(2) > 0.0);
        let back = Pose::from_opencv(r, t);
        let (turn, shift) = pose.difference(&back);
        assert!(turn.length() < 1e-12 && shift.length() < 1e-12);
    }

    #[test]
    fn nudge_and_difference_are_inverse() {
        let pose = Pose::look_at(DVec3::new(1.0, 2.0, 3.0), DVec3::X, DVec3::Y).unwrap();
        let (omega, shift) = (DVec3::new(0.01, -0.02, 0.03), DVec3::new(0.1, 0.2, -0.3));
        let (turn, moved) = pose.difference(&pose.nudged(omega, shift));
        assert!((turn - omega).length() < 1e-12 && (moved - shift).length() < 1e-12);
    }
}
