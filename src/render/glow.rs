//! Objects that shine: points drawn on their triangles, so that their light is not found by chance.
//!
//! A triangle is drawn in proportion to its area times its brightness, a point on it evenly. As a
//! density per steradian that is p = b / Σ b A · r² / |cos θ|, to be weighed against the techniques
//! that meet the triangle by direction. The brightness b of a textured triangle is an estimate, never
//! below a share of the brightest it can be: p > 0 wherever something shines.

use glam::{DVec2, Vec3};

use super::sampler::{Purpose, Sampler};
use super::surface::Surface;
use super::world::World;
use crate::conventions::Rgb;
use crate::light::table::GridTable;
use crate::scene::{Material, Mesh, Place, Scene};
use crate::trace::{Hit, Ray};

/// Share of the material's factor that a triangle whose texture looked dark is still drawn for.
const LEAST_BRIGHTNESS: f32 = 0.05;
/// A ray toward a shining point ends before it, by this share: it must not be blocked by itself.
const BEFORE: f32 = 1.0 - 1e-4;

/// The shining triangles of a scene's objects. The default is none.
#[derive(Default)]
pub struct Glow {
    table: Option<GridTable>,
    /// Mesh and triangle of each column of the table.
    drawn: Vec<[u32; 2]>,
    /// By mesh and triangle; empty for meshes that do not shine.
    brightness: Vec<Vec<f32>>,
    /// Σ brightness · area
    power: f64,
}

/// A point of a shining triangle as seen from a place.
pub struct GlowPoint {
    /// Unit, from the place.
    pub direction: Vec3,
    /// The point as a ray along `direction` meets it.
    pub hit: Hit,
    /// Density per steradian.
    pub pdf: f32,
}

impl Glow {
    pub fn new(scene: &Scene) -> Self {
        let mut drawn = Vec::new();
        let mut weights = Vec::new();
        let mut brightness = Vec::new();
        for (index, mesh) in scene.objects.iter().enumerate() {
            let material = &scene.materials[mesh.material];
            if material.emissive.max_element() <= 0.0 {
                brightness.push(Vec::new());
                continue;
            }
            let by_triangle: Vec<f32> = (0..mesh.triangles.len())
                .map(|triangle| estimate(scene, index as u32, triangle as u32, material))
                .collect();
            for (triangle, b) in by_triangle.iter().enumerate() {
                drawn.push([index as u32, triangle as u32]);
                weights.push(f64::from(*b) * f64::from(area(mesh, triangle)));
            }
            brightness.push(by_triangle);
        }
        let table = GridTable::new(weights.len(), &weights);
        Self { table, drawn, brightness, power: weights.iter().sum() }
    }

    /// True if nothing shines.
    pub fn is_dark(&self) -> bool {
        self.table.is_none()
    }

    /// A shining point as seen from a place; `None` where nothing shines or the triangle drawn is seen
    /// edge on. `u` in [0, 1)².
    pub fn sample(&self, scene: &Scene, from: Vec3, u: DVec2) -> Option<GlowPoint> {
        let cell = self.table.as_ref()?.draw(u);
        let [index, triangle] = self.drawn[cell.column];
        // Even over the triangle (Turk 1990)
        let root = cell.inside.x.sqrt();
        let (u, v) = ((root * (1.0 - cell.inside.y)) as f32, (root * cell.inside.y) as f32);
        let [a, b, c] = scene.objects[index as usize].corners(triangle as usize);
        let offset = a + u * (b - a) + v * (c - a) - from;
        let t = offset.length();
        let direction = offset / t;
        let hit = Hit { t, mesh: index, triangle, u, v };
        let pdf = self.pdf(scene, direction, &hit);
        (direction.is_finite() && pdf > 0.0 && pdf.is_finite()).then_some(GlowPoint {
            direction,
            hit,
            pdf,
        })
    }

    /// Density per steradian with which [`sample`](Self::sample) draws what a ray of unit `direction`
    /// has met.
    pub fn pdf(&self, scene: &Scene, direction: Vec3, hit: &Hit) -> f32 {
        // Instances have no list: what shines is never one.
        let by_triangle = self.brightness.get(hit.mesh as usize);
        let brightness = by_triangle.and_then(|all| all.get(hit.triangle as usize));
        let Some(brightness) = brightness else { return 0.0 };
        let [a, b, c] = scene.objects[hit.mesh as usize].corners(hit.triangle as usize);
        let cosine = (b - a).cross(c - a).normalize_or_zero().dot(direction).abs();
        if cosine < 1e-6 {
            return 0.0;
        }
        (f64::from(*brightness) / self.power) as f32 * hit.t * hit.t / cosine
    }
}

impl World<'_> {
    /// f · L · cos / p of one draw on what shines, visible past everything of both kinds.
    ///
    /// `others` gives the density with which other techniques meet a direction, from the BSDF's and the
    /// direction: the weight is the balance heuristic's over all of them.
    pub fn lit_by_glow(
        &self,
        surface: &Surface,
        sampler: &Sampler,
        others: impl Fn(f32, Vec3) -> f32,
    ) -> Rgb {
        if self.glow.is_dark() {
            return Rgb::ZERO;
        }
        let u = sampler.pair(Purpose::Glow);
        let Some(GlowPoint { direction, hit, pdf }) =
            self.glow.sample(self.scene, surface.position, u)
        else {
            return Rgb::ZERO;
        };
        let (value, bsdf_pdf) = surface.evaluate(direction);
        if value == Rgb::ZERO {
            return Rgb::ZERO;
        }
        let ray = Ray { t_max: hit.t * BEFORE, ..surface.leave(direction) };
        let point = self.object_point(&ray, &hit, false);
        let there = self.scene.alpha(Place::Object, hit.mesh, hit.triangle, hit.u, hit.v);
        let on_the_way = point.inside.map_or(Rgb::ONE, |per_metre| per_metre.powf(hit.t));
        let sent = point.emitted * on_the_way * there;
        if sent == Rgb::ZERO || self.object_occluded(&ray, sampler) {
            return Rgb::ZERO;
        }
        if !self.flat && self.local_occluded(&ray, sampler) {
            return Rgb::ZERO;
        }
        value * sent / (pdf + others(bsdf_pdf, direction))
    }

    /// Weight of light that shines from where a ray met an object, if other techniques drew the ray's
    /// direction with density `found`: the other half of [`lit_by_glow`](Self::lit_by_glow).
    pub fn weight_of_met_glow(&self, ray: &Ray, hit: &Hit, found: f32) -> f32 {
        if self.glow.is_dark() || !found.is_finite() {
            return 1.0;
        }
        found / (found + self.glow.pdf(self.scene, ray.direction, hit))
    }
}

fn area(mesh: &Mesh, triangle: usize) -> f32 {
    let [a, b, c] = mesh.corners(triangle);
    0.5 * (b - a).cross(c - a).length()
}

/// What a triangle sends out, in its brightest channel, at the mean of four of its points.
fn estimate(scene: &Scene, mesh: u32, triangle: u32, material: &Material) -> f32 {
    let most = material.emissive.max_element();
    if material.emissive_texture.is_none() {
        return most;
    }
    let points = [(1.0 / 3.0, 1.0 / 3.0), (0.1, 0.1), (0.8, 0.1), (0.1, 0.8)];
    let sum: f32 = points
        .iter()
        .map(|&(u, v)| {
            let at = scene.surface(Place::Object, mesh, triangle, u, v);
            at.parameters.emissive.max_element()
        })
        .sum();
    (0.25 * sum).max(LEAST_BRIGHTNESS * most)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::photo::Image;
    use crate::render::Numbers;
    use crate::render::coupled::Arrival;
    use crate::render::coupled::Want;
    use crate::render::test_scenes::*;
    use crate::scene::AlbedoSource;

    fn lamp(emissive: f32) -> Material {
        Material { emissive: Rgb::splat(emissive), double_sided: true, ..matt(0.0) }
    }

    /// Solid angle of a triangle seen from the origin (van Oosterom & Strackee 1983).
    fn solid_angle(corners: [Vec3; 3]) -> f64 {
        let [a, b, c] = corners.map(|p| p.as_dvec3().normalize());
        let below = 1.0 + a.dot(b) + b.dot(c) + c.dot(a);
        2.0 * a.dot(b.cross(c)).abs().atan2(below)
    }

    /// Every quarter of every triangle gets draws by its area and brightness (χ² at p = 0.001, one
    /// comparison), and the mean of 1 / p over them is its solid angle (4σ each).
    #[test]
    fn draws_follow_the_density() {
        let small = rectangle(Vec3::new(0.5, 1.0, 0.0), Vec3::X * 0.3, Vec3::Z * 0.2);
        let mut large = rectangle(Vec3::new(-1.0, 0.5, -1.0), Vec3::Y, Vec3::Z * 2.0);
        large.material = 1;
        let mut dark = rectangle(Vec3::NEG_Y, Vec3::X, Vec3::Z);
        dark.material = 2;
        let scene = Scene {
            objects: vec![small, dark, large],
            materials: vec![lamp(20.0), lamp(1.0), matt(0.5)],
            ..Scene::default()
        };
        let glow = Glow::new(&scene);
        const N: u32 = 200_000;
        let mut found: Vec<(usize, f64, f64)> = vec![(0, 0.0, 0.0); 3 * 2 * 4];
        for i in 0..N {
            let s = Sampler::new(7, (0, 0), 0, i, Numbers::Independent);
            let point = glow.sample(&scene, Vec3::ZERO, s.pair(Purpose::Glow)).unwrap();
            let Hit { u, v, .. } = point.hit;
            let quarter = match (u > 0.5, v > 0.5, u + v < 0.5) {
                (true, ..) => 1,
                (_, true, _) => 2,
                (.., true) => 0,
                _ => 3,
            };
            assert_eq!(point.pdf, glow.pdf(&scene, point.direction, &point.hit));
            let bin = (point.hit.mesh * 8 + point.hit.triangle * 4) as usize + quarter;
            let inverse = f64::from(1.0 / point.pdf);
            let (count, sum, squares) = found[bin];
            found[bin] = (count + 1, sum + inverse, squares + inverse * inverse);
        }
        let mut chi = 0.0;
        for (mesh, power) in [(0, 20.0 * 0.06), (2, 2.0)] {
            for triangle in 0..2_usize {
                let [a, b, c] = scene.objects[mesh].corners(triangle);
                let [ab, bc, ca] = [(a, b), (b, c), (c, a)].map(|(p, q)| 0.5 * (p + q));
                let quarters = [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]];
                for (k, quarter) in quarters.into_iter().enumerate() {
                    let (count, sum, squares) = found[mesh * 8 + triangle * 4 + k];
                    let expected = f64::from(N) * power / 8.0 / (20.0 * 0.06 + 2.0);
                    chi += (count as f64 - expected).powi(2) / expected;
                    let n = f64::from(N);
                    let mean = sum / n;
                    let sigma = ((squares / n - mean * mean) / n).sqrt();
                    let wanted = solid_angle(quarter);
                    assert!((mean - wanted).abs() < 4.0 * sigma, "{mean} ± {sigma} for {wanted}");
                }
            }
        }
        assert!(found[8..16].iter().all(|bin| bin.0 == 0), "what does not shine is not drawn");
        // 15 degrees of freedom
        assert!(chi < 37.7, "chi-square {chi}");
    }

    #[test]
    fn nothing_that_shines_is_no_draw() {
        let card = rectangle(Vec3::Y, Vec3::X, Vec3::Z);
        let glow = Glow::new(&scene(vec![card], matt(0.5), Vec::new()));
        assert!(
            glow.is_dark() && glow.sample(&Scene::default(), Vec3::ZERO, DVec2::ZERO).is_none()
        );
    }

    /// Mean and variance of `n` looks from the ground below a lamp, and of as many radiances of a matt
    /// ball beside it.
    fn looks(world: &World, n: u32) -> [(f64, f64); 2] {
        let down = Ray::new(Vec3::new(0.15, 0.2, 0.3), Vec3::NEG_Y);
        let at = Ray::new(Vec3::new(0.0, 0.3, 3.0), Vec3::NEG_Z);
        let ground = world.local_point(&down, &world.local.closest(&down).unwrap());
        let ball = world.objects.closest(&at).unwrap();
        let measure = |of: &dyn Fn(Sampler) -> f32| {
            let (mut sum, mut squares) = (0.0, 0.0);
            for i in 0..n {
                let value = of(Sampler::new(5, (1, 1), 0, i, Numbers::Independent));
                sum += f64::from(value);
                squares += f64::from(value).powi(2);
            }
            let mean = sum / f64::from(n);
            (mean, squares / f64::from(n) - mean * mean)
        };
        [
            measure(&|s| world.look(&ground, Want::Difference, 1.0, s, 0).delta.x),
            measure(&|s| world.object_radiance(&at, &ball, Arrival::SEEN, s, 0).x),
        ]
    }

    /// The same light with and without draws on a bulb, and the noise of as many samples.
    #[test]
    fn a_small_lamp_is_found_by_more_than_chance() {
        let mut bulb = sphere(Vec3::new(0.3, 0.5, 0.6), 0.03, 2);
        bulb.material = 1;
        let scene = Scene {
            objects: vec![sphere(Vec3::new(0.0, 0.3, 0.0), 0.3, 3), bulb],
            local: vec![local(ground(5.0), AlbedoSource::Constant(Rgb::splat(0.5)))],
            materials: vec![matt(0.6), lamp(200.0)],
            ..Scene::default()
        };
        let (camera, plate) = (corner_camera(4, 4, 5.0), Image::filled(4, 4, Rgb::ONE));
        let lights = uniform_sky(0.1);
        let mut world = World::new(&scene, &lights, &camera, &plate);
        let after = looks(&world, 40_000);
        world.glow = Glow::default();
        let before = looks(&world, 400_000);
        for (what, least, (b, a)) in
            [("ground", 3.0, (before[0], after[0])), ("ball", 20.0, (before[1], after[1]))]
        {
            let sigma = (b.1 / 400_000.0 + a.1 / 40_000.0).sqrt();
            assert!((a.0 - b.0).abs() < 4.0 * sigma, "{what}: {} for {} ± {sigma}", a.0, b.0);
            assert!(b.1 > least * a.1, "{what}: variance {} and {}", b.1, a.1);
        }
    }
}
