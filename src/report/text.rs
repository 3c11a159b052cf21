//! The report in a few lines, for the terminal.

use super::Report;

/// What a person wants to know first: where the lens, place and light come from, how exact they
/// are, what it cost, and what may be wrong.
pub fn summary(report: &Report) -> String {
    let camera = &report.camera;
    let mut lines = vec![format!(
        "camera   focal {:.1} px{} ({})",
        camera.focal_px[0],
        plus_minus(camera.sigma_focal_px, 1, " px"),
        camera.source
    )];
    let pose = &report.pose;
    lines.push(format!(
        "pose     slip {} ({})",
        pose.slip_px.map_or("not known".to_owned(), |s| format!("± {s:.2} px at the objects")),
        pose.source
    ));
    let probe = &report.probe;
    lines.push(format!(
        "probe    {} of the sphere seen{} ({})",
        per_cent(probe.seen_share),
        probe.sigma_direction_deg.map_or(String::new(), |d| format!(", directions ± {d:.2}°")),
        probe.source
    ));
    for sun in &report.lights.suns {
        lines.push(format!(
            "light    azimuth {:.1}°, elevation {:.1}°, irradiance {:.2}",
            sun.azimuth_deg, sun.elevation_deg, sun.irradiance[1]
        ));
    }
    if !report.lights.surroundings.is_empty() {
        lines.push(format!("walls    {}", report.lights.surroundings));
    }
    for lamp in &report.lights.lamps {
        lines.push(format!("lamp     {}", lamp.treated));
    }
    let render = &report.render;
    lines.push(format!(
        "render   error {}{} in {:.1} s{}, {} samples{}",
        per_cent(render.error),
        denoised(render.denoised),
        render.seconds,
        render.cpu_seconds.map_or(String::new(), |s| format!(" ({s:.1} CPU s)")),
        render.samples,
        if render.complete { "" } else { ", stopped early" }
    ));
    lines.push(format!(
        "result   {} px changed, {}; {}",
        report.composite.tally.changed, report.composite.mode, report.composite.reason
    ));
    if let Some(cause) = &report.budget.dominated_by {
        lines.push(format!("error    dominated by: {cause}"));
    }
    lines.join("\n")
}

fn plus_minus(sigma: Option<f64>, digits: usize, unit: &str) -> String {
    sigma.map_or(String::new(), |s| format!(" ± {s:.digits$}{unit}"))
}

/// That the picture was denoised, and what that was worth.
pub(super) fn denoised(gain: Option<f64>) -> String {
    gain.map_or(String::new(), |gain| {
        format!(" (denoised: {gain:.1} times less than the samples')")
    })
}

/// A share as per cent with two figures that count.
pub fn per_cent(share: f64) -> String {
    let percent = 100.0 * share;
    let digits = if percent == 0.0 || percent >= 10.0 {
        0
    } else {
        (1.0 - percent.abs().log10().floor()).clamp(0.0, 4.0) as usize
    };
    format!("{percent:.digits$} %")
}

/// A length as one says it: 4.2 mm, 3 cm, 1.25 m, 200 m.
pub fn length(metres: f64) -> String {
    let (value, digits, unit) = match metres {
        m if m < 0.00995 => (1000.0 * m, 1, "mm"),
        m if m < 0.9995 => (100.0 * m, 1, "cm"),
        m if m < 99.995 => (m, 2, "m"),
        m => (m, 0, "m"),
    };
    let text = format!("{value:.digits$}");
    let short = if digits > 0 { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    format!("{short} {unit}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_have_two_figures() {
        for (share, text) in [(0.0, "0 %"), (0.5, "50 %"), (0.0123, "1.2 %"), (0.00123, "0.12 %")] {
            assert_eq!(per_cent(share), text);
        }
    }

    #[test]
    fn lengths_are_said_in_the_unit_they_are_measured_in() {
        for (metres, said) in [
            (0.0042, "4.2 mm"),
            (0.005, "5 mm"),
            (0.00999, "1 cm"),
            (0.03, "3 cm"),
            (0.2, "20 cm"),
            (0.9999, "1 m"),
            (1.25, "1.25 m"),
            (20.0, "20 m"),
            (99.999, "100 m"),
            (200.0, "200 m"),
            (0.0, "0 mm"),
        ] {
            assert_eq!(length(metres), said);
        }
    }

    #[test]
    fn summary_names_what_dominates() {
        let mut report = Report::default();
        report.budget.dominated_by = Some("the ball's reflectance".to_owned());
        assert!(summary(&report).contains("dominated by: the ball's reflectance"));
    }
}
