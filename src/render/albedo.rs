//! The local surface's albedo, solved from the plate: ρ = π P / E₀ (methods-render R9.2).
//!
//! E₀ is the irradiance without objects, by what the estimator itself sees: local occlusion and light
//! from other local surfaces (which is the plate, where the plate shows them). It is smooth but for
//! shadow edges, so it is solved on a coarse grid of pixels; P keeps the texture. Only bounces use
//! this albedo: at the camera's own point it cancels.

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::coupled::Want;
use super::primary::Primary;
use super::sampler::{Numbers, Sampler};
use super::surface::Colouring;
use super::world::World;
use crate::conventions::Rgb;
use crate::render::Context;
use crate::scene::{AlbedoSource, Scene};

/// Largest albedo of a bounce: above it light would not die out (G15).
pub const LARGEST_BOUNCE: f32 = 0.95;
/// Assumed where the plate shows nothing of a surface: between asphalt and concrete.
const UNKNOWN: Rgb = Rgb::splat(0.25);
/// Nodes of the grid, at most about this many.
const NODES: usize = 6000;
const SAMPLES: u32 = 32;

/// E₀/π where a grid node's camera ray meets a local surface.
#[derive(Clone, Copy, Debug)]
struct Node {
    mesh: usize,
    radiance: Rgb,
}

/// Irradiance without objects on a grid over the plate, and mean albedos.
#[derive(Clone, Debug)]
pub struct AlbedoMap {
    step: usize,
    columns: usize,
    nodes: Vec<Option<Node>>,
    means: Vec<Rgb>,
}

impl AlbedoMap {
    /// What is assumed before anything is solved.
    pub fn unknown(scene: &Scene) -> Self {
        let means = scene
            .local
            .iter()
            .map(|l| if let AlbedoSource::Constant(a) = l.albedo { a } else { UNKNOWN })
            .collect();
        Self { step: 1, columns: 0, nodes: Vec::new(), means }
    }

    /// Solves on a grid, unless it is solved. A coarse round first finds the mean albedos that hidden
    /// surfaces need.
    pub fn solve(world: &mut World, primary: &Primary, context: &Context) {
        if !world.albedo.nodes.is_empty() {
            return;
        }
        let pixels = world.plate.width() * world.plate.height();
        let step = ((pixels as f64 / NODES as f64).sqrt().ceil() as usize).max(1);
        for (step, samples) in [(4 * step, SAMPLES / 4), (step, SAMPLES)] {
            let map = Self::on_grid(world, primary, step, samples, context);
            world.albedo = map;
        }
    }

    fn on_grid(
        world: &World,
        primary: &Primary,
        step: usize,
        samples: u32,
        context: &Context,
    ) -> Self {
        let (width, height) = (world.plate.width(), world.plate.height());
        let (columns, rows) = (width.div_ceil(step), height.div_ceil(step));
        let centre = |k: usize, size: usize| (k * step + step / 2).min(size - 1);
        let nodes: Vec<Option<Node>> = (0..columns * rows)
            .into_par_iter()
            .map(|k| {
                if context.is_over() {
                    return None;
                }
                let pixel = (centre(k % columns, width), centre(k / columns, height));
                node(world, primary, pixel, samples, context.seed)
            })
            .collect();

        let mut map = Self { step, columns, nodes, ..world.albedo.clone() };
        let mut found: Vec<Vec<Rgb>> = vec![Vec::new(); world.scene.local.len()];
        for (k, node) in map.nodes.iter().enumerate() {
            let Some(node) = node else { continue };
            if world.scene.local[node.mesh].albedo != AlbedoSource::Plate {
                continue;
            }
            let x = centre(k % columns, width);
            let y = centre(k / columns, height);
            let albedo = world.plate[(x, y)] / node.radiance.max(Vec3::splat(1e-9));
            found[node.mesh].push(albedo.min(Rgb::splat(LARGEST_BOUNCE)));
        }
        for (mesh, albedos) in found.iter().enumerate() {
            if !albedos.is_empty() {
                map.means[mesh] = albedos.iter().sum::<Rgb>() / albedos.len() as f32;
            }
        }
        map
    }

    /// Mean albedo of a local mesh where the plate shows it.
    pub fn mean(&self, mesh: usize) -> Rgb {
        self.means[mesh]
    }

    /// E₀/π at a pixel position on a mesh, from the nodes around that lie on the same mesh.
    pub fn irradiance(&self, pixel: Vec2, mesh: usize) -> Option<Rgb> {
        if self.nodes.is_empty() {
            return None;
        }
        let rows = self.nodes.len() / self.columns;
        // Nodes stand on whole pixels: see `on_grid`.
        let at = (pixel - (self.step / 2) as f32).max(Vec2::ZERO) / self.step as f32;
        let (i, j) = (at.x as usize, at.y as usize);
        let f = at - Vec2::new(i as f32, j as f32);
        let (mut sum, mut weights) = (Rgb::ZERO, 0.0);
        for (di, dj) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            let (column, row) = ((i + di).min(self.columns - 1), (j + dj).min(rows - 1));
            let Some(node) = &self.nodes[row * self.columns + column] else { continue };
            if node.mesh != mesh {
                continue;
            }
            let wx = if di == 0 { 1.0 - f.x } else { f.x };
            let wy = if dj == 0 { 1.0 - f.y } else { f.y };
            let weight = (wx * wy).max(1e-3);
            sum += node.radiance * weight;
            weights += weight;
        }
        (weights > 0.0).then(|| sum / weights)
    }

    /// Albedo as solved at a pixel position where the plate is `plate`: above 1 if the plate's
    /// exposure does not fit the probe's.
    fn solved(&self, plate: Rgb, pixel: Vec2, mesh: usize) -> Rgb {
        let mean = self.means[mesh];
        let Some(radiance) = self.irradiance(pixel, mesh) else { return mean };
        let channel = |c: usize| {
            // In the dark the quotient is noise over noise.
            if radiance[c] > 1e-9 { plate[c] / radiance[c] } else { mean[c] }
        };
        Rgb::new(channel(0), channel(1), channel(2)).max(Rgb::ZERO)
    }

    /// [`solved`](Self::solved), each channel at most 0.95, so that bounces die out.
    pub fn albedo(&self, plate: Rgb, pixel: Vec2, mesh: usize) -> Rgb {
        self.solved(plate, pixel, mesh).min(Rgb::splat(LARGEST_BOUNCE))
    }

    /// Albedo of the local mesh that a pixel shows, for the layer: 0 of one that is not diffuse.
    pub fn shown(&self, world: &World, mesh: usize, (x, y): (usize, usize)) -> Rgb {
        match world.scene.local[mesh].albedo {
            AlbedoSource::Constant(albedo) => albedo,
            AlbedoSource::Plate => {
                self.solved(world.plate[(x, y)], Vec2::new(x as f32, y as f32), mesh)
            }
            AlbedoSource::Material => Rgb::ZERO,
        }
    }
}

fn node(
    world: &World,
    primary: &Primary,
    pixel: (usize, usize),
    samples: u32,
    seed: u64,
) -> Option<Node> {
    let ray = primary.ray(pixel.0, pixel.1, 0.5, 0.5)?;
    let sampler =
        |index| Sampler::new(seed ^ 0x00a1_bed0, pixel, u32::MAX, index, Numbers::SobolOwen);
    let hit = world.closest_local(&ray, &sampler(0))?;
    let point = world.local_point(&ray, &hit);
    if point.colour == Colouring::Own {
        return None;
    }
    let surface = &point.surface;
    let exact = world.skylight.radiance(surface.position, surface.geometric);
    let exact = exact.filter(|_| world.flat);
    let radiance = exact.unwrap_or_else(|| {
        let sum: Rgb = (0..samples)
            .map(|index| world.look(&point, Want::Without, 1.0, sampler(index), 0).without)
            .sum();
        sum / samples as f32
    });
    Some(Node { mesh: point.mesh, radiance })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::photo::Image;
    use crate::render::test_scenes::{corner_camera, ground, local, matt, scene, uniform_sky};

    /// A texture between 0.2 and 0.8.
    fn texture(x: usize, y: usize) -> Rgb {
        Rgb::new((x % 7) as f32, (y % 5) as f32, ((x + y) % 3) as f32) * 0.1 + 0.2
    }

    #[test]
    fn a_textured_ground_under_a_known_sky_has_its_own_albedo() {
        const SKY: f32 = 0.5;
        let scene = scene(vec![], matt(0.5), vec![local(ground(50.0), AlbedoSource::Plate)]);
        let lights = uniform_sky(SKY);
        let camera = corner_camera(48, 36, 3.0);
        // E = π L, so the plate shows ρ L.
        let plate = Image::from_fn(48, 36, |x, y| texture(x, y) * SKY);
        let mut world = World::new(&scene, &lights, &camera, &plate);
        let primary = Primary::new(&camera, world.eye);
        AlbedoMap::solve(&mut world, &primary, &Context::new(1));
        for (x, y) in [(3, 20), (24, 18), (40, 33)] {
            let pixel = Vec2::new(x as f32, y as f32);
            let found = world.albedo.albedo(plate[(x, y)], pixel, 0);
            assert!((found - texture(x, y)).abs().max_element() < 1e-5, "{found}");
        }
    }

    #[test]
    fn irradiance_between_the_nodes_is_that_of_its_own_place() {
        for step in [1, 2, 3, 5] {
            let (columns, rows) = (8, 6);
            // Nodes on the pixels where `on_grid` puts them, light that grows across the plate.
            let light = |x: f32, y: f32| Rgb::splat(0.2 + 0.01 * x + 0.02 * y);
            let nodes = (0..columns * rows).map(|k| {
                let at = |k: usize| (k * step + step / 2) as f32;
                Some(Node { mesh: 0, radiance: light(at(k % columns), at(k / columns)) })
            });
            let map =
                AlbedoMap { step, columns, nodes: nodes.collect(), means: vec![Rgb::splat(0.5)] };
            for (x, y) in [(step, step), (2 * step + 1, 3 * step), (4 * step + 2, 2 * step + 1)] {
                let pixel = Vec2::new(x as f32, y as f32);
                let radiance = light(pixel.x, pixel.y);
                let found = map.albedo(texture(x, y) * radiance, pixel, 0);
                // The weights have a floor of 1e-3: the tolerance is its worst effect here.
                let off = (found - texture(x, y)).abs().max_element();
                assert!(off < 2e-4, "step {step}: {found} at {x}, {y}, off by {off}");
            }
        }
    }
}
