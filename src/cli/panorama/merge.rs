//! `panorama --merge`: several panoramas of one place → one.

use std::path::{Path, PathBuf};

use glam::{DVec2, EulerRot};
use serde::Serialize;

use super::args::{Args, Wishes};
use super::photographed::{Photographed, Seen};
use crate::cli::outputs::refuse_repeated;
use crate::cli::{CliError, Global};
use crate::conventions::{Rgb, lat_long_direction};
use crate::probe::combine::{self, CombineError, Equalise, Given, Options, Unseen};
use crate::probe::register::{
    Content, Handedness, Match, RegisterError, Registration, by_content, from_matches,
};
use crate::probe::{Panorama, View};

/// How panoramas are merged.
#[derive(Clone, Debug, clap::Args)]
pub(in crate::cli) struct MergeArgs {
    /// How --merge turns the other panoramas into the first one's axes
    #[arg(long, value_enum, default_value = "content", value_name = "HOW", requires = "merge")]
    register: How,
    /// The same thing in both panoramas that --merge takes: its texel in the first, then in the second; three
    /// or more instead of what they show
    #[arg(long = "match", value_name = "U,V,U,V", value_delimiter = ',', requires = "merge")]
    matches: Vec<f64>,
    /// What --merge does with directions that no panorama shows
    #[arg(long, value_enum, default_value = "around", value_name = "HOW", requires = "merge")]
    unseen: FillHow,
    /// Half-angle of the cone towards its own camera that each ball leaves to the other panoramas, degrees
    #[arg(long, value_name = "DEG", default_value_t = 12.0, requires = "merge")]
    photographer: f64,
    /// Bring each colour channel of the panoramas together by itself, not brightness alone
    #[arg(long, requires = "merge")]
    balance: bool,
    /// Refuse to merge panoramas whose brightness differs by more than this
    #[arg(long, value_name = "STOPS", default_value_t = 2.0, requires = "merge")]
    most_stops: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum How {
    /// By what they show, in any rotation
    Content,
    /// They are in one set of axes already
    None,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum FillHow {
    /// Filled from around
    Around,
    /// Black, coverage 0
    Black,
}

/// What was merged, for people and machines.
#[derive(Serialize)]
pub(super) struct Merged {
    views: Vec<ViewSummary>,
    /// Shares of all directions that no panorama shows, one, two or more.
    seen_by: [f64; 3],
    /// Compact lights seen by several, each taken from one.
    lights: usize,
}

#[derive(Serialize)]
struct ViewSummary {
    file: PathBuf,
    /// About X, then Y, then Z, as --rotation has them; zero for the first.
    rotation_deg: [f64; 3],
    /// Standard error of the rotation; `None` if it was not measured.
    sigma_deg: Option<f64>,
    /// How like the panorama before it is where both see; of registering by content.
    correlation: Option<f64>,
    /// How far things stand aside because the probes stood apart, degrees; of registering by content.
    parallax_deg: Option<f64>,
    /// What its light was multiplied with.
    gain: [f32; 3],
    /// Median deviation of the ratio of single texels from that gain, relative.
    gain_scatter: f64,
    /// Share of the merged panorama that is its.
    share: f64,
    /// Solid angle left to others: the cone towards its camera, and people and stands beyond that.
    cone_sr: f64,
    people_sr: f64,
}

impl MergeArgs {
    /// An option that is given, if any.
    pub(super) fn idle(&self) -> Option<&'static str> {
        let given = [
            (self.register != How::Content, "--register"),
            (!self.matches.is_empty(), "--match"),
            (self.unseen != FillHow::Around, "--unseen"),
            (self.photographer != 12.0, "--photographer"),
            (self.balance, "--balance"),
            (self.most_stops != 2.0, "--most-stops"),
        ];
        given.into_iter().find(|(given, _)| *given).map(|(_, option)| option)
    }
}

/// How a panorama was turned.
struct Turned {
    registration: Registration,
    content: Option<Content>,
    measured: bool,
}

/// The panoramas of `wishes`, turned and merged.
pub(super) fn merge(
    wishes: &Wishes,
    warnings: &mut Vec<String>,
    global: &Global,
) -> Result<(Photographed, Merged), CliError> {
    let args = wishes.args;
    let options = options(&args.merging)?;
    refuse_repeated(&args.photos)?;
    if args.photos.len() < 2 {
        return Err(CliError::wrong(format!("--merge: {}", CombineError::Few)));
    }
    let mut views = Vec::new();
    for path in &args.photos {
        let (view, remarks) = View::read(path, &wishes.read)?;
        warnings.extend(remarks);
        views.push(view);
        global.go_on()?;
    }
    let mut turned = vec![Turned::not()];
    for k in 1..views.len() {
        let found = match args.merging.matches.as_slice() {
            [] => by_what_they_show(args, &views, k)?,
            texels if views.len() == 2 => by_matches(texels, &views)?,
            _ => {
                let remedy = "is for two panoramas; merge the third into the result";
                return Err(CliError::wrong(format!("--match: {remedy}")));
            }
        };
        views[k] = views[k].clone().rotated(found.registration.rotation);
        turned.push(found);
        global.go_on()?;
    }
    let merged = combine::combine(&views, &options)
        .map_err(|error| CliError::wrong(format!("--merge: {error}")))?;
    let views: Vec<ViewSummary> = args
        .photos
        .iter()
        .zip(turned.iter().zip(&merged.given))
        .map(|(file, (turned, given))| view_summary(file, turned, given))
        .collect();
    warnings.extend(views.iter().flat_map(doubts));
    let px_per_deg = Panorama::from_radiance(merged.resolution.map(|px| Rgb::splat(*px)));
    let found = Photographed {
        panorama: merged.panorama.rotated(wishes.rotation),
        ball: None,
        overlay: None,
        seen: Seen::Several(px_per_deg.rotated(wishes.rotation)),
        seeing: None,
        unit: "the value of the first panorama".into(),
    };
    Ok((found, Merged { views, seen_by: merged.seen_by, lights: merged.lights }))
}

fn options(args: &MergeArgs) -> Result<Options, CliError> {
    if !(0.0..=90.0).contains(&args.photographer) {
        let given = args.photographer;
        return Err(CliError::wrong(format!(
            "--photographer: {given} is not an angle from 0 to 90°"
        )));
    }
    if !(args.most_stops > 0.0 && args.most_stops.is_finite()) {
        let given = args.most_stops;
        return Err(CliError::wrong(format!(
            "--most-stops: {given} is no number of stops above 0"
        )));
    }
    if !args.matches.len().is_multiple_of(4) {
        let n = args.matches.len();
        return Err(CliError::wrong(format!(
            "--match: {n} numbers were given, each match takes four"
        )));
    }
    Ok(Options {
        equalise: Equalise { per_channel: args.balance, most_stops: args.most_stops },
        unseen: match args.unseen {
            FillHow::Around => Unseen::FillAround,
            FillHow::Black => Unseen::Black,
        },
        photographer_rad: args.photographer.to_radians(),
        ..Options::default()
    })
}

impl Turned {
    fn not() -> Self {
        Self { registration: Registration::none(), content: None, measured: false }
    }
}

/// The `k`-th view against those before it, the first of them that tells.
fn by_what_they_show(args: &Args, views: &[View], k: usize) -> Result<Turned, CliError> {
    if args.merging.register == How::None {
        return Ok(Turned::not());
    }
    let mut first_error = None;
    for before in &views[..k] {
        match by_content(before, &views[k]) {
            Ok(content) => {
                let registration = content.registration;
                return Ok(Turned { registration, content: Some(content), measured: true });
            }
            Err(error) => first_error = first_error.or(Some(error)),
        }
    }
    let error = first_error.unwrap_or(RegisterError::Few { found: 0, needed: 1 });
    let path = args.photos[k].display();
    let remedy = match error {
        RegisterError::Mirrored => "",
        _ => " (--match U,V,U,V, or --register none)",
    };
    Err(CliError::wrong(format!("{path}: {error}{remedy}")))
}

/// The second view by matched texels.
fn by_matches(texels: &[f64], views: &[View]) -> Result<Turned, CliError> {
    let direction = |panorama: &Panorama, u: f64, v: f64| {
        let (w, h) = (panorama.width(), panorama.height());
        let inside = (-0.5..w as f64).contains(&u) && (-0.5..h as f64).contains(&v);
        inside.then(|| panorama.world_from_panorama * lat_long_direction(DVec2::new(u, v), w, h))
    };
    let matches: Option<Vec<Match>> = texels
        .chunks_exact(4)
        .map(|m| {
            let to = direction(&views[0].panorama, m[0], m[1])?;
            Some(Match::new(direction(&views[1].panorama, m[2], m[3])?, to))
        })
        .collect();
    let matches = matches.ok_or_else(|| {
        CliError::wrong("--match: a texel lies outside its panorama; give column, row in the first, then in the second")
    })?;
    let found = from_matches(&matches, Handedness::Unknown)
        .map_err(|error| CliError::wrong(format!("--match: {error}")))?;
    Ok(Turned { registration: found.registration, content: None, measured: true })
}

fn view_summary(file: &Path, turned: &Turned, given: &Given) -> ViewSummary {
    let (z, y, x) = turned.registration.rotation.to_euler(EulerRot::ZYX);
    ViewSummary {
        file: file.to_path_buf(),
        // Plus zero: no "-0.00".
        rotation_deg: [x, y, z].map(|angle| angle.to_degrees() + 0.0),
        sigma_deg: turned.measured.then(|| turned.registration.sigma_rad().to_degrees()),
        correlation: turned.content.map(|content| content.correlation),
        parallax_deg: turned.content.map(|content| content.parallax_rad.to_degrees()),
        gain: given.gain.factor.to_array(),
        gain_scatter: given.gain.scatter,
        share: given.weight_share,
        cone_sr: given.cone_sr,
        people_sr: given.people_sr,
    }
}

/// Parallax beyond this is told, degrees (F32).
const PARALLAX_DEG: f64 = 1.0;
/// Scatter of the exposure's ratio beyond this is other light, not noise.
const OTHER_LIGHT: f64 = 0.4;

/// What a person should know of how one view fits the others.
fn doubts(view: &ViewSummary) -> Vec<String> {
    let file = view.file.display();
    let parallax = view.parallax_deg.filter(|deg| *deg > PARALLAX_DEG).map(|deg| {
        format!(
            "{file}: stood elsewhere than the first: things are seen {deg:.1}° aside; near lights are in two \
             places or blurred by that; merge probes from one place, or take the one nearest the objects alone"
        )
    });
    let light = (view.gain_scatter > OTHER_LIGHT).then(|| {
        format!(
            "{file}: half of its directions differ by more than {:.0} % from the first after exposure is \
             equalised; the light changed, or it is another place",
            100.0 * view.gain_scatter
        )
    });
    parallax.into_iter().chain(light).collect()
}

/// What a person reads of it.
pub(super) fn lines(merged: &Merged) -> Vec<String> {
    let mut lines = Vec::new();
    for view in &merged.views {
        let [x, y, z] = view.rotation_deg;
        let mut line = format!(
            "  {}: {:.0} % of the result, light × {:.3}, turned {x:.2},{y:.2},{z:.2}°",
            view.file.display(),
            100.0 * view.share,
            (view.gain[0] + view.gain[1] + view.gain[2]) / 3.0,
        );
        if let Some(sigma) = view.sigma_deg {
            line += &format!(" ± {sigma:.2}°");
        }
        if view.people_sr > 0.0 {
            line += &format!(", {:.3} sr of people or stands left out", view.people_sr);
        }
        lines.push(line);
    }
    let [none, one, more] = merged.seen_by.map(|share| 100.0 * share);
    lines.push(format!(
        "  seen by two or more: {more:.1} %, by one: {one:.1} %, by none: {none:.1} % of all directions"
    ));
    lines
}
