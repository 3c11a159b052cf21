//! What the curves come to, in a sentence.

use crate::report::chart::{Curve, Point, Reference, Verdict};

/// Error of a curve at a cost: between its points as a power law, beyond the last as Monte Carlo goes.
/// `None` before the first.
fn error_at(curve: &Curve, cpu_seconds: f64) -> Option<f64> {
    let mut known: Vec<(f64, f64)> =
        curve.points.iter().filter_map(|p| Some((p.cpu_seconds, p.error?))).collect();
    known.sort_by(|a, b| a.0.total_cmp(&b.0));
    // Costs are good to some per cent.
    let (first, last) = (known.first()?, known.last()?);
    if cpu_seconds < 0.9 * first.0 {
        return None;
    }
    if cpu_seconds >= last.0 {
        return Some(last.1 * (last.0 / cpu_seconds).sqrt());
    }
    let after = known.iter().position(|(cost, _)| *cost > cpu_seconds)?;
    let (low, high) = (known[after.saturating_sub(1)], known[after]);
    let share = ((cpu_seconds / low.0).ln() / (high.0 / low.0).ln().max(1e-12)).clamp(0.0, 1.0);
    Some(low.1 * (high.1 / low.1).powf(share))
}

/// The shot's own settings against the best unbiased method at the same cost; the first curve is the
/// shot's.
pub fn verdict(curves: &[Curve], chosen: Option<&Point>) -> Option<Verdict> {
    let (auto, others) = curves.split_first()?;
    let point = chosen.filter(|point| point.error.is_some());
    let point = point.or_else(|| auto.points.iter().rev().find(|point| point.error.is_some()))?;
    let (best, best_error, extrapolated) = others
        .iter()
        .filter(|curve| curve.bias.is_none())
        .filter_map(|curve| {
            let last = curve.points.iter().map(|point| point.cpu_seconds).fold(0.0, f64::max);
            let beyond = point.cpu_seconds > 1.1 * last;
            Some((curve.name, error_at(curve, point.cpu_seconds)?, beyond))
        })
        .min_by(|a, b| a.1.total_cmp(&b.1))?;
    let (cpu_seconds, error) = (point.cpu_seconds, point.error?);
    Some(Verdict { cpu_seconds, error, best, best_error, extrapolated })
}

/// What the reference's own error means for the best of the others, and for what the shot's settings
/// came to.
pub fn reference_note(
    curves: &[Curve],
    chosen: Option<&Point>,
    reference: &Reference,
) -> Option<String> {
    let points = curves.iter().flat_map(|curve| &curve.points).chain(chosen);
    let best = points.filter_map(|point| point.error).reduce(f64::min)?;
    let times = best / reference.error.max(1e-12);
    let found = match times {
        times if times < 1.0 => format!(
            "the best error lies within the reference's own ({times:.2} of it): how good the best are, \
             nobody can tell"
        ),
        times if times < 10.0 => format!(
            "the best error plotted is {times:.1} times the reference's own, which is taken out of it"
        ),
        _ => return None,
    };
    Some(format!("{found}; more --time makes the reference better"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::chart::Group;

    fn curve(name: &'static str, factor: f64, bias: Option<&'static str>) -> Curve {
        let point = |cpu_seconds: f64| Point {
            cpu_seconds,
            seconds: cpu_seconds,
            samples: 1,
            stated: 0.0,
            error: Some(factor / cpu_seconds.sqrt()),
            bias: 0.0,
            bias_sigma: 0.0,
            on_objects: None,
            beside: None,
        };
        let points = [0.1, 0.5, 2.0].map(point).to_vec();
        Curve { name, group: Group::Methods, does: "", bias, points }
    }

    #[test]
    fn errors_between_and_beyond_points_follow_the_power_law() {
        let curve = curve("x", 0.01, None);
        for cost in [0.1, 0.2, 1.0, 2.0, 50.0] {
            let found = error_at(&curve, cost).unwrap();
            assert!((found * cost.sqrt() - 0.01).abs() < 1e-9, "{cost}: {found}");
        }
        assert_eq!(error_at(&curve, 0.05), None);
    }

    #[test]
    fn the_verdict_names_the_best_unbiased_method_at_equal_cost() {
        let curves = [
            curve("auto", 0.02, None),
            curve("slow", 0.05, None),
            curve("fast", 0.01, None),
            curve("biased", 0.001, Some("all")),
        ];
        let found = verdict(&curves, None).unwrap();
        assert_eq!((found.best, found.cpu_seconds), ("fast", 2.0));
        assert!((found.ratio() - 2.0).abs() < 1e-9 && !found.extrapolated);
        let dear = Point { cpu_seconds: 8.0, ..curves[0].points[2] };
        assert!(verdict(&curves, Some(&dear)).unwrap().extrapolated);
        assert!(verdict(&curves[..1], None).is_none());
    }

    #[test]
    fn the_reference_s_own_error_is_held_against_all_that_is_plotted() {
        let curves = [curve("auto", 0.02, None)];
        let reference = |error| Reference { error, ..Reference::default() };
        let best = 0.02 / 2.0_f64.sqrt();
        assert_eq!(reference_note(&curves, None, &reference(0.05 * best)), None);
        let near = reference_note(&curves, None, &reference(0.5 * best)).unwrap();
        assert!(near.contains("2.0 times the reference's own"), "{near}");
        // The ring may lie lower than any curve.
        let chosen = Point { error: Some(0.1 * best), ..curves[0].points[2] };
        let within = reference_note(&curves, Some(&chosen), &reference(0.2 * best)).unwrap();
        assert!(within.contains("within the reference's own"), "{within}");
    }
}
