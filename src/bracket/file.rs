//! Merged radiance as an EXR file: mean, variance and validity, so that no later step loses them.
//!
//! Channels: R G B (mean), `variance.R/.G/.B`, `validity.Y` (the numbers of
//! [`Validity`]). All float: a sun over a thousandth of a second does not fit a half.

use std::path::Path;

use super::{BracketError, Merged, Radiance, Validity};
use crate::conventions::Rgb;
use crate::photo::exr_file::{self, ExrAttributes, ExrPicture, ExrSamples, LINEAR_REC709};
use crate::photo::{
    Facts, Format, Image, NonFinite, Photo, PhotoError, ReadOptions, read as read_picture,
    read_layer,
};

/// Writes a merged bracket; its exposures and noise go into the file's `comments` as JSON.
pub fn write(path: &Path, merged: &Merged) -> Result<(), PhotoError> {
    let Radiance { mean, variance, validity } = &merged.radiance;
    let comments = serde_json::json!({
        "unit": "linear photograph value (white = 1) / (time_s * iso/100 / f_number^2)",
        "exposures": merged.exposures,
        "full_well_e": merged.noise.full_well_e,
        "read_noise_e": merged.noise.read_noise_e,
        "noise_measured": merged.noise.measured,
        "validity": "0 measured, 1 single, 2 lower bound, 3 upper bound, 4 moved, 5 filled, 6 analytic",
    });
    let mut picture = ExrPicture {
        width: mean.width(),
        height: mean.height(),
        channels: Vec::new(),
        attributes: ExrAttributes {
            comments: Some(comments.to_string()),
            colour_id: Some(LINEAR_REC709),
            facts: Some(Facts {
                focal_mm: merged.focal_mm[0],
                focal_35mm: merged.focal_mm[1],
                ..Facts::default()
            }),
            ..ExrAttributes::default()
        },
    };
    for (layer, image) in [("", mean), ("variance.", variance)] {
        for (channel, name) in ["R", "G", "B"].into_iter().enumerate() {
            let samples = image.pixels().iter().map(|l| l[channel]).collect();
            picture.push(format!("{layer}{name}"), ExrSamples::F32(samples));
        }
    }
    let classes = validity.pixels().iter().map(|&v| u32::from(v as u8)).collect();
    picture.push("validity.Y", ExrSamples::U32(classes));
    exr_file::write(path, &picture)
}

/// Reads what [`write()`] wrote.
///
/// # Errors
/// Files that are unreadable or lack the variance or validity layer.
pub fn read(path: &Path) -> Result<Radiance, PhotoError> {
    let mean = read_picture(path, &ReadOptions::default())?.linear;
    let size = (mean.width(), mean.height());
    let Some((variance, validity)) = layers(path, size)? else {
        let cause = "has no variance and validity layers; merge the bracket again".into();
        return Err(PhotoError::Picture { path: path.into(), cause });
    };
    Ok(Radiance { mean, variance, validity })
}

/// A picture that already holds radiance, with the variance and validity of its file where that has
/// them.
///
/// Of any other picture the noise is not known and counts as none; clipped pixels are lower bounds.
/// Negative light, which compression and colour conversion make, becomes none. What the file does not
/// hold (outside its data window) is black and [`Validity::Filled`]: not seen.
///
/// # Errors
/// Pixels that are not finite: 0 in their place would be taken for measured darkness. Layers that
/// are there but cannot be used.
pub fn from_picture(photo: &Photo) -> Result<Radiance, BracketError> {
    if let Some(NonFinite { pixels, first }) = photo.nonfinite {
        return Err(BracketError::NotFinite { path: photo.path.clone(), pixels, first });
    }
    let size = (photo.linear.width(), photo.linear.height());
    let stored = match photo.format {
        Format::Exr => layers(&photo.path, size)?,
        _ => None,
    };
    let (variance, mut validity) = stored.unwrap_or_else(|| {
        let class = |&clipped: &bool| match clipped {
            true => Validity::LowerBound,
            false => Validity::Measured,
        };
        (photo.linear.map(|_| Rgb::ZERO), photo.clipped.map(class))
    });
    if let Some(window) = photo.data_window {
        for (k, class) in validity.pixels_mut().iter_mut().enumerate() {
            if !window.contains((k % size.0, k / size.0)) {
                *class = Validity::Filled;
            }
        }
    }
    Ok(Radiance { mean: photo.linear.map(|l| l.max(Rgb::ZERO)), variance, validity })
}

/// Variance and validity of every pixel.
type Layers = (Image<Rgb>, Image<Validity>);

/// The layers of a picture of that size; `None` if the file has neither.
fn layers(path: &Path, size: (usize, usize)) -> Result<Option<Layers>, PhotoError> {
    let damaged = |cause: String| PhotoError::Picture { path: path.into(), cause };
    let (variance, validity) = match (read_layer(path, "variance")?, read_layer(path, "validity")?)
    {
        (Some(variance), Some(validity)) => (variance, validity),
        (None, None) => return Ok(None),
        (Some(_), None) | (None, Some(_)) => {
            return Err(damaged(
                "has only one of the layers variance and validity; write it with both, or neither"
                    .into(),
            ));
        }
    };
    for (name, layer) in [("variance", &variance), ("validity", &validity)] {
        let (w, h) = (layer.linear.width(), layer.linear.height());
        if (w, h) != size {
            return Err(damaged(format!(
                "its layer {name} has {w} × {h} px, the picture {} × {}; write it again",
                size.0, size.1
            )));
        }
        if let Some(NonFinite { pixels, first: (x, y) }) = layer.nonfinite {
            return Err(damaged(format!(
                "its layer {name} is not finite in {pixels} px, first at ({x}, {y}); write it again"
            )));
        }
    }
    let classes: Option<Vec<Validity>> =
        validity.linear.pixels().iter().map(|value| class(value.x)).collect();
    let classes = classes.and_then(|classes| Image::from_pixels(size.0, size.1, classes));
    let classes = classes.ok_or_else(|| {
        damaged("its layer validity holds numbers other than 0 to 6; write it again".into())
    })?;
    Ok(Some((variance.linear, classes)))
}

/// The class of a stored number; `None` for what is none.
fn class(number: f32) -> Option<Validity> {
    const CLASSES: [Validity; 7] = [
        Validity::Measured,
        Validity::Single,
        Validity::LowerBound,
        Validity::UpperBound,
        Validity::Moved,
        Validity::Filled,
        Validity::Analytic,
    ];
    CLASSES.into_iter().find(|&class| f32::from(class as u8) == number)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bracket::{Frame, MergeOptions, merge};
    use crate::photo::{Photo, Samples};

    #[test]
    fn a_merged_bracket_survives_its_file_exactly() {
        let scene = Image::from_fn(40, 30, |x, y| Rgb::new(x as f32, y as f32, 0.5) / 50.0);
        let mut photo = Photo::from_linear(scene);
        photo.facts.focal_mm = Some(35.0);
        photo.facts.focal_35mm = Some(52.5);
        let mut photo = photo.encoded();
        let Samples::F32 { data, .. } = &mut photo.samples else { panic!("made of floats") };
        data[(3 * 40 + 7) * 3] = f32::INFINITY;
        let frames = [Frame { photo: &photo, exposure: 1e-6 }];
        let merged = merge(&frames, &MergeOptions::default()).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("merged.exr");
        write(&path, &merged).unwrap();
        let back = read(&path).unwrap();
        assert_eq!(back.mean, merged.radiance.mean);
        assert_eq!(back.variance, merged.radiance.variance);
        assert_eq!(back.validity, merged.radiance.validity);
        assert_eq!(back.validity[(7, 3)], Validity::LowerBound);
        // The lens, which a ball's panorama needs; the exposure is divided out and not told.
        let facts = read_picture(&path, &ReadOptions::default()).unwrap().facts;
        assert_eq!(facts.focal_mm, Some(35.0));
        assert!((facts.focal_35mm.unwrap() / 52.5 - 1.0).abs() < 1e-6, "{facts:?}");
        assert_eq!(facts.exposure_s, None);
        // A class this program does not know is no class at all.
        for odd in [7.0, 1.5, -1.0, f32::NAN] {
            assert_eq!(class(odd), None, "{odd}");
        }
        // A plain picture has no variance: said, not guessed.
        let plain = folder.path().join("plain.hdr");
        let linear = Image::filled(4, 3, Rgb::ONE);
        crate::photo::radiance_hdr::write(&plain, &linear, Default::default()).unwrap();
        assert!(read(&plain).is_err());
    }

    #[test]
    fn a_picture_without_layers_keeps_its_clipped_pixels_and_never_its_nan() {
        let mut photo = Photo::from_linear(Image::filled(4, 3, Rgb::new(1.0, -0.5, 2.0)));
        photo.clipped[(2, 1)] = true;
        let radiance = from_picture(&photo).unwrap();
        assert_eq!(radiance.mean[(0, 0)], Rgb::new(1.0, 0.0, 2.0));
        assert_eq!(radiance.validity[(2, 1)], Validity::LowerBound);
        assert_eq!(radiance.validity[(2, 2)], Validity::Measured);
        photo.data_window = Some(crate::photo::Window { first: (1, 0), size: (3, 2) });
        let part = from_picture(&photo).unwrap().validity;
        let unseen = part.pixels().iter().filter(|&&v| v == Validity::Filled).count();
        assert_eq!((unseen, part[(0, 0)], part[(3, 1)]), (6, Validity::Filled, Validity::Measured));
        photo.nonfinite = Some(NonFinite { pixels: 3, first: (1, 2) });
        let error = from_picture(&photo).unwrap_err().to_string();
        assert!(error.contains("3 pixels") && error.contains("(1, 2)"), "{error}");
    }
}
