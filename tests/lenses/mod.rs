//! One lens of each model, for tests inside and outside the library.

use super::{Distortion, Lens};

/// Focal lengths and centres in pixels of 960 × 640.
pub fn lenses() -> Vec<Lens> {
    let base = Lens { fx: 940.3, fy: 941.7, cx: 483.2, cy: 316.4, ..Lens::pinhole(1.0, 1, 1) };
    let with = |distortion| Lens { distortion, ..base.clone() };
    vec![
        with(Distortion::None),
        with(Distortion::BrownConrady { k1: -0.28, k2: 0.1, p1: 6e-4, p2: -4e-4, k3: -0.02 }),
        with(Distortion::Rational {
            k1: 0.3,
            k2: 0.02,
            p1: 1e-4,
            p2: -2e-4,
            k3: 0.01,
            k4: 0.5,
            k5: 0.06,
            k6: 0.01,
        }),
        Lens {
            fx: 227.4,
            fy: 226.6,
            cx: 471.4,
            cy: 305.7,
            ..with(Distortion::KannalaBrandt { k1: 0.0254, k2: -0.0026, k3: 0.0025, k4: -0.0001 })
        },
    ]
}
