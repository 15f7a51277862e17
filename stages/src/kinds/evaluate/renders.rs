//! Renders of the held-out views, in files of the stage's scratch folder until they are compared: all
//! of them together may be larger than memory. Knows nothing of scores.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use formats::Camera;
use nerf::Rendered;

use crate::error::StageError;

/// The folder's name.
const FOLDER: &str = "renders";
/// Numbers of a pixel: colour, depth and opacity.
const PIXEL: usize = 5;

/// The renders of one field, by the places of their cameras.
pub struct Renders {
    folder: PathBuf,
    cameras: Vec<Camera>,
}

impl Renders {
    /// No renders yet, of the field of this name.
    pub fn new(scratch: &Path, field: &str) -> Self {
        Self {
            folder: scratch.join(FOLDER).join(field),
            cameras: Vec::new(),
        }
    }

    /// Whence the field was seen.
    pub fn cameras(&self) -> &[Camera] {
        &self.cameras
    }

    /// Takes the next render.
    pub fn add(&mut self, camera: Camera, image: &Rendered) -> Result<(), StageError> {
        let path = self.file(self.cameras.len());
        let parts = [&image.rgb, &image.depth, &image.opacity];
        let bytes: Vec<u8> = parts
            .into_iter()
            .flat_map(|part| bytemuck::cast_slice(part))
            .copied()
            .collect();
        fs::create_dir_all(&self.folder)
            .and_then(|()| fs::write(&path, bytes))
            .map_err(|error| failed(&path, &error))?;
        self.cameras.push(camera);
        Ok(())
    }

    /// The render at this place.
    pub fn read(&self, at: usize) -> Result<Rendered, StageError> {
        let path = self.file(at);
        let bytes = fs::read(&path).map_err(|error| failed(&path, &error))?;
        let Camera { width, height, .. } = self.cameras[at];
        let pixels = width as usize * height as usize;
        if bytes.len() != size_of::<f32>() * PIXEL * pixels {
            return Err(failed(&path, &io::ErrorKind::UnexpectedEof.into()));
        }
        // Written above, by the same program: the machine's own numbers.
        let numbers: Vec<f32> = bytemuck::pod_collect_to_vec(&bytes);
        Ok(Rendered {
            width,
            height,
            rgb: numbers[..3 * pixels].to_vec(),
            depth: numbers[3 * pixels..4 * pixels].to_vec(),
            opacity: numbers[4 * pixels..].to_vec(),
            samples: 0,
        })
    }

    fn file(&self, at: usize) -> PathBuf {
        self.folder.join(at.to_string())
    }
}

impl Drop for Renders {
    /// They may be large, and are of no use to anybody else.
    fn drop(&mut self) {
        // What cannot be removed goes with the scratch folder.
        let _ = fs::remove_dir_all(&self.folder);
    }
}

fn failed(path: &Path, error: &io::Error) -> StageError {
    StageError::File {
        path: path.to_owned(),
        problem: format!("{error} (renders are kept there until they are compared)"),
    }
}

#[cfg(test)]
mod tests {
    use glam::DMat4;

    use super::*;

    #[test]
    fn a_render_is_read_back_and_gone_in_the_end() {
        let scratch = tempfile::tempdir().unwrap();
        let image = |shift: f32| Rendered {
            width: 3,
            height: 2,
            rgb: (0..18).map(|i| i as f32 + shift).collect(),
            depth: (0..6).map(|i| 10.0 + i as f32).collect(),
            opacity: vec![0.5; 6],
            samples: 0,
        };
        let camera = Camera::centered((3, 2), 2.0, DMat4::IDENTITY, [1.0, 9.0]);
        let mut renders = Renders::new(scratch.path(), "sr_nerf");
        renders.add(camera, &image(0.0)).unwrap();
        renders.add(camera, &image(0.25)).unwrap();
        assert_eq!(renders.read(1).unwrap().rgb, image(0.25).rgb);
        let first = renders.read(0).unwrap();
        assert_eq!(first.depth, image(0.0).depth);
        assert_eq!(first.opacity, image(0.0).opacity);
        fs::write(renders.file(0), [0; 8]).unwrap();
        let error = renders.read(0).unwrap_err().to_string();
        assert!(error.contains("renders/sr_nerf/0: "), "{error}");
        drop(renders);
        assert!(!scratch.path().join("renders/sr_nerf").exists());
    }
}
