//! The printed targets: a checkerboard of 10 × 7 squares and one AprilTag of family 36h11.

use glam::{DVec2, DVec3};

/// Side of a checkerboard square, metres.
pub const SQUARE_M: f64 = 0.025;

/// Inner corners of the checkerboard, across and down.
pub const CORNERS: [usize; 2] = [9, 6];

/// White paper round the checkerboard's squares, metres.
const BOARD_MARGIN_M: f64 = 0.0125;

/// The tag's number in family 36h11.
pub const TAG_ID: u32 = 5;

/// Outer edge of the tag's black border, metres.
pub const TAG_M: f64 = 0.16;

/// The 6 × 6 data cells of tag 5, 1 = white, upright as OpenCV's DICT_APRILTAG_36h11 has it.
const TAG_CELLS: [[u8; 6]; 6] = [
    [0, 0, 1, 1, 0, 1],
    [0, 1, 1, 1, 0, 0],
    [1, 1, 0, 1, 0, 1],
    [0, 1, 1, 0, 1, 1],
    [1, 0, 0, 0, 1, 1],
    [0, 0, 1, 1, 1, 1],
];

/// Reflectances of the printer's black and of its paper.
const BLACK: f64 = 0.05;
const WHITE: f64 = 0.85;

/// A printed sheet somewhere in the world.
#[derive(Clone, Copy)]
pub struct Sheet {
    pub print: Print,
    /// Centre of the sheet.
    pub centre: DVec3,
    /// Unit vectors: the print's right and its upward direction.
    pub right: DVec3,
    pub up: DVec3,
}

#[derive(Clone, Copy)]
pub enum Print {
    Checkerboard,
    Tag,
}

impl Sheet {
    /// Half the paper's width and height, metres.
    pub fn half_size(&self) -> DVec2 {
        match self.print {
            Print::Checkerboard => {
                let squares = DVec2::new(CORNERS[0] as f64 + 1.0, CORNERS[1] as f64 + 1.0);
                squares * SQUARE_M / 2.0 + BOARD_MARGIN_M
            }
            // Two white cells on each side of the tag's eight.
            Print::Tag => DVec2::splat(TAG_M * 12.0 / 8.0 / 2.0),
        }
    }

    /// Unit vector from the printed side towards its viewer.
    pub fn facing(&self) -> DVec3 {
        self.right.cross(self.up)
    }

    /// Position on the sheet from its centre, x right and y down, metres.
    pub fn on_sheet(&self, p: DVec3) -> DVec2 {
        let v = p - self.centre;
        DVec2::new(v.dot(self.right), -v.dot(self.up))
    }

    /// True if the point of the sheet's plane lies on the paper.
    pub fn contains(&self, on_sheet: DVec2) -> bool {
        on_sheet.abs().cmple(self.half_size()).all()
    }

    /// Albedo at a point of the sheet.
    pub fn albedo(&self, p: DVec3) -> DVec3 {
        DVec3::splat(self.print.reflectance(self.on_sheet(p)))
    }
}

impl Print {
    /// Reflectance at a position from the centre, x right and y down, metres.
    pub fn reflectance(self, p: DVec2) -> f64 {
        let black = match self {
            Self::Checkerboard => {
                // Square (0, 0), the upper left one, is black.
                let q = p / SQUARE_M
                    + DVec2::new(CORNERS[0] as f64 + 1.0, CORNERS[1] as f64 + 1.0) / 2.0;
                let (i, j) = (q.x.floor() as i64, q.y.floor() as i64);
                let inside =
                    (0..=CORNERS[0] as i64).contains(&i) && (0..=CORNERS[1] as i64).contains(&j);
                inside && (i + j) % 2 == 0
            }
            Self::Tag => {
                let q = (p / TAG_M + 0.5) * 8.0;
                let (i, j) = (q.x.floor() as i64, q.y.floor() as i64);
                let cell = |k: i64| usize::try_from(k - 1).ok().filter(|k| *k < 6);
                let inside = (0..8).contains(&i) && (0..8).contains(&j);
                match (cell(i), cell(j)) {
                    (Some(x), Some(y)) => TAG_CELLS[y][x] == 0,
                    _ => inside,
                }
            }
        };
        if black { BLACK } else { WHITE }
    }
}
