//! [`Surface`]: what is known of the scene where a ray met it.

use glam::{Vec2, Vec3, Vec4};

use super::{Mesh, PlacedMesh, Scene, SurfaceParameters, TextureRef};

/// Which of the scene's two lists a mesh is in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// [`Scene::objects`].
    Object,
    /// [`Scene::local`].
    Local,
}

/// A point of the scene's surface and everything a renderer asks of it.
#[derive(Clone, Copy, Debug)]
pub struct Surface {
    /// Relative to [`Scene::origin`], metres. On the triangle to the last bit of f32.
    pub position: Vec3,
    /// Unit, toward the outside (counter-clockwise corners), whichever side was hit.
    pub geometric_normal: Vec3,
    /// Unit, interpolated and normal-mapped, always on the side of `geometric_normal`.
    pub shading_normal: Vec3,
    /// As `shading_normal`, of the clear coat: bent by the coat's own normal map alone.
    pub coat_normal: Vec3,
    /// Unit, perpendicular to `shading_normal`, along growing u where there are texture coordinates.
    pub tangent: Vec3,
    /// Unit, completes the right-handed frame (tangent, bitangent, shading normal).
    pub bitangent: Vec3,
    /// Both sets of texture coordinates, zero where the mesh has none.
    pub uvs: [Vec2; 2],
    pub parameters: SurfaceParameters,
    pub place: Place,
    /// Number of the object, see [`Scene::object`], or index into [`Scene::local`].
    pub mesh: u32,
    pub triangle: u32,
    /// Index into [`Scene::materials`].
    pub material: usize,
    /// How far a new ray must start off the surface, metres.
    offset: f32,
}

impl Surface {
    /// Where a ray along `direction` starts, so that it does not meet its own triangle again.
    ///
    /// On the side of the *geometric* normal to which `direction` goes (through the surface too).
    pub fn origin_toward(&self, direction: Vec3) -> Vec3 {
        let side = self.offset.copysign(direction.dot(self.geometric_normal));
        self.position + side * self.geometric_normal
    }
}

impl Scene {
    /// Everything about the point with barycentric weights `u`, `v` of the second and third corner.
    ///
    /// `mesh` and `triangle` are those of a hit in the structure built over that list.
    /// Panics where the scene has no such triangle.
    pub fn surface(&self, place: Place, mesh: u32, triangle: u32, u: f32, v: f32) -> Surface {
        let index = mesh;
        let placed = self.placed(place, index);
        let mesh = placed.mesh;
        let indices = mesh.triangles[triangle as usize].map(|i| i as usize);
        let corners = placed.corners(triangle as usize);
        let weights = [1.0 - u - v, u, v];
        let position = precise_position(corners, u, v);
        let geometric_normal = placed.winding() * flat_normal(corners);
        let uvs = uvs_at(mesh, indices, weights);
        let material = &self.materials[mesh.material];

        let interpolated = placed
            .normals(indices)
            .map(|normals| blended(normals, weights))
            .and_then(Vec3::try_normalize)
            .map_or(geometric_normal, |n| if n.dot(geometric_normal) < 0.0 { -n } else { n });
        let map = material.normal_texture.as_ref();
        let frame = tangent_frame(&placed, map, indices, weights, corners, interpolated);
        let mapped = material.tangent_normal(&self.textures, uvs);
        let shading_normal = bent_normal(mapped, frame, geometric_normal);
        let coat_normal = material.clearcoat.as_ref().map_or(interpolated, |coat| {
            let map = coat.normal_texture.as_ref();
            let frame = tangent_frame(&placed, map, indices, weights, corners, interpolated);
            bent_normal(coat.tangent_normal(&self.textures, uvs), frame, geometric_normal)
        });
        let (tangent, bitangent) = perpendicular(shading_normal, frame[0]);

        Surface {
            position,
            geometric_normal,
            shading_normal,
            coat_normal,
            tangent,
            bitangent,
            uvs,
            parameters: material.evaluate(&self.textures, uvs, colour_at(mesh, indices, weights)),
            place,
            mesh: index,
            triangle,
            material: mesh.material,
            offset: offset(&placed, triangle as usize, [u, v], corners, position),
        }
    }

    /// Share of the surface that is there (alpha), for the walk of a ray through masked leaves.
    pub fn alpha(&self, place: Place, mesh: u32, triangle: u32, u: f32, v: f32) -> f32 {
        let mesh = self.placed(place, mesh).mesh;
        let indices = mesh.triangles[triangle as usize].map(|i| i as usize);
        let weights = [1.0 - u - v, u, v];
        self.materials[mesh.material].alpha(
            &self.textures,
            uvs_at(mesh, indices, weights),
            colour_at(mesh, indices, weights),
        )
    }

    /// Whether any mesh of the list can have alpha below 1: only then is [`Scene::alpha`] worth asking.
    pub fn has_alpha(&self, place: Place) -> bool {
        let opaque =
            |mesh: &Mesh| self.materials[mesh.material].alpha_mode == super::AlphaMode::Opaque;
        match place {
            Place::Object => !self.objects.iter().all(opaque),
            Place::Local => !self.local.iter().all(|local| opaque(&local.mesh)),
        }
    }
}

/// A normal map's normal, kept on the side of the geometric one; the frame's own without a map.
fn bent_normal(
    local: Option<Vec3>,
    [tangent, bitangent, normal]: [Vec3; 3],
    geometric_normal: Vec3,
) -> Vec3 {
    let Some(local) = local else { return normal };
    let mapped = (local.x * tangent + local.y * bitangent + local.z * normal).normalize();
    let above = mapped.dot(geometric_normal);
    // Below the horizon of the real surface no light can come from: lift onto it.
    let least = 1e-3;
    if above >= least {
        mapped
    } else {
        (mapped + (least - above) * geometric_normal).normalize_or(normal)
    }
}

/// The point in f64, rounded once: off the plane by less than half an ulp of its own coordinates,
/// however large the triangle.
fn precise_position([a, b, c]: [Vec3; 3], u: f32, v: f32) -> Vec3 {
    let [a, b, c] = [a.as_dvec3(), b.as_dvec3(), c.as_dvec3()];
    (a + f64::from(u) * (b - a) + f64::from(v) * (c - a)).as_vec3()
}

fn flat_normal([a, b, c]: [Vec3; 3]) -> Vec3 {
    let a = a.as_dvec3();
    (b.as_dvec3() - a).cross(c.as_dvec3() - a).normalize_or(glam::DVec3::Y).as_vec3()
}

/// Larger than what rounding can move the triangle by in the next ray's test.
///
/// That test's coordinates are corners minus origin, sheared: off by at most six roundings of the
/// largest of them, M; 32 · 2⁻²⁴ · M is five times that (methods-render R11.6, without its term in
/// the scene's diameter, which would lift contact shadows of large places).
fn ray_offset(corners: [Vec3; 3], position: Vec3) -> f32 {
    let reach = corners.iter().fold(position.abs(), |m, c| m.max(c.abs())).max_element();
    let span = corners.iter().fold(0.0, |m: f32, &c| m.max((c - position).abs().max_element()));
    32.0 / (1 << 24) as f32 * (reach + span).max(1e-6)
}

/// [`ray_offset`] where that test is made: an instance's in the frame of its mesh, into which the ray is
/// rounded once more.
fn offset(
    placed: &PlacedMesh,
    triangle: usize,
    [u, v]: [f32; 2],
    corners: [Vec3; 3],
    position: Vec3,
) -> f32 {
    let here = ray_offset(corners, position);
    let Some(instance) = placed.instance else { return here };
    let own = placed.mesh.corners(triangle);
    here.max(instance.stretch() * ray_offset(own, precise_position(own, u, v)))
}

fn blend<T>(values: &[T], indices: [usize; 3], weights: [f32; 3]) -> Option<T>
where
    T: Copy + std::ops::Mul<f32, Output = T> + std::ops::Add<Output = T>,
{
    (!values.is_empty()).then(|| blended(indices.map(|i| values[i]), weights))
}

fn blended<T>([a, b, c]: [T; 3], [wa, wb, wc]: [f32; 3]) -> T
where
    T: Copy + std::ops::Mul<f32, Output = T> + std::ops::Add<Output = T>,
{
    a * wa + b * wb + c * wc
}

fn uvs_at(mesh: &Mesh, indices: [usize; 3], weights: [f32; 3]) -> [Vec2; 2] {
    [&mesh.uvs, &mesh.second_uvs].map(|uvs| blend(uvs, indices, weights).unwrap_or(Vec2::ZERO))
}

fn colour_at(mesh: &Mesh, indices: [usize; 3], weights: [f32; 3]) -> Vec4 {
    blend(&mesh.colours, indices, weights).unwrap_or(Vec4::ONE)
}

/// Tangent, bitangent, normal of the normal map: from the file's tangents, else from the direction
/// in which its picture's u grows, else any.
fn tangent_frame(
    placed: &PlacedMesh,
    map: Option<&TextureRef>,
    indices: [usize; 3],
    weights: [f32; 3],
    corners: [Vec3; 3],
    normal: Vec3,
) -> [Vec3; 3] {
    let stored = placed.tangents(indices).map(|tangents| blended(tangents, weights));
    let stored = stored.map(|t| (t.truncate(), if t.w < 0.0 { -1.0 } else { 1.0 }));
    let derived = || uv_tangent(picture_uvs(placed.mesh, map, indices)?, corners, normal);
    let (along, hand) = stored.or_else(derived).unwrap_or((Vec3::ZERO, 1.0));
    let (tangent, bitangent) = perpendicular(normal, along);
    [tangent, hand * bitangent, normal]
}

/// Where the corners lie on the normal map's picture: in its own set of coordinates, through its
/// own transform. Without a map, the first set.
fn picture_uvs(mesh: &Mesh, map: Option<&TextureRef>, indices: [usize; 3]) -> Option<[Vec2; 3]> {
    let sets = [&mesh.uvs, &mesh.second_uvs];
    if sets[map.map_or(0, |map| map.uv_set)].is_empty() {
        return None;
    }
    Some(indices.map(|i| {
        let uvs = sets.map(|set| set.get(i).copied().unwrap_or(Vec2::ZERO));
        map.map_or(uvs[0], |map| map.picture_uv(uvs))
    }))
}

/// Direction in which u grows on the triangle, and whether v grows to its left (seen against the
/// normal) or right. v runs down the picture, its normal map's green runs up: MikkTSpace's sign.
fn uv_tangent([a, b, c]: [Vec2; 3], corners: [Vec3; 3], normal: Vec3) -> Option<(Vec3, f32)> {
    let (e1, e2) = (corners[1] - corners[0], corners[2] - corners[0]);
    let (d1, d2) = (b - a, c - a);
    let determinant = d1.x * d2.y - d1.y * d2.x;
    if determinant == 0.0 {
        return None;
    }
    let along_u = (e1 * d2.y - e2 * d1.y) / determinant;
    let along_v = (e2 * d1.x - e1 * d2.x) / determinant;
    // glTF: bitangent = cross(normal, tangent) · w points to growing picture-up, which is −v.
    let hand = if normal.cross(along_u).dot(-along_v) < 0.0 { -1.0 } else { 1.0 };
    Some((along_u, hand))
}

/// Unit tangent and bitangent of a right-handed frame about `normal`, the first close to `along`.
fn perpendicular(normal: Vec3, along: Vec3) -> (Vec3, Vec3) {
    let tangent = (along - along.dot(normal) * normal)
        .try_normalize()
        .unwrap_or_else(|| normal.any_orthonormal_vector());
    (tangent, normal.cross(tangent))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::photo::Image;
    use crate::scene::{Clearcoat, Material, Texture, TextureRef, Wrap};

    /// A square in the plane z = 0 seen from +z, picture upright on it.
    fn square(size: f32, material: Material, textures: Vec<Texture>) -> Scene {
        let corner = |x: f32, y: f32| size * Vec3::new(x - 0.5, y - 0.5, 0.0);
        let mesh = Mesh {
            positions: vec![corner(0.0, 0.0), corner(1.0, 0.0), corner(1.0, 1.0), corner(0.0, 1.0)],
            uvs: vec![Vec2::new(0.0, 1.0), Vec2::new(1.0, 1.0), Vec2::new(1.0, 0.0), Vec2::ZERO],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Mesh::default()
        };
        Scene { objects: vec![mesh], materials: vec![material], textures, ..Scene::default() }
    }

    #[test]
    fn without_normals_the_surface_is_flat_and_its_frame_follows_the_picture() {
        let scene = square(2.0, Material::default(), Vec::new());
        let surface = scene.surface(Place::Object, 0, 1, 0.25, 0.5);
        assert_eq!(surface.geometric_normal, Vec3::Z);
        assert_eq!(surface.shading_normal, Vec3::Z);
        assert_eq!((surface.tangent, surface.bitangent), (Vec3::X, Vec3::Y));
        assert_eq!(surface.position, Vec3::new(-0.5, 0.5, 0.0));
        assert_eq!(surface.uvs[0], Vec2::new(0.25, 0.25));
        assert_eq!(surface.place, Place::Object);
    }

    #[test]
    fn red_and_green_of_a_normal_map_tilt_right_and_up() {
        for (texel, expected) in [
            (Vec4::new(0.9, 0.5, 0.8, 1.0), Vec3::new(0.8, 0.0, 0.6)),
            (Vec4::new(0.5, 0.9, 0.8, 1.0), Vec3::new(0.0, 0.8, 0.6)),
        ] {
            let texture =
                Texture::from_linear(Image::filled(1, 1, texel), [Wrap::Repeat; 2]).unwrap();
            let uv_transform = glam::Affine2::IDENTITY;
            let normal_texture = Some(TextureRef { texture: 0, uv_set: 0, uv_transform });
            let material = Material { normal_texture, ..Material::default() };
            let mut scene = square(1.0, material, vec![texture]);
            let derived = scene.surface(Place::Object, 0, 0, 0.2, 0.2).shading_normal;
            assert!((derived - expected).length() < 1e-6, "{derived}");
            scene.objects[0].tangents = vec![Vec4::new(1.0, 0.0, 0.0, 1.0); 4];
            let stored = scene.surface(Place::Object, 0, 0, 0.2, 0.2).shading_normal;
            assert!((stored - expected).length() < 1e-6, "{stored}");
        }
    }

    #[test]
    fn a_normal_map_is_read_in_the_frame_of_its_own_coordinates() {
        use glam::{Affine2, Mat2};
        // Red 0.9: toward growing u of the picture, wherever that points on the square.
        let texel = Vec4::new(0.9, 0.5, 0.8, 1.0);
        let shaded = |uv_set, uv_transform, second: [Vec2; 4]| {
            let texture =
                Texture::from_linear(Image::filled(1, 1, texel), [Wrap::Repeat; 2]).unwrap();
            let normal_texture = Some(TextureRef { texture: 0, uv_set, uv_transform });
            let material = Material { normal_texture, ..Material::default() };
            let mut scene = square(1.0, material, vec![texture]);
            scene.objects[0].second_uvs = second.to_vec();
            scene.surface(Place::Object, 0, 0, 0.2, 0.2).shading_normal
        };
        let close = |n: Vec3, to: Vec3| assert!((n - to).length() < 1e-6, "{n} is not {to}");
        // The second set has u grow upward.
        let upward = [Vec2::ZERO, Vec2::new(0.0, 1.0), Vec2::ONE, Vec2::new(1.0, 0.0)];
        close(shaded(1, Affine2::IDENTITY, upward), Vec3::new(0.0, 0.8, 0.6));
        // u' = 1 − u: the picture mirrored. u' = v: turned, growing downward.
        let mirror =
            Affine2 { matrix2: Mat2::from_diagonal(Vec2::new(-1.0, 1.0)), translation: Vec2::X };
        close(shaded(0, mirror, upward), Vec3::new(-0.8, 0.0, 0.6));
        let turned = Affine2::from_mat2(Mat2::from_cols(Vec2::new(0.0, -1.0), Vec2::X));
        close(shaded(0, turned, upward), Vec3::new(0.0, -0.8, 0.6));
    }

    #[test]
    fn a_coat_lies_smooth_over_a_bumpy_base_and_follows_its_own_map() {
        let tilted =
            |texel| Texture::from_linear(Image::filled(1, 1, texel), [Wrap::Repeat; 2]).unwrap();
        let map = |texture| {
            let uv_transform = glam::Affine2::IDENTITY;
            Some(TextureRef { texture, uv_set: 0, uv_transform })
        };
        let textures =
            vec![tilted(Vec4::new(0.9, 0.5, 0.8, 1.0)), tilted(Vec4::new(0.5, 0.9, 0.8, 1.0))];
        let normals = |normal_texture| {
            let clearcoat = Some(Clearcoat { factor: 1.0, normal_texture, ..Clearcoat::default() });
            let material = Material { normal_texture: map(0), clearcoat, ..Material::default() };
            let scene = square(1.0, material, textures.clone());
            let at = scene.surface(Place::Object, 0, 0, 0.2, 0.2);
            (at.shading_normal, at.coat_normal)
        };
        let (base, smooth) = normals(None);
        assert!((base - Vec3::new(0.8, 0.0, 0.6)).length() < 1e-6 && smooth == Vec3::Z);
        let (base, own) = normals(map(1));
        assert!((base - Vec3::new(0.8, 0.0, 0.6)).length() < 1e-6);
        assert!((own - Vec3::new(0.0, 0.8, 0.6)).length() < 1e-6, "{own}");
    }

    #[test]
    fn the_shading_normal_is_always_on_the_geometric_side() {
        let mut scene = square(1.0, Material::default(), Vec::new());
        scene.objects[0].normals = vec![Vec3::new(0.6, 0.0, -0.8); 4];
        let surface = scene.surface(Place::Object, 0, 0, 0.2, 0.2);
        assert!((surface.shading_normal - Vec3::new(-0.6, 0.0, 0.8)).length() < 1e-6);
        scene.objects[0].normals = vec![Vec3::ZERO; 4];
        assert_eq!(scene.surface(Place::Object, 0, 0, 0.2, 0.2).shading_normal, Vec3::Z);
    }

    #[test]
    fn a_ray_starts_on_the_side_it_leaves_to_by_less_than_a_hundredth_of_a_millimetre() {
        let surface =
            square(2.0, Material::default(), Vec::new()).surface(Place::Object, 0, 0, 0.3, 0.3);
        for direction in [Vec3::new(0.9, 0.0, 0.1), Vec3::new(0.9, 0.0, -0.1)] {
            let off = surface.origin_toward(direction).z;
            assert!(off * direction.z > 0.0 && off.abs() < 1e-5, "{off}");
        }
    }

    #[test]
    fn vertex_colours_and_second_coordinates_are_interpolated() {
        let mut scene = square(1.0, Material::default(), Vec::new());
        scene.objects[0].colours =
            vec![Vec4::ONE, Vec4::new(0.0, 1.0, 1.0, 1.0), Vec4::ONE, Vec4::ONE];
        scene.objects[0].second_uvs = vec![Vec2::ZERO, Vec2::new(4.0, 8.0), Vec2::ZERO, Vec2::ZERO];
        let surface = scene.surface(Place::Object, 0, 0, 0.25, 0.5);
        assert_eq!(surface.parameters.base_colour, Vec3::new(0.75, 1.0, 1.0));
        assert_eq!(surface.uvs[1], Vec2::new(1.0, 2.0));
    }
}
