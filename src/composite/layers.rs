//! The composite as one layered EXR picture.
//!
//! Unnamed R G B A is the finished picture in the plate's sample type; beside it stand the layers
//! that a compositor rebuilds it from: `object + (1 − object.A) · plate + difference`. Colour is in
//! channels ending in R G B, everything else in other suffixes. All values are finite; only
//! `difference` is signed.

use super::encode::Encoded;
use super::{Composite, Mode};
use crate::conventions::{Rgb, luminance};
use crate::photo::exr_file::{ExrPicture, ExrSamples};
use crate::photo::{Image, Photo, Primaries, Samples};
use crate::render::Difference;

/// Layers that can be written beside the main picture, as `[output] layers` names them.
pub const LAYERS: [&str; 10] = [
    "difference",
    "object",
    "shadow",
    "albedo",
    "stderr",
    "samples",
    "influence",
    "clip",
    "Z",
    "N",
];

/// `Z` where nothing is seen, metres: far, finite, and exact as f32.
pub const NO_DEPTH: f32 = 1e10;

/// The layered picture; `layers` chooses among [`LAYERS`], `None` is all of them.
///
/// Layers of an EXR plate are in its own primaries, all others in linear Rec.709. Attributes are
/// left to the caller.
pub fn exr_picture(
    plate: &Photo,
    difference: &Difference,
    composite: &Composite,
    encoded: &Encoded,
    layers: Option<&[String]>,
) -> ExrPicture {
    let (width, height) = (plate.linear.width(), plate.linear.height());
    let mut writer = Writer {
        picture: ExrPicture { width, height, ..ExrPicture::default() },
        // An EXR plate's own precision; pictures of 8 and 16 bit decode to more than half holds.
        float: !matches!(plate.samples, Samples::F16 { .. } | Samples::U8 { .. }),
        colour: exr_primaries(plate).rec709_from_rgb().map(|m| m.inverse()),
    };
    let wanted = |name: &str| layers.is_none_or(|chosen| chosen.iter().any(|layer| layer == name));
    writer.main(plate, difference, composite, encoded);
    if wanted("difference") {
        writer.rgb("difference", &composite.change);
    }
    if wanted("object") {
        writer.rgb("object", &difference.object);
        writer.plain("object.A", difference.coverage.pixels().iter().copied());
    }
    if wanted("shadow") {
        writer.plain_rgb("shadow", &composite.shadow);
    }
    if wanted("albedo") {
        writer.rgb("albedo", &difference.albedo);
    }
    if wanted("stderr") {
        writer.float("stderr.Y", difference.stderr.pixels().iter().map(|&s| luminance(s)));
    }
    if wanted("samples") {
        writer.float("samples.Y", difference.samples.pixels().iter().map(|&n| n as f32));
    }
    if wanted("influence") {
        let samples = difference.samples.pixels().iter();
        let changed = composite.changed.pixels().iter();
        let reached = samples.zip(changed).map(|(&n, &changed)| n > 0 || changed);
        writer.plain("influence.Y", reached.map(|reached| f32::from(u8::from(reached))));
    }
    if wanted("clip") {
        let clipped = plate.clipped.pixels().iter();
        writer.plain("clip.Y", clipped.map(|&clipped| f32::from(u8::from(clipped))));
    }
    if wanted("Z") {
        let depth = difference.depth.pixels().iter();
        writer.float("Z", depth.map(|&z| if z.is_finite() { z } else { NO_DEPTH }));
    }
    if wanted("N") {
        for (axis, name) in ["N.X", "N.Y", "N.Z"].into_iter().enumerate() {
            let normals = difference.normal.pixels().iter();
            writer.plain(name, normals.map(|n| n.to_array()[axis]));
        }
    }
    writer.picture
}

/// Primaries of the main picture and the colour layers.
pub fn exr_primaries(plate: &Photo) -> Primaries {
    match plate.samples {
        Samples::F16 { .. } | Samples::F32 { .. } => plate.encoding.primaries,
        Samples::U8 { .. } | Samples::U16 { .. } => Primaries::Rec709,
    }
}

/// How the mode is called in files.
impl Mode {
    pub fn name(self) -> &'static str {
        match self {
            Self::Additive => "additive",
            Self::Ratio => "ratio",
        }
    }
}

struct Writer {
    picture: ExrPicture,
    float: bool,
    /// File's primaries from Rec.709.
    colour: Option<glam::DMat3>,
}

impl Writer {
    /// R G B A: the plate's own samples for EXR plates, linear Rec.709 floats for all others.
    fn main(&mut self, plate: &Photo, d: &Difference, composite: &Composite, encoded: &Encoded) {
        let alpha_of = |i: usize| {
            let plate_alpha = plate.alpha.as_ref().map_or(1.0, |a| a.pixels()[i]);
            let covered = d.coverage.pixels()[i];
            covered + (1.0 - covered) * plate_alpha
        };
        let n = composite.linear.pixels().len();
        match &encoded.samples {
            Samples::F16 { channels, data } if *channels >= 3 => {
                for (c, name) in ["R", "G", "B", "A"].into_iter().enumerate() {
                    let samples = if c < *channels {
                        data.iter().skip(c).step_by(*channels).copied().collect()
                    } else {
                        vec![half::f16::ONE; n]
                    };
                    self.picture.push(name, ExrSamples::F16(samples));
                }
            }
            Samples::F32 { channels, data } if *channels >= 3 => {
                for (c, name) in ["R", "G", "B", "A"].into_iter().enumerate() {
                    let samples = if c < *channels {
                        data.iter().skip(c).step_by(*channels).copied().collect()
                    } else {
                        vec![1.0; n]
                    };
                    self.picture.push(name, ExrSamples::F32(samples));
                }
            }
            // FLOAT: half would round the plate's decoded values, and nothing may change them.
            _ => {
                for (c, name) in ["R", "G", "B"].into_iter().enumerate() {
                    let values = composite.linear.pixels().iter().enumerate();
                    // EXR is premultiplied; integer files are straight.
                    let values = values.map(|(i, l)| l.to_array()[c] * alpha_of(i));
                    self.picture.push(name, ExrSamples::F32(values.collect()));
                }
                self.picture.push("A", ExrSamples::F32((0..n).map(alpha_of).collect()));
            }
        }
    }

    /// A colour layer, in the file's primaries.
    fn rgb(&mut self, layer: &str, image: &Image<Rgb>) {
        match self.colour.filter(|matrix| *matrix != glam::DMat3::IDENTITY) {
            Some(matrix) => {
                let converted = image.map(|l| (matrix * l.as_dvec3()).as_vec3());
                self.plain_rgb(layer, &converted);
            }
            None => self.plain_rgb(layer, image),
        }
    }

    /// Three channels as they are.
    fn plain_rgb(&mut self, layer: &str, image: &Image<Rgb>) {
        for (c, suffix) in ["R", "G", "B"].into_iter().enumerate() {
            let values = image.pixels().iter().map(|l| l.to_array()[c]);
            self.plain(&format!("{layer}.{suffix}"), values);
        }
    }

    /// Half where the plate has no more, unless a value needs the range of float.
    fn plain(&mut self, name: &str, values: impl Iterator<Item = f32> + Clone) {
        let values = values.map(finite);
        if !self.float {
            let (samples, beyond_half) = ExrSamples::half(values.clone());
            if beyond_half == 0 {
                self.picture.push(name, samples);
                return;
            }
        }
        self.picture.push(name, ExrSamples::F32(values.collect()));
    }

    fn float(&mut self, name: &str, values: impl Iterator<Item = f32>) {
        self.picture.push(name, ExrSamples::F32(values.map(finite).collect()));
    }
}

/// 0 for what is no number: a compositor's average over one NaN is NaN.
fn finite(value: f32) -> f32 {
    if value.is_finite() { value } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::composite::{compose, encode};

    fn picture(plate: &Photo, d: &Difference, layers: Option<&[String]>) -> ExrPicture {
        let composite = compose(plate, d, Mode::Ratio).unwrap();
        let encoded = encode(plate, &composite, &d.coverage);
        exr_picture(plate, d, &composite, &encoded, layers)
    }

    fn channel<'a>(picture: &'a ExrPicture, name: &str) -> &'a ExrSamples {
        let found = picture.channels.iter().find(|channel| channel.name == name);
        &found.unwrap_or_else(|| panic!("no channel {name}")).samples
    }

    #[test]
    fn all_layers_are_there_and_finite() {
        let plate = Photo::from_linear(Image::filled(2, 1, Rgb::splat(0.5)));
        let mut d = Difference::nothing(2, 1);
        d.coverage[(0, 0)] = 0.5;
        d.object[(0, 0)] = Rgb::splat(0.1);
        d.stderr[(1, 0)] = Rgb::splat(f32::NAN);
        d.samples[(0, 0)] = 64;
        let picture = picture(&plate, &d, None);
        assert_eq!(picture.channels.len(), 4 + 3 + 4 + 3 + 3 + 1 + 1 + 1 + 1 + 1 + 3);
        assert_eq!(*channel(&picture, "Z"), ExrSamples::F32(vec![NO_DEPTH; 2]));
        assert_eq!(*channel(&picture, "influence.Y"), ExrSamples::F32(vec![1.0, 0.0]));
        assert_eq!(*channel(&picture, "stderr.Y"), ExrSamples::F32(vec![0.0; 2]));
        assert_eq!(*channel(&picture, "A"), ExrSamples::F32(vec![1.0; 2]));
    }

    #[test]
    fn chosen_layers_stand_alone_beside_the_main_picture() {
        let plate = Photo::from_linear(Image::filled(1, 1, Rgb::ONE));
        let picture = picture(&plate, &Difference::nothing(1, 1), Some(&["Z".to_owned()]));
        let names: Vec<&str> = picture.channels.iter().map(|c| c.name.as_str()).collect();
        assert_eq!(names, ["R", "G", "B", "A", "Z"]);
    }

    #[test]
    fn layers_of_a_half_plate_are_half_unless_they_need_more() {
        let plate = Photo {
            samples: Samples::F16 { channels: 3, data: vec![half::f16::ONE; 3] },
            ..Photo::from_linear(Image::filled(1, 1, Rgb::ONE))
        };
        let mut d = Difference::nothing(1, 1);
        d.coverage[(0, 0)] = 1.0;
        d.object[(0, 0)] = Rgb::new(1e6, 0.5, 0.5);
        let picture = picture(&plate, &d, None);
        assert_eq!(*channel(&picture, "object.R"), ExrSamples::F32(vec![1e6]));
        assert!(matches!(channel(&picture, "object.G"), ExrSamples::F16(_)));
        assert!(matches!(channel(&picture, "R"), ExrSamples::F16(_)));
    }
}
