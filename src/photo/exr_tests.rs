//! EXR: what is written is what is read, with every channel, window and compression.

use exr::prelude::{
    AnyChannel, AnyChannels, Compression, Encoding as ExrEncoding, FlatSamples, Image as ExrImage,
    Layer, LayerAttributes, WritableImage,
};
use half::f16;

use super::exr_file::{ExrAttributes, ExrPicture, ExrSamples, LINEAR_REC709};
use super::tests::open;
use super::*;

pub(super) fn exr_bytes(picture: &ExrPicture) -> Vec<u8> {
    exr_file::to_bytes(Path::new("a.exr"), picture).unwrap()
}

/// A half picture holding every kind of half there is: 256 × 256 bit patterns.
pub(super) fn every_half() -> ExrPicture {
    let mut picture = ExrPicture { width: 256, height: 256, ..ExrPicture::default() };
    let bits = |shift: u16| (0..=u16::MAX).map(|v| f16::from_bits(v.wrapping_add(shift))).collect();
    picture.push("G", ExrSamples::F16(bits(1)));
    picture.push("R", ExrSamples::F16(bits(0)));
    picture.push("B", ExrSamples::F16(bits(2)));
    picture
}

#[test]
fn every_half_comes_back_with_its_own_bits() {
    let photo = open("a.exr", &exr_bytes(&every_half())).unwrap();
    let Samples::F16 { channels: 3, data } = &photo.samples else { panic!("not half RGB") };
    for (i, rgb) in data.chunks_exact(3).enumerate() {
        for (c, half) in rgb.iter().enumerate() {
            assert_eq!(half.to_bits(), (i as u16).wrapping_add(c as u16), "pixel {i}");
        }
    }
    // 2 × 1024 patterns have the exponent of NaN and infinity; each is seen through three channels.
    let bad = photo.nonfinite.unwrap();
    assert_eq!(bad.pixels, 2 * (1024 + 2));
    // 0x7bfe: the first pixel whose blue is infinite.
    assert_eq!(bad.first, (0xfe, 0x7b));
    assert!(photo.linear.pixels().iter().all(|l| l.is_finite()));
}

#[test]
fn a_channel_of_a_part_is_one_value_elsewhere() {
    let mut picture = ExrPicture { width: 5, height: 40, ..ExrPicture::default() };
    let window = Window { first: (1, 17), size: (3, 2) };
    let values = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
    picture.push_part("R", ExrSamples::F32(values.to_vec()), window, -1.0);
    picture.push_part("G", ExrSamples::half(values).0, window, 0.5);
    picture.push_part("B", ExrSamples::half([]).0, Window::default(), 7.0);
    let photo = open("a.exr", &exr_bytes(&picture)).unwrap();
    for (k, light) in photo.linear.pixels().iter().enumerate() {
        let inside = window.inside((k % 5, k / 5)).map(|(x, y)| values[3 * y + x]);
        let expected = [inside.unwrap_or(-1.0), inside.unwrap_or(0.5), 7.0];
        assert_eq!(light.to_array(), expected, "pixel {k}");
    }
    for window in [
        Window { first: (3, 0), size: (3, 2) },
        Window { first: (usize::MAX, 0), size: (3, 2) },
        Window { first: (0, 39), size: (3, 2) },
    ] {
        let mut beyond = ExrPicture { width: 5, height: 40, ..ExrPicture::default() };
        beyond.push_part("R", ExrSamples::F32(values.to_vec()), window, 0.0);
        let error = exr_file::to_bytes(Path::new("a.exr"), &beyond).unwrap_err().to_string();
        assert!(error.contains("reaches beyond it"), "{error}");
    }
}

#[test]
fn mixed_layers_come_back_by_name() {
    let mut picture = ExrPicture { width: 3, height: 2, ..ExrPicture::default() };
    let ramp = |k: f32| (0..6).map(move |i| k + i as f32);
    for (name, k) in [("R", 0.1), ("G", 0.2), ("B", 0.3)] {
        picture.push(name, ExrSamples::half(ramp(k)).0);
    }
    for (name, k) in [("difference.R", -3.0), ("difference.G", -2.0), ("difference.B", 1e9)] {
        picture.push(name, ExrSamples::F32(ramp(k).collect()));
    }
    picture.push("samples.Y", ExrSamples::U32(vec![0, 1, 2, 3, 4, 4_000_000]));
    let bytes = exr_bytes(&picture);
    let layer = |name: &str| {
        let options = ReadOptions { layer: Some(name.into()), ..ReadOptions::default() };
        read_bytes(Path::new("a.exr"), &bytes, &options)
    };
    let difference = layer("difference").unwrap();
    assert_eq!(difference.linear[(2, 1)], Rgb::new(2.0, 3.0, 1e9 + 5.0));
    assert_eq!(layer("samples").unwrap().linear[(2, 1)].x, 4_000_000.0);
    let error = layer("shadow").unwrap_err().to_string();
    assert!(error.contains("shadow") && error.contains("difference.G"), "{error}");
}

#[test]
fn the_same_picture_is_the_same_bytes_on_any_number_of_threads() {
    let mut picture = every_half();
    picture.attributes = ExrAttributes {
        comments: Some("{\"name\": \"Jørgen\"}".into()),
        colour_id: Some(LINEAR_REC709),
        ..ExrAttributes::default()
    };
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| exr_bytes(&picture))
    };
    let one = on(1);
    assert_eq!(one, on(4));
    let ascii = b"{\"name\": \"J\\u00f8rgen\"}";
    assert!(one.windows(ascii.len()).any(|w| w == ascii), "comments are JSON in plain ASCII");
}

#[test]
fn light_beyond_half_is_clamped_and_counted() {
    let (samples, clamped) = ExrSamples::half([1.0, 65504.0, 65519.0, 65520.0, 1e9, -1e9]);
    assert_eq!(clamped, 3);
    let ExrSamples::F16(halves) = samples else { panic!("not half") };
    assert_eq!(halves[4], f16::MAX);
    assert_eq!(halves[5], f16::MIN);
}

#[test]
fn pictures_that_contradict_themselves_are_not_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    let mut short = ExrPicture { width: 2, height: 2, ..ExrPicture::default() };
    short.push("R", ExrSamples::F32(vec![0.0; 3]));
    let mut double = ExrPicture { width: 1, height: 1, ..ExrPicture::default() };
    double.push("R", ExrSamples::F32(vec![0.0]));
    double.push("R", ExrSamples::F32(vec![0.0]));
    for picture in [short, double, ExrPicture::default()] {
        let error = exr_file::write(&path, &picture).unwrap_err().to_string();
        assert!(error.contains("a.exr"), "{error}");
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

/// An EXR as other programs write it: data window at `place`, any compression.
pub(super) fn foreign_exr(
    compression: Compression,
    place: (i32, i32),
    display: (usize, usize),
) -> Vec<u8> {
    let channel = |name: &str, k: f32| {
        let samples = (0..12).map(|i| k + i as f32).collect();
        AnyChannel::new(name, FlatSamples::F32(samples))
    };
    let channels = AnyChannels::sort(
        [channel("R", 100.0), channel("G", 200.0), channel("B", 300.0)].into_iter().collect(),
    );
    let attributes = LayerAttributes {
        layer_position: exr::math::Vec2(place.0, place.1),
        ..LayerAttributes::default()
    };
    let encoding = ExrEncoding { compression, ..ExrEncoding::FAST_LOSSLESS };
    let mut image = ExrImage::from_layer(Layer::new((4, 3), attributes, encoding, channels));
    image.attributes.display_window = exr::meta::attribute::IntegerBounds::from_dimensions(display);
    let mut bytes = std::io::Cursor::new(Vec::new());
    image.write().to_buffered(&mut bytes).unwrap();
    bytes.into_inner()
}

#[test]
fn the_data_window_is_placed_in_the_display_window() {
    // Data window 4 × 3 at (−1, 1) in a display window of 5 × 3: the left column and the last row
    // of it are outside, the rest of the display window is black.
    let photo = open("a.exr", &foreign_exr(Compression::ZIP16, (-1, 1), (5, 3))).unwrap();
    assert_eq!((photo.linear.width(), photo.linear.height()), (5, 3));
    let red = |x, y| photo.linear[(x, y)].x;
    assert_eq!([red(0, 0), red(4, 0), red(3, 1), red(4, 2)], [0.0; 4]);
    assert_eq!([red(0, 1), red(1, 1), red(2, 1)], [101.0, 102.0, 103.0]);
    assert_eq!([red(0, 2), red(2, 2)], [105.0, 107.0]);
    // What is not in the file is not seen, and told.
    assert_eq!(photo.data_window, Some(Window { first: (0, 1), size: (3, 2) }));
    assert!(photo.remarks[0].contains("60.0 %"), "{:?}", photo.remarks);
    for (place, display) in [((0, 0), (4, 3)), ((-1, -1), (3, 2))] {
        let whole = open("a.exr", &foreign_exr(Compression::ZIP16, place, display)).unwrap();
        assert!(
            whole.data_window.is_none() && whole.remarks.is_empty(),
            "{place:?} {:?}",
            whole.remarks
        );
    }
    let beside = open("a.exr", &foreign_exr(Compression::ZIP16, (9, 9), (4, 3))).unwrap();
    assert_eq!(beside.data_window.map(|window| window.size), Some((0, 0)));
}

#[test]
fn of_several_pictures_in_a_file_the_one_taken_is_told() {
    let part = |name: &str, k: f32| {
        let channel = |name: &str| AnyChannel::new(name, FlatSamples::F32(vec![k; 12]));
        let channels = [channel("R"), channel("G"), channel("B")].into_iter().collect();
        let attributes = LayerAttributes::named(name);
        Layer::new((4, 3), attributes, ExrEncoding::FAST_LOSSLESS, AnyChannels::sort(channels))
    };
    let display = exr::meta::attribute::IntegerBounds::from_dimensions((4, 3));
    let parts: exr::image::Layers<_> =
        [part("left", 1.0), part("right", 2.0)].into_iter().collect();
    let image = ExrImage::from_layers(exr::meta::header::ImageAttributes::new(display), parts);
    let mut bytes = std::io::Cursor::new(Vec::new());
    image.write().to_buffered(&mut bytes).unwrap();
    let photo = open("a.exr", bytes.get_ref()).unwrap();
    assert_eq!(photo.linear[(0, 0)].x, 1.0);
    let said = &photo.remarks[0];
    assert!(said.contains("2 pictures") && said.contains("part 1 (\"left\")"), "{said}");
}

#[test]
fn lossless_compressions_read_alike_and_dwa_is_refused_by_name() {
    let plain = open("a.exr", &foreign_exr(Compression::Uncompressed, (0, 0), (4, 3))).unwrap();
    for compression in [Compression::RLE, Compression::ZIP1, Compression::ZIP16, Compression::PIZ] {
        let photo = open("a.exr", &foreign_exr(compression, (0, 0), (4, 3))).unwrap();
        assert_eq!(photo.samples, plain.samples, "{compression:?}");
    }
    for compression in [Compression::DWAA(None), Compression::DWAB(None)] {
        let error = open("a.exr", &foreign_exr(compression, (0, 0), (4, 3))).unwrap_err();
        let error = error.to_string();
        assert!(error.contains("DWA") && error.contains("ZIP"), "{error}");
    }
}

#[test]
fn chromaticities_become_rec709() {
    let mut picture = ExrPicture { width: 1, height: 1, ..ExrPicture::default() };
    for name in ["R", "G", "B"] {
        picture.push(name, ExrSamples::F32(vec![if name == "G" { 1.0 } else { 0.0 }]));
    }
    picture.attributes.chromaticities = Some(Primaries::AcesCg);
    let photo = open("a.exr", &exr_bytes(&picture)).unwrap();
    assert_eq!(photo.encoding.primaries, Primaries::AcesCg);
    assert_eq!(photo.encoding.source, EncodingSource::Header);
    // Green of ACEScg is outside Rec.709: red and blue are negative and stay so.
    let green = photo.linear[(0, 0)];
    assert!(green.x < -0.5 && green.y > 1.1 && green.z < -0.05, "{green}");
}
