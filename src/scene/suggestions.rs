//! Suggestions for unknown keys: terms of other programs, and the corresponding key here.

/// Terms, separated by spaces, and the corresponding key of the same table.
const KEYS: &[(&str, &str)] = &[
    // [domain]
    ("resolution grid grid_size divisions n dx cell_size", "cells"),
    ("dimensions extent extents lengths", "size"),
    ("g", "gravity"),
    ("outlet outflow boundary boundaries", "open"),
    ("mirror mirrors symmetry_plane symmetry_planes symmetric", "symmetry"),
    // [time]
    ("fps frame_rate framerate rate", "frames_per_second"),
    ("end end_time t_end tmax t_max stop total_time length", "duration"),
    ("dt time_step timestep step delta_t substep", "fixed_step"),
    ("dt_max max_dt max_timestep largest_step longest_step", "max_step"),
    ("courant cfl_number", "cfl"),
    // Materials
    ("rho mass_density", "density"),
    ("e youngs_modulus young_modulus youngs elastic_modulus elasticity modulus stiffness", "young"),
    ("mu friction_coefficient static_friction dynamic_friction", "friction"),
    ("self_collision self_collide self_intersection", "self_contact"),
    ("exclude exclude_contact ignore_collision filtered_pairs collision_filter", "no_contact_with"),
    ("collide collision collisions", "contact"),
    ("nu poisson_ratio poissons_ratio poissons", "poisson"),
    ("material material_model constitutive_model", "model"),
    // Sections
    ("fluid fluids water liquids", "liquid"),
    ("solids body bodies object elastic", "solid"),
    ("obstacles collider colliders effector rigid", "obstacle"),
    ("inflow inlet emitter tap sources", "source"),
    ("outflow outlet drain sinks", "sink"),
    ("probes gauge sensor monitor", "probe"),
    ("regions", "region"),
    ("pins fixed fix constraint clamp", "pin"),
    ("loads force forces", "load"),
    // Places
    ("position pos location centre center", "at"),
    ("translation offset move", "translate"),
    ("rotation orientation angle", "rotate"),
    ("center position pos location", "centre"),
    ("position pos location centre at", "point"),
    ("angle angle_degrees deg", "degrees"),
    ("time", "t"),
    ("ball", "sphere"),
    ("cube cuboid", "box"),
    ("filename path name", "file"),
    ("unit length_unit", "units"),
    ("vel speed v initial_velocity", "velocity"),
    ("frequency interval output_interval", "every"),
    ("tol eps epsilon", "tolerance"),
    ("iterations max_iter maxiter", "max_iterations"),
];

/// Terms, a key that identifies the table, and the replacement.
const WITHIN: &[(&str, &str, &str)] = &[
    (
        "position pos location centre center at origin",
        "placement",
        "placement = { at = [x, y, z] }, the position of its centre in m",
    ),
    ("translate translation offset", "placement", "placement = { translate = [x, y, z] }, in m"),
    ("rotate rotation orientation", "placement", "placement = { rotate = { axis = [0, 1, 0], degrees = 30 } }"),
    ("scale", "placement", "placement = { scale = 2 }"),
    ("units unit", "mesh", "units beside the file of the mesh: { file = .., units = \"mm\" }"),
    ("file filename path", "mesh", "mesh = { file = .. }"),
    ("velocity vel speed", "initial", "initial = { velocity = [x, y, z] }, in m/s"),
    ("mass weight", "young", "density, in kg/m^3"),
    (
        "mu lambda shear_modulus bulk_modulus",
        "young",
        "young and poisson, to which any two moduli of elasticity convert",
    ),
    ("gravity size cells resolution", "domain", "the key in the section [domain]"),
    (
        "duration fps dt frames_per_second fixed_step max_step cfl",
        "domain",
        "the key in the section [time]: duration, frames_per_second, cfl, max_step, fixed_step",
    ),
    ("density rho", "domain", "the key in the section [liquid] or in a [[solid]]"),
    (
        "units unit",
        "domain",
        "lengths in m; a mesh in another unit has units beside its file: { file = .., units = \"mm\" }",
    ),
];

/// Terms without a key in any table, with the reason.
const NOWHERE: &[(&str, &str)] = &[
    ("viscosity kinematic_viscosity dynamic_viscosity mu nu reynolds viscous turbulence", "liquids here are inviscid"),
    ("surface_tension tension contact_angle", "liquids here have no surface tension"),
    ("friction", "solids, obstacles and the domain have friction; liquids slide without"),
    ("restitution bounce bounciness", "the rebound of a solid follows from its stiffness and damping"),
    ("temperature heat thermal_conductivity specific_heat", "temperature is not simulated"),
    ("speed_of_sound sound_speed compressibility bulk_modulus", "liquids here are incompressible"),
    ("plasticity yield_stress fracture toughness", "solids here are elastic"),
    ("units unit", "all numbers are in m, kg, s; only mesh files have units, beside the file"),
];

/// Cure of an unknown key.
pub(super) enum Suggestion {
    /// A key of the same table.
    Key(&'static str),
    /// Text to write instead.
    Write(&'static str),
    /// No key, for this reason.
    Absent(&'static str),
}

/// Suggestion for an unknown key of a table with the keys `valid`.
pub(super) fn suggestion(name: &str, valid: &[&str]) -> Option<Suggestion> {
    let name = name.to_lowercase().replace('-', "_");
    let is = |words: &str| words.split(' ').any(|word| word == name);
    let has = |key: &str| valid.contains(&key);
    let key = KEYS.iter().find(|(words, key)| is(words) && has(key));
    let within = WITHIN.iter().find(|(words, key, _)| is(words) && has(key));
    let nowhere = NOWHERE.iter().find(|(words, _)| is(words));
    key.map(|&(_, key)| Suggestion::Key(key))
        .or(within.map(|&(_, _, instead)| Suggestion::Write(instead)))
        .or(nowhere.map(|&(_, reason)| Suggestion::Absent(reason)))
}
