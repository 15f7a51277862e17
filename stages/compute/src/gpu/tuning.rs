//! In which tiles an adapter computes matrix products fastest: measured in a second or two, told as
//! text. It knows no file.
//!
//! All tiles sum along the depth in one order, so that a choice changes how long a product takes
//! and no bit of it: what was measured need not be measured alike again.

use std::fmt;
use std::time::{Duration, Instant};

use super::context::Gpu;
use super::conv;
use super::map::fill;
use super::product::{LARGE, Product, SQUARE, TILES, Tile};
use crate::conv::{Conv, Geometry};

/// What is timed at once, so that starting it does not count.
const TOGETHER: usize = 4;
/// How often; the least time counts.
const TIMES: usize = 3;

/// Kinds of products that have a tile each: how they read their factors, and how many tiles there
/// are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Class {
    /// Of linear layers, with too few large tiles for all processors of a GPU.
    FewDense,
    /// Of linear layers, with enough.
    ManyDense,
    /// Of convolutions, with too few.
    FewConv,
    /// Of convolutions, with enough.
    ManyConv,
}

impl Class {
    const ALL: [Class; 4] = [
        Class::FewDense,
        Class::ManyDense,
        Class::FewConv,
        Class::ManyConv,
    ];

    /// The kind of a product that is not thin.
    pub fn of(is_dense: bool, is_many: bool) -> Class {
        Class::ALL[usize::from(is_many) + 2 * usize::from(!is_dense)]
    }

    fn name(self) -> &'static str {
        [
            "linear, few tiles",
            "linear, many tiles",
            "convolution, few tiles",
            "convolution, many tiles",
        ][self as usize]
    }

    /// The tile until something was measured.
    fn usual(self) -> Tile {
        if matches!(self, Class::FewDense | Class::FewConv) {
            SQUARE
        } else {
            LARGE
        }
    }

    /// Computes a product of this kind in a tile, of an extent that networks have divided by `less`
    /// each way.
    fn run(self, gpu: &Gpu, tile: Tile, less: usize) {
        let channels = 256 / less;
        let more = if self.usual() == LARGE { 2 } else { 1 };
        let [rows, columns] = [1024, 512].map(|n| more * n / less);
        let side = more * 32 / less;
        match self {
            Class::FewDense | Class::ManyDense => {
                let a = fill(gpu, rows * channels, 0.0);
                let b = fill(gpu, channels * columns, 0.0);
                let strides = [channels, 1, 1, channels];
                Product::dense((&a).into(), (&b).into(), [rows, channels, columns], strides)
                    .run_in(gpu, tile);
            }
            Class::FewConv | Class::ManyConv => {
                let x = fill(gpu, channels * side * side, 0.0);
                let w = fill(gpu, channels * channels * 9, 0.0);
                conv::forward_product(&x, (&w).into(), None, &geometry(channels, side))
                    .run_in(gpu, tile);
            }
        }
    }
}

/// A 3x3 convolution that keeps the number of channels.
fn geometry(channels: usize, side: usize) -> Geometry {
    let conv = Conv::padded(1);
    let [height, width, out_height, out_width] = [side; 4];
    Geometry {
        batch: 1,
        channels,
        height,
        width,
        outputs: channels,
        kernel: [3, 3],
        conv,
        out_height,
        out_width,
    }
}

/// The tile of every kind of products.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tuning([Tile; 4]);

impl Default for Tuning {
    fn default() -> Tuning {
        Tuning(Class::ALL.map(Class::usual))
    }
}

impl Tuning {
    /// Tries all tiles on products of every kind, of an extent that networks have divided by `less`
    /// each way.
    pub fn measure(gpu: &Gpu, less: usize) -> Tuning {
        Tuning(Class::ALL.map(|class| {
            let timed = TILES.map(|tile| (time(gpu, || class.run(gpu, tile, less)), tile));
            timed
                .into_iter()
                .min_by_key(|(time, _)| *time)
                .map_or(class.usual(), |(_, tile)| tile)
        }))
    }

    /// The tile of a kind.
    pub fn tile(&self, class: Class) -> Tile {
        self.0[class as usize]
    }

    /// What [`fmt::Display`] wrote; `None` if that does not name a tile for every kind.
    pub fn read(text: &str) -> Option<Tuning> {
        let tile = |class: Class| {
            let name = text
                .lines()
                .find_map(|line| line.strip_prefix(class.name())?.strip_prefix(": "))?;
            TILES.into_iter().find(|tile| tile.to_string() == name)
        };
        let [a, b, c, d] = Class::ALL.map(tile);
        Some(Tuning([a?, b?, c?, d?]))
    }
}

impl fmt::Display for Tuning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        Class::ALL
            .iter()
            .try_for_each(|class| writeln!(f, "{}: {}", class.name(), self.tile(*class)))
    }
}

/// The least time of several, after a first one that compiles.
fn time(gpu: &Gpu, work: impl Fn()) -> Duration {
    let finish = || {
        gpu.submit();
        gpu.wait();
    };
    work();
    finish();
    let once = || {
        let begun = Instant::now();
        (0..TOGETHER).for_each(|_| work());
        finish();
        begun.elapsed()
    };
    (0..TIMES).map(|_| once()).min().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;

    #[test]
    fn what_was_measured_is_read_back() {
        let Some(device) = testing::gpu() else { return };
        let tuning = Tuning::measure(device.gpu_context(), 16);
        assert_eq!(Tuning::read(&tuning.to_string()), Some(tuning));
        assert_eq!(
            Tuning::read(
                &tuning
                    .to_string()
                    .replace("linear, few tiles: ", "linear, few tiles: 7x")
            ),
            None
        );
        assert_eq!(Tuning::read(""), None);
    }

    #[test]
    fn every_tile_gives_the_same_bits() {
        let Some(device) = testing::gpu() else { return };
        let gpu = device.gpu_context();
        let pattern = |len: usize| {
            let values: Vec<f32> = (0..len)
                .map(|i| (i * 7919 % 1000) as f32 / 500.0 - 1.0)
                .collect();
            gpu.upload(bytemuck::cast_slice(&values))
        };
        // One of few tiles and a cut depth; then one of many.
        for [rows, depth, columns] in [[70, 700, 90], [1030, 41, 1030]] {
            let a = pattern(rows * depth);
            let b = pattern(depth * columns);
            let product = Product::dense(
                (&a).into(),
                (&b).into(),
                [rows, depth, columns],
                [depth, 1, columns, 1],
            );
            let expected = gpu.read(&product.run(gpu), rows * columns);
            for tile in TILES {
                let got = gpu.read(&product.run_in(gpu, tile), rows * columns);
                assert!(
                    expected
                        .iter()
                        .zip(&got)
                        .all(|(a, b)| a.to_bits() == b.to_bits()),
                    "{tile}"
                );
            }
        }
    }
}
