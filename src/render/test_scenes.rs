//! Small scenes with known answers, for the tests of this room.

use glam::{DVec3, Vec3};

use super::{Context, Difference, Job, Method, Numbers, Stop, Technique, Wave, integrator};
use crate::camera::{Camera, Lens, Pose};
use crate::conventions::Rgb;
use crate::light::{Disc, Environment, Lights};
use crate::photo::Image;
use crate::scene::{AlbedoSource, LocalMesh, LocalRole, Material, Mesh, Scene};

/// A sphere of geodesic triangles: an octahedron, `levels` times divided, with smooth normals.
///
/// Corners lie on a sphere slightly larger than `radius`, so that the volume is that of the sphere.
pub fn sphere(centre: Vec3, radius: f32, levels: u32) -> Mesh {
    let mut triangles: Vec<[Vec3; 3]> = Vec::new();
    for x in [Vec3::X, -Vec3::X] {
        for y in [Vec3::Y, -Vec3::Y] {
            for z in [Vec3::Z, -Vec3::Z] {
                let outward = x.cross(y).dot(z) > 0.0;
                triangles.push(if outward { [x, y, z] } else { [x, z, y] });
            }
        }
    }
    for _ in 0..levels {
        triangles = triangles
            .into_iter()
            .flat_map(|[a, b, c]| {
                let mid = |p: Vec3, q: Vec3| (p + q).normalize();
                let (ab, bc, ca) = (mid(a, b), mid(b, c), mid(c, a));
                [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
            })
            .collect();
    }
    let volume: f32 = triangles.iter().map(|[a, b, c]| a.dot(b.cross(*c)) / 6.0).sum();
    let scale = radius * (4.0 / 3.0 * std::f32::consts::PI / volume).cbrt();
    let normals: Vec<Vec3> = triangles.into_iter().flatten().collect();
    Mesh {
        name: "sphere".into(),
        positions: normals.iter().map(|n| centre + scale * *n).collect(),
        triangles: (0..normals.len() as u32 / 3).map(|k| [3 * k, 3 * k + 1, 3 * k + 2]).collect(),
        normals,
        ..Mesh::default()
    }
}

/// A rectangle spanned by two edges from a corner; its front looks along a × b.
pub fn rectangle(corner: Vec3, a: Vec3, b: Vec3) -> Mesh {
    Mesh {
        name: "rectangle".into(),
        positions: vec![corner, corner + a, corner + a + b, corner + b],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..Mesh::default()
    }
}

/// A horizontal ground about the origin.
pub fn ground(half_size: f32) -> Mesh {
    let s = 2.0 * half_size;
    rectangle(Vec3::new(-half_size, 0.0, half_size), Vec3::X * s, Vec3::NEG_Z * s)
}

pub fn local(mesh: Mesh, albedo: AlbedoSource) -> LocalMesh {
    LocalMesh { mesh, role: LocalRole::Support, albedo }
}

/// A matt material.
pub fn matt(albedo: f32) -> Material {
    Material { base_colour: Rgb::splat(albedo).extend(1.0), specular: 0.0, ..Material::default() }
}

/// Objects of one material over local meshes.
pub fn scene(objects: Vec<Mesh>, material: Material, local: Vec<LocalMesh>) -> Scene {
    Scene { objects, local, materials: vec![material], ..Scene::default() }
}

/// A sky of one radiance.
pub fn uniform_sky(radiance: f32) -> Lights {
    Lights::from_parts(Environment::constant(Rgb::splat(radiance)), Vec::new())
}

/// A gradient sky with a real sun of the given elevation (degrees) toward +x.
pub fn sunny_sky(elevation: f32, sun_irradiance: f32) -> Lights {
    let picture = Image::from_fn(64, 32, |_, j| {
        if j < 16 { Rgb::new(0.5, 0.7, 1.0) * (0.6 + 0.05 * j as f32) } else { Rgb::splat(0.1) }
    });
    let environment = Environment::new(&picture, glam::DQuat::IDENTITY, true).unwrap();
    let (sin, cos) = elevation.to_radians().sin_cos();
    let half = crate::conventions::SUN_HALF_ANGLE_RAD as f32;
    let sun = Disc::from_irradiance(Vec3::new(cos, sin, 0.0), half, Rgb::splat(sun_irradiance));
    Lights::from_parts(environment, vec![sun])
}

/// A narrow camera whose pixels look at `points` on the ground, one row, straight down.
///
/// Far away and through tiny pixels, so that a pixel is a point.
pub fn point_camera(points: &[f32]) -> (Vec<Camera>, usize) {
    let cameras = points
        .iter()
        .map(|&x| {
            let eye = DVec3::new(f64::from(x), 50.0, 0.0);
            let target = DVec3::new(f64::from(x), 0.0, 0.0);
            let pose = Pose::look_at(eye, target, DVec3::NEG_Z).unwrap();
            Camera { width: 4, height: 4, lens: Lens::pinhole(1e5, 4, 4), pose }
        })
        .collect();
    (cameras, 16)
}

/// A camera that looks at the origin from a corner.
pub fn corner_camera(width: usize, height: usize, distance: f64) -> Camera {
    let eye = DVec3::new(0.35, 0.5, 1.0).normalize() * distance;
    let pose = Pose::look_at(eye, DVec3::new(0.0, 0.15 * distance * 0.3, 0.0), DVec3::Y).unwrap();
    Camera { width, height, lens: Lens::pinhole(1.2 * width as f64, width, height), pose }
}

/// A job like any user's, without a filter.
pub fn plain_job<'a>(
    scene: &'a Scene,
    lights: &'a Lights,
    camera: &'a Camera,
    plate: &'a Image<Rgb>,
    stop: Stop,
) -> Job<'a> {
    Job {
        scene,
        lights,
        camera,
        plate,
        stop,
        numbers: Numbers::SobolOwen,
        least_step: 0.0,
        denoise: false,
        technique: Technique::default(),
    }
}

/// Renders a job to its end; what it comes to, held for its window, and the last wave.
pub fn finish(method: Method, job: Job, seed: u64) -> (Difference, Wave) {
    let mut integrator = integrator(method, job).unwrap();
    let context = Context::new(seed);
    loop {
        let wave = integrator.next_wave(&context);
        if wave.finished() {
            return (integrator.snapshot(), wave);
        }
    }
}

/// Renders to the end.
pub fn render(
    scene: &Scene,
    lights: &Lights,
    camera: &Camera,
    plate: &Image<Rgb>,
    method: Method,
    samples: u32,
    seed: u64,
) -> Difference {
    let job = plain_job(scene, lights, camera, plate, Stop::Samples(samples));
    finish(method, job, seed).0.whole()
}

/// Mean ratio over the picture and its standard error from the pixels' scatter.
pub fn mean_ratio(difference: &Difference) -> (f64, f64) {
    let values: Vec<f64> = difference.ratio.pixels().iter().map(|r| f64::from(r.x)).collect();
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0);
    (mean, (variance / n).sqrt())
}
