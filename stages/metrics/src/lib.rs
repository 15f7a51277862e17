//! PSNR, SSIM, FLIP, SSIMULACRA2, LPIPS, NIQE and consistency, each under an honest name, and the drawing
//! of comparison figures.
//!
//! Knows pictures as plain slices of sRGB-encoded numbers. Knows nothing of stages, artefacts,
//! cameras or fields: whoever calls it decides which pictures may be compared. What each figure
//! measures is told on its function and, for readers of results, in `docs/metrics.md`.
//!
//! ```
//! use metrics::{Image, psnr};
//!
//! let truth = [0.5; 4 * 4 * 3];
//! let render = [0.6; 4 * 4 * 3];
//! let decibels = psnr(Image::new(4, 4, &truth), Image::new(4, 4, &render));
//! assert!((decibels - 20.0).abs() < 1e-3, "a tenth off everywhere");
//! ```

mod consistency;
mod eigen;
mod exposed;
mod figure;
mod flip;
mod gaussian;
mod image;
mod lpips;
mod niqe;
mod psnr;
mod ssim;
mod ssimulacra2;
mod warp;

pub use consistency::psnr_lr_consistency;
pub use exposed::exposed;
pub use figure::{Figure, Panel, comparison};
pub use flip::{Flip, flip};
pub use image::Image;
pub use lpips::{Lpips, LpipsError};
pub use niqe::{Niqe, niqe};
pub use psnr::{MAX_PSNR, psnr};
pub use ssim::ssim;
pub use ssimulacra2::ssimulacra2;
pub use warp::{Surface, Warped, warped};

/// The columns of a table of metrics, the most telling first: each name with one sentence on what
/// it measures, which says `higher is` or `lower is` where one of them is better.
pub const DEFINITIONS: [(&str, &str); 15] = [
    (
        "psnr_hr",
        "PSNR in dB against a held-out photo: sRGB, all pixels and channels of a view, at most 100; higher is better",
    ),
    (
        "psnr_hr_exposed",
        "psnr_hr of a view after a gain and an offset per channel that bring it closest to the photo; higher is better",
    ),
    (
        "psnr_hr_posed",
        "psnr_hr of a view from where the field shows the photo best, by gradient descent on its camera; higher is better",
    ),
    (
        "ssim_hr",
        "SSIM against a held-out photo: sRGB, 11x11 Gaussian of sigma 1.5, mean over channels; higher is better",
    ),
    (
        "flip_hr",
        "FLIP against a held-out photo: LDR, 67 pixels per degree, mean of the map, 0 to 1; lower is better",
    ),
    (
        "ssimulacra2_hr",
        "SSIMULACRA2 against a held-out photo: 100 is identical, 70 is high quality, no floor; higher is better",
    ),
    (
        "lpips_alex",
        "LPIPS 0.1 with AlexNet against a held-out photo: 0 is identical; lower is better",
    ),
    (
        "lpips_vgg",
        "LPIPS 0.1 with VGG-16 against a held-out photo: 0 is identical; lower is better",
    ),
    (
        "lpips_squeeze",
        "LPIPS 0.1 with SqueezeNet 1.1 against a held-out photo: 0 is identical; lower is better",
    ),
    (
        "stlpips_alex",
        "shift-tolerant LPIPS with AlexNet against a held-out photo: 0 is identical; lower is better",
    ),
    (
        "stlpips_vgg",
        "shift-tolerant LPIPS with VGG-16 against a held-out photo: 0 is identical; lower is better",
    ),
    (
        // NIQE knows no truth: it belongs after all columns that have one.
        "niqe_y",
        "NIQE, no reference: BT.601 luma, BasicSR's parameters; compare at equal size only; lower is better",
    ),
    (
        "psnr_lr_consistency",
        "PSNR in dB of the bicubically reduced render against the low-resolution input; higher is better",
    ),
    (
        "psnr_warped",
        "PSNR in dB of a view carried into another by its depth, over the visible part; higher is more consistent",
    ),
    (
        // Neither direction is better: coverage also follows from how far apart the cameras stand.
        "coverage_warped",
        "the share of a view's pixels that psnr_warped could compare, 0 to 1",
    ),
];
