//! Merged radiance as an EXR file: mean, variance and validity, so that no later step loses them.
//!
//! Channels: R G B (mean), `variance.R/.G/.B`, `validity.Y` (the numbers of
//! [`Validity`]). All float: a sun over a thousandth of a second does not fit a half.

use std::path::Path;

use super::{Merged, Radiance, Validity};
use crate::conventions::Rgb;
use crate::photo::exr_file::{self, ExrAttributes, ExrPicture, ExrSamples, LINEAR_REC709};
use crate::photo::{Image, PhotoError, ReadOptions, read as read_picture};

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
    let layer = |layer: Option<&str>| {
        let options = ReadOptions { layer: layer.map(Into::into), ..ReadOptions::default() };
        read_picture(path, &options)
    };
    let mean = layer(None)?.linear;
    let variance = layer(Some("variance"))?.linear;
    let validity = layer(Some("validity"))?.linear;
    if (variance.width(), variance.height()) != (mean.width(), mean.height()) {
        let cause = "its parts have different sizes".into();
        return Err(PhotoError::Picture { path: path.into(), cause });
    }
    Ok(Radiance { mean, variance, validity: classes(&validity) })
}

fn classes(values: &Image<Rgb>) -> Image<Validity> {
    values.map(|v| match v.x as u8 {
        0 => Validity::Measured,
        1 => Validity::Single,
        2 => Validity::LowerBound,
        3 => Validity::UpperBound,
        4 => Validity::Moved,
        5 => Validity::Filled,
        _ => Validity::Analytic,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bracket::{Frame, MergeOptions, merge};
    use crate::photo::Photo;

    #[test]
    fn a_merged_bracket_survives_its_file_exactly() {
        let scene = Image::from_fn(40, 30, |x, y| Rgb::new(x as f32, y as f32, 0.5) / 50.0);
        let mut photo = Photo::from_linear(scene);
        photo.clipped[(7, 3)] = true;
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
        // A plain picture has no variance: said, not guessed.
        photo.linear[(0, 0)] = Rgb::ONE;
        let plain = folder.path().join("plain.hdr");
        crate::photo::radiance_hdr::write(&plain, &photo.linear, Default::default()).unwrap();
        assert!(read(&plain).is_err());
    }
}
