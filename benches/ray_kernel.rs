//! The ray kernel on a place of 98 000 triangles: rolling ground with twenty bumpy balls.
//!
//! `cargo bench --bench ray_kernel`. Rays a second, one thread, for camera rays, cosine bounces and
//! shadow rays to a sun, and the time to build. The answers are checked before the clock starts:
//! a thousand rays of each kind against every triangle in turn, and `occluded` against `closest`.

use std::f32::consts::{PI, TAU};
use std::sync::LazyLock;

use divan::counter::ItemsCount;
use divan::{Bencher, black_box};
use glam::{DMat3, DVec3, Vec3};
use platelight::scene::Mesh;
use platelight::trace::{Accel, Ray};

/// Rays of each kind.
const N: usize = 50_000;

struct Place {
    meshes: Vec<Mesh>,
    accel: Accel,
    camera: Vec<Ray>,
    bounce: Vec<Ray>,
    shadow: Vec<Ray>,
}

static PLACE: LazyLock<Place> = LazyLock::new(|| {
    let meshes = meshes();
    let accel = Accel::build(&meshes.iter().collect::<Vec<_>>());
    let mut random = Random(7);
    let eye = Vec3::new(0.0, 6.0, 14.0);
    let camera: Vec<Ray> = (0..N)
        .map(|_| {
            let aim = Vec3::new(16.0 * random.next() - 8.0, 0.0, 14.0 * random.next() - 9.0);
            Ray::new(eye, (aim - eye).normalize())
        })
        .collect();
    let sun = Vec3::new(0.5, 0.6, -0.3).normalize();
    let (mut bounce, mut shadow) = (Vec::new(), Vec::new());
    for ray in &camera {
        let Some(hit) = accel.closest(ray) else { continue };
        let [a, b, c] = meshes[hit.mesh as usize].corners(hit.triangle as usize);
        let normal = (b - a).cross(c - a).normalize();
        let normal = if normal.dot(ray.direction) > 0.0 { -normal } else { normal };
        let from = ray.at(hit.t) + 1e-4 * normal;
        let (x, y) = normal.any_orthonormal_pair();
        let (phi, radius2) = (TAU * random.next(), random.next());
        let flat = radius2.sqrt() * (x * phi.cos() + y * phi.sin());
        bounce.push(Ray::new(from, (flat + normal * (1.0 - radius2).sqrt()).normalize()));
        shadow.push(Ray::new(from, sun));
    }
    let place = Place { meshes, accel, camera, bounce, shadow };
    place.check();
    place
});

impl Place {
    fn check(&self) {
        for rays in [&self.camera, &self.bounce, &self.shadow] {
            for ray in rays.iter().step_by(rays.len() / 1000) {
                let hit = self.accel.closest(ray);
                let expected = nearest_by_plane_equations(&self.meshes, ray);
                let same = match (hit, expected) {
                    (Some(hit), Some(t)) => (f64::from(hit.t) - t).abs() < 1e-4 * t.max(1e-3),
                    (None, None) => true,
                    // On a rim either answer is right; the watertight test's own is pinned elsewhere.
                    _ => false,
                };
                assert!(same, "{ray:?}: {hit:?} is not at {expected:?}");
                assert_eq!(self.accel.occluded(ray), hit.is_some());
            }
        }
    }
}

/// Distance of the nearest triangle by solving for it in f64, an independent way.
fn nearest_by_plane_equations(meshes: &[Mesh], ray: &Ray) -> Option<f64> {
    let (origin, direction) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
    let mut nearest: Option<f64> = None;
    for mesh in meshes {
        for triangle in 0..mesh.triangles.len() {
            let [a, b, c] = mesh.corners(triangle).map(Vec3::as_dvec3);
            let system = DMat3::from_cols(b - a, c - a, -direction);
            if system.determinant().abs() < 1e-18 {
                continue;
            }
            let DVec3 { x: u, y: v, z: t } = system.inverse() * (origin - a);
            if u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 0.0 && nearest.is_none_or(|n| t < n) {
                nearest = Some(t);
            }
        }
    }
    nearest
}

/// A small generator, so that the rays never change.
struct Random(u64);

impl Random {
    fn next(&mut self) -> f32 {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f32 / (1 << 24) as f32
    }
}

fn ground_height(x: f32, z: f32) -> f32 {
    0.3 * (1.3 * x).sin() * (1.1 * z).cos() + 0.05 * (7.0 * x).sin() * (9.0 * z).sin()
}

fn meshes() -> Vec<Mesh> {
    let ground = grid(158, 158, |u, v| {
        let (x, z) = (20.0 * (u - 0.5), 20.0 * (v - 0.5));
        Vec3::new(x, ground_height(x, z), z)
    });
    let mut random = Random(3);
    let mut meshes = vec![ground];
    for _ in 0..20 {
        let (x, z) = (14.0 * random.next() - 7.0, 14.0 * random.next() - 7.0);
        let radius = 0.3 + 0.5 * random.next();
        let centre = Vec3::new(x, ground_height(x, z) + radius, z);
        meshes.push(grid(50, 25, |u, v| {
            let (phi, theta) = (TAU * u, PI * v);
            let d = Vec3::new(theta.sin() * phi.cos(), theta.cos(), theta.sin() * phi.sin());
            let bumps = (9.0 * d.x).sin() * (11.0 * d.y).sin() * (7.0 * d.z).sin();
            centre + radius * (1.0 + 0.1 * bumps) * d
        }));
    }
    meshes
}

/// A surface over (0…1)², `columns` × `rows` squares.
fn grid(columns: u32, rows: u32, point: impl Fn(f32, f32) -> Vec3) -> Mesh {
    let mut mesh = Mesh::default();
    for j in 0..=rows {
        for i in 0..=columns {
            mesh.positions.push(point(i as f32 / columns as f32, j as f32 / rows as f32));
        }
    }
    for j in 0..rows {
        for i in 0..columns {
            let a = j * (columns + 1) + i;
            let (b, c, d) = (a + 1, a + columns + 1, a + columns + 2);
            mesh.triangles.extend([[a, c, b], [b, c, d]]);
        }
    }
    mesh
}

fn main() {
    let place = &*PLACE;
    println!(
        "{} triangles, {:.0} bytes each",
        place.accel.n_triangles(),
        place.accel.n_bytes() as f64 / place.accel.n_triangles() as f64
    );
    divan::main();
}

#[divan::bench]
fn build(bencher: Bencher) {
    let meshes: Vec<&Mesh> = PLACE.meshes.iter().collect();
    bencher.counter(ItemsCount::new(PLACE.accel.n_triangles())).bench(|| Accel::build(&meshes));
}

fn rays(kind: &str) -> &'static [Ray] {
    match kind {
        "camera" => &PLACE.camera,
        "bounce" => &PLACE.bounce,
        _ => &PLACE.shadow,
    }
}

#[divan::bench(args = ["camera", "bounce", "shadow"])]
fn closest(bencher: Bencher, kind: &str) {
    let rays = rays(kind);
    bencher
        .counter(ItemsCount::new(rays.len()))
        .bench(|| rays.iter().filter(|ray| PLACE.accel.closest(black_box(ray)).is_some()).count());
}

#[divan::bench(args = ["camera", "bounce", "shadow"])]
fn occluded(bencher: Bencher, kind: &str) {
    let rays = rays(kind);
    bencher
        .counter(ItemsCount::new(rays.len()))
        .bench(|| rays.iter().filter(|ray| PLACE.accel.occluded(black_box(ray))).count());
}
