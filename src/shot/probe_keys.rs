//! `[probe]`, `[surroundings]` and `[[lamp]]` of the shot file: where the light comes from.

use std::path::{Path, PathBuf};

use glam::DVec3;
use serde::Serialize;

use super::camera_keys::{CameraKeys, CameraSource, ExposureKeys, PoseSource};
use super::keys::Keys;
use super::register::RegisterKeys;
use super::sky::SkyKeys;
use crate::probe::axes::Axes;
use crate::probe::layout::Layout;

/// `[probe]`
#[derive(Clone, Debug, Serialize)]
pub struct ProbeKeys {
    pub source: ProbeSource,
    /// How its axes lie in the world; `None`: as its pose or rotation say.
    pub register: Option<RegisterKeys>,
    pub clipped: Clipped,
    pub suns: Suns,
}

#[derive(Clone, Debug, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ProbeSource {
    Ball(Box<Ball>),
    Fisheye(Fisheye),
    Panorama(PanoramaKeys),
    Sky(SkyKeys),
}

/// A mirror ball in an exposure bracket.
#[derive(Clone, Debug, Serialize)]
pub struct Ball {
    /// Pattern that names the bracket's photographs, or one EXR of radiance.
    pub photos: PathBuf,
    /// Exposures of the photographs in the order of their names; empty: EXIF.
    pub exposures: Vec<ExposureKeys>,
    /// Metres.
    pub radius: f64,
    /// Its centre, metres.
    pub at: [f64; 3],
    /// Share of light it reflects, per channel.
    pub reflectance: [f64; 3],
    /// Centre and radius in the photographs, to help the finder.
    pub hint_px: Option<[f64; 3]>,
    /// `None`: the plate's.
    pub camera: Option<CameraSource>,
    pub crop: Option<Crop>,
    /// `None`: the plate's.
    pub pose: Option<PoseSource>,
}

/// The photographs are a cut-out at `scale` × the camera's frame; their pixel (0, 0) is (x, y) there.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Crop {
    pub x: f64,
    pub y: f64,
    pub scale: f64,
}

/// Fisheye photographs of the light.
#[derive(Clone, Debug, Serialize)]
pub struct Fisheye {
    pub photos: PathBuf,
    pub exposures: Vec<ExposureKeys>,
    pub mapping: FisheyeMapping,
    /// Angle across the image circle.
    pub fov_deg: f64,
    /// Centre and radius of the image circle; `None`: inscribed in the picture.
    pub circle_px: Option<[f64; 3]>,
    /// Degrees about the world's X, then Y, then Z; at 0 the lens looks along −Z with +Y up.
    pub rotation: [f64; 3],
    /// Where it stood, metres.
    pub at: [f64; 3],
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum FisheyeMapping {
    Equidistant,
    Equisolid,
}

/// A ready panorama.
#[derive(Clone, Debug, Serialize)]
pub struct PanoramaKeys {
    pub file: PathBuf,
    pub mapping: Layout,
    /// Degrees about the world's X, then Y, then Z.
    pub rotation: [f64; 3],
    /// Where it was taken, metres.
    pub at: [f64; 3],
}

/// What to do with light that is clipped in every exposure.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Clipped {
    Error,
    Accept,
    Recover,
}

/// Whether small bright lights are taken out of the panorama and sampled on their own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Suns {
    Auto,
    Never,
    Always,
}

/// `[surroundings]`: where the light really comes from when it is not far away.
#[derive(Clone, Debug, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Surroundings {
    Box { min: [f64; 3], max: [f64; 3] },
    Mesh(PathBuf),
}

/// `[[lamp]]`: a lamp near the objects.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Lamp {
    /// Its centre, metres.
    pub at: [f64; 3],
    /// Metres.
    pub radius: f64,
}

impl ProbeKeys {
    pub const KEYS: &[&str] =
        &["ball", "fisheye", "panorama", "sky", "register", "clipped", "suns"];

    pub fn read(keys: &Keys, folder: &Path) -> Option<Self> {
        let clipped =
            [("error", Clipped::Error), ("accept", Clipped::Accept), ("recover", Clipped::Recover)];
        let clipped = keys.choice("clipped", &clipped).unwrap_or(Clipped::Error);
        let suns = [("auto", Suns::Auto), ("never", Suns::Never), ("always", Suns::Always)];
        let suns = keys.choice("suns", &suns).unwrap_or(Suns::Auto);
        let register = if keys.has("register") {
            Some(RegisterKeys::read(&keys.table("register", RegisterKeys::KEYS)?)?)
        } else {
            None
        };
        if register.is_some() && keys.has("sky") {
            keys.problem(
                "register",
                "has no meaning beside sky, whose sun stands in the world; take it out",
            );
        }
        let source = match keys.exactly_one(&["ball", "fisheye", "panorama", "sky"])? {
            "ball" => {
                ProbeSource::Ball(Box::new(Ball::read(&keys.table("ball", Ball::KEYS)?, folder)?))
            }
            "fisheye" => {
                let fisheye = keys.table("fisheye", Fisheye::KEYS)?;
                ProbeSource::Fisheye(Fisheye::read(&fisheye, folder)?)
            }
            "panorama" => {
                let panorama = keys.table("panorama", PanoramaKeys::KEYS)?;
                ProbeSource::Panorama(PanoramaKeys::read(&panorama, folder)?)
            }
            _ => ProbeSource::Sky(SkyKeys::read(&keys.table("sky", SkyKeys::KEYS)?)?),
        };
        Some(Self { source, register, clipped, suns })
    }
}

impl Ball {
    const KEYS: &[&str] = &[
        "photos",
        "exposures",
        "radius",
        "at",
        "reflectance",
        "hint_px",
        "camera",
        "crop",
        "pose",
    ];

    fn read(keys: &Keys, folder: &Path) -> Option<Self> {
        let photos =
            keys.need("photos", keys.file("photos", folder), "name the bracket, \"ball_b*.jpg\"");
        let radius =
            keys.need("radius", keys.positive("radius"), "give the ball's radius in metres");
        let at = keys.need("at", keys.place("at"), "give the ball's centre in metres");
        let reflectance = read_reflectance(keys);
        let camera = read_camera(keys, folder);
        let pose = read_pose(keys, folder);
        let crop = keys.table("crop", &["x", "y", "scale"]).and_then(|crop| {
            Some(Crop {
                x: crop.need("x", crop.number("x"), "give the cut-out's left edge")?,
                y: crop.need("y", crop.number("y"), "give the cut-out's upper edge")?,
                scale: crop.positive("scale").unwrap_or(1.0),
            })
        });
        let exposures = ExposureKeys::read_list(keys, "exposures");
        let hint_px = keys.numbers("hint_px");
        Some(Self {
            photos: photos?,
            exposures,
            radius: radius?,
            at: at?,
            reflectance: reflectance?,
            hint_px,
            camera: camera?,
            crop,
            pose: pose?,
        })
    }
}

/// Three channels, or one number for all.
fn read_reflectance(keys: &Keys) -> Option<[f64; 3]> {
    if !keys.has("reflectance") {
        let remedy =
            "photograph a grey card directly and in the ball; polished chrome has about 0.6";
        return keys.need("reflectance", None, remedy);
    }
    let rgb = if keys.is_list("reflectance") {
        keys.positives("reflectance")?
    } else {
        [keys.positive("reflectance")?; 3]
    };
    if rgb.iter().any(|&r| r > 1.0) {
        keys.problem("reflectance", "a ball reflects at most 1 of the light");
        return None;
    }
    Some(rgb)
}

/// `Some(None)` is the plate's camera.
fn read_camera(keys: &Keys, folder: &Path) -> Option<Option<CameraSource>> {
    if !keys.has("camera") {
        return Some(None);
    }
    if !keys.is_text("camera") {
        let table = keys.table("camera", &CameraKeys::KEYS[..6])?;
        return CameraSource::read(&table, folder).map(Some);
    }
    match keys.text("camera")? {
        "plate" => Some(None),
        _ => Some(Some(CameraSource::File(keys.file("camera", folder)?))),
    }
}

/// `Some(None)` is the plate's pose.
fn read_pose(keys: &Keys, folder: &Path) -> Option<Option<PoseSource>> {
    if !keys.has("pose") {
        return Some(None);
    }
    if keys.is_text("pose") {
        return keys.choice("pose", &[("plate", ())]).map(|()| None);
    }
    PoseSource::read(&keys.table("pose", PoseSource::KEYS)?, folder).map(Some)
}

impl Fisheye {
    const KEYS: &[&str] =
        &["photos", "exposures", "mapping", "fov_deg", "circle_px", "rotation", "at"];

    fn read(keys: &Keys, folder: &Path) -> Option<Self> {
        let mappings = [
            ("equidistant", FisheyeMapping::Equidistant),
            ("equisolid", FisheyeMapping::Equisolid),
        ];
        let photos = keys.need("photos", keys.file("photos", folder), "name the photographs");
        let fov_deg = keys.positive("fov_deg").unwrap_or(180.0);
        if fov_deg > 360.0 {
            keys.problem("fov_deg", "a lens sees at most 360°");
        }
        Some(Self {
            photos: photos?,
            exposures: ExposureKeys::read_list(keys, "exposures"),
            mapping: keys.choice("mapping", &mappings).unwrap_or(FisheyeMapping::Equidistant),
            fov_deg,
            circle_px: keys.numbers("circle_px"),
            rotation: keys.numbers("rotation").unwrap_or_default(),
            at: keys.place("at").unwrap_or_default(),
        })
    }
}

impl PanoramaKeys {
    const KEYS: &[&str] = &["file", "mapping", "rotation", "at"];

    fn read(keys: &Keys, folder: &Path) -> Option<Self> {
        let mapping = keys.text("mapping").map(|name| {
            Layout::named(name).map_err(|error| keys.problem("mapping", &error.to_string())).ok()
        });
        let file = keys.need("file", keys.file("file", folder), "name the panorama's file");
        Some(Self {
            file: file?,
            mapping: mapping.flatten().unwrap_or(Layout::LatLong(Axes::OpenExr)),
            rotation: keys.numbers("rotation").unwrap_or_default(),
            at: keys.place("at").unwrap_or_default(),
        })
    }
}

impl Surroundings {
    pub const KEYS: &[&str] = &["box", "mesh"];

    pub fn read(keys: &Keys, folder: &Path) -> Option<Self> {
        if keys.exactly_one(&["box", "mesh"])? == "mesh" {
            return Some(Self::Mesh(keys.file("mesh", folder)?));
        }
        let table = keys.table("box", &["min", "max"])?;
        let min = table.need("min", table.place("min"), "give the lower corner in metres");
        let max = table.need("max", table.place("max"), "give the upper corner in metres");
        let (min, max) = (min?, max?);
        let turned = (0..3).filter(|&axis| min[axis] >= max[axis]);
        let turned: Vec<String> = turned
            .map(|axis| format!("{} ({} and {})", ["x", "y", "z"][axis], min[axis], max[axis]))
            .collect();
        if !turned.is_empty() {
            let axes = turned.join(", ");
            let said = format!(
                "is not below max along {axes}; min is the corner of the smallest x, y and z"
            );
            table.problem("min", &said);
            return None;
        }
        Some(Self::Box { min, max })
    }
}

/// From a grain of light to a floodlit sail, m.
const LAMP_RADII_M: std::ops::RangeInclusive<f64> = 1e-4..=100.0;

impl Lamp {
    pub const KEYS: &[&str] = &["at", "radius"];

    /// All lamps, none of which may have its centre in another.
    pub fn read_all(tables: &[Keys]) -> Vec<Self> {
        let mut lamps: Vec<Self> = Vec::with_capacity(tables.len());
        for keys in tables {
            let Some(lamp) = Self::read(keys) else { continue };
            let apart = |other: &Self| DVec3::from(other.at).distance(lamp.at.into());
            let stands_in = |other: &Self| apart(other) < other.radius.max(lamp.radius);
            if let Some(k) = lamps.iter().position(stands_in) {
                let cause = format!(
                    "is inside lamp[{k}], or that one inside this: the panorama shows one lamp there; \
                     correct one of the places, or take one out"
                );
                keys.problem("at", &cause);
            }
            lamps.push(lamp);
        }
        lamps
    }

    pub fn read(keys: &Keys) -> Option<Self> {
        let at = keys.need("at", keys.place("at"), "give its centre in metres");
        let radius = keys.need("radius", keys.positive("radius"), "give its radius in metres");
        if radius.is_some_and(|radius| !LAMP_RADII_M.contains(&radius)) {
            keys.problem("radius", "is no lamp's: give it in metres, between 0.0001 and 100");
        }
        Some(Self { at: at?, radius: radius? })
    }
}
