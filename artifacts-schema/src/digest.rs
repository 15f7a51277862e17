//! BLAKE3 digests, and the one way in which content is fed to them.
//!
//! Everything is preceded by its length, so that no two contents share a preimage. Knows nothing of
//! files.

use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;

use formats::{Bounds, Camera, Distortion, Tensor, rows};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::artifact::ArtifactKind;

/// A 256-bit BLAKE3 digest; as text, 64 lower-case hexadecimal digits.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Digest([u8; 32]);

/// A text that is not a digest.
#[derive(Debug, thiserror::Error)]
#[error("`{0}` is not a digest: expected 64 hexadecimal digits")]
pub struct NotADigest(String);

impl Digest {
    /// The digest with these bytes.
    pub const fn new(bytes: [u8; 32]) -> Self {
        Self(bytes)
    }

    /// The 32 bytes of the hash.
    pub const fn bytes(&self) -> &[u8; 32] {
        &self.0
    }
}

impl From<blake3::Hash> for Digest {
    fn from(hash: blake3::Hash) -> Self {
        Self(*hash.as_bytes())
    }
}

impl fmt::Display for Digest {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(&blake3::Hash::from_bytes(self.0).to_hex())
    }
}

impl fmt::Debug for Digest {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, out)
    }
}

impl FromStr for Digest {
    type Err = NotADigest;

    fn from_str(text: &str) -> Result<Self, NotADigest> {
        blake3::Hash::from_hex(text)
            .map(Self::from)
            .map_err(|_| NotADigest(text.to_owned()))
    }
}

impl Serialize for Digest {
    /// Its digits, or in formats that nobody reads its bytes.
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        // Binary caches hold many digests, and 32 bytes are half of 64 digits.
        if serializer.is_human_readable() {
            serializer.collect_str(self)
        } else {
            self.0.serialize(serializer)
        }
    }
}

impl<'de> Deserialize<'de> for Digest {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        if deserializer.is_human_readable() {
            String::deserialize(deserializer)?
                .parse()
                .map_err(serde::de::Error::custom)
        } else {
            <[u8; 32]>::deserialize(deserializer).map(Self)
        }
    }
}

/// Takes the canonical content of one artifact.
pub(crate) struct ContentHasher(blake3::Hasher);

impl ContentHasher {
    pub fn new(kind: ArtifactKind) -> Self {
        // A key of its own for each kind: two kinds never share a digest.
        Self(blake3::Hasher::new_derive_key(&format!(
            "srnerf-dag artifact {kind} v1"
        )))
    }

    pub fn finish(self) -> Digest {
        self.0.finalize().into()
    }

    /// The digest of posed images, whose box and views came before.
    pub fn end_of_images(mut self, to_source: Option<&[[f64; 4]; 4]>) -> Digest {
        // Behind everything and only where there is one, as with what came later elsewhere.
        if let Some(to_source) = to_source {
            self.text("to_source");
            self.reals(to_source.as_flattened());
        }
        self.finish()
    }

    pub fn count(&mut self, count: usize) {
        // As 64 bits, whatever the machine counts with.
        self.0.update(&(count as u64).to_le_bytes());
    }

    pub fn text(&mut self, text: &str) {
        // The length first: otherwise "a", "bc" and "ab", "c" would be equal.
        self.count(text.len());
        self.0.update(text.as_bytes());
    }

    pub fn json(&mut self, value: &serde_json::Value) {
        let mut value = value.clone();
        // The order of fields means nothing, and may change with the program.
        value.sort_all_objects();
        self.text(&value.to_string());
    }

    pub fn scores(&mut self, scores: &BTreeMap<String, f64>) {
        // The map is sorted, so equal scores are fed in one order.
        self.count(scores.len());
        for (name, &score) in scores {
            self.text(name);
            self.real(score);
        }
    }

    pub fn real(&mut self, value: f64) {
        // Adding zero turns -0.0 into 0.0 and leaves every other number alone.
        let canonical = if value.is_nan() {
            // There are many NaNs; which one a machine makes must not show.
            f64::NAN
        } else {
            value + 0.0
        };
        self.0.update(&canonical.to_bits().to_le_bytes());
    }

    pub fn reals(&mut self, values: &[f64]) {
        self.count(values.len());
        values.iter().for_each(|&value| self.real(value));
    }

    pub fn bytes(&mut self, bytes: &[u8]) {
        self.count(bytes.len());
        // BLAKE3 is a tree: the digest is that of one thread.
        self.0.update_rayon(bytes);
    }

    pub fn values(&mut self, values: &[f32]) {
        // Bounds the copy; BLAKE3's result does not depend on where it is cut.
        const CHUNK: usize = 1 << 18;
        self.count(values.len());
        for chunk in values.chunks(CHUNK) {
            let canonical = |&value: &f32| {
                if value.is_nan() {
                    f32::NAN
                } else {
                    value + 0.0
                }
            };
            // Little-endian on every machine.
            let bytes: Vec<[u8; 4]> = chunk
                .iter()
                .map(|value| canonical(value).to_bits().to_le_bytes())
                .collect();
            self.0.update_rayon(bytes.as_flattened());
        }
    }

    pub fn optional_values(&mut self, values: Option<&[f32]>) {
        // 0 or 1 first: none differs from an empty plane.
        self.count(usize::from(values.is_some()));
        if let Some(values) = values {
            self.values(values);
        }
    }

    /// Which pixels count; nothing where all do, so that the digest is that of the days before
    /// there were masks.
    pub fn mask(&mut self, mask: Option<&[bool]>) {
        if let Some(mask) = mask {
            let bytes: Vec<u8> = mask.iter().map(|counts| u8::from(*counts)).collect();
            // With a name, so that it cannot be taken for depths or for the next view.
            self.text("mask");
            self.bytes(&bytes);
        }
    }

    pub fn tensor(&mut self, tensor: &Tensor) {
        // The type by name leaves room for other types with the same bytes.
        self.text("f32");
        self.count(tensor.shape.len());
        tensor.shape.iter().for_each(|&extent| self.count(extent));
        self.values(&tensor.values);
    }

    pub fn tensors<'a>(
        &mut self,
        tensors: impl ExactSizeIterator<Item = (&'a String, &'a Tensor)>,
    ) {
        self.count(tensors.len());
        for (name, tensor) in tensors {
            self.text(name);
            self.tensor(tensor);
        }
    }

    pub fn bounds(&mut self, bounds: &Bounds) {
        self.reals(bounds.as_flattened());
    }

    pub fn camera(&mut self, camera: &Camera) {
        self.count(camera.width as usize);
        self.count(camera.height as usize);
        let lens = [
            camera.fl_x,
            camera.fl_y,
            camera.cx,
            camera.cy,
            camera.near,
            camera.far,
        ];
        self.reals(&[&lens[..], &bent(&camera.distortion)].concat());
        self.reals(rows::of(&camera.camera_to_world).as_flattened());
    }
}

/// What a digest takes of a lens: nothing of a pinhole, and the last four only where one of them is
/// not 0, so that digests are those of the days before there were any.
fn bent(distortion: &Distortion) -> Vec<f64> {
    let Distortion { k1, k2, k3, k4, .. } = *distortion;
    let Distortion { k5, k6, p1, p2, .. } = *distortion;
    let last = [k4, k5, k6, f64::from(u8::from(distortion.fisheye))];
    match last == [0.0; 4] {
        _ if distortion.is_none() => Vec::new(),
        true => vec![k1, k2, k3, p1, p2],
        false => [&[k1, k2, k3, p1, p2], &last[..]].concat(),
    }
}
