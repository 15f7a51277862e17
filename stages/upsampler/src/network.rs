//! What every upsampler is to those that run it: a function of images, and a few facts about it.

use compute::Array;

/// What is known of a network without running it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Facts {
    /// The architecture, as `model check` prints it: `SPAN`.
    pub family: &'static str,
    /// The result's side over the image's.
    pub scale: usize,
    /// Channels between its layers, at the most.
    pub width: usize,
    /// Blocks, or convolutions where there are no blocks, in words: "6 blocks".
    pub depth: String,
    /// How many pixels away an input may be from those that it changes.
    pub reach: usize,
    /// Of what the image's sides must be multiples.
    pub grain: usize,
    /// Bytes that its layers hold at once for each pixel of the image, roughly.
    pub bytes_per_pixel: usize,
}

/// A network that enlarges images.
pub trait Network: Send + Sync {
    /// `x [N, 3, H, W]`, 0 to 1, enlarged: `[N, 3, H scale, W scale]`. H and W are multiples of the
    /// grain.
    fn forward(&self, x: &Array) -> Array;

    /// What is known of it.
    fn facts(&self) -> Facts;
}
