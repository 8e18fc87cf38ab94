//! A level set as the liquid's surface: waves, liquid at rest, falling liquid.

use cutwater::grid::Grid;
use cutwater::reference::larger;
use cutwater::sim::Simulation;

use crate::Case;
use crate::liquid::{GRAVITY, gpu, points, simulation, step, written};
use crate::page::{Line, Mark};
use crate::sheet::Sheet;

pub(crate) fn cases() -> Vec<Case> {
    vec![
        Case::new("F13/waves", waves),
        Case::new("F13/rest", rest),
        Case::new("F13/falling", falling),
        Case::new("F13/jets", jets),
        Case::new("F13/splashes", splashes),
    ]
}

/// Height of the surface in each column of cells, m; of columns with a surface.
fn heights(grid: &Grid, phi: &[f64]) -> Vec<([usize; 2], f64)> {
    let [nx, ny, nz] = grid.cells;
    let columns = (0..nz).flat_map(|k| (0..nx).map(move |i| [i, k]));
    let height = |[i, k]: [usize; 2]| {
        let at = |j: usize| phi[grid.cell([i, j, k])];
        let below = (0..ny - 1).rev().find(|&j| at(j) < 0.0 && at(j + 1) >= 0.0)?;
        let part = at(below) / (at(below) - at(below + 1));
        Some(([i, k], (below as f64 + 0.5 + part) * grid.dx))
    };
    columns.filter_map(|column| Some((column, height(column)?.1))).collect()
}

/// Volume of the liquid, cells, by 4^3 samples in each.
fn volume(grid: &Grid, phi: &[f64]) -> f64 {
    let mut sum = 0.0;
    for (cell, &own) in phi.iter().enumerate() {
        if own.abs() > 2.0 * grid.dx {
            sum += f64::from(u8::from(own < 0.0));
            continue;
        }
        let x = grid.cell_centre(grid.cell_at(cell));
        for sample in 0..64 {
            let at = [sample % 4, sample / 4 % 4, sample / 16].map(|n| f64::from(n) / 4.0 - 0.375);
            let phi = grid.sample_cells(phi, x + grid.dx * glam::DVec3::from(at));
            sum += (0.5 - 4.0 * phi / grid.dx).clamp(0.0, 1.0) / 64.0;
        }
    }
    sum
}

/// A standing wave between walls half a wavelength apart.
struct Wave {
    /// Cells of the wavelength.
    length: usize,
    /// Cells.
    amplitude: f64,
    surface: &'static str,
}

/// Periods that waves are watched for.
const PERIODS: f64 = 5.0;

impl Wave {
    /// Amplitude of the mode over time, m, and the period, s.
    fn film(&self) -> (Vec<(f64, f64)>, f64) {
        let half = self.length / 2;
        let dx = 1.0 / half as f64;
        let (k, amplitude) = (std::f64::consts::PI, self.amplitude * dx);
        let text = format!(
            "[domain]\nsize = [1, {}, {}]\ncells = [{half}, {}, 4]\n[time]\nduration = 20\nframes_per_second = 24\n\
             [liquid]\nsurface = \"{}\"\n\
             [[liquid.region]]\nwave = {{ level = 1.0, amplitude = {amplitude}, wave_number = [{k}, 0.0] }}\n",
            1.0 + 8.0 * dx,
            4.0 * dx,
            half + 8,
            self.surface,
        );
        // Lamb, Hydrodynamics, art. 228, and the next order of Tadjbakhsh and Keller 1960 at k h = pi.
        let linear = std::f64::consts::TAU / (GRAVITY * k * k.tanh()).sqrt();
        let period = linear / (1.0 - 0.124_056_62 * (k * amplitude).powi(2));
        let scene = written(&text);
        let grid = scene.grid();
        let mut simulation = simulation(&scene, &gpu());
        let mut film = Vec::new();
        while simulation.clock().time < PERIODS * period {
            film.push((simulation.clock().time, mode(&grid, &simulation)));
            step(&mut simulation);
        }
        (film, period)
    }

    /// Part of the amplitude that is lost in a period: the slope of the logarithm of the crests' heights.
    fn loss(&self, (film, period): &(Vec<(f64, f64)>, f64)) -> f64 {
        let crest = |half: usize| {
            let window = [half as f64 - 0.5, half as f64 + 0.5].map(|n| 0.5 * n * period);
            let near = (0..film.len()).filter(|&at| (window[0]..window[1]).contains(&film[at].0));
            let highest = near.max_by(|&a, &b| film[a].1.abs().total_cmp(&film[b].1.abs()));
            vertex(film, highest.expect("a wave of many sub-steps"))
        };
        let n = (2.0 * PERIODS) as usize;
        let logs: Vec<(f64, f64)> = (0..n).map(|half| (half as f64 / 2.0, crest(half).ln())).collect();
        let mean = |of: fn(&(f64, f64)) -> f64| logs.iter().map(of).sum::<f64>() / n as f64;
        let (t, log) = (mean(|p| p.0), mean(|p| p.1));
        let across: f64 = logs.iter().map(|p| (p.0 - t) * (p.1 - log)).sum();
        let along: f64 = logs.iter().map(|p| (p.0 - t).powi(2)).sum();
        1.0 - (across / along).exp()
    }
}

/// Height of the parabola through an extremum and its neighbours.
fn vertex(film: &[(f64, f64)], at: usize) -> f64 {
    let height = |at: usize| film[at].1.abs();
    if at == 0 || at + 1 == film.len() {
        return height(at);
    }
    let [before, here, after] = [at - 1, at, at + 1].map(height);
    let (slope, bend) = (0.5 * (after - before), after - 2.0 * here + before);
    match bend < 0.0 {
        true => here - slope * slope / (2.0 * bend),
        false => here,
    }
}

/// Amplitude of the wave of half a period between the walls, m.
fn mode(grid: &Grid, simulation: &Simulation) -> f64 {
    let state = simulation.state().unwrap_or_else(|error| panic!("{error}"));
    let heights = heights(grid, &state.liquid_distance);
    let n = heights.len() as f64;
    let weighed = heights.iter().map(|([i, _], height)| {
        let x = (*i as f64 + 0.5) * grid.dx;
        height * (std::f64::consts::PI * x).cos()
    });
    2.0 * weighed.sum::<f64>() / n
}

/// Waves lose nothing in an inviscid liquid.
fn waves(sheet: &mut Sheet) {
    for (length, amplitude, allowed) in
        [(20, 1.5, 0.03), (28, 1.7, 0.03), (40, 2.0, 0.01), (20, 0.6, 0.04), (28, 0.6, 0.025), (40, 0.7, 0.025)]
    {
        let of = |surface| Wave { length, amplitude, surface };
        let [level, markers] = ["level", "markers"].map(|surface| of(surface).film());
        let [loss, loss_of_markers] =
            [("level", &level), ("markers", &markers)].map(|(surface, film)| of(surface).loss(film));
        let what = format!("wave of {length} cells, {amplitude} high: loss in a period");
        sheet.at_most(&what, loss.abs(), allowed);
        sheet.info(&format!("{what}, surface = \"markers\""), format!("{loss_of_markers:.3}"));
        if (length, amplitude) == (20, 1.5) {
            sheet.chart(
                "standing wave of 20 cells, 1.5 high",
                ["t, s", "amplitude, m"],
                vec![
                    Line::new("level", Mark::Line, points(&level.0)),
                    Line::new("markers", Mark::Line, points(&markers.0)),
                ],
            );
        }
    }
}

/// Sub-steps of liquid that should not move.
const AT_REST: usize = 500;

/// Pools whose level is anywhere within a cell stay calm.
fn rest(sheet: &mut Sheet) {
    let n = 24;
    let dx = 1.0 / f64::from(n);
    for height in [12.02, 12.27, 12.52, 12.77, 12.98] {
        let text = format!(
            "[domain]\nsize = [1, 1, 1]\ncells = [{n}, {n}, {n}]\n[time]\nduration = 100\nframes_per_second = 24\n\
             [liquid]\nsurface = \"level\"\n[[liquid.region]]\nbox = {{ min = [0, 0, 0], max = [1, {}, 1] }}\n",
            height * dx,
        );
        let scene = written(&text);
        let mut simulation = simulation(&scene, &gpu());
        let speeds = (0..AT_REST).map(|_| {
            let report = step(&mut simulation);
            let liquid = report.liquid.expect("there is liquid");
            liquid.diagnosis.max_speed / (GRAVITY * report.dt)
        });
        let fastest = speeds.fold(0.0, larger);
        let what = format!("pool of {height} of {n} cells, {AT_REST} sub-steps: largest speed over g dt");
        sheet.at_most(&what, fastest, 0.02);
        let state = simulation.state().unwrap_or_else(|error| panic!("{error}"));
        let heights = heights(&scene.grid(), &state.liquid_distance);
        let mean = heights.iter().map(|h| h.1).sum::<f64>() / heights.len() as f64;
        let squares = heights.iter().map(|h| (h.1 - mean).powi(2)).sum::<f64>();
        let rms = (squares / heights.len() as f64).sqrt() / dx;
        let what = format!("pool of {height} of {n} cells: roughness of its level, cells");
        sheet.at_most(&what, rms, 0.03);
    }
}

/// Thin liquid has the volume of its shape, and keeps it while it falls.
fn falling(sheet: &mut Sheet) {
    let n = [24, 72, 24];
    let dx = 1.0 / 24.0;
    let sheet_of = |cells: f64, allowed: f64| {
        let top = 2.5 + cells * dx;
        let region = format!("box = {{ min = [0.2, 2.5, 0.2], max = [0.8, {top}, 0.8] }}");
        let volume = cells * (0.6 / dx).powi(2);
        (format!("sheet of {cells} cells"), region, volume, allowed)
    };
    let drop_of = |cells: f64| {
        let radius = cells * dx;
        let region = format!("sphere = {{ centre = [0.51, 2.52, 0.49], radius = {radius} }}");
        let volume = 4.0 / 3.0 * std::f64::consts::PI * cells.powi(3);
        (format!("drop of radius {cells} cells"), region, volume, 0.08)
    };
    for (name, region, exact, allowed) in
        [sheet_of(1.0, 0.2), sheet_of(1.5, 0.08), sheet_of(2.0, 0.08), sheet_of(3.0, 0.08), drop_of(2.0), drop_of(3.0)]
    {
        let text = format!(
            "[domain]\nsize = [1, 3, 1]\ncells = {n:?}\n[time]\nduration = 0.6\nframes_per_second = 24\n\
             [liquid]\nsurface = \"level\"\n[[liquid.region]]\n{region}\n",
        );
        let scene = written(&text);
        let grid = scene.grid();
        let mut simulation = simulation(&scene, &gpu());
        let off = |simulation: &Simulation| {
            let state = simulation.state().unwrap_or_else(|error| panic!("{error}"));
            let flying = state.flying().count() as f64 / 8.0;
            ((volume(&grid, &state.liquid_distance) + flying) / exact - 1.0).abs()
        };
        let mut worst = off(&simulation);
        while simulation.clock().time < 0.6 - 1e-9 {
            step(&mut simulation);
            worst = larger(worst, off(&simulation));
        }
        let what = format!("{name}, falling 40 cells: largest difference of its volume");
        sheet.at_most(&what, worst, allowed);
    }
}

/// A jet that a plate turns pushes it with rho A v^2, and one that gravity turns rises by v^2 / 2g.
fn jets(sheet: &mut Sheet) {
    for frames in [24, 48, 96] {
        let push = push_on_plate(frames);
        sheet.relative(
            &format!("jet of 4 cells on a plate, {frames} frames/s: force, N"),
            1000.0 * 4.0 / 36.0,
            push,
            0.08,
        );
    }
    for frames in [24, 96] {
        let rise = rise_of_jet(frames);
        sheet.relative(&format!("jet of 4 cells, {frames} frames/s: rise, m"), 9.0 / (2.0 * GRAVITY), rise, 0.02);
    }
}

/// Mean force of a jet on a plate from 0.5 to 1 s, N.
fn push_on_plate(frames: u32) -> f64 {
    let text = format!(
        "[domain]\nsize = [1, 1, 1]\ncells = [24, 24, 24]\ngravity = [0, 0, 0]\nopen = [\"+x\", \"-y\", \"+y\", \"-z\", \"+z\"]\n\
         [time]\nduration = 1\nframes_per_second = {frames}\n[liquid]\nsurface = \"level\"\n\
         [[source]]\nbox = {{ min = [0, 0.4166666, 0.4166666], max = [0.0833333, 0.5833334, 0.5833334] }}\nvelocity = [2, 0, 0]\n\
         [[solid]]\nname = \"plate\"\nmesh = {{ box = {{ size = [0.0833333, 0.75, 0.75], cells = [1, 9, 9] }} }}\n\
         placement = {{ translate = [0.625, 0.5, 0.5] }}\ndensity = 2000\nyoung = 1e8\npoisson = 0.3\n\
         [[solid.pin]]\nregion = {{ box = {{ min = [0.6, 0, 0], max = [1, 1, 1] }} }}\n\
         [[probe]]\nname = \"f\"\nforce = {{ solid = \"plate\" }}\n"
    );
    let mut simulation = simulation(&written(&text), &gpu());
    let mut impulse = 0.0;
    while simulation.clock().time < 1.0 - 1e-9 {
        let dt = step(&mut simulation).dt;
        if simulation.clock().time > 0.5 + 1e-9 {
            let probes = simulation.probes().unwrap_or_else(|error| panic!("{error}"));
            impulse += dt * probes[0];
        }
    }
    impulse / 0.5
}

/// Largest height of the middle of an upward jet above its nozzle, m. Gravity is inclined, so that the jet does not fall back on itself.
fn rise_of_jet(frames: u32) -> f64 {
    let text = format!(
        "[domain]\nsize = [1, 0.75, 0.25]\ncells = [64, 48, 16]\ngravity = [4, -{GRAVITY}, 0]\nopen = [\"+x\", \"-y\", \"-z\", \"+z\"]\n\
         [time]\nduration = 0.75\nframes_per_second = {frames}\n[liquid]\nsurface = \"level\"\n\
         [[source]]\nbox = {{ min = [0.125, 0.0625, 0.09375], max = [0.1875, 0.125, 0.15625] }}\nvelocity = [0, 3, 0]\n"
    );
    let scene = written(&text);
    let grid = scene.grid();
    let mut simulation = simulation(&scene, &gpu());
    while simulation.clock().time < 0.75 - 1e-9 {
        step(&mut simulation);
    }
    let state = simulation.state().unwrap_or_else(|error| panic!("{error}"));
    let mut columns = vec![[0.0; 2]; grid.cells[0]];
    for (cell, &phi) in state.liquid_distance.iter().enumerate() {
        let at = grid.cell_at(cell);
        let liquid = (0.5 - phi / grid.dx).clamp(0.0, 1.0);
        let [sum, moment] = &mut columns[at[0]];
        *sum += liquid;
        *moment += liquid * grid.cell_centre(at).y;
    }
    // From two cells beside the nozzle.
    let middles = columns[14..].iter().filter(|[sum, _]| *sum > 0.0).map(|[sum, moment]| moment / sum);
    middles.fold(0.0, f64::max) - 0.125
}

/// Liquid that collides and spreads keeps its volume within 10 % at every moment.
fn splashes(sheet: &mut Sheet) {
    // A disc of both drops that is a cell thick has a radius of 0.47 m, which it reaches after this time.
    let until = 0.3;
    let drops = "sphere = { centre = [0.27, 0.51, 0.52], radius = 0.15 }\nvelocity = [1, 0, 0]\n[[liquid.region]]\n\
                 sphere = { centre = [0.75, 0.51, 0.52], radius = 0.15 }\nvelocity = [-1, 0, 0]\n";
    for frames in [24, 96] {
        let text = format!(
            "[domain]\nsize = [1, 1, 1]\ncells = [24, 24, 24]\ngravity = [0, 0, 0]\n[time]\nduration = {until}\n\
             frames_per_second = {frames}\n[liquid]\nsurface = \"level\"\n[[liquid.region]]\n{drops}"
        );
        let what = format!("two drops that meet, {frames} frames/s");
        let energies = volume_within(sheet, &what, &text, until, 0.1);
        let largest = energies.iter().copied().fold(0.0, larger);
        sheet.info(&format!("{what}: largest kinetic energy over the first"), format!("{:.2}", largest / energies[0]));
    }
    let text = "[domain]\nsize = [0.24, 0.24, 0.24]\ncells = [24, 24, 24]\n[time]\nduration = 0.5\n[liquid]\nsurface = \"level\"\n\
                [[source]]\nbox = { min = [0, 0.16, 0.10], max = [0.02, 0.20, 0.14] }\nvelocity = [4, 0, 0]\nend = 0.4\n";
    volume_within(sheet, "jet of 4 m/s and 4 cells into a tank", text, 0.5, 0.1);
    let bars = [[-0.1, 0.17], [0.29, 0.44], [0.56, 0.71], [0.83, 1.1]].map(|[low, high]| {
        format!(
            "[[obstacle]]\nbox = {{ min = [-0.1, 0.75, {low}], max = [1.1, 0.85, {high}] }}\n\
             [[obstacle]]\nbox = {{ min = [{low}, 0.75, -0.1], max = [{high}, 0.85, 1.1] }}\n"
        )
    });
    let text = format!(
        "[domain]\nsize = [1, 1.3333333333333333, 1]\ncells = [24, 32, 24]\n[time]\nduration = 1.5\n[liquid]\nsurface = \"level\"\n\
         [[liquid.region]]\nbox = {{ min = [0, 0.85, 0], max = [1, 1.1, 1] }}\n{}",
        bars.concat()
    );
    volume_within(sheet, "water through nine holes of 3 cells in a plate", &text, 1.5, 0.1);
    let text = "[domain]\nsize = [1, 1, 1]\ncells = [24, 24, 24]\n[time]\nduration = 1\n[liquid]\nsurface = \"level\"\n\
                [[liquid.region]]\nbox = { min = [0, 0.5, 0], max = [1, 0.75, 1] }\n";
    let lost = volumes(text, 1.0).into_iter().map(|(ratio, _)| 1.0 - ratio).fold(0.0, larger);
    sheet.at_most("slab of 6 cells that fills the cross-section and falls by 12: lost volume", lost, 0.03);
}

/// Reports the largest difference of the volume from its target over that. Returns the kinetic energies after the sub-steps, J.
fn volume_within(sheet: &mut Sheet, what: &str, text: &str, until: f64, allowed: f64) -> Vec<f64> {
    let (ratios, energies): (Vec<f64>, Vec<f64>) = volumes(text, until).into_iter().unzip();
    let worst = ratios.into_iter().map(|ratio| (ratio - 1.0).abs()).fold(0.0, larger);
    sheet.at_most(&format!("{what}: largest difference of its volume"), worst, allowed);
    energies
}

/// Volume over its target and kinetic energy, J, after each sub-step.
fn volumes(text: &str, until: f64) -> Vec<(f64, f64)> {
    let mut simulation = simulation(&written(text), &gpu());
    let mut volumes = Vec::new();
    while simulation.clock().time < until - 1e-9 {
        let report = step(&mut simulation);
        let ratio = simulation.volume_ratio(&report).expect("there is liquid");
        volumes.push((ratio, report.liquid.expect("there is liquid").diagnosis.kinetic_energy));
    }
    volumes
}
