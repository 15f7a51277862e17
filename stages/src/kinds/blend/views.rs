//! The views that `Blend` brings together, as its three inputs have them. Knows nothing of detail.

use artifacts_schema::{ImageSet, StoredImages, View};
use formats::Camera;

use crate::convert;
use crate::error::StageError;
use crate::io::Io;
use crate::masks;
use crate::port::Port;

/// The enlarged photos, and the images that come out.
pub const IMAGES: Port<ImageSet> = Port::new("images");
/// The field's renders.
pub const OWN: Port<ImageSet> = Port::new("own");
/// The low-resolution photos.
pub const LOW: Port<ImageSet> = Port::new("low");

/// One view as each input has it.
pub struct Views {
    pub images: View,
    pub own: View,
    pub low: View,
}

impl Views {
    /// Which pixels of the large images count: those that count in both photos.
    pub fn mask(&self) -> Option<Vec<bool>> {
        let Camera { width, height, .. } = self.images.camera;
        // Back-projection has no say where the photo is masked, so that the sum is not bound to it
        // there.
        let low = masks::at_size(&self.low, width, height);
        masks::both(self.images.mask.clone(), low)
    }
}

/// The three sets on disk.
pub struct Sets {
    pub images: StoredImages,
    own: StoredImages,
    low: StoredImages,
    /// Of each view of `images`, its places in `own` and in `low`: the sets may hold views that the
    /// others lack.
    places: Vec<[usize; 2]>,
}

impl Sets {
    /// Opens the sets, and refuses them if a view is missing or differs in size.
    pub fn open(io: &Io) -> Result<Self, StageError> {
        let images = io.images(IMAGES)?;
        let own = io.images(OWN)?;
        let low = io.images(LOW)?;
        let place = |(name, camera): &(String, Camera)| {
            let at = convert::place_named(&own, name)?;
            check_sizes(name, camera, &own.cameras()[at].1)?;
            Ok([at, convert::place_named(&low, name)?])
        };
        let places = images
            .cameras()
            .iter()
            .map(place)
            .collect::<Result<_, StageError>>()?;
        Ok(Self {
            images,
            own,
            low,
            places,
        })
    }

    /// View by view, all three read at once.
    pub fn views(&self) -> impl Iterator<Item = Result<Views, StageError>> + '_ {
        self.places.iter().enumerate().map(|(at, &[own, low])| {
            let (images, (own, low)) = rayon::join(
                || self.images.view(at),
                || rayon::join(|| self.own.view(own), || self.low.view(low)),
            );
            Ok(Views {
                images: images?,
                own: own?,
                low: low?,
            })
        })
    }
}

/// Refuses two images of one view that differ in size.
fn check_sizes(name: &str, images: &Camera, own: &Camera) -> Result<(), StageError> {
    let size = |camera: &Camera| (camera.width, camera.height);
    let images = size(images);
    let own = size(own);
    if images == own {
        return Ok(());
    }
    Err(StageError::Mismatch(format!(
        "the view `{name}` has {}x{} pixels in `images` and {}x{} in `own`; render at the same scale as the enlargement",
        images.0, images.1, own.0, own.1
    )))
}
