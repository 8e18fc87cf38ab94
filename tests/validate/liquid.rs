//! Cases of liquid alone.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicUsize, Ordering};

use cutwater::gpu::AdapterChoice;
use cutwater::grid::Axis;
use cutwater::reference::{larger, open_volumes};
use cutwater::scene::{Scene, Surface};
use cutwater::sim::{Backend, Simulation};
use cutwater::state::{SolveStatus, StepReport};
use glam::DVec3;

use crate::Case;
use crate::common::area_from_above;
use crate::page::{Line, Mark};
use crate::sheet::Sheet;

pub(crate) const GRAVITY: f64 = 9.81;

pub(crate) fn cases() -> Vec<Case> {
    vec![
        Case::new("F1", pool_at_rest),
        Case::new("F2", sphere_at_rest),
        Case::new("F3", dam_release),
        Case::new("F4", standing_wave),
        Case::new("F4/coarse", coarse_waves),
        Case::new("F11", collapsing_column),
        Case::new("free_fall", free_fall),
        Case::new("volume", volume),
        Case::new("volume/without", volume_without_control),
    ]
}

fn file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(name)
}

/// `--set KEY=VALUE` of the command line, with the number of scenes that it changed.
pub(crate) static SETTINGS: OnceLock<Vec<(String, AtomicUsize)>> = OnceLock::new();

/// Whether a text names a key in a table of it, or whole.
fn names(text: &str, key: &str) -> bool {
    let mut table = "";
    text.lines().map(str::trim).any(|line| {
        if line.starts_with('[') {
            table = line.trim_matches(['[', ']']);
        }
        let name = line.split('=').next().unwrap_or_default().trim();
        name == key || key.strip_prefix(table).and_then(|rest| rest.strip_prefix('.')) == Some(name)
    })
}

/// Overrides of a scene for keys that its text does not name: `--set`, and the surface of the published rows, markers. Keys of the liquid are for scenes
/// with regions of it. Separation needs markers.
pub(crate) fn settings_of(text: &str) -> Vec<String> {
    let mut settings: Vec<String> = Vec::new();
    let mut set = |setting: &str| {
        let key = setting.split('=').next().unwrap_or_default();
        let of_liquid = key.starts_with("liquid.") || key == "solver.pressure_on_patches";
        let fits = !of_liquid || text.contains("[[liquid.region]]");
        let separates = key == "liquid.surface" && names(text, "liquid.separation");
        let before = settings.iter().any(|before| before.split('=').next() == Some(key));
        let changes = fits && !separates && !names(text, key) && !before;
        if changes {
            settings.push(setting.to_owned());
        }
        changes
    };
    for (setting, changed) in SETTINGS.get().into_iter().flatten() {
        changed.fetch_add(usize::from(set(setting)), Ordering::Relaxed);
    }
    set("liquid.surface=markers");
    settings
}

/// A scene of `scenes/`, with overrides.
pub(crate) fn shipped(name: &str, overrides: &[&str], scale: f64) -> Scene {
    let path = file(&format!("scenes/{name}.toml"));
    let text = fs::read_to_string(&path).unwrap_or_else(|error| panic!("{name}: {error}"));
    let text = format!("{text}\n{}", overrides.join("\n"));
    let overrides = overrides.iter().map(|&text| text.to_owned()).chain(settings_of(&text)).collect::<Vec<_>>();
    Scene::load(&path, &overrides, scale).unwrap_or_else(|error| panic!("{error}"))
}

pub(crate) fn written(text: &str) -> Scene {
    let folder = tempfile::tempdir().expect("a folder for the scene");
    let path = folder.path().join("case.toml");
    fs::write(&path, text).expect("the scene is written");
    Scene::load(&path, &settings_of(text), 1.0).unwrap_or_else(|error| panic!("{error}"))
}

pub(crate) fn simulation(scene: &Scene, backend: &Backend) -> Simulation {
    Simulation::new(scene, backend).unwrap_or_else(|error| panic!("{error}"))
}

pub(crate) fn gpu() -> Backend {
    Backend::Gpu(AdapterChoice::Best)
}

/// One sub-step, whose solve must have converged.
pub(crate) fn step(simulation: &mut Simulation) -> StepReport {
    let report = simulation.step().unwrap_or_else(|error| panic!("{error}"));
    let liquid = report.liquid.expect("the scene has liquid");
    assert_eq!(liquid.solve.status, SolveStatus::Converged, "{report:?}");
    report
}

/// The numbers of a table with `#` lines and a line of names.
pub(crate) fn table(name: &str) -> Vec<Vec<f64>> {
    let text = fs::read_to_string(file(name)).unwrap_or_else(|error| panic!("{name}: {error}"));
    let rows = text.lines().filter(|line| !line.starts_with('#')).skip(1);
    rows.map(|line| {
        let fields = line.split(',');
        fields.map(|field| field.parse().expect("a number")).collect()
    })
    .collect()
}

/// Sub-steps of what should not move.
const AT_REST: usize = 20;

/// Largest speed of each of these, over g dt.
fn speeds_at_rest(simulation: &mut Simulation) -> Vec<f64> {
    (0..AT_REST).map(|_| speed(&step(simulation))).collect()
}

/// Largest speed over g dt.
fn speed(report: &StepReport) -> f64 {
    let liquid = report.liquid.expect("the scene has liquid");
    liquid.diagnosis.max_speed / (GRAVITY * report.dt)
}

/// How rough a level surface made of spheres around jittered markers is, root of the mean square, in cells: 0.07 to 0.13 as it lies in its cell.
const ROUGHNESS: f64 = 0.125;

/// A pool whose surface is made of markers. Without pressure its kinetic energy would be m (g dt)^2 / 2 after the first sub-step; without bumps it
/// would be 0. Bumps of height d and wave number k are pressures off by rho g d at the level, which give rho k d^2 (g dt)^2 / 2 per area of it, k
/// being pi/dx at most: over what free fall has, pi d^2 / dx over the depth, which is volume over area of the surface. Later, too, bumps give
/// no more than they have: rho g d^2 / 2 per area.
fn bumpy_at_rest(scene: &Scene, sheet: &mut Sheet) {
    let mut simulation = simulation(scene, &gpu());
    let density = scene.liquid.as_ref().expect("there is liquid").density;
    let (grid, start) = (scene.grid(), middle(&simulation));
    let reports: Vec<StepReport> = (0..AT_REST).map(|_| step(&mut simulation)).collect();
    let [first, last] = [&reports[0], &reports[AT_REST - 1]];
    let area = area_from_above(&grid, &simulation.state().unwrap().active);
    let diagnosis = |report: &StepReport| report.liquid.expect("there is liquid").diagnosis;
    let (volume, bump) = (diagnosis(first).volume, ROUGHNESS * grid.dx);
    let fall = 0.5 * density * volume * (GRAVITY * first.dt).powi(2);
    sheet.at_most(
        "markers, 1 sub-step: kinetic energy over that of free fall",
        diagnosis(first).kinetic_energy / fall,
        std::f64::consts::PI * bump.powi(2) * area / (grid.dx * volume),
    );
    sheet.at_most(
        &format!("markers, {AT_REST} sub-steps: kinetic energy over what bumps of {ROUGHNESS} cells hold"),
        diagnosis(last).kinetic_energy / (0.5 * density * GRAVITY * bump.powi(2) * area),
        1.0,
    );
    // The level is where the spheres are, which may sink by their bumps, twice these at most; the middle goes half as far.
    let end = middle(&simulation);
    let way = (0..3).map(|axis| ((end[axis] - start[axis]) / grid.dx).powi(2));
    let what = format!("markers, {AT_REST} sub-steps: way of the centre of mass, cells");
    sheet.at_most(&what, way.sum::<f64>().sqrt(), ROUGHNESS);
    sheet.info(
        &format!("markers, 1 and {AT_REST} sub-steps: largest speed / (g dt)"),
        format!("{:.4}, {:.4}", speed(first), speed(last)),
    );
}

/// Not a number where one is not.
fn largest(values: &[f64]) -> f64 {
    values.iter().copied().fold(0.0, larger)
}

/// Speeds at rest on both paths and with both surfaces; the GPU's simulation with a fixed one.
fn at_rest(name: &str, sheet: &mut Sheet) -> Simulation {
    let fixed = "liquid.surface=\"fixed\"";
    let scene = shipped(name, &[fixed], 1.0);
    let mut on_gpu = simulation(&scene, &gpu());
    let speeds = speeds_at_rest(&mut on_gpu);
    // Pressures that are stored in f32 round by 2^-24 of the depth, which the gradient over a cell makes 32 times as much.
    let bound = (10.0 * scene.solver.tolerance).max(2e-6);
    let what = "fixed surface, 20 sub-steps: largest speed / (g dt)";
    sheet.at_most(what, largest(&speeds), bound);
    let tight = ["solver.tolerance=1e-13", fixed];
    let mut on_cpu = simulation(&shipped(name, &tight, 0.5), &Backend::Cpu);
    let speeds = speeds_at_rest(&mut on_cpu);
    let what = "the same on the CPU in f64, half the cells";
    // A residual of 1e-13 over the eigenvalues of the Laplace operator: times the square of some ten cells of depth.
    sheet.at_most(what, largest(&speeds), 1e-11);
    let markers = ["liquid.surface=\"markers\""];
    bumpy_at_rest(&shipped(name, &markers, 1.0), sheet);
    on_gpu
}

/// The level, m, above which `hydrostatic_block` has no liquid.
fn level(scene: &Scene) -> f64 {
    let liquid = scene.liquid.as_ref().expect("the scene has liquid");
    match liquid.regions[0].shape {
        cutwater::scene::Shape::HalfSpace { point, .. } => point.y,
        ref other => panic!("{other:?}"),
    }
}

fn pool_at_rest(sheet: &mut Sheet) {
    let simulation = at_rest("hydrostatic_block", sheet);
    let scene = shipped("hydrostatic_block", &[], 1.0);
    let (grid, level) = (scene.grid(), level(&scene));
    let state = simulation.state().unwrap_or_else(|error| panic!("{error}"));
    let density = scene.liquid.expect("the scene has liquid").density;
    let errors: Vec<f64> = (0..grid.n_cells())
        .filter(|&cell| state.active[cell])
        .map(|cell| {
            let depth = level - grid.cell_centre(grid.cell_at(cell)).y;
            (state.pressure[cell] / (density * GRAVITY) - depth).abs() / level
        })
        .collect();
    let what = "fixed surface: largest error of p / (rho g H)";
    // f32 stores it to 6e-8.
    sheet.at_most(what, largest(&errors), 1e-6);
}

fn sphere_at_rest(sheet: &mut Sheet) {
    at_rest("sphere_half_full", sheet);
}

fn dam_release(sheet: &mut Sheet) {
    // A column 32 cells high and wide, free on top and to the right; a probe at each point of the table.
    let mut text = "[domain]\nsize = [1.0, 0.75, 0.03125]\ncells = [64, 48, 2]\n[time]\nduration = 1\n\
                    [liquid]\nsurface = \"fixed\"\n\
                    [[liquid.region]]\nbox = { min = [0, 0, 0], max = [0.5, 0.5, 0.03125] }\n"
        .to_owned();
    // The acceleration is singular at the corner, and probes interpolate between centres: none half a cell from a side.
    let inside = |row: &&Vec<f64>| {
        let [x, y] = [row[0], row[1]];
        let from_corner = (x - 1.0).hypot(y);
        let covered = |at: f64| (1.0 / 64.0..1.0 - 1.0 / 64.0).contains(&at);
        from_corner > 4.0 / 32.0 && covered(x) && covered(y)
    };
    let rows = table("tests/data/dam_release_pressure.csv");
    let rows: Vec<&Vec<f64>> = rows.iter().filter(inside).collect();
    for (number, row) in rows.iter().enumerate() {
        let point = [0.5 * row[0], 0.5 * row[1], 0.015625];
        text += &format!("[[probe]]\nname = \"p{number}\"\npressure = {{ point = {point:?} }}\n");
    }
    let scene = written(&text);
    let mut simulation = simulation(&scene, &gpu());
    let report = step(&mut simulation);
    let got = simulation.probes().unwrap_or_else(|error| panic!("{error}"));
    let errors: Vec<f64> =
        rows.iter().zip(&got).map(|(row, p)| (p / (1000.0 * GRAVITY * 0.5) - row[2]).abs()).collect();
    let what = format!("largest error of p / (rho g H) at {} points", errors.len());
    // Twice dx^2 in the depth of the column: second order, away from the corner's singularity.
    sheet.at_most(&what, largest(&errors), 2.0 / f64::powi(32.0, 2));
    // Exact, from the series: a_x = g sum 2 tanh(k) cos(k / 2) / k over k = (n + 1/2) pi, and a wall and a surface without pressure meet at a
    // right angle. The stencil has 0.48730 and -0.50000 g with these cells, an error that falls as dx^2.
    let grid = scene.grid();
    let state = simulation.state().unwrap_or_else(|error| panic!("{error}"));
    let acceleration =
        |axis: Axis, ijk: [usize; 3]| state.velocity[axis.index()][grid.face(axis, ijk)] / (GRAVITY * report.dt);
    let front = [15, 16].map(|row| acceleration(Axis::X, [32, row, 0]));
    let what = "acceleration of the front half-way up, a_x / g";
    sheet.relative(what, 0.486_559, 0.5 * (front[0] + front[1]), 0.005);
    let what = "acceleration of the top of the back wall, a_y / g";
    sheet.relative(what, -0.5, acceleration(Axis::Y, [0, 32, 0]), 0.005);
}

/// Times at which a series passes a value, linear between samples.
pub(crate) fn crossings(series: &[(f64, f64)], value: f64) -> Vec<f64> {
    let passes = series.windows(2).filter_map(|pair| {
        let [(t0, a), (t1, b)] = [pair[0], pair[1]].map(|(t, h)| (t, h - value));
        (a * b < 0.0).then(|| t0 + (t1 - t0) * a / (a - b))
    });
    passes.collect()
}

pub(crate) fn points(series: &[(f64, f64)]) -> Vec<[f64; 2]> {
    series.iter().map(|&(t, value)| [t, value]).collect()
}

fn standing_wave(sheet: &mut Sheet) {
    let scene = shipped("standing_wave", &[], 1.0);
    let mut simulation = simulation(&scene, &gpu());
    let (mut walls, mut aside) = ([Vec::new(), Vec::new()], Vec::new());
    while simulation.clock().frame < scene.n_frames() {
        step(&mut simulation);
        aside.push((simulation.clock().time, middle(&simulation)[0] - 1.0));
        let heights = simulation.probes().unwrap_or_else(|error| panic!("{error}"));
        for (wall, height) in walls.iter_mut().zip(heights) {
            wall.push((simulation.clock().time, height));
        }
    }
    // Lamb, Hydrodynamics, art. 228.
    let k = std::f64::consts::PI / 2.0;
    let period = std::f64::consts::TAU / (GRAVITY * k * k.tanh()).sqrt();
    let amplitude = 0.0625;
    let linear = |t: f64| 1.0 + amplitude * (std::f64::consts::TAU * t / period).cos();
    let times = || (0..=200).map(|n| 0.025 * f64::from(n));
    sheet.chart(
        "standing wave, level at a wall",
        ["t, s", "level, m"],
        vec![
            Line::new("64 cells between the walls", Mark::Line, points(&walls[0])),
            Line::new("linear theory, without loss", Mark::Theory, times().map(|t| [t, linear(t)]).collect()),
        ],
    );
    let times = crossings(&aside, 0.0);
    let what = "period over two periods, by the middle of the liquid, s";
    sheet.relative(what, period, 0.5 * (times[4] - times[0]), 0.02);
    let periods = walls.map(|wall| {
        let times = crossings(&wall, 1.0);
        (times[4] - times[0]) / 2.0
    });
    let off = periods.map(|wall| format!("{:+.1} %", 100.0 * (wall / period - 1.0)));
    sheet.info("the same by the level at each wall, which is bumpy", off.join(", "));
}

/// F4 again, on 20 and 40 cells a wavelength: half of one between walls 1 m apart, 1 m deep, one and a half cells high.
fn coarse_waves(sheet: &mut Sheet) {
    for (cells, allowed) in [(20, 0.02), (40, 0.01)] {
        let half = cells / 2;
        let dx = 1.0 / f64::from(half);
        let (k, amplitude) = (std::f64::consts::PI, 1.5 * dx);
        let text = format!(
            "[domain]\nsize = [1, {}, {}]\ncells = [{half}, {}, 4]\n[time]\nduration = 10\nframes_per_second = 60\n\
             [[liquid.region]]\nwave = {{ level = 1.0, amplitude = {amplitude}, wave_number = [{k}, 0.0] }}\n",
            1.0 + 8.0 * dx,
            4.0 * dx,
            half + 8,
        );
        // Lamb, Hydrodynamics, art. 228, and the next order of Tadjbakhsh and Keller 1960 at k h = pi.
        let linear = std::f64::consts::TAU / (GRAVITY * k * k.tanh()).sqrt();
        let period = linear / (1.0 - 0.124_056_62 * (k * amplitude).powi(2));
        let mut simulation = simulation(&written(&text), &gpu());
        let mut aside = vec![(0.0, middle(&simulation)[0] - 0.5)];
        while simulation.clock().time < 2.6 * period {
            step(&mut simulation);
            aside.push((simulation.clock().time, middle(&simulation)[0] - 0.5));
        }
        // Once there and back, so that it does not matter around what the middle swings.
        let times = crossings(&aside, 0.0);
        let what = format!("{cells} cells a wavelength, 1.5 cells high: period over two periods, s");
        sheet.relative(&what, period, 0.5 * (times[4] - times[0]), allowed);
    }
}

/// Mean of a function of the position (m) over the liquid: over its markers, or with a level, whose markers fill a band alone, over the cells by
/// their filled volume.
pub(crate) fn mean(simulation: &Simulation, of: impl Fn(DVec3) -> f64) -> f64 {
    let state = simulation.state().unwrap_or_else(|error| panic!("{error}"));
    let grid = simulation.scene().grid();
    let liquid = simulation.scene().liquid.as_ref().expect("the scene has liquid");
    if liquid.surface == Surface::Markers {
        let sum: f64 = state.markers.iter().map(|&x| of(x.into())).sum();
        return sum / state.markers.len() as f64;
    }
    let open = open_volumes(&grid, &simulation.cut_cells().solid_distance);
    let (mut sum, mut volume) = (0.0, 0.0);
    for (cell, (open, phi)) in open.iter().zip(&state.liquid_distance).enumerate() {
        let filled = open * (0.5 - phi / grid.dx).clamp(0.0, 1.0);
        sum += filled * of(grid.cell_centre(grid.cell_at(cell)));
        volume += filled;
    }
    sum / volume
}

/// Centre of mass of the liquid, m. A long wave moves it; the roughness of the surface does not.
pub(crate) fn middle(simulation: &Simulation) -> [f64; 3] {
    [0, 1, 2].map(|axis| mean(simulation, |x| x[axis]))
}

fn collapsing_column(sheet: &mut Sheet) {
    // A column of 20 x 40 cells, four across; the gate of the experiment is absent.
    let a = 0.05715;
    let text = format!(
        "[domain]\nsize = [{}, {}, {}]\ncells = [100, 48, 4]\n[time]\nduration = 1\nframes_per_second = 100\n\
         [[liquid.region]]\nbox = {{ min = [0, 0, 0], max = [{a}, {}, {}] }}\n\
         [[probe]]\nname = \"front\"\nfront = {{ axis = \"x\" }}\n\
         [[probe]]\nname = \"back\"\nheight = {{ x = {}, z = {} }}\n",
        5.0 * a,
        2.4 * a,
        0.2 * a,
        2.0 * a,
        0.2 * a,
        0.025 * a,
        0.1 * a,
    );
    let mut simulation = simulation(&written(&text), &gpu());
    let scaled = (2.0 * GRAVITY / a).sqrt();
    let (mut front, mut left) = (vec![(0.0, 1.0)], vec![(0.0, 1.0)]);
    while front.last().is_some_and(|&(t, _)| t < 3.4) {
        step(&mut simulation);
        let probes = simulation.probes().unwrap_or_else(|error| panic!("{error}"));
        let time = simulation.clock().time;
        front.push((time * scaled, probes[0] / a));
        left.push((time * (GRAVITY / a).sqrt(), probes[1] / (2.0 * a)));
    }
    let z_at = |t: f64| {
        let after = front.partition_point(|&(time, _)| time < t).max(1);
        let [(t0, z0), (t1, z1)] = [front[after - 1], front[after]];
        z0 + (z1 - z0) * (t - t0) / (t1 - t0)
    };
    let measured = table("tests/data/martin_moyce_front.csv");
    let late: Vec<[f64; 2]> =
        measured.iter().map(|row| [row[0], row[1]]).filter(|[t, _]| (1.1..3.0).contains(t)).collect();
    // Slopes by least squares over the same times.
    let slope = |points: &[[f64; 2]]| {
        let n = points.len() as f64;
        let [t, z] = [0, 1].map(|c| points.iter().map(|point| point[c]).sum::<f64>() / n);
        let across = points.iter().map(|p| (p[0] - t) * (p[1] - z)).sum::<f64>();
        across / points.iter().map(|p| (p[0] - t).powi(2)).sum::<f64>()
    };
    let own: Vec<[f64; 2]> = late.iter().map(|&[t, _]| [t, z_at(t)]).collect();
    let expected = slope(&late);
    let what = "speed of the front, dZ/dT for T from 1.2 to 3";
    sheet.relative(what, expected, slope(&own), 0.05);
    let off = measured.iter().map(|row| (z_at(row[0]) / row[1] - 1.0).abs());
    let heights = table("tests/data/martin_moyce_height.csv");
    let pairs = |rows: &[Vec<f64>]| rows.iter().map(|row| [row[0], row[1]]).collect();
    sheet.chart(
        "collapsing column, 20 cells wide: front",
        ["t sqrt(2 g / a)", "x / a"],
        vec![
            Line::new("front", Mark::Line, points(&front)),
            Line::new("Martin and Moyce 1952", Mark::Measured, pairs(&measured)),
        ],
    );
    sheet.chart(
        "collapsing column: height at the back wall",
        ["t sqrt(g / a)", "height over that of the start"],
        vec![
            Line::new("height", Mark::Line, points(&left)),
            Line::new("Martin and Moyce 1952", Mark::Measured, pairs(&heights)),
        ],
    );
    let height_at = |t: f64| {
        let after = left.partition_point(|&(time, _)| time < t).max(1);
        let after = after.min(left.len() - 1);
        let [(t0, h0), (t1, h1)] = [left[after - 1], left[after]];
        h0 + (h1 - h0) * (t - t0) / (t1 - t0)
    };
    let end = left[left.len() - 1].0;
    let lower = heights.iter().filter(|row| row[0] <= end);
    let lower = lower.map(|row| (height_at(row[0]) - row[1]).abs());
    let what = "largest error of the height at the back wall over that of the start";
    sheet.at_most(what, lower.fold(0.0, larger), 0.03);
    let what = "largest error of Z, without a shift in time";
    sheet.at_most(what, off.fold(0.0, larger), 0.1);
}

fn free_fall(sheet: &mut Sheet) {
    let text = "[domain]\nsize = [1, 1, 1]\ncells = [32, 32, 32]\n[time]\nduration = 1\n[liquid]\nsurface = \"markers\"\nvolume_control = false\n\
                [[liquid.region]]\nsphere = { centre = [0.3, 0.7, 0.3], radius = 0.15 }\nvelocity = [1.5, 0.5, 1.5]\n";
    let mut simulation = simulation(&written(text), &gpu());
    let start = middle(&simulation);
    let mut last = None;
    let mut speed = 0.5;
    for _ in 0..6 {
        let report = step(&mut simulation);
        speed -= GRAVITY * report.dt;
        last = Some(report);
    }
    let end = middle(&simulation);
    let time = simulation.clock().time;
    let way = [1.5 * time, 0.5 * (0.5 + speed) * time, 1.5 * time];
    let off = (0..3).map(|a| (end[a] - start[a] - way[a]).abs() / (1.5 * time));
    let what = "way of the centre of mass, relative error";
    sheet.at_most(what, off.fold(0.0, larger), 1e-4);
    let diagnosis = last.and_then(|report| report.liquid).expect("six sub-steps").diagnosis;
    let velocity = diagnosis.momentum.map(|p| p / (1000.0 * diagnosis.volume));
    let what = "mean velocity down after 6 sub-steps, m/s";
    sheet.relative(what, speed, velocity[1], 1e-3);
}

/// Least and largest volume over 10 s of `dam_break_liquid`, over that of the start.
fn volumes(control: bool) -> [f64; 2] {
    let control = format!("liquid.volume_control={control}");
    let overrides = ["time.duration=10.0", &control];
    let scene = shipped("dam_break_liquid", &overrides, 1.0);
    let mut simulation = simulation(&scene, &gpu());
    let mut range = [1.0_f64; 2];
    while simulation.clock().frame < scene.n_frames() {
        let report = step(&mut simulation);
        let ratio = simulation.volume_ratio(&report);
        let ratio = ratio.expect("the scene has liquid");
        range = [-larger(-range[0], -ratio), larger(range[1], ratio)];
    }
    range
}

/// At rest the liquid is four and a half cells deep. 3 % of that are an eighth of a cell, the roughness of a level of spheres ([`ROUGHNESS`]), which
/// volume control cannot tell from a change of the volume.
fn volume(sheet: &mut Sheet) {
    let [least, largest] = volumes(true);
    let what = "volume over 10 s of dam_break_liquid, with volume control";
    sheet.relative(&format!("least {what}"), 1.0, least, 0.03);
    sheet.relative(&format!("largest {what}"), 1.0, largest, 0.03);
}

fn volume_without_control(sheet: &mut Sheet) {
    let [least, largest] = volumes(false);
    let what = "least and largest volume over 10 s of dam_break_liquid, without volume control";
    sheet.info(what, format!("{least:.4}, {largest:.4}"));
}
