//! Sources and sinks of liquid.

use std::path::Path;

use glam::DVec3;

use super::document::{Keys, Place, Table};
use super::read::{MAX_VELOCITY, bounded};
use super::shape::{ensure_in_domain, over_time, shape, vector_keyframes};
use super::{Domain, Liquid, Placement, Shape, Sink, Source, Surface, VectorKeyframe};
use crate::error::{Error, rounded};

const SHAPES: [&str; 3] = ["box", "sphere", "cylinder"];
const SOURCE: Keys = Keys::new(&[
    "box",
    "sphere",
    "cylinder",
    "velocity",
    "flow_rate",
    "velocity_keyframes",
    "flow_rate_keyframes",
    "direction",
    "start",
    "end",
]);
const FLOWS: [&str; 4] = ["velocity", "flow_rate", "velocity_keyframes", "flow_rate_keyframes"];
const VELOCITY_KEYFRAME: Keys = Keys::new(&["t", "velocity"]);
const FLOW_RATE_KEYFRAME: Keys = Keys::new(&["t", "flow_rate"]);
const SINK: Keys = Keys::new(&["box", "sphere", "cylinder"]);
/// Most sources, and most sinks: a 32-bit word stores which of them run.
const MAX_ENTRIES: usize = 32;

pub(super) fn sources(
    root: &Table,
    file: &Path,
    domain: &Domain,
    liquid: Option<&Liquid>,
) -> Result<Vec<Source>, Error> {
    let source = |place: Place| {
        let (table, shape) = region(&place, &SOURCE, file, domain)?;
        let Flow { velocity, flow_rate, keyframes } = flow(&table, &shape)?;
        let start = table.optional("start", 0.0, |place| {
            place.number_within("the start time in s", 0.0.., "write a time of 0 s or later")
        })?;
        let end = table.optional("end", f64::INFINITY, |place| {
            let end = place.number("the end time in s")?;
            place.ensure(
                end > start,
                format!("is {end}, and the source starts at {start} s"),
                "write a time after the start",
            )?;
            Ok(end)
        })?;
        Ok(Source { shape, velocity, flow_rate, keyframes, start, end })
    };
    entries(root, "source", liquid)?.into_iter().map(source).collect()
}

/// Least speed of a source, m/s: a slower velocity has no direction in single precision.
const MIN_SPEED: f64 = 1e-12;

/// Largest sine of the angle between two velocities of a source.
const SAME_DIRECTION: f64 = 1e-9;

/// Velocity and flow rate of a source, see [`Source`].
struct Flow {
    velocity: DVec3,
    flow_rate: Option<f64>,
    keyframes: Vec<VectorKeyframe>,
}

fn flow(table: &Table, shape: &Shape) -> Result<Flow, Error> {
    let direction = table.get("direction");
    let (kind, place) = table.one_of(&FLOWS, "velocity or flow rate")?;
    if kind.starts_with("velocity") {
        if let Some(direction) = direction {
            return Err(direction.fail(
                "needs a flow_rate, and the source has a velocity",
                "remove it, or replace the velocity by flow_rate = 0.001, in m^3/s",
            ));
        }
        let keyframes = match kind {
            "velocity" => Vec::new(),
            _ => velocity_keyframes(&place)?,
        };
        let fastest =
            keyframes.iter().map(|frame| frame.value).reduce(|a, b| if b.length() > a.length() { b } else { a });
        let velocity = match fastest {
            Some(fastest) => fastest,
            None => bounded(&place, "a velocity in m/s", MAX_VELOCITY)?,
        };
        place.ensure(
            velocity.length() > MIN_SPEED,
            "is zero or almost zero, so the source emits nothing",
            "write a velocity in m/s, such as [0.0, -1.0, 0.0]",
        )?;
        ensure_same_direction(&place, velocity, &keyframes)?;
        return Ok(Flow { velocity, flow_rate: None, keyframes });
    }
    let rates = match kind {
        "flow_rate" => Vec::new(),
        _ => flow_rate_keyframes(&place)?,
    };
    let flow_rate = match rates.iter().map(|(_, rate)| *rate).reduce(f64::max) {
        Some(largest) => largest,
        None => place.positive("the flow rate in m^3/s")?,
    };
    let direction = match (direction, shape) {
        (Some(direction), _) => direction.direction("the direction of the flow")?,
        (None, Shape::Cylinder { axis, .. }) => *axis,
        (None, _) => table
            .required("direction", "direction = [0, -1, 0], of the flow")?
            .direction("the direction of the flow")?,
    };
    let speed = flow_rate / shape.projected_area(direction);
    place.ensure(
        (MIN_SPEED..=MAX_VELOCITY).contains(&speed),
        format!("results in a speed of {} m/s", rounded(speed)),
        "write a flow rate in m^3/s (a litre per second is 0.001)",
    )?;
    let velocity = speed * direction;
    let keyframe = |(time, rate): (f64, f64)| VectorKeyframe { time, value: rate / flow_rate * velocity };
    Ok(Flow { velocity, flow_rate: Some(flow_rate), keyframes: rates.into_iter().map(keyframe).collect() })
}

fn velocity_keyframes(place: &Place) -> Result<Vec<VectorKeyframe>, Error> {
    let example = "velocity_keyframes = [{ t = 0, velocity = [0, 0, 0] }, { t = 1, velocity = [0, -1, 0] }]";
    vector_keyframes(place, (&VELOCITY_KEYFRAME, example), "a velocity in m/s", MAX_VELOCITY)
}

/// Times (s) and flow rates (m^3/s).
fn flow_rate_keyframes(place: &Place) -> Result<Vec<(f64, f64)>, Error> {
    let example = "flow_rate_keyframes = [{ t = 0, flow_rate = 0 }, { t = 1, flow_rate = 0.001 }]";
    over_time(place, &FLOW_RATE_KEYFRAME, example, |table, time| {
        let rate = table.required("flow_rate", "flow_rate = 0.001, in m^3/s")?;
        Ok((
            time,
            rate.number_within("the flow rate in m^3/s", 0.0.., "write a flow rate in m^3/s, 0 to close the source")?,
        ))
    })
}

/// Refuses keyframes along another direction than that of the largest velocity: cells and apertures of a source are those of one direction.
fn ensure_same_direction(place: &Place, largest: DVec3, keyframes: &[VectorKeyframe]) -> Result<(), Error> {
    let along = largest.normalize();
    let turns = |frame: &VectorKeyframe| {
        let speed = frame.value.length();
        frame.value.distance(frame.value.dot(along).max(0.0) * along) > SAME_DIRECTION * speed
    };
    match keyframes.iter().find(|frame| turns(frame)) {
        Some(frame) => {
            let [from, to] = [largest, frame.value].map(|v| v.to_array());
            Err(place.fail(
                format!("changes the direction: {to:?} m/s at {} s is not along {from:?}", frame.time),
                "keep one direction, and add a [[source]] of the same shape for each other one",
            ))
        }
        None => Ok(()),
    }
}

pub(super) fn sinks(root: &Table, file: &Path, domain: &Domain, liquid: Option<&Liquid>) -> Result<Vec<Sink>, Error> {
    let sink = |place: Place| {
        let (_, shape) = region(&place, &SINK, file, domain)?;
        Ok(Sink { shape })
    };
    entries(root, "sink", liquid)?.into_iter().map(sink).collect()
}

/// Entries of a list that needs a liquid with markers.
fn entries<'a>(root: &Table<'a>, key: &str, liquid: Option<&Liquid>) -> Result<Vec<Place<'a>>, Error> {
    let Some(place) = root.get(key) else {
        return Ok(Vec::new());
    };
    let entries = place.list()?;
    place.ensure(
        entries.is_empty() || liquid.is_some(),
        "needs liquid, and the scene has none",
        format!("remove [[{key}]], or add a [liquid] section"),
    )?;
    let fixed = liquid.is_some_and(|liquid| liquid.surface == Surface::Fixed);
    place.ensure(
        entries.is_empty() || !fixed,
        "changes the volume of the liquid, and the surface is fixed",
        "use liquid.surface = \"markers\"",
    )?;
    place.ensure(
        entries.len() <= MAX_ENTRIES,
        format!("has {} entries", entries.len()),
        format!("use at most {MAX_ENTRIES}"),
    )?;
    Ok(entries)
}

/// The table of an entry and its shape.
fn region<'a>(place: &Place<'a>, keys: &Keys, file: &Path, domain: &Domain) -> Result<(Table<'a>, Shape), Error> {
    let table = place.clone().table(keys)?;
    let (kind, shape_place) = table.one_of(&SHAPES, "shape")?;
    let shape = shape(kind, shape_place.clone(), file)?;
    let inside = shape.reaches(&Placement::default(), domain.size);
    ensure_in_domain(&shape_place, inside, domain.size)?;
    Ok((table, shape))
}
