//! Pixel ↔ ray: lens models, pose, and how well both are known.
//!
//! corners or files → [`Camera`] = size + [`Lens`] + [`Pose`], with covariances.
//! This room never detects anything in a picture (that is `calib/`) and never warps one.

pub mod file;
pub mod interchange;
pub mod lens;
#[cfg(test)]
mod lens_tests;
pub mod planar_pose;
mod planar_start;
mod plausible;
pub mod pose;
pub mod print;
pub mod slip;

pub use lens::{Distortion, Lens};
pub use pose::Pose;

use glam::{DVec2, DVec3};

/// A camera: picture size, lens, place, and the covariances of both.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    pub width: usize,
    pub height: usize,
    pub lens: Lens,
    pub pose: Pose,
}

impl Camera {
    /// Origin (m) and direction (unit), in the world, of the ray seen at `pixel`.
    ///
    /// `None` outside the lens model's field.
    pub fn ray(&self, pixel: DVec2) -> Option<(DVec3, DVec3)> {
        let direction = self.lens.unproject(pixel)?;
        Some((self.pose.position(), self.pose.rotation() * direction))
    }

    /// Pixel at which a world point is seen; `None` where the lens does not see it.
    ///
    /// The pixel may lie outside the picture: ask [`Camera::shows`].
    pub fn project_world(&self, point: DVec3) -> Option<DVec2> {
        self.lens.project(self.pose.inverse().transform_point3(point))
    }

    /// Whether a pixel lies in the picture, the halves of its outermost pixels included.
    pub fn shows(&self, pixel: DVec2) -> bool {
        let inside = |at: f64, size: usize| at > -0.5 && at < size as f64 - 0.5;
        inside(pixel.x, self.width) && inside(pixel.y, self.height)
    }

    /// Whether a picture of `width` × `height` px can be a cut-out of `scale` × this frame whose pixel
    /// (0, 0) is (`x`, `y`) of that larger frame: to a pixel of either, which rounded numbers may miss.
    pub fn holds_cut_out(&self, x: f64, y: f64, scale: f64, width: usize, height: usize) -> bool {
        let slack = scale.max(1.0);
        let inside = |at: f64, part: usize, whole: usize| {
            at >= -slack && at + part as f64 <= scale * whole as f64 + slack
        };
        inside(x, width, self.width) && inside(y, height, self.height)
    }

    /// The camera of a cut-out of `scale` × this frame whose pixel (0, 0) is (`x`, `y`) there.
    pub fn cropped(&self, x: f64, y: f64, scale: f64, width: usize, height: usize) -> Self {
        let (lens, pose) = (self.lens.cropped(x, y, scale), self.pose.clone());
        Self { width, height, lens, pose }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_reaches_half_a_pixel_beyond_the_outermost_centres() {
        let lens = Lens::pinhole(4.0, 4, 3);
        let camera = Camera { width: 4, height: 3, lens, pose: Pose::identity() };
        for pixel in [(-0.4, -0.4), (0.0, 0.0), (3.4, 2.4)] {
            assert!(camera.shows(pixel.into()), "{pixel:?}");
        }
        for pixel in [(-0.6, 0.0), (3.6, 0.0), (0.0, 2.6), (f64::NAN, 0.0)] {
            assert!(!camera.shows(pixel.into()), "{pixel:?}");
        }
    }

    #[test]
    fn a_cut_out_lies_in_its_frame() {
        let lens = Lens::pinhole(400.0, 400, 300);
        let camera = Camera { width: 400, height: 300, lens, pose: Pose::identity() };
        let whole = (0.0, 0.0, 1.0, 400, 300);
        for (x, y, scale, width, height) in
            [whole, (300.0, 150.0, 3.0, 900, 750), (-0.3, 0.0, 0.5, 200, 150)]
        {
            assert!(camera.holds_cut_out(x, y, scale, width, height), "{x} {y}");
        }
        let unknown = (f64::NAN, 0.0, 1.0, 4, 3);
        for (x, y, scale, width, height) in [
            (-10.0, 0.0, 1.0, 40, 30),
            (390.0, 0.0, 1.0, 40, 30),
            (0.0, 0.0, 0.5, 400, 300),
            unknown,
        ] {
            assert!(!camera.holds_cut_out(x, y, scale, width, height), "{x} {y}");
        }
    }

    #[test]
    fn ray_passes_through_the_point_it_shows() {
        let eye = DVec3::new(0.3, 1.5, 2.0);
        let camera = Camera {
            width: 960,
            height: 640,
            lens: Lens {
                distortion: Distortion::BrownConrady {
                    k1: -0.1,
                    k2: 0.03,
                    p1: 6e-4,
                    p2: -4e-4,
                    k3: 0.0,
                },
                ..Lens::pinhole(940.0, 960, 640)
            },
            pose: Pose::look_at(eye, DVec3::ZERO, DVec3::Y).unwrap(),
        };
        let point = DVec3::new(0.2, 0.1, -0.3);
        let (origin, direction) = camera.ray(camera.project_world(point).unwrap()).unwrap();
        let miss = (point - origin).cross(direction).length();
        assert!(miss < 1e-11, "misses by {miss} m");
        assert!((point - origin).dot(direction) > 0.0);
    }
}
