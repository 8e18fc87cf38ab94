//! Sources and sinks with markers: what comes in, what goes out, what is left. With a level: `level_exchange`.

use std::f64::consts::PI;
use std::path::Path;

use cutwater::Error;
use cutwater::geometry::{SourcesAndSinks, obstacle_cut};
use cutwater::scene::{Scene, VectorKeyframe};
use cutwater::sim::{Backend, Plan, Simulation};
use cutwater::state::{Exchange, SolveStatus, State, StepReport};

use crate::common::{adapter, gpu};

fn parse(rest: &str) -> Result<Scene, Error> {
    let text = format!("[domain]\nsize = [0.5, 0.5, 0.25]\ncells = [16, 16, 8]\n[time]\nduration = 1.0\n{rest}");
    Scene::parse(Path::new("taps.toml"), &text, &[], 1.0)
}

fn on_gpu(scene: &Scene) -> Simulation {
    Simulation::new(scene, &Backend::Gpu(adapter())).unwrap()
}

/// Sub-steps up to a frame; the sum of what came and went.
fn run(simulation: &mut Simulation, frame: u64, mut each: impl FnMut(&StepReport)) -> Exchange {
    let mut sum = Exchange::default();
    while simulation.clock().frame < frame {
        let report = simulation.step().unwrap();
        let liquid = report.liquid.unwrap();
        assert_eq!(liquid.solve.status, SolveStatus::Converged, "{report:?}");
        let of = liquid.exchange.unwrap();
        sum = Exchange {
            left: sum.left + of.left,
            sunk: sum.sunk + of.sunk,
            emitted: sum.emitted + of.emitted,
            volume_left: sum.volume_left + of.volume_left,
            volume_sunk: sum.volume_sunk + of.volume_sunk,
            volume_emitted: sum.volume_emitted + of.volume_emitted,
        };
        each(&report);
    }
    sum
}

const POOL: &str = "[[liquid.region]]\nhalf_space = { point = [0.0, 0.125, 0.0], normal = [0.0, 1.0, 0.0] }\n";
/// 4 x 4 cells of 1/32 m across, below the ceiling.
const TAP: &str =
    "[[source]]\nbox = { min = [0.125, 0.375, 0.0625], max = [0.25, 0.5, 0.1875] }\nvelocity = [0.0, -1.0, 0.0]\n";

#[test]
fn what_is_no_source_or_sink_is_refused() {
    let liquid = format!("[liquid]\n{POOL}");
    let fixed = format!("[liquid]\nsurface = \"fixed\"\n{POOL}");
    let solid = "[[solid]]\nname = \"a\"\nmesh = { box = { size = [0.1, 0.1, 0.1], cells = [1, 1, 1] } }\n\
                 placement = { translate = [0.2, 0.2, 0.1] }\ndensity = 1000.0\nyoung = 1e5\npoisson = 0.3\n";
    let shape = "box = { min = [0.1, 0.1, 0.1], max = [0.2, 0.2, 0.2] }";
    let source = |rest: &str| format!("{liquid}[[source]]\n{shape}\n{rest}\n");
    for (text, line, key, cure) in [
        (format!("{liquid}[[source]]\n{shape}\n"), 9, "source[0]", "velocity, flow_rate"),
        (source("velocity = [0, 1, 0]\nflow_rate = 0.001"), 9, "source[0]", "keep one velocity or flow rate"),
        (source("velocity = [0, 1, 0]\ndirection = [0, 1, 0]"), 12, "source[0].direction", "flow_rate = 0.001"),
        (source("flow_rate = 0.001"), 9, "source[0].direction", "direction = [0, -1, 0]"),
        (source("flow_rate = 0\ndirection = [0, 1, 0]"), 11, "source[0].flow_rate", "above zero"),
        (source("flow_rate = 1e5\ndirection = [0, 1, 0]"), 11, "source[0].flow_rate", "a litre per second is 0.001"),
        (source("velocity = [0, 0, 0]"), 11, "source[0].velocity", "emits nothing"),
        (source("velocity = [0, 1e7, 0]"), 11, "source[0].velocity", "1e6"),
        (source("velocity = [0, 1]"), 11, "source[0].velocity", "a list of 3"),
        (source("velocity = [0, 1, 0]\nstart = -1.0"), 12, "source[0].start", "0 s or later"),
        (source("velocity = [0, 1, 0]\nstart = 2.0\nend = 2.0"), 13, "source[0].end", "after the start"),
        (
            source("velocity = [0, 1, 0]\nvelocity_keyframes = [{ t = 0, velocity = [0, 1, 0] }]"),
            9,
            "source[0]",
            "keep one velocity or flow rate",
        ),
        (source("velocity_keyframes = []"), 11, "source[0].velocity_keyframes", "write velocity_keyframes = [{ t = 0"),
        (
            source("velocity_keyframes = [{ t = 0, velocity = [0, 1, 0] }, { t = 0, velocity = [0, 2, 0] }]"),
            11,
            "source[0].velocity_keyframes[1].t",
            "ascending order",
        ),
        (
            source("velocity_keyframes = [{ t = 0, velocity = [0, 1] }]"),
            11,
            "source[0].velocity_keyframes[0].velocity",
            "a list of 3",
        ),
        (source("velocity_keyframes = [{ t = 0 }]"), 11, "source[0].velocity_keyframes[0]", "velocity = [0, -1, 0]"),
        (
            source("velocity_keyframes = [{ t = 0, velocity = [0, 0, 0] }]"),
            11,
            "source[0].velocity_keyframes",
            "emits nothing",
        ),
        (
            source("velocity_keyframes = [{ t = 0, velocity = [0, 2, 0] }, { t = 1, velocity = [0, -1, 0] }]"),
            11,
            "source[0].velocity_keyframes",
            "[0.0, -1.0, 0.0] m/s at 1 s is not along [0.0, 2.0, 0.0]\n  cure: keep one direction",
        ),
        (
            source("velocity_keyframes = [{ t = 0, velocity = [0, 2, 0] }]\ndirection = [0, 1, 0]"),
            12,
            "source[0].direction",
            "flow_rate = 0.001",
        ),
        (
            source("flow_rate_keyframes = [{ t = 0, flow_rate = -1 }]\ndirection = [0, 1, 0]"),
            11,
            "source[0].flow_rate_keyframes[0].flow_rate",
            "0 to close the source",
        ),
        (
            source("flow_rate_keyframes = [{ t = 0, flow_rate = 0 }]\ndirection = [0, 1, 0]"),
            11,
            "source[0].flow_rate_keyframes",
            "a litre per second is 0.001",
        ),
        (
            source("flow_rate_keyframes = [{ t = 0, flow_rate = 0.001 }]"),
            9,
            "source[0].direction",
            "direction = [0, -1, 0]",
        ),
        (source("velocity = [0, 1, 0]\nspeed = 2.0"), 12, "source[0].speed", "unknown key"),
        (format!("{liquid}[[source]]\nvelocity = [0, 1, 0]\n"), 9, "source[0]", "box, sphere, cylinder"),
        (
            format!("{liquid}[[source]]\nsphere = {{ centre = [2, 2, 2], radius = 0.1 }}\nvelocity = [0, 1, 0]\n"),
            10,
            "source[0].sphere",
            "outside the domain",
        ),
        (format!("{liquid}[[sink]]\n{shape}\nvelocity = [0, 1, 0]\n"), 11, "sink[0].velocity", "unknown key"),
        (format!("{liquid}[source]\n{shape}\n"), 9, "source", "[[source]]"),
        (format!("{fixed}[[sink]]\n{shape}\n"), 10, "sink", "markers"),
        (format!("{solid}[[sink]]\n{shape}\n"), 13, "sink", "[liquid]"),
        (format!("{liquid}{}", format!("[[sink]]\n{shape}\n").repeat(33)), 9, "sink", "at most 32"),
    ] {
        let refused = parse(&text).unwrap_err();
        let message = refused.to_string();
        let place = format!("taps.toml:{line}: {key}");
        assert!(message.contains(&place) && message.contains(cure), "{place}, {cure}: {message}\n{text}");
        assert_eq!(refused.exit_code(), 2);
    }
    // Between the centres of cells, and in an obstacle: known only on the grid.
    let thin =
        source("velocity = [0, 1, 0]").replace(shape, "box = { min = [0.1, 0.1, 0.1], max = [0.2, 0.101, 0.2] }");
    let buried =
        source("velocity = [0, 1, 0]") + "[[obstacle]]\nbox = { min = [0.0, 0.0, 0.0], max = [0.3, 0.3, 0.25] }\n";
    for text in [thin, buried] {
        let refused = Plan::new(&parse(&text).unwrap(), None).unwrap_err();
        let message = refused.to_string();
        assert!(message.contains("taps.toml:9: source[0]") && message.contains("at least a cell thick"), "{message}");
        assert_eq!(refused.exit_code(), 2);
    }
}

/// |v| times the projected area, whatever the cells, the shape and the direction. Shares of faces are scaled to that sum, but for those that
/// would be above 1, and stored in single precision: 1e-3 is for the former.
#[test]
fn a_source_emits_its_speed_times_its_projected_area() {
    let shapes = [
        (
            "cylinder = { base = [0.2, 0.5, 0.2], axis = [0, -1, 0], radius = 0.03, height = 0.05 }",
            [PI * 0.03 * 0.03, 2.0 * 0.03 * 0.05],
        ),
        ("cylinder = { base = [0.21, 0.4, 0.19], axis = [0.6, 0.8, 0], radius = 0.041, height = 0.09 }", [0.0; 2]),
        ("sphere = { centre = [0.2, 0.3, 0.2], radius = 0.047 }", [PI * 0.047 * 0.047; 2]),
        ("box = { min = [0.151, 0.22, 0.13], max = [0.233, 0.283, 0.211] }", [0.082 * 0.081, 0.063 * 0.081]),
    ];
    for scale in [0.7, 1.0, 1.2, 1.5, 2.0] {
        for (shape, known) in &shapes {
            for way in [[0.0, -1.5, 0.0], [1.5, 0.0, 0.0], [1.5, -1.5, 0.0], [0.3, 1.1, -0.7]] {
                let text = format!(
                    "[domain]\nsize = [0.4, 0.6, 0.4]\ncells = [20, 30, 20]\n[time]\nduration = 1.0\n[liquid]\nsurface = \"markers\"\n[[source]]\n{shape}\nvelocity = {way:?}\n"
                );
                let scene = Scene::parse(Path::new("taps.toml"), &text, &[], scale).unwrap();
                let [flow] = Plan::new(&scene, None).unwrap().sources[..] else {
                    panic!("one source");
                };
                let ratio = flow.flow_rate / flow.unobstructed;
                let what = format!("{shape}, {way:?}, scale {scale}: {ratio}");
                assert!((ratio - 1.0).abs() < 1e-3, "{what}");
                let area = match way {
                    [_, _, 0.0] if way[0] == 0.0 => known[0],
                    [_, 0.0, 0.0] => known[1],
                    _ => continue,
                };
                let expected = area * 1.5;
                assert!(area == 0.0 || (flow.unobstructed / expected - 1.0).abs() < 1e-12, "{what}");
            }
        }
    }
}

/// A round tap above an empty tank at five resolutions: what `steps.csv` says came out after its start, over the time. Markers stand for the
/// volume roughly: a source that is 1.75 cells thick makes a third fewer, one of 2.5 cells an eighth more.
#[test]
fn a_round_tap_emits_alike_at_every_scale() {
    for scale in [0.7, 1.0, 1.2, 1.5, 2.0] {
        let text = "[domain]\nsize = [0.4, 0.6, 0.4]\ncells = [20, 30, 20]\n[time]\nduration = 0.1667\nframes_per_second = 30\n[liquid]\nsurface = \"markers\"\n\
                    [[source]]\ncylinder = { base = [0.2, 0.5, 0.2], axis = [0, -1, 0], radius = 0.03, height = 0.05 }\nvelocity = [0, -1.5, 0]\n";
        let scene = Scene::parse(Path::new("tap.toml"), text, &[], scale).unwrap();
        let mut simulation = Simulation::new(&scene, &Backend::Cpu).unwrap();
        let area = PI * 0.03 * 0.03;
        let first = simulation.step().unwrap();
        let start = first.liquid.unwrap().exchange.unwrap();
        let fill = start.volume_emitted - 1.5 * area * first.dt;
        // Half a marker, and the samples of the shape.
        let bound = 0.5 * scene.grid().cell_volume() / 8.0 + 0.03 * 0.05 * area;
        assert!((fill - 0.05 * area).abs() < bound, "{scale}: {fill} m^3");
        let before = simulation.clock().time;
        let sum = run(&mut simulation, 2, |report| {
            // From the tap on it falls by some centimetres.
            let speed = report.liquid.unwrap().diagnosis.max_speed;
            assert!((1.4..4.0).contains(&speed), "{scale}: {speed} m/s");
        });
        let time = simulation.clock().time - before;
        let ratio = sum.volume_emitted / (1.5 * area * time);
        assert!((ratio - 1.0).abs() < 1e-3, "{scale}: {ratio}");
        let markers = sum.emitted as f64 * scene.grid().cell_volume() / 8.0 / sum.volume_emitted;
        println!("scale {scale}: {ratio} of the volume, {markers} of the markers");
        assert!((markers - 1.0).abs() < 0.35, "{scale}: {markers} of the markers");
    }
}

/// A flow rate is what comes out, also where a wall covers half of the source: the liquid is faster there.
#[test]
fn a_flow_rate_is_what_comes_out() {
    let source = |rest: &str| {
        let text = format!(
            "[liquid]\nsurface = \"markers\"\n{POOL}[[source]]\nbox = {{ min = [0.125, 0.375, 0.0625], max = [0.25, 0.5, 0.1875] }}\n{rest}"
        );
        parse(&text).unwrap()
    };
    let plate = "[[obstacle]]\nbox = { min = [0.125, 0.3, 0.0], max = [0.1875, 0.5, 0.25] }\n";
    let litre = "flow_rate = 0.001\ndirection = [0, -1, 0]\n";
    let flow = |scene: &Scene| Plan::new(scene, None).unwrap().sources[0];
    let area = 0.125 * 0.125;
    for (wall, open) in [("", 1.0), (plate, 0.5)] {
        let of = flow(&source(&format!("{litre}{wall}")));
        assert!((of.flow_rate / 1e-3 - 1.0).abs() < 1e-9, "{of:?}");
        let speed = 1e-3 / (open * area);
        assert!((of.velocity.length() / speed - 1.0).abs() < 1e-9, "{of:?}");
        let of = flow(&source(&format!("velocity = [0, -1, 0]\n{wall}")));
        assert!((of.flow_rate / (open * area) - 1.0).abs() < 1e-9, "{of:?}");
    }
    // A cylinder's flow goes along its axis.
    let text = "[liquid]\n[[source]]\ncylinder = { base = [0.2, 0.3, 0.1], axis = [0, 0, 1], radius = 0.07, height = 0.1 }\nflow_rate = 0.002\n";
    let of = flow(&parse(text).unwrap());
    assert!((of.flow_rate / 2e-3 - 1.0).abs() < 1e-3, "{of:?}");
    assert!(of.velocity.z > 0.0 && of.velocity.truncate().length() == 0.0);
    // Up against the ceiling nothing can leave.
    let covered = source("flow_rate = 0.001\ndirection = [0, 1, 0]\n");
    let message = Plan::new(&covered, None).unwrap_err().to_string();
    assert!(message.contains("source[0]: walls leave too little"), "{message}");
}

/// From an empty tank: what fills the source at its start, and then A v t, exactly in what is to be held. The volume of the union of spheres
/// follows once the pool has more of it than the jet, which is a cell fatter than it should be: 1.02 of it from 1.3 s on. A source four cells
/// thick makes a sixth more markers than its flux has, one of a single cell a fifth less.
#[test]
fn a_source_fills_a_tank_at_the_rate_it_says() {
    let Some(_) = gpu() else { return };
    let mut scene = parse(&format!("[liquid]\nsurface = \"markers\"\n{TAP}")).unwrap();
    scene.time.duration = 2.0;
    let mut simulation = on_gpu(&scene);
    assert!(simulation.state().unwrap().markers.is_empty());
    let (source, rate) = (0.125 * 0.125 * 0.125, 0.125 * 0.125 * 1.0);
    let sum = run(&mut simulation, 36, |report| {
        let speed = report.liquid.unwrap().diagnosis.max_speed;
        assert!(speed < 8.0, "{report:?}");
    });
    let state = simulation.state().unwrap();
    let expected = source + rate * 1.5;
    assert!((state.volume_0 / expected - 1.0).abs() < 1e-9, "{} m^3 to hold", state.volume_0);
    assert!((sum.volume_emitted / expected - 1.0).abs() < 1e-9);
    let (mut ratio, mut n) = (0.0, 0.0);
    let mut time = 1.5;
    run(&mut simulation, 42, |report| {
        time += report.dt;
        ratio += report.liquid.unwrap().diagnosis.volume / (source + rate * time);
        n += 1.0;
    });
    let markers = state.markers.len() as f64 / (8.0 * expected * 32f64.powi(3));
    println!("volume {} of what came in, markers {markers}", ratio / n);
    assert!((0.97..1.05).contains(&(ratio / n)), "{}", ratio / n);
    // Markers stand for the volume that they were made for.
    assert!((markers - 1.0).abs() < 0.25, "{markers} of the markers");
    assert_eq!(sum.emitted, state.markers_emitted);
    assert_eq!(state.markers_dropped, 0);
}

/// A source that starts late runs as long as it says; before and after, nothing is different from a scene without it.
#[test]
fn sources_keep_their_times() {
    let Some(_) = gpu() else { return };
    let scene = parse(&format!("[liquid]\nsurface = \"markers\"\n{POOL}{TAP}start = 0.25\nend = 0.5\n")).unwrap();
    let mut simulation = on_gpu(&scene);
    let start = simulation.state().unwrap();
    let before = run(&mut simulation, 6, |_| {});
    assert_eq!((before.emitted, before.volume_emitted), (0, 0.0));
    assert_eq!(simulation.state().unwrap().volume_0, start.volume_0);
    let during = run(&mut simulation, 12, |_| {});
    let expected = 0.125_f64.powi(3) + 0.125 * 0.125 * 0.25;
    assert!((during.volume_emitted / expected - 1.0).abs() < 1e-9, "{during:?}");
    assert!(simulation.state().unwrap().sources_running == 1);
    let after = run(&mut simulation, 18, |_| {});
    assert_eq!((after.emitted, after.volume_emitted), (0, 0.0));
    assert!(simulation.state().unwrap().sources_running == 0);
}

/// Up to 1 m/s and down again in half a second, off for a quarter, and on again. Keyframes are on frame times, where sub-steps end.
const PULSES: &str = "velocity_keyframes = [{ t = 0, velocity = [0, 0, 0] }, { t = 0.25, velocity = [0, -1, 0] }, \
                      { t = 0.5, velocity = [0, 0, 0] }, { t = 0.75, velocity = [0, 0, 0] }, { t = 1, velocity = [0, -1, 0] }]\n";

fn pulsing(surface: &str) -> Scene {
    let shape = TAP.split("velocity").next().unwrap();
    parse(&format!("[liquid]\nsurface = \"{surface}\"\n{POOL}{shape}{PULSES}")).unwrap()
}

/// The integral of the flow, and the volume of the source at each start.
#[test]
fn a_source_over_time_emits_the_integral_of_its_flow() {
    let Some(_) = gpu() else { return };
    let scene = pulsing("markers");
    let area = 0.125 * 0.125;
    for backend in [Backend::Cpu, Backend::Gpu(adapter())] {
        let mut simulation = Simulation::new(&scene, &backend).unwrap();
        let pulse = run(&mut simulation, 12, |_| {});
        let expected = 0.125 * area + 0.25 * area;
        assert!((pulse.volume_emitted / expected - 1.0).abs() < 1e-9, "{pulse:?}");
        let before = simulation.state().unwrap();
        let pause = run(&mut simulation, 18, |_| {});
        assert_eq!((pause.emitted, pause.volume_emitted), (0, 0.0));
        let after = simulation.state().unwrap();
        assert_eq!((after.volume_0, after.sources_running), (before.volume_0, 0));
        // What has not fallen out of the source is not filled again.
        let again = run(&mut simulation, 21, |_| {});
        let filled = again.volume_emitted - 0.125 * 0.5 * 0.5 * area;
        assert!((0.5 * 0.125 * area..=1.0 * 0.125 * area).contains(&filled), "{filled} m^3");
        assert!(simulation.state().unwrap().volume_0 > after.volume_0);
    }
}

/// A level moves with the velocity of the last sub-step: the volume that it exchanges is that of this velocity.
#[test]
fn a_level_over_time_emits_what_it_moves() {
    let Some(_) = gpu() else { return };
    let scene = pulsing("level");
    let speed = |times| VectorKeyframe::mean(&scene.sources[0].keyframes, times).length();
    for backend in [Backend::Cpu, Backend::Gpu(adapter())] {
        let mut simulation = Simulation::new(&scene, &backend).unwrap();
        let mut before = simulation.step().unwrap().dt;
        let start = simulation.state().unwrap().volume_0;
        let (mut expected, mut time) = (0.0, simulation.clock().time);
        while simulation.clock().frame < 10 {
            let report = simulation.step().unwrap();
            expected += report.dt * 0.125 * 0.125 * speed([time - before, time]);
            (before, time) = (report.dt, simulation.clock().time);
        }
        let state = simulation.state().unwrap();
        let emitted = state.volume_0 - start;
        // On the device volumes are multiples of 2^-23 cells, and their sums over the components in single precision.
        assert!((emitted / expected - 1.0).abs() < 1e-4, "{emitted} m^3, {expected} m^3");
        let volume = state.markers.len() as f64 * scene.grid().cell_volume() / 8.0;
        assert!(volume > 0.0 && state.sources_running == 1);
    }
}

/// A flow rate over time has its largest value in `plan`, and fractions of that later.
#[test]
fn a_flow_rate_over_time_has_its_fractions() {
    let shape = "[liquid]\n[[source]]\nbox = { min = [0.125, 0.375, 0.0625], max = [0.25, 0.5, 0.1875] }\n";
    let text = "flow_rate_keyframes = [{ t = 0.1, flow_rate = 0.001 }, { t = 0.2, flow_rate = 0.004 }, { t = 0.4, flow_rate = 0 }]\n\
                direction = [0, -1, 0]\n";
    let scene = parse(&format!("{shape}{text}")).unwrap();
    let grid = scene.grid();
    let cut = obstacle_cut(&scene, &grid).unwrap().cut;
    let mut taps = SourcesAndSinks::new(&scene, &grid, &cut).unwrap();
    let flow = Plan::new(&scene, None).unwrap().sources[0];
    assert!((flow.flow_rate / 0.004 - 1.0).abs() < 1e-12 && (flow.velocity.length() / 0.256 - 1.0).abs() < 1e-12);
    let running = |taps: &SourcesAndSinks, time| taps.running(&State { time, ..State::default() }, 0).running == 1;
    for (time, dt, rate) in [(0.0, 0.1, 0.001), (0.1, 0.1, 0.0025), (0.15, 0.1, 0.003375), (0.3, 0.1, 0.001)] {
        assert!(running(&taps, time) && taps.set_velocities(time, [0.05, dt]));
        let flux = taps.flux(1);
        assert!((flux / rate - 1.0).abs() < 1e-12, "{flux} m^3/s from {time} s on");
        let into_cells: f64 = taps.boundary_flux(&grid, None, 1).iter().map(|(_, flux)| -flux).sum();
        assert!((into_cells / rate - 1.0).abs() < 1e-12);
    }
    assert!(!running(&taps, 0.4) && running(&taps, 0.39));
    // The fastest from the beginning of the last sub-step to the end of the frame: 4 cells are thicker than the CFL condition has.
    for (time, times, speed) in
        [(0.0, [0.0, 0.1], 0.064), (0.0, [0.0, 0.5], 0.256), (0.3, [0.05, 0.1], 0.192), (0.5, [0.05, 0.1], 0.0)]
    {
        let of = taps.speed(time, times, 3.0);
        assert!((of - speed).abs() < 1e-12, "{of} m/s from {time} s on");
    }
}

/// Liquid that fills its vessel takes no more: a source in it asks for what cannot be, on both paths, and where there is air again it does not.
#[test]
fn a_source_in_a_full_vessel_is_told() {
    let block = "[solver]\ncoupling = \"weak\"\n[[solid]]\nname = \"block\"\nmesh = { box = { size = [0.125, 0.125, 0.125], cells = [1, 1, 1] } }\n\
                 placement = { translate = [0.35, 0.3, 0.125] }\ndensity = 1000.0\nyoung = 1e5\npoisson = 0.3\n";
    let scene = |level: f64, solid: &str| {
        parse(&format!(
            "[liquid]\nsurface = \"markers\"\n[[liquid.region]]\nhalf_space = {{ point = [0.0, {level}, 0.0], normal = [0.0, 1.0, 0.0] }}\n\
             [[source]]\nbox = {{ min = [0.125, 0.0625, 0.0625], max = [0.25, 0.125, 0.1875] }}\nvelocity = [1.0, 0.0, 0.0]\n{solid}"
        ))
        .unwrap()
    };
    for (level, solid, closed, status) in [
        (1.0, "", 1, SolveStatus::Incompatible),
        // A body that gives way too late.
        (1.0, block, 1, SolveStatus::Incompatible),
        (0.25, "", 0, SolveStatus::Converged),
    ] {
        let mut backends = vec![Backend::Cpu];
        backends.extend(gpu().map(|_| Backend::Gpu(adapter())));
        for backend in backends {
            let mut simulation = Simulation::new(&scene(level, solid), &backend).unwrap();
            let liquid = simulation.step().unwrap().liquid.unwrap();
            assert_eq!(liquid.closed_components, closed, "{backend:?}");
            assert_eq!(liquid.solve.status, status, "{backend:?}");
        }
    }
}

/// What a source fills, a body that is moved may leave: one judgement for both, on both paths.
#[test]
fn a_source_and_a_body_that_gives_way_to_it_are_told_together() {
    // The source gives 1 m/s through 0.0625 x 0.125 m; the top of the block, 0.125 x 0.125 m, sinks, and its bottom stays.
    let scene = |speed: f64| {
        let script = |low: f64, high: f64, down: f64| {
            format!(
                "[[solid.script]]\nregion = {{ box = {{ min = [0, {low:?}, 0], max = [1, {high:?}, 1] }} }}\n\
                 keyframes = [{{ t = 0 }}, {{ t = 0.1, translate = [0, {:?}, 0] }}]\n",
                -0.1 * down
            )
        };
        parse(&format!(
            "[liquid]\nsurface = \"markers\"\n[[liquid.region]]\nhalf_space = {{ point = [0.0, 1.0, 0.0], normal = [0.0, 1.0, 0.0] }}\n\
             [[source]]\nbox = {{ min = [0.125, 0.0625, 0.0625], max = [0.25, 0.125, 0.1875] }}\nvelocity = [1.0, 0.0, 0.0]\n\
             [[solid]]\nname = \"block\"\nmesh = {{ box = {{ size = [0.125, 0.125, 0.125], cells = [1, 1, 1] }} }}\n\
             placement = {{ translate = [0.35, 0.3, 0.125] }}\ndensity = 1000.0\nyoung = 1e5\npoisson = 0.3\n{}{}",
            script(0.0, 0.3, 0.0),
            script(0.3, 0.5, speed),
        ))
        .unwrap()
    };
    for (speed, status) in
        [(0.5, SolveStatus::Converged), (0.25, SolveStatus::Incompatible), (0.0, SolveStatus::Incompatible)]
    {
        let mut backends = vec![Backend::Cpu];
        backends.extend(gpu().map(|_| Backend::Gpu(adapter())));
        for backend in backends {
            let mut simulation = Simulation::new(&scene(speed), &backend).unwrap();
            let report = simulation.step().unwrap();
            assert_eq!(report.liquid.unwrap().closed_components, 1, "{backend:?}");
            for solve in report.solves() {
                assert_eq!(solve.status, status, "{backend:?}, {speed} m/s: {report:?}");
            }
        }
    }
}

/// A gate stands in half of the source at first and is gone after a tenth of a second: the source is where it would be without the gate.
#[test]
fn what_moves_away_takes_no_cells_of_a_source() {
    let gate = "[[obstacle]]\nbox = { min = [0.1875, 0.34375, 0.03125], max = [0.28125, 0.5, 0.21875] }\n\
                keyframes = [{ t = 0 }, { t = 0.1, translate = [0.2, 0, 0] }]\n";
    let scene = parse(&format!("[liquid]\nsurface = \"markers\"\n{POOL}{TAP}{gate}")).unwrap();
    let mut backends = vec![Backend::Cpu];
    if gpu().is_some() {
        backends.push(Backend::Gpu(adapter()));
    }
    for backend in backends {
        let mut simulation = Simulation::new(&scene, &backend).unwrap();
        let mut flux = 0.0;
        while simulation.clock().time < 0.3 {
            let report = simulation.step().unwrap();
            flux = report.liquid.unwrap().exchange.unwrap().volume_emitted / report.dt;
        }
        // 16 faces of 1/32 m, at 1 m/s.
        assert!((64.0 * flux - 1.0).abs() < 1e-9, "{}: {flux} m^3/s", backend.name());
    }
}

/// A gate slides over a source and away again. While it covers all of it nothing comes out; then the source is full again.
#[test]
fn what_a_gate_covers_gets_no_markers() {
    let gate = "[[obstacle]]\nbox = { min = [0.28125, 0.34375, 0.03125], max = [0.46875, 0.5, 0.21875] }\n\
                keyframes = [{ t = 0 }, { t = 0.05, translate = [-0.1875, 0, 0] }, { t = 0.15, translate = [-0.1875, 0, 0] }, { t = 0.2 }]\n";
    let scene = parse(&format!("[liquid]\nsurface = \"markers\"\n{POOL}{TAP}{gate}")).unwrap();
    let mut backends = vec![Backend::Cpu];
    backends.extend(gpu().map(|_| Backend::Gpu(adapter())));
    for backend in backends {
        let mut simulation = Simulation::new(&scene, &backend).unwrap();
        let mut covered = Vec::new();
        while simulation.clock().time < 0.25 {
            let report = simulation.step().unwrap();
            let emitted = report.liquid.unwrap().exchange.unwrap().emitted;
            if (0.05..0.15).contains(&simulation.clock().time) {
                covered.push(emitted);
            }
        }
        // At least those that end with a frame, at 2/24 and 3/24 s.
        assert!(covered.len() >= 2, "{}: {covered:?}", backend.name());
        assert!(covered.iter().all(|&emitted| emitted == 0), "{}: {covered:?}", backend.name());
        let (low, high) = ([0.125, 0.375, 0.0625], [0.25, 0.5, 0.1875]);
        let inside = |x: &&[f64; 3]| (0..3).all(|a| (low[a]..high[a]).contains(&x[a]));
        let state = simulation.state().unwrap();
        let n_inside = state.markers.iter().filter(inside).count();
        assert!(n_inside >= 8 * 64, "{}: {n_inside}", backend.name());
    }
}

/// A pump between a source and a sink: what is there, what came and what went add up, and in the end as much goes as comes.
#[test]
fn a_fountain_comes_to_a_steady_volume() {
    let Some(_) = gpu() else { return };
    let sink = "[[sink]]\nbox = { min = [0.4375, 0.125, 0.0], max = [0.5, 0.1875, 0.25] }\n";
    let scene = parse(&format!("[liquid]\nsurface = \"markers\"\n{POOL}{TAP}{sink}")).unwrap();
    for backend in [Backend::Gpu(adapter()), Backend::Cpu] {
        let frames = match backend {
            Backend::Gpu(_) => 96,
            Backend::Cpu => 6,
        };
        let mut simulation = Simulation::new(&scene, &backend).unwrap();
        let start = simulation.state().unwrap().volume_0;
        let mut flow = 0.0;
        run(&mut simulation, frames / 2, |report| {
            let of = report.liquid.unwrap().exchange.unwrap();
            flow += of.volume_emitted - of.volume_sunk;
        });
        let half = simulation.state().unwrap();
        let (mut worst, mut sum, mut n) = (0.0_f64, 0.0, 0.0);
        let late = run(&mut simulation, frames, |report| {
            let liquid = report.liquid.unwrap();
            let of = liquid.exchange.unwrap();
            flow += of.volume_emitted - of.volume_sunk;
            let ratio = liquid.diagnosis.volume / (start + flow);
            worst = worst.max((ratio - 1.0).abs());
            sum += ratio;
            n += 1.0;
        });
        let state = simulation.state().unwrap();
        let mean = sum / n;
        println!("volume over what came and went: mean {mean}, off by up to {worst}; {late:?}");
        assert!((state.volume_0 - start - flow).abs() < 1e-9 * start);
        assert!(state.markers_emitted > 0);
        if frames > 24 {
            // A fat jet over a small pool: what it is measured too fat, here a quarter, is the worst that may be.
            assert!((0.95..1.35).contains(&mean) && worst < 0.4, "{mean}, {worst}");
            // Longer than the scene says: slots of markers that sank are used again.
            assert!(state.markers_sunk > 0 && state.markers_emitted > half.markers_emitted);
            let ratio = late.volume_sunk / late.volume_emitted;
            assert!((0.85..1.15).contains(&ratio), "{ratio} of what came went");
        }
    }
}

#[test]
fn runs_with_sources_and_sinks_repeat_and_go_on_from_a_state() {
    let Some(_) = gpu() else { return };
    let sink = "[[sink]]\nsphere = { centre = [0.4, 0.06, 0.12], radius = 0.06 }\n";
    let scene = parse(&format!("[liquid]\nsurface = \"markers\"\n{POOL}{TAP}start = 0.05\n{sink}")).unwrap();
    let mut simulation = on_gpu(&scene);
    let start = simulation.state().unwrap();
    run(&mut simulation, 4, |_| {});
    let fourth = simulation.state().unwrap();
    assert!(fourth.markers_emitted > 0 && fourth.markers_sunk > 0);
    run(&mut simulation, 8, |_| {});
    let end = simulation.state().unwrap();
    for (from, what) in [(&start, "again"), (&fourth, "on from half the way")] {
        simulation.reset(from).unwrap();
        run(&mut simulation, 8, |_| {});
        assert!(simulation.state().unwrap() == end, "{what}");
    }
    // The same in another simulation, whose buffers hold nothing of the first.
    let mut other = on_gpu(&scene);
    other.reset(&fourth).unwrap();
    run(&mut other, 8, |_| {});
    assert!(other.state().unwrap() == end, "in another simulation");
}

#[test]
fn taps_take_room_and_kernels_only_where_they_are() {
    let sink = "[[sink]]\nsphere = { centre = [0.4, 0.06, 0.12], radius = 0.06 }\n";
    let plan = |rest: &str| {
        Plan::new(&parse(&format!("[liquid]\nsurface = \"markers\"\n{POOL}{rest}")).unwrap(), None).unwrap()
    };
    let [none, source, drain] = ["", TAP, sink].map(plan);
    let pulses = Plan::new(&pulsing("markers"), None).unwrap();
    for (plan, sources, sinks) in [(&none, false, false), (&source, true, false), (&drain, false, true)] {
        let has = |label: &str| plan.buffers.iter().any(|buffer| buffer.label.starts_with(label));
        assert_eq!([has("sources."), has("sinks.")], [sources, sinks]);
        let kernels: Vec<&str> = plan.stages.iter().flat_map(|stage| stage.kernels.iter().copied()).collect();
        for kernel in ["count_in_sources", "plan_seeds", "seed_markers", "hold_faces", "carry_faces"] {
            assert_eq!(kernels.contains(&kernel), sources, "{kernel}");
        }
        for kernel in ["sink_markers", "empty_sinks"] {
            assert_eq!(kernels.contains(&kernel), sinks, "{kernel}");
        }
        assert_eq!(plan.stages.iter().any(|stage| stage.name == "exchange"), sources || sinks);
    }
    // A second of 1/64 m^3/s, and a quarter more; the source's cells twice.
    let markers = |plan: &Plan| plan.buffers.iter().find(|b| b.label == "liquid.markers").unwrap().len;
    let room = 8 * (2 * 64 + (1.25 * 32f64.powi(3) / 64.0) as usize);
    assert_eq!(markers(&source), markers(&none) + room);
    // 0.375 s of that, and the source's cells thrice. Nothing else is larger.
    let room = 8 * (3 * 64 + (1.25 * 0.375 * 32f64.powi(3) / 64.0) as usize);
    assert_eq!(markers(&pulses), markers(&none) + room);
    let kernels = |plan: &Plan| plan.stages.iter().flat_map(|stage| stage.kernels.clone()).collect::<Vec<_>>();
    assert_eq!(kernels(&pulses), kernels(&source));
}
