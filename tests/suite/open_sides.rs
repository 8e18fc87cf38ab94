//! Open sides of the domain: what they let out, what they do not, and what they cost.

use std::path::Path;

use cutwater::Error;
use cutwater::geometry::{initial_state, obstacle_cut};
use cutwater::grid::{Axis, Grid, Sides};
use cutwater::reference::{
    Ballistic, Lost, PressureSystem, active_cells, advect_markers, divergence, right_hand_side, solve, volume_without,
    write_back,
};
use cutwater::scene::{Scene, Solver};
use cutwater::sim::{Plan, Simulation, reference_path};
use cutwater::state::{SolveStatus, State};

use crate::common::{far_below, gpu, on_gpu, surface};

const GRAVITY: f64 = 9.81;

/// A scene of cubes with `cells` along x, 1 m wide.
fn parse(cells: [usize; 3], open: &str, rest: &str) -> Result<Scene, Error> {
    let size = cells.map(|n| n as f64 / cells[0] as f64);
    let text = format!(
        "[domain]\nsize = {size:?}\ncells = {cells:?}\nopen = {open}\n\
         [time]\nduration = 1.0\nframes_per_second = 24\n{rest}"
    );
    Scene::parse(Path::new("test.toml"), &text, &[], 1.0)
}

fn scene(cells: [usize; 3], open: &str, rest: &str) -> Scene {
    parse(cells, open, rest).unwrap()
}

/// Sub-steps up to a frame; `each` hears of the state of the simulation after every one.
fn run(simulation: &mut Simulation, frame: u64, mut each: impl FnMut(&cutwater::state::StepReport)) {
    while simulation.clock().frame < frame {
        let report = simulation.step().unwrap();
        let status = report.liquid.unwrap().solve.status;
        assert_eq!(status, SolveStatus::Converged, "{report:?}");
        each(&report);
    }
}

#[test]
fn what_is_no_set_of_sides_is_refused() {
    let liquid = "[[liquid.region]]\nhalf_space = { point = [0.0, 0.5, 0.0], normal = [0.0, 1.0, 0.0] }\n";
    let fixed = format!("[liquid]\nsurface = \"fixed\"\n{liquid}");
    let solid = "[[solid]]\nname = \"a\"\nmesh = { box = { size = [0.1, 0.1, 0.1], cells = [1, 1, 1] } }\n\
                 placement = { translate = [0.5, 0.5, 0.5] }\ndensity = 1000.0\nyoung = 1e5\npoisson = 0.3\n";
    for (open, rest, line, key, cure) in [
        ("[\"left\"]", liquid, 4, "domain.open[0]", "\"-x\""),
        ("[\"+x\", \"+w\"]", liquid, 4, "domain.open[1]", "\"+z\""),
        ("[\"+x\", \"-y\", \"+x\"]", liquid, 4, "domain.open[2]", "remove it"),
        ("\"+x\"", liquid, 4, "domain.open", "write a list, such as [\"+x\"]"),
        ("[1]", liquid, 4, "domain.open[0]", "\"-x\""),
        ("[\"+x\"]", solid, 4, "domain.open", "[liquid]"),
        ("[\"+x\"]", fixed.as_str(), 9, "liquid.surface", "remove the line"),
    ] {
        let refused = parse([8, 8, 8], open, rest).unwrap_err();
        let text = refused.to_string();
        let place = format!("test.toml:{line}");
        assert!([place.as_str(), key, cure].iter().all(|part| text.contains(part)), "{open}: {text}");
        assert_eq!(refused.exit_code(), 2, "{open}");
    }
    // None is a closed domain, and may be written.
    assert!(!scene([8, 8, 8], "[]", liquid).domain.open.any());
}

#[test]
fn sides_are_what_their_names_say() {
    let open = scene(
        [4, 4, 4],
        "[\"+z\", \"-x\"]",
        "[[liquid.region]]\nsphere = { centre = [0.5, 0.5, 0.5], radius = 0.4 }\n",
    );
    let sides = open.domain.open;
    assert_eq!(sides, Sides::default().with(Axis::X, 0).with(Axis::Z, 1));
    assert_eq!(sides.names().collect::<Vec<_>>(), ["-x", "+z"]);
    assert_eq!(sides.bits(), 0b10_0001);
    let grid = open.grid();
    let cut = obstacle_cut(&open, &grid).unwrap().cut;
    for axis in Axis::ALL {
        for (face, &fraction) in cut.open[axis.index()].iter().enumerate() {
            let side = grid.wall(axis, grid.face_at(axis, face));
            let expected = side.is_none_or(|side| sides.has(axis, side));
            assert_eq!(fraction, f64::from(u8::from(expected)), "{axis:?} {face}");
        }
    }
}

/// A box that is full to its open top: p = rho g (H - y), exactly, and nothing moves. It is not closed.
#[test]
fn a_full_tank_with_an_open_top_rests() {
    let top = scene(
        [5, 4, 3],
        "[\"+y\"]",
        "[[liquid.region]]\nhalf_space = { point = [0.0, 9.0, 0.0], normal = [0.0, 1.0, 0.0] }\n",
    );
    let grid = top.grid();
    let cut = obstacle_cut(&top, &grid).unwrap().cut;
    let (dt, density) = (0.01, 1000.0);
    let phi = vec![-grid.dx; grid.n_cells()];
    let active = active_cells(&grid, &cut.open, &phi, 0.15);
    assert!(active.closed.is_empty());
    let mut u = State::at_rest(&grid).velocity;
    u[1].iter_mut().for_each(|v| *v = -dt * GRAVITY);
    let rhs = right_hand_side(&grid, &cut.open, &u, &active, None);
    let system = PressureSystem::new(active, rhs, dt, density);
    let (pressure, _) = solve(&system, &Solver { tolerance: 1e-13, ..Solver::default() }).unwrap();
    let height = grid.size().y;
    for (cell, p) in pressure.iter().enumerate() {
        let exact = density * GRAVITY * (height - grid.cell_centre(grid.cell_at(cell)).y);
        assert!((p - exact).abs() < 1e-9 * density * GRAVITY, "{p} for {exact}");
    }
    let valid = write_back(&system, &pressure, &cut.open, &phi, 0.15, &mut u);
    let on_top = grid.face(Axis::Y, [2, 4, 1]);
    assert!(valid[1][on_top] && !valid[1][grid.face(Axis::Y, [2, 0, 1])]);
    for (face, v) in u[1].iter().enumerate() {
        assert!(!valid[1][face] || v.abs() < 1e-13, "{v} at {face}");
    }
    let left = divergence(&cut.open, &u, &system.stencil, None);
    assert!(left < 1e-11, "{left}");
}

/// Between two open sides nothing holds the liquid back: it falls freely.
#[test]
fn liquid_between_open_sides_falls_freely() {
    let shaft = scene(
        [6, 5, 2],
        "[\"-y\", \"+y\"]",
        "[[liquid.region]]\nhalf_space = { point = [0.0, 9.0, 0.0], normal = [0.0, 1.0, 0.0] }\n",
    );
    let mut reference = reference_path(&shaft).unwrap();
    let before = reference.state().markers.len();
    let report = reference.step(reference.next_time_step()).unwrap();
    let liquid = report.liquid.unwrap();
    assert_eq!(liquid.closed_components, 0);
    let fallen = -GRAVITY * report.dt;
    for v in &reference.state().velocity[1] {
        assert!((v - fallen).abs() < 1e-9, "{v} for {fallen}");
    }
    assert_eq!(liquid.markers, before, "nothing has left before it moved");
}

#[test]
fn markers_leave_through_open_sides_alone() {
    let grid = Grid { cells: [4, 4, 4], dx: 0.25 };
    let far = vec![3.0 * grid.dx; grid.n_cells()];
    let mut faces = State::at_rest(&grid).velocity;
    faces[0].iter_mut().for_each(|u| *u = 1.0);
    let markers = [[0.95, 0.5, 0.5], [0.5, 0.5, 0.5], [0.85, 0.2, 0.2]];
    let deep = far_below(&grid);
    let surface = surface(&grid, &deep);
    let moved = |sides| advect_markers(&grid, sides, &faces, &far, &surface, &Ballistic::NONE, &markers, 0.1);
    let (kept, lost) = moved(Sides::default().with(Axis::X, 1));
    assert_eq!(lost, Lost { dropped: 0, left: 1 });
    assert_eq!(kept.len(), 2);
    assert!((kept[0][0] - 0.6).abs() < 1e-12 && (kept[1][0] - 0.95).abs() < 1e-12);
    // The wall holds them, whatever other sides do.
    let (kept, lost) = moved(Sides::default().with(Axis::X, 0).with(Axis::Y, 1));
    assert_eq!(lost, Lost::default());
    assert!((kept[0][0] - (1.0 - 0.01 * grid.dx)).abs() < 1e-12);
}

#[test]
fn what_leaves_takes_its_share_of_the_volume() {
    assert_eq!(volume_without(0.3, 0, 17), 0.3);
    assert_eq!(volume_without(0.3, 0, 0), 0.3);
    assert!((volume_without(0.3, 25, 75) - 0.225).abs() < 1e-16);
    assert_eq!(volume_without(0.3, 8, 0), 0.0);
}

/// A slot at the bottom of a plate beside an open side.
fn tank(volume_control: bool) -> Scene {
    let dx = 1.0 / 40.0;
    let (plate, slot) = (1.0 - 3.0 * dx, 3.0 * dx);
    scene(
        [40, 32, 2],
        "[\"+x\"]",
        &format!(
            "[liquid]\nvolume_control = {volume_control}\n\
             [[liquid.region]]\nbox = {{ min = [0.0, 0.0, 0.0], max = [{plate}, 0.6, 1.0] }}\n\
             [[obstacle]]\nbox = {{ min = [{plate}, {slot}, 0.0], max = [1.0, 0.8, 1.0] }}\n\
             [[probe]]\nname = \"level\"\nheight = {{ x = 0.3125, z = 0.0125 }}\n"
        ),
    )
}

/// Torricelli: what leaves flows at sqrt(2 g h) through the slot, h the height above its middle, so A dh/dt = - a C sqrt(2 g h). C is 1 without
/// contraction, and pi / (pi + 2) = 0.61 for the free jet below a sharp edge (Kirchhoff): the coefficient lies between, as three cells resolve the
/// edge badly. The first quarter of a second, in which the flow begins, is left out.
#[test]
fn a_tank_runs_dry_as_torricelli_says() {
    let Some(_) = gpu() else { return };
    let (area, slot) = (1.0 - 3.0 / 40.0, 3.0 / 40.0);
    let ended = [true, false].map(|control| {
        let scene = tank(control);
        let mut simulation = on_gpu(&scene);
        let (mut left, mut held) = (0.0, [f64::INFINITY, 0.0_f64]);
        let mut each = |report: &cutwater::state::StepReport| {
            let liquid = report.liquid.unwrap();
            left += liquid.exchange.unwrap().volume_left;
            let sum = liquid.diagnosis.volume + left;
            held = [held[0].min(sum), held[1].max(sum)];
        };
        run(&mut simulation, 6, &mut each);
        let start = simulation.probes().unwrap()[0] - 0.5 * slot;
        run(&mut simulation, 21, &mut each);
        let end = simulation.probes().unwrap()[0] - 0.5 * slot;
        let state = simulation.state().unwrap();
        let whole = state.volume_0 + left;
        // sqrt(h) falls in proportion to time.
        let theory = (start.sqrt() - slot / area * (GRAVITY / 2.0).sqrt() * 15.0 / 24.0).powi(2);
        let fall = (start - end) / (start - theory);
        println!("control {control}: level {start:.4} to {end:.4}, theory {theory:.4}: {fall:.3}; held {:.4} to {:.4}, left {:.3}",
            held[0] / whole, held[1] / whole, left / whole);
        let contracted = std::f64::consts::PI / (std::f64::consts::PI + 2.0);
        assert!((contracted..=1.0).contains(&fall), "the level fell {fall} of what it should");
        assert!(state.markers_left > 0 && left > 0.2 * whole, "{left} of {whole} m^3 left");
        if control {
            let held = held.map(|sum| sum / whole);
            assert!(held[0] > 0.98 && held[1] < 1.02, "volume and what left: {held:?}");
        }
        end
    });
    // Volume control neither fills the tank up nor drains it.
    assert!((ended[0] - ended[1]).abs() < 0.02, "{ended:?}");
}

/// Down to the last marker, and on without any.
#[test]
fn a_domain_without_a_floor_runs_empty() {
    let Some(_) = gpu() else { return };
    let scene =
        scene([12, 16, 5], "[\"-y\"]", "[[liquid.region]]\nbox = { min = [0.25, 0.5, 0.1], max = [0.75, 1.0, 0.3] }\n");
    let mut simulation = on_gpu(&scene);
    let start = simulation.state().unwrap();
    let mut left = 0;
    run(&mut simulation, 18, |report| {
        let liquid = report.liquid.unwrap();
        left += liquid.exchange.unwrap().left;
        assert_eq!(liquid.markers as u64 + left, start.markers.len() as u64);
        assert!(liquid.diagnosis.max_speed < 6.0, "{report:?}");
    });
    let state = simulation.state().unwrap();
    assert_eq!((state.markers.len(), state.volume_0), (0, 0.0));
    assert_eq!((state.markers_left, state.markers_dropped), (start.markers.len() as u64, 0));
    run(&mut simulation, 20, |report| {
        let liquid = report.liquid.unwrap();
        assert_eq!((liquid.solve.unknowns, liquid.diagnosis.volume), (0, 0.0));
    });
}

/// Liquid that gravity pulls away from the open side it fills: air comes in behind it, and no more energy than between walls, where the
/// bumps of its surface bring some too.
#[test]
fn what_is_sucked_in_brings_no_energy() {
    let Some(_) = gpu() else { return };
    let mass = 1000.0 * 0.5 * 0.35 * 0.5;
    let gains = ["[]", "[\"-x\"]"].map(|open| {
        let text = format!(
            "[domain]\nsize = [1.0, 0.5, 0.5]\ncells = [24, 12, 12]\ngravity = [6.0, -2.0, 0.0]\nopen = {open}\n\
             [time]\nduration = 1.0\n[liquid]\nsurface = \"markers\"\n[[liquid.region]]\n\
             box = {{ min = [0.0, 0.0, 0.0], max = [0.5, 0.35, 0.5] }}\nvelocity = [0.5, 0.0, 0.0]\n"
        );
        let scene = Scene::parse(Path::new("test.toml"), &text, &[], 1.0).unwrap();
        let mut simulation = on_gpu(&scene);
        let n_markers = simulation.state().unwrap().markers.len();
        let (mut first, mut gain) = (None, 0.0_f64);
        run(&mut simulation, 24, |report| {
            let of = report.liquid.unwrap().diagnosis;
            let energy = of.kinetic_energy + of.potential_energy;
            gain = gain.max(energy - *first.get_or_insert(energy));
            assert!(of.max_speed < 10.0, "{report:?}");
        });
        let state = simulation.state().unwrap();
        // What sloshes back may leave; most is at the far wall.
        let left = state.markers.len();
        assert!(10 * left > 8 * n_markers, "{left} of {n_markers}");
        let mean = state.markers.iter().map(|x| x[0]).sum::<f64>() / left as f64;
        assert!(mean > 0.5, "mean x {mean}");
        gain
    });
    // J; of what gravity does to all of it over half a metre. The surface that comes off the open side lies half a cell, of 12, above
    // the outermost markers.
    let fallen = mass * 6.0 * 0.5;
    println!("energy gained between walls and with an open side: {gains:?} of {fallen} J");
    assert!(gains[1] < gains[0] + 0.5 / 12.0 * fallen, "{gains:?} of {fallen} J");
}

#[test]
fn runs_with_open_sides_repeat_and_go_on_from_a_state() {
    let Some(_) = gpu() else { return };
    let scene = tank(true);
    let mut simulation = on_gpu(&scene);
    let start = simulation.state().unwrap();
    run(&mut simulation, 9, |_| {});
    let third = simulation.state().unwrap();
    assert!(third.markers_left > 0);
    run(&mut simulation, 12, |_| {});
    let end = simulation.state().unwrap();
    for (from, what) in [(&start, "again"), (&third, "on from half the way")] {
        simulation.reset(from).unwrap();
        assert!(simulation.state().unwrap().markers == from.markers, "{what}: as it was put");
        run(&mut simulation, 12, |_| {});
        assert!(simulation.state().unwrap() == end, "{what}");
    }
}

/// The effect adds no kernel and no buffer to a scene: 32 bytes to the report that is there.
#[test]
fn open_sides_allocate_and_compile_nothing() {
    let plan = |open: &str| {
        let rest = "[liquid]\nsurface = \"markers\"\n[[liquid.region]]\nbox = { min = [0.0, 0.0, 0.0], max = [0.5, 0.5, 1.0] }\n";
        Plan::new(&scene([40, 32, 2], open, rest), None).unwrap()
    };
    let [closed, open] = ["[]", "[\"+x\"]"].map(plan);
    assert_eq!(closed.stages, open.stages);
    for (without, with) in closed.buffers.iter().zip(&open.buffers) {
        let more = if with.label.starts_with("liquid.report") { 32 } else { 0 };
        assert_eq!((&without.label, without.bytes() + more), (&with.label, with.bytes()));
    }
    assert_eq!(closed.buffers.len(), open.buffers.len());
    for (plan, present) in [(closed, false), (open, true)] {
        let mut lines = plan.effects.iter();
        let line = lines.find(|line| line.name == "open_sides").unwrap();
        assert_eq!(line.active, present, "{}", line.reason);
    }
}

/// Where both paths start from one state, initial velocities reach the faces of open sides.
#[test]
fn liquid_that_starts_on_its_way_out_goes_on() {
    let scene = scene(
        [8, 8, 8],
        "[\"+x\"]",
        "[[liquid.region]]\nbox = { min = [0.5, 0.25, 0.25], max = [1.0, 0.75, 0.75] }\nvelocity = [2.0, 0.0, 0.0]\n",
    );
    let grid = scene.grid();
    let cut = obstacle_cut(&scene, &grid).unwrap().cut;
    let state = initial_state(&scene, &grid, &cut).unwrap();
    assert_eq!(state.velocity[0][grid.face(Axis::X, [8, 4, 4])], 2.0);
    assert_eq!(state.velocity[0][grid.face(Axis::X, [0, 4, 4])], 0.0);
}
