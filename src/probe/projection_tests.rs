//! All pairs of projections: directions, constant light, and the sun's flux and place.

use std::f64::consts::PI;

use glam::{DMat3, DQuat, DVec2, DVec3};

use super::axes::NAMES;
use super::cube::{Cube, CubeFaces, CubeLayout};
use super::fisheye::{Fisheye, Projection};
use super::layout::Layout;
use super::lens_picture::LensPicture;
use super::mapping::{Angular, BallMap, LatLong, Mapping, spread_directions};
use super::panorama::Panorama;
use super::resample::resample;
use super::scatter::texel_solid_angle;
use super::{file, picture_file};
use crate::bracket::{Radiance, Validity};
use crate::camera::{Distortion, Lens};
use crate::conventions::{Rgb, lat_long_direction};
use crate::photo::Image;

struct Projected {
    name: String,
    mapping: Box<dyn Mapping>,
    size: (usize, usize),
}

/// Every projection there is, about `size` px across.
fn projections(size: usize) -> Vec<Projected> {
    let mut all = Vec::new();
    let mut add = |name: String, mapping: Box<dyn Mapping>, size: (usize, usize)| {
        all.push(Projected { name, mapping, size });
    };
    let square = (size, size);
    let lat_long = LatLong { width: size, height: size / 2 };
    add("lat-long".into(), Box::new(lat_long), (size, size / 2));
    add("angular".into(), Box::new(Angular { size }), square);
    add("ball".into(), Box::new(BallMap { size }), square);
    for layout in
        [CubeLayout::Cross, CubeLayout::VerticalCross, CubeLayout::Strip, CubeLayout::Column]
    {
        for faces in [CubeFaces::Inside, CubeFaces::OpenGl] {
            let cube = Cube::new(layout, faces, size / 4);
            add(format!("{layout:?} {faces:?}"), Box::new(cube), cube.size());
        }
    }
    for (projection, field) in [
        (Projection::Equidistant, 220.0),
        (Projection::Equisolid, 220.0),
        (Projection::Stereographic, 220.0),
        (Projection::Orthographic, 180.0),
    ] {
        let fisheye = Fisheye::new(projection, field, None, [size, size]).unwrap();
        add(format!("fisheye {projection:?}"), Box::new(fisheye), square);
    }
    let lens = |focal: f64, distortion: Distortion| {
        let lens = Lens { distortion, ..Lens::pinhole(focal * size as f64, size, size) };
        Box::new(LensPicture::new(lens, size, size).unwrap())
    };
    let kannala_brandt = Distortion::KannalaBrandt { k1: -0.01, k2: 0.004, k3: -0.002, k4: 3e-4 };
    add("Kannala-Brandt".into(), lens(0.3, kannala_brandt), square);
    let brown = Distortion::BrownConrady { k1: -0.1, k2: 0.02, p1: 1e-3, p2: -1e-3, k3: 0.0 };
    add("Brown-Conrady".into(), lens(0.8, brown), square);
    all
}

fn there_and_back(projected: &Projected, direction: DVec3) -> Option<DVec3> {
    projected.mapping.direction(projected.mapping.pixel(direction)?)
}

#[test]
fn every_pair_of_projections_returns_every_direction() {
    let all = projections(512);
    let mut returned = 0;
    for from in &all {
        for to in &all {
            for direction in spread_directions(500) {
                let Some(back) =
                    there_and_back(from, direction).and_then(|seen| there_and_back(to, seen))
                else {
                    continue;
                };
                let off = back.angle_between(direction);
                assert!(off < 1e-6, "{} to {}: {direction} is {off} off", from.name, to.name);
                returned += 1;
            }
        }
    }
    // What both show: at least a narrow lens's field of all pairs, everything of most.
    assert!(returned > all.len() * all.len() * 500 / 3, "{returned}");
    for whole in all.iter().filter(|p| !p.name.contains("fisheye") && !p.name.contains('-')) {
        let seen = spread_directions(500).filter(|&d| there_and_back(whole, d).is_some()).count();
        assert_eq!(seen, 500, "{} shows all directions", whole.name);
    }
}

#[test]
fn constant_light_stays_constant_through_every_pair_of_projections() {
    let constant = Rgb::new(0.25, 1.0, 3.0);
    let all = projections(48);
    let turn = DMat3::from_rotation_y(0.3) * DMat3::from_rotation_x(0.2);
    for from in &all {
        let (w, h) = from.size;
        let source = Radiance {
            // Outside of what the projection shows there is other light, which must stay there.
            mean: Image::from_fn(w, h, |x, y| match from.mapping.covers(x, y) {
                true => constant,
                false => Rgb::splat(1e6),
            }),
            variance: Image::filled(w, h, Rgb::ZERO),
            validity: Image::filled(w, h, Validity::Measured),
        };
        for to in &all {
            let out = resample(&source, &*from.mapping, &*to.mapping, to.size, turn);
            let mut seen = 0.0;
            for y in 0..to.size.1 {
                for x in 0..to.size.0 {
                    if out.coverage[(x, y)] <= 0.0 {
                        assert_eq!(out.light.mean[(x, y)], Rgb::ZERO);
                        continue;
                    }
                    let off = (out.light.mean[(x, y)] / constant - 1.0).abs().max_element();
                    assert!(off < 1e-5, "{} to {} at ({x}, {y}): {off}", from.name, to.name);
                    let solid_angle = texel_solid_angle(&*to.mapping, x, y).unwrap_or(0.0);
                    seen += f64::from(out.coverage[(x, y)]) * solid_angle;
                }
            }
            let both = spread_directions(2000)
                .filter(|&d| {
                    there_and_back(to, d).is_some() && there_and_back(from, turn * d).is_some()
                })
                .count();
            let wanted = 4.0 * PI * both as f64 / 2000.0;
            // Rims are staircases of pixels.
            assert!(
                (seen - wanted).abs() < 0.5,
                "{} to {}: {seen} of {wanted} sr",
                from.name,
                to.name
            );
        }
    }
}

/// A lat-long with a disc 3 px wide on light of 1, antialiased.
pub(super) fn sun(width: usize, towards: DVec3) -> Image<Rgb> {
    let height = width / 2;
    let half_angle = 3.0 * PI / width as f64;
    Image::from_fn(width, height, |x, y| {
        let centre = lat_long_direction(DVec2::new(x as f64, y as f64), width, height);
        if centre.angle_between(towards) > 4.0 * half_angle {
            return Rgb::ONE;
        }
        let inside = (0..64)
            .filter(|k| {
                let p = DVec2::new((k % 8) as f64, (k / 8) as f64) / 8.0 - 0.4375;
                let p = p + DVec2::new(x as f64, y as f64);
                lat_long_direction(p, width, height).angle_between(towards) < half_angle
            })
            .count();
        Rgb::splat(1.0 + 1e5 * inside as f32 / 64.0)
    })
}

/// methods-capture C5: flux within 0.3 %, first moment within 0.02° in a picture as fine as a lat-long of
/// 1024 px, for 16 rotations: flux lands in texel centres, so the moment goes with their size.
#[test]
fn sixteen_rotations_keep_the_suns_flux_and_place_in_every_layout() {
    let towards = DVec3::new(0.3, 0.5, -0.4).normalize();
    let mut judged = 0;
    for (fine, rotations) in [(512, 0..16), (1024, 3..4)] {
        let panorama = Panorama::from_radiance(sun(fine / 2, towards));
        let flux: f64 = (0..fine / 4)
            .map(|y| {
                let row: f64 = panorama.radiance.row(y).iter().map(|l| f64::from(l.x) - 1.0).sum();
                row * panorama.solid_angle(y)
            })
            .sum();
        for name in [
            "latlong",
            "latlong:pbrt-v3",
            "angular",
            "ball",
            "cube-cross",
            "cube-vertical",
            "cube-strip",
            "cube-column:opengl",
        ] {
            for k in rotations.clone().map(f64::from) {
                let turn = DQuat::from_rotation_y(2.4 * k)
                    * DQuat::from_rotation_x(1.7 * k)
                    * DQuat::from_rotation_z(k);
                let layout = Layout::named(name).unwrap();
                // Within 30° of the direction that is their whole rim a pixel of these is a long streak.
                let rim = match layout {
                    Layout::Angular => Some(DVec3::Z),
                    Layout::BallMap => Some(DVec3::NEG_Z),
                    _ => None,
                };
                if rim.is_some_and(|rim| (turn * towards).angle_between(rim) < PI / 6.0) {
                    continue;
                }
                let (found, place) = sun_in(&panorama.clone().rotated(turn), layout, fine);
                assert!((found / flux - 1.0).abs() < 3e-3, "{name}, {k}: flux {found} of {flux}");
                let off = place.angle_between(turn * towards).to_degrees();
                assert!(off < 0.02 * 1024.0 / fine as f64, "{name} {fine}, {k}: {off}°");
                judged += 1;
            }
        }
    }
    assert!(judged > 120, "{judged} of 136");
}

/// Flux and flux-weighted world direction of what is brighter than 1 in a picture of `panorama`.
fn sun_in(panorama: &Panorama, layout: Layout, fine: usize) -> (f64, DVec3) {
    let size = layout.size(layout.side_for(fine));
    let mapping = layout.mapping(size).unwrap();
    let world_from_picture =
        layout.axes().map_or(DMat3::IDENTITY, |axes| axes.picture_from_world().transpose());
    let out = file::laid_out(panorama, layout, size).unwrap();
    let (mut flux, mut moment) = (0.0, DVec3::ZERO);
    for y in 0..size.1 {
        for x in 0..size.0 {
            let l = f64::from(out.light.mean[(x, y)].x) - 1.0;
            let direction = mapping.direction(DVec2::new(x as f64, y as f64));
            if let Some(direction) = direction.filter(|_| l > 1e-3) {
                let share = l * texel_solid_angle(&*mapping, x, y).unwrap();
                flux += share;
                moment += share * direction;
            }
        }
    }
    (flux, world_from_picture * moment.normalize())
}

/// F27: six coloured axes through every convention's file arrive where they were.
#[test]
fn every_convention_survives_its_file() {
    let axes = [DVec3::X, DVec3::NEG_X, DVec3::Y, DVec3::NEG_Y, DVec3::Z, DVec3::NEG_Z];
    let colour = |d: DVec3| {
        let k = (0..6).max_by(|&a, &b| axes[a].dot(d).total_cmp(&axes[b].dot(d))).unwrap();
        Rgb::new((k & 1) as f32, (k >> 1 & 1) as f32, (k >> 2) as f32) + 0.1
    };
    let panorama = Panorama::from_radiance(Image::from_fn(128, 64, |x, y| {
        colour(lat_long_direction(DVec2::new(x as f64, y as f64), 128, 64))
    }));
    let folder = tempfile::tempdir().unwrap();
    let mut names: Vec<String> = NAMES.iter().map(|(name, _)| format!("latlong:{name}")).collect();
    names.extend(
        ["angular", "ball", "cube-cross", "cube-vertical", "cube-strip:opengl", "cube-column"]
            .map(String::from),
    );
    for name in names {
        let layout = Layout::named(&name).unwrap();
        let size = layout.size(layout.side_for(128));
        let pictured = file::laid_out(&panorama, layout, size).unwrap();
        let path = folder.path().join("picture.exr");
        picture_file::write_exr(&path, &pictured, layout, &Default::default()).unwrap();
        let options = Default::default();
        let read =
            file::read(&path, layout, DQuat::IDENTITY, Some(128), &options).unwrap().panorama;
        let back = file::in_world_axes(&read);
        for axis in axes {
            // Beside the rims of angular and ball map, which are one direction each.
            let near = (axis + DVec3::new(0.21, 0.17, -0.13)).normalize();
            assert!((back.radiance(near) - colour(near)).length() < 1e-2, "{name} {axis}");
        }
        if layout.axes().is_some() {
            // Columns that only move are not touched.
            assert_eq!(back.radiance, panorama.radiance, "{name}");
        }
    }
}
