//! Axis-parallel boxes.

use glam::Vec3;

/// An axis-parallel box of f32 points, in the frame of the points (mostly relative to
/// [`Scene::origin`](super::Scene::origin), metres).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    pub min: Vec3,
    pub max: Vec3,
}

impl Bounds {
    /// The box of nothing: joined with anything it gives that thing's box.
    pub const EMPTY: Self = Self { min: Vec3::INFINITY, max: Vec3::NEG_INFINITY };

    /// The smallest box that holds all points.
    pub fn of(points: impl IntoIterator<Item = Vec3>) -> Self {
        points
            .into_iter()
            .fold(Self::EMPTY, |bounds, p| Self { min: bounds.min.min(p), max: bounds.max.max(p) })
    }

    /// The smallest box that holds both.
    pub fn union(&self, other: &Self) -> Self {
        Self { min: self.min.min(other.min), max: self.max.max(other.max) }
    }

    pub fn is_empty(&self) -> bool {
        !(self.min.cmple(self.max).all())
    }

    /// Middle of the box; zero of an empty one.
    pub fn centre(&self) -> Vec3 {
        if self.is_empty() { Vec3::ZERO } else { self.min + 0.5 * (self.max - self.min) }
    }

    /// Radius of the sphere around [`Bounds::centre`] that holds the box; 0 of an empty one.
    pub fn radius(&self) -> f32 {
        0.5 * self.diameter()
    }

    /// Length of the diagonal; 0 of an empty box.
    pub fn diameter(&self) -> f32 {
        if self.is_empty() { 0.0 } else { (self.max - self.min).length() }
    }

    /// Half the surface; 0 of an empty box.
    pub fn half_area(&self) -> f32 {
        if self.is_empty() {
            return 0.0;
        }
        let d = self.max - self.min;
        d.x * d.y + d.y * d.z + d.z * d.x
    }

    /// The eight corners.
    pub fn corners(&self) -> [Vec3; 8] {
        std::array::from_fn(|i| {
            let pick =
                |axis: usize| if i >> axis & 1 == 0 { self.min[axis] } else { self.max[axis] };
            Vec3::new(pick(0), pick(1), pick(2))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_box_holds_its_points_and_nothing_has_no_size() {
        let points = [Vec3::new(1.0, 2.0, 3.0), Vec3::new(-1.0, 5.0, 3.0)];
        let bounds = Bounds::of(points);
        assert_eq!(bounds.centre(), Vec3::new(0.0, 3.5, 3.0));
        assert_eq!(bounds.half_area(), 6.0);
        assert_eq!(bounds.union(&Bounds::EMPTY), bounds);
        assert!(bounds.corners().contains(&Vec3::new(1.0, 5.0, 3.0)));
        assert!(Bounds::EMPTY.is_empty());
        assert_eq!(Bounds::EMPTY.diameter(), 0.0);
        assert_eq!(Bounds::EMPTY.centre(), Vec3::ZERO);
    }
}
