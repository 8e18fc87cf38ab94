//! Every scene of solids alone in `scenes/`, with at most so many nodes, in materials, steps and dampings far from those it was made for: no
//! number that is not finite, a clear verdict of every solve, no energy that grows.
//!
//! Energy is what a sub-step begins with: kinetic energy before it, elastic energy and that of height where its move has put the nodes. Were the
//! rotations of elements those of the sub-step's start, backward Euler could only lose of it, whatever the material and the step: its solve leaves
//!
//! ```text
//! m |v'|^2 / 2 + W(x + dt v') - m g . (x + dt v') <= m |v|^2 / 2 + W(x) - m g . x
//! ```
//!
//! and contacts that a node reaches from outside do no work. The energies of one report are of before and after the solve instead: what it turns
//! from strain into motion they count twice, up to a third of a mode with w dt = sqrt(1/2).
//!
//! Its rise is relative to the energy in play: kinetic and elastic energy at the start, plus the energy of height that bodies lose at their lowest.
//!
//! Three things may add to it. A body that turns is no longer strained by that, as its move is on circles. A part that bends still is, by
//! theta^2 / 2, theta being its angle against the body: a solve makes at most a quarter of the motion into strain, (w dt / (1 + w^2 dt^2))^2, so
//! that a part s times as long as thick turns by s sqrt(A / (2 E V)) at most, with A the energy and V the volume, and its strain then holds
//! s^4 A^2 / (32 E V). With s = 4 that is below a tenth of A where E V is above 80 A; what is softer is held to the same, without a proof. The
//! third is not allowed for: what turns into an obstacle in a step, past an edge, is pushed out in the next.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

use cutwater::geometry::TetMesh;
use cutwater::reference::{diagnose_solid, larger};
use cutwater::scene::{Scene, Solid, SolidMesh};
use cutwater::state::{SolidDiagnosis, State};

use crate::Case;
use crate::lane::{Lane, Motion};
use crate::liquid::settings_of;
use crate::sheet::Sheet;
use crate::solid_scene::solids_of;

/// Nodes at most: on the device, which is a CPU here, and on the f64 path.
const MOST_NODES: [(Lane, usize); 2] = [(Lane::Mixed, 64), (Lane::F64, 300)];
const STEPS: usize = 1000;
/// States are read back and looked through after so many steps.
const LOOK: usize = 50;

/// Pa
const YOUNG: [f64; 4] = [1e3, 1e5, 1e7, 1e9];
/// kg/m^3
const DENSITY: [f64; 3] = [10.0, 300.0, 1e4];
/// s
const STEP: [f64; 3] = [1.0 / 1000.0, 1.0 / 120.0, 1.0 / 24.0];
/// Rise of the energy above that of the start, over what is in play, that these steps may come to: in the long ones with what bending adds.
const MOST_RISE: [f64; 3] = [0.01, 0.01, 0.1];
/// The same in the second half of the steps above that of the first one's end: by then there is less motion to bend anything.
const MOST_LATE_RISE: f64 = 0.05;
/// Rounding of energies of height in f32, summed over the nodes, relative to the energy of a fall through the whole domain.
const ROUNDING: f64 = 1e-5;
/// tau_M (1/s), tau_K (s)
const DAMPING: [[f64; 2]; 2] = [[0.0, 0.0], [1.0, 2e-3]];

/// Levels of Young's modulus, density, step and damping.
fn combinations() -> Vec<[usize; 4]> {
    let all: Vec<[usize; 4]> = (0..12)
        .map(|number| {
            let (young, density) = (number / 3, number % 3);
            [young, density, (young + density) % 3, (young + density) % 2]
        })
        .collect();
    // Every pair of levels of any two of the four occurs.
    let levels = [YOUNG.len(), DENSITY.len(), STEP.len(), DAMPING.len()];
    for a in 0..4 {
        for b in 0..a {
            let pairs: BTreeSet<[usize; 2]> = all.iter().map(|row| [row[a], row[b]]).collect();
            assert_eq!(pairs.len(), levels[a] * levels[b], "pairs of {a} and {b}");
        }
    }
    all
}

pub(crate) fn cases() -> Vec<Case> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
    let mut files: Vec<PathBuf> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|end| end == "toml"))
        .filter(|path| {
            let text = fs::read_to_string(path).unwrap();
            // Liquid has a table of its own or regions alone, [[liquid.region]].
            text.contains("[[solid]]") && !text.contains("[liquid")
        })
        .collect();
    files.sort();
    let mut cases = Vec::new();
    for file in files {
        let name = file.file_stem().unwrap().to_string_lossy().into_owned();
        for (number, levels) in combinations().into_iter().enumerate() {
            for (lane, most) in MOST_NODES {
                let file = file.clone();
                cases.push(Case::new(format!("scenes/{name}/{:02}/{}", number + 1, lane.name()), move |sheet| {
                    endures(lane, most, &file, levels, sheet)
                }));
            }
        }
    }
    cases
}

/// The number of nodes of all solids of a scene; nothing where a surface cannot be filled with its cells.
fn n_nodes(scene: &Scene) -> Option<usize> {
    let meshes = scene.solids.iter();
    let nodes = meshes.map(|solid| Some(TetMesh::new(solid, "coarse").ok()?.nodes.len()));
    nodes.sum()
}

/// A solid with cells that are longer by a factor. A mesh from a file is filled anew from its surface.
fn coarser(solid: &Solid, factor: f64, folder: &Path) -> Solid {
    let mut solid = solid.clone();
    let fewer = |cells: usize| ((cells as f64 / factor).round() as usize).max(1);
    solid.mesh = match solid.mesh {
        SolidMesh::Box { size, cells } => SolidMesh::Box { size, cells: cells.map(fewer) },
        SolidMesh::Sphere { radius, cell_size } => SolidMesh::Sphere { radius, cell_size: factor * cell_size },
        SolidMesh::Shell { radius, thickness, cell_size } => {
            SolidMesh::Shell { radius, thickness, cell_size: factor * cell_size }
        }
        SolidMesh::Surface { file, unit, cell_size } => {
            SolidMesh::Surface { file, unit, cell_size: factor * cell_size }
        }
        SolidMesh::File { .. } => {
            let at_home = Solid { placement: Default::default(), ..solid.clone() };
            let mesh = TetMesh::new(&at_home, "file").unwrap();
            let cell_size = factor * (6.0 * mesh.volume() / mesh.elements.len() as f64).cbrt();
            let file = folder.join(format!("{}.obj", solid.name));
            write_surface(&file, &mesh);
            SolidMesh::Surface { file: file.into(), unit: 1.0, cell_size }
        }
    };
    solid
}

/// The surface of a mesh as OBJ.
fn write_surface(file: &Path, mesh: &TetMesh) {
    let triangles = mesh.surface();
    let mut numbers = BTreeMap::new();
    let mut text = String::new();
    for &node in triangles.iter().flatten() {
        let next = numbers.len() + 1;
        numbers.entry(node).or_insert_with(|| {
            let x = mesh.nodes[node as usize];
            writeln!(text, "v {} {} {}", x.x, x.y, x.z).expect("a String takes everything");
            next
        });
    }
    for triangle in &triangles {
        let [a, b, c] = triangle.map(|node| numbers[&node]);
        writeln!(text, "f {a} {b} {c}").expect("a String takes everything");
    }
    fs::write(file, text).unwrap();
}

/// The scene with so many nodes at most.
fn coarse(scene: &Scene, most: usize, folder: &Path) -> Scene {
    let mut factor = 1.0;
    loop {
        let mut coarse = scene.clone();
        for solid in &mut coarse.solids {
            *solid = coarser(solid, factor, folder);
        }
        // Filling a surface takes a while: near the goal at once, then step by step.
        factor *= match n_nodes(&coarse) {
            Some(n) if n <= most => return coarse,
            Some(n) => f64::max(0.8 * (n as f64 / most as f64).cbrt(), 1.1),
            None => 1.1,
        };
        assert!(factor < 100.0, "{} does not become coarse", scene.name);
    }
}

/// Diagnostics of the initial state.
fn diagnosis(scene: &Scene, motion: &Motion) -> SolidDiagnosis {
    let (state, solids) = (motion.state(), &motion.solids);
    let u = &state.displacement;
    diagnose_solid(solids, &solids.deformations(u), u, &state.node_velocity, scene.domain.gravity)
}

fn endures(lane: Lane, most: usize, file: &Path, [young, density, step, damping]: [usize; 4], sheet: &mut Sheet) {
    let folder = tempfile::tempdir().unwrap();
    let settings = settings_of(&fs::read_to_string(file).unwrap());
    let mut scene = coarse(&Scene::load(file, &settings, 1.0).unwrap(), most, folder.path());
    scene.probes.clear();
    let (young, density, dt) = (YOUNG[young], DENSITY[density], STEP[step]);
    let most_rise = MOST_RISE[step];
    let [mass_damping, stiffness_damping] = DAMPING[damping];
    for solid in &mut scene.solids {
        (solid.young, solid.density) = (young, density);
        (solid.mass_damping, solid.stiffness_damping) = (mass_damping, stiffness_damping);
    }
    let n = solids_of(&scene).rest.len();
    let mut motion = Motion::as_users_do(lane, &scene, dt);
    let start = diagnosis(&scene, &motion);
    let mut kinetic_before = start.kinetic_energy;
    let mut statuses: BTreeMap<&str, usize> = BTreeMap::new();
    let (mut iterations, mut most_iterations) = (0, 0);
    let (mut residual, mut min_det) = (0.0, f64::INFINITY);
    // Largest energy of all steps, that at the end of the first half, and the largest of the second, J.
    let mut most_energy = f64::NEG_INFINITY;
    let (mut halfway, mut most_late) = (f64::NAN, f64::NEG_INFINITY);
    let mut least_height = start.potential_energy;
    // Most solves of a step, steps of more than one, and those after which contact was not settled.
    let (mut most_solves, mut several, mut unsettled) = (0, 0, 0);
    let (mut finite, mut end) = (true, String::new());
    for number in 1..=STEPS {
        let report = match motion.simulation.step() {
            Ok(report) => report.solid.unwrap(),
            Err(error) => {
                end = format!(", step {number}: {error}");
                break;
            }
        };
        let (solve, contact, diagnosis) = (report.solve, report.contact, report.diagnosis);
        most_solves = contact.solves.max(most_solves);
        several += usize::from(contact.solves > 1);
        unsettled += usize::from(contact.unsettled > 0);
        *statuses.entry(solve.status.name()).or_default() += 1;
        iterations += solve.iterations;
        most_iterations = solve.iterations.max(most_iterations);
        residual = f64::max(residual, solve.residual);
        min_det = f64::min(min_det, diagnosis.min_det);
        let energy = kinetic_before + diagnosis.elastic_energy + diagnosis.potential_energy;
        kinetic_before = diagnosis.kinetic_energy;
        least_height = least_height.min(diagnosis.potential_energy);
        most_energy = larger(most_energy, energy);
        match number > STEPS / 2 {
            true => most_late = larger(most_late, energy),
            false => halfway = energy,
        }
        let values = [
            solve.residual,
            diagnosis.kinetic_energy,
            diagnosis.elastic_energy,
            diagnosis.potential_energy,
            diagnosis.max_speed,
            diagnosis.min_det,
        ];
        finite &= values.iter().all(|x| x.is_finite());
        if number % LOOK == 0 {
            let State { displacement, node_velocity, .. } = motion.state();
            let numbers = displacement.iter().chain(&node_velocity).flatten();
            finite &= numbers.into_iter().all(|x| x.is_finite());
        }
    }
    let what = format!(
        "E {young:.0e} Pa, {density} kg/m^3, dt 1/{:.0} s, damping {mass_damping}, {stiffness_damping}",
        1.0 / dt
    );
    let steps: usize = statuses.values().sum();
    let statuses: Vec<String> = statuses.iter().map(|(name, count)| format!("{count} {name}")).collect();
    sheet.holds(
        &format!("{what}; {n} nodes"),
        "1000 finite steps",
        format!(
            "{}{end}; {several} of several solves, {most_solves} at most, {unsettled} not settled; \
             {:.1} iterations, {most_iterations} at most; residual <= {residual:.0e}; det F >= {min_det:.2}",
            statuses.join(", "),
            f64::from(iterations) / steps.max(1) as f64
        ),
        finite && steps == STEPS,
    );
    let inner = start.kinetic_energy + start.elastic_energy;
    let fall = (scene.domain.gravity.abs() * scene.domain.size).element_sum();
    let rounding = ROUNDING * fall * motion.solids.mass.iter().sum::<f64>();
    let in_play = inner + f64::max(start.potential_energy - least_height, rounding);
    let rise = most_energy - inner - start.potential_energy;
    for (of, rise, most) in
        [("above that of the start", rise, most_rise), ("in the second half", most_late - halfway, MOST_LATE_RISE)]
    {
        let what = format!("{what}: rise of the energy {of}, over what is in play");
        sheet.at_most(&what, rise / in_play, most);
    }
}
