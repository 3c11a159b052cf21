//! Where in a glTF document a value of the wrong type stands: the crate tells only what it expected.

use gltf::json::Value;
use gltf::json::deserialize::from_value;

/// Keys of one object that are tried one by one; hostile files have millions.
const MOST_KEYS: usize = 64;

/// `materials[3].extensions.KHR_materials_ior.ior`, as deep as it can be told; "JSON" if it cannot.
pub(super) fn of_wrong_type(document: &Value) -> String {
    /// The first element of a list that is no `T`, and the keys that lead to why.
    fn within<T: serde::de::DeserializeOwned>(document: &Value, list: &str) -> Option<String> {
        let is_wrong = |value: &Value| from_value::<T>(value.clone()).is_err();
        let elements = document.get(list)?.as_array()?;
        let index = elements.iter().position(is_wrong)?;
        let mut element = elements[index].clone();
        let mut place = format!("{list}[{index}]");
        let mut keys = Vec::new();
        while let Some(key) = key_at_fault(&mut element, &keys, &is_wrong) {
            place = format!("{place}.{key}");
            keys.push(key);
        }
        Some(place)
    }
    within::<gltf::json::Material>(document, "materials")
        .or_else(|| within::<gltf::json::Mesh>(document, "meshes"))
        .or_else(|| within::<gltf::json::Node>(document, "nodes"))
        .or_else(|| within::<gltf::json::Accessor>(document, "accessors"))
        .or_else(|| within::<gltf::json::buffer::View>(document, "bufferViews"))
        .or_else(|| within::<gltf::json::Buffer>(document, "buffers"))
        .or_else(|| within::<gltf::json::Image>(document, "images"))
        .or_else(|| within::<gltf::json::Texture>(document, "textures"))
        .or_else(|| within::<gltf::json::texture::Sampler>(document, "samplers"))
        .or_else(|| within::<gltf::json::Scene>(document, "scenes"))
        .or_else(|| within::<gltf::json::Animation>(document, "animations"))
        .or_else(|| within::<gltf::json::Camera>(document, "cameras"))
        .or_else(|| within::<gltf::json::Skin>(document, "skins"))
        .unwrap_or_else(|| "JSON".into())
}

/// The key, in the object that `path` leads to, without which `root` is right.
fn key_at_fault(
    root: &mut Value,
    path: &[String],
    is_wrong: &impl Fn(&Value) -> bool,
) -> Option<String> {
    fn at<'v>(root: &'v mut Value, path: &[String]) -> Option<&'v mut Value> {
        path.iter().try_fold(root, |value, key| value.get_mut(key))
    }
    let object = at(root, path)?.as_object()?;
    if object.len() > MOST_KEYS {
        return None;
    }
    let keys: Vec<String> = object.keys().cloned().collect();
    keys.into_iter().find(|key| {
        let Some(taken) = at(root, path).and_then(|v| v.as_object_mut()?.remove(key)) else {
            return false;
        };
        let right_without = !is_wrong(root);
        if let Some(object) = at(root, path).and_then(Value::as_object_mut) {
            object.insert(key.clone(), taken);
        }
        right_without
    })
}
