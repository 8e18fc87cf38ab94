//! The nodes and elements of all solids on the device.

use crate::Error;
use crate::elastic::{Solids, Turning};
use crate::gpu::{Buffer, BufferPlan, Gpu, Real, RealBuffer, WG_SIZE};
use crate::grid::{Grid, Layout};
use crate::scene::ElasticModel;
use crate::solver::SolidFields;
use crate::state::State;

use super::SolidReport;
use super::buffers::Maker;

/// What a sub-step knows of the solids: the doppelganger of `SolidStep` in `shaders/common/solid_step.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct SolidStep {
    /// m/s^2
    pub gravity: [f32; 3],
    /// s
    pub dt: f32,
    /// Size of the domain, m.
    pub size: [f32; 3],
    /// m
    pub dx: f32,
    /// 1/m
    pub inv_dx: f32,
    /// Nodes.
    pub n_nodes: u32,
    /// Elements.
    pub n_elements: u32,
    /// Zero, which no compiler of shaders knows: `shaders/common/pair_f32.wgsl` keeps roundings with it.
    pub zero: u32,
    /// 1, or 0 in a system without elasticity and loads: share of dt in zeta_K, and of all forces but inertia.
    pub elastic: f32,
    /// 1, or 0 in a system without damping: share of tau_M in zeta_M and of tau_K in zeta_K.
    pub damped: f32,
    /// Nothing.
    pub pad_0: u32,
    /// Nothing.
    pub pad_1: u32,
}

/// What decides the sizes of [`SolidBuffers`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SolidPlan {
    /// The grid: its walls and the layout of the obstacles' distance.
    pub grid: Grid,
    /// Nodes of all solids.
    pub n_nodes: usize,
    /// Their elements.
    pub n_elements: usize,
    /// Bodies that move on circles where they turn.
    pub n_turning: usize,
    /// Whether prescribed nodes move.
    pub scripts: bool,
    /// Whether there are obstacles.
    pub obstacles: bool,
    /// The scalar type of velocities, element data and sums.
    pub real: Real,
}

impl SolidPlan {
    /// The uniforms that [`SolidBuffers::new`] allocates, and the read-back of the report.
    pub fn small_buffers(&self) -> Vec<BufferPlan> {
        let mut plans = vec![
            BufferPlan::of::<SolidStep>("solid.step", 1),
            BufferPlan::of::<u32>("solid.report (read-back)", SolidReport::WORDS),
            BufferPlan::of::<u32>("solid.answer (read-back)", 3),
        ];
        if self.obstacles {
            plans.push(BufferPlan::of::<Layout>("solid.level", 1));
        }
        plans
    }

    /// All buffers that [`SolidBuffers::new`] allocates, uniforms aside.
    pub fn buffers(&self) -> Vec<BufferPlan> {
        let (n, m) = (self.n_nodes, self.n_elements);
        let prescribed = if self.scripts { n } else { 1 };
        let surfaces = if self.obstacles { 2 } else { 1 };
        let mut plans = vec![
            BufferPlan::of::<[f32; 4]>("solid.rest", n),
            BufferPlan::of::<[f32; 4]>("solid.displacement", 2 * n),
            RealBuffer::plan("solid.velocity", 4 * n, self.real),
            BufferPlan::of::<u32>("solid.flags", n.next_multiple_of(4)),
            BufferPlan::of::<[f32; 4]>("solid.gaps", surfaces * n),
            BufferPlan::of::<[f32; 4]>("solid.freedom", n),
            BufferPlan::of::<u32>("solid.answer", 3),
            BufferPlan::of::<[u32; 4]>("solid.elements", m),
            RealBuffer::plan("solid.rest_gradients", 12 * m, self.real),
            BufferPlan::of::<[f32; 2]>("solid.damping", m),
            RealBuffer::plan("solid.rotated", 12 * m, self.real),
            RealBuffer::plan("solid.element_forces", 12 * m, self.real),
            RealBuffer::plan("solid.load", 4 * n, self.real),
            BufferPlan::of::<[f32; 4]>("solid.prescribed", prescribed),
            RealBuffer::plan("solid.partials", 12 * self.n_summing(), self.real),
            BufferPlan::of::<u32>("solid.extremes", EXTREMES),
            BufferPlan::of::<u32>("solid.report", SolidReport::WORDS),
        ];
        if self.n_turning > 0 {
            plans.push(BufferPlan::of::<[u32; 4]>("solid.turning", self.n_turning));
        }
        plans
    }

    /// Threads of a reduction, each with its own share of the nodes and elements: as many as fill a large device, fewer for
    /// small solids.
    pub fn n_summing(&self) -> usize {
        ((self.n_nodes + self.n_elements) / 8)
            .next_multiple_of(WG_SIZE as usize)
            .clamp(WG_SIZE as usize, LARGEST_SUMMING)
    }
}

/// In the place of nodes of a hinge: nothing holds the body. `turn_solids.wgsl` has it too.
const FREE: u32 = u32::MAX;
/// Threads of a reduction, at most.
const LARGEST_SUMMING: usize = 16384;
/// Words of [`SolidBuffers::extremes`].
const EXTREMES: usize = 3;

/// The nodes and elements of all solids, owns no kernels. n nodes, m elements; arrays of several sections hold one section of
/// all nodes or elements after another. `Real4` is four f64 where [`SolidPlan::real`] is f64, else four f32.
#[derive(Debug)]
pub struct SolidBuffers {
    /// What they were made for.
    pub plan: SolidPlan,
    /// The sub-step's numbers.
    pub step: Buffer<SolidStep>,
    /// The layout of the obstacles' distance; only with obstacles.
    pub level: Option<Buffer<Layout>>,
    /// Per body that moves on circles where it turns: its first node and the one after its last, and two nodes of its hinge or
    /// all bits set; only with such bodies.
    pub turning: Option<Buffer<[u32; 4]>>,
    /// Per node: rest position, m, and lumped mass, kg.
    pub rest: Buffer<[f32; 4]>,
    /// Displacement from rest, m, as the sum of two f32: the larger part of all nodes, then the smaller.
    pub displacement: Buffer<[f32; 4]>,
    /// `Real4` per node: velocity, m/s; v* before the solve, v after it.
    pub velocity: RealBuffer,
    /// Per node: bits 0, 1, 2 are set where x, y, z is free. Zeros fill up to a multiple of four.
    pub flags: Buffer<u32>,
    /// Per node: distances from the nearer walls, m, and which they are; with obstacles a second section, unit normals and distances (see
    /// `shaders/common/contact.wgsl`).
    pub gaps: Buffer<[f32; 4]>,
    /// Per node: how it may move in this sub-step (see `shaders/common/freedom.wgsl`).
    pub freedom: Buffer<[f32; 4]>,
    /// What the search for contacts answers, and is told (see `shaders/common/ask.wgsl`). After a sub-step, first, how many of them are not
    /// settled.
    pub answer: Buffer<u32>,
    /// Per element: its nodes.
    pub elements: Buffer<[u32; 4]>,
    /// `Real4`, three sections: rest gradients of the shape functions of corners 1, 2, 3, 1/m (that of corner 0 is minus their
    /// sum), with the rest volume (m^3), lambda and mu (Pa) as fourth numbers.
    pub rest_gradients: RealBuffer,
    /// Per element: tau_K, s, and 1 for the linear model, else 0.
    pub damping: Buffer<[f32; 2]>,
    /// `Real4`, three sections: the same gradients, rotated; fourth numbers zeta_K V lambda, zeta_K V mu (s Pa m^3), and the
    /// determinant of the deformation gradient.
    pub rotated: RealBuffer,
    /// `Real4`, three sections: K x* - b of the element at corners 1, 2, 3, N (that at corner 0 is minus their sum); the fourth
    /// number of the first section is the element's elastic energy, J, the others are zero.
    pub element_forces: RealBuffer,
    /// `Real4` per node: constant force, N, and tau_M, 1/s.
    pub load: RealBuffer,
    /// Per node: what prescribed components move with in this sub-step, m/s. Without scripts one element, zero.
    pub prescribed: Buffer<[f32; 4]>,
    /// What each thread of a reduction found: three sections of `Real4`.
    pub partials: RealBuffer,
    /// Largest speed, least determinant, inverted elements, as `shaders/measure_solid.wgsl` orders them.
    pub extremes: Buffer<u32>,
    /// What the host reads once per step: see [`SolidReport`].
    pub report: Buffer<u32>,
}

impl SolidBuffers {
    /// Allocates everything that `plan` lists and writes all that never changes.
    ///
    /// # Errors
    /// [`Error::Limit`] when the adapter does not allow a size.
    ///
    /// # Panics
    /// When the solids are not those planned.
    pub fn new(gpu: &Gpu, plan: SolidPlan, solids: &Solids) -> Result<SolidBuffers, Error> {
        assert_eq!(
            (
                solids.rest.len(),
                solids.elements.len(),
                solids.turning().count()
            ),
            (plan.n_nodes, plan.n_elements, plan.n_turning),
            "nodes, elements and turning bodies of the plan"
        );
        let plans = plan.buffers();
        let maker = Maker { gpu, plans: &plans };
        let padded = plan.grid.padded();
        let level = || gpu.uniform("solid.level", &padded.layout());
        let turning = || maker.make("solid.turning");
        let zero: SolidStep = bytemuck::Zeroable::zeroed();
        let buffers = SolidBuffers {
            plan,
            step: gpu.uniform("solid.step", &zero)?,
            level: plan.obstacles.then(level).transpose()?,
            turning: (plan.n_turning > 0).then(turning).transpose()?,
            rest: maker.make("solid.rest")?,
            displacement: maker.make("solid.displacement")?,
            velocity: maker.make_real("solid.velocity", plan.real)?,
            flags: maker.make("solid.flags")?,
            gaps: maker.make("solid.gaps")?,
            freedom: maker.make("solid.freedom")?,
            answer: maker.make("solid.answer")?,
            elements: maker.make("solid.elements")?,
            rest_gradients: maker.make_real("solid.rest_gradients", plan.real)?,
            damping: maker.make("solid.damping")?,
            rotated: maker.make_real("solid.rotated", plan.real)?,
            element_forces: maker.make_real("solid.element_forces", plan.real)?,
            load: maker.make_real("solid.load", plan.real)?,
            prescribed: maker.make("solid.prescribed")?,
            partials: maker.make_real("solid.partials", plan.real)?,
            extremes: maker.make("solid.extremes")?,
            report: maker.make("solid.report")?,
        };
        buffers.write_nodes(gpu, solids);
        buffers.write_elements(gpu, solids);
        Ok(buffers)
    }

    fn write_nodes(&self, gpu: &Gpu, solids: &Solids) {
        let rest: Vec<[f32; 4]> = solids
            .rest
            .iter()
            .zip(&solids.mass)
            .map(|(x, &mass)| x.extend(mass).as_vec4().to_array())
            .collect();
        gpu.upload(&self.rest, &rest);
        if let Some(turning) = &self.turning {
            let bodies = solids.turning();
            let bodies = bodies.map(|Turning { nodes, about }| {
                let [a, b] = about.map_or([FREE; 2], |hinge| hinge.map(|node| node as u32));
                [nodes.start as u32, nodes.end as u32, a, b]
            });
            gpu.upload(turning, &bodies.collect::<Vec<_>>());
        }
        let free = |[x, y, z]: &[bool; 3]| u32::from(!x) | u32::from(!y) << 1 | u32::from(!z) << 2;
        let flags: Vec<u32> = solids.prescribed.iter().map(free).collect();
        gpu.upload(&self.flags, &flags);
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

    /// What the solver reads of them, and the velocity, which it solves for.
    pub fn fields(&self) -> SolidFields<'_> {
        SolidFields {
            step: (&self.step).into(),
            rest: &self.rest,
            velocity: &self.velocity,
            flags: &self.flags,
            displacement: &self.displacement,
            gaps: &self.gaps,
            freedom: &self.freedom,
            answer: &self.answer,
            elements: &self.elements,
            rotated: &self.rotated,
            element_forces: &self.element_forces,
            load: &self.load,
        }
    }

    /// The uniform of a sub-step of dt (s) under gravity (m/s^2).
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

    /// Writes the velocities (m/s) of prescribed components for the next sub-step, one entry per node; those of free components
    /// are not looked at. Without scripts there is nothing to write.
    ///
    /// # Panics
    /// When there are scripts and another number of nodes.
    pub fn write_prescribed(&self, gpu: &Gpu, velocities: &[[f64; 3]]) {
        if self.plan.scripts {
            assert_eq!(velocities.len(), self.plan.n_nodes, "prescribed velocities");
            let words: Vec<[f32; 4]> = velocities
                .iter()
                .map(|v| [v[0] as f32, v[1] as f32, v[2] as f32, 0.0])
                .collect();
            gpu.upload(&self.prescribed, &words);
        }
    }

    /// Writes displacements and velocities of a state, before all work submitted later. What [`SolidBuffers::read_state`] read
    /// is written back exactly, but for digits of the smaller parts that no f64 holds beside the larger:
    /// [`Carried`](crate::state::Carried) has those.
    ///
    /// # Panics
    /// When the state has another number of nodes.
    pub fn write_state(&self, gpu: &Gpu, state: &State) {
        let n = self.plan.n_nodes;
        assert_eq!(
            (state.displacement.len(), state.node_velocity.len()),
            (n, n),
            "nodes of the state"
        );
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

    /// Waits for all submitted work and reads displacements and velocities into a state: displacements to the digits of an f64,
    /// velocities exactly.
    ///
    /// # Errors
    /// [`Error::Gpu`] when the device fails.
    pub fn read_state(&self, gpu: &Gpu, state: &mut State) -> Result<(), Error> {
        let displacement = gpu.download(&self.displacement)?;
        state.displacement = self.displacement_of(&displacement);
        let velocity = self.velocity.download(gpu)?;
        state.node_velocity = velocity
            .chunks_exact(4)
            .map(|v| [v[0], v[1], v[2]])
            .collect();
        Ok(())
    }

    /// Displacements (m) from the contents of `displacement`.
    pub fn displacement_of(&self, displacement: &[[f32; 4]]) -> Vec<[f64; 3]> {
        let (high, low) = displacement.split_at(self.plan.n_nodes);
        let nodes = high.iter().zip(low);
        nodes
            .map(|(high, low)| {
                std::array::from_fn(|axis| f64::from(high[axis]) + f64::from(low[axis]))
            })
            .collect()
    }
}
