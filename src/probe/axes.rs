//! Which way a lat-long picture looks: the conventions of the programs that read and write them.
//!
//! A convention is a fixed rotation of ours, OpenEXR's axes, and for one of them a mirror:
//!
//! | name | middle column | left of it by a quarter | source |
//! |---|---|---|---|
//! | `openexr`, `usd`, `mitsuba` | +Z | +X | ImfEnvmap.h; UsdLux DomeLight; `atan2(x, −z)` from the left edge |
//! | `blender`, `cycles`, `threejs` | +X | −Z | Cycles `u = ½ − atan2(y, x)/2π` with +Z up, brought here by glTF's axes (x, y, z) → (x, z, −y); three.js `u = ½ + atan(z, x)/2π` |
//! | `debevec`, `hdrshop` | −Z | −X | `u = 1 + atan2(Dx, −Dz)/π` of 0…2 |
//! | `pbrt-v3` | −X | −Z, as if seen from outside | `u = φ/2π`, φ = atan2(y, x), light +Z up by `Rotate -90 1 0 0`; pbrt's axes are left-handed, so that numbers copied from a right-handed scene see a mirrored picture |
//!
//! +Y is up in all of them. Rotations about +Y by whole columns move texels without touching them.

use glam::{DMat3, DVec2, DVec3};

use super::ProbeError;
use super::mapping::{LatLong, Mapping};
use crate::photo::Image;

/// Where a lat-long picture's axes point.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Axes {
    /// The middle is +Z, +X left of it: ours, OpenEXR's, USD's and Mitsuba's.
    #[default]
    OpenExr,
    /// The middle is +X, −Z left of it: Blender (after glTF's change of axes) and three.js.
    Blender,
    /// The middle is −Z, −X left of it: Debevec's light probes and HDRShop.
    Debevec,
    /// The middle is −X, −Z left of it, mirrored: pbrt-v3.
    Pbrt,
}

/// All names, each with what it means.
pub const NAMES: [(&str, Axes); 9] = [
    ("openexr", Axes::OpenExr),
    ("usd", Axes::OpenExr),
    ("mitsuba", Axes::OpenExr),
    ("blender", Axes::Blender),
    ("cycles", Axes::Blender),
    ("threejs", Axes::Blender),
    ("debevec", Axes::Debevec),
    ("hdrshop", Axes::Debevec),
    ("pbrt-v3", Axes::Pbrt),
];

impl Axes {
    /// The convention of this name.
    ///
    /// # Errors
    /// A name that is none, with all that are.
    pub fn named(name: &str) -> Result<Self, ProbeError> {
        let known = NAMES.iter().find(|(known, _)| *known == name);
        known.map(|&(_, axes)| axes).ok_or_else(|| ProbeError::Name {
            what: "axes of a lat-long",
            found: name.into(),
            known: NAMES.map(|(name, _)| name).join(", "),
        })
    }

    /// The first of its names.
    pub fn name(self) -> &'static str {
        NAMES.iter().find(|(_, axes)| *axes == self).map_or("openexr", |(name, _)| name)
    }

    /// What its middle and its left show, for people.
    pub fn description(self) -> &'static str {
        match self {
            Self::OpenExr => "+Z in the middle, +X left of it, +Y up",
            Self::Blender => "+X in the middle, -Z left of it, +Y up",
            Self::Debevec => "-Z in the middle, -X left of it, +Y up",
            Self::Pbrt => "-X in the middle, -Z left of it, +Y up, mirrored",
        }
    }

    /// Takes a direction of the world to OpenEXR's axes of the picture; mirrors for pbrt-v3.
    pub fn picture_from_world(self) -> DMat3 {
        // Columns: where +X, +Y and +Z of the world are in the picture, whose middle is +Z and whose left +X.
        let [x, z] = match self {
            Self::OpenExr => [DVec3::X, DVec3::Z],
            Self::Blender => [DVec3::Z, DVec3::NEG_X],
            Self::Debevec => [DVec3::NEG_X, DVec3::NEG_Z],
            Self::Pbrt => [DVec3::NEG_Z, DVec3::NEG_X],
        };
        DMat3::from_cols(x, DVec3::Y, z)
    }
}

/// Which column of a lat-long of `width` px each column of another one shows, if a turn between the two is
/// only that: columns in another place, perhaps from right to left.
///
/// `source_from_target` takes directions of the target's axes to the source's.
pub fn moved_columns(source_from_target: DMat3, width: usize) -> Option<Vec<usize>> {
    if (source_from_target * DVec3::Y - DVec3::Y).length() > 1e-12 {
        return None;
    }
    let lat_long = LatLong { width, height: 2 };
    (0..width)
        .map(|x| {
            let direction = lat_long.direction(DVec2::new(x as f64, 0.5))?;
            let there = lat_long.pixel(source_from_target * direction)?.x;
            let whole = (there - there.round()).abs() < 1e-6;
            whole.then(|| (there.round() as i64).rem_euclid(width as i64) as usize)
        })
        .collect()
}

/// The picture with column `columns[x]` in the place of column x.
pub fn with_columns<T: Clone>(image: &Image<T>, columns: &[usize]) -> Image<T> {
    Image::from_fn(image.width(), image.height(), |x, y| image[(columns[x], y)].clone())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    /// Place of a world direction in a 400 × 200 picture, as shares of its width and height.
    fn at(axes: Axes, d: DVec3) -> DVec2 {
        let lat_long = LatLong { width: 400, height: 200 };
        let p = lat_long.pixel(axes.picture_from_world() * d).unwrap();
        (p + 0.5) / DVec2::new(400.0, 200.0)
    }

    fn directions() -> impl Iterator<Item = DVec3> {
        (0..200).map(|k| {
            let y = 1.0 - 2.0 * (k as f64 + 0.5) / 200.0;
            let turn = k as f64 * 2.399_963_229_728_653;
            let level = (1.0 - y * y).sqrt();
            DVec3::new(level * turn.cos(), y, level * turn.sin())
        })
    }

    /// Each convention's own formula, from its program's source or documentation.
    #[test]
    fn conventions_are_those_of_their_programs() {
        let same = |axes: Axes, d: DVec3, u: f64| {
            let off = (at(axes, d).x - u).rem_euclid(1.0);
            assert!(off.min(1.0 - off) < 1e-9, "{axes:?} {d}: {} is not {u}", at(axes, d).x);
        };
        for d in directions() {
            // Mitsuba 3, envmap.cpp
            same(Axes::OpenExr, d, d.x.atan2(-d.z) / (2.0 * PI));
            // Cycles, with glTF's axes: Blender's (x, y, z) = ours (x, −z, y)
            same(Axes::Blender, d, 0.5 - (-d.z).atan2(d.x) / (2.0 * PI));
            // three.js, equirectUv
            same(Axes::Blender, d, 0.5 + d.z.atan2(d.x) / (2.0 * PI));
            // Debevec: u of 0…2
            same(Axes::Debevec, d, 0.5 * (1.0 + d.x.atan2(-d.z) / PI));
            // pbrt-v3, InfiniteAreaLight: (x, y, z) of the light = (x, −z, y)
            same(Axes::Pbrt, d, (-d.z).atan2(d.x) / (2.0 * PI));
            for (_, axes) in NAMES {
                assert!((at(axes, d).y - d.y.acos() / PI).abs() < 1e-9, "rows are alike");
            }
        }
    }

    #[test]
    fn only_pbrt_mirrors() {
        for (name, axes) in NAMES {
            let turned = axes.picture_from_world().determinant();
            let wanted = if axes == Axes::Pbrt { -1.0 } else { 1.0 };
            assert!((turned - wanted).abs() < 1e-15, "{name}");
            assert_eq!(Axes::named(name).unwrap(), axes);
        }
        let said = Axes::named("maya").unwrap_err().to_string();
        assert!(said.contains("maya") && said.contains("debevec"), "{said}");
    }

    #[test]
    fn quarter_turns_and_mirrors_move_columns_and_other_turns_do_not() {
        for (_, axes) in NAMES {
            let source_from_target = axes.picture_from_world().transpose();
            let columns = moved_columns(source_from_target, 16).expect("whole columns");
            let picture = Image::from_fn(16, 8, |x, y| 100 * y + x);
            let moved = with_columns(&picture, &columns);
            for y in 0..8 {
                for x in 0..16 {
                    let lat_long = LatLong { width: 16, height: 8 };
                    let there = lat_long.direction(DVec2::new(x as f64, y as f64)).unwrap();
                    let from = lat_long.pixel(source_from_target * there).unwrap().round();
                    let from = (from.x.rem_euclid(16.0) as usize, from.y as usize);
                    assert_eq!(moved[(x, y)], picture[from], "{axes:?}");
                }
            }
        }
        assert!(moved_columns(DMat3::from_rotation_y(0.1), 16).is_none());
        assert!(moved_columns(DMat3::from_rotation_x(PI), 16).is_none());
        assert!(moved_columns(DMat3::from_rotation_y(PI / 2.0), 10).is_none(), "2½ columns");
    }
}
