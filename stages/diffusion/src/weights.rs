//! The weights of one network: tensors out of one file, or out of the shards of one.
//!
//! Hands out tensors by the place of their layer, each of exactly the shape that is asked for, and
//! knows which nobody wanted.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};

use compute::{Array, Device, Precision, Weight};
use formats::{FileBytes, TensorError, TensorFile};

use crate::error::ModelError;

/// Open weights.
pub(crate) struct Weights {
    files: Vec<TensorFile>,
    device: Device,
    /// For each name, the file that holds the tensor and its name there.
    places: BTreeMap<String, (usize, String)>,
    unread: RefCell<BTreeSet<String>>,
    /// Whether tensors are widened once and for all.
    widen: bool,
    precision: Precision,
}

/// Weights of fewer bytes are widened when they are read; larger ones stay in the file's map and in
/// its number format, and the operators widen them piece by piece.
const WIDENED: usize = 64 << 20;

impl Weights {
    /// Reads the headers of `files`. Fails where a header and its file do not fit together, and
    /// where two hold one tensor.
    pub fn open(files: Vec<FileBytes>, device: &Device) -> Result<Self, ModelError> {
        let files = files
            .into_iter()
            .map(TensorFile::new)
            .collect::<Result<Vec<_>, _>>()?;
        let mut places = BTreeMap::new();
        for (i, file) in files.iter().enumerate() {
            for name in file.names() {
                if let Some((other, _)) = places.insert(name.to_owned(), (i, name.to_owned())) {
                    return Err(file
                        .wrong(name, format!("is also in {}", files[other].name()))
                        .into());
                }
            }
        }
        let unread = RefCell::new(places.keys().cloned().collect());
        let widen = are_widened(&files);
        Ok(Self {
            files,
            device: device.clone(),
            places,
            unread,
            widen,
            precision: Precision::F32,
        })
    }

    /// The same weights, multiplied in another precision.
    pub fn with_precision(self, precision: Precision) -> Self {
        Self { precision, ..self }
    }

    /// The root of all names.
    pub fn root(&self) -> Scope<'_> {
        Scope {
            weights: self,
            path: String::new(),
        }
    }

    /// Renames tensors; for files written under older names.
    pub fn rename(&mut self, new_name: impl Fn(&str) -> String) {
        self.places = std::mem::take(&mut self.places)
            .into_iter()
            .map(|(old, at)| (new_name(&old), at))
            .collect();
        self.unread = RefCell::new(self.places.keys().cloned().collect());
    }

    /// Fails if there is a tensor that nothing has asked for, except those whose name ends with one
    /// of `ignored`.
    pub fn finish(self, ignored: &[&str]) -> Result<(), ModelError> {
        let unread = self.unread.into_inner();
        match unread
            .iter()
            .find(|name| !ignored.iter().any(|end| name.ends_with(end)))
        {
            Some(name) => {
                let (file, name) = &self.places[name];
                Err(self.files[*file]
                    .wrong(name, "belongs to no layer of the configuration")
                    .into())
            }
            None => Ok(()),
        }
    }

    fn weight(&self, name: &str, shape: &[usize]) -> Result<Weight, ModelError> {
        let Some((file, stored)) = self.places.get(name) else {
            let file = self.files.first().map_or("", TensorFile::name);
            return Err(ModelError::tensor(
                file,
                name,
                format!("of shape {shape:?} is missing"),
            ));
        };
        let file = &self.files[*file];
        let extents = without_pixels(file.entry(stored)?.shape(), shape);
        if extents != shape {
            let problem =
                format!("has the shape {extents:?}; the configuration asks for {shape:?}");
            return Err(file.wrong(stored, problem).into());
        }
        let weight = stored_weight(file, stored, &self.device)?.reshape(shape);
        self.unread.borrow_mut().remove(name);
        let weight = if self.widen {
            weight.to_array().into()
        } else {
            weight
        };
        Ok(weight.with_precision(self.precision))
    }
}

/// The tensor of this name as it lies in the file, which stays mapped. Fails where there is none,
/// where it holds other numbers than F32, F16 or BF16, and where one of them is not finite.
fn stored_weight(file: &TensorFile, name: &str, device: &Device) -> Result<Weight, TensorError> {
    let entry = file.entry(name)?;
    let dtype = entry.dtype();
    Weight::stored(
        device,
        entry.shape(),
        &dtype,
        file.file().shared(),
        entry.bytes(),
    )
    .map_err(|fault| file.wrong(name, fault))
}

/// The real numbers of this name in an array of their own.
pub fn array(file: &TensorFile, name: &str, device: &Device) -> Result<Array, ModelError> {
    Ok(stored_weight(file, name, device)?.to_array())
}

fn size(file: &TensorFile) -> usize {
    file.file().len()
}

fn are_widened(files: &[TensorFile]) -> bool {
    files.iter().map(size).sum::<usize>() < WIDENED
}

/// The bytes of memory that the weights of `files` take once they are read.
pub(crate) fn memory(files: &[TensorFile]) -> usize {
    match are_widened(files) {
        true => {
            4 * files
                .iter()
                .flat_map(TensorFile::counts)
                .map(|(_, count)| count)
                .sum::<usize>()
        }
        false => files.iter().map(size).sum(),
    }
}

/// Attention of old files keeps its linear weights as 1x1 convolutions: `shape` where `stored` is
/// one of that shape.
fn without_pixels<'a>(stored: &'a [usize], shape: &'a [usize]) -> &'a [usize] {
    match stored {
        [outputs, inputs, 1, 1] if shape == [*outputs, *inputs] => shape,
        other => other,
    }
}

/// A place in the tree of tensor names.
#[derive(Clone)]
pub(crate) struct Scope<'a> {
    weights: &'a Weights,
    path: String,
}

impl Scope<'_> {
    /// The place `name` below this one; `name` may have several parts.
    pub fn at(&self, name: impl std::fmt::Display) -> Self {
        let path = if self.path.is_empty() {
            name.to_string()
        } else {
            format!("{}.{name}", self.path)
        };
        Self {
            weights: self.weights,
            path,
        }
    }

    /// This place's full name.
    pub fn path(&self) -> &str {
        &self.path
    }

    /// Whether there is a tensor `name` below this place.
    pub fn has(&self, name: &str) -> bool {
        self.weights.places.contains_key(self.at(name).path())
    }

    /// The tensor `name` below this place, of exactly this shape. Fails if it is missing, of
    /// another shape or not finite.
    pub fn tensor(&self, name: &str, shape: &[usize]) -> Result<Array, ModelError> {
        Ok(self.weight(name, shape)?.to_array())
    }

    /// The same as the operators take it that widen as they go; for the large ones.
    pub fn weight(&self, name: &str, shape: &[usize]) -> Result<Weight, ModelError> {
        self.weights.weight(self.at(name).path(), shape)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::ModelSource;

    /// Weights of files that each hold two F16 numbers under each of the names.
    fn open(files: &[&[&str]]) -> Result<Weights, String> {
        let folder = tempfile::tempdir().unwrap();
        let source = ModelSource::Folder(folder.path().to_owned());
        let file = |(i, names): (usize, &&[&str])| {
            let entry = |(k, name): (usize, &&str)| {
                format!(
                    r#""{name}":{{"dtype":"F16","shape":[2],"data_offsets":[{},{}]}}"#,
                    4 * k,
                    4 * k + 4
                )
            };
            let header = format!(
                "{{{}}}",
                names
                    .iter()
                    .enumerate()
                    .map(entry)
                    .collect::<Vec<_>>()
                    .join(",")
            );
            let data = vec![0; 4 * names.len()];
            let bytes = [
                &(header.len() as u64).to_le_bytes(),
                header.as_bytes(),
                &data,
            ]
            .concat();
            std::fs::write(folder.path().join(format!("{i}.safetensors")), bytes).unwrap();
            source.file(&format!("{i}.safetensors")).unwrap()
        };
        let files = files.iter().enumerate().map(file).collect();
        Weights::open(files, &Device::cpu()).map_err(|e| e.to_string())
    }

    #[test]
    fn shards_are_one_set_of_weights() {
        let weights = open(&[&["a.w"], &["a.b"]]).unwrap();
        let scope = weights.root().at("a");
        assert!(scope.has("w") && scope.has("b") && !scope.has("c"));
        scope.tensor("w", &[2]).unwrap();
        scope.tensor("b", &[2]).unwrap();
        weights.finish(&[]).unwrap();
        let twice = open(&[&["a"], &["b", "a"]]).err().unwrap();
        assert!(
            twice.contains("1.safetensors: tensor `a` is also in ")
                && twice.ends_with("0.safetensors"),
            "{twice}"
        );
    }

    #[test]
    fn what_does_not_fit_is_named() {
        let weights = open(&[&["w"], &["v"]]).unwrap();
        let shape = weights.root().tensor("v", &[3]).unwrap_err().to_string();
        let expected =
            "1.safetensors: tensor `v` has the shape [2]; the configuration asks for [3]";
        assert!(shape.ends_with(expected), "{shape}");
        let missing = weights.root().tensor("b", &[4]).unwrap_err().to_string();
        assert!(
            missing.ends_with("tensor `b` of shape [4] is missing"),
            "{missing}"
        );
        let extra = weights.finish(&["w"]).unwrap_err().to_string();
        assert!(
            extra.ends_with("1.safetensors: tensor `v` belongs to no layer of the configuration"),
            "{extra}"
        );
    }
}
