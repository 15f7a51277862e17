//! `store`: commands about the store as a whole, one file each.

mod du;
mod fsck;
mod transfer;

use clap::Subcommand;

use crate::cli::error::Error;

/// What to do with the store.
#[derive(Subcommand)]
pub enum Store {
    /// Send results to a remote that lacks them
    Push(transfer::Transfer),
    /// Fetch results from a remote that the store lacks
    Pull(transfer::Transfer),
    /// Find damage, name it and put it out of reach, so that the next run computes what is lost
    Fsck(fsck::Fsck),
    /// Print what takes the space, by pipeline and stage
    Du(du::Du),
}

impl Store {
    /// Does it.
    pub fn run(self, json: bool) -> Result<(), Error> {
        match self {
            Self::Push(transfer) => transfer.push(json),
            Self::Pull(transfer) => transfer.pull(json),
            Self::Fsck(fsck) => fsck.run(json),
            Self::Du(du) => du.run(json),
        }
    }
}
