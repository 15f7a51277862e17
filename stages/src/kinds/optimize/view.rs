//! A view as guidance sees it: its latent, the photo beside it, and the camera.

use artifacts_schema::{LatentView, StoredImages};
use compute::Device;
use diffusion::optimize::ViewLatents;
use formats::rows;

use crate::convert;
use crate::error::StageError;
use crate::masks;

/// A latent with the photo that the prior sees beside it.
pub(super) fn view(
    latent: &LatentView,
    low: &StoredImages,
    device: &Device,
) -> Result<ViewLatents, StageError> {
    let photo = convert::view_named(low, &latent.name)?;
    let size = |side: u32| side as usize;
    let low = convert::signed_array(&photo, device).reshape(&[
        3,
        size(photo.camera.height),
        size(photo.camera.width),
    ]);
    let rows = rows::of(&latent.camera.camera_to_world);
    Ok(ViewLatents {
        name: latent.name.clone(),
        latent: device.array(&latent.tensor.shape, latent.tensor.values.clone()),
        low,
        // A latent has as many pixels as the photo: each is a quarter of the picture's size.
        mask: masks::at_size(&photo, photo.camera.width, photo.camera.height),
        // Row by row, as the camera embedding takes it.
        camera: std::array::from_fn(|i| rows[i / 4][i % 4] as f32),
    })
}
