//! Indexed triangles with one material.

use glam::{Vec2, Vec3, Vec4};

/// Indexed triangles, one material.
///
/// # Guarantees (kept by the readers of this room)
/// Every index is in range, every position is finite, `normals`, `uvs`, `tangents` and `colours` are
/// empty or as long as `positions`.
#[derive(Clone, Debug, Default)]
pub struct Mesh {
    pub name: String,
    /// Metres, relative to [`Scene::origin`](super::Scene::origin).
    pub positions: Vec<Vec3>,
    pub normals: Vec<Vec3>,
    pub uvs: Vec<Vec2>,
    /// glTF tangents: xyz and handedness.
    pub tangents: Vec<Vec4>,
    /// Linear vertex colours.
    pub colours: Vec<Vec4>,
    pub triangles: Vec<[u32; 3]>,
    /// Index into [`Scene::materials`](super::Scene::materials).
    pub material: usize,
}
