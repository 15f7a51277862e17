//! What is known of a value in a graph before anything is computed.

/// A ratio of sides, in lowest terms.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ratio {
    pub over: usize,
    pub under: usize,
}

/// The ratios that are followed: no network has others.
const LARGEST: usize = 64;

impl Ratio {
    pub const ONE: Self = Self { over: 1, under: 1 };

    /// `over / under`; `None` beyond [`LARGEST`].
    pub fn new(over: usize, under: usize) -> Option<Self> {
        let divisor = greatest_common_divisor(over, under);
        let ratio = Self {
            over: over.checked_div(divisor)?,
            under: under.checked_div(divisor)?,
        };
        // With small terms, products of two ratios stay far from overflow.
        (over > 0 && under > 0 && ratio.over <= LARGEST && ratio.under <= LARGEST).then_some(ratio)
    }

    /// The ratio that this number is, if it is one of small numbers.
    pub fn of(number: f64) -> Option<Self> {
        let close = |under: &usize| {
            let over = number * *under as f64;
            // A factor such as 1/3 is a rounded decimal in the text, hence the tolerance.
            (over - over.round()).abs() < 1e-6 && over < (LARGEST * LARGEST) as f64
        };
        let under = (1..=LARGEST).find(close)?;
        Self::new((number * under as f64).round() as usize, under)
    }

    /// This ratio of that one.
    pub fn times(self, other: Self) -> Option<Self> {
        Self::new(self.over * other.over, self.under * other.under)
    }

    pub fn value(self) -> f64 {
        self.over as f64 / self.under as f64
    }
}

/// The largest number that divides both.
pub fn greatest_common_divisor(a: usize, b: usize) -> usize {
    if b == 0 {
        a
    } else {
        greatest_common_divisor(b, a % b)
    }
}

/// A value of the graph.
#[derive(Clone, Debug)]
pub enum Blob {
    /// Images: how many channels they have, their side over the input's, and how far away, in
    /// pixels of the input, an input may be that changes them.
    Images {
        channels: usize,
        ratio: Ratio,
        reach: f64,
    },
    /// A number for each channel, which is known.
    Constant(Vec<f32>),
}
