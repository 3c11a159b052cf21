//! The promises of [`Bsdf`]: energy, reciprocity, and draws that follow their density.

use std::f32::consts::FRAC_1_PI;

use glam::{Vec2, Vec3, vec3};
use rayon::prelude::*;

use super::bsdf::*;
use super::coat::Coat;
use super::ggx;
use super::sheen::Sheen;
use crate::conventions::Rgb;
use crate::render::sampler::{Numbers, Purpose, Sampler, to_f32};

fn plastic(alpha: f32) -> Bsdf {
    Bsdf {
        base: vec3(0.8, 0.5, 0.2),
        alpha,
        specular: 1.0,
        f0: Rgb::splat(0.04),
        ..Bsdf::lambert(Rgb::ONE)
    }
}

fn metal(alpha: f32) -> Bsdf {
    Bsdf { metallic: 1.0, base: Rgb::ONE, ..plastic(alpha) }
}

fn glass(alpha: f32, eta: f32, thin: bool) -> Bsdf {
    Bsdf { transmission: 1.0, base: Rgb::ONE, eta, thin, ..plastic(alpha) }
}

/// Matt cloth under a sheen.
fn velvet(roughness: f32) -> Bsdf {
    let sheen = Sheen::new(vec3(0.9, 0.6, 0.3), roughness);
    Bsdf { sheen, ..Bsdf::lambert(vec3(0.7, 0.2, 0.1)) }
}

/// Something under a varnish whose normal leans by `slope`.
fn coated(base: Bsdf, alpha: f32, slope: f32) -> Bsdf {
    let normal = vec3(slope, 0.5 * slope, 1.0).normalize();
    Bsdf { coat: Some(Coat { weight: 0.9, alpha, normal }), ..base }
}

fn at(mu: f32) -> Vec3 {
    vec3((1.0 - mu * mu).sqrt(), 0.0, mu)
}

fn draws(bsdf: Bsdf, wo: Vec3, n: u32) -> impl Iterator<Item = Option<Scattered>> {
    (0..n).map(move |i| {
        let s = Sampler::new(4, (1, 2), 0, i, Numbers::Independent);
        let choice = to_f32(s.pair(Purpose::Choice).x);
        bsdf.sample(wo, s.pair(Purpose::Direction).as_vec2(), choice)
    })
}

#[test]
fn specular_weight_zero_is_exactly_lambert() {
    let bsdf = Bsdf { specular: 0.0, ..plastic(0.3) };
    for (wo, wi) in [(at(0.3), at(0.9)), (at(1.0), at(0.1))] {
        let (value, pdf) = bsdf.evaluate(wo, wi);
        assert!((value - bsdf.base * wi.z * FRAC_1_PI).abs().max_element() < 1e-7);
        assert!((pdf - wi.z * FRAC_1_PI).abs() < 1e-6);
    }
    assert!(bsdf.is_lambert() && !plastic(0.3).is_lambert());
}

#[test]
fn reflection_is_reciprocal() {
    let mut worst = 0.0_f32;
    for i in 0..10_000 {
        let s = Sampler::new(8, (0, 0), 0, i, Numbers::Independent);
        let a = sample_cosine(s.pair(Purpose::Direction).as_vec2());
        let b = sample_cosine(s.pair(Purpose::Environment).as_vec2());
        let kinds = [plastic(0.09), plastic(0.7), metal(0.3), glass(0.3, 1.5, false), velvet(0.5)];
        for bsdf in kinds {
            let f = bsdf.evaluate(a, b).0 / b.z;
            let back = bsdf.evaluate(b, a).0 / a.z;
            worst = worst.max(((f - back) / (f + back + 1e-6)).abs().max_element());
        }
    }
    assert!(worst < 1e-4, "{worst}");
}

/// The coat's Fresnel factor goes by the view: what departs from reciprocity is that and no more.
#[test]
fn a_coat_is_reciprocal_but_for_its_fresnel_factor() {
    for i in 0..2000 {
        let s = Sampler::new(8, (0, 0), 0, i, Numbers::Independent);
        let a = sample_cosine(s.pair(Purpose::Direction).as_vec2());
        let b = sample_cosine(s.pair(Purpose::Environment).as_vec2());
        let bare = plastic(0.3);
        let coat = Coat { weight: 0.9, alpha: 0.2, normal: Vec3::Z };
        let coated = Bsdf { coat: Some(coat), ..bare };
        let f = |wo: Vec3, wi: Vec3, bsdf: Bsdf| bsdf.evaluate(wo, wi).0 / wi.z;
        let (there, back) = (f(a, b, coated), f(b, a, coated));
        let beneath = f(a, b, bare);
        let predicted =
            (coat.share(b) - coat.share(a)) * (Rgb::splat(coat.evaluate(a, b).0 / b.z) - beneath);
        let error = (back - there - predicted).abs().max_element();
        assert!(error < 1e-4 * (there + back).max_element() + 1e-6, "{there} {back} {predicted}");
    }
}

/// The kinds of surface, each of which must keep every promise below.
fn kinds() -> [(&'static str, Bsdf); 15] {
    let mixed = Bsdf { metallic: 0.5, transmission: 0.4, ..plastic(0.3) };
    let tinted_glass = Bsdf { specular: 0.6, f0: vec3(0.04, 0.02, 0.01), ..glass(0.3, 1.5, false) };
    [
        ("plastic 0.05", plastic(0.05)),
        ("plastic 0.5", plastic(0.5)),
        ("metal 0.2", metal(0.2)),
        ("metal 1", metal(1.0)),
        ("metal 0.7 with all its light", Bsdf { multiple_scattering: true, ..metal(0.7) }),
        ("entering glass", glass(0.3, 1.5, false)),
        ("leaving glass", glass(0.4, 1.0 / 1.5, false)),
        ("thin glass", glass(0.3, 1.5, true)),
        ("glass of less reflection", tinted_glass),
        ("half metal, half glass", mixed),
        ("velvet 0.3", velvet(0.3)),
        ("velvet 1", velvet(1.0)),
        ("lacquer", coated(plastic(0.4), 0.2, 0.0)),
        ("leaning lacquer", coated(metal(0.5), 0.3, 0.2)),
        ("lacquered velvet on glass", {
            let sheen = Sheen::new(Rgb::splat(0.5), 0.6);
            coated(Bsdf { sheen, ..glass(0.3, 1.5, true) }, 0.15, 0.1)
        }),
    ]
}

/// 1e6 draws against the density over 64 × 32 bins of (cos, φ) of the sphere.
///
/// 45 comparisons at z = 4.0 (p = 3e-5 each) raise 0.14 % false alarms in all; seeds are fixed.
#[test]
fn draws_follow_the_density() {
    let cases: Vec<(&str, Bsdf, f32)> = kinds()
        .into_iter()
        .flat_map(|(name, bsdf)| [0.02, 0.4, 0.95].map(|mu| (name, bsdf, mu)))
        // A narrow lobe at grazing is thinner than the cells of the sum it is compared with.
        .filter(|(_, bsdf, mu)| *mu > 0.1 || bsdf.alpha > 0.1)
        .collect();
    cases.into_par_iter().for_each(|(name, bsdf, mu)| chi_square(name, bsdf, at(mu)));
}

fn chi_square(name: &str, bsdf: Bsdf, wo: Vec3) {
    const DRAWS: u32 = 1_000_000;
    const ROWS: usize = 64;
    const COLUMNS: usize = 32;
    // Sub-cells along either side of a bin, more where the count differs by over 2σ from their sum,
    // and what that may be wrong by.
    const FINE: usize = 12;
    const FINEST: usize = 64;
    const QUADRATURE_ERROR: f64 = 0.01;
    const LEAST_EXPECTED: f64 = 20.0;
    const Z: f64 = 4.0;
    let bin = |d: Vec3| {
        let row = ((d.z + 1.0) * 0.5 * ROWS as f32) as usize;
        let phi = d.y.atan2(d.x) / std::f32::consts::TAU + 0.5;
        row.min(ROWS - 1) * COLUMNS + ((phi * COLUMNS as f32) as usize).min(COLUMNS - 1)
    };
    let mut counts = vec![0.0; ROWS * COLUMNS];
    for s in draws(bsdf, wo, DRAWS).flatten() {
        counts[bin(s.direction)] += 1.0;
    }
    let expected = |k: usize, fine: usize| {
        let middle =
            |i: usize, k: usize, n: usize| (k as f64 + (i as f64 + 0.5) / fine as f64) / n as f64;
        let mut mass = 0.0;
        for sub in 0..fine * fine {
            let z = 2.0 * middle(sub / fine, k / COLUMNS, ROWS) - 1.0;
            let phi = (middle(sub % fine, k % COLUMNS, COLUMNS) - 0.5) * std::f64::consts::TAU;
            let r = (1.0 - z * z).sqrt();
            let wi = vec3((r * phi.cos()) as f32, (r * phi.sin()) as f32, z as f32);
            mass += f64::from(bsdf.evaluate(wo, wi).1);
        }
        let solid_angle = 4.0 * std::f64::consts::PI / (ROWS * COLUMNS * fine * fine) as f64;
        mass * f64::from(DRAWS) * solid_angle
    };
    let (mut chi, mut cells) = (0.0, 0.0);
    for (k, &count) in counts.iter().enumerate() {
        let mut mass = expected(k, FINE);
        if (count - mass) * (count - mass) > 4.0 * mass {
            mass = expected(k, FINEST);
        }
        if mass > LEAST_EXPECTED {
            let error = QUADRATURE_ERROR * mass;
            chi += (count - mass).powi(2) / (mass + error * error);
            cells += 1.0;
        }
    }
    // Wilson and Hilferty's cube root of a chi-square is nearly normal.
    let n: f64 = cells;
    let limit = n * (1.0 - 2.0 / (9.0 * n) + Z * (2.0 / (9.0 * n)).sqrt()).powi(3);
    assert!(chi < limit, "{name} at {wo}: chi-square {chi} over {limit} with {cells} bins");
}

/// Albedo by draws: nothing sends back more than it gets, seen from anywhere.
///
/// But plastic: appendix B mixes Lambert and facets by the Fresnel factor of the half vector, which
/// along a grazing view is small for most of Lambert's directions and large for the mirror's; white
/// plastic of α = 0.05 sends back 1.46 at μ = 0.02. That is the format's own word.
/// Numbers in f64 below 1 are 1 in f32, once in some ten million.
#[test]
fn numbers_at_the_edges_draw_unit_directions() {
    for (name, bsdf) in kinds() {
        for u in [Vec2::ZERO, Vec2::X, Vec2::Y, Vec2::ONE] {
            for choice in [0.0, 0.5, to_f32(1.0)] {
                let Some(drawn) = bsdf.sample(at(0.6), u, choice) else { continue };
                let length = drawn.direction.length();
                assert!((length - 1.0).abs() < 1e-4, "{name} {u} {choice}: {drawn:?}");
                assert!(
                    drawn.weight.is_finite() && drawn.pdf > 0.0,
                    "{name} {u} {choice}: {drawn:?}"
                );
            }
        }
    }
}

#[test]
fn no_kind_makes_light() {
    let white = |bsdf: Bsdf| Bsdf { base: Rgb::ONE, f0: Rgb::splat(0.04), ..bsdf };
    let whitest = Sheen::new(Rgb::ONE, 0.05);
    let more = [
        ("white under white sheen", Bsdf { sheen: whitest, ..Bsdf::lambert(Rgb::ONE) }),
        ("white under a varnish", coated(Bsdf::lambert(Rgb::ONE), 0.0, 0.0)),
        ("mirror under a varnish", coated(metal(0.0), 0.0, 0.0)),
    ];
    let plastic = |name: &str| {
        ["plastic", "lacquer", "half", "metal 0.7"].iter().any(|p| name.starts_with(p))
    };
    for (name, bsdf) in kinds().into_iter().filter(|k| !plastic(k.0)).chain(more) {
        for mu in [0.02, 0.1, 0.5, 1.0] {
            const N: u32 = 40_000;
            let weights: Vec<f64> = draws(white(bsdf), at(mu), N)
                .map(|s| s.map_or(0.0, |s| f64::from(s.weight.max_element())))
                .collect();
            let mean = weights.iter().sum::<f64>() / f64::from(N);
            let square = weights.iter().map(|w| w * w).sum::<f64>() / f64::from(N);
            let sigma = ((square - mean * mean).max(0.0) / f64::from(N)).sqrt();
            // 48 comparisons at 4σ, one-sided: 0.15 % false alarms in all.
            assert!(mean < 1.0 + 4.0 * sigma + 1e-4, "{name} at {mu}: {mean} ± {sigma}");
        }
    }
}

/// With multiple scattering a white metal of any roughness sends back all it gets.
#[test]
fn a_white_metal_with_all_its_light_is_invisible_in_a_furnace() {
    for alpha in [0.05, 0.2, 0.5, 1.0] {
        for mu in [0.1, 0.5, 1.0] {
            let bsdf = Bsdf { multiple_scattering: true, ..metal(alpha) };
            const N: u32 = 40_000;
            let mean = draws(bsdf, at(mu), N).flatten().map(|s| f64::from(s.weight.x)).sum::<f64>()
                / f64::from(N);
            // The weight is G₁ / E: its σ is below 0.5, 4σ of the mean below 0.01.
            assert!((mean - 1.0).abs() < 0.01, "alpha {alpha} mu {mu}: {mean}");
        }
    }
}

/// Softened lobes reflect as much of a white sky as they did, to what the albedo's table is good for.
#[test]
fn softened_metal_and_plastic_reflect_as_much() {
    for (name, bsdf, views) in [
        ("mirror", metal(0.0), [0.2, 0.6, 1.0]),
        ("metal", metal(0.06), [0.2, 0.6, 1.0]),
        // Along the surface Fresnel's curve is steep, and wide facets meet it at other angles.
        ("varnished", coated(metal(0.1), 0.02, 0.0), [0.4, 0.6, 1.0]),
        ("plastic", plastic(0.02), [0.4, 0.6, 1.0]),
    ] {
        for mu in views {
            let mean = |bsdf: Bsdf| {
                const N: u32 = 40_000;
                let weights = draws(bsdf, at(mu), N).flatten().map(|s| f64::from(s.weight.x));
                weights.sum::<f64>() / f64::from(N)
            };
            let (own, soft) = (mean(bsdf), mean(bsdf.softened(at(mu), 0.25)));
            assert!((soft / own - 1.0).abs() < 0.04, "{name} at {mu}: {own} → {soft}");
        }
    }
    let glass = glass(0.0, 1.5, false);
    assert_eq!(glass.softened(at(0.5), 0.25), glass);
    assert_eq!(metal(0.5).softened(at(0.5), 0.25), metal(0.5));
}

/// A white metal given its light back departs from reciprocity by the quotient of its albedos at the
/// two directions, and by no more: up to 1.13 at α = 0.05 (along the surface), 2 at α = 1.
#[test]
fn multiple_scattering_is_reciprocal_but_for_its_albedo() {
    for alpha in [0.05, 0.3, 1.0] {
        let bsdf = Bsdf { multiple_scattering: true, ..metal(alpha) };
        for i in 0..2000 {
            let s = Sampler::new(8, (0, 0), 0, i, Numbers::Independent);
            let a = sample_cosine(s.pair(Purpose::Direction).as_vec2());
            let b = sample_cosine(s.pair(Purpose::Environment).as_vec2());
            let (f, back) = (bsdf.evaluate(a, b).0.x / b.z, bsdf.evaluate(b, a).0.x / a.z);
            let predicted = f * ggx::albedo(a.z, alpha) / ggx::albedo(b.z, alpha);
            assert!((back - predicted).abs() < 1e-3 * back + 1e-6, "{alpha}: {back} {predicted}");
        }
    }
}

/// A white surface under a varnish of any smoothness sends all back but what the rough facets lose.
#[test]
fn smooth_varnish_over_white_loses_nothing() {
    for mu in [0.05, 0.4, 1.0] {
        let bsdf = coated(Bsdf::lambert(Rgb::ONE), 0.0, 0.0);
        const N: u32 = 20_000;
        let mean = draws(bsdf, at(mu), N).flatten().map(|s| f64::from(s.weight.x)).sum::<f64>()
            / f64::from(N);
        // Weights differ between the lobes by less than 10 %: 4σ = 0.003.
        assert!((mean - 1.0).abs() < 3e-3, "{mu}: {mean}");
    }
}

/// Index 1 behind a rough surface: there is no boundary, and nothing may be lost at it.
#[test]
fn glass_of_index_one_is_not_there() {
    for alpha in [0.0, 0.09, 0.5] {
        let bsdf = Bsdf { f0: Rgb::ZERO, ..glass(alpha, 1.0, false) };
        for s in draws(bsdf, at(0.4), 200) {
            let s = s.expect("light goes through");
            assert!((s.direction + at(0.4)).length() < 1e-5 && (s.weight - 1.0).length() < 1e-5);
        }
    }
}

/// KHR_materials_specular holds for glass too: 0 takes the reflection away, but not total reflection.
#[test]
fn glass_without_specular_reflects_only_totally() {
    let outside = Bsdf { specular: 0.0, ..glass(0.0, 1.5, false) };
    for s in draws(outside, at(0.3), 200) {
        assert!(s.expect("light goes through").direction.z < 0.0);
    }
    let inside = Bsdf { specular: 0.0, ..glass(0.0, 1.0 / 1.5, false) };
    for s in draws(inside, at(0.3), 200) {
        let s = s.expect("all is reflected");
        assert!(s.direction.z > 0.0 && (s.weight - 1.0).length() < 1e-5);
    }
}

#[test]
fn glass_and_white_plastic_lose_nothing_where_they_may_not() {
    // Smooth glass reflects or refracts everything; a sheet too.
    for bsdf in [glass(0.0, 1.5, false), glass(0.0, 1.0 / 1.5, false), glass(0.0, 1.5, true)] {
        for mu in [0.1, 0.6, 1.0] {
            for s in draws(bsdf, at(mu), 100) {
                let s = s.unwrap();
                assert!((s.weight - Rgb::ONE).abs().max_element() < 1e-5);
                assert_eq!(s.pdf, f32::INFINITY);
            }
        }
    }
    // A perfect mirror.
    for s in draws(metal(0.0), at(0.3), 50) {
        assert!((s.unwrap().weight - Rgb::ONE).length() < 1e-5);
    }
}

#[test]
fn mean_weight_is_the_integral_of_the_value() {
    // Albedo by draws against a midpoint sum over the sphere: 4σ of the draws and 0.5 % for the sum.
    let cases: Vec<_> = kinds()
        .into_iter()
        .filter(|(_, bsdf)| bsdf.alpha >= 0.2)
        .flat_map(|(name, bsdf)| [0.3, 0.7].map(|mu| (name, bsdf, mu)))
        .collect();
    cases.into_par_iter().for_each(|(name, bsdf, mu)| {
        const N: u32 = 100_000;
        let weights: Vec<f64> =
            draws(bsdf, at(mu), N).map(|s| s.map_or(0.0, |s| f64::from(s.weight.x))).collect();
        let mean = weights.iter().sum::<f64>() / f64::from(N);
        let square = weights.iter().map(|w| w * w).sum::<f64>() / f64::from(N);
        let sigma = ((square - mean * mean) / f64::from(N)).sqrt();
        let (mut sum, m) = (0.0, 800);
        for a in 0..m {
            for b in 0..m {
                let z = (f64::from(a) + 0.5) / f64::from(m) * 2.0 - 1.0;
                let phi = (f64::from(b) + 0.5) / f64::from(m) * std::f64::consts::TAU;
                let r = (1.0 - z * z).sqrt();
                let wi = vec3((r * phi.cos()) as f32, (r * phi.sin()) as f32, z as f32);
                sum += f64::from(bsdf.evaluate(at(mu), wi).0.x);
            }
        }
        let integral = sum * 4.0 * std::f64::consts::PI / f64::from(m * m);
        let allowed = 4.0 * sigma + 5e-3 * integral;
        assert!((mean - integral).abs() < allowed, "{name} at {mu}: {mean} ± {sigma}, {integral}");
    });
}

#[test]
fn grazing_views_stay_finite() {
    for bsdf in [plastic(0.001), plastic(1.0), metal(0.01), glass(0.2, 1.5, false)] {
        for s in draws(bsdf, at(1e-4), 2000).flatten() {
            assert!(s.weight.is_finite() && s.weight.max_element() < 50.0, "{bsdf:?} {s:?}");
        }
    }
}
