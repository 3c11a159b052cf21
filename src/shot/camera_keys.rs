//! `[camera]` and `[pose]` of the shot file: where lens and place of a camera come from.

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::keys::Keys;

/// `[camera]`: the lens.
#[derive(Clone, Debug, Serialize)]
pub struct CameraKeys {
    pub source: CameraSource,
    /// False if the lens's distortion was taken out of the plate before.
    pub plate_shows_lens: bool,
}

/// Where the intrinsics come from.
#[derive(Clone, Debug, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum CameraSource {
    /// Photographs of a board; the pattern may name several.
    Boards { photos: PathBuf, board: Board },
    /// camera.json or an interchange format.
    File(PathBuf),
    /// Given focal length; `sensor_mm` is the width of the sensor (36 if not given).
    Focal { focal_mm: f64, sensor_mm: Option<f64> },
    /// Focal length from EXIF, sensor width given.
    Exif { sensor_mm: f64 },
}

/// A calibration board.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "lowercase")]
pub enum Board {
    /// `corners`: inner corners across and down.
    Checkerboard { corners: [u32; 2], square_mm: f64 },
    /// `corners`: inner corners across and down.
    Charuco { corners: [u32; 2], square_mm: f64, marker_mm: f64, dictionary: String },
    /// `tags`: tags across and down; `spacing`: gap between tags ÷ tag size.
    AprilGrid { tags: [u32; 2], tag_mm: f64, spacing: f64 },
}

/// Where the camera stood.
#[derive(Clone, Debug, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum PoseSource {
    /// One or more tags, each in a photograph from the camera's place.
    Tags(Vec<TagPose>),
    Board(BoardPose),
    Rectangle(RectanglePose),
    /// camera.json with a pose.
    File(PathBuf),
}

/// Where a printed thing lies in the world.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Placing {
    /// Its centre, metres.
    pub at: [f64; 3],
    /// Where its printed side looks.
    pub facing: [f64; 3],
    /// The print's upward direction.
    pub up: [f64; 3],
}

#[derive(Clone, Debug, Serialize)]
pub struct TagPose {
    pub photo: PathBuf,
    /// AprilTag family, "36h11".
    pub family: String,
    pub id: u32,
    /// Outer edge of the black border.
    pub size_mm: f64,
    pub placing: Placing,
}

#[derive(Clone, Debug, Serialize)]
pub struct BoardPose {
    pub photo: PathBuf,
    /// `None`: the board of `[camera]`.
    pub board: Option<Board>,
    pub placing: Placing,
}

#[derive(Clone, Debug, Serialize)]
pub struct RectanglePose {
    /// Upper left, upper right, lower right, lower left as seen from the facing side.
    pub corners_px: [[f64; 2]; 4],
    /// Width and height, metres.
    pub size: [f64; 2],
    pub placing: Placing,
}

/// An exposure as far as the shot file gives it; the rest comes from EXIF.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct ExposureKeys {
    pub time_s: Option<f64>,
    pub f_number: Option<f64>,
    pub iso: Option<f64>,
}

impl ExposureKeys {
    const KEYS: &[&str] = &["time_s", "f_number", "iso"];

    /// The table `key`, or nothing given.
    pub fn read(keys: &Keys, key: &'static str) -> Self {
        keys.table(key, Self::KEYS).map_or(Self::default(), |table| Self::fields(&table))
    }

    /// A list of tables `key`.
    pub fn read_list(keys: &Keys, key: &'static str) -> Vec<Self> {
        keys.tables(key, Self::KEYS).iter().map(Self::fields).collect()
    }

    fn fields(table: &Keys) -> Self {
        Self {
            time_s: table.positive("time_s"),
            f_number: table.positive("f_number"),
            iso: table.positive("iso"),
        }
    }
}

impl CameraKeys {
    pub const KEYS: &[&str] =
        &["boards", "board", "file", "focal_mm", "sensor_mm", "exif_sensor_mm", "lens"];

    pub fn read(keys: &Keys, folder: &Path) -> Option<Self> {
        let lens = keys.choice("lens", &[("distorted", true), ("undistorted", false)]);
        let source = CameraSource::read(keys, folder);
        Some(Self { source: source?, plate_shows_lens: lens.unwrap_or(true) })
    }
}

impl CameraSource {
    /// Reads `boards | file | focal_mm | exif_sensor_mm` of a table opened with [`CameraKeys::KEYS`].
    pub fn read(keys: &Keys, folder: &Path) -> Option<Self> {
        let one = keys.exactly_one(&["boards", "file", "focal_mm", "exif_sensor_mm"])?;
        if one != "boards" && keys.has("board") {
            keys.problem("board", &format!("has no meaning beside {one}; take it out"));
        }
        if one != "focal_mm" && keys.has("sensor_mm") {
            keys.problem("sensor_mm", &format!("has no meaning beside {one}; take it out"));
        }
        match one {
            "boards" => {
                let board = keys.table("board", Board::KEYS);
                let board = keys.need("board", board, "describe the board in the photographs");
                let board = board.and_then(|board| Board::read(&board));
                let photos = keys.file("boards", folder);
                Some(Self::Boards { photos: photos?, board: board? })
            }
            "file" => Some(Self::File(keys.file("file", folder)?)),
            "focal_mm" => Some(Self::Focal {
                focal_mm: keys.positive("focal_mm")?,
                sensor_mm: keys.positive("sensor_mm"),
            }),
            _ => Some(Self::Exif { sensor_mm: keys.positive("exif_sensor_mm")? }),
        }
    }
}

impl Board {
    const KEYS: &[&str] =
        &["kind", "corners", "square_mm", "marker_mm", "dictionary", "tags", "tag_mm", "spacing"];

    fn read(keys: &Keys) -> Option<Self> {
        let kinds = [("checkerboard", 0), ("charuco", 1), ("aprilgrid", 2)];
        let kind =
            keys.need("kind", keys.choice("kind", &kinds), "checkerboard, charuco or aprilgrid");
        let used: &[&str] = match kind? {
            0 => &["kind", "corners", "square_mm"],
            1 => &["kind", "corners", "square_mm", "marker_mm", "dictionary"],
            _ => &["kind", "tags", "tag_mm", "spacing"],
        };
        for key in Self::KEYS {
            if keys.has(key) && !used.contains(key) {
                keys.problem(
                    key,
                    &format!("has no meaning for this kind; it uses {}", used.join(", ")),
                );
            }
        }
        if kind == Some(2) {
            let tags = grid(keys, "tags", 1, "count the tags across and down");
            let tag_mm =
                keys.need("tag_mm", keys.positive("tag_mm"), "measure a tag's black border");
            let spacing =
                keys.need("spacing", keys.positive("spacing"), "gap ÷ tag size, often 0.3");
            return Some(Self::AprilGrid { tags: tags?, tag_mm: tag_mm?, spacing: spacing? });
        }
        let corners = grid(keys, "corners", 2, "count the inner corners across and down");
        let square = keys.need("square_mm", keys.positive("square_mm"), "measure one square");
        if kind == Some(0) {
            return Some(Self::Checkerboard { corners: corners?, square_mm: square? });
        }
        let marker = keys.need("marker_mm", keys.positive("marker_mm"), "measure one marker");
        if let (Some(square), Some(marker)) = (square, marker)
            && marker >= square
        {
            keys.problem("marker_mm", "is not smaller than square_mm; are the two swapped?");
        }
        let dictionary = keys.text("dictionary").unwrap_or("4x4_50").to_owned();
        Some(Self::Charuco {
            corners: corners?,
            square_mm: square?,
            marker_mm: marker?,
            dictionary,
        })
    }
}

/// Two counts from `least` to 1000.
fn grid(keys: &Keys, key: &'static str, least: u32, remedy: &str) -> Option<[u32; 2]> {
    let counts = keys.need(key, keys.counts::<2>(key), remedy)?;
    if counts.iter().any(|n| !(least..=1000).contains(n)) {
        keys.problem(key, &format!("both counts lie between {least} and 1000; {remedy}"));
        return None;
    }
    Some(counts)
}

impl PoseSource {
    pub const KEYS: &[&str] = &["tag", "tags", "board", "rectangle", "vanishing", "file"];

    pub fn read(keys: &Keys, folder: &Path) -> Option<Self> {
        match keys.exactly_one(Self::KEYS)? {
            "tag" => {
                let tag = keys.table("tag", TagPose::KEYS)?;
                Some(Self::Tags(vec![TagPose::read(&tag, folder)?]))
            }
            "tags" => {
                let tables = keys.tables("tags", TagPose::KEYS);
                if tables.is_empty() {
                    keys.problem("tags", "is empty; describe at least one tag");
                }
                let tags: Vec<Option<TagPose>> =
                    tables.iter().map(|tag| TagPose::read(tag, folder)).collect();
                tags.into_iter().collect::<Option<Vec<_>>>().map(Self::Tags)
            }
            "board" => {
                let board = keys.table("board", BoardPose::KEYS)?;
                BoardPose::read(&board, folder).map(Self::Board)
            }
            "rectangle" => {
                let rectangle = keys.table("rectangle", RectanglePose::KEYS)?;
                RectanglePose::read(&rectangle).map(Self::Rectangle)
            }
            "file" => Some(Self::File(keys.file("file", folder)?)),
            _ => {
                keys.problem(
                    "vanishing",
                    "this version cannot find a pose from vanishing points or edges; mark the four \
                     corners of a rectangle of known size that the plate shows (a door, a tile, a sheet \
                     of paper): rectangle = { corners_px = [[u, v], …], size = [width, height], at = […] }",
                );
                None
            }
        }
    }
}

impl Placing {
    /// Reads `at`, `facing`, `up`.
    fn read(keys: &Keys, what_is_at: &str) -> Option<Self> {
        let at = keys.need("at", keys.place("at"), &format!("give {what_is_at} in metres"));
        let facing = keys.direction("facing");
        let facing = keys.need("facing", facing, "a print that lies on the floor faces [0, 1, 0]");
        let up = keys.need("up", keys.direction("up"), "say where the print's upper edge points");
        if let (Some(facing), Some(up)) = (facing, up) {
            let (facing, up) = (glam::DVec3::from(facing), glam::DVec3::from(up));
            // Within 6° of each other the print's turn about its normal is anyone's guess.
            if facing.normalize().dot(up.normalize()).abs() > 0.995 {
                keys.problem("up", "points the same way as facing; up lies in the print's plane");
            }
        }
        Some(Self { at: at?, facing: facing?, up: up? })
    }
}

impl TagPose {
    const KEYS: &[&str] = &["photo", "family", "id", "size_mm", "at", "facing", "up"];

    fn read(keys: &Keys, folder: &Path) -> Option<Self> {
        let photo = keys.need(
            "photo",
            keys.file("photo", folder),
            "name the photograph that shows the tag",
        );
        let family = keys.choice("family", &FAMILIES.map(|family| (family.0, family)));
        let (family, tags) = family.unwrap_or(FAMILIES[0]);
        let id = keys.need("id", keys.count("id"), "give the tag's number");
        if let Some(id) = id.filter(|&id| id >= tags) {
            keys.problem("id", &format!("{family} has tags 0 to {}, not {id}", tags - 1));
        }
        let size = keys.need("size_mm", keys.positive("size_mm"), "measure the black border");
        let placing = Placing::read(keys, "the centre of the black square");
        Some(Self {
            photo: photo?,
            family: family.to_owned(),
            id: id?,
            size_mm: size?,
            placing: placing?,
        })
    }
}

/// AprilTag families that can be detected, and how many tags each has; the first is the default.
pub(super) const FAMILIES: [(&str, u32); 4] =
    [("36h11", 587), ("36h10", 2320), ("25h9", 35), ("16h5", 30)];

impl BoardPose {
    const KEYS: &[&str] = &[
        "photo",
        "at",
        "facing",
        "up",
        "kind",
        "corners",
        "square_mm",
        "marker_mm",
        "dictionary",
        "tags",
        "tag_mm",
        "spacing",
    ];

    fn read(keys: &Keys, folder: &Path) -> Option<Self> {
        let photo = keys.need(
            "photo",
            keys.file("photo", folder),
            "name the photograph that shows the board",
        );
        let own = Self::KEYS[4..].iter().any(|key| keys.has(key));
        let board = if own { Some(read_own_board(keys)?) } else { None };
        let placing = Placing::read(keys, "the centre of the inner-corner grid");
        Some(Self { photo: photo?, board, placing: placing? })
    }
}

/// A board described inside the pose: a checkerboard unless `kind` says otherwise.
fn read_own_board(keys: &Keys) -> Option<Board> {
    if keys.has("kind") {
        return Board::read(keys);
    }
    let corners = grid(keys, "corners", 2, "count the inner corners across and down");
    let square = keys.need("square_mm", keys.positive("square_mm"), "measure one square");
    Some(Board::Checkerboard { corners: corners?, square_mm: square? })
}

impl RectanglePose {
    const KEYS: &[&str] = &["corners_px", "size", "at", "facing", "up"];

    fn read(keys: &Keys) -> Option<Self> {
        let corners = keys.need(
            "corners_px",
            keys.points("corners_px"),
            "give upper left, upper right, lower right, lower left",
        );
        let size = keys.need("size", keys.positives("size"), "give width and height in metres");
        let at = keys.need("at", keys.place("at"), "give its centre in metres");
        let placing = Placing {
            at: at?,
            facing: keys.direction("facing").unwrap_or([0.0, 1.0, 0.0]),
            up: keys.direction("up").unwrap_or([0.0, 0.0, -1.0]),
        };
        Some(Self { corners_px: corners?, size: size?, placing })
    }
}
