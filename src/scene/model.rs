//! [`Model`]: a mesh file in memory, before it is placed.

use std::collections::hash_map::{DefaultHasher, Entry};
use std::collections::{BTreeSet, HashMap};
use std::hash::{Hash, Hasher};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::{DAffine3, DMat3, DVec3, Vec2, Vec3, Vec4};

use super::assemble::{normal_matrix, transform_normals, transform_tangents, turned};
use super::buffers::MAX_ELEMENTS;
use super::hierarchy::{Hierarchy, Part, arrange};
use super::{Material, SceneError, Texture};
use crate::conventions::FARTHEST_M;

/// What a glTF or OBJ file holds, in the file's own coordinates (metres, f64).
#[derive(Clone, Debug, Default)]
pub struct Model {
    /// The file's name without folder and extension.
    pub name: String,
    /// Every file it is made from, the named one first: material libraries, buffers, pictures. Those
    /// that were named and not found are among them, since the model changes when they appear.
    pub files: Vec<PathBuf>,
    pub meshes: Vec<ModelMesh>,
    /// Some of the meshes once more, where many copies would fill the memory.
    pub repeats: Vec<Repeat>,
    /// Never empty if `meshes` is not.
    pub materials: Vec<Material>,
    pub textures: Vec<Texture>,
    /// What was left out or mended while reading, for the report; each says how much.
    pub warnings: Vec<String>,
    /// Names of the file's animations.
    pub animations: Vec<String>,
    /// What moves in it, if it was read to be played and anything does.
    pub played: Option<Played>,
}

/// A mesh of a model at another place of it.
#[derive(Clone, Copy, Debug)]
pub struct Repeat {
    /// Index into [`Model::meshes`].
    pub mesh: usize,
    /// Takes the mesh's points to where they are once more; it has an inverse.
    pub moved: DAffine3,
}

/// A model's nodes and meshes before they were put in their places: see [`Model::at_time`].
#[derive(Clone, Debug)]
pub struct Played {
    pub(super) hierarchy: Arc<Hierarchy>,
    /// Those of reading, without those of a place.
    pub(super) warnings: Vec<String>,
}

/// As [`Mesh`](super::Mesh), positions in f64.
///
/// # Guarantees
/// Those of [`Mesh`](super::Mesh); `material` is an index into [`Model::materials`].
#[derive(Clone, Debug, Default)]
pub struct ModelMesh {
    pub name: String,
    pub positions: Vec<DVec3>,
    pub normals: Vec<Vec3>,
    pub uvs: Vec<Vec2>,
    pub second_uvs: Vec<Vec2>,
    pub tangents: Vec<Vec4>,
    pub colours: Vec<Vec4>,
    pub triangles: Vec<[u32; 3]>,
    pub material: usize,
}

impl Model {
    /// All that can be seen, repeated ones too.
    pub fn n_triangles(&self) -> usize {
        self.places().map(|(mesh, _)| mesh.triangles.len()).sum()
    }

    /// Those that take memory.
    pub fn n_held_triangles(&self) -> usize {
        self.meshes.iter().map(|mesh| mesh.triangles.len()).sum()
    }

    /// Every mesh at each of its places, with what takes it there in the model's frame.
    fn places(&self) -> impl Iterator<Item = (&ModelMesh, DAffine3)> {
        let once = self.meshes.iter().map(|mesh| (mesh, DAffine3::IDENTITY));
        once.chain(self.repeats.iter().map(|repeat| (&self.meshes[repeat.mesh], repeat.moved)))
    }

    /// The model with a copy of the mesh for every repetition.
    ///
    /// # Errors
    /// [`SceneError::TooLarge`] where the copies are too many.
    pub fn flattened(mut self) -> Result<Self, SceneError> {
        let n: usize = self.places().map(|(m, _)| m.positions.len() + m.triangles.len()).sum();
        if n > MAX_ELEMENTS && !self.repeats.is_empty() {
            return Err(SceneError::TooLarge {
                path: self.path().into(),
                place: "a copy of its meshes for each of their places".into(),
                found: format!("{n} vertices and triangles"),
                limit: MAX_ELEMENTS.to_string(),
                remedy: "simplify it: only objects are held once for all their places",
            });
        }
        for Repeat { mesh, moved } in std::mem::take(&mut self.repeats) {
            let mut copy = self.meshes[mesh].clone();
            copy.transform(&moved);
            self.meshes.push(copy);
        }
        Ok(self)
    }

    /// Lower and upper corner of the world box of all triangles once placed; `None` without any.
    pub fn bounds(&self, world_from_model: &DAffine3) -> Option<[DVec3; 2]> {
        let mut bounds: Option<[DVec3; 2]> = None;
        for (mesh, moved) in self.places() {
            let world_from_mesh = *world_from_model * moved;
            for &index in mesh.triangles.iter().flatten() {
                let p = world_from_mesh.transform_point3(mesh.positions[index as usize]);
                let [min, max] = bounds.unwrap_or([p, p]);
                bounds = Some([min.min(p), max.max(p)]);
            }
        }
        bounds
    }

    /// As [`Model::bounds`], of all that the model's animation passes; a turning part counts with its
    /// box. The same at every time. That of the model itself if nothing moves.
    pub fn swept_bounds(&self, world_from_model: &DAffine3) -> Option<[DVec3; 2]> {
        let Some(played) = &self.played else { return self.bounds(world_from_model) };
        played.hierarchy.swept_bounds(world_from_model, self.path())
    }

    /// The model as it stands at a time of the animation it was read with, seconds; before the first
    /// key and after the last it stands still. Itself if nothing moves. Meshes that are scaled to nothing
    /// are not there.
    ///
    /// Made from the file's own corners: no time hangs on the one shown before.
    ///
    /// # Errors
    /// [`SceneError::Broken`] names a node whose transform is not finite then.
    pub fn at_time(&self, time_s: f64) -> Result<Self, SceneError> {
        let Some(played) = &self.played else { return Ok(self.clone()) };
        let hierarchy = &played.hierarchy;
        let placed = hierarchy.file_from_nodes(Some(time_s), self.path())?;
        let mut warnings = played.warnings.clone();
        // Scaled to nothing is how animations hide things: no news.
        let is_seen = |part: &&Part| !flattens_all(&placed[part.node].matrix3);
        let parts = hierarchy.parts.iter().filter(is_seen).cloned().collect();
        let arranged = arrange(parts, &placed, &self.materials, self.path(), &mut warnings)?;
        let mut model = Self {
            name: self.name.clone(),
            files: self.files.clone(),
            meshes: arranged.meshes,
            repeats: arranged.repeats,
            materials: self.materials.clone(),
            textures: self.textures.clone(),
            warnings,
            animations: self.animations.clone(),
            played: self.played.clone(),
        };
        model.mend_solids();
        model.tell_once();
        Ok(model)
    }

    /// The file that was named.
    fn path(&self) -> &Path {
        self.files.first().map_or(Path::new(""), PathBuf::as_path)
    }

    /// What is told once all meshes are in their places.
    pub(super) fn conclude(&mut self) {
        self.mend_solids();
        if self.n_triangles() == 0 {
            self.warnings.push("it holds no triangles: nothing of it can be seen".into());
        }
        self.tell_once();
    }

    /// Each sentence once.
    fn tell_once(&mut self) {
        let mut seen = BTreeSet::new();
        self.warnings.retain(|warning| seen.insert(warning.clone()));
    }
}

impl Model {
    /// Whether all of it has room in the world once placed.
    ///
    /// # Errors
    /// [`SceneError::TooFar`] names the first mesh with a corner beyond [`FARTHEST_M`], or at no place at all.
    pub fn check_place(&self, world_from_model: &DAffine3) -> Result<(), SceneError> {
        for (mesh, moved) in self.places() {
            let world_from_mesh = *world_from_model * moved;
            let distances =
                mesh.positions.iter().map(|&p| world_from_mesh.transform_point3(p).length());
            // NaN too is not near enough.
            if let Some(distance_m) = distances.into_iter().find(|d| !(*d <= FARTHEST_M)) {
                let (model, mesh) = (self.name.clone(), mesh.name.clone());
                return Err(SceneError::TooFar { model, mesh, distance_m, limit_m: FARTHEST_M });
            }
        }
        Ok(())
    }

    /// Turns solids (refracting materials) inside out that were exported so, and warns of open ones.
    ///
    /// A ray knows by the winding whether it enters or leaves glass: an inverted bowl would bend
    /// light as an air bubble in glass does, an open one would let it in and not out.
    pub(super) fn mend_solids(&mut self) {
        let Self { meshes, materials, warnings, .. } = self;
        for mesh in meshes.iter_mut() {
            let material = &materials[mesh.material];
            if !material.solid || material.transmission == 0.0 {
                continue;
            }
            let n_open = mesh.open_edges();
            if n_open > 0 {
                warnings.push(format!(
                    "{:?} refracts but is not closed ({n_open} open edges): light that goes in \
                     there does not come out right",
                    mesh.name
                ));
            } else if mesh.signed_volume() < 0.0 {
                for triangle in &mut mesh.triangles {
                    triangle.swap(1, 2);
                }
                warnings.push(format!("{:?} refracts and was inside out; it is turned", mesh.name));
            }
        }
    }
}

/// True if no triangle keeps an area.
fn flattens_all(matrix: &DMat3) -> bool {
    let [x, y, z] = [matrix.x_axis, matrix.y_axis, matrix.z_axis];
    [x.cross(y), y.cross(z), z.cross(x)].iter().all(|&normal| normal == DVec3::ZERO)
}

impl ModelMesh {
    /// Takes it to another place; what the place flattens loses its normals.
    pub(super) fn transform(&mut self, moved: &DAffine3) {
        for position in &mut self.positions {
            *position = moved.transform_point3(*position);
        }
        self.normals = transform_normals(&self.normals, normal_matrix(&moved.matrix3));
        self.tangents = transform_tangents(&self.tangents, &moved.matrix3);
        self.triangles = turned(&self.triangles, moved.matrix3.determinant() < 0.0);
    }

    /// Edges that no neighbour goes along in the other direction; 0 of a closed, evenly wound mesh.
    ///
    /// Corners at the same place are one, whatever their normals and texture coordinates.
    fn open_edges(&self) -> usize {
        let mut places: HashMap<[u64; 3], u32> = HashMap::new();
        let place_of: Vec<u32> = self
            .positions
            .iter()
            .map(|p| {
                let next = places.len() as u32;
                // + 0.0 makes −0 and 0 one place.
                *places.entry(p.to_array().map(|x| (x + 0.0).to_bits())).or_insert(next)
            })
            .collect();
        let mut balance: HashMap<(u32, u32), i32> = HashMap::new();
        for triangle in &self.triangles {
            let corners = triangle.map(|i| place_of[i as usize]);
            for (from, to) in [(0, 1), (1, 2), (2, 0)].map(|(i, j)| (corners[i], corners[j])) {
                let turn = if from < to { 1 } else { -1 };
                *balance.entry((from.min(to), from.max(to))).or_insert(0) += turn;
            }
        }
        balance.values().filter(|&&sum| sum != 0).count()
    }

    /// Volume that a closed mesh holds, negative if its corners run clockwise seen from outside.
    fn signed_volume(&self) -> f64 {
        let Some(&origin) = self.positions.first() else { return 0.0 };
        let volume = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|i| self.positions[i as usize] - origin);
            a.cross(b).dot(c) / 6.0
        };
        self.triangles.iter().map(volume).sum()
    }

    /// Makes the guarantees true after reading: drops what cannot be used and says what it was.
    ///
    /// `place` names the mesh in the warnings. Indices must already be in range.
    pub(super) fn mend(&mut self, place: &str, warnings: &mut Vec<String>) {
        let n = self.positions.len();
        let mut drop_attribute = |name: &str, length: usize| {
            if length != 0 && length != n {
                warnings.push(format!(
                    "{place}: {length} {name} for {n} positions; {name} are left out"
                ));
                return true;
            }
            false
        };
        if drop_attribute("normals", self.normals.len()) {
            self.normals.clear();
        }
        if drop_attribute("texture coordinates", self.uvs.len()) {
            self.uvs.clear();
        }
        if drop_attribute("second texture coordinates", self.second_uvs.len()) {
            self.second_uvs.clear();
        }
        if drop_attribute("tangents", self.tangents.len()) {
            self.tangents.clear();
        }
        if drop_attribute("vertex colours", self.colours.len()) {
            self.colours.clear();
        }

        self.drop_unusable_triangles(place, warnings);
        self.mend_normals(place, warnings);
        mend_values(&mut self.uvs, Vec2::is_finite, Vec2::ZERO);
        mend_values(&mut self.second_uvs, Vec2::is_finite, Vec2::ZERO);
        mend_values(&mut self.tangents, Vec4::is_finite, Vec4::ZERO);
        mend_values(&mut self.colours, Vec4::is_finite, Vec4::ONE);
        self.drop_repeated_triangles(place, warnings);
    }

    /// Triangles with a corner that is not finite, and those without area, hide nothing.
    fn drop_unusable_triangles(&mut self, place: &str, warnings: &mut Vec<String>) {
        let before = self.triangles.len();
        let positions = &self.positions;
        let finite = |t: &[u32; 3]| t.iter().all(|&i| positions[i as usize].is_finite());
        self.triangles.retain(finite);
        let n_infinite = before - self.triangles.len();
        let has_area = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|i| positions[i as usize]);
            (b - a).cross(c - a) != DVec3::ZERO
        };
        self.triangles.retain(has_area);
        let n_flat = before - n_infinite - self.triangles.len();
        mend_values(&mut self.positions, DVec3::is_finite, DVec3::ZERO);
        if n_infinite > 0 {
            warnings.push(format!(
                "{place}: {n_infinite} of {before} triangles have a corner that is not a finite \
                 number; they are left out"
            ));
        }
        if n_flat > 0 {
            warnings.push(format!(
                "{place}: {n_flat} of {before} triangles have no area; they are left out"
            ));
        }
    }

    /// The same triangle again, with the same corners in the same turn and all that hangs on them,
    /// shows nothing new, and thousands in one place cannot be parted by any tree: every ray there
    /// would be tested against all of them. The first stays. One that is wound the other way is
    /// another triangle.
    fn drop_repeated_triangles(&mut self, place: &str, warnings: &mut Vec<String>) {
        let before = self.triangles.len();
        let marks: Vec<u64> = (0..self.positions.len()).map(|v| self.vertex_hash(v)).collect();
        let mut firsts: HashMap<[u64; 3], [u32; 3]> = HashMap::with_capacity(before);
        let mut triangles = std::mem::take(&mut self.triangles);
        triangles.retain(|&triangle| {
            let mut turned = triangle;
            let least = (0..3).min_by_key(|&k| marks[triangle[k] as usize]).unwrap_or(0);
            turned.rotate_left(least);
            match firsts.entry(turned.map(|i| marks[i as usize])) {
                Entry::Vacant(place) => {
                    place.insert(turned);
                    true
                }
                // Equal marks may be chance.
                Entry::Occupied(first) => {
                    let corners = first.get().iter().zip(turned);
                    !corners.into_iter().all(|(&a, b)| self.same_vertex(a as usize, b as usize))
                }
            }
        });
        let n_repeated = before - triangles.len();
        self.triangles = triangles;
        if n_repeated > 0 {
            warnings.push(format!(
                "{place}: {n_repeated} of {before} triangles are exact copies of others; they are \
                 left out"
            ));
        }
    }

    /// A number that equal vertices share, and different ones hardly ever.
    fn vertex_hash(&self, vertex: usize) -> u64 {
        let mut hasher = DefaultHasher::new();
        let mut add = |values: &[f32]| values.iter().for_each(|v| v.to_bits().hash(&mut hasher));
        let [x, y, z] = self.positions[vertex].to_array();
        // The low bits of survey coordinates are not in an f32: equal vertices are told apart later.
        add(&[x as f32, y as f32, z as f32]);
        self.normals.get(vertex).inspect(|v| add(&v.to_array()));
        self.uvs.get(vertex).inspect(|v| add(&v.to_array()));
        hasher.finish()
    }

    fn same_vertex(&self, a: usize, b: usize) -> bool {
        fn same<T: PartialEq>(values: &[T], a: usize, b: usize) -> bool {
            values.get(a) == values.get(b)
        }
        a == b
            || same(&self.positions, a, b)
                && same(&self.normals, a, b)
                && same(&self.uvs, a, b)
                && same(&self.second_uvs, a, b)
                && same(&self.tangents, a, b)
                && same(&self.colours, a, b)
    }

    fn mend_normals(&mut self, place: &str, warnings: &mut Vec<String>) {
        let (mut unusable, mut off_length) = (0, 0);
        for normal in &mut self.normals {
            let length = normal.length();
            // Half-float and byte normals are off by up to 1 %: no news.
            if !length.is_finite() || length < 1e-6 {
                unusable += 1;
                *normal = Vec3::ZERO;
            } else {
                off_length += usize::from((length - 1.0).abs() > 0.02);
                *normal /= length;
            }
        }
        let n = self.normals.len();
        if unusable > 0 {
            warnings.push(format!(
                "{place}: {unusable} of {n} normals are zero or not finite; the faces are flat there"
            ));
        }
        if off_length > 0 {
            warnings.push(format!(
                "{place}: {off_length} of {n} normals are not of unit length; their direction is used"
            ));
        }
    }
}

fn mend_values<T: Copy>(values: &mut [T], is_finite: impl Fn(T) -> bool, instead: T) {
    for value in values {
        if !is_finite(*value) {
            *value = instead;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn glass_tetrahedron() -> Model {
        let material = Material { transmission: 1.0, solid: true, ..Material::default() };
        // Corners doubled as exporters do it for flat normals.
        let corners = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
        let faces = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];
        let mut mesh = ModelMesh::default();
        for face in faces {
            let first = mesh.positions.len() as u32;
            mesh.positions.extend(face.map(|i: usize| corners[i]));
            mesh.triangles.push([first, first + 1, first + 2]);
        }
        Model { meshes: vec![mesh], materials: vec![material], ..Model::default() }
    }

    #[test]
    fn glass_that_is_inside_out_is_turned_and_open_glass_is_told() {
        let mut good = glass_tetrahedron();
        good.mend_solids();
        assert!(good.warnings.is_empty(), "{:?}", good.warnings);
        assert!((good.meshes[0].signed_volume() - 1.0 / 6.0).abs() < 1e-12);

        let mut inverted = glass_tetrahedron();
        inverted.meshes[0].triangles.iter_mut().for_each(|t| t.swap(0, 1));
        inverted.mend_solids();
        assert!(inverted.warnings[0].contains("inside out"), "{:?}", inverted.warnings);
        assert!(inverted.meshes[0].signed_volume() > 0.0);

        let mut open = glass_tetrahedron();
        open.meshes[0].triangles.pop();
        open.mend_solids();
        assert!(open.warnings[0].contains("3 open edges"), "{:?}", open.warnings);
    }

    #[test]
    fn exact_copies_of_triangles_are_dropped_and_told_and_others_stay() {
        let corners = [DVec3::ZERO, DVec3::X, DVec3::Y];
        let mut mesh = ModelMesh {
            // The corners once more, and once with another normal at one of them.
            positions: [corners, corners, corners].concat(),
            normals: vec![Vec3::Z; 9],
            triangles: [vec![[0, 1, 2]; 5000], vec![[3, 4, 5], [1, 2, 3]]].concat(),
            ..ModelMesh::default()
        };
        mesh.normals[8] = Vec3::X;
        mesh.triangles.extend([[0, 2, 1], [6, 7, 8]]);
        let mut warnings = Vec::new();
        mesh.mend("card", &mut warnings);
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 1], [6, 7, 8]]);
        assert!(
            warnings[0].contains("card: 5001 of 5004 triangles are exact copies"),
            "{warnings:?}"
        );
        // A hair apart in f64, the same in f32.
        let mut near = ModelMesh {
            positions: [corners, corners.map(|p| p + DVec3::splat(1e-15))].concat(),
            triangles: vec![[0, 1, 2], [3, 4, 5]],
            ..ModelMesh::default()
        };
        near.mend("card", &mut Vec::new());
        assert_eq!(near.triangles.len(), 2);
    }

    #[test]
    fn opaque_things_may_be_open() {
        let mut model = glass_tetrahedron();
        model.materials[0].transmission = 0.0;
        model.meshes[0].triangles.pop();
        model.mend_solids();
        assert!(model.warnings.is_empty());
    }
}
