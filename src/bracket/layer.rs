//! A photograph of a bracket as it enters the merge: its light where another frame has the same place.

use glam::DVec2;
use rayon::prelude::*;

use super::warp::Warp;
use crate::conventions::Rgb;
use crate::photo::{Decoder, Encoded, Format, Image, Measured, Run, Samples, ToneCurve};

/// Bits of a pixel's state: the channel clips; it or a neighbour that its file mixes into it does.
pub(super) const CLIPS: u8 = 0b111;
const NEAR_CLIPPED: u32 = 3;
/// The file holds no picture here.
pub(super) const NO_DATA: u8 = 0b100_0000;
/// All of [`NO_DATA`] and the channels near clipping.
pub(super) const SPOILED: u8 = NO_DATA | CLIPS << NEAR_CLIPPED;

/// Chroma subsampling and ringing carry a clipped pixel's colour this far in a JPEG, px.
const JPEG_BLEED_PX: usize = 2;
/// What near by is brighter than this, code 194 of sRGB, may be a clipped pixel itself that rings: a sun's
/// rim in a JPEG of quality 50 goes down to codes between that and 203. What is darker is only a little noisier
/// than elsewhere, and often the one frame in which a leaf before the sky is more than black.
const BESIDE_CLIPPED: f32 = 0.55;
/// Pictures that were moved before they were stored mix the border colour this far in, px.
const BORDER_BLEED_PX: usize = 2;

/// A photograph of a bracket and how it lies on the others.
pub(super) struct Layer<'a> {
    pub photo: &'a Encoded,
    decoder: Decoder<'a>,
    /// [`CLIPS`], the same near by, and [`NO_DATA`].
    state: Image<u8>,
    /// Cube root of the light of every green code; empty of floats.
    roots: Vec<f32>,
    /// Takes a pixel of the bracket's grid to this photograph.
    pub warp: Warp,
}

/// What a layer shows at a pixel of the bracket's grid.
#[derive(Clone, Copy)]
pub(super) struct Shown {
    pub measured: Measured,
    /// The bits above; all of [`SPOILED`] outside the photograph.
    pub state: u8,
}

impl Shown {
    const OUTSIDE: Self = Self {
        measured: Measured { light: Rgb::ZERO, rounding: Rgb::ZERO, trust: Rgb::ZERO },
        state: SPOILED,
    };

    /// Whether a channel holds a measurement. `apart`: whatever the other channels do.
    #[inline]
    pub fn usable(&self, channel: usize, apart: bool) -> bool {
        self.state & spoils(channel, apart) == 0
    }
}

/// The bits that make a channel no measurement. `apart`: whatever the other channels do.
fn spoils(channel: usize, apart: bool) -> u8 {
    let clipping = if apart { 1 << channel } else { CLIPS };
    NO_DATA | clipping << NEAR_CLIPPED
}

impl<'a> Layer<'a> {
    pub fn new(photo: &'a Encoded) -> Self {
        let decoder = photo.decoder();
        let state = state(photo, &decoder);
        let roots = decoder.greens().into_iter().map(f32::cbrt).collect();
        Self { photo, decoder, state, roots, warp: Warp::IDENTITY }
    }

    /// Reads the codes through recovered curves from now on.
    pub fn read_through(&mut self, curves: &[ToneCurve; 3]) {
        if let Some(decoder) = Decoder::through(self.photo, curves) {
            self.decoder = decoder;
        }
    }

    /// State of a pixel of the photograph itself, wherever it lies in the bracket's grid.
    pub fn state(&self, x: usize, y: usize) -> u8 {
        self.state[(x, y)]
    }

    /// States of all pixels of the photograph itself, row by row.
    pub fn states(&self) -> &[u8] {
        self.state.pixels()
    }

    /// Cube root of the green light of a pixel of the photograph itself: the channel with most light and
    /// least interpolation.
    pub fn own_root(&self, x: usize, y: usize) -> f32 {
        let i = y * self.photo.width + x;
        match self.decoder.green_code(i) {
            Some(code) => self.roots[code],
            None => self.decoder.light(i).y.max(0.0).cbrt(),
        }
    }

    /// Light of a pixel of the photograph itself, wherever it lies in the bracket's grid.
    pub fn own_light(&self, x: usize, y: usize) -> Rgb {
        self.decoder.light(y * self.photo.width + x)
    }

    /// What pixel (`x`, `y`) of the bracket's grid shows.
    #[inline]
    pub fn shown(&self, x: usize, y: usize) -> Shown {
        if self.warp.is_identity() {
            let i = y * self.photo.width + x;
            return Shown { measured: self.decoder.measured(i), state: self.state.pixels()[i] };
        }
        self.interpolated(self.warp.apply(DVec2::new(x as f64, y as f64)))
    }

    /// What so many pixels of the bracket's grid show, from (`x`, `y`) to the right, as many as a run holds at
    /// most; no trust in what is no measurement. `apart`: a channel counts whatever the others do.
    pub fn read(&self, (x, y): (usize, usize), pixels: usize, apart: bool, runs: &mut [Run; 3]) {
        if !self.warp.is_identity() {
            for i in 0..pixels {
                let shown = self.shown(x + i, y);
                let Measured { light, rounding, trust } = shown.measured;
                for (c, run) in runs.iter_mut().enumerate() {
                    let trust = if shown.usable(c, apart) { trust[c] } else { 0.0 };
                    (run.light[i], run.rounding[i], run.trust[i]) = (light[c], rounding[c], trust);
                }
            }
            return;
        }
        let first = y * self.photo.width + x;
        self.decoder.measure(first, pixels, runs);
        let state = &self.state.pixels()[first..first + pixels];
        for (c, run) in runs.iter_mut().enumerate() {
            let spoils = spoils(c, apart);
            for (trust, state) in run.trust.iter_mut().zip(state) {
                *trust = if state & spoils == 0 { *trust } else { 0.0 };
            }
        }
    }

    /// Light at a pixel of the bracket's grid, if no channel of it is spoiled.
    pub fn usable(&self, x: usize, y: usize) -> Option<Rgb> {
        if self.warp.is_identity() {
            return (self.state(x, y) & SPOILED == 0).then(|| self.own_light(x, y));
        }
        let shown = self.shown(x, y);
        (shown.state & SPOILED == 0).then_some(shown.measured.light)
    }

    /// Between pixels of the photograph, by Catmull and Rom's cubic; spoiled where a pixel that it mixes is.
    fn interpolated(&self, at: DVec2) -> Shown {
        let (x0, y0) = (at.x.floor(), at.y.floor());
        let (w, h) = (self.photo.width, self.photo.height);
        if !(x0 >= 1.0 && y0 >= 1.0 && x0 + 2.0 < w as f64 && y0 + 2.0 < h as f64) {
            return Shown::OUTSIDE;
        }
        let (wx, wy) = (catmull_rom(at.x - x0), catmull_rom(at.y - y0));
        let (x0, y0) = (x0 as usize, y0 as usize);
        let mut light = Rgb::ZERO;
        let mut state = 0;
        for (j, wy) in wy.into_iter().enumerate() {
            for (i, wx) in wx.into_iter().enumerate() {
                let index = (y0 + j - 1) * w + x0 + i - 1;
                light += self.decoder.light(index) * (wx * wy);
                state |= self.state.pixels()[index];
            }
        }
        let nearest = at.round();
        let nearest = nearest.y as usize * w + nearest.x as usize;
        // Whether the place itself clips is its nearest pixel's matter.
        state = state & !CLIPS | self.state.pixels()[nearest] & CLIPS;
        let measured = Measured { light: light.max(Rgb::ZERO), ..self.decoder.measured(nearest) };
        Shown { measured, state }
    }
}

/// The four Catmull–Rom weights for a fraction 0…1 between the two middle taps.
pub(super) fn catmull_rom(t: f64) -> [f32; 4] {
    [
        -0.5 * t + t * t - 0.5 * t * t * t,
        1.0 - 2.5 * t * t + 1.5 * t * t * t,
        0.5 * t + 2.0 * t * t - 1.5 * t * t * t,
        -0.5 * t * t + 0.5 * t * t * t,
    ]
    .map(|w| w as f32)
}

/// The state of every pixel of a photograph.
fn state(photo: &Encoded, decoder: &Decoder) -> Image<u8> {
    let (w, h) = (photo.width, photo.height);
    let mut own = Image::filled(w, h, 0u8);
    let rows = own.pixels_mut().par_chunks_exact_mut(w).enumerate();
    rows.for_each(|(y, row)| decoder.clip_bits(y * w, row));
    let bleeds = photo.format == Format::Jpeg;
    let is_bright = |i: usize| decoder.light(i).max_element() > BESIDE_CLIPPED;
    let mut state = spread(&own, if bleeds { JPEG_BLEED_PX } else { 0 });
    let rows = state.pixels_mut().par_chunks_exact_mut(w).enumerate();
    rows.for_each(|(y, row)| {
        for (x, (state, own)) in row.iter_mut().zip(own.row(y)).enumerate() {
            let near = *state;
            *state = *own;
            if *own != 0 || near != 0 && is_bright(y * w + x) {
                *state |= near << NEAR_CLIPPED;
            }
        }
    });
    if let Some(missing) = no_data(photo, decoder) {
        let missing = spread(&missing, BORDER_BLEED_PX);
        for (state, missing) in state.pixels_mut().iter_mut().zip(missing.pixels()) {
            *state |= missing;
        }
    }
    state
}

/// Every pixel takes the bits of all pixels within `reach` along both axes.
fn spread(bits: &Image<u8>, reach: usize) -> Image<u8> {
    let (w, h) = (bits.width(), bits.height());
    let any = |y: usize| bits.row(y).iter().fold(0, |any, bits| any | bits) != 0;
    let any: Vec<bool> = (0..h).into_par_iter().map(any).collect();
    let mut wide = Image::filled(w, h, 0u8);
    wide.pixels_mut().par_chunks_exact_mut(w).enumerate().for_each_init(
        || vec![0u8; w],
        |column, (y, row)| {
            let rows = y.saturating_sub(reach)..(y + reach + 1).min(h);
            if !rows.clone().any(|y| any[y]) {
                return;
            }
            column.fill(0);
            for y in rows {
                column.iter_mut().zip(bits.row(y)).for_each(|(to, from)| *to |= from);
            }
            row.copy_from_slice(column);
            for shift in 1..=reach.min(w - 1) {
                row[shift..].iter_mut().zip(&*column).for_each(|(to, from)| *to |= from);
                row.iter_mut().zip(&column[shift..]).for_each(|(to, from)| *to |= from);
            }
        },
    );
    wide
}

/// [`NO_DATA`] where a file holds no picture: where its alpha is 0, and where a pure colour, black and
/// white apart, fills the frame from its border on, as blue does round Debevec's aligned church.
fn no_data(photo: &Encoded, decoder: &Decoder) -> Option<Image<u8>> {
    let (w, h) = (photo.width, photo.height);
    let mut mask = Image::filled(w, h, 0u8);
    if photo.samples.channels().is_multiple_of(2) {
        mask.pixels_mut().par_iter_mut().enumerate().for_each(|(i, mask)| {
            *mask = if decoder.coverage(i) == Some(0.0) { NO_DATA } else { 0 };
        });
    }
    let any = |mask: Image<u8>| mask.pixels().iter().any(|&m| m != 0).then_some(mask);
    let Samples::U8 { channels: channels @ 3.., data } = &photo.samples else { return any(mask) };
    let channels = *channels;
    let pixel = |i: usize| &data[i * channels..(i + 1) * channels];
    let is_pure = |colour: &[u8]| {
        let extreme = colour[..3].iter().all(|&c| c == 0 || c == 255);
        extreme && colour[..3].iter().any(|&c| c != colour[0])
    };
    let border = (0..w).flat_map(|x| [x, (h - 1) * w + x]);
    let border = border.chain((0..h).flat_map(|y| [y * w, y * w + w - 1]));
    let mut open: Vec<usize> = border.filter(|&i| is_pure(pixel(i))).collect();
    while let Some(i) = open.pop() {
        if mask.pixels()[i] != 0 {
            continue;
        }
        mask.pixels_mut()[i] = NO_DATA;
        let (x, y) = (i % w, i / w);
        let beside = [
            (x > 0).then(|| i - 1),
            (x + 1 < w).then(|| i + 1),
            (y > 0).then(|| i - w),
            (y + 1 < h).then(|| i + w),
        ];
        open.extend(beside.into_iter().flatten().filter(|&j| pixel(j)[..3] == pixel(i)[..3]));
    }
    any(mask)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::photo::Photo;

    /// An 8-bit picture of one grey, its codes linear, with some pixels of their own colour.
    fn picture(w: usize, h: usize, format: Format, colours: &[(usize, usize, [u8; 3])]) -> Encoded {
        picture_of(w, h, format, 100, colours)
    }

    fn picture_of(
        w: usize,
        h: usize,
        format: Format,
        grey: u8,
        colours: &[(usize, usize, [u8; 3])],
    ) -> Encoded {
        let mut data = vec![grey; w * h * 3];
        for &(x, y, colour) in colours {
            data[(y * w + x) * 3..][..3].copy_from_slice(&colour);
        }
        let mut photo = Photo::from_linear(Image::filled(w, h, Rgb::ZERO)).encoded();
        photo.samples = Samples::U8 { channels: 3, data };
        photo.format = format;
        photo
    }

    #[test]
    fn a_clipped_pixel_spoils_bright_surroundings_in_a_jpeg_alone() {
        for (format, grey, reach) in
            [(Format::Jpeg, 150, 2), (Format::Jpeg, 130, 0), (Format::Png, 150, 0)]
        {
            let photo = picture_of(9, 9, format, grey, &[(4, 4, [255, 10, 10])]);
            let layer = Layer::new(&photo);
            for y in 0..9usize {
                for x in 0..9usize {
                    let near = x.abs_diff(4).max(y.abs_diff(4)) <= reach;
                    assert_eq!(layer.usable(x, y).is_none(), near, "{format:?} {grey} ({x}, {y})");
                    let shown = layer.shown(x, y);
                    assert_eq!(shown.usable(0, true), !near);
                    assert!(shown.usable(1, true), "green is not clipped");
                    assert_eq!(shown.state & CLIPS != 0, (x, y) == (4, 4));
                }
            }
        }
    }

    #[test]
    fn a_pure_colour_is_no_picture_where_it_reaches_the_border() {
        let blue = [0, 0, 255];
        let frame = (0..12).map(|y| (0, y, blue));
        let colours: Vec<_> = frame.chain([(7, 6, blue)]).collect();
        let photo = picture(12, 12, Format::Png, &colours);
        let layer = Layer::new(&photo);
        for y in 0..12 {
            for x in 0..12 {
                let missing = layer.shown(x, y).state & NO_DATA != 0;
                assert_eq!(missing, x <= BORDER_BLEED_PX, "({x}, {y})");
            }
        }
        // A blue light in the middle is clipped, not missing; white and black borders are pictures.
        assert!(layer.usable(7, 6).is_none());
        for colour in [[255; 3], [0; 3]] {
            let border: Vec<_> = (0..12).map(|y| (0, y, colour)).collect();
            let photo = picture(12, 12, Format::Png, &border);
            assert_eq!(Layer::new(&photo).shown(0, 5).state & NO_DATA, 0);
        }
    }

    #[test]
    fn a_warped_layer_shows_the_other_place() {
        let light = Image::from_fn(20, 16, |x, y| Rgb::new(x as f32, y as f32, 1.0));
        let photo = Photo::from_linear(light).encoded();
        let mut layer = Layer::new(&photo);
        layer.warp = Warp::shift(DVec2::new(2.25, -0.5));
        let shown = layer.shown(8, 8);
        assert!((shown.measured.light - Rgb::new(10.25, 7.5, 1.0)).length() < 1e-5);
        assert!(layer.usable(8, 8).is_some());
        assert!(layer.usable(17, 8).is_none(), "beyond the frame nothing is known");
    }
}
