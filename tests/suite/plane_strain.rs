//! Thesis, section 6.4: an elastic block at rest in a liquid at rest, both known exactly, as a slab between two walls. For the suite and for the
//! validation.
//!
//! y is up, lengths are in m, and the liquid of density rho_f = 1 fills a tank to y = a = 0.8 under gravity g = -1. The block rests on
//! \[0, 0.4\] x \[0, 0.4\] and is deformed by
//!
//! ```text
//! x = alpha X + x1,  y = beta Y^2 + gamma Y + y1,  z = Z                                  (6.1)
//! beta = -alpha (y2 - y1) rho_f g / (2 tau0 (2 mu + lambda)),  gamma = (y2 - y1) / tau0 - beta tau0    (6.3, 6.4)
//! p = rho_f g (y - a)                                                                      (6.5)
//! T_R = P_xx(Y) + p(y(Y)) (2 beta Y + gamma) = -T_L                                        (6.6, 6.7)
//! T_T = P_yy(tau0) + alpha p(y2),  T_B = -P_yy(0) - alpha p(y1)                            (6.8, 6.9)
//! rho_s = alpha (y2 - y1) rho_f / tau0                                                     (6.10)
//! P_xx = (2 mu + lambda) (alpha - 1) + lambda (2 beta Y + gamma - 1)                       (6.2)
//! P_yy = (2 mu + lambda) (2 beta Y + gamma - 1) + lambda (alpha - 1)
//! ```
//!
//! The tractions T, per area at rest, complete the liquid's pressure to equilibrium. F is symmetric and positive: no element rotates. In three
//! dimensions the same law with F_zz = 1 has the same P_xx and P_yy; the walls along z carry P_zz.

use cutwater::elastic::Solids;
use cutwater::geometry::TetMesh;
use cutwater::grid::Axis;
use cutwater::linalg::norm;
use cutwater::measure::bench::statistics::exponent;
use cutwater::reference::larger;
use cutwater::scene::{Load, LoadKind, PatchPressure, Precision, Scene, Shape, Solver};
use cutwater::sim::{Backend, Simulation};
use cutwater::state::{SolveStatus, State};
use glam::DVec3;

/// The scene; block and grid are overrides.
const SCENE: &str = include_str!("plane_strain.toml");
/// Width of the tank, m; its height is 1 m.
const TANK: f64 = 0.8;
/// Cells and bricks across the slab.
const LAYERS: usize = 2;
/// a, m.
const LEVEL: f64 = 0.8;
/// L and tau0, m.
const EDGE: f64 = 0.4;
/// Bottom of the block at rest, m. Arbitrary: only differences of rest positions count.
const REST: f64 = 0.2;
/// rho_f, kg/m^3.
const DENSITY: f64 = 1.0;
/// g along y, m/s^2.
const GRAVITY: f64 = -1.0;

/// Points and weights of Gauss's rule on \[0, 1\] that is exact to degree 5.
const GAUSS: [[f64; 2]; 3] =
    [[0.112_701_665_379_258_31, 5.0 / 18.0], [0.5, 4.0 / 9.0], [0.887_298_334_620_741_7, 5.0 / 18.0]];

/// Relative tolerance of the true residuals that adds nothing to the errors.
pub(crate) const TOLERANCE: f64 = 1e-10;
/// Cells along the tank's height in fits of orders: cell sizes of 0.1 to 0.0125.
const FITTED: std::ops::RangeInclusive<usize> = 10..=80;

/// A choice of the block's material and deformation, and the errors that the thesis prints for it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PlaneStrain {
    /// Shear modulus, Pa.
    mu: f64,
    /// First Lame parameter, Pa.
    lambda: f64,
    /// Stretch along x.
    alpha: f64,
    /// Bottom of the deformed block, m.
    y1: f64,
    /// Its top, m.
    y2: f64,
    /// Cells along the tank's height, and errors of p (Pa), v and u (m/s).
    printed: [(usize, [f64; 3]); 5],
}

/// Block of table 6.5.
pub(crate) const TABLE_6_5: PlaneStrain = PlaneStrain {
    mu: 20.0,
    lambda: 10.0,
    alpha: 0.9,
    y1: 0.205,
    y2: 0.595,
    printed: [
        (5, [4.19e-2, 5.68e-3, 3.75e-3]),
        (10, [4.22e-2, 4.20e-3, 2.66e-3]),
        (20, [1.84e-2, 1.93e-3, 2.31e-3]),
        (40, [6.95e-3, 9.75e-4, 1.14e-3]),
        (80, [1.15e-3, 2.72e-4, 3.01e-4]),
    ],
};

/// Block of table 6.6.
pub(crate) const TABLE_6_6: PlaneStrain = PlaneStrain {
    mu: 100.0,
    lambda: 100.0,
    alpha: 1.1,
    y1: 0.18,
    y2: 0.62,
    printed: [
        (5, [9.19e-2, 3.92e-3, 3.02e-3]),
        (10, [3.35e-2, 1.37e-3, 1.06e-3]),
        (20, [6.01e-3, 3.25e-4, 2.08e-4]),
        (40, [7.30e-3, 4.74e-4, 7.57e-4]),
        (80, [1.21e-3, 1.07e-4, 1.92e-4]),
    ],
};

/// Errors of a sub-step from rest. The exact velocities are 0.
#[derive(Clone, Copy, Debug)]
pub(crate) struct AtRest {
    /// Cells along the tank's height.
    pub(crate) cells: usize,
    /// Cell size, m.
    pub(crate) dx: f64,
    /// Largest magnitudes: of the errors of the pressures of all unknowns (Pa), the components of the nodes' velocities, and the velocities on open
    /// faces beside unknowns (m/s).
    pub(crate) errors: [f64; 3],
    /// Root of the mean square of the components of the nodes' velocities, m/s.
    pub(crate) rms_v: f64,
    /// Those that the thesis prints, with pressures that are constant over a cell.
    pub(crate) printed: [f64; 3],
    /// Error of p over the weight of the liquid from the block's bottom to the centre of its cell.
    pub(crate) error_p_over_weight: f64,
    /// Whether all solves converged to the tolerance.
    pub(crate) solved: bool,
}

impl AtRest {
    /// The errors over the printed ones.
    pub(crate) fn ratios(&self) -> [f64; 3] {
        [0, 1, 2].map(|of: usize| self.errors[of] / self.printed[of])
    }
}

/// Order of convergence of an error from 10 cells on, and the least from one grid to the next.
pub(crate) fn orders(rows: &[AtRest], error: impl Fn(&AtRest) -> f64) -> [f64; 2] {
    let fitted = rows.iter().filter(|row| FITTED.contains(&row.cells));
    let points: Vec<(f64, f64)> = fitted.map(|row| (row.dx, error(row))).collect();
    let fit = |points: &[(f64, f64)]| exponent(points.iter().copied()).expect("several grids");
    [fit(&points), points.windows(2).map(fit).fold(f64::INFINITY, f64::min)]
}

impl PlaneStrain {
    /// Weight of the liquid, rho_f |g|, N/m^3.
    const WEIGHT: f64 = -DENSITY * GRAVITY;

    /// 2 mu + lambda, Pa.
    fn modulus(&self) -> f64 {
        2.0 * self.mu + self.lambda
    }

    /// beta, 1/m.
    fn beta(&self) -> f64 {
        -self.alpha * (self.y2 - self.y1) * DENSITY * GRAVITY / (2.0 * EDGE * self.modulus())
    }

    /// gamma.
    fn gamma(&self) -> f64 {
        (self.y2 - self.y1) / EDGE - self.beta() * EDGE
    }

    /// F_yy at a height at rest, m.
    fn stretch(&self, y: f64) -> f64 {
        2.0 * self.beta() * y + self.gamma()
    }

    /// y of a height at rest, m.
    fn height(&self, y: f64) -> f64 {
        (self.beta() * y + self.gamma()) * y + self.y1
    }

    /// Pressure at a height, Pa.
    fn pressure(height: f64) -> f64 {
        DENSITY * GRAVITY * (height - LEVEL)
    }

    /// T_R at a height at rest, Pa.
    fn traction_right(&self, y: f64) -> f64 {
        let [stretch, pressure] = [self.stretch(y), PlaneStrain::pressure(self.height(y))];
        let stress = self.modulus() * (self.alpha - 1.0) + self.lambda * (stretch - 1.0);
        stress + pressure * stretch
    }

    /// T_T, and -T_B, Pa.
    fn tractions_up(&self) -> [f64; 2] {
        let along = |y: f64, end: f64| {
            let stress = self.modulus() * (self.stretch(y) - 1.0) + self.lambda * (self.alpha - 1.0);
            stress + self.alpha * PlaneStrain::pressure(end)
        };
        [along(EDGE, self.y2), along(0.0, self.y1)]
    }

    /// rho_s, kg/m^3.
    fn density(&self) -> f64 {
        self.alpha * (self.y2 - self.y1) * DENSITY / EDGE
    }

    /// Distance from the block's bottom, and by symmetry its top, to the centre of its cell, m. The error of a pressure that is constant over cells
    /// is rho g times that.
    fn distance(&self, dx: f64) -> f64 {
        let centre = ((self.y1 / dx).floor() + 0.5) * dx;
        (self.y1 - centre).abs()
    }

    /// One sub-step from rest with `cells` cells along the tank's height, a multiple of 5; on the device in `mixed`.
    pub(crate) fn at_rest(&self, cells: usize, patches: PatchPressure, tolerance: f64, backend: &Backend) -> AtRest {
        let solver = Solver {
            tolerance,
            max_iterations: 20_000,
            precision: Precision::Mixed,
            pressure_on_patches: patches,
            ..Solver::default()
        };
        let scene = self.scene(cells, solver);
        let mut simulation = Simulation::new(&scene, backend).unwrap();
        let mut state = simulation.state().unwrap();
        self.deform(simulation.solids(), &mut state);
        simulation.reset(&state).unwrap();
        let report = simulation.step().unwrap();
        let (state, open) = (simulation.state().unwrap(), &simulation.cut_cells().open);
        let (grid, active) = (scene.grid(), &state.active);
        let pressures = (0..grid.n_cells()).filter(|&cell| active[cell]);
        let off = pressures
            .map(|cell| (state.pressure[cell] - PlaneStrain::pressure(grid.cell_centre(grid.cell_at(cell)).y)).abs());
        let nodes = state.node_velocity.as_flattened();
        let faces = Axis::ALL.into_iter().flat_map(|axis| {
            let (open, velocity) = (&open[axis.index()], &state.velocity[axis.index()]);
            let counts = move |face: &usize| {
                let sides = grid.face_sides(axis, grid.face_at(axis, *face));
                open[*face] > 0.0 && sides.into_iter().flatten().any(|cell| active[cell])
            };
            (0..grid.n_faces(axis)).filter(counts).map(|face| velocity[face].abs())
        });
        let errors = [off.fold(0.0, larger), nodes.iter().map(|v| v.abs()).fold(0.0, larger), faces.fold(0.0, larger)];
        let printed = self.printed.iter().find(|(grid, _)| *grid == cells).expect("the thesis has this grid");
        AtRest {
            cells,
            dx: grid.dx,
            errors,
            rms_v: norm(nodes) / (nodes.len() as f64).sqrt(),
            printed: printed.1,
            error_p_over_weight: errors[0] / (PlaneStrain::WEIGHT * self.distance(grid.dx)),
            solved: report.solves().count() == 2
                && report.solves().all(|solve| solve.status == SolveStatus::Converged && solve.residual <= tolerance),
        }
    }

    /// The slab with `cells` cells along the tank's height, and bricks of half a cell.
    fn scene(&self, cells: usize, solver: Solver) -> Scene {
        let dx = 1.0 / cells as f64;
        let [width, bricks] = [TANK / dx, 2.0 * EDGE / dx].map(|n| n.round() as usize);
        let thickness = LAYERS as f64 * dx;
        // The walls along z: the faces of the slab do not move across.
        let pins = [0.0, thickness].map(|z| {
            let [low, high] = [z - 0.1 * dx, z + 0.1 * dx];
            format!(
                "{{ region = {{ box = {{ min = [0, 0, {low:?}], max = [1, 1, {high:?}] }} }}, components = \"z\" }}"
            )
        });
        let overrides = [
            format!("domain.size[2]={thickness:?}"),
            format!("domain.cells=[{width}, {cells}, {LAYERS}]"),
            format!("solid[0].mesh.box.size[2]={thickness:?}"),
            format!("solid[0].mesh.box.cells=[{bricks}, {bricks}, {LAYERS}]"),
            format!("solid[0].placement.translate[2]={:?}", 0.5 * thickness),
            format!("solid[0].density={:?}", self.density()),
            format!("solid[0].young={:?}", self.mu * (3.0 * self.lambda + 2.0 * self.mu) / (self.lambda + self.mu)),
            format!("solid[0].poisson={:?}", 0.5 * self.lambda / (self.lambda + self.mu)),
            format!("solid[0].pin=[{}]", pins.join(", ")),
        ];
        let mut scene = Scene::parse(format!("section_6_4_{cells}.toml").as_ref(), SCENE, &overrides, 1.0).unwrap();
        let mesh = TetMesh::new(&scene.solids[0], "section 6.4").unwrap();
        scene.solids[0].loads = self.loads(&mesh, dx);
        scene.solver = solver;
        scene
    }

    /// Deforms the block of a scene at its start.
    fn deform(&self, solids: &Solids, state: &mut State) {
        let middle = 0.5 * TANK;
        let moved = solids.rest.iter().map(|rest| {
            let y = rest.y - REST;
            [(self.alpha - 1.0) * (rest.x - middle), self.height(y) - rest.y, 0.0]
        });
        state.displacement = moved.collect();
    }

    /// The tractions as a force on each node of the four sides: their integrals times the shape functions over the sides' triangles,
    /// exact, since T_L and T_R are of degree 3 in Y.
    fn loads(&self, mesh: &TetMesh, dx: f64) -> Vec<Load> {
        let mut forces = vec![DVec3::ZERO; mesh.nodes.len()];
        let [top, bottom] = self.tractions_up();
        for nodes in mesh.surface() {
            let corners = nodes.map(|node| mesh.nodes[node as usize]);
            let [a, b, c] = corners;
            let cross = (b - a).cross(c - a);
            let (area, normal) = (0.5 * cross.length(), cross.normalize());
            let traction = |x: DVec3| {
                let right = normal.x * self.traction_right(x.y - REST);
                let up = if normal.y > 0.0 { top } else { bottom };
                DVec3::new(right, normal.y * up, 0.0)
            };
            if normal.z.abs() > 0.5 {
                continue;
            }
            // The triangle is a square with one side collapsed to the first corner.
            for [s, weight_s] in GAUSS {
                for [t, weight_t] in GAUSS {
                    let weights = [1.0 - s, s * (1.0 - t), s * t];
                    let x: DVec3 = weights.iter().zip(corners).map(|(w, x)| *w * x).sum();
                    let force = 2.0 * area * s * weight_s * weight_t * traction(x);
                    for (node, weight) in nodes.iter().zip(weights) {
                        forces[*node as usize] += weight * force;
                    }
                }
            }
        }
        let near = DVec3::splat(0.01 * dx);
        let loaded = mesh.nodes.iter().zip(forces).filter(|(_, force)| *force != DVec3::ZERO);
        loaded
            .map(|(&x, force)| Load {
                region: Shape::Box { min: x - near, max: x + near },
                kind: LoadKind::Force(force),
                keyframes: Vec::new(),
            })
            .collect()
    }
}

#[test]
fn the_problem_is_the_thesis_s() {
    // Validation.md's own evaluation of (6.3), (6.4), (6.6) to (6.10).
    let right = [-4.70706, -4.85966, -5.01431];
    let soft = ([0.008775, 0.97149, 0.8775, -1.89, -1.89], right);
    let right = [40.60083, 40.44009, 40.27881];
    let stiff = ([0.00201667, 1.0991933, 1.21, 40.44, 40.44], right);
    for (problem, (expected, right)) in [(TABLE_6_5, soft), (TABLE_6_6, stiff)] {
        let [top, bottom] = problem.tractions_up();
        let tractions = [0.0, 0.2, 0.4].map(|y| problem.traction_right(y));
        let (beta, gamma) = (problem.beta(), problem.gamma());
        let found = [beta, gamma, problem.density(), top, bottom];
        let pairs = found.iter().zip(&expected);
        for (a, b) in pairs.chain(tractions.iter().zip(&right)) {
            assert!((a - b).abs() < 6e-6, "{a} {b}");
        }
    }
    assert_eq!(PlaneStrain::pressure(0.3), 0.5);
}

#[test]
fn loads_balance_weight_and_pressure() {
    use cutwater::reference::{BlockPattern, solid_matrices};
    for problem in [TABLE_6_5, TABLE_6_6] {
        let scene = problem.scene(20, Solver::default());
        let solids = cutwater::sim::solids_of(&scene).unwrap();
        let thickness = scene.domain.size.z;
        let sum = solids.load.iter().copied().sum::<DVec3>();
        // On the top T_T and on the bottom T_B = -T_T, on the sides T_R and T_L = -T_R.
        assert!(sum.length() < 1e-12 * 40.0 * thickness, "{sum}");
        let weight: f64 = solids.mass.iter().sum();
        let floats = problem.alpha * 0.4 * (problem.y2 - problem.y1) * thickness;
        assert!((weight - floats).abs() < 1e-12, "{weight} {floats}");
        // Elements turn nowhere: F is diagonal in the interpolant too.
        let mut state = State::default();
        problem.deform(&solids, &mut state);
        let pattern = std::sync::Arc::new(BlockPattern::new(&solids));
        let matrices = solid_matrices(&solids, &pattern, &state.displacement);
        for deformation in &matrices.deformations {
            let off = (deformation.rotation - glam::DMat3::IDENTITY).to_cols_array();
            assert!(off.iter().all(|x| x.abs() < 1e-12), "{deformation:?}");
        }
    }
}

/// With pressures constant over a cell, as in the thesis, errors are at most twice the printed ones, since the thesis's meshes are not known.
#[test]
fn errors_are_those_printed_in_f64_and_in_mixed() {
    let Some(_) = crate::common::gpu() else { return };
    let backends = [Backend::Cpu, Backend::Gpu(crate::common::adapter())];
    for problem in [TABLE_6_5, TABLE_6_6] {
        for cells in [5, 10, 20, 40] {
            let [cell, hydrostatic] = [PatchPressure::Cell, PatchPressure::Hydrostatic].map(|patches| {
                let [cpu, gpu] = backends.each_ref().map(|backend| problem.at_rest(cells, patches, TOLERANCE, backend));
                assert!(cpu.solved && gpu.solved, "{cpu:?} {gpu:?}");
                // What is stored in f32 is far below the errors.
                let pairs = cpu.errors.iter().zip(gpu.errors);
                assert!(pairs.into_iter().all(|(a, b)| (a - b).abs() < 1e-5), "{cpu:?} {gpu:?}");
                gpu
            });
            assert!(cell.ratios().iter().all(|ratio| *ratio <= 2.0), "{cell:?}");
            assert!(cell.error_p_over_weight <= 1.3, "{cell:?}");
            let ratios = hydrostatic.ratios();
            assert!(ratios[0] < 0.25 && ratios.iter().all(|ratio| *ratio < 1.0), "{hydrostatic:?}");
        }
    }
}

/// With hydrostatic pressures p is of second order, v of order 1.5, and no halving is below first order.
#[test]
fn orders_hold_down_to_the_finest_cells() {
    for problem in [TABLE_6_5, TABLE_6_6] {
        let rows =
            [10, 20, 40, 80].map(|cells| problem.at_rest(cells, PatchPressure::Hydrostatic, TOLERANCE, &Backend::Cpu));
        let [p, v, u] = [0, 1, 2].map(|of: usize| orders(&rows, |row| row.errors[of]));
        assert!(rows.iter().all(|row| row.solved) && p[0] >= 1.8 && v[0] >= 1.5, "{rows:?}");
        assert!([p, v, u].iter().all(|[_, least]| *least >= 1.0), "{rows:?}");
        assert!(orders(&rows, |row| row.rms_v)[0] >= 1.9, "{rows:?}");
    }
}
