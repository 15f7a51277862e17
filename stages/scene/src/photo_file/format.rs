//! Which format a photo's file has, by its name and by its first bytes. Decodes nothing.

/// Endings of the names of photos that are read, in the order in which copies of one photo are
/// preferred.
const READ: [&str; 7] = ["png", "jpg", "jpeg", "webp", "tif", "tiff", "exr"];
/// Endings of photos and films that are not read, with what people call them.
const NOT_READ: [(&str, &str); 23] = [
    ("heic", "HEIC"),
    ("heif", "HEIF"),
    ("avif", "AVIF"),
    ("jxl", "JPEG XL"),
    ("jp2", "JPEG 2000"),
    ("gif", "GIF"),
    ("bmp", "BMP"),
    ("tga", "TGA"),
    ("hdr", "Radiance HDR"),
    ("pfm", "PFM"),
    ("ppm", "PPM"),
    ("pgm", "PGM"),
    ("psd", "PSD"),
    ("dng", "DNG (camera raw)"),
    ("cr2", "CR2 (camera raw)"),
    ("cr3", "CR3 (camera raw)"),
    ("nef", "NEF (camera raw)"),
    ("arw", "ARW (camera raw)"),
    ("raf", "RAF (camera raw)"),
    ("orf", "ORF (camera raw)"),
    ("rw2", "RW2 (camera raw)"),
    ("mp4", "MP4 (film)"),
    ("mov", "MOV (film)"),
];

/// What people are told to convert to.
pub(crate) const FORMATS: &str = "PNG, JPEG, WebP, TIFF or EXR";

/// A format by a file's first bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Format {
    Png,
    Jpeg,
    Webp,
    Tiff,
    Exr,
    /// A format that is not read, by the name that people know.
    NotRead(&'static str),
    /// A text that git-lfs leaves where a file was not fetched.
    LfsPointer,
    Empty,
    Unknown,
}

impl Format {
    /// The format of a file that begins with these bytes; 32 are enough.
    pub(crate) fn of(head: &[u8]) -> Self {
        // By content where possible: people rename files without converting them.
        match head {
            [] => Self::Empty,
            [0x89, b'P', b'N', b'G', ..] => Self::Png,
            [0xFF, 0xD8, 0xFF, ..] => Self::Jpeg,
            [
                b'R',
                b'I',
                b'F',
                b'F',
                _,
                _,
                _,
                _,
                b'W',
                b'E',
                b'B',
                b'P',
                ..,
            ] => Self::Webp,
            // 43 is BigTIFF.
            [b'I', b'I', 42 | 43, 0, ..] | [b'M', b'M', 0, 42 | 43, ..] => Self::Tiff,
            [0x76, 0x2F, 0x31, 0x01, ..] => Self::Exr,
            [b'G', b'I', b'F', b'8', ..] => Self::NotRead("GIF"),
            [b'B', b'M', ..] => Self::NotRead("BMP"),
            // A bare codestream, or the ISO container.
            [0xFF, 0x0A, ..] | [0, 0, 0, 12, b'J', b'X', b'L', ..] => Self::NotRead("JPEG XL"),
            [0, 0, 0, 12, b'j', b'P', ..] => Self::NotRead("JPEG 2000"),
            [_, _, _, _, b'f', b't', b'y', b'p', brand @ ..] => Self::by_brand(brand),
            [b'#', b'?', b'R', b'A', ..] => Self::NotRead("Radiance HDR"),
            _ if is_lfs_pointer(head) => Self::LfsPointer,
            _ => Self::Unknown,
        }
    }

    /// ISO base media files say in four letters what they hold.
    fn by_brand(brand: &[u8]) -> Self {
        match brand {
            [b'a', b'v', b'i', ..] => Self::NotRead("AVIF"),
            [b'h', ..] | [b'm', b'i', b'f', b'1', ..] => Self::NotRead("HEIC"),
            [b'c', b'r', b'x', ..] => Self::NotRead("CR3 (camera raw)"),
            // Nearly all other brands (isom, mp41, qt) are films.
            _ => Self::NotRead("a film"),
        }
    }
}

/// Whether a file begins as the texts do that git-lfs leaves where a file was not fetched.
pub(crate) fn is_lfs_pointer(head: &[u8]) -> bool {
    head.starts_with(b"version https://git-lfs")
}

/// Where in the order of preference names with this ending stand; `None` for one that is no
/// photo's.
pub(crate) fn rank(extension: &str) -> Option<usize> {
    READ.iter()
        .position(|known| extension.eq_ignore_ascii_case(known))
}

/// What a photo or film with this ending is called, if it is one that is not read.
pub(crate) fn not_read(extension: &str) -> Option<&'static str> {
    NOT_READ
        .iter()
        .find(|(known, _)| extension.eq_ignore_ascii_case(known))
        .map(|(_, name)| *name)
}

/// A name and its ending, where that is one of photos, read or not.
pub(crate) fn split(name: &str) -> (&str, Option<&str>) {
    match name.rsplit_once('.') {
        Some((stem, ending))
            // Only photos' endings are cut off: `scene.v2` has none.
            if !stem.is_empty() && (rank(ending).is_some() || not_read(ending).is_some()) =>
        {
            (stem, Some(ending))
        }
        _ => (name, None),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn formats_are_known_by_their_first_bytes() {
        assert_eq!(Format::of(b"\x89PNG\r\n"), Format::Png);
        assert_eq!(
            Format::of(b"\0\0\0\x18ftypheic\0\0\0\0"),
            Format::NotRead("HEIC")
        );
        assert_eq!(
            Format::of(b"version https://git-lfs.github.com/spec/v1\n"),
            Format::LfsPointer
        );
        assert_eq!(Format::of(b""), Format::Empty);
        assert_eq!(Format::of(b"words"), Format::Unknown);
    }

    #[test]
    fn endings_are_known_in_any_case() {
        assert_eq!(split("a.b.JPEG"), ("a.b", Some("JPEG")));
        assert_eq!(split("r_0.5"), ("r_0.5", None));
        assert_eq!(not_read("Heic"), Some("HEIC"));
        assert!(rank("Png") < rank("JPG"));
    }
}
