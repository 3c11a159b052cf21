//! Directional albedos of lobes: what a lobe of reflectance 1 sends back in all, tabulated once.
//!
//! Nodes are even in √μ (μ the cosine of the view), which resolves grazing views, and in roughness
//! √α. Between them values are bilinear; the tests of the lobes say how near that is.

/// Nodes along either axis.
const SIZE: usize = 32;

/// E(μ, α) on a grid.
pub struct AlbedoTable {
    /// By α, then μ.
    columns: Vec<[f32; SIZE]>,
}

impl AlbedoTable {
    /// Tabulates `albedo`, which gives E at all of the cosines for one α.
    pub fn new(albedo: impl Fn(&[f32; SIZE], f32) -> [f32; SIZE]) -> Self {
        let cosines = std::array::from_fn(|i| node(i).max(1e-4));
        Self { columns: (0..SIZE).map(|j| albedo(&cosines, node(j))).collect() }
    }

    /// E for the cosine `mu` of the view and a lobe of width `alpha`, both in 0…1.
    pub fn look_up(&self, mu: f32, alpha: f32) -> f32 {
        let (i, x) = place(mu);
        let (j, y) = place(alpha);
        let along = |column: &[f32; SIZE]| column[i] + x * (column[i + 1] - column[i]);
        let (low, high) = (along(&self.columns[j]), along(&self.columns[j + 1]));
        low + y * (high - low)
    }
}

fn node(i: usize) -> f32 {
    let t = i as f32 / (SIZE - 1) as f32;
    t * t
}

/// The node below a value and how far it lies toward the next, 0…1.
fn place(value: f32) -> (usize, f32) {
    let at = value.clamp(0.0, 1.0).sqrt() * (SIZE - 1) as f32;
    let below = (at as usize).min(SIZE - 2);
    (below, at - below as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_at_nodes_and_between_them() {
        let table = AlbedoTable::new(|mu, alpha| mu.map(|mu| mu.sqrt() + 2.0 * alpha.sqrt()));
        for (mu, alpha) in [(0.25, 0.36), (1.0, 1.0), (0.017, 0.003), (1.0, 0.0)] {
            let (got, wanted): (f32, f32) =
                (table.look_up(mu, alpha), f32::sqrt(mu) + 2.0 * f32::sqrt(alpha));
            assert!((got - wanted).abs() < 1e-5, "{mu} {alpha}: {got} for {wanted}");
        }
        assert!(table.look_up(0.0, 0.0) < 0.011 && table.look_up(2.0, -1.0) > 0.99);
    }
}
