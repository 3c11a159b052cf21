//! Is the light far enough away that one panorama serves every place of the shot?
//!
//! First-order error of the distant assumption (methods-render R10.1, measured on a room: a horizontal
//! patch moved by t toward a wall of light at distance d): its irradiance changes by 2.7 · t / d. Above
//! 5 % the light is near (R10.2).

/// Relative change of irradiance per (displacement / distance of the light), horizontal patch.
pub const IRRADIANCE_CHANGE: f64 = 2.7;

/// Above this relative error of irradiance the distant assumption draws a warning.
pub const TOLERATED_ERROR: f64 = 0.05;

/// Relative error of irradiance if light that is `distance_m` from the probe is taken as distant for
/// something `displacement_m` away from the probe.
///
/// First order: good to about a third while it is below ½. Infinite for a light at the probe.
pub fn distant_error(displacement_m: f64, distance_m: f64) -> f64 {
    if displacement_m <= 0.0 {
        return 0.0;
    }
    if distance_m <= 0.0 {
        return f64::INFINITY;
    }
    IRRADIANCE_CHANGE * displacement_m / distance_m
}

/// True if light at `distance_m` is too near to be taken as distant.
pub fn is_near(displacement_m: f64, distance_m: f64) -> bool {
    distant_error(displacement_m, distance_m) > TOLERATED_ERROR
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lamp_at_an_arms_length_is_near_and_a_house_over_the_road_is_not() {
        assert!(is_near(0.3, 0.75));
        assert!(!is_near(0.3, 30.0));
        assert!(!is_near(0.0, 0.1));
        assert_eq!(distant_error(0.1, 0.0), f64::INFINITY);
    }

    #[test]
    fn first_order_matches_the_measured_patch() {
        // A window 3 m away, patch moved 0.1 m toward it: measured by quadrature ×1.09.
        assert!((distant_error(0.1, 3.0) - 0.09).abs() < 0.005);
    }
}
