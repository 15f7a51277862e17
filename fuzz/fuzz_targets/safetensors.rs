//! Any bytes as a safetensors file: read, or refused with one error.
#![no_main]

use compute::Device;
use formats::{FileBytes, TensorFile};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let Ok(file) = TensorFile::new(FileBytes::in_memory("fuzz.safetensors", bytes.to_vec())) else { return };
    for name in file.names() {
        let _ = diffusion::array(&file, name, &Device::cpu());
        let _ = file.whole(name);
    }
});
