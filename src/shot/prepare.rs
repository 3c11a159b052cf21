//! From a plan to everything the renderer needs: lens, pose, light, scene.
//!
//! [`Plan`] → [`Prepared`]. Problems that do not hang on each other are found together.

use glam::DVec3;

use super::bracket;
use super::calibrate::{FoundLens, find_lens};
use super::camera_keys::{Board, CameraKeys, CameraSource};
use super::light::{self, Light, Setting};
use super::locate::{FoundPose, LocateError, Seen, find_pose};
use super::place;
use super::placing;
use super::plan::Plan;
use super::probe_keys::{Ball, ProbeSource};
use super::run::RunError;
use super::shown::Shown;
use super::support_light::{self, View};
use super::unseen;
use super::watch::{Stopwatch, Watch};
use crate::camera::planar_pose::PoseScatter;
use crate::camera::slip;
use crate::camera::{Camera, Distortion};
use crate::render::{Context, Method};
use crate::report::{CameraReport, LightsReport, PoseReport, ProbeReport, Warning};
use crate::scene::Scene;
use crate::trace::accel::lost_triangles;

/// What a shot is rendered from, and how well it is known.
pub struct Prepared {
    pub camera: Camera,
    pub camera_report: CameraReport,
    pub pose_report: PoseReport,
    pub probe_report: ProbeReport,
    pub lights_report: LightsReport,
    pub light: Light,
    pub scene: Scene,
    pub method: Method,
    /// Beside the plan's own; first those that hold for all frames.
    pub warnings: Vec<Warning>,
    n_lasting: usize,
    /// No pixel may show some object, and a warning says so.
    pub objects_maybe_unseen: bool,
    /// What the pose was found from, and the camera that saw it.
    pub seen: Vec<Seen>,
    pub seen_by: Camera,
    /// How the pose scatters; `None` of one from a file.
    scatter: Option<PoseScatter>,
}

impl Prepared {
    /// Puts what moves where another frame has it. Lens, place and light stay as they are.
    ///
    /// # Errors
    /// What has no room in the world.
    pub fn take_frame(&mut self, plan: &Plan) -> Result<(), RunError> {
        self.scene = scene(plan)?;
        let shown = Shown::new(&self.scene, &self.camera);
        let standing = Standing::judge(plan, &self.scene, &self.camera, &shown);
        self.warnings.truncate(self.n_lasting);
        self.warnings.extend(standing.warnings);
        self.objects_maybe_unseen = standing.maybe_unseen;
        self.pose_report.slip_px = slip_px(plan, self.scatter.as_ref(), &self.camera);
        Ok(())
    }
}

/// What is to be said of where the things of one frame stand.
struct Standing {
    warnings: Vec<Warning>,
    maybe_unseen: bool,
}

impl Standing {
    fn judge(plan: &Plan, scene: &Scene, camera: &Camera, shown: &Shown) -> Self {
        let placing = placing::judge(plan, scene, camera, &shown.local);
        let mut warnings: Vec<Warning> = lost_triangles_warning(scene).into_iter().collect();
        warnings.extend(unseen::warning(scene, shown));
        warnings.extend(placing.warnings);
        Self { warnings, maybe_unseen: placing.maybe_unseen }
    }
}

fn scene(plan: &Plan) -> Result<Scene, RunError> {
    place::scene(plan).map_err(|problem| one(format!("{}: {problem}", plan.shot.path.display())))
}

/// Calibrates, locates, unwraps and builds the scene.
///
/// # Errors
/// Every problem found, each with file, key and remedy; [`RunError::Interrupted`] between two steps
/// once the context is cancelled.
pub fn prepare(
    plan: &mut Plan,
    stopwatch: &mut Stopwatch,
    context: &Context,
    watch: &dyn Watch,
) -> Result<Prepared, RunError> {
    let mut begin = |stage| {
        stopwatch.begin(stage, watch);
        if context.is_cancelled() { Err(RunError::Interrupted) } else { Ok(()) }
    };
    let method = method(plan).map_err(one)?;

    begin("merge the bracket")?;
    let bracket = bracket::merge(plan);
    let plan: &Plan = plan;
    let shot = &plan.shot;

    begin("calibrate the lens")?;
    let in_file = |error: String| format!("{}: {error}", shot.path.display());
    let plate = &plan.plate;
    let plate_size = [plate.linear.width(), plate.linear.height()];
    let found_lens = find_lens(&shot.camera.source, plate_size, &plate.facts, &plate.path)
        .map_err(|error| one(in_file(format!("camera: {error}"))))?;

    begin("find the camera's place")?;
    let size = [found_lens.width, found_lens.height];
    let found_pose = find_pose(&shot.pose, &found_lens.lens, size, own_board(&shot.camera))
        .map_err(|error| in_file(format!("{}: {error}", pose_key(&error))));
    let ball_camera = match &shot.probe.source {
        ProbeSource::Ball(ball) => ball_camera(plan, ball, &found_lens, found_pose.as_ref().ok())
            .map_err(|error| in_file(format!("probe.ball: {error}"))),
        ProbeSource::Fisheye(_) | ProbeSource::Panorama(_) | ProbeSource::Sky(_) => Ok(None),
    };

    begin("unwrap the probe")?;
    // A ball whose camera stands where the plate's does has none while that place is not found: one
    // problem, not two.
    let is_ball = matches!(shot.probe.source, ProbeSource::Ball(_));
    let unwrapped = match (bracket, ball_camera) {
        (Err(problem), _) | (_, Err(problem)) => Err(problem),
        (Ok(_), Ok(None)) if is_ball && found_pose.is_err() => Ok(None),
        (Ok(bracket), Ok(camera)) => light::unwrap(plan, bracket, camera).map(Some),
    };
    let (found_pose, unwrapped) = match (found_pose, unwrapped) {
        (Ok(pose), Ok(Some(unwrapped))) => (pose, unwrapped),
        (pose, unwrapped) => {
            let problems = [pose.err(), unwrapped.err()].into_iter().flatten().collect();
            return Err(RunError::Problems(problems));
        }
    };

    begin("build scene and lights")?;
    let camera = plate_camera(plan, &found_lens, &found_pose);
    let scene = scene(plan)?;
    let shown = Shown::new(&scene, &camera);
    let setting = Setting { plan, camera: &camera, scene: &scene, shown: &shown };
    let (light, probe_report, lights_report) = light::light(unwrapped, &setting).map_err(one)?;
    if context.is_cancelled() {
        return Err(RunError::Interrupted);
    }

    let mut warnings = found_lens.warnings;
    warnings.extend(found_pose.warnings.iter().cloned());
    warnings.extend(light.warnings.iter().cloned());
    warnings.extend(support_light::warnings(&View {
        plate: &plan.plate.linear,
        clipped: &plan.plate.clipped,
        scene: &scene,
        shown: &shown,
        lights: &light.lights,
    }));
    let n_lasting = warnings.len();
    let standing = Standing::judge(plan, &scene, &camera, &shown);
    warnings.extend(standing.warnings);
    let slip_px = slip_px(plan, found_pose.scatter.as_ref(), &camera);
    let pose_report = PoseReport { slip_px, ..found_pose.report };
    Ok(Prepared {
        camera,
        camera_report: found_lens.report,
        pose_report,
        probe_report,
        lights_report,
        light,
        scene,
        method,
        warnings,
        n_lasting,
        objects_maybe_unseen: standing.maybe_unseen,
        seen: found_pose.seen,
        seen_by: Camera {
            width: found_lens.width,
            height: found_lens.height,
            lens: found_lens.lens,
            pose: found_pose.pose,
        },
        scatter: found_pose.scatter,
    })
}

/// `pose`, or the key below it that an error speaks of.
fn pose_key(error: &LocateError) -> String {
    match error.key() {
        "" => "pose".to_owned(),
        key => format!("pose.{key}"),
    }
}

/// A problem that nothing else can be looked for behind.
fn one(problem: String) -> RunError {
    RunError::Problems(vec![problem])
}

/// The renderer's methods by their names in the shot file.
pub(super) const METHODS: [(&str, Method); 4] = [
    ("auto", Method::Coupled),
    ("coupled", Method::Coupled),
    ("two-pass", Method::TwoPass { same_numbers: true }),
    ("two-pass-independent", Method::TwoPass { same_numbers: false }),
];

fn method(plan: &Plan) -> Result<Method, String> {
    let name = plan.shot.render.method.as_str();
    let found = METHODS.iter().find(|(known, _)| *known == name).map(|&(_, method)| method);
    found.ok_or_else(|| {
        format!(
            "{}: render.method: \"{name}\" is not one of: {}",
            plan.shot.path.display(),
            METHODS.map(|(known, _)| known).join(", ")
        )
    })
}

/// What the shot file calls a method.
pub fn method_name(method: Method) -> &'static str {
    let named = METHODS[1..].iter().find(|(_, known)| *known == method);
    named.map_or("unnamed", |&(name, _)| name)
}

/// How far off the objects' foot may be seen, from pose and lens.
fn slip_px(plan: &Plan, scatter: Option<&PoseScatter>, camera: &Camera) -> Option<f64> {
    let foot = place::foot(plan);
    let normal = place::support_plane(plan, foot + DVec3::Y * 1e-3).map_or(DVec3::Y, |(_, n)| n);
    let radius = place::object_box(plan).map_or(0.1, |[min, max]| 0.5 * (max - min).length());
    slip::predicted_px(camera, scatter?, foot, normal, radius)
}

/// The board of `[camera]`, if it has one.
fn own_board(camera: &CameraKeys) -> Option<&Board> {
    match &camera.source {
        CameraSource::Boards { board, .. } => Some(board),
        _ => None,
    }
}

/// The plate's camera; without distortion if that was taken out of the plate before.
fn plate_camera(plan: &Plan, found: &FoundLens, pose: &FoundPose) -> Camera {
    let mut lens = found.lens.clone();
    if !plan.shot.camera.plate_shows_lens {
        lens.distortion = Distortion::None;
        lens.covariance = None;
    }
    Camera { width: found.width, height: found.height, lens, pose: pose.pose.clone() }
}

/// The camera the ball was photographed with: lens, own place, cut-out.
fn ball_camera(
    plan: &Plan,
    ball: &Ball,
    plate: &FoundLens,
    plate_pose: Option<&FoundPose>,
) -> Result<Option<Camera>, String> {
    let photo = plan.probe_photos.first().ok_or("photos: none was read")?;
    let photo_size = [photo.width, photo.height];
    let own;
    let (lens, board) = match &ball.camera {
        None => (plate, own_board(&plan.shot.camera)),
        Some(source) => {
            let found = find_lens(source, photo_size, &photo.facts, &photo.path);
            own = found.map_err(|error| format!("camera: {error}"))?;
            let board = match source {
                CameraSource::Boards { board, .. } => Some(board),
                _ => own_board(&plan.shot.camera),
            };
            (&own, board)
        }
    };
    let lens_size = [lens.width, lens.height];
    let pose = match (&ball.pose, plate_pose) {
        (Some(source), _) => {
            let found = find_pose(source, &lens.lens, lens_size, board);
            found.map_err(|error| format!("{}: {error}", pose_key(&error)))?.pose
        }
        (None, Some(found)) => found.pose.clone(),
        // The plate's own pose failed and is told already.
        (None, None) => return Ok(None),
    };
    let [width, height] = lens_size;
    let camera = Camera { width, height, lens: lens.lens.clone(), pose };
    match ball.crop {
        Some(crop)
            if !camera.holds_cut_out(crop.x, crop.y, crop.scale, photo_size[0], photo_size[1]) =>
        {
            let [wide, high] = lens_size.map(|size| size as f64 * crop.scale);
            Err(format!(
                "crop: {} × {} px from ({}, {}) on do not lie in the camera's frame of {width} × {height} px, \
                 which is {wide:.0} × {high:.0} px at scale {}; x, y is the cut-out's first pixel in the frame \
                 at that scale",
                photo_size[0], photo_size[1], crop.x, crop.y, crop.scale
            ))
        }
        Some(crop) => {
            Ok(Some(camera.cropped(crop.x, crop.y, crop.scale, photo_size[0], photo_size[1])))
        }
        None if photo_size == lens_size => Ok(Some(camera)),
        None => Err(format!(
            "photos: {}: {} × {} px, but its camera has {width} × {height} px; if the photographs \
             are a cut-out, say crop = {{ x = …, y = …, scale = … }}",
            photo.path.display(),
            photo_size[0],
            photo_size[1]
        )),
    }
}

/// Triangles that nothing can be seen of, though a file has them.
fn lost_triangles_warning(scene: &Scene) -> Option<Warning> {
    let meshes = || scene.objects.iter().chain(scene.local.iter().map(|local| &local.mesh));
    let lost: usize = meshes().map(lost_triangles).sum();
    (lost > 0).then(|| {
        let all: usize = meshes().map(|mesh| mesh.triangles.len()).sum();
        Warning::new(
            "scene",
            "triangles without area, or too far out, are left out; if they should be seen, look at the \
             scale and the units of their file",
            format!("{lost} of {all} triangles"),
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Mesh;
    use glam::Vec3;

    #[test]
    fn lost_triangles_are_told() {
        let mesh = Mesh {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y],
            triangles: vec![[0, 1, 2], [0, 0, 1]],
            ..Mesh::default()
        };
        let mut scene = Scene { objects: vec![mesh], ..Scene::default() };
        assert_eq!(lost_triangles_warning(&scene).unwrap().size, "1 of 2 triangles");
        scene.objects[0].triangles.pop();
        assert_eq!(lost_triangles_warning(&scene), None);
    }
}
