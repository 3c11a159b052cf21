//! Photographs of a folder → brackets, by what the camera wrote beside them.

use std::path::PathBuf;

use super::BracketError;
use super::exposure;
use crate::photo::Facts;

/// A photograph of a folder, its pixels not read.
#[derive(Clone, Debug)]
pub struct Listed {
    pub path: PathBuf,
    pub facts: Facts,
    /// Width and height as stored.
    pub size: (u32, u32),
}

/// Where one bracket ends and the next begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Grouping {
    /// Where an exposure comes again, or camera, lens, aperture or size of the picture change.
    Repeats,
    /// After so many photographs.
    Count(usize),
}

/// Exposures closer than this are one (third-stop labels next to each other are 26 % apart).
const SAME_EXPOSURE: f64 = 0.02;

/// Divides photographs, in the order they were taken, into brackets; each as positions in `photos`.
///
/// Time gaps are not looked at: they fail with long exposures. A photograph alone is a bracket of one.
///
/// # Errors
/// An exposure that is not known where it decides; photographs that a count does not divide.
pub fn group(photos: &[Listed], grouping: Grouping) -> Result<Vec<Vec<usize>>, BracketError> {
    match grouping {
        Grouping::Count(count) => {
            if count == 0 || !photos.len().is_multiple_of(count) {
                return Err(BracketError::GroupCount { count, photos: photos.len() });
            }
            Ok((0..photos.len() / count).map(|g| (g * count..(g + 1) * count).collect()).collect())
        }
        Grouping::Repeats => {
            let exposures = photos.iter().map(|photo| {
                exposure::exposure(&photo.facts).ok_or_else(|| BracketError::NoExposure {
                    path: photo.path.clone(),
                    missing: exposure::missing(&photo.facts),
                })
            });
            let exposures: Vec<f64> = exposures.collect::<Result<_, _>>()?;
            let mut groups: Vec<Vec<usize>> = Vec::new();
            for k in 0..photos.len() {
                let goes_on = |group: &&mut Vec<usize>| {
                    let setting = |i: usize| {
                        let facts = &photos[i].facts;
                        let camera = (facts.make.as_deref(), facts.model.as_deref());
                        (camera, photos[i].size, facts.focal_mm, facts.f_number)
                    };
                    let repeats =
                        |&i: &usize| (exposures[i] / exposures[k]).ln().abs() < SAME_EXPOSURE;
                    setting(group[0]) == setting(k) && !group.iter().any(repeats)
                };
                match groups.last_mut().filter(goes_on) {
                    Some(group) => group.push(k),
                    None => groups.push(vec![k]),
                }
            }
            Ok(groups)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn photo(time_s: f64, focal_mm: f64) -> Listed {
        Listed {
            path: "photo.jpg".into(),
            facts: Facts {
                exposure_s: Some(time_s),
                f_number: Some(8.0),
                iso: Some(100.0),
                focal_mm: Some(focal_mm),
                ..Facts::default()
            },
            size: (6000, 4000),
        }
    }

    fn sizes(photos: &[Listed], grouping: Grouping) -> Vec<usize> {
        group(photos, grouping).unwrap().iter().map(Vec::len).collect()
    }

    #[test]
    fn a_bracket_ends_where_an_exposure_comes_again() {
        // A camera's order, 0 − +, one set of them broken off.
        let times = [0.1, 0.025, 0.4, 0.1, 0.4, 0.1, 0.025, 0.4];
        let photos: Vec<Listed> = times.iter().map(|&t| photo(t, 35.0)).collect();
        assert_eq!(sizes(&photos, Grouping::Repeats), [3, 2, 3]);
        // Rising all the way: one bracket, however long.
        let rising: Vec<Listed> = (0..9).map(|k| photo(0.001 * 4f64.powi(k), 35.0)).collect();
        assert_eq!(sizes(&rising, Grouping::Repeats), [9]);
    }

    #[test]
    fn another_lens_is_another_bracket() {
        let photos = [photo(0.1, 35.0), photo(0.025, 35.0), photo(0.4, 50.0), photo(0.2, 50.0)];
        assert_eq!(sizes(&photos, Grouping::Repeats), [2, 2]);
    }

    #[test]
    fn a_count_must_divide_the_photographs() {
        let photos: Vec<Listed> = (0..6).map(|_| photo(0.1, 35.0)).collect();
        assert_eq!(sizes(&photos, Grouping::Count(3)), [3, 3]);
        for count in [0, 4] {
            let said = group(&photos, Grouping::Count(count)).unwrap_err().to_string();
            assert!(said.contains("6 photographs"), "{said}");
        }
    }

    #[test]
    fn a_photograph_without_an_exposure_is_named() {
        let mut unknown = photo(0.1, 35.0);
        unknown.facts.exposure_s = None;
        unknown.path = "scan_7.jpg".into();
        let said = group(&[photo(0.2, 35.0), unknown], Grouping::Repeats).unwrap_err().to_string();
        assert!(said.contains("scan_7.jpg") && said.contains("exposure time"), "{said}");
    }
}
