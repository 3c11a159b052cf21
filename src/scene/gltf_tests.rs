//! glTF features and attacks one by one, in files made here.

use std::path::Path;

use glam::{DAffine3, DVec3, Vec2, Vec3, Vec4};
use gltf::json::Value;

use super::{Model, SceneError, gltf::read};

/// Bytes of little-endian floats.
pub(super) fn floats(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

pub(super) fn base64(bytes: &[u8]) -> String {
    const ALPHABET: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let letters = |chunk: &[u8]| {
        let bits = chunk.iter().fold(0_u32, |bits, &b| bits << 8 | u32::from(b));
        let bits = bits << (8 * (3 - chunk.len()));
        (0..=chunk.len()).map(move |i| ALPHABET[(bits >> (18 - 6 * i)) as usize & 63] as char)
    };
    bytes.chunks(3).flat_map(|chunk| letters(chunk).collect::<Vec<_>>()).collect()
}

/// Reads a document made of a body and one buffer.
pub(super) fn read_with(body: &str, buffer: &[u8]) -> Result<Model, SceneError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("made.gltf");
    let json = format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],
            "buffers":[{{"byteLength":{},"uri":"data:;base64,{}"}}],{body}}}"#,
        buffer.len(),
        base64(buffer)
    );
    serde_json::from_str::<Value>(&json).expect("the test's own JSON");
    std::fs::write(&path, json).unwrap();
    read(&path)
}

const ONE_NODE: &str = r#""nodes":[{"mesh":0}]"#;

/// A triangle whose positions are accessor 0, and more JSON.
fn triangle(primitive: &str, accessors: &str, views: &str, more: &str) -> String {
    format!(
        r#"{more},"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}}{primitive}}}]}}],
           "accessors":[{accessors}],"bufferViews":[{views}]"#
    )
}

pub(super) const CORNERS: [f32; 9] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
const POSITIONS: &str = r#"{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"}"#;
const VIEW: &str = r#"{"buffer":0,"byteLength":36}"#;

#[test]
fn interleaved_attributes_are_read_at_their_stride() {
    let mut values = Vec::new();
    for (corner, uv) in CORNERS.chunks(3).zip([[0.0, 0.0], [1.0, 0.0], [0.0, 0.5]]) {
        values.extend(corner);
        values.extend(uv);
    }
    let body = format!(
        r#"{ONE_NODE},"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0,"TEXCOORD_0":1}}}}]}}],
        "accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"}},
          {{"bufferView":0,"byteOffset":12,"componentType":5126,"count":3,"type":"VEC2"}}],
        "bufferViews":[{{"buffer":0,"byteLength":60,"byteStride":20}}]"#
    );
    let model = read_with(&body, &floats(&values)).unwrap();
    assert_eq!(model.meshes[0].positions[2], DVec3::Y);
    assert_eq!(model.meshes[0].uvs[2], Vec2::new(0.0, 0.5));
}

#[test]
fn sparse_values_replace_those_of_the_view_or_zeros() {
    let mut buffer = floats(&CORNERS);
    buffer.extend([1, 2]);
    buffer.extend([0, 0]);
    buffer.extend(floats(&[5.0, 0.0, 0.0, 0.0, 7.0, 0.0]));
    for base in [r#""bufferView":0,"#, ""] {
        let accessor = format!(
            r#"{{{base}"componentType":5126,"count":3,"type":"VEC3","sparse":{{"count":2,
            "indices":{{"bufferView":1,"componentType":5121}},"values":{{"bufferView":2}}}}}}"#
        );
        let views = format!(
            r#"{VIEW},{{"buffer":0,"byteOffset":36,"byteLength":2}},
            {{"buffer":0,"byteOffset":40,"byteLength":24}}"#
        );
        let model = read_with(&triangle("", &accessor, &views, ONE_NODE), &buffer).unwrap();
        let expected = [DVec3::ZERO, DVec3::new(5.0, 0.0, 0.0), DVec3::new(0.0, 7.0, 0.0)];
        assert_eq!(model.meshes[0].positions, expected);
    }
    // An index outside, as a mutant would have it
    buffer[37] = 3;
    let accessor = r#"{"componentType":5126,"count":3,"type":"VEC3","sparse":{"count":2,
        "indices":{"bufferView":1,"componentType":5121},"values":{"bufferView":2}}}"#;
    let views = format!(
        r#"{VIEW},{{"buffer":0,"byteOffset":36,"byteLength":2}},
        {{"buffer":0,"byteOffset":40,"byteLength":24}}"#
    );
    let error = read_with(&triangle("", accessor, &views, ONE_NODE), &buffer).unwrap_err();
    assert!(error.to_string().contains("element 3 of 3"), "{error}");
}

#[test]
fn strips_and_fans_keep_one_side_up() {
    let corners: Vec<f32> = [[0, 0], [1, 0], [0, 1], [1, 1], [0, 2]]
        .iter()
        .flat_map(|&[x, y]| [x as f32, y as f32, 0.0])
        .collect();
    let accessor = r#"{"bufferView":0,"componentType":5126,"count":5,"type":"VEC3"}"#;
    let view = r#"{"buffer":0,"byteLength":60}"#;
    let strip = triangle(r#","mode":5"#, accessor, view, ONE_NODE);
    let model = read_with(&strip, &floats(&corners)).unwrap();
    assert_eq!(model.n_triangles(), 3);
    let mesh = &model.meshes[0];
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|i| mesh.positions[i as usize]);
        assert!((b - a).cross(c - a).z > 0.0);
    }
    let fan = triangle(r#","mode":6"#, accessor, view, ONE_NODE);
    let mesh = &read_with(&fan, &floats(&corners)).unwrap().meshes[0];

    assert_eq!(mesh.triangles, [[1, 2, 0], [2, 3, 0], [3, 4, 0]]);
}

#[test]
fn transforms_of_nodes_multiply_and_mirrors_keep_the_outside() {
    let nodes = r#""nodes":[{"scale":[-2,1,1],"children":[1]},
        {"translation":[1,2,3],"rotation":[0,0,0.70710678,0.70710678],"mesh":0}]"#;
    let model = read_with(&triangle("", POSITIONS, VIEW, nodes), &floats(&CORNERS)).unwrap();
    let mesh = &model.meshes[0];
    // (1, 0, 0) turned to (0, 1, 0), moved to (1, 3, 3), mirrored to (−2, 3, 3)
    assert!((mesh.positions[1] - DVec3::new(-2.0, 3.0, 3.0)).length() < 1e-6);
    let [a, b, c] = mesh.triangles[0].map(|i| mesh.positions[i as usize]);
    assert!((b - a).cross(c - a).z > 0.0);
}

#[test]
fn quantised_positions_are_whole_numbers() {
    let corners: Vec<u8> = [[0_i16, 0, 0, 0], [300, 0, 0, 0], [0, -7, 0, 0]]
        .concat()
        .iter()
        .flat_map(|v| v.to_le_bytes())
        .collect();
    let accessor = r#"{"bufferView":0,"componentType":5122,"count":3,"type":"VEC3"}"#;
    let view = r#"{"buffer":0,"byteLength":24,"byteStride":8}"#;
    let more = format!(
        r#"{ONE_NODE},"extensionsRequired":["KHR_mesh_quantization"],
        "extensionsUsed":["KHR_mesh_quantization"]"#
    );
    let model = read_with(&triangle("", accessor, view, &more), &corners).unwrap();
    assert_eq!(model.meshes[0].positions[1], DVec3::new(300.0, 0.0, 0.0));
    assert!(model.warnings.is_empty(), "{:?}", model.warnings);
}

#[test]
fn an_accessor_that_leaves_its_view_is_named() {
    for accessor in [
        r#"{"name":"skin","bufferView":0,"componentType":5126,"count":4,"type":"VEC3"}"#,
        r#"{"name":"skin","bufferView":0,"byteOffset":4,"componentType":5126,"count":3,"type":"VEC3"}"#,
        r#"{"name":"skin","bufferView":0,"byteOffset":18446744073709551612,"componentType":5126,"count":3,"type":"VEC3"}"#,
    ] {
        let body = triangle("", accessor, VIEW, ONE_NODE);
        let error = read_with(&body, &floats(&CORNERS)).unwrap_err().to_string();
        assert!(error.contains(r#"accessors[0] "skin" (positions)"#), "{error}");
    }
}

#[test]
fn giant_counts_end_before_memory_is_asked_for() {
    let accessor = r#"{"componentType":5126,"count":4000000000,"type":"VEC3","sparse":{"count":1,
        "indices":{"bufferView":0,"componentType":5121},"values":{"bufferView":0}}}"#;
    let error = read_with(&triangle("", accessor, VIEW, ONE_NODE), &floats(&CORNERS)).unwrap_err();
    assert!(matches!(error, SceneError::TooLarge { .. }), "{error}");
}

#[test]
fn an_attribute_of_the_wrong_length_is_not_read_at_all() {
    // 400 MB of normals out of nothing, and a sparse part that is broken if it is looked at.
    let accessors = format!(
        r#"{POSITIONS},{{"componentType":5126,"count":33554432,"type":"VEC3","sparse":{{"count":1,
        "indices":{{"bufferView":0,"componentType":5125}},"values":{{"bufferView":0}}}}}}"#
    );
    let body = format!(
        r#"{ONE_NODE},"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0,"NORMAL":1}}}}]}}],
        "accessors":[{accessors}],"bufferViews":[{VIEW}]"#
    );
    let mut buffer = floats(&CORNERS);
    buffer[..4].copy_from_slice(&u32::MAX.to_le_bytes());
    let model = read_with(&body, &buffer).unwrap();
    assert!(model.warnings.iter().any(|w| w.contains("33554432 normals for 3 positions")));
}

#[test]
fn textures_that_share_a_picture_share_its_texels() {
    let mut png = Vec::new();
    let picture = image::RgbImage::from_pixel(1, 1, image::Rgb([255; 3]));
    picture.write_to(&mut std::io::Cursor::new(&mut png), image::ImageFormat::Png).unwrap();
    let textures = vec![r#"{"source":0}"#; 50].join(",");
    let material = |i| format!(r#"{{"emissiveTexture":{{"index":{i}}}}}"#);
    let materials = (0..50).map(material).collect::<Vec<_>>().join(",");
    let primitive = |i| format!(r#"{{"attributes":{{"POSITION":0}},"material":{i}}}"#);
    let primitives = (0..50).map(primitive).collect::<Vec<_>>().join(",");
    let body = format!(
        r#"{ONE_NODE},"meshes":[{{"primitives":[{primitives}]}}],"accessors":[{POSITIONS}],
        "bufferViews":[{VIEW}],"materials":[{materials}],"textures":[{textures}],
        "images":[{{"uri":"data:image/png;base64,{}"}}]"#,
        base64(&png)
    );
    let model = read_with(&body, &floats(&CORNERS)).unwrap();
    assert_eq!((model.materials.len(), model.textures.len()), (50, 1));
}

#[test]
fn only_the_first_buffer_of_a_glb_is_its_binary_chunk() {
    let json = r#"{"asset":{"version":"2.0"},"buffers":[{"byteLength":4},{"byteLength":4}]} "#;
    let mut bytes = b"glTF".to_vec();
    let words = |bytes: &mut Vec<u8>, words: &[u32]| {
        words.iter().for_each(|w| bytes.extend(w.to_le_bytes()));
    };
    let json = format!("{json:width$}", width = json.len().next_multiple_of(4));
    words(&mut bytes, &[2, 12 + 8 + json.len() as u32 + 8 + 4, json.len() as u32]);
    bytes.extend(b"JSON");
    bytes.extend(json.as_bytes());
    words(&mut bytes, &[4]);
    bytes.extend(b"BIN\0\0\0\0\0");
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("two.glb");
    std::fs::write(&path, bytes).unwrap();
    let error = read(&path).unwrap_err().to_string();
    assert!(error.contains("buffers[1]") && error.contains("uri"), "{error}");
}

#[test]
fn factors_too_large_for_a_float_name_their_material() {
    for (factor, name) in [
        (
            r#""emissiveFactor":[1,1,1],"extensions":{"KHR_materials_emissive_strength":{"emissiveStrength":1e39}}"#,
            "emissive",
        ),
        (r#""extensions":{"KHR_materials_ior":{"ior":1e39}}"#, "ior"),
        (
            r#""extensions":{"KHR_materials_specular":{"specularColorFactor":[1,1e39,1]}}"#,
            "specular",
        ),
    ] {
        let more = format!(r#"{ONE_NODE},"materials":[{{{factor}}}]"#);
        let body = triangle(r#","material":0"#, POSITIONS, VIEW, &more);
        let error = read_with(&body, &floats(&CORNERS)).unwrap_err().to_string();
        assert!(error.contains("materials[0]") && error.contains(name), "{error}");
    }
}

#[test]
fn files_outside_the_folder_are_not_opened() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("evil.gltf");
    for uri in ["../../etc/passwd", "/etc/passwd", "%2e%2e/x", "file:///etc/passwd"] {
        let json = format!(
            r#"{{"asset":{{"version":"2.0"}},"buffers":[{{"byteLength":4,"uri":"{uri}"}}]}}"#
        );
        std::fs::write(&path, json).unwrap();
        let error = read(&path).unwrap_err().to_string();
        assert!(error.contains("only files beside it"), "{error}");
    }
}

#[test]
fn the_files_a_model_is_made_from_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("made.gltf");
    let body = triangle("", POSITIONS, VIEW, ONE_NODE);
    let json = format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],
            "buffers":[{{"byteLength":36,"uri":"corners%201.bin"}}],
            "images":[{{"uri":"skin.png"}},{{"uri":"data:image/png;base64,AA"}}],{body}}}"#
    );
    std::fs::write(&path, json).unwrap();
    let buffer = folder.path().join("corners 1.bin");
    std::fs::write(&buffer, floats(&CORNERS)).unwrap();
    let skin = folder.path().join("skin.png");
    assert_eq!(read(&path).unwrap().files, [path, buffer, skin]);
}

#[test]
fn required_extensions_that_are_not_read_are_named() {
    let more = format!(r#"{ONE_NODE},"extensionsRequired":["KHR_draco_mesh_compression"]"#);
    let body = triangle("", POSITIONS, VIEW, &more);
    let error = read_with(&body, &floats(&CORNERS)).unwrap_err().to_string();
    assert!(error.contains("KHR_draco_mesh_compression"), "{error}");
}

#[test]
fn corners_that_are_not_finite_cost_their_triangle_and_a_warning() {
    let mut corners = [CORNERS, CORNERS].concat();
    corners[4] = f32::INFINITY;
    let accessor = r#"{"bufferView":0,"componentType":5126,"count":6,"type":"VEC3"}"#;
    let view = r#"{"buffer":0,"byteLength":72}"#;
    let model = read_with(&triangle("", accessor, view, ONE_NODE), &floats(&corners)).unwrap();
    assert_eq!(model.n_triangles(), 1);
    assert!(model.warnings[0].contains("1 of 2 triangles"), "{:?}", model.warnings);
    assert!(model.bounds(&DAffine3::IDENTITY).unwrap()[1] == DVec3::new(1.0, 1.0, 0.0));
}

#[test]
fn materials_carry_their_extensions() {
    let material = r#"{"pbrMetallicRoughness":{"baseColorFactor":[0.5,0.25,1,0.5],"metallicFactor":0,
        "roughnessFactor":0.3},"emissiveFactor":[1,0.5,0],"alphaMode":"MASK","alphaCutoff":0.4,
        "doubleSided":true,"extensions":{
        "KHR_materials_emissive_strength":{"emissiveStrength":4},
        "KHR_materials_ior":{"ior":1.33},
        "KHR_materials_transmission":{"transmissionFactor":0.9},
        "KHR_materials_volume":{"thicknessFactor":1,"attenuationColor":[0.1,0.2,0.3],"attenuationDistance":0.5},
        "KHR_materials_specular":{"specularFactor":0.7,"specularColorFactor":[1,2,3]}}}"#;
    let more = format!(r#"{ONE_NODE},"materials":[{material}]"#);
    let body = triangle(r#","material":0"#, POSITIONS, VIEW, &more);
    let model = read_with(&body, &floats(&CORNERS)).unwrap();
    // One triangle of solid glass is not closed.
    assert!(model.warnings.len() == 1 && model.warnings[0].contains("3 open edges"));
    let at = model.materials[0].evaluate(&[], [Vec2::ZERO; 2], Vec4::ONE);
    assert_eq!(at.base_colour, Vec3::new(0.5, 0.25, 1.0));
    assert_eq!((at.alpha, at.metallic, at.roughness, at.double_sided), (1.0, 0.0, 0.3, true));
    assert_eq!(at.emissive, Vec3::new(4.0, 2.0, 0.0));
    assert_eq!((at.ior, at.transmission, at.solid), (1.33, 0.9, true));
    assert_eq!(at.attenuation_colour, Vec3::new(0.1, 0.2, 0.3));
    assert_eq!((at.attenuation_distance, at.specular), (0.5, 0.7));
    assert_eq!(at.specular_colour, Vec3::new(1.0, 2.0, 3.0));
}

/// Reads a triangle whose one material is `material`, with a texture of one red texel, and more JSON.
fn read_material(material: &str, more: &str) -> Result<Model, SceneError> {
    let mut png = Vec::new();
    let texel = image::RgbaImage::from_pixel(1, 1, image::Rgba([255, 51, 0, 102]));
    texel.write_to(&mut std::io::Cursor::new(&mut png), image::ImageFormat::Png).unwrap();
    let more = format!(
        r#"{ONE_NODE}{more},"materials":[{material}],"textures":[{{"source":0}}],
        "images":[{{"uri":"data:image/png;base64,{}"}}]"#,
        base64(&png)
    );
    read_with(&triangle(r#","material":0"#, POSITIONS, VIEW, &more), &floats(&CORNERS))
}

#[test]
fn sheen_and_clearcoat_are_read_with_their_textures() {
    let material = r#"{"extensions":{
        "KHR_materials_sheen":{"sheenColorFactor":[0.5,1,0.25],"sheenColorTexture":{"index":0},
            "sheenRoughnessFactor":0.5,"sheenRoughnessTexture":{"index":0}},
        "KHR_materials_clearcoat":{"clearcoatFactor":0.5,"clearcoatTexture":{"index":0},
            "clearcoatRoughnessFactor":0.8,"clearcoatRoughnessTexture":{"index":0},
            "clearcoatNormalTexture":{"index":0,"scale":2,"texCoord":0,"extensions":{
                "KHR_texture_transform":{"texCoord":1,"scale":[3,1]}}}}}}"#;
    let model = read_material(material, "").unwrap();
    let at = model.materials[0].evaluate(&model.textures, [Vec2::ZERO; 2], Vec4::ONE);
    // The texel is (1, 0.2, 0), alpha 0.4; sheen colours are sRGB: 0.2 is 0.0331 linear.
    assert!((at.sheen_colour - Vec3::new(0.5, 0.033_1, 0.0)).length() < 1e-4);
    assert!((at.sheen_roughness - 0.5 * 0.4).abs() < 1e-6, "{}", at.sheen_roughness);
    assert_eq!(at.clearcoat, 0.5);
    assert!((at.clearcoat_roughness - 0.8 * 0.2).abs() < 1e-6, "{}", at.clearcoat_roughness);
    let coat = model.materials[0].clearcoat.as_ref().unwrap();
    let map = coat.normal_texture.as_ref().unwrap();
    // The transform's own set of coordinates counts before the texture's.
    assert_eq!((coat.normal_scale, map.uv_set), (2.0, 1));
    assert_eq!(map.uv_transform.matrix2.x_axis.x, 3.0);
    // No TEXCOORD_0 nor _1 stands in the mesh: both are missed, nothing else is.
    assert_eq!(model.warnings.len(), 2, "{:?}", model.warnings);
}

#[test]
fn layers_are_off_by_the_extensions_own_defaults() {
    let material = r#"{"extensions":{"KHR_materials_sheen":{},"KHR_materials_clearcoat":{}}}"#;
    let model = read_material(material, "").unwrap();
    let at = model.materials[0].evaluate(&model.textures, [Vec2::ZERO; 2], Vec4::ONE);
    assert_eq!((at.sheen_colour, at.clearcoat), (Vec3::ZERO, 0.0));
    let mad = r#"{"extensions":{"KHR_materials_clearcoat":{"clearcoatFactor":7},
        "KHR_materials_sheen":{"sheenColorFactor":[-1,2,0]}}}"#;
    let model = read_material(mad, "").unwrap();
    assert!(model.warnings[0].contains("clearcoat") && model.warnings[0].contains("sheen colour"));
    assert_eq!(model.materials[0].clearcoat.as_ref().unwrap().factor, 1.0);
}

#[test]
fn values_of_the_wrong_type_are_named_by_their_place() {
    let sheen = |fields: &str| format!(r#"{{"extensions":{{"KHR_materials_sheen":{fields}}}}}"#);
    let coat = |fields: &str| format!(r#"{{"extensions":{{"KHR_materials_clearcoat":{fields}}}}}"#);
    let at = "materials[0].extensions.KHR_materials_";
    for (material, place, found) in [
        (sheen("[]"), "sheen", "[]"),
        (sheen(r#"{"sheenColorFactor":"red"}"#), "sheen.sheenColorFactor", "\"red\""),
        (sheen(r#"{"sheenColorFactor":[1,2]}"#), "sheen.sheenColorFactor", "[1,2]"),
        (sheen(r#"{"sheenColorFactor":[0,1e39,0]}"#), "sheen.sheenColorFactor", "39"),
        (sheen(r#"{"sheenRoughnessFactor":null}"#), "sheen.sheenRoughnessFactor", "null"),
        (sheen(r#"{"sheenColorTexture":{}}"#), "sheen.sheenColorTexture.index", "nothing"),
        (sheen(r#"{"sheenColorTexture":{"index":9}}"#), "sheen.sheenColorTexture.index", "9 of 1"),
        (
            coat(r#"{"clearcoatTexture":{"index":0,"texCoord":-1}}"#),
            "clearcoat.clearcoatTexture.texCoord",
            "-1",
        ),
        (coat(r#"{"clearcoatFactor":[1]}"#), "clearcoat.clearcoatFactor", "[1]"),
        // Those that the crate parses, which tells no place
        (r#"{"extensions":{"KHR_materials_ior":{"ior":"x"}}}"#.into(), "ior.ior", "f32"),
        (
            r#"{"extensions":{"KHR_materials_volume":{"thicknessTexture":[]}}}"#.into(),
            "volume.thicknessTexture",
            "",
        ),
    ] {
        let error = read_material(&material, "").unwrap_err().to_string();
        assert!(error.contains(&format!("{at}{place}: ")) && error.contains(found), "{error}");
    }
    let error = read_material(r#"{"alphaMode":"MASK","doubleSided":3}"#, "").unwrap_err();
    assert!(error.to_string().contains("materials[0].doubleSided: "), "{error}");
}

#[test]
fn extensions_that_are_only_used_are_named_with_what_is_lost() {
    for (name, lost) in [
        ("KHR_materials_iridescence", "films"),
        ("KHR_materials_anisotropy", "brush"),
        ("KHR_materials_dispersion", "colours alike"),
        ("KHR_materials_diffuse_transmission", "leaves"),
        ("KHR_lights_punctual", "lamps"),
        ("ACME_unheard_of", "is not read"),
    ] {
        let model = read_material("{}", &format!(r#","extensionsUsed":["{name}"]"#)).unwrap();
        let told = |warning: &String| warning.contains(name) && warning.contains(lost);
        assert!(model.warnings.len() == 1 && told(&model.warnings[0]), "{:?}", model.warnings);
    }
    for name in ["KHR_materials_iridescence", "KHR_draco_mesh_compression", "ACME_unheard_of"] {
        let required = format!(r#","extensionsUsed":["{name}"],"extensionsRequired":["{name}"]"#);
        let error = read_material("{}", &required).unwrap_err();
        assert!(matches!(error, SceneError::RequiredExtension { .. }), "{error}");
    }
}

#[test]
fn without_a_material_the_format_s_own_default_counts() {
    let body = triangle("", POSITIONS, VIEW, ONE_NODE);
    let model = read_with(&body, &floats(&CORNERS)).unwrap();
    let material = &model.materials[0];
    assert_eq!((material.metallic, material.roughness), (1.0, 1.0));
    assert_eq!(material.base_colour, Vec4::ONE);
}

#[test]
fn what_is_not_there_is_named() {
    let error = read(Path::new("/no/such/robot.glb")).unwrap_err().to_string();
    assert!(error.contains("/no/such/robot.glb"), "{error}");
    let error = super::read(Path::new("robot.fbx")).unwrap_err().to_string();
    assert!(error.contains("robot.fbx") && error.contains(".glb"), "{error}");
}
