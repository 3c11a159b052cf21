//! The demo's own camera: a pinhole with Brown–Conrady distortion, written apart from the library.
//!
//! World and pixel conventions are the project's (`docs/conventions.md`): +Y up, the camera looks
//! along its −Z, the centre of the top-left pixel is (0, 0).

use glam::{DVec2, DVec3};

/// Focal length and principal point in pixels of the full frame, and OpenCV's five coefficients.
#[derive(Clone, Copy)]
pub struct Lens {
    pub focal: DVec2,
    pub centre: DVec2,
    pub k: [f64; 3],
    pub p: [f64; 2],
}

impl Lens {
    /// Where a point at (x, y) on the plane one unit before an ideal pinhole lands on that plane.
    pub fn distort(&self, ideal: DVec2) -> DVec2 {
        let (x, y) = (ideal.x, ideal.y);
        let r2 = ideal.length_squared();
        let radial = 1.0 + r2 * (self.k[0] + r2 * (self.k[1] + r2 * self.k[2]));
        DVec2::new(
            x * radial + 2.0 * self.p[0] * x * y + self.p[1] * (r2 + 2.0 * x * x),
            y * radial + self.p[0] * (r2 + 2.0 * y * y) + 2.0 * self.p[1] * x * y,
        )
    }

    /// Inverse of [`Lens::distort`] by fixed-point steps; they shrink the error about 10× each here.
    fn undistort(&self, seen: DVec2) -> DVec2 {
        let mut ideal = seen;
        for _ in 0..11 {
            ideal += seen - self.distort(ideal);
        }
        ideal
    }

    /// The lens of a cut-out: `scale` times the full frame, its pixel (0, 0) at (x, y) there.
    pub fn cropped(&self, x: f64, y: f64, scale: f64) -> Self {
        let centre = (self.centre + 0.5) * scale - 0.5 - DVec2::new(x, y);
        Self { focal: self.focal * scale, centre, ..*self }
    }
}

/// A lens somewhere in the world.
#[derive(Clone, Copy)]
pub struct View {
    pub lens: Lens,
    pub width: usize,
    pub height: usize,
    pub position: DVec3,
    /// Unit, world: the picture's right, its up, and where the camera looks.
    pub right: DVec3,
    pub up: DVec3,
    pub forward: DVec3,
}

impl View {
    /// Looks from `position` to `target`, tilted by `roll_rad` (clockwise seen from behind).
    pub fn look_at(
        lens: Lens,
        width: usize,
        height: usize,
        position: DVec3,
        target: DVec3,
        roll_rad: f64,
    ) -> Self {
        let forward = (target - position).normalize();
        let level = forward.cross(DVec3::Y).normalize();
        let right = level * roll_rad.cos() - level.cross(forward) * roll_rad.sin();
        Self { lens, width, height, position, right, up: right.cross(forward), forward }
    }

    /// Unit direction, in the world, that is seen at `pixel`.
    pub fn direction(&self, pixel: DVec2) -> DVec3 {
        let p = self.lens.undistort((pixel - self.lens.centre) / self.lens.focal);
        (self.right * p.x - self.up * p.y + self.forward).normalize()
    }

    /// The pixel at which the world point `p` is seen; it must be before the camera.
    pub fn project(&self, p: DVec3) -> DVec2 {
        let v = p - self.position;
        let ideal = DVec2::new(v.dot(self.right), -v.dot(self.up)) / v.dot(self.forward);
        self.lens.distort(ideal) * self.lens.focal + self.lens.centre
    }

    /// The view through the cut-out of [`Lens::cropped`], `size` pixels square.
    pub fn cropped(&self, x: usize, y: usize, scale: usize, size: usize) -> Self {
        let lens = self.lens.cropped(x as f64, y as f64, scale as f64);
        Self { lens, width: size, height: size, ..*self }
    }

    /// The same view with pixels `factor` times as large.
    pub fn reduced(&self, factor: usize) -> Self {
        let lens = self.lens.cropped(0.0, 0.0, 1.0 / factor as f64);
        Self { lens, width: self.width / factor, height: self.height / factor, ..*self }
    }

    /// Row-major 4 × 4 matrix that takes camera axes to the world.
    pub fn world_from_camera(&self) -> [[f64; 4]; 4] {
        let (r, u, b, t) = (self.right, self.up, -self.forward, self.position);
        [[r.x, u.x, b.x, t.x], [r.y, u.y, b.y, t.y], [r.z, u.z, b.z, t.z], [0.0, 0.0, 0.0, 1.0]]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn view() -> View {
        let lens = Lens {
            focal: DVec2::new(1180.0, 1181.0),
            centre: DVec2::new(545.0, 352.0),
            k: [-0.11, 0.05, 0.0],
            p: [4e-4, -3e-4],
        };
        View::look_at(lens, 1080, 720, DVec3::new(0.3, 0.4, 1.2), DVec3::ZERO, 0.02)
    }

    #[test]
    fn projecting_a_seen_direction_returns_to_its_pixel() {
        let view = view();
        for pixel in [DVec2::ZERO, DVec2::new(1079.0, 0.0), DVec2::new(540.0, 719.0)] {
            let point = view.position + 3.0 * view.direction(pixel);
            assert!((view.project(point) - pixel).length() < 1e-8);
        }
    }

    #[test]
    fn a_cutout_sees_what_the_frame_sees() {
        let crop = view().cropped(1200, 700, 3, 640);
        let full = DVec2::new(1200.0 + 10.0, 700.0 + 20.0);
        let frame = (full + 0.5) / 3.0 - 0.5;
        let seen = crop.direction(DVec2::new(10.0, 20.0));
        assert!((seen - view().direction(frame)).length() < 1e-12);
    }
}
