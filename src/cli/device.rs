//! From `--device` to a device. Knows names, not what is computed.

use compute::{Counts, Device};
use serde_json::{Value, json};

use super::error::Error;

/// The device of this name: `auto`, `cpu`, `gpu` or `gpu:N`.
pub fn open(name: &str) -> Result<Device, Error> {
    // A number that cannot be parsed is kept as an error: `gpu:x` must not be taken for `gpu`.
    let (kind, number) = name
        .split_once(':')
        .map_or((name, None), |(kind, number)| (kind, Some(number.parse())));
    match (kind, number.transpose()) {
        ("auto", Ok(None)) => Ok(Device::auto()),
        ("cpu", Ok(None)) => Ok(Device::cpu()),
        ("gpu", Ok(number)) => Device::gpu(number).map_err(|error| Error::Usage {
            message: error.to_string(),
            help: None,
        }),
        _ => Err(Error::usage(
            format!("there is no device `{name}`"),
            "the devices are auto, cpu, gpu and gpu:N",
        )),
    }
}

/// Counts as `--json` prints them.
pub fn counts(counts: Counts) -> Value {
    json!({
        "dispatches": counts.dispatches, "submissions": counts.submissions, "read_backs": counts.read_backs,
        "operations": counts.operations, "bytes": counts.bytes, "uploaded": counts.uploaded,
        "pipelines": counts.pipelines,
    })
}
