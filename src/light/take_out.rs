//! A light that is modelled apart leaves the panorama, so that it does not shine twice.

use glam::{DVec2, DVec3};

use crate::bracket::Validity;
use crate::conventions::{Rgb, lat_long_direction};
use crate::probe::Panorama;

/// Takes a light that is modelled apart out of the panorama: its texels get the median of their
/// surroundings and become [`Validity::Analytic`].
///
/// `half_angle_rad` is that of the cone around `direction` (world) to clear; the surroundings are
/// the ring out to twice that, clipped texels left out. Nothing changes if the ring is empty.
pub fn take_out(panorama: &mut Panorama, direction: DVec3, half_angle_rad: f64) {
    let (width, height) = (panorama.radiance.width(), panorama.radiance.height());
    let axis = panorama.world_from_panorama.inverse() * direction;
    let mut inside = Vec::new();
    let mut ring: Vec<Rgb> = Vec::new();
    for y in 0..height {
        for x in 0..width {
            let texel = lat_long_direction(DVec2::new(x as f64, y as f64), width, height);
            let angle = axis.angle_between(texel);
            if angle <= half_angle_rad {
                inside.push((x, y));
            } else if angle <= 2.0 * half_angle_rad
                && panorama.validity[(x, y)] != Validity::LowerBound
            {
                ring.push(panorama.radiance[(x, y)]);
            }
        }
    }
    if ring.is_empty() {
        return;
    }
    let channel = |c: usize| {
        let mut values: Vec<f32> = ring.iter().map(|l| l[c]).collect();
        values.sort_by(f32::total_cmp);
        values[values.len() / 2]
    };
    let surroundings = Rgb::new(channel(0), channel(1), channel(2));
    for at in inside {
        panorama.radiance[at] = surroundings;
        panorama.validity[at] = Validity::Analytic;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::conventions::lat_long_pixel;
    use crate::photo::Image;

    #[test]
    fn taking_a_light_out_leaves_its_surroundings() {
        let sky = Rgb::new(0.02, 0.03, 0.05);
        let mut panorama = Panorama::from_radiance(Image::filled(64, 32, sky));
        let direction = DVec3::new(-0.25, 1.0, 0.1).normalize();
        let at = lat_long_pixel(direction, 64, 32).round();
        let at = (at.x as usize, at.y as usize);
        panorama.radiance[at] = Rgb::splat(50.0);
        panorama.validity[at] = Validity::LowerBound;
        take_out(&mut panorama, direction, 0.1);
        assert_eq!(panorama.radiance[at], sky);
        assert_eq!(panorama.validity[at], Validity::Analytic);
        assert!(panorama.radiance.pixels().iter().all(|&l| l == sky));
    }
}
