//! Keyframes: what one property of a node is at a time (glTF 2.0, 3.11 and appendix C).
//!
//! Before the first key and after the last the value of that key holds. Rigid motion only: nodes are
//! moved, turned and scaled; skins and morph targets are no business of this room.

use std::ops::{Add, Mul};

use glam::{DQuat, DVec3, DVec4};

/// How values follow each other between two keys.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Interpolation {
    /// The earlier key holds.
    Step,
    /// A straight line; the shorter great circle between two rotations.
    Linear,
    /// Hermite's cubic; each key is three values: tangent in, value, tangent out.
    CubicSpline,
}

/// A value that keys can hold.
pub trait Key: Copy + Add<Output = Self> + Mul<f64, Output = Self> {
    fn is_finite(self) -> bool;

    /// Whether it is nothing that a key can hold though it is finite.
    fn is_void(self) -> bool;

    /// What [`Interpolation::Linear`] makes of two keys, `s` from 0 to 1 between them.
    fn between(self, other: Self, s: f64) -> Self;
}

impl Key for DVec3 {
    fn is_finite(self) -> bool {
        Self::is_finite(self)
    }

    fn is_void(self) -> bool {
        false
    }

    fn between(self, other: Self, s: f64) -> Self {
        self.lerp(other, s)
    }
}

/// Rotations: quaternions x, y, z, w. Their length is of no matter.
impl Key for DVec4 {
    fn is_finite(self) -> bool {
        Self::is_finite(self)
    }

    fn is_void(self) -> bool {
        self == Self::ZERO
    }

    fn between(self, other: Self, s: f64) -> Self {
        unit(self).slerp(unit(other), s).into()
    }
}

/// The rotation that a quaternion of any length stands for; none of length zero.
pub fn unit(quaternion: DVec4) -> DQuat {
    let length = quaternion.length();
    if length > 0.0 { DQuat::from_vec4(quaternion / length) } else { DQuat::IDENTITY }
}

/// One property over time.
///
/// # Guarantees
/// There is a key, times are finite and never fall, and every key's value is one.
#[derive(Clone, Debug)]
pub struct Keyframes<V> {
    interpolation: Interpolation,
    /// Seconds. Two keys at one time are a jump.
    times_s: Vec<f32>,
    /// One a time, three of a spline.
    values: Vec<V>,
}

impl<V: Key> Keyframes<V> {
    /// # Errors
    /// A sentence that names the key at fault.
    pub fn new(
        interpolation: Interpolation,
        times_s: Vec<f32>,
        values: Vec<V>,
    ) -> Result<Self, String> {
        let (n, each) = (times_s.len(), values_a_key(interpolation));
        if n == 0 {
            return Err("it has no keys".into());
        }
        if each.checked_mul(n) != Some(values.len()) {
            let found = values.len();
            return Err(format!("{found} values for {n} keys, which need {each} each"));
        }
        if let Some(k) = times_s.iter().position(|time| !time.is_finite()) {
            return Err(format!("the time of key {k} is {}", times_s[k]));
        }
        if let Some(k) = (1..n).find(|&k| times_s[k] < times_s[k - 1]) {
            let (before, after) = (times_s[k - 1], times_s[k]);
            return Err(format!("key {k} at {after} s comes after one at {before} s"));
        }
        let frames = Self { interpolation, times_s, values };
        for k in 0..n {
            let key = frames.key(k);
            if !key.iter().all(|v| v.is_finite()) {
                return Err(format!("the value of key {k} is not finite"));
            }
            if key[1].is_void() {
                return Err(format!("the value of key {k} is zero, which is no rotation"));
            }
        }
        Ok(frames)
    }

    /// First and last time of a key, seconds.
    pub fn span_s(&self) -> [f64; 2] {
        // The constructor refuses none.
        [self.times_s[0], self.times_s[self.times_s.len() - 1]].map(f64::from)
    }

    /// The value at a time. Rotations are of any length but zero, except where a spline passes there.
    pub fn at(&self, time_s: f64) -> V {
        let next = self.times_s.partition_point(|&key| f64::from(key) <= time_s);
        if next == 0 || next == self.times_s.len() {
            return self.key(next.saturating_sub(1))[1];
        }
        let [start, end] = [next - 1, next].map(|k| f64::from(self.times_s[k]));
        let width = end - start;
        let s = (time_s - start) / width;
        let ([_, a, tangent_a], [tangent_b, b, _]) = (self.key(next - 1), self.key(next));
        match self.interpolation {
            Interpolation::Step => a,
            Interpolation::Linear => a.between(b, s),
            Interpolation::CubicSpline => {
                let (s2, s3) = (s * s, s * s * s);
                a * (2.0 * s3 - 3.0 * s2 + 1.0)
                    + tangent_a * (width * (s3 - 2.0 * s2 + s))
                    + b * (3.0 * s2 - 2.0 * s3)
                    + tangent_b * (width * (s3 - s2))
            }
        }
    }

    /// Tangent in, value and tangent out of a key; the value thrice where there are no tangents.
    fn key(&self, k: usize) -> [V; 3] {
        match self.interpolation {
            Interpolation::CubicSpline => [0, 1, 2].map(|i| self.values[3 * k + i]),
            Interpolation::Step | Interpolation::Linear => [self.values[k]; 3],
        }
    }
}

fn values_a_key(interpolation: Interpolation) -> usize {
    match interpolation {
        Interpolation::CubicSpline => 3,
        Interpolation::Step | Interpolation::Linear => 1,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};

    fn about_y(angle: f64) -> DVec4 {
        DQuat::from_rotation_y(angle).into()
    }

    fn along_x(interpolation: Interpolation, times: &[f32], x: &[f64]) -> Keyframes<DVec3> {
        let values = x.iter().map(|&x| DVec3::X * x).collect();
        Keyframes::new(interpolation, times.to_vec(), values).expect("good keys")
    }

    #[test]
    fn a_turn_is_half_done_half_way_on_the_shorter_way_round() {
        for sign in [1.0, -1.0] {
            // The second key's quaternion may have either sign, and any length.
            let keys = vec![about_y(0.2), about_y(0.2 + FRAC_PI_2) * (3.0 * sign)];
            let turn = Keyframes::new(Interpolation::Linear, vec![1.0, 3.0], keys).unwrap();
            for (time, angle) in [(2.0, 0.2 + FRAC_PI_4), (1.5, 0.2 + 0.25 * FRAC_PI_2)] {
                let off = unit(turn.at(time)).angle_between(DQuat::from_rotation_y(angle));
                assert!(off < 1e-7, "{sign} {time}: {off}");
            }
        }
    }

    #[test]
    fn a_spline_is_the_cubic_with_these_values_and_slopes() {
        // x³ − 2x² + 3 from 1 to 3 s and on to 4 s: values and slopes at the keys, also of its parts.
        let value = |t: f64| t.powi(3) - 2.0 * t * t + 3.0;
        let slope = |t: f64| 3.0 * t * t - 4.0 * t;
        let keys = [1.0, 3.0, 4.0].map(|t| [slope(t), value(t), slope(t)]);
        let spline = along_x(Interpolation::CubicSpline, &[1.0, 3.0, 4.0], keys.as_flattened());
        for t in [1.0, 1.25, 2.0, 2.9, 3.0, 3.5, 4.0] {
            assert!((spline.at(t).x - value(t)).abs() < 1e-12, "at {t}");
        }
        assert_eq!(spline.at(9.0).x, value(4.0), "after the last key its value holds");
    }

    #[test]
    fn steps_hold_the_earlier_key_and_lines_join_two() {
        let times = [1.0, 2.0, 4.0];
        let step = along_x(Interpolation::Step, &times, &[5.0, 6.0, 8.0]);
        let line = along_x(Interpolation::Linear, &times, &[5.0, 6.0, 8.0]);
        for (t, stepped, straight) in
            [(1.0, 5.0, 5.0), (1.5, 5.0, 5.5), (2.0, 6.0, 6.0), (3.0, 6.0, 7.0), (4.0, 8.0, 8.0)]
        {
            assert_eq!((step.at(t).x, line.at(t).x), (stepped, straight), "at {t}");
        }
        // Outside, and at no time at all.
        for (t, x) in [(f64::NEG_INFINITY, 5.0), (0.0, 5.0), (1e300, 8.0), (f64::NAN, 5.0)] {
            assert_eq!((step.at(t).x, line.at(t).x), (x, x), "at {t}");
        }
        let jump = along_x(Interpolation::Linear, &[0.0, 1.0, 1.0, 2.0], &[0.0, 1.0, 7.0, 7.0]);
        assert_eq!((jump.at(0.5).x, jump.at(1.0).x), (0.5, 7.0));
    }

    #[test]
    fn keys_that_cannot_be_are_named() {
        let refused = |times: &[f32], values: Vec<DVec4>, interpolation| {
            Keyframes::new(interpolation, times.to_vec(), values).unwrap_err()
        };
        let (w, nan) = (DVec4::W, DVec4::splat(f64::NAN));
        use Interpolation::{CubicSpline, Linear, Step};
        for (error, part) in [
            (refused(&[], vec![], Linear), "no keys"),
            (refused(&[0.0, 1.0], vec![w; 3], Step), "3 values for 2 keys, which need 1 each"),
            (refused(&[0.0, 1.0], vec![w; 2], CubicSpline), "need 3 each"),
            (refused(&[0.0, f32::NAN], vec![w; 2], Linear), "the time of key 1 is NaN"),
            (
                refused(&[0.0, 2.0, 1.5], vec![w; 3], Linear),
                "key 2 at 1.5 s comes after one at 2 s",
            ),
            (refused(&[0.0, 1.0], vec![w, nan], Linear), "the value of key 1 is not finite"),
            (refused(&[0.0], vec![DVec4::ZERO], Step), "key 0 is zero, which is no rotation"),
            (refused(&[0.0], vec![w, w, nan], CubicSpline), "the value of key 0 is not finite"),
        ] {
            assert!(error.contains(part), "{error}");
        }
    }
}
