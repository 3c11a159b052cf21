//! How a whole picture of directions is laid out, by name.
//!
//! `latlong[:AXES]`, `angular`, `ball`, `cube-cross`, `cube-vertical`, `cube-strip[:FACES]`,
//! `cube-column[:FACES]`, `fisheye-PROJECTION[:DEGREES]`; [`axes`](super::axes) and
//! [`cube`](super::cube) say what the words after the colon mean.

use super::ProbeError;
use super::axes::Axes;
use super::cube::{Cube, CubeFaces, CubeLayout};
use super::fisheye::{Fisheye, Projection};
use super::mapping::{Angular, BallMap, LatLong, Mapping};

/// How a picture of all directions (of a fisheye: of its field) is laid out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Layout {
    LatLong(Axes),
    /// Debevec's angular map; −Z in the middle.
    Angular,
    /// Orthographic mirror-ball map, which is OpenGL's sphere map; +Z in the middle.
    BallMap,
    /// Faces of 90°; −Z in the middle of a cross.
    Cube(CubeLayout, CubeFaces),
    /// A fisheye of this field, degrees, in a square; −Z in the middle.
    Fisheye(Projection, f64),
}

/// The names, each as it is without a word after a colon.
const NAMES: [(&str, Layout); 13] = [
    ("latlong", Layout::LatLong(Axes::OpenExr)),
    ("angular", Layout::Angular),
    ("ball", Layout::BallMap),
    ("sphere", Layout::BallMap),
    ("cube-cross", Layout::Cube(CubeLayout::Cross, CubeFaces::Inside)),
    ("cube", Layout::Cube(CubeLayout::Cross, CubeFaces::Inside)),
    ("cube-vertical", Layout::Cube(CubeLayout::VerticalCross, CubeFaces::Inside)),
    ("cube-strip", Layout::Cube(CubeLayout::Strip, CubeFaces::Inside)),
    ("cube-column", Layout::Cube(CubeLayout::Column, CubeFaces::Inside)),
    ("fisheye-equidistant", Layout::Fisheye(Projection::Equidistant, 180.0)),
    ("fisheye-equisolid", Layout::Fisheye(Projection::Equisolid, 180.0)),
    ("fisheye-stereographic", Layout::Fisheye(Projection::Stereographic, 180.0)),
    ("fisheye-orthographic", Layout::Fisheye(Projection::Orthographic, 180.0)),
];

/// Its name.
impl serde::Serialize for Layout {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&self.name())
    }
}

impl Layout {
    /// The layout of this name.
    ///
    /// # Errors
    /// A name, or a word after its colon, that is none, with those that are.
    pub fn named(text: &str) -> Result<Self, ProbeError> {
        let (name, detail) = text.split_once(':').map_or((text, None), |(n, d)| (n, Some(d)));
        let Some((_, layout)) = NAMES.into_iter().find(|(known, _)| *known == name) else {
            return Err(ProbeError::Name {
                what: "mapping",
                found: text.into(),
                known: NAMES.map(|(name, _)| name).join(", "),
            });
        };
        let Some(detail) = detail else { return Ok(layout) };
        let wrong = |known: &str| ProbeError::Name {
            what: "mapping",
            found: text.into(),
            known: known.into(),
        };
        Ok(match layout {
            Self::LatLong(_) => Self::LatLong(Axes::named(detail)?),
            Self::Cube(cube, _) if !cube.folds() => Self::Cube(cube, cube_faces(detail)?),
            Self::Fisheye(projection, _) => {
                let field = detail.parse().map_err(|_| wrong(&format!("{name}:DEGREES")))?;
                // Its own judgement of the field, before anything is read.
                Fisheye::new(projection, field, None, [64, 64])?;
                Self::Fisheye(projection, field)
            }
            _ => return Err(wrong(name)),
        })
    }

    /// Its name, with the word after the colon where that is not the default.
    pub fn name(self) -> String {
        let plain = |wanted: Self| NAMES.iter().find(|(_, layout)| *layout == wanted);
        match self {
            Self::LatLong(axes) if axes != Axes::default() => format!("latlong:{}", axes.name()),
            Self::Cube(cube, CubeFaces::OpenGl) if !cube.folds() => {
                format!("{}:opengl", Self::Cube(cube, CubeFaces::Inside).name())
            }
            Self::Fisheye(projection, field) => {
                format!("fisheye-{}:{field}", format!("{projection:?}").to_lowercase())
            }
            other => plain(other).map_or_else(|| "latlong".into(), |(name, _)| (*name).into()),
        }
    }

    /// What it shows where, for people.
    pub fn description(self) -> String {
        match self {
            Self::LatLong(axes) => {
                format!("lat-long panorama: {}; texel areas tile the sphere", axes.description())
            }
            Self::Angular => "angular map: -Z in the middle, +Z the rim, +X right, +Y up".into(),
            Self::BallMap => {
                "orthographic mirror-ball map: +Z in the middle, -Z the rim, +X right, +Y up".into()
            }
            Self::Cube(CubeLayout::Cross, _) => {
                "horizontal cube cross: -X -Z +X +Z in the middle row, +Y above and -Y below -Z"
                    .into()
            }
            Self::Cube(CubeLayout::VerticalCross, _) => {
                "vertical cube cross: +Y -Z -Y +Z (upside down) in the middle column, -X and +X \
                 beside -Z"
                    .into()
            }
            Self::Cube(_, faces) => {
                let turned = match faces {
                    CubeFaces::Inside => "as a camera at the centre sees them (OpenEXR's)",
                    CubeFaces::OpenGl => "as OpenGL's cube-map table has them",
                };
                format!("cube faces +X -X +Y -Y +Z -Z, {turned}")
            }
            Self::Fisheye(projection, field) => {
                format!("fisheye, {projection:?}, {field} deg across: -Z in the middle, +Y up")
            }
        }
    }

    /// The mapping of a picture of this size; `None` where the size is not the layout's.
    pub fn mapping(self, (width, height): (usize, usize)) -> Option<Box<dyn Mapping>> {
        if width == 0 || height == 0 {
            return None;
        }
        let square = width == height;
        Some(match self {
            Self::LatLong(_) if width == 2 * height => Box::new(LatLong { width, height }),
            Self::Angular if square => Box::new(Angular { size: width }),
            Self::BallMap if square => Box::new(BallMap { size: width }),
            Self::Cube(layout, faces) => {
                let cube = Cube::new(layout, faces, width / layout.shape().0);
                Box::new(Some(cube).filter(|cube| cube.size() == (width, height))?)
            }
            Self::Fisheye(projection, field) if square => {
                Box::new(Fisheye::new(projection, field, None, [width, height]).ok()?)
            }
            _ => return None,
        })
    }

    /// The shape it wants, for a message.
    pub fn shape(self) -> &'static str {
        match self {
            Self::LatLong(_) => "twice as wide as high",
            Self::Angular | Self::BallMap | Self::Fisheye(..) => "square",
            Self::Cube(CubeLayout::Cross, _) => "a horizontal cube cross (4 faces wide, 3 high)",
            Self::Cube(CubeLayout::VerticalCross, _) => {
                "a vertical cube cross (3 faces wide, 4 high)"
            }
            Self::Cube(CubeLayout::Strip, _) => "a cube strip (6 faces wide, 1 high)",
            Self::Cube(CubeLayout::Column, _) => "a cube column (1 face wide, 6 high)",
        }
    }

    /// Size of the picture whose side is `side`: width of a lat-long, side of a face, of a square.
    pub fn size(self, side: usize) -> (usize, usize) {
        match self {
            Self::LatLong(_) => (side, side / 2),
            Self::Cube(layout, _) => (layout.shape().0 * side, layout.shape().1 * side),
            _ => (side, side),
        }
    }

    /// The side with which it is about as fine as a lat-long of `width` px.
    pub fn side_for(self, width: usize) -> usize {
        match self {
            Self::LatLong(_) | Self::Angular => width,
            Self::BallMap => (width * 2).div_ceil(3),
            Self::Cube(..) => width.div_ceil(4),
            Self::Fisheye(_, field) => ((width as f64 * field / 360.0).ceil() as usize).max(16),
        }
    }

    /// Width of the lat-long that keeps the resolution of its middle.
    pub fn natural_width(self, width: usize) -> usize {
        let texels = match self {
            Self::LatLong(_) | Self::Angular => width,
            Self::BallMap => width * 3 / 2,
            Self::Cube(layout, _) => 4 * width / layout.shape().0,
            Self::Fisheye(_, field) => (width as f64 * 360.0 / field) as usize,
        };
        (texels.clamp(64, 8192) / 2) * 2
    }

    /// Where the axes of a lat-long point; `None` for all else.
    pub fn axes(self) -> Option<Axes> {
        match self {
            Self::LatLong(axes) => Some(axes),
            _ => None,
        }
    }
}

/// How a cube's faces are turned, by name.
///
/// # Errors
/// A name that is none.
pub fn cube_faces(name: &str) -> Result<CubeFaces, ProbeError> {
    match name {
        "openexr" | "inside" => Ok(CubeFaces::Inside),
        "opengl" => Ok(CubeFaces::OpenGl),
        _ => Err(ProbeError::Name {
            what: "turn of a cube's faces",
            found: name.into(),
            known: "openexr (as seen from inside), opengl".into(),
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_go_there_and_back() {
        for text in [
            "latlong",
            "latlong:blender",
            "latlong:debevec",
            "latlong:pbrt-v3",
            "angular",
            "ball",
            "cube-cross",
            "cube-vertical",
            "cube-strip",
            "cube-strip:opengl",
            "cube-column",
            "cube-column:opengl",
            "fisheye-equidistant:180",
            "fisheye-equisolid:220",
            "fisheye-stereographic:180",
            "fisheye-orthographic:150",
        ] {
            assert_eq!(Layout::named(text).unwrap().name(), text);
        }
        assert_eq!(Layout::named("latlong:usd").unwrap(), Layout::LatLong(Axes::OpenExr));
        assert_eq!(Layout::named("sphere").unwrap(), Layout::BallMap);
        for text in [
            "",
            "cubes",
            "latlong:maya",
            "angular:usd",
            "cube-cross:opengl",
            "fisheye-equisolid:x",
            "fisheye-orthographic:200",
            "cube-strip:maya",
        ] {
            assert!(Layout::named(text).is_err(), "{text}");
        }
    }

    #[test]
    fn sizes_fit_their_mappings_and_no_others() {
        for text in [
            "latlong",
            "angular",
            "ball",
            "cube-cross",
            "cube-vertical",
            "cube-strip",
            "cube-column",
        ] {
            let layout = Layout::named(text).unwrap();
            let (width, height) = layout.size(16);
            assert!(layout.mapping((width, height)).is_some(), "{text}");
            assert!(layout.mapping((width + 1, height)).is_none(), "{text}");
            assert!(layout.mapping((0, 0)).is_none(), "{text}");
        }
    }
}
