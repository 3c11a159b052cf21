//! glTF 2.0 metallic-roughness materials, onto which OBJ's MTL is mapped too.

use glam::{Vec3, Vec4};

use crate::conventions::Rgb;
use crate::photo::Image;

/// A glTF 2.0 metallic-roughness material with the extensions Platelight renders.
#[derive(Clone, Debug)]
pub struct Material {
    pub name: String,
    /// Linear; multiplied by the texture and vertex colour.
    pub base_colour: Vec4,
    pub base_colour_texture: Option<TextureRef>,
    pub metallic: f32,
    /// Perceptual roughness; GGX α = roughness².
    pub roughness: f32,
    /// Green = roughness, blue = metallic.
    pub metallic_roughness_texture: Option<TextureRef>,
    pub normal_texture: Option<TextureRef>,
    pub normal_scale: f32,
    pub emissive: Rgb,
    pub emissive_texture: Option<TextureRef>,
    pub alpha_mode: AlphaMode,
    pub double_sided: bool,
    /// KHR_materials_transmission.
    pub transmission: f32,
    /// True if the material bounds a solid (KHR_materials_volume or a closed glass): rays refract.
    pub solid: bool,
    /// KHR_materials_volume: attenuation colour over `attenuation_distance` metres.
    pub attenuation_colour: Rgb,
    pub attenuation_distance: f32,
    /// KHR_materials_ior.
    pub ior: f32,
    /// KHR_materials_specular: 0 is exactly Lambert.
    pub specular: f32,
    pub specular_colour: Rgb,
}

impl Default for Material {
    /// glTF's defaults, but a dielectric: white, metallic 0, roughness 1.
    fn default() -> Self {
        Self {
            name: String::new(),
            base_colour: Vec4::ONE,
            base_colour_texture: None,
            metallic: 0.0,
            roughness: 1.0,
            metallic_roughness_texture: None,
            normal_texture: None,
            normal_scale: 1.0,
            emissive: Vec3::ZERO,
            emissive_texture: None,
            alpha_mode: AlphaMode::Opaque,
            double_sided: false,
            transmission: 0.0,
            solid: false,
            attenuation_colour: Vec3::ONE,
            attenuation_distance: f32::INFINITY,
            ior: 1.5,
            specular: 1.0,
            specular_colour: Vec3::ONE,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AlphaMode {
    Opaque,
    /// Seen where alpha ≥ the cutoff.
    Mask(f32),
    Blend,
}

/// A texture as a material uses it, with KHR_texture_transform already made one affine map of uv.
#[derive(Clone, Debug, PartialEq)]
pub struct TextureRef {
    /// Index into [`Scene::textures`](super::Scene::textures).
    pub texture: usize,
    /// uv' = matrix · uv + offset.
    pub uv_transform: glam::Affine2,
}

/// Texels, linear light for colour and plain numbers for data; bilinear, wrapped as glTF says.
#[derive(Clone, Debug)]
pub struct Texture {
    pub texels: Image<Vec4>,
    pub wrap: [Wrap; 2],
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wrap {
    Repeat,
    MirroredRepeat,
    ClampToEdge,
}
