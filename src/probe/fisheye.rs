//! Fisheye photographs: the four textbook projections.
//!
//! r(θ) = fθ, 2f sin(θ/2), 2f tan(θ/2), f sin θ; solid angle per pixel area `sin θ/(r dr/dθ)`. Axes are
//! the camera's: −Z in the middle, +Y up.

use std::f64::consts::PI;

use glam::{DVec2, DVec3};
use serde::{Deserialize, Serialize};

use super::ProbeError;
use super::mapping::{Mapping, from_axis};

/// How the distance from the middle grows with the angle θ off the axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Projection {
    /// r = f θ
    Equidistant,
    /// r = 2 f sin(θ/2)
    Equisolid,
    /// r = 2 f tan(θ/2)
    Stereographic,
    /// r = f sin θ, up to 90°
    Orthographic,
}

impl Projection {
    /// r/f.
    fn radius(self, theta: f64) -> f64 {
        match self {
            Self::Equidistant => theta,
            Self::Equisolid => 2.0 * (theta / 2.0).sin(),
            Self::Stereographic => 2.0 * (theta / 2.0).tan(),
            Self::Orthographic => theta.sin(),
        }
    }

    fn angle(self, radius: f64) -> f64 {
        match self {
            Self::Equidistant => radius,
            Self::Equisolid => 2.0 * (radius / 2.0).clamp(-1.0, 1.0).asin(),
            Self::Stereographic => 2.0 * (radius / 2.0).atan(),
            Self::Orthographic => radius.clamp(-1.0, 1.0).asin(),
        }
    }

    /// d(r/f)/dθ.
    pub fn rate(self, theta: f64) -> f64 {
        match self {
            Self::Equidistant => 1.0,
            Self::Equisolid => (theta / 2.0).cos(),
            Self::Stereographic => (theta / 2.0).cos().powi(-2),
            Self::Orthographic => theta.cos(),
        }
    }

    /// Largest angle off the axis that it can show, radians.
    fn limit(self) -> f64 {
        match self {
            Self::Equidistant | Self::Equisolid => PI,
            Self::Stereographic => 0.95 * PI,
            Self::Orthographic => PI / 2.0,
        }
    }
}

/// A fisheye photograph's image circle.
///
/// # Guarantees
/// Positive focal length; a field that the projection can show.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fisheye {
    projection: Projection,
    focal_px: f64,
    centre: DVec2,
    /// Largest angle off the axis that is used, radians.
    edge_rad: f64,
}

/// Largest radius of an image circle, px: several times the longest picture.
const LARGEST_PX: f64 = 1e6;

impl Fisheye {
    /// The fisheye whose image circle spans `fov_deg` from edge to edge of a picture of this size.
    ///
    /// `circle_px` is its centre u, v and radius; `None`: inscribed in the picture.
    ///
    /// # Errors
    /// A field that the projection cannot show, or a circle that shows nowhere in the picture.
    pub fn new(
        projection: Projection,
        fov_deg: f64,
        circle_px: Option<[f64; 3]>,
        size: [usize; 2],
    ) -> Result<Self, ProbeError> {
        let edge_rad = fov_deg.to_radians() / 2.0;
        if !(edge_rad > 0.0 && edge_rad <= projection.limit() + 1e-9) {
            return Err(ProbeError::Value {
                what: "the fisheye's field (fov_deg)",
                found: format!("{fov_deg}°"),
                expected: "above 0° and within 180° (orthographic), 342° (stereographic) or 360°",
            });
        }
        let [width, height] = size.map(|n| n as f64);
        let inscribed = [(width - 1.0) / 2.0, (height - 1.0) / 2.0, width.min(height) / 2.0];
        let [u, v, radius_px] = circle_px.unwrap_or(inscribed);
        let shows = |at: f64, size: f64| (-radius_px..=size + radius_px).contains(&at);
        let possible = (1.0..=LARGEST_PX).contains(&radius_px);
        if !(possible && shows(u, width) && shows(v, height)) {
            return Err(ProbeError::Value {
                what: "the fisheye's image circle (circle_px)",
                found: format!("[{u:?}, {v:?}], {radius_px:?}"),
                expected: "a centre u, v and a radius of at least one pixel, in or near the picture",
            });
        }
        let focal_px = radius_px / projection.radius(edge_rad);
        Ok(Self { projection, focal_px, centre: DVec2::new(u, v), edge_rad })
    }

    pub fn projection(&self) -> Projection {
        self.projection
    }

    /// Pixels per radian on the axis.
    pub fn focal_px(&self) -> f64 {
        self.focal_px
    }

    /// Largest angle off the axis that is used, radians.
    pub fn edge_rad(&self) -> f64 {
        self.edge_rad
    }

    /// Radius of the image circle.
    pub fn radius_px(&self) -> f64 {
        self.focal_px * self.projection.radius(self.edge_rad)
    }

    /// Distance of `pixel` from the middle as a share of the circle's radius, and its angle off the axis,
    /// radians; `None` outside of the circle.
    pub fn off_axis(&self, pixel: DVec2) -> Option<(f64, f64)> {
        let radius = (pixel - self.centre).length();
        let share = radius / self.radius_px();
        (share <= 1.0).then(|| (share, self.projection.angle(radius / self.focal_px)))
    }
}

impl Mapping for Fisheye {
    fn pixel(&self, direction: DVec3) -> Option<DVec2> {
        let sideways = DVec2::new(direction.x, -direction.y);
        let theta = sideways.length().atan2(-direction.z);
        // A little past the edge, so that texels on it interpolate.
        (theta < self.projection.limit().min(self.edge_rad * 1.02)).then(|| {
            let way = sideways.try_normalize().unwrap_or(DVec2::X);
            self.centre + way * (self.focal_px * self.projection.radius(theta))
        })
    }

    fn direction(&self, pixel: DVec2) -> Option<DVec3> {
        let p = (pixel - self.centre) / self.focal_px;
        let r = p.length();
        (r <= self.projection.radius(self.edge_rad) * (1.0 + 1e-12))
            .then(|| from_axis(self.projection.angle(r), p))
    }

    fn solid_angle(&self, pixel: DVec2) -> Option<f64> {
        let r = (pixel - self.centre).length() / self.focal_px;
        if r > self.projection.radius(self.edge_rad) {
            return None;
        }
        let theta = self.projection.angle(r);
        let ratio = if theta > 1e-7 { theta.sin() / r } else { 1.0 };
        Some(ratio / self.projection.rate(theta).max(1e-6) / self.focal_px.powi(2))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: [(Projection, f64); 4] = [
        (Projection::Equidistant, 220.0),
        (Projection::Equisolid, 220.0),
        (Projection::Stereographic, 220.0),
        (Projection::Orthographic, 180.0),
    ];

    #[test]
    fn circles_that_show_nowhere_in_the_picture_are_refused() {
        let at = |u: f64, v: f64, r: f64| {
            Fisheye::new(Projection::Equidistant, 180.0, Some([u, v, r]), [64, 48])
        };
        assert!(at(32.0, 24.0, 30.0).is_ok() && at(-20.0, 24.0, 30.0).is_ok());
        for (u, v, r) in [(0.0, 0.0, 1e300), (1e9, 1e9, 5.0), (-40.0, 24.0, 30.0), (0.0, 1e5, 9.0)]
        {
            let said = at(u, v, r).unwrap_err().to_string();
            assert!(said.contains("circle"), "{said}");
        }
    }

    #[test]
    fn pixels_invert_directions() {
        for (projection, fov) in ALL {
            let fisheye = Fisheye::new(projection, fov, None, [1000, 900]).unwrap();
            for k in 0..500 {
                let theta = 0.499 * fov.to_radians() * (k as f64 / 499.0).sqrt();
                let direction = from_axis(theta, DVec2::from_angle(k as f64));
                let back = fisheye.direction(fisheye.pixel(direction).unwrap()).unwrap();
                assert!(back.angle_between(direction) < 1e-6, "{projection:?} {theta}");
            }
        }
    }

    #[test]
    fn solid_angles_add_up_to_the_cap() {
        for (projection, fov) in ALL {
            let fisheye = Fisheye::new(projection, fov, None, [600, 600]).unwrap();
            let sum: f64 = (0..600 * 600)
                .filter_map(|k| fisheye.solid_angle(DVec2::new((k % 600) as f64, (k / 600) as f64)))
                .sum();
            let cap = 2.0 * PI * (1.0 - (fov.to_radians() / 2.0).cos());
            // The orthographic edge is infinitely steep.
            let tolerance = if projection == Projection::Orthographic { 2e-2 } else { 3e-3 };
            assert!((sum / cap - 1.0).abs() < tolerance, "{projection:?}: {sum} of {cap}");
        }
    }

    #[test]
    fn up_is_up_and_right_is_right() {
        let fisheye = Fisheye::new(Projection::Equidistant, 180.0, None, [401, 401]).unwrap();
        let at = |d: DVec3| fisheye.pixel(d).unwrap();
        assert!((at(DVec3::NEG_Z) - 200.0).length() < 1e-12);
        assert!((at(DVec3::X) - DVec2::new(400.5, 200.0)).length() < 1e-9);
        assert!((at(DVec3::Y) - DVec2::new(200.0, -0.5)).length() < 1e-9);
        assert!(fisheye.pixel(DVec3::Z).is_none());
    }

    #[test]
    fn impossible_fields_and_circles_are_refused() {
        let new = |p, fov, r| Fisheye::new(p, fov, Some([0.0, 0.0, r]), [200, 200]);
        assert!(new(Projection::Orthographic, 190.0, 100.0).is_err());
        assert!(new(Projection::Equisolid, f64::NAN, 100.0).is_err());
        assert!(new(Projection::Equidistant, -3.0, 100.0).is_err());
        assert!(new(Projection::Equidistant, 180.0, 0.0).is_err());
    }
}
