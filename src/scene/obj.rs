//! Wavefront OBJ → [`Model`]; its materials are read by [`mtl`](super::mtl).
//!
//! Read: `v` (with colours), `vt`, `vn`, `f` of any number of corners, also concave ones, `usemtl`,
//! `mtllib`, `o` and `g` as names. Points, lines, curves and smoothing groups are left out; without
//! `vn` a face is flat. An own reader and not tobj's, which keeps f32 only (survey coordinates lose
//! their centimetres), fans concave faces over their outside, mixes up texture coordinates where
//! only some corners have them, and panics on a short `Kd`.

use std::collections::HashMap;
use std::path::Path;

use glam::{DVec3, Vec2, Vec3, Vec4};

use super::buffers::MAX_ELEMENTS;
use super::files::{beside, read_file};
use super::mtl::{self, MaterialLibrary};
use super::polygon::triangulate;
use super::{Material, Model, ModelMesh, SceneError};
use crate::photo::colour::srgb_decode;

/// Reads an OBJ file and the material libraries it names. What the library or a texture lacks is
/// a warning; a face that names what is not there is an error.
pub fn read(path: &Path) -> Result<Model, SceneError> {
    let bytes = read_file(path)?;
    if let Some(problem) = no_text(&bytes) {
        let place = "its first bytes".to_owned();
        return Err(SceneError::Broken { path: path.into(), place, problem: problem.to_owned() });
    }
    let mut reader = Reader::new(path);
    for (number, line) in logical_lines(&String::from_utf8_lossy(&bytes)) {
        line.and_then(|line| reader.line(&line)).map_err(|problem| SceneError::Broken {
            path: path.into(),
            place: format!("line {number}"),
            problem,
        })?;
        reader.check_size(number)?;
    }
    Ok(reader.finish())
}

/// What a file that is no text is instead. Exporters write OBJ as text alone.
fn no_text(bytes: &[u8]) -> Option<&'static str> {
    match bytes {
        [b'g', b'l', b'T', b'F', ..] => Some("it is a binary glTF file; name it .glb"),
        [0xff, 0xfe, ..] | [0xfe, 0xff, ..] => Some("it is UTF-16 text; save it as UTF-8"),
        _ if bytes.iter().take(4096).any(|&byte| byte == 0) => {
            Some("it is binary, and an OBJ file is text; name it as what it is (.glb, .gltf)")
        }
        _ => None,
    }
}

/// Longest line read, MiB: a face of half a million corners.
const MAX_LINE_MIB: usize = 4;

/// Lines with their number; a backslash at the end joins the next one, `#` ends one.
///
/// A line of more than [`MAX_LINE_MIB`] is an error: its words take many times its length.
pub(super) fn logical_lines(
    text: &str,
) -> impl Iterator<Item = (usize, Result<String, String>)> + '_ {
    let mut lines = text.lines().enumerate();
    std::iter::from_fn(move || {
        let content = |line: &'_ str| line.split('#').next().unwrap_or("").trim_end().len();
        let (index, first) = lines.next()?;
        let mut line = String::new();
        let mut next = first;
        loop {
            let next_content = &next[..content(next)];
            if line.len() + next_content.len() > MAX_LINE_MIB << 20 {
                let problem = format!("the line is longer than {MAX_LINE_MIB} MiB");
                return Some((index + 1, Err(problem)));
            }
            line.push_str(next_content);
            if !line.ends_with('\\') {
                return Some((index + 1, Ok(line)));
            }
            line.pop();
            line.push(' ');
            next = lines.next().map_or("", |(_, next)| next);
        }
    })
}

/// Position, texture coordinate and normal of a face's corner, as indices into the file's lists.
type Corner = (usize, Option<usize>, Option<usize>);

struct Reader<'a> {
    path: &'a Path,
    positions: Vec<DVec3>,
    /// Linear; as long as `positions` once the first one has a colour.
    colours: Vec<Vec4>,
    uvs: Vec<Vec2>,
    normals: Vec<Vec3>,
    library: MaterialLibrary,
    model: Model,
    object: String,
    material: Option<String>,
    /// The mesh of each object and material.
    meshes: HashMap<(String, Option<String>), usize>,
    /// Per mesh, the vertex each kind of corner became.
    vertices: Vec<HashMap<Corner, u32>>,
    n_corners: usize,
    n_skipped: usize,
    n_fanned: usize,
}

impl<'a> Reader<'a> {
    fn new(path: &'a Path) -> Self {
        let name = path.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
        Self {
            path,
            positions: Vec::new(),
            colours: Vec::new(),
            uvs: Vec::new(),
            normals: Vec::new(),
            library: MaterialLibrary::default(),
            model: Model { name, files: vec![path.to_owned()], ..Model::default() },
            object: String::new(),
            material: None,
            meshes: HashMap::new(),
            vertices: Vec::new(),
            n_corners: 0,
            n_skipped: 0,
            n_fanned: 0,
        }
    }

    fn line(&mut self, line: &str) -> Result<(), String> {
        let (key, rest) = line.trim().split_once(char::is_whitespace).unwrap_or((line.trim(), ""));
        let rest = rest.trim();
        match key {
            "v" => self.vertex(&numbers(rest)?),
            "vt" => {
                let values = numbers(rest)?;
                let u = *values.first().ok_or("a texture coordinate without numbers")?;
                // OBJ's v runs up the picture, glTF's down.
                let v = values.get(1).copied().unwrap_or(0.0);
                self.uvs.push(Vec2::new(u as f32, (1.0 - v) as f32));
                Ok(())
            }
            "vn" => match numbers(rest)?[..] {
                [x, y, z, ..] => {
                    self.normals.push(DVec3::new(x, y, z).as_vec3());
                    Ok(())
                }
                _ => Err("a normal needs three numbers".into()),
            },
            "f" => self.face(rest),
            "o" | "g" => {
                self.object = rest.into();
                Ok(())
            }
            "usemtl" => {
                self.material = Some(rest.into());
                Ok(())
            }
            "mtllib" => {
                self.material_library(rest);
                Ok(())
            }
            "p" | "l" | "curv" | "curv2" | "surf" => {
                self.n_skipped += 1;
                Ok(())
            }
            // Smoothing groups, display attributes, comments of other dialects
            _ => Ok(()),
        }
    }

    /// `x y z`, then w (ignored, as by everybody) or a colour or both.
    fn vertex(&mut self, values: &[f64]) -> Result<(), String> {
        let &[x, y, z, ref more @ ..] = values else {
            return Err("a vertex needs three numbers".into());
        };
        self.positions.push(DVec3::new(x, y, z));
        let colour = match more {
            [r, g, b] | [_, r, g, b] => Some([*r, *g, *b]),
            _ => None,
        };
        if colour.is_none() && self.colours.is_empty() {
            return Ok(());
        }
        // Colours are what a screen showed (MeshLab, photogrammetry): through the sRGB curve.
        let linear = colour.map_or(Vec4::ONE, |rgb| {
            Vec3::from(rgb.map(|c| srgb_decode((c as f32).clamp(0.0, 1.0)))).extend(1.0)
        });
        self.colours.resize(self.positions.len() - 1, Vec4::ONE);
        self.colours.push(linear);
        Ok(())
    }

    fn face(&mut self, text: &str) -> Result<(), String> {
        let corners =
            text.split_whitespace().map(|word| self.corner(word)).collect::<Result<Vec<_>, _>>()?;
        if corners.len() < 3 {
            self.n_skipped += 1;
            return Ok(());
        }
        self.n_corners += corners.len();
        let positions: Vec<DVec3> = corners.iter().map(|corner| self.positions[corner.0]).collect();
        let (triangles, clipped) = triangulate(&positions);
        self.n_fanned += usize::from(!clipped);
        let mesh = self.mesh();
        for triangle in triangles {
            let indices = triangle.map(|i| self.vertex_of(mesh, corners[i]));
            self.model.meshes[mesh].triangles.push(indices);
        }
        Ok(())
    }

    /// `v`, `v/vt`, `v//vn` or `v/vt/vn`; negative numbers count from the end.
    fn corner(&self, word: &str) -> Result<Corner, String> {
        let mut parts = word.split('/');
        let index = |part: Option<&str>, n: usize, what: &str| -> Result<Option<usize>, String> {
            let Some(part) = part.filter(|part| !part.is_empty()) else { return Ok(None) };
            let number: i64 =
                part.parse().map_err(|_| format!("{word:?} is not a corner of a face"))?;
            let index = if number < 0 { n as i64 + number } else { number - 1 };
            let index = usize::try_from(index).ok().filter(|&i| i < n);
            index.map(Some).ok_or_else(|| format!("{what} {number} of {n} in {word:?}"))
        };
        let position = index(parts.next(), self.positions.len(), "vertex")?;
        let uv = index(parts.next(), self.uvs.len(), "texture coordinate")?;
        let normal = index(parts.next(), self.normals.len(), "normal")?;
        let position = position.ok_or_else(|| format!("{word:?} is not a corner of a face"))?;
        Ok((position, uv, normal))
    }

    /// The mesh that the current object and material go to.
    fn mesh(&mut self) -> usize {
        let key = (self.object.clone(), self.material.clone());
        if let Some(&mesh) = self.meshes.get(&key) {
            return mesh;
        }
        let mesh = self.model.meshes.len();
        self.model.meshes.push(ModelMesh { name: self.object.clone(), ..ModelMesh::default() });
        self.vertices.push(HashMap::new());
        self.meshes.insert(key, mesh);
        mesh
    }

    fn vertex_of(&mut self, mesh: usize, corner: Corner) -> u32 {
        if let Some(&known) = self.vertices[mesh].get(&corner) {
            return known;
        }
        let target = &mut self.model.meshes[mesh];
        let (position, uv, normal) = corner;
        let index = target.positions.len();
        target.positions.push(self.positions[position]);
        if !self.colours.is_empty() {
            target.colours.resize(index, Vec4::ONE);
            target.colours.push(self.colours.get(position).copied().unwrap_or(Vec4::ONE));
        }
        if let Some(uv) = uv {
            target.uvs.resize(index, Vec2::ZERO);
            target.uvs.push(self.uvs[uv]);
        }
        if let Some(normal) = normal {
            target.normals.resize(index, Vec3::ZERO);
            target.normals.push(self.normals[normal]);
        }
        self.vertices[mesh].insert(corner, index as u32);
        index as u32
    }

    fn material_library(&mut self, name: &str) {
        let library = beside(self.path, name).and_then(|path| {
            let library = mtl::read(&path).map_err(|error| error.to_string());
            self.model.files.push(path);
            library
        });
        match library {
            Ok(library) => self.library.merge(library),
            Err(problem) => self.model.warnings.push(format!(
                "material library {name:?} is not read: {problem}; its materials become grey"
            )),
        }
    }

    fn check_size(&self, line: usize) -> Result<(), SceneError> {
        let n = self.positions.len().max(self.uvs.len()).max(self.normals.len());
        if n.max(self.n_corners) <= MAX_ELEMENTS {
            return Ok(());
        }
        Err(SceneError::TooLarge {
            path: self.path.into(),
            place: format!("line {line}"),
            found: format!("the {}th vertex", MAX_ELEMENTS + 1),
            limit: MAX_ELEMENTS.to_string(),
            remedy: "simplify the mesh or split it into several files",
        })
    }

    fn finish(mut self) -> Model {
        let mut used: Vec<_> = std::mem::take(&mut self.meshes).into_iter().collect();
        used.sort_by_key(|&(_, mesh)| mesh);
        let mut numbers: HashMap<Option<String>, usize> = HashMap::new();
        for ((_, material), mesh) in used {
            let next = numbers.len();
            let number = *numbers.entry(material.clone()).or_insert(next);
            if number == next {
                let read = self.library.take(material.as_deref(), &mut self.model);
                self.model.materials.push(read);
            }
            self.model.meshes[mesh].material = number;
        }
        for mesh in &mut self.model.meshes {
            // The last vertices may lack what earlier ones had
            let n = mesh.positions.len();
            if !mesh.uvs.is_empty() {
                mesh.uvs.resize(n, Vec2::ZERO);
            }
            if !mesh.normals.is_empty() {
                mesh.normals.resize(n, Vec3::ZERO);
            }
            if !mesh.colours.is_empty() {
                mesh.colours.resize(n, Vec4::ONE);
            }
            let place = if mesh.name.is_empty() { "mesh" } else { &mesh.name }.to_string();
            mesh.mend(&place, &mut self.model.warnings);
        }
        self.model.mend_solids();
        if self.n_skipped > 0 {
            let n = self.n_skipped;
            self.model.warnings.push(format!("{n} points, lines or curves are left out"));
        }
        if self.n_fanned > 0 {
            let n = self.n_fanned;
            self.model.warnings.push(format!(
                "{n} faces have so many corners, or cross themselves, that they may be cut wrongly"
            ));
        }
        if self.model.n_triangles() == 0 {
            let nothing = "it holds no triangles: nothing of it can be seen";
            self.model.warnings.push(nothing.into());
        }
        self.model
    }
}

/// What stands for a material that the file does not define: 80 % grey, Lambert.
pub(super) fn grey(name: &str) -> Material {
    Material {
        name: name.into(),
        base_colour: Vec4::new(0.8, 0.8, 0.8, 1.0),
        specular: 0.0,
        ..Material::default()
    }
}

/// Numbers separated by blanks. "nan" and "inf" are numbers here; the mesh is mended later.
pub(super) fn numbers(text: &str) -> Result<Vec<f64>, String> {
    text.split_whitespace()
        .map(|word| word.parse().map_err(|_| format!("{word:?} is not a number")))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::AlphaMode;

    fn read_text(obj: &str, files: &[(&str, &[u8])]) -> Result<Model, SceneError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("thing.obj");
        std::fs::write(&path, obj).unwrap();
        for (name, bytes) in files {
            std::fs::write(folder.path().join(name), bytes).unwrap();
        }
        read(&path)
    }

    const SQUARE: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\n";

    #[test]
    fn corners_without_coordinates_do_not_shift_those_of_others() {
        let model = read_text(&format!("{SQUARE}f 1 2 3\nf 1/1 3/3 4/2\n"), &[]).unwrap();
        let mesh = &model.meshes[0];
        assert_eq!(mesh.positions.len(), 6);
        assert_eq!(mesh.uvs.len(), 6);
        let of = |i: usize| (mesh.positions[i], mesh.uvs[i]);
        assert_eq!(of(4), (DVec3::new(1.0, 1.0, 0.0), Vec2::new(1.0, 0.0)));
        assert_eq!(of(5), (DVec3::new(0.0, 1.0, 0.0), Vec2::new(1.0, 1.0)));
    }

    #[test]
    fn files_that_are_no_text_are_told_as_what_they_are() {
        for (bytes, told) in [
            (&b"glTF\x02\0\0\0"[..], ".glb"),
            (b"\x89PNG\r\n\x1a\n\0\0\0", "binary"),
            (b"\xff\xfev\0 \0", "UTF-8"),
        ] {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("thing.obj");
            std::fs::write(&path, bytes).unwrap();
            let said = read(&path).unwrap_err().to_string();
            assert!(said.contains("thing.obj") && said.contains(told), "{said}");
        }
    }

    #[test]
    fn negative_indices_count_from_the_end_and_lines_continue() {
        let model = read_text(&format!("{SQUARE}f -4 \\\n -3 -2 # a\n"), &[]).unwrap();
        assert_eq!(model.meshes[0].positions[2], DVec3::new(1.0, 1.0, 0.0));
    }

    #[test]
    fn many_continued_lines_are_joined_in_one_pass_and_a_giant_one_is_refused() {
        // 300 000 times a copy of the line so far would be 45 GB.
        let begin = std::time::Instant::now();
        let face = format!("f 1 2 3 {}4\n", "\\\n".repeat(300_000));
        let model = read_text(&format!("{SQUARE}{face}"), &[]).unwrap();
        assert_eq!(model.n_triangles(), 2);
        assert!(begin.elapsed().as_secs() < 5, "{:?}", begin.elapsed());
        let giant = format!("{SQUARE}f 1 2 3 {}\n", "4 ".repeat(3_000_000));
        let error = read_text(&giant, &[]).unwrap_err().to_string();
        assert!(error.contains("line 8") && error.contains("MiB"), "{error}");
    }

    #[test]
    fn libraries_in_different_folders_have_pictures_of_their_own() {
        let folder = tempfile::tempdir().unwrap();
        for (name, colour) in [("a", [255, 0, 0]), ("b", [0, 255, 0])] {
            let beside = folder.path().join(name);
            std::fs::create_dir(&beside).unwrap();
            let picture = image::RgbImage::from_pixel(1, 1, image::Rgb(colour));
            picture.save(beside.join("tex.png")).unwrap();
            let mtl = format!("newmtl {name}\nKd 1 1 1\nmap_Kd tex.png\n");
            std::fs::write(beside.join("m.mtl"), mtl).unwrap();
        }
        let faces = "usemtl a\nf 1/1 2/2 3/3\nusemtl b\nf 1/1 2/2 3/3\n";
        let path = folder.path().join("thing.obj");
        std::fs::write(&path, format!("mtllib a/m.mtl\nmtllib b/m.mtl\n{SQUARE}{faces}")).unwrap();
        let model = read(&path).unwrap();
        let colours = model.materials.iter().map(|material| {
            material.evaluate(&model.textures, [Vec2::splat(0.5); 2], Vec4::ONE).base_colour
        });
        assert_eq!(colours.collect::<Vec<_>>(), [Vec3::X, Vec3::Y]);
    }

    #[test]
    fn survey_coordinates_keep_their_millimetres() {
        let obj = "v 4123456.123 5600789.001 12.5\nv 4123457.123 5600789.001 12.5\n\
                   v 4123456.123 5600790.001 12.5\nf 1 2 3\n";
        let model = read_text(obj, &[]).unwrap();
        assert_eq!(model.meshes[0].positions[0], DVec3::new(4123456.123, 5600789.001, 12.5));
    }

    #[test]
    fn bad_faces_name_their_line() {
        for (face, word) in [
            ("f 1 2 9", "9"),
            ("f 0 1 2", "0"),
            ("f 1 2 -5", "-5"),
            ("f 1/9 2 3", "texture coordinate"),
            ("f a b c", "corner"),
            ("v 1 x 2", "number"),
            ("f 1 2 99999999999999999999", "corner"),
        ] {
            let error = read_text(&format!("{SQUARE}{face}\n"), &[]).unwrap_err().to_string();
            assert!(error.contains("line 8") && error.contains(word), "{error}");
        }
    }

    #[test]
    fn a_missing_library_is_a_warning_and_the_material_grey() {
        let obj = format!("mtllib gone.mtl\n{SQUARE}usemtl red\nf 1 2 3 4\n");
        let model = read_text(&obj, &[]).unwrap();
        assert_eq!(model.n_triangles(), 2);
        assert_eq!(model.warnings.len(), 2, "{:?}", model.warnings);
        assert!(model.warnings[0].contains("gone.mtl") && model.warnings[1].contains("red"));
        assert_eq!(model.materials[0].base_colour.x, 0.8);
        let outside = read_text(&format!("mtllib ../../etc/passwd\n{SQUARE}f 1 2 3\n"), &[]);
        assert!(outside.unwrap().warnings[0].contains("beside it"));
    }

    #[test]
    fn materials_map_onto_metallic_roughness() {
        let mtl = "newmtl matte\nKd 0.5 0.25 0.1\n\
                   newmtl shiny\nKd 0.1 0.1 0.1\nKs 0.5 0.5 0.5\nNs 30\n\
                   newmtl steel\nKd 0.6 0.6 0.6\nPm 1\nPr 0.3\nKs 0 0 0\nPc 0.5\nPcr 0.1\n\
                   newmtl glass\nillum 7\nNi 1.45\nKd 1 1 1\nd 0.1\n\
                   newmtl veil\nKd 1 1 1\nd 0.25\n\
                   newmtl broken\nKd 1\nKs a b c\nmap_Kd -s 2\nNs\n";
        let mut obj = format!("mtllib m.mtl\n{SQUARE}");
        for name in ["matte", "shiny", "steel", "glass", "veil", "broken"] {
            obj += &format!("usemtl {name}\nf 1 2 3\n");
        }
        let model = read_text(&obj, &[("m.mtl", mtl.as_bytes())]).unwrap();
        let [matte, shiny, steel, glass, veil, broken] = &model.materials[..] else { panic!() };
        assert_eq!((matte.specular, matte.roughness), (0.0, 1.0));
        assert_eq!((shiny.specular, shiny.specular_colour), (1.0, Vec3::ONE));
        assert!((shiny.roughness - 0.5).abs() < 1e-6, "Ns 30: α = √(2/32) = ¼");
        assert_eq!((steel.metallic, steel.roughness, steel.specular), (1.0, 0.3, 1.0));
        let coat = steel.clearcoat.as_ref().unwrap();
        assert_eq!((coat.factor, coat.roughness, matte.clearcoat.is_none()), (0.5, 0.1, true));
        assert_eq!((glass.transmission, glass.solid, glass.ior), (1.0, true, 1.45));
        assert_eq!((glass.roughness, glass.alpha_mode), (0.0, AlphaMode::Opaque));
        assert_eq!((veil.alpha_mode, veil.base_colour.w), (AlphaMode::Blend, 0.25));
        assert_eq!(broken.base_colour.truncate(), Vec3::ONE);
        let mut warnings = model.warnings.iter();
        for expected in ["is not a number", "file name", "Ns", "is not closed"] {
            assert!(warnings.next().unwrap().contains(expected), "{:?}", model.warnings);
        }
        assert!(warnings.next().is_none());
    }

    #[test]
    fn a_map_s_path_of_another_machine_is_looked_for_beside_the_library() {
        let picture = image::RgbImage::from_fn(1, 2, |_, y| image::Rgb([255 * y as u8, 0, 0]));
        let mut png = Vec::new();
        let format = image::ImageFormat::Png;
        picture.write_to(&mut std::io::Cursor::new(&mut png), format).unwrap();
        let mtl = b"newmtl m\nKd 1 1 1\nmap_Kd -s 1 1 -o 0 0.5 C:\\Users\\me\\red below.png\n";
        let obj = format!("mtllib m.mtl\n{SQUARE}usemtl m\nf 1/1 2/2 3/3\n");
        let files: [(&str, &[u8]); 2] = [("m.mtl", mtl), ("red below.png", &png)];
        let model = read_text(&obj, &files).unwrap();
        assert!(model.warnings.is_empty(), "{:?}", model.warnings);
        let names: Vec<_> = model.files.iter().filter_map(|file| file.file_name()).collect();
        assert_eq!(names[1..], ["m.mtl", "red below.png"], "what the model is made from");
        // OBJ v = 0.25 moved by +0.5 is 0.75: the upper, black row. glTF v = 1 − 0.25.
        let at = |v: f32| {
            let uvs = [Vec2::new(0.5, 1.0 - v); 2];
            model.materials[0].evaluate(&model.textures, uvs, Vec4::ONE).base_colour.x
        };
        assert_eq!((at(0.25), at(0.75)), (0.0, 1.0));
    }

    #[test]
    fn colours_of_vertices_go_through_the_srgb_curve() {
        let obj = "v 0 0 0 1 1 1\nv 1 0 0 0 0 0\nv 0 1 0 0.5 0.5 0.5\nf 1 2 3\n";
        let model = read_text(obj, &[]).unwrap();
        let red: Vec<f32> = model.meshes[0].colours.iter().map(|c| c.x).collect();
        assert!(red[0] == 1.0 && red[1] == 0.0 && (red[2] - 0.214_041).abs() < 1e-5);
    }
}
