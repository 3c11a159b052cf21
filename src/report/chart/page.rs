//! chart.html: curves, crops and numbers on one page; no network, no libraries, pictures beside it.

use std::path::Path;

use maud::{DOCTYPE, Markup, html};

use super::{Chart, Curve, Point, sentence, signed};
use crate::report::ReportError;
use crate::report::html;
use crate::report::text::per_cent;

/// Writes chart.html; `curves` and `crops` are file names beside it.
pub fn write_page(
    path: &Path,
    chart: &Chart,
    curves: &str,
    crops: &str,
) -> Result<(), ReportError> {
    html::write_page(path, &page(chart, curves, crops))
}

fn page(chart: &Chart, curves: &str, crops: &str) -> Markup {
    let [width, height] = chart.size;
    let title = format!("{}: speed against accuracy", chart.name);
    html! {
        (DOCTYPE)
        html lang="en" {
            (html::head(&title, "body{max-width:1400px}.paper{background:#fff}"))
            body {
                h1 { (title) }
                @if let Some(verdict) = &chart.verdict { p { (sentence(verdict)) "." } }
                p.note {
                    (width) " × " (height) " px, 1/" (chart.reduced) " of the plate. The reference, the \
                    default method without denoising, is good to " (per_cent(chart.reference.error))
                    " over the " (chart.reference.pixels) " px of the influence region, in "
                    (format!("{:.1}", chart.reference.cpu_seconds)) " CPU s. The shot's settings choose "
                    (chart.auto) ", " (chart.stop) "."
                }
                @for note in &chart.notes { p.note { (note) } }
                figure { img.paper src=(curves) alt="error and bias over CPU seconds"; }
                h2 { "At equal time" }
                figure {
                    img src=(crops) alt="the same part of the picture by every method";
                    figcaption { "Each method's rendering whose cost is nearest to the others'." }
                }
                h2 { "Numbers" }
                (table(chart))
                p.note { (chart.program) ", seed " (chart.seed) }
            }
        }
    }
}

fn table(chart: &Chart) -> Markup {
    html! {
        table {
            tr { th { "method" } th { "CPU s" } th { "error" } th { "it states" } th { "bias" } th { "what it does" } }
            @for curve in &chart.curves {
                @for (k, point) in curve.points.iter().enumerate() { (row(curve, point, k == 0)) }
            }
        }
    }
}

fn row(curve: &Curve, point: &Point, first: bool) -> Markup {
    html! {
        tr {
            td { @if first { b { (curve.name) } } }
            td.n { (format!("{:.2}", point.cpu_seconds)) }
            td.n { (point.error.map_or("below the reference's".to_owned(), per_cent)) }
            td.n { (per_cent(point.stated)) }
            td.n { (signed(point.bias)) " ± " (per_cent(point.bias_sigma)) }
            td { @if first {
                (curve.does)
                @if let Some(bias) = curve.bias { "; biased: " (bias) }
            } }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::chart;
    use super::*;

    #[test]
    fn the_page_shows_curves_crops_and_every_number() {
        let text = page(&chart(), "chart.svg", "crops.png").into_string();
        assert!(text.contains("src=\"chart.svg\"") && text.contains("src=\"crops.png\""));
        assert_eq!(text.matches("<tr>").count(), 1 + 25);
    }
}
