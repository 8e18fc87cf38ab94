//! What host and shader share is the same on both sides: sizes and offsets of structs, values of constants.

use std::fs;
use std::mem::offset_of;
use std::path::Path;

use cutwater::fields::{LevelStep, SolidStep, Step, Tiles};
use cutwater::gpu::{Range, Real, SortPass, Source, compose, validate};
use cutwater::grid::Layout;
use cutwater::stages::{ProbePoint, ProbeRectangle};

fn text_of(file: &str) -> Option<String> {
    fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(file)).ok()
}

/// `shaders/NAME.wgsl`, or a kernel that imports the module `NAME` and nothing else.
fn parsed(name: &'static str) -> naga::Module {
    let kernel = text_of(&format!("shaders/{name}.wgsl"));
    let import = || format!("#import {name}\n@compute @workgroup_size(1) fn probe() {{}}\n");
    let text = kernel.unwrap_or_else(import).leak();
    let composed = compose(&Source { name, text }, Real::F32).unwrap();
    validate(&composed, Real::F32).unwrap().0
}

/// Compares a WGSL struct of a kernel or a module with (field, offset) pairs and the size of its Rust doppelganger.
pub(crate) fn assert_layout(module: &'static str, name: &str, fields: &[(&str, usize)], size: usize) {
    let module = parsed(module);
    let (_, ty) = module
        .types
        .iter()
        .find(|(_, ty)| ty.name.as_deref() == Some(name))
        .unwrap_or_else(|| panic!("no struct {name}"));
    let naga::TypeInner::Struct { members, span } = &ty.inner else { panic!("{name} is no struct") };
    let found: Vec<(&str, usize)> =
        members.iter().map(|member| (member.name.as_deref().unwrap_or(""), member.offset as usize)).collect();
    assert_eq!(found, fields, "{name}: fields and offsets");
    assert_eq!(*span as usize, size, "{name}: size");
}

/// `(name, offset)` pairs of the fields of a Rust struct.
macro_rules! fields {
    ($type:ty: $($field:ident),+ $(,)?) => {
        &[$((stringify!($field), offset_of!($type, $field))),+]
    };
}

#[test]
fn layout_matches() {
    let fields = fields!(Layout: cells, stride_y, stride_z, quads, first, total);
    assert_layout("layout", "Layout", fields, size_of::<Layout>());
}

#[test]
fn range_matches() {
    assert_layout("compact", "Range", fields!(Range: first, n_flags, args, n_chunks), size_of::<Range>());
}

#[test]
fn solver_structs_match() {
    use cutwater::solver::{Control, Level, Sweep};
    let fields = fields!(Level: shape, coefficient, args, pad_0, pad_1);
    assert_layout("level", "Level", fields, size_of::<Level>());
    assert_layout("sweep", "Sweep", fields!(Sweep: omega, ends_cycle, pad_0, pad_1), size_of::<Sweep>());
    let fields = fields!(
        Control: running, status, iterations, max_iterations, first, refinements, unknowns, n_lists
    );
    assert_layout("control_state", "Control", fields, size_of::<Control>());
}

#[test]
fn coupling_matches() {
    use cutwater::fields::Coupling;
    let fields = fields!(
        Coupling: n_wet, n_nodes, quad_starts, node_starts, mass, share, pad_0, pad_1
    );
    assert_layout("coupling", "Coupling", fields, size_of::<Coupling>());
}

#[test]
fn step_matches() {
    let fields = fields!(
        Step: gravity, dt, size, dx, inv_dx, control_time, volume_0, density, marker_radius,
        n_markers, open_sides, largest_slope,
    );
    assert_layout("step", "Step", fields, size_of::<Step>());
}

#[test]
fn solid_step_matches() {
    let fields = fields!(
        SolidStep: gravity, dt, size, dx, inv_dx, n_nodes, n_elements, zero, elastic, damped, pad_0, pad_1,
    );
    assert_layout("solid_step", "SolidStep", fields, size_of::<SolidStep>());
}

#[test]
fn tiles_match() {
    assert_layout("tiles", "Tiles", fields!(Tiles: n, reach, air, moves, pad_0, pad_1), size_of::<Tiles>());
}

#[test]
fn level_step_matches() {
    let fields = fields!(LevelStep: seed, number, capacity, courant, freed, renewed, pad_0, pad_1);
    assert_layout("level_step", "LevelStep", fields, size_of::<LevelStep>());
}

#[test]
fn probe_point_matches() {
    let fields = fields!(ProbePoint: point, kind);
    assert_layout("probe_point", "ProbePoint", fields, size_of::<ProbePoint>());
    let fields = fields!(ProbeRectangle: low, axis, high, place);
    let size = size_of::<ProbeRectangle>();
    assert_layout("probe_rectangle", "ProbeRectangle", fields, size);
}

#[test]
fn sort_pass_matches() {
    assert_layout("sort", "SortPass", fields!(SortPass: shift, args), size_of::<SortPass>());
}

#[test]
fn settings_match() {
    use cutwater::solver::RefineSettings;
    use cutwater::stages::{ActiveSettings, SeparationRound, SeparationSettings};
    let fields = fields!(ActiveSettings: theta_floor, closing_theta_floor, open_sides, pad);
    let size = size_of::<ActiveSettings>();
    assert_layout("active_cells", "ActiveSettings", fields, size);
    let fields = fields!(SeparationSettings: from_air, grows, pad_0, pad_1);
    let size = size_of::<SeparationSettings>();
    assert_layout("separation_start", "SeparationSettings", fields, size);
    let fields = fields!(SeparationRound: locks, tolerance, pad_0, pad_1);
    let size = size_of::<SeparationRound>();
    assert_layout("separation_update", "SeparationRound", fields, size);
    let fields = fields!(RefineSettings: tolerance, rounding, floor, guess, n_blocks, pad_0, pad_1, pad_2);
    let size = size_of::<RefineSettings>();
    assert_layout("refine", "RefineSettings", fields, size);
}

#[test]
fn taps_match() {
    use cutwater::fields::{DeviceSourceFace, Region, SourceStep};
    let fields = fields!(Region: low, first, n, number);
    assert_layout("region", "Region", fields, size_of::<Region>());
    let fields = fields!(SourceStep: running, starting, first, seed, number, pad_0, pad_1, pad_2);
    assert_layout("source_step", "SourceStep", fields, size_of::<SourceStep>());
    let fields = fields!(DeviceSourceFace: face, sides, minus, plus, minus_aperture, plus_aperture, pad_0, pad_1);
    let size = size_of::<DeviceSourceFace>();
    assert_layout("source_face", "SourceFace", fields, size);
}

#[test]
fn tail_matches() {
    use cutwater::solver::{Tail, TailStep};
    let fields = fields!(Tail: levels, steps, n_steps, pad_0, pad_1, pad_2);
    assert_layout("vcycle_tail", "Tail", fields, size_of::<Tail>());
    let fields = fields!(TailStep: op, level, omega, pad_0);
    assert_layout("vcycle_tail", "Step", fields, size_of::<TailStep>());
}

/// The value of a constant of a Rust or WGSL file, private ones too, from its text.
fn constant(file: &str, name: &str) -> f64 {
    let text = text_of(file).unwrap_or_else(|| panic!("no file {file}"));
    let starts = |line: &&str| {
        let rest = line.split_once(&format!("const {name}"));
        rest.is_some_and(|(_, rest)| rest.starts_with([':', ' ']))
    };
    let line = text.lines().find(starts);
    let line = line.unwrap_or_else(|| panic!("{file}: no constant {name}"));
    let value = line.split_once(" = ").unwrap().1.split(';').next().unwrap();
    let value = value.replace('_', "");
    let value = value.trim_end_matches('u');
    match value.strip_prefix("0x") {
        Some(digits) => f64::from(u32::from_str_radix(digits, 16).unwrap()),
        None => value.parse().unwrap_or_else(|_| panic!("{file}: {name} is {value}")),
    }
}

/// Constants that have one name on both sides: where the host and the shaders have them.
const SHARED: &[(&str, &str, &[&str])] = &[
    ("src/gpu/record.rs", "common/dispatch", &["SPLIT"]),
    ("src/gpu/shader.rs", "common/dispatch", &["WG_SIZE"]),
    ("src/gpu/sort.rs", "common/sort", &["TILE", "DIGIT_BITS"]),
    ("src/fields/liquid.rs", "common/tiles", &["TILE"]),
    ("src/fields/report.rs", "common/report", &["DROPPED"]),
    ("src/solver/mod.rs", "vcycle_tail", &["TAIL_STEPS"]),
    ("src/fields/pressure_system.rs", "vcycle_tail", &["TAIL_QUADS", "TAIL_LEVELS"]),
    ("src/reference/turn_solids.rs", "turn_solids", &["LEAST_INERTIA", "ROUNDS", "LEFT"]),
    ("src/fields/pressure_system.rs", "fold_partials", &["FOLD_THREADS"]),
    ("src/solver/hierarchy.rs", "vcycle_tail", &["SWEEP", "RESTRICT", "PROLONG"]),
    ("src/solver/pcg.rs", "common/control", &["UPDATE", "EVALUATE", "BEGIN"]),
    (
        "src/solver/acceptance.rs",
        "common/refine",
        &["SCALE", "RESIDUAL", "RHS", "TERMS", "REFERENCE", "NORMS_OF_STATE", "NORMS_OF_BLOCK"],
    ),
    ("src/solver/refine.rs", "common/control_state", &["STATUS_BREAKDOWN", "STATUS_STAGNATED"]),
    ("src/solver/refine.rs", "common/pcg_slots", &["GOAL"]),
    (
        "src/solver/acceptance.rs",
        "refine_accept",
        &["MARGIN", "MARGIN_COUPLED", "RETRY_COUPLED", "ROUNDING_OF_X", "STRICTEST"],
    ),
    ("src/fields/pressure_system.rs", "common/components", &["N_CLOSED"]),
];

#[test]
fn constants_match() {
    for (file, shader, names) in SHARED {
        for name in *names {
            assert_eq!(
                constant(file, name),
                constant(&format!("shaders/{shader}.wgsl"), name),
                "{file} and shaders: {name}"
            );
        }
    }
}

/// Constants of the shaders that the host has in another form.
#[test]
fn derived_constants_match() {
    let of_shader = |file: &str, name: &str| constant(&format!("shaders/{file}.wgsl"), name);
    let groups = of_shader("common/compact", "CHUNK_GROUPS");
    assert_eq!(constant("src/gpu/compact.rs", "CHUNK"), 4.0 * groups);
    assert_eq!(constant("src/solver/solid_solver.rs", "BODY_NODES"), of_shader("chebyshev_polynomial", "BODY_THREADS"));
    assert_eq!(constant("src/solver/chebyshev.rs", "MAX_DEGREE") + 1.0, of_shader("common/chebyshev", "DEGREES"));
    assert_eq!(constant("src/stages/move_solid.rs", "BODY_THREADS"), of_shader("common/tree", "FOLD_SIZE"));
    let slice = of_shader("common/rows", "SLICE");
    assert_eq!(slice, of_shader("common/dispatch", "WG_SIZE"));
    let digits = 2f64.powf(of_shader("common/sort", "DIGIT_BITS"));
    assert_eq!(of_shader("common/sort", "DIGITS"), digits);
    let tile = of_shader("common/sort", "RUN") * of_shader("common/dispatch", "WG_SIZE");
    assert_eq!(of_shader("common/sort", "TILE"), tile);
    let fold_groups = of_shader("pcg_gate", "FOLD_GROUPS") * of_shader("common/dispatch", "WG_SIZE");
    assert_eq!(constant("src/fields/pressure_system.rs", "FOLD_THREADS"), fold_groups);
    assert_eq!(
        constant("src/solver/acceptance.rs", "COUPLING_SHARE").powi(2),
        of_shader("refine_accept", "COUPLING_SHARE")
    );
    // Its workgroups must be allowed everywhere.
    for (shader, name) in [("common/tree", "FOLD_SIZE"), ("common/scan", "SCAN_SIZE")] {
        assert_eq!(of_shader(shader, name), 256.0, "{name}");
    }
}

#[test]
fn coupled_structs_match() {
    use cutwater::fields::{Clipped, CutQuad};
    use cutwater::solver::Wetted;
    use cutwater::stages::{Cavity, PressureSlope};
    let fields = fields!(Clipped: n_quads, n_places, first, pad);
    assert_layout("cut_quad", "Clipped", fields, size_of::<Clipped>());
    let fields = fields!(CutQuad: open, distance, quad, walls, pad_0, pad_1);
    assert_layout("cut_quad", "CutQuad", fields, size_of::<CutQuad>());
    let fields = fields!(PressureSlope: at_rest, scale);
    assert_layout("pressure_slope", "PressureSlope", fields, size_of::<PressureSlope>());
    let fields = fields!(Wetted: n, pad_0, pad_1, pad_2);
    assert_layout("wetted", "Wetted", fields, size_of::<Wetted>());
    let fields = fields!(Cavity: root, low, high, source, least, largest);
    assert_layout("cavities", "Cavity", fields, size_of::<Cavity>());
}
