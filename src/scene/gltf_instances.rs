//! `EXT_mesh_gpu_instancing`: one mesh at many places of its node.

use std::path::Path;

use glam::{DVec3, DVec4};
use gltf::json::Value;

use super::SceneError;
use super::buffers::Buffers;
use super::hierarchy::Local;

/// The extension's name.
pub(super) const INSTANCING: &str = "EXT_mesh_gpu_instancing";

/// Where a node's mesh stands in the node, time after time; `None` without the extension.
///
/// # Errors
/// Attributes that are no accessors, of another kind, or not of one length.
pub(super) fn places(
    path: &Path,
    document: &gltf::Document,
    node: &gltf::Node,
    buffers: &Buffers,
) -> Result<Option<Vec<Local>>, SceneError> {
    let Some(extension) = node.extension_value(INSTANCING) else { return Ok(None) };
    let place = format!("nodes[{}].extensions.{INSTANCING}.attributes", node.index());
    let broken = |key: &str, problem: String| SceneError::Broken {
        path: path.into(),
        place: if key.is_empty() { place.clone() } else { format!("{place}.{key}") },
        problem,
    };
    let attributes = extension.get("attributes").and_then(Value::as_object);
    let Some(attributes) = attributes else {
        return Err(broken("", "it is missing, or no object".into()));
    };
    let accessor = |key: &str| {
        let Some(value) = attributes.get(key) else { return Ok(None) };
        let n = document.as_json().accessors.len();
        let index = value.as_u64().filter(|&index| index < n as u64);
        let found = index.and_then(|index| document.accessors().nth(index as usize));
        let problem = || format!("{value} is none of the {n} accessors");
        found.map(Some).ok_or_else(|| broken(key, problem()))
    };
    let translations = accessor("TRANSLATION")?;
    let rotations = accessor("ROTATION")?;
    let scales = accessor("SCALE")?;
    let counts = [&translations, &rotations, &scales].map(|a| a.as_ref().map(|a| a.count()));
    let Some(n) = counts.iter().flatten().next().copied() else { return Ok(None) };
    if let Some(other) = counts.iter().flatten().find(|&&other| other != n) {
        return Err(broken("", format!("one has {n} elements, another {other}")));
    }
    // What is there first: its length is judged before anything is made of it.
    let vectors = |accessor: Option<gltf::Accessor>, use_: &str| {
        let read = accessor.map(|accessor| buffers.floats::<3>(&accessor, use_)).transpose()?;
        Ok::<_, SceneError>(read.unwrap_or_default())
    };
    let translations = vectors(translations, "instances' translations")?;
    let scales = vectors(scales, "instances' scales")?;
    let rotations =
        rotations.map(|accessor| buffers.floats::<4>(&accessor, "instances' rotations"));
    let rotations = rotations.transpose()?.unwrap_or_default();
    let vector = |values: &[[f32; 3]], i: usize, otherwise: DVec3| {
        values.get(i).map_or(otherwise, |v| DVec3::from(v.map(f64::from)))
    };
    let local = |i: usize| Local::Apart {
        translation: vector(&translations, i, DVec3::ZERO),
        rotation: rotations.get(i).map_or(DVec4::W, |q| DVec4::from(q.map(f64::from))),
        scale: vector(&scales, i, DVec3::ONE),
    };
    Ok(Some((0..n).map(local).collect()))
}

#[cfg(test)]
mod tests {
    use glam::DQuat;

    use super::*;
    use crate::scene::gltf_tests::{CORNERS, floats, read_with};
    use crate::scene::{Model, SceneError};

    /// About Z by 90°.
    const QUARTER: [f32; 4] =
        [0.0, 0.0, std::f32::consts::FRAC_1_SQRT_2, std::f32::consts::FRAC_1_SQRT_2];

    /// A triangle at the places that `attributes` give it, in a node 10 m along Z that has a child with
    /// the triangle too. Accessors: 0 corners, 1 two translations, 2 two rotations, 3 two scales, 4 one
    /// scale, 5 four milliards of scales out of nothing.
    fn read(attributes: &str) -> Result<Model, SceneError> {
        let numbers = [
            &CORNERS[..],
            &[1.0, 0.0, 0.0, 5.0, 0.0, 0.0],
            &[0.0, 0.0, 0.0, 1.0],
            &QUARTER,
            &[1.0, 1.0, 1.0, -2.0, 2.0, 2.0],
        ]
        .concat();
        let accessor = |offset: usize, count: u64, kind: &str| {
            format!(
                r#"{{"bufferView":0,"byteOffset":{offset},"componentType":5126,"count":{count},"type":"{kind}"}}"#
            )
        };
        let accessors = [
            accessor(0, 3, "VEC3"),
            accessor(36, 2, "VEC3"),
            accessor(60, 2, "VEC4"),
            accessor(92, 2, "VEC3"),
            accessor(92, 1, "VEC3"),
            accessor(92, 4_000_000_000, "VEC3"),
        ];
        let body = format!(
            r#""nodes":[{{"mesh":0,"translation":[0,0,10],"children":[1],
                "extensions":{{"{INSTANCING}":{{"attributes":{attributes}}}}}}},{{"mesh":0}}],
            "extensionsUsed":["{INSTANCING}"],"extensionsRequired":["{INSTANCING}"],
            "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}}}}]}}],
            "accessors":[{}],"bufferViews":[{{"buffer":0,"byteLength":116}}]"#,
            accessors.join(",")
        );
        read_with(&body, &floats(&numbers))
    }

    #[test]
    fn a_mesh_stands_at_each_of_its_places_scaled_then_turned_then_moved() {
        let model = read(r#"{"TRANSLATION":1,"ROTATION":2,"SCALE":3,"_ID":0}"#).unwrap();
        assert!(model.warnings.is_empty(), "{:?}", model.warnings);
        let [plain, turned, child] = model.meshes.as_slice() else {
            panic!("{} meshes", model.meshes.len())
        };
        let far = 10.0 * DVec3::Z;
        assert_eq!(plain.positions[1], far + 2.0 * DVec3::X);
        let turn = DQuat::from_rotation_z(std::f64::consts::FRAC_PI_2);
        for (corner, at) in [DVec3::ZERO, DVec3::X, DVec3::Y].into_iter().zip(&turned.positions) {
            let scaled = corner * DVec3::new(-2.0, 2.0, 2.0);
            let expected = far + 5.0 * DVec3::X + turn * scaled;
            assert!((expected - *at).length() < 1e-6, "{at}");
        }
        // The mirrored one is wound the other way, so that its outside stays outside.
        assert_eq!((plain.triangles[0], turned.triangles[0]), ([0, 1, 2], [0, 2, 1]));
        assert_eq!(child.positions[1], far + DVec3::X, "children stand in the node once");
    }

    #[test]
    fn places_may_lack_what_does_not_change_and_may_be_none() {
        let at = |attributes: &str| {
            let model = read(attributes).unwrap();
            model.meshes.iter().map(|mesh| mesh.positions[1] - 10.0 * DVec3::Z).collect::<Vec<_>>()
        };
        assert_eq!(at(r#"{"TRANSLATION":1}"#), [2.0, 6.0, 1.0].map(|x| DVec3::X * x));
        assert_eq!(at(r#"{"SCALE":4}"#), [DVec3::X; 2]);
        assert_eq!(at(r#"{"_ID":1}"#), [DVec3::X; 2], "its own place where no place is given");
    }

    #[test]
    fn places_that_cannot_be_are_named() {
        let at = "nodes[0].extensions.EXT_mesh_gpu_instancing";
        for (attributes, told) in [
            ("3", "attributes: it is missing, or no object"),
            (r#"{"TRANSLATION":9}"#, "attributes.TRANSLATION: 9 is none of the 6 accessors"),
            (r#"{"SCALE":-1}"#, "attributes.SCALE: -1 is none of the 6 accessors"),
            (r#"{"SCALE":"x"}"#, "attributes.SCALE: \"x\" is none of the 6 accessors"),
            (r#"{"TRANSLATION":1,"SCALE":4}"#, "attributes: one has 2 elements, another 1"),
        ] {
            let error = read(attributes).unwrap_err().to_string();
            assert!(error.contains(&format!("{at}.{told}")), "{error}");
        }
        let error = read(r#"{"ROTATION":1}"#).unwrap_err().to_string();
        assert!(error.contains("accessors[1] (instances' rotations)"), "{error}");
        let error = read(r#"{"SCALE":5}"#).unwrap_err();
        assert!(matches!(error, SceneError::TooLarge { .. }), "{error}");
    }
}
