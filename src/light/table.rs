//! Inversion of a piecewise constant density over a grid, in constant expected time.
//!
//! The cutpoint (indexed search) method of Chen & Asau 1974: a guide table says where to begin the
//! search in the cumulative sums. An alias table is as fast, but it shuffles the unit square, and the
//! stratification of a Sobol pair is lost; inversion keeps neighbours neighbours.
//! Cumulative sums are f64 while building and 32-bit fixed point when stored, so that a texel beside
//! a sun 10⁶ times as strong keeps its share.

use glam::DVec2;

/// Draws indices with probability in proportion to given weights, monotone in the random number.
#[derive(Clone, Debug)]
struct Cutpoints {
    /// Largest number, of 2³², that belongs to each index; those before the first weight have none
    /// and hold 0, which `first` passes over. Small on purpose: draws are cache misses.
    last: Vec<u32>,
    /// For k of `guide.len()` equal parts of [0, 1): the first index whose share reaches it.
    guide: Vec<u32>,
    /// The first index with a share.
    first: u32,
}

const ONE: f64 = 4_294_967_296.0;

impl Cutpoints {
    fn new(weights: impl Iterator<Item = f64> + Clone) -> Option<Self> {
        let total: f64 = weights.clone().sum();
        if !(total > 0.0) {
            return None;
        }
        let mut sum = 0.0;
        let mut last_positive = 0;
        let mut ends: Vec<u64> = weights
            .enumerate()
            .map(|(i, w)| {
                sum += w;
                if w > 0.0 {
                    last_positive = i;
                }
                ((sum / total) * ONE).round() as u64
            })
            .collect();
        // Rounding may leave the end short of 1: the last index with a weight takes it, no other.
        for end in &mut ends[last_positive..] {
            *end = ONE as u64;
        }
        let n = ends.len();
        let mut guide = Vec::with_capacity(n);
        let mut i = 0;
        for k in 0..n {
            let from = ((k as f64 / n as f64) * ONE) as u64;
            while ends[i] <= from {
                i += 1;
            }
            guide.push(i as u32);
        }
        let first = ends.iter().position(|&end| end > 0).unwrap_or(0) as u32;
        let last = ends.iter().map(|&end| end.saturating_sub(1) as u32).collect();
        Some(Self { last, guide, first })
    }

    /// The index whose share holds `u` in [0, 1), and where in its share `u` lies.
    fn draw(&self, u: f64) -> (usize, f64) {
        let n = self.last.len();
        let first = self.first as usize;
        let at = (u * ONE) as u32;
        let part = ((f64::from(at) / ONE) * n as f64) as usize;
        let mut i = self.guide[part.min(n - 1)] as usize;
        while self.last[i] < at {
            i += 1;
        }
        // A cut of the guide is rounded: the search may have to begin one share earlier.
        while i > first && self.last[i - 1] >= at {
            i -= 1;
        }
        let below = if i > first { f64::from(self.last[i - 1]) + 1.0 } else { 0.0 };
        let inside = (u * ONE - below) / (f64::from(self.last[i]) + 1.0 - below);
        (i, inside.clamp(0.0, 1.0 - f64::EPSILON))
    }
}

/// Draws a cell of a grid and a place inside it, in proportion to weights.
#[derive(Clone, Debug)]
pub struct GridTable {
    rows: Cutpoints,
    columns: Vec<Option<Cutpoints>>,
}

/// A cell drawn from a [`GridTable`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cell {
    pub column: usize,
    pub row: usize,
    /// Where in the cell, [0, 1)².
    pub inside: DVec2,
}

impl GridTable {
    /// `weights` are row-major, finite and not negative; `None` if they are all zero.
    pub fn new(width: usize, weights: &[f64]) -> Option<Self> {
        let row_sums: Vec<f64> = weights.chunks(width.max(1)).map(|row| row.iter().sum()).collect();
        let rows = Cutpoints::new(row_sums.iter().copied())?;
        let columns =
            weights.chunks(width).map(|row| Cutpoints::new(row.iter().copied())).collect();
        Some(Self { rows, columns })
    }

    /// The cell for `u` in [0, 1)²: u.y chooses the row, u.x the column.
    pub fn draw(&self, u: DVec2) -> Cell {
        let (row, y) = self.rows.draw(u.y);
        // A row that can be drawn has a weight, and so has columns; otherwise any column will do.
        let (column, x) = self.columns[row].as_ref().map_or((0, u.x), |c| c.draw(u.x));
        Cell { column, row, inside: DVec2::new(x, y) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn draws_follow_the_weights_at_both_ends_of_the_interval() {
        let table = GridTable::new(3, &[0.0, 1.0, 0.0, 0.0, 1.0, 2.0]).unwrap();
        let cell = |x, y| {
            let c = table.draw(DVec2::new(x, y));
            (c.column, c.row)
        };
        assert_eq!(cell(0.0, 0.0), (1, 0), "0 picks the first cell with a weight (B52)");
        assert_eq!(cell(0.999_999_999_9, 0.1), (1, 0));
        assert_eq!(cell(0.0, 0.3), (1, 1));
        assert_eq!(cell(0.34, 0.999_999_999_9), (2, 1));
    }

    #[test]
    fn no_weight_is_no_table() {
        assert!(GridTable::new(2, &[0.0; 4]).is_none());
        assert!(GridTable::new(1, &[]).is_none());
    }

    #[test]
    fn a_weight_beside_one_a_million_times_as_strong_keeps_its_share() {
        let mut weights = vec![1.0; 1024];
        weights[500] = 3e6;
        let table = Cutpoints::new(weights.iter().copied()).unwrap();
        for i in 0..1024 {
            let below = if i == 0 { 0.0 } else { f64::from(table.last[i - 1]) + 1.0 };
            let share = (f64::from(table.last[i]) + 1.0 - below) / ONE;
            let wanted = weights[i] / (3e6 + 1023.0);
            assert!((share - wanted).abs() < 1e-3 * wanted + 3e-10, "{i}: {share} for {wanted}");
            assert!(share > 0.0);
        }
    }

    #[test]
    fn the_place_inside_a_cell_is_uniform() {
        let table = GridTable::new(2, &[1.0, 3.0]).unwrap();
        let cell = table.draw(DVec2::new(0.625, 0.25));
        assert_eq!((cell.column, cell.row), (1, 0));
        assert!((cell.inside - DVec2::new(0.5, 0.25)).length() < 1e-9);
    }
}
