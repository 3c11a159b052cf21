//! Where a map of directions has a block of texel corners, without asking it for each.
//!
//! An exact mirror ball through a lens takes longer to look up than its light takes to gather, and over a few
//! texels is a parabola each way to a millionth of a pixel. Where it is not (poles, rims, the support's
//! horizon), the check against exact corners between the nodes fails, and the map is asked.

use glam::DVec2;

/// Corners along a block's side.
pub(super) const BLOCK: usize = 8;
/// How far the parabola may be off, px of the source.
pub(super) const SMOOTH_PX: f64 = 1e-3;

/// The map over a block: through three by three exact corners.
pub(super) struct Surface {
    /// By column, then by row: at the block's sides and in its middle.
    pub nodes: [[DVec2; 3]; 3],
}

impl Surface {
    /// Corner (`i`, `j`) of the block.
    pub fn at(&self, i: usize, j: usize) -> DVec2 {
        // Lagrange's three polynomials with nodes at 0, 1/2 and 1.
        let weights = |k: usize| {
            let t = k as f64 / BLOCK as f64;
            [(2.0 * t - 1.0) * (t - 1.0), 4.0 * t * (1.0 - t), t * (2.0 * t - 1.0)]
        };
        let between = |p: &[DVec2; 3], w: [f64; 3]| p[0] * w[0] + p[1] * w[1] + p[2] * w[2];
        let down = weights(j);
        between(&[0, 1, 2].map(|column| between(&self.nodes[column], down)), weights(i))
    }
}
