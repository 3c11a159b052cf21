//! The estimator against closed forms (methods-render R4). All tolerances: 3.5 standard errors of
//! the mean over 16 pixels (false alarm 0.3 % each by t₁₅) plus 0.3 % for the tessellation.

use glam::Vec3;

use super::Method;
use super::test_scenes::*;
use crate::conventions::Rgb;
use crate::light::Lights;
use crate::photo::Image;
use crate::scene::{AlbedoSource, Material, Mesh};

const COUPLED: Method = Method::Coupled;

/// D / L₀ at points on the ground along x, with its standard error.
fn ratios(objects: Vec<Mesh>, albedo: f32, lights: &Lights, points: &[f32]) -> Vec<(f64, f64)> {
    let grey = AlbedoSource::Constant(Rgb::ZERO);
    let scene = scene(objects, matt(albedo), vec![local(ground(20.0), grey)]);
    let plate = Image::filled(4, 4, Rgb::ZERO);
    let (cameras, _) = point_camera(points);
    cameras
        .iter()
        .map(|camera| mean_ratio(&render(&scene, lights, camera, &plate, COUPLED, 512, 11)))
        .collect()
}

fn assert_near(got: (f64, f64), wanted: f64, what: &str) {
    let tolerance = 3.5 * got.1 + 0.003 * wanted.abs();
    assert!((got.0 - wanted).abs() < tolerance, "{what}: {} ± {} for {wanted}", got.0, got.1);
}

#[test]
fn a_black_sphere_on_a_plane_takes_its_form_factor_of_a_uniform_sky() {
    let ball = sphere(Vec3::Y, 1.0, 5);
    let d = [0.5_f32, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 10.0];
    let wanted =
        [-0.715542, -0.353553, -0.170677, -0.089443, -0.031623, -0.014267, -0.004443, -0.000985];
    // From straight above the ball hides the points inside its outline: look from below is no
    // better, so points under it are left to the disc.
    for ((x, got), wanted) in
        d.iter().zip(ratios(vec![ball], 0.0, &uniform_sky(1.0), &d)).zip(wanted)
    {
        if *x > 1.0 {
            assert_near(got, wanted, &format!("d = {x}"));
        }
    }
}

#[test]
fn a_floating_or_half_sunk_sphere_takes_its_form_factor() {
    let d = [1.5_f32, 2.0];
    // R4.2: (r, h, d) = (1, 0.5, 1.5) and (1, 0, 2); R4.1 with h = 1.5: r²h/(d²+h²)^1.5.
    let sunk = ratios(vec![sphere(Vec3::Y * 0.5, 1.0, 5)], 0.0, &uniform_sky(1.0), &d);
    assert_near(sunk[0], -0.141044, "half sunk, d = 1.5");
    let half = ratios(vec![sphere(Vec3::ZERO, 1.0, 5)], 0.0, &uniform_sky(1.0), &d);
    assert_near(half[1], -0.028834, "sunk to the middle, d = 2");
    let high = ratios(vec![sphere(Vec3::Y * 1.5, 1.0, 5)], 0.0, &uniform_sky(1.0), &d);
    assert_near(high[1], -1.5 / (4.0_f64 + 2.25).powf(1.5), "floating, d = 2");
}

#[test]
fn a_wall_takes_its_form_factor() {
    // R4.3: height 1, half-width 1, distance 1, from the foot of its edge: two such halves.
    let wall = rectangle(Vec3::new(1.0, 0.0, -1.0), Vec3::Z * 2.0, Vec3::Y);
    let got = ratios(vec![wall], 0.0, &uniform_sky(1.0), &[0.0]);
    assert_near(got[0], -2.0 * 0.055734, "wall");
}

#[test]
fn an_umbra_loses_the_sun_and_the_blocked_sky() {
    // A black sphere high above: the sun's disc is covered whole, and the sky by the sphere's form factor.
    let lights = sunny_sky(60.0, 3.0);
    let toward = Vec3::new(0.5, 3.0_f32.sqrt() / 2.0, 0.0);
    let ball = sphere(toward * 10.0, 1.0, 5);
    let got = ratios(vec![ball], 0.0, &lights, &[0.0])[0];
    let whole = f64::from(lights.irradiance(Vec3::Y).x);
    let sun = 3.0 * f64::from(toward.y);
    // Sky radiance near the ball: rows 5 (30° from the zenith), almost constant over the ball's 5.7°.
    let mut sky = 0.0;
    let n = 400;
    for i in 0..n {
        for j in 0..n {
            let sin2 = 0.01 * (f64::from(i) + 0.5) / f64::from(n);
            let phi = std::f64::consts::TAU * (f64::from(j) + 0.5) / f64::from(n);
            // Projected onto the plane across the axis the cap is a disc: dω = d(sin²)/2 dφ / cos.
            let (sin, cos) = (sin2.sqrt(), (1.0 - sin2).sqrt());
            let (t, b) = toward.any_orthonormal_pair();
            let d =
                toward * cos as f32 + (t * phi.cos() as f32 + b * phi.sin() as f32) * sin as f32;
            let weight = 0.01 / 2.0 * std::f64::consts::TAU / f64::from(n * n) / cos;
            sky += f64::from(lights.environment.evaluate(d).0.x * d.y.max(0.0)) * weight;
        }
    }
    assert_near(got, -(sun + sky) / whole, "umbra");
}

#[test]
fn a_straight_edge_throws_the_penumbra_of_a_disc() {
    // R4.4: sun elevation 45°, edge at height 1 along z; width along x is 0.01861.
    let lights = {
        let sky = crate::light::Environment::constant(Rgb::ZERO);
        let half = crate::conventions::SUN_HALF_ANGLE_RAD as f32;
        let toward = Vec3::new(1.0, 1.0, 0.0);
        let sun = crate::light::Disc::from_irradiance(toward, half, Rgb::ONE);
        Lights::from_parts(sky, vec![sun])
    };
    // A black sheet standing on x = 0, 200 m long, seen edge on by rays from above: the sun at +x
    // 45° high throws the shadow of its top edge to x = −1.
    let sheet = rectangle(Vec3::new(0.0, 0.0, -100.0), Vec3::Z * 200.0, Vec3::Y);
    let width = 0.018_61_f32;
    let at = |share: f32| -1.0 + share * 0.5 * width;
    let points = [at(-0.5), at(0.0), at(0.5), at(-1.2), at(1.2)];
    let got = ratios(vec![sheet], 0.0, &lights, &points);
    // ½ + (x√(1−x²) + asin x)/π of the sun is seen; toward −x it is whole.
    for (got, wanted) in got.iter().zip([-0.1955, -0.5, -0.8045, 0.0, -1.0]) {
        // The two sides of a penumbra differ by tan δ: 0.5 % of its width.
        assert!((got.0 - wanted).abs() < 3.5 * got.1 + 0.008, "{} ± {} for {wanted}", got.0, got.1);
    }
}

#[test]
fn in_a_white_furnace_nothing_changes() {
    // R4.7: ρ = 1 everywhere under a sky of 1. Bounces of the plate are clamped at 0.95, so both
    // albedos are 0.9 here and the objects shine at what a closed furnace gives them.
    let ball = sphere(Vec3::Y, 1.0, 5);
    let scene =
        scene(vec![ball], matt(1.0), vec![local(ground(20.0), AlbedoSource::Constant(Rgb::ONE))]);
    let plate = Image::filled(4, 4, Rgb::ONE);
    let (cameras, _) = point_camera(&[2.0, 0.0]);
    let lights = uniform_sky(1.0);
    let d = render(&scene, &lights, &cameras[0], &plate, COUPLED, 1024, 5);
    let (mean, sigma) = mean_ratio(&d);
    // Paths end at depth 8: at d = 2 that leaves less than 0.2 % of the light.
    assert!(mean.abs() < 3.5 * sigma + 0.002, "{mean} ± {sigma}");
    let d = render(&scene, &lights, &cameras[1], &plate, COUPLED, 256, 5);
    assert!(d.coverage.pixels().iter().all(|&c| c == 1.0));
    let top: f32 = d.object.pixels().iter().map(|p| p.x).sum::<f32>() / 16.0;
    assert!((top - 1.0).abs() < 0.01, "{top}");
}

#[test]
fn a_mirror_and_clear_glass_vanish_in_a_furnace() {
    // R4.8: nothing but a uniform sphere of light; what is reflected is what is behind.
    let mirror = Material { metallic: 1.0, roughness: 0.0, specular: 1.0, ..matt(1.0) };
    let glass =
        Material { transmission: 1.0, solid: true, roughness: 0.0, specular: 1.0, ..matt(1.0) };
    let sheet = Material { transmission: 1.0, roughness: 0.0, specular: 1.0, ..matt(1.0) };
    for (name, material, lost) in
        [("mirror", mirror, 3e-3), ("glass", glass, 0.01), ("sheet", sheet, 0.01)]
    {
        let scene = scene(vec![sphere(Vec3::ZERO, 0.3, 5)], material, Vec::new());
        let camera = corner_camera(24, 18, 2.0);
        let plate = Image::filled(24, 18, Rgb::ONE);
        let d = render(&scene, &uniform_sky(1.0), &camera, &plate, COUPLED, 64, 2);
        let covered: f32 = d.coverage.pixels().iter().sum();
        let sent: f32 = d.object.pixels().iter().map(|p| p.x).sum();
        assert!(covered > 20.0, "{name}: {covered} pixels");
        // Lost: what paths longer than twelve edges carry, and, at the outline, mirror directions of
        // the smooth normal that lead into the triangle.
        assert!((sent / covered - 1.0).abs() < lost, "{name}: {}", sent / covered);
        assert!(d.difference.pixels().iter().all(|&p| p == Rgb::ZERO), "{name}: no surface");
    }
}

#[test]
fn a_coloured_ball_of_index_one_obeys_beers_law() {
    // Nothing bends nor reflects, however rough: through the middle of a ball of radius r, share
    // c^(2r / d) of a white sky is left.
    let (r, d) = (0.3_f32, 0.25);
    let colour = Rgb::new(0.9, 0.5, 0.1);
    let coloured = Material {
        transmission: 1.0,
        solid: true,
        roughness: 0.5,
        ior: 1.0,
        specular: 1.0,
        attenuation_colour: colour,
        attenuation_distance: d,
        ..matt(1.0)
    };
    let scene = scene(vec![sphere(Vec3::ZERO, r, 5)], coloured, Vec::new());
    let pose =
        crate::camera::Pose::look_at(glam::DVec3::Z * 50.0, glam::DVec3::ZERO, glam::DVec3::Y);
    let lens = crate::camera::Lens::pinhole(1e5, 4, 4);
    let camera = crate::camera::Camera { width: 4, height: 4, lens, pose: pose.unwrap() };
    let plate = Image::filled(4, 4, Rgb::ONE);
    let seen = render(&scene, &uniform_sky(1.0), &camera, &plate, COUPLED, 32, 2);
    let wanted = colour.powf(2.0 * r / d);
    for (sent, coverage) in seen.object.pixels().iter().zip(seen.coverage.pixels()) {
        // The ball's corners stand outside the sphere by 1e-3 of r, and so do the ways through it.
        assert!(
            *coverage == 1.0 && (*sent / wanted - Rgb::ONE).abs().max_element() < 0.01,
            "{sent}"
        );
    }
}

#[test]
fn a_card_of_the_grounds_own_albedo_lying_on_it_is_invisible() {
    // R4.8 and G8: coplanar, so the object must win over the ground everywhere.
    let rho = 0.5;
    let card = rectangle(Vec3::new(-0.3, 0.0, 0.3), Vec3::X * 0.6, Vec3::NEG_Z * 0.6);
    let grey = AlbedoSource::Constant(Rgb::splat(rho));
    let scene = scene(vec![card], matt(rho), vec![local(ground(3.0), grey)]);
    let camera = corner_camera(24, 18, 2.0);
    let lights = sunny_sky(45.0, 2.0);
    let shown = lights.irradiance(Vec3::Y) * rho * std::f32::consts::FRAC_1_PI;
    let plate = Image::filled(24, 18, shown);
    let d = render(&scene, &lights, &camera, &plate, COUPLED, 128, 2);
    let mut inside = 0;
    for (c, sent) in d.coverage.pixels().iter().zip(d.object.pixels()) {
        assert!(*c == 0.0 || sent.x > 0.0);
        if *c == 1.0 {
            inside += 1;
            assert!((*sent / shown - Rgb::ONE).abs().max_element() < 0.1, "{sent} for {shown}");
        }
    }
    assert!(inside > 10);
    let worst = d.difference.pixels().iter().fold(0.0_f32, |m, p| m.max(p.abs().max_element()));
    assert!(worst < 1e-3 * shown.x, "the ground around it does not see it: {worst}");
}

#[test]
fn the_delivered_standard_error_is_the_scatter() {
    // R7.4 over 64 seeds of 64 samples in 8 replicates: rms of z in 0.9…1.1, |z| < 2 in 88…94 %.
    let scene = scene(
        vec![sphere(Vec3::new(0.0, 0.3, 0.0), 0.3, 3)],
        matt(0.5),
        vec![local(ground(2.0), AlbedoSource::Constant(Rgb::splat(0.5)))],
    );
    let lights = sunny_sky(40.0, 2.0);
    let camera = corner_camera(12, 9, 2.5);
    let plate = Image::filled(12, 9, lights.irradiance(Vec3::Y) * 0.5 / std::f32::consts::PI);
    let runs: Vec<_> =
        (0..64).map(|seed| render(&scene, &lights, &camera, &plate, COUPLED, 64, seed)).collect();
    let (mut squares, mut within, mut count) = (0.0, 0.0, 0.0);
    for k in 0..12 * 9 {
        let value =
            |d: &super::Difference| f64::from((d.object.pixels()[k] + d.difference.pixels()[k]).y);
        let mean: f64 = runs.iter().map(value).sum::<f64>() / 64.0;
        for d in &runs {
            let sigma = f64::from(d.stderr.pixels()[k].y);
            // Pixels that next to nothing reaches have no error to speak of.
            if sigma > 1e-4 {
                // The mean holds a 64th of the value itself.
                let z = (value(d) - mean) / sigma / (63.0_f64 / 64.0).sqrt();
                squares += z.clamp(-6.0, 6.0).powi(2);
                within += f64::from(u8::from(z.abs() < 2.0));
                count += 1.0;
            }
        }
    }
    assert!(count > 3000.0, "{count}");
    let rms = (squares / count).sqrt();
    // z follows t with 7 degrees of freedom: its rms is √(7/5) = 1.18 for a perfect estimate.
    let scale = (7.0_f64 / 5.0).sqrt();
    assert!((0.9..1.1).contains(&(rms / scale)), "rms z {rms}");
    assert!((0.86..0.94).contains(&(within / count)), "|z| < 2 in {}", within / count);
}
