//! `liquid_components`, `volume_shift`, `excess` and the source of the excess against their twins.

use cutwater::fields::{ExchangeBuffers, LevelBuffers, LiquidBuffers, SolverBuffers, Step};
use cutwater::gpu::{Dispatches, Gpu, Real, Recorder};
use cutwater::grid::{Axis, Grid};
use cutwater::reference::{self, Ballistic, Before, Components, LevelCells, interpolant_part};
use cutwater::stages;
use cutwater::state::State;
use glam::DVec3;

use crate::common::{Random, gpu};
use crate::level_case::{level_buffers, level_cases};
use crate::liquid_case::{ActiveBuffers, Case, EPS, assert_close, single};

/// Courant number of the surface.
const COURANT: f64 = 7.5;
/// Volumes of cells in a unit of the sums.
const UNIT: f64 = 1.0 / (1 << 23) as f64;
/// Error of the volume of a cell, volumes of a cell: the distance to bodies over dx has a division of 5 half units and the rounding
/// of dx; two differences, the product and that of the sum follow. A filled part is a mean of samples of levels of up to 5 cells over
/// nine rows: three roundings of a product, nine sums, and five of 2 / dx, twice that.
const CELL: f64 = (12.0 + 2.0 * 5.0 * 17.0) * EPS;
/// Error of the area of a cell: phi / dx is at most 1.
const AREA: f64 = 18.0 * EPS;
/// Relative error of a sum of two words as an f32.
const SUM: f64 = 3.0 * EPS;

/// The stages on one set of buffers.
struct Run<'a> {
    gpu: &'a Gpu,
    case: &'a Case,
    volume_0: f64,
    liquid: LiquidBuffers,
    level: LevelBuffers,
    solver: SolverBuffers,
    origins: Dispatches,
    components: Dispatches,
    shift: Dispatches,
    excess: Dispatches,
    settle: Dispatches,
}

impl<'a> Run<'a> {
    fn new(gpu: &'a Gpu, case: &'a Case, volume_0: f64) -> Run<'a> {
        let liquid = case.upload(gpu);
        let level = level_buffers(gpu, case, &liquid);
        let solver = case.solved(gpu);
        let origins = stages::advect_level(gpu, &liquid, &solver, &level).unwrap();
        let settle = stages::settle_flights(gpu, &liquid, &level).unwrap();
        Run {
            gpu,
            case,
            volume_0,
            origins,
            components: stages::liquid_components(gpu, &liquid, &level, ExchangeBuffers::default()).unwrap(),
            shift: stages::volume_shift(gpu, &liquid, &level).unwrap(),
            excess: stages::excess(gpu, &liquid, &level).unwrap(),
            settle: Dispatches::new("spray", [settle]),
            liquid,
            level,
            solver,
        }
    }

    /// Starts again from the state.
    fn write(&self) {
        self.case.write(self.gpu, &self.liquid);
        self.write_step();
        self.level.write_components(self.gpu, &self.case.state);
        self.solver.write_active(self.gpu, &self.case.grid, &self.case.state);
        let velocities = self.case.state.marker_velocity.iter();
        let markers: Vec<[f32; 4]> = velocities
            .zip(&self.case.state.spray)
            .map(|(v, &spray)| [v[0] as f32, v[1] as f32, v[2] as f32, f32::from(spray)])
            .collect();
        self.gpu.upload(&self.level.marker_velocity, &markers);
        let flying = self.case.state.spray.iter().filter(|spray| **spray).count();
        self.gpu.upload(&self.level.marker_counts, &[flying as u32]);
    }

    /// So that the largest component is controlled in part.
    fn renewed(&self) -> f64 {
        single(0.7 * self.volume_0)
    }

    fn write_step(&self) {
        let renewed = self.renewed() / self.case.grid.cell_volume();
        self.level.write_step(self.gpu, [0; 2], COURANT, renewed);
        let step = Step { volume_0: self.volume_0 as f32, ..self.case.step() };
        self.gpu.upload(&self.liquid.step, &[step]);
    }

    fn record(&self, stages: &[&Dispatches]) {
        let mut recorder = Recorder::new(self.gpu);
        stages.iter().for_each(|stage| stage.record(&mut recorder));
        recorder.submit();
    }

    fn distance(&self) -> Vec<f64> {
        let device = self.gpu.download(&self.liquid.liquid_distance).unwrap();
        let padded = self.liquid.padded;
        padded.unpad(self.case.grid.cells, &device, f64::from)
    }

    /// Distinct labels, ascending.
    fn labels(&self) -> Vec<u32> {
        let mut labels = self.gpu.download(&self.level.component).unwrap();
        labels.sort_unstable();
        labels.dedup();
        labels.into_iter().filter(|&label| label > 0).collect()
    }

    /// Components before the sub-step at the departure points, as numbers of `labels`; beyond all numbers for labels that are not
    /// among them, which stand only outside the band.
    fn origins(&self, labels: &[u32]) -> Vec<u32> {
        let device = self.gpu.download(&self.level.component_origin).unwrap();
        let number = |label| match label {
            0 => 0,
            _ => labels.binary_search(&label).map_or(u32::MAX, |at| 1 + at as u32),
        };
        let padded = self.liquid.padded;
        padded.unpad(self.case.grid.cells, &device, number)
    }

    fn state(&self) -> State {
        let mut state = State::at_rest(&self.case.grid);
        self.level.read_components(self.gpu, &mut state).unwrap();
        state
    }

    /// Volumes (in those of a cell) of the components of `labels` and whether they are enclosed.
    fn volumes(&self, labels: &[u32]) -> (Vec<f64>, Vec<bool>) {
        let sums = self.gpu.download(&self.level.component_sums).unwrap();
        let of = |&label: &u32| {
            let [low, high] = sums[label as usize];
            let whole = u64::from(high & !(1 << 31)) << 32 | u64::from(low);
            (whole as f64 * UNIT, high >> 31 == 0)
        };
        labels.iter().map(of).unzip()
    }

    /// All that the stages leave.
    fn bits(&self) -> Vec<u32> {
        let Run { gpu, level, .. } = self;
        let mut bits = gpu.download(&level.component).unwrap();
        bits.extend(gpu.download(&level.component_origin).unwrap());
        let sums = gpu.download(&level.component_sums).unwrap();
        bits.extend(sums.into_iter().flatten());
        for field in [&level.component_volume, &level.excess, &self.liquid.liquid_distance] {
            let values = gpu.download(field).unwrap();
            bits.extend(values.into_iter().map(f32::to_bits));
        }
        bits
    }
}

/// Asserts that the origins are the twin's; returns how many are too close to a choice to tell.
fn check_origins(run: &Run, ballistic: Ballistic, label: &[u32], origins: &[u32]) -> usize {
    let (case, grid) = (run.case, &run.case.grid);
    let velocity = &case.state.velocity;
    let dt = f64::from(case.dt as f32);
    // Cells. A position is off by two roundings, a velocity by twelve of its own; what a position is off by changes it by up to its
    // double along each axis.
    let way = dt * case.speed() / grid.dx;
    let middle = EPS * (6.0 * way + 4.0 * case.extent());
    let off = way * (6.0 * middle + 12.0 * EPS) + EPS * 4.0 * case.extent();
    let mut close = 0;
    for (cell, &origin) in origins.iter().enumerate() {
        let x = grid.cell_centre(grid.cell_at(cell));
        let traced = grid.traced(velocity, x, -dt);
        let at = |x: DVec3| reference::label_at(grid, label, ballistic.origin_about(grid, x));
        let twin = at(traced);
        let around = (0..8).map(|corner| {
            let side = |bit: u32| 2.0 * f64::from(corner >> bit & 1) - 1.0;
            traced + 2.0 * off * grid.dx * DVec3::new(side(0), side(1), side(2))
        });
        if around.into_iter().any(|x| at(x) != twin) {
            close += 1;
        } else {
            let place = grid.cell_at(cell);
            assert_eq!(origin, twin, "{}: origin of {place:?}", case.name);
        }
    }
    close
}

/// Asserts what `liquid_components` leaves; the twin's components.
fn check_components(run: &Run, phi: &[f64], volume_0: &[f64], origins: &[u32]) -> Components {
    let (case, grid) = (run.case, &run.case.grid);
    let name = case.name;
    let one = grid.cell_volume();
    let open = reference::open_volumes(grid, &case.cut.solid_distance);
    let level: Vec<f64> = phi.iter().map(|phi| phi / grid.dx).collect();
    let twin = reference::liquid_components(grid, &case.cut.open, &open, &level);
    let state = run.state();
    assert!(state.component == twin.label, "{name}: labels");
    let labels = run.labels();
    let (volumes, enclosed) = run.volumes(&labels);
    assert_eq!(enclosed, twin.enclosed, "{name}");
    let n = labels.len();
    let mut volume_bound = vec![0.0; n];
    for &label in twin.label.iter().filter(|label| **label > 0) {
        volume_bound[label as usize - 1] += CELL;
    }
    assert_close(name, (0..n).map(|k| (volumes[k], twin.volume[k] / one, volume_bound[k], [k, 0, 0])));
    // Shares of the old targets.
    let in_cell = |cell: usize| match twin.label[cell] {
        0 => 0.0,
        _ => open[cell] * interpolant_part(grid, &level, cell),
    };
    let in_cells: Vec<f64> = (0..grid.n_cells()).map(in_cell).collect();
    let shares = reference::shared_volumes(volume_0, origins, &twin, &in_cells);
    let mut overlap = vec![[0.0; 2]; volume_0.len()];
    let pairs: Vec<(usize, usize)> = (0..grid.n_cells())
        .filter(|&cell| origins[cell] > 0 && in_cells[cell] > 0.0)
        .map(|cell| (cell, origins[cell] as usize - 1))
        .collect();
    for &(cell, old) in &pairs {
        overlap[old][0] += in_cells[cell] / one;
        overlap[old][1] += CELL;
    }
    let mut share_bound = vec![0.0; n];
    for &(cell, old) in &pairs {
        let [sum, off] = overlap[old];
        let relative = (off / sum + SUM).min(1.0);
        let part = in_cells[cell] / one / sum;
        // A division, two products, and the rounding of the sum.
        let part_bound = CELL / sum + part * (2.0 * relative + 8.0 * EPS);
        share_bound[twin.label[cell] as usize - 1] += volume_0[old] / one * part_bound + EPS;
    }
    let flying = case.state.spray.iter().filter(|spray| **spray).count();
    let total = run.volume_0 / one - flying as f64 / 8.0;
    let mut targets = shares.clone();
    reference::balance(total * one, &twin.volume, &mut targets);
    if !case.effects.open_sides {
        reference::cap_targets(&twin.volume, &mut targets);
    }
    let whole = twin.volume.iter().sum::<f64>() / one;
    let shared = shares.iter().sum::<f64>() / one;
    let rest = (total - shared).abs();
    // dx^3 and the quotient; the sum of the shares; two differences.
    let rest_bound = EPS * 14.0 * run.volume_0 / one
        + share_bound.iter().sum::<f64>()
        + (SUM + EPS) * shared.abs()
        + 2.0 * EPS * rest;
    let whole_bound = volume_bound.iter().sum::<f64>() / whole + SUM;
    assert_close(
        name,
        (0..n).map(|k| {
            let (target, share) = (targets[k] / one, shares[k] / one);
            let part = twin.volume[k] / one / whole;
            let part_bound = volume_bound[k] / whole + part * (whole_bound + SUM + 6.0 * EPS);
            let bound = share_bound[k] + SUM * share.abs() + rest_bound * part + rest * part_bound + EPS * target.abs();
            // A minimum is off by at most as much as one of both.
            (state.component_volume[k] / one, target, bound.max(4.0 * volume_bound[k] + EPS * target), [k, 1, 0])
        }),
    );
    twin
}

/// Asserts the shift of `phi` (m) with the volumes and targets of the device; how many components move, how many at once, and how many cells
/// of the latter are beside bodies.
fn check_shift(run: &Run, phi: &[f64], twin: &Components) -> [usize; 3] {
    let (case, grid) = (run.case, &run.case.grid);
    let one = grid.cell_volume();
    let (volumes, enclosed) = run.volumes(&run.labels());
    let components =
        Components { label: twin.label.clone(), volume: volumes.iter().map(|volume| volume * one).collect(), enclosed };
    let targets = run.state().component_volume;
    let open = reference::open_volumes(grid, &case.cut.solid_distance);
    let mut shifted = phi.to_vec();
    let times = [1.0, f64::from(case.dt as f32)];
    let limits = (times, reference::largest_shift(COURANT));
    let bodies = &case.cut.solid_distance;
    let shifts = reference::volume_shift(grid, &open, bodies, &components, &targets, limits, &mut shifted);
    let mut area = vec![[0.0; 2]; targets.len()];
    for (cell, &label) in twin.label.iter().enumerate().filter(|(_, label)| **label > 0) {
        let near = (1.0 - (phi[cell] / grid.dx).abs()).clamp(0.0, 1.0);
        let [sum, off] = &mut area[label as usize - 1];
        *sum += open[cell] / one * near;
        *off += AREA;
    }
    let bound_of = |k: usize| {
        let [area, off] = area[k];
        let target = targets[k] / one;
        let lacks = (target - volumes[k]).abs();
        let off_lacks = EPS * (5.0 * volumes[k] + 4.0 * target.abs());
        let relative = off / area + SUM + 8.0 * EPS;
        // What lacks beyond 2.5 % returns at once.
        let at_once = f64::from(target - volumes[k] + off_lacks > 0.025 * target);
        let speed = ((times[1] / times[0]).min(1.0) + at_once) / area;
        // No shift is off by more than its range.
        let range = 1.25 * reference::largest_shift(COURANT);
        let off = speed * (off_lacks + 2.0 * lacks * relative);
        if off.is_nan() { range } else { off.min(range) }
    };
    let bounds: Vec<f64> = (0..targets.len()).map(bound_of).collect();
    let after = run.distance();
    assert_close(
        case.name,
        (0..grid.n_cells()).map(|cell| {
            let off = match twin.label[cell] {
                0 => 0.0,
                label => {
                    // Two roundings of a shift, a sum, four of the share at bodies, that of dx, one of the difference.
                    let shift = shifts[label as usize - 1].abs();
                    grid.dx * (bounds[label as usize - 1] + 8.0 * EPS * shift) + EPS * (phi[cell].abs() + grid.dx)
                }
            };
            (after[cell], shifted[cell], off, grid.cell_at(cell))
        }),
    );
    let moved = shifts.iter().filter(|shift| **shift != 0.0).count();
    let gradual = |k: usize| (targets[k] - components.volume[k]) / one * (times[1] / times[0]) / area[k][0];
    let at_once: Vec<bool> = (0..shifts.len()).map(|k| shifts[k] > 0.0 && shifts[k] > 1.1 * gradual(k)).collect();
    let beside = |cell: &usize| (0.1..0.4).contains(&(bodies[*cell] / grid.dx));
    let of_these = |cell: &usize| twin.label[*cell] > 0 && at_once[twin.label[*cell] as usize - 1];
    let cells = (0..grid.n_cells()).filter(beside).filter(of_these).count();
    [moved, at_once.into_iter().filter(|at_once| *at_once).count(), cells]
}

/// Asserts e in liquid of `phi` (m); how many cells have one.
fn check_excess(run: &Run, phi: &[f64], fraction: &[f64], twin: &Components) -> usize {
    let (case, grid) = (run.case, &run.case.grid);
    let cells = LevelCells { grid, cut: &case.cut };
    let level: Vec<f64> = phi.iter().map(|phi| phi / grid.dx).collect();
    let (volumes, enclosed) = run.volumes(&run.labels());
    let volume = volumes.iter().map(|volume| volume * grid.cell_volume()).collect();
    let components = Components { label: twin.label.clone(), volume, enclosed };
    let targets = run.state().component_volume;
    let e = reference::excess(cells, (&components, &targets), run.renewed(), fraction, &level);
    let device = run.gpu.download(&run.level.excess).unwrap();
    let device = run.liquid.padded.unpad(grid.cells, &device, f64::from);
    // Six passes of at most three roundings over values up to 1, and over their weights, each after five of its own. Their quotient, of
    // 0.05 at least, has six roundings more.
    // The volume of a component is off by 16 roundings and half a unit of the sums in each cell.
    let n = grid.n_cells() as f64;
    let volume = n * (16.0 * EPS + 1.0 / (1 << 24) as f64);
    let part = volume * grid.cell_volume() / run.renewed();
    // So is the volume that a component lacks, over half a hundredth of its target.
    let of_target = |&target: &f64| (4.0 * EPS + 1e-9 * grid.cell_volume() / target) / 0.005;
    let against = targets.iter().filter(|target| **target > 0.0).map(of_target).fold(0.0, f64::max);
    let bound = EPS * (2.0 * 23.0 / 0.05 + 8.0) + part + against;
    assert_close(case.name, (0..grid.n_cells()).map(|cell| (device[cell], e[cell], bound, grid.cell_at(cell))));
    e.iter().filter(|e| **e != 0.0).count()
}

/// Writes occupancies, some unknown.
fn write_occupancy(run: &Run, random: &mut Random) -> Vec<f64> {
    let grid = &run.case.grid;
    let fraction = |_| match random.uniform(0.0, 1.0) {
        known if known < 0.9 => single(random.uniform(0.4, 1.8)),
        _ => reference::UNKNOWN,
    };
    let fractions: Vec<f64> = (0..grid.n_cells()).map(fraction).collect();
    let device = run.liquid.padded.pad(grid.cells, &fractions, |fraction| fraction as f32);
    run.gpu.upload(&run.level.occupancy, &device);
    fractions
}

/// The cases with components of a similar level before; and with white noise, ballistic liquid and random closed faces.
fn all_cases() -> Vec<Case> {
    let with_before = |noise: bool| {
        level_cases().into_iter().map(move |mut case| {
            let (grid, mut random) = (case.grid, Random(23));
            if noise {
                let noise = |_| single(grid.dx * random.uniform(-1.3, 1.5));
                case.state.liquid_distance = (0..grid.n_cells()).map(noise).collect();
                // Pockets.
                for open in case.cut.open.iter_mut().flatten() {
                    *open *= f64::from(random.uniform(0.0, 1.0) < 0.6);
                }
            }
            // Not at the depth where the density begins to count.
            for phi in &mut case.state.liquid_distance {
                if (*phi / grid.dx + 1.0).abs() < 1e-5 {
                    *phi = single(-1.1 * grid.dx);
                }
            }
            let open = reference::open_volumes(&grid, &case.cut.solid_distance);
            let phi = case.state.liquid_distance.iter();
            let level: Vec<f64> = phi.map(|phi| phi / grid.dx + random.uniform(-0.5, 0.5)).collect();
            let before = reference::liquid_components(&grid, &case.cut.open, &open, &level);
            let volume = |volume: &f64| {
                let cells = volume / grid.cell_volume() * random.uniform(0.7, 1.4);
                single(cells) * grid.cell_volume()
            };
            case.state.component_volume = before.volume.iter().map(volume).collect();
            case.state.component = before.label;
            case
        })
    };
    let falls = |case: Case| match case.state.markers.is_empty() {
        true => case,
        false => case.with_ballistic(),
    };
    let plain = with_before(false);
    plain.chain(with_before(true).map(falls)).collect()
}

#[test]
fn components_have_the_twins_labels_and_volumes() {
    let Some(gpu) = gpu() else { return };
    let (mut most, mut moved, mut dense, mut enclosed, mut flown) = (0, [0; 3], 0, 0, 0);
    for case in all_cases() {
        let grid = &case.grid;
        let one = grid.cell_volume();
        let targets: f64 = case.state.component_volume.iter().sum();
        let run = Run::new(gpu, &case, single(1.07 * targets + 3.0 * one));
        let mut random = Random(3);
        run.write();
        let fraction = write_occupancy(&run, &mut random);
        let mut written = State::at_rest(grid);
        run.level.read_components(gpu, &mut written).unwrap();
        assert!(written.component == case.state.component);
        let pairs = written.component_volume.iter();
        let same = pairs.zip(&case.state.component_volume).all(|(a, b)| a == b);
        assert!(same, "{}: targets of the state", case.name);
        let old: Vec<u32> = (1..=case.state.component_volume.len() as u32).collect();
        run.record(&[&run.origins, &run.components]);
        let origins = run.origins(&old);
        let close = check_origins(&run, case.ballistic(), &case.state.component, &origins);
        assert!(close <= 2 + grid.n_cells() / 50, "{}: {close}", case.name);
        let phi = run.distance();
        let twin = check_components(&run, &phi, &case.state.component_volume, &origins);
        run.record(&[&run.excess]);
        dense += check_excess(&run, &phi, &fraction, &twin);
        // The excess is in the way of the areas, which are zero after the components.
        run.write();
        run.record(&[&run.origins, &run.components, &run.shift]);
        let counts = check_shift(&run, &phi, &twin);
        moved = [0, 1, 2].map(|n| moved[n] + counts[n]);
        run.record(&[&run.excess]);
        let first = run.bits();
        run.write();
        run.record(&[&run.origins, &run.components, &run.shift, &run.excess]);
        assert!(first == run.bits(), "{}: again", case.name);
        most = most.max(twin.volume.len());
        enclosed += twin.enclosed.iter().filter(|enclosed| **enclosed).count();
        flown += check_flights(&run, &mut random);
    }
    let counts = [most, moved[0], moved[1], moved[2], dense, enclosed, flown];
    let least = [20, 20, 10, 10, 100, 1, 20];
    let enough = counts.iter().zip(least).all(|(count, least)| *count >= least);
    assert!(enough, "{counts:?}");
}

/// Asserts that flights change the targets by eighths; how many components have some.
fn check_flights(run: &Run, random: &mut Random) -> usize {
    let before = run.gpu.download(&run.level.component_volume).unwrap();
    let mut flights = vec![0; run.liquid.padded.len()];
    let labels = run.labels();
    for &label in &labels {
        flights[label as usize] = (random.bits() % 9) as i32 - 4;
    }
    run.gpu.upload(&run.level.component_flights, &flights);
    run.record(&[&run.settle]);
    let after = run.gpu.download(&run.level.component_volume).unwrap();
    for (cell, (before, after)) in before.iter().zip(&after).enumerate() {
        assert_eq!(before + 0.125 * flights[cell] as f32, *after);
    }
    let left = run.gpu.download(&run.level.component_flights).unwrap();
    assert!(left.iter().all(|&flights| flights == 0));
    flights.iter().filter(|flights| **flights != 0).count()
}

/// Balls in a moving band: two that meet and part, and a drop.
struct Balls {
    grid: Grid,
}

impl Balls {
    fn distance(&self, ball: f64, x: DVec3) -> f64 {
        let left = DVec3::new(8.0 + ball, 12.0, 10.3);
        let right = DVec3::new(60.0 - ball, 12.4, 9.8);
        let drop = DVec3::new(20.0 + 0.6 * ball, 20.0, 4.0);
        let x = x / self.grid.dx;
        let of = |centre: DVec3, radius: f64| x.distance(centre) - radius;
        of(left, 4.3).min(of(right, 4.8)).min(of(drop, 1.9)).min(5.0)
    }
}

#[test]
fn components_merge_and_split_as_in_the_twin() {
    let Some(gpu) = gpu() else { return };
    let mut case = level_cases().swap_remove(4);
    assert!(!case.effects.obstacles && !case.effects.open_sides);
    let grid = Grid { cells: [70, 26, 21], dx: 0.0625 };
    case.grid = grid;
    case.cut = closed_cut(&grid);
    case.state = State::at_rest(&grid);
    case.dt = 0.0625;
    // Some positions for the most cells with liquid that there are.
    let capacity = 1400;
    case.state.markers = vec![[0.0; 3]; capacity];
    case.state.marker_velocity = vec![[0.0; 3]; capacity];
    case.state.spray = vec![false; capacity];
    let balls = Balls { grid };
    let one = grid.cell_volume();
    let at = |ball: f64, cell: usize| {
        let x = grid.cell_centre(grid.cell_at(cell));
        single(grid.dx * balls.distance(ball, x))
    };
    // Components of the state.
    let ways = |n: i32| f64::from(if n <= 26 { n } else { 52 - n });
    let phi: Vec<f64> = (0..grid.n_cells()).map(|cell| at(ways(15), cell)).collect();
    let open = reference::open_volumes(&grid, &case.cut.solid_distance);
    let level: Vec<f64> = phi.iter().map(|phi| phi / grid.dx).collect();
    let first = reference::liquid_components(&grid, &case.cut.open, &open, &level);
    case.state.component = first.label;
    case.state.component_volume = first.volume.iter().map(|v| single(v / one) * one).collect();
    case.state.liquid_distance = phi;
    let whole: f64 = first.volume.iter().sum();
    let mut counts = Vec::new();
    let mut left = 0;
    let mut outside = 0;
    // The velocity of a sub-step turns round with the balls.
    let with_velocity = |sign: f64| {
        Axis::ALL.map(|axis| {
            let face = |face: usize| {
                let x = grid.face_centre(axis, grid.face_at(axis, face));
                let side = if x.x < 34.0 * grid.dx { 1.0 } else { -1.0 };
                if axis == Axis::X { sign * side } else { 0.0 }
            };
            (0..grid.n_faces(axis)).map(face).collect::<Vec<f64>>()
        })
    };
    case.state.velocity = with_velocity(1.0);
    let mut twice: Vec<Vec<u32>> = Vec::new();
    for time in 0..2 {
        let run = Run::new(gpu, &case, single(whole));
        run.write();
        let band = stages::band(gpu, &run.liquid, Some(&run.level)).unwrap();
        let mut bits = Vec::new();
        for n in 16..=37 {
            let velocity = with_velocity(if n <= 26 { 1.0 } else { -1.0 });
            gpu.upload(&run.liquid.velocity, &run.liquid.pad_faces(&velocity));
            let before = run.state();
            let old = run.labels();
            let liquid = (0..grid.n_cells()).filter(|&cell| at(ways(n), cell) < 0.0);
            let mut markers: Vec<[f32; 4]> = liquid
                .map(|cell| grid.cell_centre(grid.cell_at(cell)).as_vec3())
                .map(|x| [x.x, x.y, x.z, 1.0])
                .collect();
            assert!(markers.len() <= capacity, "{}", markers.len());
            markers.resize(capacity, [0.0; 4]);
            gpu.upload(run.liquid.markers.as_ref().unwrap(), &markers);
            run.record(&[&band, &run.origins]);
            let in_band = case.in_band(gpu, &run.liquid);
            let phi = |cell| match in_band(grid.cell_at(cell)) {
                true => at(ways(n), cell),
                false => single(grid.dx),
            };
            let phi: Vec<f64> = (0..grid.n_cells()).map(phi).collect();
            let device = run.liquid.padded.pad(grid.cells, &phi, |phi| phi as f32);
            gpu.upload(&run.liquid.liquid_distance, &device);
            run.record(&[&run.components]);
            if time == 0 {
                let cells = (0..grid.n_cells()).filter(|&cell| in_band(grid.cell_at(cell)));
                left += grid.n_cells() - cells.count();
                let origins = run.origins(&old);
                // Outside the band are those of earlier sub-steps.
                let mut known = origins.clone();
                let far = (0..grid.n_cells()).filter(|&cell| !in_band(grid.cell_at(cell)));
                far.for_each(|cell| known[cell] = 0);
                let traced = Before { label: &before.component, velocity: &velocity, ballistic: Ballistic::NONE };
                let dt = case.dt;
                let twin = reference::component_origins(&grid, traced, |cell| phi[cell] < 0.0, dt);
                for (cell, origin) in twin.iter().enumerate().filter(|(_, origin)| **origin > 0) {
                    assert_eq!(*origin, known[cell], "{:?}, {n}", grid.cell_at(cell));
                }
                let twin = check_components(&run, &phi, &before.component_volume, &known);
                counts.push(twin.volume.len());
                run.record(&[&run.shift]);
                check_shift(&run, &phi, &twin);
                let labels = gpu.download(&run.level.component).unwrap();
                let flags = gpu.download(&run.liquid.band_flags).unwrap();
                let stale = labels.iter().enumerate();
                outside += stale.filter(|&(cell, &label)| label > 0 && flags[cell / 4] == 0).count();
            } else {
                run.record(&[&run.shift]);
            }
            bits.extend(run.bits());
        }
        twice.push(bits);
    }
    assert!(twice[0] == twice[1], "again");
    assert!(left > 0, "the band leaves nothing out");
    assert_eq!(outside, 0, "labels outside the band");
    assert_eq!([counts[0], counts[10], counts[21]], [3, 2, 3], "{counts:?}");
}

/// A grid without bodies and closed walls.
fn closed_cut(grid: &Grid) -> cutwater::geometry::CutCells {
    let open = Axis::ALL.map(|axis| {
        let open = |face: usize| {
            let sides = grid.face_sides(axis, grid.face_at(axis, face));
            f64::from(!sides.contains(&None))
        };
        (0..grid.n_faces(axis)).map(open).collect()
    });
    cutwater::geometry::CutCells { open, solid_distance: vec![3.0 * grid.dx; grid.n_cells()] }
}

/// Liquid that fills a box has no surface to move and no excess.
#[test]
fn a_full_box_stays() {
    let Some(gpu) = gpu() else { return };
    let mut case = level_cases().swap_remove(4);
    let grid = case.grid;
    assert!(!case.effects.obstacles && !case.effects.open_sides);
    case.state.liquid_distance = vec![single(-2.0 * grid.dx); grid.n_cells()];
    case.state.component = vec![1; grid.n_cells()];
    case.state.component_volume = vec![grid.n_cells() as f64 * grid.cell_volume()];
    let run = Run::new(gpu, &case, single(1.5 * case.state.component_volume[0]));
    run.write();
    gpu.upload(&run.level.occupancy, &vec![1.5; run.liquid.padded.len()]);
    let phi = run.distance();
    run.record(&[&run.origins, &run.components, &run.shift, &run.excess]);
    let (volumes, enclosed) = run.volumes(&run.labels());
    assert_eq!((volumes, enclosed), (vec![grid.n_cells() as f64], vec![true]));
    assert_eq!(phi, run.distance());
    let excess = gpu.download(&run.level.excess).unwrap();
    assert!(excess.iter().all(|&e| e == 0.0));
}

#[test]
fn an_excess_is_a_source_as_in_the_twin() {
    let Some(gpu) = gpu() else { return };
    let reals = if gpu.has_f64() { &[Real::F32, Real::F64][..] } else { &[Real::F32] };
    let mut sources = 0;
    for case in level_cases() {
        let (grid, mut random) = (&case.grid, Random(9));
        let phi = &case.state.liquid_distance;
        let active = ActiveBuffers::new(&case, phi);
        let open_volumes = reference::open_volumes(grid, &case.cut.solid_distance);
        let e = |_| single(random.uniform(-1.6, 1.6));
        let e: Vec<f64> = (0..grid.n_cells()).map(e).collect();
        for &real in reals {
            let liquid = case.upload(gpu);
            let level = level_buffers(gpu, &case, &liquid);
            let solver = active.solver(gpu, real);
            let stage = |level| stages::right_hand_side(gpu, &liquid, level, &solver).unwrap();
            let device = liquid.padded.pad(grid.cells, &e, |e| e as f32);
            gpu.upload(&level.excess, &device);
            let run = |level| {
                gpu.upload(&liquid.velocity_next, &liquid.pad_faces(&case.state.velocity));
                let mut recorder = Recorder::new(gpu);
                stage(level).record(&mut recorder);
                recorder.submit();
                let rhs = solver.rhs.download(gpu).unwrap();
                liquid.padded.unpad(grid.cells, &rhs, |b| b)
            };
            let without = run(None);
            let rhs = run(Some(&level));
            assert_eq!(rhs, run(Some(&level)), "{}: again", case.name);
            let volume = |value: &f64| value * grid.dx * grid.dx;
            let mut twin = reference::RightHandSide { values: without.iter().map(volume).collect(), scale: 0.0 };
            let cells = active.cells.stencil.active_cells().into_iter();
            sources += active.cells.stencil.active_cells().len();
            let times = [1.0, f64::from(case.dt as f32)];
            reference::add_excess(&e, &open_volumes, cells, times, &mut twin);
            // The source: the time, the open volume, dx and three products; the sum with what was there.
            let source = grid.dx / (2.5 * times[0]).max(1.5 * times[1]);
            let in_sum = if real == Real::F32 { EPS } else { 1e-9 * EPS };
            assert_close(
                case.name,
                (0..grid.n_cells()).map(|cell| {
                    let twin = twin.values[cell] / (grid.dx * grid.dx);
                    let bound = 16.0 * EPS * source + in_sum * (twin.abs() + source);
                    (rhs[cell], twin, bound, grid.cell_at(cell))
                }),
            );
        }
    }
    assert!(sources > 1000);
}
