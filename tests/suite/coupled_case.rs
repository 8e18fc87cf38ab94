//! Ugly states of a liquid around solids for the twin tests: through walls, in each other, crushed, and far away.

use cutwater::effects::Effects;
use cutwater::elastic::Solids;
use cutwater::fields::{
    ClipBuffers, ClipSize, CouplingBuffers, CouplingSize, LiquidBuffers, Pair, SolidRows, SolidSystemBuffers,
    SolverBuffers,
};
use cutwater::geometry::{Coupling, SolidClip, obstacle_cut};
use cutwater::gpu::{Gpu, Real, RealBuffer};
use cutwater::grid::{Axis, Grid};
use cutwater::scene::{Precision, Scene, Solver};
use cutwater::sim::solids_of;
use glam::DVec3;

use crate::common::{Random, scene_from};
use crate::liquid_case::{Case, single};

/// Two solids that touch, one near a wall, and an obstacle; cells that do not fill quads.
pub(crate) const SCENE: &str = "[domain]
size = [1.3, 0.9, 1.1]
cells = [13, 9, 11]
[time]
duration = 1
[[liquid.region]]
box = { min = [0, 0, 0], max = [1.3, 0.5, 1.1] }
[[obstacle]]
sphere = { centre = [0.9, 0.2, 0.6], radius = 0.17 }
[[solid]]
name = \"ball\"
mesh = { sphere = { radius = 0.16, cell_size = 0.08 } }
placement = { translate = [0.3, 0.45, 0.5] }
density = 1000.0
young = 1e5
poisson = 0.3
[[solid]]
name = \"beam\"
mesh = { box = { size = [0.1, 0.07, 0.5], cells = [2, 1, 4] } }
placement = { translate = [0.51, 0.42, 0.4], rotate = { axis = [1, 2, 0], degrees = 31 } }
density = 1000.0
young = 1e5
poisson = 0.3
";

/// [`SCENE`].
pub(crate) fn scene(overrides: &[&str]) -> Scene {
    scene_from(SCENE, overrides)
}

/// A liquid, and the solids in it.
pub(crate) struct CoupledCase {
    pub(crate) liquid: Case,
    pub(crate) solids: Solids,
    pub(crate) clip: SolidClip,
    /// Of the nodes, m/s.
    pub(crate) velocity: Vec<[f64; 3]>,
}

impl CoupledCase {
    /// The clipping and the velocities on the device, the latter four numbers per node.
    pub(crate) fn upload(&self, gpu: &Gpu) -> (LiquidBuffers, ClipBuffers, RealBuffer) {
        let grid = &self.liquid.grid;
        let buffers = self.liquid.upload(gpu);
        let size = ClipSize::of(grid, &self.clip, 0);
        let mut clip = ClipBuffers::new(gpu, grid, size).unwrap();
        let cut = clip.cut(&self.clip);
        clip.write(gpu, (&self.clip, cut), &self.solids.triangles, false);
        let real = if gpu.has_f64() { Real::F64 } else { Real::F32 };
        let n = self.velocity.len();
        let velocity = RealBuffer::new(gpu, "test.velocity", 4 * n, real).unwrap();
        velocity.upload(gpu, &quads(&self.velocity));
        (buffers, clip, velocity)
    }
}

impl CoupledCase {
    /// J on the device, beside systems of which nothing is read.
    pub(crate) fn joint(&self, gpu: &Gpu) -> CouplingBuffers {
        let grid = &self.liquid.grid;
        let solver = Solver { precision: Precision::F32, ..Solver::default() };
        let liquid = SolverBuffers::new(gpu, grid, solver.precision).unwrap();
        let rows = SolidRows::new(&self.solids).unwrap();
        let solids = SolidSystemBuffers::new(gpu, &rows, &solver).unwrap();
        let pairs = pairs(grid, self.clip.coupling());
        let size = CouplingSize { quads: pairs.len().max(1), pairs: pairs.len().max(1) };
        let mut coupling = CouplingBuffers::new(gpu, &liquid, &solids, size).unwrap();
        coupling.write(gpu, &pairs, 1.0).unwrap();
        coupling
    }
}

/// J in the units of the device.
pub(crate) fn pairs(grid: &Grid, coupling: &Coupling) -> Vec<Pair> {
    let (padded, area) = (grid.padded(), grid.dx * grid.dx);
    let pairs = coupling.pairs().iter();
    let pairs = pairs.map(|pair| Pair {
        cell: padded.index(grid.cell_at(pair.cell)),
        node: pair.node,
        value: (pair.value / area).as_vec3().to_array(),
    });
    pairs.collect()
}

/// Four numbers per node.
pub(crate) fn quads(nodes: &[[f64; 3]]) -> Vec<f64> {
    nodes.iter().flat_map(|&[x, y, z]| [x, y, z, 0.0]).collect()
}

/// All cases.
pub(crate) fn cases() -> Vec<CoupledCase> {
    let pool = |[_, j, _]: [usize; 3], _: &mut Random| if j < 6 { 8 } else { 0 };
    // Droplets of one cell among them.
    let splashes = |_: [usize; 3], random: &mut Random| {
        if random.uniform(0.0, 1.0) < 0.15 { 3 } else { 0 }
    };
    let everywhere = |_: [usize; 3], _: &mut Random| 2;
    let middle = DVec3::new(0.4, 0.43, 0.45);
    type Moved<'a> = dyn Fn(DVec3) -> DVec3 + 'a;
    type Filled = dyn Fn([usize; 3], &mut Random) -> usize;
    let cases: [(&'static str, &Moved, &Filled); 7] = [
        ("solids in a pool", &|x| x, &pool),
        ("solids in splashes", &|x| x + 0.013, &splashes),
        ("half through a wall and a corner", &|x| x - DVec3::new(0.31, 0.0, 0.37), &pool),
        // The beam through the ball, and both through the obstacle.
        (
            "in each other",
            &|x| DVec3::new(0.85, 0.25, 0.6) + 0.7 * (x - middle) * DVec3::new(0.3, 1.0, 1.0),
            &everywhere,
        ),
        // Less than a cell: several of both solids' surfaces in one.
        ("crushed", &|x| middle + 0.11 * (x - middle), &everywhere),
        ("flat", &|x| middle + DVec3::new(1.0, 0.02, 1.3) * (x - middle), &pool),
        ("far away", &|x| x + 30.0, &pool),
    ];
    let scene = scene(&[]);
    let (grid, solids) = (scene.grid(), solids_of(&scene).unwrap());
    let obstacles = obstacle_cut(&scene, &grid).unwrap();
    let mut random = Random(31);
    let case = |(name, moved, filled): (&'static str, &Moved, &Filled)| {
        let mut clip = SolidClip::new(&grid, obstacles.clone(), &scene.solver);
        let displacement = solids.rest.iter().map(|&x| (moved(x) - x).to_array());
        clip.clip(&solids.moved(&displacement.collect::<Vec<_>>()));
        let mut cut = clip.cut_cells().clone();
        let fields = cut.open.iter_mut().chain([&mut cut.solid_distance]);
        for value in fields.flatten() {
            *value = single(*value);
        }
        let n = solids.rest.len();
        let mut component = || single(random.uniform(-1.5, 1.5));
        CoupledCase {
            // No cell is separated.
            liquid: Case::around(name, (grid, Effects { separation: false, ..Effects::of(&scene) }, cut), 2.0, filled),
            solids: solids.clone(),
            clip,
            velocity: (0..n).map(|_| Axis::ALL.map(|_| component())).collect(),
        }
    };
    cases.into_iter().map(case).collect()
}
