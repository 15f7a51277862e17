//! How a kernel reads a factor: its declaration, and a function that widens one number of it.

use crate::runtime::format::Format;

/// The declaration of a factor at a binding, the function `{name}_at`, and what four numbers of it
/// are in the memory that a workgroup shares: halves stay halves there, where kernels can name
/// them.
pub fn reader(name: &str, binding: usize, format: Format, halves: bool) -> String {
    let (element, quad, value) = match format {
        Format::F32 => ("f32", "vec4f", format!("{name}[i]")),
        Format::F16 if halves => ("f16", "vec4<f16>", format!("f32({name}[i])")),
        Format::F16 => (
            "u32",
            "vec4f",
            format!("unpack2x16float({name}[i / 2u])[i % 2u]"),
        ),
        // A bf16 is the upper half of an `f32`; where it lies in its word decides the shift.
        Format::Bf16 => (
            "u32",
            "vec4f",
            format!("bitcast<f32>({name}[i / 2u] >> (i % 2u * 16u) << 16u)"),
        ),
    };
    format!(
        "@group(0) @binding({binding}) var<storage, read> {name}: array<{element}>;\n\
         fn {name}_at(i: u32) -> f32 {{\n    return {value};\n}}\nalias quad_{name} = {quad};\n"
    )
}
