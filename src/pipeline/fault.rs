//! Something wrong at a place in a pipeline, before anyone has looked up where in the file that is.

/// A place in a pipeline: the names of the fields that lead to it, variants left out (`stages`,
/// `fit`, `field`, `levels`).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FieldPath(pub Vec<String>);

/// Something wrong at a place.
#[derive(Debug)]
pub struct Fault {
    pub place: FieldPath,
    pub message: String,
    /// A name that is not known, and those that are.
    pub unknown: Option<(String, Vec<String>)>,
    /// How to mend it.
    pub help: Option<String>,
}

impl FieldPath {
    /// A field of the pipeline itself.
    pub fn root(field: &str) -> Self {
        Self(vec![field.to_owned()])
    }

    /// A field of this place.
    pub fn at(&self, field: &str) -> Self {
        Self([&self.0[..], &[field.to_owned()]].concat())
    }

    /// A field several levels down: `guidance.lora_every`.
    pub fn within(&self, fields: &str) -> Self {
        fields
            .split('.')
            .fold(self.clone(), |place, field| place.at(field))
    }

    /// Something wrong here.
    pub fn fault(&self, message: impl Into<String>) -> Fault {
        Fault {
            place: self.clone(),
            message: message.into(),
            unknown: None,
            help: None,
        }
    }
}

impl Fault {
    /// With a name that is not known, and those that are.
    pub fn with_names<'a>(mut self, found: &str, known: impl IntoIterator<Item = &'a str>) -> Self {
        self.unknown = Some((
            found.to_owned(),
            known.into_iter().map(str::to_owned).collect(),
        ));
        self
    }

    /// With advice, if there is any.
    pub fn with_help(mut self, help: Option<String>) -> Self {
        self.help = help;
        self
    }
}
