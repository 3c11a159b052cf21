//! Shift between two frames of a bracket, and whether undoing it helps.
//!
//! Phase correlation on the cube root of light (0.09 px rms on a two-stop pair, against 0.34 px on
//! raw codes; methods-capture C3), coarse on a reduced picture, then fine on a full-size window.
//! Translation only: a rotated or moving camera is reported, not mended.

use std::f64::consts::PI;

use glam::{DVec2, Vec3};
use rayon::prelude::*;

use crate::conventions::{Rgb, luminance};
use crate::photo::{Image, Photo};

/// Side of the squares that are correlated, px: a power of two for the transform.
const WINDOW: usize = 256;

/// How a frame lies on the reference frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Alignment {
    /// Content at p in the reference is at p + shift in the frame, px.
    pub shift: DVec2,
    /// What the reference does not explain of the frame, with the shift undone, over that without.
    pub residual_ratio: f64,
}

/// Measures how `frame` lies on `reference`; exposures make their light comparable.
pub(super) fn measure(reference: (&Photo, f64), frame: (&Photo, f64)) -> Option<Alignment> {
    let [a, b] = cube_roots(reference, frame);
    if a.width() < 16 || a.height() < 16 {
        return None;
    }
    // Coarse: the whole picture reduced to one window.
    let factor = a.width().max(a.height()).div_ceil(WINDOW);
    let whole = |image: &Image<f32>| window(image, (0, 0), factor);
    let coarse = correlate(whole(&a), whole(&b))? * factor as f64;
    let coarse = coarse.round();
    // Fine: the window in the middle, at full size, after the coarse shift.
    let corner = |side: usize| (side.saturating_sub(WINDOW) / 2) as i64;
    let at = (corner(a.width()), corner(a.height()));
    let moved = (at.0 + coarse.x as i64, at.1 + coarse.y as i64);
    let fine = correlate(window(&a, at, 1), window(&b, moved, 1))?;
    // The fine window may see nothing but a flat wall; then the coarse answer stands.
    let fine = if fine.length() <= 2.0 * factor as f64 { fine } else { DVec2::ZERO };
    let shift = coarse + fine;
    let before = residual(&a, &b, DVec2::ZERO)?;
    let after = residual(&a, &b, shift)?;
    Some(Alignment { shift, residual_ratio: after / before.max(1e-30) })
}

/// Cube roots of both frames' light on one scale, cut where either frame is near clipping.
fn cube_roots(reference: (&Photo, f64), frame: (&Photo, f64)) -> [Image<f32>; 2] {
    // 0.85 of white of the longer frame, in radiance.
    let top = (0.85 / reference.1.max(frame.1)) as f32;
    [reference, frame].map(|(photo, exposure)| {
        let scale = (1.0 / exposure) as f32;
        photo.linear.map(|&l| ((luminance(l) * scale).clamp(0.0, top) / top).cbrt())
    })
}

/// A [`WINDOW`]² cut-out from `corner`, box-reduced by `factor`; the edge is repeated outside.
fn window(image: &Image<f32>, corner: (i64, i64), factor: usize) -> Vec<f64> {
    let (w, h) = (image.width() as i64, image.height() as i64);
    let mut values = Vec::with_capacity(WINDOW * WINDOW);
    for j in 0..WINDOW {
        for i in 0..WINDOW {
            let mut sum = 0.0;
            for dy in 0..factor {
                for dx in 0..factor {
                    let x = (corner.0 + (i * factor + dx) as i64).clamp(0, w - 1) as usize;
                    let y = (corner.1 + (j * factor + dy) as i64).clamp(0, h - 1) as usize;
                    sum += f64::from(image[(x, y)]);
                }
            }
            values.push(sum / (factor * factor) as f64);
        }
    }
    values
}

/// Shift of `b` against `a` by phase correlation, px; `None` where one of them is flat.
fn correlate(a: Vec<f64>, b: Vec<f64>) -> Option<DVec2> {
    let spectrum = |values: Vec<f64>| -> Option<Vec<DVec2>> {
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>();
        if variance < 1e-9 * values.len() as f64 {
            return None;
        }
        let hann = |i: usize| 0.5 - 0.5 * (2.0 * PI * (i as f64 + 0.5) / WINDOW as f64).cos();
        let mut tapered: Vec<DVec2> = values
            .iter()
            .enumerate()
            .map(|(i, v)| DVec2::new((v - mean) * hann(i % WINDOW) * hann(i / WINDOW), 0.0))
            .collect();
        transform_2d(&mut tapered, false);
        Some(tapered)
    };
    let (a, b) = (spectrum(a)?, spectrum(b)?);
    let mut cross: Vec<DVec2> = a
        .iter()
        .zip(&b)
        .enumerate()
        .map(|(i, (a, b))| {
            // conj(a)·b, whitened; the highest frequencies hold noise only and are faded out.
            let product = DVec2::new(a.x * b.x + a.y * b.y, a.x * b.y - a.y * b.x);
            let frequency = |k: usize| k.min(WINDOW - k) as f64 / WINDOW as f64;
            let f2 = frequency(i % WINDOW).powi(2) + frequency(i / WINDOW).powi(2);
            product.normalize_or_zero() * (-f2 / (2.0 * 0.15 * 0.15)).exp()
        })
        .collect();
    transform_2d(&mut cross, true);
    let peak = (0..cross.len()).max_by(|&i, &j| cross[i].x.total_cmp(&cross[j].x))?;
    let (px, py) = (peak % WINDOW, peak / WINDOW);
    let at = |x: usize, y: usize| cross[(y % WINDOW) * WINDOW + x % WINDOW].x;
    // The faded peak is a Gaussian: a parabola through the logarithms is exact for it.
    let sub_pixel = |before: f64, centre: f64, after: f64| {
        if before <= 0.0 || after <= 0.0 {
            return 0.0;
        }
        let (l, c, r) = (before.ln(), centre.ln(), after.ln());
        let curvature = l - 2.0 * c + r;
        if curvature < 0.0 { (0.5 * (l - r) / curvature).clamp(-0.5, 0.5) } else { 0.0 }
    };
    let dx = sub_pixel(at(px + WINDOW - 1, py), at(px, py), at(px + 1, py));
    let dy = sub_pixel(at(px, py + WINDOW - 1), at(px, py), at(px, py + 1));
    let signed = |p: usize| if p > WINDOW / 2 { p as f64 - WINDOW as f64 } else { p as f64 };
    Some(DVec2::new(signed(px) + dx, signed(py) + dy))
}

/// How badly `b`, shifted back, is a function of `a`: the share of its variance that `a` does not
/// explain (correlation ratio; Roche et al. 1998), over the middle of the frame.
///
/// A plain difference would be ruled by an unknown tone curve; this one does not see it.
fn residual(a: &Image<f32>, b: &Image<f32>, shift: DVec2) -> Option<f64> {
    /// Bands of brightness in `a`; each with count, sum and sum of squares of `b`.
    const BANDS: usize = 64;
    type Sums = [[f64; 3]; BANDS];
    let margin = (shift.abs().max_element().ceil() as usize).max(2) + 2;
    let (w, h) = (a.width(), a.height());
    if w <= 2 * margin || h <= 2 * margin {
        return None;
    }
    // 0.1 … 0.97: neither black nor cut; judged on the reference so that both shifts see one set.
    let row_sums = |y: usize| {
        let mut sums: Sums = [[0.0; 3]; BANDS];
        for x in (margin..w - margin).filter(|&x| (0.1..0.97).contains(&a[(x, y)])) {
            let there = DVec2::new(x as f64, y as f64) + shift;
            let value = f64::from(sample(b, there, 0.0f32, |v, w| v * w, |a, b| a + b));
            let band = &mut sums[(a[(x, y)] * BANDS as f32) as usize];
            *band = [band[0] + 1.0, band[1] + value, band[2] + value * value];
        }
        sums
    };
    let rows: Vec<Sums> = (margin..h - margin).into_par_iter().map(row_sums).collect();
    let mut all = [0.0; 3];
    let mut within = 0.0;
    for band in 0..BANDS {
        let add = |s: [f64; 3], t: [f64; 3]| [s[0] + t[0], s[1] + t[1], s[2] + t[2]];
        let sums = rows.iter().fold([0.0; 3], |sums, row| add(sums, row[band]));
        within += scatter(sums);
        all = add(all, sums);
    }
    (all[0] >= 100.0 && scatter(all) > 0.0).then(|| within / scatter(all))
}

/// Sum of squared deviations from the mean, of a count, a sum and a sum of squares.
fn scatter([n, sum, squares]: [f64; 3]) -> f64 {
    if n > 0.0 { (squares - sum * sum / n).max(0.0) } else { 0.0 }
}

/// The four Catmull–Rom weights for a fraction 0…1 between the two middle taps.
fn catmull_rom(t: f64) -> [f32; 4] {
    [
        -0.5 * t + t * t - 0.5 * t * t * t,
        1.0 - 2.5 * t * t + 1.5 * t * t * t,
        0.5 * t + 2.0 * t * t - 1.5 * t * t * t,
        -0.5 * t * t + 0.5 * t * t * t,
    ]
    .map(|w| w as f32)
}

fn sample<T: Copy>(
    image: &Image<T>,
    at: DVec2,
    zero: T,
    times: impl Fn(T, f32) -> T,
    plus: impl Fn(T, T) -> T,
) -> T {
    let (x0, y0) = (at.x.floor(), at.y.floor());
    let (wx, wy) = (catmull_rom(at.x - x0), catmull_rom(at.y - y0));
    let mut sum = zero;
    for (j, wy) in wy.into_iter().enumerate() {
        let y = (y0 as i64 + j as i64 - 1).clamp(0, image.height() as i64 - 1) as usize;
        for (i, wx) in wx.into_iter().enumerate() {
            let x = (x0 as i64 + i as i64 - 1).clamp(0, image.width() as i64 - 1) as usize;
            sum = plus(sum, times(image[(x, y)], wx * wy));
        }
    }
    sum
}

/// A frame shifted back by `shift`, and where its light may be used.
pub(super) fn undo(
    linear: &Image<Rgb>,
    usable: &Image<bool>,
    shift: DVec2,
) -> (Image<Rgb>, Image<bool>) {
    let (w, h) = (linear.width(), linear.height());
    let rows: Vec<(Vec<Vec3>, Vec<bool>)> = (0..h)
        .into_par_iter()
        .map(|y| {
            (0..w)
                .map(|x| {
                    let at = DVec2::new(x as f64, y as f64) + shift;
                    let light = sample(linear, at, Vec3::ZERO, |l, w| l * w, |a, b| a + b);
                    (light, all_taps(usable, at))
                })
                .unzip()
        })
        .collect();
    let (mut light, mut ok) = (Vec::with_capacity(w * h), Vec::with_capacity(w * h));
    for (l, o) in rows {
        light.extend(l);
        ok.extend(o);
    }
    let whole = "one value for every pixel was pushed";
    (Image::from_pixels(w, h, light).expect(whole), Image::from_pixels(w, h, ok).expect(whole))
}

/// True where all pixels that Catmull–Rom mixes are inside and usable.
fn all_taps(usable: &Image<bool>, at: DVec2) -> bool {
    let (x0, y0) = (at.x.floor() as i64, at.y.floor() as i64);
    let tap = |x: i64, y: i64| {
        x >= 0 && y >= 0 && usable.get(x as usize, y as usize).copied().unwrap_or(false)
    };
    (-1..3).all(|j| (-1..3).all(|i| tap(x0 + i, y0 + j)))
}

/// In-place 2-D Fourier transform of a [`WINDOW`]² square; the inverse is not scaled.
fn transform_2d(square: &mut [DVec2], inverse: bool) {
    square.par_chunks_exact_mut(WINDOW).for_each(|row| transform(row, inverse));
    let mut turned = transposed(square);
    turned.par_chunks_exact_mut(WINDOW).for_each(|row| transform(row, inverse));
    square.copy_from_slice(&transposed(&turned));
}

fn transposed(square: &[DVec2]) -> Vec<DVec2> {
    (0..WINDOW * WINDOW).map(|i| square[(i % WINDOW) * WINDOW + i / WINDOW]).collect()
}

/// Radix-2 Fourier transform (Cooley–Tukey, decimation in time); the length is a power of two.
fn transform(values: &mut [DVec2], inverse: bool) {
    let n = values.len();
    let bits = n.trailing_zeros();
    for i in 0..n {
        let j = i.reverse_bits() >> (usize::BITS - bits);
        if i < j {
            values.swap(i, j);
        }
    }
    let times = |a: DVec2, b: DVec2| DVec2::new(a.x * b.x - a.y * b.y, a.x * b.y + a.y * b.x);
    let mut length = 2;
    while length <= n {
        let angle = if inverse { 2.0 * PI } else { -2.0 * PI } / length as f64;
        for start in (0..n).step_by(length) {
            for k in 0..length / 2 {
                let turn = DVec2::from_angle(angle * k as f64);
                let (even, odd) = (values[start + k], values[start + k + length / 2]);
                values[start + k] = even + times(turn, odd);
                values[start + k + length / 2] = even - times(turn, odd);
            }
        }
        length *= 2;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A smooth scene of blobs, seen shifted.
    fn scene(shift: DVec2) -> Photo {
        Photo::from_linear(Image::from_fn(300, 280, |x, y| {
            let p = DVec2::new(x as f64, y as f64) - shift;
            let mut l = 0.1;
            for k in 0..60u32 {
                // A low-discrepancy scatter (Roberts 2018).
                let c = DVec2::new(
                    (0.754_877_666 * f64::from(k)).fract() * 300.0,
                    (0.569_840_291 * f64::from(k)).fract() * 280.0,
                );
                let size = 3.0 + f64::from(k % 7);
                l += 0.4 * (-(p - c).length_squared() / (2.0 * size * size)).exp();
            }
            Rgb::splat(l as f32)
        }))
    }

    #[test]
    fn shifts_are_measured_to_a_tenth_of_a_pixel() {
        let reference = scene(DVec2::ZERO);
        for shift in [DVec2::new(0.4, -0.3), DVec2::new(3.7, 1.2), DVec2::new(-14.6, 8.25)] {
            let found = measure((&reference, 1.0), (&scene(shift), 1.0)).unwrap();
            assert!((found.shift - shift).length() < 0.1, "{shift} was found as {}", found.shift);
            assert!(found.residual_ratio < 0.5, "{}", found.residual_ratio);
        }
    }

    #[test]
    fn undoing_the_shift_gives_the_scene_back() {
        let shift = DVec2::new(2.3, -1.6);
        let moved = scene(shift);
        let (back, usable) = undo(&moved.linear, &Image::filled(300, 280, true), shift);
        let reference = scene(DVec2::ZERO);
        for y in 5..270 {
            for x in 5..290 {
                assert!(usable[(x, y)]);
                let error = (back[(x, y)] - reference.linear[(x, y)]).abs().max_element();
                assert!(error < 2e-3, "({x}, {y}) is off by {error}");
            }
        }
        assert!(!usable[(299, 100)], "beyond the frame nothing is known");
    }

    #[test]
    fn a_flat_frame_has_no_shift() {
        let flat = Photo::from_linear(Image::filled(64, 64, Rgb::splat(0.3)));
        assert_eq!(measure((&flat, 1.0), (&flat, 1.0)), None);
    }
}
