//! Where a sun stands, to a tenth of a degree, from the edges of real shadows in the plate.
//!
//! A mirror ball shows the sun as two pixels that clip: it is known to a fifth of a degree, by what the rim
//! is off and which pixels it happened to touch. The edge of a shadow five metres from what throws it moves by a
//! centimetre when the sun moves by that much. So: for directions round the one from the probe, the share V of
//! the sun's disc that each place near a modelled shadow's edge sees; the direction is the one with which
//!
//! `Σ e²/(e² + ¼²)`, `e = (L/m − 1 − (q − 1) V) / (q − 1)`
//!
//! (Geman and McClure 1987) and the probe's own word are likeliest together, with q how much brighter the
//! support is in the sun than out of it and m the colour of its tile. Seams and stains are far off in any case
//! and weigh no more than they must. One straight edge says nothing of directions along it; there the probe's
//! word stands. What is returned is the mean over all directions by their likelihood.
//!
//! The error holds the scatter over parts of the shadow and half a pixel of pose. It does not hold how well the
//! things that throw the shadow were measured.

use std::f64::consts::PI;

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use super::clipped::Stage;
use super::support_grid::{SupportGrid, SupportSample, median_radiance};
use crate::conventions::luminance;

/// A sun's direction, by probe and plate together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SunPlace {
    /// Unit, world.
    pub direction: DVec3,
    /// Standard error, both ways together, radians.
    pub sigma_rad: f64,
    /// Angle to the direction from the probe, radians.
    pub moved_rad: f64,
    /// Samples of the plate near shadow edges.
    pub places: usize,
}

/// What the plate's shadows say of a direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ShadowEdges {
    /// No modelled shadow edge on the support, or too little of one.
    Unseen,
    Found(SunPlace),
    /// The shadows fall at least this far (radians) from where the probe's sun throws them.
    Elsewhere(f64),
}

/// The sun is looked for this many σ round its direction from the probe.
const SIGMAS: f64 = 3.0;
/// Steps between directions that are tried: 0.05°.
const STEP_RAD: f64 = 8.7e-4;
/// Most steps each way: 1.5°.
const MOST_STEPS: i32 = 30;
/// Rays across a sun's radius.
const RAYS_ACROSS_RADIUS: f64 = 3.0;
/// Fewer samples near edges than this say nothing.
const FEWEST: usize = 150;
/// Samples that a tile needs: its median is the colour that it is compared with.
const FEWEST_IN_TILE: usize = 12;
/// Samples this near each other, px in a plate of [`PLATE_PX`], share their pattern: they count as one.
const ALIKE_PX: f64 = 10.0;
/// Longer plates are sampled more thinly, as many samples in all.
const PLATE_PX: usize = 1000;
/// Side of a tile, px in such a plate.
const TILE_PX: usize = 60;
/// So many steps at the end of what is looked through, and this share of the likelihood in them, mean that the
/// sun is not there.
const OUTER_STEPS: i32 = 2;
const OUTER_SHARE: f64 = 0.25;
/// A sample that is off by more than this share of the sun's light is a seam or a stain.
const OUTLYING: f64 = 0.25;
/// Parts of the shadow that are left out in turns.
const PARTS: usize = 8;
/// Error of the pose where shadows fall, px (a board or tag gives about this).
const SIGMA_POSE_PX: f64 = 0.5;

/// Looks for the sun round `direction` (unit, world), which the probe gives with a standard error of
/// `sigma_rad` each way.
pub fn by_shadow_edges(
    stage: &Stage,
    direction: DVec3,
    sigma_rad: f64,
    half_angle_rad: f64,
) -> ShadowEdges {
    let Some(contrast) = contrast(&SupportGrid::sample(stage, direction)) else {
        return ShadowEdges::Unseen;
    };
    let step_px = stage.plate.width().max(stage.plate.height()).div_ceil(PLATE_PX);
    let grid = SupportGrid::sample_every(stage, direction, step_px);
    let steps = ((SIGMAS * sigma_rad / STEP_RAD).ceil() as i32).clamp(2, MOST_STEPS);
    let sky = SkyPatch::new(direction, half_angle_rad, f64::from(steps) * STEP_RAD);
    let tiles: Vec<Vec<Place>> = grid.tiles(TILE_PX).map(|tile| sky.places(stage, &tile)).collect();
    let tiles: Vec<Vec<Place>> =
        tiles.into_iter().filter(|places| places.len() >= FEWEST_IN_TILE).collect();
    let places: usize = tiles.iter().map(Vec::len).sum();
    if places < FEWEST {
        return ShadowEdges::Unseen;
    }
    let search = Search::new(&sky, &tiles, contrast, steps, sigma_rad);
    let all: Vec<usize> = (0..tiles.len()).collect();
    let Some((best, spread)) = search.likeliest(&all) else {
        return ShadowEdges::Elsewhere(f64::from(steps) * STEP_RAD);
    };
    let without = (0..PARTS).filter_map(|part| {
        let of_part = |k: usize| k * PARTS / tiles.len() == part;
        let rest: Vec<usize> = all.iter().copied().filter(|&k| !of_part(k)).collect();
        (rest.len() < all.len() && !rest.is_empty())
            .then(|| search.likeliest(&rest).map_or(best, |r| r.0))
    });
    let without: Vec<DVec2> = without.collect();
    let n = without.len() as f64;
    let mean = without.iter().sum::<DVec2>() / n;
    let scatter =
        without.iter().map(|offset| offset.distance_squared(mean)).sum::<f64>() * (n - 1.0) / n;
    let pose = 2.0 * sky.pixel_rad(stage, &tiles).powi(2) * SIGMA_POSE_PX.powi(2);
    ShadowEdges::Found(SunPlace {
        direction: sky.direction(best),
        // One part alone says nothing of the scatter.
        sigma_rad: (if n > 1.0 { scatter } else { 0.0 } + spread + pose).sqrt(),
        moved_rad: best.length(),
        places,
    })
}

/// How many times brighter the support is in the sun than in modelled shadows; `None` without such.
fn contrast(grid: &SupportGrid) -> Option<f64> {
    let ratios = grid.split_tiles().into_iter().filter_map(|[lit, shadowed]| {
        let brightness = |side: &[SupportSample]| Some(luminance(median_radiance(side)?.as_vec3()));
        Some(f64::from(brightness(&lit)? / brightness(&shadowed)?))
    });
    let mut ratios: Vec<f64> = ratios.filter(|ratio| ratio.is_finite()).collect();
    ratios.sort_by(f64::total_cmp);
    // An edge fainter than this drowns in the support's pattern.
    ratios.get(ratios.len() / 2).copied().filter(|&ratio| ratio > 1.3)
}

/// A sample near a shadow's edge: its luminance, and which rays to the patch of sky get through.
struct Place {
    sample: SupportSample,
    brightness: f64,
    free: Vec<bool>,
}

/// Directions round the probe's sun, in angles along two tangents.
struct SkyPatch {
    towards: DVec3,
    tangents: [DVec3; 2],
    half_angle_rad: f64,
    /// Rays go out in a square of 2 · reach + 1, this far apart.
    spacing_rad: f64,
    reach: i32,
}

impl SkyPatch {
    fn new(towards: DVec3, half_angle_rad: f64, span_rad: f64) -> Self {
        let (x, y) = towards.any_orthonormal_pair();
        let spacing_rad = half_angle_rad / RAYS_ACROSS_RADIUS;
        let reach = ((span_rad + half_angle_rad) / spacing_rad).ceil() as i32;
        Self { towards, tangents: [x, y], half_angle_rad, spacing_rad, reach }
    }

    fn direction(&self, offset: DVec2) -> DVec3 {
        (self.towards + self.tangents[0] * offset.x + self.tangents[1] * offset.y).normalize()
    }

    /// Offsets of all rays, row by row.
    fn rays(&self) -> impl Iterator<Item = DVec2> + '_ {
        let line = -self.reach..=self.reach;
        line.clone().flat_map(move |j| {
            line.clone().map(move |i| DVec2::new(f64::from(i), f64::from(j)) * self.spacing_rad)
        })
    }

    /// The samples of a tile from which some of the patch is hidden and some is not.
    fn places(&self, stage: &Stage, tile: &[SupportSample]) -> Vec<Place> {
        let sees = |sample: &SupportSample, offset: DVec2| {
            stage.sees_sun(sample.point, sample.normal, self.direction(offset))
        };
        let wide = f64::from(self.reach) * self.spacing_rad;
        let probed: Vec<DVec2> = (0..25)
            .map(|k| DVec2::new(f64::from(k % 5) - 2.0, f64::from(k / 5) - 2.0) * 0.5 * wide)
            .collect();
        let near_edge = tile.par_iter().filter(|sample| {
            let free = probed.iter().filter(|&&offset| sees(sample, offset)).count();
            free > 0 && free < probed.len()
        });
        let places = near_edge.filter_map(|sample| {
            let brightness = f64::from(luminance(sample.radiance));
            let free = self.rays().map(|offset| sees(sample, offset)).collect();
            (brightness > 0.0).then_some(Place { sample: *sample, brightness, free })
        });
        places.collect()
    }

    /// Which rays go to a disc round `offset`, with their weights: those on its rim count by half.
    fn disc(&self, offset: DVec2) -> Vec<(usize, f64)> {
        let weighed = self.rays().enumerate().map(|(i, ray)| {
            let outside = (ray.distance(offset) - self.half_angle_rad) / self.spacing_rad;
            (i, (0.5 - outside).clamp(0.0, 1.0))
        });
        weighed.filter(|(_, weight)| *weight > 0.0).collect()
    }

    /// By how much the sun must move for a shadow's edge to move by one pixel: the median, radians.
    fn pixel_rad(&self, stage: &Stage, tiles: &[Vec<Place>]) -> f64 {
        let per_pixel = 1.0 / stage.camera.lens.fx;
        let angles = tiles.iter().flatten().filter_map(|place| {
            let hidden = self.rays().zip(&place.free).find(|(_, free)| !**free)?.0;
            let SupportSample { point, normal, .. } = place.sample;
            let thrown = stage.distance_to_shade(point, normal, self.direction(hidden))?;
            Some(per_pixel * point.distance(stage.camera.pose.position()) / thrown.max(1e-6))
        });
        let mut angles: Vec<f64> = angles.collect();
        angles.sort_by(f64::total_cmp);
        angles.get(angles.len() / 2).copied().unwrap_or(0.0)
    }
}

/// What every tile says of every direction.
struct Search {
    steps: i32,
    sigma_rad: f64,
    /// So many samples count as one.
    alike: f64,
    /// Of each tile, what its samples are off for each direction, row by row.
    costs: Vec<Vec<f64>>,
    places: Vec<usize>,
}

impl Search {
    fn new(
        sky: &SkyPatch,
        tiles: &[Vec<Place>],
        contrast: f64,
        steps: i32,
        sigma_rad: f64,
    ) -> Self {
        let line = -steps..=steps;
        let offsets: Vec<DVec2> = line
            .clone()
            .flat_map(|j| {
                line.clone().map(move |i| DVec2::new(f64::from(i), f64::from(j)) * STEP_RAD)
            })
            .collect();
        let discs: Vec<Vec<(usize, f64)>> = offsets.par_iter().map(|&o| sky.disc(o)).collect();
        let costs = tiles
            .par_iter()
            .map(|tile| discs.iter().map(|disc| cost(tile, disc, contrast)).collect::<Vec<f64>>());
        let costs = costs.collect();
        Self {
            steps,
            sigma_rad,
            alike: ALIKE_PX * ALIKE_PX,
            costs,
            places: tiles.iter().map(Vec::len).collect(),
        }
    }

    /// The mean offset by these tiles and the probe, and its variance both ways together, rad²; `None` if much
    /// of the likelihood lies at the end of what is looked through.
    fn likeliest(&self, tiles: &[usize]) -> Option<(DVec2, f64)> {
        let n_across = 2 * self.steps as usize + 1;
        let n = n_across * n_across;
        let sums: Vec<f64> =
            (0..n).map(|i| tiles.iter().map(|&tile| self.costs[tile][i]).sum()).collect();
        let places: usize = tiles.iter().map(|&tile| self.places[tile]).sum();
        let least = sums.iter().copied().fold(f64::INFINITY, f64::min).max(1e-6);
        // The best direction says how far off samples are that are right.
        let width = 2.0 * least * self.alike / places as f64;
        let step = |k: usize| k as i32 - self.steps;
        let offset = |i: usize| {
            DVec2::new(f64::from(step(i % n_across)), f64::from(step(i / n_across))) * STEP_RAD
        };
        let value =
            |i: usize| sums[i] / width + 0.5 * offset(i).length_squared() / self.sigma_rad.powi(2);
        let best = (0..n).map(value).fold(f64::INFINITY, f64::min);
        let weights: Vec<f64> = (0..n).map(|i| (best - value(i)).exp()).collect();
        let all: f64 = weights.iter().sum();
        let outer = |i: &usize| {
            step(i % n_across).abs().max(step(i / n_across).abs()) >= self.steps - OUTER_STEPS
        };
        if (0..n).filter(outer).map(|i| weights[i]).sum::<f64>() > OUTER_SHARE * all {
            return None;
        }
        let mean = (0..n).map(|i| offset(i) * weights[i]).sum::<DVec2>() / all;
        let spread = (0..n).map(|i| offset(i).distance_squared(mean) * weights[i]).sum::<f64>();
        Some((mean, spread / all))
    }
}

/// Sum of what a tile's samples are off, once its own colour and the sun's visible share are taken out.
fn cost(tile: &[Place], disc: &[(usize, f64)], contrast: f64) -> f64 {
    let whole: f64 = disc.iter().map(|(_, weight)| weight).sum();
    let lit = |place: &Place| {
        let seen = disc.iter().filter(|(ray, _)| place.free[*ray]).map(|(_, weight)| weight);
        1.0 + (contrast - 1.0) * seen.sum::<f64>() / whole
    };
    let lit: Vec<f64> = tile.iter().map(lit).collect();
    let mut colours: Vec<f64> =
        tile.iter().zip(&lit).map(|(place, lit)| place.brightness / lit).collect();
    let middle = colours.len() / 2;
    let colour = *colours.select_nth_unstable_by(middle, f64::total_cmp).1;
    let off = tile.iter().zip(&lit).map(|(place, lit)| {
        let share = (place.brightness / colour - lit) / (contrast - 1.0);
        share * share / (share * share + OUTLYING * OUTLYING)
    });
    off.sum()
}

/// Standard error each way of the direction to a clipped light that covers `solid_angle` of a map
/// `map_width` texels wide: which pixels it happened to touch, and uneven glare round it.
pub fn sigma_of_clipped(solid_angle: f64, map_width: usize) -> f64 {
    0.3 * (solid_angle / PI).sqrt() + 0.25 * 2.0 * PI / map_width as f64
}

#[cfg(test)]
mod tests {
    use super::super::test_yard::{CARD, camera, photograph, sky, yard};
    use super::*;
    use crate::conventions::SUN_HALF_ANGLE_RAD;
    use crate::photo::Image;
    use crate::scene::{Mesh, Scene};
    use crate::trace::Accel;

    /// 0.3° each way.
    const SIGMA_RAD: f64 = 5.2e-3;

    fn sun() -> DVec3 {
        DVec3::new(-0.25, 1.0, 0.1).normalize()
    }

    /// What the photograph of a yard in the true sun says of one `off` from it.
    fn looked(scene: &Scene, card: [f32; 2], off: DVec3) -> (DVec3, ShadowEdges) {
        let meshes: Vec<&Mesh> = scene.local.iter().map(|l| &l.mesh).collect();
        let plate = photograph(&camera(), sun(), 0.3, card);
        let stage = Stage {
            plate: &plate,
            clipped: &Image::filled(plate.width(), plate.height(), false),
            camera: &camera(),
            panorama: &sky(),
            scene,
            local: &Accel::build(&meshes),
            support_albedo: None,
        };
        let said = (sun() + off).normalize();
        (said, by_shadow_edges(&stage, said, SIGMA_RAD, SUN_HALF_ANGLE_RAD))
    }

    #[test]
    fn the_edges_of_a_shadow_put_the_sun_in_its_place() {
        for off in [DVec3::ZERO, DVec3::new(4e-3, 0.0, -5e-3), DVec3::new(-6e-3, 2e-3, 3e-3)] {
            let (said, found) = looked(&yard(CARD), CARD, off);
            let ShadowEdges::Found(place) = found else { panic!("{found:?}") };
            let left = place.direction.angle_between(sun());
            // A pixel of this camera is 0.15° of the sun's way; 0.05° is a third of one.
            assert!(
                left < 9e-4,
                "{:.3}° left of {:.3}°",
                left.to_degrees(),
                said.angle_between(sun()).to_degrees()
            );
            assert!(left < 3.0 * place.sigma_rad && place.sigma_rad < 3e-3, "{place:?}");
            assert!((place.moved_rad - place.direction.angle_between(said)).abs() < 1e-4);
        }
    }

    #[test]
    fn along_a_straight_edge_the_probe_has_the_word() {
        // A strip along z: its shadow tells nothing of the sun's way along z.
        let card = [0.35, 3.9];
        let off = DVec3::new(4e-3, 0.0, 5e-3);
        let (said, found) = looked(&yard(card), card, off);
        let ShadowEdges::Found(place) = found else { panic!("{found:?}") };
        // Across, in the plane of the edge's normal.
        let slope = |d: DVec3| d.x / d.y;
        assert!((slope(place.direction) - slope(sun())).abs() < 1.5e-3, "{}", place.direction);
        assert!((place.direction.z - said.z).abs() < 1.5e-3, "{} of {said}", place.direction);
        assert!(place.sigma_rad > 0.7 * SIGMA_RAD, "{place:?}");
    }

    #[test]
    fn without_an_edge_nothing_is_said_and_shadows_elsewhere_are_told() {
        let mut bare = yard(CARD);
        bare.local.truncate(1);
        assert_eq!(looked(&bare, CARD, DVec3::ZERO).1, ShadowEdges::Unseen);
        let (_, found) = looked(&yard(CARD), CARD, DVec3::new(0.02, 0.0, 0.0));
        assert!(matches!(found, ShadowEdges::Elsewhere(least) if least > 0.015), "{found:?}");
    }
}
