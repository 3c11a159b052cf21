//! The two walks through the tree: nearest hit, and any hit at all.
//!
//! Children are visited nearest first. Of two hits at the same distance the triangle with the lower
//! number counts, so that the answer does not depend on the way through the tree.

use std::mem::MaybeUninit;
use std::sync::atomic::{AtomicBool, Ordering};

use super::Ray;
use super::kernel::{BoxRay, Kernel, Scalar};
use super::triangle::{self, LANES, Shear};
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

/// See [`portable_only`].
static PORTABLE_ONLY: AtomicBool = AtomicBool::new(false);

/// Structures that are built from now on are walked without AVX2, as on a processor that lacks it.
///
/// The same hits, to the last bit, take longer to find: this is how to check that, and what to try
/// where a processor claims more than it can.
pub fn portable_only() {
    PORTABLE_ONLY.store(true, Ordering::Relaxed);
}

impl Simd {
    /// The best this processor has and [`portable_only`] allows.
    pub fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        if !PORTABLE_ONLY.load(Ordering::Relaxed)
            && is_x86_feature_detected!("avx2")
            && is_x86_feature_detected!("fma")
        {
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
    match simd {
        Simd::Scalar => closest_walk::<Scalar>(tree, ray, extent, &filter),
        #[cfg(target_arch = "x86_64")]
        // SAFETY: this value exists only after AVX2 and FMA were detected.
        Simd::Avx2 => unsafe { closest_avx2(tree, ray, extent, &filter) },
    }
}

/// Whether anything that `filter` lets count lies on the ray.
pub(super) fn occluded(
    tree: &Tree,
    ray: &Ray,
    extent: f32,
    simd: Simd,
    filter: impl Filter,
) -> bool {
    match simd {
        Simd::Scalar => occluded_walk::<Scalar>(tree, ray, extent, &filter),
        #[cfg(target_arch = "x86_64")]
        // SAFETY: this value exists only after AVX2 and FMA were detected.
        Simd::Avx2 => unsafe { occluded_avx2(tree, ray, extent, &filter) },
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn closest_avx2(tree: &Tree, ray: &Ray, extent: f32, filter: &impl Filter) -> Option<Found> {
    closest_walk::<super::kernel::Avx2>(tree, ray, extent, filter)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn occluded_avx2(tree: &Tree, ray: &Ray, extent: f32, filter: &impl Filter) -> bool {
    occluded_walk::<super::kernel::Avx2>(tree, ray, extent, filter)
}

/// References that wait, the last one pushed is the next. Never holds more than the tree's
/// `stack_need`, which is what its room is checked against once, before the walk.
struct Stack<'a> {
    waiting: &'a mut [MaybeUninit<u64>],
    len: usize,
}

impl<'a> Stack<'a> {
    /// In `small` if it is large enough for every walk through `tree`, else in `large`.
    #[inline(always)]
    fn new(
        tree: &Tree,
        small: &'a mut [MaybeUninit<u64>],
        large: &'a mut Vec<MaybeUninit<u64>>,
    ) -> Self {
        if tree.stack_need <= small.len() {
            return Self { waiting: small, len: 0 };
        }
        large.resize(tree.stack_need, MaybeUninit::uninit());
        Self { waiting: large, len: 0 }
    }

    #[inline(always)]
    fn push(&mut self, key: u64) {
        debug_assert!(self.len < self.waiting.len());
        // SAFETY: a walk has at most `stack_need` references waiting (see `wide::stack_need`).
        unsafe { self.waiting.get_unchecked_mut(self.len).write(key) };
        self.len += 1;
    }

    #[inline(always)]
    fn pop(&mut self) -> Option<u64> {
        self.len = self.len.checked_sub(1)?;
        // SAFETY: every place below the old `len` was written by `push`.
        Some(unsafe { self.waiting.get_unchecked(self.len).assume_init() })
    }

    /// Sorts the last `n` descending: the nearest comes out first.
    #[inline(always)]
    fn sort_last(&mut self, n: usize) {
        debug_assert!(n <= self.len);
        // SAFETY: there are that many, and they were written by `push`.
        let last: &mut [u64] = unsafe {
            let first = self.waiting.as_mut_ptr().add(self.len - n);
            std::slice::from_raw_parts_mut(first.cast(), n)
        };
        for i in 1..n {
            let key = last[i];
            let mut place = i;
            while place > 0 && last[place - 1] < key {
                last[place] = last[place - 1];
                place -= 1;
            }
            last[place] = key;
        }
    }
}

/// Distance in the upper half, so that references sort by it (distances are not negative).
#[inline(always)]
fn waiting(enter: f32, child: u32) -> u64 {
    u64::from(enter.to_bits() & 0x7fff_ffff) << 32 | u64::from(child)
}

#[inline(always)]
fn closest_walk<K: Kernel>(
    tree: &Tree,
    ray: &Ray,
    extent: f32,
    filter: &impl Filter,
) -> Option<Found> {
    let boxes = &BoxRay::new(ray, extent)?;
    let shear = &Shear::new(ray);
    let (mut small, mut large) = ([MaybeUninit::uninit(); STACK], Vec::new());
    let mut stack = Stack::new(tree, &mut small, &mut large);
    let mut best: Option<Found> = None;
    let mut t_max = ray.t_max;
    let mut child = 0;
    if tree.nodes.is_empty() {
        return None;
    }
    'walk: loop {
        if child & LEAF == 0 {
            let node = &tree.nodes[child as usize];
            let (mut mask, enter) = K::boxes(node, boxes, t_max);
            if mask != 0 {
                let i = mask.trailing_zeros() as usize % WIDTH;
                mask &= mask - 1;
                if mask == 0 {
                    child = node.children[i];
                    continue;
                }
                let mut n = 1;
                let mut nearest = waiting(enter[i], node.children[i]);
                while mask != 0 {
                    let i = mask.trailing_zeros() as usize % WIDTH;
                    mask &= mask - 1;
                    let key = waiting(enter[i], node.children[i]);
                    stack.push(nearest.max(key));
                    nearest = nearest.min(key);
                    n += 1;
                }
                if n > 2 {
                    stack.sort_last(n - 1);
                }
                child = nearest as u32;
                continue;
            }
        } else {
            let index = child & !LEAF;
            let block = &tree.blocks[index as usize];
            let hits = K::triangles(block, shear, boxes.t_min, t_max);
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
            let Some(key) = stack.pop() else { break 'walk };
            if f32::from_bits((key >> 32) as u32) <= t_max {
                child = key as u32;
                break;
            }
        }
    }
    let mut found = best?;
    let triangle = tree.blocks[found.block as usize].triangle(found.lane as usize);
    found.at = triangle::refine(ray, &triangle, found.at);
    Some(found)
}

#[inline(always)]
fn occluded_walk<K: Kernel>(tree: &Tree, ray: &Ray, extent: f32, filter: &impl Filter) -> bool {
    let Some(boxes) = &BoxRay::new(ray, extent) else { return false };
    let shear = &Shear::new(ray);
    let (mut small, mut large) = ([MaybeUninit::uninit(); STACK], Vec::new());
    let mut stack = Stack::new(tree, &mut small, &mut large);
    if tree.nodes.is_empty() {
        return false;
    }
    let mut child = 0;
    loop {
        if child & LEAF == 0 {
            let node = &tree.nodes[child as usize];
            let (mut mask, _) = K::boxes(node, boxes, ray.t_max);
            if mask != 0 {
                loop {
                    let i = mask.trailing_zeros() as usize % WIDTH;
                    mask &= mask - 1;
                    child = node.children[i];
                    if mask == 0 {
                        break;
                    }
                    stack.push(u64::from(child));
                }
                continue;
            }
        } else {
            let block = &tree.blocks[(child & !LEAF) as usize];
            let hits = K::triangles(block, shear, boxes.t_min, ray.t_max);
            for lane in (0..LANES).filter(|lane| hits.mask >> lane & 1 == 1) {
                if hits.t[lane] < ray.t_max
                    && filter(block.primitives[lane], hits.u[lane], hits.v[lane])
                {
                    return true;
                }
            }
        }
        let Some(key) = stack.pop() else { return false };
        child = key as u32;
    }
}
