//! The photographs of the shot: where the camera stands, how it is set, and what each shows.

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use crate::lens::{Lens, View};
use crate::mesh::Ray;
use crate::objects::objects;
use crate::place::{BALL_RADIUS_M, Place};
use crate::sensor::{Exposure, PLATE};
use crate::targets::{Print, Sheet, TAG_M};
use crate::tracer::{Rendered, irradiance, render};

/// Size of the camera's frame, pixels.
pub const FRAME: (usize, usize) = (1080, 720);

/// The bracket of the ball: f/22, seven or eight thirds of a stop apart, darkest first.
pub const BRACKET: [Exposure; 6] = [
    Exposure { time: (1, 8000), f_number: 22.0, iso: 100 },
    Exposure { time: (1, 1250), f_number: 22.0, iso: 100 },
    Exposure { time: (1, 200), f_number: 22.0, iso: 100 },
    Exposure { time: (1, 30), f_number: 22.0, iso: 100 },
    Exposure { time: (1, 5), f_number: 22.0, iso: 100 },
    Exposure { time: (1, 1), f_number: 22.0, iso: 100 },
];

/// The ball is read out at this multiple of the frame, in a square of so many pixels.
pub const BALL_SCALE: usize = 3;
pub const BALL_CROP: usize = 600;

/// Paper lies this far above the table, metres.
const PAPER_M: f64 = 0.001;

/// How much work goes into the pictures.
#[derive(Clone, Copy)]
pub struct Effort {
    /// Pixels are this many times as large.
    pub coarser: usize,
    /// Paths in a pixel of the plate and of the truth; the other pictures follow.
    pub samples: u32,
}

/// The camera's lens, for the full frame.
pub fn lens() -> Lens {
    Lens {
        focal: DVec2::new(1180.0, 1180.0),
        centre: DVec2::new(545.3, 352.6),
        k: [-0.112, 0.058, 0.0],
        p: [4e-4, -3e-4],
    }
}

fn look(position: [f64; 3], target: [f64; 3], roll_rad: f64) -> View {
    View::look_at(lens(), FRAME.0, FRAME.1, position.into(), target.into(), roll_rad)
}

/// Where the plate is taken from.
pub fn plate_view() -> View {
    look([0.13, 0.41, 0.95], [0.015, 0.118, -0.05], 0.004)
}

/// Where the ball is photographed from: nearer, and a step to the left.
pub fn ball_view() -> View {
    look([-0.22, 0.44, 0.74], [0.02, 0.03, 0.0], -0.012)
}

/// The cut-out of the ball's photographs: its corner, in pixels of the enlarged frame.
pub fn ball_corner() -> (usize, usize) {
    let centre = ball_view().project(DVec3::Y * BALL_RADIUS_M);
    let corner = (centre + 0.5) * BALL_SCALE as f64 - BALL_CROP as f64 / 2.0;
    (corner.x.round() as usize, corner.y.round() as usize)
}

/// The tag, lying where the objects will stand.
pub fn tag_sheet() -> Sheet {
    lying(Print::Tag, DVec3::new(0.0, PAPER_M, 0.03), 0.14)
}

/// The board, lying on the table for the pose of the ball's camera.
pub fn lying_board() -> Sheet {
    lying(Print::Checkerboard, DVec3::new(0.01, PAPER_M, 0.02), -0.30)
}

/// A sheet on the table whose upward direction is −Z turned by `turn_rad` towards +X.
fn lying(print: Print, centre: DVec3, turn_rad: f64) -> Sheet {
    let (sin, cos) = turn_rad.sin_cos();
    Sheet { print, centre, right: DVec3::new(cos, 0.0, sin), up: DVec3::new(sin, 0.0, -cos) }
}

/// Corners of the tag's black border in the world: top left, top right, bottom right, bottom left.
pub fn tag_corners() -> [DVec3; 4] {
    let sheet = tag_sheet();
    [(-1.0, 1.0), (1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)]
        .map(|(x, y)| sheet.centre + (sheet.right * x + sheet.up * y) * (TAG_M / 2.0))
}

impl Effort {
    pub fn plate(self) -> Rendered {
        self.picture(&Place::terrace(), &plate_view(), self.samples, 1)
    }

    /// The same paths as [`Effort::plate`], with the objects in the place.
    pub fn truth(self) -> Rendered {
        let mut place = Place::terrace();
        for object in objects() {
            place.add_object(object.in_world(), object.finish);
        }
        self.picture(&place, &plate_view(), self.samples, 1)
    }

    pub fn tag(self) -> Rendered {
        let mut place = Place::terrace();
        place.add_sheet(tag_sheet());
        self.picture(&place, &plate_view(), self.fewer(4), 2)
    }

    pub fn ball_pose(self) -> Rendered {
        let mut place = Place::terrace();
        place.add_sheet(lying_board());
        self.picture(&place, &ball_view(), self.fewer(4), 3)
    }

    pub fn ball(self) -> Rendered {
        let mut place = Place::terrace();
        place.add_ball();
        let (x, y) = ball_corner();
        let view = ball_view().cropped(x, y, BALL_SCALE, BALL_CROP);
        self.picture(&place, &view, self.fewer(2), 4)
    }

    /// Board photograph `index`, and how it is exposed.
    pub fn board(self, index: usize) -> (Rendered, Exposure) {
        let place = Place::terrace();
        let hold = &HOLDS[index];
        let camera = look(hold.camera, [0.1 * hold.tilt[1], 0.02, -0.2], 0.01 * hold.tilt[2]);
        let sheet = hold.sheet(&camera);
        let corner_light = corner_irradiance(&place, &sheet, 16 * self.samples, index as u32);
        let background =
            blurred(render(&place, &camera.reduced(8), self.fewer(4), 50 + index as u32));
        let brightest = corner_light.iter().map(|e| e.max_element()).fold(0.0, f64::max);
        let picture = print_over(&camera.reduced(self.coarser), &sheet, corner_light, &background);
        (picture, exposure_for(brightest))
    }

    fn picture(self, place: &Place, view: &View, samples: u32, seed: u32) -> Rendered {
        render(place, &view.reduced(self.coarser), samples, seed)
    }

    fn fewer(self, times: u32) -> u32 {
        (self.samples / times).max(1)
    }
}

/// How the board is held for one photograph.
struct Hold {
    camera: [f64; 3],
    /// Where its centre is seen, pixels, and how far away it is, metres.
    at_px: [f64; 2],
    distance_m: f64,
    /// Turns about the picture's x, y and viewing axes, radians.
    tilt: [f64; 3],
}

/// Tilted both ways, near and far, and into every corner: what a calibration needs.
const HOLDS: [Hold; N_BOARDS] = [
    hold([0.10, 0.45, 1.05], [540.0, 360.0], 0.47, [0.05, -0.10, 0.02]),
    hold([0.10, 0.45, 1.05], [350.0, 270.0], 0.62, [0.55, 0.10, 0.05]),
    hold([0.05, 0.42, 1.00], [740.0, 260.0], 0.62, [-0.50, 0.15, -0.08]),
    hold([0.05, 0.42, 1.00], [330.0, 470.0], 0.60, [0.15, 0.60, 0.10]),
    hold([0.15, 0.40, 1.00], [750.0, 460.0], 0.60, [0.10, -0.60, -0.06]),
    hold([0.15, 0.40, 1.00], [540.0, 350.0], 0.55, [0.62, 0.35, 0.30]),
    hold([0.00, 0.48, 1.10], [545.0, 365.0], 0.55, [-0.58, -0.38, -0.25]),
    hold([0.00, 0.48, 1.10], [225.0, 190.0], 0.80, [0.30, -0.35, 0.15]),
    hold([0.20, 0.44, 1.02], [855.0, 190.0], 0.80, [0.35, 0.40, -0.12]),
    hold([0.20, 0.44, 1.02], [290.0, 500.0], 0.66, [-0.35, -0.30, -0.20]),
    hold([0.12, 0.46, 1.08], [790.0, 500.0], 0.66, [-0.30, 0.45, 0.18]),
    hold([0.12, 0.46, 1.08], [545.0, 355.0], 0.68, [-0.45, 0.05, 1.57]),
    hold([0.08, 0.43, 0.98], [400.0, 370.0], 0.60, [0.10, 0.72, -0.40]),
    hold([0.08, 0.43, 0.98], [690.0, 360.0], 0.60, [-0.12, -0.70, 0.35]),
];

/// Number of board photographs.
pub const N_BOARDS: usize = 14;

const fn hold(camera: [f64; 3], at_px: [f64; 2], distance_m: f64, tilt: [f64; 3]) -> Hold {
    Hold { camera, at_px, distance_m, tilt }
}

impl Hold {
    fn sheet(&self, view: &View) -> Sheet {
        let centre = view.position + self.distance_m * view.direction(self.at_px.into());
        let [x, y, roll] = self.tilt;
        let turn = glam::DQuat::from_axis_angle(view.forward, roll)
            * glam::DQuat::from_axis_angle(view.up, y)
            * glam::DQuat::from_axis_angle(view.right, x);
        let (right, up) = (turn * view.right, turn * view.up);
        Sheet { print: Print::Checkerboard, centre, right, up }
    }
}

/// Irradiance at the sheet's four corners: (left, top), (right, top), (left, bottom), (right, bottom).
fn corner_irradiance(place: &Place, sheet: &Sheet, samples: u32, seed: u32) -> [DVec3; 4] {
    let half = sheet.half_size();
    [(-1.0, 1.0), (1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)].map(|(x, y)| {
        let point = sheet.centre + sheet.right * (x * half.x) + sheet.up * (y * half.y);
        irradiance(place, point, sheet.facing(), samples, 900 + seed)
    })
}

/// Shutter that brings paper of this irradiance to about 0.7, in nominal thirds of a stop.
fn exposure_for(irradiance: f64) -> Exposure {
    const SHUTTERS: [u32; 20] =
        [4, 5, 6, 8, 10, 13, 15, 20, 25, 30, 40, 50, 60, 80, 100, 125, 160, 200, 250, 320];
    let value = |denominator| {
        let exposure = Exposure { time: (1, denominator), ..PLATE };
        0.85 / std::f64::consts::PI * irradiance * exposure.scale()
    };
    let denominator = SHUTTERS.into_iter().find(|d| value(*d) < 0.75).unwrap_or(320);
    Exposure { time: (1, denominator), ..PLATE }
}

/// The print, evaluated exactly at 36 points of each pixel, before an out-of-focus background.
fn print_over(
    view: &View,
    sheet: &Sheet,
    corner_light: [DVec3; 4],
    background: &Rendered,
) -> Rendered {
    const GRID: u32 = 6;
    let half = sheet.half_size();
    let mut light = vec![DVec3::ZERO; view.width * view.height];
    light.par_chunks_mut(view.width).enumerate().for_each(|(y, row)| {
        for (x, pixel) in row.iter_mut().enumerate() {
            let behind = bilinear(background, view, x, y);
            for k in 0..GRID * GRID {
                let cell = DVec2::new(f64::from(k % GRID), f64::from(k / GRID));
                let at = DVec2::new(x as f64, y as f64) + (cell + 0.5) / f64::from(GRID) - 0.5;
                let ray = Ray { origin: view.position, direction: view.direction(at) };
                let distance = sheet.facing().dot(sheet.centre - ray.origin)
                    / sheet.facing().dot(ray.direction);
                let on_sheet = sheet.on_sheet(ray.origin + ray.direction * distance);
                *pixel += if sheet.contains(on_sheet) {
                    let t = (on_sheet / half + 1.0) / 2.0;
                    let top = corner_light[0].lerp(corner_light[1], t.x);
                    let bottom = corner_light[2].lerp(corner_light[3], t.x);
                    let reflectance = sheet.print.reflectance(on_sheet);
                    top.lerp(bottom, t.y) * (reflectance / std::f64::consts::PI)
                } else {
                    behind
                };
            }
            *pixel /= f64::from(GRID * GRID);
        }
    });
    let coverage = vec![0.0; light.len()];
    Rendered { width: view.width, height: view.height, light, coverage }
}

/// The background at pixel (x, y) of `view`, whatever the sizes of both.
fn bilinear(picture: &Rendered, view: &View, x: usize, y: usize) -> DVec3 {
    let scale = DVec2::new(
        picture.width as f64 / view.width as f64,
        picture.height as f64 / view.height as f64,
    );
    let last = DVec2::new(picture.width as f64 - 1.0, picture.height as f64 - 1.0);
    let at = (DVec2::new(x as f64 + 0.5, y as f64 + 0.5) * scale - 0.5).clamp(DVec2::ZERO, last);
    let low = at.floor().min(last - 1.0);
    let f = at - low;
    let pixel = |dx, dy| picture.light[(low.y as usize + dy) * picture.width + low.x as usize + dx];
    pixel(0, 0).lerp(pixel(1, 0), f.x).lerp(pixel(0, 1).lerp(pixel(1, 1), f.x), f.y)
}

/// The picture out of focus: three passes of a 5 × 5 box.
fn blurred(mut picture: Rendered) -> Rendered {
    let (width, height) = (picture.width as i64, picture.height as i64);
    for _ in 0..3 {
        let sharp = picture.light.clone();
        for y in 0..height {
            for x in 0..width {
                let mut sum = DVec3::ZERO;
                for (dx, dy) in (-2..=2).flat_map(|dy| (-2..=2).map(move |dx| (dx, dy))) {
                    let (u, v) = ((x + dx).clamp(0, width - 1), (y + dy).clamp(0, height - 1));
                    sum += sharp[(v * width + u) as usize];
                }
                picture.light[(y * width + x) as usize] = sum / 25.0;
            }
        }
    }
    picture
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_board_lies_wholly_in_its_photograph() {
        for (index, hold) in HOLDS.iter().enumerate() {
            let view = look(hold.camera, [0.1 * hold.tilt[1], 0.02, -0.2], 0.01 * hold.tilt[2]);
            let sheet = hold.sheet(&view);
            let half = sheet.half_size();
            for (x, y) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
                let corner = sheet.centre + sheet.right * (x * half.x) + sheet.up * (y * half.y);
                let p = view.project(corner);
                let inside = p.x > 4.0 && p.y > 4.0 && p.x < 1075.0 && p.y < 715.0;
                assert!(inside, "board {index}: a corner of the paper is seen at {p}");
            }
            assert!(sheet.facing().dot(view.position - sheet.centre) > 0.0);
        }
    }

    #[test]
    fn ball_is_wholly_in_its_cutout_and_more_than_200_px_in_radius() {
        let centre = DVec3::Y * BALL_RADIUS_M;
        let distance = (ball_view().position - centre).length();
        let radius_px = lens().focal.x * BALL_SCALE as f64 * BALL_RADIUS_M / distance;
        assert!(radius_px > 200.0 && radius_px < 0.46 * BALL_CROP as f64, "{radius_px}");
    }

    #[test]
    fn the_shortest_photograph_of_the_bracket_holds_the_sun() {
        let seen = crate::sky::sun_radiance() * crate::place::BALL_REFLECTANCE;
        assert!((seen * BRACKET[0].scale()).max_element() < 0.9);
    }
}
