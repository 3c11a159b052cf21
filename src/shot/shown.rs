//! What the plate shows of the modelled real things: their tree, and what a grid of its rays meets.
//!
//! Made once for a shot; every judgement on local things asks it.

use glam::{DVec2, Vec3};

use crate::camera::Camera;
use crate::scene::{Mesh, Scene};
use crate::trace::{Accel, Hit, Ray};

/// Rays of the grid, about: a surface smaller than a six-thousandth of the plate may be missed, as the
/// renderer's own grid of albedos may miss it.
const RAYS: usize = 6000;

/// The local things of a scene, made ready for rays, as a camera sees them.
pub struct Shown {
    /// Built over the meshes of `scene.local`, in their order.
    pub local: Accel,
    /// Pixels between neighbours of the grid.
    pub step: usize,
    /// Pixels of an even grid whose rays meet a local thing.
    pub grid: Vec<Seen>,
}

/// A pixel that shows a local thing.
pub struct Seen {
    pub pixel: (usize, usize),
    /// In the scene's frame.
    pub ray: Ray,
    pub hit: Hit,
}

impl Seen {
    /// The place that is seen, a little off its surface, and the surface's normal on the camera's side; in the
    /// scene's frame.
    pub fn place(&self, scene: &Scene) -> (Vec3, Vec3) {
        let mesh = &scene.local[self.hit.mesh as usize].mesh;
        let [a, b, c] = mesh.corners(self.hit.triangle as usize);
        let normal = (b - a).cross(c - a).normalize_or_zero();
        let normal = if normal.dot(self.ray.direction) > 0.0 { -normal } else { normal };
        (self.ray.at(self.hit.t) + normal * 1e-4 * self.hit.t, normal)
    }
}

impl Shown {
    pub fn new(scene: &Scene, camera: &Camera) -> Self {
        let meshes: Vec<&Mesh> = scene.local.iter().map(|local| &local.mesh).collect();
        let local = Accel::build(&meshes);
        let (width, height) = (camera.width, camera.height);
        let step = ((width * height) as f64 / RAYS as f64).sqrt().ceil().max(1.0) as usize;
        let rows = (step / 2..height).step_by(step);
        let pixels = rows.flat_map(|y| (step / 2..width).step_by(step).map(move |x| (x, y)));
        let seen = pixels.filter_map(|pixel| {
            let (origin, direction) = camera.ray(DVec2::new(pixel.0 as f64, pixel.1 as f64))?;
            let ray = Ray::new(scene.from_world(origin), direction.as_vec3());
            let hit = local.closest(&ray)?;
            Some(Seen { pixel, ray, hit })
        });
        let grid = seen.collect();
        Self { local, step, grid }
    }
}
