//! A pipeline file for somebody's photos: the main job as it ships, with these photos in it. Reads
//! no photo; a reader of scenes has looked at them.

use std::path::Path;

use stages::kinds::scene::origin::Origin;

/// The main job.
const MAIN: &str = include_str!("../../pipelines/i3ds.ron");
/// The longest side of the pictures that come out, unless somebody asks for others: larger ones
/// take more than an hour on a few cores.
const LONGEST: u32 = 1024;
/// How many times larger the pictures are than the photos that are trained on.
const FACTOR: u32 = 4;

/// What a pipeline is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// Four times the photos' own resolution. Nothing tells how right that is.
    Enlarge,
    /// Photos made four times smaller first, so that the photos themselves tell.
    Judge,
}

/// Photos that have poses.
pub struct Photos<'a> {
    /// What the pipeline is to be called.
    pub name: &'a str,
    /// Where they lie, and in which layout.
    pub origin: &'a Origin,
    /// Width and height of each.
    pub sizes: &'a [(u32, u32)],
    /// How many of them their source itself sets aside for testing.
    pub set_aside: usize,
}

impl Photos<'_> {
    /// Width and height, if they are the same for all.
    fn common(&self) -> Option<(u32, u32)> {
        let first = *self.sizes.first()?;
        self.sizes
            .iter()
            .all(|size| *size == first)
            .then_some(first)
    }

    /// The size at which the photos are read: their own, unless the results would be too large.
    /// `None` for their own.
    fn reading_size(&self, purpose: Purpose) -> Option<(u32, u32)> {
        let (width, height) = self.common()?;
        let longest = match purpose {
            Purpose::Enlarge => LONGEST / FACTOR,
            Purpose::Judge => LONGEST / 2,
        };
        // Photos that are small enough are read as they are.
        let shrink = (f64::from(longest) / f64::from(width.max(height))).min(1.0);
        // Every size that is read can be made four times smaller without a rest.
        let side = |pixels: u32| {
            let whole = (f64::from(pixels) * shrink / f64::from(FACTOR)).round();
            // Rounding must not ask for more pixels than a photo has.
            FACTOR * (whole as u32).min(pixels / FACTOR).max(8)
        };
        let size = (side(width), side(height));
        (size != (width, height)).then_some(size)
    }

    /// The text of the pipeline file.
    pub fn pipeline(&self, purpose: Purpose) -> String {
        let size = self.reading_size(purpose);
        let source = source(self.origin, size);
        let scene = match purpose {
            Purpose::Judge => format!("Scene(source: {source}, downscale: 4, holdout: 8)"),
            // As good as none is held out: the result should know all photos.
            Purpose::Enlarge => format!("Scene(source: {source}, downscale: 1, holdout: 1000000)"),
        };
        let head = self.head(purpose, size);
        // What stands above the shipped pipeline speaks of its own photos.
        let text = replaced(MAIN, "//", "(\n", &format!("{head}(\n"));
        let text = replaced(
            &text,
            "    name: ",
            "\n",
            &format!("    name: {:?},\n", self.name),
        );
        let text = replaced(&text, SCENE, "\n", &format!("{SCENE}{scene},\n"));
        match purpose {
            Purpose::Judge => text,
            Purpose::Enlarge => replaced(&text, EVALUATE, "\n        ),\n", RESULTS),
        }
    }

    /// How many photos are not trained on: a source that sets some aside has the last word.
    fn held_out(&self, purpose: Purpose) -> usize {
        match (self.set_aside, purpose) {
            (0, Purpose::Enlarge) => 1,
            (0, Purpose::Judge) => self.sizes.len().div_ceil(8),
            (set_aside, _) => set_aside,
        }
    }

    /// What stands above the pipeline: what it does with these photos.
    fn head(&self, purpose: Purpose, size: Option<(u32, u32)>) -> String {
        let count = self.sizes.len();
        let read = match (size, self.common()) {
            (Some((width, height)), _) => {
                format!("They are read at {width}x{height}; `size` says so, and can be larger.")
            }
            (None, Some((width, height))) => {
                format!("They are read as they are, {width}x{height}.")
            }
            (None, None) => "They differ in size, and are read as they are.".to_owned(),
        };
        let held_out = self.held_out(purpose);
        let trained_on = count.saturating_sub(held_out);
        let does = match purpose {
            Purpose::Enlarge => format!(
                "// The field is trained on {trained_on} of them, and rendered from their cameras at four times that size:\n\
                 // EXR files in out/{0}/views/images, PNG files in out/{0}/pictures/color.",
                self.name
            ),
            Purpose::Judge => format!(
                "// The field is trained on {trained_on} of them, made four times smaller. From the cameras of the other {held_out}\n\
                 // it is rendered at full size, and compared with them."
            ),
        };
        format!(
            "// The main job with {count} photos. {read}\n{does}\n\
             // Only differences from the defaults stand here; `srnerf-dag explain STAGE` prints every parameter.\n"
        )
    }
}

/// Where these stages of the main job begin.
const SCENE: &str = "        \"scene\": ";
const EVALUATE: &str = "        \"evaluate\": ";
/// What there is in place of an evaluation where no truth is known.
const RESULTS: &str = r#"        "views": Render(field: "i3ds.field", cameras: "scene.train", scale: 4, supersample: 2),
        "pictures": Film(images: "views"),
"#;

/// The source as it is written in a pipeline.
fn source(origin: &Origin, size: Option<(u32, u32)>) -> String {
    let size = size.map_or(String::new(), |(width, height)| {
        format!(", size: ({width}, {height})")
    });
    // Rust's own notation for texts is RON's as well: quotes and backslashes are escaped alike.
    let named = |layout: &str, path: &Path| format!("{layout}(path: {path:?}{size})");
    match origin {
        Origin::Transforms { path, .. } => named("Transforms", path),
        Origin::Colmap { path, .. } => named("Colmap", path),
        Origin::Llff { path, .. } => named("Llff", path),
        Origin::Procedural { world, .. } => format!("Procedural(world: {world:?}{size})"),
    }
}

/// The text with `by` in place of its first part from `start` to the end of the next `end`.
fn replaced(text: &str, start: &str, end: &str, by: &str) -> String {
    let parts = text.split_once(start);
    match parts.and_then(|(before, rest)| Some((before, rest.split_once(end)?.1))) {
        Some((before, after)) => format!("{before}{by}{after}"),
        // The texts are those of the main job as it is built in. A test notices when they no longer
        // fit.
        None => text.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::load;
    use crate::pipeline::problem::SourceText;

    fn shoes() -> Origin {
        Origin::Colmap {
            path: "my \"shoes\"".into(),
            images: None,
            size: None,
        }
    }

    fn text(sizes: &[(u32, u32)], purpose: Purpose) -> String {
        let photos = Photos {
            name: "shoes",
            origin: &shoes(),
            sizes,
            set_aside: 0,
        };
        photos.pipeline(purpose)
    }

    /// The names of a pipeline's stages.
    fn stages(text: &str) -> Vec<String> {
        let source = SourceText {
            name: "shoes.ron".into(),
            text: text.into(),
        };
        let graph = load(&[source], &[]).unwrap();
        let names = graph.nodes.iter().map(|node| node.name.clone());
        names.collect()
    }

    #[test]
    fn to_judge_is_the_main_job_with_other_photos() {
        let judge = stages(&text(&[(1008, 756); 3], Purpose::Judge));
        assert_eq!(judge, stages(MAIN));
    }

    #[test]
    fn to_enlarge_there_are_pictures_in_place_of_an_evaluation() {
        let text = text(&[(1008, 756); 3], Purpose::Enlarge);
        let stages = stages(&text);
        assert!(stages.contains(&"pictures".into()) && !stages.contains(&"evaluate".into()));
        assert!(
            text.contains(r#"Colmap(path: "my \"shoes\"", size: (256, 192))"#),
            "{text}"
        );
        assert!(text.contains("downscale: 1"), "{text}");
        assert!(
            text.contains("3 photos") && text.contains("trained on 2"),
            "{text}"
        );
    }

    #[test]
    fn large_photos_are_read_smaller_and_small_ones_as_they_are() {
        let size = |size, purpose| {
            let photos = Photos {
                name: "shoes",
                origin: &shoes(),
                sizes: &[size; 2],
                set_aside: 0,
            };
            photos.reading_size(purpose)
        };
        assert_eq!(size((4032, 3024), Purpose::Judge), Some((512, 384)));
        assert_eq!(size((1080, 1920), Purpose::Enlarge), Some((144, 256)));
        assert_eq!(size((200, 100), Purpose::Enlarge), None);
        // What cannot be made four times smaller is cut to what can.
        assert_eq!(size((202, 100), Purpose::Judge), Some((200, 100)));
    }

    #[test]
    fn photos_of_several_sizes_are_read_as_they_are() {
        let text = text(&[(400, 300), (300, 400)], Purpose::Enlarge);
        assert!(
            text.contains("differ in size") && !text.contains("size: ("),
            "{text}"
        );
    }
}
