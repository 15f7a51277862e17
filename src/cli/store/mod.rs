//! `store`: commands about the store as a whole, one file each.

mod transfer;

use clap::Subcommand;

use crate::error::Error;

/// What to do with the store.
#[derive(Subcommand)]
pub enum Store {
    /// Send results to a remote that lacks them
    Push(transfer::Transfer),
    /// Fetch results from a remote that the store lacks
    Pull(transfer::Transfer),
}

impl Store {
    /// Does it.
    pub fn run(self, json: bool) -> Result<(), Error> {
        match self {
            Self::Push(transfer) => transfer.push(json),
            Self::Pull(transfer) => transfer.pull(json),
        }
    }
}
