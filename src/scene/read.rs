//! Converts the tree of a scene file to a checked [`Scene`].

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

use glam::DVec3;
use sha2::{Digest, Sha256};

use super::camera::camera;
use super::document::{Document, Keys, Place, Table};
use super::probe::probes;
use super::shape::{ensure_in_domain, keyframes, placement, shape, solitary, vector_keyframes};
use super::slab::{self, Slab};
use super::solid::solids;
use super::sources_sinks::{sinks, sources};
use super::surface::surface;
use super::{
    CouplingScheme, Domain, FaceAreas, Formulation, Liquid, Motion, Obstacle, Output, PatchPressure, Precision,
    Preconditioner, Region, SHORTEST_STEP, Scene, Separation, Shape, Solid, Solver, Surface, ThetaFloor, Time,
};
use crate::error::Error;
use crate::grid::{Axis, Sides};

/// Most cells of a domain: marker and cell indices on the device have 32 bits.
const MAX_CELLS: f64 = (1u64 << 30) as f64;
const MAX_CELLS_PER_AXIS: u64 = 1 << 16;
/// Sides of a domain, m. Squares and cubes of cell sizes must be representable in single precision.
const SIDES: std::ops::RangeInclusive<f64> = 1e-6..=1e6;
/// Radii of marker spheres, cells. The liquid distance extends two cells beyond markers, and air within half a cell of a sphere counts
/// as partly full. From a radius of 1.5 on, all air would.
const MARKER_RADII: std::ops::RangeInclusive<f64> = 0.5..=1.2;
/// Densities, kg/m^3. This limit and the next three bound derived quantities to the range of single precision.
const DENSITIES: std::ops::RangeInclusive<f64> = 1e-6..=1e6;
/// Velocities along an axis, m/s.
pub(crate) const MAX_VELOCITY: f64 = 1e6;
/// Accelerations along an axis, m/s^2.
const MAX_GRAVITY: f64 = 1e6;
/// Limit of coefficients of friction.
const MAX_FRICTION: f64 = 100.0;
const FRAME_RATES: std::ops::RangeInclusive<f64> = 1e-3..=1e6;
/// Relative tolerance of cubic cells.
const CUBIC: f64 = 1e-6;
/// Length limit of file names in file systems, bytes.
const MAX_FILE_NAME: usize = 255;
/// Longest suffix and prefix of a scene's name in a file name: moving obstacles of a frame, partially written.
const LONGEST_ADDITION: &str = "._obstacles_000000.vtp.partial";
/// Most frames of a run: file names have six digits.
pub const MAX_FRAMES: u64 = 999_999;
/// Relative tolerance of a frame time that is a multiple of the fixed step.
const WHOLE_STEPS: f64 = 1e-6;

const ROOT: Keys = Keys::new(&[
    "domain", "time", "liquid", "solid", "obstacle", "source", "sink", "probe", "solver", "output", "camera", "surface",
]);
const DOMAIN: Keys =
    Keys::new(&["size", "cells", "gravity", "gravity_keyframes", "open", "symmetry", "slab", "friction"]);
const GRAVITY_KEYFRAME: Keys = Keys::new(&["t", "gravity"]);
const TIME: Keys = Keys::new(&["duration", "frames_per_second", "cfl", "max_step", "fixed_step"]);
const LIQUID: Keys =
    Keys::new(&["density", "surface", "marker_radius", "seed", "volume_control", "separation", "region"]);
const REGION_SHAPES: [&str; 7] = ["box", "sphere", "cylinder", "half_space", "mesh", "wave", "solitary"];
const REGION: Keys = Keys::new(&[
    "box",
    "sphere",
    "cylinder",
    "half_space",
    "mesh",
    "wave",
    "solitary",
    "placement",
    "subtract",
    "velocity",
]);
const OBSTACLE_SHAPES: [&str; 4] = ["box", "sphere", "cylinder", "mesh"];
const OBSTACLE: Keys =
    Keys::new(&["box", "sphere", "cylinder", "mesh", "placement", "inside_out", "keyframes", "pivot", "friction"]);
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
        "solid_contact",
    ],
    absent: &[
        ("sigma", "the two-field form halves the masses"),
        ("alpha", "residuals of pressures and of velocities are tested separately, without a weight"),
    ],
};
const OUTPUT: Keys = Keys::new(&["particles", "fields", "solids", "surface", "every", "checkpoint_every"]);

impl Scene {
    /// Reads and checks a scene file.
    ///
    /// `overrides` are `KEY=VALUE` with dotted keys and indices from 0, such as `liquid.region[0].velocity=[1, 0, 0]`. A single word that
    /// is no TOML value is a text. `scale` multiplies the numbers of cells, rounded, and nothing else.
    pub fn load(path: &Path, overrides: &[String], scale: f64) -> Result<Scene, Error> {
        let text = read_text(path)?;
        Scene::parse(path, &text, overrides, scale)
    }

    /// Reads and checks the text of a scene file; its mesh files are relative to the folder of `path`.
    pub fn parse(path: &Path, text: &str, overrides: &[String], scale: f64) -> Result<Scene, Error> {
        if !(scale.is_finite() && scale > 0.0) {
            return Err(Error::input(
                format!("--scale {scale}"),
                "is no factor for numbers of cells",
                "use a number above zero",
            ));
        }
        let document = Document::parse(path, text, overrides)?;
        Scene::from_document(&document, path, text, overrides, scale)
    }

    /// The text of a scene file with overrides as JSON: the keys that it gives, unchecked.
    ///
    /// # Errors
    /// As [`Scene::parse`], for a text that is not TOML and overrides of keys that do not exist.
    pub fn tree(path: &Path, text: &str, overrides: &[String]) -> Result<serde_json::Value, Error> {
        Ok(Document::parse(path, text, overrides)?.json())
    }

    /// `text` is the source of the document.
    pub(super) fn from_document(
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
        let meshes = contents(&meshes)?;
        let touching = Touching::of(&domain, &obstacles, &solids);
        let mut scene = Scene {
            name: scene_name(path)?,
            file: path.to_owned(),
            origins: document.origins(),
            hash: hash(text, overrides, scale, &meshes),
            values: document.values(),
            meshes: mesh_hashes(path, &meshes),
            removed: document.removed().to_vec(),
            scale,
            overrides: overrides.to_vec(),
            solver: solver(&root, liquid.as_ref().map(|liquid| liquid.surface), !solids.is_empty(), touching)?,
            obstacles,
            sources: sources(&root, path, &domain, liquid.as_ref())?,
            sinks: sinks(&root, path, &domain, liquid.as_ref())?,
            probes: probes(&root, path, &domain, liquid.is_some(), &solids)?,
            output: output(&root, liquid.is_some(), !solids.is_empty())?,
            surface: surface(&root, liquid.as_ref().is_some_and(|liquid| liquid.surface == Surface::Markers))?,
            liquid,
            solids,
            camera: camera(&root, &domain.stretched(), &time)?,
            time,
            domain,
        };
        slab::stretch(&mut scene)?;
        Ok(scene)
    }
}

/// The text of a scene file. Errors recognise folders, meshes and results of runs.
fn read_text(path: &Path) -> Result<String, Error> {
    let refuse = |problem: &str, cure: String| {
        let what = path.display().to_string();
        Err(Error::input(what, problem, cure))
    };
    let extension = path.extension().unwrap_or_default().to_ascii_lowercase();
    let is_kind = |kinds: &[&str]| kinds.iter().any(|kind| extension == *kind);
    if path.is_dir() {
        return if path.join("manifest.json").is_file() {
            let cure = "give the scene file of the run; `cutwater preview`, `plot` and `report` read folders of runs";
            refuse("is the folder of a run, not a scene", cure.to_owned())
        } else {
            refuse("is a folder, not a scene file", scenes_in(path))
        };
    }
    if is_kind(&["obj", "stl", "ply", "glb", "gltf", "msh", "vtu"]) {
        let cure =
            "give a scene file (TOML) that names it: mesh = { file = .. }; `cutwater mesh` checks a mesh by itself";
        return refuse("is a mesh, not a scene", cure.to_owned());
    }
    if is_kind(&["json", "csv", "vtp", "vti", "pvd"]) {
        let cure = "give the scene file (TOML) of the run";
        return refuse("is a result, not a scene", cure.to_owned());
    }
    let with_extension = path.with_extension("toml");
    std::fs::read_to_string(path).or_else(|error| {
        let cure = match error.kind() {
            std::io::ErrorKind::NotFound if with_extension.is_file() => {
                format!("did you mean {}?", with_extension.display())
            }
            std::io::ErrorKind::NotFound => "give the path of a scene file (TOML)".to_owned(),
            std::io::ErrorKind::InvalidData => "save the file as UTF-8 text".to_owned(),
            _ => "give a readable file".to_owned(),
        };
        refuse(&error.to_string(), cure)
    })
}

/// Cure that names the scene files in a folder.
fn scenes_in(folder: &Path) -> String {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let files = entries.map(|entry| entry.path());
    let mut scenes: Vec<_> = files.filter(|file| file.extension().is_some_and(|kind| kind == "toml")).collect();
    scenes.sort();
    match &scenes[..] {
        [] => "give the path of a scene file (TOML); this folder has none".to_owned(),
        [scene] => format!("give the scene file in it: {}", scene.display()),
        [first, ..] => format!("give one of the {} scene files in it, such as {}", scenes.len(), first.display()),
    }
}

/// Name of a scene: its file stem, which names the folder and the files of a run.
fn scene_name(path: &Path) -> Result<String, Error> {
    let stem = path.file_stem().unwrap_or(path.as_os_str());
    let name = stem.to_string_lossy().into_owned();
    // XML 1.0 cannot represent most of these, and some break lines of messages and tables.
    let unfit = |c: &char| c.is_control() || "\u{2028}\u{2029}\u{fffe}\u{ffff}".contains(*c);
    let most = MAX_FILE_NAME - LONGEST_ADDITION.len();
    let (problem, cure) = if let Some(c) = name.chars().find(unfit) {
        (
            format!("the name of the file has the control character {c:?}, which files of results cannot represent"),
            "rename the file, without line breaks and other control characters".to_owned(),
        )
    } else if name.len() > most {
        (
            format!(
                "the name of the file has {} bytes before its ending; results are named after it, and the longest of these names would have more than {MAX_FILE_NAME} bytes",
                name.len()
            ),
            format!("rename the file to at most {most} bytes before its ending"),
        )
    } else if [".", ".."].contains(&&*name) {
        (
            format!("results cannot be named `{name}`, which is a folder"),
            "rename the file, with a letter or digit before its ending".to_owned(),
        )
    } else {
        return Ok(name);
    };
    Err(Error::input(path.display().to_string().escape_debug().to_string(), problem, cure))
}

/// Contents of the mesh files.
fn contents<'a>(meshes: &[&'a Path]) -> Result<Vec<(&'a Path, Vec<u8>)>, Error> {
    let read = |&mesh: &&'a Path| {
        let bytes = std::fs::read(mesh).map_err(|problem| {
            let cure = "give a readable mesh file";
            Error::input(mesh.display().to_string(), problem.to_string(), cure)
        })?;
        Ok((mesh, bytes))
    };
    meshes.iter().map(read).collect()
}

/// SHA-256 of all inputs of the scene. Each part is preceded by its length, so that parts cannot run together.
fn hash(text: &str, overrides: &[String], scale: f64, meshes: &[(&Path, Vec<u8>)]) -> String {
    let mut digest = Sha256::new();
    let mut add = |part: &[u8]| {
        digest.update((part.len() as u64).to_le_bytes());
        digest.update(part);
    };
    add(text.as_bytes());
    overrides.iter().for_each(|part| add(part.as_bytes()));
    meshes.iter().for_each(|(_, bytes)| add(bytes));
    digest.update(scale.to_le_bytes());
    hexadecimal(&digest.finalize())
}

fn hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |mut hex, byte| {
        write!(hex, "{byte:02x}").expect("writing to a string cannot fail");
        hex
    })
}

/// SHA-256 of each mesh file by its path from the folder of the scene.
fn mesh_hashes(scene: &Path, meshes: &[(&Path, Vec<u8>)]) -> BTreeMap<String, String> {
    let folder = scene.parent().unwrap_or(Path::new(""));
    let hash = |(mesh, bytes): &(&Path, Vec<u8>)| {
        let mesh = mesh.strip_prefix(folder).unwrap_or(mesh);
        (mesh.display().to_string(), hexadecimal(&Sha256::digest(bytes)))
    };
    meshes.iter().map(hash).collect()
}

/// The files of all meshes, in the order of the scene.
fn mesh_files<'a>(liquid: Option<&'a Liquid>, obstacles: &'a [Obstacle], solids: &'a [Solid]) -> Vec<&'a Path> {
    let regions = liquid.into_iter().flat_map(|liquid| &liquid.regions);
    let shapes = regions.map(|region| &region.shape);
    let shapes = shapes.chain(obstacles.iter().map(|obstacle| &obstacle.shape));
    let shape_files = shapes.filter_map(|shape| match shape {
        Shape::Mesh { file, .. } => Some(&**file),
        _ => None,
    });
    let solid_files = solids.iter().filter_map(|solid| Some(&**solid.mesh.file()?));
    shape_files.chain(solid_files).collect()
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
    let unscaled = cells_place.counts("the cells along x, y, z", 1, MAX_CELLS_PER_AXIS)?;
    let across = table.get("slab").map(|place| slab_axis(&place, unscaled));
    let across = across.transpose()?;
    // The thickness of a slab follows from its cells.
    let cut = |cells: [usize; 3]| {
        let mut cut = size;
        if let Some(axis) = across {
            let other = (axis + 1) % 3;
            cut[axis] = size[other] / cells[other] as f64 * cells[axis] as f64;
        }
        cut
    };
    if !cubic(cut(unscaled), unscaled) {
        let edges = DVec3::from_array(unscaled.map(|n| n as f64));
        let [x, y, z] = (cut(unscaled) / edges).to_array();
        let cure = match cubic_cells(cut(unscaled), unscaled) {
            Some(cells) => format!("use cells = {}", list(cells)),
            None => {
                let dx = size.x / edges.x;
                format!("use size = {}", list((edges * dx).to_array()))
            }
        };
        let place = if size_place.is_override() && !cells_place.is_override() { &size_place } else { &cells_place };
        return Err(place.fail(format!("cells of {x} x {y} x {z} m are not cubic"), cure));
    }

    let mut cells = unscaled.map(|n| (n as f64 * scale).round().max(1.0));
    if let Some(axis) = across {
        cells[axis] = unscaled[axis] as f64;
    }
    let count: f64 = cells.iter().product();
    if count > MAX_CELLS || cells.iter().any(|&n| n > MAX_CELLS_PER_AXIS as f64) {
        let problem = format!("{} are {count} cells, more than {MAX_CELLS}", list(cells));
        return Err(if scale == 1.0 {
            cells_place.fail(problem, "use fewer cells")
        } else {
            Error::input(format!("--scale {scale}"), problem, "use a smaller scale")
        });
    }
    let cells = cells.map(|n| n as usize);
    let slab = across.map(|axis| {
        let stretch = cut(cells)[axis] / size[axis];
        let stretch = match (stretch - 1.0).abs() <= CUBIC {
            true => 1.0,
            false => stretch,
        };
        Slab { axis, stretch }
    });
    if !cubic(cut(cells), cells) {
        let mut plane = unscaled;
        if let Some(axis) = across {
            plane[axis] = unscaled[(axis + 1) % 3];
        }
        return Err(Error::input(
            format!("--scale {scale}"),
            format!("domain.cells would be {}, which are not cubic", list(cells)),
            format!("use --scale {}", working_scale(plane, scale)),
        ));
    }
    let gravity_keyframes = table.optional("gravity_keyframes", Vec::new(), |place| {
        place.ensure(
            table.get("gravity").is_none(),
            "conflicts with `gravity`: both are the gravity",
            "keep one of them",
        )?;
        let example = "gravity_keyframes = [{ t = 0, gravity = [0, -9.81, 0] }, { t = 1, gravity = [5, -8, 0] }]";
        vector_keyframes(&place, (&GRAVITY_KEYFRAME, example), "gravity in m/s^2", MAX_GRAVITY)
    })?;
    let first = gravity_keyframes.first();
    let gravity = first.map_or(DVec3::new(0.0, -9.81, 0.0), |frame| frame.value);
    let gravity = table.optional("gravity", gravity, |place| bounded(&place, "gravity in m/s^2", MAX_GRAVITY))?;
    let open = table.optional("open", Sides::default(), |place| open_sides(&place, root))?;
    let symmetry = table.optional("symmetry", Sides::default(), |place| symmetry(&place, open, across))?;
    let domain = Domain { size, cells, gravity, gravity_keyframes, open, symmetry, slab, friction: friction(&table)? };
    let across = |axis: &Axis| {
        let plane = (0..2).any(|side| symmetry.has(*axis, side));
        plane && domain.largest_gravity()[axis.index()] != 0.0
    };
    if let (Some(place), Some(_)) = (table.get("symmetry"), Axis::ALL.iter().find(|axis| across(axis))) {
        return Err(place.fail(
            "gravity points across a plane of symmetry, so its two sides differ",
            "remove the side, or let gravity point along it",
        ));
    }
    Ok(domain)
}

/// Whether a wall, an obstacle or a solid has friction.
pub(super) fn has_friction(domain: &Domain, obstacles: &[Obstacle], solids: &[Solid]) -> bool {
    let obstacles = obstacles.iter().any(|obstacle| obstacle.friction > 0.0);
    domain.friction > 0.0 || obstacles || solids.iter().any(|solid| solid.friction > 0.0)
}

/// The coefficient of friction of a wall, obstacle or solid.
pub(super) fn friction(table: &Table) -> Result<f64, Error> {
    table.optional("friction", 0.0, |place| {
        place.number_within(
            "a coefficient of friction",
            0.0..=MAX_FRICTION,
            format!("use 0 to {MAX_FRICTION}; steel on steel has 0.6, rubber on concrete 0.8"),
        )
    })
}

/// The axis across a slab of a domain with these cells.
fn slab_axis(place: &Place, cells: [usize; 3]) -> Result<usize, Error> {
    let axis = place.choice(&[("x", 0), ("y", 1), ("z", 2)])?;
    let most = slab::MAX_CELLS;
    place.ensure(
        cells[axis] <= most,
        format!("is {} cells thick", cells[axis]),
        format!("let domain.cells have at most {most} along this axis"),
    )?;
    Ok(axis)
}

fn open_sides(place: &Place, root: &Table) -> Result<Sides, Error> {
    let open = sides(place)?;
    place.ensure(
        !open.any() || root.get("liquid").is_some(),
        "opens sides for liquid, and the scene has none",
        "remove `open`, or add a [liquid] section with a region",
    )?;
    Ok(open)
}

/// The planes of symmetry of a domain with these open sides and perhaps an axis across a slab.
fn symmetry(place: &Place, open: Sides, across: Option<usize>) -> Result<Sides, Error> {
    let planes = sides(place)?;
    for axis in Axis::ALL {
        let both = (0..2).any(|side| planes.has(axis, side) && open.has(axis, side));
        place.ensure(
            !both,
            "names an open side: nothing flows through a plane of symmetry",
            "remove it here or in domain.open",
        )?;
        let slab = (0..2).any(|side| planes.has(axis, side)) && across == Some(axis.index());
        place.ensure(!slab, "names a wall of the slab, which is a plane of symmetry already", "remove it")?;
    }
    Ok(planes)
}

fn sides(place: &Place) -> Result<Sides, Error> {
    let axes = Axis::ALL.into_iter();
    let sides = axes.flat_map(|axis| [0, 1].map(|side| (axis, side)));
    let choices: Vec<_> = Sides::NAMES.into_iter().zip(sides).collect();
    let expected = format!("a list, such as [\"+x\"], of any of {}", Sides::NAMES.join(", "));
    let entries = place.list().map_err(|_| place.wrong_type(&expected))?;
    let mut sides = Sides::default();
    for entry in entries {
        let (axis, side) = entry.choice(&choices)?;
        let twice = sides.has(axis, side);
        entry.ensure(!twice, "names a side for the second time", "remove it")?;
        sides = sides.with(axis, side);
    }
    Ok(sides)
}

/// A density; `usual` is an example.
pub(super) fn density(place: &Place, usual: &str) -> Result<f64, Error> {
    let cure = format!("use 1e-6 to 1e6 kg/m^3; {usual}");
    place.positive_within("a density in kg/m^3", DENSITIES, cure)
}

/// An error unless a name consists of letters, digits, _, - and ., and no `earlier` entry has it.
pub(super) fn unique_name<'a>(
    place: &Place,
    name: &str,
    kind: &str,
    mut earlier: impl Iterator<Item = &'a str>,
) -> Result<(), Error> {
    let plain = |c: char| c.is_ascii_alphanumeric() || "_-.".contains(c);
    place.ensure(
        name.chars().all(plain),
        format!("\"{name}\" is no name of a {kind}"),
        "use letters, digits, _, - and . only",
    )?;
    place.ensure(
        earlier.all(|other| other != name),
        format!("an earlier {kind} has the name \"{name}\" too"),
        "choose another name",
    )
}

/// Three numbers from -`most` to `most`.
pub(super) fn bounded(place: &Place, what: &str, most: f64) -> Result<DVec3, Error> {
    let vector = place.vector(what)?;
    place.ensure(
        vector.abs().max_element() <= most,
        format!("is {}", list(vector.to_array().map(|part| format!("{part:?}")))),
        format!("write {what} with numbers from -{most:e} to {most:e}"),
    )?;
    Ok(vector)
}

fn cubic(size: DVec3, cells: [usize; 3]) -> bool {
    let edges = size / DVec3::from_array(cells.map(|n| n as f64));
    (edges / edges.x - 1.0).abs().max_element() <= CUBIC
}

/// Allowed numbers of cubic cells that are nearest to `cells`, within a factor of 4.
fn cubic_cells(size: DVec3, cells: [usize; 3]) -> Option<[usize; 3]> {
    let edges = size / DVec3::from_array(cells.map(|n| n as f64));
    let target = size.x / edges.element_product().cbrt();
    let most = (4.0 * target).ceil().min(MAX_CELLS_PER_AXIS as f64) as usize;
    let candidates = (1..=most).filter_map(|nx| {
        let counts = size.to_array().map(|side| (side / size.x * nx as f64).round().max(1.0));
        let allowed =
            counts.iter().all(|&n| n <= MAX_CELLS_PER_AXIS as f64) && counts.iter().product::<f64>() <= MAX_CELLS;
        let counts = counts.map(|n| n as usize);
        (allowed && cubic(size, counts)).then_some(counts)
    });
    candidates.min_by(|a, b| {
        let distance = |counts: &[usize; 3]| (counts[0] as f64 / target).ln().abs();
        distance(a).total_cmp(&distance(b))
    })
}

/// The scale nearest to `scale` with cubic cells. With g the greatest common divisor, cells g (a, b, c) remain cubic exactly when
/// they become m (a, b, c), m whole.
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
    let table = root.required("time", "[time] with duration = 2.0")?.table(&TIME)?;
    let duration_place = table.required("duration", "duration = 2.0, in s")?;
    let duration = duration_place.positive("a duration in s")?;
    let frames_per_second = table.optional("frames_per_second", 24.0, |place| {
        let cure = "use 1e-3 to 1e6; 24 is usual";
        place.positive_within("frames per second", FRAME_RATES, cure)
    })?;
    let frames = duration * frames_per_second;
    duration_place.ensure(
        frames <= MAX_FRAMES as f64,
        format!("{duration} s at {frames_per_second} frames per second are {frames:.0} frames, more than {MAX_FRAMES}"),
        "shorten the duration or use fewer frames per second",
    )?;
    let cfl = table.optional("cfl", 3.0, |place| {
        let what = "the cells that the fastest point crosses in a sub-step";
        place.positive_within(what, ..=32.0, "use at most 32; 1 to 5 is usual")
    })?;
    let fixed_step = table.optional("fixed_step", None, |place| {
        let step = place.positive("a constant sub-step in s")?;
        let ratio = 1.0 / (frames_per_second * step);
        let whole = ratio.round().max(1.0);
        place.ensure(
            (ratio - whole).abs() <= WHOLE_STEPS * whole,
            format!("{step} s does not divide the frame time, 1/{frames_per_second} s: {ratio} steps in a frame"),
            format!("use {}, {whole} in a frame", 1.0 / (frames_per_second * whole)),
        )?;
        Ok(Some(step))
    })?;
    let max_step = table.optional("max_step", None, |place| {
        let step = place.positive("the longest sub-step in s")?;
        place.ensure(
            fixed_step.is_none(),
            "the sub-step is constant already, by time.fixed_step",
            "remove one of the two keys",
        )?;
        let least = SHORTEST_STEP * duration;
        place.ensure(
            step >= least,
            format!("{step} s is less than {SHORTEST_STEP:e} of the duration"),
            format!("use at least {least} s"),
        )?;
        Ok(Some(step))
    })?;
    Ok(Time { duration, frames_per_second, cfl, max_step, fixed_step })
}

fn liquid(root: &Table, file: &Path, domain: &Domain) -> Result<Liquid, Error> {
    let example = "[liquid] and [[liquid.region]] with a shape, such as box = { min = [0, 0, 0], max = [1, 0.5, 1] }";
    let or_solids = format!("{example}, or [[solid]] with name, mesh, density, young and poisson");
    let table = root.required("liquid", &or_solids)?.table(&LIQUID)?;
    let density = table.optional("density", 1000.0, |place| density(&place, "water has 1000"))?;
    // Keys that act on markers alone imply them.
    let of_markers = table.get("marker_radius").is_some() || root.get("surface").is_some();
    let default = if of_markers { Surface::Markers } else { Surface::Level };
    let surface = table.optional("surface", default, |place| {
        let surface =
            place.choice(&[("level", Surface::Level), ("markers", Surface::Markers), ("fixed", Surface::Fixed)])?;
        place.ensure(
            surface != Surface::Fixed || !domain.open.any(),
            "fixes the surface, and liquid leaves through open sides (domain.open)",
            "remove the line, or close all sides",
        )?;
        Ok(surface)
    })?;
    let default = if surface == Surface::Level { Separation::FromAir } else { Separation::None };
    let separation = table.optional("separation", default, |place| {
        let separation = place.choice(&[
            ("none", Separation::None),
            ("walls", Separation::Walls),
            ("from_air", Separation::FromAir),
        ])?;
        place.ensure(
            separation == Separation::None || surface != Surface::Fixed,
            "lets liquid leave walls, which needs a surface that moves",
            "use surface = \"level\", or separation = \"none\"",
        )?;
        Ok(separation)
    })?;
    let marker_radius = table.optional("marker_radius", 0.87, |place| {
        let cure = "use 0.5 to 1.2; half a cell's diagonal, 0.87, covers a cell with one marker";
        place.number_within("the marker radius in cells", MARKER_RADII, cure)
    })?;
    let seed = table.optional("seed", 0, |place| place.count("a seed", 0, i64::MAX as u64))?;
    let moves = surface != Surface::Fixed;
    let volume_control = table.optional("volume_control", moves, |place| {
        let on = place.boolean()?;
        place.ensure(!on || moves, "a fixed surface has no volume control", "remove it, or use surface = \"level\"")?;
        Ok(on)
    })?;
    // Sources may fill an empty domain.
    let sources = root.get("source").is_some();
    let places = match (table.get("region"), sources) {
        (Some(places), true) => places.list()?,
        (None, true) => Vec::new(),
        (_, false) => {
            let places = table.required("region", example)?;
            let entries = places.list()?;
            places.ensure(!entries.is_empty(), "has no entry, so there is no liquid", format!("write {example}"))?;
            entries
        }
    };
    let mut regions: Vec<Region> = Vec::new();
    for place in places {
        let region = region(&place, file, domain)?;
        let adds = regions.iter().any(|earlier| !earlier.subtract);
        place.ensure(
            adds || !region.subtract,
            "subtracts from nothing: no region before it adds liquid",
            "write a region without subtract first",
        )?;
        regions.push(region);
    }
    Ok(Liquid { density, regions, surface, marker_radius, seed, volume_control, separation })
}

fn region(place: &Place, file: &Path, domain: &Domain) -> Result<Region, Error> {
    let table = place.clone().table(&REGION)?;
    let (kind, shape_place) = table.one_of(&REGION_SHAPES, "shape")?;
    let shape = match kind {
        "solitary" => solitary(shape_place.clone(), domain.gravity)?,
        _ => shape(kind, shape_place.clone(), file)?,
    };
    if let Some(place) = table.get("placement") {
        place.ensure(
            OBSTACLE_SHAPES.contains(&kind),
            format!("needs a shape with a centre, and a {kind} has none"),
            format!("remove it, and position the shape with the keys of {kind}"),
        )?;
    }
    let placement = placement(&table, shape.centre())?;
    ensure_in_domain(&shape_place, shape.reaches(&placement, domain.size), domain.size)?;
    Ok(Region {
        shape,
        placement,
        subtract: table.optional("subtract", false, |place| place.boolean())?,
        velocity: table
            .optional("velocity", DVec3::ZERO, |place| bounded(&place, "a velocity in m/s", MAX_VELOCITY))?,
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
        let placement = placement(&table, shape.centre())?;
        let inside_out = table.optional("inside_out", false, |place| place.boolean())?;
        let motion = motion(&table)?;
        let moves_in = motion.as_ref().zip(shape.bounds(&placement));
        let moves_in = moves_in.is_some_and(|(motion, bounds)| motion.may_reach(bounds, domain.size));
        let inside = shape.reaches(&placement, domain.size) || moves_in;
        ensure_in_domain(&shape_place, inside, domain.size)?;
        if shape.contains_box(&placement, domain.size) {
            return Err(match inside_out {
                true => shape_place.fail("contains the whole domain, so the container has no effect", "shrink it"),
                false => shape_place.fail("fills the whole domain", "shrink it, or use a container: inside_out = true"),
            });
        }
        Ok(Obstacle { shape, placement, inside_out, motion, friction: friction(&table)? })
    };
    places.list()?.into_iter().map(obstacle).collect()
}

/// Motion of an obstacle; `None` without keyframes.
fn motion(table: &Table) -> Result<Option<Motion>, Error> {
    let pivot = table.get("pivot");
    if table.get("keyframes").is_none() {
        return match pivot {
            None => Ok(None),
            Some(place) => Err(place.fail(
                "is the centre of rotation of keyframes, and the obstacle has none",
                "remove it, or add keyframes",
            )),
        };
    }
    let keyframes = keyframes(table)?;
    for (place, frame) in table.required("keyframes", "keyframes = [{ t = 0 }]")?.list()?.iter().zip(&keyframes).skip(1)
    {
        let before = keyframes.iter().rev().find(|other| other.time < frame.time);
        let before = before.expect("the first keyframe was skipped");
        let speed = (frame.translate - before.translate).length() / (frame.time - before.time);
        place.ensure(
            speed <= MAX_VELOCITY,
            format!("implies a speed of {speed:.3e} m/s"),
            format!("use a longer time or a shorter distance: at most {MAX_VELOCITY:e} m/s"),
        )?;
    }
    Ok(Some(Motion { keyframes, pivot: pivot.map(|place| place.vector("the centre of rotation in m")).transpose()? }))
}

/// Floor of theta for marker surfaces, which are bumpy by a tenth of a cell: a smaller theta only amplifies the velocity of small-aperture
/// faces.
///
/// In 72 pools at rest, half of them with a body, the worst initial speed was 1.14 g dt with 0.1. With 0.15 it was 1.04 g dt.
/// The period of a standing wave is the same from 0.01 to 0.2.
const MARKER_THETA_FLOOR: f64 = 0.15;

/// Floor of theta for levels, which are smooth. Where a wave crosses a row of cell centres, a larger floor acts on the pressure of the cells
/// just below the surface and on their sides differently: with 0.01, waves of 32 cells and a tenth of a cell lost 26 % a period, with 1e-4
/// they lose 0.3 %.
const LEVEL_THETA_FLOOR: f64 = 1e-4;

/// The thesis's clamp, for its face areas.
const NODAL_AREA_CLAMP: f64 = 1e-2;

/// Why solids touch each other or themselves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Touching {
    /// Friction, or a solid that touches itself: nothing works without contact.
    Required,
    /// At least two solids may touch each other.
    Possible,
    /// No pair of solids may touch.
    No,
}

impl Touching {
    fn of(domain: &Domain, obstacles: &[Obstacle], solids: &[Solid]) -> Touching {
        let itself = solids.iter().any(|solid| solid.self_contact);
        let excludes = |a: usize, b: usize| solids[a].no_contact_with.contains(&b);
        let touch = |a: usize, b: usize| solids[a].contact && solids[b].contact && !excludes(a, b) && !excludes(b, a);
        match solids.len() {
            0 => Touching::No,
            _ if itself || has_friction(domain, obstacles, solids) => Touching::Required,
            n if (0..n).any(|a| (0..a).any(|b| touch(a, b))) => Touching::Possible,
            _ => Touching::No,
        }
    }
}

/// `surface` is that of the liquid; `None` without liquid.
fn solver(root: &Table, surface: Option<Surface>, has_solids: bool, touching: Touching) -> Result<Solver, Error> {
    let mut solver = Solver {
        theta_floor: match surface {
            Some(Surface::Markers) => ThetaFloor::from(MARKER_THETA_FLOOR),
            Some(Surface::Level) => ThetaFloor { whole: LEVEL_THETA_FLOOR, closing: MARKER_THETA_FLOOR },
            Some(Surface::Fixed) | None => Solver::default().theta_floor,
        },
        solid_contact: touching != Touching::No,
        ..Solver::default()
    };
    let Some(place) = root.get("solver") else {
        return Ok(solver);
    };
    let table = place.table(&SOLVER)?;
    if let Some(place) = table.get("precision") {
        solver.precision = place.choice(Precision::NAMES)?;
        solver.tolerance = solver.precision.default_tolerance();
    }
    solver.tolerance = table.optional("tolerance", solver.tolerance, |place| {
        let cure = "use 1e-14 to below 1; 1e-8 is usual";
        place.positive_within("a relative tolerance", 1e-14..1.0, cure)
    })?;
    solver.max_iterations = table.optional("max_iterations", solver.max_iterations, |place| {
        Ok(place.count("the iterations of all refinement steps", 1, 100_000)? as u32)
    })?;
    if let Some(place) = table.get("preconditioner") {
        place.ensure(
            surface.is_some(),
            "sets the pressure solve, and the scene has no liquid",
            "remove it: the solve of solids has its own preconditioner",
        )?;
        solver.preconditioner = place.choice(Preconditioner::NAMES)?;
        if solver.preconditioner == Preconditioner::BlockJacobi {
            ensure_coupled(&place, surface.is_some() && has_solids)?;
        }
    }
    solver.theta_floor = table.optional("theta_floor", solver.theta_floor, |place| {
        let cure = "use 1e-6 to 0.5; 1e-4 is usual with a level, 1e-2 with a fixed surface, 0.15 with markers";
        let floor = place.positive_within("the smallest distance to the surface in cells", 1e-6..=0.5, cure)?;
        Ok(ThetaFloor::from(floor))
    })?;
    coupled_solver(&table, surface.is_some() && has_solids, &mut solver)?;
    // Off by default where it would be refused: weak couplings, and f32 on the GPU.
    let supported = solver.coupling == CouplingScheme::Strong && solver.precision != Precision::F32;
    let by_default = touching == Touching::Required || touching == Touching::Possible && supported;
    solver.solid_contact = table.optional("solid_contact", by_default, |place| {
        let contact = place.boolean()?;
        place.ensure(!contact || has_solids, "needs elastic solids", "remove it")?;
        place.ensure(
            contact || touching != Touching::Required,
            "is off, and friction or self_contact needs it",
            "remove it: they turn it on; or remove each `friction` above 0 and each `self_contact`",
        )?;
        Ok(contact)
    })?;
    if solver.solid_contact && solver.coupling != CouplingScheme::Strong {
        let problem = "needs liquid and solids in one solve";
        let cure = "use coupling \"strong\", or remove it";
        return Err(match table.get("solid_contact") {
            Some(place) => place.fail(problem, cure),
            None => table.required("coupling", "coupling = \"strong\"")?.fail(
                "has liquid and solids in separate solves, and friction or self_contact needs one solve",
                "use coupling \"strong\", or remove each `friction` above 0 and each `self_contact`",
            ),
        });
    }
    solver.area_clamp = table.optional("area_clamp", solver.area_clamp, |place| {
        place.number_within(
            "the smallest aperture of a face",
            // Sums over patches are off by up to 1e-12: such apertures are rounding.
            1e-6..0.5,
            "use 1e-6 to less than 0.5; 1e-3 is usual",
        )
    })?;
    Ok(solver)
}

fn ensure_coupled(place: &Place, coupled: bool) -> Result<(), Error> {
    place.ensure(coupled, "needs liquid and elastic solids, and the scene does not have both", "remove it")
}

/// The keys of scenes with liquid and solids.
fn coupled_solver(table: &Table, coupled: bool, solver: &mut Solver) -> Result<(), Error> {
    if let Some(place) = table.get("coupling") {
        ensure_coupled(&place, coupled)?;
        solver.coupling = place.choice(&[
            ("strong", CouplingScheme::Strong),
            ("weak", CouplingScheme::Weak),
            ("damping_only", CouplingScheme::DampingOnly),
        ])?;
    }
    if let Some(place) = table.get("pressure_on_patches") {
        ensure_coupled(&place, coupled)?;
        solver.pressure_on_patches = place.choice(PatchPressure::NAMES)?;
    }
    if let Some(place) = table.get("formulation") {
        ensure_coupled(&place, coupled)?;
        solver.formulation = place.choice(&[
            ("auto", Formulation::Auto),
            ("two_field", Formulation::TwoField),
            ("condensed", Formulation::Condensed),
        ])?;
        place.ensure(
            solver.formulation != Formulation::Condensed || solver.preconditioner != Preconditioner::BlockJacobi,
            "has pressures as its only unknowns, and preconditioner \"block_jacobi\" needs nodes",
            "use formulation \"two_field\", or preconditioner \"jacobi\", the diagonal of B",
        )?;
    }
    if coupled && solver.formulation == Formulation::Auto && solver.preconditioner != Preconditioner::Multigrid {
        // Both diagonals are those of the two-field system.
        solver.formulation = Formulation::TwoField;
    }
    if let Some(place) = table.get("face_areas") {
        ensure_coupled(&place, coupled)?;
        solver.face_areas = place.choice(&[("clipped", FaceAreas::Clipped), ("nodal", FaceAreas::Nodal)])?;
        if solver.face_areas == FaceAreas::Nodal {
            solver.area_clamp = NODAL_AREA_CLAMP;
        }
    }
    Ok(())
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
    for (key, enabled, (present, problem)) in [
        ("particles", &mut output.particles, liquid),
        ("fields", &mut output.fields, liquid),
        ("solids", &mut output.solids, solids),
        ("surface", &mut output.surface, liquid),
    ] {
        if let Some(place) = table.get(key) {
            *enabled = place.boolean()?;
            let cure = format!("remove `{key}`, or write {key} = false");
            place.ensure(present || !*enabled, problem, cure)?;
        }
    }
    output.every =
        table.optional("every", output.every, |place| place.count("the interval of written frames", 1, MAX_FRAMES))?;
    output.checkpoint_every = table.optional("checkpoint_every", output.checkpoint_every, |place| {
        place.count("the interval of checkpoints in frames", 0, MAX_FRAMES)
    })?;
    Ok(output)
}

pub(super) fn list<T: std::fmt::Display, const N: usize>(values: [T; N]) -> String {
    let values: Vec<_> = values.iter().map(T::to_string).collect();
    format!("[{}]", values.join(", "))
}
