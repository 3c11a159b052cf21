//! What goes wrong with brackets: things that move, missing parts, film's channels, rounded times, ISO.

use super::simulation::*;
use super::*;
use crate::photo::{Encoded, Samples};

/// Where a thing stands that is in one frame only, px.
const THING: (std::ops::Range<usize>, std::ops::Range<usize>) = (100..140, 60..95);

fn in_thing(i: usize) -> bool {
    THING.0.contains(&(i % WIDTH)) && THING.1.contains(&(i / WIDTH))
}

/// F20: somebody walks through one exposure of the bracket.
#[test]
fn what_moved_is_found_and_taken_from_one_frame() {
    // Blocks of 20 px: edges are no motion, and tell nothing of it.
    let block = |i: usize| (i / WIDTH / 20) * (WIDTH / 20) + i % WIDTH / 20;
    let scene: Vec<f64> = (0..WIDTH * HEIGHT).map(|i| radiance(block(i), 3.0, 2.0)).collect();
    let with_thing: Vec<f64> =
        scene.iter().enumerate().map(|(i, &l)| if in_thing(i) { 0.15 } else { l }).collect();
    let mut random = Random(15);
    let exposures: Vec<f64> = (0..5).map(|k| 4f64.powi(-k)).collect();
    let shots = exposures.iter().enumerate();
    let photos: Vec<Encoded> = shots
        .map(|(k, &t)| {
            let seen = if k == 1 { &with_thing } else { &scene };
            shoot(seen, t, &mut random, straight)
        })
        .collect();
    let options = MergeOptions { noise: Some(EXACT), ..MergeOptions::default() };
    let merged = merge(&frames(&photos, &exposures), &options).unwrap();
    let moved = |i: usize| merged.radiance.validity.pixels()[i] == Validity::Moved;
    // Only where the thing's light differs by more than curve and noise allow can it be told.
    let differs = |i: &usize| in_thing(*i) && (scene[*i] / 0.15).ln().abs() > 0.5;
    let (found, n) = (0..scene.len())
        .filter(differs)
        .fold((0, 0), |(found, n), i| (found + usize::from(moved(i)), n + 1));
    let false_alarms = (0..scene.len())
        .filter(|&i| {
            let (x, y) = (i % WIDTH, i / WIDTH);
            let near = (x + 4 >= THING.0.start && x < THING.0.end + 4)
                && (y + 4 >= THING.1.start && y < THING.1.end + 4);
            !near && moved(i)
        })
        .count();
    eprintln!("{found} of {n} px found, {false_alarms} false");
    assert!(found as f64 > 0.9 * n as f64, "{found} of {n}");
    assert_eq!(false_alarms, 0);
    // What is taken is one of the two scenes, not a mixture.
    for i in (0..scene.len()).filter(|&i| moved(i)) {
        let x = f64::from(merged.radiance.mean.pixels()[i].y);
        let off = |l: f64| (x / l - 1.0).abs();
        let nearest = off(scene[i]).min(off(with_thing[i]));
        assert!(nearest < 0.15, "pixel {i}: {x} is neither {} nor 0.15", scene[i]);
    }
    assert!(merged.warnings.iter().any(|w| matches!(w, Warning::Ghosts { .. })));
    let still = MergeOptions { drop_ghosts: false, ..options };
    let mixed = merge(&frames(&photos, &exposures), &still).unwrap();
    assert!(!mixed.radiance.validity.pixels().contains(&Validity::Moved));
}

#[test]
fn a_still_scene_has_no_ghosts() {
    let scene = patches(5e4, 7.7);
    let (photos, exposures) = bracket(&scene, 16);
    let merged = merge(&frames(&photos, &exposures), &MergeOptions::default()).unwrap();
    assert!(!merged.radiance.validity.pixels().contains(&Validity::Moved));
}

/// Debevec's aligned photographs are blue where they hold no picture.
#[test]
fn what_no_frame_shows_is_black_and_a_lower_bound() {
    let scene = wide_scene();
    let (mut photos, exposures) = bracket(&scene, 17);
    for photo in &mut photos {
        let Samples::U8 { data, .. } = &mut photo.samples else { panic!("8-bit") };
        for y in 0..HEIGHT {
            data[y * WIDTH * 3..][..9].copy_from_slice(&[0, 0, 255].repeat(3));
        }
    }
    let merged = merge(&frames(&photos, &exposures), &MergeOptions::default()).unwrap();
    for y in 0..HEIGHT {
        for x in 0..3 {
            assert_eq!(merged.radiance.mean[(x, y)], Rgb::ZERO);
            assert_eq!(merged.radiance.validity[(x, y)], Validity::LowerBound);
        }
    }
    let clipped = |w: &Warning| matches!(w, Warning::ClippedInShortest { first: (0..3, _), .. });
    assert!(!merged.warnings.iter().any(clipped), "no picture is not clipped");
}

/// Film scans: each channel has a curve of its own, and a bright red says nothing of blue.
#[test]
fn channels_with_curves_of_their_own_get_them() {
    let scene = patches(30.0, 4.0);
    let mut random = Random(18);
    let exposures: Vec<f64> = (0..6).map(|k| 3f64.powi(-k)).collect();
    let curves: [fn(f64) -> f64; 3] = [|y| y.powf(0.7), s_curve, |y| y.powf(1.2)];
    let photos: Vec<Encoded> = exposures
        .iter()
        .map(|&t| {
            let mut apart = curves.map(|curve| shoot(&scene, t, &mut random, curve));
            let of = |photo: &Encoded| match &photo.samples {
                Samples::U8 { data, .. } => data.clone(),
                _ => panic!("8-bit"),
            };
            let channels = apart.each_ref().map(of);
            let data = (0..scene.len() * 3).map(|i| channels[i % 3][i]).collect();
            apart[0].samples = Samples::U8 { channels: 3, data };
            apart[0].clone()
        })
        .collect();
    let merged = merge(&frames(&photos, &exposures), &MergeOptions::default()).unwrap();
    let response = merged.response.as_ref().unwrap();
    assert!(response.per_channel, "{response:?}");
    eprintln!("{} {:.4}", response.method, response.held_out);
    // Each channel is the scene's light up to a factor of its own, to 5 % in the median.
    for channel in 0..3 {
        let mut logs: Vec<f64> = (0..scene.len())
            .filter(|&i| scene[i] > 0.05)
            .map(|i| (f64::from(merged.radiance.mean.pixels()[i][channel]) / scene[i]).ln())
            .collect();
        logs.sort_unstable_by(f64::total_cmp);
        let middle = logs[logs.len() / 2];
        let mut off: Vec<f64> = logs.iter().map(|l| (l - middle).abs()).collect();
        off.sort_unstable_by(f64::total_cmp);
        eprintln!("channel {channel}: median deviation {:.4}", off[off.len() / 2]);
        assert!(off[off.len() / 2] < 0.05, "channel {channel}: {}", off[off.len() / 2]);
    }
}

/// Shutters run in thirds of a stop, whatever is engraved.
#[test]
fn engraved_times_are_snapped_to_whole_thirds_where_the_pixels_agree() {
    let scene = wide_scene();
    let mut random = Random(19);
    let truth: Vec<f64> = (3..8).map(|k| 2f64.powi(-k)).collect();
    let photos: Vec<Encoded> =
        truth.iter().map(|&t| shoot(&scene, t * 8.0, &mut random, straight)).collect();
    let engraved = [1.0 / 8.0, 1.0 / 15.0, 1.0 / 30.0, 1.0 / 60.0, 1.0 / 125.0];
    let merged = merge(&frames(&photos, &engraved), &MergeOptions::default()).unwrap();
    for pair in merged.exposures.windows(2) {
        assert!((pair[0] / pair[1] - 2.0).abs() < 1e-9, "{:?}", merged.exposures);
    }
    let sigma = merged.sigma_exposures[0].unwrap();
    assert!(sigma < 1e-3, "the longest's ratio is known to {sigma}");
}

/// A telephone in the dark makes the shutter longer and the ISO lower.
#[test]
fn an_iso_that_cancels_the_shutter_is_told_and_counted() {
    let scene = wide_scene();
    let mut random = Random(20);
    let settings = [(1.0, 20.0), (0.25, 80.0), (1.0 / 16.0, 256.0)];
    let photos: Vec<Encoded> = settings
        .iter()
        .map(|(time_s, iso)| {
            let mut photo = shoot(&scene, time_s * iso / 20.0, &mut random, straight);
            photo.facts.exposure_s = Some(*time_s);
            photo.facts.iso = Some(*iso);
            photo.facts.f_number = Some(2.0);
            photo
        })
        .collect();
    let exposures = exposure::from_exif(&photos).unwrap();
    assert!((exposures[2] / exposures[0] - 0.8).abs() < 1e-12, "{exposures:?}");
    let merged = merge(&frames(&photos, &exposures), &MergeOptions::default()).unwrap();
    let told = |w: &Warning| matches!(w, Warning::IsoCancels { shutter, .. } if *shutter == 4.0);
    assert!(merged.warnings.iter().any(told), "{:?}", merged.warnings);
}
