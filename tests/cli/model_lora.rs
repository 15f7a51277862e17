//! `model run` with a LoRA: its names, and the same bytes however it is computed.

use std::collections::BTreeMap;
use std::fs;

use serde_json::json;

use crate::model_run::{ask, inputs};
use crate::space::Space;
use crate::tensors::{Tensor, reals, save, shapes};

const LORA: &str = "unet.mid_block.attentions.0.transformer_blocks.0.attn1.to_q";

#[test]
fn two_runs_and_any_number_of_threads_give_the_same_bytes() {
    let space = Space::new();
    save(&space.path("in.safetensors"), &inputs());
    let down = format!("{LORA}.lora_A.weight");
    let up = format!("{LORA}.lora_B.weight");
    let lora = BTreeMap::from([
        (&down[..], reals(4, &[3, 128])),
        (&up[..], reals(5, &[128, 3])),
    ]);
    save(&space.path("lora.safetensors"), &lora);
    let lora = space.path("lora.safetensors");
    for (output, threads, keep) in [("a", "1", "1024"), ("b", "2", "1024"), ("c", "2", "0")] {
        let more = [
            "--lora",
            lora.to_str().unwrap(),
            "--target-grad",
            "--threads",
            threads,
            "--keep",
            keep,
        ];
        let said = ask(&space, output, &more);
        assert_eq!((said.code, &said.out[..]), (0, ""), "{}", said.err);
    }
    let [a, b, c] = ["a", "b", "c"].map(|name| fs::read(space.path(name)).unwrap());
    assert!(a == b, "another number of threads, other bytes");
    assert!(a == c, "activations computed again, other bytes");
    assert_eq!(space.mode("a"), space.mode("in.safetensors"));
    let expected = [
        ("grad.sample".to_owned(), vec![2, 19, 5, 6]),
        (format!("grad.{down}"), vec![3, 128]),
        (format!("grad.{up}"), vec![128, 3]),
        ("loss".into(), vec![]),
        ("sample".into(), vec![2, 16, 5, 6]),
    ];
    assert_eq!(shapes(&space.path("a")), BTreeMap::from(expected));
}

#[test]
fn a_lora_under_kohyas_names_is_the_same_with_alpha_over_rank() {
    let space = Space::new();
    save(&space.path("in.safetensors"), &inputs());
    let [a, b] = [reals(4, &[3, 128]), reals(5, &[128, 3])];
    let twice = |(dtype, shape, bytes): &Tensor| {
        let values = bytes.as_chunks().0.iter();
        let doubled = values.flat_map(|four| (2.0 * f32::from_le_bytes(*four)).to_le_bytes());
        (*dtype, shape.clone(), doubled.collect::<Vec<u8>>())
    };
    let layer = LORA.trim_start_matches("unet.").replace('.', "_");
    let [down, up, alpha] = ["lora_down.weight", "lora_up.weight", "alpha"]
        .map(|part| format!("lora_unet_{layer}.{part}"));
    let six = ("F32", vec![], 6f32.to_le_bytes().to_vec());
    let kohya = BTreeMap::from([
        (&down[..], a.clone()),
        (&up[..], b.clone()),
        (&alpha[..], six),
    ]);
    save(&space.path("kohya.safetensors"), &kohya);
    let [down, up] = ["A", "B"].map(|matrix| format!("{LORA}.lora_{matrix}.weight"));
    save(
        &space.path("peft.safetensors"),
        &BTreeMap::from([(&down[..], a), (&up[..], twice(&b))]),
    );
    let [a, b] = ["kohya", "peft"].map(|name| {
        let lora = space.path(&format!("{name}.safetensors"));
        let said = ask(&space, name, &["--lora", lora.to_str().unwrap()]);
        assert_eq!(said.code, 0, "{}", said.err);
        fs::read(space.path(name)).unwrap()
    });
    assert!(a == b, "6 over a rank of 3 is 2, which scales exactly");
}

#[test]
fn alphas_for_patterns_of_layers_are_refused() {
    let space = Space::new();
    save(&space.path("in.safetensors"), &inputs());
    let [down, up] = ["A", "B"].map(|matrix| format!("{LORA}.lora_{matrix}.weight"));
    let lora = BTreeMap::from([
        (&down[..], reals(4, &[3, 128])),
        (&up[..], reals(5, &[128, 3])),
    ]);
    save(&space.path("lora.safetensors"), &lora);
    let ask = |pattern: &str| {
        let options = json!({"lora_alpha": 3, "alpha_pattern": {pattern: 6}});
        fs::write(space.path("adapter_config.json"), options.to_string()).unwrap();
        let lora = space.path("lora.safetensors");
        ask(&space, "out", &["--lora", lora.to_str().unwrap()])
    };
    assert_eq!(ask("attn1.to_q").code, 0);
    let said = ask(".*to_q");
    assert!(
        said.code == 3 && said.err.contains("alpha_pattern"),
        "{}",
        said.err
    );
}
