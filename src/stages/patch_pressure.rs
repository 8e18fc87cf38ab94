//! Part of `right_hand_side`: correction for the variation of pressure within cells, for solids in liquid. The twin,
//! `reference/patch_pressure.rs`, has the equation.

use crate::fields::{CouplingBuffers, Pair, SolidBuffers, SolidSystemBuffers, SolverBuffers};
use crate::geometry::counting_sort;
use crate::gpu::bind;
use glam::{DMat3, DVec3};
use rayon::prelude::*;

use crate::Error;
use crate::gpu::{Arrays, Bound, Buffer, Gpu, Pass, RealBuffer, Recorder};
use crate::grid::Layout;
use crate::step::Stage;
use crate::wgsl;

/// Pressure gradient at rest, and the scale of that of the last pressure.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct PressureSlope {
    /// Pressure gradient of liquid at rest, Pa/m.
    pub at_rest: [f32; 3],
    /// rho / dt of the last sub-step, Pa/m per m/s of the potential; 0 before the first.
    pub scale: f32,
}

/// Face apertures for the gradient of the last pressure.
#[derive(Clone, Copy, Debug)]
pub struct OpenFaces<'a> {
    /// Layout.
    pub level: &'a Buffer<Layout>,
    /// Open fractions.
    pub open: &'a Buffer<f32>,
}

/// The kernels, and what they are given.
#[derive(Debug)]
pub struct PatchPressure {
    n_nodes: usize,
    n_quads: usize,
    at_rest: DVec3,
    /// Whether the gradient at rest has changed, so that it is written in every sub-step.
    changes: bool,
    slope: Buffer<PressureSlope>,
    /// Per pair of a node, bits of the rows of the integral of n N_i (x - x_cell)^T, m^3; fourth of the first row, which slope.
    moments: Buffer<[u32; 4]>,
    /// Gradients in the wet cells, four per quad, Pa/m.
    slopes: Buffer<[f32; 4]>,
    /// Forces, N, `Real4` per node.
    pub correction: RealBuffer,
    measure: Option<Bound>,
    apply: Bound,
}

/// A gradient as in a buffer.
fn everywhere(at_rest: DVec3) -> [f32; 4] {
    at_rest.as_vec3().extend(0.0).to_array()
}

impl PatchPressure {
    /// Compiles and binds. `at_rest`: gradient of the pressure of liquid at rest, Pa/m, taken everywhere unless `faces` are given.
    pub fn new(
        gpu: &Gpu,
        liquid: &SolverBuffers,
        solids: &SolidSystemBuffers,
        fields: &SolidBuffers,
        coupling: &CouplingBuffers,
        (at_rest, faces): (DVec3, Option<OpenFaces>),
    ) -> Result<PatchPressure, Error> {
        let (size, n) = (coupling.size, coupling.n_nodes);
        let variant = liquid.variant;
        let everywhere = vec![everywhere(at_rest); 4 * size.quads];
        let slope =
            gpu.uniform("patch_pressure.slope", &PressureSlope { at_rest: at_rest.as_vec3().to_array(), scale: 0.0 })?;
        let moments = gpu.buffer("patch_pressure.moments", 3 * size.pairs)?;
        let slopes = gpu.buffer_with("patch_pressure.slopes", &everywhere)?;
        let correction = RealBuffer::new(gpu, "patch_pressure.correction", 4 * n, variant.real)?;
        let real = variant.real;
        let at_clip = gpu.at(Stage::Clip.name());
        let measure = |faces: OpenFaces| {
            let own = [
                ("level", faces.level.into()),
                ("slope", (&slope).into()),
                ("open", faces.open.into()),
                ("slopes", (&slopes).into()),
            ];
            bind(&at_clip, &wgsl!("pressure_slopes"), real, own, &[coupling, liquid])
        };
        let own = [
            ("moments", (&moments).into()),
            ("slopes", (&slopes).into()),
            ("node_flags", (&fields.flags).into()),
            ("correction", (&correction).into()),
        ];
        let at_right_hand_side = gpu.at(Stage::RightHandSide.name());
        let tables: [&dyn Arrays; 3] = [coupling, solids, liquid];
        let apply = bind(&at_right_hand_side, &wgsl!("patch_pressure"), real, own, &tables)?;
        Ok(PatchPressure {
            n_nodes: n,
            n_quads: size.quads,
            at_rest,
            changes: false,
            measure: faces.map(measure).transpose()?,
            apply,
            slope,
            moments,
            slopes,
            correction,
        })
    }

    /// Whether gradients are those of the last pressure.
    pub fn follows_pressure(&self) -> bool {
        self.measure.is_some()
    }

    /// Writes the integrals of n N_i (x - x_cell)^T over the patches of each pair, m^3, before all work submitted later. `pairs`: those of
    /// [`CouplingBuffers::write`], in its order. `at_rest`: as for [`PatchPressure::new`]; `scale`: rho / dt of the last sub-step, 0 before the first.
    pub fn write(&mut self, gpu: &Gpu, pairs: &[Pair], moments: &[DMat3], (at_rest, scale): (DVec3, f64)) {
        let mut wet = 0;
        // Slope of each pair.
        let mut slopes: Vec<usize> = Vec::with_capacity(pairs.len());
        for (at, pair) in pairs.iter().enumerate() {
            if at > 0 && pairs[at - 1].cell / 4 != pair.cell / 4 {
                wet += 1;
            }
            slopes.push(4 * wet + pair.cell % 4);
        }
        // As the pairs of the nodes are ordered.
        let (_, order) = counting_sort(self.n_nodes, pairs.iter().map(|pair| pair.node));
        let rows = |&at: &usize| {
            [0, 1, 2].map(|row| {
                let [x, y, z] = moments[at].row(row).as_vec3().to_array().map(f32::to_bits);
                [x, y, z, slopes[at] as u32]
            })
        };
        let rows: Vec<[[u32; 4]; 3]> = order.par_iter().map(rows).collect();
        gpu.upload(&self.moments, rows.as_flattened());
        let slope = PressureSlope { at_rest: at_rest.as_vec3().to_array(), scale: scale as f32 };
        gpu.upload(&self.slope, &[slope]);
        self.changes |= at_rest != self.at_rest;
        self.at_rest = at_rest;
        if self.changes && self.measure.is_none() && !pairs.is_empty() {
            gpu.upload(&self.slopes, &vec![everywhere(at_rest); 4 * (wet + 1)]);
        }
    }

    /// Records the gradients, while the unknowns are still those of the last sub-step.
    pub fn record_slopes(&self, pass: &mut Pass) {
        if let Some(measure) = &self.measure {
            pass.dispatch(measure, self.n_quads);
        }
    }

    /// Clears the forces that are recorded as added, for a new right-hand side.
    pub fn record_clear(&self, to: &mut Recorder) {
        to.clear(&self.correction.words);
    }

    /// Records what they add to the right-hand side, for the cells that are active now.
    pub fn record(&self, pass: &mut Pass) {
        pass.dispatch(&self.apply, self.n_nodes);
    }

    /// Gradients in the wet cells, Pa/m.
    pub fn slopes(&self) -> &Buffer<[f32; 4]> {
        &self.slopes
    }
}
