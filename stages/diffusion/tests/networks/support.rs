//! What the tests of the networks share: golden files, formula numbers and the distance between two
//! results.

use std::collections::BTreeMap;
use std::path::Path;

use compute::{Array, Device};
use safetensors::SafeTensors;

/// The tensors that the generator script left in `golden/<name>`.
pub struct Golden(BTreeMap<String, Array>);

impl Golden {
    pub fn read(name: &str) -> Self {
        let bytes = std::fs::read(golden(name)).unwrap();
        let file = SafeTensors::deserialize(&bytes).unwrap();
        let array = |view: safetensors::tensor::TensorView| {
            let values = view
                .data()
                .as_chunks()
                .0
                .iter()
                .map(|b| f32::from_le_bytes(*b))
                .collect();
            Device::cpu().array(view.shape(), values)
        };
        Self(
            file.tensors()
                .into_iter()
                .map(|(name, view)| (name, array(view)))
                .collect(),
        )
    }

    /// Asserts that `actual` is the tensor `name` but for `tolerance` times its norm.
    #[track_caller]
    pub fn assert(&self, name: &str, actual: &Array, tolerance: f64) {
        let expected = &self.0[name];
        assert_eq!(actual.shape(), expected.shape(), "{name}");
        let off = distance(actual, expected);
        assert!(off < tolerance, "{name} is off by {off:.1e} of its norm");
    }

    /// The names that begin with `prefix`, without it.
    pub fn names<'a>(&'a self, prefix: &'a str) -> impl Iterator<Item = &'a str> {
        self.0
            .keys()
            .filter_map(move |name| name.strip_prefix(prefix))
    }
}

/// A file that the generator script left.
pub fn golden(name: &str) -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/golden")
        .join(name)
}

/// The norm of the difference over the norm of what is expected.
pub fn distance(actual: &Array, expected: &Array) -> f64 {
    let norm = |values: &mut dyn Iterator<Item = f64>| values.map(|v| v * v).sum::<f64>().sqrt();
    let actual = actual.to_vec();
    let expected = expected.to_vec();
    let difference = norm(&mut actual.iter().zip(&expected).map(|(a, b)| f64::from(a - b)));
    difference / norm(&mut expected.iter().map(|v| f64::from(*v))).max(f64::MIN_POSITIVE)
}

/// The generator's pseudo-random numbers in [-1, 1): a hash of the stream and the element's index.
pub fn numbers(stream: u64, shape: &[usize]) -> Array {
    let number = |i: u64| {
        let h = i
            .wrapping_mul(0x9E37_79B9_7F4A_7C15)
            .wrapping_add(stream.wrapping_mul(0xBF58_476D_1CE4_E5B9));
        let h = (h ^ (h >> 31)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((h ^ (h >> 29)) >> 40) as f32 / 8_388_608.0 - 1.0
    };
    Device::cpu().array(
        shape,
        (1..=shape.iter().product::<usize>() as u64)
            .map(number)
            .collect(),
    )
}
