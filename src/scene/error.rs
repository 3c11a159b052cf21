//! What can be wrong with a scene file.

use std::path::PathBuf;

/// Why a mesh file could not be read. Every message names the file, what was found and what to do.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    #[error("{}: cannot be read: {source}", path.display())]
    Read { path: PathBuf, source: std::io::Error },
    #[error("{}: not a mesh file Platelight knows; give a .glb, .gltf or .obj", path.display())]
    UnknownFormat { path: PathBuf },
    /// A file that is damaged or breaks its format's rules.
    #[error("{}: {place}: {problem}; export it again", path.display())]
    Broken { path: PathBuf, place: String, problem: String },
    #[error("{}: {place} needs {found}, more than the {limit} this program reads; {remedy}", path.display())]
    TooLarge { path: PathBuf, place: String, found: String, limit: String, remedy: &'static str },
    #[error("{}: requires the glTF extension {name}, which is not supported; export without it", path.display())]
    RequiredExtension { path: PathBuf, name: String },
    /// `known` says which there are.
    #[error("{}: there is no animation {asked:?}; {known}", path.display())]
    NoAnimation { path: PathBuf, asked: String, known: String },
    /// A corner that, once placed, lies where f32 has no room for triangles.
    #[error(
        "model {model:?}: mesh {mesh:?}: a corner lies {distance_m:e} m from the world's origin, \
         more than the {limit_m:e} m this program reads; check the model's units, its scale and place"
    )]
    TooFar { model: String, mesh: String, distance_m: f64, limit_m: f64 },
    /// A file named by another file that cannot be used.
    #[error("{}: {place} names {uri:?}: {problem}", path.display())]
    Reference { path: PathBuf, place: String, uri: String, problem: String },
    #[error("{}: {place}: {problem}; give a PNG or JPEG picture", path.display())]
    Picture { path: PathBuf, place: String, problem: String },
}
