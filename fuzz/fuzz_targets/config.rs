//! Any bytes as a network's configuration: read, or refused with one error.
#![no_main]

use formats::FileBytes;
use diffusion::config::{TextConfig, UnetConfig, VaeConfig};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let file = FileBytes::in_memory("fuzz.json", bytes.to_vec());
    let _ = (UnetConfig::read(&file), VaeConfig::read(&file), TextConfig::read(&file));
});
