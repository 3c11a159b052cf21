//! `[probe] register` of the shot file: how the probe's axes lie in the world, by lights that both show.
//!
//! A panorama that stands level, or anyhow, with nothing known of which way it looks → the rotation by lights
//! whose places are known, or by the sun at a place and time → the same panorama in the world's axes, and by how
//! much that may be off.

use std::f64::consts::PI;

use glam::{DVec2, DVec3};
use serde::Serialize;

use super::keys::Keys;
use super::probe_keys::ProbeSource;
use super::sky;
use crate::camera::Camera;
use crate::conventions::lat_long_direction;
use crate::light::sun_position::SunPosition;
use crate::probe::Panorama;
use crate::probe::axes::Axes;
use crate::probe::compact_lights::compact_lights;
use crate::probe::layout::Layout;
use crate::probe::register::{
    Handedness, Match, Matched, RegisterError, Registration, by_sun, from_matches,
};
use crate::report::Warning;

/// What both the probe and the world know.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum RegisterKeys {
    Lights {
        lights: Vec<SeenLight>,
        /// Somebody vouches that the panorama's file is not flipped left to right.
        unmirrored: bool,
    },
    Sun {
        sun: SunPosition,
        /// Degrees clockwise from true north to the world's −Z.
        north_deg: f64,
        /// Where the panorama shows it; `None`: its brightest small light.
        shown: Option<Shown>,
    },
}

/// A light, or any other thing, that the probe shows and whose direction in the world is known.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SeenLight {
    pub shown: Shown,
    pub toward: Toward,
}

/// Where the panorama shows something.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Shown {
    /// Column and row in a lat-long file.
    Texel([f64; 2]),
    /// Azimuth from +Z toward +X and elevation, degrees, as the report has them of a run without `register`.
    Angles([f64; 2]),
}

/// Where that is in the world.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Toward {
    /// A place, metres: seen from the probe's.
    At([f64; 3]),
    /// A pixel of the plate that shows it; it must be far away.
    PlatePx([f64; 2]),
    /// A direction of any length.
    Direction([f64; 3]),
}

impl RegisterKeys {
    pub const KEYS: &[&str] =
        &["lights", "unmirrored", "sun", "place", "time", "north_deg", "seen", "texel"];
    const LIGHT: &[&str] = &["seen", "texel", "at", "plate_px", "toward"];

    pub(super) fn read(keys: &Keys) -> Option<Self> {
        match keys.exactly_one(&["lights", "sun", "place"])? {
            "lights" => Self::read_lights(keys),
            _ => Self::read_sun(keys),
        }
    }

    fn read_lights(keys: &Keys) -> Option<Self> {
        for other in ["time", "north_deg", "seen", "texel"] {
            if keys.has(other) {
                keys.problem(other, "belongs to the sun, not beside lights; take it out");
            }
        }
        let tables = keys.tables("lights", Self::LIGHT);
        let lights: Vec<Option<SeenLight>> = tables.iter().map(SeenLight::read).collect();
        if keys.is_list("lights") && lights.len() < 2 {
            let said = format!("{} given, two at least tell how the probe is turned", lights.len());
            keys.problem("lights", &said);
            return None;
        }
        let lights = lights.into_iter().collect::<Option<Vec<_>>>()?;
        Some(Self::Lights { lights, unmirrored: keys.flag("unmirrored").unwrap_or(false) })
    }

    fn read_sun(keys: &Keys) -> Option<Self> {
        if keys.has("unmirrored") {
            keys.problem("unmirrored", "belongs to lights; one sun cannot tell left from right");
        }
        let (_, _, sun) = sky::read_sun(keys)?;
        let shown =
            if keys.has("seen") || keys.has("texel") { Some(Shown::read(keys)?) } else { None };
        if sun.elevation_deg <= 0.0 {
            let key = if keys.has("sun") { "sun" } else { "time" };
            let said = format!(
                "the sun stands {:.1}° below the horizon then; check date, hour and zone",
                -sun.elevation_deg
            );
            keys.problem(key, &said);
            return None;
        }
        Some(Self::Sun { sun, north_deg: keys.number("north_deg").unwrap_or(0.0), shown })
    }
}

impl SeenLight {
    fn read(keys: &Keys) -> Option<Self> {
        let shown = Shown::read(keys);
        let toward = match keys.exactly_one(&["at", "plate_px", "toward"])? {
            "at" => keys.place("at").map(Toward::At),
            "plate_px" => keys.numbers("plate_px").map(Toward::PlatePx),
            _ => keys.direction("toward").map(Toward::Direction),
        };
        Some(Self { shown: shown?, toward: toward? })
    }
}

impl Shown {
    fn read(keys: &Keys) -> Option<Self> {
        match keys.exactly_one(&["seen", "texel"])? {
            "texel" => keys.numbers("texel").map(Self::Texel),
            _ => {
                let [azimuth, elevation] = keys.numbers("seen")?;
                if elevation.abs() > 90.0 {
                    keys.problem(
                        "seen",
                        "write [azimuth, elevation] in degrees, elevation from −90 to 90",
                    );
                    return None;
                }
                Some(Self::Angles([azimuth, elevation]))
            }
        }
    }

    /// Unit direction in the world's axes as they were taken to be before.
    fn direction(self, panorama: &Panorama, source: &ProbeSource) -> Result<DVec3, String> {
        match self {
            Self::Angles([azimuth, elevation]) => {
                let (azimuth, elevation) = (azimuth.to_radians(), elevation.to_radians());
                let level = elevation.cos();
                Ok(DVec3::new(azimuth.sin() * level, elevation.sin(), azimuth.cos() * level))
            }
            Self::Texel([u, v]) => {
                let (width, height) = (panorama.width(), panorama.height());
                // Other layouts, and other programs' axes, are turned on reading.
                let as_read = matches!(
                    source,
                    ProbeSource::Panorama(keys) if keys.mapping == Layout::LatLong(Axes::OpenExr)
                );
                if !as_read {
                    return Err("texel is a pixel of a panorama of mapping = \"latlong\", and the probe is \
                                none; give seen = [azimuth, elevation], as the report of a run without \
                                register has them"
                        .to_owned());
                }
                let inside = |at: f64, n: usize| (-0.5..n as f64 - 0.5).contains(&at);
                if !inside(u, width) || !inside(v, height) {
                    return Err(format!(
                        "texel [{u}, {v}] lies outside the panorama of {width} x {height}; give column and row, \
                         the upper left one is [0, 0]"
                    ));
                }
                let own = lat_long_direction(DVec2::new(u, v), width, height);
                Ok(panorama.world_from_panorama * own)
            }
        }
    }
}

impl Toward {
    fn direction(self, place: DVec3, camera: &Camera) -> Result<DVec3, String> {
        match self {
            Self::At(at) => (DVec3::from(at) - place)
                .try_normalize()
                .ok_or_else(|| "at is the probe's own place; correct one of them".to_owned()),
            Self::Direction(direction) => Ok(DVec3::from(direction).normalize_or(DVec3::Y)),
            Self::PlatePx([u, v]) => {
                let ray = camera.ray(DVec2::new(u, v)).map(|(_, direction)| direction);
                ray.ok_or_else(|| format!("plate_px [{u}, {v}]: the lens shows nothing there"))
            }
        }
    }
}

/// A panorama in the world's axes.
#[derive(Debug)]
pub struct Registered {
    /// "by 3 matched lights: …".
    pub sentence: String,
    /// Standard error of the rotation, degrees.
    pub sigma_deg: f64,
    pub warnings: Vec<Warning>,
}

/// Turns `panorama` into the world's axes.
///
/// # Errors
/// A sentence with key and remedy.
pub fn register(
    keys: &RegisterKeys,
    source: &ProbeSource,
    panorama: &mut Panorama,
    camera: &Camera,
) -> Result<Registered, String> {
    let (registration, sentence, warnings) = match keys {
        RegisterKeys::Lights { lights, unmirrored } => {
            by_lights(lights, *unmirrored, source, panorama, camera)?
        }
        RegisterKeys::Sun { sun, north_deg, shown } => {
            by_the_sun(*sun, *north_deg, *shown, source, panorama)?
        }
    };
    panorama.world_from_panorama = registration.rotation * panorama.world_from_panorama;
    let sigma_deg = registration.sigma_rad().to_degrees();
    let (axis, angle) = registration.rotation.to_axis_angle();
    // The shorter way round, and the vertical upward.
    let (axis, angle) = if angle > PI { (-axis, 2.0 * PI - angle) } else { (axis, angle) };
    let (axis, angle) = if axis.y < 0.0 { (-axis, -angle) } else { (axis, angle) };
    let sentence = format!(
        "{sentence}; turned by {:.1}° about ({:.2}, {:.2}, {:.2}), ± {sigma_deg:.2}°",
        angle.to_degrees() + 0.0,
        axis.x + 0.0,
        axis.y + 0.0,
        axis.z + 0.0
    );
    Ok(Registered { sentence, sigma_deg, warnings })
}

type Found = (Registration, String, Vec<Warning>);

fn by_lights(
    lights: &[SeenLight],
    unmirrored: bool,
    source: &ProbeSource,
    panorama: &Panorama,
    camera: &Camera,
) -> Result<Found, String> {
    let key = |i: usize| format!("probe.register.lights[{i}]");
    let matches: Vec<Match> = lights
        .iter()
        .enumerate()
        .map(|(i, light)| {
            let from = light.shown.direction(panorama, source);
            let to = light.toward.direction(panorama.place, camera);
            Ok(Match::new(
                from.map_err(|error| format!("{}: {error}", key(i)))?,
                to.map_err(|error| format!("{}: {error}", key(i)))?,
            ))
        })
        .collect::<Result<_, String>>()?;
    // What this program unwrapped itself is not flipped.
    let file = matches!(source, ProbeSource::Panorama(_));
    let handedness = if file && !unmirrored { Handedness::Unknown } else { Handedness::Known };
    let Matched { registration, inliers, .. } =
        from_matches(&matches, handedness).map_err(|error| {
            let remedy = match error {
                RegisterError::Few { .. } | RegisterError::Handedness { .. } => {
                    ", or set unmirrored = true if the file surely shows the world as it is, not mirrored"
                }
                _ => "",
            };
            format!("probe.register.lights: {error}{remedy}")
        })?;
    let off_deg = |m: &Match| (registration.rotation * m.from).angle_between(m.to).to_degrees();
    let warnings = matches.iter().zip(&inliers).enumerate().filter(|(_, (_, used))| !**used);
    let warnings = warnings.map(|(i, (m, _))| {
        Warning::new(
            key(i),
            "does not fit the other lights and is left out; look at it again",
            format!("{:.1}° beside where they put it", off_deg(m)),
        )
    });
    let used = matches.iter().zip(&inliers).filter(|(_, used)| **used);
    let worst = used.map(|(m, _)| off_deg(m)).fold(0.0, f64::max);
    let n = inliers.iter().filter(|used| **used).count();
    let sentence = format!("by {n} matched lights, the worst {worst:.2}° off");
    Ok((registration, sentence, warnings.collect()))
}

/// Standard error of a direction that somebody read off a picture, each way, radians: half a degree.
const SIGMA_READ_RAD: f64 = 0.5 * PI / 180.0;

fn by_the_sun(
    sun: SunPosition,
    north_deg: f64,
    shown: Option<Shown>,
    source: &ProbeSource,
    panorama: &Panorama,
) -> Result<Found, String> {
    let (seen, sigma_rad) = match shown {
        Some(shown) => {
            let seen = shown.direction(panorama, source);
            (seen.map_err(|error| format!("probe.register: {error}"))?, SIGMA_READ_RAD)
        }
        None => {
            let lights = compact_lights(panorama);
            let brightest = lights.first().ok_or(
                "probe.register: the probe shows no small bright light that could be the sun; give seen = \
                 [azimuth, elevation] of where it shows the sun, or register it by lights",
            )?;
            (brightest.direction, brightest.sigma_rad)
        }
    };
    let registration = by_sun(seen, sun.direction(north_deg), DVec3::Y, sigma_rad)
        .map_err(|error| format!("probe.register: {}", sun_error(&error)))?;
    let SunPosition { azimuth_deg, elevation_deg } = sun;
    let sentence = format!(
        "by the sun, {azimuth_deg:.1}° clockwise from true north and {elevation_deg:.1}° high, and the vertical"
    );
    let note = Warning::note(
        "probe.register",
        "the probe is turned by where the sun stood; compare the shadow in overlay_support.png with one in the \
         plate",
        "a clock wrong by 4 minutes turns the light by about 1°, summer time forgotten by 15°",
    );
    Ok((registration, sentence, vec![note]))
}

/// The same error where one sun and not a list of matches was given.
fn sun_error(error: &RegisterError) -> String {
    match error {
        RegisterError::OneLine => {
            "the sun stands too near the zenith to tell which way the probe looks; \
                                   register it by lights"
                .to_owned()
        }
        RegisterError::Undecided { reason } => format!(
            "{reason}; check date, hour, zone and place, that the probe stood level, and that its brightest small \
             light is the sun (or give seen = [azimuth, elevation])"
        ),
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use glam::DQuat;

    use super::*;
    use crate::camera::{Lens, Pose};
    use crate::conventions::Rgb;
    use crate::photo::Image;
    use crate::shot::ShotFile;

    fn source(probe: &str) -> Result<(ProbeSource, RegisterKeys), String> {
        let text = format!(
            "[plate]\nfile = \"p.exr\"\n[camera]\nfocal_mm = 35.0\n[pose]\nfile = \"c.json\"\n[probe]\n\
             {probe}\n[support]\nplane = {{ size = [1.0, 1.0] }}\n"
        );
        match ShotFile::parse(Path::new("shot.toml"), &text) {
            Ok(shot) => Ok((shot.probe.source, shot.probe.register.expect("a register"))),
            Err(error) => Err(error.problems().join("\n")),
        }
    }

    fn with(register: &str) -> Result<(ProbeSource, RegisterKeys), String> {
        source(&format!("panorama = {{ file = \"p.exr\" }}\nregister = {{ {register} }}"))
    }

    fn camera() -> Camera {
        let pose = Pose::look_at(DVec3::new(0.0, 1.0, 3.0), DVec3::ZERO, DVec3::Y).expect("apart");
        Camera { width: 400, height: 300, lens: Lens::pinhole(400.0, 400, 300), pose }
    }

    /// A dim panorama that stands at (0, 1, 0), with small lights in these directions of its own.
    fn panorama(lights: &[DVec3]) -> Panorama {
        let mut panorama = Panorama::from_radiance(Image::filled(720, 360, Rgb::splat(0.1)));
        panorama.place = DVec3::Y;
        for y in 0..360 {
            for x in 0..720 {
                if lights.iter().any(|light| panorama.direction(x, y).angle_between(*light) < 0.012)
                {
                    panorama.radiance[(x, y)] = Rgb::splat(2000.0);
                }
            }
        }
        panorama
    }

    fn degrees(direction: DVec3) -> [f64; 2] {
        [direction.x.atan2(direction.z).to_degrees(), direction.y.asin().to_degrees()]
    }

    #[test]
    fn lights_whose_places_are_known_turn_the_panorama_into_the_world() {
        // Three lamps of known places and one far thing in the plate, seen by a panorama that stands askew.
        let turn = DQuat::from_rotation_y(1.1) * DQuat::from_rotation_x(0.2);
        let camera = camera();
        let places =
            [DVec3::new(2.0, 2.5, 0.0), DVec3::new(-1.0, 3.0, -2.0), DVec3::new(0.5, 1.8, 2.0)];
        let own = |toward: DVec3| turn.inverse() * toward.normalize();
        let mut list: Vec<String> = places
            .iter()
            .map(|at| {
                let [azimuth, elevation] = degrees(own(*at - DVec3::Y));
                format!(
                    "{{ seen = [{azimuth}, {elevation}], at = [{}, {}, {}] }}",
                    at.x, at.y, at.z
                )
            })
            .collect();
        let (_, far) = camera.ray(DVec2::new(30.0, 40.0)).expect("in the picture");
        let texel = crate::conventions::lat_long_pixel(own(far), 720, 360);
        list.push(format!("{{ texel = [{}, {}], plate_px = [30, 40] }}", texel.x, texel.y));
        let (source, keys) = with(&format!("lights = [{}]", list.join(", "))).expect("a shot");
        let mut seen = panorama(&[]);
        let found = register(&keys, &source, &mut seen, &camera).expect("four lights");
        assert!(seen.world_from_panorama.angle_between(turn) < 1e-6, "{}", found.sentence);
        assert!(found.sentence.starts_with("by 4 matched lights"), "{}", found.sentence);
        // Half a degree is assumed of each until they show more: methods-capture C6 has 0.58° for four.
        assert!((0.2..0.7).contains(&found.sigma_deg), "{}", found.sentence);
        assert!(found.warnings.is_empty());
    }

    #[test]
    fn a_false_light_is_left_out_by_name_and_mirrored_files_are_refused() {
        let (source, keys) = with(
            "lights = [{ seen = [0, 10], toward = [0, 0.17633, 1] }, { seen = [90, 0], toward = [1, 0, 0] }, \
             { seen = [200, 50], toward = [-0.21985, 0.76604, -0.60402] }, { seen = [-60, 20], toward = [1, 1, 1] }]",
        )
        .expect("a shot");
        let mut seen = panorama(&[]);
        let found = register(&keys, &source, &mut seen, &camera()).expect("three agree");
        assert!(
            seen.world_from_panorama.angle_between(DQuat::IDENTITY) < 1e-3,
            "{}",
            found.sentence
        );
        let [said] = &found.warnings[..] else { panic!("{:?}", found.warnings) };
        assert_eq!(said.about, "probe.register.lights[3]");

        let mirrored = "lights = [{ seen = [0, 10], toward = [0, 0.17633, 1] }, { seen = [-90, 0], toward = \
                        [1, 0, 0] }, { seen = [160, 50], toward = [-0.21985, 0.76604, -0.60402] }]";
        let (source, keys) = with(mirrored).expect("a shot");
        let said = register(&keys, &source, &mut seen, &camera()).expect_err("flipped");
        assert!(said.starts_with("probe.register.lights") && said.contains("mirrored"), "{said}");

        // Two lights are enough where somebody vouches for the file, and the error says so where not.
        let two = "lights = [{ seen = [0, 10], toward = [0, 0.17633, 1] }, { seen = [90, 0], toward = [1, 0, 0] }]";
        let (source, keys) = with(two).expect("a shot");
        let said = register(&keys, &source, &mut panorama(&[]), &camera()).expect_err("two");
        assert!(said.contains("unmirrored = true"), "{said}");
        let (source, keys) = with(&format!("{two}, unmirrored = true")).expect("a shot");
        let found = register(&keys, &source, &mut panorama(&[]), &camera()).expect("two");
        assert!(found.sentence.contains("2 matched"), "{}", found.sentence);
    }

    #[test]
    fn the_sun_of_a_level_panorama_turns_it_to_true_north() {
        let sun = SunPosition { azimuth_deg: 150.0, elevation_deg: 40.0 };
        let wanted = sun.direction(20.0);
        let turn = DQuat::from_rotation_y(-2.0);
        let (source, keys) = with("sun = [150, 40], north_deg = 20").expect("a shot");
        let mut seen = panorama(&[turn.inverse() * wanted]);
        let found = register(&keys, &source, &mut seen, &camera()).expect("a sun");
        let left = seen.world_from_panorama.angle_between(turn).to_degrees();
        // Texels are half a degree wide, the light is a staircase three of them across.
        assert!(left < found.sigma_deg && found.sigma_deg < 0.3, "{left}°: {}", found.sentence);
        assert!(!found.warnings[0].asks);

        let mut dark = panorama(&[]);
        let said = register(&keys, &source, &mut dark, &camera()).expect_err("no sun");
        assert!(said.contains("seen = [azimuth, elevation]"), "{said}");
        let mut low = panorama(&[DVec3::new(1.0, 0.2, 0.0).normalize()]);
        let said = register(&keys, &source, &mut low, &camera()).expect_err("a lamp");
        assert!(said.starts_with("probe.register") && said.contains("stood level"), "{said}");
    }

    #[test]
    fn keys_that_cannot_register_are_told_with_their_names() {
        for (register, said) in [
            ("", "probe.register"),
            ("lights = [{ seen = [0, 10], at = [0, 0, 1] }]", "1 given, two at least"),
            ("sun = [150, -3]", "below the horizon"),
            ("sun = [150, 30], unmirrored = true", "probe.register.unmirrored"),
            (
                "lights = [{ seen = [0, 100], at = [0, 0, 1] }, { seen = [9, 9], at = [1, 0, 1] }]",
                "lights[0].seen",
            ),
            ("lights = [{ seen = [0, 1] }, { seen = [9, 9], at = [1, 0, 1] }]", "lights[0]"),
        ] {
            let error = with(register).expect_err(register);
            assert!(error.contains(said), "{register}: {error}");
        }
        let sky =
            source("sky = { sun = [150, 40] }\nregister = { sun = [150, 40] }").expect_err("sky");
        assert!(sky.contains("probe.register: has no meaning beside sky"), "{sky}");
        let (source, keys) = with(
            "lights = [{ texel = [0, 400], at = [0, 0, 1] }, { seen = [9, 9], at = [0, 1, 0] }]",
        )
        .expect("a shot");
        let said = register(&keys, &source, &mut panorama(&[]), &camera()).expect_err("outside");
        assert!(said.contains("lights[0]: texel [0, 400] lies outside"), "{said}");
    }
}
