//! Overlapping photographs from one place: how each camera was turned, and its focal length.
//!
//! OpenCV's stitching pipeline up to its bundle adjustment (ORB features, homographies, ray errors;
//! Brown & Lowe, IJCV 74(1), 2007), and no further: its warps and blends are in 8 bits and of no known
//! scale. Lenses are taken as pinholes, undistorted before if they are not. The cameras' horizon is
//! levelled by the common plane of their x axes, which is level if the camera was.

use opencv::core::{Mat, MatTraitConst, Ptr, Vector};
use opencv::imgproc;
use opencv::prelude::{Detail_CameraParamsTraitConst, StitcherTrait, StitcherTraitConst};
use opencv::stitching::{Stitcher, Stitcher_Mode, Stitcher_Status};

use crate::{OpenCvError, Picture, mat};

/// Size, megapixels, at which features are looked for: sharper than OpenCV's 0.6, still of seconds.
const REGISTRATION_MPX: f64 = 1.2;

/// How one photograph was taken.
#[derive(Clone, Debug, PartialEq)]
pub struct TurnedCamera {
    pub focal_px: f64,
    /// Principal point, px: the middle of the picture.
    pub principal_px: [f64; 2],
    /// Rows of the rotation that takes camera axes (x right, y down, z forward) to the panorama's, which are
    /// the same for a camera that looks level and ahead.
    pub panorama_from_camera: [[f64; 3]; 3],
}

/// Why photographs do not become one panorama.
#[derive(Debug, thiserror::Error)]
pub enum StitchError {
    #[error(
        "fewer than two photographs overlap: take them with a third of overlap, from one place"
    )]
    TooFew,
    #[error(
        "the overlapping photographs do not agree on one place of the camera; turn it about its lens, not beside it"
    )]
    NoAgreement,
    #[error(transparent)]
    OpenCv(#[from] OpenCvError),
}

impl From<opencv::Error> for StitchError {
    fn from(error: opencv::Error) -> Self {
        Self::OpenCv(error.into())
    }
}

/// The cameras of photographs that overlap, in their order; `None` for one that overlaps with no other.
///
/// # Errors
/// No two photographs overlap, they are not from one place, or OpenCV failed.
pub fn stitch(pictures: &[Picture]) -> Result<Vec<Option<TurnedCamera>>, StitchError> {
    mat::prepare();
    let mut images: Vector<Mat> = Vector::new();
    for picture in pictures {
        let mut colour = Mat::default();
        let grey = mat::eight_bit(picture)?;
        imgproc::cvt_color_def(&grey, &mut colour, imgproc::COLOR_GRAY2BGR)?;
        images.push(colour);
    }
    let mut stitcher: Ptr<Stitcher> = Stitcher::create(Stitcher_Mode::PANORAMA)?;
    stitcher.set_registration_resol(REGISTRATION_MPX)?;
    match stitcher.estimate_transform_def(&images)? {
        Stitcher_Status::OK => {}
        Stitcher_Status::ERR_NEED_MORE_IMGS => return Err(StitchError::TooFew),
        _ => return Err(StitchError::NoAgreement),
    }
    let scale = stitcher.work_scale()?;
    let mut found = vec![None; pictures.len()];
    for (index, camera) in stitcher.component()?.iter().zip(stitcher.cameras()?) {
        let Some(slot) = usize::try_from(index).ok().and_then(|index| found.get_mut(index)) else {
            continue;
        };
        let (rotation, focal) = (camera.r(), camera.focal());
        let mut rows = [[0.0; 3]; 3];
        for (y, row) in rows.iter_mut().enumerate() {
            for (x, value) in row.iter_mut().enumerate() {
                // The bundle adjustment leaves single precision.
                *value = f64::from(*rotation.at_2d::<f32>(y as i32, x as i32)?);
            }
        }
        let whole =
            rows.iter().flatten().all(|v| v.is_finite()) && focal.is_finite() && focal > 0.0;
        if !whole {
            return Err(StitchError::NoAgreement);
        }
        *slot = Some(TurnedCamera {
            focal_px: focal / scale,
            // Resized pictures keep their corners, not their first pixel's centre.
            principal_px: [camera.ppx(), camera.ppy()].map(|c| c / scale - 0.5),
            panorama_from_camera: rows,
        });
    }
    if found.iter().flatten().count() < 2 {
        return Err(StitchError::TooFew);
    }
    Ok(found)
}
