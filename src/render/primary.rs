//! Camera rays through the calibrated lens, one box per pixel.
//!
//! Directions at the corners of a block's pixels are unprojected (Newton in `camera`) when its first ray
//! is asked for, and a sample inside a pixel is interpolated between its four corners, in the plane at
//! unit distance: exact for a pinhole, and off by less than 10⁻⁴ px for the distortion of a lens of 1000 px
//! focal length. The plate itself is never warped, and what is not looked at costs nothing.

use std::sync::OnceLock;

use glam::{DVec2, DVec3, Vec3};

use super::guides::{Block, TILE};
use super::world::PartBall;
use crate::camera::Camera;
use crate::scene::Bounds;
use crate::trace::Ray;

/// Rays of a camera's pixels.
pub struct Primary {
    camera: Camera,
    axis: DVec3,
    /// All the frame looks forward: directions are of length 1 along the axis, else of unit length.
    forward: bool,
    /// World directions at the corners of a block's pixels, row by row, by block.
    blocks: Vec<OnceLock<Box<[Vec3]>>>,
    eye: Vec3,
}

/// The rays of a block, and of a pixel around it, lie between these planes through the eye.
struct Pyramid {
    eye: Vec3,
    /// Into it.
    normals: [Vec3; 4],
}

impl Primary {
    /// `eye` is the camera's position relative to the scene's origin.
    pub fn new(camera: &Camera, eye: Vec3) -> Self {
        let axis = camera.pose.world_from_camera.matrix3 * -DVec3::Z;
        let n_blocks = camera.width.div_ceil(TILE) * camera.height.div_ceil(TILE);
        Self {
            axis,
            forward: looks_forward(camera, axis),
            blocks: (0..n_blocks).map(|_| OnceLock::new()).collect(),
            camera: camera.clone(),
            eye,
        }
    }

    /// World direction at the upper left corner of a pixel; zero where the lens has none.
    fn corner(&self, x: usize, y: usize) -> Vec3 {
        let pixel = DVec2::new(x as f64 - 0.5, y as f64 - 0.5);
        match self.camera.ray(pixel) {
            Some((_, d)) if self.forward => (d / d.dot(self.axis)).as_vec3(),
            Some((_, d)) => d.as_vec3(),
            None => Vec3::ZERO,
        }
    }

    /// The ray through the point (u, v) in [0, 1]² of a pixel's box; `None` outside the lens.
    pub fn ray(&self, x: usize, y: usize, u: f32, v: f32) -> Option<Ray> {
        let (left, top) = (x - x % TILE, y - y % TILE);
        let block = y / TILE * self.camera.width.div_ceil(TILE) + x / TILE;
        let width = TILE.min(self.camera.width - left);
        let corners = self.blocks[block].get_or_init(|| {
            let bottom = (top + TILE).min(self.camera.height);
            let row = |y| (left..=left + width).map(move |x| self.corner(x, y));
            (top..=bottom).flat_map(row).collect()
        });
        let at = |x: usize, y: usize| corners[(y - top) * (width + 1) + x - left];
        let corners = [at(x, y), at(x + 1, y), at(x, y + 1), at(x + 1, y + 1)];
        if corners.contains(&Vec3::ZERO) {
            return None;
        }
        Some(self.along(corners[0].lerp(corners[1], u).lerp(corners[2].lerp(corners[3], u), v)))
    }

    /// The ray through a pixel's centre, for pixels of blocks that may never be looked at again.
    pub fn ray_once(&self, x: usize, y: usize) -> Option<Ray> {
        let (_, direction) = self.camera.ray(DVec2::new(x as f64, y as f64))?;
        Some(self.along(direction.as_vec3()))
    }

    fn along(&self, direction: Vec3) -> Ray {
        Ray { origin: self.eye, direction: direction.normalize(), t_min: 0.0, t_max: f32::INFINITY }
    }

    /// Whether a ray of a block of pixels may meet one of the balls, as seen from `eye`.
    pub fn meets(&self, block: &Block, balls: &[PartBall], eye: Vec3) -> bool {
        self.cone(block).is_none_or(|(axis, angle)| {
            balls.iter().any(|ball| {
                let to = ball.centre - eye;
                let distance = to.length();
                distance <= ball.radius
                    || axis.angle_between(to) <= angle + (ball.radius / distance).asin() + 1e-3
            })
        })
    }

    /// A cone around all rays of a block of pixels: axis and half angle, radians. `None` where the
    /// lens has no ray for its outline or the block spans too wide.
    fn cone(&self, block: &Block) -> Option<(Vec3, f32)> {
        /// Between the points of the outline a lens may bulge by less than this share.
        const BULGE: f32 = 1.02;
        let Block { x, y, width, height } = *block;
        let across = [x, x + width / 2, x + width];
        let down = [y, y + height / 2, y + height];
        let outline = down.iter().flat_map(|&y| across.iter().map(move |&x| (x, y)));
        let directions: Vec<Vec3> = outline.map(|(x, y)| self.corner(x, y)).collect();
        if directions.contains(&Vec3::ZERO) {
            return None;
        }
        let axis = (directions[0].normalize() + directions[8].normalize()).try_normalize()?;
        let angle = directions.iter().map(|d| axis.angle_between(*d)).fold(0.0, f32::max) * BULGE;
        (angle < 1.0).then_some((axis, angle))
    }

    /// Whether a ray of a block of pixels may meet one of the boxes.
    pub fn may_show(&self, block: &Block, boxes: &[Bounds]) -> bool {
        self.pyramid(block).is_none_or(|pyramid| boxes.iter().any(|b| pyramid.may_meet(b)))
    }

    /// `None` where the lens has no ray for a corner or the block spans too wide.
    fn pyramid(&self, block: &Block) -> Option<Pyramid> {
        let (left, top) = (block.x as f64 - 1.5, block.y as f64 - 1.5);
        let (wide, high) = (block.width as f64 + 2.0, block.height as f64 + 2.0);
        let mut corners = [DVec3::ZERO; 4];
        for (corner, (u, v)) in corners.iter_mut().zip([(0., 0.), (1., 0.), (1., 1.), (0., 1.)]) {
            *corner = self.camera.ray(DVec2::new(left + u * wide, top + v * high))?.1;
        }
        let middle = corners.iter().sum::<DVec3>().try_normalize()?;
        if corners.iter().any(|corner| corner.dot(middle) < 0.5) {
            return None;
        }
        let normals = std::array::from_fn(|i| {
            let normal = corners[i].cross(corners[(i + 1) % 4]);
            (normal * normal.dot(middle).signum()).normalize_or_zero().as_vec3()
        });
        Some(Pyramid { eye: self.eye, normals })
    }
}

impl Pyramid {
    fn may_meet(&self, bounds: &Bounds) -> bool {
        let (centre, half) = (bounds.centre() - self.eye, 0.5 * (bounds.max - bounds.min));
        self.normals.iter().all(|normal| normal.dot(centre) + normal.abs().dot(half) >= 0.0)
    }
}

/// Whether all of a frame lies well before the plane across the camera's axis.
///
/// Looked at along a lattice: how far a lens looks aside changes little from one of its points to the next.
fn looks_forward(camera: &Camera, axis: DVec3) -> bool {
    const POINTS: usize = 128;
    let step = (camera.width.min(camera.height) / POINTS).max(1);
    let along = |size: usize| (0..size).step_by(step).chain([size]);
    along(camera.height).all(|y| {
        along(camera.width).all(|x| {
            let ray = camera.ray(DVec2::new(x as f64 - 0.5, y as f64 - 0.5));
            ray.is_none_or(|(_, direction)| direction.dot(axis) > 0.05)
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{Distortion, Lens, Pose};

    #[test]
    fn interpolated_rays_are_those_of_the_lens() {
        let mut lens = Lens::pinhole(1000.0, 1200, 800);
        lens.distortion =
            Distortion::BrownConrady { k1: -0.12, k2: 0.05, p1: 1e-3, p2: -5e-4, k3: 0.0 };
        let pose = Pose::look_at(DVec3::new(1.0, 2.0, 3.0), DVec3::ZERO, DVec3::Y).unwrap();
        let camera = Camera { width: 1200, height: 800, lens, pose };
        let primary = Primary::new(&camera, camera.pose.position().as_vec3());
        for (x, y) in [(0, 0), (1199, 799), (600, 400), (50, 700)] {
            for (u, v) in [(0.5, 0.5), (0.25, 0.9)] {
                let ray = primary.ray(x, y, u, v).unwrap();
                let pixel =
                    DVec2::new(x as f64 - 0.5 + f64::from(u), y as f64 - 0.5 + f64::from(v));
                let (_, exact) = camera.ray(pixel).unwrap();
                let off = ray.direction.as_dvec3().angle_between(exact) * 1000.0;
                // f32 directions of ±6e-8 at 1000 px focal length alone are 1e-4 px.
                assert!(off < 3e-4, "({x}, {y}): {off} px");
            }
        }
    }
}
