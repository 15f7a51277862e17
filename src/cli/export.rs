//! `export`: writes a pipeline down as jobs for Snakemake or Slurm, or results in formats of other
//! programs. Runs no stage.

use std::fs;
use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};
use scene::Layout;

use super::error::Error;
use super::export_cameras::CameraFile;
use super::export_exr::Exr;
use super::export_kohya::Kohya;
use super::export_latents::Latents;
use super::export_layout::Views;
use super::export_ply::Ply;
use super::export_splat::Splat;
use super::export_tensorboard::TensorBoard;
use super::export_transforms::Transforms;
use super::export_video::Video;
use super::options::{Changes, Choice, PipelineOptions};
use super::session::Session;
use crate::export::{Workflow, slurm, snakemake};
use crate::store::Store;
use crate::terminal::output::print;

/// What to write.
#[derive(Subcommand)]
pub enum Export {
    /// A Snakefile with a rule for each stage
    Snakemake(Target<false>),
    /// Scripts for sbatch, one for each stage, and one that submits them
    Slurm(Target<true>),
    /// The surface of a field as a coloured mesh or point cloud, for MeshLab, Blender and Open3D
    Ply(Ply),
    /// A field as Gaussian splats, for viewers, engines and editors: .ply, .glb or .usda
    Splat(Splat),
    /// An image set as a sequence of OpenEXR frames with depth and normals, for compositors
    Exr(Exr),
    /// The cameras of an image set: .usda, .gltf or .glb
    Cameras(CameraFile),
    /// An image set as a moving picture: .mp4, .webm or .webp
    Video(Video),
    /// Latent images for ComfyUI
    Latents(Latents),
    /// Image sets as a NeRF-synthetic scene: transforms_train.json, transforms_test.json and RGBA
    /// PNGs
    Transforms(Transforms),
    /// The curves and scores of the last run, for TensorBoard
    #[command(name = "tensorboard")]
    TensorBoard(TensorBoard),
    /// A LoRA under the names of kohya's scripts, for ComfyUI and the web UIs
    Kohya(Kohya),
    /// Image sets for nerfstudio's splatfacto and nerfacto: transforms.json and images/
    Nerfstudio(Views),
    /// Image sets for brush: transforms_train.json, images/ and init.ply
    Brush(Views),
    /// Image sets in COLMAP's layout, for 3D Gaussian Splatting, gsplat and others: sparse/0 and
    /// images/
    Colmap(Views),
    /// Image sets for instant-ngp: transforms.json in its unit cube, and images/
    InstantNgp(Views),
}

/// From where to where.
#[derive(Args)]
pub struct Target<const FOLDER: bool> {
    #[command(flatten)]
    pipeline: PipelineOptions,
    /// Only this arm of a pipeline that has arms (repeatable)
    #[arg(long, value_name = "NAME")]
    arm: Vec<String>,
    /// What to write: a file for Snakemake, a folder for Slurm
    #[arg(long, value_name = "PATH", default_value = if FOLDER { "slurm" } else { "Snakefile" })]
    to: PathBuf,
}

impl Export {
    /// Writes it.
    pub fn run(self, json: bool) -> Result<(), Error> {
        match self {
            Self::Ply(ply) => ply.run(json)?,
            Self::Splat(splat) => splat.run(json)?,
            Self::Exr(exr) => exr.run(json)?,
            Self::Cameras(cameras) => cameras.run(json)?,
            Self::Video(video) => video.run(json)?,
            Self::Latents(latents) => latents.run(json)?,
            Self::Transforms(transforms) => transforms.run(json)?,
            Self::TensorBoard(tensorboard) => tensorboard.run(json)?,
            Self::Kohya(kohya) => kohya.run(json)?,
            Self::Nerfstudio(views) => views.run(Layout::Nerfstudio, json)?,
            Self::Brush(views) => views.run(Layout::Brush, json)?,
            Self::Colmap(views) => views.run(Layout::Colmap, json)?,
            Self::InstantNgp(views) => views.run(Layout::InstantNgp, json)?,
            Self::Snakemake(target) => {
                write(&target.to, &target.workflow()?.snakefile(), snakemake::MARK)?;
                print(&format_args!(
                    "wrote {}; it says at its top how to use it",
                    target.to.display()
                ));
            }
            Self::Slurm(target) => {
                let files = target.workflow()?.slurm(&target.to.to_string_lossy());
                for (name, text) in &files {
                    write(&target.to.join(name), text, slurm::MARK)?;
                }
                print(&format_args!(
                    "wrote {} scripts; {} submits them",
                    files.len(),
                    target.to.join("submit.sh").display()
                ));
            }
        }
        Ok(())
    }
}

impl<const FOLDER: bool> Target<FOLDER> {
    fn workflow(&self) -> Result<Workflow, Error> {
        let PipelineOptions { pipeline, changes } = &self.pipeline;
        let choice = Choice {
            arm: self.arm.clone(),
            ..Choice::default()
        };
        let session = Session::new(pipeline, changes, &choice)?;
        let store = Store::open(&changes.folders.store)?;
        Ok(Workflow::new(
            &session.context(&store),
            command(pipeline, changes, &self.arm),
        ))
    }
}

/// The command line that every job begins with: this program, and the options that decide keys and
/// places.
fn command(pipeline: &Path, changes: &Changes, arms: &[String]) -> Vec<String> {
    // By its own path: on another node or in a job, PATH may lead to another version.
    let program =
        std::env::current_exe().map_or("srnerf-dag".into(), |path| path.display().to_string());
    let mut words = vec![
        program,
        "run".into(),
        pipeline.display().to_string(),
        // Jobs of Snakemake share its terminal, where the bars of several would overwrite each
        // other.
        "--no-progress".into(),
    ];
    let mut option =
        |name: &str, value: &str| words.extend([format!("--{name}"), value.to_owned()]);
    arms.iter().for_each(|arm| option("arm", arm));
    changes.set.iter().for_each(|set| option("set", set));
    changes.salt.iter().for_each(|salt| option("salt", salt));
    changes
        .remote
        .iter()
        .for_each(|remote| option("remote", remote));
    option("device", &changes.device);
    changes
        .fallback
        .iter()
        .for_each(|fallback| option("fallback", fallback));
    option("store", &changes.folders.store.display().to_string());
    option("out", &changes.folders.out.display().to_string());
    words
}

/// Writes a file, unless somebody else wrote what is there.
fn write(path: &Path, text: &str, mark: &str) -> Result<(), Error> {
    let failed = |error: std::io::Error| {
        Error::usage(
            format!("cannot write {}: {error}", path.display()),
            "choose another place: --to PATH",
        )
    };
    // An earlier export may be replaced. A Snakefile that somebody wrote by hand must not.
    let exported = match fs::read(path) {
        Ok(there) => String::from_utf8_lossy(&there).contains(mark),
        // What cannot be read is somebody else's.
        Err(error) => error.kind() == std::io::ErrorKind::NotFound,
    };
    if !exported {
        let message = format!("{} is there already, and was not exported", path.display());
        return Err(Error::usage(message, "choose another place: --to PATH"));
    }
    if let Some(folder) = path
        .parent()
        // The folder of a bare file name is the empty path, which cannot be created.
        .filter(|folder| !folder.as_os_str().is_empty())
    {
        fs::create_dir_all(folder).map_err(failed)?;
    }
    fs::write(path, text).map_err(failed)
}
