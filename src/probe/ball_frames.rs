//! The frames of a bracket laid on one another by the ball that each of them shows.
//!
//! Photographs that were cut out by hand share no frame, and where the camera moved between them the
//! background moves otherwise than the ball before it. What must coincide is the ball: each frame is cut
//! round it by whole pixels, its own samples kept; what is left (less than a pixel, a slight turn) is for the
//! alignment by content, which then sees the ball and little else.

use glam::DVec2;

use super::find::BallImage;
use crate::photo::Encoded;

/// How far round the ball the cut-outs reach, in radii and px beyond.
const REACH: f64 = 1.3;
const MARGIN_PX: f64 = 8.0;

/// Cut-outs of one size with the ball in one place.
#[derive(Clone, Debug)]
pub struct LaidByBall {
    pub photos: Vec<Encoded>,
    /// The frame whose pixels the cut-outs keep: the one whose ball is known best.
    pub reference: usize,
    /// The pixel of the reference frame that is the cut-outs' first.
    pub first: (i64, i64),
}

/// Cuts every frame round its ball.
///
/// Where a cut-out reaches beyond its own frame, but not beyond all of them, it holds nothing. `None` without
/// as many balls as photographs.
pub fn lay_by_ball(photos: &[Encoded], balls: &[BallImage]) -> Option<LaidByBall> {
    let best = balls.iter().enumerate().min_by(|a, b| a.1.sigma_px.total_cmp(&b.1.sigma_px));
    let (reference, _) = best.filter(|_| balls.len() == photos.len())?;
    let radius = balls.iter().map(|ball| ball.radius_px).fold(0.0, f64::max);
    let reach = DVec2::splat((REACH * radius + MARGIN_PX).ceil());
    let middles: Vec<DVec2> = balls.iter().map(|ball| ball.centre_px.round()).collect();
    // Of the frames' pixels those that any of them has.
    let before = middles.iter().copied().fold(DVec2::ZERO, DVec2::max).min(reach);
    let ends = photos
        .iter()
        .zip(&middles)
        .map(|(photo, middle)| DVec2::new(photo.width as f64, photo.height as f64) - 1.0 - *middle);
    let after = ends.fold(DVec2::ZERO, DVec2::max).min(reach);
    let size = (before + after).as_usizevec2() + 1;
    let first = |middle: &DVec2| {
        let first = (*middle - before).as_i64vec2();
        (first.x, first.y)
    };
    let cut = |(photo, middle): (&Encoded, &DVec2)| photo.cut_out(first(middle), (size.x, size.y));
    Some(LaidByBall {
        photos: photos.iter().zip(&middles).map(cut).collect(),
        reference,
        first: first(&middles[reference]),
    })
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::conventions::Rgb;
    use crate::photo::{Image, Photo};
    use crate::probe::Rim;

    fn ball(centre_px: DVec2, sigma_px: f64) -> BallImage {
        BallImage {
            rim: Rim::known(DVec3::NEG_Z, 0.1, 1e-4),
            centre_px,
            radius_px: 10.0,
            sigma_px,
            score: Some(0.7),
            agreement: Some(0.6),
            before_black: false,
            rival_px: None,
        }
    }

    /// A picture whose light tells how far each pixel is from a place.
    fn frame(w: usize, h: usize, middle: DVec2) -> Encoded {
        let light = |x: usize, y: usize| {
            let off = DVec2::new(x as f64, y as f64) - middle + 100.0;
            Rgb::new(off.x as f32, off.y as f32, 1.0)
        };
        Photo::from_linear(Image::from_fn(w, h, light)).encoded()
    }

    #[test]
    fn the_ball_of_every_frame_comes_to_one_place() {
        let middles = [DVec2::new(11.0, 12.0), DVec2::new(9.0, 14.0), DVec2::new(40.0, 30.0)];
        let photos: Vec<Encoded> = [(24, 26), (21, 25), (90, 80)]
            .into_iter()
            .zip(middles)
            .map(|((w, h), middle)| frame(w, h, middle))
            .collect();
        let balls = [0.4, 0.3, 0.5].into_iter().zip(middles);
        let balls: Vec<BallImage> =
            balls.map(|(sigma, middle)| ball(middle + 0.3, sigma)).collect();
        let laid = lay_by_ball(&photos, &balls).unwrap();
        assert_eq!(laid.reference, 1);
        // 1.3 radii and 8 px to each side, which the last frame has.
        for photo in &laid.photos {
            assert_eq!((photo.width, photo.height), (43, 43));
            let (decoder, at) = (photo.decoder(), 21 * 43 + 21);
            assert_eq!(decoder.light(at), Rgb::new(100.0, 100.0, 1.0));
            assert_ne!(decoder.coverage(at), Some(0.0));
        }
        assert_eq!(laid.first, (9 - 21, 14 - 21));
        assert!(lay_by_ball(&photos, &balls[1..]).is_none());
        assert!(lay_by_ball(&[], &[]).is_none());
    }
}
