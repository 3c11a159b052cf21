//! How a flat print lies in the world: its axes and corners.
//!
//! centre, facing, up → right and up of the print as one sees it from its front.

use glam::DVec3;

/// The corners of a rectangle lying on a plane: upper left, upper right, lower right, lower left.
///
/// `at` is its centre (m), `facing` where its front looks, `up` its upward direction, both in the
/// world; `up` need not be exactly across `facing`. `None` if they are parallel or zero.
pub fn rectangle_corners(
    at: DVec3,
    facing: DVec3,
    up: DVec3,
    width_m: f64,
    height_m: f64,
) -> Option<[DVec3; 4]> {
    let (right, up) = target_axes(facing, up)?;
    let (x, y) = (right * (width_m * 0.5), up * (height_m * 0.5));
    Some([at - x + y, at + x + y, at + x - y, at - x - y])
}

/// Unit right and up of a target seen from its front.
///
/// `None` if `facing` and `up` are parallel, zero or not finite.
pub fn target_axes(facing: DVec3, up: DVec3) -> Option<(DVec3, DVec3)> {
    let facing = facing.try_normalize()?;
    let right = up.try_normalize()?.cross(facing);
    if right.length() < 1e-3 {
        return None;
    }
    let right = right.normalize();
    Some((right, facing.cross(right)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_print_on_the_floor_is_read_from_above() {
        let (facing, up) = (DVec3::Y, DVec3::NEG_Z);
        assert_eq!(target_axes(facing, up), Some((DVec3::X, DVec3::NEG_Z)));
        let corners = rectangle_corners(DVec3::Y, facing, up, 0.4, 0.2).unwrap();
        assert_eq!(corners[0], DVec3::new(-0.2, 1.0, -0.1), "upper left");
        assert_eq!(corners[2], DVec3::new(0.2, 1.0, 0.1), "lower right");
    }

    #[test]
    fn up_along_facing_or_of_no_length_is_refused() {
        assert_eq!(target_axes(DVec3::Y, DVec3::Y), None);
        assert_eq!(target_axes(DVec3::Y, DVec3::ZERO), None);
        assert_eq!(target_axes(DVec3::Y, DVec3::new(f64::NAN, 0.0, 0.0)), None);
    }
}
