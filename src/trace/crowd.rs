//! Triangles that lie in one place, kept out of the builder's way.
//!
//! The builder (PLOC) merges each box with the neighbour that makes the smallest union. Where
//! thousands of boxes are the same box, all unions tie, one pair merges in a pass, and 60 000 such
//! triangles take a minute. Each crowd is built as a single box, and divided by halves afterwards:
//! its order in the tree is no help to any ray, and no hit depends on it.

use std::collections::HashMap;
use std::collections::hash_map::DefaultHasher;
use std::hash::{Hash, Hasher};

use glam::{Vec3, Vec3A};
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::node::Bvh2Node;
use obvhs::triangle::Triangle;

use super::triangle::LANES;
use crate::scene::Bounds;

/// Boxes in one place from which on they are a crowd; fewer never hold up the builder.
const CROWD: usize = 64;
/// Boxes are in one place if they agree to this share of their own diameter.
const SAME: f32 = 1.0 / 4096.0;

/// What the builder is given instead of all triangles.
pub(super) struct Crowds {
    /// The triangles that each of the builder's primitives stands for, ascending.
    members: Vec<Vec<u32>>,
}

/// Primitives for the builder, and what they stand for; `None` if there is no crowd.
pub(super) fn gather(triangles: &[[Vec3; 3]]) -> Option<(Vec<Triangle>, Crowds)> {
    if !may_have_crowds(triangles) {
        return None;
    }
    let mut places: HashMap<[i64; 7], Vec<u32>> = HashMap::with_capacity(triangles.len());
    for (i, triangle) in triangles.iter().enumerate() {
        places.entry(place(&bounds(triangle))).or_default().push(i as u32);
    }
    if places.values().all(|place| place.len() < CROWD) {
        return None;
    }
    let (crowds, rest): (Vec<_>, Vec<_>) =
        places.into_values().partition(|place| place.len() >= CROWD);
    let mut members: Vec<Vec<u32>> = rest.into_iter().flatten().map(|i| vec![i]).collect();
    members.extend(crowds);
    // A map's order is chance; the tree's shall not be.
    members.sort_unstable_by_key(|members| members[0]);
    let primitives = members.iter().map(|members| match members[..] {
        [one] => corners(&triangles[one as usize]),
        _ => {
            let all = members.iter().map(|&i| bounds(&triangles[i as usize]));
            let all = all.fold(Bounds::EMPTY, |a, b| a.union(&b));
            corners(&[all.min, all.max, all.min])
        }
    });
    Some((primitives.collect(), Crowds { members }))
}

/// Whether some place is shared by many, or looks so: a cheap count for the meshes without.
fn may_have_crowds(triangles: &[[Vec3; 3]]) -> bool {
    let mut counts: HashMap<u32, usize> = HashMap::with_capacity(triangles.len());
    triangles.len() >= CROWD
        && triangles.iter().any(|triangle| {
            let mut hasher = DefaultHasher::new();
            place(&bounds(triangle)).hash(&mut hasher);
            let count = counts.entry(hasher.finish() as u32).or_insert(0);
            *count += 1;
            *count >= CROWD
        })
}

impl Crowds {
    /// Puts the triangles in the place of the builder's primitives: leaves of at most [`LANES`].
    pub fn unfold(&self, binary: &mut Bvh2) {
        let primitives = std::mem::take(&mut binary.primitive_indices);
        for node in 0..binary.nodes.len() {
            let Bvh2Node { first_index, prim_count, .. } = binary.nodes[node];
            if binary.nodes[node].is_leaf() {
                let held = first_index as usize..(first_index + prim_count) as usize;
                let held = primitives[held].iter().flat_map(|&i| &self.members[i as usize]);
                let held: Vec<u32> = held.copied().collect();
                divide(binary, node, &held);
            }
        }
    }
}

/// Makes a node the root of all of `held`; every node of the subtree has its box.
fn divide(binary: &mut Bvh2, node: usize, held: &[u32]) {
    if held.len() <= LANES {
        binary.nodes[node].first_index = binary.primitive_indices.len() as u32;
        binary.nodes[node].prim_count = held.len() as u32;
        binary.primitive_indices.extend(held);
        return;
    }
    let first = binary.nodes.len();
    let child = binary.nodes[node];
    binary.nodes.extend([child, child]);
    binary.nodes[node].first_index = first as u32;
    binary.nodes[node].prim_count = 0;
    let (left, right) = held.split_at(held.len() / 2);
    divide(binary, first, left);
    divide(binary, first + 1, right);
}

/// A name that boxes in one place share: their corners in steps of a share of their own size.
fn place(bounds: &Bounds) -> [i64; 7] {
    let scale = bounds.diameter().max(f32::MIN_POSITIVE).log2().floor();
    let step = f64::from(SAME) * f64::from(scale).exp2();
    let [a, b, c] = (bounds.min.as_dvec3() / step).round().to_array();
    let [d, e, f] = (bounds.max.as_dvec3() / step).round().to_array();
    [a, b, c, d, e, f, f64::from(scale)].map(|x| x as i64)
}

fn bounds(triangle: &[Vec3; 3]) -> Bounds {
    Bounds::of(triangle.iter().copied())
}

fn corners(triangle: &[Vec3; 3]) -> Triangle {
    let [v0, v1, v2] = triangle.map(Vec3A::from);
    Triangle { v0, v1, v2 }
}
