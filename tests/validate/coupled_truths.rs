//! Liquid and elastic solids together against what theory says of them, on the f64 path and on the device.

use std::fmt::Write;
use std::fs;

use cutwater::reference::larger;
use cutwater::scene::Scene;
use cutwater::sim::Simulation;
use cutwater::state::{SolveStatus, StepReport};
use glam::DVec3;

use crate::Case;
use crate::lane::{Lane, largest};
use crate::liquid::{settings_of, table};
use crate::page::{Line, Mark};
use crate::sheet::Sheet;

const GRAVITY: f64 = 9.81;

/// Of a single step from rest, s.
const DT: f64 = 1.0 / 120.0;

type Run = fn(Lane, &mut Sheet);

pub(crate) fn cases() -> Vec<Case> {
    let mut cases = Vec::new();
    let all: [(&str, Run); 9] = [
        ("A1", ball_in_a_vessel),
        ("A2", cylinder_in_a_vessel),
        ("A5", ball_in_the_surface),
        ("A6", bodies_without_mass),
        ("B1", piston),
        ("B2", column_on_a_block),
        ("W1", floating_bodies),
        ("plate", plate_under_water),
        ("closed", closed_vessel),
    ];
    for (id, run) in all {
        for lane in Lane::PRECISE {
            cases.push(Case::new(format!("{id}/{}", lane.name()), move |sheet| run(lane, sheet)));
        }
    }
    cases
}

/// Of added mass, relative: a tenth of a cell in the radius of a body ten cells in radius changes C, which goes as the cube, by so much.
const OF_ADDED_MASS: f64 = 0.03;

/// A1: no cell knows of a surface, and the level of the pressure is what keeps the ball's volume.
fn ball_in_a_vessel(lane: Lane, sheet: &mut Sheet) {
    let mut own = [Vec::new(), Vec::new()];
    for (ratio, s) in [(2.0, 0.1), (2.0, 2.0), (3.0, 0.1), (3.0, 2.0)] {
        let vessel = Vessel::full(ratio, 10.0);
        let what = format!("ball in a vessel, b/a = {ratio}, s = {s}: C");
        let c = vessel.added_mass(lane, s, STIFF);
        own[usize::from(s > 1.0)].push([ratio, c]);
        sheet.relative(&what, added_mass(true, ratio), c, OF_ADDED_MASS);
    }
    // Stokes 1843.
    let exact = |ratio: f64| (ratio.powi(3) + 2.0) / (2.0 * (ratio.powi(3) - 1.0));
    chart_of_added_mass(lane, "ball in a spherical vessel", own, exact, sheet);
    if lane == Lane::Mixed {
        let vessel = Vessel { formulation: "two_field", ..Vessel::full(2.0, 10.0) };
        let c = vessel.added_mass(lane, 2.0, STIFF);
        let what = "ball in a vessel, b/a = 2, s = 2, in the two-field form: C";
        sheet.relative(what, added_mass(true, 2.0), c, OF_ADDED_MASS);
    }
    let errors = [7.0, 10.0, 14.0].map(|across| {
        let vessel = Vessel::full(2.0, across);
        (vessel.added_mass(lane, 0.1, STIFF) / added_mass(true, 2.0) - 1.0).abs()
    });
    let order = (errors[0] / errors[2]).ln() / 2.0_f64.ln();
    sheet.at_least("order of the error of C from a/dx = 7 to 14", order, 1.0);
    sheet.info("error of C with a/dx = 7, 10, 14", format!("{:.4}, {:.4}, {:.4}", errors[0], errors[1], errors[2]));
}

/// Of a tenth of the liquid's density and of twice that, over the exact one.
fn chart_of_added_mass(lane: Lane, body: &str, own: [Vec<[f64; 2]>; 2], exact: impl Fn(f64) -> f64, sheet: &mut Sheet) {
    let [light, heavy] = own;
    let ratios = (0..=100).map(|n| 1.6 + 0.02 * f64::from(n));
    let title = format!("added mass of a {body}, {}", lane.name());
    sheet.chart(
        &title,
        ["radius of the vessel over that of the body", "C"],
        vec![
            Line::new("exact", Mark::Theory, ratios.map(|ratio| [ratio, exact(ratio)]).collect()),
            Line::new("density 0.1", Mark::Points, light),
            Line::new("density 2", Mark::Points, heavy),
        ],
    );
}

/// A2.
fn cylinder_in_a_vessel(lane: Lane, sheet: &mut Sheet) {
    let mut own = [Vec::new(), Vec::new()];
    for (ratio, across, s) in [(2.0, 10.0, 0.1), (2.0, 10.0, 2.0), (2.0, 20.0, 2.0), (3.0, 10.0, 0.1), (3.0, 10.0, 2.0)]
    {
        let what = format!("cylinder in a vessel, b/a = {ratio}, a/dx = {across}, s = {s}: C");
        let c = annulus(lane, ratio, across, s, STIFF);
        own[usize::from(s > 1.0)].push([ratio, c]);
        sheet.relative(&what, added_mass(false, ratio), c, OF_ADDED_MASS);
    }
    let exact = |ratio: f64| (ratio * ratio + 1.0) / (ratio * ratio - 1.0);
    chart_of_added_mass(lane, "cylinder in a cylindrical vessel", own, exact, sheet);
}

/// A5. A level surface through the middle, where pressure is zero, changes nothing: mirrored there with the opposite sign, the potential
/// of the half is that of the whole.
fn ball_in_the_surface(lane: Lane, sheet: &mut Sheet) {
    for (ratio, across, s) in [(2.0, 10.0, 0.5), (2.0, 10.0, 2.0), (3.0, 10.0, 0.5), (6.0, 6.0, 0.5)] {
        let vessel = Vessel { half: true, ..Vessel::full(ratio, across) };
        let what = format!("ball half in the surface, b/a = {ratio}, a/dx = {across}, s = {s}: C");
        let c = vessel.added_mass(lane, s, STIFF);
        sheet.relative(&what, added_mass(true, ratio), c, OF_ADDED_MASS);
    }
}

/// A6: bodies much lighter than the liquid go up at g/C, which weak coupling cannot do at all.
fn bodies_without_mass(lane: Lane, sheet: &mut Sheet) {
    for (s, young) in [(1e-3, 1e8), (1e-6, 1e7)] {
        let vessel = Vessel::full(2.0, 10.0);
        let what = format!("ball, b/a = 2, s = {s:e}: g over its acceleration upwards");
        let c = vessel.added_mass(lane, s, young);
        sheet.relative(&what, (added_mass(true, 2.0) + s) / (1.0 - s), (c + s) / (1.0 - s), OF_ADDED_MASS);
        let what = format!("cylinder, b/a = 2, s = {s:e}: g over its acceleration upwards");
        let c = annulus(lane, 2.0, 10.0, s, young);
        sheet.relative(&what, (added_mass(false, 2.0) + s) / (1.0 - s), (c + s) / (1.0 - s), OF_ADDED_MASS);
    }
}

/// Young's modulus with which pressure changes a body in a step by less than a thousandth of what it moves, Pa.
const STIFF: f64 = 1e9;

/// From the table.
fn added_mass(sphere: bool, ratio: f64) -> f64 {
    let rows = table("tests/data/added_mass.csv");
    let row = rows.iter().find(|row| (row[0] == 1.0) == sphere && row[1] == ratio);
    row.expect("the table has the case")[2]
}

/// B1: a block on rollers is the spring, and half of its mass the piston. Its bricks are thin, or nodes whose shares of mass and of
/// pressure differ would swing by themselves.
fn piston(lane: Lane, sheet: &mut Sheet) {
    for row in table("tests/data/piston_column.csv") {
        let [m_s, k, column, _, ratio, omega, dt, z, omega_h] = row[..] else { panic!("{row:?}") };
        // On the device short steps take long.
        if lane != Lane::F64 && dt < 0.02 && ratio < 1000.0 {
            continue;
        }
        let steps = (1.2 * std::f64::consts::PI / (omega * dt)).ceil().max(8.0) as usize;
        let (swing, velocities) = swings(lane, &Piston { m_s, k, column, dt, off: 0.0, patches: "cell" }, steps);
        let what = format!("piston, m_a/m_s = {ratio}, dt = {dt}");
        sheet.relative(&format!("{what}: frequency, 1/s"), omega_h, swing[0], 1e-3);
        let [expected, got] = [z, swing[1]].map(|z| -z.ln());
        sheet.relative(&format!("{what}: decay per step"), expected, got, 1e-3);
        if dt != 0.02 || ratio != 10.0 {
            continue;
        }
        // Backward Euler of one mass and one spring, from the same push.
        let (mut v, mut x) = (1e-4, 0.0);
        let discrete = (1..=velocities.len()).map(|number| {
            v = (v - omega * omega * dt * x) / (1.0 + (omega * dt).powi(2));
            x += dt * v;
            [dt * number as f64, v]
        });
        let discrete: Vec<[f64; 2]> = discrete.collect();
        // The block is pushed as a whole, its mode is a slope: both over their first velocity.
        let over_first = |series: Vec<[f64; 2]>| {
            let first = series[0][1];
            series.into_iter().map(|[t, v]| [t, v / first]).collect()
        };
        let own = velocities.iter().zip(1..);
        let own = own.map(|(v, number)| [dt * f64::from(number), *v]);
        sheet.chart(
            &format!("piston against a column, m_a/m_s = {ratio}, dt = {dt}, {}", lane.name()),
            ["t, s", "velocity over that of the first step"],
            vec![
                Line::new("backward Euler of mass and spring", Mark::Theory, over_first(discrete)),
                Line::new("piston", Mark::Points, over_first(own.collect())),
            ],
        );
    }
    if lane != Lane::F64 {
        return;
    }
    // Where pressure is one number per cell, the column begins in the middle of the piston's cell.
    for patches in ["cell", "gradient"] {
        let piston = Piston { m_s: 100.0, k: 1e5, column: 1.0, dt: 0.02, off: 0.25, patches };
        let ([frequency, _], _) = swings(lane, &piston, 24);
        sheet.info(
            &format!("piston a quarter of a cell off the middle of one, \"{patches}\", m_a/m_s = 10: frequency off by"),
            format!("{:+.1e}", frequency / piston.frequency() - 1.0),
        );
    }
}

struct Piston {
    /// Per area: kg/m^2, N/m^3.
    m_s: f64,
    k: f64,
    /// m
    column: f64,
    /// s
    dt: f64,
    /// How far the piston is from the middle of a cell, cells.
    off: f64,
    /// `pressure_on_patches`
    patches: &'static str,
}

impl Piston {
    /// Of backward Euler, 1/s.
    fn frequency(&self) -> f64 {
        let omega = (self.k / (self.m_s + 1000.0 * self.column)).sqrt();
        (omega * self.dt).atan() / self.dt
    }
}

/// Frequency (1/s) and factor per step of a piston that is pushed, from v'' = a v' + b v of its velocities in a row, and these, m/s.
fn swings(lane: Lane, piston: &Piston, steps: usize) -> ([f64; 2], Vec<f64>) {
    const DX: f64 = 0.03;
    let &Piston { m_s, k, column, dt, off, patches } = piston;
    let length = (29.5 + off) * DX;
    let mut simulation = simulation(
        lane,
        &format!(
            "[domain]
size = [{:?}, {width:?}, {width:?}]
cells = [64, 4, 4]
gravity = [0, 0, 0]
[time]
duration = 10
frames_per_second = {:?}
fixed_step = {dt:?}
[liquid]
surface = \"fixed\"
[[liquid.region]]
half_space = {{ point = [{:?}, 0, 0], normal = [1, 0, 0] }}
velocity = [1e-4, 0, 0]
[[solid]]
name = \"spring\"
mesh = {{ box = {{ size = [{length:?}, {width:?}, {width:?}], cells = [1, 4, 4] }} }}
placement = {{ translate = [{:?}, {:?}, {:?}] }}
initial = {{ velocity = [1e-4, 0, 0] }}
density = {:?}
young = {:?}
poisson = 0.0
[[solid.pin]]
region = {{ box = {{ min = [0, 0, 0], max = [{length:?}, {width:?}, {width:?}] }} }}
components = \"yz\"
[[solid.pin]]
region = {{ box = {{ min = [0, 0, 0], max = [0.001, {width:?}, {width:?}] }} }}
components = \"x\"
[solver]
tolerance = 1e-10
pressure_on_patches = \"{patches}\"
",
            64.0 * DX,
            1.0 / dt,
            length + column,
            0.5 * length,
            2.0 * DX,
            2.0 * DX,
            2.0 * m_s / length,
            k * length,
            width = 4.0 * DX,
        ),
        &[],
    );
    let mut velocities = Vec::new();
    for _ in 0..steps {
        step(&mut simulation);
        velocities.push(mean_velocity(&simulation).x);
    }
    let (mut aa, mut ab, mut bb, mut ac, mut bc) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for v in velocities.windows(3) {
        aa += v[1] * v[1];
        ab += v[1] * v[0];
        bb += v[0] * v[0];
        ac += v[1] * v[2];
        bc += v[0] * v[2];
    }
    let det = aa * bb - ab * ab;
    let (a, b) = ((ac * bb - bc * ab) / det, (bc * aa - ac * ab) / det);
    // z^2 = a z + b, with complex roots.
    let angle = (-b - 0.25 * a * a).sqrt().atan2(0.5 * a);
    ([angle / dt, (-b).sqrt()], velocities)
}

/// B2: a block on rollers under a column of water, both at rest at last. The mean of u over its top is exact in linear tetrahedra,
/// since u = y is one of their functions.
fn column_on_a_block(lane: Lane, sheet: &mut Sheet) {
    const WIDTH: f64 = 0.25;
    let (length, level, density) = (0.47, 0.9, 1500.0);
    for young in [1e6, 1e8] {
        let poisson = 0.3;
        let mut simulation = simulation(
            lane,
            &format!(
                "[domain]
size = [{WIDTH:?}, 1.0, {WIDTH:?}]
cells = [4, 16, 4]
[time]
duration = 100
frames_per_second = 10
fixed_step = 0.1
[liquid]
surface = \"fixed\"
[[liquid.region]]
half_space = {{ point = [0, {level:?}, 0], normal = [0, 1, 0] }}
[[solid]]
name = \"block\"
mesh = {{ box = {{ size = [{WIDTH:?}, {length:?}, {WIDTH:?}], cells = [2, 4, 2] }} }}
placement = {{ translate = [{:?}, {:?}, {:?}] }}
density = {density:?}
young = {young:?}
poisson = {poisson:?}
[[solid.pin]]
region = {{ box = {{ min = [0, 0, 0], max = [{WIDTH:?}, {length:?}, {WIDTH:?}] }} }}
components = \"xz\"
[[solid.pin]]
region = {{ box = {{ min = [0, 0, 0], max = [{WIDTH:?}, 0.001, {WIDTH:?}] }} }}
components = \"y\"
[solver]
tolerance = 1e-10
",
                0.5 * WIDTH,
                0.5 * length,
                0.5 * WIDTH,
            ),
            &[],
        );
        let seconds = settle(&mut simulation, 200);
        let top = mean_over(&simulation, |x| x.y > length - 1e-6).y;
        // Pressure at the top where it comes to lie: M u = - (rho g (level - L - u) L + rho_s g L^2 / 2).
        let modulus = young * (1.0 - poisson) / ((1.0 + poisson) * (1.0 - 2.0 * poisson));
        let load = 1000.0 * GRAVITY * (level - length) * length + 0.5 * density * GRAVITY * length * length;
        let expected = -load / (modulus - 1000.0 * GRAVITY * length);
        let what = format!("column on a block, E = {young:e} Pa, after {seconds:.1} s: u of the top, m");
        sheet.relative(&what, expected, top, 1e-4);
        let pressure = 1000.0 * GRAVITY * (level - length - expected);
        let heights = (0..=40).map(|n| length * f64::from(n) / 40.0);
        let exact = heights.map(|y| {
            let weight = density * GRAVITY * y * (length - 0.5 * y);
            [y, -(pressure * y + weight) / modulus]
        });
        let layers = (0..=4).map(|layer| {
            let y = length * f64::from(layer) / 4.0;
            [y, mean_at_height(&simulation, y)]
        });
        sheet.chart(
            &format!("block under a column of water, E = {young:e} Pa, {}", lane.name()),
            ["height at rest, m", "displacement, m"],
            vec![Line::new("exact", Mark::Theory, exact.collect()), Line::new("nodes", Mark::Points, layers.collect())],
        );
    }
}

/// Mean displacement upwards of the nodes at a height at rest, m.
fn mean_at_height(simulation: &Simulation, y: f64) -> f64 {
    let state = simulation.state().unwrap_or_else(|error| panic!("{error}"));
    let nodes = simulation.solids().rest.iter().zip(&state.displacement);
    let there: Vec<f64> = nodes.filter(|(rest, _)| (rest.y - y).abs() < 1e-6).map(|(_, u)| u[1]).collect();
    there.iter().sum::<f64>() / there.len() as f64
}

/// Steps until no node moves by a millionth of the largest displacement in a step; the time then, s.
fn settle(simulation: &mut Simulation, most: usize) -> f64 {
    for _ in 0..most {
        let report = step(simulation);
        let state = simulation.state().unwrap_or_else(|error| panic!("{error}"));
        let [u, v] = [&state.displacement, &state.node_velocity].map(|x| largest(x));
        if report.dt * v <= 1e-6 * u {
            return state.time;
        }
    }
    panic!("it still moves after {most} steps");
}

/// Mean displacement over the surface triangles whose corners are all of a part of the body at rest, by area, m.
fn mean_over(simulation: &Simulation, part: impl Fn(DVec3) -> bool) -> DVec3 {
    let state = simulation.state().unwrap_or_else(|error| panic!("{error}"));
    let solids = simulation.solids();
    let (mut sum, mut area) = (DVec3::ZERO, 0.0);
    for triangle in &solids.triangles {
        let nodes = triangle.map(|node| node as usize);
        let [a, b, c] = nodes.map(|node| solids.rest[node]);
        if [a, b, c].into_iter().all(&part) {
            let of_this = 0.5 * (b - a).cross(c - a).length();
            let u = nodes.map(|node| DVec3::from(state.displacement[node]));
            sum += of_this / 3.0 * u.into_iter().sum::<DVec3>();
            area += of_this;
        }
    }
    sum / area
}

/// W1: where bodies float at last. A level that is rounded to whole cells is off by a quarter of a cell in the mean.
fn floating_bodies(lane: Lane, sheet: &mut Sheet) {
    const DX: f64 = 0.025;
    const LEVEL: f64 = 0.37;
    let (height, radius) = (0.2, 0.12);
    let mut drafts = [Vec::new(), Vec::new()];
    for row in table("tests/data/buoyancy_equilibrium.csv").into_iter().take(2) {
        let box_mesh = format!("box = {{ size = [0.4, {height:?}, 0.4], cells = [4, 2, 4] }}");
        let ball_mesh = format!("sphere = {{ radius = {radius:?}, cell_size = 0.03 }}");
        for (name, mesh, half, draft) in
            [("box", box_mesh, 0.5 * height, row[1] * height), ("ball", ball_mesh, radius, row[2] * radius)]
        {
            let start = LEVEL - 0.6 * draft + half;
            let mut simulation = simulation(
                lane,
                &format!(
                    "[domain]
size = [0.8, 0.6, 0.8]
cells = [32, 24, 32]
[time]
duration = 3
frames_per_second = 12
[liquid]
surface = \"fixed\"
[[liquid.region]]
half_space = {{ point = [0, {LEVEL:?}, 0], normal = [0, 1, 0] }}
[[solid]]
name = \"body\"
mesh = {{ {mesh} }}
placement = {{ translate = [0.41, {start:?}, 0.39] }}
density = {:?}
young = 1e7
poisson = 0.3
damping = {{ mass = 20.0 }}
[[probe]]
name = \"body\"
solid = {{ name = \"body\" }}
",
                    1000.0 * row[0],
                ),
                &[],
            );
            while simulation.clock().frame < 36 {
                step(&mut simulation);
            }
            let speed = mean_velocity(&simulation).length();
            let middle = simulation.probes().unwrap_or_else(|error| panic!("{error}"))[1];
            let got = LEVEL - (middle - half);
            let what = format!("floating {name}, s = {}: draft off by, cells", row[0]);
            sheet.at_most(&what, (got - draft).abs() / DX, 0.25);
            drafts[usize::from(name == "ball")].push([row[0], got / half]);
            sheet.info(
                &format!("floating {name}, s = {}", row[0]),
                format!("draft {got:.5} m for {draft:.5} m, still {speed:.1e} m/s"),
            );
        }
    }
    let [boxes, balls] = drafts;
    let of_box = (0..=50).map(|n| 0.02 * f64::from(n)).map(|s| [s, 2.0 * s]);
    // The cap of a ball of radius 1 and depth d is d^2 (3 - d) / 4 of it.
    let of_ball = (0..=50).map(|n| 0.04 * f64::from(n));
    let of_ball = of_ball.map(|d| [d * d * (3.0 - d) / 4.0, d]);
    sheet.chart(
        &format!("where bodies float, {}", lane.name()),
        ["density over the liquid's", "draft over half the height"],
        vec![
            Line::new("box, Archimedes", Mark::Theory, of_box.collect()),
            Line::new("ball, Archimedes", Mark::Theory, of_ball.collect()),
            Line::new("box", Mark::Points, boxes),
            Line::new("ball", Mark::Points, balls),
        ],
    );
}

/// A clamped plate of 1 x 0.05 m, and as wide as the slab that it is computed in, under 2 m of water (Fourey et al. 2017).
struct Plate {
    young: f64,
    /// Bricks along and through it.
    bricks: [usize; 2],
    /// Of a step, s.
    dt: f64,
}

impl Plate {
    const DX: f64 = 0.025;
    const THICKNESS: f64 = 0.05;
    /// Of its middle, a third of a cell above a plane of the grid.
    const HEIGHT: f64 = 3.0 * Plate::DX + 0.008;
    const POISSON: f64 = 0.34;

    /// With some text on what acts on it.
    fn simulation(&self, lane: Lane, gravity: f64, loads: &str) -> Simulation {
        let width = 2.0 * Plate::DX;
        simulation(
            lane,
            &format!(
                "[domain]
size = [1.0, 2.25, {width:?}]
cells = [40, 90, 2]
gravity = [0, {:?}, 0]
[time]
duration = 100
frames_per_second = {:?}
fixed_step = {:?}
[[solid]]
name = \"plate\"
mesh = {{ box = {{ size = [1.0, {:?}, {width:?}], cells = [{}, {}, 1] }} }}
placement = {{ translate = [0.5, {:?}, {:?}] }}
density = 2700.0
young = {:?}
poisson = {:?}
[[solid.pin]]
region = {{ box = {{ min = [0, 0, 0], max = [1, 1, 1] }} }}
components = \"z\"
[[solid.pin]]
region = {{ box = {{ min = [0, 0, 0], max = [0.001, 1, 1] }} }}
[[solid.pin]]
region = {{ box = {{ min = [0.999, 0, 0], max = [1, 1, 1] }} }}
[solver]
tolerance = 1e-10
{loads}",
                -gravity,
                1.0 / self.dt,
                self.dt,
                Plate::THICKNESS,
                self.bricks[0],
                self.bricks[1],
                Plate::HEIGHT,
                0.5 * width,
                self.young,
                Plate::POISSON,
            ),
            &[],
        )
    }

    /// Displacement (m) and velocity (m/s) of the middle, upwards.
    fn middle(simulation: &Simulation) -> [f64; 2] {
        let state = simulation.state().unwrap_or_else(|error| panic!("{error}"));
        let rest = simulation.solids().rest.iter().enumerate();
        let of_middle = rest.filter(|(_, x)| (x.x - 0.5).abs() < 1e-6);
        let nodes: Vec<usize> = of_middle.map(|(node, _)| node).collect();
        [&state.displacement, &state.node_velocity]
            .map(|of_node| nodes.iter().map(|&node| of_node[node][1]).sum::<f64>() / nodes.len() as f64)
    }

    /// Under a load on its upper side, dry, m.
    fn dry(&self, lane: Lane, pressure: f64) -> f64 {
        let top = Plate::HEIGHT + 0.5 * Plate::THICKNESS;
        let load = format!(
            "[[solid.load]]
region = {{ box = {{ min = [0, {:?}, 0], max = [1, {:?}, 1] }} }}
traction = [0, {:?}, 0]
",
            top - 0.001,
            top + 0.001,
            -pressure,
        );
        let mut simulation = self.simulation(lane, 0.0, &load);
        settle(&mut simulation, 50);
        Plate::middle(&simulation)[0]
    }

    /// Under water.
    fn wet(&self, lane: Lane) -> Simulation {
        let level = Plate::HEIGHT + 0.5 * Plate::THICKNESS + 2.0;
        let water = format!(
            "[liquid]
surface = \"fixed\"
[[liquid.region]]
box = {{ min = [0, {:?}, 0], max = [1, {level:?}, 1] }}
",
            Plate::HEIGHT,
        );
        self.simulation(lane, GRAVITY, &water)
    }
}

/// The clamped plate. Linear tetrahedra are stiff in bending: Young's modulus is multiplied by what the plate's own mesh bends to dry,
/// under the same load, over what it should.
fn plate_under_water(lane: Lane, sheet: &mut Sheet) {
    // Water and weight.
    let load = GRAVITY * (1000.0 * 2.0 + 2700.0 * Plate::THICKNESS);
    // Plane strain, converged (scikit-fem): 3 % more than a thin plate, from shear.
    let expected = -7.065e-5;
    let calibrated = |bricks, dt| {
        let young = 67.5e9;
        let dry = Plate { young, bricks, dt: 0.02 };
        let kfac = dry.dry(lane, load) / expected;
        let young = kfac * young;
        (kfac, Plate { young, bricks, dt })
    };
    for bricks in [[40, 2], [40, 4]] {
        let (kfac, plate) = calibrated(bricks, 0.02);
        let mut wet = plate.wet(lane);
        settle(&mut wet, 50);
        let what = format!("plate under 2 m of water, {bricks:?} bricks, E times {kfac:.4}: deflection, m");
        sheet.relative(&what, expected, Plate::middle(&wet)[0], 0.03);
    }
    // Water and weight come on at once: it swings about that in the first mode of plate and column (beam modes, and the potential of the
    // column).
    let dt = 2.5e-4;
    let (_, plate) = calibrated([40, 4], dt);
    let mut wet = plate.wet(lane);
    let (mut turns, mut before, mut own) = (Vec::new(), 0.0, Vec::new());
    for number in 0..100 {
        step(&mut wet);
        let [u, v] = Plate::middle(&wet);
        own.push([dt * f64::from(number + 1), 1e6 * u]);
        if v * before < 0.0 {
            turns.push(dt * (f64::from(number) - v / (v - before)));
        }
        before = v;
        if turns.len() == 2 {
            break;
        }
    }
    let omega = std::f64::consts::TAU * 78.9;
    // Backward Euler of the first mode alone about the plate's rest.
    let (mut v, mut x) = (0.0, -expected);
    let discrete = own.iter().map(|[t, _]| {
        v = (v - omega * omega * dt * x) / (1.0 + (omega * dt).powi(2));
        x += dt * v;
        [*t, 1e6 * (expected + x)]
    });
    let discrete = discrete.collect();
    let ends = [own[0][0], own[own.len() - 1][0]];
    sheet.chart(
        &format!("clamped plate when 2 m of water come on at once, {}", lane.name()),
        ["t, s", "deflection of the middle, micrometres"],
        vec![
            Line::new("plate", Mark::Line, own),
            Line::new("first mode, backward Euler", Mark::Theory, discrete),
            Line::new("at rest (scikit-fem)", Mark::Theory, ends.map(|t| [t, 1e6 * expected]).to_vec()),
        ],
    );
    let expected = (omega * dt).atan() / dt / std::f64::consts::TAU;
    let what = "plate under 2 m of water, its first swing: frequency, Hz";
    sheet.relative(what, expected, 0.5 / (turns[1] - turns[0]), 0.03);
}

/// No surface: whatever moves, the ball keeps its volume, and the level of the pressure is what sees to it.
fn closed_vessel(lane: Lane, sheet: &mut Sheet) {
    const DX: f64 = 0.05;
    // Sealed liquid is solved by iterations, in f64 too.
    let tolerance = lane.choose(1e-12, 1e-8, 1e-5);
    for (name, s, frames) in [("heavy", 2.0, 10), ("neutral", 1.0, 12), ("light", 0.2, 6)] {
        let mut simulation = simulation(
            lane,
            &format!(
                "[domain]
size = [1, 1, 1]
cells = [20, 20, 20]
[time]
duration = 1
[liquid]
surface = \"fixed\"
[[liquid.region]]
half_space = {{ point = [0, 2, 0], normal = [0, 1, 0] }}
[[solid]]
name = \"ball\"
mesh = {{ sphere = {{ radius = 0.15, cell_size = 0.05 }} }}
placement = {{ translate = [0.5, 0.5, 0.5] }}
density = {:?}
young = 1e5
poisson = 0.3
[[probe]]
name = \"ball\"
solid = {{ name = \"ball\" }}
[solver]
tolerance = {tolerance:?}
",
                1000.0 * s,
            ),
            &[],
        );
        let (mut divergence, mut off, mut motion) = (0.0, 0.0, Vec::new());
        while simulation.clock().frame < frames {
            let report = step(&mut simulation);
            let liquid = report.liquid.expect("the scene has liquid");
            divergence = larger(divergence, liquid.diagnosis.divergence);
            let probes = simulation.probes().unwrap_or_else(|error| panic!("{error}"));
            off = larger(off, (probes[3] - 1.0).abs());
            let speed = mean_velocity(&simulation).y;
            motion.push((simulation.clock().time, speed, probes));
        }
        let what = format!("{name} ball in a full tank, {} sub-steps", motion.len());
        // The device stores velocities of 1 m/s in f32: 6e-8 of that for each of six faces, over the cell's 0.05 m.
        let bound = lane.choose(1e-9, 1e-5, 1e-5);
        sheet.at_most(&format!("{what}: divergence, 1/s"), divergence, bound);
        // Pressure at this depth, measured from a free surface, would squeeze it by 6 %.
        let of_volume = format!("{what}: its volume over that at rest, off by");
        sheet.at_most(&of_volume, off, 1e-3);
        let (first, last) = (&motion[2], &motion[motion.len() - 1]);
        let aside = (last.2[0] - 0.5).hypot(last.2[2] - 0.5);
        sheet.at_most(&format!("{what}: way aside, cells"), aside / DX, 1e-3);
        if name == "neutral" {
            let mean = (last.1 - first.1) / (last.0 - first.0) / GRAVITY;
            let what = format!("{what}: acceleration from the third on, g");
            sheet.at_most(&what, mean.abs(), 1e-4);
        } else {
            sheet
                .info(&format!("{what}: speed upwards, m/s; way, m"), format!("{:.4}; {:.4}", last.1, last.2[1] - 0.5));
        }
    }
}

/// A scene from text, beside other files.
pub(crate) fn simulation(lane: Lane, text: &str, files: &[(&str, String)]) -> Simulation {
    let folder = tempfile::tempdir().expect("a folder for the scene");
    for (name, content) in files {
        fs::write(folder.path().join(name), content).expect("the mesh is written");
    }
    let path = folder.path().join("case.toml");
    fs::write(&path, text).expect("the scene is written");
    let scene = Scene::load(&path, &settings_of(text), 1.0).unwrap_or_else(|error| panic!("{error}"));
    Simulation::new(&scene, &lane.backend()).unwrap_or_else(|error| panic!("{error}"))
}

/// A sub-step, all solves of which must have converged.
pub(crate) fn step(simulation: &mut Simulation) -> StepReport {
    let report = simulation.step().unwrap_or_else(|error| panic!("{error}"));
    for solve in report.solves() {
        assert_eq!(solve.status, SolveStatus::Converged, "{report:?}");
    }
    report
}

/// Momentum of all solids over their mass, m/s.
pub(crate) fn mean_velocity(simulation: &Simulation) -> DVec3 {
    let state = simulation.state().unwrap_or_else(|error| panic!("{error}"));
    let solids = simulation.solids();
    let nodes = state.node_velocity.iter().zip(&solids.mass);
    let momentum: DVec3 = nodes.map(|(v, mass)| *mass * DVec3::from(*v)).sum();
    momentum / solids.mass.iter().sum::<f64>()
}

/// A ball in the middle of a spherical vessel, full or half full.
struct Vessel {
    /// Radius of the vessel over that of the ball.
    ratio: f64,
    /// Cells along the ball's radius.
    across: f64,
    /// Whether the liquid ends at the middle.
    half: bool,
    /// `solver.formulation`
    formulation: &'static str,
}

impl Vessel {
    fn full(ratio: f64, across: f64) -> Vessel {
        Vessel { ratio, across, half: false, formulation: "auto" }
    }

    /// Liquid that goes with the ball over what it displaces, from its acceleration in one step from rest. `s`: mass of the ball over
    /// that of the liquid it displaces; `young`: Pa.
    fn added_mass(&self, lane: Lane, s: f64, young: f64) -> f64 {
        let Vessel { ratio, across, half, formulation } = *self;
        let a = 0.1;
        let dx = a / across;
        let n = 2 * (ratio * across).ceil() as usize + 2;
        let size = n as f64 * dx;
        // Nothing lies on planes of the grid.
        let centre = DVec3::splat(0.5 * size) + dx * DVec3::new(0.13, 0.21, 0.37);
        let (middle, top) = (centre.to_array(), if half { centre.y } else { 2.0 * size });
        let density = s * if half { 500.0 } else { 1000.0 };
        let mut simulation = simulation(
            lane,
            &format!(
                "[domain]
size = [{size:?}, {size:?}, {size:?}]
cells = [{n}, {n}, {n}]
[time]
duration = 1
frames_per_second = 120
fixed_step = {DT:?}
[liquid]
surface = \"fixed\"
[[liquid.region]]
half_space = {{ point = [0, {top:?}, 0], normal = [0, 1, 0] }}
[[obstacle]]
sphere = {{ centre = {middle:?}, radius = {:?} }}
inside_out = true
[[solid]]
name = \"ball\"
mesh = {{ sphere = {{ radius = {a:?}, cell_size = {:?} }} }}
placement = {{ translate = {middle:?} }}
density = {density:?}
young = {young:?}
poisson = 0.3
[solver]
formulation = \"{formulation}\"
",
                ratio * a,
                a / 5.0,
            ),
            &[],
        );
        step(&mut simulation);
        of_acceleration(&simulation, s)
    }
}

/// C in a = (s - 1) / (s + C) g downwards, from the velocity after one step.
fn of_acceleration(simulation: &Simulation, s: f64) -> f64 {
    let fall = -mean_velocity(simulation).y / (GRAVITY * DT);
    (s - 1.0) / fall - s
}

/// The same of a cylinder in a cylindrical vessel, between two walls across its axis.
fn annulus(lane: Lane, ratio: f64, across: f64, s: f64, young: f64) -> f64 {
    let a = 0.1;
    let dx = a / across;
    let n = 2 * (ratio * across).ceil() as usize + 2;
    let (size, thickness) = (n as f64 * dx, 2.0 * dx);
    let [x, y] = [0.13, 0.21].map(|off| 0.5 * size + off * dx);
    let mut simulation = simulation(
        lane,
        &format!(
            "[domain]
size = [{size:?}, {size:?}, {thickness:?}]
cells = [{n}, {n}, 2]
[time]
duration = 1
frames_per_second = 120
fixed_step = {DT:?}
[liquid]
surface = \"fixed\"
[[liquid.region]]
half_space = {{ point = [0, {:?}, 0], normal = [0, 1, 0] }}
[[obstacle]]
cylinder = {{ base = [{x:?}, {y:?}, {:?}], axis = [0, 0, 1], radius = {:?}, height = {:?} }}
inside_out = true
[[solid]]
name = \"disc\"
mesh = {{ file = \"disc.msh\" }}
placement = {{ translate = [{x:?}, {y:?}, {:?}] }}
density = {:?}
young = {young:?}
poisson = 0.3
[[solid.pin]]
region = {{ box = {{ min = [0, 0, 0], max = [{size:?}, {size:?}, {thickness:?}] }} }}
components = \"z\"
",
            2.0 * size,
            -thickness,
            ratio * a,
            3.0 * thickness,
            0.5 * thickness,
            1000.0 * s,
        ),
        &[("disc.msh", disc(a, thickness, 8, 64))],
    );
    step(&mut simulation);
    of_acceleration(&simulation, s)
}

/// A disc about the origin as the prism of a regular polygon of the same area, upright along z, in the text of a Gmsh file: rings of
/// wedges.
fn disc(radius: f64, thickness: f64, rings: usize, sides: usize) -> String {
    let turn = std::f64::consts::TAU / sides as f64;
    let corner = radius * (turn / turn.sin()).sqrt();
    let mut nodes = vec![DVec3::ZERO];
    for ring in 1..=rings {
        let r = corner * ring as f64 / rings as f64;
        nodes.extend((0..sides).map(|side| {
            let (sin, cos) = (turn * side as f64).sin_cos();
            DVec3::new(r * cos, r * sin, 0.0)
        }));
    }
    let at = |ring: usize, side: usize| match ring {
        0 => 0,
        ring => 1 + (ring - 1) * sides + side % sides,
    };
    let mut triangles = Vec::new();
    for side in 0..sides {
        for ring in 0..rings {
            let [a, b] = [at(ring, side), at(ring, side + 1)];
            let [c, d] = [at(ring + 1, side), at(ring + 1, side + 1)];
            triangles.push([a, c, d]);
            if ring > 0 {
                triangles.push([a, d, b]);
            }
        }
    }
    extruded(&nodes, &triangles, &[-0.5 * thickness, 0.5 * thickness])
}

/// Triangles of a plane z = 0, drawn up through layers between heights, m, in the text of a Gmsh file: wedges of three tetrahedra each.
pub(crate) fn extruded(flat: &[DVec3], triangles: &[[usize; 3]], heights: &[f64]) -> String {
    let all = heights.iter().flat_map(|&z| flat.iter().map(move |x| x.with_z(z)));
    let nodes: Vec<DVec3> = all.collect();
    let mut elements = Vec::new();
    for layer in 1..heights.len() {
        let low = (layer - 1) * flat.len();
        for triangle in triangles {
            // The least number first: neighbours cut the side between them along the same diagonal.
            let first = (0..3).min_by_key(|&at| triangle[at]).expect("three corners");
            let [a, b, c] = [0, 1, 2].map(|at| low + triangle[(first + at) % 3]);
            let [d, e, f] = [a, b, c].map(|node| node + flat.len());
            if b < c {
                elements.extend([[a, b, c, f], [a, b, f, e], [a, e, f, d]]);
            } else {
                elements.extend([[a, b, c, e], [a, e, c, f], [a, e, f, d]]);
            }
        }
    }
    gmsh(&nodes, &elements)
}

/// Tetrahedra as Gmsh 4.1 writes them.
fn gmsh(nodes: &[DVec3], elements: &[[usize; 4]]) -> String {
    let (n, m) = (nodes.len(), elements.len());
    let mut text = format!("$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Nodes\n1 {n} 1 {n}\n3 1 0 {n}\n");
    let mut line = |words: std::fmt::Arguments| {
        text.write_fmt(words).expect("a String takes everything");
    };
    (1..=n).for_each(|tag| line(format_args!("{tag}\n")));
    for x in nodes {
        line(format_args!("{:?} {:?} {:?}\n", x.x, x.y, x.z));
    }
    line(format_args!("$EndNodes\n$Elements\n1 {m} 1 {m}\n3 1 4 {m}\n"));
    for (element, [a, b, c, d]) in elements.iter().zip(1..).map(|(e, tag)| (tag, e.map(|node| node + 1))) {
        line(format_args!("{element} {a} {b} {c} {d}\n"));
    }
    line(format_args!("$EndElements\n"));
    text
}
