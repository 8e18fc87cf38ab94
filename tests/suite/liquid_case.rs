//! Ordinary and ugly states of a liquid for the twin tests: every number is an f32, so both paths start from the same ones.

use cutwater::effects::Effects;
use cutwater::fields::{LiquidBuffers, LiquidPlan, SolverBuffers, Step};
use cutwater::geometry::CutCells;
use cutwater::gpu::{Gpu, Real, Recorder};
use cutwater::grid::{Axis, Grid, Sides};
use cutwater::reference::{ActiveCells, Ballistic, active_cells};
use cutwater::scene::{Precision, ThetaFloor};
use cutwater::stages::band;
use cutwater::state::State;
use glam::{DMat3, DVec3};

use crate::common::Random;

/// Half the distance between neighbouring f32 numbers around 1.
pub(crate) const EPS: f64 = 1.0 / (1 << 24) as f64;
/// Floors of theta in all cases.
pub(crate) const THETA_FLOOR: ThetaFloor = ThetaFloor { whole: 1e-2, closing: 0.15 };
/// Marker radius in all cases, cells.
pub(crate) const RADIUS: f64 = 0.87;
/// Density in all cases, kg/m^3.
pub(crate) const DENSITY: f64 = 1000.0;
/// Gravity in all cases, m/s^2: none of the axes alike.
pub(crate) const GRAVITY: [f64; 3] = [0.5, -9.75, 0.25];

/// Distance to the obstacles at a point, m.
type Distance = Box<dyn Fn(DVec3) -> f64>;

/// A state with its obstacles.
pub(crate) struct Case {
    pub(crate) name: &'static str,
    pub(crate) grid: Grid,
    pub(crate) effects: Effects,
    pub(crate) cut: CutCells,
    /// Open sides of the domain.
    pub(crate) sides: Sides,
    pub(crate) state: State,
    pub(crate) cfl: f64,
    /// s
    pub(crate) dt: f64,
}

/// The nearest f32.
pub(crate) fn single(value: f64) -> f64 {
    f64::from(value as f32)
}

/// [`THETA_FLOOR`] in f32.
pub(crate) fn single_floor() -> ThetaFloor {
    ThetaFloor { whole: single(THETA_FLOOR.whole), closing: single(THETA_FLOOR.closing) }
}

/// Distance to a rotated box around the middle of the domain.
fn rotated_box(grid: &Grid, half: DVec3) -> impl Fn(DVec3) -> f64 + use<> {
    let centre = 0.5 * grid.size() + DVec3::new(0.13, -0.21, 0.08) * grid.dx;
    let turn = DMat3::from_rotation_z(0.4) * DMat3::from_rotation_x(0.7);
    let half = half * grid.dx;
    move |x| {
        let q = (turn.transpose() * (x - centre)).abs() - half;
        q.max(DVec3::ZERO).length() + q.max_element().min(0.0)
    }
}

/// Open fractions that look like those of a solid with this distance, closed walls, and the distance at cell centres.
fn cut(grid: &Grid, distance: &dyn Fn(DVec3) -> f64) -> CutCells {
    let open = Axis::ALL.map(|axis| {
        let fraction = |face: usize| {
            let ijk = grid.face_at(axis, face);
            if grid.face_sides(axis, ijk).contains(&None) {
                return 0.0;
            }
            let open = (0.5 + distance(grid.face_centre(axis, ijk)) / grid.dx).clamp(0.0, 1.0);
            match open {
                f if f < 1e-3 => 0.0,
                f if f > 1.0 - 1e-3 => 1.0,
                f => single(f),
            }
        };
        (0..grid.n_faces(axis)).map(fraction).collect()
    });
    let reach = 3.0 * grid.dx;
    let solid_distance = (0..grid.n_cells())
        .map(|cell| single(distance(grid.cell_centre(grid.cell_at(cell))).clamp(-reach, reach)))
        .collect();
    CutCells { open, solid_distance }
}

/// A position inside a cell, off its faces and its middle planes, so that rounding cannot put it elsewhere.
fn in_cell(random: &mut Random, grid: &Grid, ijk: [usize; 3]) -> [f64; 3] {
    std::array::from_fn(|a| {
        let side = if random.uniform(0.0, 1.0) < 0.5 { 0.0 } else { 0.5 };
        single((ijk[a] as f64 + side + random.uniform(0.01, 0.49)) * grid.dx)
    })
}

/// Velocities up to `speed` (m/s): smooth, with a rough part.
fn velocities(random: &mut Random, grid: &Grid, speed: f64) -> [Vec<f64>; 3] {
    Axis::ALL.map(|axis| {
        let wave = DVec3::from(std::array::from_fn(|_| random.uniform(-0.5, 0.5) / grid.dx));
        (0..grid.n_faces(axis))
            .map(|face| {
                let x = grid.face_centre(axis, grid.face_at(axis, face));
                single(speed * (0.8 * wave.dot(x).sin() + random.uniform(-0.2, 0.2)))
            })
            .collect()
    })
}

impl Case {
    /// `filled`: markers in a cell, 0 for none.
    fn new(
        name: &'static str,
        cells: [usize; 3],
        dx: f64,
        cfl: f64,
        distance: Option<&dyn Fn(&Grid) -> Distance>,
        filled: impl Fn([usize; 3], &mut Random) -> usize,
    ) -> Case {
        let grid = Grid { cells, dx };
        let far: Distance = Box::new(|_| f64::INFINITY);
        let cut = cut(&grid, &distance.map_or(far, |distance| distance(&grid)));
        let effects = Effects {
            liquid: true,
            markers: true,
            volume_control: true,
            obstacles: distance.is_some(),
            ..Effects::default()
        };
        Case::around(name, (grid, effects, cut), cfl, filled)
    }

    /// In what bodies leave of a grid.
    pub(crate) fn around(
        name: &'static str,
        (grid, effects, cut): (Grid, Effects, CutCells),
        cfl: f64,
        filled: impl Fn([usize; 3], &mut Random) -> usize,
    ) -> Case {
        let mut random = Random(grid.cells.iter().fold(7, |seed, &n| 31 * seed + n as u64));
        let speed = 2.0;
        let mut state = State::at_rest(&grid);
        state.velocity = velocities(&mut random, &grid, speed);
        for cell in 0..grid.n_cells() {
            let ijk = grid.cell_at(cell);
            for _ in 0..filled(ijk, &mut random) {
                state.markers.push(in_cell(&mut random, &grid, ijk));
            }
        }
        Case { name, grid, effects, cut, sides: Sides::default(), state, cfl, dt: single(cfl * grid.dx / speed) }
    }

    /// With open sides, of whose faces bodies leave nothing, a part or all.
    fn with_open(mut self, name: &'static str, sides: &[(Axis, usize)]) -> Case {
        self.name = name;
        self.sides = sides.iter().fold(Sides::default(), |open, &(axis, side)| open.with(axis, side));
        self.effects.open_sides = true;
        let mut random = Random(11);
        for axis in Axis::ALL {
            for (face, open) in self.cut.open[axis.index()].iter_mut().enumerate() {
                let side = self.grid.wall(axis, self.grid.face_at(axis, face));
                if side.is_some_and(|side| self.sides.has(axis, side)) {
                    let part = single(random.uniform(0.1, 0.9));
                    let part = if self.effects.obstacles { part } else { 1.0 };
                    *open = [0.0, part, 1.0, 1.0][(random.bits() % 4) as usize];
                }
            }
        }
        self
    }

    /// The device's fields in this state.
    pub(crate) fn upload(&self, gpu: &Gpu) -> LiquidBuffers {
        let real = if gpu.has_f64() { Real::F64 } else { Real::F32 };
        let buffers = LiquidBuffers::new(
            gpu,
            LiquidPlan {
                grid: self.grid,
                effects: self.effects,
                n_markers: self.state.markers.len(),
                cfl: self.cfl,
                real,
            },
        )
        .unwrap();
        self.write(gpu, &buffers);
        buffers
    }

    /// Writes the state once more.
    pub(crate) fn write(&self, gpu: &Gpu, buffers: &LiquidBuffers) {
        buffers.write_cut_cells(gpu, &self.cut);
        buffers.write_state(gpu, &self.state);
        gpu.upload(&buffers.step, &[self.step()]);
    }

    /// The device's arrays of the solve before.
    pub(crate) fn solved(&self, gpu: &Gpu) -> SolverBuffers {
        let solver = SolverBuffers::new(gpu, &self.grid, Precision::F32).unwrap();
        solver.write_active(gpu, &self.grid, &self.state);
        solver
    }

    /// With liquid in some cells and half of it, in blocks anywhere, ballistic.
    pub(crate) fn with_ballistic(mut self) -> Case {
        let mut random = Random(11);
        let blocks: Vec<bool> = (0..64).map(|_| random.uniform(0.0, 1.0) < 0.5).collect();
        // After a solve.
        self.state.step = 1;
        let State { active, ballistic, .. } = &mut self.state;
        for (cell, active) in active.iter_mut().enumerate() {
            let [i, j, k] = self.grid.cell_at(cell).map(|at| at / 3 % 4);
            *active = random.uniform(0.0, 1.0) < 0.9;
            ballistic[cell] = *active && blocks[i + 4 * (j + 4 * k)];
        }
        self
    }

    /// The twin's liquid that touches nothing.
    pub(crate) fn ballistic(&self) -> Ballistic<'_> {
        let State { active, ballistic, .. } = &self.state;
        let dt = f64::from(self.dt as f32);
        // Liquid without markers is that of a fixed surface to the device.
        let cells = match self.state.markers.is_empty() {
            true => &[][..],
            false => ballistic,
        };
        Ballistic::new(active, cells, GRAVITY.into(), dt)
    }

    /// The sub-step's numbers.
    pub(crate) fn step(&self) -> Step {
        Step {
            gravity: GRAVITY.map(|g| g as f32),
            dt: self.dt as f32,
            size: self.grid.size().to_array().map(|n| n as f32),
            dx: self.grid.dx as f32,
            inv_dx: (1.0 / self.grid.dx) as f32,
            control_time: 1.0,
            volume_0: 0.0,
            density: DENSITY as f32,
            marker_radius: RADIUS as f32,
            n_markers: self.state.markers.len() as u32,
            open_sides: self.sides.bits(),
            largest_slope: (0.5 * self.grid.dx / self.dt) as f32,
        }
    }

    /// Records the band around the markers.
    pub(crate) fn band(&self, gpu: &Gpu, buffers: &LiquidBuffers) {
        let band = band(gpu, buffers, None).unwrap();
        let mut recorder = Recorder::new(gpu);
        band.record(&mut recorder);
        recorder.submit();
    }

    /// Whether the cell, or the face with its index, is in the band.
    pub(crate) fn in_band(&self, gpu: &Gpu, buffers: &LiquidBuffers) -> impl Fn([usize; 3]) -> bool + use<> {
        let flags = gpu.download(&buffers.band_flags).unwrap();
        let padded = buffers.padded;
        move |ijk| flags[padded.index(ijk) / 4] != 0
    }

    /// Most cells along an axis.
    pub(crate) fn extent(&self) -> f64 {
        self.grid.cells.into_iter().max().unwrap() as f64
    }

    /// Largest magnitude of a velocity component, m/s.
    pub(crate) fn speed(&self) -> f64 {
        cutwater::reference::max_speed(&self.state.velocity)
    }
}

/// The unknowns on the device, as the solver would leave them.
pub(crate) struct ActiveBuffers {
    grid: Grid,
    flags: Vec<u32>,
    list: Vec<u32>,
    args: [u32; 4],
    pub(crate) cells: ActiveCells,
}

impl ActiveBuffers {
    /// Those that a liquid distance (m) makes.
    pub(crate) fn new(case: &Case, phi: &[f64]) -> ActiveBuffers {
        let cells = active_cells(&case.grid, &case.cut.open, phi, single_floor());
        ActiveBuffers::of(case, cells)
    }

    /// These.
    pub(crate) fn of(case: &Case, cells: ActiveCells) -> ActiveBuffers {
        let grid = &case.grid;
        let padded = grid.padded();
        let mut flags = vec![0u32; padded.quads];
        let mut mark = |cell: usize, shift: usize| {
            let index = padded.index(grid.cell_at(cell));
            flags[index / 4] |= 1 << (shift + index % 4);
        };
        for cell in cells.stencil.active_cells() {
            mark(cell, 0);
        }
        for &cell in cells.closed.iter().flatten() {
            mark(cell, 4);
        }
        for &cell in cells.closed.iter().chain(&cells.sealed).flatten() {
            mark(cell, 8);
        }
        // The solver tags some of its entries.
        let list: Vec<u32> = (0..padded.quads as u32)
            .filter(|&quad| flags[quad as usize] != 0)
            .map(|quad| quad | (quad % 2) << 31)
            .collect();
        let [x, y, z] = cutwater::gpu::groups((list.len() as u32).div_ceil(64));
        let args = [x, y, z, list.len() as u32];
        ActiveBuffers { grid: *grid, flags, list, args, cells }
    }

    /// Arrays of the solver with these unknowns.
    pub(crate) fn solver(&self, gpu: &Gpu, real: Real) -> SolverBuffers {
        let precision = match real {
            Real::F32 => Precision::F32,
            Real::F64 => Precision::F64,
        };
        let solver = SolverBuffers::new(gpu, &self.grid, precision).unwrap();
        gpu.upload(&solver.flags, &self.flags);
        gpu.upload(&solver.list, &self.list);
        gpu.upload(&solver.args, &self.args);
        solver
    }
}

/// The largest excess of |gpu - twin| over its bound; fails with the place where it is.
pub(crate) fn assert_close(what: &str, pairs: impl IntoIterator<Item = (f64, f64, f64, [usize; 3])>) {
    let mut worst = (0.0, String::new());
    for (gpu, twin, bound, place) in pairs {
        let excess = (gpu - twin).abs() / bound.max(f64::MIN_POSITIVE);
        // Not-a-number must not pass.
        if excess > worst.0 || excess.is_nan() {
            worst = (excess, format!("at {place:?}: {gpu:e} on the GPU, {twin:e} in the twin, bound {bound:e}"));
        }
    }
    assert!(worst.0 <= 1.0, "{what}: {}", worst.1);
}

/// All cases. Sizes are no multiples of a quad or a tile on purpose.
pub(crate) fn cases() -> Vec<Case> {
    let boxed = |half: DVec3| move |grid: &Grid| -> Distance { Box::new(rotated_box(grid, half)) };
    let half_full = |[_, j, _]: [usize; 3], _: &mut Random| if j < 7 { 8 } else { 0 };
    let splashes = |_: [usize; 3], random: &mut Random| {
        if random.uniform(0.0, 1.0) < 0.2 { 3 } else { 0 }
    };
    let everywhere = |_: [usize; 3], _: &mut Random| 2;
    let corner = |ijk: [usize; 3], _: &mut Random| usize::from(ijk == [0; 3]);
    let gap = |grid: &Grid| -> Distance {
        let (dx, middle) = (grid.dx, 0.5 * grid.size().x);
        Box::new(move |x: DVec3| 0.3 * dx - (x.x - middle - 0.2 * dx).abs())
    };
    let solid = |grid: &Grid| -> Distance {
        let depth = -4.0 * grid.dx;
        Box::new(move |_| depth)
    };
    let mut at_walls = Case::new("at walls", [9, 8, 7], 0.125, 3.0, None, splashes);
    let size = at_walls.grid.size().to_array();
    let sides = [0, 1].map(|side| size.map(|n| f64::from(side) * n));
    for c in 0..8 {
        at_walls.state.markers.push(std::array::from_fn(|a| sides[c >> a & 1][a]));
    }
    let both_along_x = [(Axis::X, 0), (Axis::X, 1)];
    let every_side = Axis::ALL.map(|axis| [(axis, 0), (axis, 1)]);
    let block = boxed(DVec3::new(3.2, 5.1, 2.6));
    // Rows with one spare cell: it is beside the ends of two rows.
    let open_block = Case::new("", [15, 14, 13], 0.0625, 3.0, Some(&block), half_full);
    let open_pool = Case::new("", [12, 9, 10], 0.1, 3.0, None, half_full);
    let open_spray = Case::new("", [15, 8, 9], 0.1, 5.0, Some(&block), splashes);
    vec![
        open_block.with_open("block between open sides", &both_along_x),
        open_pool.with_open("pool open below", &[(Axis::Y, 0), (Axis::Z, 1)]),
        open_spray.with_open("spray, all open", every_side.as_flattened()),
        Case::new("one cell", [1, 1, 1], 0.1, 3.0, None, everywhere)
            .with_open("one cell, all open", every_side.as_flattened()),
        Case::new("half full", [21, 13, 18], 0.05, 3.0, None, half_full),
        Case::new("splashes", [16, 24, 9], 0.1, 5.0, None, splashes),
        Case::new("block", [18, 17, 19], 0.07, 3.0, Some(&boxed(DVec3::new(3.2, 5.1, 2.6))), half_full),
        Case::new("block in splashes", [15, 16, 12], 0.0625, 5.0, Some(&boxed(DVec3::new(4.0, 0.8, 4.0))), splashes),
        Case::new("thin gap", [12, 10, 11], 0.1, 2.0, Some(&gap), everywhere),
        Case::new("all solid", [9, 6, 5], 0.1, 2.0, Some(&solid), everywhere),
        Case::new("all liquid", [11, 10, 9], 0.1, 1.5, None, everywhere),
        Case::new("nothing", [10, 3, 8], 0.1, 3.0, None, |_, _| 0),
        Case::new("one cell", [1, 1, 1], 0.1, 3.0, None, everywhere),
        Case::new("one thick", [14, 9, 1], 0.1, 3.0, None, splashes),
        Case::new("far corner", [40, 7, 33], 0.1, 1.0, None, corner),
        at_walls,
    ]
}
