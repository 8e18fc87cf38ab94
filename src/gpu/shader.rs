//! Shader composition: `#import name` inserts each module once. A line map lets errors name file and line.
//!
//! naga_oil is not used because it renames identifiers. `#import real` selects the scalar type `Real` (f32 or f64) of
//! the variant, `#import pair` its double arithmetic, and `#import obstacles` moving or static obstacles.

use naga::valid::{Capabilities, ModuleInfo, ValidationFlags, Validator};

use crate::Error;

/// Threads per workgroup of every kernel over a list; also in `common/dispatch.wgsl`.
pub const WG_SIZE: u32 = 64;

/// A WGSL file below `shaders/`, without `.wgsl`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Source {
    /// File stem, entry point and label of the kernel.
    pub name: &'static str,
    /// WGSL text.
    pub text: &'static str,
}

/// The modules available to `#import`.
pub const COMMON: &[Source] = &[
    crate::wgsl!("common/active"),
    crate::wgsl!("common/advect"),
    crate::wgsl!("common/advect_quad"),
    crate::wgsl!("common/ask"),
    crate::wgsl!("common/ballistic"),
    crate::wgsl!("common/ballistic_body"),
    crate::wgsl!("common/body_end"),
    crate::wgsl!("common/cavities"),
    crate::wgsl!("common/chebyshev"),
    crate::wgsl!("common/classes"),
    crate::wgsl!("common/compact"),
    crate::wgsl!("common/component_sums"),
    crate::wgsl!("common/components"),
    crate::wgsl!("common/contact"),
    crate::wgsl!("common/control"),
    crate::wgsl!("common/control_state"),
    crate::wgsl!("common/controlled_part"),
    crate::wgsl!("common/corner"),
    crate::wgsl!("common/coupling"),
    crate::wgsl!("common/coupling_flux"),
    crate::wgsl!("common/coupling_force"),
    crate::wgsl!("common/cut_quad"),
    crate::wgsl!("common/departure_words"),
    crate::wgsl!("common/dispatch"),
    crate::wgsl!("common/divergence"),
    crate::wgsl!("common/domain_walls"),
    crate::wgsl!("common/edges"),
    crate::wgsl!("common/exchange_totals"),
    crate::wgsl!("common/extension"),
    crate::wgsl!("common/extremes"),
    crate::wgsl!("common/face_departure"),
    crate::wgsl!("common/face_index"),
    crate::wgsl!("common/face_marks"),
    crate::wgsl!("common/fall"),
    crate::wgsl!("common/falling"),
    crate::wgsl!("common/filled"),
    crate::wgsl!("common/filled_part"),
    crate::wgsl!("common/filter_width"),
    crate::wgsl!("common/find"),
    crate::wgsl!("common/fixed_point"),
    crate::wgsl!("common/flies"),
    crate::wgsl!("common/flux"),
    crate::wgsl!("common/fold"),
    crate::wgsl!("common/freedom"),
    crate::wgsl!("common/gather"),
    crate::wgsl!("common/ghost_fluid"),
    crate::wgsl!("common/hash"),
    crate::wgsl!("common/inner_f32"),
    crate::wgsl!("common/inner_f64"),
    crate::wgsl!("common/interpolant_part"),
    crate::wgsl!("common/join"),
    crate::wgsl!("common/label_at"),
    crate::wgsl!("common/landing"),
    crate::wgsl!("common/lanes"),
    crate::wgsl!("common/layout"),
    crate::wgsl!("common/level"),
    crate::wgsl!("common/level_cells"),
    crate::wgsl!("common/level_origin"),
    crate::wgsl!("common/level_path"),
    crate::wgsl!("common/level_step"),
    crate::wgsl!("common/level_values"),
    crate::wgsl!("common/liquid_lanes"),
    crate::wgsl!("common/marker_counts"),
    crate::wgsl!("common/marker_depth"),
    crate::wgsl!("common/moving_walls"),
    crate::wgsl!("common/node_block"),
    crate::wgsl!("common/node_flags"),
    crate::wgsl!("common/obstacles_moving"),
    crate::wgsl!("common/obstacles_still"),
    crate::wgsl!("common/opening"),
    crate::wgsl!("common/ordered"),
    crate::wgsl!("common/pair_f32"),
    crate::wgsl!("common/pair_f64"),
    crate::wgsl!("common/pcg_slots"),
    crate::wgsl!("common/polar"),
    crate::wgsl!("common/pressure_slope"),
    crate::wgsl!("common/probe_point"),
    crate::wgsl!("common/probe_rectangle"),
    crate::wgsl!("common/put_back"),
    crate::wgsl!("common/quad_rooms"),
    crate::wgsl!("common/quad_sides"),
    crate::wgsl!("common/real_f32"),
    crate::wgsl!("common/real_f64"),
    crate::wgsl!("common/refine"),
    crate::wgsl!("common/region"),
    crate::wgsl!("common/removed"),
    crate::wgsl!("common/report"),
    crate::wgsl!("common/report_sum"),
    crate::wgsl!("common/rows"),
    crate::wgsl!("common/sample_distance"),
    crate::wgsl!("common/sample_velocity"),
    crate::wgsl!("common/scan"),
    crate::wgsl!("common/seed_slots"),
    crate::wgsl!("common/separation"),
    crate::wgsl!("common/shown"),
    crate::wgsl!("common/sink_level"),
    crate::wgsl!("common/sites"),
    crate::wgsl!("common/slide"),
    crate::wgsl!("common/slivers"),
    crate::wgsl!("common/smooth_cells"),
    crate::wgsl!("common/solid_report"),
    crate::wgsl!("common/solid_step"),
    crate::wgsl!("common/sort"),
    crate::wgsl!("common/source_face"),
    crate::wgsl!("common/source_lattice"),
    crate::wgsl!("common/source_step"),
    crate::wgsl!("common/spray_sums"),
    crate::wgsl!("common/spray_value"),
    crate::wgsl!("common/stencil"),
    crate::wgsl!("common/step"),
    crate::wgsl!("common/sweep"),
    crate::wgsl!("common/symmetric"),
    crate::wgsl!("common/tally"),
    crate::wgsl!("common/thick"),
    crate::wgsl!("common/tiles"),
    crate::wgsl!("common/trace"),
    crate::wgsl!("common/tree"),
    crate::wgsl!("common/unknown"),
    crate::wgsl!("common/valid"),
    crate::wgsl!("common/walls"),
    crate::wgsl!("common/wetted"),
];

/// The scalar type of `alias Real`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Real {
    /// 32 bit.
    F32,
    /// 64 bit; requires the adapter's `SHADER_F64`.
    F64,
}

impl Real {
    /// Bytes per scalar.
    pub fn bytes(self) -> usize {
        match self {
            Real::F32 => 4,
            Real::F64 => 8,
        }
    }

    fn name(self) -> &'static str {
        match self {
            Real::F32 => "f32",
            Real::F64 => "f64",
        }
    }
}

/// A shader text composed from several files.
#[derive(Clone, Debug)]
pub struct Composed {
    /// The text for the compiler.
    pub text: String,
    /// File and line of each line of the text.
    lines: Vec<(&'static str, usize)>,
}

impl Composed {
    /// File and line (from 1) of a line (from 1) of the composed text.
    pub fn origin(&self, line: usize) -> (String, usize) {
        let (name, line) = self.lines[line.clamp(1, self.lines.len()) - 1];
        (format!("shaders/{name}.wgsl"), line)
    }

    fn error(&self, line: usize, problem: String) -> Error {
        let (file, line) = self.origin(line);
        Error::Shader { file, line, problem }
    }
}

/// The scalar types of a kernel: `#import real` defines `Real`, `#import inner` defines `Inner`. Most kernels use
/// one. The solver's outer loop computes residuals in `Real` and corrections in `Inner`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Variant {
    /// `Real`.
    pub real: Real,
    /// `Inner`.
    pub inner: Real,
    /// Whether obstacles move: `#import obstacles` defines their prescribed boundary flux, or none.
    pub moving_obstacles: bool,
}

impl From<Real> for Variant {
    fn from(real: Real) -> Variant {
        Variant { real, inner: real, moving_obstacles: false }
    }
}

impl Variant {
    /// The same variant for moving or static obstacles.
    pub fn beside_obstacles(self, moving_obstacles: bool) -> Variant {
        Variant { moving_obstacles, ..self }
    }
}

/// Replaces the `#import` lines by their modules, each once, in order of first use.
///
/// # Errors
/// [`Error::Shader`] for an unknown module.
pub fn compose(source: &Source, variant: impl Into<Variant>) -> Result<Composed, Error> {
    let mut composed = Composed { text: String::new(), lines: Vec::new() };
    include(&mut composed, &mut Vec::new(), *source, variant.into())?;
    Ok(composed)
}

fn include(out: &mut Composed, done: &mut Vec<&'static str>, source: Source, variant: Variant) -> Result<(), Error> {
    for (index, line) in source.text.lines().enumerate() {
        if let Some(name) = line.strip_prefix("#import ") {
            let module_name = match name.trim() {
                name @ ("real" | "pair") => format!("common/{name}_{}", variant.real.name()),
                "inner" => format!("common/inner_{}", variant.inner.name()),
                "obstacles" if variant.moving_obstacles => "common/obstacles_moving".to_owned(),
                "obstacles" => "common/obstacles_still".to_owned(),
                name => format!("common/{name}"),
            };
            let module = COMMON.iter().find(|module| module.name == module_name).ok_or_else(|| Error::Shader {
                file: format!("shaders/{}.wgsl", source.name),
                line: index + 1,
                problem: format!("no module shaders/{module_name}.wgsl"),
            })?;
            if !done.contains(&module.name) {
                done.push(module.name);
                include(out, done, *module, variant)?;
            }
        } else {
            out.text.push_str(line);
            out.text.push('\n');
            out.lines.push((source.name, index + 1));
        }
    }
    Ok(())
}

/// Parses a composed shader. Errors name file and line.
pub(super) fn parse(composed: &Composed) -> Result<naga::Module, Error> {
    naga::front::wgsl::parse_str(&composed.text).map_err(|error| {
        let line = error.location(&composed.text).map_or(1, |location| location.line_number as usize);
        composed.error(line, error.to_string())
    })
}

/// Parses and validates a composed shader with the capabilities of its variant, without a device. Errors name file
/// and line, which device errors do not.
pub fn validate(composed: &Composed, variant: impl Into<Variant>) -> Result<(naga::Module, ModuleInfo), Error> {
    let variant = variant.into();
    let module = parse(composed)?;
    let mut capabilities = Capabilities::empty();
    if variant.real == Real::F64 || variant.inner == Real::F64 {
        capabilities |= Capabilities::FLOAT64;
    }
    let info = Validator::new(ValidationFlags::all(), capabilities).validate(&module).map_err(|error| {
        let line = error.location(&composed.text).map_or(1, |location| location.line_number as usize);
        let mut problem = error.as_inner().to_string();
        let mut cause: Option<&dyn std::error::Error> = std::error::Error::source(error.as_inner());
        while let Some(inner) = cause {
            problem.push_str(": ");
            problem.push_str(&inner.to_string());
            cause = inner.source();
        }
        composed.error(line, problem)
    })?;
    Ok((module, info))
}
