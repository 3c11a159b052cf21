//! Writing the demo's files: PNG, JPEG with EXIF, OpenEXR layers, and GLB.

use std::error::Error;
use std::fs;
use std::io::Cursor;
use std::path::Path;

use exif::experimental::Writer;
use exif::{Field, In, Rational, Tag, Value};
use exr::prelude::{
    AnyChannel, AnyChannels, Encoding, FlatSamples, Image as ExrImage, IntegerBounds, Layer,
    LayerAttributes, Vec2, WritableImage, f16,
};
use image::codecs::jpeg::JpegEncoder;
use image::{ExtendedColorType, ImageEncoder};
use serde_json::json;

use crate::mesh::Triangles;
use crate::paint::Paint;
use crate::sensor::Exposure;
use crate::surface::{Finish, Gloss};

/// Focal length the camera writes: 1180 px of a frame 1080 px = 36 mm wide.
const FOCAL_MM: f64 = 39.3;

type Done = Result<(), Box<dyn Error>>;

/// 8-bit sRGB as PNG.
pub fn write_png(path: &Path, rgb: &[u8], width: usize, height: usize) -> Done {
    Ok(image::save_buffer(path, rgb, width as u32, height as u32, ExtendedColorType::Rgb8)?)
}

/// 8-bit sRGB as JPEG with the facts a camera writes.
pub fn write_jpeg(
    path: &Path,
    rgb: &[u8],
    width: usize,
    height: usize,
    exposure: Exposure,
) -> Done {
    let mut bytes = Vec::new();
    let mut encoder = JpegEncoder::new_with_quality(&mut bytes, 90);
    encoder.set_exif_metadata(exif_facts(exposure)?)?;
    encoder.write_image(rgb, width as u32, height as u32, ExtendedColorType::Rgb8)?;
    Ok(fs::write(path, bytes)?)
}

fn exif_facts(exposure: Exposure) -> Result<Vec<u8>, Box<dyn Error>> {
    let rational = |num, denom| Value::Rational(vec![Rational { num, denom }]);
    let tenths = |x: f64| rational((x * 10.0).round() as u32, 10);
    let field = |tag, value| Field { tag, ifd_num: In::PRIMARY, value };
    let fields = [
        field(Tag::Make, Value::Ascii(vec![b"Platelight".to_vec()])),
        field(Tag::Model, Value::Ascii(vec![b"Synthetic demo camera".to_vec()])),
        field(Tag::Orientation, Value::Short(vec![1])),
        field(Tag::ExposureTime, rational(exposure.time.0, exposure.time.1)),
        field(Tag::FNumber, tenths(exposure.f_number)),
        field(Tag::PhotographicSensitivity, Value::Short(vec![exposure.iso as u16])),
        field(Tag::FocalLength, tenths(FOCAL_MM)),
        field(Tag::ColorSpace, Value::Short(vec![1])),
    ];
    let mut writer = Writer::new();
    for field in &fields {
        writer.push_field(field);
    }
    let mut bytes = Cursor::new(Vec::new());
    writer.write(&mut bytes, false)?;
    Ok(bytes.into_inner())
}

/// A rectangle of the display window, pixels.
#[derive(Clone, Copy)]
pub struct Window {
    pub x: usize,
    pub y: usize,
    pub width: usize,
    pub height: usize,
}

/// Named channels of `display` (width, height), of which only `window` is kept, as half floats, ZIP.
///
/// Eight bits of mantissa are kept (0.2 %): less than the noise, and it packs better.
pub fn write_exr(
    path: &Path,
    channels: &[(&str, Vec<f64>)],
    display: (usize, usize),
    window: Window,
) -> Done {
    let cut = |values: &[f64]| {
        let mut samples = Vec::with_capacity(window.width * window.height);
        for y in window.y..window.y + window.height {
            let first = y * display.0 + window.x;
            samples.extend(values[first..first + window.width].iter().map(|v| coarse_half(*v)));
        }
        FlatSamples::F16(samples)
    };
    let list = channels.iter().map(|(name, values)| AnyChannel::new(*name, cut(values))).collect();
    let attributes = LayerAttributes {
        layer_position: Vec2(window.x as i32, window.y as i32),
        ..LayerAttributes::default()
    };
    let size = Vec2(window.width, window.height);
    let encoding = Encoding::SMALL_LOSSLESS;
    let layer = Layer::new(size, attributes, encoding, AnyChannels::sort(list));
    let mut picture = ExrImage::from_layer(layer);
    picture.attributes.display_window = IntegerBounds::new(Vec2(0, 0), Vec2(display.0, display.1));
    Ok(picture.write().to_file(path)?)
}

fn coarse_half(value: f64) -> f16 {
    let bits = f16::from_f64(value).to_bits();
    f16::from_bits(bits.saturating_add(2) & !3)
}

/// Meshes with one material each as binary glTF 2.0.
pub fn write_glb(path: &Path, meshes: &[(&str, &Triangles, Finish)]) -> Done {
    let mut binary = Vec::new();
    let (mut views, mut accessors) = (Vec::new(), Vec::new());
    let (mut parts, mut materials, mut nodes) = (Vec::new(), Vec::new(), Vec::new());
    for (index, (name, mesh, finish)) in meshes.iter().enumerate() {
        let mut attributes = serde_json::Map::new();
        for (attribute, vectors) in
            [("POSITION", &mesh.positions), ("NORMAL", &mesh.normals), ("COLOR_0", &mesh.colours)]
        {
            if vectors.is_empty() {
                continue;
            }
            let start = binary.len();
            let (mut min, mut max) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
            for v in vectors {
                for (c, x) in v.as_vec3().to_array().into_iter().enumerate() {
                    min[c] = min[c].min(x);
                    max[c] = max[c].max(x);
                    binary.extend(x.to_le_bytes());
                }
            }
            attributes.insert(attribute.into(), json!(accessors.len()));
            accessors.push(json!({ "bufferView": views.len(), "componentType": 5126,
                "count": vectors.len(), "type": "VEC3", "min": min, "max": max }));
            views.push(json!({ "buffer": 0, "byteOffset": start,
                "byteLength": binary.len() - start, "target": 34962 }));
        }
        let start = binary.len();
        for i in mesh.faces.iter().flatten() {
            binary.extend(i.to_le_bytes());
        }
        parts.push(json!({ "name": name, "primitives": [{ "attributes": attributes,
            "indices": accessors.len(), "material": index }] }));
        accessors.push(json!({ "bufferView": views.len(), "componentType": 5125,
            "count": 3 * mesh.faces.len(), "type": "SCALAR" }));
        views.push(json!({ "buffer": 0, "byteOffset": start,
            "byteLength": binary.len() - start, "target": 34963 }));
        materials.push(material(name, finish));
        nodes.push(json!({ "name": name, "mesh": index }));
    }
    let scene: Vec<usize> = (0..nodes.len()).collect();
    let document = json!({
        "asset": { "version": "2.0", "generator": "platelight examples/make_demo" },
        "extensionsUsed": ["KHR_materials_specular"],
        "scene": 0, "scenes": [{ "nodes": scene }], "nodes": nodes, "meshes": parts,
        "materials": materials, "accessors": accessors, "bufferViews": views,
        "buffers": [{ "byteLength": binary.len() }],
    });
    let mut text = serde_json::to_vec(&document)?;
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut glb = Vec::new();
    let total = 12 + 8 + text.len() + 8 + binary.len();
    for word in [0x4654_6c67, 2, total as u32, text.len() as u32, 0x4e4f_534a] {
        glb.extend(u32::to_le_bytes(word));
    }
    glb.extend(text);
    for word in [binary.len() as u32, 0x004e_4942] {
        glb.extend(u32::to_le_bytes(word));
    }
    glb.extend(binary);
    Ok(fs::write(path, glb)?)
}

fn material(name: &str, finish: &Finish) -> serde_json::Value {
    let colour = match finish.paint {
        Paint::Plain(c) => c.to_array(),
        // Vertex colours multiply the base colour.
        _ => [1.0; 3],
    };
    let (metallic, roughness, specular) = match finish.gloss {
        Gloss::Matt | Gloss::Mirror => (0.0, 1.0, 0.0),
        Gloss::Dielectric { roughness } => (0.0, roughness, 1.0),
        Gloss::Metal { roughness } => (1.0, roughness, 1.0),
    };
    json!({ "name": name,
        "pbrMetallicRoughness": { "baseColorFactor": [colour[0], colour[1], colour[2], 1.0],
            "metallicFactor": metallic, "roughnessFactor": roughness },
        "extensions": { "KHR_materials_specular": { "specularFactor": specular } } })
}
