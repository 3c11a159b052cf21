//! `platelight calibrate`: photographs of a board → camera.json with the error of every number.

use std::path::PathBuf;

use serde::Serialize;

use super::outputs::{check_outputs, refuse_repeated};
use super::{CliError, Global, Outcome, targets};
use crate::camera::{Camera, Pose, file};
use crate::report::{CameraReport, Warning};
use crate::shot::calibrate::{self, FoundLens};
use crate::shot::camera_keys::Board;
use crate::shot::detect::Rung;
use crate::shot::pictures;

/// Calibrate a lens from photographs of a board
///
/// Take 10 to 15, at the plate's focal length and focus: tilt the board by 20 to 45° in different
/// directions and fill the corners of the frame. The result says how far the lens may be wrong over the
/// frame, which the residuals do not, and which photographs were left out and why.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example:\n  platelight calibrate board_*.jpg --corners 9x6 --square-mm 25 -o camera.json"
)]
pub struct Args {
    /// The photographs
    #[arg(required = true, value_name = "PHOTO")]
    photos: Vec<PathBuf>,
    /// Inner corners across and down, where four squares meet
    #[arg(long, value_name = "WxH")]
    corners: String,
    /// Measured side of a square
    #[arg(long, value_name = "MM")]
    square_mm: f64,
    /// Measured side of the markers: the board is a ChArUco board (dictionary 4x4)
    #[arg(long, value_name = "MM")]
    marker_mm: Option<f64>,
    /// The camera file to write
    #[arg(long, short, value_name = "FILE", default_value = "camera.json")]
    out: PathBuf,
}

#[derive(Serialize)]
struct Summary<'a> {
    out: &'a PathBuf,
    camera: &'a CameraReport,
    rungs: &'a [Rung],
    warnings: Vec<Warning>,
    notes: Vec<Warning>,
}

pub fn run(args: &Args, global: &Global) -> Result<Outcome, CliError> {
    let board = board(&args.corners, args.square_mm, args.marker_mm)?;
    let mut files = vec![];
    for photo in &args.photos {
        // A quoted pattern has not been expanded by the shell.
        files.extend(
            pictures::expand(photo)
                .map_err(|cause| CliError::wrong(format!("{}: {cause}", photo.display())))?,
        );
    }
    refuse_repeated(&files)?;
    let photos: Vec<&std::path::Path> = files.iter().map(PathBuf::as_path).collect();
    check_outputs(&photos, &[&args.out])?;
    let (found, _) = calibrate::from_boards(&files, &board)?;
    let FoundLens { lens, width, height, report, rungs, warnings } = &found;
    let camera =
        Camera { width: *width, height: *height, lens: lens.clone(), pose: Pose::identity() };
    global.go_on()?;
    file::write(&args.out, &camera, false)?;
    global.tell(warnings);
    let (warnings, notes) = Warning::apart(warnings.clone());
    let summary = Summary { out: &args.out, camera: report, rungs, warnings, notes };
    global.print(&summary, || describe(&found, &args.out));
    Ok(Outcome::Done)
}

/// The board that `--corners`, `--square-mm` and `--marker-mm` describe.
pub(super) fn board(
    corners: &str,
    square_mm: f64,
    marker_mm: Option<f64>,
) -> Result<Board, CliError> {
    let [columns, rows] = targets::counts(corners)?;
    let positive = |name: &str, value: f64| {
        if value > 0.0 && value.is_finite() {
            Ok(value)
        } else {
            Err(CliError::wrong(format!("--{name} {value}: measure it, in millimetres")))
        }
    };
    let square_mm = positive("square-mm", square_mm)?;
    let corners = [columns as u32, rows as u32];
    Ok(match marker_mm {
        None => Board::Checkerboard { corners, square_mm },
        Some(marker) if positive("marker-mm", marker)? < square_mm => Board::Charuco {
            corners,
            square_mm,
            marker_mm: marker,
            dictionary: "4x4_250".to_owned(),
        },
        Some(marker) => {
            return Err(CliError::wrong(format!(
                "--marker-mm {marker} is not smaller than --square-mm {square_mm}; are the two swapped?"
            )));
        }
    })
}

fn describe(found: &FoundLens, out: &std::path::Path) -> String {
    use std::fmt::Write;
    let mut text = String::new();
    let report = &found.report;
    for view in &report.views {
        let name = view.photo.display();
        // Writing to a String cannot fail.
        let _ = match (&view.rejected, view.rms_px) {
            (Some(reason), _) => writeln!(text, "{name}: left out: {reason}"),
            (None, Some(rms)) => writeln!(text, "{name}: {rms:.3} px"),
            (None, None) => writeln!(text, "{name}"),
        };
    }
    let sigma = found.lens.sigmas().unwrap_or_else(|| vec![f64::NAN; 4]);
    let lens = &found.lens;
    let _ = writeln!(text, "lens        {} ({})", report.distortion, report.source);
    let _ = writeln!(
        text,
        "focal       {:.3} ± {:.3}, {:.3} ± {:.3} px",
        lens.fx, sigma[0], lens.fy, sigma[1]
    );
    let _ = writeln!(
        text,
        "centre      {:.3} ± {:.3}, {:.3} ± {:.3} px",
        lens.cx, sigma[2], lens.cy, sigma[3]
    );
    let coefficients = lens.distortion.coefficients();
    let named = lens.distortion.names().iter().zip(&coefficients).zip(sigma.iter().skip(4));
    // A term of exactly 0 was not needed and is not known to be 0.
    let terms: Vec<String> = named
        .filter(|((_, k), _)| **k != 0.0)
        .map(|((name, k), s)| format!("{name} {k:.5} ± {s:.5}"))
        .collect();
    let terms = if terms.is_empty() { "none needed".to_owned() } else { terms.join(", ") };
    let _ = writeln!(text, "distortion  {terms}");
    let _ = writeln!(
        text,
        "residual    {:.3} px rms: how far the corners lie from where this lens sees them",
        report.rms_px.unwrap_or(f64::NAN)
    );
    let _ = writeln!(
        text,
        "known to    {:.3} px (1 σ) over the frame: how far this lens may be wrong",
        report.sigma_projection_px.unwrap_or(f64::NAN)
    );
    let _ = write!(text, "written     {}", out.display());
    text
}
