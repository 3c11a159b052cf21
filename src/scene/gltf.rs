//! glTF 2.0 (`.glb`, `.gltf`) → [`Model`].
//!
//! Read: nodes with their transforms, triangle lists, strips and fans, normals, two sets of texture
//! coordinates, tangents, vertex colours, sparse accessors, materials with the extensions of
//! [`SUPPORTED`](super::gltf_extensions::SUPPORTED), and an animation of the nodes if it is asked for.
//! Skins and morph targets stay in their rest pose, with a warning; points, lines, cameras and lights
//! are left out. Nothing outside the file's own folder is opened.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::{DAffine3, DMat4, DVec3, DVec4, Vec2, Vec3, Vec4};
use gltf::Semantic;
use gltf::json::Value;
use gltf::mesh::Mode;

use super::budget::Budget;
use super::buffers::{Buffers, Container, MAX_ELEMENTS, named_file, split};
use super::files::read_file;
use super::gltf_animation::{self, mark_channels_without_node};
use super::gltf_extensions::{may_be_required, names, remarks};
use super::gltf_instances::{self, INSTANCING};
use super::gltf_material::MaterialReader;
use super::gltf_place;
use super::hierarchy::{Hierarchy, Local, Moves, Node, Part, Shape, arrange};
use super::model::Played;
use super::{Model, ModelMesh, SceneError};

/// Reads the default scene of a glTF file (the first if none is named), at rest.
pub fn read(path: &Path) -> Result<Model, SceneError> {
    read_with(path, None)
}

/// As [`read`], with the animation of a name, or the first, for [`Model::at_time`].
///
/// # Errors
/// Also what is broken in that animation; [`SceneError::NoAnimation`] if none is called so.
pub fn read_played(path: &Path, animation: Option<&str>) -> Result<Model, SceneError> {
    read_with(path, Some(animation))
}

/// `animation`: whether one is read, and which.
fn read_with(path: &Path, animation: Option<Option<&str>>) -> Result<Model, SceneError> {
    let bytes = read_file(path)?;
    let Container { json, binary, warnings } = split(path, &bytes)?;
    let (document, extension_warnings) = parse(path, json)?;
    let budget = Budget::new(path, bytes.len());
    let buffers = Buffers::read(path, &document, binary, &budget)?;
    let name = path.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
    let mut reader = Reader {
        path,
        materials: MaterialReader::new(path, &document, &buffers),
        buffers: &buffers,
        material_numbers: Vec::new(),
        model: Model {
            name,
            files: files(path, &document),
            warnings,
            animations: gltf_animation::names(&document),
            ..Model::default()
        },
        hierarchy: Hierarchy::default(),
        shapes: HashMap::new(),
        n_vertices: 0,
    };
    reader.model.warnings.extend(extension_warnings);
    reader.scene(&document)?;
    if let Some(asked) = animation {
        reader.play(&document, asked)?;
    }
    reader.finish()
}

/// The file itself and those its buffers and images name.
fn files(path: &Path, document: &gltf::Document) -> Vec<PathBuf> {
    // The JSON itself: the crate's own reading of an image ends the program where it has no type.
    let json = document.as_json();
    let buffers = json.buffers.iter().filter_map(|buffer| buffer.uri.as_deref());
    let images = json.images.iter().filter_map(|image| image.uri.as_deref());
    let named = buffers.chain(images).filter_map(|uri| named_file(path, uri));
    std::iter::once(path.to_owned()).chain(named).collect()
}

/// The validated document, and warnings about extensions that are used but not read.
fn parse(path: &Path, json: &[u8]) -> Result<(gltf::Document, Vec<String>), SceneError> {
    let broken = |place: &str, problem: String| SceneError::Broken {
        path: path.into(),
        place: place.into(),
        problem,
    };
    let mut value: Value =
        gltf::json::deserialize::from_slice(json).map_err(|e| broken("JSON", e.to_string()))?;
    if let Some(name) = names(&value, "extensionsRequired").find(|name| !may_be_required(name)) {
        return Err(SceneError::RequiredExtension { path: path.into(), name: name.into() });
    }
    let warnings = remarks(&value);
    // Judged above; the crate's own list is shorter than what is read here.
    if let Some(object) = value.as_object_mut() {
        object.remove("extensionsRequired");
    }
    mark_channels_without_node(&mut value);
    // Exporters forget them, the crate insists, nobody here reads them: bounds of the positions.
    let accessors = value.get_mut("accessors").and_then(Value::as_array_mut).into_iter().flatten();
    for accessor in accessors.filter_map(Value::as_object_mut) {
        for key in ["min", "max"] {
            accessor.insert(key.into(), Value::from(vec![0.0; 3]));
        }
    }
    let root: gltf::json::Root = <gltf::json::Root as serde::Deserialize>::deserialize(&value)
        .map_err(|e| broken(&gltf_place::of_wrong_type(&value), e.to_string()))?;
    drop(value);
    // The crate's validation looks the positions up before it has judged their number.
    for (i, mesh) in root.meshes.iter().enumerate() {
        let accessors = mesh.primitives.iter().flat_map(|primitive| primitive.attributes.values());
        if let Some(bad) = accessors.map(|a| a.value()).find(|&a| a >= root.accessors.len()) {
            let problem = format!("accessor {bad} of {}", root.accessors.len());
            return Err(broken(&format!("meshes[{i}]"), problem));
        }
    }
    let document = gltf::Document::from_json(root).map_err(|error| match error {
        gltf::Error::Validation(problems) => {
            let first = problems.first();
            let place = first.map_or("JSON", |(place, _)| place.as_str());
            let problem = first.map_or(String::new(), |(_, problem)| problem.to_string());
            let more = problems.len().saturating_sub(1);
            broken(place, format!("{problem} (and {more} more)"))
        }
        other => broken("JSON", other.to_string()),
    })?;
    Ok((document, warnings))
}

struct Reader<'a> {
    path: &'a Path,
    buffers: &'a Buffers<'a>,
    materials: MaterialReader<'a>,
    /// glTF's number (`None` = the default material) of each material read.
    material_numbers: Vec<Option<usize>>,
    model: Model,
    hierarchy: Hierarchy,
    /// What each mesh is, by its number.
    shapes: HashMap<usize, Vec<Arc<Shape>>>,
    n_vertices: usize,
}

/// Memory that one more place of a mesh takes at least, bytes.
const PLACE_BYTES: usize = 1024;

impl Reader<'_> {
    fn scene(&mut self, document: &gltf::Document) -> Result<(), SceneError> {
        let Some(scene) = document.default_scene().or_else(|| document.scenes().next()) else {
            self.model.warnings.push("it has no scene".into());
            return Ok(());
        };
        let mut pending: Vec<_> = scene.nodes().map(|node| (node, None)).collect();
        pending.reverse();
        let mut visited = vec![false; document.nodes().len()];
        while let Some((node, parent)) = pending.pop() {
            // A tree visits each node once; anything else is a cycle or a second parent.
            if std::mem::replace(&mut visited[node.index()], true) {
                let problem = "it is its own ancestor or has two parents".into();
                return Err(self.broken(format!("nodes[{}]", node.index()), problem));
            }
            let (number, rest) = (node.index(), local_transform(&node));
            self.hierarchy.nodes.push(Node { number, parent, rest, moves: Moves::default() });
            let own = self.hierarchy.nodes.len() - 1;
            if let Some(mesh) = node.mesh() {
                let first = self.hierarchy.parts.len();
                self.mesh(&node, &mesh, own)?;
                let places = gltf_instances::places(self.path, document, &node, self.buffers)?;
                if let Some(places) = places {
                    self.repeat(first, own, &places)?;
                }
            }
            let first = pending.len();
            pending.extend(node.children().map(|child| (child, Some(own))));
            pending[first..].reverse();
        }
        Ok(())
    }

    /// Reads an animation and gives the nodes of the scene what it does to them.
    fn play(&mut self, document: &gltf::Document, asked: Option<&str>) -> Result<(), SceneError> {
        let mut read = gltf_animation::read(self.path, document, self.buffers, asked)?;
        self.model.warnings.append(&mut read.warnings);
        for node in &mut self.hierarchy.nodes {
            node.moves = read.moves.remove(&node.number).unwrap_or_default();
        }
        Ok(())
    }

    /// Puts the parts from `first` on at these places in their node, once for each.
    fn repeat(&mut self, first: usize, node: usize, places: &[Local]) -> Result<(), SceneError> {
        let parts = self.hierarchy.parts.split_off(first);
        let Node { number, .. } = self.hierarchy.nodes[node];
        let what = format!("nodes[{number}].extensions.{INSTANCING}");
        let size = size_of::<Node>() + PLACE_BYTES * parts.len();
        self.buffers.budget.take(places.len(), size, &what)?;
        for &rest in places {
            let moves = Moves::default();
            self.hierarchy.nodes.push(Node { number, parent: Some(node), rest, moves });
            let own = self.hierarchy.nodes.len() - 1;
            self.hierarchy.parts.extend(parts.iter().map(|p| Part { node: own, ..p.clone() }));
        }
        Ok(())
    }

    /// Hangs a mesh on a node, reading it the first time.
    fn mesh(&mut self, node: &gltf::Node, mesh: &gltf::Mesh, own: usize) -> Result<(), SceneError> {
        let name = mesh.name().or(node.name()).unwrap_or_default();
        // glTF ignores the node's transform for skinned meshes only together with the joints';
        // without them the node's is the best guess.
        if node.skin().is_some() {
            let place = mesh_place(mesh);
            self.warn(format!("{place}: its skin is ignored, it keeps the pose it is stored in"));
        }
        if !self.shapes.contains_key(&mesh.index()) {
            let read = self.shapes(mesh)?;
            self.shapes.insert(mesh.index(), read);
        }
        let shapes = self.shapes.get(&mesh.index()).into_iter().flatten();
        let parts = shapes.map(|shape| Part { node: own, name: name.into(), shape: shape.clone() });
        self.hierarchy.parts.extend(parts);
        Ok(())
    }

    /// What a mesh is made of.
    fn shapes(&mut self, mesh: &gltf::Mesh) -> Result<Vec<Arc<Shape>>, SceneError> {
        let place = mesh_place(mesh);
        if mesh.primitives().any(|p| p.morph_targets().len() > 0) {
            self.warn(format!("{place}: its morph targets are ignored"));
        }
        let mut shapes = Vec::new();
        for primitive in mesh.primitives() {
            let place = format!("{place}.primitives[{}]", primitive.index());
            if let Some(read) = self.primitive(&primitive, &place)? {
                for set in self.model.materials[read.material].uv_sets() {
                    if [&read.uvs, &read.second_uvs][set].is_empty() {
                        self.warn(format!(
                            "{place}: no TEXCOORD_{set} for its textures; one texel covers it all"
                        ));
                    }
                }
                shapes.push(Arc::new(Shape { place, mesh: read }));
            }
        }
        Ok(shapes)
    }

    fn primitive(
        &mut self,
        primitive: &gltf::Primitive,
        place: &str,
    ) -> Result<Option<ModelMesh>, SceneError> {
        if matches!(primitive.mode(), Mode::Points | Mode::Lines | Mode::LineLoop | Mode::LineStrip)
        {
            self.warn(format!("{place}: {:?} have no surface and are left out", primitive.mode()));
            return Ok(None);
        }
        let Some(positions) = primitive.get(&Semantic::Positions) else {
            self.warn(format!("{place}: it has no positions and is left out"));
            return Ok(None);
        };
        self.count_vertices(positions.count(), place)?;
        let positions = self.buffers.floats::<3>(&positions, "positions")?;
        let indices = match primitive.indices() {
            Some(accessor) => {
                self.count_vertices(accessor.count() / 3, place)?;
                let indices = self.buffers.indices(&accessor)?;
                let n = positions.len();
                if let Some(bad) = indices.iter().find(|&&i| i as usize >= n) {
                    let place = format!("accessors[{}] (indices of {place})", accessor.index());
                    return Err(self.broken(place, format!("index {bad} into {n} positions")));
                }
                indices
            }
            None => (0..positions.len() as u32).collect(),
        };
        let triangles = triangles(primitive.mode(), &indices);
        let left_over = match primitive.mode() {
            Mode::Triangles => indices.len() % 3,
            _ => 0,
        };
        if left_over > 0 {
            self.warn(format!("{place}: {left_over} indices make no triangle and are left out"));
        }
        let n = positions.len();
        let colours = match self.attribute(primitive, Semantic::Colors(0), n, place) {
            Some(a) if a.dimensions().multiplicity() == 3 => {
                let rgb = self.buffers.floats::<3>(&a, "vertex colours")?;
                rgb.into_iter().map(|c| Vec3::from(c).extend(1.0)).collect()
            }
            Some(a) => vectors(self.buffers.floats::<4>(&a, "vertex colours")?, Vec4::from),
            None => Vec::new(),
        };
        let normals = match self.attribute(primitive, Semantic::Normals, n, place) {
            Some(accessor) => vectors(self.buffers.floats(&accessor, "normals")?, Vec3::from),
            None => Vec::new(),
        };
        let tangents = match self.attribute(primitive, Semantic::Tangents, n, place) {
            Some(accessor) => vectors(self.buffers.floats(&accessor, "tangents")?, Vec4::from),
            None => Vec::new(),
        };
        let mut uv_set = |set| match self.attribute(primitive, Semantic::TexCoords(set), n, place) {
            Some(accessor) => {
                let uvs = self.buffers.floats(&accessor, "texture coordinates")?;
                Ok(vectors(uvs, Vec2::from))
            }
            None => Ok::<_, SceneError>(Vec::new()),
        };
        let (uvs, second_uvs) = (uv_set(0)?, uv_set(1)?);
        Ok(Some(ModelMesh {
            name: String::new(),
            positions: vectors(positions, |p| DVec3::from(p.map(f64::from))),
            normals,
            uvs,
            second_uvs,
            tangents,
            colours,
            triangles,
            material: self.material(&primitive.material())?,
        }))
    }

    /// The accessor of an attribute, if it has a value for each of `n` positions: one that has not is
    /// of no use, and never read.
    fn attribute<'d>(
        &mut self,
        primitive: &gltf::Primitive<'d>,
        semantic: Semantic,
        n: usize,
        place: &str,
    ) -> Option<gltf::Accessor<'d>> {
        let accessor = primitive.get(&semantic)?;
        if accessor.count() == n {
            return Some(accessor);
        }
        let name = match semantic {
            Semantic::Normals => "normals",
            Semantic::Tangents => "tangents",
            Semantic::Colors(_) => "vertex colours",
            Semantic::TexCoords(0) => "texture coordinates",
            _ => "second texture coordinates",
        };
        let found = accessor.count();
        self.warn(format!("{place}: {found} {name} for {n} positions; {name} are left out"));
        None
    }

    /// The number of a material among those read, reading it the first time.
    fn material(&mut self, material: &gltf::Material) -> Result<usize, SceneError> {
        let number = material.index();
        if let Some(known) = self.material_numbers.iter().position(|&n| n == number) {
            return Ok(known);
        }
        let read = self.materials.material(material)?;
        self.model.materials.push(read);
        self.material_numbers.push(number);
        Ok(self.model.materials.len() - 1)
    }

    /// Counts what a node makes, so that many nodes cannot make a small file fill the memory.
    fn count_vertices(&mut self, n: usize, place: &str) -> Result<(), SceneError> {
        self.n_vertices = self.n_vertices.saturating_add(n);
        if self.n_vertices <= MAX_ELEMENTS {
            return Ok(());
        }
        Err(SceneError::TooLarge {
            path: self.path.into(),
            place: place.into(),
            found: format!("the {}th vertex or triangle", self.n_vertices),
            limit: MAX_ELEMENTS.to_string(),
            remedy: "simplify the mesh or split it into several files",
        })
    }

    /// Puts the meshes in their places at rest; what moves keeps them as they were read besides.
    fn finish(mut self) -> Result<Model, SceneError> {
        self.model.textures = self.materials.textures;
        self.model.warnings.extend(self.materials.warnings);
        let placed = self.hierarchy.file_from_nodes(None, self.path)?;
        let parts = if self.hierarchy.moves() {
            let hierarchy = Arc::new(self.hierarchy);
            let warnings = self.model.warnings.clone();
            self.model.played = Some(Played { hierarchy: hierarchy.clone(), warnings });
            hierarchy.parts.clone()
        } else {
            self.hierarchy.parts
        };
        // Held by the parts alone now: what is copied for the last time is taken instead.
        drop(self.shapes);
        let Model { materials, warnings, .. } = &mut self.model;
        let arranged = arrange(parts, &placed, materials, self.path, warnings)?;
        (self.model.meshes, self.model.repeats) = (arranged.meshes, arranged.repeats);
        self.model.conclude();
        Ok(self.model)
    }

    fn warn(&mut self, warning: String) {
        self.model.warnings.push(warning);
    }

    fn broken(&self, place: String, problem: String) -> SceneError {
        SceneError::Broken { path: self.path.into(), place, problem }
    }
}

fn mesh_place(mesh: &gltf::Mesh) -> String {
    match mesh.name() {
        Some(name) => format!("meshes[{}] {name:?}", mesh.index()),
        None => format!("meshes[{}]", mesh.index()),
    }
}

fn vectors<const N: usize, T>(values: Vec<[f32; N]>, of: impl Fn([f32; N]) -> T) -> Vec<T> {
    values.into_iter().map(of).collect()
}

fn local_transform(node: &gltf::Node) -> Local {
    use gltf::scene::Transform;
    match node.transform() {
        Transform::Matrix { matrix } => {
            let matrix = DMat4::from_cols_array_2d(&matrix.map(|c| c.map(f64::from)));
            Local::Matrix(DAffine3::from_mat4(matrix))
        }
        Transform::Decomposed { translation, rotation, scale } => Local::Apart {
            translation: DVec3::from(translation.map(f64::from)),
            rotation: DVec4::from(rotation.map(f64::from)),
            scale: DVec3::from(scale.map(f64::from)),
        },
    }
}

/// Triangles of a list, strip or fan (glTF 2.0, 3.7.2.1); every other one of a strip is turned.
fn triangles(mode: Mode, indices: &[u32]) -> Vec<[u32; 3]> {
    match mode {
        Mode::TriangleStrip => indices
            .windows(3)
            .enumerate()
            .map(|(i, w)| if i % 2 == 0 { [w[0], w[1], w[2]] } else { [w[0], w[2], w[1]] })
            .collect(),
        Mode::TriangleFan => {
            let Some((&hub, rim)) = indices.split_first() else { return Vec::new() };
            rim.windows(2).map(|w| [w[0], w[1], hub]).collect()
        }
        _ => indices.as_chunks::<3>().0.to_vec(),
    }
}
