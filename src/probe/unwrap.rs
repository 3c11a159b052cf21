//! Photograph of a mirror ball → panorama in world axes.
//!
//! The direction to the ball comes from its rim, the axes from the camera's rotation, lengths from
//! the ball's radius. Where the support is known, what the ball shows of it is put where it
//! would be seen from the ball's centre: from the surface, things one radius away are seen in
//! quite another direction. Not seen are the blind cone behind the ball, where mirrored rays are
//! bent so fast at the rim that a pixel no longer tells them apart, and the ball's own contact with
//! the support; both are filled and say so ([`Validity::Filled`]): the first from the photograph
//! beside the ball (rim directions *are* view directions), the rest from around the gap.

use glam::{DMat3, DVec2, DVec3};

use super::ProbeError;
use super::ball::{Ball, Mirror};
use super::fill;
use super::mapping::{LatLong, Mapping};
use super::panorama::Panorama;
use super::resample::{Gatherer, to_lat_long};
use super::rim::Rim;
use crate::bracket::{Radiance, Validity};
use crate::camera::{Camera, Lens};
use crate::photo::Image;

/// Pixels this near the rim are not used: they mix ball and background.
const RIM_MARGIN_PX: f64 = 1.5;

/// Within this angle of straight down a ball that stands on the support has darkened it by more
/// than a fifth (form factor `cos³`, ball of reflectance 0.6).
const CONTACT_RAD: f64 = 40.0 * std::f64::consts::PI / 180.0;

/// The plane that the ball stands on or over.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Support {
    /// Any point of it, world, metres.
    pub point: DVec3,
    /// Unit normal, towards the ball.
    pub normal: DVec3,
}

/// The panorama that a photographed mirror ball shows, as seen from the ball's centre.
///
/// `rim` is the ball's in the axes of `camera`, whose pose gives only the rotation. `width` is even,
/// 16 or more; [`natural_width`] shows all that the photograph holds. With `support`, the parallax
/// of that plane is taken out and the contact is filled.
pub fn unwrap_ball(
    radiance: &Radiance,
    camera: &Camera,
    rim: &Rim,
    ball: &Ball,
    support: Option<&Support>,
    width: usize,
) -> Result<Panorama, ProbeError> {
    check_width(width)?;
    let view = BallView::new(camera, rim, ball, support)?;
    let camera_from_world = view.world_from_camera.transpose();
    let mut panorama = to_lat_long(radiance, &view, camera_from_world, width);
    divide_by_reflectance(&mut panorama, ball);
    panorama.place = ball.centre;

    // What is not seen: first the photograph itself, then the surroundings of the gap.
    let contact = |d: DVec3| view.plane.is_some_and(|p| p.darkened(d));
    let beside = Beside { view: &view };
    let target = LatLong { width, height: width / 2 };
    let size = (width, width / 2);
    let gatherer = Gatherer::new(radiance, &beside, target, size, camera_from_world);
    let mut gap = Image::filled(width, width / 2, false);
    for y in 0..width / 2 {
        for x in 0..width {
            let below = contact(camera_from_world * panorama.direction(x, y));
            if panorama.coverage[(x, y)] >= 0.5 && !below {
                continue;
            }
            panorama.coverage[(x, y)] = 0.0;
            let seen = gatherer.one(x, y);
            gap[(x, y)] = below || seen.coverage < 0.5;
            if !gap[(x, y)] {
                panorama.radiance[(x, y)] = seen.radiance;
                panorama.variance[(x, y)] = seen.variance;
                panorama.validity[(x, y)] = super::resample::worst(Validity::Filled, seen.validity);
            }
        }
    }
    fill::from_around(&mut panorama, &gap);
    Ok(panorama)
}

/// Refuses widths that no lat-long of ours has.
pub fn check_width(width: usize) -> Result<(), ProbeError> {
    if width < 16 || width % 2 == 1 || width > 1 << 15 {
        let found = width.to_string();
        let expected = "an even number from 16 to 32768";
        return Err(ProbeError::Value { what: "panorama width", found, expected });
    }
    Ok(())
}

/// Width at which a texel is about one pixel of the ball's middle: a power of two, 256…4096.
pub fn natural_width(radius_px: f64) -> usize {
    let width = std::f64::consts::PI * radius_px;
    (width.clamp(256.0, 4096.0) as usize).next_power_of_two().min(4096)
}

/// Angle of one pixel of `lens` at `direction` (camera axes), radians.
pub fn pixel_angle(lens: &Lens, direction: DVec3) -> Option<f64> {
    let pixel = lens.project(direction)?;
    let step =
        |d: DVec2| Some(lens.unproject(pixel + d)?.angle_between(lens.unproject(pixel - d)?));
    let area = step(DVec2::X * 0.5)? * step(DVec2::Y * 0.5)?;
    Some(area.sqrt())
}

fn divide_by_reflectance(panorama: &mut Panorama, ball: &Ball) {
    let gain = ball.reflectance.recip();
    panorama.radiance.pixels_mut().iter_mut().for_each(|l| *l *= gain);
    panorama.variance.pixels_mut().iter_mut().for_each(|v| *v *= gain * gain);
}

/// The support in camera axes, relative to the ball's centre.
#[derive(Clone, Copy, Debug)]
struct Plane {
    normal: DVec3,
    /// Height of the ball's centre above it, metres, positive.
    height: f64,
    touches: bool,
}

impl Plane {
    /// Whether the direction `d` points at the support that the ball itself darkens.
    fn darkened(&self, d: DVec3) -> bool {
        self.touches && d.dot(-self.normal) > CONTACT_RAD.cos()
    }
}

/// What a camera sees in a ball: pixel ↔ direction from the ball's centre, camera axes.
#[derive(Clone, Debug)]
pub struct BallView {
    lens: Lens,
    mirror: Mirror,
    world_from_camera: DMat3,
    plane: Option<Plane>,
    /// Largest angle off the axis at which pixels are used, and smallest at which they show what
    /// is beside the ball.
    inside_rad: f64,
    outside_rad: f64,
}

impl BallView {
    /// The view of `camera` of the ball whose rim is `rim`; with `support`, its parallax is taken out.
    ///
    /// # Errors
    /// A rim that is no cone in front of the camera, or a ball of less than ten pixels.
    pub fn new(
        camera: &Camera,
        rim: &Rim,
        ball: &Ball,
        support: Option<&Support>,
    ) -> Result<Self, ProbeError> {
        let no_ball = |reason: &str| ProbeError::NoBall { reason: reason.into() };
        let mirror = Mirror::from_rim(rim.axis, rim.half_angle_rad, ball.radius)
            .ok_or_else(|| no_ball("the rim is no cone in front of the camera"))?;
        let pixel = pixel_angle(&camera.lens, rim.axis)
            .ok_or_else(|| no_ball("its centre lies outside the lens's field"))?;
        let world_from_camera = camera.pose.rotation();
        let plane = support.and_then(|support| {
            let height = (ball.centre - support.point).dot(support.normal);
            let normal = world_from_camera.transpose() * support.normal;
            let touches = (height / ball.radius - 1.0).abs() < 0.2;
            (height > 0.0).then_some(Plane { normal, height, touches })
        });
        let margin = RIM_MARGIN_PX * pixel;
        let inside_rad = rim.half_angle_rad - margin;
        if inside_rad < 2.0 * margin {
            return Err(no_ball("it is smaller than ten pixels"));
        }
        let outside_rad = rim.half_angle_rad + margin;
        let lens = camera.lens.clone();
        Ok(Self { lens, mirror, world_from_camera, plane, inside_rad, outside_rad })
    }

    fn off_axis(&self, ray: DVec3) -> f64 {
        let axis = self.mirror.axis();
        axis.cross(ray).length().atan2(axis.dot(ray))
    }

    /// The point of the support in `direction` from the ball's centre, camera axes.
    fn on_support(&self, direction: DVec3) -> Option<DVec3> {
        let plane = self.plane?;
        let down = -direction.dot(plane.normal);
        (down > 1e-6).then(|| self.mirror.centre() + direction * (plane.height / down))
    }

    /// Direction from the ball's centre to what is met from `origin` along `direction`.
    fn seen_from_centre(&self, origin: DVec3, direction: DVec3) -> Option<DVec3> {
        let Some(plane) = self.plane else { return Some(direction) };
        let down = -direction.dot(plane.normal);
        if down <= 1e-6 {
            return Some(direction);
        }
        let height = plane.height + (origin - self.mirror.centre()).dot(plane.normal);
        (height > 0.0)
            .then(|| (origin + direction * (height / down) - self.mirror.centre()).normalize())
    }
}

impl Mapping for BallView {
    fn pixel(&self, direction: DVec3) -> Option<DVec2> {
        let ray = match self.on_support(direction) {
            Some(point) => self.mirror.ray_to_point(point)?,
            None => self.mirror.ray_showing(direction)?,
        };
        self.lens.project(ray)
    }

    fn direction(&self, pixel: DVec2) -> Option<DVec3> {
        let seen = self.mirror.reflect(self.lens.unproject(pixel)?)?;
        self.seen_from_centre(seen.point, seen.direction)
    }

    fn covers(&self, x: usize, y: usize) -> bool {
        let ray = self.lens.unproject(DVec2::new(x as f64, y as f64));
        ray.is_some_and(|ray| self.off_axis(ray) < self.inside_rad)
    }
}

/// The photograph beside the ball: what is seen directly, as from the ball's centre.
struct Beside<'a> {
    view: &'a BallView,
}

impl Mapping for Beside<'_> {
    fn pixel(&self, direction: DVec3) -> Option<DVec2> {
        let ray = match self.view.on_support(direction) {
            Some(point) => point.normalize(),
            None => direction,
        };
        (self.view.off_axis(ray) > self.view.outside_rad).then(|| self.view.lens.project(ray))?
    }

    fn direction(&self, pixel: DVec2) -> Option<DVec3> {
        let ray = self.view.lens.unproject(pixel)?;
        (self.view.off_axis(ray) > self.view.outside_rad)
            .then(|| self.view.seen_from_centre(DVec3::ZERO, ray))?
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Pose;
    use crate::conventions::Rgb;

    const BALL: Ball =
        Ball { centre: DVec3::new(0.1, 0.06, -0.2), radius: 0.06, reflectance: Rgb::splat(0.5) };

    /// 400 × 400 px, the ball 240 px across and off the middle.
    fn camera() -> Camera {
        let eye = DVec3::new(-0.4, 0.6, 0.5);
        let pose = Pose::look_at(eye, DVec3::new(0.12, 0.05, -0.2), DVec3::Y).unwrap();
        Camera { width: 400, height: 400, lens: Lens::pinhole(2000.0, 400, 400), pose }
    }

    fn rim(camera: &Camera) -> Rim {
        let centre = camera.pose.inverse().transform_point3(BALL.centre);
        Rim::known(centre, (BALL.radius / centre.length()).asin(), 1e-5)
    }

    /// Photographs `world(direction or support point)`: the support is y = 0, seen as a point.
    fn photograph(camera: &Camera, world: impl Fn(Option<DVec3>, DVec3) -> Rgb) -> Radiance {
        let mean = Image::from_fn(camera.width, camera.height, |x, y| {
            let (mut from, mut d) = camera.ray(DVec2::new(x as f64, y as f64)).unwrap();
            let mirror = Mirror::new(BALL.centre - from, BALL.radius).unwrap();
            let mut gain = 1.0;
            if let Some(r) = mirror.reflect(d) {
                (from, d, gain) = (from + r.point, r.direction, 0.5);
            }
            let hit = (d.y < 0.0).then(|| from - d * (from.y / d.y));
            gain * world(hit, d)
        });
        Radiance {
            variance: Image::filled(mean.width(), mean.height(), Rgb::splat(1e-6)),
            validity: Image::filled(mean.width(), mean.height(), Validity::Measured),
            mean,
        }
    }

    #[test]
    fn a_smooth_world_comes_back_in_world_axes() {
        let camera = camera();
        let colour = |d: DVec3| (d * DVec3::new(0.3, 0.2, 0.25) + 0.5).as_vec3();
        let photo = photograph(&camera, |_, d| colour(d));
        let panorama = unwrap_ball(&photo, &camera, &rim(&camera), &BALL, None, 256).unwrap();
        for y in 0..128 {
            for x in 0..256 {
                let expected = colour(panorama.direction(x, y));
                let error = (panorama.radiance[(x, y)] - expected).abs().max_element();
                let filled = panorama.validity[(x, y)] == Validity::Filled;
                // Beside the ball the world was seen directly, and so nearly right too.
                let tolerance = if filled { 0.05 } else { 0.02 };
                assert!(error < tolerance, "({x}, {y}) is {error} off, filled: {filled}");
            }
        }
        assert!(panorama.share(Validity::Filled) > 0.005);
        assert!(panorama.share(Validity::Filled) < 0.04);
        assert_eq!(panorama.place, BALL.centre);
    }

    #[test]
    fn support_is_seen_where_it_is_from_the_centre() {
        let camera = camera();
        // Rings round the contact: from the centre, a function of the angle to the nadir alone.
        let rings = |hit: Option<DVec3>| match hit {
            Some(p) => {
                let r = (p - BALL.centre.with_y(0.0)).length() / BALL.radius;
                Rgb::splat((0.5 + 0.5 * (r / (1.0 + 0.1 * r)).sin()) as f32)
            }
            None => Rgb::splat(0.5),
        };
        let photo = photograph(&camera, |hit, _| rings(hit));
        let support = Support { point: DVec3::ZERO, normal: DVec3::Y };
        let rim = rim(&camera);
        let panorama = unwrap_ball(&photo, &camera, &rim, &BALL, Some(&support), 256).unwrap();
        let (mut squares, mut n) = (0.0, 0.0);
        for y in 70..100 {
            for x in 0..256 {
                let d = panorama.direction(x, y);
                let hit = BALL.centre - d * (BALL.centre.y / d.y);
                if panorama.validity[(x, y)] == Validity::Filled {
                    continue;
                }
                squares += f64::from((panorama.radiance[(x, y)] - rings(Some(hit))).x).powi(2);
                n += 1.0;
            }
        }
        // The rings swing by 1; what is left is interpolation near the rim.
        assert!(n > 5000.0 && (squares / n).sqrt() < 0.02, "rms {} of {n}", (squares / n).sqrt());
        let down = panorama.validity[(7, 127)];
        assert_eq!(down, Validity::Filled, "the contact is filled");
    }

    #[test]
    fn tiny_balls_and_odd_widths_are_refused() {
        let camera = camera();
        let photo = photograph(&camera, |_, _| Rgb::ONE);
        let small = Rim::known(DVec3::NEG_Z, 0.001, 0.0);
        assert!(unwrap_ball(&photo, &camera, &small, &BALL, None, 256).is_err());
        for width in [0, 15, 257, usize::MAX] {
            assert!(unwrap_ball(&photo, &camera, &rim(&camera), &BALL, None, width).is_err());
        }
    }
}
