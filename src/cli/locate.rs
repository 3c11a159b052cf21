//! `platelight locate`: where a camera stood, from a tag, a board or a marked rectangle.

use std::path::PathBuf;

use glam::DVec3;
use serde::Serialize;

use super::outputs::check_outputs;
use super::{CliError, Global, Outcome, calibrate};
use crate::camera::{Camera, file};
use crate::photo::{self, ReadOptions};
use crate::report::{PoseReport, Warning};
use crate::shot::camera_keys::{BoardPose, Placing, PoseSource, RectanglePose, TagPose};
use crate::shot::locate;

/// Find where a camera stood, from a tag, a board or four marked corners
///
/// The world: metres, +Y up. The target's place is its centre (a tag's black square, a board's grid of
/// inner corners), where its printed side looks, and where its upper edge points.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  platelight locate tag.jpg --camera camera.json --tag 7 --size-mm 120 \\
      -o located.json
  platelight locate board.jpg --camera camera.json --board 9x6 --square-mm 25 \\
      --at 0,0.002,0
  platelight locate plate.png --camera camera.json --size-m 0.45,0.45 \\
      --rectangle 301,210,640,222,702,480,260,455")]
#[command(group = clap::ArgGroup::new("target").required(true).args(["tag", "board", "rectangle"]))]
pub struct Args {
    /// The photograph
    photo: PathBuf,
    /// The lens: camera.json, OpenCV YAML or COLMAP cameras.txt
    #[arg(long, value_name = "FILE")]
    camera: PathBuf,
    /// Number of the AprilTag
    #[arg(long, value_name = "ID", requires = "size_mm")]
    tag: Option<u32>,
    /// AprilTag family
    #[arg(long, default_value = "36h11", value_name = "NAME")]
    family: String,
    /// Outer edge of the tag's black border
    #[arg(long, value_name = "MM")]
    size_mm: Option<f64>,
    /// Inner corners of the checkerboard
    #[arg(long, value_name = "WxH", requires = "square_mm")]
    board: Option<String>,
    /// Side of a square
    #[arg(long, value_name = "MM")]
    square_mm: Option<f64>,
    /// Corners of a rectangle: upper left, upper right, lower right, lower left, as x,y pairs
    #[arg(long, value_name = "X,Y,X,Y,X,Y,X,Y", requires = "size_m", allow_hyphen_values = true)]
    rectangle: Option<Numbers<8>>,
    /// Width and height of the rectangle in metres
    #[arg(long, value_name = "W,H")]
    size_m: Option<Numbers<2>>,
    /// Centre of the target in the world, metres
    #[arg(long, value_name = "X,Y,Z", default_value = "0,0,0", allow_hyphen_values = true)]
    at: Numbers<3>,
    /// Where its printed side looks
    #[arg(long, value_name = "X,Y,Z", default_value = "0,1,0", allow_hyphen_values = true)]
    facing: Numbers<3>,
    /// Where its upper edge points
    #[arg(long, value_name = "X,Y,Z", default_value = "0,0,-1", allow_hyphen_values = true)]
    up: Numbers<3>,
    /// Write the camera with its pose
    #[arg(long, short, value_name = "FILE")]
    out: Option<PathBuf>,
}

/// N numbers in one word, between commas.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Numbers<const N: usize>([f64; N]);

impl<const N: usize> std::str::FromStr for Numbers<N> {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        let number = |s: &str| s.trim().parse::<f64>().ok().filter(|v| v.is_finite());
        let all: Option<Vec<f64>> = text.split(',').map(number).collect();
        all.and_then(|v| v.try_into().ok())
            .map(Self)
            .ok_or_else(|| format!("expected {N} numbers between commas and no spaces"))
    }
}

#[derive(Serialize)]
struct Summary {
    out: Option<PathBuf>,
    pose: PoseReport,
    /// Camera axes (−Z forward, +Y up) to world, three rows of four.
    world_from_camera: [[f64; 4]; 3],
    warnings: Vec<Warning>,
    notes: Vec<Warning>,
}

pub fn run(args: &Args, global: &Global) -> Result<Outcome, CliError> {
    if let Some(out) = &args.out {
        check_outputs(&[&args.photo, &args.camera], &[out])?;
    }
    let read = file::read(&args.camera)?;
    let photo = photo::read(&args.photo, &ReadOptions::default())?;
    let size = [photo.linear.width(), photo.linear.height()];
    let expected = [read.camera.width, read.camera.height];
    if size != expected {
        return Err(CliError::wrong(format!(
            "{}: {}×{} px, but {} is for {}×{}; use a photograph of the same setting",
            args.photo.display(),
            size[0],
            size[1],
            args.camera.display(),
            expected[0],
            expected[1]
        )));
    }
    let source = source(args)?;
    global.go_on()?;
    let mut found = locate::find_pose(&source, &read.camera.lens, size, None)?;
    let camera = Camera { pose: found.pose.clone(), ..read.camera };
    let facing = DVec3::from(args.facing.0);
    // Slip a hand's breadth round the target: what an object standing on it would show.
    found.report.slip_px = found.slip_px(&camera, DVec3::from(args.at.0), facing, SLIP_RADIUS_M);
    if let Some(out) = &args.out {
        global.go_on()?;
        file::write(out, &camera, true)?;
    }
    global.tell(&found.warnings);
    let (m, t) = (camera.pose.rotation(), camera.pose.position());
    let row = |i: usize| [m.x_axis[i], m.y_axis[i], m.z_axis[i], t[i]];
    let (warnings, notes) = Warning::apart(found.warnings);
    let summary = Summary {
        out: args.out.clone(),
        pose: found.report,
        world_from_camera: [row(0), row(1), row(2)],
        warnings,
        notes,
    };
    global.print(&summary, || describe(&summary));
    Ok(Outcome::Done)
}

const SLIP_RADIUS_M: f64 = 0.1;

fn source(args: &Args) -> Result<PoseSource, CliError> {
    let placing = Placing { at: args.at.0, facing: args.facing.0, up: args.up.0 };
    let photo = args.photo.clone();
    let positive = |name: &str, value: Option<f64>| {
        value
            .filter(|v| *v > 0.0 && v.is_finite())
            .ok_or_else(|| CliError::wrong(format!("--{name}: measure it, above zero")))
    };
    if let Some(id) = args.tag {
        let size_mm = positive("size-mm", args.size_mm)?;
        let family = args.family.clone();
        return Ok(PoseSource::Tags(vec![TagPose { photo, family, id, size_mm, placing }]));
    }
    if let Some(corners) = &args.board {
        let square_mm = positive("square-mm", args.square_mm)?;
        let board = Some(calibrate::board(corners, square_mm, None)?);
        return Ok(PoseSource::Board(BoardPose { photo, board, placing }));
    }
    let (Some(Numbers(px)), Some(Numbers(size))) = (&args.rectangle, &args.size_m) else {
        return Err(CliError::wrong("name a target: --tag, --board or --rectangle"));
    };
    let corners_px = std::array::from_fn(|i| [px[2 * i], px[2 * i + 1]]);
    let size = [positive("size-m", Some(size[0]))?, positive("size-m", Some(size[1]))?];
    Ok(PoseSource::Rectangle(RectanglePose { corners_px, size, placing }))
}

fn describe(summary: &Summary) -> String {
    let pose = &summary.pose;
    let three = |v: [String; 3]| v.join(", ");
    let mut lines = vec![
        format!("from        {}", pose.source),
        format!("position    {} m", three(pose.position_m.map(|m| format!("{m:.5}")))),
    ];
    if let Some(sigma) = pose.sigma_position_m {
        let mm = sigma.map(|m| format!("{:.2}", 1000.0 * m));
        lines.push(format!("            ± {} mm (world x, y, z)", three(mm)));
    }
    if let Some(sigma) = pose.sigma_rotation_deg {
        let degrees = sigma.map(|d| format!("{d:.4}"));
        lines.push(format!("direction   ± {} ° (about the camera's x, y, z)", three(degrees)));
    }
    lines.extend(
        pose.rms_px.map(|rms| format!("residual    {rms:.3} px rms at the target's corners")),
    );
    if let Some(slip) = pose.slip_px {
        let cm = 100.0 * SLIP_RADIUS_M;
        lines.push(format!(
            "slip        ± {slip:.2} px for what stands within {cm:.0} cm of the target"
        ));
    }
    lines.extend(pose.ambiguity.as_ref().map(|a| format!("also        {a}")));
    lines.extend(summary.out.as_ref().map(|out| format!("written     {}", out.display())));
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_come_between_commas() {
        assert_eq!("-0.1,0,2e-3".parse(), Ok(Numbers([-0.1, 0.0, 2e-3])));
        for bad in ["", "1,2", "1,2,3,4", "1,2,x", "1,2,nan", "1 2 3"] {
            assert!(bad.parse::<Numbers<3>>().is_err(), "{bad}");
        }
    }
}
