//! How much the objects can change at most, before anything is sampled.
//!
//! Methods-render R3.1: with all objects inside caps as seen from a point, what they block is at most
//! the lights' flux inside the caps, and what they send is at most their largest radiance times the
//! caps' projected solid angle; one can only replace the other, so |ΔE| is at most the larger of the
//! two. A block of pixels is judged by the caps as seen from all of its points at once. Local things
//! that rise out of the block's own plane pass on what the objects change there, and are added.

use std::f32::consts::{FRAC_1_PI, PI};

use glam::Vec3;

use super::guides::{Block, Footprint, Seen, Shape, View};
use super::primary::Primary;
use super::sources::Sources;
use super::world::{PartBall, World, is_flat};
use crate::conventions::Rgb;
use crate::light::parts::{Part, parts};
use crate::scene::{Clearcoat, Material, Mesh};
use crate::trace::Accel;

/// Balls that bound one local mesh.
const RISER_PARTS: usize = 8;
/// Where the light without objects comes from a grid of noisy nodes, it is taken for this share.
const SURE_SHARE: f32 = 0.7;
/// Objects smoother than this may gather light in one direction.
const SMOOTH: f32 = 0.5;

/// A part of a local mesh and the most that the objects can change there, as radiance.
struct Riser {
    mesh: usize,
    /// The mesh lies in a plane: points on it do not see it.
    flat: bool,
    ball: PartBall,
    change: Rgb,
}

/// Bounds of the objects' influence on a scene.
pub struct Influence<'w> {
    shapes: Vec<Shape>,
    parts: &'w [PartBall],
    /// Around all objects; tighter than the parts' sum where they are few and far.
    whole: PartBall,
    sources: Sources,
    /// Largest mean radiance that objects send on.
    sent: Rgb,
    risers: Vec<Riser>,
    /// Share of the light without objects that is there for sure.
    sure_share: f32,
    /// Smooth objects under a sun or lamp: a flat or hollow mirror can gather more light than `sent`.
    pub may_focus: bool,
}

/// What is known of a block of pixels before its first sample.
pub struct Judgement {
    /// As of [`Influence::bound`]; +∞ too where an object may be seen.
    pub bound: f32,
    /// It shows one matt local mesh and no object.
    pub plain: bool,
    /// What its pixel centres meet, if they were looked at.
    pub seen: Option<Vec<Seen>>,
}

/// A cap of directions.
pub(super) struct Cap {
    pub axis: Vec3,
    pub half_angle: f32,
}

impl<'w> Influence<'w> {
    pub fn new(world: &'w World) -> Self {
        let sources = Sources::new(world);
        let whole = whole(world);
        // Elsewhere E₀ comes from a grid of noisy nodes.
        let exact = world.flat && world.lights.proxy().is_none();
        let compact = !world.lights.suns.is_empty() || sources.has_lamps();
        let mut influence = Self {
            shapes: shapes(world),
            parts: &world.parts,
            sent: most_sent(world, &sources, &whole),
            whole,
            sources,
            risers: Vec::new(),
            sure_share: if exact { 1.0 } else { SURE_SHARE },
            may_focus: compact && has_smooth_objects(world),
        };
        if !world.flat {
            influence.risers = influence.find_risers();
        }
        influence
    }

    /// What is to be known of a block before its first sample: at a glance where that is enough.
    pub fn judge(&self, world: &World, primary: &Primary, block: &Block, enough: f32) -> Judgement {
        if primary.meets(block, self.parts, world.eye) {
            return Judgement { bound: f32::INFINITY, plain: false, seen: None };
        }
        if let Some(view) = View::glance(world, primary, &self.shapes, block) {
            let bound = self.bound(&view, enough);
            if bound <= enough {
                return Judgement { bound, plain: view.is_plain(), seen: None };
            }
        }
        let (view, seen) = View::new(world, primary, block);
        let bound = self.bound(&view, enough);
        Judgement { bound, plain: view.is_plain(), seen: Some(seen) }
    }

    /// The most that the objects can change in a block, relative to its light without objects, in
    /// the worst channel; +∞ where there is no bound. 0 is exact.
    ///
    /// A bound above `enough` is made tighter by looking at parts of the block, down to 4 × 4 pixels.
    pub fn bound(&self, view: &View, enough: f32) -> f32 {
        if view.object { f32::INFINITY } else { self.bound_of(view, view.block, enough) }
    }

    fn bound_of(&self, view: &View, part: Block, enough: f32) -> f32 {
        const SMALLEST: usize = 4;
        let Some(footprint) = view.footprint(part) else { return 0.0 };
        let bound = self.bound_of_footprint(&footprint);
        if bound <= enough || part.width.max(part.height) <= SMALLEST || !view.has_parts() {
            return bound;
        }
        let mut worst: f32 = 0.0;
        for quarter in part.quarters() {
            worst = worst.max(self.bound_of(view, quarter, enough));
            if worst.is_infinite() {
                break;
            }
        }
        worst.min(bound)
    }

    fn bound_of_footprint(&self, footprint: &Footprint) -> f32 {
        let Footprint { ball, normal, spread, .. } = footprint;
        let Some(mut change) = self.change(ball, *normal, *spread) else { return f32::INFINITY };
        for riser in &self.risers {
            if riser.flat && footprint.meshes == [riser.mesh] {
                continue;
            }
            let Some(cap) = cap(&riser.ball, ball) else { return f32::INFINITY };
            let share = cap.projected(*normal, *spread);
            if share > 0.0 {
                change += riser.change * share;
            }
        }
        if change == Rgb::ZERO {
            return 0.0;
        }
        match footprint.without {
            Some(without) if !footprint.own_material => {
                // A channel without light says nothing of what an eye would see.
                let without = without.max(Vec3::splat(0.05 * without.max_element()));
                let relative = (change / (self.sure_share * without)).max_element();
                if relative.is_finite() { relative } else { f32::INFINITY }
            }
            _ => f32::INFINITY,
        }
    }

    /// |ΔE|/π over a surface within `ball` whose normals lie within `spread` of `normal`; `None` if
    /// an object or a lamp may touch the ball.
    fn change(&self, ball: &PartBall, normal: Vec3, spread: f32) -> Option<Rgb> {
        let caps: Vec<Cap> =
            self.parts.iter().map(|part| cap(part, ball)).collect::<Option<_>>()?;
        let caps: Vec<Cap> =
            caps.into_iter().filter(|cap| cap.largest_cosine(normal, spread) > 0.0).collect();
        if caps.is_empty() {
            return Some(Rgb::ZERO);
        }
        let edges: Vec<(f32, f32)> = caps.iter().map(|cap| cap.half_angle.sin_cos()).collect();
        let sum: f32 = caps.iter().map(|cap| cap.projected(normal, spread)).sum();
        let whole = cap(&self.whole, ball).map_or(1.0, |cap| cap.projected(normal, spread));
        let share = sum.min(whole);
        let (mut of_suns, mut of_cells, mut brightest) = (Rgb::ZERO, Rgb::ZERO, Rgb::ZERO);
        // What is nearer than every object hides behind none of them
        let nearest = self
            .parts
            .iter()
            .map(|part| part.centre.distance(ball.centre) - part.radius - ball.radius);
        let lamps = self.sources.lamps_behind(ball, nearest.fold(f32::INFINITY, f32::min))?;
        for source in self.sources.seen_from(ball).chain(lamps) {
            let reached = caps.iter().zip(&edges).any(|(cap, (sin, cos))| {
                cap.half_angle + source.radius >= PI
                    || source.direction.dot(cap.axis) >= cos * source.cos - sin * source.sin
            });
            if reached {
                let cosine = largest_cosine(normal, source.direction, source.radius + spread);
                let reached = source.flux * (cosine * FRAC_1_PI);
                match source.brightest {
                    Some(radiance) => {
                        of_cells += reached;
                        brightest = brightest.max(radiance);
                    }
                    None => of_suns += reached,
                }
            }
        }
        // Cells are wider than the caps of small or far objects.
        let blocked = of_suns + of_cells.min(brightest * share);
        Some(blocked.max(self.sent * share))
    }

    fn find_risers(&self) -> Vec<Riser> {
        let mut risers = Vec::new();
        for (mesh, Shape { boxes, flat }) in self.shapes.iter().enumerate() {
            for bounds in boxes {
                let ball = PartBall { centre: bounds.centre(), radius: bounds.radius() };
                // Beside the objects everything may be blocked, and as much be sent.
                let change = self
                    .change(&ball, Vec3::Y, PI)
                    .unwrap_or_else(|| self.sent.max(self.sources.flux(&ball) * FRAC_1_PI));
                risers.push(Riser { mesh, flat: *flat, ball, change });
            }
        }
        risers
    }
}

impl Cap {
    fn largest_cosine(&self, normal: Vec3, spread: f32) -> f32 {
        largest_cosine(normal, self.axis, self.half_angle + spread)
    }

    /// Bound of the cap's projected solid angle over π.
    fn projected(&self, normal: Vec3, spread: f32) -> f32 {
        // 2 (1 − cos) without its cancellation
        let solid_angle_over_pi = 4.0 * (0.5 * self.half_angle).sin().powi(2);
        (solid_angle_over_pi * self.largest_cosine(normal, spread)).min(1.0)
    }
}

/// Boxes around every local mesh.
pub(super) fn shapes(world: &World) -> Vec<Shape> {
    let of = |mesh: &Mesh| match is_flat(&[mesh]) {
        // Its own box hides what a block shows beside it as well as many would.
        true if world.flat => Shape { boxes: vec![mesh.bounds()], flat: true },
        flat => Shape { boxes: Accel::build(&[mesh]).parts(RISER_PARTS), flat },
    };
    world.scene.local.iter().map(|local| of(&local.mesh)).collect()
}

/// A ball around the objects' vertices.
fn whole(world: &World) -> PartBall {
    let centre = world.objects.bounds().centre();
    let vertices = world.scene.all_objects().flat_map(|placed| placed.positions());
    let radius = vertices.map(|v| v.distance(centre)).fold(0.0, f32::max);
    PartBall { centre, radius: radius * (1.0 + 1e-5) }
}

/// Directions from anywhere in `from` to anywhere in `to`; `None` if the balls touch.
pub(super) fn cap(to: &PartBall, from: &PartBall) -> Option<Cap> {
    let offset = to.centre - from.centre;
    let (distance, reach) = (offset.length(), to.radius + from.radius);
    // 1e-4: rounding of f32 far from the scene's origin.
    (distance > reach * 1.0001)
        .then(|| Cap { axis: offset / distance, half_angle: (reach / distance).asin() })
}

/// Largest max(0, cos) between `normal` and directions within `radius` of `direction`.
fn largest_cosine(normal: Vec3, direction: Vec3, radius: f32) -> f32 {
    (normal.angle_between(direction) - radius).max(0.0).cos().max(0.0)
}

/// Bound of the mean radiance that the objects send on, between all lights and the ground.
///
/// Convex mirrors spread what they get as thinly as matt surfaces do; see [`Influence::may_focus`].
fn most_sent(world: &World, sources: &Sources, objects: &PartBall) -> Rgb {
    /// Between neighbours of the 26 normals tried, and by the map's coarseness, irradiance rises by
    /// less than this.
    const BETWEEN_NORMALS: f32 = 1.15;
    // Light is moved by a degree at most.
    let parts = match world.lights.proxy() {
        Some(_) => Vec::new(),
        None => parts(&world.lights.environment, 256, 128),
    };
    let on = |normal: Vec3| {
        if world.lights.proxy().is_some() {
            sources.near_irradiance(objects, normal)
        } else {
            let light = |part: &Part| part.flux * normal.dot(part.direction).max(0.0);
            parts.iter().map(light).sum::<Rgb>() + sources.lamp_irradiance(objects)
        }
    };
    let mut irradiance = Rgb::ZERO;
    for x in -1..=1 {
        for y in -1..=1 {
            for z in -1..=1 {
                if let Some(normal) = Vec3::new(x as f32, y as f32, z as f32).try_normalize() {
                    irradiance = irradiance.max(on(normal) * BETWEEN_NORMALS);
                }
            }
        }
    }
    irradiance += world.lights.suns.iter().map(|s| s.irradiance(s.direction)).sum::<Rgb>();
    // R3.1: a/(1 − aρF)·(E + ρ E_up)/π with a form factor F of at most a half.
    let object = object_materials(world).map(brightest).fold(0.0, f32::max);
    let ground = (0..world.scene.local.len())
        .map(|mesh| 1.2 * world.albedo.mean(mesh).max_element())
        .fold(0.0, f32::max)
        .min(super::albedo::LARGEST_BOUNCE);
    let in_turn = object * (1.0 + ground) / (1.0 - 0.5 * object * ground);
    let emission = object_materials(world).map(|m| m.emissive).fold(Rgb::ZERO, Rgb::max);
    irradiance * FRAC_1_PI * in_turn + emission
}

fn object_materials<'a>(world: &'a World) -> impl Iterator<Item = &'a Material> {
    world.scene.objects.iter().filter_map(|mesh| world.scene.materials.get(mesh.material))
}

/// Largest albedo of a material in any direction.
fn brightest(material: &Material) -> f32 {
    if material.metallic > 0.0 || material.transmission > 0.0 || is_smooth(material) {
        return 1.0;
    }
    // A rough dielectric's gloss adds a little to its colour, a coat no more; sheen its own.
    let sheen = material.sheen.as_ref().map_or(0.0, |sheen| sheen.colour.max_element());
    (material.base_colour.truncate().max_element() + 0.1 + sheen).min(1.0)
}

fn is_smooth(material: &Material) -> bool {
    let coat = |coat: &Clearcoat| coat.roughness < SMOOTH || coat.roughness_texture.is_some();
    material.roughness < SMOOTH
        || material.metallic_roughness_texture.is_some()
        || material.clearcoat.as_ref().is_some_and(coat)
}

fn has_smooth_objects(world: &World) -> bool {
    object_materials(world).any(is_smooth)
}
