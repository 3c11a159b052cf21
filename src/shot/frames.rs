//! Frame ranges and numbered file names: `1001-1048x2,1060` and `plate.####.exr`.

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::file::ShotFile;

/// Frame numbers in the order in which they were named, without repetition.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Frames(Vec<i64>);

/// More frames than this in one shot are a slip of the finger.
const MAX_FRAMES: usize = 100_000;

impl Frames {
    /// Reads `1001`, `1001-1048`, `1001-1048x2` and lists of them with commas; numbers may be negative.
    pub fn parse(text: &str) -> Result<Self, String> {
        let mut frames = Vec::new();
        for part in text.split(',') {
            let (first, last, step) = parse_part(part.trim()).ok_or_else(|| {
                format!("\"{part}\" is no frame range; write 1001-1048, 1001-1048x2 or 1001,1005")
            })?;
            let mut frame = first;
            while frame <= last {
                if frames.len() >= MAX_FRAMES {
                    return Err(format!("\"{text}\" names more than {MAX_FRAMES} frames"));
                }
                frames.push(frame);
                frame += step;
            }
        }
        let mut seen = std::collections::HashSet::new();
        frames.retain(|&frame| seen.insert(frame));
        Ok(Self(frames))
    }

    pub fn iter(&self) -> impl Iterator<Item = i64> {
        self.0.iter().copied()
    }
}

/// Whether frames can have this number; sums of two of them do not overflow.
pub fn is_number(number: &i64) -> bool {
    number.unsigned_abs() < 1 << 40
}

fn number(text: &str) -> Option<i64> {
    text.parse().ok().filter(is_number)
}

/// First, last and step of one range; `None` if it is not one, runs backwards or has no positive step.
fn parse_part(part: &str) -> Option<(i64, i64, i64)> {
    let (range, step) = match part.split_once('x') {
        Some((range, step)) => (range, number(step).filter(|&step| step > 0)?),
        None => (part, 1),
    };
    // A minus at the start is a sign, the next one a range.
    let dash = range.char_indices().skip(1).find(|&(_, c)| c == '-').map(|(i, _)| i);
    let (first, last) = match dash {
        Some(i) => (number(&range[..i])?, number(&range[i + 1..])?),
        None => (number(range)?, number(range)?),
    };
    (first <= last).then_some((first, last, step))
}

impl ShotFile {
    /// The shot of one frame of the sequence.
    pub fn at_frame(&self, frame: i64) -> Self {
        let mut single = self.clone();
        single.plate.file = frame_path(&self.plate.file, frame);
        single.plate.frame = Some(frame);
        single
    }
}

/// True if the file's name has a place for a frame's number: `####`, `%04d` or `$F4`.
pub fn has_pattern(path: impl AsRef<Path>) -> bool {
    place(path.as_ref()).is_some()
}

/// The file of frame `frame`; the path itself if its last part has no place for a number.
///
/// Each # is a digit, but a single # stands for four (OpenImageIO, fileseq). Folders are names, not
/// patterns.
pub fn frame_path(path: &Path, frame: i64) -> PathBuf {
    let Some((name, (start, end, digits))) = place(path) else {
        return path.to_owned();
    };
    let sign = if frame < 0 { "-" } else { "" };
    let number = format!("{sign}{:0digits$}", frame.unsigned_abs());
    path.with_file_name(format!("{}{number}{}", &name[..start], &name[end..]))
}

/// The file's name, and the frame's place in it.
fn place(path: &Path) -> Option<(&str, (usize, usize, usize))> {
    let name = path.file_name()?.to_str()?;
    Some((name, pattern(name)?))
}

/// Most digits a frame's number is written with.
const MAX_DIGITS: usize = 20;

/// First and last byte of the frame's place, and how many digits it has.
fn pattern(name: &str) -> Option<(usize, usize, usize)> {
    if let Some(start) = name.find('#') {
        let length = name[start..].bytes().take_while(|&b| b == b'#').count();
        let digits = if length == 1 { 4 } else { length };
        return (digits <= MAX_DIGITS).then_some((start, start + length, digits));
    }
    let spelled = |prefix: &str, suffix: &str| {
        let start = name.find(prefix)?;
        let digits = name[start + prefix.len()..].bytes().take_while(u8::is_ascii_digit).count();
        let end = start + prefix.len() + digits;
        let width = name[start + prefix.len()..end].parse().ok().filter(|&n| n <= MAX_DIGITS)?;
        name[end..].starts_with(suffix).then_some((start, end + suffix.len(), width))
    };
    spelled("%0", "d").or_else(|| spelled("$F", ""))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn list(text: &str) -> Vec<i64> {
        Frames::parse(text).expect("a range").0
    }

    #[test]
    fn ranges_steps_and_lists_are_expanded_in_order() {
        assert_eq!(list("1001-1004"), [1001, 1002, 1003, 1004]);
        assert_eq!(list("1001-1006x2"), [1001, 1003, 1005]);
        assert_eq!(list("-2--1, 5,4-5"), [-2, -1, 5, 4]);
    }

    #[test]
    fn nonsense_is_refused_with_a_sentence() {
        for text in ["", "a", "1-", "5-1", "1-5x0", "1-5x-1", "1-9999999999", "1..5", "1-5:2"] {
            assert!(Frames::parse(text).is_err(), "{text} was accepted");
        }
        // At the edge of the type.
        for text in ["1-5x9223372036854775807", "-9223372036854775808", "1-5x-9223372036854775808"]
        {
            assert!(Frames::parse(text).is_err(), "{text} was accepted");
        }
    }

    #[test]
    fn every_usual_padding_is_understood() {
        let name = |name: &str, frame| frame_path(Path::new(name), frame).display().to_string();
        assert_eq!(name("p.####.exr", 7), "p.0007.exr");
        assert_eq!(name("p.#.exr", 7), "p.0007.exr");
        assert_eq!(name("p.##.exr", 1001), "p.1001.exr");
        assert_eq!(name("p.%05d.exr", 7), "p.00007.exr");
        assert_eq!(name("p.$F4.exr", -7), "p.-0007.exr");
        assert_eq!(name("p.exr", 7), "p.exr");
        assert!(!has_pattern("p%.exr"));
    }

    #[test]
    fn folders_are_names_not_patterns() {
        assert_eq!(frame_path(Path::new("sho#w/$F4/p.##.exr"), 7), Path::new("sho#w/$F4/p.07.exr"));
        assert!(!has_pattern("sho#w/plate.png"));
        assert!(!has_pattern(format!("{}.exr", "#".repeat(70_000))));
    }

    #[test]
    #[cfg(unix)]
    fn a_folder_that_is_not_utf_8_stays_as_it_is() {
        use std::os::unix::ffi::OsStrExt;
        let folder = Path::new(std::ffi::OsStr::from_bytes(b"shots\xff"));
        assert_eq!(frame_path(&folder.join("p.#.exr"), 7), folder.join("p.0007.exr"));
    }
}
