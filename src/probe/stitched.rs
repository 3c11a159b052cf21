//! Overlapping photographs of known cameras in one place → panorama, in linear light.
//!
//! Each photograph is resampled with all its flux ([`resample`](super::resample)); where several show a
//! texel their light is averaged, each by how far the texel lies from its frame's border, so that no
//! seam is seen. A clipped texel gives way to one that is not.

use glam::{DMat3, DVec2};

use super::ProbeError;
use super::fill;
use super::lens_picture::LensPicture;
use super::mapping::Mapping;
use super::panorama::Panorama;
use super::resample::{to_lat_long, worst};
use super::unwrap::check_width;
use crate::bracket::{Radiance, Validity};
use crate::conventions::{Rgb, luminance};
use crate::photo::Image;

/// One photograph and how its camera was turned.
#[derive(Clone, Debug)]
pub struct View<'a> {
    pub radiance: &'a Radiance,
    pub picture: LensPicture,
    pub world_from_camera: DMat3,
}

/// A panorama of several views.
#[derive(Clone, Debug)]
pub struct Stitched {
    pub panorama: Panorama,
    /// By how many stops each view is brighter than the mean of all where it overlaps others (median);
    /// 0 where it does not. Far from 0, exposures are wrong or light has changed.
    pub off_stops: Vec<f32>,
}

/// Texels are compared where light is not black.
const DARKEST_SHARE: f32 = 1e-3;

/// The panorama of views from one place; what none shows is filled from around it.
///
/// # Errors
/// A width that no panorama has.
pub fn stitched(views: &[View], width: usize) -> Result<Stitched, ProbeError> {
    check_width(width)?;
    let seen: Vec<Panorama> = views
        .iter()
        .map(|view| {
            let camera_from_world = view.world_from_camera.transpose();
            to_lat_long(view.radiance, &view.picture, camera_from_world, width)
        })
        .collect();
    let mut panorama = Panorama::from_radiance(Image::filled(width, width / 2, Rgb::ZERO));
    let mut gap = Image::filled(width, width / 2, false);
    let mut stops: Vec<Vec<f32>> = vec![Vec::new(); views.len()];
    for y in 0..width / 2 {
        for x in 0..width {
            let shares = shares(views, &seen, (x, y));
            gap[(x, y)] = shares.is_empty();
            panorama.coverage[(x, y)] = if shares.is_empty() { 0.0 } else { 1.0 };
            if shares.is_empty() {
                continue;
            }
            let mut validity = Validity::Measured;
            for &(k, share) in &shares {
                panorama.radiance[(x, y)] += seen[k].radiance[(x, y)] * share;
                panorama.variance[(x, y)] += seen[k].variance[(x, y)] * (share * share);
                validity = worst(validity, seen[k].validity[(x, y)]);
            }
            panorama.validity[(x, y)] = validity;
            let mean = luminance(panorama.radiance[(x, y)]);
            if shares.len() > 1 && validity == Validity::Measured && mean > 0.0 {
                for &(k, _) in &shares {
                    let ratio = luminance(seen[k].radiance[(x, y)]) / mean;
                    stops[k].push(ratio.max(DARKEST_SHARE).log2());
                }
            }
        }
    }
    fill::from_around(&mut panorama, &gap);
    Ok(Stitched { panorama, off_stops: stops.into_iter().map(median).collect() })
}

/// The views that show a texel, and each one's share of it; the shares add up to 1.
fn shares(views: &[View], seen: &[Panorama], at: (usize, usize)) -> Vec<(usize, f32)> {
    let showing: Vec<usize> = (0..views.len()).filter(|&k| seen[k].coverage[at] >= 0.5).collect();
    let clipped = |k: usize| seen[k].validity[at] == Validity::LowerBound;
    let whole = showing.iter().any(|&k| !clipped(k));
    let mut weights: Vec<(usize, f32)> = showing
        .into_iter()
        .filter(|&k| !(whole && clipped(k)))
        .filter_map(|k| {
            let direction = views[k].world_from_camera.transpose() * seen[k].direction(at.0, at.1);
            let pixel = views[k].picture.pixel(direction)?;
            Some((k, inside(&views[k].radiance.mean, pixel)))
        })
        .collect();
    let total: f32 = weights.iter().map(|(_, weight)| weight).sum();
    weights.iter_mut().for_each(|(_, weight)| *weight /= total);
    weights
}

/// How far `pixel` lies inside the frame: 1 in the middle, next to nothing on the border.
fn inside(frame: &Image<Rgb>, pixel: DVec2) -> f32 {
    let from_border = |at: f64, size: usize| {
        let half = size as f64 / 2.0;
        (1.0 - (at + 0.5 - half).abs() / half).max(1e-4)
    };
    (from_border(pixel.x, frame.width()) * from_border(pixel.y, frame.height())) as f32
}

fn median(mut values: Vec<f32>) -> f32 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f32::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Lens;
    use glam::DVec3;

    fn light(d: DVec3) -> Rgb {
        Rgb::new(2.0 + d.x as f32, 2.0 + d.y as f32, 2.0 + d.z as f32)
    }

    /// Four photographs round the horizon, 100° wide each.
    fn photographs(gain: impl Fn(usize) -> f32) -> Vec<(Radiance, LensPicture, DMat3)> {
        (0..4)
            .map(|k| {
                let lens = Lens::pinhole(100.0 / 50f64.to_radians().tan(), 200, 160);
                let picture = LensPicture::new(lens, 200, 160).unwrap();
                let turn = DMat3::from_rotation_y(std::f64::consts::FRAC_PI_2 * k as f64);
                let mean = Image::from_fn(200, 160, |x, y| {
                    let pixel = DVec2::new(x as f64, y as f64);
                    light(turn * picture.direction(pixel).unwrap()) * gain(k)
                });
                let variance = Image::filled(200, 160, Rgb::splat(0.01));
                let validity = Image::filled(200, 160, Validity::Measured);
                (Radiance { mean, variance, validity }, picture, turn)
            })
            .collect()
    }

    fn stitch(photographs: &[(Radiance, LensPicture, DMat3)]) -> Stitched {
        let views: Vec<View> = photographs
            .iter()
            .map(|(radiance, picture, turn)| View {
                radiance,
                picture: picture.clone(),
                world_from_camera: *turn,
            })
            .collect();
        stitched(&views, 256).unwrap()
    }

    #[test]
    fn four_views_are_one_world() {
        let found = stitch(&photographs(|_| 1.0));
        for x in 0..256 {
            for y in 52..76 {
                let d = found.panorama.direction(x, y);
                let off = (found.panorama.radiance[(x, y)] - light(d)).abs().max_element();
                assert!(off < 5e-3, "({x}, {y}): {off}");
                assert_eq!(found.panorama.validity[(x, y)], Validity::Measured);
            }
        }
        assert_eq!(found.panorama.validity[(10, 0)], Validity::Filled);
        assert_eq!(found.panorama.coverage[(10, 0)], 0.0);
        assert!(found.off_stops.iter().all(|stops| stops.abs() < 1e-2), "{:?}", found.off_stops);
    }

    #[test]
    fn a_wrong_exposure_is_told_and_a_clipped_view_gives_way() {
        let mut shots = photographs(|k| if k == 2 { 1.5 } else { 1.0 });
        let told = stitch(&shots).off_stops;
        let brightest = (0..4).max_by(|&a, &b| told[a].total_cmp(&told[b])).unwrap();
        assert_eq!(brightest, 2);
        assert!(told[2] > 0.15, "{told:?}");
        shots = photographs(|k| if k == 2 { 0.5 } else { 1.0 });
        shots[2].0.validity = Image::filled(200, 160, Validity::LowerBound);
        let found = stitch(&shots);
        // Between views 1 and 2, where both see it: 47° from each.
        let d = DMat3::from_rotation_y(135f64.to_radians()) * DVec3::NEG_Z;
        let off = (found.panorama.radiance(d) - light(d)).abs().max_element();
        assert!(off < 5e-3, "{off}");
    }
}
