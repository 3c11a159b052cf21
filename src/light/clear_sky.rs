//! How strong sun and sky are under a clear sky: Bird and Riordan 1986, "Simple solar spectral model"
//! (SPCTRAL2), at one wavelength for each channel.
//!
//! Air mass, Rayleigh, ozone and Ångström's aerosol with Preetham's coefficients (1999, appendix A.1: β
//! from turbidity, exponent 1.3), sea level, 0.35 cm of ozone; water vapour hardly absorbs visible light
//! and is left out, and so is what ground and air throw to and fro (2 % over grass). Beside the same
//! formulas over 390–780 nm the luminances are within 3 %; in a low sun blue is up to a quarter too
//! strong. Real air of one turbidity differs by 20 to 30 % in the ratio of sun to sky.

use glam::DVec3;

use crate::photo::colour;

/// Wavelengths that stand for red, green and blue, µm.
const WAVELENGTHS: [f64; 3] = [0.612, 0.549, 0.465];
/// Ozone's absorption there, 1/cm (SPCTRAL2's table, interpolated).
const OZONE: [f64; 3] = [0.117, 0.084, 0.0075];
const OZONE_CM: f64 = 0.35;
/// CIE x, y of sunlight outside the atmosphere (SPCTRAL2's spectrum).
const SUNLIGHT_XY: [f64; 2] = [0.3226, 0.3335];
/// Mean cosine of the angles into which aerosol scatters (rural, SPCTRAL2).
const AEROSOL_COSINE: f64 = 0.65;

/// Irradiances as shares of the luminous irradiance of the sun outside the atmosphere, Rec.709.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ClearSky {
    /// By the sun on a surface facing it.
    pub(super) sun: DVec3,
    /// By the sky on level ground.
    pub(super) sky: DVec3,
}

/// The strength of sun and sky, the sun `zenith_deg` from the zenith (0…90, as it is seen).
pub(super) fn clear_sky(turbidity: f64, zenith_deg: f64) -> ClearSky {
    let cos_zenith = zenith_deg.to_radians().cos();
    // Kasten 1966
    let air_mass = 1.0 / (cos_zenith + 0.15 * (93.885 - zenith_deg).powf(-1.253));
    // Share of what aerosol scatters that goes on downward
    let g = (1.0 - AEROSOL_COSINE).ln();
    let a = g * (1.459 + g * (0.1595 + g * 0.4129));
    let b = g * (0.0783 + g * (-0.3824 - g * 0.5874));
    let downward = 1.0 - 0.5 * ((a + b * cos_zenith) * cos_zenith).exp();
    let beta = 0.046_08 * turbidity - 0.045_86;
    let channel = |c: usize| {
        let wavelength = WAVELENGTHS[c];
        let rayleigh = (-0.008_735 * wavelength.powf(-4.08) * air_mass).exp();
        let ozone = (-OZONE[c] * OZONE_CM * air_mass).exp();
        let aerosol_depth = beta * wavelength.powf(-1.3) * air_mass;
        let albedo = 0.945 * (-0.095 * (wavelength / 0.4).ln().powi(2)).exp();
        let scattered_through = (-albedo * aerosol_depth).exp();
        let absorbed_through = (-(1.0 - albedo) * aerosol_depth).exp();
        let sun = rayleigh * ozone * scattered_through * absorbed_through;
        let by_air = 0.5 * (1.0 - rayleigh.powf(0.95));
        let by_aerosol = rayleigh.powf(1.5) * (1.0 - scattered_through) * downward;
        (sun, cos_zenith * ozone * absorbed_through * (by_air + by_aerosol))
    };
    let [red, green, blue] = [0, 1, 2].map(channel);
    let outside = sunlight_outside();
    ClearSky {
        sun: outside * DVec3::new(red.0, green.0, blue.0),
        sky: outside * DVec3::new(red.1, green.1, blue.1),
    }
}

/// Sunlight outside the atmosphere, of luminance 1.
fn sunlight_outside() -> DVec3 {
    let [x, y] = SUNLIGHT_XY;
    colour::rec709_from_xyz() * DVec3::new(x / y, 1.0, (1.0 - x - y) / y)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::conventions::luminance;

    /// The luminous solar constant, klx.
    const OUTSIDE_KLX: f32 = 133.3;

    fn klx(turbidity: f64, elevation_deg: f64) -> [f32; 2] {
        let ClearSky { sun, sky } = clear_sky(turbidity, 90.0 - elevation_deg);
        [sun, sky].map(|e| luminance(e.as_vec3()) * OUTSIDE_KLX)
    }

    /// The same formulas summed over 390–780 nm by another program, with SPCTRAL2's spectrum and ozone.
    #[test]
    fn three_wavelengths_stand_for_the_spectrum() {
        for (turbidity, elevation, sun, sky) in [
            (2.0, 60.0, 102.4, 14.1),
            (2.0, 15.0, 56.1, 8.0),
            (3.0, 60.0, 91.4, 21.4),
            (3.0, 30.0, 69.5, 16.3),
            (6.0, 60.0, 65.0, 38.5),
            (10.0, 90.0, 48.3, 59.1),
        ] {
            let [found_sun, found_sky] = klx(turbidity, elevation);
            let at = format!("{turbidity} {elevation}: {found_sun} {found_sky}");
            assert!((found_sun / sun - 1.0).abs() < 0.03, "{at}");
            assert!((found_sky / sky - 1.0).abs() < 0.01, "{at}");
        }
    }

    /// methods-capture C8: real clear skies give 10 to 25 klx, the sun about 100 klx in all at 60°.
    #[test]
    fn a_clear_sky_is_as_strong_as_real_ones() {
        for turbidity in [2.0, 3.0] {
            let [sun, sky] = klx(turbidity, 60.0);
            assert!((10.0..25.0).contains(&sky), "{sky}");
            let level = sun * 60_f32.to_radians().sin() + sky;
            assert!((95.0..110.0).contains(&level), "{level}");
        }
    }

    #[test]
    fn a_low_sun_is_red_and_weak_and_haze_moves_light_from_sun_to_sky() {
        let high = clear_sky(3.0, 30.0).sun;
        let low = clear_sky(3.0, 85.0).sun;
        assert!(high.x / high.z < 1.6 && low.x / low.z > 5.0, "{high} {low}");
        assert!(low.y < 0.1 * high.y);
        let (clear, hazy) = (clear_sky(2.0, 40.0), clear_sky(8.0, 40.0));
        assert!(hazy.sun.y < 0.7 * clear.sun.y && hazy.sky.y > 2.0 * clear.sky.y);
        let horizon = clear_sky(10.0, 89.99);
        assert!(horizon.sun.min_element() >= 0.0 && horizon.sky.min_element() > 0.0);
    }
}
