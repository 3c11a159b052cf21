//! What can be asked of `panorama`, and its judgement before anything is read.

use std::path::PathBuf;

use glam::{DQuat, DVec3, Vec3};

use crate::bracket::exposure;
use crate::cli::CliError;
use crate::conventions::Rgb;
use crate::photo::{ReadOptions, colour};
use crate::probe::axes::Axes;
use crate::probe::cube::{CubeFaces, CubeLayout};
use crate::probe::layout::Layout;
use crate::probe::unwrap::check_width;
use crate::probe::{Ball, file};

/// Turn photographs of a mirror ball or fisheye, or any map of directions, into a lat-long panorama
///
/// Several photographs are a bracket and are merged first. A ball is found without help; look at
/// --overlay, and give --hint where it is wrong. The panorama's axes are the camera's (it looked
/// along -Z, +Y up) unless --camera holds a pose; --rotation turns them. Its unit is the
/// photographs' linear value divided by their exposure; layers hold variance, validity and coverage.
#[derive(Debug, clap::Args)]
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
  platelight panorama grace_probe.hdr --angular -o grace.exr")]
pub struct Args {
    /// The photographs of one bracket, or one picture
    #[arg(required = true, value_name = "PHOTO")]
    pub(super) photos: Vec<PathBuf>,
    /// The EXR to write
    #[arg(long, short, value_name = "FILE")]
    pub(super) out: PathBuf,
    #[command(flatten)]
    pub(super) kind: Kind,
    /// The ball's centre and radius in pixels, if it is not found
    #[arg(long, value_name = "U,V,R", value_delimiter = ',', requires = "ball")]
    pub(super) hint: Option<Vec<f64>>,
    /// The lens (and pose): camera.json, OpenCV's YAML or COLMAP's cameras.txt
    #[arg(long, value_name = "FILE", conflicts_with = "focal_px", requires = "ball")]
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
    #[arg(long, value_name = "M", default_value_t = 0.05, requires = "ball")]
    pub(super) radius: f64,
    /// The same view without the ball: helps to find it
    #[arg(long, value_name = "FILE", requires = "ball")]
    pub(super) clean_plate: Option<PathBuf>,
    /// Angle across the fisheye's image circle, degrees
    #[arg(long, value_name = "DEG", default_value_t = 180.0, requires = "fisheye")]
    pub(super) fov: f64,
    /// The fisheye's image circle in pixels [default: inscribed in the picture]
    #[arg(long, value_name = "U,V,R", value_delimiter = ',', requires = "fisheye")]
    pub(super) circle: Option<Vec<f64>>,
    /// Turn the panorama about X, then Y, then Z, degrees
    #[arg(long, value_name = "X,Y,Z", value_delimiter = ',', allow_hyphen_values = true)]
    pub(super) rotation: Option<Vec<f64>>,
    /// Shutter times in seconds, one for each photograph [default: exposures from EXIF]
    #[arg(
        long,
        value_delimiter = ',',
        value_name = "TIMES",
        conflicts_with_all = ["angular", "ball_map", "cube", "lat_long"]
    )]
    pub(super) times: Option<Vec<String>>,
    /// Texels across; the height is half [default: as fine as the photograph; a lat-long keeps its own]
    #[arg(long, value_name = "N", conflicts_with = "lat_long")]
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

/// What the photographs show.
#[derive(Debug, clap::Args)]
#[group(required = true, multiple = false)]
pub(super) struct Kind {
    /// A mirror ball
    #[arg(long)]
    pub(super) ball: bool,
    /// A fisheye's picture
    #[arg(long, value_enum, value_name = "PROJECTION")]
    pub(super) fisheye: Option<FisheyeKind>,
    /// Debevec's angular map (-Z in the middle)
    #[arg(long)]
    pub(super) angular: bool,
    /// An orthographic mirror-ball map, made in that mapping (+Z in the middle)
    #[arg(long)]
    pub(super) ball_map: bool,
    /// A horizontal cube cross, 4 x 3 faces (-Z in the second)
    #[arg(long)]
    pub(super) cube: bool,
    /// A lat-long
    #[arg(long)]
    pub(super) lat_long: bool,
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
        Ok(Self {
            args,
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

pub(super) fn layout(kind: &Kind) -> Option<Layout> {
    let layouts = [
        (kind.angular, Layout::Angular),
        (kind.ball_map, Layout::BallMap),
        (kind.cube, Layout::Cube(CubeLayout::Cross, CubeFaces::Inside)),
        (kind.lat_long, Layout::LatLong(Axes::OpenExr)),
    ];
    layouts.into_iter().find(|(chosen, _)| *chosen).map(|(_, layout)| layout)
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
