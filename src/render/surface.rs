//! A point of a surface, ready to be shaded: frame, BSDF, and where its colour comes from.

use glam::Vec3;

use super::bsdf::Bsdf;
use super::fresnel;
use super::world::Corners;
use crate::conventions::Rgb;
use crate::scene::{AlbedoSource, Mesh, Scene};
use crate::scene::material::SurfaceParameters;
use crate::trace::{Hit, Ray};

/// A point of a surface as seen by one ray.
#[derive(Clone, Copy, Debug)]
pub struct Surface {
    /// Relative to the scene's origin.
    pub position: Vec3,
    /// Unit normal of the triangle, on the side of the ray.
    pub geometric: Vec3,
    /// Shading frame, `normal` on the side of the ray.
    tangent: Vec3,
    bitangent: Vec3,
    normal: Vec3,
    /// Direction toward where the ray came from, in the shading frame.
    pub wo: Vec3,
    pub bsdf: Bsdf,
}

/// A point of an object.
pub struct ObjectPoint {
    pub surface: Surface,
    pub emitted: Rgb,
    /// Share of light left after a metre inside, if the ray came through the inside of a solid.
    pub inside: Option<Rgb>,
}

/// A point of the modelled real scene.
pub struct LocalPoint {
    pub surface: Surface,
    /// Index into `Scene::local`.
    pub mesh: usize,
    pub triangle: usize,
    pub colour: Colouring,
}

/// Where the light that a local point reflects is known from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Colouring {
    /// Diffuse, albedo solved from the plate: the BSDF is white Lambert, to be scaled.
    Plate,
    /// Diffuse, albedo given: the BSDF is white Lambert, to be scaled.
    Matt(Rgb),
    /// The BSDF holds all.
    Own,
}

impl Surface {
    fn new(corners: &Corners, ray: &Ray, shading: Option<Vec3>, bsdf: Bsdf) -> Self {
        let toward = -ray.direction;
        let mut geometric = corners.geometric_normal();
        if geometric.dot(toward) < 0.0 {
            geometric = -geometric;
        }
        let mut normal = shading.unwrap_or(geometric);
        if normal.dot(geometric) < 0.0 {
            normal = -normal;
        }
        // An interpolated normal may turn away from a ray that the triangle faces.
        if normal.dot(toward) < 1e-4 {
            normal = geometric;
        }
        let (tangent, bitangent) = normal.any_orthonormal_pair();
        let mut surface = Self {
            position: corners.position(),
            geometric,
            tangent,
            bitangent,
            normal,
            wo: Vec3::Z,
            bsdf,
        };
        let wo = surface.to_local(toward);
        surface.wo = Vec3::new(wo.x, wo.y, wo.z.max(1e-6)).normalize();
        surface
    }

    pub fn to_local(&self, d: Vec3) -> Vec3 {
        Vec3::new(self.tangent.dot(d), self.bitangent.dot(d), self.normal.dot(d))
    }

    pub fn to_world(&self, d: Vec3) -> Vec3 {
        (self.tangent * d.x + self.bitangent * d.y + self.normal * d.z).normalize()
    }

    pub fn normal(&self) -> Vec3 {
        self.normal
    }

    /// f · |cos| and density for a world direction; zero where triangle and shading normal disagree
    /// on the side (a light leak otherwise).
    pub fn evaluate(&self, direction: Vec3) -> (Rgb, f32) {
        let wi = self.to_local(direction);
        if (wi.z > 0.0) != (self.geometric.dot(direction) > 0.0) {
            return (Rgb::ZERO, 0.0);
        }
        self.bsdf.evaluate(self.wo, wi)
    }
}

impl ObjectPoint {
    pub fn new(scene: &Scene, mesh: &Mesh, ray: &Ray, hit: &Hit) -> Self {
        let corners = Corners::of(mesh, hit.triangle, hit.u, hit.v);
        let material = &scene.materials[mesh.material];
        let at = material.evaluate(&scene.textures, corners.uvs(), corners.colour());
        let from_behind = corners.geometric_normal().dot(ray.direction) > 0.0;
        let glassy = at.transmission > 0.0 && at.solid;
        let bsdf = bsdf_of(&at, from_behind && glassy);
        let bump = material.tangent_normal(&scene.textures, corners.uvs());
        let shading = shading_normal(&corners, bump);
        let emitted = if from_behind && !at.double_sided { Rgb::ZERO } else { at.emissive };
        Self {
            surface: Surface::new(&corners, ray, shading, bsdf),
            emitted,
            inside: (from_behind && glassy).then(|| attenuation_per_metre(&at)),
        }
    }
}

impl LocalPoint {
    pub fn new(scene: &Scene, ray: &Ray, hit: &Hit) -> Self {
        let local = &scene.local[hit.mesh as usize];
        let corners = Corners::of(&local.mesh, hit.triangle, hit.u, hit.v);
        let (bsdf, colour) = match local.albedo {
            AlbedoSource::Plate => (Bsdf::lambert(Rgb::ONE), Colouring::Plate),
            AlbedoSource::Constant(albedo) => (Bsdf::lambert(Rgb::ONE), Colouring::Matt(albedo)),
            AlbedoSource::Material => {
                let material = &scene.materials[local.mesh.material];
                let at = material.evaluate(&scene.textures, corners.uvs(), corners.colour());
                let bsdf = bsdf_of(&at, false);
                if bsdf.is_lambert() {
                    (Bsdf::lambert(Rgb::ONE), Colouring::Matt(bsdf.base))
                } else {
                    (bsdf, Colouring::Own)
                }
            }
        };
        // Real surfaces are lit by their geometry: a smooth normal over a coarse proxy would give
        // an irradiance that no triangle has.
        let shading = if colour == Colouring::Own { corners.normal() } else { None };
        Self {
            surface: Surface::new(&corners, ray, shading, bsdf),
            mesh: hit.mesh as usize,
            triangle: hit.triangle as usize,
            colour,
        }
    }
}

fn shading_normal(corners: &Corners, bump: Option<Vec3>) -> Option<Vec3> {
    let Some(bump) = bump else { return corners.normal() };
    let normal = corners.normal().unwrap_or_else(|| corners.geometric_normal());
    let tangent = corners.tangent()?;
    let t = tangent.truncate().reject_from_normalized(normal).try_normalize()?;
    let b = normal.cross(t) * tangent.w.signum();
    (t * bump.x + b * bump.y + normal * bump.z).try_normalize()
}

fn bsdf_of(at: &SurfaceParameters, leaving: bool) -> Bsdf {
    let reflectance = fresnel::normal_reflectance(at.ior);
    Bsdf {
        base: at.base_colour.clamp(Rgb::ZERO, Rgb::ONE),
        metallic: at.metallic,
        alpha: at.roughness * at.roughness,
        specular: at.specular,
        f0: (at.specular_colour * reflectance).min(Rgb::ONE),
        transmission: at.transmission,
        eta: if leaving { 1.0 / at.ior } else { at.ior },
        thin: !at.solid,
    }
}

/// Beer's law per metre (KHR_materials_volume).
fn attenuation_per_metre(at: &SurfaceParameters) -> Rgb {
    if !at.attenuation_distance.is_finite() || at.attenuation_distance <= 0.0 {
        return Rgb::ONE;
    }
    at.attenuation_colour.max(Rgb::splat(1e-6)).powf(1.0 / at.attenuation_distance)
}
