//! Meshes that stand in more than one place: their trees once, and a tree of places over them.
//!
//! A ray is taken into the frame of the mesh (origin and direction in f64, rounded once; the direction
//! keeps the length it gets, so that distances are those of the scene) and walks the mesh's own tree.
//! Distance and weights of what it meets are then those of the triangle put in its place, as of a copy.
//! Rounding the ray moves it by less than the pad of the boxes of places; two triangles of one mesh see
//! the same rounded ray, so that a mesh is as watertight as in its first place.

use glam::{DAffine3, Vec3};

use super::kernel::BoxRay;
use super::{Accel, Hit, Ray, triangle};
use crate::scene::{Bounds, Instance, Mesh};

/// Pad of the boxes of places, in those of [`BoxRay`]: a place may stretch its mesh by 16 and shrink it by
/// 16, so that a rounding in the mesh's frame is one of up to 256 in the scene's.
const PAD: f32 = 256.0;

/// How far a distance found in the mesh's frame may be off that of the placed triangle, as a share of it
/// and of the largest coordinate: only what lies farther behind the nearest hit is passed by.
const SLACK: f32 = 1e-4;

/// Places of meshes, ready for rays.
#[derive(Clone, Debug)]
pub(super) struct Instances {
    /// A structure for each mesh that is repeated.
    shapes: Vec<Accel>,
    places: Vec<Place>,
    /// Root first; empty without places.
    nodes: Vec<Node>,
    bounds: Bounds,
    extent: f32,
    n_triangles: usize,
}

#[derive(Clone, Debug)]
struct Place {
    shape: usize,
    scene_from_shape: DAffine3,
    shape_from_scene: DAffine3,
    /// Of the hits: the number of meshes before it.
    number: u32,
    bounds: Bounds,
}

/// A box of places: either one place, or two nodes.
#[derive(Clone, Copy, Debug)]
struct Node {
    bounds: Bounds,
    child: Child,
}

#[derive(Clone, Copy, Debug)]
enum Child {
    Place(usize),
    /// The two nodes from this one on.
    Nodes(usize),
}

impl Instances {
    /// Of `instances` of `meshes`; they are numbered after the meshes. `None` if nothing of them can be hit.
    pub fn build(meshes: &[&Mesh], instances: &[Instance]) -> Option<Self> {
        let mut shape_of = vec![None; meshes.len()];
        let mut shapes: Vec<Accel> = Vec::new();
        let mut places = Vec::new();
        for (k, instance) in instances.iter().enumerate() {
            let mesh = meshes[instance.of];
            let shape = *shape_of[instance.of].get_or_insert_with(|| {
                shapes.push(Accel::build(&[mesh]));
                shapes.len() - 1
            });
            let place = |p: &Vec3| instance.moved.transform_point3(p.as_dvec3()).as_vec3();
            let used = mesh.triangles.iter().flatten().map(|&i| &mesh.positions[i as usize]);
            if !shapes[shape].is_empty() {
                places.push(Place {
                    shape,
                    scene_from_shape: instance.moved,
                    shape_from_scene: instance.moved.inverse(),
                    number: (meshes.len() + k) as u32,
                    bounds: Bounds::of(used.map(place)),
                });
            }
        }
        let bounds = places.iter().fold(Bounds::EMPTY, |all, place| all.union(&place.bounds));
        let n_triangles = places.iter().map(|place| shapes[place.shape].n_triangles()).sum();
        let extent = bounds.min.abs().max(bounds.max.abs()).max_element();
        let nodes = tree(&places);
        (!places.is_empty()).then_some(Self { shapes, places, nodes, bounds, extent, n_triangles })
    }

    /// The nearer of `best` and the nearest hit of which `counts(number, triangle, u, v)` is true; of two
    /// at one distance `best`, else that of the lower number.
    pub fn closest(
        &self,
        ray: &Ray,
        best: Option<Hit>,
        counts: impl Fn(u32, u32, f32, f32) -> bool,
    ) -> Option<Hit> {
        let mut best = best;
        // Beyond this distance nothing is looked for.
        let reach = |best: &Option<Hit>| match best {
            None => ray.t_max,
            Some(hit) => (hit.t * (1.0 + SLACK) + SLACK * self.extent).min(ray.t_max),
        };
        self.walk(ray, reach(&best), |place| {
            let own = place.own_ray(&Ray { t_max: reach(&best), ..*ray });
            let found = self.shapes[place.shape]
                .closest_triangle(&own, |_, triangle, u, v| counts(place.number, triangle, u, v));
            if let Some((hit, corners)) = found {
                let hit = place.hit(ray, hit, corners);
                let nearer = best.is_none_or(|best| (hit.t, hit.mesh) < (best.t, best.mesh));
                if nearer {
                    best = Some(hit);
                }
            }
            Some(reach(&best))
        });
        best
    }

    /// Whether anything of which `counts(number, triangle, u, v)` is true lies on the ray.
    pub fn occluded(&self, ray: &Ray, counts: impl Fn(u32, u32, f32, f32) -> bool) -> bool {
        let mut found = false;
        self.walk(ray, ray.t_max, |place| {
            found = self.shapes[place.shape]
                .occluded_by_own(&place.own_ray(ray), |_, t, u, v| counts(place.number, t, u, v));
            (!found).then_some(ray.t_max)
        });
        found
    }

    pub fn bounds(&self) -> Bounds {
        self.bounds
    }

    /// All that can be hit, at every place.
    pub fn n_triangles(&self) -> usize {
        self.n_triangles
    }

    pub fn n_bytes(&self) -> usize {
        self.shapes.iter().map(Accel::n_bytes).sum::<usize>()
            + size_of_val(&self.places[..])
            + size_of_val(&self.nodes[..])
    }

    /// At most `limit` (at least one) boxes that hold all places, the largest opened first.
    pub fn parts(&self, limit: usize) -> Vec<Bounds> {
        let mut parts = vec![self.nodes[0]];
        while parts.len() < limit {
            let area = |i: &usize| parts[*i].bounds.half_area();
            let widest = (0..parts.len())
                .filter(|&i| matches!(parts[i].child, Child::Nodes(_)))
                .max_by(|i, j| area(i).total_cmp(&area(j)));
            let Some(widest) = widest else { break };
            if let Child::Nodes(first) = parts.swap_remove(widest).child {
                parts.extend(&self.nodes[first..first + 2]);
            }
        }
        parts.into_iter().map(|node| node.bounds).collect()
    }

    /// Shows `visit` the places whose boxes the ray meets before `t_max`, the nearer of two first.
    /// It returns the new `t_max`, or `None` to end the walk.
    fn walk(&self, ray: &Ray, mut t_max: f32, mut visit: impl FnMut(&Place) -> Option<f32>) {
        /// Twice the levels of a tree that halves a list of fewer than 2³² each time.
        const STACK: usize = 64;
        let span = ray.origin.abs().max_element() + self.extent;
        let Some(boxes) = BoxRay::new(ray, PAD * span) else { return };
        let mut waiting = [(0.0, 0); STACK];
        let mut n = 0;
        if let Some(enter) = enter(&boxes, &self.nodes[0].bounds, t_max) {
            waiting[0] = (enter, 0);
            n = 1;
        }
        while n > 0 {
            n -= 1;
            let (enter_at, node) = waiting[n];
            if enter_at > t_max {
                continue;
            }
            match self.nodes[node].child {
                Child::Place(place) => match visit(&self.places[place]) {
                    Some(nearer) => t_max = nearer,
                    None => return,
                },
                Child::Nodes(first) => {
                    let at =
                        |node: usize| Some((enter(&boxes, &self.nodes[node].bounds, t_max)?, node));
                    let (a, b) = (at(first), at(first + 1));
                    let is_ahead = a.zip(b).is_some_and(|(a, b)| b.0 < a.0);
                    let [near, far] = if is_ahead { [b, a] } else { [a, b] };
                    for next in [far, near].into_iter().flatten() {
                        waiting[n] = next;
                        n += 1;
                    }
                }
            }
        }
    }
}

impl Place {
    /// The ray in the mesh's frame; equal numbers mean equal distances.
    fn own_ray(&self, ray: &Ray) -> Ray {
        let origin = self.shape_from_scene.transform_point3(ray.origin.as_dvec3()).as_vec3();
        let direction = self.shape_from_scene.transform_vector3(ray.direction.as_dvec3()).as_vec3();
        Ray { origin, direction, ..*ray }
    }

    /// A hit on a triangle in the mesh's frame, at its distance and weights in the scene.
    fn hit(&self, ray: &Ray, hit: Hit, own: [Vec3; 3]) -> Hit {
        let corners = own.map(|p| self.scene_from_shape.transform_point3(p.as_dvec3()).as_vec3());
        let [t, u, v] = triangle::refine(ray, &corners, [hit.t, hit.u, hit.v]);
        Hit { t, u, v, mesh: self.number, ..hit }
    }
}

/// Where the ray enters a box, if it does before `t_max`.
fn enter(ray: &BoxRay, bounds: &Bounds, t_max: f32) -> Option<f32> {
    let planes =
        [[bounds.min.x, bounds.max.x], [bounds.min.y, bounds.max.y], [bounds.min.z, bounds.max.z]];
    let (mut enter, mut leave) = (ray.t_min, t_max);
    for (axis, planes) in planes.iter().enumerate() {
        let near = ray.near_plane[axis] & 1;
        enter = enter.max(planes[near] * ray.reciprocal[axis] + ray.near[axis]);
        leave = leave.min(planes[near ^ 1] * ray.reciprocal[axis] + ray.far[axis]);
    }
    (enter <= leave).then_some(enter)
}

/// Halves the places along the longest side of their middles' box, again and again.
fn tree(places: &[Place]) -> Vec<Node> {
    let mut nodes = Vec::with_capacity(2 * places.len());
    let mut order: Vec<usize> = (0..places.len()).collect();
    if order.is_empty() {
        return nodes;
    }
    let whole = Node { bounds: Bounds::EMPTY, child: Child::Place(0) };
    nodes.push(whole);
    // A node to be made, and the piece of the order that it holds.
    let mut pending = vec![(0, 0..places.len())];
    while let Some((node, range)) = pending.pop() {
        let held = &mut order[range.clone()];
        let bounds = held.iter().fold(Bounds::EMPTY, |b, &i| b.union(&places[i].bounds));
        nodes[node].bounds = bounds;
        if let [place] = held {
            nodes[node].child = Child::Place(*place);
            continue;
        }
        let middle = |i: usize| places[i].bounds.centre();
        let middles = Bounds::of(held.iter().map(|&i| middle(i)));
        let size = middles.max - middles.min;
        let axis = size.max_position();
        let half = held.len() / 2;
        held.select_nth_unstable_by(half, |&i, &j| {
            middle(i)[axis].total_cmp(&middle(j)[axis]).then(i.cmp(&j))
        });
        let first = nodes.len();
        nodes[node].child = Child::Nodes(first);
        nodes.extend([whole; 2]);
        pending.push((first, range.start..range.start + half));
        pending.push((first + 1, range.start + half..range.end));
    }
    nodes
}

#[cfg(test)]
mod tests {
    use glam::{DMat3, DQuat, DVec3};

    use super::*;
    use crate::scene::{Material, Place as List, Scene};
    use crate::trace::test_meshes::{Random, soup, sphere};

    /// Turned, mirrored one time in two, scaled unevenly by up to four, and moved by up to `far`.
    fn moved(random: &mut Random, far: f32) -> DAffine3 {
        let turn =
            DQuat::from_axis_angle(random.direction().as_dvec3(), 6.0 * f64::from(random.next()));
        let mut scale = DVec3::from_array([0; 3].map(|_| 0.5 + 1.5 * f64::from(random.next())));
        scale.x *= if random.next() < 0.5 { -1.0 } else { 1.0 };
        let matrix = DMat3::from_quat(turn) * DMat3::from_diagonal(scale);
        DAffine3::from_mat3_translation(matrix, (far * random.point()).as_dvec3())
    }

    fn with_instances(mesh: Mesh, places: &[DAffine3]) -> Scene {
        let instance = |moved: &DAffine3| Instance::new(0, *moved).expect("a tame place");
        Scene {
            objects: vec![mesh],
            instances: places.iter().map(instance).collect(),
            materials: vec![Material::default()],
            ..Scene::default()
        }
    }

    /// The same with a copy for each place, wound so that the outside stays outside.
    fn with_copies(mesh: Mesh, places: &[DAffine3]) -> Scene {
        let mut scene = with_instances(mesh, &[]);
        for moved in places {
            let mut copy = scene.objects[0].clone();
            for p in &mut copy.positions {
                *p = moved.transform_point3(p.as_dvec3()).as_vec3();
            }
            scene.objects.push(copy);
        }
        scene
    }

    #[test]
    fn instances_are_hit_where_copies_are() {
        let mut random = Random(21);
        for (mesh, far) in
            [(soup(200, 0.3, 5), 6.0), (sphere(12, Vec3::ZERO), 6.0), (soup(64, 0.5, 7), 300.0)]
        {
            let places: Vec<DAffine3> = (0..40).map(|_| moved(&mut random, far)).collect();
            let (ours, copies) =
                (with_instances(mesh.clone(), &places), with_copies(mesh, &places));
            let (ours, copies) = (Accel::of_objects(&ours), Accel::of_objects(&copies));
            assert_eq!(ours.n_triangles(), copies.n_triangles());
            assert!((ours.bounds().min - copies.bounds().min).length() < 1e-6 * far);
            let (mut n_hits, mut n_other) = (0, 0);
            for i in 0..20_000 {
                // Half of them at something
                let origin = 1.5 * far * random.point();
                let target = places[i % 40].translation.as_vec3() + random.point();
                let direction =
                    if i % 2 == 0 { random.direction() } else { (target - origin).normalize() };
                let ray = Ray::new(origin, direction);
                let (a, b) = (ours.closest(&ray), copies.closest(&ray));
                assert_eq!(ours.occluded(&ray), a.is_some());
                n_hits += usize::from(b.is_some());
                match (a, b) {
                    (Some(a), Some(b)) if (a.mesh, a.triangle) == (b.mesh, b.triangle) => {
                        // Ten roundings of the largest number, on triangles met at 6° and more.
                        let error = 10.0 * 6e-8 * 2.0 * far / 0.1;
                        assert!((a.t - b.t).abs() < error, "{a:?} {b:?}");
                    }
                    (None, None) => {}
                    // At an edge of the outline, or of two triangles that cross, either is right.
                    _ => n_other += 1,
                }
            }
            assert!(n_hits > 2000, "{n_hits} hits");
            // A ray's rounding is a millionth of a triangle's size in the near places, in the far ones a
            // hundred times that.
            assert!(n_other as f32 <= 1.0 + 1e-5 * far * n_hits as f32, "{n_other} of {n_hits}");
        }
    }

    #[test]
    fn no_ray_leaves_an_instance_of_a_closed_mesh_unseen() {
        let mut random = Random(22);
        let places: Vec<DAffine3> = (0..8).map(|_| moved(&mut random, 50.0)).collect();
        let scene = with_instances(sphere(24, Vec3::ZERO), &places);
        let accel = Accel::of_objects(&scene);
        for i in 0..40_000 {
            let from = places[i % 8].translation.as_vec3();
            // At corners and middles of edges too, where two triangles must share the ray.
            let aim = scene.object(1 + (i % 8) as u32).corners(i % 1000);
            let aim = [aim[0], 0.5 * (aim[0] + aim[1]), from + random.direction()][i % 3];
            let ray = Ray::new(from, (aim - from).normalize());
            assert!(accel.occluded(&ray) && accel.closest(&ray).is_some(), "{ray:?}");
        }
    }

    #[test]
    fn rays_that_leave_an_instance_never_meet_it_again_and_those_that_enter_do() {
        let mut random = Random(23);
        for far in [0.5, 20.0, 500.0] {
            for first in [Vec3::ZERO, Vec3::splat(0.3 * far)] {
                let mut place = moved(&mut random, far);
                // About the mesh's own place, so that it goes as far as is said.
                place.translation -= place.matrix3 * first.as_dvec3();
                let scene = with_instances(sphere(24, first), &[place]);
                let accel = Accel::of_objects(&scene);
                let centre = place.transform_point3(first.as_dvec3()).as_vec3();
                for _ in 0..4000 {
                    let ray = Ray::new(centre, random.direction());
                    let Some(hit) = accel.closest_where(&ray, |mesh, _, _, _| mesh == 1) else {
                        panic!("{far} {ray:?}")
                    };
                    let at = scene.surface(List::Object, hit.mesh, hit.triangle, hit.u, hit.v);
                    let normal = at.geometric_normal;
                    assert!(normal.dot(ray.direction) > 0.0, "the outside is out");
                    let direction = random.direction();
                    let flat = direction - direction.dot(normal) * normal;
                    let flat = flat.normalize_or(normal.any_orthonormal_vector());
                    let out = (flat + (1e-3 + random.next()) * normal).normalize();
                    let own = |mesh, _, _, _| mesh == 1;
                    assert!(!accel.occluded_where(&Ray::new(at.origin_toward(out), out), own));
                    let inward = (0.9 * flat - normal).normalize();
                    assert!(accel.occluded_where(&Ray::new(at.origin_toward(inward), inward), own));
                }
            }
        }
    }

    #[test]
    fn of_two_at_one_distance_the_lower_number_counts_and_masks_let_through() {
        let ahead = DAffine3::from_translation(DVec3::Z * -5.0);
        let scene = with_instances(sphere(12, Vec3::ZERO), &[ahead, DAffine3::IDENTITY, ahead]);
        let accel = Accel::of_objects(&scene);
        let ray = Ray::new(Vec3::new(0.1, 0.2, 9.0), Vec3::NEG_Z);
        let numbers = |counts: &dyn Fn(u32) -> bool| {
            accel.closest_where(&ray, |mesh, _, _, _| counts(mesh)).map(|hit| hit.mesh)
        };
        assert_eq!(accel.closest(&ray).map(|hit| hit.mesh), Some(0));
        assert_eq!(numbers(&|mesh| mesh != 0), Some(2));
        assert_eq!(numbers(&|mesh| mesh % 2 == 1), Some(1));
        assert_eq!(numbers(&|mesh| mesh == 3), Some(3));
        assert_eq!(numbers(&|_| false), None);
        assert!(accel.occluded_where(&ray, |mesh, _, _, _| mesh == 3));
        assert!(!accel.occluded_where(&ray, |_, _, _, _| false));
        let short = Ray { t_max: 7.0, ..ray };
        assert!(!accel.occluded(&short) && accel.closest(&short).is_none());
    }

    #[test]
    fn a_thousand_places_take_the_memory_of_places() {
        let mut random = Random(24);
        let places: Vec<DAffine3> = (0..1000).map(|_| moved(&mut random, 50.0)).collect();
        let mesh = sphere(40, Vec3::ZERO);
        let once = Accel::build(&[&mesh]).n_bytes();
        let scene = with_instances(mesh, &places);
        let accel = Accel::of_objects(&scene);
        assert_eq!(accel.n_triangles(), 1001 * 4 * 40 * 39);
        assert!(accel.n_bytes() < 2 * once + 1000 * 512, "{} bytes", accel.n_bytes());
        let parts = accel.parts(16);
        assert!(parts.len() <= 16 && accel.parts(1).len() == 1);
        for corner in scene.all_objects().flat_map(|placed| placed.positions()).step_by(97) {
            let holds = |b: &Bounds| corner.cmpge(b.min).all() && corner.cmple(b.max).all();
            assert!(parts.iter().any(holds), "{corner}");
        }
    }
}
