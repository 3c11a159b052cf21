//! Putting models into a [`Scene`].

use glam::{DAffine3, DMat3, DVec2, DVec3, Vec2, Vec3, Vec4};

use super::{
    AlbedoSource, Instance, LocalMesh, LocalRole, Material, Mesh, Model, ModelMesh, Scene,
    SceneError,
};

/// World point in the middle of all placed models: the best origin of their scene. Zero for nothing.
pub fn centre(placed: &[(&Model, DAffine3)]) -> DVec3 {
    let boxes =
        placed.iter().filter_map(|(model, world_from_model)| model.bounds(world_from_model));
    let all = boxes.reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])]);
    all.map_or(DVec3::ZERO, |[min, max]| min + 0.5 * (max - min))
}

impl Scene {
    /// A scene of nothing. `origin`: a world point close to the objects, see [`centre`].
    pub fn new(origin: DVec3) -> Self {
        Self { origin, ..Self::default() }
    }

    /// Puts a model into the world *with*; returns its number among the objects.
    ///
    /// # Errors
    /// As [`Model::check_place`], and nothing is added.
    pub fn add_object(
        &mut self,
        model: &Model,
        world_from_model: &DAffine3,
    ) -> Result<usize, SceneError> {
        let placed = self.object_names.len();
        let meshes = self.place(model, world_from_model, placed)?;
        self.object_names.push(model.name.clone());
        let first = self.objects.len();
        self.objects.extend(meshes);
        let placement = Placement::new(world_from_model, self.origin);
        let scene_from_model = placement.scene_from_model;
        let model_from_scene = scene_from_model.inverse();
        for repeat in &model.repeats {
            let of = first + repeat.mesh;
            match Instance::new(of, scene_from_model * repeat.moved * model_from_scene) {
                Some(instance) => self.instances.push(instance),
                None => {
                    let there = Placement::new(&(*world_from_model * repeat.moved), self.origin);
                    let mesh = &model.meshes[repeat.mesh];
                    let copy = there.mesh(mesh, placed, self.objects[of].material);
                    self.objects.push(copy);
                }
            }
        }
        Ok(placed)
    }

    /// Puts a model of a real thing into both worlds; returns its number among the local things.
    ///
    /// # Errors
    /// As [`Model::check_place`], and nothing is added.
    pub fn add_local(
        &mut self,
        model: &Model,
        world_from_model: &DAffine3,
        role: LocalRole,
        albedo: AlbedoSource,
    ) -> Result<usize, SceneError> {
        let placed = self.local_names.len();
        let meshes = if model.repeats.is_empty() {
            self.place(model, world_from_model, placed)?
        } else {
            self.place(&model.clone().flattened()?, world_from_model, placed)?
        };
        self.local_names.push(model.name.clone());
        self.local.extend(meshes.into_iter().map(|mesh| LocalMesh { mesh, role, albedo }));
        Ok(placed)
    }

    /// Puts a flat rectangle of Lambert white into both worlds, as support.
    ///
    /// `at`: its middle, world. `normal`: where it faces, not zero. Its first side (`size.x`) runs
    /// along the world's X as far as the plane allows (Z if the plane faces along X), uv 0…1 over it.
    ///
    /// # Errors
    /// As [`Model::check_place`], and nothing is added.
    pub fn add_plane(
        &mut self,
        size: DVec2,
        at: DVec3,
        normal: DVec3,
        albedo: AlbedoSource,
    ) -> Result<usize, SceneError> {
        let y = normal.normalize_or(DVec3::Y);
        let along = if y.x.abs() < 0.9 { DVec3::X } else { DVec3::NEG_Z };
        let x = (along - along.dot(y) * y).normalize();
        let world_from_plane =
            DAffine3::from_mat3_translation(DMat3::from_cols(x, y, x.cross(y)), at);
        let corner = |u: f64, v: f64| DVec3::new((u - 0.5) * size.x, 0.0, (v - 0.5) * size.y);
        let mesh = ModelMesh {
            name: "plane".into(),
            positions: vec![corner(0.0, 0.0), corner(1.0, 0.0), corner(1.0, 1.0), corner(0.0, 1.0)],
            uvs: vec![Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y],
            triangles: vec![[0, 2, 1], [0, 3, 2]],
            ..ModelMesh::default()
        };
        let lambert = Material {
            name: "plane".into(),
            specular: 0.0,
            double_sided: true,
            ..Material::default()
        };
        let model = Model {
            name: "plane".into(),
            meshes: vec![mesh],
            materials: vec![lambert],
            ..Model::default()
        };
        self.add_local(&model, &world_from_plane, LocalRole::Support, albedo)
    }

    /// A world point in the frame of the meshes.
    pub fn from_world(&self, point: DVec3) -> Vec3 {
        (point - self.origin).as_vec3()
    }

    /// A point in the frame of the meshes, in the world.
    pub fn to_world(&self, point: Vec3) -> DVec3 {
        point.as_dvec3() + self.origin
    }

    /// The model's meshes, each once, in the scene's frame; its materials and textures join the scene's.
    fn place(
        &mut self,
        model: &Model,
        world_from_model: &DAffine3,
        placed: usize,
    ) -> Result<Vec<Mesh>, SceneError> {
        model.check_place(world_from_model)?;
        let first_material = self.materials.len();
        let first_texture = self.textures.len();
        self.textures.extend(model.textures.iter().cloned());
        self.materials.extend(model.materials.iter().cloned().map(|mut material| {
            for texture in material.texture_refs_mut() {
                texture.texture += first_texture;
            }
            material
        }));
        let transform = Placement::new(world_from_model, self.origin);
        let meshes = model.meshes.iter();
        let place = |mesh| transform.mesh(mesh, placed, first_material + mesh.material);
        Ok(meshes.map(place).collect())
    }
}

/// An affine map of a model into a scene, in f64 until the origin is subtracted.
struct Placement {
    scene_from_model: DAffine3,
    /// Inverse transpose; `None` if the map flattens: normals have no direction then.
    normals: Option<DMat3>,
    mirrors: bool,
}

impl Placement {
    fn new(world_from_model: &DAffine3, origin: DVec3) -> Self {
        let scene_from_model = DAffine3 {
            matrix3: world_from_model.matrix3,
            translation: world_from_model.translation - origin,
        };
        let determinant = scene_from_model.matrix3.determinant();
        Self {
            scene_from_model,
            normals: normal_matrix(&scene_from_model.matrix3),
            mirrors: determinant < 0.0,
        }
    }

    fn mesh(&self, mesh: &ModelMesh, placed: usize, material: usize) -> Mesh {
        let place = |&p: &DVec3| self.scene_from_model.transform_point3(p).as_vec3();
        Mesh {
            name: mesh.name.clone(),
            placed,
            positions: mesh.positions.iter().map(place).collect(),
            normals: transform_normals(&mesh.normals, self.normals),
            uvs: mesh.uvs.clone(),
            second_uvs: mesh.second_uvs.clone(),
            tangents: transform_tangents(&mesh.tangents, &self.scene_from_model.matrix3),
            colours: mesh.colours.clone(),
            triangles: turned(&mesh.triangles, self.mirrors),
            material,
        }
    }
}

/// What takes normals where `matrix` takes points, up to length; `None` if `matrix` flattens.
pub(super) fn normal_matrix(matrix: &DMat3) -> Option<DMat3> {
    let inverse = matrix.inverse();
    inverse.is_finite().then(|| inverse.transpose())
}

/// Unit normals; none if the map flattens.
pub(super) fn transform_normals(normals: &[Vec3], matrix: Option<DMat3>) -> Vec<Vec3> {
    let Some(matrix) = matrix else { return Vec::new() };
    normals.iter().map(|&n| transform_normal(n, &matrix)).collect()
}

/// A unit normal, by a matrix of [`normal_matrix`].
pub(super) fn transform_normal(normal: Vec3, matrix: &DMat3) -> Vec3 {
    (*matrix * normal.as_dvec3()).normalize_or_zero().as_vec3()
}

pub(super) fn transform_tangents(tangents: &[Vec4], matrix: &DMat3) -> Vec<Vec4> {
    tangents.iter().map(|&t| transform_tangent(t, matrix)).collect()
}

/// A unit tangent and its handedness, by the matrix of points.
pub(super) fn transform_tangent(tangent: Vec4, matrix: &DMat3) -> Vec4 {
    // A mirror image turns handedness, as it turns the winding.
    let hand = if matrix.determinant() < 0.0 { -1.0 } else { 1.0 };
    let along = (*matrix * tangent.truncate().as_dvec3()).normalize_or_zero().as_vec3();
    along.extend(hand * tangent.w)
}

/// The triangles, wound the other way if `mirrors`, so that counter-clockwise stays outside.
pub(super) fn turned(triangles: &[[u32; 3]], mirrors: bool) -> Vec<[u32; 3]> {
    if mirrors {
        triangles.iter().map(|&[a, b, c]| [a, c, b]).collect()
    } else {
        triangles.to_vec()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Place, TextureRef};

    fn tetrahedron() -> Model {
        let positions = vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
        let triangles = vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];
        Model {
            meshes: vec![ModelMesh { positions, triangles, ..ModelMesh::default() }],
            materials: vec![Material::default()],
            ..Model::default()
        }
    }

    fn signed_volume(mesh: &Mesh) -> f32 {
        let volume = |t: usize| {
            let [a, b, c] = mesh.corners(t);
            a.cross(b).dot(c) / 6.0
        };
        (0..mesh.triangles.len()).map(volume).sum()
    }

    #[test]
    fn a_place_far_from_the_world_s_origin_keeps_its_millimetres() {
        let model = tetrahedron();
        let far = DAffine3::from_translation(DVec3::new(412_345.678, 12.5, -5_600_789.123));
        let mut scene = Scene::new(centre(&[(&model, far)]));
        scene.add_object(&model, &far).unwrap();
        let corner = scene.to_world(scene.objects[0].positions[1]);
        assert!((corner - far.translation - DVec3::X).length() < 1e-7);
    }

    #[test]
    fn a_corner_too_far_for_a_float_is_an_error_that_names_its_mesh() {
        let mut model = tetrahedron();
        model.name = "tower".into();
        model.meshes[0].name = "top".into();
        let mut scene = Scene::new(DVec3::ZERO);
        let huge = DAffine3::from_scale(DVec3::splat(1e300));
        let error = scene.add_object(&model, &huge).unwrap_err().to_string();
        assert!(error.contains("tower") && error.contains("\"top\""), "{error}");
        assert!(scene.objects.is_empty() && scene.materials.is_empty());
        model.meshes[0].positions[1] = DVec3::new(1e300, 0.0, 0.0);
        assert!(scene.add_object(&model, &DAffine3::IDENTITY).is_err());
    }

    #[test]
    fn a_mirrored_object_keeps_its_outside() {
        for scale in [DVec3::ONE, DVec3::new(-2.0, 1.0, 1.0), DVec3::new(-1.0, -1.0, -3.0)] {
            let mut scene = Scene::new(DVec3::ZERO);
            scene.add_object(&tetrahedron(), &DAffine3::from_scale(scale)).unwrap();
            let volume = signed_volume(&scene.objects[0]);
            assert!((f64::from(volume) - scale.element_product().abs() / 6.0).abs() < 1e-6);
        }
    }

    #[test]
    fn normals_stay_perpendicular_under_uneven_scale() {
        let mut model = tetrahedron();
        model.meshes[0].normals = vec![Vec3::ONE.normalize(); 4];
        let mut scene = Scene::new(DVec3::ZERO);
        scene.add_object(&model, &DAffine3::from_scale(DVec3::new(1.0, 5.0, 0.2))).unwrap();
        let mesh = &scene.objects[0];
        let [a, b, c] = mesh.corners(3);
        let flat = (b - a).cross(c - a).normalize();
        assert!((mesh.normals[1] - flat).length() < 1e-6);
    }

    #[test]
    fn a_plane_faces_its_normal_and_has_its_size() {
        for normal in [DVec3::Y, DVec3::NEG_Y, DVec3::X, DVec3::new(1.0, 2.0, -0.5)] {
            let mut scene = Scene::new(DVec3::new(1.0, 2.0, 3.0));
            let at = DVec3::new(1.0, 2.0, 3.5);
            let size = DVec2::new(4.0, 2.0);
            scene.add_plane(size, at, 3.0 * normal, AlbedoSource::Plate).unwrap();
            assert_eq!(scene.local[0].role, LocalRole::Support);
            for triangle in 0..2 {
                let surface = scene.surface(Place::Local, 0, triangle, 0.25, 0.25);
                let faces = surface.geometric_normal.as_dvec3();
                assert!((faces - normal.normalize()).length() < 1e-6);
                let off = surface.position.as_dvec3() - DVec3::new(0.0, 0.0, 0.5);
                assert!(off.dot(normal).abs() < 1e-6);
            }
            let mesh = &scene.local[0].mesh;
            assert!(((mesh.positions[1] - mesh.positions[0]).length() - 4.0).abs() < 1e-6);
            assert!(((mesh.positions[2] - mesh.positions[1]).length() - 2.0).abs() < 1e-6);
        }
    }

    #[test]
    fn materials_and_textures_of_each_model_stay_its_own() {
        let texture = || {
            let texel = crate::photo::Image::filled(1, 1, Vec4::ONE);
            crate::scene::Texture::from_linear(texel, [crate::scene::Wrap::Repeat; 2]).unwrap()
        };
        let mut model = tetrahedron();
        model.textures.push(texture());
        model.materials[0].normal_texture =
            Some(TextureRef { texture: 0, uv_set: 0, uv_transform: glam::Affine2::IDENTITY });
        let mut scene = Scene::new(DVec3::ZERO);
        assert_eq!(scene.add_object(&model, &DAffine3::IDENTITY).unwrap(), 0);
        assert_eq!(scene.add_object(&model, &DAffine3::IDENTITY).unwrap(), 1);
        let second = &scene.objects[1];
        assert_eq!((second.placed, second.material), (1, 1));
        assert_eq!(scene.materials[1].normal_texture.as_ref().map(|t| t.texture), Some(1));
    }
}
