//! What the camera meets first, pixel by pixel, and what a tile of pixels shows of the local scene.
//!
//! One ray through every pixel centre; nothing here is filtered or noisy.

use glam::Vec3;
use rayon::prelude::*;

use super::Context;
use super::primary::Primary;
use super::sampler::{Numbers, Sampler};
use super::surface::Colouring;
use super::world::{PartBall, World};
use crate::photo::Image;

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

/// What the camera meets first at pixel centres.
pub struct Guides {
    /// Along the view axis, metres; +∞ for nothing.
    pub depth: Image<f32>,
    /// Zero for nothing.
    pub normal: Image<Vec3>,
    /// The local mesh, whatever object stands before it.
    pub local: Image<Option<usize>>,
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
    /// True if every pixel centre shows the same matt local mesh and no object.
    pub fn is_plain(&self) -> bool {
        let same = |p: &Point| p.mesh == self.points[0].mesh && !p.own_material;
        !self.object && self.points.len() == self.block.n_pixels() && self.points.iter().all(same)
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

#[derive(Clone, Copy)]
struct Seen {
    depth: f32,
    normal: Vec3,
    local: Option<usize>,
}

impl Guides {
    /// Guides of the picture, and what `judge` says of the view of each of its `blocks`; `None` for
    /// blocks that were not looked at before the context was over.
    pub fn new<T: Send>(
        world: &World,
        primary: &Primary,
        blocks: &[Block],
        context: &Context,
        judge: impl Fn(&View) -> T + Sync,
    ) -> (Self, Vec<Option<T>>) {
        let (width, height) = (world.plate.width(), world.plate.height());
        let mut guides = Self {
            depth: Image::filled(width, height, f32::INFINITY),
            normal: Image::filled(width, height, Vec3::ZERO),
            local: Image::filled(width, height, None),
        };
        let found: Vec<(Vec<Seen>, Option<T>)> = blocks
            .par_iter()
            .map(|block| {
                if context.is_over() {
                    return (Vec::new(), None);
                }
                let (seen, view) = look(world, primary, block);
                (seen, Some(judge(&view)))
            })
            .collect();
        let mut judged = Vec::with_capacity(blocks.len());
        for (block, (seen, judgement)) in blocks.iter().zip(found) {
            for (k, seen) in seen.iter().enumerate() {
                let at = block.pixel(k);
                guides.depth[at] = seen.depth;
                guides.normal[at] = seen.normal;
                guides.local[at] = seen.local;
            }
            judged.push(judgement);
        }
        (guides, judged)
    }
}

fn look(world: &World, primary: &Primary, block: &Block) -> (Vec<Seen>, View) {
    let axis = (world.camera.pose.world_from_camera.matrix3 * -glam::DVec3::Z).as_vec3();
    let mut view = View { block: *block, object: false, points: Vec::new() };
    let seen = (0..block.n_pixels())
        .map(|k| {
            let nothing = Seen { depth: f32::INFINITY, normal: Vec3::ZERO, local: None };
            let (x, y) = block.pixel(k);
            let Some(ray) = primary.ray(x, y, 0.5, 0.5) else { return nothing };
            let sampler = Sampler::new(0, (x, y), 0, 0, Numbers::SobolOwen);
            let step = world.camera_step(&ray, &sampler);
            let along = ray.direction.dot(axis);
            let mut seen = nothing;
            if let Some(hit) = &step.local {
                let point = world.local_point(&ray, hit);
                seen = Seen {
                    depth: hit.t * along,
                    normal: point.surface.normal(),
                    local: Some(point.mesh),
                };
                let pixel = glam::Vec2::new(x as f32, y as f32);
                view.points.push(Point {
                    x,
                    y,
                    position: point.surface.position,
                    normal: point.surface.geometric,
                    mesh: point.mesh,
                    own_material: point.colour == Colouring::Own,
                    without: world.albedo.irradiance(pixel, point.mesh),
                });
            }
            if let Some(hit) = &step.object {
                view.object = true;
                seen.depth = hit.t * along;
                seen.normal = world.object_point(&ray, hit, false).surface.normal();
            }
            seen
        })
        .collect();
    (seen, view)
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
