//! How finely a photograph showed each direction: what the panorama can be trusted to resolve.
//!
//! Where a pixel `p` shows the direction `d(p)`, the 3 × 2 matrix ∂d/∂p has two singular values: radians
//! per pixel in the direction in which the picture is most squeezed and in the one in which it is least.
//! At a mirror ball's rim they are far apart.

use glam::{DMat3, DVec2};
use rayon::prelude::*;

use super::mapping::Mapping;
use crate::photo::Image;

/// Resolution of the source, for each texel of a target.
#[derive(Clone, Debug)]
pub struct Quality {
    /// Pixels of the photograph per degree, where it is coarsest; 0 where nothing is shown.
    pub pixels_per_degree: Image<f32>,
    /// Solid angle of a pixel of the photograph, sr; 0 where nothing is shown.
    pub sr_per_pixel: Image<f32>,
}

/// Resolution that a picture of `source_size` px seen through `source` has in the texels of `target`.
///
/// `source_from_target` takes directions of the target's axes to the source's.
pub fn quality<M: Mapping + ?Sized, D: Mapping + ?Sized>(
    source: &M,
    source_size: (usize, usize),
    target: &D,
    (width, height): (usize, usize),
    source_from_target: DMat3,
) -> Quality {
    let texels: Vec<[f32; 2]> = (0..width * height)
        .into_par_iter()
        .map(|k| {
            let centre = DVec2::new((k % width) as f64, (k / width) as f64);
            let direction = target.direction(centre);
            let pixel = direction.and_then(|d| source.pixel(source_from_target * d));
            let seen = pixel.filter(|&p| covered(source, source_size, p));
            seen.and_then(|p| resolution(source, p)).unwrap_or_default()
        })
        .collect();
    let of = |k: usize| Image::from_fn(width, height, |x, y| texels[y * width + x][k]);
    Quality { pixels_per_degree: of(0), sr_per_pixel: of(1) }
}

fn covered<M: Mapping + ?Sized>(source: &M, (w, h): (usize, usize), pixel: DVec2) -> bool {
    let nearest = |v: f64, size: usize| {
        let inside = (-0.5..size as f64 - 0.5).contains(&v);
        inside.then(|| (v.round().max(0.0) as usize).min(size - 1))
    };
    match (nearest(pixel.x, w), nearest(pixel.y, h)) {
        (Some(x), Some(y)) => source.covers(x, y),
        _ => false,
    }
}

/// Pixels per degree where the picture is coarsest, and sr per pixel.
fn resolution<M: Mapping + ?Sized>(source: &M, pixel: DVec2) -> Option<[f32; 2]> {
    let slope = |step: DVec2| {
        // Within half a pixel, on one side alone where the other is beyond a rim.
        let ahead = source.direction_beyond(pixel, pixel + step);
        let back = source.direction_beyond(pixel, pixel - step);
        match (ahead, back) {
            (Some(ahead), Some(back)) => Some((ahead - back) / (2.0 * step.length())),
            (Some(ahead), None) => Some((ahead - source.direction(pixel)?) / step.length()),
            (None, Some(back)) => Some((source.direction(pixel)? - back) / step.length()),
            (None, None) => None,
        }
    };
    let (a, b) = (slope(DVec2::X * 0.25)?, slope(DVec2::Y * 0.25)?);
    // Singular values of [a b] from its Gram matrix.
    let (aa, bb, ab) = (a.dot(a), b.dot(b), a.dot(b));
    let middle = 0.5 * (aa + bb);
    let coarsest = (middle + (0.25 * (aa - bb).powi(2) + ab * ab).sqrt()).sqrt();
    let solid_angle = a.cross(b).length();
    let per_degree = 1.0 / coarsest.to_degrees();
    per_degree.is_finite().then_some([per_degree as f32, solid_angle as f32])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::probe::mapping::{BallMap, LatLong};

    /// The ball map is equal-area and squeezed by 1/cos²(θ/2) towards its rim (methods-capture A4).
    #[test]
    fn a_ball_map_is_equal_area_and_coarse_at_its_rim() {
        let (ball, lat_long) = (BallMap { size: 1000 }, LatLong { width: 360, height: 180 });
        let found = quality(&ball, (1000, 1000), &lat_long, (360, 180), DMat3::IDENTITY);
        for (x, y) in [(180, 90), (200, 60), (90, 90), (50, 90), (270, 120)] {
            let direction = lat_long.direction(DVec2::new(x as f64, y as f64)).unwrap();
            let half_theta = 0.5 * direction.z.acos();
            // r = 500 sin(θ/2): 250 cos(θ/2) px per radian.
            let wanted = (250.0 * half_theta.cos()).to_radians();
            let per_degree = f64::from(found.pixels_per_degree[(x, y)]);
            assert!((per_degree / wanted - 1.0).abs() < 1e-3, "({x}, {y}): {per_degree} {wanted}");
            let solid_angle = f64::from(found.sr_per_pixel[(x, y)]);
            assert!((solid_angle / (4.0 / 500f64.powi(2)) - 1.0).abs() < 1e-3, "{solid_angle}");
        }
    }

    #[test]
    fn a_lat_long_has_one_pixel_a_degree_and_none_beyond_a_fisheye() {
        let lat_long = LatLong { width: 360, height: 180 };
        let found = quality(&lat_long, (360, 180), &lat_long, (360, 180), DMat3::IDENTITY);
        // Across a texel 1° of longitude is less of an arc; down it is 1° everywhere.
        let worst = found.pixels_per_degree.pixels().iter().copied().fold(f32::MAX, f32::min);
        assert!((worst - 1.0).abs() < 1e-3, "{worst}");
        let fisheye = crate::probe::fisheye::Fisheye::new(
            crate::probe::fisheye::Projection::Equidistant,
            180.0,
            None,
            [180, 180],
        );
        let seen = quality(&fisheye.unwrap(), (180, 180), &lat_long, (360, 180), DMat3::IDENTITY);
        // −Z is a lat-long's outer columns.
        assert!((seen.pixels_per_degree[(1, 90)] - 1.0).abs() < 1e-2);
        assert_eq!(seen.pixels_per_degree[(180, 90)], 0.0);
    }
}
