//! The support as the plate shows it: a grid of samples, in the light of a sun or in its shadow.
//!
//! plate + camera + local scene → [`SupportGrid`]. Which sample is lit is geometry alone; the plate
//! gives its radiance. Samples near a shadow's edge are left out, where the penumbra and the error of
//! the pose would mix the two.

use glam::{DVec2, DVec3};

use super::clipped::Stage;
use super::median::median_per_channel;
use crate::conventions::Rgb;
use crate::photo::Image;
use crate::scene::LocalRole;
use crate::trace::Ray;

/// Plate pixels between two samples of the support.
const GRID_STEP_PX: usize = 3;
/// A sample counts as lit or shadowed only if all its grid neighbours this far agree: keeps the
/// penumbra and the error of the pose out.
const AGREEING_NEIGHBOURS: usize = 2;
/// Grid samples along the side of a tile in which lit and shadowed samples are compared: near
/// enough to be the same material, large enough to average its texture.
const TILE_SAMPLES: usize = 20;
/// Tiles overlap by half: each sample is in so many of them, and so many say no more than one.
pub(super) const TILES_OF_A_SAMPLE: f64 = 4.0;
/// Samples of each kind that a tile needs.
const TILE_QUORUM: usize = 24;

/// A support point seen by a plate pixel.
#[derive(Clone, Copy)]
pub(super) struct SupportSample {
    pub point: DVec3,
    pub normal: DVec3,
    pub radiance: Rgb,
    pub lit: bool,
}

/// The support as the plate shows it, every [`GRID_STEP_PX`]-th pixel.
pub(super) struct SupportGrid {
    samples: Image<Option<SupportSample>>,
}

impl SupportGrid {
    pub fn sample(stage: &Stage, sun: DVec3) -> Self {
        Self::sample_every(stage, sun, GRID_STEP_PX)
    }

    pub fn sample_every(stage: &Stage, sun: DVec3, step_px: usize) -> Self {
        let width = stage.plate.width().div_ceil(step_px);
        let height = stage.plate.height().div_ceil(step_px);
        let samples = Image::from_fn(width, height, |i, j| {
            let (x, y) = (i * step_px, j * step_px);
            if stage.clipped[(x, y)] {
                return None;
            }
            let (origin, direction) = stage.camera.ray(DVec2::new(x as f64, y as f64))?;
            let ray = Ray {
                origin: (origin - stage.scene.origin).as_vec3(),
                direction: direction.as_vec3(),
                t_min: 0.0,
                t_max: f32::INFINITY,
            };
            let hit = stage.local.closest(&ray)?;
            if stage.scene.local[hit.mesh as usize].role != LocalRole::Support {
                return None;
            }
            let normal = stage.normal(&hit)?;
            let normal = if normal.dot(direction) > 0.0 { -normal } else { normal };
            let point = origin + direction * f64::from(hit.t);
            let lit = stage.sees_sun(point, normal, sun);
            Some(SupportSample { point, normal, radiance: stage.plate[(x, y)], lit })
        });
        Self { samples }
    }

    /// The sample at grid place (i, j) if every neighbour within [`AGREEING_NEIGHBOURS`] is the
    /// support too and is lit, or not, alike.
    fn settled(&self, i: usize, j: usize) -> Option<SupportSample> {
        let sample = (*self.samples.get(i, j)?)?;
        let reach = AGREEING_NEIGHBOURS as isize;
        for dj in -reach..=reach {
            for di in -reach..=reach {
                let (x, y) = (i.checked_add_signed(di)?, j.checked_add_signed(dj)?);
                if (*self.samples.get(x, y)?)?.lit != sample.lit {
                    return None;
                }
            }
        }
        Some(sample)
    }

    /// All settled samples in the light.
    pub fn lit(&self) -> Vec<SupportSample> {
        let mut lit = Vec::new();
        for j in 0..self.samples.height() {
            for i in 0..self.samples.width() {
                lit.extend(self.settled(i, j).filter(|sample| sample.lit));
            }
        }
        lit
    }

    /// All samples of each tile of `side` samples across, near edges too.
    pub fn tiles(&self, side: usize) -> impl Iterator<Item = Vec<SupportSample>> + '_ {
        let tops = (0..self.samples.height()).step_by(side);
        let corners = tops.flat_map(move |top| {
            (0..self.samples.width()).step_by(side).map(move |left| (left, top))
        });
        corners.map(move |(left, top)| {
            let rows = top..top + side;
            let at = rows.flat_map(|j| (left..left + side).map(move |i| (i, j)));
            at.filter_map(|(i, j)| *self.samples.get(i, j)?).collect()
        })
    }

    /// Lit and shadowed settled samples of each tile that holds enough of both.
    ///
    /// Tiles overlap by half, so that it matters less where their borders happen to cut a pattern.
    pub fn split_tiles(&self) -> Vec<[Vec<SupportSample>; 2]> {
        let mut tiles = Vec::new();
        for top in (0..self.samples.height()).step_by(TILE_SAMPLES / 2) {
            for left in (0..self.samples.width()).step_by(TILE_SAMPLES / 2) {
                let mut tile = [Vec::new(), Vec::new()];
                for j in top..top + TILE_SAMPLES {
                    for i in left..left + TILE_SAMPLES {
                        if let Some(sample) = self.settled(i, j) {
                            tile[usize::from(!sample.lit)].push(sample);
                        }
                    }
                }
                if tile.iter().all(|samples| samples.len() >= TILE_QUORUM) {
                    tiles.push(tile);
                }
            }
        }
        tiles
    }
}

/// Per-channel median radiance; `None` of no samples.
pub(super) fn median_radiance(samples: &[SupportSample]) -> Option<DVec3> {
    let colours: Vec<Rgb> = samples.iter().map(|sample| sample.radiance).collect();
    median_per_channel(&colours).map(|median| median.as_dvec3())
}
