//! Sources and sinks: where liquid comes in and where it is taken away.

use std::path::Path;

use glam::DVec3;

use super::document::{Keys, Place, Table};
use super::read::{MAX_VELOCITY, bounded, list};
use super::shape::shape;
use super::{Domain, Liquid, Placement, Shape, Sink, Source, Surface};
use crate::error::{Error, rounded};

const SHAPES: [&str; 3] = ["box", "sphere", "cylinder"];
const SOURCE: Keys = Keys {
    valid: &[
        "box",
        "sphere",
        "cylinder",
        "velocity",
        "flow_rate",
        "direction",
        "start",
        "end",
    ],
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
        let (velocity, flow_rate) = flow(&table, &shape)?;
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
            flow_rate,
            start,
            end,
        })
    };
    entries(root, "source", liquid)?
        .into_iter()
        .map(source)
        .collect()
}

/// Least speed of a source, m/s: below it velocities have no direction in single precision.
const SLOWEST: f64 = 1e-12;

/// The velocity of a source and, where it is given instead, the flow rate.
fn flow(table: &Table, shape: &Shape) -> Result<(DVec3, Option<f64>), Error> {
    let direction = table.get("direction");
    let (kind, place) = table.one_of(&["velocity", "flow_rate"], "velocity or flow rate")?;
    if kind == "velocity" {
        if let Some(direction) = direction {
            return Err(direction.fail(
                "belongs to a flow_rate, and the source has a velocity",
                "remove it, or write flow_rate = 0.001, in m^3/s, instead of the velocity",
            ));
        }
        let velocity = bounded(&place, "a velocity in m/s", MAX_VELOCITY)?;
        place.ensure(
            velocity.length() > SLOWEST,
            "is zero or next to it, so nothing comes out",
            "write a velocity in m/s, such as [0.0, -1.0, 0.0]",
        )?;
        return Ok((velocity, None));
    }
    let flow_rate = place.positive("the flow rate in m^3/s")?;
    let way = match (direction, shape) {
        (Some(direction), _) => direction.direction("the direction of the flow")?,
        (None, Shape::Cylinder { axis, .. }) => *axis,
        (None, _) => table
            .required("direction", "direction = [0, -1, 0], of the flow")?
            .direction("the direction of the flow")?,
    };
    let speed = flow_rate / shape.projected_area(way);
    place.ensure(
        (SLOWEST..=MAX_VELOCITY).contains(&speed),
        format!("makes a speed of {} m/s", rounded(speed)),
        "write a flow rate in m^3/s (a litre per second is 0.001)",
    )?;
    Ok((speed * way, Some(flow_rate)))
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
