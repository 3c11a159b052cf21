//! What the camera meets first, pixel by pixel, and what a tile of pixels shows of the local scene.
//!
//! One ray through every pixel centre, and nine through a block where they tell as much; nothing here is
//! filtered or noisy.

use std::collections::BTreeSet;

use glam::Vec3;
use rayon::prelude::*;

use super::primary::Primary;
use super::sampler::{Numbers, Sampler};
use super::surface::Colouring;
use super::world::{PartBall, World};
use crate::photo::{Image, Window};
use crate::scene::Bounds;
use crate::trace::Ray;

/// Side of a tile, pixels.
pub const TILE: usize = 16;

/// A block of at most [`TILE`] × [`TILE`] pixels.
#[derive(Clone, Copy, Debug)]
pub struct Block {
    pub x: usize,
    pub y: usize,
    pub width: usize,
    pub height: usize,
}

impl Block {
    /// The blocks of a picture, row by row.
    pub fn all(width: usize, height: usize) -> Vec<Self> {
        let rows = (0..height).step_by(TILE);
        rows.flat_map(|y| {
            (0..width).step_by(TILE).map(move |x| Self {
                x,
                y,
                width: TILE.min(width - x),
                height: TILE.min(height - y),
            })
        })
        .collect()
    }

    /// The smallest window around blocks; an empty one around none.
    pub fn window(blocks: impl Iterator<Item = Self> + Clone) -> Window {
        let low = |side: fn(&Self) -> usize| blocks.clone().map(|b| side(&b)).min().unwrap_or(0);
        let high = |side: fn(&Self) -> usize| blocks.clone().map(|b| side(&b)).max().unwrap_or(0);
        let first = (low(|b| b.x), low(|b| b.y));
        let end = (high(|b| b.x + b.width), high(|b| b.y + b.height));
        Window { first, size: (end.0 - first.0, end.1 - first.1) }
    }

    /// Its four quarters, or fewer of a block one pixel wide.
    pub fn quarters(&self) -> Vec<Self> {
        let (left, top) = (self.width.div_ceil(2), self.height.div_ceil(2));
        let columns = [(self.x, left), (self.x + left, self.width - left)];
        let rows = [(self.y, top), (self.y + top, self.height - top)];
        let all = rows.into_iter().flat_map(|(y, height)| {
            columns.into_iter().map(move |(x, width)| Self { x, y, width, height })
        });
        all.filter(|block| block.n_pixels() > 0).collect()
    }

    pub fn n_pixels(&self) -> usize {
        self.width * self.height
    }

    /// Position of the block's `k`-th pixel in the picture.
    pub fn pixel(&self, k: usize) -> (usize, usize) {
        (self.x + k % self.width, self.y + k / self.width)
    }
}

/// What the camera meets first at the pixel centres of a part of the picture.
pub struct Guides {
    pub window: Window,
    /// Along the view axis, metres; +∞ for nothing.
    pub depth: Image<f32>,
    /// Zero for nothing.
    pub normal: Image<Vec3>,
    /// One more than the local mesh's number, whatever object stands before it; 0 for none.
    pub local: Image<u32>,
}

/// A local point at a pixel centre.
#[derive(Clone, Copy, Debug)]
struct Point {
    x: usize,
    y: usize,
    position: Vec3,
    normal: Vec3,
    mesh: usize,
    own_material: bool,
    /// Radiance of a white matt surface without objects, as far as known.
    without: Option<Vec3>,
}

/// What the pixel centres of a block show.
pub struct View {
    pub block: Block,
    /// An object is seen.
    pub object: bool,
    points: Vec<Point>,
    /// Nine points stand for all.
    glanced: bool,
}

/// Boxes that hold a local mesh.
pub struct Shape {
    pub boxes: Vec<Bounds>,
    /// The mesh lies in a plane.
    pub flat: bool,
}

/// The local things that a block shows, summed up.
#[derive(Clone, Debug)]
pub struct Footprint {
    /// A ball around the points.
    pub ball: PartBall,
    /// Their mean normal, and the largest angle from it (radians).
    pub normal: Vec3,
    pub spread: f32,
    /// The local meshes seen.
    pub meshes: Vec<usize>,
    /// A surface with a material of its own is seen: its light is not in proportion to irradiance.
    pub own_material: bool,
    /// Smallest radiance of a white matt surface without objects there, by channel, as far as known.
    pub without: Option<Vec3>,
}

impl View {
    /// Looks through every pixel centre of a block; also what each of them meets.
    pub fn new(world: &World, primary: &Primary, block: &Block) -> (Self, Vec<Seen>) {
        let mut view = Self { block: *block, object: false, points: Vec::new(), glanced: false };
        let seen = (0..block.n_pixels()).map(|k| {
            let (x, y) = block.pixel(k);
            let Some(ray) = primary.ray(x, y, 0.5, 0.5) else { return Seen::NOTHING };
            let (seen, point, object) = look(world, &ray, x, y);
            view.points.extend(point);
            view.object |= object;
            seen
        });
        let seen = seen.collect();
        (view, seen)
    }

    /// What a block shows that no object is seen in, by nine rays; `None` where they may miss something:
    /// they tell all where the block shows nothing, or nothing but one local mesh that is flat.
    pub fn glance(
        world: &World,
        primary: &Primary,
        shapes: &[Shape],
        block: &Block,
    ) -> Option<Self> {
        let mut view = Self { block: *block, object: false, points: Vec::new(), glanced: true };
        let mut shown = (0..shapes.len()).filter(|&k| primary.may_show(block, &shapes[k].boxes));
        let Some(only) = shown.next() else { return Some(view) };
        if shown.next().is_some() || !shapes[only].flat {
            return None;
        }
        let across = [0, block.width / 2, block.width - 1].map(|i| block.x + i);
        let down = [0, block.height / 2, block.height - 1].map(|j| block.y + j);
        for (x, y) in down.into_iter().flat_map(|y| across.map(|x| (x, y))) {
            let (_, point, object) = look(world, &primary.ray_once(x, y)?, x, y);
            if object {
                return None;
            }
            view.points.push(point?);
        }
        Some(view)
    }

    /// True if every pixel centre shows the same matt local mesh and no object.
    pub fn is_plain(&self) -> bool {
        let Some(first) = self.points.first() else { return false };
        let same = |p: &Point| p.mesh == first.mesh && !p.own_material;
        let everywhere = self.glanced || self.points.len() == self.block.n_pixels();
        !self.object && everywhere && self.points.iter().all(same)
    }

    /// Whether its parts can be asked for.
    pub fn has_parts(&self) -> bool {
        !self.glanced
    }

    /// What `part` of the block shows; `None` if nothing local.
    pub fn footprint(&self, part: Block) -> Option<Footprint> {
        let inside = |p: &&Point| {
            (part.x..part.x + part.width).contains(&p.x)
                && (part.y..part.y + part.height).contains(&p.y)
        };
        let points: Vec<&Point> = self.points.iter().filter(inside).collect();
        let positions: Vec<Vec3> = points.iter().map(|p| p.position).collect();
        let normals: Vec<Vec3> = points.iter().map(|p| p.normal).collect();
        let (ball, normal, spread) = around(&positions, &normals, part)?;
        let mut meshes: Vec<usize> = points.iter().map(|p| p.mesh).collect();
        meshes.sort_unstable();
        meshes.dedup();
        let without = points.iter().filter_map(|p| p.without).reduce(Vec3::min);
        let own_material = points.iter().any(|p| p.own_material);
        Some(Footprint { ball, normal, spread, meshes, own_material, without })
    }
}

/// What a pixel centre meets first.
#[derive(Clone, Copy)]
pub struct Seen {
    depth: f32,
    normal: Vec3,
    local: u32,
}

impl Seen {
    const NOTHING: Self = Self { depth: f32::INFINITY, normal: Vec3::ZERO, local: 0 };
}

impl Guides {
    /// Guides of the part `window` of the picture; `seen` are whole blocks that were looked at already.
    pub fn new(
        world: &World,
        primary: &Primary,
        window: Window,
        seen: &[(Block, Vec<Seen>)],
    ) -> Self {
        let (width, height) = window.size;
        let mut guides = Self {
            window,
            depth: Image::filled(width, height, f32::INFINITY),
            normal: Image::filled(width, height, Vec3::ZERO),
            local: Image::filled(width, height, 0),
        };
        guides.take(seen);
        let known: BTreeSet<(usize, usize)> = seen.iter().map(|(b, _)| (b.y, b.x)).collect();
        let rest: Vec<Block> = Block::all(width, height)
            .into_iter()
            .map(|b| Block { x: b.x + window.first.0, y: b.y + window.first.1, ..b })
            .filter(|block| !known.contains(&(block.y, block.x)))
            .collect();
        let rest: Vec<(Block, Vec<Seen>)> =
            rest.par_iter().map(|block| (*block, View::new(world, primary, block).1)).collect();
        guides.take(&rest);
        guides
    }

    fn take(&mut self, seen: &[(Block, Vec<Seen>)]) {
        for (block, seen) in seen {
            for (k, seen) in seen.iter().enumerate() {
                let Some(at) = self.window.inside(block.pixel(k)) else { continue };
                self.depth[at] = seen.depth;
                self.normal[at] = seen.normal;
                self.local[at] = seen.local;
            }
        }
    }
}

/// What a ray through a pixel's centre meets first, the local point on it, and whether an object is seen.
fn look(world: &World, ray: &Ray, x: usize, y: usize) -> (Seen, Option<Point>, bool) {
    let axis = (world.camera.pose.world_from_camera.matrix3 * -glam::DVec3::Z).as_vec3();
    let sampler = Sampler::new(0, (x, y), 0, 0, Numbers::SobolOwen);
    let step = world.camera_step(ray, &sampler);
    let along = ray.direction.dot(axis);
    let mut seen = Seen::NOTHING;
    let point = step.local.as_ref().map(|hit| {
        let point = world.local_point(ray, hit);
        seen = Seen {
            depth: hit.t * along,
            normal: point.surface.normal(),
            local: point.mesh as u32 + 1,
        };
        let pixel = glam::Vec2::new(x as f32, y as f32);
        Point {
            x,
            y,
            position: point.surface.position,
            normal: point.surface.geometric,
            mesh: point.mesh,
            own_material: point.colour == Colouring::Own,
            without: world.albedo.irradiance(pixel, point.mesh),
        }
    });
    if let Some(hit) = &step.object {
        seen.depth = hit.t * along;
        seen.normal = world.object_point(ray, hit, false).surface.normal();
    }
    (seen, point, step.object.is_some())
}

/// A ball around the points of a block and a cone around their normals; `None` of nothing.
fn around(points: &[Vec3], normals: &[Vec3], block: Block) -> Option<(PartBall, Vec3, f32)> {
    let low = points.iter().copied().reduce(Vec3::min)?;
    let high = points.iter().copied().reduce(Vec3::max)?;
    let centre = 0.5 * (low + high);
    let side = block.width.min(block.height) as f32;
    // Surfaces go on to the pixels' far edges, half a pixel beyond the outermost centres.
    let to_the_edges = 1.05 * side / (side - 1.0).max(0.5);
    let radius = points.iter().map(|p| p.distance(centre)).fold(0.0, f32::max) * to_the_edges;
    let mean = normals.iter().sum::<Vec3>().try_normalize();
    let (normal, spread) = match mean {
        Some(mean) => (mean, normals.iter().map(|n| mean.angle_between(*n)).fold(0.0, f32::max)),
        None => (Vec3::Y, std::f32::consts::PI),
    };
    Some((PartBall { centre, radius }, normal, spread))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_and_their_quarters_cover_a_picture_once() {
        let mut covered = Image::filled(37, 21, 0);
        for block in Block::all(37, 21).iter().flat_map(Block::quarters) {
            for k in 0..block.n_pixels() {
                covered[block.pixel(k)] += 1;
            }
        }
        assert!(covered.pixels().iter().all(|&n| n == 1));
    }

    #[test]
    fn the_ball_holds_every_point_and_the_cone_every_normal() {
        let points = [Vec3::ZERO, Vec3::new(2.0, 0.0, 1.0), Vec3::new(1.0, 0.5, -3.0)];
        let block = Block { x: 0, y: 0, width: 16, height: 16 };
        let normals = [Vec3::Y, Vec3::new(0.3, 1.0, 0.0).normalize(), Vec3::Y];
        let (ball, normal, spread) = around(&points, &normals, block).unwrap();
        assert!(points.iter().all(|p| p.distance(ball.centre) <= ball.radius));
        assert!(normals.iter().all(|n| normal.angle_between(*n) <= spread + 1e-6));
        assert!(around(&[], &[], block).is_none());
        let (_, _, spread) = around(&points[..2], &[Vec3::Y, -Vec3::Y], block).unwrap();
        assert!(spread > 3.1);
    }
}
