//! Wavefront MTL → metallic-roughness [`Material`]s.
//!
//! | MTL | here |
//! |---|---|
//! | `Kd`, `map_Kd` | base colour (numbers linear, picture sRGB) |
//! | `Ks` | weight of the dielectric reflection: 0.5 is F0 = 0.04 (what Blender writes), none is Lambert |
//! | `Ns` | roughness = (2 / (Ns + 2))^¼: the Blinn exponent whose lobe is as wide as GGX's α = roughness² |
//! | `Pr`, `Pm` | roughness, metallic, before `Ns` |
//! | `Pc`, `Pcr` | clear coat and its roughness |
//! | `Ke`, `map_Ke` | emissive |
//! | `Ni` | index of refraction |
//! | `d`, `Tr` | alpha, blended; `map_d` of the same picture as `map_Kd`: its alpha |
//! | `illum` 4, 6, 7, 9 | smooth or rough glass, solid: transmission 1, tinted by `Kd` |
//! | `norm` | normal map; `-s`, `-o` and `-clamp` of any map |
//!
//! `Ka`, `Tf`, bump heights and the other maps are left out, the last two with a warning.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use glam::{Affine2, Mat2, Vec2, Vec3, Vec4};

use super::files::{beside, read_file};
use super::obj::{grey, logical_lines, numbers};
use super::texture::{TexelMeaning, Wrap};
use super::{AlphaMode, Clearcoat, Material, Model, SceneError, Texture, TextureRef};

/// Materials by name, pictures not yet read.
#[derive(Default)]
pub(super) struct MaterialLibrary {
    materials: HashMap<String, MtlMaterial>,
    /// Pictures already read: index into the model's textures.
    read: HashMap<PictureKey, Option<usize>>,
}

/// The library's folder, the picture's name in it, meaning and wrap.
type PictureKey = (PathBuf, String, TexelMeaning, Wrap);

#[derive(Clone, Default)]
struct MtlMaterial {
    file: PathBuf,
    diffuse: Option<Vec3>,
    specular: Option<Vec3>,
    emissive: Option<Vec3>,
    exponent: Option<f32>,
    roughness: Option<f32>,
    metallic: Option<f32>,
    clearcoat: Option<f32>,
    clearcoat_roughness: Option<f32>,
    ior: Option<f32>,
    alpha: Option<f32>,
    illumination: u32,
    /// By key (`map_Kd`, `norm` …).
    maps: HashMap<String, Map>,
    problems: Vec<String>,
}

/// A picture with its options.
#[derive(Clone, Debug, PartialEq)]
struct Map {
    name: String,
    scale: Vec2,
    offset: Vec2,
    clamp: bool,
}

/// Reads a library. Lines that cannot be read are warnings of the material they belong to.
pub(super) fn read(path: &Path) -> Result<MaterialLibrary, SceneError> {
    let bytes = read_file(path)?;
    let mut library = MaterialLibrary::default();
    let mut name = None;
    for (number, line) in logical_lines(&String::from_utf8_lossy(&bytes)) {
        let text = line.as_deref().unwrap_or("").trim();
        let (key, rest) = text.split_once(char::is_whitespace).unwrap_or((text, ""));
        let rest = rest.trim();
        if key == "newmtl" {
            name = Some(rest.to_string());
            let fresh = MtlMaterial { file: path.into(), ..MtlMaterial::default() };
            library.materials.insert(rest.into(), fresh);
        } else if let Some(material) = name.as_ref().and_then(|n| library.materials.get_mut(n))
            && let Some(problem) =
                line.as_ref().err().cloned().or_else(|| material.line(key, rest).err())
        {
            material.problems.push(format!("line {number}: {problem}"));
        }
    }
    Ok(library)
}

impl MtlMaterial {
    fn line(&mut self, key: &str, rest: &str) -> Result<(), String> {
        let rest = rest.trim_start_matches("-halo");
        let one = || -> Result<Option<f32>, String> {
            let value = *numbers(rest)?.first().ok_or(format!("{key} without a number"))? as f32;
            if value.is_finite() { Ok(Some(value)) } else { Err(format!("{key} is not finite")) }
        };
        let colour = || -> Result<Option<Vec3>, String> {
            let values = numbers(rest)?;
            let colour = match values[..] {
                // One number is grey (MTL specification).
                [grey] => Vec3::splat(grey as f32),
                [r, g, b, ..] => Vec3::new(r as f32, g as f32, b as f32),
                _ => return Err(format!("{key} needs three numbers")),
            };
            if colour.is_finite() && colour.min_element() >= 0.0 {
                Ok(Some(colour))
            } else {
                Err(format!("{key} is not a colour"))
            }
        };
        match key {
            "Kd" => self.diffuse = colour()?,
            "Ks" => self.specular = colour()?,
            "Ke" => self.emissive = colour()?,
            "Ns" => self.exponent = one()?,
            "Pr" => self.roughness = one()?,
            "Pm" => self.metallic = one()?,
            "Pc" => self.clearcoat = one()?,
            "Pcr" => self.clearcoat_roughness = one()?,
            "Ni" => self.ior = one()?,
            "d" => {
                self.alpha = numbers(rest.trim_start_matches("-halo"))?.first().map(|&d| d as f32)
            }
            "Tr" => self.alpha = one()?.map(|tr| 1.0 - tr),
            "illum" => self.illumination = one()?.unwrap_or(0.0) as u32,
            "map_Kd" | "map_Ke" | "map_d" | "norm" => {
                self.maps.insert(key.into(), map(rest)?);
            }
            _ if key.starts_with("map_") || key == "bump" || key == "disp" => {
                return Err(format!("{key} is not read"));
            }
            _ => {}
        }
        Ok(())
    }

    fn is_glass(&self) -> bool {
        matches!(self.illumination, 4 | 6 | 7 | 9)
    }
}

/// `[-option values]… file name`.
fn map(text: &str) -> Result<Map, String> {
    let mut map = Map { name: String::new(), scale: Vec2::ONE, offset: Vec2::ZERO, clamp: false };
    let mut rest = text.trim();
    while rest.starts_with('-') {
        let (option, after) = rest.split_once(char::is_whitespace).unwrap_or((rest, ""));
        rest = after.trim_start();
        let mut values = Vec::new();
        let most = match option {
            "-s" | "-o" | "-t" => 3,
            "-mm" => 2,
            _ => 1,
        };
        while values.len() < most {
            let (word, after) = rest.split_once(char::is_whitespace).unwrap_or((rest, ""));
            // -s, -o and -t have one to three numbers; the file name is what is none.
            if word.is_empty() || (most == 3 && word.parse::<f32>().is_err()) {
                break;
            }
            values.push(word);
            rest = after.trim_start();
        }
        let number = |i: usize, otherwise: f32| {
            values
                .get(i)
                .and_then(|v| v.parse().ok())
                .filter(|v: &f32| v.is_finite())
                .unwrap_or(otherwise)
        };
        match option {
            "-s" => map.scale = Vec2::new(number(0, 1.0), number(1, 1.0)),
            "-o" => map.offset = Vec2::new(number(0, 0.0), number(1, 0.0)),
            "-clamp" => map.clamp = values.first() == Some(&"on"),
            _ => {}
        }
    }
    map.name = rest.into();
    if map.name.is_empty() { Err("a map without a file name".into()) } else { Ok(map) }
}

impl MaterialLibrary {
    /// Adds the materials of another library; of two with one name the later counts.
    pub fn merge(&mut self, other: Self) {
        self.materials.extend(other.materials);
    }

    /// The material of a name, its pictures read into `model`; grey if there is none.
    pub fn take(&mut self, name: Option<&str>, model: &mut Model) -> Material {
        let Some(name) = name else {
            model.warnings.push("faces without a material become 80 % grey".into());
            return grey("");
        };
        let Some(mtl) = self.materials.get(name).cloned() else {
            model.warnings.push(format!("material {name:?} is not defined: 80 % grey"));
            return grey(name);
        };
        let place = format!("{}: material {name:?}", mtl.file.display());
        model.warnings.extend(mtl.problems.iter().map(|problem| format!("{place}, {problem}")));
        let alpha = mtl.alpha.unwrap_or(1.0).clamp(0.0, 1.0);
        let specular = mtl.specular.unwrap_or(Vec3::ZERO);
        let is_pbr = mtl.roughness.is_some() || mtl.metallic.is_some();
        let from_exponent = |ns: f32| (2.0 / (ns.max(0.0) + 2.0)).powf(0.25);
        let mut material = Material {
            name: name.into(),
            base_colour: mtl.diffuse.unwrap_or(Vec3::splat(0.8)).min(Vec3::ONE).extend(1.0),
            metallic: mtl.metallic.unwrap_or(0.0).clamp(0.0, 1.0),
            roughness: mtl
                .roughness
                .or(mtl.exponent.map(from_exponent))
                .unwrap_or(1.0)
                .clamp(0.0, 1.0),
            emissive: mtl.emissive.unwrap_or(Vec3::ZERO),
            ior: mtl.ior.filter(|&ior| ior >= 1.0).unwrap_or(1.5),
            specular: if is_pbr || specular != Vec3::ZERO { 1.0 } else { 0.0 },
            specular_colour: if is_pbr {
                Vec3::ONE
            } else {
                (2.0 * specular).min(Vec3::splat(f32::MAX))
            },
            clearcoat: mtl.clearcoat.filter(|&factor| factor > 0.0).map(|factor| Clearcoat {
                factor: factor.min(1.0),
                roughness: mtl.clearcoat_roughness.unwrap_or(0.0).clamp(0.0, 1.0),
                ..Clearcoat::default()
            }),
            ..Material::default()
        };
        if mtl.is_glass() {
            material.transmission = 1.0;
            material.solid = true;
            (material.specular, material.specular_colour) = (1.0, Vec3::ONE);
            material.roughness = mtl.roughness.or(mtl.exponent.map(from_exponent)).unwrap_or(0.0);
        } else if alpha < 1.0 {
            material.alpha_mode = AlphaMode::Blend;
            material.base_colour.w = alpha;
        }
        let mut texture = |key: &str, meaning| {
            let map = mtl.maps.get(key)?;
            self.texture(&mtl.file, map, meaning, &format!("{place}, {key}"), model)
        };
        material.base_colour_texture = texture("map_Kd", TexelMeaning::Colour);
        material.normal_texture = texture("norm", TexelMeaning::Numbers);
        material.emissive_texture = texture("map_Ke", TexelMeaning::Colour);
        if material.base_colour_texture.is_some() && mtl.diffuse == Some(Vec3::ZERO) {
            // Exporters write Kd 0 0 0 beside a map and do not mean black.
            material.base_colour = Vec4::ONE.with_w(material.base_colour.w);
        }
        if material.emissive_texture.is_some() && mtl.emissive.is_none() {
            material.emissive = Vec3::ONE;
        }
        if let Some(mask) = mtl.maps.get("map_d") {
            let same = mtl.maps.get("map_Kd").is_some_and(|colour| colour.name == mask.name);
            if same && material.base_colour_texture.is_some() {
                material.alpha_mode = AlphaMode::Blend;
            } else {
                model.warnings.push(format!(
                    "{place}, map_d: only the alpha of the picture of map_Kd is read"
                ));
            }
        }
        material
    }

    fn texture(
        &mut self,
        library: &Path,
        map: &Map,
        meaning: TexelMeaning,
        place: &str,
        model: &mut Model,
    ) -> Option<TextureRef> {
        let wrap = if map.clamp { Wrap::ClampToEdge } else { Wrap::Repeat };
        let folder = library.parent().unwrap_or(Path::new("")).to_owned();
        let key = (folder, map.name.clone(), meaning, wrap);
        let texture = *self.read.entry(key).or_insert_with(|| {
            let path = picture_path(library, &map.name);
            model.files.extend(path.clone());
            match read_picture(path, meaning, wrap) {
                Ok(texture) => {
                    model.textures.push(texture);
                    Some(model.textures.len() - 1)
                }
                Err(problem) => {
                    model.warnings.push(format!("{place} {:?} is left out: {problem}", map.name));
                    None
                }
            }
        });
        // The options count in OBJ's uv (v up): conjugate them with the flip to v down.
        let matrix2 = Mat2::from_diagonal(map.scale);
        let translation = Vec2::new(map.offset.x, 1.0 - map.scale.y - map.offset.y);
        let uv_transform = Affine2 { matrix2, translation };
        Some(TextureRef { texture: texture?, uv_set: 0, uv_transform })
    }
}

/// The picture as named, or, since many libraries keep paths of another machine, by its last name
/// beside the library, if it is there.
fn picture_path(library: &Path, name: &str) -> Result<PathBuf, String> {
    let last = name.rsplit(['/', '\\']).next().unwrap_or(name);
    let as_named = beside(library, name);
    if as_named.as_ref().is_ok_and(|path| path.is_file()) {
        return as_named;
    }
    beside(library, last).ok().filter(|path| path.is_file()).map_or(as_named, Ok)
}

fn read_picture(
    path: Result<PathBuf, String>,
    meaning: TexelMeaning,
    wrap: Wrap,
) -> Result<Texture, String> {
    let path = path?;
    if !path.is_file() {
        return Err(format!("{} is not there", path.display()));
    }
    let bytes = read_file(&path).map_err(|error| error.to_string())?;
    Texture::decode(&bytes, meaning, [wrap; 2])
}
