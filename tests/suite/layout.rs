//! Every struct that host and shader share has the same size and the same offsets on both sides.

use std::mem::offset_of;

use cutwater::gpu::{Range, Real, Source, compose, validate};
use cutwater::grid::Layout;
use cutwater::stages::{ProbePoint, SolidStep, Step, Tiles};

/// Compares a WGSL struct with (field, offset) pairs and the size of its Rust doppelganger.
pub(crate) fn assert_layout(
    module: &'static str,
    name: &str,
    fields: &[(&str, usize)],
    size: usize,
) {
    let text = format!("#import {module}\n@compute @workgroup_size(1) fn probe() {{}}\n");
    let source = Source {
        name: "probe",
        text: text.leak(),
    };
    let (module, _) = validate(&compose(&source, Real::F32).unwrap(), Real::F32).unwrap();
    let (_, ty) = module
        .types
        .iter()
        .find(|(_, ty)| ty.name.as_deref() == Some(name))
        .unwrap_or_else(|| panic!("no struct {name}"));
    let naga::TypeInner::Struct { members, span } = &ty.inner else {
        panic!("{name} is no struct")
    };
    let found: Vec<(&str, usize)> = members
        .iter()
        .map(|member| (member.name.as_deref().unwrap_or(""), member.offset as usize))
        .collect();
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
    assert_layout(
        "compact",
        "Range",
        fields!(Range: first, n_flags, args, n_chunks),
        size_of::<Range>(),
    );
}

#[test]
fn solver_structs_match() {
    use cutwater::solver::{Control, Level, Sweep};
    let fields = fields!(Level: shape, coefficient, args, pad_0, pad_1);
    assert_layout("level", "Level", fields, size_of::<Level>());
    assert_layout(
        "sweep",
        "Sweep",
        fields!(Sweep: omega, ends_cycle, pad_0, pad_1),
        size_of::<Sweep>(),
    );
    let fields = fields!(
        Control: running, status, iterations, max_iterations, first, rounds, unknowns, n_lists
    );
    assert_layout("control_state", "Control", fields, size_of::<Control>());
}

#[test]
fn step_matches() {
    let fields = fields!(
        Step: gravity, dt, size, dx, inv_dx, frame, volume_0, density, marker_radius, theta_floor,
        n_markers, spare,
    );
    assert_layout("step", "Step", fields, size_of::<Step>());
}

#[test]
fn solid_step_matches() {
    let fields = fields!(
        SolidStep: gravity, dt, size, dx, inv_dx, n_nodes, n_elements, zero,
    );
    assert_layout("solid_step", "SolidStep", fields, size_of::<SolidStep>());
}

#[test]
fn tiles_match() {
    assert_layout(
        "tiles",
        "Tiles",
        fields!(Tiles: n, reach),
        size_of::<Tiles>(),
    );
}

#[test]
fn probe_point_matches() {
    let fields = fields!(ProbePoint: point, kind);
    assert_layout("probe_point", "ProbePoint", fields, size_of::<ProbePoint>());
}
