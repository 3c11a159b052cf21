//! report.html: one page with before and after, numbers, warnings and overlays; no network, no
//! libraries, pictures beside it.

use std::path::Path;

use maud::{DOCTYPE, Markup, PreEscaped, html};

use super::text::{denoised, per_cent};
use super::{CameraReport, Picture, Report, ReportError, Warning, counted, photographs};

const STYLE: &str = "
body{font:15px/1.5 system-ui,sans-serif;max-width:1100px;margin:2rem auto;padding:0 1rem;color:#222;background:#fafafa}
h1{font-size:1.6rem}h2{font-size:1.15rem;margin-top:2.2rem;border-bottom:1px solid #ccc}
table{border-collapse:collapse}td,th{padding:.15rem .9rem .15rem 0;text-align:left;vertical-align:top}
td.n{text-align:right;font-variant-numeric:tabular-nums}
.pair{position:relative}.pair img{width:100%;display:block}.pair img+img{position:absolute;inset:0}
input[type=range]{width:100%}.ends{display:flex;justify-content:space-between;margin-top:0}figure{margin:1rem 0}figure img{max-width:100%}figcaption,.note{color:#555}
.warning{border-left:4px solid #d80;padding:.2rem .8rem;margin:.5rem 0;background:#fff6e5}
details pre{overflow:auto;background:#eee;padding:.6rem}
@media(prefers-color-scheme:dark){body{background:#1b1b1b;color:#ddd}.warning{background:#3a2d10}figcaption,.note{color:#aaa}details pre{background:#2a2a2a}}";

/// Moves the border between the two pictures.
const SLIDE: &str = "this.previousElementSibling.lastElementChild.style.clipPath=\
                     'inset(0 0 0 '+this.value+'%)'";

/// The head of a page; `more` goes on with the style.
pub(super) fn head(title: &str, more: &str) -> Markup {
    html! {
        head {
            meta charset="utf-8";
            meta name="viewport" content="width=device-width";
            title { (title) " – Platelight" }
            style { (PreEscaped(STYLE)) (PreEscaped(more)) }
        }
    }
}

/// Writes a page whole or not at all.
pub(super) fn write_page(path: &Path, page: &Markup) -> Result<(), ReportError> {
    super::write_text(path, &page.0)
}

/// Writes report.html; `before` and `after` are file names beside it.
pub fn write_html(
    path: &Path,
    report: &Report,
    before: &str,
    after: &str,
) -> Result<(), ReportError> {
    write_page(path, &page(report, before, after))
}

fn page(report: &Report, before: &str, after: &str) -> Markup {
    html! {
        (DOCTYPE)
        html lang="en" {
            (head(&name(report), ""))
            body {
                h1 { (name(report)) }
                p.note { "Platelight report on " (report.plate.file.display()) }
                div.pair {
                    img src=(before) alt="the plate";
                    img src=(after) alt="the plate with the objects" style="clip-path:inset(0 0 0 0%)";
                }
                input type="range" min="0" max="100" value="0" oninput=(SLIDE)
                    aria-label="before and after";
                p.note.ends { span { "result" } span { "plate" } }
                (warnings(report))
                (budget(report))
                h2 { "Camera" } (camera(report))
                h2 { "Pose" } (pose(report))
                h2 { "Probe and light" } (probe(report))
                h2 { "Render and composite" } (render(report))
                @if !report.pictures.is_empty() { h2 { "Overlays" } }
                @for picture in &report.pictures { (figure(picture)) }
                h2 { "Time" } (stages(report))
                details {
                    summary { "Settings" }
                    pre { (serde_json::to_string_pretty(&report.shot).unwrap_or_default()) }
                }
                p.note { (report.program) ", seed " (report.seed) }
            }
        }
    }
}

fn name(report: &Report) -> String {
    let path = report.shot.get("path").and_then(|path| path.as_str()).map(Path::new);
    path.map_or("shot".to_owned(), shot_name)
}

/// What people call a shot: its folder, or the file where that is not called shot.toml.
pub fn shot_name(path: &Path) -> String {
    let text = |name: &std::ffi::OsStr| name.to_string_lossy().into_owned();
    let path = path.canonicalize().unwrap_or_else(|_| path.to_owned());
    let name = path.file_stem().and_then(|stem| match stem {
        stem if stem == "shot" => path.parent()?.file_name().map(text),
        stem => Some(text(stem)),
    });
    name.unwrap_or_else(|| "shot".to_owned())
}

fn warnings(report: &Report) -> Markup {
    html! {
        h2 { "Warnings" }
        @if report.warnings.is_empty() { p { "None." } }
        @for warning in &report.warnings {
            div.warning { (sentence(warning)) }
        }
        @if !report.notes.is_empty() {
            details {
                summary { (counted(report.notes.len(), "note")) ", nothing to act on" }
                @for note in &report.notes { p.note { (sentence(note)) } }
            }
        }
    }
}

fn sentence(warning: &Warning) -> Markup {
    html! {
        b { (warning.about) } ": " (warning.message) "."
        @if !warning.size.is_empty() { br; i { "Effect: " (warning.size) } }
    }
}

fn budget(report: &Report) -> Markup {
    html! {
        h2 { "How wrong it may be" }
        @if let Some(cause) = &report.budget.dominated_by {
            p { "The largest known effect on brightness: " b { (cause) } "." }
        }
        table {
            tr { th { "cause" } th { "1 σ" } th { "brightness" } th { "how it is known" } }
            @for term in &report.budget.terms {
                tr {
                    td { (term.cause) }
                    td.n { @match term.sigma {
                        Some(sigma) => { (significant(sigma)) " " (term.unit) }
                        None => { "not known" }
                    } }
                    td.n { (term.brightness.map_or("–".to_owned(), per_cent)) }
                    td { (term.note) }
                }
            }
        }
    }
}

fn rows(rows: &[(&str, String)]) -> Markup {
    html! {
        table {
            @for (name, value) in rows.iter().filter(|(_, value)| !value.is_empty()) {
                tr { th { (name) } td { (value) } }
            }
        }
    }
}

fn camera(report: &Report) -> Markup {
    let c = &report.camera;
    let sigma = c.sigma_focal_px.map_or(String::new(), |s| format!(" ± {}", significant(s)));
    html! {
        (rows(&[
            ("from", c.source.clone()),
            ("size", format!("{} × {} px", c.size_px[0], c.size_px[1])),
            ("plate's colour", report.plate.colour.clone()),
            ("focal length", format!("{:.2}, {:.2}{sigma} px", c.focal_px[0], c.focal_px[1])),
            ("principal point", format!("{:.2}, {:.2} px", c.principal_point_px[0], c.principal_point_px[1])),
            ("distortion", distortion(c)),
            ("known over the frame to", px(c.sigma_projection_px)),
            ("residual of the corners", px(c.rms_px)),
        ]))
        @if !c.views.is_empty() {
            details {
                summary { (photographs(c.views.len())) }
                table {
                    @for view in &c.views {
                        tr {
                            td { (view.photo.display()) }
                            td.n { (px(view.rms_px)) }
                            td { (view.rejected.as_deref().unwrap_or("")) }
                        }
                    }
                }
            }
        }
    }
}

/// The model, what it does, and its terms; those that are 0 were not needed.
fn distortion(camera: &CameraReport) -> String {
    let terms: Vec<String> = camera
        .distortion_names
        .iter()
        .zip(&camera.distortion_coefficients)
        .filter(|(_, k)| **k != 0.0)
        .map(|(name, k)| format!("{name} = {}", significant(*k)))
        .collect();
    let does = match (camera.distortion_px, terms.as_slice()) {
        (None, []) => String::new(),
        (Some(_), []) => ", no distortion".to_owned(),
        // A corner beyond the lens model's field is moved nobody knows how far.
        (None, terms) => format!(": {}", terms.join(", ")),
        (Some(moved), terms) => {
            format!(", moves the corners by up to {moved:.1} px: {}", terms.join(", "))
        }
    };
    format!("{}{does}", camera.distortion)
}

fn pose(report: &Report) -> Markup {
    let p = &report.pose;
    let [x, y, z] = p.position_m;
    rows(&[
        ("from", p.source.clone()),
        ("camera stands at", format!("{x:.4}, {y:.4}, {z:.4} m")),
        (
            "σ of the place",
            p.sigma_position_m.map_or(String::new(), |s| {
                let mm = s.map(|m| significant(1000.0 * m));
                format!("{} mm", mm.join(", "))
            }),
        ),
        (
            "σ of the rotation",
            p.sigma_rotation_deg
                .map_or(String::new(), |s| format!("{}°", s.map(significant).join("°, "))),
        ),
        ("residual", px(p.rms_px)),
        ("slip at the objects", px(p.slip_px)),
        ("another pose", p.ambiguity.clone().unwrap_or_default()),
    ])
}

fn probe(report: &Report) -> Markup {
    let p = &report.probe;
    let exposures: Vec<String> = p.exposures.iter().map(|&e| significant(e)).collect();
    let [r, g, b] = report.lights.irradiance_up;
    html! {
        (rows(&[
            ("from", p.source.clone()),
            ("its colour", p.colour.clone()),
            ("exposures t·(ISO/100)/N²", format!("{} ({})", exposures.join(", "), p.exposure_source)),
            ("radiance × this = plate", format!("{} ({})", significant(p.plate_exposure), p.plate_exposure_source)),
            ("ball", p.ball_px.map_or(String::new(), |[x, y, r]| format!("centre {x:.1}, {y:.1}, radius {r:.1} px"))),
            ("σ of the ball", px(p.sigma_ball_px)),
            ("its axes", p.registered.clone()),
            ("σ of directions", p.sigma_direction_deg.map_or(String::new(), |d| format!("{}°", significant(d)))),
            ("seen", format!("{} of the sphere", per_cent(p.seen_share))),
            ("irradiance on level ground", format!("{r:.3}, {g:.3}, {b:.3} (plate scale)")),
            ("surroundings", report.lights.surroundings.clone()),
        ]))
        @if !report.lights.suns.is_empty() {
            table {
                tr { th { "light" } th { "azimuth" } th { "elevation" } th { "half-angle" } th { "irradiance" } }
                @for (i, sun) in report.lights.suns.iter().enumerate() {
                    tr {
                        td { (i + 1) }
                        td.n { (format!("{:.2}°", sun.azimuth_deg)) }
                        td.n { (format!("{:.2}°", sun.elevation_deg)) }
                        td.n { (format!("{:.2}°", sun.half_angle_deg)) }
                        td.n { (sun.irradiance.map(|e| format!("{e:.3}")).join(", ")) }
                    }
                }
            }
        }
        @if !report.lights.lamps.is_empty() {
            table {
                tr { th { "lamp" } th { "at" } th { "radius" } th { "radiance" } th { "treated" } }
                @for (i, lamp) in report.lights.lamps.iter().enumerate() {
                    tr {
                        td { (i + 1) }
                        td.n { (lamp.at_m.map(|c| format!("{c:.2}")).join(", ")) }
                        td.n { (format!("{:.3} m", lamp.radius_m)) }
                        td.n { (lamp.radiance.map(significant).join(", ")) }
                        td { (lamp.treated) }
                    }
                }
            }
        }
        @if !p.clipped.is_empty() {
            table {
                tr { th { "clipped light" } th { "azimuth" } th { "elevation" } th { "solid angle" } th { "of all light, at least" } th { "treated" } }
                @for (i, light) in p.clipped.iter().enumerate() {
                    tr {
                        td { (i + 1) }
                        td.n { (format!("{:.1}°", light.azimuth_deg)) }
                        td.n { (format!("{:.1}°", light.elevation_deg)) }
                        td.n { (significant(light.solid_angle_sr)) " sr" }
                        td.n { (per_cent(light.share_at_least)) }
                        td { (light.treatment.to_string()) }
                    }
                }
            }
        }
    }
}

fn render(report: &Report) -> Markup {
    let r = &report.render;
    let c = &report.composite;
    let cpu = r.cpu_seconds.map_or(String::new(), |s| format!(", {s:.1} CPU s"));
    rows(&[
        ("method", r.method.clone()),
        ("stop at", r.stop.clone()),
        ("error reached", format!("{} of the plate{}", per_cent(r.error), denoised(r.denoised))),
        (
            "camera samples",
            format!(
                "{} in {}, {:.1} s{cpu}",
                r.samples,
                counted(r.waves as usize, "wave"),
                r.seconds
            ),
        ),
        ("ended early", if r.complete { String::new() } else { "stopped by the user".to_owned() }),
        ("mode", format!("{}: {}", c.mode, c.reason)),
        ("changed", format!("{} px", c.tally.changed)),
        (
            "albedo of the support",
            c.albedo_median.map_or(String::new(), |a| {
                format!("{:.3}, {:.3}, {:.3} (median)", a[0], a[1], a[2])
            }),
        ),
    ])
}

fn stages(report: &Report) -> Markup {
    html! {
        table {
            tr { th { "stage" } th { "seconds" } th { "CPU seconds" } }
            @for stage in &report.stages {
                tr {
                    td { (stage.name) }
                    td.n { (format!("{:.2}", stage.seconds)) }
                    td.n { (stage.cpu_seconds.map_or("–".to_owned(), |s| format!("{s:.2}"))) }
                }
            }
        }
    }
}

fn figure(picture: &Picture) -> Markup {
    html! {
        figure {
            a href=(picture.file) { img src=(picture.file) alt=(picture.title) loading="lazy"; }
            figcaption { b { (picture.title) } ". " (picture.caption) }
        }
    }
}

fn px(value: Option<f64>) -> String {
    value.map_or(String::new(), |v| format!("{} px", significant(v)))
}

/// Three figures that count.
fn significant(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return format!("{value}");
    }
    let digits = 2 - value.abs().log10().floor() as i32;
    match digits {
        6.. => format!("{value:.2e}"),
        0..6 => format!("{value:.*}", digits as usize),
        _ => format!("{value:.0}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_shows_warnings_and_escapes_names() {
        let mut report = Report::default();
        report.warnings.push(Warning::new("probe", "a <script> in a name", "up to 3 %"));
        report.notes.push(Warning::note("lens", "nothing to do", ""));
        let page = page(&report, "before.png", "after.png").into_string();
        assert!(page.contains("1 note,") && page.contains("nothing to do"), "notes are counted");
        assert!(page.contains("a &lt;script&gt; in a name") && page.contains("up to 3 %"));
        assert!(page.contains("before.png") && page.contains("after.png"));
        // The heading is the shot's name, with or without a shot.toml of its own.
        for (path, heading) in [("no/such/robot/shot.toml", "robot"), ("no/such/dusk.toml", "dusk")]
        {
            let report = Report { shot: serde_json::json!({ "path": path }), ..Report::default() };
            let page = super::page(&report, "before.png", "after.png").into_string();
            assert!(page.contains(&format!("<h1>{heading}</h1>")), "{page:.900}");
        }
    }

    #[test]
    fn terms_of_a_lens_are_shown_though_no_corner_can_be_followed_through_it() {
        let mut camera = CameraReport {
            distortion: "Kannala-Brandt".to_owned(),
            distortion_names: vec!["k1", "k2"],
            distortion_coefficients: vec![0.02, 0.0],
            distortion_px: Some(3.0),
            ..CameraReport::default()
        };
        let said = distortion(&camera);
        assert_eq!(said, "Kannala-Brandt, moves the corners by up to 3.0 px: k1 = 0.0200");
        camera.distortion_px = None;
        assert_eq!(distortion(&camera), "Kannala-Brandt: k1 = 0.0200");
        camera.distortion_coefficients = vec![0.0, 0.0];
        assert_eq!(distortion(&camera), "Kannala-Brandt");
    }

    #[test]
    fn numbers_have_three_figures() {
        for (value, text) in [
            (0.0, "0"),
            (1234.5, "1234"),
            (12.345, "12.3"),
            (0.0012345, "0.00123"),
            (1e-9, "1.00e-9"),
        ] {
            assert_eq!(significant(value), text);
        }
    }
}
