//! What stands in the world: meshes, materials, inserted objects and the modelled local scene.
//!
//! glTF and OBJ files → [`Model`] ([`read`], [`read_played`] with what moves in it) → [`Scene`] (objects ·
//! local things); a point of it → [`Surface`]. Start with [`Scene::add_object`]. This room never traces
//! or lights.

pub mod animation;
pub mod assemble;
pub mod bounds;
mod budget;
mod buffers;
mod error;
#[cfg(test)]
mod file_tests;
mod files;
pub mod gltf;
mod gltf_animation;
#[cfg(test)]
mod gltf_animation_tests;
pub mod gltf_extensions;
mod gltf_instances;
mod gltf_layers;
mod gltf_material;
mod gltf_place;
#[cfg(test)]
mod gltf_tests;
pub mod hierarchy;
pub mod instance;
pub mod layers;
pub mod material;
pub mod mesh;
pub mod model;
mod mtl;
pub mod obj;
mod polygon;
pub mod surface;
pub mod texture;

pub use bounds::Bounds;
pub use error::SceneError;
pub use instance::{Instance, PlacedMesh};
pub use layers::{Clearcoat, Sheen};
pub use material::{AlphaMode, Material, SurfaceParameters, TextureRef};
pub use mesh::Mesh;
pub use model::{Model, ModelMesh, Repeat};
pub use surface::{Place, Surface};
pub use texture::{Texture, Wrap};

use std::path::Path;

use glam::DVec3;

/// All geometry of a shot, in one frame close to the objects.
///
/// Mesh positions are f32 metres relative to `origin`, so that a place far from the world's origin
/// keeps its millimetres. Axes are the world's.
#[derive(Clone, Debug, Default)]
pub struct Scene {
    /// World point that is (0, 0, 0) of every mesh.
    pub origin: DVec3,
    /// The inserted things: they exist only in the world *with*.
    pub objects: Vec<Mesh>,
    /// Meshes of `objects` at more places; hits number them after `objects`, see [`Scene::object`].
    pub instances: Vec<Instance>,
    /// The modelled real things: they exist in both worlds.
    pub local: Vec<LocalMesh>,
    pub materials: Vec<Material>,
    pub textures: Vec<Texture>,
    /// Names of the placed objects, one an [`Scene::add_object`].
    pub object_names: Vec<String>,
    /// Names of the placed local things, one an [`Scene::add_local`] or [`Scene::add_plane`].
    pub local_names: Vec<String>,
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

/// Reads a mesh file by its extension: `.glb`, `.gltf` or `.obj`. What moves in it is at rest.
pub fn read(path: &Path) -> Result<Model, SceneError> {
    match Format::of(path)? {
        Format::Gltf => gltf::read(path),
        Format::Obj => obj::read(path),
    }
}

/// As [`read`], with the animation called so, or the first: see [`Model::at_time`].
///
/// # Errors
/// As [`read`]; [`SceneError::NoAnimation`] if none is called so. A file without any is at rest.
pub fn read_played(path: &Path, animation: Option<&str>) -> Result<Model, SceneError> {
    match (Format::of(path)?, animation) {
        (Format::Gltf, _) => gltf::read_played(path, animation),
        (Format::Obj, None) => obj::read(path),
        (Format::Obj, Some(asked)) => Err(gltf_animation::no_animation(path, asked, &[])),
    }
}

enum Format {
    Gltf,
    Obj,
}

impl Format {
    fn of(path: &Path) -> Result<Self, SceneError> {
        let extension = path.extension().and_then(|e| e.to_str()).unwrap_or("");
        match extension.to_ascii_lowercase().as_str() {
            "glb" | "gltf" => Ok(Self::Gltf),
            "obj" => Ok(Self::Obj),
            _ => Err(SceneError::UnknownFormat { path: path.into() }),
        }
    }
}
