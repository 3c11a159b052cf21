//! Ray → hit: acceleration structure and ray kernel, nothing of light.
//!
//! [`Mesh`](crate::scene::Mesh)es → [`Accel`]; [`Ray`] → [`Hit`]. This room never shades.
//!
//! The hit of a ray is a property of the triangles alone: the triangle test is watertight and its
//! decisions do not depend on the order of the visit, the tree, the number of threads or the
//! instruction set. The tree only skips boxes that cannot hold a hit. Of instances that holds within
//! the rounding that [`Accel`] states.

pub mod accel;
mod crowd;
mod instances;
mod kernel;
#[cfg(test)]
mod test_meshes;
mod traverse;
mod triangle;
mod wide;

pub use accel::Accel;
pub use traverse::portable_only;

use glam::Vec3;

/// A half-open piece of a line: points `origin + t · direction` with `t_min < t < t_max`.
#[derive(Clone, Copy, Debug)]
pub struct Ray {
    pub origin: Vec3,
    /// Unit length: then `t` is a distance. Any other finite length is legal, and `t` counts in it.
    pub direction: Vec3,
    /// Not negative; a negative value counts as 0.
    pub t_min: f32,
    pub t_max: f32,
}

impl Ray {
    /// The whole half-line from `origin` along `direction` (unit length).
    pub fn new(origin: Vec3, direction: Vec3) -> Self {
        Self { origin, direction, t_min: 0.0, t_max: f32::INFINITY }
    }

    /// The point at distance `t`.
    pub fn at(&self, t: f32) -> Vec3 {
        self.origin + self.direction * t
    }
}

/// Where a ray first met a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    pub t: f32,
    /// Which of the meshes the structure was built from; after them, which of its instances.
    pub mesh: u32,
    /// Which triangle of that mesh.
    pub triangle: u32,
    /// Barycentric weights of the triangle's second and third vertex.
    pub u: f32,
    pub v: f32,
}
