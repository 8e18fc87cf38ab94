//! `probe`: the scene's measurements of the liquid, a few numbers instead of all fields. [`crate::reference::probe`] defines them.

use crate::Error;
use crate::gpu::{Bound, Buffer, BufferPlan, Gpu, Kernel, Real, RealBuffer, Recorder};
use crate::scene::ProbeKind;
use crate::wgsl;

use super::{Active, LiquidBuffers};

/// A probe at a point: the doppelganger of `ProbePoint` in `shaders/common/probe_point.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct ProbePoint {
    /// m
    pub point: [f32; 3],
    /// 0 height, 1 pressure, 2 velocity; of a height also its axis in bits 2 and 3, and bit 4 where coordinates fall on the way up.
    pub kind: u32,
}

/// Where a probe's columns stand among the values.
#[derive(Clone, Copy, Debug)]
struct Columns {
    first: usize,
    n: usize,
}

/// Words of a probe at a point among the values; the fronts along the three axes take the first four words together.
const WORDS: usize = 4;

/// The stage: fields to `values`.
#[derive(Debug)]
pub struct Probe {
    columns: Vec<Columns>,
    /// What [`Probe::columns`] makes the columns from, as bits of f32.
    pub values: Buffer<u32>,
    points: Option<(Bound, usize)>,
    fronts: Option<Bound>,
}

impl Probe {
    /// The stage's name.
    pub const NAME: &'static str = "probe";

    /// The buffers it makes, the read-back of its values included.
    pub fn plan<'a>(probes: impl IntoIterator<Item = &'a ProbeKind>) -> Vec<BufferPlan> {
        let at_point =
            |kind: &&ProbeKind| kind.of_liquid() && !matches!(kind, ProbeKind::Front { .. });
        let n_points = probes.into_iter().filter(at_point).count();
        let n_values = WORDS * (n_points + 1);
        let mut plans = vec![
            BufferPlan::of::<u32>("probe.values", n_values),
            BufferPlan::of::<u32>("probe.values (read-back)", n_values),
        ];
        if n_points > 0 {
            plans.push(BufferPlan::of::<ProbePoint>("probe.points", n_points));
        }
        plans
    }

    /// Compiles and binds. `potential`: p dt / (rho dx), m/s, as many as padded cells; only active lanes are read.
    ///
    /// # Errors
    /// As [`Kernel::new`] and [`Kernel::bind`].
    pub fn new<'a>(
        gpu: &Gpu,
        buffers: &LiquidBuffers,
        active: &Active,
        potential: &RealBuffer,
        probes: impl IntoIterator<Item = &'a ProbeKind>,
    ) -> Result<Probe, Error> {
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
        let level = ("level", (&buffers.level).into());
        let step = ("step", (&buffers.step).into());
        let flags = ("flags", active.flags.into());
        let distance = ("liquid_distance", (&buffers.liquid_distance).into());
        let output = ("values", (&values).into());
        let bind_points = |points: &Buffer<ProbePoint>| {
            let kernel = Kernel::new(gpu, &wgsl!("probe_points"), potential.real)?;
            let bindings = [
                level,
                step,
                ("points", points.into()),
                distance,
                flags,
                ("potential", potential.into()),
                ("velocity", (&buffers.velocity).into()),
                output,
            ];
            Ok::<_, Error>((kernel.bind(gpu, &bindings)?, n_points))
        };
        let bind_fronts = || {
            let kernel = Kernel::new(gpu, &wgsl!("probe_fronts"), Real::F32)?;
            let args = ("args", active.args.into());
            let list = ("list", active.list.into());
            kernel.bind(gpu, &[level, step, args, list, flags, distance, output])
        };
        Ok(Probe {
            columns,
            points: points.as_ref().map(bind_points).transpose()?,
            fronts: fronts.then(bind_fronts).transpose()?,
            values,
        })
    }

    /// Records it, after a sub-step.
    pub fn record(&self, recorder: &mut Recorder, active: &Active) {
        recorder.clear(&self.values);
        recorder.stage(Probe::NAME, |pass| {
            if let Some((points, n)) = &self.points {
                pass.dispatch(points, *n);
            }
            if let Some(fronts) = &self.fronts {
                pass.dispatch_indirect(fronts, active.args, 0);
            }
        });
    }

    /// The columns of all probes of liquid in order, from the words of `values`. SI units.
    pub fn columns(&self, values: &[u32]) -> Vec<f64> {
        self.columns
            .iter()
            .flat_map(|columns| &values[columns.first..columns.first + columns.n])
            .map(|&word| f32::from_bits(word).into())
            .collect()
    }
}
