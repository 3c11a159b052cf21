//! Filling what a probe did not see from what it saw around the gap.
//!
//! Each texel of a gap becomes the mean of the gap's border, weighed by border length over distance
//! cubed: smooth, exact for constant light, blind to poles and seams, because it works
//! with angles on the sphere and not with rows and columns. The variance is the border's own scatter.

use glam::DVec3;
use rayon::prelude::*;

use super::panorama::Panorama;
use crate::bracket::Validity;
use crate::conventions::Rgb;
use crate::photo::Image;

/// More border texels than this are thinned out evenly.
const MAX_BORDER: usize = 1024;
/// Gaps with more pairs of a texel and a border texel than this are filled at every [`STEP`]-th texel of
/// every such row and smoothly between: half a sphere of 4096 × 2048 texels took a minute.
const MAX_PAIRS: usize = 1 << 30;
/// About 0.7° at the width where it is needed.
const STEP: usize = 8;

/// Fills the texels marked in `gap`, each connected gap from its own border.
pub fn from_around(panorama: &mut Panorama, gap: &Image<bool>) {
    for region in regions(gap) {
        let border = border(panorama, gap, &region);
        let filled: Vec<(Rgb, Rgb)> = if region.len() * border.len() <= MAX_PAIRS {
            let at =
                |&i: &usize| blend(&border, panorama.direction(i % gap.width(), i / gap.width()));
            region.par_iter().map(at).collect()
        } else {
            let lattice = Lattice::new(panorama, gap, &border);
            region.par_iter().map(|&i| lattice.at(i % gap.width(), i / gap.width())).collect()
        };
        for (&index, (radiance, variance)) in region.iter().zip(&filled) {
            panorama.radiance.pixels_mut()[index] = *radiance;
            panorama.variance.pixels_mut()[index] = *variance;
            panorama.validity.pixels_mut()[index] = Validity::Filled;
            panorama.coverage.pixels_mut()[index] = 0.0;
        }
    }
}

/// Connected regions of marked texels (edge neighbours; seam and poles joined), in reading order.
pub(super) fn regions(marked: &Image<bool>) -> Vec<Vec<usize>> {
    let mut seen = vec![false; marked.pixels().len()];
    let mut regions = Vec::new();
    for start in 0..seen.len() {
        if seen[start] || !marked.pixels()[start] {
            continue;
        }
        seen[start] = true;
        let mut region = vec![start];
        let mut next = 0;
        while next < region.len() {
            for neighbour in neighbours(marked, region[next]) {
                if marked.pixels()[neighbour] && !seen[neighbour] {
                    seen[neighbour] = true;
                    region.push(neighbour);
                }
            }
            next += 1;
        }
        region.sort_unstable();
        regions.push(region);
    }
    regions
}

/// The four edge neighbours of a texel; across a pole the same row half a turn away.
fn neighbours(image: &Image<bool>, index: usize) -> [usize; 4] {
    let (w, h) = (image.width(), image.height());
    let (x, y) = (index % w, index / w);
    let across = (x + w / 2) % w;
    [
        y * w + (x + 1) % w,
        y * w + (x + w - 1) % w,
        if y > 0 { (y - 1) * w + x } else { across },
        if y + 1 < h { (y + 1) * w + x } else { y * w + across },
    ]
}

struct BorderTexel {
    direction: DVec3,
    radiance: Rgb,
    /// Length of border it stands for.
    length: f64,
}

fn border(panorama: &Panorama, gap: &Image<bool>, region: &[usize]) -> Vec<BorderTexel> {
    let w = gap.width();
    let mut around: Vec<usize> =
        region.iter().flat_map(|&i| neighbours(gap, i)).filter(|&i| !gap.pixels()[i]).collect();
    around.sort_unstable();
    around.dedup();
    let stride = around.len().div_ceil(MAX_BORDER).max(1);
    around
        .iter()
        .step_by(stride)
        .map(|&i| BorderTexel {
            direction: panorama.direction(i % w, i / w),
            radiance: panorama.radiance.pixels()[i],
            length: panorama.solid_angle(i / w).sqrt(),
        })
        .collect()
}

/// Fill values at every [`STEP`]-th texel; outside the gap the panorama's own.
struct Lattice {
    columns: usize,
    width: usize,
    height: usize,
    nodes: Vec<(Rgb, Rgb)>,
}

impl Lattice {
    fn new(panorama: &Panorama, gap: &Image<bool>, border: &[BorderTexel]) -> Self {
        let (width, height) = (gap.width(), gap.height());
        let columns = width.div_ceil(STEP);
        // One row more, on the last texels, so that the lower pole has nodes of its own.
        let rows = (height - 1).div_ceil(STEP) + 1;
        let node = |k: usize| {
            let (x, y) = (k % columns * STEP, (k / columns * STEP).min(height - 1));
            match gap[(x, y)] {
                true => blend(border, panorama.direction(x, y)),
                false => (panorama.radiance[(x, y)], panorama.variance[(x, y)]),
            }
        };
        let nodes = (0..columns * rows).into_par_iter().map(node).collect();
        Self { columns, width, height, nodes }
    }

    /// Between the four nodes around a texel; columns wrap.
    fn at(&self, x: usize, y: usize) -> (Rgb, Rgb) {
        let (i, j) = (x / STEP, y / STEP);
        let part =
            |at: usize, from: usize, to: usize| (at - from) as f32 / (to - from).max(1) as f32;
        let u = part(x, i * STEP, ((i + 1) * STEP).min(self.width));
        let v = part(y, j * STEP, ((j + 1) * STEP).min(self.height - 1));
        let below = if j * STEP == self.height - 1 { j } else { j + 1 };
        let node = |i: usize, j: usize| self.nodes[j * self.columns + i % self.columns];
        let mix = |of: fn((Rgb, Rgb)) -> Rgb| {
            let across = |j: usize| of(node(i, j)).lerp(of(node(i + 1, j)), u);
            across(j).lerp(across(below), v)
        };
        (mix(|(radiance, _)| radiance), mix(|(_, variance)| variance))
    }
}

/// Weighed mean of the border as seen from `direction`, and the border's weighed variance.
fn blend(border: &[BorderTexel], direction: DVec3) -> (Rgb, Rgb) {
    let (mut sum, mut squares, mut total) = (DVec3::ZERO, DVec3::ZERO, 0.0);
    for texel in border {
        let weight = texel.length / (texel.direction - direction).length().max(1e-9).powi(3);
        let l = texel.radiance.as_dvec3();
        sum += weight * l;
        squares += weight * l * l;
        total += weight;
    }
    if total == 0.0 {
        return (Rgb::ZERO, Rgb::ZERO);
    }
    let mean = sum / total;
    (mean.as_vec3(), (squares / total - mean * mean).max(DVec3::ZERO).as_vec3())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with_cap(l: impl Fn(DVec3) -> Rgb, towards: DVec3) -> (Panorama, Image<bool>) {
        let mut panorama = Panorama::from_radiance(Image::filled(128, 64, Rgb::ZERO));
        let mut gap = Image::filled(128, 64, false);
        for y in 0..64 {
            for x in 0..128 {
                let d = panorama.direction(x, y);
                gap[(x, y)] = d.angle_between(towards) < 0.4;
                panorama.radiance[(x, y)] = if gap[(x, y)] { Rgb::splat(9e9) } else { l(d) };
            }
        }
        (panorama, gap)
    }

    #[test]
    fn gaps_at_pole_and_seam_are_filled_from_their_border_alone() {
        for towards in [DVec3::Y, DVec3::NEG_Y, DVec3::NEG_Z, DVec3::X] {
            let smooth = |d: DVec3| (d + 2.0).as_vec3();
            let (mut panorama, gap) = with_cap(smooth, towards);
            from_around(&mut panorama, &gap);
            for y in 0..64 {
                for x in 0..128 {
                    let off =
                        (panorama.radiance[(x, y)] - smooth(panorama.direction(x, y))).length();
                    assert!(off < 0.15, "{towards}: ({x}, {y}) is {off} off");
                    let filled = panorama.validity[(x, y)] == Validity::Filled;
                    assert_eq!(filled, gap[(x, y)]);
                }
            }
        }
    }

    #[test]
    fn gap_round_a_pole_is_one_region() {
        let (_, gap) = with_cap(|_| Rgb::ONE, DVec3::new(0.1, 1.0, 0.0).normalize());
        assert_eq!(regions(&gap).len(), 1);
        let all = Image::filled(8, 4, true);
        assert_eq!(regions(&all), vec![(0..32).collect::<Vec<_>>()]);
    }

    #[test]
    fn a_lattice_gives_what_every_texel_for_itself_would() {
        // Neither width nor height is a multiple of the step.
        let mut panorama = Panorama::from_radiance(Image::filled(522, 261, Rgb::ZERO));
        let mut gap = Image::filled(522, 261, false);
        for y in 0..261 {
            for x in 0..522 {
                let d = panorama.direction(x, y);
                gap[(x, y)] = d.y < 0.1;
                panorama.radiance[(x, y)] = (d + 2.0).as_vec3();
            }
        }
        let region = &regions(&gap)[0];
        let border = border(&panorama, &gap, region);
        let lattice = Lattice::new(&panorama, &gap, &border);
        for &i in region {
            let (x, y) = (i % 522, i / 522);
            let exact = blend(&border, panorama.direction(x, y)).0;
            let off = (lattice.at(x, y).0 - exact).abs().max_element();
            // The light itself differs by 0.012 from texel to texel, eight of which are a step.
            assert!(off < 0.02, "({x}, {y}) is {off} off");
        }
    }

    #[test]
    fn nothing_seen_at_all_is_black() {
        let mut panorama = Panorama::from_radiance(Image::filled(8, 4, Rgb::ONE));
        from_around(&mut panorama, &Image::filled(8, 4, true));
        assert!(panorama.radiance.pixels().iter().all(|l| *l == Rgb::ZERO));
    }
}
