//! Products against their definition, bit for bit, and every vector width against the others.

use super::*;
use compute::rng::Rng;

fn random(len: usize, domain: &str) -> Vec<f32> {
    let rng = Rng::new(1, domain);
    (0..len as u64).map(|i| rng.uniform(0, i) - 0.5).collect()
}

#[test]
fn a_product_is_the_sum_over_the_inner_index() {
    for (rows, inner, columns) in [(8, 5, 16), (24, 64, 32), (16, 32, 64)] {
        let a = random(rows * inner, "a");
        let b = random(inner * columns, "b");
        let mut c = vec![0.0; rows * columns];
        let [left, right] = [Matrix::new(&a, inner), Matrix::new(&b, columns)];
        product(
            &mut c,
            left,
            right,
            [inner, columns],
            Prologue::Zero,
            Epilogue::Keep,
        );
        for (i, &got) in c.iter().enumerate() {
            let row = i / columns;
            let column = i % columns;
            let fused = (0..inner).fold(0f32, |sum, k| {
                a[row * inner + k].mul_add(b[k * columns + column], sum)
            });
            assert_eq!(
                got, fused,
                "the order of the sum does not depend on the machine"
            );
        }
    }
}

#[test]
fn a_product_of_a_part_of_longer_rows_adds_to_what_is_there() {
    let a = random(16 * 24, "a");
    let b = random(24 * 48, "b");
    let mut c = vec![0.25; 16 * 32];
    let [left, right] = [Matrix::new(&a, 24), Matrix::new(&b, 48)];
    product(&mut c, left, right, [3, 32], Prologue::Add, Epilogue::Keep);
    for (i, &got) in c.iter().enumerate() {
        let fused = (0..3).fold(0.25f32, |sum, k| {
            a[i / 32 * 24 + k].mul_add(b[k * 48 + i % 32], sum)
        });
        assert_eq!(got, fused);
    }
}

#[test]
fn relu_and_its_backward_pass_cut_the_same_elements() {
    let a = random(8 * 4, "a");
    let b = random(4 * 16, "b");
    let mut plain = vec![0.0; 128];
    let mut relu = vec![0.0; 128];
    let mut backward = vec![0.0; 128];
    let [a, b] = [Matrix::new(&a, 4), Matrix::new(&b, 16)];
    product(&mut plain, a, b, [4, 16], Prologue::Zero, Epilogue::Keep);
    product(&mut relu, a, b, [4, 16], Prologue::Zero, Epilogue::Relu);
    product(
        &mut backward,
        a,
        b,
        [4, 16],
        Prologue::Zero,
        Epilogue::ReluBackward(&relu),
    );
    for i in 0..128 {
        assert_eq!(relu[i], plain[i].max(0.0));
        assert_eq!(backward[i], if plain[i] > 0.0 { plain[i] } else { 0.0 });
    }
}

#[test]
fn a_transposed_product_adds_the_sum_over_rows() {
    let rows = 136;
    let width = 32;
    let columns = 64;
    let a = random(rows * width, "a");
    let b = random(rows * columns, "b");
    for inner in [32, 4] {
        let mut c = vec![1.0; inner * columns];
        add_transposed_product(
            &mut c,
            Matrix::new(&a, width),
            Matrix::new(&b, columns),
            [inner, columns],
        );
        for (i, &got) in c.iter().enumerate() {
            let k = i / columns;
            let column = i % columns;
            let want = (0..rows).fold(1f32, |sum, row| {
                a[row * width + k].mul_add(b[row * columns + column], sum)
            });
            assert_eq!(got, want);
        }
    }
}

#[cfg(target_arch = "x86_64")]
/// Both kernels with the vectors of one instruction set.
fn both<S: Simd>(simd: S) -> [Vec<f32>; 2] {
    let rows = 72;
    let inner = 32;
    let columns = 64;
    let a = random(rows * inner, "a");
    let b = random(inner * columns, "b");
    let g = random(rows * columns, "g");
    let mut c = vec![0.0; rows * columns];
    let mut d = vec![0.0; inner * columns];
    let [a, b, g] = [
        Matrix::new(&a, inner),
        Matrix::new(&b, columns),
        Matrix::new(&g, columns),
    ];
    let shape = [inner, columns];
    let prologue = Prologue::Zero;
    let epilogue = Epilogue::Relu;
    simd.vectorize(Product {
        c: &mut c,
        a,
        b,
        shape,
        prologue,
        epilogue,
    });
    simd.vectorize(TransposedProduct { c: &mut d, a, b: g });
    [c, d]
}

#[cfg(target_arch = "x86_64")]
#[test]
fn every_vector_width_gives_the_same_bits() {
    let portable = both(pulp::Scalar);
    let avx2 = pulp::x86::V3::try_new().map(both);
    let avx512 = pulp::x86::V4::try_new().map(both);
    assert!(avx2.is_none_or(|results| results == portable));
    assert!(avx512.is_none_or(|results| results == portable));
}
