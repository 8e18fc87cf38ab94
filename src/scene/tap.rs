//! Sources and sinks: where liquid comes in and where it is taken away.

use std::path::Path;

use glam::DVec3;

use super::document::{Keys, Place, Table};
use super::read::{MAX_VELOCITY, bounded, list};
use super::shape::shape;
use super::{Domain, Liquid, Placement, Shape, Sink, Source, Surface};
use crate::error::Error;

const SHAPES: [&str; 3] = ["box", "sphere", "cylinder"];
const SOURCE: Keys = Keys {
    valid: &["box", "sphere", "cylinder", "velocity", "start", "end"],
    absent: &[],
};
const SINK: Keys = Keys {
    valid: &["box", "sphere", "cylinder"],
    absent: &[],
};
/// Most sources, and most sinks: which of them run are bits of a word.
const MOST: usize = 32;

/// The sources of a scene.
pub(super) fn sources(
    root: &Table,
    file: &Path,
    domain: &Domain,
    liquid: Option<&Liquid>,
) -> Result<Vec<Source>, Error> {
    let source = |place: Place| {
        let (table, shape) = region(&place, &SOURCE, file, domain)?;
        let velocity_place = table.required("velocity", "velocity = [0.0, -1.0, 0.0], in m/s")?;
        let velocity = bounded(&velocity_place, "a velocity in m/s", MAX_VELOCITY)?;
        velocity_place.ensure(
            velocity != DVec3::ZERO,
            "is zero, so nothing comes out",
            "write a velocity in m/s, such as [0.0, -1.0, 0.0]",
        )?;
        let start = match table.get("start") {
            Some(place) => {
                let start = place.number("the time in s from which on it runs")?;
                place.within(
                    start,
                    0.0..,
                    format!("is {start}"),
                    "write a time of 0 s or later",
                )?;
                start
            }
            None => 0.0,
        };
        let end = match table.get("end") {
            Some(place) => {
                let end = place.number("the time in s at which it ends")?;
                place.ensure(
                    end > start,
                    format!("is {end}, and it starts at {start} s"),
                    "write a time after the start",
                )?;
                end
            }
            None => f64::INFINITY,
        };
        Ok(Source {
            shape,
            velocity,
            start,
            end,
        })
    };
    entries(root, "source", liquid)?
        .into_iter()
        .map(source)
        .collect()
}

/// The sinks of a scene.
pub(super) fn sinks(
    root: &Table,
    file: &Path,
    domain: &Domain,
    liquid: Option<&Liquid>,
) -> Result<Vec<Sink>, Error> {
    let sink = |place: Place| {
        let (_, shape) = region(&place, &SINK, file, domain)?;
        Ok(Sink { shape })
    };
    entries(root, "sink", liquid)?
        .into_iter()
        .map(sink)
        .collect()
}

/// The entries of a list that only a liquid with markers has.
fn entries<'a>(
    root: &Table<'a>,
    key: &str,
    liquid: Option<&Liquid>,
) -> Result<Vec<Place<'a>>, Error> {
    let Some(place) = root.get(key) else {
        return Ok(Vec::new());
    };
    let entries = place.list()?;
    place.ensure(
        entries.is_empty() || liquid.is_some(),
        "is of liquid, and the scene has none",
        format!("remove [[{key}]], or add a [liquid] section"),
    )?;
    let fixed = liquid.is_some_and(|liquid| liquid.surface == Surface::Fixed);
    place.ensure(
        entries.is_empty() || !fixed,
        "changes how much liquid there is, and a fixed surface stays where it is",
        "use liquid.surface = \"markers\"",
    )?;
    place.ensure(
        entries.len() <= MOST,
        format!("has {} entries", entries.len()),
        format!("use at most {MOST}"),
    )?;
    Ok(entries)
}

/// The table of an entry and its shape.
fn region<'a>(
    place: &Place<'a>,
    keys: &Keys,
    file: &Path,
    domain: &Domain,
) -> Result<(Table<'a>, Shape), Error> {
    let table = place.clone().table(keys)?;
    let (kind, shape_place) = table.one_of(&SHAPES, "shape")?;
    let shape = shape(kind, shape_place.clone(), file)?;
    shape_place.ensure(
        shape.reaches(&Placement::default(), domain.size),
        format!(
            "lies outside the domain, which goes from the origin to {} m",
            list(domain.size.to_array())
        ),
        "move it so that a part lies inside",
    )?;
    Ok((table, shape))
}
