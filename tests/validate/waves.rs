//! Waves and floods of liquid alone, against theory and an experiment.

use cutwater::reference::larger;
use cutwater::sim::Simulation;

use crate::Case;
use crate::liquid::{GRAVITY, crossings, gpu, mean, middle, points, simulation, step, table, written};
use crate::page::{Line, Mark};
use crate::sheet::Sheet;

pub(crate) fn cases() -> Vec<Case> {
    vec![
        Case::new("F5", round_tank),
        Case::new("F5/square", square_tank),
        Case::new("F7", u_tube),
        Case::new("F8", slot),
        Case::new("F8/separated", slot_with_separation),
        Case::new("F9", ritter),
        Case::new("F10", solitary_wave),
        Case::new("F12", impact),
    ]
}

/// Time and probes of each sub-step of a scene until a time, s.
fn film(text: &str, end: f64) -> Vec<(f64, Vec<f64>)> {
    let mut simulation = simulation(&written(text), &gpu());
    let mut film = Vec::new();
    while simulation.clock().time < end {
        step(&mut simulation);
        let probes = simulation.probes().unwrap_or_else(|error| panic!("{error}"));
        film.push((simulation.clock().time, probes));
    }
    film
}

/// Water that swings about 0.
struct Swing<'a> {
    title: &'a str,
    /// Quantity that swings, with its unit.
    value: &'a str,
    label: &'a str,
    /// Quantity of the row.
    what: &'a str,
    /// Of theory, s.
    period: f64,
    /// Theory's periods that it is watched for: two and what comes before it passes 0 for the first time.
    periods: f64,
    /// Relative, of the period.
    allowed: f64,
}

impl Swing<'_> {
    /// Runs a scene, draws the value of its states over theory, and compares two periods.
    fn watch(&self, text: &str, value: impl Fn(&Simulation) -> f64, sheet: &mut Sheet) {
        let mut simulation = simulation(&written(text), &gpu());
        let mut swing = vec![(0.0, value(&simulation))];
        while simulation.clock().time < self.periods * self.period {
            step(&mut simulation);
            swing.push((simulation.clock().time, value(&simulation)));
        }
        let start = swing[0].1;
        let theory = (0..=250).map(|n| {
            let periods = self.periods * f64::from(n) / 250.0;
            let value = start * (std::f64::consts::TAU * periods).cos();
            [periods * self.period, value]
        });
        sheet.chart(
            self.title,
            ["t, s", self.value],
            vec![
                Line::new(self.label, Mark::Line, points(&swing)),
                Line::new("theory, without loss", Mark::Theory, theory.collect()),
            ],
        );
        let times = crossings(&swing, 0.0);
        let got = 0.5 * (times[4] - times[0]);
        sheet.relative(self.what, self.period, got, self.allowed);
    }
}

/// F5: the surface of water in a round tank is tilted at first; what swings is the mode of one node line nearly alone.
fn round_tank(sheet: &mut Sheet) {
    let (radius, depth, tilt): (f64, f64, f64) = (0.5, 0.5, 0.06);
    let text = format!(
        "[domain]\nsize = [1.1, 0.73333333333333333, 1.1]\ncells = [48, 32, 48]\n[time]\nduration = 10\nframes_per_second = 48\n\
         [[obstacle]]\ncylinder = {{ base = [0.55, -0.5, 0.55], axis = [0, 1, 0], radius = {radius}, height = 2.0 }}\ninside_out = true\n\
         [[liquid.region]]\nhalf_space = {{ point = [0.55, {depth}, 0.55], normal = [{}, 1, 0] }}\n",
        -tilt / radius,
    );
    // Lamb, Hydrodynamics, art. 191: k is the first zero of J_1' over the radius.
    let k = 1.841_183_781_340_659_4 / radius;
    let swing = Swing {
        title: "round tank, the liquid's middle, which a tilted surface moves aside",
        value: "aside, thousandths of the radius",
        label: "44 cells across",
        what: "round tank, mode with one node line: period over two periods, s",
        period: std::f64::consts::TAU / (GRAVITY * k * (k * depth).tanh()).sqrt(),
        periods: 2.6,
        allowed: 0.02,
    };
    let aside = |simulation: &Simulation| 1e3 * (middle(simulation)[0] - 0.55) / radius;
    swing.watch(&text, aside, sheet);
}

/// F5: the mode of a square tank with a node line along each middle, 1 m wide, half as deep. A wave along the diagonal holds it, and
/// modes that are even about the middle, which the moment about both middles does not see.
fn square_tank(sheet: &mut Sheet) {
    let (depth, cells) = (0.5, 32);
    let dx = 1.0 / f64::from(cells);
    let k = std::f64::consts::PI;
    let text = format!(
        "[domain]\nsize = [1, {}, 1]\ncells = [{cells}, 24, {cells}]\n[time]\nduration = 10\nframes_per_second = 48\n\
         [[liquid.region]]\nwave = {{ level = {depth}, amplitude = {}, wave_number = [{k}, {k}] }}\n",
        24.0 * dx,
        1.5 * dx,
    );
    // Lamb, Hydrodynamics, art. 190.
    let of_both = std::f64::consts::SQRT_2 * k;
    let swing = Swing {
        title: "square tank, moment of the liquid about both middles",
        value: "moment, thousandths of the area",
        label: "32 cells across",
        what: "square tank, mode with two node lines: period over two periods, s",
        period: std::f64::consts::TAU / (GRAVITY * of_both * (of_both * depth).tanh()).sqrt(),
        periods: 2.5,
        allowed: 0.02,
    };
    let moment = |simulation: &Simulation| 1e3 * mean(simulation, |x| (x.x - 0.5) * (x.z - 0.5));
    swing.watch(&text, moment, sheet);
}

/// F7: water swings in a U-tube, in the plane: two legs and the way between them under a block, all of one width.
fn u_tube(sheet: &mut Sheet) {
    let width = 0.1;
    let (level, lift) = (5.0 * width, 0.5 * width);
    let text = format!(
        "[domain]\nsize = [{}, {}, {}]\ncells = [32, 52, 2]\n[time]\nduration = 10\nframes_per_second = 48\n\
         [[obstacle]]\nbox = {{ min = [{width}, {width}, -1], max = [{}, 2, 1] }}\n\
         [[liquid.region]]\nbox = {{ min = [0, 0, 0], max = [{width}, {}, 1] }}\n\
         [[liquid.region]]\nbox = {{ min = [0, 0, 0], max = [1, {width}, 1] }}\n\
         [[liquid.region]]\nbox = {{ min = [{}, 0, 0], max = [1, {}, 1] }}\n",
        4.0 * width,
        6.5 * width,
        0.25 * width,
        3.0 * width,
        level + lift,
        3.0 * width,
        level - lift,
    );
    // Newton for the column, L z'' = -2 g z, at every amplitude. L: the straight parts, and in each corner what potential flow through a
    // square bend is worth, 1 - (2 / pi) ln 2 = 0.559 widths, as for the current in a bent sheet.
    let corner = 1.0 - 2.0 / std::f64::consts::PI * std::f64::consts::LN_2;
    let length = 2.0 * (level - width) + 2.0 * width + 2.0 * corner * width;
    let swing = Swing {
        title: "U-tube 8 cells wide, the liquid's middle",
        value: "aside, widths of the tube",
        label: "12 widths long",
        what: "U-tube 12 widths long: period over two periods, s",
        period: std::f64::consts::TAU * (length / (2.0 * GRAVITY)).sqrt(),
        periods: 2.4,
        allowed: 0.03,
    };
    let aside = |simulation: &Simulation| (middle(simulation)[0] - 2.0 * width) / width;
    swing.watch(&text, aside, sheet);
}

/// A tank of 1 m that runs dry through a slot in its floor, a tenth of the tank; half of both, beside a wall. `half`: cells of the half
/// slot. `keys`: of `[time]`, then of `[liquid]`. sqrt(h) falls by C (b / W) sqrt(g / 2) in a second (Torricelli), C = pi / (pi + 2) for the
/// sharp edges of a slot in the plane (Kirchhoff).
fn tank_with_slot(half: usize, keys: [&str; 2]) -> String {
    let dx = SLOT / half as f64;
    let [time, liquid] = keys;
    // The floor is two cells thick and has air below it: the jet parts from its edge.
    format!(
        "[domain]\nsize = [1, {}, {}]\ncells = [{}, {}, 2]\nopen = [\"-y\"]\n[time]\nduration = 10\nframes_per_second = 48\n{time}\n\
         [liquid]\n{liquid}\n\
         [[obstacle]]\nbox = {{ min = [{SLOT}, {}, -1], max = [2, {SLOT_FLOOR}, 1] }}\n\
         [[liquid.region]]\nbox = {{ min = [0, {SLOT_FLOOR}, 0], max = [1, {}, 1] }}\n\
         [[probe]]\nname = \"level\"\nheight = {{ x = 0.7, z = {dx} }}\n",
        14.0 * SLOT,
        2.0 * dx,
        20 * half,
        14 * half,
        SLOT_FLOOR - 2.0 * dx,
        SLOT_FLOOR + SLOT_DEPTH,
    )
}

/// Width of the half slot, height of the floor, and depth of the water above it at first, m.
const SLOT: f64 = 0.05;
const SLOT_FLOOR: f64 = 4.0 / 3.0 * SLOT;
const SLOT_DEPTH: f64 = 12.0 * SLOT;
/// Fall of sqrt(h) in a second by Torricelli, m^(1/2)/s.
fn torricelli() -> f64 {
    SLOT * (0.5 * GRAVITY).sqrt()
}

/// Kirchhoff's contraction.
const CONTRACTION: f64 = std::f64::consts::PI / (std::f64::consts::PI + 2.0);

/// Slope of the line of least squares.
fn slope(points: &[(f64, f64)]) -> f64 {
    let n = points.len() as f64;
    let [x, y] = [points.iter().map(|(x, _)| x).sum::<f64>() / n, points.iter().map(|(_, y)| y).sum::<f64>() / n];
    let across = points.iter().map(|(a, b)| (a - x) * (b - y));
    across.sum::<f64>() / points.iter().map(|(a, _)| (a - x).powi(2)).sum::<f64>()
}

/// F8, by the level of the water, with 12 cells to the slot.
fn slot(sheet: &mut Sheet) {
    // The quarter of a second in which the flow begins is left out.
    let film = film(&tank_with_slot(6, ["", ""]), 1.25);
    let levels: Vec<(f64, f64)> =
        film.iter().filter(|(t, _)| *t > 0.25).map(|(t, probes)| (*t, (probes[0] - SLOT_FLOOR).sqrt())).collect();
    let theory = |c: f64| {
        let fallen = |at: f64| c * torricelli() * (at - levels[0].0);
        [0.25, 1.25].map(|at| [at, levels[0].1 - fallen(at)])
    };
    sheet.chart(
        "tank that runs dry through a slot in its floor",
        ["t, s", "root of the level above the floor, m^(1/2)"],
        vec![
            Line::new("slot 12 cells wide", Mark::Line, points(&levels)),
            Line::new("Torricelli, contracted", Mark::Theory, theory(CONTRACTION).into()),
            Line::new("Torricelli, not contracted", Mark::Theory, theory(1.0).into()),
        ],
    );
    let what = "tank that runs dry through a slot in its floor: flow over that of Torricelli";
    sheet.relative(what, CONTRACTION, -slope(&levels) / torricelli(), 0.1);
}

/// F8/separated: by the volume that is left, since the level swings, with 24 cells to the slot, whose sides the water may leave.
fn slot_with_separation(sheet: &mut Sheet) {
    let half = 12;
    let depth = 2.0 * SLOT / half as f64;
    let text = tank_with_slot(half, ["cfl = 1", "separation = \"walls\""]);
    let flow = format!(
        "[[probe]]\nname = \"flow\"\nflux = {{ min = [0, {SLOT_FLOOR}, 0], max = [{SLOT}, {SLOT_FLOOR}, {depth}] }}\n"
    );
    let (mut left, mut time) = (SLOT_DEPTH * depth, 0.0);
    let mut roots = Vec::new();
    for (t, probes) in film(&(text + &flow), 0.5) {
        left += probes[1] * (t - time);
        time = t;
        if t > 0.15 {
            roots.push((t, (left / depth).sqrt()));
        }
    }
    let what =
        "the same with liquid.separation = \"walls\", by volume, 24 cells to the slot: flow over that of Torricelli";
    sheet.relative(what, CONTRACTION, -slope(&roots) / torricelli(), 0.05);
}

/// F9: Ritter 1892. The flood on a dry bed behind a dam, long after, but for its tip.
fn ritter(sheet: &mut Sheet) {
    // Lengths in depths of the reservoir, 0.1 m; the dam is at 7 of them.
    let depth = 0.1;
    let dx = depth / 20.0;
    let speed = (GRAVITY * depth).sqrt();
    let time = 6.0 * depth / speed;
    let xi: Vec<f64> = (0..19).map(|n| -0.8 + 0.1 * f64::from(n)).collect();
    let mut text = format!(
        "[domain]\nsize = [{}, {}, {}]\ncells = [420, 24, 2]\n[time]\nduration = {time}\nframes_per_second = 200\n\
         [[liquid.region]]\nbox = {{ min = [0, 0, 0], max = [{}, {depth}, 1] }}\n",
        21.0 * depth,
        1.2 * depth,
        2.0 * dx,
        7.0 * depth,
    );
    for (number, xi) in xi.iter().enumerate() {
        let x = 7.0 * depth + xi * speed * time;
        text += &format!("[[probe]]\nname = \"h{number}\"\nheight = {{ x = {x}, z = {dx} }}\n");
    }
    let film = film(&text, time * (1.0 - 1e-9));
    let (_, heights) = film.last().expect("there are sub-steps");
    let exact = |xi: f64| (2.0 - xi).powi(2) / 9.0;
    let own: Vec<[f64; 2]> = xi.iter().zip(heights).map(|(xi, h)| [*xi, h / depth]).collect();
    let theory = (0..=60).map(|n| -1.0 + 0.05 * f64::from(n));
    sheet.chart(
        "flood on a dry bed at t sqrt(g/H) = 6",
        ["x / (c t)", "h / H"],
        vec![
            Line::new("20 cells deep", Mark::Points, own.clone()),
            Line::new("Ritter 1892", Mark::Theory, theory.map(|xi| [xi, exact(xi)]).collect()),
        ],
    );
    let off = own.iter().map(|[xi, h]| (h - exact(*xi)).abs());
    let what = "flood on a dry bed, largest error of the depth over the reservoir's";
    sheet.at_most(what, off.fold(0.0, larger), 0.05);
}

/// F10: a solitary wave runs and climbs a wall.
fn solitary_wave(sheet: &mut Sheet) {
    let (eps, h) = (0.25_f64, 0.3);
    let dx = h / 20.0;
    let cells = 480;
    let start = 7.0 * h;
    let eta = |x: f64| eps * h / ((0.75 * eps).sqrt() * (x - start) / h).cosh().powi(2);
    // Grimshaw 1971 and Fenton 1972, third order.
    let froude = (1.0 + eps - eps * eps / 20.0 - 3.0 * eps.powi(3) / 70.0).sqrt();
    let c = froude * (GRAVITY * h).sqrt();
    let mut text = format!(
        "[domain]\nsize = [{}, {}, {}]\ncells = [{cells}, 36, 2]\n[time]\nduration = 10\nframes_per_second = 60\n",
        f64::from(cells) * dx,
        36.0 * dx,
        2.0 * dx,
    );
    for column in 0..cells {
        let x = (f64::from(column) + 0.5) * dx;
        text += &format!(
            "[[liquid.region]]\nbox = {{ min = [{}, 0, 0], max = [{}, {}, 1] }}\nvelocity = [{}, 0, 0]\n",
            f64::from(column) * dx,
            f64::from(column + 1) * dx,
            h + eta(x),
            c * eta(x) / (h + eta(x)),
        );
    }
    let gauges = [10.0, 13.0, 16.0];
    for (number, at) in gauges.iter().enumerate() {
        text += &format!("[[probe]]\nname = \"g{number}\"\nheight = {{ x = {}, z = {dx} }}\n", at * h);
    }
    let wall = (f64::from(cells) - 0.5) * dx;
    text += &format!("[[probe]]\nname = \"wall\"\nheight = {{ x = {wall}, z = {dx} }}\n");
    let film = film(&text, 22.0 * h / c);
    let gauge =
        |number: usize| -> Vec<(f64, f64)> { film.iter().map(|(t, probes)| (*t, probes[number] / h - 1.0)).collect() };
    // The time of a crest: the middle of the times at half of its height.
    let crest = |series: &[(f64, f64)]| {
        let most = series.iter().fold(0.0, |most, (_, eta)| larger(most, *eta));
        let times = crossings(series, 0.5 * most);
        (0.5 * (times[0] + times[1]), most)
    };
    let crests = [0, 1, 2].map(|number| crest(&gauge(number)));
    let speed = (gauges[2] - gauges[0]) * h / (crests[2].0 - crests[0].0);
    let lines = (0..3).map(|number| {
        let label = format!("{:.0} depths from the start", gauges[number] - 7.0);
        Line::new(label, Mark::Line, points(&gauge(number)))
    });
    let theory = gauges.map(|at| {
        let profile = film.iter().map(|(t, _)| [*t, eta(at * h - c * t) / h]);
        let label = format!("first order, {:.0} depths", at - 7.0);
        Line::new(label, Mark::Theory, profile.collect())
    });
    sheet.chart(
        "solitary wave of a quarter of the depth, 20 cells deep, at three gauges",
        ["t, s", "eta / h"],
        lines.chain(theory).collect(),
    );
    let what = "solitary wave: speed over sqrt(g h) between 3 and 9 depths from the start";
    sheet.relative(what, froude, speed / (GRAVITY * h).sqrt(), 0.02);
    let what = "solitary wave: change of its height over 6 depths";
    // The roughness of a level of markers at both gauges, an eighth of a cell each, over the wave's five cells.
    sheet.at_most(what, (crests[2].1 / crests[0].1 - 1.0).abs(), 0.05);
    // Su and Mirie 1980.
    let climb = 2.0 * eps + 0.5 * eps * eps + 0.75 * eps.powi(3);
    let got = gauge(3).iter().fold(0.0, |most, (_, eta)| larger(most, *eta));
    let what = "solitary wave: how high it climbs the wall, over the depth";
    // The probe is in the middle of a cell of 1/20 of the depth: half of one over a climb of 11.
    sheet.relative(what, climb, got, 0.05);
}

/// F12: a column collapses and hits a wall, where its pressure is measured near the floor.
fn impact(sheet: &mut Sheet) {
    let height = 0.3;
    let dx = 1.61 / 200.0;
    let text = format!(
        "[domain]\nsize = [1.61, {}, {}]\ncells = [200, 60, 4]\n[time]\nduration = 2\nframes_per_second = 200\n\
         [[liquid.region]]\nbox = {{ min = [0, 0, 0], max = [0.6, {height}, 1] }}\n\
         [[probe]]\nname = \"p\"\npressure = {{ point = [{}, {}, {}] }}\n",
        60.0 * dx,
        4.0 * dx,
        1.61 - 0.5 * dx,
        0.5 * dx,
        2.0 * dx,
    );
    let scaled = (GRAVITY / height).sqrt();
    let film = film(&text, 6.0 / scaled);
    let of_weight = 1000.0 * GRAVITY * height;
    let pressure: Vec<(f64, f64)> = film.iter().map(|(t, probes)| (t * scaled, probes[0] / of_weight)).collect();
    let measured = table("tests/data/lobovsky2014_wall_pressure.csv");
    sheet.chart(
        "column hits a wall: pressure near the floor",
        ["t sqrt(g/H)", "p / (rho g H)"],
        vec![
            Line::new("200 cells along the tank", Mark::Line, points(&pressure)),
            Line::new(
                "Lobovsky et al. 2014, 3 mm above the floor",
                Mark::Measured,
                measured.iter().map(|row| [row[0], row[1]]).collect(),
            ),
        ],
    );
    let arrival = |series: &[(f64, f64)]| crossings(series, 0.2)[0];
    let of_experiment: Vec<(f64, f64)> = measured.iter().map(|row| (row[0], row[1])).collect();
    let what = "column hits a wall: t sqrt(g/H) when p passes 0.2 rho g H";
    sheet.relative(what, arrival(&of_experiment), arrival(&pressure), 0.03);
    let plateau = |series: &[(f64, f64)]| {
        let late = series.iter().filter(|(t, _)| (3.5..5.5).contains(t));
        let values: Vec<f64> = late.map(|(_, p)| *p).collect();
        values.iter().sum::<f64>() / values.len() as f64
    };
    let what = "column hits a wall: mean of p / (rho g H) for t sqrt(g/H) from 3.5 to 5.5";
    sheet.relative(what, plateau(&of_experiment), plateau(&pressure), 0.1);
}
