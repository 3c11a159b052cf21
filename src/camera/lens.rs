//! Lens models: pinhole with Brown–Conrady, rational or Kannala–Brandt distortion.

/// A lens: focal lengths and principal point in pixels, and its distortion (OpenCV's formulas).
#[derive(Clone, Debug, PartialEq)]
pub struct Lens {
    /// Focal length along x and y, px.
    pub fx: f64,
    pub fy: f64,
    /// Principal point, px (centre of the top-left pixel is (0, 0)).
    pub cx: f64,
    pub cy: f64,
    pub distortion: Distortion,
    /// Covariance of (fx, fy, cx, cy, distortion coefficients in order), row-major, if measured.
    pub covariance: Option<Vec<f64>>,
}

/// Lens distortion, with OpenCV's coefficient names and formulas.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Distortion {
    None,
    BrownConrady { k1: f64, k2: f64, p1: f64, p2: f64, k3: f64 },
    Rational { k1: f64, k2: f64, p1: f64, p2: f64, k3: f64, k4: f64, k5: f64, k6: f64 },
    KannalaBrandt { k1: f64, k2: f64, k3: f64, k4: f64 },
}
