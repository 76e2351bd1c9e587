//! Bytes to numbers, most of them such as people give, some such as nobody should.

/// Numbers that programs trip over.
const HOSTILE: [f64; 20] = [
    f64::NAN,
    f64::INFINITY,
    f64::NEG_INFINITY,
    0.0,
    -0.0,
    1e-320,
    1e-300,
    1e-30,
    1e-9,
    1.0,
    -1.0,
    1e8,
    -1e8,
    1e15,
    -1e32,
    9.97e36,
    1e154,
    1e300,
    f64::MAX,
    -f64::MAX,
];

/// Says what a case is made of, where `GEOMAG_FUZZ_SHOW` is set: for whoever looks at one that was found.
pub fn show(case: &dyn std::fmt::Debug) {
    static SHOWN: std::sync::LazyLock<bool> =
        std::sync::LazyLock::new(|| std::env::var_os("GEOMAG_FUZZ_SHOW").is_some());
    if *SHOWN {
        eprintln!("{case:?}");
    }
}

/// The bytes of a case, read from the front; zeros once they are used up.
#[derive(Debug)]
pub struct Source<'a> {
    bytes: &'a [u8],
}

impl<'a> Source<'a> {
    /// A source of these bytes.
    pub fn new(bytes: &'a [u8]) -> Self {
        Self { bytes }
    }

    /// Whether every byte was read.
    pub fn is_over(&self) -> bool {
        self.bytes.is_empty()
    }

    /// What was not read.
    pub fn rest(&self) -> &'a [u8] {
        self.bytes
    }

    /// The next byte.
    pub fn byte(&mut self) -> u8 {
        let Some((first, rest)) = self.bytes.split_first() else { return 0 };
        self.bytes = rest;
        *first
    }

    /// A whole number below `n`.
    pub fn below(&mut self, n: usize) -> usize {
        usize::from(self.byte()) % n
    }

    /// True once in `n` bytes on average, and not where the bytes are over.
    pub fn one_in(&mut self, n: u8) -> bool {
        self.byte() % n == n - 1
    }

    /// A number from `low` to `high`.
    pub fn within(&mut self, low: f64, high: f64) -> f64 {
        let share = f64::from(u16::from_le_bytes([self.byte(), self.byte()])) / f64::from(u16::MAX);
        low + (high - low) * share
    }

    /// A number from `low` to `high`, or, once in 32, any.
    pub fn number(&mut self, low: f64, high: f64) -> f64 {
        match self.byte() {
            0..248 => self.within(low, high),
            248..253 => HOSTILE[self.below(HOSTILE.len())],
            _ => f64::from_bits(u64::from_le_bytes(std::array::from_fn(|_| self.byte()))),
        }
    }

    /// A number, half of the time.
    pub fn maybe(&mut self, low: f64, high: f64) -> Option<f64> {
        if self.byte().is_multiple_of(2) { None } else { Some(self.number(low, high)) }
    }

    /// One of these.
    pub fn one_of<T: Copy>(&mut self, these: &[T]) -> T {
        these[self.below(these.len())]
    }

    /// So many numbers.
    pub fn numbers(&mut self, n: usize, low: f64, high: f64) -> Vec<f64> {
        (0..n).map(|_| self.number(low, high)).collect()
    }
}

/// Asserts that a matrix of two by two is a covariance: finite, symmetric, no negative variance along any axis.
pub fn assert_covariance(what: &str, c: [[f64; 2]; 2]) {
    assert!(c.as_flattened().iter().all(|v| v.is_finite()), "{what}: {c:?}");
    assert!((c[0][1] - c[1][0]).abs() <= 1e-9 * (c[0][0].abs() + c[1][1].abs()), "{what}: {c:?}");
    // Sizes first: the product of two large variances is no double.
    let (a, b) = (c[0][0].max(0.0).sqrt(), c[1][1].max(0.0).sqrt());
    assert!(c[0][0] >= 0.0 && c[1][1] >= 0.0 && c[0][1].abs() <= a * b * (1.0 + 1e-6) + 1e-300, "{what}: {c:?}");
}
