//! Registering: the rotation that takes one set of axes to another.
//!
//! Matched directions ([`matches`]), two panoramas of one place ([`content`]), or a sun and the
//! vertical ([`by_sun`]) → [`Registration`]. Places are not fitted: what stands near is seen in other
//! directions from another place, and counts as an outlier here (F32). Left and right are never
//! guessed: a mirrored map puts every light on the wrong side, and nothing later can tell (F26).

pub mod content;
pub mod matches;
mod pyramid;
mod turns;

use glam::{DMat3, DQuat, DVec3};

pub use self::content::{Content, by_content};
pub use self::matches::{Handedness, Match, Matched, from_matches};

/// How one set of axes lies in another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Registration {
    /// Takes directions of the one's axes to the other's.
    pub rotation: DQuat,
    /// Covariance of the small rotation vector left over, in the other's axes, rad².
    pub covariance: DMat3,
}

impl Registration {
    /// Axes that are the same by agreement.
    pub fn none() -> Self {
        Self { rotation: DQuat::IDENTITY, covariance: DMat3::ZERO }
    }

    /// Standard error of the rotation's angle, radians: all three axes together.
    pub fn sigma_rad(&self) -> f64 {
        let [x, y, z] =
            [self.covariance.x_axis.x, self.covariance.y_axis.y, self.covariance.z_axis.z];
        (x + y + z).max(0.0).sqrt()
    }
}

/// Why no rotation can be told.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RegisterError {
    #[error("matches are given: {found}, needed: {needed}; give more")]
    Few { found: usize, needed: usize },
    #[error(
        "the matches do not fit one rotation: {agree} of {all} agree within {within_deg:.0}°, the rest is up to \
         {worst_deg:.0}° off; look at each match again"
    )]
    Disagree { agree: usize, all: usize, within_deg: f64, worst_deg: f64 },
    #[error(
        "cannot tell left from right: a mirrored panorama would fit {ratio:.1} times as badly, 3 times is needed; \
         give one more match, away from the plane of the others, or the sun's time"
    )]
    Handedness { ratio: f64 },
    #[error(
        "the panoramas fit mirrored, not as they are: one of them was flipped left to right before; \
         flip it back"
    )]
    Mirrored,
    #[error(
        "all matches lie along one line: the turn about it is not known; give one to the side of it"
    )]
    OneLine,
    #[error(
        "the panoramas see only {share_deg2:.0} square degrees in common, {needed_deg2:.0} are needed; register \
         them by matched directions"
    )]
    Overlap { share_deg2: f64, needed_deg2: f64 },
    #[error(
        "the panoramas do not show which way they belong together ({reason}); give three or more matched directions"
    )]
    Undecided { reason: String },
}

/// The rotation about `up` that brings the panorama's sun to where the sun stood.
///
/// `sun` is where the panorama shows it, `sun_direction_world` where it was by place and time; both
/// axes share the vertical `up` (unit). `sigma_rad` is the standard error of `sun` each way. The error
/// of the turn is σ/cos(elevation) (C6d): a sun near the zenith tells no azimuth and is refused.
///
/// # Errors
/// A sun within 5° of the vertical, or two elevations further apart than 3° and 5 σ.
pub fn by_sun(
    sun: DVec3,
    sun_direction_world: DVec3,
    up: DVec3,
    sigma_rad: f64,
) -> Result<Registration, RegisterError> {
    let level = |d: DVec3| d - d.dot(up) * up;
    let elevation = |d: DVec3| d.dot(up).atan2(level(d).length());
    let (there, wanted) = (level(sun), level(sun_direction_world));
    let least = 5f64.to_radians().sin();
    if there.length() < least * sun.length()
        || wanted.length() < least * sun_direction_world.length()
    {
        return Err(RegisterError::OneLine);
    }
    let apart = (elevation(sun) - elevation(sun_direction_world)).abs();
    if apart > 3f64.to_radians().max(5.0 * sigma_rad) {
        let reason = format!(
            "the panorama's sun stands {:.1}° from the elevation that place and time give",
            apart.to_degrees()
        );
        return Err(RegisterError::Undecided { reason });
    }
    let angle = up.dot(there.cross(wanted)).atan2(there.dot(wanted));
    let across = sigma_rad / elevation(sun_direction_world).cos();
    let along = DMat3::from_cols(up * up.x, up * up.y, up * up.z);
    Ok(Registration {
        rotation: DQuat::from_axis_angle(up, angle),
        covariance: along * (across * across),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn from_angles(azimuth_deg: f64, elevation_deg: f64) -> DVec3 {
        let (a, e) = (azimuth_deg.to_radians(), elevation_deg.to_radians());
        DVec3::new(a.sin() * e.cos(), e.sin(), a.cos() * e.cos())
    }

    #[test]
    fn a_sun_and_the_vertical_give_the_turn() {
        let found =
            by_sun(from_angles(20.0, 41.0), from_angles(155.0, 40.0), DVec3::Y, 0.01).unwrap();
        let turned = found.rotation * from_angles(20.0, 41.0);
        assert!(turned.angle_between(from_angles(155.0, 41.0)) < 1e-9);
        assert!((found.rotation * DVec3::Y - DVec3::Y).length() < 1e-12);
        // σ/cos 40°
        assert!((found.sigma_rad() - 0.01 / 40f64.to_radians().cos()).abs() < 1e-12);
    }

    #[test]
    fn a_sun_overhead_or_at_another_height_is_refused() {
        let overhead = by_sun(from_angles(0.0, 88.0), from_angles(90.0, 88.0), DVec3::Y, 0.01);
        assert_eq!(overhead.unwrap_err(), RegisterError::OneLine);
        let other = by_sun(from_angles(0.0, 30.0), from_angles(90.0, 40.0), DVec3::Y, 0.01);
        assert!(other.unwrap_err().to_string().contains("10.0°"));
    }
}
