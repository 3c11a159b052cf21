//! The two walks through the tree: nearest hit, and any hit at all.
//!
//! Children are visited nearest first. Of two hits at the same distance the triangle with the lower
//! number counts, so that the answer does not depend on the way through the tree.

use super::Ray;
use super::kernel::{BoxRay, Kernel, Scalar};
use super::triangle::{LANES, Shear};
use super::wide::{LEAF, Tree, WIDTH};

/// References that fit on the machine's stack; deeper trees (none was met in practice) allocate.
const STACK: usize = 128;

/// A hit by the number of its triangle in the structure, and where its block is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Found {
    pub primitive: u32,
    pub block: u32,
    pub lane: u32,
    /// t, u, v.
    pub at: [f32; 3],
}

/// Instruction set of the walk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Simd {
    Scalar,
    /// Holds only where AVX2 and FMA were detected: made by [`Simd::detect`] alone.
    #[cfg(target_arch = "x86_64")]
    Avx2,
}

impl Simd {
    /// The best this processor has.
    pub fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
            return Self::Avx2;
        }
        Self::Scalar
    }
}

/// Which hits count: `(primitive, u, v)`; must answer the same whenever asked.
pub(super) trait Filter: Fn(u32, f32, f32) -> bool {}
impl<F: Fn(u32, f32, f32) -> bool> Filter for F {}

/// The nearest hit that `filter` lets count.
pub(super) fn closest(
    tree: &Tree,
    ray: &Ray,
    extent: f32,
    simd: Simd,
    filter: impl Filter,
) -> Option<Found> {
    let boxes = BoxRay::new(ray, extent)?;
    with_stack(tree, |stack| match simd {
        Simd::Scalar => closest_loop::<Scalar>(tree, ray, &boxes, stack, &filter),
        #[cfg(target_arch = "x86_64")]
        // SAFETY: this value exists only after AVX2 and FMA were detected.
        Simd::Avx2 => unsafe { closest_avx2(tree, ray, &boxes, stack, &filter) },
    })
}

/// Whether anything that `filter` lets count lies on the ray.
pub(super) fn occluded(
    tree: &Tree,
    ray: &Ray,
    extent: f32,
    simd: Simd,
    filter: impl Filter,
) -> bool {
    let Some(boxes) = BoxRay::new(ray, extent) else { return false };
    with_stack(tree, |stack| match simd {
        Simd::Scalar => occluded_loop::<Scalar>(tree, ray, &boxes, stack, &filter),
        #[cfg(target_arch = "x86_64")]
        // SAFETY: this value exists only after AVX2 and FMA were detected.
        Simd::Avx2 => unsafe { occluded_avx2(tree, ray, &boxes, stack, &filter) },
    })
}

#[inline(always)]
fn with_stack<R>(tree: &Tree, walk: impl FnOnce(&mut [u64]) -> R) -> R {
    if tree.stack_need <= STACK {
        walk(&mut [0; STACK])
    } else {
        walk(&mut vec![0; tree.stack_need])
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn closest_avx2(
    tree: &Tree,
    ray: &Ray,
    boxes: &BoxRay,
    stack: &mut [u64],
    filter: &impl Filter,
) -> Option<Found> {
    closest_loop::<super::kernel::Avx2>(tree, ray, boxes, stack, filter)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn occluded_avx2(
    tree: &Tree,
    ray: &Ray,
    boxes: &BoxRay,
    stack: &mut [u64],
    filter: &impl Filter,
) -> bool {
    occluded_loop::<super::kernel::Avx2>(tree, ray, boxes, stack, filter)
}

/// Distance in the upper half, so that references sort by it (distances are not negative).
#[inline(always)]
fn waiting(enter: f32, child: u32) -> u64 {
    u64::from(enter.to_bits() & 0x7fff_ffff) << 32 | u64::from(child)
}

#[inline(always)]
fn closest_loop<K: Kernel>(
    tree: &Tree,
    ray: &Ray,
    boxes: &BoxRay,
    stack: &mut [u64],
    filter: &impl Filter,
) -> Option<Found> {
    let shear = Shear::new(ray);
    let mut best: Option<Found> = None;
    let mut t_max = ray.t_max;
    let mut child = 0;
    let mut n = 0;
    if tree.nodes.is_empty() {
        return None;
    }
    loop {
        if child & LEAF == 0 {
            let node = &tree.nodes[child as usize];
            let (mut mask, enter) = K::boxes(node, boxes, t_max);
            // Push the children that are met, farthest first
            let base = n;
            while mask != 0 {
                let i = mask.trailing_zeros() as usize % WIDTH;
                mask &= mask - 1;
                let key = waiting(enter[i], node.children[i]);
                let mut place = n;
                while place > base && stack[place - 1] < key {
                    stack[place] = stack[place - 1];
                    place -= 1;
                }
                stack[place] = key;
                n += 1;
            }
        } else {
            let index = child & !LEAF;
            let block = &tree.blocks[index as usize];
            let hits = K::triangles(block, &shear, boxes.t_min, t_max);
            let mut mask = hits.mask;
            while mask != 0 {
                let lane = mask.trailing_zeros() as usize % LANES;
                mask &= mask - 1;
                let (t, primitive) = (hits.t[lane], block.primitives[lane]);
                let nearer = match &best {
                    None => t < t_max,
                    Some(best) => t < t_max || (t == t_max && primitive < best.primitive),
                };
                if nearer && filter(primitive, hits.u[lane], hits.v[lane]) {
                    t_max = t;
                    let at = [t, hits.u[lane], hits.v[lane]];
                    best = Some(Found { primitive, block: index, lane: lane as u32, at });
                }
            }
        }
        // Take the nearest that waits, unless a hit lies before it
        loop {
            if n == 0 {
                return best;
            }
            n -= 1;
            if f32::from_bits((stack[n] >> 32) as u32) <= t_max {
                child = stack[n] as u32;
                break;
            }
        }
    }
}

#[inline(always)]
fn occluded_loop<K: Kernel>(
    tree: &Tree,
    ray: &Ray,
    boxes: &BoxRay,
    stack: &mut [u64],
    filter: &impl Filter,
) -> bool {
    let shear = Shear::new(ray);
    if tree.nodes.is_empty() {
        return false;
    }
    stack[0] = 0;
    let mut n = 1;
    while n > 0 {
        n -= 1;
        let child = stack[n] as u32;
        if child & LEAF == 0 {
            let node = &tree.nodes[child as usize];
            let (mut mask, _) = K::boxes(node, boxes, ray.t_max);
            while mask != 0 {
                let i = mask.trailing_zeros() as usize % WIDTH;
                mask &= mask - 1;
                stack[n] = u64::from(node.children[i]);
                n += 1;
            }
        } else {
            let block = &tree.blocks[(child & !LEAF) as usize];
            let hits = K::triangles(block, &shear, boxes.t_min, ray.t_max);
            for lane in (0..LANES).filter(|lane| hits.mask >> lane & 1 == 1) {
                if hits.t[lane] < ray.t_max
                    && filter(block.primitives[lane], hits.u[lane], hits.v[lane])
                {
                    return true;
                }
            }
        }
    }
    false
}
