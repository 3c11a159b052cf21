//! `platelight targets`: printable checkerboards, ChArUco boards and tags at true scale.

use std::io::Write;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::outputs::check_outputs;
use super::{CliError, Global, Outcome};
use crate::photo::atomic;
use crate::shot::sheet::{self, Sheet};

/// Make printable boards and tags at true scale, as PDF or SVG
///
/// Print at 100 % and measure the bar of 50 mm, then one square or tag: what you measure is what you
/// give to calibrate and locate. Glue the print on something flat; a bow of half a millimetre shows.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  platelight targets checkerboard --corners 9x6 --square-mm 25 --page A3 \\
      -o board.pdf
  platelight targets tags --ids 0-3,7 --size-mm 120 -o tags.pdf
  platelight targets charuco --corners 6x4 --square-mm 30 --page A3 \\
      -o charuco.svg")]
pub struct Args {
    #[command(subcommand)]
    target: Target,
}

#[derive(Debug, clap::Subcommand)]
enum Target {
    /// A checkerboard
    Checkerboard(BoardArgs),
    /// A checkerboard with markers: part of it is enough
    Charuco(BoardArgs),
    /// AprilTags, one a page
    Tags(TagArgs),
}

#[derive(Debug, clap::Args)]
struct BoardArgs {
    /// Inner corners across and down, where four squares meet
    #[arg(long, default_value = "9x6", value_name = "WxH")]
    corners: String,
    /// Side of a square
    #[arg(long, default_value_t = 25.0, value_name = "MM")]
    square_mm: f64,
    #[command(flatten)]
    page: PageArgs,
}

#[derive(Debug, clap::Args)]
struct TagArgs {
    /// AprilTag family
    #[arg(long, default_value = "36h11")]
    family: String,
    /// Tag numbers: 0-3,7
    #[arg(long, default_value = "0", value_name = "IDS")]
    ids: String,
    /// Outer edge of the black border
    #[arg(long, default_value_t = 120.0, value_name = "MM")]
    size_mm: f64,
    #[command(flatten)]
    page: PageArgs,
}

#[derive(Debug, clap::Args)]
struct PageArgs {
    /// Paper: A4, A3, A2, letter or WIDTHxHEIGHT in mm; turned to landscape where only that fits
    #[arg(long, default_value = "A4")]
    page: String,
    /// File to write; its ending says the format (.pdf or .svg)
    #[arg(long, short, value_name = "FILE")]
    out: PathBuf,
}

#[derive(Serialize)]
struct Summary {
    out: PathBuf,
    pages: usize,
    page_mm: [f64; 2],
}

pub fn run(args: &Args, global: &Global) -> Result<Outcome, CliError> {
    let (Target::Checkerboard(BoardArgs { page, .. })
    | Target::Charuco(BoardArgs { page, .. })
    | Target::Tags(TagArgs { page, .. })) = &args.target;
    let (out, format) = (&page.out, Format::of(&page.out)?);
    check_outputs(&[], &[out])?;
    let page = sheet::page_mm(&page.page)?;
    let sheets = match &args.target {
        Target::Checkerboard(board) => {
            let [columns, rows] = counts(&board.corners)?;
            vec![sheet::checkerboard(columns, rows, board.square_mm, page)?]
        }
        Target::Charuco(board) => {
            let [columns, rows] = counts(&board.corners)?;
            vec![sheet::charuco(columns + 1, rows + 1, board.square_mm, page)?]
        }
        Target::Tags(tags) => {
            let of_id = |id| sheet::tag(&tags.family, id, tags.size_mm, page);
            ids(&tags.ids)?.into_iter().map(of_id).collect::<Result<Vec<_>, _>>()?
        }
    };
    let bytes = format.encode(&sheets)?;
    global.go_on()?;
    atomic::write(out, |file| file.write_all(&bytes))
        .map_err(|e| CliError::wrong(format!("{}: {e}", out.display())))?;
    let page_mm = [sheets[0].width_mm, sheets[0].height_mm];
    let summary = Summary { out: out.clone(), pages: sheets.len(), page_mm };
    global.print(&summary, || {
        let (n, [w, h]) = (summary.pages, page_mm);
        format!("{}: {n} page(s) of {w} × {h} mm; print at 100 %", out.display())
    });
    Ok(Outcome::Done)
}

/// What the sheets are written as.
enum Format {
    Pdf,
    Svg,
}

impl Format {
    /// By the ending of a file's name.
    fn of(out: &Path) -> Result<Self, CliError> {
        let ending = out.extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase();
        match ending.as_str() {
            "pdf" => Ok(Self::Pdf),
            "svg" => Ok(Self::Svg),
            _ => {
                let out = out.display();
                Err(CliError::wrong(format!("{out}: the name must end in .pdf or .svg")))
            }
        }
    }

    fn encode(self, sheets: &[Sheet]) -> Result<Vec<u8>, CliError> {
        match (self, sheets) {
            (Self::Pdf, _) => Ok(sheet::pdf(sheets)),
            (Self::Svg, [one]) => Ok(one.svg().into_bytes()),
            (Self::Svg, _) => {
                Err(CliError::wrong("--out: an SVG holds one page; use .pdf for several tags"))
            }
        }
    }
}

/// `9x6` → columns and rows.
pub(super) fn counts(text: &str) -> Result<[usize; 2], CliError> {
    let wrong = || CliError::wrong(format!("\"{text}\": expected two counts such as 9x6"));
    let (a, b) = text.split_once(['x', 'X', '×']).ok_or_else(wrong)?;
    let count =
        |s: &str| s.trim().parse().ok().filter(|n| (1..=1000).contains(n)).ok_or_else(wrong);
    Ok([count(a)?, count(b)?])
}

/// `0-3,7` → numbers.
fn ids(text: &str) -> Result<Vec<u32>, CliError> {
    const MOST: usize = 1000;
    let wrong =
        || CliError::wrong(format!("--ids \"{text}\": expected numbers and ranges such as 0-3,7"));
    let mut all = vec![];
    for part in text.split(',') {
        let (first, last) = part.split_once('-').unwrap_or((part, part));
        let number = |s: &str| s.trim().parse::<u32>().map_err(|_| wrong());
        let (first, last) = (number(first)?, number(last)?);
        if last < first || (last - first) as usize >= MOST || all.len() >= MOST {
            return Err(wrong());
        }
        all.extend(first..=last);
    }
    Ok(all)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_and_ranges_are_read_or_refused() {
        assert_eq!(counts("9x6").unwrap(), [9, 6]);
        assert_eq!(ids("0-3,7").unwrap(), [0, 1, 2, 3, 7]);
        for bad in ["", "9", "9x", "x6", "-1x6", "9x6x3", "99999x2"] {
            assert!(counts(bad).is_err(), "{bad}");
        }
        for bad in ["", "a", "3-1", "0-4000000000", "1,,2", "-"] {
            assert!(ids(bad).is_err(), "{bad}");
        }
    }
}
