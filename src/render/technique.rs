//! What the coupled estimator does in one way where there are others: plain choices that a job carries.
//!
//! The default is what `auto` takes. The others are what `platelight chart` sets beside it: each of the
//! estimator's improvements switched off alone, textbook sampling strategies, short paths and lists of
//! directional lights. Those that change only the noise say so; the others say what they leave out.

use super::coupled::MAX_DEPTH;
use crate::light::Draws;

/// Edges that a path among objects may have beyond [`MAX_DEPTH`], to get out of glass.
const MORE_AMONG_OBJECTS: u32 = 5;

/// Least GGX α of reflections by [`Caustics::Soft`].
pub const SOFT_ALPHA: f32 = 0.25;
/// A direction drawn with less than this density, per steradian, was scattered widely: by Lambert's
/// law it is at most 1/π.
pub const WIDE_PDF: f32 = 0.5;

/// Choices of the coupled estimator.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Technique {
    /// How lights are drawn; changes the noise alone. Two-pass methods follow it too.
    pub draws: Draws,
    /// Whether local points look toward the objects' bounds as well as along their BSDF; changes the
    /// noise alone.
    pub cones: bool,
    /// Whether matt local points look evenly over their hemisphere instead of by the cosine; changes the
    /// noise alone.
    pub evenly: bool,
    pub blocked: Blocked,
    pub caustics: Caustics,
    /// Longest path in edges after the camera's first; shorter ones leave out light that is reflected
    /// more often.
    pub max_depth: u32,
    /// The same for paths from object to object.
    pub max_object_depth: u32,
}

/// How the far light is found that objects keep from matt points which the camera sees.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Blocked {
    /// Cells under soft light, draws under suns and lamps.
    #[default]
    Auto,
    /// By the same draws as everything else.
    Draws,
    /// By draws over cells of the lights.
    Cells,
    /// As from about this many equal patches of the map: biased, see [`LightSet`].
    ///
    /// [`LightSet`]: crate::light::LightSet
    Patches(u32),
    /// As from this many lights by median cut: biased.
    MedianCut(u32),
}

/// How reflections are treated that only a path finds which has been scattered widely before: the sun
/// seen by the ground in a vase.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Caustics {
    /// Reflecting lobes sharper than α = 0.25 are widened to that, with all their light. A focused
    /// pattern comes out blurred, and no sample hits the sun by chance (path space regularisation,
    /// Kaplanyan and Dachsbacher 2013, with a constant width).
    #[default]
    Soft,
    /// As they are, found by chance.
    Exact,
}

impl Default for Technique {
    fn default() -> Self {
        Self {
            draws: Draws::AsMade,
            cones: true,
            evenly: false,
            blocked: Blocked::Auto,
            caustics: Caustics::Soft,
            max_depth: MAX_DEPTH,
            max_object_depth: MAX_DEPTH + MORE_AMONG_OBJECTS,
        }
    }
}

impl Technique {
    /// Paths of at most `edges` edges: 1 is blocked light and objects lit directly as the camera sees
    /// them, 2 adds what such objects send to local surfaces.
    pub fn up_to_depth(edges: u32) -> Self {
        Self { max_depth: edges, max_object_depth: edges, ..Self::default() }
    }

    /// One textbook strategy for far light: draws of one kind, no help from cones or cells.
    pub fn plain(draws: Draws) -> Self {
        Self { draws, cones: false, blocked: Blocked::Draws, ..Self::default() }
    }

    /// True if only the noise differs from the default's.
    pub fn only_noise_differs(&self) -> bool {
        let Self { max_depth, max_object_depth, .. } = Self::default();
        let whole = self.max_depth >= max_depth && self.max_object_depth >= max_object_depth;
        let same = whole && self.caustics == Caustics::default();
        same && !matches!(self.blocked, Blocked::Patches(_) | Blocked::MedianCut(_))
    }
}
