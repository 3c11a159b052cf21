//! Tone curves, primaries and the names users give colour spaces.
//!
//! Matrices are computed in f64 from CIE xy chromaticities, with Bradford adaptation to D65 (Lam
//! 1985) where the white differs. The sRGB curve is the exact one (IEC 61966-2-1), not a power of
//! 2.2, which is 47 % too dark at code 20. Nothing here clips: out-of-gamut light stays negative.

use std::str::FromStr;

use glam::{DMat3, DVec2, DVec3};

use super::{Encoding, EncodingSource, PhotoError, Primaries, Transfer};

/// Linear light (0…1 for codes 0…1) of an sRGB-encoded value; odd around zero, continued above 1.
pub fn srgb_decode(value: f32) -> f32 {
    let v = f64::from(value.abs());
    let linear = if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) };
    (linear as f32).copysign(value)
}

/// The sRGB code of linear light; inverse of [`srgb_decode`].
pub fn srgb_encode(linear: f32) -> f32 {
    let l = f64::from(linear.abs());
    let v = if l <= 0.003_130_8 { l * 12.92 } else { 1.055 * l.powf(1.0 / 2.4) - 0.055 };
    (v as f32).copysign(linear)
}

impl Transfer {
    /// Linear light of one of the file's numbers (scaled so that white is 1).
    pub fn decode(&self, value: f32) -> f32 {
        match self {
            Self::Linear => value,
            Self::Srgb => srgb_decode(value),
            Self::Gamma(hundredths) => {
                value.abs().powf(f32::from(*hundredths) / 100.0).copysign(value)
            }
            Self::Measured(curve) => curve.decode(value),
        }
    }

    /// The file's number for linear light; inverse of [`Self::decode`].
    pub fn encode(&self, linear: f32) -> f32 {
        match self {
            Self::Linear => linear,
            Self::Srgb => srgb_encode(linear),
            Self::Gamma(hundredths) => {
                linear.abs().powf(100.0 / f32::from(*hundredths)).copysign(linear)
            }
            Self::Measured(curve) => curve.encode(linear),
        }
    }

    /// The curve to write into a file's header: a camera that bends its tones still labels sRGB.
    pub(super) fn label(&self) -> &Self {
        if let Self::Measured(_) = self { &Self::Srgb } else { self }
    }
}

const D65: DVec2 = DVec2::new(0.3127, 0.3290);
/// White of ICC's profile connection space: X, Y, Z = 0.9642, 1, 0.8249.
const D50: DVec2 = DVec2::new(0.345_702_9, 0.358_538_7);

impl Primaries {
    /// CIE xy of red, green, blue and white.
    pub fn chromaticities(self) -> [f32; 8] {
        match self {
            Self::Rec709 => [0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290],
            Self::DisplayP3 => [0.68, 0.32, 0.265, 0.69, 0.15, 0.06, 0.3127, 0.3290],
            Self::AdobeRgb => [0.64, 0.33, 0.21, 0.71, 0.15, 0.06, 0.3127, 0.3290],
            Self::AcesCg => [0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767],
            Self::Aces2065 => [0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767],
            Self::Custom(xy) => xy,
        }
    }

    /// Matrix from linear RGB of these primaries to linear Rec.709; `None` where the chromaticities
    /// do not span a colour space.
    pub fn rec709_from_rgb(self) -> Option<DMat3> {
        if self == Self::Rec709 {
            return Some(DMat3::IDENTITY);
        }
        let rec709 = xyz_from_rgb(Self::Rec709.chromaticities())?;
        let this = self.chromaticities();
        let white = DVec2::new(this[6].into(), this[7].into());
        // The f32 attribute of an EXR header is D65 to a few parts in 10⁷, not exactly.
        let adapt =
            if white.distance(D65) < 1e-5 { DMat3::IDENTITY } else { bradford(white, D65)? };
        let matrix = rec709.inverse() * adapt * xyz_from_rgb(this)?;
        matrix.is_finite().then_some(matrix)
    }

    /// Matrix from linear RGB to XYZ adapted to D50 (Bradford), as ICC profiles hold it; `None` where
    /// the chromaticities do not span a colour space.
    pub(super) fn xyz_d50_from_rgb(self) -> Option<DMat3> {
        let this = self.chromaticities();
        let white = DVec2::new(this[6].into(), this[7].into());
        let matrix = bradford(white, D50)? * xyz_from_rgb(this)?;
        matrix.is_finite().then_some(matrix)
    }

    /// The named primaries within 10⁻³ of these chromaticities, else [`Self::Custom`].
    pub fn recognise(xy: [f32; 8]) -> Self {
        let named = [Self::Rec709, Self::DisplayP3, Self::AdobeRgb, Self::AcesCg, Self::Aces2065];
        let near = |p: &Self| p.chromaticities().iter().zip(xy).all(|(a, b)| (a - b).abs() <= 1e-3);
        named.into_iter().find(near).unwrap_or(Self::Custom(xy))
    }
}

/// XYZ of the white with chromaticity `xy`, Y = 1.
fn white_xyz(xy: DVec2) -> DVec3 {
    DVec3::new(xy.x / xy.y, 1.0, (1.0 - xy.x - xy.y) / xy.y)
}

/// Takes linear RGB to XYZ (RGB = 1,1,1 is the white with Y = 1).
fn xyz_from_rgb(xy: [f32; 8]) -> Option<DMat3> {
    let at = |i: usize| DVec2::new(xy[2 * i].into(), xy[2 * i + 1].into());
    // Columns x, y, 1−x−y, not divided by y: XYZ itself has a blue primary with y = 0.
    let column = |p: DVec2| DVec3::new(p.x, p.y, 1.0 - p.x - p.y);
    let directions = DMat3::from_cols(column(at(0)), column(at(1)), column(at(2)));
    if directions.determinant().abs() < 1e-6 || at(3).y.abs() < 1e-6 {
        return None;
    }
    let lengths = directions.inverse() * white_xyz(at(3));
    let matrix = directions * DMat3::from_diagonal(lengths);
    (matrix.is_finite() && matrix.determinant().abs() > 1e-9).then_some(matrix)
}

/// Takes CIE XYZ (2° observer) as it is to linear Rec.709: D65 of Y = 1 becomes 1, 1, 1.
pub fn rec709_from_xyz() -> DMat3 {
    let xyz_from_rec709 = xyz_from_rgb(Primaries::Rec709.chromaticities());
    // They are three corners of a triangle.
    xyz_from_rec709.expect("Rec.709's primaries span a colour space").inverse()
}

/// Bradford adaptation of XYZ from one white to another.
fn bradford(from: DVec2, to: DVec2) -> Option<DMat3> {
    let cone_from_xyz = DMat3::from_cols(
        DVec3::new(0.8951, -0.7502, 0.0389),
        DVec3::new(0.2664, 1.7135, -0.0685),
        DVec3::new(-0.1614, 0.0367, 1.0296),
    );
    let gain = (cone_from_xyz * white_xyz(to)) / (cone_from_xyz * white_xyz(from));
    let matrix = cone_from_xyz.inverse() * DMat3::from_diagonal(gain) * cone_from_xyz;
    matrix.is_finite().then_some(matrix)
}

/// A colour space a user can name: tone curve and primaries.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedColour {
    pub transfer: Transfer,
    pub primaries: Primaries,
}

impl NamedColour {
    /// The encoding of a file whose colour space the user named.
    pub fn encoding(&self) -> Encoding {
        Encoding {
            transfer: self.transfer.clone(),
            primaries: self.primaries,
            source: EncodingSource::Named,
        }
    }
}

const NAMES: [(&str, Transfer, Primaries); 8] = [
    ("srgb", Transfer::Srgb, Primaries::Rec709),
    ("linear-rec709", Transfer::Linear, Primaries::Rec709),
    ("display-p3", Transfer::Srgb, Primaries::DisplayP3),
    ("linear-p3", Transfer::Linear, Primaries::DisplayP3),
    ("adobe-rgb", Transfer::Gamma(220), Primaries::AdobeRgb),
    ("acescg", Transfer::Linear, Primaries::AcesCg),
    ("aces2065-1", Transfer::Linear, Primaries::Aces2065),
    ("gamma22-rec709", Transfer::Gamma(220), Primaries::Rec709),
];

/// The names [`NamedColour`] understands, for messages.
pub(super) fn known_names() -> String {
    NAMES.map(|(name, ..)| name).join(", ")
}

/// Reads a user's name for a colour space; `"auto"` gives `None`: the file itself must say.
pub fn named(name: &str) -> Result<Option<NamedColour>, PhotoError> {
    if name == "auto" { Ok(None) } else { name.parse().map(Some) }
}

impl FromStr for NamedColour {
    type Err = PhotoError;

    fn from_str(name: &str) -> Result<Self, PhotoError> {
        let lower = name.to_ascii_lowercase();
        NAMES
            .into_iter()
            .find(|(known, ..)| *known == lower)
            .map(|(_, transfer, primaries)| Self { transfer, primaries })
            .ok_or_else(|| PhotoError::ColourName { name: name.into() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn srgb_round_trip_is_the_identity_over_all_8_and_16_bit_codes() {
        for code in 0..=255u8 {
            let back = srgb_encode(srgb_decode(f32::from(code) / 255.0)) * 255.0;
            assert_eq!(back.round() as u8, code);
        }
        for code in 0..=u16::MAX {
            let back = srgb_encode(srgb_decode(f32::from(code) / 65535.0)) * 65535.0;
            assert_eq!(back.round() as u16, code);
        }
    }

    #[test]
    fn srgb_curve_has_the_values_of_the_standard() {
        assert!((srgb_decode(0.5) - 0.214_041_14).abs() < 1e-7);
        assert!((srgb_decode(0.04) - 0.04 / 12.92).abs() < 1e-9);
        assert_eq!(srgb_decode(1.0), 1.0);
        assert_eq!(srgb_decode(-0.5), -srgb_decode(0.5));
    }

    #[test]
    fn acescg_matrix_is_the_published_one() {
        // Rec.709 → ACEScg, Bradford, as published in the ACES configs (5 digits).
        let published =
            [[0.61310, 0.33952, 0.04738], [0.07019, 0.91635, 0.01345], [0.02062, 0.10957, 0.86981]];
        let acescg_from_rec709 = Primaries::AcesCg.rec709_from_rgb().unwrap().inverse();
        for (row, expected) in published.iter().enumerate() {
            for (column, value) in expected.iter().enumerate() {
                let ours = acescg_from_rec709.col(column)[row];
                assert!((ours - value).abs() < 2e-5, "[{row}][{column}] {ours} is not {value}");
            }
        }
    }

    #[test]
    fn white_stays_white_in_every_space() {
        for primaries in [
            Primaries::DisplayP3,
            Primaries::AdobeRgb,
            Primaries::AcesCg,
            Primaries::Aces2065,
            Primaries::Custom([1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0 / 3.0, 1.0 / 3.0]),
        ] {
            let white = primaries.rec709_from_rgb().unwrap() * DVec3::ONE;
            // Chromaticities are f32 (a few 10⁻⁸ of their own).
            assert!((white - DVec3::ONE).length() < 2e-6, "{primaries:?}: {white}");
        }
    }

    #[test]
    fn degenerate_chromaticities_are_no_colour_space() {
        assert!(Primaries::Custom([0.3; 8]).rec709_from_rgb().is_none());
        assert!(Primaries::Custom([f32::NAN; 8]).rec709_from_rgb().is_none());
        assert!(
            Primaries::Custom([0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3, 0.0])
                .rec709_from_rgb()
                .is_none()
        );
    }

    #[test]
    fn unknown_colour_name_lists_the_known_ones() {
        let message = "sRBG".parse::<NamedColour>().unwrap_err().to_string();
        assert!(message.contains("sRBG") && message.contains("acescg"), "{message}");
        assert!(named("auto").unwrap().is_none());
    }
}
