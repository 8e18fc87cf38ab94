//! The base scene: the base block with a beam that hangs into its liquid, on which coupled solvers are compared.
//!
//! The beam is \[0.43, 0.51\] x \[0.47, 0.55\] x \[0.24, 0.80\] m at rest, fixed at its top and bent by half a
//! radian: with
//! s = 0.8 - Z, th = 0.5 s / 0.56, k = 0.5 / 0.56, xi = X - 0.47,
//!
//! ```text
//! x = 0.47 + (1 - cos th) / k + xi cos th,  y = Y + 0.02 sin 3s,  z = 0.8 - sin(th) / k + xi sin th
//! v* = (0.3 sin 3z, 0.2 cos 4x, 0.1 sin 2y + g dt)
//! ```
//!
//! The liquid distance ignores the beam.

use std::sync::Arc;

use glam::DVec3;

use super::active_cells::active_cells;
use super::base_block::{BaseBlock, DENSITY, DT, GRAVITY, THETA_FLOOR};
use super::coupled_system::CoupledSystem;
use super::pressure_system::PressureSystem;
use super::right_hand_side::right_hand_side;
use super::solid_contacts::Freedom;
use super::solid_matrices::{BlockPattern, SolidMatrices, solid_matrices};
use super::solid_right_hand_side::solid_right_hand_side;
use super::solid_system::SolidSystem;
use crate::Error;
use crate::elastic::Solids;
use crate::geometry::{ObstacleCut, SolidClip, TetMesh};
use crate::scene::{ElasticModel, Initial, Pin, Placement, Shape, Solid, SolidMesh, Solver};

/// The beam and the step. The default is the base scene's own, with the coarsest beam.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BaseBeam {
    /// Bricks across, across and along. \[2, 2, 14\], \[3, 3, 21\] and \[4, 4, 28\] result in the thesis's 135, 352
    /// and 725 nodes.
    pub bricks: [usize; 3],
    /// Density, kg/m^3.
    pub density: f64,
    /// Young's modulus, Pa.
    pub young: f64,
    /// Poisson's ratio.
    pub poisson: f64,
    /// tau_M, 1/s.
    pub mass_damping: f64,
    /// tau_K, s.
    pub stiffness_damping: f64,
    /// Length of the step, s.
    pub dt: f64,
}

impl Default for BaseBeam {
    fn default() -> BaseBeam {
        BaseBeam {
            bricks: [2, 2, 14],
            density: 1100.0,
            young: 1e6,
            poisson: 0.4,
            mass_damping: 0.0,
            stiffness_damping: 0.0,
            dt: DT,
        }
    }
}

/// The base scene at n^3 cells.
pub struct BaseScene {
    /// Grid, liquid distance and u*.
    pub block: BaseBlock,
    /// The beam.
    pub solids: Solids,
    /// Displacement from rest, m.
    pub displacement: Vec<[f64; 3]>,
    /// v*, m/s; 0 at prescribed nodes.
    pub node_velocity: Vec<[f64; 3]>,
    /// Length of the step, s.
    pub dt: f64,
}

impl BaseScene {
    /// The scene with a beam.
    ///
    /// # Errors
    /// When the number of bricks or the material is invalid.
    pub fn new(n: usize, beam: &BaseBeam) -> Result<BaseScene, Error> {
        let (low, high) = (DVec3::new(0.43, 0.47, 0.24), DVec3::new(0.51, 0.55, 0.80));
        let solid = Solid {
            name: "beam".to_owned(),
            mesh: SolidMesh::Box { size: high - low, cells: beam.bricks },
            placement: Placement { translate: 0.5 * (low + high), ..Placement::default() },
            stretch: DVec3::ONE,
            initial: Initial::default(),
            density: beam.density,
            young: beam.young,
            poisson: beam.poisson,
            model: ElasticModel::Corotational,
            mass_damping: beam.mass_damping,
            stiffness_damping: beam.stiffness_damping,
            friction: 0.0,
            contact: true,
            no_contact_with: Vec::new(),
            self_contact: false,
            pins: vec![Pin {
                region: Shape::Box { min: low.with_z(high.z), max: high },
                components: [true; 3],
                keyframes: Vec::new(),
                pivot: None,
            }],
            loads: Vec::new(),
        };
        let mesh = TetMesh::new(&solid, "base scene")?;
        let solids = Solids::from_solids(&[solid], &[mesh], &|key| format!("base scene: {key}"))?;
        let bent = solids.rest.iter().map(|&rest| bent(rest));
        let displacement = bent.zip(&solids.rest).map(|(x, rest)| (x - rest).to_array());
        let displacement: Vec<[f64; 3]> = displacement.collect();
        let nodes = displacement.iter().zip(&solids.rest).zip(&solids.prescribed);
        let velocity = nodes.map(|((&u, &rest), prescribed)| {
            let x = rest + DVec3::from(u);
            let v = [0.3 * (3.0 * x.z).sin(), 0.2 * (4.0 * x.x).cos(), 0.1 * (2.0 * x.y).sin() + GRAVITY * beam.dt];
            std::array::from_fn(|axis| if prescribed[axis] { 0.0 } else { v[axis] })
        });
        Ok(BaseScene {
            block: BaseBlock::with_step(n, beam.dt),
            node_velocity: velocity.collect(),
            displacement,
            solids,
            dt: beam.dt,
        })
    }

    /// Clipping of the beam.
    pub fn clip(&self) -> SolidClip {
        let grid = &self.block.grid;
        let mut clip = SolidClip::new(grid, ObstacleCut::none(grid), &Solver::default());
        clip.clip(&self.solids.moved(&self.displacement));
        clip
    }

    /// Element matrices of the beam.
    pub fn matrices(&self) -> SolidMatrices {
        let pattern = Arc::new(BlockPattern::new(&self.solids));
        solid_matrices(&self.solids, &pattern, &self.displacement)
    }

    /// B and E u* of the liquid around the beam.
    pub fn pressure_system(&self, clip: &SolidClip) -> PressureSystem {
        let (block, open) = (&self.block, &clip.cut_cells().open);
        let mut active = active_cells(&block.grid, open, &block.liquid_distance, THETA_FLOOR);
        active.seal(clip.coupling(), &self.solids.prescribed);
        let rhs = right_hand_side(&block.grid, open, &block.velocity, &active, None);
        PressureSystem::new(active, rhs, self.dt, DENSITY)
    }

    /// S and -w of the beam.
    pub fn solid_system(&self, matrices: &SolidMatrices) -> SolidSystem {
        let (solids, velocity) = (&self.solids, &self.node_velocity);
        let rhs = solid_right_hand_side(solids, matrices, velocity, self.dt);
        let (freedom, stiffness) = (Freedom::all(solids), matrices.stiffness.clone());
        SolidSystem::new(solids, stiffness, &rhs, velocity, freedom, self.dt)
    }

    /// The coupled system.
    pub fn coupled_system(&self) -> CoupledSystem {
        let clip = self.clip();
        let solid = self.solid_system(&self.matrices());
        CoupledSystem::new(self.pressure_system(&clip), solid, clip.coupling())
    }
}

/// Position of a rest point in the bent beam.
fn bent(rest: DVec3) -> DVec3 {
    let s = 0.8 - rest.z;
    let (angle, curvature, across) = (0.5 * s / 0.56, 0.5 / 0.56, rest.x - 0.47);
    DVec3::new(
        0.47 + (1.0 - angle.cos()) / curvature + across * angle.cos(),
        rest.y + 0.02 * (3.0 * s).sin(),
        0.8 - angle.sin() / curvature + across * angle.sin(),
    )
}
