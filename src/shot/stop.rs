//! When to stop rendering: one rule and one wording for `[render]` and for the command line.

use std::fmt;

use serde::Serialize;

use super::keys::Keys;

/// What ends a rendering.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum StopKeys {
    /// Error relative to the plate.
    Error(f64),
    /// Seconds, preparation and writing included.
    Time(f64),
    /// Samples in every pixel that the objects change.
    Samples(u32),
}

/// Errors that can be asked for, as shares of the plate.
const ERRORS: std::ops::Range<f64> = 1e-5..1.0;

impl Default for StopKeys {
    /// One per cent of the plate: what an eye does not see in a single picture.
    fn default() -> Self {
        Self::Error(0.01)
    }
}

impl StopKeys {
    // Errors of these four are sentences without the key.

    pub fn error(share: f64) -> Result<Self, String> {
        if ERRORS.contains(&share) {
            return Ok(Self::Error(share));
        }
        Err(format!(
            "{share} is no share of the plate; write one from 1e-5 to below 1, such as 0.01, one per \
             cent, which no eye sees"
        ))
    }

    pub fn seconds(seconds: f64) -> Result<Self, String> {
        if seconds.is_finite() && seconds > 0.0 {
            Ok(Self::Time(seconds))
        } else {
            no_time(seconds)
        }
    }

    /// `60`, `60s`, `5m` or `2h`.
    pub fn time(text: &str) -> Result<Self, String> {
        let (number, seconds_each) = match text.trim().char_indices().last() {
            Some((end, 's')) => (&text.trim()[..end], 1.0),
            Some((end, 'm')) => (&text.trim()[..end], 60.0),
            Some((end, 'h')) => (&text.trim()[..end], 3600.0),
            _ => (text.trim(), 1.0),
        };
        let seconds = number.trim().parse::<f64>().map(|n| n * seconds_each);
        let known = seconds.ok().filter(|s| s.is_finite() && *s > 0.0);
        known.map_or_else(|| no_time(format!("\"{text}\"")), |seconds| Ok(Self::Time(seconds)))
    }

    pub fn samples(n: f64) -> Result<Self, String> {
        if n.fract() == 0.0 && (1.0..=f64::from(u32::MAX)).contains(&n) {
            return Ok(Self::Samples(n as u32));
        }
        Err(format!("{n} is no number of samples; write a whole number of 1 or more"))
    }

    /// The one of `error`, `time` and `samples` that a table has; the default if it has none.
    pub(super) fn read(keys: &Keys) -> Option<Self> {
        if !Self::KEYS.iter().any(|key| keys.has(key)) {
            return Some(Self::default());
        }
        let key = keys.exactly_one(Self::KEYS)?;
        let read = match key {
            "time" if keys.is_text("time") => Self::time(keys.text("time")?),
            "time" => Self::seconds(keys.number("time")?),
            "error" => Self::error(keys.number("error")?),
            _ => Self::samples(keys.number("samples")?),
        };
        read.map_err(|cause| keys.problem(key, &cause)).ok()
    }

    const KEYS: &[&str] = &["error", "time", "samples"];
}

fn no_time(found: impl fmt::Display) -> Result<StopKeys, String> {
    Err(format!("{found} is no time; write seconds above 0, or \"60s\", \"5m\", \"2h\""))
}

/// As the report names it.
impl fmt::Display for StopKeys {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            // 0.022 as 2.2, not as 2.1999999999999997
            Self::Error(error) => write!(f, "error {} %", (1e8 * error).round() / 1e6),
            Self::Time(seconds) => write!(f, "{seconds} s in all"),
            Self::Samples(samples) => write!(f, "{samples} samples a pixel"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_read_with_their_units() {
        for (text, seconds) in
            [("60", 60.0), ("60s", 60.0), ("1.5m", 90.0), (" 2 h ", 7200.0), ("1e3", 1000.0)]
        {
            assert_eq!(StopKeys::time(text), Ok(StopKeys::Time(seconds)), "{text}");
        }
        for text in ["", "s", "soon", "0", "0s", "-5m", "infs", "nan", "60 é", "5d"] {
            let said = StopKeys::time(text).expect_err(text);
            assert!(said.contains(&format!("\"{text}\" is no time; write")), "{said}");
        }
    }

    #[test]
    fn an_error_is_said_as_it_was_written() {
        for (share, said) in [(0.022, "error 2.2 %"), (0.01, "error 1 %"), (1e-5, "error 0.001 %")]
        {
            assert_eq!(StopKeys::Error(share).to_string(), said);
        }
    }

    #[test]
    fn what_stops_nothing_is_refused_with_what_to_write() {
        for share in [-1.0, 0.0, 1e-6, 1.0, 5.0, f64::NAN] {
            assert!(StopKeys::error(share).unwrap_err().contains("write one from"), "{share}");
        }
        for n in [-4.0, 0.0, 2.5, 5e9, f64::INFINITY] {
            assert!(StopKeys::samples(n).unwrap_err().contains("1 or more"), "{n}");
        }
        assert_eq!(StopKeys::error(1e-5), Ok(StopKeys::Error(1e-5)));
        assert_eq!(StopKeys::samples(4_294_967_295.0), Ok(StopKeys::Samples(u32::MAX)));
        assert!(StopKeys::seconds(0.0).unwrap_err().starts_with("0 is no time; write"));
    }
}
