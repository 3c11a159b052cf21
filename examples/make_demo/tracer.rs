//! A brute-force path tracer: the light that reaches a camera ray, and pictures made of it.
//!
//! Next-event estimation to the sun, BSDF sampling for everything else, both weighted by the balance
//! heuristic (Veach 1997) where they can find the same light. It shares no code with the library:
//! it is the other opinion.

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use crate::lens::View;
use crate::mesh::Ray;
use crate::place::{BALL_REFLECTANCE, Place};
use crate::sampling::{Sampler, pixel_seed};
use crate::sky;
use crate::surface::{Gloss, Scatter};

/// Longest path, in surfaces met.
const MAX_DEPTH: u32 = 12;

/// Surfaces after which paths end by chance.
const SURE_DEPTH: u32 = 3;

/// A picture in the plate's linear values, row-major, and whether objects were met first (0…1).
pub struct Rendered {
    pub width: usize,
    pub height: usize,
    pub light: Vec<DVec3>,
    pub coverage: Vec<f64>,
}

/// Renders `view` with `samples` paths in each pixel (a power of two fills the cells evenly).
pub fn render(place: &Place, view: &View, samples: u32, picture_seed: u32) -> Rendered {
    let mut pixels = vec![(DVec3::ZERO, 0.0); view.width * view.height];
    pixels.par_chunks_mut(view.width).enumerate().for_each(|(y, row)| {
        for (x, pixel) in row.iter_mut().enumerate() {
            let seed = pixel_seed(picture_seed, x, y);
            for sample in 0..samples {
                let mut sampler = Sampler::new(seed, sample);
                let at = DVec2::new(x as f64, y as f64) + sampler.next_2d() - 0.5;
                let ray = Ray { origin: view.position, direction: view.direction(at) };
                let (light, object) = follow(place, ray, &mut sampler, None);
                pixel.0 += light / f64::from(samples);
                pixel.1 += if object { 1.0 / f64::from(samples) } else { 0.0 };
            }
        }
    });
    let (light, coverage) = pixels.into_iter().unzip();
    Rendered { width: view.width, height: view.height, light, coverage }
}

/// Irradiance on a surface at `point` that faces `normal`, by `samples` paths.
pub fn irradiance(place: &Place, point: DVec3, normal: DVec3, samples: u32, seed: u32) -> DVec3 {
    let sheet = Scatter { colour: DVec3::ONE, gloss: Gloss::Matt, normal };
    let mut sum = DVec3::ZERO;
    for sample in 0..samples {
        let mut sampler = Sampler::new(seed, sample);
        let ray = Ray { origin: point + 1e-6 * normal, direction: normal };
        sum += sun_light(place, ray.origin, normal, normal, &sheet, &mut sampler);
        let direction = sheet.sample(normal, 0.0, sampler.next_2d());
        let (_, pdf) = sheet.value_and_pdf(normal, direction);
        let (light, _) = follow(place, Ray { direction, ..ray }, &mut sampler, Some(pdf));
        sum += light;
    }
    sum * std::f64::consts::PI / f64::from(samples)
}

/// Light along `ray`, and whether it met an object first.
///
/// `pdf` is the density with which a surface that has also sampled the sun chose the ray; a camera
/// has none.
fn follow(
    place: &Place,
    mut ray: Ray,
    sampler: &mut Sampler,
    mut pdf: Option<f64>,
) -> (DVec3, bool) {
    let mut light = DVec3::ZERO;
    let mut throughput = DVec3::ONE;
    let mut object_first = false;
    for depth in 0..MAX_DEPTH {
        let Some(hit) = place.closest(&ray) else {
            light += throughput * sky::radiance(ray.direction);
            if sky::in_sun(ray.direction) {
                let weight = pdf.map_or(1.0, |p| p / (p + 1.0 / sky::sun_solid_angle()));
                light += throughput * sky::sun_radiance() * weight;
            }
            break;
        };
        object_first |= depth == 0 && hit.is_object;
        let wo = -ray.direction;
        let geometric = hit.geometric_normal * hit.geometric_normal.dot(wo).signum();
        let normal = hit.shading_normal * hit.shading_normal.dot(geometric).signum();
        // A smooth normal turned away from the viewer is turned back to grazing.
        let facing = normal.dot(wo);
        let normal =
            if facing > 1e-3 { normal } else { (normal + (1e-3 - facing) * wo).normalize() };
        let point = ray.origin + ray.direction * hit.distance;
        let origin = point + 1e-6 * geometric;
        if let Gloss::Mirror = hit.finish.gloss {
            throughput *= hit.finish.paint.albedo(point, hit.colour);
            let direction = ray.direction - 2.0 * ray.direction.dot(normal) * normal;
            ray = Ray { origin, direction };
            // A surface before the ball has counted the sun in it already.
            pdf = pdf.map(|_| 0.0);
            continue;
        }
        let colour = hit.finish.paint.albedo(point, hit.colour);
        let scatter = Scatter { colour, gloss: hit.finish.gloss, normal };
        light += throughput * sun_light(place, origin, geometric, wo, &scatter, sampler);

        let direction = scatter.sample(wo, sampler.next_2d().x, sampler.next_2d());
        let (value, density) = scatter.value_and_pdf(wo, direction);
        if density <= 0.0 || direction.dot(geometric) <= 0.0 {
            break;
        }
        throughput *= value / density;
        if depth >= SURE_DEPTH {
            let survive = throughput.max_element().min(0.95);
            if sampler.next_2d().x >= survive {
                break;
            }
            throughput /= survive;
        }
        ray = Ray { origin, direction };
        pdf = Some(density);
    }
    (light, object_first)
}

/// Sunlight scattered towards `wo`, by one direction sampled on the sun.
fn sun_light(
    place: &Place,
    origin: DVec3,
    geometric: DVec3,
    wo: DVec3,
    scatter: &Scatter,
    sampler: &mut Sampler,
) -> DVec3 {
    let mut light = DVec3::ZERO;
    let direction = sky::sample_sun(sampler.next_2d());
    if let Some((from_ball, spread)) = place.ball_glint(origin, direction) {
        let (value, _) = scatter.value_and_pdf(wo, from_ball);
        light += value * sky::SUN_IRRADIANCE * BALL_REFLECTANCE * spread;
    }
    let (value, density) = scatter.value_and_pdf(wo, direction);
    let lit = density > 0.0 && direction.dot(geometric) > 0.0;
    if lit && !place.blocks(&Ray { origin, direction }) {
        let sun_pdf = 1.0 / sky::sun_solid_angle();
        light += value * sky::sun_radiance() / (sun_pdf + density);
    }
    light
}
