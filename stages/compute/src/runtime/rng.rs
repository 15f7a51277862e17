//! Random numbers as pure functions of (seed, domain, step, element): a counter-based generator has
//! no state to save, and any thread may draw any. Philox4x32-10, Salmon et al. 2011, "Parallel
//! random numbers: as easy as 1, 2, 3".

use rayon::prelude::*;

use super::array::Array;
use super::device::Device;

const MULTIPLIERS: [u32; 2] = [0xD251_1F53, 0xCD9E_8D57];
const WEYL: [u32; 2] = [0x9E37_79B9, 0xBB67_AE85];

/// Ten rounds of the Philox bijection on 128 bits.
fn philox4x32_10(mut counter: [u32; 4], mut key: [u32; 2]) -> [u32; 4] {
    for _ in 0..10 {
        // The round of Salmon et al.: the high halves cross over to the other lanes.
        let [a, b] = [0, 2].map(|lane| u64::from(MULTIPLIERS[lane / 2]) * u64::from(counter[lane]));
        counter = [
            (b >> 32) as u32 ^ counter[1] ^ key[0],
            b as u32,
            (a >> 32) as u32 ^ counter[3] ^ key[1],
            a as u32,
        ];
        key = [key[0].wrapping_add(WEYL[0]), key[1].wrapping_add(WEYL[1])];
    }
    counter
}

/// The 64-bit FNV-1a hash, which folds a domain's name into the key.
fn fnv1a(bytes: &[u8]) -> u64 {
    // Offset basis and prime of FNV-1a.
    bytes.iter().fold(0xCBF2_9CE4_8422_2325, |hash, &byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01B3)
    })
}

/// 24 random bits as a number in [0, 1).
fn unit(bits: u32) -> f32 {
    // 24 bits are what an f32 holds: rounding more could give 1.
    (bits >> 8) as f32 / (1 << 24) as f32
}

/// An independent stream of random numbers for each (seed, domain).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rng {
    key: [u32; 2],
}

impl Rng {
    /// The stream of `domain`, a name for what the numbers are used for, under `seed`.
    pub fn new(seed: u64, domain: &str) -> Rng {
        let name = fnv1a(domain.as_bytes());
        let [seed_low, seed_high, name_low, name_high] =
            [seed, seed >> 32, name, name >> 32].map(|x| x as u32);
        // Mixed once, so that seeds and names that differ little give keys that differ much.
        let mixed = philox4x32_10([seed_low, seed_high, name_low, name_high], [0, 0]);
        Rng {
            key: [mixed[0], mixed[1]],
        }
    }

    /// The key of the counter, for a kernel that draws the same numbers.
    pub fn key(&self) -> [u32; 2] {
        self.key
    }

    fn draw(&self, step: u64, element: u64) -> [u32; 4] {
        philox4x32_10(
            [
                element as u32,
                (element >> 32) as u32,
                step as u32,
                (step >> 32) as u32,
            ],
            self.key,
        )
    }

    /// Uniform in [0, 1), a multiple of 2^-24.
    pub fn uniform(&self, step: u64, element: u64) -> f32 {
        unit(self.draw(step, element)[0])
    }

    /// Four such numbers for the price of one, of which [`Rng::uniform`] is the first.
    pub fn uniforms(&self, step: u64, element: u64) -> [f32; 4] {
        self.draw(step, element).map(unit)
    }

    /// Standard normal, by the transform of Box and Muller 1958.
    pub fn normal(&self, step: u64, element: u64) -> f32 {
        let [a, b, ..] = self.draw(step, element);
        // Half a step up, so that the logarithm never meets 0.
        let radius = (-2.0 * ((f64::from(a) + 0.5) / 4_294_967_296.0).ln()).sqrt();
        (radius * (std::f64::consts::TAU * f64::from(b) / 4_294_967_296.0).cos()) as f32
    }

    /// Uniform in `0..n`, without bias beyond 2^-64.
    pub fn below(&self, step: u64, element: u64, n: u32) -> u32 {
        assert!(n > 0, "below: no number is below 0");
        let [a, b, ..] = self.draw(step, element);
        // A product instead of a remainder, which would favour small numbers.
        let bits = u128::from(u64::from(a) << 32 | u64::from(b));
        ((bits * u128::from(n)) >> 64) as u32
    }

    /// An array whose element `i` is [`Rng::normal`]`(step, i)`.
    pub fn normals(&self, step: u64, shape: &[usize], device: &Device) -> Array {
        let len = shape.iter().product::<usize>() as u64;
        device.array(
            shape,
            (0..len)
                // Each element is a function of its number, so that any thread may draw it.
                .into_par_iter()
                .map(|element| self.normal(step, element))
                .collect(),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::check::assert_same_bits;

    #[test]
    fn philox_gives_the_published_answers() {
        let zeros = philox4x32_10([0; 4], [0; 2]);
        assert_eq!(zeros, [0x6627_E8D5, 0xE169_C58D, 0xBC57_AC4C, 0x9B00_DBD8]);
        let ones = philox4x32_10([u32::MAX; 4], [u32::MAX; 2]);
        assert_eq!(ones, [0x408F_276D, 0x41C8_3B0E, 0xA20B_C7C6, 0x6D54_51FD]);
        let pi = [0x243F_6A88, 0x85A3_08D3, 0x1319_8A2E, 0x0370_7344];
        let digits = philox4x32_10(pi, [0xA409_3822, 0x299F_31D0]);
        assert_eq!(digits, [0xD16C_FE09, 0x94FD_CCEB, 0x5001_E420, 0x2412_6EA1]);
    }

    #[test]
    fn normals_have_the_moments_of_the_normal_distribution() {
        let n = 1 << 20;
        let values = Rng::new(7, "test")
            .normals(3, &[n], &Device::cpu())
            .to_vec();
        let moment = |p: i32| values.iter().map(|&x| f64::from(x).powi(p)).sum::<f64>() / n as f64;
        // Five standard errors of each.
        let bounds = [(1, 0.0, 1.0), (2, 1.0, 2.0), (3, 0.0, 15.0), (4, 3.0, 96.0)];
        for (p, expected, variance) in bounds {
            let bound = 5.0 * (variance / n as f64).sqrt();
            assert!(
                (moment(p) - expected).abs() < bound,
                "moment {p} is {}",
                moment(p)
            );
        }
    }

    #[test]
    fn uniform_and_below_fill_their_range_evenly() {
        let rng = Rng::new(1, "test");
        let mut counts = [[0u32; 10]; 2];
        for element in 0..100_000 {
            let u = rng.uniform(0, element);
            assert!((0.0..1.0).contains(&u));
            assert_eq!(rng.uniforms(0, element)[0], u);
            counts[0][(u * 10.0) as usize] += 1;
            counts[1][rng.below(1, element, 10) as usize] += 1;
        }
        assert!(
            counts
                .iter()
                .flatten()
                .all(|&count| count.abs_diff(10_000) < 500),
            "{counts:?}"
        );
    }

    #[test]
    fn seed_domain_step_and_element_all_matter() {
        let base = Rng::new(1, "a").normal(1, 1);
        let others = [
            Rng::new(2, "a").normal(1, 1),
            Rng::new(1, "b").normal(1, 1),
            Rng::new(1, "a").normal(2, 1),
            Rng::new(1, "a").normal(1, 2),
            Rng::new(1 << 40, "a").normal(1, 1),
        ];
        assert!(
            others.iter().all(|&other| other != base),
            "{base} and {others:?}"
        );
    }

    #[test]
    fn an_array_of_normals_is_the_numbers_one_by_one() {
        let rng = Rng::new(9, "test");
        let values = rng.normals(4, &[3, 5], &Device::cpu()).to_vec();
        assert_eq!(values[11], rng.normal(4, 11));
    }

    #[test]
    fn any_number_of_threads_draws_the_same() {
        let rng = Rng::new(3, "threads");
        assert_same_bits("normals", || {
            vec![rng.normals(5, &[100_000], &Device::cpu())]
        });
    }
}
