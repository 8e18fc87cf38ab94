//! Nodes and elements of all solids on the device.

use crate::Error;
use crate::arrays;
use crate::elastic::{Pivot, RotatingBody, Solids};
use crate::geometry::ContactField;
use crate::gpu::{Gpu, Real, WG_SIZE};
use crate::grid::{Grid, Layout};
use crate::scene::ElasticModel;
use crate::state::State;

use super::SolidReport;

/// Parameters of a sub-step.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct SolidStep {
    /// Gravity, m/s^2.
    pub gravity: [f32; 3],
    /// Length of the sub-step, s.
    pub dt: f32,
    /// Size of the domain, m.
    pub size: [f32; 3],
    /// Cell width, m.
    pub dx: f32,
    /// Inverse of the cell width, 1/m.
    pub inv_dx: f32,
    /// Number of nodes.
    pub n_nodes: u32,
    /// Number of elements.
    pub n_elements: u32,
    /// Zero at run time, so that the shader compiler cannot reassociate the double-f32 arithmetic of
    /// `shaders/common/pair_f32.wgsl`.
    pub zero: u32,
    /// 1, or 0 in a system without elasticity and loads. Factor of dt in zeta_K and of all forces but inertia.
    pub elastic: f32,
    /// 1, or 0 in a system without damping. Factor of tau_M in zeta_M and of tau_K in zeta_K.
    pub damped: f32,
    /// Padding.
    pub pad_0: u32,
    /// Padding.
    pub pad_1: u32,
}

/// Sizes of [`SolidBuffers`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SolidPlan {
    /// The grid: domain walls, and layout of the distance to obstacles.
    pub grid: Grid,
    /// Nodes of all solids.
    pub n_nodes: usize,
    /// Elements of all solids.
    pub n_elements: usize,
    /// Free and hinged bodies, whose nodes move on circles.
    pub n_turning: usize,
    /// Bodies without constraints and loads, which may be ballistic.
    pub n_free: usize,
    /// Whether any prescribed node moves.
    pub scripts: bool,
    /// Whether there are obstacles.
    pub obstacles: bool,
    /// Moving obstacles.
    pub n_moving: usize,
    /// The scalar type of velocities, element data and sums.
    pub real: Real,
}

impl SolidPlan {
    /// Sizes of solids without scripts and obstacles.
    pub fn new(grid: Grid, solids: &Solids, real: Real) -> SolidPlan {
        SolidPlan {
            grid,
            n_nodes: solids.rest.len(),
            n_elements: solids.elements.len(),
            n_turning: solids.rotating_bodies().count(),
            n_free: solids.free_bodies().count(),
            scripts: false,
            obstacles: false,
            n_moving: 0,
            real,
        }
    }

    /// Entries of [`SolidBuffers::gaps`].
    fn n_gaps(&self) -> usize {
        (1 + usize::from(self.obstacles) + usize::from(self.n_moving > 0)) * self.n_nodes
    }

    /// Threads of a reduction: enough for a large device, fewer for small solids. Each sums its own share of nodes
    /// and elements.
    pub fn n_summing(&self) -> usize {
        ((self.n_nodes + self.n_elements) / 8)
            .next_multiple_of(WG_SIZE as usize)
            .clamp(WG_SIZE as usize, LARGEST_SUMMING)
    }
}

/// Replaces the nodes of a hinge for a body that rotates about its centroid. Also in `turn_solids.wgsl`.
const FREE: u32 = u32::MAX;
/// Largest number of threads of a reduction.
const LARGEST_SUMMING: usize = 16384;
/// Words of [`SolidBuffers::extremes`].
const EXTREMES: usize = 4;

arrays! {
    /// Nodes and elements of all solids: n nodes, m elements. An array of several sections stores one section of all
    /// nodes or elements after another. `Real4` is four numbers of type [`SolidPlan::real`].
    pub struct SolidBuffers in "solid" {
        fields {
            /// Sizes.
            pub plan: SolidPlan,
        }
        arrays {
            /// Parameters of the sub-step.
            pub uniform step: SolidStep [bytemuck::Zeroable::zeroed()],
            /// Layout of the distance to obstacles.
            pub uniform level: Layout [plan.grid.padded().layout()] if plan.obstacles,
            /// Per node: rest position, m, and lumped mass, kg.
            pub array rest: [f32; 4] [plan.n_nodes],
            /// Displacement from rest, m, as the sum of two f32: the larger part of all nodes, then the smaller.
            pub array displacement: [f32; 4] [2 * plan.n_nodes],
            /// `Real4` per node: velocity, m/s; v* before the solve, v after it.
            pub real velocity: (plan.real) [4 * plan.n_nodes],
            /// Per node: bits 0, 1, 2 are set where x, y, z is free. Padded with zeros to a multiple of four.
            pub array flags: u32 [plan.n_nodes.next_multiple_of(4)],
            /// Per node: distances from the nearer walls, m, and bits that name these walls. With obstacles a second
            /// section contains unit normals and distances, with moving ones a third their rates (`shaders/common/contact.wgsl`).
            pub array gaps: [f32; 4] [plan.n_gaps()],
            /// Per cell, device layout: number of the nearest moving obstacle, from 1, or 0 ([`ContactField`]).
            pub array obstacle_of_cell: u32 [plan.grid.padded().len()] if plan.n_moving > 0,
            /// Per moving obstacle, three entries: velocity of its centre (m/s), angular velocity (rad/s), centre (m).
            pub array obstacle_motions: [f32; 4] [3 * plan.n_moving] if plan.n_moving > 0,
            /// Per node: constraint projector of this sub-step (`shaders/common/freedom.wgsl`).
            pub array freedom: [f32; 4] [plan.n_nodes],
            /// Query of the active-set search and its result (`shaders/common/ask.wgsl`). After a sub-step the first
            /// word is the number of contacts whose state would change.
            pub array answer: u32 [3],
            /// Per element: its nodes.
            pub array elements: [u32; 4] [plan.n_elements],
            /// `Real4`, three sections: rest gradients of the shape functions of corners 1, 2, 3, 1/m. The fourth
            /// numbers are the rest volume (m^3), lambda and mu (Pa). The gradient of corner 0 is minus the sum.
            pub real rest_gradients: (plan.real) [12 * plan.n_elements],
            /// Per element: tau_K, s, and 1 for the linear model, else 0.
            pub array damping: [f32; 2] [plan.n_elements],
            /// `Real4`, three sections: the rotated gradients, 1/m. The fourth numbers are zeta_K V lambda, zeta_K V
            /// mu (s Pa m^3), and the determinant of the deformation gradient.
            pub real rotated: (plan.real) [12 * plan.n_elements],
            /// `Real4`, three sections: K x* - b of the element at corners 1, 2, 3, N; corner 0 is minus the sum. The
            /// fourth number of the first section is the elastic energy, J; the others are zero.
            pub real element_forces: (plan.real) [12 * plan.n_elements],
            /// `Real4` per node: constant force, N, and tau_M, 1/s.
            pub real load: (plan.real) [4 * plan.n_nodes],
            /// Per node: velocity of prescribed components in this sub-step, m/s. Without scripts a single zero
            /// element.
            pub array prescribed: [f32; 4] [if plan.scripts { plan.n_nodes } else { 1 }],
            /// Partial sums of a reduction: three sections of `Real4`.
            pub real partials: (plan.real) [12 * plan.n_summing()],
            /// Largest speed, least determinant, number of inverted elements, closing rate (`shaders/measure_solid.wgsl`).
            pub array extremes: u32 [EXTREMES],
            /// Diagnostics that the host reads back once per step: see [`SolidReport`].
            pub array report: u32 [SolidReport::WORDS],
            /// Per body without constraints and loads: its range of nodes.
            pub array free_bodies: [u32; 4] [plan.n_free] if plan.n_free > 0,
            /// Per node: 1 in bodies that touch nothing in this sub-step, else 0.
            pub array ballistic: u32 [plan.n_nodes],
            /// Per rotating body: its range of nodes, and two nodes of its hinge; or all bits set, and the axis of its rollers or all bits set.
            pub array turning: [u32; 4] [plan.n_turning] if plan.n_turning > 0,
        }
        views {}
        parts {}
    }
}

impl SolidBuffers {
    /// Allocates all arrays and writes those that never change.
    ///
    /// # Panics
    /// When the solids differ from `plan`.
    pub fn new(gpu: &Gpu, plan: SolidPlan, solids: &Solids) -> Result<SolidBuffers, Error> {
        assert_eq!(
            (solids.rest.len(), solids.elements.len(), solids.rotating_bodies().count(), solids.free_bodies().count()),
            (plan.n_nodes, plan.n_elements, plan.n_turning, plan.n_free),
            "nodes, elements, turning and free bodies of the plan"
        );
        let buffers = SolidBuffers::allocate(gpu, plan)?;
        if !gpu.is_planning() {
            buffers.write_nodes(gpu, solids);
            buffers.write_elements(gpu, solids);
        }
        Ok(buffers)
    }

    /// Writes the motions of the moving obstacles, before all work submitted later.
    pub fn write_motions(&self, gpu: &Gpu, field: &ContactField) {
        let Some((cells, motions)) = self.obstacle_of_cell.as_ref().zip(self.obstacle_motions.as_ref()) else {
            return;
        };
        let padded = self.plan.grid.padded();
        let numbers = padded.pad(field.grid.cells, &field.nearest, |number| number);
        gpu.upload(cells, &numbers);
        let parts = field.motions.iter();
        let parts = parts.flat_map(|motion| [motion.velocity, motion.spin, motion.centre]);
        let words = parts.map(|part| part.extend(0.0).as_vec4().to_array());
        gpu.upload(motions, &words.collect::<Vec<_>>());
    }

    fn write_nodes(&self, gpu: &Gpu, solids: &Solids) {
        let rest: Vec<[f32; 4]> =
            solids.rest.iter().zip(&solids.mass).map(|(x, &mass)| x.extend(mass).as_vec4().to_array()).collect();
        gpu.upload(&self.rest, &rest);
        if let Some(turning) = &self.turning {
            let bodies = solids.rotating_bodies();
            let bodies = bodies.map(|RotatingBody { nodes, pivot }| {
                let [a, b] = match pivot {
                    Pivot::Centroid => [FREE; 2],
                    Pivot::Axis(axis) => [FREE, axis as u32],
                    Pivot::Hinge(hinge) => hinge.map(|node| node as u32),
                };
                [nodes.start as u32, nodes.end as u32, a, b]
            });
            gpu.upload(turning, &bodies.collect::<Vec<_>>());
        }
        if let Some(bodies) = &self.free_bodies {
            let nodes = solids.free_bodies().map(|(_, nodes)| nodes);
            let ranges = nodes.map(|nodes| [nodes.start as u32, nodes.end as u32, 0, 0]);
            gpu.upload(bodies, &ranges.collect::<Vec<_>>());
        }
        let free = |[x, y, z]: &[bool; 3]| u32::from(!x) | u32::from(!y) << 1 | u32::from(!z) << 2;
        let flags: Vec<u32> = solids.prescribed.iter().map(free).collect();
        gpu.upload(&self.flags, &flags);
        self.write_load(gpu, solids);
    }

    /// Writes the forces on the nodes, before all work submitted later.
    pub fn write_load(&self, gpu: &Gpu, solids: &Solids) {
        let mut load = vec![0.0; 4 * self.plan.n_nodes];
        for body in &solids.bodies {
            for node in body.nodes.clone() {
                let force = solids.load[node].extend(body.mass_damping);
                load[4 * node..][..4].copy_from_slice(&force.to_array());
            }
        }
        self.load.upload(gpu, &load);
    }

    fn write_elements(&self, gpu: &Gpu, solids: &Solids) {
        gpu.upload(&self.elements, &solids.elements);
        let m = self.plan.n_elements;
        let mut gradients = vec![0.0; 12 * m];
        let mut damping = vec![[0.0; 2]; m];
        for body in &solids.bodies {
            let linear = body.model == ElasticModel::Linear;
            for element in body.elements.clone() {
                let fourth = [solids.volume[element], body.lambda, body.mu];
                for (section, fourth) in fourth.into_iter().enumerate() {
                    let gradient = solids.gradients[element][section + 1].extend(fourth);
                    let start = 4 * (section * m + element);
                    gradients[start..][..4].copy_from_slice(&gradient.to_array());
                }
                damping[element] = [body.stiffness_damping as f32, f32::from(u8::from(linear))];
            }
        }
        self.rest_gradients.upload(gpu, &gradients);
        gpu.upload(&self.damping, &damping);
    }

    /// Parameters of a sub-step of dt (s) under gravity (m/s^2).
    pub fn step_of(&self, gravity: glam::DVec3, dt: f64) -> SolidStep {
        let grid = &self.plan.grid;
        SolidStep {
            gravity: gravity.as_vec3().to_array(),
            dt: dt as f32,
            size: grid.size().as_vec3().to_array(),
            dx: grid.dx as f32,
            inv_dx: (1.0 / grid.dx) as f32,
            n_nodes: self.plan.n_nodes as u32,
            n_elements: self.plan.n_elements as u32,
            zero: 0,
            elastic: 1.0,
            damped: 1.0,
            pad_0: 0,
            pad_1: 0,
        }
    }

    /// Writes the velocities (m/s) of prescribed components for the next sub-step, one entry per node. Entries of
    /// free components are ignored. Does nothing without scripts.
    ///
    /// # Panics
    /// When there are scripts and the number of nodes differs.
    pub fn write_prescribed(&self, gpu: &Gpu, velocities: &[[f64; 3]]) {
        if self.plan.scripts {
            assert_eq!(velocities.len(), self.plan.n_nodes, "prescribed velocities");
            let words: Vec<[f32; 4]> =
                velocities.iter().map(|v| [v[0] as f32, v[1] as f32, v[2] as f32, 0.0]).collect();
            gpu.upload(&self.prescribed, &words);
        }
    }

    /// Writes displacements and velocities of a state, before all work submitted later. A state from
    /// [`SolidBuffers::read_state`] is restored exactly, except for digits of the smaller parts beyond the precision
    /// of f64. [`Carried`](crate::state::Carried) stores those.
    ///
    /// # Panics
    /// When the state has another number of nodes.
    pub fn write_state(&self, gpu: &Gpu, state: &State) {
        let n = self.plan.n_nodes;
        assert_eq!((state.displacement.len(), state.node_velocity.len()), (n, n), "nodes of the state");
        let mut displacement = vec![[0.0; 4]; 2 * n];
        for (node, u) in state.displacement.iter().enumerate() {
            for (axis, &u) in u.iter().enumerate() {
                let high = u as f32;
                displacement[node][axis] = high;
                displacement[n + node][axis] = (u - f64::from(high)) as f32;
            }
        }
        gpu.upload(&self.displacement, &displacement);
        self.write_velocity(gpu, &state.node_velocity);
    }

    /// Writes the velocities of all nodes, m/s, before all work submitted later.
    pub fn write_velocity(&self, gpu: &Gpu, velocity: &[[f64; 3]]) {
        let nodes = velocity.iter();
        let words: Vec<f64> = nodes.flat_map(|&[x, y, z]| [x, y, z, 0.0]).collect();
        self.velocity.upload(gpu, &words);
    }

    /// Waits for all submitted work and reads displacements and velocities into a state. Displacements are rounded to
    /// f64; velocities are exact.
    pub fn read_state(&self, gpu: &Gpu, state: &mut State) -> Result<(), Error> {
        let displacement = gpu.download(&self.displacement)?;
        state.displacement = self.displacement_of(&displacement);
        let velocity = self.velocity.download(gpu)?;
        state.node_velocity = velocity.chunks_exact(4).map(|v| [v[0], v[1], v[2]]).collect();
        Ok(())
    }

    /// Displacements, m, from the contents of `displacement`.
    pub fn displacement_of(&self, displacement: &[[f32; 4]]) -> Vec<[f64; 3]> {
        let (high, low) = displacement.split_at(self.plan.n_nodes);
        let nodes = high.iter().zip(low);
        nodes.map(|(high, low)| std::array::from_fn(|axis| f64::from(high[axis]) + f64::from(low[axis]))).collect()
    }
}
