//! Lens models: pinhole with Brown–Conrady, rational or Kannala–Brandt distortion.
//!
//! With x = X/Z, y = Y/Z in OpenCV's axes and r² = x² + y²,
//! `x' = x·(1 + k1r² + k2r⁴ + k3r⁶)/(1 + k4r² + k5r⁴ + k6r⁶) + 2p1xy + p2(r² + 2x²)`, y' alike with
//! p1 and p2 exchanged; Kannala–Brandt (PAMI 28(8), 2006): `θ_d = θ(1 + k1θ² + k2θ⁴ + k3θ⁶ + k4θ⁸)`,
//! `(x', y') = θ_d (X, Y)/√(X² + Y²)`; then `u = fx x' + cx`, `v = fy y' + cy`.
//! A model is only believed out to the radius where it stops growing: beyond it two directions
//! would share a pixel, and both [`Lens::project`] and [`Lens::unproject`] answer `None`.

use glam::{DMat2, DVec2, DVec3};

use crate::conventions::{FULL_FRAME_DIAGONAL_MM, OPENCV_FROM_CAMERA};

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

/// A pixel and how it moves with the point and with each lens parameter.
#[derive(Clone, Debug)]
pub struct Projection {
    pub pixel: DVec2,
    /// ∂u/∂point and ∂v/∂point, px per unit of the point, camera axes.
    pub by_point: [DVec3; 2],
    /// ∂(u, v) by each parameter, in the order of [`Lens::parameters`].
    pub by_parameter: Vec<DVec2>,
}

/// Steps at which models without a closed-form test are checked to grow.
const GROWTH_STEPS: usize = 32;

/// Halvings of a step before the search ends: a step as long as its place is below f64 after 57.
const MAX_HALVINGS: usize = 100;

/// How far from the wanted pixel an unprojected ray may land, px.
const UNPROJECT_TOLERANCE_PX: f64 = 1e-9;

impl Distortion {
    /// The coefficients, in OpenCV's order.
    pub fn coefficients(&self) -> Vec<f64> {
        match *self {
            Self::None => vec![],
            Self::BrownConrady { k1, k2, p1, p2, k3 } => vec![k1, k2, p1, p2, k3],
            Self::Rational { k1, k2, p1, p2, k3, k4, k5, k6 } => {
                vec![k1, k2, p1, p2, k3, k4, k5, k6]
            }
            Self::KannalaBrandt { k1, k2, k3, k4 } => vec![k1, k2, k3, k4],
        }
    }

    /// What the coefficients are called, in the same order.
    pub fn names(&self) -> &'static [&'static str] {
        match self {
            Self::None => &[],
            Self::BrownConrady { .. } => &["k1", "k2", "p1", "p2", "k3"],
            Self::Rational { .. } => &["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"],
            Self::KannalaBrandt { .. } => &["k1", "k2", "k3", "k4"],
        }
    }

    /// The same model with other coefficients; `None` if their number is wrong.
    pub fn with_coefficients(&self, c: &[f64]) -> Option<Self> {
        Some(match (self, c) {
            (Self::None, []) => Self::None,
            (Self::BrownConrady { .. }, &[k1, k2, p1, p2, k3]) => {
                Self::BrownConrady { k1, k2, p1, p2, k3 }
            }
            (Self::Rational { .. }, &[k1, k2, p1, p2, k3, k4, k5, k6]) => {
                Self::Rational { k1, k2, p1, p2, k3, k4, k5, k6 }
            }
            (Self::KannalaBrandt { .. }, &[k1, k2, k3, k4]) => {
                Self::KannalaBrandt { k1, k2, k3, k4 }
            }
            _ => return None,
        })
    }

    /// The Brown–Conrady family as the eight rational coefficients; `None` for Kannala–Brandt.
    fn rational(&self) -> Option<[f64; 8]> {
        Some(match *self {
            Self::None => [0.0; 8],
            Self::BrownConrady { k1, k2, p1, p2, k3 } => [k1, k2, p1, p2, k3, 0.0, 0.0, 0.0],
            Self::Rational { k1, k2, p1, p2, k3, k4, k5, k6 } => [k1, k2, p1, p2, k3, k4, k5, k6],
            Self::KannalaBrandt { .. } => return None,
        })
    }

    /// Whether the distorted radius grows all the way from the axis to `radius`.
    ///
    /// `radius` is r = tan θ for the Brown–Conrady family and θ (rad) for Kannala–Brandt.
    pub fn grows_to(&self, radius: f64) -> bool {
        if !radius.is_finite() {
            return false;
        }
        match *self {
            Self::None => true,
            Self::BrownConrady { k1, k2, k3, .. } => {
                // d r_d/dr = 1 + 3k1 s + 5k2 s² + 7k3 s³ with s = r²: look at its ends and turning points.
                let slope = |s: f64| 1.0 + s * (3.0 * k1 + s * (5.0 * k2 + s * 7.0 * k3));
                let end = radius * radius;
                let turns = quadratic_roots(21.0 * k3, 10.0 * k2, 3.0 * k1);
                slope(end) > 0.0
                    && turns
                        .iter()
                        .all(|&s| s <= 0.0 || s >= end || !s.is_finite() || slope(s) > 0.0)
            }
            Self::Rational { k1, k2, k3, k4, k5, k6, .. } => (1..=GROWTH_STEPS).all(|i| {
                let s = (radius * i as f64 / GROWTH_STEPS as f64).powi(2);
                let top = 1.0 + s * (k1 + s * (k2 + s * k3));
                let under = 1.0 + s * (k4 + s * (k5 + s * k6));
                let top_slope = k1 + s * (2.0 * k2 + s * 3.0 * k3);
                let under_slope = k4 + s * (2.0 * k5 + s * 3.0 * k6);
                under > 0.0
                    && (top + 2.0 * s * top_slope) * under - 2.0 * s * top * under_slope > 0.0
            }),
            Self::KannalaBrandt { k1, k2, k3, k4 } => (1..=GROWTH_STEPS).all(|i| {
                let s = (radius * i as f64 / GROWTH_STEPS as f64).powi(2);
                kannala_brandt_slope([k1, k2, k3, k4], s) > 0.0
            }),
        }
    }
}

/// dθ_d/dθ at s = θ².
fn kannala_brandt_slope(k: [f64; 4], s: f64) -> f64 {
    1.0 + s * (3.0 * k[0] + s * (5.0 * k[1] + s * (7.0 * k[2] + s * 9.0 * k[3])))
}

/// θ_d/θ at s = θ².
fn kannala_brandt_ratio(k: [f64; 4], s: f64) -> f64 {
    1.0 + s * (k[0] + s * (k[1] + s * (k[2] + s * k[3])))
}

/// Real roots of a x² + b x + c; NaN where there is none.
fn quadratic_roots(a: f64, b: f64, c: f64) -> [f64; 2] {
    let root = (b * b - 4.0 * a * c).sqrt();
    // The form that does not cancel; a = 0 leaves the one finite root c/q.
    let q = -0.5 * (b + root.copysign(b));
    [q / a, c / q]
}

/// Distorted point and its derivative by (x, y), Brown–Conrady family.
fn distort(k: &[f64; 8], p: DVec2) -> (DVec2, DMat2) {
    let [k1, k2, p1, p2, k3, k4, k5, k6] = *k;
    let DVec2 { x, y } = p;
    let s = p.length_squared();
    let top = 1.0 + s * (k1 + s * (k2 + s * k3));
    let under = 1.0 + s * (k4 + s * (k5 + s * k6));
    let ratio = top / under;
    let top_slope = k1 + s * (2.0 * k2 + s * 3.0 * k3);
    let under_slope = k4 + s * (2.0 * k5 + s * 3.0 * k6);
    let ratio_slope = (top_slope - ratio * under_slope) / under;
    let out = DVec2::new(
        x * ratio + 2.0 * p1 * x * y + p2 * (s + 2.0 * x * x),
        y * ratio + p1 * (s + 2.0 * y * y) + 2.0 * p2 * x * y,
    );
    let cross = 2.0 * x * y * ratio_slope + 2.0 * p1 * x + 2.0 * p2 * y;
    let by_x = DVec2::new(ratio + 2.0 * x * x * ratio_slope + 2.0 * p1 * y + 6.0 * p2 * x, cross);
    let by_y = DVec2::new(cross, ratio + 2.0 * y * y * ratio_slope + 6.0 * p1 * y + 2.0 * p2 * x);
    (out, DMat2::from_cols(by_x, by_y))
}

impl Lens {
    /// A lens without distortion, square pixels and a centred principal point.
    pub fn pinhole(focal_px: f64, width: usize, height: usize) -> Self {
        Self {
            fx: focal_px,
            fy: focal_px,
            cx: (width as f64 - 1.0) / 2.0,
            cy: (height as f64 - 1.0) / 2.0,
            distortion: Distortion::None,
            covariance: None,
        }
    }

    /// fx, fy, cx, cy and the distortion coefficients: the order of the covariance.
    pub fn parameters(&self) -> Vec<f64> {
        let mut all = vec![self.fx, self.fy, self.cx, self.cy];
        all.extend(self.distortion.coefficients());
        all
    }

    /// Number of [`parameters`](Self::parameters).
    pub fn n_parameters(&self) -> usize {
        4 + self.distortion.coefficients().len()
    }

    /// Standard deviation of each parameter, if the lens was measured.
    pub fn sigmas(&self) -> Option<Vec<f64>> {
        let n = self.n_parameters();
        let covariance = self.covariance.as_ref().filter(|c| c.len() == n * n)?;
        Some((0..n).map(|i| covariance[i * n + i].max(0.0).sqrt()).collect())
    }

    /// Pixel at which a point or direction in camera axes (−Z forward, +Y up) is seen.
    ///
    /// `None` behind the camera (Brown–Conrady family), at the camera itself, and outside the
    /// field in which the model grows.
    pub fn project(&self, point: DVec3) -> Option<DVec2> {
        let p = OPENCV_FROM_CAMERA * point;
        let flat = match self.distortion {
            Distortion::KannalaBrandt { k1, k2, k3, k4 } => {
                let radius = p.x.hypot(p.y);
                let theta = radius.atan2(p.z);
                if !(radius > 0.0 || p.z > 0.0) || !self.distortion.grows_to(theta) {
                    return None;
                }
                let ratio = kannala_brandt_ratio([k1, k2, k3, k4], theta * theta);
                // On the axis θ/R tends to 1/Z.
                let per_radius = if radius > 1e-12 * p.z { theta / radius } else { 1.0 / p.z };
                DVec2::new(p.x, p.y) * (ratio * per_radius)
            }
            _ => {
                if p.z <= 0.0 {
                    return None;
                }
                let p = DVec2::new(p.x, p.y) / p.z;
                if !self.distortion.grows_to(p.length()) {
                    return None;
                }
                distort(&self.distortion.rational()?, p).0
            }
        };
        let pixel = DVec2::new(self.fx * flat.x + self.cx, self.fy * flat.y + self.cy);
        pixel.is_finite().then_some(pixel)
    }

    /// Direction (unit, camera axes) that is seen at `pixel`, to 1e-9 px.
    ///
    /// `None` where no direction inside the model's growing field lands on the pixel.
    pub fn unproject(&self, pixel: DVec2) -> Option<DVec3> {
        let flat = DVec2::new((pixel.x - self.cx) / self.fx, (pixel.y - self.cy) / self.fy);
        if !flat.is_finite() {
            return None;
        }
        let seen = match self.distortion {
            Distortion::None => flat.extend(1.0),
            Distortion::KannalaBrandt { k1, k2, k3, k4 } => {
                let theta = self.undistort_angle([k1, k2, k3, k4], flat.length())?;
                let sideways = flat.normalize_or_zero() * theta.sin();
                sideways.extend(theta.cos())
            }
            _ => self.undistort_flat(flat)?.extend(1.0),
        };
        Some((OPENCV_FROM_CAMERA * seen).normalize())
    }

    /// θ for a distorted angle: Newton, kept inside a bracket by bisection.
    fn undistort_angle(&self, k: [f64; 4], distorted: f64) -> Option<f64> {
        let residual = |theta: f64| theta * kannala_brandt_ratio(k, theta * theta) - distorted;
        let (mut low, mut high) = (0.0, std::f64::consts::PI);
        let mut theta = distorted.min(high);
        let tolerance = UNPROJECT_TOLERANCE_PX * 0.1 / self.fx.max(self.fy);
        for _ in 0..60 {
            let error = residual(theta);
            if error.abs() < tolerance {
                break;
            }
            // A falling model (θ beyond its maximum) counts as too far out.
            let slope = kannala_brandt_slope(k, theta * theta);
            if error > 0.0 || slope <= 0.0 {
                high = theta
            } else {
                low = theta
            }
            let next = theta - error / slope;
            theta = if next > low && next < high { next } else { 0.5 * (low + high) };
        }
        (residual(theta).abs() < tolerance * 10.0 && self.distortion.grows_to(theta))
            .then_some(theta)
    }

    /// (x, y) on the plane z = 1 for a distorted point: Newton with step halving.
    fn undistort_flat(&self, wanted: DVec2) -> Option<DVec2> {
        let k = self.distortion.rational()?;
        let scale = self.fx.max(self.fy);
        let mut p = wanted;
        let (at, mut slope) = distort(&k, p);
        let mut error = at - wanted;
        for _ in 0..40 {
            if error.length() * scale < 0.1 * UNPROJECT_TOLERANCE_PX {
                break;
            }
            // A determinant of zero, or one so small that its reciprocal is infinite, leads nowhere.
            let full_step = slope.inverse() * error;
            if !full_step.is_finite() {
                return None;
            }
            let downhill = (0..MAX_HALVINGS)
                .map(|halvings| full_step * 0.5f64.powi(halvings as i32))
                .take_while(|step| step.length() >= 1e-17 * (1.0 + p.length()))
                .map(|step| (p - step, distort(&k, p - step)))
                .find(|(_, (at, _))| (at - wanted).length() < error.length());
            // No further down: either already there or outside the field.
            let Some((next, (at, next_slope))) = downhill else { break };
            (p, error, slope) = (next, at - wanted, next_slope);
        }
        let there = error.length() * scale < UNPROJECT_TOLERANCE_PX;
        (there && self.distortion.grows_to(p.length())).then_some(p)
    }

    /// [`project`](Self::project) with its derivatives.
    pub fn project_with_derivatives(&self, point: DVec3) -> Option<Projection> {
        let pixel = self.project(point)?;
        let p = OPENCV_FROM_CAMERA * point;
        let focal = DVec2::new(self.fx, self.fy);
        let (flat, by_x, by_y, by_z, coefficients) = match self.distortion {
            Distortion::KannalaBrandt { k1, k2, k3, k4 } => {
                kannala_brandt_derivatives([k1, k2, k3, k4], p)
            }
            _ => brown_derivatives(&self.distortion, p)?,
        };
        let mut by_parameter =
            vec![DVec2::new(flat.x, 0.0), DVec2::new(0.0, flat.y), DVec2::X, DVec2::Y];
        by_parameter.extend(coefficients.iter().map(|&c| focal * c));
        // Point derivatives were taken in OpenCV's axes.
        let turn = |d: DVec3| OPENCV_FROM_CAMERA * d;
        let by_point = [
            turn(DVec3::new(by_x.x, by_y.x, by_z.x) * self.fx),
            turn(DVec3::new(by_x.y, by_y.y, by_z.y) * self.fy),
        ];
        Some(Projection { pixel, by_point, by_parameter })
    }

    /// Whether every pixel of a `width` × `height` picture has one direction.
    pub fn covers(&self, width: usize, height: usize) -> bool {
        let (right, bottom) = (width as f64 - 0.5, height as f64 - 0.5);
        let steps = 16;
        (0..=steps).all(|i| {
            let t = i as f64 / steps as f64;
            let (x, y) = (-0.5 + t * (right + 0.5), -0.5 + t * (bottom + 0.5));
            [(x, -0.5), (x, bottom), (-0.5, y), (right, y)]
                .iter()
                .all(|&(x, y)| self.unproject(DVec2::new(x, y)).is_some())
        })
    }

    /// The lens of a cut-out: `scale` × the frame, whose pixel (`x`, `y`) is the cut-out's (0, 0).
    ///
    /// Pixel areas scale, so `c' = (c + ½)·scale − ½ − (x, y)`; distortion acts before pixels and stays.
    pub fn cropped(&self, x: f64, y: f64, scale: f64) -> Self {
        let n = self.n_parameters();
        let covariance = self.covariance.as_ref().filter(|c| c.len() == n * n).map(|covariance| {
            let factor = |i: usize| if i < 4 { scale } else { 1.0 };
            (0..n * n).map(|k| covariance[k] * factor(k / n) * factor(k % n)).collect()
        });
        Self {
            fx: self.fx * scale,
            fy: self.fy * scale,
            cx: (self.cx + 0.5) * scale - 0.5 - x,
            cy: (self.cy + 0.5) * scale - 0.5 - y,
            distortion: self.distortion,
            covariance,
        }
    }
}

/// Distorted point, its derivatives by X, Y, Z, and by each coefficient.
type FlatDerivatives = (DVec2, DVec2, DVec2, DVec2, Vec<DVec2>);

fn brown_derivatives(model: &Distortion, p: DVec3) -> Option<FlatDerivatives> {
    let k = model.rational()?;
    let flat = DVec2::new(p.x, p.y) / p.z;
    let (out, slope) = distort(&k, flat);
    let (by_x, by_y) = (slope.x_axis / p.z, slope.y_axis / p.z);
    let by_z = -(slope * flat) / p.z;
    let s = flat.length_squared();
    let top = 1.0 + s * (k[0] + s * (k[1] + s * k[4]));
    let under = 1.0 + s * (k[5] + s * (k[6] + s * k[7]));
    let (x, y) = (flat.x, flat.y);
    let above = |power: i32| flat * (s.powi(power) / under);
    let below = |power: i32| flat * (-top * s.powi(power) / (under * under));
    let all = [
        above(1),
        above(2),
        DVec2::new(2.0 * x * y, s + 2.0 * y * y),
        DVec2::new(s + 2.0 * x * x, 2.0 * x * y),
        above(3),
        below(1),
        below(2),
        below(3),
    ];
    Some((out, by_x, by_y, by_z, all[..model.coefficients().len()].to_vec()))
}

fn kannala_brandt_derivatives(k: [f64; 4], p: DVec3) -> FlatDerivatives {
    let radius = p.x.hypot(p.y);
    if radius <= 1e-9 * p.z.abs() {
        // On the axis the model is the pinhole.
        let flat = DVec2::new(p.x, p.y) / p.z;
        return (flat, DVec2::X / p.z, DVec2::Y / p.z, -flat / p.z, vec![DVec2::ZERO; 4]);
    }
    let direction = DVec2::new(p.x, p.y) / radius;
    let theta = radius.atan2(p.z);
    let s = theta * theta;
    let distorted = theta * kannala_brandt_ratio(k, s);
    let slope = kannala_brandt_slope(k, s);
    let squared = radius * radius + p.z * p.z;
    // Radially θ_d moves by slope·dθ, across by θ_d/R.
    let (theta_by_radius, theta_by_z) = (p.z / squared, -radius / squared);
    let across = DVec2::new(-direction.y, direction.x);
    let by = |axis: DVec2| {
        direction * (slope * theta_by_radius * axis.dot(direction))
            + across * (distorted / radius * axis.dot(across))
    };
    let coefficients = (1..=4).map(|i| direction * theta * s.powi(i)).collect();
    let by_z = direction * (slope * theta_by_z);
    (direction * distorted, by(DVec2::X), by(DVec2::Y), by_z, coefficients)
}

/// Focal length in pixels of a lens of `focal_mm` on a sensor `sensor_width_mm` wide.
///
/// `width` is the picture's extent along the sensor's width (the longer side for a picture that
/// was turned upright). `None` unless all are positive and finite.
pub fn focal_px(focal_mm: f64, sensor_width_mm: f64, width: usize) -> Option<f64> {
    positive(focal_mm * width as f64 / sensor_width_mm)
        .filter(|_| focal_mm > 0.0 && sensor_width_mm > 0.0)
}

/// Focal length in pixels from the 35-mm equivalent, by the diagonal ([`FULL_FRAME_DIAGONAL_MM`]).
pub fn focal_px_from_35mm(focal_35mm: f64, width: usize, height: usize) -> Option<f64> {
    positive(focal_35mm * (width as f64).hypot(height as f64) / FULL_FRAME_DIAGONAL_MM)
}

fn positive(value: f64) -> Option<f64> {
    (value > 0.0 && value.is_finite()).then_some(value)
}
