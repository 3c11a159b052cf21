//! The ball finder on photographs of real mirror balls, and on photographs without one.
//!
//! Places and radii are those listed with the photographs, measured there by eye and a circle fit, good to
//! 3 px where nothing else is said. The folder `shared` lies beside the repository (or at
//! PLATELIGHT_SHARED); without it the tests say so and pass.

use std::path::{Path, PathBuf};

use glam::{DVec2, DVec3};
use platelight::bracket::{Frame, MergeOptions, Warning, exposure, merge};
use platelight::camera::lens::focal_px_from_35mm;
use platelight::camera::{Camera, Lens, Pose};
use platelight::conventions::{Rgb, luminance};
use platelight::photo::{self, Encoded, Photo, ReadOptions};
use platelight::probe::ball_frames::lay_by_ball;
use platelight::probe::find::{BallImage, Hints, find};
use platelight::probe::{Ball, ProbeError, photographed};

/// A photograph, its focal length in px where EXIF has none, the ball's centre and radius as one sees the
/// picture, and how far off they may be, px.
struct Listed {
    photo: &'static str,
    focal_px: Option<f64>,
    circle_px: [f64; 3],
    within_px: f64,
}

const fn listed(photo: &'static str, focal_px: Option<f64>, circle_px: [f64; 3]) -> Listed {
    Listed { photo, focal_px, circle_px, within_px: 3.0 }
}

/// Whole photographs.
const PHOTOGRAPHS: [Listed; 11] = [
    listed("ball-livingroom/ball_t1-10.jpg", None, [755.0, 549.0, 73.0]),
    listed("ball-livingroom/ball_t1-40.jpg", None, [755.0, 549.0, 73.0]),
    listed("ball-livingroom/ball_t1-160.jpg", None, [755.0, 551.0, 73.0]),
    // Listed as stored, (x, y); turned upright they are (2447 − y, x).
    listed("ball-hallway/ball_im01.jpg", None, [1255.0, 1723.0, 68.5]),
    listed("ball-hallway/ball_im04.jpg", None, [1254.0, 1728.0, 68.5]),
    listed("ball-hallway/ball_im09.jpg", None, [1232.0, 1734.0, 68.5]),
    listed("ball-hallway/ball_im11.jpg", None, [1232.0, 1730.0, 68.5]),
    listed("ball-cubicle/scene_with_ball_small.jpg", Some(748.0), [437.0, 380.0, 47.0]),
    // Almost white all over, and listed to 4 px each way: its white meets the white of the wall.
    Listed {
        within_px: 7.0,
        ..listed("ball-garden-overcast/scene_t1-4.jpg", Some(11620.0), [1666.0, 2165.0, 300.0])
    },
    listed("ball-outdoor-singles/tokyo.jpg", None, [1498.0, 1476.0, 1445.0]),
    // A quarter of a percent of the radius: below, the ball's shadow hides the rim.
    Listed {
        within_px: 5.0,
        ..listed("ball-outdoor-singles/tisch.jpg", Some(4000.0), [1999.0, 1962.0, 1881.0])
    },
];

/// Balls cut out by hand, the frame at the rim or beyond it.
const CUT_OUT: [Listed; 13] = [
    listed("ball-cubicle/crop_t1-24.jpg", Some(2992.0), [191.0, 190.0, 190.0]),
    listed("ball-cubicle/crop_t1-60.jpg", Some(2992.0), [190.0, 188.0, 189.0]),
    listed("ball-cubicle/crop_t1-120.jpg", Some(2992.0), [187.0, 186.0, 187.0]),
    listed("ball-garden-overcast/crop_t1-4.png", Some(11620.0), [299.5, 299.5, 300.0]),
    listed("ball-garden-overcast/crop_t1-50.png", Some(11620.0), [299.5, 299.5, 300.0]),
    listed("ball-garden-overcast/crop_t1-800.png", Some(11620.0), [299.5, 299.5, 300.0]),
    listed("ball-kitchen-night/crop_t1.jpg", None, [362.0, 362.0, 368.0]),
    listed("ball-kitchen-night/crop_t1-4.jpg", None, [363.0, 361.0, 368.0]),
    // From here on ISO 250, 1000 and 2000: noise everywhere, before white paper.
    listed("ball-kitchen-night/crop_t1-15.jpg", None, [365.0, 369.0, 367.0]),
    Listed {
        within_px: 5.0,
        ..listed("ball-kitchen-night/crop_t1-60.jpg", None, [369.0, 369.0, 369.0])
    },
    listed("ball-kitchen-night/crop_t1-250.jpg", None, [359.0, 364.0, 365.0]),
    listed("ball-office-closeup/crop_t1-25.jpg", None, [601.0, 603.0, 516.0]),
    listed("ball-office-closeup/crop_t1-200.jpg", None, [593.0, 612.0, 517.0]),
];

/// Photographs without a ball: boards, tags, rooms, yards, canopies. A church's rose windows and a mug, which
/// look as round, are not among them.
const WITHOUT: [&str; 24] = [
    "ball-hallway/plate.jpg",
    "ball-kitchen-night/plate.jpg",
    "ball-livingroom/plate.jpg",
    "ball-cubicle/plate_small.jpg",
    "bracket-memorial/memorial0071.png",
    "calib-aprilgrid/001.jpg",
    "calib-carnd/calibration1.jpg",
    "calib-carnd/calibration14.jpg",
    "calib-carnd/calibration19.jpg",
    "calib-fisheye-left/left1.jpg",
    "calib-fisheye-left/left16.jpg",
    "calib-fisheye-left/left29.jpg",
    "calib-iphone6/iphone6-000000.png",
    "calib-iphone6/iphone6-000004.png",
    "calib-opencv-stereo/left01.jpg",
    "calib-opencv-stereo/left07.jpg",
    "calib-opencv-stereo/right06.jpg",
    "fisheye-canopy/DSCN4500.JPG",
    "tags-apriltag-repo/33369213973_9d9bb4cc96_c.jpg",
    "tags-apriltag-repo/34085369442_304b6bafd9_c.jpg",
    "tags-apriltag-repo/34139872896_defdb2f8d9_c.jpg",
    "tags-duckie-rotation/test_image_rotation_-60.png",
    "tags-duckie-rotation/test_image_rotation_20.png",
    "tags-duckie-rotation/test_image_rotation_40.png",
];

/// The folder of photographs, or `None` with a word about it.
fn photographs() -> Option<PathBuf> {
    let beside = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared"));
    let path = std::env::var_os("PLATELIGHT_SHARED").map_or(beside, PathBuf::from).join("data");
    if path.is_dir() {
        return Some(path);
    }
    eprintln!("{} is missing: nothing is tested", path.display());
    None
}

fn found(path: &Path, focal_px: Option<f64>) -> (Lens, Result<BallImage, ProbeError>) {
    let photo = photo::read(path, &ReadOptions::default()).unwrap();
    let (w, h) = (photo.linear.width(), photo.linear.height());
    let exif = photo.facts.focal_35mm.and_then(|mm| focal_px_from_35mm(mm, w, h));
    let lens = Lens::pinhole(focal_px.or(exif).unwrap_or(w.max(h) as f64), w, h);
    let found = find(&photo.linear, &lens, &Hints::default());
    (lens, found)
}

fn check(listed: &[Listed]) {
    let Some(folder) = photographs() else { return };
    for Listed { photo, focal_px, circle_px: [u, v, r], within_px } in listed {
        let (lens, found) = found(&folder.join(photo), *focal_px);
        let found = found.unwrap_or_else(|cause| panic!("{photo}: {cause}"));
        // The middle of the rim's picture, as an eye measures it; not quite where its axis is seen.
        let rim = (0..360).filter_map(|k| lens.project(found.rim.ray(f64::from(k).to_radians())));
        let rim: Vec<DVec2> = rim.collect();
        let middle = rim.iter().sum::<DVec2>() / rim.len() as f64;
        let off = [middle.x - u, middle.y - v, found.radius_px - r];
        eprintln!(
            "{photo}: {:+.1} {:+.1} {:+.1} px off what is listed; score {:.2}, agreement {:.2}",
            off[0],
            off[1],
            off[2],
            found.score.unwrap_or_default(),
            found.agreement.unwrap_or_default(),
        );
        assert!(off[0].hypot(off[1]) < *within_px, "{photo}: centre {off:?} px off");
        assert!(off[2].abs() < *within_px, "{photo}: radius {} px off", off[2]);
        assert!(found.rival_px.is_none(), "{photo}: rival at {:?}", found.rival_px);
    }
}

#[test]
fn balls_are_found_where_they_are_listed() {
    check(&PHOTOGRAPHS);
}

#[test]
fn cut_out_balls_are_found_where_they_are_listed() {
    check(&CUT_OUT);
}

/// 44 of 46 such photographs gave a ball once, most of them without a word of doubt.
#[test]
fn photographs_without_a_ball_say_so() {
    let Some(folder) = photographs() else { return };
    for photo in WITHOUT {
        let (_, found) = found(&folder.join(photo), None);
        match found {
            Err(ProbeError::NoBall { .. } | ProbeError::FisheyeBorder { .. }) => {}
            Err(other) => panic!("{photo}: {other}"),
            Ok(ball) => panic!("{photo}: a ball at {}, {} px", ball.centre_px, ball.radius_px),
        }
    }
}

/// Cut out by hand, of five sizes; ISO follows the shutter, so that the first four are one exposure: by time
/// alone the radiance would be 60 times wrong.
#[test]
fn cut_outs_whose_iso_cancels_the_shutter_are_merged_by_time_and_iso() {
    let Some(folder) = photographs() else { return };
    let path = |name: &str| folder.join("ball-kitchen-night").join(name);
    let photos: Vec<Encoded> = ["t1", "t1-4", "t1-15", "t1-60", "t1-250"]
        .map(|name| {
            let path = path(&format!("crop_{name}.jpg"));
            photo::read_encoded(&path, &ReadOptions::default()).unwrap()
        })
        .into();
    let exposures = exposure::from_exif(&photos).unwrap();
    // t × ISO.
    for (exposure, expected) in exposures.iter().zip([20.0, 20.0, 250.0 / 15.0, 1000.0 / 60.0, 8.0])
    {
        assert!((exposure * 4.0 * 100.0 / expected - 1.0).abs() < 0.03, "{exposures:?}");
    }
    let listed = CUT_OUT.iter().filter(|listed| listed.photo.starts_with("ball-kitchen-night"));
    let ball = |(photo, listed): (&Encoded, &Listed)| {
        let lens = Lens::pinhole(800.0, photo.width, photo.height);
        let hints = Hints { circle_px: Some(listed.circle_px), clean_plate: None };
        find(&Photo::from(photo.clone()).linear, &lens, &hints).unwrap()
    };
    let balls: Vec<BallImage> = photos.iter().zip(listed).map(ball).collect();
    let laid = lay_by_ball(&photos, &balls).unwrap();
    let frames = laid.photos.iter().zip(&exposures);
    let frames: Vec<Frame> = frames.map(|(photo, &exposure)| Frame { photo, exposure }).collect();
    let merged = merge(&frames, &MergeOptions::default()).unwrap();
    let cancels = |warning: &&Warning| matches!(warning, Warning::IsoCancels { .. });
    let told = merged.warnings.iter().find(cancels).map(ToString::to_string);
    assert!(told.as_ref().is_some_and(|told| told.contains("8.0 stops")), "{told:?}");
    let lens = Lens::pinhole(800.0, merged.radiance.mean.width(), merged.radiance.mean.height());
    let ball = find(&merged.radiance.mean, &lens, &Hints::default()).unwrap();
    assert!((ball.radius_px - 368.0).abs() < 3.0 && !ball.is_weak(), "{ball:?}");
}

/// Lights of the living room as listed: azimuth from straight back to the camera towards the picture's right,
/// elevation, degrees, each by a flux centroid of what is bright round it.
#[test]
fn window_and_spots_of_a_room_come_from_where_they_are_listed() {
    let Some(folder) = photographs() else { return };
    let read = |name: &str| {
        let path = folder.join("ball-livingroom").join(name);
        photo::read_encoded(&path, &ReadOptions::default()).unwrap()
    };
    let photos = ["ball_t1-10.jpg", "ball_t1-40.jpg", "ball_t1-160.jpg"].map(read);
    let exposures = exposure::from_exif(&photos).unwrap();
    let frames = photos.iter().zip(&exposures);
    let frames: Vec<Frame> = frames.map(|(photo, &exposure)| Frame { photo, exposure }).collect();
    let radiance = merge(&frames, &MergeOptions::default()).unwrap().radiance;
    let lens = Lens::pinhole(1264.0, 1500, 1000);
    let camera = Camera { width: 1500, height: 1000, lens, pose: Pose::identity() };
    let found = find(&radiance.mean, &camera.lens, &Hints::default()).unwrap();
    let ball = Ball::new(found.centre_of(0.05, &camera), 0.05, Rgb::ONE).unwrap();
    let panorama = photographed::ball(&radiance, &camera, &found, &ball, None, Some(512)).unwrap();
    let mut bright: Vec<f32> = panorama.radiance.pixels().iter().map(|l| luminance(*l)).collect();
    bright.sort_by(f32::total_cmp);
    let bright = 0.12 * bright[bright.len() * 999 / 1000];
    // The window's elevation is listed as 10 to 17.
    for (azimuth, elevation, within) in [(45.0, 14.0, 5.0), (153.0, 52.0, 3.0), (178.0, 46.0, 3.0)]
    {
        let (azimuth, up) = (f64::to_radians(azimuth), f64::to_radians(elevation));
        let listed = DVec3::new(azimuth.sin() * up.cos(), up.sin(), azimuth.cos() * up.cos());
        let mut sum = DVec3::ZERO;
        for y in 0..panorama.height() {
            for x in 0..panorama.width() {
                let (d, l) = (panorama.direction(x, y), luminance(panorama.radiance[(x, y)]));
                if l > bright && d.angle_between(listed) < 12f64.to_radians() {
                    sum += d * f64::from(l) * panorama.solid_angle(y);
                }
            }
        }
        let off = sum.angle_between(listed).to_degrees();
        eprintln!("light listed at {elevation}° up: {off:.1}° off");
        assert!(off < within, "the light listed at {elevation}° up is {off}° off");
    }
}

/// A mug that is round below: what cannot be told apart is at least doubted.
#[test]
fn a_mug_is_doubted() {
    let Some(folder) = photographs() else { return };
    let (_, found) = found(&folder.join("ball-cubicle/plate.jpg"), None);
    assert!(found.map_or(true, |mug| mug.is_weak()), "a mug is taken for a ball without a doubt");
}
