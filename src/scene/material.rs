//! glTF 2.0 metallic-roughness materials, onto which OBJ's MTL is mapped too.
//!
//! A [`Material`] says how the numbers vary over a surface; [`Material::evaluate`] gives them at one
//! point as a [`SurfaceParameters`], from which the render room builds its BSDF. Occlusion maps are
//! not read: what they imitate is traced.

use glam::{Affine2, Vec2, Vec3, Vec4};

use super::{Clearcoat, Sheen, Texture};
use crate::conventions::Rgb;

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
    /// Red multiplies `transmission`.
    pub transmission_texture: Option<TextureRef>,
    /// True if the material bounds a solid (KHR_materials_volume or a closed glass): rays refract.
    pub solid: bool,
    /// KHR_materials_volume: attenuation colour over `attenuation_distance` metres.
    pub attenuation_colour: Rgb,
    pub attenuation_distance: f32,
    /// KHR_materials_ior.
    pub ior: f32,
    /// KHR_materials_specular: 0 is exactly Lambert.
    pub specular: f32,
    /// Alpha multiplies `specular`.
    pub specular_texture: Option<TextureRef>,
    pub specular_colour: Rgb,
    pub specular_colour_texture: Option<TextureRef>,
    pub sheen: Option<Sheen>,
    /// Above everything else, the sheen too.
    pub clearcoat: Option<Clearcoat>,
    /// Whether light that microfacets pass among each other is given back. glTF's own formula, and the
    /// default, loses it.
    pub multiple_scattering: bool,
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
            transmission_texture: None,
            solid: false,
            attenuation_colour: Vec3::ONE,
            attenuation_distance: f32::INFINITY,
            ior: 1.5,
            specular: 1.0,
            specular_texture: None,
            specular_colour: Vec3::ONE,
            specular_colour_texture: None,
            sheen: None,
            clearcoat: None,
            multiple_scattering: false,
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
    /// 0 = [`Mesh::uvs`](super::Mesh::uvs), 1 = [`Mesh::second_uvs`](super::Mesh::second_uvs).
    pub uv_set: usize,
    /// uv' = matrix · uv + offset.
    pub uv_transform: Affine2,
}

impl TextureRef {
    fn sample(&self, textures: &[Texture], uvs: [Vec2; 2]) -> Vec4 {
        textures[self.texture].sample(self.picture_uv(uvs))
    }

    /// Coordinates on the picture itself where a mesh's two sets are `uvs`.
    pub(super) fn picture_uv(&self, uvs: [Vec2; 2]) -> Vec2 {
        self.uv_transform.transform_point2(uvs[self.uv_set])
    }
}

/// The plain numbers of a material at one point: what a BSDF is built from (methods-render R5).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfaceParameters {
    /// Linear: factor × texture × vertex colour.
    pub base_colour: Rgb,
    /// Share of the surface that is there: 1 if opaque, 0 or 1 for a mask.
    pub alpha: f32,
    pub metallic: f32,
    /// Perceptual; GGX α = roughness².
    pub roughness: f32,
    /// Radiance sent out by the front (and the back, if `double_sided`).
    pub emissive: Rgb,
    pub double_sided: bool,
    pub transmission: f32,
    /// Whether transmitted rays refract into a solid (else a thin sheet, straight through).
    pub solid: bool,
    /// Share of light left per channel after `attenuation_distance` metres inside the solid.
    pub attenuation_colour: Rgb,
    /// +∞ = clear.
    pub attenuation_distance: f32,
    pub ior: f32,
    /// Weight of the dielectric reflection; 0 = exactly Lambert.
    pub specular: f32,
    pub specular_colour: Rgb,
    /// Black = no sheen.
    pub sheen_colour: Rgb,
    /// Perceptual; Charlie's α = roughness².
    pub sheen_roughness: f32,
    /// Share of the surface that is coated; 0 = no coat.
    pub clearcoat: f32,
    /// Perceptual; GGX α = roughness².
    pub clearcoat_roughness: f32,
    /// See [`Material::multiple_scattering`].
    pub multiple_scattering: bool,
}

impl Material {
    /// The material's numbers where the two texture coordinates are `uvs`.
    ///
    /// `textures` are those of the [`Scene`](super::Scene) the material belongs to.
    pub fn evaluate(
        &self,
        textures: &[Texture],
        uvs: [Vec2; 2],
        vertex_colour: Vec4,
    ) -> SurfaceParameters {
        let sample = |texture: &Option<TextureRef>| {
            texture.as_ref().map_or(Vec4::ONE, |t| t.sample(textures, uvs))
        };
        let base = self.base_colour * vertex_colour * sample(&self.base_colour_texture);
        let rough_metal = sample(&self.metallic_roughness_texture);
        let mut at = SurfaceParameters {
            base_colour: base.truncate().max(Vec3::ZERO),
            alpha: self.alpha_mode.coverage(base.w),
            metallic: (self.metallic * rough_metal.z).clamp(0.0, 1.0),
            roughness: (self.roughness * rough_metal.y).clamp(0.0, 1.0),
            emissive: self.emissive * sample(&self.emissive_texture).truncate(),
            double_sided: self.double_sided,
            transmission: self.transmission * sample(&self.transmission_texture).x,
            solid: self.solid,
            attenuation_colour: self.attenuation_colour,
            attenuation_distance: self.attenuation_distance,
            ior: self.ior,
            specular: self.specular * sample(&self.specular_texture).w,
            specular_colour: self.specular_colour
                * sample(&self.specular_colour_texture).truncate(),
            sheen_colour: Vec3::ZERO,
            sheen_roughness: 0.0,
            clearcoat: 0.0,
            clearcoat_roughness: 0.0,
            multiple_scattering: self.multiple_scattering,
        };
        if let Some(sheen) = &self.sheen {
            sheen.evaluate(sample, &mut at);
        }
        if let Some(coat) = &self.clearcoat {
            coat.evaluate(sample, &mut at);
        }
        at
    }

    /// Only [`SurfaceParameters::alpha`]: cheap enough to ask during the walk of a ray.
    pub fn alpha(&self, textures: &[Texture], uvs: [Vec2; 2], vertex_colour: Vec4) -> f32 {
        if self.alpha_mode == AlphaMode::Opaque {
            return 1.0;
        }
        let texture = self.base_colour_texture.as_ref();
        let alpha = texture.map_or(1.0, |t| t.sample(textures, uvs).w);
        self.alpha_mode.coverage(self.base_colour.w * vertex_colour.w * alpha)
    }

    /// The shading normal in the tangent frame (x along the tangent, z the interpolated normal),
    /// unit; `None` if the material has no normal map.
    pub fn tangent_normal(&self, textures: &[Texture], uvs: [Vec2; 2]) -> Option<Vec3> {
        tangent_normal(self.normal_texture.as_ref()?, self.normal_scale, textures, uvs)
    }

    /// The sets of texture coordinates that its textures need, ascending.
    pub(super) fn uv_sets(&self) -> Vec<usize> {
        let sets = self.clone().texture_refs_mut().map(|texture| texture.uv_set).collect();
        let sets: std::collections::BTreeSet<usize> = sets;
        sets.into_iter().collect()
    }

    pub(super) fn texture_refs_mut(&mut self) -> impl Iterator<Item = &mut TextureRef> {
        [
            &mut self.base_colour_texture,
            &mut self.metallic_roughness_texture,
            &mut self.normal_texture,
            &mut self.emissive_texture,
            &mut self.transmission_texture,
            &mut self.specular_texture,
            &mut self.specular_colour_texture,
        ]
        .into_iter()
        .flatten()
        .chain(self.sheen.iter_mut().flat_map(Sheen::texture_refs_mut))
        .chain(self.clearcoat.iter_mut().flat_map(Clearcoat::texture_refs_mut))
    }
}

/// What a normal map holds at a point, x and y times `scale`; unit.
pub(super) fn tangent_normal(
    map: &TextureRef,
    scale: f32,
    textures: &[Texture],
    uvs: [Vec2; 2],
) -> Option<Vec3> {
    let texel = map.sample(textures, uvs).truncate();
    (Vec3::new(scale, scale, 1.0) * (2.0 * texel - 1.0)).try_normalize()
}

impl AlphaMode {
    fn coverage(self, alpha: f32) -> f32 {
        match self {
            Self::Opaque => 1.0,
            Self::Mask(cutoff) => f32::from(u8::from(alpha >= cutoff)),
            Self::Blend => alpha.clamp(0.0, 1.0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::photo::Image;
    use crate::scene::Wrap;

    fn two_texels(left: Vec4, right: Vec4) -> Texture {
        let texels = Image::from_fn(2, 1, |x, _| if x == 0 { left } else { right });
        Texture::from_linear(texels, [Wrap::Repeat; 2]).unwrap()
    }

    fn first_texture() -> Option<TextureRef> {
        Some(TextureRef { texture: 0, uv_set: 0, uv_transform: Affine2::IDENTITY })
    }

    #[test]
    fn factor_texture_and_vertex_colour_multiply() {
        let textures = [two_texels(Vec4::splat(0.5), Vec4::ONE)];
        let material = Material {
            base_colour: Vec4::new(0.8, 0.4, 0.2, 1.0),
            base_colour_texture: first_texture(),
            metallic: 0.6,
            roughness: 0.4,
            metallic_roughness_texture: first_texture(),
            ..Material::default()
        };
        let uv = Vec2::new(0.25, 0.5);
        let at = material.evaluate(&textures, [uv; 2], Vec4::new(1.0, 0.5, 1.0, 1.0));
        assert!((at.base_colour - Vec3::new(0.4, 0.1, 0.1)).length() < 1e-6);
        assert_eq!((at.metallic, at.roughness, at.alpha), (0.3, 0.2, 1.0));
    }

    #[test]
    fn a_mask_is_all_or_nothing_and_blend_is_alpha() {
        let textures = [two_texels(Vec4::splat(0.3), Vec4::splat(0.7))];
        let alpha = |alpha_mode, u| {
            let material = Material {
                alpha_mode,
                base_colour_texture: first_texture(),
                ..Material::default()
            };
            let uvs = [Vec2::new(u, 0.5); 2];
            let alpha = material.alpha(&textures, uvs, Vec4::ONE);
            assert_eq!(alpha, material.evaluate(&textures, uvs, Vec4::ONE).alpha);
            alpha
        };
        assert_eq!(alpha(AlphaMode::Mask(0.5), 0.25), 0.0);
        assert_eq!(alpha(AlphaMode::Mask(0.5), 0.75), 1.0);
        assert_eq!(alpha(AlphaMode::Blend, 0.25), 0.3);
        assert_eq!(alpha(AlphaMode::Opaque, 0.25), 1.0);
    }

    #[test]
    fn a_flat_normal_map_leaves_the_normal_and_scale_tilts_it() {
        let tilted = Vec4::new(0.75, 0.5, 1.0, 1.0);
        let textures = [two_texels(Vec4::new(0.5, 0.5, 1.0, 1.0), tilted)];
        let mut material = Material { normal_texture: first_texture(), ..Material::default() };
        let normal = |m: &Material, u| m.tangent_normal(&textures, [Vec2::new(u, 0.5); 2]).unwrap();
        assert_eq!(normal(&material, 0.25), Vec3::Z);
        assert!((normal(&material, 0.75) - Vec3::new(0.5, 0.0, 1.0).normalize()).length() < 1e-6);
        material.normal_scale = 0.0;
        assert_eq!(normal(&material, 0.75), Vec3::Z);
    }
}
