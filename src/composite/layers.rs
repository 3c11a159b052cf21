//! The composite as one layered EXR picture.
//!
//! Unnamed R G B A is the finished picture in the plate's sample type; beside it stand the layers
//! that a compositor rebuilds it from: `object + (1 − object.A) · plate + difference`. Colour is in
//! channels ending in R G B, everything else in other suffixes. All values are finite; only
//! `difference` is signed.

use rayon::prelude::*;

use super::encode::Encoded;
use super::{Composite, Mode};
use crate::conventions::{Rgb, luminance};
use crate::photo::exr_file::{ExrPicture, ExrSamples};
use crate::photo::{Format, Image, Photo, Primaries, Samples, Window};
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
        window: difference.window,
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
        writer.plain("object.A", difference.coverage.pixels().iter().copied(), 0.0);
    }
    if wanted("shadow") {
        writer.plain_rgb("shadow", &composite.shadow, 1.0);
    }
    if wanted("albedo") {
        writer.rgb("albedo", &difference.albedo);
    }
    if wanted("stderr") {
        writer.float("stderr.Y", difference.stderr.pixels().iter().map(|&s| luminance(s)), 0.0);
    }
    if wanted("samples") {
        writer.float("samples.Y", difference.samples.pixels().iter().map(|&n| n as f32), 0.0);
    }
    if wanted("influence") {
        let sampled = difference.samples.pixels().iter().map(|&n| n > 0);
        writer.plain("influence.Y", sampled.map(|sampled| f32::from(u8::from(sampled))), 0.0);
    }
    if wanted("clip") {
        writer.clip(&plate.clipped);
    }
    if wanted("Z") {
        let depth = difference.depth.pixels().iter();
        writer.float("Z", depth.map(|&z| if z.is_finite() { z } else { NO_DEPTH }), NO_DEPTH);
    }
    if wanted("N") {
        for (axis, name) in ["N.X", "N.Y", "N.Z"].into_iter().enumerate() {
            let normals = difference.normal.pixels().iter();
            writer.plain(name, normals.map(|n| n.to_array()[axis]), 0.0);
        }
    }
    writer.picture
}

/// Primaries of the main picture and the colour layers.
pub fn exr_primaries(plate: &Photo) -> Primaries {
    if is_exr(plate) { plate.encoding.primaries } else { Primaries::Rec709 }
}

fn is_exr(plate: &Photo) -> bool {
    plate.format == Format::Exr
}

/// The grey sample of a float picture's pixel.
fn grey_sample(samples: &Samples, pixel: usize) -> f32 {
    let value = match samples {
        Samples::F16 { channels, data } => data[pixel * channels].to_f32(),
        Samples::F32 { channels, data } => data[pixel * channels],
        Samples::U8 { .. } | Samples::U16 { .. } => 0.0,
    };
    finite(value)
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
    /// What the layers are held of.
    window: Window,
    float: bool,
    /// File's primaries from Rec.709.
    colour: Option<glam::DMat3>,
}

impl Writer {
    /// R G B A, premultiplied: the plate's own samples for EXR plates, linear Rec.709 floats for all
    /// others. A grey EXR becomes RGB, since objects have colours.
    fn main(&mut self, plate: &Photo, d: &Difference, composite: &Composite, encoded: &Encoded) {
        let n = composite.linear.pixels().len();
        match &encoded.samples {
            Samples::F16 { channels, data } if is_exr(plate) && *channels >= 3 => {
                self.rgba(data, *channels, ExrSamples::F16);
            }
            Samples::F32 { channels, data } if is_exr(plate) && *channels >= 3 => {
                self.rgba(data, *channels, ExrSamples::F32);
            }
            // FLOAT: half would round the plate's decoded values, and nothing may change them.
            _ => {
                let width = composite.linear.width();
                let of_window = |i: usize| d.window.inside((i % width, i / width));
                let plate_alpha = |i: usize| plate.alpha.as_ref().map_or(1.0, |a| a.pixels()[i]);
                let alpha_of = |i: usize| {
                    let covered = of_window(i).map_or(0.0, |at| d.coverage[at]);
                    covered + (1.0 - covered) * plate_alpha(i)
                };
                let colour = |i: usize| {
                    let linear = composite.linear.pixels()[i];
                    match plate.format {
                        Format::Exr if of_window(i).is_some_and(|at| composite.changed[at]) => {
                            self.encoded(plate, linear)
                        }
                        // Grey is the same in all primaries; the way there and back would round it.
                        Format::Exr => Rgb::splat(grey_sample(&plate.samples, i)),
                        _ if plate.alpha.is_none() => linear,
                        _ => linear * alpha_of(i),
                    }
                };
                let channels = [0, 1, 2].map(|c| -> Vec<f32> {
                    (0..n).into_par_iter().map(|i| colour(i).to_array()[c]).collect()
                });
                for (name, values) in ["R", "G", "B"].into_iter().zip(channels) {
                    self.picture.push(name, ExrSamples::F32(values));
                }
                if plate.alpha.is_some() {
                    let values = (0..n).into_par_iter().map(alpha_of).collect();
                    self.picture.push("A", ExrSamples::F32(values));
                } else {
                    self.picture.push_part(
                        "A",
                        ExrSamples::F32(Vec::new()),
                        Window::default(),
                        1.0,
                    );
                }
            }
        }
    }

    /// Interleaved R G B and perhaps A as channels.
    fn rgba<T: Copy>(&mut self, data: &[T], channels: usize, samples: fn(Vec<T>) -> ExrSamples) {
        for (c, name) in ["R", "G", "B", "A"].into_iter().enumerate() {
            if c < channels {
                let values = data.iter().skip(c).step_by(channels).copied().collect();
                self.picture.push(name, samples(values));
            } else {
                self.picture.push_part(name, samples(Vec::new()), Window::default(), 1.0);
            }
        }
    }

    /// A linear Rec.709 colour as the plate's file writes colours.
    fn encoded(&self, plate: &Photo, linear: Rgb) -> Rgb {
        let own = self.colour.map_or(linear, |matrix| (matrix * linear.as_dvec3()).as_vec3());
        own.map(|l| plate.encoding.transfer.encode(l))
    }

    /// A colour layer, in the file's primaries; 0 outside the window.
    fn rgb(&mut self, layer: &str, image: &Image<Rgb>) {
        match self.colour.filter(|matrix| *matrix != glam::DMat3::IDENTITY) {
            Some(matrix) => {
                let converted = image.map(|l| (matrix * l.as_dvec3()).as_vec3());
                self.plain_rgb(layer, &converted, 0.0);
            }
            None => self.plain_rgb(layer, image, 0.0),
        }
    }

    /// Three channels as they are, `elsewhere` outside the window.
    fn plain_rgb(&mut self, layer: &str, image: &Image<Rgb>, elsewhere: f32) {
        for (c, suffix) in ["R", "G", "B"].into_iter().enumerate() {
            let values = image.pixels().iter().map(|l| l.to_array()[c]);
            self.plain(&format!("{layer}.{suffix}"), values, elsewhere);
        }
    }

    /// Half where the plate has no more, unless a value needs the range of float.
    fn plain(&mut self, name: &str, values: impl Iterator<Item = f32> + Clone, elsewhere: f32) {
        let values = values.map(finite);
        if !self.float {
            let (samples, beyond_half) = ExrSamples::half(values.clone());
            if beyond_half == 0 {
                self.picture.push_part(name, samples, self.window, elsewhere);
                return;
            }
        }
        self.float(name, values, elsewhere);
    }

    fn float(&mut self, name: &str, values: impl Iterator<Item = f32>, elsewhere: f32) {
        let samples = ExrSamples::F32(values.map(finite).collect());
        self.picture.push_part(name, samples, self.window, elsewhere);
    }

    /// Where the plate's file clips: of all of it.
    fn clip(&mut self, clipped: &Image<bool>) {
        let values = clipped.pixels().iter().map(|&clipped| f32::from(u8::from(clipped)));
        let samples = match self.float {
            true => ExrSamples::F32(values.collect()),
            false => ExrSamples::half(values).0,
        };
        self.picture.push("clip.Y", samples);
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
    use crate::photo::{Encoding, EncodingSource, Transfer};

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
        let alpha = picture.channels.iter().find(|channel| channel.name == "A");
        assert_eq!(alpha.and_then(|alpha| alpha.part), Some((Window::default(), 1.0)), "all of it");
    }

    #[test]
    fn a_difference_of_a_window_makes_the_file_that_its_whole_makes() {
        let plate = Photo::from_linear(Image::from_fn(7, 5, |x, y| {
            Rgb::new(0.1, 0.2, 0.3) * (1 + x + 7 * y) as f32
        }));
        let window = Window { first: (2, 1), size: (3, 2) };
        let mut d = Difference::nothing_within((7, 5), window);
        for (k, at) in [(0, 0), (1, 0), (2, 0), (0, 1), (1, 1), (2, 1)].into_iter().enumerate() {
            d.coverage[at] = 0.1 * k as f32;
            d.object[at] = Rgb::splat(0.3);
            d.difference[at] = Rgb::splat(-0.1 * k as f32);
            d.ratio[at] = Rgb::splat(-0.05 * k as f32);
            d.depth[at] = 3.0;
            d.samples[at] = 8;
        }
        let bytes = |d: &Difference| {
            let path = std::path::Path::new("a.exr");
            crate::photo::exr_file::to_bytes(path, &picture(&plate, d, None)).unwrap()
        };
        assert_eq!(bytes(&d), bytes(&d.whole()));
        let changed = compose(&plate, &d, Mode::Ratio).unwrap().linear;
        assert_ne!(changed[(2, 1)], plate.linear[(2, 1)]);
        assert_eq!(changed[(5, 1)], plate.linear[(5, 1)]);
        let samples = |d: &Difference| {
            let composite = compose(&plate, d, Mode::Ratio).unwrap();
            encode(&plate, &composite, &d.coverage).samples
        };
        assert_eq!(samples(&d), samples(&d.whole()));
    }

    #[test]
    fn chosen_layers_stand_alone_beside_the_main_picture() {
        let plate = Photo::from_linear(Image::filled(1, 1, Rgb::ONE));
        let picture = picture(&plate, &Difference::nothing(1, 1), Some(&["Z".to_owned()]));
        let names: Vec<&str> = picture.channels.iter().map(|c| c.name.as_str()).collect();
        assert_eq!(names, ["R", "G", "B", "A", "Z"]);
    }

    /// A plate of one pixel with alpha ½ and 0.4 as colour, one that an object covers by a quarter.
    fn half_there(format: Format, samples: Samples) -> (Photo, Difference) {
        let encoding = Encoding {
            transfer: Transfer::Linear,
            primaries: Primaries::AcesCg,
            source: EncodingSource::Header,
        };
        let plate = Photo {
            format,
            encoding,
            samples,
            alpha: Some(Image::filled(1, 1, 0.5)),
            ..Photo::from_linear(Image::filled(1, 1, Rgb::splat(0.4)))
        };
        let mut d = Difference::nothing(1, 1);
        d.coverage[(0, 0)] = 0.25;
        d.object[(0, 0)] = Rgb::new(0.2, 0.1, 0.05);
        (plate, d)
    }

    fn values(picture: &ExrPicture) -> [f32; 4] {
        ["R", "G", "B", "A"].map(|name| match channel(picture, name) {
            ExrSamples::F32(values) => values[0],
            other => panic!("{name} is {other:?}"),
        })
    }

    #[test]
    fn a_grey_exr_with_alpha_is_premultiplied_once_and_in_its_own_primaries() {
        let samples = Samples::F32 { channels: 2, data: vec![0.4, 0.5] };
        let (plate, d) = half_there(Format::Exr, samples);
        let own = values(&picture(&plate, &Difference::nothing(1, 1), None));
        assert_eq!(own, [0.4, 0.4, 0.4, 0.5], "nothing changed it");
        let found = values(&picture(&plate, &d, None));
        let rec709 = Rgb::new(0.2, 0.1, 0.05) + 0.75 * 0.4;
        let to_file = Primaries::AcesCg.rec709_from_rgb().unwrap().inverse();
        let expected = (to_file * rec709.as_dvec3()).as_vec3().extend(0.25 + 0.75 * 0.5);
        assert!((expected - glam::Vec4::from(found)).abs().max_element() < 1e-6, "{found:?}");
    }

    #[test]
    fn a_straight_float_tiff_is_written_premultiplied_in_rec709() {
        let samples = Samples::F32 { channels: 4, data: vec![0.4, 0.4, 0.4, 0.5] };
        let (plate, d) = half_there(Format::Tiff, samples);
        let found = values(&picture(&plate, &d, None));
        let expected = (Rgb::new(0.2, 0.1, 0.05) + 0.75 * 0.5 * 0.4).extend(0.25 + 0.75 * 0.5);
        assert!((expected - glam::Vec4::from(found)).abs().max_element() < 1e-6, "{found:?}");
        assert_eq!(exr_primaries(&plate), Primaries::Rec709);
    }

    #[test]
    fn layers_of_a_half_plate_are_half_unless_they_need_more() {
        let plate = Photo {
            format: Format::Exr,
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
