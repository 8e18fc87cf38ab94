//! Problems with a known pressure, for the error of the grid.

use glam::DVec3;

use crate::Error;
use crate::scene::{Scene, Solver, names};
use crate::sim::{reference_path, solids_of};
use crate::state::State;

use crate::measure::plane_strain::{PlaneStrain, TABLE_6_5};

/// Weight of water, N/m^3.
const WEIGHT: f64 = 1000.0 * 9.81;
/// Depth of the pool, m: inside a cell on any grid.
const DEPTH: f64 = 0.613;
/// Width and height of the dam, m.
const DAM: f64 = 0.5;
/// Distance from the dam's foot within which errors do not count, m: the acceleration is infinite there.
const FOOT: f64 = 0.125;

/// A problem with a known solution.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exact {
    /// An elastic block at rest in a liquid, thesis section 6.4, table 6.5.
    Block,
    /// A pool at rest around a turned obstacle, its surface inside cells.
    Rest,
    /// A column of water at the instant when its dam is removed, Pohle 1950.
    Dam,
}

names! { Exact: "elastic_block" => Block, "pool_at_rest" => Rest, "dam_release" => Dam; }

impl Exact {
    /// Its scene; `cells` along 1 m: a multiple of 10.
    pub(super) fn scene(self, cells: usize, solver: Solver) -> Result<Scene, Error> {
        let text = match self {
            Exact::Block => return TABLE_6_5.scene(cells, solver),
            Exact::Rest => format!(
                "[domain]\nsize = [1.0, 1.0, 1.0]\ncells = [{cells}, {cells}, {cells}]\n\
                 [time]\nduration = 0.05\nframes_per_second = 20\nfixed_step = 0.05\n\
                 [liquid]\ndensity = 1000.0\nsurface = \"fixed\"\n\
                 [[liquid.region]]\nhalf_space = {{ point = [0.0, {DEPTH}, 0.0], normal = [0.0, 1.0, 0.0] }}\n\
                 [[obstacle]]\nbox = {{ min = [0.3, 0.15, 0.35], max = [0.7, 0.45, 0.65] }}\n\
                 placement = {{ rotate = {{ axis = [1.0, 2.0, 3.0], degrees = 35.0 }} }}\n"
            ),
            Exact::Dam => format!(
                "[domain]\nsize = [1.0, 1.0, {width}]\ncells = [{cells}, {cells}, 2]\n\
                 [time]\nduration = 0.01\nframes_per_second = 100\nfixed_step = 0.01\n\
                 [liquid]\ndensity = 1000.0\nsurface = \"fixed\"\n\
                 [[liquid.region]]\nbox = {{ min = [0.0, 0.0, 0.0], max = [{DAM}, {DAM}, {width}] }}\n",
                width = 2.0 / cells as f64
            ),
        };
        let mut scene = Scene::parse(self.name().as_ref(), &text, &[], 1.0)?;
        scene.solver = solver;
        Ok(scene)
    }

    /// Initial state of its scene.
    pub(super) fn state(self, scene: &Scene) -> Result<State, Error> {
        let mut state = reference_path(scene)?.state().clone();
        if self == Exact::Block {
            TABLE_6_5.deform(&solids_of(scene)?, &mut state);
        }
        Ok(state)
    }

    /// Exact pressure at a point, Pa; `None` where errors do not count.
    pub(super) fn pressure(self, x: DVec3) -> Option<f64> {
        match self {
            Exact::Block => Some(PlaneStrain::pressure(x.y)),
            Exact::Rest => Some(WEIGHT * (DEPTH - x.y)),
            Exact::Dam => {
                let counts = (x.x - DAM).hypot(x.y) > FOOT;
                counts.then(|| WEIGHT * DAM * dam_release(x.x / DAM, x.y / DAM))
            }
        }
    }

    /// The largest pressure, Pa.
    pub(super) fn scale(self) -> f64 {
        match self {
            Exact::Block => PlaneStrain::pressure(0.0),
            Exact::Rest => WEIGHT * DEPTH,
            Exact::Dam => WEIGHT * DAM,
        }
    }
}

/// Pressure over rho g H at the instant when a dam of width and height H is removed; `x` and `y` over H. The column is free at the top and at
/// x = 1. Separation of variables: Stoker, Water Waves, 1957.
pub fn dam_release(x: f64, y: f64) -> f64 {
    let term = |n: u32| {
        let k = (f64::from(n) + 0.5) * std::f64::consts::PI;
        // cosh(k x) / cosh(k), without overflow.
        let ratio = ((k * (x - 1.0)).exp() + (-k * (x + 1.0)).exp()) / (1.0 + (-2.0 * k).exp());
        2.0 / (k * k) * (k * y).cos() * ratio
    };
    1.0 - y - (0..4000).map(term).sum::<f64>()
}
