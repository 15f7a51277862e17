//! The parameters of kernels: a struct that the host fills and of which WGSL is told, so that the
//! two cannot disagree.

/// A row of `u32` and `f32`, which [`params!`](crate::kernels::params) declares.
pub trait Params: bytemuck::Pod {
    /// Its fields as WGSL declares them, a line each.
    const FIELDS: &'static str;
}

/// Declares the parameters of a kernel, whose fields are `u32` or `f32`. In the kernel they are
/// `p`:
///
/// ```
/// compute::kernels::params! {
///     /// How far to move what is seen.
///     pub struct Shift {
///         /// Elements.
///         len: u32,
///         /// In pixels.
///         by: f32,
///     }
/// }
/// # use compute::kernels::Params;
/// assert_eq!(Shift::FIELDS, "    len: u32,\n    by: f32,\n");
/// ```
#[macro_export]
macro_rules! params {
    (
        $(#[$about:meta])*
        $visibility:vis struct $name:ident {
            $($(#[$about_field:meta])* $field:ident: $type:ident,)*
        }
    ) => {
        $(#[$about])*
        #[repr(C)]
        #[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
        $visibility struct $name {
            $($(#[$about_field])* $visibility $field: $type,)*
        }

        impl $crate::kernels::Params for $name {
            const FIELDS: &'static str =
                concat!($("    ", stringify!($field), ": ", stringify!($type), ",\n"),*);
        }
    };
}

pub use params;
