//! Files that are not as they should be are refused, in words that name what is wrong.

use std::fs;
use std::path::Path;

use compute::Device;
use formats::FileBytes;
use safetensors::Dtype;
use upsampler::{Upsampler, UpsamplerSource};

use crate::support::{Stored, bytes, golden, pair_refused, refused, said, tensors};

#[track_caller]
fn says(said: &str, words: &str) {
    assert!(said.contains(words), "{said}");
}

#[test]
fn tensors_that_do_not_fit_are_named() {
    let changed = |name: &str, change: &dyn Fn(&mut Stored)| {
        let mut tensors = tensors(name);
        change(&mut tensors);
        refused(&tensors)
    };
    let residual = |change: &dyn Fn(&mut Stored)| changed("residual-x4.safetensors", change);
    let missing = residual(&|t| drop(t.remove("b.1.bias")));
    assert_eq!(
        missing,
        "w.safetensors: tensor `b.1.bias` of shape [8] is missing"
    );
    let shape = residual(&|t| t.get_mut("after.bias").unwrap().1 = vec![4, 2]);
    says(
        &shape,
        "tensor `after.bias` has the shape [4, 2]; expected is [8]",
    );
    let axes = residual(&|t| t.get_mut("first.weight").unwrap().1 = vec![8, 27]);
    says(
        &axes,
        "tensor `first.weight` has the shape [8, 27]; a convolution's has four axes",
    );
    let extra = residual(&|t| drop(t.insert("c.weight".into(), (Dtype::F32, vec![1], vec![0; 4]))));
    says(
        &extra,
        "tensor `c.weight` belongs to no layer of Residual, which the others make",
    );
    let kind = residual(&|t| t.get_mut("last.bias").unwrap().0 = Dtype::I16);
    says(
        &kind,
        "tensor `last.bias` is I16; supported are F32, F16 and BF16",
    );
    let number = residual(&|t| t.get_mut("last.bias").unwrap().2[2..4].copy_from_slice(&[0, 0x7e]));
    says(&number, "tensor `last.bias` is NaN at element 1");
    let scale = changed("compact-x4.safetensors", &|t| {
        t.insert(
            "params.body.8.weight".into(),
            (Dtype::F32, vec![47, 8, 3, 3], vec![0; 47 * 72 * 4]),
        );
    });
    says(
        &scale,
        "tensor `params.body.8.weight` gives 47 channels, which are no whole number of pixels",
    );
    let inputs = changed("rrdb-x4.safetensors", &|t| {
        t.insert(
            "params_ema.conv_first.weight".into(),
            (Dtype::F16, vec![8, 4, 3, 3], vec![0; 8 * 36 * 2]),
        );
    });
    says(
        &inputs,
        "tensor `params_ema.conv_first.weight` takes 4 channels; known are 3, 12 and 48",
    );
    let twice = changed("rrdb-x4-old.safetensors", &|t| {
        let first = t["model.0.bias"].clone();
        t.insert("conv_first.bias".into(), first);
    });
    says(
        &twice,
        "tensor `model.0.bias` would be conv_first.bias, as another tensor is",
    );
    let part = changed("span-x4.safetensors", &|t| {
        drop(t.remove("params_ema.block_3.c2_r.conv.1.weight"))
    });
    says(&part, "tensor `block_3.c2_r.conv.1.weight` is missing");
    let other = refused(
        &[(
            "layers.0.norm.weight".into(),
            (Dtype::F32, vec![1], vec![0; 4]),
        )]
        .into(),
    );
    says(
        &other,
        "tensor `layers.0.norm.weight` is of no network that is known here: those are SPAN",
    );
    says(&refused(&Stored::new()), "w.safetensors: holds no tensors");
}

#[test]
fn cut_safetensors_are_refused() {
    let whole = bytes("span-x2.safetensors");
    for len in [0, 7, 8, 100, whole.len() / 2, whole.len() - 1] {
        let file = FileBytes::in_memory("w.safetensors", whole[..len].to_vec());
        says(
            &said(Upsampler::from_safetensors(file, &Device::cpu())),
            "w.safetensors: is not a sound safetensors file: ",
        );
    }
}

/// A copy of a golden pair's graph with one text in the place of another.
fn graph(name: &str, old: &str, new: &str) -> String {
    let text = fs::read_to_string(golden(name)).unwrap();
    assert!(text.contains(old), "{old}");
    text.replacen(old, new, 1)
}

#[test]
fn layers_that_are_not_known_are_named_with_their_line() {
    let name = "ncnn-compact-f32.param";
    let bin = bytes("ncnn-compact-f32.bin");
    let changed = |old: &str, new: &str| pair_refused(&graph(name, old, new), &bin);
    let kind = changed("PReLU            p1", "Mish             p1");
    says(
        &kind,
        "w.param: line 6: layer `p1_PReLU` (Mish) with 1 inputs is of a kind that is not known here",
    );
    says(
        &changed("4=1 5=1", "3=2 4=1 5=1"),
        "layer `c0_Convolution` (Convolution) has 2 as its stride (parameter 3)",
    );
    says(
        &changed("1=3 4=1", "1=4 4=1"),
        "has a kernel of side 4; supported are odd ones up to 15",
    );
    says(
        &changed("1=3 4=1", "1=3 4=0"),
        "pads 0 pixels around a kernel of 3; supported are 1 zeros",
    );
    says(
        &changed("6=189", "6=190"),
        "says it has 190 weights, with 3 channels in, 7 out, and a kernel of 3",
    );
    says(
        &changed("6=189", "6=189 9=5"),
        "has the activation 5 with [], which is not known here",
    );
    says(
        &changed("6=189", "6=189 7=7"),
        "has the parameter 7=[7.0], which is not known here",
    );
    says(
        &changed("6=189", "6=189 6=1"),
        "gives the parameter 6 twice",
    );
    says(
        &changed("6=189", "6=many"),
        "has the parameter \"6=many\"; expected is number=value",
    );
    says(
        &changed("p1 0=7", "p1 0=6"),
        "layer `p1_PReLU` (PReLU) has 6 slopes for 7 channels",
    );
    says(
        &changed("shuffled 0=2", "shuffled 0=3"),
        "shuffles 12 channels by 3",
    );
    says(&changed("1=2.0 2=2.0", "1=2.0 2=3.0"), "resizes by 2 and 3");
    says(
        &changed("1=2.0 2=2.0", "1=4.0 2=4.0"),
        "takes images of different sizes",
    );
    says(
        &changed("0=1 1=2.0", "0=7 1=2.0"),
        "resizes in the way 7; known are 1, 2 and 3",
    );
    says(
        &changed("x0 base", "x9 base"),
        "layer `base_Interp` (Interp) takes `x9`, which no layer before it gives",
    );
    says(
        &changed("c0 p1 0=7", "c0 c0 0=7"),
        "gives `c0`, which another layer has given",
    );
    says(
        &changed("shuffled base output", "shuffled shuffled output"),
        "nothing takes `base`, `output`; supported is one result",
    );
    let bare = "7767517\n2 2\nInput i 0 1 x\nSwish s 1 1 x y";
    says(
        &pair_refused(&bare.replace("x y", "x y 0=1"), &[]),
        "line 4: layer `s` (Swish) has the parameter 0=[1.0]",
    );
    let small = "7767517\n2 2\nInput i 0 1 x\nReorg r 1 1 x y 0=2";
    says(
        &pair_refused(small, &[]),
        "gives the result, 12 channels of 1/2 times the side; expected are 3, enlarged",
    );
}

#[test]
fn graphs_that_are_none_are_refused() {
    for (text, words) in [
        (
            "",
            "w.param: does not begin with 7767517, as ncnn's graphs do",
        ),
        ("7767518\n1 1\n", "does not begin with 7767517"),
        (
            "7767517\nmany\n",
            "line 2: expected are the numbers of layers and of blobs",
        ),
        (
            "7767517\n2 1\nInput i 0 1 x\n",
            "holds 1 layers; its second line says 2",
        ),
        (
            "7767517\n1 1\nInput i 0\n",
            "line 3: expected are a layer's kind, name, and numbers of inputs and outputs",
        ),
        (
            "7767517\n1 1\nInput i 0 99999999999999999999 x\n",
            "line 3: layer `i`: the numbers of inputs and outputs are no",
        ),
        (
            "7767517\n1 1\nInput i 18446744073709551615 9 x\n",
            "line 3: layer `i` names fewer blobs than",
        ),
        (
            "7767517\n1 1\nInput i 0 2 x\n",
            "line 3: layer `i` names fewer blobs than 0 and 2",
        ),
        (
            "7767517\n1 1\nSwish i 0 1 x\n",
            "line 3: layer `i` (Swish) is the first; a graph begins with its Input",
        ),
        (
            "7767517\n2 2\nInput i 0 1 x\nInput j 0 1 y\n",
            "line 4: layer `j` (Input) is a second input",
        ),
        (
            "7767517\n1 1\nInput i 0 1 x 2=1\n",
            "has 1 as its number of channels (parameter 2); supported is 3",
        ),
        ("7767517\n0 0\n", "w.param: holds no layers"),
    ] {
        says(&pair_refused(text, &[]), words);
    }
    let binary = FileBytes::in_memory("w.param", vec![0xff, 0xfe]);
    let none = FileBytes::in_memory("w.bin", Vec::new());
    says(
        &said(Upsampler::from_ncnn(&binary, &none, &Device::cpu())),
        "w.param: is no text; ncnn's .param files",
    );
}

#[test]
fn weights_that_do_not_belong_to_the_graph_are_refused() {
    let param = graph("ncnn-span-f16.param", "", "");
    let bin = bytes("ncnn-span-f16.bin");
    let cut = pair_refused(&param, &bin[..1000]);
    says(&cut, "needs weights of shape [6, 6, 3, 3] at byte ");
    says(&cut, "of w.bin, which has 1000");
    says(
        &pair_refused(&param, &[]),
        "layer `mean_MemoryData` (MemoryData) needs weights of shape [3] at byte 0",
    );
    let longer = [&bin[..], &[0; 4]].concat();
    says(
        &pair_refused(&param, &longer),
        "w.bin: has 4 bytes more than the layers of its .param take",
    );
    let marked = |mark: u32| {
        let mut bin = bin.clone();
        bin[12..16].copy_from_slice(&mark.to_le_bytes());
        pair_refused(&param, &bin)
    };
    says(
        &marked(0x000d_4b38),
        "layer `first_Convolution` (Convolution) has weights of 8 bits",
    );
    says(&marked(0x0002_c056), "has weights with scales");
    says(
        &marked(77),
        "has weights behind the mark 0x0000004d, in a table perhaps",
    );
    let mut infinite = bin.clone();
    infinite[16..18].copy_from_slice(&[0, 0x7c]);
    says(
        &pair_refused(&param, &infinite),
        "layer `first_Convolution` (Convolution) has the weight inf at element 0",
    );
}

#[test]
fn other_files_are_refused_with_the_way_out() {
    let folder = tempfile::tempdir().unwrap();
    let load = |name: &str| {
        said(Upsampler::load(
            &UpsamplerSource::File(folder.path().join(name)),
            &Device::cpu(),
        ))
    };
    says(
        &load("x.pth"),
        "x.pth: is a pickle, which can run any code when it is read; where you trust it, convert it:",
    );
    says(
        &load("x.onnx"),
        "x.onnx: is no upsampler that is read here: those are .safetensors, and .param with .bin",
    );
    says(&load("x.safetensors"), "x.safetensors: is missing");
    fs::write(folder.path().join("x.param"), "7767517").unwrap();
    says(&load("x.param"), "x.bin: is missing; ");
    says(
        &load("x.bin"),
        "x.param beside it is only half of an ncnn network",
    );
    says(
        &said(Upsampler::load(
            &UpsamplerSource::File(Path::new("/").to_owned()),
            &Device::cpu(),
        )),
        "/: is no upsampler",
    );
}
