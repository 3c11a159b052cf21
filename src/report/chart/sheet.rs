//! Pictures side by side, each with a few words below it.

use glam::DVec2;

use super::axes::{BLACK, LETTER};
use crate::conventions::Rgb;
use crate::photo::Image;
use crate::report::Canvas;

/// A picture, display-linear, and the lines below it.
#[derive(Clone, Debug)]
pub struct Tile {
    pub picture: Image<Rgb>,
    pub lines: Vec<String>,
}

/// Least width of a picture on the sheet, px: what its lines need.
const LEAST_WIDTH: usize = 290;
const GAP: usize = 14;

/// Tiles of equal size in rows of `columns`; pixels of small pictures are shown as squares.
pub fn contact_sheet(tiles: &[Tile], columns: usize) -> Canvas {
    let (wide, high) = tiles
        .iter()
        .fold((1, 1), |(w, h), tile| (w.max(tile.picture.width()), h.max(tile.picture.height())));
    let times = LEAST_WIDTH.div_ceil(wide).max(1);
    let lines = tiles.iter().map(|tile| tile.lines.len()).max().unwrap_or(0);
    let line = LETTER.y as usize + 8;
    let (wide, high) = (times * wide, times * high);
    let (across, down) = (wide + GAP, high + lines * line + 2 * GAP);
    let columns = columns.clamp(1, tiles.len().max(1));
    let rows = tiles.len().div_ceil(columns).max(1);
    let mut canvas = Canvas::paper(columns * across + GAP, rows * down + GAP);
    for (k, tile) in tiles.iter().enumerate() {
        let (x, y) = (GAP + k % columns * across, GAP + k / columns * down);
        canvas.paste((x, y), &tile.picture, times);
        for (row, text) in tile.lines.iter().enumerate() {
            let at = DVec2::new(x as f64, (y + high + (row + 1) * line) as f64);
            canvas.text(at, text, BLACK);
        }
    }
    canvas
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::photo::Samples;

    #[test]
    fn tiles_stand_in_rows_and_small_pixels_are_squares() {
        let tile = |value: f32| Tile {
            picture: Image::filled(100, 50, Rgb::splat(value)),
            lines: vec!["name".to_owned(), "1% at 2 CPU s".to_owned()],
        };
        let sheet = contact_sheet(&[tile(0.0), tile(0.25), tile(0.5), tile(1.0)], 3);
        let (width, height, Samples::U8 { data, .. }) = sheet.into_samples() else {
            panic!("8 bit");
        };
        assert_eq!((width, height), (3 * 314 + 14, 2 * (150 + 44 + 28) + 14));
        let at = |x: usize, y: usize| data[3 * (y * width + x)];
        assert_eq!(at(20, 20), 0);
        assert_eq!(at(14 + 314 + 20, 20), 137, "0.25 in sRGB");
        assert_eq!(at(4, 4), 255, "paper");
    }
}
