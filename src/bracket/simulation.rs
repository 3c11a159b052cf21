//! A simulated camera, and the bracket room's promises tested on it (methods-capture C3).
//!
//! electrons = Poisson(L·t·FW) + N(0, RN²); code = round(curve(electrons/FW)). All seeds are fixed;
//! each statistical test says how often a right program would fail it with another seed.

use super::exposure;
use super::*;
use crate::photo::{Encoded, Format, Photo, Samples, Transfer};

pub(super) const WIDTH: usize = 300;
pub(super) const HEIGHT: usize = 200;
const FULL_WELL: f64 = 40_000.0;
const READ_NOISE: f64 = 6.0;

/// A small generator (SplitMix64, Steele et al. 2014): tests need no more.
pub(super) struct Random(pub(super) u64);

impl Random {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }

    fn poisson(&mut self, mean: f64) -> f64 {
        if mean > 500.0 {
            return (mean + mean.sqrt() * self.normal()).round();
        }
        let limit = (-mean).exp();
        let (mut n, mut product) = (0.0, self.uniform());
        while product > limit {
            product *= self.uniform();
            n += 1.0;
        }
        n
    }
}

/// Radiance of pixel `i`: log-uniform over `decades` up to `top`, in scattered order.
pub(super) fn radiance(i: usize, top: f64, decades: f64) -> f64 {
    let u = (i as f64 * 0.754_877_666_246_693 + 0.3).fract();
    top * 10f64.powf(decades * (u - 1.0))
}

/// An 8-bit sRGB photograph of `scene` at exposure `t`, optionally through a further tone curve.
pub(super) fn shoot(scene: &[f64], t: f64, random: &mut Random, curve: fn(f64) -> f64) -> Encoded {
    let mut data = Vec::with_capacity(scene.len() * 3);
    for l in scene {
        for _ in 0..3 {
            let electrons = random.poisson(l * t * FULL_WELL) + READ_NOISE * random.normal();
            let y = curve((electrons / FULL_WELL).clamp(0.0, 1.0)) as f32;
            data.push((Transfer::Srgb.encode(y) * 255.0).round() as u8);
        }
    }
    let mut photo = Photo::from_linear(Image::filled(WIDTH, HEIGHT, Rgb::ZERO)).encoded();
    photo.encoding.transfer = Transfer::Srgb;
    photo.format = Format::Png;
    photo.samples = Samples::U8 { channels: 3, data };
    photo
}

pub(super) fn straight(y: f64) -> f64 {
    y
}

/// Nine frames two stops apart; the longest has exposure 1.
pub(super) fn bracket(scene: &[f64], seed: u64) -> (Vec<Encoded>, Vec<f64>) {
    let mut random = Random(seed);
    let exposures: Vec<f64> = (0..9).map(|k| 4f64.powi(-k)).collect();
    let photos = exposures.iter().map(|&t| shoot(scene, t, &mut random, straight)).collect();
    (photos, exposures)
}

pub(super) fn frames<'a>(photos: &'a [Encoded], exposures: &[f64]) -> Vec<Frame<'a>> {
    photos.iter().zip(exposures).map(|(photo, &exposure)| Frame { photo, exposure }).collect()
}

/// 7.7 decades, from 10⁻³ of the longest frame's saturation to the shortest frame's.
pub(super) fn wide_scene() -> Vec<f64> {
    (0..WIDTH * HEIGHT).map(|i| radiance(i, 5e4, 7.7)).collect()
}

pub(super) const EXACT: Noise =
    Noise { full_well_e: FULL_WELL, read_noise_e: READ_NOISE, measured: true };

#[test]
fn bias_and_scatter_in_each_decade_are_those_of_the_poisson_estimator() {
    let scene = wide_scene();
    let (photos, exposures) = bracket(&scene, 1);
    let options = MergeOptions {
        refine_exposures: false,
        align: false,
        noise: Some(EXACT),
        ..MergeOptions::default()
    };
    let merged = merge(&frames(&photos, &exposures), &options).unwrap();
    // Decade, most bias and most scatter allowed: the table of methods-capture C3 with a fifth of
    // room for scatter. About 23 000 samples a decade: the bias is known to 0.02 % or better, so a
    // right program fails at 0.5 % (F15) practically never.
    for (low, most_bias, most_rms) in [
        (1e-3, 0.02, 0.17),
        (1e-2, 0.005, 0.039),
        (1e-1, 0.005, 0.0116),
        (1.0, 0.005, 0.0094),
        (100.0, 0.005, 0.0086),
    ] {
        let errors: Vec<f64> = scene
            .iter()
            .zip(merged.radiance.mean.pixels())
            .filter(|(l, _)| (low..10.0 * low).contains(*l))
            .flat_map(|(l, x)| x.to_array().map(|x| f64::from(x) / l - 1.0))
            .collect();
        let n = errors.len() as f64;
        let bias = errors.iter().sum::<f64>() / n;
        let rms = (errors.iter().map(|e| e * e).sum::<f64>() / n).sqrt();
        eprintln!("decade {low:e}: n {n} bias {bias:+.5} rms {rms:.5}");
        assert!(bias.abs() < most_bias, "decade {low}: bias {bias}");
        assert!(rms < most_rms, "decade {low}: rms {rms}");
    }
}

#[test]
fn stated_sigma_covers_the_scatter_in_every_decade() {
    let scene = wide_scene();
    let (photos, exposures) = bracket(&scene, 2);
    let options = MergeOptions { refine_exposures: false, align: false, ..MergeOptions::default() };
    let merged = merge(&frames(&photos, &exposures), &options).unwrap();
    assert!(merged.noise.measured);
    let Radiance { mean, variance, validity } = &merged.radiance;
    for low in [1e-2, 1e-1, 1.0, 10.0, 100.0, 1000.0] {
        let z: Vec<f64> = (0..scene.len())
            .filter(|&i| (low..10.0 * low).contains(&scene[i]))
            .filter(|&i| validity.pixels()[i] <= Validity::Single)
            .flat_map(|i| {
                let (x, v) = (mean.pixels()[i], variance.pixels()[i]);
                [0, 1, 2].map(|c| (f64::from(x[c]) - scene[i]) / f64::from(v[c]).sqrt())
            })
            .collect();
        let share = |k: f64| z.iter().filter(|z| z.abs() < k).count() as f64 / z.len() as f64;
        let (one, two) = (share(1.0), share(2.0));
        eprintln!("decade {low:e}: {} samples, 1σ {one:.4} 2σ {two:.4}", z.len());
        // A normal error gives 0.6827 and 0.9545; 23 000 samples know them to 0.003 and 0.0014. The
        // room is for what is not normal: rounding to codes is uniform, and σ is taken at x, not L.
        assert!((one - 0.6827).abs() < 0.03, "decade {low}: {one} within 1σ");
        assert!((two - 0.9545).abs() < 0.015, "decade {low}: {two} within 2σ");
    }
}

#[test]
fn the_camera_s_noise_is_read_from_the_bracket() {
    let scene = wide_scene();
    let (photos, exposures) = bracket(&scene, 3);
    let noise = merge(&frames(&photos, &exposures), &MergeOptions::default()).unwrap().noise;
    eprintln!("{noise:?}");
    // The 68 % quantile of some 50 000 χ² pairs is good to 1 %; rounding to 8 bits blurs it further.
    assert!((noise.full_well_e / FULL_WELL - 1.0).abs() < 0.08, "{noise:?}");
    // Half a code of 8 bits at the foot of sRGB is 6 e⁻ here: the read noise is only just seen.
    assert!(noise.read_noise_e < 2.0 * READ_NOISE, "{noise:?}");
}

#[test]
fn rounded_labels_are_corrected_from_the_pixels() {
    let scene = wide_scene();
    let (photos, truth) = bracket(&scene, 4);
    // True powers of two are engraved as 1/15, 1/60, 1/250 …: up to 6.7 % off.
    let engraved = [1.0, 1.02, 0.985, 1.067, 1.0, 0.95, 1.03, 1.0, 0.99];
    let labels: Vec<f64> = truth.iter().zip(engraved).map(|(t, e)| t * e).collect();
    let merged = merge(&frames(&photos, &labels), &MergeOptions::default()).unwrap();
    // Up to the one factor that the labels share on average.
    let offset =
        (merged.exposures.iter().zip(&truth).map(|(a, b)| (a / b).ln()).sum::<f64>() / 9.0).exp();
    for (found, truth) in merged.exposures.iter().zip(&truth) {
        let off = found / truth / offset - 1.0;
        // Nothing is corrected below 0.5 %; steps add up over neighbours.
        assert!(off.abs() < 0.01, "exposure {truth}: {off:+.4}");
    }
    assert!(merged.warnings.iter().any(|w| matches!(w, Warning::LabelOff { .. })));
}

#[test]
fn true_labels_are_left_alone() {
    let scene = wide_scene();
    let (photos, truth) = bracket(&scene, 5);
    let merged = merge(&frames(&photos, &truth), &MergeOptions::default()).unwrap();
    assert_eq!(merged.exposures, truth);
}

#[test]
fn a_wrong_label_is_an_error_that_names_both_frames() {
    let scene = wide_scene();
    let (mut photos, mut labels) = bracket(&scene, 6);
    photos[4].path = "b4.jpg".into();
    labels[4] *= 1.5;
    let error = merge(&frames(&photos, &labels), &MergeOptions::default()).unwrap_err();
    assert!(matches!(error, BracketError::WrongLabel { .. }), "{error}");
    assert!(error.to_string().contains("b4.jpg"), "{error}");
}

#[test]
fn what_is_clipped_everywhere_is_a_lower_bound_and_said() {
    let mut scene = wide_scene();
    scene[77] = 1e9;
    let (photos, exposures) = bracket(&scene, 7);
    let merged = merge(&frames(&photos, &exposures), &MergeOptions::default()).unwrap();
    assert_eq!(merged.radiance.validity.pixels()[77], Validity::LowerBound);
    let bound = f64::from(merged.radiance.mean.pixels()[77].x);
    // White over the shortest exposure.
    assert!((bound - 4f64.powi(8)).abs() < 1.0, "{bound}");
    assert!(merged.warnings.iter().any(
        |w| matches!(w, Warning::ClippedInShortest { pixels, first: (77, 0), .. } if *pixels == 1)
    ));
}

#[test]
fn black_in_the_longest_is_an_upper_bound() {
    let scene = vec![0.0; WIDTH * HEIGHT];
    let (photos, exposures) = bracket(&scene, 8);
    let merged = merge(&frames(&photos, &exposures), &MergeOptions::default()).unwrap();
    assert!(merged.radiance.validity.pixels().iter().all(|&v| v == Validity::UpperBound));
    assert!(merged.warnings.iter().any(|w| matches!(w, Warning::BlackInLongest { .. })));
}

/// An S-curve as cameras apply: dark foot, brighter middle, shoulder (methods-capture F41).
pub(super) fn s_curve(y: f64) -> f64 {
    let lifted = y * (1.6 - 0.6 * y);
    lifted * lifted.powf(0.3) * 1.2 / (0.2 + lifted.powf(0.3))
}

/// Patches of 5 × 5 px, so that there are places flat enough to sample.
pub(super) fn patches(top: f64, decades: f64) -> Vec<f64> {
    (0..WIDTH * HEIGHT)
        .map(|i| radiance((i / WIDTH / 5) * (WIDTH / 5) + i % WIDTH / 5, top, decades))
        .collect()
}

fn shot_through_a_curve(seed: u64) -> (Vec<f64>, Vec<Encoded>, Vec<f64>) {
    let scene = patches(30.0, 4.0);
    let mut random = Random(seed);
    let exposures: Vec<f64> = (0..5).map(|k| 4f64.powi(-k)).collect();
    let photos = exposures.iter().map(|&t| shoot(&scene, t, &mut random, s_curve)).collect();
    (scene, photos, exposures)
}

#[test]
fn a_tone_curve_is_recovered_to_two_percent() {
    let (scene, photos, exposures) = shot_through_a_curve(9);
    let merged = merge(&frames(&photos, &exposures), &MergeOptions::default()).unwrap();
    assert_eq!(merged.exposures, exposures, "labels are what the curve is fitted to");
    let response = merged.response.as_ref().unwrap();
    eprintln!("{} {} {:.4}", response.method, response.per_channel, response.held_out);
    // The recovered curve inverts the camera's, up to one factor.
    let true_linear = |code: u8| {
        let shown = f64::from(Transfer::Srgb.decode(f32::from(code) / 255.0));
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if s_curve(middle) < shown { low = middle } else { high = middle }
        }
        low
    };
    let factor = f64::from(response.curves[1].linear(118)) / true_linear(118);
    for code in 20..=245 {
        let off = f64::from(response.curves[1].linear(code)) / true_linear(code) / factor - 1.0;
        assert!(off.abs() < 0.02, "code {code} is off by {off:+.4}");
    }
    // And the radiance is right over four decades, where sRGB would be up to twice off.
    let mut worst: f64 = 0.0;
    for (i, l) in scene.iter().enumerate().filter(|(_, l)| **l > 0.05) {
        let x = f64::from(merged.radiance.mean.pixels()[i].y);
        let sigma = f64::from(merged.radiance.variance.pixels()[i].y).sqrt();
        worst = worst.max((x / factor - l).abs() / (6.0 * sigma / factor + 0.02 * l));
    }
    assert!(worst < 1.0, "radiance is off by {worst} of 2 % + 6 σ");
}

#[test]
fn labels_that_are_kept_are_not_called_corrected() {
    let (_, photos, mut labels) = shot_through_a_curve(13);
    labels[2] *= 1.15;
    let merged = merge(&frames(&photos, &labels), &MergeOptions::default()).unwrap();
    assert!(merged.response.is_some());
    assert_eq!(merged.exposures, labels);
    assert!(!merged.warnings.iter().any(|w| matches!(w, Warning::LabelOff { .. })));
}

#[test]
fn a_tone_curve_that_may_not_be_recovered_is_reported() {
    let (_, photos, exposures) = shot_through_a_curve(13);
    let options = MergeOptions { response: ResponseSource::Stated, ..MergeOptions::default() };
    let merged = merge(&frames(&photos, &exposures), &options).unwrap();
    assert!(merged.response.is_none());
    assert!(
        merged.warnings.iter().any(|w| matches!(w, Warning::ToneCurve { .. })),
        "{:?}",
        merged.warnings
    );
}

#[test]
fn equal_exposures_merge_and_are_named() {
    let scene = wide_scene();
    let mut random = Random(10);
    let photos: Vec<Encoded> = (0..3).map(|_| shoot(&scene, 1.0, &mut random, straight)).collect();
    let merged = merge(&frames(&photos, &[1.0; 3]), &MergeOptions::default()).unwrap();
    assert!(merged.warnings.iter().any(|w| matches!(w, Warning::SameExposure { .. })));
    // Three frames of one exposure: a third of one frame's variance.
    let one = merge(
        &frames(&photos[..1], &[1.0]),
        &MergeOptions { noise: Some(merged.noise), ..MergeOptions::default() },
    )
    .unwrap();
    let i = (0..scene.len()).find(|&i| (0.4..0.5).contains(&scene[i])).unwrap();
    let ratio = merged.radiance.variance.pixels()[i].x / one.radiance.variance.pixels()[i].x;
    assert!((ratio - 1.0 / 3.0).abs() < 0.02, "{ratio}");
}

#[test]
fn a_copy_of_a_frame_counts_once() {
    let scene = wide_scene();
    let (photos, exposures) = bracket(&scene, 11);
    let mut twice = frames(&photos, &exposures);
    twice.push(twice[3]);
    let options = MergeOptions { noise: Some(EXACT), ..MergeOptions::default() };
    let (a, b) =
        (merge(&frames(&photos, &exposures), &options).unwrap(), merge(&twice, &options).unwrap());
    assert_eq!(a.radiance.mean, b.radiance.mean);
    assert!(b.warnings.iter().any(|w| matches!(w, Warning::Duplicate { .. })));
}

#[test]
fn a_copy_among_corrected_labels_changes_nothing() {
    let scene = wide_scene();
    let (mut photos, truth) = bracket(&scene, 4);
    let engraved = [1.0, 1.02, 0.985, 1.067, 1.0, 0.95, 1.03, 1.0, 0.99];
    let mut labels: Vec<f64> = truth.iter().zip(engraved).map(|(t, e)| t * e).collect();
    let options = MergeOptions { noise: Some(EXACT), ..MergeOptions::default() };
    let alone = merge(&frames(&photos, &labels), &options).unwrap();
    photos.push(photos[0].clone());
    // Whatever its label says, the copy is the picture it is a copy of.
    labels.push(labels[0] * 1.1);
    let with_copy = merge(&frames(&photos, &labels), &options).unwrap();
    assert_ne!(alone.exposures[..9], labels[..9], "the labels were corrected");
    assert_eq!(with_copy.exposures[..9], alone.exposures[..]);
    assert_eq!(with_copy.exposures[9], alone.exposures[0]);
    assert_eq!(with_copy.radiance.mean, alone.radiance.mean);
}

#[test]
fn bad_brackets_are_refused() {
    let scene = wide_scene();
    let (photos, exposures) = bracket(&scene, 12);
    let options = MergeOptions::default();
    assert!(matches!(merge(&[], &options), Err(BracketError::NoFrames)));
    let small = Photo::from_linear(Image::filled(3, 3, Rgb::ONE)).encoded();
    let mut mixed = frames(&photos, &exposures);
    mixed.push(Frame { photo: &small, exposure: 1.0 });
    assert!(matches!(merge(&mixed, &options), Err(BracketError::SizesDiffer { .. })));
    for exposure in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let frame = Frame { photo: &photos[0], exposure };
        assert!(matches!(merge(&[frame], &options), Err(BracketError::BadExposure { .. })));
    }
    let error = exposure::from_exif(&photos).unwrap_err().to_string();
    assert!(error.contains("--times"), "{error}");
}

#[test]
fn a_one_pixel_photograph_merges() {
    let photo = Photo::from_linear(Image::filled(1, 1, Rgb::splat(0.5))).encoded();
    let merged =
        merge(&[Frame { photo: &photo, exposure: 0.25 }], &MergeOptions::default()).unwrap();
    assert_eq!(merged.radiance.mean.pixels(), [Rgb::splat(2.0)]);
    assert_eq!(merged.radiance.validity.pixels(), [Validity::Single]);
}

#[test]
fn the_merged_ball_of_a_truth_scene_is_its_noise_free_picture() {
    let root = std::env::var("PLATELIGHT_SHARED")
        .unwrap_or_else(|_| concat!(env!("CARGO_MANIFEST_DIR"), "/../shared").into());
    let folder = std::path::Path::new(&root).join("truth/outdoor-sun");
    let Ok(facts) = std::fs::read_to_string(folder.join("shot_facts.json")) else {
        eprintln!("{} is missing: test skipped", folder.display());
        return;
    };
    let facts: serde_json::Value = serde_json::from_str(&facts).unwrap();
    // Linear value = K · t · (ISO/100)/N² · radiance: the merged unit is K times the picture's.
    let k = facts["sensor"]["K"].as_f64().unwrap();
    let open = |name: &str| {
        let options = crate::photo::ReadOptions::default();
        crate::photo::read_encoded(&folder.join(name), &options).unwrap()
    };
    let truth = Photo::from(open("ball.exr")).linear;
    let photos: Vec<Encoded> = (0..6).map(|i| open(&format!("ball_b{i}.jpg"))).collect();
    let exposures = exposure::from_exif(&photos).unwrap();
    let merged = merge(&frames(&photos, &exposures), &MergeOptions::default()).unwrap();
    assert_eq!(merged.exposures, exposures);
    assert!(merged.response.is_none(), "these photographs are exact sRGB");
    let Radiance { mean, variance, validity } = &merged.radiance;
    let (mut sum, mut true_sum, mut covered, mut n) = (0.0, 0.0, 0.0, 0.0);
    for (i, truth) in truth.pixels().iter().enumerate() {
        if validity.pixels()[i] > Validity::Single {
            continue;
        }
        let (x, truth) = (f64::from(mean.pixels()[i].y), f64::from(truth.y) * k);
        sum += x;
        true_sum += truth;
        n += 1.0;
        let sigma = f64::from(variance.pixels()[i].y).sqrt();
        covered += f64::from(u8::from((x - truth).abs() < sigma));
    }
    eprintln!("ratio {:.5}, within 1σ {:.3}, {:?}", sum / true_sum, covered / n, merged.noise);
    // 518 000 px of about 3 % scatter: their sum is known to 0.01 %; JPEG and 8 bits get the rest.
    assert!((sum / true_sum - 1.0).abs() < 0.003, "{}", sum / true_sum);
    // 0.68 for normal errors; JPEG's have long tails, so half is covered here (known weakness).
    assert!((0.45..0.8).contains(&(covered / n)), "{}", covered / n);
}

#[test]
fn a_camera_s_own_jpeg_is_not_accused_of_wrong_times() {
    // A pure power looks to one pair of frames like a wrong label; a camera's EXIF is believed.
    fn power(y: f64) -> f64 {
        y.powf(1.5)
    }
    let scene = patches(4.0, 2.0);
    let mut random = Random(14);
    let exposures = [1.0, 0.25];
    let mut photos: Vec<Encoded> =
        exposures.iter().map(|&t| shoot(&scene, t, &mut random, power)).collect();
    let result = merge(&frames(&photos, &exposures), &MergeOptions::default());
    assert!(matches!(result, Err(BracketError::WrongLabel { .. })), "{result:?}");
    for photo in &mut photos {
        photo.format = Format::Jpeg;
        photo.facts.make = Some("Camera".into());
    }
    let merged = merge(&frames(&photos, &exposures), &MergeOptions::default()).unwrap();
    assert!(merged.response.is_some());
    assert_eq!(merged.exposures, exposures);
    // The same light at the same times is no curve: a time must be wrong.
    let again = shoot(&scene, 0.25, &mut random, straight);
    let again = Encoded { format: Format::Jpeg, facts: photos[0].facts.clone(), ..again };
    let first = Encoded {
        facts: photos[0].facts.clone(),
        format: Format::Jpeg,
        ..shoot(&scene, 0.25, &mut random, straight)
    };
    let result = merge(&frames(&[first, again], &exposures), &MergeOptions::default());
    assert!(matches!(result, Err(BracketError::WrongLabel { .. })), "{result:?}");
}
