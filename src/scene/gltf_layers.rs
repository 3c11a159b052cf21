//! KHR_materials_sheen and KHR_materials_clearcoat from a glTF file's raw JSON.
//!
//! The crate parses neither, so their types are checked here. What has the wrong type is an error
//! that names its place; numbers out of range are judged with the other factors of the material.

use glam::Vec3;
use gltf::json::Value;

use super::gltf_material::{MaterialReader, transform_of_json};
use super::layers::{Clearcoat, Sheen};
use super::texture::TexelMeaning;
use super::{SceneError, TextureRef};

/// A JSON object of the file and where it stands.
struct Fields<'a, 'r> {
    reader: &'r mut MaterialReader<'a>,
    value: &'r Value,
    /// `materials[3].extensions.KHR_materials_sheen`
    place: String,
    /// The material for remarks: `materials[3] "velvet"`.
    material: &'r str,
}

impl<'a> MaterialReader<'a> {
    pub(super) fn sheen(
        &mut self,
        material: &gltf::Material,
        name: &str,
    ) -> Result<Option<Sheen>, SceneError> {
        let Some(mut fields) = self.layer(material, name, "KHR_materials_sheen")? else {
            return Ok(None);
        };
        let colour = fields.texture("sheenColorTexture", TexelMeaning::Colour)?;
        let roughness = fields.texture("sheenRoughnessTexture", TexelMeaning::Numbers)?;
        Ok(Some(Sheen {
            colour: fields.colour("sheenColorFactor")?,
            colour_texture: colour.map(|(texture, _)| texture),
            roughness: fields.number("sheenRoughnessFactor", 0.0)?,
            roughness_texture: roughness.map(|(texture, _)| texture),
        }))
    }

    pub(super) fn clearcoat(
        &mut self,
        material: &gltf::Material,
        name: &str,
    ) -> Result<Option<Clearcoat>, SceneError> {
        let Some(mut fields) = self.layer(material, name, "KHR_materials_clearcoat")? else {
            return Ok(None);
        };
        let texture = fields.texture("clearcoatTexture", TexelMeaning::Numbers)?;
        let roughness = fields.texture("clearcoatRoughnessTexture", TexelMeaning::Numbers)?;
        let normal = fields.texture("clearcoatNormalTexture", TexelMeaning::Numbers)?;
        Ok(Some(Clearcoat {
            factor: fields.number("clearcoatFactor", 0.0)?,
            texture: texture.map(|(texture, _)| texture),
            roughness: fields.number("clearcoatRoughnessFactor", 0.0)?,
            roughness_texture: roughness.map(|(texture, _)| texture),
            normal_scale: normal.as_ref().map_or(1.0, |&(_, scale)| scale),
            normal_texture: normal.map(|(texture, _)| texture),
        }))
    }

    fn layer<'r>(
        &'r mut self,
        material: &'r gltf::Material,
        name: &'r str,
        extension: &str,
    ) -> Result<Option<Fields<'a, 'r>>, SceneError> {
        let Some(value) = material.extension_value(extension) else { return Ok(None) };
        let index = material.index().map_or("?".into(), |index| index.to_string());
        let place = format!("materials[{index}].extensions.{extension}");
        let fields = Fields { reader: self, value, place, material: name };
        if !value.is_object() {
            return Err(fields.broken("", format!("an object is expected, not {}", short(value))));
        }
        Ok(Some(fields))
    }
}

impl Fields<'_, '_> {
    fn number(&self, key: &str, default: f32) -> Result<f32, SceneError> {
        let Some(value) = self.value.get(key) else { return Ok(default) };
        as_f32(value).ok_or_else(|| {
            self.broken(key, format!("a number of 32 bits is expected, not {}", short(value)))
        })
    }

    /// Black if it is not given.
    fn colour(&self, key: &str) -> Result<Vec3, SceneError> {
        let Some(value) = self.value.get(key) else { return Ok(Vec3::ZERO) };
        let channel = |i| as_f32(value.get(i)?);
        let three = value.as_array().filter(|channels| channels.len() == 3);
        three.and_then(|_| Some(Vec3::new(channel(0)?, channel(1)?, channel(2)?))).ok_or_else(
            || {
                let problem =
                    format!("three numbers of 32 bits are expected, not {}", short(value));
                self.broken(key, problem)
            },
        )
    }

    /// A texture and, of a normal map, its scale (1 if not given).
    fn texture(
        &mut self,
        key: &str,
        meaning: TexelMeaning,
    ) -> Result<Option<(TextureRef, f32)>, SceneError> {
        let Some(value) = self.value.get(key) else { return Ok(None) };
        let place = format!("{}.{key}", self.place);
        let mut fields =
            Fields { reader: &mut *self.reader, value, place, material: self.material };
        let scale = fields.number("scale", 1.0)?;
        let transform = value.get("extensions").and_then(|e| e.get("KHR_texture_transform"));
        let (uv_transform, other_set) = transform_of_json(transform);
        let uv_set = match other_set {
            Some(set) => set,
            None => fields.index("texCoord", Some(0))?,
        };
        let index = fields.index("index", None)?;
        let document = fields.reader.document;
        let Some(texture) = document.textures().nth(index as usize) else {
            let n = document.textures().len();
            return Err(fields.broken("index", format!("texture {index} of {n}")));
        };
        let read =
            fields.reader.reference(&texture, meaning, uv_set, uv_transform, fields.material)?;
        Ok(read.map(|texture| (texture, scale)))
    }

    /// A number of something; an error if it is not given and has no default.
    fn index(&mut self, key: &str, default: Option<u32>) -> Result<u32, SceneError> {
        let found = self.value.get(key);
        let index = match found {
            Some(value) => value.as_u64().and_then(|index| u32::try_from(index).ok()),
            None => default,
        };
        index.ok_or_else(|| {
            let found = found.map_or("nothing".into(), short);
            self.broken(key, format!("a whole number from 0 is expected, not {found}"))
        })
    }

    fn broken(&self, key: &str, problem: String) -> SceneError {
        let place =
            if key.is_empty() { self.place.clone() } else { format!("{}.{key}", self.place) };
        SceneError::Broken { path: self.reader.path.into(), place, problem }
    }
}

fn as_f32(value: &Value) -> Option<f32> {
    value.as_f64().map(|number| number as f32).filter(|number| number.is_finite())
}

/// A value as it stands in the file, cut where it is long.
fn short(value: &Value) -> String {
    let text = value.to_string();
    if text.chars().count() <= 40 {
        return text;
    }
    text.chars().take(39).chain(std::iter::once('…')).collect()
}
