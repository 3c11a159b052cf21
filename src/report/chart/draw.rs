//! Marks as SVG, and as pixels.

use glam::DVec2;
use svg::node::element::{Circle, Polyline, Rectangle, Text};

use super::Chart;
use super::axes::{Anchor, HEIGHT, LETTER, Mark, WIDTH, marks};
use crate::report::Canvas;
use crate::report::canvas::Colour;

/// Length of a dash and of the gap behind it, px.
const DASH: f64 = 7.0;

/// The chart as an SVG document.
pub fn svg(chart: &Chart) -> String {
    let mut document = svg::Document::new()
        .set("viewBox", (0, 0, WIDTH, HEIGHT))
        .set("font-family", "ui-monospace, Menlo, Consolas, monospace")
        .set("font-size", 19)
        .add(Rectangle::new().set("width", WIDTH).set("height", HEIGHT).set("fill", "white"));
    for mark in marks(chart) {
        document = match mark {
            Mark::Line { points, colour, width, dashed } => {
                let text: Vec<String> =
                    points.iter().map(|p| format!("{:.1},{:.1}", p.x, p.y)).collect();
                let line = Polyline::new()
                    .set("points", text.join(" "))
                    .set("fill", "none")
                    .set("stroke", hex(colour))
                    .set("stroke-width", width);
                document.add(if dashed { line.set("stroke-dasharray", DASH) } else { line })
            }
            Mark::Dot { at, radius, colour, filled } => document.add(
                Circle::new()
                    .set("cx", format!("{:.1}", at.x))
                    .set("cy", format!("{:.1}", at.y))
                    .set("r", radius)
                    .set("fill", if filled { hex(colour) } else { "none".to_owned() })
                    .set("stroke", hex(colour))
                    .set("stroke-width", 2),
            ),
            Mark::Text { at, text, colour, anchor } => document.add(
                Text::new(text)
                    .set("x", format!("{:.1}", at.x))
                    .set("y", format!("{:.1}", at.y))
                    .set("fill", hex(colour))
                    .set(
                        "text-anchor",
                        match anchor {
                            Anchor::Start => "start",
                            Anchor::Middle => "middle",
                            Anchor::End => "end",
                        },
                    ),
            ),
        };
    }
    document.to_string()
}

/// The chart in pixels.
pub fn canvas(chart: &Chart) -> Canvas {
    let mut canvas = Canvas::paper(WIDTH as usize, HEIGHT as usize);
    for mark in marks(chart) {
        match mark {
            Mark::Line { points, colour, width, dashed } => {
                if dashed {
                    for [from, to] in dashes(&points) {
                        canvas.stroke_line(&[from, to], colour, width);
                    }
                } else {
                    canvas.stroke_line(&points, colour, width);
                }
            }
            Mark::Dot { at, radius, colour, filled } => {
                if filled {
                    canvas.disc(at, radius, colour);
                } else {
                    canvas.ring(at, radius, colour);
                }
            }
            Mark::Text { at, text, colour, anchor } => {
                let wide = LETTER.x * text.chars().count() as f64;
                let left = match anchor {
                    Anchor::Start => at.x,
                    Anchor::Middle => at.x - 0.5 * wide,
                    Anchor::End => at.x - wide,
                };
                canvas.text(DVec2::new(left, at.y), &text, colour);
            }
        }
    }
    canvas
}

/// A polyline cut into dashes.
fn dashes(points: &[DVec2]) -> Vec<[DVec2; 2]> {
    let mut dashes = Vec::new();
    let mut walked = 0.0;
    for pair in points.windows(2) {
        let [from, to] = [pair[0], pair[1]];
        let length = from.distance(to);
        let mut at = 0.0;
        while at < length {
            let phase = (walked + at) % (2.0 * DASH);
            let end =
                (at + if phase < DASH { DASH - phase } else { 2.0 * DASH - phase }).min(length);
            if phase < DASH {
                dashes.push([from.lerp(to, at / length), from.lerp(to, end / length)]);
            }
            // A phase at its very end would not move on.
            at = end.max(at + 1e-6);
        }
        walked += length;
    }
    dashes
}

fn hex([r, g, b]: Colour) -> String {
    format!("#{r:02x}{g:02x}{b:02x}")
}

#[cfg(test)]
mod tests {
    use super::super::tests::chart;
    use super::*;
    use crate::photo::Samples;

    #[test]
    fn dashes_are_half_of_the_line() {
        let line = [DVec2::ZERO, DVec2::new(100.0, 0.0), DVec2::new(100.0, 40.0)];
        let drawn: f64 = dashes(&line).iter().map(|[a, b]| a.distance(*b)).sum();
        assert!((drawn - 70.0).abs() < 1e-3, "{drawn}");
        assert!(dashes(&[DVec2::ZERO]).is_empty());
    }

    #[test]
    fn both_drawings_name_every_curve() {
        let chart = chart();
        let text = svg(&chart);
        for curve in &chart.curves {
            assert!(text.contains(curve.name), "{}", curve.name);
        }
        assert!(text.contains("CPU seconds") && text.contains("asked for"));
        let (width, height, Samples::U8 { data, .. }) = canvas(&chart).into_samples() else {
            panic!("8 bit");
        };
        assert_eq!((width, height), (WIDTH as usize, HEIGHT as usize));
        let ink = data.chunks(3).filter(|p| p[0] < 250).count() as f64 / (WIDTH * HEIGHT);
        assert!((0.02..0.3).contains(&ink), "{ink}");
    }
}
