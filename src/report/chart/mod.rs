//! Speed against accuracy: every method on one shot, as table, curves and page.
//!
//! [`Chart`] → chart.csv, chart.svg, chart.png, chart.html. Measures nothing; `shot::chart` does.

mod axes;
mod draw;
mod page;
mod sheet;

pub use draw::{canvas, svg};
pub use page::write_page;
pub use sheet::{Tile, contact_sheet};

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::{ReportError, write_text};

/// What is compared side by side: one panel of the picture each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Group {
    /// Whole methods, and the default with one improvement on or off.
    Methods,
    /// How directions are drawn.
    Directions,
    /// How often light may be reflected.
    Depth,
    /// Lists of directional lights for blocked light.
    Lights,
}

impl Group {
    pub const ALL: [Self; 4] = [Self::Methods, Self::Directions, Self::Depth, Self::Lights];

    /// As chart.csv and `--json` have it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Methods => "methods",
            Self::Directions => "directions",
            Self::Depth => "depth",
            Self::Lights => "lights",
        }
    }

    /// What heads its panel.
    pub fn title(self) -> &'static str {
        match self {
            Self::Methods => "methods and improvements",
            Self::Directions => "how directions are drawn",
            Self::Depth => "longest path",
            Self::Lights => "blocked light from a list",
        }
    }
}

/// One rendering against the reference. Errors are relative to the picture's brightness.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Point {
    /// Of all cores together, for the waves alone: scene and lights were ready.
    pub cpu_seconds: f64,
    pub seconds: f64,
    pub samples: u64,
    /// The error that the method itself states.
    pub stated: f64,
    /// Root mean square over the influence region, the reference's own error taken out; `None` if
    /// it is too small for the reference to tell.
    pub error: Option<f64>,
    /// The same over the pixels that objects cover, and over the others.
    pub on_objects: Option<f64>,
    pub beside: Option<f64>,
    /// Mean signed difference over the region, and its standard error: see
    /// [`Comparison`](crate::render::compare::Comparison).
    pub bias: f64,
    pub bias_sigma: f64,
}

/// A method at growing cost.
#[derive(Clone, Debug, Serialize)]
pub struct Curve {
    /// As `--methods` takes it.
    pub name: &'static str,
    pub group: Group,
    pub does: &'static str,
    /// What it leaves out for good; `None` if only noise is wrong with it.
    pub bias: Option<&'static str>,
    pub points: Vec<Point>,
}

/// The default against the unbiased method with the least error at the same cost.
#[derive(Clone, Debug, Serialize)]
pub struct Verdict {
    pub cpu_seconds: f64,
    /// Of the method that the shot's settings choose.
    pub error: f64,
    pub best: &'static str,
    pub best_error: f64,
    /// That cost lies beyond the method's own renderings: the error is what Monte Carlo would make of
    /// the last of them, which knows nothing of what a rendering costs before its first sample.
    pub extrapolated: bool,
}

/// The best that was rendered: what the others are held against.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Reference {
    /// Its own standard error over the region.
    pub error: f64,
    pub cpu_seconds: f64,
    pub samples: u64,
    /// Pixels of the influence region.
    pub pixels: usize,
}

/// All that was measured on one shot.
#[derive(Clone, Debug, Serialize)]
pub struct Chart {
    /// What people call the shot.
    pub name: String,
    pub program: &'static str,
    pub seed: u64,
    /// The plate as rendered, pixels, and how many of its own went into one, across and down.
    pub size: [usize; 2],
    pub reduced: usize,
    /// What the shot's settings choose, in a sentence, and where they stop.
    pub auto: String,
    pub stop: String,
    /// The error that the shot asks for, if it asks for one.
    pub target: Option<f64>,
    pub reference: Reference,
    /// The shot's own settings come first.
    pub curves: Vec<Curve>,
    /// What the shot's settings came to, stopping rule and all, at this size.
    pub chosen: Option<Point>,
    pub verdict: Option<Verdict>,
    /// What is to be known before the curves are believed.
    pub notes: Vec<String>,
    /// Files made, beside each other.
    pub files: Vec<PathBuf>,
}

impl Serialize for Group {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}

impl Verdict {
    /// How many times the best one's error.
    pub fn ratio(&self) -> f64 {
        self.error / self.best_error
    }
}

/// Writes chart.csv: one line a rendering, shares of the picture's brightness, not per cent.
pub fn write_csv(path: &Path, chart: &Chart) -> Result<(), ReportError> {
    write_text(path, &csv(chart))
}

/// Writes chart.svg.
pub fn write_svg(path: &Path, chart: &Chart) -> Result<(), ReportError> {
    write_text(path, &svg(chart))
}

fn csv(chart: &Chart) -> String {
    let mut text = "method,group,unbiased,cpu_seconds,seconds,samples,stated_error,error,\
                    error_on_objects,error_beside,bias,\
                    bias_sigma,reference_error,chosen\n"
        .to_owned();
    let told = |error: Option<f64>| error.map_or(String::new(), |error| format!("{error:.6}"));
    let mut line = |curve: &Curve, point: &Point, chosen: bool| {
        let Point { cpu_seconds, seconds, samples, stated, bias, bias_sigma, .. } = point;
        text += &format!(
            "{},{},{},{cpu_seconds:.4},{seconds:.4},{samples},{stated:.6},{},{},{},{bias:.6},\
             {bias_sigma:.6},{:.6},{chosen}\n",
            curve.name,
            curve.group.name(),
            curve.bias.is_none(),
            told(point.error),
            told(point.on_objects),
            told(point.beside),
            chart.reference.error,
        );
    };
    for curve in &chart.curves {
        curve.points.iter().for_each(|point| line(curve, point, false));
    }
    if let (Some(auto), Some(chosen)) = (chart.curves.first(), &chart.chosen) {
        line(auto, chosen, true);
    }
    text
}

/// What a person wants to know of a chart on the terminal.
pub fn summary(chart: &Chart) -> String {
    let percent = super::text::per_cent;
    let [width, height] = chart.size;
    let mut lines = vec![
        format!("picture    {width} × {height} px, 1/{} of the plate", chart.reduced),
        format!(
            "reference  error {} over {} px, {:.1} CPU s",
            percent(chart.reference.error),
            chart.reference.pixels,
            chart.reference.cpu_seconds
        ),
    ];
    for curve in &chart.curves {
        let Some(last) = curve.points.last() else { continue };
        let error = told(last.error, &chart.reference);
        lines.push(format!(
            "{:<24} error {error} in {:.2} CPU s, bias {} ± {}{}",
            curve.name,
            last.cpu_seconds,
            signed(last.bias),
            percent(last.bias_sigma),
            curve.bias.map_or(String::new(), |why| format!(" ({why})")),
        ));
    }
    if let Some(chosen) = &chart.chosen {
        let error = told(chosen.error, &chart.reference);
        lines.push(format!(
            "chosen     {}: error {error} in {:.2} CPU s",
            chart.stop, chosen.cpu_seconds
        ));
    }
    lines.extend(sentence(chart).map(|verdict| format!("verdict    {verdict}")));
    lines.extend(chart.notes.iter().map(|note| format!("note       {note}")));
    lines.join("\n")
}

/// An error in per cent; what is smaller than the reference's own is said to be.
pub fn told(error: Option<f64>, reference: &Reference) -> String {
    match error {
        None => "below the reference's own".to_owned(),
        Some(error) if error < reference.error => {
            format!("{}, within the reference's own", super::text::per_cent(error))
        }
        Some(error) => super::text::per_cent(error),
    }
}

fn signed(share: f64) -> String {
    let sign = if share < 0.0 { "−" } else { "+" };
    format!("{sign}{}", super::text::per_cent(share.abs()))
}

/// The chart's verdict in words, if it has one.
fn sentence(chart: &Chart) -> Option<String> {
    let verdict = chart.verdict.as_ref()?;
    let at = format!("at {:.2} CPU s", verdict.cpu_seconds);
    let how = if verdict.extrapolated { " if its last rendering went on" } else { "" };
    let [own, best] =
        [verdict.error, verdict.best_error].map(|error| told(Some(error), &chart.reference));
    let name = verdict.best;
    Some(match verdict.ratio() {
        ratio if ratio <= 1.0 => format!(
            "{at} no unbiased method has less error than the shot's settings ({own}; next is {name}, \
             {best}{how})"
        ),
        ratio => format!(
            "{at} the shot's settings have {ratio:.2} times the error of the best unbiased method \
             ({own}; {name}, {best}{how})"
        ),
    })
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub fn chart() -> Chart {
        let point = |cpu_seconds: f64, error: f64| Point {
            cpu_seconds,
            seconds: 0.5 * cpu_seconds,
            samples: 1000,
            stated: error,
            error: (error > 0.001).then_some(error),
            on_objects: None,
            beside: Some(error),
            bias: -0.1 * error,
            bias_sigma: 0.03 * error,
        };
        let curve = |name, group, factor: f64, bias| Curve {
            name,
            group,
            does: "something",
            bias,
            points: (0..5)
                .map(|k| 0.05 * 4.0_f64.powi(k))
                .map(|cost| point(cost, factor * 0.02 / cost.sqrt()))
                .collect(),
        };
        Chart {
            name: "test".to_owned(),
            program: "platelight",
            seed: 0,
            size: [320, 200],
            reduced: 3,
            auto: "coupled".to_owned(),
            stop: "error 1 %".to_owned(),
            target: Some(0.01),
            reference: Reference { error: 0.001, cpu_seconds: 60.0, samples: 10, pixels: 4000 },
            curves: vec![
                curve("auto", Group::Methods, 1.0, None),
                curve("two-pass", Group::Methods, 4.0, None),
                curve("mis", Group::Directions, 2.0, None),
                curve("depth-1", Group::Depth, 1.3, Some("reflected light")),
                curve("median-cut-64", Group::Lights, 0.9, Some("what lies between")),
            ],
            chosen: Some(point(4.0, 0.01)),
            verdict: Some(Verdict {
                cpu_seconds: 4.0,
                error: 0.01,
                best: "mis",
                best_error: 0.02,
                extrapolated: false,
            }),
            notes: vec!["a note".to_owned()],
            files: Vec::new(),
        }
    }

    #[test]
    fn the_table_has_a_line_for_every_rendering() {
        let text = csv(&chart());
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 1 + 25 + 1);
        let columns = lines[0].split(',').count();
        assert!(lines.iter().all(|line| line.split(',').count() == columns), "{text}");
        assert!(lines[26].ends_with(",true") && lines[26].starts_with("auto,methods,true"));
    }

    #[test]
    fn the_summary_names_every_method_and_the_verdict() {
        let text = summary(&chart());
        for told in ["two-pass", "depth-1", "reflected light", "no unbiased method", "a note"] {
            assert!(text.contains(told), "{told}: {text}");
        }
        assert!(!text.contains("within the reference's own"), "{text}");
    }

    #[test]
    fn errors_that_the_reference_cannot_tell_are_said_to_be_within_its_own() {
        let chart = Chart { reference: Reference { error: 0.015, ..chart().reference }, ..chart() };
        let text = summary(&chart);
        let line = |start: &str| text.lines().find(|line| line.starts_with(start)).unwrap();
        assert!(line("chosen").contains("error 1.0 %, within the reference's own in"), "{text}");
        assert!(line("two-pass").contains("error 2.2 % in"), "{text}");
        assert!(line("verdict").contains("(1.0 %, within the reference's own; next"), "{text}");
        assert_eq!(told(None, &chart.reference), "below the reference's own");
    }
}
