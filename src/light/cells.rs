//! The lights cut into cells of about equal power: a tree that knows where light comes from.
//!
//! Median cut (Debevec 2005) with solid angles: the longer side, in radians, is cut where half of
//! ∫ L dω lies; the cell with the largest power × radius is cut next, so that a sun is not cut to
//! shreds and no bright cell stays wide. A cell is drawn from in exact proportion to its radiance, so
//! whatever is summed over cells is unbiased however they were cut (methods-render R12.3). Suns are
//! cells of their own. Nodes lie in preorder with the place to go on at where a subtree is not wanted.

use std::f64::consts::PI;

use glam::{DVec2, Mat3, Vec3};
use rayon::prelude::*;

use super::environment::Environment;
use super::patch::Patch;
use super::table::GridTable;
use super::{Disc, Lights};
use crate::conventions::{Rgb, lat_long_solid_angle};

/// Maps coarser than this are cut inside their texels.
const LEAST_COLUMNS: usize = 128;
const LEAST_ROWS: usize = 64;
/// Cells of finer maps end at multiples of blocks, so that the sums stay small.
const MOST_COLUMNS: usize = 2048;
const MOST_ROWS: usize = 1024;

/// A part of the lights, held by a cap.
#[derive(Clone, Debug)]
pub struct Cell {
    /// Of the cap's middle, unit, world axes.
    pub direction: Vec3,
    /// Of the cap, radians.
    pub radius: f32,
    /// ∫ L dω.
    pub flux: Rgb,
    /// Largest radiance, by channel.
    pub brightest: Rgb,
    /// ∫ max(R, G, B) dω, what draws are in proportion to.
    pub power: f32,
    source: Source,
}

#[derive(Clone, Debug)]
enum Source {
    Sun(Disc),
    /// Units of the map from `column`, `row` on.
    Map {
        column: usize,
        row: usize,
        size: [usize; 2],
        table: GridTable,
    },
}

impl Cell {
    pub fn is_sun(&self) -> bool {
        matches!(self.source, Source::Sun(_))
    }
}

/// A part of the tree: a cap, and what it holds.
#[derive(Clone, Copy, Debug)]
struct Node {
    direction: Vec3,
    sin: f32,
    cos: f32,
    /// The node after this one's subtree.
    skip: u32,
    /// Index of the cell, if it is one.
    cell: u32,
}

const NO_CELL: u32 = u32::MAX;

/// All lights as cells.
#[derive(Clone, Debug)]
pub struct Cells {
    cells: Vec<Cell>,
    nodes: Vec<Node>,
    units: Units,
    world_from_map: Mat3,
}

/// The map's texels, or equal parts of them where it is coarse.
#[derive(Clone, Debug)]
struct Units {
    columns: usize,
    rows: usize,
    /// Units per texel, across and down.
    parts: [usize; 2],
    /// Cosine of the polar angle at the upper edge of each row of units, and −1 at the end.
    cosines: Vec<f64>,
    /// Width of the map, texels.
    width: usize,
    texels: Vec<Rgb>,
}

impl Units {
    fn new(environment: &Environment) -> Self {
        let (width, height) = environment.size();
        let parts = [LEAST_COLUMNS.div_ceil(width), LEAST_ROWS.div_ceil(height)];
        let (columns, rows) = (width * parts[0], height * parts[1]);
        let cosines = (0..=rows).map(|j| (PI * j as f64 / rows as f64).cos()).collect();
        Self { columns, rows, parts, cosines, width, texels: environment.radiance() }
    }

    fn radiance(&self, column: usize, row: usize) -> Rgb {
        self.texels[row / self.parts[1] * self.width + column / self.parts[0]]
    }

    fn solid_angle(&self, row: usize) -> f64 {
        lat_long_solid_angle(row, self.columns, self.rows)
    }

    fn power(&self, column: usize, row: usize) -> f64 {
        f64::from(self.radiance(column, row).max_element()) * self.solid_angle(row)
    }

    fn patch(&self, x: [usize; 2], y: [usize; 2]) -> Patch {
        let first = Patch::new(self.columns, self.rows, &self.cosines, x[0], y[0]);
        let last = Patch::new(self.columns, self.rows, &self.cosines, x[1] - 1, y[1] - 1);
        Patch {
            longitude: [first.longitude[0], last.longitude[1]],
            cosine: [first.cosine[0], last.cosine[1]],
        }
    }
}

/// Running sums of power over blocks of units.
struct Sums {
    /// Units at which the blocks begin, and the end.
    x: Vec<usize>,
    y: Vec<usize>,
    sums: Vec<f64>,
}

/// Blocks [x0, x1) × [y0, y1) and their power.
#[derive(Clone, Copy)]
struct Area {
    x: [usize; 2],
    y: [usize; 2],
    power: f64,
}

impl Sums {
    fn new(units: &Units) -> Self {
        let edges = |n: usize, most: usize| -> Vec<usize> {
            let blocks = n.min(most);
            (0..=blocks).map(|k| k * n / blocks).collect()
        };
        let (x, y) = (edges(units.columns, MOST_COLUMNS), edges(units.rows, MOST_ROWS));
        let rows: Vec<Vec<f64>> = y
            .par_windows(2)
            .map(|y| {
                let power = |x: &[usize]| {
                    (y[0]..y[1])
                        .flat_map(|j| (x[0]..x[1]).map(move |i| (i, j)))
                        .map(|(i, j)| units.power(i, j))
                        .sum::<f64>()
                };
                x.windows(2).map(power).collect()
            })
            .collect();
        let stride = x.len();
        let mut sums = vec![0.0; stride * y.len()];
        for (j, row) in rows.iter().enumerate() {
            let mut sum = 0.0;
            for (i, power) in row.iter().enumerate() {
                sum += power;
                sums[(j + 1) * stride + i + 1] = sums[j * stride + i + 1] + sum;
            }
        }
        Self { x, y, sums }
    }

    fn area(&self, x: [usize; 2], y: [usize; 2]) -> Area {
        let at = |i: usize, j: usize| self.sums[j * self.x.len() + i];
        let power = at(x[1], y[1]) - at(x[0], y[1]) - at(x[1], y[0]) + at(x[0], y[0]);
        Area { x, y, power: power.max(0.0) }
    }

    fn patch(&self, area: &Area, units: &Units) -> Patch {
        units.patch([self.x[area.x[0]], self.x[area.x[1]]], [self.y[area.y[0]], self.y[area.y[1]]])
    }

    /// Cuts the longer side where half the power lies; `None` for a single block.
    fn cut(&self, area: &Area, units: &Units) -> Option<[Area; 2]> {
        let patch = self.patch(area, units);
        let polar = patch.cosine.map(|c| c.clamp(-1.0, 1.0).acos());
        let width = (patch.longitude[0] - patch.longitude[1]) * (0.5 * (polar[0] + polar[1])).sin();
        let across = area.x[1] - area.x[0] > 1
            && (width > polar[1] - polar[0] || area.y[1] - area.y[0] == 1);
        let halves = |at: usize| {
            if across {
                [self.area([area.x[0], at], area.y), self.area([at, area.x[1]], area.y)]
            } else {
                [self.area(area.x, [area.y[0], at]), self.area(area.x, [at, area.y[1]])]
            }
        };
        let side = if across { area.x } else { area.y };
        if side[1] - side[0] < 2 {
            return None;
        }
        // The last place that leaves no more than half before it, by bisection
        let (mut low, mut high) = (side[0] + 1, side[1] - 1);
        while low < high {
            let middle = (low + high).div_ceil(2);
            if halves(middle)[0].power <= 0.5 * area.power {
                low = middle
            } else {
                high = middle - 1
            }
        }
        Some(halves(low))
    }
}

/// A node while the tree grows.
struct Growing {
    area: Area,
    direction: Vec3,
    radius: f64,
    children: Option<[usize; 2]>,
    whole: bool,
}

impl Cells {
    /// Cuts the environment of `lights` into at most `most` cells, beside one for each sun.
    pub fn new(lights: &Lights, most: usize) -> Self {
        let units = Units::new(&lights.environment);
        let world_from_map = lights.environment.world_from_map();
        let mut cells = Self { cells: Vec::new(), nodes: Vec::new(), units, world_from_map };
        cells.cut_map(most.max(1));
        for sun in &lights.suns {
            let solid_angle = sun.solid_angle();
            cells.push_cell(Cell {
                direction: sun.direction,
                radius: sun.half_angle,
                flux: sun.radiance * solid_angle,
                brightest: sun.radiance,
                power: sun.radiance.max_element() * solid_angle,
                source: Source::Sun(*sun),
            });
        }
        cells
    }

    pub fn len(&self) -> usize {
        self.cells.len()
    }

    pub fn is_empty(&self) -> bool {
        self.cells.is_empty()
    }

    pub fn iter(&self) -> impl Iterator<Item = &Cell> {
        self.cells.iter()
    }

    /// Where the middle of a cell's light is: unit, world axes.
    pub fn centroid(&self, cell: &Cell) -> Vec3 {
        let Source::Map { column, row, size, .. } = &cell.source else { return cell.direction };
        let mut sum = glam::DVec3::ZERO;
        for y in *row..row + size[1] {
            for x in *column..column + size[0] {
                let (direction, _) = self.units.patch([x, x + 1], [y, y + 1]).bounding_cap();
                sum += direction * self.units.power(x, y);
            }
        }
        (self.world_from_map * sum.as_vec3()).try_normalize().unwrap_or(cell.direction)
    }

    /// Share of the power that small cells hold: suns and lamps.
    pub fn share_of_small(&self, radius: f32) -> f32 {
        let sum = |small: bool| -> f32 {
            self.cells.iter().filter(|c| !small || c.radius < radius).map(|c| c.power).sum()
        };
        if self.cells.is_empty() { 0.0 } else { sum(true) / sum(false) }
    }

    /// Calls `found` for every cell of whose cap, and of all caps above it in the tree, `wanted`
    /// says that it may hold something: (middle, sine and cosine of the radius). A cap of more than a
    /// half sphere has cosine −∞.
    pub fn visit(
        &self,
        wanted: impl Fn(Vec3, f32, f32) -> bool,
        mut found: impl FnMut(usize, &Cell),
    ) {
        let mut at = 0;
        while let Some(node) = self.nodes.get(at) {
            if !wanted(node.direction, node.sin, node.cos) {
                at = node.skip as usize;
                continue;
            }
            if let Some(cell) = self.cells.get(node.cell as usize) {
                found(node.cell as usize, cell);
            }
            at += 1;
        }
    }

    /// A direction drawn from a cell in proportion to max(R, G, B), and radiance over density there;
    /// `u` in [0, 1)².
    pub fn draw(&self, cell: usize, u: DVec2) -> (Vec3, Rgb) {
        let Cell { source, power, .. } = &self.cells[cell];
        match source {
            Source::Sun(sun) => {
                let direction = sun.sample(u.x as f32, u.y as f32);
                (direction, sun.radiance * sun.solid_angle())
            }
            Source::Map { column, row, table, .. } => {
                let drawn = table.draw(u);
                let (column, row) = (column + drawn.column, row + drawn.row);
                let longitude =
                    (0.5 - (column as f64 + drawn.inside.x) / self.units.columns as f64) * 2.0 * PI;
                let (top, bottom) = (self.units.cosines[row], self.units.cosines[row + 1]);
                let y = top + (bottom - top) * drawn.inside.y;
                let radius = ((1.0 - y) * (1.0 + y)).max(0.0).sqrt();
                let (sin, cos) = (longitude as f32).sin_cos();
                let direction = Vec3::new(radius as f32 * sin, y as f32, radius as f32 * cos);
                let radiance = self.units.radiance(column, row);
                let arriving = radiance * (power / radiance.max_element().max(f32::MIN_POSITIVE));
                ((self.world_from_map * direction).normalize(), arriving)
            }
        }
    }

    fn cut_map(&mut self, most: usize) {
        let sums = Sums::new(&self.units);
        let grow = |area: Area, units: &Units| {
            let (direction, radius) = sums.patch(&area, units).bounding_cap();
            Growing { area, direction: direction.as_vec3(), radius, children: None, whole: false }
        };
        let all = sums.area([0, sums.x.len() - 1], [0, sums.y.len() - 1]);
        if all.power <= 0.0 {
            return;
        }
        let mut tree = vec![grow(all, &self.units)];
        let mut leaves = vec![0];
        while leaves.len() < most {
            let weight = |&k: &usize| {
                let node: &Growing = &tree[k];
                if node.whole { -1.0 } else { node.area.power * node.radius }
            };
            let Some((place, &k)) = leaves
                .iter()
                .enumerate()
                .max_by(|a, b| weight(a.1).total_cmp(&weight(b.1)))
                .filter(|(_, k)| weight(k) >= 0.0)
            else {
                break;
            };
            let Some(halves) = sums.cut(&tree[k].area, &self.units) else {
                tree[k].whole = true;
                continue;
            };
            let first = tree.len();
            tree.extend(halves.map(|half| grow(half, &self.units)));
            tree[k].children = Some([first, first + 1]);
            leaves[place] = first;
            leaves.push(first + 1);
        }
        self.lay_out(&tree, &sums);
    }

    /// Writes the grown tree in preorder; parts without light are left out.
    fn lay_out(&mut self, tree: &[Growing], sums: &Sums) {
        enum Task {
            Enter(usize),
            Leave(usize),
        }
        // Running sums are rounded: only its units say for sure that a part is dark.
        let mut filled: Vec<Option<Cell>> = tree
            .par_iter()
            .map(|node| if node.children.is_none() { self.fill(node, sums) } else { None })
            .collect();
        let mut tasks = vec![Task::Enter(0)];
        while let Some(task) = tasks.pop() {
            match task {
                Task::Leave(node) => self.nodes[node].skip = self.nodes.len() as u32,
                Task::Enter(k) => match tree[k].children {
                    Some([a, b]) => {
                        let direction = self.world_from_map * tree[k].direction;
                        tasks.push(Task::Leave(self.nodes.len()));
                        tasks.extend([Task::Enter(b), Task::Enter(a)]);
                        self.push_node(direction, tree[k].radius as f32, NO_CELL);
                    }
                    None => {
                        if let Some(cell) = filled[k].take() {
                            self.push_cell(cell);
                        }
                    }
                },
            }
        }
    }

    /// The cell of a part of the map; `None` if it is dark.
    fn fill(&self, node: &Growing, sums: &Sums) -> Option<Cell> {
        let (area, units) = (&node.area, &self.units);
        let (x, y) = (sums.x[area.x[0]]..sums.x[area.x[1]], sums.y[area.y[0]]..sums.y[area.y[1]]);
        let (mut flux, mut brightest) = (glam::DVec3::ZERO, Rgb::ZERO);
        let mut weights = Vec::with_capacity(x.len() * y.len());
        for row in y.clone() {
            for column in x.clone() {
                let radiance = units.radiance(column, row);
                flux += radiance.as_dvec3() * units.solid_angle(row);
                brightest = brightest.max(radiance);
                weights.push(units.power(column, row));
            }
        }
        Some(Cell {
            direction: self.world_from_map * node.direction,
            radius: node.radius as f32,
            flux: flux.as_vec3(),
            brightest,
            power: weights.iter().sum::<f64>() as f32,
            source: Source::Map {
                column: x.start,
                row: y.start,
                size: [x.len(), y.len()],
                table: GridTable::new(x.len(), &weights)?,
            },
        })
    }

    fn push_cell(&mut self, cell: Cell) {
        self.push_node(cell.direction, cell.radius, self.cells.len() as u32);
        self.cells.push(cell);
    }

    fn push_node(&mut self, direction: Vec3, radius: f32, cell: u32) {
        let (sin, cos) = if radius < 0.5 * std::f32::consts::PI {
            radius.sin_cos()
        } else {
            (1.0, f32::NEG_INFINITY)
        };
        let skip = self.nodes.len() as u32 + 1;
        self.nodes.push(Node { direction, sin, cos, skip, cell });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::photo::Image;
    use glam::DQuat;

    fn sunny(width: usize, height: usize) -> Lights {
        let picture = Image::from_fn(width, height, |i, j| {
            let sky = if j < height / 2 { 1.0 + 0.5 * (i as f32 * 0.3).sin() } else { 0.0 };
            let sun = if (i, j) == (width / 3, height / 5) { 5000.0 } else { 0.0 };
            Rgb::new(sky + sun, 0.8 * sky + sun, 1.2 * sky + 0.9 * sun)
        });
        let turn = DQuat::from_rotation_y(0.4);
        let environment = Environment::new(&picture, turn, true).unwrap();
        let sun = Disc::from_irradiance(Vec3::new(0.2, 0.8, 0.5), 0.005, Rgb::new(1.0, 0.9, 0.7));
        Lights::from_parts(environment, vec![sun])
    }

    fn number(k: u32, salt: u32) -> f64 {
        let mut x = k.wrapping_mul(0x9e37_79b9) ^ salt;
        for m in [0x7feb_352d_u32, 0x846c_a68b] {
            x = (x ^ (x >> 16)).wrapping_mul(m);
        }
        f64::from(x ^ (x >> 15)) / 4_294_967_296.0
    }

    #[test]
    fn cells_hold_all_the_light() {
        for (w, h) in [(1, 1), (7, 5), (128, 64), (256, 128)] {
            let lights = sunny(w, h);
            let cells = Cells::new(&lights, 64);
            let sum: Rgb = cells.iter().map(|c| c.flux).sum();
            let suns = lights.suns[0].radiance * lights.suns[0].solid_angle();
            let wanted = lights.environment.flux().as_vec3() + suns;
            assert!((sum - wanted).length() < 1e-4 * wanted.length(), "{w} x {h}: {sum} {wanted}");
            assert!(cells.iter().count() <= 65);
        }
        assert_eq!(
            Cells::new(&Lights::from_parts(Environment::constant(Rgb::ZERO), vec![]), 9)
                .iter()
                .count(),
            0
        );
    }

    #[test]
    fn draws_lie_in_their_cells_and_estimate_the_irradiance() {
        for (w, h) in [(2, 1), (128, 64)] {
            let lights = sunny(w, h);
            let cells = Cells::new(&lights, 128);
            let normal = Vec3::new(0.3, 0.9, -0.2).normalize();
            let (mut sum, mut squares) = (0.0, 0.0);
            const N: u32 = 400;
            for k in 0..N {
                let mut one = 0.0;
                for (c, cell) in cells.iter().enumerate() {
                    let u = DVec2::new(number(k, c as u32), number(k, 77 + 3 * c as u32));
                    let (direction, arriving) = cells.draw(c, u);
                    let off = direction.angle_between(cell.direction);
                    assert!(off <= cell.radius + 1e-3, "{off} of {}", cell.radius);
                    one += f64::from(arriving.y * normal.dot(direction).max(0.0));
                }
                sum += one / f64::from(N);
                squares += one * one / f64::from(N);
            }
            let sigma = ((squares - sum * sum) / f64::from(N)).sqrt();
            let exact = f64::from(lights.irradiance(normal).y);
            // Two maps at 4σ.
            assert!((sum - exact).abs() < 4.0 * sigma + 1e-4 * exact, "{sum} {exact} {sigma}");
            assert!(sigma < 3e-3 * exact, "stratified: {sigma} of {exact}");
        }
    }

    #[test]
    fn the_tree_finds_every_cell_that_a_plain_search_finds() {
        let lights = sunny(128, 64);
        let cells = Cells::new(&lights, 256);
        for k in 0..50 {
            let z = 2.0 * number(k, 5) as f32 - 1.0;
            let (s, c) = (std::f32::consts::TAU * number(k, 6) as f32).sin_cos();
            let axis = Vec3::new(c * (1.0 - z * z).sqrt(), z, s * (1.0 - z * z).sqrt());
            let (sin, cos) = (0.02 + 1.2 * number(k, 7) as f32).sin_cos();
            let meets = |d: Vec3, s: f32, c: f32| d.dot(axis) >= cos * c - sin * s;
            let mut found = Vec::new();
            cells.visit(meets, |cell, _| found.push(cell));
            found.sort_unstable();
            let plain: Vec<usize> = cells
                .iter()
                .enumerate()
                .filter(|(_, cell)| meets(cell.direction, cell.radius.sin(), cell.radius.cos()))
                .map(|(k, _)| k)
                .collect();
            assert_eq!(found, plain);
        }
    }

    #[test]
    fn a_sun_of_one_texel_is_one_small_cell() {
        let cells = Cells::new(&sunny(512, 256), 256);
        let brightest =
            cells.iter().filter(|c| !c.is_sun()).max_by(|a, b| a.power.total_cmp(&b.power));
        assert!(brightest.unwrap().radius < 0.03);
    }
}
