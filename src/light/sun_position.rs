//! Where the sun stands at a moment, seen from a place on the Earth.
//!
//! The Astronomical Almanac's low-precision formula (Michalsky 1988), within 0.0124° of NREL's SPA from
//! 2000 to 2050 (methods-capture C8): a fortieth of the disc. Clock and map are worse: four minutes are
//! 1°, an hour of summer time forgotten is 15°.

use std::f64::consts::PI;

use glam::DVec3;
use serde::Serialize;

use super::moment::Moment;

/// A place on the Earth, degrees: latitude north, longitude east.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Place {
    latitude_deg: f64,
    longitude_deg: f64,
}

/// Two numbers that are no place on the Earth.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "{0}, {1} is no place: write the latitude from -90 to 90, north positive, then the longitude from -180 \
     to 180, east positive"
)]
pub struct NoPlace(f64, f64);

impl Place {
    /// # Errors
    /// [`NoPlace`] beyond 90° or 180°, or where a number is not finite.
    pub fn new(latitude_deg: f64, longitude_deg: f64) -> Result<Self, NoPlace> {
        if latitude_deg.abs() <= 90.0 && longitude_deg.abs() <= 180.0 {
            return Ok(Self { latitude_deg, longitude_deg });
        }
        Err(NoPlace(latitude_deg, longitude_deg))
    }
}

/// Where the middle of the sun is seen, degrees.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SunPosition {
    /// From true north, clockwise (east is 90), 0 to 360.
    pub azimuth_deg: f64,
    /// Above the horizon, lifted by the air as it is seen.
    pub elevation_deg: f64,
}

/// Where the sun is seen.
pub fn sun_position(moment: Moment, place: Place) -> SunPosition {
    let n = moment.days_since_j2000();
    // Ecliptic longitude λ from the mean anomaly g and the mean longitude q; obliquity ε.
    let g = (357.528 + 0.985_600_3 * n).to_radians();
    let q = 280.460 + 0.985_647_4 * n;
    let lambda = (q + 1.915 * g.sin() + 0.020 * (2.0 * g).sin()).to_radians();
    let epsilon = (23.439 - 4e-7 * n).to_radians();
    let right_ascension = (epsilon.cos() * lambda.sin()).atan2(lambda.cos());
    let sin_declination = epsilon.sin() * lambda.sin();
    let cos_declination = (1.0 - sin_declination * sin_declination).sqrt();

    // Hour angle H from sidereal time; then east, north and up.
    let sidereal_h = 6.697_375 + 0.065_709_824_2 * n + moment.utc_hours();
    let hour_angle = (15.0 * sidereal_h + place.longitude_deg).to_radians() - right_ascension;
    let (sin_latitude, cos_latitude) = place.latitude_deg.to_radians().sin_cos();
    let east = -cos_declination * hour_angle.sin();
    let north = sin_declination * cos_latitude - cos_declination * sin_latitude * hour_angle.cos();
    let up = sin_latitude * sin_declination + cos_latitude * cos_declination * hour_angle.cos();
    let elevation_deg = up.atan2(east.hypot(north)).to_degrees();
    SunPosition {
        azimuth_deg: east.atan2(north).to_degrees().rem_euclid(360.0),
        elevation_deg: elevation_deg + refraction_deg(elevation_deg),
    }
}

/// How far the air lifts what stands at a true elevation (Sæmundsson 1986; 1010 mbar, 10 °C): 0.48° at
/// the horizon. 0 below −1°, where nothing is seen and the formula does not hold.
fn refraction_deg(elevation_deg: f64) -> f64 {
    if elevation_deg < -1.0 {
        return 0.0;
    }
    let arc_minutes = 1.02 / (elevation_deg + 10.3 / (elevation_deg + 5.11)).to_radians().tan();
    // At the zenith the formula is at −0.002.
    arc_minutes.max(0.0) / 60.0
}

impl SunPosition {
    /// Unit vector toward the sun in the world (+Y up), where −Z points `north_deg` clockwise from true
    /// north: at 0, −Z is north and +X east.
    pub fn direction(self, north_deg: f64) -> DVec3 {
        let (sin_azimuth, cos_azimuth) = (self.azimuth_deg - north_deg).to_radians().sin_cos();
        let (up, level) = (self.elevation_deg * PI / 180.0).sin_cos();
        DVec3::new(sin_azimuth * level, up, -cos_azimuth * level)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(text: &str, latitude: f64, longitude: f64) -> SunPosition {
        let place = Place::new(latitude, longitude).expect("a place");
        sun_position(text.parse().expect("a moment"), place)
    }

    /// The highest sun of a day.
    fn noon(midnight: &str, latitude: f64, longitude: f64) -> (Moment, SunPosition) {
        let place = Place::new(latitude, longitude).expect("a place");
        let midnight: Moment = midnight.parse().expect("a moment");
        let all = (0..86_400).step_by(10).map(|s| {
            let moment = midnight.later(f64::from(s));
            (moment, sun_position(moment, place))
        });
        all.max_by(|a, b| a.1.elevation_deg.total_cmp(&b.1.elevation_deg)).expect("a day")
    }

    /// Reda & Andreas 2004 (NREL/TP-560-34302), table A5.1.
    #[test]
    fn the_worked_example_of_nrel_comes_out() {
        let sun = at("2003-10-17T12:30:30-07:00", 39.742_476, -105.178_6);
        // SPA is for 1830 m and 820 mbar, where the air lifts by 0.004° less than at sea level.
        assert!((90.0 - sun.elevation_deg - 50.111_62).abs() < 0.02, "{sun:?}");
        assert!((sun.azimuth_deg - 194.340_24).abs() < 0.02, "{sun:?}");
    }

    #[test]
    fn noon_elevations_are_ninety_less_latitude_plus_declination() {
        // Declination 23.436° at the solstices of 2026, 0 within a quarter of a day of an equinox
        // (0.4° a day).
        for (day, declination, tolerance) in [
            ("2026-06-21T00:00Z", 23.436, 0.02),
            ("2026-12-21T00:00Z", -23.436, 0.02),
            ("2026-03-20T00:00Z", 0.0, 0.12),
        ] {
            for latitude in [51.0, 30.0] {
                let (_, sun) = noon(day, latitude, 0.0);
                let lifted = refraction_deg(sun.elevation_deg);
                let wanted = 90.0 - latitude + declination + lifted;
                assert!(
                    (sun.elevation_deg - wanted).abs() < tolerance,
                    "{day} {latitude}: {sun:?}"
                );
                // At an equinox the sun still climbs by 0.016° an hour when it crosses the meridian.
                assert!((sun.azimuth_deg - 180.0).abs() < 0.2, "{day}: {sun:?}");
            }
        }
    }

    #[test]
    fn south_of_the_tropics_the_noon_sun_stands_in_the_north() {
        let (_, sun) = noon("2026-06-21T00:00Z", -35.0, 0.0);
        assert!((sun.elevation_deg - (90.0 - 35.0 - 23.436)).abs() < 0.05, "{sun:?}");
        assert!(sun.azimuth_deg < 0.1 || sun.azimuth_deg > 359.9, "{sun:?}");
        // It rises in the east all the same.
        let morning = at("2026-06-21T08:00Z", -35.0, 0.0);
        assert!(morning.direction(0.0).x > 0.5, "{morning:?}");
    }

    #[test]
    fn morning_and_afternoon_are_mirrored_at_the_meridian() {
        // At the solstice the declination stands still.
        let (noon, _) = noon("2026-06-21T00:00Z", 48.0, 0.0);
        let place = Place::new(48.0, 0.0).expect("a place");
        for hours in [1.0, 3.0, 6.0] {
            let [before, after] =
                [-1.0, 1.0].map(|sign| sun_position(noon.later(sign * hours * 3600.0), place));
            assert!((before.elevation_deg - after.elevation_deg).abs() < 0.05, "{hours} h");
            assert!((before.azimuth_deg + after.azimuth_deg - 360.0).abs() < 0.1, "{hours} h");
        }
    }

    /// methods-capture F30, A17: at a pole the azimuth is the hour angle.
    #[test]
    fn a_forgotten_hour_of_summer_time_is_fifteen_degrees() {
        let sun = at("2026-06-21T12:00+02:00", 90.0, 0.0);
        let slipped = at("2026-06-21T12:00+01:00", 90.0, 0.0);
        assert!((slipped.azimuth_deg - sun.azimuth_deg - 15.0).abs() < 0.01);
        assert!((slipped.elevation_deg - sun.elevation_deg).abs() < 1e-3);
        // As much as 15° of longitude the other way.
        let east = at("2026-06-21T12:00+02:00", 48.0, 15.0);
        let later = at("2026-06-21T12:00+01:00", 48.0, 0.0);
        assert!((later.azimuth_deg - east.azimuth_deg).abs() < 0.05);
    }

    #[test]
    fn directions_are_clockwise_from_where_the_world_has_its_north() {
        let sun = |azimuth_deg, elevation_deg| SunPosition { azimuth_deg, elevation_deg };
        let near = |a: DVec3, b: DVec3| assert!((a - b).length() < 1e-12, "{a} {b}");
        near(sun(0.0, 0.0).direction(0.0), -DVec3::Z);
        near(sun(90.0, 0.0).direction(0.0), DVec3::X);
        near(sun(180.0, 0.0).direction(0.0), DVec3::Z);
        near(sun(123.0, 90.0).direction(7.0), DVec3::Y);
        // A camera that looks along −Z, to the east, has the sun of the east before it.
        near(sun(90.0, 0.0).direction(90.0), -DVec3::Z);
        assert!((sun(10.0, 30.0).direction(55.0).y - 0.5).abs() < 1e-12);
    }

    #[test]
    fn the_air_lifts_by_what_is_printed() {
        // methods-capture C8.
        for (elevation, lift, tolerance) in
            [(0.0, 0.48, 0.005), (5.0, 0.16, 0.005), (20.0, 0.045, 0.001)]
        {
            assert!((refraction_deg(elevation) - lift).abs() < tolerance, "{elevation}");
        }
        assert!(
            refraction_deg(90.0) < 1e-4
                && refraction_deg(-1.0) < 0.7
                && refraction_deg(-5.11) == 0.0
        );
    }

    #[test]
    fn what_is_no_place_is_told() {
        for (latitude, longitude) in
            [(91.0, 0.0), (0.0, 181.0), (f64::NAN, 0.0), (0.0, f64::INFINITY)]
        {
            let said = Place::new(latitude, longitude).unwrap_err().to_string();
            assert!(said.contains("latitude from -90 to 90"), "{said}");
        }
    }
}
