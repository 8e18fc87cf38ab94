//! `probe`: the scene's measurements of the liquid, computed on the device and defined in
//! [`crate::reference::probe`].

use crate::Error;
use crate::fields::{LiquidBuffers, SolverBuffers};
use crate::gpu::{Buffer, Dispatches, Gpu, Kernel, Real, Recorder};
use crate::scene::ProbeKind;
use crate::step::Stage;
use crate::wgsl;

/// A probe at a point.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct ProbePoint {
    /// Position, m.
    pub point: [f32; 3],
    /// 0 height, 1 pressure, 2 velocity. For a height, bits 2 and 3 contain its axis, and bit 4 is set where
    /// coordinates decrease upwards.
    pub kind: u32,
}

/// Position of a probe's columns among the values.
#[derive(Clone, Copy, Debug)]
struct Columns {
    first: usize,
    n: usize,
}

/// Words per point probe. The fronts along the three axes share the first four words.
const WORDS: usize = 4;

/// The stage: evaluates the probes into `values`.
#[derive(Debug)]
pub struct Probe {
    columns: Vec<Columns>,
    /// Input of [`Probe::columns`], as bits of f32.
    pub values: Buffer<u32>,
    dispatches: Dispatches,
}

impl Probe {
    /// Compiles the kernels and binds their arrays.
    pub fn new<'a>(
        gpu: &Gpu,
        liquid: &LiquidBuffers,
        solver: &SolverBuffers,
        probes: impl IntoIterator<Item = &'a ProbeKind>,
    ) -> Result<Probe, Error> {
        let gpu = &gpu.at(Stage::Probe.name());
        let mut points = Vec::new();
        let mut at_point = |point: glam::DVec3, kind, n| {
            let point = point.as_vec3().to_array();
            points.push(ProbePoint { point, kind });
            let first = WORDS * points.len();
            Columns { first, n }
        };
        let mut fronts = false;
        let columns = probes
            .into_iter()
            .filter_map(|probe| match *probe {
                ProbeKind::Height { foot, up } => {
                    let kind = (up.axis as u32) << 2 | u32::from(up.falling) << 4;
                    Some(at_point(foot, kind, 1))
                }
                ProbeKind::Pressure { point } => Some(at_point(point, 1, 1)),
                ProbeKind::Velocity { point } => Some(at_point(point, 2, 3)),
                ProbeKind::Front { axis } => {
                    fronts = true;
                    Some(Columns { first: axis, n: 1 })
                }
                ProbeKind::Node { .. } | ProbeKind::Solid { .. } | ProbeKind::Force { .. } => None,
            })
            .collect();
        let n_points = points.len();
        let values = gpu.buffer("probe.values", WORDS * (n_points + 1))?;
        let points = (n_points > 0)
            .then(|| gpu.buffer_with("probe.points", &points))
            .transpose()?;
        let mut list = Vec::new();
        if let Some(points) = &points {
            let own = [("points", points.into()), ("values", (&values).into())];
            let kernel = Kernel::new(gpu, &wgsl!("probe_points"), solver.variant.real)?;
            let bound = kernel.bind(gpu, &own, &[liquid, solver])?;
            list.push(bound.threads(n_points));
        }
        if fronts {
            let own = [("values", (&values).into())];
            let kernel = Kernel::new(gpu, &wgsl!("probe_fronts"), Real::F32)?;
            let bound = kernel.bind(gpu, &own, &[liquid, solver])?;
            list.push(bound.indirect(&solver.args, 0));
        }
        Ok(Probe {
            columns,
            dispatches: Dispatches::new(Stage::Probe.name(), list).clearing(&values),
            values,
        })
    }

    /// Records the stage, after a sub-step.
    pub fn record(&self, recorder: &mut Recorder) {
        self.dispatches.record(recorder);
    }

    /// The columns of all liquid probes in order, from the words of `values`. SI units.
    pub fn columns(&self, values: &[u32]) -> Vec<f64> {
        self.columns
            .iter()
            .flat_map(|columns| &values[columns.first..columns.first + columns.n])
            .map(|&word| f32::from_bits(word).into())
            .collect()
    }
}
