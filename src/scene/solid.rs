//! Elastic bodies: their keys, and checks that need no mesh.

use std::ops::Bound;
use std::path::Path;

use glam::{DMat3, DVec3};

use super::document::{Keys, Place, Table};
use super::read::{MAX_VELOCITY, bounded, density, friction, list, unique_name};
use super::shape::{keyframes, mesh_file, placement, shape, surface_file, unit, vector_keyframes};
use super::{Domain, ElasticModel, Initial, Load, LoadKind, Pin, Placement, Solid, SolidMesh};
use crate::error::Error;
use crate::grid::Axis;

/// Most bricks of a box, and most cells in the cube around a ball: six tetrahedra in each can be numbered with 32 bits.
const MAX_CELLS: f64 = (1u64 << 22) as f64;
/// Limit of moduli and tractions, Pa, and forces, N. Their squares are representable in single precision.
const MAX_STRESS: f64 = 1e13;
/// Limit of coordinates of a pivot, m.
const MAX_PIVOT: f64 = 1e6;
/// Limit of damping coefficients, 1/s and s.
const MAX_DAMPING: f64 = 1e6;
/// Rounding of the walls' positions, relative to the domain's longest side.
const WALL_TOLERANCE: f64 = 1e-9;

const SOLID: Keys = Keys::new(&[
    "name",
    "mesh",
    "placement",
    "initial",
    "density",
    "young",
    "poisson",
    "model",
    "damping",
    "friction",
    "contact",
    "no_contact_with",
    "self_contact",
    "pin",
    "script",
    "load",
]);
const MESH_KINDS: [&str; 5] = ["box", "sphere", "shell", "file", "surface"];
const MESH: Keys = Keys::new(&["box", "sphere", "shell", "file", "surface", "units"]);
const BOX: Keys = Keys::new(&["size", "cells"]);
const SPHERE: Keys = Keys::new(&["radius", "cell_size"]);
const SHELL: Keys = Keys::new(&["radius", "thickness", "cell_size"]);
const SURFACE: Keys = Keys::new(&["file", "units", "cell_size"]);
const INITIAL: Keys = Keys::new(&["scale", "velocity", "spin", "velocity_gradient"]);
const VELOCITY_GRADIENT: Keys = Keys::new(&["x", "y", "z"]);
const DAMPING: Keys = Keys::new(&["mass", "stiffness"]);
const PIN: Keys = Keys::new(&["region", "components"]);
const SCRIPT: Keys = Keys::new(&["region", "components", "keyframes", "pivot"]);
const LOAD: Keys = Keys::new(&["region", "force", "traction", "force_keyframes", "traction_keyframes"]);
const LOAD_KINDS: [&str; 4] = ["force", "traction", "force_keyframes", "traction_keyframes"];
const FORCE_KEYFRAME: Keys = Keys::new(&["t", "force"]);
const TRACTION_KEYFRAME: Keys = Keys::new(&["t", "traction"]);
/// Shapes that select nodes.
const REGION_SHAPES: [&str; 4] = ["box", "sphere", "cylinder", "half_space"];
const REGION: Keys = Keys::new(&REGION_SHAPES);
/// Shapes with a centre of rotation.
const SCRIPT_SHAPES: [&str; 3] = ["box", "sphere", "cylinder"];
const SCRIPT_REGION: Keys = Keys::new(&SCRIPT_SHAPES);

pub(super) fn solids(root: &Table, file: &Path, domain: &Domain) -> Result<Vec<Solid>, Error> {
    let Some(places) = root.get("solid") else {
        return Ok(Vec::new());
    };
    let places = places.list()?;
    let mut solids: Vec<Solid> = Vec::new();
    for place in &places {
        let solid = solid(place, file, domain, &solids)?;
        solids.push(solid);
    }
    for (number, place) in places.into_iter().enumerate() {
        let others = no_contact_with(&place.table(&SOLID)?, number, &solids)?;
        solids[number].no_contact_with = others;
    }
    Ok(solids)
}

/// The indices of the solids that a solid does not touch.
fn no_contact_with(table: &Table, number: usize, solids: &[Solid]) -> Result<Vec<usize>, Error> {
    let entries = entries(table, "no_contact_with")?.into_iter();
    let index = |entry: Place| {
        let name = entry.text("the name of another solid")?;
        match solids.iter().position(|other| other.name == name) {
            Some(other) if other == number => {
                Err(entry.fail("names the solid itself", "remove it; self_contact decides about that"))
            }
            Some(other) => Ok(other),
            None => {
                let others = solids.iter().enumerate().filter(|(other, _)| *other != number);
                let others: Vec<&str> = others.map(|(_, other)| other.name.as_str()).collect();
                let cure = match others.is_empty() {
                    true => "remove it: the scene has no other solid".to_owned(),
                    false => format!("use one of {}", others.join(", ")),
                };
                Err(entry.fail(format!("no solid is named \"{name}\""), cure))
            }
        }
    };
    entries.map(index).collect()
}

fn solid(place: &Place, file: &Path, domain: &Domain, earlier: &[Solid]) -> Result<Solid, Error> {
    let table = place.clone().table(&SOLID)?;
    let name_place = table.required("name", "name = \"beam\", unique in the scene")?;
    let name = name_place.text("a name for the solid")?;
    let earlier = earlier.iter().map(|solid| solid.name.as_str());
    unique_name(&name_place, name, "solid", earlier)?;

    let example = "mesh = { box = { size = [1, 0.1, 0.1], cells = [10, 1, 1] } }";
    let mesh_place = table.required("mesh", example)?;
    let mesh = mesh(&mesh_place, file)?;
    let is_file = matches!(mesh, SolidMesh::File { .. } | SolidMesh::Surface { .. });
    let placement = placement(&table, (!is_file).then_some(DVec3::ZERO))?;
    let initial = table.optional("initial", Initial::default(), initial)?;
    ensure_inside(&table, &mesh, &placement, &initial, domain)?;
    let density_place = table.required("density", "density = 1000, in kg/m^3")?;
    let young_place = table.required("young", "young = 1e6, Young's modulus in Pa")?;
    let (mass_damping, stiffness_damping) = table.optional("damping", (0.0, 0.0), damping)?;
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
        stretch: DVec3::ONE,
        initial,
        density: density(&density_place, "rubber has 1100")?,
        young: young_place.positive_within(
            "Young's modulus in Pa",
            1e-3..=MAX_STRESS,
            format!("use 1e-3 to {MAX_STRESS:e} Pa; rubber has 1e6, steel 2e11"),
        )?,
        poisson: poisson(&table)?,
        model: table.optional("model", ElasticModel::Corotational, |place| {
            place.choice(&[("corotational", ElasticModel::Corotational), ("linear", ElasticModel::Linear)])
        })?,
        mass_damping,
        stiffness_damping,
        friction: friction(&table)?,
        contact: table.optional("contact", true, |place| place.boolean())?,
        // Needs the names of all solids.
        no_contact_with: Vec::new(),
        self_contact: table.optional("self_contact", false, |place| place.boolean())?,
        pins,
        loads: loads.map(|place| load(place, file)).collect::<Result<_, _>>()?,
    })
}

/// The entries of `[[solid.KEY]]`.
fn entries<'a>(table: &Table<'a>, key: &str) -> Result<Vec<Place<'a>>, Error> {
    table.optional(key, Vec::new(), |place| place.list())
}

fn mesh(place: &Place, file: &Path) -> Result<SolidMesh, Error> {
    let table = place.clone().table(&MESH)?;
    let (kind, place) = table.one_of(&MESH_KINDS, "mesh")?;
    if let Some(place) = table.get("units").filter(|_| kind != "file") {
        let cure = match kind {
            "surface" => "write it beside its file: surface = { file = .., units = .., cell_size = .. }",
            _ => "remove it: lengths in a scene are in m",
        };
        return Err(place.fail(format!("needs a mesh file, and {kind} is none"), cure));
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
            let problem = format!("results in {count} bricks, more than {MAX_CELLS}");
            cells_place.ensure(count <= MAX_CELLS, problem, "use fewer cells")?;
            SolidMesh::Box { size, cells }
        }
        "sphere" => {
            let table = place.table(&SPHERE)?;
            let radius = radius(&table)?;
            SolidMesh::Sphere { radius, cell_size: ball_cell_size(&table, radius)? }
        }
        "shell" => {
            let table = place.table(&SHELL)?;
            let radius = radius(&table)?;
            let place = table.required("thickness", "thickness = 0.02, in m")?;
            let thickness = place.positive("the thickness of the shell in m")?;
            place.ensure(
                thickness < radius,
                format!("a shell of {thickness} m leaves no hollow in a radius of {radius} m"),
                "use a thickness below the radius, or a sphere",
            )?;
            SolidMesh::Shell { radius, thickness, cell_size: ball_cell_size(&table, radius)? }
        }
        "file" => SolidMesh::File {
            file: mesh_file(
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
            let (file, unit) = surface_file(&table, file)?;
            SolidMesh::Surface { file, unit, cell_size: cell_size(&table)?.1 }
        }
    })
}

fn radius(table: &Table) -> Result<f64, Error> {
    table.required("radius", "radius = 0.1, in m")?.positive("the radius in m")
}

fn cell_size<'a>(table: &Table<'a>) -> Result<(Place<'a>, f64), Error> {
    let place = table.required("cell_size", "cell_size = 0.03, the length of an edge in m")?;
    let cell_size = place.positive("the length of an edge in m")?;
    Ok((place, cell_size))
}

/// Cell size of a ball or shell, m. It is at most the radius, and so large that 32 bits can number the nodes.
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
    let bounded = |key: &str, what: &str| table.optional(key, DVec3::ZERO, |place| bounded(&place, what, MAX_VELOCITY));
    Ok(Initial {
        scale: table.optional("scale", DVec3::ONE, |place| {
            place.number_or_vector("the stretch, one number or one for each axis")
        })?,
        velocity: bounded("velocity", "a velocity in m/s")?,
        spin: bounded("spin", "an angular velocity in rad/s")?,
        velocity_gradient: table.optional("velocity_gradient", [DVec3::ZERO; 3], velocity_gradient)?,
    })
}

/// Gradients of the three components of the velocity, 1/s.
fn velocity_gradient(place: Place) -> Result<[DVec3; 3], Error> {
    let table = place.table(&VELOCITY_GRADIENT)?;
    let row = |key: &str| {
        table.optional(key, DVec3::ZERO, |place| bounded(&place, "a gradient of velocity in 1/s", MAX_VELOCITY))
    };
    Ok([row("x")?, row("y")?, row("z")?])
}

/// Refuses a box, ball or shell that starts partly outside the domain: the walls would accelerate its nodes inwards.
fn ensure_inside(
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
    let slack = WALL_TOLERANCE * domain.size.max_element();
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        let [cut_low, cut_high] = [0, 1].map(|side| domain.symmetry.has(Axis::ALL[axis], side));
        if low[axis] < -slack && !cut_low || high[axis] > domain.size[axis] + slack && !cut_high {
            let problem = format!(
                "sticks out of the domain: along {name} it extends from {} to {} m, the domain from 0 to {} m",
                low[axis], high[axis], domain.size[axis]
            );
            let cure = "move it with placement.at, the position of its centre, or shrink it";
            let place = table.get("placement").or_else(|| table.get("mesh"));
            return Err(place.expect("a solid has a mesh").fail(problem, cure));
        }
    }
    Ok(())
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

/// Rayleigh coefficients of the mass (1/s) and of the stiffness (s).
fn damping(place: Place) -> Result<(f64, f64), Error> {
    let table = place.table(&DAMPING)?;
    let coefficient = |name: &str, what: &str| {
        table.optional(name, 0.0, |place| {
            let cure = format!("write {what}, zero or above, at most {MAX_DAMPING:e}");
            place.number_within(what, 0.0..=MAX_DAMPING, cure)
        })
    };
    Ok((coefficient("mass", "the damping by mass in 1/s")?, coefficient("stiffness", "the damping by stiffness in s")?))
}

/// The shape under `region` that selects nodes.
pub(super) fn node_region(table: &Table, file: &Path) -> Result<super::Shape, Error> {
    region(table, &REGION_SHAPES, &REGION, file)
}

fn region(table: &Table, shapes: &[&str], keys: &Keys, file: &Path) -> Result<super::Shape, Error> {
    let example = "region = { box = { min = [0, 0, 0], max = [0.01, 1, 1] } }, around the nodes at rest";
    let region = table.required("region", example)?.table(keys)?;
    let (kind, place) = region.one_of(shapes, "shape")?;
    shape(kind, place, file)
}

/// The constrained components among x, y and z; all by default.
fn components(table: &Table) -> Result<[bool; 3], Error> {
    let Some(place) = table.get("components") else {
        return Ok([true; 3]);
    };
    let what = "the constrained components, such as \"xyz\" or \"y\"";
    let text = place.text(what)?;
    let mut constrained = [false; 3];
    for letter in text.chars() {
        let axis = "xyz".find(letter).filter(|&axis| !constrained[axis]);
        let Some(axis) = axis else {
            let problem = format!("is \"{text}\"");
            let cure = format!("write {what}: the letters x, y, z, each once at most");
            return Err(place.fail(problem, cure));
        };
        constrained[axis] = true;
    }
    Ok(constrained)
}

fn pin(place: Place, file: &Path) -> Result<Pin, Error> {
    let table = place.table(&PIN)?;
    Ok(Pin { region: node_region(&table, file)?, components: components(&table)?, keyframes: Vec::new(), pivot: None })
}

fn script(place: Place, file: &Path) -> Result<Pin, Error> {
    let table = place.table(&SCRIPT)?;
    Ok(Pin {
        region: region(&table, &SCRIPT_SHAPES, &SCRIPT_REGION, file)?,
        components: components(&table)?,
        keyframes: keyframes(&table)?,
        pivot: table.get("pivot").map(|place| bounded(&place, "the centre of rotation in m", MAX_PIVOT)).transpose()?,
    })
}

fn load(place: Place, file: &Path) -> Result<Load, Error> {
    let table = place.table(&LOAD)?;
    let (kind, place) = table.one_of(&LOAD_KINDS, "kind of load")?;
    let is_force = kind.starts_with("force");
    let what = match is_force {
        true => "the force on all nodes together in N",
        false => "the traction in Pa of rest area",
    };
    let keyframes = match kind {
        "force_keyframes" => {
            let example = "force_keyframes = [{ t = 0, force = [0, 0, 0] }, { t = 1, force = [0, -1, 0] }]";
            vector_keyframes(&place, (&FORCE_KEYFRAME, example), what, MAX_STRESS)?
        }
        "traction_keyframes" => {
            let example = "traction_keyframes = [{ t = 0, traction = [0, 0, 0] }, { t = 1, traction = [0, -1, 0] }]";
            vector_keyframes(&place, (&TRACTION_KEYFRAME, example), what, MAX_STRESS)?
        }
        _ => Vec::new(),
    };
    let value = match keyframes.first() {
        Some(first) => first.value,
        None => bounded(&place, what, MAX_STRESS)?,
    };
    Ok(Load {
        region: node_region(&table, file)?,
        kind: match is_force {
            true => LoadKind::Force(value),
            false => LoadKind::Traction(value),
        },
        keyframes,
    })
}
