//! PSNR, SSIM, NIQE and consistency, each under an honest name.
