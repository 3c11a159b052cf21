//! A file's own samples → scene-linear Rec.709.

use rayon::prelude::*;

use super::{Encoded, Image, Photo};
use crate::conventions::Rgb;

impl From<Encoded> for Photo {
    /// Makes light of all pixels.
    fn from(file: Encoded) -> Self {
        let (width, height) = (file.width, file.height);
        let decoder = file.decoder();
        // Filled in place: rows collected first would hold every pixel twice.
        let mut linear = Image::filled(width, height, Rgb::ZERO);
        let mut clipped = Image::filled(width, height, false);
        linear
            .pixels_mut()
            .par_chunks_exact_mut(width)
            .zip(clipped.pixels_mut().par_chunks_exact_mut(width))
            .enumerate()
            .for_each(|(y, (linear, clipped))| {
                for x in 0..width {
                    linear[x] = decoder.light(y * width + x);
                    clipped[x] = decoder.clips(y * width + x).contains(&true);
                }
            });
        let alpha: Option<Vec<f32>> =
            (0..width * height).into_par_iter().map(|i| decoder.coverage(i)).collect();
        Self {
            linear,
            alpha: alpha.and_then(|alpha| Image::from_pixels(width, height, alpha)),
            clipped,
            path: file.path,
            format: file.format,
            nonfinite: file.nonfinite,
            data_window: file.data_window,
            remarks: file.remarks,
            facts: file.facts,
            encoding: file.encoding,
            samples: file.samples,
        }
    }
}
