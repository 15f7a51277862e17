//! In which tiles an adapter computes matrix products fastest, by trying: it sits above the
//! products that it times. It knows no file.
//!
//! All tiles sum along the depth in one order, so that a choice changes how long a product takes
//! and no bit of it: what was measured need not be measured alike again.

use std::time::{Duration, Instant};

use super::conv::geometry::{Conv, Geometry};
use super::conv::gpu::forward_product;
use super::product::gpu::product::Product;
use crate::runtime::device::Device;
use crate::runtime::gpu::context::Gpu;
use crate::runtime::gpu::each::fill;
use crate::runtime::gpu::error::GpuError;
use crate::runtime::gpu::fault::attempt;
use crate::runtime::gpu::tile::{LARGE, TILES, Tile};
use crate::runtime::gpu::tuning::{Class, Tuning};

/// What is timed at once, so that starting it does not count.
const TOGETHER: usize = 4;
/// How often; the least time counts.
const TIMES: usize = 3;

impl Device {
    /// In which tiles a GPU computes matrix products, as text.
    pub fn tuning(&self) -> Option<String> {
        Some(self.open_gpu()?.tuning().to_string())
    }

    /// Takes the tiles that [`Device::tuning`] told of, on the same adapter. Whether the text was
    /// one.
    pub fn tune(&self, text: &str) -> bool {
        let found = self.open_gpu().zip(Tuning::read(text));
        found.inspect(|(gpu, tuning)| gpu.tune(*tuning)).is_some()
    }

    /// Tries which tiles are the fastest, in a second or so on hardware, and takes them. No result
    /// depends on it.
    pub fn measure(&self) -> Result<(), GpuError> {
        let Some(gpu) = self.open_gpu() else {
            return Ok(());
        };
        attempt(|| gpu.tune(measure(gpu, 1)))
    }
}

/// Tries all tiles on products of every kind, of an extent that networks have divided by `less`
/// each way.
fn measure(gpu: &Gpu, less: usize) -> Tuning {
    Tuning::of(|class| {
        let timed = TILES.map(|tile| (time(gpu, || run(class, gpu, tile, less)), tile));
        timed
            .into_iter()
            .min_by_key(|(time, _)| *time)
            .map_or(class.usual(), |(_, tile)| tile)
    })
}

/// Computes a product of this kind in a tile, of an extent that networks have divided by `less`
/// each way.
fn run(class: Class, gpu: &Gpu, tile: Tile, less: usize) {
    let channels = 256 / less;
    let more = if class.usual() == LARGE { 2 } else { 1 };
    let [rows, columns] = [1024, 512].map(|n| more * n / less);
    let side = more * 32 / less;
    match class {
        Class::FewDense | Class::ManyDense => {
            // Zeros will do: products do not branch on the numbers.
            let a = fill(gpu, rows * channels, 0.0);
            let b = fill(gpu, channels * columns, 0.0);
            let strides = [channels, 1, 1, channels];
            Product::dense((&a).into(), (&b).into(), [rows, channels, columns], strides)
                .run_in(gpu, tile);
        }
        Class::FewConv | Class::ManyConv => {
            let x = fill(gpu, channels * side * side, 0.0);
            let w = fill(gpu, channels * channels * 9, 0.0);
            let conv = Conv::padded(1);
            let g = Geometry::new("tuning", [1, channels, side, side], channels, [3, 3], conv);
            forward_product(&x, (&w).into(), None, &g).run_in(gpu, tile);
        }
    }
}

/// The least time of several, after a first one that compiles.
fn time(gpu: &Gpu, work: impl Fn()) -> Duration {
    let finish = || {
        // What waits in the queue would be timed with the next.
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
        let tuning = measure(device.gpu_context(), 16);
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
