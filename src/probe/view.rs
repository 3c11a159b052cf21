//! One of several panoramas of a place: what it shows, how finely, and where its camera stood.

use std::path::Path;

use glam::{DMat3, DQuat, DVec3};
use serde::{Deserialize, Serialize};

use super::ProbeError;
use super::axes::Axes;
use super::ball::Mirror;
use super::file::{self, Layout};
use super::fisheye::{Fisheye, Projection};
use super::mapping::LatLong;
use super::panorama::Panorama;
use super::resample::to_lat_long;
use super::rim::Rim;
use super::unwrap::pixel_angle;
use crate::bracket::{Radiance, Validity};
use crate::camera::Lens;
use crate::conventions::Rgb;
use crate::photo::{self, Image, ReadOptions};

/// Through what a panorama was seen; directions in its world's axes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "probe", rename_all = "snake_case")]
pub enum Seeing {
    /// A mirror ball: finest towards its own camera, which it shows, and blind behind.
    Ball {
        /// Unit direction from the ball.
        #[serde(with = "as_array")]
        toward_camera: DVec3,
        /// Half-angle of the rim's cone.
        half_angle_rad: f64,
        /// The photograph's pixels per radian at the ball.
        px_per_rad: f64,
    },
    /// A fisheye: it does not show its own camera.
    Fisheye {
        /// Unit direction in the middle of the picture.
        #[serde(with = "as_array")]
        axis: DVec3,
        projection: Projection,
        focal_px: f64,
        /// Largest angle off the axis that is shown.
        edge_rad: f64,
    },
    /// Nobody knows: as fine everywhere as the texels.
    Even { px_per_deg: f64 },
}

impl Seeing {
    /// A photographed ball; `rim` and `lens` in camera axes.
    ///
    /// # Errors
    /// A rim that this lens cannot see.
    pub fn ball(lens: &Lens, rim: &Rim, world_from_camera: DMat3) -> Result<Self, ProbeError> {
        let pixel = pixel_angle(lens, rim.axis).ok_or_else(|| ProbeError::NoBall {
            reason: "its centre lies outside the lens's field".into(),
        })?;
        Ok(Self::Ball {
            toward_camera: (world_from_camera * -rim.axis).normalize(),
            half_angle_rad: rim.half_angle_rad,
            px_per_rad: 1.0 / pixel,
        })
    }

    /// A fisheye photograph; `world_from_lens` as for
    /// [`photographed::fisheye`](super::photographed::fisheye).
    pub fn fisheye(fisheye: &Fisheye, world_from_lens: DQuat) -> Self {
        Self::Fisheye {
            axis: world_from_lens * DVec3::NEG_Z,
            projection: fisheye.projection(),
            focal_px: fisheye.focal_px(),
            edge_rad: fisheye.edge_rad(),
        }
    }

    /// Unit direction in which the probe shows its own camera and the photographer, if it does.
    pub fn toward_camera(&self) -> Option<DVec3> {
        match *self {
            Self::Ball { toward_camera, .. } => Some(toward_camera),
            _ => None,
        }
    }

    /// The same in a world turned by `rotation`.
    pub fn rotated(self, rotation: DQuat) -> Self {
        match self {
            Self::Ball { toward_camera, half_angle_rad, px_per_rad } => {
                Self::Ball { toward_camera: rotation * toward_camera, half_angle_rad, px_per_rad }
            }
            Self::Fisheye { axis, projection, focal_px, edge_rad } => {
                Self::Fisheye { axis: rotation * axis, projection, focal_px, edge_rad }
            }
            even => even,
        }
    }

    /// Pixels of the photograph per degree in each direction (unit), along the way in which it is coarser:
    /// away from the axis. `(R/2) cos(θ/2)` pixels per radian for a far ball.
    pub fn resolution(&self) -> impl Fn(DVec3) -> f64 + Sync {
        let seeing = *self;
        let mirror = match seeing {
            // The radius is the unit of length: only directions are asked for.
            Self::Ball { toward_camera, half_angle_rad, .. } => {
                Mirror::from_rim(-toward_camera, half_angle_rad, 1.0)
            }
            _ => None,
        };
        move |d| match seeing {
            Self::Ball { px_per_rad, .. } => {
                mirror.map_or(0.0, |mirror| mirror.ray_rate(d)) * px_per_rad * 1f64.to_radians()
            }
            Self::Fisheye { axis, projection, focal_px, edge_rad } => {
                let theta = axis.angle_between(d);
                let px_per_rad = focal_px * projection.rate(theta);
                if theta <= edge_rad { px_per_rad * 1f64.to_radians() } else { 0.0 }
            }
            Self::Even { px_per_deg } => px_per_deg,
        }
    }

    /// Whether every number is one that a photograph can have.
    fn is_plausible(&self) -> bool {
        let unit = |d: DVec3| (d.length() - 1.0).abs() < 1e-3;
        let positive = |v: f64| v.is_finite() && v > 0.0;
        match *self {
            Self::Ball { toward_camera, half_angle_rad, px_per_rad } => {
                unit(toward_camera) && positive(px_per_rad) && (1e-4..1.5).contains(&half_angle_rad)
            }
            Self::Fisheye { axis, focal_px, edge_rad, .. } => {
                unit(axis) && positive(focal_px) && (0.0..3.2).contains(&edge_rad)
            }
            Self::Even { px_per_deg } => positive(px_per_deg),
        }
    }
}

/// A direction in a file: `[x, y, z]`.
mod as_array {
    use super::{DVec3, Deserialize, Serialize};

    pub fn serialize<S: serde::Serializer>(d: &DVec3, to: S) -> Result<S::Ok, S::Error> {
        d.to_array().serialize(to)
    }

    pub fn deserialize<'a, D: serde::Deserializer<'a>>(from: D) -> Result<DVec3, D::Error> {
        <[f64; 3]>::deserialize(from).map(DVec3::from)
    }
}

/// A panorama with what weighs it against another of the same place.
#[derive(Clone, Debug)]
pub struct View {
    pub panorama: Panorama,
    pub seeing: Seeing,
}

impl View {
    /// A panorama of which nothing more is known.
    pub fn even(panorama: Panorama) -> Self {
        let px_per_deg = panorama.width() as f64 / 360.0;
        Self { panorama, seeing: Seeing::Even { px_per_deg } }
    }

    /// Reads a panorama, with what its file says of how it is laid out and was seen; a lat-long in OpenEXR's
    /// axes where it says nothing.
    ///
    /// # Errors
    /// As [`file::read`], and comments of ours that were tampered with.
    pub fn read(path: &Path, options: &ReadOptions) -> Result<(Self, Vec<String>), ProbeError> {
        let (layout, seeing) = stored(path)?;
        let read = file::read(path, layout, DQuat::IDENTITY, None, options)?;
        let mut view = Self::even(read.panorama);
        view.seeing = seeing.unwrap_or(view.seeing);
        let mut remarks = read.remarks;
        remarks.extend(read.negative.map(|n| format!("{}: {n}", path.display())));
        Ok((view, remarks))
    }

    /// The same view turned by `rotation` in the world; no texel is touched.
    pub fn rotated(self, rotation: DQuat) -> Self {
        Self { panorama: self.panorama.rotated(rotation), seeing: self.seeing.rotated(rotation) }
    }

    /// The same view with texels in the world's axes, `width` across; resampled where that differs.
    pub fn in_world_axes(&self, width: usize) -> Self {
        let panorama = &self.panorama;
        let turn = panorama.world_from_panorama;
        if turn.angle_between(DQuat::IDENTITY) < 1e-12 && width == panorama.width() {
            return self.clone();
        }
        let mapping = LatLong { width: panorama.width(), height: panorama.height() };
        let back = DMat3::from_quat(turn.conjugate());
        let light = Radiance {
            mean: panorama.radiance.clone(),
            variance: panorama.variance.clone(),
            validity: panorama.validity.clone(),
        };
        let mut turned = to_lat_long(&light, &mapping, back, width);
        turned.place = panorama.place;
        let coverage = Radiance {
            mean: panorama.coverage.map(|c| Rgb::splat(*c)),
            variance: panorama.coverage.map(|_| Rgb::ZERO),
            validity: panorama.coverage.map(|_| Validity::Measured),
        };
        turned.coverage = to_lat_long(&coverage, &mapping, back, width).radiance.map(|c| c.x);
        Self { panorama: turned, seeing: self.seeing }
    }

    /// Whether each texel was really seen and not filled.
    pub(super) fn seen(&self) -> Image<bool> {
        let panorama = &self.panorama;
        Image::from_fn(panorama.width(), panorama.height(), |x, y| {
            panorama.coverage[(x, y)] >= 0.5 && panorama.validity[(x, y)] != Validity::Filled
        })
    }
}

/// What a panorama's file says of its layout and of how it was seen; files of other programs say nothing.
fn stored(path: &Path) -> Result<(Layout, Option<Seeing>), ProbeError> {
    let nothing = (Layout::LatLong(Axes::OpenExr), None);
    let Some(comments) = photo::read_comments(path)? else { return Ok(nothing) };
    let Ok(comments) = serde_json::from_str::<serde_json::Value>(&comments) else {
        return Ok(nothing);
    };
    let layout = match comments.get("mapping").and_then(|mapping| mapping.as_str()) {
        Some(name) => Layout::named(name)?,
        None => nothing.0,
    };
    let Some(stored) = comments.get("seen_through") else { return Ok((layout, None)) };
    let seeing = serde_json::from_value(stored.clone()).ok().filter(Seeing::is_plausible);
    let seeing = seeing.ok_or_else(|| ProbeError::Value {
        what: "seen_through in the comments of the panorama's file",
        found: format!("{}: {stored}", path.display()),
        expected: "what platelight panorama writes; write the panorama again",
    })?;
    Ok((layout, Some(seeing)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Lens;

    fn constant() -> Panorama {
        Panorama::from_radiance(Image::filled(128, 64, Rgb::ONE))
    }

    #[test]
    fn a_ball_is_finest_toward_its_camera_and_a_fisheye_on_its_axis() {
        let rim = Rim::known(DVec3::new(0.1, 0.0, -1.0), 0.05, 0.0);
        let turn = DQuat::from_rotation_y(1.0);
        let lens = Lens::pinhole(2000.0, 800, 800);
        let ball = Seeing::ball(&lens, &rim, DMat3::from_quat(turn)).unwrap();
        let camera = ball.toward_camera().unwrap();
        assert!((camera - turn * -rim.axis).length() < 1e-12);
        // R = 2000 · 0.05 px: 100/2 px per radian facing and a little more at 20 radii, half of it at 120°.
        let aside = DQuat::from_axis_angle(camera.any_orthonormal_vector(), 120f64.to_radians());
        assert!((ball.resolution()(camera) - 0.87).abs() < 0.05);
        assert!((ball.resolution()(aside * camera) - 0.44).abs() < 0.05);
        assert_eq!(ball.resolution()(-camera), 0.0);
        let lens = Fisheye::new(Projection::Equidistant, 180.0, None, [360, 360]).unwrap();
        let fisheye = Seeing::fisheye(&lens, turn);
        // 180 px of radius show 90°.
        assert!((fisheye.resolution()(turn * DVec3::NEG_Z) - 2.0).abs() < 1e-9);
        assert_eq!(fisheye.resolution()(turn * DVec3::Z), 0.0);
        assert_eq!(fisheye.toward_camera(), None);
    }

    #[test]
    fn turning_a_view_turns_all_of_it() {
        let mut view = View::even(constant());
        for y in 0..64 {
            for x in 0..128 {
                let d = view.panorama.direction(x, y);
                view.panorama.radiance[(x, y)] = Rgb::splat((2.0 + d.x) as f32);
            }
        }
        view.seeing =
            Seeing::Ball { toward_camera: DVec3::X, half_angle_rad: 0.1, px_per_rad: 1e3 };
        let turned = view.rotated(DQuat::from_rotation_z(1.2)).in_world_axes(256);
        let camera = turned.seeing.toward_camera().unwrap();
        for y in 2..126 {
            for x in 0..256 {
                let along = turned.panorama.direction(x, y).dot(camera) as f32;
                assert!((turned.panorama.radiance[(x, y)].x - 2.0 - along).abs() < 0.02);
            }
        }
    }

    #[test]
    fn how_a_panorama_was_seen_survives_its_file_and_nonsense_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("view.exr");
        let seeing = Seeing::Ball { toward_camera: DVec3::X, half_angle_rad: 0.1, px_per_rad: 1e3 };
        file::write_seen(&path, &constant(), Some(&seeing)).unwrap();
        let (back, remarks) = View::read(&path, &ReadOptions::default()).unwrap();
        assert_eq!((back.seeing, remarks.len()), (seeing, 0));
        // A panorama of which nothing is said is even.
        file::write(&path, &constant()).unwrap();
        let (even, _) = View::read(&path, &ReadOptions::default()).unwrap();
        assert_eq!(even.seeing, Seeing::Even { px_per_deg: 128.0 / 360.0 });
        let seeing = Seeing::Ball { toward_camera: DVec3::X, half_angle_rad: 9.0, px_per_rad: 1e3 };
        file::write_seen(&path, &constant(), Some(&seeing)).unwrap();
        let said = View::read(&path, &ReadOptions::default()).unwrap_err().to_string();
        assert!(said.contains("view.exr") && said.contains("again"), "{said}");
    }
}
