//! A part of a picture in its file's own samples.

use half::f16;

use super::{Encoded, Samples, Window};

impl Encoded {
    /// The part of `width` × `height` px whose first pixel is (`x`, `y`) here, in the file's own samples.
    ///
    /// It may reach beyond the picture, where it holds nothing: its coverage is 0 there.
    pub fn cut_out(&self, (x, y): (i64, i64), (width, height): (usize, usize)) -> Self {
        let part = Part { from: (self.width, self.height), first: (x, y), size: (width, height) };
        let samples = match &self.samples {
            Samples::U8 { channels, data } => {
                let (channels, data) = part.of(data, *channels, u8::MAX, 0);
                Samples::U8 { channels, data }
            }
            Samples::U16 { channels, data } => {
                let (channels, data) = part.of(data, *channels, u16::MAX, 0);
                Samples::U16 { channels, data }
            }
            Samples::F16 { channels, data } => {
                let (channels, data) = part.of(data, *channels, f16::ONE, f16::ZERO);
                Samples::F16 { channels, data }
            }
            Samples::F32 { channels, data } => {
                let (channels, data) = part.of(data, *channels, 1.0, 0.0);
                Samples::F32 { channels, data }
            }
        };
        let mut cut = Self {
            path: self.path.clone(),
            format: self.format,
            width,
            height,
            nonfinite: None,
            data_window: self.data_window.map(|window| part.window(window)),
            remarks: self.remarks.clone(),
            facts: self.facts.clone(),
            encoding: self.encoding.clone(),
            samples,
        };
        cut.nonfinite = cut.find_nonfinite();
        cut
    }
}

/// Which part of a picture of `from` px.
struct Part {
    from: (usize, usize),
    first: (i64, i64),
    size: (usize, usize),
}

impl Part {
    /// Columns of the part that the picture has, and the picture's column of the first of them.
    fn shared(first: i64, size: usize, from: usize) -> (std::ops::Range<usize>, usize) {
        let begin = (-first).clamp(0, size as i64);
        let end = (from as i64 - first).clamp(begin, size as i64);
        (begin as usize..end as usize, (first + begin).max(0) as usize)
    }

    /// Its channels and samples: with a coverage where it reaches beyond the picture.
    fn of<T: Copy>(&self, data: &[T], channels: usize, all: T, nothing: T) -> (usize, Vec<T>) {
        let ((w, h), (x, y)) = (self.size, self.first);
        let (columns, from_x) = Self::shared(x, w, self.from.0);
        let (rows, from_y) = Self::shared(y, h, self.from.1);
        let beyond = columns.len() < w || rows.len() < h;
        let covered = channels + usize::from(beyond && !channels.is_multiple_of(2));
        let mut out = vec![nothing; w * h * covered];
        for (k, row) in rows.enumerate() {
            for (i, column) in columns.clone().enumerate() {
                let from = ((from_y + k) * self.from.0 + from_x + i) * channels;
                let to = (row * w + column) * covered;
                out[to..to + channels].copy_from_slice(&data[from..from + channels]);
                if covered > channels {
                    out[to + channels] = all;
                }
            }
        }
        (covered, out)
    }

    /// What of a rectangle of the picture the part has.
    fn window(&self, window: Window) -> Window {
        let along = |first: usize, size: usize, origin: i64, length: usize| {
            let begin = (first as i64 - origin).clamp(0, length as i64);
            let end = ((first + size) as i64 - origin).clamp(begin, length as i64);
            (begin as usize, (end - begin) as usize)
        };
        let x = along(window.first.0, window.size.0, self.first.0, self.size.0);
        let y = along(window.first.1, window.size.1, self.first.1, self.size.1);
        Window { first: (x.0, y.0), size: (x.1, y.1) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::conventions::Rgb;
    use crate::photo::{Image, Photo};

    fn picture() -> Encoded {
        Photo::from_linear(Image::from_fn(5, 4, |x, y| Rgb::new(x as f32, y as f32, 1.0))).encoded()
    }

    #[test]
    fn a_part_has_the_samples_of_its_place() {
        let part = picture().cut_out((1, 2), (3, 2));
        assert_eq!((part.width, part.height, part.samples.channels()), (3, 2, 3));
        let decoder = part.decoder();
        for i in 0..6 {
            let expected = Rgb::new((1 + i % 3) as f32, (2 + i / 3) as f32, 1.0);
            assert_eq!(decoder.light(i), expected);
        }
    }

    #[test]
    fn beyond_the_picture_nothing_is_covered() {
        let part = picture().cut_out((-2, -1), (9, 7));
        let decoder = part.decoder();
        for i in 0..63 {
            let (x, y) = (i as i64 % 9 - 2, i as i64 / 9 - 1);
            let inside = (0..5).contains(&x) && (0..4).contains(&y);
            assert_eq!(decoder.coverage(i), Some(if inside { 1.0 } else { 0.0 }), "({x}, {y})");
            let light = if inside { Rgb::new(x as f32, y as f32, 1.0) } else { Rgb::ZERO };
            assert_eq!(decoder.light(i), light);
        }
        let nowhere = picture().cut_out((50, -90), (2, 2));
        assert!((0..4).all(|i| nowhere.decoder().coverage(i) == Some(0.0)));
    }
}
