//! Probes and their columns in probes.csv.

use std::collections::BTreeMap;
use std::path::Path;

use glam::DVec3;

use super::document::{Keys, Place, Table};
use super::read::{list, unique_name};
use super::solid::node_region;
use super::{Domain, Probe, ProbeKind, ProbedNodes, Solid, Up};
use crate::error::Error;

const PROBE: Keys = Keys::new(&[
    "name",
    "height",
    "pressure",
    "velocity",
    "front",
    "flux",
    "node",
    "node_velocity",
    "solid",
    "solid_velocity",
    FORCE_MEASUREMENT,
    "reaction",
]);
/// All measurements: those of liquid alone first.
pub(super) const MEASUREMENTS: &[&str] = PROBE.valid.split_at(1).1;
pub(super) const LIQUID_MEASUREMENTS: &[&str] = MEASUREMENTS.split_at(5).0;
/// The measurement of liquid and solids.
pub(super) const FORCE_MEASUREMENT: &str = "force";
/// Values of `front.axis`: the axis, and whether it is the smallest coordinate.
const FRONT_AXES: [(&str, (usize, bool)); 6] =
    [("x", (0, false)), ("y", (1, false)), ("z", (2, false)), ("-x", (0, true)), ("-y", (1, true)), ("-z", (2, true))];
const FLUX: Keys = Keys::new(&["min", "max"]);
const HEIGHT: Keys = Keys::new(&["x", "y", "z"]);
const POINT: Keys = Keys::new(&["point"]);
const FRONT: Keys = Keys::new(&["axis"]);
const NODE: Keys = Keys::new(&["solid", "rest_point", "region"]);
const REACTION: Keys = Keys::new(&["solid", "region"]);
const SOLID: Keys = Keys::new(&["name"]);
const FORCE: Keys = Keys::new(&["solid"]);

pub(super) fn probes(
    root: &Table,
    file: &Path,
    domain: &Domain,
    has_liquid: bool,
    solids: &[Solid],
) -> Result<Vec<Probe>, Error> {
    let Some(places) = root.get("probe") else {
        return Ok(Vec::new());
    };
    let mut probes: Vec<Probe> = Vec::new();
    let mut owners = BTreeMap::from(
        [("step", "the number of the sub-step"), ("t", "the time")]
            .map(|(column, owner)| (column.to_owned(), owner.to_owned())),
    );
    for place in places.list()? {
        let table = place.table(&PROBE)?;
        let name_place = table.required("name", "name = \"h1\", the column of probes.csv")?;
        let name = name_place.text("the name of a column in probes.csv")?;
        let earlier = probes.iter().map(|probe| probe.name.as_str());
        unique_name(&name_place, name, "probe", earlier)?;
        let probe = Probe { name: name.to_owned(), kind: measurement(&table, file, domain, has_liquid, solids)? };
        for column in probe.columns() {
            if let Some(owner) = owners.get(&column) {
                let problem = format!("needs column \"{column}\" of probes.csv, the column of {owner}");
                return Err(name_place.fail(problem, "choose another name"));
            }
            owners.insert(column, format!("probe \"{name}\""));
        }
        probes.push(probe);
    }
    Ok(probes)
}

fn measurement(
    table: &Table,
    file: &Path,
    domain: &Domain,
    has_liquid: bool,
    solids: &[Solid],
) -> Result<ProbeKind, Error> {
    let (kind, place) = table.one_of(MEASUREMENTS, "measurement")?;
    if LIQUID_MEASUREMENTS.contains(&kind) {
        let cure = "measure a solid: node = { solid, rest_point } or solid = { name }";
        place.ensure(has_liquid, "measures liquid, and the scene has none", cure)?;
    } else {
        let cure = "measure the liquid: height, pressure, velocity, front or flux";
        let problem = "measures a solid, and the scene has no [[solid]]";
        place.ensure(!solids.is_empty(), problem, cure)?;
    }
    if kind == FORCE_MEASUREMENT {
        let problem = "measures the force of liquid, and the scene has none";
        place.ensure(has_liquid, problem, "add a [liquid] section with a region")?;
    }
    Ok(match kind {
        "height" => height(place, domain)?,
        "pressure" => ProbeKind::Pressure { point: point(place, domain)? },
        "velocity" => ProbeKind::Velocity { point: point(place, domain)? },
        "front" => {
            let table = place.table(&FRONT)?;
            let axis = table.required("axis", "axis = \"x\"")?;
            let (axis, lower) = axis.choice(&FRONT_AXES)?;
            ProbeKind::Front { axis, lower }
        }
        "flux" => flux(place, domain)?,
        "node" | "node_velocity" => {
            let table = place.table(&NODE)?;
            let (nodes, place) = table.one_of(&["rest_point", "region"], "choice of nodes")?;
            ProbeKind::Node {
                solid: solid_named(&table, "solid", solids)?,
                nodes: match nodes {
                    "region" => ProbedNodes::Within(node_region(&table, file)?),
                    _ => ProbedNodes::Nearest(place.vector("a point of the solid at rest in m")?),
                },
                velocity: kind == "node_velocity",
            }
        }
        "solid_velocity" => ProbeKind::SolidVelocity { solid: solid_named(&place.table(&SOLID)?, "name", solids)? },
        "reaction" => {
            let table = place.table(&REACTION)?;
            let region = table.get("region").map(|_| node_region(&table, file));
            ProbeKind::Reaction { solid: solid_named(&table, "solid", solids)?, region: region.transpose()? }
        }
        FORCE_MEASUREMENT => ProbeKind::Force { solid: solid_named(&place.table(&FORCE)?, "solid", solids)? },
        _ => ProbeKind::Solid { solid: solid_named(&place.table(&SOLID)?, "name", solids)? },
    })
}

/// Height along a vertical line; the two horizontal coordinates select it.
fn height(place: Place, domain: &Domain) -> Result<ProbeKind, Error> {
    let table = place.table(&HEIGHT)?;
    let up = Up::against(domain.gravity);
    let mut foot = DVec3::ZERO;
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        let Some(place) = table.get(name) else {
            if axis == up.axis {
                continue;
            }
            let problem = format!("has no `{name}`");
            return Err(table.fail(problem, format!("add {name} = 0.5, in m")));
        };
        place.ensure(
            axis != up.axis,
            "is along gravity, the direction of the height",
            "remove it: the two other coordinates select the line",
        )?;
        let value = place.number("a coordinate in m")?;
        let side = domain.size[axis];
        place.ensure(
            (0.0..=side).contains(&value),
            format!("{value} m lies outside the domain"),
            format!("use 0 to {side} m"),
        )?;
        foot[axis] = value;
    }
    Ok(ProbeKind::Height { foot, up })
}

/// Index of the solid that a key names.
fn solid_named(table: &Table, key: &str, solids: &[Solid]) -> Result<usize, Error> {
    let place = table.required(key, &format!("{key} = \"{}\", the name of a solid", solids[0].name))?;
    let names: Vec<(&str, usize)> = (0..).zip(solids).map(|(index, solid)| (solid.name.as_str(), index)).collect();
    place.named("the name of a solid", &names)
}

/// A rectangle whose corners have one equal coordinate.
fn flux(place: Place, domain: &Domain) -> Result<ProbeKind, Error> {
    let table = place.clone().table(&FLUX)?;
    let corner = |key: &str, example: &str| {
        let place = table.required(key, &format!("{key} = {example}, a corner in m"))?;
        point_inside(&place, domain)
    };
    let min = corner("min", "[0.5, 0, 0]")?;
    let max = corner("max", "[0.5, 1, 1]")?;
    let mut flat = (0..3).filter(|&axis| min[axis] == max[axis]);
    let (axis, others) = (flat.next(), flat.next());
    let Some(axis) = axis.filter(|_| others.is_none() && min.cmple(max).all()) else {
        let problem = format!("{} to {} is no rectangle along two axes", list(min.to_array()), list(max.to_array()));
        let cure = "use one equal coordinate, and smaller ones in min for the two others: min = [0.5, 0, 0], max = [0.5, 1, 1]";
        return Err(place.fail(problem, cure));
    };
    Ok(ProbeKind::Flux { axis, min, max })
}

fn point(place: Place, domain: &Domain) -> Result<DVec3, Error> {
    let table = place.table(&POINT)?;
    let place = table.required("point", "point = [0.5, 0.1, 0.5], in m")?;
    point_inside(&place, domain)
}

fn point_inside(place: &Place, domain: &Domain) -> Result<DVec3, Error> {
    let point = place.vector("a point in m")?;
    let inside = point.cmpge(DVec3::ZERO).all() && point.cmple(domain.size).all();
    let problem = format!("{} lies outside the domain", list(point.to_array()));
    place.ensure(inside, problem, format!("stay between the origin and {}", list(domain.size.to_array())))?;
    Ok(point)
}
