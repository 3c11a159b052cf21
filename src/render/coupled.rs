//! THE estimator: one path, two worlds.
//!
//! At a local point x (methods-render R2.1) D(x) = ∫ f cosθ ΔL dω, where along ω
//! - an object is first: ΔL = L_with(object) − L_without(what is behind it),
//! - something local at z is first: ΔL = D(z),
//! - nothing is met: ΔL = 0.
//!
//! Each look takes one draw from every stratum of the lights, for the blocked light only (any-hit
//! rays), and one draw from a mixture of the BSDF and cones toward the objects, which also finds what
//! objects reflect and what local surfaces pass on. Blocked light is weighted by the balance heuristic
//! over all of them, the rest by the mixture's own density. Under soft light, what the camera's own
//! local points lose is drawn from cells of the light instead (`blocked`). Nothing is added where no
//! object is touched: D is exactly zero there.
//! The same draws estimate the light without objects, L_without, as the ratio D / L_without needs it;
//! where the plain horizon irradiance is known exactly and nearly right it serves as control variate.
//! What objects shine themselves is drawn on their triangles too (`glow`).
//! Lamps stand on the rays, before what ends them: each is weighed on its own, by its own draws and the
//! mixture, and is blocked by what is nearer than it.

use glam::Vec3;

use super::Context;
use super::albedo::AlbedoMap;
use super::bsdf::{EVEN_PDF, sample_even};
use super::cones::Cones;
use super::film::{Pair, Sample};
use super::primary::Primary;
use super::sampler::{Purpose, Sampler, below_one, to_f32};
use super::surface::{Colouring, LocalPoint, Surface};
use super::technique::WIDE_PDF;
use super::waves::Estimator;
use super::world::World;
use crate::conventions::Rgb;
use crate::trace::{Hit, Ray};

/// Longest path, in edges after the camera's.
pub const MAX_DEPTH: u32 = 8;
/// From this depth on paths end by chance.
const ROULETTE_DEPTH: u32 = 2;
/// As [`ROULETTE_DEPTH`], for looking on from local points that objects or local points see.
const LOOK_ROULETTE_DEPTH: u32 = 1;
/// Share of draws toward the objects where nothing local can be met, and where it can.
const CONE_SHARE_FLAT: f32 = 0.9;
const CONE_SHARE: f32 = 0.5;

/// See [`World::look_of_camera`].
const WITHOUT_EVERY: f32 = 4.0;

/// How a path came to an object.
#[derive(Clone, Copy, Debug)]
pub struct Arrival {
    /// Density that the ray's direction was drawn with; +∞ if nothing else could have found it.
    pub found: f32,
    /// As of [`World::object_point`].
    pub after_wide: bool,
}

impl Arrival {
    /// The camera sees it.
    pub const SEEN: Self = Self { found: f32::INFINITY, after_wide: false };
}

/// What is asked of a look.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Want {
    /// D alone.
    Difference,
    /// L_without alone: no object is looked for.
    Without,
    /// Both; with the unoccluded value of L_without if it shall be the control variate.
    Both(Option<Rgb>),
}

impl Want {
    fn difference(self) -> bool {
        self != Self::Without
    }

    fn without(self) -> bool {
        self != Self::Difference
    }

    fn control(self) -> Option<Rgb> {
        if let Self::Both(control) = self { control } else { None }
    }
}

/// The coupled estimator for camera samples.
pub struct Coupled<'a> {
    pub world: World<'a>,
    pub primary: Primary,
}

impl Estimator for Coupled<'_> {
    fn world(&self) -> &World<'_> {
        &self.world
    }

    fn primary(&self) -> &Primary {
        &self.primary
    }

    fn solve_albedo(&mut self, context: &Context) {
        AlbedoMap::solve(&mut self.world, &self.primary, context);
    }

    fn sample(&self, x: usize, y: usize, sampler: Sampler) -> Sample {
        let jitter = sampler.pair(Purpose::Pixel);
        let Some(ray) = self.primary.ray(x, y, to_f32(jitter.x), to_f32(jitter.y)) else {
            return Sample::default();
        };
        let step = self.world.camera_step(&ray, &sampler);
        if let Some(hit) = step.object {
            let radiance =
                self.world.object_radiance(&ray, &hit, Arrival::SEEN, sampler.descend(0), 0);
            return Sample { coverage: 1.0, object: radiance, ..Sample::default() };
        }
        let Some(hit) = step.local else { return Sample::default() };
        let point = self.world.local_point(&ray, &hit);
        let control = self.world.control_for(&point, x, y);
        let pair = self.world.look_of_camera(&point, control, sampler);
        Sample::background(point.colour, self.world.albedo.mean(point.mesh), pair)
    }
}

impl World<'_> {
    /// The unoccluded L_without of a point, if it is a good control variate in pixel (x, y).
    fn control_for(&self, point: &LocalPoint, x: usize, y: usize) -> Option<Rgb> {
        if point.colour == Colouring::Own {
            return None;
        }
        let surface = &point.surface;
        let exact = self.skylight.radiance(surface.position, surface.geometric)?;
        if self.flat {
            return Some(exact);
        }
        // In a real shadow most of the unoccluded light is blocked: there the difference of two
        // large numbers would be noisier than the light itself.
        let pixel = glam::Vec2::new(x as f32, y as f32);
        let known = self.albedo.irradiance(pixel, point.mesh)?;
        (known.element_sum() > 0.6 * exact.element_sum()).then_some(exact)
    }

    /// The look from a local point that the camera sees.
    ///
    /// Where a control variate holds nearly all of L_without, and its draws do not serve the blocked
    /// light as well, what is left of it is asked for in every [`WITHOUT_EVERY`]th sample only.
    fn look_of_camera(&self, point: &LocalPoint, control: Option<Rgb>, sampler: Sampler) -> Pair {
        let onward = sampler.descend(0);
        let (Some(control), true) = (control, self.by_cells && !self.flat) else {
            return self.look(point, Want::Both(control), 1.0, onward, 0);
        };
        if sampler.one(Purpose::Choice) * WITHOUT_EVERY >= 1.0 {
            let pair = self.look(point, Want::Difference, 1.0, onward, 0);
            return Pair { without: control, ..pair };
        }
        let pair = self.look(point, Want::Both(Some(control)), 1.0, onward, 0);
        Pair { without: control + (pair.without - control) * WITHOUT_EVERY, ..pair }
    }

    /// One look from a local point: D and L_without for its BSDF (white Lambert unless `Own`).
    ///
    /// `power` is how much of its light counts in the pixel; it steers roulette, not the mean.
    pub fn look(
        &self,
        point: &LocalPoint,
        want: Want,
        power: f32,
        sampler: Sampler,
        depth: u32,
    ) -> Pair {
        let surface = &point.surface;
        let mut pair = Pair { without: want.control().unwrap_or(Rgb::ZERO), ..Pair::default() };
        let share = match (self.technique.cones, self.flat) {
            (false, _) => 0.0,
            (true, true) => CONE_SHARE_FLAT,
            (true, false) => CONE_SHARE,
        };
        let cones = if want.difference() {
            Cones::new(&self.parts, surface.position, surface.geometric, share)
        } else {
            Cones::none()
        };
        let exact = self.flat && (want.control().is_some() || !want.without());
        if exact && !cones.any_above() {
            return pair;
        }
        let by_cells =
            self.by_cells && depth == 0 && want.difference() && point.colour != Colouring::Own;
        if by_cells {
            pair.delta -= self.blocked_light(surface, &cones, &sampler);
        }
        let evenly = self.technique.evenly && point.colour != Colouring::Own;
        let look = Look {
            world: self,
            surface,
            want,
            power,
            cones: &cones,
            exact,
            by_cells,
            evenly,
            depth,
        };
        for stratum in 0..self.lights.n_strata() {
            look.toward_light(stratum, &sampler, &mut pair);
        }
        if want.difference() && self.may_meet_objects(depth) {
            pair.delta += self.lit_by_glow(surface, &sampler, |pdf, d| look.mixture_pdf(pdf, d));
        }
        look.along_mixture(&sampler, &mut pair);
        pair
    }

    /// Radiance of both worlds leaving a local point toward where the ray came from.
    pub fn local_radiance(
        &self,
        point: &LocalPoint,
        want: Want,
        power: f32,
        sampler: Sampler,
        depth: u32,
    ) -> Pair {
        let albedo = |pixel: Option<glam::Vec2>| match (point.colour, pixel) {
            (Colouring::Own, _) => Rgb::ONE,
            (Colouring::Matt(albedo), _) => albedo,
            (Colouring::Plate, Some(p)) => self.albedo.albedo(self.plate_at(p), p, point.mesh),
            (Colouring::Plate, None) => self.albedo.mean(point.mesh),
        };
        // A mirror in the real scene looks different from here than from the camera.
        let seen = if point.colour == Colouring::Own {
            None
        } else {
            self.pixel_of(&point.surface, &sampler)
        };
        let albedo = albedo(seen);
        let mut known = Pair::default();
        let mut still = want;
        if let Some(pixel) = seen {
            known.without = self.plate_at(pixel);
            still = Want::Difference;
            if !want.difference() {
                return known;
            }
        }
        if depth >= self.technique.max_depth {
            return known;
        }
        let survival = if depth < LOOK_ROULETTE_DEPTH {
            1.0
        } else {
            (power * albedo.max_element() * 2.0).clamp(0.05, 1.0)
        };
        if sampler.one(Purpose::Roulette) >= survival {
            return known;
        }
        let power = power * albedo.max_element() / survival;
        let pair = self.look(point, still, power, sampler, depth);
        let scale = albedo / survival;
        Pair { delta: pair.delta * scale, without: known.without + pair.without * scale }
    }

    /// Whether the path may go on from a local point at `depth` to an object.
    fn may_meet_objects(&self, depth: u32) -> bool {
        depth < self.technique.max_depth && depth + 1 < self.technique.max_object_depth
    }

    /// Radiance in the world with objects that an object sends back along a ray.
    pub fn object_radiance(
        &self,
        ray: &Ray,
        hit: &Hit,
        arrival: Arrival,
        sampler: Sampler,
        depth: u32,
    ) -> Rgb {
        let mut ray = *ray;
        let mut hit = *hit;
        let Arrival { mut found, mut after_wide } = arrival;
        let mut sampler = sampler;
        let mut radiance = Rgb::ZERO;
        let mut throughput = Rgb::ONE;
        for depth in depth..self.technique.max_object_depth {
            let point = self.object_point(&ray, &hit, after_wide);
            if let Some(per_metre) = point.inside {
                throughput *= per_metre.powf(hit.t);
            }
            if point.emitted != Rgb::ZERO {
                let weight = self.weight_of_met_glow(&ray, &hit, found);
                radiance += throughput * point.emitted * weight;
            }
            let surface = &point.surface;
            for stratum in 0..self.lights.n_strata() {
                radiance += throughput * self.lit_with(surface, stratum, &sampler);
            }
            if depth + 1 < self.technique.max_object_depth {
                radiance += throughput * self.lit_by_glow(surface, &sampler, |pdf, _| pdf);
            }
            // Sample the BSDF and go on
            let u = sampler.pair(Purpose::Direction).as_vec2();
            let choice = sampler.one(Purpose::Choice);
            let Some(scattered) = surface.bsdf.sample(surface.wo, u, choice) else { break };
            let direction = surface.to_world(scattered.direction);
            if (scattered.direction.z > 0.0) != (surface.geometric.dot(direction) > 0.0) {
                break;
            }
            throughput *= scattered.weight;
            after_wide |= scattered.pdf < WIDE_PDF;
            if depth >= ROULETTE_DEPTH {
                let survival = throughput.max_element().clamp(0.05, 0.95);
                if sampler.one(Purpose::Roulette) >= survival {
                    break;
                }
                throughput /= survival;
            }
            sampler = sampler.descend(1);
            ray = surface.leave(direction);
            found = scattered.pdf;
            let step = self.step(&ray, &sampler);
            let end = step.first_distance();
            for lamp in self.lights.lamps_on(surface.position, direction) {
                if lamp.distance < end {
                    radiance += throughput * lamp.radiance * scattered.weight_against(lamp.pdf);
                }
            }
            if let Some(next) = step.object {
                hit = next;
                continue;
            }
            if let Some(local) = step.local {
                let z = self.local_point(&ray, &local);
                let power = throughput.max_element();
                let pair =
                    self.local_radiance(&z, Want::Both(None), power, sampler.descend(2), depth + 1);
                radiance += throughput * (pair.without + pair.delta);
            } else {
                let (l, pdf) = self.lights.evaluate(surface.position, direction);
                radiance += throughput * l * scattered.weight_against(pdf);
            }
            break;
        }
        radiance
    }

    /// Light of one stratum reflected by an object, visible past everything of both kinds.
    fn lit_with(&self, surface: &Surface, stratum: usize, sampler: &Sampler) -> Rgb {
        let u = sampler.pair(purpose_of(stratum));
        let Some(light) = self.lights.sample(stratum, surface.position, u) else {
            return Rgb::ZERO;
        };
        let (value, pdf) = surface.evaluate(light.direction);
        if value == Rgb::ZERO || light.radiance == Rgb::ZERO {
            return Rgb::ZERO;
        }
        let ray = surface.leave_for(&light);
        if self.object_occluded(&ray, sampler) || self.local_occluded(&ray, sampler) {
            return Rgb::ZERO;
        }
        value * light.radiance / (light.pdf + pdf)
    }
}

/// Which numbers a stratum of the lights is drawn by.
pub(super) fn purpose_of(stratum: usize) -> Purpose {
    match stratum {
        0 => Purpose::Environment,
        1 => Purpose::Sun,
        _ => Purpose::Lamp,
    }
}

/// One look from a local point, with what its draws share.
struct Look<'w> {
    world: &'w World<'w>,
    surface: &'w Surface,
    want: Want,
    power: f32,
    cones: &'w Cones,
    /// L_without is known without any draw, and nothing local can be met.
    exact: bool,
    /// Blocked far light is already known.
    by_cells: bool,
    /// Looks evenly over the hemisphere, not by the BSDF.
    evenly: bool,
    depth: u32,
}

impl Look<'_> {
    /// Light of one stratum: what objects block of it, and what reaches the point without them.
    fn toward_light(&self, stratum: usize, sampler: &Sampler, pair: &mut Pair) {
        let world = self.world;
        let u = sampler.pair(purpose_of(stratum));
        let Some(light) = world.lights.sample(stratum, self.surface.position, u) else { return };
        let known = self.by_cells && light.distance.is_infinite();
        let may_block = self.want.difference() && !known && self.cones.may_meet(light.direction);
        let ends_without_object = self.exact || !self.want.without();
        if !may_block && ends_without_object {
            return;
        }
        let (value, bsdf_pdf) = self.surface.evaluate(light.direction);
        if value == Rgb::ZERO || light.radiance == Rgb::ZERO {
            return;
        }
        let ray = self.surface.leave_for(&light);
        let blocked = may_block && world.object_occluded(&ray, sampler);
        if !blocked && ends_without_object {
            return;
        }
        let hidden = !world.flat && world.local_occluded(&ray, sampler);
        let mixture = self.mixture_pdf(bsdf_pdf, light.direction);
        let arriving = value * light.radiance / (light.pdf + mixture);
        if blocked && !hidden {
            pair.delta -= arriving;
        }
        self.add_without(pair, arriving, hidden);
    }

    /// One draw from BSDF and cones: blocked light, what objects send, what local surfaces pass on.
    fn along_mixture(&self, sampler: &Sampler, pair: &mut Pair) {
        let (world, surface) = (self.world, self.surface);
        let u = sampler.pair(Purpose::Direction).as_vec2();
        let choice = sampler.one(Purpose::Choice);
        let share = self.cones.share();
        let (direction, value, bsdf_pdf) = if choice < share {
            let Some(direction) = self.cones.sample(u, choice) else { return };
            let (value, bsdf_pdf) = surface.evaluate(direction);
            (direction, value, bsdf_pdf)
        } else if self.evenly {
            let direction = surface.to_world(sample_even(u));
            let (value, bsdf_pdf) = surface.evaluate(direction);
            (direction, value, bsdf_pdf)
        } else {
            let choice = below_one(((choice - share) / (1.0 - share)).max(0.0));
            let Some(drawn) = surface.bsdf.sample(surface.wo, u, choice) else { return };
            let direction = surface.to_world(drawn.direction);
            if drawn.pdf.is_finite() {
                let (value, bsdf_pdf) = surface.evaluate(direction);
                (direction, value, bsdf_pdf)
            } else {
                // A mirror direction: only the BSDF finds it.
                (direction, drawn.weight / (1.0 - share), f32::INFINITY)
            }
        };
        let mixture = self.mixture_pdf(bsdf_pdf, direction);
        if value == Rgb::ZERO || mixture <= 0.0 {
            return;
        }
        let by_mixture = if mixture.is_finite() { value / mixture } else { value };
        let by_all = |light_pdf: f32| {
            if mixture.is_finite() { value / (mixture + light_pdf) } else { value }
        };

        // Trace both worlds
        let ray = surface.leave(direction);
        let local = if world.flat { None } else { world.closest_local(&ray, sampler) };
        let object = if self.want.difference() {
            let t_max = local.map_or(f32::INFINITY, |hit| hit.t + world.coincident);
            world.closest_object(&Ray { t_max, ..ray }, sampler)
        } else {
            None
        };
        let next = sampler.descend(1);
        let power = self.power * by_mixture.max_element();

        // Lamps on the way
        for lamp in world.lights.lamps_on(surface.position, direction) {
            let before = |hit: Hit| hit.t < lamp.distance;
            let (blocked, hidden) = (object.is_some_and(before), local.is_some_and(before));
            let arriving = by_all(lamp.pdf) * lamp.radiance;
            if blocked && !hidden {
                pair.delta -= arriving;
            }
            self.add_without(pair, arriving, hidden);
        }

        // What the object sends, by roulette: it matters little where the direction matters little
        if let Some(hit) = object {
            let survival = if mixture.is_finite() { (4.0 * power).clamp(0.05, 1.0) } else { 1.0 };
            if self.depth < world.technique.max_depth && next.one(Purpose::Roulette) < survival {
                let arrival = Arrival { found: mixture, after_wide: bsdf_pdf < WIDE_PDF };
                let sent =
                    world.object_radiance(&ray, &hit, arrival, next.descend(3), self.depth + 1);
                pair.delta += by_mixture * sent / survival;
            }
        }
        // What is behind it, or there is no object
        match local {
            Some(hit) => {
                let z = world.local_point(&ray, &hit);
                let want = match (object.is_some(), self.want.without()) {
                    (true, _) => Want::Without,
                    (false, true) if self.want.difference() => Want::Both(None),
                    (false, true) => Want::Without,
                    (false, false) => Want::Difference,
                };
                let behind = world.local_radiance(&z, want, power, next.descend(4), self.depth + 1);
                if object.is_some() {
                    pair.delta -= by_mixture * behind.without;
                } else {
                    pair.delta += by_mixture * behind.delta;
                }
                if self.want.without() {
                    pair.without += by_mixture * behind.without;
                    if self.want.control().is_some() {
                        let (l, pdf) = world.lights.evaluate(surface.position, direction);
                        pair.without -= by_all(pdf) * l;
                    }
                }
            }
            None if object.is_some() || !self.exact => {
                let (l, pdf) = world.lights.evaluate(surface.position, direction);
                let arriving = by_all(pdf) * l;
                if object.is_some() && !self.by_cells {
                    pair.delta -= arriving;
                }
                self.add_without(pair, arriving, false);
            }
            None => {}
        }
    }

    /// Adds light that no surface sends to L_without; with a control variate only what is missing of it.
    fn add_without(&self, pair: &mut Pair, arriving: Rgb, hidden: bool) {
        if !self.want.without() {
            return;
        }
        match (self.want.control().is_some(), hidden) {
            (true, true) => pair.without -= arriving,
            (false, false) => pair.without += arriving,
            _ => {}
        }
    }

    fn mixture_pdf(&self, bsdf_pdf: f32, direction: Vec3) -> f32 {
        let own = if self.evenly { EVEN_PDF } else { bsdf_pdf };
        (1.0 - self.cones.share()) * own + self.cones.pdf(direction)
    }
}
