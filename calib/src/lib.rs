//! Boards, tags, intrinsics and pose for Platelight: the only code that knows OpenCV.
//!
//! Plain arrays in, plain arrays out; no OpenCV type crosses this API. Pictures come as scene-linear
//! luma ([`Picture`]); pixels are OpenCV's (centre of the top-left pixel at (0, 0)); camera axes are
//! OpenCV's too (x right, y down, z forward). Start with [`board::find_checkerboard`],
//! [`tag::find_tags`] and [`calibrate::calibrate`].
//! Nothing here reads a file.

pub mod board;
mod bundle;
pub mod calibrate;
pub mod charuco;
mod choice;
mod edge;
mod edge_lines;
pub mod lens;
mod mat;
mod projection;
mod saddle;
pub mod stitch;
mod strip;
pub mod tag;
pub mod targets;

pub use lens::{Lens, Model};

/// A picture in scene-linear light: one channel, row-major, white near 1.
#[derive(Clone, Copy, Debug)]
pub struct Picture<'a> {
    width: usize,
    height: usize,
    luma: &'a [f32],
}

impl<'a> Picture<'a> {
    /// `None` if the number of samples is not `width × height`, a side is zero or above 32 767
    /// (OpenCV's limit for the functions used here), or a sample is not finite.
    pub fn new(width: usize, height: usize, luma: &'a [f32]) -> Option<Self> {
        let sides = (1..=32_767).contains(&width) && (1..=32_767).contains(&height);
        let whole = sides && width * height == luma.len() && luma.iter().all(|v| v.is_finite());
        whole.then_some(Self { width, height, luma })
    }

    pub fn width(&self) -> usize {
        self.width
    }

    pub fn height(&self) -> usize {
        self.height
    }

    /// Bilinear sample; clamps at the border.
    pub(crate) fn sample(&self, x: f64, y: f64) -> f64 {
        let x = x.clamp(0.0, (self.width - 1) as f64);
        let y = y.clamp(0.0, (self.height - 1) as f64);
        let (i, j) = (x.floor() as usize, y.floor() as usize);
        let (i1, j1) = ((i + 1).min(self.width - 1), (j + 1).min(self.height - 1));
        let (a, b) = (x - i as f64, y - j as f64);
        let at = |i: usize, j: usize| f64::from(self.luma[j * self.width + i]);
        (at(i, j) * (1.0 - a) + at(i1, j) * a) * (1.0 - b)
            + (at(i, j1) * (1.0 - a) + at(i1, j1) * a) * b
    }

    pub(crate) fn luma(&self) -> &'a [f32] {
        self.luma
    }
}

/// OpenCV itself failed; its message names a place in its own source.
#[derive(Debug, thiserror::Error)]
#[error("OpenCV: {0}")]
pub struct OpenCvError(#[from] opencv::Error);
