//! The pressure system B p = E u* of one sub-step (thesis 4.32-4.39), B = scale * stencil.

use rayon::prelude::*;

use super::active_cells::ActiveCells;
use super::right_hand_side::RightHandSide;
use crate::grid::{Axis, Grid};
use crate::linalg::{Csr, LinearOperator, norm};

/// The dimensionless part of B, matrix-free on the whole grid:
///
/// ```text
/// (A x)_c = sum over faces of weight_f (x_c - x_nb) + dirichlet_c x_c
/// ```
///
/// Symmetric and positive semi-definite. An inactive cell has neither weights nor a Dirichlet part; its diagonal is 0.
#[derive(Clone, Debug)]
pub struct Stencil {
    /// The grid.
    pub grid: Grid,
    /// Weight of every face per axis, host layout: the aperture between active cells, else 0.
    pub weight: [Vec<f64>; 3],
    /// Per cell: sum of aperture / theta over the free-surface faces.
    pub dirichlet: Vec<f64>,
    /// Per cell: sum of its face weights and its Dirichlet term. Positive exactly in active cells.
    pub diagonal: Vec<f64>,
}

impl Stencil {
    /// Assembles a stencil from its weights.
    pub fn new(grid: Grid, weight: [Vec<f64>; 3], dirichlet: Vec<f64>) -> Stencil {
        assert_eq!(dirichlet.len(), grid.n_cells(), "there is one Dirichlet entry per cell");
        for axis in Axis::ALL {
            assert_eq!(weight[axis.index()].len(), grid.n_faces(axis), "there is one weight per face");
        }
        let mut stencil = Stencil { grid, weight, dirichlet, diagonal: Vec::new() };
        stencil.diagonal = (0..grid.n_cells())
            .into_par_iter()
            .map(|cell| {
                stencil.dirichlet[cell] + stencil.neighbours(cell).iter().map(|(_, weight)| weight).sum::<f64>()
            })
            .collect();
        stencil
    }

    /// Index and face weight of the six neighbours in ascending order of their index: -z, -y, -x, +x, +y, +z. A
    /// neighbour outside the domain has weight 0 and the cell's own index.
    #[inline]
    pub fn neighbours(&self, cell: usize) -> [(usize, f64); 6] {
        let [nx, ny, nz] = self.grid.cells;
        let [i, j, k] = self.grid.cell_at(cell);
        let [x, y, z] = &self.weight;
        let (fx, fy) = (i + (nx + 1) * (j + ny * k), i + nx * (j + (ny + 1) * k));
        let at = |inside: bool, neighbour: usize, weight: f64| {
            if inside { (neighbour, weight) } else { (cell, 0.0) }
        };
        [
            at(k > 0, cell.wrapping_sub(nx * ny), z[cell]),
            at(j > 0, cell.wrapping_sub(nx), y[fy]),
            at(i > 0, cell.wrapping_sub(1), x[fx]),
            at(i + 1 < nx, cell + 1, x[fx + 1]),
            at(j + 1 < ny, cell + nx, y[fy + nx]),
            at(k + 1 < nz, cell + nx * ny, z[cell + nx * ny]),
        ]
    }

    /// Whether a cell is active.
    #[inline]
    pub fn active(&self, cell: usize) -> bool {
        self.diagonal[cell] > 0.0
    }

    /// The active cells in order: the numbering of [`PressureSystem::to_csr`].
    pub fn active_cells(&self) -> Vec<usize> {
        (0..self.grid.n_cells()).filter(|&cell| self.active(cell)).collect()
    }

    /// Whether each cell is active.
    pub fn active_mask(&self) -> Vec<bool> {
        self.diagonal.iter().map(|&diagonal| diagonal > 0.0).collect()
    }

    /// (A x) of one cell, from differences: these are small compared with the pressures.
    #[inline]
    pub(super) fn product(&self, x: &[f64], cell: usize) -> f64 {
        let centre = x[cell];
        let fluxes =
            self.neighbours(cell).iter().map(|&(neighbour, weight)| weight * (centre - x[neighbour])).sum::<f64>();
        fluxes + self.dirichlet[cell] * centre
    }
}

impl Stencil {
    /// The operator without unknowns in some cells, where x is 0: the others keep their weights towards them.
    pub fn masked(&self, cells: &[bool]) -> Stencil {
        let (mut weight, mut dirichlet) = (self.weight.clone(), self.dirichlet.clone());
        for axis in Axis::ALL {
            for (face, weight) in weight[axis.index()].iter_mut().enumerate() {
                let sides = self.grid.face_sides(axis, self.grid.face_at(axis, face));
                let [Some(minus), Some(plus)] = sides else {
                    continue;
                };
                match [cells[minus], cells[plus]] {
                    [false, false] => continue,
                    [false, true] => dirichlet[minus] += *weight,
                    [true, false] => dirichlet[plus] += *weight,
                    [true, true] => {}
                }
                *weight = 0.0;
            }
        }
        let masked = dirichlet.iter_mut().zip(cells).filter(|(_, cell)| **cell);
        masked.for_each(|(dirichlet, _)| *dirichlet = 0.0);
        Stencil::new(self.grid, weight, dirichlet)
    }
}

impl LinearOperator for Stencil {
    fn size(&self) -> usize {
        self.grid.n_cells()
    }

    fn apply(&self, x: &[f64], y: &mut [f64]) {
        y.par_iter_mut()
            .with_min_len(4096)
            .enumerate()
            .for_each(|(cell, out)| *out = if self.active(cell) { self.product(x, cell) } else { 0.0 });
    }
}

/// The pressure system of one step.
#[derive(Clone, Debug)]
pub struct PressureSystem {
    /// B without its scale.
    pub stencil: Stencil,
    /// dt dx / rho, m^4 s/kg: B = scale * stencil.
    pub scale: f64,
    /// E u* with volume control and without the mean over enclosed components, m^3/s, per cell; 0 in inactive cells.
    pub rhs: Vec<f64>,
    /// s_p = || |E| |u*| ||, m^3/s: scale of the rounding error of the right-hand side.
    pub rhs_scale: f64,
    /// Cells of each enclosed liquid component, ascending. Their pressure has mean zero.
    pub closed: Vec<Vec<usize>>,
    /// Cells of each component without a free surface whose pressure level moving solids determine.
    pub sealed: Vec<Vec<usize>>,
    /// Prescribed boundary flux of obstacles and sources per cell, m^3/s.
    pub taken: Vec<(usize, f64)>,
    /// Separated cells, ascending: their pressure is 0, and they are no unknowns.
    pub separated: Vec<usize>,
}

impl PressureSystem {
    /// Assembles the system of a step; `density` in kg/m^3.
    pub fn new(active: ActiveCells, rhs: RightHandSide, dt: f64, density: f64) -> PressureSystem {
        let scale = dt * active.stencil.grid.dx / density;
        PressureSystem {
            stencil: active.stencil,
            scale,
            rhs: rhs.values,
            rhs_scale: rhs.scale,
            closed: active.closed,
            sealed: active.sealed,
            taken: Vec::new(),
            separated: Vec::new(),
        }
    }

    /// Adds the prescribed boundary flux J v of moving obstacles, m^3/s.
    pub fn beside_obstacles(mut self, flux: &[(usize, f64)]) -> PressureSystem {
        let mut taken = vec![0.0; self.rhs.len()];
        let cells = flux.iter().filter(|(cell, _)| self.stencil.active(*cell));
        cells.for_each(|&(cell, flux)| taken[cell] = flux);
        for (rhs, taken) in self.rhs.iter_mut().zip(&taken) {
            *rhs -= taken;
        }
        self.rhs_scale += norm(&taken);
        remove_means(&self.closed, &mut self.rhs);
        self
    }

    /// Adds the prescribed boundary flux of obstacles and sources, m^3/s.
    pub fn with_taken(mut self, taken: impl IntoIterator<Item = (usize, f64)>) -> PressureSystem {
        self.taken.extend(taken);
        self
    }

    /// Largest incompatible boundary flux of a component, relative to the flux of `taken` and of solids (m^3/s per
    /// cell) over its cells. Rounding if the volume is constant, up to 1 if not.
    pub fn squeezed(&self, components: &[Vec<usize>], by_solids: Option<&[f64]>) -> f64 {
        if components.is_empty() {
            return 0.0;
        }
        let cell_flux = self.prescribed_flux(by_solids);
        let shares = components.iter().map(|component| {
            let [net, gross] = sums(component, &cell_flux);
            if gross > 0.0 { net.abs() / gross } else { 0.0 }
        });
        shares.fold(0.0, f64::max)
    }

    /// Flux of `taken` and of solids per cell, m^3/s.
    fn prescribed_flux(&self, by_solids: Option<&[f64]>) -> Vec<f64> {
        let mut cell_flux = by_solids.map_or_else(|| vec![0.0; self.rhs.len()], <[f64]>::to_vec);
        for &(cell, taken) in &self.taken {
            cell_flux[cell] += taken;
        }
        cell_flux
    }

    /// Removes from `closed` the components whose room grows by more than the share `least` of the prescribed flux. Their right-hand side is
    /// E u* again, without a mean removed. Returns their cells beside walls and bodies that recede, at least one of each.
    pub fn take_growing(&mut self, touching: &[bool], by_solids: Option<&[f64]>, least: f64) -> Vec<usize> {
        if self.closed.is_empty() {
            return Vec::new();
        }
        let [flux, taken] = [by_solids, None].map(|solids| self.prescribed_flux(solids));
        let recedes = |&cell: &usize| touching[cell] && flux[cell] > 0.0;
        let (growing, closed) = std::mem::take(&mut self.closed).into_iter().partition(|component: &Vec<usize>| {
            let [net, gross] = sums(component, &flux);
            net > least * gross && component.iter().any(recedes)
        });
        self.closed = closed;
        for component in &growing {
            let mean = sums(component, &taken)[0] / component.len() as f64;
            component.iter().for_each(|&cell| self.rhs[cell] -= mean);
        }
        growing.into_iter().flatten().filter(recedes).collect()
    }

    /// The system with p = 0 at the centres of some cells, which are no unknowns.
    pub fn masked(&self, cells: &[bool]) -> PressureSystem {
        let mut masked = self.clone();
        masked.separated = (0..cells.len()).filter(|&cell| cells[cell]).collect();
        if !masked.separated.is_empty() {
            masked.stencil = self.stencil.masked(cells);
            (masked.separated.iter()).for_each(|&cell| masked.rhs[cell] = 0.0);
            let opens = |component: &Vec<usize>| component.iter().any(|&cell| cells[cell]);
            masked.closed.retain(|component| !opens(component));
        }
        masked
    }

    /// Number of active cells.
    pub fn n_unknowns(&self) -> usize {
        self.stencil.diagonal.iter().filter(|&&diagonal| diagonal > 0.0).count()
    }

    /// rhs - B p, m^3/s, per cell.
    pub fn residual(&self, pressure: &[f64]) -> Vec<f64> {
        let mut residual = vec![0.0; pressure.len()];
        self.stencil.apply(pressure, &mut residual);
        for (r, b) in residual.iter_mut().zip(&self.rhs) {
            *r = b - self.scale * *r;
        }
        residual
    }

    /// B in the numbering of [`Stencil::active_cells`], m^3/s per Pa. Singular with enclosed components.
    pub fn to_csr(&self) -> Csr {
        self.numbered(self.scale, &[])
    }

    /// `scale` times the stencil in active numbering, with the diagonal of the `pinned` cells doubled.
    pub(super) fn numbered(&self, scale: f64, pinned: &[usize]) -> Csr {
        let cells = self.stencil.active_cells();
        let mut number = vec![usize::MAX; self.stencil.grid.n_cells()];
        for (n, &cell) in cells.iter().enumerate() {
            number[cell] = n;
        }
        Csr::from_rows(cells.len(), cells.len(), |row, entries| {
            let cell = cells[row];
            let diagonal = self.stencil.diagonal[cell] * if pinned.contains(&cell) { 2.0 } else { 1.0 };
            for (index, (neighbour, weight)) in self.stencil.neighbours(cell).into_iter().enumerate() {
                if index == 3 {
                    entries.push((row, scale * diagonal));
                }
                if weight > 0.0 {
                    entries.push((number[neighbour], -scale * weight));
                }
            }
        })
    }

    /// Subtracts the mean over every enclosed component from a field.
    pub fn remove_closed_means(&self, field: &mut [f64]) {
        remove_means(&self.closed, field);
    }
}

/// Sum of a field over some cells, and of its absolute values.
fn sums(cells: &[usize], field: &[f64]) -> [f64; 2] {
    let values = cells.iter().map(|&cell| field[cell]);
    values.fold([0.0, 0.0], |[net, gross], value: f64| [net + value, gross + value.abs()])
}

/// Subtracts the mean over each list of cells from a field.
pub fn remove_means(components: &[Vec<usize>], field: &mut [f64]) {
    for component in components {
        let mean = component.iter().map(|&cell| field[cell]).sum::<f64>() / component.len() as f64;
        component.iter().for_each(|&cell| field[cell] -= mean);
    }
}
