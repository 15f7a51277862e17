//! The named tensors of a safetensors file. Hands them out by name, each of exactly the shape that
//! is asked for, and knows which nobody wanted. Nothing is allocated before the header has been
//! checked against the file's size.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

use compute::{Array, Device, Format, Weight};
use safetensors::{Dtype, SafeTensors};

use crate::error::UpsamplerError;
use crate::source::SourceFile;

/// What training programs put before every name, and what says nothing.
const PREFIXES: [&str; 7] = [
    "params_ema.",
    "params.",
    "module.",
    "state_dict.",
    "netG.",
    "net_g.",
    "generator.",
];

/// Where a tensor lies, and what the file calls it.
struct Entry {
    stored: String,
    dtype: Dtype,
    shape: Vec<usize>,
    bytes: Range<usize>,
}

/// An open file.
pub struct Tensors {
    file: SourceFile,
    device: Device,
    entries: BTreeMap<String, Entry>,
    unread: RefCell<BTreeSet<String>>,
}

impl Tensors {
    /// The tensors of `file`, under their names without what all of them begin with.
    pub fn open(file: SourceFile, device: &Device) -> Result<Self, UpsamplerError> {
        let bytes = file.content();
        let (header, info) = SafeTensors::read_metadata(bytes).map_err(|e| {
            UpsamplerError::file(&file.name, format!("is not a sound safetensors file: {e}"))
        })?;
        let start = 8 + header;
        let entry = |(name, info): (String, &safetensors::tensor::TensorInfo)| {
            let (first, last) = info.data_offsets;
            let bytes = start + first..start + last;
            (
                name.clone(),
                Entry {
                    stored: name,
                    dtype: info.dtype,
                    shape: info.shape.clone(),
                    bytes,
                },
            )
        };
        let mut entries: BTreeMap<String, Entry> = info.tensors().into_iter().map(entry).collect();
        while let Some(prefix) = PREFIXES
            .into_iter()
            .find(|p| entries.keys().all(|name| name.starts_with(p)))
        {
            if entries.is_empty() {
                break;
            }
            entries = entries
                .into_iter()
                .map(|(name, entry)| (name[prefix.len()..].to_owned(), entry))
                .collect();
        }
        let unread = RefCell::new(entries.keys().cloned().collect());
        Ok(Self {
            file,
            device: device.clone(),
            entries,
            unread,
        })
    }

    /// How messages name the file.
    pub fn file(&self) -> &str {
        &self.file.name
    }

    /// Where the tensors go.
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// The tensors' names, sorted.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.entries.keys().map(String::as_str)
    }

    /// Gives tensors other names; for files written under older ones.
    pub fn rename(&mut self, new_name: impl Fn(&str) -> String) {
        self.entries = std::mem::take(&mut self.entries)
            .into_iter()
            .map(|(old, e)| (new_name(&old), e))
            .collect();
        self.unread = RefCell::new(self.entries.keys().cloned().collect());
    }

    /// Whether there is a tensor of this name.
    pub fn has(&self, name: &str) -> bool {
        self.entries.contains_key(name)
    }

    /// The shape of a tensor; `None` where there is none of this name.
    pub fn shape(&self, name: &str) -> Option<&[usize]> {
        self.entries.get(name).map(|entry| &entry.shape[..])
    }

    /// The extents of a convolution's weight. Fails where it is missing or has not four axes.
    pub fn kernels(&self, name: &str) -> Result<[usize; 4], UpsamplerError> {
        match self.shape(name) {
            Some(&[o, c, h, w]) => Ok([o, c, h, w]),
            Some(shape) => Err(self.wrong(
                name,
                format!("has the shape {shape:?}; a convolution's has four axes"),
            )),
            None => Err(self.wrong(name, "is missing")),
        }
    }

    /// How many numbered layers there are: the first number of which there is no tensor with the
    /// name made of it.
    pub fn count(&self, name: impl Fn(usize) -> String) -> usize {
        (0..).find(|&i| !self.has(&name(i))).unwrap_or_default()
    }

    /// The tensor of this name and shape. Fails where there is none, where it is of another shape,
    /// where it holds other numbers than F32, F16 or BF16, and where one of them is not finite.
    pub fn array(&self, name: &str, shape: &[usize]) -> Result<Array, UpsamplerError> {
        let Some(entry) = self.entries.get(name) else {
            return Err(self.wrong(name, format!("of shape {shape:?} is missing")));
        };
        if entry.shape != shape {
            return Err(self.wrong(
                name,
                format!("has the shape {:?}; expected is {shape:?}", entry.shape),
            ));
        }
        let format = match entry.dtype {
            Dtype::F32 => Format::F32,
            Dtype::F16 => Format::F16,
            Dtype::BF16 => Format::Bf16,
            other => {
                return Err(self.wrong(
                    name,
                    format!("is {other:?}; supported are F32, F16 and BF16"),
                ));
            }
        };
        self.unread.borrow_mut().remove(name);
        let weight = Weight::from_bytes(
            &self.device,
            shape,
            format,
            self.file.bytes.clone(),
            entry.bytes.clone(),
        );
        match weight.first_not_finite() {
            Some((index, value)) => Err(self.wrong(name, format!("is {value} at element {index}"))),
            None => Ok(weight.to_array()),
        }
    }

    /// Passes over a tensor that says nothing about what is computed.
    pub fn ignore(&self, name: &str) {
        self.unread.borrow_mut().remove(name);
    }

    /// Fails if there is a tensor that nothing has asked for.
    pub fn finish(&self, family: &str) -> Result<(), UpsamplerError> {
        match self.unread.borrow().first() {
            Some(name) => Err(self.wrong(
                name,
                format!("belongs to no layer of {family}, which the others make"),
            )),
            None => Ok(()),
        }
    }

    /// For each number type, how many numbers there are.
    pub fn counts(&self) -> BTreeMap<String, usize> {
        let mut counts = BTreeMap::new();
        for entry in self.entries.values() {
            *counts.entry(format!("{:?}", entry.dtype)).or_default() +=
                entry.shape.iter().product::<usize>();
        }
        counts
    }

    /// An error about the tensor of this name.
    pub fn wrong(&self, name: &str, problem: impl Into<String>) -> UpsamplerError {
        let stored = self.entries.get(name).map_or(name, |entry| &entry.stored);
        UpsamplerError::tensor(&self.file.name, stored, problem)
    }
}
