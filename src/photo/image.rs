//! A picture in memory: row-major, top-left first.

use std::ops::{Index, IndexMut};

use crate::conventions::Rgb;

/// A `width` × `height` picture, row-major, top-left pixel first.
///
/// # Guarantees
/// `pixels().len() == width * height`; both sides may be zero.
#[derive(Clone, Debug, PartialEq)]
pub struct Image<T> {
    width: usize,
    height: usize,
    pixels: Vec<T>,
}

impl<T: Clone> Image<T> {
    /// A picture of one value.
    pub fn filled(width: usize, height: usize, value: T) -> Self {
        Self { width, height, pixels: vec![value; width * height] }
    }
}

impl<T> Image<T> {
    /// Takes row-major pixels; `None` if their number is not `width * height`.
    pub fn from_pixels(width: usize, height: usize, pixels: Vec<T>) -> Option<Self> {
        (width.checked_mul(height)? == pixels.len()).then_some(Self { width, height, pixels })
    }

    /// A picture whose pixel (x, y) is `value(x, y)`.
    pub fn from_fn(width: usize, height: usize, mut value: impl FnMut(usize, usize) -> T) -> Self {
        let mut pixels = Vec::with_capacity(width * height);
        for y in 0..height {
            for x in 0..width {
                pixels.push(value(x, y));
            }
        }
        Self { width, height, pixels }
    }

    pub fn width(&self) -> usize {
        self.width
    }

    pub fn height(&self) -> usize {
        self.height
    }

    /// All pixels, row-major.
    pub fn pixels(&self) -> &[T] {
        &self.pixels
    }

    /// All pixels, row-major.
    pub fn pixels_mut(&mut self) -> &mut [T] {
        &mut self.pixels
    }

    /// The pixels of row `y`, left to right. Panics outside the picture.
    pub fn row(&self, y: usize) -> &[T] {
        &self.pixels[y * self.width..(y + 1) * self.width]
    }

    /// The pixel at column `x`, row `y`, or `None` outside the picture.
    pub fn get(&self, x: usize, y: usize) -> Option<&T> {
        if x < self.width && y < self.height() {
            Some(&self.pixels[y * self.width + x])
        } else {
            None
        }
    }

    /// The picture of `f` of each pixel.
    pub fn map<U>(&self, f: impl FnMut(&T) -> U) -> Image<U> {
        Image {
            width: self.width,
            height: self.height,
            pixels: self.pixels.iter().map(f).collect(),
        }
    }
}

impl Image<Rgb> {
    /// Means of squares of `n` × `n` pixels, `n` from 1; what does not fill one at the right and lower edge is left
    /// out.
    pub fn reduced(&self, n: usize) -> Self {
        let (width, height) = ((self.width / n).max(1), (self.height / n).max(1));
        let n = n.min(self.width).min(self.height);
        Self::from_fn(width, height, |x, y| {
            let square = (0..n * n).map(|k| self[(x * n + k % n, y * n + k / n)]);
            square.sum::<Rgb>() / (n * n) as f32
        })
    }
}

/// `image[(x, y)]`: column, row. Panics outside the picture.
impl<T> Index<(usize, usize)> for Image<T> {
    type Output = T;
    fn index(&self, (x, y): (usize, usize)) -> &T {
        assert!(x < self.width, "column {x} of a picture {} wide", self.width);
        &self.pixels[y * self.width + x]
    }
}

impl<T> IndexMut<(usize, usize)> for Image<T> {
    fn index_mut(&mut self, (x, y): (usize, usize)) -> &mut T {
        assert!(x < self.width, "column {x} of a picture {} wide", self.width);
        &mut self.pixels[y * self.width + x]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wrong_pixel_count_is_no_image() {
        assert!(Image::from_pixels(3, 2, vec![0; 5]).is_none());
        assert!(Image::from_pixels(usize::MAX, 2, vec![0; 6]).is_none());
    }

    #[test]
    fn a_reduced_picture_is_the_mean_of_its_pixels() {
        let picture = Image::from_fn(7, 5, |x, y| Rgb::splat((x + 10 * y) as f32));
        let small = picture.reduced(2);
        assert_eq!((small.width(), small.height()), (3, 2));
        assert_eq!(small[(1, 1)], Rgb::splat((22.0 + 23.0 + 32.0 + 33.0) / 4.0));
        assert_eq!(picture.reduced(1), picture);
    }

    #[test]
    fn index_is_column_then_row() {
        let image = Image::from_fn(3, 2, |x, y| 10 * y + x);
        assert_eq!(image[(2, 1)], 12);
        assert_eq!(image.row(1), &[10, 11, 12]);
        assert_eq!(image.get(3, 0), None);
    }
}
