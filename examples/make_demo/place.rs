//! The demo's place: a tiled table on a terrace above the sea, late in a hazy afternoon.
//!
//! World: metres, +Y up, origin on the table top where the objects stand. The tiles are matt;
//! a pot with an aloe and two lemons on a board are real things near by that cast and receive.

use glam::DVec3;

use crate::mesh::{Ray, Tree, Triangles, meets_box};
use crate::paint::{Paint, TILE_M};
use crate::surface::{Finish, Gloss};
use crate::targets::Sheet;

/// The table top with its frame: centre and full size along x and z, metres.
pub const TABLE_CENTRE: DVec3 = DVec3::new(0.0, 0.0, -0.06);
pub const TABLE_SIZE: [f64; 2] = [14.0 * TILE_M + 2.0 * FRAME_M, 9.0 * TILE_M + 2.0 * FRAME_M];

/// Radius of the mirror ball, metres, and its reflectance.
pub const BALL_RADIUS_M: f64 = 0.06;
pub const BALL_REFLECTANCE: DVec3 = DVec3::new(0.62, 0.61, 0.60);

const FRAME_M: f64 = 0.05;
const TABLE_THICKNESS_M: f64 = 0.045;
const FLOOR_Y: f64 = -0.74;

/// Everything a ray can meet.
pub struct Place {
    things: Vec<Thing>,
    has_ball: bool,
}

struct Thing {
    shape: Shape,
    finish: Finish,
    is_object: bool,
}

enum Shape {
    Cuboid { min: DVec3, max: DVec3 },
    Ball { centre: DVec3, radius: f64 },
    Mesh(Tree),
    Sheet(Sheet),
}

/// What a ray met.
pub struct Hit<'a> {
    pub distance: f64,
    pub geometric_normal: DVec3,
    pub shading_normal: DVec3,
    /// Interpolated vertex colour.
    pub colour: DVec3,
    pub finish: &'a Finish,
    pub is_object: bool,
}

/// A real thing as the shot's `props.glb` gives it: its triangles and one plain albedo.
pub struct Prop {
    pub name: &'static str,
    pub triangles: Triangles,
    pub finish: Finish,
    /// What a person would note as its colour.
    pub albedo: DVec3,
}

impl Place {
    /// The terrace as it is found, with nothing of ours in it.
    pub fn terrace() -> Self {
        let mut place = Self { things: Vec::new(), has_ball: false };
        place.furnish();
        for prop in props() {
            place.add_mesh(prop.triangles, prop.finish);
        }
        place
    }

    /// Adds an inserted object.
    pub fn add_object(&mut self, mesh: Triangles, finish: Finish) {
        self.things.push(Thing { shape: Shape::Mesh(Tree::new(mesh)), finish, is_object: true });
    }

    /// Adds the mirror ball, standing on the table at the origin.
    pub fn add_ball(&mut self) {
        let centre = DVec3::Y * BALL_RADIUS_M;
        let paint = Paint::Plain(BALL_REFLECTANCE);
        self.has_ball = true;
        self.add(
            Shape::Ball { centre, radius: BALL_RADIUS_M },
            Finish { paint, gloss: Gloss::Mirror },
        );
    }

    /// Adds a printed target.
    pub fn add_sheet(&mut self, sheet: Sheet) {
        self.add(Shape::Sheet(sheet), matt(Paint::Sheet(sheet)));
    }

    /// The nearest thing along the ray.
    pub fn closest(&self, ray: &Ray) -> Option<Hit<'_>> {
        let mut best: Option<Hit> = None;
        for thing in &self.things {
            let limit = best.as_ref().map_or(f64::INFINITY, |b| b.distance);
            best = thing.closest(ray, limit).or(best);
        }
        best
    }

    /// True if anything stands in the ray's way.
    pub fn blocks(&self, ray: &Ray) -> bool {
        self.things.iter().any(|thing| match &thing.shape {
            Shape::Mesh(tree) => tree.blocks(ray, f64::INFINITY),
            _ => thing.closest(ray, f64::INFINITY).is_some(),
        })
    }

    /// Sunlight that the ball throws on `point`: the direction it comes from and its irradiance on a
    /// surface facing it. Random paths would find the sun in the ball too rarely.
    ///
    /// Parallel light on a convex mirror leaves as a wave of curvatures 2 / (r cos i) and 2 cos i / r
    /// (i: angle of incidence); the width of the sun is small against the spread and left out.
    pub fn ball_glint(&self, point: DVec3, sun: DVec3) -> Option<(DVec3, f64)> {
        let to_point = point - DVec3::Y * BALL_RADIUS_M;
        if !self.has_ball || to_point.length() < BALL_RADIUS_M {
            return None;
        }
        // The normal at the glint halves the angle between sun and point.
        let mut n = (sun + to_point.normalize()).normalize();
        for _ in 0..24 {
            n = (sun + (to_point - BALL_RADIUS_M * n).normalize()).normalize();
        }
        let from_glint = to_point - BALL_RADIUS_M * n;
        let (distance, cos_i) = (from_glint.length(), n.dot(sun));
        let direction = -from_glint / distance;
        if cos_i <= 0.0 || n.dot(direction) >= 0.0 {
            return None;
        }
        let glint = Ray { origin: point - from_glint + 1e-6 * n, direction: sun };
        let near = Ray { origin: point, direction };
        let in_the_way = |t: &Thing| t.closest(&near, distance - 1e-5).is_some();
        if self.blocks(&glint) || self.things.iter().any(in_the_way) {
            return None;
        }
        let spread = 2.0 * distance / BALL_RADIUS_M;
        Some((direction, 1.0 / ((1.0 + spread / cos_i) * (1.0 + spread * cos_i))))
    }

    fn add(&mut self, shape: Shape, finish: Finish) {
        self.things.push(Thing { shape, finish, is_object: false });
    }

    fn add_mesh(&mut self, mesh: Triangles, finish: Finish) {
        self.add(Shape::Mesh(Tree::new(mesh)), finish);
    }

    fn add_cuboid(&mut self, min: [f64; 3], max: [f64; 3], paint: Paint) {
        self.add(Shape::Cuboid { min: min.into(), max: max.into() }, matt(paint));
    }

    fn furnish(&mut self) {
        // The table: tiles in an oak frame on two trestles.
        let [w, d] = TABLE_SIZE.map(|s| s / 2.0);
        let (x, z) = (w - FRAME_M, d - FRAME_M);
        let (back, front) = (TABLE_CENTRE.z - d, TABLE_CENTRE.z + d);
        let low = -TABLE_THICKNESS_M;
        let (inner_back, inner_front) = (TABLE_CENTRE.z - z, TABLE_CENTRE.z + z);
        self.add_cuboid([-x, low, inner_back], [x, 0.0, inner_front], Paint::Tiles);
        self.add_cuboid([-w, low, back], [w, 0.0, inner_back], Paint::Oak(0));
        self.add_cuboid([-w, low, inner_front], [w, 0.0, front], Paint::Oak(0));
        self.add_cuboid([-w, low, inner_back], [-x, 0.0, inner_front], Paint::Oak(2));
        self.add_cuboid([x, low, inner_back], [w, 0.0, inner_front], Paint::Oak(2));
        for leg in [-0.62, 0.62] {
            self.add_cuboid(
                [leg - 0.04, FLOOR_Y, back + 0.1],
                [leg + 0.04, low, front - 0.1],
                Paint::Oak(2),
            );
        }
        // The terrace: slabs, a parapet with its coping towards the sea, the house behind the camera.
        self.add_cuboid([-7.0, FLOOR_Y - 0.1, -2.6], [7.0, FLOOR_Y, 5.0], Paint::Slabs);
        self.add_cuboid([-7.0, FLOOR_Y, -2.55], [7.0, -0.16, -2.25], Paint::Plaster);
        self.add_cuboid([-7.0, -0.16, -2.60], [7.0, -0.10, -2.20], Paint::Terracotta);
        self.add_cuboid([-5.0, FLOOR_Y, 3.6], [3.2, 3.2, 3.9], Paint::Plaster);
        self.add_cuboid([2.9, FLOOR_Y, -0.4], [3.2, 3.2, 3.9], Paint::Plaster);
        let shutter = Paint::Plain(DVec3::new(0.09, 0.20, 0.27));
        self.add_cuboid([-1.6, FLOOR_Y, 3.55], [-0.5, 1.5, 3.62], shutter);
        self.add_cuboid([2.85, 0.1, 0.6], [2.92, 1.5, 1.5], shutter);
        // A large planter by the parapet.
        let at = DVec3::new(0.86, FLOOR_Y, -1.72);
        let (pot, soil, leaves) = aloe(2.4, 34, 2.5);
        self.add_mesh(pot.placed(1.0, 0.0, at), matt(Paint::Terracotta));
        self.add_mesh(soil.placed(1.0, 0.0, at), matt(Paint::Soil));
        self.add_mesh(leaves.placed(1.0, 0.5, at), matt(Paint::Leaf));
    }
}

impl Thing {
    fn closest(&self, ray: &Ray, limit: f64) -> Option<Hit<'_>> {
        let (distance, geometric_normal, shading_normal, colour) = match &self.shape {
            Shape::Cuboid { min, max } => meet_cuboid(ray, *min, *max, limit)?,
            Shape::Ball { centre, radius } => meet_ball(ray, *centre, *radius, limit)?,
            Shape::Sheet(sheet) => meet_sheet(ray, sheet, limit)?,
            Shape::Mesh(tree) => {
                let hit = tree.closest(ray, limit)?;
                (hit.distance, hit.geometric_normal, hit.shading_normal, hit.colour)
            }
        };
        let (finish, is_object) = (&self.finish, self.is_object);
        Some(Hit { distance, geometric_normal, shading_normal, colour, finish, is_object })
    }
}

type Meeting = (f64, DVec3, DVec3, DVec3);

fn meet_cuboid(ray: &Ray, min: DVec3, max: DVec3, limit: f64) -> Option<Meeting> {
    let inverse = ray.direction.recip();
    if !meets_box(ray.origin, inverse, min, max, limit) {
        return None;
    }
    let (a, b) = ((min - ray.origin) * inverse, (max - ray.origin) * inverse);
    let (near, far) = (a.min(b), a.max(b));
    let entry = near.max_element();
    let distance = if entry > 1e-7 { entry } else { far.min_element() };
    if distance <= 1e-7 || distance >= limit {
        return None;
    }
    let planes = if entry > 1e-7 { near } else { far };
    let axis = (0..3).find(|i| planes[*i] == distance)?;
    let mut n = DVec3::ZERO;
    n[axis] = -ray.direction[axis].signum();
    Some((distance, n, n, DVec3::ONE))
}

fn meet_ball(ray: &Ray, centre: DVec3, radius: f64, limit: f64) -> Option<Meeting> {
    let v = ray.origin - centre;
    let b = v.dot(ray.direction);
    let root = (b * b - v.length_squared() + radius * radius).sqrt();
    // A ray that misses has a root that is not a number, which fails both comparisons.
    let distance = if -b - root > 1e-7 { -b - root } else { root - b };
    if !(distance > 1e-7 && distance < limit) {
        return None;
    }
    let n = (v + ray.direction * distance) / radius;
    Some((distance, n, n, DVec3::ONE))
}

fn meet_sheet(ray: &Ray, sheet: &Sheet, limit: f64) -> Option<Meeting> {
    let n = sheet.facing();
    let distance = n.dot(sheet.centre - ray.origin) / n.dot(ray.direction);
    if !(distance > 1e-7 && distance < limit) {
        return None;
    }
    let p = ray.origin + ray.direction * distance;
    sheet.contains(sheet.on_sheet(p)).then_some((distance, n, n, DVec3::ONE))
}

fn matt(paint: Paint) -> Finish {
    Finish { paint, gloss: Gloss::Matt }
}

/// The real things near the objects.
pub fn props() -> Vec<Prop> {
    let at = DVec3::new(-0.47, 0.0, -0.30);
    let (pot, soil, leaves) = aloe(1.0, 22, 1.0);
    let prop = |name, triangles: Triangles, paint, albedo: [f64; 3]| Prop {
        name,
        triangles: triangles.rounded(),
        finish: matt(paint),
        albedo: albedo.into(),
    };
    let turn = -0.35;
    let board_at = DVec3::new(0.42, 0.0, -0.21);
    let board = Triangles::cuboid(DVec3::new(-0.15, 0.0, -0.10), DVec3::new(0.15, 0.018, 0.10));
    let lemon = |x: f64, z: f64, roll: f64| {
        let body = lemon().placed(1.0, roll, DVec3::ZERO);
        body.placed(1.0, turn, board_at + DVec3::new(x, 0.018 + 0.0295, z))
    };
    let mut lemons = lemon(-0.04, -0.02, 0.6);
    lemons.append(lemon(0.045, 0.02, 2.2));
    vec![
        prop("pot", pot.placed(1.0, 0.0, at), Paint::Terracotta, [0.53, 0.26, 0.15]),
        prop("soil", soil.placed(1.0, 0.0, at), Paint::Soil, [0.07, 0.05, 0.035]),
        prop("aloe", leaves.placed(1.0, 0.0, at), Paint::Leaf, [0.18, 0.27, 0.13]),
        prop("board", board.placed(1.0, turn, board_at), Paint::Oak(0), [0.30, 0.18, 0.085]),
        prop("lemons", lemons, Paint::Peel(DVec3::new(0.80, 0.56, 0.06)), [0.80, 0.56, 0.06]),
    ]
}

/// A lemon lying along x, centred, with its two tips.
fn lemon() -> Triangles {
    let n = 40;
    let profile: Vec<(f64, f64)> = (0..=n)
        .map(|i| {
            let t = std::f64::consts::PI * f64::from(i) / f64::from(n);
            let tip = 0.009 * (-(t.sin() / 0.22).powi(2)).exp() * -t.cos().signum();
            (0.0295 * t.sin().powf(0.92), -0.038 * t.cos() + tip)
        })
        .collect();
    let mut mesh = Triangles::lathe(&profile, 48);
    for v in mesh.positions.iter_mut().chain(&mut mesh.normals) {
        *v = DVec3::new(v.y, -v.x, v.z);
    }
    mesh
}

/// A pot (`scale` × 15 cm high) standing at the origin, its soil, and an aloe of `blades` leaves.
fn aloe(scale: f64, blades: u32, leaf_scale: f64) -> (Triangles, Triangles, Triangles) {
    let profile: Vec<(f64, f64)> = [
        (0.0, 0.0),
        (0.058, 0.0),
        (0.0605, 0.003),
        (0.080, 0.112),
        (0.088, 0.112),
        (0.090, 0.115),
        (0.091, 0.145),
        (0.089, 0.148),
        (0.083, 0.148),
        (0.081, 0.146),
        (0.077, 0.125),
        (0.0, 0.125),
    ]
    .map(|(r, y)| (r * scale, y * scale))
    .to_vec();
    let pot = Triangles::lathe(&profile, 72);
    let soil = Triangles::lathe(&[(0.079 * scale, 0.130 * scale), (0.0, 0.134 * scale)], 48);
    let mut leaves = Triangles::default();
    for i in 0..blades {
        // Young leaves stand upright in the middle, old ones lie outside (137.5° apart).
        let age = (f64::from(i) + 0.5) / f64::from(blades);
        let azimuth = f64::from(i) * 2.399_963;
        let elevation = 1.45 - 1.0 * age;
        let length = leaf_scale * (0.12 + 0.10 * age) * (0.9 + 0.2 * (azimuth * 3.7).sin());
        let out = DVec3::new(azimuth.cos(), 0.0, azimuth.sin());
        let root = DVec3::Y * (0.128 * scale) + out * (0.006 + 0.016 * age) * leaf_scale;
        leaves.append(Triangles::blade(root, azimuth, elevation, length, 0.0125 * leaf_scale));
    }
    (pot, soil, leaves)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Flux through a distant sphere: what the ball takes from the sun comes out again, so the mean
    /// of the spread over all directions is a quarter of (r / d)². 2 % covers the finite grid.
    #[test]
    fn ball_throws_all_its_light_back() {
        let mut place = Place { things: Vec::new(), has_ball: false };
        place.add_ball();
        let sun = DVec3::new(0.3, 0.8, 0.1).normalize();
        let (distance, n) = (1000.0 * BALL_RADIUS_M, 4000);
        let mut sum = 0.0;
        for i in 0..n {
            let u = (f64::from(i) + 0.5) / f64::from(n);
            let out = crate::sampling::around(sun, 1.0 - 2.0 * u, 0.618_034 * f64::from(i));
            let point = DVec3::Y * BALL_RADIUS_M + distance * out;
            sum += place.ball_glint(point, sun).map_or(0.0, |g| g.1);
        }
        let expected = (BALL_RADIUS_M / distance).powi(2) / 4.0;
        assert!((sum / f64::from(n) / expected - 1.0).abs() < 0.02);
    }
}
