//! A moment as people write it: RFC 3339, always with its zone.
//!
//! The sun moves 15° an hour, so that a time without its zone is no time: it is refused, not guessed.

use std::fmt;
use std::str::FromStr;

/// A moment, and the zone in which it was written.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moment {
    /// Seconds since 1970-01-01T00:00:00Z, without leap seconds.
    unix_s: f64,
    /// What the clock beside it is ahead of UTC.
    zone_s: i32,
}

/// Why a text is no moment.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum MomentError {
    #[error("\"{0}\" is no date and time; write 2026-06-21T12:00:00+02:00")]
    Form(String),
    #[error(
        "\"{0}\" has no zone: 12 o'clock is another sun in each; write Z for UTC or what the clock was \
         ahead of it, +02:00, summer time included"
    )]
    NoZone(String),
    #[error("\"{text}\": {found} is no {field}")]
    Field { text: String, field: &'static str, found: i64 },
    #[error("\"{0}\" is not between 1900 and 2100, for which the sun's place is known")]
    Far(String),
}

const DAY_S: f64 = 86_400.0;
/// 2000-01-01T12:00:00Z.
const J2000_UNIX_S: f64 = 946_728_000.0;

impl Moment {
    /// Days since noon of 1 January 2000, UTC.
    pub fn days_since_j2000(self) -> f64 {
        (self.unix_s - J2000_UNIX_S) / DAY_S
    }

    /// Hours since midnight, UTC.
    pub fn utc_hours(self) -> f64 {
        self.unix_s.rem_euclid(DAY_S) / 3600.0
    }

    /// The same clock so many seconds later.
    pub fn later(self, seconds: f64) -> Self {
        Self { unix_s: self.unix_s + seconds, ..self }
    }

    /// Seconds from `earlier` to this.
    pub fn seconds_since(self, earlier: Self) -> f64 {
        self.unix_s - earlier.unix_s
    }
}

impl FromStr for Moment {
    type Err = MomentError;

    /// Reads `2026-06-21T12:00:00+02:00`; T may be a space, seconds may be left out or have a fraction.
    fn from_str(text: &str) -> Result<Self, MomentError> {
        let form = || MomentError::Form(text.to_owned());
        let (date, clock) = text.split_once(['T', 't', ' ']).ok_or_else(form)?;
        let (clock, zone) = match clock.find(['Z', 'z', '+', '-']) {
            Some(at) => clock.split_at(at),
            None if numbers(clock, ':').is_some_and(|n| n.len() >= 2) => {
                return Err(MomentError::NoZone(text.to_owned()));
            }
            None => return Err(form()),
        };
        let date = numbers(date, '-').filter(|_| date.len() == 10).ok_or_else(form)?;
        let (whole_s, fraction) = match clock.split_once('.') {
            Some((whole, digits)) if !digits.is_empty() && clock.matches(':').count() == 2 => {
                let is_number = digits.bytes().all(|b| b.is_ascii_digit());
                let fraction = format!("0.{digits}").parse::<f64>().ok();
                (whole, fraction.filter(|_| is_number).ok_or_else(form)?)
            }
            Some(_) => return Err(form()),
            None => (clock, 0.0),
        };
        let clock = numbers(whole_s, ':').ok_or_else(form)?;
        let (&[year, month, day], (&[hour, minute], second)) = (
            date.as_slice(),
            match clock.as_slice() {
                [to_minute @ .., second] if clock.len() == 3 => (to_minute, *second),
                to_minute => (to_minute, 0),
            },
        ) else {
            return Err(form());
        };
        let field = |field, found, range: std::ops::RangeInclusive<i64>| {
            let wrong = MomentError::Field { text: text.to_owned(), field, found };
            if range.contains(&found) { Ok(found) } else { Err(wrong) }
        };
        if !(1900..=2100).contains(&year) {
            return Err(MomentError::Far(text.to_owned()));
        }
        field("month", month, 1..=12)?;
        field("day of this month", day, 1..=days_of_month(year, month))?;
        field("hour", hour, 0..=23)?;
        field("minute", minute, 0..=59)?;
        field("second", second, 0..=59)?;
        let zone_s = match (zone, zone.split_at_checked(1)) {
            ("Z" | "z", _) => 0,
            (_, Some((sign, digits))) if digits.len() == 5 => match numbers(digits, ':').as_deref()
            {
                Some(&[hours, minutes]) => {
                    field("zone's hour", hours, 0..=14)?;
                    field("zone's minute", minutes, 0..=59)?;
                    let ahead = 3600 * hours + 60 * minutes;
                    (if sign == "-" { -ahead } else { ahead }) as i32
                }
                _ => return Err(form()),
            },
            _ => return Err(form()),
        };
        let days = days_from_civil(year, month, day) as f64;
        let clock_s = (3600 * hour + 60 * minute + second) as f64 + fraction;
        Ok(Self { unix_s: days * DAY_S + clock_s - f64::from(zone_s), zone_s })
    }
}

/// RFC 3339 in the zone it was written in, to the second.
impl fmt::Display for Moment {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let local = (self.unix_s + f64::from(self.zone_s)).round() as i64;
        let (year, month, day) = civil_from_days(local.div_euclid(86_400));
        let s = local.rem_euclid(86_400);
        let (hour, minute, second) = (s / 3600, s / 60 % 60, s % 60);
        write!(f, "{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}")?;
        if self.zone_s == 0 {
            return f.write_str("Z");
        }
        let (sign, ahead) = (if self.zone_s < 0 { '-' } else { '+' }, self.zone_s.abs());
        write!(f, "{sign}{:02}:{:02}", ahead / 3600, ahead / 60 % 60)
    }
}

impl serde::Serialize for Moment {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// Whole numbers of 2 or 4 digits between separators.
fn numbers(text: &str, separator: char) -> Option<Vec<i64>> {
    let number = |part: &str| {
        let digits = matches!(part.len(), 2 | 4) && part.bytes().all(|b| b.is_ascii_digit());
        digits.then(|| part.parse().ok()).flatten()
    };
    text.split(separator).map(number).collect()
}

fn days_of_month(year: i64, month: i64) -> i64 {
    let (next_year, next) = if month == 12 { (year + 1, 1) } else { (year, month + 1) };
    days_from_civil(next_year, next, 1) - days_from_civil(year, month, 1)
}

/// Days since 1970-01-01 of a Gregorian date (Hinnant, "chrono-compatible low-level date algorithms"):
/// the year begins in March, so that the leap day is its last.
fn days_from_civil(year: i64, month: i64, day: i64) -> i64 {
    let year = if month <= 2 { year - 1 } else { year };
    let era = year.div_euclid(400);
    let year_of_era = year.rem_euclid(400);
    let day_of_year = (153 * ((month + 9) % 12) + 2) / 5 + day - 1;
    era * 146_097 + year_of_era * 365 + year_of_era / 4 - year_of_era / 100 + day_of_year - 719_468
}

/// Inverse of [`days_from_civil`].
fn civil_from_days(days: i64) -> (i64, i64, i64) {
    let days = days + 719_468;
    let day_of_era = days.rem_euclid(146_097);
    let year_of_era =
        (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let march_month = (5 * day_of_year + 2) / 153;
    let month = (march_month + 2) % 12 + 1;
    let year = 400 * days.div_euclid(146_097) + year_of_era + i64::from(month <= 2);
    (year, month, day_of_year - (153 * march_month + 2) / 5 + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn moment(text: &str) -> Moment {
        text.parse().unwrap_or_else(|error| panic!("{error}"))
    }

    #[test]
    fn moments_are_those_of_the_julian_calendar_of_astronomers() {
        assert_eq!(moment("2000-01-01T12:00:00Z").days_since_j2000(), 0.0);
        // JD 2452930.312847, the worked example of NREL/TP-560-34302.
        let days = moment("2003-10-17T12:30:30-07:00").days_since_j2000();
        assert!((days - (2_452_930.312_847 - 2_451_545.0)).abs() < 1e-6, "{days}");
        assert!(
            (moment("2003-10-17T12:30:30-07:00").utc_hours() - (19.0 + 30.5 / 60.0)).abs() < 1e-9
        );
        assert_eq!(moment("1970-01-01T00:00Z").unix_s, 0.0);
        assert_eq!(moment("1969-12-31 23:59:59.5z").unix_s, -0.5);
    }

    #[test]
    fn the_same_moment_in_another_zone_is_the_same_moment() {
        let (here, there) = (moment("2026-06-21T12:00:00+05:45"), moment("2026-06-21T06:15:00Z"));
        assert_eq!(here.seconds_since(there), 0.0);
        assert_eq!(here.to_string(), "2026-06-21T12:00:00+05:45");
        assert_eq!(
            moment("2026-01-01T00:30:00-03:30").later(-3600.0).to_string(),
            "2025-12-31T23:30:00-03:30"
        );
    }

    #[test]
    fn every_day_of_two_centuries_goes_there_and_back() {
        for days in days_from_civil(1900, 1, 1)..days_from_civil(2101, 1, 1) {
            let (year, month, day) = civil_from_days(days);
            assert_eq!(days_from_civil(year, month, day), days);
            assert!((1..=12).contains(&month) && (1..=days_of_month(year, month)).contains(&day));
        }
        assert_eq!(civil_from_days(days_from_civil(2000, 2, 29)), (2000, 2, 29));
    }

    #[test]
    fn what_is_no_moment_is_told_with_its_remedy() {
        let said = |text: &str| text.parse::<Moment>().unwrap_err().to_string();
        for text in ["2026-06-21T12:00:00", "2026-06-21 12:00"] {
            assert!(said(text).contains("zone") && said(text).contains("+02:00"), "{}", said(text));
        }
        for text in [
            "",
            "noon",
            "2026-06-21",
            "T",
            "2026-06-21T",
            "2026-06-21TZ",
            "2026-06-21T1:00Z",
            "2026-06-21T12Z",
            "2026-06-21T12:00:00.Z",
            "2026-06-21T12:00.5Z",
            "26-06-21T12:00Z+",
            "2026-06-21T12:00:00+2",
            "2026-06-21T12:00:00+0200",
            "2026-06-21T12:00:00+02:00:00",
            "2026-06-21T12:00:00Z ",
            "2026-06-21T12:00:00é",
            "+2026-06-21T12:00Z",
            "2026-06-21T12:00:00-é:0",
        ] {
            assert!(
                said(text).contains("write 2026-06-21T12:00:00+02:00"),
                "{text}: {}",
                said(text)
            );
        }
        for (text, part) in [
            ("2026-13-01T12:00Z", "13 is no month"),
            ("2026-02-29T12:00Z", "29 is no day of this month"),
            ("2026-01-01T24:00Z", "24 is no hour"),
            ("2026-01-01T12:60Z", "60 is no minute"),
            ("2026-01-01T12:00:61Z", "61 is no second"),
            ("2026-01-01T12:00+15:00", "15 is no zone's hour"),
            ("1800-01-01T12:00Z", "between 1900 and 2100"),
        ] {
            assert!(said(text).contains(part), "{text}: {}", said(text));
        }
    }
}
