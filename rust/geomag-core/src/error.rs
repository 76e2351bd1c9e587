//! What can go wrong, said so that a reader can mend it: what was needed, what was got, and where.
//!
//! Not finding a fix is never an error; it is a [`Status`](crate::fix::Status).

/// Shorthand for results of this crate.
pub type Result<T> = std::result::Result<T, Error>;

/// Every error of this crate.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// An argument is outside what the function accepts.
    #[error("{what}: needed {needed}, got {got}")]
    Invalid {
        /// The argument, with its index where it is an element.
        what: String,
        /// What is accepted.
        needed: String,
        /// What was passed.
        got: String,
    },
    /// Arrays that belong together do not fit each other.
    #[error("{what}: needed shape {needed}, got {got}")]
    Shape {
        /// The array.
        what: String,
        /// The shape that would fit.
        needed: String,
        /// The shape that was passed.
        got: String,
    },
    /// A value that must be finite is NaN or infinite.
    #[error("{what}[{index}]: needed a finite number, got {got}")]
    NotFinite {
        /// The array or argument.
        what: String,
        /// Index of the first offending element.
        index: usize,
        /// The value.
        got: f64,
    },
    /// Too few samples for what was asked.
    #[error("{what}: needed at least {needed} samples, got {got}")]
    TooFewSamples {
        /// What needs the samples.
        what: String,
        /// The least number.
        needed: usize,
        /// The number passed.
        got: usize,
    },
    /// A search would exceed the caller's own limit; refused before memory is taken.
    #[error(
        "{what}: needs {needed} candidates, the limit is {limit}; raise max_candidates (lattices end at 2^31), enlarge the step or shrink the search"
    )]
    TooManyCandidates {
        /// The search.
        what: String,
        /// Candidates that it would need.
        needed: u128,
        /// The limit in force.
        limit: u64,
    },
    /// Memory that the system does not grant.
    #[error(
        "{what}: needs {bytes} bytes of memory, more than the system grants; enlarge the step or shrink the search"
    )]
    NoMemory {
        /// What needs it.
        what: String,
        /// Bytes asked for.
        bytes: u128,
    },
    /// A value of a map that must be finite, or NaN for a hole, is infinite.
    #[error("{what}: needed finite numbers (NaN for a hole), got {got} at row {row}, column {column} (x {x}, y {y})")]
    NotFiniteNode {
        /// The map.
        what: String,
        /// Row of the node, in the order that the values were given in.
        row: usize,
        /// Column of the node, in that order.
        column: usize,
        /// Its x as given.
        x: f64,
        /// Its y as given.
        y: f64,
        /// The value.
        got: f64,
    },
    /// A matrix that must be positive definite is not, after bounded regularisation.
    #[error("{what}: needed a positive definite matrix, got one whose factorisation fails ({detail})")]
    NotPositiveDefinite {
        /// The matrix.
        what: String,
        /// What was tried.
        detail: String,
    },
    /// Equations without a unique solution.
    #[error("{what}: needed a full-rank problem, got rank {rank} of {needed} ({detail})")]
    RankDeficient {
        /// The problem.
        what: String,
        /// Numerical rank.
        rank: usize,
        /// Rank needed.
        needed: usize,
        /// Why, in the caller's terms.
        detail: String,
    },
    /// Saved state that cannot be read back.
    #[error("saved state of {what}: {detail}")]
    State {
        /// The object.
        what: String,
        /// What is wrong with it.
        detail: String,
    },
    /// The caller asked to stop.
    #[error("interrupted by the caller")]
    Interrupted,
}

impl Error {
    /// An [`Error::Invalid`] from its three parts.
    #[allow(clippy::needless_pass_by_value)] // literals, numbers and fresh strings alike
    pub fn invalid(what: impl Into<String>, needed: impl Into<String>, got: impl ToString) -> Self {
        Self::Invalid { what: what.into(), needed: needed.into(), got: got.to_string() }
    }

    /// An [`Error::Shape`] from its three parts.
    #[allow(clippy::needless_pass_by_value)] // literals, numbers and fresh strings alike
    pub fn shape(what: impl Into<String>, needed: impl Into<String>, got: impl ToString) -> Self {
        Self::Shape { what: what.into(), needed: needed.into(), got: got.to_string() }
    }
}

/// Asks the system whether it would grant room for `len` numbers, so that a large request is refused and does not end
/// the process. Small ones are not asked for: their return to the allocator costs the next one its untouched zeros.
pub(crate) fn grantable<T>(what: &str, len: usize) -> Result<()> {
    if len.saturating_mul(size_of::<T>()) < 1 << 28 { Ok(()) } else { room::<T>(what, len).map(drop) }
}

/// An empty vector with room for `len` numbers.
pub(crate) fn room<T>(what: &str, len: usize) -> Result<Vec<T>> {
    let mut room = Vec::new();
    let bytes = len as u128 * size_of::<T>() as u128;
    room.try_reserve_exact(len).map_err(|_| Error::NoMemory { what: what.into(), bytes })?;
    Ok(room)
}

/// Refuses a slice with a NaN or infinite element, naming the first.
///
/// # Errors
/// [`Error::NotFinite`].
pub fn require_finite(what: &str, values: &[f64]) -> Result<()> {
    match values.iter().position(|v| !v.is_finite()) {
        None => Ok(()),
        Some(index) => Err(Error::NotFinite { what: what.into(), index, got: values[index] }),
    }
}

/// Refuses a number that is not finite and greater than zero.
///
/// # Errors
/// [`Error::Invalid`].
pub fn require_positive(what: &str, value: f64) -> Result<f64> {
    if value.is_finite() && value > 0.0 { Ok(value) } else { Err(Error::invalid(what, "a finite number > 0", value)) }
}

/// Refuses a count of zero, or one over what memory and patience can bear.
///
/// # Errors
/// [`Error::Invalid`].
pub fn require_count(what: &str, value: usize, limit: usize) -> Result<usize> {
    if (1..=limit).contains(&value) {
        Ok(value)
    } else {
        Err(Error::invalid(what, format!("a number from 1 to {limit}"), value))
    }
}

/// Refuses a number that is not finite or is less than zero.
///
/// # Errors
/// [`Error::Invalid`].
pub fn require_not_negative(what: &str, value: f64) -> Result<f64> {
    if value.is_finite() && value >= 0.0 { Ok(value) } else { Err(Error::invalid(what, "a finite number >= 0", value)) }
}

/// Refuses weights that are not one for each of `n` samples, are no numbers >= 0 or are all zero.
///
/// # Errors
/// [`Error::Shape`], [`Error::Invalid`].
pub fn require_weights(weights: &[f64], n: usize) -> Result<()> {
    if weights.len() != n {
        return Err(Error::shape("weights", format!("({n},) as the track"), format!("({},)", weights.len())));
    }
    for (k, &w) in weights.iter().enumerate() {
        require_not_negative(&format!("weights[{k}]"), w)?;
    }
    if weights.iter().all(|w| *w == 0.0) {
        return Err(Error::invalid("weights", "at least one weight > 0", "zeros only"));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_that_no_system_has_is_an_error() {
        let bytes = 8 << 60;
        assert_eq!(grantable::<f64>("scores", 1 << 60), Err(Error::NoMemory { what: "scores".into(), bytes }));
        assert!(room::<f64>("scores", 1 << 10).unwrap().capacity() >= 1 << 10);
    }
}
