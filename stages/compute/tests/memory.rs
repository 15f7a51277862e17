//! Attention needs memory for its tokens, not for their pairs.
#![cfg(target_os = "linux")]

use std::process::Command;

use compute::attention::{attention, attention_backward};
use compute::{Device, Rng};

/// Set in the process that measures itself.
const TOKENS: &str = "ATTENTION_TOKENS";
/// Features of the one head.
const DEPTH: usize = 8;

/// Prints the most memory that this process ever held, after attention forward and backward.
#[test]
fn measures_itself() {
    let Some(tokens) = std::env::var(TOKENS)
        .ok()
        .and_then(|tokens| tokens.parse().ok())
    else {
        return;
    };
    let rng = Rng::new(1, "memory");
    let [q, k, v, dout] =
        [1, 2, 3, 4].map(|step| rng.normals(step, &[1, tokens, DEPTH], &Device::cpu()));
    let attended = attention(&q, &k, &v, 1, false);
    attention_backward(&q, &k, &v, &attended, 1, false, &dout);
    let status = std::fs::read_to_string("/proc/self/status").expect("Linux tells");
    let peak = status
        .lines()
        .find_map(|line| line.strip_prefix("VmHWM:"))
        .expect("the peak");
    println!("peak {}", peak.trim().trim_end_matches(" kB"));
}

/// The peak of a process that attends over so many tokens, in KiB.
fn peak(tokens: usize) -> usize {
    let program = std::env::current_exe().expect("the path of this program");
    let arguments = ["--exact", "measures_itself", "--nocapture"];
    let output = Command::new(program)
        .env(TOKENS, tokens.to_string())
        .args(arguments)
        .output()
        .expect("it runs");
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let peak = text
        .split("peak ")
        .nth(1)
        .and_then(|rest| rest.split_whitespace().next());
    peak.and_then(|peak| peak.parse().ok())
        .unwrap_or_else(|| panic!("no peak in: {text}"))
}

#[test]
fn attention_at_16384_tokens_holds_no_matrix_of_scores() {
    let least = peak(1);
    let small = peak(4096);
    let large = peak(16384);
    let matrix = 16384 * 16384 * 4 / 1024;
    assert!(
        large - least < matrix / 16,
        "{} KiB, where the scores are {matrix} KiB",
        large - least
    );
    let inputs = 16384 * DEPTH * 4 / 1024;
    let growth = large.saturating_sub(small);
    assert!(
        growth < 40 * inputs,
        "from 4096 to 16384 tokens grows by {growth} KiB; one input is {inputs} KiB"
    );
}
