//! Plain arrays ↔ OpenCV matrices.

use std::sync::Once;

use opencv::core::{Mat, MatTraitConst, MatTraitConstManual, Point2f};

use crate::{OpenCvError, Picture};

/// One thread and one seed inside OpenCV: parallelism is the caller's, results repeat.
pub(crate) fn prepare() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        // Refusing only costs speed and repeatability of RANSAC, which is not used.
        let _ = opencv::core::set_num_threads(1);
        let _ = opencv::core::set_rng_seed(1);
    });
}

/// The picture in 8 bits through a square root: faint boards keep their steps.
///
/// The 99th percentile becomes white, so that an under-exposed board fills the range.
pub(crate) fn eight_bit(picture: &Picture) -> Result<Mat, OpenCvError> {
    let mut sorted: Vec<f32> =
        picture.luma().iter().step_by(1 + picture.luma().len() / 65_536).copied().collect();
    sorted.sort_by(f32::total_cmp);
    let white = sorted[(sorted.len() - 1) * 99 / 100].max(1e-6);
    let bytes: Vec<u8> = picture
        .luma()
        .iter()
        .map(|&v| ((v / white).clamp(0.0, 1.0).sqrt() * 255.0).round() as u8)
        .collect();
    let mat =
        Mat::new_rows_cols_with_data(picture.height() as i32, picture.width() as i32, &bytes)?;
    Ok(mat.try_clone()?)
}

/// The picture's own linear floats.
pub(crate) fn linear(picture: &Picture) -> Result<Mat, OpenCvError> {
    let mat = Mat::new_rows_cols_with_data(
        picture.height() as i32,
        picture.width() as i32,
        picture.luma(),
    )?;
    Ok(mat.try_clone()?)
}

pub(crate) fn doubles(p: &Point2f) -> [f64; 2] {
    [f64::from(p.x), f64::from(p.y)]
}

/// A 3-vector or matrix column of f64.
pub(crate) fn values(mat: &Mat) -> Result<Vec<f64>, OpenCvError> {
    let mut all = Vec::new();
    for row in 0..mat.rows() {
        all.extend_from_slice(mat.at_row::<f64>(row)?);
    }
    Ok(all)
}
