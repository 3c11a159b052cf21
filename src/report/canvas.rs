//! A photograph to draw on: antialiased lines and circles over an 8-bit sRGB picture.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};

use glam::DVec2;

use super::lettering::{self, HIGH, WIDE, letter};
use crate::conventions::Rgb;
use crate::photo::colour::srgb_encode;
use crate::photo::{Image, Photo, Samples, Transfer};

/// 8-bit sRGB.
pub type Colour = [u8; 3];

/// What is drawn round lines and letters, and what paper is.
const RIM: Colour = [0, 0, 0];
const PAPER: Colour = [255, 255, 255];
/// Pixels of a letter's cell on paper.
const PAPER_CELL: usize = 2;

/// A picture that is drawn on. Points are in pixels, the centre of the top-left pixel is (0, 0).
#[derive(Clone, Debug)]
pub struct Canvas {
    width: usize,
    height: usize,
    data: Vec<u8>,
    /// What is drawn round lines and letters.
    rim: Colour,
    /// Pixels of a letter's cell, across and down.
    cell: usize,
}

impl Canvas {
    /// White paper. Letters are 10 × 14 px, with 2 px between them.
    pub fn paper(width: usize, height: usize) -> Self {
        let data = vec![u8::MAX; 3 * width * height];
        Self { width, height, data, rim: PAPER, cell: PAPER_CELL }
    }

    /// The picture in sRGB; light above white is clipped.
    pub fn new(linear: &Image<Rgb>) -> Self {
        Self::encoded(linear, |l| srgb_encode(l.max(0.0)))
    }

    /// A photograph as viewers show it, `reduced` × `reduced` of its pixels in one: through the camera's own
    /// curve where that is known.
    pub fn of(photo: &Photo, reduced: usize) -> Self {
        let linear = match reduced {
            0 | 1 => Cow::Borrowed(&photo.linear),
            n => Cow::Owned(photo.linear.reduced(n)),
        };
        match &photo.encoding.transfer {
            Transfer::Measured(curve) => Self::encoded(&linear, |l| curve.encode(l)),
            Transfer::Linear | Transfer::Srgb | Transfer::Gamma(_) => Self::new(&linear),
        }
    }

    fn encoded(linear: &Image<Rgb>, encode: impl Fn(f32) -> f32) -> Self {
        let code = |l: f32| (encode(l).clamp(0.0, 1.0) * 255.0).round() as u8;
        let data = linear.pixels().iter().flat_map(|l| l.to_array().map(&code)).collect();
        let (width, height) = (linear.width(), linear.height());
        // Letters stay legible when a 6000 px picture is looked at in a browser.
        Self { width, height, data, rim: RIM, cell: (width.max(height) / 500).max(1) }
    }

    /// A line between two points, with a dark rim that lets it be seen on any ground. Points that are not
    /// finite draw nothing.
    pub fn line(&mut self, from: DVec2, to: DVec2, colour: Colour) {
        self.path(&[Some(from), Some(to)], colour);
    }

    /// Blends a line through points, each pixel once, however many pieces touch it.
    fn stroke(&mut self, points: &[Option<DVec2>], colour: Colour, half: f64, opacity: f64) {
        let mut covered = BTreeMap::new();
        for pair in points.windows(2) {
            if let [Some(from), Some(to)] = *pair {
                self.cover(from, to, half, &mut covered);
            }
        }
        for ((x, y), share) in covered {
            self.blend(x, y, colour, opacity * share);
        }
    }

    /// How far a piece of a line covers the pixels round it.
    fn cover(
        &self,
        from: DVec2,
        to: DVec2,
        half: f64,
        covered: &mut BTreeMap<(usize, usize), f64>,
    ) {
        if !from.is_finite() || !to.is_finite() {
            return;
        }
        let reach = DVec2::splat(half + 1.0);
        let low = (from.min(to) - reach).max(DVec2::ZERO);
        let high = (from.max(to) + reach)
            .min(DVec2::new(self.width as f64 - 1.0, self.height as f64 - 1.0));
        if low.x > high.x || low.y > high.y {
            return;
        }
        for y in low.y as usize..=high.y as usize {
            for x in low.x as usize..=high.x as usize {
                let distance = distance_to_line(DVec2::new(x as f64, y as f64), from, to);
                let share = (half + 0.5 - distance).clamp(0.0, 1.0);
                if share > 0.0 {
                    let most = covered.entry((x, y)).or_insert(share);
                    *most = most.max(share);
                }
            }
        }
    }

    /// Lines through points; a gap where a point is missing.
    pub fn path(&mut self, points: &[Option<DVec2>], colour: Colour) {
        let half = self.half_width();
        self.stroke(points, self.rim, 2.0 * half, 0.5);
        self.stroke(points, colour, half, 1.0);
    }

    /// A line of `width` px through points, without a rim.
    pub fn stroke_line(&mut self, points: &[DVec2], colour: Colour, width: f64) {
        let points: Vec<_> = points.iter().copied().map(Some).collect();
        self.stroke(&points, colour, 0.5 * width - 0.5, 1.0);
    }

    /// A filled circle.
    pub fn disc(&mut self, centre: DVec2, radius: f64, colour: Colour) {
        self.stroke(&[Some(centre), Some(centre)], colour, radius, 1.0);
    }

    /// A circle of 2 px.
    pub fn ring(&mut self, centre: DVec2, radius: f64, colour: Colour) {
        self.stroke_line(&around(centre, radius), colour, 2.0);
    }

    /// A display-linear picture with its upper left pixel at (x, y), each of its pixels a square of
    /// `times` px. What does not fit is cut.
    pub fn paste(&mut self, (x, y): (usize, usize), picture: &Image<Rgb>, times: usize) {
        let times = times.max(1);
        for row in y..(y + times * picture.height()).min(self.height) {
            for column in x..(x + times * picture.width()).min(self.width) {
                let light = picture[((column - x) / times, (row - y) / times)];
                let at = 3 * (row * self.width + column);
                let code = |l: f32| (srgb_encode(l.clamp(0.0, 1.0)) * 255.0).round() as u8;
                self.data[at..at + 3].copy_from_slice(&light.to_array().map(code));
            }
        }
    }

    /// As [`path`](Self::path), with lines that let the picture show through.
    pub fn faint_path(&mut self, points: &[Option<DVec2>], colour: Colour) {
        self.stroke(points, colour, 0.5 * self.half_width(), 0.6);
    }

    /// Letters whose lower left corner is at `at`, moved into the picture if they would leave it.
    pub fn text(&mut self, at: DVec2, text: &str, colour: Colour) {
        let cell = self.cell;
        let (wide, high) = (cell * (WIDE + 1) * text.chars().count(), cell * HIGH);
        if !at.is_finite() || wide + 2 * cell > self.width || high + 2 * cell > self.height {
            return;
        }
        let within =
            |v: f64, least: usize, most: usize| v.clamp(least as f64, most as f64) as usize;
        let left = within(at.x, cell, self.width - wide - cell);
        let top = within(at.y - high as f64, cell, self.height - high - cell);
        // The dark rim of every cell first, one cell wide.
        for (colour, rim, opacity) in [(self.rim, cell, 0.7), (colour, 0, 1.0)] {
            let mut marked = BTreeSet::new();
            for (i, c) in text.chars().enumerate() {
                for (row, bits) in letter(c).into_iter().enumerate() {
                    for column in (0..WIDE).filter(|k| bits >> (WIDE - 1 - k) & 1 == 1) {
                        let x = left + cell * (i * (WIDE + 1) + column) - rim;
                        let y = top + cell * row - rim;
                        let side = cell + 2 * rim;
                        marked
                            .extend((y..y + side).flat_map(|y| (x..x + side).map(move |x| (x, y))));
                    }
                }
            }
            for (x, y) in marked {
                self.blend(x, y, colour, opacity);
            }
        }
    }

    /// Height of a letter, px.
    pub fn letter_height(&self) -> f64 {
        (self.cell * lettering::HIGH) as f64
    }

    /// An upright cross, `radius` px from centre to tip.
    pub fn cross(&mut self, at: DVec2, radius: f64, colour: Colour) {
        self.line(at - DVec2::X * radius, at + DVec2::X * radius, colour);
        self.line(at - DVec2::Y * radius, at + DVec2::Y * radius, colour);
    }

    /// A circle.
    pub fn circle(&mut self, centre: DVec2, radius: f64, colour: Colour) {
        let points: Vec<_> = around(centre, radius).into_iter().map(Some).collect();
        self.path(&points, colour);
    }

    /// The finished picture.
    pub fn into_samples(self) -> (usize, usize, Samples) {
        (self.width, self.height, Samples::U8 { channels: 3, data: self.data })
    }

    /// Lines stay visible when a 6000 px picture is looked at in a browser.
    fn half_width(&self) -> f64 {
        (self.width.max(self.height) as f64 / 1200.0).max(1.0)
    }

    fn blend(&mut self, x: usize, y: usize, colour: Colour, opacity: f64) {
        let at = 3 * (y * self.width + x);
        for (sample, new) in self.data[at..at + 3].iter_mut().zip(colour) {
            let mixed = f64::from(*sample) * (1.0 - opacity) + f64::from(new) * opacity;
            *sample = mixed.round() as u8;
        }
    }
}

/// Points of a circle, the first one also last.
fn around(centre: DVec2, radius: f64) -> Vec<DVec2> {
    let turn = |i: i32| f64::from(i) / 64.0 * std::f64::consts::TAU;
    (0..=64).map(|i| centre + radius * DVec2::from_angle(turn(i))).collect()
}

/// Distance of a point from a line's nearest point.
fn distance_to_line(point: DVec2, from: DVec2, to: DVec2) -> f64 {
    let along = to - from;
    let length_squared = along.length_squared();
    let t = if length_squared > 0.0 { (point - from).dot(along) / length_squared } else { 0.0 };
    point.distance(from + along * t.clamp(0.0, 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn black() -> Canvas {
        Canvas::new(&Image::filled(9, 5, Rgb::ZERO))
    }

    #[test]
    fn a_line_through_pixel_centres_fills_them_and_nothing_far() {
        let mut canvas = black();
        canvas.line(DVec2::new(1.0, 2.0), DVec2::new(7.0, 2.0), [255, 0, 0]);
        let (.., Samples::U8 { data, .. }) = canvas.into_samples() else { panic!() };
        assert_eq!(data[3 * (2 * 9 + 4)], 255);
        assert_eq!(data[3 * 4], 0);
        assert_eq!(data[3 * (2 * 9 + 4) + 1], 0);
    }

    #[test]
    fn letters_are_drawn_whole_and_inside_the_picture() {
        let white = || Canvas::new(&Image::filled(60, 20, Rgb::ONE));
        let red = |canvas: Canvas| {
            let (.., Samples::U8 { data, .. }) = canvas.into_samples() else { panic!() };
            data.chunks(3).filter(|p| **p == [255, 0, 0]).count()
        };
        // L has seven cells down and four more across, a cell is a pixel here.
        for at in [DVec2::new(5.0, 15.0), DVec2::new(-99.0, 1e9), DVec2::new(1e9, -1e9)] {
            let mut canvas = white();
            canvas.text(at, "l", [255, 0, 0]);
            assert_eq!(red(canvas), 11, "{at}");
        }
        let mut canvas = white();
        canvas.text(DVec2::NAN, "L", [255, 0, 0]);
        canvas.text(DVec2::ZERO, "far too long a text", [255, 0, 0]);
        assert_eq!(red(canvas), 0);
    }

    #[test]
    fn lines_outside_or_not_finite_draw_nothing() {
        let mut canvas = black();
        canvas.line(DVec2::new(-9.0, -9.0), DVec2::new(-3.0, -5.0), [255; 3]);
        canvas.line(DVec2::NAN, DVec2::ZERO, [255; 3]);
        canvas.circle(DVec2::new(1e12, 0.0), 3.0, [255; 3]);
        let (.., Samples::U8 { data, .. }) = canvas.into_samples() else { panic!() };
        assert!(data.iter().all(|&v| v == 0));
    }
}
