//! `export splat`: a field as Gaussian splats for viewers, engines and editors. Writes one file.

use std::path::PathBuf;

use artifacts_schema::ImageSet;
use clap::Args;
use formats::Camera;
use nerf::Field;
use serde_json::json;
use splat::Cloud;
use splat::files::Format;
use stages::convert;
use stages::splats::{self, Closeness, SplatOptions};

use super::error::Error;
use super::export_cameras::up;
use super::{artifact, named, whole};
use crate::content::lineage::{Lineage, Told};
use crate::store::Store;
use crate::terminal::output::{print, print_json, tell};

/// Steps between two lines of progress.
const LINE: u32 = 50;

/// Options of `export splat`.
#[derive(Args)]
pub struct Splat {
    /// A field (field.safetensors, or the folder that it is in), a run (@2 is the last but one; or
    /// 20261122T23), or a pipeline's name
    #[arg(value_name = "FIELD|RUN", default_value = "@1")]
    what: String,
    /// The file to write: .ply (3D Gaussian Splatting), .glb (glTF with KHR_gaussian_splatting) or
    /// .usda (OpenUSD)
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// At most so many splats
    #[arg(long, default_value_t = SplatOptions::default().most, value_name = "N")]
    most: usize,
    /// The degree of the harmonics by which colours turn with the direction
    #[arg(long, default_value_t = SplatOptions::default().degree, value_parser = clap::value_parser!(u32).range(..=i64::from(splat::HIGHEST_DEGREE)))]
    degree: u32,
    /// Steps by which colours, opacities and sizes are fitted to the field's pictures
    #[arg(long, default_value_t = SplatOptions::default().steps, value_name = "N")]
    steps: u32,
    /// The cameras to look from, an image set; by default those of the pictures that the field was
    /// trained on
    #[arg(long, value_name = "FOLDER")]
    views: Option<PathBuf>,
    /// Pictures that are as much larger than these as the splats are to be sharp
    #[arg(long, default_value_t = 1.0, value_name = "FACTOR")]
    scale: f64,
    /// Photos to measure on, an image set; by default those that the scene holds out, or else every
    /// eighth camera without photos
    #[arg(long, value_name = "FOLDER")]
    test: Option<PathBuf>,
    /// Of a run with several fields: the stage that made the one to export
    #[arg(long, value_name = "STAGE")]
    stage: Option<String>,
    /// The folder of the store
    #[arg(long, default_value = ".srnerf", value_name = "FOLDER")]
    store: PathBuf,
}

impl Splat {
    /// Writes the file and says what is in it, and what it lost.
    pub fn run(self, json: bool) -> Result<(), Error> {
        let format = self.format()?;
        self.check()?;
        let scene = self.scene()?;
        let options = SplatOptions {
            most: self.most,
            degree: self.degree,
            steps: self.steps,
        };
        let told = |step: u32, decibels: f64| {
            if step.is_multiple_of(LINE) {
                tell(&format_args!(
                    "fit: {step}/{}  {decibels:.2} dB to the field",
                    self.steps
                ));
            }
        };
        let cloud =
            splats::splats(&scene.field, &scene.cameras, &options, told).map_err(|error| {
                Error::usage(error.to_string(), "give cameras that see it: --views")
            })?;
        // Measured on views that the fit has not seen: on its own views it would look too good.
        let closeness = scene.closeness(&cloud);
        whole::file(&self.output, |mut out| {
            // A field does not know which way is up, and some formats say so: the cameras tell.
            format.write(&cloud, up(&scene.cameras), &mut out)
        })?;
        self.report(&scene, &cloud, &closeness, json);
        Ok(())
    }

    fn format(&self) -> Result<Format, Error> {
        let ending = self.output.extension().and_then(|ending| ending.to_str());
        ending.and_then(Format::by_ending).ok_or_else(|| {
            Error::usage(
                format!("{} ends in no format of splats", self.output.display()),
                "name a file that ends in .ply, .glb or .usda",
            )
        })
    }

    fn check(&self) -> Result<(), Error> {
        let refuse = |message: String, help: &str| Err(Error::usage(message, help));
        if !(1..=10_000_000).contains(&self.most) {
            return refuse(
                format!("--most is {}", self.most),
                "it must be 1 to 10000000",
            );
        }
        if !(0.05..=16.0).contains(&self.scale) {
            return refuse(
                format!("--scale is {}", self.scale),
                "it must be 0.05 to 16",
            );
        }
        Ok(())
    }

    fn scene(&self) -> Result<Scene, Error> {
        let store = Store::open(&self.store)?;
        let lineage = Lineage::new(&store)?;
        let told = named::field(&self.what, self.stage.as_deref(), &store, &lineage)?;
        let views: Option<ImageSet> = match &self.views {
            Some(folder) => Some(artifact::images(folder)?),
            None => lineage.pictures(&told)?,
        };
        let views = views.ok_or_else(|| {
            Error::usage(
                "the store does not have the pictures that the field was trained on",
                "give an image set whose cameras see it: --views FOLDER",
            )
        })?;
        let test: Option<ImageSet> = match &self.test {
            Some(folder) => Some(artifact::images(folder)?),
            None => lineage.held_out(&told)?,
        };
        self.placed(told, &views, test)
    }

    fn placed(&self, told: Told, views: &ImageSet, test: Option<ImageSet>) -> Result<Scene, Error> {
        let help = "was it written by this version of the program?";
        let field =
            convert::field(told.field).map_err(|error| Error::usage(error.to_string(), help))?;
        let scaled = views
            .views
            .iter()
            .map(|view| view.camera.scaled_by(self.scale));
        let all: Vec<Camera> = scaled.collect();
        // The pictures of all cameras are in memory at once while splats are fitted.
        let cameras = splats::affordable(&all);
        if cameras.len() < all.len() {
            tell(&format_args!(
                "warning: {} of {} views are looked at, so that their pictures fit into memory; --scale makes them smaller",
                cameras.len(),
                all.len()
            ));
        }
        // The splats' rasteriser knows no lens, so photos that a lens bends cannot be compared
        // with.
        Ok(match test.filter(has_plain) {
            Some(test) => Scene {
                field,
                cameras,
                held_out: HeldOut::Photos(test),
            },
            None => {
                // Without photos the field's own pictures are the truth, and some of its cameras
                // are held out.
                let [cameras, held_out] = splats::split(&cameras);
                Scene {
                    field,
                    cameras,
                    held_out: HeldOut::Cameras(held_out),
                }
            }
        })
    }

    fn report(&self, scene: &Scene, cloud: &Cloud, closeness: &Closeness, json: bool) {
        let count = cloud.splats.len();
        let views = scene.cameras.len();
        if json {
            let photos = closeness.photos;
            print_json(&json!({
                "splats": count, "degree": cloud.degree, "views": views, "held_out": closeness.views,
                "field_psnr": photos.map(|[field, _]| field),
                "splat_psnr": photos.map(|[_, splats]| splats),
                "loss": photos.map(|[field, splats]| field - splats),
                "psnr_to_field": closeness.field,
            }));
            return;
        }
        print(&format_args!(
            "{}: {count} splats of degree {} from {views} views",
            self.output.display(),
            cloud.degree
        ));
        if let Some([field, splats]) = closeness.photos {
            print(&format_args!(
                "{} held-out photos: field {field:.2} dB, splats {splats:.2} dB, lost {:.2} dB",
                closeness.views,
                field - splats
            ));
        }
        print(&format_args!(
            "{} held-out views: splats beside the field {:.2} dB",
            closeness.views, closeness.field
        ));
    }
}

/// A field with what it is looked at from.
struct Scene {
    field: Field,
    cameras: Vec<Camera>,
    held_out: HeldOut,
}

/// What splats are measured on and not fitted to.
enum HeldOut {
    Photos(ImageSet),
    Cameras(Vec<Camera>),
}

impl Scene {
    fn closeness(&self, cloud: &Cloud) -> Closeness {
        match &self.held_out {
            HeldOut::Photos(set) => splats::closeness_to_photos(&self.field, cloud, &set.views),
            HeldOut::Cameras(cameras) => splats::closeness(&self.field, cloud, cameras),
        }
    }
}

/// Whether there is a photo without a lens to measure on.
fn has_plain(set: &ImageSet) -> bool {
    set.views
        .iter()
        .any(|view| view.camera.distortion.is_none())
}
