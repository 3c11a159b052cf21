//! Circles among edge points: where a ball may be.
//!
//! Edge points vote for the centres they point at, for radii in steps of 5 % (Hough); the best
//! cells start a small RANSAC on the points near that circle. A circle's worth is how many of its
//! sectors have an edge *along* it, less what other radii round the same centre have by chance:
//! texture is full of edges, but not of edges along one circle.

use std::f64::consts::PI;

use glam::DVec2;
use rayon::prelude::*;

use super::edges::Edge;

/// A circle and how well edges support it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Circle {
    pub centre: DVec2,
    pub radius: f64,
    /// Share of the sectors inside the frame that have an edge along the circle.
    pub support: f64,
    /// The same for other radii round this centre: what chance and texture give.
    pub background: f64,
    /// Share of the circle inside the frame.
    pub visible: f64,
}

impl Circle {
    /// Support beyond chance, 0…1, less for circles cut by the frame and for tiny ones.
    pub fn score(&self) -> f64 {
        let beyond = ((self.support - self.background) / (1.0 - self.background).max(0.1)).max(0.0);
        let sectors = sectors(self.radius) as f64;
        beyond * self.visible.sqrt() * sectors / (sectors + 20.0)
    }
}

const MAX_SECTORS: usize = 120;
/// Of the random circles, how many are polished by least squares.
const POLISHED: usize = 30;
const RADIUS_STEP: f64 = 1.05;
/// Most cells of one radius: 4096² of them, while pictures are reduced to 960 px. Only a lens whose
/// focal length is far larger than its picture needs more, and shows no ball.
const MAX_CELLS: f64 = 16_777_216.0;
/// Hough cells that start a RANSAC.
const STARTS: usize = 160;
/// Cosine of the largest angle between an edge and the circle's radius.
const ALONG: f64 = 0.94;

/// The plane in which circles are looked for: a rectangle, and what of it the picture shows.
///
/// The plane need not be the picture: [`find`](super::find) looks in the stereographic plane, where
/// every rim is exactly a circle.
pub struct Frame<'a> {
    pub least: DVec2,
    pub most: DVec2,
    pub shows: &'a (dyn Fn(DVec2) -> bool + Sync),
}

/// Circles of radius `least`…`most`, best first.
pub fn find(edges: &[Edge], frame: &Frame, least: f64, most: f64) -> Vec<Circle> {
    let steps = ((most / least).ln() / RADIUS_STEP.ln()).ceil().max(1.0) as usize;
    let mut cells: Vec<Cell> = (0..steps)
        .into_par_iter()
        .flat_map_iter(|k| vote(edges, frame, least * RADIUS_STEP.powi(k as i32)))
        .collect();
    cells.sort_by(|a, b| b.votes.total_cmp(&a.votes));
    let mut starts: Vec<Cell> = Vec::new();
    for cell in cells {
        let known = |s: &Cell| {
            (s.centre - cell.centre).length() < 0.12 * cell.radius
                && (s.radius / cell.radius).ln().abs() < 0.09
        };
        if !starts.iter().any(known) {
            starts.push(cell);
        }
        if starts.len() == STARTS {
            break;
        }
    }
    let mut circles: Vec<Circle> = starts
        .par_iter()
        .filter_map(|s| refine(edges, frame, s.centre, s.radius, &COARSE))
        .collect();
    circles.sort_by(|a, b| b.score().total_cmp(&a.score()));
    let mut distinct: Vec<Circle> = Vec::new();
    for circle in circles {
        let same = |c: &Circle| {
            (c.centre - circle.centre).length() < 0.03 * circle.radius
                && (c.radius / circle.radius).ln().abs() < 0.03
        };
        if !distinct.iter().any(same) {
            distinct.push(circle);
        }
    }
    distinct
}

struct Cell {
    centre: DVec2,
    radius: f64,
    votes: f64,
}

/// Local maxima of the votes for circles of one radius, as shares of the circumference.
fn vote(edges: &[Edge], frame: &Frame, radius: f64) -> Vec<Cell> {
    let size = (0.05 * radius).max(1.0);
    let extent = (frame.most - frame.least) / size;
    if !((extent.x + 2.0) * (extent.y + 2.0) <= MAX_CELLS) {
        return Vec::new();
    }
    let (w, h) = (extent.x.ceil() as usize + 1, extent.y.ceil() as usize + 1);
    let mut votes = vec![0f32; w * h];
    for edge in edges {
        for side in [radius, -radius] {
            let p = (edge.at + edge.towards * side - frame.least) / size;
            if p.x >= 0.0 && p.y >= 0.0 && p.x < w as f64 && p.y < h as f64 {
                votes[p.y as usize * w + p.x as usize] += 1.0;
            }
        }
    }
    let smooth = box_sum(&votes, w, h);
    let mean = smooth.iter().sum::<f32>() / smooth.len() as f32;
    let mut found = Vec::new();
    for y in 0..h {
        for x in 0..w {
            let here = smooth[y * w + x];
            let top = (y.saturating_sub(2)..(y + 3).min(h))
                .all(|j| (x.saturating_sub(2)..(x + 3).min(w)).all(|i| smooth[j * w + i] <= here));
            let share = f64::from(here - mean) / (2.0 * PI * radius);
            if top && share > 0.15 {
                let centre = frame.least + DVec2::new(x as f64 + 0.5, y as f64 + 0.5) * size;
                found.push(Cell { centre, radius, votes: share });
            }
        }
    }
    found
}

/// Sums over 5 × 5 cells.
fn box_sum(values: &[f32], w: usize, h: usize) -> Vec<f32> {
    let pass = |source: &[f32], along_x: bool| -> Vec<f32> {
        let mut out = vec![0.0; w * h];
        for y in 0..h {
            for x in 0..w {
                let (at, end) = if along_x { (x, w) } else { (y, h) };
                out[y * w + x] = (at.saturating_sub(2)..(at + 3).min(end))
                    .map(|k| if along_x { source[y * w + k] } else { source[k * w + x] })
                    .sum();
            }
        }
        out
    };
    pass(&pass(values, true), false)
}

/// How far round a start to look, and how exactly a circle must be met.
pub struct Search {
    /// Share of the radius that centre and radius may move.
    pub reach: f64,
    /// Tolerance as a share of the radius, and its least value, px.
    pub tolerance: f64,
    pub least_tolerance: f64,
    /// Of circles with nearly the best support (this share of it) the widest is taken: inside a
    /// rim the world is squeezed along it, outside there is nothing like it.
    pub widest_of: f64,
    pub triples: usize,
}

/// From a Hough cell to a circle.
pub const COARSE: Search =
    Search { reach: 0.25, tolerance: 0.012, least_tolerance: 1.2, widest_of: 1.0, triples: 150 };

/// From a circle of the reduced picture to one of the picture itself.
pub const NEAR: Search =
    Search { reach: 0.12, tolerance: 0.006, least_tolerance: 1.2, widest_of: 1.0, triples: 400 };

/// From a circle to the rim.
pub const FINE: Search =
    Search { reach: 0.06, tolerance: 0.003, least_tolerance: 1.0, widest_of: 0.85, triples: 800 };

impl Search {
    fn tolerance(&self, radius: f64) -> f64 {
        (self.tolerance * radius).max(self.least_tolerance)
    }
}

/// The best circle near a start, by RANSAC and least squares; `None` if the points make none.
pub fn refine(
    edges: &[Edge],
    frame: &Frame,
    centre: DVec2,
    radius: f64,
    search: &Search,
) -> Option<Circle> {
    let near: Vec<Edge> = edges
        .iter()
        .filter(|e| {
            let out = e.at - centre;
            let r = out.length();
            (r / radius - 1.0).abs() < search.reach && (out / r).dot(e.towards).abs() > 0.86
        })
        .copied()
        .collect();
    if near.len() < 12 {
        return None;
    }
    let stride = near.len().div_ceil(2500);
    let near: Vec<Edge> = near.into_iter().step_by(stride).collect();
    let mut pick = OutermostFirst::new(&near, centre, radius);
    let mut tried: Vec<(usize, DVec2, f64)> = Vec::new();
    for _ in 0..search.triples {
        let (p, q, s) = (pick.next(), pick.next(), pick.next());
        // Points close together say little of the circle.
        let spread = (p - q).length().min((q - s).length()).min((s - p).length());
        let Some((c, r)) = through(p, q, s).filter(|_| spread > 0.5 * radius) else { continue };
        let moved = (c - centre).length().max((r - radius).abs());
        if moved < search.reach * radius {
            tried.push((supported(&near, c, r, search.tolerance(r)), c, r));
        }
    }
    tried.sort_by_key(|tried| std::cmp::Reverse(tried.0));
    tried.truncate(POLISHED);
    for (support, c, r) in &mut tried {
        for _ in 0..4 {
            let tolerance = search.tolerance(*r);
            let on = near.iter().filter(|e| on_circle(e, *c, *r, tolerance)).map(|e| e.at);
            let Some(better) = least_squares(&on.collect::<Vec<_>>(), *c, *r) else { break };
            let reached = supported(&near, better.0, better.1, search.tolerance(better.1));
            if reached < *support {
                break;
            }
            (*support, *c, *r) = (reached, better.0, better.1);
        }
    }
    let enough = search.widest_of * tried.iter().map(|t| t.0).max()? as f64;
    let (_, c, r) =
        tried.into_iter().filter(|t| t.0 as f64 >= enough).max_by(|a, b| a.2.total_cmp(&b.2))?;
    measure(edges, frame, c, r, search)
}

/// Draws edge points for RANSAC: a sector at random, in it every other time any edge, else the
/// outermost with probability ½, the next with ¼ and so on. The rim is the outermost ring, so triples
/// lie on it far more often than chance.
pub(super) struct OutermostFirst {
    sectors: Vec<Vec<DVec2>>,
    random: u64,
}

impl OutermostFirst {
    pub(super) fn new(edges: &[Edge], centre: DVec2, radius: f64) -> Self {
        let n = sectors(radius);
        let mut sectors: Vec<Vec<DVec2>> = vec![Vec::new(); n];
        for edge in edges {
            sectors[sector(edge.at - centre, n)].push(edge.at);
        }
        sectors.retain(|s| !s.is_empty());
        for sector in &mut sectors {
            sector.sort_by(|a, b| (*b - centre).length().total_cmp(&(*a - centre).length()));
        }
        Self { sectors, random: 0x9E37_79B9_7F4A_7C15 ^ (((radius * 16.0) as u64) << 20) }
    }

    pub(super) fn next(&mut self) -> DVec2 {
        self.random ^= self.random << 13;
        self.random ^= self.random >> 7;
        self.random ^= self.random << 17;
        let sector = &self.sectors[(self.random >> 20) as usize % self.sectors.len()];
        // Every other draw takes the sector's edges alike: far from the rim outermost means texture.
        let depth = match self.random & 1 {
            0 => (self.random >> 40) as usize,
            _ => (self.random >> 1 & 0xFFFF).trailing_ones() as usize,
        };
        sector[depth % sector.len()]
    }
}

/// The support of a given circle; `None` if the frame shows less than a quarter of it.
pub fn measure(
    edges: &[Edge],
    frame: &Frame,
    centre: DVec2,
    radius: f64,
    search: &Search,
) -> Option<Circle> {
    let n = sectors(radius);
    let inside = (0..n)
        .filter(|k| {
            let turn = (*k as f64 + 0.5) / n as f64 * 2.0 * PI;
            (frame.shows)(centre + DVec2::from_angle(turn) * radius)
        })
        .count();
    if inside * 4 < n {
        return None;
    }
    let near: Vec<Edge> =
        edges.iter().filter(|e| (e.at - centre).length() < 1.4 * radius).copied().collect();
    let tolerance = search.tolerance(radius);
    let share = |r: f64| supported(&near, centre, r, tolerance) as f64 / inside as f64;
    let others = [0.75, 0.8, 0.85, 0.9, 1.1, 1.15, 1.2, 1.25];
    let background = others.iter().map(|f| share(f * radius)).sum::<f64>() / others.len() as f64;
    Some(Circle {
        centre,
        radius,
        support: share(radius).min(1.0),
        background: background.min(1.0),
        visible: inside as f64 / n as f64,
    })
}

/// Which of `n` sectors the direction `out` falls into.
pub(super) fn sector(out: DVec2, n: usize) -> usize {
    let turn = out.to_angle().rem_euclid(2.0 * PI) / (2.0 * PI);
    ((turn * n as f64) as usize).min(n - 1)
}

/// Sectors that a circle is divided into: of about three pixels, at most 120.
fn sectors(radius: f64) -> usize {
    ((2.0 * PI * radius / 3.0) as usize).clamp(12, MAX_SECTORS)
}

pub(super) fn on_circle(edge: &Edge, centre: DVec2, radius: f64, tolerance: f64) -> bool {
    let out = edge.at - centre;
    let r = out.length();
    (r - radius).abs() < tolerance && out.dot(edge.towards).abs() > ALONG * r
}

/// Number of sectors with an edge along the circle.
fn supported(edges: &[Edge], centre: DVec2, radius: f64, tolerance: f64) -> usize {
    let n = sectors(radius);
    let mut seen = [false; MAX_SECTORS];
    for edge in edges.iter().filter(|e| on_circle(e, centre, radius, tolerance)) {
        seen[sector(edge.at - centre, n)] = true;
    }
    seen.iter().filter(|s| **s).count()
}

/// Centre and radius of the circle through three points.
pub(super) fn through(a: DVec2, b: DVec2, c: DVec2) -> Option<(DVec2, f64)> {
    let (p, q) = (b - a, c - a);
    let cross = 2.0 * p.perp_dot(q);
    if cross.abs() < 1e-3 * p.length() * q.length() {
        return None;
    }
    let (pp, qq) = (p.length_squared(), q.length_squared());
    let from_a = DVec2::new(q.y * pp - p.y * qq, p.x * qq - q.x * pp) / cross;
    Some((a + from_a, from_a.length()))
}

/// One Gauss–Newton step of the geometric circle fit.
fn least_squares(points: &[DVec2], centre: DVec2, radius: f64) -> Option<(DVec2, f64)> {
    if points.len() < 5 {
        return None;
    }
    let mut normal = nalgebra::Matrix3::<f64>::zeros();
    let mut gradient = nalgebra::Vector3::<f64>::zeros();
    for p in points {
        let out = *p - centre;
        let way = out.try_normalize()?;
        let row = nalgebra::Vector3::new(way.x, way.y, 1.0);
        normal += row * row.transpose();
        gradient += row * (out.length() - radius);
    }
    let step = normal.try_inverse()? * gradient;
    Some((centre + DVec2::new(step[0], step[1]), radius + step[2]))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Edges all over (seeded) and `share` of a circle of radius 40 round (130, 90).
    fn scene(share: f64, clutter: usize) -> Vec<Edge> {
        let mut state = 88172645463325252u64;
        let mut uniform = || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state >> 11) as f64 / (1u64 << 53) as f64
        };
        let mut edges: Vec<Edge> = (0..clutter)
            .map(|_| Edge {
                at: DVec2::new(320.0 * uniform(), 240.0 * uniform()),
                towards: DVec2::from_angle(2.0 * PI * uniform()),
                strength: 1.0,
            })
            .collect();
        edges.extend((0..250).filter(|k| (*k as f64) < 250.0 * share).map(|k| {
            let turn = k as f64 / 250.0 * 2.0 * PI;
            let way = DVec2::from_angle(turn);
            Edge {
                at: DVec2::new(130.0, 90.0) + way * (40.0 + uniform() - 0.5),
                towards: DVec2::from_angle(turn + 0.2 * (uniform() - 0.5)),
                strength: 0.1,
            }
        }));
        edges
    }

    fn search(edges: &[Edge]) -> Vec<Circle> {
        let (least, most) = (DVec2::ZERO, DVec2::new(320.0, 240.0));
        let shows = |p: DVec2| p.cmpge(least).all() && p.cmplt(most).all();
        find(edges, &Frame { least, most, shows: &shows }, 10.0, 120.0)
    }

    #[test]
    fn a_circle_is_found_in_clutter() {
        for share in [1.0, 0.7] {
            let circles = search(&scene(share, 4000));
            let best = circles[0];
            assert!((best.centre - DVec2::new(130.0, 90.0)).length() < 1.0, "{best:?}");
            assert!((best.radius - 40.0).abs() < 1.0, "{best:?}");
            assert!(best.score() > 0.35, "{best:?}");
        }
    }

    #[test]
    fn clutter_alone_scores_low() {
        let circles = search(&scene(0.0, 4000));
        assert!(circles.first().is_none_or(|c| c.score() < 0.3), "{:?}", circles.first());
    }

    #[test]
    fn no_edges_no_circles() {
        assert!(search(&[]).is_empty());
    }
}
