//! Every matrix product: of linear layers, and of convolutions, whose column matrix is never
//! formed. What differs is how the factors are read and in which tiles a product is cut.

use super::epilogue::{Bias, Epilogue};
use super::reader::reader;
use super::tiling::{Choice, Tiling, choose};
use crate::ops::product::finish::Finish;
use crate::runtime::format::Format;
use crate::runtime::gpu::context::Gpu;
use crate::runtime::gpu::factor::Factor;
use crate::runtime::gpu::kernel::Kernel;
use crate::runtime::gpu::launch::one;
use crate::runtime::gpu::params::params;
use crate::runtime::gpu::pool::Buffer;
use crate::runtime::gpu::tile::Tile;
use crate::runtime::gpu::tuning::Class;

const PRODUCT: &str = include_str!("product.wgsl");

params! {
    /// What the template and the snippets of factors are told of a product.
    struct Extents {
        rows: u32,
        columns: u32,
        depth: u32,
        /// The part of the depth that one workgroup along z sums.
        chunk: u32,
        /// Columns of one image; all of them where there are no images.
        pixels: u32,
        /// The bias of output i is number (i / bias_inner) % bias_count.
        bias_inner: u32,
        bias_count: u32,
        /// Strides of dense factors.
        a_row: u32,
        a_depth: u32,
        b_depth: u32,
        b_column: u32,
        /// The images of a convolution.
        channels: u32,
        height: u32,
        width: u32,
        out_height: u32,
        out_width: u32,
        stride: u32,
        top: u32,
        left: u32,
        /// What results below 0 are multiplied by, where that is the finish.
        slope: f32,
    }
}

/// One product `[rows, depth] x [depth, columns]`, its factors read as a snippet of WGSL says.
pub struct Product<'a> {
    /// The snippet, which has `factor_a`, `column_place` and `factor_b`.
    pub factors: &'static str,
    /// The name of the snippet.
    pub name: &'static str,
    /// The left factor, which `factor_a` reads, and the right one, which `factor_b` reads.
    pub a: Factor<'a>,
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
    /// The images of a convolution.
    pub images: Option<Images>,
    /// Height and width of a convolution's kernel.
    pub kernel: [usize; 2],
}

/// What a convolution reads, pixel by pixel.
#[derive(Clone, Copy, Default)]
pub struct Images {
    /// Those that are read.
    pub channels: usize,
    pub height: usize,
    pub width: usize,
    pub out_height: usize,
    pub out_width: usize,
    pub stride: usize,
    /// Zeros above and left of the image.
    pub top: usize,
    pub left: usize,
}

/// What has a bias of its own.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Along {
    Rows,
    Columns,
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
            factors: include_str!("dense.wgsl"),
            name: "product",
            a,
            b,
            bias: None,
            finish: Finish::None,
            extents,
            depth_first: [strides[1] == 1, strides[2] == 1 && strides[3] != 1],
            pixels: extents[2],
            strides,
            images: None,
            kernel: [1; 2],
        }
    }

    /// Computes it: `[rows, columns]`, or `[images, rows, pixels]`.
    pub fn run(&self, gpu: &Gpu) -> Buffer {
        let [rows, _, columns] = self.extents;
        let tile = match choose(rows, columns) {
            Choice::Thin(tile) => tile,
            Choice::Tuned { many } => gpu.tuning().tile(Class::of(self.images.is_none(), many)),
        };
        self.run_in(gpu, tile)
    }

    /// Computes it in tiles of one's choice.
    pub fn run_in(&self, gpu: &Gpu, tile: Tile) -> Buffer {
        let tiling = Tiling::new(self.extents, tile);
        let epilogue = self.epilogue();
        if tiling.parts == 1 {
            return self.sum(gpu, &tiling, &epilogue);
        }
        // Where the depth is cut, bias and finish come after its parts are joined.
        let parts = self.sum(gpu, &tiling, &Epilogue::NOTHING);
        let [rows, _, columns] = self.extents;
        epilogue.join(gpu, &parts, tiling.parts, rows * columns)
    }

    /// The sums of all parts of the depth, one part behind the other.
    fn sum(&self, gpu: &Gpu, tiling: &Tiling, epilogue: &Epilogue) -> Buffer {
        let [rows, depth, columns] = self.extents;
        let [across, down] = tiling.tiles;
        let mut reads = vec![self.a.numbers, self.b.numbers];
        reads.extend(epilogue.reads());
        one(
            gpu,
            &self.kernel(tiling.tile, epilogue, gpu.has_halves()),
            &reads,
            tiling.parts * rows * columns,
            self.params(tiling.chunk, epilogue),
            [across, down, tiling.parts].map(|count| count as u32),
            2 * (rows * depth * columns) as u64,
        )
    }

    fn epilogue(&self) -> Epilogue<'a> {
        let [rows, _, columns] = self.extents;
        let bias = self.bias.map(|(numbers, along)| {
            let (inner, count) = match along {
                Along::Rows => (self.pixels.max(1), rows),
                Along::Columns => (1, columns),
            };
            Bias {
                numbers,
                inner,
                count,
            }
        });
        Epilogue {
            bias,
            finish: self.finish,
        }
    }

    fn kernel(&self, tile: Tile, epilogue: &Epilogue, halves: bool) -> Kernel<Extents> {
        let reads = 2 + epilogue.reads().len();
        let halves_of = |factor: Factor| halves && factor.format == Format::F16;
        // Bindings 1 and 2 are the factors; what the epilogue reads follows, in the order of
        // `reads`.
        let head = [
            reader("a", 1, self.a.format, halves),
            reader("b", 2, self.b.format, halves),
            epilogue.functions(3),
            self.factors.into(),
        ];
        Kernel::new(self.name, &[PRODUCT], [reads, 1])
            .with(&self.constants(tile, reads))
            .having(head.concat())
            .naming_halves(halves_of(self.a) || halves_of(self.b))
    }

    fn constants(&self, tile: Tile, reads: usize) -> Vec<(&'static str, u32)> {
        let mut constants = tile.constants();
        let [kh, kw] = self.kernel.map(|extent| extent as u32);
        let [a, b] = self.depth_first.map(u32::from);
        constants.extend([
            ("KH", kh),
            ("KW", kw),
            ("A_DEPTH_FIRST", a),
            ("B_MOVES", b),
            ("B_STAYS", 1 - b),
            ("OUT", 1 + reads as u32),
        ]);
        constants
    }

    fn params(&self, chunk: usize, epilogue: &Epilogue) -> Extents {
        let [rows, depth, columns] = self.extents.map(|extent| extent as u32);
        let [bias_inner, bias_count] = epilogue.bias_at();
        let [a_row, a_depth, b_depth, b_column] = self.strides.map(|stride| stride as u32);
        let images = self.images.unwrap_or_default();
        Extents {
            rows,
            columns,
            depth,
            chunk: chunk as u32,
            pixels: self.pixels as u32,
            bias_inner,
            bias_count,
            a_row,
            a_depth,
            b_depth,
            b_column,
            channels: images.channels as u32,
            height: images.height as u32,
            width: images.width as u32,
            out_height: images.out_height as u32,
            out_width: images.out_width as u32,
            stride: images.stride as u32,
            top: images.top as u32,
            left: images.left as u32,
            slope: epilogue.slope(),
        }
    }
}
