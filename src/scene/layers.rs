//! Layers that glTF extensions put upon a material: sheen, and a clear coat above all.

use glam::{Vec2, Vec3, Vec4};

use super::material::{TextureRef, tangent_normal};
use super::{SurfaceParameters, Texture};
use crate::conventions::Rgb;

/// KHR_materials_clearcoat: a thin clear varnish of index 1.5.
#[derive(Clone, Debug)]
pub struct Clearcoat {
    /// Share of the surface that is coated, 0…1.
    pub factor: f32,
    /// Red multiplies `factor`.
    pub texture: Option<TextureRef>,
    /// Perceptual roughness; GGX α = roughness².
    pub roughness: f32,
    /// Green multiplies `roughness`.
    pub roughness_texture: Option<TextureRef>,
    /// Of the coat alone: without it the coat is as smooth as the mesh, whatever lies beneath.
    pub normal_texture: Option<TextureRef>,
    pub normal_scale: f32,
}

/// KHR_materials_sheen: the back-scattering of fibres that stand upright, as of velvet.
#[derive(Clone, Debug)]
pub struct Sheen {
    /// Linear, 0…1.
    pub colour: Rgb,
    pub colour_texture: Option<TextureRef>,
    /// How far the fibres lean; Charlie's α = roughness².
    pub roughness: f32,
    /// Alpha multiplies `roughness`.
    pub roughness_texture: Option<TextureRef>,
}

impl Default for Clearcoat {
    /// The extension's defaults: nothing coated, perfectly smooth.
    fn default() -> Self {
        Self {
            factor: 0.0,
            texture: None,
            roughness: 0.0,
            roughness_texture: None,
            normal_texture: None,
            normal_scale: 1.0,
        }
    }
}

impl Default for Sheen {
    /// The extension's defaults: black, hence none.
    fn default() -> Self {
        Self { colour: Vec3::ZERO, colour_texture: None, roughness: 0.0, roughness_texture: None }
    }
}

impl Clearcoat {
    pub(super) fn evaluate(
        &self,
        sample: impl Fn(&Option<TextureRef>) -> Vec4,
        at: &mut SurfaceParameters,
    ) {
        at.clearcoat = (self.factor * sample(&self.texture).x).clamp(0.0, 1.0);
        at.clearcoat_roughness =
            (self.roughness * sample(&self.roughness_texture).y).clamp(0.0, 1.0);
    }

    /// As [`Material::tangent_normal`](super::Material::tangent_normal), of the coat.
    pub(super) fn tangent_normal(&self, textures: &[Texture], uvs: [Vec2; 2]) -> Option<Vec3> {
        tangent_normal(self.normal_texture.as_ref()?, self.normal_scale, textures, uvs)
    }

    pub(super) fn texture_refs_mut(&mut self) -> impl Iterator<Item = &mut TextureRef> {
        [&mut self.texture, &mut self.roughness_texture, &mut self.normal_texture]
            .into_iter()
            .flatten()
    }
}

impl Sheen {
    pub(super) fn evaluate(
        &self,
        sample: impl Fn(&Option<TextureRef>) -> Vec4,
        at: &mut SurfaceParameters,
    ) {
        let colour = self.colour * sample(&self.colour_texture).truncate();
        at.sheen_colour = colour.clamp(Vec3::ZERO, Vec3::ONE);
        at.sheen_roughness = (self.roughness * sample(&self.roughness_texture).w).clamp(0.0, 1.0);
    }

    pub(super) fn texture_refs_mut(&mut self) -> impl Iterator<Item = &mut TextureRef> {
        [&mut self.colour_texture, &mut self.roughness_texture].into_iter().flatten()
    }
}
