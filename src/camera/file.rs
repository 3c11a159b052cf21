//! camera.json, and the plain text formats a lens arrives in.
//!
//! camera.json holds size, lens, pose and both covariances, in our own conventions (see
//! `conventions.rs`). Read as well: OpenCV's YAML (`camera_matrix`, `distortion_coefficients`) and
//! COLMAP's `cameras.txt` (whose pixel corner is the origin: half a pixel is taken off). Files are not
//! believed: sizes, numbers and rotations are checked before anyone uses them.

use std::io::Write;
use std::path::{Path, PathBuf};

use glam::{DAffine3, DMat3, DVec3};
use serde::{Deserialize, Serialize};

use super::{Camera, Distortion, Lens, Pose, interchange};
use crate::conventions::FARTHEST_M;
use crate::photo::{atomic, text};

/// Largest side of a picture that a camera file may state, px.
const LONGEST_SIDE: usize = 1 << 20;
/// Largest camera file that is read, bytes.
const LARGEST_FILE: u64 = 4 << 20;

/// Why a camera file cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum CameraFileError {
    #[error("{}: {cause}", path.display())]
    Io { path: PathBuf, cause: std::io::Error },
    #[error("{}: {what}", path.display())]
    Content { path: PathBuf, what: String },
}

impl From<std::io::Error> for CameraFileError {
    fn from(cause: std::io::Error) -> Self {
        Self::Io { path: PathBuf::new(), cause }
    }
}

/// What a camera file held.
#[derive(Clone, Debug, PartialEq)]
pub struct ReadCamera {
    /// Its pose is the identity if the file has none.
    pub camera: Camera,
    pub has_pose: bool,
}

/// camera.json, field by field.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct CameraJson {
    /// Version of this format.
    platelight_camera: u32,
    width: usize,
    height: usize,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    /// none, brown-conrady, rational or kannala-brandt.
    distortion: String,
    #[serde(default)]
    coefficients: Vec<f64>,
    #[serde(default)]
    lens_covariance: Option<Vec<f64>>,
    /// Three rows of four: camera axes (−Z forward, +Y up) to world, metres.
    #[serde(default)]
    world_from_camera: Option<[[f64; 4]; 3]>,
    #[serde(default)]
    pose_covariance: Option<[[f64; 6]; 6]>,
    #[serde(default)]
    about: String,
}

const ABOUT: &str = "pixels: centre of the top-left pixel is (0, 0); coefficients as OpenCV names and orders \
     them; lens_covariance: fx fy cx cy coefficients, row-major; world: metres, +Y up; pose_covariance: rotation \
     vector in camera axes (rad), position in world (m)";

/// Writes camera.json; the file appears whole or not at all.
pub fn write(path: &Path, camera: &Camera, with_pose: bool) -> Result<(), CameraFileError> {
    let (lens, pose) = (&camera.lens, &camera.pose);
    let (m, t) = (pose.rotation(), pose.position());
    let row = |i: usize| [m.x_axis[i], m.y_axis[i], m.z_axis[i], t[i]];
    let json = CameraJson {
        platelight_camera: 1,
        width: camera.width,
        height: camera.height,
        fx: lens.fx,
        fy: lens.fy,
        cx: lens.cx,
        cy: lens.cy,
        distortion: name(&lens.distortion).to_owned(),
        coefficients: lens.distortion.coefficients(),
        lens_covariance: lens.covariance.clone(),
        world_from_camera: with_pose.then(|| [row(0), row(1), row(2)]),
        pose_covariance: pose.covariance.filter(|_| with_pose),
        about: ABOUT.to_owned(),
    };
    let finite =
        lens.parameters().iter().all(|v| v.is_finite()) && pose.world_from_camera.is_finite();
    if !finite {
        let what = "the camera has values that are not finite and cannot be written".to_owned();
        return Err(CameraFileError::Content { path: path.to_owned(), what });
    }
    let text = serde_json::to_string_pretty(&json)
        .map_err(|e| CameraFileError::Content { path: path.to_owned(), what: e.to_string() })?;
    let named = |error: CameraFileError| match error {
        CameraFileError::Io { cause, .. } => CameraFileError::Io { path: path.to_owned(), cause },
        other => other,
    };
    atomic::write(path, |f| {
        f.write_all(text.as_bytes())?;
        f.write_all(b"\n")?;
        Ok(())
    })
    .map_err(named)
}

fn name(distortion: &Distortion) -> &'static str {
    match distortion {
        Distortion::None => "none",
        Distortion::BrownConrady { .. } => "brown-conrady",
        Distortion::Rational { .. } => "rational",
        Distortion::KannalaBrandt { .. } => "kannala-brandt",
    }
}

/// Reads camera.json, OpenCV's YAML or COLMAP's cameras.txt, told by content.
pub fn read(path: &Path) -> Result<ReadCamera, CameraFileError> {
    let named = |cause| CameraFileError::Io { path: path.to_owned(), cause };
    let text = text::read(path, LARGEST_FILE).map_err(named)?;
    let content = |what: String| CameraFileError::Content { path: path.to_owned(), what };
    parse(&text).map_err(content)
}

/// Reads a camera from the text of any of the formats. `Err` is a sentence without the file's name.
pub fn parse(text: &str) -> Result<ReadCamera, String> {
    let start = text.trim_start();
    let read = if start.starts_with('{') {
        from_json(text)?
    } else if start.starts_with("%YAML") {
        ReadCamera { camera: interchange::opencv_yaml(text)?, has_pose: false }
    } else {
        ReadCamera { camera: interchange::colmap(text)?, has_pose: false }
    };
    check(&read.camera)?;
    Ok(read)
}

/// A sentence about JSON that is not a camera: line, key, what was found, and what to do.
fn json_problem(text: &str, error: &serde_json::Error) -> String {
    let said = error.to_string();
    let what = said.rsplit_once(" at line ").map_or(said.as_str(), |(what, _)| what);
    let what = what.replace("f64", "a number").replace("usize", "a whole number");
    let remedy = match error.classify() {
        serde_json::error::Category::Data => {
            "correct it, or let platelight calibrate or locate write the file anew"
        }
        _ => "the file is cut off or no JSON; let platelight calibrate or locate write it anew",
    };
    // What is missing is missing everywhere.
    if error.line() == 0 || what.starts_with("missing") {
        return format!("{what}; {remedy}");
    }
    // The key whose value was read last, if this line has one.
    let line = text.lines().nth(error.line() - 1).unwrap_or("");
    let before: String = line.chars().take(error.column()).collect();
    let key = before.rsplit_once("\":").and_then(|(head, _)| head.rsplit_once('"'));
    let key = key.map_or(String::new(), |(_, key)| format!("{key}: "));
    format!("line {}: {key}{what}; {remedy}", error.line())
}

fn from_json(text: &str) -> Result<ReadCamera, String> {
    let json: CameraJson = serde_json::from_str(text).map_err(|e| json_problem(text, &e))?;
    if json.platelight_camera != 1 {
        return Err(format!(
            "version {} of camera.json; this reads version 1",
            json.platelight_camera
        ));
    }
    let model = match json.distortion.as_str() {
        "none" => Distortion::None,
        "brown-conrady" => Distortion::BrownConrady { k1: 0.0, k2: 0.0, p1: 0.0, p2: 0.0, k3: 0.0 },
        "rational" => Distortion::Rational {
            k1: 0.0,
            k2: 0.0,
            p1: 0.0,
            p2: 0.0,
            k3: 0.0,
            k4: 0.0,
            k5: 0.0,
            k6: 0.0,
        },
        "kannala-brandt" => Distortion::KannalaBrandt { k1: 0.0, k2: 0.0, k3: 0.0, k4: 0.0 },
        other => {
            return Err(format!(
                "distortion \"{other}\" is unknown: none, brown-conrady, rational or kannala-brandt"
            ));
        }
    };
    let distortion = model.with_coefficients(&json.coefficients).ok_or_else(|| {
        let (n, wanted) = (json.coefficients.len(), model.coefficients().len());
        format!("{} has {wanted} coefficients, not {n}", json.distortion)
    })?;
    let covariance = json.lens_covariance;
    let lens = Lens { fx: json.fx, fy: json.fy, cx: json.cx, cy: json.cy, distortion, covariance };
    let mut pose = Pose::identity();
    let has_pose = json.world_from_camera.is_some();
    if let Some(rows) = json.world_from_camera {
        let column = |k: usize| DVec3::new(rows[0][k], rows[1][k], rows[2][k]);
        pose.world_from_camera = DAffine3 {
            matrix3: DMat3::from_cols(column(0), column(1), column(2)),
            translation: column(3),
        };
        pose.covariance = json.pose_covariance;
    }
    Ok(ReadCamera {
        camera: Camera { width: json.width, height: json.height, lens, pose },
        has_pose,
    })
}

/// Refuses what no camera can be.
fn check(camera: &Camera) -> Result<(), String> {
    const ORTHONORMAL: f64 = 1e-6;
    let Camera { width, height, lens, pose } = camera;
    if *width == 0 || *height == 0 || *width > LONGEST_SIDE || *height > LONGEST_SIDE {
        return Err(format!(
            "a picture of {width} × {height} px; sides lie between 1 and {LONGEST_SIDE}"
        ));
    }
    if lens.parameters().iter().any(|v| !v.is_finite()) {
        return Err("lens values that are not finite".into());
    }
    if !(lens.fx > 0.0 && lens.fy > 0.0) {
        return Err(format!("focal lengths {} and {} px; both must be positive", lens.fx, lens.fy));
    }
    lens.check_plausible(*width, *height)?;
    let n = lens.n_parameters();
    if let Some(c) = &lens.covariance {
        if c.len() != n * n {
            return Err(format!(
                "lens_covariance has {} numbers; this lens needs {}",
                c.len(),
                n * n
            ));
        }
        if c.iter().any(|v| !v.is_finite()) || (0..n).any(|i| c[i * n + i] < 0.0) {
            return Err("lens_covariance is not finite or has a negative variance".into());
        }
    }
    let m = pose.rotation();
    let off = (m.transpose() * m - DMat3::IDENTITY).to_cols_array();
    let rotation = off.iter().all(|v| v.abs() < ORTHONORMAL) && m.determinant() > 0.0;
    if !rotation || !pose.position().is_finite() {
        return Err(
            "world_from_camera is no rotation and position (a scale or a mirror crept in?)".into(),
        );
    }
    let distance_m = pose.position().length();
    if !(distance_m <= FARTHEST_M) {
        return Err(format!(
            "the camera lies {distance_m:e} m from the world's origin, more than {FARTHEST_M:e} m; \
             check the units"
        ));
    }
    let variances = |c: &[[f64; 6]; 6]| {
        c.iter().flatten().all(|v| v.is_finite()) && (0..6).all(|i| c[i][i] >= 0.0)
    };
    if pose.covariance.as_ref().is_some_and(|c| !variances(c)) {
        return Err("pose_covariance is not finite or has a negative variance".into());
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> Camera {
        let mut pose = Pose::look_at(DVec3::new(0.3, 1.5, 2.0), DVec3::ZERO, DVec3::Y).unwrap();
        pose.covariance = Some([[1e-8; 6]; 6]);
        Camera {
            width: 960,
            height: 640,
            lens: Lens {
                fy: 941.7,
                distortion: Distortion::BrownConrady {
                    k1: -0.1,
                    k2: 0.03,
                    p1: 6e-4,
                    p2: -4e-4,
                    k3: 0.0,
                },
                covariance: Some(vec![1e-3; 81]),
                ..Lens::pinhole(940.3, 960, 640)
            },
            pose,
        }
    }

    #[test]
    fn camera_json_round_trip_is_exact() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("camera.json");
        write(&path, &camera(), true).unwrap();
        assert_eq!(read(&path).unwrap(), ReadCamera { camera: camera(), has_pose: true });
        write(&path, &camera(), false).unwrap();
        let back = read(&path).unwrap();
        assert!(!back.has_pose && back.camera.pose == Pose::identity());
    }

    #[test]
    fn hostile_cameras_are_refused_with_the_reason() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("camera.json");
        write(&path, &camera(), true).unwrap();
        let good = std::fs::read_to_string(&path).unwrap();
        let spoil = |from: &str, to: &str| {
            assert!(good.contains(from), "{from}");
            parse(&good.replacen(from, to, 1)).expect_err(to)
        };
        assert!(spoil("\"width\": 960", "\"width\": 99999999999").contains("sides"));
        assert!(spoil("\"fx\": 940.3", "\"fx\": -1").contains("positive"));
        assert!(spoil("brown-conrady", "tangential").contains("unknown"));
        assert!(spoil("\"coefficients\": [", "\"coefficients\": [1,").contains("not 6"));
        assert!(spoil("\"lens_covariance\": [", "\"lens_covariance\": [1,").contains("81"));
        assert!(spoil("\"platelight_camera\": 1", "\"platelight_camera\": 7").contains("version"));
        assert!(spoil("\"fx\"", "\"focal\"").contains("focal"));
        let said = spoil("\"fx\": 940.3", "\"fx\": \"wide\"");
        let told = ["line 5: fx: invalid type", "expected a number", "calibrate"];
        assert!(told.iter().all(|told| said.contains(told)), "{said}");
        let said = spoil("\"fx\": 940.3,", "");
        assert!(said.starts_with("missing field `fx`; "), "{said}");
        assert!(spoil("\"fx\": 940.3", "\"fx\": 1e9").contains("span"));
        assert!(parse("{").unwrap_err().contains("cut off"), "{}", parse("{").unwrap_err());
        let rows = "\"world_from_camera\": [\n    [";
        assert!(spoil(rows, &format!("{rows}1e3, 0, 0, 0], [")).contains("trailing"));
        let start = good.find(rows).expect("the pose was written");
        let end = start + good[start..].find("]\n  ]").expect("the pose ends") + 5;
        for matrix in [
            "[2, 0, 0, 0], [0, 2, 0, 0], [0, 0, 2, 0]",
            "[-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]",
            "[1, 0.1, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]",
            "[1, 0, 0, 1e13], [0, 1, 0, 0], [0, 0, 1, 0]",
        ] {
            let pose = format!("\"world_from_camera\": [{matrix}]");
            let error = parse(&[&good[..start], &pose, &good[end..]].concat()).unwrap_err();
            let told = if matrix.contains("1e13") { "check the units" } else { "no rotation" };
            assert!(error.contains(told), "{matrix}: {error}");
        }
        for cut in (0..good.len()).step_by(37).filter(|&c| good.is_char_boundary(c)) {
            assert!(parse(&good[..cut]).is_err());
        }
        assert!(read(folder.path()).is_err() && parse("").is_err() && parse("{}").is_err());
    }
}
