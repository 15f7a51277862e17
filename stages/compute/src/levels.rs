//! All tests on the CPU again, with narrower vectors than the processor's widest.

use std::process::Command;

use crate::Device;

/// Runs this program's other tests in a process limited to `level`.
fn passes_at(level: &str) {
    let program = std::env::current_exe().expect("the path of this program");
    let skipped = [
        "every_test_passes",
        "on_a_gpu",
        "runtime::gpu",
        "ops::tuning",
    ];
    let output = Command::new(program)
        .env("COMPUTE_SIMD", level)
        .args(skipped.map(|name| format!("--skip={name}")))
        .output()
        .expect("it runs");
    assert!(
        output.status.success(),
        "{level}: {}",
        String::from_utf8_lossy(&output.stdout)
    );
}

#[test]
fn every_test_passes_with_portable_vectors() {
    passes_at("portable");
}

#[test]
fn every_test_passes_with_avx2() {
    passes_at("avx2");
}

#[test]
fn a_limit_is_obeyed() {
    if let Ok(limit) = std::env::var("COMPUTE_SIMD") {
        let used = Device::cpu().instructions();
        assert!(
            used == limit || used == "portable",
            "limited to {limit}, but using {used}"
        );
    }
}
