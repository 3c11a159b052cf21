//! The lens models as the bundle adjustment sees them: one flat vector of parameters.
//!
//! OpenCV's formulas in OpenCV's axes; the same as `camera::Lens` of the main crate, which a test
//! there holds to 1e-9 px. It exists twice because this crate knows nothing of that one.

/// Most parameters any model has.
pub const MAX_PARAMETERS: usize = 12;

/// Which formula bends the rays.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Model {
    /// fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6: Brown–Conrady, rational when k4…k6 are used.
    Brown,
    /// fx fy cx cy k1 k2 k3 k4 (Kannala–Brandt 2006).
    KannalaBrandt,
}

impl Model {
    pub fn n_parameters(self) -> usize {
        match self {
            Self::Brown => 12,
            Self::KannalaBrandt => 8,
        }
    }
}

/// A lens: model and parameters (the first [`Model::n_parameters`] count, px and 1).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lens {
    pub model: Model,
    pub parameters: [f64; MAX_PARAMETERS],
}

/// A pixel with its derivatives by the point and by the parameters.
pub(crate) struct Projection {
    pub pixel: [f64; 2],
    pub by_point: [[f64; 3]; 2],
    pub by_parameter: [[f64; MAX_PARAMETERS]; 2],
}

/// Steps at which a model is checked to grow.
const GROWTH_STEPS: usize = 48;

impl Lens {
    /// A lens without distortion (or the equidistant fisheye) with square pixels.
    pub fn simple(model: Model, focal_px: f64, width: usize, height: usize) -> Self {
        let mut parameters = [0.0; MAX_PARAMETERS];
        parameters[..4].copy_from_slice(&[
            focal_px,
            focal_px,
            (width as f64 - 1.0) / 2.0,
            (height as f64 - 1.0) / 2.0,
        ]);
        Self { model, parameters }
    }

    /// Whether the distorted radius grows from the axis to `radius` (tan θ, or θ for Kannala–Brandt).
    pub(crate) fn grows_to(&self, radius: f64) -> bool {
        let k = &self.parameters[4..];
        radius.is_finite()
            && (0..=GROWTH_STEPS).all(|i| {
                let s = (radius * i as f64 / GROWTH_STEPS as f64).powi(2);
                match self.model {
                    Model::Brown => {
                        let (top, under) = rational(k, s);
                        let (top_slope, under_slope) = rational_slopes(k, s);
                        under > 0.0
                            && (top + 2.0 * s * top_slope) * under > 2.0 * s * top * under_slope
                    }
                    Model::KannalaBrandt => kannala_brandt_slope(k, s) > 0.0,
                }
            })
    }

    /// Pixel and derivatives of a point in OpenCV's camera axes.
    ///
    /// `None` behind the camera. The field is not checked here: while parameters are still moving a
    /// model may fold for a moment, and the fit must be able to walk back.
    pub(crate) fn project_with_derivatives(&self, p: [f64; 3]) -> Option<Projection> {
        let [fx, fy, cx, cy] = [0, 1, 2, 3].map(|i| self.parameters[i]);
        let flat = match self.model {
            Model::Brown => brown(&self.parameters[4..], p)?,
            Model::KannalaBrandt => kannala_brandt(&self.parameters[4..], p)?,
        };
        let pixel = [fx * flat.at[0] + cx, fy * flat.at[1] + cy];
        if !(pixel[0].is_finite() && pixel[1].is_finite()) {
            return None;
        }
        let mut by_parameter = [[0.0; MAX_PARAMETERS]; 2];
        (by_parameter[0][0], by_parameter[0][2]) = (flat.at[0], 1.0);
        (by_parameter[1][1], by_parameter[1][3]) = (flat.at[1], 1.0);
        for (i, by) in flat.by_coefficient.iter().enumerate().take(self.model.n_parameters() - 4) {
            by_parameter[0][4 + i] = fx * by[0];
            by_parameter[1][4 + i] = fy * by[1];
        }
        let by_point = [flat.by_point[0].map(|v| v * fx), flat.by_point[1].map(|v| v * fy)];
        Some(Projection { pixel, by_point, by_parameter })
    }

    /// Pixel of a point in OpenCV's camera axes; `None` where the lens does not see it.
    pub fn project(&self, p: [f64; 3]) -> Option<[f64; 2]> {
        let radius = match self.model {
            Model::Brown => p[0].hypot(p[1]) / p[2],
            Model::KannalaBrandt => p[0].hypot(p[1]).atan2(p[2]),
        };
        if !self.grows_to(radius) {
            return None;
        }
        Some(self.project_with_derivatives(p)?.pixel)
    }

    /// Direction (unit, OpenCV's camera axes) seen at a pixel; `None` outside the growing field.
    pub fn unproject(&self, pixel: [f64; 2]) -> Option<[f64; 3]> {
        let [fx, fy, cx, cy] = [0, 1, 2, 3].map(|i| self.parameters[i]);
        let wanted = [(pixel[0] - cx) / fx, (pixel[1] - cy) / fy];
        let radius = wanted[0].hypot(wanted[1]);
        if !radius.is_finite() {
            return None;
        }
        let k = &self.parameters[4..];
        match self.model {
            Model::KannalaBrandt => {
                let grows = |theta: f64| theta * kannala_brandt_ratio(k, theta * theta);
                let theta = bisect(grows, radius, std::f64::consts::PI)?;
                if !self.grows_to(theta) {
                    return None;
                }
                let side = if radius > 0.0 { theta.sin() / radius } else { 1.0 };
                Some([wanted[0] * side, wanted[1] * side, theta.cos()])
            }
            Model::Brown => {
                let mut at = wanted;
                for _ in 0..50 {
                    let flat = brown(k, [at[0], at[1], 1.0])?;
                    let off = [flat.at[0] - wanted[0], flat.at[1] - wanted[1]];
                    let [[a, b, _], [c, d, _]] = flat.by_point;
                    let determinant = a * d - b * c;
                    let step = [
                        (d * off[0] - b * off[1]) / determinant,
                        (a * off[1] - c * off[0]) / determinant,
                    ];
                    // Newton's first steps may overshoot a strong barrel.
                    let length = step[0].hypot(step[1]);
                    let short = (0.5 / length).min(1.0);
                    at = [at[0] - step[0] * short, at[1] - step[1] * short];
                    if length < 1e-14 {
                        break;
                    }
                }
                let off = brown(k, [at[0], at[1], 1.0])?.at;
                let off = (off[0] - wanted[0]).hypot(off[1] - wanted[1]);
                if !(off < 1e-11) || !self.grows_to(at[0].hypot(at[1])) {
                    return None;
                }
                let length = (at[0] * at[0] + at[1] * at[1] + 1.0).sqrt();
                Some([at[0] / length, at[1] / length, 1.0 / length])
            }
        }
    }

    /// Whether every pixel of the picture has one direction.
    pub fn covers(&self, width: usize, height: usize) -> bool {
        let (right, bottom) = (width as f64 - 0.5, height as f64 - 0.5);
        [[-0.5, -0.5], [right, -0.5], [-0.5, bottom], [right, bottom]]
            .iter()
            .all(|&corner| self.unproject(corner).is_some())
    }
}

/// Root of a growing function in [0, high] by bisection to the last bit.
fn bisect(f: impl Fn(f64) -> f64, wanted: f64, high: f64) -> Option<f64> {
    // The largest angle below which f still grows past `wanted`.
    let (mut low, mut high) = (0.0, high);
    if f(high) < wanted {
        // A folding polynomial may come down again: look for any point beyond the wanted value.
        high = (1..=GROWTH_STEPS)
            .map(|i| high * i as f64 / GROWTH_STEPS as f64)
            .find(|&t| f(t) >= wanted)?;
    }
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if f(middle) < wanted { low = middle } else { high = middle }
    }
    Some(0.5 * (low + high))
}

/// Distorted point on the plane z = 1 and its derivatives.
struct Flat {
    at: [f64; 2],
    by_point: [[f64; 3]; 2],
    by_coefficient: [[f64; 2]; 8],
}

/// Numerator and denominator of the radial factor at s = r².
fn rational(k: &[f64], s: f64) -> (f64, f64) {
    (1.0 + s * (k[0] + s * (k[1] + s * k[4])), 1.0 + s * (k[5] + s * (k[6] + s * k[7])))
}

/// Their derivatives by s.
fn rational_slopes(k: &[f64], s: f64) -> (f64, f64) {
    (k[0] + s * (2.0 * k[1] + s * 3.0 * k[4]), k[5] + s * (2.0 * k[6] + s * 3.0 * k[7]))
}

fn brown(k: &[f64], p: [f64; 3]) -> Option<Flat> {
    if !(p[2] > 0.0) {
        return None;
    }
    let (x, y) = (p[0] / p[2], p[1] / p[2]);
    let s = x * x + y * y;
    let (p1, p2) = (k[2], k[3]);
    let (top, under) = rational(k, s);
    let (top_slope, under_slope) = rational_slopes(k, s);
    let ratio = top / under;
    let slope = (top_slope - ratio * under_slope) / under;

    let at = [
        x * ratio + 2.0 * p1 * x * y + p2 * (s + 2.0 * x * x),
        y * ratio + p1 * (s + 2.0 * y * y) + 2.0 * p2 * x * y,
    ];
    let cross = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y;
    let xx = ratio + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x;
    let yy = ratio + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x;
    let z = p[2];
    let by_point = [
        [xx / z, cross / z, -(xx * x + cross * y) / z],
        [cross / z, yy / z, -(cross * x + yy * y) / z],
    ];
    let above = |factor: f64| [x * factor / under, y * factor / under];
    let below = |factor: f64| [-x * ratio * factor / under, -y * ratio * factor / under];
    let by_coefficient = [
        above(s),
        above(s * s),
        [2.0 * x * y, s + 2.0 * y * y],
        [s + 2.0 * x * x, 2.0 * x * y],
        above(s * s * s),
        below(s),
        below(s * s),
        below(s * s * s),
    ];
    Some(Flat { at, by_point, by_coefficient })
}

fn kannala_brandt_ratio(k: &[f64], s: f64) -> f64 {
    1.0 + s * (k[0] + s * (k[1] + s * (k[2] + s * k[3])))
}

fn kannala_brandt_slope(k: &[f64], s: f64) -> f64 {
    1.0 + s * (3.0 * k[0] + s * (5.0 * k[1] + s * (7.0 * k[2] + s * 9.0 * k[3])))
}

fn kannala_brandt(k: &[f64], p: [f64; 3]) -> Option<Flat> {
    let radius = p[0].hypot(p[1]);
    let mut by_coefficient = [[0.0; 2]; 8];
    if radius <= 1e-9 * p[2].abs() {
        // On the axis the model is the pinhole.
        let z = p[2];
        if !(z > 0.0) {
            return None;
        }
        let at = [p[0] / z, p[1] / z];
        let by_point = [[1.0 / z, 0.0, -at[0] / z], [0.0, 1.0 / z, -at[1] / z]];
        return Some(Flat { at, by_point, by_coefficient });
    }
    let (c, d) = (p[0] / radius, p[1] / radius);
    let theta = radius.atan2(p[2]);
    let s = theta * theta;
    let bent = theta * kannala_brandt_ratio(k, s);
    let slope = kannala_brandt_slope(k, s);
    let squared = radius * radius + p[2] * p[2];
    let (radial, across) = (slope * p[2] / squared, bent / radius);
    let by_z = -slope * radius / squared;
    let mixed = (radial - across) * c * d;
    let by_point = [
        [radial * c * c + across * d * d, mixed, by_z * c],
        [mixed, radial * d * d + across * c * c, by_z * d],
    ];
    for (i, by) in by_coefficient.iter_mut().take(4).enumerate() {
        let factor = theta * s.powi(i as i32 + 1);
        *by = [c * factor, d * factor];
    }
    Some(Flat { at: [bent * c, bent * d], by_point, by_coefficient })
}

/// OpenCV's own projection of a point in its camera axes: the outside standard of the tests.
///
/// `coefficients` as OpenCV orders them: 4, 5 or 8 for its main model, 4 for `cv::fisheye`.
pub fn project_by_opencv(lens: &Lens, point: [f64; 3]) -> Result<[f64; 2], crate::OpenCvError> {
    use opencv::core::{Mat, MatTraitConst, Point2d, Point3d, Vector};
    let [fx, fy, cx, cy] = [0, 1, 2, 3].map(|i| lens.parameters[i]);
    let k = [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]];
    let k = Mat::from_slice_2d(&k)?;
    let d = Mat::from_slice(&lens.parameters[4..lens.model.n_parameters()])?.try_clone()?;
    let object = Vector::<Point3d>::from_slice(&[Point3d::new(point[0], point[1], point[2])]);
    let mut seen = Vector::<Point2d>::new();
    let zero = Mat::from_slice(&[0.0f64; 3])?.try_clone()?;
    match lens.model {
        Model::Brown => {
            opencv::calib3d::project_points_def(&object, &zero, &zero, &k, &d, &mut seen)?
        }
        Model::KannalaBrandt => {
            opencv::calib3d::fisheye_project_points_vec_def(
                &object, &mut seen, &zero, &zero, &k, &d,
            )?;
        }
    }
    let p = seen.get(0)?;
    Ok([p.x, p.y])
}
