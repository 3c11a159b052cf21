//! The inserted objects: a clay cow, a copper vase and a glazed bowl, with their glTF materials.
//!
//! The cow is "Spot" by Keenan Crane (CC0), `spot.obj` beside this file; the others are lathed here.
//! Each stands with its foot at its own origin; [`Object`] says where the shot puts it.

use glam::DVec3;

use crate::mesh::Triangles;
use crate::paint::{Paint, fbm, smooth};
use crate::surface::{Finish, Gloss};

/// An object, in its own coordinates, and its place in the shot.
pub struct Object {
    /// File stem.
    pub name: &'static str,
    pub triangles: Triangles,
    pub finish: Finish,
    pub at: DVec3,
    pub rotate_y_deg: f64,
    pub scale: f64,
}

impl Object {
    /// The triangles where the shot puts them.
    pub fn in_world(&self) -> Triangles {
        let turn = self.rotate_y_deg.to_radians();
        self.triangles.clone().placed(self.scale, turn, self.at)
    }
}

/// The three objects of the shot.
pub fn objects() -> [Object; 3] {
    let copper = Paint::Plain(DVec3::new(0.93, 0.58, 0.42));
    let cobalt = Paint::Plain(DVec3::new(0.035, 0.13, 0.30));
    let finish = |paint, gloss| Finish { paint, gloss };
    [
        Object {
            name: "spot",
            triangles: spot().rounded(),
            finish: finish(Paint::Vertices, Gloss::Matt),
            at: DVec3::new(-0.10, 0.0, 0.05),
            rotate_y_deg: 150.0,
            scale: 1.0,
        },
        Object {
            name: "vase",
            triangles: vase().rounded(),
            finish: finish(copper, Gloss::Metal { roughness: 0.40 }),
            at: DVec3::new(0.10, 0.0, -0.09),
            rotate_y_deg: 0.0,
            scale: 1.0,
        },
        Object {
            name: "bowl",
            triangles: bowl().rounded(),
            finish: finish(cobalt, Gloss::Dielectric { roughness: 0.28 }),
            at: DVec3::new(0.15, 0.0, 0.11),
            rotate_y_deg: 0.0,
            scale: 1.0,
        },
    ]
}

/// Spot, 22 cm high, standing, with patches painted into its vertex colours.
fn spot() -> Triangles {
    let text = include_str!("spot.obj");
    let mesh = Triangles::from_obj(text).expect("spot.obj is compiled in and whole");
    let low = mesh.positions.iter().map(|p| p.y).fold(f64::INFINITY, f64::min);
    let mut mesh =
        mesh.placed(1.0, 0.0, DVec3::new(0.0, -low, -0.19)).placed(0.128, 0.0, DVec3::ZERO);
    let (bisque, umber) = (DVec3::new(0.76, 0.70, 0.61), DVec3::new(0.21, 0.105, 0.06));
    mesh.colours = mesh
        .positions
        .iter()
        .map(|p| bisque.lerp(umber, smooth(0.13, 0.20, fbm(*p * 15.0 + 3.3, 2))))
        .collect();
    mesh
}

/// A spun copper vase, 23 cm high.
fn vase() -> Triangles {
    let outside = |t: f64| {
        let belly = 0.058 * (std::f64::consts::PI * t.powf(0.62)).sin().max(0.0).powf(0.85);
        0.021 + belly * (1.0 - 0.35 * t) + 0.016 * smooth(0.84, 1.0, t)
    };
    let n = 32;
    let mut profile = vec![(0.0, 0.0), (0.030, 0.0), (0.032, 0.0015), (0.032, 0.0045)];
    for i in 0..=n {
        let t = f64::from(i) / f64::from(n);
        profile.push((outside(t).max(0.030 * (1.0 - 8.0 * t)), 0.006 + 0.224 * t));
    }
    let lip = outside(1.0);
    profile.extend([(lip + 0.0006, 0.2312), (lip - 0.0004, 0.2322), (lip - 0.0016, 0.2316)]);
    for i in (0..=n / 2).rev() {
        let t = 0.25 + 0.75 * f64::from(i) / f64::from(n / 2);
        profile.push((outside(t) - 0.002, 0.006 + 0.224 * t));
    }
    profile.push((0.0, 0.058));
    Triangles::lathe(&profile, 96)
}

/// A glazed bowl on a foot ring, 6 cm high, 13 cm across.
fn bowl() -> Triangles {
    let outside = |t: f64| 0.024 + 0.041 * t.powf(0.55);
    let n = 24;
    let mut profile =
        vec![(0.0, 0.003), (0.019, 0.003), (0.020, 0.0), (0.0235, 0.0), (0.024, 0.001)];
    for i in 0..=n {
        let t = f64::from(i) / f64::from(n);
        profile.push((outside(t), 0.006 + 0.054 * t));
    }
    let lip = outside(1.0);
    profile.extend([(lip - 0.0004, 0.0612), (lip - 0.0015, 0.0618), (lip - 0.0027, 0.0612)]);
    for i in (1..=n).rev() {
        let t = f64::from(i) / f64::from(n);
        let shrink = smooth(0.0, 0.12, t);
        profile.push(((outside(t) - 0.0035) * shrink, 0.0105 + 0.0495 * t));
    }
    profile.push((0.0, 0.0105));
    Triangles::lathe(&profile, 96)
}
