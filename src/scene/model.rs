//! [`Model`]: a mesh file in memory, before it is placed.

use glam::{DAffine3, DVec3, Vec2, Vec3, Vec4};

use super::{Material, Texture};

/// What a glTF or OBJ file holds, in the file's own coordinates (metres, f64).
#[derive(Clone, Debug, Default)]
pub struct Model {
    /// The file's name without folder and extension.
    pub name: String,
    pub meshes: Vec<ModelMesh>,
    /// Never empty if `meshes` is not.
    pub materials: Vec<Material>,
    pub textures: Vec<Texture>,
    /// What was left out or mended while reading, for the report; each says how much.
    pub warnings: Vec<String>,
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
    pub fn n_triangles(&self) -> usize {
        self.meshes.iter().map(|mesh| mesh.triangles.len()).sum()
    }

    /// Lower and upper corner of the world box of all triangles once placed; `None` without any.
    pub fn bounds(&self, world_from_model: &DAffine3) -> Option<[DVec3; 2]> {
        let mut bounds: Option<[DVec3; 2]> = None;
        for mesh in &self.meshes {
            for &index in mesh.triangles.iter().flatten() {
                let p = world_from_model.transform_point3(mesh.positions[index as usize]);
                let [min, max] = bounds.unwrap_or([p, p]);
                bounds = Some([min.min(p), max.max(p)]);
            }
        }
        bounds
    }
}

impl ModelMesh {
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
