//! The tile that an open GPU takes for every kind of products, as text too. It knows no clock and
//! no file.
//!
//! All tiles sum along the depth in one order, so that a choice changes how long a product takes
//! and no bit of it.

use std::fmt;

use super::tile::{LARGE, SQUARE, TILES, Tile};

/// Kinds of products that have a tile each: how they read their factors, and how many tiles there
/// are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Class {
    /// Of linear layers, with too few large tiles for all processors of a GPU.
    FewDense,
    /// Of linear layers, with enough.
    ManyDense,
    /// Of convolutions, with too few.
    FewConv,
    /// Of convolutions, with enough.
    ManyConv,
}

impl Class {
    /// All kinds, in the order of [`Tuning`].
    pub const ALL: [Class; 4] = [
        Class::FewDense,
        Class::ManyDense,
        Class::FewConv,
        Class::ManyConv,
    ];

    /// The kind of a product that is not thin.
    pub fn of(is_dense: bool, is_many: bool) -> Class {
        Class::ALL[usize::from(is_many) + 2 * usize::from(!is_dense)]
    }

    fn name(self) -> &'static str {
        [
            "linear, few tiles",
            "linear, many tiles",
            "convolution, few tiles",
            "convolution, many tiles",
        ][self as usize]
    }

    /// The tile until something was measured.
    pub fn usual(self) -> Tile {
        if matches!(self, Class::FewDense | Class::FewConv) {
            SQUARE
        } else {
            LARGE
        }
    }
}

/// The tile of every kind of products.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tuning([Tile; 4]);

impl Default for Tuning {
    fn default() -> Tuning {
        Tuning::of(Class::usual)
    }
}

impl Tuning {
    /// The tile that `choose` names for every kind.
    pub fn of(choose: impl Fn(Class) -> Tile) -> Tuning {
        Tuning(Class::ALL.map(choose))
    }

    /// The tile of a kind.
    pub fn tile(&self, class: Class) -> Tile {
        self.0[class as usize]
    }

    /// What [`fmt::Display`] wrote; `None` if that does not name a tile for every kind.
    pub fn read(text: &str) -> Option<Tuning> {
        let tile = |class: Class| {
            let name = text
                .lines()
                .find_map(|line| line.strip_prefix(class.name())?.strip_prefix(": "))?;
            TILES.into_iter().find(|tile| tile.to_string() == name)
        };
        let [a, b, c, d] = Class::ALL.map(tile);
        Some(Tuning([a?, b?, c?, d?]))
    }
}

impl fmt::Display for Tuning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        Class::ALL
            .iter()
            .try_for_each(|class| writeln!(f, "{}: {}", class.name(), self.tile(*class)))
    }
}
