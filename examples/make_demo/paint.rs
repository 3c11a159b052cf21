//! Procedural textures of the place: value noise and what is made of it. Albedos are linear Rec.709.

use glam::{DVec2, DVec3};

use crate::sampling::hash;
use crate::targets;

/// How a surface is coloured, as a function of the point on it (metres).
#[derive(Clone, Copy)]
pub enum Paint {
    Plain(DVec3),
    /// Vertex colours of the mesh.
    Vertices,
    /// Patterned cement tiles in the plane y = 0.
    Tiles,
    /// Oak with its grain along the axis 0 (x) or 2 (z).
    Oak(usize),
    /// White lime plaster.
    Plaster,
    /// Sawn sandstone slabs in a horizontal plane.
    Slabs,
    /// Burnt clay.
    Terracotta,
    /// Citrus skin of a colour.
    Peel(DVec3),
    /// Leaves, lighter along the middle.
    Leaf,
    /// Dark soil.
    Soil,
    /// A printed target lying or standing in the place; see [`targets::Sheet`].
    Sheet(targets::Sheet),
}

impl Paint {
    /// Albedo at `p`; `vertex` is the mesh's interpolated vertex colour there.
    pub fn albedo(&self, p: DVec3, vertex: DVec3) -> DVec3 {
        match *self {
            Self::Plain(colour) => colour,
            Self::Vertices => vertex,
            Self::Tiles => tiles(DVec2::new(p.x, p.z)),
            Self::Oak(axis) => oak(p, axis),
            Self::Plaster => {
                let stain = fbm(p * 1.3, 4) * 0.14 + fbm(p * 23.0, 3) * 0.06;
                DVec3::new(0.80, 0.76, 0.69) * (0.90 + stain)
            }
            Self::Slabs => slabs(DVec2::new(p.x, p.z)),
            Self::Terracotta => {
                let bloom = smooth(0.1, 0.5, fbm(p * 9.0 + 7.0, 4));
                let clay = DVec3::new(0.52, 0.235, 0.125) * (1.0 + 0.35 * fbm(p * 40.0, 4));
                clay.lerp(DVec3::new(0.62, 0.46, 0.36), 0.4 * bloom)
            }
            Self::Peel(colour) => {
                colour * (1.0 + 0.10 * fbm(p * 220.0, 2) + 0.10 * fbm(p * 18.0, 2))
            }
            Self::Leaf => {
                let age = 0.5 + 0.5 * fbm(p * 6.0, 2);
                let green = DVec3::new(0.12, 0.21, 0.105).lerp(DVec3::new(0.25, 0.33, 0.15), age);
                green * (1.0 + 0.22 * fbm(p * 60.0, 3))
            }
            Self::Soil => DVec3::new(0.07, 0.05, 0.035) * (1.0 + 0.6 * fbm(p * 150.0, 3)),
            Self::Sheet(sheet) => sheet.albedo(p),
        }
    }
}

/// Side of a cement tile, metres.
pub const TILE_M: f64 = 0.12;

fn tiles(p: DVec2) -> DVec3 {
    let cell = (p / TILE_M).floor();
    let inside = p / TILE_M - cell;
    // Every tile has the four-fold symmetry of its mould.
    let q = (inside - 0.5).abs();
    let key = hash(hash(cell.x as i32 as u32) ^ cell.y as i32 as u32);
    let wear = fbm(DVec3::new(p.x, 0.3, p.y) * 11.0, 4);
    let fine = fbm(DVec3::new(p.x, 1.3, p.y) * 160.0, 3);

    let cream = DVec3::new(0.64, 0.575, 0.47);
    let blue = DVec3::new(0.105, 0.185, 0.275);
    let ochre = DVec3::new(0.50, 0.275, 0.105);
    let sage = DVec3::new(0.34, 0.385, 0.33);
    let corner = (q - 0.5).length();
    let edge = (q - DVec2::new(0.5, 0.0)).length().min((q - DVec2::new(0.0, 0.5)).length());
    let mut colour = cream;
    if corner < 0.40 {
        colour = if corner > 0.345 { blue } else { sage };
        if corner < 0.20 {
            colour = if corner > 0.155 { cream } else { blue };
        }
    } else if edge < 0.155 {
        colour = if edge > 0.11 { blue } else { ochre };
    } else if q.x + q.y < 0.19 {
        colour = if q.x + q.y > 0.125 { ochre } else { blue };
    }
    colour = colour.lerp(cream, 0.10 + 0.10 * wear);
    colour *= 0.95 + 0.09 * unit(key) + 0.16 * wear + 0.09 * fine;

    let joint = 0.5 - q.max_element() + 0.004 * fine;
    DVec3::new(0.40, 0.37, 0.33).lerp(colour, smooth(0.008, 0.016, joint))
}

fn slabs(p: DVec2) -> DVec3 {
    let size = DVec2::new(0.62, 0.44);
    let row = (p.y / size.y).floor();
    let shifted = DVec2::new(p.x + 0.37 * size.x * row, p.y) / size;
    let cell = shifted.floor();
    let q = (shifted - cell - 0.5).abs();
    let joint = ((0.5 - q) * size).min_element();
    let key = hash(hash(cell.x as i32 as u32) ^ cell.y as i32 as u32);
    let grain = fbm(DVec3::new(p.x, unit(key) * 9.0, p.y) * 7.0, 5);
    let warm = DVec3::new(0.50, 0.40, 0.30).lerp(DVec3::new(0.42, 0.37, 0.32), unit(hash(key)));
    let stone = warm * (0.92 + 0.12 * unit(key) + 0.28 * grain);
    (stone * 0.45).lerp(stone, smooth(0.002, 0.008, joint))
}

fn oak(p: DVec3, axis: usize) -> DVec3 {
    let mut stretched = p * 9.0;
    stretched[axis] *= 0.07;
    let warp = fbm(stretched, 3);
    let mut ring = p * 60.0;
    ring[axis] *= 0.02;
    let rings = (9.0 * warp + 2.5 * fbm(ring * 0.3, 2)).sin() * 0.5 + 0.5;
    let mut pore = p * 900.0;
    pore[axis] *= 0.03;
    let wood = DVec3::new(0.36, 0.215, 0.105).lerp(DVec3::new(0.24, 0.13, 0.06), rings * 0.8);
    wood * (1.0 + 0.25 * fbm(pore, 2) + 0.15 * fbm(p * 4.0, 2))
}

/// Hermite step from 0 at `a` to 1 at `b`.
pub fn smooth(a: f64, b: f64, x: f64) -> f64 {
    let t = ((x - a) / (b - a)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Sum of `octaves` of value noise, about −0.5…0.5.
pub fn fbm(p: DVec3, octaves: u32) -> f64 {
    let (mut sum, mut weight, mut scale) = (0.0, 0.5, 1.0);
    for octave in 0..octaves {
        sum += weight * noise(p * scale + f64::from(octave) * 17.17);
        weight *= 0.5;
        scale *= 2.03;
    }
    sum
}

/// Large odd factors that keep neighbouring lattice points apart (Teschner et al. 2003).
const PRIMES: [u32; 3] = [73_856_093, 19_349_663, 83_492_791];

/// Value noise −1…1, smooth, with a lattice of one unit.
fn noise(p: DVec3) -> f64 {
    let base = p.floor();
    let f = p - base;
    let w = f * f * (DVec3::splat(3.0) - 2.0 * f);
    let corner = (base.x as i32 as u32)
        .wrapping_mul(PRIMES[0])
        .wrapping_add((base.y as i32 as u32).wrapping_mul(PRIMES[1]))
        .wrapping_add((base.z as i32 as u32).wrapping_mul(PRIMES[2]));
    let at = |x: i32, y: i32, z: i32| {
        let key = corner
            .wrapping_add((x as u32).wrapping_mul(PRIMES[0]))
            .wrapping_add((y as u32).wrapping_mul(PRIMES[1]))
            .wrapping_add((z as u32).wrapping_mul(PRIMES[2]));
        unit(hash(key)) * 2.0 - 1.0
    };
    let mix = |a: f64, b: f64, t: f64| a + (b - a) * t;
    let plane = |z: i32| {
        let low = mix(at(0, 0, z), at(1, 0, z), w.x);
        let high = mix(at(0, 1, z), at(1, 1, z), w.x);
        mix(low, high, w.y)
    };
    mix(plane(0), plane(1), w.z)
}

/// A hash as a number in [0, 1).
fn unit(key: u32) -> f64 {
    f64::from(key) / 4_294_967_296.0
}
