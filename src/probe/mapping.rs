//! Pictures of directions: lat-long, angular map and mirror-ball map here; cubes, fisheyes and lenses in
//! their own files.
//!
//! [`Mapping`] takes pixels to directions and back, each with the solid angle of a pixel. Axes are
//! the picture's own: angular map, ball map and cube are as a camera at the centre holds
//! them, right = +X, up = +Y. The traps here (methods-capture A1–A6): `acos` loses the axis,
//! one-argument arctangents lose half the sphere, image rows grow downwards.

use std::f64::consts::PI;

use glam::{DVec2, DVec3};

use crate::conventions::{lat_long_direction, lat_long_pixel, lat_long_solid_angle};

/// One-to-one between pixels of a picture and directions; axes as each implementation says.
pub trait Mapping: Sync {
    /// Where `direction` (unit) is in the picture; `None` if it is not. May lie outside the frame.
    fn pixel(&self, direction: DVec3) -> Option<DVec2>;

    /// Unit direction shown at `pixel`; `None` where the picture shows nothing.
    fn direction(&self, pixel: DVec2) -> Option<DVec3>;

    /// Solid angle of the pixel centred at `pixel`, sr.
    ///
    /// The default is a central difference over one pixel.
    fn solid_angle(&self, pixel: DVec2) -> Option<f64> {
        let h = 0.5;
        let dx = self.direction(pixel + h * DVec2::X)? - self.direction(pixel - h * DVec2::X)?;
        let dy = self.direction(pixel + h * DVec2::Y)? - self.direction(pixel - h * DVec2::Y)?;
        Some(dx.cross(dy).length())
    }

    /// Whether pixel (x, y) may be used at all; mappings with a rim keep away from it.
    fn covers(&self, x: usize, y: usize) -> bool {
        self.direction(DVec2::new(x as f64, y as f64)).is_some()
    }

    /// Whether the picture closes on itself as a lat-long does: its last column meets its first,
    /// its top and bottom rows meet themselves half a turn away.
    fn wraps(&self) -> bool {
        false
    }

    /// Solid angle of one of the `side` × `side` parts of a pixel in row `y`, sr: of the `j`-th from above;
    /// `None` where not all pixels of a row have the same.
    fn part_of_row(&self, _y: usize, _j: usize, _side: usize) -> Option<f64> {
        None
    }

    /// Which of the pieces that the picture is put together from (the faces of a cube) holds `pixel`.
    ///
    /// Within a piece neighbouring pixels show neighbouring directions; across two they may not.
    fn piece(&self, _pixel: DVec2) -> usize {
        0
    }

    /// Direction at `pixel`, if the piece that holds `inside` went on there.
    fn direction_beyond(&self, _inside: DVec2, pixel: DVec2) -> Option<DVec3> {
        self.direction(pixel)
    }

    /// The pixel that shows what pixel (x, y) would, if the piece that holds `inside` went on there.
    fn continued(&self, _inside: DVec2, x: i64, y: i64) -> (i64, i64) {
        (x, y)
    }
}

impl<M: Mapping + ?Sized> Mapping for &M {
    fn pixel(&self, direction: DVec3) -> Option<DVec2> {
        (**self).pixel(direction)
    }

    fn direction(&self, pixel: DVec2) -> Option<DVec3> {
        (**self).direction(pixel)
    }

    fn solid_angle(&self, pixel: DVec2) -> Option<f64> {
        (**self).solid_angle(pixel)
    }

    fn covers(&self, x: usize, y: usize) -> bool {
        (**self).covers(x, y)
    }

    fn wraps(&self) -> bool {
        (**self).wraps()
    }

    fn part_of_row(&self, y: usize, j: usize, side: usize) -> Option<f64> {
        (**self).part_of_row(y, j, side)
    }

    fn piece(&self, pixel: DVec2) -> usize {
        (**self).piece(pixel)
    }

    fn direction_beyond(&self, inside: DVec2, pixel: DVec2) -> Option<DVec3> {
        (**self).direction_beyond(inside, pixel)
    }

    fn continued(&self, inside: DVec2, x: i64, y: i64) -> (i64, i64) {
        (**self).continued(inside, x, y)
    }
}

/// Lat-long as in `conventions`.
#[derive(Clone, Copy, Debug)]
pub struct LatLong {
    pub width: usize,
    pub height: usize,
}

impl Mapping for LatLong {
    fn pixel(&self, direction: DVec3) -> Option<DVec2> {
        Some(lat_long_pixel(direction, self.width, self.height))
    }

    fn direction(&self, pixel: DVec2) -> Option<DVec3> {
        Some(lat_long_direction(pixel, self.width, self.height))
    }

    fn solid_angle(&self, pixel: DVec2) -> Option<f64> {
        let row = pixel.y.round().clamp(0.0, self.height as f64 - 1.0) as usize;
        Some(lat_long_solid_angle(row, self.width, self.height))
    }

    fn wraps(&self) -> bool {
        true
    }

    fn part_of_row(&self, y: usize, j: usize, side: usize) -> Option<f64> {
        Some(lat_long_solid_angle(y * side + j, self.width * side, self.height * side))
    }

    fn continued(&self, _inside: DVec2, x: i64, y: i64) -> (i64, i64) {
        let (w, h) = (self.width as i64, self.height as i64);
        // Saturating: a place beyond all integers is outside, not an overflow.
        let x = if y < 0 || y >= h { x.saturating_add(w / 2) } else { x };
        (x.rem_euclid(w), y.clamp(0, h - 1))
    }
}

/// Debevec's angular map: distance from the centre ∝ angle from −Z, the whole rim is +Z.
///
/// `p = (½ + rDx, ½ + rDy), r = θ/(2π √(Dx² + Dy²))` with rows upwards. The widely copied
/// `acos(+Dz)` with forward −Z puts the forward direction on the rim (A1).
#[derive(Clone, Copy, Debug)]
pub struct Angular {
    pub size: usize,
}

impl Mapping for Angular {
    fn pixel(&self, direction: DVec3) -> Option<DVec2> {
        let sideways = DVec2::new(direction.x, -direction.y);
        let theta = sideways.length().atan2(-direction.z);
        // On the axis backwards every way is right: take +x.
        let way = sideways.try_normalize().unwrap_or(DVec2::X);
        Some(self.centre() + way * (theta / PI * self.radius()))
    }

    fn direction(&self, pixel: DVec2) -> Option<DVec3> {
        let p = (pixel - self.centre()) / self.radius();
        let theta = p.length() * PI;
        (theta <= PI).then(|| from_axis(theta, p))
    }

    fn solid_angle(&self, pixel: DVec2) -> Option<f64> {
        let r = (pixel - self.centre()).length() / self.radius();
        let sinc = if r > 1e-9 { (r * PI).sin() / (r * PI) } else { 1.0 };
        (r <= 1.0).then(|| sinc * (PI / self.radius()).powi(2))
    }
}

impl Angular {
    fn centre(&self) -> DVec2 {
        DVec2::splat((self.size as f64 - 1.0) / 2.0)
    }

    fn radius(&self) -> f64 {
        self.size as f64 / 2.0
    }
}

/// The orthographic mirror-ball map: centre +Z (back to the camera), rim −Z. Equal-area (A4).
///
/// OpenGL's sphere map (`GL_SPHERE_MAP`) is the same. For pictures *made* in this mapping; a photographed
/// ball is [`Mirror`](super::ball::Mirror).
#[derive(Clone, Copy, Debug)]
pub struct BallMap {
    pub size: usize,
}

impl Mapping for BallMap {
    fn pixel(&self, direction: DVec3) -> Option<DVec2> {
        let sideways = DVec2::new(direction.x, -direction.y);
        let theta = sideways.length().atan2(direction.z);
        let way = sideways.try_normalize().unwrap_or(DVec2::X);
        let half = self.size as f64 / 2.0;
        Some(DVec2::splat(half - 0.5) + way * ((theta / 2.0).sin() * half))
    }

    fn direction(&self, pixel: DVec2) -> Option<DVec3> {
        let half = self.size as f64 / 2.0;
        let p = (pixel - DVec2::splat(half - 0.5)) / half;
        let forward = (p.length() <= 1.0).then(|| from_axis(2.0 * p.length().asin(), p))?;
        Some(DVec3::new(forward.x, forward.y, -forward.z))
    }

    fn solid_angle(&self, pixel: DVec2) -> Option<f64> {
        let half = self.size as f64 / 2.0;
        let inside = (pixel - DVec2::splat(half - 0.5)).length() <= half;
        inside.then_some(4.0 / (half * half))
    }
}

/// Direction `theta` from −Z on the side of `p` (picture axes, y down).
pub(super) fn from_axis(theta: f64, p: DVec2) -> DVec3 {
    let way = p.normalize_or_zero() * theta.sin();
    DVec3::new(way.x, -way.y, -theta.cos())
}

/// `n` unit directions spread evenly (golden spiral).
pub(super) fn spread_directions(n: usize) -> impl Iterator<Item = DVec3> {
    (0..n).map(move |k| {
        let y = 1.0 - 2.0 * (k as f64 + 0.5) / n as f64;
        let turn = k as f64 * 2.399_963_229_728_653;
        let level = (1.0 - y * y).sqrt();
        DVec3::new(level * turn.cos(), y, level * turn.sin())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mappings() -> Vec<(&'static str, Box<dyn Mapping>)> {
        vec![
            ("lat-long", Box::new(LatLong { width: 512, height: 256 })),
            ("angular", Box::new(Angular { size: 512 })),
            ("ball map", Box::new(BallMap { size: 512 })),
        ]
    }

    #[test]
    fn pixels_invert_directions() {
        for (name, mapping) in mappings() {
            for direction in spread_directions(2000) {
                let pixel = mapping.pixel(direction).unwrap();
                // At 1e-8 rad from the mappings' rims f64 itself runs out.
                let back = mapping.direction(pixel * (1.0 - 1e-16)).unwrap();
                assert!(back.angle_between(direction) < 1e-6, "{name} {direction}: {back}");
            }
        }
    }

    #[test]
    fn solid_angles_add_up_to_the_sphere() {
        for (name, mapping) in mappings() {
            let mut sum = 0.0;
            for y in 0..512 {
                for x in 0..512 {
                    let inside = match name {
                        "lat-long" => y < 256,
                        _ => true,
                    };
                    let pixel = DVec2::new(x as f64, y as f64);
                    if inside && mapping.covers(x, y) {
                        sum += mapping.solid_angle(pixel).unwrap();
                    }
                }
            }
            // Rims are staircases of pixels.
            assert!((sum / (4.0 * PI) - 1.0).abs() < 2e-3, "{name}: {sum}");
        }
    }

    /// F27: six directions must be found where the mapping's definition puts them.
    #[test]
    fn six_axes_are_where_they_belong() {
        let lat_long = LatLong { width: 400, height: 200 };
        let at = |d: DVec3| lat_long.pixel(d).unwrap();
        assert!((at(DVec3::Z) - DVec2::new(199.5, 99.5)).length() < 1e-9);
        assert!((at(DVec3::X) - DVec2::new(99.5, 99.5)).length() < 1e-9);
        assert!((at(DVec3::NEG_X) - DVec2::new(299.5, 99.5)).length() < 1e-9);
        assert!(at(DVec3::NEG_Z).x < 0.0 || at(DVec3::NEG_Z).x > 399.0);
        assert!((at(DVec3::Y).y + 0.5).abs() < 1e-9 && (at(DVec3::NEG_Y).y - 199.5).abs() < 1e-9);

        let angular = Angular { size: 200 };
        let at = |d: DVec3| (angular.pixel(d).unwrap() + 0.5) / 200.0;
        assert!((at(DVec3::NEG_Z) - 0.5).length() < 1e-12);
        assert!((at(DVec3::X) - DVec2::new(0.75, 0.5)).length() < 1e-12);
        assert!((at(DVec3::Y) - DVec2::new(0.5, 0.25)).length() < 1e-12);
        assert!(((at(DVec3::Z) - 0.5).length() - 0.5).abs() < 1e-12);

        let ball = BallMap { size: 200 };
        let at = |d: DVec3| (ball.pixel(d).unwrap() + 0.5) / 200.0;
        assert!((at(DVec3::Z) - 0.5).length() < 1e-12);
        assert!((at(DVec3::X).x - (0.5 + 0.5 * 0.5f64.sqrt())).abs() < 1e-12);
        assert!(((at(DVec3::NEG_Z) - 0.5).length() - 0.5).abs() < 1e-12);
    }

    /// OpenGL 2.1, 2.11.4: s = r_x/m + ½, t = r_y/m + ½ with m = 2 √(r_x² + r_y² + (r_z + 1)²), t upwards.
    #[test]
    fn the_sphere_map_of_opengl_is_the_ball_map() {
        let ball = BallMap { size: 300 };
        for r in spread_directions(2000) {
            let m = 2.0 * (r.x * r.x + r.y * r.y + (r.z + 1.0).powi(2)).sqrt();
            let gl = DVec2::new(r.x / m + 0.5, 0.5 - r.y / m) * 300.0 - 0.5;
            assert!((ball.pixel(r).unwrap() - gl).length() < 1e-9, "{r}");
        }
    }

    /// A1: near the axis `acos` in f32 is 100 % wrong; the arctangent is not.
    #[test]
    fn angular_map_is_exact_near_its_centre() {
        let angular = Angular { size: 1000 };
        for theta in [1e-12, 1e-8, 1e-4] {
            let direction = DVec3::new(f64::sin(theta), 0.0, -f64::cos(theta));
            let r = (angular.pixel(direction).unwrap() - 499.5).length() / 500.0 * PI;
            assert!((r / theta - 1.0).abs() < 1e-1 || (r - theta).abs() < 1e-13, "{theta}: {r}");
        }
        assert!((angular.direction(DVec2::splat(499.5)).unwrap() - DVec3::NEG_Z).length() < 1e-15);
        assert!(angular.direction(DVec2::new(0.0, 0.0)).is_none());
    }

    /// A2: with the one-argument arctangent all u lie in [¼, ¾].
    #[test]
    fn lat_long_reaches_the_rear_half() {
        let lat_long = LatLong { width: 100, height: 50 };
        let outer = spread_directions(2000)
            .filter(|&d| {
                let u = (lat_long.pixel(d).unwrap().x + 0.5) / 100.0;
                !(0.25..0.75).contains(&u)
            })
            .count();
        assert!((outer as i64 - 1000).abs() < 20, "{outer} of 2000 outside the front half");
    }
}
