//! Which glTF extensions are read, and what is lost with those that are not.

use gltf::json::Value;

/// Extensions that are read and meant.
pub const SUPPORTED: [&str; 10] = [
    "EXT_mesh_gpu_instancing",
    "KHR_materials_clearcoat",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_sheen",
    "KHR_materials_specular",
    "KHR_materials_transmission",
    "KHR_materials_volume",
    "KHR_mesh_quantization",
    "KHR_texture_transform",
];

/// Told of where it is met, and in a lit scene no reason to refuse a file.
const TOLD_ELSEWHERE: &str = "KHR_materials_unlit";

/// Refused if required, and what is lost where a file only uses them.
const LOST: [(&str, &str); 17] = [
    ("EXT_meshopt_compression", "the uncompressed copy is read, if there is one"),
    ("EXT_texture_avif", "pictures that are only AVIF are left out"),
    ("EXT_texture_webp", "pictures that are only WebP are left out"),
    ("KHR_animation_pointer", "nothing is animated"),
    ("KHR_draco_mesh_compression", "the uncompressed copy is read, if there is one"),
    ("KHR_lights_punctual", "the lamps of the file do not shine"),
    ("KHR_materials_anisotropy", "highlights are round, not drawn out along the brush"),
    ("KHR_materials_diffuse_transmission", "leaves, paper and shades let no light through"),
    ("KHR_materials_dispersion", "glass bends all colours alike"),
    ("KHR_materials_iridescence", "thin films have no colours"),
    (
        "KHR_materials_pbrSpecularGlossiness",
        "its colours and gloss are lost, export metallic-roughness",
    ),
    ("KHR_materials_variants", "only the default materials are seen"),
    ("KHR_materials_volume_scatter", "milk, wax and skin are clear"),
    ("KHR_node_visibility", "hidden nodes are seen"),
    ("KHR_texture_basisu", "pictures that are only KTX2 are left out"),
    ("KHR_xmp_json_ld", "it says who made the file and changes no picture"),
    ("MSFT_texture_dds", "pictures that are only DDS are left out"),
];

/// Whether a file that requires the extension is read as it is meant.
///
/// Lamps of a file are never read, yet no scene that needs them is refused: its objects are whole.
pub(super) fn may_be_required(name: &str) -> bool {
    SUPPORTED.contains(&name) || [TOLD_ELSEWHERE, "KHR_lights_punctual"].contains(&name)
}

/// What to tell of the extensions that a document says it uses.
pub(super) fn remarks(document: &Value) -> Vec<String> {
    let used = names(document, "extensionsUsed");
    let unread = used.filter(|name| !SUPPORTED.contains(name) && *name != TOLD_ELSEWHERE);
    let lost = |name: &str| LOST.iter().find(|(known, _)| *known == name).map(|(_, lost)| *lost);
    unread
        .map(|name| match lost(name) {
            Some(lost) => format!("extension {name} is not read: {lost}"),
            None => format!("extension {name} is not read"),
        })
        .collect()
}

/// The strings of one of the document's two lists of extensions.
pub(super) fn names<'v>(document: &'v Value, key: &str) -> impl Iterator<Item = &'v str> {
    let names = document.get(key).and_then(Value::as_array).into_iter().flatten();
    names.filter_map(Value::as_str)
}
