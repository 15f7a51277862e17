//! A stage's private state on disk: what lets a stage that was cut off go on with the same bits.
//!
//! Knows nothing of what a state means. The file: `MAGIC`, the BLAKE3 digest of all that follows,
//! the length of a JSON header in 8 bytes, the header, and the tensors' values in its order,
//! everything little-endian.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::Path;

use serde::{Deserialize, Serialize};
use serde_json::Value;

/// The first bytes of a file; the number is the layout's.
const MAGIC: &[u8; 24] = b"srnerf-dag checkpoint 1\n";

/// Shapes and row-major values by name.
pub type Tensors = BTreeMap<String, (Vec<usize>, Vec<f32>)>;

/// All that the coming steps of a stage depend on besides its parameters, inputs and seed.
#[derive(Clone, Debug, PartialEq)]
pub struct Checkpoint {
    /// Steps done.
    pub step: u64,
    /// Numbers; whole ones stand as f32, exact below 2^24.
    pub tensors: Tensors,
    /// Log, means and counts of the steps so far.
    pub notes: Value,
}

#[derive(Serialize, Deserialize)]
struct Header {
    step: u64,
    notes: Value,
    tensors: Vec<(String, Vec<usize>)>,
}

impl Checkpoint {
    /// Writes the file: whole, flushed and renamed into place, or not at all.
    pub fn write(&self, path: &Path) -> io::Result<()> {
        let folder = path.parent().unwrap_or(Path::new("."));
        // In the same folder: a rename does not cross file systems.
        let mut file = tempfile::NamedTempFile::new_in(folder)?;
        let body = self.body()?;
        file.write_all(MAGIC)?;
        file.write_all(blake3::hash(&body).as_bytes())?;
        file.write_all(&body)?;
        // Before the rename: a power cut must not leave the name on a file without its content.
        file.as_file().sync_all()?;
        file.persist(path)?;
        // A rename is safe from a power cut only once its folder is flushed too.
        File::open(folder)?.sync_all()
    }

    fn body(&self) -> io::Result<Vec<u8>> {
        let tensors = self
            .tensors
            .iter()
            .map(|(name, (shape, _))| (name.clone(), shape.clone()))
            .collect();
        let header = serde_json::to_vec(&Header {
            step: self.step,
            notes: self.notes.clone(),
            tensors,
        })?;
        let mut body = (header.len() as u64).to_le_bytes().to_vec();
        body.extend(header);
        // The header was made of the same map, so the order is the same.
        for (_, values) in self.tensors.values() {
            let bytes: Vec<[u8; 4]> = values.iter().map(|value| value.to_le_bytes()).collect();
            // As bits, so that minus zero and the last digit come back.
            body.extend_from_slice(bytes.as_flattened());
        }
        Ok(body)
    }

    /// Reads a file; `None` where there is none. Nothing of it is believed before its digest is
    /// right.
    pub fn read(path: &Path) -> io::Result<Option<Self>> {
        let bytes = match fs::read(path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            other => other?,
        };
        let damaged = || io::Error::new(io::ErrorKind::InvalidData, "its content is damaged");
        Self::from_bytes(&bytes).ok_or_else(damaged).map(Some)
    }

    fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let (digest, body) = bytes.strip_prefix(MAGIC)?.split_first_chunk::<32>()?;
        // Damage ends here. The checks below are for files that were made to mislead.
        if blake3::hash(body) != *digest {
            return None;
        }
        let (length, rest) = body.split_first_chunk::<8>()?;
        let (header, mut values) =
            rest.split_at_checked(usize::try_from(u64::from_le_bytes(*length)).ok()?)?;
        let Header {
            step,
            notes,
            tensors: shapes,
        } = serde_json::from_slice(header).ok()?;
        let mut tensors = Tensors::new();
        for (name, shape) in shapes {
            // Bytes: four for each value. The header may claim any size, so products are checked.
            let count = shape
                .iter()
                .try_fold(4usize, |bytes, &extent| bytes.checked_mul(extent))?;
            let (own, behind) = values.split_at_checked(count)?;
            values = behind;
            tensors.insert(
                name,
                (
                    shape,
                    own.as_chunks()
                        .0
                        .iter()
                        .map(|&four| f32::from_le_bytes(four))
                        .collect(),
                ),
            );
        }
        // What the header does not name must not be there.
        values.is_empty().then_some(Self {
            step,
            tensors,
            notes,
        })
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    const FILE: &str = "checkpoint";

    fn checkpoint(step: u64) -> Checkpoint {
        let tensors = [
            ("a".to_owned(), (vec![2, 1], vec![0.1, -0.0])),
            ("b".to_owned(), (vec![0], vec![])),
        ];
        Checkpoint {
            step,
            tensors: tensors.into(),
            notes: json!({"psnr": 0.1f64 + 0.2, "lines": []}),
        }
    }

    #[test]
    fn a_checkpoint_comes_back_bit_by_bit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(FILE);
        assert_eq!(Checkpoint::read(&path).unwrap(), None);
        checkpoint(7).write(&path).unwrap();
        let read = Checkpoint::read(&path).unwrap().unwrap();
        assert_eq!(read, checkpoint(7));
        assert!(read.tensors["a"].1[1].is_sign_negative());
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn whatever_bytes_are_changed_or_lost_nothing_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(FILE);
        checkpoint(7).write(&path).unwrap();
        let whole = fs::read(&path).unwrap();
        for at in 0..whole.len() {
            let mut changed = whole.clone();
            changed[at] ^= 0x10;
            assert_eq!(Checkpoint::from_bytes(&changed), None, "byte {at}");
            assert_eq!(Checkpoint::from_bytes(&whole[..at]), None, "{at} bytes");
        }
    }

    #[test]
    fn a_header_that_promises_too_much_is_refused() {
        for text in [
            r#"{"step":1,"notes":0,"tensors":[["a",[4611686018427387904,4]]]}"#,
            r#"{"step":1}"#,
            "",
        ] {
            let body = [&(text.len() as u64).to_le_bytes()[..], text.as_bytes()].concat();
            let bytes = [&MAGIC[..], blake3::hash(&body).as_bytes(), &body].concat();
            assert_eq!(Checkpoint::from_bytes(&bytes), None, "{text}");
        }
    }
}
