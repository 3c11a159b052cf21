//! A file's nodes and what hangs on them, before and after they are put in their places.
//!
//! Meshes come from the file in their node's frame; a [`Model`](super::Model) holds them in the
//! file's. What moves is put there anew for every time, from the corners as they were read, so that
//! no frame hangs on another.

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use glam::{DAffine3, DVec3, DVec4, Vec3};

use super::animation::{Keyframes, unit};
use super::assemble::normal_matrix;
use super::buffers::MAX_ELEMENTS;
use super::instance::is_tame;
use super::{Material, ModelMesh, Repeat, SceneError};

/// Steps from the first key to the last at which the box of a motion is taken. Who asks for it wants to
/// know how far things get, to a few per cent.
const MOMENTS: u32 = 128;

/// Nodes, the meshes in their frames, and what moves the nodes.
#[derive(Clone, Debug, Default)]
pub struct Hierarchy {
    /// Parents before their children.
    pub(super) nodes: Vec<Node>,
    pub(super) parts: Vec<Part>,
}

/// One node of the tree.
#[derive(Clone, Debug)]
pub(super) struct Node {
    /// Its number in the file.
    pub number: usize,
    /// Index into [`Hierarchy::nodes`], below its own.
    pub parent: Option<usize>,
    pub rest: Local,
    pub moves: Moves,
}

/// Where a node stands in its parent.
#[derive(Clone, Copy, Debug)]
pub(super) enum Local {
    Matrix(DAffine3),
    /// Scaled, then turned (a quaternion of any length), then moved.
    Apart {
        translation: DVec3,
        rotation: DVec4,
        scale: DVec3,
    },
}

/// What an animation does to a node.
#[derive(Clone, Debug, Default)]
pub(super) struct Moves {
    pub translation: Option<Keyframes<DVec3>>,
    pub rotation: Option<Keyframes<DVec4>>,
    pub scale: Option<Keyframes<DVec3>>,
}

/// A mesh in its node's frame.
#[derive(Clone, Debug)]
pub(super) struct Shape {
    /// Its place in the file, for warnings.
    pub place: String,
    pub mesh: ModelMesh,
}

/// What hangs on a node.
#[derive(Clone, Debug)]
pub(super) struct Part {
    /// Index into [`Hierarchy::nodes`].
    pub node: usize,
    /// The mesh's name, or the node's.
    pub name: String,
    /// Shared by all nodes that have this mesh.
    pub shape: Arc<Shape>,
}

impl Local {
    fn parent_from_node(self) -> DAffine3 {
        match self {
            Self::Matrix(matrix) => matrix,
            Self::Apart { translation, rotation, scale } => {
                DAffine3::from_scale_rotation_translation(scale, unit(rotation), translation)
            }
        }
    }

    /// The same with what `moves` says of it at a time. Matrices stay: glTF forbids to move them.
    fn at(self, moves: &Moves, time_s: f64) -> Self {
        match self {
            Self::Matrix(_) => self,
            Self::Apart { translation, rotation, scale } => Self::Apart {
                translation: moves.translation.as_ref().map_or(translation, |t| t.at(time_s)),
                rotation: moves.rotation.as_ref().map_or(rotation, |r| r.at(time_s)),
                scale: moves.scale.as_ref().map_or(scale, |s| s.at(time_s)),
            },
        }
    }
}

impl Moves {
    pub fn is_none(&self) -> bool {
        self.spans().next().is_none()
    }

    /// First and last key of each property, seconds.
    fn spans(&self) -> impl Iterator<Item = [f64; 2]> {
        let vectors = [&self.translation, &self.scale].into_iter().flatten();
        vectors.map(Keyframes::span_s).chain(self.rotation.iter().map(Keyframes::span_s))
    }
}

impl Hierarchy {
    /// Whether anything of it moves.
    pub fn moves(&self) -> bool {
        self.nodes.iter().any(|node| !node.moves.is_none())
    }

    /// First and last key of all, seconds; `None` if nothing moves.
    pub fn span_s(&self) -> Option<[f64; 2]> {
        let spans = self.nodes.iter().flat_map(|node| node.moves.spans());
        spans.reduce(|[a, b], [c, d]| [a.min(c), b.max(d)])
    }

    /// What takes each node's points to the file's, at a time of the animation or at rest.
    ///
    /// # Errors
    /// [`SceneError::Broken`] names the first node whose transform is not finite.
    pub(super) fn file_from_nodes(
        &self,
        time_s: Option<f64>,
        path: &Path,
    ) -> Result<Vec<DAffine3>, SceneError> {
        let mut placed: Vec<DAffine3> = Vec::with_capacity(self.nodes.len());
        for node in &self.nodes {
            let local = time_s.map_or(node.rest, |time_s| node.rest.at(&node.moves, time_s));
            let parent = node.parent.map_or(DAffine3::IDENTITY, |parent| placed[parent]);
            let file_from_node = parent * local.parent_from_node();
            if !file_from_node.is_finite() {
                let when = time_s.map_or(String::new(), |time_s| format!(" at {time_s} s"));
                return Err(SceneError::Broken {
                    path: path.into(),
                    place: format!("nodes[{}]", node.number),
                    problem: format!("its transform is not finite{when}"),
                });
            }
            placed.push(file_from_node);
        }
        Ok(placed)
    }

    /// Lower and upper corner of the world box of all parts, all through the animation; of each part the
    /// box in its node's frame counts. `None` of nothing.
    pub(super) fn swept_bounds(
        &self,
        world_from_model: &DAffine3,
        path: &Path,
    ) -> Option<[DVec3; 2]> {
        let [first, last] = self.span_s()?;
        let parts = self.parts.iter();
        let corners: Vec<(usize, [DVec3; 8])> =
            parts.filter_map(|part| Some((part.node, part.shape.box_corners()?))).collect();
        let mut bounds: Option<[DVec3; 2]> = None;
        for k in 0..=MOMENTS {
            let time_s = first + (last - first) * f64::from(k) / f64::from(MOMENTS);
            // A node that is nowhere at this time is told of when this time is shown.
            let Ok(placed) = self.file_from_nodes(Some(time_s), path) else { continue };
            for (node, corners) in &corners {
                let world_from_node = *world_from_model * placed[*node];
                for p in corners.map(|corner| world_from_node.transform_point3(corner)) {
                    let [min, max] = bounds.unwrap_or([p, p]);
                    bounds = Some([min.min(p), max.max(p)]);
                }
            }
        }
        bounds
    }
}

impl Shape {
    /// Corners of the box of what can be used of it; `None` of nothing.
    fn box_corners(&self) -> Option<[DVec3; 8]> {
        let corners = self.mesh.triangles.iter().flatten();
        let finite = corners.map(|&i| self.mesh.positions[i as usize]).filter(|p| p.is_finite());
        let ends = finite.map(|p| [p, p]).reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])])?;
        let corner = |i: usize| DVec3::new(ends[i & 1].x, ends[i >> 1 & 1].y, ends[i >> 2 & 1].z);
        Some(std::array::from_fn(corner))
    }
}

impl Part {
    /// The mesh in the file's frame, mended there: what a transform flattens has no area.
    fn placed(self, file_from_node: &DAffine3, warnings: &mut Vec<String>) -> ModelMesh {
        let Shape { place, mut mesh } = Arc::unwrap_or_clone(self.shape);
        mesh.name = self.name;
        mesh.transform(file_from_node);
        mesh.mend(&place, warnings);
        mesh
    }
}

/// Meshes of fewer triangles are copied: a place takes as much memory as three of them.
const LEAST_TRIANGLES: usize = 64;
/// Copies of fewer triangles in all are no matter: 4 MB.
const LEAST_SAVED: usize = 1 << 14;

/// Meshes in the file's frame, and where they are once more.
#[derive(Default)]
pub(super) struct Arranged {
    pub meshes: Vec<ModelMesh>,
    pub repeats: Vec<Repeat>,
}

/// Puts parts in their places: copies, or where those would be many and large the same once more.
///
/// What shines is copied: its triangles are drawn from a list of all.
///
/// # Errors
/// [`SceneError::TooLarge`] where the copies are too many.
pub(super) fn arrange(
    parts: Vec<Part>,
    file_from_nodes: &[DAffine3],
    materials: &[Material],
    path: &Path,
    warnings: &mut Vec<String>,
) -> Result<Arranged, SceneError> {
    let mut uses: HashMap<*const Shape, usize> = HashMap::new();
    for part in &parts {
        *uses.entry(Arc::as_ptr(&part.shape)).or_default() += 1;
    }
    // Where the mesh is that others repeat, and what took it there.
    let mut firsts: HashMap<*const Shape, (usize, DAffine3)> = HashMap::new();
    let mut arranged = Arranged::default();
    let mut n_elements = 0;
    for part in parts {
        let file_from_node = &file_from_nodes[part.node];
        let (key, mesh) = (Arc::as_ptr(&part.shape), &part.shape.mesh);
        let n = mesh.triangles.len();
        let pays = n >= LEAST_TRIANGLES
            && n.saturating_mul(uses[&key] - 1) >= LEAST_SAVED
            && materials[mesh.material].emissive == Vec3::ZERO;
        if let Some((mesh, first)) = firsts.get(&key) {
            let moved = *file_from_node * first.inverse();
            if is_tame(&moved) {
                arranged.repeats.push(Repeat { mesh: *mesh, moved });
                continue;
            }
        } else if pays && normal_matrix(&file_from_node.matrix3).is_some() {
            firsts.insert(key, (arranged.meshes.len(), *file_from_node));
        }
        n_elements += mesh.positions.len() + n;
        if n_elements > MAX_ELEMENTS {
            return Err(SceneError::TooLarge {
                path: path.into(),
                place: part.shape.place.clone(),
                found: format!("the {n_elements}th vertex or triangle, copies counted"),
                limit: MAX_ELEMENTS.to_string(),
                remedy: "simplify the mesh or split it into several files",
            });
        }
        arranged.meshes.push(part.placed(file_from_node, warnings));
    }
    Ok(arranged)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Model;
    use crate::scene::gltf_tests::{floats, read_with};

    /// Columns and rows of corners of a sheet of as many triangles as pay if they are saved once.
    const LARGE: [usize; 2] = [91, 95];

    fn n_triangles([columns, rows]: [usize; 2]) -> usize {
        2 * (columns - 1) * (rows - 1)
    }

    /// A sheet in all these nodes, of a material.
    fn read_sheet(size: [usize; 2], nodes: &str, material: &str) -> Model {
        let [columns, rows] = size;
        let corner = |i: usize| [(i % columns) as f32, (i / columns) as f32, 0.0];
        let mut buffer = floats((0..columns * rows).map(corner).collect::<Vec<_>>().as_flattened());
        let n_bytes = buffer.len();
        let mut n_indices = 0;
        for first in (0..columns * (rows - 1)).filter(|i| (i + 1) % columns != 0) {
            let quad = [0, 1, columns, 1, columns + 1, columns].map(|i| (first + i) as u16);
            buffer.extend(quad.iter().flat_map(|i| i.to_le_bytes()));
            n_indices += quad.len();
        }
        let body = format!(
            r#""nodes":[{{"children":[1,2,3]}},{nodes}],
            "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}},"indices":1,"material":0}}]}}],
            "materials":[{{{material}}}],"accessors":[
            {{"bufferView":0,"componentType":5126,"count":{},"type":"VEC3"}},
            {{"bufferView":1,"componentType":5123,"count":{n_indices},"type":"SCALAR"}}],
            "bufferViews":[{{"buffer":0,"byteLength":{n_bytes}}},
            {{"buffer":0,"byteOffset":{n_bytes},"byteLength":{}}}]"#,
            columns * rows,
            2 * n_indices
        );
        read_with(&body, &buffer).expect("a good file")
    }

    const THREE: &str = r#"{"mesh":0,"translation":[1,2,3]},{"mesh":0,"scale":[-1,2,1],"name":"b"},
        {"mesh":0,"rotation":[0,1,0,0]}"#;

    #[test]
    fn what_many_nodes_have_is_held_once_and_stands_where_copies_would() {
        let model = read_sheet(LARGE, THREE, "");
        let n = n_triangles(LARGE);
        assert_eq!((model.meshes.len(), model.repeats.len()), (1, 2));
        assert_eq!((model.n_triangles(), model.n_held_triangles()), (3 * n, n));
        // What shines is copied, and as a copy everything is where its node has it.
        let copies = read_sheet(LARGE, THREE, r#""emissiveFactor":[1,1,1]"#);
        assert_eq!((copies.meshes.len(), copies.repeats.len()), (3, 0));
        assert_eq!(copies.meshes[1].positions[1], DVec3::NEG_X);
        assert_eq!(copies.meshes[1].name, "b");
        let flat = model.flattened().unwrap();
        for (a, b) in flat.meshes.iter().zip(&copies.meshes) {
            assert_eq!(a.triangles, b.triangles);
            let off = a.positions.iter().zip(&b.positions).map(|(a, b)| a.distance(*b));
            assert!(off.fold(0.0, f64::max) < 1e-12);
        }
    }

    #[test]
    fn a_place_that_flattens_is_a_copy_and_told_and_none_repeats_it() {
        let nodes = r#"{"mesh":0,"scale":[1,0,0]},{"mesh":0},{"mesh":0,"scale":[50,50,50]}"#;
        let model = read_sheet(LARGE, nodes, "");
        let n = n_triangles(LARGE);
        assert_eq!((model.meshes.len(), model.repeats.len()), (3, 0));
        assert_eq!(model.n_triangles(), 2 * n);
        let told = format!("{n} of {n} triangles have no area");
        assert!(
            model.warnings.len() == 1 && model.warnings[0].contains(&told),
            "{:?}",
            model.warnings
        );
    }

    #[test]
    fn few_copies_stay_copies() {
        let nodes = r#"{"mesh":0},{"mesh":0},{}"#;
        for (size, held) in [(LARGE, (1, 1)), ([91, 91], (2, 0))] {
            assert_eq!(n_triangles(size) >= LEAST_SAVED, held == (1, 1));
            let model = read_sheet(size, nodes, "");
            assert_eq!((model.meshes.len(), model.repeats.len()), held);
        }
    }
}
