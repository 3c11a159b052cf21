//! A point of a surface, ready to be shaded: frame, BSDF, and where its colour comes from.

use glam::Vec3;

use super::bsdf::Bsdf;
use super::coat::Coat;
use super::fresnel;
use super::sheen::Sheen;
use crate::conventions::Rgb;
use crate::light::LightSample;
use crate::scene::{self, AlbedoSource, Place, Scene, SurfaceParameters};
use crate::trace::{Hit, Ray};

/// A lamp's own glass, if it is modelled, lies on its surface and does not block it.
const BEFORE_A_LAMP: f32 = 1.0 - 1e-4;

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
    at: scene::Surface,
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
    fn new(at: scene::Surface, ray: &Ray, shading: Vec3, bsdf: Bsdf) -> Self {
        let toward = -ray.direction;
        let facing = |n: Vec3| if at.geometric_normal.dot(toward) < 0.0 { -n } else { n };
        let geometric = facing(at.geometric_normal);
        let mut normal = facing(shading);
        // An interpolated normal may turn away from a ray that the triangle faces.
        if normal.dot(toward) < 1e-4 {
            normal = geometric;
        }
        let (tangent, bitangent) = normal.any_orthonormal_pair();
        let mut surface = Self {
            position: at.position,
            geometric,
            tangent,
            bitangent,
            normal,
            wo: Vec3::Z,
            bsdf,
            at,
        };
        let wo = surface.to_local(toward);
        surface.wo = Vec3::new(wo.x, wo.y, wo.z.max(1e-6)).normalize();
        surface.bsdf.coat = coat_of(&surface, facing(surface.at.coat_normal));
        surface
    }

    /// A ray that leaves along `direction` and does not meet this triangle again.
    pub fn leave(&self, direction: Vec3) -> Ray {
        Ray::new(self.at.origin_toward(direction), direction)
    }

    /// The ray on which a light is seen: it ends just before the light.
    pub fn leave_for(&self, light: &LightSample) -> Ray {
        Ray { t_max: light.distance * BEFORE_A_LAMP, ..self.leave(light.direction) }
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
    pub fn new(scene: &Scene, ray: &Ray, hit: &Hit) -> Self {
        let at = scene.surface(Place::Object, hit.mesh, hit.triangle, hit.u, hit.v);
        let parameters = &at.parameters;
        let from_behind = at.geometric_normal.dot(ray.direction) > 0.0;
        let glassy = parameters.transmission > 0.0 && parameters.solid;
        let bsdf = bsdf_of(parameters, from_behind && glassy);
        let dark = from_behind && !parameters.double_sided;
        let surface = Surface::new(at, ray, at.shading_normal, bsdf);
        let emissive = if dark { Rgb::ZERO } else { parameters.emissive };
        Self {
            emitted: emissive * surface.bsdf.let_out(surface.wo),
            inside: (from_behind && glassy).then(|| attenuation_per_metre(parameters)),
            surface,
        }
    }
}

impl LocalPoint {
    pub fn new(scene: &Scene, ray: &Ray, hit: &Hit) -> Self {
        let at = scene.surface(Place::Local, hit.mesh, hit.triangle, hit.u, hit.v);
        let white = Bsdf::lambert(Rgb::ONE);
        let (bsdf, colour) = match scene.local[hit.mesh as usize].albedo {
            AlbedoSource::Plate => (white, Colouring::Plate),
            AlbedoSource::Constant(albedo) => (white, Colouring::Matt(albedo)),
            AlbedoSource::Material => {
                let own = bsdf_of(&at.parameters, false);
                if own.is_lambert() {
                    (white, Colouring::Matt(own.base))
                } else {
                    (own, Colouring::Own)
                }
            }
        };
        // Real surfaces are lit by their geometry: a smooth normal over a coarse proxy would give
        // an irradiance that no triangle has.
        let shading =
            if colour == Colouring::Own { at.shading_normal } else { at.geometric_normal };
        let surface = Surface::new(at, ray, shading, bsdf);
        Self { surface, mesh: hit.mesh as usize, colour }
    }
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
        multiple_scattering: at.multiple_scattering,
        facet_gain: 1.0,
        sheen: Sheen::new(at.sheen_colour, at.sheen_roughness).filter(|_| !leaving),
        coat: None,
    }
}

/// The clear coat of a surface, none from inside glass; `normal` is the coat's own, in the world.
fn coat_of(surface: &Surface, normal: Vec3) -> Option<Coat> {
    let parameters = &surface.at.parameters;
    let glassy = parameters.transmission > 0.0 && parameters.solid;
    if parameters.clearcoat <= 0.0 || (glassy && surface.bsdf.eta < 1.0) {
        return None;
    }
    let normal = surface.to_local(normal);
    Some(Coat {
        weight: parameters.clearcoat,
        alpha: parameters.clearcoat_roughness * parameters.clearcoat_roughness,
        // As of the shading normal: it may turn away from a ray that the triangle faces.
        normal: if normal.dot(surface.wo) < 1e-4 { fresnel::UP } else { normal },
    })
}

/// Beer's law per metre (KHR_materials_volume).
fn attenuation_per_metre(at: &SurfaceParameters) -> Rgb {
    if !at.attenuation_distance.is_finite() || at.attenuation_distance <= 0.0 {
        return Rgb::ONE;
    }
    at.attenuation_colour.max(Rgb::splat(1e-6)).powf(1.0 / at.attenuation_distance)
}
