//! Splats of a field: what its cameras see of it makes their places, their first colours, and what
//! they are fitted to. Knows no files.

use artifacts_schema::View;
use formats::Camera;
use nerf::{Field, RenderOptions};
use splat::{Cloud, Colors, Fit, Picture, SeedError, Seeds};

use crate::convert;

/// Pixels of all pictures together, at most: with depth they take 20 bytes each.
const MOST_PIXELS: u64 = 24 << 20;
/// Where no photos are held out, every so many cameras are.
const HOLD_OUT: usize = 8;

/// How splats are made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SplatOptions {
    /// At most so many.
    pub most: usize,
    /// The degree of their harmonics.
    pub degree: u32,
    /// Steps of the fit.
    pub steps: u32,
}

impl Default for SplatOptions {
    fn default() -> Self {
        Self {
            most: 100_000,
            degree: 1,
            steps: 300,
        }
    }
}

/// How near splats come to their field, mean dB over views.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Closeness {
    /// Views that were compared.
    pub views: usize,
    /// The field's and the splats' pictures beside the photos, where there are some.
    pub photos: Option<[f64; 2]>,
    /// The splats' pictures beside the field's.
    pub field: f64,
}

/// What a camera sees of a field.
struct Sight {
    camera: Camera,
    picture: Picture,
    depth: Vec<f32>,
}

impl Sight {
    fn new(field: &Field, camera: &Camera) -> Self {
        // Splats are drawn without a lens, so that the field they are fitted to must be, too.
        let camera = splat::pinhole(camera);
        let rendered = nerf::render(field, &camera, &RenderOptions::default());
        Self {
            camera,
            picture: Picture::new(&rendered.rgb, &rendered.opacity),
            depth: rendered.depth,
        }
    }
}

/// Every camera or, if they have too many pixels together, every so many; as pinholes.
pub fn affordable(cameras: &[Camera]) -> Vec<Camera> {
    let pixels = |camera: &Camera| u64::from(camera.width) * u64::from(camera.height);
    let all: u64 = cameras.iter().map(pixels).sum();
    // Every so many and not the first ones, so that all sides of the scene stay.
    let step = all.div_ceil(MOST_PIXELS).max(1) as usize;
    cameras.iter().step_by(step).map(splat::pinhole).collect()
}

/// Cameras to fit to, and cameras to hold out: every eighth.
pub fn split(cameras: &[Camera]) -> [Vec<Camera>; 2] {
    let part = |held_out: bool| {
        let all = cameras.iter().enumerate();
        let own = all.filter(|(i, _)| i.is_multiple_of(HOLD_OUT) == held_out);
        own.map(|(_, camera)| *camera).collect()
    };
    [false, true].map(part)
}

/// Splats of what cameras see of a field. `told` hears of each step, and how near the splats were
/// to its picture before it, in dB.
///
/// # Errors
/// If they see nothing.
pub fn splats(
    field: &Field,
    cameras: &[Camera],
    options: &SplatOptions,
    mut told: impl FnMut(u32, f64),
) -> Result<Cloud, SeedError> {
    let sights: Vec<Sight> = cameras
        .iter()
        .map(|camera| Sight::new(field, camera))
        .collect();
    let mut fit = Fit::new(seeded(&sights, options)?, options.steps);
    for step in 1..=options.steps {
        let sight = &sights[fit.next_picture(sights.len())];
        told(step, fit.step(&sight.camera, &sight.picture));
    }
    Ok(fit.cloud())
}

fn seeded(sights: &[Sight], options: &SplatOptions) -> Result<Cloud, SeedError> {
    let pixels = sights.iter().map(|sight| sight.depth.len()).sum();
    let mut seeds = Seeds::new(options.most, pixels);
    for sight in sights {
        let coverage: Vec<f32> = sight.picture.pixels.iter().map(|pixel| pixel[3]).collect();
        // Places first, from all cameras, and then colours: a splat's colour is a mean over the
        // cameras that see it.
        seeds.add_view(&sight.camera, &sight.depth, &coverage);
    }
    let mut cloud = seeds.cloud(options.degree)?;
    let mut colors = Colors::new(&cloud);
    for sight in sights {
        colors.add_view(&cloud, &sight.camera, &sight.picture, &sight.depth);
    }
    colors.settle(&mut cloud);
    Ok(cloud)
}

/// How near splats come to a field from cameras that they were not fitted to.
pub fn closeness(field: &Field, cloud: &Cloud, cameras: &[Camera]) -> Closeness {
    let apart = |camera: &Camera| {
        let sight = Sight::new(field, camera);
        let ours = splat::render(cloud, &sight.camera);
        splat::psnr(ours.rgb(), sight.picture.rgb())
    };
    Closeness {
        views: cameras.len(),
        photos: None,
        field: mean(cameras.iter().map(apart)),
    }
}

/// How near splats and their field come to photos, whose masked pixels do not count. Photos behind
/// a lens are passed over: splats are drawn without.
pub fn closeness_to_photos(field: &Field, cloud: &Cloud, photos: &[View]) -> Closeness {
    let plain = photos
        .iter()
        .filter(|photo| photo.camera.distortion.is_none());
    let scores: Vec<[f64; 3]> = plain.map(|photo| scores(field, cloud, photo)).collect();
    let column = |i: usize| mean(scores.iter().map(|row| row[i]));
    Closeness {
        views: scores.len(),
        photos: Some([column(0), column(1)]),
        field: column(2),
    }
}

/// Field to photo, splats to photo, splats to field.
fn scores(field: &Field, cloud: &Cloud, photo: &View) -> [f64; 3] {
    let sight = Sight::new(field, &photo.camera);
    let ours = splat::render(cloud, &sight.camera);
    let truth = convert::srgb(photo);
    let counted = |values: Vec<f32>| -> Vec<f32> {
        let counts = |i: usize| photo.mask.as_ref().is_none_or(|mask| mask[i / 3]);
        let kept = values.into_iter().enumerate().filter(|(i, _)| counts(*i));
        kept.map(|(_, value)| value).collect()
    };
    let [field, splats, truth] =
        [sight.picture.rgb().collect(), ours.rgb().collect(), truth].map(counted);
    let psnr = |a: &[f32], b: &[f32]| splat::psnr(a.iter().copied(), b.iter().copied());
    [
        psnr(&field, &truth),
        psnr(&splats, &truth),
        psnr(&splats, &field),
    ]
}

fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len().max(1);
    values.sum::<f64>() / count as f64
}
