//! Filtering of a panorama's texels: what is lost of a small light, against how often a texel looks.
//!
//! A sun three source pixels wide on black, in a mirror ball's photograph of 800 px radius and in a lat-long of twice the
//! width, at eight places; resampled to 1024 × 512 texels.

use std::error::Error;
use std::fmt::Write;
use std::time::Instant;

use glam::{DMat3, DQuat, DVec2, DVec3};
use platelight::bracket::{Radiance, Validity};
use platelight::conventions::{Rgb, lat_long_direction, lat_long_solid_angle};
use platelight::photo::Image;
use platelight::probe::mapping::{BallMap, LatLong, Mapping};
use platelight::probe::resample::to_lat_long;

use super::plot::{self, Line};

const WIDTH: usize = 1024;
const PLACES: usize = 8;
/// Looks along a texel's side.
const SIDES: [usize; 4] = [1, 2, 4, 8];

/// A way to resample a source and how it did.
pub struct Row {
    source: &'static str,
    filter: &'static str,
    /// Looks at the source along a texel's side; `None`: as many as are needed.
    side: Option<usize>,
    seconds: f64,
    /// Rms over the places of the relative error of the flux, and of its direction, degrees.
    flux: f64,
    direction_deg: f64,
}

struct Source {
    name: &'static str,
    mapping: Box<dyn Mapping>,
    size: (usize, usize),
}

pub fn measure() -> Vec<Row> {
    let lat_long = LatLong { width: 2 * WIDTH, height: WIDTH };
    let sources = [
        Source { name: "lat-long", mapping: Box::new(lat_long), size: (2 * WIDTH, WIDTH) },
        Source { name: "ball", mapping: Box::new(BallMap { size: 1600 }), size: (1600, 1600) },
    ];
    let mut rows = Vec::new();
    for source in &sources {
        let ways = [("nearest", false), ("bilinear", true)];
        let gathered_ways = ways
            .into_iter()
            .flat_map(|(filter, smooth)| SIDES.map(move |side| (filter, Some(side), smooth)));
        let ways: Vec<_> = gathered_ways.chain([("ours", None, true)]).collect();
        let mut of_source: Vec<Row> = ways
            .iter()
            .map(|&(filter, side, _)| Row {
                source: source.name,
                filter,
                side,
                seconds: 0.0,
                flux: 0.0,
                direction_deg: 0.0,
            })
            .collect();
        for place in 0..PLACES {
            let sun = sun(source, place);
            for (row, (_, side, smooth)) in of_source.iter_mut().zip(&ways) {
                let clock = Instant::now();
                let map = match side {
                    Some(side) => gathered(&sun.picture, &*source.mapping, *side, *smooth),
                    None => {
                        let mapping = &*source.mapping;
                        to_lat_long(&sun.picture, mapping, DMat3::IDENTITY, WIDTH).radiance
                    }
                };
                let seconds = clock.elapsed().as_secs_f64();
                let (flux, direction_deg) = sun.lost_in(&map);
                row.seconds += seconds / PLACES as f64;
                row.flux += flux * flux;
                row.direction_deg += direction_deg * direction_deg;
            }
        }
        for row in &mut of_source {
            row.flux = (row.flux / PLACES as f64).sqrt();
            row.direction_deg = (row.direction_deg / PLACES as f64).sqrt();
        }
        rows.extend(of_source);
    }
    rows
}

/// A picture of a sun on nearly black, and what all of it gives.
struct Sun {
    picture: Radiance,
    flux: f64,
    /// Flux times direction.
    moment: DVec3,
}

impl Sun {
    /// Relative error of a lat-long's flux, and of its direction, degrees.
    fn lost_in(&self, map: &Image<Rgb>) -> (f64, f64) {
        let (mut flux, mut moment) = (0.0, DVec3::ZERO);
        for y in 0..map.height() {
            let solid_angle = lat_long_solid_angle(y, map.width(), map.height());
            for x in 0..map.width() {
                let l = f64::from(map[(x, y)].y) * solid_angle;
                let at = DVec2::new(x as f64, y as f64);
                flux += l;
                moment += l * lat_long_direction(at, map.width(), map.height());
            }
        }
        (flux / self.flux - 1.0, moment.angle_between(self.moment).to_degrees())
    }
}

/// A sun three pixels wide.
fn sun(source: &Source, place: usize) -> Sun {
    let turn = DQuat::from_rotation_y(0.37 + 0.61 * place as f64)
        * DQuat::from_rotation_x(-1.1 + 0.13 * place as f64);
    let direction = turn * DVec3::Z;
    let (w, h) = source.size;
    let centre = source.mapping.pixel(direction).unwrap_or(DVec2::ZERO);
    let mut mean = Image::filled(w, h, Rgb::splat(1e-8));
    let (mut flux, mut moment) = (0.0, DVec3::ZERO);
    let near = |middle: f64, length: usize| {
        let first = (middle - 2.0).max(0.0) as usize;
        first..(first + 5).min(length)
    };
    for y in near(centre.y, h) {
        for x in near(centre.x, w) {
            let at = DVec2::new(x as f64, y as f64);
            if at.distance(centre) > 1.5 || !source.mapping.covers(x, y) {
                continue;
            }
            let (Some(omega), Some(seen)) =
                (source.mapping.solid_angle(at), source.mapping.direction(at))
            else {
                continue;
            };
            mean[(x, y)] = Rgb::splat(1e4);
            flux += 1e4 * omega;
            moment += 1e4 * omega * seen;
        }
    }
    let picture = Radiance {
        variance: Image::filled(w, h, Rgb::ZERO),
        validity: Image::filled(w, h, Validity::Measured),
        mean,
    };
    Sun { picture, flux, moment }
}

/// Every texel the mean of `side` × `side` looks at the source.
fn gathered(source: &Radiance, mapping: &dyn Mapping, side: usize, smooth: bool) -> Image<Rgb> {
    let height = WIDTH / 2;
    let mean = &source.mean;
    let at = |x: i64, y: i64| {
        let x = if mapping.wraps() { x.rem_euclid(mean.width() as i64) } else { x };
        let inside = |v: i64, n: usize| v.clamp(0, n as i64 - 1) as usize;
        mean[(inside(x, mean.width()), inside(y, mean.height()))]
    };
    let look = |pixel: DVec2| {
        let direction = lat_long_direction(pixel, WIDTH, height);
        let Some(p) = mapping.pixel(direction) else { return Rgb::ZERO };
        if !smooth {
            return at(p.x.round() as i64, p.y.round() as i64);
        }
        let (x, y) = (p.x.floor(), p.y.floor());
        let (u, v) = ((p.x - x) as f32, (p.y - y) as f32);
        let (x, y) = (x as i64, y as i64);
        at(x, y).lerp(at(x + 1, y), u).lerp(at(x, y + 1).lerp(at(x + 1, y + 1), u), v)
    };
    Image::from_fn(WIDTH, height, |x, y| {
        let sample = |k: usize| (k as f64 + 0.5) / side as f64 - 0.5;
        let looks = (0..side * side)
            .map(|k| look(DVec2::new(x as f64 + sample(k % side), y as f64 + sample(k / side))));
        looks.sum::<Rgb>() / (side * side) as f32
    })
}

pub fn csv(rows: &[Row]) -> String {
    let mut text =
        String::from("source,filter,samples,seconds,flux_error_rms,direction_error_deg\n");
    for row in rows {
        let samples = row.side.map_or("as needed".into(), |side| (side * side).to_string());
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "{},{},{samples},{:.3},{:.5},{:.5}",
            row.source, row.filter, row.seconds, row.flux, row.direction_deg
        );
    }
    text
}

/// Of the flux, or of its direction.
pub fn chart(rows: &[Row], of_direction: bool) -> Result<String, Box<dyn Error>> {
    let error = |row: &Row| if of_direction { row.direction_deg } else { row.flux };
    let mut lines: Vec<Line> = Vec::new();
    for of_line in rows.chunk_by(|a, b| (a.source, a.filter) == (b.source, b.filter)) {
        let samples = |side: usize| (side * side) as f64;
        let points = match of_line {
            // As a level over all.
            [row] => SIDES.map(|side| (samples(side), error(row))).to_vec(),
            rows => rows.iter().filter_map(|r| Some((samples(r.side?), error(r)))).collect(),
        };
        let (Some(first), Some(last)) = (of_line.first(), of_line.last()) else { continue };
        let seconds = match of_line {
            [row] => format!("{:.2} s", row.seconds),
            _ => format!("{:.2} … {:.2} s", first.seconds, last.seconds),
        };
        let name = format!("{}, {}: {seconds}", first.source, first.filter);
        lines.push(Line { name, points, ours: of_line.len() == 1 });
    }
    let title = format!("A sun of three pixels, resampled to {WIDTH} × {}", WIDTH / 2);
    let of = if of_direction { "its direction, rms degrees" } else { "its light, rms, relative" };
    plot::chart(&title, "looks at the source per texel", &format!("error of {of}"), &lines)
}
