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

/// A rectangle of a flux probe.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct ProbeRectangle {
    /// Lowest corner, m.
    pub low: [f32; 3],
    /// Axis of its normal.
    pub axis: u32,
    /// Highest corner, m.
    pub high: [f32; 3],
    /// Index of its value, in fours.
    pub place: u32,
}

/// A probe's columns among the values.
#[derive(Clone, Copy, Debug)]
enum Columns {
    /// Words from `first` on.
    Words { first: usize, n: usize },
    /// Smallest coordinate: the complement of a word. A word of 0 is the length of the domain, m.
    LowerFront { word: usize, size: f64 },
}

/// Threads of a rectangle. Also in `common/tree.wgsl`.
const FOLD_SIZE: usize = 256;
/// Words per point and rectangle.
const WORDS: usize = 4;
/// Words of the fronts, before those of the points: the largest coordinates along x, y, z, then the smallest, complemented.
const FRONT_WORDS: usize = 2 * WORDS;

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
        let (mut points, mut rectangles) = (Vec::new(), Vec::new());
        let probes: Vec<&ProbeKind> = probes.into_iter().collect();
        let is_flux = |probe: &&&ProbeKind| matches!(probe, ProbeKind::Flux { .. });
        let n_fluxes = probes.iter().filter(is_flux).count();
        let mut at_point = |point: glam::DVec3, kind, n| {
            let point = point.as_vec3().to_array();
            let first = FRONT_WORDS + WORDS * points.len();
            points.push(ProbePoint { point, kind });
            Columns::Words { first, n }
        };
        let n_points = probes.iter().filter(|probe| {
            let is_front = matches!(probe, ProbeKind::Front { .. });
            probe.measures_liquid() && !is_front && !is_flux(probe)
        });
        let n_points = n_points.count();
        let mut fronts = 0;
        let size = liquid.plan.grid.size();
        let columns = probes
            .into_iter()
            .filter_map(|probe| match *probe {
                ProbeKind::Height { foot, up } => {
                    let kind = (up.axis as u32) << 2 | u32::from(up.falling) << 4;
                    Some(at_point(foot, kind, 1))
                }
                ProbeKind::Pressure { point } => Some(at_point(point, 1, 1)),
                ProbeKind::Velocity { point } => Some(at_point(point, 2, 3)),
                ProbeKind::Front { axis, lower } => {
                    let word = axis + 3 * usize::from(lower);
                    fronts |= 1u32 << word;
                    Some(match lower {
                        false => Columns::Words { first: word, n: 1 },
                        true => Columns::LowerFront { word, size: size[axis] },
                    })
                }
                ProbeKind::Flux { axis, min, max } => {
                    let first = FRONT_WORDS + WORDS * (n_points + rectangles.len());
                    rectangles.push(ProbeRectangle {
                        low: min.as_vec3().to_array(),
                        axis: axis as u32,
                        high: max.as_vec3().to_array(),
                        place: (first / WORDS) as u32,
                    });
                    Some(Columns::Words { first, n: 1 })
                }
                ProbeKind::Node { .. }
                | ProbeKind::Solid { .. }
                | ProbeKind::SolidVelocity { .. }
                | ProbeKind::Force { .. }
                | ProbeKind::Reaction { .. } => None,
            })
            .collect();
        let values = gpu.buffer("probe.values", FRONT_WORDS + WORDS * (n_points + rectangles.len()))?;
        let points = (n_points > 0).then(|| gpu.buffer_with("probe.points", &points)).transpose()?;
        let mut list = Vec::new();
        if let Some(points) = &points {
            let own = [("points", points.into()), ("values", (&values).into())];
            let kernel = Kernel::new(gpu, &wgsl!("probe_points"), solver.variant.real)?;
            let bound = kernel.bind(gpu, &own, &[liquid, solver])?;
            list.push(bound.threads(n_points));
        }
        if !rectangles.is_empty() {
            let rectangles = gpu.buffer_with("probe.rectangles", &rectangles)?;
            let own = [("rectangles", (&rectangles).into()), ("values", (&values).into())];
            let kernel = Kernel::new(gpu, &wgsl!("probe_fluxes"), solver.variant.real)?;
            let bound = kernel.bind(gpu, &own, &[liquid])?;
            list.push(bound.threads(FOLD_SIZE * n_fluxes));
        }
        if fronts != 0 {
            let sides = gpu.uniform("probe.sides", &[fronts, 0, 0, 0])?;
            let own = [("values", (&values).into()), ("sides", (&sides).into())];
            let kernel = Kernel::new(gpu, &wgsl!("probe_fronts"), Real::F32)?;
            let bound = kernel.bind(gpu, &own, &[liquid, solver])?;
            list.push(bound.indirect(&solver.args, 0));
        }
        Ok(Probe { columns, dispatches: Dispatches::new(Stage::Probe.name(), list).clearing(&values), values })
    }

    /// Records the stage, after a sub-step.
    pub fn record(&self, recorder: &mut Recorder) {
        self.dispatches.record(recorder);
    }

    /// The columns of all liquid probes in order, from the words of `values`. SI units.
    pub fn columns(&self, values: &[u32]) -> Vec<f64> {
        let number = |word: u32| f64::from(f32::from_bits(word));
        let columns = self.columns.iter();
        let columns = columns.flat_map(|columns| -> Vec<f64> {
            match *columns {
                Columns::Words { first, n } => {
                    let words = values[first..first + n].iter();
                    words.map(|&word| number(word)).collect()
                }
                Columns::LowerFront { word, size } => vec![match values[word] {
                    0 => size,
                    word => number(!word),
                }],
            }
        });
        columns.collect()
    }
}
