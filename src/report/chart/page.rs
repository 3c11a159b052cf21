//! chart.html: curves, crops and numbers on one page; no network, no libraries, pictures beside it.

use std::path::Path;

use maud::{DOCTYPE, Markup, html};

use super::{Chart, Curve, Point, Reference, sentence, signed, told};
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
                @if let Some(verdict) = sentence(chart) { p { (verdict) "." } }
                p.note {
                    (width) " × " (height) " px, 1/" (chart.reduced) " of the plate. The reference, the \
                    default method without denoising, is good to " (per_cent(chart.reference.error))
                    " over the " (chart.reference.pixels) " px of the influence region, in "
                    (format!("{:.1}", chart.reference.cpu_seconds)) " CPU s. The shot's settings choose "
                    (chart.auto) ", " (chart.stop) "."
                }
                @for note in &chart.notes { p.note { (note) } }
                figure { img.paper src=(curves) alt="error and bias over CPU seconds"; }
                h2 { "The same part by every method" }
                figure {
                    img src=(crops) alt="the same part of the picture by every method";
                    figcaption { "Of each method the rendering whose cost is nearest to the others'; the costs stand below." }
                }
                h2 { "Numbers" }
                (table(chart))
                p.note {
                    "± is one standard error of the bias, from what tiles of 16 × 16 px err apart from each \
                    other. The reference's own noise is in it, and the same for all methods. Light that a \
                    method has not found yet, a small sun by BSDF draws alone, is not."
                }
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
                @for (k, point) in curve.points.iter().enumerate() { (row(curve, point, &chart.reference, k == 0)) }
            }
        }
    }
}

fn row(curve: &Curve, point: &Point, reference: &Reference, first: bool) -> Markup {
    html! {
        tr {
            td { @if first { b { (curve.name) } } }
            td.n { (format!("{:.2}", point.cpu_seconds)) }
            td.n { (told(point.error, reference)) }
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
