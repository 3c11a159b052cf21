//! The two inner steps of a walk, eight boxes and four triangles, for each instruction set.
//!
//! The box test pushes every box outward by [`BoxRay`]'s pad, which is larger than all rounding of
//! either test, so that a box is never skipped that holds a triangle the triangle test would hit;
//! nothing else about it can change a result. Triangle lanes do the operations of
//! [`triangle::intersect`] one for one: both kernels give the same bits.

use super::Ray;
use super::triangle::{self, Block, LANES, LaneHits, Shear};
use super::wide::{Node, WIDTH};

/// Largest reciprocal of a direction component: a power of two, so that its products are exact.
const MAX_RECIPROCAL: f32 = (1_u128 << 80) as f32;

/// Coordinates beyond this (metres) are refused: products with [`MAX_RECIPROCAL`] stay finite.
pub(super) const MAX_COORDINATE: f32 = (1_u64 << 40) as f32;

/// Pad in units of half an ulp of the largest coordinate.
///
/// Sum of the roundings, in units of 2⁻²⁴ · M with M the largest coordinate of ray origin plus
/// boxes: plane and origin products 4, shear of a vertex 6, distance along the ray 4; 16 holds them all.
const PAD: f32 = 16.0 / (1_u32 << 24) as f32;

/// A ray made ready for the box test: plane p is reached at `p · reciprocal + near` (or `far`).
#[derive(Clone, Copy)]
pub(super) struct BoxRay {
    pub reciprocal: [f32; 3],
    pub near: [f32; 3],
    pub far: [f32; 3],
    /// Row of [`Node::planes`] that is met first, per axis; the other one is that `^ 1`.
    pub near_plane: [usize; 3],
    pub t_min: f32,
}

impl BoxRay {
    /// Of a ray among boxes whose largest coordinate is `extent`; `None` if the ray has no points
    /// (NaN, no direction, or farther out than [`MAX_COORDINATE`]).
    #[inline(always)]
    pub fn new(ray: &Ray, extent: f32) -> Option<Self> {
        let reach = ray.origin.abs().max_element();
        let length = ray.direction.length_squared();
        let legal = reach <= MAX_COORDINATE
            && length > 0.0
            && length.is_finite()
            && !ray.origin.is_nan()
            && ray.t_min < ray.t_max;
        if !legal {
            return None;
        }
        let pad = PAD * (reach + extent);
        let mut this = Self {
            reciprocal: [0.0; 3],
            near: [0.0; 3],
            far: [0.0; 3],
            near_plane: [0; 3],
            t_min: ray.t_min.max(0.0),
        };
        for axis in 0..3 {
            let (o, d) = (ray.origin[axis], ray.direction[axis]);
            // Parallel to the slab (±0): a huge slope says "always" inside it and "never" outside.
            let reciprocal =
                if d.abs() < 1.0 / MAX_RECIPROCAL { MAX_RECIPROCAL.copysign(d) } else { 1.0 / d };
            let outward = pad.copysign(reciprocal);
            this.reciprocal[axis] = reciprocal;
            this.near[axis] = -((o + outward) * reciprocal);
            this.far[axis] = -((o - outward) * reciprocal);
            this.near_plane[axis] = 2 * axis + usize::from(reciprocal.is_sign_negative());
        }
        Some(this)
    }
}

/// The two inner steps.
pub(super) trait Kernel {
    /// Bit i: the ray meets child i not beyond `t_max`; and where it enters (garbage elsewhere).
    fn boxes(node: &Node, ray: &BoxRay, t_max: f32) -> (u32, [f32; WIDTH]);
    /// Lanes that the ray meets with `t_min < t ≤ t_max`.
    fn triangles(block: &Block, ray: &Shear, t_min: f32, t_max: f32) -> LaneHits;
}

/// Plain Rust, for every processor.
pub(super) struct Scalar;

impl Kernel for Scalar {
    #[inline(always)]
    fn boxes(node: &Node, ray: &BoxRay, t_max: f32) -> (u32, [f32; WIDTH]) {
        let mut enter = [ray.t_min; WIDTH];
        let mut leave = [t_max; WIDTH];
        for axis in 0..3 {
            let near = &node.planes[ray.near_plane[axis]];
            let far = &node.planes[ray.near_plane[axis] ^ 1];
            for i in 0..WIDTH {
                let a = near[i] * ray.reciprocal[axis] + ray.near[axis];
                let b = far[i] * ray.reciprocal[axis] + ray.far[axis];
                enter[i] = if a > enter[i] { a } else { enter[i] };
                leave[i] = if b < leave[i] { b } else { leave[i] };
            }
        }
        let mut mask = 0;
        for i in 0..WIDTH {
            mask |= u32::from(enter[i] <= leave[i]) << i;
        }
        (mask, enter)
    }

    #[inline(always)]
    fn triangles(block: &Block, ray: &Shear, t_min: f32, t_max: f32) -> LaneHits {
        let mut hits = LaneHits::NONE;
        for lane in 0..LANES {
            let corners = block.vertices.map(|v| [v[0][lane], v[1][lane], v[2][lane]]);
            if let Some([t, u, v]) = triangle::intersect(ray, corners)
                && t > t_min
                && t <= t_max
            {
                hits.mask |= 1 << lane;
                (hits.t[lane], hits.u[lane], hits.v[lane]) = (t, u, v);
            }
        }
        hits
    }
}

#[cfg(target_arch = "x86_64")]
pub(super) use avx2::Avx2;

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use std::arch::x86_64::*;

    use super::*;

    /// AVX2 and FMA: one register of boxes, half a register of triangles.
    ///
    /// Every method is inlined into a function that has the features enabled
    /// (`traverse::closest_avx2`, `traverse::occluded_avx2`), which are only entered after
    /// `is_x86_feature_detected!` said yes.
    pub(in crate::trace) struct Avx2;

    impl Kernel for Avx2 {
        #[inline(always)]
        fn boxes(node: &Node, ray: &BoxRay, t_max: f32) -> (u32, [f32; WIDTH]) {
            let mut enter = [0.0; WIDTH];
            // SAFETY: AVX2 and FMA are there (see the type); every pointer is that of a whole
            // array of eight f32, and loadu/storeu ask for no alignment.
            let mask = unsafe {
                let plane = |row: usize| _mm256_loadu_ps(node.planes.as_ptr().add(row).cast());
                let reach = |row: usize, axis: usize, offset: f32| {
                    let slope = _mm256_set1_ps(ray.reciprocal[axis]);
                    _mm256_fmadd_ps(plane(row), slope, _mm256_set1_ps(offset))
                };
                let [x, y, z] = ray.near_plane;
                let near = _mm256_max_ps(
                    _mm256_max_ps(reach(x, 0, ray.near[0]), reach(y, 1, ray.near[1])),
                    _mm256_max_ps(reach(z, 2, ray.near[2]), _mm256_set1_ps(ray.t_min)),
                );
                let far = _mm256_min_ps(
                    _mm256_min_ps(reach(x ^ 1, 0, ray.far[0]), reach(y ^ 1, 1, ray.far[1])),
                    _mm256_min_ps(reach(z ^ 1, 2, ray.far[2]), _mm256_set1_ps(t_max)),
                );
                _mm256_storeu_ps(enter.as_mut_ptr(), near);
                _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(near, far))
            };
            (mask as u32, enter)
        }

        #[inline(always)]
        fn triangles(block: &Block, ray: &Shear, t_min: f32, t_max: f32) -> LaneHits {
            let [kx, ky, kz] = ray.axes;
            // SAFETY: as in `boxes`, arrays of four f32. No FMA: the signs must be those of
            // `triangle::intersect`.
            unsafe {
                let [ox, oy, oz] = ray.origin.map(|o| _mm_set1_ps(o));
                let [sx, sy, sz] = ray.shear.map(|s| _mm_set1_ps(s));
                let sheared = |vertex: usize| {
                    let v = block.vertices[vertex].as_ptr();
                    let along = |axis: usize, origin: __m128| {
                        _mm_sub_ps(_mm_loadu_ps(v.add(axis).cast()), origin)
                    };
                    let (x, y, z) = (along(kx, ox), along(ky, oy), along(kz, oz));
                    [
                        _mm_sub_ps(x, _mm_mul_ps(sx, z)),
                        _mm_sub_ps(y, _mm_mul_ps(sy, z)),
                        _mm_mul_ps(sz, z),
                    ]
                };
                let (a, b, c) = (sheared(0), sheared(1), sheared(2));
                let edge = |p: &[__m128; 3], q: &[__m128; 3]| {
                    _mm_sub_ps(_mm_mul_ps(p[0], q[1]), _mm_mul_ps(p[1], q[0]))
                };
                let (u, v, w) = (edge(&c, &b), edge(&a, &c), edge(&b, &a));
                let zero = _mm_setzero_ps();
                let lowest = _mm_min_ps(_mm_min_ps(u, v), w);
                let highest = _mm_max_ps(_mm_max_ps(u, v), w);
                let outside = _mm_and_ps(_mm_cmplt_ps(lowest, zero), _mm_cmpgt_ps(highest, zero));
                let outside = _mm_movemask_ps(outside) as u32;
                if outside == 0b1111 {
                    return LaneHits::NONE;
                }
                let on_edge = _mm_or_ps(
                    _mm_or_ps(_mm_cmpeq_ps(u, zero), _mm_cmpeq_ps(v, zero)),
                    _mm_cmpeq_ps(w, zero),
                );
                let on_edge = _mm_movemask_ps(on_edge) as u32 & !outside;

                let reciprocal = _mm_div_ps(_mm_set1_ps(1.0), _mm_add_ps(_mm_add_ps(u, v), w));
                let t = _mm_add_ps(
                    _mm_add_ps(_mm_mul_ps(u, a[2]), _mm_mul_ps(v, b[2])),
                    _mm_mul_ps(w, c[2]),
                );
                let t = _mm_mul_ps(t, reciprocal);
                let between = _mm_and_ps(
                    _mm_cmpgt_ps(t, _mm_set1_ps(t_min)),
                    _mm_cmple_ps(t, _mm_set1_ps(t_max)),
                );
                let mut hits = LaneHits::NONE;
                hits.mask = _mm_movemask_ps(between) as u32 & !outside & !on_edge;
                if hits.mask | on_edge == 0 {
                    return hits;
                }
                _mm_storeu_ps(hits.t.as_mut_ptr(), t);
                _mm_storeu_ps(hits.u.as_mut_ptr(), _mm_mul_ps(v, reciprocal));
                _mm_storeu_ps(hits.v.as_mut_ptr(), _mm_mul_ps(w, reciprocal));
                if on_edge != 0 {
                    decide_edges(block, ray, on_edge, t_min, t_max, &mut hits);
                }
                hits
            }
        }
    }

    /// The lanes whose edge functions vanish in f32, by the plain test with its f64 fallback.
    #[cold]
    fn decide_edges(
        block: &Block,
        ray: &Shear,
        lanes: u32,
        t_min: f32,
        t_max: f32,
        hits: &mut LaneHits,
    ) {
        for lane in (0..LANES).filter(|lane| lanes >> lane & 1 == 1) {
            let corners = block.vertices.map(|v| [v[0][lane], v[1][lane], v[2][lane]]);
            if let Some([t, u, v]) = triangle::intersect(ray, corners)
                && t > t_min
                && t <= t_max
            {
                hits.mask |= 1 << lane;
                (hits.t[lane], hits.u[lane], hits.v[lane]) = (t, u, v);
            }
        }
    }
}
