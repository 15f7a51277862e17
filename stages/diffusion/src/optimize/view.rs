//! One view as the optimisation takes it, and what makes views unfit. Knows no step.

use compute::Array;

use super::OptimizeError;
use super::window::Window;

/// One view's encoded latent and what the networks are told about it.
#[derive(Clone, Debug)]
pub struct ViewLatents {
    /// Names it in messages.
    pub name: String,
    /// The encoded latent z, `[C, h, w]`, times the VAE's scaling factor.
    pub latent: Array,
    /// The low-resolution image, `[3, h, w]`, sRGB in [-1, 1].
    pub low: Array,
    /// Which latent pixels count, `[h, w]`; the others stay as they are encoded. `None` where all do.
    pub mask: Option<Vec<bool>>,
    /// The camera, row-major camera-to-world in normalised scene units.
    pub camera: [f32; 16],
}

impl ViewLatents {
    /// Height and width in latent pixels.
    pub fn size(&self) -> [usize; 2] {
        [self.latent.shape()[1], self.latent.shape()[2]]
    }

    /// Sets a gradient in a window, `[C, window.height, window.width]`, to zero where the view is
    /// masked: residuals that are never moved stay zero.
    pub(super) fn silence(&self, window: &Window, gradient: &mut [f32]) {
        let Some(mask) = &self.mask else {
            return;
        };
        let width = self.size()[1];
        for (i, d) in gradient.iter_mut().enumerate() {
            // The gradient is [C, height, width] and the mask [h, w]: all channels of a pixel share
            // it.
            let [x, y] = [i % window.width, i / window.width % window.height];
            if !mask[(window.top + y) * width + window.left + x] {
                *d = 0.0;
            }
        }
    }
}

/// The height and width of windows that fit every view, at most `crop`. Refuses views that do not
/// fit each other.
pub(super) fn window_size(views: &[ViewLatents], crop: usize) -> Result<[usize; 2], OptimizeError> {
    let Some(first) = views.first() else {
        return Err(OptimizeError::NoViews);
    };
    for view in views {
        check(view, first).map_err(|problem| OptimizeError::View {
            name: view.name.clone(),
            problem,
        })?;
    }
    // One size for all views, since a batch is one array.
    Ok([0, 1].map(|axis| {
        views
            .iter()
            .map(|view| view.size()[axis])
            .fold(crop, usize::min)
    }))
}

/// A view must have a latent with as many channels as the first one's, and a low-resolution image
/// of the latent's size.
fn check(view: &ViewLatents, first: &ViewLatents) -> Result<(), String> {
    let latent = view.latent.shape();
    let low = view.low.shape();
    if latent.len() != 3 || latent[0] != first.latent.shape()[0] {
        return Err(format!(
            "has a latent of shape {latent:?}; the first view's is {:?}",
            first.latent.shape()
        ));
    }
    // Windows would have no pixels, and means over them would be 0 / 0.
    if view.latent.is_empty() {
        return Err(format!("has an empty latent, of shape {latent:?}"));
    }
    if low != [3, latent[1], latent[2]] {
        let expected = [3, latent[1], latent[2]];
        return Err(format!(
            "has a low-resolution image of shape {low:?}; its latent asks for {expected:?}"
        ));
    }
    match view.mask.as_ref().map(Vec::len) {
        Some(found) if found != latent[1] * latent[2] => Err(format!(
            "has a mask of {found} values; its latent asks for {}",
            latent[1] * latent[2]
        )),
        _ => Ok(()),
    }
}
