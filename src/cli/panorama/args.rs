//! What can be asked of `panorama`, and its judgement before anything is read.

use std::path::{Path, PathBuf};

use glam::{DQuat, DVec3, Vec3};

use super::merge::MergeArgs;
use crate::bracket::exposure;
use crate::cli::CliError;
use crate::conventions::Rgb;
use crate::photo::{ReadOptions, colour};
use crate::probe::axes::Axes;
use crate::probe::cube::{CubeFaces, CubeLayout, FACE_NAMES};
use crate::probe::layout::{self, Layout};
use crate::probe::unwrap::check_width;
use crate::probe::vignetting::Vignetting;
use crate::probe::{Ball, ProbeError, file};

/// Turn photographs of a mirror ball or fisheye, or any map of directions, into a panorama
///
/// Several photographs are a bracket and are merged first. A ball is found without help; look at
/// --overlay, and give --hint where it is wrong. Balls cut out by hand may differ in size and place: they are
/// laid on one another by the ball. The panorama's axes are the camera's (it looked
/// along -Z, +Y up) unless --camera holds a pose; --rotation turns them. Its unit is the
/// photographs' linear value divided by their exposure; layers hold variance, validity and coverage.
/// Two balls seen from 90 to 120 degrees apart show what each alone hides: make a panorama of each, and
/// --merge them; they are turned into the first one's axes by what they show.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "\
Examples:
  platelight panorama ball_b*.jpg --ball --camera camera.json -o pano.exr \\
      --preview pano.png
  platelight panorama cut_b*.jpg --ball --camera camera.json \\
      --crop 1260,661,3 -o pano.exr
  platelight panorama ball.jpg --ball --focal-px 1264 --hint 755,549,73 \\
      -o pano.exr
  platelight panorama sky.exr --fisheye equidistant --fov 180 \\
      --rotation 90,0,0 -o pano.exr
  platelight panorama sky_b*.jpg --lens --camera fisheye.json -o pano.exr
  platelight panorama turn_*.exr --stitch --rotation 0,30,0 -o pano.exr
  platelight panorama grace_probe.hdr --angular -o grace.exr
  platelight panorama pano.exr --lat-long --to latlong:blender -o blender.hdr
  platelight panorama pano.exr --lat-long --to cube-faces:opengl -o sky.exr
  platelight panorama px.hdr nx.hdr py.hdr ny.hdr pz.hdr nz.hdr \\
      --cube-faces=opengl -o pano.exr --axes axes.png
  platelight panorama ball_left.exr ball_right.exr --merge -o both.exr
  platelight panorama day_1/balls --ball --camera camera.json -o panoramas \\
      --preview panoramas --overlay rims --skip-existing")]
pub struct Args {
    /// The photographs of one bracket, one picture, the several of --merge, --stitch and --cube-faces, or a
    /// folder: each bracket or map in it becomes a panorama
    #[arg(required = true, value_name = "PHOTO")]
    pub(super) photos: Vec<PathBuf>,
    /// The EXR to write, or Radiance HDR if the name ends in .hdr: light alone, without layers; of a folder the
    /// folder to write to, as with --preview, --overlay, --axes, --irradiance and --sibl
    #[arg(long, short, value_name = "FILE")]
    pub(super) out: PathBuf,
    #[command(flatten)]
    pub(super) kind: Kind,
    /// Photographs of each bracket in a folder [default: told by their exposures]
    #[arg(long, value_name = "N")]
    pub(super) group: Option<usize>,
    /// Of a folder, leave alone what has a panorama already that is newer
    #[arg(long)]
    pub(super) skip_existing: bool,
    #[command(flatten)]
    pub(super) further: Further,
    #[command(flatten)]
    pub(super) merging: MergeArgs,
    /// The ball's centre and radius in pixels, if it is not found
    #[arg(long, value_name = "U,V,R", value_delimiter = ',', requires = "ball")]
    pub(super) hint: Option<Vec<f64>>,
    /// The lens (and pose) of --ball or --lens: camera.json, OpenCV's YAML or COLMAP's cameras.txt
    #[arg(long, value_name = "FILE", conflicts_with = "focal_px")]
    pub(super) camera: Option<PathBuf>,
    /// Focal length in pixels [default: the 35-mm equivalent of EXIF or of a merged EXR, right only for uncropped photographs]
    #[arg(long, value_name = "F", requires = "ball")]
    pub(super) focal_px: Option<f64>,
    /// The photographs are a cut-out of the camera's frame enlarged SCALE times; their pixel (0, 0) is X,Y
    /// of the enlarged frame
    #[arg(
        long,
        value_name = "X,Y,SCALE",
        value_delimiter = ',',
        allow_hyphen_values = true,
        requires = "camera"
    )]
    pub(super) crop: Option<Vec<f64>>,
    /// Share of light the ball reflects: one number or one for each of R,G,B
    #[arg(long, value_name = "R,G,B", value_delimiter = ',', requires = "ball")]
    pub(super) reflectance: Option<Vec<f32>>,
    /// The ball's radius in metres; says how far away it stands, no direction depends on it
    #[arg(long, value_name = "M", default_value_t = RADIUS_M, requires = "ball")]
    pub(super) radius: f64,
    /// The same view without the ball: helps to find it
    #[arg(long, value_name = "FILE", requires = "ball")]
    pub(super) clean_plate: Option<PathBuf>,
    /// Angle across the fisheye's image circle, degrees
    #[arg(long, value_name = "DEG", default_value_t = FOV_DEG, requires = "fisheye")]
    pub(super) fov: f64,
    /// The fisheye's image circle in pixels [default: inscribed in the picture]
    #[arg(long, value_name = "U,V,R", value_delimiter = ',', requires = "fisheye")]
    pub(super) circle: Option<Vec<f64>>,
    /// What the lens of --fisheye or --lens loses towards the rim, to be divided out: A,B,C of
    /// 1 + A r² + B r⁴ + C r⁶ (r is 1 at the image circle, of --lens at half the diagonal), or a text file
    /// with an angle off the axis in degrees and the share of light that arrives on each line
    #[arg(long, value_name = "A,B,C|FILE", allow_hyphen_values = true)]
    pub(super) vignetting: Option<String>,
    /// Turn the panorama about X, then Y, then Z, degrees
    #[arg(long, value_name = "X,Y,Z", value_delimiter = ',', allow_hyphen_values = true)]
    pub(super) rotation: Option<Vec<f64>>,
    /// Shutter times in seconds, one for each photograph [default: exposures from EXIF]
    #[arg(
        long,
        value_delimiter = ',',
        value_name = "TIMES",
        conflicts_with_all = ["angular", "ball_map", "cube", "lat_long", "from", "cube_faces", "merge"]
    )]
    pub(super) times: Option<Vec<String>>,
    /// Texels across; the height is half [default: as fine as the photograph; a lat-long keeps its own]
    #[arg(long, value_name = "N", conflicts_with_all = ["lat_long", "merge"])]
    pub(super) width: Option<usize>,
    /// Also write the panorama as a PNG to look at
    #[arg(long, value_name = "PNG")]
    pub(super) preview: Option<PathBuf>,
    /// Also write the photograph with the found rim as a PNG
    #[arg(long, value_name = "PNG", requires = "ball")]
    pub(super) overlay: Option<PathBuf>,
    /// Fill what was not seen above the horizon with the clear sky that fits the rest, round a sun that is
    /// "found" in the panorama or stands at azimuth and elevation, degrees: the azimuth clockwise from -Z
    #[arg(long, value_name = "found|AZIMUTH,ELEVATION", allow_hyphen_values = true)]
    pub(super) fill_sky: Option<String>,
    /// Colour space of the photographs, where they do not say it themselves
    #[arg(long, alias = "color", default_value = "auto", value_name = "NAME")]
    pub(super) colour: String,
}

/// What is written beside the panorama, and how.
#[derive(Clone, Debug, clap::Args)]
pub(super) struct Further {
    /// How the panorama is laid out: latlong[:AXES] (openexr = usd = mitsuba, blender = cycles = threejs,
    /// debevec = hdrshop, pbrt-v3), angular, ball (= sphere), cube-cross, cube-vertical,
    /// cube-strip[:opengl] (6 x 1), cube-column[:opengl] (1 x 6), cube-faces[:opengl] (six files, named
    /// with _px _nx _py _ny _pz _nz), fisheye-equidistant[:DEGREES], -equisolid, -stereographic or
    /// -orthographic; docs/conventions.md shows what is where
    #[arg(long, value_name = "MAPPING", default_value = "latlong")]
    pub(super) to: String,
    /// Pixels of what --to writes: side of a face or a square, width of a lat-long [default: as fine as the
    /// panorama]
    #[arg(long, value_name = "N")]
    pub(super) size: Option<usize>,
    /// Also write the light on matt surfaces, for each normal: a lat-long EXR of 256 x 128, its unit the
    /// panorama's times sr
    #[arg(long, value_name = "EXR")]
    pub(super) irradiance: Option<PathBuf>,
    /// Also write a Smart IBL set into this folder: background, environment, reflection, icon and .ibl
    #[arg(long, value_name = "DIR")]
    pub(super) sibl: Option<PathBuf>,
    /// Also write what --to writes as a PNG with its axes named on it, to check it in any program
    #[arg(long, value_name = "PNG")]
    pub(super) axes: Option<PathBuf>,
    /// Two more layers in the EXR: quality.Y, pixels of the photograph per degree where it is coarsest,
    /// and solid_angle.Y, sr of one of its pixels; 0 where it shows nothing
    #[arg(long)]
    pub(super) quality: bool,
}

/// What the photographs show.
#[derive(Clone, Debug, clap::Args)]
#[group(required = true, multiple = false)]
pub(super) struct Kind {
    /// A mirror ball
    #[arg(long)]
    pub(super) ball: bool,
    /// A fisheye's picture
    #[arg(long, value_enum, value_name = "PROJECTION")]
    pub(super) fisheye: Option<FisheyeKind>,
    /// A picture through the lens of --camera: any model, Kannala-Brandt fisheyes too
    #[arg(long, requires = "camera")]
    pub(super) lens: bool,
    /// Photographs that overlap, turned about one place: cameras by OpenCV's stitcher, lenses taken as
    /// without distortion; level if the camera was, and which photograph is ahead (-Z) is its choice
    #[arg(long)]
    pub(super) stitch: bool,
    /// Debevec's angular map (-Z in the middle)
    #[arg(long)]
    pub(super) angular: bool,
    /// An orthographic mirror-ball map, made in that mapping (+Z in the middle)
    #[arg(long)]
    pub(super) ball_map: bool,
    /// A horizontal cube cross, 4 x 3 faces (-Z in the second)
    #[arg(long)]
    pub(super) cube: bool,
    /// Six pictures, the faces +X -X +Y -Y +Z -Z of a cube, turned as OpenEXR (seen from inside) or OpenGL
    /// does
    #[arg(
        long,
        value_name = "openexr|opengl",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "openexr"
    )]
    pub(super) cube_faces: Option<String>,
    /// A lat-long
    #[arg(long)]
    pub(super) lat_long: bool,
    /// A map of directions in any mapping that --to knows
    #[arg(long, value_name = "MAPPING")]
    pub(super) from: Option<String>,
    /// Lat-long panoramas of one place, written by this command: merged into one, each direction from the
    /// one that shows it best
    #[arg(long)]
    pub(super) merge: bool,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
pub(super) enum FisheyeKind {
    Equidistant,
    Equisolid,
    Stereographic,
    Orthographic,
}

/// The arguments, judged before anything is read or written.
pub(super) struct Wishes<'a> {
    pub(super) args: &'a Args,
    pub(super) read: ReadOptions,
    pub(super) rotation: DQuat,
    pub(super) hint: Option<[f64; 3]>,
    pub(super) circle: Option<[f64; 3]>,
    pub(super) crop: Option<[f64; 3]>,
    pub(super) times_s: Option<Vec<f64>>,
    /// `None`: not given.
    pub(super) reflectance: Option<Rgb>,
    pub(super) vignetting: Option<Vignetting>,
    pub(super) rotation_deg: [f64; 3],
    pub(super) source: Source,
    pub(super) target: Target,
}

/// What the pictures are.
#[derive(Clone, Copy, Debug)]
pub(super) enum Source {
    /// Of a ball, through a fisheye or a lens: bracketed or not.
    Photographs,
    /// Overlapping ones.
    Overlapping,
    /// One picture of directions.
    Map(Layout),
    /// Six faces of a cube.
    Faces(CubeFaces),
    /// Several panoramas of one place.
    Panoramas,
}

/// What is written.
#[derive(Clone, Copy, Debug)]
pub(super) enum Target {
    One(Layout),
    /// Six files.
    Faces(CubeFaces),
}

impl Target {
    fn named(text: &str) -> Result<Self, ProbeError> {
        Ok(match text.split_once(':') {
            None if text == "cube-faces" => Self::Faces(CubeFaces::Inside),
            Some(("cube-faces", faces)) => Self::Faces(layout::cube_faces(faces)?),
            _ => Self::One(Layout::named(text)?),
        })
    }

    /// The picture that is made: six files are cut out of a strip.
    pub(super) fn layout(self) -> Layout {
        match self {
            Self::One(layout) => layout,
            Self::Faces(faces) => Layout::Cube(CubeLayout::Strip, faces),
        }
    }

    /// The files that are written to `out`.
    pub(super) fn files(self, out: &Path) -> Vec<PathBuf> {
        let Self::Faces(_) = self else { return vec![out.to_owned()] };
        let stem = out.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let ending = out.extension().unwrap_or_default().to_string_lossy().into_owned();
        FACE_NAMES.map(|face| out.with_file_name(format!("{stem}_{face}.{ending}"))).into()
    }
}

/// The ball's radius and the fisheye's angle where they are not given.
const RADIUS_M: f64 = 0.05;
const FOV_DEG: f64 = 180.0;

impl Args {
    /// An option that is given and only means something of a folder.
    pub(super) fn of_folder(&self) -> Option<&'static str> {
        let given = [(self.group.is_some(), "--group"), (self.skip_existing, "--skip-existing")];
        given.into_iter().find(|(given, _)| *given).map(|(_, option)| option)
    }

    /// An option that is given without the kind of probe that it is for, and that kind. (clap does not say
    /// so: `requires` yields where the kind that is given excludes the required one.)
    fn idle(&self) -> Option<(&'static str, &'static str)> {
        let of_ball = [
            (self.hint.is_some(), "--hint"),
            (self.focal_px.is_some(), "--focal-px"),
            (self.reflectance.is_some(), "--reflectance"),
            (self.radius != RADIUS_M, "--radius"),
            (self.clean_plate.is_some(), "--clean-plate"),
            (self.overlay.is_some(), "--overlay"),
        ];
        let of_fisheye = [(self.fov != FOV_DEG, "--fov"), (self.circle.is_some(), "--circle")];
        let given = |options: &[(bool, &'static str)]| {
            options.iter().find(|(given, _)| *given).map(|(_, option)| *option)
        };
        let ball = given(&of_ball).filter(|_| !self.kind.ball).map(|o| (o, "--ball"));
        let fisheye = given(&of_fisheye).filter(|_| self.kind.fisheye.is_none());
        let merging = self.merging.idle().filter(|_| !self.kind.merge);
        ball.or(fisheye.map(|o| (o, "--fisheye"))).or(merging.map(|o| (o, "--merge")))
    }
}

impl<'a> Wishes<'a> {
    pub(super) fn judge(args: &'a Args) -> Result<Self, CliError> {
        if let Some(width) = args.width {
            check_width(width)?;
        }
        let rotation = triple("--rotation", args.rotation.as_deref())?.unwrap_or_default();
        let times =
            args.times.as_deref().map(|times| times.iter().map(|t| exposure::parse_time(t)));
        let reflectance = match args.reflectance.as_deref() {
            Some(&[all]) => Some(Rgb::splat(all)),
            Some(&[r, g, b]) => Some(Vec3::new(r, g, b)),
            Some(_) => return Err(CliError::wrong("--reflectance: give one number or three")),
            None => None,
        };
        if args.kind.ball {
            // Where it stands is not known yet; radius and reflectance are judged alike anywhere.
            Ball::new(DVec3::ZERO, args.radius, reflectance.unwrap_or(Rgb::ONE))?;
        }
        let kind = &args.kind;
        if let Some((option, of)) = args.idle() {
            return Err(CliError::wrong(format!("{option} is for {of}, which is not given")));
        }
        if args.camera.is_some() && !(kind.ball || kind.lens) {
            return Err(CliError::wrong("--camera: is for --ball and --lens; leave it out"));
        }
        if args.vignetting.is_some() && !(kind.fisheye.is_some() || kind.lens) {
            return Err(CliError::wrong("--vignetting: is for --fisheye and --lens; leave it out"));
        }
        if args.further.quality && kind.stitch {
            return Err(CliError::wrong(
                "--quality: is of one picture; leave it out with --stitch",
            ));
        }
        let target = Target::named(&args.further.to)
            .map_err(|error| CliError::wrong(format!("--to: {error}")))?;
        Ok(Self {
            args,
            rotation_deg: rotation,
            source: source(kind)?,
            target,
            vignetting: args.vignetting.as_deref().map(vignetting).transpose()?,
            read: ReadOptions { colour: colour::named(&args.colour)?, ..ReadOptions::default() },
            rotation: file::rotation_xyz_deg(rotation),
            hint: triple("--hint", args.hint.as_deref())?,
            circle: triple("--circle", args.circle.as_deref())?,
            crop: crop(args)?,
            times_s: times.map(Iterator::collect).transpose()?,
            reflectance,
        })
    }
}

fn source(kind: &Kind) -> Result<Source, CliError> {
    if kind.stitch {
        return Ok(Source::Overlapping);
    }
    let wrong = |option: &str, error: ProbeError| CliError::wrong(format!("{option}: {error}"));
    if let Some(faces) = &kind.cube_faces {
        let faces = layout::cube_faces(faces).map_err(|error| wrong("--cube-faces", error))?;
        return Ok(Source::Faces(faces));
    }
    if let Some(name) = &kind.from {
        return Ok(Source::Map(Layout::named(name).map_err(|error| wrong("--from", error))?));
    }
    if kind.merge {
        return Ok(Source::Panoramas);
    }
    let maps = [
        (kind.angular, Layout::Angular),
        (kind.ball_map, Layout::BallMap),
        (kind.cube, Layout::Cube(CubeLayout::Cross, CubeFaces::Inside)),
        (kind.lat_long, Layout::LatLong(Axes::OpenExr)),
    ];
    let map = maps.into_iter().find(|(chosen, _)| *chosen);
    Ok(map.map_or(Source::Photographs, |(_, layout)| Source::Map(layout)))
}

/// Three coefficients, or the table of a file.
fn vignetting(text: &str) -> Result<Vignetting, CliError> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|v| v.trim().parse()).collect();
    let found = match numbers.as_deref() {
        Ok(&[a, b, c]) => Vignetting::polynomial([a, b, c]),
        Ok(_) => {
            return Err(CliError::wrong(format!(
                "--vignetting {text}: give three numbers A,B,C, or a file"
            )));
        }
        Err(_) => Vignetting::read(Path::new(text)),
    };
    found.map_err(|error| CliError::wrong(format!("--vignetting: {error}")))
}

/// The place and scale of a cut-out.
fn crop(args: &Args) -> Result<Option<[f64; 3]>, CliError> {
    match triple("--crop", args.crop.as_deref())? {
        Some([.., scale]) if scale <= 0.0 => {
            Err(CliError::wrong(format!("--crop: {scale} is no scale; the frame itself has 1")))
        }
        crop => Ok(crop),
    }
}

/// The three numbers of an option, if it was given.
fn triple(option: &str, values: Option<&[f64]>) -> Result<Option<[f64; 3]>, CliError> {
    let Some(values) = values else { return Ok(None) };
    let three = values.try_into().map_err(|_| {
        CliError::wrong(format!("{option}: {} numbers were given, three are needed", values.len()))
    })?;
    let finite = |three: &[f64; 3]| three.iter().all(|v| v.is_finite());
    let three = Some(three).filter(finite);
    let wrong = || CliError::wrong(format!("{option}: {values:?} are not three finite numbers"));
    three.ok_or_else(wrong).map(Some)
}
