//! Everything a path meets: geometry of both worlds, lights, and the plate as seen from any point.
//!
//! Two structures, local and objects, so that one step along a ray answers for both worlds.
//! Points are relative to the scene's origin.

use std::borrow::Cow;
use std::sync::Arc;

use glam::{Vec2, Vec3};

use super::albedo::AlbedoMap;
use super::blocked::CELLS;
use super::glow::Glow;
use super::sampler::{Purpose, Sampler};
use super::skylight::Skylight;
use super::surface::{LocalPoint, ObjectPoint, Surface};
use super::technique::{Blocked, Caustics, SOFT_ALPHA, Technique};
use crate::camera::Camera;
use crate::conventions::Rgb;
use crate::light::{Cells, Draws, LightSet, Lights};
use crate::photo::Image;
use crate::scene::{LocalRole, Mesh, Place, Scene};
use crate::trace::{Accel, Hit, Ray};

/// Objects that lie on a local surface within this share of their diameter win over it.
const COINCIDENT: f32 = 1e-5;
/// How many boxes bound the objects for cone sampling.
const PARTS: usize = 8;

/// A ball that holds a part of the objects.
#[derive(Clone, Copy, Debug)]
pub struct PartBall {
    pub centre: Vec3,
    pub radius: f32,
}

/// The scene of a job, ready for paths.
pub struct World<'a> {
    pub scene: &'a Scene,
    pub lights: Cow<'a, Lights>,
    /// The same lights, to draw what objects block of them.
    pub cells: Arc<Cells>,
    /// True if blocked light is drawn from cells: see [`blocked`](super::blocked).
    pub by_cells: bool,
    /// Where light is blocked as if it came from these directions alone.
    pub light_set: Option<LightSet>,
    pub technique: Technique,
    pub camera: &'a Camera,
    pub plate: &'a Image<Rgb>,
    pub local: Accel,
    pub objects: Accel,
    /// What of the objects shines.
    pub glow: Glow,
    pub parts: Vec<PartBall>,
    pub albedo: AlbedoMap,
    pub skylight: Skylight,
    /// Camera position relative to the scene's origin.
    pub eye: Vec3,
    /// True if the local meshes lie in one plane: no local surface sees another.
    pub flat: bool,
    /// True if no local mesh lets the camera see an object behind it.
    all_hide: bool,
    local_masks: bool,
    object_masks: bool,
    /// How far behind a local surface an object still wins over it, metres.
    pub coincident: f32,
}

/// What a ray meets in the two worlds.
pub struct Step {
    /// The first object, if it lies before everything local.
    pub object: Option<Hit>,
    /// The first local thing, whatever stands before it.
    pub local: Option<Hit>,
}

impl Step {
    /// Distance to what is met first in the world with objects; +∞ for nothing.
    pub fn first_distance(&self) -> f32 {
        let distance = |hit: Option<Hit>| hit.map_or(f32::INFINITY, |hit| hit.t);
        distance(self.object).min(distance(self.local))
    }
}

/// What takes long to find out about a scene, and is the same for every estimator.
#[derive(Clone, Debug)]
pub struct Groundwork {
    pub albedo: AlbedoMap,
    pub skylight: Skylight,
    pub cells: Arc<Cells>,
}

impl<'a> World<'a> {
    pub fn new(
        scene: &'a Scene,
        lights: &'a Lights,
        camera: &'a Camera,
        plate: &'a Image<Rgb>,
    ) -> Self {
        let groundwork = Groundwork {
            albedo: AlbedoMap::unknown(scene),
            skylight: Skylight::new(scene, lights),
            cells: Arc::new(Cells::new(lights, CELLS)),
        };
        Self::on(groundwork, scene, lights, camera, plate)
    }

    /// As [`new`](Self::new), with what is known of the same scene, lights, camera and plate.
    pub fn on(
        groundwork: Groundwork,
        scene: &'a Scene,
        lights: &'a Lights,
        camera: &'a Camera,
        plate: &'a Image<Rgb>,
    ) -> Self {
        let Groundwork { albedo, skylight, cells } = groundwork;
        let local_meshes: Vec<&Mesh> = scene.local.iter().map(|l| &l.mesh).collect();
        let (local, objects) = (Accel::build(&local_meshes), Accel::of_objects(scene));
        let parts = objects
            .parts(PARTS)
            .iter()
            .map(|b| PartBall { centre: b.centre(), radius: b.radius() * (1.0 + 1e-5) })
            .collect();
        let size = if objects.is_empty() { local.bounds() } else { objects.bounds() }.diameter();
        Self {
            flat: is_flat(&local_meshes),
            all_hide: scene.local.iter().all(|l| l.role != LocalRole::Prop),
            local_masks: scene.has_alpha(Place::Local),
            object_masks: scene.has_alpha(Place::Object),
            coincident: COINCIDENT * size,
            glow: Glow::new(scene),
            eye: (camera.pose.position() - scene.origin).as_vec3(),
            albedo,
            skylight,
            by_cells: Blocked::Auto.resolved(lights, &cells) == Blocked::Cells,
            light_set: None,
            technique: Technique::default(),
            cells,
            scene,
            lights: Cow::Borrowed(lights),
            camera,
            plate,
            local,
            objects,
            parts,
        }
    }

    /// The same, to be estimated by another technique.
    pub fn with_technique(mut self, technique: Technique) -> Self {
        let lights = self.lights.as_ref();
        let blocked = technique.blocked.resolved(lights, &self.cells);
        self.light_set = match blocked {
            Blocked::Patches(n) => Some(LightSet::patches(lights, n as usize)),
            Blocked::MedianCut(n) => Some(LightSet::median_cut(lights, n as usize)),
            Blocked::Auto | Blocked::Draws | Blocked::Cells => None,
        };
        self.by_cells = blocked != Blocked::Draws;
        if technique.draws != Draws::AsMade {
            self.lights = Cow::Owned(self.lights.with_draws(technique.draws));
        }
        Self { technique: Technique { blocked, ..technique }, ..self }
    }

    /// Traces a ray in both worlds at once.
    pub fn step(&self, ray: &Ray, sampler: &Sampler) -> Step {
        let local = self.closest_local(ray, sampler);
        let t_max = local.map_or(ray.t_max, |hit| hit.t + self.coincident);
        let object = self.closest_object(&Ray { t_max, ..*ray }, sampler);
        Step { object, local }
    }

    /// As [`step`](Self::step) for a camera ray: props that are no holdouts do not hide objects.
    pub fn camera_step(&self, ray: &Ray, sampler: &Sampler) -> Step {
        let step = self.step(ray, sampler);
        if step.object.is_some() || self.all_hide || self.objects.is_empty() {
            return step;
        }
        let is_prop = |hit: &Hit| self.scene.local[hit.mesh as usize].role == LocalRole::Prop;
        if !step.local.as_ref().is_some_and(is_prop) {
            return step;
        }
        let hiding = self.local.closest_where(ray, |mesh, triangle, u, v| {
            self.scene.local[mesh as usize].role != LocalRole::Prop
                && self.is_there(Place::Local, [mesh, triangle], [u, v], sampler)
        });
        let t_max = hiding.map_or(ray.t_max, |hit| hit.t + self.coincident);
        Step { object: self.closest_object(&Ray { t_max, ..*ray }, sampler), ..step }
    }

    pub fn closest_local(&self, ray: &Ray, sampler: &Sampler) -> Option<Hit> {
        if !self.local_masks {
            return self.local.closest(ray);
        }
        self.local.closest_where(ray, |mesh, triangle, u, v| {
            self.is_there(Place::Local, [mesh, triangle], [u, v], sampler)
        })
    }

    pub fn closest_object(&self, ray: &Ray, sampler: &Sampler) -> Option<Hit> {
        if !self.object_masks {
            return self.objects.closest(ray);
        }
        self.objects.closest_where(ray, |mesh, triangle, u, v| {
            self.is_there(Place::Object, [mesh, triangle], [u, v], sampler)
        })
    }

    pub fn local_occluded(&self, ray: &Ray, sampler: &Sampler) -> bool {
        if !self.local_masks {
            return self.local.occluded(ray);
        }
        self.local.occluded_where(ray, |mesh, triangle, u, v| {
            self.is_there(Place::Local, [mesh, triangle], [u, v], sampler)
        })
    }

    pub fn object_occluded(&self, ray: &Ray, sampler: &Sampler) -> bool {
        if !self.object_masks {
            return self.objects.occluded(ray);
        }
        self.objects.occluded_where(ray, |mesh, triangle, u, v| {
            self.is_there(Place::Object, [mesh, triangle], [u, v], sampler)
        })
    }

    /// Whether a triangle is there at (u, v): alpha masks, and blended alpha by chance.
    fn is_there(
        &self,
        place: Place,
        [mesh, triangle]: [u32; 2],
        [u, v]: [f32; 2],
        sampler: &Sampler,
    ) -> bool {
        let alpha = self.scene.alpha(place, mesh, triangle, u, v);
        // The same triangle must answer the same on this ray, and no other one with it: the number
        // depends on the ray and on which triangle of which mesh of which list this is.
        let own =
            || sampler.descend(2 * mesh + u32::from(place == Place::Object)).descend(triangle);
        alpha >= 1.0 || alpha > 0.0 && own().one(Purpose::Alpha) < alpha
    }

    /// A point of an object; `after_wide` if the path was scattered widely before it came here, see
    /// [`Caustics`].
    pub fn object_point(&self, ray: &Ray, hit: &Hit, after_wide: bool) -> ObjectPoint {
        let mut point = ObjectPoint::new(self.scene, ray, hit);
        if after_wide && self.technique.caustics == Caustics::Soft {
            let Surface { bsdf, wo, .. } = &mut point.surface;
            *bsdf = bsdf.softened(*wo, SOFT_ALPHA);
        }
        point
    }

    pub fn local_point(&self, ray: &Ray, hit: &Hit) -> LocalPoint {
        LocalPoint::new(self.scene, ray, hit)
    }

    /// The plate pixel that shows `point`, if it lies in the frame and nothing local hides it.
    pub fn pixel_of(&self, surface: &Surface, sampler: &Sampler) -> Option<Vec2> {
        let to_eye = self.eye - surface.position;
        // The side we see must be the side the camera sees.
        if surface.geometric.dot(to_eye) <= 0.0 {
            return None;
        }
        let world = self.scene.origin + surface.position.as_dvec3();
        let pixel = self.camera.project_world(world)?;
        if !self.camera.shows(pixel) {
            return None;
        }
        let distance = to_eye.length();
        let mut ray = surface.leave(to_eye / distance);
        ray.t_max = distance * (1.0 - 1e-4);
        (!self.local_occluded(&ray, sampler)).then_some(pixel.as_vec2())
    }

    /// The plate at a pixel position inside the frame, bilinear.
    pub fn plate_at(&self, pixel: Vec2) -> Rgb {
        let (w, h) = (self.plate.width(), self.plate.height());
        let p = pixel.clamp(Vec2::ZERO, Vec2::new(w as f32 - 1.0, h as f32 - 1.0));
        let (x, y) = (p.x as usize, p.y as usize);
        let (x1, y1) = ((x + 1).min(w - 1), (y + 1).min(h - 1));
        let (fx, fy) = (p.x - x as f32, p.y - y as f32);
        let top = self.plate[(x, y)].lerp(self.plate[(x1, y)], fx);
        let bottom = self.plate[(x, y1)].lerp(self.plate[(x1, y1)], fx);
        top.lerp(bottom, fy)
    }
}

/// True if all triangles lie in one plane (to 1e-5 of their extent) and look the same way.
pub fn is_flat(meshes: &[&Mesh]) -> bool {
    let bounds = meshes.iter().fold(crate::scene::Bounds::EMPTY, |b, m| b.union(&m.bounds()));
    let tolerance = 1e-5 * bounds.diameter();
    let mut plane: Option<(Vec3, f32)> = None;
    for mesh in meshes {
        for triangle in 0..mesh.triangles.len() {
            let [a, b, c] = mesh.corners(triangle);
            let Some(n) = (b - a).cross(c - a).try_normalize() else { continue };
            let (normal, height) = *plane.get_or_insert((n, n.dot(a)));
            if [a, b, c].iter().any(|p| (normal.dot(*p) - height).abs() > tolerance) {
                return false;
            }
        }
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::Numbers;
    use crate::render::test_scenes::{corner_camera, local, rectangle, scene, uniform_sky};
    use crate::scene::{AlbedoSource, AlphaMode, Material};

    #[test]
    fn two_half_transparent_cards_hide_three_quarters() {
        let veil = Material {
            alpha_mode: AlphaMode::Blend,
            base_colour: Rgb::ONE.extend(0.5),
            ..Material::default()
        };
        let card = |y: f32| rectangle(Vec3::new(-1.0, y, 1.0), Vec3::X * 2.0, Vec3::NEG_Z * 2.0);
        // One pair in the same list, one across the lists; all are triangle 0 of their mesh.
        let objects = scene(vec![card(1.0), card(2.0)], veil.clone(), vec![]);
        let across =
            scene(vec![card(1.0)], veil, vec![local(card(2.0), AlbedoSource::Constant(Rgb::ONE))]);
        let (camera, plate) = (corner_camera(4, 4, 5.0), Image::filled(4, 4, Rgb::ONE));
        let lights = uniform_sky(1.0);
        for (name, scene) in [("one list", objects), ("two lists", across)] {
            let world = World::new(&scene, &lights, &camera, &plate);
            let ray = Ray::new(Vec3::new(0.3, 5.0, 0.2), Vec3::NEG_Y);
            const N: u32 = 4096;
            let hidden = (0..N)
                .filter(|&index| {
                    let sampler = Sampler::new(5, (0, 0), 0, index, Numbers::Independent);
                    let step = world.step(&ray, &sampler);
                    step.object.is_some() || step.local.is_some()
                })
                .count();
            // 1 − ½ · ½; independent numbers scatter by √(¾ · ¼ / N) = 0.0068: two tests at 4σ.
            let share = hidden as f64 / f64::from(N);
            assert!((share - 0.75).abs() < 0.028, "{name}: {share}");
        }
    }
}
