//! Files with bytes changed and cut off: read, or refused with one error; never a panic.

use compute::Device;
use formats::FileBytes;
use proptest::prelude::*;
use upsampler::Upsampler;

use crate::support::bytes;

/// Bytes with some of them changed, and cut off or not.
fn damaged(
    mut bytes: Vec<u8>,
    changes: &[(prop::sample::Index, u8)],
    cut: Option<prop::sample::Index>,
) -> Vec<u8> {
    for (at, value) in changes {
        let at = at.index(bytes.len());
        bytes[at] = *value;
    }
    if let Some(cut) = cut {
        bytes.truncate(cut.index(bytes.len()));
    }
    bytes
}

fn changes() -> impl Strategy<Value = Vec<(prop::sample::Index, u8)>> {
    // Bytes that mean something in the grammars are likely.
    let byte = prop_oneof![
        any::<u8>(),
        prop::sample::select(b"0123456789=-., \n{}[]\"".to_vec())
    ];
    prop::collection::vec((any::<prop::sample::Index>(), byte), 0..6)
}

proptest! {
    #[test]
    fn a_damaged_pair_is_read_or_refused(
        text in changes(),
        numbers in changes(),
        cuts in any::<[Option<prop::sample::Index>; 2]>(),
        name in prop::sample::select(vec!["ncnn-span-f16", "ncnn-compact-f32"]),
    ) {
        let param = damaged(bytes(&format!("{name}.param")), &text, cuts[0]);
        let bin = damaged(bytes(&format!("{name}.bin")), &numbers, cuts[1]);
        let [param, bin] = [("w.param", param), ("w.bin", bin)].map(|(name, bytes)| FileBytes::in_memory(name, bytes));
        let _ = Upsampler::from_ncnn(&param, &bin, &Device::cpu());
    }

    #[test]
    fn a_damaged_safetensors_file_is_read_or_refused(
        changes in changes(),
        cut in any::<Option<prop::sample::Index>>(),
        name in prop::sample::select(vec!["span-x4", "rrdb-x4-old", "compact-x2", "residual-x4"]),
    ) {
        let bytes = damaged(bytes(&format!("{name}.safetensors")), &changes, cut);
        let _ = Upsampler::from_safetensors(FileBytes::in_memory("w.safetensors", bytes), &Device::cpu());
    }
}
