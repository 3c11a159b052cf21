//! The clear sky's light by direction: Preetham, Shirley and Smits 1999, "A Practical Analytic Model for
//! Daylight", with Perez's five-parameter form, as printed.
//!
//! Only relative: its own luminance is two to six times a real clear sky's (methods-capture C8), so that
//! [`Sky`](super::Sky) takes shape and colour from here and strength from
//! [`clear_sky`](super::clear_sky). Fitted for turbidity 2 to 10 and the sun above the horizon; below
//! turbidity 2 it goes negative.

use std::f64::consts::PI;

use glam::{DMat3, DVec3};

use crate::photo::colour;

/// Cosines to the zenith below this count as this: at the horizon the form divides by 0.
const LEAST_COSINE: f64 = 0.01;

/// Perez's F: A darkens or brightens the horizon within B, C and D are the light round the sun, E the
/// backscatter.
#[derive(Clone, Copy, Debug)]
struct Perez {
    a: f64,
    b: f64,
    c: f64,
    d: f64,
    e: f64,
}

impl Perez {
    /// From slope and offset of each coefficient over turbidity.
    fn new(turbidity: f64, [a, b, c, d, e]: [[f64; 2]; 5]) -> Self {
        let line = |[slope, offset]: [f64; 2]| slope * turbidity + offset;
        Self { a: line(a), b: line(b), c: line(c), d: line(d), e: line(e) }
    }

    /// F of the cosine of the zenith angle θ and of the angle γ to the sun.
    fn value(&self, cos_theta: f64, gamma: f64, cos_gamma: f64) -> f64 {
        let Self { a, b, c, d, e } = self;
        (1.0 + a * (b / cos_theta).exp())
            * (1.0 + c * (d * gamma).exp() + e * cos_gamma * cos_gamma)
    }
}

const LUMINANCE: [[f64; 2]; 5] =
    [[0.1787, -1.4630], [-0.3554, 0.4275], [-0.0227, 5.3251], [0.1206, -2.5771], [-0.0670, 0.3703]];
const CHROMATICITY_X: [[f64; 2]; 5] = [
    [-0.0193, -0.2592],
    [-0.0665, 0.0008],
    [-0.0004, 0.2125],
    [-0.0641, -0.8989],
    [-0.0033, 0.0452],
];
const CHROMATICITY_Y: [[f64; 2]; 5] = [
    [-0.0167, -0.2608],
    [-0.0950, 0.0092],
    [-0.0079, 0.2102],
    [-0.0441, -1.6537],
    [-0.0109, 0.0529],
];
/// Of the zenith's x: rows by powers T², T, 1, columns by powers θ³, θ², θ, 1 of the sun's zenith angle.
const ZENITH_X: [[f64; 4]; 3] = [
    [0.00166, -0.00375, 0.00209, 0.0],
    [-0.02903, 0.06377, -0.03202, 0.00394],
    [0.11693, -0.21196, 0.06052, 0.25886],
];
const ZENITH_Y: [[f64; 4]; 3] = [
    [0.00275, -0.00610, 0.00317, 0.0],
    [-0.04214, 0.08970, -0.04153, 0.00516],
    [0.15346, -0.26756, 0.06670, 0.26688],
];

/// Luminance (kcd/m²) and CIE x, y straight above.
fn zenith(turbidity: f64, sun_zenith: f64) -> [f64; 3] {
    let chi = (4.0 / 9.0 - turbidity / 120.0) * (PI - 2.0 * sun_zenith);
    let luminance = (4.0453 * turbidity - 4.9710) * chi.tan() - 0.2155 * turbidity + 2.4192;
    let chromaticity = |rows: [[f64; 4]; 3]| {
        let row = |[a, b, c, d]: [f64; 4]| ((a * sun_zenith + b) * sun_zenith + c) * sun_zenith + d;
        let [square, linear, constant] = rows.map(row);
        (square * turbidity + linear) * turbidity + constant
    };
    [luminance, chromaticity(ZENITH_X), chromaticity(ZENITH_Y)]
}

/// The sky's light round one sun, kcd/m² as luminance of Rec.709.
#[derive(Clone, Copy, Debug)]
pub(super) struct Preetham {
    /// Of Y, x and y.
    perez: [Perez; 3],
    /// Y, x, y straight above over F there.
    zenith_over_f: [f64; 3],
    rec709_from_xyz: DMat3,
}

impl Preetham {
    /// `turbidity` 2…10; `sun_zenith` is the sun's angle to the zenith, 0…π/2.
    pub(super) fn new(turbidity: f64, sun_zenith: f64) -> Self {
        let perez =
            [LUMINANCE, CHROMATICITY_X, CHROMATICITY_Y].map(|lines| Perez::new(turbidity, lines));
        let zenith = zenith(turbidity, sun_zenith);
        let over_f = |i: usize| zenith[i] / perez[i].value(1.0, sun_zenith, sun_zenith.cos());
        Self {
            perez,
            zenith_over_f: [0, 1, 2].map(over_f),
            rec709_from_xyz: colour::rec709_from_xyz(),
        }
    }

    /// Light from a direction with these cosines to the zenith and to the sun, Rec.709.
    ///
    /// What Rec.709 cannot hold is cut at 0.
    pub(super) fn radiance(&self, cos_theta: f64, cos_gamma: f64) -> DVec3 {
        let [luminance, x, y] = self.xy_luminance(cos_theta, cos_gamma);
        let xyz = DVec3::new(x, y, 1.0 - x - y) * (luminance / y);
        (self.rec709_from_xyz * xyz).max(DVec3::ZERO)
    }

    /// Luminance, x and y.
    fn xy_luminance(&self, cos_theta: f64, cos_gamma: f64) -> [f64; 3] {
        let cos_theta = cos_theta.max(LEAST_COSINE);
        let cos_gamma = cos_gamma.clamp(-1.0, 1.0);
        let gamma = cos_gamma.acos();
        [0, 1, 2].map(|i| self.zenith_over_f[i] * self.perez[i].value(cos_theta, gamma, cos_gamma))
    }

    /// Irradiance of level ground by the whole sky, klx as luminance of Rec.709; good to 1e-4.
    pub(super) fn irradiance(&self, sun_zenith: f64) -> DVec3 {
        // Midpoints in cos θ and azimuth, of which one half mirrors the other.
        const STEPS: usize = 256;
        let (sin_sun, cos_sun) = sun_zenith.sin_cos();
        let mut sum = DVec3::ZERO;
        for j in 0..STEPS {
            let cos_theta = (j as f64 + 0.5) / STEPS as f64;
            let sin_theta = (1.0 - cos_theta * cos_theta).sqrt();
            for i in 0..STEPS {
                let azimuth = PI * (i as f64 + 0.5) / STEPS as f64;
                let cos_gamma = cos_theta * cos_sun + sin_theta * sin_sun * azimuth.cos();
                sum += self.radiance(cos_theta, cos_gamma) * cos_theta;
            }
        }
        sum * (2.0 * PI / (STEPS * STEPS) as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::conventions::luminance;

    fn zenith_angle(elevation_deg: f64) -> f64 {
        (90.0 - elevation_deg).to_radians()
    }

    /// From the paper's formulas, by another program.
    #[test]
    fn zenith_values_are_those_of_the_printed_formulas() {
        for (turbidity, elevation, wanted) in [
            (2.0, 60.0, [5.886_743_249, 0.251_421_462, 0.255_923_838]),
            (3.0, 60.0, [10.413_086_912, 0.253_434_184, 0.259_792_522]),
            (6.0, 20.0, [6.579_691_529, 0.271_447_491, 0.289_813_140]),
            (10.0, 5.0, [2.503_446_408, 0.310_683_021, 0.337_436_394]),
        ] {
            let sun = zenith_angle(elevation);
            let sky = Preetham::new(turbidity, sun);
            let found = sky.xy_luminance(1.0, sun.cos());
            for (found, wanted) in found.iter().zip(wanted) {
                assert!((found / wanted - 1.0).abs() < 1e-6, "{turbidity} {elevation}: {found}");
            }
        }
    }

    /// methods-capture C8: 24/32/56/85 klx at 60° for turbidity 2/3/6/10.
    #[test]
    fn irradiance_of_level_ground_is_what_others_found() {
        for (turbidity, wanted) in [(2.0, 24.0), (3.0, 32.0), (6.0, 56.0), (10.0, 85.0)] {
            let sun = zenith_angle(60.0);
            let found = luminance(Preetham::new(turbidity, sun).irradiance(sun).as_vec3());
            // Printed to a klux
            assert!((found - wanted).abs() < 0.6, "turbidity {turbidity}: {found} klx");
        }
    }

    #[test]
    fn light_is_never_negative_where_the_model_holds() {
        for turbidity in [2.0, 3.0, 6.0, 10.0] {
            for elevation in [0.1, 1.0, 5.0, 20.0, 60.0, 90.0] {
                let sky = Preetham::new(turbidity, zenith_angle(elevation));
                for cos_theta in [0.0, 0.01, 0.1, 0.5, 1.0] {
                    for cos_gamma in [-1.0, -0.5, 0.0, 0.5, 0.99, 1.0] {
                        let [luminance, x, y] = sky.xy_luminance(cos_theta, cos_gamma);
                        let at = format!("{turbidity} {elevation} {cos_theta} {cos_gamma}");
                        assert!(luminance > 0.0, "{at}: luminance {luminance}");
                        assert!(x > 0.1 && y > 0.1 && x + y < 0.95, "{at}: {x} {y}");
                    }
                }
            }
        }
    }

    /// methods-capture F30, C8: what is refused for this reason.
    #[test]
    fn a_turbidity_below_two_would_be_negative() {
        // 8.5° below a sun at 20°
        let sky = Preetham::new(1.5, zenith_angle(20.0));
        assert!(sky.xy_luminance(0.2, 0.989)[0] < -10.0);
    }

    #[test]
    fn the_zenith_is_blue_and_haze_is_whiter() {
        let colour = |turbidity| {
            let sun = zenith_angle(30.0);
            let l = Preetham::new(turbidity, sun).radiance(1.0, sun.cos());
            l / l.y
        };
        let (clear, hazy) = (colour(2.0), colour(8.0));
        assert!(clear.z > 1.5 && clear.x < 0.8, "{clear}");
        assert!(hazy.z < clear.z && hazy.x > clear.x, "{hazy}");
    }
}
