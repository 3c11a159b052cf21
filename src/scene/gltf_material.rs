//! glTF materials, textures and samplers → [`Material`] and [`Texture`].

use std::collections::HashMap;
use std::path::Path;

use glam::{Affine2, Mat2, Vec2, Vec3, Vec4};
use gltf::json::Value;
use gltf::material::AlphaMode as GltfAlphaMode;
use gltf::texture::WrappingMode;

use super::buffers::{Buffers, resolve};
use super::texture::{TexelMeaning, Wrap};
use super::{AlphaMode, Material, SceneError, Texture, TextureRef};

/// Reads materials and, once each, the textures they use.
pub(super) struct MaterialReader<'a> {
    pub(super) path: &'a Path,
    pub(super) document: &'a gltf::Document,
    buffers: &'a Buffers<'a>,
    /// By glTF image, meaning and wrap along u and v: the same picture may be colour here and
    /// numbers there, and any number of glTF textures may show it.
    read: HashMap<(usize, TexelMeaning, [Wrap; 2]), usize>,
    pub textures: Vec<Texture>,
    pub warnings: Vec<String>,
}

impl<'a> MaterialReader<'a> {
    pub fn new(path: &'a Path, document: &'a gltf::Document, buffers: &'a Buffers<'a>) -> Self {
        let (read, textures, warnings) = (HashMap::new(), Vec::new(), Vec::new());
        Self { path, document, buffers, read, textures, warnings }
    }

    pub fn material(&mut self, material: &gltf::Material) -> Result<Material, SceneError> {
        let place = match (material.index(), material.name()) {
            (Some(i), Some(name)) => format!("materials[{i}] {name:?}"),
            (Some(i), None) => format!("materials[{i}]"),
            (None, _) => "the default material".into(),
        };
        let pbr = material.pbr_metallic_roughness();
        let strength = material.emissive_strength().unwrap_or(1.0);
        let mut result = Material {
            name: material.name().unwrap_or_default().into(),
            base_colour: Vec4::from(pbr.base_color_factor()),
            base_colour_texture: self.info(
                pbr.base_color_texture(),
                TexelMeaning::Colour,
                &place,
            )?,
            metallic: pbr.metallic_factor(),
            roughness: pbr.roughness_factor(),
            metallic_roughness_texture: self.info(
                pbr.metallic_roughness_texture(),
                TexelMeaning::Numbers,
                &place,
            )?,
            emissive: Vec3::from(material.emissive_factor()) * strength,
            emissive_texture: self.info(
                material.emissive_texture(),
                TexelMeaning::Colour,
                &place,
            )?,
            alpha_mode: match material.alpha_mode() {
                GltfAlphaMode::Opaque => AlphaMode::Opaque,
                GltfAlphaMode::Mask => AlphaMode::Mask(material.alpha_cutoff().unwrap_or(0.5)),
                GltfAlphaMode::Blend => AlphaMode::Blend,
            },
            double_sided: material.double_sided(),
            ior: material.ior().unwrap_or(1.5),
            ..Material::default()
        };
        if let Some(normal) = material.normal_texture() {
            let transform = normal.extension_value("KHR_texture_transform");
            let (uv_transform, uv_set) = transform_of_json(transform);
            result.normal_scale = normal.scale();
            result.normal_texture = self.reference(
                &normal.texture(),
                TexelMeaning::Numbers,
                uv_set.unwrap_or(normal.tex_coord()),
                uv_transform,
                &place,
            )?;
        }
        if let Some(transmission) = material.transmission() {
            result.transmission = transmission.transmission_factor();
            let texture = transmission.transmission_texture();
            result.transmission_texture = self.info(texture, TexelMeaning::Numbers, &place)?;
        }
        if let Some(volume) = material.volume() {
            // A thickness of 0 means thin-walled (KHR_materials_volume). Its value is a raster
            // renderer's guess of the path length, which here is traced; so is its texture.
            result.solid = volume.thickness_factor() > 0.0;
            result.attenuation_colour = Vec3::from(volume.attenuation_color());
            result.attenuation_distance = volume.attenuation_distance();
        }
        if let Some(specular) = material.specular() {
            result.specular = specular.specular_factor();
            result.specular_colour = Vec3::from(specular.specular_color_factor());
            result.specular_texture =
                self.info(specular.specular_texture(), TexelMeaning::Numbers, &place)?;
            result.specular_colour_texture =
                self.info(specular.specular_color_texture(), TexelMeaning::Colour, &place)?;
        }
        result.sheen = self.sheen(material, &place)?;
        result.clearcoat = self.clearcoat(material, &place)?;
        if material.unlit() {
            self.warnings.push(format!("{place}: KHR_materials_unlit is lit like any other"));
        }
        self.check_finite(&result, &place)?;
        self.clamp(&mut result, &place);
        Ok(result)
    }

    /// JSON has numbers that f32 has not: those are no light and no glass.
    fn check_finite(&self, material: &Material, place: &str) -> Result<(), SceneError> {
        let factors = [
            ("emissive", material.emissive.is_finite()),
            ("specular colour", material.specular_colour.is_finite()),
            ("ior", material.ior.is_finite()),
        ];
        let Some((name, _)) = factors.into_iter().find(|(_, finite)| !finite) else {
            return Ok(());
        };
        let problem = format!("its {name} is too large for a 32-bit number");
        Err(SceneError::Broken { path: self.path.into(), place: place.into(), problem })
    }

    /// Keeps factors where physics has them; says which were not there.
    fn clamp(&mut self, material: &mut Material, place: &str) {
        let mut outside = Vec::new();
        let mut fraction = |value: &mut f32, name: &'static str| {
            if !(0.0..=1.0).contains(value) {
                outside.push(name);
                *value = if value.is_nan() { 0.0 } else { value.clamp(0.0, 1.0) };
            }
        };
        fraction(&mut material.base_colour.x, "base colour");
        fraction(&mut material.base_colour.y, "base colour");
        fraction(&mut material.base_colour.z, "base colour");
        fraction(&mut material.base_colour.w, "alpha");
        fraction(&mut material.metallic, "metallic");
        fraction(&mut material.roughness, "roughness");
        fraction(&mut material.transmission, "transmission");
        fraction(&mut material.specular, "specular");
        fraction(&mut material.attenuation_colour.x, "attenuation colour");
        fraction(&mut material.attenuation_colour.y, "attenuation colour");
        fraction(&mut material.attenuation_colour.z, "attenuation colour");
        if let Some(sheen) = &mut material.sheen {
            fraction(&mut sheen.colour.x, "sheen colour");
            fraction(&mut sheen.colour.y, "sheen colour");
            fraction(&mut sheen.colour.z, "sheen colour");
            fraction(&mut sheen.roughness, "sheen roughness");
        }
        if let Some(coat) = &mut material.clearcoat {
            fraction(&mut coat.factor, "clearcoat");
            fraction(&mut coat.roughness, "clearcoat roughness");
        }
        let mut at_least = |value: &mut f32, least: f32, instead: f32, name: &'static str| {
            if value.is_nan() || *value < least {
                outside.push(name);
                *value = instead;
            }
        };
        at_least(
            &mut material.attenuation_distance,
            f32::MIN_POSITIVE,
            f32::INFINITY,
            "attenuation",
        );
        at_least(&mut material.emissive.x, 0.0, 0.0, "emissive");
        at_least(&mut material.emissive.y, 0.0, 0.0, "emissive");
        at_least(&mut material.emissive.z, 0.0, 0.0, "emissive");
        at_least(&mut material.specular_colour.x, 0.0, 0.0, "specular colour");
        at_least(&mut material.specular_colour.y, 0.0, 0.0, "specular colour");
        at_least(&mut material.specular_colour.z, 0.0, 0.0, "specular colour");
        // KHR_materials_ior lets 0 mean "reflects all": as good as a very large one.
        if material.ior == 0.0 {
            material.ior = 1e3;
        }
        at_least(&mut material.ior, 1.0, 1.5, "ior");
        if !material.normal_scale.is_finite() {
            outside.push("normal scale");
            material.normal_scale = 1.0;
        }
        outside.dedup();
        if !outside.is_empty() {
            let names = outside.join(", ");
            self.warnings.push(format!("{place}: {names} outside the range of glTF, clamped"));
        }
    }

    fn info(
        &mut self,
        info: Option<gltf::texture::Info>,
        meaning: TexelMeaning,
        place: &str,
    ) -> Result<Option<TextureRef>, SceneError> {
        let Some(info) = info else { return Ok(None) };
        let transform = info.texture_transform();
        let uv_set = transform.as_ref().and_then(|t| t.tex_coord()).unwrap_or(info.tex_coord());
        let uv_transform = transform.map_or(Affine2::IDENTITY, |t| {
            uv_affine(Vec2::from(t.offset()), t.rotation(), Vec2::from(t.scale()))
        });
        self.reference(&info.texture(), meaning, uv_set, uv_transform, place)
    }

    pub(super) fn reference(
        &mut self,
        texture: &gltf::Texture,
        meaning: TexelMeaning,
        uv_set: u32,
        uv_transform: Affine2,
        place: &str,
    ) -> Result<Option<TextureRef>, SceneError> {
        if uv_set > 1 {
            self.warnings.push(format!(
                "{place}: texture {} uses TEXCOORD_{uv_set}; only 0 and 1 are read, it is left out",
                texture.index()
            ));
            return Ok(None);
        }
        if !uv_transform.is_finite() {
            self.warnings.push(format!("{place}: a texture transform is not finite, ignored"));
            return self.reference(texture, meaning, uv_set, Affine2::IDENTITY, place);
        }
        let Some(index) = self.texture(texture, meaning, place)? else { return Ok(None) };
        Ok(Some(TextureRef { texture: index, uv_set: uv_set as usize, uv_transform }))
    }

    /// The number of a texture among those read; `None`, with a warning, if it has no picture that
    /// glTF 2.0 itself knows (KTX2, WebP, DDS come in through extensions only).
    fn texture(
        &mut self,
        texture: &gltf::Texture,
        meaning: TexelMeaning,
        place: &str,
    ) -> Result<Option<usize>, SceneError> {
        let Some(image) = texture.source() else {
            self.warnings.push(format!(
                "{place}: textures[{}] has no PNG or JPEG picture; it is left out",
                texture.index()
            ));
            return Ok(None);
        };
        let sampler = texture.sampler();
        let wrap = [wrap(sampler.wrap_s()), wrap(sampler.wrap_t())];
        let key = (image.index(), meaning, wrap);
        if let Some(&index) = self.read.get(&key) {
            return Ok(Some(index));
        }
        let same_texels =
            |known: &&(usize, TexelMeaning, [Wrap; 2])| known.0 == key.0 && known.1 == key.1;
        let read = match self.read.keys().find(same_texels) {
            Some(known) => {
                let mut texture = self.textures[self.read[known]].clone();
                texture.wrap = wrap;
                texture
            }
            None => self.decode(&image, meaning, wrap)?,
        };
        let index = self.textures.len();
        self.textures.push(read);
        self.read.insert(key, index);
        Ok(Some(index))
    }

    fn decode(
        &self,
        image: &gltf::Image,
        meaning: TexelMeaning,
        wrap: [Wrap; 2],
    ) -> Result<Texture, SceneError> {
        let image_place = format!("images[{}]", image.index());
        // From the JSON: the crate's own answer panics on a picture that names no place or type.
        let json = &self.document.as_json().images[image.index()];
        let view = json.buffer_view.map(|view| view.value());
        let owned;
        let bytes = match (&json.uri, view.and_then(|view| self.document.views().nth(view))) {
            (_, Some(view)) => self.buffers.view(&view)?,
            (Some(uri), None) => {
                owned = resolve(self.path, &image_place, uri)?;
                self.buffers.budget.grant(uri, owned.len());
                &owned
            }
            (None, None) => {
                return Err(SceneError::Picture {
                    path: self.path.into(),
                    place: image_place,
                    problem: "it names neither a file nor a buffer view".into(),
                });
            }
        };
        let texture = Texture::decode(bytes, meaning, wrap).map_err(|problem| {
            SceneError::Picture { path: self.path.into(), place: image_place.clone(), problem }
        })?;
        self.buffers.budget.take(texture.n_bytes(), 1, &image_place)?;
        Ok(texture)
    }
}

fn wrap(mode: WrappingMode) -> Wrap {
    match mode {
        WrappingMode::Repeat => Wrap::Repeat,
        WrappingMode::MirroredRepeat => Wrap::MirroredRepeat,
        WrappingMode::ClampToEdge => Wrap::ClampToEdge,
    }
}

/// KHR_texture_transform: translation · rotation · scale; the rotation turns the uv
/// counter-clockwise as seen on the picture, whose v runs down.
fn uv_affine(offset: Vec2, rotation: f32, scale: Vec2) -> Affine2 {
    let (sin, cos) = rotation.sin_cos();
    let turn = Mat2::from_cols(Vec2::new(cos, -sin), Vec2::new(sin, cos));
    Affine2 { matrix2: turn * Mat2::from_diagonal(scale), translation: offset }
}

/// The same from raw JSON (the crate parses it for ordinary textures only), and its `texCoord`.
pub(super) fn transform_of_json(value: Option<&Value>) -> (Affine2, Option<u32>) {
    let Some(value) = value else { return (Affine2::IDENTITY, None) };
    let number = |value: &Value| value.as_f64().map(|x| x as f32);
    let pair = |key: &str| {
        let pair = value.get(key)?;
        Some(Vec2::new(number(pair.get(0)?)?, number(pair.get(1)?)?))
    };
    let rotation = value.get("rotation").and_then(number).unwrap_or(0.0);
    let uv_set = value.get("texCoord").and_then(Value::as_u64).map(|set| set.min(99) as u32);
    let (offset, scale) =
        (pair("offset").unwrap_or(Vec2::ZERO), pair("scale").unwrap_or(Vec2::ONE));
    (uv_affine(offset, rotation, scale), uv_set)
}
