//! A photograph through any lens of `camera`: pinhole, Brown–Conrady, rational, Kannala–Brandt fisheye.
//!
//! Axes are the camera's: −Z in the middle, +Y up. Shown is what is in the frame and inside the field
//! in which the lens model grows.

use glam::{DVec2, DVec3};

use super::ProbeError;
use super::mapping::Mapping;
use crate::camera::Lens;

/// What a lens draws into a frame of pixels.
#[derive(Clone, Debug)]
pub struct LensPicture {
    lens: Lens,
    width: usize,
    height: usize,
}

impl LensPicture {
    /// The frame of `width` × `height` px behind `lens`.
    ///
    /// # Errors
    /// A lens whose model does not even grow over the middle of the frame.
    pub fn new(lens: Lens, width: usize, height: usize) -> Result<Self, ProbeError> {
        let picture = Self { lens, width, height };
        let middle = DVec2::new(width as f64 - 1.0, height as f64 - 1.0) / 2.0;
        if picture.solid_angle(middle).is_none() {
            return Err(ProbeError::Value {
                what: "the lens",
                found: format!("{:?}", picture.lens.parameters()),
                expected: "one that sees the middle of its picture; calibrate it again",
            });
        }
        Ok(picture)
    }

    /// Distance of `pixel` from the principal point as a share of half the frame's diagonal, and the
    /// angle off the axis at which the lens sees it, radians.
    pub fn off_axis(&self, pixel: DVec2) -> Option<(f64, f64)> {
        let direction = self.lens.unproject(pixel)?;
        let half_diagonal = 0.5 * (self.width as f64).hypot(self.height as f64);
        let radius = (pixel - DVec2::new(self.lens.cx, self.lens.cy)).length() / half_diagonal;
        Some((radius, direction.angle_between(DVec3::NEG_Z)))
    }

    /// Angle of a pixel at the principal point, radians.
    pub fn pixel_rad(&self) -> f64 {
        1.0 / (self.lens.fx * self.lens.fy).sqrt()
    }

    fn holds(&self, pixel: DVec2) -> bool {
        let inside = |at: f64, size: usize| (-0.5..=size as f64 - 0.5).contains(&at);
        inside(pixel.x, self.width) && inside(pixel.y, self.height)
    }
}

impl Mapping for LensPicture {
    fn pixel(&self, direction: DVec3) -> Option<DVec2> {
        self.lens.project(direction).filter(|&pixel| self.holds(pixel))
    }

    fn direction(&self, pixel: DVec2) -> Option<DVec3> {
        self.lens.unproject(pixel).filter(|_| self.holds(pixel))
    }

    /// From one side where the other lies beyond the model's field.
    fn solid_angle(&self, pixel: DVec2) -> Option<f64> {
        let here = self.direction(pixel)?;
        let slope = |step: DVec2| {
            let (after, before) =
                (self.lens.unproject(pixel + step), self.lens.unproject(pixel - step));
            match (after, before) {
                (Some(after), Some(before)) => Some((after - before) / (2.0 * step.length())),
                (Some(after), None) => Some((after - here) / step.length()),
                (None, Some(before)) => Some((here - before) / step.length()),
                (None, None) => None,
            }
        };
        Some(slope(DVec2::X * 0.5)?.cross(slope(DVec2::Y * 0.5)?).length())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Distortion;

    /// Kannala–Brandt with all coefficients 0 is the equidistant fisheye: `sin θ/(θ f²)` sr a pixel.
    #[test]
    fn kannala_brandt_without_coefficients_is_equidistant() {
        let mut lens = Lens::pinhole(100.0, 401, 401);
        lens.distortion = Distortion::KannalaBrandt { k1: 0.0, k2: 0.0, k3: 0.0, k4: 0.0 };
        let picture = LensPicture::new(lens, 401, 401).unwrap();
        for (x, theta) in [(200.0, 0.0), (250.0, 0.5), (350.0, 1.5), (400.0, 2.0_f64)] {
            let pixel = DVec2::new(x, 200.0);
            let wanted = if theta > 0.0 { theta.sin() / theta } else { 1.0 } / 1e4;
            let found = picture.solid_angle(pixel).unwrap();
            assert!((found / wanted - 1.0).abs() < 1e-4, "{x}: {found} {wanted}");
            let (radius, angle) = picture.off_axis(pixel).unwrap();
            assert!((angle - theta).abs() < 1e-7, "{angle}");
            assert!((radius - (x - 200.0) / (0.5 * 401.0 * 2f64.sqrt())).abs() < 1e-9);
        }
    }

    #[test]
    fn what_lies_beyond_the_frame_is_not_shown() {
        let picture = LensPicture::new(Lens::pinhole(100.0, 200, 100), 200, 100).unwrap();
        assert!(picture.pixel(DVec3::new(0.9, 0.0, -1.0)).is_some());
        assert!(picture.pixel(DVec3::new(1.1, 0.0, -1.0)).is_none());
        assert!(picture.pixel(DVec3::Z).is_none());
        assert!(picture.direction(DVec2::new(250.0, 50.0)).is_none());
    }
}
