//! Snapshots of the device between two stages, for comparison with the f64 path and for export.

use std::sync::Arc;

use glam::{DMat3, DVec3};

use crate::Error;
use crate::elastic::{Deformation, Solids, stiffness_block};
use crate::fields::pressure_system::{BALLISTIC, FILLED};
use crate::fields::{
    CouplingReport, LevelBuffers, Report, SolidBuffers, SolidReport, SolidSystemBuffers, SolverBuffers,
};
use crate::geometry::{Coupling, CutCells};
use crate::gpu::{Buffer, Gpu, Real};
use crate::grid::{Axis, Grid, Padded};
use crate::reference::{
    ActiveCells, ActiveSurfaces, BlockMatrix, BlockPattern, CoupledSystem, Freedom, PressureSystem, RightHandSide,
    SolidRightHandSide, SolidSystem, Stencil,
};
use crate::state::State;

use super::GpuPath;
use super::gpu_liquid::GpuLiquid;

/// All fields that stages exchange, widened to f64.
#[derive(Clone, Debug)]
pub struct Snapshot {
    /// Fields of the liquid, if any.
    pub liquid: Option<LiquidSnapshot>,
    /// Fields of the solids, if any.
    pub solids: Option<SolidSnapshot>,
    /// Diagnostics of the coupling from the last `diagnose`, with liquid and solids.
    pub coupling: Option<CouplingReport>,
}

/// Fields that the stages of the solids exchange; one entry per node or element.
#[derive(Clone, Debug)]
pub struct SolidSnapshot {
    /// Displacement from rest, m.
    pub displacement: Vec<[f64; 3]>,
    /// v* before the solve, v after it, m/s.
    pub velocity: Vec<[f64; 3]>,
    /// Whether each node is of a body that touches nothing in the sub-step.
    pub ballistic: Vec<bool>,
    /// Prescribed velocities of the sub-step, m/s; 0 in free components.
    pub prescribed: Vec<[f64; 3]>,
    /// Rotated gradients of the shape functions of corners 1, 2, 3, 1/m. The fourth numbers are zeta_K V lambda,
    /// zeta_K V mu and det F.
    pub rotated: [Vec<[f64; 4]>; 3],
    /// K x* - b at corners 1, 2, 3 of the elements, N.
    pub element_forces: [Vec<[f64; 3]>; 3],
    /// zeta_M m of the nodes, kg/s.
    pub masses: Vec<f64>,
    /// Right-hand side of the components that are not prescribed, N.
    pub rhs: Vec<[f64; 3]>,
    /// Constraint projector per node.
    pub freedom: Vec<Freedom>,
    /// Constraining surfaces per node.
    pub held: Vec<ActiveSurfaces>,
    /// Whether the active-set search has converged.
    pub settled: bool,
    /// Scalar type of all fields but the displacement.
    pub real: Real,
    /// Diagnostics of the last `diagnose`.
    pub report: SolidReport,
}

/// Fields that the stages of the liquid exchange, host layout.
#[derive(Clone, Debug)]
pub struct LiquidSnapshot {
    /// Face apertures and distances of the centres (m), if solids cut the grid in every sub-step.
    pub cut: Option<CutCells>,
    /// Marker positions, m; `None` for deleted markers and reserved slots.
    pub markers: Vec<Option<[f64; 3]>>,
    /// Face velocities, m/s.
    pub velocity: [Vec<f64>; 3],
    /// u*, m/s; defined on the band.
    pub velocity_next: [Vec<f64>; 3],
    /// Faces whose velocity `write_back` computed.
    pub valid: [Vec<bool>; 3],
    /// Liquid distance, m.
    pub liquid_distance: Vec<f64>,
    /// Cells of the narrow band.
    pub band: Vec<bool>,
    /// Faces of the narrow band.
    pub face_band: [Vec<bool>; 3],
    /// Active cells.
    pub active: Vec<bool>,
    /// Active cells of enclosed components, defined after `closed_components`.
    pub closed: Vec<bool>,
    /// Active cells of components that touch nothing, likewise.
    pub ballistic: Vec<bool>,
    /// Separated cells, defined after `solve`; empty without separation.
    pub separated: Vec<bool>,
    /// Cells with liquid in the last solve: active ones, or before the first those with liquid.
    pub filled: Vec<bool>,
    /// Weights of the stored matrix, dimensionless.
    pub weight: [Vec<f64>; 3],
    /// Free-surface terms of the matrix, dimensionless.
    pub dirichlet: Vec<f64>,
    /// Reciprocal of the diagonal; 0 in inactive cells.
    pub inverse_diagonal: Vec<f64>,
    /// Right-hand side, m/s; 0 in inactive cells.
    pub rhs: Vec<f64>,
    /// Potential p dt / (rho dx), m/s; 0 in inactive cells.
    pub potential: Vec<f64>,
    /// Scalar type of the stored right-hand side and potential.
    pub real: Real,
    /// Diagnostics of the sub-step so far.
    pub report: Report,
    /// Fields of the level, if the surface is one.
    pub level: Option<LevelSnapshot>,
}

impl LiquidSnapshot {
    /// Positions (m) and velocities (m/s) of the markers that fly.
    pub fn spray(&self) -> Vec<([f64; 3], [f64; 3])> {
        let Some(level) = &self.level else {
            return Vec::new();
        };
        let slots = self.markers.iter().zip(&level.spray);
        let flying = slots.zip(&level.marker_velocity);
        flying.filter(|((_, spray), _)| **spray).filter_map(|((x, _), &v)| Some(((*x)?, v))).collect()
    }
}

/// Fields that the stages of a level exchange, host layout; one entry per cell but for the markers. They hold on the band.
#[derive(Clone, Debug)]
pub struct LevelSnapshot {
    /// Level after its transport, cells.
    pub carried: Vec<f64>,
    /// Bounds of the level at walls and bodies, cells, minus infinity elsewhere: from `advect_level` to `redistance`. Empty without separation.
    pub separation_bounds: Vec<f64>,
    /// Level after the last stage that changed it, cells.
    pub level: Vec<f64>,
    /// Fraction of the surroundings that markers fill.
    pub occupancy: Vec<f64>,
    /// Density of the markers less that of liquid.
    pub excess: Vec<f64>,
    /// Component of each cell, from 1, 0 for none.
    pub component: Vec<u32>,
    /// Target volume of each component, m^3.
    pub component_volume: Vec<f64>,
    /// Velocity of the markers, m/s, in the slots of [`LiquidSnapshot::markers`].
    pub marker_velocity: Vec<[f64; 3]>,
    /// Whether each is spray.
    pub spray: Vec<bool>,
    /// Spray lost in the sub-step.
    pub lost_spray: u32,
}

impl GpuPath {
    /// Waits for all submitted work and reads all fields.
    pub fn snapshot(&self) -> Result<Snapshot, Error> {
        let liquid = self.liquid.as_ref();
        let liquid = liquid.map(|liquid| liquid.snapshot(&self.gpu, &self.grid));
        let solids = self.solids.as_ref();
        let solids = solids.map(|solids| {
            let prescribed = &solids.solids.prescribed;
            SolidSnapshot::read(&self.gpu, &solids.buffers, &solids.system, prescribed)
        });
        Ok(Snapshot {
            liquid: liquid.transpose()?,
            solids: solids.transpose()?,
            coupling: match &self.coupling {
                Some(coupling) => Some(coupling.read_report(&self.gpu)?),
                None => None,
            },
        })
    }
}

/// Per cell: the bit of its lane in the quad's word, starting at bit `first`.
fn bits(padded: &Padded, words: &[u32], first: usize) -> Vec<bool> {
    let lanes = 0..padded.len();
    lanes.map(|at| words[at / 4] >> (first + at % 4) & 1 == 1).collect()
}

/// The pressure system as stored on the device, host layout. See the fields of the same names in [`LiquidSnapshot`].
#[derive(Clone, Debug)]
pub struct StoredPressure {
    /// Active cells.
    pub active: Vec<bool>,
    /// Active cells of enclosed components.
    pub closed: Vec<bool>,
    /// Active cells of components that touch nothing.
    pub ballistic: Vec<bool>,
    /// Cells with liquid.
    pub filled: Vec<bool>,
    /// Dimensionless.
    pub weight: [Vec<f64>; 3],
    /// Dimensionless.
    pub dirichlet: Vec<f64>,
    /// Dimensionless.
    pub inverse_diagonal: Vec<f64>,
    /// m/s.
    pub rhs: Vec<f64>,
    /// m/s.
    pub potential: Vec<f64>,
}

impl StoredPressure {
    /// Waits for all submitted work and reads the system.
    pub fn read(gpu: &Gpu, grid: &Grid, solver: &SolverBuffers) -> Result<StoredPressure, Error> {
        let padded = grid.padded();
        let cells = |values: &[f64]| padded.unpad(grid.cells, values, |value| value);
        let flags = gpu.download(&solver.flags)?;
        let [active, closed, ballistic, filled] = [0, 4, BALLISTIC, FILLED].map(|first| {
            let lanes = bits(&padded, &flags, first);
            padded.unpad(grid.cells, &lanes, |lane| lane)
        });
        let matrix = solver.matrix.download(gpu)?;
        let section = |s: usize| &matrix[4 * solver.plan.total * s..][..padded.len()];
        // Quads without liquid may contain values of earlier sub-steps.
        let masked = |values: Vec<f64>| {
            let mut values = cells(&values);
            for (value, active) in values.iter_mut().zip(&active) {
                *value = if *active { *value } else { 0.0 };
            }
            values
        };
        Ok(StoredPressure {
            weight: Axis::ALL.map(|axis| padded.unpad(grid.faces(axis), section(axis.index()), |weight| weight)),
            dirichlet: cells(section(3)),
            inverse_diagonal: cells(section(4)),
            rhs: masked(solver.rhs.download(gpu)?),
            potential: masked(solver.potential.download(gpu)?),
            active,
            closed,
            ballistic,
            filled,
        })
    }
}

/// J as stored on a device, and its effective density (kg/m^3), for a sub-step of dt (s). Areas over dx^2 and the
/// mass of a cell over dt are f32 on the device. The dt of such systems must be an f32 too.
pub fn stored_coupling(coupling: &Coupling, dx: f64, density: f64, dt: f64) -> (Coupling, f64) {
    let area = dx * dx;
    let stored = coupling.mapped(|value| area * (value / area).as_vec3().as_dvec3());
    let mass = f64::from((density * dx.powi(3) / dt) as f32);
    (stored, mass * f64::from(dt as f32) / dx.powi(3))
}

/// Assembles the coupled system. `rhs`: E u*, m^3/s, less the flux of prescribed nodes into enclosed components. `separated`: cells
/// that are no unknowns; empty for none.
pub fn coupled_system(
    (active, separated): (ActiveCells, &[bool]),
    rhs: RightHandSide,
    solid: SolidSystem,
    coupling: &Coupling,
    density: f64,
) -> CoupledSystem {
    let mut closed = vec![false; rhs.values.len()];
    let cells = active.closed.iter().flatten();
    cells.for_each(|&cell| closed[cell] = true);
    let pressure = PressureSystem::new(active, rhs, solid.dt(), density).masked(separated);
    CoupledSystem::new(pressure, solid, &coupling.restricted(|cell| !closed[cell]))
}

impl SolidSnapshot {
    /// Walls constrain components, obstacles one direction.
    fn freedom(
        gpu: &Gpu,
        buffers: &SolidBuffers,
        prescribed: &[[bool; 3]],
    ) -> Result<(Vec<Freedom>, Vec<ActiveSurfaces>), Error> {
        let words = gpu.download(&buffers.freedom)?;
        let nodes = prescribed.iter().zip(words);
        Ok(nodes
            .map(|(&prescribed, [x, y, z, flags])| {
                let components = [0, 1, 2].map(|axis| flags as u32 >> axis & 1 == 1);
                let direction = DVec3::new(x.into(), y.into(), z.into()).normalize_or_zero();
                let held = ActiveSurfaces {
                    walls: [0, 1, 2].map(|axis| !prescribed[axis] && !components[axis]),
                    obstacle: direction != DVec3::ZERO,
                };
                (Freedom::left(prescribed, components, direction), held)
            })
            .collect())
    }

    /// Waits for all submitted work and reads all fields. `prescribed`: components of the nodes.
    pub fn read(
        gpu: &Gpu,
        buffers: &SolidBuffers,
        system: &SolidSystemBuffers,
        prescribed: &[[bool; 3]],
    ) -> Result<SolidSnapshot, Error> {
        let (freedom, held) = SolidSnapshot::freedom(gpu, buffers, prescribed)?;
        let mut state = State::default();
        buffers.read_state(gpu, &mut state)?;
        let (n, m) = (buffers.plan.n_nodes, buffers.plan.n_elements);
        let three = |values: &[f64]| -> Vec<[f64; 3]> {
            let (quads, _) = values.as_chunks::<4>();
            quads.iter().map(|&[x, y, z, _]| [x, y, z]).collect()
        };
        let rotated = buffers.rotated.download(gpu)?;
        let forces = buffers.element_forces.download(gpu)?;
        let section = |values: &[f64], s: usize| values[4 * m * s..][..4 * m].to_vec();
        let mut prescribed = vec![[0.0; 3]; n];
        if buffers.plan.scripts {
            let words = gpu.download(&buffers.prescribed)?;
            prescribed = words.iter().map(|&[x, y, z, _]| [x, y, z].map(f64::from)).collect();
        }
        Ok(SolidSnapshot {
            displacement: state.displacement,
            velocity: state.node_velocity,
            ballistic: gpu.download(&buffers.ballistic)?.iter().map(|&falls| falls != 0).collect(),
            prescribed,
            rotated: [0, 1, 2].map(|s| section(&rotated, s).as_chunks::<4>().0.to_vec()),
            element_forces: [0, 1, 2].map(|s| three(&section(&forces, s))),
            masses: system.masses.download(gpu)?[..n].to_vec(),
            rhs: three(&system.rhs.download(gpu)?[..4 * n]),
            freedom,
            held,
            settled: gpu.download(&buffers.answer)?[..2] == [0, 0],
            real: buffers.plan.real,
            report: SolidReport::from_words(&gpu.download(&buffers.report)?),
        })
    }
}

impl GpuLiquid {
    fn snapshot(&self, gpu: &Gpu, grid: &Grid) -> Result<LiquidSnapshot, Error> {
        let GpuLiquid { buffers: liquid, solver, .. } = self;
        let padded = grid.padded();
        let on_cells = |lanes: &[bool]| padded.unpad(grid.cells, lanes, |lane| lane);
        let words = gpu.download(&liquid.valid)?;
        let band_words = gpu.download(&liquid.band_flags)?;
        let band: Vec<bool> = (0..padded.len()).map(|at| band_words[at / 4] != 0).collect();
        let valid = Axis::ALL.map(|axis| {
            let lanes = bits(&padded, &words, 4 * axis.index());
            padded.unpad(grid.faces(axis), &lanes, |valid| valid)
        });
        let stored = StoredPressure::read(gpu, grid, solver)?;
        let used = match &self.level {
            // With the seeds of the sub-step.
            Some(level) => gpu.download(&level.marker_args)?[3] as usize,
            None => self.n_slots(),
        };
        let markers = match &liquid.markers {
            None => Vec::new(),
            Some(markers) => gpu.download(markers)?[..used]
                .iter()
                .map(|&[x, y, z, alive]| (alive != 0.0).then(|| [x, y, z].map(f64::from)))
                .collect(),
        };
        let n_slots = markers.len();
        let distance = gpu.download(&liquid.liquid_distance)?;
        let cut = || -> Result<CutCells, Error> {
            let distance = gpu.download(&liquid.obstacles.solid_distance)?;
            Ok(CutCells {
                open: liquid.read_faces(gpu, &liquid.open)?,
                solid_distance: padded.unpad(grid.cells, &distance, f64::from),
            })
        };
        Ok(LiquidSnapshot {
            cut: liquid.plan.effects.clips().then(cut).transpose()?,
            markers,
            velocity: liquid.read_faces(gpu, &liquid.velocity)?,
            velocity_next: liquid.read_faces(gpu, &liquid.velocity_next)?,
            valid,
            liquid_distance: padded.unpad(grid.cells, &distance, f64::from),
            face_band: Axis::ALL.map(|axis| padded.unpad(grid.faces(axis), &band, |band| band)),
            band: on_cells(&band),
            active: stored.active,
            closed: stored.closed,
            ballistic: stored.ballistic,
            separated: liquid.read_separated(gpu)?,
            filled: stored.filled,
            weight: stored.weight,
            dirichlet: stored.dirichlet,
            inverse_diagonal: stored.inverse_diagonal,
            rhs: stored.rhs,
            potential: stored.potential,
            real: solver.rhs.real,
            report: Report::from_words(&gpu.download(&liquid.report)?),
            level: match &self.level {
                Some(level) => Some(LevelSnapshot::read(gpu, grid, level, n_slots)?),
                None => None,
            },
        })
    }
}

/// Word of the lost spray among the numbers of markers, as in `shaders/common/marker_counts.wgsl`.
const LOST_SPRAY: usize = 1;

impl LevelSnapshot {
    fn read(gpu: &Gpu, grid: &Grid, level: &LevelBuffers, n_slots: usize) -> Result<LevelSnapshot, Error> {
        let cells = |field: &Buffer<f32>| {
            let values = gpu.download(field)?;
            Ok::<_, Error>(grid.padded().unpad(grid.cells, &values, f64::from))
        };
        // NO_BOUND in `shaders/common/level_values.wgsl`.
        let or_none = |bound: f32| if bound <= -1e30 { f64::NEG_INFINITY } else { bound.into() };
        let mut state = State::default();
        level.read_components(gpu, &mut state)?;
        let velocity = gpu.download(&level.marker_velocity)?;
        let velocity = &velocity[..n_slots];
        Ok(LevelSnapshot {
            carried: cells(&level.carried_level)?,
            separation_bounds: match level.read_separation_bounds(gpu)? {
                Some(bounds) => grid.padded().unpad(grid.cells, &bounds, or_none),
                None => Vec::new(),
            },
            level: cells(&level.new_level)?,
            occupancy: cells(&level.occupancy)?,
            excess: cells(&level.excess)?,
            component: state.component,
            component_volume: state.component_volume,
            marker_velocity: velocity.iter().map(|&[x, y, z, _]| [x, y, z].map(f64::from)).collect(),
            spray: velocity.iter().map(|v| v[3] != 0.0).collect(),
            lost_spray: gpu.download(&level.marker_counts)?[LOST_SPRAY],
        })
    }
}

impl SolidSnapshot {
    /// The solids as stored on the device: rest positions and masses in f32, other numbers in its scalar type.
    pub fn on_device(&self, solids: &Solids) -> Solids {
        let single = |x: f64| f64::from(x as f32);
        let round = |x: f64| match self.real {
            Real::F32 => single(x),
            Real::F64 => x,
        };
        let rounded = |x: &DVec3| DVec3::from(x.to_array().map(round));
        let mut device = solids.clone();
        for (rest, mass) in device.rest.iter_mut().zip(&mut device.mass) {
            *rest = rest.as_vec3().as_dvec3();
            *mass = single(*mass);
        }
        for gradients in &mut device.gradients {
            let [_, a, b, c] = *gradients;
            let [a, b, c] = [a, b, c].map(|g| rounded(&g));
            *gradients = [-(a + b + c), a, b, c];
        }
        for volume in &mut device.volume {
            *volume = round(*volume);
        }
        self.round_load(&mut device);
        for body in &mut device.bodies {
            body.lambda = round(body.lambda);
            body.mu = round(body.mu);
            body.mass_damping = round(body.mass_damping);
            body.stiffness_damping = single(body.stiffness_damping);
        }
        device
    }

    /// Rounds the loads of solids as on the device.
    pub fn round_load(&self, solids: &mut Solids) {
        if self.real == Real::F32 {
            for load in &mut solids.load {
                *load = load.as_vec3().as_dvec3();
            }
        }
    }

    /// A deformation with the device's rotation of the element's gradients. `solids` from
    /// [`on_device`](Self::on_device).
    pub fn turned(&self, solids: &Solids, element: usize, gradient: DMat3) -> Deformation {
        let [_, a, b, c] = solids.gradients[element];
        let turned = self.rotated.each_ref().map(|section| {
            let [x, y, z, _] = section[element];
            DVec3::new(x, y, z)
        });
        let columns = |[a, b, c]: [DVec3; 3]| DMat3::from_cols(a, b, c);
        let rotation = columns(turned) * columns([a, b, c]).inverse();
        let back = rotation.transpose() * (gradient + (DMat3::IDENTITY - rotation));
        Deformation { gradient, rotation, strain: 0.5 * (back + back.transpose()) }
    }

    /// The stored system of a sub-step of dt (s, an f32): rotated gradients, moduli and right-hand side in the
    /// device's scalar type. `solids` from [`on_device`](Self::on_device).
    pub fn system(&self, solids: &Solids, pattern: &Arc<BlockPattern>, dt: f64) -> SolidSystem {
        let stiffness = BlockMatrix::assemble(solids, pattern, |element, a, b| {
            let turned = |corner: usize| -> DVec3 {
                let at = |section: usize| {
                    let [x, y, z, _] = self.rotated[section][element];
                    DVec3::new(x, y, z)
                };
                match corner {
                    0 => -(at(0) + at(1) + at(2)),
                    corner => at(corner - 1),
                }
            };
            let zeta = solids.body_of_element(element).zeta_stiffness(dt);
            let [lambda, mu] = [0, 1].map(|section| self.rotated[section][element][3] / zeta);
            stiffness_block(turned(a), turned(b), lambda, mu)
        });
        let rhs = SolidRightHandSide { values: self.rhs.clone(), scale: 0.0 };
        let freedom = self.freedom.clone();
        SolidSystem::new(solids, stiffness, &rhs, &self.velocity, freedom, dt)
    }
}

impl LiquidSnapshot {
    /// The stored matrix, with the enclosed components that the f64 path computes from it.
    pub fn active_cells(&self, grid: &Grid) -> ActiveCells {
        ActiveCells::new(Stencil::new(*grid, self.weight.clone(), self.dirichlet.clone()))
    }
}
