//! Does the light come from near by? Then treating it as distant is wrong, and by how much.
//!
//! Walls and lamps of the shot file, judged by [`distant_error`].

use glam::DVec3;

use super::probe_keys::{Lamp, Surroundings};
use crate::light::near_field::{TOLERATED_ERROR, distant_error};
use crate::report::Warning;

/// Warnings about surroundings and lamps that the renderer treats as distant.
///
/// `reach` is the largest distance from the probe to a point of the objects, metres.
pub fn warnings(
    surroundings: Option<&Surroundings>,
    lamps: &[Lamp],
    probe: DVec3,
    reach: f64,
) -> Vec<Warning> {
    let mut found = Vec::new();
    match surroundings {
        Some(Surroundings::Box { min, max }) => {
            let walls = wall_distance(probe, (*min).into(), (*max).into());
            found.push(warning("surroundings.box", "the nearest wall", walls, reach));
        }
        Some(Surroundings::Mesh(_)) => found.push(Warning::new(
            "surroundings.mesh",
            "is read but has no effect yet: light is treated as infinitely far away",
            "unknown; about 2.7 × distance from probe to object ÷ distance to the light",
        )),
        None => {}
    }
    for (i, lamp) in lamps.iter().enumerate() {
        let distance = probe.distance(lamp.at.into()) - lamp.radius;
        found.push(warning(&format!("lamp[{i}]"), "the lamp", distance, reach));
    }
    found
}

/// The largest relative error of irradiance that the warnings tell of; `None` without any.
pub fn largest_error(
    surroundings: Option<&Surroundings>,
    lamps: &[Lamp],
    probe: DVec3,
    reach: f64,
) -> Option<f64> {
    let walls = match surroundings {
        Some(Surroundings::Box { min, max }) => {
            Some(wall_distance(probe, (*min).into(), (*max).into()))
        }
        _ => None,
    };
    let lamps = lamps.iter().map(|lamp| probe.distance(lamp.at.into()) - lamp.radius);
    let nearest = lamps.chain(walls).reduce(f64::min)?;
    Some(error(nearest, reach))
}

fn error(distance: f64, reach: f64) -> f64 {
    distant_error(reach, distance).min(1.0)
}

fn warning(key: &str, what: &str, distance: f64, reach: f64) -> Warning {
    let error = error(distance, reach);
    let verdict = if error > TOLERATED_ERROR {
        "the light changes across the objects, but it is treated as infinitely far away"
    } else {
        "far enough: treating its light as infinitely far away is good to the error given"
    };
    let size = if error < 1.0 {
        format!("light on the objects off by up to {:.0} %", 100.0 * error)
    } else {
        "light on the objects off by 100 % or more".to_owned()
    };
    let said = Warning::new(
        key,
        format!(
            "{what} is {distance:.2} m from the probe and the objects reach {reach:.2} m from it; \
             {verdict}; near light is read but has no effect yet"
        ),
        size,
    );
    Warning { asks: error > TOLERATED_ERROR, ..said }
}

/// Distance from a point to the nearest side wall or ceiling of a box; the floor is the support's
/// business. 0 outside the box.
fn wall_distance(point: DVec3, min: DVec3, max: DVec3) -> f64 {
    let low = point - min;
    let high = max - point;
    [low.x, low.z, high.x, high.y, high.z].into_iter().fold(f64::INFINITY, f64::min).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_near_lamp_is_a_large_error_and_a_far_wall_a_small_one() {
        let room = Surroundings::Box { min: [-50.0, 0.0, -50.0], max: [50.0, 60.0, 50.0] };
        let lamp = Lamp { at: [0.0, 1.0, 0.0], radius: 0.1 };
        let found = warnings(Some(&room), &[lamp], DVec3::ZERO, 0.2);
        assert!(found[0].size.contains("1 %") && found[0].message.contains("far enough"));
        // 2.7 · 0.2 / 0.9
        assert!(found[1].size.contains("60 %"), "{}", found[1]);
    }

    #[test]
    fn a_probe_outside_its_box_is_not_divided_by() {
        let room = Surroundings::Box { min: [1.0, 0.0, 1.0], max: [2.0, 1.0, 2.0] };
        let found = warnings(Some(&room), &[], DVec3::ZERO, 0.2);
        assert!(found[0].size.contains("100 % or more"));
    }

    #[test]
    fn nothing_said_nothing_warned() {
        assert!(warnings(None, &[], DVec3::ZERO, 1.0).is_empty());
    }
}
