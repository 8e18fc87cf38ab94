//! Tables of device arrays: each row is an array's name in WGSL, its element and its length. The table allocates the arrays and offers
//! them to kernels.

/// Declares a struct of device arrays.
///
/// - `fields`: what sizes depend on, in scope of every row.
/// - `arrays`: `array NAME: T [LENGTH]` is a [`Buffer`](super::Buffer) of `T`, `real NAME: REAL [LENGTH]` a
///   [`RealBuffer`](super::RealBuffer), `uniform NAME: T [VALUE]` a uniform buffer. With `if CONDITION` the array is an `Option`.
/// - `views`: another name under which kernels bind an array: with another element type, or as scratch memory of a stage in which its
///   own contents are not needed.
/// - `parts`: fields that are tables themselves, whose arrays kernels bind too.
///
/// Labels are `GROUP.NAME`, or the label in `as "..."`.
#[macro_export]
macro_rules! arrays {
    (
        $(#[$meta:meta])*
        $vis:vis struct $Name:ident in $group:literal {
            fields { $( $(#[$fmeta:meta])* $fvis:vis $field:ident : $ftype:ty ),* $(,)? }
            arrays { $(
                $(#[$ameta:meta])*
                $avis:vis $kind:ident $name:ident : $t:tt [ $len:expr ] $(as $label:literal)? $(if $when:expr)?
            ),* $(,)? }
            views { $( $view:ident = $of:ident ),* $(,)? }
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
            ///
            /// # Errors
            /// [`Error::Limit`](crate::Error::Limit) when the adapter does not allow a size.
            pub(crate) fn allocate(gpu: &$crate::gpu::Gpu $(, $field: $ftype)*) -> Result<$Name, $crate::Error> {
                $( let $name = $crate::arrays!(
                    @optional { $crate::arrays!(@new gpu $kind $t [$len] $crate::arrays!(@label $group $name $($label)?)) } $(if $when)?
                ); )*
                Ok($Name { $($field,)* $($name,)* })
            }
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
