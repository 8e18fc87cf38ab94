//! The vocabulary of device arrays. Tables list the WGSL name, element, length, unit and centring of each array.
//!
//! A table allocates its arrays and binds them to kernels by name. `plan` and the limits derive from the same
//! allocations on a planning device.

mod clip;
pub(crate) mod coupling;
mod level;
mod level_exchange;
mod liquid;
pub(crate) mod pressure_system;
mod report;
pub(crate) mod solid_system;
mod solids;
mod taps;

pub use clip::{ClipBuffers, ClipSize, Clipped, CutQuad, CutQuads};
pub use coupling::{Coupling, CouplingBuffers, CouplingSize, Pair, REPORT_WORDS};
pub use level::{LevelBuffers, LevelStep};
pub use level_exchange::{ExchangeBuffers, LevelExchange};
pub(crate) use liquid::TILE;
pub use liquid::{LiquidBuffers, LiquidPlan, ObstacleBuffers, Step, Tiles, extrapolation_layers};
pub(crate) use pressure_system::everywhere;
pub use pressure_system::{LevelPlan, SolverBuffers, variant};
pub use report::{CouplingReport, Exchanged, Report, SolidReport};
pub use solid_system::{Rows, SolidRows, SolidSystemBuffers};
pub use solids::{SolidBuffers, SolidPlan, SolidStep};
pub use taps::{DeviceSourceFace, Region, Sinks, SourceStep, Sources};

use crate::step::Stage;

/// Memory that two arrays share.
#[derive(Clone, Copy, Debug)]
pub struct Shared {
    /// Name of the scratch array.
    pub view: &'static str,
    /// Name of the array whose memory it uses.
    pub array: &'static str,
    /// First and last stage that use the scratch contents.
    pub used: [Stage; 2],
    /// First and last stage in which the array's own contents are free.
    pub free: [Stage; 2],
}

/// Declares a struct of device arrays.
///
/// - `fields`: sizes and options, in scope of every row.
/// - `sizes`: further sizes in scope of every row, not stored.
/// - `arrays`: `array NAME: T [LENGTH]` is a `Buffer` of `T`, `real NAME: REAL [LENGTH]` a
///   `RealBuffer`, `uniform NAME: T [VALUE]` a uniform buffer. With `if CONDITION` the array is
///   an `Option`.
/// - `views`: another WGSL name of an array. Without stages it is the same contents with another element type. With
///   `while FIRST..=LAST, free FROM..=TO` it is scratch memory in FIRST to LAST. The array's own contents are free in
///   FROM to TO; a test checks both ranges.
/// - `parts`: fields that are tables themselves; kernels bind their arrays too.
///
/// Labels are `GROUP.NAME`, or the label in `as "..."`.
#[macro_export]
macro_rules! arrays {
    (
        $(#[$meta:meta])*
        $vis:vis struct $Name:ident in $group:literal {
            fields { $( $(#[$fmeta:meta])* $fvis:vis $field:ident : $ftype:ty ),* $(,)? }
            $(sizes { $( $size:ident : $stype:ty ),* $(,)? })?
            arrays { $(
                $(#[$ameta:meta])*
                $avis:vis $kind:ident $name:ident : $t:tt [ $len:expr ] $(as $label:literal)? $(if $when:expr)?
            ),* $(,)? }
            views { $( $view:ident = $of:ident $(while $first:ident ..= $last:ident, free $from:ident ..= $to:ident)? ),* $(,)? }
            parts { $( $part:ident ),* $(,)? }
        }
    ) => {
        $(#[$meta])*
        #[derive(Debug)]
        $vis struct $Name {
            $( $(#[$fmeta])* $fvis $field: $ftype, )*
            $( $(#[$ameta])* $avis $name: $crate::arrays!(@type $kind $t $(if $when)?), )*
        }

        impl $Name {
            /// Allocates all rows of the table.
            pub(crate) fn allocate(gpu: &$crate::gpu::Gpu $(, $field: $ftype)* $($(, $size: $stype)*)?) -> Result<$Name, $crate::Error> {
                $( let $name = $crate::arrays!(
                    @optional { $crate::arrays!(@new gpu $kind $t [$len] $crate::arrays!(@label $group $name $($label)?)) } $(if $when)?
                ); )*
                Ok($Name { $($field,)* $($name,)* })
            }
        }

        impl $Name {
            /// Views that are scratch memory.
            pub const SHARED: &[$crate::fields::Shared] = &[
                $( $($crate::fields::Shared {
                    view: stringify!($view),
                    array: stringify!($of),
                    used: [$crate::step::Stage::$first, $crate::step::Stage::$last],
                    free: [$crate::step::Stage::$from, $crate::step::Stage::$to],
                },)? )*
            ];
        }

        impl $crate::gpu::Arrays for $Name {
            fn array(&self, name: &str) -> Option<$crate::gpu::Binding<'_>> {
                match name {
                    $( stringify!($name) => $crate::arrays!(@binding self $name $(if $when)?), )*
                    $( stringify!($view) => self.array(stringify!($of)), )*
                    _ => {
                        let part: Option<$crate::gpu::Binding<'_>> = None;
                        $( let part = part.or_else(|| self.$part.array(name)); )*
                        part
                    }
                }
            }
        }
    };
    (@type $kind:ident $t:tt if $when:expr) => { Option<$crate::arrays!(@type $kind $t)> };
    (@type array $t:tt) => { $crate::gpu::Buffer<$t> };
    (@type uniform $t:tt) => { $crate::gpu::Buffer<$t> };
    (@type real $t:tt) => { $crate::gpu::RealBuffer };
    (@optional $new:block if $when:expr) => { if $when { Some($new) } else { None } };
    (@optional $new:block) => { $new };
    (@label $group:literal $name:ident) => { concat!($group, ".", stringify!($name)) };
    (@label $group:literal $name:ident $label:literal) => { $label };
    (@new $gpu:ident array $t:tt [$len:expr] $label:expr) => { $gpu.buffer::<$t>($label, $len)? };
    (@new $gpu:ident uniform $t:tt [$value:expr] $label:expr) => { $gpu.uniform::<$t>($label, &$value)? };
    (@new $gpu:ident real $t:tt [$len:expr] $label:expr) => { $crate::gpu::RealBuffer::new($gpu, $label, $len, $t)? };
    (@binding $self:ident $name:ident if $when:expr) => { $self.$name.as_ref().map(Into::into) };
    (@binding $self:ident $name:ident) => { Some((&$self.$name).into()) };
}

#[cfg(test)]
mod tests {
    use super::{LevelBuffers, LiquidBuffers, SolidBuffers};

    #[test]
    fn shared_memory_is_never_needed_twice() {
        assert!(!LiquidBuffers::SHARED.is_empty());
        let tables = [LevelBuffers::SHARED, LiquidBuffers::SHARED, SolidBuffers::SHARED];
        for shared in tables.into_iter().flatten() {
            let ([first, last], [from, to]) = (shared.used, shared.free);
            // Free stages that wrap around the end of a sub-step are those before `to` and after `from`.
            let within = match from <= to {
                true => from <= first && last <= to,
                false => last <= to || from <= first,
            };
            assert!(within && first <= last, "{shared:?}");
        }
    }
}
