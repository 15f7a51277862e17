//! Any bytes as an ncnn pair, the graph up to the first zero, the weights behind it: read, or
//! refused with one error.
#![no_main]

use compute::Device;
use libfuzzer_sys::fuzz_target;
use formats::FileBytes;
use upsampler::Upsampler;

fuzz_target!(|bytes: &[u8]| {
    let end = bytes.iter().position(|&byte| byte == 0).unwrap_or(bytes.len());
    let graph = FileBytes::in_memory("fuzz.param", bytes[..end].to_vec());
    let weights = FileBytes::in_memory("fuzz.bin", bytes.get(end + 1..).unwrap_or_default().to_vec());
    let _ = Upsampler::from_ncnn(&graph, &weights, &Device::cpu());
});
