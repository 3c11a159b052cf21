//! Log luminance of a view, coarse to fine, and two of them laid on each other.

use std::f64::consts::PI;

use glam::{DMat3, DQuat, DVec2, DVec3};
use nalgebra::{Matrix3, Matrix6, Vector6};

use crate::conventions::{lat_long_direction, lat_long_pixel, lat_long_solid_angle, luminance};
use crate::photo::Image;
use crate::probe::view::View;

/// Light below this share of the median is noise more than picture.
const FLOOR: f64 = 0.02;
/// Lamps count as this many times the median (e³): what is clipped in one view is not in the other.
const CEILING: f64 = 20.0;
/// Residuals beyond this many robust scales count little: things near by, people, clouds.
const ROBUST: f64 = 2.5;

/// Log luminance on a lat-long grid, in the picture's own axes.
pub(super) struct Level {
    pub width: usize,
    pub height: usize,
    value: Vec<f64>,
    /// Solid angle seen, sr.
    weight: Vec<f64>,
    /// Along the sphere, per radian; zero beside what is not seen.
    gradient: Vec<DVec3>,
    directions: Vec<DVec3>,
}

impl Level {
    /// `usable` marks the texels that count. `width` divides by two and is at most the panorama's.
    pub fn new(view: &View, usable: &Image<bool>, width: usize) -> Self {
        let panorama = &view.panorama;
        let height = width / 2;
        let (mut sum, mut weight) = (vec![0.0; width * height], vec![0.0; width * height]);
        for y in 0..panorama.height() {
            let omega = panorama.solid_angle(y);
            let row = y * height / panorama.height() * width;
            for x in 0..panorama.width() {
                if usable[(x, y)] {
                    let cell = row + x * width / panorama.width();
                    sum[cell] += f64::from(luminance(panorama.radiance[(x, y)])).max(0.0) * omega;
                    weight[cell] += omega;
                }
            }
        }
        // Cells that are seen in part only show something else than the whole cell would.
        for (cell, weight) in weight.iter_mut().enumerate() {
            if *weight < 0.6 * lat_long_solid_angle(cell / width, width, height) {
                *weight = 0.0;
            }
        }
        let mean = |cell: usize| sum[cell] / weight[cell];
        let seen = |cell: &usize| weight[*cell] > 0.0;
        let mut middle: Vec<(f64, f64)> =
            (0..sum.len()).filter(seen).map(|cell| (mean(cell), weight[cell])).collect();
        let median = weighted_median(&mut middle).max(1e-30);
        let value = (0..sum.len())
            .map(|cell| match seen(&cell) {
                true => (mean(cell).min(CEILING * median) + FLOOR * median).ln(),
                false => 0.0,
            })
            .collect();
        Self::from_values(width, value, weight)
    }

    fn from_values(width: usize, value: Vec<f64>, weight: Vec<f64>) -> Self {
        let n = value.len();
        let height = width / 2;
        let direction = |cell: usize| {
            lat_long_direction(
                DVec2::new((cell % width) as f64, (cell / width) as f64),
                width,
                height,
            )
        };
        let directions = (0..n).map(direction).collect();
        let gradient = vec![DVec3::ZERO; n];
        let mut level = Self { width, height, value, weight, gradient, directions };
        let step = 2.0 * PI / width as f64;
        for cell in (0..n).filter(|&cell| level.weight[cell] > 0.0) {
            let d = level.directions[cell];
            let (east, north) = d.any_orthonormal_pair();
            let slope = |t: DVec3| {
                let ahead = level.value_at((d + step * t).normalize())?;
                Some(t * (ahead - level.value_at((d - step * t).normalize())?) / (2.0 * step))
            };
            match slope(east).zip(slope(north)) {
                Some((a, b)) => level.gradient[cell] = a + b,
                None => continue,
            }
        }
        level
    }

    /// Blurred by a Gaussian of `sigma_rad` over what is seen.
    pub fn blurred(&self, sigma_rad: f64) -> Self {
        let far = (3.0 * sigma_rad).cos();
        let value = self
            .directions
            .iter()
            .map(|d| {
                let (mut sum, mut total) = (0.0, 1e-30);
                for (cell, other) in self.directions.iter().enumerate() {
                    let cosine = d.dot(*other);
                    if cosine > far && self.weight[cell] > 0.0 {
                        // 1 − cos θ = θ²/2 and a little.
                        let w =
                            ((cosine - 1.0) / (sigma_rad * sigma_rad)).exp() * self.weight[cell];
                        sum += w * self.value[cell];
                        total += w;
                    }
                }
                sum / total
            })
            .collect();
        Self::from_values(self.width, value, self.weight.clone())
    }

    /// As in a mirror: left and right (±X) exchanged.
    pub fn mirrored(&self) -> Self {
        let flip =
            |cell: usize| cell / self.width * self.width + self.width - 1 - cell % self.width;
        let value = (0..self.value.len()).map(|c| self.value[flip(c)]).collect();
        let weight = (0..self.value.len()).map(|c| self.weight[flip(c)]).collect();
        Self::from_values(self.width, value, weight)
    }

    /// The cells that were seen, with their directions.
    fn seen(&self) -> impl Iterator<Item = (usize, DVec3)> {
        let cells = self.directions.iter().copied().enumerate();
        cells.filter(|(cell, _)| self.weight[*cell] > 0.0)
    }

    /// The four cells round a direction with their bilinear weights; `None` where one is not seen.
    fn around(&self, d: DVec3) -> Option<[(usize, f64); 4]> {
        let (w, h) = (self.width as i64, self.height as i64);
        let p = lat_long_pixel(d, self.width, self.height);
        let corner = p.floor();
        let f = p - corner;
        let (x, y) = (corner.x as i64, corner.y as i64);
        let cell = |x: i64, y: i64| {
            let (x, y) = match y {
                y if y < 0 => (x + w / 2, 0),
                y if y >= h => (x + w / 2, h - 1),
                y => (x, y),
            };
            let cell = (y * w + x.rem_euclid(w)) as usize;
            (self.weight[cell] > 0.0).then_some(cell)
        };
        Some([
            (cell(x, y)?, (1.0 - f.x) * (1.0 - f.y)),
            (cell(x + 1, y)?, f.x * (1.0 - f.y)),
            (cell(x, y + 1)?, (1.0 - f.x) * f.y),
            (cell(x + 1, y + 1)?, f.x * f.y),
        ])
    }

    /// Log luminance in a direction of the picture's axes, where it is seen.
    pub fn value_at(&self, d: DVec3) -> Option<f64> {
        Some(self.around(d)?.iter().map(|&(cell, w)| w * self.value[cell]).sum())
    }

    fn value_and_gradient(&self, d: DVec3) -> Option<(f64, DVec3)> {
        let around = self.around(d)?;
        let value = around.iter().map(|&(cell, w)| w * self.value[cell]).sum();
        Some((value, around.iter().map(|&(cell, w)| w * self.gradient[cell]).sum()))
    }
}

/// Where the second view stands: turned, and moved aside.
#[derive(Clone, Copy, Debug)]
pub(super) struct Placed {
    /// Takes the second's axes to the first's.
    pub rotation: DQuat,
    /// From the first's place to the second's, in the first's axes, over the distance of what is seen: near
    /// things are not all at one distance, but this takes out what they have in common.
    pub shift: DVec3,
}

/// Two levels laid on each other.
#[derive(Clone, Copy, Debug)]
pub(super) struct Aligned {
    pub placed: Placed,
    /// Of the small rotation left over, rad²; from the scatter over patches of the sphere.
    pub covariance: DMat3,
    pub agreement: Agreement,
}

/// How alike two pictures are where both see.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Agreement {
    /// Pearson's correlation of log luminance.
    pub correlation: f64,
    /// Seen by both, sr.
    pub overlap_sr: f64,
}

/// Solid angle over which log luminance is one sample and not several, sr: patches of 14°.
const PATCH_SR: f64 = 0.06;

impl Agreement {
    pub fn of(sums: &Sums) -> Self {
        Self { correlation: sums.correlation(), overlap_sr: sums.weight }
    }

    /// Share of the light's variation that the one does not explain of the other.
    pub fn unexplained(&self) -> f64 {
        1.0 - self.correlation * self.correlation
    }

    /// Log likelihood gained over two unrelated pictures: `−n/2 ln(1 − r²)`, n patches of the sphere.
    ///
    /// Tells a wide fair fit from a narrow good one.
    pub fn evidence(&self) -> f64 {
        let r = self.correlation.clamp(0.0, 0.999_999);
        -0.5 * self.overlap_sr / PATCH_SR * (1.0 - r * r).ln()
    }
}

/// Weighted sums of two quantities.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Sums {
    pub weight: f64,
    pub a: f64,
    pub b: f64,
    pub aa: f64,
    pub bb: f64,
    pub ab: f64,
}

impl Sums {
    pub fn add(&mut self, weight: f64, a: f64, b: f64) {
        self.weight += weight;
        self.a += weight * a;
        self.b += weight * b;
        self.aa += weight * a * a;
        self.bb += weight * b * b;
        self.ab += weight * a * b;
    }

    fn correlation(&self) -> f64 {
        if self.weight <= 0.0 {
            return 0.0;
        }
        let (a, b) = (self.a / self.weight, self.b / self.weight);
        let (aa, bb) = (self.aa / self.weight - a * a, self.bb / self.weight - b * b);
        let scatter = (aa * bb).sqrt();
        if scatter > 1e-12 { (self.ab / self.weight - a * b) / scatter } else { 0.0 }
    }
}

struct Residual {
    /// sr
    weight: f64,
    error: f64,
    /// Change of the error per radian about each axis, and per unit of shift along each.
    rate: Vector6<f64>,
    patch: usize,
}

/// Standard deviation of the shifts expected where any is fitted, as a share of the distance; the pictures
/// can ask for more.
pub(super) const ANY_SHIFT: f64 = 0.1;
/// Where none is fitted.
pub(super) const NO_SHIFT: f64 = 1e-5;
const LARGEST_SHIFT: f64 = 0.5;

/// Turns and shifts `b` until it lies best on `a`: Gauss–Newton, robust against what does not fit.
///
/// `shift_sigma`: [`ANY_SHIFT`] or [`NO_SHIFT`].
/// `None` where they have nothing in common or no structure to hold on to.
pub(super) fn align(a: &Level, b: &Level, start: Placed, shift_sigma: f64) -> Option<Aligned> {
    let texel = 2.0 * PI / a.width as f64;
    let mut placed = start;
    let mut covariance = DMat3::ZERO;
    for _ in 0..15 {
        let residuals = residuals(a, b, placed);
        let (weights, scale) = robust_weights(&residuals)?;
        // Worth as much as one patch that is off by the robust scale at the expected shift.
        let prior = scale * scale * PATCH_SR / (shift_sigma * shift_sigma);
        let equations = Equations::new(&residuals, &weights, prior, placed.shift)?;
        let step = equations.inverse * equations.side;
        // A step beyond a few texels leaves what the slopes know about.
        let limit = |v: [f64; 3]| DVec3::from(v).clamp_length_max(4.0 * texel);
        let (turn, shift) =
            (limit([step[0], step[1], step[2]]), limit([step[3], step[4], step[5]]));
        placed.rotation = (DQuat::from_scaled_axis(turn) * placed.rotation).normalize();
        placed.shift = (placed.shift + shift).clamp_length_max(LARGEST_SHIFT);
        covariance = equations.patch_covariance(&residuals, &weights);
        if turn.length().max(shift.length()) < 0.01 * texel {
            break;
        }
    }
    let mut sums = Sums::default();
    for (cell, d) in a.seen() {
        if let Some(value) = b.value_at(placed.rotation.conjugate() * (d - placed.shift)) {
            sums.add(a.weight[cell], a.value[cell], value);
        }
    }
    Some(Aligned { placed, covariance, agreement: Agreement::of(&sums) })
}

fn residuals(a: &Level, b: &Level, placed: Placed) -> Vec<Residual> {
    let there = DMat3::from_quat(placed.rotation);
    let back = there.transpose();
    a.seen()
        .filter_map(|(cell, d)| {
            let (value, gradient) = b.value_and_gradient(back * (d - placed.shift))?;
            // Both slopes: converges from farther than either.
            let slope = 0.5 * (a.gradient[cell] + there * gradient);
            let turn = d.cross(slope);
            Some(Residual {
                weight: a.weight[cell],
                error: a.value[cell] - value,
                rate: Vector6::new(turn.x, turn.y, turn.z, slope.x, slope.y, slope.z),
                patch: patch(d),
            })
        })
        .collect()
}

/// Patches of the sphere, 3 × 3 on each face of a cube.
const PATCHES: usize = 54;

fn patch(d: DVec3) -> usize {
    let size = d.abs();
    let axis = if size.x >= size.y && size.x >= size.z {
        0
    } else if size.y >= size.z {
        1
    } else {
        2
    };
    let face = 2 * axis + usize::from(d[axis] < 0.0);
    let third = |v: f64| (((v / size[axis] + 1.0) * 1.5) as usize).min(2);
    face * 9 + third(d[(axis + 1) % 3]) * 3 + third(d[(axis + 2) % 3])
}

/// Residuals that the robust scale is taken from: more would only take longer.
const SCALE_SAMPLES: usize = 4096;

/// Geman and McClure's weights about the median, times solid angle; and the robust scale.
fn robust_weights(residuals: &[Residual]) -> Option<(Vec<f64>, f64)> {
    if residuals.len() < 16 {
        return None;
    }
    let some = || residuals.iter().step_by(residuals.len() / SCALE_SAMPLES + 1);
    let mut errors: Vec<(f64, f64)> = some().map(|r| (r.error, r.weight)).collect();
    let middle = weighted_median(&mut errors);
    let mut off: Vec<(f64, f64)> = some().map(|r| ((r.error - middle).abs(), r.weight)).collect();
    let scale = (1.4826 * weighted_median(&mut off)).max(1e-3);
    let weight = |r: &Residual| {
        let u = (r.error - middle) / (ROBUST * scale);
        r.weight / (1.0 + u * u).powi(2)
    };
    Some((residuals.iter().map(weight).collect(), scale))
}

/// Normal equations of turn and shift, the exposures' offset taken out.
struct Equations {
    inverse: Matrix6<f64>,
    side: Vector6<f64>,
    mean_rate: Vector6<f64>,
    mean_error: f64,
}

impl Equations {
    /// `prior`: the information on each component of the shift, which is expected to be zero.
    fn new(residuals: &[Residual], weights: &[f64], prior: f64, shift: DVec3) -> Option<Self> {
        let total: f64 = weights.iter().sum();
        let (mut mean_rate, mut mean_error) = (Vector6::zeros(), 0.0);
        for (r, &w) in residuals.iter().zip(weights) {
            mean_rate += w / total * r.rate;
            mean_error += w / total * r.error;
        }
        let (mut hessian, mut side) = (Matrix6::zeros(), Vector6::zeros());
        for (r, &w) in residuals.iter().zip(weights) {
            let j = r.rate - mean_rate;
            hessian += w * j * j.transpose();
            side -= w * (r.error - mean_error) * j;
        }
        let turns: Matrix3<f64> = hessian.fixed_view::<3, 3>(0, 0).into();
        for k in 0..3 {
            hessian[(3 + k, 3 + k)] += prior;
            side[3 + k] -= prior * shift[k];
        }
        // Light that is the same all round an axis says nothing of the turn about it.
        let holds = turns.determinant() > 1e-6 * turns.trace().powi(3) && turns.trace() > 1e-9;
        let inverse = hessian.try_inverse().filter(|_| holds)?;
        Some(Self { inverse, side, mean_rate, mean_error })
    }

    /// `H⁻¹ (Σ u uᵀ) H⁻¹`, u summed over patches: neighbours err alike, by interpolation and by parallax.
    fn patch_covariance(&self, residuals: &[Residual], weights: &[f64]) -> DMat3 {
        let mut pulls = [Vector6::zeros(); PATCHES];
        for (r, &w) in residuals.iter().zip(weights) {
            pulls[r.patch] += w * (r.error - self.mean_error) * (r.rate - self.mean_rate);
        }
        let middle: Matrix6<f64> = pulls.iter().map(|u| u * u.transpose()).sum();
        let whole = self.inverse * middle * self.inverse;
        let turns: Matrix3<f64> = whole.fixed_view::<3, 3>(0, 0).into();
        let columns: [[f64; 3]; 3] = turns.into();
        DMat3::from_cols_array_2d(&columns)
    }
}

/// Value below which half of the weight lies; reorders, 0 of nothing.
fn weighted_median(values: &mut [(f64, f64)]) -> f64 {
    values.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let half = 0.5 * values.iter().map(|(_, w)| w).sum::<f64>();
    let mut sum = 0.0;
    for &(value, weight) in values.iter() {
        sum += weight;
        if sum >= half {
            return value;
        }
    }
    0.0
}
