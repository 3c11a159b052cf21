//! Photographs of a probe → panorama, the same way for every caller: commands, shots, programs.

use glam::{DMat3, DQuat};

use super::ProbeError;
use super::ball::Ball;
use super::fill;
use super::find::BallImage;
use super::fisheye::Fisheye;
use super::mapping::Mapping;
use super::panorama::Panorama;
use super::resample::to_lat_long;
use super::unwrap::{Support, check_width, natural_width, unwrap_ball};
use crate::bracket::Radiance;
use crate::camera::Camera;
use crate::photo::Image;

/// The panorama that photographs of a mirror ball show, once it is found in them.
///
/// `support` is what the ball stands on or over, if that is known; `width` is the natural one where
/// `None` is given.
///
/// # Errors
/// A width that no panorama has.
pub fn ball(
    radiance: &Radiance,
    camera: &Camera,
    found: &BallImage,
    ball: &Ball,
    support: Option<&Support>,
    width: Option<usize>,
) -> Result<Panorama, ProbeError> {
    let width = width.unwrap_or_else(|| natural_width(found.radius_px));
    unwrap_ball(radiance, camera, &found.rim, ball, support, width)
}

/// The panorama that photographs through a fisheye show; `world_from_lens` turns its axes (−Z in the
/// middle of the picture, +Y up) to the world's.
///
/// Directions that it does not show are filled from around them and are
/// [`Validity::Filled`](crate::bracket::Validity::Filled).
///
/// # Errors
/// A width that no panorama has.
pub fn fisheye(
    radiance: &Radiance,
    fisheye: &Fisheye,
    world_from_lens: DQuat,
    width: Option<usize>,
) -> Result<Panorama, ProbeError> {
    let width = width.unwrap_or_else(|| natural_width(fisheye.radius_px()));
    through(radiance, fisheye, world_from_lens, width)
}

/// The panorama of what any picture of directions shows; `world_from_picture` turns its axes to the world's.
///
/// What it does not show is filled from around it, as for a fisheye.
///
/// # Errors
/// A width that no panorama has.
pub fn through<M: Mapping + ?Sized>(
    radiance: &Radiance,
    mapping: &M,
    world_from_picture: DQuat,
    width: usize,
) -> Result<Panorama, ProbeError> {
    check_width(width)?;
    let picture_from_world = DMat3::from_quat(world_from_picture.inverse());
    let mut panorama = to_lat_long(radiance, mapping, picture_from_world, width);
    let gap = Image::from_fn(width, width / 2, |x, y| panorama.coverage[(x, y)] < 0.5);
    fill::from_around(&mut panorama, &gap);
    Ok(panorama)
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::bracket::Validity;
    use crate::conventions::Rgb;
    use crate::probe::fisheye::Projection;

    #[test]
    fn what_a_fisheye_does_not_see_is_filled_and_says_so() {
        let constant = Rgb::new(0.5, 1.0, 2.0);
        let radiance = Radiance {
            mean: Image::filled(200, 200, constant),
            variance: Image::filled(200, 200, Rgb::ZERO),
            validity: Image::filled(200, 200, Validity::Measured),
        };
        let lens = Fisheye::new(Projection::Equidistant, 180.0, None, [200, 200]).unwrap();
        for turn in [DQuat::IDENTITY, DQuat::from_rotation_x(1.0)] {
            let panorama = fisheye(&radiance, &lens, turn, Some(128)).unwrap();
            let off = panorama.radiance.pixels().iter().map(|l| (*l - constant).length());
            assert!(off.fold(0.0, f32::max) < 1e-5, "constant light is constant all round");
            let filled = panorama.share(Validity::Filled);
            assert!((filled - 0.5).abs() < 0.02, "half is not seen: {filled}");
            // What looks ahead is seen, what lies behind is not.
            for y in 0..64 {
                for x in 0..128 {
                    let ahead = panorama.direction(x, y).dot(turn * DVec3::NEG_Z);
                    let seen = panorama.validity[(x, y)] == Validity::Measured;
                    assert!(ahead.abs() < 0.05 || seen == (ahead > 0.0), "({x}, {y})");
                }
            }
        }
    }
}
