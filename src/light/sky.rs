//! A clear sky with its sun, where no photograph of them is.
//!
//! Shape and colour by Preetham et al. 1999 (`preetham.rs`), the strength of sun and sky by Bird and
//! Riordan 1986 (`clear_sky.rs`), ground of one albedo below the horizon. No clouds, no haze over a
//! town, no mountains: E_sun / E_sky is good to 20–30 % on a day that looks clear (6.4 against 8.3 in a
//! photographed panorama, Poly Haven's Rooitou Park, the sun at 10°). The unit is chosen by [`Strength`],
//! for a plate knows nothing of lux: at first a level white card has radiance 1.

use std::collections::BTreeMap;
use std::f64::consts::PI;

use glam::{DQuat, DVec2, DVec3, Vec3};
use rayon::prelude::*;

use super::clear_sky::clear_sky;
use super::preetham::Preetham;
use super::sun::Disc;
use crate::bracket::Validity;
use crate::conventions::{
    Rgb, SUN_HALF_ANGLE_RAD, lat_long_direction, lat_long_pixel, lat_long_solid_angle, luminance,
};
use crate::photo::Image;
use crate::probe::Panorama;

/// Relative standard error of E_sun / E_sky, and so about that of a shadow's depth.
pub const SIGMA: f64 = 0.25;
/// Haze of the models: 2 is mountain air, 3 a clear day, 6 haze, 10 thick haze.
pub const DEFAULT_TURBIDITY: f64 = 3.0;
/// Grass, soil, old asphalt.
pub const DEFAULT_GROUND: Rgb = Rgb::splat(0.2);

/// Turbidities for which Preetham's formulas were fitted; below 2 they go negative.
pub(super) const TURBIDITIES: std::ops::RangeInclusive<f64> = 2.0..=10.0;

/// Why there is no such sky. [`SkyError::key`] says which wish it is about.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SkyError {
    #[error(
        "{0} is below 2, where the model's sky goes negative; 2 is the clearest air, 3 a clear day"
    )]
    TooClear(f64),
    #[error(
        "{0} is above 10, where there is no sky to see but haze; take at most 10, or photograph the light"
    )]
    TooHazy(f64),
    #[error(
        "the sun stands {0:.1}° below the horizon, where the model has no light; check date, zone and the \
         signs of the place (north and east are positive)"
    )]
    BelowHorizon(f64),
    #[error("{0:?} is no albedo; write shares of light from 0 to 1, grass has about 0.2")]
    Ground([f32; 3]),
    #[error("{0:?} is no irradiance of light; write numbers from 0 to 1e12 that are not all 0")]
    Irradiance([f64; 3]),
}

impl SkyError {
    /// Name of the key or option, without dashes; both spell it alike but for `_` and `-`.
    pub fn key(&self) -> &'static str {
        match self {
            Self::TooClear(_) | Self::TooHazy(_) => "turbidity",
            Self::BelowHorizon(_) => "sun",
            Self::Ground(_) => "ground",
            Self::Irradiance(_) => "irradiance",
        }
    }
}

/// What somebody knows of the light's strength, and with it the unit of all radiance.
///
/// Without either, sun and sky together give level ground the irradiance π: a level white card has
/// radiance 1. With one of them, the other follows by the model.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Strength {
    /// Irradiance of level ground by the sky alone, its luminance.
    pub sky: Option<f64>,
    /// Irradiance of a surface that faces the sun by the sun alone.
    pub sun: Option<DVec3>,
}

/// The light of a clear sky at one moment, world axes.
#[derive(Clone, Debug)]
pub struct Sky {
    /// Unit, toward the sun.
    direction: DVec3,
    turbidity: f64,
    ground: Rgb,
    preetham: Preetham,
    /// Our radiance for the model's kcd/m².
    scale: f64,
    /// Irradiance of level ground by the sky.
    sky_irradiance: DVec3,
    /// Irradiance of a surface facing the sun.
    sun_irradiance: DVec3,
}

impl Sky {
    /// The sky about a sun seen in `direction` (world, +Y up), over ground of the albedo `ground`; a level
    /// white card has radiance 1.
    ///
    /// # Errors
    /// [`SkyError`]: a turbidity outside 2…10, a sun that is not above the horizon, or no albedo.
    pub fn new(direction: DVec3, turbidity: f64, ground: Rgb) -> Result<Self, SkyError> {
        let of_model = Self::of_model(direction, turbidity, ground)?;
        let level = of_model.level_irradiance();
        Ok(of_model.scaled(PI / f64::from(luminance(level))))
    }

    /// The same in the model's unit: the sun outside the atmosphere gives 1. Skies of several moments
    /// are in one unit then.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn of_model(direction: DVec3, turbidity: f64, ground: Rgb) -> Result<Self, SkyError> {
        if !(turbidity >= *TURBIDITIES.start()) {
            return Err(SkyError::TooClear(turbidity));
        }
        if turbidity > *TURBIDITIES.end() {
            return Err(SkyError::TooHazy(turbidity));
        }
        if !ground.to_array().iter().all(|albedo| (0.0..=1.0).contains(albedo)) {
            return Err(SkyError::Ground(ground.to_array()));
        }
        let direction = direction.normalize_or_zero();
        if !(direction.y > 0.0) {
            return Err(SkyError::BelowHorizon(-direction.y.asin().to_degrees()));
        }
        let sun_zenith = direction.x.hypot(direction.z).atan2(direction.y);
        let preetham = Preetham::new(turbidity, sun_zenith);
        let shape = preetham.irradiance(sun_zenith);
        let strength = clear_sky(turbidity, sun_zenith.to_degrees());
        // Preetham's colour, the other model's luminance
        let y = |l: DVec3| f64::from(luminance(l.as_vec3()));
        let scale = y(strength.sky) / y(shape);
        Ok(Self {
            direction,
            turbidity,
            ground,
            preetham,
            scale,
            sky_irradiance: shape * scale,
            sun_irradiance: strength.sun,
        })
    }

    /// The same sky in the unit of what is known of its strength.
    ///
    /// # Errors
    /// [`SkyError::Irradiance`] for numbers that are negative, not finite or nothing.
    pub fn with_strength(self, known: &Strength) -> Result<Self, SkyError> {
        const MOST: f64 = 1e12;
        let y = |l: DVec3| f64::from(luminance(l.as_vec3()));
        let wrong = |e: DVec3| !(e.min_element() >= 0.0 && e.max_element() <= MOST && y(e) > 0.0);
        let given = known.sky.map(DVec3::splat).into_iter().chain(known.sun);
        if let Some(wrong) = given.into_iter().find(|&e| wrong(e)) {
            return Err(SkyError::Irradiance(wrong.to_array()));
        }
        let factor = match (known.sky, known.sun) {
            (Some(sky), _) => sky / y(self.sky_irradiance),
            (None, Some(sun)) => y(sun) / y(self.sun_irradiance).max(f64::MIN_POSITIVE),
            (None, None) => return Ok(self),
        };
        if !(factor > 0.0 && factor < 1e15) {
            // A sun of the model that the horizon's air has swallowed says nothing of the sky.
            return Err(SkyError::Irradiance(known.sun.unwrap_or_default().to_array()));
        }
        let mut sky = self.scaled(factor);
        sky.sun_irradiance = known.sun.unwrap_or(sky.sun_irradiance);
        Ok(sky)
    }

    /// The same light in another unit.
    pub fn scaled(mut self, factor: f64) -> Self {
        self.scale *= factor;
        self.sky_irradiance *= factor;
        self.sun_irradiance *= factor;
        self
    }

    /// The same light in the unit in which the model's 1 kcd/m² are this radiance.
    pub(super) fn with_luminance_scale(self, scale: f64) -> Self {
        let factor = scale / self.scale;
        self.scaled(factor)
    }

    /// Radiance from a direction (unit, world), without the sun's disc.
    pub fn radiance(&self, direction: DVec3) -> Rgb {
        if direction.y < 0.0 {
            return self.ground_radiance();
        }
        let cos_gamma = direction.dot(self.direction);
        (self.preetham.radiance(direction.y, cos_gamma) * self.scale).as_vec3()
    }

    /// The sun, 0.533° across.
    pub fn sun(&self) -> Disc {
        let (direction, irradiance) = (self.direction.as_vec3(), self.sun_irradiance.as_vec3());
        Disc::from_irradiance(direction, SUN_HALF_ANGLE_RAD as f32, irradiance)
    }

    /// Haze, 2 to 10.
    pub fn turbidity(&self) -> f64 {
        self.turbidity
    }

    /// Irradiance of level ground by the sky alone.
    pub fn sky_irradiance(&self) -> Rgb {
        self.sky_irradiance.as_vec3()
    }

    /// Irradiance of a surface that faces the sun, by the sun alone.
    pub fn sun_irradiance(&self) -> Rgb {
        self.sun_irradiance.as_vec3()
    }

    /// Irradiance of level ground by sun and sky.
    pub fn level_irradiance(&self) -> Rgb {
        self.sky_irradiance() + self.sun().irradiance(Vec3::Y)
    }

    /// Level matt ground in this light.
    fn ground_radiance(&self) -> Rgb {
        self.ground * self.level_irradiance() / PI as f32
    }

    /// The sky as a lat-long of `width` × `width`/2 texels, without the sun's disc.
    ///
    /// Each texel is a mean over it; all are [`Validity::Analytic`] and seen by nobody (coverage 0).
    pub fn panorama(&self, width: usize) -> Panorama {
        let height = width / 2;
        let rows = (0..height).into_par_iter().flat_map_iter(|y| {
            (0..width).map(move |x| {
                let pixel = DVec2::new(x as f64, y as f64);
                self.mean_over_texel(pixel, width, height, DQuat::IDENTITY)
            })
        });
        let texels: Vec<Rgb> = rows.collect();
        // Each row made one for each of its places.
        let radiance = Image::from_pixels(width, height, texels).expect("as many texels as places");
        Panorama {
            validity: Image::filled(width, height, Validity::Analytic),
            coverage: Image::filled(width, height, 0.0),
            ..Panorama::from_radiance(radiance)
        }
    }

    /// The same with the sun drawn into it: its flux is exact, its disc as sharp as the texels are.
    pub fn panorama_with_sun(&self, width: usize) -> Panorama {
        let mut panorama = self.panorama(width);
        draw_disc(&mut panorama.radiance, &self.sun());
        panorama
    }

    /// Mean radiance over the texel about `pixel` of a lat-long map that is turned in the world, without
    /// the sun's disc.
    pub(super) fn mean_over_texel(
        &self,
        pixel: DVec2,
        width: usize,
        height: usize,
        world_from_map: DQuat,
    ) -> Rgb {
        let at = |dx: f64, dy: f64| {
            world_from_map * lat_long_direction(pixel + DVec2::new(dx, dy), width, height)
        };
        // Half a texel's diagonal is less than its side.
        let texel_rad = PI / height as f64;
        let middle = at(0.0, 0.0);
        if middle.y < -texel_rad {
            return self.ground_radiance();
        }
        // The light has a cusp at the sun and changes within a degree of the horizon.
        let bends = middle.dot(self.direction) > (3.0 * texel_rad).min(PI).cos()
            || middle.y < 3.0 * texel_rad;
        let n = if bends { 8 } else { 2 };
        let mut sum = DVec3::ZERO;
        let mut weights = 0.0;
        for j in 0..n {
            let dy = (j as f64 + 0.5) / n as f64 - 0.5;
            // Solid angle goes with the cosine of the latitude.
            let weight = (PI * (0.5 - (pixel.y + 0.5 + dy) / height as f64)).cos();
            for i in 0..n {
                let dx = (i as f64 + 0.5) / n as f64 - 0.5;
                sum += self.radiance(at(dx, dy)).as_dvec3() * weight;
            }
            weights += n as f64 * weight;
        }
        (sum / weights).as_vec3()
    }
}

/// Adds a disc (axes of the map) to a lat-long map, ∫ L dω exact.
///
/// Points spread evenly over the disc each bring their share of its flux to the texel that they fall
/// into: poles and seam need no care, and nothing is lost at an edge.
pub(super) fn draw_disc(map: &mut Image<Rgb>, disc: &Disc) {
    // A sun in the largest map covers 2 400 texels: 25 points in each.
    const POINTS: usize = 1 << 16;
    const GOLDEN: f64 = 0.618_033_988_749_894_9;
    let (width, height) = (map.width(), map.height());
    let mut hits: BTreeMap<(usize, usize), u32> = BTreeMap::new();
    for k in 0..POINTS {
        let (u, v) = ((k as f64 * GOLDEN).fract(), (k as f64 + 0.5) / POINTS as f64);
        let pixel = lat_long_pixel(disc.sample(u as f32, v as f32).as_dvec3(), width, height);
        let texel = |value: f64, n: usize| ((value + 0.5).max(0.0) as usize).min(n - 1);
        *hits.entry((texel(pixel.y, height), texel(pixel.x, width))).or_default() += 1;
    }
    let flux = disc.radiance.as_dvec3() * f64::from(disc.solid_angle());
    for ((y, x), n) in hits {
        let share = f64::from(n) / POINTS as f64 / lat_long_solid_angle(y, width, height);
        map[(x, y)] += (flux * share).as_vec3();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::sun::{SunSplit, split};
    use crate::light::sun_position::SunPosition;

    fn sky(elevation_deg: f64, turbidity: f64) -> Sky {
        let sun = SunPosition { azimuth_deg: 140.0, elevation_deg }.direction(0.0);
        Sky::new(sun, turbidity, DEFAULT_GROUND).expect("a sky")
    }

    #[test]
    fn a_level_white_card_has_radiance_one() {
        for (elevation, turbidity) in [(60.0, 3.0), (20.0, 2.0), (5.0, 8.0), (1.0, 10.0)] {
            let sky = sky(elevation, turbidity);
            let level = f64::from(luminance(sky.level_irradiance()));
            assert!((level / PI - 1.0).abs() < 1e-5, "{elevation}: {level}");
            // The map holds what the sky says: its horizon row is steep, 1e-3 of the whole.
            let up = sky.panorama(256).irradiance(DVec3::Y);
            let off = (up / sky.sky_irradiance() - 1.0).abs().max_element();
            assert!(off < 2e-3, "{elevation} {turbidity}: off by {off}");
        }
    }

    #[test]
    fn ground_shines_with_its_albedo_of_all_light() {
        let sky = sky(40.0, 3.0);
        let below = sky.radiance(DVec3::new(0.0, -1.0, 0.0));
        let wanted = 0.2 * sky.level_irradiance() / PI as f32;
        assert!((below - wanted).length() < 1e-6);
        assert!((luminance(below) - 0.2).abs() < 1e-5);
        let map = sky.panorama(64);
        assert!(
            (map.irradiance(-DVec3::Y) / (PI as f32 * wanted) - 1.0).abs().max_element() < 1e-5
        );
        assert!(map.validity.pixels().iter().all(|&v| v == Validity::Analytic));
    }

    #[test]
    fn a_drawn_sun_keeps_its_flux_and_its_place_everywhere() {
        // The middle, the pole, the seam (−Z), a corner of texels, and across the horizon.
        let places = [
            DVec3::new(0.3, 0.8, 0.5),
            DVec3::Y,
            DVec3::new(0.0, 0.5, -1.0),
            DVec3::new(1.0, 1.0, 0.0),
            DVec3::new(0.0, 1e-3, 1.0),
        ];
        for direction in places.map(DVec3::normalize) {
            let irradiance = Vec3::new(3.0, 2.5, 2.0);
            let half_angle = SUN_HALF_ANGLE_RAD as f32;
            let disc = Disc::from_irradiance(direction.as_vec3(), half_angle, irradiance);
            for width in [16, 64, 1024, 4096] {
                let mut map = Image::filled(width, width / 2, Rgb::ZERO);
                draw_disc(&mut map, &disc);
                let (mut flux, mut moment) = (DVec3::ZERO, DVec3::ZERO);
                for y in 0..width / 2 {
                    let solid_angle = lat_long_solid_angle(y, width, width / 2);
                    for x in 0..width {
                        let l = map[(x, y)].as_dvec3() * solid_angle;
                        flux += l;
                        let pixel = DVec2::new(x as f64, y as f64);
                        moment += lat_long_direction(pixel, width, width / 2) * l.y;
                    }
                }
                let wanted = disc.radiance.as_dvec3() * f64::from(disc.solid_angle());
                let off = (flux / wanted - 1.0).abs().max_element();
                assert!(off < 1e-6, "{direction} {width}: flux off by {off}");
                // Within half a texel, and to 0.02 texels where texels are smaller than the disc (the
                // pole's are wedges, whose middles pull by less than a texel).
                let angle = moment.angle_between(direction);
                let texel = PI / (width / 2) as f64;
                assert!(angle < 0.75 * texel, "{direction} {width}: {} texels", angle / texel);
                if width == 4096 {
                    assert!(angle < 0.02 * texel, "{direction}: {} texels", angle / texel);
                }
            }
        }
    }

    #[test]
    fn the_sun_drawn_into_a_map_comes_out_as_the_same_disc() {
        let sky = sky(35.0, 3.0);
        let sun = sky.sun();
        for width in [256, 1024] {
            let with = sky.panorama_with_sun(width);
            let discs = split(&with, SunSplit::Auto).discs;
            assert_eq!(discs.len(), 1, "{width}");
            let [found, wanted] = [&discs[0], &sun].map(|d| d.irradiance(d.direction));
            // What is split off is above the ring's median, and the sky is brightest at the sun.
            assert!((found / wanted - 1.0).abs().max_element() < 0.02, "{width}: {found} {wanted}");
            let angle = discs[0].direction.angle_between(sun.direction).to_degrees();
            assert!(angle < 180.0 / width as f32, "{width}: {angle}°");
        }
    }

    #[test]
    fn what_is_known_of_the_strength_sets_the_unit() {
        let of = |sky, sun| sky_with(&Strength { sky, sun });
        fn sky_with(known: &Strength) -> Sky {
            sky(50.0, 3.0).with_strength(known).expect("a strength")
        }
        let ratio = |s: &Sky| luminance(s.sun_irradiance()) / luminance(s.sky_irradiance());
        let free = of(None, None);
        let shade = of(Some(15_000.0), None);
        assert!((luminance(shade.sky_irradiance()) - 15_000.0).abs() < 0.1);
        assert!((ratio(&shade) / ratio(&free) - 1.0).abs() < 1e-5);
        let sun = DVec3::new(9.0, 8.0, 7.0);
        let sunny = of(None, Some(sun));
        assert_eq!(sunny.sun_irradiance(), sun.as_vec3());
        assert!((ratio(&sunny) / ratio(&free) - 1.0).abs() < 1e-5);
        let both = of(Some(2.0), Some(sun));
        assert_eq!(both.sun_irradiance(), sun.as_vec3());
        assert!((luminance(both.sky_irradiance()) - 2.0).abs() < 1e-5);
        // Ground is lit by what there is.
        let below = both.radiance(-DVec3::Y) * PI as f32 / 0.2;
        assert!((below - both.level_irradiance()).length() < 1e-4);
        for (sky_y, sun) in [
            (Some(0.0), None),
            (Some(-1.0), None),
            (Some(f64::NAN), None),
            (None, Some(DVec3::ZERO)),
            (None, Some(DVec3::new(1.0, -1.0, 1.0))),
            (None, Some(DVec3::splat(f64::INFINITY))),
        ] {
            let refused = sky(50.0, 3.0).with_strength(&Strength { sky: sky_y, sun });
            assert!(matches!(refused, Err(SkyError::Irradiance(_))), "{sky_y:?} {sun:?}");
        }
    }

    #[test]
    fn skies_of_one_day_are_in_one_unit() {
        let at = |elevation_deg| {
            let sun = SunPosition { azimuth_deg: 90.0, elevation_deg }.direction(0.0);
            Sky::of_model(sun, 3.0, DEFAULT_GROUND).expect("a sky")
        };
        let level = |elevation| luminance(at(elevation).level_irradiance());
        assert!(level(60.0) > 2.0 * level(25.0) && level(25.0) > 5.0 * level(5.0));
        assert!(level(60.0) < 1.0, "no more than outside the atmosphere");
    }

    #[test]
    fn a_clear_sky_is_blue_above_and_a_low_sun_is_red() {
        let noon = sky(60.0, 2.5);
        let zenith = noon.radiance(DVec3::Y);
        assert!(zenith.z > 1.5 * zenith.y && zenith.y > zenith.x, "{zenith}");
        let low = sky(4.0, 2.5);
        let sun = low.sun_irradiance();
        assert!(sun.x > 1.5 * sun.y && sun.y > 1.5 * sun.z, "{sun}");
        // Beside the sun it is brighter than away from it.
        let beside = low.radiance((low.sun().direction.as_dvec3() + 0.1 * DVec3::Y).normalize());
        let away = low.radiance((-low.sun().direction.as_dvec3() + 0.2 * DVec3::Y).normalize());
        assert!(luminance(beside) > 2.0 * luminance(away), "{beside} {away}");
    }

    /// methods-capture F30.
    #[test]
    fn skies_that_there_are_not_are_refused_with_their_remedy() {
        let up = DVec3::new(0.2, 0.5, 0.1);
        let said = |sun, turbidity, ground: f32| {
            let error = Sky::new(sun, turbidity, Rgb::splat(ground)).unwrap_err();
            format!("{}: {error}", error.key())
        };
        assert!(said(up, 1.9, 0.2).starts_with("turbidity: 1.9 is below 2"));
        assert!(said(up, f64::NAN, 0.2).starts_with("turbidity"));
        assert!(said(up, 10.5, 0.2).contains("above 10"));
        assert!(said(up, 3.0, 1.2).starts_with("ground"));
        assert!(said(up, 3.0, f32::NAN).starts_with("ground"));
        let night = said(DVec3::new(1.0, -0.1, 0.0), 3.0, 0.2);
        assert!(night.starts_with("sun: ") && night.contains("5.7° below"), "{night}");
        assert!(said(DVec3::ZERO, 3.0, 0.2).starts_with("sun"));
    }
}
