//! Arrays longer than a kernel may see at once: they are bound piece by piece, and the kernel's
//! text is rewritten so that every access finds its piece. It knows how kernels declare and use
//! arrays, not what they compute.
//!
//! Only addresses change, no sum and no order: the results are those of a GPU that sees arrays as a
//! whole.

use std::collections::BTreeSet;

/// An array as a kernel declares it.
struct ArrayDeclaration<'t> {
    name: &'t str,
    /// `read` or `read_write`.
    access: &'t str,
    /// The type of its elements.
    element: &'t str,
    /// In how many pieces it lies.
    pieces: u32,
}

/// How a kernel uses an array that lies in pieces.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Use {
    /// `x[i]` as a value.
    Get,
    /// `x[i] = value`, or one component of it: `.w`
    Put(String),
    /// An atomic function, here `atomicAdd(&x[i], value)`.
    Call(String),
}

/// The text of a kernel whose array number `k`, in the order of bindings, lies in `pieces[k]`
/// pieces of `window` bytes. `None` if one of those has elements of a type that is not known here.
pub fn split(text: &str, pieces: &[u32], window: u64) -> Option<String> {
    let mut arrays = Vec::new();
    let mut uses = BTreeSet::new();
    // Declarations are written anew, each piece with a binding; all else is text to rewrite.
    let (mut declared, rest): (Vec<&str>, Vec<&str>) =
        text.lines().partition(|line| is_declaration(line));
    // Pieces are counted in the order of bindings, in which a text need not declare them.
    declared.sort_by_key(|line| binding(line));
    for (line, &pieces) in declared.into_iter().zip(pieces) {
        arrays.push(ArrayDeclaration::read(line, pieces)?);
    }
    let body = rewrite(&rest.join("\n"), &arrays, &mut uses);
    let mut out = String::new();
    let mut first = 1;
    for array in &arrays {
        out += &array.declaration(first);
        first += array.pieces;
    }
    out += &body;
    for (which, usage) in &uses {
        out += &arrays[*which].accessor(usage, window)?;
    }
    Some(out)
}

fn is_declaration(line: &str) -> bool {
    line.starts_with("@group(0)") && line.contains("var<storage")
}

fn binding(declaration: &str) -> Option<u32> {
    declaration
        .split_once("@binding(")?
        .1
        .split_once(')')?
        .0
        .parse()
        .ok()
}

impl<'t> ArrayDeclaration<'t> {
    /// `@group(0) @binding(1) var<storage, read> x: array<f32>;`
    fn read(line: &'t str, pieces: u32) -> Option<Self> {
        let (access, rest) = line.split_once("storage, ")?.1.split_once("> ")?;
        let (name, element) = rest.split_once(": array<")?;
        Some(Self {
            name,
            access,
            element: element.strip_suffix(">;")?,
            pieces,
        })
    }

    fn piece(&self, number: u32) -> String {
        if self.pieces == 1 {
            self.name.to_owned()
        } else {
            format!("{}_{number}", self.name)
        }
    }

    fn declaration(&self, first: u32) -> String {
        let Self {
            access, element, ..
        } = self;
        let one = |number| {
            let binding = first + number;
            let name = self.piece(number);
            format!(
                "@group(0) @binding({binding}) var<storage, {access}> {name}: array<{element}>;\n"
            )
        };
        (0..self.pieces).map(one).collect()
    }

    /// The function that stands for one use of the array.
    fn accessor(&self, usage: &Use, window: u64) -> Option<String> {
        let per_piece = window / bytes_of(self.element)?;
        let (parameters, result) = match usage {
            Use::Get => ("i: u32".to_owned(), format!(" -> {}", self.element)),
            Use::Put(part) if part.is_empty() => {
                (format!("i: u32, value: {}", self.element), String::new())
            }
            // One component: the last letter of the vector's type tells `f32` from `u32`.
            Use::Put(_) => (
                format!("i: u32, value: {}32", self.element.chars().last()?),
                String::new(),
            ),
            Use::Call(_) => ("i: u32, value: u32".to_owned(), " -> u32".to_owned()),
        };
        let case = |number| {
            let label = if number + 1 < self.pieces {
                format!("case {number}u")
            } else {
                "default".to_owned()
            };
            let place = format!("{}[i % {per_piece}u]", self.piece(number));
            let statement = match usage {
                Use::Get => format!("return {place}"),
                Use::Put(part) => format!("{place}{part} = value"),
                Use::Call(function) => format!("return {function}(&{place}, value)"),
            };
            format!("        {label}: {{ {statement}; }}\n")
        };
        let cases: String = (0..self.pieces).map(case).collect();
        let name = self.function(usage);
        Some(format!(
            "\nfn {name}({parameters}){result} {{\n    switch i / {per_piece}u {{\n{cases}    }}\n}}\n"
        ))
    }

    fn function(&self, usage: &Use) -> String {
        match usage {
            Use::Get => format!("get_{}", self.name),
            Use::Put(part) => format!("put_{}{}", self.name, part.replace('.', "_")),
            Use::Call(function) => format!("{function}_{}", self.name),
        }
    }
}

fn bytes_of(element: &str) -> Option<u64> {
    match element {
        "f16" => Some(2),
        "f32" | "u32" | "i32" | "atomic<u32>" => Some(4),
        "vec2f" | "vec2u" => Some(8),
        "vec4f" | "vec4u" => Some(16),
        _ => None,
    }
}

fn is_name(c: char) -> bool {
    c.is_alphanumeric() || c == '_'
}

/// The text with every use of an array that lies in pieces as a call, and what uses there were.
fn rewrite(text: &str, arrays: &[ArrayDeclaration], uses: &mut BTreeSet<(usize, Use)>) -> String {
    let mut out = String::new();
    let mut rest = text;
    while let Some(open) = rest.find('[') {
        let start = rest[..open]
            .rfind(|c| !is_name(c))
            .map_or(0, |before| before + 1);
        let Some(which) = arrays
            .iter()
            .position(|array| array.name == &rest[start..open] && array.pieces > 1)
        else {
            out.push_str(&rest[..=open]);
            rest = &rest[open + 1..];
            continue;
        };
        out.push_str(&rest[..start]);
        let (index, after) = bracketed(&rest[open + 1..]);
        // Within the index, other arrays in pieces may be read.
        let index = rewrite(index, arrays, uses);
        let (usage, value, after) = usage(&mut out, after);
        let function = arrays[which].function(&usage);
        out += &match (&usage, value) {
            (Use::Call(_), _) => format!("{function}({index}"),
            (_, Some(value)) => format!("{function}({index}, {})", rewrite(value, arrays, uses)),
            (_, None) => format!("{function}({index})"),
        };
        uses.insert((which, usage));
        rest = after;
    }
    out + rest
}

/// What is done with an element, by what stands around it; the value that it is given; and the text
/// behind.
fn usage<'t>(before: &mut String, after: &'t str) -> (Use, Option<&'t str>, &'t str) {
    if let Some(call) = before.strip_suffix("(&") {
        let start = call.rfind(|c| !is_name(c)).map_or(0, |end| end + 1);
        let function = call[start..].to_owned();
        before.truncate(start);
        // `&x_0` cannot be chosen by a function: WGSL gives no pointers to storage back.
        return (Use::Call(function), None, after);
    }
    let part = |name: &str| 1 + name.find(|c| !is_name(c)).unwrap_or(name.len());
    let end = after.strip_prefix('.').map_or(0, part);
    match after[end..]
        .strip_prefix(" = ")
        .and_then(|value| Some((value, value.find(';')?)))
    {
        Some((value, len)) => (
            Use::Put(after[..end].to_owned()),
            Some(&value[..len]),
            &value[len..],
        ),
        None => (Use::Get, None, after),
    }
}

/// What stands before the bracket that closes, and after it.
fn bracketed(text: &str) -> (&str, &str) {
    let mut depth = 1;
    for (at, c) in text.char_indices() {
        depth += i32::from(c == '[') - i32::from(c == ']');
        if depth == 0 {
            return (&text[..at], &text[at + 1..]);
        }
    }
    panic!("split: a bracket of `{text}` is not closed")
}

#[cfg(test)]
mod tests {
    use super::split;

    const KERNEL: &str = "@group(0) @binding(1) var<storage, read> x: array<u32>;
@group(0) @binding(2) var<storage, read> y: array<f32>;
@group(0) @binding(3) var<storage, read_write> out: array<vec4f>;
fn main() {
    out[x[y_at(3u)]] = vec4f(y[x[1]] + part[x[2]]);
    out[i].w = y[i] == 0.0;
    atomicAdd(&x[i], 1u);
}";

    #[test]
    fn accesses_become_calls_and_bindings_are_counted_anew() {
        let text = split(KERNEL, &[2, 1, 3], 64).unwrap();
        for expected in [
            "@binding(1) var<storage, read> x_0: array<u32>;\n@group(0) @binding(2) var<storage, read> x_1",
            "@binding(3) var<storage, read> y: array<f32>;",
            "@binding(6) var<storage, read_write> out_2: array<vec4f>;",
            "    put_out(get_x(y_at(3u)), vec4f(y[get_x(1)] + part[get_x(2)]));\n",
            "    put_out_w(i, y[i] == 0.0);\n    atomicAdd_x(i, 1u);\n",
            "fn get_x(i: u32) -> u32 {\n    switch i / 16u {\n        case 0u: { return x_0[i % 16u]; }\n",
            "fn put_out_w(i: u32, value: f32) {\n    switch i / 4u {\n        case 0u: { out_0[i % 4u].w = value; }\n",
            "        default: { return atomicAdd(&x_1[i % 16u], value); }\n",
        ] {
            assert!(text.contains(expected), "no `{expected}` in\n{text}");
        }
    }

    #[test]
    fn elements_of_an_unknown_type_cannot_be_split() {
        assert_eq!(
            split(
                &KERNEL.replace("array<vec4f>", "array<Level>"),
                &[1, 1, 2],
                64
            ),
            None
        );
    }
}
