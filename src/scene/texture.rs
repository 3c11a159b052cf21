//! [`Texture`]: pictures on surfaces; decoding with limits, bilinear look-up.
//!
//! Not through [`photo::read`](crate::photo::read): glTF forbids colour profiles and orientation
//! tags to act on textures, half of them hold numbers and no colours, and bytes are kept as bytes.

use std::io::Cursor;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, LazyLock};

use glam::{Vec2, Vec4};
use image::{DynamicImage, ImageDecoder, ImageReader, Limits};

use crate::photo::Image;
use crate::photo::colour::srgb_decode;

/// Widest and highest texture read.
pub(super) const MAX_SIDE: u32 = 16_384;

/// Memory a decoder may ask for, bytes: 16 384² texels of RGBA8.
const MAX_BYTES: u64 = 1 << 30;

/// A picture on a surface. (0, 0) is the corner of the top-left texel, (1, 1) that of the last.
#[derive(Clone, Debug)]
pub struct Texture {
    /// Shared: the same file may be placed many times, a picture be wrapped in several ways.
    texels: Arc<Texels>,
    /// Along u and v.
    pub wrap: [Wrap; 2],
}

/// What happens to texture coordinates outside 0…1 (glTF sampler).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Wrap {
    Repeat,
    MirroredRepeat,
    ClampToEdge,
}

/// How the stored numbers stand for the values wanted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum TexelMeaning {
    /// RGB through the sRGB curve, alpha linear.
    Colour,
    /// Plain numbers 0…1.
    Numbers,
}

#[derive(Clone, Debug)]
enum Texels {
    /// Four bytes a texel, decoded when looked up: a quarter of the memory.
    Bytes { texels: Image<[u8; 4]>, meaning: TexelMeaning },
    /// Linear values.
    Floats(Image<Vec4>),
}

impl Texture {
    /// A texture of linear values. `None` if it has no texels.
    pub fn from_linear(texels: Image<Vec4>, wrap: [Wrap; 2]) -> Option<Self> {
        let some = texels.width() > 0 && texels.height() > 0;
        some.then_some(Self { texels: Arc::new(Texels::Floats(texels)), wrap })
    }

    /// Decodes a PNG, JPEG or TIFF. The error says what is wrong, not where.
    ///
    /// 8-bit pictures stay bytes; others become floats. Orientation tags are ignored, as glTF asks.
    pub(super) fn decode(
        bytes: &[u8],
        meaning: TexelMeaning,
        wrap: [Wrap; 2],
    ) -> Result<Self, String> {
        // zune-jpeg is known to panic on some malformed files (zune-image issue 442).
        let picture = catch_unwind(AssertUnwindSafe(|| decode_limited(bytes)))
            .unwrap_or_else(|_| Err("the picture is damaged".into()))?;
        let (width, height) = (picture.width() as usize, picture.height() as usize);
        if width == 0 || height == 0 {
            return Err("the picture has no texels".into());
        }
        let is_8_bit = matches!(
            picture,
            DynamicImage::ImageLuma8(_)
                | DynamicImage::ImageLumaA8(_)
                | DynamicImage::ImageRgb8(_)
                | DynamicImage::ImageRgba8(_)
        );
        let texels = if is_8_bit {
            let bytes = picture.into_rgba8().into_raw();
            let texels = bytes.as_chunks::<4>().0.to_vec();
            Image::from_pixels(width, height, texels).map(|t| Texels::Bytes { texels: t, meaning })
        } else {
            // 16-bit integers carry the curve as bytes do; floating-point TIFFs are linear.
            let is_float =
                matches!(picture, DynamicImage::ImageRgb32F(_) | DynamicImage::ImageRgba32F(_));
            let curved = meaning == TexelMeaning::Colour && !is_float;
            let decode = |x: f32| if curved { srgb_decode(x) } else { x };
            let values = picture.into_rgba32f().into_raw();
            let texel = |t: &[f32; 4]| Vec4::new(decode(t[0]), decode(t[1]), decode(t[2]), t[3]);
            let texels: Vec<Vec4> = values.as_chunks::<4>().0.iter().map(texel).collect();
            if texels.iter().any(|t| !t.is_finite()) {
                return Err("the picture holds values that are not finite".into());
            }
            Image::from_pixels(width, height, texels).map(Texels::Floats)
        };
        let texels = texels.ok_or("the picture's size does not fit its data")?;
        Ok(Self { texels: Arc::new(texels), wrap })
    }

    /// Memory its texels take.
    pub(super) fn n_bytes(&self) -> usize {
        let size = match &*self.texels {
            Texels::Bytes { .. } => std::mem::size_of::<[u8; 4]>(),
            Texels::Floats(_) => std::mem::size_of::<Vec4>(),
        };
        self.width() * self.height() * size
    }

    pub fn width(&self) -> usize {
        match &*self.texels {
            Texels::Bytes { texels, .. } => texels.width(),
            Texels::Floats(texels) => texels.width(),
        }
    }

    pub fn height(&self) -> usize {
        match &*self.texels {
            Texels::Bytes { texels, .. } => texels.height(),
            Texels::Floats(texels) => texels.height(),
        }
    }

    /// The linear value at a texture coordinate, bilinear between texel centres, wrapped.
    pub fn sample(&self, uv: Vec2) -> Vec4 {
        if !uv.is_finite() {
            return self.texel(0, 0);
        }
        let (width, height) = (self.width(), self.height());
        let (x0, x1, fx) = neighbours(uv.x, width, self.wrap[0]);
        let (y0, y1, fy) = neighbours(uv.y, height, self.wrap[1]);
        let top = self.texel(x0, y0).lerp(self.texel(x1, y0), fx);
        let bottom = self.texel(x0, y1).lerp(self.texel(x1, y1), fx);
        top.lerp(bottom, fy)
    }

    fn texel(&self, x: usize, y: usize) -> Vec4 {
        match &*self.texels {
            Texels::Floats(texels) => texels[(x, y)],
            Texels::Bytes { texels, meaning } => {
                let [r, g, b, a] = texels[(x, y)];
                let plain = |byte: u8| f32::from(byte) / 255.0;
                let colour = |byte: u8| match meaning {
                    TexelMeaning::Colour => SRGB_TABLE[usize::from(byte)],
                    TexelMeaning::Numbers => plain(byte),
                };
                Vec4::new(colour(r), colour(g), colour(b), plain(a))
            }
        }
    }
}

/// Linear light of every sRGB byte.
static SRGB_TABLE: LazyLock<[f32; 256]> =
    LazyLock::new(|| std::array::from_fn(|i| srgb_decode(i as f32 / 255.0)));

/// The two texels between whose centres a coordinate lies, and the weight of the second.
fn neighbours(u: f32, n: usize, wrap: Wrap) -> (usize, usize, f32) {
    // f64: at u = 1000.5 on 4096 texels f32 knows the texel to a quarter only.
    let position = f64::from(u) * n as f64 - 0.5;
    let floor = position.floor();
    let fraction = (position - floor) as f32;
    (wrapped(floor, n, wrap), wrapped(floor + 1.0, n, wrap), fraction)
}

fn wrapped(index: f64, n: usize, wrap: Wrap) -> usize {
    let size = n as f64;
    let inside = match wrap {
        Wrap::Repeat => index.rem_euclid(size),
        Wrap::ClampToEdge => index,
        Wrap::MirroredRepeat => {
            let there_and_back = index.rem_euclid(2.0 * size);
            if there_and_back < size { there_and_back } else { 2.0 * size - 1.0 - there_and_back }
        }
    };
    (inside.max(0.0) as usize).min(n - 1)
}

fn decode_limited(bytes: &[u8]) -> Result<DynamicImage, String> {
    let mut reader =
        ImageReader::new(Cursor::new(bytes)).with_guessed_format().map_err(|e| e.to_string())?;
    let format = reader.format();
    let readable = [image::ImageFormat::Png, image::ImageFormat::Jpeg, image::ImageFormat::Tiff];
    if !format.is_some_and(|f| readable.contains(&f)) {
        return Err("the picture is neither PNG nor JPEG nor TIFF".into());
    }
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_SIDE);
    limits.max_image_height = Some(MAX_SIDE);
    limits.max_alloc = Some(MAX_BYTES);
    reader.limits(limits);
    let decoder = reader.into_decoder().map_err(|e| e.to_string())?;
    let (width, height) = decoder.dimensions();
    if decoder.total_bytes() > MAX_BYTES {
        return Err(format!("{width} × {height} texels are more than this program reads"));
    }
    DynamicImage::from_decoder(decoder).map_err(|e| e.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp(wrap: Wrap) -> Texture {
        let texels = Image::from_fn(4, 1, |x, _| Vec4::splat(x as f32));
        Texture::from_linear(texels, [wrap; 2]).unwrap()
    }

    fn at(texture: &Texture, u: f32) -> f32 {
        texture.sample(Vec2::new(u, 0.5)).x
    }

    #[test]
    fn texel_centres_give_their_own_value_and_halfway_the_mean() {
        for wrap in [Wrap::Repeat, Wrap::MirroredRepeat, Wrap::ClampToEdge] {
            let texture = ramp(wrap);
            assert_eq!(at(&texture, 0.125), 0.0);
            assert_eq!(at(&texture, 0.625), 2.0);
            assert_eq!(at(&texture, 0.5), 1.5);
        }
    }

    #[test]
    fn each_wrap_continues_beyond_the_border_in_its_way() {
        assert_eq!(at(&ramp(Wrap::Repeat), 1.125), 0.0);
        assert_eq!(at(&ramp(Wrap::Repeat), 0.0), 1.5);
        assert_eq!(at(&ramp(Wrap::Repeat), -0.125), 3.0);
        assert_eq!(at(&ramp(Wrap::MirroredRepeat), 1.125), 3.0);
        assert_eq!(at(&ramp(Wrap::MirroredRepeat), -0.375), 1.0);
        assert_eq!(at(&ramp(Wrap::ClampToEdge), 7.0), 3.0);
        assert_eq!(at(&ramp(Wrap::ClampToEdge), -7.0), 0.0);
        assert_eq!(at(&ramp(Wrap::Repeat), f32::NAN), 0.0);
        assert!(at(&ramp(Wrap::Repeat), 1e30).is_finite());
    }

    fn png(width: u32, height: u32, colour: [u8; 4]) -> Vec<u8> {
        let picture = image::RgbaImage::from_pixel(width, height, image::Rgba(colour));
        let mut bytes = Vec::new();
        picture.write_to(&mut Cursor::new(&mut bytes), image::ImageFormat::Png).unwrap();
        bytes
    }

    #[test]
    fn colours_are_decoded_by_the_srgb_curve_and_numbers_are_not() {
        let bytes = png(2, 2, [188, 0, 255, 128]);
        let wrap = [Wrap::Repeat; 2];
        let colour = Texture::decode(&bytes, TexelMeaning::Colour, wrap).unwrap();
        let numbers = Texture::decode(&bytes, TexelMeaning::Numbers, wrap).unwrap();
        let c = colour.sample(Vec2::splat(0.3));
        assert!((c - Vec4::new(0.502_886_5, 0.0, 1.0, 128.0 / 255.0)).length() < 1e-5, "{c}");
        assert_eq!(numbers.sample(Vec2::splat(0.3)).x, 188.0 / 255.0);
    }

    #[test]
    fn cut_or_foreign_bytes_are_an_error() {
        let bytes = png(64, 64, [1, 2, 3, 4]);
        for length in [0, 7, 20, 40, bytes.len() / 2] {
            let cut = &bytes[..length];
            assert!(Texture::decode(cut, TexelMeaning::Colour, [Wrap::Repeat; 2]).is_err());
        }
    }

    #[test]
    fn a_header_that_claims_a_giant_picture_is_refused_before_memory_is_asked_for() {
        let mut bytes = png(1, 1, [0; 4]);
        bytes[16..20].copy_from_slice(&60_000_u32.to_be_bytes());
        bytes[20..24].copy_from_slice(&60_000_u32.to_be_bytes());
        assert!(Texture::decode(&bytes, TexelMeaning::Colour, [Wrap::Repeat; 2]).is_err());
    }
}
