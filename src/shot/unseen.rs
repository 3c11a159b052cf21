//! Real surfaces that the plate does not show: their albedo cannot be solved from it.

use super::shown::Shown;
use crate::report::Warning;
use crate::scene::{AlbedoSource, Scene};

/// Names the local surfaces whose albedo was to come from the plate and that no pixel shows.
pub fn warning(scene: &Scene, shown: &Shown) -> Option<Warning> {
    let mut seen = vec![false; scene.local.len()];
    for pixel in &shown.grid {
        seen[pixel.hit.mesh as usize] = true;
    }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{Camera, Lens, Pose};
    use crate::scene::{LocalMesh, LocalRole, Mesh};
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
        let said = warning(&scene, &Shown::new(&scene, &camera)).unwrap().message;
        assert!(said.contains("room shelf") && !said.contains("table"), "{said}");
        scene.local[1].albedo = AlbedoSource::Constant(Vec3::splat(0.5));
        assert_eq!(warning(&scene, &Shown::new(&scene, &camera)), None, "its colour was given");
    }
}
