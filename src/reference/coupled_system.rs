//! The coupled system of one sub-step (thesis 5.17): B p + J v = E u*, S v - J^T p = -w.

use glam::DVec3;

use super::pressure_system::{PressureSystem, remove_means};
use super::refine::{LinearSystem, Part};
use super::solid_system::SolidSystem;
use super::solve_coupled::CoupledSolution;
use crate::geometry::{CellNode, Coupling};
use crate::linalg::{Csr, LinearOperator, norm};

/// Largest allowed incompatible boundary flux, relative to the prescribed flux: rounding, and the effect of the area
/// clamp.
pub const SQUEEZE: f64 = 1e-2;
/// Remainder of a constrained direction when the normal is rounded to f32.
const ROUNDED: f64 = 1e-6;

/// The pressure system, the solid system, and J. A vector contains a pressure per grid cell (0 in inactive ones),
/// then three velocities per node (0 in prescribed components).
#[derive(Clone, Debug)]
pub struct CoupledSystem {
    /// B, and E u* less J times the prescribed velocities.
    pub pressure: PressureSystem,
    /// S, and -w less S times the prescribed velocities.
    pub solid: SolidSystem,
    /// J on the active cells.
    pub coupling: Coupling,
    /// Enclosed components beside nodes that are all constrained, or slide along walls and obstacles: their pressure
    /// level is undetermined too.
    constrained: Vec<Vec<usize>>,
    /// Components that are not prescribed, ascending.
    components: Vec<usize>,
    /// Both right-hand sides.
    rhs: Vec<f64>,
    /// [`PressureSystem::squeezed`] over the components with undetermined pressure level, including prescribed nodes.
    pub squeezed: f64,
}

impl CoupledSystem {
    /// Assembles the system. `coupling` covers all cells.
    pub fn new(mut pressure: PressureSystem, solid: SolidSystem, coupling: &Coupling) -> CoupledSystem {
        let coupling = coupling.restricted(|cell| pressure.stencil.active(cell));
        let (n_cells, n_components) = (pressure.rhs.len(), solid.rhs.len());
        let prescribed = solid.velocity(&vec![0.0; n_components]);
        let mut flux = vec![0.0; n_cells];
        coupling.add_product(prescribed.as_flattened(), &mut flux);
        for (rhs, flux) in pressure.rhs.iter_mut().zip(&flux) {
            *rhs -= flux;
        }
        pressure.rhs_scale += norm(&flux);
        let freedom = solid.freedom();
        let moves = |pair: &CellNode| {
            let free = freedom[pair.node].projector * pair.value;
            free.length() > ROUNDED * pair.value.length()
        };
        let moves = |&cell: &usize| coupling.cell_pairs(cell).iter().any(moves);
        let constrained = pressure.sealed.iter();
        let constrained = constrained.filter(|cells| !cells.iter().any(moves));
        let constrained: Vec<Vec<usize>> = constrained.cloned().collect();
        // Gaps that contacts close in a sub-step are not prescribed motion.
        let squeezed = pressure.squeezed(&pressure.closed, Some(&flux)).max(pressure.squeezed(&constrained, None));
        let mut rhs = std::mem::take(&mut pressure.rhs);
        pressure.remove_closed_means(&mut rhs);
        remove_means(&constrained, &mut rhs);
        pressure.rhs.clone_from(&rhs);
        rhs.extend(&solid.rhs);
        CoupledSystem { constrained, components: solid.components(), pressure, solid, coupling, rhs, squeezed }
    }

    /// Cells of each liquid component with undetermined pressure level.
    pub fn level_free(&self) -> impl Iterator<Item = &Vec<usize>> {
        self.pressure.closed.iter().chain(&self.constrained)
    }

    /// Cells of each liquid component without a free surface whose room bodies make: B alone does not determine its pressure level.
    pub fn room_of_bodies(&self) -> impl Iterator<Item = &Vec<usize>> {
        self.pressure.sealed.iter().filter(|cells| !self.constrained.contains(cells))
    }

    /// Number of cells of the grid: index of the first velocity in a vector.
    pub fn n_cells(&self) -> usize {
        self.pressure.rhs.len()
    }

    /// J x, m^3/s per cell.
    pub fn flux(&self, x: &[f64]) -> Vec<f64> {
        let mut flux = vec![0.0; self.n_cells()];
        self.coupling.add_product(x, &mut flux);
        flux
    }

    /// J^T p in the free directions, N, three numbers per node.
    pub fn force(&self, pressure: &[f64]) -> Vec<f64> {
        let mut all = vec![0.0; self.solid.rhs.len()];
        self.coupling.add_transposed(pressure, &mut all);
        self.solid.free_part(all.as_chunks().0)
    }

    /// Pressure (Pa) and velocities (m/s), including prescribed ones, of a vector.
    pub fn split(&self, mut x: Vec<f64>) -> (Vec<f64>, Vec<[f64; 3]>) {
        let velocity = self.solid.velocity(&x[self.n_cells()..]);
        x.truncate(self.n_cells());
        (x, velocity)
    }

    /// Adds forces on all nodes, N, three numbers per node.
    pub(super) fn push(&mut self, forces: &[f64]) {
        self.solid.push(forces);
        let n_cells = self.n_cells();
        self.rhs[n_cells..].copy_from_slice(&self.solid.rhs);
    }

    /// Residual of the nodes, -w - S v + J^T p, N, three numbers per node.
    pub(super) fn unbalanced(&self, solution: &CoupledSolution) -> Vec<f64> {
        let products = self.solid.multiply(&solution.velocity).into_iter();
        let sums = products.zip(self.solid.forces());
        let sums: Vec<[f64; 3]> = sums.map(|(product, force)| (DVec3::from(*force) - product).to_array()).collect();
        let force = self.force(&solution.pressure);
        let free = self.solid.free_part(&sums).into_iter();
        free.zip(force).map(|(sum, force)| sum + force).collect()
    }

    /// The blocks as sparse matrices.
    pub fn blocks(&self) -> Blocks {
        let cells = self.pressure.stencil.active_cells();
        let mut row = vec![usize::MAX; self.n_cells()];
        for (number, &cell) in cells.iter().enumerate() {
            row[cell] = number;
        }
        let mut column = vec![None; self.solid.rhs.len()];
        for (number, &component) in self.components.iter().enumerate() {
            column[component] = Some(number);
        }
        let j = Csr::from_rows(cells.len(), self.components.len(), |row, entries| {
            for pair in self.coupling.cell_pairs(cells[row]) {
                let free = self.solid.freedom()[pair.node].projector * pair.value;
                let values = free.to_array().into_iter().enumerate();
                entries.extend(
                    values.filter_map(|(axis, value)| column[3 * pair.node + axis].map(|column| (column, value))),
                );
            }
        });
        let pinned: Vec<usize> = self.level_free().map(|cells| cells[0]).collect();
        let mass = self.solid.mass_term();
        Blocks {
            b: self.pressure.numbered(self.pressure.scale, &pinned),
            j,
            s: self.solid.free_to_csr(),
            free: self.solid.free_directions(),
            mass: self.components.iter().map(|&at| mass[at / 3]).collect(),
            cells,
            components: self.components.clone(),
            n_cells: self.n_cells(),
            n_components: self.solid.rhs.len(),
        }
    }
}

/// The blocks of a coupled system with only active cells and free components as unknowns, in order.
#[derive(Clone, Debug)]
pub struct Blocks {
    /// B, m^3/s per Pa. The diagonal of one cell is doubled in each component with undetermined pressure level.
    pub b: Csr,
    /// J P, m^2, with P the constraint projector.
    pub j: Csr,
    /// P S P, kg/s, with the mean of a node's diagonal in constrained directions.
    pub s: Csr,
    /// P. Rows: all components; columns: those of S.
    pub free: Csr,
    /// zeta_M M, kg/s.
    pub mass: Vec<f64>,
    /// Cell of each row of B.
    pub cells: Vec<usize>,
    /// Component of each row of S: three times the node, plus 0, 1, 2 for x, y, z.
    pub components: Vec<usize>,
    n_cells: usize,
    n_components: usize,
}

impl Blocks {
    /// Selects the unknowns of a vector.
    pub fn gather(&self, x: &[f64]) -> Vec<f64> {
        let pressure = self.cells.iter().map(|&cell| x[cell]);
        let velocity = self.components.iter();
        let velocity = velocity.map(|&component| x[self.n_cells + component]);
        pressure.chain(velocity).collect()
    }

    /// Inserts the unknowns into a vector.
    pub fn scatter(&self, unknowns: &[f64]) -> Vec<f64> {
        let mut x = vec![0.0; self.n_cells + self.n_components];
        let places = self.cells.iter().copied();
        let components = self.components.iter();
        let places = places.chain(components.map(|&component| self.n_cells + component));
        for (place, value) in places.zip(unknowns) {
            x[place] = *value;
        }
        x
    }
}

impl LinearSystem for CoupledSystem {
    fn rhs(&self) -> &[f64] {
        &self.rhs
    }

    fn rhs_scale(&self) -> f64 {
        self.pressure.rhs_scale + self.solid.rhs_scale
    }

    fn n_unknowns(&self) -> usize {
        self.pressure.n_unknowns() + self.solid.n_unknowns()
    }

    /// E u* - B p - J x, then -w - S x + J^T p.
    fn residual(&self, x: &[f64]) -> Vec<f64> {
        let (pressure, velocity) = x.split_at(self.n_cells());
        let mut residual = self.pressure.residual(pressure);
        for (residual, flux) in residual.iter_mut().zip(self.flux(velocity)) {
            *residual -= flux;
        }
        let solid = self.solid.residual(velocity).into_iter();
        residual.extend(solid.zip(self.force(pressure)).map(|(r, force)| r + force));
        residual
    }

    fn project(&self, x: &mut [f64]) {
        let n_cells = self.n_cells();
        self.pressure.remove_closed_means(&mut x[..n_cells]);
        remove_means(&self.constrained, &mut x[..n_cells]);
    }

    /// The scale includes rounding of the coupling terms, which may be the only ones.
    fn parts(&self, x: &[f64]) -> Vec<Part> {
        let (pressure, velocity) = x.split_at(self.n_cells());
        let flux_scale = |pair: &CellNode| {
            let velocity = DVec3::from_slice(&velocity[3 * pair.node..]);
            pair.value.abs().dot(velocity.abs())
        };
        let rows = self.coupling.cells();
        let fluxes: Vec<f64> = rows.map(|(_, pairs)| pairs.iter().map(flux_scale).sum()).collect();
        let force_scale = |pair: &CellNode| pair.value.length() * pressure[pair.cell].abs();
        let nodes = 0..self.coupling.n_nodes();
        let forces: Vec<f64> = nodes.map(|node| self.coupling.node_pairs(node).iter().map(force_scale).sum()).collect();
        let n_cells = self.n_cells();
        vec![
            Part {
                range: 0..n_cells,
                unknowns: self.pressure.n_unknowns(),
                scale: self.pressure.rhs_scale + norm(&fluxes),
                acts: norm(&self.flux(velocity)),
            },
            Part {
                range: n_cells..self.rhs.len(),
                unknowns: self.solid.n_unknowns(),
                scale: self.solid.rhs_scale + norm(&forces),
                acts: norm(&self.force(pressure)),
            },
        ]
    }
}

/// The monolithic two-field operator A of thesis (5.25), factored for accuracy in single precision: t = Z1^-1 (J^T p
/// - Z2 v), then B p + J t and Z2 (v - t). Z1 = sigma zeta_M M, Z2 = S - Z1.
pub struct TwoField<'a> {
    system: &'a CoupledSystem,
    /// Z1 per component, kg/s.
    z1: Vec<f64>,
}

impl<'a> TwoField<'a> {
    /// `sigma`: fraction of the mass in Z1, between 0 and 1.
    pub fn new(system: &'a CoupledSystem, sigma: f64) -> TwoField<'a> {
        let mass = system.solid.mass_term();
        TwoField { system, z1: (0..3 * mass.len()).map(|at| sigma * mass[at / 3]).collect() }
    }

    /// Z1 per component, kg/s.
    pub fn z1(&self) -> &[f64] {
        &self.z1
    }

    /// Z2 x.
    pub fn z2(&self, x: &[f64]) -> Vec<f64> {
        let mut product = vec![0.0; x.len()];
        self.system.solid.apply(x, &mut product);
        let mass = self.z1.iter().zip(x);
        let sums = product.iter().zip(mass);
        sums.map(|(s, (z1, x))| s - z1 * x).collect()
    }

    /// Z1^-1 y.
    pub fn over_z1(&self, y: &[f64]) -> Vec<f64> {
        y.iter().zip(&self.z1).map(|(y, z1)| y / z1).collect()
    }

    /// [r_p + J Z1^-1 r_v; -Z2 Z1^-1 r_v] of a residual [r_p; -r_v] of the coupled system.
    pub fn rhs(&self, residual: &[f64]) -> Vec<f64> {
        let (pressure_rows, velocity_rows) = residual.split_at(self.system.n_cells());
        let t = self.over_z1(velocity_rows);
        let mut rhs = pressure_rows.to_vec();
        for (rhs, flux) in rhs.iter_mut().zip(self.system.flux(&t)) {
            *rhs -= flux;
        }
        rhs.extend(self.z2(&t));
        rhs
    }
}

impl LinearOperator for TwoField<'_> {
    fn size(&self) -> usize {
        self.system.n_cells() + self.z1.len()
    }

    fn apply(&self, x: &[f64], y: &mut [f64]) {
        let (pressure, velocity) = x.split_at(self.system.n_cells());
        let (pressure_rows, velocity_rows) = y.split_at_mut(self.system.n_cells());
        let mut t = self.system.force(pressure);
        for (t, pull) in t.iter_mut().zip(self.z2(velocity)) {
            *t -= pull;
        }
        let t = self.over_z1(&t);
        self.system.pressure.stencil.apply(pressure, pressure_rows);
        for (y, flux) in pressure_rows.iter_mut().zip(self.system.flux(&t)) {
            *y = self.system.pressure.scale * *y + flux;
        }
        let difference: Vec<f64> = velocity.iter().zip(&t).map(|(v, t)| v - t).collect();
        velocity_rows.copy_from_slice(&self.z2(&difference));
    }
}
