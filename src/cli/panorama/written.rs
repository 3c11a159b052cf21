//! What `panorama` writes: the panorama in the layout that was asked for, and what comes beside it.

use std::path::Path;

use glam::{DMat3, DVec3};

use super::args::{Target, Wishes};
use super::photographed::{Photographed, Seen};
use crate::cli::CliError;
use crate::light::sibl::{self, SiblFiles};
use crate::photo::tone::{ToneCurve, automatic_stops, display};
use crate::photo::{Encoding, EncodingSource, Primaries, Transfer, png};
use crate::probe::axes::Axes;
use crate::probe::cube::FACE_NAMES;
use crate::probe::irradiance::irradiance_map;
use crate::probe::layout::Layout;
use crate::probe::picture_file::{self, Layer, Origin};
use crate::probe::quality::quality;
use crate::probe::resample::Resampled;
use crate::probe::unwrap::check_width;
use crate::probe::{Panorama, file};
use crate::report::axes_card;

/// Width of the irradiance map.
const IRRADIANCE: usize = 256;

/// Largest side of a picture, px.
const LARGEST_SIDE: usize = 1 << 15;

/// What is written to a file of this name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Ending {
    Exr,
    Hdr,
}

pub(super) fn ending(out: &Path) -> Result<Ending, CliError> {
    let ends = |ending: &str| out.extension().is_some_and(|e| e.eq_ignore_ascii_case(ending));
    match (ends("exr"), ends("hdr")) {
        (true, _) => Ok(Ending::Exr),
        (_, true) => Ok(Ending::Hdr),
        _ => Err(CliError::wrong(format!(
            "{}: the name must end in .exr or .hdr, which is what is written; name it {}",
            out.display(),
            out.with_extension("exr").display()
        ))),
    }
}

/// Writes the panorama in its layout, and the card of its axes; the size of what was written.
pub(super) fn write(wishes: &Wishes, found: &Photographed) -> Result<(usize, usize), CliError> {
    let further = &wishes.args.further;
    let layout = wishes.target.layout();
    let size = size(layout, further.size, found.panorama.width())?;
    let pictured = file::laid_out(&found.panorama, layout, size)?;
    let origin = Origin {
        sources: wishes.args.photos.iter().map(|path| path.display().to_string()).collect(),
        unit: Some(found.unit.clone()),
        rotation_deg: Some(wishes.rotation_deg),
        place_m: found.panorama.place,
        seen_through: found.seeing,
    };
    let layers = match further.quality {
        true => quality_layers(found, layout, size)?,
        false => Vec::new(),
    };
    let files = wishes.target.files(&wishes.args.out);
    match wishes.target {
        Target::One(_) => write_one(&files[0], &pictured, layout, &origin, &layers)?,
        Target::Faces(_) => {
            let side = size.1;
            for (k, path) in files.iter().enumerate() {
                let face = pictured.part((k * side, 0), (side, side));
                let sources = [vec![format!("face {}", FACE_NAMES[k])], origin.sources.clone()];
                let origin = Origin { sources: sources.concat(), ..origin.clone() };
                let layers: Vec<Layer> =
                    layers.iter().map(|layer| layer.part((k * side, 0), (side, side))).collect();
                write_one(path, &face, layout, &origin, &layers)?;
            }
        }
    }
    if let Some(path) = &further.axes {
        write_axes(path, &pictured, layout, size)?;
    }
    Ok(size)
}

/// The size of the picture: as asked for, or as fine as the panorama.
fn size(layout: Layout, asked: Option<usize>, width: usize) -> Result<(usize, usize), CliError> {
    let side = asked.unwrap_or_else(|| layout.side_for(width));
    let size = layout.size(side);
    if layout.axes().is_some() {
        check_width(side).map_err(|error| CliError::wrong(format!("--size: {error}")))?;
    }
    if side < 4 || size.0.max(size.1) > LARGEST_SIDE {
        return Err(CliError::wrong(format!(
            "--size: {side} makes a picture of {} × {} px; give 4 or more, and no side above \
             {LARGEST_SIDE} px",
            size.0, size.1
        )));
    }
    Ok(size)
}

fn write_one(
    path: &Path,
    pictured: &Resampled,
    layout: Layout,
    origin: &Origin,
    layers: &[Layer],
) -> Result<(), CliError> {
    match ending(path)? {
        Ending::Exr => picture_file::write_exr_with(path, pictured, layout, origin, layers)?,
        Ending::Hdr => picture_file::write_hdr(path, pictured)?,
    }
    Ok(())
}

/// How finely the pictures showed each texel's direction.
fn quality_layers(
    found: &Photographed,
    layout: Layout,
    size: (usize, usize),
) -> Result<Vec<Layer>, CliError> {
    let (mapping, source_size, mapping_from_world) = match &found.seen {
        Seen::Picture { mapping, size, mapping_from_world } => {
            (mapping, *size, *mapping_from_world)
        }
        // Refused before anything was read.
        Seen::Together => return Ok(Vec::new()),
        Seen::Several(px_per_deg) => {
            let laid_out = file::laid_out(px_per_deg, layout, size)?;
            let samples = laid_out.light.mean.map(|all| all.x);
            return Ok(vec![Layer { name: "quality.Y", samples }]);
        }
    };
    let Some(target) = layout.mapping(size) else { return Ok(Vec::new()) };
    let source_from_target = mapping_from_world * world_from_picture(layout);
    let found = quality(&**mapping, source_size, &*target, size, source_from_target);
    Ok(vec![
        Layer { name: "quality.Y", samples: found.pixels_per_degree },
        Layer { name: "solid_angle.Y", samples: found.sr_per_pixel },
    ])
}

fn world_from_picture(layout: Layout) -> DMat3 {
    layout.axes().map_or(DMat3::IDENTITY, |axes| axes.picture_from_world().transpose())
}

fn write_axes(
    path: &Path,
    pictured: &Resampled,
    layout: Layout,
    size: (usize, usize),
) -> Result<(), CliError> {
    let Some(mapping) = layout.mapping(size) else { return Ok(()) };
    let light = &pictured.light.mean;
    let shown = display(light, automatic_stops(light), ToneCurve::REINHARD);
    let picture_from_world = layout.axes().map_or(DMat3::IDENTITY, Axes::picture_from_world);
    let pixel = |direction: DVec3| mapping.pixel(picture_from_world * direction);
    let card = axes_card(&shown, pixel, &layout.name());
    let (width, height, samples) = card.into_samples();
    let encoding = Encoding {
        transfer: Transfer::Srgb,
        primaries: Primaries::Rec709,
        source: EncodingSource::Named,
    };
    png::write(path, &samples, width, height, &encoding)?;
    Ok(())
}

/// The diffuse light and the Smart IBL set of a panorama in the world's axes.
pub(super) fn beside(wishes: &Wishes, panorama: &Panorama) -> Result<(), CliError> {
    let further = &wishes.args.further;
    if let Some(path) = &further.irradiance {
        let map = irradiance_map(panorama, IRRADIANCE);
        let what =
            "irradiance by normal: integral of L max(0, n w) dw, the panorama's unit times sr";
        picture_file::write_light(path, &map, what)?;
    }
    if let Some(folder) = &further.sibl {
        std::fs::create_dir_all(folder).map_err(|cause| {
            CliError::wrong(format!("{}: cannot be made: {cause}", folder.display()))
        })?;
        sibl::write(&sibl_files(folder)?, &sibl_name(folder)?, panorama)?;
    }
    Ok(())
}

pub(super) fn sibl_files(folder: &Path) -> Result<SiblFiles, CliError> {
    Ok(SiblFiles::new(folder, &sibl_name(folder)?))
}

/// A set has its folder's name; loaders read it as plain ASCII between quotes.
fn sibl_name(folder: &Path) -> Result<String, CliError> {
    let name = folder.file_name().map(|name| name.to_string_lossy().into_owned());
    let plain =
        |name: &String| name.chars().all(|c| c.is_ascii_alphanumeric() || " ._-".contains(c));
    name.filter(plain).ok_or_else(|| {
        CliError::wrong(format!(
            "--sibl {}: the set has its folder's name, which must be plain letters, digits, dots, \
             dashes and underscores",
            folder.display()
        ))
    })
}
