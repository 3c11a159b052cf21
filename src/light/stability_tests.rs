//! Sampling errors that textbooks and lecture notes print, each against what is right here.
//!
//! Numbers as in `docs/stability.md`. Fixed seeds; a statistical comparison is at 4σ (false alarm
//! 6e-5 each).

use std::f64::consts::{PI, TAU};

use glam::{DQuat, DVec2, DVec3, Vec3};

use super::{Disc, Environment, Lights};
use crate::conventions::Rgb;
use crate::photo::Image;

const WIDTH: usize = 128;
const HEIGHT: usize = 64;

/// Points that fill the square evenly (R2 sequence).
fn even(k: u32) -> DVec2 {
    let k = f64::from(k) + 0.5;
    DVec2::new((k * 0.754_877_666_246_693).fract(), (k * 0.569_840_290_998_053_3).fract())
}

fn map(texel: impl Fn(usize, usize) -> Rgb) -> Environment {
    Environment::new(&Image::from_fn(WIDTH, HEIGHT, texel), DQuat::IDENTITY, true).unwrap()
}

/// Mean of L max(0, n·ω) / p over draws and its standard error as if they were independent.
fn drawn_irradiance(env: &Environment, normal: Vec3, count: u32) -> (f64, f64) {
    let values = (0..count).map(|k| {
        let draw = env.sample(even(k)).unwrap();
        f64::from(draw.radiance.x * normal.dot(draw.direction).max(0.0) / draw.pdf)
    });
    let (sum, squares) = values.fold((0.0, 0.0), |(s, q), v| (s + v, q + v * v));
    let (n, mean) = (f64::from(count), sum / f64::from(count));
    (mean, ((squares / n - mean * mean).max(0.0) / n).sqrt())
}

/// ∫ |cos| dω over one texel of the upper half for a plane that looks up: Δφ Δ(sin²) / 2.
fn texel_irradiance(row: usize) -> f64 {
    let sine = |edge: usize| (PI * (0.5 - edge as f64 / HEIGHT as f64)).sin();
    TAU / WIDTH as f64 * (sine(row).powi(2) - sine(row + 1).powi(2)) / 2.0
}

#[test]
fn b04_b05_b08_b45_b46_a_lone_hot_texel_has_its_exact_energy_at_pole_seam_and_corner() {
    // A mass taken for a density, a missing sin θ, a corner for a texel, a neighbour's density: each
    // would show by whole factors near the pole or by a neighbour's black.
    for (column, row) in [(5, 0), (0, 0), (WIDTH - 1, 0), (0, 20), (WIDTH - 1, 20), (64, 31)] {
        let env = map(|i, j| Rgb::splat(if (i, j) == (column, row) { 1e4 } else { 0.0 }));
        let wanted = 1e4 * texel_irradiance(row);
        let exact = env.irradiance(DVec3::Y).x;
        assert!((exact / wanted - 1.0).abs() < 1e-5, "({column}, {row}): {exact} for {wanted}");
        let (mean, sigma) = drawn_irradiance(&env, Vec3::Y, 20_000);
        // The density is constant in the texel: rounding is all there is beside the cosine's spread.
        let allowed = 4.0 * sigma + 1e-4 * wanted;
        assert!((mean - wanted).abs() < allowed, "({column}, {row}): {mean} for {wanted}");
    }
}

#[test]
fn b30_a_tilted_plane_takes_its_cosine_from_its_own_normal() {
    // The pole's angle in the place of the normal's gives 1.12, 1.08 and 0.90 times as much.
    let bright = |i: usize, j: usize| Rgb::splat(if j < 20 || i == 90 { 3.0 } else { 0.3 });
    let env = map(bright);
    for tilt in [30.0_f64, 60.0, 90.0] {
        let (sin, cos) = tilt.to_radians().sin_cos();
        let normal = DVec3::new(sin, cos, 0.0);
        // What lies below the mean is left to other techniques: its share is the plane's cosine alone.
        let exact = env.irradiance(normal).x;
        let whole = Lights::from_parts(map(bright), Vec::new()).irradiance(normal.as_vec3()).x;
        assert!((exact - f64::from(whole)).abs() < 1e-4 * exact);
        let mut by_cells = 0.0;
        for k in 0..200_000 {
            // Uniform over the sphere
            let u = even(k);
            let (z, phi) = (1.0 - 2.0 * u.x, TAU * u.y);
            let r = (1.0 - z * z).sqrt();
            let d = DVec3::new(r * phi.cos(), z, r * phi.sin());
            let l = f64::from(env.evaluate(d.as_vec3()).0.x);
            by_cells += l * normal.dot(d).max(0.0) * 4.0 * PI / 200_000.0;
        }
        assert!((by_cells / exact - 1.0).abs() < 5e-3, "{tilt}: {by_cells} for {exact}");
    }
}

#[test]
fn b32_a_map_is_linear_to_its_table_and_its_look_up() {
    // A curve on one of the two would leave shares and radiance at odds: 1e4 becomes 6e8.
    let env = Environment::new(
        &Image::from_fn(WIDTH, HEIGHT, |i, _| Rgb::splat(if i < 64 { 1.0 } else { 1e4 })),
        DQuat::IDENTITY,
        false,
    )
    .unwrap();
    const N: u32 = 200_000;
    let dim = (0..N).filter(|&k| env.sample(even(k)).unwrap().radiance.x == 1.0).count();
    // A share of 1 / 10 001: 20 expected, even points scatter less than independent ones.
    assert!((10..=30).contains(&dim), "{dim}");
}

#[test]
fn b33_b34_b49_light_of_one_channel_alone_is_drawn() {
    // A luminance with negative or zero weights would give such texels no density.
    let colours = [Rgb::X, Rgb::Y, Rgb::Z];
    let env = map(|i, j| match (i, j) {
        (20, 10) => 100.0 * colours[0],
        (60, 30) => 100.0 * colours[1],
        (100, 50) => 100.0 * colours[2],
        _ => Rgb::ZERO,
    });
    let mut drawn = Rgb::ZERO;
    for k in 0..3000 {
        drawn += env.sample(even(k)).unwrap().radiance;
    }
    assert!(drawn.min_element() > 0.0, "{drawn}");
}

#[test]
fn b29_a_sun_gives_the_irradiance_of_its_angle() {
    // Ω = A / r² with the sphere's whole area, or the like, is four times too much.
    let half = crate::conventions::SUN_HALF_ANGLE_RAD;
    let omega = TAU * (1.0 - half.cos());
    let sun = Disc::from_irradiance(Vec3::Y, half as f32, Rgb::ONE);
    assert!((f64::from(sun.solid_angle()) / omega - 1.0).abs() < 1e-3);
    let radiance = 1.0 / (PI * half.sin().powi(2));
    assert!((f64::from(sun.radiance.x) / radiance - 1.0).abs() < 1e-3, "{}", sun.radiance);
    assert!((sun.irradiance(Vec3::Y).x - 1.0).abs() < 1e-3);
}
