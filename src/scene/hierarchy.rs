//! A file's nodes and what hangs on them, before and after they are put in their places.
//!
//! Meshes come from the file in their node's frame; a [`Model`](super::Model) holds them in the
//! file's. What moves is put there anew for every time, from the corners as they were read, so that
//! no frame hangs on another.

use std::path::Path;

use glam::{DAffine3, DVec3, DVec4};

use super::animation::{Keyframes, unit};
use super::assemble::{normal_matrix, transform_normals, transform_tangents, turned};
use super::{ModelMesh, SceneError};

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
pub(super) struct Part {
    /// Index into [`Hierarchy::nodes`].
    pub node: usize,
    /// Its place in the file, for warnings.
    pub place: String,
    pub mesh: ModelMesh,
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
            parts.filter_map(|part| Some((part.node, part.box_corners()?))).collect();
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

impl Part {
    /// Memory it takes, bytes.
    pub fn n_bytes(&self) -> usize {
        let Self { place, mesh, .. } = self;
        size_of::<Self>()
            + place.len()
            + size_of_val(&mesh.positions[..])
            + size_of_val(&mesh.normals[..])
            + size_of_val(&mesh.uvs[..])
            + size_of_val(&mesh.second_uvs[..])
            + size_of_val(&mesh.tangents[..])
            + size_of_val(&mesh.colours[..])
            + size_of_val(&mesh.triangles[..])
    }

    /// Corners of the box of what can be used of it; `None` of nothing.
    fn box_corners(&self) -> Option<[DVec3; 8]> {
        let corners = self.mesh.triangles.iter().flatten();
        let finite = corners.map(|&i| self.mesh.positions[i as usize]).filter(|p| p.is_finite());
        let ends = finite.map(|p| [p, p]).reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])])?;
        let corner = |i: usize| DVec3::new(ends[i & 1].x, ends[i >> 1 & 1].y, ends[i >> 2 & 1].z);
        Some(std::array::from_fn(corner))
    }

    /// The mesh in the file's frame, mended there: what a transform flattens has no area.
    pub fn placed(self, file_from_node: &DAffine3, warnings: &mut Vec<String>) -> ModelMesh {
        let Self { place, mut mesh, .. } = self;
        let matrix = file_from_node.matrix3;
        for position in &mut mesh.positions {
            *position = file_from_node.transform_point3(*position);
        }
        mesh.normals = transform_normals(&mesh.normals, normal_matrix(&matrix));
        mesh.tangents = transform_tangents(&mesh.tangents, &matrix);
        mesh.triangles = turned(&mesh.triangles, matrix.determinant() < 0.0);
        mesh.mend(&place, warnings);
        mesh
    }
}
