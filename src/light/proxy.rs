//! Where the light of a panorama really comes from: walls round the probe, a box or a mesh.
//!
//! A ray from x meets the walls at p; its radiance is what the panorama shows in the direction p − c,
//! c the probe's place (methods-render R10.3). A direction drawn from the panorama's table with density
//! p_c is turned to p as seen from x, where its density is
//! p_ω(x) = p_c |p−x|² cos_c / (|p−c|² cos_x), both cosines at the wall.
//! A place outside the box, and a ray that misses the mesh, see the panorama as from far away. What
//! stands in the room and is not modelled moves with the wall behind it: that parallax is lost.

use std::sync::Arc;

use glam::{DVec3, Vec3};

use crate::scene::Mesh;
use crate::trace::{Accel, Hit, Ray};

/// Walls round a probe. All places are relative to the scene's origin, metres.
#[derive(Clone, Debug)]
pub struct Proxy {
    centre: Vec3,
    shape: Shape,
}

#[derive(Clone, Debug)]
enum Shape {
    Box { min: Vec3, max: Vec3 },
    Mesh(Arc<Room>),
}

/// A mesh of walls.
#[derive(Debug)]
struct Room {
    meshes: Vec<Mesh>,
    accel: Accel,
    /// A ray from a wall does not meet that wall nearer than this.
    least: f32,
}

/// A direction as another place sees it.
#[derive(Clone, Copy, Debug)]
pub struct Turned {
    /// Unit, world axes.
    pub direction: Vec3,
    /// Density of directions at x over that at the probe; 0 where the probe did not see the wall.
    pub density: f32,
}

/// A wall seen under a smaller cosine than this is seen edge-on: nothing is drawn there.
const EDGE_ON: f32 = 1e-6;
/// A place this share of the box outside still counts as in it: a floor may be a wall of the box.
const ON_THE_WALL: f32 = 1e-4;

/// Rays that look for a mesh's nearest wall, 3° apart.
const UPWARD_RAYS: u32 = 2048;

impl Proxy {
    /// A box with walls along the axes; `None` if `centre` is not inside.
    pub fn of_box(centre: Vec3, min: Vec3, max: Vec3) -> Option<Self> {
        let inside = centre.cmpgt(min).all() && centre.cmplt(max).all();
        inside.then_some(Self { centre, shape: Shape::Box { min, max } })
    }

    /// Walls of any shape; `None` if the meshes hold no triangle.
    pub fn of_mesh(centre: Vec3, meshes: Vec<Mesh>) -> Option<Self> {
        let accel = Accel::build(&meshes.iter().collect::<Vec<_>>());
        if accel.is_empty() {
            return None;
        }
        let least = ON_THE_WALL * accel.bounds().diameter();
        Some(Self { centre, shape: Shape::Mesh(Arc::new(Room { meshes, accel, least })) })
    }

    /// Where the panorama was taken.
    pub fn centre(&self) -> Vec3 {
        self.centre
    }

    /// True if every place inside sees all walls: there the density is exact everywhere.
    pub fn is_convex(&self) -> bool {
        matches!(self.shape, Shape::Box { .. })
    }

    /// False if light is taken as distant at this place.
    pub fn holds(&self, place: Vec3) -> bool {
        match &self.shape {
            Shape::Box { min, max } => {
                let slack = (*max - *min) * ON_THE_WALL;
                place.cmpge(*min - slack).all() && place.cmple(*max + slack).all()
            }
            Shape::Mesh(_) => true,
        }
    }

    /// The panorama's direction that a ray from `from` along `direction` sees.
    pub fn seen(&self, from: Vec3, direction: Vec3) -> Turned {
        let distant = Turned { direction, density: 1.0 };
        match &self.shape {
            Shape::Box { .. } if !self.holds(from) => distant,
            Shape::Box { min, max } => {
                let (point, normal) = leave_box(*min, *max, from, direction);
                let to = point - self.centre;
                Turned {
                    direction: to.normalize_or(direction),
                    density: self.density(from, point, normal),
                }
            }
            Shape::Mesh(room) => match room.first(from, direction) {
                None if room.first(self.centre, direction).is_none() => distant,
                None => Turned { density: 0.0, ..distant },
                Some((point, normal)) => {
                    let to = point - self.centre;
                    let density = if room.between(self.centre, point) {
                        0.0
                    } else {
                        self.density(from, point, normal)
                    };
                    Turned { direction: to.normalize_or(direction), density }
                }
            },
        }
    }

    /// Where `from` sees what the probe sees in `direction`; `None` if it does not, or edge-on.
    pub fn toward(&self, from: Vec3, direction: Vec3) -> Option<Turned> {
        let (point, normal) = match &self.shape {
            Shape::Box { .. } if !self.holds(from) => {
                return Some(Turned { direction, density: 1.0 });
            }
            Shape::Box { min, max } => leave_box(*min, *max, self.centre, direction),
            Shape::Mesh(room) => match room.first(self.centre, direction) {
                Some(found) if !room.between(from, found.0) => found,
                Some(_) => return None,
                None => {
                    let misses = room.first(from, direction).is_none();
                    return misses.then_some(Turned { direction, density: 1.0 });
                }
            },
        };
        let density = self.density(from, point, normal);
        let direction = (point - from).try_normalize()?;
        (density > 0.0).then_some(Turned { direction, density })
    }

    /// |p−x|² cos_c / (|p−c|² cos_x), 0 edge-on.
    fn density(&self, from: Vec3, point: Vec3, normal: Vec3) -> f32 {
        let (to_c, to_x) = (point - self.centre, point - from);
        let (c2, x2) = (to_c.length_squared(), to_x.length_squared());
        // cos = |n·d| / |d|
        let (cos_c, cos_x) =
            (normal.dot(to_c).abs() / c2.sqrt(), normal.dot(to_x).abs() / x2.sqrt());
        let density = x2 * cos_c / (c2 * cos_x);
        if cos_x > EDGE_ON && density.is_finite() { density } else { 0.0 }
    }

    /// Distance from the probe to the nearest wall in an upward or level direction, metres: the floor
    /// is the support's business. `None` if nothing is met.
    pub fn nearest_wall(&self) -> Option<f32> {
        match &self.shape {
            Shape::Box { min, max } => {
                let (low, high) = (self.centre - *min, *max - self.centre);
                Some(
                    [low.x, low.z, high.x, high.y, high.z]
                        .into_iter()
                        .fold(f32::INFINITY, f32::min),
                )
            }
            Shape::Mesh(room) => self.upward(room).flatten().reduce(f32::min),
        }
    }

    /// Bounds for what the probe sees within `radius` of `direction`: the least distance to it, and the
    /// least distance to the plane of a wall there. 0 where nothing is known.
    pub fn nearest(&self, direction: Vec3, radius: f32) -> [f32; 2] {
        let Shape::Box { min, max } = &self.shape else { return [0.0; 2] };
        // Plane distance, and the range of distances along the directions, of each wall.
        let walls = (0..6).filter_map(|k| {
            let axis = k / 2;
            let (height, sign) = if k % 2 == 0 {
                (self.centre[axis] - min[axis], -1.0)
            } else {
                (max[axis] - self.centre[axis], 1.0)
            };
            let angle = direction.angle_between(Vec3::AXES[axis] * sign);
            let steepest = (angle - radius).max(0.0).cos();
            let flattest = (angle + radius).min(std::f32::consts::PI).cos();
            let farthest = if flattest > 0.0 { height / flattest } else { f32::INFINITY };
            (steepest > 0.0).then(|| [height, height / steepest, farthest])
        });
        let walls: Vec<[f32; 3]> = walls.collect();
        let end = walls.iter().map(|wall| wall[2]).fold(f32::INFINITY, f32::min);
        let met = walls.iter().filter(|wall| wall[1] <= end);
        met.fold([f32::INFINITY; 2], |least, wall| [least[0].min(wall[1]), least[1].min(wall[0])])
    }

    /// Share of the upper half sphere in which the probe sees no wall.
    pub fn open_share(&self) -> f64 {
        match &self.shape {
            Shape::Box { .. } => 0.0,
            Shape::Mesh(room) => {
                self.upward(room).filter(Option::is_none).count() as f64 / f64::from(UPWARD_RAYS)
            }
        }
    }

    /// Distances from the probe to the walls along Fibonacci points of the upper half sphere.
    fn upward<'a>(&'a self, room: &'a Room) -> impl Iterator<Item = Option<f32>> + 'a {
        (0..UPWARD_RAYS).map(move |k| {
            let y = (f64::from(k) + 0.5) / f64::from(UPWARD_RAYS);
            let radius = (1.0 - y * y).sqrt();
            let (s, c) = (f64::from(k) * 2.399_963_229_728_653).sin_cos();
            let direction = DVec3::new(radius * c, y, radius * s).as_vec3();
            room.first(self.centre, direction).map(|(p, _)| p.distance(self.centre))
        })
    }
}

impl Room {
    /// The first wall on a ray, and its normal.
    fn first(&self, from: Vec3, direction: Vec3) -> Option<(Vec3, Vec3)> {
        let ray = Ray { t_min: self.least, ..Ray::new(from, direction) };
        let Hit { t, mesh, triangle, .. } = self.accel.closest(&ray)?;
        let [a, b, c] = self.meshes[mesh as usize].corners(triangle as usize);
        Some((ray.at(t), (b - a).cross(c - a).normalize_or_zero()))
    }

    /// True if a wall hides `point`, which lies on a wall, from a place.
    fn between(&self, from: Vec3, point: Vec3) -> bool {
        let to = point - from;
        let distance = to.length();
        let t_max = distance - self.least;
        let ray = Ray { origin: from, direction: to / distance, t_min: self.least, t_max };
        t_max > self.least && self.accel.occluded(&ray)
    }
}

/// Where a ray from inside a box leaves it, and the axis of that wall.
fn leave_box(min: Vec3, max: Vec3, from: Vec3, direction: Vec3) -> (Vec3, Vec3) {
    let wall = Vec3::select(direction.cmpgt(Vec3::ZERO), max, min);
    let (mut t, mut axis) = (f32::INFINITY, 0);
    for k in 0..3 {
        let distance = (wall[k] - from[k]) / direction[k];
        // A ray along a wall never leaves through it.
        if direction[k] != 0.0 && distance < t {
            (t, axis) = (distance, k);
        }
    }
    let mut point = from + direction * t.max(0.0);
    point[axis] = wall[axis];
    (point, Vec3::AXES[axis])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::conventions::Rgb;
    use crate::light::{Environment, Lights};
    use crate::photo::Image;
    use glam::{DQuat, DVec2};

    const CENTRE: Vec3 = Vec3::new(0.1, 0.06, -0.2);
    const MIN: Vec3 = Vec3::new(-2.2, -0.75, -1.9);
    const MAX: Vec3 = Vec3::new(2.8, 1.95, 2.1);

    /// The room as a mesh of twelve triangles.
    fn box_mesh() -> Mesh {
        let corner =
            |k: usize| Vec3::select(glam::BVec3::new(k & 1 != 0, k & 2 != 0, k & 4 != 0), MAX, MIN);
        let faces =
            [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]];
        Mesh {
            positions: (0..8).map(corner).collect(),
            triangles: faces.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect(),
            ..Mesh::default()
        }
    }

    fn proxies() -> [Proxy; 2] {
        let walls = Proxy::of_box(CENTRE, MIN, MAX).unwrap();
        [walls, Proxy::of_mesh(CENTRE, vec![box_mesh()]).unwrap()]
    }

    fn uniform(k: u32) -> DVec2 {
        // R2 sequence (Roberts 2018): even enough for bins and integrals alike.
        let k = f64::from(k);
        DVec2::new((k * 0.754_877_666_246_693).fract(), (k * 0.569_840_290_998_053).fract())
    }

    /// A direction, uniform over the sphere.
    fn direction(u: DVec2) -> Vec3 {
        let z = 2.0 * u.y - 1.0;
        let (s, c) = (std::f64::consts::TAU * u.x).sin_cos();
        let radius = (1.0 - z * z).sqrt();
        DVec3::new(radius * c, z, radius * s).as_vec3().normalize()
    }

    #[test]
    fn at_the_probe_nothing_is_turned() {
        for proxy in proxies() {
            for k in 0..1000 {
                let d = direction(uniform(k));
                let (seen, toward) = (proxy.seen(CENTRE, d), proxy.toward(CENTRE, d).unwrap());
                assert!(seen.direction.distance(d) < 1e-5 && toward.direction.distance(d) < 1e-5);
                assert!((seen.density - 1.0).abs() < 1e-4 && (toward.density - 1.0).abs() < 1e-4);
            }
        }
    }

    #[test]
    fn a_direction_there_and_back_is_itself_with_the_same_density() {
        for proxy in proxies() {
            for from in [Vec3::new(1.0, 0.3, 0.5), Vec3::new(-2.0, 1.0, -1.0)] {
                for k in 0..1000 {
                    let d = direction(uniform(k));
                    let toward = proxy.toward(from, d).unwrap();
                    let seen = proxy.seen(from, toward.direction);
                    assert!(seen.direction.distance(d) < 1e-4, "{d} {seen:?}");
                    assert!((seen.density / toward.density - 1.0).abs() < 2e-3);
                }
            }
        }
    }

    #[test]
    fn a_place_outside_the_box_and_a_ray_past_the_mesh_see_distant_light() {
        let [walls, _] = proxies();
        let outside = Vec3::new(5.0, 0.0, 0.0);
        let d = Vec3::new(0.6, 0.8, 0.0);
        assert_eq!(walls.seen(outside, d).direction, d);
        assert_eq!(walls.toward(outside, d).unwrap().density, 1.0);
        assert!(Proxy::of_box(outside, MIN, MAX).is_none());
        assert!(Proxy::of_mesh(CENTRE, vec![Mesh::default()]).is_none());
        // A single wall: rays away from it are distant.
        let wall = Mesh { triangles: box_mesh().triangles[..2].to_vec(), ..box_mesh() };
        let one = Proxy::of_mesh(CENTRE, vec![wall]).unwrap();
        assert_eq!(one.seen(Vec3::X, Vec3::Z).direction, Vec3::Z);
        assert_eq!(one.toward(Vec3::X, Vec3::Z).unwrap().direction, Vec3::Z);
        assert!(one.seen(Vec3::X, Vec3::NEG_Z).direction.x > 0.1);
    }

    /// Bright window on the wall toward −x, dim walls.
    fn room_light() -> Image<Rgb> {
        Image::from_fn(128, 64, |i, j| {
            let window = (88..104).contains(&i) && (20..32).contains(&j);
            let wall = 0.2 + 0.1 * (i as f32 * 0.1).sin() + 0.002 * j as f32;
            if window { Rgb::new(8.0, 9.0, 10.0) } else { Rgb::splat(wall) }
        })
    }

    fn lights(proxy: Proxy, compensated: bool) -> Lights {
        let environment =
            Environment::new(&room_light(), DQuat::from_rotation_y(0.3), compensated).unwrap();
        Lights::from_parts(environment, Vec::new()).near(CENTRE, Some(proxy), Vec::new())
    }

    /// Largest χ² accepted at p = 0.001 with `n` degrees of freedom (Wilson & Hilferty 1931).
    fn chi_square_limit(n: f64) -> f64 {
        n * (1.0 - 2.0 / (9.0 * n) + 3.0902 * (2.0 / (9.0 * n)).sqrt()).powi(3)
    }

    /// 32 × 16 bins over the sphere at a displaced place: counts of draws against ∫ pdf over the bin.
    #[test]
    fn draws_through_the_walls_have_the_density_that_evaluate_says() {
        const DRAWS: u32 = 200_000;
        const QUADRATURE: u32 = 4_000_000;
        let from = Vec3::new(-0.9, 0.5, 0.4);
        for (name, proxy) in ["box", "mesh"].into_iter().zip(proxies()) {
            let lights = lights(proxy, false);
            let bin = |d: Vec3| {
                let x = (d.z.atan2(d.x) / std::f32::consts::TAU + 0.5) * 32.0;
                (x as usize).min(31) + 32 * (((d.y + 1.0) * 8.0) as usize).min(15)
            };
            let (mut counts, mut expected) = (vec![0.0; 512], vec![0.0; 512]);
            // Independent numbers: χ² speaks of those.
            let mut state = 0x9e37_79b9_u64;
            let mut next = || {
                state = state
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1_442_695_040_888_963_407);
                (state >> 11) as f64 / 9_007_199_254_740_992.0
            };
            for _ in 0..DRAWS {
                let u = DVec2::new(next(), next());
                let draw = lights.sample(0, from, u).expect("every wall is seen");
                counts[bin(draw.direction)] += 1.0;
            }
            let mut whole = 0.0;
            for k in 0..QUADRATURE {
                let d = direction(uniform(k));
                let pdf = f64::from(lights.evaluate(from, d).1) * 4.0 * std::f64::consts::PI
                    / f64::from(QUADRATURE);
                expected[bin(d)] += pdf * f64::from(DRAWS);
                whole += pdf;
            }
            assert!((whole - 1.0).abs() < 1e-3, "{name}: the density sums to {whole}");
            let (mut chi_square, mut bins) = (0.0, 0.0);
            for (count, expected) in counts.iter().zip(&expected) {
                // Five draws at least, the customary limit of the χ² law.
                if *expected > 5.0 {
                    chi_square += (count - expected).powi(2) / expected;
                    bins += 1.0;
                }
            }
            let limit = chi_square_limit(bins - 1.0);
            assert!(chi_square < limit, "{name}: {chi_square} of {bins} bins, limit {limit}");
        }
    }

    #[test]
    fn a_draw_knows_what_evaluate_says_of_it() {
        for proxy in proxies() {
            let lights = lights(proxy, true);
            let mut differ = 0;
            for from in [Vec3::new(-0.9, 0.5, 0.4), Vec3::new(2.0, -0.7, 1.5)] {
                for k in 0..2000 {
                    let draw = lights.sample(0, from, uniform(k)).unwrap();
                    let (radiance, pdf) = lights.evaluate(from, draw.direction);
                    // Within rounding of a texel's edge the neighbour may answer.
                    let same = radiance == draw.radiance && (pdf / draw.pdf - 1.0).abs() < 5e-3;
                    differ += usize::from(!same);
                }
            }
            assert!(differ <= 20, "{differ} of 4000 draws");
        }
    }

    #[test]
    fn a_furnace_stays_one_everywhere_in_the_room() {
        for proxy in proxies() {
            let one = Lights::from_parts(Environment::constant(Rgb::ONE), Vec::new());
            let lights = one.near(CENTRE, Some(proxy), Vec::new());
            for from in [CENTRE, Vec3::new(1.5, 0.2, 1.0), Vec3::new(-2.0, 1.7, -1.0)] {
                assert_eq!(lights.evaluate(from, Vec3::new(0.6, 0.0, 0.8)).0, Rgb::ONE);
                for normal in [Vec3::Y, Vec3::new(-0.6, 0.0, 0.8)] {
                    let e = lights.irradiance_at(from, normal).x / std::f32::consts::PI;
                    // What the quadrature promises; the last place is nearer to two walls.
                    assert!((e - 1.0).abs() < 3e-3, "{e} at {from} toward {normal}");
                }
            }
        }
    }

    /// A window of radiance 1 in the wall x = −3 m of a black room, the probe in the room's middle:
    /// irradiance of a horizontal patch moved by t toward it, against the rectangle's closed form.
    #[test]
    fn a_window_lights_displaced_patches_as_its_rectangle_does() {
        let (min, max) = (Vec3::new(-3.0, -1.0, -4.0), Vec3::new(4.0, 3.0, 4.0));
        let (low, high, half) = (0.2_f64, 1.6_f64, 0.7_f64);
        // 16 samples a texel: the window's edges are cut to a thousandth of its size.
        let picture = Image::from_fn(1024, 512, |i, j| {
            let lit = |k: usize| {
                let part = |k: usize| (k as f64 + 0.5) / 4.0 - 0.5;
                let at = DVec2::new(i as f64 + part(k % 4), j as f64 + part(k / 4));
                let d = crate::conventions::lat_long_direction(at, 1024, 512);
                let p = d * (3.0 / -d.x);
                d.x < 0.0 && (low..high).contains(&p.y) && p.z.abs() < half
            };
            Rgb::splat((0..16).filter(|&k| lit(k)).count() as f32 / 16.0)
        });
        let environment = Environment::new(&picture, DQuat::IDENTITY, true).unwrap();
        let proxy = Proxy::of_box(Vec3::ZERO, min, max).unwrap();
        let lights =
            Lights::from_parts(environment, Vec::new()).near(Vec3::ZERO, Some(proxy), Vec::new());
        // ∫ cosθ cosθ' / r² dA over the window, midpoint rule of 400 × 400.
        let exact = |place: DVec3| {
            let n = 400;
            let mut sum = 0.0;
            for i in 0..n * n {
                let (u, v) = ((i % n) as f64 + 0.5, (i / n) as f64 + 0.5);
                let y = low + (high - low) * u / n as f64;
                let z = half * (2.0 * v / n as f64 - 1.0);
                let to = DVec3::new(-3.0, y, z) - place;
                sum += to.y.max(0.0) * -to.x / to.length_squared().powi(2);
            }
            sum * (high - low) * 2.0 * half / (n * n) as f64
        };
        let at_probe = exact(DVec3::ZERO);
        for (t, factor) in [(0.0, 1.0), (0.1, 1.09), (0.25, 1.24), (0.5, 1.57), (1.0, 2.61)] {
            let place = DVec3::new(-t, 0.0, 0.0);
            let wanted = exact(place);
            // R10.1's measured factors are of a like room.
            assert!((wanted / at_probe / factor - 1.0).abs() < 0.05, "{t}: {}", wanted / at_probe);
            let found = f64::from(lights.irradiance_at(place.as_vec3(), Vec3::Y).x);
            assert!((found / wanted - 1.0).abs() < 5e-3, "{t} m: {found} for {wanted}");
            // The density's own Jacobian: draws weighed by the cosine give the same.
            let n = 20_000;
            let mut sum = 0.0;
            for k in 0..n {
                if let Some(draw) = lights.sample(0, place.as_vec3(), uniform(k)) {
                    let cosine = draw.direction.y.max(0.0);
                    sum += f64::from(draw.radiance.x * cosine / draw.pdf) / f64::from(n);
                }
            }
            assert!((sum / wanted - 1.0).abs() < 5e-3, "{t} m: {sum} for {wanted} by draws");
        }
        let aside = DVec3::new(0.0, 0.0, 0.5);
        let found = f64::from(lights.irradiance_at(aside.as_vec3(), Vec3::Y).x);
        assert!((found / exact(aside) - 1.0).abs() < 5e-3);
        let wall = lights.irradiance_at(DVec3::new(0.5, 0.2, 0.0).as_vec3(), Vec3::NEG_X);
        assert!(wall.x > 0.0);
    }
}
