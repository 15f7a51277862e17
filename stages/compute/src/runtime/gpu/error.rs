//! Why a GPU cannot be used, or can be used no more. Each message names what to do.

/// What is wrong with a GPU.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum GpuError {
    /// No driver offers an adapter.
    #[error("no GPU was found: {0}")]
    NoAdapter(String),
    /// There are software adapters only, and none was asked for by its number.
    #[error(
        "there is no hardware GPU, only {0}, which computes on the CPU; to use it all the same, name it: \
         `--device gpu:0`"
    )]
    OnlySoftware(String),
    /// The number is too high.
    #[error(
        "there is no GPU {asked}; there are {count}, counted from 0, and `srnerf-dag doctor` lists them"
    )]
    NoSuchAdapter {
        /// The number asked for.
        asked: usize,
        /// How many adapters there are.
        count: usize,
    },
    /// An adapter that cannot run the kernels.
    #[error("{adapter} cannot be used: {reason}; use another one or `--device cpu`")]
    Unfit {
        /// Its name, as the driver tells it.
        adapter: String,
        /// What it lacks, or what its driver said.
        reason: String,
    },
    /// The memory of the device is full.
    #[error(
        "the GPU's memory is full: arrays hold {held} MiB, and no more could be had; lower the crop, \
         the views per step, the tile of the autoencoder, a field's `samples` or `log2_table` or `--keep`, \
         close what else uses the GPU, or take `--device cpu`"
    )]
    OutOfMemory {
        /// MiB that arrays hold.
        held: u64,
    },
    /// More than a kernel of this adapter can see, even if it sees arrays piece by piece.
    #[error(
        "{asked} MiB in one piece are more than {limit} MiB, the most that this GPU's kernels can see at once; \
         lower the crop, the views per step, the tile of the autoencoder or a field's `log2_table`, \
         or take `--device cpu`"
    )]
    TooLarge {
        /// MiB that were asked for in one piece.
        asked: u64,
        /// MiB that there may be at most.
        limit: u64,
    },
    /// The driver gave up: a reset, a time-out, a removed device.
    #[error(
        "the GPU was lost ({0}); run the same command again, which goes on from the last checkpoint, \
         or take `--device cpu`"
    )]
    Lost(String),
    /// The driver refused a command: a bug in the kernels or in the driver.
    #[error("the GPU refused a command: {0}")]
    Refused(String),
}
