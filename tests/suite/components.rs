//! Closed components on the device: labels and flags against a flood fill, means, and solves that only exist without them.

use std::collections::BTreeMap;

use cutwater::gpu::Real;
use cutwater::grid::Axis;
use cutwater::reference::{ActiveCells, ballistic_cells, solve_direct};
use cutwater::scene::{Precision, Solver};
use cutwater::state::SolveStatus;

use crate::common::{Random, gpu};
use crate::solver::{Case, Device, largest};

/// Bit of a label whose component has a free surface.
const OPEN: u32 = 0x8000_0000;
/// Bit of a label whose component has none, but a solid that gives way.
const SEALED: u32 = 0x4000_0000;

/// The smallest cell of every active cell's component.
fn flood(active: &ActiveCells) -> BTreeMap<usize, usize> {
    let stencil = &active.stencil;
    let mut roots = BTreeMap::new();
    for seed in stencil.active_cells() {
        let mut front = vec![seed];
        while let Some(cell) = front.pop() {
            if roots.contains_key(&cell) {
                continue;
            }
            roots.insert(cell, seed);
            front.extend(
                stencil.neighbours(cell).iter().filter(|(_, weight)| *weight > 0.0).map(|(neighbour, _)| neighbour),
            );
        }
    }
    roots
}

/// Number, flags and labels of a case on the device against the twin's.
fn assert_components(device: &mut Device, name: &str, case: &Case) {
    device.load(case);
    device.prepare().submit();
    assert_labels(device, name, case, &case.twin());
}

/// The same of what the device holds.
pub(crate) fn assert_labels(device: &Device, name: &str, case: &Case, active: &ActiveCells) {
    let gpu = device.gpu;
    let (grid, padded) = (case.grid, case.grid.padded());
    let found = gpu.download(&device.buffers.components).unwrap()[0] as usize;
    assert_eq!(found, active.closed.len(), "{name}: closed components");

    let flags = gpu.download(&device.buffers.flags).unwrap();
    let of = |components: &[Vec<usize>]| {
        let mut found = vec![false; grid.n_cells()];
        components.iter().flatten().for_each(|&cell| found[cell] = true);
        found
    };
    let (closed, sealed) = (of(&active.closed), of(&active.sealed));
    let ballistic = ballistic_cells(&case.open, &active.stencil);
    for cell in 0..grid.n_cells() {
        let at = padded.index(grid.cell_at(cell));
        let flag = flags[at / 4] >> (at % 4);
        assert_eq!(
            [0, 4, 8, 20, 24].map(|bit| flag >> bit & 1 == 1),
            [
                active.stencil.active(cell),
                closed[cell],
                closed[cell] || sealed[cell],
                ballistic[cell],
                active.stencil.active(cell)
            ],
            "{name}: active, closed, surfaceless, ballistic and filled flag of cell {:?}",
            grid.cell_at(cell)
        );
    }
    if active.closed.len() + active.sealed.len() == 0 {
        return;
    }
    let labels = gpu.download(&device.buffers.labels).unwrap();
    for (cell, root) in flood(active) {
        let root = padded.index(grid.cell_at(root)) as u32;
        let expected = match (closed[cell], sealed[cell]) {
            (true, _) => root,
            (_, true) => root | OPEN | SEALED,
            _ => root | OPEN,
        };
        let label = labels[padded.index(grid.cell_at(cell))];
        assert_eq!(label, expected, "{name}: label of cell {:?}", grid.cell_at(cell));
    }
}

const ODD_CELLS: [[usize; 3]; 6] = [[16, 16, 16], [13, 7, 9], [3, 50, 7], [33, 6, 5], [1, 1, 40], [5, 3, 2]];

/// Faces are closed with this probability, cells are air with that one: from isolated droplets through clusters at the
/// percolation threshold, with paths as tangled as they come, to one pool with holes.
#[test]
fn random_patterns_have_the_components_of_the_flood_fill() {
    let Some(gpu) = gpu() else { return };
    let mut closed = 0;
    for (seed, cells) in ODD_CELLS.into_iter().enumerate() {
        let mut device = Device::new(gpu, cells, &Solver::default());
        for (blocked, air) in [(0.0, 0.8), (0.75, 0.0), (0.75, 0.01), (0.6, 0.001), (0.3, 0.3)] {
            let random = |salt: u64, at: [usize; 3]| {
                let [i, j, k] = at.map(|n| n as u64);
                let mut random = Random(seed as u64 + 7 * (salt + 4 * (i + 100 * (j + 100 * k))));
                random.bits();
                random.uniform(0.0, 1.0)
            };
            let case = Case::new(cells, |at| random(3, at) >= air).narrow(|axis, at| {
                let share = random(axis.index() as u64, at);
                if share < blocked { 0.0 } else { share }
            });
            assert_components(&mut device, &format!("{cells:?} {blocked} {air}"), &case);
            closed += case.twin().closed.len();
        }
    }
    assert!(closed > 500, "the patterns have closed components: {closed}");
}

/// A wall between `low` and `high` (cells) and the rest.
pub(crate) fn wall_around(low: [usize; 3], high: [usize; 3]) -> impl Fn(Axis, [usize; 3]) -> f64 {
    move |axis, at| {
        let a = axis.index();
        let beside = |b: usize| b == a || (low[b]..high[b]).contains(&at[b]);
        let on_wall = (at[a] == low[a] || at[a] == high[a]) && (0..3).all(beside);
        if on_wall { 0.0 } else { 1.0 }
    }
}

/// Pool below y = 9 cells, and a box under water, closed all round.
fn pocket_in_a_pool() -> Case {
    Case::new([14, 13, 11], |[_, j, _]| j < 9).narrow(wall_around([3, 2, 4], [9, 6, 8]))
}

/// One channel, a cell wide, that winds through all cells.
fn winding_channel(cells: [usize; 3], liquid: impl Fn([usize; 3]) -> bool) -> Case {
    let [nx, ny, _] = cells;
    Case::new(cells, liquid).narrow(move |axis, [i, j, k]| {
        let forwards = |n: usize, end: usize, length: usize| {
            if end.is_multiple_of(2) { n == length - 1 } else { n == 0 }
        };
        let open = match axis {
            Axis::X => true,
            // Rows are joined at alternating ends, slabs likewise.
            Axis::Y => forwards(i, if k.is_multiple_of(2) { j + 1 } else { ny - j } + k, nx),
            Axis::Z => {
                let last_row = if (k - 1).is_multiple_of(2) { ny - 1 } else { 0 };
                j == last_row && forwards(i, ny - 1 + (k - 1), nx)
            }
        };
        if open { 1.0 } else { 0.0 }
    })
}

#[test]
fn named_patterns_have_the_components_of_the_flood_fill() {
    let Some(gpu) = gpu() else { return };
    let full = |_: [usize; 3]| true;
    let cells = [9, 10, 11];
    let cases = [
        ("nothing", Case::new(cells, |_| false), 0),
        ("closed tank", Case::new(cells, full), 1),
        ("closed tank of whole tiles", Case::new([32, 16, 8], full), 1),
        ("tank with an air cell", Case::new(cells, |at| at != [4, 5, 6]), 0),
        ("one liquid cell", Case::new(cells, |at| at == [4, 5, 6]), 0),
        ("a grid of one cell", Case::new([1, 1, 1], full), 0),
        ("a grid of two cells", Case::new([1, 2, 1], full), 1),
        ("pocket in a pool", pocket_in_a_pool(), 1),
        (
            "dominoes",
            Case::new([10, 10, 10], full).narrow(
                |axis, [_, j, _]| {
                    if axis == Axis::Y && j % 2 == 1 { 1.0 } else { 0.0 }
                },
            ),
            500,
        ),
        ("slabs", Case::new([10, 9, 8], full).narrow(|axis, _| if axis == Axis::Z { 0.0 } else { 1.0 }), 8),
        (
            "checkerboard of columns, half of them open",
            Case::new([12, 12, 9], |[i, j, k]| k < 8 || (i + j) % 2 == 0)
                .narrow(|axis, _| if axis == Axis::Z { 1.0 } else { 0.0 }),
            72,
        ),
        ("winding channel", winding_channel([8, 7, 6], full), 1),
        ("winding channel, open at its end", winding_channel([8, 7, 6], |at| at != [0, 0, 5]), 0),
    ];
    for (name, case, closed) in cases {
        let mut device = Device::new(gpu, case.grid.cells, &Solver::default());
        assert_components(&mut device, name, &case);
        assert_eq!(case.twin().closed.len(), closed, "{name}");
    }
}

/// Values over 18 decades, more than an f32 sum holds, with a mean that is no rounding.
fn wild(case: Case) -> Case {
    let mut random = Random(5);
    let mut case = case;
    for b in &mut case.rhs {
        *b = f64::from((0.3 + random.uniform(-1.0, 1.0) * 10_f64.powf(random.uniform(-12.0, 6.0))) as f32);
    }
    case
}

#[test]
fn means_of_closed_components_are_taken_out_exactly() {
    let Some(gpu) = gpu() else { return };
    let dominoes = Case::new([10, 10, 10], |_| true).narrow(
        |axis, [_, j, _]| {
            if axis == Axis::Y && j % 2 == 1 { 1.0 } else { 0.0 }
        },
    );
    let tank = Case::new([19, 18, 17], |_| true);
    for (name, case) in [("tank", tank), ("dominoes", dominoes), ("pocket", pocket_in_a_pool())] {
        let case = wild(case);
        for precision in [Precision::F32, Precision::Mixed] {
            let solver = Solver { precision, ..Solver::default() };
            let device = Device::holding(gpu, &case, &solver);
            device.prepare().submit();
            let found = device.cells(&device.buffers.rhs);
            let mut expected = case.rhs.clone();
            let mut means = vec![0.0; expected.len()];
            let closed = case.twin().closed;
            for component in &closed {
                let mean = component.iter().map(|&cell| case.rhs[cell]).sum::<f64>() / component.len() as f64;
                for &cell in component {
                    expected[cell] -= mean;
                    means[cell] = mean;
                }
            }
            let epsilon = match device.buffers.rhs.real {
                Real::F32 => f64::from(f32::EPSILON),
                Real::F64 => f64::EPSILON,
            };
            for component in &closed {
                let scale = largest(component.iter().map(|&cell| case.rhs[cell]));
                for &cell in component {
                    // Rounding of the mean, and what is set to zero for it; the twin's own sum rounds once per cell.
                    let bound = epsilon * (expected[cell].abs() + 3.0 * means[cell].abs()) + 1e-13 * scale;
                    assert!(
                        (found[cell] - expected[cell]).abs() <= bound,
                        "{name} {precision:?} cell {cell}: {:e}, not {:e}",
                        found[cell],
                        expected[cell]
                    );
                }
            }
            let in_closed: Vec<usize> = closed.into_iter().flatten().collect();
            for cell in (0..found.len()).filter(|cell| !in_closed.contains(cell)) {
                assert_eq!(found[cell], case.rhs[cell], "{name}: open cell {cell}");
            }
        }
    }
}

#[test]
fn a_uniform_source_in_a_closed_tank_leaves_nothing_to_solve() {
    let Some(gpu) = gpu() else { return };
    for source in [0.1, -1e-9, 12345.678] {
        let mut case = Case::new([11, 12, 13], |_| true);
        case.rhs.fill(source);
        let solved = Device::holding(gpu, &case, &Solver::default()).solve();
        assert_eq!(
            (solved.outcome.status, solved.outcome.iterations),
            (SolveStatus::Converged, 0),
            "{source}: {:?}",
            solved.outcome
        );
        assert_eq!(largest(solved.potential), 0.0, "{source}");
    }
}

/// The right-hand sides are random, so they have means, and without taking them out there is no solution.
#[test]
fn closed_components_are_solved_to_the_tolerance_with_mean_zero() {
    let Some(gpu) = gpu() else { return };
    let porous = Case::new([12, 11, 10], |at| at != [0, 0, 0]).narrow(|axis, [i, j, k]| {
        let mut random = Random((axis.index() + 3 * (i + 20 * (j + 20 * k))) as u64);
        random.bits();
        let share = random.uniform(0.0, 1.0);
        if share < 0.7 { 0.0 } else { share }
    });
    for (name, case, most) in [
        ("tank", Case::new([16, 16, 16], |_| true), 20),
        ("tank with odd cells", Case::new([13, 7, 21], |_| true), 20),
        ("pocket in a pool", pocket_in_a_pool(), 20),
        ("two cells", Case::new([2, 1, 1], |_| true), 4),
        ("three cells", Case::new([1, 3, 1], |_| true), 6),
        ("winding channel", winding_channel([6, 5, 4], |_| true), 200),
        ("porous", porous, 200),
    ] {
        let case = case.random_rhs(3);
        let device = Device::holding(gpu, &case, &Solver::default());
        let solved = device.solve();
        let outcome = solved.outcome;
        assert_eq!(outcome.status, SolveStatus::Converged, "{name}: {outcome:?}");
        assert!(outcome.verified && outcome.residual <= 1e-8 && outcome.iterations <= most, "{name}: {outcome:?}");
        let system = case.twin_system();
        assert_eq!(outcome.closed_components as usize, system.closed.len(), "{name}");
        let exact = Solver { tolerance: 1e-12, ..Solver::default() };
        let (direct, _) = solve_direct(&system, &exact).unwrap();
        let scale = largest(direct.iter().copied());
        let difference = largest(direct.iter().zip(&solved.potential).map(|(p, x)| p - x));
        assert!(difference <= 1e-5 * scale, "{name}: {difference:e} of {scale:e}");
        let repeated = device.solve();
        assert_eq!(repeated.potential, solved.potential, "{name}: bit for bit");
        assert_eq!(repeated.outcome.iterations, outcome.iterations, "{name}");
    }
}
