//! Finds a mirror ball in a photograph: no hint needed, a hint accepted.
//!
//! Edge points are taken at two reduced sizes and moved to the stereographic plane of the lens,
//! where the rim of every ball is exactly a circle, also at the corner of a wide lens. Circles
//! compete by their support ([`circles`]); the best few are looked at more closely, where of
//! circles supported nearly alike the widest wins: a reflected horizon lies inside the rim, never
//! outside. The rim itself is then fitted as a cone ([`rim::fit`]), at a size where the ball is at
//! most [`FINE_RADIUS_PX`] in radius; finer than that, photographs hold blur and not rim.
//!
//! Two things tell a ball from what else has a round outline: it stands out from the texture round it
//! ([`Circle::score`]), and its edges lie on one circle far more narrowly than they would by chance
//! ([`ring::Ring::agreement`]). What reaches less than the least of either is no ball; what reaches both
//! but little more is [doubtful](super::Doubt). Other round things (a mug, a rose window) are not told apart.

use glam::{DVec2, DVec3};

use super::ProbeError;
use super::ball::{Ball, Mirror};
use super::circles::{self, Circle, Frame};
use super::edges::{self, Edge};
use super::rim::{self, Rim};
use super::ring::{self, Ring};
use super::unwrap::pixel_angle;
use crate::camera::{Camera, Lens};
use crate::conventions::{Rgb, luminance};
use crate::photo::Image;

/// Longer side of the pictures in which large and small balls are looked for, px.
const COARSE_SIDES_PX: [usize; 2] = [320, 960];
/// Smallest ball looked for in them, px of radius.
const LEAST_RADIUS_PX: f64 = 10.0;
/// Radius at which the rim is fitted; larger balls are reduced to it.
const FINE_RADIUS_PX: f64 = 450.0;
/// Blur before edges are taken there: less tells the rim from what is squeezed along it.
const FINE_SIGMA_PX: f64 = 0.7;
/// Blur of noisy photographs at most, as a share of the radius: with more of it, what is squeezed along the
/// rim pulls it in.
const MOST_BLUR: f64 = 0.004;
/// Candidates looked at closely.
const CANDIDATES: usize = 6;
/// Support beyond chance below which nothing is called a ball. 31 photographs of balls reach 0.50 to 0.82,
/// other things in 46 photographs without one 0.2 to 0.5, a rose window and a mug more.
const LEAST_SCORE: f64 = 0.42;
/// The same for the share of the rim whose edges agree on one circle: 0.37 to 1 for balls; below 0.3 for
/// what else has the score.
const LEAST_AGREEMENT: f64 = 0.35;
/// Where the user says that there is a ball, a fit to this much is better than the hint itself.
const LEAST_AGREEMENT_OF_HINT: f64 = 0.2;
/// Score and agreement below which a ball is doubted, and above which it was not once something else.
const TRUSTED_SCORE: f64 = 0.5;
const TRUSTED_AGREEMENT: f64 = 0.4;
/// Light round a circle, as a share of that inside, below which it is black.
const BLACK: f32 = 0.05;
/// A circle before black, of which the frame shows less than this, is the border of a fisheye's picture.
const CUT_BORDER: f64 = 0.7;
/// How far edge points may be off the rim, in widths of the ring they make.
const TOLERANCE: f64 = 2.5;
/// Edges this far off the axis are left out, rad: the plane of the search ends at 3.7 times its
/// width at 90°; straight behind it would be infinite.
const FARTHEST_OFF_AXIS_RAD: f64 = 150.0 * std::f64::consts::PI / 180.0;
/// Standard error of a hint whose rim could not be measured: share of its radius.
pub(super) const HINT_SIGMA: f64 = 0.01;

/// What is known beforehand.
#[derive(Clone, Copy, Debug, Default)]
pub struct Hints<'a> {
    /// The ball's centre u, v and radius r, px; within a tenth of the radius is enough.
    pub circle_px: Option<[f64; 3]>,
    /// The same view without the ball, same size.
    pub clean_plate: Option<&'a Image<Rgb>>,
}

/// A ball found in a photograph.
#[derive(Clone, Debug, PartialEq)]
pub struct BallImage {
    /// The rim, camera axes, with its covariance.
    pub rim: Rim,
    /// Pixel of the ball's centre direction (not quite the middle of its picture).
    pub centre_px: DVec2,
    /// Mean distance of the rim from the middle of its picture, px.
    pub radius_px: f64,
    /// Standard error of centre and radius, px.
    pub sigma_px: f64,
    /// Support beyond chance, 0…1; `None` if the hint was taken as it is.
    pub score: Option<f64>,
    /// Share of the rim whose edges agree on one circle, 0…1; `None` if the hint was taken as it is.
    pub agreement: Option<f64>,
    /// Whether all that the picture shows beside the ball is black.
    pub before_black: bool,
    /// Another place that looks nearly as much like a ball: centre and radius, px.
    pub rival_px: Option<[f64; 3]>,
}

impl BallImage {
    /// Whether it looks so little like a ball that it may be something else that is round.
    pub fn is_weak(&self) -> bool {
        self.score.is_some_and(|score| score < TRUSTED_SCORE)
            || self.agreement.is_some_and(|agreement| agreement < TRUSTED_AGREEMENT)
    }

    /// Where its rim puts the centre of a ball of this radius before the camera: world, metres.
    pub fn centre_of(&self, radius_m: f64, camera: &Camera) -> DVec3 {
        let distance = radius_m / self.rim.half_angle_rad.sin();
        camera.pose.position() + camera.pose.rotation() * self.rim.axis * distance
    }

    /// How far the rim is from where a known pose puts it: centre and radius (found − predicted), px.
    ///
    /// Beyond a few σ either the pose, the ball's place or size, or the rim is wrong. `None` if the
    /// camera cannot see the ball there.
    pub fn disagreement_px(&self, camera: &Camera, ball: &Ball) -> Option<(f64, f64)> {
        let centre = camera.pose.inverse().transform_point3(ball.centre);
        let half_angle = Mirror::new(centre, ball.radius)?.half_angle();
        let pixel = pixel_angle(&camera.lens, self.rim.axis)?;
        let apart = self.rim.axis.angle_between(centre.normalize());
        Some((apart / pixel, (self.rim.half_angle_rad - half_angle) / pixel))
    }
}

/// Finds the ball in scene-linear light.
///
/// `picture` is a photograph, or a merged bracket (best: nothing is clipped); `lens` is its lens.
/// A clean plate that does not help (another pose, another exposure's noise) is left aside.
pub fn find(picture: &Image<Rgb>, lens: &Lens, hints: &Hints) -> Result<BallImage, ProbeError> {
    check(picture, hints)?;
    let with_plate = match hints.clean_plate {
        Some(_) => search(picture, lens, hints).ok().filter(|b| b.score > Some(TRUSTED_SCORE)),
        None => None,
    };
    match with_plate {
        Some(ball) => Ok(ball),
        None => search(picture, lens, &Hints { clean_plate: None, ..*hints }),
    }
}

/// [`find`] with checked hints.
fn search(picture: &Image<Rgb>, lens: &Lens, hints: &Hints) -> Result<BallImage, ProbeError> {
    let plane = Plane { lens, width: picture.width(), height: picture.height() };
    let starts = match hints.circle_px {
        Some(hint) => vec![plane.circle(hint)?],
        None => candidates(picture, &plane, hints)?,
    };
    let mut closer: Vec<Candidate> =
        starts.iter().filter_map(|start| look_closer(picture, &plane, hints, start)).collect();
    closer.sort_by(|a, b| b.score().total_cmp(&a.score()));
    if let Some(hint) = hints.circle_px {
        closer.retain(|c| c.ring.agreement >= LEAST_AGREEMENT_OF_HINT);
        let fitted = closer.first().and_then(|chosen| Some((chosen, fit(&plane, chosen).ok()?)));
        return match fitted {
            Some((chosen, rim)) => describe(picture, &plane, rim, Some(chosen)),
            None => describe(picture, &plane, hinted(&plane, hint)?, None),
        };
    }
    let best = closer.first().map(|c| (c.score(), c.ring.agreement));
    closer.retain(|c| c.score() >= LEAST_SCORE && c.ring.agreement >= LEAST_AGREEMENT);
    let Some(chosen) = choose(&closer) else {
        let reason = match best {
            Some((score, agreement)) => format!(
                "the roundest thing in the picture stands out by {score:.2} ({LEAST_SCORE} is needed), and its \
                 edges lie on one circle along {:.0} % of it ({:.0} % are needed)",
                100.0 * agreement,
                100.0 * LEAST_AGREEMENT
            ),
            None => "no circle in the picture stands out from its texture".into(),
        };
        return Err(ProbeError::NoBall { reason });
    };
    let rim = fit(&plane, chosen)?;
    let mut ball = describe(picture, &plane, rim, Some(chosen))?;
    if ball.before_black && chosen.circle.visible < CUT_BORDER {
        return Err(ProbeError::FisheyeBorder {
            circle_px: [ball.centre_px.x, ball.centre_px.y, ball.radius_px],
        });
    }
    let rival = closer.iter().find(|c| {
        let apart = (c.circle.centre - chosen.circle.centre).length() > chosen.circle.radius;
        apart && c.score() > 0.85 * chosen.score()
    });
    ball.rival_px = rival.and_then(|c| plane.to_picture(&c.circle));
    Ok(ball)
}

fn check(picture: &Image<Rgb>, hints: &Hints) -> Result<(), ProbeError> {
    let (w, h) = (picture.width(), picture.height());
    if w.min(h) < 16 {
        let reason = format!("the picture is only {w} × {h} px");
        return Err(ProbeError::NoBall { reason });
    }
    if let Some(hint) = hints.circle_px
        && !is_in(hint, (w, h))
    {
        let found = format!("{hint:?}");
        let expected = "u, v and r in pixels of a circle of radius 5 or more in this picture";
        return Err(ProbeError::Value { what: "the ball's hint", found, expected });
    }
    if let Some(plate) = hints.clean_plate
        && (plate.width(), plate.height()) != (w, h)
    {
        let found = format!("{} × {} px", plate.width(), plate.height());
        let expected = "as large as the photograph of the ball";
        return Err(ProbeError::Value { what: "the clean plate", found, expected });
    }
    Ok(())
}

/// Whether a circle has a size that can be searched and shows in the picture.
fn is_in([u, v, r]: [f64; 3], (w, h): (usize, usize)) -> bool {
    let (right, bottom) = (w as f64, h as f64);
    (5.0..=right.max(bottom)).contains(&r)
        && (-r..=right + r).contains(&u)
        && (-r..=bottom + r).contains(&v)
}

/// Stereographic plane of a lens: `2 f tan(θ/2)`, px of the picture near the axis, y down.
struct Plane<'a> {
    lens: &'a Lens,
    width: usize,
    height: usize,
}

impl Plane<'_> {
    fn focal(&self) -> f64 {
        (self.lens.fx * self.lens.fy).sqrt()
    }

    fn at_ray(&self, d: DVec3) -> DVec2 {
        DVec2::new(d.x, -d.y) * (2.0 * self.focal() / (1.0 - d.z))
    }

    fn ray(&self, p: DVec2) -> DVec3 {
        let q = p / (2.0 * self.focal());
        let s = q.length_squared();
        DVec3::new(2.0 * q.x, -2.0 * q.y, s - 1.0) / (1.0 + s)
    }

    fn at_pixel(&self, pixel: DVec2) -> Option<DVec2> {
        Some(self.at_ray(self.lens.unproject(pixel)?))
    }

    /// Whether the picture shows a point, two pixels of border left out.
    fn shows(&self, p: DVec2, border: f64) -> bool {
        self.lens.project(self.ray(p)).is_some_and(|q| {
            q.x > border
                && q.y > border
                && q.x < self.width as f64 - 1.0 - border
                && q.y < self.height as f64 - 1.0 - border
        })
    }

    /// The circle of a hint in pixels.
    fn circle(&self, [u, v, r]: [f64; 3]) -> Result<Circle, ProbeError> {
        let at = |dx: f64, dy: f64| self.at_pixel(DVec2::new(u + dx, v + dy));
        let rim = [at(r, 0.0), at(-r, 0.0), at(0.0, r), at(0.0, -r)];
        let [Some(e), Some(w), Some(s), Some(n)] = rim else {
            return Err(ProbeError::NoBall {
                reason: "the hint lies outside the lens's field".into(),
            });
        };
        let centre = (e + w + s + n) / 4.0;
        let radius = [e, w, s, n].iter().map(|p| (*p - centre).length()).sum::<f64>() / 4.0;
        Ok(Circle { centre, radius, support: 0.0, background: 0.0, visible: 1.0 })
    }

    /// Middle and mean radius of a circle's picture, px.
    fn to_picture(&self, circle: &Circle) -> Option<[f64; 3]> {
        let points: Vec<DVec2> = (0..72)
            .filter_map(|k| {
                let turn = f64::from(k) * 5f64.to_radians();
                self.lens.project(self.ray(circle.centre + DVec2::from_angle(turn) * circle.radius))
            })
            .collect();
        let n = points.len() as f64;
        let centre = points.iter().sum::<DVec2>() / n;
        let radius = points.iter().map(|p| (*p - centre).length()).sum::<f64>() / n;
        (n > 0.0).then_some([centre.x, centre.y, radius])
    }

    /// Edge points of a reduced cut-out, in the plane and in its units divided by `factor`.
    fn edges(&self, found: &[Edge], origin: DVec2, factor: f64) -> Vec<Edge> {
        let farthest = 2.0 * self.focal() * (FARTHEST_OFF_AXIS_RAD / 2.0).tan();
        found
            .iter()
            .filter_map(|edge| {
                let pixel = |p: DVec2| origin + (p + 0.5) * factor - 0.5;
                let at = self.at_pixel(pixel(edge.at)).filter(|at| at.length() < farthest)?;
                // Tangents map forward; the edge's side is kept by its sign.
                let tangent = self.at_pixel(pixel(edge.at + edge.towards.perp()))? - at;
                let towards = -tangent.try_normalize()?.perp();
                Some(Edge { at: at / factor, towards, strength: edge.strength })
            })
            .collect()
    }
}

/// What edges are taken from: log luminance, or how much it differs from the clean plate.
fn guide(picture: &Image<Rgb>, plate: Option<&Image<Rgb>>, factor: usize) -> Image<f32> {
    let log = edges::log_luminance(picture, factor);
    let Some(plate) = plate else { return log };
    let plate = edges::log_luminance(plate, factor);
    let mut ratio: Vec<f32> = log.pixels().iter().zip(plate.pixels()).map(|(a, b)| a - b).collect();
    if ratio.is_empty() {
        return log;
    }
    let middle = ratio.len() / 2;
    // Exposures may differ: most of the picture is without the ball.
    let gain = *ratio.clone().select_nth_unstable_by(middle, f32::total_cmp).1;
    ratio.iter_mut().for_each(|r| *r = (*r - gain).abs().min(2.0));
    Image::from_pixels(log.width(), log.height(), ratio).unwrap_or(log)
}

/// Circles of the whole picture, the most ball-like first.
fn candidates(
    picture: &Image<Rgb>,
    plane: &Plane,
    hints: &Hints,
) -> Result<Vec<Circle>, ProbeError> {
    let side = picture.width().max(picture.height());
    let mut all: Vec<Circle> = Vec::new();
    for (level, wanted) in COARSE_SIDES_PX.into_iter().enumerate() {
        let factor = ((side as f64 / wanted as f64).round() as usize).max(1);
        let found = edges::edges(&guide(picture, hints.clean_plate, factor), 1.0);
        let scale = factor as f64;
        let moved = plane.edges(&found, DVec2::ZERO, scale);
        if moved.is_empty() {
            continue;
        }
        let least = moved.iter().map(|e| e.at).reduce(DVec2::min).unwrap_or_default();
        let most = moved.iter().map(|e| e.at).reduce(DVec2::max).unwrap_or_default();
        let shows = |p: DVec2| plane.shows(p * scale, 2.0 * scale);
        let frame = Frame { least, most, shows: &shows };
        let reach = (most - least).max_element();
        // Each size of ball is looked for where it is 10 to some 100 px in radius.
        let largest = if level == 0 { 0.75 * reach } else { 0.11 * reach };
        for mut circle in circles::find(&moved, &frame, LEAST_RADIUS_PX, largest) {
            circle.centre *= scale;
            circle.radius *= scale;
            all.push(circle);
        }
    }
    all.sort_by(|a, b| b.score().total_cmp(&a.score()));
    let mut distinct: Vec<Circle> = Vec::new();
    for circle in all {
        let same = |c: &Circle| {
            (c.centre - circle.centre).length() < 0.05 * circle.radius
                && (c.radius / circle.radius).ln().abs() < 0.05
        };
        if !distinct.iter().any(same) {
            distinct.push(circle);
        }
        if distinct.len() == CANDIDATES {
            break;
        }
    }
    Ok(distinct)
}

/// A circle looked at closely.
struct Candidate {
    /// In units of the picture's plane.
    circle: Circle,
    /// Score of the reduced picture; `None` for a hint.
    start_score: Option<f64>,
    /// Edge points round it, in fine pixels.
    edges: Vec<Edge>,
    /// Pixels of the picture in a fine pixel.
    scale: f64,
    /// Where the edges agree, in fine pixels.
    ring: Ring,
}

impl Candidate {
    /// Soft pictures score better when reduced, crowded ones when not.
    fn score(&self) -> f64 {
        let fine = self.circle.score();
        (fine + self.start_score.unwrap_or(fine)) / 2.0
    }
}

/// The rim near `start`, at fine size.
fn look_closer(
    picture: &Image<Rgb>,
    plane: &Plane,
    hints: &Hints,
    start: &Circle,
) -> Option<Candidate> {
    let [u, v, r] = plane.to_picture(start)?;
    let factor = ((r / FINE_RADIUS_PX).round() as usize).max(1);
    let origin = ((DVec2::new(u, v) - 1.45 * r).max(DVec2::ZERO)).as_usizevec2();
    let end = (DVec2::new(u, v) + 1.45 * r).as_usizevec2() + 1;
    let end = end.min(glam::USizeVec2::new(picture.width(), picture.height()));
    if end.cmple(origin + 16).any() {
        return None;
    }
    let cut = |picture: &Image<Rgb>| {
        let size = end - origin;
        Image::from_fn(size.x, size.y, |x, y| picture[(origin.x + x, origin.y + y)])
    };
    let plate = hints.clean_plate.map(cut);
    let guide = guide(&cut(picture), plate.as_ref(), factor);
    let most_blur = MOST_BLUR * r / factor as f64;
    let found = edges::edges(&guide, edges::quiet_sigma(&guide, FINE_SIGMA_PX, most_blur));
    let scale = factor as f64;
    let edges = plane.edges(&found, origin.as_dvec2(), scale);
    let shows = |p: DVec2| plane.shows(p * scale, 2.0 * scale);
    let least = DVec2::ZERO;
    let frame = Frame { least, most: least, shows: &shows };
    let (centre, radius) = (start.centre / scale, start.radius / scale);
    let near = circles::refine(&edges, &frame, centre, radius, &circles::NEAR)?;
    let mut circle = circles::refine(&edges, &frame, near.centre, near.radius, &circles::FINE)?;
    let ring = ring::find(&edges, &circle)?;
    circle.centre *= scale;
    circle.radius *= scale;
    let start_score = hints.circle_px.is_none().then(|| start.score());
    Some(Candidate { circle, start_score, edges, scale, ring })
}

/// The best supported, or a wider one round it that is supported nearly as well.
fn choose(closer: &[Candidate]) -> Option<&Candidate> {
    let best = closer.first()?;
    closer
        .iter()
        .filter(|c| {
            let between = (c.circle.centre - best.circle.centre).length();
            let inside = between + best.circle.radius < 1.05 * c.circle.radius;
            inside && c.score() > 0.8 * best.score()
        })
        .max_by(|a, b| a.circle.radius.total_cmp(&b.circle.radius))
        .or(Some(best))
}

/// The cone through the edge points along a circle.
fn fit(plane: &Plane, candidate: &Candidate) -> Result<Rim, ProbeError> {
    let Candidate { circle, edges, scale, ring, .. } = candidate;
    let rays: Vec<DVec3> = ring.points(edges).into_iter().map(|p| plane.ray(p * *scale)).collect();
    let pixel = pixel_angle(plane.lens, plane.ray(circle.centre))
        .ok_or_else(|| ProbeError::NoBall { reason: "it lies outside the lens's field".into() })?;
    rim::fit(&rays, pixel * scale, TOLERANCE * ring.width)
}

/// The rim of a hint taken as it is.
fn hinted(plane: &Plane, hint: [f64; 3]) -> Result<Rim, ProbeError> {
    let circle = plane.circle(hint)?;
    let rays: Vec<DVec3> = (0..72)
        .map(|k| {
            let turn = f64::from(k) * 5f64.to_radians();
            plane.ray(circle.centre + DVec2::from_angle(turn) * circle.radius)
        })
        .collect();
    let cone = rim::fit(&rays, circle.radius / plane.focal() * 1e-3, 1.0)?;
    let sigma =
        (HINT_SIGMA * cone.half_angle_rad).max(pixel_angle(plane.lens, cone.axis).unwrap_or(0.0));
    Ok(Rim::known(cone.axis, cone.half_angle_rad, sigma))
}

/// Whether there is nothing beside the rim but black: the picture was masked, or is a fisheye's.
fn is_before_black(picture: &Image<Rgb>, lens: &Lens, rim: &Rim) -> bool {
    let light = |share: f64| -> Vec<f32> {
        let cone = Rim { half_angle_rad: share * rim.half_angle_rad, ..*rim };
        let pixel = |k: u32| lens.project(cone.ray(f64::from(k) * 3f64.to_radians()));
        let shown = (0..120).filter_map(pixel).map(|p| p.round()).filter(|p| {
            p.x >= 0.0
                && p.y >= 0.0
                && p.x < picture.width() as f64
                && p.y < picture.height() as f64
        });
        shown.map(|p| luminance(picture[(p.x as usize, p.y as usize)])).collect()
    };
    let rank = |mut light: Vec<f32>, share: usize| {
        light.sort_by(f32::total_cmp);
        light.get(light.len() * share / 100).copied()
    };
    let inside = rank([0.2, 0.4, 0.6, 0.8].map(light).concat(), 50);
    let around = rank([1.04, 1.07, 1.1, 1.13].map(light).concat(), 50);
    inside.zip(around).is_some_and(|(inside, around)| around < BLACK * inside)
}

/// What is told of a rim; `None` is the candidate of a hint taken as it is.
fn describe(
    picture: &Image<Rgb>,
    plane: &Plane,
    rim: Rim,
    candidate: Option<&Candidate>,
) -> Result<BallImage, ProbeError> {
    let outside = || ProbeError::NoBall { reason: "its centre is outside the lens's field".into() };
    let centre_px = plane.lens.project(rim.axis).ok_or_else(outside)?;
    let pixel = pixel_angle(plane.lens, rim.axis).ok_or_else(outside)?;
    let points: Vec<DVec2> = (0..72)
        .filter_map(|k| plane.lens.project(rim.ray(f64::from(k) * 5f64.to_radians())))
        .collect();
    let middle = points.iter().sum::<DVec2>() / points.len().max(1) as f64;
    let radius_px =
        points.iter().map(|p| (*p - middle).length()).sum::<f64>() / points.len().max(1) as f64;
    let sigma_px = rim.sigma_axis_rad() / pixel;
    Ok(BallImage {
        rim,
        centre_px,
        radius_px,
        sigma_px,
        score: candidate.map(Candidate::score),
        agreement: candidate.map(|c| c.ring.agreement),
        before_black: is_before_black(picture, plane.lens, &rim),
        rival_px: None,
    })
}

#[cfg(test)]
mod tests;
