//! Watertight ray–triangle test (Woop, Benthin, Wald 2013, "Watertight Ray/Triangle Intersection").
//!
//! The ray is sheared onto the z axis and the three edge functions of the triangle are judged by
//! sign. A product rounded to f32 is a monotone function of the exact product, so the sign of a
//! difference of two rounded products is right or zero, never wrong; a zero is decided in f64,
//! where the products are exact. Two triangles that share an edge see the same numbers for it with
//! opposite sign, hence no ray passes between them. No fused multiply-add here: it would round the
//! two sides of an edge differently.

use glam::Vec3;

use super::Ray;

/// Triangles tested together.
pub(super) const LANES: usize = 4;

/// A ray made ready for the triangle test.
#[derive(Clone, Copy)]
pub(super) struct Shear {
    /// Along `axes`.
    pub origin: [f32; 3],
    /// The axes: `axes[2]` is the one along which the direction is longest.
    pub axes: [usize; 3],
    /// Shear along x and y and scale along z that take the direction to (0, 0, 1).
    pub shear: [f32; 3],
}

impl Shear {
    /// Of a ray with finite origin and a finite direction that is not zero.
    #[inline(always)]
    pub fn new(ray: &Ray) -> Self {
        let d = ray.direction.to_array();
        let a = ray.direction.abs();
        // By arithmetic: of rays in all directions no branch could be foretold.
        let z = if a.z > a.x.max(a.y) { 2 } else { usize::from(a.y > a.x) };
        let axes = [[1, 2, 0], [2, 0, 1], [0, 1, 2]][z];
        let [x, y, z] = axes;
        let reciprocal = 1.0 / d[z];
        Self {
            origin: axes.map(|axis| ray.origin[axis]),
            axes,
            shear: [d[x] * reciprocal, d[y] * reciprocal, reciprocal],
        }
    }
}

/// Four triangles, vertex by vertex and axis by axis; unused lanes are NaN and never hit.
#[repr(C, align(32))]
#[derive(Clone, Debug)]
pub(super) struct Block {
    /// `[vertex][axis][lane]`.
    pub vertices: [[[f32; LANES]; 3]; 3],
    /// Which triangle of the structure each lane is.
    pub primitives: [u32; LANES],
}

impl Block {
    pub const EMPTY: Self =
        Self { vertices: [[[f32::NAN; LANES]; 3]; 3], primitives: [u32::MAX; LANES] };

    pub fn set(&mut self, lane: usize, triangle: &[Vec3; 3], primitive: u32) {
        for (vertex, position) in self.vertices.iter_mut().zip(triangle) {
            for (axis, lanes) in vertex.iter_mut().enumerate() {
                lanes[lane] = position[axis];
            }
        }
        self.primitives[lane] = primitive;
    }

    /// The triangle in `lane`.
    pub fn triangle(&self, lane: usize) -> [Vec3; 3] {
        self.vertices.map(|v| Vec3::new(v[0][lane], v[1][lane], v[2][lane]))
    }
}

/// What the test says of the lanes of a block; `t`, `u`, `v` hold only where `mask` has its bit.
#[derive(Clone, Copy)]
pub(super) struct LaneHits {
    pub mask: u32,
    pub t: [f32; LANES],
    pub u: [f32; LANES],
    pub v: [f32; LANES],
}

impl LaneHits {
    pub const NONE: Self = Self { mask: 0, t: [0.0; LANES], u: [0.0; LANES], v: [0.0; LANES] };
}

/// Distance and barycentric weights (second, third vertex) where the ray meets the triangle's
/// inside or border. The caller judges the distance.
#[inline(always)]
pub(super) fn intersect(ray: &Shear, triangle: [[f32; 3]; 3]) -> Option<[f32; 3]> {
    let [kx, ky, kz] = ray.axes;
    let [ox, oy, oz] = ray.origin;
    let [sx, sy, sz] = ray.shear;
    let sheared = triangle.map(|p| {
        let z = p[kz] - oz;
        [(p[kx] - ox) - sx * z, (p[ky] - oy) - sy * z, sz * z]
    });
    let [a, b, c] = sheared;
    let u = c[0] * b[1] - c[1] * b[0];
    let v = a[0] * c[1] - a[1] * c[0];
    let w = b[0] * a[1] - b[1] * a[0];
    if (u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0) {
        return None;
    }
    if u == 0.0 || v == 0.0 || w == 0.0 {
        return intersect_exact(&sheared);
    }
    let reciprocal = 1.0 / (u + v + w);
    let t = u * a[2] + v * b[2] + w * c[2];
    Some([t * reciprocal, v * reciprocal, w * reciprocal])
}

/// The same from sheared vertices, edge functions in f64, where their signs are exact.
#[cold]
pub(super) fn intersect_exact(sheared: &[[f32; 3]; 3]) -> Option<[f32; 3]> {
    let [a, b, c] = sheared.map(|p| p.map(f64::from));
    let u = c[0] * b[1] - c[1] * b[0];
    let v = a[0] * c[1] - a[1] * c[0];
    let w = b[0] * a[1] - b[1] * a[0];
    if (u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0) {
        return None;
    }
    let determinant = u + v + w;
    if determinant == 0.0 || determinant.is_nan() {
        return None;
    }
    let t = (u * a[2] + v * b[2] + w * c[2]) / determinant;
    Some([t as f32, (v / determinant) as f32, (w / determinant) as f32])
}

/// Distance and barycentric weights of a hit found by [`intersect`], recomputed in f64.
///
/// On a triangle of 1000 m a weight in f32 is known to 0.1 mm only, which is seen in shadows and
/// reflections close by. Where the ray lies in the triangle's plane `coarse` stays.
#[inline(always)]
pub(super) fn refine(ray: &Ray, triangle: &[Vec3; 3], coarse: [f32; 3]) -> [f32; 3] {
    let [a, b, c] = triangle.map(Vec3::as_dvec3);
    let direction = ray.direction.as_dvec3();
    let (ab, ac, from_a) = (b - a, c - a, ray.origin.as_dvec3() - a);
    // Cramer's rule for origin + t · direction = a + u · ab + v · ac (Möller, Trumbore 1997)
    let (p, q) = (direction.cross(ac), from_a.cross(ab));
    let inverse = 1.0 / ab.dot(p);
    let t = ac.dot(q) * inverse;
    // Near grazing the plane's t runs away from the triangle; the coarse t never leaves it.
    let reach = 1e-5 * ab.abs().max(ac.abs()).max_element()
        + 1e-6 * (t.abs() + f64::from(ray.origin.abs().max_element()));
    let agrees = (t - f64::from(coarse[0])).abs() <= reach;
    if !agrees {
        return coarse;
    }
    let u = (from_a.dot(p) * inverse).clamp(0.0, 1.0);
    let v = (direction.dot(q) * inverse).clamp(0.0, 1.0 - u);
    [t as f32, u as f32, v as f32]
}

#[cfg(test)]
mod tests {
    use super::*;

    const TRIANGLE: [[f32; 3]; 3] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];

    fn shoot(origin: Vec3, direction: Vec3) -> Option<[f32; 3]> {
        intersect(&Shear::new(&Ray::new(origin, direction)), TRIANGLE)
    }

    #[test]
    fn weights_belong_to_the_second_and_third_vertex() {
        let [t, u, v] = shoot(Vec3::new(0.5, 0.125, 2.0), -Vec3::Z).unwrap();
        assert_eq!([t, u, v], [2.0, 0.5, 0.125]);
    }

    #[test]
    fn vertices_and_edges_belong_to_the_triangle_from_both_sides() {
        for (x, y) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (0.5, 0.5), (0.25, 0.0), (0.0, 0.75)] {
            for z in [3.0, -3.0] {
                let hit = shoot(Vec3::new(x, y, z), Vec3::new(0.0, -0.0, -f32::signum(z)));
                assert_eq!(hit, Some([3.0, x, y]));
            }
        }
        assert_eq!(shoot(Vec3::new(0.5 + 1e-6, 0.5, 3.0), -Vec3::Z), None);
    }

    #[test]
    fn a_ray_in_the_plane_misses() {
        assert_eq!(shoot(Vec3::new(-1.0, 0.25, 0.0), Vec3::X), None);
    }

    #[test]
    fn nan_vertices_never_count_as_a_hit_in_front() {
        let hit = intersect(&Shear::new(&Ray::new(Vec3::Z, -Vec3::Z)), [[f32::NAN; 3]; 3]);
        assert!(hit.is_none_or(|[t, _, _]| t.is_nan()));
    }

    #[test]
    fn refining_gives_a_large_triangle_its_tenth_of_a_millimetre() {
        let big = [Vec3::new(-1e3, 0.0, -1e3), Vec3::new(1e3, 0.0, -1e3), Vec3::new(0.1, 0.0, 2e3)];
        let direction = Vec3::new(0.3, -0.6, 0.2).normalize();
        let ray = Ray::new(Vec3::new(0.123, 2.0, 0.456), direction);
        let coarse = intersect(&Shear::new(&ray), big.map(|p| p.to_array())).unwrap();
        let [t, u, v] = refine(&ray, &big, coarse);
        let exact = -f64::from(ray.origin.y) / f64::from(direction.y);
        assert!((f64::from(t) - exact).abs() < 2e-7 * exact);
        let position = big[0] + u * (big[1] - big[0]) + v * (big[2] - big[0]);
        // Weights of f32 on 3000 m of triangle are good to 6e-8 × 3000 m.
        assert!((position - ray.at(t)).length() < 1e-3);
    }
}
