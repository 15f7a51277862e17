//! `init`: looks at a folder of posed photos and writes a pipeline for them. Runs no stage.

use std::fs::OpenOptions;
use std::io::{BufRead, Write, stderr, stdin};
use std::path::{Path, PathBuf};

use clap::Args;
use stages::kinds::scene::origin::Origin;

use super::error::Error;
use crate::pipeline::init::{Photos, Purpose};
use crate::terminal::output::{print, tell};

#[derive(Args)]
pub struct Init {
    /// A folder of photos with poses (COLMAP, transforms.json, LLFF), or a transforms.json; asked
    /// for where it is not given
    pub(super) photos: Option<PathBuf>,
    /// Where to write the pipeline, by default a file named after the folder
    #[arg(short, long, value_name = "FILE")]
    pub(super) output: Option<PathBuf>,
    /// Make the photos four times smaller first, and compare held-out views with them
    #[arg(long)]
    pub(super) judge: bool,
}

impl Init {
    /// Looks, writes, and says what to do next.
    pub fn run(self, json: bool) -> Result<(), Error> {
        let place = match &self.photos {
            Some(photos) => photos.clone(),
            None => asked(&mut stdin().lock())?,
        };
        let origin = Origin::at(&place).ok_or_else(|| no_poses(&place))?;
        let reader = origin.reader().ok_or_else(|| no_poses(&place))?;
        let parsed = reader.parse()?;
        let sizes: Vec<(u32, u32)> = parsed.file_sizes().collect();
        let name = self.name(&place);
        let purpose = match self.judge {
            true => Purpose::Judge,
            false => Purpose::Enlarge,
        };
        let photos = Photos {
            name: &name,
            origin: &origin,
            sizes: &sizes,
            set_aside: parsed.counts().1,
        };
        let file = self.output.clone().unwrap_or(format!("{name}.ron").into());
        write_new(&file, &photos.pipeline(purpose))?;
        let file = file.display().to_string();
        if json {
            print(
                &serde_json::json!({"wrote": file, "photos": sizes.len(), "notes": parsed.notes()}),
            );
            return Ok(());
        }
        for note in parsed.notes() {
            tell(&format_args!("warning: {note}"));
        }
        print(&format_args!(
            "wrote {file}: the main job with {} photos\n\n  srnerf-dag plan {file}   # what would run\n  \
             srnerf-dag run {file}",
            sizes.len()
        ));
        Ok(())
    }

    /// What a pipeline of these photos is called: as its file, or the folder, as far as names allow.
    fn name(&self, photos: &Path) -> String {
        // `.` and `..` have no name of their own. The folders that they lead to have.
        let path = photos.canonicalize().unwrap_or(photos.to_owned());
        let folder = match path.is_file() {
            true => path.parent().unwrap_or(&path),
            false => &path,
        };
        let file = self.output.as_deref().and_then(Path::file_stem);
        let name = file.or(folder.file_name()).unwrap_or_default();
        let allowed = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
        let name: String = name
            .to_string_lossy()
            .chars()
            .map(|c| if allowed(c) { c } else { '_' })
            .collect();
        match name.chars().next() {
            // The grammar of pipelines wants a letter first, and folders are often called
            // `2024-05-01`.
            Some(first) if first.is_ascii_alphabetic() => name,
            _ => format!("photos_{name}"),
        }
    }
}

/// What somebody answers who is asked for the photos.
fn asked(answer: &mut impl BufRead) -> Result<PathBuf, Error> {
    let mut line = String::new();
    // On stderr, so that what is piped on is the result alone.
    let question = "Where are the photos? A folder with poses, or a transforms.json: ";
    let asked = write!(stderr(), "{question}").and_then(|()| answer.read_line(&mut line));
    match (asked, line.trim()) {
        (Ok(_), place) if !place.is_empty() => Ok(place.into()),
        _ => Err(Error::usage(
            "no photos are named",
            "`srnerf-dag init PHOTOS` takes a folder of photos with poses",
        )),
    }
}

fn no_poses(photos: &Path) -> Error {
    let folder = photos.display();
    let message = match photos.exists() {
        true => format!("{folder} has no poses that can be read"),
        false => format!("there is no {folder}"),
    };
    Error::usage(
        message,
        format!(
            "`srnerf-dag import {folder}` has COLMAP find where photos were taken; docs/inputs.md tells which \
             layouts with poses are read"
        ),
    )
}

/// Writes a file that is not there yet.
fn write_new(path: &Path, text: &str) -> Result<(), Error> {
    // A pipeline that is there may have been edited by hand, so it is never replaced.
    let opened = OpenOptions::new().write(true).create_new(true).open(path);
    let written = opened.and_then(|mut file| file.write_all(text.as_bytes()));
    written.map_err(|error| {
        Error::usage(
            format!("cannot write {}: {error}", path.display()),
            "give another file: --output FILE",
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn photos_that_are_not_named_are_asked_for() {
        let answered = |answer: &str| asked(&mut answer.as_bytes()).map_err(|_| ());
        assert_eq!(answered(" my photos \n"), Ok(PathBuf::from("my photos")));
        assert_eq!(answered("\n"), Err(()));
        assert_eq!(answered(""), Err(()), "nobody is there to answer");
    }
}
