//! Does the plate show its surfaces as bright as the probe's light and their albedo make them?
//!
//! ρ = π P / E (methods-render R9.2) with the light that arrives unhindered. Where the albedo comes from
//! the plate, nothing that is real reflects more than 95 %; where it was given, it is what ρ must be.

use glam::Vec3;

use super::shown::{Seen, Shown};
use crate::conventions::{Rgb, luminance};
use crate::light::Lights;
use crate::photo::Image;
use crate::report::Warning;
use crate::scene::{AlbedoSource, Scene};
use crate::trace::Ray;

/// Irradiance is a pass over the panorama: this many normals get their own, others the nearest one's.
const NORMALS: usize = 48;
/// Normals this near each other share one (8°): irradiance changes by some percent.
const SAME_NORMAL: f32 = 0.99;
/// Places this near each other share the irradiance of near light, m.
const SAME_PLACE_M: f32 = 0.05;
/// A plate this many times brighter or darker than the given albedo says is no matter of texture.
const OFF: f32 = 2.0;

/// The plate and what it was taken of.
pub struct View<'a> {
    pub plate: &'a Image<Rgb>,
    pub clipped: &'a Image<bool>,
    pub scene: &'a Scene,
    pub shown: &'a Shown,
    pub lights: &'a Lights,
}

/// What of that cannot be, if anything.
pub fn warnings(view: &View) -> Vec<Warning> {
    let (mut solved, mut given) = (Vec::new(), Vec::new());
    for (source, albedo) in view.albedos() {
        match source {
            AlbedoSource::Plate => solved.push(albedo),
            AlbedoSource::Constant(stated) => given.push((albedo, stated)),
            AlbedoSource::Material => {}
        }
    }
    [too_white(&solved), off_the_given(&given)].into_iter().flatten().collect()
}

impl View<'_> {
    /// Albedo that plate and light ask for, on a grid of pixels that show lit local surfaces.
    fn albedos(&self) -> Vec<(AlbedoSource, Rgb)> {
        let mut light =
            Irradiances { lights: self.lights, known: Vec::new(), known_near: Vec::new() };
        self.shown.grid.iter().filter_map(|seen| self.albedo(seen, &mut light)).collect()
    }

    /// `None` in a sun's shadow, without light, and where a clipped pixel is too little to compare.
    fn albedo(&self, seen: &Seen, light: &mut Irradiances) -> Option<(AlbedoSource, Rgb)> {
        let Seen { pixel, hit, .. } = seen;
        let surface = &self.scene.local[hit.mesh as usize];
        let (point, normal) = seen.place(self.scene);
        let suns = &self.lights.suns;
        let in_shadow =
            suns.iter().any(|sun| self.shown.local.occluded(&Ray::new(point, sun.direction)));
        let irradiance = light.at(point, normal);
        // A clipped pixel is at least as bright: enough to be too white, too little to compare.
        let unknown = self.clipped[*pixel] && surface.albedo != AlbedoSource::Plate;
        if in_shadow || unknown || irradiance.min_element() <= 0.0 {
            return None;
        }
        Some((surface.albedo, self.plate[*pixel] * std::f32::consts::PI / irradiance))
    }
}

/// Irradiance by normal; surfaces of a mesh share a few. In near light, by place as well.
struct Irradiances<'a> {
    lights: &'a Lights,
    known: Vec<(Vec3, Rgb)>,
    /// Place, normal and irradiance.
    known_near: Vec<(Vec3, Vec3, Rgb)>,
}

impl Irradiances<'_> {
    fn at(&mut self, place: Vec3, normal: Vec3) -> Rgb {
        if !self.lights.is_near() {
            return self.on(normal);
        }
        let like = |known: &&(Vec3, Vec3, Rgb)| {
            known.0.distance(place) < SAME_PLACE_M && known.1.dot(normal) > SAME_NORMAL
        };
        if let Some(known) = self.known_near.iter().find(like) {
            return known.2;
        }
        let irradiance = self.lights.irradiance_at(place, normal);
        self.known_near.push((place, normal, irradiance));
        irradiance
    }

    fn on(&mut self, normal: Vec3) -> Rgb {
        let nearest = self.known.iter().max_by(|a, b| a.0.dot(normal).total_cmp(&b.0.dot(normal)));
        if let Some(&(near, irradiance)) = nearest
            && (near.dot(normal) > SAME_NORMAL || self.known.len() == NORMALS)
        {
            return irradiance;
        }
        let irradiance = self.lights.irradiance(normal);
        self.known.push((normal, irradiance));
        irradiance
    }
}

/// A surface that seems to give back more light than it gets: plate and probe disagree.
fn too_white(solved: &[Rgb]) -> Option<Warning> {
    let mut too_white: Vec<f32> =
        solved.iter().map(|albedo| albedo.max_element()).filter(|&a| a > 0.95).collect();
    let share = 100.0 * too_white.len() as f64 / solved.len().max(1) as f64;
    if share <= 5.0 {
        return None;
    }
    let albedo = median(&mut too_white);
    Some(Warning::new(
        "plate.exposure",
        "the support seems to reflect more than 95 % of its light: the exposures of plate and probe, \
         the ball's reflectance or the sun's strength are wrong, or light comes from near by; correct \
         them, or set plate.relative_exposure, until the albedo is one the surface can have",
        format!(
            "{share:.0} % of the support's pixels; albedo {albedo:.2} there, shadows turn to glows"
        ),
    ))
}

/// A surface that the plate shows far brighter or darker than the albedo somebody gave makes it.
fn off_the_given(given: &[(Rgb, Rgb)]) -> Option<Warning> {
    let mut ratios: Vec<f32> = given
        .iter()
        .map(|&(shown, stated)| luminance(shown) / luminance(stated))
        .filter(|ratio| ratio.is_finite())
        .collect();
    if ratios.is_empty() {
        return None;
    }
    let ratio = median(&mut ratios);
    let (times, word) = if ratio > OFF {
        (ratio, "brighter")
    } else if ratio < 1.0 / OFF {
        (ratio.recip(), "darker")
    } else {
        return None;
    };
    let shown: Vec<String> = (0..3)
        .map(|channel| {
            let mut values: Vec<f32> = given.iter().map(|(shown, _)| shown[channel]).collect();
            format!("{:.2}", median(&mut values))
        })
        .collect();
    Some(Warning::new(
        "support.albedo",
        format!(
            "the plate shows the support {times:.1} times {word} than its albedo and the probe's light make \
             it: the albedo, the exposures of plate and probe, the ball's reflectance or the sun's strength \
             are wrong, or much of the support lies in shadow; by the plate the albedo is [{}]",
            shown.join(", ")
        ),
        format!(
            "objects {times:.1} times too {}, if the light is wrong and not the albedo",
            if ratio > 1.0 { "dark" } else { "bright" }
        ),
    ))
}

/// The middle value; the list is not empty.
fn median(values: &mut [f32]) -> f32 {
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f32::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{Camera, Lens, Pose};
    use crate::light::LightOptions;
    use crate::probe::Panorama;
    use crate::scene::{LocalMesh, LocalRole, Mesh};
    use glam::DVec3;

    /// A level ground of this albedo under a sky of radiance 1, in a plate of this value.
    fn said(albedo: AlbedoSource, plate: f32) -> Vec<Warning> {
        let corners = [(-9.0, -9.0), (-9.0, 9.0), (9.0, 9.0), (9.0, -9.0)];
        let mesh = Mesh {
            positions: corners.map(|(x, z)| Vec3::new(x, 0.0, z)).to_vec(),
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Mesh::default()
        };
        let scene = Scene {
            local: vec![LocalMesh { mesh, role: LocalRole::Support, albedo }],
            ..Scene::default()
        };
        let pose = Pose::look_at(DVec3::new(0.0, 3.0, 3.0), DVec3::ZERO, DVec3::Y).unwrap();
        let sky = Panorama::from_radiance(Image::filled(64, 32, Rgb::ONE));
        let camera = Camera { width: 48, height: 36, lens: Lens::pinhole(60.0, 48, 36), pose };
        warnings(&View {
            plate: &Image::filled(48, 36, Rgb::splat(plate)),
            clipped: &Image::filled(48, 36, false),
            scene: &scene,
            shown: &Shown::new(&scene, &camera),
            lights: &Lights::new(&sky, &LightOptions::default()).unwrap(),
        })
    }

    #[test]
    fn an_albedo_that_plate_and_light_contradict_is_told_with_the_one_they_ask_for() {
        // Under a sky of radiance 1 the plate shows the albedo itself.
        let given = |albedo| AlbedoSource::Constant(Rgb::splat(albedo));
        for (stated, plate) in [(0.4, 0.4), (0.4, 0.21), (0.4, 0.79), (0.98, 0.98)] {
            assert_eq!(said(given(stated), plate), [], "{stated} shown as {plate}");
        }
        let darker = &said(given(0.4), 0.1)[0];
        assert!(darker.message.contains("4.0 times darker"), "{darker}");
        assert!(darker.message.contains("[0.10, 0.10, 0.10]") && darker.about == "support.albedo");
        let brighter = &said(given(0.2), 0.6)[0];
        assert!(brighter.message.contains("3.0 times brighter"), "{brighter}");
    }

    #[test]
    fn a_ground_whiter_than_anything_is_told_and_a_white_one_is_not() {
        assert_eq!(said(AlbedoSource::Plate, 0.9), []);
        let glow = &said(AlbedoSource::Plate, 1.5)[0];
        assert!(glow.size.contains("100 %") && glow.size.contains("1.50"), "{glow}");
    }
}
