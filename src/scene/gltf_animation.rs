//! glTF's animations: which there are, and one of them as the keyframes of nodes.
//!
//! The crate neither checks the targets of channels nor finds a sampler without a walk over all of
//! them; here the document's own lists are read, and every number is judged.

use std::collections::BTreeMap;
use std::path::Path;

use gltf::json;
use gltf::json::Value;
use gltf::json::animation::{Interpolation as Named, Property};
use gltf::json::validation::Checked;

use super::SceneError;
use super::animation::{Interpolation, Key, Keyframes};
use super::buffers::Buffers;
use super::hierarchy::Moves;

/// Characters of a name that messages show, and names.
const SHOWN: usize = 60;
const SHOWN_NAMES: usize = 12;

/// What moves the nodes, by their numbers, and what of the animation is not read.
#[derive(Default)]
pub(super) struct Played {
    pub moves: BTreeMap<usize, Moves>,
    pub warnings: Vec<String>,
}

/// Channels that only an extension understands have no node (3.11), which the crate insists on: they
/// get one, and a property that nobody knows.
pub(super) fn mark_channels_without_node(document: &mut Value) {
    let animations = document.get_mut("animations").and_then(Value::as_array_mut);
    for animation in animations.into_iter().flatten() {
        let channels = animation.get_mut("channels").and_then(Value::as_array_mut);
        for channel in channels.into_iter().flatten() {
            let target = channel.get_mut("target").and_then(Value::as_object_mut);
            if let Some(target) = target.filter(|target| !target.contains_key("node")) {
                target.insert("node".into(), 0.into());
                target.insert("path".into(), "".into());
            }
        }
    }
}

/// The animations' names in the file's order; `animations[2]` for one without.
pub(super) fn names(document: &gltf::Document) -> Vec<String> {
    let animations = document.as_json().animations.iter().enumerate();
    let name = |(i, animation): (usize, &json::Animation)| {
        animation.name.clone().unwrap_or_else(|| format!("animations[{i}]"))
    };
    animations.map(name).collect()
}

/// Reads the animation called `asked`, or the first.
///
/// # Errors
/// [`SceneError::NoAnimation`] if there is none called so; whatever is broken in it, with its place.
/// A file without any moves nothing.
pub(super) fn read(
    path: &Path,
    document: &gltf::Document,
    buffers: &Buffers,
    asked: Option<&str>,
) -> Result<Played, SceneError> {
    let names = names(document);
    let found = match asked {
        Some(asked) => names.iter().position(|name| name == asked),
        None => Some(0),
    };
    let Some(number) = found else {
        return Err(no_animation(path, asked.unwrap_or_default(), &names));
    };
    let Some(animation) = document.as_json().animations.get(number) else {
        return Ok(Played::default());
    };
    let reader = Reader { path, document, buffers, accessors: document.accessors().collect() };
    reader.animation(number, animation)
}

/// An error that names the animations there are.
pub(super) fn no_animation(path: &Path, asked: &str, names: &[String]) -> SceneError {
    let short = |name: &str| name.chars().take(SHOWN).collect::<String>();
    let listed: Vec<String> =
        names.iter().take(SHOWN_NAMES).map(|name| format!("{:?}", short(name))).collect();
    let more = names.len().saturating_sub(SHOWN_NAMES);
    let known = match (names.len(), more) {
        (0, _) => "it has none; export them too, or ask for none".to_owned(),
        (_, 0) => format!("it has {}", listed.join(", ")),
        (_, more) => format!("it has {} and {more} more", listed.join(", ")),
    };
    SceneError::NoAnimation { path: path.into(), asked: short(asked), known }
}

/// What a channel moves a property of.
struct Target {
    /// The node's number, not yet checked.
    node: usize,
    /// The channel's place in the file.
    place: String,
}

struct Reader<'a> {
    path: &'a Path,
    document: &'a gltf::Document,
    buffers: &'a Buffers<'a>,
    accessors: Vec<gltf::Accessor<'a>>,
}

impl Reader<'_> {
    fn animation(&self, number: usize, animation: &json::Animation) -> Result<Played, SceneError> {
        let mut played = Played::default();
        let (mut n_unknown, mut n_repeated) = (0, 0);
        for (i, channel) in animation.channels.iter().enumerate() {
            let place = format!("animations[{number}].channels[{i}]");
            let Checked::Valid(property) = channel.target.path else {
                n_unknown += 1;
                continue;
            };
            let sampler = animation.samplers.get(channel.sampler.value()).ok_or_else(|| {
                let (found, n) = (channel.sampler.value(), animation.samplers.len());
                self.broken(&format!("{place}.sampler"), format!("sampler {found} of {n}"))
            })?;
            let target = Target { node: channel.target.node.value(), place };
            let moves = played.moves.entry(target.node).or_default();
            let is_first = match property {
                Property::Translation => {
                    self.first_keys(&mut moves.translation, sampler, &target, "translation")?
                }
                Property::Rotation => {
                    self.first_keys(&mut moves.rotation, sampler, &target, "rotation")?
                }
                Property::Scale => self.first_keys(&mut moves.scale, sampler, &target, "scale")?,
                // Told with the mesh that has the targets.
                Property::MorphTargetWeights => continue,
            };
            n_repeated += usize::from(!is_first);
        }
        let n = animation.channels.len();
        for (count, what) in [
            (n_unknown, "move something that is not known here"),
            (n_repeated, "move what an earlier one moves"),
        ] {
            if count > 0 {
                let place = format!("animations[{number}]");
                let said = format!("{place}: {count} of {n} channels {what}; they are left out");
                played.warnings.push(said);
            }
        }
        Ok(played)
    }

    /// Reads what moves a property, unless an earlier channel moves it: false.
    fn first_keys<V: Key + From<[f64; N]>, const N: usize>(
        &self,
        property: &mut Option<Keyframes<V>>,
        sampler: &json::animation::Sampler,
        target: &Target,
        name: &str,
    ) -> Result<bool, SceneError> {
        self.check(target)?;
        if property.is_some() {
            return Ok(false);
        }
        let place = format!("{} ({name} of nodes[{}])", target.place, target.node);
        *property = Some(self.keys(sampler, &place)?);
        Ok(true)
    }

    /// Whether there is such a node, and it may be moved.
    fn check(&self, Target { node: number, place }: &Target) -> Result<(), SceneError> {
        let nodes = &self.document.as_json().nodes;
        let Some(node) = nodes.get(*number) else {
            let problem = format!("node {number} of {}", nodes.len());
            return Err(self.broken(&format!("{place}.target.node"), problem));
        };
        if node.matrix.is_some() {
            let problem = format!(
                "{place} moves it, but it has a matrix instead of translation, rotation and scale"
            );
            return Err(self.broken(&format!("nodes[{number}]"), problem));
        }
        Ok(())
    }

    /// A sampler's keyframes with values of `N` components.
    fn keys<V: Key + From<[f64; N]>, const N: usize>(
        &self,
        sampler: &json::animation::Sampler,
        place: &str,
    ) -> Result<Keyframes<V>, SceneError> {
        let accessor = |index: usize| {
            let n = self.accessors.len();
            let found = self.accessors.get(index);
            found.ok_or_else(|| self.broken(place, format!("accessor {index} of {n}")))
        };
        let Checked::Valid(interpolation) = sampler.interpolation else {
            let problem = "its interpolation is none of STEP, LINEAR and CUBICSPLINE".into();
            return Err(self.broken(place, problem));
        };
        let interpolation = match interpolation {
            Named::Step => Interpolation::Step,
            Named::Linear => Interpolation::Linear,
            Named::CubicSpline => Interpolation::CubicSpline,
        };
        let (input, output) = (accessor(sampler.input.value())?, accessor(sampler.output.value())?);
        let times = self.buffers.floats::<1>(input, "keyframe times")?;
        let values = self.buffers.floats::<N>(output, "keyframe values")?;
        let times = times.into_iter().map(|[time]| time).collect();
        let values = values.into_iter().map(|v| V::from(v.map(f64::from))).collect();
        let keys = Keyframes::new(interpolation, times, values);
        keys.map_err(|problem| self.broken(place, problem))
    }

    fn broken(&self, place: &str, problem: String) -> SceneError {
        SceneError::Broken { path: self.path.into(), place: place.into(), problem }
    }
}
