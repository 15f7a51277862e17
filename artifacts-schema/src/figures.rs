//! Pictures for people: one PNG each. The provenance is a text chunk of each, and in a file beside them.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::io::Cursor;
use std::path::Path;

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{DynamicImage, ExtendedColorType, ImageEncoder, ImageFormat, ImageReader, Limits};

use crate::artifact::{Artifact, ArtifactKind};
use crate::canonical::{self, LARGEST_COMPRESSION_RATIO};
use crate::digest::{ContentHasher, Digest};
use crate::error::SchemaError;
use crate::provenance::{self, Provenance};

/// Pictures for people.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Figures {
    /// The pictures by the stem of their file.
    pub images: BTreeMap<String, Picture>,
}

/// One picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// In pixels.
    pub width: u32,
    /// In pixels.
    pub height: u32,
    /// Height x width x 3, sRGB.
    pub rgb8: Vec<u8>,
}

impl Picture {
    fn encode(&self, name: &str) -> Result<Vec<u8>, SchemaError> {
        let refuse = |problem: String| SchemaError::content(format!("picture {name:?}"), problem);
        let (count, expected) = (self.rgb8.len() as u64, 3 * u64::from(self.width) * u64::from(self.height));
        if count != expected {
            return Err(refuse(format!("has {count} bytes; expected {expected}")));
        }
        let mut bytes = Vec::new();
        // The settings are part of the file's bytes: equal pictures are equal files.
        PngEncoder::new_with_quality(&mut bytes, CompressionType::Default, FilterType::Adaptive)
            .write_image(&self.rgb8, self.width, self.height, ExtendedColorType::Rgb8)
            .map_err(|error| refuse(error.to_string()))?;
        Ok(bytes)
    }

    fn read(path: &Path) -> Result<Self, SchemaError> {
        let bytes = std::fs::read(path).map_err(|error| SchemaError::io(path, error))?;
        let mut limits = Limits::default();
        limits.max_alloc = Some(LARGEST_COMPRESSION_RATIO * bytes.len() as u64);
        let mut reader = ImageReader::with_format(Cursor::new(bytes), ImageFormat::Png);
        reader.limits(limits);
        let image = reader.decode().map_err(|error| SchemaError::malformed(path, "PNG", error))?;
        match image {
            DynamicImage::ImageRgb8(rgb) => Ok(Self { width: rgb.width(), height: rgb.height(), rgb8: rgb.into_raw() }),
            other => Err(SchemaError::malformed(path, "PNG", format!("is {:?}; expected Rgb8", other.color()))),
        }
    }
}

/// The keyword of our text chunk.
const KEYWORD: &[u8] = b"srnerf\0";

/// Where a PNG's first chunk, its header, ends.
const HEADER_END: usize = 8 + 4 + 4 + 13 + 4;

/// A PNG with a text chunk after its header. `text` is ASCII.
fn with_text(mut png: Vec<u8>, text: &str) -> Vec<u8> {
    let named = [b"tEXt", KEYWORD, text.as_bytes()].concat();
    let length = (named.len() - 4) as u32;
    let chunk = [&length.to_be_bytes()[..], &named, &crc32fast::hash(&named).to_be_bytes()].concat();
    png.splice(HEADER_END..HEADER_END, chunk);
    png
}

impl Artifact for Figures {
    const KIND: ArtifactKind = ArtifactKind::Figures;

    fn write(&self, folder: &Path, provenance: &Provenance) -> Result<(), SchemaError> {
        canonical::check_names(self.images.keys().map(String::as_str))?;
        let text = canonical::line(provenance)?;
        for (name, picture) in &self.images {
            canonical::write(folder, &format!("{name}.png"), &with_text(picture.encode(name)?, &text))?;
        }
        canonical::write(folder, provenance::FILE, canonical::page(provenance)?.as_bytes())
    }

    fn read(folder: &Path) -> Result<Self, SchemaError> {
        let failed = |error| SchemaError::io(folder, error);
        let mut images = BTreeMap::new();
        for entry in std::fs::read_dir(folder).map_err(failed)? {
            let path = entry.map_err(failed)?.path();
            if path.extension() == Some(OsStr::new("png")) {
                let name = path.file_stem().and_then(OsStr::to_str);
                let name = name.ok_or_else(|| SchemaError::malformed(&path, "name", "is not Unicode"))?;
                images.insert(name.to_owned(), Picture::read(&path)?);
            }
        }
        Ok(Self { images })
    }

    fn semantic_digest(&self) -> Digest {
        let mut hasher = ContentHasher::new(Self::KIND);
        hasher.count(self.images.len());
        for (name, picture) in &self.images {
            hasher.text(name);
            hasher.count(picture.width as usize);
            hasher.count(picture.height as usize);
            hasher.bytes(&picture.rgb8);
        }
        hasher.finish()
    }
}
