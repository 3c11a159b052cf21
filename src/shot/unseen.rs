//! Real surfaces that the plate does not show: their albedo cannot be solved from it.

use glam::DVec2;

use crate::camera::Camera;
use crate::report::Warning;
use crate::scene::{AlbedoSource, Mesh, Scene};
use crate::trace::{Accel, Ray};

/// Rays that look for surfaces, about: a surface smaller than a six-thousandth of the plate may be missed,
/// as the renderer's own grid of albedos may miss it.
const RAYS: usize = 6000;

/// Names the local surfaces whose albedo was to come from the plate and that no pixel shows.
pub fn warning(scene: &Scene, camera: &Camera) -> Option<Warning> {
    let seen = seen(scene, camera);
    let mut names: Vec<String> = Vec::new();
    for (local, _) in scene.local.iter().zip(seen).filter(|(_, seen)| !seen) {
        let placed = scene.local_names.get(local.mesh.placed).map_or("", String::as_str);
        let name = format!("{placed} {}", local.mesh.name).trim().to_owned();
        if local.albedo == AlbedoSource::Plate && !names.contains(&name) {
            names.push(name);
        }
    }
    (!names.is_empty()).then(|| {
        Warning::new(
            "local",
            format!(
                "the plate does not show {}, so that nobody knows its colour; it is taken to reflect \
                 25 % of the light",
                names.join(", ")
            ),
            "what it throws back on the objects is off by its true albedo ÷ 0.25",
        )
    })
}

/// Which local meshes a grid of the camera's rays meets first.
fn seen(scene: &Scene, camera: &Camera) -> Vec<bool> {
    let meshes: Vec<&Mesh> = scene.local.iter().map(|local| &local.mesh).collect();
    let local = Accel::build(&meshes);
    let mut seen = vec![false; meshes.len()];
    let step =
        ((camera.width * camera.height) as f64 / RAYS as f64).sqrt().ceil().max(1.0) as usize;
    for y in (step / 2..camera.height).step_by(step) {
        for x in (step / 2..camera.width).step_by(step) {
            let Some((origin, direction)) = camera.ray(DVec2::new(x as f64, y as f64)) else {
                continue;
            };
            let ray = Ray::new((origin - scene.origin).as_vec3(), direction.as_vec3());
            if let Some(hit) = local.closest(&ray) {
                seen[hit.mesh as usize] = true;
            }
        }
    }
    seen
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{Lens, Pose};
    use crate::scene::{LocalMesh, LocalRole};
    use glam::{DVec3, Vec3};

    /// A level square of 2 m.
    fn square(name: &str, centre: Vec3) -> LocalMesh {
        let corners = [(-1.0, -1.0), (-1.0, 1.0), (1.0, 1.0), (1.0, -1.0)];
        let mesh = Mesh {
            name: name.to_owned(),
            positions: corners.map(|(x, z)| centre + Vec3::new(x, 0.0, z)).to_vec(),
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Mesh::default()
        };
        LocalMesh { mesh, role: LocalRole::Prop, albedo: AlbedoSource::Plate }
    }

    #[test]
    fn only_what_no_pixel_shows_is_named() {
        let eye = DVec3::new(0.0, 3.0, 3.0);
        let pose = Pose::look_at(eye, DVec3::ZERO, DVec3::Y).unwrap();
        let camera = Camera { width: 96, height: 64, lens: Lens::pinhole(90.0, 96, 64), pose };
        let behind = Vec3::new(0.0, 3.0, 9.0);
        let mut scene = Scene {
            local: vec![square("table", Vec3::ZERO), square("shelf", behind)],
            local_names: vec!["room".to_owned()],
            ..Scene::default()
        };
        let said = warning(&scene, &camera).unwrap().message;
        assert!(said.contains("room shelf") && !said.contains("table"), "{said}");
        scene.local[1].albedo = AlbedoSource::Constant(Vec3::splat(0.5));
        assert_eq!(warning(&scene, &camera), None, "its colour was given");
    }
}
