//! Triangles for the demo: a small bounding-volume tree, and the shapes that are made of triangles.

use glam::{DVec2, DVec3};

/// A ray; `direction` has unit length.
#[derive(Clone, Copy)]
pub struct Ray {
    pub origin: DVec3,
    pub direction: DVec3,
}

/// Indexed triangles with smooth normals and, optionally, a colour a vertex. Metres.
#[derive(Clone, Default)]
pub struct Triangles {
    pub positions: Vec<DVec3>,
    pub normals: Vec<DVec3>,
    pub colours: Vec<DVec3>,
    pub faces: Vec<[u32; 3]>,
}

impl Triangles {
    /// The surface of revolution about +Y of a `profile` of (radius, height), bottom to top outside.
    ///
    /// Normals are smooth along the profile except where it turns by more than 40°.
    pub fn lathe(profile: &[(f64, f64)], segments: usize) -> Self {
        let mut mesh = Self::default();
        for pair in profile.windows(2) {
            let first = mesh.positions.len() as u32;
            for (end, &(r, y)) in pair.iter().enumerate() {
                let n = profile_normal(profile, pair, end);
                for s in 0..segments {
                    let (sin, cos) = (std::f64::consts::TAU * s as f64 / segments as f64).sin_cos();
                    mesh.positions.push(DVec3::new(r * cos, y, r * sin));
                    mesh.normals.push(DVec3::new(n.x * cos, n.y, n.x * sin));
                }
            }
            let n = segments as u32;
            for s in 0..n {
                let (a, b) = (first + s, first + (s + 1) % n);
                mesh.faces.push([a, a + n, b + n]);
                mesh.faces.push([a, b + n, b]);
            }
        }
        mesh.without_slivers().welded()
    }

    /// A folded blade from `root`, leaving at `elevation_rad` and bending down under its weight.
    pub fn blade(
        root: DVec3,
        azimuth_rad: f64,
        elevation_rad: f64,
        length: f64,
        width: f64,
    ) -> Self {
        const STEPS: u32 = 10;
        let mut mesh = Self::default();
        let out = DVec3::new(azimuth_rad.cos(), 0.0, azimuth_rad.sin());
        let side = DVec3::new(-out.z, 0.0, out.x);
        let mut centre = root;
        let mut angle = elevation_rad;
        for i in 0..=STEPS {
            let s = f64::from(i) / f64::from(STEPS);
            let along = out * angle.cos() + DVec3::Y * angle.sin();
            let across = side * (width * (0.55 + 1.6 * s * (1.0 - s)) * (1.0 - s.powi(4)));
            let up = side.cross(along).normalize();
            let up = if up.y < 0.0 { -up } else { up };
            for (x, fold) in [(-1.0, 0.35), (0.0, 0.0), (1.0, 0.35)] {
                mesh.positions.push(centre + across * x + up * (fold * across.length()));
                mesh.normals.push((up - side * (0.5 * x)).normalize());
            }
            centre += along * (length / f64::from(STEPS));
            angle -= 0.11 * (1.0 - elevation_rad.sin()) + 0.02;
        }
        for i in 0..STEPS {
            for j in 0..2 {
                let a = 3 * i + j;
                mesh.faces.push([a, a + 1, a + 4]);
                mesh.faces.push([a, a + 4, a + 3]);
            }
        }
        mesh.without_slivers()
    }

    /// An axis-parallel box from `min` to `max`.
    pub fn cuboid(min: DVec3, max: DVec3) -> Self {
        let mut mesh = Self::default();
        for axis in 0..3 {
            for far in [false, true] {
                let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
                let first = mesh.positions.len() as u32;
                for (a, b) in [(false, false), (true, false), (true, true), (false, true)] {
                    let mut p = min;
                    p[axis] = if far { max[axis] } else { min[axis] };
                    p[u] = if a { max[u] } else { min[u] };
                    p[v] = if b { max[v] } else { min[v] };
                    mesh.positions.push(p);
                    let mut n = DVec3::ZERO;
                    n[axis] = if far { 1.0 } else { -1.0 };
                    mesh.normals.push(n);
                }
                let [a, b, c, d] = [first, first + 1, first + 2, first + 3];
                if far {
                    mesh.faces.extend([[a, b, c], [a, c, d]]);
                } else {
                    mesh.faces.extend([[a, c, b], [a, d, c]]);
                }
            }
        }
        mesh
    }

    /// Positions and faces of an OBJ text (`v` and triangular `f` lines), with smooth normals.
    pub fn from_obj(text: &str) -> Option<Self> {
        let mut mesh = Self::default();
        for line in text.lines() {
            let mut words = line.split_whitespace();
            match words.next() {
                Some("v") => {
                    let mut number = || words.next()?.parse().ok();
                    mesh.positions.push(DVec3::new(number()?, number()?, number()?));
                }
                Some("f") => {
                    let mut index = || words.next()?.split('/').next()?.parse::<u32>().ok();
                    mesh.faces.push([index()? - 1, index()? - 1, index()? - 1]);
                }
                _ => {}
            }
        }
        mesh.normals = vec![DVec3::ZERO; mesh.positions.len()];
        for f in &mesh.faces {
            let [a, b, c] = f.map(|i| mesh.positions[i as usize]);
            for i in f {
                mesh.normals[*i as usize] += (b - a).cross(c - a);
            }
        }
        for n in &mut mesh.normals {
            *n = n.normalize();
        }
        Some(mesh)
    }

    /// The mesh turned by `turn_rad` about +Y, scaled, then moved.
    pub fn placed(mut self, scale: f64, turn_rad: f64, at: DVec3) -> Self {
        let turn = glam::DQuat::from_rotation_y(turn_rad);
        for p in &mut self.positions {
            *p = turn * (*p * scale) + at;
        }
        for n in &mut self.normals {
            *n = turn * *n;
        }
        self
    }

    /// Adds the triangles of `other`.
    pub fn append(&mut self, other: Self) {
        let first = self.positions.len() as u32;
        self.positions.extend(other.positions);
        self.normals.extend(other.normals);
        self.colours.extend(other.colours);
        self.faces.extend(other.faces.into_iter().map(|f| f.map(|i| i + first)));
    }

    /// Rounds to the 32-bit numbers a glTF file holds, so that file and picture agree exactly.
    pub fn rounded(mut self) -> Self {
        for v in self.positions.iter_mut().chain(&mut self.normals).chain(&mut self.colours) {
            *v = v.as_vec3().as_dvec3();
        }
        self
    }

    /// The mesh with each vertex of equal position and normal kept once. For meshes without colours.
    fn welded(self) -> Self {
        let mut mesh = Self::default();
        let mut seen = std::collections::HashMap::new();
        for f in &self.faces {
            mesh.faces.push(f.map(|i| {
                let (p, n) = (self.positions[i as usize], self.normals[i as usize]);
                let key = [p.as_vec3(), n.as_vec3()].map(|v| v.to_array().map(f32::to_bits));
                *seen.entry(key).or_insert_with(|| {
                    mesh.positions.push(p);
                    mesh.normals.push(n);
                    mesh.positions.len() as u32 - 1
                })
            }));
        }
        mesh
    }

    fn without_slivers(mut self) -> Self {
        let p = &self.positions;
        self.faces.retain(|f| {
            let [a, b, c] = f.map(|i| p[i as usize]);
            (b - a).cross(c - a).length() > 1e-14
        });
        self
    }
}

/// Outward normal (radial, vertical) at one end of a profile piece.
fn profile_normal(profile: &[(f64, f64)], pair: &[(f64, f64)], end: usize) -> DVec2 {
    let normal = |a: (f64, f64), b: (f64, f64)| DVec2::new(b.1 - a.1, a.0 - b.0).normalize();
    let own = normal(pair[0], pair[1]);
    let at = profile.iter().position(|p| *p == pair[end]).unwrap_or(0);
    let neighbour = if end == 0 {
        at.checked_sub(1).map(|i| normal(profile[i], profile[at]))
    } else {
        profile.get(at + 1).map(|next| normal(profile[at], *next))
    };
    match neighbour {
        Some(other) if own.dot(other) > 40_f64.to_radians().cos() => (own + other).normalize(),
        _ => own,
    }
}

/// What a ray met in a mesh.
pub struct MeshHit {
    pub distance: f64,
    pub geometric_normal: DVec3,
    pub shading_normal: DVec3,
    /// Interpolated vertex colour; white if the mesh has none.
    pub colour: DVec3,
}

/// Triangles sorted into a tree of boxes by median splits.
pub struct Tree {
    mesh: Triangles,
    nodes: Vec<Node>,
}

struct Node {
    min: DVec3,
    max: DVec3,
    /// First triangle and count of a leaf; the right child and 0 of an inner node.
    first: u32,
    count: u32,
}

impl Tree {
    pub fn new(mut mesh: Triangles) -> Self {
        let mut faces = std::mem::take(&mut mesh.faces);
        let mut nodes = Vec::new();
        split(&mesh.positions, &mut faces, 0, &mut nodes);
        mesh.faces = faces;
        Self { mesh, nodes }
    }

    /// The nearest triangle nearer than `limit`.
    pub fn closest(&self, ray: &Ray, limit: f64) -> Option<MeshHit> {
        let (distance, face, u, v) = self.walk(ray, limit, false)?;
        let [a, b, c] = self.mesh.faces[face].map(|i| i as usize);
        let p = &self.mesh.positions;
        let mix = |x: &[DVec3]| x[a] * (1.0 - u - v) + x[b] * u + x[c] * v;
        let colours = &self.mesh.colours;
        Some(MeshHit {
            distance,
            geometric_normal: (p[b] - p[a]).cross(p[c] - p[a]).normalize(),
            shading_normal: mix(&self.mesh.normals).normalize(),
            colour: if colours.is_empty() { DVec3::ONE } else { mix(colours) },
        })
    }

    /// True if any triangle is nearer than `limit`.
    pub fn blocks(&self, ray: &Ray, limit: f64) -> bool {
        self.walk(ray, limit, true).is_some()
    }

    fn walk(&self, ray: &Ray, limit: f64, any: bool) -> Option<(f64, usize, f64, f64)> {
        let inverse = ray.direction.recip();
        let mut best: Option<(f64, usize, f64, f64)> = None;
        // Median splits: 64 levels would need 2^64 triangles.
        let mut stack = [0_u32; 64];
        let mut waiting = 1;
        while waiting > 0 {
            waiting -= 1;
            let at = stack[waiting];
            let node = &self.nodes[at as usize];
            let near = best.map_or(limit, |b| b.0);
            if !meets_box(ray.origin, inverse, node.min, node.max, near) {
                continue;
            }
            if node.count == 0 {
                stack[waiting] = node.first;
                stack[waiting + 1] = at + 1;
                waiting += 2;
                continue;
            }
            for face in node.first as usize..(node.first + node.count) as usize {
                let corners = self.mesh.faces[face].map(|i| self.mesh.positions[i as usize]);
                let near = best.map_or(limit, |b| b.0);
                if let Some((t, u, v)) = meet_triangle(ray, corners, near) {
                    best = Some((t, face, u, v));
                    if any {
                        return best;
                    }
                }
            }
        }
        best
    }
}

fn split(p: &[DVec3], faces: &mut [[u32; 3]], first: u32, nodes: &mut Vec<Node>) {
    let corners = || faces.iter().flatten().map(|i| p[*i as usize]);
    let min = corners().fold(DVec3::INFINITY, DVec3::min) - 1e-9;
    let max = corners().fold(DVec3::NEG_INFINITY, DVec3::max) + 1e-9;
    let at = nodes.len();
    nodes.push(Node { min, max, first, count: faces.len() as u32 });
    if faces.len() <= 4 {
        return;
    }
    let size = max - min;
    let axis = (0..3).max_by(|a, b| size[*a].total_cmp(&size[*b])).unwrap_or(0);
    let middle = faces.len() / 2;
    let centre = |f: &[u32; 3]| f.iter().map(|i| p[*i as usize][axis]).sum::<f64>();
    faces.select_nth_unstable_by(middle, |a, b| centre(a).total_cmp(&centre(b)));
    let (left, right) = faces.split_at_mut(middle);
    split(p, left, first, nodes);
    nodes[at].first = nodes.len() as u32;
    nodes[at].count = 0;
    split(p, right, first + middle as u32, nodes);
}

/// True if the ray passes the box before `limit`.
pub fn meets_box(origin: DVec3, inverse: DVec3, min: DVec3, max: DVec3, limit: f64) -> bool {
    let (a, b) = ((min - origin) * inverse, (max - origin) * inverse);
    a.min(b).max_element().max(0.0) <= a.max(b).min_element().min(limit)
}

/// Möller and Trumbore 1997: distance and the second and third barycentric numbers.
fn meet_triangle(ray: &Ray, [a, b, c]: [DVec3; 3], limit: f64) -> Option<(f64, f64, f64)> {
    let (e1, e2) = (b - a, c - a);
    let q = ray.direction.cross(e2);
    let inverse = 1.0 / e1.dot(q);
    let s = ray.origin - a;
    let u = s.dot(q) * inverse;
    let r = s.cross(e1);
    let v = ray.direction.dot(r) * inverse;
    let t = e2.dot(r) * inverse;
    (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 1e-7 && t < limit).then_some((t, u, v))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::around;

    fn ball() -> Triangles {
        let profile: Vec<(f64, f64)> = (0..=16)
            .map(|i| (std::f64::consts::PI * f64::from(i) / 16.0).sin_cos())
            .map(|(sin, cos)| (sin.max(0.0), -cos))
            .collect();
        Triangles::lathe(&profile, 32)
    }

    #[test]
    fn the_tree_finds_what_trying_all_triangles_finds() {
        let mesh = ball();
        let tree = Tree::new(mesh.clone());
        for i in 0..200 {
            let i = f64::from(i);
            let origin = 2.0 * around(DVec3::Y, (i * 0.37).sin(), i * 0.618);
            let direction = (DVec3::new(0.3, 0.7, -0.3) - origin).normalize();
            let ray = Ray { origin, direction };
            let all = mesh.faces.iter().filter_map(|f| {
                meet_triangle(&ray, f.map(|i| mesh.positions[i as usize]), f64::INFINITY)
            });
            let nearest = all.map(|h| h.0).min_by(f64::total_cmp);
            assert_eq!(tree.closest(&ray, f64::INFINITY).map(|h| h.distance), nearest);
        }
    }

    #[test]
    fn normals_and_faces_of_a_lathe_point_outwards() {
        let mesh = ball();
        assert!(mesh.positions.iter().zip(&mesh.normals).all(|(p, n)| p.dot(*n) > 0.9));
        for f in &mesh.faces {
            let [a, b, c] = f.map(|i| mesh.positions[i as usize]);
            assert!((b - a).cross(c - a).dot(a + b + c) > 0.0);
        }
    }
}
