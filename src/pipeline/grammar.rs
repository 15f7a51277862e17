//! What a pipeline file may say: named stages in order, loops of them, and differences from another
//! file or between arms. Knows nothing of what references mean.

use std::collections::BTreeMap;
use std::fmt;
use std::marker::PhantomData;
use std::sync::LazyLock;

use serde::Deserialize;
use serde::de::{Deserializer, EnumAccess, Error, IgnoredAny, MapAccess, VariantAccess, Visitor};
use stages::Input;
use stages::registry::{AnyStage, KINDS};

/// A pipeline file as written.
///
/// `set`, `arms`, `matrix`, `include` and `exclude` hold values of fields whose types only the
/// stages know: here they are only checked to be RON, and [`super::layers`] reads them with their
/// places from the text.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields, rename = "Pipeline")]
#[expect(
    dead_code,
    reason = "some fields are read from the text, with their places"
)]
pub struct Document {
    /// Its name: that of its folder under `out/`.
    pub name: String,
    /// The file that it extends, relative to its own folder.
    #[serde(default)]
    pub base: Option<String>,
    /// The seed of everything random; by default that of the file it extends, or 0.
    #[serde(default)]
    pub seed: Option<u64>,
    /// Its stages and loops: those of the file it extends, replaced or added to by name.
    #[serde(default)]
    pub stages: Named<StageOrLoop>,
    /// Stages of the file it extends that it does not have.
    #[serde(default)]
    pub without: Vec<String>,
    /// Values of the file it extends, by the paths of `--set`.
    #[serde(default)]
    pub set: Option<IgnoredAny>,
    /// Named sets of such differences: what is compared.
    #[serde(default)]
    pub arms: Option<IgnoredAny>,
    /// Values by path: an arm for each combination.
    #[serde(default)]
    pub matrix: Option<IgnoredAny>,
    /// Combinations beside those of the matrix.
    #[serde(default)]
    pub include: Option<IgnoredAny>,
    /// Combinations of the matrix to leave out.
    #[serde(default)]
    pub exclude: Option<IgnoredAny>,
    /// The arm that others are compared with; by default the first.
    #[serde(default)]
    pub baseline: Option<String>,
    /// The arm whose field is the best that can be hoped for, if there is one.
    #[serde(default)]
    pub bound: Option<String>,
    /// The seeds that each arm is run with.
    #[serde(default)]
    pub seeds: Option<Vec<u64>>,
    /// The stages that are wanted, with all that they need; by default all.
    #[serde(default)]
    pub targets: Option<Vec<String>>,
    /// The row of metrics that arms are compared by.
    #[serde(default)]
    pub row: Option<String>,
}

/// A pipeline once the files that it extends are laid under it.
#[derive(Clone, Debug)]
pub struct Pipeline {
    pub name: String,
    /// The seed of everything random.
    pub seed: u64,
    /// Its stages and loops.
    pub stages: Named<StageOrLoop>,
}

/// A stage or a loop.
#[derive(Clone, Debug)]
pub enum StageOrLoop {
    Stage(Box<AnyStage>),
    /// A loop over stages.
    Rounds(Rounds),
}

/// A loop with state, unrolled when the pipeline is loaded.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rounds {
    /// How many rounds.
    pub count: u32,
    /// What `@name` means in the first round.
    #[serde(default)]
    pub carry: Named<Input>,
    /// The stages of one round.
    pub stages: Named<StageOrLoop>,
    /// What `@name` means in the next round, and `loop.name` after the last.
    #[serde(default)]
    pub next: Named<Input>,
}

/// Named things in the order of the file, each name once.
#[derive(Clone, Debug)]
pub struct Named<T> {
    items: Vec<(String, T)>,
    index: BTreeMap<String, usize>,
}

impl<T> Default for Named<T> {
    fn default() -> Self {
        Self {
            items: Vec::new(),
            index: BTreeMap::new(),
        }
    }
}

impl<T> Named<T> {
    /// The thing of this name.
    pub fn get(&self, name: &str) -> Option<&T> {
        self.index.get(name).map(|&at| &self.items[at].1)
    }

    /// The thing of this name, to be changed.
    pub fn get_mut(&mut self, name: &str) -> Option<&mut T> {
        self.index.get(name).map(|&at| &mut self.items[at].1)
    }

    /// Puts a thing in the place of that of the same name, or behind all others.
    pub fn put(&mut self, name: &str, item: T) {
        match self.index.get(name) {
            Some(&at) => self.items[at].1 = item,
            None => {
                self.index.insert(name.to_owned(), self.items.len());
                self.items.push((name.to_owned(), item));
            }
        }
    }

    /// Takes the thing of this name out; says whether there was one.
    pub fn remove(&mut self, name: &str) -> bool {
        let Some(at) = self.index.remove(name) else {
            return false;
        };
        self.items.remove(at);
        // The index holds places, and all items behind the one that went have moved up.
        for place in self.index.values_mut().filter(|place| **place > at) {
            *place -= 1;
        }
        true
    }

    /// All, in the order of the file.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &T)> {
        self.items.iter().map(|(name, item)| (name.as_str(), item))
    }

    /// All names, in the order of the file.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.items.iter().map(|(name, _)| name.as_str())
    }
}

impl<'de, T: Deserialize<'de>> Deserialize<'de> for Named<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_map(NamedVisitor(PhantomData))
    }
}

struct NamedVisitor<T>(PhantomData<T>);

impl<'de, T: Deserialize<'de>> Visitor<'de> for NamedVisitor<T> {
    type Value = Named<T>;

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str("a map of names: { \"name\": .. }")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
        let mut named = Named::default();
        while let Some(name) = map.next_key::<String>()? {
            if named.index.contains_key(&name) {
                // A map would keep the last of two silently, and the first stage would be gone
                // without a word.
                return Err(A::Error::custom(format!("`{name}` is defined twice")));
            }
            named.index.insert(name.clone(), named.items.len());
            named.items.push((name, map.next_value()?));
        }
        Ok(named)
    }
}

/// The loop's name where a stage kind could stand.
const ROUNDS: &str = "Rounds";

/// What may stand where a stage stands.
static VARIANTS: LazyLock<Vec<&'static str>> =
    LazyLock::new(|| KINDS.iter().copied().chain([ROUNDS]).collect());

impl<'de> Deserialize<'de> for StageOrLoop {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_enum("Stage", &VARIANTS, NodeVisitor)
    }
}

struct NodeVisitor;

impl<'de> Visitor<'de> for NodeVisitor {
    type Value = StageOrLoop;

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "a stage ({})", VARIANTS.join(", "))
    }

    fn visit_enum<A: EnumAccess<'de>>(self, access: A) -> Result<StageOrLoop, A::Error> {
        let (kind, fields) = access.variant::<Variant>()?;
        match kind.0 {
            // `Rounds(..)` holds its fields in one struct; `ron` is told to take them without a
            // second pair of parentheses.
            ROUNDS => fields.newtype_variant().map(StageOrLoop::Rounds),
            kind => AnyStage::from_variant(kind, fields)
                .map(|stage| StageOrLoop::Stage(Box::new(stage))),
        }
    }
}

/// The name of a stage kind, refused before its fields are read, so that the error points at the
/// name.
struct Variant(&'static str);

impl<'de> Deserialize<'de> for Variant {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_identifier(VariantVisitor)
    }
}

struct VariantVisitor;

impl Visitor<'_> for VariantVisitor {
    type Value = Variant;

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str("the name of a stage kind")
    }

    fn visit_str<E: Error>(self, name: &str) -> Result<Variant, E> {
        let known = VARIANTS.iter().find(|known| **known == name);
        known
            .map(|known| Variant(known))
            .ok_or_else(|| E::unknown_variant(name, &VARIANTS))
    }
}
