//! Small valid files of every format, from which the mutations start.

use std::io::Cursor;
use std::path::Path;

use exr::prelude::{
    AnyChannel, AnyChannels, Blocks, Compression, Encoding, FlatSamples, Image, Layer,
    LayerAttributes, WritableImage,
};
use image::ExtendedColorType::{self, L8, La16, Rgb8, Rgb16, Rgb32F, Rgba8};
use image::ImageEncoder;
use image::codecs::{jpeg::JpegEncoder, png::PngEncoder, tiff::TiffEncoder};
use platelight::photo::exr_file::{self, EnvironmentMap, ExrAttributes, ExrPicture, ExrSamples};

type Seed = (&'static str, Vec<u8>);

/// The seeds of a format.
pub fn of(format: &str) -> Vec<Seed> {
    match format {
        "exr" => exrs(),
        "hdr" => hdrs(),
        "png" => pngs(),
        "tiff" => tiffs(),
        "jpeg" => jpegs(),
        "exif" => vec![("facts", exif())],
        "icc" => vec![
            ("p3", profile(moxcms::ColorProfile::new_display_p3())),
            ("adobe", profile(moxcms::ColorProfile::new_adobe_rgb())),
        ],
        "gltf" => {
            vec![
                ("layers", layers().into()),
                ("moving", moving().into()),
                ("triangle", gltf(TRIANGLE, ORANGE, "").into()),
            ]
        }
        "glb" => vec![("triangle", glb())],
        "obj" => vec![("square", OBJ.into())],
        "mtl" => vec![("gold", MTL.into())],
        "shot" => vec![("shot", SHOT.into())],
        "camera" => vec![("json", CAMERA.into()), ("yaml", YAML.into()), ("colmap", COLMAP.into())],
        "times" => {
            vec![("named", b"b.jpg 1/4\na.jpg 2\n".into()), ("plain", b"0.5\n1/60\n".into())]
        }
        _ => panic!("no seeds for {format}"),
    }
}

fn exrs() -> Vec<Seed> {
    let mut own = ExrPicture { width: 9, height: 5, ..ExrPicture::default() };
    let ramp = |k: f32| (0..45).map(move |i| k * i as f32).collect::<Vec<f32>>();
    for (name, k) in [("R", 0.1), ("G", 0.2), ("B", 0.3), ("difference.R", -1.0)] {
        own.push(name, ExrSamples::half(ramp(k)).0);
    }
    for name in ["difference.G", "difference.B", "Z"] {
        own.push(name, ExrSamples::F32(ramp(1e6)));
    }
    own.push("samples.Y", ExrSamples::U32((0..45).collect()));
    own.attributes = ExrAttributes {
        comments: Some("{}".into()),
        colour_id: Some(exr_file::LINEAR_REC709),
        environment: Some(EnvironmentMap::LatLong),
        world_to_camera: Some([0.5; 16]),
        ..ExrAttributes::default()
    };
    let bytes = exr_file::to_bytes(Path::new("seed"), &own).expect("the seed is valid");
    let mut seeds = vec![("own", bytes)];
    for (name, compression, blocks) in [
        ("plain", Compression::Uncompressed, Blocks::ScanLines),
        ("rle", Compression::RLE, Blocks::ScanLines),
        ("zips", Compression::ZIP1, Blocks::ScanLines),
        ("piz", Compression::PIZ, Blocks::ScanLines),
        ("pxr24", Compression::PXR24, Blocks::ScanLines),
        ("b44", Compression::B44, Blocks::ScanLines),
        ("tiles", Compression::ZIP16, Blocks::Tiles(exr::math::Vec2(4, 4))),
        ("dwaa", Compression::DWAA(None), Blocks::ScanLines),
    ] {
        seeds.push((name, foreign_exr(compression, blocks)));
    }
    seeds
}

fn foreign_exr(compression: Compression, blocks: Blocks) -> Vec<u8> {
    let channel = |name: &str, k: f32| {
        let samples = (0..70).map(|i| half::f16::from_f32(k * i as f32)).collect();
        AnyChannel::new(name, FlatSamples::F16(samples))
    };
    let channels = [channel("R", 0.1), channel("G", 0.2), channel("B", 0.3), channel("A", 0.01)];
    let attributes =
        LayerAttributes { layer_position: exr::math::Vec2(-2, 1), ..LayerAttributes::default() };
    let line_order = exr::meta::attribute::LineOrder::Increasing;
    let encoding = Encoding { compression, blocks, line_order };
    let channels = AnyChannels::sort(channels.into_iter().collect());
    let image = Image::from_layer(Layer::new((10, 7), attributes, encoding, channels));
    let mut bytes = Cursor::new(Vec::new());
    image.write().non_parallel().to_buffered(&mut bytes).expect("the seed is valid");
    bytes.into_inner()
}

fn hdrs() -> Vec<Seed> {
    let header = b"#?RADIANCE\nEXPOSURE=2\nPRIMARIES=0.64 0.33 0.3 0.6 0.15 0.06 0.3127 0.329\n\
                   FORMAT=32-bit_rle_rgbe\n\n";
    let file = |size: &[u8], pixels: &[u8]| [&header[..], size, pixels].concat();
    // New coding: two rows of 9; a run, then single values.
    let mut row = vec![2, 2, 0, 9];
    for channel in 0..4u8 {
        row.extend([128 + 4, 100 + channel, 5, 1, 2, 3, 4, 120 + channel]);
    }
    let new = file(b"-Y 2 +X 9\n", &[row.clone(), row].concat());
    let flat = file(b"-Y 1 +X 3\n", &[128, 64, 32, 129, 0, 0, 0, 0, 1, 200, 3, 140]);
    let old = file(b"-Y 1 +X 5\n", &[128, 64, 32, 129, 1, 1, 1, 4]);
    vec![("new", new), ("flat", flat), ("old", old)]
}

fn ramp(n: usize) -> Vec<u8> {
    (0..n).map(|i| (i * 37 % 256) as u8).collect()
}

fn pngs() -> Vec<Seed> {
    let png = |kind: ExtendedColorType, icc: Option<Vec<u8>>| {
        let mut bytes = Vec::new();
        let mut encoder = PngEncoder::new(&mut bytes);
        if let Some(icc) = icc {
            encoder.set_icc_profile(icc).expect("PNG holds profiles");
        }
        let raw = ramp(35 * usize::from(kind.bits_per_pixel()) / 8);
        encoder.write_image(&raw, 7, 5, kind).expect("the seed is valid");
        bytes
    };
    let p3 = profile(moxcms::ColorProfile::new_display_p3());
    vec![
        ("grey8", png(L8, None)),
        ("rgb8", png(Rgb8, None)),
        ("rgba8", png(Rgba8, None)),
        ("greyalpha16", png(La16, Some(p3.clone()))),
        ("rgb16", png(Rgb16, Some(p3))),
    ]
}

fn tiffs() -> Vec<Seed> {
    let tiff = |kind: ExtendedColorType| {
        let mut bytes = Cursor::new(Vec::new());
        let mut encoder = TiffEncoder::new(&mut bytes);
        encoder
            .set_icc_profile(profile(moxcms::ColorProfile::new_srgb()))
            .expect("TIFF holds profiles");
        let raw = ramp(35 * usize::from(kind.bits_per_pixel()) / 8);
        encoder.write_image(&raw, 7, 5, kind).expect("the seed is valid");
        bytes.into_inner()
    };
    vec![
        ("grey8", tiff(L8)),
        ("rgb8", tiff(Rgb8)),
        ("rgb16", tiff(Rgb16)),
        ("rgb32f", tiff(Rgb32F)),
    ]
}

fn jpegs() -> Vec<Seed> {
    let jpeg = |kind: ExtendedColorType, width: u32, height: u32| {
        let mut bytes = Vec::new();
        let raw = ramp((width * height) as usize * usize::from(kind.bits_per_pixel()) / 8);
        let encoder = JpegEncoder::new_with_quality(&mut bytes, 80);
        encoder.write_image(&raw, width, height, kind).expect("the seed is valid");
        bytes
    };
    let with_exif = {
        let plain = jpeg(Rgb8, 7, 5);
        let block = [b"Exif\0\0", exif().as_slice()].concat();
        let length = (block.len() as u16 + 2).to_be_bytes();
        [&plain[..2], &[0xff, 0xe1], &length, &block, &plain[2..]].concat()
    };
    vec![("grey", jpeg(L8, 8, 8)), ("colour", jpeg(Rgb8, 17, 9)), ("exif", with_exif)]
}

fn profile(profile: moxcms::ColorProfile) -> Vec<u8> {
    let mut bytes = profile.encode().expect("the profile is the crate's own");
    // The date of creation: the seeds are the same tomorrow.
    bytes[24..36].fill(1);
    bytes
}

/// Orientation, time, f-number, ISO, focal length and maker, little-endian.
fn exif() -> Vec<u8> {
    let mut block = b"II*\0\x08\0\0\0\x03\0".to_vec();
    let entry = |block: &mut Vec<u8>, tag: u16, kind: u16, count: u32, value: u32| {
        block.extend(tag.to_le_bytes());
        block.extend(kind.to_le_bytes());
        block.extend(count.to_le_bytes());
        block.extend(value.to_le_bytes());
    };
    entry(&mut block, 0x010f, 2, 4, u32::from_le_bytes(*b"Cam\0"));
    entry(&mut block, 0x0112, 3, 1, 6);
    entry(&mut block, 0x8769, 4, 1, 50);
    block.extend([0; 4]);
    block.extend(4u16.to_le_bytes());
    entry(&mut block, 0x829a, 5, 1, 104);
    entry(&mut block, 0x829d, 5, 1, 112);
    entry(&mut block, 0x8827, 3, 1, 400);
    entry(&mut block, 0x920a, 5, 1, 120);
    block.extend([0; 4]);
    for value in [1u32, 160, 28, 10, 350, 10] {
        block.extend(value.to_le_bytes());
    }
    block
}

/// One triangle whose buffer is `uri`.
/// The buffer of [`gltf`]: three corners and their indices.
const TRIANGLE: &str = "\"data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAAAAABAAIA\"";

/// A picture of one texel.
const TEXEL: &str = "data:image/png;base64,iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR4nGP438BwAgAGSQJIAdHolgAAAABJRU5ErkJggg==";

const ORANGE: &str = r#""pbrMetallicRoughness":{"baseColorFactor":[1,0.5,0,1],"metallicFactor":0}"#;

/// A triangle of `material`, its buffer at `uri`; `more` goes to the top of the document.
fn gltf(uri: &str, material: &str, more: &str) -> String {
    format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],{more}
"nodes":[{{"mesh":0,"translation":[0,1,0]}}],
"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}},"indices":1,"material":0}}]}}],
"materials":[{{{material}}}],
"buffers":[{{"byteLength":42,"uri":{uri}}}],
"bufferViews":[{{"buffer":0,"byteLength":36}},{{"buffer":0,"byteOffset":36,"byteLength":6}}],
"accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,0],"max":[1,1,0]}},
{{"bufferView":1,"componentType":5123,"count":3,"type":"SCALAR"}}]}}"#
    )
}

/// The triangle with every extension of materials that is read.
fn layers() -> String {
    let turned = r#"{"index":0,"texCoord":1,"extensions":{"KHR_texture_transform":{"offset":[0,1],"rotation":1,"texCoord":0}}}"#;
    let material = format!(
        r#"{ORANGE},"emissiveFactor":[1,0,0],"extensions":{{
"KHR_materials_sheen":{{"sheenColorFactor":[1,0.5,0],"sheenColorTexture":{{"index":0}},"sheenRoughnessFactor":0.5,"sheenRoughnessTexture":{turned}}},
"KHR_materials_clearcoat":{{"clearcoatFactor":0.5,"clearcoatTexture":{{"index":0}},"clearcoatRoughnessFactor":0.2,"clearcoatRoughnessTexture":{turned},
"clearcoatNormalTexture":{{"index":0,"scale":0.5}}}},
"KHR_materials_transmission":{{"transmissionFactor":0.5,"transmissionTexture":{turned}}},
"KHR_materials_volume":{{"thicknessFactor":1,"attenuationDistance":2,"attenuationColor":[1,0,0]}},
"KHR_materials_specular":{{"specularFactor":0.5,"specularColorTexture":{{"index":0}}}},
"KHR_materials_ior":{{"ior":1.4}},"KHR_materials_emissive_strength":{{"emissiveStrength":3}}}}"#
    );
    let more = format!(
        r#""textures":[{{"source":0,"sampler":0}}],"samplers":[{{"wrapS":33071}}],"images":[{{"uri":"{TEXEL}"}}],"#
    );
    gltf(TRIANGLE, &material, &more)
}

/// The triangle at two places, moved, turned and scaled, all by the numbers of its own corners.
fn moving() -> String {
    let animations = r#""animations":[{"name":"go","channels":[{"sampler":0,"target":{"node":0,"path":"translation"}},
{"sampler":1,"target":{"node":0,"path":"rotation"}},{"sampler":2,"target":{"node":0,"path":"scale"}}],
"samplers":[{"input":2,"output":3},{"input":2,"output":4,"interpolation":"STEP"},{"input":5,"output":0,"interpolation":"CUBICSPLINE"}]}],"#;
    let accessors = r#""SCALAR"},
{"bufferView":0,"byteOffset":8,"componentType":5126,"count":2,"type":"SCALAR"},
{"bufferView":0,"componentType":5126,"count":2,"type":"VEC3"},
{"bufferView":0,"componentType":5126,"count":2,"type":"VEC4"},
{"bufferView":0,"byteOffset":12,"componentType":5126,"count":1,"type":"SCALAR"}]}"#;
    let twice =
        r#""mesh":0,"extensions":{"EXT_mesh_gpu_instancing":{"attributes":{"TRANSLATION":3}}}"#;
    let text = gltf(TRIANGLE, ORANGE, animations).replace("\"SCALAR\"}]}", accessors);
    text.replacen("\"mesh\":0", twice, 1)
}

fn glb() -> Vec<u8> {
    let mut json = gltf("0", ORANGE, "").replace(",\"uri\":0", "").into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let mut binary: Vec<u8> = [0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]
        .iter()
        .flat_map(|v| v.to_le_bytes())
        .collect();
    binary.extend([0, 0, 1, 0, 2, 0, 0, 0]);
    let mut bytes = b"glTF\x02\0\0\0".to_vec();
    bytes.extend((28 + json.len() as u32 + binary.len() as u32).to_le_bytes());
    for (kind, chunk) in [(b"JSON", json), (b"BIN\0", binary)] {
        bytes.extend((chunk.len() as u32).to_le_bytes());
        bytes.extend(kind);
        bytes.extend(chunk);
    }
    bytes
}

const OBJ: &str = "# square and triangle\no a\nv 0 0 0\nv 1 0 0 0.5 0.5 0.5\nv 1 1 0\nv 0 1 0\n\
                   vt 0 0\nvt 1 1\nvn 0 0 1\nusemtl m\ns 1\nf 1/1/1 2/2/1 3/1/1 4/2/1\nf -4//1 -3//1 \\\n-2//1\n";

const MTL: &str = "newmtl m\nKd 1 0.8 0.3\nKs 0.5 0.5 0.5\nNs 200\nNi 1.5\nd 0.9\nillum 2\n\
                   Pr 0.2\nPm 1\nKe 0 0 0\nTf 1 1 1\nmap_Kd -s 2 2 1 missing.png\n";

const SHOT: &str = r#"[plate]
file = "plate.####.png"
frames = "1001-1048x2,-7"
exposure = { time_s = 0.0166, f_number = 8.0, iso = 100 }
[camera]
boards = "board_*.jpg"
board = { kind = "checkerboard", corners = [9, 6], square_mm = 25.0 }
[pose]
tag = { photo = "tag.jpg", family = "36h11", id = 7, size_mm = 120.0, at = [0.4, 0.0, 0.2], facing = [0, 1, 0], up = [0, 0, -1] }
[probe]
ball = { photos = "ball_b*.jpg", radius = 0.06, at = [0.0, 0.06, 0.0], reflectance = [0.63, 0.62, 0.60] }
clipped = "recover"
[[lamp]]
at = [0.7, 0.3, -0.2]
radius = 0.05
[support]
plane = { size = [3.0, 3.0] }
albedo = "plate"
[[object]]
file = "robot.glb"
at = [0.0, 0.0, 0.0]
rotate = [0.0, 30.0, 0.0]
[render]
samples = 64
"#;

const CAMERA: &str = r#"{"platelight_camera":1,"width":960,"height":640,"fx":940.3,"fy":940.1,"cx":483.2,"cy":321.0,"distortion":"brown-conrady","coefficients":[-0.1,0.02,0.001,-0.001,0.0],"world_from_camera":[[1,0,0,0],[0,1,0,1.5],[0,0,1,2]]}"#;

const YAML: &str = "%YAML:1.0\n---\nimage_width: 640\nimage_height: 480\ncamera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 532.8, 0., 342.5, 0., 532.9, 233.9, 0., 0., 1. ]\ndistortion_coefficients: !!opencv-matrix\n   rows: 5\n   cols: 1\n   dt: d\n   data: [ -0.28, 0.025, 0.0012, -0.0001, 0.163 ]\n";

const COLMAP: &str =
    "# Camera list\n1 OPENCV 960 640 940.3 940.1 483.7 321.5 -0.1 0.02 0.001 -0.001\n";
