//! The named tensors of a safetensors file. Hands them out by name, each of exactly the shape that
//! is asked for, and knows which nobody wanted.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};

use compute::{Array, Device, Weight};
use formats::{FileBytes, TensorFile, tensor_file::Entry};

use crate::error::UpsamplerError;

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

/// Enlargements beyond this are no networks that anybody uses.
const LARGEST: usize = 16;

/// A file whose tensors are being handed out.
pub struct Tensors {
    file: TensorFile,
    device: Device,
    /// For each name, what the file calls the tensor.
    stored: BTreeMap<String, String>,
    // Readers share the tensors and cross off what they have read.
    unread: RefCell<BTreeSet<String>>,
}

impl Tensors {
    /// The tensors of `file`, under their names without what all of them begin with.
    pub fn open(file: FileBytes, device: &Device) -> Result<Self, UpsamplerError> {
        let file = TensorFile::new(file)?;
        let names = file.names().map(|name| (name.to_owned(), name.to_owned()));
        let stored = without_prefixes(names.collect());
        Ok(Self {
            unread: RefCell::new(stored.keys().cloned().collect()),
            file,
            device: device.clone(),
            stored,
        })
    }

    /// How messages name the file.
    pub fn file(&self) -> &str {
        self.file.name()
    }

    /// Where the tensors go.
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// The tensors' names, sorted.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.stored.keys().map(String::as_str)
    }

    /// Gives tensors other names; for files written under older ones. Fails where two would then
    /// have the same: one of them would be lost in silence.
    pub fn rename(&mut self, new_name: impl Fn(&str) -> String) -> Result<(), UpsamplerError> {
        let mut renamed = BTreeMap::new();
        for (old, stored) in &self.stored {
            let new = new_name(old);
            if renamed.insert(new.clone(), stored.clone()).is_some() {
                return Err(self.wrong(old, format!("would be {new}, as another tensor is")));
            }
        }
        self.stored = renamed;
        // Renamed as well, or `finish` would name tensors that are read under new names.
        self.unread = RefCell::new(self.stored.keys().cloned().collect());
        Ok(())
    }

    /// Whether there is a tensor of this name.
    pub fn has(&self, name: &str) -> bool {
        self.stored.contains_key(name)
    }

    /// The shape of a tensor; `None` where there is none of this name.
    pub fn shape(&self, name: &str) -> Option<&[usize]> {
        self.entry(name).map(Entry::shape)
    }

    fn entry(&self, name: &str) -> Option<&Entry> {
        self.file.entry(self.stored.get(name)?).ok()
    }

    /// By how much the last convolution enlarges, whose outputs are laid out as blocks of pixels.
    pub fn scale(&self, name: &str) -> Result<usize, UpsamplerError> {
        let [outputs, ..] = self.kernels(name)?;
        // Bounded, since the count of channels comes from a foreign file.
        let scale = (1..=LARGEST).find(|scale| 3 * scale * scale == outputs);
        scale.ok_or_else(|| {
            self.wrong(
                name,
                format!(
                    "gives {outputs} channels, which are no whole number of pixels of three colours"
                ),
            )
        })
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
        // Numbered from 0 without a gap, as all families' layers are.
        (0..).find(|&i| !self.has(&name(i))).unwrap_or_default()
    }

    /// The tensor of this name and shape. Fails where there is none, where it is of another shape,
    /// where it holds other numbers than F32, F16 or BF16, and where one of them is not finite.
    pub fn array(&self, name: &str, shape: &[usize]) -> Result<Array, UpsamplerError> {
        let Some(entry) = self.entry(name) else {
            return Err(self.wrong(name, format!("of shape {shape:?} is missing")));
        };
        if entry.shape() != shape {
            let problem = format!("has the shape {:?}; expected is {shape:?}", entry.shape());
            return Err(self.wrong(name, problem));
        }
        self.unread.borrow_mut().remove(name);
        // Widened straight from the file's bytes, which are shared and not copied.
        let owner = self.file.file().shared();
        Weight::stored(&self.device, shape, &entry.dtype(), owner, entry.bytes())
            .map(|weight| weight.to_array())
            .map_err(|fault| self.wrong(name, fault))
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
        self.file.counts()
    }

    /// An error about the tensor of this name.
    pub fn wrong(&self, name: &str, problem: impl ToString) -> UpsamplerError {
        let stored = self.stored.get(name).map_or(name, String::as_str);
        self.file.wrong(stored, problem).into()
    }
}

/// Names without what all of them begin with.
fn without_prefixes(mut names: BTreeMap<String, String>) -> BTreeMap<String, String> {
    // Repeated, since programs put prefixes one behind the other (`module.params_ema.`).
    while let Some(prefix) = shared_prefix(&names) {
        names = names
            .into_iter()
            .map(|(name, stored)| (name[prefix.len()..].to_owned(), stored))
            .collect();
    }
    names
}

fn shared_prefix(names: &BTreeMap<String, String>) -> Option<&'static str> {
    let mut prefixes = PREFIXES.into_iter().filter(|_| !names.is_empty());
    // Of all names or of none: a prefix of some is part of a layer's name.
    prefixes.find(|prefix| names.keys().all(|name| name.starts_with(prefix)))
}
