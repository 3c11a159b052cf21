//! Lenses from other programs' text files: OpenCV's YAML and COLMAP's `cameras.txt`.
//!
//! Only what a lens needs is read; everything else in the file is passed over. Errors are sentences
//! without the file's name.

use super::{Camera, Distortion, Lens, Pose};

/// The lens of an OpenCV calibration file (`camera_matrix`, `distortion_coefficients`, image size).
///
/// With 4, 5, 8 coefficients of OpenCV's main model; more (thin prism, tilt) must be zero.
pub fn opencv_yaml(text: &str) -> Result<Camera, String> {
    let k = matrix(text, &["camera_matrix", "K", "M1"])?.ok_or("no camera_matrix")?;
    if k.len() != 9 || k[1] != 0.0 || k[3] != 0.0 || k[8] != 1.0 {
        return Err("camera_matrix is not 3 × 3 with rows fx 0 cx, 0 fy cy, 0 0 1".into());
    }
    let names = ["distortion_coefficients", "dist_coeffs", "D", "D1"];
    let mut d = matrix(text, &names)?.unwrap_or_default();
    while d.len() > 8 && d.last() == Some(&0.0) {
        d.pop();
    }
    let fisheye = text.contains("fisheye_model: 1") || text.contains("equidistant");
    let distortion = match (fisheye, d.as_slice()) {
        (true, &[k1, k2, k3, k4]) => Distortion::KannalaBrandt { k1, k2, k3, k4 },
        (true, other) => {
            return Err(format!(
                "{} distortion coefficients of a fisheye, which has 4 (0 0 0 0 is the pure \
                 equidistant lens); write those, or take the fisheye mark out of the file",
                other.len()
            ));
        }
        (_, []) => Distortion::None,
        (false, &[k1, k2, p1, p2]) => Distortion::BrownConrady { k1, k2, p1, p2, k3: 0.0 },
        (false, &[k1, k2, p1, p2, k3]) => Distortion::BrownConrady { k1, k2, p1, p2, k3 },
        (false, &[k1, k2, p1, p2, k3, k4, k5, k6]) => {
            Distortion::Rational { k1, k2, p1, p2, k3, k4, k5, k6 }
        }
        (_, other) => {
            return Err(format!(
                "{} distortion coefficients; 4, 5 or 8 can be read (thin prism and tilt cannot)",
                other.len()
            ));
        }
    };
    let side = |key: &str| -> Result<usize, String> {
        let value = scalar(text, key).ok_or_else(|| {
            format!(
                "no {key}; add image_width and image_height, a lens belongs to a size of picture"
            )
        })?;
        value.parse().map_err(|_| format!("{key} is \"{value}\", not a number of pixels"))
    };
    let lens = Lens { fx: k[0], fy: k[4], cx: k[2], cy: k[5], distortion, covariance: None };
    let (width, height) = (side("image_width")?, side("image_height")?);
    Ok(Camera { width, height, lens, pose: Pose::identity() })
}

/// The text after `key:` at the start of a line.
fn scalar<'a>(text: &'a str, key: &str) -> Option<&'a str> {
    let after = |line: &'a str| line.trim().strip_prefix(key)?.strip_prefix(':');
    text.lines().find_map(after).map(str::trim)
}

/// Numbers of the first `!!opencv-matrix` that has one of these names.
fn matrix(text: &str, names: &[&str]) -> Result<Option<Vec<f64>>, String> {
    const MOST: usize = 64;
    for name in names {
        let head = format!("\n{name}:");
        let Some(at) = text.find(&head) else { continue };
        let rest = &text[at + head.len()..];
        let open = rest.find("data:").and_then(|d| Some(d + rest[d..].find('[')?));
        let Some((open, close)) = open.and_then(|o| Some((o, o + rest[o..].find(']')?))) else {
            return Err(format!("{name} has no data: [ … ]"));
        };
        let numbers: Vec<f64> = rest[open + 1..close]
            .split(',')
            .take(MOST + 1)
            .map(|v| v.trim().parse().map_err(|_| format!("{name}: \"{}\" is no number", v.trim())))
            .collect::<Result<_, String>>()?;
        if numbers.len() > MOST {
            return Err(format!("{name} has more than {MOST} numbers"));
        }
        return Ok(Some(numbers));
    }
    Ok(None)
}

/// The camera of COLMAP's `cameras.txt`: `ID MODEL WIDTH HEIGHT PARAMS…`.
///
/// Of several cameras none is chosen: that is an error which names them. COLMAP counts pixels from the corner: half a pixel is taken off the principal point.
pub fn colmap(text: &str) -> Result<Camera, String> {
    let expected = "expected camera.json, OpenCV YAML, or COLMAP's `ID MODEL WIDTH HEIGHT PARAMS`";
    let mut lines = text.lines().map(str::trim).filter(|l| !l.is_empty() && !l.starts_with('#'));
    let line = lines.next().ok_or_else(|| format!("nothing in it; {expected}"))?;
    let mut words = line.split_whitespace();
    let mut word = || words.next().ok_or_else(|| expected.to_owned());
    let (id, model) = (word()?, word()?.to_owned());
    let side = |w: &str| w.parse::<usize>().map_err(|_| expected.to_owned());
    let (width, height) = (side(word()?)?, side(word()?)?);
    let mut others = lines.filter_map(|line| line.split_whitespace().next());
    if let Some(second) = others.next() {
        return Err(format!(
            "{} cameras ({id}, {second}, …); keep the line of the one that took the picture in a \
             file of its own",
            2 + others.count()
        ));
    }
    let p: Vec<f64> = words
        .map(|w| w.parse().map_err(|_| format!("\"{w}\" is no number; {expected}")))
        .collect::<Result<_, String>>()?;
    let brown =
        |k1: f64, k2: f64, p1: f64, p2: f64| Distortion::BrownConrady { k1, k2, p1, p2, k3: 0.0 };
    let (focal, centre, distortion) = match (model.as_str(), p.as_slice()) {
        ("SIMPLE_PINHOLE", &[f, x, y]) => ([f, f], [x, y], Distortion::None),
        ("PINHOLE", &[fx, fy, x, y]) => ([fx, fy], [x, y], Distortion::None),
        ("SIMPLE_RADIAL", &[f, x, y, k1]) => ([f, f], [x, y], brown(k1, 0.0, 0.0, 0.0)),
        ("RADIAL", &[f, x, y, k1, k2]) => ([f, f], [x, y], brown(k1, k2, 0.0, 0.0)),
        ("OPENCV", &[fx, fy, x, y, k1, k2, p1, p2]) => ([fx, fy], [x, y], brown(k1, k2, p1, p2)),
        ("FULL_OPENCV", &[fx, fy, x, y, k1, k2, p1, p2, k3, k4, k5, k6]) => {
            ([fx, fy], [x, y], Distortion::Rational { k1, k2, p1, p2, k3, k4, k5, k6 })
        }
        ("OPENCV_FISHEYE", &[fx, fy, x, y, k1, k2, k3, k4]) => {
            ([fx, fy], [x, y], Distortion::KannalaBrandt { k1, k2, k3, k4 })
        }
        (name, numbers) => {
            return Err(format!(
                "model {name} with {} numbers cannot be read; {expected}",
                numbers.len()
            ));
        }
    };
    let lens = Lens {
        fx: focal[0],
        fy: focal[1],
        cx: centre[0] - 0.5,
        cy: centre[1] - 0.5,
        distortion,
        covariance: None,
    };
    Ok(Camera { width, height, lens, pose: Pose::identity() })
}

#[cfg(test)]
mod tests {
    use super::*;

    const YAML: &str = "%YAML:1.0\n---\nimage_width: 640\nimage_height: 480\ncamera_matrix: !!opencv-matrix\n   \
        rows: 3\n   cols: 3\n   dt: d\n   data: [ 4.5e+02, 0., 317.5, 0.,\n       456.25, 277.75, 0., 0., 1. ]\n\
        distortion_coefficients: !!opencv-matrix\n   rows: 1\n   cols: 5\n   dt: d\n   data: [ 0.125, -1.5,\n   \
        1e-4, -4e-4, 2.5 ]\n";

    #[test]
    fn opencv_yaml_keeps_every_number() {
        let camera = opencv_yaml(YAML).unwrap();
        assert_eq!((camera.width, camera.height), (640, 480));
        assert_eq!(
            camera.lens.parameters(),
            [450.0, 456.25, 317.5, 277.75, 0.125, -1.5, 1e-4, -4e-4, 2.5]
        );
        assert!(opencv_yaml(&YAML.replace("image_width: 640\n", "")).is_err());
        assert!(opencv_yaml(&YAML.replace("456.25", "x")).is_err());
        assert!(opencv_yaml("%YAML:1.0\ncamera_matrix: [").is_err());
    }

    #[test]
    fn colmap_counts_pixels_from_the_corner() {
        let text = "# cameras\n1 OPENCV 800 600 700 701 400 300 0.1 0.01 1e-3 2e-3\n";
        let camera = colmap(text).unwrap();
        assert_eq!((camera.lens.cx, camera.lens.cy), (399.5, 299.5));
        assert!(colmap("1 OPENCV 800 600 700").is_err());
        assert!(colmap("hello").is_err() && colmap("").is_err());
    }

    #[test]
    fn of_several_colmap_cameras_none_is_guessed() {
        let text = "# cameras\n1 PINHOLE 800 600 700 701 400 300\n7 PINHOLE 80 60 70 71 40 30\n";
        let error = colmap(text).unwrap_err();
        assert!(error.contains("2 cameras (1, 7"), "{error}");
    }

    #[test]
    fn a_fisheye_has_four_coefficients_and_never_becomes_a_pinhole() {
        let fisheye = format!("{YAML}fisheye_model: 1\n");
        let error = opencv_yaml(&fisheye).unwrap_err();
        assert!(error.contains("5 distortion coefficients of a fisheye, which has 4"), "{error}");
        let without = fisheye.replace("distortion_coefficients", "coefficients_of_another_name");
        let error = opencv_yaml(&without).unwrap_err();
        assert!(error.starts_with("0 distortion coefficients of a fisheye"), "{error}");
        let four = fisheye.replace(", 2.5 ]", " ]");
        let lens = opencv_yaml(&four).unwrap().lens;
        assert!(matches!(lens.distortion, Distortion::KannalaBrandt { k4: -4e-4, .. }));
    }

    #[test]
    fn cutting_a_file_anywhere_is_no_panic() {
        for cut in 0..YAML.len() {
            let _ = opencv_yaml(&YAML[..cut]);
        }
    }
}
