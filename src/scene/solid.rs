//! Elastic bodies: how they are written, and what can be told of them before their mesh is made.

use std::ops::Bound;
use std::path::Path;

use glam::{DMat3, DVec3};

use super::document::{Keys, Place, Table};
use super::read::{MAX_VELOCITY, bounded, density as density_of, list};
use super::shape::{existing_file, keyframes, placement, shape, unit};
use super::{Domain, ElasticModel, Initial, Load, LoadKind, Pin, Placement, Solid, SolidMesh};
use crate::error::Error;

/// Most bricks of a box, and most cells of the given size in the cube around a ball: six tetrahedra in each still have 32-bit
/// numbers.
const MAX_CELLS: f64 = (1u64 << 22) as f64;
/// Moduli and tractions, Pa, and forces, N; damping, 1/s and s. Far beyond all bodies; their squares stay in single precision.
const MAX_STRESS: f64 = 1e13;
const MAX_DAMPING: f64 = 1e6;
/// A body may stick out of the domain by this part of the domain's longest side: rounding.
const STICKS_OUT: f64 = 1e-9;

const SOLID: Keys = Keys {
    valid: &[
        "name",
        "mesh",
        "placement",
        "initial",
        "density",
        "young",
        "poisson",
        "model",
        "damping",
        "pin",
        "script",
        "load",
    ],
    absent: &[],
};
const MESH_KINDS: [&str; 5] = ["box", "sphere", "shell", "file", "surface"];
const MESH: Keys = Keys {
    valid: &["box", "sphere", "shell", "file", "surface", "units"],
    absent: &[],
};
const BOX: Keys = Keys {
    valid: &["size", "cells"],
    absent: &[],
};
const SPHERE: Keys = Keys {
    valid: &["radius", "cell_size"],
    absent: &[],
};
const SHELL: Keys = Keys {
    valid: &["radius", "thickness", "cell_size"],
    absent: &[],
};
const SURFACE: Keys = Keys {
    valid: &["file", "units", "cell_size"],
    absent: &[],
};
const INITIAL: Keys = Keys {
    valid: &["scale", "velocity", "spin"],
    absent: &[],
};
const DAMPING: Keys = Keys {
    valid: &["mass", "stiffness"],
    absent: &[],
};
const PIN: Keys = Keys {
    valid: &["region", "components"],
    absent: &[],
};
const SCRIPT: Keys = Keys {
    valid: &["region", "components", "keyframes"],
    absent: &[],
};
const LOAD: Keys = Keys {
    valid: &["region", "force", "traction"],
    absent: &[],
};
/// Shapes that choose nodes.
const REGION_SHAPES: [&str; 4] = ["box", "sphere", "cylinder", "half_space"];
const REGION: Keys = Keys {
    valid: &REGION_SHAPES,
    absent: &[],
};
/// Those of them that have a middle to turn about.
const SCRIPT_SHAPES: [&str; 3] = ["box", "sphere", "cylinder"];
const SCRIPT_REGION: Keys = Keys {
    valid: &SCRIPT_SHAPES,
    absent: &[],
};

/// All solids of a scene, in order; none where it has no `[[solid]]`.
pub(super) fn solids(root: &Table, file: &Path, domain: &Domain) -> Result<Vec<Solid>, Error> {
    let Some(places) = root.get("solid") else {
        return Ok(Vec::new());
    };
    let mut solids: Vec<Solid> = Vec::new();
    for place in &places.list()? {
        let solid = solid(place, file, domain, &solids)?;
        solids.push(solid);
    }
    Ok(solids)
}

fn solid(place: &Place, file: &Path, domain: &Domain, earlier: &[Solid]) -> Result<Solid, Error> {
    let table = place.clone().table(&SOLID)?;
    let name_place = table.required("name", "name = \"beam\", unique in the scene")?;
    let name = name_place.text("a name for the solid")?;
    let plain = name
        .chars()
        .all(|c| c.is_ascii_alphanumeric() || "_-.".contains(c));
    let problem = format!("\"{name}\" cannot name a solid");
    name_place.ensure(plain, problem, "use letters, digits, _, - and . only")?;
    let unique = earlier.iter().all(|solid| solid.name != name);
    let problem = format!("a solid before it is named \"{name}\" too");
    name_place.ensure(unique, problem, "choose another name")?;

    let example = "mesh = { box = { size = [1, 0.1, 0.1], cells = [10, 1, 1] } }";
    let mesh_place = table.required("mesh", example)?;
    let mesh = mesh(&mesh_place, file)?;
    let is_file = matches!(mesh, SolidMesh::File { .. } | SolidMesh::Surface { .. });
    let placement = placement(&table, (!is_file).then_some(DVec3::ZERO))?;
    let initial = match table.get("initial") {
        Some(place) => initial(place)?,
        None => Initial::default(),
    };
    stays_inside(&table, &mesh, &placement, &initial, domain)?;
    let density = table.required("density", "density = 1000, in kg/m^3")?;
    let young = table.required("young", "young = 1e6, Young's modulus in Pa")?;
    let (mass_damping, stiffness_damping) = match table.get("damping") {
        Some(place) => damping(place)?,
        None => (0.0, 0.0),
    };
    let mut pins = Vec::new();
    for place in entries(&table, "pin")? {
        pins.push(pin(place, file)?);
    }
    for place in entries(&table, "script")? {
        pins.push(script(place, file)?);
    }
    let loads = entries(&table, "load")?.into_iter();
    Ok(Solid {
        name: name.to_owned(),
        mesh,
        placement,
        initial,
        density: density_of(&density, "rubber has 1100")?,
        young: stiffness(&young)?,
        poisson: poisson(&table)?,
        model: match table.get("model") {
            Some(place) => place.choice(&[
                ("corotational", ElasticModel::Corotational),
                ("linear", ElasticModel::Linear),
            ])?,
            None => ElasticModel::Corotational,
        },
        mass_damping,
        stiffness_damping,
        pins,
        loads: loads
            .map(|place| load(place, file))
            .collect::<Result<_, _>>()?,
    })
}

/// The entries of `[[solid.KEY]]`; none where it is not given.
fn entries<'a>(table: &Table<'a>, key: &str) -> Result<Vec<Place<'a>>, Error> {
    table.get(key).map_or(Ok(Vec::new()), |place| place.list())
}

fn mesh(place: &Place, file: &Path) -> Result<SolidMesh, Error> {
    let table = place.clone().table(&MESH)?;
    let (kind, place) = table.one_of(&MESH_KINDS, "mesh")?;
    if let Some(place) = table.get("units").filter(|_| kind != "file") {
        let cure = match kind {
            "surface" => {
                "write it beside its file: surface = { file = .., units = .., cell_size = .. }"
            }
            _ => "remove it: lengths in a scene are in m",
        };
        return Err(place.fail(format!("is of a mesh file, and {kind} is none"), cure));
    }
    Ok(match kind {
        "box" => {
            let table = place.table(&BOX)?;
            let size_place = table.required("size", "size = [1, 0.1, 0.1], in m")?;
            let size = size_place.vector("the sides of the box in m")?;
            let problem = format!("is {}", list(size.to_array()));
            size_place.ensure(size.min_element() > 0.0, problem, "write sides above zero")?;
            let cells_place = table.required("cells", "cells = [10, 1, 1], along x, y, z")?;
            let cells = cells_place.counts("the bricks along x, y, z", 1, MAX_CELLS as u64)?;
            let count: f64 = cells.iter().map(|&n| n as f64).product();
            let problem = format!("makes {count} bricks, more than {MAX_CELLS}");
            cells_place.ensure(count <= MAX_CELLS, problem, "use fewer cells")?;
            SolidMesh::Box { size, cells }
        }
        "sphere" => {
            let table = place.table(&SPHERE)?;
            let radius = radius(&table)?;
            SolidMesh::Sphere {
                radius,
                cell_size: ball_cell_size(&table, radius)?,
            }
        }
        "shell" => {
            let table = place.table(&SHELL)?;
            let radius = radius(&table)?;
            let place = table.required("thickness", "thickness = 0.02, in m")?;
            let thickness = place.positive("the thickness of the shell in m")?;
            place.ensure(
                thickness < radius,
                format!("a shell of {thickness} m leaves no hollow in a radius of {radius} m"),
                "make it thinner than the radius, or use a sphere",
            )?;
            SolidMesh::Shell {
                radius,
                thickness,
                cell_size: ball_cell_size(&table, radius)?,
            }
        }
        "file" => SolidMesh::File {
            file: existing_file(
                &place,
                file,
                &["msh", "vtu"],
                "the name of a Gmsh 4.1 .msh or VTK .vtu file",
                "use tetrahedra as Gmsh 4.1 .msh or VTK .vtu, or fill a closed surface: surface = { file, cell_size }",
            )?,
            unit: unit(&table)?,
        },
        _ => {
            let table = place.table(&SURFACE)?;
            let name = table.required("file", "file = \"body.obj\", relative to the scene")?;
            SolidMesh::Surface {
                file: existing_file(
                    &name,
                    file,
                    &["obj", "stl", "ply"],
                    "the name of an OBJ, STL or PLY file",
                    "use a closed triangle mesh as .obj, .stl or .ply",
                )?,
                unit: unit(&table)?,
                cell_size: cell_size(&table)?.1,
            }
        }
    })
}

fn radius(table: &Table) -> Result<f64, Error> {
    table
        .required("radius", "radius = 0.1, in m")?
        .positive("the radius in m")
}

fn cell_size<'a>(table: &Table<'a>) -> Result<(Place<'a>, f64), Error> {
    let place = table.required("cell_size", "cell_size = 0.03, the length of an edge in m")?;
    let cell_size = place.positive("the length of an edge in m")?;
    Ok((place, cell_size))
}

/// The cell size of a ball or shell: at most the radius, and not so small that its nodes cannot be numbered.
fn ball_cell_size(table: &Table, radius: f64) -> Result<f64, Error> {
    let (place, cell_size) = cell_size(table)?;
    let smallest = 2.0 * radius / MAX_CELLS.cbrt();
    place.ensure(
        (smallest..=radius).contains(&cell_size),
        format!("is {cell_size} with a radius of {radius}"),
        format!("use {smallest:.3e} to {radius} m; a quarter of the radius is usual"),
    )?;
    Ok(cell_size)
}

fn initial(place: Place) -> Result<Initial, Error> {
    let table = place.table(&INITIAL)?;
    let mut initial = Initial::default();
    if let Some(place) = table.get("scale") {
        initial.scale = place.number_or_vector("the stretch, one number or one for each axis")?;
    }
    if let Some(place) = table.get("velocity") {
        initial.velocity = bounded(&place, "a velocity in m/s", MAX_VELOCITY)?;
    }
    if let Some(place) = table.get("spin") {
        initial.spin = bounded(&place, "an angular velocity in rad/s", MAX_VELOCITY)?;
    }
    Ok(initial)
}

/// Refuses a box, ball or shell that sticks out of the domain at the start: walls would push its nodes in with force.
fn stays_inside(
    table: &Table,
    mesh: &SolidMesh,
    placement: &Placement,
    initial: &Initial,
    domain: &Domain,
) -> Result<(), Error> {
    let half = match *mesh {
        SolidMesh::Box { size, .. } => {
            let turned = DMat3::from_cols_array(&placement.rotate.to_cols_array().map(f64::abs));
            turned * (0.5 * size)
        }
        SolidMesh::Sphere { radius, .. } | SolidMesh::Shell { radius, .. } => DVec3::splat(radius),
        SolidMesh::File { .. } | SolidMesh::Surface { .. } => return Ok(()),
    };
    let half = half * placement.scale * initial.scale.abs();
    let (low, high) = (placement.translate - half, placement.translate + half);
    let slack = STICKS_OUT * domain.size.max_element();
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        if low[axis] < -slack || high[axis] > domain.size[axis] + slack {
            let problem = format!(
                "sticks out of the domain: along {name} it goes from {} to {} m, the domain from 0 to {} m",
                low[axis], high[axis], domain.size[axis]
            );
            let cure = "move it with placement.at, the place of its middle, or make it smaller";
            let place = table.get("placement").or_else(|| table.get("mesh"));
            return Err(place.expect("a solid has a mesh").fail(problem, cure));
        }
    }
    Ok(())
}

/// Young's modulus, Pa.
fn stiffness(place: &Place) -> Result<f64, Error> {
    let young = place.positive("Young's modulus in Pa")?;
    place.within(
        young,
        1e-3..=MAX_STRESS,
        format!("is {young:?}"),
        format!("use 1e-3 to {MAX_STRESS:e} Pa; rubber has 1e6, steel 2e11"),
    )?;
    Ok(young)
}

fn poisson(table: &Table) -> Result<f64, Error> {
    let place = table.required("poisson", "poisson = 0.3, Poisson's ratio")?;
    let poisson = place.number("Poisson's ratio")?;
    let problem = format!("is {poisson}");
    place.within(
        poisson,
        ..0.5,
        problem.clone(),
        "use less than 0.5, where the resistance to a change of volume is infinite; 0.49 is nearly incompressible, and above \
         it linear tetrahedra act stiffer than the material",
    )?;
    place.within(
        poisson,
        (Bound::Excluded(-1.0), Bound::Unbounded),
        problem,
        "use more than -1, where the resistance to shear is infinite; 0.3 is usual",
    )?;
    Ok(poisson)
}

/// Coefficients of the mass (1/s) and of the stiffness (s).
fn damping(place: Place) -> Result<(f64, f64), Error> {
    let table = place.table(&DAMPING)?;
    let coefficient = |name: &str, what: &str| {
        let Some(place) = table.get(name) else {
            return Ok(0.0);
        };
        let value = place.number(what)?;
        let cure = format!("write {what}, zero or above, at most {MAX_DAMPING:e}");
        place.within(value, 0.0..=MAX_DAMPING, format!("is {value:?}"), cure)?;
        Ok::<f64, Error>(value)
    };
    Ok((
        coefficient("mass", "the damping by mass in 1/s")?,
        coefficient("stiffness", "the damping by stiffness in s")?,
    ))
}

fn region(table: &Table, shapes: &[&str], keys: &Keys, file: &Path) -> Result<super::Shape, Error> {
    let example =
        "region = { box = { min = [0, 0, 0], max = [0.01, 1, 1] } }, around the nodes at rest";
    let region = table.required("region", example)?.table(keys)?;
    let (kind, place) = region.one_of(shapes, "shape")?;
    shape(kind, place, file)
}

/// Some of x, y and z; all by default.
fn components(table: &Table) -> Result<[bool; 3], Error> {
    let Some(place) = table.get("components") else {
        return Ok([true; 3]);
    };
    let what = "the components that are held, such as \"xyz\" or \"y\"";
    let text = place.text(what)?;
    let mut held = [false; 3];
    for letter in text.chars() {
        let axis = "xyz".find(letter).filter(|&axis| !held[axis]);
        let Some(axis) = axis else {
            let problem = format!("is \"{text}\"");
            let cure = format!("write {what}: the letters x, y, z, each once at most");
            return Err(place.fail(problem, cure));
        };
        held[axis] = true;
    }
    Ok(held)
}

fn pin(place: Place, file: &Path) -> Result<Pin, Error> {
    let table = place.table(&PIN)?;
    Ok(Pin {
        region: region(&table, &REGION_SHAPES, &REGION, file)?,
        components: components(&table)?,
        keyframes: Vec::new(),
    })
}

fn script(place: Place, file: &Path) -> Result<Pin, Error> {
    let table = place.table(&SCRIPT)?;
    Ok(Pin {
        region: region(&table, &SCRIPT_SHAPES, &SCRIPT_REGION, file)?,
        components: components(&table)?,
        keyframes: keyframes(&table)?,
    })
}

fn load(place: Place, file: &Path) -> Result<Load, Error> {
    let table = place.table(&LOAD)?;
    let (kind, place) = table.one_of(&["force", "traction"], "kind of load")?;
    Ok(Load {
        region: region(&table, &REGION_SHAPES, &REGION, file)?,
        kind: match kind {
            "force" => LoadKind::Force(bounded(
                &place,
                "the force on all nodes together in N",
                MAX_STRESS,
            )?),
            _ => LoadKind::Traction(bounded(
                &place,
                "the traction in Pa of rest area",
                MAX_STRESS,
            )?),
        },
    })
}
