//! Which pixels of a photo are looked at, in a bit each, and how to find the n-th of them. Knows
//! nothing of colours.

/// Pixels of a word.
const WORD: usize = u64::BITS as usize;

/// The open pixels of a photo, counted row by row from the top.
#[derive(Clone, Debug)]
pub struct Mask {
    words: Vec<u64>,
    /// Open pixels before each word.
    before: Vec<u32>,
    pixels: usize,
    open: u32,
}

impl Mask {
    /// Open where the flags say so.
    pub fn new(open: &[bool]) -> Self {
        let word = |flags: &[bool]| {
            let bits = flags.iter().enumerate();
            bits.fold(0, |word, (bit, open)| word | u64::from(*open) << bit)
        };
        let words: Vec<u64> = open.chunks(WORD).map(word).collect();
        let mut sum = 0;
        let mut before = Vec::with_capacity(words.len());
        for word in &words {
            before.push(sum);
            sum += word.count_ones();
        }
        Self {
            words,
            before,
            pixels: open.len(),
            open: sum,
        }
    }

    /// All pixels, open or not.
    pub fn pixels(&self) -> usize {
        self.pixels
    }

    /// How many pixels are open.
    pub fn open(&self) -> u32 {
        self.open
    }

    /// The place of open pixel `n`, from 0; there must be one.
    pub fn nth(&self, n: u32) -> u32 {
        // The last word with no more than `n` open pixels before it: it has pixel `n`, since
        // words without open pixels do not move the count.
        let word = self.before.partition_point(|&before| before <= n) - 1;
        let mut bits = self.words[word];
        for _ in self.before[word]..n {
            // Clears the lowest bit.
            bits &= bits - 1;
        }
        (word * WORD) as u32 + bits.trailing_zeros()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::bool::weighted;
    use proptest::collection::vec;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_open_pixels_come_in_order(open in vec(weighted(0.1), 0..300)) {
            let mask = Mask::new(&open);
            let places: Vec<u32> = (0..mask.open()).map(|n| mask.nth(n)).collect();
            let expected = (0..open.len() as u32).filter(|&at| open[at as usize]);
            let expected: Vec<u32> = expected.collect();
            prop_assert_eq!(places, expected);
            prop_assert_eq!(mask.pixels(), open.len());
        }
    }
}
