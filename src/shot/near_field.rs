//! Light from near by: which walls and lamps of the shot file are near enough to matter, and these.
//!
//! Methods-render R10.2: treating light at distance d as distant is wrong by 2.7 · t/d on something t
//! from the probe. Above 5 % it is put in its place; below, it stays in the panorama and a note says
//! how little is lost. What cannot be put in its place stays distant, and a warning says why.

use glam::{DVec3, Vec3};

use super::clipped_light::Cleared;
use super::light::Setting;
use super::place;
use super::plan::Plan;
use super::probe_keys::{ProbeSource, Surroundings};
use crate::light::near_field::{distant_error, is_near};
use crate::light::{Disc, Lamp, NoLamp, Proxy, take_out_lamp};
use crate::probe::Panorama;
use crate::report::{self, LampReport, Warning};
use crate::scene::{Mesh, Model, Scene};
use crate::trace::{Accel, Ray};

/// Walls and lamps that are put in their place, and what is to be said of all of them.
#[derive(Default)]
pub struct NearField {
    pub proxy: Option<Proxy>,
    pub lamps: Vec<Lamp>,
    /// Of each that clipped in every exposure, and is as weak as the probe saw it, where that was.
    pub clipped_lamps: Vec<Option<Cleared>>,
    pub warnings: Vec<Warning>,
    /// How `[surroundings]` are treated, and why; empty without.
    pub surroundings: String,
    pub lamp_reports: Vec<LampReport>,
    /// Largest relative error of irradiance from what is still treated as distant; `None` if the shot
    /// tells of nothing that is.
    pub distant_error: Option<f64>,
}

/// A lamp seen farther beside its place than this share of its radius, and than a mirror ball's own
/// parallax, was measured badly.
const BESIDE: f64 = 0.5;
/// More of the sphere than this behind the walls' holes is worth a word.
const OPEN: f64 = 0.05;

impl NearField {
    /// Judges walls and lamps and takes near lamps out of the panorama. Recovered `suns` that were
    /// lamps go with them.
    ///
    /// # Errors
    /// A sentence with key and remedy: the probe stands where it cannot have seen this light.
    pub fn find(
        setting: &Setting,
        panorama: &mut Panorama,
        suns: &mut Vec<(Disc, f64)>,
    ) -> Result<Self, String> {
        let mut near = Self::default();
        let reach = reach(setting.plan, panorama.place);
        near.walls(setting, panorama.place, reach)?;
        for k in 0..setting.plan.shot.lamps.len() {
            near.lamp(k, setting, panorama, suns, reach)?;
        }
        Ok(near)
    }

    fn walls(&mut self, setting: &Setting, probe: DVec3, reach: f64) -> Result<(), String> {
        let Some(keys) = &setting.plan.shot.surroundings else { return Ok(()) };
        let centre = setting.scene.from_world(probe);
        let (key, proxy) = match keys {
            Surroundings::Box { min, max } => {
                let corner = |p: [f64; 3]| setting.scene.from_world(p.into());
                let proxy = Proxy::of_box(centre, corner(*min), corner(*max));
                ("surroundings.box", Some(proxy.ok_or_else(|| not_in_the_box(probe, *min, *max))?))
            }
            Surroundings::Mesh(_) => {
                let meshes = setting.plan.surroundings.as_ref().map(|m| meshes(m, setting.scene));
                ("surroundings.mesh", meshes.and_then(|meshes| Proxy::of_mesh(centre, meshes)))
            }
        };
        let Some((proxy, distance)) = proxy.and_then(|p| p.nearest_wall().map(|d| (p, d))) else {
            self.stays(1.0);
            self.surroundings = "treated as infinitely far away".to_owned();
            self.warnings.push(Warning::new(
                key,
                "no wall of it stands beside or above the probe, so that nobody knows where the light \
                 comes from; correct it, or the probe's place",
                "light on the objects off by 100 % or more",
            ));
            return Ok(());
        };
        let distance = f64::from(distance);
        let error = distant_error(reach, distance);
        let facts = format!(
            "the nearest wall is {distance:.2} m from the probe and the objects reach {reach:.2} m from it"
        );
        if !is_near(reach, distance) {
            self.stays(error);
            self.surroundings = format!("far enough to be treated as infinitely far away: {facts}");
            self.warnings.push(far_enough(key, &facts, error));
            return Ok(());
        }
        self.surroundings = format!(
            "light lies on the walls: {facts}; as distant light it would be off by {}",
            per_cent(error)
        );
        self.warnings.extend(outside(key, &proxy, setting));
        self.warnings.extend(open(key, &proxy));
        self.proxy = Some(proxy);
        Ok(())
    }

    fn lamp(
        &mut self,
        k: usize,
        setting: &Setting,
        panorama: &mut Panorama,
        suns: &mut Vec<(Disc, f64)>,
        reach: f64,
    ) -> Result<(), String> {
        let keys = setting.plan.shot.lamps[k];
        let (key, at) = (format!("lamp[{k}]"), DVec3::from(keys.at));
        self.warnings.extend(behind_the_walls(&key, at, &setting.plan.shot.surroundings));
        let distance = panorama.place.distance(at) - keys.radius;
        let error = distant_error(reach, distance);
        let mut report =
            LampReport { at_m: keys.at, radius_m: keys.radius, ..LampReport::default() };
        let facts = format!(
            "the lamp is {distance:.2} m from the probe and the objects reach {reach:.2} m from it"
        );
        if !is_near(reach, distance) {
            self.stays(error);
            report.treated = format!("far enough to be treated as infinitely far away: {facts}");
            self.lamp_reports.push(report);
            self.warnings.push(far_enough(&key, &facts, error));
            return Ok(());
        }
        let hidden = hides(&setting.shown.local, setting.scene, panorama.place, at, keys.radius);
        let probe_radius = probe_radius(setting.plan);
        let taken = if hidden {
            Err(NoLamp::Unseen)
        } else {
            take_out_lamp(panorama, at, keys.radius, probe_radius)
        };
        let taken = match taken {
            Ok(taken) => taken,
            Err(why @ NoLamp::Inside) => return Err(format!("{key}: {}", cause(why, hidden))),
            Err(why) => {
                self.stays(error);
                report.treated = "not found in the panorama".to_owned();
                self.lamp_reports.push(report);
                self.warnings.push(not_found(&key, why, hidden, error));
                return Ok(());
            }
        };
        let lamp = Lamp {
            centre: setting.scene.from_world(at),
            radius: keys.radius as f32,
            radiance: taken.radiance,
        };
        let away = panorama.place.distance(at);
        report.beside_deg = taken.off_rad.to_degrees();
        if taken.off_rad > (BESIDE * keys.radius + probe_radius) / away {
            self.warnings.push(beside(&key, taken.off_rad, away));
        }
        let n_suns = suns.len();
        let lamp = with_suns(lamp, setting.scene.from_world(panorama.place), suns);
        // A sun that was recovered where it stands is its light already.
        let weak = taken.clipped && suns.len() == n_suns;
        self.clipped_lamps.push(weak.then_some(taken.cleared));
        report.treated = format!("put in its place: {facts}");
        report.radiance = lamp.radiance.as_dvec3().to_array();
        report.in_place = true;
        self.lamp_reports.push(report);
        self.lamps.push(lamp);
        Ok(())
    }

    /// Something is left as distant light, with this error.
    fn stays(&mut self, error: f64) {
        let error = error.min(1.0);
        self.distant_error = Some(self.distant_error.map_or(error, |other| other.max(error)));
    }
}

/// A lamp with the light of the recovered suns that stood where it stands.
fn with_suns(mut lamp: Lamp, place: Vec3, suns: &mut Vec<(Disc, f64)>) -> Lamp {
    let to = (lamp.centre - place).normalize_or_zero();
    let own = (lamp.radius / place.distance(lamp.centre)).min(1.0).asin();
    suns.retain(|(sun, _)| {
        let is_it = sun.direction.angle_between(to) < own + sun.half_angle;
        if is_it {
            lamp.radiance += sun.radiance * (sun.solid_angle() / lamp.solid_angle(place));
        }
        !is_it
    });
    lamp
}

fn far_enough(key: &str, facts: &str, error: f64) -> Warning {
    let said = Warning::new(
        key,
        format!("{facts}: far enough, its light is treated as infinitely far away"),
        format!("light on the objects off by up to {}", per_cent(error)),
    );
    Warning { asks: false, ..said }
}

fn not_in_the_box(probe: DVec3, min: [f64; 3], max: [f64; 3]) -> String {
    let place = |p: [f64; 3]| p.map(|x| format!("{x:.2}")).join(", ");
    format!(
        "surroundings.box: the probe stands at ({}) m, outside the box from ({}) to ({}) or on a wall of \
         it, and saw its walls from there; correct the box, or the probe's place",
        place(probe.to_array()),
        place(min),
        place(max)
    )
}

/// A box has no window through which a lamp could shine.
fn behind_the_walls(key: &str, at: DVec3, surroundings: &Option<Surroundings>) -> Option<Warning> {
    let Some(Surroundings::Box { min, max }) = surroundings else { return None };
    let inside = at.cmpge(DVec3::from(*min)).all() && at.cmple(DVec3::from(*max)).all();
    (!inside).then(|| {
        Warning::new(
            key,
            "the lamp stands outside the box of [surroundings], behind its walls, and lights what is in \
             it all the same; correct its place, or make the box as large as the room",
            "its light and the walls' come from places that cannot both be right",
        )
    })
}

/// Why a lamp stays in the panorama, and what to do.
fn cause(why: NoLamp, hidden: bool) -> String {
    match why {
        NoLamp::Inside => {
            "the probe stands inside this lamp; correct its place or radius".to_owned()
        }
        NoLamp::Unseen if hidden => "a modelled thing stands between the probe and this lamp, so that \
             the panorama does not show it; correct its place, or photograph the probe from where the \
             lamp is seen"
            .to_owned(),
        NoLamp::Unseen => "the probe saw less than half of where this lamp should be; correct its \
             place, or photograph the probe from another side"
            .to_owned(),
        NoLamp::NotHot { excess, surroundings } => format!(
            "the panorama shows nothing brighter than its surroundings where this lamp should be \
             ({excess:.3} above {surroundings:.3}); correct its place (overlay_panorama.png shows \
             where lights are), or take it out if it is off"
        ),
    }
}

fn not_found(key: &str, why: NoLamp, hidden: bool, error: f64) -> Warning {
    let cause = cause(why, hidden);
    let rest = "its light, wherever it is in the panorama, is treated as infinitely far away";
    Warning::new(
        key,
        format!("{cause}; {rest}"),
        format!("its light on the objects off by {}", per_cent(error)),
    )
}

fn beside(key: &str, off_rad: f64, distance: f64) -> Warning {
    Warning::new(
        key,
        format!(
            "the panorama shows this lamp {:.1}° beside where it should be; measure its place again, \
             or the probe's, and look at the rim in overlay_ball.png",
            off_rad.to_degrees()
        ),
        format!(
            "{:.3} m at its distance of {distance:.2} m; shadows turn by as much",
            off_rad * distance
        ),
    )
}

/// Objects beyond the box see distant light.
fn outside(key: &str, proxy: &Proxy, setting: &Setting) -> Option<Warning> {
    let [min, max] = place::object_box(setting.plan)?;
    let corner = |k: usize| {
        let pick = |axis: usize| if k >> axis & 1 == 0 { min[axis] } else { max[axis] };
        setting.scene.from_world(DVec3::new(pick(0), pick(1), pick(2)))
    };
    let outside = (0..8).filter(|&k| !proxy.holds(corner(k))).count();
    (outside > 0).then(|| {
        Warning::new(
            key,
            "part of the objects stands outside the box: there, light is treated as infinitely far \
             away; make the box as large as the room",
            format!("{outside} of the 8 corners of the objects' box"),
        )
    })
}

/// Rays that miss the walls see distant light.
fn open(key: &str, proxy: &Proxy) -> Option<Warning> {
    let share = proxy.open_share();
    (share > OPEN).then(|| {
        let said = Warning::new(
            key,
            "the walls are open: what the probe sees through the holes is treated as infinitely far \
             away, as a landscape behind a window is; close them if it is near",
            format!("{:.0} % of the upper half sphere", 100.0 * share),
        );
        Warning { asks: false, ..said }
    })
}

/// True if a modelled thing stands between the probe and a lamp.
fn hides(local: &Accel, scene: &Scene, probe: DVec3, at: DVec3, radius: f64) -> bool {
    let to = at - probe;
    let t_max = (to.length() - radius) as f32;
    let direction = to.normalize_or(DVec3::Y).as_vec3();
    local.occluded(&Ray { t_max, ..Ray::new(scene.from_world(probe), direction) })
}

/// A model's triangles in the scene's frame.
fn meshes(model: &Model, scene: &Scene) -> Vec<Mesh> {
    let placed = model.meshes.iter().map(|mesh| Mesh {
        name: mesh.name.clone(),
        positions: mesh.positions.iter().map(|&p| scene.from_world(p)).collect(),
        triangles: mesh.triangles.clone(),
        ..Mesh::default()
    });
    placed.collect()
}

/// How far from its middle a probe sees: a ball mirrors at its surface.
fn probe_radius(plan: &Plan) -> f64 {
    match &plan.shot.probe.source {
        ProbeSource::Ball(ball) => ball.radius,
        ProbeSource::Fisheye(_) | ProbeSource::Panorama(_) | ProbeSource::Sky(_) => 0.0,
    }
}

/// Largest distance from the probe to a corner of the box that the objects are in in all frames, metres;
/// 0 without objects.
fn reach(plan: &Plan, probe: DVec3) -> f64 {
    let Some([min, max]) = place::swept_box(plan) else { return 0.0 };
    let far = (probe - min).abs().max((max - probe).abs());
    far.length()
}

fn per_cent(error: f64) -> String {
    if error < 1.0 { report::per_cent(error) } else { "100 % or more".to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::conventions::Rgb;
    use crate::scene::{AlbedoSource, LocalMesh, LocalRole};

    /// A level table of 2 m at y = 0.
    fn table() -> Scene {
        let corners = [(-1.0, -1.0), (-1.0, 1.0), (1.0, 1.0), (1.0, -1.0)];
        let mesh = Mesh {
            positions: corners.map(|(x, z)| Vec3::new(x, 0.0, z)).to_vec(),
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Mesh::default()
        };
        let albedo = AlbedoSource::Plate;
        Scene {
            local: vec![LocalMesh { mesh, role: LocalRole::Support, albedo }],
            ..Scene::default()
        }
    }

    #[test]
    fn a_lamp_under_the_table_is_hidden_and_one_above_it_is_not() {
        let scene = table();
        let local = Accel::build(&[&scene.local[0].mesh]);
        let probe = DVec3::Y * 0.06;
        assert!(hides(&local, &scene, probe, DVec3::new(0.5, -0.4, 0.0), 0.05));
        assert!(!hides(&local, &scene, probe, DVec3::new(0.5, 0.4, 0.0), 0.05));
        let said = not_found("lamp[0]", NoLamp::Unseen, true, 0.6);
        assert!(said.asks && said.message.contains("correct its place"), "{said}");
        assert!(said.size.contains("60 %"), "{said}");
    }

    #[test]
    fn a_recovered_sun_where_a_lamp_stands_is_the_lamp_s_light() {
        let lamp = Lamp { centre: Vec3::X, radius: 0.05, radiance: Rgb::ONE };
        let disc = |direction| Disc::from_irradiance(direction, 0.02, Rgb::splat(0.3));
        let mut suns = vec![(disc(Vec3::X), 0.1), (disc(Vec3::Y), 0.2)];
        let lit = with_suns(lamp, Vec3::ZERO, &mut suns);
        assert_eq!(suns.len(), 1, "the other one is no lamp");
        // Its irradiance on a plane that faces it is what both gave.
        let (before, after) = (
            lamp.irradiance(Vec3::ZERO, Vec3::X) + Rgb::splat(0.3),
            lit.irradiance(Vec3::ZERO, Vec3::X),
        );
        assert!((after / before - 1.0).abs().max_element() < 2e-3, "{before} {after}");
    }

    #[test]
    fn what_is_far_enough_is_a_note_and_what_is_not_found_a_warning() {
        let note = far_enough("surroundings.box", "the nearest wall is 50.00 m away", 0.01);
        assert!(!note.asks && note.size.contains("1.0 %"), "{note}");
        let why = NoLamp::NotHot { excess: 0.001, surroundings: 0.4 };
        let cold = not_found("lamp[1]", why, false, 2.0);
        assert!(cold.asks && cold.message.contains("take it out if it is off"), "{cold}");
        assert!(cold.size.contains("100 % or more"), "{cold}");
        let off = beside("lamp[0]", 0.02, 0.75);
        assert!(off.message.contains("1.1°") && off.size.contains("0.015 m"), "{off}");
    }
}
