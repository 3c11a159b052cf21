//! Cutting polygons with any number of corners into triangles.

use glam::{DVec2, DVec3};

/// Corners up to which ears are searched: the search takes their number squared and more.
const MAX_CORNERS: usize = 512;

/// Triangles (as corner numbers, wound like the polygon) that fill a polygon of three corners or
/// more, and whether every one was cut as an ear.
///
/// Ears are cut in the plane in which the polygon is largest (Newell's normal). A polygon that
/// crosses itself, is flat as a line or has too many corners is fanned from its first corner.
pub(super) fn triangulate(corners: &[DVec3]) -> (Vec<[usize; 3]>, bool) {
    let n = corners.len();
    if n == 3 {
        return (vec![[0, 1, 2]], true);
    }
    let cut = if n <= MAX_CORNERS { cut_ears(corners) } else { None };
    match cut {
        Some(triangles) => (triangles, true),
        None => ((2..n).map(|i| [0, i - 1, i]).collect(), false),
    }
}

fn cut_ears(corners: &[DVec3]) -> Option<Vec<[usize; 3]>> {
    let points = flatten(corners)?;
    let mut left: Vec<usize> = (0..points.len()).collect();
    let mut triangles = Vec::with_capacity(points.len() - 2);
    while left.len() > 3 {
        let n = left.len();
        let at = |i: usize| points[left[i % n]];
        // Start at 1: a convex quad is cut along its first diagonal (0, 2), as everybody does.
        let ear = (1..=n).map(|i| i % n).find(|&i| {
            let [a, b, c] = [at(i + n - 1), at(i), at(i + 1)];
            let others = (2..n - 1).map(|k| at(i + k));
            area(a, b, c) > 0.0 && !others.into_iter().any(|p| inside(p, a, b, c))
        })?;
        triangles.push([left[(ear + n - 1) % n], left[ear], left[(ear + 1) % n]]);
        left.remove(ear);
    }
    triangles.push([left[0], left[1], left[2]]);
    Some(triangles)
}

/// The corners in their own plane, counter-clockwise; `None` without area or finite numbers.
fn flatten(corners: &[DVec3]) -> Option<Vec<DVec2>> {
    let first = corners[0];
    let following = corners.iter().skip(1).chain([&first]);
    let normal: DVec3 =
        corners.iter().zip(following).map(|(a, b)| (a - first).cross(b - first)).sum();
    let normal = normal.try_normalize()?;
    let (x, y) = normal.any_orthonormal_pair();
    let flat = corners.iter().map(|p| DVec2::new((p - first).dot(x), (p - first).dot(y)));
    let points: Vec<DVec2> = flat.collect();
    points.iter().all(|p| p.is_finite()).then_some(points)
}

/// Twice the signed area.
fn area(a: DVec2, b: DVec2, c: DVec2) -> f64 {
    (b - a).perp_dot(c - a)
}

/// Whether `p` is in the triangle or on its border, its corners excepted.
fn inside(p: DVec2, a: DVec2, b: DVec2, c: DVec2) -> bool {
    let is_corner = p == a || p == b || p == c;
    !is_corner && area(a, b, p) >= 0.0 && area(b, c, p) >= 0.0 && area(c, a, p) >= 0.0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn total_area(corners: &[DVec3], triangles: &[[usize; 3]]) -> f64 {
        let area = |t: &[usize; 3]| {
            let [a, b, c] = t.map(|i| corners[i]);
            0.5 * (b - a).cross(c - a).length()
        };
        triangles.iter().map(area).sum()
    }

    #[test]
    fn a_convex_quad_is_cut_along_its_first_diagonal() {
        let square = [DVec3::ZERO, DVec3::X, DVec3::X + DVec3::Y, DVec3::Y];
        let (triangles, clipped) = triangulate(&square);
        assert!(clipped);
        assert!(triangles.iter().all(|t| t.contains(&0) && t.contains(&2)));
        assert_eq!(total_area(&square, &triangles), 1.0);
    }

    #[test]
    fn a_concave_polygon_keeps_its_area_whichever_corner_is_first() {
        // An L of area 3 and an arrow head of area 1, tilted in space.
        let flat_l = [(0.0, 0.0), (2.0, 0.0), (2.0, 1.0), (1.0, 1.0), (1.0, 2.0), (0.0, 2.0)];
        let arrow = [(0.0, 0.0), (2.0, 1.0), (0.0, 2.0), (1.0, 1.0)];
        for (outline, expected) in [(&flat_l[..], 3.0), (&arrow[..], 1.0)] {
            for first in 0..outline.len() {
                let mut corners: Vec<DVec3> =
                    outline.iter().map(|&(x, y)| DVec3::new(x, 0.6 * y, 0.8 * y)).collect();
                corners.rotate_left(first);
                let (triangles, clipped) = triangulate(&corners);
                assert!(clipped);
                assert_eq!(triangles.len(), outline.len() - 2);
                assert!((total_area(&corners, &triangles) - expected).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn hopeless_polygons_still_give_a_fan() {
        let bow_tie = [DVec3::ZERO, DVec3::X + DVec3::Y, DVec3::X, DVec3::Y];
        let line = [DVec3::ZERO; 5];
        let nan = [DVec3::NAN; 4];
        let circle: Vec<DVec3> =
            (0..5000).map(|i| DVec3::new((i as f64).cos(), (i as f64).sin(), 0.0)).collect();
        for corners in [&bow_tie[..], &line, &nan, &circle] {
            let (triangles, clipped) = triangulate(corners);
            assert_eq!(triangles.len(), corners.len() - 2);
            assert!(!clipped);
        }
    }
}
