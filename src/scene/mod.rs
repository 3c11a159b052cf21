//! What stands in the world: meshes, materials, inserted objects and the modelled local scene.
//!
//! glTF and OBJ files → [`Scene`] (objects · local things). This room never traces or lights.

pub mod bounds;
pub mod material;
pub mod mesh;

pub use bounds::Bounds;
pub use material::{AlphaMode, Material, Texture, TextureRef};
pub use mesh::Mesh;

use glam::DVec3;

/// All geometry of a shot, in one frame close to the objects.
///
/// Mesh positions are f32 metres relative to `origin`, so that a place far from the world's origin
/// keeps its millimetres.
#[derive(Clone, Debug, Default)]
pub struct Scene {
    /// World point that is (0, 0, 0) of every mesh.
    pub origin: DVec3,
    /// The inserted things: they exist only in the world *with*.
    pub objects: Vec<Mesh>,
    /// The modelled real things: they exist in both worlds.
    pub local: Vec<LocalMesh>,
    pub materials: Vec<Material>,
    pub textures: Vec<Texture>,
}

/// A modelled real thing.
#[derive(Clone, Debug)]
pub struct LocalMesh {
    pub mesh: Mesh,
    pub role: LocalRole,
    /// Where its diffuse albedo comes from.
    pub albedo: AlbedoSource,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LocalRole {
    /// The surface the objects stand on.
    Support,
    /// Something near that casts, receives and reflects.
    Prop,
    /// As `Prop`, and it hides objects behind it.
    Holdout,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AlbedoSource {
    /// Solved from the plate where the plate shows it.
    Plate,
    Constant(glam::Vec3),
    /// The file's own material.
    Material,
}
