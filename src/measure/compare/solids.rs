//! The stages of the solids against their twins.

use std::sync::Arc;

use glam::{DMat3, DVec3};

use super::table::{Pair, Place, Table, components, flag};
use super::{Both, EPS, corners, largest, rounded_to_f32, unit};
use crate::Error;
use crate::elastic::{Deformation, Solids, forces};
use crate::geometry::{ContactField, Coupling};
use crate::gpu::Real;
use crate::grid::Grid;
use crate::linalg::norm;
use crate::reference::{
    self, ActiveCells, ActiveSurfaces, BlockPattern, Contacts, Formulation, RightHandSide as Inflow, SolidMatrices,
    SolidRightHandSide, SolidSolver, SolidSystem, TimeStep,
};
use crate::scene::{Scene, Solver};
use crate::sim::{GpuPath, SolidSnapshot, coupled_system, stored_coupling};
use crate::solver::{COUPLING_SHARE, rounding};
use crate::state::SolidDiagnosis;
use crate::step::Stage;

/// Relative error of a displacement, which is stored as the sum of two f32, and of its increment.
const PAIR: f64 = 1.0 / (1u64 << 45) as f64;
/// Rounding-error budget of the rotation correction of a body, relative to its largest node's: sums over nodes, with lever arms that are differences
/// of positions, and an inverse tensor of inertia.
const ROTATION_ROUNDINGS: f64 = 256.0;

/// Largest effect of coefficients in f32 on the solution for liquid and solids, relative to its largest number.
const ASSEMBLY: f64 = 1e-5;

/// A vector per node.
type Field = [[f64; 3]];

/// Error of R above which the nearest rotation counts as not unique.
const AMBIGUOUS: f64 = 1e-2;

/// The twins of the solids, with the inputs of the device.
pub(super) struct SolidComparison<'a> {
    scene: &'a Scene,
    grid: Grid,
    /// The obstacles.
    obstacles: ContactField,
    /// As stored on the device.
    solids: Solids,
    pattern: Arc<BlockPattern>,
    solver: SolidSolver,
    pub(super) table: Table,
    /// s
    dt: f64,
    /// Mean over the sub-step as on the device, m/s^2.
    gravity: DVec3,
    /// Input of the stage: the fields of the device.
    pub(super) before: SolidSnapshot,
    /// Matrices of the sub-step, after `solid_matrices`.
    matrices: Option<SolidMatrices>,
}

impl<'a> SolidComparison<'a> {
    /// `before`: the solids at the start.
    pub(super) fn new(scene: &'a Scene, path: &GpuPath, before: SolidSnapshot) -> Self {
        let grid = Grid { cells: scene.domain.cells, dx: f64::from(scene.grid().dx as f32) };
        let solids = before.on_device(path.solids().expect("the scene has solids"));
        let mut obstacles = path.contact_field();
        obstacles.grid = grid;
        if !obstacles.moves() {
            obstacles.distance = rounded_to_f32(&obstacles.distance);
        }
        SolidComparison {
            scene,
            grid,
            obstacles,
            pattern: Arc::new(BlockPattern::new(&solids)),
            solver: SolidSolver::new(&solids),
            solids,
            table: Table::new(scene.grid()),
            dt: 0.0,
            gravity: DVec3::ZERO,
            before,
            matrices: None,
        }
    }

    /// Begins a sub-step.
    pub(super) fn begin(&mut self, path: &GpuPath, time_step: TimeStep) {
        self.gravity = path.gravity(time_step).as_vec3().as_dvec3();
        let (time, dt) = (path.clock().time, time_step.dt);
        if self.solids.set_load([time, time + dt]) {
            self.before.round_load(&mut self.solids);
        }
        self.table.step = path.clock().step;
        self.dt = f64::from(dt as f32);
        self.obstacles.move_to(time + dt, dt);
        if path.clock().step == 0 {
            let SolidSnapshot { displacement, velocity, real, .. } = &mut self.before;
            self.solids.start_scripts(displacement, velocity, self.dt);
            if *real == Real::F32 {
                velocity.as_flattened_mut().iter_mut().for_each(|v| *v = f64::from(*v as f32));
            }
        }
    }

    /// Compares the fields after a stage.
    pub(super) fn compare(&mut self, stage: Stage, after: &SolidSnapshot, both: Option<&Both>) -> Result<(), Error> {
        self.table.stage = stage.name();
        match stage {
            Stage::MoveSolid => self.move_solid(after, both),
            Stage::Forces => self.forces(after),
            Stage::SolidMatrices => self.solid_matrices(after),
            Stage::RightHandSide => self.right_hand_side(after, both),
            Stage::Solve => self.solve(after, both)?,
            Stage::Diagnose => self.diagnose(after),
            _ => {}
        }
        Ok(())
    }

    /// Which bodies are ballistic on the device. Where one ends so near to a wall or an obstacle that rounding decides, either is
    /// right.
    fn ballistic_bodies(&mut self, after: &SolidSnapshot, both: Option<&Both>) -> Vec<bool> {
        let (n, grid, before) = (self.solids.rest.len(), self.grid, &self.before);
        let wet = both.map(|both| reference::wet_nodes(both.clip.coupling(), &both.liquid.filled, n));
        let wet = wet.unwrap_or_else(|| vec![false; n]);
        let distance = if self.scene.obstacles.is_empty() { &[][..] } else { &self.obstacles.distance };
        let falling = (self.gravity, self.dt);
        let twin = |off: DVec3| {
            let moved: Vec<[f64; 3]> = before.displacement.iter().map(|&u| (DVec3::from(u) + off).into()).collect();
            let (solids, v) = (&self.solids, &before.velocity);
            let mut ballistic = reference::ballistic_bodies(solids, &grid, distance, &wet, falling, &moved, v);
            if self.scene.solver.solid_contact {
                reference::hold_near_others(solids, grid.dx, self.dt, &moved, v, &mut ballistic);
            }
            ballistic
        };
        let near = 64.0 * EPS * grid.size().max_element();
        let others: Vec<Vec<bool>> = corners().map(|corner| twin(near * corner)).collect();
        let exact = twin(DVec3::ZERO);
        let first_nodes = self.solids.bodies.iter().map(|body| body.nodes.start);
        let ballistic: Vec<bool> = first_nodes.clone().map(|node| after.ballistic[node]).collect();
        let flags = ballistic.iter().zip(first_nodes).enumerate().map(|(body, (&gpu, node))| {
            let either = others.iter().any(|other| other[body] == gpu);
            flag(gpu, if either { gpu } else { exact[body] }, Place::Node(node, self.solids.rest[node]))
        });
        self.table.add(["ballistic", "flag"], flags);
        ballistic
    }

    /// A free node has the roundings of its stored displacement, of dt v and of the rotation of its body; a node put on a wall those of its position.
    /// Rounding decides whether a node that the solve has brought to the wall penetrates it and loses its normal velocity.
    fn move_solid(&mut self, after: &SolidSnapshot, both: Option<&Both>) {
        let ballistic = self.ballistic_bodies(after, both);
        let (before, dt, gravity) = (&self.before, self.dt, self.gravity);
        let (mut turned, mut turned_v) = (before.displacement.clone(), before.velocity.clone());
        reference::turn_solids(&self.solids, dt, &mut turned, &mut turned_v);
        let rotation = self.rotation_errors(&turned, &turned_v, unit(after.real));
        let (mut u, mut v) = (before.displacement.clone(), before.velocity.clone());
        reference::move_solid(&self.solids, &self.grid, dt, (gravity, &ballistic), &mut u, &mut v);
        let size = self.grid.size();
        let longest = size.max_element();
        let touches = |node: usize| {
            (0..3).any(|axis| {
                let fall = if after.ballistic[node] { 0.5 * dt * dt * gravity[axis] } else { 0.0 };
                let free = turned[node][axis] + dt * turned_v[node][axis] + fall;
                let moved = |u: f64| (u - free).abs() > PAIR * (free.abs() + longest);
                moved(u[node][axis]) || moved(after.displacement[node][axis])
            })
        };
        let touched: Vec<bool> = (0..u.len()).map(touches).collect();
        let contact = 8.0 * EPS * longest;
        let (rest, eps) = (&self.solids.rest, unit(after.real));
        let displacement = |node: usize, axis: usize| {
            let way = dt * (before.velocity[node][axis].abs() + 0.5 * dt * gravity[axis].abs());
            let free = 4.0 * PAIR * (u[node][axis].abs() + way) + eps * way;
            rotation[node][0] + if touched[node] { contact } else { free }
        };
        let velocity = |node: usize, _: usize| {
            let x = rest[node] + DVec3::from(u[node]);
            let arrives = x.min(size - x).min_element() <= contact;
            let speed = DVec3::from(before.velocity[node]).length();
            rotation[node][1] + if arrives { speed } else { 0.0 }
        };
        self.table.nodes(rest, ["displacement", "m"], [&after.displacement, &u], displacement);
        self.table.nodes(rest, ["v*", "m/s"], [&after.velocity, &v], velocity);
    }

    /// Errors of displacement (m) and velocity (m/s) of each node by the rotation of its body. `turned`, `turned_v`: displacements and velocities after it.
    fn rotation_errors(&self, turned: &Field, turned_v: &Field, eps: f64) -> Vec<[f64; 2]> {
        let before = &self.before;
        let mut errors = vec![[0.0; 2]; turned.len()];
        for body in self.solids.rotating_bodies() {
            let longest =
                |vector: &dyn Fn(usize) -> DVec3| largest(body.nodes.clone().map(|node| vector(node).length()));
            let change =
                |after: &Field, before: &Field| longest(&|node| DVec3::from(after[node]) - DVec3::from(before[node]));
            let speed = longest(&|node| before.velocity[node].into());
            let moved = change(turned, &before.displacement) + self.dt * speed / ROTATION_ROUNDINGS;
            let faster = change(turned_v, &before.velocity) + speed / ROTATION_ROUNDINGS;
            errors[body.nodes.clone()].fill([moved, faster].map(|change| ROTATION_ROUNDINGS * eps * change));
        }
        errors
    }

    /// One product and one sum.
    fn forces(&mut self, after: &SolidSnapshot) {
        let (eps, dt, gravity) = (unit(after.real), self.dt, self.gravity);
        let mut twin = self.before.velocity.clone();
        reference::node_forces(&self.solids, &after.prescribed, gravity, dt, &mut twin);
        let bound = |node: usize, axis: usize| eps * (2.0 * dt * gravity[axis].abs() + twin[node][axis].abs());
        self.table.nodes(&self.solids.rest, ["v*", "m/s"], [&after.velocity, &twin], bound);
    }

    /// The gradient of the displacement has 8 roundings of its terms. The rotation has these and a few of its own, times the condition of the polar
    /// decomposition: twice the norm of (tr(S) I - S)^-1, where S = R^T F (Higham 2008, section 8.2). Strain and stress have both.
    fn solid_matrices(&mut self, after: &SolidSnapshot) {
        let solids = &self.solids;
        let mut matrices = reference::solid_matrices(solids, &self.pattern, &after.displacement);
        let eps = unit(after.real);
        let (table, ambiguous) = (&mut self.table, ["|F - R| where R is ambiguous", ""]);
        // This row comes first.
        table.row(ambiguous);
        for element in 0..solids.elements.len() {
            let body = solids.body_of_element(element);
            let g = &solids.gradients[element];
            let terms = gradient_terms(solids, after, element);
            let size = 1.0 + terms;
            let error_f = eps * (8.0 * terms + 2.0);
            let mut error_r = error_f * condition(&matrices.deformations[element]) + 16.0 * eps;
            if error_r > AMBIGUOUS {
                table.add(ambiguous, [accept_rotation(solids, after, element, &mut matrices, 8.0 * eps * size)]);
                error_r = 64.0 * eps * size;
            }
            let deformation = &matrices.deformations[element];
            let volume = solids.volume[element];
            let zeta = body.zeta_stiffness(self.dt);
            let twin_moduli = [zeta * volume * body.lambda, zeta * volume * body.mu];
            let stiffness = volume * (2.0 * body.mu + 3.0 * body.lambda.abs());
            let strain = size * error_r + error_f + 8.0 * eps * size;
            let strain = strain + (error_r + 8.0 * eps) * frobenius(deformation.strain);
            let place = Place::Element(element);
            for section in 0..3 {
                let gpu = after.rotated[section][element];
                let rotated = deformation.rotation * g[section + 1];
                let steep = g[section + 1].length();
                let bound = steep * (error_r + 4.0 * eps);
                let [x, y, z, _] = gpu;
                table.add(["rotated gradients", "1/m"], components([x, y, z], rotated.into(), bound, place));
                if let Some(&twin) = twin_moduli.get(section) {
                    let bound = 6.0 * (EPS + eps) * twin;
                    table.add(["zeta_K V moduli", "N s m"], [(gpu[3], twin, bound, place)]);
                }
                let bound = 2.0 * stiffness * steep * strain;
                let gpu = after.element_forces[section][element];
                let twin = matrices.element_forces[element][section + 1];
                table.add(["K x* - b of elements", "N"], components(gpu, twin.into(), bound, place));
            }
            let bound = 4.0 * size * size * error_f + 12.0 * eps * size.powi(3);
            let [.., determinant] = after.rotated[2][element];
            table.add(["det F", ""], [(determinant, deformation.determinant(), bound, place)]);
        }
        self.matrices = Some(matrices);
    }

    /// A sum over the elements of a node, and three terms: a rounding each, and three in each term. In liquid also the variation of the pressure within
    /// cells, with integrals in f32.
    fn right_hand_side(&mut self, after: &SolidSnapshot, both: Option<&Both>) {
        let n = self.solids.rest.len();
        let (mut elastic, mut size) = (vec![DVec3::ZERO; n], vec![DVec3::ZERO; n]);
        let mut count = vec![0.0; n];
        for (element, corners) in self.solids.elements.iter().enumerate() {
            let [a, b, c] = [0, 1, 2].map(|s| DVec3::from(after.element_forces[s][element]));
            let magnitude = a.abs() + b.abs() + c.abs();
            for (&node, force) in corners.iter().zip([-(a + b + c), a, b, c]) {
                elastic[node as usize] += force;
                size[node as usize] += magnitude;
                count[node as usize] += 1.0;
            }
        }
        // Constrained nodes have another velocity after the stage.
        let v_star = &self.before.velocity;
        let inertia = |node: usize| self.solids.mass[node] / self.dt * DVec3::from(v_star[node]);
        let eps = unit(after.real);
        let (corrections, gross) = self.corrections(both);
        let (mut twin, mut bounds) = (vec![[0.0; 3]; n], vec![[0.0; 3]; n]);
        for node in 0..n {
            let load = self.solids.load[node];
            let sum = inertia(node) - elastic[node] + load + corrections[node];
            let terms = (count[node] + 4.0) * size[node] + 8.0 * inertia(node).abs() + 4.0 * load.abs();
            let terms = terms + (8.0 * EPS / eps + 32.0) * gross[node];
            for axis in (0..3).filter(|&axis| !self.solids.prescribed[node][axis]) {
                twin[node][axis] = sum[axis];
                bounds[node][axis] = eps * terms[axis];
            }
        }
        let bound = |node: usize, axis: usize| bounds[node][axis];
        self.table.nodes(&self.solids.rest, ["M v*/dt - (K x* - b) + load", "N"], [&after.rhs, &twin], bound);
    }

    /// Forces of the pressure's variation within cells on the nodes, N, and the sums of the magnitudes of their terms.
    fn corrections(&self, both: Option<&Both>) -> (Vec<DVec3>, Vec<f64>) {
        let n = self.solids.rest.len();
        let (mut sums, mut gross) = (vec![DVec3::ZERO; n], vec![0.0; n]);
        let Some(both) = both else { return (sums, gross) };
        // The host computes the integrals, with a dx in f64.
        let (triangles, grid) = (&both.at_rest.triangles, self.scene.grid());
        for patch in both.clip.patches().iter().filter(|patch| both.liquid.active[patch.cell]) {
            let offset = patch.centroid - grid.cell_centre(grid.cell_at(patch.cell));
            let slope = both.slopes[patch.cell];
            for (corner, &node) in triangles[patch.triangle].iter().enumerate() {
                let moment = patch.barycentric[corner] * patch.area * offset + patch.moments[corner];
                sums[node as usize] += slope.dot(moment) * patch.normal;
                gross[node as usize] += slope.length() * moment.length();
            }
        }
        (sums, gross)
    }

    /// Row `assembly` of liquid and solids, before `solve` is compared: the solution of the coupled system as stored against that of the one assembled in
    /// f64. `systems`: unknowns and E u* of each.
    pub(super) fn assembly(&mut self, both: &Both, systems: [(ActiveCells, Inflow); 2]) -> Result<(), Error> {
        let (solids, dt, after) = (&self.solids, self.dt, both.solids);
        let Some((matrices, liquid)) = self.matrices.as_ref().zip(self.scene.liquid.as_ref()) else { return Ok(()) };
        let exact = Solver { tolerance: 1e-12, max_iterations: 10_000, ..self.scene.solver };
        let solve = |(active, rhs), solid, coupling: &Coupling, density| {
            let system = coupled_system((active, &*both.liquid.separated), rhs, solid, coupling, density);
            reference::solve_coupled(&system, Formulation::of(&system), &self.solver, solids, &exact)
        };
        let [stored, assembled] = systems;
        let (areas, weight) = stored_coupling(both.clip.coupling(), self.scene.grid().dx, liquid.density, dt);
        let solid = after.system(solids, &self.pattern, dt);
        let stored = solve(stored, solid, &areas, weight)?;
        // The right-hand side is the device's, compared in row `right_hand_side`: this row compares coefficients.
        let rhs = SolidRightHandSide { values: after.rhs.clone(), scale: 0.0 };
        let (stiffness, freedom) = (matrices.stiffness.clone(), after.freedom.clone());
        let solid = SolidSystem::new(solids, stiffness, &rhs, &after.velocity, freedom, dt);
        let assembled = solve(assembled, solid, both.clip.coupling(), liquid.density)?;
        // The velocity of a fall during the step is the scale where nothing moves.
        let fall = dt * self.gravity.length();
        let scale = |values: &[f64]| largest(values.iter().map(|x| x.abs()));
        self.table.stage = "assembly";
        let bound = ASSEMBLY * scale(&assembled.pressure);
        self.table.cells(["pressure, with solids", "Pa"], |cell| {
            both.liquid.active[cell].then_some((stored.pressure[cell], assembled.pressure[cell], bound))
        });
        let bound = ASSEMBLY * scale(assembled.velocity.as_flattened()).max(fall);
        let velocities = [&stored.velocity[..], &assembled.velocity];
        self.table.nodes(&solids.rest, ["v, with liquid", "m/s"], velocities, |_, _| bound);
        Ok(())
    }

    /// The system is the one stored: rotated gradients and moduli in the scalar type of the outer loop, and the device's constraints. In liquid it has
    /// J^T p of the computed pressure, with areas in f32. Row `v` compares with a direct solve: S >= zeta_M M, so v is off by at most |r| over
    /// the least zeta_M m.
    fn solve(&mut self, after: &SolidSnapshot, both: Option<&Both>) -> Result<(), Error> {
        let Some(matrices) = self.matrices.take() else { return Ok(()) };
        let (solids, dt) = (&self.solids, self.dt);
        let mut system = after.system(solids, &self.pattern, dt);
        let mut size = norm(&system.rhs);
        let mut area_error = 0.0;
        if let (Some(both), Some(liquid)) = (both.filter(|both| both.touch()), &self.scene.liquid) {
            let [force, gross] = both.force(liquid.density * self.grid.dx / dt);
            size = size.max(COUPLING_SHARE * norm(&system.free_part(bytemuck::cast_slice(&force))));
            system.push(bytemuck::cast_slice(&force));
            area_error = 4.0 * EPS * norm(bytemuck::cast_slice(&gross));
        }
        let solver = &self.scene.solver;
        let x = system.free_part(&after.velocity);
        let residual = norm(&system.residual(&x));
        let twin_rhs = reference::solid_right_hand_side(solids, &matrices, &self.before.velocity, dt);
        let rounded = rounding(solver) * (twin_rhs.scale + size);
        let mut allowed = (solver.tolerance * size).max(rounded) * (1.0 + 1e-6) + area_error;
        if after.real == Real::F32 {
            // The device tested a velocity in f64, of which it stores an f32.
            let rows = system.to_csr();
            let magnitude = |row| rows.row(row).map(|(column, s)| (s * x[column]).abs()).sum();
            let magnitudes: Vec<f64> = (0..rows.n_rows()).map(magnitude).collect();
            allowed += 2.0 * EPS * norm(&magnitudes);
        }
        self.table.whole(["true residual of S v", "N"], residual, 0.0, allowed);
        self.compare_contacts(after, both, &system);
        let exact = Solver { tolerance: 1e-13, ..self.scene.solver };
        let solids = &self.solids;
        let (twin, _) = self.solver.solve_direct(&system, &exact)?;
        let least = (0..solids.rest.len())
            .map(|node| solids.body_of_node(node).zeta_mass(dt) * solids.mass[node])
            .fold(f64::INFINITY, f64::min);
        let bound = (allowed + 1e-12 * norm(&system.rhs)) / least;
        self.table.nodes(&solids.rest, ["v", "m/s"], [&after.velocity, &twin], |_, _| bound);
        Ok(())
    }

    /// Penetrating or adhering nodes. Where the active set is not settled, only penetration by solids alone is compared.
    fn compare_contacts(&mut self, after: &SolidSnapshot, both: Option<&Both>, system: &SolidSystem) {
        if !after.settled && both.is_some_and(Both::touch) {
            return;
        }
        let held = match after.settled {
            true => after.held.clone(),
            false => vec![ActiveSurfaces::default(); after.held.len()],
        };
        let contacts = Contacts::holding(&self.solids, &self.obstacles, &after.displacement, &held, self.dt);
        let wrong = contacts.beyond(&after.velocity).max(contacts.pulled(system, &after.velocity));
        // Gaps are f32, of a distance sampled at a position in cells.
        let bound = contacts.near() + 64.0 * EPS * self.grid.size().max_element();
        self.table.whole(["beyond walls and obstacles, or pulled", "m"], wrong, 0.0, bound);
    }

    /// Sums over nodes and elements: five roundings of a term, in f32 one per term of a thread's share and level of the tree, and two f32 for the sum.
    fn diagnose(&mut self, after: &SolidSnapshot) {
        let (solids, gpu, gravity) = (&self.solids, &after.report.diagnosis, self.gravity);
        let (displacement, velocity) = (&after.displacement, &after.velocity);
        let deformations = solids.deformations(displacement);
        let twin = reference::diagnose_solid(solids, &deformations, displacement, velocity, gravity);
        let size = magnitudes(solids, after, gravity);
        let n = (solids.rest.len() + solids.elements.len()) as f64;
        let shares = if after.real == Real::F32 { 96.0 * EPS } else { 0.0 };
        let error = shares + (n + 32.0) * f64::EPSILON + EPS * EPS;
        // Quadratic in the strain, which has the roundings of F.
        let eps = unit(after.real);
        let rounded =
            64.0 * eps * (size.elastic_energy * twin.elastic_energy).sqrt() + 4096.0 * eps * eps * size.elastic_energy;
        self.table.wholes([
            ("kinetic energy", "J", gpu.kinetic_energy, twin.kinetic_energy, error * size.kinetic_energy),
            ("potential energy", "J", gpu.potential_energy, twin.potential_energy, error * size.potential_energy),
            ("largest speed", "m/s", gpu.max_speed, twin.max_speed, EPS * twin.max_speed),
        ]);
        for a in 0..3 {
            let (momentum, angular) = (error * size.momentum[a], 4.0 * error * size.angular_momentum[a]);
            self.table.wholes([
                ("momentum", "kg m/s", gpu.momentum[a], twin.momentum[a], momentum),
                ("angular momentum", "kg m^2/s", gpu.angular_momentum[a], twin.angular_momentum[a], angular),
            ]);
        }
        let elastic = rounded + error * twin.elastic_energy;
        self.table.whole(["elastic energy", "J"], gpu.elastic_energy, twin.elastic_energy, elastic);
    }
}

/// Sum of the magnitudes of the terms of an element's displacement gradient.
fn gradient_terms(solids: &Solids, after: &SolidSnapshot, element: usize) -> f64 {
    let u = solids.elements[element].map(|node| DVec3::from(after.displacement[node as usize]));
    let g = &solids.gradients[element];
    (1..4).map(|a| (u[a] - u[0]).length() * g[a].length()).sum()
}

/// An ambiguous rotation: any nearest one is correct, so the twin accepts the device's if it is as near. Distances to F on the GPU and of the twin, and
/// a bound that `rounding` is a part of.
fn accept_rotation(
    solids: &Solids,
    after: &SolidSnapshot,
    element: usize,
    matrices: &mut SolidMatrices,
    rounding: f64,
) -> Pair {
    let twin = &mut matrices.deformations[element];
    let gpu = after.turned(solids, element, twin.gradient);
    // |F - R|
    let distance = |of: &Deformation| frobenius(DMat3::IDENTITY + of.gradient - of.rotation);
    let [gpu_distance, distance] = [&gpu, &*twin].map(distance);
    let bound = 1e-6 * distance + rounding;
    let defect = gpu.rotation.transpose() * gpu.rotation - DMat3::IDENTITY;
    let eps = unit(after.real);
    let proper = gpu.rotation.determinant() > 0.0 && frobenius(defect) <= 64.0 * eps;
    if proper && gpu_distance - distance <= bound {
        *twin = gpu;
        let body = solids.body_of_element(element);
        let (g, volume) = (&solids.gradients[element], solids.volume[element]);
        matrices.element_forces[element] = forces(g, volume, twin, body.lambda, body.mu);
    }
    (gpu_distance, distance, bound, Place::Element(element))
}

/// Sums of the magnitudes of the terms of a diagnosis; elastic energy of a strain of the size of F.
fn magnitudes(solids: &Solids, after: &SolidSnapshot, gravity: DVec3) -> SolidDiagnosis {
    let mut size = SolidDiagnosis::default();
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
    for element in 0..solids.elements.len() {
        let body = solids.body_of_element(element);
        let size_f = 1.0 + gradient_terms(solids, after, element);
        let stiffness = 2.0 * body.mu + 3.0 * body.lambda.abs();
        size.elastic_energy += solids.volume[element] * stiffness * size_f.powi(2);
    }
    size
}

/// Condition of the polar decomposition: error of R over that of F.
fn condition(deformation: &Deformation) -> f64 {
    let stretch = deformation.rotation.transpose() * (DMat3::IDENTITY + deformation.gradient);
    let trace = stretch.x_axis.x + stretch.y_axis.y + stretch.z_axis.z;
    let inverse = (DMat3::from_diagonal(DVec3::splat(trace)) - stretch).inverse();
    let size = frobenius(inverse);
    if size.is_finite() { 2.0 * size } else { f64::INFINITY }
}

/// Frobenius norm.
fn frobenius(m: DMat3) -> f64 {
    let squares = [m.x_axis, m.y_axis, m.z_axis].map(DVec3::length_squared);
    squares.iter().sum::<f64>().sqrt()
}
