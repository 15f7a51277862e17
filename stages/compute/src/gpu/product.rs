//! Every matrix product: of linear layers, and of convolutions, whose column matrix is never
//! formed. What differs is how the factors are read and in which tiles a product is cut.

use std::fmt;

use super::context::Gpu;
use super::kernel::Kernel;
use super::launch::{Each, bits, one};
use super::pool::Buffer;
use super::tuning::Class;
use crate::conv::Finish;
use crate::weight::Format;

const PRODUCT: &str = include_str!("wgsl/product.wgsl");

/// Tiles per product below which the depth is cut as well, so that a large GPU has something for
/// each of its processors.
const ENOUGH_TILES: usize = 64;
/// The least depth that is worth a workgroup of its own.
const LEAST_DEPTH: usize = 256;

/// A factor in device memory.
#[derive(Clone, Copy)]
pub struct Factor<'a> {
    /// Where its numbers lie.
    pub numbers: &'a Buffer,
    /// How they are stored.
    pub format: Format,
}

impl<'a> From<&'a Buffer> for Factor<'a> {
    fn from(numbers: &'a Buffer) -> Factor<'a> {
        Factor {
            numbers,
            format: Format::F32,
        }
    }
}

/// One product `[rows, depth] x [depth, columns]`, its factors read as a snippet of WGSL says.
pub struct Product<'a> {
    /// The snippet, which has `factor_a`, `column_place` and `factor_b`.
    pub factors: &'static str,
    /// The name of the snippet.
    pub name: &'static str,
    /// The left and the right factor.
    pub a: Factor<'a>,
    /// The right factor.
    pub b: Factor<'a>,
    /// Added to every row's (of an image's channel) or column's results.
    pub bias: Option<(&'a Buffer, Along)>,
    /// What becomes of the results, bias and all.
    pub finish: Finish<&'a Buffer>,
    /// Rows, depth and columns.
    pub extents: [usize; 3],
    /// Whether neighbours along the depth lie side by side in memory, in each factor.
    pub depth_first: [bool; 2],
    /// Columns of one image; all where there are none.
    pub pixels: usize,
    /// Strides of dense factors: `a` by row and depth, `b` by depth and column.
    pub strides: [usize; 4],
    /// Channels, height, width, output height and width, stride, top and left of a convolution.
    pub image: [usize; 8],
    /// Height and width of a convolution's kernel.
    pub kernel: [usize; 2],
}

/// What has a bias of its own.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Along {
    Rows,
    Columns,
}

/// How a product is cut: rows, columns and depth of a tile, rows and columns of one invocation. All
/// have 256 invocations.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tile {
    rows: usize,
    columns: usize,
    depth: usize,
    per_invocation: [usize; 2],
}

/// The tile that reads the factors the least often.
pub const LARGE: Tile = Tile {
    rows: 128,
    columns: 128,
    depth: 8,
    per_invocation: [8, 8],
};
/// The tile that cuts a product into the most parts.
pub const SQUARE: Tile = Tile {
    rows: 64,
    columns: 64,
    depth: 16,
    per_invocation: [4, 4],
};
const HIGH: Tile = Tile {
    rows: 128,
    columns: 64,
    depth: 16,
    per_invocation: [8, 4],
};
const BROAD: Tile = Tile {
    rows: 64,
    columns: 128,
    depth: 16,
    per_invocation: [4, 8],
};
/// What an adapter's tuning chooses from.
pub const TILES: [Tile; 4] = [SQUARE, HIGH, BROAD, LARGE];
const TALL: Tile = Tile {
    rows: 256,
    columns: 16,
    depth: 16,
    per_invocation: [4, 4],
};
const WIDE: Tile = Tile {
    rows: 16,
    columns: 256,
    depth: 16,
    per_invocation: [4, 4],
};

impl Tile {
    /// The largest tile that leaves enough of them; long ones where one extent is short. It says
    /// how the depth is cut, whichever tile an adapter is faster with: so that all give the same
    /// bits.
    fn usual(rows: usize, columns: usize) -> Tile {
        let large = rows.div_ceil(LARGE.rows) * columns.div_ceil(LARGE.columns);
        match (rows, columns) {
            (_, ..=16) if rows > 16 => TALL,
            (..=16, _) => WIDE,
            _ if large >= ENOUGH_TILES && rows > 64 && columns > 64 => LARGE,
            _ => SQUARE,
        }
    }

    /// How many of them a product has, by column and by row.
    fn count(self, rows: usize, columns: usize) -> [usize; 2] {
        [columns.div_ceil(self.columns), rows.div_ceil(self.rows)]
    }

    fn constants(self) -> Vec<(&'static str, u32)> {
        let [rows, columns] = self.per_invocation;
        let pitches = [self.rows / 4 + 1, self.columns / 4 + 1];
        let named = [
            ("TM", self.rows),
            ("TN", self.columns),
            ("TK", self.depth),
            ("RM", rows),
            ("RN", columns),
            ("QM", rows / 4),
            ("QN", columns / 4),
            ("A_PITCH", pitches[0]),
            ("B_PITCH", pitches[1]),
            ("A_TILE", self.depth * pitches[0]),
            ("B_TILE", self.depth * pitches[1]),
        ];
        named.map(|(name, value)| (name, value as u32)).to_vec()
    }
}

impl fmt::Display for Tile {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}x{}", self.rows, self.columns)
    }
}

impl<'a> Product<'a> {
    /// A product of two matrices that lie in memory, by the strides of each.
    pub fn dense(
        a: Factor<'a>,
        b: Factor<'a>,
        extents: [usize; 3],
        strides: [usize; 4],
    ) -> Product<'a> {
        Product {
            factors: include_str!("wgsl/dense.wgsl"),
            name: "product",
            a,
            b,
            bias: None,
            finish: Finish::None,
            extents,
            depth_first: [strides[1] == 1, strides[2] == 1 && strides[3] != 1],
            pixels: extents[2],
            strides,
            image: [0; 8],
            kernel: [1; 2],
        }
    }

    /// Computes it: `[rows, columns]`, or `[images, rows, pixels]`.
    pub fn run(&self, gpu: &Gpu) -> Buffer {
        let [rows, _, columns] = self.extents;
        let usual = Tile::usual(rows, columns);
        let is_thin = usual == TALL || usual == WIDE;
        let class = Class::of(self.image[0] == 0, usual == LARGE);
        self.run_in(
            gpu,
            if is_thin {
                usual
            } else {
                gpu.tuning().tile(class)
            },
        )
    }

    /// Computes it in tiles of one's choice.
    pub fn run_in(&self, gpu: &Gpu, tile: Tile) -> Buffer {
        let [rows, depth, columns] = self.extents;
        let usual = Tile::usual(rows, columns);
        let tiles = tile.count(rows, columns);
        let enough = usual.count(rows, columns).iter().product::<usize>();
        let parts = (depth / LEAST_DEPTH)
            .min(ENOUGH_TILES / enough.max(1))
            .clamp(1, 32);
        let chunk = depth.div_ceil(parts).next_multiple_of(usual.depth);
        let parts = depth.div_ceil(chunk).max(1);
        // Where the depth is cut, bias and finish come after its parts are joined.
        let whole = Product {
            bias: self.bias.filter(|_| parts == 1),
            finish: if parts == 1 {
                self.finish
            } else {
                Finish::None
            },
            ..*self
        };
        let mut reads = vec![self.a.numbers, self.b.numbers];
        reads.extend(whole.bias.map(|(bias, _)| bias));
        reads.extend(whole.added());
        let groups = [tiles[0] as u32, tiles[1] as u32, parts as u32];
        let len = rows * columns;
        let operations = 2 * (rows * depth * columns) as u64;
        let kernel = whole.kernel(tile, gpu.has_halves());
        let out = one(
            gpu,
            &kernel,
            &reads,
            parts * len,
            &self.words(chunk),
            groups,
            operations,
        );
        if parts == 1 {
            out
        } else {
            self.join(gpu, &out, parts, len)
        }
    }

    /// What the finish adds.
    fn added(&self) -> Option<&'a Buffer> {
        match self.finish {
            Finish::Add(other) => Some(other),
            _ => None,
        }
    }

    fn kernel(&self, tile: Tile, halves: bool) -> Kernel {
        let bias = self.bias.is_some();
        let mut constants = tile.constants();
        let [kh, kw] = self.kernel.map(|extent| extent as u32);
        let [a, b] = self.depth_first.map(u32::from);
        let reads = 2 + usize::from(bias) + usize::from(self.added().is_some());
        constants.extend([
            ("KH", kh),
            ("KW", kw),
            ("A_DEPTH_FIRST", a),
            ("B_MOVES", b),
            ("B_STAYS", 1 - b),
        ]);
        constants.push(("OUT", 1 + reads as u32));
        let start = if bias {
            BIASED
        } else {
            "fn start(i: u32) -> f32 {\n    return 0.0;\n}\n"
        };
        let [a, b] =
            [("a", 1, self.a.format), ("b", 2, self.b.format)].map(|(name, at, format)| {
                if halves && format == Format::F16 {
                    half_reader(name, at)
                } else {
                    reader(name, at, format)
                }
            });
        let halves = halves && [self.a.format, self.b.format].contains(&Format::F16);
        let kernel = Kernel::new(self.name, &[PRODUCT], [reads, 1]).with(&constants);
        let finish = finisher(self.finish, reads);
        Kernel {
            halves,
            ..kernel.having([a, b, start.into(), finish, self.factors.into()].concat())
        }
    }

    /// How outputs find their bias: the number `(i / inner) % count`.
    fn bias_at(&self) -> [usize; 2] {
        let [rows, _, columns] = self.extents;
        match self.bias {
            Some((_, Along::Rows)) => [self.pixels.max(1), rows],
            Some((_, Along::Columns)) => [1, columns],
            None => [1, 1],
        }
    }

    fn words(&self, chunk: usize) -> Vec<u32> {
        let first = self.extents;
        let [inner, count] = self.bias_at();
        let words = [
            first[0],
            first[2],
            first[1],
            chunk,
            self.pixels,
            inner,
            count,
        ];
        words
            .iter()
            .chain(&self.strides)
            .chain(&self.image)
            .map(|&word| word as u32)
            .chain([self.slope()])
            .collect()
    }

    /// The bits of the finish's slope; without one, any.
    fn slope(&self) -> u32 {
        match self.finish {
            Finish::Leaky(slope) => bits(slope),
            _ => 0,
        }
    }

    /// Sums the parts of the depth in their order, adds the bias and finishes.
    fn join(&self, gpu: &Gpu, parts: &Buffer, count: usize, len: usize) -> Buffer {
        let [inner, biases] = self.bias_at();
        let words = [
            ("parts: u32", count as u32),
            ("inner: u32", inner as u32),
            ("count: u32", biases as u32),
            ("slope: f32", self.slope()),
        ];
        let sum = "var sum = 0.0;
    for (var part = 0u; part < p.parts; part++) {
        sum += x[part * p.len + i];
    }
";
        let mut reads = vec![("x: f32", parts)];
        let mut value = String::from(sum);
        if let Some((bias, _)) = self.bias {
            reads.push(("bias: f32", bias));
            value += "    sum += bias[i / p.inner % p.count];\n";
        }
        reads.extend(self.added().map(|added| ("added: f32", added)));
        value += &format!("    return {};", finished("sum", self.finish));
        Each {
            name: "join",
            reads: &reads,
            words: &words,
            value: &value,
            functions: "",
        }
        .run(gpu, len)
    }
}

const BIASED: &str = "@group(0) @binding(3) var<storage, read> bias: array<f32>;
fn start(i: u32) -> f32 {
    return bias[i / p.bias_inner % p.bias_count];
}
";

/// The number `x`, finished, as WGSL: the same as on the CPU.
fn finished(x: &str, finish: Finish<&Buffer>) -> String {
    match finish {
        Finish::None => x.to_owned(),
        Finish::Leaky(_) => format!("select(p.slope * {x}, {x}, {x} > 0.0)"),
        Finish::Add(_) => format!("{x} + added[i]"),
    }
}

/// A function that finishes result `i`, and the declaration of what it adds, at `binding`.
fn finisher(finish: Finish<&Buffer>, binding: usize) -> String {
    let declared = match finish {
        Finish::Add(_) => {
            format!("@group(0) @binding({binding}) var<storage, read> added: array<f32>;\n")
        }
        _ => String::new(),
    };
    let value = finished("x", finish);
    format!("{declared}fn finish(i: u32, x: f32) -> f32 {{\n    return {value};\n}}\n")
}

/// The declaration of a factor, and a function that reads and widens one number of it.
fn reader(name: &str, binding: u32, format: Format) -> String {
    let (element, value) = match format {
        Format::F32 => ("f32", format!("return {name}[i];")),
        Format::F16 => (
            "u32",
            format!("return unpack2x16float({name}[i / 2u])[i % 2u];"),
        ),
        Format::Bf16 => (
            "u32",
            format!("return bitcast<f32>({name}[i / 2u] >> (i % 2u * 16u) << 16u);"),
        ),
    };
    format!(
        "@group(0) @binding({binding}) var<storage, read> {name}: array<{element}>;\n\
         fn {name}_at(i: u32) -> f32 {{\n    {value}\n}}\nalias quad_{name} = vec4f;\n"
    )
}

/// The same of halves, by kernels that can name them: they stay halves in the memory that a
/// workgroup shares.
fn half_reader(name: &str, binding: u32) -> String {
    format!(
        "@group(0) @binding({binding}) var<storage, read> {name}: array<f16>;\n\
         fn {name}_at(i: u32) -> f32 {{\n    return f32({name}[i]);\n}}\nalias quad_{name} = vec4<f16>;\n"
    )
}
