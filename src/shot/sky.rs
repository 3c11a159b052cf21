//! `[probe] sky` of the shot file: a calculated clear sky and its sun for light.

use serde::Serialize;

use super::file::PlateKeys;
use super::keys::Keys;
use super::probe_keys::{ProbeKeys, ProbeSource};
use crate::conventions::Rgb;
use crate::light::Moment;
use crate::light::sky::{self, Sky, Strength};
use crate::light::sun_position::{Place, SunPosition, sun_position};
use crate::report::Warning;

/// A clear sky, of a place and time or with its sun where it was seen.
#[derive(Clone, Debug, Serialize)]
pub struct SkyKeys {
    pub place: Option<Place>,
    pub time: Option<Moment>,
    /// As it was given, or from place and time.
    pub sun: SunPosition,
    pub turbidity: f64,
    /// Degrees clockwise from true north to the world's −Z.
    pub north_deg: f64,
    /// Albedo below the horizon.
    pub ground: [f64; 3],
    /// Of level ground by the sky, luminance.
    pub sky_irradiance: Option<f64>,
    /// Of what faces the sun.
    pub sun_irradiance: Option<[f64; 3]>,
}

impl SkyKeys {
    pub const KEYS: &[&str] = &[
        "place",
        "time",
        "sun",
        "turbidity",
        "north_deg",
        "ground",
        "sky_irradiance",
        "sun_irradiance",
    ];

    pub(super) fn read(keys: &Keys) -> Option<Self> {
        let (place, time, sun) = read_sun(keys)?;
        let ground = keys.numbers("ground");
        let found = Self {
            place,
            time,
            sun,
            turbidity: keys.number("turbidity").unwrap_or(sky::DEFAULT_TURBIDITY),
            north_deg: keys.number("north_deg").unwrap_or(0.0),
            ground: ground.unwrap_or(sky::DEFAULT_GROUND.as_dvec3().to_array()),
            sky_irradiance: keys.positive("sky_irradiance"),
            sun_irradiance: keys.numbers("sun_irradiance"),
        };
        match found.sky() {
            Ok(_) => Some(found),
            Err(error) => {
                let key = match error.key() {
                    "irradiance" if keys.has("sun_irradiance") => "sun_irradiance",
                    "irradiance" => "sky_irradiance",
                    "sun" if keys.has("time") => "time",
                    key => key,
                };
                let SunPosition { azimuth_deg, elevation_deg } = found.sun;
                let there = format!("azimuth {azimuth_deg:.1}°, elevation {elevation_deg:.1}°: ");
                let there = if error.key() == "sun" { there } else { String::new() };
                keys.problem(key, &format!("{there}{error}"));
                None
            }
        }
    }

    /// The sky that these keys describe: a level white card has radiance 1 unless they say otherwise.
    ///
    /// # Errors
    /// What the keys ask for and there is not; none once they are read.
    pub fn sky(&self) -> Result<Sky, sky::SkyError> {
        let ground = Rgb::from(self.ground.map(|albedo| albedo as f32));
        let sky = Sky::new(self.sun.direction(self.north_deg), self.turbidity, ground)?;
        let sun = self.sun_irradiance.map(Into::into);
        sky.with_strength(&Strength { sky: self.sky_irradiance, sun })
    }

    /// "clear sky of turbidity 3, sun 139.2° clockwise from true north, 62.1° high": not "azimuth", which
    /// beside it is a light's in the world's axes.
    pub(super) fn sentence(&self) -> String {
        let SunPosition { azimuth_deg, elevation_deg } = self.sun;
        format!(
            "clear sky of turbidity {}, sun {azimuth_deg:.1}° clockwise from true north, \
             {elevation_deg:.1}° high",
            self.turbidity
        )
    }

    /// What nobody measured, and how to see whether the clock was right.
    pub(super) fn notes(&self) -> [Warning; 2] {
        let SunPosition { azimuth_deg, elevation_deg } = self.sun;
        let shadows = (azimuth_deg + 180.0).rem_euclid(360.0);
        let [x, _, z] = (-self.sun.direction(self.north_deg)).to_array();
        [
            Warning::note(
                "probe.sky",
                format!(
                    "the sun is calculated to stand {azimuth_deg:.1}° clockwise from true north, \
                     {elevation_deg:.1}° high; compare a shadow in the plate: it must point to {shadows:.1}°, in the \
                     world along x {x:+.2}, z {z:+.2}"
                ),
                "an hour of summer time forgotten turns shadows by about 15°",
            ),
            Warning::note(
                "probe.sky",
                "the light was not photographed: no clouds, houses or trees are in it",
                format!("the sun against the sky is good to {:.0} %", 100.0 * sky::SIGMA),
            ),
        ]
    }
}

/// A calculated sky has no exposure by which it and the plate were one scale: a problem unless the shot
/// says how they compare.
pub(super) fn check_scale(root: &Keys, plate: &PlateKeys, probe: &ProbeKeys) {
    if matches!(probe.source, ProbeSource::Sky(_)) && plate.relative_exposure.is_none() {
        root.problem(
            "plate",
            "relative_exposure is needed beside probe.sky, which has no exposure: the linear value that a \
             level white card in the sun has in the plate (that of a grey card divided by 0.18, of any \
             sunlit level surface by its albedo)",
        );
    }
}

/// Where the sun is, by place and time or by itself.
pub(super) fn read_sun(keys: &Keys) -> Option<(Option<Place>, Option<Moment>, SunPosition)> {
    if keys.has("sun") {
        if let Some(other) = ["place", "time"].into_iter().find(|key| keys.has(key)) {
            keys.problem(other, "sun says already where it stands; keep place and time, or sun");
        }
        let [azimuth_deg, elevation_deg] = keys.numbers("sun")?;
        if elevation_deg.abs() > 90.0 {
            let said =
                format!("{elevation_deg} is no elevation; write [azimuth, elevation] in degrees");
            keys.problem("sun", &said);
            return None;
        }
        let azimuth_deg = azimuth_deg.rem_euclid(360.0);
        return Some((None, None, SunPosition { azimuth_deg, elevation_deg }));
    }
    let place = keys.need(
        "place",
        keys.numbers("place"),
        "give [latitude, longitude] in degrees, north and east positive, or sun = [azimuth, elevation]",
    );
    let time =
        keys.need("time", keys.moment("time"), "give the moment, \"2026-06-21T12:00:00+02:00\"");
    let [latitude, longitude] = place?;
    let place = Place::new(latitude, longitude)
        .map_err(|error| keys.problem("place", &error.to_string()))
        .ok()?;
    let time = time?;
    Some((Some(place), Some(time), sun_position(time, place)))
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::shot::ShotFile;

    fn shot(plate: &str, sky: &str) -> Result<SkyKeys, String> {
        let text = format!(
            "[plate]\nfile = \"p.exr\"\n{plate}\n[camera]\nfocal_mm = 35.0\n[pose]\nfile = \"c.json\"\n\
             [probe]\nsky = {{ {sky} }}\n[support]\nplane = {{ size = [1.0, 1.0] }}\n"
        );
        match ShotFile::parse(Path::new("shot.toml"), &text) {
            Ok(shot) => match shot.probe.source {
                ProbeSource::Sky(keys) => Ok(keys),
                other => panic!("{other:?}"),
            },
            Err(error) => Err(error.problems().join("\n")),
        }
    }

    const SCALE: &str = "relative_exposure = 0.6";

    #[test]
    fn a_sky_is_read_with_place_and_time_or_with_its_sun() {
        let quoted = "place = [48.14, 11.58], time = \"2026-06-21T12:00:00+02:00\"";
        let by_text = shot(SCALE, quoted).unwrap();
        let by_date = shot(SCALE, &quoted.replace('"', "")).unwrap();
        assert_eq!(by_text.sun, by_date.sun);
        assert!((by_text.sun.elevation_deg - 61.0).abs() < 3.0, "{:?}", by_text.sun);
        assert_eq!((by_text.turbidity, by_text.north_deg), (3.0, 0.0));
        let given = shot(SCALE, "sun = [-90, 30], north_deg = 90, turbidity = 5").unwrap();
        assert_eq!(given.sun, SunPosition { azimuth_deg: 270.0, elevation_deg: 30.0 });
        // The west is behind a camera that looks east.
        let sun = given.sky().unwrap().sun();
        assert!(sun.direction.z > 0.8 && sun.direction.x.abs() < 1e-6, "{}", sun.direction);
    }

    #[test]
    fn what_a_sky_lacks_is_told_with_its_key_and_remedy() {
        let sun = "sun = [180, 40]";
        for (plate, sky, parts) in [
            ("", sun.to_owned(), ["plate: relative_exposure is needed", "grey card"]),
            (
                SCALE,
                format!("{sun}, turbidity = 1.5"),
                ["probe.sky.turbidity: 1.5", "2 is the clearest"],
            ),
            (
                SCALE,
                "sun = [180, -4]".to_owned(),
                ["probe.sky.sun: azimuth 180.0°", "below the horizon"],
            ),
            (SCALE, "sun = [180, 100]".to_owned(), ["probe.sky.sun: 100", "[azimuth, elevation]"]),
            (SCALE, format!("{sun}, ground = [0.2, 0.2, 3]"), ["probe.sky.ground", "albedo"]),
            (
                SCALE,
                format!("{sun}, sun_irradiance = [0, 0, 0]"),
                ["probe.sky.sun_irradiance", "0 to"],
            ),
            (
                SCALE,
                format!("{sun}, place = [1, 2]"),
                ["probe.sky.place", "keep place and time, or sun"],
            ),
            (
                SCALE,
                format!("{sun}, noth_deg = 3"),
                ["noth_deg: unknown key", "probe.sky.north_deg"],
            ),
            (SCALE, "place = [48, 11]".to_owned(), ["probe.sky.time: is missing", "+02:00"]),
            (
                SCALE,
                "time = 2026-06-21T12:00:00Z".to_owned(),
                ["probe.sky.place: is missing", "latitude"],
            ),
            (
                SCALE,
                "place = [48, 11], time = 2026-06-21T12:00:00".to_owned(),
                ["probe.sky.time", "has no zone"],
            ),
            (
                SCALE,
                "place = [48, 200], time = 2026-06-21T12:00:00Z".to_owned(),
                ["probe.sky.place: 48, 200", "latitude"],
            ),
            (
                SCALE,
                "place = [48, 11], time = 2026-06-21T00:00:00Z".to_owned(),
                ["probe.sky.time: azimuth", "below the horizon"],
            ),
        ] {
            let said = shot(plate, &sky).unwrap_err();
            assert!(parts.iter().all(|part| said.contains(part)), "{sky}: {said}");
        }
    }
}
