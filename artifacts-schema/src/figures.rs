//! Pictures for people: one PNG each. The provenance is a text chunk of each, and in a file beside
//! them.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Cursor;
use std::path::{Path, PathBuf};

use formats::LARGEST_COMPRESSION_RATIO;
use png::{BitDepth, ColorType, Compression, Decoder, Encoder, Filter, Limits};

use crate::artifact::{Artifact, ArtifactKind};
use crate::canonical;
use crate::digest::{ContentHasher, Digest};
use crate::error::SchemaError;
use crate::provenance::{self, Provenance};

/// The keyword of the text that holds the provenance.
const PROVENANCE: &str = "srnerf";

/// Pictures for people to look at, one PNG file each.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Figures {
    /// The pictures by the stem of their file.
    pub images: BTreeMap<String, Picture>,
}

/// One picture of a [`Figures`].
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Pixels in a row.
    pub width: u32,
    /// Rows of pixels.
    pub height: u32,
    /// Height x width x 3, sRGB.
    pub rgb8: Vec<u8>,
    /// What the colours mean, where they are no photo's: texts of the PNG file by keyword, in
    /// Latin-1.
    pub legend: BTreeMap<String, String>,
}

impl Picture {
    fn encode(&self, name: &str, provenance: &str) -> Result<Vec<u8>, SchemaError> {
        let refuse = |problem: String| SchemaError::content(format!("picture {name:?}"), problem);
        let count = self.rgb8.len() as u64;
        let expected = 3 * u64::from(self.width) * u64::from(self.height);
        if count != expected {
            return Err(refuse(format!("has {count} bytes; expected {expected}")));
        }
        let mut bytes = Vec::new();
        self.write_to(&mut bytes, provenance)
            .map_err(|error| refuse(error.to_string()))?;
        Ok(bytes)
    }

    /// The settings are part of the file's bytes: equal pictures are equal files.
    fn write_to(&self, bytes: &mut Vec<u8>, provenance: &str) -> Result<(), png::EncodingError> {
        let mut encoder = Encoder::new(bytes, self.width, self.height);
        encoder.set_color(ColorType::Rgb);
        encoder.set_depth(BitDepth::Eight);
        encoder.set_compression(Compression::Balanced);
        encoder.set_filter(Filter::Adaptive);
        encoder.add_text_chunk(PROVENANCE.into(), provenance.into())?;
        for (keyword, text) in &self.legend {
            encoder.add_text_chunk(keyword.clone(), text.clone())?;
        }
        let mut writer = encoder.write_header()?;
        writer.write_image_data(&self.rgb8)?;
        writer.finish()
    }

    fn read(path: &Path) -> Result<Self, SchemaError> {
        let bytes = std::fs::read(path).map_err(|error| SchemaError::io(path, error))?;
        Self::decode(&bytes).map_err(|problem| SchemaError::malformed(path, "PNG", problem))
    }

    fn decode(bytes: &[u8]) -> Result<Self, String> {
        // A PNG of a few bytes may claim gigabytes; deflate bounds what it can really hold.
        let most = usize::try_from(LARGEST_COMPRESSION_RATIO)
            .unwrap_or(usize::MAX)
            .saturating_mul(bytes.len());
        let decoder = Decoder::new_with_limits(Cursor::new(bytes), Limits { bytes: most });
        let mut reader = decoder.read_info().map_err(|error| error.to_string())?;
        let info = reader.info();
        let (width, height) = info.size();
        // Only what `write_to` writes: other depths and palettes would be read as other bytes.
        if (info.color_type, info.bit_depth) != (ColorType::Rgb, BitDepth::Eight) {
            return Err(format!(
                "is {:?}, {:?} bits; expected Rgb, Eight",
                info.color_type, info.bit_depth
            ));
        }
        let texts = info
            .uncompressed_latin1_text
            .iter()
            // Provenance is part of no content, and so of no digest.
            .filter(|chunk| chunk.keyword != PROVENANCE);
        let legend = texts
            .map(|chunk| (chunk.keyword.clone(), chunk.text.clone()))
            .collect();
        // Checked once more: the limits bound the decoder's own buffers, not this one.
        let size = reader.output_buffer_size().filter(|size| *size <= most);
        let mut rgb8 = vec![0; size.ok_or("is larger than its bytes can hold")?];
        reader
            .next_frame(&mut rgb8)
            .map_err(|error| error.to_string())?;
        Ok(Self {
            width,
            height,
            rgb8,
            legend,
        })
    }
}

/// Writes pictures into a folder as they come, in any order. Equal pictures leave equal files.
pub struct FigureWriter<'p> {
    folder: PathBuf,
    provenance: &'p Provenance,
    /// The provenance as it stands in each file.
    text: String,
    names: BTreeSet<String>,
}

impl<'p> FigureWriter<'p> {
    /// A writer of pictures of this origin.
    ///
    /// # Errors
    /// A provenance that has no form on disk.
    pub fn new(folder: &Path, provenance: &'p Provenance) -> Result<Self, SchemaError> {
        Ok(Self {
            folder: folder.to_owned(),
            provenance,
            text: canonical::line(provenance)?,
            names: BTreeSet::new(),
        })
    }

    /// Writes a picture, whose name becomes the stem of its file.
    ///
    /// # Errors
    /// A picture that has no form on disk or whose name another has, or a file system that refuses.
    pub fn add(&mut self, name: &str, picture: &Picture) -> Result<(), SchemaError> {
        canonical::check_name(name)?;
        if !self.names.insert(name.to_owned()) {
            return Err(canonical::twice(name));
        }
        let bytes = picture.encode(name, &self.text)?;
        canonical::write(&self.folder, &format!("{name}.png"), &bytes)
    }

    /// Ends the set. Without this the folder says nothing of its origin.
    ///
    /// # Errors
    /// A file system that refuses.
    pub fn finish(self) -> Result<(), SchemaError> {
        let page = canonical::page(self.provenance)?;
        canonical::write(&self.folder, provenance::FILE, page.as_bytes())
    }
}

impl Artifact for Figures {
    const KIND: ArtifactKind = ArtifactKind::Figures;

    fn write(&self, folder: &Path, provenance: &Provenance) -> Result<(), SchemaError> {
        let mut writer = FigureWriter::new(folder, provenance)?;
        for (name, picture) in &self.images {
            writer.add(name, picture)?;
        }
        writer.finish()
    }

    fn read(folder: &Path) -> Result<Self, SchemaError> {
        let files = canonical::by_stem(folder, "png")?;
        let images = files
            .into_iter()
            .map(|(name, path)| Ok((name, Picture::read(&path)?)))
            .collect::<Result<_, SchemaError>>()?;
        Ok(Self { images })
    }

    fn semantic_digest(&self) -> Digest {
        let mut hasher = FigureHasher::new(self.images.len());
        for (name, picture) in &self.images {
            hasher.add(name, picture);
        }
        hasher.finish()
    }
}

/// The semantic digest of the pictures in a folder, which are looked at one by one.
///
/// # Errors
/// As [`Figures::read`](Artifact::read).
pub fn semantic_digest_of(folder: &Path) -> Result<Digest, SchemaError> {
    let files = canonical::by_stem(folder, "png")?;
    let mut hasher = FigureHasher::new(files.len());
    for (name, path) in files {
        hasher.add(&name, &Picture::read(&path)?);
    }
    Ok(hasher.finish())
}

/// A digest of pixels, not of files: another encoder's PNG is the same picture.
struct FigureHasher {
    hasher: ContentHasher,
    /// Legends by the names of their pictures, where there are any.
    legends: Vec<(String, BTreeMap<String, String>)>,
}

impl FigureHasher {
    /// Of so many pictures.
    fn new(count: usize) -> Self {
        let mut hasher = ContentHasher::new(ArtifactKind::Figures);
        hasher.count(count);
        Self {
            hasher,
            legends: Vec::new(),
        }
    }

    /// The next in the order of names.
    fn add(&mut self, name: &str, picture: &Picture) {
        self.hasher.text(name);
        self.hasher.count(picture.width as usize);
        self.hasher.count(picture.height as usize);
        self.hasher.bytes(&picture.rgb8);
        if !picture.legend.is_empty() {
            self.legends.push((name.to_owned(), picture.legend.clone()));
        }
    }

    fn finish(mut self) -> Digest {
        // Behind everything, so that pictures without legends keep the digests of the days before
        // there were any.
        for (name, legend) in self.legends {
            self.hasher.text(&name);
            self.hasher.count(legend.len());
            for (keyword, text) in &legend {
                self.hasher.text(keyword);
                self.hasher.text(text);
            }
        }
        self.hasher.finish()
    }
}
