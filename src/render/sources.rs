//! Parts of the light as bounds need them: where they can be seen from anywhere in a ball, and how
//! much they give there at most.
//!
//! Of light on near walls a part k, which the probe at c sees at no less than d_k, is seen from x,
//! s = |x − c| away, turned by at most asin(s/d_k); and by R10.3 its solid angle grows by no more than
//! (h_x/h_c)(|p−c|/|p−x|)³ ≤ (1 + s/h_k)/(1 − s/d_k)³, h_k the distance of c to the plane of its wall.

use std::f32::consts::PI;

use glam::Vec3;

use super::influence::{Cap, cap};
use super::world::{PartBall, World};
use crate::conventions::{Rgb, cap_height};
use crate::light::cells::Cell;
use crate::light::{Lamp, Proxy};

/// Light from a part of the sphere.
#[derive(Clone, Copy)]
pub struct Source {
    /// Unit, to the middle of the cap that holds the part.
    pub direction: Vec3,
    /// Half-angle of the cap, radians, with its sine and cosine.
    pub radius: f32,
    pub sin: f32,
    pub cos: f32,
    /// ∫ L dω, in the plate's scale.
    pub flux: Rgb,
    /// Largest radiance, if the part is wide; a sun is taken whole.
    pub brightest: Option<Rgb>,
    /// Least distance of a near wall, and of its plane; 0 where nothing is known of it.
    wall: Option<[f32; 2]>,
}

/// All lights, for bounds.
pub struct Sources {
    place: Vec3,
    parts: Vec<Source>,
    lamps: Vec<Lamp>,
}

impl Source {
    fn new(direction: Vec3, radius: f32, flux: Rgb, brightest: Option<Rgb>) -> Self {
        let (sin, cos) = radius.sin_cos();
        Self { direction, sin, cos, radius, flux, brightest, wall: None }
    }

    /// The same, as it is seen from somewhere no farther than `s` from the probe.
    fn within(&self, s: f32) -> Self {
        let Some([distance, height]) = self.wall else { return *self };
        // The rest is rounding's.
        let nearness = s / distance * 1.001;
        if !(nearness < 1.0) {
            return Self::new(self.direction, PI, Rgb::INFINITY, self.brightest);
        }
        let radius = (self.radius + nearness.asin()).min(PI);
        let growth = (1.0 + s / height) / (1.0 - nearness).powi(3);
        Self::new(self.direction, radius, self.flux * growth, self.brightest)
    }
}

impl Sources {
    pub fn new(world: &World) -> Self {
        let lights = &world.lights;
        let proxy = lights.proxy();
        let part = |cell: &Cell| {
            if cell.is_sun() {
                return Source::new(cell.direction, cell.radius, cell.flux, None);
            }
            let own = Source::new(cell.direction, cell.radius, cell.flux, Some(cell.brightest));
            let wall = proxy.map(|proxy| proxy.nearest(cell.direction, cell.radius));
            Source { wall, ..own }
        };
        let parts = world.cells.iter().map(part).collect();
        let place = proxy.map_or(Vec3::ZERO, Proxy::centre);
        Self { place, parts, lamps: lights.lamps.clone() }
    }

    /// All but the lamps, as seen from anywhere in a ball.
    pub fn seen_from(&self, ball: &PartBall) -> impl Iterator<Item = Source> + '_ {
        let s = ball.centre.distance(self.place) + ball.radius;
        self.parts.iter().map(move |source| source.within(s))
    }

    /// The lamps that something at `least` metres or farther may hide from anywhere in a ball; `None`
    /// if one of them touches the ball.
    pub fn lamps_behind(&self, ball: &PartBall, least: f32) -> Option<Vec<Source>> {
        let behind = self
            .lamps
            .iter()
            .filter(|lamp| lamp.centre.distance(ball.centre) + ball.radius > least);
        behind.map(|lamp| lamp_source(lamp, ball)).collect()
    }

    /// Flux of all parts, +∞ if a wall may be touched.
    pub fn flux(&self, ball: &PartBall) -> Rgb {
        let lamps: Rgb = self
            .lamps
            .iter()
            .map(|lamp| lamp_source(lamp, ball).map_or(Rgb::INFINITY, |source| source.flux))
            .sum();
        lamps + self.seen_from(ball).map(|source| source.flux).sum::<Rgb>()
    }

    /// Irradiance by walls and lamps anywhere in a ball, for a normal: at most this.
    pub fn near_irradiance(&self, ball: &PartBall, normal: Vec3) -> Rgb {
        let (mut sum, mut brightest) = (Rgb::ZERO, Rgb::ZERO);
        for source in self.seen_from(ball) {
            let cosine = (normal.angle_between(source.direction) - source.radius).max(0.0).cos();
            if let Some(radiance) = source.brightest
                && cosine > 0.0
            {
                sum += source.flux * cosine;
                brightest = brightest.max(radiance);
            }
        }
        sum.min(brightest * PI) + self.lamp_irradiance(ball)
    }

    /// Irradiance by the lamps anywhere in a ball: at most this. One that may be touched fills half the
    /// sky at most.
    pub fn lamp_irradiance(&self, ball: &PartBall) -> Rgb {
        let of_lamp =
            |lamp: &Lamp| lamp_source(lamp, ball).map_or(lamp.radiance * PI, |source| source.flux);
        self.lamps.iter().map(of_lamp).sum()
    }

    pub fn has_lamps(&self) -> bool {
        !self.lamps.is_empty()
    }
}

/// A lamp from anywhere in a ball; `None` if they touch.
fn lamp_source(lamp: &Lamp, ball: &PartBall) -> Option<Source> {
    let sphere = PartBall { centre: lamp.centre, radius: lamp.radius };
    let Cap { axis, half_angle } = cap(&sphere, ball)?;
    let sin = (lamp.radius / (lamp.centre.distance(ball.centre) - ball.radius)).min(1.0);
    let solid_angle = 2.0 * PI * cap_height(sin * sin);
    Some(Source::new(axis, half_angle, lamp.radiance * solid_angle, None))
}
