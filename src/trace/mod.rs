//! Ray → hit: acceleration structure and ray kernel, nothing of light.
//!
//! [`Mesh`](crate::scene::Mesh)es → [`Accel`]; [`Ray`] → [`Hit`]. This room never shades.

use glam::Vec3;

/// A half-open piece of a line: points `origin + t · direction` with `t_min < t < t_max`.
#[derive(Clone, Copy, Debug)]
pub struct Ray {
    pub origin: Vec3,
    /// Unit length.
    pub direction: Vec3,
    pub t_min: f32,
    pub t_max: f32,
}

/// Where a ray first met a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    pub t: f32,
    /// Which of the meshes the structure was built from.
    pub mesh: u32,
    /// Which triangle of that mesh.
    pub triangle: u32,
    /// Barycentric weights of the triangle's second and third vertex.
    pub u: f32,
    pub v: f32,
}
