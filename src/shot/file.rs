//! shot.toml: what is in the shot, as the user wrote it, with defaults filled in.
//!
//! [`ShotFile::read`] finds all problems of the text at once; whether the named files exist and fit
//! is the plan's question. Paths are made relative to the shot file here and nowhere else. The
//! format is described key by key in `docs/shot.md`; [`Serialize`] gives the effective settings.

use std::path::{Path, PathBuf};

use serde::Serialize;
use toml::de::DeTable;

use super::camera_keys::{CameraKeys, ExposureKeys, PoseSource};
use super::frames::{Frames, frame_path, has_pattern};
use super::keys::{Keys, Problems};
use super::motion::Motion;
use super::prepare::METHODS;
use super::probe_keys::{Lamp, ProbeKeys, Surroundings};
use super::sky;
use super::stop::StopKeys;
use crate::photo::{NamedColour, text};
use crate::render::Caustics;

/// The whole shot file.
#[derive(Clone, Debug, Serialize)]
pub struct ShotFile {
    /// The file itself.
    pub path: PathBuf,
    pub plate: PlateKeys,
    pub camera: CameraKeys,
    pub pose: PoseSource,
    pub probe: ProbeKeys,
    pub surroundings: Option<Surroundings>,
    pub lamps: Vec<Lamp>,
    pub support: Support,
    pub local: Vec<Local>,
    pub objects: Vec<Object>,
    pub render: Render,
    pub composite: CompositeKeys,
    pub output: Output,
}

/// `[plate]`: the photograph the objects go into.
#[derive(Clone, Debug, Serialize)]
pub struct PlateKeys {
    /// A picture, or with `frames` a pattern such as `plate.####.exr`.
    pub file: PathBuf,
    pub frames: Option<Frames>,
    /// Frames a second, which animations play by.
    pub fps: f64,
    /// Which frame of a sequence `file` is; `None` of the pattern and of a single plate.
    pub frame: Option<i64>,
    pub colour: PlateColour,
    pub exposure: ExposureKeys,
    /// Plate value = this × the probe's radiance, where exposures are not known.
    pub relative_exposure: Option<f64>,
}

/// Who says how the plate's numbers stand for light.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum PlateColour {
    /// The file, or its format's rule.
    Auto,
    /// The user, by the name of a colour space.
    Named(String),
    /// The probe's bracket, taken by the same camera, which shows its tone curve.
    Bracket,
}

/// `[support]`: the surface the objects stand on.
#[derive(Clone, Debug, Serialize)]
pub struct Support {
    pub shape: SupportShape,
    pub albedo: Albedo,
}

#[derive(Clone, Debug, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum SupportShape {
    /// A rectangle: metres along its two sides, its centre, the way its top looks.
    Plane {
        size: [f64; 2],
        at: [f64; 3],
        normal: [f64; 3],
    },
    Mesh(PathBuf),
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Albedo {
    /// Solved from plate and light.
    Plate,
    /// The mesh file's own material.
    Mesh,
    Constant([f64; 3]),
}

/// `[[local]]`: another real thing.
#[derive(Clone, Debug, Serialize)]
pub struct Local {
    pub file: PathBuf,
    pub holdout: bool,
    #[serde(flatten)]
    pub motion: Motion,
}

/// `[[object]]`: a thing to insert.
#[derive(Clone, Debug, Serialize)]
pub struct Object {
    pub file: PathBuf,
    /// Metres.
    pub at: [f64; 3],
    /// Degrees about the world's X, then Y, then Z.
    pub rotate: [f64; 3],
    pub scale: f64,
    #[serde(flatten)]
    pub motion: Motion,
}

/// `[render]`: when to stop and how to work.
#[derive(Clone, Debug, Serialize)]
pub struct Render {
    pub stop: StopKeys,
    /// "auto" or a method's name.
    pub method: String,
    pub denoise: DenoiseKeys,
    pub caustics: Caustics,
    /// Whether rough surfaces get back what glTF's formula loses between their microfacets.
    pub multiple_scattering: bool,
}

/// `render.denoise`
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum DenoiseKeys {
    #[default]
    Off,
    /// Where two halves of the samples prove that it lowers the error.
    Auto,
}

/// `[composite]`
#[derive(Clone, Copy, Debug, Serialize)]
pub struct CompositeKeys {
    pub mode: ModeKeys,
    pub grain: Grain,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ModeKeys {
    Auto,
    Additive,
    Ratio,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Grain {
    None,
    Match,
}

/// `[output]`
#[derive(Clone, Debug, Serialize)]
pub struct Output {
    /// Names of the layers to write beside the main picture; `None` is "all".
    pub layers: Option<Vec<String>>,
}

/// What is wrong with a shot file: every problem found, together.
#[derive(Debug, thiserror::Error)]
pub enum ShotFileError {
    #[error("{}: {cause}; name a shot.toml or the folder that holds one", path.display())]
    Unreadable { path: PathBuf, cause: std::io::Error },
    #[error("{}", .0.join("\n"))]
    Problems(Vec<String>),
}

impl ShotFileError {
    /// One sentence for each problem.
    pub fn problems(self) -> Vec<String> {
        match self {
            Self::Problems(problems) => problems,
            unreadable => vec![unreadable.to_string()],
        }
    }
}

impl ShotFile {
    /// Reads a shot file, or the `shot.toml` of a folder.
    pub fn read(path: &Path) -> Result<Self, ShotFileError> {
        let path = if path.is_dir() { path.join("shot.toml") } else { path.to_owned() };
        let read = text::read(&path, MAX_BYTES)
            .map_err(|cause| ShotFileError::Unreadable { path: path.clone(), cause })?;
        // Where the text is wrong there will be no plan that looks at its files: all is told now.
        Self::parse_or(&path, &read, |problems| problems.look_at_files())
    }

    /// Reads the text of a shot file that lies at `path`; no other file is looked at.
    pub fn parse(path: &Path, text: &str) -> Result<Self, ShotFileError> {
        Self::parse_or(path, text, |_| ())
    }

    /// As [`ShotFile::parse`]; `of_wrong_text` may note more problems where there are some.
    fn parse_or(
        path: &Path,
        text: &str,
        of_wrong_text: impl FnOnce(&Problems),
    ) -> Result<Self, ShotFileError> {
        let problems = Problems::new(path, text);
        let (table, syntax) = DeTable::parse_recoverable(text);
        for error in &syntax {
            problems.note(error.span().map_or(0, |span| span.start), error.message());
        }
        if !syntax.is_empty() {
            return Err(ShotFileError::Problems(problems.into_sentences()));
        }
        let folder = path.parent().unwrap_or(Path::new(""));
        let shot = read_root(&Keys::root(&problems, table.get_ref(), ROOT), path, folder);
        match shot {
            Some(shot) if problems.is_empty() => Ok(shot),
            _ => {
                of_wrong_text(&problems);
                Err(ShotFileError::Problems(problems.into_sentences()))
            }
        }
    }

    /// The folder all paths of the shot are relative to.
    pub fn folder(&self) -> &Path {
        self.path.parent().unwrap_or(Path::new(""))
    }
}

/// A text larger than this is no shot file.
const MAX_BYTES: u64 = 1 << 20;

const ROOT: &[&str] = &[
    "plate",
    "camera",
    "pose",
    "probe",
    "surroundings",
    "lamp",
    "support",
    "local",
    "object",
    "render",
    "composite",
    "output",
];

/// Reads every section, so that the problems of all are noted, before it asks whether all are there.
fn read_root(root: &Keys, path: &Path, folder: &Path) -> Option<ShotFile> {
    let section = |key, known, remedy| root.need(key, root.table(key, known), remedy);
    let plate = section("plate", PLATE, "add [plate] with file = \"plate.png\"")
        .and_then(|keys| read_plate(&keys, folder));
    let camera = section("camera", CameraKeys::KEYS, "add [camera] with boards, file or focal_mm")
        .and_then(|keys| CameraKeys::read(&keys, folder));
    let pose = section("pose", PoseSource::KEYS, "add [pose] with tag, board, rectangle or file")
        .and_then(|keys| PoseSource::read(&keys, folder));
    let probe =
        section("probe", ProbeKeys::KEYS, "add [probe] with ball, fisheye, panorama or sky")
            .and_then(|keys| ProbeKeys::read(&keys, folder));
    if let (Some(plate), Some(probe)) = (&plate, &probe) {
        sky::check_scale(root, plate, probe);
    }
    let surroundings = root
        .table("surroundings", Surroundings::KEYS)
        .and_then(|keys| Surroundings::read(&keys, folder));
    let lamps = root.tables("lamp", Lamp::KEYS);
    let lamps = Lamp::read_all(&lamps);
    let support = section("support", SUPPORT, "add [support] with plane = { size = [3.0, 3.0] }")
        .and_then(|keys| read_support(&keys, folder));
    let local = root.tables("local", LOCAL);
    let local = local.iter().filter_map(|keys| read_local(keys, folder, plate.as_ref())).collect();
    let objects = root.tables("object", OBJECT);
    let objects =
        objects.iter().filter_map(|keys| read_object(keys, folder, plate.as_ref())).collect();
    let render = root.table("render", RENDER).map_or_else(
        || {
            Some(Render {
                stop: StopKeys::default(),
                method: "auto".to_owned(),
                denoise: DenoiseKeys::default(),
                caustics: Caustics::default(),
                multiple_scattering: false,
            })
        },
        |keys| read_render(&keys),
    );
    let composite = read_composite(root.table("composite", &["mode", "grain"]).as_ref());
    let layers = root.table("output", &["layers"]).and_then(|keys| read_layers(&keys));
    Some(ShotFile {
        path: path.to_owned(),
        plate: plate?,
        camera: camera?,
        pose: pose?,
        probe: probe?,
        surroundings,
        lamps,
        support: support?,
        local,
        objects,
        render: render?,
        composite,
        output: Output { layers },
    })
}

const PLATE: &[&str] = &["file", "frames", "fps", "colour", "exposure", "relative_exposure"];
/// Film's.
const FPS: f64 = 24.0;

fn read_plate(keys: &Keys, folder: &Path) -> Option<PlateKeys> {
    let file = keys.need("file", keys.text("file"), "name the photograph");
    let frames = keys.text("frames").and_then(|text| match Frames::parse(text) {
        Ok(frames) => Some(frames),
        Err(cause) => {
            keys.problem("frames", &cause);
            None
        }
    });
    if let Some(file) = file {
        match (has_pattern(file), keys.has("frames")) {
            (true, false) => keys.problem(
                "file",
                "is a pattern of numbered frames; add frames = \"1001-1048\" beside it",
            ),
            (false, true) => keys
                .problem("frames", "is given, but file has no #### to put the frame's number in"),
            (true, true) => {
                let each = frames.iter().flat_map(Frames::iter);
                each.for_each(|n| keys.names_file("file", frame_path(&folder.join(file), n)));
            }
            (false, false) => keys.names_file("file", folder.join(file)),
        }
    }
    let fps = keys.positive("fps");
    if fps.is_some() && !keys.has("frames") {
        keys.problem(
            "fps",
            "is given, but there are no frames; give frames, or object.time instead",
        );
    }
    let exposure = ExposureKeys::read(keys, "exposure");
    let relative_exposure = keys.positive("relative_exposure");
    if relative_exposure.is_some() && keys.has("exposure") {
        keys.problem("relative_exposure", "and exposure exclude each other; keep one");
    }
    let colour = match keys.text("colour") {
        None | Some("auto") => PlateColour::Auto,
        Some("bracket") => PlateColour::Bracket,
        Some(name) => {
            if let Err(error) = name.parse::<NamedColour>() {
                keys.problem("colour", &error.to_string());
            }
            PlateColour::Named(name.to_owned())
        }
    };
    let (file, fps) = (folder.join(file?), fps.unwrap_or(FPS));
    Some(PlateKeys { file, frames, fps, frame: None, colour, exposure, relative_exposure })
}

/// Side beyond which the f32 of meshes would lose the shadows of things of a metre, metres.
const LARGEST_PLANE: f64 = 1e4;
const SUPPORT: &[&str] = &["plane", "mesh", "albedo"];

fn read_support(keys: &Keys, folder: &Path) -> Option<Support> {
    let albedo = if keys.is_text("albedo") {
        keys.choice("albedo", &[("plate", Albedo::Plate), ("mesh", Albedo::Mesh)])
    } else if keys.has("albedo") {
        keys.numbers("albedo").map(Albedo::Constant)
    } else {
        Some(Albedo::Plate)
    };
    if let Some(Albedo::Constant(rgb)) = albedo
        && rgb.iter().any(|c| !(0.0..=1.0).contains(c))
    {
        keys.problem("albedo", "a surface reflects between 0 and 1 of the light, per channel");
    }
    let shape = match keys.exactly_one(&["plane", "mesh"])? {
        "mesh" => SupportShape::Mesh(keys.file("mesh", folder)?),
        _ => {
            let plane = keys.table("plane", &["size", "at", "normal"])?;
            let size = plane.positives("size");
            if size.is_some_and(|size: [f64; 2]| size.iter().any(|&side| side > LARGEST_PLANE)) {
                plane.problem("size", "is larger than 10 km; give what the picture shows");
            }
            SupportShape::Plane {
                size: plane.need("size", size, "give its two sides in metres, [3.0, 3.0]")?,
                at: plane.place("at").unwrap_or_default(),
                normal: plane.direction("normal").unwrap_or([0.0, 1.0, 0.0]),
            }
        }
    };
    if albedo == Some(Albedo::Mesh) && matches!(shape, SupportShape::Plane { .. }) {
        keys.problem("albedo", "\"mesh\" needs support.mesh; a plane has no colour of its own");
    }
    Some(Support { shape, albedo: albedo? })
}

const LOCAL: &[&str] = &["file", "holdout", "animation", "time", "start_frame"];

fn read_local(keys: &Keys, folder: &Path, plate: Option<&PlateKeys>) -> Option<Local> {
    let file = keys.need("file", keys.file("file", folder), "name a .glb, .gltf or .obj file");
    let holdout = keys.flag("holdout").unwrap_or(false);
    let motion = Motion::read(keys, plate);
    Some(Local { file: file?, holdout, motion })
}

const OBJECT: &[&str] = &["file", "at", "rotate", "scale", "animation", "time", "start_frame"];

fn read_object(keys: &Keys, folder: &Path, plate: Option<&PlateKeys>) -> Option<Object> {
    let file = keys.need("file", keys.file("file", folder), "name a .glb, .gltf or .obj file");
    let at = keys.place("at").unwrap_or_default();
    let rotate = keys.numbers("rotate").unwrap_or_default();
    let scale = keys.positive("scale").unwrap_or(1.0);
    let motion = Motion::read(keys, plate);
    Some(Object { file: file?, at, rotate, scale, motion })
}

const RENDER: &[&str] =
    &["error", "time", "samples", "method", "denoise", "caustics", "multiple_scattering"];

fn read_render(keys: &Keys) -> Option<Render> {
    let method = keys.choice("method", &METHODS.map(|(name, _)| (name, name)));
    let method = method.unwrap_or("auto").to_owned();
    let denoise = keys.choice("denoise", &[("off", DenoiseKeys::Off), ("auto", DenoiseKeys::Auto)]);
    let caustics = keys.choice("caustics", &[("soft", Caustics::Soft), ("exact", Caustics::Exact)]);
    Some(Render {
        stop: StopKeys::read(keys)?,
        method,
        denoise: denoise.unwrap_or_default(),
        caustics: caustics.unwrap_or_default(),
        multiple_scattering: keys.flag("multiple_scattering").unwrap_or(false),
    })
}

fn read_composite(keys: Option<&Keys>) -> CompositeKeys {
    let modes =
        [("auto", ModeKeys::Auto), ("additive", ModeKeys::Additive), ("ratio", ModeKeys::Ratio)];
    let grains = [("none", Grain::None), ("match", Grain::Match)];
    CompositeKeys {
        mode: keys.and_then(|k| k.choice("mode", &modes)).unwrap_or(ModeKeys::Auto),
        grain: keys.and_then(|k| k.choice("grain", &grains)).unwrap_or(Grain::None),
    }
}

/// The list of layers, or `None` for "all".
fn read_layers(keys: &Keys) -> Option<Vec<String>> {
    let names = keys.texts("layers")?;
    if names == ["all"] {
        return None;
    }
    for name in &names {
        if !crate::composite::LAYERS.contains(name) {
            let sentence = format!(
                "\"{name}\" is no layer; known: all, {}",
                crate::composite::LAYERS.join(", ")
            );
            keys.problem("layers", &sentence);
        }
    }
    Some(names.into_iter().map(str::to_owned).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shot::camera_keys::{Board, CameraSource};
    use crate::shot::probe_keys::{Clipped, ProbeSource};

    const WHOLE: &str = r#"
[plate]
file = "plate.png"
[camera]
boards = "board_*.jpg"
board = { kind = "checkerboard", corners = [9, 6], square_mm = 25 }
[pose]
tag = { photo = "tag.jpg", id = 7, size_mm = 120.0, at = [0.4, 0, 0.2], facing = [0, 1, 0], up = [0, 0, -1] }
[probe]
ball = { photos = "ball_b*.jpg", radius = 0.06, at = [0, 0.06, 0], reflectance = 0.6 }
[support]
plane = { size = [3.0, 3.0] }
"#;

    fn parse(text: &str) -> Result<ShotFile, Vec<String>> {
        ShotFile::parse(Path::new("shots/a/shot.toml"), text).map_err(|error| match error {
            ShotFileError::Problems(problems) => problems,
            other => panic!("{other}"),
        })
    }

    #[test]
    fn defaults_are_those_of_the_format_and_paths_follow_the_file() {
        let shot = parse(WHOLE).expect("the text is right");
        assert_eq!(shot.plate.file, Path::new("shots/a/plate.png"));
        assert!(matches!(&shot.camera.source, CameraSource::Boards { board, .. }
            if *board == Board::Checkerboard { corners: [9, 6], square_mm: 25.0 }));
        assert_eq!(shot.probe.clipped, Clipped::Error);
        assert!(matches!(&shot.probe.source, ProbeSource::Ball(ball)
            if ball.reflectance == [0.6; 3] && ball.camera.is_none() && ball.pose.is_none()));
        assert_eq!(shot.support.albedo, Albedo::Plate);
        assert_eq!(shot.render.stop, StopKeys::Error(0.01));
        assert!(shot.objects.is_empty() && shot.output.layers.is_none());
    }

    #[test]
    fn every_problem_is_told_at_once_with_line_and_key() {
        let text = WHOLE
            .replace("radius = 0.06", "radios = 0.06")
            .replace("size = [3.0, 3.0]", "size = [3.0]")
            .replace("[plate]", "[plaet]")
            + "[render]\ntime = \"soon\"\n[[object]]\nscale = -1\n";
        let problems = parse(&text).expect_err("six things are wrong");
        let expected = [
            "shot.toml:2: plaet: unknown key; did you mean `plate`?",
            "shot.toml:10: probe.ball.radios: unknown key; did you mean `probe.ball.radius`?",
            "shot.toml:12: support.plane.size: expected 2 numbers above 0",
            "object[0].file: is missing",
            "object[0].scale: expected a number above 0",
            "shot.toml:14: render.time: \"soon\" is no time",
        ];
        for sentence in expected {
            assert!(
                problems.iter().any(|problem| problem.contains(sentence)),
                "{sentence:?} is not in {problems:#?}"
            );
        }
        assert_eq!(problems.len(), expected.len(), "a misspelt key is not missing: {problems:#?}");
    }

    #[test]
    fn a_tag_that_its_family_does_not_have_is_refused_in_the_text() {
        let problems = parse(&WHOLE.replace("id = 7", "id = 587")).expect_err("586 is the last");
        assert!(problems[0].contains("pose.tag.id: 36h11 has tags 0 to 586"), "{problems:?}");
        assert!(parse(&WHOLE.replace("id = 7", "id = 30, family = \"16h5\"")).is_err());
        assert!(parse(&WHOLE.replace("id = 7", "id = 586")).is_ok());
    }

    #[test]
    fn broken_toml_is_a_problem_with_a_line() {
        let problems = parse("[plate]\nfile = \n").expect_err("no value");
        assert!(problems[0].contains("shot.toml:2:"), "{problems:?}");
    }

    #[test]
    fn one_of_error_time_and_samples_says_when_to_stop() {
        let stop = |text: &str| parse(&format!("{WHOLE}[render]\n{text}\n"));
        for (text, expected) in [
            ("time = 60", StopKeys::Time(60.0)),
            ("time = \"1.5m\"", StopKeys::Time(90.0)),
            ("error = 0.1", StopKeys::Error(0.1)),
            ("samples = 4", StopKeys::Samples(4)),
        ] {
            assert_eq!(stop(text).expect(text).render.stop, expected);
        }
        for (text, told) in [
            ("time = \"\"", "render.time: \"\" is no time; write"),
            ("time = 0", "render.time: 0 is no time; write"),
            ("error = -1", "render.error: -1 is no share of the plate; write"),
            ("samples = 0", "render.samples: 0 is no number of samples; write"),
            ("error = 0.1\nsamples = 4", "error and samples exclude each other"),
        ] {
            let problems = stop(text).expect_err(text);
            assert!(problems[0].contains(told), "{problems:?}");
        }
    }

    #[test]
    fn places_and_lamps_that_no_world_holds_are_refused() {
        for (text, key) in [
            ("[[lamp]]\nat = [0, 0, 1e300]\nradius = 1\n", "lamp[0].at"),
            ("[[lamp]]\nat = [0, 0, 1]\nradius = 1e300\n", "lamp[0].radius"),
            (
                "[surroundings]\nbox = { min = [-1e300, 0, 0], max = [1, 1, 1] }\n",
                "surroundings.box.min",
            ),
            ("[[object]]\nfile = \"a.obj\"\nat = [nan, 0, 0]\n", "object[0].at"),
            ("[render]\nerror = 5\n", "render.error: 5 is no share"),
        ] {
            let problems = parse(&format!("{WHOLE}{text}")).expect_err("too far");
            assert!(problems[0].contains(key), "{problems:?}");
        }
    }

    #[test]
    fn layers_are_checked_by_name() {
        let shot = parse(&format!("{WHOLE}[output]\nlayers = [\"Z\", \"shadow\"]\n"));
        assert_eq!(
            shot.expect("two layers").output.layers,
            Some(vec!["Z".into(), "shadow".into()])
        );
        assert!(parse(&format!("{WHOLE}[output]\nlayers = [\"depth\"]\n")).is_err());
    }
}
