//! Where a photo was taken from, by a field that shows what it shows. Knows nothing of how the field
//! came about.

use crate::batch::TrainView;
use crate::field::Field;
use crate::options::TrainOptions;
use crate::poses::PoseOptions;
use crate::train::Trainer;
use formats::Camera;

/// Steps for a photo.
const STEPS: u32 = 150;
/// Samples along rays per step.
const SAMPLES: u32 = 1 << 13;
/// Adam's rate at its highest. One photo has a batch for itself, so its gradients scatter less than
/// in training, where 1e-4 was best.
const RATE: f64 = 3e-4;

/// The camera of a photo, turned and shifted to where the field shows what the photo shows: by
/// gradient descent on the photometric loss from the camera as it is given, which must be off by no
/// more than a few pixels (iNeRF, Yen-Chen et al. 2021; the way in which BARF, Lin et al. 2021,
/// judges held-out views). The field stays as it is. Masked pixels have no say; where all are masked,
/// the camera stays as it is given.
///
/// Computes on the CPU. The same bits for any number of threads.
///
/// Panics if the view's sizes do not fit together.
pub fn localize(field: &Field, view: TrainView, seed: u64) -> Camera {
    if view.open() == 0 {
        return view.camera;
    }
    let options = TrainOptions {
        steps: STEPS,
        samples: SAMPLES,
        poses: Some(PoseOptions {
            rate: RATE,
            start: 0,
        }),
        // What shapes a field has no say in where a camera is.
        distortion: 0.0,
        fog: 0.0,
        ..TrainOptions::default()
    };
    let mut trainer = Trainer::of_views(field.clone(), vec![view], &options, seed);
    for _ in 0..STEPS {
        trainer.step();
    }
    trainer.cameras()[0]
}
