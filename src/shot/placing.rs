//! Objects that stand where nobody would put them: on air, in the table, behind the camera, in
//! millimetres. Told before anything is rendered, each with the key that mends it.

use glam::{DVec2, DVec3};

use super::file::SupportShape;
use super::place;
use super::plan::Plan;
use crate::camera::Camera;
use crate::report::{Warning, length};
use crate::scene::{Bounds, LocalRole, PlacedMesh, Scene};
use crate::trace::{Accel, Ray};

/// Rays that look for an object in the picture and for the support below it, about.
const RAYS: usize = 6000;
/// A foot this far off the support, as a share of the object's diagonal, is not seen to float or sink.
const SEEN_GAP: f64 = 0.01;
/// No gap below a millimetre is told: no tape measures it.
const LEAST_GAP_M: f64 = 1e-3;
/// Larger than this many times the shot, or smaller than this part of it, is a matter of units: files
/// in centimetres or millimetres are off by 100 or 1000.
const TOO_LARGE: f64 = 5.0;
const TOO_SMALL: f64 = 1.0 / 250.0;

/// What the places of the objects say.
pub struct Judged {
    /// One sentence for each object that is not where it can be meant to be.
    pub warnings: Vec<Warning>,
    /// No pixel may show some object: it is out of sight, or far too small or large, which is told of,
    /// or its animation hides it.
    pub maybe_unseen: bool,
}

/// Judges where the objects stand. `local` is built over the meshes of `scene.local`, in their order.
pub fn judge(plan: &Plan, scene: &Scene, camera: &Camera, local: &Accel) -> Judged {
    let around = Around { plan, scene, camera, objects: Accel::of_objects(scene), local };
    let mut judged = Judged { warnings: Vec::new(), maybe_unseen: false };
    for (i, name) in scene.object_names.iter().enumerate() {
        let meshes: Vec<PlacedMesh> =
            scene.all_objects().filter(|placed| placed.mesh.placed == i).collect();
        let Some(object) = Placed::new(i, name, &meshes, scene) else {
            // Animations hide things by scaling them to nothing.
            judged.maybe_unseen |= plan.object_moves(i);
            continue;
        };
        // An object in wrong units is also in the wrong place: one sentence, not three.
        let (standing, unseen) = match around.size(&object) {
            Some(warning) => (None, Some(warning)),
            None => (around.standing(&object), around.sight(&object)),
        };
        judged.maybe_unseen |= unseen.is_some();
        // What moves may fly, and come into the picture later.
        let asks = !plan.object_moves(i);
        let said = standing.into_iter().chain(unseen);
        judged.warnings.extend(said.map(|said| Warning { asks, ..said }));
    }
    judged
}

/// Everything an object is held against.
struct Around<'a> {
    plan: &'a Plan,
    scene: &'a Scene,
    camera: &'a Camera,
    objects: Accel,
    local: &'a Accel,
}

/// One placed object, world metres.
struct Placed<'a> {
    index: usize,
    name: &'a str,
    meshes: &'a [PlacedMesh<'a>],
    scene: &'a Scene,
    /// Corners of its triangles, thinned out evenly.
    corners: Vec<DVec3>,
    /// Middles of its triangles, thinned out evenly.
    middles: Vec<DVec3>,
    min: DVec3,
    max: DVec3,
}

impl<'a> Placed<'a> {
    /// `None` of an object without triangles.
    fn new(
        index: usize,
        name: &'a str,
        meshes: &'a [PlacedMesh<'a>],
        scene: &'a Scene,
    ) -> Option<Self> {
        let n: usize = meshes.iter().map(|placed| placed.mesh.triangles.len()).sum();
        let triangles = meshes.iter().flat_map(|placed| {
            let corners = |t| placed.corners(t).map(|p| scene.to_world(p));
            (0..placed.mesh.triangles.len()).map(corners)
        });
        let some: Vec<[DVec3; 3]> = triangles.step_by(n.div_ceil(RAYS).max(1)).collect();
        let boxes = meshes.iter().map(|placed| Bounds::of(placed.positions()));
        let bounds = boxes.reduce(|a, b| a.union(&b))?;
        (n > 0).then(|| Self {
            index,
            name,
            meshes,
            scene,
            corners: some.iter().flatten().copied().collect(),
            middles: some.iter().map(|[a, b, c]| (*a + *b + *c) / 3.0).collect(),
            min: scene.to_world(bounds.min),
            max: scene.to_world(bounds.max),
        })
    }

    fn positions(&self) -> impl Iterator<Item = DVec3> {
        self.meshes.iter().flat_map(|placed| placed.positions()).map(|p| self.scene.to_world(p))
    }

    /// Its lowest corners, and some all over it.
    fn feet(&self) -> Vec<DVec3> {
        let mut all: Vec<DVec3> = self.positions().collect();
        if all.len() > RAYS {
            all.select_nth_unstable_by(RAYS, |a, b| a.y.total_cmp(&b.y));
            all.truncate(RAYS);
        }
        all.extend(&self.corners);
        all
    }

    fn key(&self, key: &str) -> String {
        format!("object[{}].{key}", self.index)
    }

    fn diagonal(&self) -> f64 {
        self.min.distance(self.max)
    }

    fn middle(&self) -> DVec3 {
        0.5 * (self.min + self.max)
    }
}

impl Around<'_> {
    /// A size that only a wrong unit explains.
    fn size(&self, object: &Placed) -> Option<Warning> {
        let support = place::ground(self.plan)
            .map_or(0.0, |ground| 2.0 * DVec2::from(ground.half_size).length());
        let keys = self.plan.shot.objects.get(object.index)?;
        let distance = self.camera.pose.position().distance(keys.at.into());
        let (size, scale) = (object.diagonal(), keys.scale);
        let what = if size > TOO_LARGE * support.max(distance) {
            format!(
                "far larger than the support and its distance from the camera: if its file is in \
                 centimetres, set scale = {}, in millimetres {}",
                0.01 * scale,
                0.001 * scale
            )
        } else if size < TOO_SMALL * support.min(distance) {
            format!(
                "far smaller than the support and its distance from the camera: if its file is 100 or \
                 1000 times too small, set scale = {} or {}",
                100.0 * scale,
                1000.0 * scale
            )
        } else {
            return None;
        };
        let [x, y, z] = (object.max - object.min).to_array().map(length);
        Some(Warning::new(
            object.key("scale"),
            format!("{} measures {x} × {y} × {z} (X, Y, Z), {what}", object.name),
            format!("it is seen from {}", length(distance)),
        ))
    }

    /// A foot that floats over the support or sinks into it.
    fn standing(&self, object: &Placed) -> Option<Warning> {
        let (up, height) = self.height(object)?;
        let tolerance = (SEEN_GAP * object.diagonal()).max(LEAST_GAP_M);
        if height.abs() <= tolerance || height > 0.0 && self.rests(object, up, tolerance) {
            return None;
        }
        let at = DVec3::from(self.plan.shot.objects.get(object.index)?.at) - up * height;
        // + 0.0 turns −0 into 0.
        let [x, y, z] = at.to_array().map(|c| (c * 1e4).round() / 1e4 + 0.0);
        let (name, gap) = (object.name, length(height.abs()));
        let (verb, size) = if height > 0.0 {
            ("hovers", format!("its lowest point is {gap} above the support"))
        } else {
            ("sinks", format!("its lowest point is {gap} below the support's surface"))
        };
        let how = if height > 0.0 { "above" } else { "into" };
        Some(Warning::new(
            object.key("at"),
            format!(
                "{name} {verb} {gap} {how} the support; to stand it there, set at = [{x}, {y}, {z}]; if \
                 it is meant so, leave it"
            ),
            size,
        ))
    }

    /// Up, and the height of the object's lowest point over the support; `None` where none is below it.
    fn height(&self, object: &Placed) -> Option<(DVec3, f64)> {
        if let SupportShape::Plane { at, normal, .. } = self.plan.shot.support.shape {
            let up = DVec3::from(normal).normalize_or(DVec3::Y);
            let height = |p: DVec3| (p - DVec3::from(at)).dot(up);
            let lowest = object.positions().map(height).fold(f64::INFINITY, f64::min);
            return Some((up, lowest));
        }
        // From the object's top, so that a surface is met from above where the foot is below it.
        let lift = object.max.y - object.min.y + LEAST_GAP_M;
        let is_support = |mesh: usize| self.scene.local[mesh].role == LocalRole::Support;
        let heights = object.feet().into_iter().filter_map(|p| {
            let met = self.below(self.local, p + DVec3::Y * lift, DVec3::Y, is_support)?;
            Some(met - lift)
        });
        heights.reduce(f64::min).map(|lowest| (DVec3::Y, lowest))
    }

    /// Whether it stands on a local thing or another object instead.
    fn rests(&self, object: &Placed, up: DVec3, tolerance: f64) -> bool {
        object.feet().into_iter().any(|p| {
            // From just above, so that a corner that lies on the surface meets it.
            let from = p + up * tolerance;
            let near = |distance: Option<f64>| distance.is_some_and(|d| d < 2.0 * tolerance);
            let is_other = |mesh: usize| self.scene.object(mesh as u32).mesh.placed != object.index;
            near(self.below(self.local, from, up, |_| true))
                || near(self.below(&self.objects, from, up, is_other))
        })
    }

    /// How far below a point the next surface lies, of the meshes that count.
    fn below(
        &self,
        accel: &Accel,
        from: DVec3,
        up: DVec3,
        counts: impl Fn(usize) -> bool,
    ) -> Option<f64> {
        let ray = Ray::new(self.scene.from_world(from), -up.as_vec3());
        let hit = accel.closest_where(&ray, |mesh, _, _, _| counts(mesh as usize));
        hit.map(|hit| f64::from(hit.t))
    }

    /// An object that no pixel shows.
    fn sight(&self, object: &Placed) -> Option<Warning> {
        let looks = self.camera.pose.rotation() * DVec3::NEG_Z;
        let eye = self.camera.pose.position();
        let key = object.key("at");
        let name = object.name;
        if !object.corners.iter().any(|&p| (p - eye).dot(looks) > 0.0) {
            let [x, y, z] = eye.to_array().map(|c| format!("{c:.2}"));
            let [dx, dy, dz] = looks.to_array().map(|c| format!("{c:.2}"));
            return Some(Warning::new(
                key,
                format!(
                    "{name} is behind the camera, which stands at [{x}, {y}, {z}] and looks along \
                     [{dx}, {dy}, {dz}]; move it with at, or mend the pose"
                ),
                "no pixel shows it",
            ));
        }
        if self.is_seen(object) {
            return None;
        }
        let cause = if object.middles.iter().any(|&p| self.is_in_frame(p)) {
            match self.hider(object) {
                Some(hider) => format!("is hidden by {hider}; move it with at"),
                None => {
                    "is smaller than a pixel or hardly larger; look at scale and the units of its file"
                        .to_owned()
                }
            }
        } else {
            let (w, h) = (self.camera.width, self.camera.height);
            let middle = self.camera.project_world(object.middle());
            let seen_at = middle.map_or(String::new(), |p| {
                format!(": its middle would be seen at pixel ({:.0}, {:.0}) of {w} × {h}", p.x, p.y)
            });
            format!("is outside the frame{seen_at}; move it with at, or mend the pose")
        };
        Some(Warning::new(
            key,
            format!("{name} {cause}"),
            "no pixel's centre shows it; its shadow may be seen",
        ))
    }

    /// Whether a pixel's ray, or one to a triangle's middle, meets it first.
    fn is_seen(&self, object: &Placed) -> bool {
        let (w, h) = (self.camera.width, self.camera.height);
        let corners: Option<Vec<DVec2>> =
            object.corners.iter().map(|&p| self.camera.project_world(p)).collect();
        // Partly behind the camera or beyond the lens's field: it may be anywhere in the frame.
        let (low, high) = corners.map_or((DVec2::ZERO, DVec2::INFINITY), |all| {
            all.iter().fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(low, high), &p| {
                (low.min(p), high.max(p))
            })
        });
        let low = low.floor().max(DVec2::ZERO);
        let high = high.ceil().min(DVec2::new(w as f64 - 1.0, h as f64 - 1.0));
        if low.x > high.x || low.y > high.y {
            return false;
        }
        let area = (high.x - low.x + 1.0) * (high.y - low.y + 1.0);
        let step = (area / RAYS as f64).sqrt().ceil().max(1.0) as usize;
        let pixels = (low.y as usize..=high.y as usize).step_by(step).flat_map(|y| {
            (low.x as usize..=high.x as usize)
                .step_by(step)
                .map(move |x| DVec2::new(x as f64, y as f64))
        });
        let mut rays = pixels.filter_map(|p| self.camera.ray(p)).map(|(_, direction)| direction);
        if rays.any(|direction| self.first_met(direction) == Some(Met::Object(object.index))) {
            return true;
        }
        // Every pixel was looked at: what none of them shows is not there.
        step > 1 && {
            let seen = |p: &&DVec3| self.is_in_frame(**p);
            let met = |p: &DVec3| self.first_met(*p - self.camera.pose.position());
            object.middles.iter().filter(seen).any(|p| met(p) == Some(Met::Object(object.index)))
        }
    }

    fn is_in_frame(&self, point: DVec3) -> bool {
        self.camera.project_world(point).is_some_and(|pixel| self.camera.shows(pixel))
    }

    /// The name of what stands in front of the object where it would be in the frame.
    fn hider(&self, object: &Placed) -> Option<String> {
        let eye = self.camera.pose.position();
        let inside = object.middles.iter().filter(|p| self.is_in_frame(**p));
        let mut met = inside.filter_map(|&p| self.first_met(p - eye));
        met.find_map(|met| match met {
            Met::Object(i) if i == object.index => None,
            Met::Object(i) => self.scene.object_names.get(i).cloned(),
            Met::Local(i) => {
                let local = &self.scene.local[i];
                match local.role {
                    LocalRole::Support => Some("the support".to_owned()),
                    _ => self.scene.local_names.get(local.mesh.placed).cloned(),
                }
            }
        })
    }

    fn first_met(&self, direction: DVec3) -> Option<Met> {
        let origin = self.scene.from_world(self.camera.pose.position());
        let ray = Ray::new(origin, direction.normalize_or(DVec3::NEG_Z).as_vec3());
        let object = self.objects.closest(&ray);
        let local = self.local.closest(&ray);
        match (object, local) {
            (Some(object), local) if local.is_none_or(|local| object.t <= local.t) => {
                Some(Met::Object(self.scene.object(object.mesh).mesh.placed))
            }
            (_, local) => local.map(|local| Met::Local(local.mesh as usize)),
        }
    }
}

/// What a ray met first.
#[derive(Clone, Copy, PartialEq)]
enum Met {
    /// Number of the object.
    Object(usize),
    /// Number of the local mesh.
    Local(usize),
}
