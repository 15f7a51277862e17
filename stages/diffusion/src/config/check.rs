//! What holds for any configuration: counts that agree, sizes within reason, numbers that divide.

use crate::error::ModelError;

/// Sizes beyond this are taken for a damaged file.
// Weights have two such sizes and a kernel's, whose product then fits 64 bits.
const MAX_SIZE: usize = 1 << 16;

/// Fails where a list that goes by blocks has another length than the list of blocks.
pub(super) fn check_lengths(
    file: &str,
    blocks: usize,
    counts: &[(&str, usize)],
) -> Result<(), ModelError> {
    // Everything behind this reads block 0 without asking.
    if blocks == 0 {
        return Err(ModelError::field(file, "block_out_channels", "is empty"));
    }
    match counts.iter().find(|(_, count)| *count != blocks) {
        Some((field, count)) => {
            let problem = format!("has {count} entries; `block_out_channels` has {blocks}");
            Err(ModelError::field(file, *field, problem))
        }
        None => Ok(()),
    }
}

/// Fails where a size is zero or absurd.
pub(super) fn check_sizes(file: &str, sizes: &[(&str, &[usize])]) -> Result<(), ModelError> {
    let wrong = |size: &usize| !(1..=MAX_SIZE).contains(size);
    match sizes.iter().find_map(|(field, sizes)| {
        sizes
            .iter()
            .find(|size| wrong(size))
            .map(|size| (field, size))
    }) {
        Some((field, size)) => Err(ModelError::field(
            file,
            *field,
            format!("is {size}; it must be from 1 to {MAX_SIZE}"),
        )),
        None => Ok(()),
    }
}

/// Fails where the number of `field` for some block does not divide its channels.
pub(super) fn check_divisors(
    file: &str,
    field: &str,
    channels: &[usize],
    of: impl Fn(usize) -> usize,
) -> Result<(), ModelError> {
    match channels
        .iter()
        .enumerate()
        .find(|(i, channels)| !channels.is_multiple_of(of(*i)))
    {
        Some((i, channels)) => Err(ModelError::field(
            file,
            field,
            format!("is {}, which does not divide {channels}", of(i)),
        )),
        None => Ok(()),
    }
}
