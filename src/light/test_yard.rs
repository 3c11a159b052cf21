//! A yard with a card over it, photographed from above: what a sun's recovery is tested on.

use std::f64::consts::PI;

use glam::{DAffine3, DMat3, DQuat, DVec2, DVec3, Vec3};

use crate::bracket::Validity;
use crate::camera::{Camera, Lens, Pose};
use crate::conventions::Rgb;
use crate::photo::Image;
use crate::probe::Panorama;
use crate::scene::{AlbedoSource, LocalMesh, LocalRole, Mesh, Scene};

pub const SKY: Rgb = Rgb::new(0.02, 0.03, 0.05);
pub const SUN: DVec3 = DVec3::new(1.6, 1.4, 1.0);

fn quad(corners: [Vec3; 4]) -> Mesh {
    Mesh { positions: corners.to_vec(), triangles: vec![[0, 1, 2], [0, 2, 3]], ..Mesh::default() }
}

/// Half the card's length along x and z, metres: it hides 1.5 % of the sky at most.
pub const CARD: [f32; 2] = [0.35, 0.35];

/// Ground of 8 × 8 m and a card floating 3 m above.
pub fn yard(card: [f32; 2]) -> Scene {
    let rectangle = |[half_x, half_z]: [f32; 2], at: Vec3| {
        quad(
            [(-1.0, -1.0), (-1.0, 1.0), (1.0, 1.0), (1.0, -1.0)]
                .map(|(x, z)| at + Vec3::new(x * half_x, 0.0, z * half_z)),
        )
    };
    let local = |mesh, role| LocalMesh { mesh, role, albedo: AlbedoSource::Plate };
    Scene {
        local: vec![
            local(rectangle([4.0; 2], Vec3::ZERO), LocalRole::Support),
            local(rectangle(card, Vec3::new(0.0, 3.0, 0.0)), LocalRole::Prop),
        ],
        ..Scene::default()
    }
}

pub fn sky() -> Panorama {
    Panorama {
        radiance: Image::filled(64, 32, SKY),
        variance: Image::filled(64, 32, Rgb::ZERO),
        validity: Image::filled(64, 32, Validity::Measured),
        coverage: Image::filled(64, 32, 1.0),
        world_from_panorama: DQuat::IDENTITY,
        place: DVec3::new(0.0, 0.1, 0.0),
    }
}

/// Looks straight down from 2.5 m at 300 × 300 px.
pub fn camera() -> Camera {
    let down = DMat3::from_cols(DVec3::X, -DVec3::Z, DVec3::Y);
    Camera {
        width: 300,
        height: 300,
        lens: Lens::pinhole(300.0, 300, 300),
        pose: Pose {
            world_from_camera: DAffine3::from_mat3_translation(down, DVec3::new(0.4, 2.5, 0.0)),
            covariance: None,
        },
    }
}

/// What the camera sees: a textured ground, lit but where the card's shadow falls. The card's
/// share of the sky is left out, the shadow comes from plane geometry.
pub fn photograph(camera: &Camera, sun: DVec3, albedo: f64, card: [f32; 2]) -> Image<Rgb> {
    Image::from_fn(camera.width, camera.height, |x, y| {
        let (origin, direction) = camera.ray(DVec2::new(x as f64, y as f64)).unwrap();
        let ground = origin - direction * (origin.y / direction.y);
        let above = ground + sun * (3.0 / sun.y);
        let shadowed = above.x.abs() < f64::from(card[0]) && above.z.abs() < f64::from(card[1]);
        let texture = 1.0 + 0.2 * (17.0 * ground.x).sin() * (23.0 * ground.z).cos();
        let known = SKY.as_dvec3() * PI;
        let irradiance = if shadowed { known } else { known + SUN * sun.y };
        (irradiance * albedo * texture / PI).as_vec3()
    })
}
