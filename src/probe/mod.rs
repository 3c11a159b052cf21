//! Light probes → lat-long panorama.
//!
//! [`Radiance`](crate::bracket::Radiance) + [`Camera`](crate::camera::Camera) → [`Panorama`].
//! A mirror ball goes through [`find`] (where is the ball?), [`rim`] (its tangent cone),
//! [`ball`] (exact reflection at finite distance) and [`unwrap`]; fisheyes, angular maps and
//! lat-long pictures are [`mapping::Mapping`]s; all of them meet in [`resample`]. Several of one place are
//! turned into one set of axes by [`register`] and merged by [`combine`].
//! Start with [`Panorama`] and [`photographed`]. This room never lights anything, never
//! merges a bracket, and never takes the direction to a ball from anything but its rim.

pub mod axes;
pub mod ball;
pub mod ball_frames;
mod block;
pub mod circles;
pub mod clipped;
pub mod combine;
pub mod compact_lights;
pub mod cube;
pub mod doubt;
pub mod edges;
pub mod file;
pub mod fill;
pub mod find;
pub mod fisheye;
pub mod irradiance;
pub mod layout;
pub mod lens_picture;
pub mod mapping;
pub mod overlay;
pub mod panorama;
pub mod photographed;
pub mod picture_file;
#[cfg(test)]
mod projection_tests;
pub mod quality;
pub mod register;
pub mod resample;
pub mod rim;
pub mod ring;
pub mod scatter;
pub mod stitched;
#[cfg(test)]
mod test_worlds;
pub mod unwrap;
pub mod view;
pub mod vignetting;

pub use self::ball::Ball;
pub use self::clipped::{ClippedRegion, clipped_regions};
pub use self::doubt::Doubt;
pub use self::panorama::Panorama;
pub use self::register::{RegisterError, Registration};
pub use self::rim::Rim;
pub use self::view::View;

use std::path::PathBuf;

/// Why a probe cannot become a panorama.
#[derive(Debug, thiserror::Error)]
pub enum ProbeError {
    #[error(
        "no mirror ball found: {reason}; if there is one, give three numbers as a hint: the ball's centre u, v and \
         radius r in pixels (probe.ball.hint_px or --hint u,v,r); if this is another kind of picture, say which \
         (--fisheye, --lens, --lat-long; probe.fisheye, probe.panorama)"
    )]
    NoBall { reason: String },
    #[error(
        "no mirror ball found: the circle round {:.0}, {:.0} of radius {:.0} px is cut by the frame and has only black \
         round it, as the border of a fisheye's picture; say that it is one (--fisheye, probe.fisheye), or give the ball's \
         centre u, v and radius r in pixels as a hint (probe.ball.hint_px or --hint u,v,r)",
        circle_px[0], circle_px[1], circle_px[2]
    )]
    FisheyeBorder { circle_px: [f64; 3] },
    #[error(
        "only {found:.0} % of the edge points lie on one rim, {needed:.0} % are needed: the rim is \
         hidden or something else was taken for it; give a hint (centre u, v and radius r in pixels)"
    )]
    FewInliers { found: f64, needed: f64 },
    #[error(
        "only {arc_deg:.0}° of the ball's rim can be seen, 45° are needed: frame the whole ball or \
         remove what hides its edge"
    )]
    ShortArc { arc_deg: f64 },
    #[error("{what}: {found} is not {expected}")]
    Value { what: &'static str, found: String, expected: &'static str },
    #[error("{found:?} is no {what}; known are {known}")]
    Name { what: &'static str, found: String, known: String },
    #[error("{}: {width} × {height} is not a lat-long picture: the width must be twice the height; if it is an angular map or a cube, say so (mapping = \"angular\")", path.display())]
    NotLatLong { path: PathBuf, width: usize, height: usize },
    #[error("{}: {width} × {height} is not {wanted}; name the mapping the file really has", path.display())]
    Layout { path: PathBuf, width: usize, height: usize, wanted: &'static str },
    #[error(transparent)]
    Photo(#[from] crate::photo::PhotoError),
    #[error(transparent)]
    Radiance(#[from] crate::bracket::BracketError),
}
