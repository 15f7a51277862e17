//! An evaluation as it goes on: renders of two fields, their scores, and the pictures to show. Knows
//! nothing of where inputs come from and results go.

use artifacts_schema::{Metrics, StoredImages, View};
use compute::resize::{Filter, resize};
use formats::pixels::planes;
use nerf::{Field, Rendered};

use super::album::Album;
use super::consistency::{Shown, nearest, warped};
use super::networks::Networks;
use super::pictures::{BEHIND, Picked, error_map, side_by_side};
use super::renders::Renders;
use super::scores::{Scored, Scores};
use super::{Evaluate, masked};
use crate::convert;
use crate::error::StageError;
use crate::io::Io;

/// The one column that is only this stage's.
const OWN: (&str, &str) = (
    "psnr_lr",
    "PSNR in dB against the low-resolution photos that the field was trained on; higher is better",
);

/// The rows of the fields, and that of an enlarged render.
const SR: &str = "sr_nerf";
const LR: &str = "lr_nerf";
const BICUBIC: &str = "bicubic";

/// A field that is measured.
struct Measured {
    row: &'static str,
    field: Field,
    /// Its renders from all held-out cameras.
    renders: Renders,
}

/// Two fields, and what is known of them so far.
pub struct Evaluation<'a> {
    stage: &'a Evaluate,
    io: &'a Io<'a>,
    networks: Networks,
    /// The super-resolved field and the low-resolution one.
    fields: [Measured; 2],
    scores: Scores,
    album: Album<'a>,
    /// Held-out views that were measured.
    views: usize,
    done: usize,
    steps: usize,
}

impl<'a> Evaluation<'a> {
    /// Of the super-resolved field and the low-resolution one.
    pub fn new(
        stage: &'a Evaluate,
        io: &'a Io<'a>,
        networks: Networks,
        [field, baseline]: [Field; 2],
    ) -> Result<Self, StageError> {
        let measured = |row, field| Measured {
            row,
            field,
            renders: Renders::new(&io.scratch, row),
        };
        Ok(Self {
            stage,
            io,
            networks,
            fields: [measured(SR, field), measured(LR, baseline)],
            scores: Scores::default(),
            album: Album::new(io)?,
            views: 0,
            done: 0,
            steps: 0,
        })
    }

    /// How many pieces of work there will be, for whoever waits.
    pub fn expect(&mut self, steps: usize) {
        self.steps = steps;
    }

    fn tell(&mut self) -> Result<(), StageError> {
        self.done += 1;
        self.io.progress(self.done, self.steps, &[])
    }

    /// Renders both fields from all held-out cameras.
    pub fn show(&mut self, truths: &StoredImages) -> Result<(), StageError> {
        for view in truths.views() {
            let view = view?;
            for which in 0..self.fields.len() {
                let image = self.render(&self.fields[which].field, &view);
                self.fields[which].renders.add(view.camera, &image)?;
                self.tell()?;
            }
        }
        Ok(())
    }

    fn render(&self, field: &Field, view: &View) -> Rendered {
        // A truth with alpha is put before white (`Picked::of`), so the field must be too.
        let background = if view.pixels.alpha.is_some() {
            [BEHIND; 3]
        } else {
            [0.0; 3]
        };
        let options = nerf::RenderOptions {
            supersample: self.stage.supersample,
            background,
        };
        // On the CPU whatever the device, so that figures of fields from different devices compare.
        nerf::render(field, &view.camera, &options)
    }

    /// Measures the next held-out view, in the order in which they were shown.
    pub fn held_out(&mut self, view: &View, low: &View) -> Result<(), StageError> {
        let at = self.views;
        let truth = Picked::of(view);
        let mask = view.mask.as_deref();
        // Masked pixels take the truth's values, so that every metric finds no error there.
        let enlarged = self.enlarged(low, view).masked_by(&truth, mask);
        let shown = |field: &Measured| {
            let image = field.renders.read(at)?;
            Ok::<_, StageError>(Picked::rendered(&image).masked_by(&truth, mask))
        };
        let [sr, lr] = &self.fields;
        let sr = shown(sr)?;
        let lr = shown(lr)?;
        let low = Picked::of(low);
        let images = [(BICUBIC, &enlarged), (LR, &lr), (SR, &sr)];
        for (row, image) in images {
            let measured = self.measure(image, &truth, &low, mask);
            self.scores
                .add(row, &view.name, masked::counted(measured, mask));
        }
        self.measure_fields(view, &truth)?;
        // Comparisons are large, and the first few views tell as much as all.
        let album = &mut self.album;
        if at < self.stage.figures as usize {
            let comparison = side_by_side(&truth, &images);
            album.comparisons.add(&view.name, &comparison)?;
        }
        album.renders.add(&view.name, &sr.picture())?;
        album.photos.add(&view.name, &truth.picture())?;
        album.errors.add(&view.name, &error_map(&truth, &sr))?;
        self.views += 1;
        self.tell()
    }

    /// The low-resolution field at low resolution, enlarged to the size of `truth` on sRGB values.
    fn enlarged(&self, low: &View, truth: &View) -> Picked {
        let [_, baseline] = &self.fields;
        let small = self.render(&baseline.field, low);
        let shape = [1, 3, small.height as usize, small.width as usize];
        let array = self.io.device.array(&shape, planes(&small.rgb, 3));
        let height = truth.camera.height as usize;
        let width = truth.camera.width as usize;
        // Enlarged from what the field shows, not from the photo: the baseline knows the scene as
        // the field does.
        let rgb = convert::pixels(&resize(&array, height, width, Filter::BicubicTorch, false));
        Picked {
            width,
            height,
            // Bicubic overshoots at edges.
            rgb: rgb.iter().map(|x| x.clamp(0.0, 1.0)).collect(),
        }
    }

    /// What an image scores by itself.
    fn measure(
        &mut self,
        image: &Picked,
        truth: &Picked,
        low: &Picked,
        mask: Option<&[bool]>,
    ) -> Vec<Scored> {
        let scores = &mut self.scores;
        let mut measured = scores.measure(image.image(), truth.image(), low.image());
        measured.extend(self.networks.measure(truth.image(), image.image()));
        if self.stage.exposed {
            let exposed = image.exposed_as(truth, mask).masked_by(truth, mask);
            let psnr = metrics::psnr(truth.image(), exposed.image());
            measured.push(("psnr_hr_exposed", Ok(psnr)));
        }
        measured
    }

    /// What only a field has: depths, and other cameras to look from.
    fn measure_fields(&mut self, view: &View, truth: &Picked) -> Result<(), StageError> {
        let name = &view.name;
        for field in &self.fields {
            let scored = agreement(&field.renders, self.views)?;
            self.scores.add(field.row, name, scored);
        }
        let no_depth = || Err("an enlarged picture has no depth".to_owned());
        // Said and not left out, so that an empty place in the table has its reason.
        self.scores
            .add(BICUBIC, name, [("psnr_warped", no_depth())]);
        if self.stage.posed {
            let posed = self.fields.each_ref().map(|of| {
                let measured = vec![("psnr_hr_posed", Ok(self.posed(&of.field, view, truth)))];
                (of.row, masked::counted(measured, view.mask.as_deref()))
            });
            for (row, measured) in posed {
                self.scores.add(row, name, measured);
            }
            let no_field = || Err("an enlarged picture has one camera".to_owned());
            self.scores
                .add(BICUBIC, name, [("psnr_hr_posed", no_field())]);
        }
        Ok(())
    }

    /// PSNR from where the field shows the photo best.
    fn posed(&self, field: &Field, view: &View, truth: &Picked) -> f64 {
        let photo = convert::train_view(view.clone(), 1.0, self.stage.supersample);
        let from = View {
            camera: nerf::localize(field, photo, 0),
            ..view.clone()
        };
        let render = Picked::rendered(&self.render(field, &from));
        let render = render.masked_by(truth, view.mask.as_deref());
        metrics::psnr(truth.image(), render.image())
    }

    /// Measures the low-resolution field on a view that it was trained on.
    pub fn training(&mut self, view: &View) -> Result<(), StageError> {
        let truth = Picked::of(view);
        let mask = view.mask.as_deref();
        let [_, baseline] = &self.fields;
        let render = Picked::rendered(&self.render(&baseline.field, view)).masked_by(&truth, mask);
        let psnr = metrics::psnr(truth.image(), render.image());
        let measured = masked::counted(vec![(OWN.0, Ok(psnr))], mask);
        self.scores
            .add("lr_nerf_on_training_views", &view.name, measured);
        self.tell()
    }

    /// All scores. Pictures lie in the outputs when this returns.
    pub fn finish(self) -> Result<Metrics, StageError> {
        if let Some(warning) = self.scores.warning() {
            self.io.warn(warning);
        }
        self.album.finish()?;
        Ok(self.scores.finish(&[OWN]))
    }
}

/// How well render `at` agrees with the one whose camera stands nearest to its own.
fn agreement(renders: &Renders, at: usize) -> Result<[Scored; 2], StageError> {
    let cameras = renders.cameras();
    let Some(nearest) = nearest(cameras, at) else {
        let why = || Err("there is only one held-out view".to_owned());
        return Ok([("psnr_warped", why()), ("coverage_warped", why())]);
    };
    let shown = |at: usize| {
        Ok::<_, StageError>(Shown {
            camera: cameras[at],
            image: renders.read(at)?,
        })
    };
    Ok(warped(&shown(at)?, &shown(nearest)?))
}
