//! The part of the picture that is shown of every method, and the files of a chart.

use std::path::Path;

use super::bench::Rendering;
use crate::conventions::Rgb;
use crate::photo::tone::{ToneCurve, automatic_stops, display};
use crate::photo::{Image, Photo, Samples};
use crate::render::compare::Region;
use crate::report::chart::{Chart, Tile, canvas, contact_sheet, write_csv, write_page, write_svg};
use crate::report::per_cent;
use crate::shot::run::RunError;
use crate::shot::watch::Watch;
use crate::shot::write;

const CSV: &str = "chart.csv";
const SVG: &str = "chart.svg";
const PNG: &str = "chart.png";
const CROPS: &str = "crops.png";
const HTML: &str = "chart.html";
const FILES: [&str; 5] = [CSV, SVG, PNG, CROPS, HTML];

/// Largest crop, px.
const LARGEST: [usize; 2] = [290, 220];
const COLUMNS: usize = 6;

/// The part that is shown: where the objects change most.
#[derive(Clone, Copy, Debug)]
pub struct Window {
    x: usize,
    y: usize,
    width: usize,
    height: usize,
}

/// What a method made of the window, scene-linear, and at which cost.
pub struct Crop {
    picture: Image<Rgb>,
    cpu_seconds: f64,
}

impl Window {
    /// Of at most [`LARGEST`], about the middle of what the objects change.
    pub fn around(region: &Region, plate: &Image<Rgb>) -> Self {
        let (mut sum, mut middle) = (0.0_f64, glam::DVec2::ZERO);
        for ((x, y), change) in region.changes() {
            sum += f64::from(change);
            middle += f64::from(change) * glam::DVec2::new(x as f64, y as f64);
        }
        let middle = middle / sum.max(1e-12);
        let [width, height] = [plate.width().min(LARGEST[0]), plate.height().min(LARGEST[1])];
        let from = |middle: f64, size: usize, of: usize| {
            (middle - 0.5 * size as f64).clamp(0.0, (of - size) as f64) as usize
        };
        let x = from(middle.x, width, plate.width());
        let y = from(middle.y, height, plate.height());
        Self { x, y, width, height }
    }

    pub fn crop(&self, rendering: &Rendering, plate: &Image<Rgb>) -> Crop {
        let difference = &rendering.difference;
        let picture = Image::from_fn(self.width, self.height, |x, y| {
            let at = (self.x + x, self.y + y);
            difference.over(plate[at], at)
        });
        Crop { picture, cpu_seconds: rendering.cpu_seconds }
    }
}

/// Whether a chart writes a file of this name.
pub fn is_result(name: &str) -> bool {
    FILES.contains(&name)
}

/// Writes table, curves, crops and page.
pub fn write(
    out: &Path,
    chart: &mut Chart,
    plate: &Photo,
    reference: Crop,
    crops: &[Vec<Crop>],
    watch: &dyn Watch,
) -> Result<(), RunError> {
    std::fs::create_dir_all(out)
        .map_err(|cause| RunError::Folder { folder: out.to_owned(), cause })?;
    chart.files = FILES.iter().map(|name| out.join(name)).collect();
    write_csv(&out.join(CSV), chart)?;
    write_svg(&out.join(SVG), chart)?;
    write::canvas(&out.join(PNG), canvas(chart))?;
    let tiles = tiles(chart, plate, reference, crops);
    write::canvas(&out.join(CROPS), contact_sheet(&tiles, COLUMNS))?;
    write_page(&out.join(HTML), chart, SVG, CROPS)?;
    chart.files.iter().for_each(|path| watch.written(path));
    Ok(())
}

/// The reference and every method's crop nearest to the cost that all have reached.
fn tiles(chart: &Chart, plate: &Photo, reference: Crop, crops: &[Vec<Crop>]) -> Vec<Tile> {
    // Pictures that are made for a screen are shown as they are.
    let stops = match plate.samples {
        Samples::F32 { .. } | Samples::F16 { .. } => automatic_stops(&plate.linear),
        _ => 0.0,
    };
    let shown = |crop: &Crop| display(&crop.picture, stops, ToneCurve::Clip);
    let dearest = |crops: &Vec<Crop>| crops.iter().map(|c| c.cpu_seconds).fold(0.0, f64::max);
    let common = crops.iter().map(dearest).fold(f64::INFINITY, f64::min);
    let first = Tile {
        picture: shown(&reference),
        lines: vec![
            "reference".to_owned(),
            format!("{}, {}", per_cent(chart.reference.error), cost(&reference)),
        ],
    };
    let rest = chart.curves.iter().zip(crops).filter_map(|(curve, crops)| {
        let off = |crop: &Crop| (crop.cpu_seconds / common).ln().abs();
        let (k, crop) = crops.iter().enumerate().min_by(|a, b| off(a.1).total_cmp(&off(b.1)))?;
        let error = match curve.points[k].error {
            Some(error) if error >= chart.reference.error => per_cent(error),
            _ => "as reference".to_owned(),
        };
        let lines = vec![curve.name.to_owned(), format!("{error}, {}", cost(crop))];
        Some(Tile { picture: shown(crop), lines })
    });
    std::iter::once(first).chain(rest).collect()
}

fn cost(crop: &Crop) -> String {
    format!("{:.2} CPU s", crop.cpu_seconds)
}
