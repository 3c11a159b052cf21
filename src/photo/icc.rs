//! ICC profiles: recognised, or refused by name.
//!
//! A matrix profile whose curve is sRGB's, linear or a power is taken for what it is, whatever it
//! calls itself. Profiles with look-up tables (printers, scanners, some cameras) are refused: their
//! tables are made for viewing, not for light.

use std::path::Path;

use glam::{DMat3, DVec3};
use moxcms::{ColorProfile, DataColorSpace, ProfileText, ToneReprCurve};

use super::{Encoding, EncodingSource, PhotoError, Primaries, Transfer};

/// Largest difference between a profile's curve and the recognised one, in linear light.
const CURVE_TOLERANCE: f32 = 2e-3;

/// The encoding a profile describes.
///
/// # Errors
/// [`PhotoError::UnknownColour`] naming the profile.
pub(super) fn encoding(path: &Path, icc: &[u8]) -> Result<Encoding, PhotoError> {
    let unknown = |found: String| PhotoError::UnknownColour { path: path.into(), found };
    let profile = std::panic::catch_unwind(|| ColorProfile::new_from_slice(icc).ok())
        .ok()
        .flatten()
        .ok_or_else(|| unknown("has a damaged ICC profile".into()))?;
    let name = description(&profile);
    let recognised = match profile.color_space {
        DataColorSpace::Rgb => rgb(&profile),
        DataColorSpace::Gray => profile.gray_trc.as_ref().and_then(transfer).map(|transfer| {
            // Grey has no primaries: neutral in every space.
            (transfer, Primaries::Rec709)
        }),
        _ => None,
    };
    let (transfer, primaries) = recognised
        .ok_or_else(|| unknown(format!("has the ICC profile {name:?}, which is not understood")))?;
    Ok(Encoding { transfer, primaries, source: EncodingSource::Profile })
}

/// A profile that says what an encoding is; `None` where its chromaticities span no colour space.
///
/// A camera's measured curve is labelled sRGB, as the camera itself does.
pub(super) fn profile(encoding: &Encoding) -> Option<ColorProfile> {
    let transfer = encoding.transfer.label();
    // Where the standard's own digits exist they are taken.
    match (transfer, encoding.primaries) {
        (Transfer::Srgb, Primaries::Rec709) => return Some(ColorProfile::new_srgb()),
        (Transfer::Srgb, Primaries::DisplayP3) => return Some(ColorProfile::new_display_p3()),
        (Transfer::Gamma(220), Primaries::AdobeRgb) => return Some(ColorProfile::new_adobe_rgb()),
        (Transfer::Linear, Primaries::AcesCg) => return Some(ColorProfile::new_aces_cg_linear()),
        _ => {}
    }
    let mut profile = ColorProfile::new_srgb();
    let curve = match transfer {
        Transfer::Srgb | Transfer::Measured(_) => profile.red_trc.clone(),
        // ICC.1, 10.6: no entry is the identity, one entry an exponent in 256ths.
        Transfer::Linear => Some(ToneReprCurve::Lut(vec![])),
        Transfer::Gamma(hundredths) => {
            let in_256ths = (f64::from(*hundredths) * 2.56).round().min(f64::from(u16::MAX));
            Some(ToneReprCurve::Lut(vec![in_256ths as u16]))
        }
    };
    (profile.red_trc, profile.green_trc, profile.blue_trc) = (curve.clone(), curve.clone(), curve);
    let m = encoding.primaries.xyz_d50_from_rgb()?;
    let colorant = |v: DVec3| moxcms::Xyzd { x: v.x, y: v.y, z: v.z };
    profile.red_colorant = colorant(m.x_axis);
    profile.green_colorant = colorant(m.y_axis);
    profile.blue_colorant = colorant(m.z_axis);
    // The base's name and code points are not this encoding's.
    profile.cicp = None;
    let name = format!("{:?}, {transfer:?}", encoding.primaries);
    let (language, country) = ("en".to_string(), "US".to_string());
    let name = moxcms::LocalizableString::new(language, country, name);
    profile.description = Some(ProfileText::Localizable(vec![name]));
    Some(profile)
}

fn rgb(profile: &ColorProfile) -> Option<(Transfer, Primaries)> {
    let curves = [&profile.red_trc, &profile.green_trc, &profile.blue_trc];
    let transfer = transfer(curves[0].as_ref()?)?;
    for curve in &curves[1..] {
        if !follows(curve.as_ref()?, &transfer) {
            return None;
        }
    }
    let m = profile.colorant_matrix().v;
    let xyz_d50_from_rgb = DMat3::from_cols_array_2d(&m).transpose();
    Some((transfer, primaries(xyz_d50_from_rgb)?))
}

/// The primaries whose D50-adapted colorants these are, by name if they are known.
fn primaries(xyz_d50_from_rgb: DMat3) -> Option<Primaries> {
    let xy = |v: DVec3| {
        let sum = v.element_sum();
        [(v.x / sum) as f32, (v.y / sum) as f32]
    };
    let [red, green, blue] =
        [xyz_d50_from_rgb.x_axis, xyz_d50_from_rgb.y_axis, xyz_d50_from_rgb.z_axis].map(xy);
    let white = xy(xyz_d50_from_rgb * DVec3::ONE);
    let custom = Primaries::Custom([
        red[0], red[1], green[0], green[1], blue[0], blue[1], white[0], white[1],
    ]);
    let rec709_from_custom = custom.rec709_from_rgb()?;
    let named = [
        Primaries::Rec709,
        Primaries::DisplayP3,
        Primaries::AdobeRgb,
        Primaries::AcesCg,
        Primaries::Aces2065,
    ];
    // 2·10⁻³: profiles round their colorants to 16 bits and differ in the adaptation's digits.
    let same = |p: &Primaries| {
        p.rec709_from_rgb().is_some_and(|m| m.abs_diff_eq(rec709_from_custom, 2e-3))
    };
    Some(named.into_iter().find(same).unwrap_or(custom))
}

fn transfer(curve: &ToneReprCurve) -> Option<Transfer> {
    let middle = curve.make_linear_evaluator().ok()?.evaluate_value(0.5);
    let gamma = middle.ln() / 0.5f32.ln();
    let power =
        (0.5..8.0).contains(&gamma).then(|| Transfer::Gamma((gamma * 100.0).round() as u16));
    [Some(Transfer::Linear), Some(Transfer::Srgb), power]
        .into_iter()
        .flatten()
        .find(|t| follows(curve, t))
}

fn follows(curve: &ToneReprCurve, transfer: &Transfer) -> bool {
    let Ok(evaluator) = curve.make_linear_evaluator() else { return false };
    // Not at 0: the evaluator's power of zero is no zero for some exponents (1.8 among them).
    (1..=64).map(|i| i as f32 / 64.0).all(|v| {
        let difference = evaluator.evaluate_value(v) - transfer.decode(v);
        difference.abs() <= CURVE_TOLERANCE
    })
}

/// The profile's own name for messages.
fn description(profile: &ColorProfile) -> String {
    let text = match &profile.description {
        Some(ProfileText::PlainString(text)) => text.as_str(),
        Some(ProfileText::Localizable(texts)) => texts.first().map_or("", |t| t.value.as_str()),
        Some(ProfileText::Description(text)) => text.ascii_string.as_str(),
        None => "",
    };
    let name: String = text.chars().filter(|c| !c.is_control()).take(80).collect();
    if name.is_empty() { "without a name".into() } else { name }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn encoding_of(profile: ColorProfile) -> Result<Encoding, PhotoError> {
        encoding(Path::new("a.jpg"), &profile.encode().unwrap())
    }

    #[test]
    fn common_profiles_are_recognised() {
        for (profile, transfer, primaries) in [
            (ColorProfile::new_srgb(), Transfer::Srgb, Primaries::Rec709),
            (ColorProfile::new_display_p3(), Transfer::Srgb, Primaries::DisplayP3),
            (ColorProfile::new_adobe_rgb(), Transfer::Gamma(220), Primaries::AdobeRgb),
            (ColorProfile::new_aces_cg_linear(), Transfer::Linear, Primaries::AcesCg),
        ] {
            let found = encoding_of(profile).unwrap();
            assert_eq!((found.transfer, found.primaries), (transfer, primaries));
        }
    }

    #[test]
    fn an_unknown_matrix_profile_is_used_as_it_is() {
        let found = encoding_of(ColorProfile::new_dci_p3()).unwrap();
        assert!(matches!(found.primaries, Primaries::Custom(_)), "{found:?}");
        let white = found.primaries.rec709_from_rgb().unwrap() * DVec3::ONE;
        assert!((white - DVec3::ONE).length() < 1e-3, "{white}");
    }

    #[test]
    fn a_profile_that_is_not_understood_is_named() {
        let error = encoding_of(ColorProfile::new_bt2020_pq()).unwrap_err().to_string();
        assert!(error.contains("2020") && error.contains("a.jpg"), "{error}");
        let damaged = encoding(Path::new("a.jpg"), &[7; 300]).unwrap_err().to_string();
        assert!(damaged.contains("damaged ICC"), "{damaged}");
    }
}
