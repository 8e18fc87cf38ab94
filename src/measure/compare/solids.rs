//! The stages of the solids against their twins.

use std::sync::Arc;

use glam::{DMat3, DVec3};

use super::table::{Place, Table};
use super::{Both, EPS, unit};
use crate::Error;
use crate::elastic::{Deformation, Solids, forces as forces_of};
use crate::geometry::{Coupling, CutCells};
use crate::gpu::Real;
use crate::grid::Grid;
use crate::linalg::norm;
use crate::reference::{
    self, ActiveCells, ActiveSurfaces, BlockPattern, Contacts, Formulation,
    RightHandSide as Inflow, SolidMatrices, SolidRightHandSide, SolidSolver, SolidSystem,
};
use crate::scene::{Scene, Solver};
use crate::sim::{GpuPath, SolidSnapshot, coupled_system, stored_coupling};
use crate::solver::{COUPLING_SHARE, rounding};
use crate::step::Stage;

use crate::state::SolidDiagnosis;

/// Relative error of the sum of two f32 that a displacement is held as, and of what is added to it.
const PAIR: f64 = 1.0 / (1u64 << 45) as f64;
/// Roundings of what a body that turns needs besides its tangents, relative to its largest node's: sums over nodes, with arms that are
/// differences of positions, and an inverse tensor of inertia.
const TURNED: f64 = 256.0;

/// How far coefficients in f32 may move the answer of liquid and solids, relative to its largest numbers.
const ASSEMBLY: f64 = 1e-5;

/// Where R may be off by more than this, the nearest rotation is as good as not unique.
const AMBIGUOUS: f64 = 1e-2;

/// The twins of a scene, fed with what the device holds.
pub(super) struct SolidJudge<'a> {
    scene: &'a Scene,
    grid: Grid,
    /// As the device has them.
    cut: CutCells,
    /// As the device has them.
    solids: Solids,
    pattern: Arc<BlockPattern>,
    solver: SolidSolver,
    pub(super) table: Table,
    /// s
    dt: f64,
    /// What the stage had.
    before: SolidSnapshot,
    /// Of the sub-step's displacements, once `solid_matrices` was judged.
    matrices: Option<SolidMatrices>,
}

impl<'a> SolidJudge<'a> {
    /// `None` for a scene without solids.
    pub(super) fn new(scene: &'a Scene, path: &GpuPath) -> Result<Option<SolidJudge<'a>>, Error> {
        let (Some(solids), Some(before)) = (path.solids(), path.snapshot()?.solids) else {
            return Ok(None);
        };
        let single = |values: &Vec<f64>| -> Vec<f64> {
            values
                .iter()
                .map(|&value| f64::from(value as f32))
                .collect()
        };
        let grid = Grid {
            cells: scene.domain.cells,
            dx: f64::from(scene.grid().dx as f32),
        };
        let solids = before.on_device(solids);
        let cut = path.obstacles();
        Ok(Some(SolidJudge {
            scene,
            grid,
            cut: CutCells {
                open: cut.open.clone(),
                solid_distance: single(&cut.solid_distance),
            },
            pattern: Arc::new(BlockPattern::new(&solids)),
            solver: SolidSolver::new(&solids),
            solids,
            table: Table::default(),
            dt: 0.0,
            before,
            matrices: None,
        }))
    }

    /// Hears of the next sub-step.
    pub(super) fn begin(&mut self, path: &GpuPath, dt: f64) {
        self.table.step = path.clock().step;
        self.dt = f64::from(dt as f32);
        if path.clock().step == 0 {
            let SolidSnapshot {
                displacement,
                velocity,
                real,
                ..
            } = &mut self.before;
            self.solids.start_scripts(displacement, velocity, self.dt);
            if *real == Real::F32 {
                for v in velocity.iter_mut().flatten() {
                    *v = f64::from(*v as f32);
                }
            }
        }
    }

    /// Judges what a stage left; `held` is what the device really holds.
    pub(super) fn judge(
        &mut self,
        stage: Stage,
        after: &SolidSnapshot,
        held: Option<SolidSnapshot>,
        both: Option<&Both>,
    ) -> Result<(), Error> {
        match stage {
            Stage::MoveSolid => self.move_solid(after),
            Stage::Forces => self.forces(after),
            Stage::SolidMatrices => self.solid_matrices(after),
            Stage::RightHandSide => self.right_hand_side(after, both),
            Stage::Solve => self.solve(after, both)?,
            Stage::Diagnose => self.diagnose(after),
            _ => {}
        }
        self.before = held.unwrap_or_else(|| after.clone());
        Ok(())
    }

    fn node(&self, node: usize) -> Place {
        Place::Node(node, self.solids.rest[node])
    }

    /// Adds three numbers per node.
    fn add_nodes(
        &mut self,
        row: [&'static str; 3],
        gpu: &[[f64; 3]],
        twin: &[[f64; 3]],
        bound: impl Fn(usize, usize) -> f64,
    ) {
        let pairs: Vec<_> = (0..gpu.len())
            .flat_map(|node| (0..3).map(move |axis| (node, axis)))
            .map(|(node, axis)| {
                let (gpu, twin) = (gpu[node][axis], twin[node][axis]);
                (gpu, twin, bound(node, axis), self.node(node))
            })
            .collect();
        self.table.add(row, pairs);
    }

    /// A free node is off by the rounding of the pair, of dt v and of what it turns by. One that is put on a wall is off by the rounding of its
    /// position. Rounding decides whether one that the solve has brought to the wall is beyond it and loses its velocity into it.
    fn move_solid(&mut self, after: &SolidSnapshot) {
        let before = self.before.clone();
        let (mut u, mut v) = (before.displacement.clone(), before.velocity.clone());
        reference::turn_solids(&self.solids, self.dt, &mut u, &mut v);
        let (turned, turned_v) = (u.clone(), v.clone());
        (u, v) = (before.displacement.clone(), before.velocity.clone());
        reference::move_solid(&self.solids, &self.grid, self.dt, &mut u, &mut v);
        let size = self.grid.size().max_element();
        let touched: Vec<bool> = (0..u.len())
            .map(|node| {
                (0..3).any(|axis| {
                    let free = turned[node][axis] + self.dt * turned_v[node][axis];
                    let moved = |u: f64| (u - free).abs() > PAIR * (free.abs() + size);
                    moved(u[node][axis]) || moved(after.displacement[node][axis])
                })
            })
            .collect();
        let contact = 8.0 * EPS * size;
        let (dt, eps) = (self.dt, unit(after.real));
        // Per node: how far what its body turns by may be off, m and m/s.
        let mut off = vec![[0.0; 2]; u.len()];
        for body in self.solids.rotating_bodies() {
            let largest = |of: &dyn Fn(usize) -> DVec3| {
                let nodes = body.nodes.clone();
                nodes.fold(0.0, |largest, node| of(node).length().max(largest))
            };
            let change = |after: &[[f64; 3]], before: &[[f64; 3]], node: usize| {
                DVec3::from(after[node]) - DVec3::from(before[node])
            };
            let speed = largest(&|node| before.velocity[node].into());
            let [way, rate] = [
                largest(&|node| change(&turned, &before.displacement, node)) + dt * speed / TURNED,
                largest(&|node| change(&turned_v, &before.velocity, node)) + speed / TURNED,
            ]
            .map(|change| TURNED * eps * change);
            off[body.nodes.clone()].fill([way, rate]);
        }
        let row = [Stage::MoveSolid.name(), "displacement", "m"];
        self.add_nodes(row, &after.displacement, &u, |node, axis| {
            let way = dt * before.velocity[node][axis].abs();
            match touched[node] {
                true => contact + off[node][0],
                false => 4.0 * PAIR * (u[node][axis].abs() + way) + eps * way + off[node][0],
            }
        });
        let size = self.grid.size();
        let arrives: Vec<bool> = (0..u.len())
            .map(|node| {
                let x = self.solids.rest[node] + DVec3::from(u[node]);
                x.min(size - x).min_element() <= contact
            })
            .collect();
        let row = [Stage::MoveSolid.name(), "v*", "m/s"];
        self.add_nodes(row, &after.velocity, &v, |node, _| {
            let speed = DVec3::from(before.velocity[node]).length();
            let of_contact = if arrives[node] { speed } else { 0.0 };
            of_contact + off[node][1]
        });
    }

    /// One product and one sum.
    fn forces(&mut self, after: &SolidSnapshot) {
        let gravity = self.scene.domain.gravity.as_vec3().as_dvec3();
        let mut twin = self.before.velocity.clone();
        let prescribed = &after.prescribed;
        reference::node_forces(&self.solids, prescribed, gravity, self.dt, &mut twin);
        let (eps, dt) = (unit(after.real), self.dt);
        let row = [Stage::Forces.name(), "v*", "m/s"];
        self.add_nodes(row, &after.velocity, &twin.clone(), |node, axis| {
            eps * (2.0 * dt * gravity[axis].abs() + twin[node][axis].abs())
        });
    }

    /// The gradient of the displacement is off by 8 roundings of its terms. The rotation is off by that and a few roundings of its
    /// own, times the condition of the polar decomposition: twice the norm of (tr(S) I - S)^-1, where S = R^T F (Higham 2008,
    /// section 8.2). Strain and stress are off by both.
    fn solid_matrices(&mut self, after: &SolidSnapshot) {
        let solids = &self.solids;
        let mut matrices = reference::solid_matrices(solids, &self.pattern, &after.displacement);
        let eps = unit(after.real);
        let mut ambiguous = Vec::new();
        let mut gradients = Vec::new();
        let mut forces = Vec::new();
        let mut determinants = Vec::new();
        let mut moduli = Vec::new();
        for (element, corners) in solids.elements.iter().enumerate() {
            let body = solids.body_of_element(element);
            let g = &solids.gradients[element];
            let u = corners.map(|node| DVec3::from(after.displacement[node as usize]));
            let terms: f64 = (1..4).map(|a| (u[a] - u[0]).length() * g[a].length()).sum();
            let size = 1.0 + terms;
            let off_f = eps * (8.0 * terms + 2.0);
            let mut off_r = off_f * condition(&matrices.deformations[element]) + 16.0 * eps;
            if off_r > AMBIGUOUS {
                // Any nearest rotation will do, so the twin goes on with the device's.
                let twin = &mut matrices.deformations[element];
                let gpu = after.turned(solids, element, twin.gradient);
                let [gpu_distance, distance] = [&gpu, &*twin].map(distance_to_rotation);
                let bound = 1e-6 * distance + 8.0 * eps * size;
                ambiguous.push((gpu_distance, distance, bound, Place::Element(element)));
                let defect = gpu.rotation.transpose() * gpu.rotation - DMat3::IDENTITY;
                let proper = gpu.rotation.determinant() > 0.0 && frobenius(defect) <= 64.0 * eps;
                if proper && gpu_distance - distance <= bound {
                    *twin = gpu;
                    let body_forces =
                        forces_of(g, solids.volume[element], twin, body.lambda, body.mu);
                    matrices.element_forces[element] = body_forces;
                }
                off_r = 64.0 * eps * size;
            }
            let deformation = &matrices.deformations[element];
            let volume = solids.volume[element];
            let zeta = body.zeta_stiffness(self.dt);
            let twin_moduli = [zeta * volume * body.lambda, zeta * volume * body.mu];
            for section in 0..3 {
                let place = Place::Element(element);
                let gpu = after.rotated[section][element];
                let turned = deformation.rotation * g[section + 1];
                let steep = g[section + 1].length();
                for axis in 0..3 {
                    let bound = steep * (off_r + 4.0 * eps);
                    gradients.push((gpu[axis], turned[axis], bound, place));
                }
                match section {
                    2 => {
                        let twin = deformation.determinant();
                        let bound = 4.0 * size * size * off_f + 12.0 * eps * size.powi(3);
                        determinants.push((gpu[3], twin, bound, place));
                    }
                    _ => {
                        let twin = twin_moduli[section];
                        moduli.push((gpu[3], twin, 6.0 * (EPS + eps) * twin, place));
                    }
                }
                let stiffness = volume * (2.0 * body.mu + 3.0 * body.lambda.abs());
                let strain = size * off_r + off_f + 8.0 * eps * size;
                let bound = 2.0
                    * stiffness
                    * steep
                    * (strain + (off_r + 8.0 * eps) * frobenius(deformation.strain));
                let gpu = after.element_forces[section][element];
                let twin = matrices.element_forces[element][section + 1];
                for axis in 0..3 {
                    forces.push((gpu[axis], twin[axis], bound, place));
                }
            }
        }
        let stage = Stage::SolidMatrices.name();
        self.table
            .add([stage, "|F - R| where R is ambiguous", ""], ambiguous);
        self.table
            .add([stage, "rotated gradients", "1/m"], gradients);
        self.table.add([stage, "zeta_K V moduli", "N s m"], moduli);
        self.table.add([stage, "K x* - b of elements", "N"], forces);
        self.table.add([stage, "det F", ""], determinants);
        self.matrices = Some(matrices);
    }

    /// A sum over the elements of a node, and three terms: a rounding each, and three in each term. In liquid, what pressure does within
    /// cells, of integrals that are f32.
    fn right_hand_side(&mut self, after: &SolidSnapshot, both: Option<&Both>) {
        let n = self.solids.rest.len();
        let (mut elastic, mut size) = (vec![DVec3::ZERO; n], vec![DVec3::ZERO; n]);
        let mut count = vec![0.0; n];
        for (element, corners) in self.solids.elements.iter().enumerate() {
            let [a, b, c] = [0, 1, 2].map(|s| DVec3::from(after.element_forces[s][element]));
            let largest = a.abs() + b.abs() + c.abs();
            for (&node, force) in corners.iter().zip([-(a + b + c), a, b, c]) {
                elastic[node as usize] += force;
                size[node as usize] += largest;
                count[node as usize] += 1.0;
            }
        }
        // What is held has another velocity after the stage.
        let v_star = &self.before.velocity;
        let inertia = |node: usize| self.solids.mass[node] / self.dt * DVec3::from(v_star[node]);
        let eps = unit(after.real);
        let (corrections, gross) = match both {
            Some(both) => self.corrections(both),
            None => (vec![DVec3::ZERO; n], vec![0.0; n]),
        };
        let (mut twin, mut bounds) = (vec![[0.0; 3]; n], vec![[0.0; 3]; n]);
        for node in 0..n {
            let load = self.solids.load[node];
            let sum = inertia(node) - elastic[node] + load + corrections[node];
            let terms =
                (count[node] + 4.0) * size[node] + 8.0 * inertia(node).abs() + 4.0 * load.abs();
            let terms = terms + (8.0 * EPS / eps + 32.0) * gross[node];
            for axis in (0..3).filter(|&axis| !self.solids.prescribed[node][axis]) {
                twin[node][axis] = sum[axis];
                bounds[node][axis] = eps * terms[axis];
            }
        }
        let row = [
            Stage::RightHandSide.name(),
            "M v*/dt - (K x* - b) + load",
            "N",
        ];
        self.add_nodes(row, &after.rhs, &twin, |node, axis| bounds[node][axis]);
    }

    /// Forces of the pressure's variation within cells on the nodes, N, and the sums of their terms' sizes.
    fn corrections(&self, both: &Both) -> (Vec<DVec3>, Vec<f64>) {
        let n = self.solids.rest.len();
        let (mut sums, mut gross) = (vec![DVec3::ZERO; n], vec![0.0; n]);
        // The host made the integrals, with a dx in f64.
        let (clip, triangles, grid) = (both.clip, &both.at_rest.triangles, self.scene.grid());
        for patch in clip
            .patches()
            .iter()
            .filter(|patch| both.liquid.active[patch.cell])
        {
            let way = patch.centroid - grid.cell_centre(grid.cell_at(patch.cell));
            let slope = both.slopes[patch.cell];
            for (corner, &node) in triangles[patch.triangle].iter().enumerate() {
                let moment = patch.barycentric[corner] * patch.area * way + patch.moments[corner];
                sums[node as usize] += slope.dot(moment) * patch.normal;
                gross[node as usize] += slope.length() * moment.length();
            }
        }
        (sums, gross)
    }

    /// Row `assembly` of liquid and solids together, before `solve` is judged: the answer of the system of both as it is stored against that
    /// of the one assembled in f64. `parts`: unknowns and E u* of each.
    pub(super) fn assembly(
        &mut self,
        after: &SolidSnapshot,
        both: &Both,
        density: f64,
        parts: [(ActiveCells, Inflow); 2],
    ) -> Result<(), Error> {
        let (solids, dt, grid) = (&self.solids, self.dt, self.scene.grid());
        let Some(matrices) = &self.matrices else {
            return Ok(());
        };
        let exact = Solver {
            tolerance: 1e-12,
            max_iterations: 10_000,
            ..self.scene.solver
        };
        let solved = |(active, rhs), solid, coupling: &Coupling, density| {
            let system = coupled_system(active, rhs, solid, coupling, density);
            let form = Formulation::of(&system);
            reference::solve_coupled(&system, form, &self.solver, solids, &exact)
        };
        let [of_device, of_twin] = parts;
        let (areas, weight) = stored_coupling(both.clip.coupling(), grid.dx, density, dt);
        let solid = after.system(solids, &self.pattern, dt);
        let stored = solved(of_device, solid, &areas, weight)?;
        // That of the device, which row `right_hand_side` has judged: its rounding is none of the coefficients'.
        let rhs = SolidRightHandSide {
            values: after.rhs.clone(),
            scale: 0.0,
        };
        let (stiffness, freedom) = (matrices.stiffness.clone(), after.freedom.clone());
        let solid = SolidSystem::new(solids, stiffness, &rhs, &after.velocity, freedom, dt);
        let assembled = solved(of_twin, solid, both.clip.coupling(), density)?;
        // What gravity does to a velocity in a step is there even where nothing moves.
        let falls = dt * self.scene.domain.gravity.length();
        let largest = |values: &[f64]| values.iter().fold(0.0, |m, x| f64::max(m, x.abs()));
        let bound = ASSEMBLY * largest(&assembled.pressure);
        let row = ["assembly", "pressure, with solids", "Pa"];
        self.table.cells(&grid, row, |cell| {
            let numbers = (stored.pressure[cell], assembled.pressure[cell], bound);
            both.liquid.active[cell].then_some(numbers)
        });
        let bound = ASSEMBLY * largest(assembled.velocity.as_flattened()).max(falls);
        let row = ["assembly", "v, with liquid", "m/s"];
        self.add_nodes(row, &stored.velocity, &assembled.velocity, |_, _| bound);
        Ok(())
    }

    /// The system is the one stored: rotated gradients and moduli in the scalar type of the outer loop, and what the device holds; in liquid
    /// with J^T p of the pressure found, whose areas are f32. Row `true residual` judges v on it; row `beyond` whether that is what walls and
    /// obstacles should hold (where the search for it did not end: whether nodes are behind them, of solids by themselves); row `v` compares with a direct solve: S >= zeta_M M, so v is off by |r| over the least zeta_M m at most.
    fn solve(&mut self, after: &SolidSnapshot, both: Option<&Both>) -> Result<(), Error> {
        let (solids, dt) = (&self.solids, self.dt);
        let Some(matrices) = self.matrices.take() else {
            return Ok(());
        };
        let mut system = after.system(solids, &self.pattern, dt);
        let mut size = norm(&system.rhs);
        let mut of_areas = 0.0;
        if let (Some(both), Some(liquid)) = (both.filter(|both| both.touch()), &self.scene.liquid) {
            let [force, gross] = both.force(liquid.density * self.grid.dx / dt);
            let pushed = system.free_part(force.as_chunks().0);
            size = size.max(COUPLING_SHARE * norm(&pushed));
            system.push(&force);
            of_areas = 4.0 * EPS * norm(&gross);
        }
        let x = system.free_part(&after.velocity);
        let residual = norm(&system.residual(&x));
        let twin_rhs =
            reference::solid_right_hand_side(solids, &matrices, &self.before.velocity, dt);
        let rounded = rounding(&self.scene.solver) * (twin_rhs.scale + size);
        let mut allowed =
            (self.scene.solver.tolerance * size).max(rounded) * (1.0 + 1e-6) + of_areas;
        if after.real == Real::F32 {
            // The verdict was on a velocity in f64, of which the device keeps an f32.
            let rows = system.to_csr();
            let moved: Vec<f64> = (0..rows.n_rows())
                .map(|row| rows.row(row).map(|(column, s)| (s * x[column]).abs()).sum())
                .collect();
            allowed += 2.0 * EPS * norm(&moved);
        }
        let row = ["solve", "true residual of S v", "N"];
        self.table.whole(row, residual, 0.0, allowed);
        let mut distance = self.cut.solid_distance.clone();
        distance.resize(self.grid.n_cells(), 3.0 * self.grid.dx);
        // Of a search that did not end nothing is held that the system does not hold anyway.
        let held = match after.settled {
            true => after.held.clone(),
            false => vec![ActiveSurfaces::default(); after.held.len()],
        };
        let contacts = Contacts::holding(
            solids,
            &self.grid,
            &distance,
            &after.displacement,
            &held,
            dt,
        );
        if after.settled || !both.is_some_and(Both::touch) {
            let beyond = contacts.beyond(&after.velocity);
            let wrong = beyond.max(contacts.pulled(&system, &after.velocity));
            // Gaps are f32, of a distance sampled with a position in cells.
            let size = self.grid.size().max_element();
            let bound = contacts.near() + 64.0 * EPS * size;
            let row = ["solve", "beyond walls and obstacles, or pulled", "m"];
            self.table.whole(row, wrong, 0.0, bound);
        }
        let exact = Solver {
            tolerance: 1e-13,
            ..self.scene.solver
        };
        let (twin, _) = self.solver.solve_direct(&system, &exact)?;
        let least = (0..solids.rest.len())
            .map(|node| solids.body_of_node(node).zeta_mass(dt) * solids.mass[node])
            .fold(f64::INFINITY, f64::min);
        let bound = (allowed + 1e-12 * norm(&system.rhs)) / least;
        self.add_nodes(["solve", "v", "m/s"], &after.velocity, &twin, |_, _| bound);
        Ok(())
    }

    /// Sums over nodes and elements: five roundings of a term, one per term of a thread's share and level of the tree in f32, and
    /// two f32 that hold the sum.
    fn diagnose(&mut self, after: &SolidSnapshot) {
        let (solids, gpu) = (&self.solids, &after.report.diagnosis);
        let gravity = self.scene.domain.gravity.as_vec3().as_dvec3();
        let deformations: Vec<Deformation> = (0..solids.elements.len())
            .map(|element| solids.deformation(element, &after.displacement))
            .collect();
        let sums = |velocity: &[[f64; 3]], gravity: DVec3| {
            let displacement = &after.displacement;
            reference::diagnose_solid(solids, &deformations, displacement, velocity, gravity)
        };
        let twin = sums(&after.velocity, gravity);
        let size = sizes(solids, after, gravity);
        let n = (solids.rest.len() + solids.elements.len()) as f64;
        let shares = match after.real {
            Real::F32 => 96.0 * EPS,
            Real::F64 => 0.0,
        };
        let error = shares + (n + 32.0) * f64::EPSILON + EPS * EPS;
        let mut row = |quantity, unit, number: &dyn Fn(&SolidDiagnosis) -> f64, bound| {
            let row = [Stage::Diagnose.name(), quantity, unit];
            self.table.whole(row, number(gpu), number(&twin), bound);
        };
        row(
            "kinetic energy",
            "J",
            &|d| d.kinetic_energy,
            error * size.kinetic_energy,
        );
        row(
            "potential energy",
            "J",
            &|d| d.potential_energy,
            error * size.potential_energy,
        );
        row(
            "largest speed",
            "m/s",
            &|d| d.max_speed,
            EPS * twin.max_speed,
        );
        for a in 0..3 {
            row(
                "momentum",
                "kg m/s",
                &|d| d.momentum[a],
                error * size.momentum[a],
            );
            let bound = 4.0 * error * size.angular_momentum[a];
            row(
                "angular momentum",
                "kg m^2/s",
                &|d| d.angular_momentum[a],
                bound,
            );
        }
        // Quadratic in the strain, which is off by roundings of F.
        let eps = unit(after.real);
        let rounded = 64.0 * eps * (size.elastic_energy * twin.elastic_energy).sqrt()
            + 4096.0 * eps * eps * size.elastic_energy;
        let bound = rounded + error * twin.elastic_energy;
        row("elastic energy", "J", &|d| d.elastic_energy, bound);
    }
}

/// Sums of the magnitudes that the sums of a diagnosis add up; of the elastic energy, what a strain of the size of F would store.
fn sizes(solids: &Solids, after: &SolidSnapshot, gravity: DVec3) -> SolidDiagnosis {
    let mut size = SolidDiagnosis {
        momentum: [0.0; 3],
        angular_momentum: [0.0; 3],
        kinetic_energy: 0.0,
        elastic_energy: 0.0,
        potential_energy: 0.0,
        max_speed: 0.0,
        min_det: 0.0,
        inverted: 0,
    };
    for (node, &mass) in solids.mass.iter().enumerate() {
        let x = (solids.rest[node] + DVec3::from(after.displacement[node])).abs();
        let v = DVec3::from(after.velocity[node]).abs();
        size.kinetic_energy += mass * v.length_squared();
        size.potential_energy += mass * gravity.abs().dot(x);
        for axis in 0..3 {
            let (next, last) = ((axis + 1) % 3, (axis + 2) % 3);
            size.momentum[axis] += mass * v[axis];
            size.angular_momentum[axis] += mass * (x[next] * v[last] + x[last] * v[next]);
        }
    }
    for (element, corners) in solids.elements.iter().enumerate() {
        let body = solids.body_of_element(element);
        let u = corners.map(|node| DVec3::from(after.displacement[node as usize]));
        let g = &solids.gradients[element];
        let terms: f64 = (1..4).map(|a| (u[a] - u[0]).length() * g[a].length()).sum();
        let stiffness = 2.0 * body.mu + 3.0 * body.lambda.abs();
        size.elastic_energy += solids.volume[element] * stiffness * (1.0 + terms).powi(2);
    }
    size
}

/// How much larger the error of R is than that of F.
fn condition(deformation: &Deformation) -> f64 {
    let stretch = deformation.rotation.transpose() * (DMat3::IDENTITY + deformation.gradient);
    let trace = stretch.x_axis.x + stretch.y_axis.y + stretch.z_axis.z;
    let inverse = (DMat3::from_diagonal(DVec3::splat(trace)) - stretch).inverse();
    let size = frobenius(inverse);
    if size.is_finite() {
        2.0 * size
    } else {
        f64::INFINITY
    }
}

fn frobenius(m: DMat3) -> f64 {
    let columns = [m.x_axis, m.y_axis, m.z_axis];
    columns
        .map(DVec3::length_squared)
        .iter()
        .sum::<f64>()
        .sqrt()
}

/// |F - R|
fn distance_to_rotation(deformation: &Deformation) -> f64 {
    frobenius(DMat3::IDENTITY + deformation.gradient - deformation.rotation)
}
