//! Cube maps: six square pictures of 90° each, as a cross, a strip or a column of faces.
//!
//! The faces are as a camera at the centre sees them, which is how OpenEXR's `ENVMAP_CUBE` stores
//! them (ImfEnvmap.h), or as OpenGL's cube-map table does (OpenGL 4.6, table 8.19), whose axes are
//! left-handed: there every face is its own mirror image. Unlike OpenEXR's library, which puts the
//! outermost pixel *centres* on the cube's edges, the pixels here tile the faces, as in OpenGL.
//!
//! `dω = du dv/(1 + u² + v²)^{3/2}` on a face of −1…1 (methods-capture A6). Samples and lamps near an edge
//! go on in the face that really lies beyond it, wherever the picture has put that.

use glam::{DVec2, DVec3};

use super::mapping::Mapping;

/// Where the faces are in the picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CubeLayout {
    /// 4 × 3 faces: −X, −Z, +X, +Z in the middle row, +Y and −Y above and below −Z.
    Cross,
    /// 3 × 4 faces: +Y, −Z, −Y and +Z (turned by half a turn) in the middle column, −X and +X beside −Z.
    VerticalCross,
    /// 6 × 1 faces: +X −X +Y −Y +Z −Z.
    Strip,
    /// 1 × 6 faces: +X −X +Y −Y +Z −Z from the top, as OpenEXR's `ENVMAP_CUBE`.
    Column,
}

/// How each face is turned.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CubeFaces {
    /// As a camera at the centre sees them, and as OpenEXR stores them.
    #[default]
    Inside,
    /// OpenGL's table (rows of a face in the order of its t): mirror images of those seen from inside.
    OpenGl,
}

/// A cube map.
#[derive(Clone, Copy, Debug)]
pub struct Cube {
    /// Side of a face, px.
    face: usize,
    columns: usize,
    rows: usize,
    faces: [Face; 6],
}

/// A face: its cell in the picture, and where its axes point.
#[derive(Clone, Copy, Debug)]
struct Face {
    column: usize,
    row: usize,
    right: DVec3,
    up: DVec3,
    outward: DVec3,
}

/// The names of the faces in the order +X −X +Y −Y +Z −Z, as separate files end on them.
pub const FACE_NAMES: [&str; 6] = ["px", "nx", "py", "ny", "pz", "nz"];

/// Outward, right and up of +X −X +Y −Y +Z −Z, seen from inside: ImfEnvmap.h's figures.
const INSIDE: [[DVec3; 3]; 6] = [
    [DVec3::X, DVec3::Z, DVec3::Y],
    [DVec3::NEG_X, DVec3::NEG_Z, DVec3::Y],
    [DVec3::Y, DVec3::X, DVec3::Z],
    [DVec3::NEG_Y, DVec3::X, DVec3::NEG_Z],
    [DVec3::Z, DVec3::NEG_X, DVec3::Y],
    [DVec3::NEG_Z, DVec3::X, DVec3::Y],
];

/// The same of OpenGL's table: right = s_c, up = −t_c.
const OPENGL: [[DVec3; 3]; 6] = [
    [DVec3::X, DVec3::NEG_Z, DVec3::Y],
    [DVec3::NEG_X, DVec3::Z, DVec3::Y],
    [DVec3::Y, DVec3::X, DVec3::NEG_Z],
    [DVec3::NEG_Y, DVec3::X, DVec3::Z],
    [DVec3::Z, DVec3::X, DVec3::Y],
    [DVec3::NEG_Z, DVec3::NEG_X, DVec3::Y],
];

impl CubeLayout {
    /// Faces across and down.
    pub fn shape(self) -> (usize, usize) {
        match self {
            Self::Cross => (4, 3),
            Self::VerticalCross => (3, 4),
            Self::Strip => (6, 1),
            Self::Column => (1, 6),
        }
    }

    /// Cells (column, row) of +X −X +Y −Y +Z −Z.
    fn cells(self) -> [(usize, usize); 6] {
        match self {
            Self::Cross => [(2, 1), (0, 1), (1, 0), (1, 2), (3, 1), (1, 1)],
            Self::VerticalCross => [(2, 1), (0, 1), (1, 0), (1, 2), (1, 3), (1, 1)],
            Self::Strip => [0, 1, 2, 3, 4, 5].map(|k| (k, 0)),
            Self::Column => [0, 1, 2, 3, 4, 5].map(|k| (0, k)),
        }
    }

    /// Whether it is cut out of paper and folded: then the faces are as seen from inside.
    pub fn folds(self) -> bool {
        matches!(self, Self::Cross | Self::VerticalCross)
    }
}

impl Cube {
    /// A cube map with faces of `face` × `face` px; the faces of crosses are always as seen from inside.
    pub fn new(layout: CubeLayout, faces: CubeFaces, face: usize) -> Self {
        let axes = match faces {
            CubeFaces::OpenGl if !layout.folds() => OPENGL,
            _ => INSIDE,
        };
        let (columns, rows) = layout.shape();
        let mut k = 0;
        let faces = layout.cells().map(|(column, row)| {
            let [outward, mut right, mut up] = axes[k];
            // Folded over the bottom face, the back one stands on its head.
            if layout == CubeLayout::VerticalCross && outward == DVec3::Z {
                (right, up) = (-right, -up);
            }
            k += 1;
            Face { column, row, right, up, outward }
        });
        Self { face, columns, rows, faces }
    }

    /// The picture's width and height.
    pub fn size(&self) -> (usize, usize) {
        (self.columns * self.face, self.rows * self.face)
    }

    /// The cell that holds `pixel`; of one outside the picture, the nearest.
    fn cell(&self, pixel: DVec2) -> (usize, usize) {
        let p = (pixel + 0.5) / self.face as f64;
        let within = |v: f64, n: usize| (v.floor().max(0.0) as usize).min(n - 1);
        (within(p.x, self.columns), within(p.y, self.rows))
    }

    fn face_at(&self, pixel: DVec2) -> Option<&Face> {
        let (column, row) = self.cell(pixel);
        self.faces.iter().find(|face| (face.column, face.row) == (column, row))
    }

    fn holds(&self, pixel: DVec2) -> bool {
        let (width, height) = self.size();
        let inside = |v: f64, size: usize| (-0.5..=size as f64 - 0.5).contains(&v);
        inside(pixel.x, width) && inside(pixel.y, height)
    }

    /// The place of `pixel` on a face, −1…1 there: right and up.
    fn on(&self, face: &Face, pixel: DVec2) -> DVec2 {
        let p = (pixel + 0.5) / self.face as f64;
        let (u, v) = (p.x - face.column as f64, p.y - face.row as f64);
        DVec2::new(2.0 * u - 1.0, 1.0 - 2.0 * v)
    }
}

impl Face {
    fn direction(&self, at: DVec2) -> DVec3 {
        (self.outward + self.right * at.x + self.up * at.y).normalize()
    }
}

impl Mapping for Cube {
    fn pixel(&self, direction: DVec3) -> Option<DVec2> {
        // The face whose outward axis is nearest; ties on edges go to the first.
        let (mut best, mut most) = (&self.faces[0], f64::NEG_INFINITY);
        for face in &self.faces {
            if direction.dot(face.outward) > most {
                (best, most) = (face, direction.dot(face.outward));
            }
        }
        // An edge's far side is another face's, in a strip quite another one's.
        let within = |v: f64| v.clamp(0.0, 1.0 - 1e-12);
        let u = within(0.5 + 0.5 * direction.dot(best.right) / most);
        let v = within(0.5 - 0.5 * direction.dot(best.up) / most);
        let cell = DVec2::new(best.column as f64, best.row as f64);
        Some((cell + DVec2::new(u, v)) * self.face as f64 - 0.5)
    }

    fn direction(&self, pixel: DVec2) -> Option<DVec3> {
        let face = self.face_at(pixel).filter(|_| self.holds(pixel))?;
        Some(face.direction(self.on(face, pixel)))
    }

    fn solid_angle(&self, pixel: DVec2) -> Option<f64> {
        let face = self.face_at(pixel).filter(|_| self.holds(pixel))?;
        let on = self.on(face, pixel);
        Some((2.0 / self.face as f64).powi(2) / (1.0 + on.length_squared()).powf(1.5))
    }

    fn piece(&self, pixel: DVec2) -> usize {
        let (column, row) = self.cell(pixel);
        row * self.columns + column
    }

    fn direction_beyond(&self, inside: DVec2, pixel: DVec2) -> Option<DVec3> {
        let face = self.face_at(inside)?;
        Some(face.direction(self.on(face, pixel)))
    }

    fn continued(&self, inside: DVec2, x: i64, y: i64) -> (i64, i64) {
        let pixel = DVec2::new(x as f64, y as f64);
        if self.holds(pixel) && self.cell(pixel) == self.cell(inside) {
            return (x, y);
        }
        let there = self.direction_beyond(inside, pixel).and_then(|d| self.pixel(d));
        there.map_or((x, y), |p| {
            let (width, height) = self.size();
            let within = |v: f64, size: usize| (v.round() as i64).clamp(0, size as i64 - 1);
            (within(p.x, width), within(p.y, height))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LAYOUTS: [CubeLayout; 4] =
        [CubeLayout::Cross, CubeLayout::VerticalCross, CubeLayout::Strip, CubeLayout::Column];

    fn cross() -> Cube {
        Cube::new(CubeLayout::Cross, CubeFaces::Inside, 100)
    }

    #[test]
    fn six_axes_are_where_they_belong_in_the_cross() {
        let at = |d: DVec3| (cross().pixel(d).unwrap() + 0.5) / 100.0;
        assert!((at(DVec3::NEG_Z) - DVec2::new(1.5, 1.5)).length() < 1e-12);
        assert!((at(DVec3::X) - DVec2::new(2.5, 1.5)).length() < 1e-12);
        assert!((at(DVec3::Y) - DVec2::new(1.5, 0.5)).length() < 1e-12);
        // Looking up from the front keeps right on the right.
        let up_right = DVec3::new(0.3, 1.0, -0.2);
        assert!(at(up_right).x > 1.5 && at(up_right).y > 0.5 && at(up_right).y < 1.0);
    }

    #[test]
    fn crosses_fold_where_faces_touch() {
        // Across an edge between two cells that both hold faces, directions go on smoothly.
        for layout in [CubeLayout::Cross, CubeLayout::VerticalCross] {
            let cube = Cube::new(layout, CubeFaces::Inside, 10);
            let (width, height) = cube.size();
            let mut edges = 0;
            let mut meet = |a: DVec2, b: DVec2| {
                if let (Some(a), Some(b)) = (cube.direction(a), cube.direction(b)) {
                    edges += 1;
                    assert!(a.angle_between(b) < 0.021, "{layout:?}: {a} {b}");
                }
            };
            for x in 0..width {
                for y in (10..height).step_by(10) {
                    let edge = DVec2::new(x as f64, y as f64 - 0.5);
                    meet(edge - DVec2::Y * 0.05, edge + DVec2::Y * 0.05);
                }
            }
            for y in 0..height {
                for x in (10..width).step_by(10) {
                    let edge = DVec2::new(x as f64 - 0.5, y as f64);
                    meet(edge - DVec2::X * 0.05, edge + DVec2::X * 0.05);
                }
            }
            // Five folds of ten pixels each.
            assert_eq!(edges, 50, "{layout:?}");
        }
    }

    /// OpenGL 4.6, table 8.19: s_c, t_c and m_a of each face; s = ½(s_c/|m_a| + 1), rows in the order of t.
    #[test]
    fn opengl_faces_are_those_of_its_table() {
        let cube = Cube::new(CubeLayout::Strip, CubeFaces::OpenGl, 64);
        for r in [DVec3::new(0.9, 0.2, -0.3), DVec3::new(-0.9, 0.2, -0.3)] {
            let (sc, tc) = if r.x > 0.0 { (-r.z, -r.y) } else { (r.z, -r.y) };
            check(&cube, r, if r.x > 0.0 { 0.0 } else { 1.0 }, sc / 0.9, tc / 0.9);
        }
        for r in [DVec3::new(0.1, 0.8, 0.3), DVec3::new(0.1, -0.8, 0.3)] {
            let (sc, tc) = if r.y > 0.0 { (r.x, r.z) } else { (r.x, -r.z) };
            check(&cube, r, if r.y > 0.0 { 2.0 } else { 3.0 }, sc / 0.8, tc / 0.8);
        }
        for r in [DVec3::new(0.1, -0.2, 0.7), DVec3::new(0.1, -0.2, -0.7)] {
            let (sc, tc) = if r.z > 0.0 { (r.x, -r.y) } else { (-r.x, -r.y) };
            check(&cube, r, if r.z > 0.0 { 4.0 } else { 5.0 }, sc / 0.7, tc / 0.7);
        }
    }

    fn check(cube: &Cube, r: DVec3, face: f64, sc: f64, tc: f64) {
        let wanted = DVec2::new(face + 0.5 * (sc + 1.0), 0.5 * (tc + 1.0)) * 64.0 - 0.5;
        let found = cube.pixel(r.normalize()).unwrap();
        assert!((found - wanted).length() < 1e-9, "{r}: {found}, not {wanted}");
    }

    /// ImfEnvmap.cpp: +X has +Z on the right, +Y has +Z at the top, −Y has −Z at the top, +Z has −X right.
    #[test]
    fn openexr_columns_are_those_of_its_library() {
        let cube = Cube::new(CubeLayout::Column, CubeFaces::Inside, 10);
        let at = |d: DVec3| (cube.pixel(d).unwrap() + 0.5) / 10.0;
        let near = |a: DVec2, x: f64, y: f64| assert!((a - DVec2::new(x, y)).length() < 1e-12);
        near(at(DVec3::new(1.0, 0.0, 0.5)), 0.75, 0.5);
        near(at(DVec3::new(-1.0, 0.0, 0.5)), 0.25, 1.5);
        near(at(DVec3::new(0.0, 1.0, 0.5)), 0.5, 2.25);
        near(at(DVec3::new(0.0, -1.0, 0.5)), 0.5, 3.75);
        near(at(DVec3::new(0.5, 0.0, 1.0)), 0.25, 4.5);
        near(at(DVec3::new(0.5, 0.5, -1.0)), 0.75, 5.25);
    }

    #[test]
    fn beyond_an_edge_lies_the_face_that_really_does() {
        for layout in LAYOUTS {
            for faces in [CubeFaces::Inside, CubeFaces::OpenGl] {
                let cube = Cube::new(layout, faces, 16);
                let (width, height) = cube.size();
                for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
                    let here = DVec2::new(x as f64, y as f64);
                    let Some(direction) = cube.direction(here) else { continue };
                    for (dx, dy) in [(-1, 0), (1, 0), (0, -1), (0, 1)] {
                        let (x, y) = cube.continued(here, x as i64 + dx, y as i64 + dy);
                        let there = cube.direction(DVec2::new(x as f64, y as f64)).unwrap();
                        // A pixel in the middle of a face is 2/16 wide.
                        assert!(there.angle_between(direction) < 0.13, "{layout:?} {here}");
                    }
                }
            }
        }
    }
}
