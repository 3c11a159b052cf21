//! Meshes and random numbers for the tests of this room.

use glam::Vec3;

use crate::scene::Mesh;

/// A small generator (PCG-like), so that the tests need no crate and never change.
pub(super) struct Random(pub u64);

impl Random {
    /// In [0, 1).
    pub fn next(&mut self) -> f32 {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 40) as f32) / (1_u32 << 24) as f32
    }

    /// In the cube from −1 to 1.
    pub fn point(&mut self) -> Vec3 {
        Vec3::new(self.next(), self.next(), self.next()) * 2.0 - 1.0
    }

    /// Unit, even over the sphere.
    pub fn direction(&mut self) -> Vec3 {
        loop {
            let p = self.point();
            if p.length_squared() > 0.01 && p.length_squared() <= 1.0 {
                return p.normalize();
            }
        }
    }
}

/// `n` triangles of about `size` in the cube from −1 to 1.
pub(super) fn soup(n: usize, size: f32, seed: u64) -> Mesh {
    let mut random = Random(seed);
    let mut mesh = Mesh::default();
    for i in 0..n as u32 {
        let centre = random.point();
        for _ in 0..3 {
            mesh.positions.push(centre + size * random.point());
        }
        mesh.triangles.push([3 * i, 3 * i + 1, 3 * i + 2]);
    }
    mesh
}

/// A closed sphere of 4 · n · (n − 1) triangles.
pub(super) fn sphere(n: u32, centre: Vec3) -> Mesh {
    let mut mesh = Mesh::default();
    let (rows, columns) = (n, 2 * n);
    mesh.positions.push(centre + Vec3::Y);
    for row in 1..rows {
        let theta = std::f32::consts::PI * row as f32 / rows as f32;
        for column in 0..columns {
            let phi = std::f32::consts::TAU * column as f32 / columns as f32;
            let (sin, cos) = theta.sin_cos();
            mesh.positions.push(centre + Vec3::new(sin * phi.cos(), cos, sin * phi.sin()));
        }
    }
    mesh.positions.push(centre - Vec3::Y);
    let at = |row: u32, column: u32| 1 + (row - 1) * columns + column % columns;
    let last = mesh.positions.len() as u32 - 1;
    for column in 0..columns {
        mesh.triangles.push([0, at(1, column + 1), at(1, column)]);
        mesh.triangles.push([last, at(rows - 1, column), at(rows - 1, column + 1)]);
        for row in 1..rows - 1 {
            let (a, b) = (at(row, column), at(row, column + 1));
            let (c, d) = (at(row + 1, column), at(row + 1, column + 1));
            mesh.triangles.extend([[a, b, c], [b, d, c]]);
        }
    }
    mesh
}

/// The unit box, each face a grid of n × n squares; all coordinates exact.
pub(super) fn grid_box(n: u32, shift: Vec3) -> Mesh {
    let mut mesh = Mesh::default();
    for axis in 0..3 {
        for side in [0.0, 1.0] {
            let first = mesh.positions.len() as u32;
            for j in 0..=n {
                for i in 0..=n {
                    let mut p = Vec3::ZERO;
                    p[axis] = side;
                    p[(axis + 1) % 3] = i as f32 / n as f32;
                    p[(axis + 2) % 3] = j as f32 / n as f32;
                    mesh.positions.push(p + shift);
                }
            }
            for j in 0..n {
                for i in 0..n {
                    let a = first + j * (n + 1) + i;
                    let (b, c, d) = (a + 1, a + n + 1, a + n + 2);
                    mesh.triangles.extend([[a, b, c], [b, d, c]]);
                }
            }
        }
    }
    mesh
}
