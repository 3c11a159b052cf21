//! `animation`, `time` and `start_frame`: which moment of its file's animation a thing shows.
//!
//! A single plate shows the second that `time` names, and without it the pose the file stores. Under a
//! sequence the animation plays: its second 0 in `start_frame`, one frame each 1/`plate.fps` seconds.

use serde::Serialize;

use super::file::PlateKeys;
use super::keys::Keys;

/// What an `[[object]]` or `[[local]]` says of its file's animation.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Motion {
    /// By its name in the file; the first one if not given.
    pub animation: Option<String>,
    /// Seconds into the animation; a sequence shows them in every frame.
    pub time: Option<f64>,
    /// Frame of the plate that shows second 0; the lowest one if not given.
    pub start_frame: Option<i64>,
}

impl Motion {
    /// Reads the three keys of a table; `plate` is `None` where it has problems of its own.
    pub fn read(keys: &Keys, plate: Option<&PlateKeys>) -> Self {
        let motion = Self {
            animation: keys.text("animation").map(str::to_owned),
            time: keys.number("time"),
            start_frame: keys.whole("start_frame"),
        };
        if keys.has("time") && keys.has("start_frame") {
            keys.problem(
                "start_frame",
                "and time exclude each other, since time holds the animation still; keep one",
            );
        } else if plate.is_some_and(|plate| plate.frames.is_none()) {
            let remedy = "the plate is a single picture; give time, the second to show, instead";
            if keys.has("start_frame") {
                keys.problem("start_frame", remedy);
            }
            if keys.has("animation") && !keys.has("time") {
                keys.problem(
                    "animation",
                    "needs time beside it: the second that a single plate shows of it",
                );
            }
        }
        motion
    }

    /// True if the shot file speaks of an animation, so that there must be one.
    pub fn is_asked_for(&self) -> bool {
        *self != Self::default()
    }

    /// True if frames of a sequence show different times.
    pub fn plays(&self, plate: &PlateKeys) -> bool {
        self.time.is_none() && plate.frames.is_some()
    }

    /// Seconds into the animation that this plate or frame shows; `None` for the pose at rest.
    pub fn time_s(&self, plate: &PlateKeys) -> Option<f64> {
        if self.time.is_some() {
            return self.time;
        }
        let first = plate.frames.as_ref()?.iter().min()?;
        let start = self.start_frame.unwrap_or(first);
        Some((plate.frame.unwrap_or(first) - start) as f64 / plate.fps)
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use crate::shot::ShotFile;

    /// A shot file with these keys of the plate, and of an object.
    fn shot(plate: &str, object: &str) -> Result<ShotFile, String> {
        let text = format!(
            "[plate]\n{plate}\n[camera]\nfocal_mm = 35\n[pose]\nfile = \"camera.json\"\n\
             [probe]\npanorama = {{ file = \"p.exr\" }}\n[support]\nplane = {{ size = [3, 3] }}\n\
             [[object]]\nfile = \"a.glb\"\n{object}\n"
        );
        ShotFile::parse(Path::new("shot.toml"), &text).map_err(|error| error.to_string())
    }

    const SINGLE: &str = "file = \"p.exr\"";
    const FRAMES: &str = "file = \"p.####.exr\"\nframes = \"1003,1001-1002\"";

    #[test]
    fn time_follows_the_frames_from_the_lowest_or_the_start_frame() {
        let time = |plate: &str, object: &str, frame: i64| {
            let shot = shot(plate, object).expect("a good shot").at_frame(frame);
            shot.objects[0].motion.time_s(&shot.plate)
        };
        assert_eq!(time(FRAMES, "", 1001), Some(0.0));
        assert_eq!(time(FRAMES, "", 1003), Some(2.0 / 24.0));
        let slow = format!("{FRAMES}\nfps = 12.5");
        assert_eq!(time(&slow, "start_frame = 900", 1001), Some(101.0 / 12.5));
        // Before it starts it has not begun.
        assert_eq!(time(FRAMES, "start_frame = 1025", 1001), Some(-1.0));
        assert_eq!(time(FRAMES, "time = 1.25", 1003), Some(1.25));
        let single = |object: &str| {
            let shot = shot(SINGLE, object).expect("a good shot");
            shot.objects[0].motion.time_s(&shot.plate)
        };
        assert_eq!(single("animation = \"walk\"\ntime = 2"), Some(2.0));
        assert_eq!(single(""), None);
    }

    #[test]
    fn keys_without_effect_are_told() {
        let faster = format!("{SINGLE}\nfps = 30");
        for (plate, object, told) in [
            (SINGLE, "animation = \"walk\"", "object[0].animation: needs time beside it"),
            (SINGLE, "start_frame = 3", "object[0].start_frame: the plate is a single picture"),
            (FRAMES, "start_frame = 3\ntime = 1", "start_frame: and time exclude each other"),
            (FRAMES, "start_frame = 1.5", "start_frame: expected a whole number"),
            (FRAMES, "start_frame = 9000000000000000", "start_frame: expected a whole number"),
            (FRAMES, "time = nan", "object[0].time: expected a finite number"),
            (&faster, "", "plate.fps: is given, but"),
            (&format!("{FRAMES}\nfps = 0"), "", "plate.fps: expected a number above 0"),
        ] {
            let error = shot(plate, object).expect_err(told);
            assert!(error.contains(told), "{error}");
        }
    }
}
