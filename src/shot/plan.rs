//! Everything that can be found wrong with a shot by reading its files, found together.
//!
//! [`ShotFile`] → [`Plan`]: plate and probe photographs read, exposures known, meshes read. Nothing
//! is computed from the pictures yet; that is [`prepare`](super::prepare).

use std::path::{Path, PathBuf};

use glam::DAffine3;
use rayon::prelude::*;

use super::camera_keys::{CameraKeys, CameraSource, PoseSource};
use super::exposures::{self, Exposures, Scale};
use super::file::{PlateColour, PlateKeys, ShotFile, SupportShape};
use super::motion::Motion;
use super::pictures::{expand, readable};
use super::place;
use super::probe_keys::{ProbeSource, Surroundings};
use crate::conventions::Rgb;
use crate::photo::{self, Encoded, Facts, NamedColour, Photo, ReadOptions, Samples, Transfer};
use crate::report::Warning;
use crate::scene::{self, Model};

/// A shot whose files are all there and readable.
#[derive(Debug)]
pub struct Plan {
    pub shot: ShotFile,
    pub plate: Photo,
    /// What the probe's radiance is multiplied with to be in the plate's values.
    pub scale: Scale,
    /// Photographs of the ball or fisheye.
    pub probe_photos: Vec<Encoded>,
    pub exposures: Exposures,
    /// The mesh of `[surroundings]`.
    pub surroundings: Option<Model>,
    pub support: Option<Model>,
    pub local: Vec<Model>,
    pub objects: Vec<Model>,
    /// Every file the shot is made from.
    pub inputs: Vec<PathBuf>,
    pub warnings: Vec<Warning>,
}

/// Collects what is found.
struct Finder {
    problems: Vec<String>,
    inputs: Vec<PathBuf>,
    file: PathBuf,
}

impl Finder {
    fn problem(&mut self, key: &str, path: &Path, cause: &str) {
        let sentence = format!("{}: {key}: {}: {cause}", self.file.display(), path.display());
        self.problems.push(sentence);
    }

    /// The readable files a name or pattern stands for; none after a problem.
    fn files(&mut self, key: &str, pattern: &Path) -> Vec<PathBuf> {
        match expand(pattern) {
            Ok(files) => {
                self.inputs.extend(files.iter().cloned());
                files
            }
            Err(cause) => {
                self.problem(key, pattern, &cause);
                Vec::new()
            }
        }
    }

    fn file(&mut self, key: &str, path: &Path) -> Option<PathBuf> {
        match readable(path) {
            Ok(()) => {
                self.inputs.push(path.to_owned());
                Some(path.to_owned())
            }
            Err(cause) => {
                self.problem(key, path, &cause);
                None
            }
        }
    }

    /// The photograph a name stands for, or a pattern that only one file matches.
    fn photo(&mut self, key: &str, name: &Path, colour: Option<NamedColour>) -> Option<Photo> {
        let several = expand(name).ok().filter(|files| files.len() > 1);
        if let Some(files) = several {
            let names = files.iter().filter_map(|file| file.file_name()?.to_str());
            let cause = format!(
                "stands for {} files: {}; name one, or write #### and give frames",
                files.len(),
                names.collect::<Vec<_>>().join(", ")
            );
            self.problem(key, name, &cause);
            return None;
        }
        self.photos(key, name, colour).pop().map(Photo::from)
    }

    fn photos(&mut self, key: &str, pattern: &Path, colour: Option<NamedColour>) -> Vec<Encoded> {
        let options = ReadOptions { colour, ..ReadOptions::default() };
        let read: Vec<_> = self
            .files(key, pattern)
            .par_iter()
            .map(|path| photo::read_encoded(path, &options))
            .collect();
        read.into_iter().filter_map(|photo| self.keep(key, photo)).collect()
    }

    /// A model that stands still, every mesh a copy of its own.
    fn model(&mut self, key: &str, path: &Path) -> Option<Model> {
        let path = self.file(key, path)?;
        let model = self.keep(key, scene::read(&path).and_then(Model::flattened))?;
        self.usable(key, &path, model, &DAffine3::IDENTITY)
    }

    /// The model of `thing`, `object[0]`, at the plate's moment of its animation.
    fn thing(
        &mut self,
        thing: &str,
        path: &Path,
        world_from_model: &DAffine3,
        (motion, plate): (&Motion, &PlateKeys),
    ) -> Option<Model> {
        let key = format!("{thing}.file");
        let path = self.file(&key, path)?;
        let Some(time_s) = motion.time_s(plate) else {
            let model = self.keep(&key, scene::read(&path))?;
            return self.usable(&key, &path, model, world_from_model);
        };
        let read = scene::read_played(&path, motion.animation.as_deref());
        let asks = if motion.animation.is_some() { "animation" } else { "file" };
        let model = self.keep(&format!("{thing}.{asks}"), read)?;
        if motion.is_asked_for() && model.played.is_none() {
            let cause = "moves no node, and the shot asks for its animation; export it with one (skins \
                         and morph targets are not read), or take animation, time and start_frame out";
            self.problem(&key, &path, cause);
            return None;
        }
        let model = self.keep(&key, model.at_time(time_s))?;
        self.usable(&key, &path, model, world_from_model)
    }

    /// The model, if anything of it can be seen and it has room in the world.
    fn usable(
        &mut self,
        key: &str,
        path: &Path,
        model: Model,
        world_from_model: &DAffine3,
    ) -> Option<Model> {
        self.keep(key, model.check_place(world_from_model))?;
        // What moves may be scaled to nothing for a while.
        if model.n_triangles() == 0 && model.played.is_none() {
            // Both readers say that there are none, and what they left out.
            let why = model.warnings.join("; ");
            let cause = format!("{why}; export the mesh itself, or take {key} out");
            self.problem(key, path, &cause);
            return None;
        }
        // The first of its files is the one named, and is an input already.
        self.inputs.extend(model.files.iter().skip(1).cloned());
        Some(model)
    }

    /// The value, or a problem. Room errors name their file.
    fn keep<T>(&mut self, key: &str, result: Result<T, impl std::error::Error>) -> Option<T> {
        match result {
            Ok(value) => Some(value),
            Err(error) => {
                self.problems.push(format!("{}: {key}: {error}", self.file.display()));
                None
            }
        }
    }

    fn camera(&mut self, key: &str, source: &CameraSource) {
        match source {
            CameraSource::Boards { photos, .. } => {
                self.files(&format!("{key}.boards"), photos);
            }
            CameraSource::File(path) => {
                self.file(&format!("{key}.file"), path);
            }
            CameraSource::Focal { .. } | CameraSource::Exif { .. } => {}
        }
    }

    fn pose(&mut self, key: &str, source: &PoseSource, camera: &CameraKeys) {
        match source {
            PoseSource::Tags(tags) => {
                for tag in tags {
                    self.file(&format!("{key}.tag.photo"), &tag.photo);
                }
            }
            PoseSource::Board(board) => {
                self.file(&format!("{key}.board.photo"), &board.photo);
                if board.board.is_none() && !matches!(camera.source, CameraSource::Boards { .. }) {
                    self.problems.push(format!(
                        "{}: {key}.board: the camera has no board of its own; describe this one \
                         (corners, square_mm)",
                        self.file.display()
                    ));
                }
            }
            PoseSource::File(path) => {
                self.file(&format!("{key}.file"), path);
            }
            PoseSource::Rectangle(_) => {}
        }
    }
}

impl Plan {
    /// Reads everything the shot names.
    ///
    /// # Errors
    /// Every problem found, each with file, key and remedy.
    pub fn make(shot: ShotFile) -> Result<Self, Vec<String>> {
        let mut find = Finder { problems: Vec::new(), inputs: Vec::new(), file: shot.path.clone() };
        find.inputs.push(shot.path.clone());

        let plate = find.photo("plate.file", &shot.plate.file, named_colour(&shot));
        find.camera("camera", &shot.camera.source);
        find.pose("pose", &shot.pose, &shot.camera);
        if let Some(bad) = plate.as_ref().and_then(|plate| plate.nonfinite)
            && plate.as_ref().is_some_and(|p| p.linear.pixels().len() as u64 == bad.pixels)
        {
            let cause = "every pixel is NaN or infinite: there is no picture in it; write it again";
            find.problem("plate.file", &shot.plate.file, cause);
        }
        let relative = shot.plate.relative_exposure;
        let scale = plate.as_ref().map(|plate| {
            exposures::plate_scale(plate, &shot.plate.exposure, relative)
                .map_err(|cause| find.problems.push(format!("{}: {cause}", shot.path.display())))
        });
        if let Some(plate) = &plate {
            check_exif_camera(&shot, plate, &mut find);
        }
        let (probe_photos, exposures) = read_probe(&shot, &mut find);
        if let Some(plate) = &plate {
            check_ball_frame(&shot, plate, &probe_photos, &mut find);
        }
        if let (PlateColour::Bracket, Some(plate)) = (&shot.plate.colour, &plate) {
            check_one_camera(plate, &probe_photos, &mut find);
        }
        let surroundings = match &shot.surroundings {
            Some(Surroundings::Mesh(path)) => find.model("surroundings.mesh", path),
            Some(Surroundings::Box { .. }) | None => None,
        };

        let support = match &shot.support.shape {
            SupportShape::Mesh(path) => find.model("support.mesh", path),
            SupportShape::Plane { .. } => None,
        };
        let local = shot.local.iter().enumerate();
        let local: Vec<Model> = local
            .filter_map(|(i, local)| {
                let motion = (&local.motion, &shot.plate);
                find.thing(&format!("local[{i}]"), &local.file, &DAffine3::IDENTITY, motion)
            })
            .collect();
        let objects = shot.objects.iter().enumerate();
        let objects: Vec<Model> = objects
            .filter_map(|(i, object)| {
                let at = place::world_from_model(object);
                let motion = (&object.motion, &shot.plate);
                find.thing(&format!("object[{i}]"), &object.file, &at, motion)
            })
            .collect();

        match (plate, scale, exposures) {
            (Some(plate), Some(Ok(scale)), Some(exposures)) if find.problems.is_empty() => {
                let inputs = find.inputs;
                let mut plan = Self {
                    plate,
                    scale,
                    probe_photos,
                    exposures,
                    surroundings,
                    support,
                    local,
                    objects,
                    inputs,
                    warnings: Vec::new(),
                    shot,
                };
                plan.warnings = plan.find_warnings();
                Ok(plan)
            }
            _ => Err(find.problems),
        }
    }

    /// Puts another frame's plate in the place of this one's. False, with nothing changed, if the plate
    /// is of another size or the camera wrote other facts beside it (exposure, focal length): then
    /// more than the plate may be another. What moves is put where the frame has it.
    ///
    /// # Errors
    /// The frame cannot be read, or something is nowhere then; nothing is changed.
    pub fn take_frame(&mut self, shot: &ShotFile) -> Result<bool, Vec<String>> {
        let mut find = Finder { problems: Vec::new(), inputs: Vec::new(), file: shot.path.clone() };
        let plate = find.photo("plate.file", &shot.plate.file, named_colour(shot));
        let Some(mut plate) = plate else { return Err(find.problems) };
        let size = |photo: &Photo| (photo.linear.width(), photo.linear.height());
        if size(&plate) != size(&self.plate) || plate.facts != self.plate.facts {
            return Ok(false);
        }
        // The curve that the bracket showed is this frame's too.
        if let Transfer::Measured(curve) = &self.plate.encoding.transfer {
            plate = plate.redecoded(Transfer::Measured(curve.clone()));
        }
        let local = moved(&self.local, shot.local.iter().map(|keys| &keys.motion), shot)?;
        let objects = moved(&self.objects, shot.objects.iter().map(|keys| &keys.motion), shot)?;
        if let Some(input) = self.inputs.iter_mut().find(|input| **input == self.plate.path) {
            input.clone_from(&plate.path);
        }
        local.into_iter().for_each(|(i, model)| self.local[i] = model);
        objects.into_iter().for_each(|(i, model)| self.objects[i] = model);
        self.plate = plate;
        self.shot = shot.clone();
        self.warnings = self.find_warnings();
        Ok(true)
    }

    /// Whether frames of the sequence show something at different places.
    pub fn moves(&self) -> bool {
        let plate = &self.shot.plate;
        let mut local = self.shot.local.iter().zip(&self.local);
        local.any(|(keys, model)| is_moved(model, &keys.motion, plate))
            || (0..self.objects.len()).any(|i| self.object_moves(i))
    }

    /// Whether frames of the sequence show an object at different places.
    pub fn object_moves(&self, i: usize) -> bool {
        let object = self.shot.objects.get(i).zip(self.objects.get(i));
        object.is_some_and(|(keys, model)| is_moved(model, &keys.motion, &self.shot.plate))
    }

    /// Bytes a run will need at its peak, roughly: what is kept for each pixel, texel and triangle.
    pub fn predicted_bytes(&self) -> u64 {
        /// Plate, its samples, the difference, its replicates and the encoded layers.
        const PER_PIXEL: u64 = 700;
        /// Samples and state of a photograph's pixel, and mean, variance and validity of a bracket's.
        const PER_PROBE_PIXEL: u64 = 40;
        /// Vertices, indices and both trees.
        const PER_TRIANGLE: u64 = 250;
        /// The program, its threads' stacks and a panorama of 2048 × 1024 texels with its tables.
        const BASE: u64 = 300 << 20;
        let pixels = |photo: &Encoded| (photo.width * photo.height) as u64;
        let models = self.support.iter().chain(&self.local).chain(&self.objects);
        let triangles: u64 = models.map(|model| model.n_held_triangles() as u64).sum();
        PER_PIXEL * self.plate.linear.pixels().len() as u64
            + PER_PROBE_PIXEL * self.probe_photos.iter().map(pixels).sum::<u64>()
            + PER_TRIANGLE * triangles
            + BASE
    }

    /// A note on an animation that a single plate does not show.
    fn at_rest(&self, key: &str, i: usize, (motion, model): (&Motion, &Model)) -> Option<Warning> {
        let (first, others) = model.animations.split_first()?;
        motion.time_s(&self.shot.plate).is_none().then(|| {
            let more = match others.len() {
                0 => String::new(),
                n => format!(" and {n} more"),
            };
            Warning::note(
                format!("{key}[{i}].time"),
                format!(
                    "{} has the animation {first:?}{more}, of which a single plate shows nothing; give \
                     time, the second to show",
                    model.name
                ),
                "it stands as its file stores it",
            )
        })
    }

    fn find_warnings(&self) -> Vec<Warning> {
        let mut warnings = Vec::new();
        let pixels = self.plate.linear.pixels().len() as f64;
        let clipped = self.plate.clipped.pixels().iter().filter(|&&c| c).count() as f64 / pixels;
        if clipped > 0.01 {
            warnings.push(Warning::new(
                "plate",
                "part of the plate is clipped; where objects change it, the result is a lower bound",
                format!("{:.1} % of the pixels", 100.0 * clipped),
            ));
        }
        if self.plate.linear.pixels().iter().all(|&l| l == Rgb::ZERO) {
            warnings.push(Warning::new(
                "plate",
                "is black everywhere: surfaces have no colour to be shadowed or lit; check plate.file",
                "every pixel",
            ));
        }
        let probe = self.probe_photos.iter().map(|photo| (&photo.path, &photo.remarks));
        for (path, remarks) in probe.chain([(&self.plate.path, &self.plate.remarks)]) {
            let name = path.display().to_string();
            // Each says itself what it does to the picture.
            warnings.extend(remarks.iter().map(|remark| Warning::new(&name, remark, "")));
        }
        if let Some(bad) = self.plate.nonfinite {
            warnings.push(Warning::new(
                "plate",
                format!(
                    "holds values that are no numbers, first at {:?}; they count as 0",
                    bad.first
                ),
                format!("{} pixels", bad.pixels),
            ));
        }
        let models = self.support.iter().chain(&self.local).chain(&self.objects);
        for model in models {
            let name = &model.name;
            warnings.extend(model.warnings.iter().map(|sentence| {
                Warning::new(name, sentence, "the parts named; the rest is as in the file")
            }));
        }
        let local = self.shot.local.iter().map(|keys| &keys.motion).zip(&self.local);
        let objects = self.shot.objects.iter().map(|keys| &keys.motion).zip(&self.objects);
        warnings.extend(local.enumerate().filter_map(|(i, thing)| self.at_rest("local", i, thing)));
        warnings
            .extend(objects.enumerate().filter_map(|(i, thing)| self.at_rest("object", i, thing)));
        if self.shot.objects.is_empty() {
            warnings.push(Warning::new(
                "object",
                "the shot has no [[object]]; the result is the plate itself",
                "no change",
            ));
        }
        if self.shot.composite.grain == super::file::Grain::Match {
            warnings.push(Warning::new(
                "composite.grain",
                "\"match\" is read but has no effect yet: objects carry no grain",
                "objects look smoother than the plate by its own noise",
            ));
        }
        warnings
    }
}

/// Those of the models that stand elsewhere in the frame of `shot`, with their numbers.
fn moved<'a>(
    models: &[Model],
    motions: impl Iterator<Item = &'a Motion>,
    shot: &ShotFile,
) -> Result<Vec<(usize, Model)>, Vec<String>> {
    let mut moved = Vec::new();
    for (i, (model, motion)) in models.iter().zip(motions).enumerate() {
        if let Some(time_s) = motion.time_s(&shot.plate)
            && is_moved(model, motion, &shot.plate)
        {
            let named = |error| vec![format!("{}: {error}", shot.path.display())];
            moved.push((i, model.at_time(time_s).map_err(named)?));
        }
    }
    Ok(moved)
}

fn is_moved(model: &Model, motion: &Motion, plate: &PlateKeys) -> bool {
    model.played.is_some() && motion.plays(plate)
}

/// The plate's colour space if the shot file names one.
fn named_colour(shot: &ShotFile) -> Option<NamedColour> {
    match &shot.plate.colour {
        PlateColour::Named(name) => name.parse().ok(),
        PlateColour::Auto | PlateColour::Bracket => None,
    }
}

/// Reads the probe's pictures; exposures are `None` after a problem.
fn read_probe(shot: &ShotFile, find: &mut Finder) -> (Vec<Encoded>, Option<Exposures>) {
    let (key, pattern, keys) = match &shot.probe.source {
        ProbeSource::Ball(ball) => ("probe.ball", &ball.photos, &ball.exposures),
        ProbeSource::Fisheye(fisheye) => ("probe.fisheye", &fisheye.photos, &fisheye.exposures),
        ProbeSource::Panorama(panorama) => {
            find.file("probe.panorama.file", &panorama.file);
            let source = "a panorama, taken as radiance";
            return (Vec::new(), Some(Exposures { values: vec![1.0], source }));
        }
        ProbeSource::Sky(_) => {
            let source = "a sky, calculated as radiance";
            return (Vec::new(), Some(Exposures { values: vec![1.0], source }));
        }
    };
    if let ProbeSource::Ball(ball) = &shot.probe.source {
        if let Some(camera) = &ball.camera {
            find.camera("probe.ball.camera", camera);
        }
        if let Some(pose) = &ball.pose {
            find.pose("probe.ball.pose", pose, &shot.camera);
        }
    }
    let photos = find.photos(&format!("{key}.photos"), pattern, None);
    if photos.is_empty() {
        return (photos, None);
    }
    let tied = shot.plate.relative_exposure.is_none();
    match exposures::of_bracket(&photos, keys, tied, key) {
        Ok(exposures) => (photos, Some(exposures)),
        Err(problems) => {
            let file = find.file.display().to_string();
            find.problems.extend(problems.into_iter().map(|p| format!("{file}: {p}")));
            (photos, None)
        }
    }
}

/// A curve recovered from the bracket holds for a plate of the same camera only.
fn check_one_camera(plate: &Photo, bracket: &[Encoded], find: &mut Finder) {
    let key = "plate.colour";
    let remedy = "name a colour space or take \"auto\" instead of \"bracket\"";
    let eight_bit = |samples: &Samples| matches!(samples, Samples::U8 { .. });
    if bracket.len() < 2 {
        let cause = format!("the probe has no bracket that could show a tone curve; {remedy}");
        return find.problem(key, &plate.path, &cause);
    }
    let of_bracket = bracket.iter().map(|photo| (&photo.samples, &photo.path));
    let mut all = [(&plate.samples, &plate.path)].into_iter().chain(of_bracket);
    if let Some((_, path)) = all.find(|(samples, _)| !eight_bit(samples)) {
        let cause = format!("is no 8-bit file; only those have a camera's tone curve; {remedy}");
        find.problem(key, path, &cause);
    }
    let camera = |facts: &Facts| (facts.make.clone(), facts.model.clone());
    if let Some(other) = bracket.iter().find(|photo| camera(&photo.facts) != camera(&plate.facts)) {
        let cause = format!("was taken by another camera than the plate; {remedy}");
        find.problem(key, &other.path, &cause);
    }
}

/// Photographs of the ball through the plate's lens have the plate's size, or are a cut-out.
fn check_ball_frame(shot: &ShotFile, plate: &Photo, photos: &[Encoded], find: &mut Finder) {
    let ProbeSource::Ball(ball) = &shot.probe.source else { return };
    let (width, height) = (plate.linear.width(), plate.linear.height());
    let differs = |photo: &&Encoded| (photo.width, photo.height) != (width, height);
    let Some(photo) = photos.first().filter(differs) else { return };
    if ball.camera.is_none() && ball.crop.is_none() {
        let (w, h) = (photo.width, photo.height);
        let cause = format!(
            "{w} × {h} px, but the plate has {width} × {height} px; if it is a cut-out, say crop = {{ x = …, \
             y = …, scale = … }}; if it is of another camera or setting, describe that as camera"
        );
        find.problem("probe.ball.photos", &photo.path.clone(), &cause);
    }
}

/// A focal length from EXIF must be there.
fn check_exif_camera(shot: &ShotFile, plate: &Photo, find: &mut Finder) {
    if matches!(shot.camera.source, CameraSource::Exif { .. }) && plate.facts.focal_mm.is_none() {
        find.problem(
            "camera.exif_sensor_mm",
            &plate.path,
            "holds no focal length; give camera.focal_mm and sensor_mm instead",
        );
    }
}
