//! The cases: scenes in strong coupling that are hostile in one way each, and the four variants of the thesis's section 6.3.

use std::fmt::Write;
use std::path::Path;

use super::Row;
use crate::Error;
use crate::output::write_atomically;
use crate::scene::Scene;

/// Length of the beam of scenes/stability.toml, m.
pub(super) const BEAM: f64 = 0.8;
/// Sub-steps that its scene lasts.
const THESIS_STEPS: u64 = 120;
/// Of its length that the stiff beam of the thesis may bend.
const STIFF: f64 = 0.1;
/// Of its length that its end may rise by that: one that gets no longer rises by 0.6 of the square of its way, 0.006, or 2/3 where it bends as a
/// parabola.
const LEVEL: f64 = 0.01;
/// Of its length that the wrong buoyancy pushes it away.
const PUSHED_AWAY: f64 = 0.2;
/// Of its length that the wrong buoyancy lifts it: twice what is right at most, and buoyancy acts upwards.
const LIFTED: f64 = 0.02;
/// What "extreme distortion" is: elastic energy over all energy of the start. Liquid and gravity could not give it as much if they gave all. Not
/// det F, which bending and shear leave as it is.
const TORN: f64 = 1.0;
/// Growth of an unstable beam's speed per sub-step, over four of them: its energy 25 times as large. The column of water as one with the beam's first
/// bending, m_a / m_s = 59 by potential flow around a square and w dt = 2.9, grows by 7.8 where all of it is wet ([`super::limit`]).
const GROWS: f64 = 1.5;
const THESIS: &str = include_str!("../../../scenes/stability.toml");

/// Cases that are known to fail over 2,000 sub-steps, and why; docs/bench.md has the experiments. A verdict names them as failures like
/// any other.
pub const KNOWN_FAILURES: [(&str, &str); 4] = [
    (
        "young_1e3",
        "the pool's pressure is four times the block's stiffness, and its elements turn inside out",
    ),
    (
        "droplet_one",
        "one of seven markers is lost below the pad, which is more than a tenth",
    ),
    (
        "closed_soft",
        "the pressure at the floor is above the block's bulk modulus, and its elements turn inside out",
    ),
    (
        "closed_stiff",
        "some face of the liquid is faster than a fall makes it",
    ),
];

/// What has to happen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Expected {
    /// The run comes to its end with a bounded energy and finite values.
    Completes,
    /// "the solid undergoing extreme distortion, and the simulation eventually failing"
    Fails,
    /// "pressure-induced buoyancy inaccurately dominates and incorrectly pushes the stiff solid to the surface"
    PushedAway,
    /// It completes, and the beam stays stiff.
    StaysStiff,
}

impl Expected {
    /// For tables.
    pub(super) fn name(self) -> &'static str {
        match self {
            Expected::Completes => "completes",
            Expected::Fails => "fails",
            Expected::PushedAway => "is pushed away",
            Expected::StaysStiff => "stays stiff",
        }
    }

    /// Whether it happened.
    pub(super) fn holds(self, row: &Row) -> bool {
        let (completed, way) = (row.completed(), row.deflection.unwrap_or(0.0));
        let lift = row.lift.unwrap_or(0.0);
        match self {
            Expected::Completes => completed,
            // How far an instability goes is chance, and how fast it grows is not.
            Expected::Fails => {
                let grows = row.growth.is_some_and(|growth| growth >= GROWS);
                !completed && grows && row.elastic_ratio >= TORN
            }
            Expected::PushedAway => completed && way >= PUSHED_AWAY && lift >= LIFTED,
            Expected::StaysStiff => completed && way <= STIFF && lift <= LEVEL,
        }
    }
}

/// A case.
#[derive(Clone, Debug)]
pub struct Case {
    /// Its name, unique.
    pub name: String,
    /// What cases beside it vary too.
    pub group: &'static str,
    /// What is hostile about it.
    pub varies: String,
    /// Sub-steps.
    pub steps: u64,
    /// What has to happen.
    pub expected: Expected,
    /// TOML.
    text: String,
    overrides: Vec<String>,
    scale: f64,
}

impl Case {
    /// Its scene.
    ///
    /// # Errors
    /// As [`Scene::load`].
    pub fn scene(&self) -> Result<Scene, Error> {
        let file = format!("{}.toml", self.name);
        Scene::parse(file.as_ref(), &self.text, &self.overrides, self.scale)
    }

    /// Writes the scene file; that of the thesis's is among the project's scenes.
    pub(super) fn write(&self, folder: &Path) -> Result<(), Error> {
        if self.group == "thesis" {
            return Ok(());
        }
        let text = format!("# {}.\n\n{}", self.varies, self.text);
        write_atomically(&folder.join(format!("{}.toml", self.name)), text.as_bytes())
    }
}

/// A box of 1 m with water and bodies in it.
#[derive(Clone)]
struct Setting {
    /// Along each edge.
    cells: usize,
    /// m/s^2, downwards.
    gravity: f64,
    /// Frames per second and sub-steps in each; as speeds allow where there is none.
    steps: Option<[u32; 2]>,
    /// Regions of liquid, with what belongs to each.
    liquid: Vec<String>,
    bodies: Vec<Body>,
    obstacle: Option<&'static str>,
    source: Option<&'static str>,
}

#[derive(Clone)]
struct Body {
    mesh: String,
    /// Middle, m.
    at: [f64; 3],
    /// About (1, 2, 3), degrees.
    turned: f64,
    /// kg/m^3
    density: f64,
    /// Pa
    young: f64,
    poisson: f64,
    /// Of mass, 1/s, and of stiffness, s.
    damping: [f64; 2],
    /// Keys of `initial`.
    initial: &'static str,
    /// Where its nodes are held.
    held: Option<&'static str>,
}

/// The lower 0.4 m of the box.
const POOL: &str = "box = { min = [0, 0, 0], max = [1, 0.4, 1] }";
/// All of it.
const FULL: &str = "box = { min = [0, 0, 0], max = [1, 1, 1] }";
/// A column that breaks.
const COLUMN: &str = "box = { min = [0, 0, 0], max = [0.35, 0.7, 1] }";

fn cuboid([x, y, z]: [f64; 3], cells: [usize; 3]) -> String {
    format!("box = {{ size = [{x:?}, {y:?}, {z:?}], cells = {cells:?} }}")
}

fn shell(thickness: f64) -> String {
    format!("shell = {{ radius = 0.3, thickness = {thickness:?}, cell_size = 0.1 }}")
}

/// A cube with a side of four cells.
fn block(at: [f64; 3]) -> Body {
    Body {
        mesh: cuboid([0.25; 3], [3, 3, 3]),
        at,
        turned: 0.0,
        density: 500.0,
        young: 1e6,
        poisson: 0.3,
        damping: [0.0; 2],
        initial: "",
        held: None,
    }
}

fn setting(liquid: &[&str], bodies: Vec<Body>) -> Setting {
    Setting {
        cells: 16,
        gravity: 9.81,
        steps: None,
        liquid: liquid.iter().map(|&region| region.to_owned()).collect(),
        bodies,
        obstacle: None,
        source: None,
    }
}

/// A block that starts half in a pool.
fn pool() -> Setting {
    setting(&[POOL], vec![block([0.47, 0.42, 0.52])])
}

/// A block below the surface of a pool.
fn sunken(height: f64) -> Setting {
    setting(&[POOL], vec![block([0.47, height + 0.125, 0.52])])
}

/// A column of water that breaks against a beam held at its upper end.
fn dam() -> Setting {
    let beam = Body {
        mesh: cuboid([0.125, 0.7, 0.125], [2, 10, 2]),
        density: 1100.0,
        held: Some("box = { min = [0, 0.899, 0], max = [1, 1, 1] }"),
        ..block([0.6, 0.55, 0.5])
    };
    setting(&[COLUMN], vec![beam])
}

/// Water between walls, all full, and a block in it.
fn closed() -> Setting {
    setting(&[FULL], vec![block([0.47, 0.53, 0.52])])
}

impl Setting {
    fn body(mut self, change: impl Fn(&mut Body)) -> Setting {
        self.bodies.iter_mut().for_each(change);
        self
    }

    fn cells(mut self, cells: usize) -> Setting {
        self.cells = cells;
        self
    }

    fn gravity(mut self, gravity: f64) -> Setting {
        self.gravity = gravity;
        self
    }

    fn steps(mut self, frames: u32, in_each: u32) -> Setting {
        self.steps = Some([frames, in_each]);
        self
    }

    fn obstacle(mut self, shape: &'static str) -> Setting {
        self.obstacle = Some(shape);
        self
    }

    fn source(mut self, keys: &'static str) -> Setting {
        self.source = Some(keys);
        self
    }

    fn text(&self) -> String {
        let mut text = format!(
            "[domain]
size = [1, 1, 1]
cells = {:?}
gravity = [0, {:?}, 0]
[time]
duration = 1000
",
            [self.cells; 3], -self.gravity,
        );
        if let Some([frames, in_each]) = self.steps {
            let step = 1.0 / (f64::from(frames) * f64::from(in_each));
            // Past the cells that a sub-step of this length may cross, a run is as it is.
            let _ = write!(
                text,
                "frames_per_second = {frames}\ncfl = 8\nfixed_step = {step:?}\n"
            );
        }
        if self.liquid.is_empty() {
            text += "[liquid]\n";
        }
        for region in &self.liquid {
            let _ = write!(text, "[[liquid.region]]\n{region}\n");
        }
        if let Some(keys) = self.source {
            let _ = write!(text, "[[source]]\n{keys}\n");
        }
        if let Some(shape) = self.obstacle {
            let _ = write!(text, "[[obstacle]]\n{shape}\n");
        }
        for (number, body) in self.bodies.iter().enumerate() {
            let [of_mass, of_stiffness] = body.damping;
            let _ = write!(
                text,
                "[[solid]]
name = \"body{number}\"
mesh = {{ {} }}
placement = {{ translate = {:?}, rotate = {{ axis = [1, 2, 3], degrees = {:?} }} }}
initial = {{ {} }}
density = {:?}
young = {:?}
poisson = {:?}
damping = {{ mass = {of_mass:?}, stiffness = {of_stiffness:?} }}
",
                body.mesh,
                body.at,
                body.turned,
                body.initial,
                body.density,
                body.young,
                body.poisson,
            );
            if let Some(shape) = body.held {
                let _ = write!(text, "[[solid.pin]]\nregion = {{ {shape} }}\n");
            }
        }
        text
    }
}

/// The matrix.
struct Matrix {
    steps: u64,
    cases: Vec<Case>,
}

impl Matrix {
    fn add(&mut self, group: &'static str, name: &str, varies: &str, setting: &Setting) {
        self.cases.push(Case {
            name: format!("{group}_{name}"),
            group,
            varies: varies.to_owned(),
            steps: self.steps,
            expected: Expected::Completes,
            text: setting.text(),
            overrides: Vec::new(),
            scale: 1.0,
        });
    }
}

/// All cases; hostile ones with so many sub-steps each, the thesis's with their own, in its scene with so many times its cells.
pub fn cases(steps: u64, scale: f64) -> Vec<Case> {
    let mut matrix = Matrix {
        steps,
        cases: Vec::new(),
    };
    materials(&mut matrix);
    times_and_forces(&mut matrix);
    shapes(&mut matrix);
    places(&mut matrix);
    liquids(&mut matrix);
    corners(&mut matrix);
    matrix.cases.extend(of_thesis(scale));
    matrix.cases
}

fn materials(to: &mut Matrix) {
    for (name, ratio) in [
        ("1e-3", 1e-3),
        ("1e-2", 1e-2),
        ("0.1", 0.1),
        ("1", 1.0),
        ("3", 3.0),
        ("10", 10.0),
    ] {
        let varies = format!("{ratio} times as heavy as the liquid");
        let setting = pool().body(|body| body.density = 1000.0 * ratio);
        to.add("density", name, &varies, &setting);
    }
    for (name, young) in [("1e3", 1e3), ("1e5", 1e5), ("1e7", 1e7), ("1e9", 1e9)] {
        let varies = format!("block of E = {name} Pa");
        let setting = pool().body(|body| body.young = young);
        to.add("young", name, &varies, &setting);
    }
    to.add(
        "young",
        "1e4_beam",
        "a beam that its own weight stretches by half, in a dam break",
        &dam().body(|body| body.young = 1e4),
    );
    for (name, poisson) in [("0", 0.0), ("0.45", 0.45), ("0.49", 0.49)] {
        let varies = format!("beam of nu = {name} in a dam break");
        let setting = dam().body(|body| body.poisson = poisson);
        to.add("poisson", name, &varies, &setting);
    }
    to.add(
        "poisson",
        "0.49_soft",
        "nu = 0.49, E = 1e4 Pa, lighter than the liquid",
        &pool().body(|body| (body.poisson, body.young) = (0.49, 1e4)),
    );
    for (name, damping) in [
        ("none", [0.0, 0.0]),
        ("mass", [100.0, 0.0]),
        ("stiffness", [0.0, 0.5]),
        ("both", [100.0, 0.5]),
    ] {
        let [of_mass, of_stiffness] = damping;
        let varies = format!("beam damped by {of_mass}/s and {of_stiffness} s");
        let setting = dam().body(|body| body.damping = damping);
        to.add("damping", name, &varies, &setting);
    }
}

fn times_and_forces(to: &mut Matrix) {
    for (name, frames, in_each) in [
        ("1000", 25, 40),
        ("240", 24, 10),
        ("60", 30, 2),
        ("24", 24, 1),
        ("15", 15, 1),
    ] {
        let varies = format!("sub-steps of 1/{name} s, dam break on a beam");
        to.add("step", name, &varies, &dam().steps(frames, in_each));
    }
    to.add(
        "step",
        "15_stiff_light",
        "sub-steps of 1/15 s, beam of E = 1e9 Pa and 20 kg/m^3",
        &dam()
            .steps(15, 1)
            .body(|body| (body.young, body.density) = (1e9, 20.0)),
    );
    to.add(
        "gravity",
        "10g",
        "ten times the gravity, dam break on a beam",
        &dam().gravity(98.1),
    );
    to.add(
        "gravity",
        "10g_stiff_light",
        "ten times the gravity, beam of E = 1e8 Pa and 20 kg/m^3, sub-steps of 1/96 s",
        &dam()
            .gravity(98.1)
            .steps(24, 4)
            .body(|body| (body.young, body.density) = (1e8, 20.0)),
    );
    to.add(
        "gravity",
        "100g",
        "a hundred times the gravity, block in a pool",
        &pool().gravity(981.0),
    );
    to.add(
        "gravity",
        "none",
        "no gravity: a ball of liquid flies into a block",
        &setting(
            &["sphere = { centre = [0.25, 0.5, 0.5], radius = 0.18 }\nvelocity = [3, 0, 0]"],
            vec![block([0.7, 0.5, 0.5])],
        )
        .gravity(0.0),
    );
}

fn shapes(to: &mut Matrix) {
    for (name, initial, varies) in [
        ("inverted", "scale = -1.0", "block inside out"),
        ("flat", "scale = [1.0, 0.0, 1.0]", "block without a volume"),
        (
            "eighth",
            "scale = 0.5",
            "block with an eighth of its volume",
        ),
        (
            "grown",
            "scale = 1.5",
            "block with three times its volume, half in the liquid",
        ),
        (
            "spun",
            "spin = [0.0, 0.0, 40.0]",
            "block that spins at 40 rad/s",
        ),
        (
            "thrown",
            "velocity = [0.0, -10.0, 0.0]",
            "block thrown into the pool at 10 m/s",
        ),
    ] {
        to.add(
            "start",
            name,
            varies,
            &pool().body(|body| body.initial = initial),
        );
    }
    to.add(
        "start",
        "hinged",
        "bar of E = 1e8 Pa on a hinge, level, swings into the pool",
        &setting(
            &[POOL],
            vec![Body {
                mesh: cuboid([0.4, 0.1, 0.1], [8, 2, 2]),
                density: 1000.0,
                young: 1e8,
                held: Some("box = { min = [0.29, 0.69, 0], max = [0.31, 0.71, 1] }"),
                ..block([0.5, 0.7, 0.5])
            }],
        ),
    );
    to.add(
        "sliver",
        "thin",
        "plate a fifth of a cell thick under a dam break",
        &setting(
            &[COLUMN],
            vec![Body {
                mesh: cuboid([0.5, 0.0125, 0.5], [8, 1, 8]),
                ..block([0.6, 0.31, 0.5])
            }],
        ),
    );
    to.add(
        "sliver",
        "turned",
        "bricks ten times as long as thick, turned against the grid",
        &pool().body(|body| {
            body.mesh = cuboid([0.3, 0.3, 0.3], [1, 10, 2]);
            body.turned = 37.0;
        }),
    );
    to.add(
        "sliver",
        "aligned",
        "block whose sides lie a thousandth of a cell off the grid's",
        &setting(
            &[POOL],
            vec![Body {
                density: 1000.0,
                ..block([0.500_062_5, 0.250_062_5, 0.500_062_5])
            }],
        ),
    );
}

fn places(to: &mut Matrix) {
    for (name, gap) in [("0", 0.0), ("0.1", 0.1), ("0.5", 0.5)] {
        let varies = format!("heavy block {name} cells above the floor of a pool");
        let setting = sunken(gap / 16.0).body(|body| body.density = 2000.0);
        to.add("gap", &format!("floor_{name}"), &varies, &setting);
    }
    to.add(
        "gap",
        "floor_light",
        "light block a tenth of a cell above the floor of a pool",
        &sunken(0.1 / 16.0).body(|body| body.density = 100.0),
    );
    let pair = |gap: f64, density: f64| {
        let low = block([0.47, 0.14, 0.52]);
        let high = Body {
            density,
            ..block([0.5, 0.14 + 0.25 + gap / 16.0, 0.5])
        };
        setting(
            &["box = { min = [0, 0, 0], max = [1, 0.6, 1] }"],
            vec![
                Body {
                    density: 2000.0,
                    ..low
                },
                high,
            ],
        )
    };
    to.add(
        "gap",
        "solids_0.2",
        "two heavy blocks under water, a film of 0.2 cells between: nothing else holds them apart",
        &pair(0.2, 2000.0),
    );
    to.add(
        "gap",
        "solids_0.2_light",
        "a light block 0.2 cells above a heavy one under water: the film between them opens",
        &pair(0.2, 50.0),
    );
    to.add(
        "wall",
        "through",
        "beam half through an obstacle, held there",
        &setting(
            &[POOL],
            vec![Body {
                mesh: cuboid([0.75, 0.125, 0.125], [12, 2, 2]),
                held: Some("box = { min = [0, 0, 0], max = [0.501, 1, 1] }"),
                ..block([0.5, 0.3, 0.5])
            }],
        )
        .obstacle("box = { min = [0, 0, 0], max = [0.5, 0.7, 1] }"),
    );
    to.add(
        "wall",
        "obstacle",
        "block that starts 0.9 cells deep in an obstacle",
        &setting(&[POOL], vec![block([0.25 + 0.125 - 0.9 / 16.0, 0.3, 0.5])])
            .obstacle("box = { min = [0, 0, 0], max = [0.25, 0.7, 1] }"),
    );
}

fn liquids(to: &mut Matrix) {
    let pad = || Body {
        mesh: cuboid([0.5, 0.125, 0.5], [6, 2, 6]),
        density: 200.0,
        young: 1e5,
        ..block([0.5, 0.0625, 0.5])
    };
    to.add(
        "droplet",
        "one",
        "a droplet of one cell falls on a light pad",
        &setting(
            &["sphere = { centre = [0.53125, 0.53125, 0.53125], radius = 0.075 }"],
            vec![pad()],
        ),
    );
    to.add(
        "droplet",
        "rain",
        "four droplets of one cell fall on a light pad",
        &setting(
            &[
                "sphere = { centre = [0.34375, 0.53125, 0.53125], radius = 0.075 }",
                "sphere = { centre = [0.65625, 0.65625, 0.40625], radius = 0.075 }",
                "sphere = { centre = [0.53125, 0.78125, 0.65625], radius = 0.075 }",
                "sphere = { centre = [0.40625, 0.90625, 0.34375], radius = 0.075 }",
            ],
            vec![pad()],
        ),
    );
    for (name, density, young) in [
        ("light", 10.0, 1e6),
        ("heavy", 5000.0, 1e6),
        ("soft", 900.0, 1e4),
        ("stiff", 900.0, 1e9),
    ] {
        let varies = format!("full tank, block of {density} kg/m^3, E = {young:e} Pa");
        let setting = closed().body(|body| (body.density, body.young) = (density, young));
        to.add("closed", name, &varies, &setting);
    }
    let ball = "sphere = { centre = [0.5, 0.5, 0.5], radius = 0.2 }";
    let hollow = |regions: &[&str], density: f64| {
        let ball = Body {
            mesh: shell(0.1),
            density,
            young: 1e5,
            ..block([0.5, 0.5, 0.5])
        };
        setting(regions, vec![ball]).cells(20)
    };
    to.add(
        "inside",
        "full",
        "hollow ball full of liquid falls to the floor",
        &hollow(&[ball], 300.0),
    );
    to.add(
        "inside",
        "half",
        "hollow ball half full falls to the floor",
        &hollow(
            &[
                ball,
                "box = { min = [0, 0.5, 0], max = [1, 1, 1] }\nsubtract = true",
            ],
            300.0,
        ),
    );
    to.add(
        "inside",
        "both",
        "hollow ball full of liquid in a pool",
        &hollow(&[ball, POOL], 100.0),
    );
    to.add(
        "empty",
        "nothing",
        "a region of liquid that no cell holds and a droplet far from a block",
        &setting(
            &[
                "sphere = { centre = [0.1, 0.9, 0.1], radius = 0.005 }",
                "sphere = { centre = [0.09375, 0.53125, 0.90625], radius = 0.075 }",
            ],
            vec![block([0.5, 0.3, 0.5])],
        ),
    );
    to.add(
        "empty",
        "dry",
        "block on a shelf that the liquid does not reach",
        &setting(
            &["box = { min = [0, 0, 0], max = [1, 0.2, 1] }"],
            vec![block([0.5, 0.7, 0.5])],
        )
        .obstacle("box = { min = [0.3, 0.3, 0.3], max = [0.7, 0.5, 0.7] }"),
    );
    to.add(
        "empty",
        "never",
        "block falls where there is no liquid from start to end: its source opens too late",
        &setting(&[], vec![block([0.5, 0.5, 0.5])]).source(
            "box = { min = [0, 0.75, 0], max = [0.125, 0.875, 0.125] }\nvelocity = [0, -0.1, 0]\nstart = 999",
        ),
    );
}

/// Several extremes at once.
fn corners(to: &mut Matrix) {
    to.add(
        "corner",
        "light_soft_15",
        "20 kg/m^3, E = 1e4 Pa, nu = 0.49, sub-steps of 1/15 s, block in a pool",
        &pool().steps(15, 1).body(|body| {
            (body.density, body.young, body.poisson) = (20.0, 1e4, 0.49);
        }),
    );
    to.add(
        "corner",
        "heavy_stiff_15",
        "10,000 kg/m^3, E = 1e9 Pa, sub-steps of 1/15 s, block in a pool",
        &pool()
            .steps(15, 1)
            .body(|body| (body.density, body.young) = (1e4, 1e9)),
    );
    to.add(
        "corner",
        "light_stiff_1000",
        "1 kg/m^3, E = 1e9 Pa, no damping, sub-steps of 1/1000 s, dam break on a beam",
        &dam()
            .steps(25, 40)
            .body(|body| (body.density, body.young) = (1.0, 1e9)),
    );
}

/// The thesis's four pictures, from left to right, and the first of them in two more runs, whose chance is another one.
fn of_thesis(scale: f64) -> [Case; 6] {
    const WEAK: &str = "solver.coupling=weak";
    const ASIDE: &str = "solid[0].placement.translate=[0.600001,0.5,0.5]";
    [
        ("weak", "weak coupling", &[WEAK][..], 1.0, Expected::Fails),
        (
            "damping_only",
            "coupled to mass and damping alone",
            &["solver.coupling=damping_only"],
            1.0,
            Expected::PushedAway,
        ),
        (
            "strong",
            "strong coupling",
            &["solver.coupling=strong"],
            1.0,
            Expected::StaysStiff,
        ),
        (
            "undamped",
            "strong coupling, no damping",
            &["solid[0].damping.stiffness=0"],
            1.0,
            Expected::StaysStiff,
        ),
        (
            "aside_weak",
            "weak coupling, the beam a micrometre aside",
            &[WEAK, ASIDE],
            1.0,
            Expected::Fails,
        ),
        (
            "coarser_weak",
            "weak coupling, nine tenths of the cells along an edge",
            &[WEAK],
            0.9,
            Expected::Fails,
        ),
    ]
    .map(|(name, varies, overrides, cells, expected)| Case {
        name: format!("thesis_{name}"),
        group: "thesis",
        varies: varies.to_owned(),
        steps: THESIS_STEPS,
        expected,
        text: THESIS.to_owned(),
        overrides: overrides.iter().map(|&text| text.to_owned()).collect(),
        scale: scale * cells,
    })
}
