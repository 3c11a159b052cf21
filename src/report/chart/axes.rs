//! The chart as marks on paper: panels with logarithmic axes, curves, legends.
//!
//! A panel for each [`Group`] that has curves, error above and bias below, all with the same axes; what
//! the shot's settings choose is the black curve in every panel. Nothing here knows what a picture file is.

use glam::DVec2;

use super::{Chart, Curve, Group, Point};
use crate::report::canvas::Colour;

/// Size of the paper, px.
pub const WIDTH: f64 = 1920.0;
pub const HEIGHT: f64 = 1180.0;
/// From the paper's edge to the first panel, and from a panel to the next, px.
const LEFT: f64 = 120.0;
const BETWEEN: f64 = 80.0;
/// A bias of more standard errors than this is shown as one. All methods are held against the same
/// reference: its noise moves them together, two of its standard errors in one chart of twenty.
const SURE: f64 = 3.0;
/// A letter of the picture's text, px: width with its gap, height.
pub const LETTER: DVec2 = DVec2::new(12.0, 14.0);

pub const BLACK: Colour = [0, 0, 0];
const GREY: Colour = [205, 205, 205];
const DARK: Colour = [90, 90, 90];
const RED: Colour = [200, 30, 30];
/// Okabe and Ito's colours, told apart by every kind of eye, and two more.
const COLOURS: [Colour; 8] = [
    [213, 94, 0],
    [0, 114, 178],
    [0, 158, 115],
    [204, 121, 167],
    [230, 159, 0],
    [86, 180, 233],
    [120, 94, 60],
    [140, 140, 140],
];

/// Where a text's given point is in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Anchor {
    Start,
    Middle,
    End,
}

/// Something drawn. Points in px from the paper's upper left.
#[derive(Clone, Debug)]
pub enum Mark {
    Line {
        points: Vec<DVec2>,
        colour: Colour,
        width: f64,
        dashed: bool,
    },
    /// Filled, or the paper's colour with a rim.
    Dot {
        at: DVec2,
        radius: f64,
        colour: Colour,
        filled: bool,
    },
    /// `at` is on the letters' foot.
    Text {
        at: DVec2,
        text: String,
        colour: Colour,
        anchor: Anchor,
    },
}

/// One axis: what its ends stand for, and where they lie on the paper.
#[derive(Clone, Copy)]
struct Axis {
    /// Each 1, 2 or 5 times a power of ten.
    range: [f64; 2],
    ends: [f64; 2],
}

impl Axis {
    /// Between the steps round all values above 0, at least a factor of five apart; of more than `most`
    /// decades the highest.
    fn new(values: impl Iterator<Item = f64>, most: i32, ends: [f64; 2]) -> Self {
        let positive = values.filter(|v| *v > 0.0 && v.is_finite());
        let (low, high) =
            positive.fold((f64::INFINITY, 0.0_f64), |(low, high), v| (low.min(v), high.max(v)));
        if high <= 0.0 {
            return Self { range: [0.01, 1.0], ends };
        }
        let high = steps(high).find(|step| *step >= high * (1.0 - ROUNDING)).unwrap_or(high);
        let low = low.clamp(high / 10f64.powi(most), 0.2 * high);
        let below = steps(low).take_while(|step| *step <= low * (1.0 + ROUNDING)).last();
        Self { range: [below.unwrap_or(low), high], ends }
    }

    fn at(&self, value: f64) -> f64 {
        let [low, high] = self.range.map(f64::ln);
        let share = (value.max(1e-300).ln() - low) / (high - low);
        self.ends[0] + (self.ends[1] - self.ends[0]) * share.clamp(0.0, 1.0)
    }

    fn holds(&self, value: f64) -> bool {
        value >= self.range[0] * (1.0 - ROUNDING) && !self.ends_below(value)
    }

    fn ends_below(&self, value: f64) -> bool {
        value > self.range[1] * (1.0 + ROUNDING)
    }

    /// Every decade, and 2 and 5 of each where there are few.
    fn ticks(&self) -> Vec<f64> {
        let [low, high] = self.range;
        let few = high / low < 300.0;
        let decades = (low.log10().floor() as i32)..=(high.log10().ceil() as i32);
        let kept: &[f64] = if few { &[1.0, 2.0, 5.0] } else { &[1.0] };
        decades
            .flat_map(|decade| kept.iter().map(move |step| step * 10f64.powi(decade)))
            .filter(|&tick| self.holds(tick))
            .collect()
    }
}

/// Of products of steps and powers of ten.
const ROUNDING: f64 = 1e-9;

/// 1, 2 and 5 times the power of ten at or below `value`, and the next one.
fn steps(value: f64) -> impl Iterator<Item = f64> {
    let decade = 10f64.powi(value.log10().floor() as i32);
    [1.0, 2.0, 5.0, 10.0].into_iter().map(move |step| step * decade)
}

/// The largest error that is shown: ten times the largest of the shot's own settings. Methods beyond
/// would press all others into a corner.
fn largest_shown(chart: &Chart) -> f64 {
    let own = chart.curves.first().into_iter().flat_map(|curve| &curve.points).chain(&chart.chosen);
    let largest = own.filter_map(|point| point.error).fold(0.0, f64::max);
    if largest > 0.0 { 10.0 * largest } else { f64::INFINITY }
}

/// Groups with a curve beside the shot's own settings; with none, the one that those are in.
fn groups(chart: &Chart) -> Vec<Group> {
    let others = || chart.curves.iter().skip(1);
    let shown: Vec<Group> = Group::ALL
        .into_iter()
        .filter(|group| others().any(|curve| curve.group == *group))
        .collect();
    if shown.is_empty() { vec![Group::Methods] } else { shown }
}

/// Everything to be drawn, in order.
pub fn marks(chart: &Chart) -> Vec<Mark> {
    let mut marks = Vec::new();
    heading(chart, &mut marks);
    let points = || chart.curves.iter().flat_map(|curve| &curve.points).chain(&chart.chosen);
    let (groups, largest) = (groups(chart), largest_shown(chart));
    let pitch = (WIDTH - LEFT) / groups.len() as f64;
    for (column, group) in groups.into_iter().enumerate() {
        let left = LEFT + pitch * column as f64;
        let x = Axis::new(points().map(|p| p.cpu_seconds), 6, [left, left + pitch - BETWEEN]);
        let errors = points().filter_map(|p| p.error).filter(|error| *error <= largest);
        let errors = errors.chain(chart.target);
        let y = Axis::new(errors.chain([chart.reference.error]), 5, [560.0, 164.0]);
        let error = Panel { x, y, value: |point| point.error, first: column == 0 };
        error.frame(group.title(), "error", "", &mut marks);
        // Their names on the sides that look away from each other
        let own = chart.reference.error;
        let above = chart.target.is_none_or(|target| own > target);
        error.level(own, "reference", above, DARK, &mut marks);
        if let Some(target) = chart.target {
            error.level(target, "asked for", !above, RED, &mut marks);
        }
        let biases = points().map(|p| p.bias.abs().max(p.bias_sigma));
        let biases = biases.filter(|bias| *bias <= largest);
        let y = Axis::new(biases, 5, [900.0, 640.0]);
        let bias = Panel { x, y, value: |point| Some(point.bias.abs()), first: column == 0 };
        bias.frame("", "bias", "CPU seconds", &mut marks);

        let others = chart.curves.iter().skip(1).filter(|curve| curve.group == group);
        let auto = chart.curves.first().into_iter().map(|curve| (curve, BLACK));
        let coloured: Vec<(&Curve, Colour)> = others.zip(COLOURS.into_iter().cycle()).collect();
        for (row, (curve, colour)) in coloured.into_iter().chain(auto).enumerate() {
            error.curve(curve, colour, |_| true, &mut marks);
            bias.curve(curve, colour, |p| p.bias.abs() > SURE * p.bias_sigma, &mut marks);
            let at = DVec2::new(left, 990.0 + 22.0 * row as f64);
            let shown = curve.points.iter().any(|point| error.place(point).is_some());
            legend(curve, shown, colour, at, &mut marks);
        }
        if let Some(chosen) = &chart.chosen {
            error.ring(chosen, &mut marks);
            bias.ring(chosen, &mut marks);
        }
    }
    marks
}

fn heading(chart: &Chart, marks: &mut Vec<Mark>) {
    let [width, height] = chart.size;
    let percent = crate::report::text::per_cent;
    let ring = match &chart.chosen {
        Some(_) => format!(" Ring: where {} stops the shot's own settings (auto).", chart.stop),
        None => String::new(),
    };
    let lines = [
        format!("{}: error and bias over CPU seconds", chart.name),
        format!(
            "{width} x {height} px, 1/{} of the plate. Reference: good to {}.{ring}",
            chart.reduced,
            percent(chart.reference.error),
        ),
        format!(
            "Relative to the picture's brightness, root mean square over the influence region. Hollow: \
             bias within {SURE:.0} standard errors of 0."
        ),
    ];
    for (line, text) in lines.into_iter().enumerate() {
        let at = DVec2::new(40.0, 34.0 + 24.0 * line as f64);
        marks.push(Mark::Text { at, text, colour: BLACK, anchor: Anchor::Start });
    }
}

fn legend(curve: &Curve, shown: bool, colour: Colour, at: DVec2, marks: &mut Vec<Mark>) {
    let middle = at - DVec2::Y * 0.5 * LETTER.y;
    let points = vec![middle, middle + DVec2::X * 34.0];
    marks.push(Mark::Line { points, colour, width: 2.5, dashed: curve.bias.is_some() });
    marks.push(Mark::Dot { at: middle + DVec2::X * 17.0, radius: 4.0, colour, filled: true });
    let remark = match (curve.bias.is_some(), shown) {
        (true, true) => " (biased)",
        (false, true) => "",
        // Above the axis, or below what the reference can tell
        (_, false) => " (not shown)",
    };
    let text = format!("{}{remark}", curve.name);
    let at = at + DVec2::X * 46.0;
    marks.push(Mark::Text { at, text, colour: BLACK, anchor: Anchor::Start });
}

/// One pair of axes and what it shows of a point.
struct Panel {
    x: Axis,
    y: Axis,
    value: fn(&Point) -> Option<f64>,
    /// It has the numbers of the vertical axis.
    first: bool,
}

impl Panel {
    fn frame(&self, title: &str, name: &str, below: &str, marks: &mut Vec<Mark>) {
        let ([left, right], [bottom, top]) = (self.x.ends, self.y.ends);
        let mut text = |x: f64, y: f64, text: String, anchor: Anchor| {
            marks.push(Mark::Text { at: DVec2::new(x, y), text, colour: BLACK, anchor });
        };
        text(left, top - 40.0, title.to_owned(), Anchor::Start);
        text(0.5 * (left + right), bottom + 54.0, below.to_owned(), Anchor::Middle);
        if self.first {
            text(left - 12.0, top - 14.0, name.to_owned(), Anchor::End);
        }
        let mut free = f64::NEG_INFINITY;
        for tick in self.x.ticks() {
            let (at, label) = (self.x.at(tick), number(tick));
            let half = 0.5 * LETTER.x * label.len() as f64;
            if at - half > free {
                text(at, bottom + 30.0, label, Anchor::Middle);
                free = at + half + LETTER.x;
            }
        }
        for tick in self.y.ticks().into_iter().filter(|_| self.first) {
            let at = self.y.at(tick) + 0.5 * LETTER.y;
            text(left - 12.0, at, format!("{}%", number(100.0 * tick)), Anchor::End);
        }
        let mut line = |from: [f64; 2], to: [f64; 2], colour: Colour, width: f64| {
            let points = vec![DVec2::from(from), DVec2::from(to)];
            marks.push(Mark::Line { points, colour, width, dashed: false });
        };
        for at in self.x.ticks().into_iter().map(|tick| self.x.at(tick)) {
            line([at, bottom], [at, top], GREY, 1.0);
        }
        for at in self.y.ticks().into_iter().map(|tick| self.y.at(tick)) {
            line([left, at], [right, at], GREY, 1.0);
        }
        line([left, bottom], [right, bottom], DARK, 2.0);
        line([left, bottom], [left, top], DARK, 2.0);
    }

    /// A dashed line across at a value, with its name above or below it: on the left, where cheap
    /// renderings leave the lower part free.
    fn level(&self, value: f64, name: &str, above: bool, colour: Colour, marks: &mut Vec<Mark>) {
        if !self.y.holds(value) {
            return;
        }
        let [left, right] = self.x.ends;
        let y = self.y.at(value);
        let points = vec![DVec2::new(left, y), DVec2::new(right, y)];
        marks.push(Mark::Line { points, colour, width: 1.5, dashed: true });
        // Below the lowest line stand the numbers of the axis.
        let above = above || y + 6.0 + LETTER.y > self.y.ends[0];
        let at = DVec2::new(left + 6.0, if above { y - 6.0 } else { y + 6.0 + LETTER.y });
        marks.push(Mark::Text { at, text: name.to_owned(), colour, anchor: Anchor::Start });
    }

    /// `None` of what lies above the axis; what lies below it is at its foot.
    fn place(&self, point: &Point) -> Option<DVec2> {
        let value = (self.value)(point).filter(|value| !self.y.ends_below(*value))?;
        Some(DVec2::new(self.x.at(point.cpu_seconds), self.y.at(value)))
    }

    fn curve(
        &self,
        curve: &Curve,
        colour: Colour,
        filled: impl Fn(&Point) -> bool,
        marks: &mut Vec<Mark>,
    ) {
        let width = if colour == BLACK { 3.5 } else { 2.5 };
        let points = curve.points.iter().filter_map(|point| self.place(point)).collect();
        marks.push(Mark::Line { points, colour, width, dashed: curve.bias.is_some() });
        for point in &curve.points {
            let Some(at) = self.place(point) else { continue };
            marks.push(Mark::Dot { at, radius: 4.0, colour, filled: filled(point) });
        }
    }

    fn ring(&self, point: &Point, marks: &mut Vec<Mark>) {
        let Some(at) = self.place(point) else { return };
        marks.push(Mark::Dot { at, radius: 10.0, colour: BLACK, filled: false });
        marks.push(Mark::Dot { at, radius: 3.0, colour: BLACK, filled: true });
    }
}

/// "0.05", "1", "200": no more digits than it has.
fn number(value: f64) -> String {
    let digits = (-value.log10().floor()).clamp(0.0, 6.0) as usize;
    format!("{value:.digits$}")
}

#[cfg(test)]
mod tests {
    use super::super::tests::chart;
    use super::*;

    #[test]
    fn an_axis_holds_its_values_between_steps_of_one_two_and_five() {
        let labels = |values: &[f64], most| {
            let axis = Axis::new(values.iter().copied(), most, [0.0, 300.0]);
            axis.ticks().into_iter().map(number).collect::<Vec<_>>()
        };
        assert_eq!(
            labels(&[0.03, 4.0, 0.0, f64::NAN], 6),
            ["0.02", "0.05", "0.1", "0.2", "0.5", "1", "2", "5"]
        );
        assert_eq!(labels(&[0.3], 6), ["0.1", "0.2", "0.5"]);
        assert_eq!(labels(&[0.5], 6), ["0.1", "0.2", "0.5"]);
        assert_eq!(labels(&[], 6), ["0.01", "0.02", "0.05", "0.1", "0.2", "0.5", "1"]);
        assert_eq!(labels(&[1e-9, 1.0], 3), ["0.001", "0.01", "0.1", "1"]);
        let axis = Axis::new([0.01, 10.0].into_iter(), 6, [0.0, 300.0]);
        assert!((axis.at(0.1) - 100.0).abs() < 1e-9 && axis.at(1e9) == 300.0);
    }

    #[test]
    fn what_was_not_asked_for_has_no_panel_and_what_is_hopeless_stretches_no_axis() {
        let texts = |chart: &Chart| -> Vec<String> {
            let text = |mark| match mark {
                Mark::Text { text, .. } => Some(text),
                Mark::Line { .. } | Mark::Dot { .. } => None,
            };
            marks(chart).into_iter().filter_map(text).collect()
        };
        let mut chart = chart();
        let whole = texts(&chart);
        for group in Group::ALL {
            assert!(whole.iter().any(|text| text == group.title()), "{group:?}");
        }
        assert!(!whole.iter().any(|text| text == "500%"), "{whole:?}");
        chart.curves.truncate(2);
        for point in &mut chart.curves[1].points {
            point.error = Some(3.0);
        }
        let some = texts(&chart);
        assert!(some.iter().any(|text| text == Group::Methods.title()));
        assert!(!some.iter().any(|text| text == Group::Depth.title()));
        assert!(some.iter().any(|text| text == "two-pass (not shown)"), "{some:?}");
        assert!(!some.iter().any(|text| text == "500%"), "{some:?}");
    }

    #[test]
    fn all_marks_lie_on_the_paper_and_texts_do_not_leave_it() {
        for mark in marks(&chart()) {
            let paper = |p: &DVec2| p.x >= 0.0 && p.y >= 0.0 && p.x <= WIDTH && p.y <= HEIGHT;
            match &mark {
                Mark::Line { points, .. } => assert!(points.iter().all(paper), "{mark:?}"),
                Mark::Dot { at, .. } => assert!(paper(at), "{mark:?}"),
                Mark::Text { at, text, anchor, .. } => {
                    let wide = LETTER.x * text.chars().count() as f64;
                    let left = match anchor {
                        Anchor::Start => at.x,
                        Anchor::Middle => at.x - 0.5 * wide,
                        Anchor::End => at.x - wide,
                    };
                    assert!(left >= 0.0 && left + wide <= WIDTH && at.y <= HEIGHT, "{mark:?}");
                }
            }
        }
    }
}
