//! One convention each for axes, pixels, directions, colour and light; every other room refers here.
//!
//! World: right-handed, metres, +Y up. Cameras look along their −Z with +Y up (glTF, USD);
//! OpenCV's camera frame (+Z forward, +Y down) is [`OPENCV_FROM_CAMERA`] of it and lives only in
//! `calib/` and in file formats. Pixels: OpenCV's, the centre of the top-left pixel is (0, 0).
//! Lat-long: OpenEXR's axes, texel centres at half. Colour: scene-linear Rec.709, D65.
//! The tests pin these to OpenCV, OpenEXR's ImfEnvmap.h, glTF 2.0 and USD.

use std::f64::consts::PI;

use glam::{DMat3, DVec2, DVec3, Vec3};

/// Scene-linear Rec.709 light (D65): red, green, blue in `x`, `y`, `z`.
pub type Rgb = Vec3;

/// Takes a point in our camera axes (−Z forward, +Y up) to OpenCV's (+Z forward, +Y down).
///
/// It is its own inverse.
pub const OPENCV_FROM_CAMERA: DMat3 = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));

/// Luminance weights of linear Rec.709.
pub const LUMINANCE_WEIGHTS: Rgb = Rgb::new(0.2126, 0.7152, 0.0722);

/// Relative luminance of scene-linear Rec.709 light.
pub fn luminance(l: Rgb) -> f32 {
    l.dot(LUMINANCE_WEIGHTS)
}

/// Nothing of a shot lies farther out than this along an axis, not in any survey's coordinates either,
/// metres. Products of three such lengths, which ray tests and areas are made of, are numbers in f32.
pub const FARTHEST_M: f64 = 1e9;

/// Half the angle under which the sun is seen from the Earth at its mean distance, radians.
pub const SUN_HALF_ANGLE_RAD: f64 = 0.266_5 * PI / 180.0;

/// Diagonal of the 36 × 24 mm frame, by which 35-mm equivalents of focal lengths go (CIPA DC-008).
pub const FULL_FRAME_DIAGONAL_MM: f64 = 43.266_615_305_567_87;

/// Direction (unit, world axes) of the point `pixel` of a `width` × `height` lat-long picture.
///
/// `pixel` is in pixel coordinates: texel (i, j) has its centre at (i, j). The centre column is
/// +Z, a quarter of the width is +X, the top row +Y (OpenEXR's ImfEnvmap.h axes, seen from inside).
/// Texel areas tile the sphere, where ImfEnvmap.h itself puts texel *centres* on poles and seam.
pub fn lat_long_direction(pixel: DVec2, width: usize, height: usize) -> DVec3 {
    let longitude = (0.5 - (pixel.x + 0.5) / width as f64) * 2.0 * PI;
    let latitude = (0.5 - (pixel.y + 0.5) / height as f64) * PI;
    DVec3::new(longitude.sin() * latitude.cos(), latitude.sin(), longitude.cos() * latitude.cos())
}

/// Point of a `width` × `height` lat-long picture that shows `direction` (any length but zero).
///
/// Inverse of [`lat_long_direction`]: x in [−½, width − ½), y in [−½, height − ½].
pub fn lat_long_pixel(direction: DVec3, width: usize, height: usize) -> DVec2 {
    let longitude = direction.x.atan2(direction.z);
    let latitude = direction.y.atan2(direction.x.hypot(direction.z));
    let x = (0.5 - longitude / (2.0 * PI)) * width as f64 - 0.5;
    let y = (0.5 - latitude / PI) * height as f64 - 0.5;
    DVec2::new(if x >= width as f64 - 0.5 { x - width as f64 } else { x }, y)
}

/// Solid angle (sr) of each texel in row `row` of a `width` × `height` lat-long picture: exact.
pub fn lat_long_solid_angle(row: usize, width: usize, height: usize) -> f64 {
    let top = (PI * row as f64 / height as f64).cos();
    let bottom = (PI * (row + 1) as f64 / height as f64).cos();
    2.0 * PI / width as f64 * (top - bottom)
}

/// 1 − cos α of an angle with this sin² α, 0 ≤ α ≤ ½π, without the cancellation of small angles: the
/// height of the cap of the unit sphere in which a ball is seen, whose solid angle is 2π times that.
///
/// A ball of radius r, seen from the distance d of its centre, has sin² α = r² / d².
pub fn cap_height(sin2: f32) -> f32 {
    sin2 / (1.0 + (1.0 - sin2).max(0.0).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn assert_near(a: DVec3, b: DVec3) {
        assert!((a - b).length() < 1e-12, "{a} is not {b}");
    }

    #[test]
    fn lat_long_axes_are_those_of_openexr() {
        assert_near(lat_long_direction(DVec2::new(1023.5, 511.5), 2048, 1024), DVec3::Z);
        assert_near(lat_long_direction(DVec2::new(511.5, 511.5), 2048, 1024), DVec3::X);
        assert_near(lat_long_direction(DVec2::new(77.0, -0.5), 2048, 1024), DVec3::Y);
        assert_near(lat_long_direction(DVec2::new(-0.5, 511.5), 2048, 1024), -DVec3::Z);
        assert_near(lat_long_direction(DVec2::new(1535.5, 511.5), 2048, 1024), -DVec3::X);
    }

    #[test]
    fn lat_long_pixel_inverts_lat_long_direction() {
        for j in 0..16 {
            for i in 0..32 {
                let pixel = DVec2::new(i as f64, j as f64);
                let back = lat_long_pixel(lat_long_direction(pixel, 32, 16), 32, 16);
                assert!((back - pixel).length() < 1e-12, "{pixel} came back as {back}");
            }
        }
    }

    #[test]
    fn texel_solid_angles_tile_the_sphere() {
        for height in [1, 2, 7, 512] {
            let width = 2 * height + 1;
            let sum: f64 =
                (0..height).map(|j| width as f64 * lat_long_solid_angle(j, width, height)).sum();
            assert!((sum - 4.0 * PI).abs() < 1e-12);
        }
    }

    #[test]
    fn caps_of_tiny_angles_keep_their_height() {
        for angle in [1e-6_f64, 4.65e-3, 0.3, 0.5 * PI] {
            let height = f64::from(cap_height(angle.sin().powi(2) as f32));
            let wanted = 2.0 * (0.5 * angle).sin().powi(2);
            // Half an ulp each of sin², root, sum and quotient
            assert!((height / wanted - 1.0).abs() < 3e-7, "{angle}: {height} for {wanted}");
        }
    }

    #[test]
    fn opencv_looks_along_plus_z_with_y_down() {
        assert_eq!(OPENCV_FROM_CAMERA * -DVec3::Z, DVec3::Z);
        assert_eq!(OPENCV_FROM_CAMERA * DVec3::Y, -DVec3::Y);
        assert_eq!(OPENCV_FROM_CAMERA * OPENCV_FROM_CAMERA, DMat3::IDENTITY);
    }
}
