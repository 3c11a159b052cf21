//! `platelight panorama`: photographs of a light probe → lat-long panorama.

use std::path::{Path, PathBuf};

use glam::{DQuat, DVec3, Vec3};
use serde::Serialize;

use super::outputs::{check_ending, check_outputs};
use super::{CliError, Global, Outcome};
use crate::bracket::{self, Frame, MergeOptions, Radiance, Validity, exposure};
use crate::camera::lens::focal_px_from_35mm;
use crate::camera::{self, Camera, Lens, Pose};
use crate::conventions::{Rgb, luminance};
use crate::photo::tone::{self, ToneCurve};
use crate::photo::{
    self, Encoding, EncodingSource, Format, Image, Photo, Primaries, ReadOptions, Transfer, colour,
    png,
};
use crate::probe::find::{BallImage, Hints, find};
use crate::probe::fisheye::{Fisheye, Projection};
use crate::probe::overlay::overlay;
use crate::probe::photographed;
use crate::probe::unwrap::check_width;
use crate::probe::{Ball, Doubt, Panorama, clipped_regions, file};

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
    photos: Vec<PathBuf>,
    /// The EXR to write
    #[arg(long, short, value_name = "FILE")]
    out: PathBuf,
    #[command(flatten)]
    kind: Kind,
    /// The ball's centre and radius in pixels, if it is not found
    #[arg(long, value_name = "U,V,R", value_delimiter = ',', requires = "ball")]
    hint: Option<Vec<f64>>,
    /// The lens (and pose): camera.json, OpenCV's YAML or COLMAP's cameras.txt
    #[arg(long, value_name = "FILE", conflicts_with = "focal_px", requires = "ball")]
    camera: Option<PathBuf>,
    /// Focal length in pixels [default: the 35-mm equivalent of EXIF or of a merged EXR, right only for uncropped photographs]
    #[arg(long, value_name = "F", requires = "ball")]
    focal_px: Option<f64>,
    /// The photographs are a cut-out of the camera's frame enlarged SCALE times; their pixel (0, 0) is X,Y
    /// of the enlarged frame
    #[arg(
        long,
        value_name = "X,Y,SCALE",
        value_delimiter = ',',
        allow_hyphen_values = true,
        requires = "camera"
    )]
    crop: Option<Vec<f64>>,
    /// Share of light the ball reflects: one number or one for each of R,G,B
    #[arg(long, value_name = "R,G,B", value_delimiter = ',', requires = "ball")]
    reflectance: Option<Vec<f32>>,
    /// The ball's radius in metres; says how far away it stands, no direction depends on it
    #[arg(long, value_name = "M", default_value_t = 0.05, requires = "ball")]
    radius: f64,
    /// The same view without the ball: helps to find it
    #[arg(long, value_name = "FILE", requires = "ball")]
    clean_plate: Option<PathBuf>,
    /// Angle across the fisheye's image circle, degrees
    #[arg(long, value_name = "DEG", default_value_t = 180.0, requires = "fisheye")]
    fov: f64,
    /// The fisheye's image circle in pixels [default: inscribed in the picture]
    #[arg(long, value_name = "U,V,R", value_delimiter = ',', requires = "fisheye")]
    circle: Option<Vec<f64>>,
    /// Turn the panorama about X, then Y, then Z, degrees
    #[arg(long, value_name = "X,Y,Z", value_delimiter = ',', allow_hyphen_values = true)]
    rotation: Option<Vec<f64>>,
    /// Shutter times in seconds, one for each photograph [default: exposures from EXIF]
    #[arg(
        long,
        value_delimiter = ',',
        value_name = "TIMES",
        conflicts_with_all = ["angular", "ball_map", "cube", "lat_long"]
    )]
    times: Option<Vec<String>>,
    /// Texels across; the height is half [default: as fine as the photograph; a lat-long keeps its own]
    #[arg(long, value_name = "N", conflicts_with = "lat_long")]
    width: Option<usize>,
    /// Also write the panorama as a PNG to look at
    #[arg(long, value_name = "PNG")]
    preview: Option<PathBuf>,
    /// Also write the photograph with the found rim as a PNG
    #[arg(long, value_name = "PNG", requires = "ball")]
    overlay: Option<PathBuf>,
    /// Colour space of the photographs, where they do not say it themselves
    #[arg(long, alias = "color", default_value = "auto", value_name = "NAME")]
    colour: String,
}

/// What the photographs show.
#[derive(Debug, clap::Args)]
#[group(required = true, multiple = false)]
struct Kind {
    /// A mirror ball
    #[arg(long)]
    ball: bool,
    /// A fisheye's picture
    #[arg(long, value_enum, value_name = "PROJECTION")]
    fisheye: Option<FisheyeKind>,
    /// Debevec's angular map (-Z in the middle)
    #[arg(long)]
    angular: bool,
    /// An orthographic mirror-ball map, made in that mapping (+Z in the middle)
    #[arg(long)]
    ball_map: bool,
    /// A horizontal cube cross, 4 x 3 faces (-Z in the second)
    #[arg(long)]
    cube: bool,
    /// A lat-long
    #[arg(long)]
    lat_long: bool,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum FisheyeKind {
    Equidistant,
    Equisolid,
    Stereographic,
    Orthographic,
}

/// What came out, for people and machines.
#[derive(Serialize)]
struct Summary {
    out: PathBuf,
    width: usize,
    height: usize,
    ball: Option<BallSummary>,
    /// Share of all directions that was not seen and is filled.
    filled: f64,
    /// Irradiance on a level surface, the panorama's unit.
    irradiance_up: [f32; 3],
    clipped: Vec<ClippedSummary>,
    warnings: Vec<String>,
}

#[derive(Serialize)]
struct BallSummary {
    centre_px: [f64; 2],
    radius_px: f64,
    sigma_px: f64,
    sigma_direction_deg: f64,
    inliers: f64,
    /// `None`: the hint was taken as it is.
    score: Option<f64>,
}

#[derive(Serialize)]
struct ClippedSummary {
    direction: [f64; 3],
    solid_angle_sr: f64,
    flux_at_least: [f32; 3],
    place: String,
}

/// The arguments, judged before anything is read or written.
struct Wishes<'a> {
    args: &'a Args,
    read: ReadOptions,
    rotation: DQuat,
    hint: Option<[f64; 3]>,
    circle: Option<[f64; 3]>,
    crop: Option<[f64; 3]>,
    times_s: Option<Vec<f64>>,
    /// `None`: not given.
    reflectance: Option<Rgb>,
}

impl<'a> Wishes<'a> {
    fn judge(args: &'a Args) -> Result<Self, CliError> {
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

/// A ball or fisheye unwrapped.
struct Photographed {
    panorama: Panorama,
    ball: Option<BallImage>,
    /// The photograph with the rim, if it is wanted.
    overlay: Option<Image<Rgb>>,
}

pub fn run(args: &Args, global: &Global) -> Result<Outcome, CliError> {
    let beside = args.camera.iter().chain(&args.clean_plate);
    let inputs: Vec<&Path> = args.photos.iter().chain(beside).map(PathBuf::as_path).collect();
    let further = [&args.preview, &args.overlay].into_iter().flatten();
    let outputs: Vec<&Path> =
        [&args.out].into_iter().chain(further).map(PathBuf::as_path).collect();
    check_outputs(&inputs, &outputs)?;
    check_ending(&args.out, "exr")?;
    for png in [&args.preview, &args.overlay].into_iter().flatten() {
        check_ending(png, "png")?;
    }
    if args.overlay.is_some() && !args.kind.ball {
        return Err(CliError::wrong("--overlay draws a ball's rim; only --ball has one"));
    }
    let wishes = Wishes::judge(args)?;
    let mut warnings = Vec::new();
    let Photographed { panorama, ball: found, overlay } = match layout(&args.kind) {
        Some(layout) => {
            let [path] = args.photos.as_slice() else {
                return Err(CliError::wrong("a map of directions is one picture, not a bracket"));
            };
            let read = file::read(path, layout, wishes.rotation, args.width, &wishes.read)?;
            warnings.extend(read.remarks);
            warnings.extend(read.negative.map(|n| format!("{}: {n}", path.display())));
            Photographed { panorama: read.panorama, ball: None, overlay: None }
        }
        None => photographed(&wishes, &mut warnings, global)?,
    };
    let panorama = file::in_world_axes(&panorama).into_owned();
    global.go_on()?;
    file::write(&args.out, &panorama)?;
    if let (Some(path), Some(drawn)) = (&args.overlay, &overlay) {
        write_png(path, drawn)?;
    }
    if let Some(path) = &args.preview {
        let shown = tone::automatic_stops(&panorama.radiance);
        write_png(path, &tone::display(&panorama.radiance, shown, ToneCurve::Reinhard))?;
    }
    let summary = summary(args, &panorama, found.as_ref(), warnings);
    for warning in &summary.warnings {
        global.warn(warning);
    }
    global.print(&summary, || text(&summary));
    Ok(Outcome::Done)
}

fn layout(kind: &Kind) -> Option<file::Layout> {
    let layouts = [
        (kind.angular, file::Layout::Angular),
        (kind.ball_map, file::Layout::BallMap),
        (kind.cube, file::Layout::Cube),
        (kind.lat_long, file::Layout::LatLong),
    ];
    layouts.into_iter().find(|(chosen, _)| *chosen).map(|(_, layout)| layout)
}

/// Ball or fisheye: merge, find, unwrap.
fn photographed(
    wishes: &Wishes,
    warnings: &mut Vec<String>,
    global: &Global,
) -> Result<Photographed, CliError> {
    let args = wishes.args;
    let photos: Vec<Photo> =
        args.photos.iter().map(|path| photo::read(path, &wishes.read)).collect::<Result<_, _>>()?;
    warnings.extend(photos.iter().flat_map(Photo::named_remarks));
    global.go_on()?;
    let radiance = radiance(wishes, &photos, warnings)?;
    global.go_on()?;
    let (w, h) = (radiance.mean.width(), radiance.mean.height());
    if let Some(kind) = args.kind.fisheye {
        let lens = fisheye(wishes, kind, w, h)?;
        let panorama = photographed::fisheye(&radiance, &lens, wishes.rotation, args.width)?;
        return Ok(Photographed { panorama, ball: None, overlay: None });
    }
    let camera = ball_camera(wishes, &photos[0], w, h)?;
    let plate = match &args.clean_plate {
        Some(path) => Some(photo::read(path, &wishes.read)?.linear),
        None => None,
    };
    let hints = Hints { circle_px: wishes.hint, clean_plate: plate.as_ref() };
    let found = find(&radiance.mean, &camera.lens, &hints)?;
    let reflectance = wishes.reflectance.unwrap_or(Rgb::ONE);
    let ball = Ball::new(found.centre_of(args.radius, &camera), args.radius, reflectance)?;
    let panorama = photographed::ball(&radiance, &camera, &found, &ball, None, args.width)?;
    warnings.extend(Doubt::about(&found).into_iter().map(|doubt| doubt.sentence("--hint")));
    let wants_overlay = args.overlay.is_some();
    let drawn = wants_overlay.then(|| overlay(&radiance.mean, &camera.lens, &found, 800));
    if wishes.reflectance.is_none() {
        warnings.push(
            "--reflectance is not given: the ball is taken as perfect, and the light comes out \
             too dark by its reflectance (chrome 0.55, good steel 0.6)"
                .into(),
        );
    }
    let panorama = panorama.rotated(wishes.rotation);
    Ok(Photographed { panorama, ball: Some(found), overlay: drawn })
}

/// The photographs as radiance: an EXR or HDR as it is, a bracket or a single photograph merged.
fn radiance(
    wishes: &Wishes,
    photos: &[Photo],
    warnings: &mut Vec<String>,
) -> Result<Radiance, CliError> {
    if let [only] = photos
        && matches!(only.format, Format::Exr | Format::RadianceHdr)
    {
        if wishes.times_s.is_some() {
            return Err(CliError::wrong(format!(
                "--times: {} is one picture of radiance, taken as it is; leave --times out",
                only.path.display()
            )));
        }
        return Ok(bracket::file::from_picture(only)?);
    }
    let exposures = match &wishes.times_s {
        Some(times) => exposure::from_times(photos, times)?,
        // One photograph needs no exposure to have a scale.
        None if photos.len() == 1 => vec![exposure::exposure(&photos[0].facts).unwrap_or(1.0)],
        None => exposure::from_exif(photos)?,
    };
    let frames: Vec<Frame> =
        photos.iter().zip(&exposures).map(|(photo, &exposure)| Frame { photo, exposure }).collect();
    let merged = bracket::merge(&frames, &MergeOptions::default())?;
    let asking = merged.warnings.iter().filter(|warning| warning.asks());
    warnings.extend(asking.map(ToString::to_string));
    Ok(merged.radiance)
}

fn fisheye(wishes: &Wishes, kind: FisheyeKind, w: usize, h: usize) -> Result<Fisheye, CliError> {
    let fov = wishes.args.fov;
    let projection = match kind {
        FisheyeKind::Equidistant => Projection::Equidistant,
        FisheyeKind::Equisolid => Projection::Equisolid,
        FisheyeKind::Stereographic => Projection::Stereographic,
        FisheyeKind::Orthographic => Projection::Orthographic,
    };
    Ok(Fisheye::new(projection, fov, wishes.circle, [w, h])?)
}

/// The camera of the ball's photographs: a file, a focal length, or EXIF.
fn ball_camera(wishes: &Wishes, photo: &Photo, w: usize, h: usize) -> Result<Camera, CliError> {
    let args = wishes.args;
    if let Some(path) = &args.camera {
        let camera = camera::file::read(path)?.camera;
        if let Some([x, y, scale]) = wishes.crop {
            if !camera.holds_cut_out(x, y, scale, w, h) {
                let [wide, high] = [camera.width, camera.height].map(|size| size as f64 * scale);
                let frame = path.display();
                return Err(CliError::wrong(format!(
                    "--crop {x},{y},{scale}: {w} × {h} px from {x}, {y} on do not lie in the frame of {frame}, \
                     {} × {} px, which is {wide:.0} × {high:.0} px at scale {scale}; X,Y is the cut-out's first \
                     pixel in the frame at that scale",
                    camera.width, camera.height
                )));
            }
            return Ok(camera.cropped(x, y, scale, w, h));
        }
        if (camera.width, camera.height) != (w, h) {
            let (cw, ch, path) = (camera.width, camera.height, path.display());
            return Err(CliError::wrong(format!(
                "{path}: the camera is of {cw} × {ch} px, the photographs of {w} × {h} px; calibrate \
                 with photographs of the same size, or say which part of the frame these are (--crop)"
            )));
        }
        return Ok(camera);
    }
    let exif = || focal_px_from_35mm(photo.facts.focal_35mm?, w, h);
    if let Some(given) = args.focal_px.filter(|f| !(f.is_finite() && *f > 0.0)) {
        return Err(CliError::wrong(format!(
            "--focal-px: {given} is not above 0; give focal length in mm / sensor width in mm × \
             picture width in px"
        )));
    }
    let focal = args.focal_px.or_else(exif).filter(|f| f.is_finite() && *f > 0.0);
    let focal = focal.ok_or_else(|| {
        let path = photo.path.display();
        CliError::wrong(format!(
            "{path}: no focal length in its EXIF or header; give --camera camera.json or --focal-px (focal length \
             in mm / sensor width in mm × picture width in px)"
        ))
    })?;
    let lens = Lens::pinhole(focal, w, h);
    let source = if args.focal_px.is_some() { "--focal-px" } else { "EXIF" };
    lens.check_plausible(w, h).map_err(|cause| CliError::wrong(format!("{source}: {cause}")))?;
    Ok(Camera { width: w, height: h, lens, pose: Pose::identity() })
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

fn write_png(path: &Path, shown: &Image<Rgb>) -> Result<(), CliError> {
    let encoding = Encoding {
        transfer: Transfer::Srgb,
        primaries: Primaries::Rec709,
        source: EncodingSource::Named,
    };
    png::write(path, &png::srgb_codes(shown), shown.width(), shown.height(), &encoding)?;
    Ok(())
}

fn summary(
    args: &Args,
    panorama: &Panorama,
    found: Option<&BallImage>,
    mut warnings: Vec<String>,
) -> Summary {
    let regions = clipped_regions(panorama);
    let whole = f64::from(luminance(panorama.mean())) * 4.0 * std::f64::consts::PI;
    for region in &regions {
        let share = f64::from(luminance(region.lower_bound)) / whole;
        if share > 0.01 {
            warnings.push(format!(
                "clipped in every photograph: {region}; at least {:.0} % of all light comes from there; \
                 add a shorter exposure",
                100.0 * share
            ));
        }
    }
    Summary {
        out: args.out.clone(),
        width: panorama.width(),
        height: panorama.height(),
        ball: found.map(|b| BallSummary {
            centre_px: b.centre_px.to_array(),
            radius_px: b.radius_px,
            sigma_px: b.sigma_px,
            sigma_direction_deg: b.rim.sigma_direction_rad().to_degrees(),
            inliers: b.rim.inlier_fraction,
            score: b.score,
        }),
        filled: panorama.share(Validity::Filled),
        irradiance_up: panorama.irradiance(DVec3::Y).to_array(),
        clipped: regions
            .iter()
            .map(|r| ClippedSummary {
                direction: r.direction.to_array(),
                solid_angle_sr: r.solid_angle,
                flux_at_least: r.lower_bound.to_array(),
                place: r.to_string(),
            })
            .collect(),
        warnings,
    }
}

fn text(summary: &Summary) -> String {
    let (w, h) = (summary.width, summary.height);
    let mut lines = vec![format!("{}: {w} × {h} texels", summary.out.display())];
    if let Some(b) = &summary.ball {
        lines.push(format!(
            "  ball at ({:.1}, {:.1}) px, radius {:.1} px, ± {:.2} px: directions ± {:.2}°",
            b.centre_px[0], b.centre_px[1], b.radius_px, b.sigma_px, b.sigma_direction_deg
        ));
    }
    let [r, g, b] = summary.irradiance_up;
    lines.push(format!("  irradiance from above {r:.4} {g:.4} {b:.4} (linear value / exposure)"));
    if summary.filled > 0.0 {
        lines.push(format!(
            "  not seen and filled: {:.1} % of all directions",
            100.0 * summary.filled
        ));
    }
    for region in summary.clipped.iter().take(5) {
        lines.push(format!("  clipped: {}", region.place));
    }
    lines.join("\n")
}
