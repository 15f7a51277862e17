//! From a field to what it was made from: the field that its training began with, and the photos.
//! Goes by what files tell of themselves and what the store has. Knows nothing of pipelines.

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use artifacts_schema::{Artifact, ArtifactKind, Field, Provenance};

use crate::content;
use crate::store::Store;
use crate::store::error::{At, StoreError};
use crate::store::record::{Output, Record};
use crate::store::runs::RunRecord;

/// The file of a field.
const FILE: &str = "field.safetensors";
/// The input of a stage that trains a field further.
const FIELD: &str = "field";
/// The inputs that hold the photos: of a stage that trains a field on them beside others, or on
/// them alone.
const PHOTOS: [&str; 2] = ["low", "images"];
/// The inputs that hold the largest pictures that a stage trains a field on.
const PICTURES: [&str; 2] = ["images", "low"];
/// The outputs of a stage that splits photos.
const SPLIT: [&str; 2] = ["train", "test"];

/// A field as it is written, and what it tells of itself.
pub struct Told {
    pub field: Field,
    /// Where it comes from; of somebody else's field nothing is known.
    pub provenance: Provenance,
}

/// By name: the digests of what a stage read.
type Inputs = BTreeMap<String, String>;

impl Told {
    /// Reads a field by its file, its folder, or the folder of the stage that made it.
    pub fn read(path: &Path) -> Result<Self, String> {
        // What lies beside another file must not be taken for it.
        if path.is_file() && path.file_name() != Some(OsStr::new(FILE)) {
            return Err(format!(
                "{}: a field's file is called {FILE}",
                path.display()
            ));
        }
        let folder = [path.to_owned(), path.join(FIELD)]
            .into_iter()
            .find(|folder| folder.join(FILE).is_file());
        let folder = folder
            // `Field::read` takes a folder, whatever the user named.
            .or_else(|| path.is_file().then(|| path.parent().map(Path::to_owned))?)
            .unwrap_or_else(|| path.to_owned());
        Ok(Self {
            field: Field::read(&folder).map_err(|error| error.to_string())?,
            provenance: content::provenance(&folder.join(FILE)).unwrap_or_default(),
        })
    }

    fn input(&self, name: &str) -> Option<&String> {
        self.provenance.inputs.get(name)
    }
}

/// What a store has, by the digests of contents.
pub struct Lineage<'s> {
    store: &'s Store,
    artifacts: BTreeMap<String, Output>,
    /// By the digest of photos that are trained on: those that were held out beside them.
    held_out: BTreeMap<String, Output>,
}

impl<'s> Lineage<'s> {
    /// Of all that a store has.
    pub fn new(store: &'s Store) -> Result<Self, StoreError> {
        let records = store.results.records()?;
        let split = |record: &Record| {
            let [train, test] = SPLIT.map(|name| record.outputs.get(name));
            Some((train?.digest.to_string(), test?.clone()))
        };
        let held_out = records.iter().filter_map(split).collect();
        let outputs = records.into_iter().flat_map(|record| record.outputs);
        Ok(Self {
            store,
            artifacts: outputs
                .map(|(_, output)| (output.digest.to_string(), output))
                .collect(),
            held_out,
        })
    }

    /// The field of a result.
    pub fn field(&self, output: &Output) -> Result<Told, StoreError> {
        self.read(output, Told::read)
    }

    /// The field that the training of another began with, as far back as the store has it.
    pub fn root(&self, told: &Told) -> Result<Option<Told>, StoreError> {
        let mut root: Option<Told> = None;
        let mut seen = BTreeSet::new();
        while let Some(output) = self.input(root.as_ref().unwrap_or(told), FIELD) {
            // A training that changed nothing gave the field that it began with, and would lead in
            // a circle.
            if !seen.insert(output.digest) {
                break;
            }
            root = Some(self.field(output)?);
        }
        Ok(root)
    }

    /// The photos that a field was made from, if the store has them.
    pub fn photos<A: Artifact>(&self, told: &Told) -> Result<Option<A>, StoreError> {
        let inputs = self.first_inputs(told)?;
        self.first(&inputs, PHOTOS)
    }

    /// The largest pictures that a field was trained on, if the store has them.
    pub fn pictures<A: Artifact>(&self, told: &Told) -> Result<Option<A>, StoreError> {
        self.first(&told.provenance.inputs, PICTURES)
    }

    /// The photos that were held out beside those that a field was made from, if the store has
    /// them.
    pub fn held_out<A: Artifact>(&self, told: &Told) -> Result<Option<A>, StoreError> {
        let inputs = self.first_inputs(told)?;
        let beside = |name: &str| self.held_out.get(inputs.get(name)?);
        self.artifact(PHOTOS.into_iter().find_map(beside))
    }

    /// The inputs of the training that a field began with: later ones may have seen enlargements
    /// alone.
    fn first_inputs(&self, told: &Told) -> Result<Inputs, StoreError> {
        let root = self.root(told)?;
        Ok(root.as_ref().unwrap_or(told).provenance.inputs.clone())
    }

    fn first<A: Artifact>(
        &self,
        inputs: &Inputs,
        names: [&str; 2],
    ) -> Result<Option<A>, StoreError> {
        let artifact = |name: &str| self.artifacts.get(inputs.get(name)?);
        self.artifact(names.into_iter().find_map(artifact))
    }

    fn artifact<A: Artifact>(&self, output: Option<&Output>) -> Result<Option<A>, StoreError> {
        output
            .filter(|output| output.kind == A::KIND)
            .map(|output| {
                self.read(output, |folder| {
                    A::read(folder).map_err(|error| error.to_string())
                })
            })
            .transpose()
    }

    fn input(&self, told: &Told, name: &str) -> Option<&Output> {
        self.artifacts.get(told.input(name)?)
    }

    fn read<T>(
        &self,
        output: &Output,
        read: impl FnOnce(&Path) -> Result<T, String>,
    ) -> Result<T, StoreError> {
        let folder = tempfile::tempdir().at("create a folder in", &std::env::temp_dir())?;
        // Inside of the temporary folder: `show` clears the folder that it fills.
        let shown: PathBuf = folder.path().join("artifact");
        output.show(self.store, &shown)?;
        read(&shown).map_err(|problem| StoreError::Output {
            output: output.kind.to_string(),
            problem,
        })
    }
}

/// The stages of a run that gave fields on which no other stage of it went on training, with these
/// fields.
pub fn last_fields(run: &RunRecord, store: &Store) -> Result<BTreeMap<String, Output>, StoreError> {
    let mut fields = BTreeMap::new();
    let mut begun_with = BTreeSet::new();
    for (name, stage) in &run.stages {
        let Some(key) = stage.key else { continue };
        let Some(record) = store.results.lookup(&key)?.sound() else {
            continue;
        };
        let Some(field) = field_of(record) else {
            continue;
        };
        // A manifest that is gone names no field: one field too many may be offered then, and none
        // too few.
        let manifest = store.manifests.get(&key).unwrap_or_default();
        // The last fields of a run are those with which no other stage has begun.
        begun_with.extend(manifest.0.get("inputs.field").cloned());
        fields.insert(name.clone(), field);
    }
    fields.retain(|_, field| !begun_with.contains(&field.digest.to_string()));
    Ok(fields)
}

fn field_of(record: Record) -> Option<Output> {
    let mut outputs = record.outputs.into_values();
    outputs.find(|output| output.kind == ArtifactKind::Field)
}
