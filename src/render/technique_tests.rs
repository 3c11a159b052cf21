//! Every technique against a closed form (methods-render R4.1: a sphere under a uniform sky), and
//! under a sky that is not uniform against the default.
//!
//! Tolerances: 3.5 standard errors of the mean over 16 pixels, six comparisons a test, plus 0.3 % for
//! the tessellation.

use glam::Vec3;

use super::technique::{Blocked, Caustics, Technique};
use super::test_scenes::*;
use super::{Difference, Job, Method, Stop};
use crate::conventions::Rgb;
use crate::light::{Draws, Environment, Lights};
use crate::photo::Image;
use crate::scene::{AlbedoSource, Material};

/// The techniques whose mean is that of the default.
fn unbiased() -> [(&'static str, Technique); 7] {
    [
        ("even directions", Technique { evenly: true, ..Technique::plain(Draws::Never) }),
        ("BSDF alone", Technique::plain(Draws::Never)),
        ("lights alone", Technique::plain(Draws::Alone)),
        ("BSDF and lights", Technique::plain(Draws::Whole)),
        ("BSDF and compensated lights", Technique::plain(Draws::AsMade)),
        ("no cells", Technique { blocked: Blocked::Draws, ..Technique::default() }),
        ("cells", Technique { blocked: Blocked::Cells, ..Technique::default() }),
    ]
}

/// A sphere on a ground of albedo 0.5, seen at one point, `distance` from where they touch.
fn look(technique: Technique, material: Material, lights: &Lights, distance: f32) -> Difference {
    let grey = AlbedoSource::Constant(Rgb::splat(0.5));
    let ball = sphere(Vec3::Y, 1.0, 5);
    let scene = scene(vec![ball], material, vec![local(ground(20.0), grey)]);
    let plate = Image::filled(4, 4, Rgb::splat(0.5));
    let (cameras, _) = point_camera(&[distance]);
    let job =
        Job { technique, ..plain_job(&scene, lights, &cameras[0], &plate, Stop::Samples(512)) };
    finish(Method::Coupled, job, 3).0.whole()
}

#[test]
fn unbiased_techniques_give_the_form_factor_of_a_black_sphere() {
    let wanted = -0.089_443;
    for (name, technique) in unbiased() {
        assert!(technique.only_noise_differs(), "{name}");
        let (got, sigma) = mean_ratio(&look(technique, matt(0.0), &uniform_sky(1.0), 2.0));
        println!("{name}: {got:.5} ± {sigma:.5} for {wanted}");
        assert!((got - wanted).abs() < 3.5 * sigma + 0.003 * wanted.abs(), "{name}: {got}");
        assert!(sigma < 0.01, "{name}: ± {sigma}");
    }
}

#[test]
fn unbiased_techniques_agree_where_the_sky_is_not_uniform_and_the_sphere_shines() {
    let picture = Image::from_fn(64, 32, |i, j| {
        let window = (10..20).contains(&i) && (6..12).contains(&j);
        if window { Rgb::splat(5.0) } else { Rgb::splat(0.2 + 0.01 * j as f32) }
    });
    let environment = Environment::new(&picture, glam::DQuat::IDENTITY, true).unwrap();
    let lights = Lights::from_parts(environment, Vec::new());
    let shiny = Material { roughness: 0.7, metallic: 1.0, ..matt(0.8) };
    let (wanted, wanted_sigma) =
        mean_ratio(&look(Technique::default(), shiny.clone(), &lights, 1.5));
    for (name, technique) in unbiased() {
        let (got, sigma) = mean_ratio(&look(technique, shiny.clone(), &lights, 1.5));
        println!("{name}: {got:.5} ± {sigma:.5} for {wanted:.5} ± {wanted_sigma:.5}");
        assert!((got - wanted).abs() < 3.5 * sigma.hypot(wanted_sigma), "{name}: {got}");
    }
}

#[test]
fn paths_of_one_edge_find_what_is_blocked_and_nothing_else() {
    // A white sphere without the light it reflects is a black one.
    let shallow = Technique::up_to_depth(1);
    assert!(!shallow.only_noise_differs());
    let (got, sigma) = mean_ratio(&look(shallow, matt(1.0), &uniform_sky(1.0), 2.0));
    let wanted = -0.089_443;
    assert!((got - wanted).abs() < 3.5 * sigma + 0.003 * 0.0894, "{got} ± {sigma} for {wanted}");
    let (whole, _) = mean_ratio(&look(Technique::default(), matt(1.0), &uniform_sky(1.0), 2.0));
    let (two, _) = mean_ratio(&look(Technique::up_to_depth(2), matt(1.0), &uniform_sky(1.0), 2.0));
    println!("1: {got:.4}, 2: {two:.4}, all: {whole:.4}");
    assert!(got < two && two < whole, "longer paths find more: {got} {two} {whole}");
}

#[test]
fn light_sets_come_near_the_form_factor_without_noise() {
    let wanted = -0.089_443;
    let picture = Image::filled(256, 128, Rgb::ONE);
    let environment = Environment::new(&picture, glam::DQuat::IDENTITY, true).unwrap();
    let lights = Lights::from_parts(environment, Vec::new());
    for (blocked, tolerance) in [
        (Blocked::Patches(64), 0.5),
        (Blocked::Patches(4096), 0.06),
        (Blocked::MedianCut(64), 0.5),
        (Blocked::MedianCut(4096), 0.06),
    ] {
        let technique = Technique { blocked, ..Technique::default() };
        assert!(!technique.only_noise_differs());
        let (got, sigma) = mean_ratio(&look(technique, matt(0.0), &lights, 2.0));
        println!("{blocked:?}: {got:.5} ± {sigma:.6}, off by {:.4}", got / wanted - 1.0);
        // A disc of the sphere's size holds N/20 directions; those at its edge are in or out.
        assert!((got / wanted - 1.0).abs() < tolerance, "{blocked:?}: {got}");
        // The only scatter: pixels a hair apart see one direction of thousands on the sphere's edge.
        assert!(sigma < 2e-4, "{blocked:?}: ± {sigma}");
    }
}

#[test]
fn soft_caustics_keep_the_light_and_find_it_without_luck() {
    // A brass ball in the sun: what it throws onto the ground, over the places that it lights.
    let brass = Material { roughness: 0.25, metallic: 1.0, ..matt(0.8) };
    let lights = sunny_sky(40.0, 1.0);
    let sum = |caustics: Caustics| {
        let technique = Technique { caustics, ..Technique::default() };
        let at = [1.2, 1.6, 2.0, 2.5, 3.0];
        let looks = at.map(|d| mean_ratio(&look(technique, brass.clone(), &lights, d)));
        let light: f64 = looks.iter().zip(at).map(|(l, d)| l.0 * f64::from(d)).sum();
        let variance: f64 = looks.iter().zip(at).map(|(l, d)| (l.1 * f64::from(d)).powi(2)).sum();
        (light, variance.sqrt())
    };
    let ((soft, soft_sigma), (exact, exact_sigma)) = (sum(Caustics::Soft), sum(Caustics::Exact));
    println!("soft {soft:.5} ± {soft_sigma:.5}, exact {exact:.5} ± {exact_sigma:.5}");
    assert!(soft_sigma < 0.5 * exact_sigma, "{soft_sigma} {exact_sigma}");
    assert!((soft - exact).abs() < 3.5 * soft_sigma.hypot(exact_sigma) + 0.03 * exact.abs());
}
