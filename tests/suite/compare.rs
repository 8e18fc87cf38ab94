//! `compare`: these scenes pass it, and a value that is off does not.

use cutwater::Error;
use cutwater::measure::compare::{Comparison, Place, Row, Worst, compare};
use cutwater::reference::ActiveSurfaces;
use cutwater::scene::Scene;
use cutwater::sim::{Snapshot, SolidSnapshot};
use cutwater::step::Stage;

use crate::common::{adapter, gpu, project_scene as scene, scene_from};

/// What differs by more than its bound, one per line.
fn breaches(comparison: &Comparison) -> String {
    let rows = comparison.rows.iter().filter(|row| row.breached());
    rows.map(|row| {
        let [excused, of] = [row.excused, row.count];
        let what = [row.stage, row.quantity].join(" ");
        format!("{what}: {:?}, {excused} excused, {of} compared\n", row.worst)
    })
    .collect()
}

/// Compares both paths over these frames.
fn assert_passes(scene: &Scene, frames: u64) {
    let comparison = compare(scene, frames, &adapter(), &mut |_, _| {}).unwrap();
    let found = breaches(&comparison);
    assert!(found.is_empty(), "{}:\n{found}", scene.name);
    assert!(comparison.verdict().is_ok(), "{}", scene.name);
    assert!(comparison.steps >= frames, "{}", scene.name);
    for row in comparison.rows.iter().filter(|row| row.excused > 0) {
        let (name, share) = (&scene.name, row.excused as f64 / row.count as f64);
        println!("{name}: {share:.1e} of {} of {} excused: {} of {}", row.quantity, row.stage, row.excused, row.count);
    }
}

/// One scene per effect, for every driver.
#[test]
fn small_scenes_pass() {
    let Some(_) = gpu() else { return };
    let single = ["solver.precision=\"f32\""];
    // One component without a free surface.
    let full = ["liquid.region[0].half_space.point=[0.0, 0.99, 0.0]"];
    let turning = [
        "without domain.gravity",
        "domain.gravity_keyframes=[{ t = 0, gravity = [0, -9.81, 0] }, { t = 0.1, gravity = [4, -6, 1] }]",
    ];
    let pulsing = [
        "without source[0].velocity",
        "source[0].velocity_keyframes=[{ t = 0, velocity = [0, 1, 0] }, { t = 0.03, velocity = [0, 3, 0] }, \
         { t = 0.06, velocity = [0, 0, 0] }, { t = 0.09, velocity = [0, 0, 0] }, { t = 0.1, velocity = [0, 2, 0] }]",
    ];
    for (scene, frames) in [
        (scene("dam_break_liquid", 0.25, &[]), 2),
        (scene("dam_break_liquid", 0.25, &["liquid.surface=level"]), 2),
        (scene("draining_tank", 0.25, &["liquid.surface=level"]), 2),
        (scene("fountain", 0.25, &["liquid.surface=level"]), 2),
        (scene("draining_tank", 0.25, &[]), 2),
        (scene("fountain", 0.25, &single), 2),
        (scene("hydrostatic_block", 0.5, &full), 1),
        // Elastic forces are large beside the velocities: without f64 their rounding shows.
        (scene("compressibility", 0.2, &[]), 1),
        (scene("fountain", 0.25, &pulsing), 3),
        (scene("fountain", 0.25, &[&pulsing[..], &["liquid.surface=markers"]].concat()), 3),
        (scene("draining_tank", 0.25, &turning), 2),
        (scene("compressibility", 0.2, &turning[1..]), 2),
    ] {
        assert_passes(&scene, frames);
    }
}

/// Longer and larger.
#[test]
fn all_scenes_pass() {
    let Some(_) = gpu() else { return };
    let thin = ["domain.size=[2.0, 1.25, 0.25]", "domain.cells=[16, 10, 2]"];
    let moving = ["liquid.region[0].velocity=[1.0, 0.5, -0.75]"];
    let markers = ["liquid.surface=\"markers\""];
    let single = ["solver.precision=\"f32\""];
    let open = ["domain.open=[\"-x\", \"+x\", \"-z\"]"];
    for (scene, frames) in [
        (scene("dam_break_liquid", 0.25, &[]), 3),
        (scene("draining_tank", 0.25, &[]), 4),
        (scene("fountain", 0.25, &[]), 3),
        (scene("dam_break_liquid", 0.25, &open), 2),
        (scene("dam_break_liquid", 0.5, &single), 2),
        (scene("drop_into_pool", 0.375, &moving), 2),
        (scene("hydrostatic_block", 0.5, &[]), 2),
        (scene("hydrostatic_block", 0.5, &markers), 2),
        (scene("hydrostatic_block", 0.5, &single), 2),
        (scene("sphere_half_full", 0.5, &[]), 2),
        (scene("standing_wave", 1.0, &thin), 2),
        (scene("gate", 0.5, &[]), 4),
        (scene("water_wheel", 0.4, &[]), 4),
    ] {
        assert_passes(&scene, frames);
    }
}

/// The first flag that is set.
fn first(flags: &[bool]) -> usize {
    flags.iter().position(|&flag| flag).unwrap()
}

/// Where a field is largest.
fn largest(field: &[f64]) -> usize {
    (0..field.len()).max_by(|&a, &b| field[a].total_cmp(&field[b])).unwrap()
}

/// Changes a little of what a stage left; returns the quantities that are wrong then.
fn spoil(stage: &str, s: &mut Snapshot) -> &'static [&'static str] {
    let Some(s) = &mut s.liquid else { return &[] };
    match stage {
        "advect_markers" => {
            s.markers[7].as_mut().unwrap()[1] += 1e-5;
            s.markers[8] = None;
            &["positions", "markers gone"]
        }
        "advect_velocity" | "forces" => {
            s.velocity_next[2][first(&s.face_band[2])] += 1e-5;
            &["u*"]
        }
        "liquid_distance" => {
            s.liquid_distance[first(&s.band)] += 1e-4;
            s.report.volume_rate += 1e-3;
            &["phi", "volume rate"]
        }
        "active_cells" => {
            let cell = first(&s.active);
            s.active[cell] = false;
            let face = largest(&s.weight[1]);
            s.weight[1][face] *= 1.0 + 1e-6;
            let cell = largest(&s.dirichlet);
            s.dirichlet[cell] *= 1.0 + 1e-5;
            let cell = largest(&s.inverse_diagonal);
            s.inverse_diagonal[cell] *= 1.0 - 1e-5;
            &["active", "weights", "free-surface terms", "1 / diagonal"]
        }
        "right_hand_side" => {
            s.rhs[first(&s.active)] += 1e-4;
            let cell = first(&s.active);
            s.closed[cell] = true;
            &["E u* / dx^2", "closed components"]
        }
        "solve" => {
            let cell = largest(&s.potential);
            s.potential[cell] *= 1.01;
            &["true residual", "pressure"]
        }
        "write_back" => {
            s.velocity[1][first(&s.valid[1])] += 1e-5;
            let face = first(&s.valid[0]);
            s.valid[0][face] = false;
            &["u", "valid faces"]
        }
        "extrapolate" => {
            s.velocity[1][first(&s.face_band[1])] = f64::NAN;
            &["u"]
        }
        "diagnose" => {
            s.report.diagnosis.volume *= 1.0 + 1e-4;
            s.report.diagnosis.max_speed *= 1.0 + 1e-7;
            &["volume", "largest speed"]
        }
        _ => &[],
    }
}

#[test]
fn what_is_off_is_found_and_nothing_else() {
    let Some(_) = gpu() else { return };
    // One sub-step.
    let scene = scene("sphere_half_full", 0.5, &["time.fixed_step=0.041666666666666664"]);
    let mut spoilt = Vec::new();
    let mut listen = |stage: Stage, snapshot: &mut Snapshot| {
        let stage = stage.name();
        spoilt.extend(spoil(stage, snapshot).iter().map(|&quantity| (stage, quantity)));
    };
    let comparison = compare(&scene, 1, &adapter(), &mut listen).unwrap();
    assert_eq!(spoilt.len(), 19);
    for row in &comparison.rows {
        let expected = spoilt.contains(&(row.stage, row.quantity));
        assert_eq!(row.breached(), expected, "{} {}: {:?}", row.stage, row.quantity, row.worst);
    }
    let verdict = comparison.verdict();
    assert!(matches!(verdict, Err(Error::Check(_))), "{verdict:?}");
    assert_eq!(verdict.unwrap_err().exit_code(), 1);
}

/// What of a scene, given as text, differs by more than its bound; `held` hears of the solids after each search for what holds them.
fn compared(text: &str, frames: u64, mut held: impl FnMut(&SolidSnapshot)) -> String {
    let scene = scene_from(text, &[]);
    let mut listen = |stage: Stage, snapshot: &mut Snapshot| {
        if stage == Stage::Solve {
            held(snapshot.solids.as_ref().unwrap());
        }
    };
    breaches(&compare(&scene, frames, &adapter(), &mut listen).unwrap())
}

/// A block on the floor that moves into the side of an obstacle, which looks away from the nearer wall or along it.
#[test]
fn an_obstacle_beside_a_wall_is_not_taken_for_it() {
    let Some(_) = gpu() else { return };
    for speed in [1.0, -1.0] {
        let mut by_obstacle = 0;
        let found = compared(
            &format!(
                "[domain]
size = [1.0, 1.0, 1.0]
cells = [10, 10, 10]
[time]
duration = 1.0
frames_per_second = 60
[[solid]]
name = \"block\"
mesh = {{ box = {{ size = [0.2, 0.2, 0.2], cells = [2, 2, 2] }} }}
placement = {{ translate = [{}, 0.1, 0.5] }}
initial = {{ velocity = [{speed}, 0.0, 0.0] }}
density = 1000.0
young = 1e6
poisson = 0.4
[[obstacle]]
box = {{ min = [0.4, 0.0, 0.2], max = [0.6, 0.5, 0.8] }}
",
                0.5 - 0.205 * speed
            ),
            2,
            |solids| by_obstacle += solids.held.iter().filter(|held| held.obstacle).count(),
        );
        assert!(by_obstacle > 0);
        assert!(found.is_empty(), "{speed} m/s:\n{found}");
    }
}

/// A block between two walls and a ball, which hold nodes in wedges.
#[test]
fn a_wedged_block_is_held_as_in_f64() {
    // Both in mixed precision need f64.
    if !gpu().is_some_and(|gpu| gpu.has_f64()) {
        return;
    }
    let mut by_both = 0;
    let found = compared(
        "[domain]
size = [1.0, 1.0, 1.0]
cells = [14, 14, 14]
[time]
duration = 0.2
frames_per_second = 24
[[liquid.region]]
box = { min = [0, 0, 0], max = [1, 0.5, 1] }
[[solid]]
name = \"block\"
mesh = { box = { size = [0.3, 0.3, 0.3], cells = [2, 2, 2] } }
placement = { translate = [0.15, 0.15, 0.5] }
initial = { velocity = [0.5, 0.0, 0.0] }
density = 2000.0
young = 1e6
poisson = 0.4
[[obstacle]]
sphere = { centre = [0.5, 0.13, 0.47], radius = 0.25 }
",
        1,
        |solids| {
            let both = |held: &&ActiveSurfaces| held.obstacle && held.walls.contains(&true);
            by_both += solids.held.iter().filter(both).count();
        },
    );
    assert!(by_both > 0);
    assert!(found.is_empty(), "{found}");
}

/// Rows with so many numbers compared, all equal, and so many excused.
fn comparison(rows: &[(&'static str, u64, u64)]) -> Comparison {
    let row = |&(quantity, count, excused): &(&'static str, u64, u64)| {
        let mut row = Row::default();
        (row.stage, row.quantity, row.unit) = ("forces", quantity, "m/s");
        (row.count, row.excused) = (count, excused);
        row
    };
    Comparison { rows: rows.iter().map(row).collect(), steps: 1, adapter: String::new() }
}

#[test]
fn excuses_have_a_cap() {
    // A single decision may hang on a rounding however few there are; of 10,000 numbers, 20.
    let within = comparison(&[("a", 10_000, 0), ("b", 9_980, 20), ("c", 3, 1)]);
    assert!(within.verdict().is_ok(), "{:?}", within.verdict());
    for (beyond, told) in [
        ((9_979, 21), "b of forces: 21 excused and 9979 compared, 20 may be"),
        ((100, 2), "b of forces: 2 excused and 100 compared, 1 may be"),
        ((0, 1), "b of forces: 1 excused and 0 compared"),
        ((0, 5_000), "b of forces: 5000 excused and 0 compared"),
    ] {
        let spoilt = comparison(&[("a", 10_000, 0), ("b", beyond.0, beyond.1), ("c", 3, 1)]);
        let breached: Vec<bool> = spoilt.rows.iter().map(Row::breached).collect();
        assert_eq!(breached, [false, true, false]);
        let error = spoilt.verdict().unwrap_err();
        assert_eq!(error.exit_code(), 1);
        let message = error.to_string();
        assert!(message.contains("1 of 3 quantities leave out") && message.contains(told), "{message}");
    }
}

/// One is not hidden behind the other.
#[test]
fn differences_and_excuses_are_both_reported() {
    let mut both = comparison(&[("a", 10, 0), ("b", 10, 7)]);
    both.rows[0].worst = Some(Worst { gpu: f64::NAN, twin: 1.0, bound: 1.0, place: Place::Whole, step: 4 });
    let message = both.verdict().unwrap_err().to_string();
    for told in ["the worst is a of forces: NaN m/s", "sub-step 4", "b of forces: 7 excused"] {
        assert!(message.contains(told), "{told}: {message}");
    }
}
