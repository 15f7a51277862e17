//! The weights of one network: tensors out of one file, out of the shards of one, or out of a file
//! of several networks.
//!
//! Hands out tensors by the place of their layer, each of exactly the shape that is asked for, and
//! knows which nobody wanted.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};

use compute::{Array, Device, Precision, Weight};
use formats::tensor_file::Entry;
use formats::{FileBytes, TensorFile};

use crate::error::ModelError;
use crate::single_file::error::SingleFileError;
use crate::single_file::names::Names;
use crate::stored::Stored;

/// The tensors of one network, in one file or in shards, as they were opened.
pub(crate) struct Weights {
    files: Vec<TensorFile>,
    device: Device,
    /// For each name, the file that holds the tensor and its name there.
    places: BTreeMap<String, (usize, String)>,
    /// How those names follow from diffusers'; `None` where they are the same.
    names: Option<Names>,
    // Shared behind `&self`, since many scopes borrow the weights at once.
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
                // Two shards with one tensor would make it a matter of their order which counts.
                if let Some((other, _)) = places.insert(name.to_owned(), (i, name.to_owned())) {
                    return Err(file
                        .wrong(name, format!("is also in {}", files[other].name()))
                        .into());
                }
            }
        }
        Ok(Self::at(files, places, None, device))
    }

    /// The tensors of one network of a single file, which has `names` for them.
    pub fn single(file: TensorFile, names: Names, device: &Device) -> Self {
        let taken = file.names().filter(|name| names.takes(name));
        let places = taken
            .map(|name| (name.to_owned(), (0, name.to_owned())))
            .collect();
        Self::at(vec![file], places, Some(names), device)
    }

    fn at(
        files: Vec<TensorFile>,
        places: BTreeMap<String, (usize, String)>,
        names: Option<Names>,
        device: &Device,
    ) -> Self {
        let mut weights = Self {
            files,
            device: device.clone(),
            unread: RefCell::new(places.keys().cloned().collect()),
            places,
            names,
            widen: false,
            precision: Precision::F32,
        };
        weights.widen = weights.bytes() < WIDENED;
        weights
    }

    /// Sets the precision that products round these weights to.
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
            // A tensor that nobody asked for is part of another network than the configuration
            // says.
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
        let place = self.place(name);
        let Some((file, stored)) = self.places.get(&place.name) else {
            return Err(self.missing(name, &place.name, shape));
        };
        let file = &self.files[*file];
        let stored = Stored {
            name: stored.clone(),
            third: place.third,
        };
        let entry = file.entry(&stored.name)?;
        let extents = stored.shape(entry);
        if extents.is_none_or(|extents| without_pixels(&extents, shape) != shape) {
            return Err(self.misshapen(name, file.name(), &stored, entry.shape(), shape));
        }
        // After the check of extents: a 1x1 convolution's four axes become two here.
        let weight = stored.weight(file, &self.device)?.reshape(shape);
        // Three projections may lead to one tensor: what is removed already stays so.
        self.unread.borrow_mut().remove(&place.name);
        let weight = if self.widen {
            weight.to_array().into()
        } else {
            weight
        };
        Ok(weight.with_precision(self.precision))
    }

    /// Where the tensor that a layer calls `name` is.
    fn place(&self, name: &str) -> Stored {
        self.names
            .map_or_else(|| Stored::whole(name), |names| names.stored(name))
    }

    fn missing(&self, name: &str, stored: &str, shape: &[usize]) -> ModelError {
        let file = self.files.first().map_or("", |file| file.name());
        match self.names {
            Some(names) => SingleFileError::missing(file, names.network(), stored, name).into(),
            None => ModelError::tensor(file, name, format!("of shape {shape:?} is missing")),
        }
    }

    /// The tensor at `stored` of `file` has the shape `has`, the layer asks for `shape`.
    fn misshapen(
        &self,
        name: &str,
        file: &str,
        stored: &Stored,
        has: &[usize],
        shape: &[usize],
    ) -> ModelError {
        let Some(names) = self.names else {
            let problem = format!("has the shape {has:?}; the configuration asks for {shape:?}");
            return ModelError::tensor(file, &stored.name, problem);
        };
        let parts = stored.third.map_or("", |_| " in each of three parts");
        let wanted = format!("{shape:?}{parts}");
        SingleFileError::shape(file, names.network(), &stored.name, name, has, &wanted).into()
    }

    fn entries(&self) -> impl Iterator<Item = &Entry> {
        let entry = |(file, name): &(usize, String)| self.files[*file].entry(name).ok();
        self.places.values().filter_map(entry)
    }

    fn bytes(&self) -> usize {
        self.entries().map(|entry| entry.bytes().len()).sum()
    }

    /// How many tensors there are.
    pub fn len(&self) -> usize {
        self.places.len()
    }

    /// For each number type that the files use, how many numbers there are.
    pub fn types(&self) -> BTreeMap<String, usize> {
        let mut types = BTreeMap::new();
        for entry in self.entries() {
            let count: usize = entry.shape().iter().product();
            *types.entry(entry.dtype()).or_default() += count;
        }
        types
    }

    /// The bytes of memory that they take once they are read.
    pub fn memory(&self) -> usize {
        match self.widen {
            true => 4 * self.types().values().sum::<usize>(),
            false => self.bytes(),
        }
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
        let place = self.weights.place(self.at(name).path());
        self.weights.places.contains_key(&place.name)
    }

    /// The tensor `name` below this place, of exactly this shape. Fails if it is missing, of
    /// another shape or not finite.
    pub fn tensor(&self, name: &str, shape: &[usize]) -> Result<Array, ModelError> {
        Ok(self.weight(name, shape)?.to_array())
    }

    /// The tensor `name` below this place in its own number format, which operators widen as they
    /// go: for the large ones. Fails as [`Scope::tensor`] does.
    pub fn weight(&self, name: &str, shape: &[usize]) -> Result<Weight, ModelError> {
        self.weights.weight(self.at(name).path(), shape)
    }
}

#[cfg(test)]
mod tests;
