//! Separation of liquid from walls, obstacles and solids on the f64 path.

use cutwater::geometry::{CutCells, ObstacleCut};
use cutwater::grid::{Axis, Grid};
use cutwater::output::tables::{StepRow, StepTable};
use cutwater::reference::{
    Candidates, PressureSystem, Reference, RightHandSide, Separation, StepSystem, active_cells, extrapolate_one_sided,
    opening, touching_cells,
};
use cutwater::scene::{Scene, Solver};
use cutwater::sim::{Backend, Simulation, reference_path};
use cutwater::state::{SeparationReport, SolveStatus, State, StepReport};

use crate::common::Random;

pub(crate) const GRAVITY: f64 = 9.81;

pub(crate) fn scene(text: &str) -> Scene {
    Scene::parse("separation.toml".as_ref(), text, &[], 1.0).unwrap()
}

pub(crate) fn start(text: &str) -> Simulation {
    Simulation::new(&scene(text), &Backend::Cpu).unwrap()
}

pub(crate) fn separation(report: &StepReport) -> SeparationReport {
    let liquid = report.liquid.unwrap();
    assert_eq!(liquid.solve.status, SolveStatus::Converged, "{report:?}");
    liquid.separation.unwrap_or_default()
}

/// Runs to a time (s).
pub(crate) fn run_to(simulation: &mut Simulation, end: f64) {
    while simulation.clock().time < end {
        separation(&simulation.step().unwrap());
    }
}

/// A scene with cubic cells of `dx` (m), gravity along y, and the rest of its text from the keys of `[liquid]` on.
pub(crate) fn domain(cells: [usize; 3], dx: f64, gravity: f64, rest: &str) -> String {
    let size = cells.map(|n| n as f64 * dx);
    format!(
        "[domain]\nsize = {size:?}\ncells = {cells:?}\ngravity = [0, {gravity:?}, 0]\n\
         [time]\nduration = 2.0\nframes_per_second = 24\ncfl = 1.5\n[liquid]\n{rest}"
    )
}

/// Liquid in a box that spans the domain in z.
pub(crate) fn filled(size: [f64; 2]) -> String {
    let [x, y] = size;
    format!("[[liquid.region]]\nbox = {{ min = [0, 0, 0], max = [{x:?}, {y:?}, 100] }}\n")
}

/// Height of a dam before a low ceiling, m, and cells of it.
pub(crate) const DAM: (f64, usize) = (0.3, 16);

/// A dam breaks under a ceiling at 1.25 of its height.
pub(crate) fn ceiling(kind: &str) -> String {
    let (height, n) = DAM;
    let liquid = format!("separation = \"{kind}\"\nvolume_control = false\n");
    let cells = [3 * n, 5 * n / 4, 4];
    let region = filled([2.0 * height, height]);
    domain(cells, height / n as f64, -GRAVITY, &(liquid + &region))
}

/// Heights of the markers, m, ascending.
fn heights(state: &State) -> Vec<f64> {
    let mut heights: Vec<f64> = state.markers.iter().map(|x| x[1]).collect();
    heights.sort_by(f64::total_cmp);
    heights
}

/// The wave that runs back along the ceiling falls off it.
#[test]
fn water_falls_off_a_ceiling() {
    let (height, n) = DAM;
    let [without, walls, from_air] = ["none", "walls", "from_air"].map(|kind| {
        let mut simulation = start(&ceiling(kind));
        run_to(&mut simulation, 4.0 * (height / GRAVITY).sqrt());
        let top = 1.25 * height - height / n as f64;
        let heights = heights(&simulation.state().unwrap());
        heights.iter().filter(|&&y| y > top).count()
    });
    assert!(without > 0, "the wave reaches the ceiling");
    // Single drops may still be near the ceiling.
    assert!(without > 20 * walls.max(from_air), "markers in the top cells: {walls}, {from_air}, {without} without");
}

/// A plate with its lower side in water rises by 1.5 m/s; water has no reason to follow.
#[test]
fn a_lifted_plate_leaves_the_water() {
    let n = 32;
    let dx = 1.0 / n as f64;
    let gap = |kind: &str| {
        let plate = "[[obstacle]]\nbox = { min = [0.3, 0.37, -1], max = [0.7, 0.41, 1] }\n\
                     keyframes = [{ t = 0 }, { t = 0.4, translate = [0, 0.6, 0] }]\n";
        let liquid = format!("separation = \"{kind}\"\n{}{plate}", filled([1.0, 0.4]));
        let mut simulation = start(&domain([n, n, 4], dx, -GRAVITY, &liquid));
        run_to(&mut simulation, 0.2);
        let state = simulation.state().unwrap();
        let bottom = 0.37 + 1.5 * state.time;
        let under = |x: &&[f64; 3]| (x[0] - 0.5).abs() < 0.18 && x[1] < bottom;
        let under = state.markers.iter().filter(under);
        (bottom - under.map(|x| x[1]).fold(0.0, f64::max)) / dx
    };
    // The plate rose by ten cells. The water that refills the hollow of a cell below it splashes by a few cells.
    let [walls, from_air, without] = ["walls", "from_air", "none"].map(gap);
    assert!(walls > 5.0 && from_air > 5.0, "{walls} and {from_air} cells below the plate");
    assert!(without < 1.0, "{without} cells below the plate");
}

/// Speed of a cylinder that enters a pool, m/s, its radius and the level of the pool, m, and cells per metre.
const ENTRY: (f64, f64, f64, usize) = (3.0, 0.1, 0.6, 64);

/// Largest angle from its lowest point to which a cylinder is wet once it is below the level of the pool, and the least pressure until
/// then over rho V^2 / 2.
fn entry(kind: &str) -> (f64, f64) {
    let (speed, radius, level, n) = ENTRY;
    let (dx, start_y) = (1.0 / n as f64, level + radius + 0.02);
    let cylinder = format!(
        "[[obstacle]]\ncylinder = {{ base = [0.5, {start_y}, -1], axis = [0, 0, 1], radius = {radius}, height = 2 }}\n\
         keyframes = [{{ t = 0 }}, {{ t = 1, translate = [0, {}, 0] }}]\n",
        -speed
    );
    let liquid = format!("separation = \"{kind}\"\n{}{cylinder}", filled([1.0, level]));
    let mut simulation = start(&domain([n, 5 * n / 4, 2], dx, -GRAVITY, &liquid));
    let (mut wet, mut least) = (0.0_f64, 0.0_f64);
    while simulation.clock().time < 0.11 {
        separation(&simulation.step().unwrap());
        let state = simulation.state().unwrap();
        least = state.pressure.iter().fold(least, |least, &p| least.min(p));
        let centre = [0.5, start_y - speed * state.time];
        if centre[1] > level - radius {
            continue;
        }
        let offsets = state.markers.iter().map(|x| [x[0] - centre[0], x[1] - centre[1]]);
        let near = offsets.filter(|[x, y]| x.hypot(*y) < radius + 0.75 * dx);
        let mut angles: Vec<f64> = near.map(|[x, y]| x.abs().atan2(-y).to_degrees()).collect();
        angles.sort_by(f64::total_cmp);
        // Drops are further apart from the contact line than two cells.
        let apart = (2.0 * dx / radius).to_degrees();
        let gap = angles.windows(2).find(|pair| pair[1] - pair[0] > apart);
        wet = wet.max(gap.map_or(angles[angles.len() - 1], |pair| pair[0]));
    }
    (wet, least / (0.5 * 1000.0 * speed * speed))
}

/// Water leaves a cylinder at its sides, and hardly anything pulls at it.
#[test]
fn a_cylinder_that_enters_water_drags_a_cavity() {
    // The contact line is between markers half a cell apart.
    let between = (0.5 / (ENTRY.1 * ENTRY.3 as f64)).to_degrees();
    for kind in ["walls", "from_air"] {
        let (angle, least) = entry(kind);
        assert!((90.0..96.0 + between).contains(&angle), "{kind}: wet to {angle} degrees");
        assert!(least > -0.05, "{kind}: {least} rho V^2 / 2");
    }
    let (angle, least) = entry("none");
    assert!(angle > 107.0 && least < -1.0, "without: wet to {angle} degrees, {least} rho V^2 / 2");
}

/// In a box pulled down at 2 g gravity points upwards.
fn pulled_down(surface: &str, kind: &str, level: f64) -> String {
    let liquid = format!("surface = \"{surface}\"\nseparation = \"{kind}\"\n{}", filled([1.0, level]));
    domain([16, 16, 4], 1.0 / 16.0, GRAVITY, &liquid)
}

#[test]
fn water_in_a_box_pulled_down_leaves_the_floor() {
    for surface in ["level", "markers"] {
        let lowest = |kind: &str| {
            let mut simulation = start(&pulled_down(surface, kind, 0.5));
            run_to(&mut simulation, 0.25);
            let state = simulation.state().unwrap();
            // The lower side of the liquid in each column.
            let sides = (0..16 * 4).filter_map(|column| {
                let cell = |j: usize| column % 16 + 16 * (j + 16 * (column / 16));
                let j = (0..16).find(|&j| state.liquid_distance[cell(j)] < 0.0)?;
                Some((j as f64 + 0.5) / 16.0 + state.liquid_distance[cell(j)])
            });
            let sides: Vec<f64> = sides.collect();
            (sides.iter().sum::<f64>() / sides.len() as f64, state.time)
        };
        let (height, t) = lowest("walls");
        // A sub-step moves the surface before it accelerates it, which makes it late by half of it, at most of a frame.
        let (flight, late) = (0.5 * GRAVITY * t * t, 0.5 * GRAVITY * t / 24.0);
        let cell = 1.0 / 16.0;
        assert!(
            flight - late - cell < height && height < flight + cell,
            "{surface}: {height} m after {t} s, in free flight {flight} m"
        );
        // Air comes in along the sides.
        let (height, _) = lowest("from_air");
        assert!(height > 0.5 * flight, "{surface}, from_air: {height} m above the floor");
        let (height, _) = lowest("none");
        assert!(height < cell, "{surface}, none: {height} m above the floor");
    }
}

/// Water without a free surface cannot open: its pressure has no level, and its least one is 0.
#[test]
fn a_full_box_pulled_down_stays_full() {
    for surface in ["level", "markers"] {
        let mut simulation = start(&pulled_down(surface, "walls", 1.0));
        for _ in 0..3 {
            let report = simulation.step().unwrap();
            assert_eq!(separation(&report).cells, 0);
            let state = simulation.state().unwrap();
            let (least, most) =
                (state.pressure.iter()).fold((f64::MAX, 0.0_f64), |(least, most), &p| (least.min(p), most.max(p)));
            assert_eq!(least, 0.0);
            // The weight of 15 cells between the centres of the lowest and the highest one.
            let weight = 1000.0 * GRAVITY * 15.0 / 16.0;
            assert!((most - weight).abs() < 1e-6 * weight, "{surface}: {most} Pa");
            let speed = report.liquid.unwrap().diagnosis.max_speed;
            assert!(speed < 1e-6, "{surface}: {speed} m/s");
        }
    }
}

/// A surface that leaves the floor, while it is within a few tenths of a cell of it: the level in the lowest cells is the distance that the liquid has
/// moved, less half a cell, although there is no cell below them, and also at the sides, along which the water falls. Without volume control, which counts
/// these cells as full until then.
#[test]
fn the_level_follows_liquid_that_leaves_the_floor() {
    let scene = pulled_down("level", "walls", 0.5).replace("[liquid]", "[liquid]\nvolume_control = false");
    let scene = scene.replace("[time]", "[time]\nfixed_step = 0.005208333333333333");
    let mut simulation = start(&scene);
    let (dx, dt) = (1.0 / 16.0, 1.0 / 192.0);
    // The surface moves with the velocity of the sub-step before: 0, g dt, 2 g dt and so on.
    let mut way = 0.0;
    for step in 0..14_u32 {
        way += f64::from(step) * GRAVITY * dt * dt;
        simulation.step().unwrap();
        let level = simulation.state().unwrap().liquid_distance;
        if step < 2 {
            continue;
        }
        for (k, i) in (0..4).flat_map(|k| (0..16).map(move |i| (k, i))) {
            let phi = level[i + 16 * 16 * k] / dx;
            assert!((phi + 0.5 - way / dx).abs() < 0.05, "step {step}: {phi} cells, way {} cells", way / dx);
        }
    }
    assert!(way > 0.35 * dx, "{way}");
}

/// A full tank of 0.75 m by 1 m, and a piston that recedes along x at this speed (m/s): an obstacle, or a solid of prescribed nodes.
pub(crate) fn piston(kind: &str, solid: bool) -> (String, f64) {
    let (n, speed) = (16, 0.5);
    let piston = match solid {
        false => "[[obstacle]]\nbox = { min = [0.75, -1, -1], max = [2, 2, 1] }\n",
        true => {
            "[[solid]]\nname = \"piston\"\nmesh = { box = { size = [0.125, 1, 0.25], cells = [1, 4, 1] } }\n\
             placement = { translate = [0.8125, 0.5, 0.125] }\ndensity = 900\nyoung = 1e5\npoisson = 0.3\n\
             [[solid.script]]\nregion = { box = { min = [-9, -9, -9], max = [9, 9, 9] } }\n"
        }
    };
    let keyframes = format!("keyframes = [{{ t = 0 }}, {{ t = 1, translate = [{speed}, 0, 0] }}]\n");
    let region = filled([0.8125, 1.0]);
    let liquid = format!("separation = \"{kind}\"\nvolume_control = false\n{region}{piston}{keyframes}");
    (domain([n, n, 4], 1.0 / n as f64, -GRAVITY, &liquid), speed)
}

/// A piston that makes a full tank larger opens exactly the room that it leaves.
#[test]
fn a_full_tank_opens_where_a_piston_recedes() {
    for (kind, solid) in [("walls", false), ("from_air", false), ("walls", true), ("from_air", true)] {
        let (text, speed) = piston(kind, solid);
        let mut simulation = start(&text);
        let report = simulation.step().unwrap();
        let separation = separation(&report);
        let room = speed * report.dt * 0.25;
        assert!(
            (separation.opened - room).abs() < 1e-6 * room,
            "{kind}: opened {} m^3 of {room} m^3",
            separation.opened
        );
        assert!(separation.cells > 0);
        // At walls; between them water may pull at water.
        let pressure = simulation.state().unwrap().pressure;
        let floor = pressure.chunks(16 * 16).flat_map(|layer| &layer[..16]);
        let least = floor.fold(f64::MAX, |least, &p| least.min(p));
        assert!(least >= -1e-6 * pressure.iter().fold(0.0, |most: f64, &p| most.max(p)), "{kind}: {least} Pa");
    }
}

#[test]
fn pools_at_rest_stay_at_the_walls() {
    let dx = 1.0 / 20.0;
    let tilted = |centre: [f64; 2], half: [f64; 2], degrees: f64| {
        let ([x, y], [a, b]) = (centre, half);
        format!(
            "[[obstacle]]\nbox = {{ min = [{}, {}, -1], max = [{a}, {b}, 1] }}\n\
             placement = {{ translate = [{x}, {y}, 0], rotate = {{ axis = [0, 0, 1], degrees = {degrees} }} }}\n",
            -a, -b
        )
    };
    let part = |x: [f64; 2], y: [f64; 2]| {
        let ([x0, x1], [y0, y1]) = (x, y);
        format!("[[obstacle]]\nbox = {{ min = [{x0}, {y0}, -1], max = [{x1}, {y1}, 1] }}\n")
    };
    let cup = part([0.3, 0.36], [0.2, 0.42]) + &part([0.64, 0.7], [0.2, 0.42]) + &part([0.3, 0.7], [0.34, 0.42]);
    for (name, obstacles) in [
        ("flat", String::new()),
        ("tilted block", tilted([0.5, 0.25], [0.2, 0.1], 17.0)),
        // Below the water: where a slope this shallow leaves it, films of less than a cell have pressures of either sign.
        ("overhang", tilted([0.85, 0.25], [0.3, 0.05], 12.0)),
        ("inverted cup", cup),
    ] {
        for kind in ["walls", "from_air"] {
            let liquid = format!("separation = \"{kind}\"\n{}{obstacles}", filled([1.0, 0.5]));
            let mut simulation = start(&domain([20, 20, 4], dx, -GRAVITY, &liquid));
            for step in 0..100 {
                let report = separation(&simulation.step().unwrap());
                assert_eq!((report.cells, report.rounds), (0, 1), "{name}, {kind}, step {step}");
                assert!(report.least_pressure > 0.0, "{name}, {kind}, step {step}: {report:?}");
            }
        }
    }
}

/// Net flux out of a cell, m^3/s.
fn outflow(grid: &Grid, cut: &CutCells, state: &State, cell: usize) -> f64 {
    let fluxes = Axis::ALL.map(|axis| {
        let a = axis.index();
        let here = grid.cell_at(cell);
        let mut next = here;
        next[a] += 1;
        let [minus, plus] = [here, next].map(|at| {
            let face = grid.face(axis, at);
            cut.open[a][face] * state.velocity[a][face]
        });
        plus - minus
    });
    grid.dx * grid.dx * fluxes.iter().sum::<f64>()
}

/// The result of a sub-step, with the largest speed and acceleration before it.
pub(crate) struct Solved<'a> {
    pub(crate) scene: &'a Scene,
    pub(crate) cut: &'a CutCells,
    /// J v, m^3/s per cell; empty without bodies in motion.
    pub(crate) flux: Vec<f64>,
    pub(crate) touching: Vec<bool>,
    pub(crate) state: &'a State,
    /// Largest speed before the sub-step, m/s.
    pub(crate) speed_before: f64,
    /// Rounding unit of velocities and pressures.
    pub(crate) unit: f64,
}

/// Largest speed of liquid and nodes, m/s.
pub(crate) fn speed(state: &State) -> f64 {
    let nodes = state.node_velocity.as_flattened();
    let all = state.velocity.iter().flatten().chain(nodes);
    all.fold(0.0, |max: f64, u| max.max(u.abs()))
}

/// 0 <= p, 0 <= w, p w = 0 beside walls and bodies, w = 0 elsewhere, with w from the faces and nodes after a sub-step. Returns
/// the separated cells.
pub(crate) fn assert_complementary(solved: &Solved) -> usize {
    let Solved { state, cut, touching, .. } = solved;
    let (grid, tolerance) = (solved.scene.grid(), solved.scene.solver.tolerance);
    let largest = state.pressure.iter().fold(0.0, |max: f64, p| max.max(p.abs()));
    // |E u*| and |J v| of a cell: six faces, and as much area of bodies, at the largest speed. The residual of all cells is at
    // most the tolerance times the root of their number times that. Twelve fluxes are rounded.
    let speed = solved.speed_before.max(speed(state)) + GRAVITY * state.dt_last;
    let scale = 12.0 * grid.dx * grid.dx * speed;
    let n_active = state.active.iter().filter(|active| **active).count() as f64;
    let rounding = 2.0 * solved.unit * scale;
    let mut n_separated = 0;
    for cell in (0..grid.n_cells()).filter(|&cell| state.active[cell]) {
        let flux = solved.flux.get(cell).copied().unwrap_or_default();
        let (p, w) = (state.pressure[cell], outflow(&grid, cut, state, cell) + flux);
        if state.separated[cell] {
            assert!(touching[cell] && p == 0.0, "cell {cell}: {p} Pa");
            let bound = 2.0 * tolerance * scale + rounding;
            assert!(w >= -bound, "cell {cell} closes by {w} m^3/s, allowed {bound}");
            n_separated += 1;
        } else {
            let bound = tolerance * n_active.sqrt() * scale + rounding;
            assert!(w.abs() <= bound, "cell {cell} opens by {w} m^3/s, allowed {bound}");
            assert!(!touching[cell] || p >= -2e-6 * largest, "cell {cell}: {p} Pa");
        }
    }
    n_separated
}

/// A sub-step of the f64 path. Returns the separated cells.
fn complementary_step(reference: &mut Reference) -> usize {
    let speed_before = speed(reference.state());
    let mut solved = 0;
    let report = reference.step_observed(reference.next_time_step(), &mut |system| {
        solved += usize::from(!matches!(system, StepSystem::Solid(..)));
    });
    separation(&report.unwrap());
    assert_eq!(solved, 1);
    let (state, cut, grid) = (reference.state(), reference.cut_cells(), reference.scene().grid());
    let mut flux = Vec::new();
    if let Some(clip) = reference.clip() {
        flux = vec![0.0; grid.n_cells()];
        let nodes = state.node_velocity.as_flattened();
        clip.coupling().add_product(nodes, &mut flux);
    }
    assert_complementary(&Solved {
        scene: reference.scene(),
        cut,
        flux,
        touching: touching_cells(&grid, &cut.open, reference.clip()),
        state,
        speed_before,
        unit: 0.0,
    })
}

#[test]
fn pressures_and_openings_are_complementary() {
    let (height, _) = DAM;
    let mut reference = reference_path(&scene(&ceiling("walls"))).unwrap();
    while reference.state().time < 2.2 * (height / GRAVITY).sqrt() {
        reference.step(reference.next_time_step()).unwrap();
    }
    let separated: usize = (0..12).map(|_| complementary_step(&mut reference)).sum();
    assert!(separated > 0, "the case has separated cells");
}

/// A rubber block that a script of its upper side pulls out of the water.
pub(crate) fn pulled_block() -> String {
    let block = "[[solid]]\nname = \"block\"\nmesh = { box = { size = [0.4, 0.3, 0.2], cells = [4, 3, 1] } }\n\
                 placement = { translate = [0.5, 0.52, 0.125] }\ndensity = 900\nyoung = 1e5\npoisson = 0.3\n\
                 [[solid.script]]\nregion = { box = { min = [0, 0.6, -1], max = [1, 1, 1] } }\n\
                 keyframes = [{ t = 0 }, { t = 1, translate = [0, 2, 0] }]\n";
    let liquid = "separation = \"walls\"\nvolume_control = false\n".to_owned();
    let text = liquid + &filled([1.0, 0.5]) + block;
    domain([16, 20, 4], 1.0 / 16.0, -GRAVITY, &text)
}

#[test]
fn pressures_beside_elastic_solids_are_complementary() {
    let mut reference = reference_path(&scene(&pulled_block())).unwrap();
    let separated: usize = (0..10).map(|_| complementary_step(&mut reference)).sum();
    assert!(separated > 0, "the block leaves the water");
}

/// A block of 1 kg/m^3 falls on a pool, which throws it up: in the sub-step in which the water lets go of it, what separates does not push it by
/// the variation of its pressure. In the one before that is 12 N.
#[test]
fn separated_cells_do_not_push_solids() {
    let block = "[[solid]]\nname = \"block\"\nmesh = { box = { size = [0.25, 0.25, 0.25], cells = [3, 3, 3] } }\n\
                 placement = { translate = [0.47, 0.42, 0.52] }\ndensity = 1\nyoung = 1e6\npoisson = 0.3\n";
    let text = filled([1.0, 0.4]) + block;
    let mut reference = reference_path(&scene(&domain([16; 3], 1.0 / 16.0, -GRAVITY, &text))).unwrap();
    let mut before = 0.0;
    for _ in 0..6 {
        let report = reference.step(reference.next_time_step()).unwrap();
        let correction = report.coupling.unwrap().correction[1];
        if separation(&report).cells > 0 {
            assert!(before < -10.0 && correction.abs() < 1.0, "{before} N, then {correction} N");
            return;
        }
        before = correction;
    }
    panic!("nothing separates");
}

#[test]
fn a_run_resumes_with_its_separated_cells() {
    let mut whole = reference_path(&scene(&pulled_down("level", "from_air", 0.5))).unwrap();
    let mut resumed = whole.clone();
    for _ in 0..4 {
        whole.step(whole.next_time_step()).unwrap();
    }
    assert!(whole.state().separated.contains(&true));
    resumed.reset(whole.state().clone()).unwrap();
    for reference in [&mut whole, &mut resumed] {
        reference.step(reference.next_time_step()).unwrap();
    }
    assert_eq!(whole.state(), resumed.state());
}

/// The active set against projected Gauss-Seidel iterations, on random liquid in a box.
#[test]
fn the_active_set_solves_the_complementarity_problem() {
    let grid = Grid { cells: [7, 6, 5], dx: 0.1 };
    let open = ObstacleCut::none(&grid).cut.open;
    let touching = touching_cells(&grid, &open, None);
    let mut random = Random(7);
    for case in 0..20 {
        // Air above, and holes.
        let phi: Vec<f64> = (0..grid.n_cells())
            .map(|cell| match grid.cell_at(cell)[1] == 5 || random.uniform(0.0, 1.0) < 0.1 {
                true => 0.02 + 0.08 * random.uniform(0.0, 1.0),
                false => -0.02 - 0.08 * random.uniform(0.0, 1.0),
            })
            .collect();
        let active = active_cells(&grid, &open, &phi, 0.15);
        let values = (0..grid.n_cells()).map(|cell| match active.stencil.active(cell) {
            true => random.uniform(0.0, 1.0) - 0.6,
            false => 0.0,
        });
        let rhs = RightHandSide { values: values.collect(), scale: 1.0 };
        let system = PressureSystem::new(active, rhs, 0.01, 1000.0);
        let candidates = Candidates { touching: &touching, from_air: None, before: &[] };
        let mut separation = Separation::new(&system, candidates, &[]);
        let (pressure, report) = separation.solve(&system, &Solver::default()).unwrap();
        let report = separation.flagged(report);
        assert_eq!(report.status, SolveStatus::Converged, "case {case}");
        let stencil = &system.stencil;
        let mut exact = vec![0.0_f64; grid.n_cells()];
        for _ in 0..4000 {
            for cell in stencil.active_cells() {
                let sides = stencil.neighbours(cell);
                let others: f64 = sides.iter().map(|&(at, weight)| weight * exact[at]).sum();
                let value = (system.rhs[cell] / system.scale + others) / stencil.diagonal[cell];
                exact[cell] = match separation.candidates()[cell] {
                    true => value.max(0.0),
                    false => value,
                };
            }
        }
        let largest = exact.iter().fold(0.0, |max: f64, p| max.max(p.abs()));
        for (cell, (p, exact)) in pressure.iter().zip(&exact).enumerate() {
            // The set may leave pressures of a millionth of the largest one below 0.
            assert!((p - exact).abs() <= 1e-5 * largest, "case {case}, cell {cell}: {p}, {exact}");
        }
        let w = opening(&system, &pressure, &[]);
        let separated = separation.cells().iter().filter(|cell| **cell).count();
        let opened = separation.report(1.0).opened;
        assert!(separated > 0 && opened > 0.0, "case {case}");
        assert!((w.iter().sum::<f64>() - opened).abs() < 1e-6 * opened, "case {case}");
    }
}

#[test]
fn closed_faces_keep_velocities_away_from_walls_that_liquid_leaves() {
    let grid = Grid { cells: [4, 4, 4], dx: 0.25 };
    let cut = ObstacleCut::none(&grid).cut;
    let [top, bottom] = [[1, 4, 1], [1, 0, 1]].map(|at| grid.face(Axis::Y, at));
    for (velocity, hold, expected) in
        [(-1.0, false, [-1.0, 0.0]), (1.0, false, [0.0, 1.0]), (-1.0, true, [0.0, 0.0]), (1.0, true, [0.0, 0.0])]
    {
        let valid = cut.open.clone().map(|open| open.iter().map(|&open| open > 0.0).collect());
        let mut faces = Axis::ALL.map(|axis| vec![0.0; grid.n_faces(axis)]);
        let inner = faces[1].iter_mut().zip(&cut.open[1]);
        inner.filter(|(_, open)| **open > 0.0).for_each(|(u, _)| *u = velocity);
        let held = vec![hold; grid.n_cells()];
        let walls = (None, Some(&*held));
        extrapolate_one_sided(&grid, &cut, walls, valid, (3, 0.0), &mut faces);
        assert_eq!([faces[1][top], faces[1][bottom]], expected, "{velocity} {hold}");
    }
}

#[test]
fn steps_have_columns_of_separation() {
    let mut simulation = start(&pulled_down("level", "walls", 0.5));
    let report = simulation.step().unwrap();
    let run = tempfile::tempdir().unwrap();
    let mut table = StepTable::create(run.path()).unwrap();
    let row = StepRow { step: 0, time: report.dt, report: &report, volume_ratio: simulation.volume_ratio(&report) };
    table.push(&row).unwrap();
    table.flush().unwrap();
    let mut reader = csv::Reader::from_path(run.path().join("steps.csv")).unwrap();
    let head = reader.headers().unwrap().clone();
    let row = reader.records().next().unwrap().unwrap();
    let first = head.iter().position(|name| name == "separated_cells").unwrap();
    let names = ["separated_cells", "returned_cells", "separation_rounds", "least_pressure", "opened_volume"];
    assert!(head.iter().skip(first).take(5).eq(names));
    let written: Vec<f64> = (first..first + 5).map(|at| row[at].parse().unwrap()).collect();
    let separation = separation(&report);
    let counts = [separation.cells as f64, separation.returned as f64, f64::from(separation.rounds)];
    assert_eq!(written[..3], counts);
    assert_eq!(written[3..], [separation.least_pressure, separation.opened]);
    assert!(separation.cells > 0);
}
