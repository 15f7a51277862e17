//! What one step looks at: some views in turn, a window of each, and their low-resolution images
//! with noise. Knows no rule.

use compute::elementwise::add;
use compute::shape::concat;
use compute::{Array, Device, Rng};

use super::residual::Residual;
use super::view::ViewLatents;
use super::window::Window;
use crate::schedule::Schedule;

/// Where the batches of a run come from: a function of the step's number alone.
#[derive(Clone, Debug)]
pub(super) struct Batches {
    /// The views' numbers in the order in which they take their turns.
    order: Vec<usize>,
    /// How many views a batch has.
    len: usize,
    /// Height and width of every window.
    size: [usize; 2],
    window: Rng,
    low_noise: Rng,
}

/// The views of one step, N of them, and the window of each.
#[derive(Clone, Debug)]
pub(super) struct Batch {
    /// The views' numbers, each once, and their windows.
    pub windows: Vec<(usize, Window)>,
    /// The encoded latents z in the windows, `[N, C, h, w]`.
    pub latents: Array,
    /// The noised low-resolution images in the windows, `[N, 3, h, w]`.
    pub low: Array,
    /// Each view's camera, `[N, 16]`.
    pub cameras: Array,
}

impl Batches {
    /// Batches of `batch` of the views, or of all where there are fewer; `size` is the height and
    /// width of every window.
    pub fn new(views: usize, batch: usize, size: [usize; 2], seed: u64) -> Self {
        Self {
            // One order for the whole run. The batch of a step is then a function of the step's
            // number, and a resumed run needs no list.
            order: shuffled(views, &Rng::new(seed, "optimize/order")),
            len: views.min(batch),
            size,
            window: Rng::new(seed, "optimize/window"),
            low_noise: Rng::new(seed, "optimize/low_noise"),
        }
    }

    /// The batch of step `step`.
    pub fn at(
        &self,
        step: u64,
        views: &[ViewLatents],
        low: (&Schedule, u32),
        device: &Device,
    ) -> Batch {
        // Turns go on where the last batch ended: every view is seen equally often, even where the
        // batch does not divide their number.
        let first = step as usize * self.len;
        let windows: Vec<_> = (first..first + self.len)
            .map(|turn| self.order[turn % self.order.len()])
            .collect();
        let windows: Vec<_> = (0..)
            .zip(windows)
            .map(|(i, view)| (view, self.window(step, i, &views[view])))
            .collect();
        let cameras: Vec<f32> = windows
            .iter()
            .flat_map(|&(view, _)| views[view].camera)
            .collect();
        Batch {
            latents: join(
                windows
                    .iter()
                    .map(|(view, window)| window.crop(&views[*view].latent)),
            ),
            low: self.noised_low(step, views, &windows, low, device),
            cameras: device.array(&[windows.len(), 16], cameras),
            windows,
        }
    }

    fn window(&self, step: u64, place: u64, view: &ViewLatents) -> Window {
        // Two draws for each place in the batch: row and column.
        let draw = |axis, n| self.window.below(step, 2 * place + axis, n);
        Window::around_any_pixel(self.size, view.size(), draw)
    }

    fn noised_low(
        &self,
        step: u64,
        views: &[ViewLatents],
        windows: &[(usize, Window)],
        (schedule, level): (&Schedule, u32),
        device: &Device,
    ) -> Array {
        let low = join(
            windows
                .iter()
                .map(|(view, window)| window.crop(&views[*view].low)),
        );
        // A single timestep for all views: the noise level is an option, not drawn.
        schedule.add_noise(
            &low,
            &self.low_noise.normals(step, low.shape(), device),
            &[level],
        )
    }
}

impl Batch {
    /// How many views there are.
    pub fn len(&self) -> usize {
        self.windows.len()
    }

    /// The current latents z' = z + h in the windows, `[N, C, h, w]`.
    pub fn current(&self, residuals: &[Residual]) -> Array {
        let values = self
            .windows
            .iter()
            .flat_map(|(view, window)| residuals[*view].crop(window))
            .collect();
        add(
            &self.latents,
            &self.latents.device().array(self.latents.shape(), values),
        )
    }

    /// The cameras, with zeros in place of those that `keep` drops.
    pub fn cameras_kept(&self, keep: impl Fn(u64) -> bool) -> Array {
        // The last number of a camera-to-world matrix is 1, so that zeros can stand for no camera.
        let mut cameras = self.cameras.to_vec();
        for (_, camera) in (0..).zip(cameras.chunks_mut(16)).filter(|(i, _)| !keep(*i)) {
            camera.fill(0.0);
        }
        self.cameras.device().array(self.cameras.shape(), cameras)
    }
}

fn join(parts: impl Iterator<Item = Array>) -> Array {
    let parts: Vec<Array> = parts.collect();
    concat(&parts.iter().collect::<Vec<_>>(), 0)
}

/// The numbers below `n` in an order drawn evenly (Fisher and Yates).
fn shuffled(n: usize, rng: &Rng) -> Vec<usize> {
    let mut order: Vec<usize> = (0..n).collect();
    for i in (1..n).rev() {
        order.swap(i, rng.below(0, i as u64, i as u32 + 1) as usize);
    }
    order
}
