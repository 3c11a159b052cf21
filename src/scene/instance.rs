//! [`Instance`]: a mesh of the objects once more, without a copy of it.

use glam::{DAffine3, DMat3, Vec3, Vec4};

use super::assemble::{normal_matrix, transform_normal, transform_tangent};
use super::{Mesh, Place, Scene};

/// Places that stretch or shrink more than this (root of the sum of squares of all nine numbers) are
/// copied: the rounding of rays taken into the mesh's frame stays small.
const MOST_STRETCH: f64 = 16.0;

/// A mesh of [`Scene::objects`] at another place of the scene.
///
/// # Guarantees
/// The place has an inverse, and neither stretches nor shrinks by more than a factor of about ten.
#[derive(Clone, Debug)]
pub struct Instance {
    /// Index into [`Scene::objects`].
    pub of: usize,
    /// Takes the mesh's points, which lie in the scene's frame at its first place, to this one.
    pub moved: DAffine3,
    /// Takes its normals, up to length.
    normals: DMat3,
}

impl Instance {
    /// `None` where a copy is better: the place flattens, or stretches or shrinks too much.
    pub fn new(of: usize, moved: DAffine3) -> Option<Self> {
        let normals = normal_matrix(&moved.matrix3).filter(|_| is_tame(&moved))?;
        Some(Self { of, moved, normals })
    }

    /// How many times longer a way may be here than in the mesh's frame, at most.
    pub(super) fn stretch(&self) -> f32 {
        size(&self.moved.matrix3) as f32
    }

    /// True of a mirror image: corners run clockwise seen from outside.
    fn mirrors(&self) -> bool {
        self.moved.matrix3.determinant() < 0.0
    }
}

/// Whether rays may be taken back through such a place: see the guarantees of [`Instance`].
pub(super) fn is_tame(moved: &DAffine3) -> bool {
    moved.is_finite()
        && size(&moved.matrix3) <= MOST_STRETCH
        && size(&moved.matrix3.inverse()) <= MOST_STRETCH
}

/// Root of the sum of the squares: at least the longest that a unit vector becomes.
fn size(matrix: &DMat3) -> f64 {
    matrix.to_cols_array().iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// A mesh at one of its places.
#[derive(Clone, Copy, Debug)]
pub struct PlacedMesh<'a> {
    pub mesh: &'a Mesh,
    /// `None`: where its own corners are.
    pub instance: Option<&'a Instance>,
}

impl<'a> PlacedMesh<'a> {
    /// Corners of a triangle in the scene's frame, in the mesh's own order. Panics outside the mesh.
    pub fn corners(&self, triangle: usize) -> [Vec3; 3] {
        self.mesh.corners(triangle).map(|p| self.point(p))
    }

    /// All positions in the scene's frame.
    pub fn positions(self) -> impl Iterator<Item = Vec3> + 'a {
        self.mesh.positions.iter().map(move |&p| self.point(p))
    }

    fn point(&self, p: Vec3) -> Vec3 {
        match self.instance {
            None => p,
            Some(instance) => instance.moved.transform_point3(p.as_dvec3()).as_vec3(),
        }
    }

    /// −1 where the corners run clockwise seen from outside, else 1.
    pub(super) fn winding(&self) -> f32 {
        if self.instance.is_some_and(Instance::mirrors) { -1.0 } else { 1.0 }
    }

    /// Normals at corners of the mesh; `None` if it has none.
    pub(super) fn normals(&self, corners: [usize; 3]) -> Option<[Vec3; 3]> {
        let normals = &self.mesh.normals;
        let own = (!normals.is_empty()).then(|| corners.map(|i| normals[i]))?;
        let Some(instance) = self.instance else { return Some(own) };
        Some(own.map(|n| transform_normal(n, &instance.normals)))
    }

    /// Tangents at corners of the mesh; `None` if it has none.
    pub(super) fn tangents(&self, corners: [usize; 3]) -> Option<[Vec4; 3]> {
        let tangents = &self.mesh.tangents;
        let own = (!tangents.is_empty()).then(|| corners.map(|i| tangents[i]))?;
        let Some(instance) = self.instance else { return Some(own) };
        Some(own.map(|t| transform_tangent(t, &instance.moved.matrix3)))
    }
}

impl Scene {
    /// The mesh that hits among the objects number so: first [`Scene::objects`], then
    /// [`Scene::instances`]. Panics outside both.
    pub fn object(&self, number: u32) -> PlacedMesh<'_> {
        let number = number as usize;
        match self.objects.get(number) {
            Some(mesh) => PlacedMesh { mesh, instance: None },
            None => {
                let instance = &self.instances[number - self.objects.len()];
                PlacedMesh { mesh: &self.objects[instance.of], instance: Some(instance) }
            }
        }
    }

    /// All of them, in the order of their numbers.
    pub fn all_objects(&self) -> impl Iterator<Item = PlacedMesh<'_>> {
        (0..self.objects.len() + self.instances.len()).map(|number| self.object(number as u32))
    }

    /// The mesh that hits of a list number so. Panics outside it.
    pub fn placed(&self, place: Place, number: u32) -> PlacedMesh<'_> {
        match place {
            Place::Object => self.object(number),
            Place::Local => PlacedMesh { mesh: &self.local[number as usize].mesh, instance: None },
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::{DVec3, EulerRot, Vec2};

    use super::*;
    use crate::photo::Image;
    use crate::scene::{Clearcoat, Material, Model, ModelMesh, Repeat, Texture, TextureRef, Wrap};

    /// A bent sheet with normals, tangents if asked for, coordinates, and normal maps of both layers.
    fn sheet(has_tangents: bool) -> Model {
        let texel = Vec4::new(0.7, 0.4, 0.9, 1.0);
        let texture = Texture::from_linear(Image::filled(1, 1, texel), [Wrap::Repeat; 2]).unwrap();
        let uv_transform = glam::Affine2::IDENTITY;
        let map = || Some(TextureRef { texture: 0, uv_set: 0, uv_transform });
        let coat = Clearcoat { normal_texture: map(), normal_scale: 0.5, ..Clearcoat::default() };
        let material =
            Material { normal_texture: map(), clearcoat: Some(coat), ..Material::default() };
        let tangent = Vec3::new(1.0, 0.2, 0.0).normalize().extend(-1.0);
        let mesh = ModelMesh {
            positions: vec![DVec3::ZERO, DVec3::X, DVec3::new(0.2, 1.0, 0.3), DVec3::ONE],
            normals: [[-0.2, 0.0, 1.0], [0.3, 0.1, 1.0], [0.0, -0.3, 1.0], [0.1, 0.1, 1.0]]
                .map(|n| Vec3::from(n).normalize())
                .to_vec(),
            uvs: vec![Vec2::ZERO, Vec2::X, Vec2::Y, Vec2::ONE],
            tangents: if has_tangents { vec![tangent; 4] } else { Vec::new() },
            triangles: vec![[0, 1, 2], [1, 3, 2]],
            ..ModelMesh::default()
        };
        Model {
            name: "sheet".into(),
            meshes: vec![mesh],
            materials: vec![material],
            textures: vec![texture],
            ..Model::default()
        }
    }

    fn place(scale: DVec3) -> DAffine3 {
        let turn = glam::DQuat::from_euler(EulerRot::XYZ, 0.4, 1.1, -0.7);
        DAffine3::from_scale_rotation_translation(scale, turn, DVec3::new(3.0, -1.0, 2.0))
    }

    #[test]
    fn the_surface_of_an_instance_is_that_of_a_copy() {
        let uneven = DVec3::new(0.6, 1.5, 2.0);
        for (scale, has_tangents) in
            [DVec3::ONE, uneven, DVec3::new(-1.0, 1.0, 1.0), DVec3::new(-0.6, -1.5, -2.0)]
                .into_iter()
                .flat_map(|scale| [(scale, true), (scale, false)])
        {
            let mut model = sheet(has_tangents);
            model.repeats.push(Repeat { mesh: 0, moved: place(scale) });
            let world = place(DVec3::splat(1.3));
            let mut instanced = Scene::new(DVec3::X);
            instanced.add_object(&model, &world).unwrap();
            assert_eq!((instanced.objects.len(), instanced.instances.len()), (1, 1));
            let mut copied = Scene::new(DVec3::X);
            copied.add_object(&model.clone().flattened().unwrap(), &world).unwrap();
            assert_eq!((copied.objects.len(), copied.instances.len()), (2, 0));
            for (triangle, u, v) in [(0, 0.2, 0.3), (1, 0.6, 0.1), (1, 0.0, 1.0)] {
                let a = instanced.surface(Place::Object, 1, triangle, u, v);
                // A mirrored copy is wound the other way: its second corner is the third.
                let (cu, cv) = if scale.element_product() < 0.0 { (v, u) } else { (u, v) };
                let b = copied.surface(Place::Object, 1, triangle, cu, cv);
                let near = |a: Vec3, b: Vec3, what: &str| {
                    assert!((a - b).length() < 3e-6, "{what} at {scale}: {a} is not {b}");
                };
                near(a.position, b.position, "position");
                near(a.geometric_normal, b.geometric_normal, "geometric normal");
                near(a.shading_normal, b.shading_normal, "shading normal");
                near(a.coat_normal, b.coat_normal, "coat's normal");
                near(a.tangent, b.tangent, "tangent");
                near(a.bitangent, b.bitangent, "bitangent");
                assert!((a.uvs[0] - b.uvs[0]).length() < 1e-6 && a.material == b.material);
            }
        }
    }

    #[test]
    fn places_that_rays_cannot_be_taken_back_through_become_copies() {
        for scale in [DVec3::new(1.0, 0.0, 1.0), DVec3::splat(100.0), DVec3::new(1.0, 1.0, 1e-3)] {
            assert!(Instance::new(0, place(scale)).is_none(), "{scale}");
            let mut model = sheet(false);
            model.repeats.push(Repeat { mesh: 0, moved: place(scale) });
            let mut scene = Scene::new(DVec3::ZERO);
            scene.add_object(&model, &DAffine3::IDENTITY).unwrap();
            assert_eq!((scene.objects.len(), scene.instances.len()), (2, 0), "{scale}");
            let corner = place(scale).transform_point3(DVec3::X).as_vec3();
            assert_eq!(scene.objects[1].positions[1], corner);
        }
        assert!(Instance::new(0, DAffine3::from_translation(DVec3::splat(f64::NAN))).is_none());
    }

    #[test]
    fn a_model_is_as_large_and_as_far_as_with_copies() {
        let mut model = sheet(false);
        model.repeats.push(Repeat { mesh: 0, moved: place(DVec3::ONE) });
        assert_eq!((model.n_triangles(), model.n_held_triangles()), (4, 2));
        let flat = model.clone().flattened().unwrap();
        let world = place(DVec3::splat(2.0));
        let ([a, b], [c, d]) = (model.bounds(&world).unwrap(), flat.bounds(&world).unwrap());
        assert!((a - c).length() < 1e-12 && (b - d).length() < 1e-12);
        model.repeats[0].moved.translation.x = 1e300;
        assert!(model.check_place(&world).is_err());
    }
}
