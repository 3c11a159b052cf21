//! The rim among the edges along a circle.
//!
//! Inside the rim the world is squeezed along it: edges come near it from within, lie along it two pixels
//! further in, and where rim and background are alike nothing else is seen (methods-capture C4). What they
//! do not do is agree on one circle as narrowly as the rim does. So circles compete by the sectors that
//! have an edge within a fraction of a pixel, each sector counting by how unlikely that is by chance: in
//! texture it means nothing. Of circles supported nearly alike the widest is the rim.
//!
//! How much of the circle agrees is also what tells a ball from texture ([`Ring::agreement`]).

use glam::DVec2;

use super::circles::{Circle, OutermostFirst, on_circle, sector, through};
use super::edges::Edge;

/// Sectors of the circle.
const SECTORS: usize = 360;
/// Chance is judged over this many sectors to each side.
const AROUND: usize = 7;
/// How far from the start the rim may lie, as a share of the radius.
const REACH: f64 = 0.035;
/// Random circles tried, and how many of them are polished.
const TRIPLES: usize = 2500;
const POLISHED: usize = 30;
/// Circles with this share of the best support may be the rim; the widest of them is.
const NEARLY: f64 = 0.93;
/// Half-widths within which edges agree, px: sharp photographs first.
const WIDTHS_PX: [f64; 4] = [0.15, 0.3, 0.6, 1.2];
/// Reach of an edge's support, in half-widths of the agreement.
const KERNEL: f64 = 2.5;
/// Support at which no wider agreement is looked for, where all of the circle is in the picture.
const ENOUGH: f64 = 0.4;

/// The rim, and how narrowly its edges agree.
pub struct Ring {
    pub centre: DVec2,
    pub radius: f64,
    /// Half-width of the agreement, px.
    pub width: f64,
    /// Share of the circle in the picture with an edge along it that agrees, 0…1.
    pub agreement: f64,
}

/// The narrowest well supported circle near `start`; `None` where there are too few edges.
pub fn find(edges: &[Edge], start: &Circle) -> Option<Ring> {
    let near = Near::new(edges, start)?;
    let mut best: Option<Ring> = None;
    // Edges that agree to no better than the band in which they are looked for say nothing.
    let narrower = |width: &f64| KERNEL * width <= REACH * near.radius;
    let least = WIDTHS_PX[0];
    for width in WIDTHS_PX.into_iter().filter(|width| *width == least || narrower(width)) {
        let Some(mut ring) = near.find(width) else { continue };
        ring.agreement = (ring.agreement / start.visible).min(1.0);
        let enough = ring.agreement >= ENOUGH;
        if best.as_ref().is_none_or(|best| ring.agreement > best.agreement) {
            best = Some(ring);
        }
        if enough {
            break;
        }
    }
    best
}

impl Ring {
    /// For each sector the edge nearest to the rim, within a few widths of it.
    pub fn points(&self, edges: &[Edge]) -> Vec<DVec2> {
        let mut nearest: Vec<Option<(f64, DVec2)>> = vec![None; SECTORS];
        let reach = 4.0 * self.width;
        for edge in edges.iter().filter(|e| on_circle(e, self.centre, self.radius, reach)) {
            let off = ((edge.at - self.centre).length() - self.radius).abs();
            let slot = &mut nearest[sector(edge.at - self.centre, SECTORS)];
            if slot.is_none_or(|(least, _)| off < least) {
                *slot = Some((off, edge.at));
            }
        }
        nearest.into_iter().flatten().map(|(_, at)| at).collect()
    }
}

/// The edges along a circle, by sector.
struct Near {
    edges: Vec<Edge>,
    /// Where each sector's edges begin in `edges`, and where the last one's end.
    begins: Vec<usize>,
    centre: DVec2,
    radius: f64,
}

impl Near {
    fn new(edges: &[Edge], start: &Circle) -> Option<Self> {
        let (centre, radius) = (start.centre, start.radius);
        let along = |edge: &&Edge| on_circle(edge, centre, radius, REACH * radius);
        let mut edges: Vec<Edge> = edges.iter().filter(along).copied().collect();
        if edges.len() < 12 {
            return None;
        }
        let of = |edge: &Edge| sector(edge.at - centre, SECTORS);
        edges.sort_by_key(of);
        let begins = (0..=SECTORS).map(|k| edges.partition_point(|edge| of(edge) < k)).collect();
        Some(Self { edges, begins, centre, radius })
    }

    /// What each sector's support is worth: little where so many edges lie that one meets any circle.
    fn worth(&self, width: f64) -> Vec<f64> {
        let window = 2 * AROUND + 1;
        let raw: Vec<f64> = (0..SECTORS)
            .map(|k| {
                let sectors = (0..window).map(|i| (k + SECTORS + i - AROUND) % SECTORS);
                let count: usize = sectors.map(|k| self.begins[k + 1] - self.begins[k]).sum();
                let expected = count as f64 / window as f64 * width / (REACH * self.radius);
                (-1.25 * expected).exp()
            })
            .collect();
        let sum: f64 = raw.iter().sum();
        raw.into_iter().map(|worth| worth / sum).collect()
    }

    /// Each sector's edge nearest to a circle, and how far outside of it that lies.
    fn nearest(&self, centre: DVec2, radius: f64) -> impl Iterator<Item = (usize, f64, DVec2)> {
        self.begins.windows(2).enumerate().filter_map(move |(k, range)| {
            let off = self.edges[range[0]..range[1]].iter().map(|edge| {
                let out = edge.at - centre;
                (k, out.length() - radius, out)
            });
            off.min_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))
        })
    }

    /// Share of the circle with an edge along it, 0…1.
    fn support(&self, (centre, radius): (DVec2, f64), width: f64, worth: &[f64]) -> f64 {
        self.nearest(centre, radius)
            .map(|(k, off, _)| worth[k] * biweight(off / (KERNEL * width)))
            .sum()
    }

    fn find(&self, width: f64) -> Option<Ring> {
        let worth = self.worth(width);
        let reach = REACH * self.radius;
        let mut pick = OutermostFirst::new(&self.edges, self.centre, self.radius);
        let mut tried: Vec<(f64, (DVec2, f64))> = Vec::new();
        for _ in 0..TRIPLES {
            let (p, q, s) = (pick.next(), pick.next(), pick.next());
            let spread = (p - q).length().min((q - s).length()).min((s - p).length());
            if spread < 0.5 * self.radius {
                continue;
            }
            let Some((centre, radius)) = through(p, q, s) else { continue };
            if (centre - self.centre).length().max((radius - self.radius).abs()) < reach {
                tried.push((self.support((centre, radius), width, &worth), (centre, radius)));
            }
        }
        tried.sort_by(|a, b| b.0.total_cmp(&a.0));
        tried.truncate(POLISHED);
        for (support, circle) in &mut tried {
            for _ in 0..4 {
                let Some(better) = self.step(*circle, width, &worth) else { break };
                *circle = better;
            }
            *support = self.support(*circle, width, &worth);
        }
        let enough = NEARLY * tried.iter().map(|t| t.0).reduce(f64::max)?;
        let widest = tried
            .into_iter()
            .filter(|(support, _)| *support >= enough)
            .max_by(|a, b| a.1.1.total_cmp(&b.1.1))?;
        let (support, (centre, radius)) = widest;
        Some(Ring { centre, radius, width, agreement: support })
    }

    /// One Gauss–Newton step of the circle fit to the nearest edges.
    fn step(
        &self,
        (centre, radius): (DVec2, f64),
        width: f64,
        worth: &[f64],
    ) -> Option<(DVec2, f64)> {
        let mut normal = nalgebra::Matrix3::<f64>::zeros();
        let mut gradient = nalgebra::Vector3::<f64>::zeros();
        for (k, off, out) in self.nearest(centre, radius) {
            let weight = worth[k] * biweight(off / (4.0 * width));
            let way = out.try_normalize()?;
            let row = nalgebra::Vector3::new(way.x, way.y, 1.0);
            normal += weight * row * row.transpose();
            gradient += weight * off * row;
        }
        let step = normal.try_inverse()? * gradient;
        Some((centre + DVec2::new(step[0], step[1]), radius + step[2]))
    }
}

/// Tukey's biweight.
fn biweight(x: f64) -> f64 {
    (1.0 - x * x).max(0.0).powi(2)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;
    use crate::probe::rim::XorShift;

    const CENTRE: DVec2 = DVec2::new(300.3, 299.6);
    const RADIUS: f64 = 250.2;

    fn edge(turn: f64, out: f64) -> Edge {
        let way = DVec2::from_angle(turn);
        Edge { at: CENTRE + way * (RADIUS + out), towards: way, strength: 0.1 }
    }

    /// A rim that is not seen over a third of it, where a squeezed horizon lies 1.7 px further in, and
    /// texture along a sixth of it.
    fn edges(scatter: f64, seed: u64) -> Vec<Edge> {
        let mut random = XorShift(seed);
        let mut edges = Vec::new();
        for k in 0..720 {
            let turn = f64::from(k) / 720.0 * 2.0 * PI;
            let degrees = turn.to_degrees();
            let off = scatter * 2.0 * (random.uniform() + random.uniform() - 1.0);
            if (60.0..180.0).contains(&degrees) {
                edges.push(edge(turn, -1.7 - ((degrees - 120.0) / 40.0).powi(4) + 0.3 * off));
            } else if (200.0..260.0).contains(&degrees) {
                for _ in 0..3 {
                    edges.push(edge(turn, 24.0 * (random.uniform() - 0.5)));
                }
            } else {
                edges.push(edge(turn, off));
            }
        }
        edges
    }

    #[test]
    fn a_squeezed_horizon_does_not_pull_the_rim_in() {
        let start = |x: f64, y: f64, r: f64| Circle {
            centre: CENTRE + DVec2::new(x, y),
            radius: RADIUS + r,
            support: 1.0,
            background: 0.0,
            visible: 1.0,
        };
        for (seed, start) in [start(0.2, 1.3, -0.4), start(-3.2, 1.4, -2.8), start(2.0, -2.0, 3.0)]
            .iter()
            .enumerate()
        {
            for scatter in [0.05, 0.1, 0.2] {
                let edges = edges(scatter, 0x1234_5678_9abc_def1 + seed as u64);
                let ring = find(&edges, start).unwrap();
                let off = (ring.centre - CENTRE).length().max((ring.radius - RADIUS).abs());
                assert!(off < 0.05, "{scatter}: {off} px at width {}", ring.width);
                assert!(ring.points(&edges).len() > 180);
            }
        }
        assert!(find(&edges(0.1, 5)[..11], &start(0.0, 0.0, 0.0)).is_none());
    }

    #[test]
    fn a_rim_that_the_frame_cuts_is_met_as_narrowly() {
        let half: Vec<Edge> = edges(0.1, 77)
            .into_iter()
            .filter(|edge| (edge.at - CENTRE).to_angle().abs() < 60f64.to_radians())
            .collect();
        let start = Circle {
            centre: CENTRE + DVec2::new(1.5, -1.0),
            radius: RADIUS - 1.0,
            support: 1.0,
            background: 0.0,
            visible: 1.0 / 3.0,
        };
        let ring = find(&half, &start).unwrap();
        let off = (ring.centre - CENTRE).length().max((ring.radius - RADIUS).abs());
        assert!(off < 0.15 && ring.width < 0.2, "{off} px at width {}", ring.width);
    }

    /// Texture alone: no circle is agreed on, and none more widely than edges are looked for. (Where edges
    /// lie closer still, other radii have as many, and the circle's score is low.)
    #[test]
    fn texture_agrees_on_little_of_any_circle() {
        for (radius, seed) in [(30.0, 3), (60.0, 4), (250.0, 5)] {
            let mut random = XorShift(0x1234_5678_9abc_def1 ^ (seed << 20));
            let start =
                Circle { centre: CENTRE, radius, support: 1.0, background: 0.0, visible: 1.0 };
            // An edge in every 100 pixels of the band.
            let edges: Vec<Edge> = (0..(2.0 * PI * radius * 0.4 * radius / 100.0) as usize)
                .map(|_| {
                    let way = DVec2::from_angle(2.0 * PI * random.uniform());
                    let out = radius * (0.8 + 0.4 * random.uniform());
                    Edge { at: CENTRE + way * out, towards: way, strength: 0.1 }
                })
                .collect();
            // Small circles have too few edges for any.
            let Some(ring) = find(&edges, &start) else { continue };
            assert!(ring.agreement < 0.3, "{radius} px: {}", ring.agreement);
            assert!(KERNEL * ring.width <= REACH * radius, "{radius} px: {}", ring.width);
        }
    }

    #[test]
    fn a_blurred_rim_is_met_by_a_wider_agreement() {
        let start = Circle {
            centre: CENTRE + 2.0,
            radius: RADIUS - 2.0,
            support: 1.0,
            background: 0.0,
            visible: 1.0,
        };
        for (scatter, widest) in [(0.1, 0.15), (0.5, 0.6), (2.0, 1.2)] {
            let mut random = XorShift(0x9e37_79b9_7f4a_7c15);
            let edges: Vec<Edge> = (0..720)
                .map(|k| {
                    let off = scatter * (random.uniform() + random.uniform() - 1.0);
                    edge(f64::from(k) / 720.0 * 2.0 * PI, off)
                })
                .collect();
            let ring = find(&edges, &start).unwrap();
            let off = (ring.centre - CENTRE).length().max((ring.radius - RADIUS).abs());
            // A start for the fit of the cone, which takes all points.
            assert!(off < 0.15 * scatter + 0.01, "{scatter}: {off} px");
            assert!(ring.width <= widest, "{scatter}: {}", ring.width);
        }
    }
}
