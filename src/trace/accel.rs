//! [`Accel`]: meshes made ready for rays.

use std::time::Duration;

use glam::{Vec3, Vec3A};
use obvhs::BvhBuildParams;
use obvhs::bvh2::builder::build_bvh2_from_tris;

use super::crowd;
use super::instances::Instances;
use super::kernel::MAX_COORDINATE;
use super::traverse::{self, Found, Simd};
use super::triangle::LANES;
use super::wide::{self, LEAF, Tree};
use super::{Hit, Ray};
use crate::scene::{Bounds, Instance, Mesh, Scene};

/// Meshes made ready for rays.
///
/// # Guarantees
/// - Watertight: a ray that crosses a closed surface hits it, through edges and vertices too.
/// - The hit is that of testing every triangle in turn; of two at the same distance the one with
///   the lower mesh, then lower triangle number counts.
/// - Of an instance ([`Accel::of_objects`]) that holds within rounding of the ray: of its own triangles the
///   nearest one is found by the ray as rounded in its mesh's frame; distance and weights are those of
///   the placed triangle, and by these and the numbers instances compete with all else.
/// - Both sides of a triangle are hit. Triangles without area, and those with a corner that is not
///   finite or farther out than 2⁴⁰ m, are left out: [`lost_triangles`] counts them.
#[derive(Clone, Debug)]
pub struct Accel {
    tree: Tree,
    /// Mesh and triangle of each primitive, ascending.
    ids: Vec<[u32; 2]>,
    bounds: Bounds,
    /// Largest absolute coordinate.
    extent: f32,
    simd: Simd,
    /// Only of structures with instances: others take no time for them.
    instances: Option<Box<Instances>>,
}

impl Accel {
    /// Builds over the objects of a scene and their instances; [`Hit::mesh`] is the number that
    /// [`Scene::object`] knows.
    pub fn of_objects(scene: &Scene) -> Self {
        let meshes: Vec<&Mesh> = scene.objects.iter().collect();
        Self::build(&meshes).with_instances(&meshes, &scene.instances)
    }

    fn with_instances(self, meshes: &[&Mesh], instances: &[Instance]) -> Self {
        Self { instances: Instances::build(meshes, instances).map(Box::new), ..self }
    }

    /// Builds over all triangles of `meshes`; [`Hit::mesh`] counts in their order. None is legal.
    ///
    /// Panics beyond 2³¹ triangles or with an index outside a mesh ([`Mesh`] promises there is none).
    pub fn build(meshes: &[&Mesh]) -> Self {
        let mut triangles: Vec<[Vec3; 3]> = Vec::new();
        let mut ids = Vec::new();
        for (mesh_index, mesh) in meshes.iter().enumerate() {
            for (triangle_index, corners) in mesh.triangles.iter().enumerate() {
                let triangle = corners.map(|i| mesh.positions[i as usize]);
                if can_be_hit(&triangle) {
                    triangles.push(triangle);
                    ids.push([mesh_index as u32, triangle_index as u32]);
                }
            }
        }
        assert!(triangles.len() < LEAF as usize, "{} triangles in one structure", triangles.len());

        let bounds = Bounds::of(triangles.iter().flatten().copied());
        let extent = bounds.min.abs().max(bounds.max.abs()).max_element();
        Self {
            tree: build_tree(&triangles),
            ids,
            extent: if triangles.is_empty() { 0.0 } else { extent },
            bounds,
            simd: Simd::detect(),
            instances: None,
        }
    }

    /// Nearest hit of the ray.
    pub fn closest(&self, ray: &Ray) -> Option<Hit> {
        match &self.instances {
            None => self.closest_of_own(ray, |_, _, _, _| true),
            Some(instances) => {
                let own = self.closest_of_own(ray, |_, _, _, _| true);
                instances.closest(ray, own, |_, _, _, _| true)
            }
        }
    }

    /// Nearest hit of those for which `counts(mesh, triangle, u, v)` is true (alpha masks).
    ///
    /// `counts` is asked of candidates in no particular order and must not change its mind.
    pub fn closest_where(
        &self,
        ray: &Ray,
        counts: impl Fn(u32, u32, f32, f32) -> bool,
    ) -> Option<Hit> {
        match &self.instances {
            None => self.closest_of_own(ray, counts),
            Some(instances) => {
                let own = self.closest_of_own(ray, &counts);
                instances.closest(ray, own, counts)
            }
        }
    }

    /// As [`Accel::closest_where`], without instances.
    fn closest_of_own(
        &self,
        ray: &Ray,
        counts: impl Fn(u32, u32, f32, f32) -> bool,
    ) -> Option<Hit> {
        let found = traverse::closest(&self.tree, ray, self.extent, self.simd, |i, u, v| {
            let [mesh, triangle] = self.ids[i as usize];
            counts(mesh, triangle, u, v)
        })?;
        Some(self.hit(found))
    }

    /// Whether anything lies on the ray. Faster than [`Accel::closest`]: stops at the first find.
    pub fn occluded(&self, ray: &Ray) -> bool {
        traverse::occluded(&self.tree, ray, self.extent, self.simd, |_, _, _| true)
            || self.instances.as_ref().is_some_and(|i| i.occluded(ray, |_, _, _, _| true))
    }

    /// Whether anything for which `counts(mesh, triangle, u, v)` is true lies on the ray.
    pub fn occluded_where(&self, ray: &Ray, counts: impl Fn(u32, u32, f32, f32) -> bool) -> bool {
        self.occluded_by_own(ray, &counts)
            || self.instances.as_ref().is_some_and(|instances| instances.occluded(ray, counts))
    }

    /// As [`Accel::occluded_where`], without instances.
    pub(super) fn occluded_by_own(
        &self,
        ray: &Ray,
        counts: impl Fn(u32, u32, f32, f32) -> bool,
    ) -> bool {
        traverse::occluded(&self.tree, ray, self.extent, self.simd, |i, u, v| {
            let [mesh, triangle] = self.ids[i as usize];
            counts(mesh, triangle, u, v)
        })
    }

    /// Box of all triangles; empty ([`Bounds::is_empty`]) if there is none.
    pub fn bounds(&self) -> Bounds {
        let instances = self.instances.as_ref().map_or(Bounds::EMPTY, |i| i.bounds());
        self.bounds.union(&instances)
    }

    pub fn is_empty(&self) -> bool {
        self.ids.is_empty()
    }

    /// Triangles that can be hit, those of instances once for each.
    pub fn n_triangles(&self) -> usize {
        self.ids.len() + self.instances.as_ref().map_or(0, |instances| instances.n_triangles())
    }

    /// Memory of the structure, bytes.
    pub fn n_bytes(&self) -> usize {
        size_of_val(&self.tree.nodes[..])
            + size_of_val(&self.tree.blocks[..])
            + size_of_val(&self.ids[..])
            + self.instances.as_ref().map_or(0, |instances| instances.n_bytes())
    }

    /// At most `limit` boxes (at least one if there is anything) that together hold every triangle:
    /// the top of the tree, largest boxes opened first. Tight bounds for long or scattered objects.
    pub fn parts(&self, limit: usize) -> Vec<Bounds> {
        if self.is_empty() {
            return Vec::new();
        }
        // Half of them for the instances, and for one alone a box of both.
        if let Some(instances) = &self.instances {
            if limit < 2 {
                return vec![self.bounds()];
            }
            let mut parts = self.own_parts(limit - limit / 2);
            parts.extend(instances.parts(limit - parts.len()));
            return parts;
        }
        self.own_parts(limit)
    }

    /// As [`Accel::parts`], without instances.
    fn own_parts(&self, limit: usize) -> Vec<Bounds> {
        let mut parts = vec![(0, self.bounds)];
        loop {
            let widest = (0..parts.len())
                .filter(|&i| {
                    let child: u32 = parts[i].0;
                    child & LEAF == 0
                        && parts.len() - 1 + self.tree.nodes[child as usize].n_children as usize
                            <= limit
                })
                .max_by(|&i, &j| parts[i].1.half_area().total_cmp(&parts[j].1.half_area()));
            let Some(widest) = widest else { break };
            let node = &self.tree.nodes[parts.swap_remove(widest).0 as usize];
            let children = 0..node.n_children as usize;
            parts.extend(children.map(|i| (node.children[i], node.bounds(i))));
        }
        parts.into_iter().map(|(_, bounds)| bounds).collect()
    }

    /// As [`Accel::closest_where`] without instances, with the corners of what is hit.
    pub(super) fn closest_triangle(
        &self,
        ray: &Ray,
        counts: impl Fn(u32, u32, f32, f32) -> bool,
    ) -> Option<(Hit, [Vec3; 3])> {
        let found = traverse::closest(&self.tree, ray, self.extent, self.simd, |i, u, v| {
            let [mesh, triangle] = self.ids[i as usize];
            counts(mesh, triangle, u, v)
        })?;
        let corners = self.tree.blocks[found.block as usize].triangle(found.lane as usize);
        Some((self.hit(found), corners))
    }

    fn hit(&self, found: Found) -> Hit {
        let [t, u, v] = found.at;
        let [mesh, triangle] = self.ids[found.primitive as usize];
        Hit { t, mesh, triangle, u, v }
    }
}

/// Triangles of a mesh that no ray can hit: without area, or without a finite place nearer than 2⁴⁰ m.
pub fn lost_triangles(mesh: &Mesh) -> usize {
    (0..mesh.triangles.len()).filter(|&i| !can_be_hit(&mesh.corners(i))).count()
}

/// Finite, not too far out, and not without area (in f64, where the products are exact enough).
fn can_be_hit(triangle: &[Vec3; 3]) -> bool {
    let legal = triangle.iter().all(|p| p.abs().max_element() <= MAX_COORDINATE && !p.is_nan());
    let [a, b, c] = triangle.map(Vec3::as_dvec3);
    legal && (b - a).cross(c - a) != glam::DVec3::ZERO
}

fn build_tree(triangles: &[[Vec3; 3]]) -> Tree {
    let parameters =
        BvhBuildParams { max_prims_per_leaf: LANES as u32, ..BvhBuildParams::medium_build() };
    let mut took = Duration::default();
    if let Some((primitives, crowds)) = crowd::gather(triangles) {
        let mut binary = build_bvh2_from_tris(&primitives, parameters, &mut took);
        crowds.unfold(&mut binary);
        return wide::collapse(&binary, triangles);
    }
    let builder_triangles: Vec<_> = triangles
        .iter()
        .map(|t| obvhs::triangle::Triangle {
            v0: Vec3A::from(t[0]),
            v1: Vec3A::from(t[1]),
            v2: Vec3A::from(t[2]),
        })
        .collect();
    let binary = build_bvh2_from_tris(&builder_triangles, parameters, &mut took);
    wide::collapse(&binary, triangles)
}

#[cfg(test)]
mod tests {
    use rayon::prelude::*;

    use super::*;
    use crate::scene::{Material, Place};
    use crate::trace::test_meshes::{Random, grid_box, soup, sphere};
    use crate::trace::triangle::{self, Shear};

    /// Every triangle in turn, by the definition in the guarantees of [`Accel`].
    fn brute_force(meshes: &[&Mesh], ray: &Ray) -> Option<Hit> {
        let shear = Shear::new(ray);
        let mut best: Option<Hit> = None;
        let mut t_max = ray.t_max;
        for (m, mesh) in meshes.iter().enumerate() {
            for (i, corners) in mesh.triangles.iter().enumerate() {
                let triangle = corners.map(|k| mesh.positions[k as usize]);
                if !can_be_hit(&triangle) {
                    continue;
                }
                let Some(at) = triangle::intersect(&shear, triangle.map(|p| p.to_array())) else {
                    continue;
                };
                if at[0] > ray.t_min && at[0] < t_max {
                    t_max = at[0];
                    let [t, u, v] = triangle::refine(ray, &triangle, at);
                    best = Some(Hit { t, mesh: m as u32, triangle: i as u32, u, v });
                }
            }
        }
        best
    }

    /// The structure as every instruction set of this machine walks it.
    fn every_way(meshes: &[&Mesh]) -> Vec<Accel> {
        let best = Accel::build(meshes);
        let scalar = Accel { simd: Simd::Scalar, ..best.clone() };
        if best.simd == Simd::Scalar { vec![scalar] } else { vec![scalar, best] }
    }

    fn assert_brute_force(meshes: &[&Mesh], rays: impl Iterator<Item = Ray>) -> usize {
        let ways = every_way(meshes);
        let mut hits = 0;
        for ray in rays {
            let expected = brute_force(meshes, &ray);
            hits += usize::from(expected.is_some());
            for accel in &ways {
                assert_eq!(accel.closest(&ray), expected, "{:?} {ray:?}", accel.simd);
                assert_eq!(accel.occluded(&ray), expected.is_some(), "{:?} {ray:?}", accel.simd);
            }
        }
        hits
    }

    /// `n` triangles in one place, each moved from the last by `step`, in random turns.
    fn stack(n: usize, step: f32) -> Mesh {
        let mut mesh = Mesh::default();
        for i in 0..n as u32 {
            let off = Vec3::new(step * i as f32, 0.0, -step * i as f32);
            mesh.positions.extend([Vec3::NEG_X, Vec3::X, Vec3::Y].map(|p| p + off));
            let [a, b, c] = [3 * i, 3 * i + 1, 3 * i + 2];
            mesh.triangles.push(if i % 3 == 0 { [b, c, a] } else { [a, b, c] });
        }
        mesh
    }

    #[test]
    fn hits_among_crowds_are_those_of_brute_force() {
        let meshes = [stack(700, 0.0), soup(300, 0.3, 1), stack(500, 1e-6), stack(900, 1e-4)];
        let meshes: Vec<&Mesh> = meshes.iter().collect();
        let mut random = Random(6);
        let rays = (0..600).map(|_| {
            let origin = 4.0 * random.direction();
            Ray::new(origin, (random.point() * 0.8 - origin).normalize())
        });
        assert!(assert_brute_force(&meshes, rays) > 200);
        assert_eq!(Accel::build(&meshes).n_triangles(), 2400);
    }

    #[test]
    fn a_crowd_is_a_few_boxes_to_the_builder_and_whole_in_the_tree() {
        // A pass of the builder merges one pair of a crowd: with 60 000 primitives that is a minute.
        for step in [0.0, 1e-9, 1e-8, 1e-7] {
            let mesh = stack(60_000, step);
            let triangles: Vec<[Vec3; 3]> = (0..60_000).map(|i| mesh.corners(i)).collect();
            let (primitives, _) = crowd::gather(&triangles).expect("a crowd");
            assert!(primitives.len() < 1000, "{step}: {} boxes for the builder", primitives.len());
            assert_eq!(Accel::build(&[&mesh]).n_triangles(), 60_000);
        }
    }

    #[test]
    fn hits_are_those_of_brute_force_on_random_triangles() {
        let meshes = [soup(1500, 0.2, 1), soup(500, 1.0, 2), soup(3, 0.5, 3)];
        let mut random = Random(4);
        let rays = (0..4000).map(|i| {
            let origin = random.point() * if i % 2 == 0 { 0.5 } else { 30.0 };
            let direction =
                if i % 2 == 0 { random.direction() } else { (random.point() - origin).normalize() };
            let (t_min, t_max) =
                if i % 3 == 0 { (0.1, 0.1 + random.next()) } else { (0.0, f32::INFINITY) };
            Ray { origin, direction, t_min, t_max }
        });
        let hits = assert_brute_force(&meshes.each_ref(), rays);
        assert!(hits > 1000, "{hits} hits test nothing");
    }

    #[test]
    fn far_away_rays_and_offset_meshes_lose_no_hit_of_brute_force() {
        for offset in [100.0, 1e4] {
            let mesh = sphere(12, Vec3::splat(offset));
            let mut random = Random(5);
            let rays = (0..2000).map(|_| {
                let target = mesh.positions[(random.next() * mesh.positions.len() as f32) as usize];
                let origin = Vec3::splat(offset) + 2000.0 * random.direction();
                Ray::new(origin, (target - origin).normalize())
            });
            assert_brute_force(&[&mesh], rays);
        }
    }

    #[test]
    fn no_ray_leaves_a_closed_sphere_through_a_vertex_or_an_edge() {
        for offset in [0.0, 100.0, 10_000.0] {
            let centre = Vec3::new(offset, 0.5 * offset, -offset);
            let mesh = sphere(71, centre);
            assert_eq!(mesh.triangles.len(), 4 * 71 * 70);
            let ways = every_way(&[&mesh]);
            // Two million rays over the three offsets
            (0..67_u64).into_par_iter().for_each(|seed| {
                let mut random = Random(6 + seed);
                for i in 0..10_000 {
                    let corners =
                        mesh.triangles[(random.next() * mesh.triangles.len() as f32) as usize];
                    let [a, b, _] = corners.map(|k| mesh.positions[k as usize]);
                    let along = random.next();
                    let target = if i % 2 == 0 { a } else { a + along * (b - a) };
                    let origin = centre + 0.5 * random.point();
                    let ray = Ray::new(origin, (target - origin).normalize());
                    for accel in &ways {
                        assert!(accel.closest(&ray).is_some(), "{:?} leaks {ray:?}", accel.simd);
                        assert!(accel.occluded(&ray), "{:?} leaks {ray:?}", accel.simd);
                    }
                }
            });
        }
    }

    #[test]
    fn axis_parallel_rays_through_vertices_and_edges_all_hit_the_box() {
        // 33 × 33 lines through the vertices of a 32 × 32 grid, its rim included, from both ends.
        for shift in [Vec3::ZERO, Vec3::new(3.0, -7.0, 100.0)] {
            let mesh = grid_box(32, shift);
            let ways = every_way(&[&mesh]);
            for axis in 0..3 {
                for zero in [0.0, -0.0] {
                    let mut hits = 0;
                    for (i, j, sign) in (0..33 * 33 * 2).map(|k| (k / 2 % 33, k / 66, k % 2)) {
                        let sign = if sign == 0 { 1.0 } else { -1.0 };
                        let mut origin = Vec3::ZERO;
                        origin[axis] = 0.5 - 2.0 * sign;
                        origin[(axis + 1) % 3] = i as f32 / 32.0;
                        origin[(axis + 2) % 3] = j as f32 / 32.0;
                        let mut direction = Vec3::splat(zero);
                        direction[axis] = sign;
                        let ray = Ray::new(origin + shift, direction);
                        for accel in &ways {
                            let hit = accel.closest(&ray);
                            hits += usize::from(hit.is_some_and(|h| (h.t - 1.5).abs() < 1e-4));
                            assert!(accel.occluded(&ray));
                        }
                    }
                    assert_eq!(hits, 2178 * ways.len(), "axis {axis}, zero {zero:?}, {shift}");
                }
            }
        }
    }

    #[test]
    fn bad_triangles_are_left_out_and_the_others_hit_as_before() {
        let mut mesh = soup(200, 0.3, 7);
        let good = mesh.clone();
        for corner in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e30] {
            let first = mesh.positions.len() as u32;
            mesh.positions.extend([Vec3::ZERO, Vec3::X, Vec3::new(0.0, corner, 0.0)]);
            mesh.triangles.push([first, first + 1, first + 2]);
        }
        mesh.triangles.extend([[0, 0, 1], [5, 5, 5]]);
        let accel = Accel::build(&[&mesh]);
        assert_eq!((lost_triangles(&mesh), accel.n_triangles()), (6, 200));
        let before = Accel::build(&[&good]);
        let mut random = Random(8);
        for _ in 0..1000 {
            let ray = Ray::new(random.point(), random.direction());
            assert_eq!(accel.closest(&ray), before.closest(&ray));
        }
    }

    #[test]
    fn a_thousand_identical_triangles_are_hit_once_by_the_first() {
        let one = soup(1, 0.5, 9);
        let mut mesh = one.clone();
        mesh.triangles = vec![[0, 1, 2]; 1000];
        let centre = (one.positions[0] + one.positions[1] + one.positions[2]) / 3.0;
        let ray =
            Ray::new(centre + Vec3::new(0.1, 0.2, 3.0), Vec3::new(-0.1, -0.2, -3.0).normalize());
        for accel in every_way(&[&mesh]) {
            assert_eq!(accel.closest(&ray).map(|h| h.triangle), Some(0));
        }
    }

    #[test]
    fn nothing_is_never_hit_and_has_no_bounds() {
        for accel in every_way(&[&Mesh::default()]) {
            let ray = Ray::new(Vec3::ZERO, Vec3::X);
            assert!(accel.closest(&ray).is_none() && !accel.occluded(&ray));
            assert!(accel.bounds().is_empty() && accel.is_empty() && accel.parts(8).is_empty());
        }
    }

    #[test]
    fn rays_without_points_hit_nothing() {
        let mesh = sphere(8, Vec3::ZERO);
        for accel in every_way(&[&mesh]) {
            for ray in [
                Ray::new(Vec3::NAN, Vec3::X),
                Ray::new(Vec3::ZERO, Vec3::ZERO),
                Ray::new(Vec3::ZERO, Vec3::NAN),
                Ray::new(Vec3::splat(f32::INFINITY), Vec3::X),
                Ray { t_min: 2.0, t_max: 1.0, ..Ray::new(Vec3::ZERO, Vec3::X) },
                Ray { t_max: f32::NAN, ..Ray::new(Vec3::ZERO, Vec3::X) },
            ] {
                assert!(accel.closest(&ray).is_none() && !accel.occluded(&ray), "{ray:?}");
            }
        }
    }

    #[test]
    fn a_mask_lets_the_ray_through_to_what_counts() {
        let meshes = [sphere(16, Vec3::ZERO), sphere(16, Vec3::new(3.0, 0.0, 0.0))];
        for accel in every_way(&meshes.each_ref()) {
            let ray = Ray::new(Vec3::new(-5.0, 0.1, 0.2), Vec3::X);
            assert_eq!(accel.closest(&ray).map(|h| h.mesh), Some(0));
            let second = accel.closest_where(&ray, |mesh, _, _, _| mesh == 1).unwrap();
            assert_eq!(second.mesh, 1);
            assert!(accel.occluded_where(&ray, |mesh, _, _, _| mesh == 1));
            assert!(!accel.occluded_where(&ray, |_, _, _, _| false));
            assert!(accel.closest_where(&ray, |_, _, _, _| false).is_none());
        }
    }

    #[test]
    fn parts_hold_every_triangle_in_at_most_as_many_boxes_as_asked() {
        let mesh = soup(500, 0.1, 11);
        let accel = Accel::build(&[&mesh]);
        for limit in [1, 2, 8, 32] {
            let parts = accel.parts(limit);
            assert!((1..=limit).contains(&parts.len()));
            for corners in &mesh.triangles {
                let inside = |b: &Bounds| {
                    let held = |&i: &u32| {
                        let p = mesh.positions[i as usize];
                        p.cmpge(b.min).all() && p.cmple(b.max).all()
                    };
                    corners.iter().all(held)
                };
                assert!(parts.iter().any(inside));
            }
        }
        assert!(accel.parts(32).len() > 8);
    }

    #[test]
    fn rays_that_leave_a_convex_thing_never_meet_it_again_and_those_that_enter_do() {
        // A small thing near the origin, one far off it, and a ball the size of a hall.
        for (centre, radius) in [(0.0, 0.1), (0.0, 1.0), (500.0, 1.0), (0.0, 100.0)] {
            let mut mesh = sphere(40, Vec3::ZERO);
            for p in &mut mesh.positions {
                *p = *p * radius + Vec3::splat(centre);
            }
            let scene = Scene {
                objects: vec![mesh],
                materials: vec![Material::default()],
                ..Scene::default()
            };
            let accel = Accel::build(&[&scene.objects[0]]);
            let mut random = Random(12);
            for _ in 0..20_000 {
                let ray = Ray::new(Vec3::splat(centre), random.direction());
                let hit = accel.closest(&ray).unwrap();
                let at = scene.surface(Place::Object, hit.mesh, hit.triangle, hit.u, hit.v);
                // Grazing ones too: down to 1e-4 rad over the facet
                let direction = random.direction();
                let flat = direction - direction.dot(at.geometric_normal) * at.geometric_normal;
                let rise = if random.next() < 0.5 { 1e-4 } else { random.next() };
                let out =
                    (flat.normalize_or(ray.direction) + rise * at.geometric_normal).normalize();
                assert!(!accel.occluded(&Ray::new(at.origin_toward(out), out)), "{radius} {out}");
                let inward = -at.geometric_normal + 0.9 * flat;
                let inward = inward.normalize();
                assert!(accel.occluded(&Ray::new(at.origin_toward(inward), inward)));
            }
        }
    }
}
