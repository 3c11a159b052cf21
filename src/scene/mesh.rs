//! Indexed triangles with one material.

use glam::{Vec2, Vec3, Vec4};

use super::Bounds;

/// Indexed triangles, one material.
///
/// # Guarantees (kept by the readers of this room)
/// Every index is in range, every position is finite, `normals`, `uvs`, `second_uvs`, `tangents` and
/// `colours` are empty or as long as `positions`. Counter-clockwise seen from outside.
#[derive(Clone, Debug, Default)]
pub struct Mesh {
    pub name: String,
    /// Which placed file it came from: index into [`Scene::object_names`](super::Scene::object_names)
    /// or [`Scene::local_names`](super::Scene::local_names).
    pub placed: usize,
    /// Metres, relative to [`Scene::origin`](super::Scene::origin).
    pub positions: Vec<Vec3>,
    /// Unit, or zero where the file's was unusable (the flat normal counts there).
    pub normals: Vec<Vec3>,
    /// (0, 0) is the picture's upper left corner, v down, as in glTF.
    pub uvs: Vec<Vec2>,
    /// glTF's TEXCOORD_1.
    pub second_uvs: Vec<Vec2>,
    /// glTF tangents: xyz and handedness.
    pub tangents: Vec<Vec4>,
    /// Linear vertex colours.
    pub colours: Vec<Vec4>,
    pub triangles: Vec<[u32; 3]>,
    /// Index into [`Scene::materials`](super::Scene::materials).
    pub material: usize,
}

impl Mesh {
    /// Box of all positions.
    pub fn bounds(&self) -> Bounds {
        Bounds::of(self.positions.iter().copied())
    }

    /// Corners of a triangle. Panics outside the mesh.
    pub fn corners(&self, triangle: usize) -> [Vec3; 3] {
        self.triangles[triangle].map(|i| self.positions[i as usize])
    }
}
