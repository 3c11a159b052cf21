//! The shot's models, put where the shot file says.

use glam::{DAffine3, DMat3, DVec2, DVec3};

use super::file::{Albedo, Object, SupportShape};
use super::plan::Plan;
use crate::probe::file::rotation_xyz_deg;
use crate::report::overlay::Ground;
use crate::scene::{AlbedoSource, LocalRole, Model, Scene, SceneError, assemble};

/// Where an object of the shot stands.
pub fn world_from_model(object: &Object) -> DAffine3 {
    let turned = DMat3::from_quat(rotation_xyz_deg(object.rotate)) * object.scale;
    DAffine3::from_mat3_translation(turned, object.at.into())
}

/// Support, local things and objects in one frame near the objects.
///
/// # Errors
/// What has no room in the world, see [`Model::check_place`].
pub fn scene(plan: &Plan) -> Result<Scene, SceneError> {
    let placed = placed_objects(plan);
    // The frames of a sequence share the light, which lies in the scene's frame: an origin that things
    // do not carry along.
    let origin = match plan.moves() || placed.is_empty() {
        true => support_centre(plan),
        false => assemble::centre(&placed),
    };
    let mut scene = Scene::new(origin);
    let albedo = match plan.shot.support.albedo {
        Albedo::Plate => AlbedoSource::Plate,
        Albedo::Mesh => AlbedoSource::Material,
        Albedo::Constant(rgb) => AlbedoSource::Constant(DVec3::from(rgb).as_vec3()),
    };
    match (&plan.shot.support.shape, &plan.support) {
        (SupportShape::Plane { size, at, normal }, _) => {
            scene.add_plane(DVec2::from(*size), (*at).into(), (*normal).into(), albedo)?;
        }
        (SupportShape::Mesh(_), Some(model)) => {
            scene.add_local(model, &DAffine3::IDENTITY, LocalRole::Support, albedo)?;
        }
        (SupportShape::Mesh(_), None) => {}
    }
    for (keys, model) in plan.shot.local.iter().zip(&plan.local) {
        let role = if keys.holdout { LocalRole::Holdout } else { LocalRole::Prop };
        scene.add_local(model, &DAffine3::IDENTITY, role, AlbedoSource::Plate)?;
    }
    for (model, world_from_model) in placed {
        scene.add_object(model, &world_from_model)?;
    }
    for material in &mut scene.materials {
        material.multiple_scattering = plan.shot.render.multiple_scattering;
    }
    Ok(scene)
}

fn placed_objects(plan: &Plan) -> Vec<(&Model, DAffine3)> {
    let objects = plan.shot.objects.iter().zip(&plan.objects);
    objects.map(|(object, model)| (model, world_from_model(object))).collect()
}

/// Name and box of every object: the box of its own axes, placed; corners counted in binary (x, y, z).
pub fn object_boxes(plan: &Plan) -> Vec<(&str, [DVec3; 8])> {
    let boxes = placed_objects(plan).into_iter().filter_map(|(model, at)| {
        let ends = model.bounds(&DAffine3::IDENTITY)?;
        let corner = |i: usize| {
            let [x, y, z] = [i & 1, i >> 1 & 1, i >> 2 & 1];
            at.transform_point3(DVec3::new(ends[x].x, ends[y].y, ends[z].z))
        };
        Some((model.name.as_str(), std::array::from_fn(corner)))
    });
    boxes.collect()
}

/// World box of the objects; `None` without any.
pub fn object_box(plan: &Plan) -> Option<[DVec3; 2]> {
    let boxes = placed_objects(plan).into_iter().filter_map(|(model, at)| model.bounds(&at));
    boxes.reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])])
}

/// World box of the objects in all frames of the shot; `None` without any.
pub fn swept_box(plan: &Plan) -> Option<[DVec3; 2]> {
    let boxes = placed_objects(plan).into_iter().enumerate().filter_map(|(i, (model, at))| {
        if plan.object_moves(i) { model.swept_bounds(&at) } else { model.bounds(&at) }
    });
    boxes.reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])])
}

/// Point on the ground below the middle of the objects.
pub fn foot(plan: &Plan) -> DVec3 {
    object_box(plan).map_or_else(
        || support_centre(plan),
        |[min, max]| DVec3::new(0.5 * (min.x + max.x), min.y, 0.5 * (min.z + max.z)),
    )
}

fn support_box(plan: &Plan) -> Option<[DVec3; 2]> {
    plan.support.as_ref()?.bounds(&DAffine3::IDENTITY)
}

fn support_centre(plan: &Plan) -> DVec3 {
    match plan.shot.support.shape {
        SupportShape::Plane { at, .. } => at.into(),
        SupportShape::Mesh(_) => {
            support_box(plan).map_or(DVec3::ZERO, |[min, max]| 0.5 * (min + max))
        }
    }
}

/// A point of the support near `place` and its normal there, for what needs a plane.
///
/// A mesh counts as level through the highest of its triangles below `place`.
pub fn support_plane(plan: &Plan, place: DVec3) -> Option<(DVec3, DVec3)> {
    match plan.shot.support.shape {
        SupportShape::Plane { at, normal, .. } => {
            Some((at.into(), DVec3::from(normal).normalize_or(DVec3::Y)))
        }
        SupportShape::Mesh(_) => {
            let y = highest_below(plan.support.as_ref()?, place)?;
            Some((DVec3::new(place.x, y, place.z), DVec3::Y))
        }
    }
}

/// Height of the highest surface of the model on the vertical through `place`, below it.
fn highest_below(model: &Model, place: DVec3) -> Option<f64> {
    let mut highest: Option<f64> = None;
    for mesh in &model.meshes {
        for triangle in &mesh.triangles {
            let [a, b, c] = triangle.map(|i| mesh.positions[i as usize]);
            if let Some(y) = height_at(a, b, c, place).filter(|&y| y <= place.y) {
                highest = Some(highest.map_or(y, |h| h.max(y)));
            }
        }
    }
    highest
}

/// Height of a triangle's plane over (x, z) of `place`, if that lies inside it.
fn height_at(a: DVec3, b: DVec3, c: DVec3, place: DVec3) -> Option<f64> {
    let flat = |p: DVec3| DVec2::new(p.x - place.x, p.z - place.z);
    let (fa, fb, fc) = (flat(a), flat(b), flat(c));
    let area = (fb - fa).perp_dot(fc - fa);
    if area == 0.0 {
        return None;
    }
    let (u, v) = (fa.perp_dot(fb) / area, fc.perp_dot(fa) / area);
    let inside = u >= 0.0 && v >= 0.0 && u + v <= 1.0;
    // Weights of c and b: areas over the point's opposite sides.
    inside.then_some(a.y + v * (b.y - a.y) + u * (c.y - a.y))
}

/// The support as a rectangle to draw; `None` where it has no extent.
pub fn ground(plan: &Plan) -> Option<Ground> {
    match plan.shot.support.shape {
        SupportShape::Plane { size, at, normal } => {
            let normal = DVec3::from(normal).normalize_or(DVec3::Y);
            let x = (DVec3::X - normal * normal.x).try_normalize()?;
            Some(Ground {
                centre: at.into(),
                sides: [x, x.cross(normal)],
                half_size: [0.5 * size[0], 0.5 * size[1]],
            })
        }
        SupportShape::Mesh(_) => {
            let [min, max] = support_box(plan)?;
            let mut centre = 0.5 * (min + max);
            centre.y = support_plane(plan, foot(plan) + DVec3::Y * 0.01)?.0.y;
            Some(Ground {
                centre,
                sides: [DVec3::X, DVec3::Z],
                half_size: [0.5 * (max.x - min.x), 0.5 * (max.z - min.z)],
            })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shot::motion::Motion;

    #[test]
    fn objects_are_scaled_then_turned_about_x_y_z_then_moved() {
        let object = Object {
            file: "a.glb".into(),
            at: [1.0, 2.0, 3.0],
            rotate: [0.0, 90.0, 0.0],
            scale: 2.0,
            motion: Motion::default(),
        };
        let p = world_from_model(&object).transform_point3(DVec3::Z);
        assert!((p - DVec3::new(3.0, 2.0, 3.0)).length() < 1e-12, "{p}");
        // About X first: Y goes to Z, then about Z nothing moves it.
        let tilted = Object { rotate: [90.0, 0.0, 90.0], at: [0.0; 3], scale: 1.0, ..object };
        let q = world_from_model(&tilted).transform_point3(DVec3::Y);
        assert!((q - DVec3::Z).length() < 1e-12, "{q}");
    }

    #[test]
    fn height_on_a_slope_is_interpolated() {
        let (a, b, c) = (DVec3::ZERO, DVec3::new(2.0, 1.0, 0.0), DVec3::new(0.0, 3.0, 2.0));
        let at = |x: f64, z: f64| height_at(a, b, c, DVec3::new(x, 9.0, z));
        assert!((at(0.5, 0.5).unwrap() - (0.25 + 0.75)).abs() < 1e-12);
        assert_eq!(at(1.5, 1.5), None);
    }
}
