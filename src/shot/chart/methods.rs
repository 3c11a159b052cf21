//! The rows of a chart: what can be charted, by name.

use crate::light::Draws;
use crate::render::{Blocked, Method, Technique};
use crate::report::chart::Group;
use crate::shot::keys::nearest;

/// A way to render the shot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row {
    pub name: &'static str,
    pub group: Group,
    /// What it does, in a sentence without a full stop.
    pub does: &'static str,
    pub method: Method,
    pub technique: Technique,
    pub denoise: bool,
    /// What it leaves out for good.
    pub bias: Option<&'static str>,
}

/// The shot's own settings.
pub const AUTO: &str = "auto";

/// What the denoiser leaves out, or adds.
pub const MOVED: &str = "what the filter moves between pixels";
const PATCHES: &str = "shadows are sums of hard ones";
const DEPTHS: [(&str, u32, &str, &str); 4] = [
    (
        "depth-1",
        1,
        "what objects block, and objects in direct light",
        "nothing that objects send to local surfaces",
    ),
    ("depth-2", 2, "and what such objects send to local surfaces", "light reflected twice"),
    ("depth-3", 3, "three edges after the camera's", "light reflected three times and more"),
    ("depth-4", 4, "four edges after the camera's", "light reflected four times and more"),
];
const LISTS: [(&str, Blocked, &str); 6] = [
    ("patches-64", Blocked::Patches(64), "blocked light from 64 equal patches of the panorama"),
    ("patches-256", Blocked::Patches(256), "the same with 256"),
    ("patches-1024", Blocked::Patches(1024), "the same with 1024"),
    ("median-cut-64", Blocked::MedianCut(64), "blocked light from 64 parts of equal power"),
    ("median-cut-256", Blocked::MedianCut(256), "the same with 256"),
    ("median-cut-1024", Blocked::MedianCut(1024), "the same with 1024"),
];

fn row(name: &'static str, group: Group, does: &'static str, technique: Technique) -> Row {
    let method = Method::Coupled;
    Row { name, group, does, method, technique, denoise: false, bias: None }
}

/// The default method, unfiltered.
pub fn coupled() -> Row {
    let default = Technique::default();
    row("coupled", Group::Methods, "one path in two worlds: the default", default)
}

/// Every row but the shot's own settings.
pub fn all() -> Vec<Row> {
    let default = Technique::default();
    let two_pass = |same_numbers| Method::TwoPass { same_numbers };
    let coupled = coupled();
    let mut rows = vec![
        Row {
            name: "two-pass-independent",
            method: two_pass(false),
            does: "two pictures by textbook path tracing, subtracted",
            ..coupled
        },
        Row {
            name: "two-pass",
            method: two_pass(true),
            does: "the same from the same random numbers",
            ..coupled
        },
        coupled,
        Row {
            name: "denoised",
            denoise: true,
            does: "the default, filtered where two halves of the samples prove it better",
            bias: Some(MOVED),
            ..coupled
        },
    ];
    let improved = |name, does, technique| row(name, Group::Methods, does, technique);
    rows.extend([
        improved(
            "no-cells",
            "the default with blocked light by the same draws as all else",
            Technique { blocked: Blocked::Draws, ..default },
        ),
        improved(
            "cells",
            "the default with blocked light by draws over cells of the lights",
            Technique { blocked: Blocked::Cells, ..default },
        ),
        improved(
            "no-compensation",
            "the default with all light in the lights' table, not what exceeds the mean",
            Technique { draws: Draws::Whole, ..default },
        ),
    ]);
    let directed = |name, does, technique| row(name, Group::Directions, does, technique);
    rows.extend([
        directed(
            "uniform",
            "matt local points look evenly over their hemisphere",
            Technique { evenly: true, ..Technique::plain(Draws::Never) },
        ),
        directed("bsdf", "directions by the BSDF alone", Technique::plain(Draws::Never)),
        directed(
            "environment",
            "far light by the panorama's table alone",
            Technique::plain(Draws::Alone),
        ),
        directed("mis", "both, by the balance heuristic", Technique::plain(Draws::Whole)),
        directed(
            "mis-compensated",
            "both, the table of what exceeds the mean",
            Technique::plain(Draws::AsMade),
        ),
    ]);
    rows.extend(DEPTHS.map(|(name, edges, does, bias)| {
        let technique = Technique::up_to_depth(edges);
        Row { bias: Some(bias), ..row(name, Group::Depth, does, technique) }
    }));
    rows.extend(LISTS.map(|(name, blocked, does)| {
        let technique = Technique { blocked, ..default };
        Row { bias: Some(PATCHES), ..row(name, Group::Lights, does, technique) }
    }));
    rows
}

/// The rows of these names, each once, in the order of [`all`]; all of them for no names.
///
/// # Errors
/// Names that are none, with the nearest that is one.
pub fn named(names: &[String]) -> Result<Vec<Row>, String> {
    let rows = all();
    let known: Vec<&str> = rows.iter().map(|row| row.name).collect();
    for name in names.iter().filter(|name| *name != AUTO) {
        if !known.contains(&name.as_str()) {
            let remedy = match nearest(name, &known) {
                Some(near) => format!("did you mean {near}?"),
                None => format!("known: {}", known.join(", ")),
            };
            return Err(format!("--methods: \"{name}\" is no method; {remedy}"));
        }
    }
    let wanted = |row: &Row| names.is_empty() || names.iter().any(|name| name == row.name);
    Ok(rows.into_iter().filter(wanted).collect())
}

/// What is left of the rows asked for, and what is to be said of the others.
pub struct Sorted {
    pub kept: Vec<Row>,
    /// Names of rows that come out as another one does, with that one's.
    pub repeats: Vec<(&'static str, &'static str)>,
    /// Names of rows whose way to blocked light cannot be gone here.
    pub impossible: Vec<&'static str>,
}

impl Sorted {
    /// A sentence for each that is left out.
    pub fn notes(&self) -> Vec<String> {
        let same =
            self.repeats.iter().map(|(name, other)| format!("{name} is what {other} does here"));
        let names = self.impossible.join(", ");
        let none = (!self.impossible.is_empty()).then(|| {
            format!(
                "left out: {names}; they need light that comes from the same directions everywhere, as that \
                 of near walls does not"
            )
        });
        same.chain(none).collect()
    }
}

/// Takes out rows that come out as an earlier row or `auto` does, or cannot be had, where `resolved` says
/// what a choice comes to.
pub fn sort(auto: &Row, rows: Vec<Row>, resolved: impl Fn(Blocked) -> Blocked) -> Sorted {
    let does = |row: &Row| {
        let blocked = resolved(row.technique.blocked);
        (row.method, Technique { blocked, ..row.technique }, row.denoise)
    };
    let mut kept: Vec<Row> = Vec::new();
    let (mut repeats, mut impossible) = (Vec::new(), Vec::new());
    for row in rows {
        let asked = row.technique.blocked;
        if asked != Blocked::Auto && resolved(asked) != asked {
            impossible.push(row.name);
            continue;
        }
        let same = std::iter::once(auto).chain(&kept).find(|other| does(other) == does(&row));
        match same {
            Some(other) => repeats.push((row.name, other.name)),
            None => kept.push(row),
        }
    }
    Sorted { kept, repeats, impossible }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::conventions::Rgb;
    use crate::light::{Cells, Environment, Lights, Proxy};
    use crate::render::blocked::CELLS;

    #[test]
    fn rows_say_whether_they_are_biased_as_their_technique_does() {
        let rows = all();
        for row in &rows {
            assert_eq!(
                row.bias.is_some(),
                !row.technique.only_noise_differs() || row.denoise,
                "{}",
                row.name
            );
            assert_eq!(rows.iter().filter(|other| other.name == row.name).count(), 1);
        }
    }

    #[test]
    fn a_misspelt_method_is_told_with_the_one_meant() {
        let names = |text: &str| text.split(',').map(str::to_owned).collect::<Vec<_>>();
        let error = named(&names("coupled,two-pas")).unwrap_err();
        assert!(error.contains("\"two-pas\"") && error.contains("two-pass?"), "{error}");
        let rows = named(&names("mis,auto,two-pass")).unwrap();
        assert_eq!(rows.iter().map(|row| row.name).collect::<Vec<_>>(), ["two-pass", "mis"]);
        assert_eq!(named(&[]).unwrap().len(), all().len());
    }

    #[test]
    fn what_auto_chooses_is_not_measured_twice() {
        let lights = Lights::from_parts(Environment::constant(Rgb::ONE), Vec::new());
        let cells = Cells::new(&lights, CELLS);
        let auto = Row { name: AUTO, ..coupled() };
        let sorted = sort(&auto, all(), |blocked| blocked.resolved(&lights, &cells));
        // A constant sky has no suns: cells pay.
        assert_eq!(sorted.repeats, [("coupled", AUTO), ("cells", AUTO)]);
        assert_eq!(sorted.kept.len(), all().len() - 2);
    }

    #[test]
    fn lists_of_lights_that_near_walls_forbid_are_not_said_to_be_what_auto_does() {
        let walls = Proxy::of_box(Vec3::ZERO, Vec3::splat(-2.0), Vec3::splat(2.0));
        let lights = Lights::from_parts(Environment::constant(Rgb::ONE), Vec::new());
        let lights = lights.near(Vec3::ZERO, walls, Vec::new());
        let cells = Cells::new(&lights, CELLS);
        let auto = Row { name: AUTO, ..coupled() };
        let sorted = sort(&auto, all(), |blocked| blocked.resolved(&lights, &cells));
        assert_eq!(sorted.repeats, [("coupled", AUTO), ("no-cells", AUTO)]);
        assert_eq!(sorted.impossible.len(), 7, "{:?}", sorted.impossible);
        let said = sorted.notes().join("\n");
        assert!(
            said.contains("left out: cells, patches-64") && said.contains("near walls"),
            "{said}"
        );
    }
}
