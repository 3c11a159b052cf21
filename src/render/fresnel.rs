//! Share of light that a smooth boundary reflects.

use glam::{Vec3, vec3};

use crate::conventions::Rgb;

/// Schlick's (1994) approximation as glTF 2.0 appendix B uses it: rises from `f0` to 1.
pub fn schlick(f0: Rgb, cosine: f32) -> Rgb {
    let m = (1.0 - cosine).clamp(0.0, 1.0);
    let m2 = m * m;
    f0 + (Rgb::ONE - f0) * (m2 * m2 * m)
}

/// Exact reflectance of a dielectric boundary for unpolarised light.
///
/// `cosine` > 0 is on the side of the incident ray, `eta` the index beyond over the index before.
/// 1 where everything is reflected.
pub fn dielectric(cosine: f32, eta: f32) -> f32 {
    let Some(transmitted) = transmitted_cosine(cosine, eta) else { return 1.0 };
    let parallel = (eta * cosine - transmitted) / (eta * cosine + transmitted);
    let perpendicular = (cosine - eta * transmitted) / (cosine + eta * transmitted);
    0.5 * (parallel * parallel + perpendicular * perpendicular)
}

/// Cosine on the far side (Snell), positive; `None` for total reflection.
fn transmitted_cosine(cosine: f32, eta: f32) -> Option<f32> {
    let sine2 = (1.0 - cosine * cosine).max(0.0) / (eta * eta);
    (sine2 < 1.0).then(|| (1.0 - sine2).sqrt())
}

/// Direction behind the boundary for light seen along `wo`; `m` is the normal on `wo`'s side.
///
/// Both unit; `None` for total reflection.
pub fn refract(wo: Vec3, m: Vec3, eta: f32) -> Option<Vec3> {
    let cosine = wo.dot(m);
    let transmitted = transmitted_cosine(cosine, eta)?;
    Some((m * (cosine / eta - transmitted) - wo / eta).normalize())
}

/// Reflectance of a dielectric at normal incidence.
pub fn normal_reflectance(ior: f32) -> f32 {
    let r = (ior - 1.0) / (ior + 1.0);
    r * r
}

/// Mirror image of `wo` about `m`, both unit.
pub fn reflect(wo: Vec3, m: Vec3) -> Vec3 {
    (2.0 * wo.dot(m) * m - wo).normalize()
}

/// What a sheet of a material with boundary reflectance `r` reflects and lets through, with all the
/// reflections between its two faces.
pub fn sheet(r: f32) -> (f32, f32) {
    let reflected = 2.0 * r / (1.0 + r);
    (reflected, 1.0 - reflected)
}

/// `z` up, for the local frames of this room.
pub const UP: Vec3 = vec3(0.0, 0.0, 1.0);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn glass_reflects_four_percent_head_on_and_all_at_grazing() {
        assert!((dielectric(1.0, 1.5) - 0.04).abs() < 1e-6);
        assert!((dielectric(1.0, 1.0 / 1.5) - 0.04).abs() < 1e-6);
        assert!(dielectric(1e-4, 1.5) > 0.999);
        assert_eq!(dielectric(0.5, 1.0 / 1.5), 1.0, "beyond the critical angle of 41.8 degrees");
        assert!((normal_reflectance(1.5) - 0.04).abs() < 1e-7);
    }

    #[test]
    fn brewster_light_is_half_of_the_perpendicular_reflectance() {
        let cosine = (1.5_f32).atan().cos();
        // tan θ = η: the parallel part vanishes; perpendicular ((1−η²)/(1+η²))².
        let wanted = 0.5 * (1.25_f32 / 3.25).powi(2);
        assert!((dielectric(cosine, 1.5) - wanted).abs() < 1e-6);
    }

    #[test]
    fn refraction_obeys_snell_and_is_reversible() {
        let wo = vec3(0.6, 0.0, 0.8);
        let inside = refract(wo, UP, 1.5).unwrap();
        assert!((inside.x + 0.4).abs() < 1e-6 && inside.z < 0.0);
        let back = refract(inside, -UP, 1.0 / 1.5).unwrap();
        assert!((back - wo).length() < 1e-5, "{back}");
        assert!(refract(vec3(0.8, 0.0, 0.6), UP, 1.0 / 1.5).is_none());
    }

    #[test]
    fn a_sheet_keeps_the_energy() {
        let (r, t) = sheet(0.04);
        assert!((r + t - 1.0).abs() < 1e-7 && (r - 0.076_923).abs() < 1e-6);
    }
}
