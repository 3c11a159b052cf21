//! Pictures of all directions: lat-long, angular map, mirror-ball map, cube cross; and any lens.
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
/// For pictures *made* in this mapping; a photographed ball is [`Mirror`](super::ball::Mirror).
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

/// Horizontal cube cross, 4 × 3 faces: left, front (−Z), right, back in the middle row, top and
/// bottom above and below the front.
#[derive(Clone, Copy, Debug)]
pub struct CubeCross {
    /// Side of a face, px; the picture is 4 × 3 of them.
    pub face: usize,
}

/// A face's place in the cross (column, row) and its axes: right, up, outwards.
const FACES: [([f64; 2], DVec3, DVec3, DVec3); 6] = [
    ([0.0, 1.0], DVec3::NEG_Z, DVec3::Y, DVec3::NEG_X),
    ([1.0, 1.0], DVec3::X, DVec3::Y, DVec3::NEG_Z),
    ([2.0, 1.0], DVec3::Z, DVec3::Y, DVec3::X),
    ([3.0, 1.0], DVec3::NEG_X, DVec3::Y, DVec3::Z),
    ([1.0, 0.0], DVec3::X, DVec3::Z, DVec3::Y),
    ([1.0, 2.0], DVec3::X, DVec3::NEG_Z, DVec3::NEG_Y),
];

impl Mapping for CubeCross {
    fn pixel(&self, direction: DVec3) -> Option<DVec2> {
        // The face whose outward axis is nearest; ties on edges go to the first.
        let (mut best, mut most) = (&FACES[0], f64::NEG_INFINITY);
        for face in &FACES {
            if direction.dot(face.3) > most {
                (best, most) = (face, direction.dot(face.3));
            }
        }
        let &([column, row], right, up, _) = best;
        let u = 0.5 + 0.5 * direction.dot(right) / most;
        let v = 0.5 - 0.5 * direction.dot(up) / most;
        Some(DVec2::new(column + u, row + v) * self.face as f64 - 0.5)
    }

    fn direction(&self, pixel: DVec2) -> Option<DVec3> {
        let (outward, right, up, u, v) = self.on_face(pixel)?;
        Some((outward + right * u + up * v).normalize())
    }

    fn solid_angle(&self, pixel: DVec2) -> Option<f64> {
        let (_, _, _, u, v) = self.on_face(pixel)?;
        Some((2.0 / self.face as f64).powi(2) / (1.0 + u * u + v * v).powf(1.5))
    }
}

impl CubeCross {
    /// Axes (outward, right, up) of the face under `pixel` and the place on it, −1…1.
    fn on_face(&self, pixel: DVec2) -> Option<(DVec3, DVec3, DVec3, f64, f64)> {
        let p = (pixel + 0.5) / self.face as f64;
        let (column, row) = (p.x.floor(), p.y.floor());
        let &(_, right, up, outward) = FACES.iter().find(|f| f.0 == [column, row])?;
        Some((outward, right, up, 2.0 * (p.x - column) - 1.0, 1.0 - 2.0 * (p.y - row)))
    }
}

/// Direction `theta` from −Z on the side of `p` (picture axes, y down).
pub(super) fn from_axis(theta: f64, p: DVec2) -> DVec3 {
    let way = p.normalize_or_zero() * theta.sin();
    DVec3::new(way.x, -way.y, -theta.cos())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 2000 directions spread evenly (golden spiral), none on an axis.
    fn directions() -> impl Iterator<Item = DVec3> {
        (0..2000).map(|k| {
            let y = 1.0 - 2.0 * (k as f64 + 0.5) / 2000.0;
            let turn = k as f64 * 2.399_963_229_728_653;
            let level = (1.0 - y * y).sqrt();
            DVec3::new(level * turn.cos(), y, level * turn.sin())
        })
    }

    fn mappings() -> Vec<(&'static str, Box<dyn Mapping>)> {
        vec![
            ("lat-long", Box::new(LatLong { width: 512, height: 256 })),
            ("angular", Box::new(Angular { size: 512 })),
            ("ball map", Box::new(BallMap { size: 512 })),
            ("cube", Box::new(CubeCross { face: 128 })),
        ]
    }

    #[test]
    fn pixels_invert_directions() {
        for (name, mapping) in mappings() {
            for direction in directions() {
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

        let cube = CubeCross { face: 100 };
        let at = |d: DVec3| (cube.pixel(d).unwrap() + 0.5) / 100.0;
        assert!((at(DVec3::NEG_Z) - DVec2::new(1.5, 1.5)).length() < 1e-12);
        assert!((at(DVec3::X) - DVec2::new(2.5, 1.5)).length() < 1e-12);
        assert!((at(DVec3::Y) - DVec2::new(1.5, 0.5)).length() < 1e-12);
        // Looking up from the front keeps right on the right.
        let up_right = DVec3::new(0.3, 1.0, -0.2);
        assert!(at(up_right).x > 1.5 && at(up_right).y > 0.5 && at(up_right).y < 1.0);
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
        let outer = directions()
            .filter(|&d| {
                let u = (lat_long.pixel(d).unwrap().x + 0.5) / 100.0;
                !(0.25..0.75).contains(&u)
            })
            .count();
        assert!((outer as i64 - 1000).abs() < 20, "{outer} of 2000 outside the front half");
    }
}
