//! The photo room's promises: what is written is what is read, and nothing a file holds does harm.

use exr::prelude::Compression;

use super::exr_tests::{every_half, exr_bytes, foreign_exr};
use super::*;

pub(super) fn open(name: &str, bytes: &[u8]) -> Result<Photo, PhotoError> {
    read_bytes(Path::new(name), bytes, &ReadOptions::default())
}

pub(super) fn open_as(name: &str, bytes: &[u8], colour: &str) -> Photo {
    let options = ReadOptions { colour: colour::named(colour).unwrap(), ..ReadOptions::default() };
    read_bytes(Path::new(name), bytes, &options).unwrap()
}

/// Interleaved samples that use the whole range.
fn codes(channels: usize, n: usize) -> Vec<u16> {
    (0..n * channels).map(|i| (i as u32 * 40_503 % 65_536) as u16).collect()
}

#[test]
fn png_and_tiff_give_back_the_samples_and_the_encoding() {
    let folder = tempfile::tempdir().unwrap();
    let encodings = [
        (Transfer::Srgb, Primaries::Rec709),
        (Transfer::Srgb, Primaries::DisplayP3),
        (Transfer::Gamma(220), Primaries::AdobeRgb),
        (Transfer::Linear, Primaries::AcesCg),
        // Everything else a user can name, and what a camera or an editor may write.
        (Transfer::Gamma(220), Primaries::Rec709),
        (Transfer::Linear, Primaries::Rec709),
        (Transfer::Linear, Primaries::DisplayP3),
        (Transfer::Linear, Primaries::Aces2065),
        (Transfer::Srgb, Primaries::AdobeRgb),
        (Transfer::Srgb, Primaries::AcesCg),
        (Transfer::Gamma(180), Primaries::DisplayP3),
    ];
    for (transfer, primaries) in encodings {
        let encoding =
            Encoding { transfer: transfer.clone(), primaries, source: EncodingSource::Profile };
        for channels in 1..=4 {
            let wide = codes(channels, 35);
            let narrow = wide.iter().map(|v| (v >> 8) as u8).collect();
            for samples in
                [Samples::U8 { channels, data: narrow }, Samples::U16 { channels, data: wide }]
            {
                let path = folder.path().join("a.png");
                png::write(&path, &samples, 7, 5, &encoding).unwrap();
                let photo = read(&path, &ReadOptions::default()).unwrap();
                assert_eq!(photo.samples, samples);
                assert_eq!(photo.encoding, encoding);
                if channels == 2 {
                    continue;
                }
                let path = folder.path().join("a.tif");
                tiff::write(&path, &samples, 7, 5, &encoding).unwrap();
                let photo = read(&path, &ReadOptions::default()).unwrap();
                assert_eq!(photo.samples, samples);
                assert_eq!(photo.encoding.transfer, transfer);
                assert_eq!(photo.encoding.primaries, primaries);
            }
        }
    }
}

#[test]
fn png_files_are_reproducible() {
    let encoding = Encoding {
        transfer: Transfer::Srgb,
        primaries: Primaries::DisplayP3,
        source: EncodingSource::Named,
    };
    let samples = Samples::U16 { channels: 3, data: codes(3, 35) };
    let folder = tempfile::tempdir().unwrap();
    let bytes = |name: &str| {
        let path = folder.path().join(name);
        png::write(&path, &samples, 7, 5, &encoding).unwrap();
        std::fs::read(path).unwrap()
    };
    let first = bytes("a.png");
    // The profile's date has a resolution of seconds.
    std::thread::sleep(std::time::Duration::from_millis(1100));
    assert_eq!(first, bytes("b.png"));
}

/// A PNG by the image crate: no colour chunks at all.
fn plain_png(kind: ::image::ExtendedColorType, raw: &[u8], width: u32, height: u32) -> Vec<u8> {
    let mut bytes = Vec::new();
    let encoder = ::image::codecs::png::PngEncoder::new(&mut bytes);
    ::image::ImageEncoder::write_image(encoder, raw, width, height, kind).unwrap();
    bytes
}

#[test]
fn sixteen_bits_without_a_profile_are_refused_until_named() {
    let raw: Vec<u8> = codes(3, 4).iter().flat_map(|v| v.to_ne_bytes()).collect();
    let bytes = plain_png(::image::ExtendedColorType::Rgb16, &raw, 2, 2);
    let error = open("scan.png", &bytes).unwrap_err().to_string();
    assert!(error.contains("scan.png") && error.contains("colour space"), "{error}");
    let linear = open_as("scan.png", &bytes, "linear-rec709");
    assert_eq!(linear.encoding.source, EncodingSource::Named);
    assert_eq!(linear.linear[(1, 0)].x, f32::from(codes(3, 4)[3]) / 65535.0);
    let srgb = open_as("scan.png", &bytes, "srgb");
    let expected = colour::srgb_decode(f32::from(codes(3, 4)[3]) / 65535.0);
    assert_eq!(srgb.linear[(1, 0)].x, expected);
}

#[test]
fn eight_bits_are_srgb_by_rule_and_clip_at_250() {
    let bytes = plain_png(::image::ExtendedColorType::Rgb8, &[249, 249, 249, 0, 250, 7], 2, 1);
    let photo = open("a.png", &bytes).unwrap();
    assert_eq!(photo.encoding.source, EncodingSource::FormatRule);
    assert_eq!(photo.encoding.transfer, Transfer::Srgb);
    assert_eq!(photo.clipped.pixels(), [false, true]);
    assert_eq!(photo.linear[(1, 0)].z, colour::srgb_decode(7.0 / 255.0));
}

/// A little-endian EXIF block with orientation, time, f-number and ISO.
fn exif_block(orientation: u16) -> Vec<u8> {
    let mut block = b"II*\0\x08\0\0\0".to_vec();
    let entry = |block: &mut Vec<u8>, tag: u16, kind: u16, value: u32| {
        block.extend(tag.to_le_bytes());
        block.extend(kind.to_le_bytes());
        block.extend(1u32.to_le_bytes());
        block.extend(value.to_le_bytes());
    };
    block.extend(2u16.to_le_bytes());
    entry(&mut block, 0x0112, 3, orientation.into());
    entry(&mut block, 0x8769, 4, 38);
    block.extend([0; 4]);
    block.extend(3u16.to_le_bytes());
    entry(&mut block, 0x829a, 5, 80);
    entry(&mut block, 0x829d, 5, 88);
    entry(&mut block, 0x8827, 3, 400);
    block.extend([0; 4]);
    for value in [1u32, 160, 28, 10] {
        block.extend(value.to_le_bytes());
    }
    block
}

/// A JPEG of `raw` RGB with an EXIF block.
fn jpeg(raw: &[u8], width: u32, height: u32, exif: &[u8]) -> Vec<u8> {
    let mut plain = Vec::new();
    let encoder = ::image::codecs::jpeg::JpegEncoder::new_with_quality(&mut plain, 100);
    let kind = ::image::ExtendedColorType::Rgb8;
    ::image::ImageEncoder::write_image(encoder, raw, width, height, kind).unwrap();
    let mut bytes = plain[..2].to_vec();
    bytes.extend([0xff, 0xe1]);
    bytes.extend((exif.len() as u16 + 8).to_be_bytes());
    bytes.extend(b"Exif\0\0");
    bytes.extend(exif);
    bytes.extend(&plain[2..]);
    bytes
}

#[test]
fn orientation_turns_samples_and_light_upright() {
    // 16 × 8, left half white: after a quarter turn clockwise the white half is on top.
    let raw: Vec<u8> = (0..128).flat_map(|i| [if i % 16 < 8 { 255 } else { 0 }; 3]).collect();
    let photo = open("a.jpg", &jpeg(&raw, 16, 8, &exif_block(6))).unwrap();
    assert_eq!((photo.linear.width(), photo.linear.height()), (8, 16));
    assert!(photo.linear[(4, 2)].x > 0.9 && photo.linear[(4, 13)].x < 0.1);
    assert!(photo.clipped[(4, 2)] && !photo.clipped[(4, 13)]);
    let Samples::U8 { channels: 3, data } = &photo.samples else { panic!("not RGB") };
    assert!(data[(2 * 8 + 4) * 3] > 240);
    let facts = &photo.facts;
    assert_eq!(facts.orientation, 6);
    assert_eq!(facts.exposure_s, Some(1.0 / 160.0));
    assert_eq!((facts.f_number, facts.iso), (Some(2.8), Some(400.0)));
}

#[test]
fn iso_beyond_its_tag_is_read_from_the_larger_ones() {
    let raw = [128u8; 64 * 3];
    let mut block = exif_block(1);
    // PhotographicSensitivity is the third entry of the second directory.
    let iso = 38 + 2 + 2 * 12;
    block[iso + 8..iso + 12].copy_from_slice(&65_535u32.to_le_bytes());
    let photo = open("a.jpg", &jpeg(&raw, 8, 8, &block)).unwrap();
    assert_eq!(photo.facts.iso, None, "65535 says only: see the other tags");
    // The f-number's place is taken by RecommendedExposureIndex, LONG.
    let at = iso - 12;
    block[at..at + 2].copy_from_slice(&0x8832u16.to_le_bytes());
    block[at + 2..at + 4].copy_from_slice(&4u16.to_le_bytes());
    block[at + 8..at + 12].copy_from_slice(&102_400u32.to_le_bytes());
    let photo = open("a.jpg", &jpeg(&raw, 8, 8, &block)).unwrap();
    assert_eq!(photo.facts.iso, Some(102_400.0));
}

#[test]
fn a_named_colour_stands_above_chunks_that_are_not_understood() {
    // cICP of HDR10: BT.2020 with PQ.
    let mut bytes = plain_png(::image::ExtendedColorType::Rgb8, &[128; 3], 1, 1);
    let chunk = [0, 0, 0, 4, b'c', b'I', b'C', b'P', 9, 16, 0, 1, 0, 0, 0, 0];
    bytes.splice(33..33, chunk);
    assert!(matches!(open("a.png", &bytes), Err(PhotoError::UnknownColour { .. })));
    let colour = colour::named("display-p3").unwrap();
    let options = ReadOptions { colour, ..ReadOptions::default() };
    let photo = read_bytes(Path::new("a.png"), &bytes, &options).unwrap();
    assert_eq!(photo.encoding.primaries, Primaries::DisplayP3);
}

#[test]
fn hostile_exif_gives_a_picture_without_facts() {
    let raw = [128u8; 64 * 3];
    let good = exif_block(6);
    for cut in 0..good.len() {
        let mut bad = good[..cut].to_vec();
        assert!(open("a.jpg", &jpeg(&raw, 8, 8, &bad)).is_ok(), "cut at {cut}");
        bad = good.clone();
        bad[cut] = 0xff;
        assert!(open("a.jpg", &jpeg(&raw, 8, 8, &bad)).is_ok(), "byte {cut}");
    }
}

#[test]
fn four_component_jpeg_is_refused_before_decoding() {
    let mut bytes = jpeg(&[128; 192], 8, 8, &exif_block(1));
    let sof = bytes.windows(2).position(|w| w == [0xff, 0xc0]).unwrap();
    bytes[sof + 9] = 4;
    let error = open("scan.jpg", &bytes).unwrap_err().to_string();
    assert!(error.contains("CMYK") && error.contains("RGB"), "{error}");
}

#[test]
fn radiance_hdr_round_trips_without_bias_in_either_convention() {
    let folder = tempfile::tempdir().unwrap();
    // Log-uniform over six decades, one channel ten times weaker.
    let picture = Image::from_fn(200, 100, |x, y| {
        let l = 10f32.powf(6.0 * ((x * 100 + y) as f32 * 0.618_034).fract() - 3.0);
        Rgb::new(l, 0.5 * l, 0.1 * l)
    });
    for mantissa in [Mantissa::Truncated, Mantissa::Rounded] {
        let path = folder.path().join("a.hdr");
        radiance_hdr::write(&path, &picture, mantissa).unwrap();
        let options = ReadOptions { mantissa, ..ReadOptions::default() };
        let back = read(&path, &options).unwrap();
        let bias = |c: usize| {
            let pairs = back.linear.pixels().iter().zip(picture.pixels());
            pairs.map(|(b, p)| f64::from(b[c] / p[c]) - 1.0).sum::<f64>() / 20_000.0
        };
        // One mantissa step is at most 1/128 of the strongest channel; a mean of 20 000 of them is
        // known to 2·10⁻⁵ there, and ten times worse in the weak channel.
        for (c, limit) in [(0, 2e-4), (1, 4e-4), (2, 2e-3)] {
            assert!(bias(c).abs() < limit, "{mantissa:?} channel {c}: {}", bias(c));
        }
    }
}

#[test]
fn radiance_hdr_headers_are_honoured() {
    let file = |header: &str| {
        let mut bytes =
            format!("#?RADIANCE\n{header}FORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 2\n").into_bytes();
        bytes.extend([128, 64, 0, 129, 0, 0, 0, 0]);
        bytes
    };
    let options = ReadOptions { mantissa: Mantissa::Rounded, ..ReadOptions::default() };
    let value = |header: &str| {
        read_bytes(Path::new("a.hdr"), &file(header), &options).unwrap().linear[(0, 0)]
    };
    assert_eq!(value(""), Rgb::new(1.0, 0.5, 0.0));
    assert_eq!(value("EXPOSURE=2\nEXPOSURE=4\n"), Rgb::new(0.125, 0.0625, 0.0));
    assert_eq!(value("COLORCORR=1 0.5 1\n"), Rgb::new(1.0, 1.0, 0.0));
    for bad in ["EXPOSURE=0\n", "EXPOSURE=nan\n", "COLORCORR=1 2\n", "PRIMARIES=1\n"] {
        assert!(open("a.hdr", &file(bad)).is_err(), "{bad}");
    }
    let xyze = String::from_utf8_lossy(&file("")).replace("rgbe", "xyze").into_bytes();
    assert!(open("a.hdr", &xyze).unwrap_err().to_string().contains("XYZE"));
}

#[test]
fn huge_claims_are_refused_before_anything_is_allocated() {
    let hdr = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 60000 +X 60000\n".to_vec();
    let mut png = plain_png(::image::ExtendedColorType::Rgb8, &[0; 3], 1, 1);
    png[16..24].copy_from_slice(&[0, 0, 0xea, 0x60, 0, 0, 0xea, 0x60]);
    let mut jpg = jpeg(&[128; 192], 8, 8, &exif_block(1));
    let sof = jpg.windows(2).position(|w| w == [0xff, 0xc0]).unwrap();
    jpg[sof + 5..sof + 9].copy_from_slice(&[0xff, 0xff, 0xff, 0xff]);
    for (name, bytes) in [("a.hdr", hdr), ("a.png", png), ("a.jpg", jpg)] {
        let error = open(name, &bytes).unwrap_err();
        assert!(matches!(error, PhotoError::TooLarge { .. }), "{name}: {error}");
    }
    // 8-bit grey: small in itself, thirteen times as large in linear light.
    let mut png = plain_png(::image::ExtendedColorType::L8, &[0], 1, 1);
    png[16..24].copy_from_slice(&[0, 0, 0xb3, 0xb0, 0, 0, 0xb3, 0xb0]);
    let error = open("grey.png", &png).unwrap_err();
    assert!(matches!(error, PhotoError::TooLarge { .. }), "{error}");
    // The crate itself compares an EXR's size with its chunks, so a true size is tried here.
    let options = ReadOptions { max_bytes: 256 * 256 * 4 * 3 - 1, ..ReadOptions::default() };
    let error = read_bytes(Path::new("a.exr"), &exr_bytes(&every_half()), &options).unwrap_err();
    assert!(matches!(error, PhotoError::TooLarge { .. }), "{error}");
}

#[test]
fn every_cut_of_every_format_is_an_error_or_a_picture() {
    let rgb: Vec<u8> = (0..35 * 3).map(|i| (i * 7) as u8).collect();
    let folder = tempfile::tempdir().unwrap();
    let encoding = Encoding {
        transfer: Transfer::Srgb,
        primaries: Primaries::Rec709,
        source: EncodingSource::Named,
    };
    let tif = folder.path().join("a.tif");
    tiff::write(&tif, &Samples::U8 { channels: 3, data: rgb.clone() }, 7, 5, &encoding).unwrap();
    let hdr = folder.path().join("a.hdr");
    let picture = Image::from_fn(7, 5, |x, y| Rgb::new(x as f32, y as f32, 1.0));
    radiance_hdr::write(&hdr, &picture, Mantissa::Truncated).unwrap();
    for (name, bytes) in [
        ("a.exr", foreign_exr(Compression::PIZ, (0, 0), (4, 3))),
        ("b.exr", foreign_exr(Compression::ZIP16, (1, 1), (9, 9))),
        ("a.png", plain_png(::image::ExtendedColorType::Rgb8, &rgb, 7, 5)),
        ("a.jpg", jpeg(&rgb, 7, 5, &exif_block(3))),
        ("a.tif", std::fs::read(tif).unwrap()),
        ("a.hdr", std::fs::read(hdr).unwrap()),
    ] {
        assert!(open(name, &bytes).is_ok(), "{name} whole");
        for cut in 0..bytes.len() {
            if let Err(error) = open(name, &bytes[..cut]) {
                assert!(error.to_string().contains(name), "{error}");
            }
        }
    }
}

#[test]
fn what_is_no_picture_is_told_apart() {
    for (bytes, word) in [
        (&b""[..], "empty"),
        (b"version https://git-lfs.github.com/spec/v1\n", "LFS"),
        (b"BM\0\0", "BMP"),
        (b"\0\0\0\x18ftypheic", "HEIC"),
        (b"hello", "known format"),
    ] {
        let error = open("a.xyz", bytes).unwrap_err().to_string();
        assert!(error.contains("a.xyz") && error.contains(word), "{error}");
    }
}

/// A folder of `../shared`, or `None` with a word where it is missing.
fn shared(folder: &str) -> Option<PathBuf> {
    let root = std::env::var_os("PLATELIGHT_SHARED").map_or_else(
        || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared")),
        PathBuf::from,
    );
    let path = root.join(folder);
    if !path.exists() {
        eprintln!("{} is missing: test skipped", path.display());
        return None;
    }
    Some(path)
}

fn files_below(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders = vec![folder.to_path_buf()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() { folders.push(path) } else { found.push(path) }
        }
    }
    found.sort();
    found
}

#[test]
fn odd_and_damaged_files_end_in_a_picture_or_an_error_that_names_them() {
    for set in ["data/exr-odd", "data/exr-damaged", "data/png-suite", "data/image-odd"] {
        let Some(folder) = shared(set) else { continue };
        for path in files_below(&folder) {
            match read(&path, &ReadOptions::default()) {
                Ok(photo) => {
                    let (w, h) = (photo.linear.width(), photo.linear.height());
                    assert!(photo.linear.pixels().iter().all(|l| l.is_finite()));
                    assert_eq!(photo.clipped.pixels().len(), w * h);
                }
                Err(error) => {
                    let name = path.file_name().unwrap().to_string_lossy();
                    assert!(error.to_string().contains(&*name), "{error}");
                }
            }
        }
    }
}

#[test]
fn display_windows_of_openexr_show_what_their_readme_says() {
    let Some(folder) = shared("data/exr-odd/DisplayWindow") else { return };
    let open = |name: &str| read(&folder.join(name), &ReadOptions::default()).unwrap().linear;
    let whole = open("t01.exr");
    assert_eq!((whole.width(), whole.height()), (400, 300));
    for apart in ["t09.exr", "t10.exr", "t11.exr", "t12.exr"] {
        assert!(open(apart).pixels().iter().all(|&l| l == Rgb::ZERO), "{apart}");
    }
    let black = |l: &&Rgb| **l == Rgb::ZERO;
    let corner = open("t13.exr");
    assert_eq!(corner[(0, 0)], whole[(399, 299)]);
    assert!(corner.pixels()[1..].iter().all(|l| black(&l)));
    let corner = open("t14.exr");
    let last = (corner.width() - 1, corner.height() - 1);
    assert_eq!(corner[last], whole[(0, 0)]);
    // Not square: the lens model of every later step would be wrong.
    let error = read(&folder.join("t15.exr"), &ReadOptions::default()).unwrap_err().to_string();
    assert!(error.contains("1.5"), "{error}");
}
