//! Sources, sinks and open sides with a level set: volumes on both paths, and the GPU against the twin.

use std::path::Path;

use cutwater::effects::Effects;
use cutwater::fields::{
    ExchangeBuffers, LevelBuffers, LevelExchange, LiquidBuffers, LiquidPlan, Report, Sinks, SolverBuffers, SourceStep,
    Sources, Step,
};
use cutwater::geometry::{MARKERS_PER_CELL, MOST_SITES, Running, SourcesAndSinks, obstacle_cut};
use cutwater::gpu::{Gpu, Real, Recorder};
use cutwater::grid::{Axis, Grid, Sides};
use cutwater::reference::{self, Ballistic, filled};
use cutwater::scene::Scene;
use cutwater::sim::{Backend, Plan, Simulation};
use cutwater::stages;
use cutwater::state::{Exchange, LiquidReport};
use glam::DVec3;

use crate::common::{adapter, gpu};
use crate::level_case::with_level;
use crate::liquid_case::{Case, EPS, assert_close, single};
use crate::twin_exchange;

/// A pool in a box of cells of 1/32 m.
fn parse(rest: &str) -> Scene {
    let text = format!(
        "[domain]\nsize = [0.5, 0.5, 0.25]\ncells = [16, 16, 8]\n[time]\nduration = 1.0\nframes_per_second = 24\n{rest}"
    );
    Scene::parse(Path::new("flows.toml"), &text, &[], 1.0).unwrap()
}

/// Courant number of the surface.
const COURANT: f64 = 7.5;

const POOL: &str = "[liquid]\nsurface = \"level\"\n\
                    [[liquid.region]]\nhalf_space = { point = [0.0, 0.125, 0.0], normal = [0.0, 1.0, 0.0] }\n";
/// 4 x 4 x 4 cells below the ceiling.
const TAP: &str =
    "[[source]]\nbox = { min = [0.125, 0.375, 0.0625], max = [0.25, 0.5, 0.1875] }\nvelocity = [0.0, -1.0, 0.0]\n";
/// Beside the surface of the pool, cut by the post.
const DRAIN: &str = "[[sink]]\nbox = { min = [0.40625, 0.0625, 0.0], max = [0.5, 0.1875, 0.25] }\n\
     [[obstacle]]\nbox = { min = [0.39, 0.0, 0.1], max = [0.44, 0.11, 0.2] }\n";

fn backends() -> Vec<Backend> {
    let device = gpu().map(|_| Backend::Gpu(adapter()));
    std::iter::once(Backend::Cpu).chain(device).collect()
}

/// Sub-steps up to a frame; their sum.
fn run(simulation: &mut Simulation, frame: u64, mut each: impl FnMut(&LiquidReport)) -> Exchange {
    let mut sum = Exchange::default();
    while simulation.clock().frame < frame {
        let liquid = simulation.step().unwrap().liquid.unwrap();
        let of = liquid.exchange.unwrap();
        sum.left += of.left;
        sum.sunk += of.sunk;
        sum.emitted += of.emitted;
        sum.volume_left += of.volume_left;
        sum.volume_sunk += of.volume_sunk;
        sum.volume_emitted += of.volume_emitted;
        each(&liquid);
    }
    sum
}

/// Spray has an eighth of a cell each.
fn spray_volume(scene: &Scene, spray: &[bool]) -> f64 {
    let flying = spray.iter().filter(|spray| **spray).count();
    flying as f64 * scene.grid().cell_volume() / MARKERS_PER_CELL as f64
}

/// What comes less what goes is the change of the target, without open sides: a source that starts and stops, and a sink. All
/// numbers are f64 on the host; of the device's volumes each is a sum of whole units. The targets of the components and the spray
/// are that of the whole liquid, on the device to f32. The liquid follows its target: it lacks at most the dead band of the shift
/// (0.5 %), what a splash changes in a time of control, and the shape of the jet's edges, together 6 %.
#[test]
fn what_comes_less_what_goes_is_the_change_of_the_target() {
    let tap = format!("{TAP}start = 0.05\nend = 0.25\n");
    let scene = parse(&format!("{POOL}{tap}{DRAIN}"));
    for backend in backends() {
        let name = backend.name();
        let mut simulation = Simulation::new(&scene, &backend).unwrap();
        let start = simulation.state().unwrap().volume_0;
        let mut worst = 0.0_f64;
        let mut flow = 0.0;
        let sum = run(&mut simulation, 10, |liquid| {
            flow -= liquid.exchange.unwrap().outflow();
            worst = worst.max((liquid.diagnosis.volume / (start + flow) - 1.0).abs());
        });
        let state = simulation.state().unwrap();
        println!("{name}: {sum:?}, off by up to {worst}");
        let lost = state.markers_dropped as f64 * scene.grid().cell_volume() / 8.0;
        let difference = start + flow - state.volume_0;
        assert!((-1e-9 * start..=lost + 1e-9 * start).contains(&difference), "{name}: {difference:e}");
        let targets: f64 = state.component_volume.iter().sum();
        let whole = targets + spray_volume(&scene, &state.spray);
        let bound = if name == "cpu" { 1e-12 } else { 1e-5 };
        assert!((whole / state.volume_0 - 1.0).abs() < bound, "{name}: {whole} of {}", state.volume_0);
        assert!(worst < 0.06, "{name}: {worst}");
        // The cells of the source once, and its flux from its second sub-step to its end.
        let cells = 64.0 * scene.grid().cell_volume();
        let flux = 0.125 * 0.125;
        let most = cells + 0.2 * flux;
        // A sub-step is at most 3 cells of the fastest liquid, of 1 m/s or more, and one may end after the source does.
        let step = flux * 3.0 / 32.0;
        assert!((most - step..=most + step).contains(&sum.volume_emitted), "{name}: {} of {most}", sum.volume_emitted);
        assert!(sum.volume_sunk > 0.0 && sum.sunk > 0, "{name}");
        assert!(sum.emitted > 64 * 8, "{name}");
    }
}

/// Through an open side: the targets are those of what is left, with the limits. Those follow the measured volume, so the sum of
/// all is off by what the flux and the transport of the level differ: at most a twentieth of what there was, of which a third leaves over a step.
#[test]
fn what_leaves_through_an_open_side_is_gone() {
    let open = "[domain]\nsize = [0.5, 0.5, 0.25]\ncells = [16, 16, 8]\nopen = [\"+x\"]\n[time]\nduration = 1.0\nframes_per_second = 24\n";
    let tap = format!("{TAP}start = 0.02\nend = 0.2\n");
    let text = format!("{open}{POOL}{tap}[[obstacle]]\nbox = {{ min = [0.45, 0.0, 0.0], max = [0.5, 0.04, 0.25] }}\n");
    let scene = Scene::parse(Path::new("flows.toml"), &text, &[], 1.0).unwrap();
    let mut ends = Vec::new();
    for backend in backends() {
        let name = backend.name();
        let mut simulation = Simulation::new(&scene, &backend).unwrap();
        let start = simulation.state().unwrap().volume_0;
        let mut last = 0.0;
        let sum = run(&mut simulation, 12, |liquid| {
            last = liquid.diagnosis.volume;
        });
        let state = simulation.state().unwrap();
        let expected = start + sum.volume_emitted - sum.volume_left;
        println!("{name}: {start}, {sum:?}, {last}, {}", state.volume_0);
        assert!((last - expected).abs() < 0.05 * start, "{name}: {last}, {expected}");
        assert!((state.volume_0 - last).abs() < 0.1 * last, "{name}");
        let targets: f64 = state.component_volume.iter().sum();
        let whole = targets + spray_volume(&scene, &state.spray);
        let bound = if name == "cpu" { 1e-12 } else { 1e-5 };
        assert!((whole / state.volume_0 - 1.0).abs() < bound, "{name}");
        assert!(sum.volume_left > 0.25 * start && sum.left > 100, "{name}");
        ends.push([sum.volume_left, sum.volume_emitted, last]);
    }
    // The same on both, up to what a splash makes of roundings.
    if let [cpu, device] = &ends[..] {
        for (a, b) in cpu.iter().zip(device) {
            assert!((a - b).abs() < 0.03 * cpu[0], "{cpu:?}, {device:?}");
        }
    }
}

/// A source above a pool at rest that starts late: its volume is that of the drop it fills alone. Both paths; on the device the
/// targets are f32.
#[test]
fn a_first_fill_is_the_liquid_of_its_source() {
    let tap = TAP.replace("[0.0, -1.0, 0.0]", "[0.0, -0.01, 0.0]");
    let scene = parse(&format!("{POOL}{tap}start = 0.01\n"));
    for backend in backends() {
        let name = backend.name();
        let mut simulation = Simulation::new(&scene, &backend).unwrap();
        let pool = simulation.state().unwrap().component_volume;
        assert_eq!(pool.len(), 1, "{name}");
        let mut emitted = 0.0;
        while emitted == 0.0 {
            let liquid = simulation.step().unwrap().liquid.unwrap();
            emitted = liquid.exchange.unwrap().volume_emitted;
        }
        let cells = 64.0 * scene.grid().cell_volume();
        let state = simulation.state().unwrap();
        let bound = if name == "cpu" { 1e-12 } else { 1e-6 };
        let [lower, upper] = state.component_volume[..] else {
            panic!("{name}: {:?}", state.component_volume);
        };
        assert!((emitted / cells - 1.0).abs() < bound, "{name}: {emitted}");
        assert!((lower / pool[0] - 1.0).abs() < bound, "{name}: {lower}");
        assert!((upper / cells - 1.0).abs() < 4.0 * bound, "{name}: {upper}");
    }
}

/// A source in the middle of a pool: cells below the band emit no markers, and the volumes are those of others.
#[test]
fn a_source_below_the_surface_raises_it() {
    let deep = "[liquid]\nsurface = \"level\"\n\
                [[liquid.region]]\nhalf_space = { point = [0.0, 0.3125, 0.0], normal = [0.0, 1.0, 0.0] }\n\
                [[source]]\nbox = { min = [0.1875, 0.0, 0.0625], max = [0.3125, 0.0625, 0.1875] }\nvelocity = [0.0, 0.5, 0.0]\n";
    let scene = parse(deep);
    for backend in backends() {
        let name = backend.name();
        let mut simulation = Simulation::new(&scene, &backend).unwrap();
        let start = simulation.state().unwrap().volume_0;
        let mut last = 0.0;
        let sum = run(&mut simulation, 6, |liquid| last = liquid.diagnosis.volume);
        println!("{name}: {start}, {sum:?}, {last}");
        assert_eq!(sum.emitted, 0, "{name}");
        // It was full, and its first sub-step is at most a frame.
        let flux = 0.125 * 0.125 * 0.5;
        assert!(sum.volume_emitted <= flux * 6.0 / 24.0 * (1.0 + 1e-6), "{name}");
        assert!(sum.volume_emitted >= flux * 5.0 / 24.0 - 1e-6, "{name}");
        // The dead band of the shift is 0.5 %.
        let expected = start + sum.volume_emitted;
        assert!((last / expected - 1.0).abs() < 0.01, "{name}: {last}, {expected}");
    }
}

#[test]
fn runs_with_a_level_that_exchanges_resume_bitwise() {
    let open = "[domain]\nsize = [0.5, 0.5, 0.25]\ncells = [16, 16, 8]\nopen = [\"-x\"]\n[time]\nduration = 1.0\nframes_per_second = 24\n";
    let text = format!("{open}{POOL}{TAP}start = 0.06\nend = 0.14\n{DRAIN}");
    let scene = Scene::parse(Path::new("flows.toml"), &text, &[], 1.0).unwrap();
    for backend in backends() {
        let name = backend.name();
        let mut whole = Simulation::new(&scene, &backend).unwrap();
        // Before the source starts, while it runs, and after its end.
        for (frame, until) in [(1, 2), (2, 4), (5, 6)] {
            run(&mut whole, frame, |_| {});
            let (state, carried) = (whole.state().unwrap(), whole.carried().unwrap());
            let mut again = Simulation::new(&scene, &backend).unwrap();
            again.resume(&state, &carried).unwrap();
            let [a, b] = [&mut whole, &mut again].map(|simulation| {
                let sum = run(simulation, until, |_| {});
                (sum, simulation.state().unwrap(), simulation.carried().unwrap())
            });
            assert_eq!(a.0, b.0, "{name}: from frame {frame}");
            assert!(a == b, "{name}: from frame {frame}");
        }
        let state = whole.state().unwrap();
        let counts = [state.markers_left, state.markers_sunk, state.markers_emitted];
        assert!(counts.iter().all(|&n| n > 0), "{name}: {counts:?}");
    }
}

#[test]
fn the_exchange_of_a_level_has_kernels_and_arrays_only_where_it_is() {
    let plan = |text: &str| Plan::new(&parse(text), None).unwrap();
    let plain = plan(POOL);
    let [source, sink] = [TAP, "[[sink]]\nsphere = { centre = [0.4, 0.06, 0.12], radius = 0.06 }\n"]
        .map(|rest| plan(&format!("{POOL}{rest}")));
    let markers = plan(&format!("{POOL}{TAP}").replace("\"level\"", "\"markers\""));
    for (plan, has_sources, has_sinks) in
        [(&plain, false, false), (&source, true, false), (&sink, false, true), (&markers, false, false)]
    {
        let kernels: Vec<&str> = plan.stages.iter().flat_map(|stage| stage.kernels.clone()).collect();
        for (names, present) in [
            (
                &["fill_sources", "count_emitted", "scan_emitted", "emit_markers", "count_labelled", "add_sources"][..],
                has_sources,
            ),
            (&["sink_volumes", "sink_spray", "settle_removed"], has_sinks),
            (&["add_exchange", "report_exchange"], has_sources || has_sinks),
            (&["outflow", "limit_targets"], false),
        ] {
            for name in names {
                assert_eq!(kernels.contains(name), present, "{name}");
            }
        }
        let labels = plan.buffers.iter().map(|buffer| &*buffer.label);
        let labels: Vec<&str> = labels.filter(|label| label.starts_with("exchange.")).collect();
        assert_eq!(labels.contains(&"exchange.fills"), has_sources, "{labels:?}");
        assert_eq!(labels.contains(&"exchange.component_removed"), has_sinks, "{labels:?}");
        assert_eq!(labels.is_empty(), !has_sources && !has_sinks, "{labels:?}");
    }
}

/// The stages on one set of buffers: sources and sinks that overlap each other and an obstacle, all sides open.
struct Run<'a> {
    gpu: &'a Gpu,
    case: Case,
    taps: SourcesAndSinks,
    liquid: LiquidBuffers,
    level: LevelBuffers,
    solver: SolverBuffers,
    sources: Sources,
    sinks: Sinks,
    exchange: LevelExchange,
}

impl<'a> Run<'a> {
    fn new(gpu: &'a Gpu) -> Run<'a> {
        let scene = twin_exchange::scene();
        let (grid, cut, taps) = twin_exchange::stored(&scene);
        let effects = Effects { open_sides: true, ..Effects::of(&scene) };
        let case = Case::around("flows", (grid, effects, cut), 3.0, |_, _| 2);
        let mut case = with_level(case);
        case.sides = Axis::ALL
            .into_iter()
            .flat_map(|axis| [(axis, 0), (axis, 1)])
            .fold(Sides::default(), |sides, (axis, side)| sides.with(axis, side));
        for axis in Axis::ALL {
            for (face, open) in case.cut.open[axis.index()].iter_mut().enumerate() {
                if grid.wall(axis, grid.face_at(axis, face)).is_some() {
                    *open = [0.0, 0.3125, 1.0, 1.0][face % 4];
                }
            }
        }
        let open_volumes = reference::open_volumes(&grid, &case.cut.solid_distance);
        let level: Vec<f64> = case.state.liquid_distance.iter().map(|phi| phi / grid.dx).collect();
        let before = reference::liquid_components(&grid, &case.cut.open, &open_volumes, &level);
        assert!(before.volume.len() > 1);
        case.state.component = before.label;
        let targets = before.volume.iter().map(|volume| 1.05 * volume / grid.cell_volume());
        case.state.component_volume = targets.map(|target| single(target) * grid.cell_volume()).collect();
        let plan = LiquidPlan {
            grid,
            effects: case.effects,
            n_markers: case.state.markers.len() + MOST_SITES * taps.source_cells.len(),
            cfl: case.cfl,
            real: if gpu.has_f64() { Real::F64 } else { Real::F32 },
        };
        let liquid = LiquidBuffers::new(gpu, plan).unwrap();
        Run {
            level: LevelBuffers::new(gpu, plan).unwrap().unwrap(),
            solver: case.solved(gpu),
            sources: Sources::new(gpu, &liquid, &taps).unwrap().unwrap(),
            sinks: Sinks::new(gpu, &liquid, &taps).unwrap().unwrap(),
            exchange: LevelExchange::new(gpu, &liquid, &taps, case.sides).unwrap().unwrap(),
            gpu,
            case,
            taps,
            liquid,
        }
    }

    fn buffers(&self) -> ExchangeBuffers<'_> {
        ExchangeBuffers { sources: Some(&self.sources), sinks: Some(&self.sinks), level: Some(&self.exchange) }
    }

    fn step(&self) -> Step {
        let volume: f64 = self.case.state.component_volume.iter().sum();
        Step { volume_0: (1.3 * volume) as f32, ..self.case.step() }
    }

    /// Starts again from the state; the band without spray, which here is none.
    fn write(&self, running: Running) {
        self.case.write(self.gpu, &self.liquid);
        self.gpu.upload(&self.liquid.step, &[self.step()]);
        self.level.write_components(self.gpu, &self.case.state);
        self.gpu.upload(&self.level.marker_counts, &[0; 6]);
        let n_markers = self.case.state.markers.len();
        let dt = f64::from(self.case.dt as f32);
        let lattices = self.taps.lattices(&self.case.grid, TIME, dt);
        let step = SourceStep::new(running, n_markers);
        self.sources.write_step(self.gpu, step, &lattices);
        let renewed = self.renewed() / self.case.grid.cell_volume();
        self.level.write_step(self.gpu, [17, 3], COURANT, renewed);
        let one = self.case.grid.cell_volume();
        self.exchange.write_step(self.gpu, &self.taps, running, (dt, one));
        self.case.band(self.gpu, &self.liquid);
    }

    /// So that the largest component is controlled in part and the others are not.
    fn renewed(&self) -> f64 {
        let volumes = self.case.state.component_volume.iter();
        single(0.65 * volumes.fold(0.0, |most: f64, &volume| most.max(volume)))
    }

    fn cells(&self, values: &[f32]) -> Vec<f64> {
        self.liquid.padded.unpad(self.case.grid.cells, values, f64::from)
    }

    fn report(&self) -> Report {
        Report::from_words(&self.gpu.download(&self.liquid.report).unwrap())
    }
}

/// Start of the sub-step, s.
const TIME: f64 = 0.7;

#[test]
fn sources_emit_the_markers_of_the_twin() {
    let Some(gpu) = gpu() else { return };
    let run = Run::new(gpu);
    let grid = &run.case.grid;
    let [emission, ..] = run.sources.stages(gpu, &run.liquid).unwrap();
    let n = run.case.state.markers.len();
    let state = &run.case.state;
    let distance = &run.case.cut.solid_distance;
    let distance = reference::closed_to_markers(distance, &state.liquid_distance, grid.dx);
    let mut emitted = Vec::new();
    for running in twin_exchange::runs() {
        // The last moves a source by more than its cells.
        for dt in [0.004, 0.03, 0.4] {
            let lattices = run.taps.lattices(grid, TIME, dt);
            let step = SourceStep::new(running, n);
            let go = || {
                run.write(running);
                run.sources.write_step(gpu, step, &lattices);
                let mut recorder = Recorder::new(gpu);
                emission.record(&mut recorder);
                recorder.submit();
                let markers = gpu.download(run.liquid.markers.as_ref().unwrap()).unwrap();
                (markers, run.report().emitted)
            };
            let (markers, n_emitted) = go();
            assert!((markers.clone(), n_emitted) == go(), "again");
            let mut twin = Vec::new();
            let n_twin = reference::emit_markers(grid, &run.taps, running, &lattices, &distance, &mut twin);
            assert_eq!(u64::from(n_emitted), n_twin);
            let new = &markers[n..];
            assert!(new[twin.len()..].iter().all(|marker| *marker == [0.0; 4]));
            // Halves and quotients by powers of two are exact: a sum and a product are rounded.
            let bound = 2.0 * EPS * run.case.extent() * grid.dx;
            let pairs = new.iter().zip(&twin).enumerate();
            assert_close(
                "positions",
                pairs.flat_map(|(index, (gpu, twin))| {
                    (0..3).map(move |a| (f64::from(gpu[a]), twin[a], bound, [index, a, 0]))
                }),
            );
            emitted.push(n_twin);
        }
    }
    // None runs in the third. Sources that do not start emit less in a short sub-step: one runs in the second, where another starts.
    assert_eq!(emitted[6..9], [0; 3]);
    let growing = emitted[3..6].windows(2).all(|pair| pair[0] < pair[1]);
    assert!(emitted[3] > 0 && growing, "{emitted:?}");
}

/// Rounding of a volume of a cell to a unit of the sums.
const HALF_UNIT: f64 = 1.0 / (1 << 24) as f64;

#[test]
fn a_level_exchanges_as_in_the_twin() {
    let Some(gpu) = gpu() else { return };
    let run = Run::new(gpu);
    let (case, grid) = (&run.case, &run.case.grid);
    let one = grid.cell_volume();
    let transport = stages::advect_level(gpu, &run.liquid, &run.solver, &run.level).unwrap();
    let exchange = stages::exchange_level(gpu, &run.liquid, &run.level, run.buffers());
    let exchange = exchange.unwrap().unwrap();
    let components = stages::liquid_components(gpu, &run.liquid, &run.level, run.buffers()).unwrap();
    let open_volumes = reference::open_volumes(grid, &case.cut.solid_distance);
    let dt = f64::from(case.dt as f32);
    let velocity = &case.state.velocity;
    let mut seen = [false; 4];
    for running in twin_exchange::runs() {
        run.write(running);
        let mut recorder = Recorder::new(gpu);
        transport.record(&mut recorder);
        recorder.submit();
        // The twin of the exchange has the device's transport.
        let before = run.cells(&gpu.download(&run.level.carried_level).unwrap());
        let origins = || {
            let origins = gpu.download(&run.level.component_origin).unwrap();
            run.liquid.padded.unpad(grid.cells, &origins, |label| label)
        };
        let mut held = origins();
        reference::hold_source_origins(grid, &run.taps, running, &case.state.component, &mut held);
        let mut recorder = Recorder::new(gpu);
        exchange.record(&mut recorder);
        recorder.submit();
        let after = run.cells(&gpu.download(&run.level.carried_level).unwrap());
        assert!(origins() == held, "liquid in the cells of sources stays there");
        let in_band = case.in_band(gpu, &run.liquid);
        let mut twin = before.clone();
        let fills = reference::fill_sources(grid, &run.taps, running, &open_volumes, &mut twin);
        let level = case.state.liquid_distance.iter().map(|phi| phi / grid.dx);
        let level: Vec<f64> = level.collect();
        let sunk = reference::sunk_volumes(&run.taps, &open_volumes, Some(&level[..]), &twin);
        reference::empty_level_sinks(&run.taps, &mut twin);
        // The levels of both are copies, and those of the fills f32.
        assert_close(
            "level",
            (0..grid.n_cells())
                .filter(|&cell| in_band(grid.cell_at(cell)))
                .map(|cell| (after[cell], twin[cell], EPS, grid.cell_at(cell))),
        );
        let left = reference::outflow(grid, case.sides, &case.cut.open, velocity, &level, dt);
        let mut targets = case.state.component_volume.clone();
        reference::remove_volumes(&case.state.component, &left, &mut targets);
        reference::remove_volumes(&case.state.component, &sunk, &mut targets);
        // A filled share is off by 8 roundings; dt, dx and three products follow.
        let way = dt * case.speed() / grid.dx;
        let removed_bound =
            left.len() as f64 * (16.0 * EPS * way + HALF_UNIT) + sunk.len() as f64 * (16.0 * EPS + HALF_UNIT);
        let volumes = gpu.download(&run.level.component_volume).unwrap();
        assert_close(
            "targets less what left",
            targets.iter().enumerate().map(|(k, target)| {
                let target = target / one;
                let bound = removed_bound + 4.0 * EPS * target.abs();
                (f64::from(volumes[k + 1]), target, bound, [k, 0, 0])
            }),
        );
        let sum = |of: &[reference::CellVolume]| of.iter().map(|(_, volume)| volume / one).sum::<f64>();
        let filled_whole = fills.iter().sum::<f64>() / one;
        seen[0] |= sum(&left) > 1.0;
        seen[1] |= sum(&sunk) > 1.0;
        seen[2] |= filled_whole > 1.0;
        // Components of the level that is there now.
        let phi: Vec<f64> = (0..grid.n_cells())
            .map(|cell| match in_band(grid.cell_at(cell)) {
                true => single(after[cell] * grid.dx),
                false => single(5.0 * grid.dx),
            })
            .collect();
        let device = run.liquid.padded.pad(grid.cells, &phi, |phi| phi as f32);
        gpu.upload(&run.liquid.liquid_distance, &device);
        let mut recorder = Recorder::new(gpu);
        components.record(&mut recorder);
        recorder.submit();
        let exchanged = run.report().exchanged;
        let fill_bound = fills.len() as f64 * (16.0 * EPS + HALF_UNIT);
        assert_close(
            "totals",
            [
                (exchanged.left, sum(&left), removed_bound, [0; 3]),
                (exchanged.sunk, sum(&sunk), removed_bound, [1; 3]),
                (exchanged.filled, filled_whole, fill_bound, [2; 3]),
            ],
        );
        let new_level: Vec<f64> = phi.iter().map(|phi| phi / grid.dx).collect();
        let new = reference::liquid_components(grid, &case.cut.open, &open_volumes, &new_level);
        let mut state = case.state.clone();
        run.level.read_components(gpu, &mut state).unwrap();
        assert!(state.component == new.label, "labels");
        let origins = gpu.download(&run.level.component_origin).unwrap();
        let origins = run.liquid.padded.unpad(grid.cells, &origins, |label| label);
        let in_cell = |cell: usize| match new.label[cell] {
            0 => 0.0,
            _ => open_volumes[cell] * filled(new_level[cell]),
        };
        let in_cells: Vec<f64> = (0..grid.n_cells()).map(in_cell).collect();
        let mut shares = reference::shared_volumes(&targets, &origins, &new, &in_cells);
        let inflows: Vec<f64> = (0..3).map(|source| run.taps.inflow(running, source, dt)).collect();
        seen[3] |= inflows.iter().any(|&inflow| inflow > 0.0);
        reference::add_sources(&run.taps, &fills, &inflows, &new.label, &mut shares);
        let whole = f64::from(run.step().volume_0) + one * (filled_whole - sum(&left) - sum(&sunk));
        reference::balance(whole, &new.volume, &mut shares);
        let unlimited: f64 = shares.iter().sum();
        let limited = reference::limit_targets(&new.volume, run.renewed(), &mut shares);
        assert!((shares.iter().sum::<f64>() - unlimited - limited).abs() < 1e-12);
        // A target is a share of volumes that are off by at most 40 roundings of the whole and a rounding of each cell.
        let n = grid.n_cells() as f64;
        let bound = 40.0 * EPS * whole / one + n * (16.0 * EPS + HALF_UNIT) + removed_bound + fill_bound;
        assert_close(
            "targets",
            shares
                .iter()
                .zip(&state.component_volume)
                .enumerate()
                .map(|(k, (twin, gpu))| (gpu / one, twin / one, bound, [k, 1, 0])),
        );
        let limit_bound = new.volume.len() as f64 * bound;
        assert_close("limits", [(exchanged.limited, limited / one, limit_bound, [0; 3])]);
        assert_close("liquid", [(exchanged.liquid, new.volume.iter().sum::<f64>() / one, bound, [0; 3])]);
        // Exact sums: the host's bookkeeping is that of the targets but for their rounding.
        let sum_of_targets: f64 = state.component_volume.iter().sum();
        let booked = f64::from(run.step().volume_0) / one + exchanged.filled - exchanged.left - exchanged.sunk
            + exchanged.limited;
        assert_close("booked", [(sum_of_targets / one, booked, bound, [0; 3])]);
    }
    assert_eq!(seen, [true; 4], "left, sunk, filled, emitted");
    let distance = &case.cut.solid_distance;
    assert!(distance.iter().any(|&distance| distance < 0.0));
}

/// Cells of a source with two components: a third of them in one.
#[test]
fn a_source_in_two_components_shares_its_volume_by_cells() {
    let scene = twin_exchange::scene();
    let grid = scene.grid();
    let cut = obstacle_cut(&scene, &grid).unwrap().cut;
    let taps = SourcesAndSinks::new(&scene, &grid, &cut).unwrap();
    let own: Vec<usize> = taps.source_cells.iter().filter(|of| of.1 == 0).map(|of| of.0).collect();
    let mut label = vec![0; grid.n_cells()];
    for (index, &cell) in own.iter().enumerate() {
        label[cell] = [1, 2, 2, 0][index % 4];
    }
    let fills = vec![0.25; taps.source_cells.len()];
    let mut targets = [1.0, 2.0];
    reference::add_sources(&taps, &fills, &[9.0, 0.0, 0.0], &label, &mut targets);
    let counts = [1, 2].map(|k| label.iter().filter(|&&label| label == k).count() as f64);
    for k in 0..2 {
        let share = 9.0 * counts[k] / (counts[0] + counts[1]) + 0.25 * counts[k];
        assert!((targets[k] - 1.0 - k as f64 - share).abs() < 1e-12);
    }
}

/// Speeds of the last sub-step, which moved the level, count: through two open sides of a column in uniform motion leaves what
/// the transport loses, to the roundings of the sums.
#[test]
fn the_flux_of_a_full_column_is_the_loss_of_its_level() {
    let grid = Grid { cells: [6, 4, 4], dx: 0.25 };
    let side = Sides::default().with(Axis::X, 1);
    let level: Vec<f64> = (0..grid.n_cells())
        .map(|cell| {
            let x: DVec3 = grid.cell_centre(grid.cell_at(cell)) / grid.dx;
            2.25 - x.x
        })
        .collect();
    let faces = Axis::ALL.map(|axis| vec![if axis == Axis::X { 0.5 } else { 0.0 }; grid.n_faces(axis)]);
    let open = Axis::ALL.map(|axis| vec![1.0; grid.n_faces(axis)]);
    let dt = 0.2;
    let after = reference::advect_level(&grid, side, &faces, &Ballistic::NONE, &level, dt);
    let volume = |level: &[f64]| level.iter().map(|&phi| filled(phi)).sum::<f64>() * grid.cell_volume();
    let left = reference::outflow(&grid, side, &open, &faces, &level, dt);
    let left: f64 = left.iter().map(|(_, volume)| volume).sum();
    let lost = volume(&level) - volume(&after);
    assert!((left - lost).abs() < 1e-12, "{left} {lost}");
    assert!((left - 16.0 * 0.25 * 0.25 * 0.5 * dt).abs() < 1e-12);
}
