//! A Smart IBL set: one folder that renderers' loaders read as background, diffuse light, reflections and
//! a key light (hdrlabs.com, format 2: an `.ibl` text beside the pictures that it names).
//!
//! Environment = irradiance ÷ π without the sun, which is the key light; reflection = the panorama as it
//! is. All pictures are lat-longs in the panorama's axes, linear, in its unit; only background and icon
//! are tone-mapped. The sections' spelling (`[Enviroment]`) and the spaces round `=` are the format's.

use std::f32::consts::PI;
use std::io::Write;
use std::path::{Path, PathBuf};

use super::sun::{Disc, Split, SunSplit, split};
use crate::conventions::{Rgb, lat_long_pixel};
use crate::photo::radiance_hdr::{self, Mantissa};
use crate::photo::tone::{ToneCurve, automatic_stops, display};
use crate::photo::{Encoding, EncodingSource, Image, PhotoError, Primaries, Transfer, atomic, png};
use crate::probe::axes::Axes;
use crate::probe::file::laid_out;
use crate::probe::irradiance::irradiance_map;
use crate::probe::layout::Layout;
use crate::probe::{Panorama, ProbeError};

/// Width of the environment and the icon, and the largest of the reflection.
const ENVIRONMENT: usize = 256;
const ICON: usize = 128;
const LARGEST_REFLECTION: usize = 2048;

/// The files of a set called `name` in `folder`.
#[derive(Clone, Debug)]
pub struct SiblFiles {
    pub text: PathBuf,
    pub icon: PathBuf,
    pub background: PathBuf,
    pub environment: PathBuf,
    pub reflection: PathBuf,
}

impl SiblFiles {
    pub fn new(folder: &Path, name: &str) -> Self {
        let file = |ending: &str| folder.join(format!("{name}{ending}"));
        Self {
            text: file(".ibl"),
            icon: file("_icon.png"),
            background: file("_background.png"),
            environment: file("_environment.hdr"),
            reflection: file("_reflection.hdr"),
        }
    }

    pub fn all(&self) -> [&Path; 5] {
        [&self.text, &self.icon, &self.background, &self.environment, &self.reflection]
    }
}

/// Writes the set of a panorama whose texels are in the world's axes.
///
/// # Errors
/// Light that RGBE cannot hold, or the disk.
pub fn write(files: &SiblFiles, name: &str, panorama: &Panorama) -> Result<(), ProbeError> {
    let Split { radiance, discs, .. } = split(panorama, SunSplit::Always);
    let sun = discs.into_iter().max_by(|a, b| a.flux().total_cmp(&b.flux()));
    let mut diffuse = match sun {
        Some(_) => Panorama::from_radiance(radiance),
        None => panorama.clone(),
    };
    diffuse.world_from_panorama = panorama.world_from_panorama;
    let environment = irradiance_map(&diffuse, ENVIRONMENT).map(|&e| e / PI);
    let reflection = match panorama.width() {
        width if width > LARGEST_REFLECTION => {
            let layout = Layout::LatLong(Axes::OpenExr);
            laid_out(panorama, layout, layout.size(LARGEST_REFLECTION))?.light.mean
        }
        _ => panorama.radiance.clone(),
    };
    let shown =
        |picture: &Image<Rgb>| display(picture, automatic_stops(picture), ToneCurve::REINHARD);
    let background = shown(&panorama.radiance);
    write_png(&files.background, &background)?;
    write_png(&files.icon, &background.reduced(panorama.width().div_ceil(ICON)))?;
    radiance_hdr::write(&files.environment, &environment, Mantissa::Truncated)?;
    radiance_hdr::write(&files.reflection, &reflection, Mantissa::Truncated)?;
    let heights = [background.height(), environment.height(), reflection.height()];
    let text = text(files, name, heights, sun.as_ref());
    atomic::write(&files.text, |file| file.write_all(text.as_bytes()))
        .map_err(|source| PhotoError::Write { path: files.text.clone(), source })?;
    Ok(())
}

fn text(files: &SiblFiles, name: &str, heights: [usize; 3], sun: Option<&Disc>) -> String {
    let file = |path: &Path| {
        path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
    };
    let map = |key: &str, path: &Path, height: usize| {
        let file = file(path);
        format!(
            "{key}file = \"{file}\"\n{key}map = 1\n{key}u = 0.000000\n{key}v = 0.000000\n\
             {key}height = {height}\n"
        )
    };
    let linear = |key: &str| format!("{key}multi = 1.000000\n{key}gamma = 1.000000\n");
    let [background, environment, reflection] = heights;
    let mut text = format!(
        "[Header]\nICOfile = \"{}\"\nName = \"{name}\"\nAuthor = \"\"\nLocation = \"\"\n\
         Comment = \"platelight {}\"\n",
        file(&files.icon),
        env!("CARGO_PKG_VERSION")
    );
    text += &format!("\n[Background]\n{}", map("BG", &files.background, background));
    let left_out = if sun.is_some() { "--without the sun below\n" } else { "" };
    text += &format!(
        "\n[Enviroment]\n{left_out}{}{}",
        map("EV", &files.environment, environment),
        linear("EV")
    );
    text +=
        &format!("\n[Reflection]\n{}{}", map("REF", &files.reflection, reflection), linear("REF"));
    if let Some(sun) = sun {
        text += &sun_section(sun);
    }
    text
}

/// Place as shares of the picture's width and height from its upper left, colour, and strength: what a white
/// matt surface that faces it sends back, irradiance ÷ π, in the panorama's unit.
fn sun_section(sun: &Disc) -> String {
    // On a picture of 1 × 1 a texel's centre is the middle.
    let place = lat_long_pixel(sun.direction.as_dvec3(), 1, 1) + 0.5;
    let back = sun.irradiance(sun.direction) / PI;
    let strongest = back.max_element();
    let [r, g, b] = (back / strongest * 255.0).round().to_array().map(|v| v as u8);
    format!(
        "\n[Sun]\nSUNcolor = {r},{g},{b}\nSUNmulti = {strongest:.6}\nSUNu = {:.6}\nSUNv = {:.6}\n",
        place.x, place.y
    )
}

fn write_png(path: &Path, shown: &Image<Rgb>) -> Result<(), PhotoError> {
    let encoding = Encoding {
        transfer: Transfer::Srgb,
        primaries: Primaries::Rec709,
        source: EncodingSource::Named,
    };
    png::write(path, &png::srgb_codes(shown), shown.width(), shown.height(), &encoding)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::photo::{self, ReadOptions};
    use glam::DVec3;

    /// The value of a key of the `.ibl` text.
    fn value<'a>(text: &'a str, key: &str) -> &'a str {
        let line = text.lines().find_map(|line| line.strip_prefix(&format!("{key} = ")));
        line.unwrap_or_else(|| panic!("{key} in {text}"))
    }

    #[test]
    fn a_set_holds_the_light_and_names_the_sun() {
        let mut panorama =
            Panorama::from_radiance(Image::filled(512, 256, Rgb::new(1.0, 2.0, 4.0)));
        panorama.radiance[(128, 64)] = Rgb::new(4e5, 2e5, 1e5);
        let before = panorama.irradiance(DVec3::Y) - Rgb::new(1.0, 2.0, 4.0) * PI;
        let folder = tempfile::tempdir().unwrap();
        let files = SiblFiles::new(folder.path(), "garden");
        write(&files, "garden", &panorama).unwrap();
        let text = std::fs::read_to_string(&files.text).unwrap();
        for section in ["[Header]", "[Background]", "[Enviroment]", "[Reflection]", "[Sun]"] {
            assert!(text.contains(section), "{section} in {text}");
        }
        for key in ["ICOfile", "BGfile", "EVfile", "REFfile"] {
            let name = value(&text, key).trim_matches('"');
            assert!(folder.path().join(name).is_file(), "{key}: {name}");
        }
        let number = |key: &str| value(&text, key).parse::<f64>().unwrap();
        assert!((number("SUNu") - 128.5 / 512.0).abs() < 2e-3, "{text}");
        assert!((number("SUNv") - 64.5 / 256.0).abs() < 2e-3, "{text}");
        assert_eq!(value(&text, "SUNcolor"), "255,127,64");
        // Level ground: the sun's share is its strength × π × the sine of its elevation.
        let sine = panorama.direction(128, 64).y;
        let given = number("SUNmulti") * f64::from(PI) * sine;
        assert!((given / f64::from(before.x) - 1.0).abs() < 1e-3, "{given} of {before}");
        let read = |path: &Path| photo::read(path, &ReadOptions::default()).unwrap().linear;
        let environment = read(&files.environment);
        assert!((environment[(40, 40)] / Rgb::new(1.0, 2.0, 4.0) - 1.0).abs().max_element() < 0.01);
        assert_eq!(environment.height(), number("EVheight") as usize);
        assert_eq!(read(&files.reflection).height(), number("REFheight") as usize);
    }

    #[test]
    fn without_a_sun_there_is_no_key_light() {
        let panorama = Panorama::from_radiance(Image::filled(64, 32, Rgb::ONE));
        let folder = tempfile::tempdir().unwrap();
        let files = SiblFiles::new(folder.path(), "fog");
        write(&files, "fog", &panorama).unwrap();
        let text = std::fs::read_to_string(&files.text).unwrap();
        assert!(!text.contains("[Sun]") && !text.contains("without the sun"), "{text}");
    }
}
