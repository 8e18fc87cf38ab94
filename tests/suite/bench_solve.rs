//! `bench solve` on small grids: complete tables, rivals that solve the same system, growth of what grows.

use std::fs;

use cutwater::measure::bench_solve::{Formulation, Options, Rival, bench_solve, largest_grid};
use cutwater::scene::{Precision, Preconditioner, Solver};

use crate::common::gpu;

fn options(formulations: Vec<Formulation>) -> Options {
    Options {
        formulations,
        grids: vec![12],
        bricks: vec![None],
        repeats: 1,
        solvers: vec![Solver::default()],
        against: Vec::new(),
        largest_factor: 1e8,
        matrices: false,
    }
}

#[test]
fn every_formulation_has_a_row_and_every_rival_its_own() {
    let Some(gpu) = gpu() else { return };
    let folder = tempfile::tempdir().unwrap();
    let options = Options {
        against: vec![Rival::IncompleteCholesky, Rival::Cholesky, Rival::Multigrid],
        repeats: 3,
        ..options(vec![
            Formulation::Pressure,
            Formulation::TwoField,
            Formulation::Condensed,
        ])
    };
    let mut told = 0;
    let tell = &mut |_: &_, against: &[_]| told += 1 + against.len();
    let table = bench_solve(gpu, &options, folder.path(), tell).unwrap();
    let [pressure, both, condensed] = &table.rows[..] else {
        panic!("{:?}", table.rows);
    };
    assert_eq!(
        [pressure, both, condensed].map(|row| row.formulation),
        ["pressure", "two-field", "condensed"]
    );
    assert_eq!([pressure.solid_nodes, both.solid_nodes], [0, 135]);
    for row in &table.rows {
        assert_eq!(row.status, "converged", "{row:?}");
        assert!(row.residual_p <= 1e-8 && row.residual_v <= 1e-8, "{row:?}");
        // An iteration with a V-cycle moves 120 bytes a cell where each quad is uniform.
        let of_cells = 120.0 * f64::from(row.active_cells) * f64::from(row.iterations);
        assert!(row.bytes > of_cells && row.seconds_min > 0.0, "{row:?}");
    }
    assert!(pressure.residual_v == 0.0 && both.residual_v > 0.0);
    assert_eq!((told, table.against.len()), (12, 9));
    for rival in &table.against {
        // The residuals that the device is judged on, with solids those of the indefinite system.
        let coupled = rival.formulation != "pressure";
        let residuals = [rival.residual_p, rival.residual_v].map(Option::unwrap);
        assert_eq!(rival.status, Some("converged"), "{rival:?}");
        assert!(residuals.iter().all(|&r| r <= 1e-8), "{rival:?}");
        assert_eq!([residuals[0] > 0.0, residuals[1] > 0.0], [true, coupled]);
        let [exact, multigrid] = ["cholesky", "multigrid_cg"].map(|name| rival.rival == name);
        assert_eq!(rival.iterations.is_some(), !exact, "{rival:?}");
        assert_eq!(rival.factor_bytes.is_some(), !multigrid, "{rival:?}");
        assert!(rival.threads >= 1 && !rival.parallel.is_empty());
        // Of the turns, whichever they were.
        let bounds = [
            rival.seconds_min.unwrap() / rival.device_seconds_max,
            rival.ratio_min.unwrap(),
            rival.ratio_median.unwrap(),
            rival.ratio_max.unwrap(),
            rival.seconds_max.unwrap() / rival.device_seconds_min,
        ];
        assert!(bounds.is_sorted() && bounds[0] > 0.0, "{rival:?}");
        assert_eq!((rival.turns, rival.note.as_str()), (3, ""), "{rival:?}");
        // Multigrid has pressures alone.
        let more = rival.rows > rival.active_cells as usize;
        assert_eq!(more, coupled && !multigrid, "{rival:?}");
    }
    for (file, lines) in [("solve.csv", 4), ("solve_against.csv", 10)] {
        let written = fs::read_to_string(folder.path().join(file)).unwrap();
        assert_eq!(written.lines().count(), lines, "{written}");
    }
}

#[test]
fn a_diagonal_moves_less_than_a_cycle_and_rounding_is_told() {
    let Some(gpu) = gpu() else { return };
    let folder = tempfile::tempdir().unwrap();
    let optional = ["solve_growth.csv", "solve_against.csv"].map(|name| folder.path().join(name));
    for file in &optional {
        fs::write(file, "of another run").unwrap();
    }
    let multigrid = Solver {
        max_iterations: 5000,
        ..Solver::default()
    };
    let options = Options {
        grids: vec![8],
        solvers: vec![
            multigrid,
            Solver {
                preconditioner: Preconditioner::Jacobi,
                ..multigrid
            },
            Solver {
                precision: Precision::F32,
                ..multigrid
            },
        ],
        ..options(vec![Formulation::Pressure])
    };
    let table = bench_solve(gpu, &options, folder.path(), &mut |_, _| {}).unwrap();
    let [multigrid, jacobi, single] = &table.rows[..] else {
        panic!("{:?}", table.rows);
    };
    for row in [multigrid, jacobi] {
        assert_eq!(row.status, "converged", "{row:?}");
    }
    // The most on any grid: `solver::iterations_hardly_grow_with_the_grid`.
    assert!(multigrid.iterations <= 20, "{multigrid:?}");
    let [cycle, diagonal] = [multigrid, jacobi].map(|row| row.bytes / f64::from(row.iterations));
    assert!(diagonal < 0.6 * cycle, "{diagonal}, {cycle}");
    // f32 may not hold what a residual of 1e-8 asks for. Whether it does is told as it is.
    let holds = single.residual_p <= single.tolerance;
    assert_eq!(single.status == "converged", holds, "{single:?}");
    for file in optional {
        assert!(!file.exists(), "{}", file.display());
    }
}

#[test]
fn growth_is_along_what_grows() {
    let Some(gpu) = gpu() else { return };
    let folder = tempfile::tempdir().unwrap();
    let options = Options {
        grids: vec![8, 12],
        bricks: vec![Some(1), Some(2)],
        against: vec![Rival::Cholesky],
        largest_factor: 1.0,
        ..options(vec![Formulation::Pressure, Formulation::TwoField])
    };
    let table = bench_solve(gpu, &options, folder.path(), &mut |_, _| {}).unwrap();
    assert_eq!(table.rows.len(), 2 + 4);
    let left_out = table
        .against
        .iter()
        .all(|row| row.seconds_median.is_none() && row.turns == 0 && row.factor_bytes > Some(1.0));
    assert!(left_out, "{:?}", table.against);
    let written = fs::read_to_string(folder.path().join("solve_against.csv")).unwrap();
    assert_eq!(written.matches("GiB left out").count(), 6, "{written}");
    // Pressures with the cells; both with the cells for two beams, and with the nodes on two grids.
    let along: Vec<_> = table
        .growth
        .iter()
        .map(|growth| (growth.formulation, growth.along, growth.fixed, growth.rows))
        .collect();
    assert_eq!(along.len(), 5, "{along:?}");
    for expected in [
        ("pressure", "cells", None, 2),
        ("two-field", "cells", Some(32), 2),
        ("two-field", "cells", Some(135), 2),
        ("two-field", "nodes", Some(8), 2),
        ("two-field", "nodes", Some(12), 2),
    ] {
        assert!(along.contains(&expected), "{expected:?} {along:?}");
    }
    for growth in &table.growth {
        assert!(
            growth.exponent.is_finite() && growth.from < growth.to,
            "{growth:?}"
        );
        let ends = growth.exponent_low.zip(growth.exponent_high);
        let within = ends.is_none_or(|(low, high)| (low..=high).contains(&growth.exponent));
        assert!(within, "{growth:?}");
        // Of two sizes the last pair is all there is; least squares round.
        let last = growth.exponent_last - growth.exponent;
        assert!(last.abs() < 1e-9, "{growth:?}");
    }
}

#[test]
fn grids_without_room_are_refused_before_any_work() {
    let Some(gpu) = gpu() else { return };
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let options = Options {
        grids: vec![8, 1024],
        ..options(vec![Formulation::Pressure])
    };
    let largest = largest_grid(gpu.report(), &options.solvers).unwrap();
    // Free memory, which may decide, changes while other tests run.
    assert!((20..1020).contains(&largest) && largest.is_multiple_of(10));
    let error = bench_solve(gpu, &options, &out, &mut |_, _| {}).unwrap_err();
    let told = error.to_string();
    assert!(told.contains("give grids of at most"), "{told}");
    assert!(error.exit_code() == 3 && !out.exists(), "{told}");
}
