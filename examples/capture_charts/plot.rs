//! Lines on two logarithmic axes, as SVG.

use std::error::Error;
use std::ops::Range;

use plotters::prelude::*;

/// A named line; what is not above 0 is left out.
pub struct Line {
    pub name: String,
    pub points: Vec<(f64, f64)>,
    /// Drawn thick.
    pub ours: bool,
}

/// Colours that differ for the colour-blind too (Okabe & Ito 2008).
const COLOURS: [RGBColor; 8] = [
    RGBColor(0, 0, 0),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(0, 158, 115),
    RGBColor(200, 170, 0),
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(204, 121, 167),
];
const SIZE: (u32, u32) = (1100, 560);
/// Width left for the names, px.
const NAMES: u32 = 400;

/// The chart; its axes run over the decades of what is drawn.
pub fn chart(
    title: &str,
    x_title: &str,
    y_title: &str,
    lines: &[Line],
) -> Result<String, Box<dyn Error>> {
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, SIZE).into_drawing_area();
        area.fill(&WHITE)?;
        let (plot, names) =
            area.titled(title, ("sans-serif", 20))?.split_horizontally(SIZE.0 - NAMES);
        let drawn = |line: &Line| -> Vec<(f64, f64)> {
            line.points.iter().copied().filter(|p| p.0 > 0.0 && p.1 > 0.0).collect()
        };
        let all: Vec<(f64, f64)> = lines.iter().flat_map(drawn).collect();
        let mut chart = ChartBuilder::on(&plot)
            .margin(12)
            .x_label_area_size(44)
            .y_label_area_size(64)
            .build_cartesian_2d(
                decades(all.iter().map(|p| p.0)).log_scale(),
                decades(all.iter().map(|p| p.1)).log_scale(),
            )?;
        chart
            .configure_mesh()
            .x_desc(x_title)
            .y_desc(y_title)
            .label_style(("sans-serif", 13))
            .draw()?;
        for (k, line) in lines.iter().enumerate() {
            let colour = COLOURS[k % COLOURS.len()];
            let width = if line.ours { 4 } else { 2 };
            // The second time round the colours mean hollow dots.
            let dot = if k < COLOURS.len() { colour.filled() } else { colour.stroke_width(2) };
            let points = drawn(line);
            chart.draw_series(LineSeries::new(points.clone(), colour.stroke_width(width)))?;
            chart.draw_series(points.iter().map(|&p| Circle::new(p, 4, dot)))?;
            let y = 24 + 22 * k as i32;
            names.draw(&PathElement::new(vec![(8, y), (32, y)], colour.stroke_width(width)))?;
            names.draw(&Circle::new((20, y), 4, dot))?;
            names.draw(&Text::new(line.name.as_str(), (40, y - 7), ("sans-serif", 14)))?;
        }
        area.present()?;
    }
    Ok(svg)
}

/// Whole decades that hold all values.
fn decades(values: impl Iterator<Item = f64>) -> Range<f64> {
    let (low, high) =
        values.fold((f64::INFINITY, 1e-30f64), |(low, high), v| (low.min(v), high.max(v)));
    let (low, high) = (low.log10().floor(), high.log10().ceil());
    10f64.powf(low)..10f64.powf(high.max(low + 1.0))
}
