//! The cases: scenes in strong coupling, each hostile in one way, and the variants of the thesis's section 6.3.

use std::fmt::Write;
use std::path::Path;

use super::completed;
use crate::Error;
use crate::measure::bench::table::Row;
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
const THESIS: &str = include_str!("../../../../scenes/stability.toml");

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

/// Expected behaviour.
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
    pub fn holds(self, row: &Row) -> bool {
        let (completed, way, lift) = (completed(row), row.number("deflection"), row.number("lift"));
        match self {
            Expected::Completes => completed,
            // The size of an instability is random, its growth is not.
            Expected::Fails => {
                !completed && row.number("growth") >= GROWS && row.number("elastic_ratio") >= TORN
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

impl Setting {
    /// Changes all bodies.
    fn body(mut self, change: impl Fn(&mut Body)) -> Setting {
        self.bodies.iter_mut().for_each(change);
        self
    }

    /// Changes the setting.
    fn with(mut self, change: impl Fn(&mut Setting)) -> Setting {
        change(&mut self);
        self
    }

    /// Sub-steps of a fixed length: frames per second, and sub-steps in each.
    fn steps(self, frames: u32, in_each: u32) -> Setting {
        self.with(|setting| setting.steps = Some([frames, in_each]))
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

macro_rules! matrix {
    ($steps:ident, $($group:ident $name:literal $varies:literal => $setting:expr;)*) => {
        vec![$(Case {
            name: format!("{}_{}", stringify!($group), $name),
            group: stringify!($group),
            varies: $varies.to_owned(),
            steps: $steps,
            expected: Expected::Completes,
            text: $setting.text(),
            overrides: Vec::new(),
            scale: 1.0,
        }),*]
    };
}

/// All cases; hostile ones with so many sub-steps each, the thesis's with their own, in its scene with so many times its cells.
pub fn cases(steps: u64, scale: f64) -> Vec<Case> {
    let young = |setting: Setting, young: f64| setting.body(|body| body.young = young);
    let start = |initial: &'static str| pool().body(|body| body.initial = initial);
    let high = |gravity: f64| move |setting: &mut Setting| setting.gravity = gravity;
    let stiff_light = |setting: Setting, young: f64| {
        setting.body(|body| (body.young, body.density) = (young, 20.0))
    };
    let bar = |at, size, cells| Body {
        mesh: cuboid(size, cells),
        ..block(at)
    };
    let mut cases = matrix! { steps,
        density "1e-3" "0.001 times as heavy as the liquid" => pool().body(|body| body.density = 1.0);
        density "1e-2" "0.01 times as heavy as the liquid" => pool().body(|body| body.density = 10.0);
        density "0.1" "0.1 times as heavy as the liquid" => pool().body(|body| body.density = 100.0);
        density "1" "1 times as heavy as the liquid" => pool().body(|body| body.density = 1000.0);
        density "3" "3 times as heavy as the liquid" => pool().body(|body| body.density = 3000.0);
        density "10" "10 times as heavy as the liquid" => pool().body(|body| body.density = 10000.0);
        young "1e3" "block of E = 1e3 Pa" => young(pool(), 1e3);
        young "1e5" "block of E = 1e5 Pa" => young(pool(), 1e5);
        young "1e7" "block of E = 1e7 Pa" => young(pool(), 1e7);
        young "1e9" "block of E = 1e9 Pa" => young(pool(), 1e9);
        young "1e4_beam" "a beam that its own weight stretches by half, in a dam break" => young(dam(), 1e4);
        poisson "0" "beam of nu = 0 in a dam break" => dam().body(|body| body.poisson = 0.0);
        poisson "0.45" "beam of nu = 0.45 in a dam break" => dam().body(|body| body.poisson = 0.45);
        poisson "0.49" "beam of nu = 0.49 in a dam break" => dam().body(|body| body.poisson = 0.49);
        poisson "0.49_soft" "nu = 0.49, E = 1e4 Pa, lighter than the liquid" => pool().body(|body| (body.poisson, body.young) = (0.49, 1e4));
        damping "none" "beam damped by 0/s and 0 s" => dam().body(|body| body.damping = [0.0, 0.0]);
        damping "mass" "beam damped by 100/s and 0 s" => dam().body(|body| body.damping = [100.0, 0.0]);
        damping "stiffness" "beam damped by 0/s and 0.5 s" => dam().body(|body| body.damping = [0.0, 0.5]);
        damping "both" "beam damped by 100/s and 0.5 s" => dam().body(|body| body.damping = [100.0, 0.5]);
        step "1000" "sub-steps of 1/1000 s, dam break on a beam" => dam().steps(25, 40);
        step "240" "sub-steps of 1/240 s, dam break on a beam" => dam().steps(24, 10);
        step "60" "sub-steps of 1/60 s, dam break on a beam" => dam().steps(30, 2);
        step "24" "sub-steps of 1/24 s, dam break on a beam" => dam().steps(24, 1);
        step "15" "sub-steps of 1/15 s, dam break on a beam" => dam().steps(15, 1);
        step "15_stiff_light" "sub-steps of 1/15 s, beam of E = 1e9 Pa and 20 kg/m^3" => stiff_light(dam().steps(15, 1), 1e9);
        gravity "10g" "ten times the gravity, dam break on a beam" => dam().with(high(98.1));
        gravity "10g_stiff_light" "ten times the gravity, beam of E = 1e8 Pa and 20 kg/m^3, sub-steps of 1/96 s" =>
            stiff_light(dam().with(high(98.1)).steps(24, 4), 1e8);
        gravity "100g" "a hundred times the gravity, block in a pool" => pool().with(high(981.0));
        gravity "none" "no gravity: a ball of liquid flies into a block" =>
            setting(&["sphere = { centre = [0.25, 0.5, 0.5], radius = 0.18 }\nvelocity = [3, 0, 0]"], vec![block([0.7, 0.5, 0.5])]).with(high(0.0));
        start "inverted" "block inside out" => start("scale = -1.0");
        start "flat" "block without a volume" => start("scale = [1.0, 0.0, 1.0]");
        start "eighth" "block with an eighth of its volume" => start("scale = 0.5");
        start "grown" "block with three times its volume, half in the liquid" => start("scale = 1.5");
        start "spun" "block that spins at 40 rad/s" => start("spin = [0.0, 0.0, 40.0]");
        start "thrown" "block thrown into the pool at 10 m/s" => start("velocity = [0.0, -10.0, 0.0]");
        start "hinged" "bar of E = 1e8 Pa on a hinge, level, swings into the pool" => setting(&[POOL], vec![Body {
            density: 1000.0,
            young: 1e8,
            held: Some("box = { min = [0.29, 0.69, 0], max = [0.31, 0.71, 1] }"),
            ..bar([0.5, 0.7, 0.5], [0.4, 0.1, 0.1], [8, 2, 2])
        }]);
        sliver "thin" "plate a fifth of a cell thick under a dam break" =>
            setting(&[COLUMN], vec![bar([0.6, 0.31, 0.5], [0.5, 0.0125, 0.5], [8, 1, 8])]);
        sliver "turned" "bricks ten times as long as thick, turned against the grid" =>
            pool().body(|body| (body.mesh, body.turned) = (cuboid([0.3, 0.3, 0.3], [1, 10, 2]), 37.0));
        sliver "aligned" "block whose sides lie a thousandth of a cell off the grid's" =>
            setting(&[POOL], vec![block([0.500_062_5, 0.250_062_5, 0.500_062_5])]).body(|body| body.density = 1000.0);
        gap "floor_0" "heavy block 0 cells above the floor of a pool" => sunken(0.0).body(|body| body.density = 2000.0);
        gap "floor_0.1" "heavy block 0.1 cells above the floor of a pool" => sunken(0.1 / 16.0).body(|body| body.density = 2000.0);
        gap "floor_0.5" "heavy block 0.5 cells above the floor of a pool" => sunken(0.5 / 16.0).body(|body| body.density = 2000.0);
        gap "floor_light" "light block a tenth of a cell above the floor of a pool" => sunken(0.1 / 16.0).body(|body| body.density = 100.0);
        gap "solids_0.2" "two heavy blocks under water, a film of 0.2 cells between: nothing else holds them apart" => pair(2000.0);
        gap "solids_0.2_light" "a light block 0.2 cells above a heavy one under water: the film between them opens" => pair(50.0);
        wall "through" "beam half through an obstacle, held there" => setting(&[POOL], vec![Body {
            held: Some("box = { min = [0, 0, 0], max = [0.501, 1, 1] }"),
            ..bar([0.5, 0.3, 0.5], [0.75, 0.125, 0.125], [12, 2, 2])
        }]).with(|setting| setting.obstacle = Some("box = { min = [0, 0, 0], max = [0.5, 0.7, 1] }"));
        wall "obstacle" "block that starts 0.9 cells deep in an obstacle" =>
            setting(&[POOL], vec![block([0.25 + 0.125 - 0.9 / 16.0, 0.3, 0.5])])
                .with(|setting| setting.obstacle = Some("box = { min = [0, 0, 0], max = [0.25, 0.7, 1] }"));
        droplet "one" "a droplet of one cell falls on a light pad" =>
            setting(&["sphere = { centre = [0.53125, 0.53125, 0.53125], radius = 0.075 }"], vec![pad()]);
        droplet "rain" "four droplets of one cell fall on a light pad" => setting(&[
            "sphere = { centre = [0.34375, 0.53125, 0.53125], radius = 0.075 }",
            "sphere = { centre = [0.65625, 0.65625, 0.40625], radius = 0.075 }",
            "sphere = { centre = [0.53125, 0.78125, 0.65625], radius = 0.075 }",
            "sphere = { centre = [0.40625, 0.90625, 0.34375], radius = 0.075 }",
        ], vec![pad()]);
        closed "light" "full tank, block of 10 kg/m^3, E = 1e6 Pa" => closed(10.0, 1e6);
        closed "heavy" "full tank, block of 5000 kg/m^3, E = 1e6 Pa" => closed(5000.0, 1e6);
        closed "soft" "full tank, block of 900 kg/m^3, E = 1e4 Pa" => closed(900.0, 1e4);
        closed "stiff" "full tank, block of 900 kg/m^3, E = 1e9 Pa" => closed(900.0, 1e9);
        inside "full" "hollow ball full of liquid falls to the floor" => hollow(&[BALL], 300.0);
        inside "half" "hollow ball half full falls to the floor" =>
            hollow(&[BALL, "box = { min = [0, 0.5, 0], max = [1, 1, 1] }\nsubtract = true"], 300.0);
        inside "both" "hollow ball full of liquid in a pool" => hollow(&[BALL, POOL], 100.0);
        empty "nothing" "a region of liquid that no cell holds and a droplet far from a block" => setting(&[
            "sphere = { centre = [0.1, 0.9, 0.1], radius = 0.005 }",
            "sphere = { centre = [0.09375, 0.53125, 0.90625], radius = 0.075 }",
        ], vec![block([0.5, 0.3, 0.5])]);
        empty "dry" "block on a shelf that the liquid does not reach" =>
            setting(&["box = { min = [0, 0, 0], max = [1, 0.2, 1] }"], vec![block([0.5, 0.7, 0.5])])
                .with(|setting| setting.obstacle = Some("box = { min = [0.3, 0.3, 0.3], max = [0.7, 0.5, 0.7] }"));
        empty "never" "block falls where there is no liquid from start to end: its source opens too late" =>
            setting(&[], vec![block([0.5, 0.5, 0.5])]).with(|setting| setting.source = Some(LATE));
        corner "light_soft_15" "20 kg/m^3, E = 1e4 Pa, nu = 0.49, sub-steps of 1/15 s, block in a pool" =>
            stiff_light(pool().steps(15, 1), 1e4).body(|body| body.poisson = 0.49);
        corner "heavy_stiff_15" "10,000 kg/m^3, E = 1e9 Pa, sub-steps of 1/15 s, block in a pool" =>
            pool().steps(15, 1).body(|body| (body.density, body.young) = (1e4, 1e9));
        corner "light_stiff_1000" "1 kg/m^3, E = 1e9 Pa, no damping, sub-steps of 1/1000 s, dam break on a beam" =>
            dam().steps(25, 40).body(|body| (body.density, body.young) = (1.0, 1e9));
    };
    cases.extend(thesis_cases(scale));
    cases
}

/// A block in a full tank.
fn closed(density: f64, young: f64) -> Setting {
    setting(&[FULL], vec![block([0.47, 0.53, 0.52])])
        .body(|body| (body.density, body.young) = (density, young))
}

/// A block of a density 0.2 cells above a heavy one, under water.
fn pair(density: f64) -> Setting {
    let low = Body {
        density: 2000.0,
        ..block([0.47, 0.14, 0.52])
    };
    let high = Body {
        density,
        ..block([0.5, 0.14 + 0.25 + 0.2 / 16.0, 0.5])
    };
    setting(
        &["box = { min = [0, 0, 0], max = [1, 0.6, 1] }"],
        vec![low, high],
    )
}

/// A light pad on the floor.
fn pad() -> Body {
    Body {
        mesh: cuboid([0.5, 0.125, 0.5], [6, 2, 6]),
        density: 200.0,
        young: 1e5,
        ..block([0.5, 0.0625, 0.5])
    }
}

const BALL: &str = "sphere = { centre = [0.5, 0.5, 0.5], radius = 0.2 }";
const LATE: &str = "box = { min = [0, 0.75, 0], max = [0.125, 0.875, 0.125] }\nvelocity = [0, -0.1, 0]\nstart = 999";

/// A hollow ball and liquid.
fn hollow(regions: &[&str], density: f64) -> Setting {
    let mesh = "shell = { radius = 0.3, thickness = 0.1, cell_size = 0.1 }".to_owned();
    let ball = Body {
        mesh,
        density,
        young: 1e5,
        ..block([0.5, 0.5, 0.5])
    };
    setting(regions, vec![ball]).with(|setting| setting.cells = 20)
}

/// The thesis's four pictures, from left to right, and the first of them in two more runs with other random numbers.
fn thesis_cases(scale: f64) -> [Case; 6] {
    const WEAK: &str = "solver.coupling=weak";
    const ASIDE: &str = "solid[0].placement.translate=[0.600001,0.5,0.5]";
    const DAMPING: &str = "solver.coupling=damping_only";
    const STRONG: &str = "solver.coupling=strong";
    const UNDAMPED: &str = "solid[0].damping.stiffness=0";
    let coarser = "weak coupling, nine tenths of the cells along an edge";
    [
        ("weak", "weak coupling", &[WEAK][..], 1.0, Expected::Fails),
        (
            "damping_only",
            "coupled to mass and damping alone",
            &[DAMPING],
            1.0,
            Expected::PushedAway,
        ),
        (
            "strong",
            "strong coupling",
            &[STRONG],
            1.0,
            Expected::StaysStiff,
        ),
        (
            "undamped",
            "strong coupling, no damping",
            &[UNDAMPED],
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
        ("coarser_weak", coarser, &[WEAK], 0.9, Expected::Fails),
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
