//! From the tree of a scene file to a checked [`Scene`].

use std::fmt::Write as _;
use std::path::Path;

use glam::DVec3;
use sha2::{Digest, Sha256};

use super::camera::camera;
use super::document::{Document, Keys, Place, Table};
use super::probe::probes;
use super::shape::{keyframes, placement, shape, solitary};
use super::solid::solids;
use super::surface::surface;
use super::tap::{sinks, sources};
use super::{
    CouplingScheme, Domain, FaceAreas, Formulation, Liquid, Motion, Obstacle, Output,
    PatchPressure, Placement, Precision, Preconditioner, Region, Scene, Shape, Solid, SolidMesh,
    Solver, Surface, Time,
};
use crate::error::Error;
use crate::grid::{Axis, Sides};

/// Most cells of a domain: marker and cell indices on the device have 32 bits.
const MAX_CELLS: f64 = (1u64 << 30) as f64;
/// Most cells along an axis.
const MAX_CELLS_PER_AXIS: u64 = 1 << 16;
/// Sides of a domain, m: beyond, squares and cubes of cell sizes leave single precision.
const SIDES: std::ops::RangeInclusive<f64> = 1e-6..=1e6;
/// Radii of marker spheres, cells. Markers tell the liquid distance up to two cells away, and air that is nearer than half a
/// cell to a sphere counts as partly full: from 1.5 on all air would.
const MARKER_RADII: std::ops::RangeInclusive<f64> = 0.5..=1.2;
/// Densities, kg/m^3; velocities, m/s, and accelerations, m/s^2, along an axis; frames per second. Far beyond all liquids; what
/// is computed from them stays in single precision.
const DENSITIES: std::ops::RangeInclusive<f64> = 1e-6..=1e6;
pub(crate) const MAX_VELOCITY: f64 = 1e6;
const MAX_GRAVITY: f64 = 1e6;
const FRAME_RATES: std::ops::RangeInclusive<f64> = 1e-3..=1e6;
/// Cells are cubic to this relative difference.
const CUBIC: f64 = 1e-6;
/// Most frames of a run: file names have six digits.
pub const MAX_FRAMES: u64 = 999_999;
/// The fixed step divides the frame time to this relative difference.
const WHOLE_STEPS: f64 = 1e-6;

const ROOT: Keys = Keys {
    valid: &[
        "domain", "time", "liquid", "solid", "obstacle", "source", "sink", "probe", "solver",
        "output", "camera", "surface",
    ],
    absent: &[],
};
const DOMAIN: Keys = Keys {
    valid: &["size", "cells", "gravity", "open"],
    absent: &[],
};
const TIME: Keys = Keys {
    valid: &["duration", "frames_per_second", "cfl", "fixed_step"],
    absent: &[],
};
const LIQUID: Keys = Keys {
    valid: &[
        "density",
        "surface",
        "marker_radius",
        "seed",
        "volume_control",
        "region",
    ],
    absent: &[],
};
const REGION_SHAPES: [&str; 7] = [
    "box",
    "sphere",
    "cylinder",
    "half_space",
    "mesh",
    "wave",
    "solitary",
];
const REGION: Keys = Keys {
    valid: &[
        "box",
        "sphere",
        "cylinder",
        "half_space",
        "mesh",
        "wave",
        "solitary",
        "subtract",
        "velocity",
    ],
    absent: &[],
};
const OBSTACLE_SHAPES: [&str; 4] = ["box", "sphere", "cylinder", "mesh"];
const OBSTACLE: Keys = Keys {
    valid: &[
        "box",
        "sphere",
        "cylinder",
        "mesh",
        "placement",
        "inside_out",
        "keyframes",
        "pivot",
    ],
    absent: &[],
};
const SOLVER: Keys = Keys {
    valid: &[
        "tolerance",
        "max_iterations",
        "precision",
        "preconditioner",
        "theta_floor",
        "area_clamp",
        "coupling",
        "face_areas",
        "pressure_on_patches",
        "formulation",
    ],
    absent: &[
        ("sigma", "the form with two fields halves the masses"),
        (
            "alpha",
            "residuals of pressures and of velocities are judged apart, without a weight",
        ),
    ],
};
const OUTPUT: Keys = Keys {
    valid: &[
        "particles",
        "fields",
        "solids",
        "surface",
        "every",
        "checkpoint_every",
    ],
    absent: &[],
};

impl Scene {
    /// Reads and checks a scene file.
    ///
    /// `overrides` are `KEY=VALUE` with dotted keys and indices from 0 (`liquid.region[0].velocity=[1, 0, 0]`); a value that
    /// is no TOML and one word is a text. `scale` multiplies the cells, rounded, and nothing else. The first thing found
    /// wrong is returned, with the file and line (or the override), the key and the cure.
    pub fn load(path: &Path, overrides: &[String], scale: f64) -> Result<Scene, Error> {
        let text = std::fs::read_to_string(path).map_err(|error| {
            let cure = match error.kind() {
                std::io::ErrorKind::NotFound => "give the path of a scene file (TOML)",
                std::io::ErrorKind::InvalidData => "save the file as UTF-8 text",
                _ => "make it a file that can be read",
            };
            Error::input(path.display().to_string(), error.to_string(), cure)
        })?;
        Scene::parse(path, &text, overrides, scale)
    }

    /// The same of the text of a scene file; `path` names it in errors, and files that it names are beside it.
    ///
    /// # Errors
    /// As [`Scene::load`].
    pub fn parse(
        path: &Path,
        text: &str,
        overrides: &[String],
        scale: f64,
    ) -> Result<Scene, Error> {
        if !(scale.is_finite() && scale > 0.0) {
            return Err(Error::input(
                format!("--scale {scale}"),
                "cells cannot be multiplied by it",
                "use a number above zero",
            ));
        }
        let document = Document::parse(path, text, overrides)?;
        Scene::of_document(&document, path, text, overrides, scale)
    }

    /// What a document says; `text` is what it was parsed from.
    pub(super) fn of_document(
        document: &Document,
        path: &Path,
        text: &str,
        overrides: &[String],
        scale: f64,
    ) -> Result<Scene, Error> {
        let root = document.root().table(&ROOT)?;
        let domain = domain(&root, scale)?;
        let solids = solids(&root, path, &domain)?;
        let liquid = match root.get("liquid") {
            None if !solids.is_empty() => None,
            _ => Some(liquid(&root, path, &domain)?),
        };
        let obstacles = obstacles(&root, path, &domain)?;
        let time = time(&root)?;
        let meshes = match document.is_exemplar() {
            true => Vec::new(),
            false => mesh_files(liquid.as_ref(), &obstacles, &solids),
        };
        let scene = Scene {
            name: name(path)?,
            file: path.to_owned(),
            written: document.written(),
            hash: hash(text, overrides, scale, &meshes)?,
            scale,
            overrides: overrides.to_vec(),
            solver: solver(
                &root,
                liquid.as_ref().map(|liquid| liquid.surface),
                !solids.is_empty(),
            )?,
            obstacles,
            sources: sources(&root, path, &domain, liquid.as_ref())?,
            sinks: sinks(&root, path, &domain, liquid.as_ref())?,
            probes: probes(&root, &domain, liquid.is_some(), &solids)?,
            output: output(&root, liquid.is_some(), !solids.is_empty())?,
            surface: surface(
                &root,
                liquid
                    .as_ref()
                    .is_some_and(|liquid| liquid.surface == Surface::Markers),
            )?,
            liquid,
            solids,
            camera: camera(&root, &domain, &time)?,
            time,
            domain,
        };
        Ok(scene)
    }
}

/// SHA-256 of everything that the scene is made from; lengths keep neighbours apart.
fn hash(text: &str, overrides: &[String], scale: f64, meshes: &[&Path]) -> Result<String, Error> {
    let mut digest = Sha256::new();
    let mut add = |part: &[u8]| {
        digest.update((part.len() as u64).to_le_bytes());
        digest.update(part);
    };
    add(text.as_bytes());
    overrides.iter().for_each(|part| add(part.as_bytes()));
    for mesh in meshes {
        let bytes = std::fs::read(mesh).map_err(|problem| {
            let cure = "make it a mesh file that can be read";
            Error::input(mesh.display().to_string(), problem.to_string(), cure)
        })?;
        add(&bytes);
    }
    digest.update(scale.to_le_bytes());
    let bytes = digest.finalize();
    Ok(bytes.iter().fold(String::new(), |mut hex, byte| {
        write!(hex, "{byte:02x}").expect("writing to a string cannot fail");
        hex
    }))
}

/// The files of all meshes, in the order of the scene.
fn mesh_files<'a>(
    liquid: Option<&'a Liquid>,
    obstacles: &'a [Obstacle],
    solids: &'a [Solid],
) -> Vec<&'a Path> {
    let regions = liquid.into_iter().flat_map(|liquid| &liquid.regions);
    let shapes = regions.map(|region| &region.shape);
    let shapes = shapes.chain(obstacles.iter().map(|obstacle| &obstacle.shape));
    let of_shapes = shapes.filter_map(|shape| match shape {
        Shape::Mesh { file } => Some(file.as_path()),
        _ => None,
    });
    let of_solids = solids.iter().filter_map(|solid| match &solid.mesh {
        SolidMesh::File { file } | SolidMesh::Surface { file, .. } => Some(file.as_path()),
        _ => None,
    });
    of_shapes.chain(of_solids).collect()
}

fn domain(root: &Table, scale: f64) -> Result<Domain, Error> {
    let example = "[domain] with size = [1.0, 1.0, 1.0] and cells = [32, 32, 32]";
    let table = root.required("domain", example)?.table(&DOMAIN)?;
    let size_place = table.required("size", "size = [1.0, 1.0, 1.0], in m")?;
    let size = size_place.vector("the sides of the domain in m")?;
    let sound = size.to_array().iter().all(|side| SIDES.contains(side));
    let problem = format!("is {}", list(size.to_array()));
    size_place.ensure(sound, problem, "write sides from 1e-6 to 1e6 m")?;

    let cells_place = table.required("cells", "cells = [32, 32, 32]")?;
    let given = cells_place.counts("the cells along x, y, z", 1, MAX_CELLS_PER_AXIS)?;
    if !cubic(size, given) {
        let edges = DVec3::from_array(given.map(|n| n as f64));
        let [x, y, z] = (size / edges).to_array();
        let cure = match cubic_cells(size, given) {
            Some(cells) => format!("use cells = {}", list(cells)),
            None => {
                let dx = size.x / edges.x;
                format!("use size = {}", list((edges * dx).to_array()))
            }
        };
        let place = if size_place.is_override() && !cells_place.is_override() {
            &size_place
        } else {
            &cells_place
        };
        return Err(place.fail(format!("cells of {x} x {y} x {z} m are not cubic"), cure));
    }

    let cells = given.map(|n| (n as f64 * scale).round().max(1.0));
    let count: f64 = cells.iter().product();
    if count > MAX_CELLS || cells.iter().any(|&n| n > MAX_CELLS_PER_AXIS as f64) {
        let problem = format!("{} makes {count} cells, more than {MAX_CELLS}", list(cells));
        return Err(if scale == 1.0 {
            cells_place.fail(problem, "use fewer cells")
        } else {
            Error::input(format!("--scale {scale}"), problem, "use a smaller scale")
        });
    }
    let cells = cells.map(|n| n as usize);
    if !cubic(size, cells) {
        return Err(Error::input(
            format!("--scale {scale}"),
            format!("domain.cells would be {}, which are not cubic", list(cells)),
            format!("use --scale {}", working_scale(given, scale)),
        ));
    }
    let gravity = match table.get("gravity") {
        Some(place) => bounded(&place, "gravity in m/s^2", MAX_GRAVITY)?,
        None => DVec3::new(0.0, -9.81, 0.0),
    };
    let open = match table.get("open") {
        Some(place) => open_sides(&place, root)?,
        None => Sides::default(),
    };
    Ok(Domain {
        size,
        cells,
        gravity,
        open,
    })
}

/// The sides through which liquid leaves.
fn open_sides(place: &Place, root: &Table) -> Result<Sides, Error> {
    let axes = Axis::ALL.into_iter();
    let sides = axes.flat_map(|axis| [0, 1].map(|side| (axis, side)));
    let choices: Vec<_> = Sides::NAMES.into_iter().zip(sides).collect();
    let wanted = format!(
        "a list, such as [\"+x\"], of any of {}",
        Sides::NAMES.join(", ")
    );
    let entries = place.list().map_err(|_| place.wrong_type(&wanted))?;
    let mut open = Sides::default();
    for entry in entries {
        let (axis, side) = entry.choice(&choices)?;
        let twice = open.has(axis, side);
        entry.ensure(!twice, "names a side for the second time", "remove it")?;
        open = open.with(axis, side);
    }
    place.ensure(
        !open.any() || root.get("liquid").is_some(),
        "lets liquid out, and the scene has none",
        "remove `open`, or add a [liquid] section with a region",
    )?;
    Ok(open)
}

/// A density whose numbers stay in single precision; `usual`: what is.
pub(super) fn density(place: &Place, usual: &str) -> Result<f64, Error> {
    let density = place.positive("a density in kg/m^3")?;
    place.within(
        density,
        DENSITIES,
        format!("is {density:?}"),
        format!("use 1e-6 to 1e6 kg/m^3; {usual}"),
    )?;
    Ok(density)
}

/// Three numbers of a magnitude of at most `most`.
pub(super) fn bounded(place: &Place, what: &str, most: f64) -> Result<DVec3, Error> {
    let vector = place.vector(what)?;
    place.ensure(
        vector.abs().max_element() <= most,
        format!(
            "is {}",
            list(vector.to_array().map(|part| format!("{part:?}")))
        ),
        format!("write {what} with numbers from -{most:e} to {most:e}"),
    )?;
    Ok(vector)
}

fn cubic(size: DVec3, cells: [usize; 3]) -> bool {
    let edges = size / DVec3::from_array(cells.map(|n| n as f64));
    (edges / edges.x - 1.0).abs().max_element() <= CUBIC
}

/// The counts of cubic cells whose number along x is nearest to what was meant, up to a factor of 4 away. Counts that a domain
/// may have, if there are any.
fn cubic_cells(size: DVec3, cells: [usize; 3]) -> Option<[usize; 3]> {
    let edges = size / DVec3::from_array(cells.map(|n| n as f64));
    let wanted = size.x / edges.element_product().cbrt();
    let most = (4.0 * wanted).ceil().min(MAX_CELLS_PER_AXIS as f64) as usize;
    let candidates = (1..=most).filter_map(|nx| {
        let counts = size
            .to_array()
            .map(|side| (side / size.x * nx as f64).round().max(1.0));
        let allowed = counts.iter().all(|&n| n <= MAX_CELLS_PER_AXIS as f64)
            && counts.iter().product::<f64>() <= MAX_CELLS;
        let counts = counts.map(|n| n as usize);
        (allowed && cubic(size, counts)).then_some(counts)
    });
    candidates.min_by(|a, b| {
        let distance = |counts: &[usize; 3]| (counts[0] as f64 / wanted).ln().abs();
        distance(a).total_cmp(&distance(b))
    })
}

/// The scale nearest to `scale` that keeps `cells` cubic: cells = g (a, b, c) with g their greatest common divisor stay
/// cubic exactly when they become m (a, b, c), m whole.
fn working_scale(cells: [usize; 3], scale: f64) -> f64 {
    let divisor = |mut a: usize, mut b: usize| {
        while b != 0 {
            (a, b) = (b, a % b);
        }
        a
    };
    let g = divisor(divisor(cells[0], cells[1]), cells[2]);
    (scale * g as f64).round().max(1.0) / g as f64
}

fn time(root: &Table) -> Result<Time, Error> {
    let table = root
        .required("time", "[time] with duration = 2.0")?
        .table(&TIME)?;
    let duration_place = table.required("duration", "duration = 2.0, in s")?;
    let duration = duration_place.positive("a duration in s")?;
    let frames_per_second = match table.get("frames_per_second") {
        Some(place) => {
            let rate = place.positive("frames per second")?;
            place.within(
                rate,
                FRAME_RATES,
                format!("is {rate:?}"),
                "use 1e-3 to 1e6; 24 is usual",
            )?;
            rate
        }
        None => 24.0,
    };
    let frames = duration * frames_per_second;
    duration_place.ensure(
        frames <= MAX_FRAMES as f64,
        format!("{duration} s at {frames_per_second} frames per second are {frames:.0} frames, more than {MAX_FRAMES}"),
        "shorten the duration or use fewer frames per second",
    )?;
    let cfl = match table.get("cfl") {
        Some(place) => {
            let cfl = place.positive("the cells that the fastest point crosses in a sub-step")?;
            place.within(
                cfl,
                ..=32.0,
                format!("is {cfl}"),
                "use at most 32; 1 to 5 is usual",
            )?;
            cfl
        }
        None => 3.0,
    };
    let fixed_step = match table.get("fixed_step") {
        Some(place) => {
            let step = place.positive("a constant sub-step in s")?;
            let ratio = 1.0 / (frames_per_second * step);
            let whole = ratio.round().max(1.0);
            place.ensure(
                (ratio - whole).abs() <= WHOLE_STEPS * whole,
                format!("{step} s does not divide the frame time, 1/{frames_per_second} s: {ratio} steps in a frame"),
                format!("use {}, {whole} in a frame", 1.0 / (frames_per_second * whole)),
            )?;
            Some(step)
        }
        None => None,
    };
    Ok(Time {
        duration,
        frames_per_second,
        cfl,
        fixed_step,
    })
}

fn liquid(root: &Table, file: &Path, domain: &Domain) -> Result<Liquid, Error> {
    let example = "[liquid] and [[liquid.region]] with a shape, such as box = { min = [0, 0, 0], max = [1, 0.5, 1] }";
    let or_solids = format!("{example}, or [[solid]] with name, mesh, density, young and poisson");
    let table = root.required("liquid", &or_solids)?.table(&LIQUID)?;
    let density = match table.get("density") {
        Some(place) => density(&place, "water has 1000")?,
        None => 1000.0,
    };
    let surface = match table.get("surface") {
        Some(place) => {
            let surface =
                place.choice(&[("markers", Surface::Markers), ("fixed", Surface::Fixed)])?;
            place.ensure(
                surface == Surface::Markers || !domain.open.any(),
                "stays where it is, and through open sides (domain.open) liquid leaves",
                "use surface = \"markers\", or close all sides",
            )?;
            surface
        }
        None => Surface::Markers,
    };
    let marker_radius = match table.get("marker_radius") {
        Some(place) => {
            let radius = place.number("the marker radius in cells")?;
            let cure =
                "use 0.5 to 1.2; half a cell's diagonal, 0.87, covers a cell with one marker";
            place.within(radius, MARKER_RADII, format!("is {radius}"), cure)?;
            radius
        }
        None => 0.87,
    };
    let seed = match table.get("seed") {
        Some(place) => place.count("a seed", 0, i64::MAX as u64)?,
        None => 0,
    };
    let volume_control = match table.get("volume_control") {
        Some(place) => {
            let on = place.boolean()?;
            let cure = "remove it, or use surface = \"markers\"";
            place.ensure(
                !on || surface == Surface::Markers,
                "a fixed surface has no volume control",
                cure,
            )?;
            on
        }
        None => surface == Surface::Markers,
    };
    // Sources may fill an empty domain.
    let sources = root.get("source").is_some();
    let places = match (table.get("region"), sources) {
        (Some(places), true) => places.list()?,
        (None, true) => Vec::new(),
        (_, false) => {
            let places = table.required("region", example)?;
            let entries = places.list()?;
            places.ensure(
                !entries.is_empty(),
                "has no entry, so there is no liquid",
                format!("write {example}"),
            )?;
            entries
        }
    };
    let mut regions: Vec<Region> = Vec::new();
    for place in places {
        let region = region(&place, file, domain)?;
        let adds = regions.iter().any(|earlier| !earlier.subtract);
        let problem = "takes liquid away where there is none: no region before it adds any";
        place.ensure(
            adds || !region.subtract,
            problem,
            "put a region without subtract first",
        )?;
        regions.push(region);
    }
    Ok(Liquid {
        density,
        regions,
        surface,
        marker_radius,
        seed,
        volume_control,
    })
}

fn region(place: &Place, file: &Path, domain: &Domain) -> Result<Region, Error> {
    let table = place.clone().table(&REGION)?;
    let (kind, shape_place) = table.one_of(&REGION_SHAPES, "shape")?;
    let shape = match kind {
        "solitary" => solitary(shape_place.clone(), domain.gravity)?,
        _ => shape(kind, shape_place.clone(), file)?,
    };
    shape_place.ensure(
        shape.reaches(&Placement::default(), domain.size),
        format!(
            "lies outside the domain, which goes from the origin to {} m",
            list(domain.size.to_array())
        ),
        "move it so that a part lies inside",
    )?;
    Ok(Region {
        shape,
        subtract: table
            .get("subtract")
            .map_or(Ok(false), |place| place.boolean())?,
        velocity: table.get("velocity").map_or(Ok(DVec3::ZERO), |place| {
            bounded(&place, "a velocity in m/s", MAX_VELOCITY)
        })?,
    })
}

fn obstacles(root: &Table, file: &Path, domain: &Domain) -> Result<Vec<Obstacle>, Error> {
    let Some(places) = root.get("obstacle") else {
        return Ok(Vec::new());
    };
    let obstacle = |place: Place| {
        let table = place.table(&OBSTACLE)?;
        let (kind, shape_place) = table.one_of(&OBSTACLE_SHAPES, "shape")?;
        let shape = shape(kind, shape_place.clone(), file)?;
        let placement = match table.get("placement") {
            Some(place) => placement(place)?,
            None => Placement::default(),
        };
        let inside_out = table
            .get("inside_out")
            .map_or(Ok(false), |place| place.boolean())?;
        let motion = motion(&table)?;
        let moved = |motion: &Motion| {
            let poses = motion.keyframes.iter().map(|frame| Placement {
                translate: placement.translate + frame.translate,
                ..placement
            });
            // A turn may take it in from anywhere.
            let turns = motion.keyframes.iter().any(|frame| frame.angle != 0.0);
            turns
                || poses
                    .into_iter()
                    .any(|pose| shape.reaches(&pose, domain.size))
        };
        shape_place.ensure(
            shape.reaches(&placement, domain.size) || motion.as_ref().is_some_and(moved),
            format!(
                "lies outside the domain, which goes from the origin to {} m",
                list(domain.size.to_array())
            ),
            "move it so that a part lies inside",
        )?;
        if shape.holds_box(&placement, domain.size) {
            return Err(if inside_out {
                shape_place.fail(
                    "surrounds the whole domain, so the container holds nothing back",
                    "make it smaller",
                )
            } else {
                shape_place.fail(
                    "fills the whole domain",
                    "make it smaller, or a container with inside_out = true",
                )
            });
        }
        Ok(Obstacle {
            shape,
            placement,
            inside_out,
            motion,
        })
    };
    places.list()?.into_iter().map(obstacle).collect()
}

/// How an obstacle moves; `None` where it has no keyframes.
fn motion(table: &Table) -> Result<Option<Motion>, Error> {
    let pivot = table.get("pivot");
    if table.get("keyframes").is_none() {
        return match pivot {
            None => Ok(None),
            Some(place) => Err(place.fail(
                "is what keyframes turn about, and the obstacle has none",
                "remove it, or add keyframes",
            )),
        };
    }
    let keyframes = keyframes(table)?;
    for (place, frame) in table
        .required("keyframes", "keyframes = [{ t = 0 }]")?
        .list()?
        .iter()
        .zip(&keyframes)
        .skip(1)
    {
        let before = keyframes.iter().rev().find(|other| other.time < frame.time);
        let before = before.expect("the first keyframe was skipped");
        let speed = (frame.translate - before.translate).length() / (frame.time - before.time);
        place.ensure(
            speed <= MAX_VELOCITY,
            format!("asks for {speed:.3e} m/s"),
            format!("leave more time, or go less far: at most {MAX_VELOCITY:e} m/s"),
        )?;
    }
    Ok(Some(Motion {
        keyframes,
        pivot: pivot
            .map(|place| place.vector("the point that it turns about in m"))
            .transpose()?,
    }))
}

/// Floor of theta with markers. Their surface is bumpy by about a tenth of a cell, so a smaller theta is no more true; it only
/// multiplies the velocity of slivers. Of 72 pools at rest, half of them with a body, the worst started at 1.14 g dt with 0.1
/// and at 1.04 g dt with this; a half-full sphere at 1.34 g dt with 1e-2. The period of the standing wave does not tell 0.01
/// from 0.2.
const MARKER_THETA_FLOOR: f64 = 0.15;

/// The thesis's clamp, for its face areas.
const NODAL_AREA_CLAMP: f64 = 1e-2;

/// `surface` is the liquid's; none without liquid.
fn solver(root: &Table, surface: Option<Surface>, has_solids: bool) -> Result<Solver, Error> {
    let mut solver = Solver {
        theta_floor: match surface {
            Some(Surface::Markers) => MARKER_THETA_FLOOR,
            Some(Surface::Fixed) | None => Solver::default().theta_floor,
        },
        ..Solver::default()
    };
    let Some(place) = root.get("solver") else {
        return Ok(solver);
    };
    let table = place.table(&SOLVER)?;
    if let Some(place) = table.get("precision") {
        let choices = [
            ("f32", Precision::F32),
            ("mixed", Precision::Mixed),
            ("f64", Precision::F64),
        ];
        solver.precision = place.choice(&choices)?;
        solver.tolerance = solver.precision.default_tolerance();
    }
    if let Some(place) = table.get("tolerance") {
        solver.tolerance = place.positive("a relative tolerance")?;
        let problem = format!("is {}", solver.tolerance);
        place.within(
            solver.tolerance,
            1e-14..1.0,
            problem,
            "use 1e-14 to below 1; 1e-8 is usual",
        )?;
    }
    if let Some(place) = table.get("max_iterations") {
        solver.max_iterations = place.count("the iterations of all rounds", 1, 100_000)? as u32;
    }
    let ensure_coupled = |place: &Place| {
        place.ensure(
            surface.is_some() && has_solids,
            "is about elastic solids in liquid, and the scene does not have both",
            "remove it",
        )
    };
    if let Some(place) = table.get("preconditioner") {
        let choices = [
            ("multigrid", Preconditioner::Multigrid),
            ("jacobi", Preconditioner::Jacobi),
            ("block_jacobi", Preconditioner::BlockJacobi),
        ];
        place.ensure(
            surface.is_some(),
            "is of the pressure's solve, and the scene has no liquid",
            "remove it: the solve of solids has a preconditioner of its own",
        )?;
        solver.preconditioner = place.choice(&choices)?;
        if solver.preconditioner == Preconditioner::BlockJacobi {
            ensure_coupled(&place)?;
        }
    }
    if let Some(place) = table.get("theta_floor") {
        solver.theta_floor = place.positive("the smallest distance to the surface in cells")?;
        let problem = format!("is {}", solver.theta_floor);
        place.within(
            solver.theta_floor,
            1e-6..=0.5,
            problem,
            "use 1e-6 to 0.5; 1e-2 is usual with a fixed surface, 0.15 with markers",
        )?;
    }
    if let Some(place) = table.get("coupling") {
        ensure_coupled(&place)?;
        let choices = [
            ("strong", CouplingScheme::Strong),
            ("weak", CouplingScheme::Weak),
            ("damping_only", CouplingScheme::DampingOnly),
        ];
        solver.coupling = place.choice(&choices)?;
    }
    if let Some(place) = table.get("pressure_on_patches") {
        ensure_coupled(&place)?;
        let choices = [
            ("cell", PatchPressure::Cell),
            ("hydrostatic", PatchPressure::Hydrostatic),
            ("gradient", PatchPressure::Gradient),
        ];
        solver.pressure_on_patches = place.choice(&choices)?;
    }
    if let Some(place) = table.get("formulation") {
        ensure_coupled(&place)?;
        let choices = [
            ("auto", Formulation::Auto),
            ("two_field", Formulation::TwoField),
            ("condensed", Formulation::Condensed),
        ];
        solver.formulation = place.choice(&choices)?;
        place.ensure(
            solver.formulation != Formulation::Condensed
                || solver.preconditioner != Preconditioner::BlockJacobi,
            "knows of pressures alone, and preconditioner \"block_jacobi\" of nodes",
            "use formulation \"two_field\", or preconditioner \"jacobi\", which is of B then",
        )?;
    }
    let together = surface.is_some() && has_solids;
    let factored = solver.preconditioner == Preconditioner::Multigrid;
    if together && solver.formulation == Formulation::Auto && !factored {
        // The diagonal that is asked for is that of the two-field system.
        solver.formulation = Formulation::TwoField;
    }
    if let Some(place) = table.get("face_areas") {
        ensure_coupled(&place)?;
        let choices = [("clipped", FaceAreas::Clipped), ("nodal", FaceAreas::Nodal)];
        solver.face_areas = place.choice(&choices)?;
        if solver.face_areas == FaceAreas::Nodal {
            solver.area_clamp = NODAL_AREA_CLAMP;
        }
    }
    if let Some(place) = table.get("area_clamp") {
        solver.area_clamp = place.number("the smallest open fraction of a face")?;
        let problem = format!("is {}", solver.area_clamp);
        place.within(
            solver.area_clamp,
            // Open fractions come from sums over patches and are off by up to 1e-12: those slivers are no faces.
            1e-6..0.5,
            problem,
            "use 1e-6 to less than 0.5; 1e-3 is usual",
        )?;
    }
    Ok(solver)
}

fn output(root: &Table, has_liquid: bool, has_solids: bool) -> Result<Output, Error> {
    let mut output = Output {
        particles: has_liquid,
        fields: false,
        solids: has_solids,
        surface: false,
        every: 1,
        checkpoint_every: 10,
    };
    let Some(place) = root.get("output") else {
        return Ok(output);
    };
    let table = place.table(&OUTPUT)?;
    let liquid = (has_liquid, "the scene has no liquid");
    let solids = (has_solids, "the scene has no [[solid]]");
    for (key, wanted, (present, problem)) in [
        ("particles", &mut output.particles, liquid),
        ("fields", &mut output.fields, liquid),
        ("solids", &mut output.solids, solids),
        ("surface", &mut output.surface, liquid),
    ] {
        if let Some(place) = table.get(key) {
            *wanted = place.boolean()?;
            let cure = format!("remove `{key}`, or write {key} = false");
            place.ensure(present || !*wanted, problem, cure)?;
        }
    }
    if let Some(place) = table.get("every") {
        output.every = place.count(
            "the frames from one that is written to the next",
            1,
            MAX_FRAMES,
        )?;
    }
    if let Some(place) = table.get("checkpoint_every") {
        output.checkpoint_every =
            place.count("the frames from one checkpoint to the next", 0, MAX_FRAMES)?;
    }
    Ok(output)
}

pub(super) fn list<T: std::fmt::Display, const N: usize>(values: [T; N]) -> String {
    let values: Vec<_> = values.iter().map(T::to_string).collect();
    format!("[{}]", values.join(", "))
}

/// Longest name of a scene, bytes: most file systems end at 255, and the longest name of a file that is being written is
/// `.NAME_obstacles_000000.vtp.partial`.
const LONGEST_NAME: usize = 255 - ".".len() - "_obstacles_000000.vtp".len() - ".partial".len();

/// Name of a scene: its file's, without the ending. The names of all output files begin with it, and `.pvd` files contain them.
///
/// # Errors
/// [`Error::Input`] for a name that no file system or no XML file can have with what comes behind it.
fn name(path: &Path) -> Result<String, Error> {
    let stem = path.file_stem().unwrap_or(path.as_os_str());
    let name = stem.to_string_lossy();
    let refused =
        |problem: String, cure: String| Err(Error::input(format!("{name:?}"), problem, cure));
    let cure = "rename the scene file";
    if stem.to_str().is_none() {
        return refused(
            "the name of the scene file is not UTF-8".to_owned(),
            cure.to_owned(),
        );
    }
    if name.chars().any(char::is_control) {
        let problem = "the name of the scene file has a line break or another control character";
        return refused(problem.to_owned(), cure.to_owned());
    }
    if name.len() > LONGEST_NAME {
        let problem = format!("the name of the scene file has {} bytes", name.len());
        let cure = format!(
            "rename it to at most {LONGEST_NAME} bytes: names of output files begin with it"
        );
        return refused(problem, cure);
    }
    Ok(name.into_owned())
}
