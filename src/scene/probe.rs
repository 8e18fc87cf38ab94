//! Probes: how they are written, and which columns they make.

use std::collections::BTreeMap;

use glam::DVec3;

use super::document::{Keys, Place, Table};
use super::read::list;
use super::{Domain, Probe, ProbeKind, Solid, Up};
use crate::error::Error;

const PROBE: Keys = Keys {
    valid: &[
        "name", "height", "pressure", "velocity", "front", "node", "solid", "force",
    ],
    absent: &[],
};
/// What measures liquid.
const OF_LIQUID: [&str; 4] = ["height", "pressure", "velocity", "front"];
/// All measurements: those of liquid first.
const MEASUREMENTS: [&str; 7] = [
    "height", "pressure", "velocity", "front", "node", "solid", "force",
];
const HEIGHT: Keys = Keys {
    valid: &["x", "y", "z"],
    absent: &[],
};
const POINT: Keys = Keys {
    valid: &["point"],
    absent: &[],
};
const FRONT: Keys = Keys {
    valid: &["axis"],
    absent: &[],
};
const NODE: Keys = Keys {
    valid: &["solid", "rest_point"],
    absent: &[],
};
const SOLID: Keys = Keys {
    valid: &["name"],
    absent: &[],
};
const FORCE: Keys = Keys {
    valid: &["solid"],
    absent: &[],
};

/// All probes of a scene, in order.
pub(super) fn probes(
    root: &Table,
    domain: &Domain,
    has_liquid: bool,
    solids: &[Solid],
) -> Result<Vec<Probe>, Error> {
    let Some(places) = root.get("probe") else {
        return Ok(Vec::new());
    };
    let mut probes: Vec<Probe> = Vec::new();
    let mut taken = BTreeMap::from(
        [("step", "the number of the sub-step"), ("t", "the time")]
            .map(|(name, what)| (name.to_owned(), what.to_owned())),
    );
    for place in places.list()? {
        let table = place.table(&PROBE)?;
        let name_place = table.required("name", "name = \"h1\", the column of probes.csv")?;
        let name = name_place.text("the name of a column in probes.csv")?;
        let plain = name
            .chars()
            .all(|c| c.is_ascii_alphanumeric() || "_-.".contains(c));
        let problem = format!("\"{name}\" cannot name a column");
        name_place.ensure(plain, problem, "use letters, digits, _, - and . only")?;
        let named = probes.iter().any(|probe| probe.name == name);
        let problem = format!("a probe before it is named \"{name}\" too");
        name_place.ensure(!named, problem, "choose another name")?;

        let (kind, place) = table.one_of(&MEASUREMENTS, "measurement")?;
        if OF_LIQUID.contains(&kind) {
            let cure = "measure a solid: node = { solid, rest_point } or solid = { name }";
            place.ensure(
                has_liquid,
                "measures liquid, of which the scene has none",
                cure,
            )?;
        } else {
            let cure = "measure the liquid: height, pressure, velocity or front";
            let problem = "measures a solid, and the scene has no [[solid]]";
            place.ensure(!solids.is_empty(), problem, cure)?;
        }
        if kind == "force" {
            let problem = "measures the force of liquid, of which the scene has none";
            place.ensure(has_liquid, problem, "add a [liquid] section with a region")?;
        }
        let kind = match kind {
            "height" => {
                let table = place.table(&HEIGHT)?;
                let up = Up::against(domain.gravity);
                let mut foot = DVec3::ZERO;
                for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
                    let Some(place) = table.get(name) else {
                        let problem = format!("has no `{name}`");
                        match axis == up.axis {
                            true => continue,
                            false => {
                                return Err(table.fail(problem, format!("add {name} = 0.5, in m")));
                            }
                        }
                    };
                    place.ensure(
                        axis != up.axis,
                        "is along gravity, and the height is measured that way",
                        "remove it: the two other coordinates say where",
                    )?;
                    let value = place.number("a coordinate in m")?;
                    let side = domain.size[axis];
                    let problem = format!("{value} m lies outside the domain");
                    place.ensure(
                        (0.0..=side).contains(&value),
                        problem,
                        format!("use 0 to {side} m"),
                    )?;
                    foot[axis] = value;
                }
                ProbeKind::Height { foot, up }
            }
            "pressure" => ProbeKind::Pressure {
                point: point(place, domain)?,
            },
            "velocity" => ProbeKind::Velocity {
                point: point(place, domain)?,
            },
            "front" => {
                let table = place.table(&FRONT)?;
                let axis = table.required("axis", "axis = \"x\"")?;
                ProbeKind::Front {
                    axis: axis.choice(&[("x", 0), ("y", 1), ("z", 2)])?,
                }
            }
            "node" => {
                let table = place.table(&NODE)?;
                let point = table.required("rest_point", "rest_point = [0.5, 0.1, 0.5], in m")?;
                ProbeKind::Node {
                    solid: solid_named(&table, "solid", solids)?,
                    rest_point: point.vector("a point of the solid at rest in m")?,
                }
            }
            "force" => ProbeKind::Force {
                solid: solid_named(&place.table(&FORCE)?, "solid", solids)?,
            },
            _ => ProbeKind::Solid {
                solid: solid_named(&place.table(&SOLID)?, "name", solids)?,
            },
        };
        let probe = Probe {
            name: name.to_owned(),
            kind,
        };
        for column in probe.columns() {
            if let Some(owner) = taken.get(&column) {
                let problem =
                    format!("makes column \"{column}\" of probes.csv, which {owner} has already");
                return Err(name_place.fail(problem, "choose another name"));
            }
            taken.insert(column, format!("probe \"{name}\""));
        }
        probes.push(probe);
    }
    Ok(probes)
}

/// The index of the solid whose name stands under a key.
fn solid_named(table: &Table, key: &str, solids: &[Solid]) -> Result<usize, Error> {
    let place = table.required(
        key,
        &format!("{key} = \"{}\", the name of a solid", solids[0].name),
    )?;
    let names: Vec<(&str, usize)> = (0..)
        .zip(solids)
        .map(|(index, solid)| (solid.name.as_str(), index))
        .collect();
    place.named("the name of a solid", &names)
}

fn point(place: Place, domain: &Domain) -> Result<DVec3, Error> {
    let table = place.table(&POINT)?;
    let place = table.required("point", "point = [0.5, 0.1, 0.5], in m")?;
    let point = place.vector("a point in m")?;
    let inside = point.cmpge(DVec3::ZERO).all() && point.cmple(domain.size).all();
    let problem = format!("{} lies outside the domain", list(point.to_array()));
    place.ensure(
        inside,
        problem,
        format!(
            "stay between the origin and {}",
            list(domain.size.to_array())
        ),
    )?;
    Ok(point)
}
